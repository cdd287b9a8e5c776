"""Whether closed contacts are followed in a step of Moreau's method, or leap to other places: compiled."""

from __future__ import annotations

from ..dynamics.evaluation import are_at_one_place
from ..geometry.location import NO_CLOSED_FORM
from ..geometry.small import norm
from ..jit import kernel
from ..layout import CLOSED_FORM, CONDITION, FREE, K1, LENGTH, MODE, NEXT
from .accuracy import LEAPS
from .impulses import LEAP


@kernel
def comes_out(system, step, h):
    """By how much in m bodies are moved in a step to come out of what they were, or got, inside of, at most."""
    largest = 0.0
    for c in range(system.sizes.nc):
        if system.contact_int[c, MODE] != FREE:
            inside = max(-step.start_gap[c], 0.0)
            if step.start_mode[c] == FREE:
                inside += h * abs(step.start_normal[c, 0])
            largest = max(largest, inside)
    return largest


@kernel
def leaps(system, step, c, h, moved_out):
    """Whether contact c is not where its coordinates go in a step, by their rates before and after it, and as bodies
    are moved out of each other: Newton's method has gone over to other points where bodies touch."""
    integers, before, after = system.contact_int[c], step.start_rates[c], system.rates[c]
    if integers[CLOSED_FORM] != NO_CLOSED_FORM:
        return False
    moved = fastest = 0.0
    for body in range(2):
        for a in range(integers[K1 + body]):
            i, length = 2 * body + a, norm(system.derivatives[2 * c + body, 1 + a])
            moved = max(moved, length * abs(system.location[c, i] - step.start_location[c, i]))
            fastest = max(fastest, length * max(abs(before[i]), abs(after[i])))
    numbers = system.contact_real[c]
    # the worse they are conditioned, the farther contact coordinates move with the bodies
    explained = h * fastest + moved_out / abs(numbers[CONDITION])
    return moved > LEAP * explained + LEAPS * numbers[LENGTH]


@kernel
def has_come_to_another(system, c):
    """Whether a closed contact is where an earlier one of the same contours, which is closed, is: one is enough."""
    other = system.contact_int[c, NEXT]
    while other != c:
        if other < c and system.contact_int[other, MODE] != FREE and are_at_one_place(system, c, other):
            return True
        other = system.contact_int[other, NEXT]
    return False
