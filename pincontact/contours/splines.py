"""Splines through points: curves, surfaces and height fields, at least three times differentiable."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from ..errors import ContourError
from .base import Contour
from .checks import array, flag, flags, in_space
from .evaluation import contour_kernel
from .piecewise import Direction, chebyshev_nodes, fitted, pack, piecewise
from .surfaces import put_plane

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# f has to be three times differentiable: the dynamics use f_11, and their integration one order more.
_SMOOTHNESS = 3


def spline(
    owner: str, parameters: np.ndarray, values: np.ndarray, degree: int, periodic: bool
) -> scipy.interpolate.BSpline:
    """The interpolating spline along the first axis; a periodic one repeats its first value at the end.

    Raises ContourError for parameters that do not increase, a degree below 4 or too few points.
    """
    if not isinstance(degree, (int, np.integer)) or degree <= _SMOOTHNESS:
        raise ContourError(f"{owner}: degree must be an integer of at least {_SMOOTHNESS + 1}, got {degree!r}")
    if len(parameters) <= degree:
        raise ContourError(
            f"{owner}: {len(parameters)} points are too few for degree {degree}, {degree + 1} are needed"
        )
    steps = np.diff(parameters)
    if not (steps > 0.0).all():
        i = int(np.argmin(steps))
        raise ContourError(
            f"{owner}: parameters must increase, but number {i + 1} is {parameters[i + 1]} after {parameters[i]}"
        )
    return scipy.interpolate.make_interp_spline(
        parameters, values, k=int(degree), bc_type="periodic" if periodic else None
    )


def chords(owner: str, points: np.ndarray) -> np.ndarray:
    """Chord lengths accumulated along points (n, d). Raises ContourError where two coincide."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if not (steps > 0.0).all():
        i = int(np.argmin(steps))
        raise ContourError(f"{owner}: points {i} and {i + 1} coincide at {points[i].tolist()}")
    return np.concatenate([[0.0], np.cumsum(steps)])


def spline_pool(curve: scipy.interpolate.BSpline, periodic: bool) -> np.ndarray:
    """The pool of a spline of one variable with values (n,), as polynomials on each of its intervals."""
    low, high = curve.t[curve.k], curve.t[-curve.k - 1]
    breaks = np.unique(curve.t[(curve.t >= low) & (curve.t <= high)])
    nodes = chebyshev_nodes(curve.k)
    inverse = np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, curve.k))
    points = 0.5 * (breaks[:-1] + breaks[1:])[:, None] + 0.5 * np.diff(breaks)[:, None] * nodes
    coefficients = np.einsum("mn,inc->imc", inverse, curve(points))
    direction = Direction.chebyshev(breaks, curve.k, periodic)
    return pack([direction], coefficients.reshape(direction.functions, -1))


class SplineCurve(Contour):
    """An interpolating spline through points, or a given B-spline.

    Parameters
    ----------
    points : (n, 3) or (n, 2) array_like, or scipy.interpolate.BSpline
        In m; with two columns the curve lies in the xy-plane. A B-spline of such values brings its own degree and
        parameters, and must be three times differentiable.
    periodic : bool
        Closed: the first point follows the last one (do not repeat it). For a B-spline: its ends meet, with three
        derivatives.
    degree : int
        At least 4; the curve is degree - 1 times differentiable.
    parameters : (n,) array_like, or (n + 1,) if periodic, optional
        Values of u at the points; chord lengths from the first point if not given, so that u is close to the arc
        length in m.

    Raises
    ------
    ContourError
        For too few, coincident or non-finite points and for splines less than three times differentiable.

    Examples
    --------
    >>> import numpy as np
    >>> import pincontact as pc
    >>> angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    >>> cam = pc.SplineCurve(np.c_[0.05 * np.cos(angle), 0.04 * np.sin(angle)], periodic=True)
    >>> cam.planar, cam.periodic, cam.convex_side
    (True, (True,), 1)
    """

    def __init__(
        self,
        points: ArrayLike | scipy.interpolate.BSpline,
        periodic: bool = False,
        degree: int = 5,
        parameters: ArrayLike | None = None,
    ) -> None:
        owner = "SplineCurve"
        periodic = flag(owner, "periodic", periodic)
        if isinstance(points, scipy.interpolate.BSpline):
            curve = _checked(owner, points, periodic)
        else:
            columns = 2 if np.ndim(points) == 2 and np.shape(points)[1] == 2 else 3
            through = in_space(array(owner, "points", points, None, columns))
            if periodic:
                through = np.concatenate([through, through[:1]])
            if parameters is None:
                u = chords(owner, through)
            else:
                u = array(owner, "parameters", parameters, len(through))
            curve = spline(owner, u, through, degree, periodic)
        super().__init__(
            fitted,
            1,
            pool=spline_pool(curve, periodic),
            domain=((float(curve.t[curve.k]), float(curve.t[-curve.k - 1])),),
            periodic=(periodic,),
            planar=not np.any(curve.c[:, 2]),
        )


