"""Slips that jam, since no forces in them are those of Coulomb's law, or no step is short enough: ideal rolling held up
by friction alone, and what is as slow as slip that counts as ended. They are ended at once, by the least change of
velocity that does it."""

from __future__ import annotations

import math

import numpy as np

from ..dynamics.system import System
from ..layout import EVENT, FRICTION_EVENT, MODE, MU, SLIPPING, STICK
from .accuracy import slow_slips
from .mode_changes import ModeChanges


def held_up(system: System) -> list[int]:
    """Contacts of ideal rolling that slide held up by friction alone."""
    modes, mu = system.modes.tolist(), system.contact_real[:, MU].tolist()
    return [c for c, mode in enumerate(modes) if mode == SLIPPING and mu[c] == math.inf]


def may_stop(system: System) -> list[int]:
    """What may be stopped at once where it jams: see `held_up` and `slow_slips`."""
    return sorted({*held_up(system), *slow_slips(system)})


def stop_jammed(changes: ModeChanges, t: float) -> None:
    """Stop slips that friction alone would have to hold up and cannot: the force it takes grows without bound."""
    system, sliding = changes.system, held_up(changes.system)
    if sliding and changes.rk.evaluate(t) <= EVENT:
        sliding = [c for c in sliding if system.event_functions[c, FRICTION_EVENT] < 0.0]
    if sliding:
        stop_slips(changes, t, sliding)


def stop_slips(changes: ModeChanges, t: float, contacts: list[int]) -> None:
    """End slips at once, by the least change of velocity that does it."""
    changes.system.contact_int[contacts, MODE] = STICK
    changes.project(t, explained=True)


def end_jams(changes: ModeChanges, t: float, contacts: list[int]) -> None:
    """End the slips of jammed contacts, and decide the modes that follow."""
    energy = changes.counted_energy()
    stop_slips(changes, t, contacts)
    changes.count_loss(energy)
    changes.update_modes(t, changes.sticking(), dict.fromkeys(contacts, np.zeros(3)))
