"""One time step of Moreau's method: its midpoint, its end, and the state that the next one starts from.

A step of size h from (q_0, v_0) takes all smooth terms at the midpoint q_m = q_0 + (h/2) v_0, v_m = v_0 + (h/2) a,
with a the velocity's change in the last step over its size. A step in which bodies collide takes them, and the
geometry, at the mean time of its impulses instead: momenta are carried there by the motion before the impact, and from
there by the one after it, so neither way changes the energy by more than the order h^2. With P the impulses and z the
change of velocity by them,

    (M + (h/2) D) (v_1 - v_0) = h (tau - nle - D v_0) + sum of rows^T P,

and Signorini's and Coulomb's laws hold between P and the relative velocity at the step's end (`impulse_problem`).
Velocities of free, planar and spherical joints are in the joint's axes, which turn. Within a step all are in the axes
of the midpoint: v_0 is carried there from the start's, v_1 from there to the end's (see `carrying`), and what that
changes in their rate is left out of nle and of the biases of v_c. A ball may spin as fast as it likes.

Joint damping D, to which viscous friction of contacts is added, enters by the trapezoidal rule, which no step size
makes unstable.

Every impulse has its time in the step: the middle for contacts that were closed (a force, spread over the step), the
instant of touching for those that close. The displacement is h v_0 + (h/2) (v_free - v_0) + (h - time) z, so a body
that falls and bounces within a step follows its parabolas.
"""

from __future__ import annotations

import math

from ..dynamics.equations import inner
from ..dynamics.linear import unwhiten
from ..dynamics.manifold import displace
from ..friction import cone
from ..friction.ellipse import stretch_pair
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import kernel
from ..layout import (
    ANISOTROPIC,
    CHART,
    CONTACT_INTS,
    DOMAIN,
    FREE,
    FRICTIONLESS,
    FROZEN,
    GUARD_END,
    GUARD_Q,
    HIGH_END,
    LENGTH,
    LOW_END,
    MODE,
    MOTION_KIND,
    MU,
    NORMAL_1,
    NORMAL_2,
    NORMAL_SIGN,
    NOT_FINITE,
    PATTERN,
    ROLLING,
    SLIP_SIGN,
    SLIPPING,
    SPINNING,
    STICK,
    TANGENTS,
    TIME_DEPENDENT,
    UNILATERAL,
    VISCOUS,
)
from ..workspace import flat
from .carrying import carry, find_inertias, turning_rate
from .impulse_layout import (
    ACCELERATION,
    AHEAD,
    AXIS,
    DRIVEN_T1,
    DRY_FRICTION,
    FREE_CHANGE,
    HAS_TREND,
    IMPACT,
    IMPULSE_TIME,
    JOINT_GUARD,
    JOINT_KIND,
    JOINT_V,
    KEPT,
    MEAN_VELOCITY,
    MIDPOINT,
    MISS,
    NEQ,
    NJ,
    ON_JOINT,
    ON_LOADED,
    ON_TURN,
    PASSES,
    ROW_MASK,
    SHIFT,
    START_T1,
    START_T2,
    TOUCHED,
    TOUCHES,
    TREND_BEFORE,
    UNIT_INDEX,
    UNIT_KIND,
    UNITS,
    UPPER_LIMIT,
    H,
)
from .impulse_problem import OPENING, TOUCHING, add_turn_row, free_gain, rigid_velocity, start_velocity
from .impulse_review import DONE, equation_impulses, impulse_work, review, velocity_change
from .stages import DAMPING_WORK, DRIVE_WORK, FRICTION_WORK, NUMBER_OF_WORKS, TORQUE_WORK, hand_over


@kernel
def _blocks(system, step, n):
    """The n blocks of the configuration and their inertias."""
    return system.joint_table, step.inertias


