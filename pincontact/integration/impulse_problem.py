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
from ..dynamics.equations import coefficient_at, unit_of_force
from ..dynamics.linear import factorize_tree, inner, solve_semidefinite, unwhiten, whiten
from ..dynamics.resistance import drop_unturned
from ..friction.ellipse import stretch_pair
from ..geometry.carriers import ALPHA, OMEGA
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import TABLE, entry_kernel, kernel
from ..layout import (
    ANISOTROPIC,
    BASIS,
    BIAS,
    CONSTRAINT_ROWS,
    CONTACT_INT,
    CONTACT_INTS,
    CONTACT_REAL,
    CONTACT_REALS,
    DAMPING,
    DOMAIN,
    FACTOR,
    FRAMES,
    FREE,
    GUARD_COUNT,
    JACOBIAN,
    LENGTH,
    MASS,
    MASS_NOT_POSITIVE,
    MU,
    MULTIPLIERS,
    NC,
    NLE,
    NOT_FINITE,
    NQ,
    NV,
    OK,
    PARENTS,
    PATTERN,
    PERMUTATION,
    ROLLING,
    ROWS,
    SIDE_INT,
    SIDE_INTS,
    SIZES,
    SLIP,
    SLIPPING,
    SPINNING,
    STICK,
    STRIBECK_SPEED,
    SUPPORT,
    SUPPORT_SIZE,
    TANGENTS,
    TAU,
    UNILATERAL,
    VISCOUS,
    WORK,
    V,
)
from ..layout import DELASSUS as DELASSUS_WORK
from ..memory import cube, integer_matrix, integers, matrix, reals
from .impulse_layout import (
    AHEAD,
    APART,
    APPROACH,
    AT_REST,
    AXIS,
    BEHIND,
    CARRIED_TREND,
    CARRIED_V,
    CHANGE,
    COUNTS,
    COUPLED,
    DELASSUS,
    DRIVEN_T1,
    DRY_FRICTION,
    EQUATION_FACTOR,
    EQUATION_INDEX,
    EQUATION_SHARE,
    EQUATION_UNIT,
    EQUATIONS,
    FREE_CHANGE,
    FREE_RATE,
    FRICTION,
    HAS_TREND,
    HELD,
    IMPULSE_TIME,
    JOINT_GUARD,
    JOINT_INT,
    JOINT_INTS,
    JOINT_KIND,
    JOINT_Q,
    JOINT_REAL,
    JOINT_V,
    KEPT,
    KEPT_HIGH,
    KEPT_LOW,
    LOAD,
    LOADS,
    LOWER_LIMIT,
    MAX_EQUATIONS,
    MAX_UNITS,
    MEAN,
    MEAN_VELOCITY,
    MIDPOINT,
    NCOUNTS,
    NEQ,
    NJ,
    NNUMBERS,
    NUMBERS,
    ON_CONTACT,
    ON_JOINT,
    ON_LOADED,
    ON_TURN,
    OVERLAP,
    PARENT,
    RESTITUTION,
    REVIEWS,
    RIGID,
    ROW_MASK,
    SHIFT,
    SLID,
    SLIDING,
    START_DOMAIN,
    START_END,
    START_GAP,
    START_MODE,
    START_NORMAL,
    START_Q,
    START_SLIP,
    START_T1,
    START_T2,
    STICKING,
    STICKING_AGAIN,
    TOUCHED,
    TOUCHES,
    TREND_BEFORE,
    TURNING_RATE,
    UNIT_INDEX,
    UNIT_INT,
    UNIT_INTS,
    UNIT_KIND,
    UNIT_LOAD,
    UNIT_REAL,
    UNIT_REALS,
    UNITS,
    UPPER_LIMIT,
    WHITENED,
    H,
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
def rigid_velocity(table, step, c, row, nv, nc):
    """Component of v_c along a basis row at the start's velocity, in the midpoint's geometry."""
    rows, v0, middle = cube(table[ROWS], nc, 3, nv), reals(step[CARRIED_V], nv), reals(table[V], nv)
    value = dot(cube(table[BASIS], nc, 3, 3)[c, row], matrix(table[SLIP], nc, 3)[c])
    for k in range(nv):
        value += rows[c, row, k] * (v0[k] - middle[k])
    return value


@kernel
def start_velocity(table, step, c, row, nv, nc):
    """Component of v_c along a basis row at the step's start."""
    if integers(step[COUNTS], NCOUNTS)[RIGID] != 0:
        return rigid_velocity(table, step, c, row, nv, nc)
    # the biases of normals hold the normal's own rate, those of tangents do not
    if row == 2:
        return matrix(step[START_NORMAL], nc, 2)[c, 0]
    if row == 1 and integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)[c, PATTERN] == ON_CURVE:
        return matrix(step[START_NORMAL], nc, 2)[c, 1]
    return dot(cube(table[BASIS], nc, 3, 3)[c, row], matrix(step[START_SLIP], nc, 3)[c])


