"""Bounds of how sharply traced contours bend, all over their domains, by interval arithmetic on their tapes.

What a tape does to values and derivatives is done to intervals of these, over boxes of the parameters; where bounds are
too wide, boxes are divided.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from . import tape as ops
from .base import Contour
from .enclosures import Interval, of_one, of_two

# Boxes that are divided, and how often, before it is given up.
_MOST_BOXES, _DIVISIONS = 1024, 40
# What decides between equals only.
_TIE = 1e-3
# By how much farther out boxes without an end are divided than they begin.
_OUTWARDS = 8.0


class Jet(NamedTuple):
    """Bounds (m,) of a quantity on m boxes of n variables, (n, m) and (n, n, m) of its first and second derivatives."""

    value: Interval
    first: Interval
    second: Interval


def bends_less(contour: Contour, side: int, limit: float) -> bool:
    """Whether a curve in its frame's plane, or a surface, bends towards the given side of its normal by less than the
    limit, in 1/m, everywhere; not where that is not found out, or it is no traced contour that does not change."""
    if contour.evaluator is not ops.traced or contour.time_dependent:
        return False
    low, high = np.array([contour.domain]).transpose(2, 0, 1)
    looked_at = 0
    for _ in range(_DIVISIONS):
        looked_at += len(low)
        middle = _middles(low, high)
        if looked_at > _MOST_BOXES or not (_bends(contour, side, middle, middle) < limit).all():
            return False
        # each is divided along the parameter by which more is known of its halves, or else along the longer one
        halves = [_halves(low, middle, high, a) for a in range(contour.dimension)]
        bounds = np.array([[_bends(contour, side, *half) for half in pair] for pair in halves])
        wide, worst, lengths = ~(bounds < limit), bounds.max(axis=1), (np.arctan(high) - np.arctan(low)).T
        with np.errstate(invalid="ignore"):
            left_over = np.nan_to_num(worst / worst.max(axis=0), nan=1.0) - _TIE * lengths / lengths.max(axis=0)
        along = np.argmin(wide.sum(axis=1) + _TIE * left_over, axis=0)
        left = [(*half, wide[a, i] & (along == a)) for a, pair in enumerate(halves) for i, half in enumerate(pair)]
        low = np.concatenate([ends[kept] for ends, _, kept in left])
        high = np.concatenate([ends[kept] for _, ends, kept in left])
        if len(low) == 0:
            return True
    return False


def _middles(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Where boxes (m, k) are divided: those without an end, at zero or farther out than they begin."""
    upwards, downwards = np.maximum(_OUTWARDS * low + 1.0, 0.0), np.minimum(_OUTWARDS * high - 1.0, 0.0)
    ends = np.where(np.isfinite(low), upwards, downwards)
    with np.errstate(invalid="ignore"):
        halves = 0.5 * (low + high)
    return np.where(np.isfinite(low) & np.isfinite(high), halves, np.where(np.isfinite(ends), ends, 0.0))


