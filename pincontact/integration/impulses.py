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
from ..friction import cone
from ..friction.ellipse import stretch_pair
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import kernel
from ..layout import (
    ANISOTROPIC,
    BASIS,
    BIAS,
    CHART,
    CONTACT_INT,
    CONTACT_INTS,
    CONTACT_REAL,
    CONTACT_REALS,
    CORRECTION_Q,
    CORRECTION_V,
    DAMPING,
    DOMAIN,
    FACTOR,
    FREE,
    FRICTIONLESS,
    FROZEN,
    GAPS,
    GUARD_COUNT,
    GUARD_END,
    GUARD_INT,
    GUARD_INTS,
    GUARD_Q,
    GUARD_REAL,
    GUARD_REALS,
    HIGH_END,
    JOINT_TABLE,
    LENGTH,
    LOCATION,
    LOW_END,
    MASS,
    MODE,
    MOTION_KIND,
    MU,
    NBLOCKS,
    NC,
    NLE,
    NORMAL_1,
    NORMAL_2,
    NORMAL_SIGN,
    NOT_FINITE,
    NQ,
    NV,
    NWORK,
    NY,
    PARENTS,
    PATTERN,
    RATES,
    ROLLING,
    ROWS,
    SIDE_INT,
    SIDE_INTS,
    SIZES,
    SLIP,
    SLIP_SIGN,
    SLIPPING,
    SPINNING,
    STAGE_STATE,
    STATE,
    STICK,
    TANGENTS,
    TAU,
    TIME_DEPENDENT,
    UNILATERAL,
    VISCOUS,
    WORK,
    Q,
    V,
)
from ..memory import cube, integer_matrix, integers, matrix, reals
from .carrying import INERTIA_SIZE, carry, find_inertias, turning_rate
from .impulse_layout import (
    ACCELERATION,
    AHEAD,
    AXIS,
    BEHIND,
    CARRIED_TREND,
    CARRIED_V,
    CHANGE,
    CONE_FORCES,
    CONE_MODES,
    CONE_VELOCITIES,
    CONTACT_IMPULSE,
    COUNTS,
    DISPLACEMENT,
    DRIVEN_T1,
    DRY_FRICTION,
    EQUATION_IMPULSE,
    EQUATION_INDEX,
    FORCES,
    FREE_CHANGE,
    HAS_TREND,
    IMPACT,
    IMPULSE_TIME,
    INERTIAS,
    JOINT_GUARD,
    JOINT_IMPULSE,
    JOINT_INT,
    JOINT_INTS,
    JOINT_KIND,
    JOINT_REAL,
    JOINT_V,
    KEPT,
    KNOWN,
    LOAD,
    MAX_EQUATIONS,
    MAX_UNITS,
    MEAN,
    MEAN_VELOCITY,
    MIDPOINT,
    MISS,
    NCOUNTS,
    NEQ,
    NJ,
    NNUMBERS,
    NUMBERS,
    ON_JOINT,
    ON_LOADED,
    ON_TURN,
    ORIENTATION,
    PASSES,
    ROW_MASK,
    SEEN_V,
    SHIFT,
    START_DOMAIN,
    START_END,
    START_GAP,
    START_LOCATION,
    START_MODE,
    START_NORMAL,
    START_Q,
    START_RATES,
    START_SLIP,
    START_T1,
    START_T2,
    START_V,
    TORQUES,
    TOUCH_TIME,
    TOUCHED,
    TOUCHES,
    TREND,
    TREND_BEFORE,
    TURNING_RATE,
    UNIT_INDEX,
    UNIT_INT,
    UNIT_INTS,
    UNIT_KIND,
    UNIT_REAL,
    UNIT_REALS,
    UNITS,
    UPPER_LIMIT,
    WHITENED,
    H,
)
from .impulse_problem import OPENING, TOUCHING, add_turn_row, free_gain, rigid_velocity, start_velocity
from .impulse_review import DONE, equation_impulses, impulse_work, review, velocity_change
from .manifold import displace
from .stages import DAMPING_WORK, DRIVE_WORK, FRICTION_WORK, NUMBER_OF_WORKS, TORQUE_WORK, hand_over


