"""Expressions of symbols: what a user's formula computes, as a graph without repetition.

Arithmetic on a `Symbol` extends its `Graph`. Where the formula compares or rounds, the outcome is that at one point,
and the graph keeps the sign that was found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

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

    def __init__(self, variables: str, point: Sequence[float]) -> None:
        """point: values of the variables, which decide comparisons."""
        self.nodes: list[Node] = []
        self.comparisons: list[Check] = []
        self.leak = ""
        self._known: dict[Node, int] = {}
        self._variables, self._point = variables, np.array([point], dtype=float)
        self._values: dict[int, Interval] = {}

    def symbol(self, op: int, x: int = -1, y: int = -1, c: float = 0.0, d: float = 0.0, name: str = "") -> Symbol:
        """The symbol of a node, which is added if it is new."""
        node = Node(op, x, y, c, d, name)
        if node not in self._known:
            self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return Symbol(self, self._known[node])

    def number(self, index: int) -> float:
        """The value of a node at the point."""
        missing = [i for i in self.reachable([index]) if i not in self._values]
        self._values.update(values(self.nodes, missing, self._variables, self._point, self._values))
        return float(self._values[index].lo[0])

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


class Symbol(NDArrayOperatorsMixin):
    """A number that is not known yet; NumPy's functions of it, which Python's operators call, extend its graph."""

    __slots__ = ("graph", "index")

    def __init__(self, graph: Graph, index: int) -> None:
        self.graph = graph
        self.index = index

    def one(self, op: int, constant: float = 0.0) -> Symbol:
        """The function `op` of this symbol."""
        return self.graph.symbol(op, self.index, c=constant)

    def affine(self, factor: float, shift: float) -> Any:
        """factor times this symbol + shift."""
        return self.graph.affine(self.index, factor, shift)

    def decided(self) -> float:
        """Its value, whose sign the path depends on from here."""
        value = self.graph.number(self.index)
        self.graph.comparisons.append((SIGN, self.index, self.index, math.copysign(1.0, value)))
        return value

    def whole(self, shift: float = 0.0) -> int:
        """The whole number below it, plus the shift; the path depends on it from here."""
        shifted = self + shift
        below = math.floor(self.graph.number(shifted.index))
        for rest in (shifted - below, (below + 1) - shifted):
            rest.decided()
        return below

    def __int__(self) -> int:
        return -(-self).whole() if self.decided() < 0.0 else self.whole()

    def __round__(self, digits: int | None = None) -> Any:
        scale = 10.0 ** (digits or 0)
        nearest = (scale * self).whole(0.5)
        return nearest if digits is None else nearest / scale

    def __bool__(self) -> bool:
        return self.decided() != 0.0

    def __float__(self) -> float:
        self.graph.leak = "a call into compiled code needs the number of a parameter"
        return self.graph.number(self.index)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **keywords: Any) -> Any:
        # of x += y, whose result is another symbol
        if isinstance(keywords.get("out", [None])[0], Symbol):
            del keywords["out"]
        if method == "__call__" and not keywords and ufunc in SUBSTITUTES:
            return SUBSTITUTES[ufunc](*inputs)
        if method != "__call__" or any(holds_symbols(value) for value in inputs):
            raise Untraceable(f"np.{ufunc.__name__} of a parameter")
        return ufunc(*(float(value) if isinstance(value, Symbol) else value for value in inputs), **keywords)

    def __hash__(self) -> int:
        return hash((id(self.graph), self.index))


def holds_symbols(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype == object
    if isinstance(value, (list, tuple)):
        return any(isinstance(part, Symbol) or holds_symbols(part) for part in value)
    return False


# What stands in for a function that a formula calls, by the function itself (see `substitutes`).
SUBSTITUTES: dict[Any, Callable[..., Any]] = {}
