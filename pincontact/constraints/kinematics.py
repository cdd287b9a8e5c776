"""Kinematics of one contact: contact coordinates, basis, relative velocity, gap, their rates, constraint rows, biases.

Everything is formed in an orthonormal basis at the contact, rows (t1, second, n): t1 the tangent e_1 of body 2, n the
unit normal that points from body 1 into body 2 (so the gap n . (r_2 - r_1) is positive when the bodies are apart and
a compressive force on body 2 is positive), second the other tangent, or the second normal of a point on a spatial
curve. The oblique contact frame of the paper is made from it for reports only (`geometry.frames`).

The kernels take the workspace of a run and the contact's number c; its sides are 2 c and 2 c + 1. `contact_kinematics`
reads the sides' `frames` and the guess in `location`; it writes `location`, `derivatives`, `basis`, `slip`, `gaps`,
`rates` and, on request, `bias` of that contact. `constraint_rows` forms its `rows` afterwards.
"""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..contours.evaluation import call_contour
from ..geometry.carriers import OMEGA, ORIGIN, point_bias, point_velocity
from ..geometry.frames import STEEP
from ..geometry.location import (
    CYLINDERS,
    DIFFERENCE,
    FREE_VECTORS,
    NEWTON_LIMIT,
    NEWTON_STEP,
    NO_CLOSED_FORM,
    NORMAL,
    PLANE_NORMAL,
    POINT_ON_PLANE,
    ROUND_ON_PLANE,
    SIDES,
    SINGULAR_LIMIT,
    conditioning,
    cross_second,
    location_jacobian,
    location_residual,
    nearest_of_cylinders,
    nearest_on_sphere,
    point_to_plane,
    rate_equations,
    round_on_plane,
    second_row,
    solve_location,
    tangent_at_fixed_u,
)
from ..geometry.patterns import CROSSING_CURVES, ON_CURVE, ON_SURFACE, PLANAR
from ..geometry.small import add_cross, cross, dot, norm, rotate
from ..jit import BOOLEAN, INTEGER, NOTHING, inlined_kernel, kernel
from ..layout import (
    BRANCH,
    CHART,
    CLOSED_FORM,
    CONDITION,
    DETERMINANT_SIGN,
    EVALUATOR,
    FREE,
    K1,
    K2,
    KIND,
    LAST_NORMAL_X,
    LENGTH,
    LOCATION_FAILED,
    MODE,
    OK,
    PATTERN,
    POOL_ADDRESS,
    POOL_SIZE,
    SIDE,
    SINGULAR,
    SUPPORT_SIZE,
    SYSTEM,
    TIME_DEPENDENT,
)
from ..workspace import reals_at

# rows of the scratch array `vectors` after those of `geometry.location`; NORMAL_RATE: n', see `acceleration_bias`
_A, _B, _C, _D, NORMAL_RATE = range(FREE_VECTORS, FREE_VECTORS + 5)
# Newton may run into a pole, where a tangent vanishes and every equation with it; unit tangents tell. Relative.
_SOLVED = 1e-6
# Rows with a larger entry are not looked at for round-off.
_SMALL_ROW = 1e-9
# What rounding leaves of a contact's row whose terms cancel, as a part of these, with a margin.
ROW_ROUND_OFF = 1e-13


@kernel
def shape_in_world(system, c, body):
    """Evaluate the contour of a contact's body (0 or 1) at its coordinates; its derivatives in world axes."""
    side, dimension = 2 * c + body, system.contact_int[c, K1 + body]
    integers, local, world = system.side_int[side], system.local, system.derivatives[side]
    call_contour(
        integers[EVALUATOR],
        integers[CHART],
        system.side_shape[side],
        reals_at(integers[POOL_ADDRESS], integers[POOL_SIZE]),
        system.location[c, 2 * body],
        system.location[c, 2 * body + 1],
        system.scalars.time,
        local,
    )
    rotation = system.frames[side, 0:3]
    rotate(rotation, local[0], world[0])
    if dimension > 0:
        rotate(rotation, local[1], world[1])
        rotate(rotation, local[3], world[3])
    if dimension > 1:
        rotate(rotation, local[2], world[2])
        rotate(rotation, local[4], world[4])
        rotate(rotation, local[5], world[5])
    if integers[TIME_DEPENDENT] != 0:
        for row in range(6, 10):
            # 7 and 8 are the rates of the tangents
            if row == 9 or row - 7 < dimension:
                rotate(rotation, local[row], world[row])


