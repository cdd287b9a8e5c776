"""The cone problem of one step of Moreau's method: rows of its units and equations, the Delassus matrix and b.

Equations (see `impulse_equations`) are eliminated before. Viscous friction of contacts enters like joint damping, with
the velocity of slip in the midpoint's geometry. Coefficients that depend on the speed of slip are those of its speed at
the midpoint; elliptic cones are stretched to round ones (see `friction.ellipse`).

Of the two relative velocities at the step's end (see `impulse_velocities`) steps with impacts take that of rigid
geometry, and those in which redundant contacts contradict each other by what it leaves out. Sliding contacts take the
mean of u and w_0 instead, which makes friction second order too, until one of them stops.
"""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..dynamics.least_forces import IMMOBILE
from ..dynamics.resistance import drop_unturned
from ..friction.ellipse import scale_pair
from ..geometry.carriers import ALPHA, OMEGA
from ..jit import INTEGER, NOTHING, STEPPING, entry_kernel, kernel
from ..layout import (
    ANISOTROPIC,
    LENGTH,
    MASS_NOT_POSITIVE,
    NOT_FINITE,
    OK,
    SLIPPING,
    SYSTEM,
    system_at,
)
from ..linalg import RANK_TOLERANCE, factorize_tree, inner, solve_gram, unwhiten, whiten
from ..workspace import square
from .actuators import add_actuators, end_weight
from .impulse_equations import REDUNDANT, gather_equations
from .impulse_layout import APART, DRY_FRICTION, ON_CONTACT, ON_JOINT, ON_TURN, STEP, UPPER_LIMIT, step_at
from .impulse_units import gather_contacts, gather_joints, gather_turns, set_impact_friction
from .impulse_velocities import add_turn_row, beyond_rigid, free_gain, relative_turning, rigid_velocity, start_velocity
from .impulse_viscous import add_viscous

# What slides or opens by less in a step, relative to the contact's length, does not: round-off of velocities. In rad,
# the same of turning. Short steps take the rate, in 1/s^2, times their square: an acceleration. What begins from rest
# covers less in a step than any fixed way if steps are short enough, and would never slide.
_OPENING, _OPENING_RATE = 1e-12, 1e-6
# Mobility, relative to the unit's, of what slides whatever the forces.
_NO_MOBILITY = 1e-9
# Relative to b, this is round-off.
_WITHIN_ROUND_OFF = 1e-14
# By this part of b redundant contacts contradict each other at most where gaps at the midpoint make them do so.
_OUT_OF_REACH = 1e-5


@kernel
def _joint_row(step, j, nv, line):
    """Row of joint limit or dry friction j; returns what `_contact_row` does."""
    joint = step.joints[j]
    k = joint.index_v
    for i in range(nv):
        line[i] = 0.0
    line[k] = -1.0 if joint.kind == UPPER_LIMIT else 1.0
    start = line[k] * step.transported_v[k]
    return start, line[k] * step.change[k], start, 0.0


@kernel
def _turn_row(system, step, u, row, nv, line):
    """Row of unit u that resists turning; returns what `_contact_row` does."""
    c, axis = step.units[u].index, step.units[u].axis + row
    for i in range(nv):
        line[i] = 0.0
    add_turn_row(system, c, axis, 1.0, line)
    drop_unturned(line, nv)
    # what the bodies turn at the midpoint, and what drives add to it
    turned, turning = inner(line, system.v, nv), relative_turning(system, c, axis, OMEGA)
    step.unit_driven[u, row] = turned - turning
    beyond = 0.0
    if step.counts.rigid == 0:
        rate = inner(line, step.turning_rate, nv)
        beyond = 0.5 * step.numbers.h * (relative_turning(system, c, axis, ALPHA) - rate)
    start = turning + inner(line, step.transported_v, nv) - turned - beyond
    return start, inner(line, step.change, nv) + 2.0 * beyond, start, beyond


