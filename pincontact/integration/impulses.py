"""The velocity-impulse problem of one time step of Moreau's method: assembled, reviewed, carried out.

A step of size h from (q_0, v_0) takes all smooth terms at the midpoint q_m = q_0 + (h/2) v_0, v_m = v_0 + (h/2) a,
with a the velocity's change in the last step over its size. With z the change of velocity by impulses P,

    (M + (h/2) D) (v_1 - v_0) = h (tau - nle - D v_0) + sum of rows^T P,
    u = w_0 + rows (v_1 - v_0) + h bias,

u is the relative velocity at the step's end to second order; Signorini's and Coulomb's laws hold between u and P. In
steps with impacts u is taken in the midpoint's geometry instead, w_m + rows (v_1 - v_m), to first order.
Joint damping D enters by the trapezoidal rule, which no step size makes unstable.

Every impulse has its time in the step: the middle for contacts that were closed (a force, spread over the step), the
instant of touching for those that close. The displacement is h v_0 + (h/2) (v_free - v_0) + (h - time) z, so a body
that falls and bounces within a step follows its parabolas.

Units are the cones of the problem: unilateral contacts that are closed or close in the step; bilateral ones with
Coulomb friction, whose normal impulse is an equation and their cone a disk of given radius; resistance to spinning and
to rolling, disks of torques with a radius from the contact's normal impulse; joint limits; dry friction of joints.
Equations (bilateral normals, ideal rolling) are eliminated before.

Viscous friction of contacts enters like joint damping. Coefficients that depend on the speed of slip are those of its
speed at the midpoint; elliptic cones are stretched to round ones (see `friction.ellipse`).
"""

from __future__ import annotations

import math

from ..dynamics.energy import ENERGY_SLACK, KEPT_ACCURACY
from ..dynamics.equations import coefficient_at, inner
from ..dynamics.linear import backward, cholesky, forward
from ..friction import cone
from ..friction.ellipse import stretch_pair
from ..geometry.carriers import ALPHA, OMEGA
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import INTEGER, TABLE, entry_kernel, kernel
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
    FACTOR,
    FRAMES,
    FREE,
    FRICTIONLESS,
    FROZEN,
    GAPS,
    JACOBIAN,
    JOINT_TABLE,
    LENGTH,
    LOCATION,
    MASS,
    MASS_NOT_POSITIVE,
    MODE,
    MOTION_KIND,
    MU,
    NBLOCKS,
    NC,
    NLE,
    NO_FORCE,
    NORMAL_1,
    NORMAL_2,
    NORMAL_SIGN,
    NOT_FINITE,
    NQ,
    NV,
    NWORK,
    NY,
    OK,
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
    STRIBECK_SPEED,
    SUPPORT,
    SUPPORT_SIZE,
    TANGENTS,
    TAU,
    TIME_DEPENDENT,
    UNILATERAL,
    VISCOUS,
    WORK,
    V,
)
from ..memory import Memory, cube, integer_matrix, integers, matrix, reals
from .manifold import CIRCLE_BLOCK, FREE_FLYER, QUATERNION, VECTOR, normalize
from .stages import DAMPING_WORK, DRIVE_WORK, FRICTION_WORK, NUMBER_OF_WORKS, TORQUE_WORK, hand_over

# Arrays of one step, by slot of their own table; ns units, ne equations.
STEP_SLOTS = (
    "counts",  # (8,) int: see the COUNT columns
    "numbers",  # (8,): see the columns below
    "start_q",
    "start_v",
    "start_location",  # (nc, 4)
    "start_rates",  # (nc, 4)
    "start_slip",  # (nc, 3) v_c, world axes
    "start_normal",  # (nc, 2) components of v_c along n and the second normal
    "start_gap",  # (nc,)
    "start_mode",  # (nc,) int
    "trend",  # (nv,) mean acceleration of the last step
    "change",  # (nv,) v_free - v_0
    "restitution",  # (nc,)
    "sticking",  # (nc,) coefficient up to which a contact at rest sticks
    "load",  # (nc,) normal impulse over the step size in the last step of contacts whose disks depend on it, N
    "joint_int",  # (nj, 3) int: kind, index in q, index in v
    "joint_real",  # (nj, 2): limit and nothing, or half the width and the middle of the friction force's range
    "unit_int",  # (ns, UNIT_INTS) int
    "unit_real",  # (ns, UNIT_REALS)
    "whitened",  # (3 ns, nv) L^-1 rows^T, without what the equations take
    "overlap",  # (3 ns, ne) what they take
    "delassus",  # (9 ns ns,) of which the first (3 n)^2 are used
    "loads",  # (3 ns,) b of the cone problem
    "friction",  # (ns,)
    "cone_forces",  # (3 n,) of the solver
    "cone_velocities",
    "cone_modes",
    "equation_index",  # (ne, 2) int: contact and row
    "equations",  # (ne, nv) orthonormal basis of their whitened rows
    "equation_factor",  # (ne, ne) the rows in that basis
    "equation_share",  # (ne,) change of velocity in that basis
    "equation_impulse",  # (ne,)
    "contact_impulse",  # (nc, 3) along the basis, N s
    "joint_impulse",  # (nv,) of limits, dry friction, and of what resists spinning and rolling
    "touch_time",  # (nc,) s after the step's start, negative: did not touch
    "displacement",  # (nv,)
    "mean",  # (nv,) displacement over the step size
    "forces",  # (nc, 3) impulse over step size on the second contour given, world axes
    "torques",  # (nc, 3) what resists spinning and rolling, likewise
    "orientation",  # (nc,): -1 where the user named the contours the other way round
    "known",  # (nc, CONTACT_INTS + 2) int: the contact's integers and charts after the last step
)
(
    COUNTS,
    NUMBERS,
    START_Q,
    START_V,
    START_LOCATION,
    START_RATES,
    START_SLIP,
    START_NORMAL,
    START_GAP,
    START_MODE,
    TREND,
    CHANGE,
    RESTITUTION,
    STICKING,
    LOAD,
    JOINT_INT,
    JOINT_REAL,
    UNIT_INT,
    UNIT_REAL,
    WHITENED,
    OVERLAP,
    DELASSUS,
    LOADS,
    FRICTION,
    CONE_FORCES,
    CONE_VELOCITIES,
    CONE_MODES,
    EQUATION_INDEX,
    EQUATIONS,
    EQUATION_FACTOR,
    EQUATION_SHARE,
    EQUATION_IMPULSE,
    CONTACT_IMPULSE,
    JOINT_IMPULSE,
    TOUCH_TIME,
    DISPLACEMENT,
    MEAN,
    FORCES,
    TORQUES,
    ORIENTATION,
    KNOWN,
) = range(len(STEP_SLOTS))

