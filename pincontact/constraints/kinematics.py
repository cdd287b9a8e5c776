"""Kinematics of one contact: location, basis, relative velocity, gap, location rates, constraint rows and biases.

Everything is formed in an orthonormal basis at the contact, rows (t1, second, n): t1 the tangent e_1 of body 2, n the
unit normal that points from body 1 into body 2 (so the gap n . (r_2 - r_1) is positive when the bodies are apart and
a compressive force on body 2 is positive), second the other tangent, or the second normal of a point on a spatial
curve. The oblique contact frame of the paper is made from it for reports only (`geometry.frames`).
"""

from __future__ import annotations

import math

from ..arrays import address
from ..contours.evaluation import call_contour
from ..geometry.carriers import point_bias, point_velocity
from ..geometry.frames import STEEP
from ..geometry.location import (
    NEWTON_LIMIT,
    NEWTON_STEP,
    NO_CLOSED_FORM,
    POINT_ON_PLANE,
    POINT_ON_SPHERE,
    ROUND_ON_PLANE,
    SIDES,
    SINGULAR_LIMIT,
    SPHERE_ON_SPHERE,
    conditioning,
    location_jacobian,
    location_residual,
    nearest_on_sphere,
    point_to_plane,
    rate_equations,
    raw_normal,
    round_on_plane,
    second_row,
    solve_location,
    tangent_at_fixed_u,
)
from ..geometry.patterns import CROSSING_CURVES, ON_CURVE, ON_SURFACE, PLANAR
from ..geometry.small import add_cross, cross, dot, norm, rotate
from ..jit import kernel
from ..layout import (
    BRANCH,
    CHART,
    CLOSED_FORM,
    CONDITION,
    DETERMINANT_SIGN,
    EVALUATOR,
    K1,
    K2,
    KIND,
    LAST_NORMAL_X,
    LENGTH,
    LOCATION_FAILED,
    OK,
    PATTERN,
    POOL_ADDRESS,
    POOL_SIZE,
    SIDE,
    SINGULAR,
    TIME_DEPENDENT,
)

# rows of the scratch array `vectors`
_DIFFERENCE, _NORMAL, _K_AXIS, _V1, _V2, _A, _B, _C, _D, NORMAL_RATE = range(10)


@kernel
def shape_in_world(integers, shape, frame, u1, u2, dimension, time, local, world):
    """Evaluate a contour and turn its derivatives to world axes."""
    call_contour(
        integers[EVALUATOR],
        integers[CHART],
        address(shape),
        integers[POOL_ADDRESS],
        integers[POOL_SIZE],
        u1,
        u2,
        time,
        address(local),
    )
    rotation = frame[0:3]
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
def point_difference(frame1, frame2, first, second, out):
    """r_2 - r_1, world axes."""
    for i in range(3):
        out[i] = (frame2[3, i] - frame1[3, i]) + (second[0, i] - first[0, i])


@kernel
def locate(
    integers,
    numbers,
    side1,
    side2,
    shape1,
    shape2,
    frame1,
    frame2,
    first,
    second,
    location,
    time,
    scratch,
    counters,
):
    """Location parameters of one contact, from the guess in `location` (4,), and both contours evaluated there.

    Returns OK, LOCATION_FAILED (Newton did not converge, or left its branch) or SINGULAR.
    scratch: (vectors, local, system).
    """
    vectors, local, system = scratch
    pattern, k1, k2 = integers[PATTERN], integers[K1], integers[K2]
    difference, normal, k_axis = vectors[_DIFFERENCE], vectors[_NORMAL], vectors[_K_AXIS]
    if integers[CLOSED_FORM] != NO_CLOSED_FORM:
        counters.closed_count += 1
        form, branch, found = integers[CLOSED_FORM], integers[BRANCH], True
        if form in (POINT_ON_SPHERE, SPHERE_ON_SPHERE):
            charts = (side1[CHART], side2[CHART])
            found = nearest_on_sphere(form, charts, frame1, frame2, branch, location, vectors[_A:_C])
        elif form == ROUND_ON_PLANE:
            found = round_on_plane(
                side1[KIND], side1[CHART], shape1, frame1, frame2, float(branch), location, vectors[_A:_C]
            )
        if not found:
            numbers[CONDITION] = 0.0
            return SINGULAR
        shape_in_world(side1, shape1, frame1, location[0], location[1], k1, time, local, first)
        if form in (POINT_ON_PLANE, ROUND_ON_PLANE):
            for i in range(3):
                vectors[_A, i] = frame1[3, i] + first[0, i]
            point_to_plane(vectors[_A], frame2, location)
        shape_in_world(side2, shape2, frame2, location[2], location[3], k2, time, local, second)
        point_difference(frame1, frame2, first, second, difference)
        raw_normal(pattern, first, second, frame2, normal, k_axis)
        return OK
    length = numbers[LENGTH]
    converged = False
    for _ in range(NEWTON_LIMIT):
        counters.newton_count += 1
        shape_in_world(side1, shape1, frame1, location[0], location[1], k1, time, local, first)
        shape_in_world(side2, shape2, frame2, location[2], location[3], k2, time, local, second)
        point_difference(frame1, frame2, first, second, difference)
        raw_normal(pattern, first, second, frame2, normal, k_axis)
        if converged:
            return OK
        location_jacobian(pattern, k1, k2, first, second, difference, normal, k_axis, system, vectors[_A:_C])
        location_residual(pattern, k1, k2, first, second, difference, normal, system)
        determinant = solve_location(k1, k2, system)
        if not abs(conditioning(pattern, k1, k2, first, second, normal, length, determinant)) > SINGULAR_LIMIT:
            numbers[CONDITION] = determinant
            return SINGULAR
        change, step = system[SIDES], 0.0
        for a in range(k1):
            step = max(step, abs(change[a]) * norm(first[1 + a]))
        for a in range(k2):
            step = max(step, abs(change[2 + a]) * norm(second[1 + a]))
        if not step < math.inf:
            return LOCATION_FAILED
        for a in range(k1):
            location[a] += change[a]
        for a in range(k2):
            location[2 + a] += change[2 + a]
        converged = step <= NEWTON_STEP * length
    return LOCATION_FAILED


