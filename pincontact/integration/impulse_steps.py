"""Whole steps of Moreau's method in compiled code, one call for many: see `impulses` for what a step is.

The loop comes back to Python for what is rare: a cone problem that the usual ways do not solve, a change of
modes, which is an event, an output in which something is about to slip, a user's event function, a failure. Where it
was left within a step it goes on from there.
"""

from __future__ import annotations

import math

from ..arrays import as_array
from ..callback import call_python, kernel_caller
from ..dynamics.energy import REST_SPEED
from ..dynamics.equations import inner
from ..dynamics.evaluation import KINEMATICS_OF_ALL, VELOCITIES_OF_ALL, torques_finite
from ..friction import cone
from ..friction.attempt import AFRESH, USUAL
from ..geometry.small import dot
from ..jit import INTEGER, REAL, STEPPING, entry_kernel, kernel
from ..layout import (
    DOMAIN,
    FREE,
    FRICTIONLESS,
    FROZEN,
    GUARD_END,
    LENGTH,
    LOCATION_FAILED,
    MODE,
    MU,
    NO_FORCE,
    NOT_FINITE,
    OK,
    SINGULAR,
    SLIP_SIGN,
    SLIPPING,
    STICK,
    SYSTEM,
    TANGENTS,
    TOO_LONG,
    UNILATERAL,
    system_at,
)
from ..workspace import square
from .carrying import carry
from .impulse_layout import (
    ACCELERATION,
    AHEAD,
    APART,
    ASKED,
    ASKED_WITH,
    ASSEMBLE,
    CALL_FAILED,
    CHANGED,
    CHOOSING,
    CONE_RESIDUAL,
    CONE_TASK,
    CONE_TOLERANCE,
    COUPLED,
    HAS_TREND,
    HELD,
    HOLDING,
    IMPACT,
    LAST,
    MEAN_VELOCITY,
    MISS,
    MOVE_CHARTS,
    ON_CONTACT,
    ON_TURN,
    OPEN_LOADS,
    PASSES,
    RIGID,
    RIGID_STEPS,
    ROW_COUNT,
    ROW_STEPS,
    ROWS_DONE,
    RUN_END,
    RUN_START,
    RUN_TASK,
    SOLVE_CONES,
    SOLVED_HERE,
    STEP_LIMIT,
    STEP_SIZE,
    STEPS,
    THOROUGH,
    TOUCHED,
    TREND_BEFORE,
    TURNS,
    UNASKED,
    UNIT_INDEX,
    UNIT_KIND,
    UNITS,
    WANTED,
    WATCHED,
    H,
    step_at,
)
from .impulse_layout import STEP as STEP_LAYOUT
from .impulse_problem import OPENING
from .impulse_review import AGAIN, may_rest
from .impulses import advance, commit, leave_turning_axes, predict_midpoint
from .recording import BLOCK, output_done
from .results import CLOSED_APART, CONTOUR_ENDS
from .stages import hand_over
from .steps import RECORD, SETTLE, evaluate

# What `run_steps` does.
BEGIN, ACCEPT, ATTEMPT, STEP, MARCH = range(5)
# What it comes back with, besides a status: a cone problem is to be solved; call again; and from MARCH: the end, the
# limit of steps; a step is attempted, not accepted; an output is to be recorded (its torques are set), at the end of
# the last step, or in the attempted one.
CONE_LEFT, MARCHING, AT_END, AT_LIMIT, ATTEMPTED, OUTPUT_LEFT, INNER_OUTPUT_LEFT = range(100, 107)
# What has become of the cone problem that the last call left, if it left one, or of the attempted step.
FRESH, SOLVED, UNSOLVED, APPROVED = range(4)

# Steps after which MARCH comes back all the same, for the keyboard's and the progress bar's sake.
_BATCH = 256
# A step is corrected where the velocity at its midpoint was off by this fraction, at most so many times; corrections
# that leave it off by the last have not converged.
_FAR = 0.06
_CORRECTIONS = 8
_LOST = 0.08
# Slip slower than this (m/s, relative to the largest velocity or 1) counts as rest where a run starts.
_REST = 1e-9
# Steps that end within this fraction of a step from the end, or from an output time, end there.
SLIVER = 1e-9
# Friction beyond its limit by less than this part of the loads on the joints is round-off.
_ROUND_OFF = 1e-11
# The last correction of gaps leaves so much of them, relative to the contact's length, only where the constraints
# contradict each other.
_APART = 1e-6
# Nearer to an end of its domain (in its units) a point is at it.
_AT_END = 1e-12

