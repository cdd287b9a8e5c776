"""The states of a Runge-Kutta step: handed to Pinocchio, made from slopes, corrected, moved to other charts.

State: y = (q, w, location parameters, quadratures). q is ambient; w is v in the axes of the joints' parents (see
`manifold`) where the counter PARENT_AXES is set, as it is for the pairs, and v itself elsewhere. The location
parameters ride along as the start of Newton's iteration and take part in the error norm; the quadratures are the powers
of friction, drive, torque and damping when energies are recorded.
"""

from __future__ import annotations

import math

from ..contours.base import SHAPE_SIZE
from ..contours.charts import convert_chart, is_across_pole, preferred_chart, turned_back
from ..dynamics.equations import guard_force
from ..dynamics.resistance import count_items
from ..geometry.small import dot
from ..jit import TABLE, entry_kernel, kernel
from ..layout import (
    ABSOLUTE,
    ACCELERATION,
    BASIS,
    CHART,
    CHARTED,
    COEFFICIENTS,
    CONTACT_INT,
    CONTACT_INTS,
    CORRECTION_Q,
    CORRECTION_V,
    COUNTERS,
    COUNTERS_SIZE,
    DAMPING,
    FORCE,
    FREE,
    GUARD_COUNT,
    GUARD_INT,
    GUARD_INTS,
    GUARD_REAL,
    GUARD_REALS,
    GUARD_V,
    JOINT_TABLE,
    KIND,
    LOCATION,
    MODE,
    NBLOCKS,
    NC,
    NEW_STATE,
    NQ,
    NSTAGES,
    NV,
    NWORK,
    NY,
    PARENT_AXES,
    POOL_ADDRESS,
    POOL_SIZE,
    RATES,
    ROWS,
    SCALARS,
    SCALARS_SIZE,
    SCALE,
    SIDE_INT,
    SIDE_INTS,
    SIDE_SHAPE,
    SIZES,
    SLIP,
    SLOPES,
    STAGE_STATE,
    STATE,
    STEP,
    STICK,
    TAU,
    WEIGHTS_ERROR,
    Q,
    V,
)
from ..memory import cube, integer_matrix, integers, matrix, reals
from .manifold import configuration_rate, move, normalize, rate_in_parent_axes, to_joint_axes, to_parent_axes

# Rows of the coefficient table and of the slopes: 16 for stages and the interpolant, the last one for scratch.
MAX_STAGES = 17
# Rows of the error weights: two estimates of the state's error, the rest for margins (see `resolution`).
ERROR_ROWS = 14
FRICTION_WORK, DRIVE_WORK, TORQUE_WORK, DAMPING_WORK = range(4)
NUMBER_OF_WORKS = 4


@kernel
def hand_over(table, state):
    """Give a state to Pinocchio (normalised) and to the location solver."""
    sizes = integers(table[SIZES], 8)
    nq, nv, nc = sizes[NQ], sizes[NV], sizes[NC]
    q, v, blocks = reals(table[Q], nq), reals(table[V], nv), integer_matrix(table[JOINT_TABLE], sizes[NBLOCKS], 4)
    normalize(blocks, state, q)
    if integers(table[COUNTERS], COUNTERS_SIZE)[PARENT_AXES] != 0:
        to_joint_axes(blocks, q, state[nq : nq + nv], v)
    else:
        for k in range(nv):
            v[k] = state[nq + k]
    location, u = reals(table[LOCATION], 4 * nc), state[nq + nv : nq + nv + 4 * nc]
    if integers(table[COUNTERS], COUNTERS_SIZE)[CHARTED] == 0:
        for k in range(4 * nc):
            location[k] = u[k]
        return
    side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
    side_shape = matrix(table[SIDE_SHAPE], 2 * nc, SHAPE_SIZE)
    for side in range(2 * nc):
        kind, chart, i = side_int[side, KIND], side_int[side, CHART], 2 * side
        # within a long step parameters run on over a pole of their chart
        location[i], location[i + 1] = turned_back(kind, chart, side_shape[side], u[i], u[i + 1])


