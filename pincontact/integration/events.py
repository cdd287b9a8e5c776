"""The user's event functions g(t, q, v), and their zeros in a step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..arguments import is_number
from ..errors import ArgumentError, UnusableResult
from .dense import Interpolant
from .runge_kutta import RungeKutta
from .sign_changes import ACCURACY, MOST_LOOKS, Samples, asked_once, crossing_between, resolve, with_double_zeros

if TYPE_CHECKING:
    from .run_system import RunSystem

# Looks at a function in a step that are few, as in all steps once there were too many in one.
_FEW_LOOKS = 512
# A function that gets so near to zero, against its largest value in a step, is looked at more closely.
_NEAR = 0.05
# Zeros this part of a step before or after what happens in it come with that.
_WITH = 1e-9
# Looks for a place behind a zero: a function that only touches zero has none.
_LOOKS_BEHIND = 8
# Values below this part of the largest one so far are zero: the round-off of what is held there has no sign.
_ROUND_OFF = 1e-13


@dataclass
class UserEvent:
    """A user's function g(t, q, v), number index, with SciPy's attributes `terminal` and `direction`, its last value,
    that before what jumps next, its largest one so far, the time of the last zero that was seen and its sign behind
    that, and the start in s of the first step that was too long to find all its zeros."""

    index: int
    function: Callable[[float, np.ndarray, np.ndarray], Any]
    terminal: bool
    direction: float
    value: float = 0.0
    before: float = 0.0
    largest: float = 0.0
    zero_at: float = -math.inf
    sign: float = 0.0
    lost_from: float | None = None

    @staticmethod
    def wrap(events: Any) -> list[UserEvent]:
        """The events given by the user: None, one function or several; ArgumentError for what cannot be called."""
        if events is None:
            return []
        functions = events if isinstance(events, (list, tuple)) else [events]
        wrapped = []
        for i, function in enumerate(functions):
            if not callable(function):
                raise ArgumentError(f"events[{i}] is not callable: {function!r}")
            terminal, direction = getattr(function, "terminal", False), getattr(function, "direction", 0.0)
            # SciPy counts up to a larger number
            if not (terminal is None or (isinstance(terminal, (bool, np.bool_, int)) and terminal in (0, 1))):
                raise ArgumentError(f"events[{i}].terminal must be True or False, got {terminal!r}")
            if not is_number(direction):
                raise ArgumentError(f"events[{i}].direction must be a number, got {direction!r}")
            wrapped.append(UserEvent(i, function, bool(terminal), float(direction)))
        return wrapped

    def value_at(self, t: float, system: RunSystem) -> float:
        """The function at the system's (q, v). Raises what it raises, UnusableResult for what is no number."""
        return self.value_of(t, system.q.copy(), system.v.copy(), system)

    def value_of(self, t: float, q: np.ndarray, v: np.ndarray, system: RunSystem) -> float:
        """The function at q and v, as `value_at`."""
        try:
            result = self.function(t, q, v)
        except BaseException:
            system.blame(f"t = {t:.9g} s: events[{self.index}]")
            raise
        if isinstance(result, (bool, np.bool_)):
            # never negative, it would never be seen to change its sign
            raise UnusableResult(
                f"t = {t:.9g} s: events[{self.index}] returned {result}, not a number that changes its sign"
            )
        try:
            number = float(result)
        except (TypeError, ValueError, OverflowError) as error:
            text = f"t = {t:.9g} s: events[{self.index}] failed with {type(error).__name__}: {error}"
            raise UnusableResult(text) from error
        if math.isnan(number):
            raise UnusableResult(f"t = {t:.9g} s: events[{self.index}] returned nan")
        if math.isfinite(number):
            self.largest = max(self.largest, abs(number))
        # what happens with a zero may happen a little before it: that is no other zero
        seen = t <= self.zero_at and number * self.sign < 0.0
        return 0.0 if seen or abs(number) <= self.round_off else number

    @property
    def round_off(self) -> float:
        """Values that are no larger are zero."""
        return _ROUND_OFF * self.largest

    def crosses(self, before: float, after: float) -> bool:
        """Whether the function goes through zero in its direction from one value to another."""
        return goes_through(before, after) and (self.direction == 0.0 or (after - before) * self.direction > 0.0)

    def samples(self, value: Callable[[float], float], t: float, at_end: float) -> tuple[Samples, bool]:
        """Values in a step that begins at t, at fractions of it, and whether there is one zero at most between them."""
        most = MOST_LOOKS if self.lost_from is None else _FEW_LOOKS
        samples = resolve(value, self.value, at_end, most)
        resolved = len(samples) < most
        if self.lost_from is None and not resolved:
            self.lost_from = t
        return with_double_zeros(value, samples), resolved


def goes_through(before: float, after: float) -> bool:
    """Whether zero is between two values, or where a function comes to."""
    return before < 0.0 <= after or before > 0.0 >= after


