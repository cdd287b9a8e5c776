"""Whole steps of Moreau's method in compiled code, one call for many: see `impulses` for what a step is.

The loop comes back to Python for what is rare: a cone problem that the usual ways do not solve, a change of
modes, which is an event, an output in which something is about to slip, a user's event function, a failure. Where it
was left within a step it goes on from there.
"""

from __future__ import annotations

import math

from ..callback import call_python, kernel_caller
from ..dynamics.energy import REST_SPEED
from ..dynamics.equations import inner
from ..dynamics.evaluation import KINEMATICS_OF_ALL, VELOCITIES_OF_ALL, torques_finite
from ..friction import cone
from ..friction.attempt import AFRESH, USUAL
from ..geometry.small import dot
from ..jit import INTEGER, REAL, TABLE, entry_kernel, kernel
from ..layout import (
    BASIS,
    CHARTED,
    CONTACT_INT,
    CONTACT_INTS,
    CONTACT_REAL,
    CONTACT_REALS,
    CORRECTION_Q,
    COUNTERS,
    COUNTERS_SIZE,
    DOMAIN,
    FREE,
    FRICTIONLESS,
    FROZEN,
    GAPS,
    GUARD_COUNT,
    GUARD_END,
    GUARD_INT,
    GUARD_INTS,
    JOINT_TABLE,
    LENGTH,
    LOCATION_FAILED,
    MODE,
    MU,
    NBLOCKS,
    NC,
    NEXT_OUTPUT,
    NO_FORCE,
    NOT_FINITE,
    NQ,
    NV,
    NY,
    OK,
    RECORD_STEPS,
    RECORDED,
    ROWS,
    SCALARS,
    SCALARS_SIZE,
    SINGULAR,
    SIZES,
    SLIP,
    SLIP_SIGN,
    SLIPPING,
    STAGE_STATE,
    STATE,
    STICK,
    TANGENTS,
    TAU,
    TIME,
    TOO_LONG,
    UNILATERAL,
    V,
)
from ..memory import cube, integer_matrix, integers, matrix, reals
from .carrying import INERTIA_SIZE, carry
from .impulse_layout import (
    ACCELERATION,
    AHEAD,
    APART,
    ASKED,
    ASKED_WITH,
    ASSEMBLE,
    BEHIND,
    CALL_FAILED,
    CALLS,
    CHANGED,
    CHOOSING,
    CONE_FORCES,
    CONE_MODES,
    CONE_RESIDUAL,
    CONE_TABLES,
    CONE_TASK,
    CONE_TOLERANCE,
    CONE_VELOCITIES,
    COUNTS,
    COUPLED,
    DELASSUS,
    EDGE_TIME,
    FORCES,
    FRICTION,
    HAS_TREND,
    HELD,
    HOLDING,
    IMPACT,
    INERTIAS,
    JOINT_IMPULSE,
    LAST,
    LOAD,
    LOADS,
    MAX_UNITS,
    MEAN_VELOCITY,
    MISS,
    MOVE_CHARTS,
    NCALLS,
    NCOUNTS,
    NNUMBERS,
    NUMBERS,
    ON_CONTACT,
    ON_TURN,
    OPEN_LOADS,
    PASSES,
    RIGID,
    RIGID_STEPS,
    ROW_COUNT,
    ROW_STEPS,
    ROWS_DONE,
    ROWS_Q,
    ROWS_TAU,
    ROWS_V,
    RUN_END,
    RUN_START,
    RUN_TASK,
    SEEN_V,
    SET_ASIDE,
    SOLVE_CONES,
    SOLVED_HERE,
    START_DOMAIN,
    START_MODE,
    START_Q,
    STEP_LIMIT,
    STEP_SIZE,
    STEPS,
    STICKING,
    THOROUGH,
    TORQUES,
    TOUCH_TIME,
    TOUCHED,
    TREND,
    TREND_BEFORE,
    TURNS,
    UNASKED,
    UNIT_INDEX,
    UNIT_INT,
    UNIT_INTS,
    UNIT_KIND,
    UNITS,
    WANTED,
    WATCHED,
    H,
)
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

_call_task = kernel_caller(INTEGER, TABLE, INTEGER, REAL, REAL)
_call_on_step = kernel_caller(INTEGER, TABLE, TABLE)
_call_on_table = kernel_caller(INTEGER, TABLE)
_call_cones = kernel_caller(
    REAL, REAL[:, ::1], REAL[::1], REAL[::1], TABLE, INTEGER, INTEGER, REAL, INTEGER, INTEGER
)  # fmt: skip