def _halves(low: np.ndarray, middle: np.ndarray, high: np.ndarray, a: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Both halves of boxes (m, k), divided along parameter a."""
    first, last = high.copy(), low.copy()
    first[:, a] = last[:, a] = middle[:, a]
    return [(low, first), (last, high)]


def _bends(contour: Contour, side: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Upper bounds (m,) of the normal curvature towards that side on boxes (m, k)."""
    with np.errstate(all="ignore"):
        return _bent(contour, side, low, high)


def _bent(contour: Contour, side: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    parts = enclosed(contour.pool, Interval(low.T, high.T))

    def dot(a: list[Interval], b: list[Interval]) -> Interval:
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

    def cross(a: list[Interval], b: list[Interval]) -> list[Interval]:
        pairs = ((1, 2), (2, 0), (0, 1))
        return [a[i] * b[j] + (a[j] * b[i]).affine(-1.0) for i, j in pairs]

    def first(i: int) -> list[Interval]:
        return [Interval(part.first.lo[i], part.first.hi[i]) for part in parts]

    def second(i: int, j: int) -> list[Interval]:
        return [Interval(part.second.lo[i, j], part.second.hi[i, j]) for part in parts]

    def length(vector: list[Interval]) -> np.ndarray:
        return np.sqrt(sum(part.square().lo for part in vector))

    if contour.dimension == 1:
        (x, y, _), (xx, yy, _) = first(0), second(0, 0)
        bent = (xx * y + (yy * x).affine(-1.0)).affine(float(side))
        return np.maximum(bent.hi, 0.0) / length(first(0)) ** 3
    normal = cross(first(0), first(1))
    one, mixed, two = (dot(second(i, j), normal).affine(float(side)) for i, j in ((0, 0), (0, 1), (1, 1)))
    half = (one + two.affine(-1.0)).magnitude
    bent = 0.5 * (one.hi + two.hi + np.hypot(half, 2.0 * mixed.magnitude))
    if contour.lengths:
        # over its frame's plane nothing is shorter than there
        return np.maximum(bent, 0.0)
    e, f, g = dot(first(0), first(0)), dot(first(0), first(1)), dot(first(1), first(1))
    # the least eigenvalue of the metric
    least = 0.5 * (e.lo + g.lo - np.hypot((e + g.affine(-1.0)).magnitude, 2.0 * f.magnitude))
    return np.where(least > 0.0, np.maximum(bent, 0.0) / (least * length(normal)), np.inf)


def enclosed(pool: np.ndarray, box: Interval) -> list[Jet]:
    """The tape's outputs over boxes (n, m) of its variables."""
    count, n, width, scratch, outputs = (int(number) for number in pool[: ops.RESULTS])
    m = box.lo.shape[1]

    def constant(shape: tuple[int, ...], number: float = 0.0) -> Interval:
        return Interval(*np.full((2, *shape, m), number))

    slots: list[Jet] = []
    for i in range(n):
        own = constant((n,))
        own.lo[i] = own.hi[i] = 1.0
        slots.append(Jet(Interval(box.lo[i], box.hi[i]), own, constant((n, n))))
    for k in range(count):
        at = ops.INSTRUCTIONS + ops.INSTRUCTION_SIZE * k
        op, a, b, c, d = pool[at : at + ops.INSTRUCTION_SIZE].tolist()
        x, y = (slots[(int(offset) - scratch) // width] for offset in (a, b or scratch))
        if op == ops.LINEAR:
            slots.append(Jet(*(p.affine(c) + q.affine(d) for p, q in zip(x, y))))
        elif op == ops.AFFINE:
            slots.append(Jet(x.value.affine(c, d), x.first.affine(c), x.second.affine(c)))
        elif op == ops.SINCOS:
            slots += [_chain(ops.SIN, c, x), _chain(ops.COS, c, x)]
        else:
            slots.append(_chain(int(op), c, x) if op >= ops.SQUARE else _chain_two(int(op), x, y))
    found = []
    for i in range(outputs):
        offset, number = pool[ops.RESULTS + 2 * i : ops.RESULTS + 2 * i + 2].tolist()
        known = slots[(int(offset) - scratch) // width] if offset >= 0.0 else None
        found.append(known or Jet(constant((), number), constant((n,)), constant((n, n))))
    return found


def _chain(op: int, c: float, x: Jet) -> Jet:
    """A function of one variable."""
    f, f_x = of_one(op, c, x.value)
    f_xx = _second(op, c, x.value, f, f_x)
    return Jet(f, f_x * x.first, f_x * x.second + f_xx * _outer(x.first, x.first))


def _chain_two(op: int, x: Jet, y: Jet) -> Jet:
    """A function of two variables."""
    f, f_x, f_y = of_two(op, x.value, y.value)
    second = f_x * x.second + f_y * y.second
    mixed = _outer(x.first, y.first)
    mixed = mixed + Interval(mixed.lo.swapaxes(0, 1), mixed.hi.swapaxes(0, 1))
    if op == ops.MULTIPLY:
        return Jet(f, f_x * x.first + f_y * y.first, second + mixed)
    if op == ops.DIVIDE:
        f_xy, f_xx = f_x.square().affine(-1.0), Interval(*np.zeros((2, 1)))
        f_yy = (f_y * f_x).affine(-2.0)
    else:  # ATAN2
        f_xx = (f_x * f_y).affine(2.0)
        f_xy, f_yy = f_y.square() + f_x.square().affine(-1.0), f_xx.affine(-1.0)
    squares = f_xx * _outer(x.first, x.first) + f_yy * _outer(y.first, y.first)
    return Jet(f, f_x * x.first + f_y * y.first, second + f_xy * mixed + squares)


def _outer(a: Interval, b: Interval) -> Interval:
    """Products (n, n, m) of (n, m)."""
    product = Interval(a.lo[:, None], a.hi[:, None]) * Interval(b.lo[None], b.hi[None])
    if a is b:
        i = np.arange(len(a.lo))
        square = a.square()
        product.lo[i, i], product.hi[i, i] = square.lo, square.hi
    return product


def _second(op: int, c: float, x: Interval, f: Interval, f_x: Interval) -> Interval:
    """The second derivative of the function `op`, from its argument, value and first derivative."""
    if op == ops.SQUARE:
        return Interval(*np.full((2, *x.lo.shape), 2.0))
    if op == ops.POWER_CONSTANT:
        return x.power(c - 2.0).affine(c * (c - 1.0))
    if op in (ops.SIN, ops.COS, ops.EXP, ops.SINH, ops.COSH):
        return f.affine(-1.0 if op in (ops.SIN, ops.COS) else 1.0)
    if op == ops.EXPM1:
        return f_x
    if op in (ops.LOG, ops.LOG1P):
        return f_x.square().affine(-1.0)
    if op in (ops.TAN, ops.TANH):
        return (f * f_x).affine(2.0 if op == ops.TAN else -2.0)
    if op in (ops.ATAN, ops.ATANH):
        return (x * f_x.square()).affine(-2.0 if op == ops.ATAN else 2.0)
    if op in (ops.ASIN, ops.ASINH, ops.ACOSH):
        return (x * f_x.power(3.0)).affine(1.0 if op == ops.ASIN else -1.0)
    if op == ops.SQRT:
        return (f_x * x.inverse()).affine(-0.5)
    return (f_x * x.inverse()).affine(-2.0)  # INVERSE
