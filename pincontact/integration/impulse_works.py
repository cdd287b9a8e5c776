"""Work of the impulses of a step of Moreau's method, and the account of works over it."""

from __future__ import annotations

import math

from ..arrays import REALS, array_type
from ..callback import separate_kernel
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import CALLED, NOTHING, REAL, kernel
from ..layout import (
    DAMPING_WORK,
    DRIVE_WORK,
    FREE,
    FRICTION_WORK,
    PATTERN,
    SYSTEM,
    TORQUE_WORK,
    UNILATERAL,
)
from ..linalg import inner
from .impulse_layout import DRY_FRICTION, ON_JOINT, ON_TURN, STEP
from .impulse_velocities import free_gain, rigid_velocity, start_velocity
from .stages import is_driven


@kernel
def velocity_change(step, nv, out):
    """out (nv,) = change of velocity by all impulses, whitened."""
    equations, share, forces, whitened = step.equations, step.equation_share, step.cone_forces, step.whitened
    for k in range(nv):
        out[k] = 0.0
    for e in range(step.counts.equations):
        for k in range(nv):
            out[k] += share[e] * equations[e, k]
    for r in range(3 * step.counts.units):
        if forces[r] != 0.0:
            for k in range(nv):
                out[k] += forces[r] * whitened[r, k]


@kernel
def impulse_work(step, nv, h, scratch):
    """Work of the contacts' impulses on v_c, of the joints' units, the sum of the sizes of all terms, and the kinetic
    energy that these impulses bring beyond what the smooth forces account for within the step.

    Work: an impulse times the mean of the velocities at the step's ends, or of its part in an impact times that of the
    velocities right before and after it. Kinetic energy: always those at the step's ends. Impulses of equations do no
    work on v_c. Large impulses that nearly cancel (a wedged chain) magnify what the smooth forces do around their
    instants, which is known to first order only: no more of it is counted than the change of velocity and that by the
    smooth forces allow. scratch: (nv,).
    """
    kept, forces, velocities = step.numbers.kept, step.cone_forces, step.cone_velocities
    on_contacts, on_joints, size, meanwhile = 0.0, 0.0, 0.0, 0.0
    for u in range(step.counts.units):
        unit, work = step.units[u], 0.0
        for row in range(2):
            if unit.mask >> row & 1 != 0:
                mean = velocities[3 * u + row]
                if unit.midpoint == 0:
                    mean += step.unit_start[u, row]
                work += 0.5 * forces[3 * u + row] * mean
        size += abs(work)
        if unit.touches != 0:
            after = velocities[3 * u + 2] + kept * unit.shift
            gained = unit.impulse_time * unit.free_rate
            later = (h - unit.impulse_time) * unit.free_rate
            before = unit.approach
            if unit.shift > 0.0:
                after -= later
                gained -= later
            elif later < 0.0 and before < 0.0:
                # it stays: the part of the impulse that holds it for the rest of the step does no work
                before *= before / (before + later)
                gained -= unit.approach - before
            # what the smooth forces do before and after the impact
            meanwhile += 0.5 * forces[3 * u + 2] * gained
            work += 0.5 * forces[3 * u + 2] * (before + after)
            size += 0.5 * forces[3 * u + 2] * (abs(unit.approach) + abs(after))
        if unit.kind == ON_JOINT:
            on_joints += work
        else:
            on_contacts += work
    kinetic = on_contacts + on_joints - meanwhile
    velocity_change(step, nv, scratch)
    accounted = step.numbers.free_change * math.sqrt(inner(scratch, scratch, nv))
    on_contacts += max(-accounted, min(meanwhile, accounted)) - meanwhile
    return on_contacts, on_joints, size, kinetic - accounted


