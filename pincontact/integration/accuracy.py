"""What a run can tell from zero: gaps, rates of gaps and slip speeds, as the event handling uses them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.patterns import ON_CURVE
from ..layout import (
    END_MARGIN,
    FREE,
    LENGTH,
    MODE,
    MU,
    PATTERN,
    SLIPPING,
    START_RATE,
    START_SPEED,
    START_TOLERANCE,
    STOP_ERROR,
    TANGENTS,
    VISCOUS,
)
from .results import GAP_TOLERANCE
from .slip_at_ends import LEFT_OUT, STOP_DOUBLINGS

if TYPE_CHECKING:
    from ..dynamics.system import System
    from .run_system import RunSystem

# A start that is no deeper than this part of the contact's length, and does not come out, has just touched. A gap that
# is larger than that part as it changes sign has leapt: touches are located to 4e-5 of it in the coarsest runs.
SHALLOW, LEAPS = 0.05, 1e-3
# The last correction of gaps leaves so much of them, relative to the contact's length, only where the constraints
# contradict each other; bodies that are nearer touch, on whichever side they are.
APART_AT_END = 1e-6
# What is slower than this (m/s or rad/s, absolute and relative to the largest velocity) is at rest where modes are set.
REST = 1e-9
# Part of the accuracy of gaps to which rebounds are resolved, and round-off of gaps, relative to coordinates of unit
# size.
_RESOLVED, _ROUND_OFF = 1e-6, 2e-14
# That is so many times more, speeds twice as high, where rebounds lower than that accuracy do not get lower.
_COARSER = 4.0
# Rebounds that are resolved so many times less far have not got lower several times in a row; those slower than this
# part of the velocity leave a motion, which they may change, in the end by any amount.
_LASTING, _SLOW_REBOUNDS = 1e2, 1e-2
# What touches at once, or comes to its end, is as near as so many times that, or this part of the accuracy of gaps:
# motions keep their symmetries up to round-off, whatever their error.
_AT_ONCE, AT_ONCE_ROUND_OFF = 1e-3, 100.0
# The same part where viscous friction makes rebounds ever shorter: each one left out takes the root of its height in
# speed.
_RESOLVED_VISCOUS = 1e-3

# Round-off of speeds, against 1 or the largest velocity.
_SPEED_ROUND_OFF = 1e-15

# Part of the size of a contact along which normals of a curve turn.
_TURNS = 1e-2
# An event function that is this part of its largest size away from zero wherever steps went to make it zero has no zero
# there.
_NEXT_TO_NOTHING = 1e-6


def sizes_of_gaps(system: System) -> tuple[np.ndarray, np.ndarray]:
    """(items,) lengths in m that gaps are compared with, joint coordinates with 1, and to which part of the accuracy of
    gaps rebounds are resolved.

    With viscous friction, which ends as a contact opens, rebounds may get shorter without end: there they are resolved
    less far.
    """
    lengths, resolved = np.ones(system.items), np.full(system.items, _RESOLVED)
    lengths[: system.nc] = system.contact_real[: system.nc, LENGTH]
    resolved[: system.nc][system.contact_real[: system.nc, VISCOUS] > 0.0] = _RESOLVED_VISCOUS
    return lengths, resolved


def set_accuracy(system: RunSystem, relative: float, absolute: float) -> None:
    """From the tolerances of a run: the errors of gaps in m, and of the distances of joint coordinates from their ends,
    in m or rad, and how low rebounds are that are none.

    They are GAP_TOLERANCE times the tolerance of positions.
    """
    lengths, resolved = sizes_of_gaps(system)
    system.gap_accuracy = GAP_TOLERANCE * (absolute + relative * lengths)
    system.lowest_resolved = resolved * system.gap_accuracy
    system.lowest_rebounds, system.rebound_speeds = system.lowest_resolved.copy(), np.full(system.items, math.inf)
    system.lasting_rebounds = np.zeros(system.items, dtype=bool)


def count_rebound(system: RunSystem, i: int, speed: float, low: bool) -> None:
    """Item i comes back from a rebound at this speed, in m/s or rad/s. low: from no higher than gaps are known.

    Bodies that are pressed together in several places may throw each other off for ever: rest, as far as is known. So
    low rebounds that do not get lower are resolved less and less far. Runs tell of those beside a motion,
    `lasting_rebounds`.
    """
    if not low:
        # what strikes from high throws off what is at rest: rebounds of their own, unlike those of stops that rattle
        begun = slice(0, system.nc) if i < system.nc else slice(i, i + 1)
        system.lowest_rebounds[begun], system.rebound_speeds[begun] = system.lowest_resolved[begun], math.inf
    elif speed >= system.rebound_speeds[i]:
        system.lowest_rebounds[i] = min(_COARSER * system.lowest_rebounds[i], system.gap_accuracy[i])
        lasts = system.lowest_rebounds[i] > _LASTING * system.lowest_resolved[i]
        # what drives them, and what they change, is a motion
        system.lasting_rebounds[i] |= lasts and speed < _SLOW_REBOUNDS * max(map(abs, system.v.tolist()))
    system.rebound_speeds[i] = speed


def gap_resolution(system: RunSystem) -> np.ndarray:
    """(items,) how low rebounds are that are none, and how far open gaps may be below zero, in m or rad.

    Gaps are computed from the configuration to round-off, however large its error is.
    """
    return np.maximum(system.lowest_rebounds, round_off(system))


def gaps_at_once(system: RunSystem) -> np.ndarray:
    """(items,) how large the gaps are, in m or rad, of what touches in the same instant as others."""
    # what comes in over an end, and what strikes there, are as far apart as ends are moved out
    least = np.maximum(_AT_ONCE * system.gap_accuracy, max(AT_ONCE_ROUND_OFF * round_off(system), 2.0 * END_MARGIN))
    return np.maximum(least, gap_resolution(system))


def round_off(system: RunSystem) -> float:
    """Of gaps in m, and of distances from ends."""
    return _ROUND_OFF * max(map(abs, [1.0, *system.q.tolist()]))


def next_to_nothing(system: RunSystem, i: int, kind: int) -> float:
    """What is as good as zero in event function `kind` of item i, against its sizes in the last trial step."""
    return _NEXT_TO_NOTHING * max(abs(float(system.lowest[i, kind])), abs(float(system.highest[i, kind])))


def rest_speed(system: System) -> float:
    """Slip slower than this, in m/s, counts as rest."""
    return REST * (1.0 + max(map(abs, system.v.tolist()), default=0.0))


def speed_round_off(system: System) -> float:
    """Speeds below this, in m/s or rad/s, have no sign."""
    return _SPEED_ROUND_OFF * (1.0 + max(map(abs, system.v.tolist()), default=0.0))


def slow_slips(system: System) -> list[int]:
    """Items that slide, in the last evaluation no faster than what counts as ended where steps get nowhere near it."""
    allowed = np.abs(system.rows) @ (system.scale[1] + system.scale[0] * np.abs(system.v))
    along = np.einsum("nij,nj->ni", system.basis[:, :2], system.slip)
    along[system.contact_int[:, TANGENTS] == 1, 1] = 0.0
    slow = np.linalg.norm(along, axis=1) <= 2.0**STOP_DOUBLINGS * allowed.max(axis=1)
    return np.flatnonzero((system.contact_int[:, MODE] == SLIPPING) & slow).tolist()


def held_up(system: System) -> list[int]:
    """Contacts of ideal rolling that slide held up by friction alone."""
    modes, mu = system.modes.tolist(), system.contact_real[:, MU].tolist()
    return [c for c, mode in enumerate(modes) if mode == SLIPPING and mu[c] == math.inf]


def turns_along_curves(system: System, step: float) -> bool:
    """Whether a point slides along a curve so far in a step of this size in s that its normals turn: one of them may be
    redundant at the end of the step and not on the way."""
    closed = np.flatnonzero((system.contact_int[: system.nc, PATTERN] == ON_CURVE) & (system.modes != FREE))
    ways = step * np.linalg.norm(system.slip[closed], axis=1)
    return bool((ways > _TURNS * system.contact_real[closed, LENGTH]).any())


def may_stop(system: System) -> list[int]:
    """What is stopped at once where its slip jams, since no forces in it are those of Coulomb's law, or no step is
    short enough: ideal rolling held up by friction alone, and what is as slow as slip that counts as ended."""
    return sorted({*held_up(system), *slow_slips(system)})


def slip_is_ending(system: System) -> bool:
    """Whether a slip of the accepted state ends in one linear step."""
    numbers = system.contact_real
    stopping = np.isfinite(numbers[:, START_SPEED]) & (numbers[:, START_RATE] < 0.0)
    allowed = min(2.0**system.counters.stalled, 1.0) * numbers[:, START_TOLERANCE]
    return bool((stopping & (numbers[:, STOP_ERROR] <= LEFT_OUT * allowed)).any())


def gap_rate(system: System, c: int) -> float:
    """Speed in m/s at which the bodies of contact c part, from the last evaluation."""
    (x, y, z), (u, v, w) = system.basis[c, 2].tolist(), system.slip[c].tolist()
    return float(x * u + y * v + z * w)
