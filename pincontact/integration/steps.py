"""Whole steps in compiled code: evaluations, Runge-Kutta stages, step control and projection, one call for many steps.

The loop comes back to Python only for what needs it: an event function that became negative, an output, a user's
function, the end of slip, a failure. Pinocchio is called from inside (see `callback`).
"""

from __future__ import annotations

import math

from ..callback import call_kernel
from ..dynamics.equations import slip_direction
from ..dynamics.evaluation import KINEMATICS_OF_ALL, PLACES_OF_ALL, PLACES_OF_CLOSED, contact_corrections
from ..dynamics.linear import inner, whiten
from ..dynamics.resistance import count_items
from ..geometry.small import dot
from ..jit import INTEGER, REAL, TABLE, entry_kernel, kernel
from ..layout import (
    ABSOLUTE,
    ACROSS,
    ALARM,
    ATTEMPT_LIMIT,
    BASIS,
    CALLBACK,
    CALLBACK_SIZE,
    CHARTED,
    CONTACT_INT,
    CONTACT_INTS,
    CONTACT_REAL,
    CONTACT_REALS,
    CORRECTION_SIZE,
    COUNTERS,
    COUNTERS_SIZE,
    DENSE,
    DENSE_NESTED,
    DENSE_START,
    DENSE_STEP,
    DIP,
    END,
    ERROR_NORM,
    ERROR_ORDER,
    ESTIMATE_AFTER,
    EVALUATION,
    EVENT,
    EXTRA_STAGES,
    FACTOR,
    FAILURE,
    FIXED_STEP,
    FLOOR,
    FORCE,
    FROZEN,
    GAP_RESIDUAL,
    HIGHEST,
    LAST_ERROR,
    LAST_NORMAL_X,
    LOCATION_FAILED,
    LOWEST,
    MARGINS,
    MARGINS_PER_CONTACT,
    MAX_STEP,
    MODE,
    MU,
    NC,
    NEW_STATE,
    NEXT_NORMAL_X,
    NEXT_OUTPUT,
    NEXT_SLOPE,
    NEXT_STATE,
    NEXT_STEP,
    NEXT_TIME,
    NODES,
    NOT_FINITE,
    NOW,
    NQ,
    NSTAGES,
    NV,
    NY,
    OK,
    OWN_TABLE,
    PARENTS,
    PATIENCE,
    POLYNOMIAL_SIZE,
    RECORD_STEPS,
    RECORDED,
    REJECTED_COUNT,
    ROWS,
    SCALARS,
    SCALARS_SIZE,
    SCALE,
    SCAN_COUNT,
    SCAN_MARGINS,
    SCAN_ROOM,
    SCAN_SHARES,
    SCAN_STATUS,
    SIZES,
    SLIP,
    SLIP_RATE,
    SLIP_SPEED,
    SLIPPING,
    SLOPES,
    SLOWEST,
    STAGE_STATE,
    STALLED,
    START_RATE,
    START_SPEED,
    START_TOLERANCE,
    STATE,
    STEP,
    STEP_COUNT,
    STIFF_STEPS,
    TANGENTS,
    TURNING_RATE,
    VECTORS,
    VELOCITY_LEFT,
    VELOCITY_RESIDUAL,
    WORK,
    Q,
    V,
)
from ..memory import cube, integer_matrix, integers, matrix, reals
from .approach import bound_speeds, stay_apart
from .dense import DENSE_ROWS, dense_coefficients, interpolate
from .recording import BLOCK, output_done, record_row
from .resolution import KEPT_ROWS, keep_margins, margin_error, set_margins_aside, take_margins_up
from .results import CLOSED_APART, CONTRADICTION
from .stages import (
    MAX_STAGES,
    build_state,
    change_charts,
    correct_state,
    error_norm,
    fill_slope,
    hand_over,
    keep_velocity,
)

# What `run_task` does.
(
    EVALUATE,
    KINEMATICS,
    ATTEMPT,
    INTERPOLATION_STAGES,
    PROJECT,
    PROJECT_EVALUATED,
    ACCEPT,
    START,
    FINISH_STEP,
    RECORD,
    WRITE_OUTPUTS,
    MARCH,
    MARCH_ONE_STEP,
    MARCH_ONE_ATTEMPT,
    MARCH_APART,
    SETTLE,
    ACROSS_SLIP,
    FIRST_STEP,
    KEEP_VELOCITY,
    SCAN,
    BOUND_SPEEDS,
) = range(21)