@kernel
def _work_on_misses(system, step):
    """Work in J of impulses of closed contacts on constrained velocities that are not zero at the step's start, as in
    the first step from a state that does not keep to its constraints."""
    basis, contact_int = system.basis, system.contact_int
    start_slip, start_normal, impulse = step.start_slip, step.start_normal, step.contact_impulse
    index, of_equations, twice = step.equation_index, step.equation_impulse, 0.0
    for c in range(system.sizes.nc):
        if contact_int[c, UNILATERAL] != 0 and step.start_mode[c] != FREE:
            twice += impulse[c, 2] * start_normal[c, 0]
    for e in range(step.counts.equations):
        c, row = index[e, 0], index[e, 1]
        if row == 2 or (row == 1 and contact_int[c, PATTERN] == ON_CURVE):
            twice += of_equations[e] * start_normal[c, 2 - row]
        else:
            twice += of_equations[e] * dot(basis[c, row], start_slip[c])
    return 0.5 * twice


@kernel
def energy_made(system, step):
    """Energy in J that impulses of contacts make as geometry changes in the step, on top of their work on v_c: of first
    order in the step's error, and none in rigid geometry."""
    if step.counts.rigid != 0:
        return 0.0
    half, made = 0.5 * step.numbers.h, 0.0
    for c in range(system.sizes.nc):
        for row in range(3):
            impulse = step.contact_impulse[c, row]
            if impulse != 0.0:
                mean = start_velocity(system, step, c, row) + half * system.bias[c, row]
                made += impulse * (rigid_velocity(system, step, c, row) - mean)
    return made


@kernel
def energy_put_right(system, before, after):
    """Kinetic energy in J that putting the step's end on the constraints makes, or less than none, by changing the
    velocities before (nv,) to those after."""
    mass, made = system.mass, 0.0
    for i in range(system.sizes.nv):
        change, whole = after[i] - before[i], after[i] + before[i]
        made += 0.5 * mass[i, i] * change * whole
        for k in range(i):
            made += 0.5 * mass[i, k] * (change * (after[k] + before[k]) + (after[k] - before[k]) * whole)
    return made


@kernel
def count_energy_made(numbers):
    """Add up what the accepted steps have made."""
    numbers.made_so_far += numbers.made
    numbers.least_made = min(numbers.least_made, numbers.made_so_far)
    numbers.most_made = max(numbers.most_made, numbers.made_so_far)
    numbers.most_moving = max(numbers.most_moving, numbers.moving)


@kernel
def _work_of_drives(system, step):
    """What prescribed motions do: what impulses do on the joints less what they do on v_c."""
    nv, v0, side_int, work = system.sizes.nv, step.transported_v, system.side_int, 0.0
    for c in range(system.sizes.nc):
        for row in range(3 if is_driven(side_int, c) else 0):
            line = system.rows[c, row]
            # what v_c is on average where nothing but the motion moves it, against what the joints make of it
            driven = start_velocity(system, step, c, row)
            driven += 0.5 * (free_gain(system, step, c, row) - inner(line, step.change, nv))
            work += step.contact_impulse[c, row] * (inner(line, v0, nv) - driven)
    for u in range(step.counts.units):
        if step.units[u].kind == ON_TURN:
            for row in range(2):
                work += step.cone_forces[3 * u + row] * step.unit_driven[u, row]
    return work


@separate_kernel(NOTHING, SYSTEM.type, STEP.type, array_type(REALS, 1), REAL, array_type(REALS, 1), when=CALLED)
def add_works(system, step, v1, viscous, works):
    """Works over the step, with that of viscous friction."""
    nv, h, v0, tau, damping = system.sizes.nv, step.numbers.h, step.transported_v, system.tau, system.damping
    on_contacts, on_joints, _, _ = impulse_work(step, nv, h, system.work)
    works[FRICTION_WORK] += on_contacts + viscous + _work_on_misses(system, step)
    works[DRIVE_WORK] += _work_of_drives(system, step)
    works[DAMPING_WORK] += on_joints
    for k in range(nv):
        mean = 0.5 * (v0[k] + v1[k])
        works[TORQUE_WORK] += h * tau[k] * mean
        works[DAMPING_WORK] -= h * damping[k] * mean * mean
    for j in range(step.counts.joints):
        joint = step.joints[j]
        if joint.kind == DRY_FRICTION:
            # the constant part of a range that is not symmetric, beside the unit's
            works[DAMPING_WORK] += h * joint.middle * 0.5 * (v0[joint.index_v] + v1[joint.index_v])
