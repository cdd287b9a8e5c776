"""Curves in closed form. The planar ones lie in their frame's xy-plane."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ContourError
from ..jit import kernel
from .base import ALL, ELLIPSE, LINE, TURN, Contour
from .checks import array, finite, in_space, interval, positive
from .evaluation import contour_kernel

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# A domain in rad that is longer than a turn by no more than round-off is a whole one.
_WHOLE = 2.0 * math.pi * (1.0 + 1e-14)
# A contact comes to an end so far from a cusp, rad, since u' grows without bound towards it. What is left of the arch
# is of the order of its square.
_CUSP = 1e-4


def arc(owner: str, name: str, domain: Any) -> tuple[tuple[float, float], bool]:
    """Domain of an angle, at most one turn, and whether it closes; no domain means the full turn."""
    if domain is None:
        return TURN, True
    low, high = interval(owner, name, domain)
    if not high - low <= _WHOLE:
        raise ContourError(f"{owner}: {name} must not exceed one turn, got {high - low} rad")
    # up to the rounding of multiples of pi
    return (low, high), abs(high - low - 2.0 * math.pi) <= _WHOLE - 2.0 * math.pi


def _round(owner: str, a: float, b: float, domain: Any) -> dict[str, Any]:
    """What `Contour` is to be given for a circle or an ellipse."""
    limits, closed = arc(owner, "domain", domain)
    return {
        "evaluator": round_curve,
        "dimension": 1,
        "shape": (a, b, 0.0),
        "domain": (limits,),
        "periodic": (closed,),
        "periods": (2.0 * math.pi,),
        "planar": True,
        "size": max(a, b),
        "convex_side": int(closed),
        "kind": ELLIPSE,
    }


class Line(Contour):
    """The x axis: f(u) = (u, 0, 0).

    Parameters
    ----------
    domain : (low, high), optional
        Ends of u in m for a segment; infinite if not given.

    Raises
    ------
    ContourError
        Unless low < high.

    Examples
    --------
    >>> import pincontact as pc
    >>> edge = pc.Line(domain=(-0.5, 0.5))
    >>> edge, edge.ends()[:2].tolist()
    (Line(domain=(-0.5, 0.5)), [-0.5, 0.5])
    """

    def __init__(self, domain: tuple[float, float] | None = None) -> None:
        low, high = ALL if domain is None else interval("Line", "domain", domain)
        super().__init__(line, 1, domain=((low, high),), planar=True, size=0.5 * (high - low), kind=LINE, lengths=True)


class Circle(Contour):
    """f(u) = radius (cos u, sin u, 0).

    Parameters
    ----------
    radius : float
        In m.
    domain : (low, high), optional
        Ends of u in rad for an arc of at most one turn; the whole circle if not given.

    Raises
    ------
    ContourError
        For a radius that is not positive or a domain that is not such an arc.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Circle(0.3).size
    0.3
    """

    def __init__(self, radius: float, domain: tuple[float, float] | None = None) -> None:
        (radius,) = positive("Circle", radius=radius)
        super().__init__(**_round("Circle", radius, radius, domain))


class Ellipse(Contour):
    """f(u) = (a cos u, b sin u, 0).

    Parameters
    ----------
    a, b : float
        Semi-axes in m.
    domain : (low, high), optional
        Ends of u in rad for an arc of at most one turn; the whole ellipse if not given.

    Raises
    ------
    ContourError
        For a semi-axis that is not positive or a domain that is not such an arc.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Ellipse(a=0.4, b=0.2).point(0.0).tolist()
    [0.4, 0.0, 0.0]
    """

    def __init__(self, a: float, b: float, domain: tuple[float, float] | None = None) -> None:
        a, b = positive("Ellipse", a=a, b=b)
        super().__init__(**_round("Ellipse", a, b, domain))


class Helix(Contour):
    """f(u) = (radius cos u, radius sin u, pitch u / (2 pi)).

    Parameters
    ----------
    radius : float
        In m.
    pitch : float
        Climb in m along z per turn, negative for a left-handed helix.
    domain : (low, high), optional
        Ends of u in rad; infinite if not given.

    Raises
    ------
    ContourError
        For a radius that is not positive or a pitch that is not finite.

    Examples
    --------
    >>> import math
    >>> import pincontact as pc
    >>> pc.Helix(radius=0.2, pitch=0.1).point(2.0 * math.pi).round(12).tolist()
    [0.2, -0.0, 0.1]
    """

    def __init__(self, radius: float, pitch: float, domain: tuple[float, float] | None = None) -> None:
        (radius,) = positive("Helix", radius=radius)
        (pitch,) = finite("Helix", pitch=pitch)
        limits = ALL if domain is None else interval("Helix", "domain", domain)
        climb = pitch / (2.0 * math.pi)
        super().__init__(round_curve, 1, shape=(radius, radius, climb), domain=(limits,), size=radius)


class Cycloid(Contour):
    """One arch of a cycloid, opening to +y (a cup): f(u) = radius (u + sin u, 1 - cos u, 0), |u| < pi.

    Parameters
    ----------
    radius : float
        Of the generating circle, in m.
    domain : (low, high)
        Ends of u within (-pi, pi), whose ends are cusps.

    Raises
    ------
    ContourError
        For a radius that is not positive or a domain beyond the cusps.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Cycloid(radius=0.5).point(0.0).tolist()
    [0.0, 0.0, 0.0]
    """

    def __init__(self, radius: float, domain: tuple[float, float] = TURN) -> None:
        (radius,) = positive("Cycloid", radius=radius)
        low, high = interval("Cycloid", "domain", domain)
        if low < -math.pi or high > math.pi:
            raise ContourError(f"Cycloid: domain must stay between the cusps -pi and pi, got ({low}, {high})")
        limits = (max(low, _CUSP - math.pi), min(high, math.pi - _CUSP))
        super().__init__(cycloid, 1, shape=(radius,), domain=((low, high),), limits=(limits,), planar=True, size=radius)


class FourierCurve(Contour):
    """A closed curve f(u) = sum over k = 0..n of cosine[k] cos(k u) + sine[k] sin(k u).

    Parameters
    ----------
    cosine, sine : (n + 1, 3) or (n + 1, 2) array_like
        Coefficients in m, n > 0; with two columns the curve is planar. sine[0] has no effect.

    Raises
    ------
    ContourError
        For shapes that do not match, numbers that are not finite or a curve without extent.

    Examples
    --------
    >>> import pincontact as pc
    >>> ellipse = pc.FourierCurve(cosine=[[0, 0], [0.4, 0]], sine=[[0, 0], [0, 0.2]])
    >>> ellipse.planar, ellipse.convex_side, ellipse.point(0.0).tolist()
    (True, 1, [0.4, 0.0, 0.0])
    """

    def __init__(self, cosine: ArrayLike, sine: ArrayLike) -> None:
        owner = "FourierCurve"
        tables = [array(owner, name, given, None, None) for name, given in (("cosine", cosine), ("sine", sine))]
        for name, table in zip(("cosine", "sine"), tables):
            if table.shape[1] not in (2, 3) or len(table) < 2:
                raise ContourError(f"{owner}: {name} must be (n + 1, 2 or 3), n > 0, got {table.shape}")
        a, b = (in_space(table) for table in tables)
        if a.shape != b.shape:
            raise ContourError(f"{owner}: {len(a)} rows of cosine but {len(b)} of sine")
        if not np.any(a[1:]) and not np.any(b[1:]):
            raise ContourError(f"{owner}: all coefficients beyond the constant one are zero")
        b[0] = 0.0
        super().__init__(
            fourier,
            1,
            shape=(float(len(a)),),
            pool=np.stack([a, b], axis=1).ravel(),
            domain=(TURN,),
            periodic=(True,),
            planar=not np.any([a[:, 2], b[:, 2]]),
        )


@kernel
def put_curve(out, x, y, z, x_1, y_1, z_1, x_11, y_11, z_11):
    """Write the rows F, F_1 and F_11."""
    out[0, 0], out[0, 1], out[0, 2] = x, y, z
    out[1, 0], out[1, 1], out[1, 2] = x_1, y_1, z_1
    out[3, 0], out[3, 1], out[3, 2] = x_11, y_11, z_11


@contour_kernel
def line(chart, shape, pool, u1, u2, t, out):
    put_curve(out, u1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@contour_kernel
def round_curve(chart, shape, pool, u1, u2, t, out):
    """(a cos u, b sin u, climb u)."""
    a, b, climb = shape[0], shape[1], shape[2]
    c, s = math.cos(u1), math.sin(u1)
    put_curve(out, a * c, b * s, climb * u1, -a * s, b * c, climb, -a * c, -b * s, 0.0)


@contour_kernel
def cycloid(chart, shape, pool, u1, u2, t, out):
    a = shape[0]
    c, s = math.cos(u1), math.sin(u1)
    # 1 - cos u and 1 + cos u without cancellation
    half_s, half_c = math.sin(0.5 * u1), math.cos(0.5 * u1)
    y, x_1 = 2.0 * a * half_s * half_s, 2.0 * a * half_c * half_c
    put_curve(out, a * (u1 + s), y, 0.0, x_1, a * s, 0.0, -a * s, a * c, 0.0)


@contour_kernel
def fourier(chart, shape, pool, u1, u2, t, out):
    """Coefficients (cosine, sine) of each order in turn; the angle is advanced by complex multiplication."""
    for i in range(3):
        out[0, i], out[1, i], out[3, i] = 0.0, 0.0, 0.0
    c, s = math.cos(u1), math.sin(u1)
    c_k, s_k = 1.0, 0.0
    for k in range(int(shape[0])):
        for i in range(3):
            a, b = pool[6 * k + i], pool[6 * k + 3 + i]
            value = a * c_k + b * s_k
            out[0, i] += value
            out[1, i] += k * (b * c_k - a * s_k)
            out[3, i] -= k * k * value
        c_k, s_k = c_k * c - s_k * s, s_k * c + c_k * s
