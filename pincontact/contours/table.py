"""Contours in compiled code: kinds with a closed form, and kinds made of formulas or piecewise polynomials.

Each of both is an entry kernel that others call by its address, so that it is compiled once, and not before a contour
needs it.
"""

from __future__ import annotations

import numpy as np

from ..arrays import address, view
from ..callback import kernel_address, kernel_caller
from ..jit import CALLED, INTEGER, REAL, entry_kernel, kernel
from ..workspace import matrix_at, reals_at
from .base import (
    CYCLOID,
    DERIVATIVE_ROWS,
    FOURIER_CURVE,
    HEIGHT_FIELD,
    PLANE,
    POINT,
    REVOLUTION,
    SHAPE_SIZE,
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

__all__ = ["call_contour", "contour_address", "convert_chart", "evaluate_contours", "preferred_chart"]

ROWS = DERIVATIVE_ROWS
_ARGUMENTS = (INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, REAL, REAL, REAL, INTEGER)
# `call_contour(contour, kind, chart, shape, pool, pool_size, u1, u2, t, out)`: f and its derivatives (rows F .. F_TT of
# `base`), contour frame, by the kernel at address `contour`. shape, pool, out: addresses of (SHAPE_SIZE,), (pool_size,)
# and (10, 3). Rows of time derivatives are written by time-dependent kinds only; the caller keeps them zero otherwise.
# Rows of derivatives by parameters that the contour does not have are not written.
call_contour = kernel_caller(INTEGER, *_ARGUMENTS)


@kernel
def _closed_form(kind, chart, shape, pool, u1, u2, out):
    if kind == POINT:
        point(out)
    elif kind <= CYCLOID:
        closed_form_curve(kind, shape, u1, out)
    elif kind == PLANE:
        plane(u1, u2, out)
    elif PLANE < kind <= TORUS:
        closed_form_surface(kind, chart, shape, u1, u2, out)
    else:
        fourier_curve(shape, pool, u1, out)


@kernel
def _composed(kind, chart, shape, pool, u1, u2, t, out):
    # a tape and piecewise polynomials are compiled in at one place each
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


@entry_kernel(*_ARGUMENTS)
def closed_form_at(kind, chart, shape, pool, pool_size, u1, u2, t, out):
    """See `call_contour`."""
    _closed_form(kind, chart, reals_at(shape, SHAPE_SIZE), reals_at(pool, pool_size), u1, u2, matrix_at(out, ROWS, 3))
    return 0


@entry_kernel(*_ARGUMENTS, when=CALLED)
def composed_at(kind, chart, shape, pool, pool_size, u1, u2, t, out):
    """See `call_contour`."""
    _composed(kind, chart, reals_at(shape, SHAPE_SIZE), reals_at(pool, pool_size), u1, u2, t, matrix_at(out, ROWS, 3))
    return 0


def contour_address(kind: int) -> int:
    """Where `call_contour` finds the kernel of a kind of contour."""
    closed = kind in (POINT, PLANE, FOURIER_CURVE) or kind <= CYCLOID or PLANE < kind <= TORUS
    return kernel_address(closed_form_at if closed else composed_at)


def evaluate_contours(
    kind: int, chart: int, shape: np.ndarray, pool: np.ndarray, u: np.ndarray, t: float, out: np.ndarray
) -> None:
    """f and its derivatives at parameters u (n, 2) into out (n, 10, 3), for callers in Python."""
    evaluate_all(contour_address(kind), kind, chart, shape, pool, u, t, out)


@entry_kernel(INTEGER, INTEGER, INTEGER, REAL[::1], REAL[::1], REAL[:, ::1], REAL, REAL[:, :, ::1], when=CALLED)
def evaluate_all(contour, kind, chart, shape, pool, u, t, out):
    """`call_contour` at parameters u (n, 2) into out (n, 10, 3)."""
    for i in range(u.shape[0]):
        at = address(view(out)[i])
        call_contour(
            contour, kind, chart, address(view(shape)), address(view(pool)), pool.size, u[i, 0], u[i, 1], t, at
        )
