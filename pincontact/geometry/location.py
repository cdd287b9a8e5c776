"""Contact coordinates: conditions C1 and C2, their values and their rates (Eqs. 1-7).

Of the m equations, k well-conditioned ones are solved for the contact coordinates p = (u_1, u_2): C1 projected on
the tangents, t . (r_2 - r_1) = 0, and C2, N . t_1 = 0 with N the normal of body 2. What is left of C1 is the gap
along the normal. Written so, p is a smooth function of (q, t) also off the constraint, and the gap's rate is
exactly the normal component of v_c.
"""

from __future__ import annotations

import math

from ..contours.base import CYLINDER, ELLIPSE, ELLIPSOID, LINE, PLANE, POINT, SPHERE
from ..jit import kernel
from ..layout import K1, K2, LENGTH, PATTERN
from .carriers import OMEGA, ORIGIN
from .patterns import CROSSING_CURVES, ON_SURFACE, PLANAR
from .small import add_cross, cross, dot, norm, rotate_back

# Steps of Newton's method, which needs one or two from a start nearby.
NEWTON_LIMIT = 30
# A Newton step below this (relative to the parameter's natural length) leaves an error below round-off: it is squared.
NEWTON_STEP = 1e-8
# Below this dimensionless determinant the point contact is taken as degenerate (line, area or double contact).
SINGULAR_LIMIT = 1e-7

# A line in the plane of motion is like a plane across that.
NO_CLOSED_FORM, POINT_ON_PLANE, ROUND_ON_PLANE, POINT_ON_SPHERE, SPHERE_ON_SPHERE, CYLINDERS = range(6)
# Solutions of each closed form, as the branch that names one.
BRANCHES = {
    POINT_ON_PLANE: (1,),
    ROUND_ON_PLANE: (-1, 1),
    POINT_ON_SPHERE: (-1, 1),
    SPHERE_ON_SPHERE: (-2, -1, 1, 2),
    CYLINDERS: (1,),
}


def closed_form(pattern: int, kind1: int, kind2: int, bilateral: bool = False) -> int:
    """Which closed form gives the contact coordinates of two kinds of contours in a pattern, if any. Of cylinders it is
    that of what is beside each other, and has no others: of those within each other none would touch at one point."""
    is_flat = kind2 == PLANE or (kind2 == LINE and pattern == PLANAR)
    if is_flat and kind1 == POINT:
        return POINT_ON_PLANE
    if is_flat and kind1 in (ELLIPSE, SPHERE, ELLIPSOID):
        return ROUND_ON_PLANE
    if kind2 == SPHERE and kind1 in (POINT, SPHERE):
        return POINT_ON_SPHERE if kind1 == POINT else SPHERE_ON_SPHERE
    if kind1 == kind2 == CYLINDER and not bilateral:
        return CYLINDERS
    return NO_CLOSED_FORM


@kernel
def second_row(a, b):
    """Row of the derivative array that holds f_ab (a, b = 0, 1)."""
    return 3 + a + b


@kernel
def cross_second(pattern, first, second, vectors, x, out):
    """out = x x s, of the unnormalised normal N = t x s (e_1 x e_2 of Definition 5), t body 2's first tangent."""
    if pattern == ON_SURFACE:
        cross(x, second[2], out)
    elif pattern == PLANAR:
        cross(x, vectors[PLANE_NORMAL], out)
    else:
        cross(x, first[1], out)


# Rows of the scratch array `vectors` that belong to the contact under evaluation: r_2 - r_1, N, and the plane's normal
# of planar patterns; from FREE_VECTORS on they are anybody's.
DIFFERENCE, NORMAL, PLANE_NORMAL, FREE_VECTORS = range(4)
_RATE, _NORMAL_RATE = FREE_VECTORS, FREE_VECTORS + 1
# Rows of `location_system`: of the equations of C1 (symmetric: 11, 12, 22) the block of u_2; of each parameter a of
# body 1 what it adds to both of these (2), what u_2 adds to its own equation (2), and what both parameters do (2);
# right-hand sides of C1 (2), then of body 1's equations (2), and in their place the solution, u_1 (2), then u_2 (2).
_METRIC, _BODY_1, SIDES = 0, 1, 3