def _checked(owner: str, curve: scipy.interpolate.BSpline, periodic: bool) -> scipy.interpolate.BSpline:
    """The given B-spline with three components, once it is known to be smooth enough."""
    values = np.asarray(curve.c, dtype=float)
    if values.ndim != 2 or values.shape[1] not in (2, 3):
        raise ContourError(f"{owner}: the B-spline must have 2 or 3 components, got values {values.shape[1:]}")
    knots = np.asarray(curve.t, dtype=float)
    low, high = knots[curve.k], knots[-curve.k - 1]
    inner, repeats = np.unique(knots[(knots > low) & (knots < high)], return_counts=True)
    least = int(curve.k - repeats.max()) if len(inner) else int(curve.k)
    if least < _SMOOTHNESS:
        raise ContourError(
            f"{owner}: the B-spline is {max(least, 0)} times differentiable at a knot, "
            f"{_SMOOTHNESS} are needed (degree {curve.k})"
        )
    result = scipy.interpolate.BSpline(knots, in_space(values), curve.k)
    if not np.isfinite(result.c).all() or not np.isfinite(knots).all():
        raise ContourError(f"{owner}: the B-spline has knots or coefficients that are not finite")
    if periodic:
        for order in range(_SMOOTHNESS + 1):
            ends = result(np.array([low, high]), nu=order)
            scale = np.abs(result(np.linspace(low, high, 50), nu=order)).max()
            # Looser than rounding: the coefficients of a closed spline come from a linear solve.
            if np.abs(ends[1] - ends[0]).max() > 1e-9 * scale:
                raise ContourError(
                    f"{owner}: periodic, but derivative {order} is {ends[0]} at one end and {ends[1]} at the other"
                )
    return result


class SplineSurface(Contour):
    """A tensor product of interpolating splines through a grid of points.

    Parameters
    ----------
    points : (n1, n2, 3) array_like
        In m. f_1 x f_2 is the outward normal, so the order of the grid's axes decides the side.
    periodic : pair of bool
        Which grid directions close (do not repeat the first row or column).
    degree : int
        At least 4.
    parameters : ((n1,) array_like, (n2,) array_like), optional
        Values of u1 and u2 at the grid lines, one more than lines where periodic; mean chord lengths if not given.

    Raises
    ------
    ContourError
        For too few, coincident or non-finite points.

    Examples
    --------
    >>> import numpy as np
    >>> import pincontact as pc
    >>> x, y = np.meshgrid(np.linspace(0.0, 1.0, 8), np.linspace(0.0, 1.0, 8), indexing="ij")
    >>> sheet = pc.SplineSurface(np.stack([x, y, 0.1 * x * y], axis=-1))
    >>> bool(abs(sheet.point((0.0, 0.0))).max() < 1e-12)
    True
    """

    def __init__(
        self,
        points: ArrayLike,
        periodic: tuple[bool, bool] = (False, False),
        degree: int = 5,
        parameters: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> None:
        owner = "SplineSurface"
        periodic = flags(owner, "periodic", periodic)
        grid = array(owner, "points", points, None, None, 3)
        lines = []
        for axis in range(2):
            if periodic[axis]:
                grid = np.concatenate([grid, np.take(grid, [0], axis=axis)], axis=axis)
        for axis in range(2):
            if parameters is None:
                steps = np.linalg.norm(np.diff(grid, axis=axis), axis=2).mean(axis=1 - axis)
                lines.append(np.concatenate([[0.0], np.cumsum(steps)]))
            else:
                name = f"parameters[{axis}]"
                lines.append(array(owner, name, parameters[axis], grid.shape[axis]))
        super().__init__(
            fitted,
            2,
            pool=_tensor_pool(owner, lines, grid, degree, periodic, first=0),
            domain=tuple((float(line[0]), float(line[-1])) for line in lines),
            periodic=periodic,
        )


def _tensor_pool(
    owner: str, lines: list[np.ndarray], grid: np.ndarray, degree: int, periodic: tuple[bool, bool], first: int
) -> np.ndarray:
    """Interpolation along one axis of (n1, n2, components) after the other."""
    along = spline(f"{owner} (first direction)", lines[0], grid, degree, periodic[0])
    across = spline(f"{owner} (second direction)", lines[1], np.swapaxes(along.c, 0, 1), degree, periodic[1])
    directions = [Direction.splines(s.t, s.k, bool(p)) for s, p in zip((along, across), periodic)]
    return pack(directions, np.swapaxes(across.c, 0, 1), first=first)


def height_grid(owner: str, x: Any, y: Any, z: Any, degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x (n1,), y (n2,) and the pool of the spline through z (n1, n2)."""
    x, y = array(owner, "x", x, None), array(owner, "y", y, None)
    heights = array(owner, "z", z, len(x), len(y))
    return x, y, _tensor_pool(owner, [x, y], heights[..., None], degree, (False, False), first=2)


@contour_kernel
def height_spline(chart, shape, pool, u1, u2, t, out):
    """(u1, u2, z), whose column z is a spline."""
    put_plane(out, u1, u2)
    piecewise(pool, u1, u2, t, out)
