"""Bounds of a traced formula's quantities over boxes of its variables, by interval arithmetic.

A formula is smooth where no root of it falls to zero, no denominator vanishes, no angle crosses its cut and no
comparison changes its outcome. Samples cannot show that; bounds can. Boxes are evaluated many at a time: every bound is
an array with one entry for each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from . import tape as ops
from .tape import Node

# What may be checked besides the operations of a tape: a comparison finds the sign of a quantity, which is that of the
# constant; ORIGIN: where an angle has no value.
SIGN, ORIGIN = -4, -5


class Interval:
    """Numbers between lo and hi, arrays of one shape; what is not a number is unbounded."""

    __slots__ = ("hi", "lo")

    def __init__(self, lo: np.ndarray, hi: np.ndarray) -> None:
        self.lo = np.where(np.isnan(lo), -np.inf, lo)
        self.hi = np.where(np.isnan(hi), np.inf, hi)

    def __add__(self, other: Interval) -> Interval:
        return Interval(self.lo + other.lo, self.hi + other.hi)

    def __mul__(self, other: Interval) -> Interval:
        products = [x * y for x in (self.lo, self.hi) for y in (other.lo, other.hi)]
        # zero times unbounded is zero
        products = [np.where(np.isnan(product), 0.0, product) for product in products]
        return Interval(np.minimum.reduce(products), np.maximum.reduce(products))

    def affine(self, factor: float, shift: float = 0.0) -> Interval:
        """factor x + shift."""
        ends = (factor * self.lo + shift, factor * self.hi + shift)
        return Interval(*(ends if factor >= 0.0 else ends[::-1]))

    def rising(self, f: Callable[[np.ndarray], np.ndarray]) -> Interval:
        """f(x) for a function that grows."""
        return Interval(f(self.lo), f(self.hi))

    def clipped(self, lo: float, hi: float = np.inf) -> Interval:
        """What of it is between lo and hi."""
        return Interval(np.clip(self.lo, lo, hi), np.clip(self.hi, lo, hi))

    def meets(self, other: Interval) -> Interval:
        """What is in both, which have some number in common, up to rounding."""
        lo, hi = np.maximum(self.lo, other.lo), np.minimum(self.hi, other.hi)
        return Interval(np.minimum(lo, hi), np.maximum(lo, hi))

    @property
    def magnitude(self) -> np.ndarray:
        """The largest |x|."""
        return np.maximum(np.abs(self.lo), np.abs(self.hi))

    @property
    def distance(self) -> np.ndarray:
        """The least |x|, or a negative number where zero is within."""
        return np.maximum(self.lo, -self.hi)

    def absolute(self) -> Interval:
        """|x|."""
        return Interval(np.maximum(self.distance, 0.0), self.magnitude)

    def inverse(self) -> Interval:
        """1 / x, unbounded where zero is within."""
        whole = self.distance <= 0.0
        return Interval(np.where(whole, -np.inf, 1.0 / self.hi), np.where(whole, np.inf, 1.0 / self.lo))

    def square(self) -> Interval:
        """x^2."""
        return self.absolute().rising(np.square)

    def cosine(self) -> Interval:
        """cos x."""
        a, b = np.cos(self.lo), np.cos(self.hi)
        turn = 2.0 * math.pi
        top = np.floor(self.hi / turn) >= np.ceil(self.lo / turn)
        bottom = np.floor((self.hi - math.pi) / turn) >= np.ceil((self.lo - math.pi) / turn)
        unbounded = ~np.isfinite(self.lo) | ~np.isfinite(self.hi)
        return Interval(
            np.where(bottom | unbounded, -1.0, np.minimum(a, b)), np.where(top | unbounded, 1.0, np.maximum(a, b))
        )

    def power(self, c: float) -> Interval:
        """x^c; of a power that is not whole, where x is positive."""
        if c < 0.0:
            return self.power(-c).inverse()
        if c != round(c):
            return self.clipped(0.0).rising(lambda x: x**c)
        return (self if c % 2.0 else self.absolute()).rising(lambda x: x**c)


class _Rule(NamedTuple):
    """A growing function of one variable.

    f: the function; slope: bounds of its derivative from those of its argument and its value; domain: where it is
    defined; fault: what is wrong where its argument reaches an end of that.
    """

    f: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[Interval, Interval], Interval]
    domain: tuple[float, float] = (-np.inf, np.inf)
    fault: str = ""


def _power_of_square(factor: float, constant: float, power: float) -> Callable[[Interval, Interval], Interval]:
    """(factor x^2 + constant)^power."""
    return lambda x, _: x.square().affine(factor, constant).clipped(0.0).power(power)


_FALLS, _REACHES = "of a quantity that falls to", "of a quantity that reaches 1 or -1"
_RULES = {
    ops.SQRT: _Rule(np.sqrt, lambda _, f: f.inverse().affine(0.5), (0.0, np.inf), f"the square root {_FALLS} zero"),
    ops.EXP: _Rule(np.exp, lambda _, f: f),
    ops.EXPM1: _Rule(np.expm1, lambda x, _: x.rising(np.exp)),
    ops.LOG: _Rule(np.log, lambda x, _: x.inverse(), (0.0, np.inf), f"the logarithm {_FALLS} zero"),
    ops.LOG1P: _Rule(
        np.log1p, lambda x, _: x.affine(1.0, 1.0).inverse(), (-1.0, np.inf), f"the logarithm {_FALLS} zero"
    ),
    ops.ASIN: _Rule(np.arcsin, _power_of_square(-1.0, 1.0, -0.5), (-1.0, 1.0), f"the arc sine or cosine {_REACHES}"),
    ops.ATAN: _Rule(np.arctan, _power_of_square(1.0, 1.0, -1.0)),
    ops.SINH: _Rule(np.sinh, lambda x, _: x.absolute().rising(np.cosh)),
    ops.TANH: _Rule(np.tanh, lambda _, f: f.square().affine(-1.0, 1.0)),
    ops.ASINH: _Rule(np.arcsinh, _power_of_square(1.0, 1.0, -0.5)),
    ops.ACOSH: _Rule(
        np.arccosh, _power_of_square(1.0, -1.0, -0.5), (1.0, np.inf), f"the inverse hyperbolic cosine {_FALLS} 1"
    ),
    ops.ATANH: _Rule(
        np.arctanh, _power_of_square(-1.0, 1.0, -1.0), (-1.0, 1.0), f"the inverse hyperbolic tangent {_REACHES}"
    ),
}
# What is wrong where `_away` is not positive.
FAULTS = {
    **{op: rule.fault for op, rule in _RULES.items() if rule.fault},
    ops.POWER_CONSTANT: f"a power {_FALLS} zero",
    ops.INVERSE: "a quotient whose denominator vanishes",
    ops.TAN: "the tangent of an angle that reaches a quarter turn",
    ORIGIN: "the angle of a vector that vanishes",
}


def of_one(op: int, c: float, x: Interval) -> tuple[Interval, Interval]:
    """Bounds of the function `op` with constant c, and of its derivative."""
    if op in _RULES:
        rule = _RULES[op]
        x = x.clipped(*rule.domain)
        value = x.rising(rule.f)
        return value, rule.slope(x, value)
    if op == ops.SQUARE:
        return x.square(), x.affine(2.0)
    if op == ops.INVERSE:
        inverse = x.inverse()
        return inverse.affine(c), inverse.square().affine(-c)
    if op == ops.POWER_CONSTANT:
        return x.power(c), x.power(c - 1.0).affine(c)
    if op in (ops.SIN, ops.COS):
        behind, ahead = (x.affine(1.0, quarter).cosine() for quarter in (-0.5 * math.pi, 0.5 * math.pi))
        return (behind, x.cosine()) if op == ops.SIN else (x.cosine(), ahead)
    if op == ops.COSH:
        return x.absolute().rising(np.cosh), x.rising(np.sinh)
    # TAN
    value = x.rising(np.tan)
    pole = _away(op, 0.0, x, x) <= 0.0
    value = Interval(np.where(pole, -np.inf, value.lo), np.where(pole, np.inf, value.hi))
    return value, value.square().affine(1.0, 1.0)


def of_two(op: int, x: Interval, y: Interval) -> tuple[Interval, Interval, Interval]:
    """Bounds of the function `op`, and of its derivatives by x and y."""
    if op == ops.MULTIPLY:
        return x * y, y, x
    if op == ops.DIVIDE:
        inverse = y.inverse()
        value = x * inverse
        return value, inverse, (value * inverse).affine(-1.0)
    # ATAN2 is largest and least at corners, unless its cut is within
    corners = [np.arctan2(a, b) for a in (x.lo, x.hi) for b in (y.lo, y.hi)]
    cut = _away(ops.ATAN2, 0.0, x, y) <= 0.0
    value = Interval(
        np.where(cut, -math.pi, np.minimum.reduce(corners)), np.where(cut, math.pi, np.maximum.reduce(corners))
    )
    inverse = (x.square() + y.square()).inverse()
    return value, y * inverse, (x * inverse).affine(-1.0)


def _away(op: int, c: float, x: Interval, y: Interval) -> np.ndarray:
    """How far, at least, the arguments of `op` are from where it is not smooth; positive where it is."""
    if op == SIGN:
        return x.lo if c > 0.0 else -x.hi
    if op in _RULES:
        low, high = _RULES[op].domain
        return np.minimum(x.lo - low, high - x.hi) if high < np.inf else x.lo - low
    if op == ops.POWER_CONSTANT and c != round(c):
        # twice differentiable at zero from 2 on
        return np.where((x.lo == 0.0) & (c >= 2.0), np.finfo(float).tiny, x.lo)
    if op in (ops.INVERSE, ops.POWER_CONSTANT):
        return x.distance
    if op == ops.TAN:
        return x.cosine().distance
    if op == ops.ATAN2:
        return np.maximum(y.lo, x.distance)
    return np.maximum(x.distance, y.distance)  # ORIGIN


def is_risky(op: int, c: float) -> bool:
    """Whether there are arguments where the function `op` of one variable with constant c is not smooth."""
    if op == ops.POWER_CONSTANT:
        return c < 0.0 or c != round(c)
    return op in FAULTS


def is_end(op: int, c: float) -> bool:
    """Whether the function `op` with constant c has no value beyond where it is not smooth."""
    if op == ops.POWER_CONSTANT:
        return c != round(c)
    return op in _RULES and bool(_RULES[op].fault)


# A check: operation, nodes of its arguments (the same twice if it has one) and constant.
Check = tuple[int, int, int, float]


def values(
    nodes: Sequence[Node],
    order: Sequence[int],
    variables: str,
    points: np.ndarray,
    known: dict[int, Interval] | None = None,
) -> dict[int, Interval]:
    """The nodes of a graph at points (m, n), by their numbers; in `order` arguments come first, unless known."""
    nothing = Interval(*np.zeros((2, 0, len(points))))
    with np.errstate(all="ignore"):
        start = {index: (value, nothing) for index, value in (known or {}).items()}
        found = _enclosed(nodes, order, variables, Interval(points.T, points.T), nothing, start)
    return {index: value for index, (value, _) in found.items()}


def margins(
    nodes: Sequence[Node],
    order: Sequence[int],
    checks: Sequence[Check],
    variables: str,
    low: np.ndarray,
    high: np.ndarray,
    inside: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far a graph's functions are from where they are not smooth, on boxes.

    low, high, inside: (m, n) ends of the boxes and a point of each. Returns the least margins of all checks on the
    boxes (k, m), those at the points (k, m), NaN where the quantity is not finite, and bounds of the slopes of the
    checks' first and second arguments (k, m, n, 2, 2), low before high.
    """
    at_points = values(nodes, order, variables, inside)
    with np.errstate(all="ignore"):
        reach = Interval((low - inside).T, (high - inside).T)
        enclosed = _enclosed(nodes, order, variables, Interval(low.T, high.T), reach, {}, at_points)
        least = np.array([_away(op, c, enclosed[a][0], enclosed[b][0]) for op, a, b, c in checks])
        there = np.array([_away(op, c, at_points[a], at_points[b]) for op, a, b, c in checks])
    slopes = np.array(
        [[(enclosed[argument][1].lo, enclosed[argument][1].hi) for argument in check[1:3]] for check in checks]
    )
    return least, np.where(np.isfinite(there), there, np.nan), slopes.transpose(0, 4, 3, 1, 2)