# counts
NJ, MAX_UNITS, MAX_EQUATIONS, UNITS, NEQ, HAS_TREND, TOUCHED, REVIEWS = range(8)
# counts[HAS_TREND]: nothing, or what the velocity at the midpoint follows from
ACCELERATION, MEAN_VELOCITY = 1, 2
# numbers
H, KEPT, KEPT_LOW, KEPT_HIGH = range(4)
# joint_int
JOINT_KIND, JOINT_Q, JOINT_V = range(3)
LOWER_LIMIT, UPPER_LIMIT, DRY_FRICTION = range(3)
# unit_int; ROW_MASK: bit r is set where row r is real, the others only fill up the cone. Row r of a unit that resists
# turning is about basis vector AXIS + r; PARENT is the unit of the contact, -1 where equations give its normal impulse.
UNIT_KIND, UNIT_INDEX, ROW_MASK, TOUCHES, MIDPOINT, AT_REST, AXIS, PARENT = range(8)
UNIT_INTS = 8
ON_CONTACT, ON_LOADED, ON_JOINT, ON_TURN = range(4)
# unit_real
IMPULSE_TIME, SHIFT, APPROACH, FREE_RATE, START_T1, START_T2, UNIT_LOAD, SLIDING, DRIVEN_T1, DRIVEN_T2 = range(10)
UNIT_REALS = 10

# What `advance` returns: the step is done, or the cone problem was changed and must be solved again.
DONE, AGAIN = 0, -1

# A contact nearer than this, relative to its length, is touching.
TOUCHING = 1e-12
# A closed contact without force that would be this far apart after the step, relative to its length, opens; one at its
# limit of friction that would slide so far slips.
OPENING = 1e-12
# An equation whose rest after orthogonalisation is below this fraction is redundant.
REDUNDANT = 1e-10
# Fixed point on the normal loads of bilateral contacts: change that ends it, undamped iterations, all iterations.
LOAD_CHANGE = 1e-12
# The same for resistance to turning, whose loads come from a cone problem solved to this accuracy.
TURN_LOAD_CHANGE = 1e-10
UNDAMPED = 12
REVIEW_LIMIT = 200


def step_memory(nq: int, nv: int, nc: int, nj: int, nt: int) -> Memory:
    """The arrays of `STEP_SLOTS` for a system with nj joint limits and dry frictions, and nt resistances to turning."""
    memory = Memory(STEP_SLOTS)
    contacts, units, equations = max(nc, 1), max(nc + nj + nt, 1), max(3 * nc, 1)
    counts = memory.integers("counts", 8)
    counts[[NJ, MAX_UNITS, MAX_EQUATIONS]] = nj, units, equations
    memory.reals("numbers", 8)
    memory.reals("start_q", nq)
    for name in ("start_v", "trend", "change", "joint_impulse", "displacement", "mean"):
        memory.reals(name, max(nv, 1))
    for name in ("start_location", "start_rates"):
        memory.reals(name, contacts, 4)
    for name in ("start_slip", "contact_impulse", "forces", "torques"):
        memory.reals(name, contacts, 3)
    memory.reals("start_normal", contacts, 2)
    for name in ("start_gap", "restitution", "sticking", "load", "touch_time", "orientation"):
        memory.reals(name, contacts)
    memory.integers("start_mode", contacts)
    memory.integers("known", contacts, CONTACT_INTS + 2)
    memory.integers("joint_int", max(nj, 1), 3)
    memory.reals("joint_real", max(nj, 1), 2)
    memory.integers("unit_int", units, UNIT_INTS)
    memory.reals("unit_real", units, UNIT_REALS)
    memory.reals("whitened", 3 * units, nv)
    memory.reals("overlap", 3 * units, equations)
    memory.reals("delassus", 9 * units * units)
    for name in ("loads", "cone_forces", "cone_velocities"):
        memory.reals(name, 3 * units)
    memory.reals("friction", units)
    memory.integers("cone_modes", units)
    memory.integers("equation_index", equations, 2)
    memory.reals("equations", equations, nv)
    memory.reals("equation_factor", equations, equations)
    for name in ("equation_share", "equation_impulse"):
        memory.reals(name, equations)
    return memory


# ------------------------------------------------------------------------------------------------ configurations


@kernel
def _turn(q, i, wx, wy, wz, out):
    """out[i:i+4] = quaternion q[i:i+4] times the exponential of the rotation vector w (body axes)."""
    angle = math.sqrt(wx * wx + wy * wy + wz * wz)
    half = 0.5 * angle
    s = 0.5 * (1.0 - half * half / 6.0) if angle < 1e-4 else math.sin(half) / angle
    a, b, c, d = s * wx, s * wy, s * wz, math.cos(half)
    x, y, z, w = q[i], q[i + 1], q[i + 2], q[i + 3]
    out[i] = w * a + x * d + y * c - z * b
    out[i + 1] = w * b + y * d + z * a - x * c
    out[i + 2] = w * c + z * d + x * b - y * a
    out[i + 3] = w * d - x * a - y * b - z * c


