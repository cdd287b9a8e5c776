"""Surfaces in closed form. f_1 x f_2 points outwards: out of the body, up for the plane."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..errors import ContourError
from ..jit import kernel
from .base import CONE, CYLINDER, ELLIPSOID, PLANE, SPHERE, TORUS, Contour, interval, positive
from .curves import ALL, TURN, closes

_HALF_TURN = (-0.5 * math.pi, 0.5 * math.pi)


def _patch(
    owner: str, domain: Any, whole: tuple[tuple[float, float], tuple[float, float]]
) -> tuple[tuple[float, float], ...]:
    """Domain of a surface, one (low, high) or None for each parameter."""
    if domain is None:
        return whole
    try:
        first, second = domain
    except (TypeError, ValueError):
        raise ContourError(f"{owner}: domain must be a pair of (low, high) or None, got {domain!r}") from None
    return tuple(
        limits if part is None else interval(owner, f"domain[{i}]", part)
        for i, (part, limits) in enumerate(zip((first, second), whole))
    )


def _around(owner: str, domain: Any, along: tuple[float, float]) -> tuple[tuple[tuple[float, float], ...], bool]:
    """Domain of a surface around an axis, and whether it goes all the way round."""
    patch = _patch(owner, domain, (TURN, along))
    low, high = patch[0]
    closed = closes(low, high)
    if not (closed or high - low < 2.0 * math.pi):
        raise ContourError(f"{owner}: domain[0] must not exceed one turn, got {high - low} rad")
    return patch, closed


class Plane(Contour):
    """f(u1, u2) = (u1, u2, 0), normal +z.

    domain: ((low, high), (low, high)) in m for a rectangular patch, either of them None if infinite.
    Raises ContourError unless low < high.
    """

    def __init__(self, domain: Any = None) -> None:
        patch = _patch("Plane", domain, (ALL, ALL))
        size = 0.5 * math.hypot(patch[0][1] - patch[0][0], patch[1][1] - patch[1][0])
        super().__init__(kind=PLANE, dimension=2, domain=patch, periodic=(False, False), size=size)


class Sphere(Contour):
    """Chart 0: f = radius (cos u2 cos u1, cos u2 sin u1, sin u2), poles on z.

    Chart 1 is the same with the axes turned (x, y, z) -> (y, z, x), poles on x.
    radius: m. Raises ContourError unless it is positive.
    """

    def __init__(self, radius: float) -> None:
        (radius,) = positive("Sphere", radius=radius)
        super().__init__(
            kind=SPHERE,
            dimension=2,
            shape=(radius,),
            domain=(TURN, _HALF_TURN),
            periodic=(True, False),
            size=radius,
            convex_side=1,
        )


class Ellipsoid(Contour):
    """Chart 0: f = (a cos u2 cos u1, b cos u2 sin u1, c sin u2), poles on z.

    Chart 1: f = (a sin u2, b cos u2 cos u1, c cos u2 sin u1), poles on x.
    a, b, c: semi-axes along x, y, z in m. Raises ContourError unless they are positive.
    """

    def __init__(self, a: float, b: float, c: float) -> None:
        a, b, c = positive("Ellipsoid", a=a, b=b, c=c)
        super().__init__(
            kind=ELLIPSOID,
            dimension=2,
            shape=(a, b, c),
            domain=(TURN, _HALF_TURN),
            periodic=(True, False),
            size=max(a, b, c),
            convex_side=1,
        )


class Cylinder(Contour):
    """f(u1, u2) = (radius cos u1, radius sin u1, u2), axis z.

    radius: m; domain: ((low, high) of u1 in rad, (low, high) of u2 in m), either of them None if whole.
    Raises ContourError for a radius that is not positive or a domain that is not an interval.
    """

    def __init__(self, radius: float, domain: Any = None) -> None:
        (radius,) = positive("Cylinder", radius=radius)
        patch, closed = _around("Cylinder", domain, ALL)
        super().__init__(
            kind=CYLINDER,
            dimension=2,
            shape=(radius,),
            domain=patch,
            periodic=(closed, False),
            size=radius,
            convex_side=1 if closed else 0,
        )


# A contact comes to an end so far from an apex, m, since u1' and the curvature grow without bound towards it.
_APEX = 1e-6


class Cone(Contour):
    """f(u1, u2) = u2 (sin a cos u1, sin a sin u1, cos a): axis z, apex at the origin, opening to +z.

    half_angle: a, between axis and surface, rad, in (0, pi/2). u2 is the distance from the apex in m, which is an
    end of the domain: no point contact has a tangent plane there.
    domain: ((low, high) of u1 in rad, (low, high) of u2 in m), either of them None if whole.
    Raises ContourError for an angle out of bounds or a domain that is not an interval of u2 >= 0.
    """

    def __init__(self, half_angle: float, domain: Any = None) -> None:
        (half_angle,) = positive("Cone", half_angle=half_angle)
        if not half_angle < 0.5 * math.pi:
            raise ContourError(f"Cone: half_angle must be less than pi/2, got {half_angle}")
        patch, closed = _around("Cone", domain, (0.0, math.inf))
        if patch[1][0] < 0.0:
            raise ContourError(f"Cone: domain[1] must not go beyond the apex at 0, got {patch[1]}")
        super().__init__(
            kind=CONE,
            dimension=2,
            shape=(math.sin(half_angle), math.cos(half_angle)),
            domain=patch,
            periodic=(closed, False),
            size=patch[1][1],
            convex_side=1 if closed else 0,
        )

    def ends(self) -> np.ndarray:
        out = super().ends()
        out[2] = max(out[2], _APEX)
        return out


class Torus(Contour):
    """f = ((major + minor cos u2) cos u1, (major + minor cos u2) sin u1, minor sin u2), axis z.

    major: radius of the centre circle in m; minor: of the tube, less than major.
    Raises ContourError for radii out of bounds.
    """

    def __init__(self, major: float, minor: float) -> None:
        major, minor = positive("Torus", major=major, minor=minor)
        if not minor < major:
            raise ContourError(f"Torus: minor must be less than major, got {minor} and {major}")
        super().__init__(
            kind=TORUS,
            dimension=2,
            shape=(major, minor),
            domain=(TURN, TURN),
            periodic=(True, True),
            size=major + minor,
        )


@kernel
def plane(u1, u2, out):
    for row in range(6):
        out[row, 0], out[row, 1], out[row, 2] = 0.0, 0.0, 0.0
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


@kernel
def closed_form_surface(kind, chart, shape, u1, u2, out):
    """Sphere, ellipsoid, cylinder, cone or torus: profiles turned about an axis."""
    c1, s1 = math.cos(u1), math.sin(u1)
    if kind == CYLINDER:
        put_revolved(out, 0, c1, s1, shape[0], u2, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0)
        return
    if kind == CONE:
        sine, cosine = shape[0], shape[1]
        put_revolved(out, 0, c1, s1, sine * u2, cosine * u2, sine, cosine, 0.0, 0.0, 1.0, 1.0)
        return
    c2, s2 = math.cos(u2), math.sin(u2)
    if kind == TORUS:
        r, z = shape[1] * c2, shape[1] * s2
        put_revolved(out, 0, c1, s1, shape[0] + r, z, -z, r, -r, -z, 1.0, 1.0)
        return
    a, b, c = shape[0], shape[0], shape[0]
    if kind == ELLIPSOID:
        b, c = shape[1], shape[2]
    if chart == 1:
        a, b, c = b, c, a
    put_revolved(out, chart, c1, s1, c2, c * s2, -s2, c * c2, -c2, -c * s2, a, b)