@kernel
def free_gain(table, step, c, row, nv, nc, h):
    """What a component of v_c gains over the step if no impulse acts."""
    value = inner(cube(table[ROWS], nc, 3, nv)[c, row], reals(step[CHANGE], nv), nv)
    if integers(step[COUNTS], NCOUNTS)[RIGID] == 0:
        value += h * matrix(table[BIAS], nc, 3)[c, row]
    return value


@kernel
def _add_equation(table, step, c, row, nv, nc, h):
    """One more equation u = 0, orthogonalised (twice, for round-off) against those before."""
    counts = integers(step[COUNTS], NCOUNTS)
    size = counts[MAX_EQUATIONS]
    e = counts[NEQ]
    index = integer_matrix(step[EQUATION_INDEX], size, 2)
    equations = matrix(step[EQUATIONS], size, nv)
    factor = matrix(step[EQUATION_FACTOR], size, size)
    share = reals(step[EQUATION_SHARE], size)
    index[e, 0], index[e, 1] = c, row
    whiten(
        matrix(table[FACTOR], nv, nv),
        integers(table[PARENTS], nv),
        nv,
        cube(table[ROWS], nc, 3, nv)[c, row],
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
    value = -start_velocity(table, step, c, row, nv, nc) - free_gain(table, step, c, row, nv, nc, h)
    for j in range(e):
        value -= factor[e, j] * share[j]
    share[e] = value / rest if independent else 0.0
    counts[NEQ] = e + 1


@kernel
def _add_unit(step, kind, index, mask, mu, instant):
    """A new unit, returns its number; instant: when it closes, negative where its impulse is spread over the step."""
    counts = integers(step[COUNTS], NCOUNTS)
    u = counts[UNITS]
    ints = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)[u]
    numbers = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)[u]
    ints[UNIT_KIND], ints[UNIT_INDEX], ints[ROW_MASK] = kind, index, mask
    ints[TOUCHES] = ints[MIDPOINT] = ints[AT_REST] = ints[SLID] = ints[HELD] = 0
    for i in range(UNIT_REALS):
        numbers[i] = 0.0
    numbers[IMPULSE_TIME] = 0.5 * reals(step[NUMBERS], NNUMBERS)[H]
    if instant >= 0.0:
        numbers[IMPULSE_TIME] = instant
        ints[TOUCHES] = counts[TOUCHED] = counts[RIGID] = 1
    reals(step[FRICTION], counts[MAX_UNITS])[u] = numbers[SLIDING] = mu
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
def _gather_contacts(table, step, nv, nc, h):
    """Units of all contacts that take part."""
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    rows, bias = cube(table[ROWS], nc, 3, nv), matrix(table[BIAS], nc, 3)
    counts = integers(step[COUNTS], NCOUNTS)
    unit_int = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)
    unit_real = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)
    friction = reals(step[FRICTION], counts[MAX_UNITS])
    start_mode = integers(step[START_MODE], nc)
    start_gap, start_normal = reals(step[START_GAP], nc), matrix(step[START_NORMAL], nc, 2)
    start_domain, behind = reals(step[START_DOMAIN], nc), integers(step[BEHIND], nc)
    sticking, load, trend = reals(step[STICKING], nc), reals(step[LOAD], nc), reals(step[CARRIED_TREND], nv)
    basis, slip = cube(table[BASIS], nc, 3, 3), matrix(table[SLIP], nc, 3)
    ahead = reals(step[NUMBERS], NNUMBERS)[AHEAD]
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
def _gather_turns(table, step, nc, h):
    """Units that resist spinning and rolling, of the contacts that take part."""
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    counts = integers(step[COUNTS], NCOUNTS)
    unit_int = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)
    unit_real = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)
    load = reals(step[LOAD], nc)
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
def add_turn_row(table, c, axis, nv, nc, factor, out):
    """out += factor times the row of the relative angular velocity of contact c about a basis vector."""
    jacobian, about = matrix(table[JACOBIAN], nv, 6), cube(table[BASIS], nc, 3, 3)[c, axis]
    support = integer_matrix(table[SUPPORT], 2 * nc, nv)
    side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
    for side in range(2 * c, 2 * c + 2):
        signed = factor if side % 2 == 1 else -factor
        add_rotation_row(signed, jacobian, support[side], side_int[side, SUPPORT_SIZE], about, out)