@kernel
def _contact_row(system, step, c, row, nv, line):
    """Row of contact c. Returns the velocity along it at the step's start, what it gains without impulses, the velocity
    whose mean with that at the end is the mean of slip in rigid geometry, and what rigid geometry leaves out of the
    velocity at the end."""
    for i in range(nv):
        line[i] = system.rows[c, row, i]
    start, gain = start_velocity(system, step, c, row), free_gain(system, step, c, row)
    beyond = beyond_rigid(system, step, c, row, start, gain)
    return start, gain, rigid_velocity(system, step, c, row) - beyond, beyond


@kernel
def _set_impact(unit, start, rate, restitution, h):
    """Newton's law for a unit that closes: its rebound, less what the smooth forces take back by the step's end.

    They add nothing to it: what they would lift is closed to the step's end, and free to leave in the next one. The
    rate holds the forces of the last step, which may have been the unit's own.
    """
    approach = start + unit.impulse_time * rate
    unit.approach, unit.free_rate = approach, rate
    if approach < 0.0:
        unit.shift = max(-restitution * approach + (h - unit.impulse_time) * min(rate, 0.0), 0.0)


@kernel
def _fill_row(system, step, u, row):
    """Whitened row of unit u and its part of b, after the equations have taken their share."""
    nv, m, unit, r = system.sizes.nv, step.counts.equations, step.units[u], 3 * u + row
    line, overlap, b = step.whitened[r], step.overlap[r], step.loads
    b[r] = 0.0
    if unit.mask >> row & 1 == 0:
        for k in range(nv):
            line[k] = 0.0
        for j in range(m):
            overlap[j] = 0.0
        step.beyond[r, 0] = 0.0
        return
    if unit.kind == ON_JOINT:
        start, gain, opposed, beyond = _joint_row(step, unit.index, nv, line)
    elif unit.kind == ON_TURN:
        start, gain, opposed, beyond = _turn_row(system, step, u, row, nv, line)
    else:
        start, gain, opposed, beyond = _contact_row(system, step, unit.index, row, nv, line)
    b[r] = start + gain
    if row < 2:
        # slip is opposed along the mean of its velocities at both ends: in rigid geometry
        step.unit_start[u, row] = opposed if unit.midpoint != 0 else start
    elif unit.touches != 0:
        restitution = step.restitution[unit.index] if unit.kind != ON_JOINT else 0.0
        _set_impact(unit, start, inner(line, step.transported_trend, nv), restitution, step.numbers.h)
    whiten(system.factor, system.parents, nv, line, line)
    whole, terms = inner(line, line, nv), abs(start) + abs(gain)
    for j in range(m):
        equation = step.equations[j]
        part = inner(line, equation, nv)
        overlap[j] = part
        b[r] += part * step.equation_share[j]
        terms += abs(part * step.equation_share[j])
        beyond += part * step.equation_beyond[j]
        for k in range(nv):
            line[k] -= part * equation[k]
    step.beyond[r, 0] = beyond
    if m > 0 and whole > 0.0 and inner(line, line, nv) <= REDUNDANT * REDUNDANT * whole:
        # the equations say it, too: what is left of it is round-off (what no joint moves they say nothing of), but for
        # slip that they leave to drives
        if row == 2 or abs(b[r]) <= REDUNDANT * terms:
            b[r] = 0.0
        for k in range(nv):
            line[k] = 0.0
        if row == 2 and unit.kind == ON_CONTACT:
            unit.tied = 1


@kernel
def least_way(h):
    """What slides or opens by no more in a step of h s does not: relative to the contact's length, or in rad."""
    return min(_OPENING, _OPENING_RATE * h * h)


