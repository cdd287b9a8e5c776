"""Whole steps of Moreau's method in compiled code, one call for many: see `impulses` for what a step is.

The loop comes back to Python for what is rare: a cone problem that the usual ways do not solve, a change of
modes, which is an event, an output in which something is about to slip, a user's event function, a failure. Where it
was left within a step it goes on from there.
"""

from __future__ import annotations

import math

from ..callback import kernel_caller
from ..dynamics.energy import REST_SPEED
from ..dynamics.evaluation import KINEMATICS_OF_ALL
from ..geometry.carriers import OMEGA
from ..geometry.small import dot
from ..jit import INTEGER, REAL, STEPPING, entry_kernel, kernel
from ..layout import (
    DOMAIN,
    FREE,
    FRICTIONLESS,
    FROZEN,
    JOINT_END,
    LENGTH,
    MODE,
    MU,
    NOT_FINITE,
    OK,
    ROLLING,
    SLIP_SIGN,
    SLIPPING,
    SPINNING,
    STICK,
    SYSTEM,
    TANGENTS,
    UNILATERAL,
    system_at,
)
from .accuracy import APART_AT_END, REST, SHALLOW
from .impulse_layout import JOINT_MOVES, ROLL, SLIP, SPIN, step_at
from .impulse_trial import APPROVED, CONE_LEFT, FRESH, TAKEN, ask, call_task, find_joint_states, trial_step
from .impulse_velocities import relative_turning
from .impulses import commit, commit_contact
from .recording import BLOCK, output_done
from .stages import evaluate, hand_over_start
from .step_control import BATCH, SLIVER
from .steps import RECORD

# What `run_steps` does.
RELOCATE, BEGIN, ACCEPT, TRY, STEP, INTEGRATE = range(6)
# What it comes back with, besides a status and CONE_LEFT: call again; and from INTEGRATE: the end, the limit of steps;
# a step is tried, not accepted; an output is to be recorded (its torques are set), at the end of the last step, or in
# the trial step.
GOING_ON, AT_END, AT_LIMIT, TRIED, OUTPUT_LEFT, INNER_OUTPUT_LEFT = range(CONE_LEFT + 1, CONE_LEFT + 7)


_call_on_system = kernel_caller(INTEGER, SYSTEM.type)


@kernel
def _begin_contact(system, step, c, largest):
    """Clear what the last step left of contact c; a closed one gets the mode that its v_c shows."""
    contact, mu, length = system.contact_int[c], system.contact_real[c, MU], system.contact_real[c, LENGTH]
    basis, slip = system.basis[c], system.slip[c]
    first, second, normal = dot(basis[0], slip), dot(basis[1], slip), dot(basis[2], slip)
    step.touch_time[c], step.load[c], step.start_domain[c] = -1.0, 0.0, math.inf
    for i in range(3):
        step.forces[c, i] = step.torques[c, i] = 0.0
        step.motion[c, i] = 0
    # deeper than a step could have brought it there from the near side, or than has just touched
    reach = step.numbers.step_size * abs(normal) + APART_AT_END * length
    if normal <= REST * largest:
        reach = max(reach, SHALLOW * length)
    step.start_gap[c], inside = system.gaps[c, 0], system.contact_real[c, DOMAIN] >= 0.0
    step.behind[c] = 1 if contact[MODE] == FREE and inside and system.gaps[c, 0] < -reach else 0
    if contact[MODE] == FREE:
        return
    if contact[UNILATERAL] != 0 and normal < -REST_SPEED:
        # touches in the first step
        contact[MODE] = FREE
        return
    speed = abs(first) if contact[TANGENTS] == 1 else math.hypot(first, second)
    contact[FROZEN] = 0
    if speed > REST * largest and 0.0 < mu < math.inf:
        contact[MODE] = SLIPPING
    else:
        contact[MODE] = FRICTIONLESS if mu == 0.0 else STICK
    contact[SLIP_SIGN] = 1 if first >= 0.0 else -1
    step.motion[c, SLIP] = contact[MODE]
    two = contact[TANGENTS] == 2
    if system.contact_real[c, ROLLING] > 0.0:
        turning = relative_turning(system, c, 0 if two else 1, OMEGA)
        if two:
            turning = math.hypot(turning, relative_turning(system, c, 1, OMEGA))
        step.motion[c, ROLL] = SLIPPING if abs(turning) > REST * largest else STICK
    if system.contact_real[c, SPINNING] > 0.0:
        turning = abs(relative_turning(system, c, 2, OMEGA))
        step.motion[c, SPIN] = SLIPPING if turning > REST * largest else STICK


