"""Surfaces of revolution, smooth where the profile meets the axis.

Away from the axis (chart 0) f = (r(s) cos u1, h r(s) sin u1, z(s)), s = u2, h = 1 or -1 so that f_1 x f_2 points
outwards. A profile that meets the axis at s = e smoothly has r odd and z even in the distance d = |s - e|, so that
r = d g(d^2) and z = k(d^2) with smooth g and k, and the cap chart f = (u1 g, +-u2 g, k) with d^2 = u1^2 + u2^2 is
smooth at the pole. Near the pole g and k are Chebyshev fits in d^2; beyond it they come from the profile itself.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import chebyshev

from ..errors import ContourError
from ..jit import kernel
from .base import ALL, F_1, F_11, REVOLUTION, TURN, Contour, F
from .charts import ENDS, HAND, TRACED
from .checks import array, flag, interval
from .evaluation import contour_kernel
from .formula import Formula
from .piecewise import Direction, chebyshev_nodes, fitted, pack, piecewise
from .program import compiled
from .splines import chords, spline, spline_pool
from .surfaces import put_revolved
from .tape import tape, traced

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Pool: offset of (g, k) at both ends, the d^2 up to which they hold, then the profile.
_CAPS, _REACHES, _PROFILE = 0, 2, 4


# A profile whose end is nearer to the axis than this part of its size meets it: rounding of the user's sines.
_ON_AXIS = 1e-12
# It meets it tangentially where r grows by less than this part of its size over the cap, and in an apex where its slope
# dz/dr is larger than this.
_TANGENTIAL, _APEX = 1e-6, 1e-9
# A body with less than this part of the volume that its profile could bound is a disk, which has no outside. A surface
# is convex if its curvatures are, up to this part of the largest.
_FLAT, _BENT = 1e-6, 1e-12
# The cap chart is entered this part of the profile away from the pole, and left at LEAVE_FACTOR times that.
_ENTER = 0.25
_LEAVE_FACTOR = 1.6
# Degree in d^2 of the fits at a pole, and where they may end, as parts of the distance at which the cap is entered.
_CAP_DEGREE = 12
_CAP_REACHES = (0.8, 0.4, 0.2, 0.1)
# A smooth profile is fitted to rounding; one with the wrong parity misses by many orders more.
_CAP_ERROR = 1e-12
_CAP_ROUNDING = 1e-15
# Second derivatives of a fit are worst at its end, so that part is left to the profile.
_CAP_KEPT = 0.8
_PROFILE_SAMPLES = 400
# Of splines through points; an even one where there are poles, whose knots lie between the points, none at a pole.
_DEGREE, _POLAR_DEGREE = 5, 6


class SurfaceOfRevolution(Contour):
    """A profile (r, z) turned about the z axis: f = (r(u2) cos u1, +-r(u2) sin u1, z(u2)).

    The sign is such that f_1 x f_2 points out of the body between the profile and the axis (up for a flat disk).
    Where the profile meets the axis, at an end, it must be smooth as a surface (r odd, z even in the distance from
    the end, both parameters such as arc length or an angle); charts 1 and 2 cover those poles.

    Parameters
    ----------
    profile : callable s -> (r, z), or (n, 2) array_like
        In m. A function is traced or fitted as in `ParametricCurve`; points are joined by a spline that also passes the
        axis smoothly where its first or last point has r = 0.
    domain : (low, high), optional
        Ends of s, finite; for a function only.
    periodic : bool
        The profile closes (away from the axis).

    Raises
    ------
    ContourError
        For a profile that crosses the axis, or meets it with an edge or an apex.

    Examples
    --------
    >>> import math
    >>> import pincontact as pc
    >>> egg = pc.SurfaceOfRevolution(lambda s: (0.1 * math.cos(s), 0.14 * math.sin(s)), (-math.pi / 2, math.pi / 2))
    >>> egg.charts, egg.convex_side, egg.point((0.0, 0.0)).tolist()
    ((0, 1, 2), 1, [0.1, 0.0, 0.0])
    """

    def __init__(
        self,
        profile: Callable[[float], Sequence[Any]] | ArrayLike,
        domain: tuple[float, float] | None = None,
        periodic: bool = False,
    ) -> None:
        owner = "SurfaceOfRevolution"
        periodic = flag(owner, "periodic", periodic)
        reaches = None
        if callable(profile):
            if domain is None:
                raise ContourError(f"{owner}: a callable profile needs its domain")
            low, high = interval(owner, "domain", domain)
            if not (math.isfinite(low) and math.isfinite(high)):
                raise ContourError(f"{owner}: domain must be finite, got ({low}, {high})")
            program = compiled(_profile_formula(owner, profile), ((low, high),), (periodic,))
            evaluator, pool, error = program.evaluator, program.pool, program.error
        else:
            if domain is not None:
                raise ContourError(f"{owner}: domain goes with a callable profile, not with points")
            pool, (low, high), reaches = _spline_profile(owner, profile, periodic)
            evaluator, error = fitted, 0.0
        curve = Contour(evaluator, 1, pool=pool, size=math.inf)
        samples = np.linspace(low, high, _PROFILE_SAMPLES)
        rows = curve.evaluate_many(samples[:, None])[:, [F, F_1, F_11], :2]
        smooth = np.isfinite(rows).all(axis=(1, 2))
        if not smooth.all():
            raise ContourError(
                f"{owner}: the profile has no finite derivatives at s = {samples[np.argmin(smooth)]}: parametrise it "
                "by arc length or an angle"
            )
        size = float(np.abs(rows[:, 0]).max())
        r = rows[:, 0, 0]
        poles = [not periodic and abs(r[end]) <= _ON_AXIS * size for end in (0, -1)]
        off_axis = r > 0.0
        off_axis[[end for end, pole in zip((0, -1), poles) if pole]] = True
        if not off_axis.all():
            where = int(np.argmin(off_axis))
            raise ContourError(f"{owner}: the profile crosses the axis: r = {r[where]} at s = {samples[where]}")
        caps = []
        for end, pole in enumerate(poles):
            reach = _ENTER * (high - low) if reaches is None else reaches[end]
            caps.append(_cap(owner, curve, (low, high)[end], 1.0 - 2.0 * end, reach, size) if pole else None)
        hand = _outward(rows, samples)
        enter = _ENTER * (high - low)
        # where the profile meets the axis charts 1 and 2 go on, so there is no end
        limits = (-math.inf if poles[0] or periodic else low, math.inf if poles[1] or periodic else high)
        super().__init__(
            revolution,
            2,
            shape=(hand, low, high, *map(float, poles), enter, _LEAVE_FACTOR * enter, float(evaluator is traced)),
            pool=_assemble(pool, caps),
            domain=(TURN, (low, high)),
            periodic=(True, periodic),
            limits=(ALL, limits),
            charts=(0, *(chart for chart, pole in zip((1, 2), poles) if pole)),
            size=max(float(r.max()), 0.5 * float(np.ptp(rows[:, 0, 1]))),
            convex_side=_convex(rows, hand) if sum(poles) != 1 and not periodic else 0,
            fit_error=error,
            kind=REVOLUTION,
        )


def _profile_formula(owner: str, profile: Callable[..., Any]) -> Formula:
    formula = Formula(f"{owner} (profile)", profile, 1, 2)
    if formula.takes_time:
        raise ContourError(f"{owner}: the profile must not depend on time")
    return formula


def _spline_profile(
    owner: str, given: Any, periodic: bool
) -> tuple[np.ndarray, tuple[float, float], tuple[float, float]]:
    """Pool and domain of the spline through (r, z) points, and how far it is one polynomial from each end.

    Where the profile starts or ends on the axis it is mirrored there, so that the spline has the parity of a smooth
    surface.
    """
    points = array(owner, "profile", given, None, 2)
    if (points[:, 0] < 0.0).any():
        i = int(np.argmin(points[:, 0]))
        raise ContourError(f"{owner}: profile[{i}] is on the other side of the axis, r = {points[i, 0]}")
    if periodic:
        points = np.concatenate([points, points[:1]])
    s = chords(f"{owner} (profile)", points)
    touches = [not periodic and points[end, 0] <= _ON_AXIS * np.abs(points).max() for end in (0, -1)]
    points[[end for end, touch in zip((0, -1), touches) if touch], 0] = 0.0
    mirrored = np.column_stack([-points[:, 0], points[:, 1]])
    high = s[-1]
    sites, values = s, points
    if touches[0]:
        sites = np.concatenate([-s[:0:-1], sites])
        values = np.concatenate([mirrored[:0:-1], values])
    if touches[1]:
        sites = np.concatenate([sites, 2.0 * high - s[-2::-1]])
        values = np.concatenate([values, mirrored[-2::-1]])
    whole = spline(owner, sites, values, _POLAR_DEGREE if any(touches) else _DEGREE, periodic)
    # Only the half on this side is evaluated, up to the chart's overshoot.
    return spline_pool(whole, periodic), (0.0, float(high)), (0.5 * s[1], 0.5 * (high - s[-2]))


def _cap(owner: str, curve: Contour, end: float, towards: float, reach: float, size: float) -> tuple[np.ndarray, float]:
    """Pool of (g, k) as functions of d^2 around the pole at s = end, and the d^2 up to which they hold."""
    r_1, z_1 = curve.evaluate(end)[F_1, :2]
    if not abs(r_1) * reach > _TANGENTIAL * size:
        raise ContourError(f"{owner}: the profile reaches the axis tangentially at s = {end}: dr/ds = {r_1}")
    if abs(z_1) > _APEX * abs(r_1):
        raise ContourError(
            f"{owner}: the surface has an apex at s = {end}: the profile meets the axis with slope "
            f"dz/dr = {z_1 / r_1}, not 0; end the domain before it"
        )
    best = (math.inf, reach, np.zeros((0, 2)))
    for part, degree in itertools.product(_CAP_REACHES, range(1, _CAP_DEGREE + 1)):
        coefficients, error = _cap_fit(curve, end, towards, part * reach, degree)
        # Every degree beyond the first that fits to rounding only adds noise to the derivatives.
        if error < 0.5 * best[0]:
            best = error, part * reach, coefficients
        if best[0] <= _CAP_ROUNDING * size:
            break
    error, length, coefficients = best
    if not error <= _CAP_ERROR * size:
        raise ContourError(
            f"{owner}: not smooth where the profile meets the axis at s = {end}: r must be odd and z even in the "
            f"distance from there; the best such functions miss it by {error:.1e} m"
        )
    direction = Direction.chebyshev(np.array([0.0, length**2]), len(coefficients) - 1)
    return pack([direction], coefficients), (_CAP_KEPT * length) ** 2


# Where a cap is fitted, in d^2 relative to its reach.
_CAP_NODES = 0.5 + 0.5 * chebyshev_nodes(5 * _CAP_DEGREE)


def _cap_fit(curve: Contour, end: float, towards: float, length: float, degree: int) -> tuple[np.ndarray, float]:
    """Chebyshev coefficients (degree + 1, 2) of (g, k) that fit (r, z), and the largest deviation."""
    d = length * np.sqrt(_CAP_NODES)[:, None]
    values = curve.evaluate_many(end + towards * d)[:, F, :2]
    powers = chebyshev.chebvander(2.0 * _CAP_NODES - 1.0, degree)
    # Fitting r = d g instead of g keeps the rounding of r near the pole from being divided by d.
    g = np.linalg.lstsq(d / length * powers, values[:, 0] / length, rcond=None)[0]
    k = np.linalg.lstsq(powers, values[:, 1], rcond=None)[0]
    fitted = np.column_stack([d[:, 0] * (powers @ g), powers @ k])
    return np.column_stack([g, k]), float(np.abs(fitted - values).max())


def _assemble(profile_pool: np.ndarray, caps: list[tuple[np.ndarray, float] | None]) -> np.ndarray:
    header = np.zeros(_PROFILE)
    parts = [header, profile_pool]
    for end, cap in enumerate(caps):
        if cap is not None:
            header[_CAPS + end], header[_REACHES + end] = sum(part.size for part in parts), cap[1]
            parts.append(cap[0])
    return np.concatenate(parts)


def _outward(rows: np.ndarray, s: np.ndarray) -> float:
    """The sign of the azimuth for which f_1 x f_2 points out of the body around the axis."""
    r, z_1, r_1 = rows[:, 0, 0], rows[:, 1, 1], rows[:, 1, 0]
    volume = float(np.trapezoid(r * r * z_1, s))
    scale = float(np.trapezoid(r * r * np.hypot(r_1, z_1), s))
    if abs(volume) > _FLAT * scale:
        return math.copysign(1.0, volume)
    return -math.copysign(1.0, float(r_1.sum()))


def _convex(rows: np.ndarray, hand: float) -> int:
    """1 if both principal curvatures bend away from the outward normal everywhere."""
    (r, _), (r_1, z_1), (r_11, z_11) = (rows[:, i].T for i in range(3))
    along, around = hand * (z_1 * r_11 - r_1 * z_11), -hand * z_1 * r
    scale = np.abs(along).max() + np.abs(around).max()
    return 1 if max(along.max(), around.max()) <= _BENT * scale else 0


@kernel
def revolution_source(chart, shape, pool, u1, u2):
    """What a point of a surface of revolution is made from: the profile, or a cap's (g, k).

    Returns the offset of its pool, the argument and whether it is a tape.
    """
    traced = shape[TRACED] != 0.0
    if chart == 0:
        return _PROFILE, u2, traced
    w, end = u1 * u1 + u2 * u2, chart - 1
    if w <= pool[_REACHES + end]:
        return int(pool[_CAPS + end]), w, False
    return _PROFILE, shape[ENDS + end] + (1.0 - 2.0 * end) * math.sqrt(w), traced


@contour_kernel
def revolution(chart, shape, pool, u1, u2, t, out):
    start, argument, is_tape = revolution_source(chart, shape, pool, u1, u2)
    if is_tape:
        tape(pool[start:], argument, u2, t, out)
    else:
        piecewise(pool[start:], argument, u2, t, out)
    revolve(chart, shape, pool, u1, u2, out)


@kernel
def revolve(chart, shape, pool, u1, u2, out):
    """The point of a surface of revolution from what `revolution_source` named.

    That is found, with its derivatives, in columns 0 and 1 of the rows F, F_1, F_11 of out, which this fills.
    """
    hand, towards = shape[HAND], 3.0 - 2.0 * chart
    g, g_w, g_ww = out[0, 0], out[1, 0], out[3, 0]
    k, k_w, k_ww = out[0, 1], out[1, 1], out[3, 1]
    if chart == 0:
        put_revolved(out, 0, math.cos(u1), math.sin(u1), g, k, g_w, k_w, g_ww, k_ww, 1.0, hand)
        return
    w = u1 * u1 + u2 * u2
    if w > pool[_REACHES + chart - 1]:
        # This is the profile (r, z)(s): by d first, with r = d g, then by w, with dw = 2 d dd.
        d = math.sqrt(w)
        g /= d
        g_d = (towards * g_w - g) / d
        g_w = 0.5 * g_d / d
        g_ww = 0.25 * ((g_ww - 2.0 * g_d) / d - g_d / d) / w
        k_d = towards * k_w
        k_w = 0.5 * k_d / d
        k_ww = 0.25 * (k_ww - k_d / d) / w
    a, b = u1, u2
    # The cap at the low end turns the other way round its pole.
    hand *= -towards
    cross = 2.0 * a * b * g_w
    aa, bb = 4.0 * a * a * g_ww, 4.0 * b * b * g_ww
    out[0, 0], out[0, 1], out[0, 2] = a * g, hand * b * g, k
    out[1, 0], out[1, 1], out[1, 2] = g + 2.0 * a * a * g_w, hand * cross, 2.0 * a * k_w
    out[2, 0], out[2, 1], out[2, 2] = cross, hand * (g + 2.0 * b * b * g_w), 2.0 * b * k_w
    out[3, 0], out[3, 1] = a * (6.0 * g_w + aa), hand * b * (2.0 * g_w + aa)
    out[4, 0], out[4, 1] = b * (2.0 * g_w + aa), hand * a * (2.0 * g_w + bb)
    out[5, 0], out[5, 1] = a * (2.0 * g_w + bb), hand * b * (6.0 * g_w + bb)
    out[3, 2] = 2.0 * k_w + 4.0 * a * a * k_ww
    out[4, 2] = 4.0 * a * b * k_ww
    out[5, 2] = 2.0 * k_w + 4.0 * b * b * k_ww
