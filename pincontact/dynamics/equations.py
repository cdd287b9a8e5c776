"""Accelerations and contact forces of one state in given modes (Eqs. 29, 31, 34).

M a = tau - damping v - nle + sum over contacts of rows^T F, with the rows of the normal always constrained, the
tangential ones in stick, and F_t = -mu |F_n| w_t / |w_t| in slip, which makes the operator unsymmetric:
J_n M^-1 (J_n - mu d J_t)^T. Friction of two directions has A^2 w_t / |A w_t| there (see `friction.ellipse`), viscous
friction is one of the loads.
"""

from __future__ import annotations

import math

from ..friction.elimination import least_norm, minimum_norm_solve
from ..friction.ellipse import friction_direction, friction_length
from ..friction.stribeck import stribeck_kernel
from ..geometry.patterns import NO_NORMAL, ON_CURVE
from ..geometry.small import dot
from ..jit import kernel
from ..layout import (
    ACROSS_X,
    ANISOTROPIC,
    DIRECTION_X,
    DOMAIN,
    DOMAIN_MARGIN,
    EVENT,
    FREE,
    FRICTION_MARGIN,
    FRICTIONLESS,
    FROZEN,
    GAP_MARGIN,
    GUARD_END,
    GUARD_SIGN,
    GUARD_V,
    HIGH_END,
    HIGH_FORCE,
    LIMIT_SLACK,
    LOW_END,
    LOW_FORCE,
    MARGINS_PER_CONTACT,
    MODE,
    MU,
    MU_FAST,
    MU_NOW,
    MU_STATIC,
    NO_FORCE,
    NORMAL_1,
    NORMAL_2,
    NORMAL_MARGIN,
    NORMAL_SIGN,
    OK,
    OWNER,
    PATTERN,
    POLYNOMIAL,
    POLYNOMIAL_SIZE,
    SLIP_RATE,
    SLIP_SIGN,
    SLIP_SPEED,
    SLIPPING,
    SPAN,
    SPEED_MARGIN,
    START,
    STICK,
    STRETCH_11,
    STRETCH_12,
    STRIBECK_EXPONENT,
    STRIBECK_SPEED,
    TANGENTS,
    UNILATERAL,
    VISCOUS,
)
from .linear import RANK_TOLERANCE, inner, solve_gram, unwhiten, whiten
from .resistance import free_with_owners, resists, size_of_load

# Friction on a point of a spatial curve depends on the length of a two-component normal force: fixed point, quadratic.
_NORMAL_ITERATIONS = 50
_NORMAL_CHANGE = 1e-15
# What is left of a change where it has been found, but for round-off of the forces.
_NORMAL_FOUND = 1e-6
# Accelerations that contact forces cancel down to this part are zero, so that what is held does not creep by round-off
# times the square of a step.
_CANCELLED = 4e-15
# A contact without a load stays closed by itself where its relative acceleration, in units of what cancels in it and in
# m/s^2, is no more than this.
_CLOSES = 1e-8
# A slip operator whose pivot falls below this fraction of its frictionless value has lost positivity (Painleve).
PAINLEVE_LIMIT = 1e-9
# The operator of several contacts has lost it where their determinant is negative, and its last pivot larger than this
# part of the largest: of nearly redundant ones the least unevenness decides which sign it has.
COMMON_LIMIT = 1e-3
# Friction that holds a contact up alone jams where a unit of it pushes the bodies apart by less than this fraction of
# what a unit of normal force does.
JAM_LIMIT = 1e-6


