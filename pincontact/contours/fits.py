"""Adaptive piecewise Chebyshev fits of functions that cannot be traced."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.polynomial import chebyshev

from ..errors import ContourError
from .piecewise import Direction, chebyshev_nodes, pack

# More pieces with a lower degree keep second derivatives better than fewer with a higher one.
_DEGREE = 12
_MOST_PIECES = {1: 4096, 2: 1024}
# Pieces narrower than this part of the domain are needed only where a second derivative jumps, or worse.
_NARROWEST = 1e-5
# The last two coefficients of a resolved piece, relative to the function's size: close to rounding.
_RESOLVED = 2e-15


class Fit:
    """A fit and how good it is.

    pool:   as `piecewise` reads it
    error:  largest deviation from the function at points between the nodes, in the function's unit
    """

    def __init__(self, pool: np.ndarray, error: float) -> None:
        self.pool = pool
        self.error = error


def fit(
    owner: str,
    function: Callable[..., np.ndarray],
    domain: Sequence[tuple[float, float]],
    periodic: Sequence[bool],
    derivatives: Callable[..., np.ndarray] | None = None,
    time: bool = False,
) -> Fit:
    """Fit function(u) or function(u1, u2) -> (n,) over a finite domain, to rounding.

    derivatives: all first, then all second derivatives (i <= j) by the arguments, (2 or 5, n), fitted together
    with the values by least squares, so that second derivatives are as good as the ones given.
    time: the second argument is t.
    Raises ContourError naming the place where refinement does not help: a kink, a jump or noise.
    """
    dimension = len(domain)
    solve, nodes = _solver(dimension, derivatives is not None)
    breaks = [np.linspace(low, high, 3) for low, high in domain]
    pieces: dict[tuple[float, ...], np.ndarray] = {}
    while True:
        boxes = list(itertools.product(*(range(len(b) - 1) for b in breaks)))
        split: list[set[int]] = [set() for _ in domain]
        worst = 0.0
        for box in boxes:
            ends = [(b[i], b[i + 1]) for b, i in zip(breaks, box)]
            key = tuple(itertools.chain(*ends))
            if key not in pieces:
                pieces[key] = solve @ _data(function, derivatives, ends, nodes)
        scale = max(np.abs(piece).max() for piece in pieces.values())
        for box in boxes:
            ends = [(b[i], b[i + 1]) for b, i in zip(breaks, box)]
            piece = pieces[tuple(itertools.chain(*ends))].reshape((*[_DEGREE + 1] * dimension, -1))
            for axis in range(dimension):
                tail = np.abs(np.take(piece, (-2, -1), axis=axis)).max()
                if tail > _RESOLVED * scale:
                    split[axis].add(box[axis])
                    if tail > worst:
                        worst, place = tail, [0.5 * (low + high) for low, high in ends]
        if not any(split):
            break
        refined = [_refined(b, chosen) for b, chosen in zip(breaks, split)]
        count = math.prod(len(b) - 1 for b in refined)
        narrow = any(np.diff(b).min() < _NARROWEST * (b[-1] - b[0]) for b in refined)
        if narrow or count > _MOST_PIECES[dimension]:
            shown = ", ".join(f"{value:.6g}" for value in place)
            raise ContourError(
                f"{owner}: the function cannot be traced, and fitting it leaves an error of {worst:.1e} near "
                f"({shown}); it must be twice differentiable and free of noise"
            )
        breaks = refined
    directions = [Direction.chebyshev(b, _DEGREE, bool(p)) for b, p in zip(breaks, periodic)]
    shape = tuple(direction.functions for direction in directions)
    coefficients: np.ndarray | None = None
    for box in boxes:
        ends = [(b[i], b[i + 1]) for b, i in zip(breaks, box)]
        block: np.ndarray = pieces[tuple(itertools.chain(*ends))].reshape((*[_DEGREE + 1] * dimension, -1))
        if coefficients is None:
            coefficients = np.empty((*shape, block.shape[-1]))
        coefficients[tuple(slice(i * (_DEGREE + 1), (i + 1) * (_DEGREE + 1)) for i in box)] = block
    assert coefficients is not None
    error = _deviation(function, breaks, directions, coefficients)
    return Fit(pack(directions, coefficients, time=time), error)


def _refined(breaks: np.ndarray, chosen: set[int]) -> np.ndarray:
    middles = [0.5 * (breaks[i] + breaks[i + 1]) for i in sorted(chosen)]
    return np.sort(np.concatenate([breaks, middles]))


def _derivative_orders(dimension: int) -> list[tuple[int, ...]]:
    """Orders of the value, the first and the second derivatives along each direction."""
    if dimension == 1:
        return [(0,), (1,), (2,)]
    return [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]


def _solver(dimension: int, with_derivatives: bool) -> tuple[np.ndarray, np.ndarray]:
    """Matrix from the data of one piece to its coefficients, and the nodes of the data in (-1, 1)."""
    nodes = chebyshev_nodes(_DEGREE)
    identity = np.eye(_DEGREE + 1)
    tables = [
        np.stack([chebyshev.chebval(nodes, chebyshev.chebder(c, order) if order else c) for c in identity], axis=1)
        for order in range(3)
    ]
    rows = []
    for orders in _derivative_orders(dimension) if with_derivatives else [(0,) * dimension]:
        block = np.ones((1, 1))
        for order in orders:
            block = np.kron(block, tables[order])
        rows.append(_weight(sum(orders)) * block)
    return np.linalg.pinv(np.concatenate(rows), rcond=1e-14), nodes


def _weight(order: int) -> float:
    """Between equal weights, which cost values their last digit, and equal sizes, which cost second derivatives two.

    Derivatives of Chebyshev polynomials grow like degree^(2 order).
    """
    return float(_DEGREE) ** -order


def _data(
    function: Callable[..., np.ndarray],
    derivatives: Callable[..., np.ndarray] | None,
    ends: list[tuple[float, float]],
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


def _deviation(
    function: Callable[..., np.ndarray], breaks: list[np.ndarray], directions: list[Direction], coefficients: np.ndarray
) -> float:
    """Largest deviation at random points, evaluated independently of the kernels."""
    generator = np.random.default_rng(7)
    worst = 0.0
    for _ in range(200):
        piece = coefficients
        point = []
        for b, direction in zip(breaks, directions):
            i = int(generator.integers(len(b) - 1))
            x = generator.uniform(-1.0, 1.0)
            point.append(float(0.5 * (b[i] + b[i + 1]) + 0.5 * (b[i + 1] - b[i]) * x))
            start = direction.starts[i]
            values = chebyshev.chebvander(x, direction.degree).ravel()
            piece = np.tensordot(values, piece[start : start + direction.degree + 1], axes=1)
        worst = max(worst, float(np.abs(piece - function(*point)).max()))
    return worst
