"""The cone problem of one step of Moreau's method: its units, its equations, the Delassus matrix and b.

Units are the cones of the problem: unilateral contacts that are closed or close in the step; bilateral ones with
Coulomb friction, whose normal impulse is an equation and their cone a disk of given radius; resistance to spinning and
to rolling, disks of torques with a radius from the contact's normal impulse; joint limits; dry friction of joints.
Equations (bilateral normals, ideal rolling) are eliminated before.

Viscous friction of contacts enters like joint damping, with the velocity of slip in the midpoint's geometry.
Coefficients that depend on the speed of slip are those of its speed at the midpoint; elliptic cones are stretched to
round ones (see `friction.ellipse`).

Velocities are in the axes of the midpoint, and bias forces and biases without what comes of axes that turn (see
`impulses`). The relative velocity u at the step's end is w_0 + rows (v_1 - v_0) + h bias to second order, or, to first
order, w_m + rows (v_1 - v_m) in the midpoint's geometry: that is the velocity of bodies that are rigid to the last bit,
so that redundant contacts can all come to rest, and impulses change the kinetic energy of just these velocities. Steps
with impacts take it, and those in which redundant contacts contradict each other by what the first one leaves out.
Sliding contacts take the mean of u and w_0 instead, which makes friction second order too, until one of them stops.
"""

from __future__ import annotations

import math

from ..constraints.kinematics import add_rotation_row
from ..dynamics.least_forces import unit_of_force
from ..dynamics.linear import factorize_tree, inner, solve_semidefinite, unwhiten, whiten
from ..dynamics.resistance import drop_unturned
from ..dynamics.sliding import coefficient_at
from ..friction.ellipse import stretch_pair
from ..geometry.carriers import ALPHA, OMEGA
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import INTEGER, STEPPING, entry_kernel, kernel
from ..layout import (
    ANISOTROPIC,
    DOMAIN,
    FREE,
    LENGTH,
    MASS_NOT_POSITIVE,
    MU,
    NOT_FINITE,
    OK,
    PATTERN,
    ROLLING,
    SLIPPING,
    SPINNING,
    STICK,
    STRIBECK_SPEED,
    SUPPORT_SIZE,
    TANGENTS,
    UNILATERAL,
    VISCOUS,
    system_at,
)
from ..workspace import square
from .impulse_layout import (
    AHEAD,
    APART,
    APPROACH,
    AT_REST,
    AXIS,
    COUPLED,
    DRIVEN_T1,
    DRY_FRICTION,
    FREE_CHANGE,
    FREE_RATE,
    HAS_TREND,
    HELD,
    IMPULSE_TIME,
    JOINT_GUARD,
    JOINT_KIND,
    JOINT_Q,
    JOINT_V,
    KEPT,
    KEPT_HIGH,
    KEPT_LOW,
    LOWER_LIMIT,
    MEAN_VELOCITY,
    MIDPOINT,
    NEQ,
    NJ,
    ON_CONTACT,
    ON_JOINT,
    ON_LOADED,
    ON_TURN,
    PARENT,
    REVIEWS,
    RIGID,
    ROW_MASK,
    SHIFT,
    SLID,
    SLIDING,
    START_T1,
    START_T2,
    STICKING_AGAIN,
    TOUCHED,
    TOUCHES,
    TREND_BEFORE,
    UNIT_INDEX,
    UNIT_KIND,
    UNIT_LOAD,
    UNIT_REALS,
    UNITS,
    UPPER_LIMIT,
    H,
    step_at,
)

# A contact nearer than this, relative to its length, is touching.
TOUCHING = 1e-12
# A contact at its limit of friction that would slide this far in a step, relative to its length, slips; one without
# force that would be this far apart opens; what turns by less, in rad, does not turn.
OPENING = 1e-12
# Relative to b, this is nothing.
WITHIN_ROUND_OFF = 1e-14
# By this part of b redundant contacts contradict each other at most where gaps at the midpoint make them do so.
OUT_OF_REACH = 1e-5
# An equation whose rest after orthogonalisation is below this fraction is redundant.
REDUNDANT = 1e-10