@kernel
def slip_direction(integers, numbers, slip, basis, time, direction):
    """Unit direction of slip in the tangent plane, components along (t1, second); and the slip speed.

    Patterns with one tangent keep their sign as a mode. A frozen direction (slip that starts, whose v_c is too small to
    show one) is a polynomial of time in world axes.
    """
    along, aside = dot(basis[0], slip), dot(basis[1], slip)
    if integers[TANGENTS] == 1:
        direction[0], direction[1] = float(integers[SLIP_SIGN]), 0.0
        return direction[0] * along
    speed = math.hypot(along, aside)
    if integers[FROZEN] != 0 or speed == 0.0:
        world, across = numbers[DIRECTION_X:], numbers[ACROSS_X:]
        share = (time - numbers[START]) / numbers[SPAN]
        turn = 0.0
        for j in range(POLYNOMIAL_SIZE - 1, -1, -1):
            turn = turn * share + numbers[POLYNOMIAL + j]
        direction[0] = dot(basis[0], world) + turn * dot(basis[0], across)
        direction[1] = dot(basis[1], world) + turn * dot(basis[1], across)
        size = math.hypot(direction[0], direction[1])
        if size > 0.0:
            direction[0] /= size
            direction[1] /= size
    else:
        direction[0], direction[1] = along / speed, aside / speed
    return speed


@kernel
def coefficient_at(numbers, speed):
    """Coefficient of friction of slip at a speed in m/s."""
    if numbers[STRIBECK_SPEED] > 0.0:
        return stribeck_kernel(
            numbers[MU], numbers[MU_FAST], numbers[STRIBECK_SPEED], numbers[STRIBECK_EXPONENT], speed
        )
    return numbers[MU]


@kernel
def shares_viscous_force(integers):
    """Whether a unilateral contact slides with F_n = 0, held up by a part of its viscous force (NORMAL_SIGN is -1)."""
    return integers[MODE] == SLIPPING and integers[UNILATERAL] != 0 and integers[NORMAL_SIGN] < 0


@kernel
def is_held_up(integers, numbers):
    """Whether a contact slides with F_n = 0, held up by friction alone: ideal rolling, or part of its viscous force."""
    return shares_viscous_force(integers) or (integers[MODE] == SLIPPING and numbers[MU] == math.inf)


@kernel
def resists_viscously(integers, numbers):
    """Whether a contact moves with all of its viscous friction: it touches, and does not stick."""
    moves = numbers[VISCOUS] > 0.0 and integers[MODE] != FREE and integers[MODE] != STICK
    return moves and not shares_viscous_force(integers)


@kernel
def viscous_force(numbers, tangent, slip):
    """Component along a tangent of the viscous force on body 2, in N."""
    return -numbers[VISCOUS] * dot(tangent, slip)


@kernel
def add_viscous_loads(nv, nc, contact_int, contact_real, basis, slip, rows, load):
    """load += rows^T F over all viscous forces F."""
    for c in range(nc):
        if resists_viscously(contact_int[c], contact_real[c]):
            for row in range(contact_int[c, TANGENTS]):
                value = viscous_force(contact_real[c], basis[c, row], slip[c])
                for k in range(nv):
                    load[k] += rows[c, row, k] * value


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
def whiten_rows(factor, parents, nv, rows, row_index, count, whitened):
    """whitened[r] = L^-T (constraint row r)^T, so that Delassus products are plain dot products."""
    for r in range(count):
        whiten(factor, parents, nv, rows[row_index[r, 0], row_index[r, 1]], whitened[r])