# What MARCH comes back with.
(
    MARCHING,
    STEPPED,
    ATTEMPTED,
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
# Attempts after which MARCH comes back all the same, for the keyboard's and the progress bar's sake.
_BATCH = 256

# Step-size control: safety, and the bounds of one change.
_SAFETY = 0.8
_SMALLEST_FACTOR = 0.2
_LARGEST_FACTOR = 10.0
# Weights of the present and the last error in the exponent, and the least that is remembered of the last, lest a tiny
# error keep steps from growing. Hardly a step is rejected then: a fifth fewer evaluations at loose tolerances, a
# twelfth at 1e-6, than with the present error alone and a safety of 0.9.
_PRESENT, _PAST = 0.76, 0.24
_SMALLEST_LAST_ERROR = 1e-2
# Sizes of the state and its slope, in tolerances, below which they tell nothing of the first step, and what it is then;
# safety of the first step: a longer one costs a rejection, a shorter one next to nothing.
_SMALL_SIZE = 1e-5
_SMALL_STEP = 1e-6
_FIRST_FRACTION = 0.5
# After a rejection by a failed evaluation the step shrinks by this factor.
FAILED_FACTOR = 0.25
# A remainder of the interval below this fraction of the step is added to it.
_SLIVER = 1e-9
# Steps of the longest size that is allowed differ by up to this part, in the sequence of the golden ratio.
_IRREGULAR, _GOLDEN = 0.3, 0.6180339887498949

# Where 3D slip ends its direction is singular: no step goes further than this fraction of the way to the end.
_STOP_FRACTION = 0.8
# Slip has ended once its speed is down to the error that steps are allowed to make in it, where its direction is noise;
# the rest is one linear step, whose error is of second order in the time left. Where steps no longer get anywhere near
# the end, the speed that counts as ended is doubled at every attempt, so many times at most.
_STOP_DOUBLINGS = 10
_PROGRESS = 0.9
# Growth by which a slip has got away from its slowest point.
_ESCAPE = 2.0
_SMALLEST_STOP_SPEED = 1e-13
# Steps of more than this over the time in which friction turns a slip are held back by stability, not by accuracy: the
# pairs' limits are 2.5, 3.3 and 6.4.
_STIFF = 2.0

_PROJECTIONS = 12
# What a state is projected for.
TO_KEEP, TO_STEP_ON, TO_SHOW = range(3)
# Changes of q and v by less than this part of the tolerance leave accelerations what they are.
_CLOSE = 1e-1
# A change of q below this needs no further evaluation: what it leaves in gaps and v_c is quadratic, or below round-off.
_NEGLIGIBLE = 1e-14
# Residual (m, and m/s relative to the speeds) below which nothing is corrected.
_ROUND_OFF = 1e-16
_LARGEST_CORRECTION = 1e3
# What redundant constraints may leave of velocities, relative to the largest or 1, and, of corrections of q (rad or m),
# times so much more.
_CONTRADICTING, _OF_CORRECTION = 1e-5, 1e2
# What a projection may change q and v by, in the step's errors, or relative to them, whichever is more: no error of a
# step is larger, not even where a contour is smooth between its knots only.
_EXPLAINED, _LEAST_EXPLAINED = 1e3, 1e-6
_PROJECTED_GAP = 1e-11
# SETTLE: a correction of q below the first of these leaves gaps of its square, and needs no further evaluation; nor
# does one after which Newton's method, whose corrections are as the squares of those before, has the next one below the
# other.
_SMALL_CORRECTION, _FORETOLD_CORRECTION = 1e-7, 1e-12
_SETTLEMENTS = 6
# Gaps in m that it may leave where corrections do not get that small.
_SETTLED_GAP = 1e-7


@kernel
def evaluate(table, time, only_kinematics):
    """Pinocchio's terms and one evaluation at (q, v), by a kernel of its own; arguments and status are its."""
    callback = integers(table[CALLBACK], CALLBACK_SIZE)
    return call_kernel(callback[EVALUATION], callback[OWN_TABLE], time, only_kinematics)


@kernel
def _slope(table, index):
    """Slope number `index` from the last evaluation, of the state in STAGE_STATE."""
    ny = integers(table[SIZES], 8)[NY]
    fill_slope(table, reals(table[STAGE_STATE], ny), matrix(table[SLOPES], MAX_STAGES, ny)[index])
    keep_margins(table, index)


@kernel
def _stages(table, t, h, first, last, adaptive):
    """Stages first .. last of a step of size h from the state at t; a status.

    adaptive: leave the step's end unevaluated where the error estimate already rejects it.
    """
    scalars, counters = reals(table[SCALARS], SCALARS_SIZE), integers(table[COUNTERS], COUNTERS_SIZE)
    nodes = reals(table[NODES], MAX_STAGES)
    end, estimate_after = integers(table[SIZES], 8)[NSTAGES], counters[ESTIMATE_AFTER]
    scalars[STEP] = h
    for s in range(first, last + 1):
        if adaptive and s == end and end > estimate_after and scalars[ERROR_NORM] >= 1.0:
            break
        if s == first or s > end:
            build_state(table, s)
        status = evaluate(table, t + nodes[s] * h, 0)
        if status > EVENT:
            return status
        if status == EVENT:
            counters[ALARM] = 1
        _slope(table, s)
        if s < end:
            build_state(table, s + 1)
        if s == estimate_after:
            norm = error_norm(table, s)
            scalars[ERROR_NORM] = norm
            if not norm < math.inf:
                return NOT_FINITE
    return OK


@kernel
def attempt(table, t, h, adaptive):
    """A step of size h from the state at t, which is kept.

    ALARM tells whether an event function was negative in a stage, or may have been between two. adaptive: their
    resolution counts as an error, too (see `resolution`).
    """
    counters = integers(table[COUNTERS], COUNTERS_SIZE)
    n = MARGINS_PER_CONTACT * count_items(table)
    lowest, highest = reals(table[LOWEST], n), reals(table[HIGHEST], n)
    for i in range(n):
        lowest[i], highest[i] = math.inf, -math.inf
    counters[ALARM] = 0
    status = _stages(table, t, h, 1, integers(table[SIZES], 8)[NSTAGES], adaptive)
    dip = reals(table[SCALARS], SCALARS_SIZE)[DIP]
    for i in range(n):
        # written such that infinite margins compare
        if (1.0 + dip) * lowest[i] < dip * highest[i]:
            counters[ALARM] = 1
    if adaptive and status <= EVENT and reals(table[SCALARS], SCALARS_SIZE)[ERROR_NORM] < 1.0:
        margin_error(table)
    return status


@kernel
def _contradicts(table):
    """Whether the last correction leaves velocities that it was to take away, since constraints contradict each other:
    those of rigid geometry do by errors of the configuration only, that is by no more than its own correction."""
    scalars, v = reals(table[SCALARS], SCALARS_SIZE), reals(table[V], integers(table[SIZES], 8)[NV])
    if scalars[VELOCITY_LEFT] == 0.0:
        return False
    fastest = 1.0
    for k in range(v.shape[0]):
        fastest = max(fastest, abs(v[k]))
    return scalars[VELOCITY_LEFT] > (_CONTRADICTING + _OF_CORRECTION * scalars[CORRECTION_SIZE]) * fastest


@kernel
def project(table, t, evaluated, purpose, error):
    """Put (q, v) and the location of STAGE_STATE on the constraints, in the mass metric; a status.

    No gain to tune and no drift: Newton's iteration on the gaps with the factors of the last evaluation, and the exact
    linear projection of the velocity. The order of the integrator is kept, since the correction is of the size of its
    local error. Afterwards the accelerations are those of a state that differs by next to nothing.
    evaluated: the system has just been evaluated at that state, which saves one evaluation.
    purpose: TO_STEP_ON leaves constraints that are off by the square of a small part of the tolerance, and TO_SHOW the
    accelerations of another state; TO_KEEP is for states that are both shown and gone on from.
    error: norm of the error of the step that led here, infinite where that is not known. It is what the change has to
    be explained by: what takes more from q and v is a failure.
    """
    sizes, scalars = integers(table[SIZES], 8), reals(table[SCALARS], SCALARS_SIZE)
    beyond = count_items(table) - sizes[NC]
    if sizes[NC] + beyond == 0:
        return OK
    q = reals(table[Q], sizes[NQ])
    # forces of guarded joints and resistances are shown with the state
    part = PLACES_OF_CLOSED if purpose == TO_SHOW and beyond == 0 else 0
    for i in range(_PROJECTIONS):
        if i > 0 or not evaluated:
            status = evaluate(table, t, part)
            if status > EVENT:
                return status
        count = contact_corrections(table, 1, 1)
        if count == 0 or (scalars[GAP_RESIDUAL] <= _ROUND_OFF and scalars[VELOCITY_RESIDUAL] <= _ROUND_OFF):
            correct_state(table, 0, 0)
            return OK
        change = correct_state(table, 1, 1)
        if _contradicts(table):
            return CONTRADICTION
        if i == 0 and change > max(_EXPLAINED, _LEAST_EXPLAINED / reals(table[SCALE], 2)[0]) * max(error, 1.0):
            return LOCATION_FAILED
        close = change <= _CLOSE
        size, largest = scalars[CORRECTION_SIZE], 1.0
        for k in range(sizes[NQ]):
            largest = max(largest, abs(q[k]))
        if size <= _NEGLIGIBLE * largest or (close and purpose == TO_STEP_ON):
            return OK
        if not size < _LARGEST_CORRECTION:
            break
        if close and beyond == 0:
            part = PLACES_OF_CLOSED
    return OK if scalars[GAP_RESIDUAL] < _PROJECTED_GAP else LOCATION_FAILED


@kernel
def interpolation(table, t, h):
    """The extra stages and the coefficients of dense output for the attempted step of size h from t; a status."""
    scalars = reals(table[SCALARS], SCALARS_SIZE)
    first = integers(table[SIZES], 8)[NSTAGES] + 1
    extra = integers(table[COUNTERS], COUNTERS_SIZE)[EXTRA_STAGES]
    scalars[DENSE_START], scalars[DENSE_STEP] = t, h
    status = _stages(table, t, h, first, first + extra - 1, False)
    if status <= EVENT:
        dense_coefficients(table)
    return status


@kernel
def across_slip(table, t, h):
    """How well prescribed slip directions hold in a step of size h from the state at t, which is attempted; a status.

    ACROSS is filled with v_c across the direction at the shares of the step in its first row, up to a zero, and then
    with v_c along it.
    """
    n = count_items(table)
    status = start(table, t)
    if status <= EVENT:
        status = attempt(table, t, h, False)
    if status == OK:
        status = interpolation(table, t, h)
    if status > EVENT:
        return status
    contact_int = integer_matrix(table[CONTACT_INT], n, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], n, CONTACT_REALS)
    basis, slip = cube(table[BASIS], n, 3, 3), matrix(table[SLIP], n, 3)
    across = matrix(table[ACROSS], 2 * n + 1, POLYNOMIAL_SIZE)
    direction = matrix(table[VECTORS], 16, 3)[0]
    for k in range(POLYNOMIAL_SIZE):
        share = across[0, k]
        if share == 0.0:
            break
        _interpolated(table, share)
        status = evaluate(table, t + share * h, KINEMATICS_OF_ALL)
        if status > EVENT:
            return status
        for c in range(n):
            if contact_int[c, FROZEN] != 0:
                slip_direction(contact_int[c], contact_real[c], slip[c], basis[c], t + share * h, direction)
                first, second = dot(basis[c, 0], slip[c]), dot(basis[c, 1], slip[c])
                across[c + 1, k] = direction[0] * second - direction[1] * first
                across[n + c + 1, k] = direction[0] * first + direction[1] * second
    return OK