@kernel
def _evaluate_start(system, t):
    """Kinematics at STATE, which becomes STAGE_STATE; a status."""
    hand_over_start(system)
    return evaluate(system, t, KINEMATICS_OF_ALL)


@kernel
def _relocate(system, step, t):
    """Start the next step with contact coordinates of open contacts that others have set in STATE; a status."""
    status = _evaluate_start(system, t)
    for c in range(system.sizes.nc):
        if status == OK and system.contact_int[c, MODE] == FREE:
            step.start_gap[c] = system.gaps[c, 0]
            commit_contact(system, step, c, 0)
    return status


@kernel
def _begin(system, step, t):
    """Make STATE what is to be accepted; closed contacts get the mode that their v_c shows. A status of `layout`."""
    nv, nc = system.sizes.nv, system.sizes.nc
    status = _evaluate_start(system, t)
    if status != OK:
        return status
    largest = 1.0
    for k in range(nv):
        largest = max(largest, abs(system.v[k]))
        step.joint_impulse[k] = 0.0
    for c in range(nc):
        _begin_contact(system, step, c, largest)
    # joints at their stops are found by the first step
    for g in range(system.joint_count[0]):
        system.contact_int[nc + g, MODE], system.joint_int[g, JOINT_END] = FREE, 0
        step.joint_state[g], step.limit_time[g] = JOINT_MOVES, -1.0
    find_joint_states(system, step)
    step.counts.touched = 0
    return OK


@kernel
def _accept(system, step, t, stepped):
    """STAGE_STATE, at t, becomes the start; see `commit`. counts.changed: whether modes, signs or charts did."""
    may_move = stepped != 0 and system.counters.charted != 0
    while True:
        changed = commit(system, step, stepped)
        if not may_move or _call_on_system(step.calls.move_charts, system) == 0:
            break
        _evaluate_start(system, t)
        may_move, stepped = False, 0
    step.counts.changed = 1 if changed else 0


@kernel
def _happens(system, step):
    """Whether a contact has another mode after the trial step, or touched in it, or what it resists, or a limited
    coordinate, does what it did not before."""
    happens = False
    for g in range(system.joint_count[0]):
        happens = happens or step.start_joint[g] != step.joint_state[g]
    for c in range(system.sizes.nc):
        happens = happens or step.touch_time[c] >= 0.0 or step.start_mode[c] != system.contact_int[c, MODE]
        for motion in range(3):
            happens = happens or step.start_motion[c, motion] != step.motion[c, motion]
    return happens


@kernel
def _output(system, step, t):
    """Record the state at t: OK, OUTPUT_LEFT (its torques are set) or NOT_FINITE."""
    if not ask(system, step, t):
        return NOT_FINITE
    counts, counters = step.counts, system.counters
    if counters.recorded == BLOCK or counts.turns != 0:
        return OUTPUT_LEFT
    nv, h = system.sizes.nv, step.numbers.h
    tau, kept, impulse = system.tau, step.set_aside, step.joint_impulse
    for k in range(nv):
        # forces of limits and dry friction go with the torques, so that contact forces can be found again
        kept[k] = tau[k]
        tau[k] += impulse[k] / h
    call_task(step.calls.run_task, system, RECORD, t, 0.0)
    for k in range(nv):
        tau[k] = kept[k]
    return OK


