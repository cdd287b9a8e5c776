"""One time step of Moreau's method: its midpoint, its end, and the state that the next one starts from.

A step of size h from (q_0, v_0) takes all smooth terms at the midpoint q_m = q_0 + (h/2) v_0, v_m = v_0 + (h/2) a,
with a the velocity's change in the last step over its size. A step in which bodies collide takes them, and the
geometry, at the mean time of its impulses instead: momenta are carried there by the motion before the impact, and from
there by the one after it, so neither way changes the energy by more than the order h^2. With P the impulses and z the
change of velocity by them,

    (M + (h/2) D) (v_1 - v_0) = h (tau - nle - D v_0) + sum of rows^T P,

and Signorini's and Coulomb's laws hold between P and the relative velocity at the step's end (`impulse_problem`).
Velocities of free, planar and spherical joints are in the joint's axes, which turn. Within a step all are in the axes
of the midpoint: v_0 is carried there from the start's, v_1 from there to the end's (see `momentum_transport`), and what
that changes in their rate is left out of nle and of the biases of v_c. A ball may spin as fast as it likes.

Joint damping D, to which viscous friction of contacts is added, enters by the trapezoidal rule, which no step size
makes unstable. What PD actuators add to both sides says `actuators`.

Every impulse has its time in the step: the middle for contacts that were closed (a force, spread over the step), the
instant of touching for those that close. The displacement is h v_0 + (h/2) (v_free - v_0) + (h - time) z, so a body
that falls and bounces within a step follows its parabolas.
"""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..dynamics.manifold import displace
from ..friction import cone
from ..friction.ellipse import scale_pair
from ..geometry.location import NO_CLOSED_FORM
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import BOOLEAN, INTEGER, NOTHING, STEPPING, kernel
from ..layout import (
    ANISOTROPIC,
    CHART,
    CLOSED_FORM,
    CONTACT_INTS,
    DOMAIN,
    FREE,
    FRICTIONLESS,
    FROZEN,
    HIGH_END,
    JOINT_END,
    JOINT_Q,
    LENGTH,
    LOW_END,
    MODE,
    MU,
    NORMAL_1,
    NORMAL_2,
    NORMAL_SIGN,
    NOT_FINITE,
    NUMBER_OF_WORKS,
    PATTERN,
    ROLLING,
    SLIP_SIGN,
    SLIPPING,
    SPINNING,
    STICK,
    SYSTEM,
    UNILATERAL,
)
from ..linalg import inner, unwhiten
from ..workspace import flat
from .accuracy import APART_AT_END, SHALLOW
from .actuators import find_actuation
from .ends import is_on_either_side
from .impulse_drives import note_drives
from .impulse_equations import equation_impulses
from .impulse_layout import (
    ACCELERATION,
    DRY_FRICTION,
    JOINT_MOVES,
    JOINT_STICKS,
    MEAN_VELOCITY,
    ON_JOINT,
    ON_LOADED,
    ON_TURN,
    ROLL,
    SLIP,
    SPIN,
    STEP,
    TURNED_ROUND,
    UPPER_LIMIT,
)
from .impulse_leaps import LEAP, is_deeper
from .impulse_problem import least_way
from .impulse_review import ANEW, DONE, review, slip_at_end
from .impulse_units import NEVER, PASSING, TOUCHING
from .impulse_velocities import add_turn_row
from .impulse_viscous import add_viscous_impulses, shares_viscous
from .impulse_works import add_works, count_energy_made, energy_made, velocity_change
from .momentum_transport import find_inertias, transport, turning_rate
from .stages import hand_over

# Size in m/s and rad/s of velocities that are none: what is held loses most of its velocity in every step, until there
# is no number for the products of impulses.
_NO_SPEED = 1e-60


