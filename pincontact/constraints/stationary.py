"""Stationary points of the distance between two contours: Newton's method from a start, and what it has found."""

from __future__ import annotations

import math

from ..arrays import array_entry
from ..contours.base import F_11, F_12, F_22
from ..contours.charts import is_across_pole, turned_back
from ..geometry.carriers import ORIGIN
from ..geometry.chart_changes import change_charts
from ..geometry.location import ROUND_ON_PLANE
from ..geometry.patterns import CROSSING_CURVES, ON_CURVE
from ..geometry.small import dot
from ..jit import CALLED, INTEGER, REAL, kernel
from ..layout import (
    BRANCH,
    CHART,
    CLOSED_FORM,
    CONDITION,
    FREE,
    K1,
    K2,
    KIND,
    LOCATION_FAILED,
    MODE,
    OK,
    PATTERN,
    SIDE,
    system_at,
)
from .kinematics import contact_kinematics

# What is found: columns of integers, and of reals: contact coordinates (4), signed distance in m along the normal of
# the side assumed, points (3) of body 1 and body 2 in m, in the world.
STATUS, FOUND_SIDE, FOUND_SIGN, FOUND_CHARTS, INTEGERS_FOUND = 0, 1, 2, 3, 5
COORDINATES, GAP, POINTS, REALS_FOUND = 0, 4, 5, 11

# Parallel surfaces on which areas are less than this part of what they are on the surface tell no sides.
_TOWARDS = 0.5


@array_entry(INTEGER, REAL[:, ::1], INTEGER[::1], INTEGER[:, ::1], INTEGER[:, ::1], REAL[:, ::1], when=CALLED)
def find_stationary(address, starts, branches, charts, integers, reals):
    """Where Newton's method leads from starts (n, 4) for the only contact of a system whose contours are placed.
    branches (n,): of closed forms; charts (m, 2): pairs in which a start is tried until it leads anywhere; it is in
    the first. integers (n, 5), reals (n, 11): of what is found, with a status of `layout`.
    """
    system = system_at(address)
    mode = system.contact_int[0, MODE]
    # as if it were open, so that it is not found at a pole
    system.contact_int[0, MODE] = FREE
    for i in range(starts.shape[0]):
        system.contact_int[0, BRANCH] = branches[i]
        integers[i, STATUS] = _find(system, starts[i], charts)
        if integers[i, STATUS] == OK:
            _describe(system, branches[i], integers[i], reals[i])
    system.contact_int[0, MODE] = mode


@kernel
def _find(system, start, charts):
    location, status = system.location[0], LOCATION_FAILED
    for k in range(charts.shape[0]):
        # a start near a pole is better off in another chart, and one right at it fails in its own
        for side in range(2):
            system.side_int[side, CHART] = charts[k, side]
            for a in range(2 * side, 2 * side + 2):
                location[a] = start[a] if charts[k, side] == charts[0, side] else 0.0
        if k == 0:
            _choose_charts(system)
        status = contact_kinematics(system, 0, False)
        # also where Newton's method ended at a pole
        if status in (OK, LOCATION_FAILED) and _choose_charts(system):
            status = contact_kinematics(system, 0, False)
        # there normals would be turned inside out
        if status == OK and _turn_back(system):
            status = contact_kinematics(system, 0, False)
        if status == OK:
            return OK
    return status


@kernel
def _turn_back(system):
    """Have the same points in parameters that have run over no poles of their charts; whether any had."""
    location, turned = system.location[0], False
    for side in range(2):
        ints, shape, k = system.side_int[side], system.side_shape[side], 2 * side
        if is_across_pole(ints[KIND], ints[CHART], shape, location[k + 1]):
            location[k], location[k + 1] = turned_back(ints[KIND], ints[CHART], shape, location[k], location[k + 1])
            turned = True
    return turned


@kernel
def _choose_charts(system):
    """Move the contact coordinates to better charts; whether any were."""
    if system.counters.charted == 0:
        return False
    first, location = system.sizes.nq + system.sizes.nv, system.location[0]
    for a in range(4):
        system.state[first + a] = location[a]
    changed = change_charts(system) > 0
    for a in range(4):
        location[a] = system.state[first + a]
    return changed


