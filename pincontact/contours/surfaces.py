"""Surfaces in closed form: plane, sphere, ellipsoid, cylinder, cone, torus. f_1 x f_2 points outwards."""

from __future__ import annotations

import math

import numpy as np

from ..jit import kernel
from .base import PLANE, SPHERE, Contour, positive

_TURN = (-math.pi, math.pi)
_HALF_TURN = (-0.5 * math.pi, 0.5 * math.pi)
_ALL = (-np.inf, np.inf)


class Plane(Contour):
    """f(u1, u2) = (u1, u2, 0), normal +z."""

    def __init__(self) -> None:
        super().__init__(kind=PLANE, dimension=2, domain=(_ALL, _ALL), periodic=(False, False))


class Sphere(Contour):
    """Chart 0: f = radius (cos u2 cos u1, cos u2 sin u1, sin u2), poles on z.

    Chart 1 is the same with the axes turned (x, y, z) -> (y, z, x), poles on x.
    """

    def __init__(self, radius: float) -> None:
        (radius,) = positive("Sphere", radius=radius)
        super().__init__(
            kind=SPHERE,
            dimension=2,
            shape=(radius,),
            domain=(_TURN, _HALF_TURN),
            periodic=(True, False),
            size=radius,
            convex_side=1,
        )


@kernel
def plane(u1, u2, out):
    for row in range(6):
        out[row, 0] = 0.0
        out[row, 1] = 0.0
        out[row, 2] = 0.0
    out[0, 0] = u1
    out[0, 1] = u2
    out[1, 0] = 1.0
    out[2, 1] = 1.0


@kernel
def sphere(chart, shape, u1, u2, out):
    r = shape[0]
    c1, s1, c2, s2 = math.cos(u1), math.sin(u1), math.cos(u2), math.sin(u2)
    # Chart 1 writes to the axes (1, 2, 0) instead of (0, 1, 2).
    x, y, z = 0, 1, 2
    if chart == 1:
        x, y, z = 1, 2, 0
    out[0, x] = r * c2 * c1
    out[0, y] = r * c2 * s1
    out[0, z] = r * s2
    out[1, x] = -r * c2 * s1
    out[1, y] = r * c2 * c1
    out[1, z] = 0.0
    out[2, x] = -r * s2 * c1
    out[2, y] = -r * s2 * s1
    out[2, z] = r * c2
    out[3, x] = -r * c2 * c1
    out[3, y] = -r * c2 * s1
    out[3, z] = 0.0
    out[4, x] = r * s2 * s1
    out[4, y] = -r * s2 * c1
    out[4, z] = 0.0
    out[5, x] = -r * c2 * c1
    out[5, y] = -r * c2 * s1
    out[5, z] = -r * s2
