"""Where in a step something happens: sign changes of margins and of the user's functions, found on the dense output
and refined with true steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arguments import is_number
from ..errors import ArgumentError, UnusableResult
from ..layout import DOMAIN, DOMAIN_MARGIN, GAP_MARGIN, LENGTH, NOTHING_THERE, OK, SCAN_ROOM, SPEED_MARGIN
from .dense import Interpolant
from .open_contacts import OpenContacts
from .results import GAP_TOLERANCE
from .runge_kutta import RungeKutta
from .sign_changes import Samples, resolve, vertex, with_dips, zero_between

if TYPE_CHECKING:
    from .run_system import RunSystem

# Samples of the dense output between which a margin's sign change is looked for, all those of one scan: irregular, lest
# they all be zeros of a sine.
_PLACES = (0.0, 0.1137, 0.2419, 0.3871, 0.5093, 0.6361, 0.7493, 0.8829, 1.0)
assert len(_PLACES) == SCAN_ROOM
# Steps that refine an event's time, and the change of time (relative to the step) that ends them.
_REFINEMENTS = 8
_REFINED = 1e-14
_BISECTIONS = 40
# Looks for what crosses before the first crossing that was found, beyond one for each margin.
_ROUNDS = 4
# Looks at the lowest point between two samples.
_LOOKS = 3
# A margin that is this part of its largest size away from zero wherever steps went to make it zero has no zero there.
_NEXT_TO_NOTHING = 1e-6
# Speeds below this, against 1 or the largest velocity, have no sign.
_SPEED_ROUND_OFF = 1e-15
# A user's function that gets so near to zero, against its largest value in a step, is looked at more closely.
_NEAR = 0.05
# Zeros of margins and of users' functions, as a part of the step.
_ACCURACY = 1e-15


@dataclass
class UserEvent:
    """A user's function g(t, q, v), number index, with SciPy's attributes `terminal` and `direction`, and its last
    value."""

    index: int
    function: Callable[[float, np.ndarray, np.ndarray], Any]
    terminal: bool
    direction: float
    value: float = 0.0

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
            if not (terminal is None or isinstance(terminal, (bool, np.bool_, int))):
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
        try:
            number = float(result)
        except (TypeError, ValueError, OverflowError) as error:
            text = f"t = {t:.9g} s: events[{self.index}] failed with {type(error).__name__}: {error}"
            raise UnusableResult(text) from error
        if math.isnan(number):
            raise UnusableResult(f"t = {t:.9g} s: events[{self.index}] returned nan")
        return number

    def crosses(self, before: float, after: float) -> bool:
        """Whether the function goes through zero in its direction from one value to another."""
        rises, falls = before < 0.0 <= after, before > 0.0 >= after
        return (rises and self.direction >= 0.0) or (falls and self.direction <= 0.0)


@dataclass(frozen=True)
class Crossing:
    """A sign change at a fraction theta of the step: of margin (contact, kind), or of the user's event number."""

    theta: float
    margin: tuple[int, int] | None = None
    user: int = -1