@kernel
def predict_midpoint(system, step):
    """Hand over the midpoint's state, from the start and the last step's acceleration or this one's mean velocity."""
    sizes = system.sizes
    nq, nv, nc = sizes.nq, sizes.nv, sizes.nc
    counts = step.counts
    numbers = step.numbers
    half = numbers[AHEAD]
    v, trend, mean = step.start_v, step.trend, step.mean
    displacement = step.displacement
    blocks, inertias = _blocks(system, step, sizes.nblocks)
    location, rates = flat(step.start_location), flat(step.start_rates)
    state, start_q = system.stage_state, step.start_q
    carried, carried_trend = step.carried_v, step.carried_trend
    for k in range(nv):
        displacement[k] = half * v[k]
    displace(blocks, start_q, start_q, displacement, state)
    carry(blocks, inertias, start_q, state, v, carried)
    moved = half != 0.5 * numbers[H] and counts[TREND_BEFORE] == ACCELERATION
    if counts[PASSES] == 0 or counts[HAS_TREND] == ACCELERATION or moved:
        # else it is what the first pass had
        carry(blocks, inertias, start_q, state, trend, carried_trend)
    for k in range(nv):
        state[nq + k] = carried[k]
        if counts[HAS_TREND] == ACCELERATION:
            state[nq + k] += half * carried_trend[k]
        elif counts[HAS_TREND] == MEAN_VELOCITY:
            state[nq + k] = mean[k]
    for k in range(4 * nc):
        state[nq + nv + k] = location[k] + half * rates[k]
    hand_over(system, state)


@kernel
def leave_turning_axes(system, step):
    """Take what comes of turning axes alone out of the midpoint's bias forces and biases: there velocities change from
    v_0 to v_1 in axes that stand still."""
    sizes = system.sizes
    nv, nc, rate = sizes.nv, sizes.nc, step.turning_rate
    blocks, inertias = _blocks(system, step, sizes.nblocks)
    if not turning_rate(blocks, inertias, system.v, rate):
        return
    mass, nle = system.mass, system.nle
    rows, bias = system.rows, system.bias
    for k in range(nv):
        if rate[k] != 0.0:
            for i in range(nv):
                nle[i] -= mass[max(i, k), min(i, k)] * rate[k]
    for c in range(nc):
        for row in range(3):
            bias[c, row] -= inner(rows[c, row], rate, nv)


@kernel
def _contact_mode(system, step, u, c, nc, h):
    """Mode of contact c after the step, from the solution of its unit u; notes when it touched."""
    counts = step.counts
    kept = step.numbers[KEPT]
    ints = step.unit_int[u]
    values = step.unit_real[u]
    velocities, cone_mode = step.cone_velocities, step.cone_modes[u]
    integers_c = system.contact_int[c]
    numbers_c = system.contact_real[c]
    mu = numbers_c[MU]
    rest = FRICTIONLESS if mu == 0.0 else STICK
    opening = OPENING * numbers_c[LENGTH]
    first, second = velocities[3 * u], velocities[3 * u + 1]
    if ints[MIDPOINT] != 0:
        first -= values[START_T1]
        second -= values[START_T2]
    integers_c[FROZEN] = 0
    if first != 0.0:
        integers_c[SLIP_SIGN] = 1 if first > 0.0 else -1
    if ints[UNIT_KIND] == ON_LOADED:
        if cone_mode == cone.OPEN:
            # no load: nothing holds the contact
            return SLIPPING if math.hypot(first, second) * h > opening else STICK
        return STICK if cone_mode == cone.STICK else SLIPPING
    slides = mu != 0.0 and math.hypot(first, second) * h > opening
    if cone_mode == cone.OPEN:
        # without force, though perhaps not apart: among redundant contacts others may carry the load
        gap = step.start_gap[c] if ints[TOUCHES] != 0 else 0.0
        apart = (velocities[3 * u + 2] + kept * values[SHIFT]) * h > opening
        if apart or gap > TOUCHING * numbers_c[LENGTH] or (slides and mu == math.inf):
            return FREE
        return SLIPPING if slides else rest
    if ints[TOUCHES] != 0:
        step.touch_time[c] = values[IMPULSE_TIME]
        counts[TOUCHED] = 1
        if kept * values[SHIFT] > 0.0:
            return FREE
    # among redundant contacts one may be at its limit of friction without sliding
    return SLIPPING if slides and cone_mode != cone.STICK else rest


