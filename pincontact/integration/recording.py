"""Outputs of a run: rows that the compiled steps write."""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..dynamics.equations import dry_friction_force
from ..dynamics.resistance import count_items
from ..jit import NOTHING, REAL, kernel
from ..layout import CHART, CONTACT_INTS, FREE, FROZEN_COLUMNS, JOINT_V, MODE, OWNER, START, SYSTEM, TANGENTS
from ..workspace import flat

# Integers of a contact in a row: its own, and its two charts.
INTEGERS_PER_CONTACT = CONTACT_INTS + 2
# Rows that the compiled steps may write before they have to come back.
BLOCK = 256


@separate_kernel(NOTHING, SYSTEM.type, REAL)
def record_row(system, t):
    """Write the state in (Q, V, LOCATION) at t as the next row: t, q, v, tau, works, location, frozen directions,
    contact forces where evaluations of the contacts alone do not give them, torques on body 2 that resist turning where
    there may be any.
    """
    sizes, index = system.sizes, system.counters.recorded
    nq, nv, nc, nwork = sizes.nq, sizes.nv, sizes.nc, sizes.nwork
    row, whole = system.recorded_reals[index], system.recorded_integers[index]
    modes, force, rows = system.contact_int, system.force, system.rows
    ng, n = system.joint_count[0], count_items(system)
    row[0] = t
    at = _put(row, 1, system.q, nq)
    at = _put(row, at, system.v, nv)
    torque = row[at:]
    at = _put(row, at, system.tau, nv)
    # the forces of limits, dry friction and resistances go with the torques, so that contact forces can be found again
    for g in range(ng):
        mode, limit = modes[nc + g, MODE], system.joint_int[g]
        held = force[nc + g, 2] if mode != FREE else 0.0
        torque[limit[JOINT_V]] += held + dry_friction_force(mode, limit, system.joint_real[g])
    for i in range(nc + ng, n):
        if modes[i, MODE] != FREE:
            for j in range(modes[i, TANGENTS]):
                for k in range(nv):
                    torque[k] += rows[i, j, k] * force[i, j]
    at = _put(row, at, system.stage_state[sizes.ny - nwork :], nwork)
    at = _put(row, at, flat(system.location), 4 * nc)
    for c in range(nc):
        at = _put(row, at, system.contact_real[c, START:], FROZEN_COLUMNS)
        charts = _put(whole, c * INTEGERS_PER_CONTACT, modes[c], CONTACT_INTS)
        for k in range(2):
            whole[charts + k] = system.side_int[2 * c + k, CHART]
    # contacts alone would choose others than they do together with joints and resistances, or have chosen before
    told = 1.0 if n > nc else system.scalars.has_reference
    for c in range(nc):
        for k in range(3):
            row[at + 3 * c + k] = told * force[c, k]
    at += 3 * nc
    if n > nc + ng:
        turning = row[at:]
        for k in range(3 * nc):
            turning[k] = 0.0
        for i in range(nc + ng, n):
            if modes[i, MODE] != FREE:
                for j in range(modes[i, TANGENTS]):
                    for k in range(3):
                        turning[3 * modes[i, OWNER] + k] += force[i, j] * system.basis[i, j, k]
    system.counters.recorded = index + 1


@kernel
def _put(row, at, values, count):
    """Write so many values into a row; returns where the next ones begin."""
    for k in range(count):
        row[at + k] = values[k]
    return at + count


@kernel
def output_done(system):
    """Go on to the next output time."""
    counters = system.counters
    counters.outputs_done += 1
    announce_output(system)


@kernel
def announce_output(system):
    """NEXT_OUTPUT from the list of output times."""
    counters = system.counters
    done, count = counters.outputs_done, counters.output_count
    times = system.output_times
    system.scalars.next_output = times[done] if done < count else math.inf
