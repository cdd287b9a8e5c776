"""Constraints that are not met: closed contacts that are apart, and velocities that contradict each other."""

from __future__ import annotations

import numpy as np

from ..dynamics.system import System
from ..dynamics.units import whitened_velocity
from ..errors import StateError
from ..geometry.carriers import OMEGA, VELOCITY
from ..geometry.patterns import ON_CURVE
from ..layout import LENGTH, MODE, PATTERN, STICK, TANGENTS
from .projection import CONTRADICTING
from .results import FAILURES, NO_CONTACT_FORCE, STEP_TOO_SMALL, TOUCHES_TWICE, Stop
from .stages import load_state

# Contacts are named whose velocity is off by more than this part of the largest.
_NAMED = 1e-3
# A velocity that meets constraints up to this part of the speeds meets them; to lose more than that of it is a failure.
_MET, _LOST = 1e-6, 1e-3
# How far apart closed contacts may be where a motion begins, as a part of their natural length; they are put together.
CLOSED_WITHIN = 0.05


def apart(system: System, closed: list[int], within: float = CLOSED_WITHIN) -> dict[str, float]:
    """Contacts of these that are further apart than this part of their natural length, and by how many metres."""
    gaps = {c: max(map(abs, system.gaps[c].tolist())) for c in closed}
    return {system.contacts[c].name: gap for c, gap in gaps.items() if gap > within * system.contact_real[c, LENGTH]}


def refuse_apart(found: dict[str, float]) -> None:
    """Raise StateError where closed contacts of a state with which a motion is to begin are `apart`: q was changed."""
    for name, gap in found.items():
        raise StateError(
            f"contact {name!r} is closed in this state, but {gap:.3g} m apart: make a state of other q by "
            "scene.initial_state"
        )


def jump_apart(t: float, name: str, gap: float) -> Stop:
    """The Stop where a motion jumps at t, which leaves the bodies of this closed contact apart."""
    return Stop(
        STEP_TOO_SMALL,
        f"t = {t:.9g} s: a motion jumps, which moves the bodies of contact {name!r} {gap:.3g} m apart at once",
        blocked=True,
    )


def jump_into(t: float, name: str) -> Stop:
    """The Stop where the bodies of this open contact are inside each other at t, without having touched."""
    return Stop(
        STEP_TOO_SMALL,
        f"t = {t:.9g} s: the bodies of contact {name!r} are inside each other at once: a motion jumps, or they got "
        "there far from where they were nearest, which a smaller max_step shows",
        blocked=True,
    )


def touch_elsewhere(t: float, name: str, trouble: int = TOUCHES_TWICE) -> Stop:
    """The Stop where the bodies of this contact touch, but not where a contact may be."""
    code, reason = FAILURES[trouble]
    return Stop(code, f"t = {t:.9g} s: contact {name!r}: {reason}")


def crushed(t: float, where: list[str]) -> Stop:
    """The Stop where what moves presses bodies into each other at these contacts, and joints onto their ends."""
    return Stop(
        NO_CONTACT_FORCE,
        f"t = {t:.9g} s: bodies are crushed, and cannot give way to any forces: they are moved into each other at "
        f"{', '.join(where)}",
        blocked=True,
    )


def refuse_lost(system: System, t: float, given: np.ndarray) -> None:
    """Raise StateError where the system's velocity, on the constraints, has lost much of the given one (nv,), which met
    them in that configuration but for next to nothing: so it is where rows are next to redundant, or to zero. May leave
    the kinematics of the given one evaluated."""
    size = float(np.linalg.norm(whitened_velocity(system, given)))
    lost = float(np.linalg.norm(whitened_velocity(system, given - system.v)))
    if not lost > _LOST * size > 0.0:
        return
    found = system.v.copy()
    system.v[:] = given
    system.evaluate_kinematics(t)
    system.v[:], missed = found, _held_speeds(system)
    frames, points = system.frames[: 2 * system.nc], system.derivatives[: 2 * system.nc, 0]
    speeds = np.linalg.norm(frames[:, VELOCITY], axis=1)
    speeds += np.linalg.norm(frames[:, OMEGA], axis=1) * np.linalg.norm(points, axis=1)
    most = float(missed.max(initial=0.0))
    if most <= _MET * speeds.max(initial=0.0):
        name = system.contacts[int(np.argmax(missed))].name
        raise StateError(
            f"the velocity meets the constraints up to {most:.3g} m/s, but to meet them wholly takes {lost / size:.2%} "
            f"of it: those of contact {name!r} are next to redundant, or joints hardly move it along its normal, as "
            "where sizes are a little off"
        )


def _held_speeds(system: System) -> np.ndarray:
    """(nc,) how far in m/s the velocity constraints of each contact are from met in the last evaluation."""
    left = np.zeros(system.nc)
    for i in [*system.closed(), *system.resisting()]:
        ints, along = system.contact_int[i], system.basis[i] @ system.slip[i]
        held = list(range(ints[TANGENTS])) if ints[MODE] == STICK else []
        if i < system.nc:
            held += [2, 1] if ints[PATTERN] == ON_CURVE else [2]
        c = system.owner(i)
        left[c] = max(left[c], np.abs(along[held]).max(initial=0.0))
    return left


def contradiction(system: System, t: float) -> str:
    """Which contacts contradict each other after the last projection of `stage_state`, and by how much; "" where none
    do. Leaves that state loaded, with its kinematics."""
    fastest = max(float(np.abs(system.stage_state[system.nq : system.nq + system.nv]).max(initial=0.0)), 1.0)
    if not system.scalars.velocity_left > CONTRADICTING * fastest:
        # of round-off nothing is said
        return ""
    load_state(system.address)
    system.evaluate_kinematics(t)
    left = _held_speeds(system)
    if not left.max(initial=0.0) > _NAMED * system.scalars.velocity_left:
        # joints
        return f"velocity constraints cannot be met together: {system.scalars.velocity_left:.3g} (m/s or rad/s) is left"
    names = [contact.name for contact, off in zip(system.contacts, left) if off > _NAMED * left.max()]
    named = ", ".join(map(repr, names))
    return (
        f"the velocity constraints of contacts {named} cannot be met together: {left.max():.3g} (m/s or rad/s) is left"
    )


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