def _enclosed(
    nodes: Sequence[Node],
    order: Sequence[int],
    variables: str,
    box: Interval,
    reach: Interval,
    out: dict[int, tuple[Interval, Interval]],
    at_points: dict[int, Interval] | None = None,
) -> dict[int, tuple[Interval, Interval]]:
    """Bounds (m,) of nodes over a box (n, m), and of their derivatives by as many variables as `reach` (n, m) has: how
    far the box goes from its point. Added to `out`.

    With the values at the points, bounds are sharpened by the mean value theorem: their excess is quadratic in the
    size of the box then.
    """
    for index in order:
        node = nodes[index]
        if node.op == ops.VARIABLE:
            i = variables.index(node.name)
            own = np.zeros(reach.lo.shape)
            own[i : i + 1] = 1.0
            out[index] = Interval(box.lo[i], box.hi[i]), Interval(own, own)
            continue
        x, x_slopes = out[node.x]
        if node.op == ops.AFFINE:
            value, slopes = x.affine(node.c, node.d), x_slopes.affine(node.c)
        elif node.op == ops.LINEAR:
            y, y_slopes = out[node.y]
            value = x.affine(node.c) + y.affine(node.d)
            slopes = x_slopes.affine(node.c) + y_slopes.affine(node.d)
        elif node.y >= 0:
            y, y_slopes = out[node.y]
            value, by_x, by_y = of_two(node.op, x, y)
            slopes = by_x * x_slopes + by_y * y_slopes
        else:
            value, slope = of_one(node.op, node.c, x)
            slopes = slope * x_slopes
        if at_points is not None:
            change = slopes * reach
            value = value.meets(at_points[index] + Interval(change.lo.sum(axis=0), change.hi.sum(axis=0)))
        out[index] = value, slopes
    return out