@kernel
def displace(blocks, q, step, out):
    """out = q moved by the finite tangent step (nv,): turned by its exponential, translated in the axes half-way."""
    for b in range(blocks.shape[0]):
        kind, iq, iv, n = blocks[b, 0], blocks[b, 1], blocks[b, 2], blocks[b, 3]
        if kind == VECTOR:
            for i in range(n):
                out[iq + i] = q[iq + i] + step[iv + i]
        elif kind == FREE_FLYER:
            wx, wy, wz = step[iv + 3], step[iv + 4], step[iv + 5]
            _turn(q, iq + 3, 0.5 * wx, 0.5 * wy, 0.5 * wz, out)
            x, y, z, w = out[iq + 3], out[iq + 4], out[iq + 5], out[iq + 6]
            a, b2, c = step[iv], step[iv + 1], step[iv + 2]
            tx, ty, tz = 2.0 * (y * c - z * b2), 2.0 * (z * a - x * c), 2.0 * (x * b2 - y * a)
            out[iq] = q[iq] + a + w * tx + y * tz - z * ty
            out[iq + 1] = q[iq + 1] + b2 + w * ty + z * tx - x * tz
            out[iq + 2] = q[iq + 2] + c + w * tz + x * ty - y * tx
            _turn(q, iq + 3, wx, wy, wz, out)
        elif kind == QUATERNION:
            _turn(q, iq, step[iv], step[iv + 1], step[iv + 2], out)
        else:
            first, turn = (iq, step[iv]) if kind == CIRCLE_BLOCK else (iq + 2, step[iv + 2])
            c, s = q[first], q[first + 1]
            if kind != CIRCLE_BLOCK:
                ch, sh = math.cos(0.5 * turn), math.sin(0.5 * turn)
                cm, sm = c * ch - s * sh, s * ch + c * sh
                out[iq] = q[iq] + cm * step[iv] - sm * step[iv + 1]
                out[iq + 1] = q[iq + 1] + sm * step[iv] + cm * step[iv + 1]
            ct, st = math.cos(turn), math.sin(turn)
            out[first], out[first + 1] = c * ct - s * st, s * ct + c * st
    normalize(blocks, out, out)


@entry_kernel(TABLE, TABLE)
def predict_midpoint(table, step):
    """Hand over the midpoint's state, from the start and the last step's acceleration or this one's mean velocity."""
    sizes = integers(table[SIZES], 8)
    nq, nv, nc = sizes[NQ], sizes[NV], sizes[NC]
    counts = integers(step[COUNTS], 8)
    half = 0.5 * reals(step[NUMBERS], 8)[H]
    v, trend, mean = reals(step[START_V], nv), reals(step[TREND], nv), reals(step[MEAN], nv)
    displacement = reals(step[DISPLACEMENT], nv)
    location, rates = reals(step[START_LOCATION], 4 * nc), reals(step[START_RATES], 4 * nc)
    state = reals(table[STAGE_STATE], sizes[NY])
    for k in range(nv):
        displacement[k] = half * v[k]
        state[nq + k] = v[k]
        if counts[HAS_TREND] == ACCELERATION:
            state[nq + k] += half * trend[k]
        elif counts[HAS_TREND] == MEAN_VELOCITY:
            state[nq + k] = mean[k]
    displace(integer_matrix(table[JOINT_TABLE], sizes[NBLOCKS], 4), reals(step[START_Q], nq), displacement, state)
    for k in range(4 * nc):
        state[nq + nv + k] = location[k] + half * rates[k]
    hand_over(table, state)


# ------------------------------------------------------------------------------------------------ assembly


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
def _start_velocity(table, step, c, row, nv, nc):
    """Component of v_c along a basis row at the step's start; in steps with impacts, in the midpoint's geometry.

    There the velocities of points of a rigid body have to fit each other exactly, or no impulse could stop them all,
    and the kinetic energy has to be that of the velocities that the law is applied to.
    """
    basis = cube(table[BASIS], nc, 3, 3)
    if integers(step[COUNTS], 8)[TOUCHED] != 0:
        rows, v0, middle = cube(table[ROWS], nc, 3, nv), reals(step[START_V], nv), reals(table[V], nv)
        value = dot(basis[c, row], matrix(table[SLIP], nc, 3)[c])
        for k in range(nv):
            value += rows[c, row, k] * (v0[k] - middle[k])
        return value
    # the biases of normals hold the normal's own rate, those of tangents do not
    if row == 2:
        return matrix(step[START_NORMAL], nc, 2)[c, 0]
    if row == 1 and integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)[c, PATTERN] == ON_CURVE:
        return matrix(step[START_NORMAL], nc, 2)[c, 1]
    return dot(basis[c, row], matrix(step[START_SLIP], nc, 3)[c])


@kernel
def _free_gain(table, step, c, row, nv, nc, h):
    """What a component of v_c gains over the step if no impulse acts."""
    value = inner(cube(table[ROWS], nc, 3, nv)[c, row], reals(step[CHANGE], nv), nv)
    if integers(step[COUNTS], 8)[TOUCHED] == 0:
        value += h * matrix(table[BIAS], nc, 3)[c, row]
    return value


@kernel
def _add_equation(table, step, c, row, nv, nc, h):
    """One more equation u = 0, orthogonalised (twice, for round-off) against those before."""
    counts = integers(step[COUNTS], 8)
    size = counts[MAX_EQUATIONS]
    e = counts[NEQ]
    index = integer_matrix(step[EQUATION_INDEX], size, 2)
    equations = matrix(step[EQUATIONS], size, nv)
    factor = matrix(step[EQUATION_FACTOR], size, size)
    share = reals(step[EQUATION_SHARE], size)
    index[e, 0], index[e, 1] = c, row
    forward(matrix(table[FACTOR], nv, nv), nv, cube(table[ROWS], nc, 3, nv)[c, row], equations[e])
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
    value = -_start_velocity(table, step, c, row, nv, nc) - _free_gain(table, step, c, row, nv, nc, h)
    for j in range(e):
        value -= factor[e, j] * share[j]
    share[e] = value / rest if independent else 0.0
    counts[NEQ] = e + 1


@kernel
def _add_unit(step, kind, index, mask, mu, instant):
    """A new unit, returns its number; instant: when it closes, negative where its impulse is spread over the step."""
    counts = integers(step[COUNTS], 8)
    u = counts[UNITS]
    ints = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)[u]
    numbers = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)[u]
    ints[UNIT_KIND], ints[UNIT_INDEX], ints[ROW_MASK] = kind, index, mask
    ints[TOUCHES] = ints[MIDPOINT] = ints[AT_REST] = 0
    for i in range(UNIT_REALS):
        numbers[i] = 0.0
    numbers[IMPULSE_TIME] = 0.5 * reals(step[NUMBERS], 8)[H]
    if instant >= 0.0:
        numbers[IMPULSE_TIME] = instant
        ints[TOUCHES] = counts[TOUCHED] = 1
    reals(step[FRICTION], counts[MAX_UNITS])[u] = numbers[SLIDING] = mu
    counts[UNITS] = u + 1
    return u


