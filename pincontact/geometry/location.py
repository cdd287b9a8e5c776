"""Location parameters: conditions C1 and C2, their values and their rates (Eqs. 1-7).

Of the m equations, k well-conditioned ones are solved for the location parameters p = (u_1, u_2): C1 projected on
the tangents, t . (r_2 - r_1) = 0, and C2, N . t_1 = 0 with N the normal of body 2. What is left of C1 is the gap
along the normal. Written so, p is a smooth function of (q, t) also off the constraint, and the gap's rate is
exactly the normal component of v_c.
"""

from __future__ import annotations

import math

from ..contours.base import CIRCLE, ELLIPSE, ELLIPSOID, PLANE, POINT, SPHERE
from ..jit import kernel
from .carriers import OMEGA, ORIGIN
from .patterns import CROSSING_CURVES, ON_SURFACE, PLANAR
from .small import add_cross, cross, dot, norm, rotate_back

NEWTON_LIMIT = 30
# A Newton step below this (relative to the parameter's natural length) leaves an error below round-off: it is squared.
NEWTON_STEP = 1e-8
# Below this dimensionless determinant the point contact is taken as degenerate (line, area or double contact).
SINGULAR_LIMIT = 1e-7

NO_CLOSED_FORM, POINT_ON_PLANE, ROUND_ON_PLANE, POINT_ON_SPHERE, SPHERE_ON_SPHERE = range(5)
# Solutions of each closed form, as the branch that names one.
BRANCHES = {
    POINT_ON_PLANE: (1,),
    ROUND_ON_PLANE: (-1, 1),
    POINT_ON_SPHERE: (-1, 1),
    SPHERE_ON_SPHERE: (-2, -1, 1, 2),
}


def closed_form(kind1: int, kind2: int) -> int:
    """Which closed form solves the location equations of two kinds of contours, if any."""
    if kind2 == PLANE and kind1 == POINT:
        return POINT_ON_PLANE
    if kind2 == PLANE and kind1 in (CIRCLE, ELLIPSE, SPHERE, ELLIPSOID):
        return ROUND_ON_PLANE
    if kind2 == SPHERE and kind1 in (POINT, SPHERE):
        return POINT_ON_SPHERE if kind1 == POINT else SPHERE_ON_SPHERE
    return NO_CLOSED_FORM


@kernel
def second_row(a, b):
    """Row of the derivative array that holds f_ab (a, b = 0, 1)."""
    return 3 + a + b


@kernel
def raw_normal(pattern, first, second, frame2, out, k_axis):
    """N, the unnormalised normal e_1 x e_2 of Definition 5; k_axis receives the plane's normal of planar patterns."""
    if pattern == ON_SURFACE:
        cross(second[1], second[2], out)
    elif pattern == PLANAR:
        for i in range(3):
            k_axis[i] = frame2[i, 2]
        cross(second[1], k_axis, out)
    elif pattern == CROSSING_CURVES:
        cross(second[1], first[1], out)


@kernel
def location_jacobian(pattern, k1, k2, first, second, difference, normal, k_axis, system, scratch):
    """J = df/dp (Eq. 5) in the first k columns of system; the unknowns are u_1 then u_2."""
    for a in range(k2):
        tangent = second[1 + a]
        for b in range(k1):
            system[a, b] = -dot(tangent, first[1 + b])
        for b in range(k2):
            system[a, k1 + b] = dot(second[second_row(a, b)], difference) + dot(tangent, second[1 + b])
    if pattern == CROSSING_CURVES:
        system[1, 0] = dot(first[3], difference) - dot(first[1], first[1])
        system[1, 1] = dot(first[1], second[1])
    elif k1 > 0:
        for b in range(k2):
            if pattern == ON_SURFACE:
                cross(second[second_row(0, b)], second[2], scratch)
                add_cross(second[1], second[second_row(1, b)], scratch)
            else:
                cross(second[3], k_axis, scratch)
            for a in range(k1):
                system[k2 + a, k1 + b] = dot(scratch, first[1 + a])
        for a in range(k1):
            for b in range(k1):
                system[k2 + a, b] = dot(normal, first[second_row(a, b)])


@kernel
def location_residual(pattern, k1, k2, first, second, difference, normal, system, column):
    """Minus the k equations, into one column of system."""
    for a in range(k2):
        system[a, column] = -dot(second[1 + a], difference)
    if pattern == CROSSING_CURVES:
        system[1, column] = -dot(first[1], difference)
    elif k1 > 0:
        for a in range(k1):
            system[k2 + a, column] = -dot(normal, first[1 + a])