@kernel
def basis_at_contact(pattern, side, first, second, normal, basis):
    """Orthonormal rows (t1, second, n) at the contact; n points from body 1 into body 2."""
    t1, other, n = basis[0], basis[1], basis[2]
    scale = 1.0 / norm(second[1])
    for i in range(3):
        t1[i] = second[1, i] * scale
    if pattern == ON_CURVE:
        # any two normals of the curve: made from the world axis that is least along it, z unless the curve climbs
        if abs(t1[2]) < STEEP:
            other[0], other[1], other[2] = -t1[2] * t1[0], -t1[2] * t1[1], 1.0 - t1[2] * t1[2]
        else:
            other[0], other[1], other[2] = 1.0 - t1[0] * t1[0], -t1[0] * t1[1], -t1[0] * t1[2]
        scale = 1.0 / norm(other)
        for i in range(3):
            other[i] *= scale
        cross(t1, other, n)
    else:
        scale = -side / norm(normal)
        for i in range(3):
            n[i] = normal[i] * scale
        cross(n, t1, other)


@kernel
def contact_kinematics(
    integers,
    numbers,
    side1,
    side2,
    shape1,
    shape2,
    frame1,
    frame2,
    first,
    second,
    location,
    time,
    basis,
    slip,
    gaps,
    rates,
    bias,
    with_bias,
    scratch,
    counters,
):
    """Location, basis, v_c, gaps, location rates (Eq. 6) and, where it is wanted, the bias of one contact.

    See `acceleration_bias`. Returns OK, LOCATION_FAILED or SINGULAR.
    """
    vectors, _local, system = scratch
    status = locate(
        integers,
        numbers,
        side1,
        side2,
        shape1,
        shape2,
        frame1,
        frame2,
        first,
        second,
        location,
        time,
        scratch,
        counters,
    )
    if status != OK:
        return status
    pattern, k1, k2 = integers[PATTERN], integers[K1], integers[K2]
    difference, normal, k_axis = vectors[_DIFFERENCE], vectors[_NORMAL], vectors[_K_AXIS]
    basis_at_contact(pattern, integers[SIDE], first, second, normal, basis)
    if pattern == CROSSING_CURVES and dot(basis[2], numbers[LAST_NORMAL_X : LAST_NORMAL_X + 3]) < 0.0:
        # the normal has turned over: the curves went through parallel within the step
        return LOCATION_FAILED
    gaps[0] = dot(basis[2], difference)
    gaps[1] = dot(basis[1], difference) if pattern == ON_CURVE else 0.0
    # relative velocity of the two material points (Eq. 10)
    v1, v2 = vectors[_V1], vectors[_V2]
    point_velocity(frame1, first[0], first[6], v1)
    point_velocity(frame2, second[0], second[6], v2)
    for i in range(3):
        slip[i] = v2[i] - v1[i]
    # location rates (Eq. 6)
    location_jacobian(pattern, k1, k2, first, second, difference, normal, k_axis, system, vectors[_A:_C])
    rate_equations(
        pattern, k1, k2, frame1, frame2, first, second, difference, slip, normal, k_axis, system, vectors[_A:_C]
    )
    determinant = solve_location(k1, k2, system)
    condition = conditioning(pattern, k1, k2, first, second, normal, numbers[LENGTH], determinant)
    numbers[CONDITION] = condition
    if not abs(condition) > SINGULAR_LIMIT:
        return SINGULAR
    if condition * integers[DETERMINANT_SIGN] < 0.0:
        return LOCATION_FAILED
    for a in range(4):
        rates[a] = 0.0
    for a in range(k1):
        rates[a] = system[SIDES, a]
    for a in range(k2):
        rates[2 + a] = system[SIDES, 2 + a]
    if with_bias:
        side = integers[SIDE]
        acceleration_bias(
            pattern, side, frame1, frame2, first, second, rates, basis, slip, normal, k_axis, vectors, k1, k2, bias
        )
    return OK