@kernel
def _distribute(system, step, nv, nc, h):
    """Impulses of contacts and joints, new modes, ends at which joints are held; in WORK the change of velocity by all
    impulses, whitened, and in DISPLACEMENT what they displace by acting before or after the middle of the step."""
    counts = step.counts
    n, nequations = counts[UNITS], counts[NEQ]
    ng, kept = system.guard_count[0], step.numbers[KEPT]
    contact_int = system.contact_int
    guard_int = system.guard_int
    contact_real = system.contact_real
    unit_int = step.unit_int
    unit_real = step.unit_real
    joint_int = step.joint_int
    forces, whitened = step.cone_forces, step.whitened
    index, equation_impulse = step.equation_index, step.equation_impulse
    impulse, joint_impulse = step.contact_impulse, step.joint_impulse
    touch_time = step.touch_time
    load = step.load
    basis, torques = system.basis, step.torques
    orientation = step.orientation
    whole, shifted = system.work, step.displacement
    velocity_change(step, nv, whole)
    for k in range(nv):
        shifted[k] = joint_impulse[k] = 0.0
    for g in range(ng):
        contact_int[nc + g, MODE], guard_int[g, GUARD_END] = FREE, 0
    for c in range(nc):
        touch_time[c] = -1.0
        for row in range(3):
            impulse[c, row] = torques[c, row] = 0.0
        if contact_int[c, UNILATERAL] != 0:
            contact_int[c, MODE] = FREE
        else:
            contact_int[c, MODE] = STICK if contact_real[c, MU] == math.inf else FRICTIONLESS
    counts[TOUCHED] = 0
    total = moment = 0.0
    for j in range(counts[NJ]):
        if joint_int[j, JOINT_KIND] == DRY_FRICTION:
            joint_impulse[joint_int[j, JOINT_V]] += h * step.joint_real[j, 1]
    for e in range(nequations):
        impulse[index[e, 0], index[e, 1]] += equation_impulse[e]
    for u in range(n):
        kind, i, mask = unit_int[u, UNIT_KIND], unit_int[u, UNIT_INDEX], unit_int[u, ROW_MASK]
        early = 0.5 * h - unit_real[u, IMPULSE_TIME]
        if kind < ON_JOINT:
            first, second = forces[3 * u], forces[3 * u + 1]
            if contact_int[i, ANISOTROPIC] != 0:
                first, second = stretch_pair(contact_real[i], first, second)
            if mask & 1 != 0:
                impulse[i, 0] += first
            if mask & 2 != 0:
                impulse[i, 1] += second
            if mask & 4 != 0:
                impulse[i, 2] += forces[3 * u + 2]
        for row in range(3):
            if mask >> row & 1 == 0:
                continue
            r = 3 * u + row
            size = 0.0
            for k in range(nv):
                shifted[k] += early * forces[r] * whitened[r, k]
                size += (forces[r] * whitened[r, k]) ** 2
            total += math.sqrt(size)
            moment += math.sqrt(size) * unit_real[u, IMPULSE_TIME]
            if kind == ON_TURN:
                axis = unit_int[u, AXIS] + row
                add_turn_row(system, i, axis, nv, nc, forces[r], joint_impulse)
                for j in range(3):
                    torques[i, j] += orientation[i] * forces[r] * basis[i, axis, j] / h
            elif kind == ON_JOINT:
                sign = -1.0 if joint_int[i, JOINT_KIND] == UPPER_LIMIT else 1.0
                joint_impulse[joint_int[i, JOINT_V]] += sign * forces[r]
                if joint_int[i, JOINT_KIND] != DRY_FRICTION and forces[r] > 0.0:
                    if unit_int[u, TOUCHES] != 0:
                        counts[TOUCHED] = 1
                    if kept * unit_real[u, SHIFT] <= 0.0:
                        # it does not leave its stop again within the step
                        g = joint_int[i, JOINT_GUARD]
                        contact_int[nc + g, MODE], guard_int[g, GUARD_END] = FRICTIONLESS, -int(sign)
        if kind < ON_JOINT:
            contact_int[i, MODE] = _contact_mode(system, step, u, i, nc, h)
    step.numbers[IMPACT] = moment / total if total > 0.0 else 0.5 * h
    # impulses that nearly cancel (a wedged body) at different times would throw it far: one alone moves it no further
    limit = 0.25 * h * h * inner(whole, whole, nv)
    moved = inner(shifted, shifted, nv)
    if moved > limit:
        for k in range(nv):
            shifted[k] *= math.sqrt(limit / moved)
    for c in range(nc):
        normal, second = impulse[c, 2], impulse[c, 1]
        if contact_int[c, UNILATERAL] == 0 or contact_real[c, SPINNING] > 0.0 or contact_real[c, ROLLING] > 0.0:
            load[c] = abs(normal) / h
            if contact_int[c, PATTERN] == ON_CURVE:
                length = math.hypot(normal, second)
                load[c] = length / h
                if length > 0.0:
                    contact_real[c, NORMAL_1], contact_real[c, NORMAL_2] = normal / length, second / length
            elif contact_int[c, UNILATERAL] == 0 and normal != 0.0:
                contact_int[c, NORMAL_SIGN] = 1 if normal > 0.0 else -1