@kernel
def _set_impact(numbers, start, rate, restitution, h):
    """Newton's law for a unit that closes: its rebound, less what the smooth forces take back by the step's end."""
    approach = start + numbers[IMPULSE_TIME] * rate
    numbers[APPROACH], numbers[FREE_RATE] = approach, rate
    if approach < 0.0:
        numbers[SHIFT] = max(-restitution * approach + (h - numbers[IMPULSE_TIME]) * rate, 0.0)


@kernel
def _gather_contacts(table, step, nv, nc, h):
    """Units of all contacts that take part."""
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    rows, bias = cube(table[ROWS], nc, 3, nv), matrix(table[BIAS], nc, 3)
    counts = integers(step[COUNTS], 8)
    unit_int = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)
    unit_real = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)
    friction = reals(step[FRICTION], counts[MAX_UNITS])
    start_mode = integers(step[START_MODE], nc)
    start_gap, start_normal = reals(step[START_GAP], nc), matrix(step[START_NORMAL], nc, 2)
    sticking, load, trend = reals(step[STICKING], nc), reals(step[LOAD], nc), reals(step[TREND], nv)
    basis, slip = cube(table[BASIS], nc, 3, 3), matrix(table[SLIP], nc, 3)
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
            if instant < 0.0:
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
        ints[MIDPOINT] = 1 if start_mode[c] == SLIPPING and two and 0.0 < mu < math.inf else 0


@kernel
def _gather_turns(table, step, nc, h):
    """Units that resist spinning and rolling, of the contacts that take part."""
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    counts = integers(step[COUNTS], 8)
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
def _add_turn_row(table, c, axis, nv, nc, factor, out):
    """out += factor times the row of the relative angular velocity of contact c about a basis vector."""
    jacobian, about = matrix(table[JACOBIAN], nv, 6), cube(table[BASIS], nc, 3, 3)[c, axis]
    support = integer_matrix(table[SUPPORT], 2 * nc, nv)
    side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
    for side in range(2 * c, 2 * c + 2):
        signed = factor if side % 2 == 1 else -factor
        for i in range(side_int[side, SUPPORT_SIZE]):
            k = support[side, i]
            out[k] += signed * (about[0] * jacobian[k, 3] + about[1] * jacobian[k, 4] + about[2] * jacobian[k, 5])


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


@kernel
def _gather_joints(table, step, nv, h):
    """Units of joint limits within reach and of dry friction."""
    counts = integers(step[COUNTS], 8)
    nq = integers(table[SIZES], 8)[NQ]
    nj = counts[NJ]
    joint_int, joint_real = integer_matrix(step[JOINT_INT], nj, 3), matrix(step[JOINT_REAL], nj, 2)
    unit_real = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)
    q, v, trend = reals(step[START_Q], nq), reals(step[START_V], nv), reals(step[TREND], nv)
    for j in range(nj):
        k = joint_int[j, JOINT_V]
        if joint_int[j, JOINT_KIND] == DRY_FRICTION:
            u = _add_unit(step, ON_JOINT, j, 1, 1.0, -1.0)
            unit_real[u, UNIT_LOAD] = h * joint_real[j, 0]
            continue
        sign = 1.0 if joint_int[j, JOINT_KIND] == LOWER_LIMIT else -1.0
        gap = sign * (q[joint_int[j, JOINT_Q]] - joint_real[j, 0])
        speed, rate = sign * v[k], sign * trend[k]
        resting = gap <= TOUCHING and abs(speed) * h <= TOUCHING
        instant = touch_instant(gap, speed, rate, TOUCHING, h)
        if resting or instant >= 0.0:
            _add_unit(step, ON_JOINT, j, 4, 0.0, -1.0 if resting else instant)


@kernel
def _fill_units(table, step, nv, nc, h):
    """Whitened rows, Delassus matrix and b of all units, after the equations have taken their share."""
    counts = integers(step[COUNTS], 8)
    n, units, nequations, size = counts[UNITS], counts[MAX_UNITS], counts[NEQ], counts[MAX_EQUATIONS]
    factor, rows = matrix(table[FACTOR], nv, nv), cube(table[ROWS], nc, 3, nv)
    unit_int = integer_matrix(step[UNIT_INT], units, UNIT_INTS)
    unit_real = matrix(step[UNIT_REAL], units, UNIT_REALS)
    joint_int = integer_matrix(step[JOINT_INT], counts[NJ], 3)
    whitened, overlap = matrix(step[WHITENED], 3 * units, nv), matrix(step[OVERLAP], 3 * units, size)
    equations, share = matrix(step[EQUATIONS], size, nv), reals(step[EQUATION_SHARE], size)
    delassus, b = matrix(step[DELASSUS], 3 * n, 3 * n), reals(step[LOADS], 3 * n)
    v, change, trend = reals(step[START_V], nv), reals(step[CHANGE], nv), reals(step[TREND], nv)
    restitution, middle = reals(step[RESTITUTION], nc), reals(table[V], nv)
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    for u in range(n):
        kind, index, mask = unit_int[u, UNIT_KIND], unit_int[u, UNIT_INDEX], unit_int[u, ROW_MASK]
        for row in range(3):
            r = 3 * u + row
            line = whitened[r]
            b[r] = 0.0
            if mask >> row & 1 == 0:
                for k in range(nv):
                    line[k] = 0.0
                for j in range(nequations):
                    overlap[r, j] = 0.0
                continue
            if kind == ON_JOINT:
                k = joint_int[index, JOINT_V]
                for i in range(nv):
                    line[i] = 0.0
                line[k] = -1.0 if joint_int[index, JOINT_KIND] == UPPER_LIMIT else 1.0
                start, gain = line[k] * v[k], line[k] * change[k]
            elif kind == ON_TURN:
                axis = unit_int[u, AXIS] + row
                for i in range(nv):
                    line[i] = 0.0
                _add_turn_row(table, index, axis, nv, nc, 1.0, line)
                drift = 0.5 * h * _turning(table, index, axis, ALPHA, nc)
                # what the bodies turn at the midpoint, and what drives add to it
                turned = inner(line, middle, nv)
                start = _turning(table, index, axis, OMEGA, nc)
                unit_real[u, DRIVEN_T1 + row] = turned - start
                start += inner(line, v, nv) - turned - drift
                gain = inner(line, change, nv) + 2.0 * drift
            else:
                for i in range(nv):
                    line[i] = rows[index, row, i]
                start = _start_velocity(table, step, index, row, nv, nc)
                gain = _free_gain(table, step, index, row, nv, nc, h)
            b[r] = start + gain
            if row < 2:
                unit_real[u, START_T1 + row] = start
            elif unit_int[u, TOUCHES] != 0:
                again = restitution[index] if kind != ON_JOINT else 0.0
                _set_impact(unit_real[u], start, inner(line, trend, nv), again, h)
            forward(factor, nv, line, line)
            for j in range(nequations):
                part = inner(line, equations[j], nv)
                overlap[r, j] = part
                b[r] += part * share[j]
                for k in range(nv):
                    line[k] -= part * equations[j, k]
        if kind == ON_TURN and mask == 3:
            turning = math.hypot(unit_real[u, START_T1], unit_real[u, START_T2])
            unit_int[u, MIDPOINT] = 1 if turning * h > OPENING else 0
        elif kind < ON_JOINT and contact_int[index, ANISOTROPIC] != 0:
            numbers, r = contact_real[index], 3 * u
            for k in range(nv):
                whitened[r, k], whitened[r + 1, k] = stretch_pair(numbers, whitened[r, k], whitened[r + 1, k])
            for j in range(nequations):
                overlap[r, j], overlap[r + 1, j] = stretch_pair(numbers, overlap[r, j], overlap[r + 1, j])
            b[r], b[r + 1] = stretch_pair(numbers, b[r], b[r + 1])
            values = unit_real[u]
            values[START_T1], values[START_T2] = stretch_pair(numbers, values[START_T1], values[START_T2])
    for i in range(3 * n):
        for j in range(i + 1):
            value = inner(whitened[i], whitened[j], nv)
            delassus[i, j] = value
            delassus[j, i] = value
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