@kernel
def _turning(table, c, axis, quantity, nc):
    """Relative angular velocity (OMEGA), or acceleration at a = 0 (ALPHA), about a basis vector at the midpoint."""
    frames, about = cube(table[FRAMES], 2 * nc, 8, 3), cube(table[BASIS], nc, 3, 3)[c, axis]
    return dot(about, frames[2 * c + 1, quantity]) - dot(about, frames[2 * c, quantity])


@kernel
def _gather_equations(table, step, nv, nc, h):
    """Bilateral normals and ideal rolling of bilateral contacts."""
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    for c in range(nc):
        if contact_int[c, UNILATERAL] == 0:
            rolls, two = contact_real[c, MU] == math.inf, contact_int[c, TANGENTS] == 2
            second_normal = contact_int[c, PATTERN] == ON_CURVE
            for row in range(2, -1, -1):
                if row == 2 or (row == 1 and second_normal) or (rolls and (row == 0 or two)):
                    _add_equation(table, step, c, row, nv, nc, h)
    counts = integers(step[COUNTS], NCOUNTS)
    nequations, size = counts[NEQ], counts[MAX_EQUATIONS]
    if not are_redundant(matrix(step[EQUATION_FACTOR], size, size), nequations):
        return
    index, unit = integer_matrix(step[EQUATION_INDEX], size, 2), reals(step[EQUATION_UNIT], size)
    rows, factor = cube(table[ROWS], nc, 3, nv), matrix(table[FACTOR], nv, nv)
    parents, work = integers(table[PARENTS], nv), reals(table[WORK], nv)
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
def _gather_joints(table, step, nv, h):
    """Units of joint limits within reach and of dry friction. A joint that was held at its end is closed, whatever
    rounding makes of its position."""
    counts = integers(step[COUNTS], NCOUNTS)
    nq = integers(table[SIZES], 8)[NQ]
    nj = counts[NJ]
    joint_int, joint_real = integer_matrix(step[JOINT_INT], nj, JOINT_INTS), matrix(step[JOINT_REAL], nj, 2)
    start_end = integers(step[START_END], integers(table[GUARD_COUNT], 1)[0])
    unit_real = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)
    q, v, trend = reals(step[START_Q], nq), reals(step[CARRIED_V], nv), reals(step[CARRIED_TREND], nv)
    mean = reals(step[MEAN], nv)
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
def _keep_within_reach(table, step, nc):
    """Redundant contacts: take out of b what no motion of rigid bodies could follow.

    Gaps at the midpoint put a little of that into b where contacts move with the bodies that they are on. More of it is
    in what second order adds to rigid geometry, in the first column of OVERLAP. What drives ask for beyond the range of
    the Delassus matrix is left: there something has to slip. Tangents of contacts that slide already take no part: they
    need not come to rest, and what changes their slip does so whatever the impulses.
    """
    counts = integers(step[COUNTS], NCOUNTS)
    n = counts[UNITS]
    unit_int = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)
    overlap = matrix(step[OVERLAP], 3 * counts[MAX_UNITS], counts[MAX_EQUATIONS])
    delassus, b = matrix(step[DELASSUS], 3 * n, 3 * n), reals(step[LOADS], 3 * n)
    system, scratch = (
        matrix(table[DELASSUS_WORK], 3 * nc, 3 * nc + 1),
        matrix(table[CONSTRAINT_ROWS], 3 * nc, 3 * nc + 1),
    )
    x, start_mode = reals(table[MULTIPLIERS], 3 * nc), integers(step[START_MODE], nc)
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
                system[count, j] = delassus[count, j] if held and (j == count or system[j, j] > 0.0) else 0.0
            count += 1
        if count <= 3 or largest <= WITHIN_ROUND_OFF * scale:
            return
        if solve_semidefinite(system, count, integers(table[PERMUTATION], 3 * nc), x, scratch) == independent:
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
def _fill_units(table, step, nv, nc, h):
    """Whitened rows, Delassus matrix and b of all units, after the equations have taken their share."""
    counts = integers(step[COUNTS], NCOUNTS)
    n, units, nequations, size = counts[UNITS], counts[MAX_UNITS], counts[NEQ], counts[MAX_EQUATIONS]
    factor, rows = matrix(table[FACTOR], nv, nv), cube(table[ROWS], nc, 3, nv)
    parents = integers(table[PARENTS], nv)
    unit_int = integer_matrix(step[UNIT_INT], units, UNIT_INTS)
    unit_real = matrix(step[UNIT_REAL], units, UNIT_REALS)
    joint_int = integer_matrix(step[JOINT_INT], counts[NJ], JOINT_INTS)
    whitened, overlap = matrix(step[WHITENED], 3 * units, nv), matrix(step[OVERLAP], 3 * units, size)
    equations, share = matrix(step[EQUATIONS], size, nv), reals(step[EQUATION_SHARE], size)
    delassus, b = matrix(step[DELASSUS], 3 * n, 3 * n), reals(step[LOADS], 3 * n)
    v, change, trend = reals(step[CARRIED_V], nv), reals(step[CHANGE], nv), reals(step[CARRIED_TREND], nv)
    restitution, middle = reals(step[RESTITUTION], nc), reals(table[V], nv)
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
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
                add_turn_row(table, index, axis, nv, nc, 1.0, line)
                drop_unturned(line, nv)
                # what the bodies turn at the midpoint, and what drives add to it
                turned = inner(line, middle, nv)
                turning = _turning(table, index, axis, OMEGA, nc)
                unit_real[u, DRIVEN_T1 + row] = turned - turning
                rigid = turning + inner(line, v, nv) - turned
                beyond = 0.0
                if counts[RIGID] == 0:
                    rate = inner(line, reals(step[TURNING_RATE], nv), nv)
                    beyond = 0.5 * h * (_turning(table, index, axis, ALPHA, nc) - rate)
                start = rigid - beyond
                gain = inner(line, change, nv) + 2.0 * beyond
            else:
                for i in range(nv):
                    line[i] = rows[index, row, i]
                start = start_velocity(table, step, index, row, nv, nc)
                gain = free_gain(table, step, index, row, nv, nc, h)
                rigid = rigid_velocity(table, step, index, row, nv, nc)
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
        _keep_within_reach(table, step, nc)
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
def _add_viscous(table, step, nv, nc, h, factor, change):
    """Viscous friction of the contacts closed at the start, in the system (its lower triangle) and the loads."""
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    rows, start_mode = cube(table[ROWS], nc, 3, nv), integers(step[START_MODE], nc)
    for c in range(nc):
        constant = h * contact_real[c, VISCOUS]
        if constant == 0.0 or start_mode[c] == FREE:
            continue
        for row in range(contact_int[c, TANGENTS]):
            line = rows[c, row]
            slip = rigid_velocity(table, step, c, row, nv, nc)
            for i in range(nv):
                change[i] -= constant * slip * line[i]
                for j in range(i + 1):
                    factor[i, j] += 0.5 * constant * line[i] * line[j]


