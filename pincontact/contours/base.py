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

from ..arguments import NOT_REAL, is_number, real, real_array
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
    fit_error:       how far in m the contour is from the function it was fitted to, 0 where it is exact
    """

    kind: int
    dimension: int
    shape: tuple[float, ...] = ()
    pool: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)
    domain: tuple[tuple[float, float], ...] = ()
    periodic: tuple[bool, ...] = ()
    planar: bool = False
    time_dependent: bool = False
    size: float = np.inf
    convex_side: int = 0
    fit_error: float = 0.0

    def evaluate(self, u: Sequence[float] | float = (), t: float = 0.0, chart: int = 0) -> np.ndarray:
        """f and its derivatives at one parameter value.

        u: the k parameters of the given chart; t: time in s.
        Returns (10, 3): f, f_1, f_2, f_11, f_12, f_22, f_t, f_1t, f_2t, f_tt in the contour's frame; not finite
        where f is not differentiable. Raises ContourError for a wrong number of parameters or chart.
        """
        return self.evaluate_many(np.atleast_1d(np.asarray(u))[None], t, chart)[0]

    def evaluate_many(self, u: np.ndarray, t: float = 0.0, chart: int = 0) -> np.ndarray:
        """f and its derivatives at parameter values u (n, k): (n, 10, 3), otherwise as `evaluate`."""
        from .table import evaluate_contours

        try:
            # a contour without parameters has none of any type
            u, t = real_array(u) if np.size(u) else np.zeros(np.shape(u)), real(t)
        except NOT_REAL:
            raise ContourError(f"{self.name}: u and t must be real numbers, got {u!r} and {t!r}") from None
        if u.ndim != 2 or u.shape[1] != self.dimension:
            raise ContourError(f"{self.name} has {self.dimension} parameters, got {u.shape[-1]}")
        if not is_number(chart) or chart not in self.charts:
            raise ContourError(f"{self.name} has the charts {self.charts}, there is no number {chart}")
        parameters = np.zeros((len(u), 2))
        parameters[:, : self.dimension] = u
        out = np.zeros((len(u), DERIVATIVE_ROWS, 3))
        row, pool = self.shape_row(), self.pool
        try:
            evaluate_contours(self.kind, chart, row, pool, parameters, t, out)
        except (ArithmeticError, ValueError):
            # Without compilation Python raises where the kernels' arithmetic gives infinity or NaN.
            if len(u) == 1:
                out[:] = np.nan
            else:
                out = np.concatenate([self.evaluate_many(one[None], t, chart) for one in u])
        return out

    def point(self, u: Sequence[float] | float = (), t: float = 0.0, chart: int = 0) -> np.ndarray:
        """The point f(u, t), (3,), in the contour's frame."""
        return self.evaluate(u, t, chart)[F]

    def ends(self) -> np.ndarray:
        """(4,) low and high end of u1 and u2 at which the contour stops; infinite where it does not (periodic
        parameters, poles)."""
        out = np.array([-np.inf, np.inf, -np.inf, np.inf])
        for a in range(self.dimension):
            if not self.periodic[a] and not (self.kind in (SPHERE, ELLIPSOID) and a == 1):
                out[2 * a : 2 * a + 2] = self.domain[a]
        return out

    def shape_row(self) -> np.ndarray:
        """The shape parameters padded to SHAPE_SIZE."""
        row = np.zeros(SHAPE_SIZE)
        row[: len(self.shape)] = self.shape
        return row

    @property
    def name(self) -> str:
        return type(self).__name__

    @property
    def charts(self) -> tuple[int, ...]:
        """The numbers of its charts; domain and periodic are those of chart 0, which every contour has."""
        return (0, 1) if self.kind in (SPHERE, ELLIPSOID) else (0,)

    def samples(self, n: int | Sequence[int] = 50, window: Any = None) -> np.ndarray:
        """A grid of parameter values that covers the domain of the first chart.

        n:       values along each parameter, or one number for each; ends are included, except that a parameter
                 that wraps around has its end once
        window:  ((low, high) for each parameter); needed where the domain is infinite, and cut to the domain
        Returns (number of points, k), the last parameter running fastest.
        Raises ContourError for an infinite domain without a window.
        """
        axes = self._axes(n, window, closed=False)
        if not axes:
            return np.zeros((1, 0))
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)

    def polyline(self, n: int = 100, window: Any = None, t: float = 0.0) -> np.ndarray:
        """Points (n, 3) along a curve, both ends included, so that a closed curve ends where it starts.

        window: ((low, high),) as in `samples`. Raises ContourError for anything but a curve.
        """
        if self.dimension != 1:
            raise ContourError(f"{self.name} is not a curve: it has {self.dimension} parameters")
        (axis,) = self._axes(n, window, closed=True)
        return np.array([self.point(u, t) for u in axis])

    def mesh(self, n: int | Sequence[int] = 40, window: Any = None, t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (n1 n2, 3) and triangles (m, 3) of a surface, counter-clockwise seen from outside.

        Seams of parameters that wrap around are closed. window: as in `samples`.
        Raises ContourError for anything but a surface.
        """
        if self.dimension != 2:
            raise ContourError(f"{self.name} is not a surface: it has {self.dimension} parameters")
        axes = self._axes(n, window, closed=False)
        vertices = np.array([self.point((a, b), t) for a in axes[0] for b in axes[1]])
        n1, n2 = len(axes[0]), len(axes[1])
        first = np.arange(n1 if self._wraps(0, window) else n1 - 1)
        second = np.arange(n2 if self._wraps(1, window) else n2 - 1)
        i, j = (grid.ravel() for grid in np.meshgrid(first, second, indexing="ij"))
        a, b = i * n2 + j, (i + 1) % n1 * n2 + j
        c, d = i * n2 + (j + 1) % n2, (i + 1) % n1 * n2 + (j + 1) % n2
        return vertices, np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])

    def _wraps(self, axis: int, window: Any) -> bool:
        return self.periodic[axis] and (window is None or window[axis] is None)

    def _axes(self, n: int | Sequence[int], window: Any, closed: bool) -> list[np.ndarray]:
        counts = list(n) if isinstance(n, (Sequence, np.ndarray)) else [n] * self.dimension
        whole = all(isinstance(count, (int, np.integer)) for count in counts)
        if not whole or len(counts) != self.dimension or any(count < 2 for count in counts):
            raise ContourError(f"{self.name}: at least 2 values are needed along each parameter, got {n!r}")
        if window is not None and not (isinstance(window, (Sequence, np.ndarray)) and len(window) == self.dimension):
            raise ContourError(f"{self.name}: window must have {self.dimension} entries, got {window!r}")
        axes = []
        for i, (count, (low, high)) in enumerate(zip(counts, self.domain)):
            if window is not None and window[i] is not None:
                start, end = interval(self.name, f"window[{i}]", window[i])
                low, high = (start, end) if self.periodic[i] else (max(low, start), min(high, end))
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise ContourError(
                    f"{self.name}: parameter {i} runs over ({low}, {high}); a window within its domain is needed"
                )
            wraps = self._wraps(i, window) and not closed
            axes.append(np.linspace(low, high, count, endpoint=not wraps))
        return axes


def positive(owner: str, **lengths: Any) -> tuple[float, ...]:
    """The given lengths as floats, or a ContourError naming the one that is not positive and finite."""
    checked = finite(owner, **lengths)
    for name, number in zip(lengths, checked):
        if not number > 0.0:
            raise ContourError(f"{owner}: {name} must be positive and finite, got {number}")
    return checked


def finite(owner: str, **numbers: Any) -> tuple[float, ...]:
    """The given numbers as floats, or a ContourError naming the one that is not finite."""
    checked = []
    for name, value in numbers.items():
        try:
            number = real(value)
        except NOT_REAL:
            raise ContourError(f"{owner}: {name} must be a number, got {value!r}") from None
        if not np.isfinite(number):
            raise ContourError(f"{owner}: {name} must be finite, got {number}")
        checked.append(number)
    return tuple(checked)


def interval(owner: str, name: str, ends: Any) -> tuple[float, float]:
    """(low, high) as floats with low < high, either of which may be infinite, or a ContourError."""
    try:
        low, high = (real(end) for end in ends)
    except NOT_REAL:
        raise ContourError(f"{owner}: {name} must be two numbers (low, high), got {ends!r}") from None
    if not low < high:
        raise ContourError(f"{owner}: {name} must have low < high, got ({low}, {high})")
    return low, high


def flag(owner: str, name: str, value: Any) -> bool:
    """True or False, or a ContourError."""
    if isinstance(value, (bool, np.bool_)) or (isinstance(value, (int, np.integer)) and value in (0, 1)):
        return bool(value)
    raise ContourError(f"{owner}: {name} must be True or False, got {value!r}")


def flags(owner: str, name: str, values: Any) -> tuple[bool, bool]:
    """Two of them, one for each parameter of a surface, or a ContourError."""
    if isinstance(values, (str, bytes)) or not isinstance(values, (Sequence, np.ndarray)) or len(values) != 2:
        raise ContourError(f"{owner}: {name} must be a pair of booleans, got {values!r}")
    return flag(owner, f"{name}[0]", values[0]), flag(owner, f"{name}[1]", values[1])


def in_space(values: np.ndarray) -> np.ndarray:
    """Rows (x, y) or (x, y, z) as (n, 3), with z = 0 where they have none."""
    out = np.zeros((len(values), 3))
    out[:, : values.shape[1]] = values
    return out


def half_diagonal(contour: Contour, t: float = 0.0) -> float:
    """Half the diagonal of the box around a contour of finite domain, else infinity."""
    if not np.isfinite(contour.domain).all():
        return np.inf
    points = np.array([contour.point(u, t) for u in contour.samples(12 if contour.dimension == 2 else 64)])
    return 0.5 * float(np.linalg.norm(np.ptp(points, axis=0)))


def turning(contour: Contour) -> int:
    """`convex_side` of a curve: the sense in which it runs around a convex region, 0 if it does not.

    A closed planar curve is convex if its curvature keeps one sign and its tangent turns around once.
    """
    if not (contour.planar and contour.periodic[0]) or contour.time_dependent:
        return 0
    low, high = contour.domain[0]
    n = 720
    rows = np.array([contour.evaluate(u) for u in np.linspace(low, high, n, endpoint=False)])
    first, second = rows[:, F_1], rows[:, F_11]
    bend = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    speed = first[:, 0] ** 2 + first[:, 1] ** 2
    if not (speed > 0.0).all() or (bend.min() < 0.0 < bend.max()):
        return 0
    turns = (high - low) / n * float((bend / speed).sum()) / (2.0 * np.pi)
    # The sum is exponentially accurate for smooth curves; a whole number of turns is all that matters here.
    whole = round(turns)
    return whole if abs(whole) == 1 else 0
