"""One evaluation: from Pinocchio's terms at (q, v) to accelerations, contact forces and location rates.

Pinocchio's terms come from its own algorithms on the same data, see `pinocchio_calls`; no other work is done for
a contact that is open than its location and gap.
"""

from __future__ import annotations

import math

from ..arrays import address as address_in
from ..callback import call_by_address, call_python
from ..constraints.kinematics import add_point_rows, contact_kinematics, distance_to_ends
from ..contours.motion import call_motion
from ..friction.ellipse import set_stretch
from ..geometry.carriers import add_drive, place_on_joint
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import INTEGER, REAL, entry_kernel, kernel
from ..layout import (
    ALONG_BODY_1,
    ANISOTROPIC,
    CHART,
    DOMAIN,
    EVENT,
    FREE,
    GUARD_END,
    GUARD_Q,
    GUARD_V,
    HIGH_END,
    JOINT,
    K1,
    K2,
    LOW_END,
    MARGINS_PER_CONTACT,
    MASS_NOT_POSITIVE,
    MODE,
    MOTION_EVALUATOR,
    MOTION_KIND,
    MOTION_POOL,
    MOTION_POOL_SIZE,
    NOT_FINITE,
    NOTHING_THERE,
    OK,
    PATTERN,
    SUPPORT_SIZE,
    TIME_DEPENDENT,
    system_at,
)
from ..workspace import integer_matrix_at, integers_at, matrix_at, reals_at
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
def evaluate_state(address, time, only_kinematics):
    """Pinocchio's terms and one evaluation at (q, v); a status of `layout`.

    only_kinematics: KINEMATICS_OF_ALL for locations, rows and biases of all contacts, open ones too, and no forces;
    PLACES_OF_ALL for the same without biases, and Pinocchio's mass matrix and bias forces left as they are;
    PLACES_OF_CLOSED for those of closed contacts; VELOCITIES_OF_ALL as KINEMATICS_OF_ALL, where q is that of the last
    evaluation, which was one of these; 0 for everything.
    """
    system = system_at(address)
    counters, callback = system.counters, system.callback
    system.scalars.time = time
    asked = callback.asked
    if asked != 0:
        if not call_python(asked, callback.asked_with, callback.call_failed):
            return NOT_FINITE
        if not torques_finite(system, time):
            return NOT_FINITE
    places = only_kinematics in (PLACES_OF_CLOSED, PLACES_OF_ALL)
    # C++ would throw at a model that has got another size since, and nothing here catches that; Python's calls raise
    known = callback.native != 0
    if known:
        words = integers_at(callback.model, 2)
        known = words[0] == callback.model_size and words[1] == callback.model_joints
    if known:
        native = integer_matrix_at(callback.native, NATIVE_ROWS, NATIVE_COLUMNS)
        end = 3 if places else 2
        if only_kinematics == VELOCITIES_OF_ALL:
            # all but the mass matrix, the Jacobians and the poses
            end = 1
        for i in range(2 if places else 0, end):
            call = native[i]
            call_by_address(call[0], call[1], call[2], call[3], call[4], call[5])
    else:
        first, given = (callback.placed, callback.placed_with) if places else (callback.called, callback.called_with)
        if not call_python(first, given, callback.call_failed):
            return NOT_FINITE
        follows = 0 if places else callback.called_next
        if follows != 0 and not call_python(follows, callback.called_next_with, callback.call_failed):
            return NOT_FINITE
    counters.evaluation_count += 1
    with_rows = only_kinematics in (KINEMATICS_OF_ALL, PLACES_OF_ALL, VELOCITIES_OF_ALL)
    status = evaluate_contacts(system, time, with_rows, not places)
    if status != OK or only_kinematics != 0:
        return status
    return evaluate_dynamics(system, time)


@kernel
def torques_finite(system, time):
    """Whether the user's torques are numbers to go on with; else the first that is not is noted."""
    nv = system.sizes.nv
    tau, scalars = system.tau, system.scalars
    for k in range(nv):
        if not abs(tau[k]) < math.inf:
            scalars.bad_torque, scalars.bad_time = tau[k], time
            return False
    return True


