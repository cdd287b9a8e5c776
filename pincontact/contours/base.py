"""What a contour is: a kind, a few numbers, and derivatives up to second order (Defs. 1-4).

A contour is a point, a curve f(u) or a surface f(u1, u2) in its own frame. The compiled kernels see it as one
row of a flat table: an integer kind, `SHAPE_SIZE` shape parameters and, for kinds with more data, a pool of
numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import ContourError

# Kinds. Closed-form kinds come first within each dimension; the values are the table's, not the user's.
POINT = 0
LINE, CIRCLE, ELLIPSE, HELIX, CYCLOID, FOURIER_CURVE, SPLINE_CURVE, TAPE_CURVE = range(10, 18)
PLANE, SPHERE, ELLIPSOID, CYLINDER, CONE, TORUS = range(30, 36)
REVOLUTION, HEIGHT_FIELD, SPLINE_SURFACE, TAPE_SURFACE = range(36, 40)

SHAPE_SIZE = 8

# Rows of the derivative array that every evaluation fills: f and its derivatives by u1, u2 and t.
F, F_1, F_2, F_11, F_12, F_22, F_T, F_1T, F_2T, F_TT = range(10)
DERIVATIVE_ROWS = 10


@dataclass(frozen=True, eq=False)
class Contour:
    """A shape that can touch another, in its own frame; units are metres and radians.

    kind:            row of the flat table (one of the constants above)
    dimension:       number of parameters k: 0 point, 1 curve, 2 surface
    shape:           up to SHAPE_SIZE numbers read by the kernels
    pool:            further numbers (coefficients, knots, instructions), possibly empty
    domain:          (low, high) of each parameter in the first chart; infinite where unbounded
    periodic:        whether each parameter wraps around its domain
    planar:          the curve lies in its frame's xy-plane (so it may form a planar pattern)
    time_dependent:  f depends on t explicitly
    size:            a characteristic length in m, infinite for planes and lines
    convex_side:     +1 if the material that this contour bounds is convex and lies on the side opposite to
                     e_3 (e_3 points out of a convex body), -1 if e_3 points into it, 0 if the shape does not
                     decide. For planar curves the normal is e_1 x k.
    """

    kind: int
    dimension: int
    shape: tuple[float, ...] = ()
    pool: np.ndarray = field(default_factory=lambda: np.zeros(0))
    domain: tuple[tuple[float, float], ...] = ()
    periodic: tuple[bool, ...] = ()
    planar: bool = False
    time_dependent: bool = False
    size: float = np.inf
    convex_side: int = 0

    def evaluate(self, u: Sequence[float] | float = (), t: float = 0.0, chart: int = 0) -> np.ndarray:
        """f and its derivatives at one parameter value.

        u: the k parameters of the given chart; t: time in s.
        Returns (10, 3): f, f_1, f_2, f_11, f_12, f_22, f_t, f_1t, f_2t, f_tt in the contour's frame.
        """
        from .table import evaluate_contour

        parameters = np.zeros(2)
        given = np.atleast_1d(np.asarray(u, dtype=float))
        if given.size != self.dimension:
            raise ContourError(f"{self.name} has {self.dimension} parameters, got {given.size}")
        parameters[: given.size] = given
        out = np.zeros((DERIVATIVE_ROWS, 3))
        evaluate_contour(
            self.kind, chart, self.shape_row(), self.pool, parameters[0], parameters[1], float(t), out
        )
        return out

    def point(self, u: Sequence[float] | float = (), t: float = 0.0, chart: int = 0) -> np.ndarray:
        """The point f(u, t), (3,), in the contour's frame."""
        return self.evaluate(u, t, chart)[F]

    def shape_row(self) -> np.ndarray:
        """The shape parameters padded to SHAPE_SIZE."""
        row = np.zeros(SHAPE_SIZE)
        row[: len(self.shape)] = self.shape
        return row

    @property
    def name(self) -> str:
        return type(self).__name__


def positive(owner: str, **lengths: Any) -> tuple[float, ...]:
    """The given lengths as floats, or a ContourError naming the one that is not positive and finite."""
    checked = []
    for name, value in lengths.items():
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise ContourError(f"{owner}: {name} must be a number, got {value!r}") from None
        if not (np.isfinite(number) and number > 0.0):
            raise ContourError(f"{owner}: {name} must be positive and finite, got {number}")
        checked.append(number)
    return tuple(checked)


def interval(owner: str, name: str, ends: Any) -> tuple[float, float]:
    """(low, high) as floats with low < high, either of which may be infinite, or a ContourError."""
    try:
        low, high = (float(end) for end in ends)
    except (TypeError, ValueError):
        raise ContourError(f"{owner}: {name} must be two numbers (low, high), got {ends!r}") from None
    if not low < high:
        raise ContourError(f"{owner}: {name} must have low < high, got ({low}, {high})")
    return low, high
