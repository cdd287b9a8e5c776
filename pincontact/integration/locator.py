"""Locating an event: where in a step an event function of a mode turns negative, found on the dense output and refined
with true steps.

An event function (a row of `system.event_functions`: a gap, a normal force, what is left to the friction limit, a slip
speed, the distance to the end of a contour) is positive while a mode holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import groupby
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from ..arrays import array_entry
from ..dynamics.event_functions import FORCE_EVENTS
from ..jit import REAL
from ..layout import (
    DOMAIN,
    DOMAIN_EVENT,
    EVENT,
    EVENTS_PER_CONTACT,
    FREE,
    GAP_EVENT,
    LEFT_ROW,
    LOOK_ROW,
    MODE,
    NORMAL_EVENT,
    OK,
    OVERLAP,
    RIGHT_ROW,
    SCAN_ROOM,
    SLIPPING,
    SPEED_EVENT,
)
from .accuracy import gap_rate, gap_resolution, gaps_at_once, next_to_nothing, rest_speed, speed_round_off
from .crossings import CROSSES, ENDS, LEFT_OUT, MINIMUM, NOT_SOUGHT, UNKNOWN, find_crossings, find_minima
from .ends import at_end, deepest_at_end, passes_by
from .open_contacts import OpenContacts
from .runge_kutta import RungeKutta
from .sign_changes import look_below_zero
from .steps import FIND_EARLIEST, FIND_ZERO, SCAN_ON

# Samples of the dense output between which a sign change is looked for, all those of one scan: irregular, lest they all
# be zeros of a sine.
_PLACES = np.array([0.0, 0.1137, 0.2419, 0.3871, 0.5093, 0.6361, 0.7493, 0.8829, 1.0])
assert len(_PLACES) == SCAN_ROOM
# Steps that refine an event's time, and the change of time (relative to the step) that ends them, or by which the state
# moves by this part of its tolerance.
_REFINEMENTS = 8
_REFINED = 1e-14
_STANDS = 1e-2
# Dense output is as good as a step to the event where the error norm of the whole step is no more than this: its own
# error, up to 50 times that norm (DOP853), or 450 times (Sharp98), then is less than steps are allowed.
_AS_GOOD = 1e-3
# The slope at an event is taken over this part of the step before it, and no further back than half the way to it.
_SLOPE_OVER = 1e-4
# No step to an event goes further beyond the step in which it was seen.
_FURTHEST = 1.1
# Steps are as short as can be that are so many times the least at most; loads grow without bound that are so many times
# what else acts.
_SHORT, _WITHOUT_BOUND = 1e3, 1e4
# Ways are zero that are this part of what open gaps may be below it.
_CLOSE = 0.1


class Crossing(NamedTuple):
    """A sign change at a fraction theta of the step: of event function `kind` of item c; value: what that is there,
    plus what it may be below zero; until: the fraction at which all event functions were looked at next."""

    theta: float
    c: int
    kind: int
    value: float
    until: float


class EventLocator:
    """Finds the first crossing in the trial step that its integrator has interpolated last, from t and of size step.

    depths: (items,) how much deeper in m or rad than their resolution open contacts, and joints beyond their ends, may
    be; others change it. open_contacts: which contacts may touch; is told which ones come into a domain from behind.
    """

    def __init__(self, rk: RungeKutta, depths: np.ndarray, open_contacts: OpenContacts) -> None:
        self.rk, self.system, self._depths, self._open = rk, rk.system, depths, open_contacts

    def first(self, t: float, step: float, begin: float = 0.0) -> Crossing | None:
        """The earliest crossing from the fraction `begin` of the step on; None where the alarm was false."""
        system = self.system
        if begin == 0.0:
            # later scans of the step go on with the same
            self._set_slack()
        system.scan_shares[:SCAN_ROOM] = begin + (1.0 - begin) * _PLACES
        system.counters.scan_count = met = 0
        # gaps that end no mode, and the samples before
        denied: set[tuple[float, int, int]] = set()
        while not met & ENDS:
            met = met & MINIMUM | system.run(SCAN_ON, t, step)
            n = system.counters.scan_count
            if not met & (CROSSES | MINIMUM) or n < 2:
                continue
            places, values = system.scan_shares[:n].tolist(), system.scan_event_functions[:n, : system.items]
            if met & MINIMUM:
                places, values = self._with_lowest(t, step, places, values)
            for i, group in groupby(self._found(find_crossings, values, self._open.apart), lambda found: found[0]):
                for row, k in ((LEFT_ROW, i), (RIGHT_ROW, i + 1)):
                    system.scan_shares[row], system.scan_event_functions[row, : system.items] = places[k], values[k]
                known: dict[tuple[int, int], float] = {}
                crossed = []
                for _, c, kind in group:
                    if (places[i], c, kind) in denied or (kind == DOMAIN_EVENT and (c, GAP_EVENT) in crossed):
                        continue
                    if self._ends_mode(t, step, c, kind, known):
                        crossed.append((c, kind))
                    else:
                        denied.add((places[i], c, kind))
                if crossed:
                    return self._earliest(t, step, crossed, known, places[i + 1])
        return None

    def jams(self, step: float, crossing: Crossing) -> bool:
        """Whether the load of what slides, whose sign changes at the crossing that `first` has found last, has grown
        without bound before: in steps that have become as short as can be, to far more than what else acts."""
        system, c = self.system, crossing.c
        if crossing.kind != NORMAL_EVENT or step > _SHORT * system.scalars.floor:
            return False
        slides = c < system.nc and bool(system.contact_int[c, MODE] == SLIPPING)
        acting = float(np.abs(system.nle - system.tau).max(initial=0.0))
        return slides and system.scan_event_functions.item(LEFT_ROW, c, NORMAL_EVENT) > _WITHOUT_BOUND * acting

    def comes_over(self, t: float, step: float, crossing: Crossing | None) -> Crossing | None:
        """What is first in the trial step: this crossing, or where a contact comes over a contour that it touches then.
        That is no change of sign, as others carry the body, but it is to carry its part from there on."""
        system, nc = self.system, self.system.nc
        level = (system.modes == FREE) & self._open.apart
        level &= system.highest[:nc, GAP_EVENT] <= gaps_at_once(system)[:nc]
        if not level.any():
            return crossing

        def distances(theta: float) -> np.ndarray:
            exists, _ = system.look(t, step, theta)
            return np.where(exists, system.contact_real[:nc, DOMAIN], -1.0)

        until, least = 1.0 if crossing is None else crossing.theta, at_end(system)
        before = distances(0.0)
        for c in np.flatnonzero(level & (before <= least)).tolist():
            if not distances(until)[c] > least:
                continue
            theta = 0.0
            if before[c] < 0.0:
                theta = brentq(lambda share, c=c: distances(share)[c], 0.0, until, xtol=_REFINED)
            distances(theta)
            if abs(gap_rate(system, c)) <= rest_speed(system):
                until, crossing = theta, Crossing(theta, c, DOMAIN_EVENT, math.nan, theta)
        return crossing

    # ---------------------------------------------------------------- values

    def _set_slack(self) -> None:
        """What event functions may be below zero."""
        system = self.system
        n, slack = system.items, system.slack
        slack[:n, GAP_EVENT] = gap_resolution(system) + self._depths
        # the upper end of a joint coordinate, and the end of a domain
        slack[:n, DOMAIN_EVENT] = slack[:n, GAP_EVENT]
        slack[:n, SPEED_EVENT] = speed_round_off(system)

    def _with_lowest(
        self, t: float, step: float, places: list[float], values: np.ndarray
    ) -> tuple[list[float], np.ndarray]:
        """The samples at these places, and the lowest points of event functions between them, if they are negative
        there."""
        samples = dict(zip(places, values))
        for i, c, kind in self._found(find_minima, values):
            points = [(place, float(samples[place][c, kind])) for place in places[i : i + 3]]
            looked: dict[float, np.ndarray] = {}
            lowest = look_below_zero(self._function(t, step, (c, kind), looked), points)
            if lowest is not None and lowest[1] < 0.0:
                samples[lowest[0]] = looked[lowest[0]]
        return sorted(samples), np.array([samples[place] for place in sorted(samples)])

    def _function(
        self, t: float, step: float, which: tuple[int, int], known: dict[float, np.ndarray]
    ) -> Callable[[float], float]:
        """One event function of fractions of the step, infinite where it cannot be evaluated; known: values of all by
        fraction, which is added to.

        Each fraction is asked for once: a control that answers otherwise the next time (noise) has no root to be found.
        """

        def value(theta: float) -> float:
            if theta not in known:
                exists, values = self.system.look(t, step, theta)
                known[theta] = values.copy() if exists else np.full_like(values, math.inf)
            return float(known[theta][which])

        return value

    # ---------------------------------------------------------------- crossings

    def _found(self, find: Callable[..., int], samples: np.ndarray, *given: np.ndarray) -> list[list[int]]:
        """What a kernel of `crossings` finds in samples: place, item, kind."""
        samples = np.ascontiguousarray(samples)
        places = np.empty((samples.size, 3), dtype=np.int64)
        found: list[list[int]] = places[: find(samples, *given, places)].tolist()
        return found

    def _is_way(self, c: int, kind: int) -> bool:
        """Whether an event function is a way, of an open contact or a joint, and not of a closed contact to an end."""
        if kind == DOMAIN_EVENT:
            return c >= self.system.nc or bool(self.system.contact_int[c, MODE] == FREE)
        return kind == GAP_EVENT

    def _ends_mode(self, t: float, step: float, c: int, kind: int, known: dict[tuple[int, int], float]) -> bool:
        """Whether an event function that turns negative between the samples on both sides ends a mode: a gap does
        between points inside both domains only, and a contact that comes into a domain if its bodies touch, or overlap,
        but neither from behind nor where they pass by. known: zeros, which is added to."""
        if not self._is_way(c, kind) or c >= self.system.nc:
            return True
        system = self.system
        if (c, kind) in known:
            ends, _ = system.look(t, step, known[c, kind])
        else:
            system.counters.sought_item, system.counters.sought_kind = c, kind
            system.run(FIND_ZERO, t, step)
            known[c, kind] = system.scan_shares.item(LOOK_ROW)
            ends = bool(system.scan_status[LOOK_ROW] <= EVENT)
        gap, domain = system.gaps.item(c, 0), system.contact_real.item(c, DOMAIN)
        if kind == GAP_EVENT:
            ends = ends and domain >= 0.0
        elif ends and gap < -max(deepest_at_end(system, c), system.slack.item(c, kind)):
            # what comes through its gap is no matter of domains, nor is on which side curves cross beside their ends
            ends = domain < -gap <= system.contact_real.item(c, OVERLAP) and not self._open.crosses(c)
            if ends:
                self._open.overlapping.add(c)
        ends = ends and not passes_by(system, c)
        if not ends:
            self._open.passed.add(c)
        return ends

    def _earliest(
        self,
        t: float,
        step: float,
        crossed: list[tuple[int, int]],
        known: dict[tuple[int, int], float],
        until: float,
    ) -> Crossing:
        """First of the event functions `crossed` that turn negative between the samples on both sides; known: zeros;
        until: the share of the later sample."""
        system, rows = self.system, (self.system.scan_shares, self.system.scan_event_functions)
        right = [row[RIGHT_ROW].copy() for row in rows]
        while True:
            system.sought[:] = NOT_SOUGHT
            for item in self._open.passed:
                system.sought[item, [GAP_EVENT, DOMAIN_EVENT]] = LEFT_OUT
            for pair in crossed:
                system.sought[pair] = known.get(pair, UNKNOWN)
            c, kind = divmod(system.run(FIND_EARLIEST, t, step), EVENTS_PER_CONTACT)
            theta, value = system.scan_shares.item(RIGHT_ROW), system.scan_event_functions.item(RIGHT_ROW, c, kind)
            # what is negative between the samples only has not been asked yet
            if (c, kind) in crossed or self._ends_mode(t, step, c, kind, {(c, kind): theta}):
                return Crossing(theta, c, kind, value, until)
            for row, values in zip(rows, right):
                row[RIGHT_ROW] = values

    # ---------------------------------------------------------------- true steps

    def refine(self, t: float, step: float, crossing: Crossing) -> tuple[float, bool]:
        """Take trial steps to the crossing, with secants on the true event function there; returns the last one's size,
        and whether there is a crossing: at loose tolerances the dense output may dip where the motion does not.

        The state that the trial step leaves is of the method's full order; only where to stop came from the dense
        output. Where that is as good there is no such step, and its own state is left.
        """
        # an open contact may have gone over to other stationary points in the step, between which nothing interpolates
        as_good = self.rk.error <= _AS_GOOD and not self._open.may_go_over()
        system, h = self.system, crossing.theta * step
        # not over what others do between later samples
        furthest = step * (crossing.until if crossing.until < 1.0 else _FURTHEST)
        c, kind, slack = crossing.c, crossing.kind, system.slack
        # forces decide modes, and where they do the motion has no jump
        is_force = kind in FORCE_EVENTS
        back, before_it = step * system.scan_shares.item(LEFT_ROW), system.scan_event_functions.item(LEFT_ROW, c, kind)
        slope = (crossing.value - before_it) / (h - back) if back < h else 0.0
        found = crossing.value
        if not is_force:
            # what it may be below zero is as small as the step to the crossing has it
            found -= slack.item(c, kind)
            self._set_slack()
            found += slack.item(c, kind)
        if not (as_good and is_force and -math.inf < slope < 0.0):
            # other zeros than those that were found are gone to, by steps as few as can be
            back = max(h - _SLOPE_OVER * step, 0.5 * h)
            exists, values = system.look(t, step, back / step)
            if not exists or math.isnan(found):
                self.rk.try_step(t, h)
                return h, True
            slope = (found - values.item(c, kind)) / (h - back)
        depth = float(self._depths[c]) if self._is_way(c, kind) else 0.0
        # ways were looked for where they are below zero by what open gaps may be, and are refined to zero
        below = slack.item(c, kind) - depth
        if slope < 0.0:
            h = min(max(h - (found - below) / slope, back), furthest)
        zero = _CLOSE * below
        before: tuple[float, float] | None = None
        denied, value = True, 0.0
        rate = fastest(system.state, system.slopes[0], system.absolute, system.scale.item(0))
        # the time in which the state moves by so much of its tolerance
        stands = _STANDS / rate if rate > 0.0 else math.inf
        change, begun = 0.0, h
        for _ in range(_REFINEMENTS):
            if as_good or change * change > stands * begun or not self._move_on(t + h, change):
                begun = h
                if not self._reach(t, h, step, as_good):
                    return h, True
            value = float(system.event_functions[c, kind]) + depth
            if before is not None and before[0] != h:
                slope = (value - before[1]) / (h - before[0])
            before = h, value
            round_off = next_to_nothing(system, c, kind)
            denied = denied and value > max(round_off, zero)
            change = -value / slope if slope != 0.0 else 0.0
            close = abs(value) <= (round_off if is_force else zero) and abs(change) <= stands
            if close or abs(change) <= _REFINED * step or not 0.0 < h + change <= furthest:
                break
            h += change
        else:
            self.rk.try_step(t, h)
        if denied or value < -max(next_to_nothing(system, c, kind), zero):
            # outputs were written up to there; a function that jumps has no zero for secants
            h = crossing.theta * step
            self.rk.try_step(t, h)
        return h, not denied

    def _reach(self, t: float, h: float, step: float, as_good: bool) -> bool:
        """A trial step of size h, or what the dense output of the whole step has there, where that is as good; whether
        it can be evaluated."""
        if not as_good or h > step:
            return self.rk.try_step(t, h) == OK
        system = self.system
        exists, _ = system.look(t, step, h / step)
        system.new_state[:], system.scalars.step = system.stage_state, h
        return exists

    def _move_on(self, t: float, change: float) -> bool:
        """Move the end of the last trial step on along its slope, by a time in s whose square counts for nothing: to t.
        False where there is nothing to move, or it cannot be evaluated there."""
        if change == 0.0:
            return False
        system = self.system
        system.new_state += change * system.slopes[system.sizes.nstages]
        self.rk.load(system.new_state)
        return self.rk.evaluate(t) <= EVENT


@array_entry(*(REAL[::1],) * 3, REAL)
def fastest(state, slope, absolute, relative):
    """The largest rate in a state's slope, in tolerances per s; absolute: 0 of what has none."""
    rate = 0.0
    for i in range(state.shape[0]):
        if absolute[i] > 0.0:
            rate = max(rate, abs(slope[i]) / (absolute[i] + relative * abs(state[i])))
    return rate
