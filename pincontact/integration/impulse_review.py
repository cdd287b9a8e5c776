"""Whether the solution of a step's cone problem stands (see `impulses`)."""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..dynamics.energy import ENERGY_SLACK, KEPT_ACCURACY
from ..dynamics.event_functions import IDEAL_FRICTION
from ..friction import cone
from ..jit import INTEGER, STEPPING, kernel
from ..layout import NO_FORCE, SYSTEM
from ..linalg import inner
from ..workspace import square
from .impulse_equations import normal_load
from .impulse_layout import APART, ON_CONTACT, ON_LOADED, ON_TURN, STEP, TOGETHER
from .impulse_works import impulse_work, velocity_change

# What `review` and `impulses.advance` return: the step is done, or the cone problem was changed and must be solved
# again, or has to be assembled anew.
DONE, AGAIN, ANEW = 0, -1, -2

# Fixed point on the loads that cone problems take as given: relative change that ends it (those of resistance to
# turning come from a cone problem solved to less accuracy), reviews after which loads and forces are found together,
# and after which the step fails.
_LOAD_CHANGE, _TURN_LOAD_CHANGE = 1e-12, 1e-10
_PATIENCE = 12
_REVIEW_LIMIT = 200
# What comes to rest may take this part of the velocity in a step, by which a step may be off, too.
_TAKEN = 0.06


@kernel
def slip_at_end(step, u):
    """Both components of the slip of unit u at the step's end."""
    first, second = step.cone_velocities[3 * u], step.cone_velocities[3 * u + 1]
    if step.units[u].midpoint != 0:
        # the problem's are twice its mean over the step
        first -= step.unit_start[u, 0]
        second -= step.unit_start[u, 1]
    return first, second


@kernel
def _slips_back(step, u):
    """Whether the slip of unit u, which slid at the step's start, turns by a right angle or more, so that it may as
    well come to rest within the step."""
    first, second = slip_at_end(step, u)
    return first * step.unit_start[u, 0] + second * step.unit_start[u, 1] <= 0.0


@kernel
def may_rest(step, u):
    """Whether unit u slid at the step's start and comes to rest in this solution, or slips back, and nothing that it is
    coupled with slides on: what passes by a place of rest, while others slide, does not stop there."""
    n, units, delassus = step.counts.units, step.units, square(step.delassus, 3 * step.counts.units)
    if units[u].slid == 0 or units[u].midpoint != 0:
        return False
    for w in range(n):
        rests = units[w].slid == 0 or step.cone_modes[w] == cone.STICK or (w != u and step.friction[w] == 0.0)
        if rests or _slips_back(step, w):
            continue
        for i in range(3 * u, 3 * u + 3):
            for j in range(3 * w, 3 * w + 3):
                if delassus[i, j] != 0.0:
                    return False
    return True


@kernel
def _has_jammed(system, step):
    """Whether what slid and came to rest in this solution takes more from the velocity than forces could that hold it:
    the slip is ended by what slides, and rest goes on under the smooth forces. The impulse of a jam, such as of a
    crank near its dead centre, does not get smaller with the step, in which it would end the motion."""
    rests = False
    for u in range(step.counts.units):
        rests = rests or (step.units[u].slid != 0 and step.units[u].at_rest != 0 and step.cone_modes[u] == cone.STICK)
    if not rests:
        return False
    nv, slid, change, v = system.sizes.nv, step.slid_change, system.work, step.transported_v
    velocity_change(step, nv, change)
    explained, more, moving = inner(slid, slid, nv), 0.0, 0.0
    for k in range(nv):
        more += (change[k] - slid[k]) ** 2
        moving += system.mass[k, k] * v[k] * v[k]
    return math.sqrt(more) > math.sqrt(explained) + step.numbers.free_change + _TAKEN * math.sqrt(moving)


@kernel
def _let_unpressed_go(step, u):
    """Take its friction from unit u, ideal rolling that has a tangential impulse without a load, or give it back what
    carries a load without; whether any was."""
    unit, friction, forces = step.units[u], step.friction, step.cone_forces[3 * u : 3 * u + 3]
    if unit.unpressed > 0.0 and friction[u] == 0.0:
        if not forces[2] * IDEAL_FRICTION > unit.unpressed:
            return False
        # friction was what lifted it
        friction[u], unit.unpressed = math.inf, -1.0
        return True
    tangential = math.hypot(forces[0], forces[1])
    rolls = unit.kind == ON_CONTACT and friction[u] == math.inf and unit.unpressed == 0.0
    if not (rolls and forces[2] * IDEAL_FRICTION < tangential):
        return False
    friction[u], unit.unpressed = 0.0, tangential
    return True