@kernel
def _smooth_slip(table, step, c, row, nc, h):
    """Mean over the step of a tangential component of v_c, if v stays as it is: what viscous friction acts against."""
    along = cube(table[BASIS], nc, 3, 3)[c, row]
    return dot(along, matrix(step[START_SLIP], nc, 3)[c]) + 0.5 * h * matrix(table[BIAS], nc, 3)[c, row]


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
            slip = _smooth_slip(table, step, c, row, nc, h)
            for i in range(nv):
                change[i] -= constant * slip * line[i]
                for j in range(i + 1):
                    factor[i, j] += 0.5 * constant * line[i] * line[j]


@kernel
def _viscous_impulses(table, step, nv, nc, h, v1):
    """Add viscous impulses to those of the contacts; returns their work on v_c."""
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    rows, start_mode = cube(table[ROWS], nc, 3, nv), integers(step[START_MODE], nc)
    v0, impulse = reals(step[START_V], nv), matrix(step[CONTACT_IMPULSE], nc, 3)
    work = 0.0
    for c in range(nc):
        constant = h * contact_real[c, VISCOUS]
        if constant == 0.0 or start_mode[c] == FREE:
            continue
        for row in range(contact_int[c, TANGENTS]):
            mean = _smooth_slip(table, step, c, row, nc, h)
            for k in range(nv):
                mean += 0.5 * rows[c, row, k] * (v1[k] - v0[k])
            impulse[c, row] -= constant * mean
            work -= constant * mean * mean
    return work


@entry_kernel(TABLE, TABLE)
def assemble(table, step):
    """The cone problem of the step from the kinematics at its midpoint; OK, or a status of `layout`.

    Its size is counts[UNITS].
    """
    sizes = integers(table[SIZES], 8)
    nv, nc = sizes[NV], sizes[NC]
    counts, numbers = integers(step[COUNTS], 8), reals(step[NUMBERS], 8)
    h = numbers[H]
    counts[UNITS] = counts[NEQ] = counts[REVIEWS] = counts[TOUCHED] = 0
    numbers[KEPT], numbers[KEPT_LOW], numbers[KEPT_HIGH] = 1.0, 0.0, 1.0
    mass, factor = matrix(table[MASS], nv, nv), matrix(table[FACTOR], nv, nv)
    damping, tau, nle = reals(table[DAMPING], nv), reals(table[TAU], nv), reals(table[NLE], nv)
    v, change, trend = reals(step[START_V], nv), reals(step[CHANGE], nv), reals(step[TREND], nv)
    for i in range(nv):
        for j in range(i):
            factor[i, j] = mass[i, j]
        factor[i, i] = mass[i, i] + 0.5 * h * damping[i]
        change[i] = h * (tau[i] - nle[i] - damping[i] * v[i])
    joint_int, joint_real = integer_matrix(step[JOINT_INT], counts[NJ], 3), matrix(step[JOINT_REAL], counts[NJ], 2)
    for j in range(counts[NJ]):
        if joint_int[j, JOINT_KIND] == DRY_FRICTION:
            change[joint_int[j, JOINT_V]] += h * joint_real[j, 1]
    _add_viscous(table, step, nv, nc, h, factor, change)
    if not cholesky(factor, nv, factor):
        return MASS_NOT_POSITIVE
    forward(factor, nv, change, change)
    backward(factor, nv, change, change)
    total = 0.0
    for k in range(nv):
        total += change[k]
        if counts[HAS_TREND] == 0:
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


# ------------------------------------------------------------------------------------------------ review


@kernel
def _equation_impulses(step, nv):
    """Impulses of the equations that go with the cones' forces: R^T P = share - overlap^T F."""
    counts = integers(step[COUNTS], 8)
    n, nequations, size = counts[UNITS], counts[NEQ], counts[MAX_EQUATIONS]
    forces = reals(step[CONE_FORCES], 3 * n)
    overlap, factor = matrix(step[OVERLAP], 3 * counts[MAX_UNITS], size), matrix(step[EQUATION_FACTOR], size, size)
    share, impulse = reals(step[EQUATION_SHARE], size), reals(step[EQUATION_IMPULSE], size)
    for e in range(nequations - 1, -1, -1):
        value = share[e]
        for r in range(3 * n):
            value -= overlap[r, e] * forces[r]
        for j in range(e + 1, nequations):
            value -= factor[j, e] * impulse[j]
        impulse[e] = value / factor[e, e] if factor[e, e] > 0.0 else 0.0


