"""Expressions of symbols: what a user's formula computes, as a graph without repetition.

Arithmetic on a `Symbol` extends its `Graph`. Where the formula compares or rounds, the outcome is that at one point,
and the graph keeps the sign that was found.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from . import tape as ops
from .enclosures import SIGN, Check, Interval, values
from .tape import Node


class Untraceable(Exception):
    """The function does something with its argument that a tape cannot hold."""


class Graph:
    """Nodes, each after those that it depends on.

    comparisons:  the signs that were found
    leak:         what took the number of a symbol out of the graph, empty if nothing did
    """

    def __init__(self, point: dict[str, float] | None = None) -> None:
        """point: values of the variables that decide comparisons, None if there are to be none."""
        self.nodes: list[Node] = []
        self.comparisons: list[Check] = []
        self.leak = ""
        self._known: dict[Node, int] = {}
        self._point = point
        self._values: dict[int, Interval] = {}

    def symbol(self, op: int, x: int = -1, y: int = -1, c: float = 0.0, d: float = 0.0, name: str = "") -> Symbol:
        """The symbol of a node, which is added if it is new."""
        node = Node(op, x, y, c, d, name)
        if node not in self._known:
            self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return Symbol(self, self._known[node])

    def number(self, index: int, what: str) -> float:
        """The value of a node at the point. Raises Untraceable saying what needs it where there is no point."""
        if self._point is None:
            raise Untraceable(f"{what} needs the number of a parameter")
        missing = [i for i in self.reachable([index]) if i not in self._values]
        box = {name: Interval(np.array([x]), np.array([x])) for name, x in self._point.items()}
        self._values.update(values(self.nodes, missing, box, self._values))
        return float(self._values[index].lo[0])

    def decided(self, index: int, what: str) -> float:
        """A value whose sign the path depends on from here."""
        value = self.number(index, what)
        self.comparisons.append((SIGN, index, index, math.copysign(1.0, value)))
        return value

    def _scaled(self, index: int) -> tuple[float, int]:
        """The node as factor times another node, where it is one."""
        node = self.nodes[index]
        if node.op == ops.AFFINE and node.d == 0.0:
            return node.c, node.x
        return 1.0, index

    def affine(self, x: int, factor: float, shift: float) -> Any:
        """factor x + shift."""
        if factor == 0.0:
            return shift
        inner, x = self._scaled(x)
        factor *= inner
        if shift == 0.0:
            if factor == 1.0:
                return Symbol(self, x)
            node = self.nodes[x]
            # A change of sign is exact, so it may move into a sum; other factors may not.
            if abs(factor) == 1.0 and node.op == ops.AFFINE:
                return self.affine(node.x, factor * node.c, factor * node.d)
            if abs(factor) == 1.0 and node.op == ops.LINEAR:
                return self.linear(node.x, node.y, factor * node.c, factor * node.d)
        return self.symbol(ops.AFFINE, x, c=factor, d=shift)

    def linear(self, x: int, y: int, c: float, d: float) -> Any:
        """c x + d y."""
        (cx, x), (dy, y) = self._scaled(x), self._scaled(y)
        c, d = c * cx, d * dy
        if x == y:
            return self.affine(x, c + d, 0.0)
        if x > y:
            x, y, c, d = y, x, d, c
        return self.symbol(ops.LINEAR, x, y, c, d)

    def multiply(self, x: int, y: int) -> Any:
        """x y."""
        (c, x), (d, y) = self._scaled(x), self._scaled(y)
        product = self.symbol(ops.SQUARE, x) if x == y else self.symbol(ops.MULTIPLY, min(x, y), max(x, y))
        return self.affine(product.index, c * d, 0.0)

    def reachable(self, roots: Iterable[int]) -> list[int]:
        """Nodes that the roots depend on; indices grow along dependencies, so sorting orders them."""
        seen: set[int] = set()
        stack = list(roots)
        while stack:
            index = stack.pop()
            if index >= 0 and index not in seen:
                seen.add(index)
                stack += self.nodes[index].x, self.nodes[index].y
        return sorted(seen)


def _refuse(what: str) -> Callable[..., Any]:
    def refused(self: Symbol, *_: Any) -> Any:
        raise Untraceable(f"{what} needs the number of a parameter")

    return refused


def as_number(value: Any) -> Any:
    """A symbol as it is, anything else as a float."""
    if isinstance(value, Symbol):
        return value
    if isinstance(value, np.ndarray) and value.dtype == object and value.ndim == 0:
        return as_number(value[()])
    try:
        return float(value)
    except (TypeError, ValueError):
        raise Untraceable(f"{type(value).__name__} where a number was expected") from None


def _operator(method: Callable[[Symbol, Any], Any]) -> Callable[[Symbol, Any], Any]:
    """An arithmetic operator whose other operand is a number or a symbol; arrays take the operation over."""

    @functools.wraps(method)
    def operator(self: Symbol, other: Any) -> Any:
        if isinstance(other, np.ndarray) and other.ndim:
            return NotImplemented
        return method(self, as_number(other))

    return operator


class Symbol:
    """A number that is not known yet; arithmetic on it extends its graph."""

    __slots__ = ("graph", "index")

    def __init__(self, graph: Graph, index: int) -> None:
        self.graph = graph
        self.index = index

    def one(self, op: int, constant: float = 0.0) -> Symbol:
        """The function `op` of this symbol."""
        return self.graph.symbol(op, self.index, c=constant)

    def _sum(self, other: Any, sign: float) -> Any:
        if isinstance(other, Symbol):
            return self.graph.linear(self.index, other.index, 1.0, sign)
        return self.graph.affine(self.index, 1.0, sign * other)

    @_operator
    def __add__(self, other: Any) -> Any:
        return self._sum(other, 1.0)

    __radd__ = __add__

    @_operator
    def __sub__(self, other: Any) -> Any:
        return self._sum(other, -1.0)

    @_operator
    def __rsub__(self, other: Any) -> Any:
        return self.graph.affine(self.index, -1.0, other)

    @_operator
    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Symbol):
            return self.graph.multiply(self.index, other.index)
        return self.graph.affine(self.index, other, 0.0)

    __rmul__ = __mul__

    @_operator
    def __truediv__(self, other: Any) -> Any:
        if not isinstance(other, Symbol):
            return self.graph.affine(self.index, 1.0 / other, 0.0)
        return 1.0 if other.index == self.index else two(ops.DIVIDE, self, other)

    @_operator
    def __rtruediv__(self, other: Any) -> Any:
        return 0.0 if other == 0.0 else self.one(ops.INVERSE, other)

    @_operator
    def __pow__(self, other: Any) -> Any:
        if isinstance(other, Symbol):
            return two(ops.POWER, self, other)
        if other == 0.0:
            return 1.0
        if other == 1.0:
            return self
        if other == 2.0:
            return self.graph.multiply(self.index, self.index)
        if other == 0.5:
            return self.one(ops.SQRT)
        if other == -1.0:
            return self.one(ops.INVERSE, 1.0)
        return self.one(ops.POWER_CONSTANT, other)

    @_operator
    def __rpow__(self, other: Any) -> Any:
        if not other > 0.0:
            raise Untraceable(f"{other} to the power of a parameter is not smooth")
        exponent = self * math.log(other)
        return exponent.one(ops.EXP) if isinstance(exponent, Symbol) else 1.0

    def __neg__(self) -> Any:
        return self.graph.affine(self.index, -1.0, 0.0)

    def __pos__(self) -> Symbol:
        return self

    def decided(self, what: str) -> float:
        """Its value, whose sign the path depends on from here."""
        return self.graph.decided(self.index, what)

    def whole(self, shift: float = 0.0) -> int:
        """The whole number below it, plus the shift; the path depends on it from here."""
        shifted = self + shift
        below = math.floor(self.graph.number(shifted.index, "rounding"))
        for rest in (shifted - below, (below + 1) - shifted):
            rest.decided("rounding")
        return below

    def __abs__(self) -> Any:
        return -self if self.decided("an absolute value") < 0.0 else self

    def __floor__(self) -> int:
        return self.whole()

    def __ceil__(self) -> int:
        return -(-self).whole()

    def __trunc__(self) -> int:
        return self.__ceil__() if self.decided("rounding") < 0.0 else self.__floor__()

    __int__ = __trunc__

    def __round__(self, digits: int | None = None) -> Any:
        scale = 10.0 ** (digits or 0)
        nearest = (scale * self).whole(0.5)
        return nearest if digits is None else nearest / scale

    @_operator
    def __floordiv__(self, other: Any) -> Any:
        return _quotient(self, other)

    @_operator
    def __rfloordiv__(self, other: Any) -> Any:
        return _quotient(other, self)

    @_operator
    def __mod__(self, other: Any) -> Any:
        return self - other * _quotient(self, other)

    @_operator
    def __rmod__(self, other: Any) -> Any:
        return other - self * _quotient(other, self)

    @_operator
    def __divmod__(self, other: Any) -> Any:
        return self // other, self % other

    @_operator
    def __rdivmod__(self, other: Any) -> Any:
        return other // self, other % self

    def _difference(self, other: Any) -> float:
        """The difference, whose sign the path depends on from here."""
        difference = self - as_number(other)
        return difference.decided("a comparison") if isinstance(difference, Symbol) else difference

    def __lt__(self, other: Any) -> bool:
        return self._difference(other) < 0.0

    def __le__(self, other: Any) -> bool:
        return self._difference(other) <= 0.0

    def __gt__(self, other: Any) -> bool:
        return self._difference(other) > 0.0

    def __ge__(self, other: Any) -> bool:
        return self._difference(other) >= 0.0

    def __eq__(self, other: Any) -> bool:
        return self._difference(other) == 0.0

    def __ne__(self, other: Any) -> bool:
        return self._difference(other) != 0.0

    def __bool__(self) -> bool:
        return self.decided("a branch") != 0.0

    def __float__(self) -> float:
        number = self.graph.number(self.index, "a call into compiled code")
        self.graph.leak = self.graph.leak or "a call into compiled code needs the number of a parameter"
        return number

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **keywords: Any) -> Any:
        if method == "__call__" and not keywords and ufunc in SUBSTITUTES:
            return SUBSTITUTES[ufunc](*inputs)
        if method != "__call__" or any(holds_symbols(value) for value in inputs):
            raise Untraceable(f"np.{ufunc.__name__} of a parameter")
        return ufunc(*(float(value) if isinstance(value, Symbol) else value for value in inputs), **keywords)

    def __hash__(self) -> int:
        return hash((id(self.graph), self.index))

    __complex__ = _refuse("a complex number")
    __index__ = _refuse("an index")


def _quotient(x: Any, y: Any) -> float:
    """The whole number below x / y, of which one is a symbol."""
    ratio = x / y
    return float(math.floor(ratio))


def two(op: int, x: Any, y: Any) -> Any:
    """The function `op` of two arguments of which one at least is a symbol."""
    graph, anchor = (x.graph, x.index) if isinstance(x, Symbol) else (y.graph, y.index)
    # A constant is a multiple, by zero, of what the other argument is.
    left, right = (
        value if isinstance(value, Symbol) else graph.symbol(ops.AFFINE, anchor, d=value) for value in (x, y)
    )
    return graph.symbol(op, left.index, right.index)


def holds_symbols(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype == object
    if isinstance(value, (list, tuple)):
        return any(isinstance(part, Symbol) or holds_symbols(part) for part in value)
    return False


# What stands in for a function that a formula calls, by the function itself (see `substitutes`).
SUBSTITUTES: dict[Any, Callable[..., Any]] = {}