@kernel
def location_jacobian(system, c):
    """J = df/dp (Eq. 5) by blocks: k2 equations of C1, then k1, one for each parameter of body 1."""
    pattern, k1, k2 = system.contact_int[c, PATTERN], system.contact_int[c, K1], system.contact_int[c, K2]
    first, second = system.derivatives[2 * c], system.derivatives[2 * c + 1]
    vectors, equations = system.vectors, system.location_system
    difference, tangent, metric = vectors[DIFFERENCE], second[1], equations[_METRIC]
    metric[0] = dot(second[3], difference) + dot(tangent, tangent)
    if k2 == 2:
        metric[1] = dot(second[4], difference) + dot(tangent, second[2])
        metric[2] = dot(second[5], difference) + dot(second[2], second[2])
    if k1 == 0:
        return
    # dN / du_2
    turned, other = vectors[_RATE], vectors[_NORMAL_RATE]
    if pattern != CROSSING_CURVES:
        for b in range(k2):
            cross_second(pattern, first, second, vectors, second[3 + b], vectors[_RATE + b])
            if pattern == ON_SURFACE:
                add_cross(tangent, second[4 + b], vectors[_RATE + b])
    for a in range(k1):
        along, row = first[1 + a], equations[_BODY_1 + a]
        row[0] = -dot(tangent, along)
        if k2 == 2:
            row[1], row[3] = -dot(second[2], along), dot(other, along)
        if pattern == CROSSING_CURVES:
            row[2], row[4] = dot(along, tangent), dot(first[3], difference) - dot(along, along)
        else:
            row[2] = dot(turned, along)
            for b in range(k1):
                row[4 + b] = dot(vectors[NORMAL], first[second_row(a, b)])


@kernel
def location_residual(system, c):
    """Minus the k equations, as right-hand sides."""
    integers, vectors, sides = system.contact_int[c], system.vectors, system.location_system[SIDES]
    first, second = system.derivatives[2 * c], system.derivatives[2 * c + 1]
    for a in range(integers[K2]):
        sides[a] = -dot(second[1 + a], vectors[DIFFERENCE])
    across = vectors[DIFFERENCE if integers[PATTERN] == CROSSING_CURVES else NORMAL]
    for a in range(integers[K1]):
        sides[2 + a] = -dot(first[1 + a], across)


@kernel
def _solve_two(a, b, c, d, x, y):
    """The determinant of [[a, b], [c, d]], and the solution of (x, y), zeros where there is none."""
    determinant = a * d - b * c
    if determinant == 0.0:
        return 0.0, 0.0, 0.0
    scale = 1.0 / determinant
    return determinant, scale * (d * x - b * y), scale * (a * y - c * x)


@kernel
def solve_location(k1, k2, equations):
    """The solution of J p = right-hand sides, in their place. Returns det J; 0 leaves them as they are.

    The equations of C1 are solved for u_2 first. Their block is the metric of body 2, changed by a gap over its radii
    of curvature, and singular only where body 1 is at its focus; what is left has as many unknowns as body 1 has
    parameters.
    """
    metric, sides, row, below = equations[_METRIC], equations[SIDES], equations[_BODY_1], equations[_BODY_1 + 1]
    m11, m12, m22, side, row_1, row_3 = metric[0], metric[1], metric[2], sides[1], row[1], row[3]
    if k2 == 1:
        # as with a second parameter that nothing depends on
        m12, m22, side, row_1, row_3 = 0.0, 1.0, 0.0, 0.0, 0.0
    # u_2 = p - x u_1, or p - x u_11 - y u_12
    regular, p1, p2 = _solve_two(m11, m12, m12, m22, sides[0], side)
    if regular == 0.0:
        return 0.0
    if k1 == 0:
        sides[2], sides[3] = p1, p2
        return regular
    _, x1, x2 = _solve_two(m11, m12, m12, m22, row[0], row_1)
    first = row[4] - row[2] * x1 - row_3 * x2
    right = sides[2] - row[2] * p1 - row_3 * p2
    if k1 == 1:
        if first == 0.0:
            return 0.0
        u = right / first
        sides[0], sides[2], sides[3] = u, p1 - x1 * u, p2 - x2 * u
        # of two curves the columns are in the other order
        return regular * first if k2 == 2 else -regular * first
    _, y1, y2 = _solve_two(m11, m12, m12, m22, below[0], below[1])
    second = row[5] - row[2] * y1 - row[3] * y2
    third = below[4] - below[2] * x1 - below[3] * x2
    fourth = below[5] - below[2] * y1 - below[3] * y2
    rest, u, v = _solve_two(first, second, third, fourth, right, sides[3] - below[2] * p1 - below[3] * p2)
    if rest == 0.0:
        return 0.0
    sides[0], sides[1] = u, v
    sides[2], sides[3] = p1 - x1 * u - y1 * v, p2 - x2 * u - y2 * v
    return regular * rest


