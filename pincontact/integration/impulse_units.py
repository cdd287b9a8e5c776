"""Units of a step's cone problem: what takes part in it, and when its impulse acts.

Units are the cones of the problem: unilateral contacts that are closed or close in the step; bilateral ones with
Coulomb friction, whose normal impulse is an equation and their cone a disk of given radius; resistance to spinning and
to rolling, disks of torques with a radius from the contact's normal impulse; joint limits; dry friction of joints.
"""

from __future__ import annotations

import math

from ..arrays import as_array
from ..callback import separate_kernel
from ..dynamics.sliding import coefficient_at
from ..geometry.small import dot, norm
from ..jit import CALLED, INTEGER, NOTHING, REAL, STEPPING, kernel
from ..layout import (
    CURVE_SPEED,
    DOMAIN,
    FREE,
    LENGTH,
    MU,
    NOTHING_THERE,
    ROLLING,
    SLIPPING,
    SPINNING,
    STICK,
    SYSTEM,
    TANGENTS,
    UNILATERAL,
)
from ..linalg import inner
from .accuracy import APART_AT_END, REST
from .ends import is_beside, is_kept_out, is_on_either_side
from .impulse_layout import DRY_FRICTION, LOWER_LIMIT, MEAN_VELOCITY, ON_CONTACT, ON_JOINT, ON_LOADED, ON_TURN, STEP

# A contact nearer than this, relative to its length, is touching: round-off of positions, with room to spare.
TOUCHING = 1e-12
# Instants of a step: an impulse is spread over it; what is kept out at an end; and what does not happen in it.
SPREAD, PASSING, NEVER = -1.0, -2.0, math.inf


@kernel
def _touch_instant(gap, speed, rate, touching, h):
    """When gap + speed s + rate s^2 / 2 falls through `touching`, what is no gap, for s in [0, h]; NEVER if it does
    not."""
    gap -= touching
    if gap <= 0.0 and speed <= 0.0:
        return 0.0 if speed < 0.0 or rate <= 0.0 else NEVER
    discriminant = speed * speed - 2.0 * rate * gap
    if discriminant < 0.0:
        # below the surface for the whole parabola, or above it
        return 0.0 if gap < 0.0 else NEVER
    root = math.sqrt(discriminant)
    if speed < 0.0:
        instant = 2.0 * gap / (root - speed)
    elif rate < 0.0:
        instant = (speed + root) / -rate
    else:
        return NEVER
    return instant if instant <= h else NEVER


@kernel
def _way_at(system, step, c, part):
    """The way of contact c to the nearest end after this part of the time between the step's start and the evaluated
    state, by the ways there."""
    start, later = step.start_domain[c], system.contact_real[c, DOMAIN]
    if system.gaps[c, 0] >= NOTHING_THERE:
        # beyond all ends, wherever it comes from
        return later
    return later if start == math.inf or later == math.inf else start + (later - start) * part


@kernel
def _known_to(system, step, c):
    """How far in m places at contact c are known within the step, in which forces still may change: accelerations of
    the size of gravity, or of what accelerates its bodies."""
    square, n = 0.0, system.sizes.nv
    for i in range(3):
        square += (inner(system.rows[c, i], step.transported_trend, n) + system.bias[c, i]) ** 2
    bend = 0.5 * step.numbers.h**2 * max(math.sqrt(square), norm(system.gravity))
    return APART_AT_END * system.contact_real[c, LENGTH] + bend


@separate_kernel(INTEGER, SYSTEM.type, STEP.type, INTEGER, REAL, when=CALLED)
def passes_by(system, step, c, part):
    """Whether contact c is at an end after this part of the time between the step's start and the evaluated state, as
    far as positions are known, and is kept out there; 0 or 1."""
    ways = step.touch_ways
    for i in range(system.sizes.nc):
        ways[i] = _way_at(system, step, i, part)
    known_to = _known_to(system, step, c)
    if not abs(ways[c]) <= known_to:
        return 0
    rates, near = as_array(step.start_normal)[:, 0], _near(system, step, c)
    return 1 if is_kept_out(system, c, step.start_gap, rates, ways, known_to, near, REST) else 0


