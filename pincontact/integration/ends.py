"""Open contacts at the ends of contours: what is at one, what comes in over it, and what passes by.

At a corner of a body two of its faces end. What slides over one of them passes the other one at its end, as near as
gaps are known, and may seem to strike it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.carriers import ORIGIN
from ..geometry.patterns import CROSSING_CURVES
from ..geometry.small import dot, norm
from ..jit import kernel
from ..layout import BESIDE, CARRIER, CHART, DOMAIN, DOMAIN_EVENT, FREE, LENGTH, MODE, PATTERN
from .accuracy import APART_AT_END, AT_ONCE_ROUND_OFF, gap_rate, rest_speed, round_off

if TYPE_CHECKING:
    from .run_system import RunSystem

# Directions whose cosine is smaller than this are at right angles: what slides falls a little where it changes faces.
_ACROSS = 1e-4


def at_end(system: RunSystem) -> float:
    """How near to the end of a domain a contact is at it, in m or rad."""
    return AT_ONCE_ROUND_OFF * round_off(system)


def deepest_at_end(system: RunSystem, c: int) -> float:
    """How far in m bodies may be inside each other where contact c comes into a domain, and touch there."""
    return max(float(system.gap_accuracy[c]), APART_AT_END * float(system.contact_real[c, LENGTH]))


def stays_within(system: RunSystem, c: int, kind: int) -> bool:
    """Whether closed contact c, whose event function of this kind was seen to reach zero, has not reached the end of a
    contour in the projected state: what grazes an end does not come over it, whatever the errors of steps are."""
    closed = kind == DOMAIN_EVENT and c < system.nc and system.contact_int[c, MODE] != FREE
    return bool(closed and system.contact_real[c, DOMAIN] > at_end(system))


def comes_in(system: RunSystem, c: int) -> bool:
    """Whether the points of contact c are at an end of the contours' domains in the last evaluation, and about to come
    in."""
    if abs(float(system.contact_real[c, DOMAIN])) > at_end(system):
        return False
    side, a, inward = nearest_end(system, c)
    return bool(inward * system.rates[c, 2 * side + a] > 0.0)


def waits(system: RunSystem, c: int, touching: list[int]) -> bool:
    """Whether contact c comes in over an end, without approach, where others between its bodies strike in the last
    evaluation: what comes in still is known after that."""
    if not comes_in(system, c):
        return False
    near, rest = system.contact_real[c, LENGTH] * APART_AT_END, rest_speed(system)
    strike = [i for i in touching if i != c and gap_rate(system, i) < -rest and is_beside(system, c, i, near)]
    return bool(strike) and gap_rate(system, c) >= -rest


def passes_by(system: RunSystem, c: int) -> bool:
    """Whether contact c is at an end, as far as gaps are known, and is kept out there in the last evaluation."""
    known_to, nc = float(system.gap_accuracy[c]), system.nc
    if not abs(float(system.contact_real[c, DOMAIN])) <= known_to:
        return False
    rates = np.einsum("ni,ni->n", system.basis[:nc, 2], system.slip[:nc])
    near = system.contact_real[c, LENGTH] * APART_AT_END
    domains = system.contact_real[:nc, DOMAIN]
    return bool(is_kept_out(system, c, system.gaps[:nc, 0], rates, domains, known_to, near, rest_speed(system)))


@kernel
def is_on_either_side(contact):
    """Whether a contact, its integers, is of curves that cross, whose side beside their ends is not told."""
    return contact[PATTERN] == CROSSING_CURVES and contact[BESIDE] != 0


@kernel
def is_kept_out(system, c, gaps, rates, ways, known_to, near, rest):
    """Whether another contact keeps contact c from coming in over the end at which it is: one that touches between the
    same bodies, which do not approach each other there, and lies between them.

    gaps, rates, ways (nc,): in m, m/s, and to the nearest end of the contours' domains; known_to: what is zero in them;
    near: how far in m is at the same place; rest: a speed in m/s that is none. Directions are those of the last
    evaluation. What slides falls a little where it changes faces.
    """
    slowest = -rest - _ACROSS * abs(rates[c])
    for i in range(gaps.shape[0]):
        touches = i != c and abs(gaps[i]) <= known_to and ways[i] >= -known_to
        if touches and rates[i] >= slowest and _is_between(system, c, i, ways, known_to, near):
            return True
    return False


@kernel
def _is_between(system, c, i, ways, known_to, near):
    """Whether the tangent plane of contact i lies between the bodies of contact c where this is: the face that ends
    there is behind it, and no other one that does comes before it."""
    if not (is_beside(system, c, i, near) and _rise(system, c, i) < -_ACROSS):
        return False
    for j in range(ways.shape[0]):
        if abs(ways[j]) <= known_to and is_beside(system, c, j, near) and _rise(system, j, i) > _ACROSS:
            return False
    return True


@kernel
def is_beside(system, c, i, near):
    """Whether contact i is between the bodies of contact c, and at the place of what comes to an end there."""
    other = 1 - nearest_end(system, c)[0]
    owner, guest = _carrier(system, c, 1 - other), _carrier(system, c, other)
    same = _carrier(system, i, other) == guest and _carrier(system, i, 1 - other) == owner
    if not (same or (_carrier(system, i, 1 - other) == guest and _carrier(system, i, other) == owner)):
        return False
    one, two, square = 2 * c + other, 2 * i + (other if same else 1 - other), 0.0
    for k in range(3):
        between = system.frames[one, ORIGIN, k] - system.frames[two, ORIGIN, k]
        square += (between + system.derivatives[one, 0, k] - system.derivatives[two, 0, k]) ** 2
    return square <= near * near


@kernel
def _rise(system, c, i):
    """Cosine of the angle between the way into the face that ends where contact c is and the normal of contact i, of
    the same bodies, away from the body that has this face."""
    side, a, inward = nearest_end(system, c)
    into = system.derivatives[2 * c + side, 1 + a]
    # e_3 leads from body 1 to body 2
    away = inward if _carrier(system, i, 0) == _carrier(system, c, side) else -inward
    return away * dot(into, system.basis[i, 2]) / norm(into)


@kernel
def _carrier(system, c, side):
    return system.side_int[2 * c + side, CARRIER]


@kernel
def nearest_end(system, c):
    """Side, 0 or 1, and parameter, 0 or 1, in which contact c is nearest to an end, and the sign of the way in."""
    side, a, inward, least = 0, 0, 0.0, math.inf
    for i in range(4):
        body = 2 * c + i // 2
        if system.side_int[body, CHART] != 0:
            # other charts stay away from ends
            continue
        u, low, high = (
            system.location[c, i],
            system.side_domain[body, 2 * (i % 2)],
            system.side_domain[body, 2 * (i % 2) + 1],
        )
        if min(u - low, high - u) < least:
            side, a, inward, least = i // 2, i % 2, 1.0 if u - low < high - u else -1.0, min(u - low, high - u)
    return side, a, inward
