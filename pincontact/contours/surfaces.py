"""Surfaces in closed form. f_1 x f_2 points outwards: out of the body, up for the plane."""

from __future__ import annotations

import math
from typing import Any

from ..errors import ContourError
from ..jit import kernel
from .base import ALL, CYLINDER, ELLIPSOID, PLANE, SPHERE, TURN, Contour
from .checks import interval, pair, positive
from .curves import arc
from .evaluation import contour_kernel

# A contact comes to an end so far from an apex, m, since u1' and the curvature grow without bound towards it.
_APEX = 1e-6
# (low, high) of both parameters, None for all of one.
Domain = tuple[tuple[float, float] | None, tuple[float, float] | None] | None


def _pair(owner: str, domain: Domain) -> tuple[Any, Any]:
    """Both parts of the domain of a surface, each (low, high) or None; none means None for both."""
    return (None, None) if domain is None else pair(owner, "domain", domain, "(low, high) or None")


def _along(owner: str, name: str, given: Any) -> tuple[float, float]:
    """Domain of a length; no domain means all of it."""
    return ALL if given is None else interval(owner, name, given)


def _straight(
    around: tuple[tuple[float, float], bool], along: tuple[float, float], limits: tuple[float, float]
) -> dict[str, Any]:
    """What `Contour` is to be given for a cylinder or a cone, besides its shape and size; around: see `arc`."""
    angle, closed = around
    return {
        "evaluator": straight_profile,
        "dimension": 2,
        "domain": (angle, along),
        "periodic": (closed, False),
        "periods": (2.0 * math.pi, math.inf),
        "limits": (ALL if closed else angle, limits),
        "convex_side": int(closed),
        "lengths": True,
    }


class Plane(Contour):
    """f(u1, u2) = (u1, u2, 0), normal +z.

    Parameters
    ----------
    domain : ((low, high), (low, high)), optional
        In m for a rectangular patch, either of them None if infinite.

    Raises
    ------
    ContourError
        Unless low < high.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Plane(), pc.Plane(domain=((-1, 1), None)).domain
    (Plane(), ((-1.0, 1.0), (-inf, inf)))
    """

    def __init__(self, domain: Domain = None) -> None:
        parts = _pair("Plane", domain)
        patch = (_along("Plane", "domain[0]", parts[0]), _along("Plane", "domain[1]", parts[1]))
        size = 0.5 * math.hypot(patch[0][1] - patch[0][0], patch[1][1] - patch[1][0])
        super().__init__(plane, 2, domain=patch, size=size, kind=PLANE, lengths=True)


class Sphere(Contour):
    """A ball's surface. Chart 0: f = radius (cos u2 cos u1, cos u2 sin u1, sin u2), poles on z.

    Chart 1 is the same with the axes turned (x, y, z) -> (y, z, x), poles on x.

    Parameters
    ----------
    radius : float
        In m.

    Raises
    ------
    ContourError
        Unless the radius is positive.

    Examples
    --------
    >>> import pincontact as pc
    >>> ball = pc.Sphere(radius=0.1)
    >>> ball.point((0.0, 0.0)).tolist(), ball.charts
    ([0.1, 0.0, 0.0], (0, 1))
    """

    def __init__(self, radius: float) -> None:
        (radius,) = positive("Sphere", radius=radius)
        super().__init__(shape=(radius, radius, radius), size=radius, kind=SPHERE, **_OVAL)


class Ellipsoid(Contour):
    """Chart 0: f = (a cos u2 cos u1, b cos u2 sin u1, c sin u2), poles on z.

    Chart 1: f = (a sin u2, b cos u2 cos u1, c cos u2 sin u1), poles on x.

    Parameters
    ----------
    a, b, c : float
        Semi-axes along x, y, z in m.

    Raises
    ------
    ContourError
        Unless they are positive.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Ellipsoid(a=0.3, b=0.2, c=0.1).point((0.0, 0.0), chart=1).tolist()
    [0.0, 0.2, 0.0]
    """

    def __init__(self, a: float, b: float, c: float) -> None:
        a, b, c = positive("Ellipsoid", a=a, b=b, c=c)
        super().__init__(shape=(a, b, c), size=max(a, b, c), kind=ELLIPSOID, **_OVAL)


class Cylinder(Contour):
    """f(u1, u2) = (radius cos u1, radius sin u1, u2), axis z.

    Parameters
    ----------
    radius : float
        In m.
    domain : ((low, high) of u1 in rad, (low, high) of u2 in m), optional
        Either of them None if whole.

    Raises
    ------
    ContourError
        For a radius that is not positive or a domain that is not an interval.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Cylinder(radius=0.2, domain=(None, (0.0, 1.0))).periodic
    (True, False)
    """

    def __init__(self, radius: float, domain: Domain = None) -> None:
        (radius,) = positive("Cylinder", radius=radius)
        around, along = _pair("Cylinder", domain)
        turn, length = arc("Cylinder", "domain[0]", around), _along("Cylinder", "domain[1]", along)
        super().__init__(shape=(radius, 0.0, 1.0), size=radius, kind=CYLINDER, **_straight(turn, length, length))


