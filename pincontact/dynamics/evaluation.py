"""One evaluation: from Pinocchio's terms at (q, v) to accelerations, contact forces and location rates.

Pinocchio's terms come from its own algorithms on the same data, see `pinocchio_calls`; no other work is done for
a contact that is open than its location and gap.
"""

from __future__ import annotations

import math

from ..callback import call_by_address, call_python
from ..constraints.kinematics import add_point_rows, contact_kinematics, distance_to_ends
from ..contours.base import SHAPE_SIZE
from ..contours.motion import MOTION_PARAMETERS, MOTION_SIZE, evaluate_motion
from ..friction.ellipse import set_stretch
from ..geometry.carriers import add_drive, place_on_joint
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import INTEGER, REAL, entry_kernel, kernel
from ..layout import (
    ACCELERATION,
    ALONG_BODY_1,
    ANISOTROPIC,
    ASKED,
    ASKED_WITH,
    BAD_TIME,
    BAD_TORQUE,
    BASIS,
    BIAS,
    CALL_FAILED,
    CALLBACK,
    CALLBACK_SIZE,
    CALLED,
    CHART,
    CONSTRAINT_ROWS,
    CONTACT_INT,
    CONTACT_INTS,
    CONTACT_REAL,
    CONTACT_REALS,
    CORRECTION_Q,
    CORRECTION_SIZE,
    CORRECTION_V,
    COUNTERS,
    COUNTERS_SIZE,
    DAMPING,
    DELASSUS,
    DERIVATIVES,
    DOMAIN,
    DRIVES_EVALUATED,
    EVALUATION_COUNT,
    EVENT,
    FACTOR,
    FORCE,
    FRAMES,
    FREE,
    FREE_ACCELERATION,
    GAP_RESIDUAL,
    GAPS,
    GRAVITY,
    GUARD_COUNT,
    GUARD_END,
    GUARD_INT,
    GUARD_INTS,
    GUARD_Q,
    GUARD_REAL,
    GUARD_REALS,
    GUARD_V,
    HAS_REFERENCE,
    HIGH_END,
    HIGHEST,
    JACOBIAN,
    JOINT,
    JOINT_ADDRESSES,
    K1,
    K2,
    LOCAL,
    LOCATION,
    LOW_END,
    LOWEST,
    MARGINS,
    MARGINS_PER_CONTACT,
    MASS,
    MASS_NOT_POSITIVE,
    MODE,
    MODEL,
    MODEL_JOINTS,
    MODEL_SIZE,
    MOTION_KIND,
    MOTION_POOL,
    MOTION_POOL_SIZE,
    MULTIPLIERS,
    NATIVE,
    NC,
    NJOINTS,
    NLE,
    NOT_FINITE,
    NOTHING_THERE,
    NQ,
    NV,
    OK,
    PARENTS,
    PATTERN,
    PERMUTATION,
    PLACED,
    RATES,
    REFERENCE,
    REFERENCE_MOVES,
    REFERENCE_RATE,
    REFERENCE_SLOPE,
    REFERENCE_START,
    REFERENCE_TIME,
    RELATIVE_ACCELERATION,
    ROW_INDEX,
    ROWS,
    ROWS_FORMED,
    SCALARS,
    SCALARS_SIZE,
    SIDE_BASE,
    SIDE_DOMAIN,
    SIDE_INT,
    SIDE_INTS,
    SIDE_MOTION,
    SIDE_MOTION_PARAMETERS,
    SIDE_SHAPE,
    SIZES,
    SLIP,
    SUPPORT,
    SUPPORT_SIZE,
    SYSTEM,
    TABLE_SIZE,
    TAU,
    TIME,
    TIME_DEPENDENT,
    VECTORS,
    VELOCITY_LEFT,
    VELOCITY_RESIDUAL,
    WHITENED_FORCES,
    WHITENED_ROWS,
    WORK,
    Q,
    V,
)
from ..memory import cube, integer_matrix, integers, matrix, reals
from .equations import add_viscous_loads, contact_dynamics, guard_force, list_rows, whiten_rows
from .linear import factorize_tree, inner, solve_gram, unwhiten, whiten
from .pinocchio_calls import NATIVE_COLUMNS, NATIVE_ROWS
from .resistance import count_items, free_with_owners, resistance_kinematics, resists