@kernel
def tangent_at_fixed_u(frame, derivatives, a, out):
    """Rate of the tangent t_a at fixed contact coordinates: omega x t_a + R d2c/du dt."""
    for i in range(3):
        out[i] = derivatives[7 + a, i]
    add_cross(frame[OMEGA], derivatives[1 + a], out)


@kernel
def rate_equations(system, c):
    """Minus (f_q q' + f_t) of the k equations (Eq. 5), as right-hand sides."""
    pattern, k1, k2 = system.contact_int[c, PATTERN], system.contact_int[c, K1], system.contact_int[c, K2]
    first, second = system.derivatives[2 * c], system.derivatives[2 * c + 1]
    frame1, frame2, slip = system.frames[2 * c], system.frames[2 * c + 1], system.slip[c]
    vectors, sides = system.vectors, system.location_system[SIDES]
    rate, normal_rate = vectors[_RATE], vectors[_NORMAL_RATE]
    for a in range(k2):
        tangent_at_fixed_u(frame2, second, a, rate)
        sides[a] = -dot(second[1 + a], slip) - dot(rate, vectors[DIFFERENCE])
    if pattern == CROSSING_CURVES:
        tangent_at_fixed_u(frame1, first, 0, rate)
        sides[2] = -dot(first[1], slip) - dot(rate, vectors[DIFFERENCE])
    elif k1 > 0:
        tangent_at_fixed_u(frame2, second, 0, rate)
        cross_second(pattern, first, second, vectors, rate, normal_rate)
        if pattern == ON_SURFACE:
            tangent_at_fixed_u(frame2, second, 1, rate)
        else:
            cross(frame2[OMEGA], vectors[PLANE_NORMAL], rate)
        add_cross(second[1], rate, normal_rate)
        for a in range(k1):
            tangent_at_fixed_u(frame1, first, a, rate)
            sides[2 + a] = -dot(normal_rate, first[1 + a]) - dot(vectors[NORMAL], rate)


@kernel
def conditioning(system, c, determinant):
    """|det J| without units: 1 for well-placed equations, 0 where the contact degenerates.

    Rows and columns are divided by the tangents' lengths, the rows of C2 (curvatures) multiplied by length in m.
    """
    integers = system.contact_int[c]
    for a in range(integers[K2]):
        tangent = system.derivatives[2 * c + 1, 1 + a]
        determinant /= dot(tangent, tangent)
    for a in range(integers[K1]):
        tangent = system.derivatives[2 * c, 1 + a]
        determinant /= dot(tangent, tangent)
        if integers[PATTERN] != CROSSING_CURVES:
            determinant *= system.contact_real[c, LENGTH] / norm(system.vectors[NORMAL])
    return determinant


@kernel
def unwrapped(angle, near):
    """The representative of angle (mod 2 pi) nearest to `near`."""
    return angle + 2.0 * math.pi * round((near - angle) / (2.0 * math.pi))