_call_task = kernel_caller(INTEGER, SYSTEM.type, INTEGER, REAL, REAL)
_call_on_step = kernel_caller(INTEGER, SYSTEM.type, STEP_LAYOUT.type)
_call_on_system = kernel_caller(INTEGER, SYSTEM.type)
_call_cones = kernel_caller(
    REAL, REAL[:, ::1], REAL[::1], REAL[::1], cone.CONE.type, INTEGER, INTEGER, REAL, INTEGER, INTEGER
)  # fmt: skip


@kernel
def _begin(system, step, t):
    """Make STATE what is to be accepted; closed contacts get the mode that their v_c shows. A status."""
    sizes = system.sizes
    nv, nc, ny = sizes.nv, sizes.nc, sizes.ny
    state, stage_state = system.state, system.stage_state
    for i in range(ny):
        stage_state[i] = state[i]
    hand_over(system, stage_state)
    status = evaluate(system, t, KINEMATICS_OF_ALL)
    if status != OK:
        return status
    v, joint_impulse = system.v, step.joint_impulse
    largest = 1.0
    for k in range(nv):
        largest = max(largest, abs(v[k]))
        joint_impulse[k] = 0.0
    ng = system.guard_count[0]
    contact_int = system.contact_int
    contact_real = system.contact_real
    basis, slip = system.basis, system.slip
    forces, torques = step.forces, step.torques
    touch_time, load = step.touch_time, step.load
    gaps, behind, size = (
        system.gaps,
        step.behind,
        step.numbers[STEP_SIZE],
    )
    for c in range(nc):
        touch_time[c], load[c] = -1.0, 0.0
        # deeper than a step could have brought it there from the near side
        reach = size * abs(dot(basis[c, 2], slip[c])) + _APART * contact_real[c, LENGTH]
        behind[c] = 1 if contact_int[c, MODE] == FREE and gaps[c, 0] < -reach else 0
        for i in range(3):
            forces[c, i] = torques[c, i] = 0.0
        if contact_int[c, MODE] == FREE:
            continue
        ints, mu = contact_int[c], contact_real[c, MU]
        if ints[UNILATERAL] != 0 and dot(basis[c, 2], slip[c]) < -REST_SPEED:
            # touches in the first step
            ints[MODE] = FREE
            continue
        first, second = dot(basis[c, 0], slip[c]), dot(basis[c, 1], slip[c])
        speed = abs(first) if ints[TANGENTS] == 1 else math.hypot(first, second)
        ints[FROZEN] = 0
        if speed > _REST * largest and 0.0 < mu < math.inf:
            ints[MODE] = SLIPPING
        else:
            ints[MODE] = FRICTIONLESS if mu == 0.0 else STICK
        ints[SLIP_SIGN] = 1 if first >= 0.0 else -1
    # joints at their stops are found by the first step
    guard_int = system.guard_int
    for g in range(ng):
        contact_int[nc + g, MODE], guard_int[g, GUARD_END] = FREE, 0
    step.counts[TOUCHED] = 0
    return OK


@kernel
def _ask(system, step, t):
    """Let the user's function set the torques for the system's (q, v) at t; False where it fails."""
    calls = step.calls
    if calls[ASKED] == 0:
        return True
    system.scalars.time = t
    return call_python(calls[ASKED], calls[ASKED_WITH], calls[CALL_FAILED]) and torques_finite(system, t)


@kernel
def take_solution(step, found):
    """The forces, velocities and modes that a cone solver has found become those of the step."""
    forces, velocities, modes = step.cone_forces, step.cone_velocities, step.cone_modes
    for u in range(found.modes.shape[0]):
        modes[u] = found.modes[u]
        for k in range(3 * u, 3 * u + 3):
            forces[k], velocities[k] = found.forces[k], found.velocities[k]


@kernel
def _solve(step, n):
    """Solve the assembled problem of n units in the usual ways; False leaves it to Python."""
    counts, numbers = step.counts, step.numbers
    address, tolerance = step.cone_tables[n], numbers[CONE_TOLERANCE]
    if address == 0:
        return False
    known = cone.cone_at(address)
    # of several solutions of an impact the one that the past has no part in
    usual = counts[CONE_TASK] >= USUAL
    task = USUAL + AFRESH if usual and counts[TOUCHED] != 0 else counts[CONE_TASK]
    residual = _call_cones(
        step.calls[SOLVE_CONES],
        as_array(square(step.delassus, 3 * n)),
        as_array(step.loads[: 3 * n]),
        as_array(step.friction[:n]),
        known,
        task,
        0,
        tolerance,
        0,
        0,
    )
    if not residual <= tolerance:
        return False
    counts[SOLVED_HERE] += 1
    numbers[CONE_RESIDUAL] = max(numbers[CONE_RESIDUAL], residual)
    take_solution(step, known)
    return True


