"""Hops too low to be resolved are ended at once, by the impulses of the whole hop.

A contact that leaves at the speed u while the acceleration a pulls it back misses the force that would keep it closed
for the time 2 u / a, and lands with the speed u. To leading order in u the velocities change by impulses: those that
are missed, of negative sign, those of landings, and those of whatever hops these begin at other contacts. Each has the
direction of its contact's force, along which friction is a part of it where the contact slides. Afterwards everything
is closed, which determines the sum at each contact.

A projection of the velocity would leave out the friction, with an error of first order in u, that is of the square root
of the hop's height.
"""

from __future__ import annotations

import numpy as np

from ..dynamics.system import System
from ..dynamics.units import unwhiten
from ..layout import MODE, SLIPPING

# Velocities along constraints, relative to the largest or 1, that are round-off.
_NONE = 1e-13
# Relative singular values of redundant constraints, and the part of the velocities to be ended that these may leave.
_REDUNDANT, _LEFT = 1e-9, 1e-6
# Where friction almost jams contacts its impulses grow without bound: those that change v by more than so many times
# the least change are not taken.
_LARGEST = 10.0


def end_hops(system: System) -> bool:
    """Change `system.v` so that everything closed stays closed; whether there are impulses that do it.

    Uses the rows, force directions and relative velocities of the last evaluation, which must have found forces.
    """
    count = int(system.counters["row_count"])
    if count == 0:
        return False
    items = system.row_index[:count]
    rows = system.whitened_rows[:count, : system.nv]
    slides = (system.contact_int[items[:, 0], MODE] == SLIPPING).any()
    directions = system.whitened_forces[:count, : system.nv] if slides else rows
    rates = np.array([system.basis[item, row] @ system.slip[item] for item, row in items.tolist()])
    if np.abs(rates).max() <= _NONE * max(1.0, float(np.abs(system.v).max())):
        return False
    sums = np.linalg.lstsq(rows @ directions.T, -rates, rcond=_REDUNDANT)[0]
    change = directions.T @ sums
    least = np.linalg.lstsq(rows, -rates, rcond=_REDUNDANT)[0]
    if np.abs(rows @ change + rates).max() > _LEFT * np.abs(rates).max():
        return False
    if np.linalg.norm(change) > _LARGEST * np.linalg.norm(least):
        return False
    system.v[:] += unwhiten(system, change)
    return True
