"""What a user's formula sees in place of `math`, NumPy and plain Python functions when it runs on symbols.

`replaced` makes a copy of a function whose names are replaced (in its globals, its closure and, recursively, in the
plain Python functions that it calls), so that nothing of the user's is changed.
"""

from __future__ import annotations

import builtins
import functools
import math
import types
from collections.abc import Callable
from typing import Any

import numpy as np

from . import tape as ops
from .graph import SUBSTITUTES, Symbol, Untraceable, as_number, holds_symbols


def _lift(symbolic: Callable[..., Any], plain: Callable[..., Any]) -> Callable[..., Any]:
    """`plain` extended to symbols, and to arrays of them element by element."""

    def function(*arguments: Any, **keywords: Any) -> Any:
        arrays = [value for value in arguments if isinstance(value, np.ndarray) and value.ndim]
        if arrays and any(isinstance(value, Symbol) or holds_symbols(value) for value in arguments):
            objects = []
            for value in arguments:
                element = np.empty((), dtype=object)
                element[()] = value
                objects.append(value.astype(object) if isinstance(value, np.ndarray) else element)
            return np.frompyfunc(function, len(arguments), 1)(*objects)
        if not arrays and any(isinstance(value, Symbol) or holds_symbols(value) for value in arguments):
            return symbolic(*(as_number(value) for value in arguments))
        return plain(*arguments, **keywords)

    return function


def _sum(x: Any, y: Any, sign: float = 1.0) -> Any:
    """x + sign y."""
    if isinstance(x, Symbol) and isinstance(y, Symbol):
        return x.graph.linear(x.index, y.index, 1.0, sign)
    return x.affine(1.0, sign * y) if isinstance(x, Symbol) else y.affine(sign, x)


def _product(x: Any, y: Any) -> Any:
    if isinstance(x, Symbol) and isinstance(y, Symbol):
        return x.graph.multiply(x.index, y.index)
    return x.affine(y, 0.0) if isinstance(x, Symbol) else y.affine(x, 0.0)


def _quotient(x: Any, y: Any) -> Any:
    if not isinstance(y, Symbol):
        return x.affine(1.0 / y, 0.0)
    if isinstance(x, Symbol):
        return 1.0 if x.index == y.index else x.graph.symbol(ops.DIVIDE, x.index, y.index)
    return 0.0 if x == 0.0 else y.one(ops.INVERSE, x)


def _power(x: Any, y: Any) -> Any:
    if isinstance(y, Symbol):
        if not isinstance(x, Symbol) and not x > 0.0:
            raise Untraceable(f"{x} to the power of a parameter is not smooth")
        exponent = y * (x.one(ops.LOG) if isinstance(x, Symbol) else math.log(x))
        return exponent.one(ops.EXP) if isinstance(exponent, Symbol) else 1.0
    # those that have an instruction of their own, or need none
    known = {0.0: lambda: 1.0, 1.0: lambda: x, 2.0: lambda: x * x, 0.5: lambda: x.one(ops.SQRT), -1.0: lambda: 1.0 / x}
    return known[y]() if y in known else x.one(ops.POWER_CONSTANT, y)


def _angle(y: Any, x: Any) -> Any:
    graph, anchor = (x.graph, x.index) if isinstance(x, Symbol) else (y.graph, y.index)
    # A constant is a multiple, by zero, of what the other argument is.
    first, second = (
        value if isinstance(value, Symbol) else graph.symbol(ops.AFFINE, anchor, d=value) for value in (y, x)
    )
    return graph.symbol(ops.ATAN2, first.index, second.index)


def _length(*parts: Any) -> Any:
    return sum(part * part for part in parts) ** 0.5


def _log(x: Any, base: Any = math.e) -> Any:
    """Logarithm of a symbol, or to a symbolic base."""
    x, base = (value.one(ops.LOG) if isinstance(value, Symbol) else math.log(value) for value in (x, base))
    return x / base


def _difference(x: Any, y: Any) -> float:
    """The difference, whose sign the path depends on from here if it is a symbol."""
    difference = x - y
    return difference.decided() if isinstance(difference, Symbol) else difference


_DEGREE = math.pi / 180.0