@kernel
def _viscous_impulses(system, step, nv, nc, h, v1):
    """Add viscous impulses to those of the contacts; returns their work on v_c."""
    contact_int = system.contact_int
    contact_real = system.contact_real
    rows, start_mode = system.rows, step.start_mode
    v0, impulse = step.carried_v, step.contact_impulse
    work = 0.0
    for c in range(nc):
        constant = h * contact_real[c, VISCOUS]
        if constant == 0.0 or start_mode[c] == FREE:
            continue
        for row in range(contact_int[c, TANGENTS]):
            mean = rigid_velocity(system, step, c, row, nv, nc)
            for k in range(nv):
                mean += 0.5 * rows[c, row, k] * (v1[k] - v0[k])
            impulse[c, row] -= constant * mean
            work -= constant * mean * mean
    return work


@kernel
def _work_on_misses(system, step, nv, nc):
    """Work in J of impulses of closed contacts on constrained velocities that are not zero at the step's start, as in
    the first step from a state that does not keep to its constraints."""
    counts, basis = step.counts, system.basis
    contact_int = system.contact_int
    start_slip, start_normal = step.start_slip, step.start_normal
    start_mode, impulse = step.start_mode, step.contact_impulse
    index = step.equation_index
    of_equations = step.equation_impulse
    twice = 0.0
    for c in range(nc):
        if contact_int[c, UNILATERAL] != 0 and start_mode[c] != FREE:
            twice += impulse[c, 2] * start_normal[c, 0]
    for e in range(counts[NEQ]):
        c, row = index[e, 0], index[e, 1]
        if row == 2 or (row == 1 and contact_int[c, PATTERN] == ON_CURVE):
            twice += of_equations[e] * start_normal[c, 2 - row]
        else:
            twice += of_equations[e] * dot(basis[c, row], start_slip[c])
    return 0.5 * twice


