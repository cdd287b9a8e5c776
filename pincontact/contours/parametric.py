"""Contours from a user's formula: curves f(u) or f(u, t), surfaces f(u1, u2) or f(u1, u2, t), height fields."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ContourError
from .base import ALL, F_1, F_2, Contour, F, half_diagonal
from .checks import flag, flags, interval, pair
from .formula import Formula, takes_time, trials
from .program import compiled
from .splines import height_grid, height_spline

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


class ParametricCurve(Contour):
    """A curve f(u) or f(u, t) -> (x, y, z) in m, t in s.

    f must be twice continuously differentiable inside its domain: a traced formula is searched for all operations that
    are not smooth everywhere (roots, quotients, angles, inverse functions), by bounds, so that nothing falls between
    samples. The search has its limits: parameters and times beyond 1e6, and formulas of several variables that are
    nearly rough in thousands of places. Branches are followed wherever they lead, and a fit begins a new piece where
    the function changes. Code that cannot be looked into is seen at samples only: there, what is narrower than 1/2000
    of a curve's domain (1/30 of each side of a surface's) may be missed.

    Parameters
    ----------
    f : callable
        Written with `math` or NumPy functions of numbers. It is traced into a tape once, so that no Python runs during
        a simulation and all derivatives are exact. A function that cannot be traced (it branches on u, or calls
        compiled code) is fitted to round-off instead; `fit_error` says in m how well.
    domain : (low, high)
        Ends of u; may be infinite if f can be traced.
    periodic : bool
        f repeats, whether or not its formula does: f(low) and f(high) are the same point, at all times, and so are the
        derivatives that the dynamics use, up to the second ones. This is checked.
    derivatives : callable, optional
        Same arguments -> (f_1, f_11), or (f_1, f_t, f_11, f_1t, f_tt) with time. Not needed; if given, compared with
        the traced ones, or fitted together with f.
    time_domain : (first, last), optional
        Time in s at which f(u, t) is used. Needed if it has to be fitted: beyond it the contour goes on with constant
        acceleration then. Also needed if f is smooth at these times only: it has no value at others then. Without it, f
        must be smooth at all times from 0 on where it has a value.

    Raises
    ------
    ContourError
        If f is not finite or not smooth, does not return three numbers, or is not what was traced.

    Examples
    --------
    >>> import math
    >>> import pincontact as pc
    >>> chain = pc.ParametricCurve(lambda u: (u, math.cosh(u), 0.0), domain=(-1.0, 1.0))
    >>> chain.evaluate(0.0)[[0, 1, 3]].tolist()  # f, f_1, f_11
    [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """

    def __init__(
        self,
        f: Callable[..., Any],
        domain: tuple[float, float],
        periodic: bool = False,
        derivatives: Callable[..., Any] | None = None,
        time_domain: tuple[float, float] | None = None,
    ) -> None:
        owner = "ParametricCurve"
        periodic = flag(owner, "periodic", periodic)
        checked = (interval(owner, "domain", domain),)
        super().__init__(**_traced(Formula(owner, f, 1), checked, (periodic,), derivatives, time_domain))


class ParametricSurface(Contour):
    """A surface f(u1, u2) or f(u1, u2, t) -> (x, y, z) in m, t in s; its normal is along f_1 x f_2.

    Parameters
    ----------
    f : callable
        As for `ParametricCurve`; with time it must be traceable.
    domain : ((low, high), (low, high))
        Ends of u1 and u2; may be infinite if f can be traced.
    periodic : pair of bool
        Which parameters wrap around.
    derivatives : callable, optional
        Same arguments -> (f_1, f_2, f_11, f_12, f_22), or with time
        (f_1, f_2, f_t, f_11, f_12, f_1t, f_22, f_2t, f_tt); not needed, see `ParametricCurve`.
    time_domain : (first, last), optional
        Time in s at which f is used, if it is smooth at these times only.

    Raises
    ------
    ContourError
        As `ParametricCurve` does.

    Examples
    --------
    >>> import pincontact as pc
    >>> saddle = pc.ParametricSurface(lambda u, v: (u, v, u * v), domain=((-1.0, 1.0), (-1.0, 1.0)))
    >>> saddle.point((0.5, 0.5)).tolist()
    [0.5, 0.5, 0.25]
    """

    def __init__(
        self,
        f: Callable[..., Any],
        domain: tuple[tuple[float, float], tuple[float, float]],
        periodic: tuple[bool, bool] = (False, False),
        derivatives: Callable[..., Any] | None = None,
        time_domain: tuple[float, float] | None = None,
    ) -> None:
        owner = "ParametricSurface"
        checked = _rectangle(owner, domain)
        wraps = flags(owner, "periodic", periodic)
        super().__init__(**_traced(Formula(owner, f, 2), checked, wraps, derivatives, time_domain))


class HeightField(Contour):
    """A surface over its frame's xy-plane, (x, y, z(x, y)), normal upwards: from a function or from a grid.

    Parameters
    ----------
    f : callable, or (n1,) array_like
        f(x, y) or f(x, y, t) -> z in m, traced or fitted as in `ParametricCurve`. Or the x of a grid, increasing, in m.
    y : (n2,) array_like, optional
        Of a grid, increasing, in m.
    z : (n1, n2) array_like, optional
        Heights of a grid in m; a spline through them is made.
    domain : ((low, high), (low, high)), optional
        Ends of x and y for a function; infinite if not given.
    degree : int
        Of the spline, at least 4.
    derivatives : callable, optional
        Of a function: same arguments -> (f_x, f_y, f_xx, f_xy, f_yy); not needed.
    time_domain : (first, last), optional
        As for `ParametricSurface`.

    Raises
    ------
    ContourError
        For what cannot be traced, fitted or interpolated.

    Examples
    --------
    >>> import numpy as np
    >>> import pincontact as pc
    >>> bowl = pc.HeightField(lambda x, y: 0.5 * (x * x + 2.0 * y * y))
    >>> bowl.point((1.0, 1.0)).tolist()
    [1.0, 1.0, 1.5]
    >>> x = np.linspace(-1.0, 1.0, 9)
    >>> pc.HeightField(x, x, np.outer(x, x)).domain
    ((-1.0, 1.0), (-1.0, 1.0))
    """

    def __init__(
        self,
        f: Callable[..., Any] | ArrayLike,
        y: ArrayLike | None = None,
        z: ArrayLike | None = None,
        *,
        domain: tuple[tuple[float, float], tuple[float, float]] | None = None,
        degree: int = 5,
        derivatives: Callable[..., Any] | None = None,
        time_domain: tuple[float, float] | None = None,
    ) -> None:
        owner = "HeightField"
        if callable(f):
            if y is not None or z is not None:
                raise ContourError(f"{owner}: give a function f (and domain=) or a grid x, y, z, not both")
            checked = (ALL, ALL) if domain is None else _rectangle(owner, domain)
            formula = Formula(owner, _lifted(f, takes_time(owner, f, 2)), 2)
            second = None if derivatives is None else _lifted_derivatives(derivatives)
            super().__init__(**_traced(formula, checked, (False, False), second, time_domain), lengths=True)
            return
        if y is None or z is None:
            raise ContourError(f"{owner}: a grid needs x, y and z")
        if domain is not None or derivatives is not None or time_domain is not None:
            raise ContourError(f"{owner}: domain, derivatives and time_domain go with a function, not with a grid")
        x, y, pool = height_grid(owner, f, y, z, degree)
        super().__init__(
            height_spline,
            2,
            pool=pool,
            domain=((float(x[0]), float(x[-1])), (float(y[0]), float(y[-1]))),
            lengths=True,
        )


def _lifted(f: Callable[..., Any], timed: bool) -> Callable[..., Any]:
    """The surface (x, y, f)."""
    if timed:
        return lambda x, y, t: (x, y, f(x, y, t))
    return lambda x, y: (x, y, f(x, y))


def _lifted_derivatives(derivatives: Callable[..., Any]) -> Callable[..., Any]:
    def lifted(*arguments: float) -> np.ndarray:
        heights = np.asarray(derivatives(*arguments), dtype=float).reshape(-1)
        rows = np.zeros((len(heights), 3))
        rows[0, 0] = rows[1, 1] = 1.0
        rows[:, 2] = heights
        return rows

    return lifted


def _rectangle(owner: str, domain: Any) -> tuple[tuple[float, float], ...]:
    first, second = pair(owner, "domain", domain, "(low, high)")
    return interval(owner, "domain[0]", first), interval(owner, "domain[1]", second)


def _traced(
    formula: Formula,
    domain: tuple[tuple[float, float], ...],
    periodic: tuple[bool, ...],
    derivatives: Callable[..., Any] | None,
    time_domain: Any,
) -> dict[str, Any]:
    """What `Contour` is to be given for a formula, which must have a tangent or a normal at some time."""
    owner, k = formula.owner, len(domain)
    times = None if time_domain is None else interval(owner, "time_domain", time_domain)
    program = compiled(formula, domain, periodic, derivatives, times)
    numbers = {
        "evaluator": program.evaluator,
        "dimension": k,
        "pool": program.pool,
        "domain": domain,
        "periodic": periodic,
        "time_dependent": program.time_dependent,
    }
    contour = Contour(**numbers, size=math.inf)
    points = trials([*domain, *program.times])
    rows = np.array([contour.evaluate(point[:k], *point[k:]) for point in points])
    size, first = np.abs(rows[:, F]).max(), rows[:, F_1]
    measure = first if k == 1 else np.cross(first, rows[:, F_2])
    # One singular point is a matter of taste; a shape that is singular everywhere is not a curve or surface.
    if not np.linalg.norm(measure, axis=1).max() > 1e-14 * min(size, 1.0):
        raise ContourError(f"{owner}: {'f_1' if k == 1 else 'f_1 x f_2'} vanishes all over the domain")
    # at the first of these times at which it is more than a point
    moments = (0.0, *(float(point[-1]) for point in points)) if program.times else (0.0,)
    numbers["size"] = next((size for size in (half_diagonal(contour, t) for t in moments) if size > 0.0), 0.0)
    numbers["planar"] = k == 1 and program.constants[2] == 0.0
    return {**numbers, "fit_error": program.error}