@kernel
def friction_directions(
    total,
    contact_int,
    contact_real,
    slip,
    basis,
    rows,
    row_index,
    count,
    factor,
    parents,
    nv,
    whitened,
    whitened_forces,
    time,
    direction,
    work,
):
    """whitened_forces[r] = L^-T (direction of the force that multiplier r scales)^T.

    For a slipping contact this is n - mu w_t / |w_t|, if friction is isotropic; |F_n| = sign F_n for one normal and
    l . F_n, with l the unit normal force of the last iterate, for two. Where only friction holds the contact up and
    F_n = 0 it is -w_t / |w_t|: so ideal rolling slips, the limit for mu without bound, and what viscous friction keeps
    from closing. A resistance that slips adds its torque to its contact's normal force in the same way.
    """
    for r in range(count):
        for k in range(nv):
            whitened_forces[r, k] = whitened[r, k]
    for i in range(total):
        integers, numbers = contact_int[i], contact_real[i]
        alone = is_held_up(integers, numbers)
        if integers[MODE] != SLIPPING or (numbers[MU] == 0.0 and not alone):
            continue
        c = integers[OWNER] if integers[PATTERN] == NO_NORMAL else i
        if c != i and is_held_up(contact_int[c], contact_real[c]):
            # without a load
            continue
        numbers[SLIP_SPEED] = slip_direction(integers, numbers, slip[i], basis[i], time, direction)
        numbers[MU_NOW] = coefficient_at(numbers, abs(numbers[SLIP_SPEED]))
        if not shares_viscous_force(integers):
            friction_direction(integers, numbers, direction)
        for k in range(nv):
            work[k] = direction[0] * rows[i, 0, k]
        if integers[TANGENTS] == 2:
            for k in range(nv):
                work[k] += direction[1] * rows[i, 1, k]
        whiten(factor, parents, nv, work, work)
        for r in range(count):
            row = row_index[r, 1]
            on_curve = contact_int[c, PATTERN] == ON_CURVE
            if row_index[r, 0] != c or not (row == 2 or (row == 1 and on_curve)):
                continue
            share = float(contact_int[c, NORMAL_SIGN]) if contact_int[c, UNILATERAL] == 0 else 1.0
            if on_curve:
                share = numbers[NORMAL_1] if row == 2 else numbers[NORMAL_2]
            for k in range(nv):
                whitened_forces[r, k] = -work[k] if alone else whitened_forces[r, k] - numbers[MU_NOW] * share * work[k]


@kernel
def is_normal_of_curve(contact_int, c, row):
    """Whether a row is one of the two normals of a point on a spatial curve."""
    return row != 0 and contact_int[c, PATTERN] == ON_CURVE


@kernel
def solve_slip(contact_int, row_index, operator, n, x, permutation, scratch):
    """Solve the unsymmetric system of slipping contacts, x (n,) in and out; returns its rank.

    -1 where a contact's own operator has lost positivity, against its frictionless value in the last column of
    system: no force, or two (Painleve); see `curves_lose_positivity` for points on curves. So it has of several where
    their determinant, positive without friction, is negative, which is for the caller to look at: it is operator[0, 0]
    then, where the rank is n. Where that value is zero
    nothing moves along the normal, whatever pushes: the multiplier is left out, and so zero, as among redundant ones.
    """
    moving = 0
    for i in range(n):
        if operator[i, n] < 0.0:
            # carries nothing, with a column of zeros
            moving += 1
            continue
        if operator[i, n] == 0.0:
            x[i] = 0.0
            for j in range(n):
                operator[j, i] = 0.0
            continue
        if not operator[i, i] > PAINLEVE_LIMIT * operator[i, n] and not is_normal_of_curve(
            contact_int, row_index[i, 0], row_index[i, 1]
        ):
            return -1
        moving += 1
    if n == 1 or moving == 0:
        if moving == 1:
            x[0] = x[0] / operator[0, 0] if operator[0, n] > 0.0 else 0.0
        return moving
    for i in range(n):
        scratch[i, n] = x[i]
    rank = minimum_norm_solve(operator, scratch[:n, n], n, x, scratch, permutation, RANK_TOLERANCE)
    return rank if rank > 0 else -1


@kernel
def curves_lose_positivity(contact_int, row_index, count, whitened, whitened_forces, nv):
    """Whether the own operator of a point on a curve, of both its normals, has lost positivity, as in `solve_slip`.

    Its determinant is that of the frictionless one times 1 - mu l . k, k = G_nn^-1 G_nt, whichever normals are taken;
    where all motions are in one plane with the tangent, its trace is.
    """
    for r in range(count - 1):
        c = row_index[r, 0]
        if row_index[r, 1] != 2 or contact_int[c, PATTERN] != ON_CURVE or contact_int[c, MODE] != SLIPPING:
            continue
        own, forces = whitened[r : r + 2], whitened_forces[r : r + 2]
        trace, size, moves_in_plane = plane_of_normals(own, nv)
        left = inner(own[0], forces[0], nv) + inner(own[1], forces[1], nv)
        if not moves_in_plane:
            left = inner(own[0], forces[0], nv) * inner(own[1], forces[1], nv)
            left -= inner(own[0], forces[1], nv) * inner(own[1], forces[0], nv)
        if trace > 0.0 and not left > PAINLEVE_LIMIT * (trace if moves_in_plane else size):
            return True
    return False


