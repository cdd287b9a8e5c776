"""Viscous friction of contacts in a step of Moreau's method, and how much of it acts where it would open its contact.

It acts while its contact is closed. Where bodies stay together without it and part with it, only a part acts, with
which there is no normal force and no motion apart: with less the bodies would press on each other, with more they would
part and, as then nothing parts them, come back. That part is found by regula falsi; the velocity apart, and the normal
impulse over what it takes to give the bodies a velocity, are linear in it but for changes elsewhere.
"""

from __future__ import annotations

from ..callback import separate_kernel
from ..jit import BOOLEAN, NOTHING, STEPPING, kernel
from ..layout import FREE, MODE, SYSTEM, TANGENTS, UNILATERAL, VISCOUS
from ..workspace import square
from .impulse_layout import ON_CONTACT, STEP
from .impulse_velocities import rigid_velocity

# The part is found where the contact presses with less than this of what it would without viscous friction.
_FOUND = 1e-6
# So much less is taken than would leave no normal force, so that the contact stays closed.
_LESS = 1e-7
_TRIES = 30
# Of a contact's search: the largest part known with which it stays closed, the least with which it opens, and the
# velocities there, see `_velocity_apart`.
CLOSED_PART, CLOSED_VELOCITY, OPEN_PART, OPEN_VELOCITY = range(4)


@kernel
def viscous_constant(system, step, c):
    """Impulse of viscous friction of contact c per velocity of slip, zero where none acts."""
    if step.start_mode[c] == FREE:
        return 0.0
    return step.numbers.h * step.viscous_part[c] * system.contact_real[c, VISCOUS]


@kernel
def add_viscous(system, step, change):
    """Viscous friction of the contacts closed at the start, in the system (its lower triangle) and the loads."""
    nv, factor = system.sizes.nv, system.factor
    for c in range(system.sizes.nc):
        constant = viscous_constant(system, step, c)
        if constant == 0.0:
            continue
        for row in range(system.contact_int[c, TANGENTS]):
            line, slip = system.rows[c, row], rigid_velocity(system, step, c, row)
            for i in range(nv):
                change[i] -= constant * slip * line[i]
                for j in range(i + 1):
                    factor[i, j] += 0.5 * constant * line[i] * line[j]


@kernel
def add_viscous_impulses(system, step, v1):
    """Add viscous impulses to those of the contacts; returns their work on v_c."""
    v0, impulse, work = step.transported_v, step.contact_impulse, 0.0
    for c in range(system.sizes.nc):
        constant = viscous_constant(system, step, c)
        if constant == 0.0:
            continue
        for row in range(system.contact_int[c, TANGENTS]):
            mean, line = rigid_velocity(system, step, c, row), system.rows[c, row]
            for k in range(system.sizes.nv):
                mean += 0.5 * line[k] * (v1[k] - v0[k])
            impulse[c, row] -= constant * mean
            work -= constant * mean * mean
    return work


@separate_kernel(NOTHING, SYSTEM.type, STEP.type, when=STEPPING)
def begin_sharing(system, step):
    """All of the viscous friction acts, until it opens a contact."""
    step.counts.sharings = 0
    for c in range(system.sizes.nc):
        step.viscous_part[c] = 1.0


@kernel
def _velocity_apart(step, u):
    """With which the contact of unit u opens, or, negative, that its normal impulse takes from the bodies alone."""
    r = 3 * u + 2
    if step.cone_forces[r] > 0.0:
        return -step.cone_forces[r] * square(step.delassus, 3 * step.counts.units)[r, r]
    return step.cone_velocities[r]


@separate_kernel(BOOLEAN, SYSTEM.type, STEP.type, when=STEPPING)
def shares_viscous(system, step):
    """Whether the step is to be taken again with another part of some contact's viscous friction."""
    again = False
    if step.counts.touched != 0 or step.counts.sharings == _TRIES:
        return False
    for u in range(step.counts.units):
        c = step.units[u].index
        if step.units[u].kind != ON_CONTACT or step.start_mode[c] == FREE or system.contact_int[c, UNILATERAL] == 0:
            continue
        if system.contact_real[c, VISCOUS] == 0.0:
            continue
        part, velocity, search = step.viscous_part[c], _velocity_apart(step, u), step.viscous_search[c]
        opens = velocity > 0.0 and system.contact_int[c, MODE] == FREE
        if part == 1.0:
            if opens:
                search[OPEN_PART], search[OPEN_VELOCITY] = 1.0, velocity
                step.viscous_part[c], again = 0.0, True
            continue
        if part == 0.0:
            if not velocity < 0.0:
                # it opens without it
                continue
        elif not opens and -velocity <= _FOUND * search[OPEN_VELOCITY]:
            continue
        first = CLOSED_PART if velocity < 0.0 else OPEN_PART
        search[first], search[first + 1] = part, velocity
        closed, opened = search[CLOSED_VELOCITY], search[OPEN_VELOCITY]
        share = -closed / (opened - closed) * (1.0 - _LESS)
        step.viscous_part[c] = search[CLOSED_PART] + share * (search[OPEN_PART] - search[CLOSED_PART])
        again = True
    step.counts.sharings += 1
    return again