@kernel
def evaluate_contacts(system, time, with_rows, with_bias):
    """Kinematics of all contacts at the guess in LOCATION; with_rows: constraint rows also where no force may act;
    with_bias: what accelerations of v_c have besides the rows.

    Returns the first status that is not OK.
    """
    sizes = system.sizes
    nv, nc = sizes.nv, sizes.nc
    side_int = system.side_int
    side_shape = system.side_shape
    side_base = system.side_base
    side_domain = system.side_domain
    frames = system.frames
    derivatives = system.derivatives
    contact_int = system.contact_int
    contact_real = system.contact_real
    vectors = system.vectors
    scratch = (vectors, system.local, system.location_system)
    addresses = system.joint_addresses
    gravity = system.gravity
    location = system.location
    basis = system.basis
    slip = system.slip
    gaps = system.gaps
    rates = system.rates
    bias = system.bias
    rows = system.rows
    jacobian = system.jacobian
    support = system.support
    total = count_items(system)
    counters = system.counters
    for c in range(nc):
        for side in range(2 * c, 2 * c + 2):
            ints = side_int[side]
            joint = ints[JOINT]
            if joint != 0:
                place_on_joint(
                    side_base[side],
                    matrix_at(addresses[joint, 0], 3, 3),
                    reals_at(addresses[joint, 1], 3),
                    reals_at(addresses[joint, 2], 6),
                    reals_at(addresses[joint, 3], 6),
                    gravity,
                    frames[side],
                    vectors,
                )
            if ints[MOTION_KIND] != 0 or ints[TIME_DEPENDENT] != 0:
                counters.drives_evaluated += 1
            if ints[MOTION_KIND] != 0:
                drive_side(system, side, nc, ints, side_base[side], frames[side], time, vectors)
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
        counters.rows_formed += 1
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
            resistance_kinematics(system, c, total)
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
def drive_side(system, side, nc, ints, base, frame, time, vectors):
    """Add a driven placement to a side's frame; a world-fixed side starts from its base pose at rest."""
    motion = system.side_motion[side]
    if ints[JOINT] == 0:
        for i in range(3):
            for j in range(3):
                frame[i, j] = base[3 * i + j]
            frame[3, i] = base[9 + i]
        for row in range(4, 8):
            for i in range(3):
                frame[row, i] = 0.0
    parameters = system.side_motion_parameters[side]
    call_motion(
        ints[MOTION_EVALUATOR],
        ints[MOTION_KIND],
        address_in(parameters),
        ints[MOTION_POOL],
        ints[MOTION_POOL_SIZE],
        time,
        address_in(motion),
    )
    add_drive(motion, frame, vectors)


@kernel
def evaluate_dynamics(system, time):
    """Factor the mass matrix, then accelerations, forces and margins in the present modes."""
    sizes = system.sizes
    nv, nc = sizes.nv, sizes.nc
    factor = system.factor
    parents = system.parents
    if not factorize_tree(system.mass, parents, nv, factor):
        return MASS_NOT_POSITIVE
    nle, tau, damping, v = (
        system.nle,
        system.tau,
        system.damping,
        system.v,
    )
    free_acceleration = system.free_acceleration
    acceleration = system.acceleration
    for k in range(nv):
        free_acceleration[k] = tau[k] - damping[k] * v[k] - nle[k]
    add_viscous_loads(
        nv,
        nc,
        system.contact_int,
        system.contact_real,
        system.basis,
        system.slip,
        system.rows,
        free_acceleration,
    )
    ng, total = system.guard_count[0], count_items(system)
    contact_int = system.contact_int
    guard_int = system.guard_int
    guard_real = system.guard_real
    slip, gaps = system.slip, system.gaps
    _read_guards(system, guard_int, nc, ng, slip, gaps)
    for g in range(ng):
        k = guard_int[g, GUARD_V]
        free_acceleration[k] += guard_force(contact_int[nc + g, MODE], guard_int[g], guard_real[g])
    whiten(factor, parents, nv, free_acceleration, free_acceleration)
    unwhiten(factor, parents, nv, free_acceleration, free_acceleration)
    if nc + ng == 0:
        for k in range(nv):
            acceleration[k] = free_acceleration[k]
        return OK if _finite(acceleration, nv) else NOT_FINITE
    margins = system.margins
    scalars = system.scalars
    status = contact_dynamics(
        nv,
        nc,
        contact_int,
        system.contact_real,
        slip,
        system.basis,
        gaps,
        system.rows,
        system.bias,
        factor,
        parents,
        free_acceleration,
        acceleration,
        system.row_index,
        system.whitened_rows,
        system.whitened_forces,
        system.delassus,
        system.multipliers,
        system.permutation,
        system.constraint_rows,
        system.force,
        system.relative_acceleration,
        margins,
        system.work,
        time,
        system.vectors[0],
        ng,
        total,
        guard_int,
        guard_real,
        system.reference,
        system.reference_start,
        system.reference_rate,
        system.reference_slope,
        scalars.has_reference != 0.0,
        scalars.reference_moves != 0.0,
        scalars.reference_time,
        system.counters,
    )
    if status > EVENT:
        # neither accelerations nor margins were written
        return status if _finite(free_acceleration, nv) else NOT_FINITE
    lowest, highest = (
        system.lowest,
        system.highest,
    )
    for c in range(total):
        for i in range(MARGINS_PER_CONTACT):
            lowest[c, i] = min(lowest[c, i], margins[c, i])
            highest[c, i] = max(highest[c, i], margins[c, i])
    return status if _finite(acceleration, nv) else NOT_FINITE