@kernel
def touch_instant(gap, speed, rate, touching, h):
    """When gap + speed s + rate s^2 / 2 falls through zero for s in [0, h]; negative if it does not."""
    if gap <= touching and speed <= 0.0:
        return 0.0 if speed < 0.0 or rate <= 0.0 else -1.0
    discriminant = speed * speed - 2.0 * rate * gap
    if discriminant < 0.0:
        # below the surface for the whole parabola, or above it
        return 0.0 if gap < 0.0 else -1.0
    root = math.sqrt(discriminant)
    if speed < 0.0:
        instant = 2.0 * gap / (root - speed)
    elif rate < 0.0:
        instant = (speed + root) / -rate
    else:
        return -1.0
    return instant if instant <= h else -1.0


@kernel
def _within_domains(start, middle, instant, ahead):
    """Whether the points of a contact are inside both domains at an instant of the step, by their way to the nearest
    end at its start and so much later."""
    if start == math.inf or middle == math.inf:
        return middle >= 0.0
    return (start + (middle - start) * instant / ahead if ahead > 0.0 else start) >= 0.0


@kernel
def rigid_velocity(system, step, c, row, nv, nc):
    """Component of v_c along a basis row at the start's velocity, in the midpoint's geometry."""
    rows, v0, middle = system.rows, step.carried_v, system.v
    value = dot(system.basis[c, row], system.slip[c])
    for k in range(nv):
        value += rows[c, row, k] * (v0[k] - middle[k])
    return value


@kernel
def start_velocity(system, step, c, row, nv, nc):
    """Component of v_c along a basis row at the step's start."""
    if step.counts[RIGID] != 0:
        return rigid_velocity(system, step, c, row, nv, nc)
    # the biases of normals hold the normal's own rate, those of tangents do not
    if row == 2:
        return step.start_normal[c, 0]
    if row == 1 and system.contact_int[c, PATTERN] == ON_CURVE:
        return step.start_normal[c, 1]
    return dot(system.basis[c, row], step.start_slip[c])


@kernel
def free_gain(system, step, c, row, nv, nc, h):
    """What a component of v_c gains over the step if no impulse acts."""
    value = inner(system.rows[c, row], step.change, nv)
    if step.counts[RIGID] == 0:
        value += h * system.bias[c, row]
    return value


@kernel
def _add_equation(system, step, c, row, nv, nc, h):
    """One more equation u = 0, orthogonalised (twice, for round-off) against those before."""
    counts = step.counts
    e = counts[NEQ]
    index = step.equation_index
    equations = step.equations
    factor = step.equation_factor
    share = step.equation_share
    index[e, 0], index[e, 1] = c, row
    whiten(
        system.factor,
        system.parents,
        nv,
        system.rows[c, row],
        equations[e],
    )
    whole = math.sqrt(inner(equations[e], equations[e], nv))
    for j in range(e):
        factor[e, j] = 0.0
    for _ in range(2):
        for j in range(e):
            part = inner(equations[e], equations[j], nv)
            factor[e, j] += part
            for k in range(nv):
                equations[e, k] -= part * equations[j, k]
    rest = math.sqrt(inner(equations[e], equations[e], nv))
    independent = rest > REDUNDANT * whole
    factor[e, e] = rest if independent else 0.0
    for k in range(nv):
        equations[e, k] = equations[e, k] / rest if independent else 0.0
    value = -start_velocity(system, step, c, row, nv, nc) - free_gain(system, step, c, row, nv, nc, h)
    for j in range(e):
        value -= factor[e, j] * share[j]
    share[e] = value / rest if independent else 0.0
    counts[NEQ] = e + 1