class EventLocator:
    """Finds crossings in the step that its integrator has attempted.

    depths: (items,) how much deeper in m than gaps are known open contacts may be; others change it. open_contacts:
    which contacts may touch; is told whose gaps fall through zero beyond an end of a contour.
    """

    def __init__(
        self, rk: RungeKutta, users: Sequence[UserEvent], depths: np.ndarray, open_contacts: OpenContacts
    ) -> None:
        self.rk, self.users, self._depths, self._open = rk, users, depths, open_contacts
        self._at_end: list[float] = []

    @cached_property
    def _slack(self) -> np.ndarray:
        """(items, MARGINS_PER_CONTACT) what margins may be below zero; of gaps as `_take_slack` has found it."""
        slack = np.zeros_like(self.rk.system.margins[: self.rk.system.items])
        # both ends of a joint coordinate
        nc = self.rk.system.nc
        slack[nc:, DOMAIN_MARGIN] = self._gap_slack[nc:]
        return slack

    def _take_slack(self) -> None:
        self._slack[:, GAP_MARGIN] = self._gap_slack + self._depths
        self._slack[:, SPEED_MARGIN] = _SPEED_ROUND_OFF * (1.0 + float(np.abs(self.rk.system.v).max(initial=0.0)))

    @cached_property
    def _gap_slack(self) -> np.ndarray:
        """(items,) what gaps are known to, in m."""
        system = self.rk.system
        # guarded joint coordinates follow the contacts; theirs are of unit size
        lengths = np.ones(system.items)
        lengths[: system.nc] = system.contact_real[: system.nc, LENGTH]
        return GAP_TOLERANCE * (system.scale[1] + system.scale[0] * lengths)

    def value_of_user(self, index: int, t: float) -> float:
        """The user's function at the system's (q, v)."""
        return self.users[index].value_at(t, self.rk.system)

    def users_cross(self, t: float, step: float) -> bool:
        """Whether any of the users' functions may go through zero in the attempted step, whose end is loaded.

        They are looked at on the cubic that the slopes at both ends give: dense output of its own may take evaluations.
        """
        if not self.users:
            return False
        self._at_end = [self.value_of_user(i, t + step) for i in range(len(self.users))]
        if self.rk.method.extra == 0:
            return True
        state_at = self.rk.cubic(step)
        found = False
        for i in range(len(self.users)):
            samples = self._samples(i, self._user(i, t, step, state_at))
            sizes = [abs(value) for _, value in samples]
            turns = any(before * after <= 0.0 for (_, before), (_, after) in pairwise(samples))
            if turns or min(sizes) < _NEAR * max(sizes):
                found = True
                break
        self.rk.load(self.rk.system.new_state)
        return found

    def user_crossings(self, t: float, step: float, dense: Interpolant) -> list[Crossing]:
        """All zeros of the users' functions in the attempted step, in order; after `users_cross`."""
        found = []
        for i, event in enumerate(self.users):
            value = self._user(i, t, step, dense)
            samples = self._samples(i, value)
            for (low, before), (high, after) in pairwise(samples):
                if event.crosses(before, after):
                    at_end = after == 0.0 or math.isinf(before) or math.isinf(after)
                    root = high if at_end else zero_between(value, low, high, _ACCURACY)
                    found.append(Crossing(root, None, i))
        return sorted(found, key=lambda crossing: crossing.theta)

    def _user(
        self, index: int, t: float, step: float, state_at: Callable[[float], np.ndarray]
    ) -> Callable[[float], float]:
        """User's function number index of fractions of a step, asked once for each: one that answers otherwise the next
        time (noise) has no root to be found."""
        known = {0.0: self.users[index].value, 1.0: self._at_end[index]}

        def value(theta: float) -> float:
            if theta not in known:
                self.rk.load(state_at(theta))
                known[theta] = self.value_of_user(index, t + theta * step)
            return known[theta]

        return value

    def _samples(self, index: int, value: Callable[[float], float]) -> Samples:
        return with_dips(value, resolve(value, self.users[index].value, self._at_end[index]))

    def update_users(self, t: float) -> None:
        """Take the system's state at t as the one that the next crossing is measured from."""
        for i, event in enumerate(self.users):
            event.value = self.value_of_user(i, t)

    def first(self, t: float, step: float) -> Crossing | None:
        """Earliest crossing of a margin in the step that was interpolated last; None where the alarm was false."""
        self._take_slack()
        return self._first_margin(t, step)

    def _margins(self, t: float, step: float, thetas: Sequence[float]) -> np.ndarray:
        """Margins (n, items, MARGINS_PER_CONTACT) at fractions of the step that was interpolated last, less what gaps
        are known to; there are fewer than fractions where one of them cannot be evaluated: those before it."""
        known, found = self.rk.system.scan(t, step, thetas)
        return (found[: known.index(False)] if False in known else found) + self._slack

    def _first_margin(self, t: float, step: float) -> Crossing | None:
        thetas, samples = self._with_lowest(t, step, list(_PLACES), self._margins(t, step, _PLACES))
        before, after = samples[:-1], samples[1:]
        crosses = (after < 0.0) & (before >= 0.0)
        # what is negative at the start counts as just having crossed
        crosses[:1] |= after[:1] < 0.0
        crosses &= before != NOTHING_THERE
        # what has begun to slide by round-off in the other direction, and comes back, does not come to rest
        crosses[:, :, SPEED_MARGIN] &= (before[:, :, SPEED_MARGIN] >= 0.0) | (
            after[:, :, SPEED_MARGIN] < before[:, :, SPEED_MARGIN]
        )
        gaps, later = before[:, :, GAP_MARGIN], after[:, :, GAP_MARGIN]
        nc = self.rk.system.nc
        # a joint that starts beyond its end, and comes back, does not meet it; nor does what comes from behind touch
        crosses[:, nc:, GAP_MARGIN] &= (gaps[:, nc:] >= 0.0) | (later[:, nc:] < gaps[:, nc:])
        crosses[:1, :nc, GAP_MARGIN] &= (gaps[:1, :nc] >= 0.0) | self._open.apart
        for i in np.flatnonzero(crosses.any(axis=(1, 2))):
            left, right = (thetas[i], before[i]), (thetas[i + 1], after[i])
            crossed = [margin for margin in np.argwhere(crosses[i]) if self._is_there(t, step, margin, left, right)]
            if crossed:
                return self._earliest(t, step, np.array(crossed), left, right)
        return None

    def _is_there(
        self,
        t: float,
        step: float,
        margin: np.ndarray,
        left: tuple[float, np.ndarray],
        right: tuple[float, np.ndarray],
    ) -> bool:
        """Whether a margin that turns negative between two samples ends a mode: a gap does between points inside both
        domains only."""
        c, kind = (int(x) for x in margin)
        if kind != GAP_MARGIN or c >= self.rk.system.nc:
            return True
        theta = self._root(t, step, (c, kind), (left[0], left[1][c, kind]), (right[0], right[1][c, kind]))
        known = len(self._margins(t, step, [theta])) > 0
        if known and self._open.are_apart(c, t + theta * step):
            # where it is followed is not where it is nearest
            return False
        inside = bool(known and self.rk.system.contact_real[c, DOMAIN] >= 0.0)
        if not inside:
            self._open.passed.add(c)
        return inside

    def _earliest(
        self,
        t: float,
        step: float,
        crossed: np.ndarray,
        left: tuple[float, np.ndarray],
        right: tuple[float, np.ndarray],
    ) -> Crossing:
        """First of the margins `crossed` (n, 2) that turn negative between two samples (theta, margins).

        The root of one is the next sample, at which most others are seen to cross later, and some to have been negative
        in between.
        """
        low, before = left
        high, after = right
        found: Crossing | None = None
        for _ in range(crossed.shape[0] + _ROUNDS):
            ends = before[crossed[:, 0], crossed[:, 1]], after[crossed[:, 0], crossed[:, 1]]
            # the one that is first on straight lines; what is infinite or zero at both ends counts as last
            with np.errstate(invalid="ignore", divide="ignore"):
                places = np.nan_to_num(ends[0] / (ends[0] - ends[1]), nan=1.0, posinf=1.0)
            c, kind = (int(x) for x in crossed[int(np.argmin(places))])
            theta = self._root(t, step, (c, kind), (low, before[c, kind]), (high, after[c, kind]))
            if found is not None and theta >= found.theta:
                break
            found, high = Crossing(theta, (c, kind)), theta
            margins = self._margins(t, step, [theta])
            if not len(margins):
                break
            after = margins[0]
            candidates = (after < 0.0) & (before > 0.0) & (before != NOTHING_THERE)
            candidates[c, kind] = False
            candidates[list(self._open.passed), GAP_MARGIN] = False
            crossed = np.argwhere(candidates)
            if not crossed.size:
                break
        assert found is not None
        return found

    def _with_lowest(
        self, t: float, step: float, thetas: list[float], samples: np.ndarray
    ) -> tuple[list[float], np.ndarray]:
        """Places and samples with the lowest points of margins that dip between them, if they are negative there."""
        left, middle, right = samples[:-2], samples[1:-1], samples[2:]
        higher = np.maximum(left, right)
        # a parabola's valley is no deeper than half the change between samples; infinite margins compare
        valleys = (middle >= 0.0) & (middle <= left) & (middle <= right) & (middle < higher)
        valleys &= 1.5 * middle < 0.5 * higher
        # one that lies between the first two samples, or the last two, has its lowest one at an end of the step
        for i, end in ((0, left), (-1, right)):
            valleys[i] |= (end[i] >= 0.0) & (end[i] < middle[i]) & (1.5 * end[i] < 0.5 * higher[i])
        found: dict[float, np.ndarray] = {}
        for i, c, kind in np.argwhere(valleys).tolist():
            points = [(thetas[k], float(samples[k, c, kind])) for k in (i, i + 1, i + 2)]
            for _ in range(_LOOKS):
                theta = vertex(points)
                values = self._margins(t, step, [theta]) if theta is not None else samples[:0]
                if theta is None or not len(values):
                    break
                if values[0][c, kind] < 0.0:
                    found[theta] = values[0]
                    break
                points = sorted(points, key=lambda point: point[1])[:2]
                points = sorted([*points, (theta, float(values[0][c, kind]))])
        if not found:
            return thetas, samples
        order = sorted([*zip(thetas, samples), *found.items()], key=lambda place: place[0])
        return [theta for theta, _ in order], np.array([values for _, values in order])

    def _root(
        self,
        t: float,
        step: float,
        margin: tuple[int, int],
        left: tuple[float, float],
        right: tuple[float, float],
    ) -> float:
        """Where a margin turns negative between two samples (theta, value)."""
        (low, at_low), (high, _) = left, right
        # asked once for each time: a control that answers otherwise the next time (noise) has no root to be found
        known = dict([left, right])

        def value(theta: float) -> float:
            if theta not in known:
                margins = self._margins(t, step, [theta])
                known[theta] = float(margins[0][margin]) if len(margins) else -1.0
            return known[theta]

        if at_low <= 0.0:
            # the mode was entered on its boundary: look for the part where it holds first
            probe = high
            for _ in range(_BISECTIONS):
                probe = low + 0.5 * (probe - low)
                if value(probe) > 0.0:
                    low = probe
                    break
            else:
                return low
        return zero_between(value, low, high, _ACCURACY)

    def refine(self, t: float, step: float, crossing: Crossing) -> tuple[float, bool]:
        """Attempt steps to the crossing, with secants on the true margin there; returns the last one's size, and
        whether there is a crossing: at loose tolerances the dense output may dip where the motion does not.

        The state that the attempt leaves is of the method's full order; only where to stop came from the dense output.
        """
        h = crossing.theta * step
        if crossing.margin is None:
            self.rk.attempt(t, h)
            return h, True
        back = max(h - 1e-4 * step, 0.5 * h)
        self._take_slack()
        ends = self._margins(t, step, [back / step, h / step])
        if len(ends) < 2:
            self.rk.attempt(t, h)
            return h, True
        slope = float(ends[1][crossing.margin] - ends[0][crossing.margin]) / (h - back)
        c, kind = crossing.margin
        depth = float(self._depths[c]) if kind == GAP_MARGIN else 0.0
        before: tuple[float, float] | None = None
        denied, value = True, 0.0
        for _ in range(_REFINEMENTS):
            if self.rk.attempt(t, h) != OK:
                return h, True
            value = float(self.rk.system.margins[c, kind]) + depth
            if before is not None and before[0] != h:
                slope = (value - before[1]) / (h - before[0])
            before = h, value
            denied = denied and value > self._round_off(c, kind)
            change = -value / slope if slope != 0.0 else 0.0
            if abs(change) <= _REFINED * step or not 0.0 < h + change <= 1.1 * step:
                break
            h += change
        else:
            self.rk.attempt(t, h)
        if denied or value < -self._round_off(c, kind):
            # outputs were written up to there; a margin that jumps has no zero for secants
            h = crossing.theta * step
            self.rk.attempt(t, h)
        return h, not denied

    def _round_off(self, c: int, kind: int) -> float:
        """What is next to nothing in a margin, against its sizes in the last attempt."""
        system = self.rk.system
        return _NEXT_TO_NOTHING * max(abs(float(system.lowest[c, kind])), abs(float(system.highest[c, kind])))