@kernel
def scan(table, t, h):
    """Margins along the step from t of size h that was interpolated last, at SCAN_SHARES of it: see `System.scan`."""
    n = count_items(table)
    shares, statuses = reals(table[SCAN_SHARES], SCAN_ROOM), integers(table[SCAN_STATUS], SCAN_ROOM)
    found = cube(table[SCAN_MARGINS], SCAN_ROOM + KEPT_ROWS, n, MARGINS_PER_CONTACT)
    margins = matrix(table[MARGINS], n, MARGINS_PER_CONTACT)
    for i in range(integers(table[COUNTERS], COUNTERS_SIZE)[SCAN_COUNT]):
        _interpolated(table, shares[i])
        statuses[i] = evaluate(table, t + shares[i] * h, 0)
        for c in range(n):
            for kind in range(MARGINS_PER_CONTACT):
                found[i, c, kind] = margins[c, kind]


@kernel
def _interpolated(table, theta):
    """Hand over the state at the fraction theta of the step that was interpolated last."""
    ny = integers(table[SIZES], 8)[NY]
    stage_state = reals(table[STAGE_STATE], ny)
    nested = integers(table[COUNTERS], COUNTERS_SIZE)[DENSE_NESTED]
    interpolate(matrix(table[DENSE], DENSE_ROWS, ny), reals(table[STATE], ny), nested, theta, stage_state)
    hand_over(table, stage_state)