@kernel
def _lets_go(system, step, n):
    """Whether the solution of the n units lets a contact slip or open that was at rest, or slip that comes to rest in
    the step as its slip turns back; marks them."""
    h = step.numbers[H]
    start_mode, sticking = step.start_mode, step.sticking
    contact_real = system.contact_real
    unit_int, friction = step.unit_int, step.friction
    modes, velocities = step.cone_modes, step.cone_velocities
    goes = False
    for u in range(n):
        ints, c = unit_int[u], unit_int[u, UNIT_INDEX]
        ints[HELD] = 0
        # not once more with the coefficient of sliding
        if ints[UNIT_KIND] != ON_CONTACT or friction[u] < sticking[c]:
            continue
        rests = start_mode[c] == STICK or may_rest(step, u)
        ints[HELD] = 1 if rests else 0
        slides = math.hypot(velocities[3 * u], velocities[3 * u + 1]) * h > OPENING * contact_real[c, LENGTH]
        opens = velocities[3 * u + 2] * h > OPENING * contact_real[c, LENGTH]
        goes = goes or (rests and ((slides and modes[u] == cone.SLIP) or (opens and modes[u] == cone.OPEN)))
    return goes


@kernel
def _leaves_choice(step, n):
    """Whether there is a choice among the forces of the n units that moves the bodies, since some of them slide, and
    that is not yet what the rule has it, since it depends on the last forces.

    Where others stick, or torques resist turning, the rule leaves loads open: that is counted, and with such torques
    the choice is left as it is.
    """
    counts = step.counts
    address = step.cone_tables[n]
    if address == 0 or counts[COUPLED] != APART:
        return False
    known = cone.cone_at(address).counts
    if known[cone.CHOICES] == 0:
        return False
    unit_int, friction = step.unit_int, step.friction
    modes = step.cone_modes
    slides = sticks = turns = False
    for u in range(n):
        on_contact = unit_int[u, UNIT_KIND] == ON_CONTACT and friction[u] > 0.0
        turns = turns or unit_int[u, UNIT_KIND] == ON_TURN
        slides = slides or (on_contact and modes[u] == cone.SLIP)
        sticks = sticks or (on_contact and modes[u] == cone.STICK)
    if slides and (sticks or turns):
        counts[OPEN_LOADS] += 1
    return slides and not turns and known[cone.FOLLOWS] != 0


@kernel
def _impulses(system, step, found):
    """Cone problem and end of the step; a status, or CONE_LEFT. found: see FRESH."""
    counts = step.counts
    if found == FRESH:
        status = _call_on_step(step.calls[ASSEMBLE], system, step)
        if status != OK:
            return status
    while True:
        n = counts[UNITS]
        if found == UNSOLVED:
            return NO_FORCE
        if found == FRESH:
            counts[HOLDING], counts[CHOOSING] = UNASKED, 0
            if n > 0 and (counts[COUPLED] != APART or not _solve(step, n)):
                return CONE_LEFT
        if counts[HOLDING] == UNASKED and counts[COUPLED] == APART and _lets_go(system, step, n):
            counts[HOLDING] = WANTED
            return CONE_LEFT
        if counts[CHOOSING] == 0 and n > 0 and _leaves_choice(step, n):
            counts[CHOOSING] = 1
            return CONE_LEFT
        found = FRESH
        status = advance(system, step)
        if status != AGAIN:
            return status


@kernel
def _pass(system, step, t, found):
    """Midpoint, cone problem and end of the step from t; a status, or CONE_LEFT."""
    counts = step.counts
    if found == FRESH:
        predict_midpoint(system, step)
        numbers = step.numbers
        middle = t + numbers[AHEAD]
        if not _ask(system, step, middle):
            return NOT_FINITE
        # but for impacts the passes of an attempt differ in the midpoint's velocity only
        moved = counts[PASSES] == 0 or numbers[AHEAD] != 0.5 * numbers[H]
        status = evaluate(system, middle, KINEMATICS_OF_ALL if moved else VELOCITIES_OF_ALL)
        if status != OK:
            return status
        leave_turning_axes(system, step)
        counts[RIGID] = counts[THOROUGH] = 0
    while True:
        status = _impulses(system, step, found)
        if status != NO_FORCE or counts[THOROUGH] != 0:
            return status
        found = FRESH
        if counts[RIGID] == 0:
            # redundant contacts may contradict each other by what only rigid geometry leaves out
            counts[RIGID] = 1
            counts[RIGID_STEPS] += 1
        else:
            counts[THOROUGH] = 1