@separate_kernel(NOTHING, SYSTEM.type, STEP.type, INTEGER, when=STEPPING)
def fill_unit(system, step, u):
    """Rows of unit u; elliptic cones are stretched."""
    unit, start, rigid = step.units[u], step.unit_start, step.counts.rigid != 0
    if rigid:
        # means of both ends and velocities at the end are not those of one rigid body
        unit.midpoint = 0
    for row in range(3):
        _fill_row(system, step, u, row)
    if step.counts.touched != 0 and unit.kind < ON_JOINT:
        set_impact_friction(system, step, u)
    if unit.kind == ON_TURN and unit.mask == 3 and not rigid:
        moves = math.hypot(start[u, 0], start[u, 1]) * step.numbers.h > least_way(step.numbers.h)
        unit.midpoint = 1 if moves else 0
    elif unit.kind < ON_JOINT and system.contact_int[unit.index, ANISOTROPIC] != 0:
        numbers, r = system.contact_real[unit.index], 3 * u
        first, second, b = step.whitened[r], step.whitened[r + 1], step.loads
        for k in range(system.sizes.nv):
            first[k], second[k] = scale_pair(numbers, first[k], second[k])
        first, second, beyond = step.overlap[r], step.overlap[r + 1], step.beyond
        for j in range(step.counts.equations):
            first[j], second[j] = scale_pair(numbers, first[j], second[j])
        beyond[r, 0], beyond[r + 1, 0] = scale_pair(numbers, beyond[r, 0], beyond[r + 1, 0])
        b[r], b[r + 1] = scale_pair(numbers, b[r], b[r + 1])
        start[u, 0], start[u, 1] = scale_pair(numbers, start[u, 0], start[u, 1])