@kernel
def measure(system, c):
    """r_2 - r_1 and N of the contours as they were evaluated last, into the scratch vectors."""
    frames, derivatives, vectors = system.frames, system.derivatives, system.vectors
    one, two = 2 * c, 2 * c + 1
    for i in range(3):
        apart = frames[two, ORIGIN, i] - frames[one, ORIGIN, i]
        vectors[DIFFERENCE, i] = apart + (derivatives[two, 0, i] - derivatives[one, 0, i])
        vectors[PLANE_NORMAL, i] = frames[two, i, 2]
    pattern = system.contact_int[c, PATTERN]
    if pattern != ON_CURVE:
        cross_second(pattern, derivatives[one], derivatives[two], vectors, derivatives[two, 1], vectors[NORMAL])


@kernel
def locate_in_closed_form(system, c):
    """`locate` where a formula gives the contact coordinates: OK or SINGULAR."""
    integers, location, scratch = system.contact_int[c], system.location[c], system.vectors[_A : NORMAL_RATE + 1]
    system.counters.closed_count += 1
    one, two, form = 2 * c, 2 * c + 1, integers[CLOSED_FORM]
    side1, frame1, frame2 = system.side_int[one], system.frames[one], system.frames[two]
    found = True
    if form == ROUND_ON_PLANE:
        shape, branch = system.side_shape[one], float(integers[BRANCH])
        found = round_on_plane(
            side1[KIND], side1[CHART], shape, frame1, frame2, integers[K2], branch, location, scratch
        )
    elif form == CYLINDERS:
        found = nearest_of_cylinders(frame1, frame2, location, scratch)
    elif form != POINT_ON_PLANE:
        charts = (side1[CHART], system.side_int[two, CHART])
        found = nearest_on_sphere(form, charts, frame1, frame2, integers[BRANCH], location, scratch)
    if not found:
        system.contact_real[c, CONDITION] = 0.0
        return SINGULAR
    shape_in_world(system, c, 0)
    if form in (POINT_ON_PLANE, ROUND_ON_PLANE):
        for i in range(3):
            scratch[0, i] = frame1[ORIGIN, i] + system.derivatives[one, 0, i]
        point_to_plane(scratch[0], frame2, integers[K2], location)
    shape_in_world(system, c, 1)
    measure(system, c)
    return OK


@separate_kernel(INTEGER, SYSTEM.type, INTEGER)
def locate(system, c):
    """Contact coordinates from the guess in `location`, and both contours evaluated there.

    Returns OK, LOCATION_FAILED (Newton did not converge, or left its branch) or SINGULAR.
    """
    integers, numbers = system.contact_int[c], system.contact_real[c]
    if integers[CLOSED_FORM] != NO_CLOSED_FORM:
        return locate_in_closed_form(system, c)
    location, change = system.location[c], system.location_system[SIDES]
    first, second = system.derivatives[2 * c], system.derivatives[2 * c + 1]
    converged = False
    for _ in range(NEWTON_LIMIT):
        system.counters.newton_count += 1
        shape_in_world(system, c, 0)
        shape_in_world(system, c, 1)
        measure(system, c)
        if converged:
            # what is closed is where it touches
            return OK if integers[MODE] != FREE or _is_solved(system, c) else LOCATION_FAILED
        location_jacobian(system, c)
        location_residual(system, c)
        determinant = solve_location(integers[K1], integers[K2], system.location_system)
        if not abs(conditioning(system, c, determinant)) > SINGULAR_LIMIT:
            numbers[CONDITION] = determinant
            return SINGULAR
        step = 0.0
        for a in range(integers[K1]):
            step = max(step, abs(change[a]) * norm(first[1 + a]))
        for a in range(integers[K2]):
            step = max(step, abs(change[2 + a]) * norm(second[1 + a]))
        if not step < math.inf:
            return LOCATION_FAILED
        add_coordinates(integers, change, location)
        converged = step <= NEWTON_STEP * numbers[LENGTH]
    return LOCATION_FAILED


