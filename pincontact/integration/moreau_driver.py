"""A run of Moreau's method: constant steps, outputs, and users' events."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..layout import FREE, LENGTH, LOCATION_FAILED, MODE, OK, SINGULAR, SLIPPING, STICK
from .accuracy import LEAPS
from .contradictions import jump_apart, jump_into, refuse_apart
from .events import UserEvent, Zero, goes_through, lost_zeros
from .impulse_layout import JOINT_AT_HIGH, JOINT_AT_LOW, JOINT_STICKS, SLIP
from .impulse_steps import AT_END, AT_LIMIT, GOING_ON, INNER_OUTPUT_LEFT, OUTPUT_LEFT, TRIED
from .moreau import MoreauStep
from .reports import left_behind
from .results import CONTOUR_ENDS, FINISHED, OPEN_LOADS, TERMINATED, Event, Stop
from .results import STEP_LIMIT as AT_STEP_LIMIT
from .sign_changes import asked_once, crossing_between
from .step_control import SLIVER

if TYPE_CHECKING:
    from ..dynamics.system import Torque

# Accuracy of the time of a user's event, relative to the step.
_EVENT_ACCURACY = 1e-12


class MoreauDriver:
    """A run of constant steps, with outputs and users' events.

    record(t): called for outputs outside compiled steps, with the state in the system. flush(): makes room for rows
    that compiled steps write. torque: see `MoreauStep.ask`; progress(t): an attribute, called now and then, or None.
    t_eval: output times in s, None for every step. breakpoints: times in s, in order within the run, at which steps
    end.
    """

    def __init__(
        self,
        step: MoreauStep,
        users: list[UserEvent],
        record: Callable[[float], None],
        flush: Callable[[], None],
        size: float,
        t_eval: np.ndarray | None,
        max_steps: int,
        torque: Torque | None,
        breakpoints: Sequence[float] = (),
    ) -> None:
        self.breakpoints, self._earlier_steps = breakpoints, 0
        self.step, self.system, self.users = step, step.system, users
        self.record, self.flush, self.size, self.max_steps = record, flush, size, max_steps
        self.torque = torque
        self.progress: Callable[[float], None] | None = None
        self.events: list[Event] = []
        self.system.set_output_times(t_eval)

    def run(self, t: float, t_end: float) -> tuple[int, str]:
        """Step from t to t_end (s); returns a code of `results` and a message. Raises what users' functions do."""
        self.step.ask(self.torque)
        try:
            self._run(t, t_end)
            self.step.follow(t_end)
        except Stop as stop:
            return stop.code, stop.message + lost_zeros(self.users)
        finally:
            # nothing of the user's is kept
            self.step.ask(None)
        return FINISHED, "the end of the interval was reached" + self._remarks(t_end)

    def _remarks(self, t: float) -> str:
        """What is to be said of problems that had no solution, or none that was found, and of loads on which the motion
        depends, and of which more than one choice is right."""
        cones, left_open, said = self.step.cones, self.step.stats["open_loads"], ""
        if cones.settled:
            off = f"off by up to {cones.settled_off:.2g} of the largest"
            said += f"; {cones.settled} cone problems were settled with the friction of other loads, {off}"
        if left_open:
            said += f"; in {left_open} cone problems {OPEN_LOADS}"
        behind = left_behind(self.system, self.step.start_gap, self.step.start_domain, self.step.open, t)
        return said + behind + lost_zeros(self.users)

    def _run(self, start: float, end: float) -> None:
        step = self.step
        self._plan(start, end)
        self._check(step.begin(start), start)
        refuse_apart(step.apart)
        for event in self.users:
            event.value = event.value_at(start, self.system)
        if step.acts_on_joints:
            # forces of outputs are those of the step before
            step.foresee(start, min(self.size, end - start) if end > start else self.size)
        self.output(start)
        for jump in self.breakpoints:
            # so much before it that no rounding of the step takes it for a whole one, and gets there
            self._run_until(start, max(start, jump - 2.0 * SLIVER * self.size))
            start = math.nextafter(jump, math.inf)
            while self._next_output <= start:
                self._record(self._next_output, asked=False)
                self.system.output_done()
            self._earlier_steps += step.steps
            step.steps = 0
            before, outside = step.start_motion.copy(), step.start_gap >= 0.0
            self._check(step.begin(start), start)
            for name, gap in step.apart.items():
                raise jump_apart(jump, name, gap)
            step.follow(start)
            inside = step.start_gap < -LEAPS * self.system.contact_real[: self.system.nc, LENGTH]
            for c in np.flatnonzero(outside & inside & (step.start_domain >= 0.0)).tolist():
                raise jump_into(jump, self.system.contacts[c].name)
            for c, motion in zip(*np.nonzero((before == STICK) & (step.start_motion == SLIPPING))):
                self._announce(jump, self.system.contacts[c].name, _friction_event(motion, STICK, SLIPPING))
        self._run_until(start, end)

    def _run_until(self, start: float, end: float) -> None:
        step, size, count = self.step, self.size, self._plan(start, end)
        most = self.max_steps - self._earlier_steps
        why = GOING_ON
        while why != AT_END:
            self.flush()
            approved = why == TRIED
            ahead = 1 if approved else step.look()
            why = step.integrate(most, ahead, approved)
            i = step.steps
            t, t_new = start + i * size, end if i >= count - 1 else start + (i + 1) * size
            if why == TRIED:
                self._user_events(t, t_new)
                self._report(t, t_new)
            elif why == OUTPUT_LEFT:
                self.output(end if i == count else t, asked=True)
            elif why == INNER_OUTPUT_LEFT:
                self._record(float(self._next_output), asked=True)
                self.system.output_done()
            elif why == AT_LIMIT and i >= most:
                raise Stop(AT_STEP_LIMIT, f"t = {t:.9g} s: the limit of {self.max_steps} steps was reached")
            elif why == CONTOUR_ENDS:
                raise self._end_of_contour(t, t + step.size)
            elif step.divides(why, t):
                count = self._run_parts(start, end, t, t_new)
                most = self.max_steps - self._earlier_steps
            elif why == AT_LIMIT and ahead == 0:
                self._check(step.trouble, t)
            elif why not in (GOING_ON, AT_END, AT_LIMIT):
                self._check(why, t)
            if self.progress is not None:
                i = step.steps
                self.progress(end if i == count else start + i * size)
        if step.goes_wrong(end):
            self._check(step.trouble, end)

    def _run_parts(self, start: float, end: float, t: float, t_new: float) -> int:
        """The step from t to t_new by steps of half the size, within a run of steps; returns how many these are."""
        step, size, done, earlier = self.step, self.size, self.step.steps, self._earlier_steps
        self.size, self._earlier_steps, step.parts = 0.5 * size, earlier + done, 2 * step.parts
        try:
            self._run_until(t, t_new)
        finally:
            self.size, step.parts = size, step.parts // 2
        # one of them counts as the step itself
        self._earlier_steps += step.steps - done - 1
        count = self._plan(start, end)
        step.steps = done + 1
        return count

    def _plan(self, start: float, end: float) -> int:
        """Prepare steps of constant size, the last of which ends at the end; returns how many there are."""
        size = self.size
        count = max(math.ceil((end - start) / size - SLIVER), 1) if end > start else 0
        self.step.set_run(start, end, size, count, self.max_steps - self._earlier_steps, bool(self.users))
        return count

    @property
    def steps(self) -> int:
        """Accepted steps so far."""
        return self._earlier_steps + self.step.steps

    def _check(self, status: int, t: float) -> None:
        if status != OK:
            if status in (SINGULAR, LOCATION_FAILED):
                self._announce(t, None, "singular")
            raise self.step.describe(status, t)

    def _try_step(self, t: float, t_new: float) -> None:
        h = t_new - t
        if abs(h - self.size) <= SLIVER * self.size:
            # not what rounding has made of it
            h = self.size
        status = self.step.try_step(t, h)
        if status == CONTOUR_ENDS:
            raise self._end_of_contour(t, t_new)
        self._check(status, t)

    def _end_of_contour(self, t: float, t_new: float) -> Stop:
        """Step from t to where a contact that cannot open reaches the end of a contour, which it does before t_new."""
        step = self.step
        name = self.system.contacts[step.nearest_end()].name
        inside, outside = t, t_new
        while outside - inside > _EVENT_ACCURACY * (t_new - t):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if step.try_step(t, middle - t) == OK else (inside, middle)
        if inside > t:
            self._try_step(t, inside)
            if self.users:
                self._user_events(t, inside)
            self._report(t, inside)
            step.accept(inside)
            step.steps += 1
        self._announce(inside, name, "edge")
        self.output(inside)
        return step.describe(CONTOUR_ENDS, inside)

    def _report(self, t: float, t_new: float) -> None:
        """What happened to the contacts and joints in the trial step."""
        step, names = self.step, [c.name for c in self.system.contacts]
        found: list[tuple[float, str | None, str, str | None]] = []
        for c, name in enumerate(names):
            before, after = int(step.start_mode[c]), int(self.system.contact_int[c, MODE])
            edge = float(step.edge_time[c])
            if step.touch_time[c] >= 0.0:
                found.append((t + float(step.touch_time[c]), name, "touch", None))
            if edge >= 0.0:
                found.append((t + max(edge, float(step.touch_time[c])), name, "edge", None))
            elif step.touch_time[c] >= 0.0:
                continue
            elif before != FREE and after == FREE:
                found.append((t_new, name, "separate", None))
            elif before == FREE and after != FREE:
                # at rest on what it came over
                found.append((t, name, "touch", None))
            else:
                kinds = map(_friction_event, range(3), step.start_motion[c].tolist(), step.motion[c].tolist())
                found += [(t_new, name, kind, None) for kind in kinds if kind]
        for g, limit in enumerate(self.system.limits):
            when, kind = t_new, _joint_event(int(step.start_joint[g]), int(step.joint_state[g]))
            if kind == "limit" and step.limit_time[g] >= 0.0:
                when = t + float(step.limit_time[g])
            if kind:
                found.append((when, None, kind, limit.joint))
        for when, contact, kind, joint in sorted(found, key=lambda entry: entry[0]):
            self._announce(when, contact, kind, joint=joint)

    def _announce(self, t: float, contact: str | None, kind: str, index: int = -1, joint: str | None = None) -> None:
        self.events.append(Event(t, contact, kind, self.system.q.copy(), self.system.v.copy(), index, joint))

    # ---------------------------------------------------------------- outputs

    @property
    def _next_output(self) -> float:
        return float(self.system.scalars["next_output"])

    def output(self, t: float, asked: bool = False) -> None:
        """Record the state at t, once for every output time that falls on it; asked: torques are set for it."""
        if self.system.counters["record_steps"]:
            self._record(t, asked)
            return
        while self._next_output <= t + SLIVER * self.size:
            self._record(t, asked)
            self.system.output_done()

    def _record(self, t: float, asked: bool) -> None:
        if self.torque is not None and not asked:
            self.torque.ask(t)
            self.system.check_torques(t)
        self.record(t)

    # ---------------------------------------------------------------- users' events

    def _user_events(self, t: float, t_new: float) -> None:
        """Locate the zeros of users' functions in the trial step by shorter ones; a terminal one ends the run.

        Where to look is told by the functions on the straight way from the step's start to its end.
        """
        system, users = self.system, self.users
        nq, nv = system.nq, system.nv
        ends = [(state[:nq].copy(), state[nq : nq + nv].copy()) for state in (system.state, system.stage_state)]
        values = [event.value_at(t_new, system) for event in users]
        found: list[Zero] = []
        looked = False
        for event, after in zip(users, values):
            ends_known = {0.0: event.value, 1.0: after}
            on_the_way = asked_once(partial(self._value_between, event, ends, t, t_new), dict(ends_known))
            samples, _ = event.samples(on_the_way, t, after)
            turns = sum(goes_through(low, high) for (_, low), (_, high) in pairwise(samples))
            if turns == 0:
                continue
            looked = True
            stepped = asked_once(partial(self._value_after, event, t, t_new), ends_known)
            # one zero lies between the ends; of several, those which shorter steps find there, too
            places = [0.0, 1.0] if turns == 1 and event.crosses(event.value, after) else [s for s, _ in samples]
            for low, high in pairwise(places):
                if event.crosses(stepped(low), stepped(high)):
                    place = crossing_between(stepped, low, high, _EVENT_ACCURACY)
                    found.append(Zero(place, event, (stepped(high) - stepped(low)) / (high - low)))
        for zero in sorted(found, key=lambda zero: zero.theta):
            place = zero.theta
            if zero.event.terminal:
                place = zero.behind(1.0, partial(self._value_after, zero.event, t, t_new))
            when = t + place * (t_new - t)
            self._try_step(t, when)
            self._announce(when, None, "user", zero.event.index)
            if zero.event.terminal:
                self._report(t, when)
                self.step.accept(when)
                self.step.steps += 1
                if self.system.counters["record_steps"]:
                    self.output(when)
                raise Stop(TERMINATED, "a terminal event occurred")
        if looked:
            # shorter steps have taken its place
            self._try_step(t, t_new)
        for event, value in zip(users, values):
            event.value = value

    def _value_between(
        self, event: UserEvent, ends: list[tuple[np.ndarray, np.ndarray]], t: float, t_new: float, place: float
    ) -> float:
        (q0, v0), (q1, v1) = ends
        q = pin.interpolate(self.system.model, q0, q1, place)
        return event.value_of(t + place * (t_new - t), q, v0 + place * (v1 - v0), self.system)

    def _value_after(self, event: UserEvent, t: float, t_new: float, place: float) -> float:
        """After a step that is shorter by that factor."""
        when = t + place * (t_new - t)
        self._try_step(t, when)
        return event.value_at(when, self.system)


def _friction_event(motion: int, before: int, after: int) -> str:
    """What happened to a resisted motion in a step, see `impulse_layout.SLIP`; "" for nothing."""
    if before == after or 0 in (before, after):
        return ""
    if motion == SLIP:
        return "stick" if after == STICK else "slip"
    return "hold" if after == STICK else "turn"


def _joint_event(before: int, after: int) -> str:
    """What happened to a limited coordinate in a step, see `impulse_layout.JOINT_MOVES`; "" for nothing."""
    ends = (JOINT_AT_LOW, JOINT_AT_HIGH)
    if before == after:
        return ""
    if after in ends:
        return "limit"
    if after == JOINT_STICKS:
        return "stick"
    if before in ends:
        return "release"
    # from rest, or the other way
    return "slip"