@kernel
def _begin(table, step, t):
    """Make STATE what is to be accepted; closed contacts get the mode that their v_c shows. A status."""
    sizes = integers(table[SIZES], 8)
    nv, nc, ny = sizes[NV], sizes[NC], sizes[NY]
    state, stage_state = reals(table[STATE], ny), reals(table[STAGE_STATE], ny)
    for i in range(ny):
        stage_state[i] = state[i]
    hand_over(table, stage_state)
    status = evaluate(table, t, KINEMATICS_OF_ALL)
    if status != OK:
        return status
    v, joint_impulse = reals(table[V], nv), reals(step[JOINT_IMPULSE], nv)
    largest = 1.0
    for k in range(nv):
        largest = max(largest, abs(v[k]))
        joint_impulse[k] = 0.0
    ng = integers(table[GUARD_COUNT], 1)[0]
    contact_int = integer_matrix(table[CONTACT_INT], nc + ng, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    basis, slip = cube(table[BASIS], nc, 3, 3), matrix(table[SLIP], nc, 3)
    forces, torques = matrix(step[FORCES], nc, 3), matrix(step[TORQUES], nc, 3)
    touch_time, load = reals(step[TOUCH_TIME], nc), reals(step[LOAD], nc)
    gaps, behind, size = (
        matrix(table[GAPS], nc, 2),
        integers(step[BEHIND], nc),
        reals(step[NUMBERS], NNUMBERS)[STEP_SIZE],
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
    guard_int = integer_matrix(table[GUARD_INT], ng, GUARD_INTS)
    for g in range(ng):
        contact_int[nc + g, MODE], guard_int[g, GUARD_END] = FREE, 0
    integers(step[COUNTS], NCOUNTS)[TOUCHED] = 0
    return OK


@kernel
def _ask(table, step, t):
    """Let the user's function set the torques for the system's (q, v) at t; False where it fails."""
    calls = integers(step[CALLS], NCALLS)
    if calls[ASKED] == 0:
        return True
    reals(table[SCALARS], SCALARS_SIZE)[TIME] = t
    return call_python(calls[ASKED], calls[ASKED_WITH], calls[CALL_FAILED]) and torques_finite(table, t)


@kernel
def _solve(step, n):
    """Solve the assembled problem of n units in the usual ways; False leaves it to Python."""
    counts, numbers = integers(step[COUNTS], NCOUNTS), reals(step[NUMBERS], NNUMBERS)
    address, tolerance = integers(step[CONE_TABLES], counts[MAX_UNITS] + 1)[n], numbers[CONE_TOLERANCE]
    if address == 0:
        return False
    known = integers(address, len(cone.SLOTS))
    # of several solutions of an impact the one that the past has no part in
    task = USUAL + AFRESH if counts[TOUCHED] != 0 else counts[CONE_TASK]
    residual = _call_cones(
        integers(step[CALLS], NCALLS)[SOLVE_CONES],
        matrix(step[DELASSUS], 3 * n, 3 * n),
        reals(step[LOADS], 3 * n),
        reals(step[FRICTION], n),
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
    step[CONE_FORCES], step[CONE_VELOCITIES] = known[cone.FORCES], known[cone.VELOCITIES]
    step[CONE_MODES] = known[cone.MODES]
    return True


@kernel
def _lets_go(table, step, n):
    """Whether the solution of the n units lets a contact slip or open that was at rest, or slip that comes to rest in
    the step as its slip turns back; marks them."""
    sizes, counts = integers(table[SIZES], 8), integers(step[COUNTS], NCOUNTS)
    nc, h = sizes[NC], reals(step[NUMBERS], NNUMBERS)[H]
    start_mode, sticking = integers(step[START_MODE], nc), reals(step[STICKING], nc)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    unit_int, friction = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS), reals(step[FRICTION], n)
    modes, velocities = integers(step[CONE_MODES], n), reals(step[CONE_VELOCITIES], 3 * n)
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
    counts = integers(step[COUNTS], NCOUNTS)
    address = integers(step[CONE_TABLES], counts[MAX_UNITS] + 1)[n]
    if address == 0 or counts[COUPLED] != APART:
        return False
    known = integers(integers(address, len(cone.SLOTS))[cone.COUNTS], cone.COUNTS_LENGTH)
    if known[cone.CHOICES] == 0:
        return False
    unit_int, friction = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS), reals(step[FRICTION], n)
    modes = integers(step[CONE_MODES], n)
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
def _impulses(table, step, found):
    """Cone problem and end of the step; a status, or CONE_LEFT. found: see FRESH."""
    counts = integers(step[COUNTS], NCOUNTS)
    if found == FRESH:
        status = _call_on_step(integers(step[CALLS], NCALLS)[ASSEMBLE], table, step)
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
        if counts[HOLDING] == UNASKED and counts[COUPLED] == APART and _lets_go(table, step, n):
            counts[HOLDING] = WANTED
            return CONE_LEFT
        if counts[CHOOSING] == 0 and n > 0 and _leaves_choice(step, n):
            counts[CHOOSING] = 1
            return CONE_LEFT
        found = FRESH
        status = advance(table, step)
        if status != AGAIN:
            return status


@kernel
def _pass(table, step, t, found):
    """Midpoint, cone problem and end of the step from t; a status, or CONE_LEFT."""
    counts = integers(step[COUNTS], NCOUNTS)
    if found == FRESH:
        predict_midpoint(table, step)
        numbers = reals(step[NUMBERS], NNUMBERS)
        middle = t + numbers[AHEAD]
        if not _ask(table, step, middle):
            return NOT_FINITE
        # but for impacts the passes of an attempt differ in the midpoint's velocity only
        moved = counts[PASSES] == 0 or numbers[AHEAD] != 0.5 * numbers[H]
        status = evaluate(table, middle, KINEMATICS_OF_ALL if moved else VELOCITIES_OF_ALL)
        if status != OK:
            return status
        leave_turning_axes(table, step)
        counts[RIGID] = counts[THOROUGH] = 0
    while True:
        status = _impulses(table, step, found)
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
def _review_end(table, step, h):
    """The attempted step, whose end has been put on the constraints: contacts that went beyond the end of a contour
    open. A status: those that cannot open end there, and closed ones that are still apart are a failure."""
    sizes = integers(table[SIZES], 8)
    nv, nc = sizes[NV], sizes[NC]
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    gaps, rows = matrix(table[GAPS], nc, 2), cube(table[ROWS], nc, 3, nv)
    correction = reals(table[CORRECTION_Q], nv)
    start_domain, edge_time = reals(step[START_DOMAIN], nc), reals(step[EDGE_TIME], nc)
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
def _attempt(table, step, t, h, found):
    """A step of size h from the start at t; a status, or CONE_LEFT."""
    sizes = integers(table[SIZES], 8)
    nq, nv = sizes[NQ], sizes[NV]
    counts, numbers = integers(step[COUNTS], NCOUNTS), reals(step[NUMBERS], NNUMBERS)
    if found == FRESH:
        numbers[H], numbers[AHEAD] = h, 0.5 * h
        counts[PASSES], counts[TREND_BEFORE] = 0, counts[HAS_TREND]
    while True:
        status = _pass(table, step, t, found)
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
                state, trend = reals(table[STAGE_STATE], sizes[NY]), reals(step[TREND], nv)
                seen_v, blocks = reals(step[SEEN_V], nv), integer_matrix(table[JOINT_TABLE], sizes[NBLOCKS], 4)
                for k in range(nv):
                    trend[k] = (state[nq + k] - seen_v[k]) / h
                inertias = matrix(step[INERTIAS], sizes[NBLOCKS], INERTIA_SIZE)
                carry(blocks, inertias, state, reals(step[START_Q], nq), trend, trend)
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
    status = _call_task(integers(step[CALLS], NCALLS)[RUN_TASK], table, SETTLE, t + h, 0.0)
    return status if status != OK else _review_end(table, step, h)


@kernel
def _accept(table, step, t, stepped):
    """STAGE_STATE, at t, becomes the start; see `commit`. counts[CHANGED]: whether modes, signs or charts did."""
    may_move = stepped != 0 and integers(table[COUNTERS], COUNTERS_SIZE)[CHARTED] != 0
    while True:
        changed = commit(table, step, stepped)
        if not may_move or _call_on_table(integers(step[CALLS], NCALLS)[MOVE_CHARTS], table) == 0:
            break
        ny = integers(table[SIZES], 8)[NY]
        state, stage_state = reals(table[STATE], ny), reals(table[STAGE_STATE], ny)
        for i in range(ny):
            stage_state[i] = state[i]
        hand_over(table, stage_state)
        evaluate(table, t, KINEMATICS_OF_ALL)
        may_move, stepped = False, 0
    integers(step[COUNTS], NCOUNTS)[CHANGED] = 1 if changed else 0


@kernel
def _happens(table, step):
    """Whether a contact has another mode after the attempted step, or touched in it."""
    nc = integers(table[SIZES], 8)[NC]
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    start_mode, touch_time = integers(step[START_MODE], nc), reals(step[TOUCH_TIME], nc)
    happens = False
    for c in range(nc):
        happens = happens or touch_time[c] >= 0.0 or start_mode[c] != contact_int[c, MODE]
    return happens


@kernel
def _output(table, step, t):
    """Record the state at t: OK, OUTPUT_LEFT (its torques are set) or NOT_FINITE."""
    if not _ask(table, step, t):
        return NOT_FINITE
    counts, counters = integers(step[COUNTS], NCOUNTS), integers(table[COUNTERS], COUNTERS_SIZE)
    if counters[RECORDED] == BLOCK or counts[TURNS] != 0:
        return OUTPUT_LEFT
    nv, h = integers(table[SIZES], 8)[NV], reals(step[NUMBERS], NNUMBERS)[H]
    tau, kept, impulse = reals(table[TAU], nv), reals(step[SET_ASIDE], nv), reals(step[JOINT_IMPULSE], nv)
    for k in range(nv):
        # forces of limits and dry friction go with the torques, so that contact forces can be found again
        kept[k] = tau[k]
        tau[k] += impulse[k] / h
    _call_task(integers(step[CALLS], NCALLS)[RUN_TASK], table, RECORD, t, 0.0)
    for k in range(nv):
        tau[k] = kept[k]
    return OK


@kernel
def _next_row(table, step):
    """Write q and v as a row, where rows are wanted; whether steps to another one begin, with its torques."""
    counts, sizes = integers(step[COUNTS], NCOUNTS), integers(table[SIZES], 8)
    row, rows = counts[ROWS_DONE], counts[ROW_COUNT]
    if row >= rows:
        return False
    nq, nv = sizes[NQ], sizes[NV]
    state = reals(table[STATE], sizes[NY])
    row_q, row_v = matrix(step[ROWS_Q], rows, nq)[row], matrix(step[ROWS_V], rows, nv)[row]
    for i in range(nq):
        row_q[i] = state[i]
    for k in range(nv):
        row_v[k] = state[nq + k]
    counts[ROWS_DONE] = row + 1
    if row + 1 == rows:
        return False
    tau, row_tau = reals(table[TAU], nv), matrix(step[ROWS_TAU], rows, nv)[row + 1]
    for k in range(nv):
        tau[k] = row_tau[k]
    counts[LAST] += counts[ROW_STEPS]
    return True


@entry_kernel(TABLE, TABLE, INTEGER, INTEGER, REAL, REAL)
def run_steps(table, step, task, found, t, h):
    """A status of `layout`, or what Python is needed for: see CONE_LEFT.

    task: BEGIN at t, ATTEMPT a step of size h from t, ACCEPT it at its end t; STEP, which is both until counts[LAST]
    are done, and MARCH, steps and outputs until Python is needed, take their times from the table. found: FRESH, or
    what has become of the cone problem that the last call with this task left, or APPROVED for the step that MARCH came
    back with as ATTEMPTED.
    """
    # one loop for all tasks: code that is called from one place is compiled once
    counts, numbers = integers(step[COUNTS], NCOUNTS), reals(step[NUMBERS], NNUMBERS)
    scalars, every_step = (
        reals(table[SCALARS], SCALARS_SIZE),
        integers(table[COUNTERS], COUNTERS_SIZE)[RECORD_STEPS] != 0,
    )
    start, size = numbers[RUN_START], numbers[STEP_SIZE]
    slack = SLIVER * size
    if task == BEGIN:
        status = _begin(table, step, t)
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
                inside = scalars[NEXT_OUTPUT] < t_new - slack
                h = (scalars[NEXT_OUTPUT] if inside else t_new) - t
                if abs(h - size) <= slack:
                    # not what rounding has made of it
                    h = size
        approved = found == APPROVED
        if task >= ATTEMPT and not approved:
            status = _attempt(table, step, t, h, found)
            if status != OK or task == ATTEMPT:
                return status
        found = FRESH
        if not inside:
            if task == MARCH and not approved and (counts[WATCHED] != 0 or _happens(table, step)):
                return ATTEMPTED
            _accept(table, step, t_new, 0 if task == BEGIN else 1)
            if task < ATTEMPT:
                return OK
            counts[STEPS] += 1
            if task == STEP:
                if counts[STEPS] >= counts[LAST] and not _next_row(table, step):
                    return OK
                continue
        while inside or every_step or scalars[NEXT_OUTPUT] <= t_new + slack:
            status = _output(table, step, scalars[NEXT_OUTPUT] if inside else t_new)
            if status != OK:
                return INNER_OUTPUT_LEFT if inside and status == OUTPUT_LEFT else status
            if every_step:
                break
            output_done(table)
            if inside:
                break
    return MARCHING