@kernel
def write_outputs(table, until, inclusive):
    """Record the output times before `until`, or up to it, of the step that was interpolated last.

    Each is projected on the constraints. A status, or BLOCK_FULL.
    """
    scalars, counters = reals(table[SCALARS], SCALARS_SIZE), integers(table[COUNTERS], COUNTERS_SIZE)
    while scalars[NEXT_OUTPUT] < until or (inclusive and scalars[NEXT_OUTPUT] == until):
        if counters[RECORDED] == BLOCK:
            return BLOCK_FULL
        t = scalars[NEXT_OUTPUT]
        _interpolated(table, (t - scalars[DENSE_START]) / scalars[DENSE_STEP])
        status = project(table, t, False, TO_SHOW, math.inf)
        if status != OK:
            return status
        record_row(table, t)
        output_done(table)
    return OK


@kernel
def settle(table, t):
    """Kinematics of STAGE_STATE, which is put on the constraints with whatever factor there is; a status.

    For a method that needs no accelerations; open contacts are evaluated too.
    """
    last = 0.0
    for _ in range(_SETTLEMENTS):
        status = evaluate(table, t, PLACES_OF_ALL)
        if status != OK:
            return status
        contact_corrections(table, 1, 1)
        correct_state(table, 1, 1)
        if _contradicts(table):
            return CONTRADICTION
        size = reals(table[SCALARS], SCALARS_SIZE)[CORRECTION_SIZE]
        if size <= _SMALL_CORRECTION or size * size * size <= _FORETOLD_CORRECTION * last * last:
            return OK
        last = size
    return OK if reals(table[SCALARS], SCALARS_SIZE)[GAP_RESIDUAL] < _SETTLED_GAP else CLOSED_APART