@kernel
def _normal_load(step, c, lowest):
    """Length of the normal impulse that the equations give contact c; its normals are the rows from the lowest on."""
    counts = integers(step[COUNTS], 8)
    index = integer_matrix(step[EQUATION_INDEX], counts[MAX_EQUATIONS], 2)
    impulse = reals(step[EQUATION_IMPULSE], counts[MAX_EQUATIONS])
    total = 0.0
    for e in range(counts[NEQ]):
        if index[e, 0] == c and index[e, 1] >= lowest:
            total += impulse[e] * impulse[e]
    return math.sqrt(total)


@kernel
def _impulse_work(step, h):
    """Work of the contacts' impulses on v_c, of the joints' units, and the sum of the sizes of all terms.

    An impulse times the mean of the velocities at the step's ends, or right before and after an impact. Impulses of
    equations do no work on v_c.
    """
    counts, kept = integers(step[COUNTS], 8), reals(step[NUMBERS], 8)[KEPT]
    n = counts[UNITS]
    unit_int = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)
    unit_real = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)
    forces, velocities = reals(step[CONE_FORCES], 3 * n), reals(step[CONE_VELOCITIES], 3 * n)
    on_contacts, on_joints, size = 0.0, 0.0, 0.0
    for u in range(n):
        ints, numbers = unit_int[u], unit_real[u]
        work = 0.0
        for row in range(2):
            if ints[ROW_MASK] >> row & 1 != 0:
                mean = velocities[3 * u + row]
                if ints[MIDPOINT] == 0:
                    mean += numbers[START_T1 + row]
                work += 0.5 * forces[3 * u + row] * mean
        size += abs(work)
        if ints[TOUCHES] != 0:
            after = velocities[3 * u + 2] + kept * numbers[SHIFT]
            if numbers[SHIFT] > 0.0:
                after -= (h - numbers[IMPULSE_TIME]) * numbers[FREE_RATE]
            work += 0.5 * forces[3 * u + 2] * (numbers[APPROACH] + after)
            size += 0.5 * forces[3 * u + 2] * (abs(numbers[APPROACH]) + abs(after))
        if ints[UNIT_KIND] == ON_JOINT:
            on_joints += work
        else:
            on_contacts += work
    return on_contacts, on_joints, size


@kernel
def _review(step, nv, h):
    """Whether the solution stands; if not, b or the coefficients are changed and the problem is to be solved again.

    Slip is opposed along the mean of its velocities at both ends only while it goes on; a contact at rest that starts
    to slip does so with the sliding coefficient; bilateral loads are a fixed point; and restitution is lowered where,
    together with friction, it would create energy (Newton's law does that when contacts are coupled).
    """
    counts, numbers = integers(step[COUNTS], 8), reals(step[NUMBERS], 8)
    n = counts[UNITS]
    unit_int = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)
    unit_real = matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS)
    forces, velocities = reals(step[CONE_FORCES], 3 * n), reals(step[CONE_VELOCITIES], 3 * n)
    modes, friction = integers(step[CONE_MODES], n), reals(step[FRICTION], n)
    b, delassus = reals(step[LOADS], 3 * n), matrix(step[DELASSUS], 3 * n, 3 * n)
    counts[REVIEWS] += 1
    again = False
    bounces = False
    for u in range(n):
        ints, values = unit_int[u], unit_real[u]
        if ints[MIDPOINT] != 0:
            first, second = values[START_T1], values[START_T2]
            onward = (velocities[3 * u] - first) * first + (velocities[3 * u + 1] - second) * second
            if modes[u] == cone.STICK or onward <= 0.0:
                b[3 * u] -= first
                b[3 * u + 1] -= second
                ints[MIDPOINT] = 0
                again = True
        if ints[AT_REST] != 0 and modes[u] == cone.SLIP:
            friction[u] = values[SLIDING]
            ints[AT_REST] = 0
            again = True
        if ints[UNIT_KIND] == ON_LOADED or ints[UNIT_KIND] == ON_TURN:
            turns = ints[UNIT_KIND] == ON_TURN
            if turns and ints[PARENT] >= 0:
                load = forces[3 * ints[PARENT] + 2]
            else:
                # what turns has one normal, and where it must not slip further equations; others have normals only
                load = _normal_load(step, ints[UNIT_INDEX], 2 if turns else 0)
            before = values[UNIT_LOAD]
            if abs(load - before) > (TURN_LOAD_CHANGE if turns else LOAD_CHANGE) * (load + before):
                values[UNIT_LOAD] = load if counts[REVIEWS] <= UNDAMPED else 0.5 * (load + before)
                b[3 * u + 2] = -delassus[3 * u + 2, 3 * u + 2] * values[UNIT_LOAD]
                again = True
        if ints[TOUCHES] != 0 and values[SHIFT] > 0.0 and forces[3 * u + 2] > 0.0:
            bounces = True
    if again:
        return AGAIN if counts[REVIEWS] < REVIEW_LIMIT else NO_FORCE
    if not bounces:
        return DONE
    # bisection for the largest part of the restitution that creates no energy; 0 never does
    on_contacts, on_joints, size = _impulse_work(step, h)
    creates = on_contacts + on_joints > ENERGY_SLACK * size
    if not creates and (numbers[KEPT] == 1.0 or numbers[KEPT_HIGH] - numbers[KEPT_LOW] < KEPT_ACCURACY):
        return DONE
    kept = numbers[KEPT]
    if creates:
        numbers[KEPT_HIGH] = kept
    else:
        numbers[KEPT_LOW] = kept
    if numbers[KEPT_HIGH] - numbers[KEPT_LOW] < KEPT_ACCURACY:
        numbers[KEPT] = numbers[KEPT_LOW]
        if kept == numbers[KEPT]:
            return DONE
    else:
        numbers[KEPT] = 0.5 * (numbers[KEPT_LOW] + numbers[KEPT_HIGH])
    for u in range(n):
        b[3 * u + 2] += (kept - numbers[KEPT]) * unit_real[u, SHIFT]
    return AGAIN if counts[REVIEWS] < REVIEW_LIMIT else NO_FORCE


