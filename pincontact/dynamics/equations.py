"""Accelerations and contact forces of one state in given modes (Eqs. 29, 31, 34).

M a = tau - damping v - nle + sum over contacts of rows^T F, with the rows of the normal always constrained, the
tangential ones in stick, and F_t = -mu |F_n| w_t / |w_t| in slip, which makes the operator unsymmetric:
J_n M^-1 (J_n - mu d J_t)^T. Friction of two directions has A^2 w_t / |A w_t| there (see `friction.ellipse`), viscous
friction is one of the loads.

`contact_dynamics` is the row of steps. It reads an evaluation's kinematics (`rows`, `bias`, `basis`, `slip`, `gaps`),
the factor of M, `free_acceleration`, and the modes; it writes `row_index`, `whitened_rows`, `multipliers`, `force`,
`acceleration` and `event_functions`. Row r of the constraints is row `row_index[r, 1]` of item `row_index[r, 0]`;
multiplier r scales the force direction r, whitened: L^-T of both makes products by M^-1 dot products.
"""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..friction.cone import COMMON_LIMIT
from ..friction.ellipse import friction_direction
from ..geometry.patterns import NO_NORMAL, ON_CURVE
from ..jit import BOOLEAN, INTEGER, inlined_kernel, kernel
from ..layout import (
    FREE,
    HIGH_FORCE,
    JOINT_SIGN,
    JOINT_V,
    LOW_FORCE,
    MODE,
    MU,
    MU_NOW,
    NO_FORCE,
    NORMAL_1,
    NORMAL_2,
    NORMAL_SIGN,
    OWNER,
    PATTERN,
    SLIP_SPEED,
    SLIPPING,
    STICK,
    SYSTEM,
    TANGENTS,
    UNILATERAL,
)
from ..linalg import (
    NEXT_TO_REDUNDANT,
    RANK_TOLERANCE,
    inner,
    least_norm,
    solve_factored,
    solve_gram,
    unwhiten,
    whiten,
    whiten_rows,
)
from .event_functions import (
    contact_event_functions,
    jam_event_functions,
    joint_event_functions,
    resistance_event_functions,
)
from .least_forces import count_unloaded, leave_unloaded, solve_for_least, unloaded_event_functions
from .positivity import CONTACT_LOST, NOTHING_LOST, is_plane, loses_positivity, slides_on_curve
from .resistance import count_items, free_with_owners
from .sliding import coefficient_at, is_held_up, resists_viscously, shares_viscous_force, slip_direction, viscous_force

# Friction on a point of a spatial curve depends on the length of a two-component normal force: fixed point, quadratic.
_NORMAL_ITERATIONS = 50
_NORMAL_CHANGE = 1e-15
# What is left of a change where it has been found, but for round-off of the forces.
_NORMAL_FOUND = 1e-6
# Accelerations that contact forces cancel down to this part are zero, so that what is held does not creep by round-off
# times the square of a step.
_CANCELLED = 4e-15


@separate_kernel(INTEGER, SYSTEM.type)
def contact_dynamics(system):
    """Accelerations, forces on body 2 along each basis, and the event functions of the present modes.

    Returns OK, EVENT (an event function is negative) or NO_FORCE, which leaves accelerations, forces and event
    functions as they were.
    """
    count, slipping = list_constraints(system)
    counters = system.counters
    counters.row_count, counters.row_rank, counters.lost_positivity = count, 0, 0
    if slipping:
        if not solve_slipping(system, count):
            return NO_FORCE
        accelerate(system, count, system.whitened_forces)
    else:
        solve_sticking(system, count)
        accelerate(system, count, system.whitened_rows)
    resistances = system.sizes.nc + system.joint_count[0]
    status = max(joint_event_functions(system), contact_event_functions(system))
    status = max(status, resistance_event_functions(system, resistances, count_items(system)))
    if slipping:
        if count_unloaded(system, count) > 0:
            status = max(status, unloaded_event_functions(system, count))
        status = max(status, jam_event_functions(system, count))
    return status


# ------------------------------------------------------------------------------------------- loads and constraints


@kernel
def add_viscous_loads(system, load):
    """load (nv,) += rows^T F over all viscous forces F."""
    for c in range(system.sizes.nc):
        integers, numbers = system.contact_int[c], system.contact_real[c]
        if resists_viscously(integers, numbers):
            for row in range(integers[TANGENTS]):
                value = viscous_force(numbers, system.basis[c, row], system.slip[c])
                for k in range(system.sizes.nv):
                    load[k] += system.rows[c, row, k] * value


@kernel
def dry_friction_force(mode, limit, numbers):
    """Dry friction in N or N m of a joint coordinate that moves; 0 where it is held."""
    if mode != FREE or limit[JOINT_SIGN] == 0:
        return 0.0
    return numbers[LOW_FORCE] if limit[JOINT_SIGN] > 0 else numbers[HIGH_FORCE]


