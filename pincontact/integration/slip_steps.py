"""Steps of a run besides those of its method: with prescribed directions where slip is slow, and to the end of slip."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..dynamics.directions import freeze_slip
from ..layout import EVENT, MODE, START_SPEED, STICK, STOP_ERROR
from .accuracy import slip_is_ending, speed_round_off
from .outputs import Outputs
from .runge_kutta import RungeKutta
from .slip_at_ends import LEFT_OUT, doubled
from .transitions import Transitions

# Steps that slow slip makes stiff before its direction is prescribed instead, and at most after that has failed;
# the least length of a step with a prescribed direction, in stiff ones that cost as much and last this time over that
# in which friction turns the slip; how much longer the next one is tried, and after how many of the same length where
# longer ones have failed: those that took less than the last factor of what was asked for.
PATIENCE, _LONGEST_PATIENCE = 24, 3072
_SLOW_STEPS, STABLE = 20.0, 4.0
_SLOW_GROWTH, _SLOW_RESTS, _SLOW_CUT = 4.0, 6, 0.9
# Slips this many times faster than what counts as ended end with one that does.
_TOGETHER = 8.0
# A straight step that leaves out less than this part of what is allowed, by all that is known, is not looked at.
_CLEARLY = 1e-2
# What the end of slips may take from the velocity, in tolerances, and how often the speed that counts as ended is
# halved at most where it would take more.
_WORTH, _HALVINGS = 8.0, 20


class SlipSteps:
    """Makes such steps from the accepted state of a run.

    accepted(t, since, start): called for every state that is accepted, after the one at `since` in s, `start`.
    """

    def __init__(
        self,
        rk: RungeKutta,
        transitions: Transitions,
        outputs: Outputs,
        accepted: Callable[[float, float, np.ndarray], None],
    ) -> None:
        self.rk, self.system, self.transitions = rk, rk.system, transitions
        self.outputs, self._accepted = outputs, accepted

    def follow_slowly(self, t: float, end: float, longest: float, age: float) -> float:
        """Steps with prescribed directions of slip as long as these are longer than many stiff ones; the new time.

        end: of the run, or the next breakpoint, in s; longest: of a step, in s; age: how long in s slip went on that
        has just begun.
        """
        scalars, counters, onset = self.system.scalars, self.system.counters, self.transitions.onset
        span, rests, tried = 2.0 * _SLOW_STEPS * STABLE / scalars.turning_rate, 0, True
        # slip that has just begun changes in times like its age
        span = max(span, age)
        while tried:
            shortest = _SLOW_STEPS * STABLE / max(scalars.turning_rate, 1e-300)
            span = min(span, longest, end - t)
            start = self.system.state.copy()
            after = onset.follow_slow_slip(t, span, shortest) if span >= shortest else None
            tried = after is not None
            if after is None:
                # the next steps are explicit again; the longer that fails the longer they are left alone
                counters.patience = min(2 * counters.patience, _LONGEST_PATIENCE)
                # nor do these get nearer to the end of a slip that is as slow as they are accurate
                counters.stalled = doubled(counters.stalled)
            else:
                counters.patience = PATIENCE
                counters.step_count += 1
                # a length that was too much is not asked for again soon
                rests = _SLOW_RESTS if after - t < _SLOW_CUT * span else rests - 1
                span = (after - t) * (1.0 if rests > 0 else _SLOW_GROWTH)
                self._accepted(after, t, start)
                t = after
                limited = t >= end or counters.step_count >= counters.trial_limit
                tried = not (limited or slip_is_ending(self.system) or onset.pending)
        counters.stiff_steps = 0
        return t

    def end_slip(self, t: float, allow_start: Callable[[float, float], None]) -> tuple[float, bool]:
        """One linear step to the end of slip (its error is the square of a short time), then stick or not; the new
        time, and whether modes changed. allow_start: see `Driver`."""
        rk, system, scalars = self.rk, self.system, self.system.scalars
        columns = system.contact_real[:, START_SPEED : STOP_ERROR + 1].tolist()
        slips = {i: (*column[:3], column[-1]) for i, column in enumerate(columns) if column[0] < math.inf}
        stopping = [i for i, (_, rate, _, _) in slips.items() if rate < 0.0]
        stopping = stopping or [i for i, (speed, _, allowed, _) in slips.items() if speed <= allowed]
        straight = [i for i in stopping if slips[i][3] <= LEFT_OUT * slips[i][2]]
        c = min(straight or stopping, key=lambda i: slips[i][0] / slips[i][2])
        # what is round-off has ended, and what should grow, but does not
        speed, rate, *_ = slips[c]
        way = speed / -rate if rate < 0.0 and speed > speed_round_off(system) else 0.0
        # at loose tolerances a slip that counts as over may have a long way to go: no further than a step
        left = min(way, scalars.next_step, scalars.max_step, scalars.end - t)
        left = min(left, scalars.next_output - t, self.transitions.onset.until_touch())
        if straight and left < way:
            # something else comes first
            system.contact_real[:, STOP_ERROR] = math.inf
            return t, True
        # contacts of one body come to rest at the same instant as a rule: those go together that are near it together
        further, contacts = 2.0**system.counters.stalled, [c]
        for i, (speed, rate, allowed, _) in slips.items():
            # what grows may be taking over the slip that ends
            if i != c and rate < 0.0 and min(speed, abs(speed + rate * left)) <= further * _TOGETHER * allowed:
                contacts.append(i)
        rk.load(system.state)
        rk.evaluate(t)
        ended = {i: self.transitions.changes.slip_direction(i) for i in contacts}
        stopped = system.state + left * system.slopes[0]
        if left > 0.0 and self._bends(t, left, ended, stopped):
            if slips[c][0] > further * slips[c][2]:
                # steps of the method go nearer
                system.contact_real[:, STOP_ERROR] = math.inf
                return t, True
            # as slow as it is it ends at once
            left, stopped = 0.0, system.state.copy()
        worth = self._worth(t, left, contacts, stopped) / further if further >= 1.0 else 0.0
        if worth > _WORTH:
            system.counters.stalled = -min(math.ceil(math.log2(worth)), _HALVINGS)
            return t, False
        start = system.state.copy()
        if left > 0.0:
            self.outputs.keep_end_of_slip(t, left, ended)
        # v_c is round-off there and has no direction: not to be evaluated as slip
        system.contact_int[contacts, MODE] = STICK
        rk.load(stopped)
        allow_start(t + left, scalars.step)
        after = self.transitions.come_to_rest(t + left, ended)
        self._accepted(after, t, start)
        return after, True

    def _bends(self, t: float, left: float, ended: dict[int, np.ndarray], stopped: np.ndarray) -> bool:
        """Whether anything moves so that a straight step from t to `stopped`, `left` s later, leaves out more than is
        allowed in steps: half of what velocities and accelerations change by in it. The last evaluation is that at t.
        ended: slips that go on up to there, with their directions."""
        system, before = self.system, self.system.acceleration.copy()
        # steps of the method resolve by how much accelerations change in one
        most, step = max(map(abs, before.tolist())), min(system.scalars.next_step, 1.0)
        if 0.5 * left * left * most <= _CLEARLY * step * system.scale.item(1):
            return False
        integers, numbers = system.contact_int.copy(), system.contact_real.copy()
        for c, direction in ended.items():
            freeze_slip(system, c, system.basis[c, :2] @ direction)
        self.rk.load(stopped)
        known = self.rk.evaluate(t + left) <= EVENT
        left_out = 0.5 * left * np.maximum(left * np.abs(system.acceleration), np.abs(system.acceleration - before))
        allowed = system.scale[1] + system.scale[0] * np.abs(system.v)
        system.contact_int[:], system.contact_real[:] = integers, numbers
        return not known or bool((left_out > allowed).any())

    def _worth(self, t: float, left: float, contacts: list[int], stopped: np.ndarray) -> float:
        """What the end of these slips, in the state `left` s after the accepted one at t, takes from the velocity, in
        tolerances."""
        system, modes = self.system, self.transitions.modes
        integers, forces = system.contact_int.copy(), modes.reference()
        system.contact_int[contacts, MODE] = STICK
        self.rk.load(stopped)
        before, taken = system.v.copy(), 0.0
        if self.rk.project(t + left, False):
            taken, speed = modes.taken_from(before)
            taken /= modes.tolerance(speed)
        system.contact_int[:] = integers
        modes.take_back(forces)
        # joints beside come to rest by what they did till now
        self.transitions.changes.evaluate_accepted(t)
        return taken
