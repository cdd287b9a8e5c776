"""Index reduction with projection: q and v put back on the constraints, in the mass metric.

No gain to tune and no drift: Newton's iteration on the gaps with the factors of the last evaluation, and the exact
linear projection of the velocity. The order of the integrator is kept, since the correction is of the size of its
local error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..integration.stages import correct_state
from ..layout import CORRECTION_SIZE, EVENT, GAP_RESIDUAL, OK, VELOCITY_RESIDUAL
from .evaluation import contact_corrections

if TYPE_CHECKING:
    from .system import System

_ITERATIONS = 12
# A change of q below this needs no further evaluation: what it leaves in gaps and v_c is quadratic, or below round-off.
_NEGLIGIBLE = 1e-14
# Residual (m, and m/s relative to the speeds) below which nothing is corrected.
_ROUND_OFF = 1e-16


def project(system: System, t: float, evaluated: bool = False, evaluate: Callable[[float], int] | None = None) -> bool:
    """Correct (q, v) and the location of the system's STAGE_STATE; whether it converged.

    evaluated: the system has just been evaluated at that state, which saves one evaluation. evaluate: what to call
    instead of `system.evaluate` (an integrator that also applies a control).
    On return (q, v, location) of the system hold the corrected state, and its accelerations those of a state that
    differs by no more than round-off.
    """
    if system.nc == 0:
        return True
    scalars = system.scalars
    evaluate = evaluate or system.evaluate
    for _ in range(_ITERATIONS):
        if not evaluated and evaluate(t) not in (OK, EVENT):
            return False
        evaluated = False
        count = contact_corrections(system.table, 1, 1)
        if count == 0 or (scalars[GAP_RESIDUAL] <= _ROUND_OFF and scalars[VELOCITY_RESIDUAL] <= _ROUND_OFF):
            correct_state(system.table, 0, 0)
            return True
        correct_state(system.table, 1, 1)
        size = scalars[CORRECTION_SIZE]
        if size <= _NEGLIGIBLE * max(1.0, float(np.abs(system.q).max())):
            return True
        if not size < 1e3:
            return False
    return bool(scalars[GAP_RESIDUAL] < 1e-11)
