"""Tracing: running a user's Python function once on symbols turns it into a tape.

The function is called with `Symbol` arguments through a copy whose `math` and NumPy know symbols (in its
globals, its closure and, recursively, in the plain Python functions that it calls), so that nothing of the
user's is changed. A branch follows the outcome at one point, and the path remembers what was compared; `branches`
finds out where else it is the same. A call into compiled code gets a number, and the path remembers that it is no tape.
"""

from __future__ import annotations

import builtins
import functools
import math
import types
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import tape as ops
from .base import F_1, F_1T, F_2, F_2T, F_11, F_12, F_22, F_T, F_TT, F
from .enclosures import ORIGIN, SIGN, Check, Interval, is_risky, values

# What a slot's entries are, by the variables of the tape: rows of the derivative array.
ROWS = {
    "u": (F, F_1, F_11),
    "ut": (F, F_1, F_T, F_11, F_1T, F_TT),
    "uv": (F, F_1, F_2, F_11, F_12, F_22),
    "uvt": (F, F_1, F_2, F_T, F_11, F_12, F_1T, F_22, F_2T, F_TT),
}


class Untraceable(Exception):
    """The function does something with its argument that a tape cannot hold."""


@dataclass(frozen=True)
class Tape:
    """A traced function.

    pool:            the tape as the kernels read it (writable: it holds its own scratch area)
    time_dependent:  whether t occurs in it
    constants:       for each output its value if it does not depend on any variable, else None
    """

    pool: np.ndarray
    time_dependent: bool
    constants: tuple[float | None, ...]

    @property
    def instructions(self) -> int:
        """How many instructions it has."""
        return int(self.pool[ops.COUNT])


class Path:
    """What a function does at one point, and wherever else its comparisons have the same outcome.

    reason: why there is no tape, empty if there is one
    """

    def __init__(
        self, function: Callable[..., Any], variables: str, outputs: int, at: Sequence[float] | None = None
    ) -> None:
        self.graph = _Graph(None if at is None else dict(zip(variables, at)))
        self.reason = ""
        self._components: list[Any] = []
        arguments = [self.graph.symbol(("variable", name)) for name in variables]
        try:
            result = _replace(function, {})(*arguments)
            self._components = _components(result, outputs)
            self.reason = self.graph.leak
        except Untraceable as reason:
            self.reason = str(reason)
        except Exception as error:  # whatever the user's code raises on a symbol means the same
            self.reason = f"{type(error).__name__}: {error}"

    def tape(self, variables: str) -> Tape:
        """The tape of this path. Raises `Untraceable` with the reason where there is none."""
        if self.reason:
            raise Untraceable(self.reason)
        return self.graph.tape(self._components, variables)

    @property
    def comparisons(self) -> list[Check]:
        """The signs that its comparisons found."""
        return self.graph.comparisons

    @property
    def risks(self) -> list[Check]:
        """The operations of its tape that are not smooth for all arguments."""
        if self.reason:
            return []
        return [
            check
            for index in self.graph.reachable(self._roots())
            if (check := _risk(self.graph.nodes[index])) is not None
        ]

    @property
    def cuts(self) -> list[Check]:
        """The angles of its tape, which jump by a turn at their cut."""
        if self.reason:
            return []
        used = (self.graph.nodes[index] for index in self.graph.reachable(self._roots()))
        return [(ops.ATAN2, node[2], node[3], 0.0) for node in used if node[:2] == ("two", ops.ATAN2)]

    def _roots(self) -> list[int]:
        return [part.index for part in self._components if isinstance(part, Symbol)]


def _risk(node: tuple[Any, ...]) -> Check | None:
    """Where an operation is not smooth, by the arguments that decide it: those of others would only mislead."""
    if node[0] == "one" and is_risky(node[1], node[3]):
        return node[1], node[2], node[2], node[3]
    if node[0] != "two" or node[1] == ops.MULTIPLY:
        return None
    op, x, y = node[1:]
    if op == ops.DIVIDE:
        return ops.INVERSE, y, y, 0.0
    if op == ops.POWER:
        return op, x, x, 0.0
    return (ORIGIN if op == ops.ATAN2 else op), x, y, 0.0


def trace(function: Callable[..., Any], variables: str, outputs: int) -> Tape:
    """The tape of function(*variables) -> `outputs` numbers, which compares none of them.

    variables: "u", "ut", "uv" or "uvt".
    Raises `Untraceable` with the reason where the function does not follow from elementary operations.
    """
    return Path(function, variables, outputs).tape(variables)