@separate_kernel(NOTHING, SYSTEM.type, STEP.type, when=STEPPING)
def predict_midpoint(system, step):
    """Hand over the midpoint's state, from the start and the last step's acceleration or this one's mean velocity."""
    nq, nv, nc = system.sizes.nq, system.sizes.nv, system.sizes.nc
    counts, half = step.counts, step.numbers.ahead
    blocks, inertias, start_q, state = system.joint_table, step.inertias, step.start_q, system.stage_state
    v, displacement, carried, transported_trend = (
        step.start_v,
        step.displacement,
        step.transported_v,
        step.transported_trend,
    )
    location, rates = flat(step.start_location), flat(step.start_rates)
    for k in range(nv):
        displacement[k] = half * v[k]
    displace(blocks, start_q, start_q, displacement, state)
    transport(blocks, inertias, start_q, state, v, carried)
    if counts.passes == 0 or counts.has_trend == ACCELERATION or half != 0.5 * step.numbers.h:
        # else it is what the last pass had
        transport(blocks, inertias, start_q, state, step.trend, transported_trend)
    for k in range(nv):
        state[nq + k] = carried[k]
        if counts.has_trend == ACCELERATION:
            state[nq + k] += half * transported_trend[k]
        elif counts.has_trend == MEAN_VELOCITY:
            state[nq + k] = step.mean[k]
    for k in range(4 * nc):
        state[nq + nv + k] = location[k] + half * rates[k]
    hand_over(system, state)


@separate_kernel(NOTHING, SYSTEM.type, STEP.type, when=STEPPING)
def leave_turning_axes(system, step):
    """Take what comes of turning axes alone out of the midpoint's bias forces and biases: there velocities change from
    v_0 to v_1 in axes that stand still."""
    nv, rate = system.sizes.nv, step.turning_rate
    if not turning_rate(system.joint_table, step.inertias, system.v, rate):
        return
    mass, nle, rows, bias = system.mass, system.nle, system.rows, system.bias
    for k in range(nv):
        if rate[k] != 0.0:
            for i in range(nv):
                nle[i] -= mass[max(i, k), min(i, k)] * rate[k]
    for c in range(system.sizes.nc):
        for row in range(3):
            bias[c, row] -= inner(rows[c, row], rate, nv)


@kernel
def _contact_mode(system, step, u, c):
    """Mode of contact c after the step, from the solution of its unit u; notes when it touched."""
    unit, cone_mode, h = step.units[u], step.cone_modes[u], step.numbers.h
    rebound = step.numbers.kept * unit.shift
    contact, numbers = system.contact_int[c], system.contact_real[c]
    mu, opening = numbers[MU], least_way(h) * numbers[LENGTH]
    rest = FRICTIONLESS if mu == 0.0 else STICK
    first, second = slip_at_end(step, u)
    slides = math.hypot(first, second) * h > opening
    contact[FROZEN] = 0
    if first != 0.0:
        contact[SLIP_SIGN] = 1 if first > 0.0 else -1
    if unit.kind == ON_LOADED:
        # without load nothing holds the contact
        sticks = not slides if cone_mode == cone.OPEN else cone_mode == cone.STICK
        return STICK if sticks else SLIPPING
    slides = slides and mu != 0.0
    if slides and mu == math.inf and step.cone_forces[3 * u] == 0.0 and step.cone_forces[3 * u + 1] == 0.0:
        # nothing presses it, and there is nothing that friction would have to hold up
        slides, rest = False, FRICTIONLESS
    if cone_mode == cone.OPEN:
        # without force, though perhaps not apart: among redundant contacts others may carry the load
        gap = step.start_gap[c] if unit.touches != 0 else 0.0
        apart = (step.cone_velocities[3 * u + 2] + rebound) * h > opening
        if apart or gap > TOUCHING * numbers[LENGTH] or (slides and mu == math.inf):
            return FREE
        return SLIPPING if slides else rest
    if unit.touches != 0:
        step.touch_time[c] = unit.impulse_time
        step.counts.touched = 1
        # curvature, which is not in the rebound, may bring it back within the step, too
        if rebound + (h - unit.impulse_time) * min(system.bias[c, 2], 0.0) > 0.0:
            return FREE
    # among redundant contacts one may be at its limit of friction without sliding
    return SLIPPING if slides and cone_mode != cone.STICK else rest


