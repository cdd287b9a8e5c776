"""Adaptive piecewise Chebyshev fits of functions that cannot be traced."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import cache, reduce
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from ..errors import ContourError
from .formula import spread
from .piecewise import Direction, chebyshev_nodes, pack

# More pieces with a lower degree keep second derivatives better than fewer with a higher one.
_DEGREE = 12
_MOST_PIECES = {1: 4096, 2: 1024}
# Pieces narrower than this part of the domain are needed only where a second derivative jumps, or worse.
_NARROWEST = 1e-5
# The last two coefficients of a resolved piece, relative to the function's size: close to rounding.
_RESOLVED = 2e-15
# A fit is compared with the function at so many points, evenly spread, and at so many more in each piece. What is
# narrower than their distance may be missed in a function that cannot be looked into.
_CHECKED = {1: 2000, 2: 50 * 50}
_CHECKED_PER_PIECE = 4
# How far it may be off there, relative to the function's size: a resolved piece is at most a few times its last
# coefficients off.
_VERIFIED = 5e-14
# Neighbouring pieces differ in derivatives by what rounding and the coefficients left out make there: of this many
# times the last ones', all of one sign, since T_n and its derivatives are largest at the ends of a piece.
_JOINT = 10.0
# Value, first and second derivatives of T_0, T_1, ... at 1.
_ENDS = tuple(
    np.array([math.prod((n * n - k * k) / (2 * k + 1) for k in range(order)) for n in range(_DEGREE + 1)], dtype=float)
    for order in range(3)
)
# Where a function changes to another path closer to another such place than this part of the domain, no piece begins:
# second derivatives of short pieces are poor, and what happens there is seen at the points that are looked at.
_SHORTEST = 1e-3
# (low, high) of a piece along each direction.
Ends = tuple[tuple[float, float], ...]


class Fit(NamedTuple):
    """A fit and how good it is.

    pool:       as `piecewise` reads it
    error:      largest deviation from the function at points between the nodes, in the function's unit
    constants:  0 for each output that vanishes everywhere, else None
    """

    pool: np.ndarray
    error: float
    constants: tuple[float | None, ...]


def fit(
    owner: str,
    function: Callable[..., np.ndarray],
    domain: Sequence[tuple[float, float]],
    periodic: Sequence[bool],
    derivatives: Callable[..., np.ndarray] | None = None,
    time: bool = False,
    breaks: Sequence[Sequence[float]] = ((), ()),
    places: np.ndarray | None = None,
    cure: str = "",
) -> Fit:
    """Fit function(u) or function(u1, u2) -> (n,) over a finite domain, to rounding.

    derivatives: all first, then all second derivatives (i <= j) by the arguments, (2 or 5, n), fitted together
    with the values by least squares, so that second derivatives are as good as the ones given.
    time: the second argument is t.
    breaks: for each argument, where the function is known to change.  places: (k, 1 or 2) arguments to look at.
    cure: what messages about a function that is not smooth end with.
    Raises ContourError naming the place where refinement does not help, or where neighbouring pieces do not meet in
    value and two derivatives: a kink, a jump or noise.
    """
    n = len(domain)
    solve, nodes = _solver(n, derivatives is not None)
    lines = [_first_breaks(ends, known) for ends, known in zip(domain, breaks)]
    pieces: dict[Ends, np.ndarray] = {}
    seen: dict[tuple[float, ...], np.ndarray] = {}
    while True:
        boxes = _boxes(lines)
        for ends in boxes:
            if ends not in pieces:
                pieces[ends] = solve @ _data(function, derivatives, ends, nodes)
        scale = max(np.abs(piece).max() for piece in pieces.values())
        coefficients = _assembled(lines, pieces)
        split: list[set[int]] = [set() for _ in domain]
        worst = 0.0
        for axis in range(n):
            tails = np.abs(np.take(coefficients, (-2, -1), axis=2 * axis + 1))
            tails = tails.max(axis=tuple(k for k in range(2 * n + 1) if k % 2 or k == 2 * n))
            split[axis].update(np.nonzero(tails > _RESOLVED * scale)[axis].tolist())
            if tails.max() > worst:
                worst, place = tails.max(), np.mean(boxes[int(np.argmax(tails))], axis=1)
        if not any(split):
            # all pieces are resolved as far as their nodes can see
            points, at = _points(lines, boxes, places)
            arguments = [tuple(point) for point in points.tolist()]
            for point in arguments:
                if point not in seen:
                    seen[point] = function(*point)
            expected = np.array([seen[point] for point in arguments])
            off = np.abs(_values(lines, coefficients, points, at) - expected).max(axis=1)
            error = float(off.max())
            worst, place = error, points[int(np.argmax(off))]
            for axis in range(n):
                split[axis].update(at[~(off <= _VERIFIED * scale), axis].tolist())
        if not any(split):
            break
        narrow = any(b[i + 1] - b[i] < 2.0 * _NARROWEST * (b[-1] - b[0]) for b, s in zip(lines, split) for i in s)
        lines = [_refined(b, chosen) for b, chosen in zip(lines, split)]
        if narrow or math.prod(len(b) - 1 for b in lines) > _MOST_PIECES[n]:
            shown = ", ".join(f"{value:.6g}" for value in place)
            raise ContourError(
                f"{owner}: the function cannot be traced, and fitting it leaves an error of {worst:.1e} near "
                f"({shown}); it must be twice continuously differentiable and free of noise{cure}"
            )
    _check_joints(owner, lines, periodic, coefficients, scale, cure)
    directions = [Direction.chebyshev(b, _DEGREE, bool(p)) for b, p in zip(lines, periodic)]
    flat = coefficients.reshape(*(direction.functions for direction in directions), -1)
    constants = tuple(None if column.any() else 0.0 for column in np.moveaxis(flat, -1, 0))
    return Fit(pack(directions, flat, time=time), error, constants)


def _first_breaks(ends: tuple[float, float], known: Sequence[float]) -> np.ndarray:
    """Where the first pieces of one argument end."""
    low, high = ends
    far = np.array([low, *known, high])
    apart = np.diff(far) > _SHORTEST * (high - low)
    inner = far[1:-1][apart[:-1] & apart[1:]]
    return np.array([low, *inner, high]) if inner.size else np.linspace(low, high, 3)


def _boxes(lines: list[np.ndarray]) -> list[Ends]:
    """Ends of all pieces, the last argument running fastest."""
    return list(itertools.product(*(itertools.pairwise(b.tolist()) for b in lines)))


def _assembled(lines: list[np.ndarray], pieces: dict[Ends, np.ndarray]) -> np.ndarray:
    """Coefficients (pieces of the first argument, its polynomials, the same of the second one, components)."""
    n = len(lines)
    table = np.array([pieces[ends] for ends in _boxes(lines)])
    table = table.reshape(*(len(b) - 1 for b in lines), *[_DEGREE + 1] * n, -1)
    return table if n == 1 else np.moveaxis(table, 2, 1)


def _points(lines: list[np.ndarray], boxes: list[Ends], places: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Points (k, n) at which a fit is compared with its function, and the pieces that they are in."""
    n, ends = len(lines), np.array(boxes)
    points = [spread(np.array([b[0] for b in lines]), np.array([b[-1] for b in lines]), _CHECKED[n])]
    generator = np.random.default_rng(7)
    for _ in range(_CHECKED_PER_PIECE):
        points.append(generator.uniform(ends[..., 0], ends[..., 1]))
    if places is not None:
        points.append(places)
    every = np.concatenate(points)
    at = [np.clip(np.searchsorted(b, x, side="right") - 1, 0, len(b) - 2) for b, x in zip(lines, every.T)]
    return every, np.stack(at, axis=1)