@kernel
def _is_solved(system, c):
    """Whether C1, but for the gap, and C2 hold for unit tangents, too."""
    integers, length = system.contact_int[c], system.contact_real[c, LENGTH]
    first, second, difference = system.derivatives[2 * c], system.derivatives[2 * c + 1], system.vectors[DIFFERENCE]
    solved, least = True, _SOLVED * _SOLVED * max(length * length, dot(difference, difference))
    for a in range(1, 1 + integers[K2]):
        solved = solved and dot(second[a], difference) ** 2 <= least * dot(second[a], second[a])
    across = difference
    if integers[PATTERN] != CROSSING_CURVES:
        across = system.vectors[NORMAL]
        least = _SOLVED * _SOLVED * dot(across, across)
    for a in range(1, 1 + integers[K1]):
        solved = solved and dot(first[a], across) ** 2 <= least * dot(first[a], first[a])
    return solved


@kernel
def add_coordinates(integers, change, location):
    """location (4,) += change (4,), the coordinates that the contours have."""
    for a in range(integers[K1]):
        location[a] += change[a]
    for a in range(integers[K2]):
        location[2 + a] += change[2 + a]


@kernel
def basis_at_contact(pattern, side, second, normal, basis):
    """Orthonormal rows (t1, second, n) at the contact; n points from body 1 into body 2."""
    t1, other, n = basis[0], basis[1], basis[2]
    scale = 1.0 / norm(second[1])
    for i in range(3):
        t1[i] = second[1, i] * scale
    if pattern == ON_CURVE:
        # any two normals of the curve: made from the world axis that is least along it, z unless the curve climbs
        axis = 2 if abs(t1[2]) < STEEP else 0
        for i in range(3):
            other[i] = -t1[axis] * t1[i]
        other[axis] += 1.0
        scale = 1.0 / norm(other)
        for i in range(3):
            other[i] *= scale
        cross(t1, other, n)
    else:
        scale = -side / norm(normal)
        for i in range(3):
            n[i] = normal[i] * scale
        cross(n, t1, other)


@separate_kernel(INTEGER, SYSTEM.type, INTEGER, BOOLEAN)
def contact_kinematics(system, c, with_bias):
    """Contact coordinates, basis, v_c, gaps, rates of the coordinates (Eq. 6) and, where it is wanted, the bias.

    See `acceleration_bias`. Returns OK, LOCATION_FAILED or SINGULAR.
    """
    status = locate(system, c)
    if status != OK:
        return status
    integers, basis, vectors, gaps = system.contact_int[c], system.basis[c], system.vectors, system.gaps[c]
    pattern, numbers = integers[PATTERN], system.contact_real[c]
    basis_at_contact(pattern, integers[SIDE], system.derivatives[2 * c + 1], vectors[NORMAL], basis)
    if pattern == CROSSING_CURVES and dot(basis[2], numbers[LAST_NORMAL_X : LAST_NORMAL_X + 3]) < 0.0:
        # the normal has turned over: the curves went through parallel within the step
        return LOCATION_FAILED
    gaps[0] = dot(basis[2], vectors[DIFFERENCE])
    gaps[1] = dot(basis[1], vectors[DIFFERENCE]) if pattern == ON_CURVE else 0.0
    relative_velocity(system, c)
    status = location_rates(system, c)
    if status == OK and with_bias:
        acceleration_bias(system, c)
    return status


