"""One trial step of Moreau's method in compiled code: see `impulses` for what it is.

It comes back to Python for cone problems that the usual ways do not solve, and goes on from there.
"""

from __future__ import annotations

import math

from ..arrays import as_array
from ..callback import kernel_caller, separate_kernel
from ..dynamics.evaluation import KINEMATICS_OF_ALL, VELOCITIES_OF_ALL, ask_for_torques
from ..dynamics.joints import END_SLACK
from ..friction import cone
from ..friction.starts import AFRESH, NEAREST, USUAL
from ..jit import INTEGER, REAL, STEPPING, kernel
from ..layout import (
    DOMAIN,
    FREE,
    FRICTIONLESS,
    HIGH_END,
    HIGH_FORCE,
    JOINT_END,
    JOINT_Q,
    JOINT_V,
    LENGTH,
    LOCATION_FAILED,
    LOW_END,
    LOW_FORCE,
    MODE,
    MU,
    NO_FORCE,
    NOT_FINITE,
    OK,
    SINGULAR,
    STICK,
    SYSTEM,
    TOO_LONG,
    UNILATERAL,
)
from ..linalg import inner, whiten
from ..workspace import square
from .accuracy import APART_AT_END
from .impulse_choices import leaves_choice, may_be_redundant
from .impulse_drives import driven_apart
from .impulse_layout import (
    ACCELERATION,
    APART,
    IN_VAIN,
    JOINT_AT_HIGH,
    JOINT_AT_LOW,
    JOINT_SLIDES_DOWN,
    JOINT_SLIDES_UP,
    JOINT_STICKS,
    LOOKED_FOR,
    MEAN_VELOCITY,
    ON_CONTACT,
    ON_JOINT,
    ON_LOADED,
    STEP,
    UNASKED,
    WANTED,
)
from .impulse_leaps import has_come_to_another, leaps, overlaps_at_end, puts_later_ones_off
from .impulse_problem import least_way
from .impulse_review import AGAIN, ANEW, may_rest
from .impulse_viscous import begin_sharing
from .impulse_works import energy_put_right
from .impulses import advance, leave_turning_axes, predict_midpoint
from .momentum_transport import transport
from .results import CLOSED_APART, CONTOUR_ENDS, LEAPT, MOTION_JUMPS, OFF_BALANCE, OVERLAPS_AT_END
from .stages import evaluate, hand_over
from .steps import PROJECT_PLACES

# A polynomial of these over the entries tells lists apart: its base, and the prime modulo which it is taken.
_BASE, _PRIME = 1_000_003, 2_147_483_647
# What it comes back with, besides a status: a cone problem is to be solved.
CONE_LEFT = 100
# What has become of the cone problem that the last call left, if it left one: solved or not, or there is room now for
# one of its size; or the trial step is to be accepted, or its way has been gone in shorter ones.
FRESH, SOLVED, UNSOLVED, APPROVED, WITH_ROOM, TAKEN = range(6)

# A step is taken again where the velocity at its midpoint was off by this fraction, at most so many times; corrections
# that leave it off by the last have not converged. One that makes energy is off by half the part that it makes.
_FAR = 0.06
_CORRECTIONS = 8
_LOST = 0.08
# A gap below this, relative to the contact's length, is zero.
_ON_SURFACE = 1e-13

call_task = kernel_caller(INTEGER, SYSTEM.type, INTEGER, REAL, REAL)
_call_on_step = kernel_caller(INTEGER, SYSTEM.type, STEP.type)
_call_cones = kernel_caller(REAL, REAL[:, ::1], REAL[::1], REAL[::1], cone.CONE.type, INTEGER, REAL)


@kernel
def ask(system, step, t):
    """Let the user's function set the torques for the system's (q, v) at t; False where it fails."""
    calls = step.calls
    if calls.asked == 0:
        return True
    system.scalars.time = t
    return ask_for_torques(system, calls)


@kernel
def _take_solution(step, found):
    """The forces, velocities and modes that a cone solver has found become those of the step."""
    forces, velocities, modes = step.cone_forces, step.cone_velocities, step.cone_modes
    for u in range(found.modes.shape[0]):
        modes[u] = found.modes[u]
        for k in range(3 * u, 3 * u + 3):
            forces[k], velocities[k] = found.forces[k], found.velocities[k]