def _values(lines: list[np.ndarray], coefficients: np.ndarray, points: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The fit at points of pieces, evaluated independently of the kernels."""
    tables = []
    for b, x, i in zip(lines, points.T, at.T):
        tables.append(chebyshev.chebvander((2.0 * x - b[i] - b[i + 1]) / (b[i + 1] - b[i]), _DEGREE))
    if len(lines) == 1:
        return np.einsum("km,kmc->kc", tables[0], coefficients[at[:, 0]])
    return np.einsum("km,kn,kmnc->kc", *tables, coefficients[at[:, 0], :, at[:, 1]], optimize=True)


def _check_joints(
    owner: str,
    lines: list[np.ndarray],
    periodic: Sequence[bool],
    coefficients: np.ndarray,
    scale: float,
    cure: str,
) -> None:
    """ContourError where neighbouring pieces do not meet in value, first and second derivative."""
    signs = (-1.0) ** np.arange(_DEGREE + 1)
    across = chebyshev.chebvander(chebyshev_nodes(_DEGREE), _DEGREE)
    for axis, b in enumerate(lines):
        # pieces and polynomials of this argument first
        table = np.moveaxis(coefficients, (2 * axis, 2 * axis + 1), (0, 1))
        if len(lines) == 2:
            table = np.einsum("mn,ijknc->ijkmc", across, table)
        lower = np.arange(len(b) - 1 if periodic[axis] else len(b) - 2)
        upper = (lower + 1) % (len(b) - 1)
        for order, ends in enumerate(_ENDS):
            scales = (2.0 / np.diff(b)) ** order
            before = np.tensordot(table, ends, axes=(1, 0))
            after = np.tensordot(table, ends * signs * (-1.0) ** order, axes=(1, 0))
            shape = (len(lower),) + (1,) * (before.ndim - 1)
            jumps = np.abs(before[lower] * scales[lower].reshape(shape) - after[upper] * scales[upper].reshape(shape))
            allowed = _JOINT * _RESOLVED * scale * ends[-1] * (scales[lower] + scales[upper])
            excess = jumps / allowed.reshape(shape)
            if (excess > 1.0).any():
                worst = np.unravel_index(int(np.argmax(excess)), excess.shape)
                i = int(worst[0])
                where = [b[i + 1]]
                if len(lines) == 2:
                    other = lines[1 - axis]
                    piece, node = worst[1], chebyshev_nodes(_DEGREE)[worst[2]]
                    where.insert(1 - axis, 0.5 * (other[piece] * (1.0 - node) + other[piece + 1] * (1.0 + node)))
                what = ("the function", "its first derivative", "its second derivative")[order]
                seam = "" if upper[i] else f" between the ends of parameter {axis}, which is periodic,"
                raise ContourError(
                    f"{owner}: {what} jumps by {float(jumps[worst]):.1e}{seam} near "
                    f"({', '.join(f'{x:.6g}' for x in where)}), where rounding makes {allowed[i]:.0e} at most; it must "
                    f"be twice continuously differentiable{cure}"
                )


def _refined(breaks: np.ndarray, chosen: set[int]) -> np.ndarray:
    middles = [0.5 * (breaks[i] + breaks[i + 1]) for i in sorted(chosen)]
    return np.sort(np.concatenate([breaks, middles]))


def _derivative_orders(n: int) -> list[tuple[int, ...]]:
    """Orders of the value, the first and the second derivatives along each of n directions."""
    orders = [order for order in itertools.product(range(2, -1, -1), repeat=n) if sum(order) <= 2]
    return sorted(orders, key=sum)


@cache
def _solver(n: int, with_derivatives: bool) -> tuple[np.ndarray, np.ndarray]:
    """Matrix from the data of one piece to its coefficients, and the nodes of the data in (-1, 1)."""
    nodes = chebyshev_nodes(_DEGREE)
    tables = [chebyshev.chebval(nodes, chebyshev.chebder(np.eye(_DEGREE + 1), order)).T for order in range(3)]
    rows = []
    for orders in _derivative_orders(n) if with_derivatives else [(0,) * n]:
        rows.append(_weight(sum(orders)) * reduce(np.kron, [tables[order] for order in orders]))
    return np.linalg.pinv(np.concatenate(rows), rcond=1e-14), nodes


def _weight(order: int) -> float:
    """Between equal weights, which cost values their last digit, and equal sizes, which cost second derivatives two.

    Derivatives of Chebyshev polynomials grow like degree^(2 order).
    """
    return float(_DEGREE) ** -order


def _data(
    function: Callable[..., np.ndarray],
    derivatives: Callable[..., np.ndarray] | None,
    ends: Ends,
    nodes: np.ndarray,
) -> np.ndarray:
    grids = [0.5 * (low + high) + 0.5 * (high - low) * nodes for low, high in ends]
    points = [tuple(map(float, point)) for point in itertools.product(*grids)]
    data = [np.array([function(*point) for point in points])]
    if derivatives is not None:
        given = np.array([derivatives(*point) for point in points])
        for i, orders in enumerate(_derivative_orders(len(ends))[1:]):
            scale = _weight(sum(orders))
            for (low, high), order in zip(ends, orders):
                scale *= (0.5 * (high - low)) ** order
            data.append(scale * given[:, i])
    return np.concatenate(data)
