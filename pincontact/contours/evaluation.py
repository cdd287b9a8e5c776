"""Evaluation of contours in compiled code: one kernel for each shape, called by its address.

Such a kernel has the parameters

    chart      which of the contour's charts u1 and u2 belong to
    shape      (SHAPE_SIZE,) the contour's shape parameters
    pool       (n,) its further numbers
    u1, u2, t  parameters and time in s
    out        (10, 3) rows that it fills, in the contour's frame

It writes the rows of f and of its first and second derivatives by the parameters that the contour has; those by time
only if the contour depends on time: they stay zero otherwise. Each is compiled, once, when the first contour of its
shape is evaluated.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..arrays import REALS, array_entry, array_type
from ..callback import kernel_address, kernel_caller
from ..jit import CALLED, INTEGER, NOTHING, REAL, entry_kernel

_NUMBERS, _ROWS = array_type(REALS, 1), array_type(REALS, 2)
_ARGUMENTS = (INTEGER, _NUMBERS, _NUMBERS, REAL, REAL, REAL, _ROWS)
# `call_contour(evaluator, chart, shape, pool, u1, u2, t, out)`: the kernel at address `evaluator`.
call_contour = kernel_caller(NOTHING, *_ARGUMENTS)


def contour_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator of a kernel that evaluates a shape, with the parameters above."""
    return entry_kernel(*_ARGUMENTS, when=CALLED, from_python=False)(function)


def evaluate_contour(
    evaluator: Any, chart: int, shape: np.ndarray, pool: np.ndarray, u: np.ndarray, t: float, out: np.ndarray
) -> None:
    """f and its derivatives at parameters u (n, 2) into out (n, 10, 3), for callers in Python."""
    _evaluate_many(kernel_address(evaluator), chart, shape, pool, u, t, out)


@array_entry(INTEGER, INTEGER, REAL[::1], REAL[::1], REAL[:, ::1], REAL, REAL[:, :, ::1], when=CALLED)
def _evaluate_many(evaluator, chart, shape, pool, u, t, out):
    for i in range(u.shape[0]):
        call_contour(evaluator, chart, shape, pool, u[i, 0], u[i, 1], t, out[i])