@kernel
def relative_velocity(system, c):
    """v_c = v_2 - v_1 of the two material points (Eq. 10)."""
    v1, v2, slip = system.vectors[_A], system.vectors[_B], system.slip[c]
    first, second = system.derivatives[2 * c], system.derivatives[2 * c + 1]
    point_velocity(system.frames[2 * c], first[0], first[6], v1)
    point_velocity(system.frames[2 * c + 1], second[0], second[6], v2)
    for i in range(3):
        slip[i] = v2[i] - v1[i]


@kernel
def location_rates(system, c):
    """Rates of the contact coordinates (Eq. 6): OK, SINGULAR, or LOCATION_FAILED on another branch."""
    integers = system.contact_int[c]
    location_jacobian(system, c)
    rate_equations(system, c)
    determinant = solve_location(integers[K1], integers[K2], system.location_system)
    condition = conditioning(system, c, determinant)
    system.contact_real[c, CONDITION] = condition
    if not abs(condition) > SINGULAR_LIMIT:
        return SINGULAR
    if condition * integers[DETERMINANT_SIGN] < 0.0:
        return LOCATION_FAILED
    rates = system.rates[c]
    for a in range(4):
        rates[a] = 0.0
    add_coordinates(integers, system.location_system[SIDES], rates)
    return OK


@separate_kernel(NOTHING, SYSTEM.type, INTEGER)
def acceleration_bias(system, c):
    """bias (3,): row . gamma + frame rate . v_c, so that row . (J_2 - J_1) a + bias is the rate of row . v_c.

    The rate of n is left in row NORMAL_RATE of the scratch vectors, but for a point on a spatial curve.
    """
    relative_bias(system, c)
    basis, bias, slip, vectors = system.basis[c], system.bias[c], system.slip[c], system.vectors
    tangent_rate, second = vectors[_D], system.derivatives[2 * c + 1]
    for row in range(3):
        bias[row] = dot(basis[row], vectors[_A])
    # the slip velocity meets a basis that turns
    total_tangent_rate(system, c, 1, 0, tangent_rate)
    if system.contact_int[c, PATTERN] == ON_CURVE:
        along = dot(basis[0], slip) / norm(second[1])
        bias[2] -= dot(basis[2], tangent_rate) * along
        bias[1] -= dot(basis[1], tangent_rate) * along
    else:
        turn_normal(system, c, tangent_rate)
        bias[2] += dot(slip, vectors[NORMAL_RATE])


@kernel
def relative_bias(system, c):
    """vectors[_A] = gamma: bias of the relative acceleration of material points, and their shift along the contours."""
    gamma, part, moving, rates = system.vectors[_A], system.vectors[_B], system.vectors[_C], system.rates[c]
    for body in range(2):
        side, sign = 2 * c + body, 2 * body - 1
        frame, shape = system.frames[side], system.derivatives[side]
        point_bias(frame, shape[0], shape[6], shape[9], part, moving)
        for a in range(system.contact_int[c, K1 + body]):
            tangent_at_fixed_u(frame, shape, a, moving)
            for i in range(3):
                part[i] += moving[i] * rates[2 * body + a]
        for i in range(3):
            gamma[i] = sign * part[i] + (gamma[i] if body == 1 else 0.0)


@kernel
def turn_normal(system, c, tangent_rate):
    """vectors[NORMAL_RATE] = n', from the rate of body 2's first tangent."""
    pattern, vectors, n = system.contact_int[c, PATTERN], system.vectors, system.basis[c, 2]
    first, second, frame2 = system.derivatives[2 * c], system.derivatives[2 * c + 1], system.frames[2 * c + 1]
    normal_rate, other_rate = vectors[NORMAL_RATE], vectors[_B]
    cross_second(pattern, first, second, vectors, tangent_rate, normal_rate)
    if pattern == ON_SURFACE:
        total_tangent_rate(system, c, 1, 1, other_rate)
    elif pattern == PLANAR:
        cross(frame2[OMEGA], vectors[PLANE_NORMAL], other_rate)
    else:
        total_tangent_rate(system, c, 0, 0, other_rate)
    add_cross(second[1], other_rate, normal_rate)
    # n' = -side (1 - n n^T) N' / |N|
    scale, along_n = -system.contact_int[c, SIDE] / norm(vectors[NORMAL]), dot(n, normal_rate)
    for i in range(3):
        normal_rate[i] = scale * (normal_rate[i] - along_n * n[i])