@kernel
def plane_of_normals(own, nv):
    """Trace and determinant of the operator of two normals, own (2, nv) whitened, and whether all motions along them
    are in one plane."""
    first, second, both = inner(own[0], own[0], nv), inner(own[1], own[1], nv), inner(own[0], own[1], nv)
    size = first * second - both * both
    return first + second, size, not size > RANK_TOLERANCE * (first + second) ** 2


@kernel
def unit_of_force(contact_int, contact_real, c, row, own, rows, factor, parents, nv, work):
    """What a multiplier is measured in where forces are redundant: a contact's force is as large as its length times
    the root of its mobility, the mean of J M^-1 J^T over its directions.

    So do the equations of cone problems, without units: redundant loads are the same in both. own: n M^-1 n^T.
    """
    integers, numbers = contact_int[c], contact_real[c]
    tangents = integers[TANGENTS]
    on_curve = is_normal_of_curve(contact_int, c, row)
    if not on_curve and (row != 2 or integers[MODE] == FRICTIONLESS or tangents == 0):
        return own
    total, largest = own, own
    for i in range(2):
        if on_curve:
            # the other normal and the tangent: the same whichever normals are taken
            whiten(factor, parents, nv, rows[c, (row + 1 + i) % 3], work)
            total += inner(work, work, nv)
            continue
        if i >= tangents:
            total += largest
            break
        if integers[ANISOTROPIC] != 0:
            # row i of the stretch
            first, second = numbers[STRETCH_11 + i], numbers[STRETCH_12 + i]
            for k in range(nv):
                work[k] = first * rows[c, 0, k] + second * rows[c, 1, k]
        else:
            for k in range(nv):
                work[k] = rows[c, i, k]
        whiten(factor, parents, nv, work, work)
        size = inner(work, work, nv)
        total += size
        largest = max(largest, size)
    force = 1.0
    if integers[MODE] == SLIPPING and numbers[MU] < math.inf:
        force += numbers[MU_NOW] * numbers[MU_NOW]
    return force * total / 3.0


@kernel
def weigh_forces(
    contact_int, contact_real, rows, row_index, count, factor, parents, nv, whitened, whitened_forces, operator, work
):
    """The operator with forces in their units, see `unit_of_force`; what they are to be multiplied with, then, in the
    last column of system (count, count + 1)."""
    for j in range(count):
        own = inner(whitened[j], whitened[j], nv)
        c, row = row_index[j, 0], row_index[j, 1]
        unit = unit_of_force(contact_int, contact_real, c, row, own, rows, factor, parents, nv, work)
        operator[j, count] = 1.0 / math.sqrt(unit) if own > 0.0 else 0.0
        for i in range(count):
            operator[i, j] = inner(whitened[i], whitened_forces[j], nv) * operator[j, count]


@kernel
def carries_nothing(contact_int, nc, c, row):
    """Whether a row is the normal of a unilateral contact that stays closed without a load (NORMAL_SIGN is 0)."""
    return c < nc and row == 2 and contact_int[c, UNILATERAL] != 0 and contact_int[c, NORMAL_SIGN] == 0


@kernel
def leave_unloaded(contact_int, nc, row_index, count, operator):
    """Zero the columns of contacts that carry nothing, and mark them by -1 in the last one; how many there are."""
    found = 0
    for j in range(count):
        if carries_nothing(contact_int, nc, row_index[j, 0], row_index[j, 1]):
            found += 1
            operator[j, count] = -1.0
            for i in range(count):
                operator[i, j] = 0.0
    return found