@kernel
def _update_load(step, u, delassus):
    """Let the problem take as given the normal impulse that its solution has for unit u; by which part of their sum
    that differs from what it took, zero for round-off."""
    unit = step.units[u]
    turns = unit.kind == ON_TURN
    if turns and unit.parent >= 0:
        load = step.cone_forces[3 * unit.parent + 2]
    else:
        # what turns has one normal, and where it must not slip further equations; others have normals only
        load = normal_load(step, unit.index, 2 if turns else 0)
    change, both = abs(load - unit.load), load + unit.load
    if not change > (_TURN_LOAD_CHANGE if turns else _LOAD_CHANGE) * both:
        return 0.0
    unit.load = load
    step.loads[3 * u + 2] = -delassus[3 * u + 2, 3 * u + 2] * load
    return change / both


@separate_kernel(INTEGER, SYSTEM.type, STEP.type, when=STEPPING)
def review(system, step):
    """Whether the solution stands; if not, b or the coefficients are changed and the problem is to be solved again.

    Slip is opposed along the mean of its velocities at both ends only while it goes on; a contact at rest that starts
    to slip does so with the sliding coefficient, and one whose slip turns back comes to rest first, if that of sticking
    holds it without a jam; ideal rolling that nothing presses has no friction; and restitution is lowered where,
    together with friction, it would create energy. Before all this, loads that the problem takes as given are a fixed
    point, which is iterated a few times, then found together with the forces (see `friction.loads`): the last step's
    may let go what this one's hold.
    """
    nv, h, scratch = system.sizes.nv, step.numbers.h, system.work
    counts, n, units = step.counts, step.counts.units, step.units
    modes, friction = step.cone_modes, step.friction
    b, delassus = step.loads, square(step.delassus, 3 * n)
    if counts.reviews == 0:
        # those of the last step's loads
        for k in range(3 * n):
            step.first_forces[k] = step.cone_forces[k]
    counts.reviews += 1
    if counts.coupled == APART:
        change, before = 0.0, step.numbers.load_change if counts.reviews > 1 else math.inf
        for u in range(n):
            if units[u].kind == ON_LOADED or units[u].kind == ON_TURN:
                change = max(change, _update_load(step, u, delassus))
        step.numbers.load_change = change
        if change > 0.0:
            # what leads away from a solution may come to another one
            if change > before or counts.reviews > _PATIENCE:
                counts.coupled = TOGETHER
            return AGAIN
    bounces = stops = False
    for u in range(n):
        if units[u].midpoint != 0:
            stops = stops or modes[u] == cone.STICK or _slips_back(step, u)
    again, jams, tried = stops, _has_jammed(system, step), False
    for u in range(n):
        again = _let_unpressed_go(step, u) or again
    for u in range(n):
        unit = units[u]
        if unit.sticking_again > 0.0 and modes[u] == cone.SLIP and may_rest(step, u):
            if not tried:
                velocity_change(step, nv, step.slid_change)
            tried = True
            friction[u], unit.sticking_again = unit.sticking_again, 0.0
            unit.at_rest = 1
            again = True
            continue
        # all at once, see `impulse_problem`
        if stops and unit.midpoint != 0:
            b[3 * u] -= step.unit_start[u, 0]
            b[3 * u + 1] -= step.unit_start[u, 1]
            unit.midpoint = 0
        if unit.at_rest != 0 and (modes[u] == cone.SLIP or (jams and unit.slid != 0)):
            friction[u] = unit.sliding
            unit.at_rest = 0
            again = True
        if unit.touches != 0 and unit.shift > 0.0 and step.cone_forces[3 * u + 2] > 0.0:
            bounces = True
    if not again and not (bounces and _lowers_restitution(step, nv, h, scratch)):
        return DONE
    return AGAIN if counts.reviews < _REVIEW_LIMIT else NO_FORCE


@kernel
def _lowers_restitution(step, nv, h, scratch):
    """Bisection for the largest part of the restitution that creates no energy (see `dynamics.energy`), nor raises the
    kinetic energy by more than the smooth forces account for within a step; 0 never does. Whether it goes on, with
    another part."""
    numbers = step.numbers
    on_contacts, on_joints, size, excess = impulse_work(step, nv, h, scratch)
    creates = max(on_contacts + on_joints, excess) > ENERGY_SLACK * size
    if not creates and (numbers.kept == 1.0 or numbers.kept_high - numbers.kept_low < KEPT_ACCURACY):
        return False
    kept = numbers.kept
    if creates:
        numbers.kept_high = kept
    else:
        numbers.kept_low = kept
    if numbers.kept_high - numbers.kept_low < KEPT_ACCURACY:
        numbers.kept = numbers.kept_low
        if kept == numbers.kept:
            return False
    else:
        numbers.kept = 0.5 * (numbers.kept_low + numbers.kept_high)
    for u in range(step.counts.units):
        step.loads[3 * u + 2] += (kept - numbers.kept) * step.units[u].shift
    return True