@kernel
def _motion(step, u, before, moves):
    """What the slip or turning of unit u does after the step, see `impulse_layout.SLIP`."""
    if not moves:
        return STICK
    (first, second), start = slip_at_end(step, u), step.unit_start[u]
    back = before == SLIPPING and first * start[0] + second * start[1] < 0.0
    return TURNED_ROUND if back else SLIPPING


@kernel
def _clear_results(system, step):
    """Modes and impulses without any unit, but those of equations and the constant part of dry friction."""
    nv, nc, contact_int = system.sizes.nv, system.sizes.nc, system.contact_int
    impulse, joint_impulse, torques = step.contact_impulse, step.joint_impulse, step.torques
    for k in range(nv):
        step.displacement[k] = joint_impulse[k] = 0.0
    for g in range(system.joint_count[0]):
        contact_int[nc + g, MODE], system.joint_int[g, JOINT_END] = FREE, 0
        step.joint_state[g], step.limit_time[g] = JOINT_MOVES, -1.0
    for c in range(nc):
        step.touch_time[c] = -1.0
        for row in range(3):
            impulse[c, row] = torques[c, row] = 0.0
            step.motion[c, row] = 0
        contact_int[c, MODE] = FREE
        if contact_int[c, UNILATERAL] == 0:
            contact_int[c, MODE] = STICK if system.contact_real[c, MU] == math.inf else FRICTIONLESS
    step.counts.touched = 0
    for j in range(step.counts.joints):
        if step.joints[j].kind == DRY_FRICTION:
            joint_impulse[step.joints[j].index_v] += step.numbers.h * step.joints[j].middle
    for e in range(step.counts.equations):
        c, row = step.equation_index[e, 0], step.equation_index[e, 1]
        impulse[c, row] += step.equation_impulse[e]


@kernel
def _take_joint(system, step, unit, force, mode):
    """Impulse of a joint limit or of dry friction, and whether the joint is held by it; mode: of the solution."""
    joint = step.joints[unit.index]
    sign = -1.0 if joint.kind == UPPER_LIMIT else 1.0
    step.joint_impulse[joint.index_v] += sign * force
    if joint.kind == DRY_FRICTION and mode == cone.STICK:
        step.joint_state[joint.limit] = JOINT_STICKS
    if joint.kind == DRY_FRICTION or not force > 0.0:
        return
    if unit.touches != 0:
        step.counts.touched = 1
        step.limit_time[joint.limit] = unit.impulse_time
    if step.numbers.kept * unit.shift <= 0.0:
        # it does not leave its stop again within the step
        system.contact_int[system.sizes.nc + joint.limit, MODE] = FRICTIONLESS
        system.joint_int[joint.limit, JOINT_END] = -int(sign)


@kernel
def _take_turn(system, step, c, axis, force):
    """Torque that resists the turning of contact c about a basis vector."""
    add_turn_row(system, c, axis, force, step.joint_impulse)
    about, torque = system.basis[c, axis], step.torques[c]
    for j in range(3):
        torque[j] += step.orientation[c] * force * about[j] / step.numbers.h


