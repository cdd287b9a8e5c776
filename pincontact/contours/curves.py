"""Curves in closed form: line, circle, ellipse, helix, cycloid. Planar ones lie in their frame's xy-plane."""

from __future__ import annotations

import math

import numpy as np

from ..jit import kernel
from .base import CIRCLE, LINE, Contour, positive

_TURN = (-math.pi, math.pi)
_ALL = (-np.inf, np.inf)


class Line(Contour):
    """The x axis: f(u) = (u, 0, 0)."""

    def __init__(self) -> None:
        super().__init__(kind=LINE, dimension=1, domain=(_ALL,), periodic=(False,), planar=True)


class Circle(Contour):
    """f(u) = radius (cos u, sin u, 0)."""

    def __init__(self, radius: float) -> None:
        (radius,) = positive("Circle", radius=radius)
        super().__init__(
            kind=CIRCLE,
            dimension=1,
            shape=(radius,),
            domain=(_TURN,),
            periodic=(True,),
            planar=True,
            size=radius,
            convex_side=1,
        )


@kernel
def line(u, out):
    out[0, 0] = u
    out[0, 1] = 0.0
    out[0, 2] = 0.0
    out[1, 0] = 1.0
    out[1, 1] = 0.0
    out[1, 2] = 0.0
    out[3, 0] = 0.0
    out[3, 1] = 0.0
    out[3, 2] = 0.0


@kernel
def circle(shape, u, out):
    x = shape[0] * math.cos(u)
    y = shape[0] * math.sin(u)
    out[0, 0] = x
    out[0, 1] = y
    out[0, 2] = 0.0
    out[1, 0] = -y
    out[1, 1] = x
    out[1, 2] = 0.0
    out[3, 0] = -x
    out[3, 1] = -y
    out[3, 2] = 0.0
