"""Event-driven integration: smooth steps in fixed modes between located mode changes.

The way of a run, see `Driver`: compiled steps go on until something may have happened (`_step`). The trial step is then
searched for events (`_complete`; `locator`, `events`). The state is stepped to the first one, where `transitions`
changes the modes (`_change_modes`). What is accepted is written (`_after`; `outputs`), and the next step is bounded
(`_restart`, `_foresee`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from ..dynamics.redistribution import leaves_loads_open
from ..layout import (
    EVENT,
    FREE,
    FRICTION_EVENT,
    LOCATION_FAILED,
    NO_FORCE,
    NORMAL_EVENT,
    OK,
)
from .accuracy import held_up, turns_along_curves
from .contradictions import projection_failure
from .dense import Interpolant
from .ends import stays_within
from .events import UserEvent, UserEvents, lost_zeros
from .locator import Crossing, EventLocator
from .options import Options
from .outputs import Outputs, no_dense_output
from .reports import told
from .results import FINISHED, OPEN_LOADS, STEP_LIMIT, TERMINATED, Stop
from .runge_kutta import RungeKutta
from .slip_at_ends import ACCURATE
from .slip_steps import PATIENCE, STABLE, SlipSteps
from .steps import (
    AT_FLOOR,
    AT_LIMIT,
    FAILED_FACTOR,
    INTEGRATE,
    INTEGRATE_APART,
    INTEGRATE_ONE_STEP,
    INTEGRATE_ONE_TRIAL,
    MAY_TOUCH,
    PROJECTION_FAILED,
    SLIP_ENDS,
    SLIP_IS_SLOW,
    STEP_FAILED,
    STEPPED,
    TRIED,
)
from .transitions import Transitions

_FLOOR = 8.0 * float(np.finfo(float).eps)
# No step after a mode change, or where bodies are near, is shorter than so many times the least; none after a mode
# change longer than so many times the seed of a slip.
_RESTART, _RESTART_SEEDS = 4.0, 10.0
# Crossings in a row that true steps may deny before one is believed: an event function that jumps has no zero.
_DOUBTS = 3
# Rounds, at most, in which contacts of the same contours may leave their places to each other.
_RELOCATIONS = 4
# What the user's control, or a drive, does in so many seconds is looked at, even where nothing moves: a dozen
# evaluations in each, so that a minute at rest costs less than a tenth of a second. A pulse that lasts as long is met
# by several of them.
_WATCH = 0.1
# The same for functions of the user's that are looked for zeros.
_WATCH_EVENTS = 1.0


class Driver:
    """Integrates one system from the state in `system.state`.

    record(t): called for outputs outside compiled steps, with the state in the system. flush(): makes room for the rows
    that compiled steps write. progress(t): an attribute that is called now and then, or None.
    """

    def __init__(
        self,
        rk: RungeKutta,
        transitions: Transitions,
        users: list[UserEvent],
        record: Callable[[float], None],
        flush: Callable[[], None],
        options: Options,
    ) -> None:
        self.rk, self.system, self.transitions = rk, rk.system, transitions
        self.locator = EventLocator(rk, transitions.penetration.depths, transitions.open)
        self.users = UserEvents(rk, users)
        self.outputs = Outputs(rk, record, flush, options.t_eval, options.pieces)
        self.slips = SlipSteps(rk, transitions, self.outputs, self._after_way)
        transitions.onset.emit = self._pass_short_step
        self.options = options
        self.progress: Callable[[float], None] | None = None
        self._doubts = 0
        # s: how long slip went on that has just begun
        self._age = 0.0
        # what is told when to act, by a control or a drive, acts any time
        self._max_step = options.max_step
        if math.isinf(options.max_step):
            if self.system.varies_with_time:
                self._max_step = _WATCH
            elif users:
                self._max_step = _WATCH_EVENTS
        # how often modes were entered in which the motion depends on loads that nothing decides
        self.open_loads = 0
        # whether the last evaluation was not at the accepted state: of a rejected step, or of one that was tried first
        self._thrown = False
        # time (s), state and discrete part of the contacts of the last state that the run came to, where it is kept
        self.good: tuple[float, np.ndarray, np.ndarray] | None = None

    @property
    def steps(self) -> int:
        """Accepted steps so far."""
        return self.system.counters.step_count

    @property
    def rejected(self) -> int:
        """Rejected steps so far."""
        return self.system.counters.rejected_count

    def run(self, t: float, t_end: float) -> tuple[int, str]:
        """Integrate from t to t_end (s); returns a code of `results` and a message. Raises what users' functions do."""
        try:
            self._run(t, t_end)
        except Stop as stop:
            return stop.code, told(self.system, stop) + lost_zeros(self.users.functions)
        said = f"; after {self.open_loads} changes of modes {OPEN_LOADS}" if self.open_loads else ""
        said += self.transitions.remarks(t_end) + lost_zeros(self.users.functions)
        return FINISHED, "the end of the interval was reached" + said

    def _run(self, t: float, t_end: float) -> None:
        stops = [*(math.nextafter(time, -math.inf) for time in self.options.breakpoints), t_end]
        self._end, why = stops.pop(0), STEPPED
        t = self._begin(t, t_end)
        while t < t_end:
            if t >= self._end:
                jump, self._end = math.nextafter(self._end, math.inf), stops.pop(0)
                t = self._pass_jump(max(t, jump))
                continue
            if self.transitions.onset.pending is not None:
                t = self._go_on(t, self.system.scalars.next_step)
                continue
            t, why = self._step(t, why)
            t = self._respond(t, t_end, why)
            if self.progress is not None:
                self.progress(t)

    def _begin(self, t: float, t_end: float) -> float:
        """Decide the modes of the initial state, and what strikes or slips there; the new time."""
        try:
            self.transitions.begin(t)
        except BaseException:
            # what there is: the state that the run was to start from
            self.rk.load(self.system.state)
            self.outputs.write_state(t)
            raise
        self.outputs.write_state(t)
        struck = None
        if t_end > t:
            self._allow_start(t, self.options.fixed_step or math.inf)
            self.users.update(t)
            struck = self.transitions.strike(t)
            t = self.transitions.onset.start(t) if struck is None else struck
        if struck is None:
            self.users.update(t)
            self._finish(t)
        else:
            self._after(t, jumps=True)
        self._set_limits(t)
        if t >= t_end and self.outputs.pieces is not None and not len(self.outputs.pieces):
            self.outputs.pieces.keep_point(t)
        return t

    def _step(self, t: float, why: int) -> tuple[float, int]:
        """Let compiled steps go on as far as they can; the new time, and why they come back. why: the last time."""
        scalars = self.system.scalars
        scalars.now = t
        self.outputs.flush()
        self._keep_good(t)
        counters, task = self.system.counters, self._foresee(t, self._task(), why == MAY_TOUCH)
        rejected = counters.rejected_count
        why = self.system.run(task)
        if why == STEP_FAILED or (why == MAY_TOUCH and counters.rejected_count > rejected):
            self._thrown = True
        t = scalars.now
        self._keep_good(t)
        return t, why

    def _respond(self, t: float, t_end: float, why: int) -> float:
        """Do what compiled steps leave to be done: events, transitions, outputs; the new time."""
        scalars, usual_step = self.system.scalars, self.system.scalars.next_step
        if why == STEPPED:
            if self.system.counters.lost_positivity:
                raise self.transitions.reports.failure(t, NO_FORCE)
            self._watch(t, True, False)
            self.outputs.write_asked(t)
        elif why in (TRIED, SLIP_ENDS):
            step, t_new = scalars.step, scalars.next_time
            t, switched = self._complete(t, step, t_new) if why == TRIED else self.slips.end_slip(t, self._allow_start)
            if switched:
                t = self._go_on(t, usual_step)
            if self._slides_slowly() and t < t_end:
                t = self._slow_slip(t)
        elif why == SLIP_IS_SLOW:
            self._watch(t, True)
            self.outputs.write_asked(t)
            t = self._slow_slip(t)
        elif why == AT_LIMIT:
            raise Stop(STEP_LIMIT, f"t = {t:.9g} s: the limit of {self.options.max_steps} steps was reached")
        elif why == AT_FLOOR or (why == STEP_FAILED and self.options.fixed_step):
            t = self._end_jams(t)
        elif why == PROJECTION_FAILED and t < scalars.next_time and self._may_close(scalars.step):
            self._shorten(scalars.step)
        elif why == PROJECTION_FAILED:
            t_new, step = scalars.next_time, scalars.step
            self.outputs.write_until(t_new)
            t = self._go_on(self._give_way(t_new, self.system.new_state, step), usual_step)
        return t

    def _go_on(self, t: float, step: float) -> float:
        """Go on from a mode change, which interrupts steps of this size in s, and from the next where slip begins up to
        it; the new time."""
        onset = self.transitions.onset
        while onset.pending is not None and t < self._end:
            (item, kind), onset.pending = onset.pending, None
            self.rk.load(self.system.state)
            self._project(t, False)
            self._allow_start(t, max(step, self.system.scalars.step))
            t = self.transitions.switch(t, item, kind, False)
            self._after(t)
        self._restart(step)
        return t

    def _keep_good(self, t: float) -> None:
        """Keep the accepted state as the last good one, where that is asked for."""
        if self.options.discrete is not None:
            self.good = t, self.system.state.copy(), self.options.discrete(self.system)

    def _allow_start(self, t: float, step: float) -> None:
        """Let slip that starts at t, which ends or interrupts a step, go on for half of that at most."""
        onset, left = self.transitions.onset, self._end - t
        # in less time than that no slip shows, however short slow slip beside makes steps
        stiff = self.system.scalars.turning_rate * step > ACCURATE
        longest = max(0.5 * step, self.transitions.changes.ahead if stiff else 0.0)
        onset.longest, onset.left = min(longest, 0.5 * left, self._max_step), max(left, 0.0)

    def _pass_jump(self, t: float) -> float:
        """Go on from the breakpoint t in s, behind what jumps there; the new time."""
        after, self.transitions.onset.pending = math.nextafter(t, math.inf), None
        self._allow_start(after, self.options.fixed_step or math.inf)
        after = self.transitions.pass_jump(after)
        # what was asked for at the breakpoint is shown there
        self._after(after, jumps=True, at_their_times=True)
        self._set_limits(after)
        return after

    def _set_limits(self, t: float) -> None:
        """What the compiled steps are controlled by."""
        options, scalars, counters = self.options, self.system.scalars, self.system.counters
        scalars.end, scalars.max_step = self._end, self._max_step
        scalars.fixed_step = options.fixed_step or 0.0
        given = options.fixed_step or options.first_step
        scalars.next_step, self._thrown = given or self.rk.first_step(t, self._end - t), not given
        scalars.floor, scalars.slowest = _FLOOR * max(abs(t), abs(self._end)), math.inf
        counters.trial_limit = options.max_steps
        counters.stalled, counters.stiff_steps, counters.patience = 0, 0, PATIENCE
        self.open_loads += leaves_loads_open(self.system)

    def _task(self) -> int:
        """How far the compiled steps may go on their own."""
        if self.users or self.outputs.pieces is not None:
            return INTEGRATE_ONE_TRIAL
        if self.system.ng or FREE in self.system.modes.tolist():
            return INTEGRATE_ONE_STEP
        return INTEGRATE

    def _foresee(self, t: float, task: int, may_touch: bool) -> int:
        """Bound the next step by what bodies may touch in it; how far the compiled steps may then go.

        may_touch: whether these have come back because some may touch.
        """
        scalars, opened = self.system.scalars, self.transitions.open
        scalars.max_step = self._max_step
        if not opened.are_any(t):
            return task
        task = INTEGRATE_ONE_STEP if task == INTEGRATE else task
        if self._thrown:
            # the last evaluation was of a state that is not accepted
            self._thrown = False
            if self.rk.evaluate_start(t) > EVENT:
                raise self.transitions.reports.failure(t, LOCATION_FAILED)
        longest = min(scalars.next_step, scalars.max_step, scalars.end - t)
        opened.watch_ends(t, longest)
        self._follow_relocated(t)
        if not may_touch and task == INTEGRATE_ONE_STEP and self.transitions.stay_apart(t):
            opened.is_near = False
            return INTEGRATE_APART
        for _ in range(_RELOCATIONS):
            longest, near = opened.begin_step(t, longest)
            if not opened.relocated:
                break
            # others may be where these were
            self._follow_relocated(t)
        scalars.max_step = max(min(self._max_step, longest), _RESTART * scalars.floor)
        return INTEGRATE_ONE_TRIAL if near else task

    def _follow_relocated(self, t: float) -> None:
        """Where contacts are elsewhere, have the accepted state located there."""
        if self.transitions.open.relocated:
            self.transitions.open.relocated.clear()
            self.rk.load(self.system.state)
            if self.rk.evaluate_start(t) > EVENT:
                raise self.transitions.reports.failure(t, LOCATION_FAILED)
            self._finish(t)
            # what has come there within the step, as far as gaps are known, is about to touch
            self.transitions.open.note(self.system.gap_accuracy.item)

    def _restart(self, h: float) -> None:
        """Step size after a mode change; h is what it would have been."""
        scalars, counters = self.system.scalars, self.system.counters
        if counters.failure != OK:
            # what has cut steps short are the modes that were left
            h, counters.failure = self.transitions.onset.seed, OK
        self._age, self.transitions.onset.age = self.transitions.onset.age, 0.0
        if self._age > 0.0:
            # slip that has just begun changes in times like its age
            h = min(h, max(self._age, _RESTART_SEEDS * self.transitions.onset.seed))
        if scalars.turning_rate > 0.0:
            # longer explicit steps are not stable
            h = min(h, STABLE / scalars.turning_rate)
        scalars.next_step = self.options.fixed_step or max(h, _RESTART * scalars.floor)
        scalars.slowest, scalars.last_error = math.inf, 0.0
        counters.stalled, counters.patience = 0, PATIENCE
        if scalars.turning_rate * self._age > PATIENCE * STABLE:
            # friction turns slip that has just begun much faster than it grows
            counters.stiff_steps = counters.patience
        self.open_loads += leaves_loads_open(self.system)

    # ---------------------------------------------------------------- one step

    def _complete(self, t: float, step: float, t_new: float) -> tuple[float, bool]:
        """Events, outputs and commitment of the trial step; returns the new time and whether modes changed."""
        rk, system = self.rk, self.system
        opened, told, kept = self.transitions.open, len(self.transitions.reports.events), len(self.outputs)
        if opened.is_near and not opened.may_stand(t_new, step):
            self._unmake()
            return t, False
        asked = self.users.may_cross(t, step)
        interpolated = rk.alarm or asked or opened.is_near or self.outputs.need_dense(t_new)
        if interpolated:
            if not rk.interpolate(t, step):
                return self._reject(t, step)
            crossing = self.locator.first(t, step) if rk.alarm else None
            rests = crossing is not None and not asked and self.transitions.changes.rests_on_redundant()
            while rests and crossing is not None and self._keeps_motion(t, step, crossing):
                crossing = self.locator.first(t, step, crossing.theta)
            if opened.is_near:
                crossing = self.locator.comes_over(t, step, crossing)
                if crossing is None and self._may_be_shorter(step) and self.transitions.misses(t_new):
                    self._take_back(told, kept, step)  # before anything is told or written of the step
                    return t, False
            if asked:
                self._announce_user_events(t, step, math.inf if crossing is None else crossing.theta)
            if crossing is not None:
                return self._change_modes(t, step, crossing, rests, told, kept)
            rk.load(system.new_state)
        closes, written = rk.project(t_new, not interpolated, rk.error), interpolated and self.outputs.due(t_new)
        if not closes and self._may_close(step):
            self._take_back(told, kept, step)
            return t, False
        if written:
            self.outputs.write_until(t_new)
            rk.load(system.new_state)
            closes = rk.project(t_new, False, rk.error)
        self.outputs.keep(t, t_new, step)
        if not closes:
            return self._give_way(t_new, system.new_state, step), True
        rk.accept()
        self._after(t_new, True)
        self._doubts = 0
        return t_new, False

    def _keeps_motion(self, t: float, step: float, crossing: Crossing) -> bool:
        """Whether other ones among redundant forces, which move nothing, keep all modes beyond a crossing in the trial
        step. The step stays as it is then: its motion does not depend on when forces are chosen, as long as there are
        some at any time, so that dense output is accurate enough for that."""
        time = t + crossing.theta * step
        if crossing.kind not in (NORMAL_EVENT, FRICTION_EVENT):
            return False
        self.outputs.write_until(time)
        self.outputs.keep(t, time, step)
        exists, _ = self.system.look(t, step, crossing.theta)
        if exists and self.transitions.changes.redistribute_within(time, crossing.c, crossing.kind):
            return True
        self.outputs.drop()
        return False

    def _reject(self, t: float, step: float) -> tuple[float, bool]:
        """Try a shorter step where the trial step has no dense output, as where one of its stages fails."""
        if self.options.fixed_step:
            self._unmake()
            if not held_up(self.system):
                raise no_dense_output(t)
            return self._end_jams(t), True
        self._shorten(step)
        return t, False

    def _may_close(self, step: float) -> bool:
        """Whether a shorter step may be projected where this one may not: its error was larger than was known, as over
        knots of a contour, and no constraint next to redundant is in its way, or is not in shorter ones."""
        independent = self.system.counters.row_rank == self.system.counters.row_count
        return self._may_be_shorter(step) and (independent or turns_along_curves(self.system, step))

    def _may_be_shorter(self, step: float) -> bool:
        return not self.options.fixed_step and step > _RESTART * self.system.scalars.floor

    def _shorten(self, step: float) -> None:
        """Try a shorter step than this one."""
        self._unmake()
        self.system.scalars.next_step = FAILED_FACTOR * step

    def _unmake(self) -> None:
        """Count the trial step as rejected."""
        self.system.counters.step_count -= 1
        self.system.counters.rejected_count += 1
        self._thrown = True

    def _take_back(self, told: int, kept: int, step: float) -> None:
        """Try a shorter step, and take back what was told, and kept, of this one but so many events, and pieces."""
        self._shorten(step)
        self.users.take_back(self.system.scalars.now)
        del self.transitions.reports.events[told:]
        self.outputs.keep_only(kept)

    def _give_way(self, t: float, state: np.ndarray, step: float) -> float:
        """Go on from a state at t, behind a step of this size, that could not be projected; the new time."""
        failure = projection_failure(self.system, t)
        self.rk.load(state)
        self._allow_start(t, step)
        after = self.transitions.onset.give_way(t, failure)
        self._after(after, jumps=True)
        return after

    def _end_jams(self, t: float) -> float:
        """Where no step succeeds, end the slips that may be stopped, if there are any; the new time."""
        failure = self.system.counters.failure
        self.rk.load(self.system.state)
        self.transitions.changes.evaluate_rows(t)
        after = self.transitions.end_jams(t)
        if after is None:
            raise self.transitions.reports.failure(t, failure)
        self._after(after)
        self._restart(self.transitions.onset.seed)
        return after

    def _project(self, t: float, evaluated: bool) -> None:
        if not self.rk.project(t, evaluated, self.rk.error):
            raise projection_failure(self.system, t)

    def _finish(self, t: float) -> None:
        if self.rk.finish_step(t) > EVENT:
            raise projection_failure(self.system, t)

    def _after(self, t: float, stepped: bool = False, jumps: bool = False, at_their_times: bool = False) -> None:
        """What follows every state that is accepted here; stepped: see `_watch`; jumps: whether the state, or what
        users' events are of, has jumped since these were looked for; at_their_times: see `write_state`."""
        self._finish(t)
        jumped = self.users.jumped(t) if jumps else []
        self._watch(t, stepped)
        self.outputs.write_state(t, at_their_times)
        for user in jumped:
            self._announce_user_event(t, user)

    def _after_way(self, t: float, since: float, start: np.ndarray) -> None:
        """What follows the state at t that is accepted after a way, straight but for round-off, from the state `start`
        at `since` (s); terminal events end the run at t."""
        self._finish(t)
        zeros = self.users.passed(t, since, start)
        self._watch(t, False)
        self.outputs.write_state(t)
        for time, user, state in zeros:
            self.rk.load(state)
            self._announce_user_event(time, user)
        if zeros:
            # the slip's own event has been told
            self.transitions.reports.events.sort(key=lambda event: event.time)
            self.rk.load(self.system.state)

    def _pass_short_step(self, t: float, step: float) -> None:
        """Users' events and outputs in the last trial step, by which slip that starts at t is taken on."""
        if self.users:
            # the state at t may have jumped
            self.rk.load(self.system.state)
            for user in self.users.jumped(t):
                self._announce_user_event(t, user)
            self.rk.load(self.system.new_state)
            if self.users.may_cross(t, step):
                self.outputs.interpolate(t, step)
                self._announce_user_events(t, step, math.inf)
        self.outputs.write_short_step(t, step)

    def _announce_user_event(self, t: float, user: UserEvent) -> None:
        """Note a zero of a user's function in the loaded state; a terminal one raises Stop."""
        self.transitions.reports.announce(t, None, "user", user.index)
        if user.terminal:
            raise Stop(TERMINATED, "a terminal event occurred")

    def _watch(self, t: float, stepped: bool, scanned: bool = True) -> None:
        """Take the accepted state at t as the one that the next events are measured from.

        stepped: whether the last trial step led there in the present modes; scanned: and events were looked for in it.
        """
        self.users.update(t)
        self.transitions.penetration.watch(stepped)
        if self.system.ng:
            self.transitions.joints.watch(stepped)
        self.transitions.note_sides(scanned)

    def _announce_user_events(self, t: float, step: float, until: float) -> None:
        """The zeros of the user's functions in the trial step before the fraction `until`; a terminal one raises Stop,
        after a step to it."""
        dense = Interpolant(self.system)
        for zero in self.users.crossings(t, step, until, dense):
            time = t + zero.theta * step
            if zero.event.terminal:
                self.outputs.write_until(time)
                taken = step * zero.behind(min(until, 1.0), partial(self._value_after, t, step, zero.event))
                time = t + taken
                self.outputs.keep_shorter(t, taken, step)
                self.rk.load(self.system.new_state)
                self._project(time, False)
                self.rk.accept()
                self._after(time)
            else:
                self.rk.load(dense(zero.theta))
            self._announce_user_event(time, zero.event)

    def _value_after(self, t: float, step: float, event: UserEvent, theta: float) -> float:
        """A user's function after a trial step of that part of this size, on the constraints."""
        self.rk.try_step(t, theta * step)
        self.rk.load(self.system.new_state)
        self._project(t + theta * step, False)
        return event.value_at(t + theta * step, self.system)

    def _change_modes(
        self, t: float, step: float, crossing: Crossing, chosen: bool, told: int, kept: int
    ) -> tuple[float, bool]:
        """Step again to the crossing, so that the state there has the method's full order, and switch modes; returns
        the new time and whether modes changed. chosen: whether no other redundant forces would do; told, kept: see
        `_take_back`."""
        rk, error = self.rk, self.rk.error
        time, happens = t + crossing.theta * step, True
        if self.locator.jams(step, crossing):
            self._take_back(told, kept, step)
            return self._end_jams(t), True
        self.outputs.write_until(time)
        if crossing.theta > 0.0:
            taken, happens = self.locator.refine(t, step, crossing)
            if taken <= step and rk.error > max(error, 1.0) and not self.options.fixed_step:
                # forces jump there, as where rows become independent: longer steps may not see it
                self._take_back(told, kept, taken)
                return t, False
            time = t + taken
            self.outputs.keep_shorter(t, taken, step)
        state = self.system.new_state if crossing.theta > 0.0 else self.system.state
        rk.load(state)
        if not rk.project(time, False, rk.error):
            return self._give_way(time, state, step), True
        grazes = crossing.theta > 0.0 and stays_within(self.system, crossing.c, crossing.kind)
        if (not happens and self._doubts < _DOUBTS) or grazes:
            # a shorter step, like any other
            self._doubts += not happens
            rk.accept()
            self._after(time, True)
            return time, False
        self._doubts = 0
        self._allow_start(time, step)
        try:
            after = self.transitions.switch(time, crossing.c, crossing.kind, chosen)
        except Stop as stop:
            if stop.code != TERMINATED:
                self.outputs.write_end(time)
            raise
        self._after(after, jumps=True)
        return after, True

    def _slides_slowly(self) -> bool:
        """Whether so many steps were stiff as is allowed, where the compiled steps leave it to be asked."""
        counters = self.system.counters
        return not self.options.fixed_step and bool(counters.stiff_steps >= counters.patience)

    def _slow_slip(self, t: float) -> float:
        """Go on with prescribed directions of slip; the new time."""
        age, self._age = self._age, 0.0
        return self.slips.follow_slowly(t, self._end, self._max_step, age)