# ------------------------------------------------------------------------------------------------ carrying out


@kernel
def _contact_mode(table, step, u, c, nc, h):
    """Mode of contact c after the step, from the solution of its unit u; notes when it touched."""
    counts = integers(step[COUNTS], 8)
    n, kept = counts[UNITS], reals(step[NUMBERS], 8)[KEPT]
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
    if cone_mode == cone.OPEN:
        if ints[TOUCHES] != 0:
            return FREE
        return FREE if velocities[3 * u + 2] * h > opening else rest
    if ints[TOUCHES] != 0:
        reals(step[TOUCH_TIME], nc)[c] = values[IMPULSE_TIME]
        counts[TOUCHED] = 1
        if kept * values[SHIFT] > 0.0:
            return FREE
    # among redundant contacts one may be at its limit of friction without sliding
    if mu == 0.0 or cone_mode == cone.STICK or math.hypot(first, second) * h <= opening:
        return rest
    return SLIPPING


@kernel
def _distribute(table, step, nv, nc, h):
    """Impulses of contacts and joints, new modes; in WORK the change of velocity by all impulses, whitened, and in
    DISPLACEMENT what they displace by acting before or after the middle of the step."""
    counts = integers(step[COUNTS], 8)
    n, units, nequations, size = counts[UNITS], counts[MAX_UNITS], counts[NEQ], counts[MAX_EQUATIONS]
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    unit_int = integer_matrix(step[UNIT_INT], units, UNIT_INTS)
    unit_real = matrix(step[UNIT_REAL], units, UNIT_REALS)
    joint_int = integer_matrix(step[JOINT_INT], counts[NJ], 3)
    forces, whitened = reals(step[CONE_FORCES], 3 * n), matrix(step[WHITENED], 3 * units, nv)
    equations, share = matrix(step[EQUATIONS], size, nv), reals(step[EQUATION_SHARE], size)
    index, equation_impulse = integer_matrix(step[EQUATION_INDEX], size, 2), reals(step[EQUATION_IMPULSE], size)
    impulse, joint_impulse = matrix(step[CONTACT_IMPULSE], nc, 3), reals(step[JOINT_IMPULSE], nv)
    touch_time = reals(step[TOUCH_TIME], nc)
    load = reals(step[LOAD], nc)
    basis, torques, orientation = (
        cube(table[BASIS], nc, 3, 3),
        matrix(step[TORQUES], nc, 3),
        reals(step[ORIENTATION], nc),
    )
    whole, shifted = reals(table[WORK], nv), reals(step[DISPLACEMENT], nv)
    for k in range(nv):
        whole[k] = shifted[k] = joint_impulse[k] = 0.0
    for c in range(nc):
        touch_time[c] = -1.0
        for row in range(3):
            impulse[c, row] = torques[c, row] = 0.0
        if contact_int[c, UNILATERAL] != 0:
            contact_int[c, MODE] = FREE
        else:
            contact_int[c, MODE] = STICK if contact_real[c, MU] == math.inf else FRICTIONLESS
    counts[TOUCHED] = 0
    for j in range(counts[NJ]):
        if joint_int[j, JOINT_KIND] == DRY_FRICTION:
            joint_impulse[joint_int[j, JOINT_V]] += h * matrix(step[JOINT_REAL], counts[NJ], 2)[j, 1]
    for e in range(nequations):
        for k in range(nv):
            whole[k] += share[e] * equations[e, k]
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
            for k in range(nv):
                whole[k] += forces[r] * whitened[r, k]
                shifted[k] += early * forces[r] * whitened[r, k]
            if kind == ON_TURN:
                axis = unit_int[u, AXIS] + row
                _add_turn_row(table, i, axis, nv, nc, forces[r], joint_impulse)
                for j in range(3):
                    torques[i, j] += orientation[i] * forces[r] * basis[i, axis, j] / h
            elif kind == ON_JOINT:
                sign = -1.0 if joint_int[i, JOINT_KIND] == UPPER_LIMIT else 1.0
                joint_impulse[joint_int[i, JOINT_V]] += sign * forces[r]
                if unit_int[u, TOUCHES] != 0 and forces[r] > 0.0:
                    counts[TOUCHED] = 1
        if kind < ON_JOINT:
            contact_int[i, MODE] = _contact_mode(table, step, u, i, nc, h)
    for c in range(nc):
        normal, second = impulse[c, 2], impulse[c, 1]
        if contact_int[c, UNILATERAL] == 0 or contact_real[c, SPINNING] > 0.0 or contact_real[c, ROLLING] > 0.0:
            load[c] = abs(normal) / h
            if contact_int[c, PATTERN] == ON_CURVE:
                length = math.hypot(normal, second)
                load[c] = length / h
                if length > 0.0:
                    contact_real[c, NORMAL_1], contact_real[c, NORMAL_2] = normal / length, second / length
            elif normal != 0.0:
                contact_int[c, NORMAL_SIGN] = 1 if normal > 0.0 else -1


@kernel
def _add_works(table, step, nv, nc, h, v1, viscous, works):
    """Works over the step, with that of viscous friction; what drives do is what impulses do on the joints less what
    they do on v_c."""
    slip, basis = matrix(step[START_SLIP], nc, 3), cube(table[BASIS], nc, 3, 3)
    rows, bias = cube(table[ROWS], nc, 3, nv), matrix(table[BIAS], nc, 3)
    impulse = matrix(step[CONTACT_IMPULSE], nc, 3)
    v0, tau, damping = reals(step[START_V], nv), reals(table[TAU], nv), reals(table[DAMPING], nv)
    on_contacts, on_joints, _ = _impulse_work(step, h)
    works[FRICTION_WORK] += on_contacts + viscous
    works[DAMPING_WORK] += on_joints
    side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
    for c in range(nc):
        is_driven = False
        for side in range(2 * c, 2 * c + 2):
            is_driven = is_driven or side_int[side, MOTION_KIND] != 0 or side_int[side, TIME_DEPENDENT] != 0
        for row in range(3 if is_driven else 0):
            driven = -dot(basis[c, row], slip[c]) - 0.5 * h * bias[c, row]
            for k in range(nv):
                driven += rows[c, row, k] * v0[k]
            works[DRIVE_WORK] += impulse[c, row] * driven
    counts = integers(step[COUNTS], 8)
    unit_int = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)
    unit_real, forces = (
        matrix(step[UNIT_REAL], counts[MAX_UNITS], UNIT_REALS),
        reals(step[CONE_FORCES], 3 * counts[UNITS]),
    )
    for u in range(counts[UNITS]):
        if unit_int[u, UNIT_KIND] == ON_TURN:
            for row in range(2):
                works[DRIVE_WORK] += forces[3 * u + row] * unit_real[u, DRIVEN_T1 + row]
    for k in range(nv):
        mean = 0.5 * (v0[k] + v1[k])
        works[TORQUE_WORK] += h * tau[k] * mean
        works[DAMPING_WORK] -= h * damping[k] * mean * mean