def _components(result: Any, outputs: int) -> list[Any]:
    components = np.asarray(result, dtype=object).reshape(-1).tolist()
    if len(components) != outputs:
        raise Untraceable(f"returned {len(components)} numbers instead of {outputs}")
    return [part if isinstance(part, Symbol) else float(part) for part in components]


class _Graph:
    """Expressions without repetition: a node is (operation, arguments..., constants...).

    point:        values of the variables that decide comparisons, None if there are to be none
    comparisons:  the signs that were decided
    leak:         what took the number of a symbol out of the graph, empty if nothing did
    """

    def __init__(self, point: dict[str, float] | None = None) -> None:
        self.nodes: list[tuple[Any, ...]] = []
        self.known: dict[tuple[Any, ...], int] = {}
        self.comparisons: list[Check] = []
        self.leak = ""
        self._point = point
        self._values: dict[int, Interval] = {}

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

    def symbol(self, node: tuple[Any, ...]) -> Symbol:
        if node not in self.known:
            self.known[node] = len(self.nodes)
            self.nodes.append(node)
        return Symbol(self, self.known[node])

    def scaled(self, index: int) -> tuple[float, int]:
        """The node as factor times another node, where it is one."""
        node = self.nodes[index]
        if node[0] == "affine" and node[3] == 0.0:
            return node[2], node[1]
        return 1.0, index

    def affine(self, x: int, factor: float, shift: float) -> Any:
        if factor == 0.0:
            return shift
        if shift == 0.0:
            inner, x = self.scaled(x)
            factor *= inner
            if factor == 1.0:
                return Symbol(self, x)
            if abs(factor) == 1.0 and self.nodes[x][0] in ("affine", "linear"):
                # A change of sign is exact, so it may move into a sum; other factors may not.
                node = self.nodes[x]
                if node[0] == "affine":
                    return self.affine(node[1], factor * node[2], factor * node[3])
                return self.linear(node[1], node[2], factor * node[3], factor * node[4])
        else:
            inner, x = self.scaled(x)
            factor *= inner
        return self.symbol(("affine", x, factor, shift))

    def linear(self, x: int, y: int, c: float, d: float) -> Any:
        (cx, x), (dy, y) = self.scaled(x), self.scaled(y)
        c, d = c * cx, d * dy
        if x == y:
            return self.affine(x, c + d, 0.0)
        if x > y:
            x, y, c, d = y, x, d, c
        return self.symbol(("linear", x, y, c, d))

    def multiply(self, x: int, y: int) -> Any:
        (c, x), (d, y) = self.scaled(x), self.scaled(y)
        if x == y:
            product = self.symbol(("one", ops.SQUARE, x, 0.0))
        else:
            product = self.symbol(("two", ops.MULTIPLY, min(x, y), max(x, y)))
        return self.affine(product.index, c * d, 0.0)

    def tape(self, components: list[Any], variables: str) -> Tape:
        used = self.reachable([part.index for part in components if isinstance(part, Symbol)])
        timed = "t" in variables and any(self.nodes[i] == ("variable", "t") for i in used)
        if not timed:
            variables = variables.replace("t", "")
        rows = ROWS[variables]
        width, n = len(rows), len(variables)

        order = [i for i in used if self.nodes[i][0] != "variable"]
        program: list[tuple[int, int, int, float, float]] = []

        def append(op: int, a: int, b: int = 0, c: float = 0.0, d: float = 0.0) -> None:
            program.append((op, a, b, c, d))

        slots: dict[int, int] = {}  # node -> slot
        pairs: dict[int, int] = {}
        for name in variables:
            slots[self.known[("variable", name)]] = variables.index(name)
        count = n
        for index in order:
            node = self.nodes[index]
            if node[0] == "affine":
                append(ops.AFFINE, slots[node[1]], c=node[2], d=node[3])
            elif node[0] == "linear":
                append(ops.LINEAR, slots[node[1]], slots[node[2]], node[3], node[4])
            elif node[0] in ("sin", "cos"):
                argument = node[1]
                if argument not in pairs:
                    pairs[argument] = count
                    append(ops.SINCOS, slots[argument])
                    count += 2
                slots[index] = pairs[argument] + (node[0] == "cos")
                continue
            elif node[0] == "two":
                append(node[1], slots[node[2]], slots[node[3]])
            else:
                append(node[1], slots[node[2]], c=node[3])
            slots[index] = count
            count += 1

        scratch = ops.INSTRUCTIONS + ops.INSTRUCTION_SIZE * len(program)
        pool = np.zeros(scratch + count * width)
        pool[: ops.RESULTS] = len(program), n, width, scratch, len(components)
        for i, part in enumerate(components):
            traced = isinstance(part, Symbol)
            pool[ops.RESULTS + 2 * i] = scratch + width * slots[part.index] if traced else -1.0
            pool[ops.RESULTS + 2 * i + 1] = 0.0 if traced else part
        pool[ops.ROWS : ops.ROWS + width] = rows
        pool[ops.TIMES : ops.TIMES + 2] = -math.inf, math.inf
        for i, (op, a, b, c, d) in enumerate(program):
            at = ops.INSTRUCTIONS + ops.INSTRUCTION_SIZE * i
            pool[at : at + 5] = op, scratch + width * a, scratch + width * b, c, d
        for i in range(n):
            pool[scratch + width * i + 1 + i] = 1.0
        constants = tuple(None if isinstance(part, Symbol) else float(part) for part in components)
        return Tape(pool, timed, constants)

    def reachable(self, roots: list[int]) -> list[int]:
        """Nodes that the roots depend on; indices grow along dependencies, so sorting orders them."""
        seen: set[int] = set()
        stack = list(roots)
        while stack:
            index = stack.pop()
            if index in seen:
                continue
            seen.add(index)
            stack.extend(self._arguments(self.nodes[index]))
        return sorted(seen)

    @staticmethod
    def _arguments(node: tuple[Any, ...]) -> tuple[int, ...]:
        if node[0] == "variable":
            return ()
        if node[0] in ("affine", "sin", "cos"):
            return (node[1],)
        if node[0] == "linear":
            return (node[1], node[2])
        return node[2:] if node[0] == "two" else (node[2],)


