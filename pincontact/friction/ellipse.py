"""Friction of two directions: an elliptic cone is a round one in scaled tangential coordinates.

With a contact's scaling A (symmetric, eigenvalues 1 along the first direction and `aspect` across it), forces
F_t = A F_t' and velocities u_t' = A u_t have the same products, F_t' lies in the round cone of coefficient mu exactly
where F_t lies in the elliptic one, and Coulomb's law between F_t' and u_t' is the associated law between F_t and u_t.
"""

from __future__ import annotations

import math

from ..jit import kernel
from ..layout import ANISOTROPIC, ASPECT, SCALING_11, SCALING_12, SCALING_22


@kernel
def set_friction_scaling(numbers, x, y):
    """The scaling of a contact whose first direction is (x, y), of any length, along (t1, second)."""
    squared = x * x + y * y
    more = (numbers[ASPECT] - 1.0) / squared
    numbers[SCALING_11] = 1.0 + more * y * y
    numbers[SCALING_12] = -more * x * y
    numbers[SCALING_22] = 1.0 + more * x * x


@kernel
def scale_pair(numbers, first, second):
    """A applied to (first, second)."""
    return (
        numbers[SCALING_11] * first + numbers[SCALING_12] * second,
        numbers[SCALING_12] * first + numbers[SCALING_22] * second,
    )


@kernel
def friction_direction(integers, numbers, direction):
    """From a unit direction of slip d, in place, to what friction of coefficient 1 opposes it with: A^2 d / |A d|."""
    if integers[ANISOTROPIC] != 0:
        first, second = scale_pair(numbers, direction[0], direction[1])
        size = math.hypot(first, second)
        if size > 0.0:
            first, second = scale_pair(numbers, first / size, second / size)
            direction[0], direction[1] = first, second


@kernel
def friction_length(integers, numbers, first, second):
    """|A^-1 F_t|: the length of a friction force that its limit is held against."""
    if integers[ANISOTROPIC] != 0:
        whole = numbers[SCALING_11] * numbers[SCALING_22] - numbers[SCALING_12] * numbers[SCALING_12]
        return (
            math.hypot(
                numbers[SCALING_22] * first - numbers[SCALING_12] * second,
                numbers[SCALING_11] * second - numbers[SCALING_12] * first,
            )
            / whole
        )
    return math.hypot(first, second)