@kernel
def fill_slope(table, state, slope):
    """y' from the last evaluation."""
    sizes = integers(table[SIZES], 8)
    nq, nv, nc = sizes[NQ], sizes[NV], sizes[NC]
    q, v, blocks = reals(table[Q], nq), reals(table[V], nv), integer_matrix(table[JOINT_TABLE], sizes[NBLOCKS], 4)
    configuration_rate(blocks, state, q, v, slope)
    acceleration = reals(table[ACCELERATION], nv)
    if integers(table[COUNTERS], COUNTERS_SIZE)[PARENT_AXES] != 0:
        rate_in_parent_axes(blocks, q, v, acceleration, slope[nq : nq + nv])
    else:
        for k in range(nv):
            slope[nq + k] = acceleration[k]
    rates, u, out = reals(table[RATES], 4 * nc), state[nq + nv :], slope[nq + nv :]
    for k in range(4 * nc):
        out[k] = rates[k]
    if integers(table[COUNTERS], COUNTERS_SIZE)[CHARTED] != 0:
        side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
        side_shape = matrix(table[SIDE_SHAPE], 2 * nc, SHAPE_SIZE)
        for side in range(2 * nc):
            i = 2 * side + 1
            if is_across_pole(side_int[side, KIND], side_int[side, CHART], side_shape[side], u[i]):
                out[i] = -rates[i]
    if sizes[NWORK] > 0:
        _powers(table, nv, nc, slope[nq + nv + 4 * nc :])


@kernel
def _powers(table, nv, nc, out):
    """Powers in W: contact force on v_c, contact force of drives, user's torques, joints' damping and dry friction.

    Torques that resist turning count with the contact forces.
    """
    n, ng = count_items(table), integers(table[GUARD_COUNT], 1)[0]
    contact_int = integer_matrix(table[CONTACT_INT], n, CONTACT_INTS)
    basis = cube(table[BASIS], n, 3, 3)
    slip = matrix(table[SLIP], n, 3)
    force = matrix(table[FORCE], n, 3)
    rows = cube(table[ROWS], n, 3, nv)
    v, tau, damping = reals(table[V], nv), reals(table[TAU], nv), reals(table[DAMPING], nv)
    for i in range(NUMBER_OF_WORKS):
        out[i] = 0.0
    for c in range(n):
        if contact_int[c, MODE] == FREE or nc <= c < nc + ng:
            continue
        for row in range(3):
            on_slip = force[c, row] * dot(basis[c, row], slip[c])
            on_joints = 0.0
            for k in range(nv):
                on_joints += rows[c, row, k] * v[k]
            if row < 2 and contact_int[c, MODE] != STICK:
                # what is held does no work; its small v_c within a step would only feed the error estimate
                out[FRICTION_WORK] += on_slip
            out[DRIVE_WORK] += force[c, row] * on_joints - on_slip
    guard_int = integer_matrix(table[GUARD_INT], ng, GUARD_INTS)
    for g in range(ng):
        dry = guard_force(contact_int[nc + g, MODE], guard_int[g], matrix(table[GUARD_REAL], ng, GUARD_REALS)[g])
        out[DAMPING_WORK] += dry * v[guard_int[g, GUARD_V]]
    for k in range(nv):
        out[TORQUE_WORK] += tau[k] * v[k]
        out[DAMPING_WORK] -= damping[k] * v[k] * v[k]


@kernel
def build_state(table, index):
    """State number `index` of the step: y + h sum_j a_ij k_j; index = number of stages gives the new state."""
    sizes = integers(table[SIZES], 8)
    ny = sizes[NY]
    state, out = reals(table[STATE], ny), reals(table[STAGE_STATE], ny)
    slopes = matrix(table[SLOPES], MAX_STAGES, ny)
    weights = matrix(table[COEFFICIENTS], MAX_STAGES, MAX_STAGES)[index]
    scalars = reals(table[SCALARS], SCALARS_SIZE)
    step = scalars[STEP]
    for i in range(ny):
        out[i] = 0.0
    for j in range(index):
        weight = weights[j]
        if weight != 0.0:
            slope = slopes[j]
            for i in range(ny):
                out[i] += weight * slope[i]
    for i in range(ny):
        out[i] = state[i] + step * out[i]
    if index == sizes[NSTAGES]:
        new_state = reals(table[NEW_STATE], ny)
        for i in range(ny):
            new_state[i] = out[i]
    hand_over(table, out)