@kernel
def _read_guards(system, guard_int, nc, ng, slip, gaps):
    """Velocities and positions of guarded joint coordinates, in the places of normal v_c and gaps."""
    q, v = system.q, system.v
    for g in range(ng):
        slip[nc + g, 2], gaps[nc + g, 0] = v[guard_int[g, GUARD_V]], q[guard_int[g, GUARD_Q]]


@kernel
def _finite(a, n):
    total = 0.0
    for k in range(n):
        total += a[k]
    return total - total == 0.0


@kernel
def contact_corrections(system, with_position, with_velocity):
    """Corrections of q and v in the mass metric from the last evaluation (its rows, gaps, v_c and factor of M).

    Position: gaps of closed contacts to zero. Velocity: normal components of v_c, and tangential ones in stick.
    The least change in the norm of M: -M^-1 R^T (R M^-1 R^T)^+ residual.
    """
    sizes = system.sizes
    nv, nc = sizes.nv, sizes.nc
    scalars = system.scalars
    factor = system.factor
    ng, total = system.guard_count[0], count_items(system)
    contact_int = system.contact_int
    guard_int = system.guard_int
    guard_real = system.guard_real
    basis = system.basis
    slip = system.slip
    gaps = system.gaps
    rows = system.rows
    row_index = system.row_index
    whitened = system.whitened_rows
    correction_q = system.correction_q
    correction_v = system.correction_v
    x = system.multipliers
    free_with_owners(contact_int, nc + ng, total)
    count, _ = list_rows(contact_int, total, row_index)
    # an evaluation of kinematics alone has left them out
    _read_guards(system, guard_int, nc, ng, slip, gaps)
    for g in range(ng):
        # what is left to the end on which the coordinate rests; where it is held by friction it rests anywhere
        position, end = gaps[nc + g, 0], guard_int[g, GUARD_END]
        gaps[nc + g, 0] = 0.0
        if end != 0:
            gaps[nc + g, 0] = position - guard_real[g, LOW_END if end < 0 else HIGH_END]
    parents = system.parents
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
    scalars.gap_residual = gap_residual
    scalars.velocity_residual = velocity_residual
    scalars.velocity_left = 0.0
    if with_velocity != 0:
        rank = _least_correction(system, count, correction_v)
        if rank < count:
            # redundant: whether they can be met together is another question
            for r in range(count):
                c, row = row_index[r, 0], row_index[r, 1]
                left = inner(rows[c, row], correction_v, nv) + dot(basis[c, row], slip[c])
                scalars.velocity_left = max(scalars.velocity_left, abs(left))
    if with_position != 0:
        for r in range(count):
            c, row = row_index[r, 0], row_index[r, 1]
            if is_normal_row(contact_int[c, PATTERN], row):
                for k in range(nv):
                    whitened[normals, k] = whitened[r, k]
                x[normals] = -gaps[c, 2 - row]
                normals += 1
        _least_correction(system, normals, correction_q)
    largest = 0.0
    for k in range(nv):
        largest = max(largest, abs(correction_q[k]))
    scalars.correction_size = largest
    return count


@kernel
def is_normal_row(pattern, row):
    return row == 2 or (row == 1 and pattern == ON_CURVE)


@kernel
def _least_correction(system, count, out):
    """out = M^-1 R^T (R M^-1 R^T)^+ x from the whitened rows; returns their rank."""
    nv, whitened, x, factor = system.sizes.nv, system.whitened_rows, system.multipliers, system.factor
    rank = solve_gram(
        whitened,
        count,
        nv,
        system.delassus,
        system.permutation,
        x,
        system.constraint_rows,
    )
    for k in range(nv):
        value = 0.0
        for r in range(count):
            value += whitened[r, k] * x[r]
        out[k] = value
    unwhiten(factor, system.parents, nv, out, out)
    return rank