@separate_kernel(NOTHING, SYSTEM.type, STEP.type, when=STEPPING)
def distribute(system, step):
    """Impulses of contacts and joints, new modes, ends at which joints are held; in WORK the change of velocity by all
    impulses, whitened, and in DISPLACEMENT what they displace by acting before or after the middle of the step."""
    nv, h, whole, shifted = system.sizes.nv, step.numbers.h, system.work, step.displacement
    forces, impulse = step.cone_forces, step.contact_impulse
    velocity_change(step, nv, whole)
    _clear_results(system, step)
    total = moment = 0.0
    for u in range(step.counts.units):
        unit = step.units[u]
        i, early = unit.index, 0.5 * h - unit.impulse_time
        if unit.kind < ON_JOINT:
            first, second = forces[3 * u], forces[3 * u + 1]
            if system.contact_int[i, ANISOTROPIC] != 0:
                first, second = scale_pair(system.contact_real[i], first, second)
            if unit.mask & 1 != 0:
                impulse[i, 0] += first
            if unit.mask & 2 != 0:
                impulse[i, 1] += second
            if unit.mask & 4 != 0:
                impulse[i, 2] += forces[3 * u + 2]
        if unit.kind == ON_TURN:
            first, second = slip_at_end(step, u)
            turns = step.cone_modes[u] == cone.SLIP and math.hypot(first, second) * h > least_way(h)
            motion = SPIN if unit.axis == 2 else ROLL
            step.motion[i, motion] = _motion(step, u, step.start_motion[i, motion], turns)
        for row in range(3):
            if unit.mask >> row & 1 == 0:
                continue
            force, line, size = forces[3 * u + row], step.whitened[3 * u + row], 0.0
            for k in range(nv):
                shifted[k] += early * force * line[k]
                size += (force * line[k]) ** 2
            total += math.sqrt(size)
            moment += math.sqrt(size) * unit.impulse_time
            if unit.kind == ON_TURN:
                _take_turn(system, step, i, unit.axis + row, force)
            elif unit.kind == ON_JOINT:
                _take_joint(system, step, unit, force, step.cone_modes[u])
        if unit.kind < ON_JOINT:
            contact, mode = system.contact_int[i], _contact_mode(system, step, u, i)
            contact[MODE] = mode
            if mode in (STICK, SLIPPING):
                step.motion[i, SLIP] = _motion(step, u, step.start_motion[i, SLIP], mode == SLIPPING)
            if contact[UNILATERAL] != 0:
                contact[NORMAL_SIGN] = 1
                if step.viscous_part[i] < 1.0 and mode in (SLIPPING, FRICTIONLESS):
                    # a part of its viscous friction holds it up
                    contact[MODE], contact[NORMAL_SIGN] = SLIPPING, -1
    step.numbers.impact = moment / total if total > 0.0 else 0.5 * h
    # impulses that nearly cancel (a wedged body) at different times would throw it far: one alone moves it no further
    limit, moved = 0.25 * h * h * inner(whole, whole, nv), inner(shifted, shifted, nv)
    if moved > limit:
        for k in range(nv):
            shifted[k] *= math.sqrt(limit / moved)
    _note_loads(system, step)


@kernel
def _note_loads(system, step):
    """Normal forces of contacts on which something in the next step depends, and their directions. Impulses of impacts
    are none: with them what resists turning could throw a contact off that stays closed."""
    impulse, load = step.contact_impulse, step.load
    per_impulse = 1.0 / step.numbers.h if step.counts.touched == 0 else 0.0
    for c in range(system.sizes.nc):
        contact, numbers = system.contact_int[c], system.contact_real[c]
        bilateral = contact[UNILATERAL] == 0
        if not (bilateral or numbers[SPINNING] > 0.0 or numbers[ROLLING] > 0.0):
            continue
        normal, second = impulse[c, 2], impulse[c, 1]
        load[c] = abs(normal) * per_impulse
        if contact[PATTERN] == ON_CURVE:
            length = math.hypot(normal, second)
            load[c] = length * per_impulse
            if length > 0.0:
                numbers[NORMAL_1], numbers[NORMAL_2] = normal / length, second / length
        elif bilateral and normal != 0.0:
            contact[NORMAL_SIGN] = 1 if normal > 0.0 else -1


