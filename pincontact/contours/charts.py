"""Charts: other parameters for the same surface near the poles of the first ones.

Sphere and ellipsoid: two charts whose poles lie on different axes. Surface of revolution: chart 1 (2) is a smooth
cap around the pole at the low (high) end of the profile, see `revolution.py`. All other kinds have one chart.
"""

from __future__ import annotations

import math

from ..jit import kernel
from .base import ELLIPSOID, REVOLUTION, SPHERE

# Shape parameters of a surface of revolution: sign of the azimuth, both ends of the profile, whether they are poles,
# distances from a pole at which the cap chart is entered and left, and whether the profile is a tape (or piecewise
# polynomials). Chart 1 + end is the cap at that end.
HAND, ENDS, POLES, ENTER, LEAVE, TRACED = 0, 1, 3, 5, 6, 7

# A latitude is left where its cosine falls below this; the other chart's cosine is then at least sqrt(3)/2, which
# is the hysteresis.
_POLAR = 0.5


@kernel
def from_end(shape, end, u2):
    """How far inside an end (0 low, 1 high) of a surface of revolution's profile u2 is."""
    return (1.0 - 2.0 * end) * (u2 - shape[ENDS + end])


@kernel
def preferred_chart(kind, chart, shape, u1, u2):
    """The chart in which the point (u1, u2) of `chart` is well described: `chart` itself where it is."""
    if kind in (SPHERE, ELLIPSOID):
        return 1 - chart if math.cos(u2) < _POLAR else chart
    if kind == REVOLUTION:
        if chart == 0:
            for end in range(2):
                if shape[POLES + end] != 0.0 and from_end(shape, end, u2) < shape[ENTER]:
                    return 1 + end
        elif u1 * u1 + u2 * u2 > shape[LEAVE] * shape[LEAVE]:
            return 0
    return chart


@kernel
def is_across_pole(kind, chart, shape, u2):
    """Whether parameters have run over a pole of their chart, where they describe the surface turned inside out."""
    if kind in (SPHERE, ELLIPSOID):
        return math.cos(u2) < 0.0
    if kind == REVOLUTION and chart == 0:
        for end in range(2):
            if shape[POLES + end] != 0.0 and from_end(shape, end, u2) < 0.0:
                return True
    return False


@kernel
def turned_back(kind, chart, shape, u1, u2):
    """Parameters within the chart's poles of the same point, for (u1, u2) that may have run over one."""
    if is_across_pole(kind, chart, shape, u2):
        middle = 0.5 * math.pi
        if kind == REVOLUTION:
            middle = shape[ENDS] if u2 < shape[ENDS] else shape[ENDS + 1]
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
            # the cap at the low end turns the other way round its pole
            inwards, distance = 3.0 - 2.0 * chart, math.hypot(u1, u2)
            u1, u2 = math.atan2(-inwards * u2, u1), shape[ENDS + chart - 1] + inwards * distance
        if new_chart != 0:
            inwards, distance = 3.0 - 2.0 * new_chart, from_end(shape, new_chart - 1, u2)
            u1, u2 = distance * math.cos(u1), -inwards * distance * math.sin(u1)
    return u1, u2
