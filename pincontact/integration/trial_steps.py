"""One Runge-Kutta step: its stages, its dense output, and what is looked at along it."""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..dynamics.resistance import count_items
from ..jit import BOOLEAN, INTEGER, NOTHING, REAL, kernel
from ..layout import EVENT, EVENTS_PER_CONTACT, NOT_FINITE, OK, SYSTEM
from ..workspace import flat
from .dense import dense_coefficients, interpolate
from .resolution import event_function_error, keep_event_functions
from .slip_at_ends import turns_round
from .stages import build_state, error_norm, evaluate, fill_slope, hand_over, hand_over_start

# Error of a step in which slip turns round: no polynomial has it.
_TURNED = 1e4


@kernel
def keep_slope(system, index):
    """Slope number `index` from the last evaluation, of the state in STAGE_STATE."""
    fill_slope(system, system.stage_state, system.slopes[index])
    keep_event_functions(system, index)


@separate_kernel(INTEGER, SYSTEM.type, REAL)
def start(system, t):
    """Evaluate at STATE and store its slope; a status."""
    hand_over_start(system)
    status = evaluate(system, t, 0)
    if status <= EVENT:
        keep_slope(system, 0)
    return status


@separate_kernel(INTEGER, SYSTEM.type, REAL, REAL, INTEGER, INTEGER, BOOLEAN)
def _stages(system, t, h, first, last, adaptive):
    """Stages first .. last of a step of size h from the state at t; a status.

    adaptive: leave the step's end unevaluated where the error estimate already rejects it.
    """
    scalars, counters, nodes = system.scalars, system.counters, system.nodes
    end, estimate_after = system.sizes.nstages, counters.estimate_after
    scalars.step = h
    for s in range(first, last + 1):
        if adaptive and s == end and end > estimate_after and scalars.error_norm >= 1.0:
            break
        if s == first or s > end:
            build_state(system, s)
        status = evaluate(system, t + nodes[s] * h, 0)
        if status > EVENT:
            return status
        if status == EVENT:
            counters.alarm = 1
        keep_slope(system, s)
        if s < end:
            build_state(system, s + 1)
        if s == estimate_after:
            scalars.error_norm = error_norm(system, s)
            if not scalars.error_norm < math.inf:
                return NOT_FINITE
    return OK


@separate_kernel(INTEGER, SYSTEM.type, REAL, REAL, BOOLEAN)
def trial_step(system, t, h, adaptive):
    """A step of size h from the state at t, which is kept.

    ALARM tells whether an event function was negative in a stage, or may have been between two. adaptive: their
    resolution counts as an error, too (see `resolution`).
    """
    counters = system.counters
    n = EVENTS_PER_CONTACT * count_items(system)
    lowest, highest = flat(system.lowest), flat(system.highest)
    for i in range(n):
        lowest[i], highest[i] = math.inf, -math.inf
    counters.alarm = 0
    status = _stages(system, t, h, 1, system.sizes.nstages, adaptive)
    dip = system.scalars.dip
    for i in range(n):
        # written such that infinite event functions compare
        if (1.0 + dip) * lowest[i] < dip * highest[i]:
            counters.alarm = 1
    if adaptive and status <= EVENT and system.scalars.error_norm < 1.0:
        event_function_error(system)
        if turns_round(system):
            system.scalars.error_norm = max(system.scalars.error_norm, _TURNED)
    return status


@separate_kernel(INTEGER, SYSTEM.type, REAL, REAL)
def interpolation(system, t, h):
    """The extra stages and the coefficients of dense output for the trial step of size h from t; a status."""
    scalars = system.scalars
    first = system.sizes.nstages + 1
    extra = system.counters.extra_stages
    scalars.dense_start, scalars.dense_step = t, h
    status = _stages(system, t, h, first, first + extra - 1, False)
    if status <= EVENT:
        dense_coefficients(system)
    return status


@separate_kernel(NOTHING, SYSTEM.type, REAL)
def load_interpolated(system, theta):
    """Hand over the state at the fraction theta of the step that was interpolated last."""
    interpolate(system.dense, system.state, system.counters.dense_nested, theta, system.stage_state)
    hand_over(system, system.stage_state)