# What an evaluation may be confined to.
KINEMATICS_OF_ALL, PLACES_OF_CLOSED, PLACES_OF_ALL, VELOCITIES_OF_ALL = 1, 2, 3, 4
# Rows with a larger entry are not looked at; others are round-off where they are below this part of their terms.
_SMALL_ROW = 1e-9
_ROW_ROUND_OFF = 1e-13


@entry_kernel(INTEGER, REAL, INTEGER)
def evaluate_state(table_address, time, only_kinematics):
    """Pinocchio's terms and one evaluation at (q, v); a status of `layout`.

    only_kinematics: KINEMATICS_OF_ALL for locations, rows and biases of all contacts, open ones too, and no forces;
    PLACES_OF_ALL for the same without biases, and Pinocchio's mass matrix and bias forces left as they are;
    PLACES_OF_CLOSED for those of closed contacts; VELOCITIES_OF_ALL as KINEMATICS_OF_ALL, where q is that of the last
    evaluation, which was one of these; 0 for everything.
    """
    table = integers(table_address, TABLE_SIZE)
    counters, callback = integers(table[COUNTERS], COUNTERS_SIZE), integers(table[CALLBACK], CALLBACK_SIZE)
    reals(table[SCALARS], SCALARS_SIZE)[TIME] = time
    asked = callback[ASKED]
    if asked != 0:
        if not call_python(asked, callback[ASKED_WITH], callback[CALL_FAILED]):
            return NOT_FINITE
        if not torques_finite(table, time):
            return NOT_FINITE
    places = only_kinematics in (PLACES_OF_CLOSED, PLACES_OF_ALL)
    # C++ would throw at a model that has got another size since, and nothing here catches that; Python's calls raise
    known = callback[NATIVE] != 0
    if known:
        words = integers(callback[MODEL], 2)
        known = words[0] == callback[MODEL_SIZE] and words[1] == callback[MODEL_JOINTS]
    if known:
        native = integer_matrix(callback[NATIVE], NATIVE_ROWS, NATIVE_COLUMNS)
        end = 3 if places else 2
        if only_kinematics == VELOCITIES_OF_ALL:
            # all but the mass matrix, the Jacobians and the poses
            end = 1
        for i in range(2 if places else 0, end):
            call = native[i]
            call_by_address(call[0], call[1], call[2], call[3], call[4], call[5])
    else:
        for i in range(PLACED if places else CALLED, PLACED + 2 if places else CALLED + 4, 2):
            called = callback[i]
            if called != 0 and not call_python(called, callback[i + 1], callback[CALL_FAILED]):
                return NOT_FINITE
    counters[EVALUATION_COUNT] += 1
    with_rows = only_kinematics in (KINEMATICS_OF_ALL, PLACES_OF_ALL, VELOCITIES_OF_ALL)
    status = evaluate_contacts(table, time, with_rows, not places)
    if status != OK or only_kinematics != 0:
        return status
    return evaluate_dynamics(table, time)


@kernel
def torques_finite(table, time):
    """Whether the user's torques are numbers to go on with; else the first that is not is noted."""
    nv = integers(table[SIZES], 8)[NV]
    tau, scalars = reals(table[TAU], nv), reals(table[SCALARS], SCALARS_SIZE)
    for k in range(nv):
        if not abs(tau[k]) < math.inf:
            scalars[BAD_TORQUE], scalars[BAD_TIME] = tau[k], time
            return False
    return True