@kernel
def _blocks(table, step, n):
    """The n blocks of the configuration and their inertias."""
    return integer_matrix(table[JOINT_TABLE], n, 4), matrix(step[INERTIAS], n, INERTIA_SIZE)


@kernel
def predict_midpoint(table, step):
    """Hand over the midpoint's state, from the start and the last step's acceleration or this one's mean velocity."""
    sizes = integers(table[SIZES], 8)
    nq, nv, nc = sizes[NQ], sizes[NV], sizes[NC]
    counts = integers(step[COUNTS], NCOUNTS)
    numbers = reals(step[NUMBERS], NNUMBERS)
    half = numbers[AHEAD]
    v, trend, mean = reals(step[START_V], nv), reals(step[TREND], nv), reals(step[MEAN], nv)
    displacement = reals(step[DISPLACEMENT], nv)
    blocks, inertias = _blocks(table, step, sizes[NBLOCKS])
    location, rates = reals(step[START_LOCATION], 4 * nc), reals(step[START_RATES], 4 * nc)
    state, start_q = reals(table[STAGE_STATE], sizes[NY]), reals(step[START_Q], nq)
    carried, carried_trend = reals(step[CARRIED_V], nv), reals(step[CARRIED_TREND], nv)
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
    hand_over(table, state)


@kernel
def leave_turning_axes(table, step):
    """Take what comes of turning axes alone out of the midpoint's bias forces and biases: there velocities change from
    v_0 to v_1 in axes that stand still."""
    sizes = integers(table[SIZES], 8)
    nv, nc, rate = sizes[NV], sizes[NC], reals(step[TURNING_RATE], sizes[NV])
    blocks, inertias = _blocks(table, step, sizes[NBLOCKS])
    if not turning_rate(blocks, inertias, reals(table[V], nv), rate):
        return
    mass, nle = matrix(table[MASS], nv, nv), reals(table[NLE], nv)
    rows, bias = cube(table[ROWS], nc, 3, nv), matrix(table[BIAS], nc, 3)
    for k in range(nv):
        if rate[k] != 0.0:
            for i in range(nv):
                nle[i] -= mass[max(i, k), min(i, k)] * rate[k]
    for c in range(nc):
        for row in range(3):
            bias[c, row] -= inner(rows[c, row], rate, nv)


@kernel
def _contact_mode(table, step, u, c, nc, h):
    """Mode of contact c after the step, from the solution of its unit u; notes when it touched."""
    counts = integers(step[COUNTS], NCOUNTS)
    n, kept = counts[UNITS], reals(step[NUMBERS], NNUMBERS)[KEPT]
    ints = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)[u]
    values = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)[u]
    velocities, cone_mode = reals(step[CONE_VELOCITIES], 3 * n), integers(step[CONE_MODES], n)[u]
    integers_c = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)[c]
    numbers_c = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)[c]
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
        gap = reals(step[START_GAP], nc)[c] if ints[TOUCHES] != 0 else 0.0
        apart = (velocities[3 * u + 2] + kept * values[SHIFT]) * h > opening
        if apart or gap > TOUCHING * numbers_c[LENGTH] or (slides and mu == math.inf):
            return FREE
        return SLIPPING if slides else rest
    if ints[TOUCHES] != 0:
        reals(step[TOUCH_TIME], nc)[c] = values[IMPULSE_TIME]
        counts[TOUCHED] = 1
        if kept * values[SHIFT] > 0.0:
            return FREE
    # among redundant contacts one may be at its limit of friction without sliding
    return SLIPPING if slides and cone_mode != cone.STICK else rest