@kernel
def unloaded_margins(
    nv,
    nc,
    contact_int,
    contact_real,
    rows,
    bias,
    row_index,
    count,
    factor,
    parents,
    whitened,
    whitened_forces,
    acceleration,
    multipliers,
    operator,
    permutation,
    scratch,
    margins,
    work,
):
    """Margins of contacts that carry nothing: how far from the least forces a load of theirs would be; EVENT where one
    is negative, or where such a contact does not stay closed by itself.

    The forces are least among those that are not negative if N = A^T y + s in their units, with s >= 0 at those that
    are zero (Kuhn and Tucker).
    """
    weigh_forces(
        contact_int,
        contact_real,
        rows,
        row_index,
        count,
        factor,
        parents,
        nv,
        whitened,
        whitened_forces,
        operator,
        work,
    )
    loaded = 0
    for j in range(count):
        if operator[j, count] > 0.0 and not carries_nothing(contact_int, nc, row_index[j, 0], row_index[j, 1]):
            for i in range(count):
                scratch[loaded, i] = operator[i, j]
            scratch[loaded, count] = multipliers[j] / operator[j, count]
            loaded += 1
    least_norm(scratch, scratch[:count, count], loaded, count, multipliers, operator, permutation, RANK_TOLERANCE)
    status = OK
    for j in range(count):
        c = row_index[j, 0]
        if not carries_nothing(contact_int, nc, c, row_index[j, 1]):
            continue
        load = 0.0
        for i in range(count):
            load += inner(whitened[i], whitened_forces[j], nv) * multipliers[i]
        margins[c, NORMAL_MARGIN] = -load * operator[j, count] * operator[j, count]
        free, held = bias[c, 2], inner(rows[c, 2], acceleration, nv)
        if abs(held + free) > _CLOSES * (abs(held) + abs(free) + 1.0):
            margins[c, NORMAL_MARGIN] = -1.0
        if margins[c, NORMAL_MARGIN] < 0.0:
            status = EVENT
    return status


@kernel
def right_hand_side(row_index, count, rows, bias, free_acceleration, nv, x):
    """-(row . a_free + bias): what the multipliers have to make up."""
    for r in range(count):
        c, row = row_index[r, 0], row_index[r, 1]
        x[r] = -(inner(rows[c, row], free_acceleration, nv) + bias[c, row])