@kernel
def _owners(step, n):
    """A number for the contacts and joints that the n units belong to, in their order: other units, another number."""
    owners = 1
    for u in range(n):
        unit = step.units[u]
        kind, index = unit.kind, unit.index
        if kind == ON_JOINT:
            joint = step.joints[index]
            kind, index = 4 + joint.kind, joint.index_v
        # a turn about the normal and one across it, and what has no axis
        owners = (owners * _BASE + (index * 8 + kind) * 3 + unit.axis) % _PRIME
    return owners


@kernel
def _begin_anew(step, n, known):
    """Let the problem of the n units, which are not those of the last problem of this size, begin with nothing, or
    where all contacts are at rest at the start of the step with these at rest."""
    known.counts[cone.KNOWN] = 0
    for u in range(n):
        unit, start = step.units[u], step.unit_start[u]
        if unit.kind < ON_JOINT:
            mode = step.start_mode[unit.index]
            if mode != STICK and mode != FRICTIONLESS:
                return
            slides = False
        else:
            slides = math.hypot(start[0], start[1]) * step.numbers.h > least_way(step.numbers.h)
        known.modes[u] = cone.SLIP if slides or step.friction[u] == 0.0 else cone.STICK
        for k in range(3):
            known.forces[3 * u + k] = 0.0
            known.velocities[3 * u + k] = start[k] if k < 2 else 0.0
    known.counts[cone.KNOWN] = 1


@kernel
def _call(step, n, friction, known, task):
    """Solve the assembled problem of n units with these coefficients; the residual."""
    return _call_cones(
        step.calls.solve_cones,
        as_array(square(step.delassus, 3 * n)),
        as_array(step.loads[: 3 * n]),
        as_array(friction[:n]),
        known,
        task,
        step.numbers.cone_tolerance,
    )


@kernel
def _solve(step, n):
    """Solve the assembled problem of n units in the usual ways; False leaves it to Python."""
    counts, numbers = step.counts, step.numbers
    address, tolerance = step.cone_tables[n], numbers.cone_tolerance
    if address == 0:
        return False
    known = cone.cone_at(address)
    # of several solutions of an impact the one that the past has no part in
    afresh = counts.cone_task >= USUAL and counts.touched != 0
    task = USUAL + AFRESH if afresh else counts.cone_task
    owners = _owners(step, n)
    if not afresh and (known.counts[cone.KNOWN] == 0 or known.counts[cone.OWNERS] != owners):
        _begin_anew(step, n, known)
    known.counts[cone.OWNERS] = owners
    residual = _call(step, n, step.friction, known, task)
    if not residual <= tolerance:
        return False
    counts.solved += 1
    numbers.cone_residual = max(numbers.cone_residual, residual)
    _take_solution(step, known)
    return True


@kernel
def _mark_struck(step, n):
    """Mark the units that impulses of what touches in the step act on, through others, too."""
    delassus, spreads = square(step.delassus, 3 * n), step.counts.touched != 0
    for u in range(n):
        step.units[u].struck = step.units[u].touches
    while spreads:
        spreads = False
        for u in range(n):
            for other in range(n if step.units[u].struck == 0 else 0):
                if step.units[other].struck != 0 and _are_coupled(delassus, u, other):
                    step.units[u].struck, spreads = 1, True
                    break


@kernel
def _are_coupled(delassus, u, other):
    for row in range(3 * u, 3 * u + 3):
        for column in range(3 * other, 3 * other + 3):
            if delassus[row, column] != 0.0:
                return True
    return False


@kernel
def _lets_go(system, step, n):
    """Whether the solution of the n units lets a contact slip or open that was at rest, or slip that comes to rest in
    the step as its slip turns back; marks them. An impact has no part in what was before, but ideal rolling must not
    slip in it."""
    h, velocities, goes = step.numbers.h, step.cone_velocities, False
    _mark_struck(step, n)
    for u in range(n):
        unit = step.units[u]
        c, mode = unit.index, step.cone_modes[u]
        unit.held = 0
        # not once more with the coefficient of sliding
        if unit.kind >= ON_JOINT or step.friction[u] < step.sticking[c]:
            continue
        rests = unit.struck == 0 and (step.start_mode[c] == STICK or may_rest(step, u))
        opening = least_way(h) * system.contact_real[c, LENGTH]
        # what cannot open has no friction without a load
        may_slide = mode == cone.SLIP or (mode == cone.OPEN and unit.kind == ON_LOADED)
        slides = may_slide and math.hypot(velocities[3 * u], velocities[3 * u + 1]) * h > opening
        opens = mode == cone.OPEN and unit.kind == ON_CONTACT and velocities[3 * u + 2] * h > opening
        rolls = slides and unit.struck != 0 and step.friction[u] == math.inf
        unit.held = 1 if rests or rolls else 0
        goes = goes or (rests and (slides or opens)) or rolls
    return goes