# Functions of which one argument at least is a symbol, under their names in `math` and in NumPy.
_ELEMENTARY: list[tuple[str, Callable[..., Any]]] = [
    ("add", _sum),
    ("subtract", lambda x, y: _sum(x, y, -1.0)),
    ("multiply", _product),
    ("divide true_divide", _quotient),
    ("pow power float_power", _power),
    ("negative", lambda x: x.affine(-1.0, 0.0)),
    ("positive", lambda x: x),
    ("less", lambda x, y: _difference(x, y) < 0.0),
    ("less_equal", lambda x, y: _difference(x, y) <= 0.0),
    ("greater", lambda x, y: _difference(x, y) > 0.0),
    ("greater_equal", lambda x, y: _difference(x, y) >= 0.0),
    ("equal", lambda x, y: _difference(x, y) == 0.0),
    ("not_equal", lambda x, y: _difference(x, y) != 0.0),
    ("sin", lambda x: x.one(ops.SIN)),
    ("cos", lambda x: x.one(ops.COS)),
    ("tan", lambda x: x.one(ops.TAN)),
    ("asin arcsin", lambda x: x.one(ops.ASIN)),
    ("acos arccos", lambda x: 0.5 * math.pi - x.one(ops.ASIN)),
    ("atan arctan", lambda x: x.one(ops.ATAN)),
    ("sinh", lambda x: x.one(ops.SINH)),
    ("cosh", lambda x: x.one(ops.COSH)),
    ("tanh", lambda x: x.one(ops.TANH)),
    ("asinh arcsinh", lambda x: x.one(ops.ASINH)),
    ("acosh arccosh", lambda x: x.one(ops.ACOSH)),
    ("atanh arctanh", lambda x: x.one(ops.ATANH)),
    ("exp", lambda x: x.one(ops.EXP)),
    ("exp2", lambda x: 2.0**x),
    ("expm1", lambda x: x.one(ops.EXPM1)),
    ("log", _log),
    ("log1p", lambda x: x.one(ops.LOG1P)),
    ("log2", lambda x: _log(x, 2.0)),
    ("log10", lambda x: _log(x, 10.0)),
    ("sqrt", lambda x: x**0.5),
    ("square", lambda x: x * x),
    ("reciprocal", lambda x: 1.0 / x),
    ("fabs abs absolute", lambda x: -x if x.decided() < 0.0 else x),
    ("sign", lambda x: 1.0 if x > 0.0 else -1.0),
    ("copysign", lambda x, y: abs(x) if y > 0.0 else -abs(x)),
    ("maximum fmax", lambda x, y: x if x > y else y),
    ("minimum fmin", lambda x, y: x if x < y else y),
    ("clip", lambda x, low, high: low if x < low else high if x > high else x),
    ("heaviside", lambda x, middle: 1.0 if x > 0.0 else 0.0),
    ("floor", Symbol.whole),
    ("ceil", lambda x: -(-x).whole()),
    ("trunc fix", int),
    ("rint", round),
    ("floor_divide", lambda x, y: float(np.floor(x / y))),
    ("mod", lambda x, y: x - y * (x // y)),
    ("divmod", lambda x, y: (x // y, x % y)),
    ("fmod", lambda x, y: x - y * int(x / y)),
    ("radians deg2rad", lambda x: x * _DEGREE),
    ("degrees rad2deg", lambda x: x / _DEGREE),
    ("atan2 arctan2", _angle),
    ("hypot", _length),
]


def _array(value: Any, dtype: Any = None, **keywords: Any) -> Any:
    return np.array(value, dtype=object if holds_symbols(value) or isinstance(value, Symbol) else dtype, **keywords)


def _filled(number: float) -> Callable[..., Any]:
    """An array that symbols may be written into."""
    return lambda shape, *_, **__: np.full(shape, number, dtype=object)


def _norm(value: Any, *arguments: Any, **keywords: Any) -> Any:
    if not holds_symbols(value):
        return np.linalg.norm(value, *arguments, **keywords)
    if arguments or keywords:
        raise Untraceable("np.linalg.norm of a parameter with options")
    return _length(*np.asarray(value, dtype=object).ravel())


def _fsum(values: Any) -> Any:
    return sum(values) if any(isinstance(value, Symbol) for value in values) else math.fsum(values)


class _FloatType(type):
    def __instancecheck__(cls, value: Any) -> bool:
        return isinstance(value, (float, Symbol))


class _Float(float, metaclass=_FloatType):
    """`float` that lets symbols through."""

    def __new__(cls, value: Any = 0.0) -> Any:
        return value if isinstance(value, Symbol) else float(value)


SUBSTITUTES |= {
    np.array: _array,
    np.asarray: _array,
    np.zeros: _filled(0.0),
    np.ones: _filled(1.0),
    np.empty: _filled(0.0),
    np.linalg.norm: _norm,
    np.float64: _Float,
    math.fsum: _fsum,
    float: _Float,
}
for _names, _symbolic in _ELEMENTARY:
    for _module in (math, np):
        for _name in _names.split():
            if hasattr(_module, _name):
                _plain = getattr(_module, _name)
                SUBSTITUTES[_plain] = _lift(_symbolic, _plain)


def replaced(value: Any, memo: dict[Any, Any]) -> Any:
    """`value` as it should look to code that runs on symbols; `memo` keeps what was already replaced."""
    if isinstance(value, types.ModuleType):
        return memo.setdefault(value, _Instance(value, memo))
    try:
        if value in SUBSTITUTES:
            return SUBSTITUTES[value]
    except TypeError:  # not hashable
        pass
    if isinstance(value, types.FunctionType):
        # NumPy's own Python functions work on arrays of symbols as they are.
        return value if (value.__module__ or "").startswith("numpy") else _copy(value, memo)
    if isinstance(value, types.MethodType):
        return types.MethodType(replaced(value.__func__, memo), _instance(value.__self__, memo))
    if isinstance(value, functools.partial):
        arguments = [replaced(argument, memo) for argument in value.args]
        keywords = {name: replaced(argument, memo) for name, argument in value.keywords.items()}
        return functools.partial(replaced(value.func, memo), *arguments, **keywords)
    compiled_from = getattr(value, "py_func", None)  # numba
    if isinstance(compiled_from, types.FunctionType):
        return _copy(compiled_from, memo)
    call = _call_of(value)
    if isinstance(call, types.FunctionType):
        return types.MethodType(_copy(call, memo), _instance(value, memo))
    return value


class _Instance:
    """A module or object whose functions know symbols; what is assigned to it does not reach the original."""

    def __init__(self, origin: Any, memo: dict[Any, Any]) -> None:
        self.__dict__["_origin"] = (origin, memo)

    def __getattr__(self, name: str) -> Any:
        origin, memo = self.__dict__["_origin"]
        value = getattr(origin, name)
        if isinstance(value, types.MethodType) and value.__self__ is origin:
            return types.MethodType(replaced(value.__func__, memo), self)
        return replaced(value, memo)

    def __call__(self, *arguments: Any) -> Any:
        origin, memo = self.__dict__["_origin"]
        return replaced(_call_of(origin), memo)(self, *arguments)


def _call_of(value: Any) -> Any:
    """What calling an object runs, before it is bound to it."""
    return next((vars(kind)["__call__"] for kind in type(value).__mro__ if "__call__" in vars(kind)), None)


def _instance(origin: Any, memo: dict[Any, Any]) -> Any:
    return origin if isinstance(origin, type) else _Instance(origin, memo)


def _copy(function: types.FunctionType, memo: dict[Any, Any]) -> types.FunctionType:
    """The same code in a world where `math`, NumPy and other plain functions know symbols."""
    if function in memo:
        return memo[function]

    def imported(name: str, *arguments: Any, **keywords: Any) -> Any:
        return replaced(builtins.__import__(name, *arguments, **keywords), memo)

    scope: dict[str, Any] = {
        "__name__": function.__globals__.get("__name__", ""),
        "__builtins__": {**vars(builtins), "float": _Float, "__import__": imported},
    }
    cells = tuple(types.CellType() for _ in function.__closure__ or ())
    copy = types.FunctionType(function.__code__, scope, function.__name__, None, cells or None)
    # Known before its names are filled in: functions may call each other.
    memo[function] = copy
    if function.__defaults__:
        copy.__defaults__ = tuple(replaced(value, memo) for value in function.__defaults__)
    if function.__kwdefaults__:
        copy.__kwdefaults__ = {name: replaced(value, memo) for name, value in function.__kwdefaults__.items()}
    for name in _names_in(function.__code__):
        if name in function.__globals__:
            scope[name] = replaced(function.__globals__[name], memo)
    for cell, original in zip(cells, function.__closure__ or ()):
        try:
            cell.cell_contents = replaced(original.cell_contents, memo)
        except ValueError:  # an empty cell stays empty
            continue
    return copy


def _names_in(code: types.CodeType) -> set[str]:
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names |= _names_in(constant)
    return names