@kernel
def _add_unit(step, kind, index, mask, mu, instant):
    """A new unit, returns its number; instant: when it closes, negative where its impulse is spread over the step."""
    counts = step.counts
    u = counts[UNITS]
    ints = step.unit_int[u]
    numbers = step.unit_real[u]
    ints[UNIT_KIND], ints[UNIT_INDEX], ints[ROW_MASK] = kind, index, mask
    ints[TOUCHES] = ints[MIDPOINT] = ints[AT_REST] = ints[SLID] = ints[HELD] = 0
    for i in range(UNIT_REALS):
        numbers[i] = 0.0
    numbers[IMPULSE_TIME] = 0.5 * step.numbers[H]
    if instant >= 0.0:
        numbers[IMPULSE_TIME] = instant
        ints[TOUCHES] = counts[TOUCHED] = counts[RIGID] = 1
    step.friction[u] = numbers[SLIDING] = mu
    counts[UNITS] = u + 1
    return u


@kernel
def _set_impact(numbers, start, rate, restitution, h):
    """Newton's law for a unit that closes: its rebound, less what the smooth forces take back by the step's end.

    They add nothing to it: what they would lift is closed to the step's end, and free to leave in the next one. The
    rate holds the forces of the last step, which may have been the unit's own.
    """
    approach = start + numbers[IMPULSE_TIME] * rate
    numbers[APPROACH], numbers[FREE_RATE] = approach, rate
    if approach < 0.0:
        numbers[SHIFT] = max(-restitution * approach + (h - numbers[IMPULSE_TIME]) * min(rate, 0.0), 0.0)


@kernel
def _gather_contacts(system, step, nv, nc, h):
    """Units of all contacts that take part."""
    contact_int = system.contact_int
    contact_real = system.contact_real
    rows, bias = system.rows, system.bias
    unit_int = step.unit_int
    unit_real = step.unit_real
    friction = step.friction
    start_mode = step.start_mode
    start_gap, start_normal = step.start_gap, step.start_normal
    start_domain, behind = step.start_domain, step.behind
    sticking, load, trend = step.sticking, step.load, step.carried_trend
    basis, slip = system.basis, system.slip
    ahead = step.numbers[AHEAD]
    for c in range(nc):
        mu, two = contact_real[c, MU], contact_int[c, TANGENTS] == 2
        bilateral, opened = contact_int[c, UNILATERAL] == 0, start_mode[c] == FREE
        kind, mask = ON_CONTACT, 4 if mu == 0.0 else (7 if two else 5)
        instant = -1.0
        if bilateral:
            # the cone's normal carries a given impulse: the disk's radius is mu times it
            kind, mask = ON_LOADED, 3 if two else 1
            if mu == 0.0 or mu == math.inf:
                continue
        elif opened:
            rate = inner(rows[c, 2], trend, nv) + bias[c, 2]
            instant = touch_instant(start_gap[c], start_normal[c, 0], rate, TOUCHING * contact_real[c, LENGTH], h)
            if instant < 0.0 or behind[c] != 0:
                continue
            if not _within_domains(start_domain[c], contact_real[c, DOMAIN], instant, ahead):
                continue
        if contact_real[c, STRIBECK_SPEED] > 0.0 and start_mode[c] != STICK:
            speed = math.hypot(dot(basis[c, 0], slip[c]), dot(basis[c, 1], slip[c]) if two else 0.0)
            mu = coefficient_at(contact_real[c], speed)
        u = _add_unit(step, kind, c, mask, mu, instant)
        ints = unit_int[u]
        if bilateral:
            unit_real[u, UNIT_LOAD] = h * load[c]
        if start_mode[c] == STICK and sticking[c] > mu:
            # a contact at rest holds up to its coefficient of sticking
            friction[u] = sticking[c]
            ints[AT_REST] = 1
        if start_mode[c] == SLIPPING:
            ints[SLID] = 1
            unit_real[u, STICKING_AGAIN] = sticking[c] if sticking[c] > mu else 0.0
        ints[MIDPOINT] = 1 if start_mode[c] == SLIPPING and two and 0.0 < mu < math.inf else 0