@kernel
def evaluate_contacts(table, time, with_rows, with_bias):
    """Kinematics of all contacts at the guess in LOCATION; with_rows: constraint rows also where no force may act;
    with_bias: what accelerations of v_c have besides the rows.

    Returns the first status that is not OK.
    """
    sizes = integers(table[SIZES], 8)
    nv, nc = sizes[NV], sizes[NC]
    side_int = integer_matrix(table[SIDE_INT], 2 * nc, SIDE_INTS)
    side_shape = matrix(table[SIDE_SHAPE], 2 * nc, SHAPE_SIZE)
    side_base = matrix(table[SIDE_BASE], 2 * nc, 12)
    side_domain = matrix(table[SIDE_DOMAIN], 2 * nc, 4)
    frames = cube(table[FRAMES], 2 * nc, 8, 3)
    derivatives = cube(table[DERIVATIVES], 2 * nc, 10, 3)
    contact_int = integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS)
    contact_real = matrix(table[CONTACT_REAL], nc, CONTACT_REALS)
    vectors = matrix(table[VECTORS], 16, 3)
    scratch = (vectors, matrix(table[LOCAL], 10, 3), matrix(table[SYSTEM], 4, 8))
    addresses = integer_matrix(table[JOINT_ADDRESSES], sizes[NJOINTS], 4)
    gravity = reals(table[GRAVITY], 3)
    location = matrix(table[LOCATION], nc, 4)
    basis = cube(table[BASIS], nc, 3, 3)
    slip = matrix(table[SLIP], nc, 3)
    gaps = matrix(table[GAPS], nc, 2)
    rates = matrix(table[RATES], nc, 4)
    bias = matrix(table[BIAS], nc, 3)
    rows = cube(table[ROWS], nc, 3, nv)
    jacobian = matrix(table[JACOBIAN], nv, 6)
    support = integer_matrix(table[SUPPORT], 2 * nc, nv)
    total = count_items(table)
    counters = integers(table[COUNTERS], COUNTERS_SIZE)
    for c in range(nc):
        for side in range(2 * c, 2 * c + 2):
            ints = side_int[side]
            joint = ints[JOINT]
            if joint != 0:
                place_on_joint(
                    side_base[side],
                    matrix(addresses[joint, 0], 3, 3),
                    reals(addresses[joint, 1], 3),
                    reals(addresses[joint, 2], 6),
                    reals(addresses[joint, 3], 6),
                    gravity,
                    frames[side],
                    vectors,
                )
            if ints[MOTION_KIND] != 0 or ints[TIME_DEPENDENT] != 0:
                counters[DRIVES_EVALUATED] += 1
            if ints[MOTION_KIND] != 0:
                drive_side(table, side, nc, ints, side_base[side], frames[side], time, vectors)
        one, two = 2 * c, 2 * c + 1
        u = location[c]
        start1, start2, start3, start4 = u[0], u[1], u[2], u[3]
        status = contact_kinematics(
            contact_int[c],
            contact_real[c],
            side_int[one],
            side_int[two],
            side_shape[one],
            side_shape[two],
            frames[one],
            frames[two],
            derivatives[one],
            derivatives[two],
            location[c],
            time,
            basis[c],
            slip[c],
            gaps[c],
            rates[c],
            bias[c],
            with_bias,
            scratch,
            counters,
        )
        if status != OK:
            if contact_int[c, MODE] == FREE:
                # an open contact without a nearest point (parallel lines, a focus) is beyond all ends for the moment
                contact_real[c, DOMAIN] = -1.0
                u[0], u[1], u[2], u[3] = start1, start2, start3, start4
                gaps[c, 0] = NOTHING_THERE
                for a in range(4):
                    rates[c, a] = 0.0
                for row in range(3):
                    slip[c, row] = bias[c, row] = 0.0
                    for k in range(nv):
                        rows[c, row, k] = 0.0
                continue
            return status
        distance = distance_to_ends(
            contact_int[c, K1], location[c, 0:2], side_int[one, CHART], side_domain[one], math.inf
        )
        contact_real[c, DOMAIN] = distance_to_ends(
            contact_int[c, K2], location[c, 2:4], side_int[two, CHART], side_domain[two], distance
        )
        if not with_rows and contact_int[c, MODE] == FREE:
            continue
        counters[ROWS_FORMED] += 1
        if contact_int[c, ANISOTROPIC] == ALONG_BODY_1:
            tangent = derivatives[one, 1]
            set_stretch(contact_real[c], dot(basis[c, 0], tangent), dot(basis[c, 1], tangent))
        for row in range(3):
            for k in range(nv):
                rows[c, row, k] = 0.0
        for side in range(one, two + 1):
            if side_int[side, SUPPORT_SIZE] > 0:
                add_point_rows(
                    1.0 if side == two else -1.0,
                    jacobian,
                    support[side],
                    side_int[side, SUPPORT_SIZE],
                    frames[side],
                    derivatives[side, 0],
                    basis[c],
                    rows[c],
                    vectors,
                )
        for row in range(3):
            _drop_round_off(rows[c, row], nv, one, jacobian, support, side_int, frames, derivatives)
        if resists(contact_int[c]):
            resistance_kinematics(table, c, total)
    return OK


