"""Whole steps in compiled code: evaluations, Runge-Kutta stages, step control and projection, one call for many steps.

The loop comes back to Python only for what needs it: an event function that became negative, an output, a user's
function, the end of slip, a failure. Pinocchio is called from inside (see `callback`).
"""

from __future__ import annotations

import math

from ..callback import kernel_caller
from ..dynamics.equations import slip_direction
from ..dynamics.evaluation import KINEMATICS_OF_ALL, PLACES_OF_ALL, PLACES_OF_CLOSED, contact_corrections
from ..dynamics.linear import inner, whiten
from ..dynamics.resistance import count_items
from ..geometry.chart_changes import change_charts
from ..geometry.small import dot
from ..jit import INTEGER, REAL, entry_kernel, kernel
from ..layout import (
    EVENT,
    FROZEN,
    LAST_NORMAL_X,
    LOCATION_FAILED,
    MARGINS_PER_CONTACT,
    MODE,
    MU,
    NEXT_NORMAL_X,
    NOT_FINITE,
    OK,
    POLYNOMIAL_SIZE,
    SLIP_RATE,
    SLIP_SPEED,
    SLIPPING,
    START_RATE,
    START_SPEED,
    START_TOLERANCE,
    SYSTEM,
    TANGENTS,
    system_at,
)
from ..workspace import flat
from .approach import bound_speeds, stay_apart
from .dense import dense_coefficients, interpolate
from .recording import BLOCK, output_done, record_row
from .resolution import keep_margins, margin_error, set_margins_aside, take_margins_up
from .results import CLOSED_APART, CONTRADICTION
from .stages import (
    build_state,
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


_call_evaluation = kernel_caller(INTEGER, SYSTEM.type, REAL, INTEGER)


@kernel
def evaluate(system, time, only_kinematics):
    """Pinocchio's terms and one evaluation at (q, v), by a kernel of its own; arguments and status are its."""
    return _call_evaluation(system.callback.evaluation, system, time, only_kinematics)


@kernel
def _slope(system, index):
    """Slope number `index` from the last evaluation, of the state in STAGE_STATE."""
    fill_slope(system, system.stage_state, system.slopes[index])
    keep_margins(system, index)


@kernel
def _stages(system, t, h, first, last, adaptive):
    """Stages first .. last of a step of size h from the state at t; a status.

    adaptive: leave the step's end unevaluated where the error estimate already rejects it.
    """
    scalars, counters = system.scalars, system.counters
    nodes = system.nodes
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
        _slope(system, s)
        if s < end:
            build_state(system, s + 1)
        if s == estimate_after:
            norm = error_norm(system, s)
            scalars.error_norm = norm
            if not norm < math.inf:
                return NOT_FINITE
    return OK


@kernel
def attempt(system, t, h, adaptive):
    """A step of size h from the state at t, which is kept.

    ALARM tells whether an event function was negative in a stage, or may have been between two. adaptive: their
    resolution counts as an error, too (see `resolution`).
    """
    counters = system.counters
    n = MARGINS_PER_CONTACT * count_items(system)
    lowest, highest = flat(system.lowest), flat(system.highest)
    for i in range(n):
        lowest[i], highest[i] = math.inf, -math.inf
    counters.alarm = 0
    status = _stages(system, t, h, 1, system.sizes.nstages, adaptive)
    dip = system.scalars.dip
    for i in range(n):
        # written such that infinite margins compare
        if (1.0 + dip) * lowest[i] < dip * highest[i]:
            counters.alarm = 1
    if adaptive and status <= EVENT and system.scalars.error_norm < 1.0:
        margin_error(system)
    return status


@kernel
def _contradicts(system):
    """Whether the last correction leaves velocities that it was to take away, since constraints contradict each other:
    those of rigid geometry do by errors of the configuration only, that is by no more than its own correction."""
    scalars, v = system.scalars, system.v
    if scalars.velocity_left == 0.0:
        return False
    fastest = 1.0
    for k in range(v.shape[0]):
        fastest = max(fastest, abs(v[k]))
    return scalars.velocity_left > (_CONTRADICTING + _OF_CORRECTION * scalars.correction_size) * fastest


@kernel
def project(system, t, evaluated, purpose, error):
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
    sizes, scalars = system.sizes, system.scalars
    beyond = count_items(system) - sizes.nc
    if sizes.nc + beyond == 0:
        return OK
    q = system.q
    # forces of guarded joints and resistances are shown with the state
    part = PLACES_OF_CLOSED if purpose == TO_SHOW and beyond == 0 else 0
    for i in range(_PROJECTIONS):
        if i > 0 or not evaluated:
            status = evaluate(system, t, part)
            if status > EVENT:
                return status
        count = contact_corrections(system, 1, 1)
        if count == 0 or (scalars.gap_residual <= _ROUND_OFF and scalars.velocity_residual <= _ROUND_OFF):
            correct_state(system, 0, 0)
            return OK
        change = correct_state(system, 1, 1)
        if _contradicts(system):
            return CONTRADICTION
        if i == 0 and change > max(_EXPLAINED, _LEAST_EXPLAINED / system.scale[0]) * max(error, 1.0):
            return LOCATION_FAILED
        close = change <= _CLOSE
        size, largest = scalars.correction_size, 1.0
        for k in range(sizes.nq):
            largest = max(largest, abs(q[k]))
        if size <= _NEGLIGIBLE * largest or (close and purpose == TO_STEP_ON):
            return OK
        if not size < _LARGEST_CORRECTION:
            break
        if close and beyond == 0:
            part = PLACES_OF_CLOSED
    return OK if scalars.gap_residual < _PROJECTED_GAP else LOCATION_FAILED


@kernel
def interpolation(system, t, h):
    """The extra stages and the coefficients of dense output for the attempted step of size h from t; a status."""
    scalars = system.scalars
    first = system.sizes.nstages + 1
    extra = system.counters.extra_stages
    scalars.dense_start, scalars.dense_step = t, h
    status = _stages(system, t, h, first, first + extra - 1, False)
    if status <= EVENT:
        dense_coefficients(system)
    return status


@kernel
def across_slip(system, t, h):
    """How well prescribed slip directions hold in a step of size h from the state at t, which is attempted; a status.

    ACROSS is filled with v_c across the direction at the shares of the step in its first row, up to a zero, and then
    with v_c along it.
    """
    n = count_items(system)
    status = start(system, t)
    if status <= EVENT:
        status = attempt(system, t, h, False)
    if status == OK:
        status = interpolation(system, t, h)
    if status > EVENT:
        return status
    contact_int = system.contact_int
    contact_real = system.contact_real
    basis, slip = system.basis, system.slip
    across = system.across
    direction = system.vectors[0]
    for k in range(POLYNOMIAL_SIZE):
        share = across[0, k]
        if share == 0.0:
            break
        _interpolated(system, share)
        status = evaluate(system, t + share * h, KINEMATICS_OF_ALL)
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
def scan(system, t, h):
    """Margins along the step from t of size h that was interpolated last, at SCAN_SHARES of it: see `System.scan`."""
    n = count_items(system)
    shares, statuses = system.scan_shares, system.scan_status
    found = system.scan_margins
    margins = system.margins
    for i in range(system.counters.scan_count):
        _interpolated(system, shares[i])
        statuses[i] = evaluate(system, t + shares[i] * h, 0)
        for c in range(n):
            for kind in range(MARGINS_PER_CONTACT):
                found[i, c, kind] = margins[c, kind]


@kernel
def _interpolated(system, theta):
    """Hand over the state at the fraction theta of the step that was interpolated last."""
    stage_state = system.stage_state
    nested = system.counters.dense_nested
    interpolate(system.dense, system.state, nested, theta, stage_state)
    hand_over(system, stage_state)


@kernel
def write_outputs(system, until, inclusive):
    """Record the output times before `until`, or up to it, of the step that was interpolated last.

    Each is projected on the constraints. A status, or BLOCK_FULL.
    """
    scalars, counters = system.scalars, system.counters
    while scalars.next_output < until or (inclusive and scalars.next_output == until):
        if counters.recorded == BLOCK:
            return BLOCK_FULL
        t = scalars.next_output
        _interpolated(system, (t - scalars.dense_start) / scalars.dense_step)
        status = project(system, t, False, TO_SHOW, math.inf)
        if status != OK:
            return status
        record_row(system, t)
        output_done(system)
    return OK


@kernel
def settle(system, t):
    """Kinematics of STAGE_STATE, which is put on the constraints with whatever factor there is; a status.

    For a method that needs no accelerations; open contacts are evaluated too.
    """
    last = 0.0
    for _ in range(_SETTLEMENTS):
        status = evaluate(system, t, PLACES_OF_ALL)
        if status != OK:
            return status
        contact_corrections(system, 1, 1)
        correct_state(system, 1, 1)
        if _contradicts(system):
            return CONTRADICTION
        size = system.scalars.correction_size
        if size <= _SMALL_CORRECTION or size * size * size <= _FORETOLD_CORRECTION * last * last:
            return OK
        last = size
    return OK if system.scalars.gap_residual < _SETTLED_GAP else CLOSED_APART


@kernel
def accept(system):
    """The projected state becomes the next step's start; its slope is that of the last evaluation."""
    ny = system.sizes.ny
    _slope(system, 0)
    state, stage_state = system.state, system.stage_state
    for i in range(ny):
        state[i] = stage_state[i]


@kernel
def start(system, t):
    """Evaluate at STATE and store its slope; a status."""
    ny = system.sizes.ny
    state, stage_state = system.state, system.stage_state
    for i in range(ny):
        stage_state[i] = state[i]
    hand_over(system, stage_state)
    status = evaluate(system, t, 0)
    if status <= EVENT:
        _slope(system, 0)
    return status


@kernel
def finish_step(system, t):
    """What follows every accepted state: better charts, and what the next step is held against; a status."""
    status = _better_charts(system, t)
    if status <= EVENT:
        _note_end(system)
        _begin_next(system)
        status = OK
    return status


@kernel
def _better_charts(system, t):
    """Other charts for STATE where there are better ones, and its slope in them; a status."""
    if system.counters.charted != 0 and change_charts(system) > 0:
        return start(system, t)
    return OK


@kernel
def _note_end(system):
    """From the last evaluation, that of STAGE_STATE, what the next step is held against: each contact's normal, the
    speed and rate of every 3D slip with the error that is allowed in it, and how fast friction turns it.
    """
    sizes = system.sizes
    nv, n = sizes.nv, count_items(system)
    contact_int = system.contact_int
    contact_real = system.contact_real
    basis, rows = system.basis, system.rows
    v, tolerances = system.v, system.scale
    turning = 0.0
    for c in range(n):
        integer, number = contact_int[c], contact_real[c]
        for i in range(3):
            number[NEXT_NORMAL_X + i] = basis[c, 2, i]
        number[START_SPEED] = math.inf
        if integer[MODE] != SLIPPING or integer[TANGENTS] != 2 or integer[FROZEN] != 0 or not number[MU] > 0.0:
            continue
        number[START_SPEED], number[START_RATE] = number[SLIP_SPEED], number[SLIP_RATE]
        turning = max(turning, _turning_rate(system, c, n))
        allowed = _SMALLEST_STOP_SPEED
        for row in range(3):
            value = 0.0
            for k in range(nv):
                value += abs(rows[c, row, k]) * (tolerances[1] + tolerances[0] * abs(v[k]))
            allowed = max(allowed, value)
        number[START_TOLERANCE] = allowed
    system.scalars.turning_rate = turning


@kernel
def _begin_next(system):
    """What was noted holds from here on; steps that slow slip makes stiff are counted."""
    n, scalars = count_items(system), system.scalars
    counters = system.counters
    contact_real = system.contact_real
    for c in range(n):
        for i in range(3):
            contact_real[c, LAST_NORMAL_X + i] = contact_real[c, NEXT_NORMAL_X + i]
    stiff = scalars.turning_rate * scalars.step > _STIFF
    counters.stiff_steps = counters.stiff_steps + 1 if stiff else 0
    _watch_slips(contact_real, n, scalars, counters, True)


@kernel
def _set_aside(system):
    """Keep the end of a step, projected and evaluated, while outputs within the step are evaluated."""
    ny = system.sizes.ny
    stage_state, next_state = system.stage_state, system.next_state
    fill_slope(system, stage_state, system.next_slope)
    set_margins_aside(system)
    for i in range(ny):
        next_state[i] = stage_state[i]
    _note_end(system)


@kernel
def _take_up(system, t):
    """Go on from what was set aside; a status. The last evaluation is another one, unless charts were changed."""
    ny = system.sizes.ny
    state, stage_state = system.state, system.stage_state
    slope = system.slopes[0]
    next_state, next_slope = system.next_state, system.next_slope
    for i in range(ny):
        state[i] = stage_state[i] = next_state[i]
        slope[i] = next_slope[i]
    take_margins_up(system)
    hand_over(system, stage_state)
    _begin_next(system)
    return _better_charts(system, t)


@kernel
def _turning_rate(system, c, n):
    """How fast friction turns the slip of item c into the direction in which it would go, in 1 / s: |F_t| w M^-1 w^T
    over the speed, with w the row across the slip."""
    nv = system.sizes.nv
    force = system.force[c]
    basis, rows, slip = system.basis[c], system.rows[c], system.slip[c]
    work = system.work
    first, second = dot(basis[0], slip), dot(basis[1], slip)
    for k in range(nv):
        work[k] = first * rows[1, k] - second * rows[0, k]
    whiten(system.factor, system.parents, nv, work, work)
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
        if accepted and least < math.inf and least > _ESCAPE * scalars.slowest:
            scalars.slowest = math.inf
            counters.stalled = 0
        return
    if accepted and slowest < _PROGRESS * scalars.slowest:
        scalars.slowest = slowest
        counters.stalled = 0
    elif near:
        counters.stalled = min(counters.stalled + 1, _STOP_DOUBLINGS)


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
def first_step(system, t, span):
    """NEXT_STEP: the first step from STATE, from the sizes of the state, of its slope and of that one's rate, all in
    tolerances; span: time in s that there is, and the step where nothing is controlled.

    The rate comes from a small Euler step (Hairer, Norsett, Wanner, Sec. II.4). Their step (0.01 / size)^(1 / order)
    has no unit of time, and is far too long for what turns fast; rate over slope has one, but is a guess at one
    instant. The lesser of both is within a factor of three of what the control settles at.
    """
    sizes, scalars = system.sizes, system.scalars
    ny, n = sizes.ny, count_items(system)
    state, stage_state = system.state, system.stage_state
    slope, moved = system.slopes[0], system.next_slope
    absolute, relative = system.absolute, system.scale[0]
    scalars.next_step = span
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
        hand_over(system, stage_state)
        if evaluate(system, t + h, 0) <= EVENT:
            fill_slope(system, stage_state, moved)
            change = _distance(state, slope, moved, absolute, relative) / h
            exponent = 1.0 / (scalars.error_order + 1.0)
            longer = (0.01 / max(rate, change)) ** exponent
            if change > 0.0:
                longer = min(longer, (10.0 * change / rate / rate) ** exponent * rate / change)
            if longer < math.inf:
                h = max(h, _FIRST_FRACTION * longer)
        hand_over(system, state)
    contact_real = system.contact_real
    for c in range(n):
        # slip that has just begun turns within the time that it has gone on
        if contact_real[c, START_SPEED] < _FIRST_FRACTION * h * abs(contact_real[c, START_RATE]):
            h = contact_real[c, START_SPEED] / (_FIRST_FRACTION * abs(contact_real[c, START_RATE]))
    scalars.next_step = min(h, span)


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
def march(system, task):
    """Steps from NOW towards END until Python is needed; what for.

    MARCHING: not yet, call again; STEPPED: a step was accepted, which MARCH_ONE_STEP asks for, or END was reached, or
    there is no room for more rows (at the call there must be some);
    SLIP_IS_SLOW: so many steps were stiff as PATIENCE allows;
    ATTEMPTED: a step is within its error, but neither projected nor accepted: an event function was negative, or its
    outputs could not all be written, or MARCH_ONE_ATTEMPT asks for it; SLIP_ENDS; STEP_FAILED: rejected because of the
    status in FAILURE; PROJECTION_FAILED; AT_FLOOR; AT_LIMIT: of attempts; MAY_TOUCH: open contacts might in the next
    step, at which MARCH_APART ends.
    """
    scalars, counters = system.scalars, system.counters
    sizes = system.sizes
    n, ny = count_items(system), sizes.ny
    stage_state = system.stage_state
    contact_real = system.contact_real
    end, fixed = scalars.end, scalars.fixed_step
    for _ in range(_BATCH):
        t, h = scalars.now, scalars.next_step
        if counters.step_count + counters.rejected_count >= counters.attempt_limit:
            return AT_LIMIT
        if _slip_ends(contact_real, n, counters.stalled):
            return SLIP_ENDS
        if task == MARCH_APART and not stay_apart(system, min(h, min(scalars.max_step, end - t))):
            return MAY_TOUCH
        remaining = end - t
        step = min(h, min(_irregular(counters.step_count) * scalars.max_step, remaining))
        for c in range(n):
            if contact_real[c, START_SPEED] < math.inf and contact_real[c, START_RATE] < 0.0:
                stop = _STOP_FRACTION * contact_real[c, START_SPEED] / -contact_real[c, START_RATE]
                if stop < scalars.floor:
                    return SLIP_ENDS
                step = min(step, stop)
        if remaining - step < _SLIVER * step:
            step = remaining
        if step < scalars.floor and step < remaining:
            return AT_FLOOR
        status = attempt(system, t, step, fixed == 0.0)
        error = scalars.error_norm
        if status != OK or (fixed == 0.0 and error >= 1.0):
            counters.rejected_count += 1
            _watch_slips(contact_real, n, scalars, counters, False)
            if status != OK:
                counters.failure = status
                scalars.next_step = FAILED_FACTOR * step
                return STEP_FAILED
            scalars.next_step = _next_step(step, error, 0.0, scalars.error_order, True)
            continue
        counters.failure = OK
        proposal = fixed
        if fixed == 0.0:
            proposal = _next_step(step, error, scalars.last_error, scalars.error_order, False)
            scalars.last_error = error
        # a step cut short for an output or a stop says nothing against the larger one
        scalars.next_step = proposal if step == h else max(proposal, min(h, 10.0 * step))
        t_new = end if step == remaining else t + step
        scalars.next_time = t_new
        counters.step_count += 1
        if task == MARCH_ONE_ATTEMPT or counters.alarm != 0:
            return ATTEMPTED
        inside = scalars.next_output < t_new
        # what is not shown may be a little off, and outputs within the step need not cost the end's evaluation
        ahead = inside and task == MARCH and project(system, t_new, True, TO_STEP_ON, error) == OK
        if ahead:
            _set_aside(system)
        if inside:
            if interpolation(system, t, step) > EVENT or write_outputs(system, t_new, False) != OK:
                return ATTEMPTED
            new_state = system.new_state
            for i in range(ny):
                stage_state[i] = new_state[i]
            hand_over(system, stage_state)
        if ahead and scalars.next_output > t_new:
            if _take_up(system, t_new) > EVENT:
                return PROJECTION_FAILED
            scalars.now = t_new
        else:
            shown = task not in (MARCH, MARCH_APART) or counters.record_steps != 0 or scalars.next_output == t_new
            if project(system, t_new, not inside, TO_KEEP if shown else TO_STEP_ON, error) != OK:
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
        if counters.stiff_steps >= counters.patience and fixed == 0.0:
            return SLIP_IS_SLOW
        if task == MARCH_ONE_STEP or t_new >= end or counters.recorded == BLOCK:
            return STEPPED
    return MARCHING


@entry_kernel(INTEGER, INTEGER, REAL, REAL, aside=True)
def run_task(address, task, t, h):
    """All tasks behind one entry, since they share their parts.

    Returns a status of `layout`; for the MARCH tasks, which take their times from the scalars, what they came back for.
    """
    return _run(system_at(address), task, t, h)


@kernel
def _run(system, task, t, h):
    # a part: what an entry kernel calls itself is compiled once more for those that are called by parts
    if task in (EVALUATE, KINEMATICS):
        return evaluate(system, t, KINEMATICS_OF_ALL if task == KINEMATICS else 0)
    if task == ATTEMPT:
        return attempt(system, t, h, False)
    if task == INTERPOLATION_STAGES:
        return interpolation(system, t, h)
    if task in (PROJECT, PROJECT_EVALUATED):
        return project(system, t, task == PROJECT_EVALUATED, TO_KEEP, h)
    if task == SETTLE:
        return settle(system, t)
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
    if task == ACROSS_SLIP:
        return across_slip(system, t, h)
    if task == FIRST_STEP:
        first_step(system, t, h)
        return OK
    if task == SCAN:
        scan(system, t, h)
        return OK
    if task == BOUND_SPEEDS:
        bound_speeds(system)
        return OK
    if task == KEEP_VELOCITY:
        keep_velocity(system, system.stage_state)
        return OK
    return march(system, task)