@kernel
def _gather_turns(system, step, nc, h):
    """Units that resist spinning and rolling, of the contacts that take part."""
    contact_int = system.contact_int
    contact_real = system.contact_real
    counts = step.counts
    unit_int = step.unit_int
    unit_real = step.unit_real
    load = step.load
    contacts = counts[UNITS]
    for c in range(nc):
        if contact_real[c, SPINNING] == 0.0 and contact_real[c, ROLLING] == 0.0:
            continue
        parent = -1
        if contact_int[c, UNILATERAL] != 0:
            for u in range(contacts):
                if unit_int[u, UNIT_INDEX] == c:
                    parent = u
            if parent < 0:
                continue
        two = contact_int[c, TANGENTS] == 2
        for spins in range(2):
            length = contact_real[c, SPINNING if spins == 1 else ROLLING]
            if length > 0.0:
                u = _add_unit(step, ON_TURN, c, 3 if two and spins == 0 else 1, length, -1.0)
                # in a plane everything rolls about its normal, the second basis vector
                unit_int[u, AXIS] = 2 if spins == 1 else (0 if two else 1)
                unit_int[u, PARENT] = parent
                unit_real[u, UNIT_LOAD] = h * load[c]


@kernel
def add_turn_row(system, c, axis, nv, nc, factor, out):
    """out += factor times the row of the relative angular velocity of contact c about a basis vector."""
    jacobian, about = system.jacobian, system.basis[c, axis]
    support = system.support
    side_int = system.side_int
    for side in range(2 * c, 2 * c + 2):
        signed = factor if side % 2 == 1 else -factor
        add_rotation_row(signed, jacobian, support[side], side_int[side, SUPPORT_SIZE], about, out)


@kernel
def _turning(system, c, axis, quantity, nc):
    """Relative angular velocity (OMEGA), or acceleration at a = 0 (ALPHA), about a basis vector at the midpoint."""
    frames, about = system.frames, system.basis[c, axis]
    return dot(about, frames[2 * c + 1, quantity]) - dot(about, frames[2 * c, quantity])


@kernel
def _gather_equations(system, step, nv, nc, h):
    """Bilateral normals and ideal rolling of bilateral contacts."""
    contact_int = system.contact_int
    contact_real = system.contact_real
    for c in range(nc):
        if contact_int[c, UNILATERAL] == 0:
            rolls, two = contact_real[c, MU] == math.inf, contact_int[c, TANGENTS] == 2
            second_normal = contact_int[c, PATTERN] == ON_CURVE
            for row in range(2, -1, -1):
                if row == 2 or (row == 1 and second_normal) or (rolls and (row == 0 or two)):
                    _add_equation(system, step, c, row, nv, nc, h)
    counts = step.counts
    nequations = counts[NEQ]
    if not are_redundant(step.equation_factor, nequations):
        return
    index, unit = step.equation_index, step.equation_unit
    rows, factor = system.rows, system.factor
    parents, work = system.parents, system.work
    for e in range(nequations):
        c, row = index[e, 0], index[e, 1]
        whiten(factor, parents, nv, rows[c, row], work)
        own, unit[e] = inner(work, work, nv), 1.0
        if own > 0.0:
            unit[e] = unit_of_force(contact_int, contact_real, c, row, own, rows, factor, parents, nv, work)


@kernel
def are_redundant(factor, n):
    """Whether any of n equations says what those before it do."""
    redundant = False
    for e in range(n):
        redundant = redundant or factor[e, e] == 0.0
    return redundant


@kernel
def _gather_joints(system, step, nv, h):
    """Units of joint limits within reach and of dry friction. A joint that was held at its end is closed, whatever
    rounding makes of its position."""
    counts = step.counts
    nj = counts[NJ]
    joint_int, joint_real = step.joint_int, step.joint_real
    start_end = step.start_end
    unit_real = step.unit_real
    q, v, trend = step.start_q, step.carried_v, step.carried_trend
    mean = step.mean
    for j in range(nj):
        k = joint_int[j, JOINT_V]
        if joint_int[j, JOINT_KIND] == DRY_FRICTION:
            u = _add_unit(step, ON_JOINT, j, 1, 1.0, -1.0)
            unit_real[u, UNIT_LOAD] = h * joint_real[j, 0]
            continue
        sign = 1.0 if joint_int[j, JOINT_KIND] == LOWER_LIMIT else -1.0
        gap = sign * (q[joint_int[j, JOINT_Q]] - joint_real[j, 0])
        speed, rate = sign * v[k], sign * trend[k]
        held = start_end[joint_int[j, JOINT_GUARD]] * sign < 0.0
        resting = held or (gap <= TOUCHING and abs(speed) * h <= TOUCHING)
        instant = touch_instant(gap, speed, rate, TOUCHING, h)
        thrown = sign * mean[k]
        if instant < 0.0 and counts[HAS_TREND] == MEAN_VELOCITY and thrown < 0.0 and gap + h * thrown < 0.0:
            # by an impact of this step
            instant = max(gap / -thrown, 0.0)
        if resting or instant >= 0.0:
            _add_unit(step, ON_JOINT, j, 4, 0.0, -1.0 if resting else instant)