@separate_kernel(INTEGER, SYSTEM.type, STEP.type, when=STEPPING)
def advance(system, step):
    """Review the cone problem's solution and carry out the step: state, modes, impulses; hands over its end.

    Returns DONE, AGAIN or ANEW, see `impulse_review`, or a status of `layout`.
    """
    sizes, numbers, h = system.sizes, step.numbers, step.numbers.h
    nq, nv, nc = sizes.nq, sizes.nv, sizes.nc
    equation_impulses(system, step)
    verdict = review(system, step)
    if verdict != DONE:
        return verdict
    distribute(system, step)
    if shares_viscous(system, step):
        return ANEW
    factor, parents, change = system.factor, system.parents, step.change
    gained, displacement, mean = system.work, step.displacement, step.mean
    unwhiten(factor, parents, nv, gained, gained)
    unwhiten(factor, parents, nv, displacement, displacement)
    start_v, state, assumed, mass = step.transported_v, system.stage_state, system.v, system.mass
    v1 = state[nq : nq + nv]
    total = miss = speed = squares = 0.0
    for k in range(nv):
        v1[k] = start_v[k] + change[k] + gained[k]
        displacement[k] += 0.5 * h * (start_v[k] + v1[k])
        mean[k] = displacement[k] / h
        miss += mass[k, k] * (mean[k] - assumed[k]) ** 2
        # what moves by round-off is not far off
        speed += mass[k, k] * (mean[k] ** 2 + (least_way(h) / h) ** 2)
        total += v1[k]
        squares += v1[k] * v1[k]
    if squares < _NO_SPEED**2:
        for k in range(nv):
            v1[k] = 0.0
    # a body that comes to rest is not fast, but neither is it far off
    speed += numbers.free_change**2
    numbers.miss = math.sqrt(miss / speed) if miss > 0.0 else 0.0
    numbers.made, numbers.moving = energy_made(system, step), speed
    if total - total != 0.0:
        return NOT_FINITE
    if step.counts.actuators > 0:
        find_actuation(step, h, v1)
    viscous = add_viscous_impulses(system, step, v1)
    if sizes.nwork > 0:
        start, works = system.state[nq + nv + 4 * nc :], state[nq + nv + 4 * nc :]
        for i in range(NUMBER_OF_WORKS):
            works[i] = start[i]
        add_works(system, step, v1, viscous, works)
    blocks, inertias, middle = system.joint_table, step.inertias, system.q
    displace(blocks, step.start_q, middle, displacement, state)
    transport(blocks, inertias, middle, state, v1, v1)
    transport(blocks, inertias, middle, state, start_v, step.seen_v)
    for g in range(system.joint_count[0]):
        # to the last bit; what that does to contacts is corrected with this end as a constraint
        end = system.joint_int[g, JOINT_END]
        if end != 0:
            state[system.joint_int[g, JOINT_Q]] = system.joint_real[g, LOW_END if end < 0 else HIGH_END]
    location, rates = flat(system.location), flat(system.rates)
    for k in range(4 * nc):
        state[nq + nv + k] = location[k] + (h - numbers.ahead) * rates[k]
    _report_forces(system, step)
    hand_over(system, state)
    return DONE


@kernel
def _report_forces(system, step):
    """Mean forces over the step on the contours named second, world axes (of the step's midpoint)."""
    forces, orientation, h = step.forces, step.orientation, step.numbers.h
    for c in range(system.sizes.nc):
        basis, impulse = system.basis[c], step.contact_impulse[c]
        for i in range(3):
            value = impulse[0] * basis[0, i] + impulse[1] * basis[1, i] + impulse[2] * basis[2, i]
            forces[c, i] = orientation[c] * value / h