@kernel
def accept(table):
    """The projected state becomes the next step's start; its slope is that of the last evaluation."""
    ny = integers(table[SIZES], 8)[NY]
    _slope(table, 0)
    state, stage_state = reals(table[STATE], ny), reals(table[STAGE_STATE], ny)
    for i in range(ny):
        state[i] = stage_state[i]


@kernel
def start(table, t):
    """Evaluate at STATE and store its slope; a status."""
    ny = integers(table[SIZES], 8)[NY]
    state, stage_state = reals(table[STATE], ny), reals(table[STAGE_STATE], ny)
    for i in range(ny):
        stage_state[i] = state[i]
    hand_over(table, stage_state)
    status = evaluate(table, t, 0)
    if status <= EVENT:
        _slope(table, 0)
    return status


@kernel
def finish_step(table, t):
    """What follows every accepted state: better charts, and what the next step is held against; a status."""
    status = _better_charts(table, t)
    if status <= EVENT:
        _note_end(table)
        _begin_next(table)
        status = OK
    return status


@kernel
def _better_charts(table, t):
    """Other charts for STATE where there are better ones, and its slope in them; a status."""
    if integers(table[COUNTERS], COUNTERS_SIZE)[CHARTED] != 0 and change_charts(table) > 0:
        return start(table, t)
    return OK


@kernel
def _note_end(table):
    """From the last evaluation, that of STAGE_STATE, what the next step is held against: each contact's normal, the
    speed and rate of every 3D slip with the error that is allowed in it, and how fast friction turns it.
    """
    sizes = integers(table[SIZES], 8)
    nv, n = sizes[NV], count_items(table)
    contact_int = integer_matrix(table[CONTACT_INT], n, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], n, CONTACT_REALS)
    basis, rows = cube(table[BASIS], n, 3, 3), cube(table[ROWS], n, 3, nv)
    v, tolerances = reals(table[V], nv), reals(table[SCALE], 2)
    turning = 0.0
    for c in range(n):
        integer, number = contact_int[c], contact_real[c]
        for i in range(3):
            number[NEXT_NORMAL_X + i] = basis[c, 2, i]
        number[START_SPEED] = math.inf
        if integer[MODE] != SLIPPING or integer[TANGENTS] != 2 or integer[FROZEN] != 0 or not number[MU] > 0.0:
            continue
        number[START_SPEED], number[START_RATE] = number[SLIP_SPEED], number[SLIP_RATE]
        turning = max(turning, _turning_rate(table, c, n))
        allowed = _SMALLEST_STOP_SPEED
        for row in range(3):
            value = 0.0
            for k in range(nv):
                value += abs(rows[c, row, k]) * (tolerances[1] + tolerances[0] * abs(v[k]))
            allowed = max(allowed, value)
        number[START_TOLERANCE] = allowed
    reals(table[SCALARS], SCALARS_SIZE)[TURNING_RATE] = turning


@kernel
def _begin_next(table):
    """What was noted holds from here on; steps that slow slip makes stiff are counted."""
    n, scalars = count_items(table), reals(table[SCALARS], SCALARS_SIZE)
    counters = integers(table[COUNTERS], COUNTERS_SIZE)
    contact_real = matrix(table[CONTACT_REAL], n, CONTACT_REALS)
    for c in range(n):
        for i in range(3):
            contact_real[c, LAST_NORMAL_X + i] = contact_real[c, NEXT_NORMAL_X + i]
    stiff = scalars[TURNING_RATE] * scalars[STEP] > _STIFF
    counters[STIFF_STEPS] = counters[STIFF_STEPS] + 1 if stiff else 0
    _watch_slips(contact_real, n, scalars, counters, True)


@kernel
def _set_aside(table):
    """Keep the end of a step, projected and evaluated, while outputs within the step are evaluated."""
    ny = integers(table[SIZES], 8)[NY]
    stage_state, next_state = reals(table[STAGE_STATE], ny), reals(table[NEXT_STATE], ny)
    fill_slope(table, stage_state, reals(table[NEXT_SLOPE], ny))
    set_margins_aside(table)
    for i in range(ny):
        next_state[i] = stage_state[i]
    _note_end(table)


