"""Formulas written as text: arithmetic, elementary functions and named constants, and nothing else of Python.

A text is parsed, every node of its tree is checked against a short list, and only then made into a function. What it
makes is traced as any function of a user is (`contours.parametric`), so that a run contains no Python.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from .errors import ArgumentError

FUNCTIONS: dict[str, Callable[..., float]] = {
    name: getattr(math, name)
    for name in (
        *("sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
        *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
        *("exp", "expm1", "log", "log1p", "log10", "sqrt", "hypot", "radians", "degrees"),
    )
} | {"abs": math.fabs}
CONSTANTS = {"pi": math.pi, "tau": math.tau, "e": math.e}

# Longer than any formula, short enough for Python's parser to be quick and safe.
_LONGEST = 5000


def evaluate(text: str, constants: Mapping[str, float] | None = None) -> float:
    """The number that a formula of constants stands for, such as "pi / 2" or "2 * radius".

    constants: names in addition to pi, tau and e. Raises ArgumentError for anything but a finite number.
    """
    try:
        value = compiled([text], (), constants)()[0]
    except (ArithmeticError, ValueError, TypeError) as error:
        if isinstance(error, ArgumentError):
            raise
        raise ArgumentError(f"{text!r} has no value: {error}") from error
    if isinstance(value, complex) or not math.isfinite(value):
        raise ArgumentError(f"{text!r} is {value}, not a finite number")
    return float(value)


def compiled(
    texts: Sequence[str], variables: Sequence[str], constants: Mapping[str, float] | None = None
) -> Callable[..., tuple[float, ...]]:
    """A function of the variables that returns one number for every text.

    A variable named "t" becomes an argument only if some text contains it: a shape that does not change with time is
    not one that does. Raises ArgumentError for a text that is not such a formula, with the part that is not.
    """
    known = {**CONSTANTS, **(constants or {})}
    used: set[str] = set()
    elements = [_tree(text, variables, known, used) for text in texts]
    arguments = [name for name in variables if name != "t" or "t" in used]
    signature = ast.arguments(
        posonlyargs=[], args=[ast.arg(name) for name in arguments], kwonlyargs=[], kw_defaults=[], defaults=[]
    )
    body = ast.Tuple(elements, ast.Load())
    program = ast.fix_missing_locations(ast.Expression(ast.Lambda(signature, body)))
    # Nothing is evaluated here but the lambda itself, whose nodes are those that `_tree` made.
    names: dict[str, Any] = {"__builtins__": {}, "__name__": __name__, **FUNCTIONS}
    return eval(compile(program, "<formula>", "eval"), names)


def _tree(text: str, variables: Sequence[str], constants: Mapping[str, float], used: set[str]) -> ast.expr:
    if len(text) > _LONGEST:
        raise ArgumentError(f"a formula of {len(text)} characters is too long, the limit is {_LONGEST}")
    try:
        return _checked(ast.parse(text.strip(), mode="eval").body, text, variables, constants, used)
    except SyntaxError as error:
        raise ArgumentError(f"{text!r} is not a formula: {error.msg}") from error
    except (RecursionError, MemoryError) as error:
        raise ArgumentError(f"{text[:40]!r}... is nested too deeply") from error
    except (ValueError, OverflowError) as error:
        if isinstance(error, ArgumentError):
            raise
        raise ArgumentError(f"{text!r} is not a formula: {error}") from error


def _checked(
    node: ast.expr, text: str, variables: Sequence[str], constants: Mapping[str, float], used: set[str]
) -> ast.expr:
    """A new tree of the nodes allowed, with constants in place of their names."""

    def part(child: ast.expr) -> ast.expr:
        return _checked(child, text, variables, constants, used)

    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            # as floats, powers of whole numbers overflow instead of taking for ever
            return ast.Constant(float(value))
        case ast.Name(id=name) if name in variables:
            used.add(name)
            return ast.Name(name, ast.Load())
        case ast.Name(id=name) if name in constants:
            return ast.Constant(float(constants[name]))
        case ast.Name(id=name):
            allowed = ", ".join([*variables, *constants])
            raise ArgumentError(f"{text!r}: unknown name {name!r}; there are {allowed}")
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() | ast.Pow() as op, right=right):
            return ast.BinOp(part(left), op, part(right))
        case ast.BinOp(op=ast.BitXor()):
            raise ArgumentError(f"{text!r}: a power is written **, not ^")
        case ast.UnaryOp(op=ast.UAdd() | ast.USub() as op, operand=operand):
            return ast.UnaryOp(op, part(operand))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            return ast.Call(ast.Name(name, ast.Load()), [part(argument) for argument in arguments], [])
        case ast.Call(func=ast.Name(id=name), keywords=[]):
            raise ArgumentError(f"{text!r}: unknown function {name!r}; there are {', '.join(FUNCTIONS)}")
    shown = ast.get_source_segment(text.strip(), node) or type(node).__name__
    raise ArgumentError(f"{text!r}: {shown!r} is not arithmetic")
