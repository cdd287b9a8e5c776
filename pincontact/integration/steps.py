"""Whole steps in compiled code, one call for many: trial steps, step control and projection.

The loop comes back to Python only for what needs it: an event function that became negative, an output, a user's
function, the end of slip, a failure. Pinocchio is called from inside (see `callback`).
"""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..dynamics.resistance import count_items
from ..geometry.chart_changes import change_charts
from ..jit import BOOLEAN, INTEGER, REAL, entry_kernel, kernel
from ..layout import EVENT, OK, SYSTEM, system_at
from .approach import bound_speeds, stay_apart
from .crossings import find_earliest, find_zero, look, scan_on
from .projection import TO_KEEP, TO_SHOW, TO_STEP_ON, project, project_places
from .recording import BLOCK, announce_output, output_done, record_row
from .resolution import set_event_functions_aside, take_event_functions_up
from .slip_at_ends import begin_next, note_end, slip_ends, time_to_stop, watch_slips
from .stages import fill_slope, hand_over, keep_velocity
from .step_control import BATCH, FAILED_FACTOR, SLIVER, first_step, irregular, next_step
from .trial_steps import interpolation, keep_slope, load_interpolated, start, trial_step

# What `run_task` does.
(
    TRIAL_STEP,
    INTERPOLATION_STAGES,
    PROJECT,
    PROJECT_EVALUATED,
    ACCEPT,
    START,
    FINISH_STEP,
    RECORD,
    WRITE_OUTPUTS,
    INTEGRATE,
    INTEGRATE_ONE_STEP,
    INTEGRATE_ONE_TRIAL,
    INTEGRATE_APART,
    PROJECT_PLACES,
    FIRST_STEP,
    KEEP_VELOCITY,
    LOOK,
    BOUND_SPEEDS,
    SCAN_ON,
    FIND_ZERO,
    FIND_EARLIEST,
) = range(21)

# What INTEGRATE comes back with.
(
    INTEGRATING,
    STEPPED,
    TRIED,
    SLIP_ENDS,
    SLIP_IS_SLOW,
    STEP_FAILED,
    PROJECTION_FAILED,
    AT_FLOOR,
    AT_LIMIT,
    MAY_TOUCH,
) = range(10)
# What WRITE_OUTPUTS comes back with, besides a status: there is no room for more rows.
BLOCK_FULL = 100


@separate_kernel(INTEGER, SYSTEM.type, REAL, BOOLEAN)
def write_outputs(system, until, inclusive):
    """Record the output times before `until`, or up to it, of the step that was interpolated last.

    Each is projected on the constraints. A status, or BLOCK_FULL.
    """
    scalars, counters = system.scalars, system.counters
    while scalars.next_output < until or (inclusive and scalars.next_output == until):
        if counters.recorded == BLOCK:
            return BLOCK_FULL
        t = scalars.next_output
        load_interpolated(system, (t - scalars.dense_start) / scalars.dense_step)
        status = project(system, t, False, TO_SHOW, math.inf)
        if status != OK:
            return status
        record_row(system, t)
        output_done(system)
    return OK


@kernel
def accept(system):
    """The projected state becomes the next step's start; its slope is that of the last evaluation."""
    keep_slope(system, 0)
    state, stage_state = system.state, system.stage_state
    for i in range(system.sizes.ny):
        state[i] = stage_state[i]


@kernel
def _better_charts(system, t):
    """Other charts for STATE where there are better ones, and its slope in them; a status."""
    if system.counters.charted != 0 and change_charts(system) > 0:
        return start(system, t)
    return OK


@separate_kernel(INTEGER, SYSTEM.type, REAL)
def finish_step(system, t):
    """What follows every accepted state: better charts, and what the next step is held against; a status."""
    status = _better_charts(system, t)
    if status <= EVENT:
        note_end(system)
        begin_next(system)
        status = OK
    return status