@kernel
def _take_up(table, t):
    """Go on from what was set aside; a status. The last evaluation is another one, unless charts were changed."""
    ny = integers(table[SIZES], 8)[NY]
    state, stage_state = reals(table[STATE], ny), reals(table[STAGE_STATE], ny)
    slope = matrix(table[SLOPES], MAX_STAGES, ny)[0]
    next_state, next_slope = reals(table[NEXT_STATE], ny), reals(table[NEXT_SLOPE], ny)
    for i in range(ny):
        state[i] = stage_state[i] = next_state[i]
        slope[i] = next_slope[i]
    take_margins_up(table)
    hand_over(table, stage_state)
    _begin_next(table)
    return _better_charts(table, t)


@kernel
def _turning_rate(table, c, n):
    """How fast friction turns the slip of item c into the direction in which it would go, in 1 / s: |F_t| w M^-1 w^T
    over the speed, with w the row across the slip."""
    nv = integers(table[SIZES], 8)[NV]
    force = matrix(table[FORCE], n, 3)[c]
    basis, rows, slip = cube(table[BASIS], n, 3, 3)[c], cube(table[ROWS], n, 3, nv)[c], matrix(table[SLIP], n, 3)[c]
    work = reals(table[WORK], nv)
    first, second = dot(basis[0], slip), dot(basis[1], slip)
    for k in range(nv):
        work[k] = first * rows[1, k] - second * rows[0, k]
    whiten(matrix(table[FACTOR], nv, nv), integers(table[PARENTS], nv), nv, work, work)
    speed = math.hypot(first, second)
    return math.hypot(force[0], force[1]) * inner(work, work, nv) / speed**3 if speed > 0.0 else 0.0


@kernel
def _watch_slips(contact_real, n, scalars, counters, accepted):
    """Count attempts that bring no slip nearer to its end, while one that slows down is within reach of it."""
    least, slowest, near = math.inf, math.inf, False
    for c in range(n):
        speed, number = contact_real[c, START_SPEED], contact_real[c]
        if speed < math.inf:
            least = min(least, speed)
            if number[START_RATE] < 0.0:
                slowest = min(slowest, speed)
                near = near or speed <= number[START_TOLERANCE] * 2.0**_STOP_DOUBLINGS
    if slowest == math.inf:
        # a slip that grows again has passed its slowest point: that was not its end
        if accepted and least < math.inf and least > _ESCAPE * scalars[SLOWEST]:
            scalars[SLOWEST] = math.inf
            counters[STALLED] = 0
        return
    if accepted and slowest < _PROGRESS * scalars[SLOWEST]:
        scalars[SLOWEST] = slowest
        counters[STALLED] = 0
    elif near:
        counters[STALLED] = min(counters[STALLED] + 1, _STOP_DOUBLINGS)


@kernel
def _slip_ends(contact_real, n, stalled):
    """Whether a slip is as good as over."""
    for c in range(n):
        speed, number = contact_real[c, START_SPEED], contact_real[c]
        if speed < math.inf and number[START_RATE] < 0.0 and speed <= number[START_TOLERANCE] * 2.0**stalled:
            return True
    return False


@kernel
def _next_step(h, error, last_error, order, rejected):
    """Step size after an attempt of size h with this error norm; last_error: that of the accepted step before.

    After a rejection by the error alone; else a PI controller (Hairer, Wanner, Solving ODEs II, Sec. IV.2).
    """
    if error == 0.0:
        return h if rejected else _LARGEST_FACTOR * h
    exponent = 1.0 / (order + 1.0)
    if rejected:
        return h * min(1.0, max(_SMALLEST_FACTOR, _SAFETY * error**-exponent))
    factor = _SAFETY * error ** (-_PRESENT * exponent) * max(last_error, _SMALLEST_LAST_ERROR) ** (_PAST * exponent)
    return h * min(_LARGEST_FACTOR, max(_SMALLEST_FACTOR, factor))