@kernel
def contact_dynamics(
    nv,
    nc,
    contact_int,
    contact_real,
    slip,
    basis,
    gaps,
    rows,
    bias,
    factor,
    parents,
    free_acceleration,
    acceleration,
    row_index,
    whitened,
    whitened_forces,
    delassus,
    multipliers,
    permutation,
    scratch,
    force,
    relative_acceleration,
    margins,
    work,
    time,
    direction,
    ng,
    total,
    guard_int,
    guard_real,
    reference,
    reference_start,
    reference_rate,
    reference_slope,
    has_reference,
    reference_moves,
    reference_time,
    counters,
):
    """Accelerations, forces on body 2 along each basis, and the margins of the present modes.

    Of redundant forces those of the least distance from the reference, which is zero unless it was chosen otherwise
    (see `redundant`); it may move with time and the loads.
    Returns OK, EVENT (a margin is negative) or NO_FORCE.
    """
    free_with_owners(contact_int, nc + ng, total)
    count, slipping = list_rows(contact_int, total, row_index)
    counters.row_count, counters.row_rank, counters.lost_positivity = count, 0, 0
    unloaded = 0
    whiten_rows(factor, parents, nv, rows, row_index, count, whitened)
    iterate, change = 1, 0.0
    if slipping:
        for c in range(nc):
            if contact_int[c, MODE] == SLIPPING and contact_int[c, PATTERN] == ON_CURVE and contact_real[c, MU] > 0.0:
                iterate = _NORMAL_ITERATIONS
    for _ in range(iterate):
        right_hand_side(row_index, count, rows, bias, free_acceleration, nv, multipliers)
        if reference_moves:
            _move_reference(
                row_index,
                count,
                multipliers,
                time - reference_time,
                reference_start,
                reference_rate,
                reference_slope,
                nv,
                reference,
                work,
            )
        if slipping:
            friction_directions(
                total,
                contact_int,
                contact_real,
                slip,
                basis,
                rows,
                row_index,
                count,
                factor,
                parents,
                nv,
                whitened,
                whitened_forces,
                time,
                direction,
                work,
            )
            if has_reference:
                _take_reference(row_index, count, reference, whitened, whitened_forces, nv, multipliers, work)
            for i in range(count):
                for j in range(count):
                    delassus[i, j] = inner(whitened[i], whitened_forces[j], nv)
                delassus[i, count] = inner(whitened[i], whitened[i], nv)
            unloaded = leave_unloaded(contact_int, nc, row_index, count, delassus)
            rank = solve_slip(contact_int, row_index, delassus, count, multipliers, permutation, scratch)
            if rank < 0:
                return NO_FORCE
            counters.row_rank = rank
            counters.lost_positivity = 1 if rank == count and delassus[0, 0] < -COMMON_LIMIT else 0
            if rank < count:
                # redundant: the least forces, each in its unit
                right_hand_side(row_index, count, rows, bias, free_acceleration, nv, multipliers)
                if has_reference:
                    _take_reference(row_index, count, reference, whitened, whitened_forces, nv, multipliers, work)
                weigh_forces(
                    contact_int,
                    contact_real,
                    rows,
                    row_index,
                    count,
                    factor,
                    parents,
                    nv,
                    whitened,
                    whitened_forces,
                    delassus,
                    work,
                )
                leave_unloaded(contact_int, nc, row_index, count, delassus)
                for j in range(count):
                    scratch[j, count] = multipliers[j] if delassus[j, count] != 0.0 else 0.0
                minimum_norm_solve(
                    delassus, scratch[:count, count], count, multipliers, scratch, permutation, RANK_TOLERANCE
                )
                for j in range(count):
                    multipliers[j] *= max(delassus[j, count], 0.0)
        else:
            if has_reference:
                _take_reference(row_index, count, reference, whitened, whitened, nv, multipliers, work)
            counters.row_rank = solve_gram(whitened, count, nv, delassus, permutation, multipliers, scratch)
        if has_reference:
            for r in range(count):
                multipliers[r] += reference[row_index[r, 0], row_index[r, 1]]
        if iterate == 1:
            break
        change = _update_normal_shares(contact_int, contact_real, row_index, count, multipliers, whitened, nv)
        if change <= _NORMAL_CHANGE:
            break
    if iterate > 1 and (
        change > _NORMAL_FOUND or curves_lose_positivity(contact_int, row_index, count, whitened, whitened_forces, nv)
    ):
        return NO_FORCE
    for c in range(total):
        for i in range(3):
            force[c, i] = 0.0
    for k in range(nv):
        work[k] = 0.0
    for r in range(count):
        force[row_index[r, 0], row_index[r, 1]] = multipliers[r]
        source = whitened_forces if slipping else whitened
        for k in range(nv):
            work[k] += source[r, k] * multipliers[r]
    unwhiten(factor, parents, nv, work, work)
    for k in range(nv):
        acceleration[k] = free_acceleration[k] + work[k]
        if abs(acceleration[k]) <= _CANCELLED * abs(free_acceleration[k]):
            acceleration[k] = 0.0
    for g in range(ng):
        # of the others' forces more may be left than of its own
        if contact_int[nc + g, MODE] != FREE:
            acceleration[guard_int[g, GUARD_V]] = 0.0
    status = guard_margins(nc, ng, contact_int, guard_int, guard_real, slip, gaps, force, margins)
    status = max(
        status,
        _margins(
            nv,
            nc,
            nc + ng,
            total,
            contact_int,
            contact_real,
            slip,
            basis,
            gaps,
            rows,
            bias,
            acceleration,
            force,
            relative_acceleration,
            margins,
            time,
            direction,
        ),
    )
    if unloaded > 0:
        status = max(
            status,
            unloaded_margins(
                nv,
                nc,
                contact_int,
                contact_real,
                rows,
                bias,
                row_index,
                count,
                factor,
                parents,
                whitened,
                whitened_forces,
                acceleration,
                multipliers,
                delassus,
                permutation,
                scratch,
                margins,
                work,
            ),
        )
    if slipping:
        for r in range(count):
            c = row_index[r, 0]
            if c < nc and contact_int[c, MODE] == SLIPPING and contact_real[c, MU] == math.inf:
                lift, own = inner(whitened[r], whitened_forces[r], nv), inner(whitened[r], whitened[r], nv)
                margins[c, FRICTION_MARGIN] = lift / own - JAM_LIMIT if own > 0.0 else 1.0
                if margins[c, FRICTION_MARGIN] < 0.0:
                    status = EVENT
    return status