class Cone(Contour):
    """f(u1, u2) = u2 (sin a cos u1, sin a sin u1, cos a): axis z, apex at the origin, opening to +z.

    Parameters
    ----------
    half_angle : float
        a, between axis and surface, in rad, in (0, pi/2).
    domain : ((low, high) of u1 in rad, (low, high) of u2 in m), optional
        Either of them None if whole. u2 is the distance from the apex, which is an end of the domain: no point contact
        has a tangent plane there.

    Raises
    ------
    ContourError
        For an angle out of bounds or a domain that is not an interval of u2 >= 0.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Cone(half_angle=0.4).ends()[2:].tolist()
    [1e-06, inf]
    """

    def __init__(self, half_angle: float, domain: Domain = None) -> None:
        owner = "Cone"
        (half_angle,) = positive(owner, half_angle=half_angle)
        if not half_angle < 0.5 * math.pi:
            raise ContourError(f"{owner}: half_angle must be less than pi/2, got {half_angle}")
        around, along = _pair(owner, domain)
        turn = arc(owner, "domain[0]", around)
        low, high = (0.0, math.inf) if along is None else interval(owner, "domain[1]", along)
        if low < 0.0:
            raise ContourError(f"{owner}: domain[1] must not go beyond the apex at 0, got {(low, high)}")
        shape = (0.0, math.sin(half_angle), math.cos(half_angle))
        super().__init__(shape=shape, size=high, **_straight(turn, (low, high), (max(low, _APEX), high)))


class Torus(Contour):
    """f = ((major + minor cos u2) cos u1, (major + minor cos u2) sin u1, minor sin u2), axis z.

    Parameters
    ----------
    major : float
        Radius of the centre circle in m.
    minor : float
        Radius of the tube in m, less than major.

    Raises
    ------
    ContourError
        For radii out of bounds.

    Examples
    --------
    >>> import pincontact as pc
    >>> pc.Torus(major=1.0, minor=0.25).point((0.0, 0.0)).tolist()
    [1.25, 0.0, 0.0]
    """

    def __init__(self, major: float, minor: float) -> None:
        major, minor = positive("Torus", major=major, minor=minor)
        if not minor < major:
            raise ContourError(f"Torus: minor must be less than major, got {minor} and {major}")
        super().__init__(torus, 2, shape=(major, minor), domain=(TURN, TURN), periodic=(True, True), size=major + minor)


@contour_kernel
def plane(chart, shape, pool, u1, u2, t, out):
    put_plane(out, u1, u2)
    for row in range(6):
        out[row, 2] = 0.0


@kernel
def put_plane(out, u1, u2):
    """Write columns x and y of f = (u1, u2, z)."""
    for row in range(6):
        out[row, 0], out[row, 1] = 0.0, 0.0
    out[0, 0], out[0, 1] = u1, u2
    out[1, 0] = 1.0
    out[2, 1] = 1.0


@kernel
def put_revolved(out, turn, c, s, r, z, r_2, z_2, r_22, z_22, a, b):
    """Write the rows of f = (a r cos u1, b r sin u1, z) for a profile (r, z)(u2), given c, s = cos u1, sin u1.

    turn: 0, or 1 to write it to the axes (y, z, x) instead of (x, y, z).
    """
    x, y, w = turn, turn + 1, 2 - 2 * turn
    ac, as_, bc, bs = a * c, a * s, b * c, b * s
    out[0, x], out[0, y], out[0, w] = ac * r, bs * r, z
    out[1, x], out[1, y], out[1, w] = -as_ * r, bc * r, 0.0
    out[2, x], out[2, y], out[2, w] = ac * r_2, bs * r_2, z_2
    out[3, x], out[3, y], out[3, w] = -ac * r, -bs * r, 0.0
    out[4, x], out[4, y], out[4, w] = -as_ * r_2, bc * r_2, 0.0
    out[5, x], out[5, y], out[5, w] = ac * r_22, bs * r_22, z_22


@contour_kernel
def ellipsoid(chart, shape, pool, u1, u2, t, out):
    """An ellipse with semi-axes 1 and c, turned about its second axis and stretched by a and b."""
    a, b, c = shape[0], shape[1], shape[2]
    if chart == 1:
        a, b, c = b, c, a
    c2, s2 = math.cos(u2), math.sin(u2)
    put_revolved(
        out,
        chart,
        math.cos(u1),
        math.sin(u1),
        c2,
        c * s2,
        -s2,
        c * c2,
        -c2,
        -c * s2,
        a,
        b,
    )


# What balls and ellipsoids have in common.
_OVAL: dict[str, Any] = {
    "evaluator": ellipsoid,
    "dimension": 2,
    "domain": (TURN, (-0.5 * math.pi, 0.5 * math.pi)),
    "periodic": (True, False),
    "limits": (ALL, ALL),
    "charts": (0, 1),
    "convex_side": 1,
}


@contour_kernel
def straight_profile(chart, shape, pool, u1, u2, t, out):
    """The profile r = r_0 + slope u2, z = climb u2, turned about z: a cylinder or a cone."""
    slope, climb = shape[1], shape[2]
    r, z = shape[0] + slope * u2, climb * u2
    put_revolved(out, 0, math.cos(u1), math.sin(u1), r, z, slope, climb, 0.0, 0.0, 1.0, 1.0)


@contour_kernel
def torus(chart, shape, pool, u1, u2, t, out):
    r, z = shape[1] * math.cos(u2), shape[1] * math.sin(u2)
    put_revolved(out, 0, math.cos(u1), math.sin(u1), shape[0] + r, z, -z, r, -r, -z, 1.0, 1.0)
