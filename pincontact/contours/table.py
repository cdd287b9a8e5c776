"""One compiled dispatch over all kinds of contours."""

from __future__ import annotations

from ..arrays import view
from ..jit import CALLED, INTEGER, REAL, entry_kernel, kernel
from .base import (
    CYCLOID,
    FOURIER_CURVE,
    HEIGHT_FIELD,
    PLANE,
    POINT,
    REVOLUTION,
    TAPE_CURVE,
    TAPE_SURFACE,
    TORUS,
)
from .charts import convert_chart, preferred_chart
from .curves import closed_form_curve, fourier_curve
from .piecewise import piecewise
from .points import point
from .revolution import revolution_source, revolve
from .splines import lift
from .surfaces import closed_form_surface, plane
from .tape import tape

__all__ = ["convert_chart", "evaluate", "evaluate_contours", "preferred_chart"]


@kernel
def evaluate(kind, chart, shape, pool, u1, u2, t, out):
    """Fill out (10, 3) with f and its derivatives (rows F .. F_TT of `base`), contour frame.

    Rows of time derivatives are written by time-dependent kinds only; the caller keeps them zero otherwise. Rows
    of derivatives by parameters that the contour does not have are not written.
    """
    if kind == POINT:
        point(out)
    elif kind <= CYCLOID:
        closed_form_curve(kind, shape, u1, out)
    elif kind == PLANE:
        plane(u1, u2, out)
    elif PLANE < kind <= TORUS:
        closed_form_surface(kind, chart, shape, u1, u2, out)
    elif kind == FOURIER_CURVE:
        fourier_curve(shape, pool, u1, out)
    else:
        # Kinds made of a tape or of piecewise polynomials; each of the two is compiled in at one place.
        start, argument, traced = 0, u1, kind in (TAPE_CURVE, TAPE_SURFACE)
        if kind == REVOLUTION:
            start, argument, traced = revolution_source(chart, shape, pool, u1, u2)
        if traced:
            tape(pool[start:], argument, u2, t, out)
        else:
            piecewise(pool[start:], argument, u2, t, out)
        if kind == REVOLUTION:
            revolve(chart, shape, pool, u1, u2, out)
        elif kind == HEIGHT_FIELD:
            lift(u1, u2, out)


@entry_kernel(INTEGER, INTEGER, REAL[::1], REAL[::1], REAL[:, ::1], REAL, REAL[:, :, ::1], when=CALLED)
def evaluate_contours(kind, chart, shape, pool, u, t, out):
    """`evaluate` for callers in Python, at parameters u (n, 2) into out (n, 10, 3)."""
    for i in range(u.shape[0]):
        evaluate(kind, chart, view(shape), view(pool), u[i, 0], u[i, 1], t, view(out)[i])