@kernel
def _move_reference(row_index, count, x, time, start, rate, slope, nv, reference, work):
    """reference = start + rate time + slope[1] slope[0]^T x, x (count,) the right side of the equations."""
    for k in range(nv):
        work[k] = 0.0
    for r in range(count):
        place = 3 * row_index[r, 0] + row_index[r, 1]
        for k in range(nv):
            work[k] += slope[0, place, k] * x[r]
    for r in range(count):
        c, row = row_index[r, 0], row_index[r, 1]
        reference[c, row] = start[c, row] + rate[c, row] * time + inner(slope[1, 3 * c + row], work, nv)


@kernel
def _take_reference(row_index, count, reference, whitened, whitened_forces, nv, x, work):
    """Leave to the multipliers x (count,) what the reference forces do not make up."""
    for k in range(nv):
        work[k] = 0.0
    for r in range(count):
        part = reference[row_index[r, 0], row_index[r, 1]]
        for k in range(nv):
            work[k] += part * whitened_forces[r, k]
    for r in range(count):
        x[r] -= inner(whitened[r], work, nv)


@kernel
def guard_force(mode, guard, numbers):
    """Dry friction in N or N m of a joint coordinate that moves; 0 where it is held."""
    if mode != FREE or guard[GUARD_SIGN] == 0:
        return 0.0
    return numbers[LOW_FORCE] if guard[GUARD_SIGN] > 0 else numbers[HIGH_FORCE]


@kernel
def guard_margins(nc, ng, contact_int, guard_int, guard_real, slip, gaps, force, margins):
    """Event functions of guarded joint coordinates.

    Moving: way to the lower (GAP) and to the upper end (DOMAIN), speed. Held: force above its lower (NORMAL) and below
    its upper bound (FRICTION), of which the end it rests on takes one away.
    """
    status = OK
    for g in range(ng):
        value, guard, numbers = margins[nc + g], guard_int[g], guard_real[g]
        for i in range(MARGINS_PER_CONTACT):
            value[i] = 1.0
        if contact_int[nc + g, MODE] == FREE:
            if numbers[LOW_END] > -math.inf:
                value[GAP_MARGIN] = gaps[nc + g, 0] - numbers[LOW_END]
            if numbers[HIGH_END] < math.inf:
                value[DOMAIN_MARGIN] = numbers[HIGH_END] - gaps[nc + g, 0]
            if guard[GUARD_SIGN] != 0:
                value[SPEED_MARGIN] = guard[GUARD_SIGN] * slip[nc + g, 2]
        else:
            if guard[GUARD_END] <= 0:
                value[NORMAL_MARGIN] = force[nc + g, 2] - numbers[LOW_FORCE]
            if guard[GUARD_END] >= 0:
                value[FRICTION_MARGIN] = numbers[HIGH_FORCE] - force[nc + g, 2]
        for i in range(MARGINS_PER_CONTACT):
            if value[i] < 0.0:
                status = EVENT
    return status


@kernel
def _update_normal_shares(contact_int, contact_real, row_index, count, multipliers, whitened, nv):
    """Unit normal force of points on spatial curves from the last multipliers; by how much it has changed.

    Where all motions are in one plane with the tangent, it is in that plane: of redundant forces the least.
    """
    change = 0.0
    for r in range(count - 1):
        c = row_index[r, 0]
        if row_index[r, 1] != 2 or contact_int[c, PATTERN] != ON_CURVE or contact_int[c, MODE] != SLIPPING:
            continue
        first, second = multipliers[r], multipliers[r + 1]
        _, _, moves_in_plane = plane_of_normals(whitened[r : r + 2], nv)
        if moves_in_plane:
            larger = r if inner(whitened[r], whitened[r], nv) >= inner(whitened[r + 1], whitened[r + 1], nv) else r + 1
            one, two = inner(whitened[r], whitened[larger], nv), inner(whitened[r + 1], whitened[larger], nv)
            along = first * one + second * two
            first, second = along * one, along * two
        size = math.hypot(first, second)
        if size > 0.0:
            first, second = first / size, second / size
            numbers = contact_real[c]
            change = max(change, abs(first - numbers[NORMAL_1]) + abs(second - numbers[NORMAL_2]))
            numbers[NORMAL_1], numbers[NORMAL_2] = first, second
    return change