@kernel
def _add_unit(step, kind, index, mask, mu, instant):
    """A new unit, returns its number; instant: when it closes, or SPREAD."""
    counts = step.counts
    u = counts.units
    unit = step.units[u]
    unit.kind, unit.index, unit.mask = kind, index, mask
    unit.touches = unit.midpoint = unit.at_rest = unit.slid = unit.held = unit.tied = unit.struck = 0
    unit.approach = unit.free_rate = unit.shift = unit.load = unit.sticking_again = unit.unpressed = 0.0
    unit.axis, unit.parent = 0, -1
    unit.impulse_time = 0.5 * step.numbers.h
    if instant >= 0.0:
        unit.impulse_time = instant
        unit.touches = counts.touched = counts.rigid = 1
    step.friction[u] = unit.sliding = mu
    for row in range(2):
        step.unit_start[u, row] = step.unit_driven[u, row] = 0.0
    counts.units = u + 1
    return u


@kernel
def _strikes_beside(system, step, c):
    """Whether the bodies of contact c strike each other in the step where it is, and not past each other: what comes in
    still is known then."""
    h, ahead, near = step.numbers.h, step.numbers.ahead, _near(system, step, c)
    for i in range(system.sizes.nc):
        gap, speed = step.start_gap[i], step.start_normal[i, 0]
        falls = i != c and speed < -REST and gap + speed * h < 0.0
        if falls and step.start_mode[i] == FREE and step.behind[i] == 0 and is_beside(system, c, i, near):
            part = max(gap, 0.0) / (-speed * ahead)
            inside = _way_at(system, step, i, part) >= 0.0
            if inside and passes_by(system, step, i, part) == 0:
                return True
    return False


@kernel
def _near(system, step, c):
    """How far in m from contact c what slides is at the same place in the step."""
    return APART_AT_END * system.contact_real[c, LENGTH] + step.numbers.h * norm(system.slip[c])


@kernel
def _when_it_touches(system, step, c):
    """When contact c, which is open, closes in the step, SPREAD, PASSING or NEVER."""
    h, ahead, trend = step.numbers.h, step.numbers.ahead, step.counts.has_trend
    if step.behind[c] != 0 or step.put_off[c] != 0:
        return NEVER
    # what impulses change does not change when they began: touches in one instant stay so
    if trend == MEAN_VELOCITY and step.instant[c] != NEVER:
        return step.instant[c]
    gap, speed, touching = step.start_gap[c], step.start_normal[c, 0], TOUCHING * system.contact_real[c, LENGTH]
    start, later, instant = step.start_domain[c], system.contact_real[c, DOMAIN], NEVER
    if abs(gap) <= touching and abs(speed) * h <= touching and start < 0.0 and ahead > 0.0:
        # at rest on what it comes over in the step
        comes = _way_at(system, step, c, h / ahead) >= 0.0
        instant = SPREAD if comes and not _strikes_beside(system, step, c) else NEVER
    elif trend != 0:
        # before that nothing tells whether it touches, which depends on what holds the bodies
        rate = inner(system.rows[c, 2], step.transported_trend, system.sizes.nv) + system.bias[c, 2]
        instant = _touch_instant(gap, speed, rate, touching, h)
        if instant != NEVER and later < math.inf:
            part = instant / ahead if ahead > 0.0 else 0.0
            way = _way_at(system, step, c, part)
            # what comes over the very end of a curve that it crosses goes through no gap
            comes_over = start < 0.0 and is_on_either_side(system.contact_int[c]) and way <= _known_to(system, step, c)
            if way < 0.0 or comes_over:
                instant = NEVER
            elif passes_by(system, step, c, part) != 0:
                instant = PASSING
    step.instant[c] = instant
    return instant