@kernel
def first_step(table, t, span):
    """NEXT_STEP: the first step from STATE, from the sizes of the state, of its slope and of that one's rate, all in
    tolerances; span: time in s that there is, and the step where nothing is controlled.

    The rate comes from a small Euler step (Hairer, Norsett, Wanner, Sec. II.4). Their step (0.01 / size)^(1 / order)
    has no unit of time, and is far too long for what turns fast; rate over slope has one, but is a guess at one
    instant. The lesser of both is within a factor of three of what the control settles at.
    """
    sizes, scalars = integers(table[SIZES], 8), reals(table[SCALARS], SCALARS_SIZE)
    ny, n = sizes[NY], count_items(table)
    state, stage_state = reals(table[STATE], ny), reals(table[STAGE_STATE], ny)
    slope, moved = matrix(table[SLOPES], MAX_STAGES, ny)[0], reals(table[NEXT_SLOPE], ny)
    absolute, relative = reals(table[ABSOLUTE], ny), reals(table[SCALE], 2)[0]
    scalars[NEXT_STEP] = span
    for i in range(ny):
        moved[i] = 0.0
    size, rate = _distance(state, state, moved, absolute, relative), _distance(state, slope, moved, absolute, relative)
    if size < 0.0:
        return
    # sizes that overflow leave nothing to go by
    h = _SMALL_STEP
    if _SMALL_SIZE <= size < math.inf and _SMALL_SIZE <= rate < math.inf:
        h = min(0.01 * size / rate, span)
        for i in range(ny):
            stage_state[i] = state[i] + h * slope[i]
        hand_over(table, stage_state)
        if evaluate(table, t + h, 0) <= EVENT:
            fill_slope(table, stage_state, moved)
            change = _distance(state, slope, moved, absolute, relative) / h
            exponent = 1.0 / (scalars[ERROR_ORDER] + 1.0)
            longer = (0.01 / max(rate, change)) ** exponent
            if change > 0.0:
                longer = min(longer, (10.0 * change / rate / rate) ** exponent * rate / change)
            if longer < math.inf:
                h = max(h, _FIRST_FRACTION * longer)
        hand_over(table, state)
    contact_real = matrix(table[CONTACT_REAL], n, CONTACT_REALS)
    for c in range(n):
        # slip that has just begun turns within the time that it has gone on
        if contact_real[c, START_SPEED] < _FIRST_FRACTION * h * abs(contact_real[c, START_RATE]):
            h = contact_real[c, START_SPEED] / (_FIRST_FRACTION * abs(contact_real[c, START_RATE]))
    scalars[NEXT_STEP] = min(h, span)


@kernel
def _distance(state, a, b, absolute, relative):
    """Root mean square of a - b over all controlled components, in the tolerances of the state; -1 without any."""
    count, total = 0, 0.0
    for i in range(state.shape[0]):
        if absolute[i] > 0.0:
            count += 1
            value = (a[i] - b[i]) / (absolute[i] + relative * abs(state[i]))
            total += value * value
    return math.sqrt(total / count) if count > 0 else -1.0


@kernel
def _irregular(count):
    """Part of the longest step that step number count may take: never twice the same, so that nothing periodic is seen
    in the same phase for long."""
    share = _GOLDEN * (count + 1)
    return 1.0 - _IRREGULAR * (share - math.floor(share))