@kernel
def _margins(
    nv,
    nc,
    resistances,
    total,
    contact_int,
    contact_real,
    slip,
    basis,
    gaps,
    rows,
    bias,
    acceleration,
    force,
    relative_acceleration,
    margins,
    time,
    direction,
):
    """Complete the forces of slip and fill the event functions, but for guarded joint coordinates."""
    status = OK
    for c in range(total):
        if nc <= c < resistances:
            continue
        integers, numbers, value = contact_int[c], contact_real[c], margins[c]
        for i in range(MARGINS_PER_CONTACT):
            value[i] = 1.0
        owner = c
        if c >= nc:
            owner = integers[OWNER]
        elif integers[MODE] == FREE:
            value[GAP_MARGIN] = gaps[c, 0]
            if value[GAP_MARGIN] < 0.0:
                status = EVENT
            continue
        else:
            value[DOMAIN_MARGIN] = numbers[DOMAIN]
            if value[DOMAIN_MARGIN] < 0.0:
                status = EVENT
            if integers[UNILATERAL] != 0:
                value[NORMAL_MARGIN] = force[c, 2]
            elif integers[PATTERN] != ON_CURVE and (integers[MODE] == SLIPPING or resists(integers)):
                value[NORMAL_MARGIN] = integers[NORMAL_SIGN] * force[c, 2]
        _friction_margins(
            nv,
            c,
            size_of_load(contact_int, force, owner),
            integers,
            numbers,
            slip,
            basis,
            rows,
            bias,
            acceleration,
            force,
            relative_acceleration,
            value,
            time,
            direction,
        )
        if c < nc and resists_viscously(integers, numbers):
            for row in range(integers[TANGENTS]):
                force[c, row] += viscous_force(numbers, basis[c, row], slip[c])
        if value[NORMAL_MARGIN] < 0.0 or value[FRICTION_MARGIN] < 0.0 or value[SPEED_MARGIN] < 0.0:
            status = EVENT
    return status


@kernel
def _friction_margins(
    nv,
    c,
    load,
    integers,
    numbers,
    slip,
    basis,
    rows,
    bias,
    acceleration,
    force,
    relative_acceleration,
    value,
    time,
    direction,
):
    """Friction of item c under a load |F_n| in its present mode: complete its force, fill its margins `value`."""
    if integers[MODE] == STICK:
        if numbers[MU_STATIC] < math.inf:
            tangential = abs(force[c, 0])
            if integers[TANGENTS] == 2:
                tangential = friction_length(integers, numbers, force[c, 0], force[c, 1])
            value[FRICTION_MARGIN] = (1.0 + numbers[LIMIT_SLACK]) * numbers[MU_STATIC] * load - tangential
    elif integers[MODE] == SLIPPING:
        speed = slip_direction(integers, numbers, slip[c], basis[c], time, direction)
        numbers[SLIP_SPEED] = speed
        for row in range(3):
            relative_acceleration[c, row] = inner(rows[c, row], acceleration, nv) + bias[c, row]
        numbers[SLIP_RATE] = direction[0] * relative_acceleration[c, 0]
        shares = shares_viscous_force(integers)
        if integers[TANGENTS] == 1:
            if integers[FROZEN] == 0 and numbers[MU] > 0.0:
                value[SPEED_MARGIN] = speed
        else:
            numbers[SLIP_RATE] += direction[1] * relative_acceleration[c, 1]
            if not shares:
                friction_direction(integers, numbers, direction)
        friction = numbers[MU_NOW] * load
        if is_held_up(integers, numbers):
            friction, force[c, 2] = force[c, 2], 0.0
        if shares:
            value[FRICTION_MARGIN] = numbers[VISCOUS] * abs(speed) - friction
        if integers[TANGENTS] == 2:
            force[c, 1] = -friction * direction[1]
        force[c, 0] = -friction * direction[0]