@kernel
def _stay_otherwise(step, n):
    """Keep at rest contacts that were so at the step's start, and that this solution lets go, where they stay so in
    another one: that in which they cannot slip, if friction holds them there."""
    if step.counts.touched != 0 or step.counts.coupled != APART:
        return
    known, friction, lets_go = cone.cone_at(step.cone_tables[n]), step.holding_friction, False
    choices, follows = known.counts[cone.CHOICES], known.counts[cone.FOLLOWS]
    for u in range(n):
        unit = step.units[u]
        friction[u] = step.friction[u]
        if unit.held != 0 and unit.kind == ON_CONTACT and step.start_mode[unit.index] == STICK:
            friction[u], known.modes[u], lets_go = math.inf, cone.STICK, True
    tolerance, task = step.numbers.cone_tolerance, max(step.counts.cone_task, NEAREST)
    holds = lets_go and _call(step, n, friction, known, task) <= tolerance
    holds = holds and _call(step, n, step.friction, known, task) <= tolerance
    for u in range(n if lets_go else 0):
        holds = holds and (friction[u] == step.friction[u] or known.modes[u] == cone.STICK)
    if holds:
        _take_solution(step, known)
        return
    known.counts[cone.CHOICES], known.counts[cone.FOLLOWS] = choices, follows
    for u in range(n):
        known.modes[u] = step.cone_modes[u]
        for k in range(3 * u, 3 * u + 3):
            known.forces[k], known.velocities[k] = step.cone_forces[k], step.cone_velocities[k]


@kernel
def _slide_on(step, n):
    """Let what came to rest within the step, to see whether it holds, slide on: whether there is any."""
    found = False
    for u in range(n):
        unit = step.units[u]
        if unit.slid != 0 and unit.at_rest != 0:
            step.friction[u], unit.at_rest, found = unit.sliding, 0, True
    return found


@kernel
def _impulses(system, step, found):
    """Cone problem and end of the step; a status, or CONE_LEFT. found: see FRESH."""
    counts = step.counts
    if found == FRESH:
        status = _call_on_step(step.calls.assemble, system, step)
        if status != OK:
            return status
    elif found == WITH_ROOM:
        found = FRESH
    while True:
        n = counts.units
        if found == UNSOLVED:
            if not _slide_on(step, n):
                return NO_FORCE
            found = FRESH
        if found == FRESH:
            counts.holding, counts.choosing = UNASKED, 0
            if n > 0 and (counts.coupled != APART or not _solve(step, n)):
                return CONE_LEFT
        if counts.holding == UNASKED and _lets_go(system, step, n):
            # forces that are not redundant are what they are, but for loads that friction itself makes, and friction
            # that may hold in other modes of what slides elsewhere
            chosen = may_be_redundant(step, system.sizes.nv, n, system.delassus, system.permutation)
            for u in range(n):
                chosen = chosen or (step.units[u].held != 0 and step.units[u].kind == ON_LOADED)
            counts.holding = WANTED if chosen else IN_VAIN
            if counts.holding == WANTED:
                return CONE_LEFT
        if counts.holding == IN_VAIN:
            counts.holding = LOOKED_FOR
            _stay_otherwise(step, n)
        if counts.choosing == 0 and n > 0 and leaves_choice(step, n):
            counts.choosing = 1
            return CONE_LEFT
        found = FRESH
        status = advance(system, step)
        if status == ANEW:
            status = _call_on_step(step.calls.assemble, system, step)
            if status == OK:
                continue
        if status != AGAIN:
            return status


@kernel
def _may_be_wedged(system, step):
    """Whether two contacts or more take part in an impact that may not slip, and the evaluated state is not on all of
    them."""
    count, apart = 0, False
    for c in range(system.sizes.nc):
        numbers = system.contact_real[c]
        if numbers[MU] == math.inf and (step.touch_time[c] >= 0.0 or step.start_mode[c] != FREE):
            count += 1
            apart = apart or abs(system.gaps[c, 0]) > _ON_SURFACE * numbers[LENGTH]
    return count > 1 and apart