@kernel
def list_rows(contact_int, n, row_index):
    """The constrained rows of n items, (item, basis row): of each its normal, if it has one, then stuck tangents.

    Returns the number of rows and whether any item slips.
    """
    count = 0
    slipping = False
    for c in range(n):
        integers = contact_int[c]
        mode = integers[MODE]
        if mode == FREE:
            continue
        if integers[PATTERN] != NO_NORMAL:
            row_index[count, 0], row_index[count, 1] = c, 2
            count += 1
        if integers[PATTERN] == ON_CURVE:
            row_index[count, 0], row_index[count, 1] = c, 1
            count += 1
        if mode == STICK:
            row_index[count, 0], row_index[count, 1] = c, 0
            count += 1
            if integers[TANGENTS] == 2:
                row_index[count, 0], row_index[count, 1] = c, 1
                count += 1
        elif mode == SLIPPING:
            slipping = True
    return count, slipping


@kernel
def list_constraints(system):
    """The constrained rows of all items in `row_index`, and L^-T of each in `whitened_rows`; their number, and whether
    any item slips."""
    total = count_items(system)
    free_with_owners(system.contact_int, system.sizes.nc + system.joint_count[0], total)
    count, slipping = list_rows(system.contact_int, total, system.row_index)
    nv, whitened = system.sizes.nv, system.whitened_rows
    for r in range(count):
        row = system.rows[system.row_index[r, 0], system.row_index[r, 1]]
        for k in range(nv):
            whitened[r, k] = row[k]
    whiten_rows(system.factor, system.parents, nv, whitened, count)
    return count, slipping


@kernel
def right_hand_sides(system, count):
    """multipliers = -(row . a_free + bias): what the forces have to make up."""
    x, row_index = system.multipliers, system.row_index
    for r in range(count):
        c, row = row_index[r, 0], row_index[r, 1]
        x[r] = -(inner(system.rows[c, row], system.free_acceleration, system.sizes.nv) + system.bias[c, row])


@kernel
def move_reference(system, count):
    """reference = start + slope[1] slope[0]^T (x - start), x (count,) the forces in `multipliers`."""
    nv, slope, row_index, work = system.sizes.nv, system.reference_slope, system.row_index, system.work
    for k in range(nv):
        work[k] = 0.0
    for r in range(count):
        c, row = row_index[r, 0], row_index[r, 1]
        change, along = system.multipliers[r] - system.reference_start[c, row], slope[0, 3 * c + row]
        for k in range(nv):
            work[k] += along[k] * change
    for r in range(count):
        c, row = row_index[r, 0], row_index[r, 1]
        system.reference[c, row] = system.reference_start[c, row] + inner(slope[1, 3 * c + row], work, nv)


@kernel
def take_reference(system, count, directions):
    """Leave to the multipliers (count,) what the reference forces do not make up."""
    nv, row_index, work = system.sizes.nv, system.row_index, system.work
    for k in range(nv):
        work[k] = 0.0
    for r in range(count):
        part = system.reference[row_index[r, 0], row_index[r, 1]]
        for k in range(nv):
            work[k] += part * directions[r, k]
    right_hand_sides(system, count)
    for r in range(count):
        system.multipliers[r] -= inner(system.whitened_rows[r], work, nv)


@kernel
def follow_choice(system, count, directions, slides):
    """Multipliers nearest to the reference, which follows the forces that are nearest to where it starts; returns the
    rank of the rows.

    What loads, turning rows and turning friction change shows in the latter. Of this the reference takes what is along
    the choice's span, and adds the choice's tangent (see `redistribution`): so forces stay central to first order, as
    far as what moves nothing does not turn by itself while bounds are near.
    """
    x, row_index, rank = system.multipliers, system.row_index, 0
    for r in range(count):
        x[r] = system.reference_start[row_index[r, 0], row_index[r, 1]]
    for again in range(2):
        move_reference(system, count)
        take_reference(system, count, directions)
        if slides:
            solve_for_least(system, count)
        elif again == 0:
            rank = solve_for_rows(system, count)
        else:
            solve_factored(system.delassus, system.permutation, count, rank, x, system.constraint_rows)
        for r in range(count):
            x[r] += system.reference[row_index[r, 0], row_index[r, 1]]
    return rank


# ----------------------------------------------------------------------------------------------- multipliers (Eq. 31)


@inlined_kernel
def solve_sticking(system, count):
    """Multipliers without slip: J M^-1 J^T f = -(J a_free + bias), the least or the chosen ones if redundant."""
    if system.scalars.has_reference != 0.0:
        system.counters.row_rank = follow_choice(system, count, system.whitened_rows, False)
        return
    right_hand_sides(system, count)
    system.counters.row_rank = solve_for_rows(system, count)