@kernel
def _drop_round_off(row, nv, one, jacobian, support, side_int, frames, derivatives):
    """Zero a row (nv,) of which nothing is left but round-off: no joint moves the contact along it.

    Each entry is the sum of what one joint moves both bodies by; the row is held against the largest term.
    """
    largest = 0.0
    for k in range(nv):
        if abs(row[k]) > _SMALL_ROW:
            return
        largest = max(largest, abs(row[k]))
    size = 0.0
    for side in range(one, one + 2):
        reach = 0.0
        for i in range(3):
            reach = max(reach, max(abs(frames[side, 3, i]), abs(derivatives[side, 0, i])))
        for index in range(side_int[side, SUPPORT_SIZE]):
            for i in range(3):
                entry = jacobian[support[side, index]]
                size = max(size, max(abs(entry[i]), reach * abs(entry[3 + i])))
    if largest <= _ROW_ROUND_OFF * size:
        for k in range(nv):
            row[k] = 0.0


@kernel
def drive_side(table, side, nc, ints, base, frame, time, vectors):
    """Add a driven placement to a side's frame; a world-fixed side starts from its base pose at rest."""
    motion = matrix(table[SIDE_MOTION], 2 * nc, MOTION_SIZE)[side]
    if ints[JOINT] == 0:
        for i in range(3):
            for j in range(3):
                frame[i, j] = base[3 * i + j]
            frame[3, i] = base[9 + i]
        for row in range(4, 8):
            for i in range(3):
                frame[row, i] = 0.0
    parameters = matrix(table[SIDE_MOTION_PARAMETERS], 2 * nc, MOTION_PARAMETERS)[side]
    pool = reals(ints[MOTION_POOL], ints[MOTION_POOL_SIZE])
    evaluate_motion(ints[MOTION_KIND], parameters, pool, time, motion)
    add_drive(motion, frame, vectors)