@kernel
def tangent_at_fixed_u(frame, derivatives, a, out):
    """Rate of the tangent t_a at fixed location parameters: omega x t_a + R d2c/du dt."""
    for i in range(3):
        out[i] = derivatives[7 + a, i]
    add_cross(frame[OMEGA], derivatives[1 + a], out)


@kernel
def rate_equations(
    pattern,
    k1,
    k2,
    frame1,
    frame2,
    first,
    second,
    difference,
    velocity,
    normal,
    k_axis,
    system,
    column,
    scratch,
):
    """Minus (f_q q' + f_t) of the k equations (Eq. 5), into one column of system. velocity: v_c."""
    rate = scratch[0]
    for a in range(k2):
        tangent_at_fixed_u(frame2, second, a, rate)
        system[a, column] = -dot(second[1 + a], velocity) - dot(rate, difference)
    if pattern == CROSSING_CURVES:
        tangent_at_fixed_u(frame1, first, 0, rate)
        system[1, column] = -dot(first[1], velocity) - dot(rate, difference)
    elif k1 > 0:
        normal_rate = scratch[1]
        tangent_at_fixed_u(frame2, second, 0, rate)
        if pattern == ON_SURFACE:
            cross(rate, second[2], normal_rate)
            tangent_at_fixed_u(frame2, second, 1, rate)
            add_cross(second[1], rate, normal_rate)
        else:
            cross(rate, k_axis, normal_rate)
            cross(frame2[OMEGA], k_axis, rate)
            add_cross(second[1], rate, normal_rate)
        for a in range(k1):
            tangent_at_fixed_u(frame1, first, a, rate)
            system[k2 + a, column] = -dot(normal_rate, first[1 + a]) - dot(normal, rate)


@kernel
def conditioning(pattern, k1, k2, first, second, normal, length, determinant):
    """|det J| without units: 1 for well-placed equations, 0 where the contact degenerates.

    Rows and columns are divided by the tangents' lengths, the rows of C2 (curvatures) multiplied by length in m.
    """
    for a in range(k2):
        determinant /= dot(second[1 + a], second[1 + a])
    for a in range(k1):
        determinant /= dot(first[1 + a], first[1 + a])
        if pattern != CROSSING_CURVES:
            determinant *= length / norm(normal)
    return determinant


@kernel
def unwrapped(angle, near):
    """The representative of angle (mod 2 pi) nearest to `near`."""
    return angle + 2.0 * math.pi * round((near - angle) / (2.0 * math.pi))


@kernel
def round_on_plane(kind, chart, shape, frame1, frame2, branch, location, scratch):
    """Location of a circle, ellipse, sphere or ellipsoid on a plane: its extreme point along the plane's normal.

    branch: +1 for the extreme point along +e_3, -1 along -e_3.
    Sets u_1; returns False where the direction is undefined (a disk that lies flat).
    """
    direction, local = scratch[0], scratch[1]
    for i in range(3):
        direction[i] = branch * frame2[i, 2]
    rotate_back(frame1[0:3], direction, local)
    if kind == CIRCLE:
        if local[0] == 0.0 and local[1] == 0.0:
            return False
        location[0] = unwrapped(math.atan2(local[1], local[0]), location[0])
    elif kind == ELLIPSE:
        if local[0] == 0.0 and local[1] == 0.0:
            return False
        location[0] = unwrapped(math.atan2(shape[1] * local[1], shape[0] * local[0]), location[0])
    else:
        # the parameter sphere's point is proportional to (a n_x, b n_y, c n_z)
        if kind == ELLIPSOID:
            for i in range(3):
                local[i] *= shape[i]
        _set_angles(chart, local, location[0:2])
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
def point_to_plane(point_w, frame2, location):
    """Parameters of a plane nearest to a world point."""
    x = point_w[0] - frame2[ORIGIN, 0]
    y = point_w[1] - frame2[ORIGIN, 1]
    z = point_w[2] - frame2[ORIGIN, 2]
    location[2] = frame2[0, 0] * x + frame2[1, 0] * y + frame2[2, 0] * z
    location[3] = frame2[0, 1] * x + frame2[1, 1] * y + frame2[2, 1] * z
