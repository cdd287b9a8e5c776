"""Event-driven integration: smooth steps in fixed modes between located mode changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..layout import (
    EVENT,
    FREE,
    LOCATION_FAILED,
    MODE,
    NO_FORCE,
    OK,
    START_RATE,
    START_SPEED,
    START_TOLERANCE,
    STICK,
)
from .contradictions import contradiction
from .dense import Interpolant
from .discrete import read_discrete
from .events import Crossing, EventLocator, UserEvent
from .results import FINISHED, NO_CONTACT_FORCE, STEP_LIMIT, STEP_TOO_SMALL, TERMINATED, Stop
from .runge_kutta import RungeKutta
from .steps import (
    AT_FLOOR,
    AT_LIMIT,
    ATTEMPTED,
    BLOCK_FULL,
    FAILED_FACTOR,
    MARCH,
    MARCH_APART,
    MARCH_ONE_ATTEMPT,
    MARCH_ONE_STEP,
    MAY_TOUCH,
    PROJECTION_FAILED,
    SLIP_ENDS,
    SLIP_IS_SLOW,
    STEP_FAILED,
    STEPPED,
    WRITE_OUTPUTS,
)
from .transitions import Transitions

# Steps that slow slip makes stiff before its direction is prescribed instead, and at most after that has failed;
# the least length of a step with a prescribed direction, in stiff ones that cost as much and last this time over that
# in which friction turns the slip; how much longer the next one is tried, and after how many of the same length where
# longer ones have failed.
_PATIENCE, _LONGEST_PATIENCE = 24, 3072
_SLOW_STEPS, _STABLE = 20.0, 4.0
_SLOW_GROWTH, _SLOW_RESTS = 4.0, 6
_FLOOR = 8.0 * float(np.finfo(float).eps)
# No step after a mode change begins with less than so many times the least.
_RESTART = 4.0
# Crossings in a row that true steps may deny before one is believed: where a margin jumps there is no zero.
_DOUBTS = 3
# Slips this many times faster than what counts as ended end with one that does.
_TOGETHER = 8.0
# What the user's control, or a drive, does in so many seconds is looked at, even where nothing moves: a dozen
# evaluations in each, so that a minute at rest costs less than a tenth of a second. A pulse that lasts as long is met
# by several of them.
_WATCH = 0.1
# The same for functions of the user's that are looked for zeros.
_WATCH_EVENTS = 1.0


@dataclass
class Options:
    """Step-size and output options of a run.

    t_eval: output times in s, None for every accepted step; breakpoints: times in s, in order within the run, at which
    steps end and modes are decided anew; keep_good: see `Driver.good`.
    """

    t_eval: np.ndarray | None = None
    max_step: float = math.inf
    max_steps: int = 1_000_000
    fixed_step: float | None = None
    first_step: float | None = None
    breakpoints: Sequence[float] = ()
    keep_good: bool = False


class Driver:
    """Integrates one system from the state in `system.state`.

    record(t): called for outputs outside compiled steps, with the state in the system. flush(): makes room for the rows
    that compiled steps write. progress(t): called now and then, or None.
    """

    def __init__(
        self,
        rk: RungeKutta,
        transitions: Transitions,
        users: list[UserEvent],
        record: Callable[[float], None],
        flush: Callable[[], None],
        options: Options,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.rk, self.system, self.transitions = rk, rk.system, transitions
        self.locator = EventLocator(rk, users, transitions.dips.depths, transitions.open)
        transitions.emit = self._output_short_step
        self.record, self.flush, self.options, self.progress = record, flush, options, progress
        self.system.set_output_times(options.t_eval)
        self._doubts = 0
        # what is told when to act, by a control or a drive, acts any time
        self._max_step = options.max_step
        if math.isinf(options.max_step):
            if self.system.varies_with_time:
                self._max_step = _WATCH
            elif users:
                self._max_step = _WATCH_EVENTS
        # time (s), state and discrete part of the contacts of the last state that the run came to, where it is kept
        self.good: tuple[float, np.ndarray, np.ndarray] | None = None

    @property
    def steps(self) -> int:
        """Accepted steps so far."""
        return int(self.system.counters["step_count"])

    @property
    def rejected(self) -> int:
        """Rejected steps so far."""
        return int(self.system.counters["rejected_count"])

    def run(self, t: float, t_end: float) -> tuple[int, str]:
        """Integrate from t to t_end (s); returns a code of `results` and a message. Raises what users' functions do."""
        try:
            self._run(t, t_end)
        except Stop as stop:
            return stop.code, stop.message
        return FINISHED, "the end of the interval was reached"

    def _run(self, t: float, t_end: float) -> None:
        options, rk = self.options, self.rk
        stops = [*(math.nextafter(time, -math.inf) for time in options.breakpoints), t_end]
        self._end = stops.pop(0)
        try:
            self.transitions.begin(t)
        except BaseException:
            # what there is: the state that the run was to start from
            rk.load(self.system.state)
            self._output_start(t)
            raise
        self._output_start(t)
        struck = None
        if t_end > t:
            self._allow_start(t, 0.0 if self.locator.users else options.fixed_step or math.inf)
            struck = self.transitions.strike(t)
            t = self.transitions.start_frozen(t) if struck is None else struck
        if struck is None:
            self.locator.update_users(t)
            self._finish(t)
        else:
            self._after(t)
        self._set_limits(t)
        scalars, why = self.system.scalars, STEPPED
        while t < t_end:
            if t >= self._end:
                before, self._end = self._end, stops.pop(0)
                t = self._pass_jump(max(t, math.nextafter(before, math.inf)))
                continue
            scalars["now"] = t
            self.flush()
            if options.keep_good:
                self._keep_good(t)
            why = self.system.run(self._foresee(t, self._task(), why == MAY_TOUCH))
            t = float(scalars["now"])
            if options.keep_good:
                self._keep_good(t)
            if why == STEPPED and self.system.counters["lost_positivity"]:
                raise self.transitions.give_up(t, NO_FORCE)
            if why == STEPPED:
                self._watch(t, True, False)
                self._output_at(t)
            elif why == ATTEMPTED:
                h = float(scalars["next_step"])
                t, switched = self._complete(t, float(scalars["step"]), float(scalars["next_time"]))
                if switched:
                    self._restart(h)
                elif self._slides_slowly() and t < t_end:
                    t = self._slow_slip(t)
            elif why == SLIP_ENDS:
                h = float(scalars["next_step"])
                t = self._end_slip(t)
                self._restart(h)
            elif why == SLIP_IS_SLOW:
                self._watch(t, True)
                self._output_at(t)
                t = self._slow_slip(t)
            elif why == AT_LIMIT:
                raise Stop(STEP_LIMIT, f"t = {t:.9g} s: the limit of {options.max_steps} steps was reached")
            elif why == AT_FLOOR:
                t = self._end_jams(t)
            elif why == STEP_FAILED:
                if options.fixed_step:
                    t = self._end_jams(t)
            elif why == PROJECTION_FAILED:
                raise self._projection_failed(float(scalars["next_time"]))
            if self.progress is not None:
                self.progress(t)

    def _keep_good(self, t: float) -> None:
        self.good = t, self.system.state.copy(), read_discrete(self.system)

    def _allow_start(self, t: float, step: float) -> None:
        """Let slip that starts at t, which ends or interrupts a step, go on for half of that at most."""
        self.transitions.longest_start = min(0.5 * step, 0.5 * (self._end - t), self._max_step)

    def _pass_jump(self, t: float) -> float:
        """Go on from the breakpoint t in s, behind what jumps there; the new time."""
        after = math.nextafter(t, math.inf)
        self._allow_start(after, self.options.fixed_step or math.inf)
        after = self.transitions.pass_jump(after)
        self._finish(after)
        self._watch(after, False)
        if self.options.t_eval is None:
            self.record(after)
        while self._output_due(after):
            # what was asked for at the breakpoint is shown there
            self.record(float(self.system.scalars["next_output"]))
            self.system.output_done()
        self._set_limits(after)
        return after

    def _set_limits(self, t: float) -> None:
        """What the compiled steps are controlled by."""
        options, scalars, counters = self.options, self.system.scalars, self.system.counters
        scalars["end"], scalars["max_step"] = self._end, self._max_step
        scalars["fixed_step"] = options.fixed_step or 0.0
        scalars["next_step"] = options.fixed_step or options.first_step or self.rk.first_step(t, self._end - t)
        scalars["floor"] = _FLOOR * max(abs(t), abs(self._end))
        scalars["slowest"] = math.inf
        counters["attempt_limit"] = options.max_steps
        counters["stalled"] = counters["stiff_steps"] = 0
        counters["patience"] = _PATIENCE

    def _task(self) -> int:
        """How far the compiled steps may go on their own."""
        if self.locator.users:
            return MARCH_ONE_ATTEMPT
        if self.system.ng or FREE in self.system.modes.tolist():
            return MARCH_ONE_STEP
        return MARCH

    def _foresee(self, t: float, task: int, may_touch: bool) -> int:
        """Bound the next step by what open contacts may hit in it; how far the compiled steps may then go.

        may_touch: whether these have come back because some may touch.
        """
        scalars, opened = self.system.scalars, self.transitions.open
        scalars["max_step"] = self._max_step
        if not opened.are_any():
            return task
        if not may_touch and task == MARCH_ONE_STEP and self.transitions.stay_apart(t):
            opened.is_near = False
            return MARCH_APART
        longest, near = opened.begin_step(t, float(min(scalars["next_step"], scalars["max_step"], scalars["end"] - t)))
        if opened.has_moved:
            # nearest points elsewhere: the same state, located there
            opened.has_moved = False
            self.rk.load(self.system.state)
            if self.rk.evaluate_start(t) > EVENT:
                raise self.transitions.give_up(t, LOCATION_FAILED)
            self._finish(t)
            self.transitions.note_sides(False)
        scalars["max_step"] = max(min(self._max_step, longest), 4.0 * scalars["floor"])
        return MARCH_ONE_ATTEMPT if near else task

    def _restart(self, h: float) -> None:
        """Step size after a mode change; h is what it would have been."""
        scalars, counters = self.system.scalars, self.system.counters
        if counters["failure"] != OK:
            # what has cut steps short are the modes that were left
            h, counters["failure"] = self.transitions.seed, OK
        h = max(h, _RESTART * float(scalars["floor"]))
        scalars["next_step"] = self.options.fixed_step or min(h, 10.0 * self.transitions.seed)
        scalars["slowest"], scalars["last_error"] = math.inf, 0.0
        counters["stalled"] = 0

    # ---------------------------------------------------------------- one step

    def _complete(self, t: float, step: float, t_new: float) -> tuple[float, bool]:
        """Events, outputs and commitment of the attempted step; returns the new time and whether modes changed."""
        rk, system = self.rk, self.system
        dense: Interpolant | None = None
        opened = self.transitions.open
        if opened.is_near and not opened.may_stand(t_new, step):
            self._unmake()
            return t, False
        asked = self.locator.users_cross(t, step)
        if rk.alarm or asked or opened.is_near:
            dense = rk.interpolant(t, step)
            if dense is None:
                return self._reject(t, step)
            crossing = self.locator.first(t, step) if rk.alarm else None
            for user in self.locator.user_crossings(t, step, dense) if asked else ():
                if crossing is not None and crossing.theta <= user.theta:
                    break
                if self.locator.users[user.user].terminal:
                    crossing = user
                    break
                rk.load(dense(user.theta))
                self.transitions.announce(t + user.theta * step, None, "user", user.user)
            if crossing is not None:
                return self._stop_at(t, step, dense, crossing)
            rk.load(system.new_state)
        if self._output_due(t_new):
            if dense is None:
                dense = rk.interpolant(t, step)
                if dense is None:
                    return self._reject(t, step)
            self._output_until(t_new)
            rk.load(system.new_state)
        self._project(t_new, dense is None)
        rk.accept()
        self._after(t_new, True)
        self._doubts = 0
        return t_new, False

    def _no_interpolant(self, t: float) -> Stop:
        return Stop(STEP_TOO_SMALL, f"t = {t:.9g} s: the dense output of a step could not be evaluated")

    def _reject(self, t: float, step: float) -> tuple[float, bool]:
        """Try a shorter step where the attempted one has no dense output, as where one of its stages fails."""
        scalars = self.system.scalars
        self._unmake()
        if self.options.fixed_step:
            if not self.transitions.held_up():
                raise self._no_interpolant(t)
            return self._end_jams(t), True
        scalars["next_step"] = FAILED_FACTOR * step
        return t, False

    def _unmake(self) -> None:
        """Count the attempted step as rejected."""
        self.system.counters["step_count"] -= 1
        self.system.counters["rejected_count"] += 1

    def _end_jams(self, t: float) -> float:
        """Where no step succeeds, end the slips that friction alone holds up, if there are any; the new time."""
        if not self.transitions.held_up():
            raise self.transitions.give_up(t, int(self.system.counters["failure"]))
        t = self.transitions.end_jams(t)
        self._after(t)
        self._restart(self.transitions.seed)
        return t

    def _project(self, t: float, evaluated: bool) -> None:
        if not self.rk.project(t, evaluated, self.rk.error):
            raise self._projection_failed(t)

    def _projection_failed(self, t: float) -> Stop:
        contradicting = contradiction(self.system, t)
        if contradicting:
            return Stop(NO_CONTACT_FORCE, f"t = {t:.9g} s: {contradicting}")
        return Stop(
            STEP_TOO_SMALL,
            f"t = {t:.9g} s: the projection on the constraints failed: it would change the state by more than the "
            "step's error",
        )

    def _finish(self, t: float) -> None:
        if self.rk.finish_step(t) > EVENT:
            raise self._projection_failed(t)

    def _after(self, t: float, stepped: bool = False) -> None:
        """What follows every state that is accepted here; stepped: see `_watch`."""
        self._finish(t)
        self._watch(t, stepped)
        if self.options.t_eval is None:
            self.record(t)
        self._output_at(t)

    def _watch(self, t: float, stepped: bool, scanned: bool = True) -> None:
        """Take the accepted state at t as the one that the next events are measured from.

        stepped: whether the last attempt led there in the present modes; scanned: and events were looked for in it.
        """
        self.locator.update_users(t)
        self.transitions.watch_gaps(stepped)
        self.transitions.note_sides(scanned)

    def _stop_at(self, t: float, step: float, dense: Interpolant, crossing: Crossing) -> tuple[float, bool]:
        """Step again to the crossing, so that the state there has the method's full order, and switch modes; returns
        the new time and whether modes changed."""
        rk, system = self.rk, self.system
        event_time = t + crossing.theta * step
        if self._output_due(event_time):
            self._output_until(event_time)
        happens = True
        if crossing.theta > 0.0:
            taken, happens = self.locator.refine(t, step, crossing)
            event_time = t + taken
            rk.load(system.new_state)
        else:
            rk.load(system.state)
        self._project(event_time, False)
        if not happens and self._doubts < _DOUBTS:
            # a shorter step, like any other
            self._doubts += 1
            rk.accept()
            self._after(event_time, True)
            return event_time, False
        self._doubts = 0
        if crossing.margin is None:
            rk.accept()
            self._after(event_time)
            self.transitions.announce(event_time, None, "user", crossing.user)
            raise Stop(TERMINATED, "a terminal event occurred")
        self._allow_start(event_time, step)
        try:
            after = self.transitions.switch(event_time, *crossing.margin)
        except Stop:
            if self.options.t_eval is None:
                self.record(event_time)
            raise
        self._after(after)
        return after, True

    # ---------------------------------------------------------------- slow slip and its end

    def _slides_slowly(self) -> bool:
        """Whether so many steps were stiff as is allowed, where the compiled steps leave it to be asked."""
        counters = self.system.counters
        asked = self.locator.users or self.options.fixed_step
        return bool(not asked and counters["stiff_steps"] >= counters["patience"])

    def _slow_slip(self, t: float) -> float:
        """Steps with prescribed directions of slip as long as these are longer than many stiff ones; the new time."""
        scalars, counters = self.system.scalars, self.system.counters
        span, rests, tried = 2.0 * _SLOW_STEPS * _STABLE / float(scalars["turning_rate"]), 0, True
        while tried:
            shortest = _SLOW_STEPS * _STABLE / max(float(scalars["turning_rate"]), 1e-300)
            span = min(span, self._max_step, self._end - t)
            after = self.transitions.follow_slow_slip(t, span, shortest) if span >= shortest else None
            tried = after is not None
            if after is None:
                # the next steps are explicit again; the longer that fails the longer they are left alone
                counters["patience"] = min(2 * counters["patience"], _LONGEST_PATIENCE)
            else:
                counters["patience"] = _PATIENCE
                counters["step_count"] += 1
                # a length that was too much is not asked for again soon
                rests = _SLOW_RESTS if after - t < 0.9 * span else rests - 1
                span = (after - t) * (1.0 if rests > 0 else _SLOW_GROWTH)
                t = after
                self._after(t)
                tried = t < self._end and counters["step_count"] < counters["attempt_limit"]
        counters["stiff_steps"] = 0
        return t

    def _end_slip(self, t: float) -> float:
        """One linear step to the end of slip (its error is the square of a short time), then stick or not."""
        rk, system = self.rk, self.system
        speed, rate = system.contact_real[:, START_SPEED], system.contact_real[:, START_RATE]
        stopping = np.flatnonzero(np.isfinite(speed) & (rate < 0.0))
        allowed = system.contact_real[stopping, START_TOLERANCE]
        c = int(stopping[np.argmin(speed[stopping] / allowed)])
        scalars = system.scalars
        # at loose tolerances a slip that counts as over may have a long way to go: no further than a step
        left = min(float(speed[c] / -rate[c]), scalars["next_step"], scalars["max_step"], scalars["end"] - t)
        left = float(min(left, scalars["next_output"] - t, self.transitions.until_touch()))
        # contacts of one body come to rest at the same instant as a rule: those go together that are near it together
        reach = _TOGETHER * 2.0 ** int(system.counters["stalled"]) * system.contact_real[:, START_TOLERANCE]
        with np.errstate(invalid="ignore"):
            near = np.minimum(speed, np.abs(speed + rate * left)) <= reach
        contacts = [c, *(int(i) for i in np.flatnonzero(near & np.isfinite(speed)) if i != c)]
        rk.load(system.state)
        rk.evaluate(t)
        ended = {i: self.transitions.slip_direction(i) for i in contacts}
        # v_c is round-off there and has no direction: not to be evaluated as slip
        system.contact_int[contacts, MODE] = STICK
        rk.load(system.state + left * system.slopes[0])
        self._allow_start(t + left, float(scalars["step"]))
        after = self.transitions.come_to_rest(t + left, ended)
        self._after(after)
        return after

    # ---------------------------------------------------------------- outputs

    def _output_start(self, t: float) -> None:
        if self.options.t_eval is None:
            self.record(t)
        self._output_at(t)

    def _output_due(self, t: float) -> bool:
        return bool(self.system.scalars["next_output"] <= t)

    def _output_at(self, t: float) -> None:
        """Record the system's state for every output time that has come."""
        while self._output_due(t):
            self.record(t)
            self.system.output_done()

    def _output_short_step(self, t: float, step: float) -> None:
        if self._output_due(t + step):
            if self.rk.interpolant(t, step) is None:
                raise self._no_interpolant(t)
            self._output_until(t + step)

    def _output_until(self, until: float) -> None:
        """Record the output times up to `until` in the step that was interpolated last."""
        self.flush()
        status = self.system.run(WRITE_OUTPUTS, until)
        while status == BLOCK_FULL:
            self.flush()
            status = self.system.run(WRITE_OUTPUTS, until)
        if status != OK:
            raise self._projection_failed(until)
