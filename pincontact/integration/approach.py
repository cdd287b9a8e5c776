"""How soon an open contact could touch: bounds from speeds at one instant, in compiled code."""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..geometry.carriers import ACCELERATION, OMEGA, ORIGIN, VELOCITY
from ..geometry.small import dot, norm, rotate
from ..jit import BOOLEAN, NOTHING, REAL, kernel
from ..layout import (
    APPROACH_SPEED,
    BENDING,
    DOMAIN,
    EXTENT,
    FLAT,
    FREE,
    HULL_X,
    HULL_Y,
    HULL_Z,
    MODE,
    NOTHING_THERE,
    SPEEDING,
    SYSTEM,
    TURNING,
    UNILATERAL,
    WHOLE,
)

# Gravity and what changed velocities last, times this, is what may change them next.
SAFETY = 2.0
# Speeds (m/s, rad/s) are cut off at this: beyond, differences are no numbers.
_BEYOND = 1e50


def time_to_cover(way: float, speed: float, acceleration: float) -> float:
    """Time in s in which something of that speed and acceleration goes a way in m."""
    if math.isinf(way):
        return math.inf
    root = math.sqrt(speed * speed + 2.0 * acceleration * way)
    return 2.0 * way / (speed + root) if speed + root > 0.0 else math.inf


_time_to_cover = kernel(time_to_cover)


@kernel
def _velocity_at(frame, lever, i):
    """Component i of v + omega x lever."""
    j, k = (i + 1) % 3, (i + 2) % 3
    return frame[VELOCITY, i] + frame[OMEGA, j] * lever[k] - frame[OMEGA, k] * lever[j]


@kernel
def bound_speed(numbers, one, two, from_origin, normal, vectors):
    """Bounds of how one contour moves in the frame of the other body, from both frames (world axes): APPROACH_SPEED of
    its points in m/s, TURNING in rad/s, and BENDING in m/s^2, how fast turning alone changes the speed.

    It lies within EXTENT of a point of its frame, or, where EXTENT is negative, is its point from_origin (3,); a ball
    that turns about its centre stays where it is. Where the other one is FLAT only speed along the normal counts.
    """
    own, other, local, change = vectors[0], vectors[1], vectors[2], vectors[3]
    local[0], local[1], local[2] = numbers[HULL_X], numbers[HULL_Y], numbers[HULL_Z]
    rotate(one[0:3], local, own)
    turning = 0.0
    for i in range(3):
        other[i] = own[i] + one[ORIGIN, i] - two[ORIGIN, i]
        turning += (one[OMEGA, i] - two[OMEGA, i]) ** 2
    for i in range(3):
        change[i] = _velocity_at(one, own, i) - _velocity_at(two, other, i)
    turning, speed, bending = math.sqrt(turning), norm(change), 0.0
    if numbers[FLAT] != 0.0:
        first, second = norm(one[OMEGA]), norm(two[OMEGA])
        bending = first * first * norm(own) + second * second * norm(other) + 2.0 * second * speed
        bending += norm(one[ACCELERATION]) + norm(two[ACCELERATION])
        speed = abs(dot(normal, change))
    speed += turning * (numbers[EXTENT] if numbers[EXTENT] >= 0.0 else norm(from_origin))
    numbers[TURNING], numbers[BENDING] = turning, bending
    numbers[APPROACH_SPEED] = speed if speed < _BEYOND else _BEYOND


@separate_kernel(NOTHING, SYSTEM.type)
def bound_speeds(system):
    """`bound_speed` of all unilateral contacts, from the last evaluation."""
    contact_int, contact_real = system.contact_int, system.contact_real
    frames, derivatives = system.frames, system.derivatives
    for c in range(system.sizes.nc):
        if contact_int[c, UNILATERAL] != 0:
            one = 2 * c + contact_int[c, WHOLE]
            two, point, normal = 4 * c + 1 - one, derivatives[one, 0], system.basis[c, 2]
            bound_speed(contact_real[c], frames[one], frames[two], point, normal, system.vectors)


@separate_kernel(BOOLEAN, SYSTEM.type, REAL)
def stay_apart(system, h):
    """Whether none of the open contacts can touch within h from the state of the last evaluation.

    For contacts whose gap says how far they are apart, of contours that neither move by themselves nor change.
    """
    bound_speeds(system)
    contact_int, contact_real, gaps = system.contact_int, system.contact_real, system.gaps
    pull = norm(system.gravity)
    for c in range(system.sizes.nc):
        if contact_int[c, MODE] != FREE or contact_int[c, UNILATERAL] == 0:
            continue
        numbers = contact_real[c]
        if numbers[DOMAIN] < 0.0 and gaps[c, 0] >= NOTHING_THERE:
            return False
        acceleration = SAFETY * max(pull, numbers[SPEEDING]) + numbers[BENDING]
        if h > _time_to_cover(abs(gaps[c, 0]), numbers[APPROACH_SPEED], acceleration):
            return False
    return True
