"""Event-driven integration: smooth steps in fixed modes between located mode changes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..layout import (
    FROZEN,
    LAST_NORMAL_X,
    MODE,
    MU,
    OK,
    SLIP_RATE,
    SLIP_SPEED,
    SLIPPING,
    STICK,
    TANGENTS,
)
from .events import Crossing, EventLocator, UserEvent
from .results import FINISHED, STEP_LIMIT, STEP_TOO_SMALL, TERMINATED, Stop
from .runge_kutta import RungeKutta
from .stages import move_charts
from .tableaux import Interpolant
from .transitions import Transitions

# Where 3D slip ends its direction is singular: no step goes further than this fraction of the way to the end.
_STOP_FRACTION = 0.8
# Slip has ended once its speed is down to the error that steps are allowed to make in it, where its direction is noise;
# the rest is one linear step, whose error is of second order in the time left. Where steps no longer get anywhere near
# the end, the speed that counts as ended is doubled at every attempt, so many times at most.
_STOP_DOUBLINGS = 10
_PROGRESS = 0.9
_SMALLEST_STOP_SPEED = 1e-13
# After a rejection by a failed evaluation the step shrinks by this factor.
_FAILED_FACTOR = 0.25
# A remainder of the interval below this fraction of the step is added to it.
_SLIVER = 1e-9


@dataclass
class Options:
    """Step-size and output options of a run. t_eval: output times in s, None for every accepted step."""

    t_eval: np.ndarray | None = None
    max_step: float = math.inf
    max_steps: int = 1_000_000
    fixed_step: float | None = None
    first_step: float | None = None


class Driver:
    """Integrates one system from the state in `system.state`.

    record(t): called for every output with the state in the system. progress(t): called after every step, or None.
    """

    def __init__(
        self,
        rk: RungeKutta,
        transitions: Transitions,
        users: list[UserEvent],
        record: Callable[[float], None],
        options: Options,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.rk, self.system, self.transitions = rk, rk.system, transitions
        self.locator = EventLocator(rk, users)
        transitions.emit = self._output_short_step
        self.record, self.options, self.progress = record, options, progress
        self.steps = self.rejected = self.outputs = 0
        self._next_output = 0
        # (contact, speed, rate) of every 3D slip at the step's start
        self._slips: list[tuple[int, float, float]] = []
        self._stalled = 0
        self._slowest = math.inf

    def run(self, t: float, t_end: float) -> tuple[int, str]:
        """Integrate from t to t_end (s); returns a code of `results` and a message."""
        try:
            self._run(t, t_end)
        except Stop as stop:
            return stop.code, stop.message
        return FINISHED, "the end of the interval was reached"

    def _run(self, t: float, t_end: float) -> None:
        options, rk = self.options, self.rk
        self._end = t_end
        try:
            self.transitions.begin(t)
        except Stop:
            # what there is: the state that the run was to start from
            rk.load(self.system.state)
            self._output_start(t)
            raise
        self._output_start(t)
        if t_end > t:
            t = self.transitions.start_frozen(t)
        self.locator.update_users(t)
        self._note_state()
        self.locator.arm()
        h = options.fixed_step or options.first_step or rk.first_step(t, t_end - t)
        floor = 8.0 * np.finfo(float).eps * max(abs(t), abs(t_end))
        failure = OK
        while t < t_end:
            if self.steps + self.rejected >= options.max_steps:
                raise Stop(STEP_LIMIT, f"t = {t:.9g} s: the limit of {options.max_steps} steps was reached")
            ending = self._ending_slip()
            if ending is not None:
                t = self._end_slip(t, *ending)
                self._stalled, self._slowest = 0, math.inf
                h = self._restart(h)
                continue
            remaining = t_end - t
            step = min(h, options.max_step, remaining)
            for _, speed, rate in self._slips:
                if rate < 0.0:
                    step = min(step, _STOP_FRACTION * speed / -rate)
            if remaining - step < _SLIVER * step:
                step = remaining
            if step < floor and step < remaining:
                raise self.transitions.give_up(t, failure)
            status = rk.attempt(t, step, adaptive=not options.fixed_step)
            if status != OK:
                self.transitions.failed_control(t)
                failure = status
                self.rejected += 1
                self._watch_slips(False)
                h = _FAILED_FACTOR * step
                if options.fixed_step:
                    raise self.transitions.give_up(t, failure)
                continue
            if rk.error >= 1.0 and not options.fixed_step:
                self.rejected += 1
                self._watch_slips(False)
                h = rk.next_step(step, True)
                continue
            failure = OK
            proposal = options.fixed_step or rk.next_step(step, False)
            t_new = t_end if step == remaining else t + step
            t, switched = self._complete(t, step, t_new)
            self.steps += 1
            if switched:
                self._stalled, self._slowest = 0, math.inf
            elif self._slips:
                self._watch_slips(True)
            # a step cut short for an output or a stop says nothing against the larger one
            h = self._restart(proposal) if switched else (proposal if step == h else max(proposal, min(h, 10.0 * step)))
            if self.progress is not None:
                self.progress(t)

    def _restart(self, h: float) -> float:
        """Step size after a mode change."""
        return self.options.fixed_step or min(h, 10.0 * self.transitions.seed)

    # ---------------------------------------------------------------- one step

    def _complete(self, t: float, step: float, t_new: float) -> tuple[float, bool]:
        """Events, outputs and commitment of the attempted step; returns the new time and whether modes changed."""
        rk, system = self.rk, self.system
        dense: Interpolant | None = None
        users = self.locator.crossed_users(t_new) if self.locator.users else []
        if rk.alarm or users:
            dense = self._interpolant(t, step)
            crossing = self.locator.first(t, step, dense, users)
            while crossing is not None and crossing.margin is None and not self.locator.users[crossing.user].terminal:
                rk.load(dense(crossing.theta))
                self.transitions.announce(t + crossing.theta * step, None, "user", crossing.user)
                users.remove(crossing.user)
                crossing = self.locator.first(t, step, dense, users)
            if crossing is not None:
                return self._stop_at(t, step, dense, crossing), True
            rk.load(system.new_state)
        if self._output_due(t_new):
            if dense is None:
                dense = self._interpolant(t, step)
            self._output_until(t, step, dense, t_new)
            rk.load(system.new_state)
        self._project(t_new, dense is None)
        rk.accept()
        self._after(t_new)
        return t_new, False

    def _interpolant(self, t: float, step: float) -> Interpolant:
        dense = self.rk.interpolant(t, step)
        if dense is None:
            self.transitions.failed_control(t)
            raise Stop(STEP_TOO_SMALL, f"t = {t:.9g} s: the dense output of a step could not be evaluated")
        return dense

    def _project(self, t: float, evaluated: bool) -> None:
        if not self.rk.project(t, evaluated):
            self.transitions.failed_control(t)
            raise Stop(STEP_TOO_SMALL, f"t = {t:.9g} s: the projection on the constraints failed")

    def _after(self, t: float) -> None:
        """What follows every accepted state."""
        if self._change_charts():
            self.rk.evaluate_start(t)
        self._note_state()
        self.locator.arm()
        if self.locator.users:
            self.locator.update_users(t)
        if self.options.t_eval is None:
            self.outputs += 1
            self.record(t)

    def _stop_at(self, t: float, step: float, dense: Interpolant, crossing: Crossing) -> float:
        """Step again to the crossing, so that the state there has the method's full order, and switch modes."""
        rk, system = self.rk, self.system
        event_time = t + crossing.theta * step
        if self._output_due(event_time):
            self._output_until(t, step, dense, event_time)
        if crossing.theta > 0.0:
            event_time = t + self.locator.refine(t, step, dense, crossing)
            rk.load(system.new_state)
        else:
            rk.load(system.state)
        self._project(event_time, False)
        if crossing.margin is None:
            rk.accept()
            self._after(event_time)
            self.transitions.announce(event_time, None, "user", crossing.user)
            raise Stop(TERMINATED, "a terminal event occurred")
        self.transitions.longest_start = min(0.5 * step, 0.5 * (self._end - event_time))
        try:
            after = self.transitions.switch(event_time, *crossing.margin)
        except Stop:
            if self.options.t_eval is None:
                self.outputs += 1
                self.record(event_time)
            raise
        self._after(after)
        return after

    # ---------------------------------------------------------------- the end of 3D slip

    def _note_state(self) -> None:
        """Remember what the next step is held against: normals, and speed and rate of every 3D slip."""
        system = self.system
        integers, numbers = system.contact_int, system.contact_real
        numbers[: system.nc, LAST_NORMAL_X : LAST_NORMAL_X + 3] = system.basis[: system.nc, 2]
        self._slips = [
            (c, float(numbers[c, SLIP_SPEED]), float(numbers[c, SLIP_RATE]))
            for c in range(system.nc)
            if integers[c, MODE] == SLIPPING
            and integers[c, TANGENTS] == 2
            and not integers[c, FROZEN]
            and numbers[c, MU] > 0.0
        ]

    def _ending_slip(self) -> tuple[int, float] | None:
        """The contact whose slip is as good as over, and the time in s that is left of it."""
        for c, speed, rate in self._slips:
            if rate < 0.0 and speed <= self._slip_tolerance(c) * 2.0**self._stalled:
                return c, speed / -rate
        return None

    def _slip_tolerance(self, c: int) -> float:
        """Error in m/s that the tolerances allow in the slip velocity of contact c."""
        system = self.system
        relative, absolute = system.scale
        errors = absolute + relative * np.abs(system.v)
        return max(float(np.max(np.abs(system.rows[c]) @ errors)), _SMALLEST_STOP_SPEED)

    def _watch_slips(self, accepted: bool) -> None:
        """Count attempts that bring no slip nearer to its end, while one is within reach of it."""
        slowest = min((speed for _, speed, _ in self._slips), default=math.inf)
        if accepted and slowest < _PROGRESS * self._slowest:
            self._slowest, self._stalled = slowest, 0
        elif any(speed <= self._slip_tolerance(c) * 2.0**_STOP_DOUBLINGS for c, speed, _ in self._slips):
            self._stalled = min(self._stalled + 1, _STOP_DOUBLINGS)

    def _end_slip(self, t: float, c: int, left: float) -> float:
        """One linear step to the end of slip (its error is the square of a negligible time), then stick or not."""
        rk, system = self.rk, self.system
        # v_c is round-off there and has no direction: not to be evaluated as slip
        system.contact_int[c, MODE] = STICK
        rk.load(system.state + left * system.slopes[0])
        after = self.transitions.come_to_rest(t + left, c)
        self._after(after)
        return after

    # ---------------------------------------------------------------- charts

    def _change_charts(self) -> bool:
        """Move location parameters whose chart has a pole nearby to another chart."""
        return self.system.charted and bool(move_charts(self.system.table))

    # ---------------------------------------------------------------- outputs

    def _output_start(self, t: float) -> None:
        if self.options.t_eval is None:
            self.outputs += 1
            self.record(t)
        while self._output_due(t):
            self._next_output += 1
            self.outputs += 1
            self.record(t)

    def _output_due(self, t: float) -> bool:
        times = self.options.t_eval
        return times is not None and self._next_output < times.size and times[self._next_output] <= t

    def _output_short_step(self, t: float, step: float) -> None:
        if self._output_due(t + step):
            self._output_until(t, step, self._interpolant(t, step), t + step)

    def _output_until(self, t: float, step: float, dense: Interpolant, until: float) -> None:
        """Record the output times in (t, until], each projected on the constraints."""
        times = self.options.t_eval
        assert times is not None
        while self._output_due(until):
            when = float(times[self._next_output])
            self.rk.load(dense((when - t) / step))
            self._project(when, False)
            self.record(when)
            self.outputs += 1
            self._next_output += 1