def _refuse(what: str) -> Callable[..., Any]:
    def refused(self: Symbol, *_: Any) -> Any:
        raise Untraceable(f"{what} needs the number of a parameter")

    return refused


def _number(value: Any) -> Any:
    """A symbol as it is, anything else as a float."""
    if isinstance(value, Symbol):
        return value
    if isinstance(value, np.ndarray) and value.dtype == object and value.ndim == 0:
        return _number(value[()])
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
        return method(self, _number(other))

    return operator


class Symbol:
    """A number that is not known yet; arithmetic on it extends its graph."""

    __slots__ = ("graph", "index")

    def __init__(self, graph: _Graph, index: int) -> None:
        self.graph = graph
        self.index = index

    def one(self, op: int, constant: float = 0.0) -> Symbol:
        """The function `op` of this symbol."""
        return self.graph.symbol(("one", op, self.index, constant))

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
        return 1.0 if other.index == self.index else _two(ops.DIVIDE, self, other)

    @_operator
    def __rtruediv__(self, other: Any) -> Any:
        return 0.0 if other == 0.0 else self.one(ops.INVERSE, other)

    @_operator
    def __pow__(self, other: Any) -> Any:
        if isinstance(other, Symbol):
            return _two(ops.POWER, self, other)
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
        difference = self - _number(other)
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
        if method == "__call__" and not keywords and ufunc in _SHIMS:
            return _SHIMS[ufunc](*inputs)
        if method != "__call__" or any(_holds_symbols(value) for value in inputs):
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


def _two(op: int, x: Any, y: Any) -> Any:
    """The function `op` of two arguments of which one at least is a symbol."""
    graph, anchor = (x.graph, x.index) if isinstance(x, Symbol) else (y.graph, y.index)
    # A constant is a multiple, by zero, of what the other argument is.
    left, right = (
        value if isinstance(value, Symbol) else graph.symbol(("affine", anchor, 0.0, value)) for value in (x, y)
    )
    return graph.symbol(("two", op, left.index, right.index))


