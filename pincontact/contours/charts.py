"""Charts: other parameters for the same surface near the poles of the first ones.

Sphere and ellipsoid: two charts whose poles lie on different axes. Surface of revolution: chart 1 (2) is a smooth
cap around the pole at the low (high) end of the profile, see `revolution.py`. All other kinds have one chart.
"""

from __future__ import annotations

import math

from ..jit import kernel
from .base import ELLIPSOID, REVOLUTION, SPHERE

# Shape parameters of a surface of revolution: sign of the azimuth, ends of the profile, distances from a pole at which
# the cap chart is entered and left, which ends are poles, and whether the profile is a tape (or piecewise polynomials).
HAND, LOW, HIGH, ENTER, LEAVE, LOW_POLE, HIGH_POLE, TRACED = range(8)

# A latitude is left where its cosine falls below this; the other chart's cosine is then at least sqrt(3)/2, which
# is the hysteresis.
_POLAR = 0.5


@kernel
def preferred_chart(kind, chart, shape, u1, u2):
    """The chart in which the point (u1, u2) of `chart` is well described: `chart` itself where it is."""
    if kind in (SPHERE, ELLIPSOID):
        return 1 - chart if math.cos(u2) < _POLAR else chart
    if kind == REVOLUTION:
        if chart == 0:
            if shape[LOW_POLE] != 0.0 and u2 - shape[LOW] < shape[ENTER]:
                return 1
            if shape[HIGH_POLE] != 0.0 and shape[HIGH] - u2 < shape[ENTER]:
                return 2
        elif u1 * u1 + u2 * u2 > shape[LEAVE] * shape[LEAVE]:
            return 0
    return chart


@kernel
def is_across_pole(kind, chart, shape, u2):
    """Whether parameters have run over a pole of their chart, where they describe the surface turned inside out."""
    if kind in (SPHERE, ELLIPSOID):
        return math.cos(u2) < 0.0
    if kind == REVOLUTION and chart == 0:
        return (shape[LOW_POLE] != 0.0 and u2 < shape[LOW]) or (shape[HIGH_POLE] != 0.0 and u2 > shape[HIGH])
    return False


@kernel
def turned_back(kind, chart, shape, u1, u2):
    """Parameters within the chart's poles of the same point, for (u1, u2) that may have run over one."""
    if is_across_pole(kind, chart, shape, u2):
        middle = 0.5 * math.pi
        if kind == REVOLUTION:
            middle = shape[LOW] if u2 < shape[LOW] else shape[HIGH]
        u1, u2 = u1 + math.pi, 2.0 * middle - u2
    if kind in (SPHERE, ELLIPSOID):
        u2 -= 2.0 * math.pi * round(u2 / (2.0 * math.pi))
    return u1, u2


@kernel
def convert_chart(kind, shape, chart, u1, u2, new_chart):
    """Parameters (u1, u2) in new_chart of the point that has parameters (u1, u2) in chart.

    Angles come out in (-pi, pi]. At a pole the angle is arbitrary: zero.
    """
    if chart == new_chart:
        return u1, u2
    if kind in (SPHERE, ELLIPSOID):
        # The point on the unit sphere; an ellipsoid's charts are a sphere's, stretched.
        c2 = math.cos(u2)
        x, y, z = c2 * math.cos(u1), c2 * math.sin(u1), math.sin(u2)
        if new_chart == 1:
            x, y, z = y, z, x
        else:
            x, y, z = z, x, y
        return math.atan2(y, x), math.atan2(z, math.hypot(x, y))
    if kind == REVOLUTION:
        if chart != 0:
            # The cap at the low end turns the other way round its pole.
            turn = -1.0 if chart == 1 else 1.0
            distance = math.hypot(u1, u2)
            u1 = math.atan2(turn * u2, u1)
            u2 = shape[LOW] + distance if chart == 1 else shape[HIGH] - distance
        if new_chart != 0:
            turn = -1.0 if new_chart == 1 else 1.0
            distance = u2 - shape[LOW] if new_chart == 1 else shape[HIGH] - u2
            u1, u2 = distance * math.cos(u1), turn * distance * math.sin(u1)
    return u1, u2