@separate_kernel(BOOLEAN, SYSTEM.type, STEP.type, INTEGER, when=STEPPING)
def commit(system, step, stepped):
    """Make STAGE_STATE the next step's start, with the kinematics of its evaluation, moved on by the last corrections.

    stepped: 0 for the first state of a run, which has no corrections and no step behind it.
    Returns whether anything discrete (modes, signs, charts) is not what it was before.
    """
    sizes, counts, h = system.sizes, step.counts, step.numbers.h
    nq, nv, stage = sizes.nq, sizes.nv, system.stage_state
    state, start_q, start_v, trend, seen_v = system.state, step.start_q, step.start_v, step.trend, step.seen_v
    if stepped != 0:
        count_energy_made(step.numbers)
    for i in range(sizes.ny):
        state[i] = stage[i]
    for i in range(nq):
        start_q[i] = stage[i]
    find_inertias(system.joint_table, system.mass, step.inertias)
    counts.has_trend = ACCELERATION if stepped != 0 and counts.touched == 0 else 0
    for k in range(nv):
        if stepped != 0:
            trend[k] = (stage[nq + k] - seen_v[k]) / h
        start_v[k] = stage[nq + k]
    for g in range(system.joint_count[0]):
        step.start_end[g], step.start_joint[g] = system.joint_int[g, JOINT_END], step.joint_state[g]
    if system.callback.asked_for_places != 0:
        note_drives(system, step)
    changed = stepped == 0
    for c in range(sizes.nc):
        if commit_contact(system, step, c, stepped):
            changed = True
    return changed


@kernel
def commit_contact(system, step, c, stepped):
    """Take kinematics and integers of contact c for the next step's start; whether the integers are others than before.
    stepped: as for `commit`."""
    nv, rows, basis, slip = system.sizes.nv, system.rows[c], system.basis[c], step.start_slip[c]
    mode, gap, domain = system.contact_int[c, MODE], system.gaps[c, 0], system.contact_real[c, DOMAIN]
    for i in range(4):
        step.start_location[c, i], step.start_rates[c, i] = system.location[c, i], system.rates[c, i]
    for i in range(3):
        slip[i] = system.slip[c, i]
    if stepped != 0:
        gap += inner(rows[2], system.correction_q, nv)
        for row in range(3):
            gained = inner(rows[row], system.correction_v, nv)
            for i in range(3):
                slip[i] += gained * basis[row, i]
    rate, before, was_closed = dot(basis[2], slip), step.start_gap[c], step.start_mode[c] != FREE
    step.start_mode[c], step.start_gap[c] = mode, gap
    for motion in range(3):
        step.start_motion[c, motion] = abs(step.motion[c, motion])
    # what came in from behind, where it was beside the contours, or is followed there since Newton's method has gone
    # over to other stationary points, touches after it has been on the near side only, as far as steps tell
    behind, h = False, step.numbers.h
    if step.instant[c] == PASSING or (step.start_domain[c] < 0.0 and is_on_either_side(system.contact_int[c])):
        behind = True
    elif step.behind[c] != 0 or step.start_domain[c] <= APART_AT_END * system.contact_real[c, LENGTH]:
        behind = is_deeper(system, step, c, gap, rate, h)
    elif was_closed:
        # opened by what struck elsewhere, after this had come inside: it touches in the next step
        behind = gap < -SHALLOW * system.contact_real[c, LENGTH]
    elif system.contact_int[c, CLOSED_FORM] == NO_CLOSED_FORM:
        behind = is_deeper(system, step, c, gap - before, rate, LEAP * h)
    step.behind[c] = 1 if mode == FREE and gap < 0.0 <= domain and behind else 0
    step.start_domain[c], step.instant[c] = domain, NEVER
    step.start_normal[c, 0], step.start_normal[c, 1] = rate, dot(basis[1], slip)
    contact, known, changed = system.contact_int[c], step.known[c], False
    for i in range(CONTACT_INTS + 2):
        number = contact[i] if i < CONTACT_INTS else system.side_int[2 * c + i - CONTACT_INTS, CHART]
        changed = changed or known[i] != number
        known[i] = number
    return changed