@kernel
def evaluate_dynamics(table, time):
    """Factor the mass matrix, then accelerations, forces and margins in the present modes."""
    sizes = integers(table[SIZES], 8)
    nv, nc = sizes[NV], sizes[NC]
    factor = matrix(table[FACTOR], nv, nv)
    parents = integers(table[PARENTS], nv)
    if not factorize_tree(matrix(table[MASS], nv, nv), parents, nv, factor):
        return MASS_NOT_POSITIVE
    nle, tau, damping, v = (
        reals(table[NLE], nv),
        reals(table[TAU], nv),
        reals(table[DAMPING], nv),
        reals(table[V], nv),
    )
    free_acceleration = reals(table[FREE_ACCELERATION], nv)
    acceleration = reals(table[ACCELERATION], nv)
    for k in range(nv):
        free_acceleration[k] = tau[k] - damping[k] * v[k] - nle[k]
    add_viscous_loads(
        nv,
        nc,
        integer_matrix(table[CONTACT_INT], nc, CONTACT_INTS),
        matrix(table[CONTACT_REAL], nc, CONTACT_REALS),
        cube(table[BASIS], nc, 3, 3),
        matrix(table[SLIP], nc, 3),
        cube(table[ROWS], nc, 3, nv),
        free_acceleration,
    )
    ng, total = integers(table[GUARD_COUNT], 1)[0], count_items(table)
    contact_int = integer_matrix(table[CONTACT_INT], total, CONTACT_INTS)
    guard_int = integer_matrix(table[GUARD_INT], ng, GUARD_INTS)
    guard_real = matrix(table[GUARD_REAL], ng, GUARD_REALS)
    slip, gaps = matrix(table[SLIP], total, 3), matrix(table[GAPS], total, 2)
    _read_guards(table, guard_int, nc, ng, slip, gaps)
    for g in range(ng):
        k = guard_int[g, GUARD_V]
        free_acceleration[k] += guard_force(contact_int[nc + g, MODE], guard_int[g], guard_real[g])
    whiten(factor, parents, nv, free_acceleration, free_acceleration)
    unwhiten(factor, parents, nv, free_acceleration, free_acceleration)
    if nc + ng == 0:
        for k in range(nv):
            acceleration[k] = free_acceleration[k]
        return OK if _finite(acceleration, nv) else NOT_FINITE
    margins = matrix(table[MARGINS], total, MARGINS_PER_CONTACT)
    scalars = reals(table[SCALARS], SCALARS_SIZE)
    status = contact_dynamics(
        nv,
        nc,
        contact_int,
        matrix(table[CONTACT_REAL], total, CONTACT_REALS),
        slip,
        cube(table[BASIS], total, 3, 3),
        gaps,
        cube(table[ROWS], total, 3, nv),
        matrix(table[BIAS], total, 3),
        factor,
        parents,
        free_acceleration,
        acceleration,
        integer_matrix(table[ROW_INDEX], 3 * total, 2),
        matrix(table[WHITENED_ROWS], 3 * total, nv),
        matrix(table[WHITENED_FORCES], 3 * total, nv),
        matrix(table[DELASSUS], 3 * total, 3 * total + 1),
        reals(table[MULTIPLIERS], 3 * total),
        integers(table[PERMUTATION], 3 * total),
        matrix(table[CONSTRAINT_ROWS], 3 * total, 3 * total + 1),
        matrix(table[FORCE], total, 3),
        matrix(table[RELATIVE_ACCELERATION], total, 3),
        margins,
        reals(table[WORK], nv),
        time,
        reals(table[VECTORS], 3),
        ng,
        total,
        guard_int,
        guard_real,
        matrix(table[REFERENCE], total, 3),
        matrix(table[REFERENCE_START], total, 3),
        matrix(table[REFERENCE_RATE], total, 3),
        cube(table[REFERENCE_SLOPE], 2, 3 * total, nv),
        scalars[HAS_REFERENCE] != 0.0,
        scalars[REFERENCE_MOVES] != 0.0,
        scalars[REFERENCE_TIME],
        integers(table[COUNTERS], COUNTERS_SIZE),
    )
    if status > EVENT:
        # neither accelerations nor margins were written
        return status if _finite(free_acceleration, nv) else NOT_FINITE
    lowest, highest = (
        matrix(table[LOWEST], total, MARGINS_PER_CONTACT),
        matrix(table[HIGHEST], total, MARGINS_PER_CONTACT),
    )
    for c in range(total):
        for i in range(MARGINS_PER_CONTACT):
            lowest[c, i] = min(lowest[c, i], margins[c, i])
            highest[c, i] = max(highest[c, i], margins[c, i])
    return status if _finite(acceleration, nv) else NOT_FINITE


@kernel
def _read_guards(table, guard_int, nc, ng, slip, gaps):
    """Velocities and positions of guarded joint coordinates, in the places of normal v_c and gaps."""
    sizes = integers(table[SIZES], 8)
    q, v = reals(table[Q], sizes[NQ]), reals(table[V], sizes[NV])
    for g in range(ng):
        slip[nc + g, 2], gaps[nc + g, 0] = v[guard_int[g, GUARD_V]], q[guard_int[g, GUARD_Q]]


@kernel
def _finite(a, n):
    total = 0.0
    for k in range(n):
        total += a[k]
    return total - total == 0.0