@kernel
def _describe(system, branch, integers, reals):
    """What was found."""
    ints, condition = system.contact_int[0], system.contact_real[0, CONDITION]
    side = -branch if ints[CLOSED_FORM] == ROUND_ON_PLANE else _bending_side(system)
    integers[FOUND_SIDE], integers[FOUND_SIGN] = side, int(condition > 0.0) - int(condition < 0.0)
    gap = system.gaps[0, 0]
    if ints[PATTERN] == ON_CURVE:
        gap = math.hypot(gap, system.gaps[0, 1])
    elif side * ints[SIDE] < 0:
        gap = -gap
    reals[GAP] = gap
    for a in range(4):
        reals[COORDINATES + a] = system.location[0, a]
    for body in range(2):
        integers[FOUND_CHARTS + body] = system.side_int[body, CHART]
        for i in range(3):
            reals[POINTS + 3 * body + i] = system.frames[body, ORIGIN, i] + system.derivatives[body, 0, i]


@kernel
def _bending_side(system):
    """Side of body 2 towards which body 1 bends away from it where they touch, and from what is as far from body 2 as
    body 1 is, where they are apart; 0 for points, for crossing curves, and where these are not one definite side."""
    integers = system.contact_int[0]
    if integers[K1] == 0 or integers[PATTERN] == CROSSING_CURVES:
        return 0
    first, second = system.derivatives[0], system.derivatives[1]
    normal, sign, gap = system.basis[0, 2], -float(integers[SIDE]), 0.0
    for i in range(3):
        way = system.frames[0, ORIGIN, i] + first[0, i] - system.frames[1, ORIGIN, i] - second[0, i]
        gap += sign * normal[i] * way
    side = _bending_side_at(system, 0.0)
    return side if side == _bending_side_at(system, gap) else 0


@kernel
def _bending_side_at(system, gap):
    """Side of the parallel surface of body 2 at a gap in m towards which body 1 bends away from it, or 0.

    With m and l the fundamental forms of body 2 along e_3, that surface has the curvature b . m^-1 l p along a tangent
    with the products b with those of body 2, where (m - gap l) p = b.
    """
    k1, k2 = system.contact_int[0, K1], system.contact_int[0, K2]
    first, second = system.derivatives[0], system.derivatives[1]
    normal, sign = system.basis[0, 2], -float(system.contact_int[0, SIDE])
    m11, m12, m22 = dot(second[1], second[1]), 0.0, 1.0
    l11, l12, l22 = sign * dot(second[F_11], normal), 0.0, 0.0
    if k2 == 2:
        m12, m22 = dot(second[1], second[2]), dot(second[2], second[2])
        l12, l22 = sign * dot(second[F_12], normal), sign * dot(second[F_22], normal)
    if not m11 * m22 - m12 * m12 > 0.0:
        return 0
    n11, n12, n22 = m11 - gap * l11, m12 - gap * l12, m22 - gap * l22
    if not (n11 * n22 - n12 * n12 > _TOWARDS * (m11 * m22 - m12 * m12) and n11 > 0.0):
        # far towards a centre of curvature, or beyond it
        n11, n12, n22 = m11, m12, m22
    b1, c1 = _products(first[1], second, k2)
    x1, y1 = _curved(b1, c1, n11, n12, n22, l11, l12, l22, m11, m12, m22)
    r11 = sign * dot(first[F_11], normal) - (b1 * x1 + c1 * y1)
    if k1 == 1:
        return int(r11 > 0.0) - int(r11 < 0.0)
    b2, c2 = _products(first[2], second, k2)
    x2, y2 = _curved(b2, c2, n11, n12, n22, l11, l12, l22, m11, m12, m22)
    r12 = sign * dot(first[F_12], normal) - (b1 * x2 + c1 * y2)
    r22 = sign * dot(first[F_22], normal) - (b2 * x2 + c2 * y2)
    if not r11 * r22 - r12 * r12 > 0.0:
        return 0
    return 1 if r11 > 0.0 else -1


@kernel
def _products(tangent, second, k2):
    """Of a tangent (3,) with those of body 2."""
    return dot(second[1], tangent), dot(second[2], tangent) if k2 == 2 else 0.0


@kernel
def _curved(b, c, n11, n12, n22, l11, l12, l22, m11, m12, m22):
    """m^-1 l n^-1 (b, c), of symmetric matrices (2, 2)."""
    p, q = _solved(b, c, n11, n12, n22)
    return _solved(l11 * p + l12 * q, l12 * p + l22 * q, m11, m12, m22)


@kernel
def _solved(b, c, n11, n12, n22):
    """Solution of a symmetric system (2, 2)."""
    scale = 1.0 / (n11 * n22 - n12 * n12)
    return scale * (n22 * b - n12 * c), scale * (n11 * c - n12 * b)