@kernel
def _review_end(system, step, h):
    """The attempted step, whose end has been put on the constraints: contacts that went beyond the end of a contour
    open. A status: those that cannot open end there, and closed ones that are still apart are a failure."""
    sizes = system.sizes
    nv, nc = sizes.nv, sizes.nc
    contact_int = system.contact_int
    contact_real = system.contact_real
    gaps, rows = system.gaps, system.rows
    correction = system.correction_q
    start_domain, edge_time = step.start_domain, step.edge_time
    status = OK
    for c in range(nc):
        edge_time[c] = -1.0
        if contact_int[c, MODE] == FREE:
            continue
        if not abs(gaps[c, 0] + inner(rows[c, 2], correction, nv)) <= _APART * contact_real[c, LENGTH]:
            return CLOSED_APART
        domain, before = contact_real[c, DOMAIN], start_domain[c]
        if domain >= -_AT_END:
            continue
        if contact_int[c, UNILATERAL] == 0:
            status = CONTOUR_ENDS
            continue
        contact_int[c, MODE] = FREE
        edge_time[c] = h * before / (before - domain) if 0.0 < before < math.inf else 0.0
    return status


@kernel
def _attempt(system, step, t, h, found):
    """A step of size h from the start at t; a status, or CONE_LEFT."""
    sizes = system.sizes
    nq, nv = sizes.nq, sizes.nv
    counts, numbers = step.counts, step.numbers
    if found == FRESH:
        numbers[H], numbers[AHEAD] = h, 0.5 * h
        counts[PASSES], counts[TREND_BEFORE] = 0, counts[HAS_TREND]
    while True:
        status = _pass(system, step, t, found)
        if status == CONE_LEFT:
            return status
        found = FRESH
        before = counts[PASSES]
        if before > 1 and status in (LOCATION_FAILED, SINGULAR):
            status = TOO_LONG
        if status != OK:
            break
        if before == 0 and (counts[TOUCHED] != 0 or counts[TREND_BEFORE] == 0):
            # The step is taken again with what it tells: the mean velocity where impacts change it, else, where there
            # is no last step to tell it, the acceleration.
            counts[PASSES], counts[HAS_TREND] = 1, MEAN_VELOCITY
            if counts[TOUCHED] != 0:
                numbers[AHEAD] = numbers[IMPACT]
            else:
                state, trend = system.stage_state, step.trend
                seen_v, blocks = step.seen_v, system.joint_table
                for k in range(nv):
                    trend[k] = (state[nq + k] - seen_v[k]) / h
                inertias = step.inertias
                carry(blocks, inertias, state, step.start_q, trend, trend)
                counts[HAS_TREND] = ACCELERATION
            continue
        # A step in which bodies turn far is taken again with its own mean velocity: the implicit midpoint rule, which
        # stays stable where the velocity foretold from the last step does not.
        if before > _CORRECTIONS:
            if numbers[MISS] > _LOST:
                status = TOO_LONG
            break
        if counts[TOUCHED] != 0 or not numbers[MISS] > _FAR:
            break
        counts[PASSES], counts[HAS_TREND] = max(before, 1) + 1, MEAN_VELOCITY
    counts[HAS_TREND] = counts[TREND_BEFORE]
    if status != OK:
        return status
    status = _call_task(step.calls[RUN_TASK], system, SETTLE, t + h, 0.0)
    return status if status != OK else _review_end(system, step, h)


@kernel
def _accept(system, step, t, stepped):
    """STAGE_STATE, at t, becomes the start; see `commit`. counts[CHANGED]: whether modes, signs or charts did."""
    may_move = stepped != 0 and system.counters.charted != 0
    while True:
        changed = commit(system, step, stepped)
        if not may_move or _call_on_system(step.calls[MOVE_CHARTS], system) == 0:
            break
        ny = system.sizes.ny
        state, stage_state = system.state, system.stage_state
        for i in range(ny):
            stage_state[i] = state[i]
        hand_over(system, stage_state)
        evaluate(system, t, KINEMATICS_OF_ALL)
        may_move, stepped = False, 0
    step.counts[CHANGED] = 1 if changed else 0


