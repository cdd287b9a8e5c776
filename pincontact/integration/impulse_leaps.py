"""What a step of Moreau's method is too long for: closed contacts that leap to other places, touches that come behind
others; compiled."""

from __future__ import annotations

import math

from ..dynamics.evaluation import are_at_one_place
from ..friction import cone
from ..geometry.location import NO_CLOSED_FORM
from ..geometry.small import dot, norm
from ..jit import kernel
from ..layout import (
    CLOSED_FORM,
    DOMAIN,
    FREE,
    K1,
    LENGTH,
    MODE,
    NEXT,
    NOTHING_THERE,
    OVERLAP,
    UNILATERAL,
)
from .accuracy import APART_AT_END, LEAPS
from .ends import is_on_either_side
from .impulse_layout import ON_CONTACT
from .impulse_units import passes_by

# A gap, or a contact coordinate, that changes in a step by more than this many times what its rates before and after it
# explain is another one.
LEAP = 4.0


@kernel
def leaps(system, step, c, h):
    """Whether contact c is not where its coordinates go in a step, by their rates before and after it: Newton's method
    has gone over to other points where bodies touch. Corrections of positions elsewhere move a contact, too, by less
    the shorter the step is; a step in which it leaps is divided."""
    integers, before, after = system.contact_int[c], step.start_rates[c], system.rates[c]
    if integers[CLOSED_FORM] != NO_CLOSED_FORM:
        return False
    moved = fastest = 0.0
    for body in range(2):
        for a in range(integers[K1 + body]):
            i, length = 2 * body + a, norm(system.derivatives[2 * c + body, 1 + a])
            moved = max(moved, length * abs(system.location[c, i] - step.start_location[c, i]))
            fastest = max(fastest, length * max(abs(before[i]), abs(after[i])))
    return moved > LEAP * h * fastest + LEAPS * system.contact_real[c, LENGTH]


@kernel
def is_deeper(system, step, c, gap, rate, h):
    """Whether contact c is deeper inside than it can have come in a step since it was on the near side."""
    fastest = max(abs(rate), abs(step.start_normal[c, 0]))
    return gap < -APART_AT_END * system.contact_real[c, LENGTH] - fastest * h


@kernel
def overlaps_at_end(system, step, c, h):
    """Whether the bodies of contact c, which is open, overlap where it has come over an end in the step, deeper than by
    the step itself: not where it is kept out, nor curves that cross, whose side beside their ends does not matter."""
    contact, numbers, gap = system.contact_int[c], system.contact_real[c], system.gaps[c, 0]
    # from beyond an end, and not from nowhere
    entered = step.start_domain[c] < 0.0 <= numbers[DOMAIN] and step.start_gap[c] < NOTHING_THERE
    if not (entered and contact[UNILATERAL] != 0 and -numbers[OVERLAP] <= gap < 0.0):
        return False
    if is_on_either_side(contact):
        return False
    rate = dot(system.basis[c, 2], system.slip[c])
    return is_deeper(system, step, c, gap, rate, h) and passes_by(system, step, c, 1.0) == 0


@kernel
def has_come_to_another(system, c):
    """Whether a closed contact is where an earlier one of the same contours, which is closed, is: one is enough."""
    other = system.contact_int[c, NEXT]
    while other != c:
        if other < c and system.contact_int[other, MODE] != FREE and are_at_one_place(system, c, other):
            return True
        other = system.contact_int[other, NEXT]
    return False


@kernel
def puts_later_ones_off(system, step):
    """Whether the solution lets go what touches in the step by an impulse of what touches so much later that bodies
    have gone into each other by then, as where they come over an edge; what touches later is left to the next step."""
    counts, units, first, found = step.counts, step.units, math.inf, False
    for u in range(counts.units):
        unit, c = units[u], units[u].index
        if unit.kind != ON_CONTACT or unit.touches == 0 or step.cone_modes[u] != cone.OPEN:
            continue
        speed, known_to = -step.start_normal[c, 0], APART_AT_END * system.contact_real[c, LENGTH]
        for other in range(counts.units):
            later = units[other].impulse_time - unit.impulse_time
            pushes = units[other].touches != 0 and step.cone_forces[3 * other + 2] > 0.0
            if pushes and later > 0.0 and later * speed > known_to:
                first = min(first, unit.impulse_time)
    for u in range(counts.units):
        if units[u].kind == ON_CONTACT and units[u].touches != 0 and units[u].impulse_time > first:
            step.put_off[units[u].index], found = 1, True
    return found