@kernel
def _distribute(table, step, nv, nc, h):
    """Impulses of contacts and joints, new modes, ends at which joints are held; in WORK the change of velocity by all
    impulses, whitened, and in DISPLACEMENT what they displace by acting before or after the middle of the step."""
    counts = integers(step[COUNTS], NCOUNTS)
    n, units, nequations, most = counts[UNITS], counts[MAX_UNITS], counts[NEQ], counts[MAX_EQUATIONS]
    ng, kept = integers(table[GUARD_COUNT], 1)[0], reals(step[NUMBERS], NNUMBERS)[KEPT]
    contact_int = integer_matrix(table[CONTACT_INT], nc + ng, CONTACT_INTS)
    guard_int = integer_matrix(table[GUARD_INT], ng, GUARD_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    unit_int = integer_matrix(step[UNIT_INT], units, UNIT_INTS)
    unit_real = matrix(step[UNIT_REAL], units, UNIT_REALS)
    joint_int = integer_matrix(step[JOINT_INT], counts[NJ], JOINT_INTS)
    forces, whitened = reals(step[CONE_FORCES], 3 * n), matrix(step[WHITENED], 3 * units, nv)
    index, equation_impulse = integer_matrix(step[EQUATION_INDEX], most, 2), reals(step[EQUATION_IMPULSE], most)
    impulse, joint_impulse = matrix(step[CONTACT_IMPULSE], nc, 3), reals(step[JOINT_IMPULSE], nv)
    touch_time = reals(step[TOUCH_TIME], nc)
    load = reals(step[LOAD], nc)
    basis, torques = cube(table[BASIS], nc, 3, 3), matrix(step[TORQUES], nc, 3)
    orientation = reals(step[ORIENTATION], nc)
    whole, shifted = reals(table[WORK], nv), reals(step[DISPLACEMENT], nv)
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
            joint_impulse[joint_int[j, JOINT_V]] += h * matrix(step[JOINT_REAL], counts[NJ], 2)[j, 1]
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
                add_turn_row(table, i, axis, nv, nc, forces[r], joint_impulse)
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
            contact_int[i, MODE] = _contact_mode(table, step, u, i, nc, h)
    reals(step[NUMBERS], NNUMBERS)[IMPACT] = moment / total if total > 0.0 else 0.5 * h
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
def _viscous_impulses(table, step, nv, nc, h, v1):
    """Add viscous impulses to those of the contacts; returns their work on v_c."""
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    rows, start_mode = cube(table[ROWS], nc, 3, nv), integers(step[START_MODE], nc)
    v0, impulse = reals(step[CARRIED_V], nv), matrix(step[CONTACT_IMPULSE], nc, 3)
    work = 0.0
    for c in range(nc):
        constant = h * contact_real[c, VISCOUS]
        if constant == 0.0 or start_mode[c] == FREE:
            continue
        for row in range(contact_int[c, TANGENTS]):
            mean = rigid_velocity(table, step, c, row, nv, nc)
            for k in range(nv):
                mean += 0.5 * rows[c, row, k] * (v1[k] - v0[k])
            impulse[c, row] -= constant * mean
            work -= constant * mean * mean
    return work


@kernel
def _work_on_misses(table, step, nv, nc):
    """Work in J of impulses of closed contacts on constrained velocities that are not zero at the step's start, as in
    the first step from a state that does not keep to its constraints."""
    counts, basis = integers(step[COUNTS], NCOUNTS), cube(table[BASIS], nc, 3, 3)
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    start_slip, start_normal = matrix(step[START_SLIP], nc, 3), matrix(step[START_NORMAL], nc, 2)
    start_mode, impulse = integers(step[START_MODE], nc), matrix(step[CONTACT_IMPULSE], nc, 3)
    index = integer_matrix(step[EQUATION_INDEX], counts[MAX_EQUATIONS], 2)
    of_equations = reals(step[EQUATION_IMPULSE], counts[MAX_EQUATIONS])
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
def _add_works(table, step, nv, nc, h, v1, viscous, works):
    """Works over the step, with that of viscous friction; what drives do is what impulses do on the joints less what
    they do on v_c."""
    rows, impulse = cube(table[ROWS], nc, 3, nv), matrix(step[CONTACT_IMPULSE], nc, 3)
    change = reals(step[CHANGE], nv)
    v0, tau, damping = reals(step[CARRIED_V], nv), reals(table[TAU], nv), reals(table[DAMPING], nv)
    on_contacts, on_joints, _, _ = impulse_work(step, nv, h, reals(table[WORK], nv))
    works[FRICTION_WORK] += on_contacts + viscous + _work_on_misses(table, step, nv, nc)
    works[DAMPING_WORK] += on_joints
    side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
    for c in range(nc):
        is_driven = False
        for side in range(2 * c, 2 * c + 2):
            is_driven = is_driven or side_int[side, MOTION_KIND] != 0 or side_int[side, TIME_DEPENDENT] != 0
        for row in range(3 if is_driven else 0):
            line = rows[c, row]
            # what v_c is on average where nothing but the drive moves it, against what the joints make of it
            driven = start_velocity(table, step, c, row, nv, nc)
            driven += 0.5 * (free_gain(table, step, c, row, nv, nc, h) - inner(line, change, nv))
            works[DRIVE_WORK] += impulse[c, row] * (inner(line, v0, nv) - driven)
    counts = integers(step[COUNTS], NCOUNTS)
    unit_int = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)
    unit_real = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)
    forces = reals(step[CONE_FORCES], 3 * counts[UNITS])
    for u in range(counts[UNITS]):
        if unit_int[u, UNIT_KIND] == ON_TURN:
            for row in range(2):
                works[DRIVE_WORK] += forces[3 * u + row] * unit_real[u, DRIVEN_T1 + row]
    for k in range(nv):
        mean = 0.5 * (v0[k] + v1[k])
        works[TORQUE_WORK] += h * tau[k] * mean
        works[DAMPING_WORK] -= h * damping[k] * mean * mean
    joint_int = integer_matrix(step[JOINT_INT], counts[NJ], JOINT_INTS)
    for j in range(counts[NJ]):
        if joint_int[j, JOINT_KIND] == DRY_FRICTION:
            # the constant part of a range that is not symmetric, beside the unit's
            k = joint_int[j, JOINT_V]
            works[DAMPING_WORK] += h * matrix(step[JOINT_REAL], counts[NJ], 2)[j, 1] * 0.5 * (v0[k] + v1[k])