@kernel
def error_norm(table, last):
    """Norm of the step's error estimate, 1 at the tolerance; stages 0 .. last are known.

    Two estimates are blended as for DOP853 (Hairer, Norsett, Wanner, Sec. II.10); a pair with a single one has zero
    weights in the second.
    """
    sizes = integers(table[SIZES], 8)
    ny = sizes[NY]
    state, new_state = reals(table[STATE], ny), reals(table[NEW_STATE], ny)
    slopes = matrix(table[SLOPES], MAX_STAGES, ny)
    weights = matrix(table[WEIGHTS_ERROR], ERROR_ROWS, MAX_STAGES)
    absolute = reals(table[ABSOLUTE], ny)
    relative = reals(table[SCALE], 1)[0]
    first, second = 0.0, 0.0
    count = 0
    for i in range(ny):
        if absolute[i] == 0.0:
            continue
        count += 1
        a, b = 0.0, 0.0
        for j in range(last + 1):
            a += weights[0, j] * slopes[j, i]
            b += weights[1, j] * slopes[j, i]
        scale = absolute[i] + relative * max(abs(state[i]), abs(new_state[i]))
        first += (a / scale) ** 2
        second += (b / scale) ** 2
    step = abs(reals(table[SCALARS], SCALARS_SIZE)[STEP])
    if first == 0.0:
        return 0.0
    return step * first / math.sqrt((first + 0.01 * second) * count)


@entry_kernel(TABLE)
def load_state(table):
    """Hand over STAGE_STATE to Pinocchio and the location solver."""
    hand_over(table, reals(table[STAGE_STATE], integers(table[SIZES], 8)[NY]))


@kernel
def correct_state(table, with_position, with_velocity):
    """Apply the last corrections to STAGE_STATE: v first (its rows belong to the old q), then q; take the location
    found, moved along with q. Returns the largest change of q and v in tolerances.
    """
    sizes = integers(table[SIZES], 8)
    nq, nv, nc = sizes[NQ], sizes[NV], sizes[NC]
    state = reals(table[STAGE_STATE], sizes[NY])
    absolute, relative = reals(table[ABSOLUTE], sizes[NY]), reals(table[SCALE], 2)[0]
    change = 0.0
    location = reals(table[LOCATION], 4 * nc)
    for k in range(4 * nc):
        state[nq + nv + k] = location[k]
    q, v = reals(table[Q], nq), reals(table[V], nv)
    if with_velocity != 0:
        correction = reals(table[CORRECTION_V], nv)
        for k in range(nv):
            change = max(change, abs(correction[k]) / (absolute[nq + k] + relative * abs(v[k])))
            v[k] += correction[k]
    if with_position != 0:
        moved = matrix(table[SLOPES], MAX_STAGES, sizes[NY])[MAX_STAGES - 1]
        move(
            integer_matrix(table[JOINT_TABLE], sizes[NBLOCKS], 4),
            q,
            reals(table[CORRECTION_Q], nv),
            moved,
            q,
        )
        for i in range(nq):
            change = max(change, abs(moved[i]) / (absolute[i] + relative * abs(state[i])))
    for i in range(nq):
        state[i] = q[i]
    if with_position != 0 or with_velocity != 0:
        keep_velocity(table, state)
    return change


@kernel
def keep_velocity(table, state):
    """The velocity that Pinocchio has becomes that of the state, whose configuration it has, too."""
    sizes = integers(table[SIZES], 8)
    nq, nv = sizes[NQ], sizes[NV]
    v, out = reals(table[V], nv), state[nq : nq + nv]
    if integers(table[COUNTERS], COUNTERS_SIZE)[PARENT_AXES] != 0:
        to_parent_axes(integer_matrix(table[JOINT_TABLE], sizes[NBLOCKS], 4), reals(table[Q], nq), v, out)
    else:
        for k in range(nv):
            out[k] = v[k]


@kernel
def change_charts(table):
    """Move the location parameters in STATE to better charts; returns how many contours changed theirs."""
    sizes = integers(table[SIZES], 8)
    nc, first = sizes[NC], sizes[NQ] + sizes[NV]
    state = reals(table[STATE], sizes[NY])
    side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
    side_shape = matrix(table[SIDE_SHAPE], 2 * nc, SHAPE_SIZE)
    changed = 0
    for side in range(2 * nc):
        ints = side_int[side]
        u = state[first + 2 * side : first + 2 * side + 2]
        chart = preferred_chart(ints[KIND], ints[CHART], side_shape[side], u[0], u[1])
        if chart != ints[CHART]:
            pool = reals(ints[POOL_ADDRESS], ints[POOL_SIZE])
            u[0], u[1] = convert_chart(ints[KIND], side_shape[side], pool, ints[CHART], u[0], u[1], chart)
            ints[CHART] = chart
            changed += 1
    return changed


@entry_kernel(TABLE)
def move_charts(table):
    """`change_charts` for callers in Python."""
    return change_charts(table)