@entry_kernel(TABLE, TABLE)
def advance(table, step):
    """Review the cone problem's solution and carry out the step: state, modes, impulses; hands over its end.

    Returns DONE, AGAIN (solve the changed problem first) or a status of `layout`.
    """
    sizes = integers(table[SIZES], 8)
    nq, nv, nc = sizes[NQ], sizes[NV], sizes[NC]
    counts, h = integers(step[COUNTS], 8), reals(step[NUMBERS], 8)[H]
    _equation_impulses(step, nv)
    verdict = _review(step, nv, h)
    if verdict != DONE:
        return verdict
    _distribute(table, step, nv, nc, h)
    factor, change = matrix(table[FACTOR], nv, nv), reals(step[CHANGE], nv)
    gained, displacement, mean = reals(table[WORK], nv), reals(step[DISPLACEMENT], nv), reals(step[MEAN], nv)
    backward(factor, nv, gained, gained)
    backward(factor, nv, displacement, displacement)
    start_q, start_v, state = reals(step[START_Q], nq), reals(step[START_V], nv), reals(table[STAGE_STATE], sizes[NY])
    v1 = state[nq : nq + nv]
    total = 0.0
    for k in range(nv):
        v1[k] = start_v[k] + change[k] + gained[k]
        displacement[k] += 0.5 * h * (start_v[k] + v1[k])
        mean[k] = displacement[k] / h
        total += v1[k]
    if total - total != 0.0:
        return NOT_FINITE
    viscous = _viscous_impulses(table, step, nv, nc, h, v1)
    displace(integer_matrix(table[JOINT_TABLE], sizes[NBLOCKS], 4), start_q, displacement, state)
    unit_int = integer_matrix(step[UNIT_INT], counts[MAX_UNITS], UNIT_INTS)
    joint_int, joint_real = integer_matrix(step[JOINT_INT], counts[NJ], 3), matrix(step[JOINT_REAL], counts[NJ], 2)
    forces = reals(step[CONE_FORCES], 3 * counts[UNITS])
    for u in range(counts[UNITS]):
        if unit_int[u, UNIT_KIND] == ON_JOINT and unit_int[u, ROW_MASK] == 4 and forces[3 * u + 2] > 0.0:
            j = unit_int[u, UNIT_INDEX]
            state[joint_int[j, JOINT_Q]] = joint_real[j, 0]
    location, rates = reals(table[LOCATION], 4 * nc), reals(table[RATES], 4 * nc)
    for k in range(4 * nc):
        state[nq + nv + k] = location[k] + 0.5 * h * rates[k]
    if sizes[NWORK] > 0:
        start, works = reals(table[STATE], sizes[NY])[nq + nv + 4 * nc :], state[nq + nv + 4 * nc :]
        for i in range(NUMBER_OF_WORKS):
            works[i] = start[i]
        _add_works(table, step, nv, nc, h, v1, viscous, works)
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


@entry_kernel(TABLE, TABLE, INTEGER)
def commit(table, step, stepped):
    """Make STAGE_STATE the next step's start, with the kinematics of its evaluation, moved on by the last corrections.

    stepped: 0 for the first state of a run, which has no corrections and no step behind it.
    Returns whether anything discrete (modes, signs, charts) is not what it was before.
    """
    sizes = integers(table[SIZES], 8)
    nq, nv, nc = sizes[NQ], sizes[NV], sizes[NC]
    counts, h = integers(step[COUNTS], 8), reals(step[NUMBERS], 8)[H]
    stage, state = reals(table[STAGE_STATE], sizes[NY]), reals(table[STATE], sizes[NY])
    start_q, start_v, trend = reals(step[START_Q], nq), reals(step[START_V], nv), reals(step[TREND], nv)
    correction_q, correction_v = reals(table[CORRECTION_Q], nv), reals(table[CORRECTION_V], nv)
    for i in range(sizes[NY]):
        state[i] = stage[i]
    for i in range(nq):
        start_q[i] = stage[i]
    counts[HAS_TREND] = ACCELERATION if stepped != 0 and counts[TOUCHED] == 0 else 0
    for k in range(nv):
        if stepped != 0:
            trend[k] = (stage[nq + k] - start_v[k]) / h
        start_v[k] = stage[nq + k]
    basis, rows = cube(table[BASIS], nc, 3, 3), cube(table[ROWS], nc, 3, nv)
    slip, gaps = matrix(table[SLIP], nc, 3), matrix(table[GAPS], nc, 2)
    location, rates = matrix(table[LOCATION], nc, 4), matrix(table[RATES], nc, 4)
    start_location, start_rates = matrix(step[START_LOCATION], nc, 4), matrix(step[START_RATES], nc, 4)
    start_slip, start_normal = matrix(step[START_SLIP], nc, 3), matrix(step[START_NORMAL], nc, 2)
    start_gap, start_mode = reals(step[START_GAP], nc), integers(step[START_MODE], nc)
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
    known = integer_matrix(step[KNOWN], nc, CONTACT_INTS + 2)
    changed = stepped == 0
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
        start_normal[c, 0], start_normal[c, 1] = dot(basis[c, 2], start_slip[c]), dot(basis[c, 1], start_slip[c])
        for i in range(CONTACT_INTS):
            changed = changed or known[c, i] != contact_int[c, i]
            known[c, i] = contact_int[c, i]
        for i in range(2):
            chart = side_int[2 * c + i, CHART]
            changed = changed or known[c, CONTACT_INTS + i] != chart
            known[c, CONTACT_INTS + i] = chart
    return changed