@kernel
def _next_row(system, step):
    """Write q and v as a row, where rows are wanted; whether steps to another one begin, with what is given for it."""
    counts, sizes = step.counts, system.sizes
    row, rows = counts.rows_done, counts.row_count
    if row >= rows:
        return False
    nq, nv = sizes.nq, sizes.nv
    state = system.state
    row_q, row_v = step.rows_q[row], step.rows_v[row]
    for i in range(nq):
        row_q[i] = state[i]
    for k in range(nv):
        row_v[k] = state[nq + k]
    counts.rows_done = row + 1
    if row + 1 == rows:
        return False
    tau, row_tau = system.tau, step.rows_tau[row + 1]
    for k in range(nv):
        tau[k] = row_tau[k]
    if counts.targeted != 0:
        target, row_target = step.target, step.rows_target[row + 1]
        for i in range(nq):
            target[i] = row_target[i]
    counts.last += counts.row_steps
    return True


@kernel
def _run(system, step, task, found, t, h):
    # one loop for all tasks: code that is called from one place is compiled once
    counts, numbers, scalars = step.counts, step.numbers, system.scalars
    every_step = system.counters.record_steps != 0
    start, size = numbers.run_start, numbers.step_size
    slack = SLIVER * size
    if task == RELOCATE:
        return _relocate(system, step, t)
    if task == BEGIN:
        status = _begin(system, step, t)
        if status != OK:
            return status
    for _ in range(BATCH):
        t_new, inside = t, False
        if task in (STEP, INTEGRATE):
            # steps are counted, so that their rounding does not add up
            i = counts.steps
            t, t_new, h = start + i * size, start + (i + 1) * size, size
            if task == INTEGRATE:
                if i >= counts.last:
                    return AT_END
                if i >= counts.step_limit:
                    return AT_LIMIT
                if i == counts.last - 1:
                    t_new = numbers.run_end
                # an output inside a step is the end of a shorter one, which is then dropped
                inside = scalars.next_output < t_new - slack
                h = (scalars.next_output if inside else t_new) - t
                if abs(h - size) <= slack:
                    # not what rounding has made of it
                    h = size
        taken = found == TAKEN
        approved = taken or found == APPROVED
        if task >= TRY and not approved:
            status = trial_step(system, step, t, h, found)
            if status != OK or task == TRY:
                return status
        found = FRESH
        if not inside:
            if task == INTEGRATE and not approved and (counts.watched != 0 or _happens(system, step)):
                return TRIED
            if not taken:
                _accept(system, step, t_new, 0 if task == BEGIN else 1)
            if task < TRY:
                return OK
            counts.steps += 1
            if task == STEP:
                if counts.steps >= counts.last and not _next_row(system, step):
                    return OK
                continue
        while inside or every_step or scalars.next_output <= t_new + slack:
            status = _output(system, step, scalars.next_output if inside else t_new)
            if status != OK:
                return INNER_OUTPUT_LEFT if inside and status == OUTPUT_LEFT else status
            if every_step:
                break
            output_done(system)
            if inside:
                break
    return GOING_ON


@entry_kernel(INTEGER, INTEGER, INTEGER, INTEGER, REAL, REAL, when=STEPPING)
def run_steps(system_address, step_address, task, found, t, h):
    """A status of `layout`, or what Python is needed for: see CONE_LEFT.

    task: BEGIN at t; RELOCATE open contacts at t, where others have found them; TRY a step of size h from t, ACCEPT it
    at its end t; STEP, which is both until counts.last steps are done, and INTEGRATE, steps and outputs until Python is
    needed, take their times from the step's numbers. found: FRESH, or what has become of the cone problem that the last
    call with this task left, or APPROVED for the step that INTEGRATE came back with as TRIED, or TAKEN.
    """
    return _run(system_at(system_address), step_at(step_address), task, found, t, h)