@entry_kernel(TABLE, TABLE, aside=True)
def assemble(table, step):
    """The cone problem of the step from the kinematics at its midpoint; OK, or a status of `layout`.

    Its size is counts[UNITS]; counts[RIGID] says which geometry to take, and is set where anything touches.
    """
    sizes = integers(table[SIZES], 8)
    nv, nc = sizes[NV], sizes[NC]
    counts, numbers = integers(step[COUNTS], NCOUNTS), reals(step[NUMBERS], NNUMBERS)
    h = numbers[H]
    counts[UNITS] = counts[NEQ] = counts[REVIEWS] = counts[TOUCHED] = 0
    counts[COUPLED] = APART
    numbers[KEPT], numbers[KEPT_LOW], numbers[KEPT_HIGH] = 1.0, 0.0, 1.0
    mass, factor = matrix(table[MASS], nv, nv), matrix(table[FACTOR], nv, nv)
    damping, tau, nle = reals(table[DAMPING], nv), reals(table[TAU], nv), reals(table[NLE], nv)
    v, change, trend = reals(step[CARRIED_V], nv), reals(step[CHANGE], nv), reals(step[CARRIED_TREND], nv)
    for i in range(nv):
        for j in range(i):
            factor[i, j] = mass[i, j]
        factor[i, i] = mass[i, i] + 0.5 * h * damping[i]
        change[i] = h * (tau[i] - nle[i] - damping[i] * v[i])
    joint_int = integer_matrix(step[JOINT_INT], counts[NJ], JOINT_INTS)
    joint_real = matrix(step[JOINT_REAL], counts[NJ], 2)
    for j in range(counts[NJ]):
        if joint_int[j, JOINT_KIND] == DRY_FRICTION:
            change[joint_int[j, JOINT_V]] += h * joint_real[j, 1]
    _add_viscous(table, step, nv, nc, h, factor, change)
    parents = integers(table[PARENTS], nv)
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
    _gather_contacts(table, step, nv, nc, h)
    _gather_turns(table, step, nc, h)
    _gather_joints(table, step, nv, h)
    # last, since the geometry of the step depends on whether anything touches
    _gather_equations(table, step, nv, nc, h)
    _fill_units(table, step, nv, nc, h)
    return OK