@kernel
def acceleration_bias(
    pattern, side, frame1, frame2, first, second, rates, basis, slip, normal, k_axis, vectors, k1, k2, bias
):
    """bias (3,): row . gamma + frame rate . v_c, so that row . (J_2 - J_1) a + bias is the rate of row . v_c.

    The rate of n is left in row NORMAL_RATE of the scratch vectors, but for a point on a spatial curve.
    """
    # bias of the relative acceleration: material points, then their shift along the contours
    gamma, part, scratch3, moving = vectors[_A], vectors[_B], vectors[_C], vectors[_D]
    point_bias(frame2, second[0], second[6], second[9], gamma, scratch3)
    point_bias(frame1, first[0], first[6], first[9], part, scratch3)
    for i in range(3):
        gamma[i] -= part[i]
    for a in range(k2):
        tangent_at_fixed_u(frame2, second, a, moving)
        for i in range(3):
            gamma[i] += moving[i] * rates[2 + a]
    for a in range(k1):
        tangent_at_fixed_u(frame1, first, a, moving)
        for i in range(3):
            gamma[i] -= moving[i] * rates[a]
    for row in range(3):
        bias[row] = dot(basis[row], gamma)
    # rate of the normal, which the slip velocity meets
    tangent_rate = vectors[_D]
    total_tangent_rate(frame2, second, 0, k2, rates[2:4], tangent_rate)
    if pattern == ON_CURVE:
        along = dot(basis[0], slip) / norm(second[1])
        bias[2] -= dot(basis[2], tangent_rate) * along
        bias[1] -= dot(basis[1], tangent_rate) * along
    else:
        normal_rate, other_rate = vectors[NORMAL_RATE], vectors[_B]
        if pattern == ON_SURFACE:
            cross(tangent_rate, second[2], normal_rate)
            total_tangent_rate(frame2, second, 1, k2, rates[2:4], other_rate)
            add_cross(second[1], other_rate, normal_rate)
        elif pattern == PLANAR:
            cross(tangent_rate, k_axis, normal_rate)
            cross(frame2[5], k_axis, other_rate)
            add_cross(second[1], other_rate, normal_rate)
        else:
            cross(tangent_rate, first[1], normal_rate)
            total_tangent_rate(frame1, first, 0, k1, rates[0:2], other_rate)
            add_cross(second[1], other_rate, normal_rate)
        # n' = -side (1 - n n^T) N' / |N|
        scale, along_n = -side / norm(normal), dot(basis[2], normal_rate)
        for i in range(3):
            normal_rate[i] = scale * (normal_rate[i] - along_n * basis[2, i])
        bias[2] += dot(slip, normal_rate)


@kernel
def distance_to_ends(dimension, u, chart, ends, distance):
    """The least of distance and the parameters' distances from the ends (4,) of their domain, negative outside.

    Ends are those of the first chart; other charts stay away from them.
    """
    if chart == 0:
        for a in range(dimension):
            distance = min(distance, u[a] - ends[2 * a], ends[2 * a + 1] - u[a])
    return distance


@kernel
def total_tangent_rate(frame, derivatives, a, dimension, rates, out):
    """Total rate of the tangent t_a: at fixed u, plus t_ab u_b'."""
    tangent_at_fixed_u(frame, derivatives, a, out)
    for b in range(dimension):
        for i in range(3):
            out[i] += derivatives[second_row(a, b), i] * rates[b]


@kernel
def add_point_rows(sign, jacobian, support, count, frame, rho, basis, rows, scratch):
    """rows += sign * basis . J of the material point at rho (world axes), over the coordinates that move it.

    jacobian (nv, 6): one joint Jacobian column a row, linear part at the world's origin, then angular.
    """
    point, moments = scratch[0], scratch[1:4]
    for i in range(3):
        point[i] = frame[3, i] + rho[i]
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
def add_rotation_row(sign, jacobian, support, count, about, row):
    """row += sign * about . J_omega of a body, over the coordinates that move it; jacobian as for `add_point_rows`."""
    for index in range(count):
        column = support[index]
        entry = jacobian[column]
        row[column] += sign * (about[0] * entry[3] + about[1] * entry[4] + about[2] * entry[5])