@separate_kernel(INTEGER, SYSTEM.type, INTEGER)
def solve_for_rows(system, count):
    """The least multipliers x with R R^T x = b, R the whitened rows, from b in their place; returns the rank of R."""
    tolerance = RANK_TOLERANCE
    if system.counters.redundant != 0:
        tolerance *= NEXT_TO_REDUNDANT
    return solve_gram(
        system.whitened_rows,
        count,
        system.sizes.nv,
        system.delassus,
        system.permutation,
        system.multipliers,
        system.constraint_rows,
        tolerance,
    )


@separate_kernel(BOOLEAN, SYSTEM.type, INTEGER)
def solve_slipping(system, count):
    """Multipliers with slip, J_n M^-1 (J_n - mu d J_t)^T f = -(J a_free + bias); False where there are none.

    A fixed point where points slip on curves: |F_n| = l . F_n with l the unit normal force, which is corrected.
    """
    change, lost = 0.0, NOTHING_LOST
    for _ in range(_NORMAL_ITERATIONS):
        friction_directions(system, count)
        assemble_slip(system, count)
        lost = NOTHING_LOST if system.counters.decided != 0 else loses_positivity(system, count)
        if lost == CONTACT_LOST or not solve_linear_slip(system, count):
            return False
        change = update_normal_shares(system, count)
        if change <= _NORMAL_CHANGE:
            break
    return change <= _NORMAL_FOUND and lost == NOTHING_LOST


@kernel
def friction_directions(system, count):
    """whitened_forces[r] = L^-T (direction of the force that multiplier r scales)^T.

    For a slipping contact this is n - mu w_t / |w_t|, if friction is isotropic; |F_n| = sign F_n for one normal and
    l . F_n, with l the unit normal force of the last iterate, for two. Where only friction holds the contact up and
    F_n = 0 it is -w_t / |w_t|: so ideal rolling slips, the limit for mu without bound, and what viscous friction keeps
    from closing. A resistance that slips adds its torque to its contact's normal force in the same way.
    """
    nv = system.sizes.nv
    for r in range(count):
        for k in range(nv):
            system.whitened_forces[r, k] = system.whitened_rows[r, k]
    for i in range(count_items(system)):
        integers, numbers = system.contact_int[i], system.contact_real[i]
        if integers[MODE] != SLIPPING or (numbers[MU] == 0.0 and not is_held_up(integers, numbers)):
            continue
        c = integers[OWNER] if integers[PATTERN] == NO_NORMAL else i
        # the torque of a resistance whose contact is without a load is zero
        if c == i or not is_held_up(system.contact_int[c], system.contact_real[c]):
            whiten_friction(system, i)
            add_friction(system, count, i, c)


@kernel
def whiten_friction(system, i):
    """work = L^-T (d J_t)^T of item i, which slides along d; notes its speed and coefficient."""
    integers, numbers, rows = system.contact_int[i], system.contact_real[i], system.rows[i]
    nv, direction, work = system.sizes.nv, system.vectors[0], system.work
    speed = slip_direction(integers, numbers, system.slip[i], system.basis[i], system.scalars.time, direction)
    numbers[SLIP_SPEED], numbers[MU_NOW] = speed, coefficient_at(numbers, abs(speed))
    if not shares_viscous_force(integers):
        friction_direction(integers, numbers, direction)
    for k in range(nv):
        work[k] = direction[0] * rows[0, k]
    if integers[TANGENTS] == 2:
        for k in range(nv):
            work[k] += direction[1] * rows[1, k]
    whiten(system.factor, system.parents, nv, work, work)


@kernel
def add_friction(system, count, i, c):
    """Add the friction of item i, whitened in `work`, to the force directions of contact c's normals."""
    numbers, row_index, work = system.contact_real[i], system.row_index, system.work
    alone, on_curve = is_held_up(system.contact_int[i], numbers), system.contact_int[c, PATTERN] == ON_CURVE
    for r in range(count):
        row = row_index[r, 1]
        if row_index[r, 0] != c or not (row == 2 or (row == 1 and on_curve)):
            continue
        share = float(system.contact_int[c, NORMAL_SIGN]) if system.contact_int[c, UNILATERAL] == 0 else 1.0
        if on_curve:
            share = numbers[NORMAL_1] if row == 2 else numbers[NORMAL_2]
        target, factor = system.whitened_forces[r], numbers[MU_NOW] * share
        for k in range(system.sizes.nv):
            target[k] = -work[k] if alone else target[k] - factor * work[k]


