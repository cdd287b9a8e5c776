"""Open contacts at the ends of contours: what is at one, what comes in over it, and what passes by.

At a corner of a body two of its faces end. What slides over one of them passes the other one at its end, as near as
gaps are known, and may seem to strike it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..layout import CHART, DOMAIN, LENGTH
from .accuracy import APART_AT_END, AT_ONCE_ROUND_OFF, gap_rate, rest_speed, round_off
from .nearness import places_of

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


def comes_in(system: RunSystem, c: int) -> bool:
    """Whether the points of contact c are at an end of the contours' domains in the last evaluation, and about to come
    in."""
    if abs(float(system.contact_real[c, DOMAIN])) > at_end(system):
        return False
    side, a, inward = _nearest_end(system, c)
    return bool(inward * system.rates[c, 2 * side + a] > 0.0)


def passes_by(system: RunSystem, c: int) -> bool:
    """Whether contact c is at an end, as far as gaps are known, and another contact of the same bodies, which are not
    approaching each other there, keeps them from coming in: faces of a body that meet at a convex corner."""
    contact, known_to = system.contacts[c], float(system.gap_accuracy[c])
    if not abs(float(system.contact_real[c, DOMAIN])) <= known_to:
        return False
    side, a, inward = _nearest_end(system, c)
    into = inward * system.derivatives[2 * c + side, 1 + a]
    slowest = -rest_speed(system) - _ACROSS * abs(gap_rate(system, c))
    owner = (contact.body1, contact.body2)[side].carrier
    for i, other in enumerate(system.contacts):
        if i == c or other.bodies != contact.bodies or abs(float(system.gaps[i, 0])) > known_to:
            continue
        if system.contact_real[i, DOMAIN] < -known_to or gap_rate(system, i) < slowest:
            continue
        # away from the body whose contour ends; e_3 leads from body 1 to body 2
        away = system.basis[i, 2] if other.body1.carrier == owner else -system.basis[i, 2]
        place, there = (points[1 - side] for points in places_of(system, [c, i], c))
        near = np.linalg.norm(place - there) <= system.contact_real[c, LENGTH] * APART_AT_END
        if near and into @ away < -_ACROSS * np.linalg.norm(into):
            return True
    return False


def _nearest_end(system: RunSystem, c: int) -> tuple[int, int, float]:
    """Side, 0 or 1, and parameter, 0 or 1, in which contact c is nearest to an end, and the sign of the way in."""
    best, least = (0, 0, 0.0), np.inf
    for i, u in enumerate(system.location[c].tolist()):
        side = 2 * c + i // 2
        if system.side_int[side, CHART] != 0:
            # other charts stay away from ends
            continue
        low, high = system.side_domain[side, 2 * (i % 2) : 2 * (i % 2) + 2].tolist()
        if min(u - low, high - u) < least:
            least, best = min(u - low, high - u), (i // 2, i % 2, 1.0 if u - low < high - u else -1.0)
    return best