@kernel
def _keep_within_reach(system, step, nc):
    """Redundant contacts: take out of b what no motion of rigid bodies could follow.

    Gaps at the midpoint put a little of that into b where contacts move with the bodies that they are on. More of it is
    in what second order adds to rigid geometry, in the first column of OVERLAP. What drives ask for beyond the range of
    the Delassus matrix is left: there something has to slip. Tangents of contacts that slide already take no part: they
    need not come to rest, and what changes their slip does so whatever the impulses.
    """
    counts = step.counts
    n = counts[UNITS]
    unit_int = step.unit_int
    overlap = step.overlap
    delassus, b = square(step.delassus, 3 * n), step.loads
    operator, scratch = (
        system.delassus,
        system.constraint_rows,
    )
    x, start_mode = system.multipliers, step.start_mode
    # all of b, and where that leaves more than gaps explain, second order alone; what is left goes to the second column
    for whole in range(1, -1, -1):
        count, independent, largest, scale = 0, 0, 0.0, 0.0
        while count < 3 * n and unit_int[count // 3, UNIT_KIND] < ON_JOINT:
            held = count % 3 == 2 or start_mode[unit_int[count // 3, UNIT_INDEX]] != SLIPPING
            x[count] = (b[count] if whole == 1 else overlap[count, 0]) if held else 0.0
            largest, scale = max(largest, abs(overlap[count, 0]) if held else 0.0), max(scale, abs(b[count]))
            if held and delassus[count, count] > 0.0:
                independent += 1
            for j in range(count + 1):
                operator[count, j] = delassus[count, j] if held and (j == count or operator[j, j] > 0.0) else 0.0
            count += 1
        if count <= 3 or largest <= WITHIN_ROUND_OFF * scale:
            return
        if solve_semidefinite(operator, count, system.permutation, x, scratch) == independent:
            return
        most = 0.0
        for r in range(count):
            held = r % 3 == 2 or start_mode[unit_int[r // 3, UNIT_INDEX]] != SLIPPING
            wanted = b[r] if whole == 1 else overlap[r, 0]
            overlap[r, 1] = wanted - inner(delassus[r], x, count) if held else 0.0
            most = max(most, abs(overlap[r, 1]))
        if whole == 1 and most > OUT_OF_REACH * scale:
            continue
        for r in range(count):
            b[r] -= overlap[r, 1]
        return


@kernel
def _fill_units(system, step, nv, nc, h):
    """Whitened rows, Delassus matrix and b of all units, after the equations have taken their share."""
    counts = step.counts
    n, nequations = counts[UNITS], counts[NEQ]
    factor, rows = system.factor, system.rows
    parents = system.parents
    unit_int = step.unit_int
    unit_real = step.unit_real
    joint_int = step.joint_int
    whitened, overlap = step.whitened, step.overlap
    equations, share = step.equations, step.equation_share
    delassus, b = square(step.delassus, 3 * n), step.loads
    v, change, trend = step.carried_v, step.change, step.carried_trend
    restitution, middle = step.restitution, system.v
    contact_int = system.contact_int
    contact_real = system.contact_real
    for u in range(n):
        if counts[RIGID] != 0:
            # means of both ends and velocities at the end are not those of one rigid body
            unit_int[u, MIDPOINT] = 0
        kind, index, mask = unit_int[u, UNIT_KIND], unit_int[u, UNIT_INDEX], unit_int[u, ROW_MASK]
        for row in range(3):
            r = 3 * u + row
            line = whitened[r]
            b[r] = 0.0
            if mask >> row & 1 == 0:
                for k in range(nv):
                    line[k] = 0.0
                for j in range(max(nequations, 1)):
                    overlap[r, j] = 0.0
                continue
            if kind == ON_JOINT:
                k = joint_int[index, JOINT_V]
                for i in range(nv):
                    line[i] = 0.0
                line[k] = -1.0 if joint_int[index, JOINT_KIND] == UPPER_LIMIT else 1.0
                start, gain = line[k] * v[k], line[k] * change[k]
                rigid, beyond = start, 0.0
            elif kind == ON_TURN:
                axis = unit_int[u, AXIS] + row
                for i in range(nv):
                    line[i] = 0.0
                add_turn_row(system, index, axis, nv, nc, 1.0, line)
                drop_unturned(line, nv)
                # what the bodies turn at the midpoint, and what drives add to it
                turned = inner(line, middle, nv)
                turning = _turning(system, index, axis, OMEGA, nc)
                unit_real[u, DRIVEN_T1 + row] = turned - turning
                rigid = turning + inner(line, v, nv) - turned
                beyond = 0.0
                if counts[RIGID] == 0:
                    rate = inner(line, step.turning_rate, nv)
                    beyond = 0.5 * h * (_turning(system, index, axis, ALPHA, nc) - rate)
                start = rigid - beyond
                gain = inner(line, change, nv) + 2.0 * beyond
            else:
                for i in range(nv):
                    line[i] = rows[index, row, i]
                start = start_velocity(system, step, index, row, nv, nc)
                gain = free_gain(system, step, index, row, nv, nc, h)
                rigid = rigid_velocity(system, step, index, row, nv, nc)
                beyond = start + gain - inner(line, change, nv) - rigid
            b[r] = start + gain
            if nequations == 0:
                overlap[r, 0] = beyond
            if row < 2:
                # slip is opposed along the mean of its velocities at both ends: in rigid geometry
                unit_real[u, START_T1 + row] = rigid - beyond if unit_int[u, MIDPOINT] != 0 else start
            elif unit_int[u, TOUCHES] != 0:
                again = restitution[index] if kind != ON_JOINT else 0.0
                _set_impact(unit_real[u], start, inner(line, trend, nv), again, h)
            whiten(factor, parents, nv, line, line)
            for j in range(nequations):
                part = inner(line, equations[j], nv)
                overlap[r, j] = part
                b[r] += part * share[j]
                for k in range(nv):
                    line[k] -= part * equations[j, k]
        if kind == ON_TURN and mask == 3 and counts[RIGID] == 0:
            turning = math.hypot(unit_real[u, START_T1], unit_real[u, START_T2])
            unit_int[u, MIDPOINT] = 1 if turning * h > OPENING else 0
        elif kind < ON_JOINT and contact_int[index, ANISOTROPIC] != 0:
            numbers, r, values = contact_real[index], 3 * u, unit_real[u]
            for k in range(nv):
                whitened[r, k], whitened[r + 1, k] = stretch_pair(numbers, whitened[r, k], whitened[r + 1, k])
            for j in range(max(nequations, 1)):
                overlap[r, j], overlap[r + 1, j] = stretch_pair(numbers, overlap[r, j], overlap[r + 1, j])
            b[r], b[r + 1] = stretch_pair(numbers, b[r], b[r + 1])
            values[START_T1], values[START_T2] = stretch_pair(numbers, values[START_T1], values[START_T2])
    for i in range(3 * n):
        for j in range(i + 1):
            value = inner(whitened[i], whitened[j], nv)
            delassus[i, j] = value
            delassus[j, i] = value
    if counts[RIGID] == 0 and nequations == 0:
        _keep_within_reach(system, step, nc)
    for u in range(n):
        mask = unit_int[u, ROW_MASK]
        # rows that only fill up the cone are as heavy as the real ones, since the solver scales by the mean
        weight = 0.0
        for row in range(3):
            weight = max(weight, delassus[3 * u + row, 3 * u + row])
        if weight == 0.0:
            weight = 1.0
        for row in range(3):
            if mask >> row & 1 == 0:
                delassus[3 * u + row, 3 * u + row] = weight
        if mask & 4 == 0:
            # a given normal load: u = weight (F - load) has to vanish
            b[3 * u + 2] = -weight * unit_real[u, UNIT_LOAD]
        b[3 * u + 2] -= unit_real[u, SHIFT]
        if unit_int[u, MIDPOINT] != 0:
            b[3 * u] += unit_real[u, START_T1]
            b[3 * u + 1] += unit_real[u, START_T2]
        for r in range(3 * u, 3 * u + 3):
            if delassus[r, r] == 0.0:
                # no joint moves the bodies along it: no impulse, whatever the round-off in b asks for
                delassus[r, r], b[r] = weight, 0.0


@kernel
def _add_viscous(system, step, h, change):
    """Viscous friction of the contacts closed at the start, in the system (its lower triangle) and the loads."""
    nv, nc, factor = system.sizes.nv, system.sizes.nc, system.factor
    contact_int = system.contact_int
    contact_real = system.contact_real
    rows, start_mode = system.rows, step.start_mode
    for c in range(nc):
        constant = h * contact_real[c, VISCOUS]
        if constant == 0.0 or start_mode[c] == FREE:
            continue
        for row in range(contact_int[c, TANGENTS]):
            line = rows[c, row]
            slip = rigid_velocity(system, step, c, row, nv, nc)
            for i in range(nv):
                change[i] -= constant * slip * line[i]
                for j in range(i + 1):
                    factor[i, j] += 0.5 * constant * line[i] * line[j]


@entry_kernel(INTEGER, INTEGER, aside=True, when=STEPPING)
def assemble(system_address, step_address):
    """The cone problem of the step from the kinematics at its midpoint; OK, or a status of `layout`.

    Its size is counts[UNITS]; counts[RIGID] says which geometry to take, and is set where anything touches.
    """
    system, step = system_at(system_address), step_at(step_address)
    sizes = system.sizes
    nv, nc = sizes.nv, sizes.nc
    counts, numbers = step.counts, step.numbers
    h = numbers[H]
    counts[UNITS] = counts[NEQ] = counts[REVIEWS] = counts[TOUCHED] = 0
    counts[COUPLED] = APART
    numbers[KEPT], numbers[KEPT_LOW], numbers[KEPT_HIGH] = 1.0, 0.0, 1.0
    mass, factor = system.mass, system.factor
    damping, tau, nle = system.damping, system.tau, system.nle
    v, change, trend = step.carried_v, step.change, step.carried_trend
    for i in range(nv):
        for j in range(i):
            factor[i, j] = mass[i, j]
        factor[i, i] = mass[i, i] + 0.5 * h * damping[i]
        change[i] = h * (tau[i] - nle[i] - damping[i] * v[i])
    joint_int = step.joint_int
    joint_real = step.joint_real
    for j in range(counts[NJ]):
        if joint_int[j, JOINT_KIND] == DRY_FRICTION:
            change[joint_int[j, JOINT_V]] += h * joint_real[j, 1]
    _add_viscous(system, step, h, change)
    parents = system.parents
    if not factorize_tree(factor, parents, nv, factor):
        return MASS_NOT_POSITIVE
    whiten(factor, parents, nv, change, change)
    numbers[FREE_CHANGE] = math.sqrt(inner(change, change, nv))
    unwhiten(factor, parents, nv, change, change)
    total = 0.0
    # what no step has told is taken anew where an impact has moved the geometry
    untold = counts[HAS_TREND] == 0 or (counts[TREND_BEFORE] == 0 and numbers[AHEAD] != 0.5 * h)
    for k in range(nv):
        total += change[k]
        if untold:
            trend[k] = change[k] / h
    if total - total != 0.0:
        return NOT_FINITE
    _gather_contacts(system, step, nv, nc, h)
    _gather_turns(system, step, nc, h)
    _gather_joints(system, step, nv, h)
    # last, since the geometry of the step depends on whether anything touches
    _gather_equations(system, step, nv, nc, h)
    _fill_units(system, step, nv, nc, h)
    return OK
