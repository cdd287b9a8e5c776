"""Velocity constraints that cannot be met together: the projection that promised to meet them leaves some."""

from __future__ import annotations

import numpy as np

from ..dynamics.system import System
from ..geometry.patterns import ON_CURVE
from ..layout import FREE, MODE, PATTERN, STICK, TANGENTS
from .results import NO_CONTACT_FORCE, STEP_TOO_SMALL, Stop
from .stages import load_state

# Contacts are named whose velocity is off by more than this part of the largest.
_NAMED = 1e-3


def contradiction(system: System, t: float) -> str:
    """Which contacts contradict each other after the last projection of `stage_state`, and by how much; "" where none
    do. Leaves that state loaded, with its kinematics."""
    if not system.scalars["velocity_left"] > 0.0:
        return ""
    load_state(system.address)
    system.evaluate_kinematics(t)
    left = np.zeros(system.nc)
    for c in range(system.nc):
        ints, along = system.contact_int[c], system.basis[c] @ system.slip[c]
        if ints[MODE] == FREE:
            continue
        held = [2, 1] if ints[PATTERN] == ON_CURVE else [2]
        held += list(range(ints[TANGENTS])) if ints[MODE] == STICK else []
        left[c] = np.abs(along[held]).max()
    if not left.any():
        # joints at their stops
        return (
            f"velocity constraints cannot be met together: {system.scalars['velocity_left']:.3g} (m/s or rad/s) is left"
        )
    names = [contact.name for contact, off in zip(system.contacts, left) if off > _NAMED * left.max()]
    named = ", ".join(map(repr, names))
    return f"the velocity constraints of contacts {named} cannot be met together: {left.max():.3g} m/s is left"


def projection_failure(system: System, t: float) -> Stop:
    """The Stop for a step that could not be projected on the constraints."""
    contradicting = contradiction(system, t)
    if contradicting:
        return Stop(NO_CONTACT_FORCE, f"t = {t:.9g} s: {contradicting}")
    return Stop(
        STEP_TOO_SMALL,
        f"t = {t:.9g} s: the projection on the constraints failed: it would change the state by more than the step's "
        "error",
    )