@kernel
def _set_aside(system):
    """Keep the end of a step, projected and evaluated, while outputs within the step are evaluated."""
    stage_state, next_state = system.stage_state, system.next_state
    fill_slope(system, stage_state, system.next_slope)
    set_event_functions_aside(system)
    for i in range(system.sizes.ny):
        next_state[i] = stage_state[i]
    note_end(system)


@kernel
def _take_up(system, t):
    """Go on from what was set aside; a status. The last evaluation is another one, unless charts were changed."""
    state, stage_state = system.state, system.stage_state
    slope = system.slopes[0]
    next_state, next_slope = system.next_state, system.next_slope
    for i in range(system.sizes.ny):
        state[i] = stage_state[i] = next_state[i]
        slope[i] = next_slope[i]
    take_event_functions_up(system)
    hand_over(system, stage_state)
    begin_next(system)
    return _better_charts(system, t)


@separate_kernel(INTEGER, SYSTEM.type, INTEGER, REAL, REAL, REAL)
def _complete(system, task, t, step, error):
    """Outputs, projection and acceptance of the trial step from t, of this size and error norm; OK, or what Python is
    needed for."""
    scalars, counters, t_new = system.scalars, system.counters, system.scalars.next_time
    inside, done, recorded = scalars.next_output < t_new, counters.outputs_done, counters.recorded
    # what is not shown may be a little off, and outputs within the step need not cost the end's evaluation
    ahead = inside and task == INTEGRATE and project(system, t_new, True, TO_STEP_ON, error) == OK
    if ahead:
        _set_aside(system)
    if inside:
        if interpolation(system, t, step) > EVENT or write_outputs(system, t_new, False) != OK:
            return TRIED
        new_state, stage_state = system.new_state, system.stage_state
        for i in range(system.sizes.ny):
            stage_state[i] = new_state[i]
        hand_over(system, stage_state)
    if ahead and scalars.next_output > t_new:
        if _take_up(system, t_new) > EVENT:
            return PROJECTION_FAILED
        scalars.now = t_new
    else:
        shown = task not in (INTEGRATE, INTEGRATE_APART) or counters.record_steps != 0 or scalars.next_output == t_new
        if project(system, t_new, not inside, TO_KEEP if shown else TO_STEP_ON, error) != OK:
            # what was written of the step goes with it
            counters.outputs_done, counters.recorded = done, recorded
            announce_output(system)
            return PROJECTION_FAILED
        accept(system)
        scalars.now = t_new
        if finish_step(system, t_new) > EVENT:
            return PROJECTION_FAILED
    if counters.record_steps != 0:
        record_row(system, t_new)
    while scalars.next_output <= t_new and counters.recorded < BLOCK:
        record_row(system, t_new)
        output_done(system)
    return OK


