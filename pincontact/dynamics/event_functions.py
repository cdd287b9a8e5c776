"""Event functions of the present modes, (items, EVENTS_PER_CONTACT): positive while a mode holds, 1 where it has none.

Each function fills the rows of its items in `event_functions`, from the forces and accelerations just found, and
returns OK, or EVENT where one is negative. Contacts that carry nothing have theirs in `least_forces`.
"""

from __future__ import annotations

import math

from ..friction.ellipse import friction_direction, friction_length
from ..geometry.patterns import ON_CURVE
from ..jit import kernel
from ..layout import (
    DOMAIN,
    DOMAIN_EVENT,
    EVENT,
    EVENTS_PER_CONTACT,
    FREE,
    FRICTION_EVENT,
    FRICTIONLESS,
    FROZEN,
    GAP_EVENT,
    HIGH_END,
    HIGH_FORCE,
    JOINT_END,
    JOINT_SIGN,
    JOINT_V,
    LIFT,
    LIMIT_SLACK,
    LOW_END,
    LOW_FORCE,
    MODE,
    MU,
    MU_NOW,
    MU_STATIC,
    NORMAL_EVENT,
    NORMAL_SIGN,
    OK,
    OWNER,
    PATTERN,
    SLIP_RATE,
    SLIP_SPEED,
    SLIPPING,
    SPEED_EVENT,
    STICK,
    TANGENTS,
    UNILATERAL,
    VISCOUS,
)
from ..linalg import inner, whiten
from .resistance import resists, size_of_load
from .sliding import is_held_up, resists_viscously, shares_viscous_force, slip_direction, viscous_force

# Friction that holds a contact up alone jams where a unit of it pushes the bodies apart by less than this fraction of
# what a unit of normal force does.
JAM_LIMIT = 1e-6

# Ideal rolling is the limit of ever larger coefficients of friction. This one stands for it where a load is so small a
# part of the tangential force that it is none.
IDEAL_FRICTION = 1e10
# What has lost its load has one again where it is so many times as large, so that it does not go to and fro.
_LOADED = 10.0

# What presses a joint onto its end has no sign below this part of what would move that joint alone as much as all that
# acts moves the bodies.
_ROUND_OFF = 1e-14

# Those that are forces, in N or N m; all others are ways in m or rad, or their speeds.
FORCE_EVENTS = (NORMAL_EVENT, FRICTION_EVENT)


@kernel
def cleared(value):
    """An item's event functions, none of which ends its mode."""
    for i in range(EVENTS_PER_CONTACT):
        value[i] = 1.0
    return value


@kernel
def status_of(value):
    """EVENT where one of an item's event functions is negative."""
    for i in range(EVENTS_PER_CONTACT):
        if value[i] < 0.0:
            return EVENT
    return OK


@kernel
def joint_event_functions(system):
    """Event functions of joint coordinates with limits or dry friction.

    Moving: way to the lower (GAP) and to the upper end (DOMAIN), speed. Held: force above its lower (NORMAL) and below
    its upper bound (FRICTION), of which the end it rests on takes one away.
    """
    status, nc = OK, system.sizes.nc
    for g in range(system.joint_count[0]):
        i, limit, numbers = nc + g, system.joint_int[g], system.joint_real[g]
        value, position, force = cleared(system.event_functions[i]), system.gaps[i, 0], system.force[i, 2]
        if system.contact_int[i, MODE] == FREE:
            if numbers[LOW_END] > -math.inf:
                value[GAP_EVENT] = position - numbers[LOW_END]
            if numbers[HIGH_END] < math.inf:
                value[DOMAIN_EVENT] = numbers[HIGH_END] - position
            if limit[JOINT_SIGN] != 0:
                value[SPEED_EVENT] = limit[JOINT_SIGN] * system.slip[i, 2]
        else:
            low, high, k = numbers[LOW_FORCE], numbers[HIGH_FORCE], limit[JOINT_V]
            # as in free flight, where nothing presses joints onto their ends; L_kk, with M = L^T L, is the root of the
            # inertia that the joint feels
            slack = _ROUND_OFF * system.factor[k, k] * system.scalars.free_size
            if limit[JOINT_END] == 0:
                slack = system.contact_real[i, LIMIT_SLACK] * (high - low)
            if limit[JOINT_END] <= 0:
                value[NORMAL_EVENT] = force - low + slack
            if limit[JOINT_END] >= 0:
                value[FRICTION_EVENT] = high - force + slack
        status = max(status, status_of(value))
    return status


@kernel
def has_sided_load(integers, numbers):
    """Whether something goes with the size of the load of a bilateral contact, which vanishes as it changes sides."""
    if integers[UNILATERAL] != 0 or integers[PATTERN] == ON_CURVE:
        return False
    sticks = integers[MODE] == STICK and numbers[MU_STATIC] < math.inf
    return sticks or integers[MODE] == SLIPPING or resists(integers)