@kernel
def contact_corrections(table, with_position, with_velocity):
    """Corrections of q and v in the mass metric from the last evaluation (its rows, gaps, v_c and factor of M).

    Position: gaps of closed contacts to zero. Velocity: normal components of v_c, and tangential ones in stick.
    The least change in the norm of M: -M^-1 R^T (R M^-1 R^T)^+ residual.
    """
    sizes = integers(table[SIZES], 8)
    nv, nc = sizes[NV], sizes[NC]
    scalars = reals(table[SCALARS], SCALARS_SIZE)
    factor = matrix(table[FACTOR], nv, nv)
    ng, total = integers(table[GUARD_COUNT], 1)[0], count_items(table)
    contact_int = integer_matrix(table[CONTACT_INT], total, CONTACT_INTS)
    guard_int = integer_matrix(table[GUARD_INT], ng, GUARD_INTS)
    guard_real = matrix(table[GUARD_REAL], ng, GUARD_REALS)
    basis = cube(table[BASIS], total, 3, 3)
    slip = matrix(table[SLIP], total, 3)
    gaps = matrix(table[GAPS], total, 2)
    rows = cube(table[ROWS], total, 3, nv)
    row_index = integer_matrix(table[ROW_INDEX], 3 * total, 2)
    whitened = matrix(table[WHITENED_ROWS], 3 * total, nv)
    correction_q = reals(table[CORRECTION_Q], nv)
    correction_v = reals(table[CORRECTION_V], nv)
    x = reals(table[MULTIPLIERS], 3 * total)
    free_with_owners(contact_int, nc + ng, total)
    count, _ = list_rows(contact_int, total, row_index)
    # an evaluation of kinematics alone has left them out
    _read_guards(table, guard_int, nc, ng, slip, gaps)
    for g in range(ng):
        # what is left to the end on which the coordinate rests; where it is held by friction it rests anywhere
        position, end = gaps[nc + g, 0], guard_int[g, GUARD_END]
        gaps[nc + g, 0] = 0.0
        if end != 0:
            gaps[nc + g, 0] = position - guard_real[g, LOW_END if end < 0 else HIGH_END]
    parents = integers(table[PARENTS], nv)
    whiten_rows(factor, parents, nv, rows, row_index, count, whitened)
    gap_residual = 0.0
    velocity_residual = 0.0
    # positions: normal rows only, which are moved to the front of the list
    normals = 0
    for r in range(count):
        c, row = row_index[r, 0], row_index[r, 1]
        residual = basis[c, row, 0] * slip[c, 0] + basis[c, row, 1] * slip[c, 1] + basis[c, row, 2] * slip[c, 2]
        velocity_residual = max(velocity_residual, abs(residual))
        x[r] = -residual
        if is_normal_row(contact_int[c, PATTERN], row):
            gap_residual = max(gap_residual, abs(gaps[c, 2 - row]))
    scalars[GAP_RESIDUAL] = gap_residual
    scalars[VELOCITY_RESIDUAL] = velocity_residual
    scalars[VELOCITY_LEFT] = 0.0
    if with_velocity != 0:
        rank = _least_correction(table, total, nv, count, whitened, x, factor, correction_v)
        if rank < count:
            # redundant: whether they can be met together is another question
            for r in range(count):
                c, row = row_index[r, 0], row_index[r, 1]
                left = inner(rows[c, row], correction_v, nv) + dot(basis[c, row], slip[c])
                scalars[VELOCITY_LEFT] = max(scalars[VELOCITY_LEFT], abs(left))
    if with_position != 0:
        for r in range(count):
            c, row = row_index[r, 0], row_index[r, 1]
            if is_normal_row(contact_int[c, PATTERN], row):
                for k in range(nv):
                    whitened[normals, k] = whitened[r, k]
                x[normals] = -gaps[c, 2 - row]
                normals += 1
        _least_correction(table, total, nv, normals, whitened, x, factor, correction_q)
    largest = 0.0
    for k in range(nv):
        largest = max(largest, abs(correction_q[k]))
    scalars[CORRECTION_SIZE] = largest
    return count


@kernel
def is_normal_row(pattern, row):
    return row == 2 or (row == 1 and pattern == ON_CURVE)


@kernel
def _least_correction(table, nc, nv, count, whitened, x, factor, out):
    """out = M^-1 R^T (R M^-1 R^T)^+ x from the whitened rows; returns their rank."""
    rank = solve_gram(
        whitened,
        count,
        nv,
        matrix(table[DELASSUS], 3 * nc, 3 * nc + 1),
        integers(table[PERMUTATION], 3 * nc),
        x,
        matrix(table[CONSTRAINT_ROWS], 3 * nc, 3 * nc + 1),
    )
    for k in range(nv):
        value = 0.0
        for r in range(count):
            value += whitened[r, k] * x[r]
        out[k] = value
    unwhiten(factor, integers(table[PARENTS], nv), nv, out, out)
    return rank