@kernel
def _add_works(system, step, nv, nc, h, v1, viscous, works):
    """Works over the step, with that of viscous friction; what drives do is what impulses do on the joints less what
    they do on v_c."""
    rows, impulse = system.rows, step.contact_impulse
    change = step.change
    v0, tau, damping = step.carried_v, system.tau, system.damping
    on_contacts, on_joints, _, _ = impulse_work(step, nv, h, system.work)
    works[FRICTION_WORK] += on_contacts + viscous + _work_on_misses(system, step, nv, nc)
    works[DAMPING_WORK] += on_joints
    side_int = system.side_int
    for c in range(nc):
        is_driven = False
        for side in range(2 * c, 2 * c + 2):
            is_driven = is_driven or side_int[side, MOTION_KIND] != 0 or side_int[side, TIME_DEPENDENT] != 0
        for row in range(3 if is_driven else 0):
            line = rows[c, row]
            # what v_c is on average where nothing but the drive moves it, against what the joints make of it
            driven = start_velocity(system, step, c, row, nv, nc)
            driven += 0.5 * (free_gain(system, step, c, row, nv, nc, h) - inner(line, change, nv))
            works[DRIVE_WORK] += impulse[c, row] * (inner(line, v0, nv) - driven)
    counts = step.counts
    unit_int = step.unit_int
    unit_real = step.unit_real
    forces = step.cone_forces
    for u in range(counts[UNITS]):
        if unit_int[u, UNIT_KIND] == ON_TURN:
            for row in range(2):
                works[DRIVE_WORK] += forces[3 * u + row] * unit_real[u, DRIVEN_T1 + row]
    for k in range(nv):
        mean = 0.5 * (v0[k] + v1[k])
        works[TORQUE_WORK] += h * tau[k] * mean
        works[DAMPING_WORK] -= h * damping[k] * mean * mean
    joint_int = step.joint_int
    for j in range(counts[NJ]):
        if joint_int[j, JOINT_KIND] == DRY_FRICTION:
            # the constant part of a range that is not symmetric, beside the unit's
            k = joint_int[j, JOINT_V]
            works[DAMPING_WORK] += h * step.joint_real[j, 1] * 0.5 * (v0[k] + v1[k])


@kernel
def advance(system, step):
    """Review the cone problem's solution and carry out the step: state, modes, impulses; hands over its end.

    Returns DONE, AGAIN (solve the changed problem first) or a status of `layout`.
    """
    sizes = system.sizes
    nq, nv, nc = sizes.nq, sizes.nv, sizes.nc
    h, ahead = step.numbers[H], step.numbers[AHEAD]
    equation_impulses(system, step)
    verdict = review(step, nv, h, system.work)
    if verdict != DONE:
        return verdict
    _distribute(system, step, nv, nc, h)
    factor, change = system.factor, step.change
    gained, displacement, mean = system.work, step.displacement, step.mean
    parents = system.parents
    unwhiten(factor, parents, nv, gained, gained)
    unwhiten(factor, parents, nv, displacement, displacement)
    start_q, start_v, state = step.start_q, step.carried_v, system.stage_state
    v1 = state[nq : nq + nv]
    assumed, mass = system.v, system.mass
    total = miss = speed = 0.0
    for k in range(nv):
        v1[k] = start_v[k] + change[k] + gained[k]
        displacement[k] += 0.5 * h * (start_v[k] + v1[k])
        mean[k] = displacement[k] / h
        miss += mass[k, k] * (mean[k] - assumed[k]) ** 2
        speed += mass[k, k] * mean[k] ** 2
        total += v1[k]
    numbers = step.numbers
    # a body that comes to rest is not fast, but neither is it far off
    speed += numbers[FREE_CHANGE] ** 2
    numbers[MISS] = math.sqrt(miss / speed) if miss > 0.0 else 0.0
    if total - total != 0.0:
        return NOT_FINITE
    viscous = _viscous_impulses(system, step, nv, nc, h, v1)
    if sizes.nwork > 0:
        start, works = system.state[nq + nv + 4 * nc :], state[nq + nv + 4 * nc :]
        for i in range(NUMBER_OF_WORKS):
            works[i] = start[i]
        _add_works(system, step, nv, nc, h, v1, viscous, works)
    (blocks, inertias), middle = _blocks(system, step, sizes.nblocks), system.q
    displace(blocks, start_q, middle, displacement, state)
    carry(blocks, inertias, middle, state, v1, v1)
    carry(blocks, inertias, middle, state, start_v, step.seen_v)
    ng = system.guard_count[0]
    guard_int, guard_real = system.guard_int, system.guard_real
    for g in range(ng):
        # to the last bit; what that does to contacts is settled with this end as a constraint
        end = guard_int[g, GUARD_END]
        if end != 0:
            state[guard_int[g, GUARD_Q]] = guard_real[g, LOW_END if end < 0 else HIGH_END]
    location, rates = flat(system.location), flat(system.rates)
    for k in range(4 * nc):
        state[nq + nv + k] = location[k] + (h - ahead) * rates[k]
    _report_forces(system, step, nc, h)
    hand_over(system, state)
    return DONE