@kernel
def advance(table, step):
    """Review the cone problem's solution and carry out the step: state, modes, impulses; hands over its end.

    Returns DONE, AGAIN (solve the changed problem first) or a status of `layout`.
    """
    sizes = integers(table[SIZES], 8)
    nq, nv, nc = sizes[NQ], sizes[NV], sizes[NC]
    h, ahead = reals(step[NUMBERS], NNUMBERS)[H], reals(step[NUMBERS], NNUMBERS)[AHEAD]
    equation_impulses(table, step)
    verdict = review(step, nv, h, reals(table[WORK], nv))
    if verdict != DONE:
        return verdict
    _distribute(table, step, nv, nc, h)
    factor, change = matrix(table[FACTOR], nv, nv), reals(step[CHANGE], nv)
    gained, displacement, mean = reals(table[WORK], nv), reals(step[DISPLACEMENT], nv), reals(step[MEAN], nv)
    parents = integers(table[PARENTS], nv)
    unwhiten(factor, parents, nv, gained, gained)
    unwhiten(factor, parents, nv, displacement, displacement)
    start_q, start_v, state = reals(step[START_Q], nq), reals(step[CARRIED_V], nv), reals(table[STAGE_STATE], sizes[NY])
    v1 = state[nq : nq + nv]
    assumed, mass = reals(table[V], nv), matrix(table[MASS], nv, nv)
    total = miss = speed = 0.0
    for k in range(nv):
        v1[k] = start_v[k] + change[k] + gained[k]
        displacement[k] += 0.5 * h * (start_v[k] + v1[k])
        mean[k] = displacement[k] / h
        miss += mass[k, k] * (mean[k] - assumed[k]) ** 2
        speed += mass[k, k] * mean[k] ** 2
        total += v1[k]
    numbers = reals(step[NUMBERS], NNUMBERS)
    # a body that comes to rest is not fast, but neither is it far off
    speed += numbers[FREE_CHANGE] ** 2
    numbers[MISS] = math.sqrt(miss / speed) if miss > 0.0 else 0.0
    if total - total != 0.0:
        return NOT_FINITE
    viscous = _viscous_impulses(table, step, nv, nc, h, v1)
    if sizes[NWORK] > 0:
        start, works = reals(table[STATE], sizes[NY])[nq + nv + 4 * nc :], state[nq + nv + 4 * nc :]
        for i in range(NUMBER_OF_WORKS):
            works[i] = start[i]
        _add_works(table, step, nv, nc, h, v1, viscous, works)
    (blocks, inertias), middle = _blocks(table, step, sizes[NBLOCKS]), reals(table[Q], nq)
    displace(blocks, start_q, middle, displacement, state)
    carry(blocks, inertias, middle, state, v1, v1)
    carry(blocks, inertias, middle, state, start_v, reals(step[SEEN_V], nv))
    ng = integers(table[GUARD_COUNT], 1)[0]
    guard_int, guard_real = integer_matrix(table[GUARD_INT], ng, GUARD_INTS), matrix(table[GUARD_REAL], ng, GUARD_REALS)
    for g in range(ng):
        # to the last bit; what that does to contacts is settled with this end as a constraint
        end = guard_int[g, GUARD_END]
        if end != 0:
            state[guard_int[g, GUARD_Q]] = guard_real[g, LOW_END if end < 0 else HIGH_END]
    location, rates = reals(table[LOCATION], 4 * nc), reals(table[RATES], 4 * nc)
    for k in range(4 * nc):
        state[nq + nv + k] = location[k] + (h - ahead) * rates[k]
    _report_forces(table, step, nc, h)
    hand_over(table, state)
    return DONE