@kernel
def _close_touching(system, step, t):
    """Put the state of an impact on the contacts that it closes, if there is such a state.

    Points of a body that touch a little above or below the surface could be wedged: forces between them, which no
    motion of the body feels, would press against it.
    """
    contact_int, modes, nq, nv = system.contact_int, step.impact_mode, system.sizes.nq, system.sizes.nv
    state, before = system.stage_state, step.impact_state
    for k in range(before.shape[0]):
        before[k] = state[k]
    for c in range(system.sizes.nc):
        modes[c] = contact_int[c, MODE]
        if step.touch_time[c] >= 0.0 and modes[c] == FREE:
            contact_int[c, MODE] = FRICTIONLESS
    status = call_task(step.calls.run_task, system, PROJECT_PLACES, t, 0.0)
    for c in range(system.sizes.nc):
        contact_int[c, MODE] = modes[c]
    for k in range(before.shape[0]):
        # velocities stay what they were
        if status != OK or nq <= k < nq + nv:
            state[k] = before[k]
    hand_over(system, state)


@kernel
def _pass(system, step, t, found):
    """Midpoint, cone problem and end of the step from t; a status, or CONE_LEFT."""
    counts, numbers = step.counts, step.numbers
    if found == FRESH:
        predict_midpoint(system, step)
        middle, tau, asked_before = t + numbers.ahead, system.tau, step.asked_before
        for k in range(system.sizes.nv):
            asked_before[k] = tau[k]
        if not ask(system, step, middle):
            return NOT_FINITE
        # but for impacts the passes of a trial step differ in the midpoint's velocity only
        moved = counts.passes == 0 or numbers.ahead != 0.5 * numbers.h
        status = evaluate(system, middle, KINEMATICS_OF_ALL if moved else VELOCITIES_OF_ALL)
        if status == OK and counts.passes != 0 and counts.touched != 0 and _may_be_wedged(system, step):
            _close_touching(system, step, middle)
            status = evaluate(system, middle, KINEMATICS_OF_ALL)
        if status != OK:
            return status
        leave_turning_axes(system, step)
        begin_sharing(system, step)
        counts.rigid = counts.thorough = 0
    while True:
        status = _impulses(system, step, found)
        if status != NO_FORCE or counts.thorough != 0:
            return status
        found = FRESH
        if counts.rigid == 0:
            # redundant contacts may contradict each other by what only rigid geometry leaves out
            counts.rigid = 1
            counts.rigid_steps += 1
        else:
            counts.thorough = 1


@kernel
def _review_end(system, step, h):
    """The trial step, whose end has been put on the constraints: contacts that went beyond the end of a contour
    open. A status: those that cannot open end there, and closed ones that are still apart, or not followed, are a
    failure."""
    nv, correction, status = system.sizes.nv, system.correction_q, OK
    for c in range(system.sizes.nc):
        contact, numbers = system.contact_int[c], system.contact_real[c]
        step.edge_time[c] = -1.0
        if contact[MODE] == FREE:
            if overlaps_at_end(system, step, c, h):
                return OVERLAPS_AT_END
            continue
        if not abs(system.gaps[c, 0] + inner(system.rows[c, 2], correction, nv)) <= APART_AT_END * numbers[LENGTH]:
            return CLOSED_APART
        if leaps(system, step, c, h):
            return LEAPT
        if contact[UNILATERAL] != 0 and system.counters.paired != 0 and has_come_to_another(system, c):
            contact[MODE], step.touch_time[c] = FREE, -1.0
            continue
        domain, before = numbers[DOMAIN], step.start_domain[c]
        if domain >= 0.0:
            continue
        if contact[UNILATERAL] == 0:
            status = CONTOUR_ENDS
            continue
        contact[MODE] = FREE
        step.edge_time[c] = h * before / (before - domain) if 0.0 < before < math.inf else 0.0
    return status


@kernel
def find_joint_states(system, step):
    """What limited coordinates do at STAGE_STATE, where nothing has said that they stick."""
    state, nq, size = system.stage_state, system.sizes.nq, step.numbers.step_size
    slowest = least_way(size) / size
    for g in range(system.joint_count[0]):
        joint, numbers = system.joint_int[g], system.joint_real[g]
        position, speed, end = state[joint[JOINT_Q]], state[nq + joint[JOINT_V]], joint[JOINT_END]
        if end == 0 and abs(speed) <= slowest:
            # without load, too
            end = -1 if position <= numbers[LOW_END] + END_SLACK else 0
            end = 1 if position >= numbers[HIGH_END] - END_SLACK else end
        if end != 0:
            step.joint_state[g] = JOINT_AT_LOW if end < 0 else JOINT_AT_HIGH
        elif numbers[LOW_FORCE] < numbers[HIGH_FORCE] and step.joint_state[g] != JOINT_STICKS:
            slides = JOINT_SLIDES_DOWN if speed < 0.0 else JOINT_SLIDES_UP
            step.joint_state[g] = slides if abs(speed) > slowest else JOINT_STICKS