@separate_kernel(NOTHING, SYSTEM.type, STEP.type, when=STEPPING)
def gather_contacts(system, step):
    """Units of all contacts that take part."""
    h, contact_int, contact_real = step.numbers.h, system.contact_int, system.contact_real
    start_mode, sticking = step.start_mode, step.sticking
    for c in range(system.sizes.nc):
        mu, two, mode = contact_real[c, MU], contact_int[c, TANGENTS] == 2, start_mode[c]
        bilateral = contact_int[c, UNILATERAL] == 0
        kind, mask = ON_CONTACT, 4 if mu == 0.0 else (7 if two else 5)
        instant = SPREAD
        if bilateral:
            # the cone's normal carries a given impulse: the disk's radius is mu times it
            kind, mask = ON_LOADED, 3 if two else 1
            if mu == 0.0 or mu == math.inf:
                continue
        elif mode == FREE:
            instant = _when_it_touches(system, step, c)
            if instant in (PASSING, NEVER):
                continue
        if contact_real[c, CURVE_SPEED] > 0.0 and mode != STICK:
            basis, slip = system.basis[c], system.slip[c]
            mu = coefficient_at(contact_real[c], math.hypot(dot(basis[0], slip), dot(basis[1], slip) if two else 0.0))
        u = _add_unit(step, kind, c, mask, mu, instant)
        unit = step.units[u]
        if bilateral:
            unit.load = h * step.load[c]
        if mode == STICK and sticking[c] > mu:
            # a contact at rest holds up to its coefficient of sticking
            step.friction[u] = sticking[c]
            unit.at_rest = 1
        if mode == SLIPPING:
            unit.slid = 1
            unit.sticking_again = sticking[c] if sticking[c] > mu else 0.0
            unit.midpoint = 1 if two and 0.0 < mu < math.inf else 0


@kernel
def set_impact_friction(system, step, u):
    """In a step with impacts the coefficient of unit u, of a contact, is that of its slip before, and what slid does
    not hold as what was at rest."""
    unit, start = step.units[u], step.unit_start[u]
    numbers = system.contact_real[unit.index]
    unit.sticking_again = 0.0
    if numbers[CURVE_SPEED] > 0.0 and step.start_mode[unit.index] != STICK:
        step.friction[u] = unit.sliding = coefficient_at(numbers, math.hypot(start[0], start[1]))


@kernel
def gather_turns(system, step):
    """Units that resist spinning and rolling, of the contacts that take part."""
    contact_int, contact_real, units = system.contact_int, system.contact_real, step.units
    contacts = step.counts.units
    for c in range(system.sizes.nc):
        if contact_real[c, SPINNING] == 0.0 and contact_real[c, ROLLING] == 0.0:
            continue
        parent = -1
        if contact_int[c, UNILATERAL] != 0:
            for u in range(contacts):
                if units[u].index == c:
                    parent = u
            if parent < 0:
                continue
        two = contact_int[c, TANGENTS] == 2
        for spins in range(2):
            length = contact_real[c, SPINNING if spins == 1 else ROLLING]
            if length > 0.0:
                unit = units[_add_unit(step, ON_TURN, c, 3 if two and spins == 0 else 1, length, SPREAD)]
                # in a plane everything rolls about its normal, the second basis vector
                unit.axis = 2 if spins == 1 else (0 if two else 1)
                unit.parent, unit.load = parent, step.numbers.h * step.load[c]


@kernel
def gather_joints(step):
    """Units of joint limits within reach and of dry friction. A joint that was held at its end is closed, whatever
    rounding makes of its position."""
    h = step.numbers.h
    for j in range(step.counts.joints):
        joint = step.joints[j]
        k = joint.index_v
        if joint.kind == DRY_FRICTION:
            u = _add_unit(step, ON_JOINT, j, 1, 1.0, SPREAD)
            step.units[u].load = h * joint.bound
            continue
        sign = 1.0 if joint.kind == LOWER_LIMIT else -1.0
        gap = sign * (step.start_q[joint.index_q] - joint.bound)
        speed, rate, thrown = sign * step.transported_v[k], sign * step.transported_trend[k], sign * step.mean[k]
        held = step.start_end[joint.limit] * sign < 0.0
        resting = held or (gap <= TOUCHING and abs(speed) * h <= TOUCHING)
        instant = _touch_instant(gap, speed, rate, TOUCHING, h)
        if instant == NEVER and step.counts.has_trend == MEAN_VELOCITY and thrown < 0.0 and gap + h * thrown < 0.0:
            # by an impact of this step
            instant = max(gap / -thrown, 0.0)
        # as for contacts, whether it gets there depends on what holds it
        if resting or (instant != NEVER and step.counts.has_trend != 0):
            _add_unit(step, ON_JOINT, j, 4, 0.0, SPREAD if resting else instant)
