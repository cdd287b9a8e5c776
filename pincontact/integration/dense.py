"""Dense output: the solution within a step, as a polynomial of the fraction theta of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..arrays import array_entry
from ..callback import separate_kernel
from ..jit import INTEGER, NOTHING, REAL, kernel
from ..layout import DENSE_ROWS, MAX_STAGES, SYSTEM

if TYPE_CHECKING:
    from ..dynamics.system import System


@separate_kernel(NOTHING, SYSTEM.type)
def dense_coefficients(system):
    """Fill DENSE from the slopes of the trial step: row i is h sum_j w_ij k_j + w_i (y_1 - y_0).

    The weight of the difference stands behind those of the stages.
    """
    ny = system.sizes.ny
    step = system.scalars.step
    state, new_state = system.state, system.new_state
    slopes = system.slopes
    weights = system.dense_weights
    dense = system.dense
    for row in range(DENSE_ROWS):
        out, weight = dense[row], weights[row]
        for i in range(ny):
            out[i] = 0.0
        for j in range(MAX_STAGES):
            if weight[j] != 0.0:
                for i in range(ny):
                    out[i] += weight[j] * slopes[j, i]
        for i in range(ny):
            out[i] = step * out[i] + weight[MAX_STAGES] * (new_state[i] - state[i])


@kernel
def interpolate(dense, start, nested, theta, out):
    """out = the state at the fraction theta of a step from `start`.

    Horner's scheme with factors theta, or theta and 1 - theta by turns (Hairer's nested form of DOP853).
    """
    for i in range(start.shape[0]):
        out[i] = 0.0
    for row in range(dense.shape[0] - 1, -1, -1):
        factor = 1.0 - theta if nested != 0 and row % 2 == 1 else theta
        for i in range(start.shape[0]):
            out[i] = (out[i] + dense[row, i]) * factor
    for i in range(start.shape[0]):
        out[i] += start[i]


@array_entry(REAL[:, ::1], REAL[::1], INTEGER, REAL, REAL[::1])
def fill_interpolated(dense, start, nested, theta, out):
    """`interpolate` for callers in Python."""
    interpolate(dense, start, nested, theta, out)


class Interpolant:
    """y(theta) for theta in [0, 1] of the step that a system has tried; keeps what it needs."""

    def __init__(self, system: System) -> None:
        self._start, self._dense = system.state.copy(), system.dense.copy()
        self._nested = system.counters.dense_nested

    def __call__(self, theta: float) -> np.ndarray:
        out = np.empty_like(self._start)
        fill_interpolated(self._dense, self._start, self._nested, theta, out)
        return out