@kernel
def contact_event_functions(system):
    """Event functions of contacts: gap of open ones, and the end of a domain that they may come over while it is
    negative; end of the domain, load and friction of the others.

    Forces of slip are completed on the way: friction, and what is viscous.
    """
    status = OK
    for c in range(system.sizes.nc):
        integers, numbers, value, force = (
            system.contact_int[c],
            system.contact_real[c],
            cleared(system.event_functions[c]),
            system.force,
        )
        if integers[MODE] == FREE:
            value[GAP_EVENT] = system.gaps[c, 0]
            if numbers[DOMAIN] < math.inf:
                # beside a contour it may be on any side of what that would go on as
                value[DOMAIN_EVENT] = max(system.gaps[c, 0], -numbers[DOMAIN])
        else:
            value[DOMAIN_EVENT] = numbers[DOMAIN]
            if integers[UNILATERAL] != 0:
                value[NORMAL_EVENT] = force[c, 2]
                if integers[MODE] == STICK and numbers[MU_STATIC] == math.inf:
                    # the limit of friction, too
                    slack = numbers[LIMIT_SLACK] * system.scalars.largest_force
                    value[NORMAL_EVENT] += slack - math.hypot(force[c, 0], force[c, 1]) / IDEAL_FRICTION
                elif integers[MODE] == FRICTIONLESS and numbers[MU_STATIC] == math.inf:
                    # what comes under a load slides no more
                    least = _least_load(system, c)
                    value[NORMAL_EVENT], value[FRICTION_EVENT] = force[c, 2] + least, least - force[c, 2]
            elif has_sided_load(integers, numbers):
                value[NORMAL_EVENT] = integers[NORMAL_SIGN] * force[c, 2]
            friction_event_functions(system, c, size_of_load(system.contact_int, force, c))
            if resists_viscously(integers, numbers):
                for row in range(integers[TANGENTS]):
                    force[c, row] += viscous_force(numbers, system.basis[c, row], system.slip[c])
        status = max(status, status_of(value))
    return status


@kernel
def _least_load(system, c):
    """The largest load in N of contact c that counts as none beside what else acts on its bodies."""
    whiten(system.factor, system.parents, system.sizes.nv, system.rows[c, 2], system.work)
    size = math.sqrt(inner(system.work, system.work, system.sizes.nv))
    return _LOADED * system.scalars.free_size / (IDEAL_FRICTION * size) if size > 0.0 else 0.0


@kernel
def resistance_event_functions(system, first, total):
    """Event functions of the resistances to turning, items first .. total, whose loads are their contacts'."""
    status, contact_int = OK, system.contact_int
    for i in range(first, total):
        value = cleared(system.event_functions[i])
        friction_event_functions(system, i, size_of_load(contact_int, system.force, contact_int[i, OWNER]))
        status = max(status, status_of(value))
    return status


@kernel
def friction_event_functions(system, c, load):
    """Friction of item c under a load |F_n|: complete its force in slip, fill its event functions."""
    integers, numbers, value, force = (
        system.contact_int[c],
        system.contact_real[c],
        system.event_functions[c],
        system.force[c],
    )
    tangents = integers[TANGENTS]
    if integers[MODE] == STICK:
        if numbers[MU_STATIC] < math.inf:
            tangential = abs(force[0])
            if tangents == 2:
                tangential = friction_length(integers, numbers, force[0], force[1])
            # a load may be what round-off of others leaves
            slack = numbers[LIMIT_SLACK] * (numbers[MU_STATIC] * load + system.scalars.largest_force)
            value[FRICTION_EVENT] = numbers[MU_STATIC] * load - tangential + slack
    elif integers[MODE] == SLIPPING:
        relative, direction = system.relative_acceleration[c], system.vectors[0]
        for row in range(3):
            relative[row] = inner(system.rows[c, row], system.acceleration, system.sizes.nv) + system.bias[c, row]
        speed = slip_direction(integers, numbers, system.slip[c], system.basis[c], system.scalars.time, direction)
        rate = direction[0] * relative[0]
        if tangents == 2:
            rate += direction[1] * relative[1]
        elif integers[FROZEN] == 0 and numbers[MU] > 0.0:
            value[SPEED_EVENT] = speed
        numbers[SLIP_SPEED], numbers[SLIP_RATE] = speed, rate
        friction, shares = numbers[MU_NOW] * load, shares_viscous_force(integers)
        if is_held_up(integers, numbers):
            friction, force[2] = force[2], 0.0
        if shares:
            value[FRICTION_EVENT] = numbers[VISCOUS] * abs(speed) - friction
        elif tangents == 2:
            friction_direction(integers, numbers, direction)
        for row in range(tangents):
            force[row] = -friction * direction[row]


@kernel
def jam_event_functions(system, count):
    """Event functions of contacts that slide, held up by friction alone: whether it still pushes the bodies apart."""
    status = OK
    for r in range(count if system.counters.decided == 0 else 0):
        c = system.row_index[r, 0]
        if c < system.sizes.nc and system.contact_int[c, MODE] == SLIPPING and system.contact_real[c, MU] == math.inf:
            system.event_functions[c, FRICTION_EVENT] = system.contact_real[c, LIFT] - JAM_LIMIT
            if system.event_functions[c, FRICTION_EVENT] < 0.0:
                status = EVENT
    return status