@kernel
def _report_forces(table, step, nc, h):
    """Mean forces over the step on the contours named second, world axes (of the step's midpoint)."""
    basis, impulse = cube(table[BASIS], nc, 3, 3), matrix(step[CONTACT_IMPULSE], nc, 3)
    forces, orientation = matrix(step[FORCES], nc, 3), reals(step[ORIENTATION], nc)
    for c in range(nc):
        for i in range(3):
            value = impulse[c, 0] * basis[c, 0, i] + impulse[c, 1] * basis[c, 1, i] + impulse[c, 2] * basis[c, 2, i]
            forces[c, i] = orientation[c] * value / h


@kernel
def commit(table, step, stepped):
    """Make STAGE_STATE the next step's start, with the kinematics of its evaluation, moved on by the last corrections.

    stepped: 0 for the first state of a run, which has no corrections and no step behind it.
    Returns whether anything discrete (modes, signs, charts) is not what it was before.
    """
    sizes = integers(table[SIZES], 8)
    nq, nv, nc = sizes[NQ], sizes[NV], sizes[NC]
    counts, h = integers(step[COUNTS], NCOUNTS), reals(step[NUMBERS], NNUMBERS)[H]
    stage, state = reals(table[STAGE_STATE], sizes[NY]), reals(table[STATE], sizes[NY])
    start_q, start_v, trend = reals(step[START_Q], nq), reals(step[START_V], nv), reals(step[TREND], nv)
    seen_v = reals(step[SEEN_V], nv)
    correction_q, correction_v = reals(table[CORRECTION_Q], nv), reals(table[CORRECTION_V], nv)
    for i in range(sizes[NY]):
        state[i] = stage[i]
    for i in range(nq):
        start_q[i] = stage[i]
    blocks, inertias = _blocks(table, step, sizes[NBLOCKS])
    find_inertias(blocks, matrix(table[MASS], nv, nv), inertias)
    counts[HAS_TREND] = ACCELERATION if stepped != 0 and counts[TOUCHED] == 0 else 0
    for k in range(nv):
        if stepped != 0:
            trend[k] = (stage[nq + k] - seen_v[k]) / h
        start_v[k] = stage[nq + k]
    basis, rows = cube(table[BASIS], nc, 3, 3), cube(table[ROWS], nc, 3, nv)
    slip, gaps = matrix(table[SLIP], nc, 3), matrix(table[GAPS], nc, 2)
    location, rates = matrix(table[LOCATION], nc, 4), matrix(table[RATES], nc, 4)
    start_location, start_rates = matrix(step[START_LOCATION], nc, 4), matrix(step[START_RATES], nc, 4)
    start_slip, start_normal = matrix(step[START_SLIP], nc, 3), matrix(step[START_NORMAL], nc, 2)
    start_gap, start_mode = reals(step[START_GAP], nc), integers(step[START_MODE], nc)
    start_domain, behind = reals(step[START_DOMAIN], nc), integers(step[BEHIND], nc)
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
    known = integer_matrix(step[KNOWN], nc, CONTACT_INTS + 2)
    changed = stepped == 0
    ng = integers(table[GUARD_COUNT], 1)[0]
    start_end, guard_int = integers(step[START_END], ng), integer_matrix(table[GUARD_INT], ng, GUARD_INTS)
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