@kernel
def _puts_off(system, step):
    """By which part of the velocity the step's end is off, since the velocity at its midpoint is: as bodies turn in
    between, or by the torques of a control, which the last two passes have told. Slip that begins and ends by turns
    from one pass to the next makes that velocity uncertain, too, where nothing comes of it."""
    nv, h, v, change = system.sizes.nv, step.numbers.h, step.mean, system.work
    turned, moving = 0.0, step.numbers.free_change**2 + (least_way(h) / h) ** 2
    for k in range(nv):
        turned = max(turned, h * max(abs(v[k]), abs(system.v[k])))
        moving += system.mass[k, k] * v[k] * v[k]
        change[k] = h * (system.tau[k] - step.asked_before[k])
    whiten(system.factor, system.parents, nv, change, change)
    return min(turned, 1.0) * step.numbers.miss + math.sqrt(inner(change, change, nv) / moving)


@separate_kernel(INTEGER, SYSTEM.type, STEP.type, REAL, REAL, INTEGER, when=STEPPING)
def trial_step(system, step, t, h, found):
    """A step of size h from the start at t; a status, or CONE_LEFT."""
    counts, numbers = step.counts, step.numbers
    if found == FRESH:
        numbers.h, numbers.ahead = h, 0.5 * h
        counts.passes, counts.trend_before = 0, counts.has_trend
        for c in range(system.sizes.nc):
            step.put_off[c] = 0
    while True:
        status = _pass(system, step, t, found)
        if status == CONE_LEFT:
            return status
        found = FRESH
        before = counts.passes
        if before > 1 and status in (LOCATION_FAILED, SINGULAR):
            status = TOO_LONG
        if status != OK:
            break
        # The step is taken again with what it tells: where there is no last step to tell it the acceleration, without
        # which nothing is known of what touches, and the mean velocity where impacts change it.
        if before == 0 and counts.trend_before == 0:
            state, trend, nq = system.stage_state, step.trend, system.sizes.nq
            for k in range(system.sizes.nv):
                trend[k] = (state[nq + k] - step.seen_v[k]) / h
            transport(system.joint_table, step.inertias, state, step.start_q, trend, trend)
            counts.passes, counts.has_trend = 1, ACCELERATION
            continue
        if counts.touched != 0 and counts.has_trend != MEAN_VELOCITY:
            if puts_later_ones_off(system, step):
                continue
            numbers.ahead = numbers.impact
            counts.passes, counts.has_trend = before + 1, MEAN_VELOCITY
            continue
        # A step in which bodies turn far is taken again with its own mean velocity: the implicit midpoint rule, which
        # stays stable where the velocity foretold from the last step does not.
        if before > _CORRECTIONS:
            if numbers.miss > _LOST and _puts_off(system, step) > _LOST:
                status = TOO_LONG
            break
        if counts.touched != 0 or not numbers.miss > _FAR:
            break
        counts.passes, counts.has_trend = max(before, 1) + 1, MEAN_VELOCITY
    counts.has_trend = counts.trend_before
    if status != OK:
        return status
    nq, nv, ahead, state = system.sizes.nq, system.sizes.nv, step.unprojected_v, system.stage_state
    for k in range(nv):
        ahead[k] = state[nq + k]
    status = call_task(step.calls.run_task, system, PROJECT_PLACES, t + h, 0.0)
    numbers.made += energy_put_right(system, ahead, state[nq : nq + nv])
    if system.callback.asked_for_places != 0 and status in (OK, CLOSED_APART):
        counts.jumped = driven_apart(system, step, h)
        if counts.jumped >= 0:
            return MOTION_JUMPS
    if status == OK and abs(numbers.made) > _LOST * numbers.moving:
        # of the energy twice that part of the velocity, which is off by as much
        return OFF_BALANCE
    find_joint_states(system, step)
    return status if status != OK else _review_end(system, step, h)
