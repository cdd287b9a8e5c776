"""Locating an event: where in a step an event function of a mode turns negative, found on the dense output and refined
with true steps.

An event function (a row of `system.event_functions`: a gap, a normal force, what is left to the friction limit, a slip
speed, the distance to the end of a contour) is positive while a mode holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from ..dynamics.event_functions import FORCE_EVENTS
from ..layout import (
    DOMAIN,
    DOMAIN_EVENT,
    EVENT,
    GAP_EVENT,
    NOTHING_THERE,
    OK,
    SCAN_ROOM,
    SPEED_EVENT,
)
from .accuracy import gap_resolution
from .crossings import find_crossings, find_valleys
from .open_contacts import OpenContacts
from .runge_kutta import RungeKutta
from .sign_changes import look_below_zero
from .steps import FIND_ZERO

# Samples of the dense output between which a sign change is looked for, all those of one scan: irregular, lest they all
# be zeros of a sine.
_PLACES = (0.0, 0.1137, 0.2419, 0.3871, 0.5093, 0.6361, 0.7493, 0.8829, 1.0)
assert len(_PLACES) == SCAN_ROOM
# Steps that refine an event's time, and the change of time (relative to the step) that ends them, or by which the state
# moves by this part of its tolerance.
_REFINEMENTS = 8
_REFINED = 1e-14
_STANDS = 1e-2
# The slope at an event is taken over this part of the step before it, and no further back than half the way to it.
_SLOPE_OVER = 1e-4
# No step to an event goes further beyond the step in which it was seen.
_FURTHEST = 1.1
# Looks for what crosses before the first crossing that was found, beyond one for each event function.
_ROUNDS = 4
# Ways are zero that are this part of what open gaps may be below it.
_CLOSE = 0.1
# Event functions that are negative by this part of what they were cross zero at the same time.
_AT_ONCE = 1e-12
# An event function that is this part of its largest size away from zero wherever steps went to make it zero has no zero
# there.
_NEXT_TO_NOTHING = 1e-6
# Speeds below this, against 1 or the largest velocity, have no sign.
_SPEED_ROUND_OFF = 1e-15


@dataclass(frozen=True)
class Crossing:
    """A sign change at a fraction theta of the step: of event function `kind` of item c."""

    theta: float
    c: int
    kind: int


@dataclass(frozen=True)
class _Sample:
    """All event functions (items, EVENTS_PER_CONTACT) at a fraction theta of the step."""

    theta: float
    values: np.ndarray


@dataclass(frozen=True)
class _Stretch:
    """What is between two samples of the step from t of size `step`; roots: the samples at zeros that are known there,
    by event function."""

    t: float
    step: float
    left: _Sample
    right: _Sample
    roots: dict[tuple[int, int], _Sample] = field(default_factory=dict)


def _zero_between(before: float, after: float) -> float:
    """Where the straight line between two values at 0 and 1 is zero; 1 where they are infinite or the same."""
    change = before - after
    share = before / change if change != 0.0 else math.inf
    return share if share < math.inf else 1.0


class EventLocator:
    """Finds the first crossing in the trial step that its integrator has interpolated last, from t and of size step.

    depths: (items,) how much deeper in m or rad than their resolution open contacts, and joints beyond their ends, may
    be; others change it. open_contacts: which contacts may touch; is told whose gaps fall through zero beyond an end of
    a contour.
    """

    def __init__(self, rk: RungeKutta, depths: np.ndarray, open_contacts: OpenContacts) -> None:
        self.rk, self.system, self._depths, self._open = rk, rk.system, depths, open_contacts

    def first(self, t: float, step: float, begin: float = 0.0) -> Crossing | None:
        """The earliest crossing from the fraction `begin` of the step on; None where the alarm was false."""
        self._set_slack()
        places = tuple(begin + (1.0 - begin) * place for place in _PLACES)
        values = self._values(t, step, places)
        places = places[: len(values)]
        if len(places) < 2:
            return None
        places, values = self._with_lowest(t, step, places, values)
        for i, group in groupby(self._found(find_crossings, values, self._open.apart), lambda found: found[0]):
            left, right = (_Sample(places[k], values[k]) for k in (i, i + 1))
            stretch = _Stretch(t, step, left, right)
            crossed = [(c, kind) for _, c, kind in group if self._ends_mode(stretch, (c, kind))]
            if crossed:
                return self._earliest(stretch, crossed)
        return None

    # ---------------------------------------------------------------- values

    def _set_slack(self) -> None:
        """What event functions may be below zero."""
        system, nc = self.system, self.system.nc
        n, slack = system.items, system.slack
        slack[:n, GAP_EVENT] = gap_resolution(system) + self._depths
        # the upper end of a joint coordinate
        slack[nc:n, DOMAIN_EVENT] = slack[nc:n, GAP_EVENT]
        slack[:n, SPEED_EVENT] = _SPEED_ROUND_OFF * (1.0 + max(map(abs, system.v.tolist()), default=0.0))

    def _values(self, t: float, step: float, thetas: Sequence[float]) -> np.ndarray:
        """Event functions (n, items, EVENTS_PER_CONTACT) at fractions of the step, plus what they may be below zero;
        there are fewer than fractions where one of them cannot be evaluated: those before it."""
        known, found = self.system.scan(t, step, thetas)
        return (found[: known.index(False)] if False in known else found).copy()

    def _with_lowest(
        self, t: float, step: float, places: tuple[float, ...], values: np.ndarray
    ) -> tuple[tuple[float, ...], np.ndarray]:
        """The samples at these places, and the lowest points of event functions between them, if they are negative
        there."""
        valleys = self._found(find_valleys, values)
        if not valleys:
            return places, values
        samples = dict(zip(places, values))
        for i, c, kind in valleys:
            points = [(place, float(samples[place][c, kind])) for place in places[i : i + 3]]
            looked: dict[float, np.ndarray] = {}
            lowest = look_below_zero(self._function(t, step, (c, kind), looked), points)
            if lowest is not None and lowest[1] < 0.0:
                samples[lowest[0]] = looked[lowest[0]]
        return tuple(sorted(samples)), np.array([samples[place] for place in sorted(samples)])

    def _function(
        self, t: float, step: float, which: tuple[int, int], known: dict[float, np.ndarray]
    ) -> Callable[[float], float]:
        """One event function of fractions of the step, infinite where it cannot be evaluated; known: values of all by
        fraction, which is added to.

        Each fraction is asked for once: a control that answers otherwise the next time (noise) has no root to be found.
        """

        def value(theta: float) -> float:
            if theta not in known:
                values = self._values(t, step, [theta])
                known[theta] = values[0] if len(values) else np.full_like(self.system.slack, math.inf)
            return float(known[theta][which])

        return value

    # ---------------------------------------------------------------- crossings

    def _found(self, find: Callable[..., int], samples: np.ndarray, *given: np.ndarray) -> list[list[int]]:
        """What a kernel of `crossings` finds in samples: place, item, kind."""
        places = np.empty((samples.size, 3), dtype=np.int64)
        found: list[list[int]] = places[: find(samples, *given, places)].tolist()
        return found

    def _ends_mode(self, stretch: _Stretch, crossed: tuple[int, int]) -> bool:
        """Whether an event function that turns negative there ends a mode: a gap does between points inside both
        domains only."""
        c, kind = crossed
        if kind != GAP_EVENT or c >= self.system.nc:
            return True
        root = self._root(stretch, crossed)
        known = not np.isnan(root.values).any()
        if known and self._open.are_apart(c, stretch.t + root.theta * stretch.step):
            # where it is followed is not where it is nearest
            return False
        inside = bool(known and self.system.contact_real[c, DOMAIN] >= 0.0)
        if not inside:
            self._open.passed.add(c)
        return inside

    def _earliest(self, stretch: _Stretch, crossed: list[tuple[int, int]]) -> Crossing:
        """First of the event functions `crossed` that turn negative there.

        The root of one is the next sample, at which most others are seen to cross later, and some to have been negative
        in between.
        """
        found, left = None, stretch.left
        # what has come down to that is zero there, too, as far as zeros are told apart
        at_once = _AT_ONCE * np.where(left.values < NOTHING_THERE, left.values, 0.0)
        for _ in range(len(crossed) + _ROUNDS):
            # the one that is first on straight lines
            shares = [_zero_between(left.values[pair].item(), stretch.right.values[pair].item()) for pair in crossed]
            c, kind = crossed[shares.index(min(shares))]
            root = self._root(stretch, (c, kind))
            if found is not None and root.theta >= found.theta:
                break
            found, stretch = Crossing(root.theta, c, kind), _Stretch(stretch.t, stretch.step, left, root)
            candidates = (root.values < -at_once) & (left.values > 0.0) & (left.values != NOTHING_THERE)
            candidates[c, kind] = False
            candidates[list(self._open.passed), GAP_EVENT] = False
            crossed = [(c, kind) for c, kind in np.argwhere(candidates).tolist()]
            if not crossed:
                break
        assert found is not None
        return found

    def _root(self, stretch: _Stretch, crossed: tuple[int, int]) -> _Sample:
        """Where an event function turns negative there; its values are NaN where there are none."""
        if crossed not in stretch.roots:
            system, left, right = self.system, stretch.left, stretch.right
            system.counters["sought_item"], system.counters["sought_kind"] = crossed
            system.bracket[:4] = left.theta, left.values[crossed], right.theta, right.values[crossed]
            system.run(FIND_ZERO, stretch.t, stretch.step)
            values = system.scan_event_functions[0, : system.items].copy()
            if system.scan_status[0] > EVENT:
                values[:] = math.nan
            stretch.roots[crossed] = _Sample(float(system.scan_shares[0]), values)
        return stretch.roots[crossed]

    # ---------------------------------------------------------------- true steps

    def refine(self, t: float, step: float, crossing: Crossing) -> tuple[float, bool]:
        """Take trial steps to the crossing, with secants on the true event function there; returns the last one's size,
        and whether there is a crossing: at loose tolerances the dense output may dip where the motion does not.

        The state that the trial step leaves is of the method's full order; only where to stop came from the dense
        output.
        """
        h = crossing.theta * step
        back = max(h - _SLOPE_OVER * step, 0.5 * h)
        c, kind = crossing.c, crossing.kind
        self._set_slack()
        ends = self._values(t, step, [back / step, h / step])
        if len(ends) < 2:
            self.rk.attempt(t, h)
            return h, True
        slope = float(ends[1][c, kind] - ends[0][c, kind]) / (h - back)
        is_way = kind == GAP_EVENT or (kind == DOMAIN_EVENT and c >= self.system.nc)
        depth = float(self._depths[c]) if is_way else 0.0
        # ways were looked for where they are below zero by what open gaps may be, and are refined to zero
        below = float(self.system.slack[c, kind]) - depth
        if slope < 0.0:
            h = max(h - (float(ends[1][c, kind]) - below) / slope, back)
        zero = _CLOSE * below
        before: tuple[float, float] | None = None
        # forces decide modes, and where they do the motion has no jump
        is_force = kind in FORCE_EVENTS
        denied, value, stands = True, 0.0, self._time_to_move()
        for _ in range(_REFINEMENTS):
            if self.rk.attempt(t, h) != OK:
                return h, True
            value = float(self.system.event_functions[c, kind]) + depth
            if before is not None and before[0] != h:
                slope = (value - before[1]) / (h - before[0])
            before = h, value
            round_off = self._round_off(c, kind)
            denied = denied and value > max(round_off, zero)
            change = -value / slope if slope != 0.0 else 0.0
            close = abs(value) <= (round_off if is_force else zero) and abs(change) <= stands
            if close or abs(change) <= _REFINED * step or not 0.0 < h + change <= _FURTHEST * step:
                break
            h += change
        else:
            self.rk.attempt(t, h)
        if denied or value < -max(self._round_off(c, kind), zero):
            # outputs were written up to there; a function that jumps has no zero for secants
            h = crossing.theta * step
            self.rk.attempt(t, h)
        return h, not denied

    def _time_to_move(self) -> float:
        """Time in s in which the state at the step's start moves by `_STANDS` of its tolerance."""
        system = self.system
        counted = system.absolute > 0.0
        allowed = system.absolute + system.scale[0] * np.abs(system.state)
        rate = float(np.abs(system.slopes[0][counted] / allowed[counted]).max(initial=0.0))
        return _STANDS / rate if rate > 0.0 else math.inf

    def _round_off(self, c: int, kind: int) -> float:
        """What is next to nothing in an event function, against its sizes in the last trial step."""
        lowest, highest = float(self.system.lowest[c, kind]), float(self.system.highest[c, kind])
        return _NEXT_TO_NOTHING * max(abs(lowest), abs(highest))