@kernel
def march(table, task):
    """Steps from NOW towards END until Python is needed; what for.

    MARCHING: not yet, call again; STEPPED: a step was accepted, which MARCH_ONE_STEP asks for, or END was reached, or
    there is no room for more rows (at the call there must be some);
    SLIP_IS_SLOW: so many steps were stiff as PATIENCE allows;
    ATTEMPTED: a step is within its error, but neither projected nor accepted: an event function was negative, or its
    outputs could not all be written, or MARCH_ONE_ATTEMPT asks for it; SLIP_ENDS; STEP_FAILED: rejected because of the
    status in FAILURE; PROJECTION_FAILED; AT_FLOOR; AT_LIMIT: of attempts; MAY_TOUCH: open contacts might in the next
    step, at which MARCH_APART ends.
    """
    scalars, counters = reals(table[SCALARS], SCALARS_SIZE), integers(table[COUNTERS], COUNTERS_SIZE)
    sizes = integers(table[SIZES], 8)
    n, ny = count_items(table), sizes[NY]
    stage_state = reals(table[STAGE_STATE], ny)
    contact_real = matrix(table[CONTACT_REAL], n, CONTACT_REALS)
    end, fixed = scalars[END], scalars[FIXED_STEP]
    for _ in range(_BATCH):
        t, h = scalars[NOW], scalars[NEXT_STEP]
        if counters[STEP_COUNT] + counters[REJECTED_COUNT] >= counters[ATTEMPT_LIMIT]:
            return AT_LIMIT
        if _slip_ends(contact_real, n, counters[STALLED]):
            return SLIP_ENDS
        if task == MARCH_APART and not stay_apart(table, min(h, min(scalars[MAX_STEP], end - t))):
            return MAY_TOUCH
        remaining = end - t
        step = min(h, min(_irregular(counters[STEP_COUNT]) * scalars[MAX_STEP], remaining))
        for c in range(n):
            if contact_real[c, START_SPEED] < math.inf and contact_real[c, START_RATE] < 0.0:
                stop = _STOP_FRACTION * contact_real[c, START_SPEED] / -contact_real[c, START_RATE]
                if stop < scalars[FLOOR]:
                    return SLIP_ENDS
                step = min(step, stop)
        if remaining - step < _SLIVER * step:
            step = remaining
        if step < scalars[FLOOR] and step < remaining:
            return AT_FLOOR
        status = attempt(table, t, step, fixed == 0.0)
        error = scalars[ERROR_NORM]
        if status != OK or (fixed == 0.0 and error >= 1.0):
            counters[REJECTED_COUNT] += 1
            _watch_slips(contact_real, n, scalars, counters, False)
            if status != OK:
                counters[FAILURE] = status
                scalars[NEXT_STEP] = FAILED_FACTOR * step
                return STEP_FAILED
            scalars[NEXT_STEP] = _next_step(step, error, 0.0, scalars[ERROR_ORDER], True)
            continue
        counters[FAILURE] = OK
        proposal = fixed
        if fixed == 0.0:
            proposal = _next_step(step, error, scalars[LAST_ERROR], scalars[ERROR_ORDER], False)
            scalars[LAST_ERROR] = error
        # a step cut short for an output or a stop says nothing against the larger one
        scalars[NEXT_STEP] = proposal if step == h else max(proposal, min(h, 10.0 * step))
        t_new = end if step == remaining else t + step
        scalars[NEXT_TIME] = t_new
        counters[STEP_COUNT] += 1
        if task == MARCH_ONE_ATTEMPT or counters[ALARM] != 0:
            return ATTEMPTED
        inside = scalars[NEXT_OUTPUT] < t_new
        # what is not shown may be a little off, and outputs within the step need not cost the end's evaluation
        ahead = inside and task == MARCH and project(table, t_new, True, TO_STEP_ON, error) == OK
        if ahead:
            _set_aside(table)
        if inside:
            if interpolation(table, t, step) > EVENT or write_outputs(table, t_new, False) != OK:
                return ATTEMPTED
            new_state = reals(table[NEW_STATE], ny)
            for i in range(ny):
                stage_state[i] = new_state[i]
            hand_over(table, stage_state)
        if ahead and scalars[NEXT_OUTPUT] > t_new:
            if _take_up(table, t_new) > EVENT:
                return PROJECTION_FAILED
            scalars[NOW] = t_new
        else:
            shown = task not in (MARCH, MARCH_APART) or counters[RECORD_STEPS] != 0 or scalars[NEXT_OUTPUT] == t_new
            if project(table, t_new, not inside, TO_KEEP if shown else TO_STEP_ON, error) != OK:
                return PROJECTION_FAILED
            accept(table)
            scalars[NOW] = t_new
            if finish_step(table, t_new) > EVENT:
                return PROJECTION_FAILED
        if counters[RECORD_STEPS] != 0:
            record_row(table, t_new)
        while scalars[NEXT_OUTPUT] <= t_new and counters[RECORDED] < BLOCK:
            record_row(table, t_new)
            output_done(table)
        if counters[STIFF_STEPS] >= counters[PATIENCE] and fixed == 0.0:
            return SLIP_IS_SLOW
        if task == MARCH_ONE_STEP or t_new >= end or counters[RECORDED] == BLOCK:
            return STEPPED
    return MARCHING


@entry_kernel(TABLE, INTEGER, REAL, REAL, aside=True)
def run_task(table, task, t, h):
    """All tasks behind one entry, since they share their parts.

    Returns a status of `layout`; for the MARCH tasks, which take their times from the scalars, what they came back for.
    """
    if task in (EVALUATE, KINEMATICS):
        return evaluate(table, t, KINEMATICS_OF_ALL if task == KINEMATICS else 0)
    if task == ATTEMPT:
        return attempt(table, t, h, False)
    if task == INTERPOLATION_STAGES:
        return interpolation(table, t, h)
    if task in (PROJECT, PROJECT_EVALUATED):
        return project(table, t, task == PROJECT_EVALUATED, TO_KEEP, h)
    if task == SETTLE:
        return settle(table, t)
    if task == ACCEPT:
        accept(table)
        return OK
    if task == START:
        return start(table, t)
    if task == RECORD:
        record_row(table, t)
        return OK
    if task == WRITE_OUTPUTS:
        return write_outputs(table, t, True)
    if task == FINISH_STEP:
        return finish_step(table, t)
    if task == ACROSS_SLIP:
        return across_slip(table, t, h)
    if task == FIRST_STEP:
        first_step(table, t, h)
        return OK
    if task == SCAN:
        scan(table, t, h)
        return OK
    if task == BOUND_SPEEDS:
        bound_speeds(table)
        return OK
    if task == KEEP_VELOCITY:
        keep_velocity(table, reals(table[STAGE_STATE], integers(table[SIZES], 8)[NY]))
        return OK
    return march(table, task)
