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
    redundant forces where they were chosen, torques on body 2 that resist turning where there may be any.
    """
    sizes, counters = system.sizes, system.counters
    nq, nv, nc, nwork = sizes.nq, sizes.nv, sizes.nc, sizes.nwork
    index = counters.recorded
    row = system.recorded_reals[index]
    whole = system.recorded_integers[index]
    q, v, tau, location = (
        system.q,
        system.v,
        system.tau,
        flat(system.location),
    )
    state = system.stage_state
    contact_int = system.contact_int
    contact_real = system.contact_real
    side_int = system.side_int
    row[0] = t
    at = 1
    for k in range(nq):
        row[at + k] = q[k]
    at += nq
    for k in range(nv):
        row[at + k] = v[k]
        row[at + nv + k] = tau[k]
    at += nv
    # the forces of limits, dry friction and resistances go with the torques, so that contact forces can be found again
    ng, n = system.joint_count[0], count_items(system)
    modes = system.contact_int
    limits, joint_real = system.joint_int, system.joint_real
    force, reference = system.force, system.reference
    basis, rows = system.basis, system.rows
    for g in range(ng):
        mode = modes[nc + g, MODE]
        held = force[nc + g, 2] if mode != FREE else 0.0
        row[at + limits[g, JOINT_V]] += held + dry_friction_force(mode, limits[g], joint_real[g])
    for i in range(nc + ng, n):
        if modes[i, MODE] != FREE:
            for j in range(modes[i, TANGENTS]):
                for k in range(nv):
                    row[at + k] += rows[i, j, k] * force[i, j]
    at += nv
    for k in range(nwork):
        row[at + k] = state[sizes.ny - nwork + k]
    at += nwork
    for k in range(4 * nc):
        row[at + k] = location[k]
    at += 4 * nc
    for c in range(nc):
        for k in range(FROZEN_COLUMNS):
            row[at + k] = contact_real[c, START + k]
        at += FROZEN_COLUMNS
        for k in range(CONTACT_INTS):
            whole[c * INTEGERS_PER_CONTACT + k] = contact_int[c, k]
        for k in range(2):
            whole[c * INTEGERS_PER_CONTACT + CONTACT_INTS + k] = side_int[2 * c + k, CHART]
    chosen = system.scalars.has_reference
    for c in range(nc):
        for k in range(3):
            row[at + k] = chosen * reference[c, k]
        at += 3
    if n > nc + ng:
        for k in range(3 * nc):
            row[at + k] = 0.0
    for i in range(nc + ng, n):
        if modes[i, MODE] != FREE:
            for j in range(modes[i, TANGENTS]):
                for k in range(3):
                    row[at + 3 * modes[i, OWNER] + k] += force[i, j] * basis[i, j, k]
    counters.recorded = index + 1


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