@kernel
def total_tangent_rate(system, c, body, a, out):
    """Total rate of a body's tangent t_a: at fixed coordinates, plus t_ab u_b'."""
    derivatives, rates = system.derivatives[2 * c + body], system.rates[c]
    tangent_at_fixed_u(system.frames[2 * c + body], derivatives, a, out)
    for b in range(system.contact_int[c, K1 + body]):
        for i in range(3):
            out[i] += derivatives[second_row(a, b), i] * rates[2 * body + b]


@kernel
def distance_to_ends(dimension, u, chart, ends, distance):
    """The least of distance and the parameters' distances from the ends (4,) of their domain, negative outside.

    Ends are those of the first chart; other charts stay away from them.
    """
    if chart == 0:
        for a in range(dimension):
            distance = min(distance, u[a] - ends[2 * a], ends[2 * a + 1] - u[a])
    return distance


@inlined_kernel
def constraint_rows(system, c):
    """rows[c] (3, nv) = basis . (J_2 - J_1), Jacobians of both material points at the contact."""
    nv, rows = system.sizes.nv, system.rows[c]
    for row in range(3):
        for k in range(nv):
            rows[row, k] = 0.0
    for body in range(2):
        add_point_rows(system, c, body)
    for row in range(3):
        drop_round_off(system, c, row)


@kernel
def add_point_rows(system, c, body):
    """Add the part of one body to `constraint_rows`, over the coordinates that move it.

    jacobian (nv, 6): one joint Jacobian column a row, linear part at the world's origin, then angular.
    """
    side, sign, point, moments = 2 * c + body, 2.0 * body - 1.0, system.vectors[0], system.vectors[1:4]
    basis, rows, frame, rho = system.basis[c], system.rows[c], system.frames[side], system.derivatives[side, 0]
    jacobian, support = system.jacobian, system.support[side]
    count = system.side_int[side, SUPPORT_SIZE]
    if count == 0:
        return
    for i in range(3):
        point[i] = frame[ORIGIN, i] + rho[i]
    for row in range(3):
        cross(point, basis[row], moments[row])
    for index in range(count):
        column = support[index]
        entry = jacobian[column]
        for row in range(3):
            rows[row, column] += sign * (
                basis[row, 0] * entry[0]
                + basis[row, 1] * entry[1]
                + basis[row, 2] * entry[2]
                + moments[row, 0] * entry[3]
                + moments[row, 1] * entry[4]
                + moments[row, 2] * entry[5]
            )


@kernel
def drop_round_off(system, c, number):
    """Zero a row of contact c of which nothing is left but round-off: no joint moves the contact along it.

    Each entry is the sum of what one joint moves both bodies by; the row is held against the largest term.
    """
    row, largest = system.rows[c, number], 0.0
    for k in range(system.sizes.nv):
        largest = max(largest, abs(row[k]))
        if largest > _SMALL_ROW:
            return
    size = 0.0
    for side in range(2 * c, 2 * c + 2):
        reach = 0.0
        for i in range(3):
            reach = max(reach, max(abs(system.frames[side, ORIGIN, i]), abs(system.derivatives[side, 0, i])))
        for index in range(system.side_int[side, SUPPORT_SIZE]):
            entry = system.jacobian[system.support[side, index]]
            for i in range(3):
                size = max(size, max(abs(entry[i]), reach * abs(entry[3 + i])))
    if largest <= ROW_ROUND_OFF * size:
        for k in range(system.sizes.nv):
            row[k] = 0.0


@kernel
def add_rotation_row(sign, jacobian, support, count, about, row):
    """row += sign * about . J_omega of a body, over the coordinates that move it; jacobian as for `add_point_rows`."""
    for index in range(count):
        column = support[index]
        entry = jacobian[column]
        row[column] += sign * (about[0] * entry[3] + about[1] * entry[4] + about[2] * entry[5])
