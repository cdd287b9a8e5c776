"""Friction of one item that slides: its direction, its coefficient, what holds it up, and viscous friction.

Items are contacts and resistances to turning. The kernels are given the item's integers and numbers, rows of
`contact_int` and `contact_real`.
"""

from __future__ import annotations

import math

from ..friction.stribeck import stribeck_kernel
from ..geometry.small import dot
from ..jit import kernel
from ..layout import (
    ACROSS_X,
    CURVE_SPEED,
    DIRECTION_X,
    FREE,
    FROZEN,
    MODE,
    MU,
    MU_FAST,
    NORMAL_SIGN,
    POLYNOMIAL,
    POLYNOMIAL_SIZE,
    SLIP_SIGN,
    SLIPPING,
    SPAN,
    START,
    STICK,
    STRIBECK_EXPONENT,
    TANGENTS,
    UNILATERAL,
    VISCOUS,
)


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
    if numbers[CURVE_SPEED] > 0.0:
        return stribeck_kernel(numbers[MU], numbers[MU_FAST], numbers[CURVE_SPEED], numbers[STRIBECK_EXPONENT], speed)
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