@inlined_kernel
def assemble_slip(system, count):
    """The unsymmetric operator of slip (count, count) in `delassus`; its last column is the diagonal without friction,
    or -1 for contacts that carry nothing."""
    nv, operator, whitened, directions = system.sizes.nv, system.delassus, system.whitened_rows, system.whitened_forces
    for i in range(count):
        for j in range(count):
            operator[i, j] = inner(whitened[i], directions[j], nv)
        operator[i, count] = inner(whitened[i], whitened[i], nv)
    leave_unloaded(system, count)


@inlined_kernel
def solve_linear_slip(system, count):
    """Multipliers for the force directions of `friction_directions` by the operator of these; False where there are
    none."""
    counters, operator = system.counters, system.delassus
    right_hand_sides(system, count)
    rank = solve_slip(system, count)
    if rank < 0:
        return False
    counters.row_rank = rank
    counters.lost_positivity = 1 if rank == count and operator[0, 0] < -COMMON_LIMIT else 0
    if rank < count and system.scalars.has_reference != 0.0:
        follow_choice(system, count, system.whitened_forces, True)
    elif rank < count:
        right_hand_sides(system, count)
        solve_for_least(system, count)
    return True


@inlined_kernel
def solve_slip(system, n):
    """Solve the unsymmetric system (n, n) of slip in `delassus` for the multipliers, from the right-hand sides in their
    place; returns its rank, -1 where it has none.

    Where the diagonal without friction, in the last column, is zero nothing moves along the normal, whatever pushes:
    the multiplier is left out, and so zero, as among redundant ones. -1 there marks a contact that carries nothing.
    Several contacts have lost positivity where their determinant, positive without friction, is negative, which is for
    the caller to look at: it is operator[0, 0] then, where the rank is n.
    """
    operator, x, scratch = system.delassus, system.multipliers, system.constraint_rows
    right, moving, loaded = system.right_side, 0, 0
    for i in range(n):
        moving += 1 if operator[i, n] != 0.0 else 0
        loaded += 1 if operator[i, n] > 0.0 else 0
        for j in range(n if operator[i, n] == 0.0 else 0):
            operator[j, i] = 0.0
    if n == 1 and loaded == 1:
        x[0] /= operator[0, 0]
        return 1
    for i in range(n):
        right[i] = x[i]
        x[i] = 0.0
    if loaded == 0:
        return moving
    rank = least_norm(operator, right, n, n, x, scratch, system.permutation, RANK_TOLERANCE)
    return rank if rank > 0 else -1


@kernel
def update_normal_shares(system, count):
    """Unit normal force of points on spatial curves, with friction, from the last multipliers; by how much it changed.

    Where all motions are in one plane with the tangent, it is in that plane: of redundant forces the least.
    """
    change, nv = 0.0, system.sizes.nv
    for r in range(count - 1):
        numbers = system.contact_real[system.row_index[r, 0]]
        if not slides_on_curve(system, r) or numbers[MU] == 0.0:
            continue
        first, second = system.multipliers[r], system.multipliers[r + 1]
        own = system.whitened_rows[r : r + 2]
        one, two, both = inner(own[0], own[0], nv), inner(own[1], own[1], nv), inner(own[0], own[1], nv)
        if is_plane(one + two, one * two - both * both):
            larger = own[0] if one >= two else own[1]
            one, two = inner(own[0], larger, nv), inner(own[1], larger, nv)
            along = first * one + second * two
            first, second = along * one, along * two
        size = math.hypot(first, second)
        if size > 0.0:
            first, second = first / size, second / size
            change = max(change, abs(first - numbers[NORMAL_1]) + abs(second - numbers[NORMAL_2]))
            numbers[NORMAL_1], numbers[NORMAL_2] = first, second
    return change


# --------------------------------------------------------------------------------------------- accelerations (Eq. 29)


@kernel
def accelerate(system, count, directions):
    """Forces along the bases from the multipliers, and a = a_free + M^-1 (sum of the force directions they scale)."""
    nv, nc, force, work = system.sizes.nv, system.sizes.nc, system.force, system.work
    acceleration, free = system.acceleration, system.free_acceleration
    for i in range(count_items(system)):
        for row in range(3):
            force[i, row] = 0.0
    for k in range(nv):
        work[k] = 0.0
    largest = 0.0
    for r in range(count):
        multiplier = system.multipliers[r]
        largest = max(largest, abs(multiplier))
        force[system.row_index[r, 0], system.row_index[r, 1]] = multiplier
        for k in range(nv):
            work[k] += directions[r, k] * multiplier
    system.scalars.largest_force = largest
    unwhiten(system.factor, system.parents, nv, work, work)
    for k in range(nv):
        acceleration[k] = free[k] + work[k]
        if abs(acceleration[k]) <= _CANCELLED * abs(free[k]):
            acceleration[k] = 0.0
    for g in range(system.joint_count[0]):
        # of the others' forces more may be left than of its own
        if system.contact_int[nc + g, MODE] != FREE:
            acceleration[system.joint_int[g, JOINT_V]] = 0.0