@separate_kernel(NOTHING, SYSTEM.type, STEP.type, when=STEPPING)
def keep_within_reach(system, step):
    """Redundant contacts: take out of b what no motion of rigid bodies could follow.

    Gaps at the midpoint put a little of that into b where contacts move with the bodies that they are on. More of it is
    in what second order adds to rigid geometry, in the first column of BEYOND. What drives ask for beyond the range of
    the Delassus matrix is left: there something has to slip. Tangents of contacts that slide already take no part: they
    need not come to rest, and what changes their slip does so whatever the impulses.
    """
    n = step.counts.units
    units, beyond, start_mode = step.units, step.beyond, step.start_mode
    delassus, b = square(step.delassus, 3 * n), step.loads
    nv, rows, x = system.sizes.nv, system.whitened_rows, system.multipliers
    # all of b, and where that leaves more than gaps explain, second order alone; what is left goes to the second column
    for whole in range(1, -1, -1):
        count, independent, largest, scale = 0, 0, 0.0, 0.0
        while count < 3 * n and units[count // 3].kind < ON_JOINT:
            held = count % 3 == 2 or start_mode[units[count // 3].index] != SLIPPING
            x[count] = (b[count] if whole == 1 else beyond[count, 0]) if held else 0.0
            largest, scale = max(largest, abs(beyond[count, 0]) if held else 0.0), max(scale, abs(b[count]))
            if held and delassus[count, count] > 0.0:
                independent += 1
            for k in range(nv):
                rows[count, k] = step.whitened[count, k] if held else 0.0
            count += 1
        if largest <= _WITHIN_ROUND_OFF * scale:
            return
        lower, scratch = system.delassus, system.constraint_rows
        rank = solve_gram(rows, count, nv, lower, system.permutation, x, scratch, RANK_TOLERANCE)
        if rank == independent:
            return
        most = 0.0
        for r in range(count):
            held = r % 3 == 2 or start_mode[units[r // 3].index] != SLIPPING
            wanted = b[r] if whole == 1 else beyond[r, 0]
            beyond[r, 1] = wanted - inner(delassus[r], x, count) if held else 0.0
            most = max(most, abs(beyond[r, 1]))
        if whole == 1 and most > _OUT_OF_REACH * scale:
            continue
        for r in range(count):
            b[r] -= beyond[r, 1]
        return


@kernel
def _complete_unit(unit, mu, start, delassus, b, r, least):
    """Rows that only fill up the cone of a unit, whose first row is r, its given load, its rebound, and the mean of
    slip over the step; least: what moves along a row by more, m/s or rad/s, moves."""
    # as heavy as the real ones, since the solver scales by the mean
    weight = max(delassus[r, r], max(delassus[r + 1, r + 1], delassus[r + 2, r + 2]))
    if weight == 0.0:
        weight = 1.0
    for row in range(3):
        if unit.mask >> row & 1 == 0:
            delassus[r + row, r + row] = weight
    if unit.mask & 4 == 0:
        # a given normal load: u = weight (F - load) has to vanish
        b[r + 2] = -weight * unit.load
    b[r + 2] -= unit.shift
    if unit.midpoint != 0:
        b[r] += start[0]
        b[r + 1] += start[1]
    for k in range(r, r + 3):
        if delassus[k, k] <= IMMOBILE * weight:
            # no joint moves the bodies along it
            if k < r + 2 and abs(b[k]) > least and mu < math.inf:
                # drives do: friction acts, and changes nothing of that slip
                delassus[k, k] = _NO_MOBILITY * weight
            else:
                # no impulse, whatever the round-off in b asks for
                delassus[k, k], b[k] = weight, 0.0


@kernel
def _fill_units(system, step):
    """Whitened rows, Delassus matrix and b of all units."""
    n, nv = step.counts.units, system.sizes.nv
    whitened, delassus = step.whitened, square(step.delassus, 3 * n)
    for u in range(n):
        fill_unit(system, step, u)
    for i in range(3 * n):
        for j in range(i + 1):
            delassus[i, j] = delassus[j, i] = inner(whitened[i], whitened[j], nv)
    if step.counts.rigid == 0:
        keep_within_reach(system, step)
    for u in range(n):
        unit = step.units[u]
        length = system.contact_real[unit.index, LENGTH] if unit.kind < ON_JOINT else 1.0
        least = least_way(step.numbers.h) * length / step.numbers.h
        _complete_unit(unit, step.friction[u], step.unit_start[u], delassus, step.loads, 3 * u, least)


@separate_kernel(INTEGER, SYSTEM.type, STEP.type, when=STEPPING)
def change_freely(system, step):
    """Change of velocity without impulses, and the factor of M + (h/2) D with what actuators add; a status."""
    nv, h, counts, numbers = system.sizes.nv, step.numbers.h, step.counts, step.numbers
    mass, factor, parents = system.mass, system.factor, system.parents
    damping, tau, nle = system.damping, system.tau, system.nle
    v, change, trend = step.transported_v, step.change, step.transported_trend
    for i in range(nv):
        factor[i, i] = mass[i, i] + 0.5 * h * damping[i]
        j = parents[i]
        while j >= 0:
            factor[i, j] = mass[i, j]
            j = parents[j]
        change[i] = h * system.moves[i] * (tau[i] - nle[i] - damping[i] * v[i])
    for j in range(counts.joints):
        if step.joints[j].kind == DRY_FRICTION:
            change[step.joints[j].index_v] += h * step.joints[j].middle
    if counts.actuators > 0:
        numbers.weight = end_weight(step, mass, h)
        add_actuators(step, h, factor, change)
    add_viscous(system, step, change)
    if not factorize_tree(factor, parents, nv, factor):
        return MASS_NOT_POSITIVE
    whiten(factor, parents, nv, change, change)
    numbers.free_change = math.sqrt(inner(change, change, nv))
    unwhiten(factor, parents, nv, change, change)
    total = 0.0
    for k in range(nv):
        total += change[k]
        if counts.has_trend == 0:
            trend[k] = change[k] / h
    return NOT_FINITE if total - total != 0.0 else OK


@kernel
def _assemble(system, step):
    counts, numbers = step.counts, step.numbers
    counts.units = counts.equations = counts.reviews = counts.touched = 0
    counts.coupled = APART
    numbers.kept, numbers.kept_low, numbers.kept_high = 1.0, 0.0, 1.0
    status = change_freely(system, step)
    if status != OK:
        return status
    gather_contacts(system, step)
    gather_turns(system, step)
    gather_joints(step)
    # last, since the geometry of the step depends on whether anything touches
    gather_equations(system, step)
    _fill_units(system, step)
    return OK


@entry_kernel(INTEGER, INTEGER, when=STEPPING)
def assemble(system_address, step_address):
    """The cone problem of the step from the kinematics at its midpoint; OK, or a status of `layout`.

    Its size is counts.units; counts.rigid says which geometry to take, and is set where anything touches.
    """
    return _assemble(system_at(system_address), step_at(step_address))
