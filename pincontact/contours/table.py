"""One compiled dispatch over all kinds of contours."""

from __future__ import annotations

from ..jit import INTEGER, REAL, entry_kernel, kernel
from .base import CIRCLE, LINE, PLANE, POINT, SPHERE, TAPE_CURVE, TAPE_SURFACE
from .curves import circle, line
from .points import point
from .surfaces import plane, sphere
from .tape import tape


@kernel
def evaluate(kind, chart, shape, pool, u1, u2, t, out):
    """Fill out (10, 3) with f and its derivatives (rows F .. F_TT of `base`), contour frame.

    Rows of time derivatives are written by time-dependent kinds only; the caller keeps them zero otherwise.
    """
    if kind == POINT:
        point(out)
    elif kind == CIRCLE:
        circle(shape, u1, out)
    elif kind == PLANE:
        plane(u1, u2, out)
    elif kind == SPHERE:
        sphere(chart, shape, u1, u2, out)
    elif kind == LINE:
        line(u1, out)
    elif kind in (TAPE_CURVE, TAPE_SURFACE):
        tape(pool, u1, u2, t, out)


@kernel
def preferred_chart(kind, chart, shape, u1, u2):
    """The chart in which the point (u1, u2) of `chart` is well described: `chart` itself where it is."""
    return chart


@kernel
def convert_chart(kind, shape, pool, chart, u1, u2, new_chart):
    """Parameters (u1, u2) in new_chart of the point that has parameters (u1, u2) in chart."""
    return u1, u2


@entry_kernel(INTEGER, INTEGER, REAL[::1], REAL[::1], REAL, REAL, REAL, REAL[:, ::1])
def evaluate_contour(kind, chart, shape, pool, u1, u2, t, out):
    """`evaluate` for callers in Python."""
    evaluate(kind, chart, shape, pool, u1, u2, t, out)