@kernel
def round_on_plane(kind, chart, shape, frame1, frame2, k2, branch, location, scratch):
    """Location of a circle, ellipse, sphere or ellipsoid on a plane, or a line: its extreme point along the normal.

    branch: +1 for the extreme point along +e_3, -1 along -e_3.
    Sets u_1; returns False where the direction is undefined (a disk that lies flat).
    """
    direction, local = scratch[0], scratch[1]
    for i in range(3):
        direction[i] = branch * (frame2[i, 2] if k2 == 2 else -frame2[i, 1])
    rotate_back(frame1[0:3], direction, local)
    # the parameter circle's or sphere's point is proportional to (a n_x, b n_y, c n_z)
    for i in range(3):
        local[i] *= shape[i]
    if kind != ELLIPSE:
        _set_angles(chart, local, location[0:2])
        return True
    if local[0] == 0.0 and local[1] == 0.0:
        return False
    location[0] = unwrapped(math.atan2(local[1], local[0]), location[0])
    return True


@kernel
def _set_angles(chart, local, u):
    """Parameters u (2,) of a sphere's point in the direction local (3,); chart 1 turns the axes cyclically."""
    x, y, z = local[0], local[1], local[2]
    if chart == 1:
        x, y, z = local[1], local[2], local[0]
    u[0] = unwrapped(math.atan2(y, x), u[0])
    u[1] = math.atan2(z, math.hypot(x, y))


@kernel
def nearest_on_sphere(form, charts, frame1, frame2, branch, location, scratch):
    """Location of a point or a sphere on a sphere: on the line through both centres.

    The sign of the branch tells on which side of its centre body 2 is touched, +1 towards body 1. A sphere that is
    body 1 is touched on the opposite side of its own centre if |branch| is 1 (one beside the other), on the same side
    if it is 2 (one within the other). Returns False where the centres coincide.
    """
    apart, local = scratch[0], scratch[1]
    side = 1.0 if branch > 0 else -1.0
    for i in range(3):
        apart[i] = side * (frame1[ORIGIN, i] - frame2[ORIGIN, i])
    if apart[0] == 0.0 and apart[1] == 0.0 and apart[2] == 0.0:
        return False
    rotate_back(frame2[0:3], apart, local)
    _set_angles(charts[1], local, location[2:4])
    if form == SPHERE_ON_SPHERE:
        rotate_back(frame1[0:3], apart, local)
        if abs(branch) == 1:
            for i in range(3):
                local[i] = -local[i]
        _set_angles(charts[0], local, location[0:2])
    return True


@kernel
def nearest_of_cylinders(frame1, frame2, location, scratch):
    """Location of cylinders beside each other: on the line across both axes. Returns False where these are parallel."""
    first, second, normal, apart, across = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    for i in range(3):
        first[i], second[i], apart[i] = frame1[i, 2], frame2[i, 2], frame2[ORIGIN, i] - frame1[ORIGIN, i]
    cross(first, second, normal)
    square = dot(normal, normal)
    if not square > SINGULAR_LIMIT:
        return False
    # apart = s_1 first - s_2 second + m normal
    cross(apart, second, across)
    location[1] = dot(across, normal) / square
    cross(apart, first, across)
    location[3] = dot(across, normal) / square
    towards = 1.0 if dot(apart, normal) >= 0.0 else -1.0
    for body in range(2):
        direction, local = scratch[3], scratch[4]
        for i in range(3):
            direction[i] = (1 - 2 * body) * towards * normal[i]
        rotate_back((frame1 if body == 0 else frame2)[0:3], direction, local)
        location[2 * body] = unwrapped(math.atan2(local[1], local[0]), location[2 * body])
    return True


@kernel
def point_to_plane(point_w, frame2, k2, location):
    """Parameters of a plane, or a line, nearest to a world point."""
    x = point_w[0] - frame2[ORIGIN, 0]
    y = point_w[1] - frame2[ORIGIN, 1]
    z = point_w[2] - frame2[ORIGIN, 2]
    location[2] = frame2[0, 0] * x + frame2[1, 0] * y + frame2[2, 0] * z
    if k2 == 2:
        location[3] = frame2[0, 1] * x + frame2[1, 1] * y + frame2[2, 1] * z
