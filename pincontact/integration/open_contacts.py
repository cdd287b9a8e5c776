"""Open contacts: how far a step may go before they could touch, the nearest points at which they would, and on which
side of each other their bodies are; and closed ones, whose bodies may touch at another point."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..errors import SingularContactError
from ..geometry.carriers import ORIGIN
from ..geometry.location import NO_CLOSED_FORM, POINT_ON_SPHERE, SPHERE_ON_SPHERE
from ..geometry.nearest import crosses_anywhere, is_searched
from ..geometry.patterns import CROSSING_CURVES
from ..geometry.search import find_candidates, on_side
from ..geometry.sides import Beside, crossings_apart, side_of_crossing
from ..geometry.single_touch import touches_once
from ..layout import (
    BENDING,
    BESIDE,
    BRANCH,
    CHART,
    CLOSED_FORM,
    DETERMINANT_SIGN,
    DOMAIN,
    FREE,
    LAST_NORMAL_X,
    LENGTH,
    NEXT_NORMAL_X,
    NOTHING_THERE,
    PATTERN,
    SAME_PLACE,
    SIDE,
    SPEEDING,
    UNILATERAL,
)
from .accuracy import APART_AT_END, LEAPS, SHALLOW, gap_rate, rest_speed
from .approach import SAFETY, time_to_cover
from .contradictions import touch_elsewhere
from .nearness import TOO_FAR, Drives, Nearness, Place, of_same_contours, touching_order
from .results import FLIES_THROUGH, TOUCHES_AROUND, TOUCHES_TWICE, TOUCHES_UNSEEN
from .stages import load_state
from .steps import BOUND_SPEEDS

if TYPE_CHECKING:
    from ..geometry.search import Candidate
    from .run_system import RunSystem

# How far bodies may turn within a step where they are near, in rad: gaps are then seen wherever they may be negative.
_TURN = 2.0
# How far inside a stationary pair of points may be, as a multiple of how far bodies went since they were apart: where
# one enters beside it, farther.
_DEEPER = 4.0
# Part of how far curves that cross are apart where they are not followed that they may move before that is known anew.
_FRESH = 0.5
# Constant steps are looked at beside closed contacts after bodies have moved this part of how far they may near others.
_LATE = 0.05
# Constant steps between two looks, at most.
MANY_STEPS = 1_000_000
# Places on the way of a step that went far, and how deep, relative to the contact's length, it may have grazed there.
_WAY_STATIONS, _GRAZES = 16, 1e-2


class OpenContacts:
    """What is known between its steps of a system's contacts that may touch anywhere: of open ones, and beside closed
    ones. Contacts of the same contours are at different places: where one of them is, no other one is looked for.

    apart: (nc,) whether a contact touches when its gap comes down through zero: since its bodies have been apart.
    trouble, where: why `look` has found that steps cannot go on, and at which contact.
    relocated: contacts that were found to be nearest, or on a side, elsewhere; others take that down, and clear it.
    passed: contacts that came into a domain from behind in the last step, or whose gap fell through zero unseen.
    overlapping: contacts that came into a domain in the last step while their bodies overlapped.
    """

    def __init__(self, system: RunSystem) -> None:
        self.system = system
        self.apart = np.ones(system.nc, dtype=bool)
        self.passed: set[int] = set()
        self.overlapping: set[int] = set()
        # those that were inside at the start, and have not come out since
        self._shallow: set[int] = set()
        # open contacts, and what is beside closed ones
        self._known: dict[tuple[int, bool], Nearness] = {}
        # closed contacts whose bodies may touch elsewhere are among these
        self._searched = [c for c in range(system.nc) if system.contact_int[c, UNILATERAL] and is_searched(system, c)]
        self._drives = Drives()
        self._speeds: dict[int, float] = {}
        self._allowed: dict[int, float] = {}
        self._cut = math.inf
        # states from which a step went far for what is near, and how far, in m, by contact
        self._far: dict[int, tuple[np.ndarray, float]] = {}
        self.trouble, self.where = FLIES_THROUGH, 0
        self.relocated: set[int] = set()
        self.is_near = False
        self._watched: list[Nearness] = []
        # contacts that are beside ends, what is seen of those, and for how long in s that holds for all
        self._ending: list[int] = []
        self._hold = math.inf
        self._beside: dict[int, Beside] = {}
        self._two_sided: dict[int, bool] = {}
        self._free: list[bool] | None = None if self._searched else [False] * system.nc
        self._gravity = math.hypot(*system.gravity.tolist())
        self._absolute = system.absolute.copy()

    # ---------------------------------------------------------------- sides

    def begin(self, slack: Callable[[int], float]) -> None:
        """The evaluated state is that at which a run starts; slack: what its gap may be below zero, in m."""
        system = self.system
        for c in self._list():
            allowed = APART_AT_END if gap_rate(system, c) > rest_speed(system) else SHALLOW
            allowed *= system.contact_real[c, LENGTH]
            if system.contact_real[c, DOMAIN] < 0.0:
                allowed = 0.0
            self.apart[c] = system.gaps[c, 0] >= -max(slack(c), allowed)
            if system.gaps[c, 0] < 0.0 and self.apart[c]:
                self._shallow.add(c)

    def note(self, slack: Callable[[int], float] | None) -> None:
        """The evaluated state has been accepted. slack: as `begin` has it, None where events were looked for in the
        step that led there."""
        system = self.system
        for c, mode in enumerate(system.modes.tolist()):
            gap = system.gaps.item(c, 0)
            if mode != FREE or 0.0 <= gap < NOTHING_THERE:
                self.apart[c] = True
                self._shallow.discard(c)
            elif c in self.passed or (slack is not None and gap < -slack(c)):
                self.apart[c] = False
        self.passed.clear()
        self.overlapping.clear()

    def _list(self) -> list[int]:
        unilateral = self.system.contact_int[:, UNILATERAL]
        return [c for c, mode in enumerate(self.system.modes.tolist()) if mode == FREE and unilateral[c]]

    def watch_ends(self, t: float, h: float) -> None:
        """Have contacts that are beside ends, at the accepted state, which is evaluated, on the sides on which their
        bodies are, where these are not given, and near where these are nearest, if that may not hold for h. They are
        beside until bodies are over each other, or have touched."""
        system, integers = self.system, self.system.contact_int[: self.system.nc]
        numbers, crosses = system.contact_real[: system.nc], integers[:, PATTERN] == CROSSING_CURVES
        # what comes over an end again may do so on the other side; curves cross beside their ends in any step
        may_turn = (integers[:, BESIDE] == 0) & (crosses | (numbers[:, DOMAIN] < 0.0))
        for c in np.flatnonzero(may_turn & (integers[:, UNILATERAL] != 0) & (system.modes == FREE)).tolist():
            integers[c, BESIDE] = self._takes_sides(c)
        self._ending, self._hold = self.at_ends(), math.inf
        apart = system.gaps[: system.nc, 0] > SAME_PLACE * numbers[:, LENGTH]
        apart |= self.apart & (numbers[:, DOMAIN] >= 0.0)
        for c in self._ending:
            if crosses[c]:
                self._hold = min(self._hold, h)
                if not apart[c]:
                    self._cross(c)
                continue
            holds = self._side_holds(t, c) if c in self._beside else 0.0
            if holds < h:
                beside = self._seen(c)
                integers[c, BESIDE] = not beside.look(t)
                turns = beside.is_turned()
                if turns or beside.is_far():
                    self._move(t, c, beside.side if turns else integers.item(c, SIDE), beside.nearest)
                holds = self._side_holds(t, c)
            self._hold = min(self._hold, holds)

    def _takes_sides(self, c: int) -> bool:
        """Whether contact c is on the side on which its body comes over a piece, as none of its sides is given."""
        if c not in self._two_sided:
            takes = Beside.is_seen(self.system, c) or self.system.contact_int[c, PATTERN] == CROSSING_CURVES
            self._two_sided[c] = bool(takes) and self.system.contacts[c].side is None
        return self._two_sided[c]

    def crosses(self, c: int) -> bool:
        """Whether contact c is of crossing curves that are open, and on no given side."""
        return bool(self.system.contact_int[c, PATTERN] == CROSSING_CURVES and self.system.contact_int[c, BESIDE])

    def _cross(self, c: int) -> None:
        """Have crossing curves that are beside each other's ends, or have come in from there on the far side, on the
        side on which they are apart."""
        numbers, side = self.system.contact_real[c], side_of_crossing(self.system, c)
        if side not in (0, self.system.contact_int[c, SIDE]):
            self.system.contact_int[c, SIDE] = side
            for normal in (LAST_NORMAL_X, NEXT_NORMAL_X):
                numbers[normal : normal + 3] *= -1.0
            self.relocated.add(c)

    def at_ends(self) -> list[int]:
        """Contacts whose bodies have not been over each other yet."""
        beside: list[int] = np.flatnonzero(self.system.contact_int[: self.system.nc, BESIDE]).tolist()
        return beside

    def _seen(self, c: int) -> Beside:
        if c not in self._beside:
            self._beside[c] = Beside(self.system, c)
        return self._beside[c]

    def _side_holds(self, t: float, c: int) -> float:
        """For how long in s from t what was seen of contact c, which is beside an end, holds."""
        beside, acceleration = self._beside[c], SAFETY * max(self._gravity, self.system.contact_real.item(c, SPEEDING))
        return time_to_cover(beside.left(t), beside.speed(), acceleration + SAFETY * beside.bending)

    def _move(self, t: float, c: int, side: int, end: np.ndarray) -> None:
        """Have contact c on this side, near an end, see `find_candidates`."""
        system, single = self.system, self.system.alone(c)
        turns = side != system.contact_int[c, SIDE]
        system.contact_int[c, SIDE] = single.contact_int[0, SIDE] = side
        single.q[:], single.v[:] = system.q, system.v
        single.evaluate_kinematics(t)
        try:
            found = find_candidates(single, t, np.full(4, np.nan), end=end)
        except SingularContactError:
            found = []
        if found:
            place = on_side(found, side)[0]
            self._put(c, (place.location, place.branch, place.determinant_sign, place.charts))
        self.relocated.add(c)
        if turns:
            # what was known is of the side that was left
            for i in (c, *of_same_contours(system, c)):
                for is_open in (True, False):
                    self._known.pop((i, is_open), None)
            self._begin_watch(t, [mode == FREE for mode in system.modes.tolist()])

    # ---------------------------------------------------------------- steps

    def begin_step(self, t: float, h: float) -> tuple[float, bool]:
        """The longest step in s from the accepted state, which is evaluated, of those up to h; and whether anything
        may touch in it. Raises Stop where bodies are inside each other beside a closed contact."""
        system = self.system
        system.run(BOUND_SPEEDS)
        self._allowed.clear()
        longest, near = math.inf, False
        for known in self._watched:
            c = known.c
            speed, turning = known.speed(system)
            drive, follows = known.driven(self.system, t, h)
            speed += drive
            self._speeds[c] = speed
            acceleration = SAFETY * max(self._gravity, system.contact_real.item(c, SPEEDING))
            acceleration += system.contact_real.item(c, BENDING)
            distance = self._distance(known, t)
            if known.search is not None and h > time_to_cover(distance, speed, acceleration):
                moved = known.moved(t)
                if moved > 0.0 and (distance >= known.near or moved + known.near > known.elsewhere):
                    self._search(t, known)
                    distance = self._distance(known, t)
            known.set_out()
            self._allowed[c] = allowed = self._allow(t, known, distance)
            free = time_to_cover(distance, speed, acceleration)
            limit = time_to_cover(allowed, speed, acceleration)
            if h > free:
                near = True
                limit = min(limit, max(follows, free))
                if turning > 0.0 and known.whole is not None and known.whole.extent > 0.0:
                    limit = min(limit, max(_TURN / turning, free))
            longest = min(longest, limit)
        longest, self._cut = min(longest, self._hold, self._cut), math.inf
        self.is_near = near
        return longest, near

    def _allow(self, t: float, known: Nearness, distance: float) -> float:
        """How far in m bodies may move in the next step, which are this far apart. Curves that cross go through each
        other unseen where they are not followed: there they come no nearer than they are. Raises Stop where they
        touch there."""
        if not known.crosses:
            return max(distance, known.near)
        if not known.moved(t) < _FRESH * known.beside:
            self._search(t, known)
            distance = self._distance(known, t)
        beside = known.beside - known.moved(t)
        if beside <= float(self.system.gap_accuracy[known.c]):
            raise touch_elsewhere(t, known.contact.name)
        return max(distance, min(known.near, beside)) if known.is_open else beside

    def _search(self, t: float, known: Nearness) -> None:
        """Look for nearest points at the accepted state, which is evaluated."""
        if known.is_open:
            # of places that touch at the same time, as far as gaps are known, first that which is approached fastest
            slack, speed = float(self.system.gap_accuracy[known.c]), self._speeds[known.c]
            self.find(t, known.c, h=slack / speed if speed > 0.0 else 0.0, slack=slack)
            self._refuse_around(t, known)
        elif known.enters(t) is not None:
            raise touch_elsewhere(t, known.contact.name)

    @staticmethod
    def _refuse_around(t: float, known: Nearness) -> None:
        if known.touches_around:
            raise touch_elsewhere(t, known.contact.name, TOUCHES_AROUND)

    def watches(self) -> bool:
        """Whether constant steps have to be looked at: whether any contact may be elsewhere, or be flown through."""
        integers = self.system.contact_int[: self.system.nc]
        balls = np.isin(integers[:, CLOSED_FORM], (POINT_ON_SPHERE, SPHERE_ON_SPHERE))
        searched = np.array([is_searched(self.system, c) for c in range(self.system.nc)], dtype=bool)
        return bool(((integers[:, UNILATERAL] != 0) & (balls | searched)).any())

    def look(self, t: float, h: float, touched: np.ndarray) -> int:
        """How many steps of size h from the accepted state at t, which is evaluated, may go before the next look; zero
        where one may go through what is there, or the last one did. touched: (nc,) which contacts touched in that."""
        if self._went_through(t, h, touched):
            return 0
        self.system.run(BOUND_SPEEDS)
        steps = max(int(min(self._hold / h, MANY_STEPS)), 1)
        for known in self._watched:
            if math.isinf(known.near):
                continue
            c = known.c
            speed, _ = known.speed(self.system)
            speed += known.driven(self.system, t, h)[0]
            acceleration, distance = SAFETY * self._gravity, self._distance(known, t)
            way = speed * h + 0.5 * acceleration * h * h
            if not known.is_open:
                late = 0.0 if known.crosses else _LATE * known.near
                if known.moved(t) + way > max(known.distance, late) and self._touches_twice(t, known):
                    return 0
                # near is what that has just found
                certain = max(known.distance - known.moved(t), late)
                steps = min(steps, max(int(min(time_to_cover(certain, speed, acceleration) / h, MANY_STEPS)), 1))
                continue
            if known.search is not None and way > distance:
                lost = self.system.gaps[c, 0] >= NOTHING_THERE or not self.apart[c]
                # what is where it is followed may not go through it, either
                if lost or known.moved(t) + way > known.elsewhere or way > known.through:
                    # what steps end with is before the last correction of gaps
                    self.system.evaluate_kinematics(t)
                    found = self.find(t, c, way, h)
                    if known.touches_around:
                        self.trouble, self.where = TOUCHES_AROUND, c
                        return 0
                    if found is not None:
                        # it has not been elsewhere longer than in the last step
                        self.apart[c] = found.gap > -_DEEPER * way
                distance = self._distance(known, t)
            # what is behind a contour goes through it
            if self.apart[c] and way > max(distance, known.through):
                self.trouble, self.where = FLIES_THROUGH, c
                return 0
            if self.apart[c] and way > max(distance, known.near):
                # so far that the parabola of the gap may not tell
                self._far[c] = self.system.state.copy(), way
            certain = distance if known.search is None else known.elsewhere - known.moved(t)
            steps = min(steps, max(int(min(time_to_cover(max(certain, 0.0), speed, acceleration) / h, MANY_STEPS)), 1))
        return steps

    def _touches_twice(self, t: float, known: Nearness) -> bool:
        """Whether bodies are inside each other beside a closed contact; that is why steps cannot go on then."""
        # what steps end with is before the last correction of gaps
        self.system.evaluate_kinematics(t)
        touches = known.enters(t) is not None
        if touches:
            self.trouble, self.where = TOUCHES_TWICE, known.c
        return touches

    def goes_wrong(self, t: float, h: float, touched: np.ndarray) -> bool:
        """Whether the last step, which is long, carried bodies through each other, or inside each other."""
        if self._went_through(t, h, touched):
            return True
        # what has closed in that step is watched, too
        self.are_any(t)
        beside = (known for known in self._watched if not known.is_open and known.moved(t) > known.distance)
        return any(self._touches_twice(t, known) for known in beside)

    def forget_way(self) -> None:
        """No step has led to the state from which the next one goes."""
        self._far.clear()

    def _went_through(self, t: float, h: float, touched: np.ndarray) -> bool:
        """Whether an open contact that did not touch has been closed on the straight way of the last step, which was
        long."""
        far, self._far = self._far, {}
        system, nq = self.system, self.system.nq
        far = {c: there for c, there in far.items() if system.modes[c] == FREE and not touched[c]}
        if not far:
            return False
        end, through = system.state.copy(), False
        for c, (before, way) in far.items():
            start = math.nan
            for part in (i / _WAY_STATIONS for i in range(_WAY_STATIONS + 1)):
                system.stage_state[:] = before + part * (end - before)
                system.stage_state[:nq] = pin.interpolate(system.model, before[:nq], end[:nq], part)
                load_state(system.address)
                system.evaluate_kinematics(t - (1.0 - part) * h)
                gap, inside = system.gaps[c, 0], system.contact_real[c, DOMAIN] >= 0.0
                start = gap if part == 0.0 else start
                # elsewhere, where it was not followed to, gaps tell nothing
                if inside and abs(gap - start) <= way and gap < -_GRAZES * system.contact_real[c, LENGTH]:
                    self.trouble, self.where, through = FLIES_THROUGH, c, True
        system.stage_state[:] = end
        load_state(system.address)
        system.evaluate_kinematics(t)
        return through

    def _nearness(self, c: int, t: float) -> Nearness:
        key, system = (c, bool(self.system.modes[c] == FREE)), self.system
        if key not in self._known:
            others = (known for known in self._known.values() if known.has_the_bodies_of(c))
            self._known[key] = Nearness(system, c, t, self._drives, next((known.search for known in others), None))
        return self._known[key]

    def _distance(self, known: Nearness, t: float) -> float:
        """How far bodies are apart, at least, in m; zero where that is not known."""
        system, c = self.system, known.c
        if known.search is not None:
            return max(known.distance - known.moved(t), 0.0)
        if system.contact_real[c, DOMAIN] < 0.0 and system.gaps[c, 0] >= NOTHING_THERE:
            return 0.0
        return max(abs(float(system.gaps[c, 0])), 0.0)

    def may_stand(self, t: float, step: float) -> bool:
        """Whether the trial step to the state at t, which is evaluated, went no further than it was to, and past
        nothing; where it did not, the next one is shorter. Raises Stop where bodies touch beside a closed contact."""
        system = self.system
        system.run(BOUND_SPEEDS)
        for known in self._watched:
            c, allowed = known.c, self._allowed[known.c]
            speed, _ = known.speed(self.system)
            drive, _ = known.driven(self.system, t - step, step)
            speed += drive
            system.contact_real[c, SPEEDING] = abs(speed - self._speeds[c]) / step
            way = max(speed, self._speeds[c]) * step
            if way > TOO_FAR * allowed or (known.crosses and known.moved(t) > known.beside):
                self._cut = 0.5 * step
                return False
            if known.crosses:
                continue
            if not known.is_open:
                entered = known.enters(t) if known.moved(t) > known.distance else None
                if entered is None:
                    continue
                if entered.gap > -LEAPS * system.contact_real[c, LENGTH]:
                    raise touch_elsewhere(t, known.contact.name)
                self._cut = 0.5 * step
                return False
            lost = self.system.gaps[c, 0] >= NOTHING_THERE
            if known.search is not None and self.apart[c] and (lost or known.moved(t) > known.elsewhere):
                # of places that touch at the same time, as far as gaps are known, any will do
                known_to = -float(system.gap_accuracy[c])
                candidates = known.look(t).candidates
                self._refuse_around(t, known)
                length = system.contact_real[c, LENGTH]
                inside = (found for found in candidates if -max(_DEEPER * way, SHALLOW * length) < found.gap < known_to)
                elsewhere = [found for found in inside if not (self._is_present(c, found) and known.is_near(found))]
                if elsewhere and way < LEAPS * length and all(found.gap < -_DEEPER * way for found in elsewhere):
                    raise touch_elsewhere(t, known.contact.name, TOUCHES_UNSEEN)
                if elsewhere:
                    # which was not followed there, or from far away
                    self._cut = 0.5 * step
                    return False
        return True

    def may_go_over(self) -> bool:
        """Whether Newton's method may have left the nearest points of an open contact for other stationary points."""
        forms = self.system.contact_int[:, CLOSED_FORM].tolist()
        return any(mode == FREE and form == NO_CLOSED_FORM for mode, form in zip(self.system.modes.tolist(), forms))

    def are_plain(self) -> bool:
        """Whether all that is watched is such that compiled steps can tell how long it stays apart."""
        return all(known.is_plain and self.apart[known.c] for known in self._watched) and not self._ending

    def are_any(self, t: float) -> bool:
        """Whether anything is to be watched from the accepted state at t, which is evaluated. No error is controlled in
        where open contacts are, which matters to nobody."""
        free = [mode == FREE for mode in self.system.modes.tolist()]
        if free != self._free:
            self._begin_watch(t, free)
        return bool(self._watched)

    def _begin_watch(self, t: float, free: list[bool]) -> None:
        """Watch what there is where these contacts are open."""
        system, self._free, self.is_near = self.system, free, False
        # what has touched is on the side on which it did, and over it
        system.contact_int[: system.nc, BESIDE] &= free
        first, contacts = system.nq + system.nv, self._list()
        system.absolute[first : first + 4 * system.nc] = self._absolute[first : first + 4 * system.nc]
        for c in contacts:
            system.absolute[first + 4 * c : first + 4 * c + 4] = 0.0
        self._watched = [self._nearness(c, t) for c in contacts]
        for c in self._searched:
            # one of them watches for all of the same contours
            others = of_same_contours(system, c)
            if not (free[c] or any(free[i] or i < c for i in others) or touches_once(system, c)):
                known = self._nearness(c, t)
                if known.search is not None:
                    self._watched.append(known)

    # ---------------------------------------------------------------- nearest points

    def find(self, t: float, c: int, entered: float = 0.0, h: float = 0.0, slack: float = 0.0) -> Candidate | None:
        """Look for the nearest points of contact c at the evaluated state; None where they are not others than before,
        which are then in `system.state`. entered: by how much in m bodies may have got inside each other; where they
        have, or will have within h, is nearest; slack: by how much they may be, and it is yet to come, in m."""
        system, known = self.system, self._nearness(c, t)
        candidates, gap = known.find(t), float(system.gaps[c, 0])
        crosses = crosses_anywhere(system, c)
        if crosses:
            candidates = crossings_apart(system, c, candidates)
        elif system.contact_int[c, BESIDE] != 0:
            # what is farther than the end is not what bodies come to first
            candidates = [found for found in candidates if found.gap < self._seen(c).distance]
        inside = [found for found in candidates if -entered < found.gap < 0.0]
        if inside:
            candidates = [min(inside, key=lambda each: each.gap)]
        found = min(candidates, key=lambda each: known.order(each, t, h, slack), default=None)
        if found is None or self._is_present(c, found):
            return None
        followed = not inside and system.contact_real[c, DOMAIN] >= 0.0 and gap >= -slack
        if followed and touching_order(gap, gap_rate(system, c), h, slack) <= known.order(found, t, h, slack):
            # where it is followed comes before what was found
            return None
        self._put(c, (found.location, found.branch, found.determinant_sign, found.charts))
        if crosses:
            numbers = system.contact_real[c]
            numbers[LAST_NORMAL_X : LAST_NORMAL_X + 3] = numbers[NEXT_NORMAL_X : NEXT_NORMAL_X + 3] = 0.0
            system.contact_int[c, SIDE] = found.side
        self.relocated.add(c)
        for i in of_same_contours(system, c):
            # nobody is any more where it was
            if (i, True) in self._known:
                self._known[i, True].forget()
        return found

    def _put(self, c: int, place: Place) -> None:
        """Have contact c elsewhere."""
        location, branch, sign, charts = place
        system, first = self.system, self.system.nq + self.system.nv + 4 * c
        system.state[first : first + 4] = system.location[c] = location
        system.contact_int[c, BRANCH], system.contact_int[c, DETERMINANT_SIGN] = branch, sign
        system.side_int[2 * c : 2 * c + 2, CHART] = charts

    def follow(self, t: float) -> bool:
        """Have open contacts, at the evaluated state, where bodies are nearest, and the kinematics evaluated there;
        whether any were elsewhere. They are looked for where the gap, or that from where they were the last time, has
        changed by more than the bodies have moved since."""
        system, were_elsewhere = self.system, False
        for c in self._list():
            known = self._nearness(c, t)
            if known.search is None:
                continue
            if not known.is_followed(t):
                were_elsewhere = True
                if known.place is not None:
                    self._put(c, known.place)
                    system.evaluate_kinematics(t)
                if not known.is_followed(t) and self.find(t, c) is not None:
                    system.evaluate_kinematics(t)
            known.follow(t)
        self.relocated.clear()
        return were_elsewhere

    def has_leapt(self, c: int, slack: float) -> bool:
        """Whether the gap of contact c, which has changed its sign, has done so without coming to zero, or to what it
        may be below it, in m."""
        allowed = SHALLOW if c in self._shallow else LEAPS
        return bool(abs(self.system.gaps[c, 0]) > slack + allowed * self.system.contact_real[c, LENGTH])

    def loses(self, t: float, c: int) -> bool:
        """Whether contact c was not followed where its gap leapt through zero in the step to the evaluated state at t:
        its nearest points are elsewhere, and looked for anew, or its curves became parallel."""
        self.passed.add(c)
        if self.system.contact_int[c, PATTERN] == CROSSING_CURVES:
            return True
        if self._nearness(c, t).search is None or (inside := self.is_inside(t, c)):
            return False
        if inside is None:
            self.find(t, c)
        return True

    def is_inside(self, t: float, c: int) -> bool | None:
        """Whether bodies of contact c are inside each other where it is, at t; None if nearest elsewhere."""
        known = self._nearness(c, t)
        if known.search is None:
            return bool(self.system.gaps[c, 0] < 0.0)
        found = known.look(t).candidate
        return found.gap <= 0.0 if found is not None and self._is_present(c, found) else None

    def is_behind(self, t: float, c: int) -> bool:
        """Whether the bodies of contact c, which is open and has a negative gap at the evaluated state, are inside or
        behind each other: not where all places are other contacts', or they are apart where they are nearest."""
        known = self._nearness(c, t)
        if known.search is None or known.crosses:
            return True
        found = known.look(t).candidate
        return found is not None and found.gap < 0.0

    def _is_present(self, c: int, found: Candidate) -> bool:
        """Whether a candidate, which is inside the contours' domains, is where contact c is: a point may have other
        coordinates beyond an end, from which there is no way to it."""
        if self.system.contact_real[c, DOMAIN] < 0.0:
            return False
        system, same = self.system, SAME_PLACE * self.system.contact_real[c, LENGTH]
        if not abs(system.gaps[c, 0] - found.gap) < same:
            # elsewhere, or on another side of body 1
            return False
        present = system.frames[2 * c + 1, ORIGIN] + system.derivatives[2 * c + 1, 0]
        return bool(np.linalg.norm(present - found.point) < same)