@kernel
def _happens(system, step):
    """Whether a contact has another mode after the attempted step, or touched in it."""
    nc = system.sizes.nc
    contact_int = system.contact_int
    start_mode, touch_time = step.start_mode, step.touch_time
    happens = False
    for c in range(nc):
        happens = happens or touch_time[c] >= 0.0 or start_mode[c] != contact_int[c, MODE]
    return happens


@kernel
def _output(system, step, t):
    """Record the state at t: OK, OUTPUT_LEFT (its torques are set) or NOT_FINITE."""
    if not _ask(system, step, t):
        return NOT_FINITE
    counts, counters = step.counts, system.counters
    if counters.recorded == BLOCK or counts[TURNS] != 0:
        return OUTPUT_LEFT
    nv, h = system.sizes.nv, step.numbers[H]
    tau, kept, impulse = system.tau, step.set_aside, step.joint_impulse
    for k in range(nv):
        # forces of limits and dry friction go with the torques, so that contact forces can be found again
        kept[k] = tau[k]
        tau[k] += impulse[k] / h
    _call_task(step.calls[RUN_TASK], system, RECORD, t, 0.0)
    for k in range(nv):
        tau[k] = kept[k]
    return OK


@kernel
def _next_row(system, step):
    """Write q and v as a row, where rows are wanted; whether steps to another one begin, with its torques."""
    counts, sizes = step.counts, system.sizes
    row, rows = counts[ROWS_DONE], counts[ROW_COUNT]
    if row >= rows:
        return False
    nq, nv = sizes.nq, sizes.nv
    state = system.state
    row_q, row_v = step.rows_q[row], step.rows_v[row]
    for i in range(nq):
        row_q[i] = state[i]
    for k in range(nv):
        row_v[k] = state[nq + k]
    counts[ROWS_DONE] = row + 1
    if row + 1 == rows:
        return False
    tau, row_tau = system.tau, step.rows_tau[row + 1]
    for k in range(nv):
        tau[k] = row_tau[k]
    counts[LAST] += counts[ROW_STEPS]
    return True


@entry_kernel(INTEGER, INTEGER, INTEGER, INTEGER, REAL, REAL, when=STEPPING)
def run_steps(system_address, step_address, task, found, t, h):
    """A status of `layout`, or what Python is needed for: see CONE_LEFT.

    task: BEGIN at t, ATTEMPT a step of size h from t, ACCEPT it at its end t; STEP, which is both until counts[LAST]
    are done, and MARCH, steps and outputs until Python is needed, take their times from the system. found: FRESH, or
    what has become of the cone problem that the last call with this task left, or APPROVED for the step that MARCH came
    back with as ATTEMPTED.
    """
    system, step = system_at(system_address), step_at(step_address)
    # one loop for all tasks: code that is called from one place is compiled once
    counts, numbers = step.counts, step.numbers
    scalars, every_step = (
        system.scalars,
        system.counters.record_steps != 0,
    )
    start, size = numbers[RUN_START], numbers[STEP_SIZE]
    slack = SLIVER * size
    if task == BEGIN:
        status = _begin(system, step, t)
        if status != OK:
            return status
    for _ in range(_BATCH):
        t_new, inside = t, False
        if task in (STEP, MARCH):
            # steps are counted, so that their rounding does not add up
            i = counts[STEPS]
            t, t_new, h = start + i * size, start + (i + 1) * size, size
            if task == MARCH:
                if i >= counts[LAST]:
                    return AT_END
                if i >= counts[STEP_LIMIT]:
                    return AT_LIMIT
                if i == counts[LAST] - 1:
                    t_new = numbers[RUN_END]
                # an output inside a step is the end of a shorter one, which is then dropped
                inside = scalars.next_output < t_new - slack
                h = (scalars.next_output if inside else t_new) - t
                if abs(h - size) <= slack:
                    # not what rounding has made of it
                    h = size
        approved = found == APPROVED
        if task >= ATTEMPT and not approved:
            status = _attempt(system, step, t, h, found)
            if status != OK or task == ATTEMPT:
                return status
        found = FRESH
        if not inside:
            if task == MARCH and not approved and (counts[WATCHED] != 0 or _happens(system, step)):
                return ATTEMPTED
            _accept(system, step, t_new, 0 if task == BEGIN else 1)
            if task < ATTEMPT:
                return OK
            counts[STEPS] += 1
            if task == STEP:
                if counts[STEPS] >= counts[LAST] and not _next_row(system, step):
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
    return MARCHING