class Zero(NamedTuple):
    """A zero of a user's function at the fraction theta of a trial step, and its slope there, about."""

    theta: float
    event: UserEvent
    slope: float

    def behind(self, last: float, value: Callable[[float], float]) -> float:
        """The fraction, from theta up to the last one, of a step that has the zero behind it, so that a run that goes
        on from there does not find it again; value: the function after such a part of the step, which is tried so."""
        theta, further = self.theta, 0.0
        # the step ends here: zeros further on are none
        self.event.zero_at = -math.inf
        for _ in range(_LOOKS_BEHIND):
            there = value(theta)
            if there * self.slope > 0.0 or theta >= last:
                break
            further = max(2.0 * (abs(there) + self.event.round_off) / abs(self.slope), 2.0 * further)
            theta = min(theta + further, last)
        return theta


def lost_zeros(events: Sequence[UserEvent]) -> str:
    """What is to be said of functions that vary too fast for steps."""
    lost = [event for event in events if event.lost_from is not None]
    return "".join(
        f"; events[{event.index}] changes too fast to find all its zeros, from t = {event.lost_from:.9g} s on: a "
        "smaller max_step (or dt) looks closer"
        for event in lost
    )


class UserEvents:
    """Finds the zeros of the user's functions in trial steps."""

    def __init__(self, rk: RungeKutta, functions: Sequence[UserEvent]) -> None:
        self.rk, self.functions = rk, functions
        self._at_end: list[float] = []

    def __bool__(self) -> bool:
        return bool(self.functions)

    def update(self, t: float) -> None:
        """Take the system's state at t as the one that the next zero is measured from."""
        for event in self.functions:
            event.value = event.before = event.value_at(t, self.rk.system)

    def take_back(self, t: float) -> None:
        """Forget zeros after the accepted state at t, of a step that is taken back."""
        for event in self.functions:
            if event.zero_at > t:
                event.zero_at = -math.inf

    def jumped(self, t: float) -> list[UserEvent]:
        """Take the system's state at t as `update` does; those functions that have gone through zero by the jump of
        the state, or of what they are of, that led there."""
        before = [event.before for event in self.functions]
        self.update(t)
        return [event for event, value in zip(self.functions, before) if event.crosses(value, event.value)]

    def passed(self, t: float, since: float, start: np.ndarray) -> list[tuple[float, UserEvent, np.ndarray]]:
        """Take the accepted state at t as `update` does; times, functions and states of their zeros on a straight way
        there from the state `start` at `since` (s), in order: of terminal ones the end."""
        end, before, zeros = self.rk.system.state.copy(), [event.before for event in self.functions], []
        for event in self.jumped(t):
            value = before[event.index]
            part = 1.0 if event.terminal else value / (value - event.value)
            zeros.append((since + part * (t - since), event, start + part * (end - start)))
        return sorted(zeros, key=lambda zero: zero[0])

    def may_cross(self, t: float, step: float) -> bool:
        """Whether any function may go through zero in the trial step, whose end is loaded.

        They are looked at on the cubic that the slopes at both ends give: dense output of its own may take evaluations.
        """
        if not self.functions:
            return False
        self._at_end = [event.value_at(t + step, self.rk.system) for event in self.functions]
        for event in self.functions:
            event.before = event.value
        if self.rk.method.extra == 0:
            return True
        state_at = self.rk.cubic(step)
        found = any(self._comes_near(event, t, step, state_at) for event in self.functions)
        self.rk.load(self.rk.system.new_state)
        return found

    def crossings(self, t: float, step: float, until: float, dense: Interpolant) -> list[Zero]:
        """All zeros in the trial step before the fraction `until` in order; after `may_cross`."""
        found = []
        for event in self.functions:
            value = self._in_step(event, t, step, dense)
            samples, resolved = event.samples(value, t, self._at_end[event.index])
            for (low, before), (high, after) in pairwise(samples):
                if low >= until:
                    break
                if not goes_through(before, after):
                    event.before = (after if high <= until else value(until)) or event.before
                    continue
                # what is too fast to be seen is not looked for more closely
                zero = crossing_between(value, low, high, ACCURACY) if resolved else high
                if zero > until + _WITH:
                    event.before = before
                    break
                event.zero_at, event.sign = t + zero * step, math.copysign(1.0, after - before)
                # what comes to zero with what happens there has no sign before that
                event.before = after if zero < until - _WITH else 0.0
                if event.crosses(before, after):
                    found.append(Zero(min(zero, until), event, (after - before) / (high - low)))
        return sorted(found, key=lambda zero: zero.theta)

    def _comes_near(self, event: UserEvent, t: float, step: float, state_at: Callable[[float], np.ndarray]) -> bool:
        """Whether a function changes its sign in the step, or comes near to zero, or where few looks do not tell."""
        value = self._in_step(event, t, step, state_at)
        samples = resolve(value, event.value, self._at_end[event.index], _FEW_LOOKS)
        if len(samples) >= _FEW_LOOKS:
            return True
        samples = with_double_zeros(value, samples)
        sizes = [abs(size) for _, size in samples]
        turns = any(before * after <= 0.0 for (_, before), (_, after) in pairwise(samples))
        return turns or min(sizes) < _NEAR * max(sizes)

    def _in_step(
        self, event: UserEvent, t: float, step: float, state_at: Callable[[float], np.ndarray]
    ) -> Callable[[float], float]:
        """A function of fractions of a step."""

        def value(theta: float) -> float:
            self.rk.load(state_at(theta))
            return event.value_at(t + theta * step, self.rk.system)

        return asked_once(value, {0.0: event.value, 1.0: self._at_end[event.index]})