@separate_kernel(INTEGER, SYSTEM.type, INTEGER)
def integrate(system, task):
    """Steps from NOW towards END until Python is needed; what for.

    INTEGRATING: not yet, call again; STEPPED: a step was accepted, which INTEGRATE_ONE_STEP asks for, or END was
    reached, or there is no room for more rows (at the call there must be some); SLIP_IS_SLOW: so many steps were stiff
    as PATIENCE allows; TRIED: a step is within its error, but neither projected nor accepted: an event function was
    negative, or its outputs could not all be written, or INTEGRATE_ONE_TRIAL asks for it; SLIP_ENDS; STEP_FAILED:
    rejected because of the status in FAILURE; PROJECTION_FAILED; AT_FLOOR; AT_LIMIT: of trial steps; MAY_TOUCH: open
    contacts might in the next step, at which INTEGRATE_APART ends.
    """
    scalars, counters = system.scalars, system.counters
    n, end, fixed = count_items(system), scalars.end, scalars.fixed_step
    for _ in range(BATCH):
        t, h, remaining = scalars.now, scalars.next_step, scalars.end - scalars.now
        if counters.step_count + counters.rejected_count >= counters.trial_limit:
            return AT_LIMIT
        if slip_ends(system, n):
            return SLIP_ENDS
        if task == INTEGRATE_APART and not stay_apart(system, min(h, min(scalars.max_step, remaining))):
            return MAY_TOUCH
        stop = time_to_stop(system, n)
        if stop < scalars.floor:
            return SLIP_ENDS
        step = min(min(h, stop), min(irregular(counters.step_count) * scalars.max_step, remaining))
        if remaining - step < SLIVER * step:
            step = remaining
        if step < scalars.floor and step < remaining:
            return AT_FLOOR
        status = trial_step(system, t, step, fixed == 0.0)
        error = scalars.error_norm
        if status != OK or (fixed == 0.0 and error >= 1.0):
            counters.rejected_count += 1
            watch_slips(system, n, False)
            if status != OK:
                counters.failure = status
                scalars.next_step = FAILED_FACTOR * step
                return STEP_FAILED
            scalars.next_step = next_step(step, error, 0.0, scalars.error_order, True)
            continue
        counters.failure = OK
        proposal = fixed
        if fixed == 0.0:
            proposal = next_step(step, error, scalars.last_error, scalars.error_order, False)
            scalars.last_error = error
        # a step cut short for an output lets the next one grow tenfold; one cut by the end of slip tells nothing of the
        # steps that follow that
        larger = h if step == stop else min(h, 10.0 * step)
        scalars.next_step = proposal if step == h else max(proposal, larger)
        t_new = end if step == remaining else t + step
        scalars.next_time = t_new
        counters.step_count += 1
        if task == INTEGRATE_ONE_TRIAL or counters.alarm != 0:
            return TRIED
        result = _complete(system, task, t, step, error)
        if result != OK:
            return result
        if counters.stiff_steps >= counters.patience and fixed == 0.0:
            return SLIP_IS_SLOW
        if task == INTEGRATE_ONE_STEP or t_new >= end or counters.recorded == BLOCK:
            return STEPPED
    return INTEGRATING


@entry_kernel(INTEGER, INTEGER, REAL, REAL)
def run_task(address, task, t, h):
    """All tasks behind one entry, since they share their parts.

    Returns a status of `layout`; for the INTEGRATE tasks, which take their times from the scalars, what they came back
    for; for SCAN_ON and FIND_EARLIEST what these find.
    """
    return _run(system_at(address), task, t, h)


@kernel
def _run(system, task, t, h):
    # a part: what an entry kernel calls itself is compiled once more for those that are called by parts
    if task == TRIAL_STEP:
        return trial_step(system, t, h, False)
    if task == INTERPOLATION_STAGES:
        return interpolation(system, t, h)
    if task in (PROJECT, PROJECT_EVALUATED):
        return project(system, t, task == PROJECT_EVALUATED, TO_KEEP, h)
    if task == PROJECT_PLACES:
        return project_places(system, t)
    if task == ACCEPT:
        accept(system)
        return OK
    if task == START:
        return start(system, t)
    if task == RECORD:
        record_row(system, t)
        return OK
    if task == WRITE_OUTPUTS:
        return write_outputs(system, t, True)
    if task == FINISH_STEP:
        return finish_step(system, t)
    if task == FIRST_STEP:
        first_step(system, t, h)
        return OK
    if task == LOOK:
        look(system, t, h)
        return OK
    if task == SCAN_ON:
        return scan_on(system, t, h)
    if task == FIND_ZERO:
        find_zero(system, t, h, system.counters.sought_item, system.counters.sought_kind)
        return OK
    if task == FIND_EARLIEST:
        return find_earliest(system, t, h)
    if task == BOUND_SPEEDS:
        bound_speeds(system)
        return OK
    if task == KEEP_VELOCITY:
        keep_velocity(system, system.stage_state)
        return OK
    return integrate(system, task)