def _lift(symbolic: Callable[..., Any], plain: Callable[..., Any]) -> Callable[..., Any]:
    """`plain` extended to symbols, and to arrays of them element by element."""

    def function(*arguments: Any, **keywords: Any) -> Any:
        arrays = [value for value in arguments if isinstance(value, np.ndarray) and value.ndim]
        if arrays and any(isinstance(value, Symbol) or _holds_symbols(value) for value in arguments):
            objects = []
            for value in arguments:
                element = np.empty((), dtype=object)
                element[()] = value
                objects.append(value.astype(object) if isinstance(value, np.ndarray) else element)
            return np.frompyfunc(function, len(arguments), 1)(*objects)
        if not arrays and any(isinstance(value, Symbol) or _holds_symbols(value) for value in arguments):
            return symbolic(*(_number(value) for value in arguments))
        return plain(*arguments, **keywords)

    return function


def _holds_symbols(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype == object
    if isinstance(value, (list, tuple)):
        return any(isinstance(part, Symbol) or _holds_symbols(part) for part in value)
    return False


def _hypot(*arguments: Any) -> Any:
    if len(arguments) == 2:
        return _two(ops.HYPOT, *arguments)
    return sum(value * value for value in arguments) ** 0.5


def _log(x: Any, base: Any = math.e) -> Any:
    """Logarithm of a symbol, or to a symbolic base."""
    x, base = (value.one(ops.LOG) if isinstance(value, Symbol) else math.log(value) for value in (x, base))
    return x / base


_DEGREE = math.pi / 180.0

# Functions of one symbol, under their names in `math` and in NumPy.
_ELEMENTARY: list[tuple[str, Callable[..., Any]]] = [
    ("sin", lambda x: x.graph.symbol(("sin", x.index))),
    ("cos", lambda x: x.graph.symbol(("cos", x.index))),
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
    ("log2", lambda x: x.one(ops.LOG) / math.log(2.0)),
    ("log10", lambda x: x.one(ops.LOG) / math.log(10.0)),
    ("sqrt", lambda x: x.one(ops.SQRT)),
    ("square", lambda x: x * x),
    ("reciprocal", lambda x: 1.0 / x),
    ("fabs abs absolute", abs),
    ("sign", lambda x: 1.0 if x > 0.0 else -1.0),
    ("copysign", lambda x, y: abs(x) if y > 0.0 else -abs(x)),
    ("maximum fmax", lambda x, y: x if x > y else y),
    ("minimum fmin", lambda x, y: x if x < y else y),
    ("clip", lambda x, low, high: low if x < low else high if x > high else x),
    ("heaviside", lambda x, middle: 1.0 if x > 0.0 else 0.0),
    ("floor", math.floor),
    ("ceil", math.ceil),
    ("trunc fix", math.trunc),
    ("rint", round),
    ("mod", lambda x, y: x % y),
    ("fmod", lambda x, y: x - y * math.trunc(x / y)),
    ("floor_divide", lambda x, y: x // y),
    ("negative", lambda x: -x),
    ("positive", lambda x: x),
    ("radians deg2rad", lambda x: x * _DEGREE),
    ("degrees rad2deg", lambda x: x / _DEGREE),
    ("atan2 arctan2", functools.partial(_two, ops.ATAN2)),
    ("hypot", _hypot),
    ("pow power float_power", lambda x, y: x**y),
    ("add", lambda x, y: x + y),
    ("subtract", lambda x, y: x - y),
    ("multiply", lambda x, y: x * y),
    ("divide true_divide", lambda x, y: x / y),
]


def _array(value: Any, dtype: Any = None, **keywords: Any) -> Any:
    return np.array(value, dtype=object if _holds_symbols(value) or isinstance(value, Symbol) else dtype, **keywords)


def _filled(number: float) -> Callable[..., Any]:
    """An array that symbols may be written into."""
    return lambda shape, *_, **__: np.full(shape, number, dtype=object)


def _norm(value: Any, *arguments: Any, **keywords: Any) -> Any:
    if not _holds_symbols(value):
        return np.linalg.norm(value, *arguments, **keywords)
    if arguments or keywords:
        raise Untraceable("np.linalg.norm of a parameter with options")
    return sum(part * part for part in np.asarray(value, dtype=object).ravel()) ** 0.5


def _sum(values: Any) -> Any:
    return sum(values) if any(isinstance(value, Symbol) for value in values) else math.fsum(values)


class _FloatType(type):
    def __instancecheck__(cls, value: Any) -> bool:
        return isinstance(value, (float, Symbol))


class _Float(float, metaclass=_FloatType):
    """`float` that lets symbols through."""

    def __new__(cls, value: Any = 0.0) -> Any:
        return value if isinstance(value, Symbol) else float(value)


# What stands in for a function of the user's names, by the function itself.
_SHIMS: dict[Any, Callable[..., Any]] = {
    np.array: _array,
    np.asarray: _array,
    np.zeros: _filled(0.0),
    np.ones: _filled(1.0),
    np.empty: _filled(0.0),
    np.linalg.norm: _norm,
    np.float64: _Float,
    math.fsum: _sum,
    float: _Float,
}
for _names, _symbolic in _ELEMENTARY:
    for _module in (math, np):
        for _name in _names.split():
            if hasattr(_module, _name):
                _plain = getattr(_module, _name)
                _SHIMS[_plain] = _lift(_symbolic, _plain)


class _Module(types.ModuleType):
    """A module whose functions know symbols."""

    def __init__(self, module: types.ModuleType, memo: dict[Any, Any]) -> None:
        super().__init__(module.__name__)
        self.__dict__["_origin"] = (module, memo)

    def __getattr__(self, name: str) -> Any:
        module, memo = self.__dict__["_origin"]
        return _replace(getattr(module, name), memo)


def _replace(value: Any, memo: dict[Any, Any]) -> Any:
    """`value` as it should look to code that runs on symbols; `memo` keeps what was already replaced."""
    if isinstance(value, types.ModuleType):
        return memo.setdefault(value, _Module(value, memo))
    try:
        if value in _SHIMS:
            return _SHIMS[value]
    except TypeError:  # not hashable
        pass
    if isinstance(value, types.FunctionType):
        # NumPy's own Python functions work on arrays of symbols as they are.
        return value if (value.__module__ or "").startswith("numpy") else _copy(value, memo)
    if isinstance(value, types.MethodType):
        return types.MethodType(_replace(value.__func__, memo), _instance(value.__self__, memo))
    if isinstance(value, functools.partial):
        arguments = [_replace(argument, memo) for argument in value.args]
        keywords = {name: _replace(argument, memo) for name, argument in value.keywords.items()}
        return functools.partial(_replace(value.func, memo), *arguments, **keywords)
    compiled_from = getattr(value, "py_func", None)  # numba
    if isinstance(compiled_from, types.FunctionType):
        return _copy(compiled_from, memo)
    call = _call_of(value)
    if isinstance(call, types.FunctionType):
        return types.MethodType(_copy(call, memo), _instance(value, memo))
    return value


class _Instance:
    """An object whose methods know symbols; what is assigned to it does not reach the original."""

    def __init__(self, origin: Any, memo: dict[Any, Any]) -> None:
        self.__dict__["_origin"] = (origin, memo)

    def __getattr__(self, name: str) -> Any:
        origin, memo = self.__dict__["_origin"]
        value = getattr(origin, name)
        if isinstance(value, types.MethodType) and value.__self__ is origin:
            return types.MethodType(_replace(value.__func__, memo), self)
        return _replace(value, memo)

    def __call__(self, *arguments: Any) -> Any:
        origin, memo = self.__dict__["_origin"]
        return _replace(_call_of(origin), memo)(self, *arguments)


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
        return _replace(builtins.__import__(name, *arguments, **keywords), memo)

    scope: dict[str, Any] = {
        "__name__": function.__globals__.get("__name__", ""),
        "__builtins__": {**vars(builtins), "float": _Float, "__import__": imported},
    }
    cells = tuple(types.CellType() for _ in function.__closure__ or ())
    copy = types.FunctionType(function.__code__, scope, function.__name__, None, cells or None)
    # Known before its names are filled in: functions may call each other.
    memo[function] = copy
    if function.__defaults__:
        copy.__defaults__ = tuple(_replace(value, memo) for value in function.__defaults__)
    if function.__kwdefaults__:
        copy.__kwdefaults__ = {name: _replace(value, memo) for name, value in function.__kwdefaults__.items()}
    for name in _names_in(function.__code__):
        if name in function.__globals__:
            scope[name] = _replace(function.__globals__[name], memo)
    for cell, original in zip(cells, function.__closure__ or ()):
        try:
            cell.cell_contents = _replace(original.cell_contents, memo)
        except ValueError:  # an empty cell stays empty
            continue
    return copy


def _names_in(code: types.CodeType) -> set[str]:
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names |= _names_in(constant)
    return names