@kernel
def _report_forces(system, step, nc, h):
    """Mean forces over the step on the contours named second, world axes (of the step's midpoint)."""
    basis, impulse = system.basis, step.contact_impulse
    forces, orientation = step.forces, step.orientation
    for c in range(nc):
        for i in range(3):
            value = impulse[c, 0] * basis[c, 0, i] + impulse[c, 1] * basis[c, 1, i] + impulse[c, 2] * basis[c, 2, i]
            forces[c, i] = orientation[c] * value / h


@kernel
def commit(system, step, stepped):
    """Make STAGE_STATE the next step's start, with the kinematics of its evaluation, moved on by the last corrections.

    stepped: 0 for the first state of a run, which has no corrections and no step behind it.
    Returns whether anything discrete (modes, signs, charts) is not what it was before.
    """
    sizes = system.sizes
    nq, nv, nc = sizes.nq, sizes.nv, sizes.nc
    counts, h = step.counts, step.numbers[H]
    stage, state = system.stage_state, system.state
    start_q, start_v, trend = step.start_q, step.start_v, step.trend
    seen_v = step.seen_v
    correction_q, correction_v = system.correction_q, system.correction_v
    for i in range(sizes.ny):
        state[i] = stage[i]
    for i in range(nq):
        start_q[i] = stage[i]
    blocks, inertias = _blocks(system, step, sizes.nblocks)
    find_inertias(blocks, system.mass, inertias)
    counts[HAS_TREND] = ACCELERATION if stepped != 0 and counts[TOUCHED] == 0 else 0
    for k in range(nv):
        if stepped != 0:
            trend[k] = (stage[nq + k] - seen_v[k]) / h
        start_v[k] = stage[nq + k]
    basis, rows = system.basis, system.rows
    slip, gaps = system.slip, system.gaps
    location, rates = system.location, system.rates
    start_location, start_rates = step.start_location, step.start_rates
    start_slip, start_normal = step.start_slip, step.start_normal
    start_gap, start_mode = step.start_gap, step.start_mode
    start_domain, behind = step.start_domain, step.behind
    contact_int = system.contact_int
    contact_real = system.contact_real
    side_int = system.side_int
    known = step.known
    changed = stepped == 0
    ng = system.guard_count[0]
    start_end, guard_int = step.start_end, system.guard_int
    for g in range(ng):
        start_end[g] = guard_int[g, GUARD_END]
    for c in range(nc):
        start_mode[c] = contact_int[c, MODE]
        start_gap[c] = gaps[c, 0]
        for i in range(4):
            start_location[c, i], start_rates[c, i] = location[c, i], rates[c, i]
        for i in range(3):
            start_slip[c, i] = slip[c, i]
        if stepped != 0:
            start_gap[c] += inner(rows[c, 2], correction_q, nv)
            for row in range(3):
                gained = inner(rows[c, row], correction_v, nv)
                for i in range(3):
                    start_slip[c, i] += gained * basis[c, row, i]
        # what got to the far side beside the contours touches them after it has been on the near side only
        domain, outside = contact_real[c, DOMAIN], behind[c] != 0
        outside = outside or domain < 0.0 or (stepped != 0 and start_domain[c] < 0.0)
        behind[c] = 1 if start_mode[c] == FREE and start_gap[c] < 0.0 and outside else 0
        start_domain[c] = domain
        start_normal[c, 0], start_normal[c, 1] = dot(basis[c, 2], start_slip[c]), dot(basis[c, 1], start_slip[c])
        for i in range(CONTACT_INTS):
            changed = changed or known[c, i] != contact_int[c, i]
            known[c, i] = contact_int[c, i]
        for i in range(2):
            chart = side_int[2 * c + i, CHART]
            changed = changed or known[c, CONTACT_INTS + i] != chart
            known[c, CONTACT_INTS + i] = chart
    return changed
