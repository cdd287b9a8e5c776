"""Open contacts: how far a step may go before they could touch, the nearest points at which they would, and on which
side of each other their bodies are."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..contours.base import F_T, F_TT, PLANE
from ..geometry.carriers import ORIGIN
from ..geometry.location import POINT_ON_SPHERE, SPHERE_ON_SPHERE
from ..geometry.nearest import NearestSearch, Whole, is_searched, least_whole
from ..geometry.patterns import CROSSING_CURVES
from ..geometry.search import SAME
from ..layout import (
    APPROACH_SPEED,
    BENDING,
    BRANCH,
    CHART,
    CLOSED_FORM,
    DETERMINANT_SIGN,
    DOMAIN,
    EXTENT,
    FLAT,
    FREE,
    HULL_X,
    HULL_Z,
    LENGTH,
    NOTHING_THERE,
    PATTERN,
    SPEEDING,
    TURNING,
    UNILATERAL,
    WHOLE,
)
from .accuracy import APART_AT_END, LEAPS, SHALLOW, gap_rate, rest_speed
from .approach import SAFETY, time_to_cover
from .stages import load_state
from .steps import BOUND_SPEEDS

if TYPE_CHECKING:
    from ..geometry.search import Candidate
    from .run_system import RunSystem

# How far bodies may move within a step where they are near, in radii of curvature, and how far they may turn, in rad:
# gaps are then seen wherever they may be negative.
_NEAR, _TURN = 0.25, 2.0
# Instants of a step at which drives are looked at, and part of its size by which a drive's velocity may change in one.
_INSTANTS, _CHANGE = 16, 0.75
# A step that took bodies this many times as far as it was to is taken again.
_TOO_FAR = 2.0
# Contact coordinates (4,), branch, sign of the determinant, and charts of an open contact.
_Place = tuple[np.ndarray, int, int, tuple[int, int]]
# How far inside a stationary pair of points may be, as a multiple of how far bodies went since they were apart: where
# one enters beside it, farther.
_DEEPER = 4.0
# Constant steps between two looks, at most; and how far one may go where bodies are near, in what others may: through
# nothing that is as thick as its radius of curvature says.
MANY_STEPS, _THROUGH = 1_000_000, 8.0
# Places on the way of a step that went far, and how deep, relative to the contact's length, it may have grazed there.
_WAY_STATIONS, _GRAZES = 16, 1e-2


class _Open:
    """One contact while it is open. searched: whether its nearest points are looked for; near: how far in m bodies may
    move in a step where they are near each other."""

    def __init__(self, system: RunSystem, c: int, t: float) -> None:
        self.system, self.c, self.contact = system, c, system.contacts[c]
        self.search: NearestSearch | None = None
        # the smaller one of bounded contours, and its side
        self.whole: Whole | None = None
        self.side = 0
        one, two = self.contact.body1.contour, self.contact.body2.contour
        self.near = math.inf
        bodies = self.contact.body1, self.contact.body2
        # sides whose contours change with time
        self.changing = [2 * c + i for i, body in enumerate(bodies) if body.contour.time_dependent]
        self.is_driven = bool(self.changing) or any(body.motion is not None for body in bodies)
        if is_searched(system, c):
            with suppress(ValueError):
                self.search = NearestSearch(system, c, t)
        if self.search is not None:
            self.near = _NEAR * self.search.bend
        if self.search is not None:
            self.side, self.whole = self.search.side, self.search.whole
        elif (found := least_whole((one, two), t)) is not None:
            self.side, self.whole = found
        form = system.contact_int[c, CLOSED_FORM]
        if form in (POINT_ON_SPHERE, SPHERE_ON_SPHERE):
            # within the other one there is nothing to fly through
            beside = form == SPHERE_ON_SPHERE and abs(int(system.contact_int[c, BRANCH])) == 1
            self.near = _NEAR * (two.size + (one.size if beside else 0.0))
        numbers = system.contact_real[c]
        numbers[EXTENT], system.contact_int[c, WHOLE] = -1.0, self.side
        if self.whole is not None:
            numbers[HULL_X : HULL_Z + 1], numbers[EXTENT] = self.whole.centre, self.whole.extent
        # whether its gap tells how far the bodies are apart, at least, and nothing but their velocities does how soon
        # they may touch
        self.is_plain = self.search is None and math.isinf(self.near) and not self.is_driven
        numbers[FLAT] = float(self.is_plain and two.kind == PLANE)
        # distances that the last search has found, and the pose at which it did
        self.distance = self.elsewhere = -math.inf
        self.rotation, self.centre, self.time = np.eye(3), np.zeros(3), t
        # gap and place that `follow` has left
        self.gap: float = math.nan
        self.place: _Place | None = None

    def speed(self, system: RunSystem) -> tuple[float, float]:
        """Bounds of the speed in m/s at which points of the smaller contour move in the frame of the other body, and of
        its turning, in rad/s, from `bound_speeds`."""
        speed, turning = system.contact_real[self.c, APPROACH_SPEED : TURNING + 1].tolist()
        for side in self.changing:
            speed += float(np.linalg.norm(system.derivatives[side, 6]))
        return speed, turning

    def driven(self, system: RunSystem, t: float, h: float) -> tuple[float, float]:
        """The largest speed in m/s at which drives move points of one contour near the other one up to t + h, and the
        longest step in s in which their velocities change by no more than they are."""
        speed = change = 0.0
        if not self.is_driven:
            return 0.0, math.inf
        centre = system.frames[2 * self.c + self.side, ORIGIN]
        for side, body in ((2 * self.c, self.contact.body1), (2 * self.c + 1, self.contact.body2)):
            contour, u = body.contour, system.location[self.c, 2 * (side % 2) :][: body.contour.dimension]
            reach = float(np.linalg.norm(centre - system.frames[side, ORIGIN]))
            reach += self.whole.extent if self.whole is not None else 0.0
            for i in range(_INSTANTS if body.motion is not None or contour.time_dependent else 0):
                when = t + h * (i + 0.5) / _INSTANTS
                if body.motion is not None:
                    row = body.motion.evaluate(when)
                    speed = max(speed, float(np.linalg.norm(row[12:15]) + reach * np.linalg.norm(row[15:18])))
                    change = max(change, float(np.linalg.norm(row[18:21]) + reach * np.linalg.norm(row[21:24])))
                if contour.time_dependent:
                    values = contour.evaluate(u.tolist(), when, int(system.side_int[side, CHART]))
                    speed = max(speed, float(np.linalg.norm(values[F_T])))
                    change = max(change, float(np.linalg.norm(values[F_TT])))
        return speed, _CHANGE * speed / change if change > 0.0 else math.inf

    def moved(self, t: float) -> float:
        """How far in m any point of body 1 has moved in the frame of body 2 since the last search, at most."""
        search = self.search
        if search is None:
            return 0.0
        if self.changing:
            return 0.0 if t == self.time else math.inf
        rotation, centre = search.pose()
        turned = float(np.linalg.norm(rotation - self.rotation)) / math.sqrt(2.0)
        return float(np.linalg.norm(centre - self.centre)) + turned * search.whole.extent

    def is_followed(self, t: float) -> bool:
        """Whether its gap may be that of the nearest points, for all that is known from the last time."""
        gap = float(self.system.gaps[self.c, 0])
        return abs(gap - self.gap) <= self.moved(t) + SAME * self.system.contact_real[self.c, LENGTH]

    def follow(self, t: float) -> None:
        """Take where it is as where bodies are nearest; what the last search has found counts no more."""
        system, c, integers = self.system, self.c, self.system.contact_int[self.c]
        assert self.search is not None
        self.distance = self.elsewhere = -math.inf
        (self.rotation, self.centre), self.time, self.gap = self.search.pose(), t, float(system.gaps[c, 0])
        charts = (int(system.side_int[2 * c, CHART]), int(system.side_int[2 * c + 1, CHART]))
        self.place = system.location[c].copy(), int(integers[BRANCH]), int(integers[DETERMINANT_SIGN]), charts


class OpenContacts:
    """What is known of a system's open contacts between its steps.

    apart: (nc,) whether a contact touches when its gap comes down through zero: since its bodies have been apart.
    hasty: the contact for which `look` has last found the step too long.
    relocated: contacts that were found to be nearest elsewhere; others take that down, and clear it.
    passed: contacts whose gap fell through zero beyond an end of a contour in the last step, or was not seen to.
    """

    def __init__(self, system: RunSystem) -> None:
        self.system = system
        self.apart = np.ones(system.nc, dtype=bool)
        self.passed: set[int] = set()
        # those that were inside at the start, and have not come out since
        self._shallow: set[int] = set()
        self._open: dict[int, _Open] = {}
        self._speeds: dict[int, float] = {}
        self._allowed: dict[int, float] = {}
        self._cut = math.inf
        # states from which a step went far for what is near, by contact
        self._far: dict[int, np.ndarray] = {}
        self.hasty = 0
        self.relocated: set[int] = set()
        self.is_near = False
        self._controlled: list[int] = []
        self._gravity = math.hypot(*system.gravity.tolist())
        self._absolute = system.absolute.copy()

    # ---------------------------------------------------------------- sides

    def begin(self, slack: Callable[[int], float]) -> None:
        """The evaluated state is that at which a run starts; slack: what its gap may be below zero, in m."""
        system = self.system
        for c in self._list():
            leaves = system.contact_real[c, DOMAIN] < 0.0 or gap_rate(system, c) > rest_speed(system)
            allowed = (APART_AT_END if leaves else SHALLOW) * system.contact_real[c, LENGTH]
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

    def _list(self) -> list[int]:
        unilateral = self.system.contact_int[:, UNILATERAL]
        return [c for c, mode in enumerate(self.system.modes.tolist()) if mode == FREE and unilateral[c]]

    # ---------------------------------------------------------------- steps

    def begin_step(self, t: float, h: float) -> tuple[float, bool]:
        """The longest step in s from the accepted state, which is evaluated, of those up to h; and whether anything
        may touch in it."""
        system, contacts = self.system, self._controlled
        known_of = [self._known(c, t) for c in contacts]
        system.run(BOUND_SPEEDS)
        self._allowed.clear()
        longest, near = math.inf, False
        for c, known in zip(contacts, known_of):
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
                    self.find(t, c)
                    distance = self._distance(known, t)
            self._allowed[c] = allowed = max(distance, known.near)
            free = time_to_cover(distance, speed, acceleration)
            limit = time_to_cover(allowed, speed, acceleration)
            if h > free:
                near = True
                limit = min(limit, max(follows, free))
                if turning > 0.0 and known.whole is not None and known.whole.extent > 0.0:
                    limit = min(limit, max(_TURN / turning, free))
            longest = min(longest, limit)
        longest, self._cut = min(longest, self._cut), math.inf
        self.is_near = near
        return longest, near

    def watches(self) -> bool:
        """Whether constant steps have to be looked at: whether any contact may be elsewhere, or be flown through."""
        integers = self.system.contact_int[: self.system.nc]
        balls = np.isin(integers[:, CLOSED_FORM], (POINT_ON_SPHERE, SPHERE_ON_SPHERE))
        searched = np.array([is_searched(self.system, c) for c in range(self.system.nc)], dtype=bool)
        return bool(((integers[:, UNILATERAL] != 0) & (balls | searched)).any())

    def look(self, t: float, h: float, touched: np.ndarray) -> int:
        """How many steps of size h from the accepted state at t, which is evaluated, may go before the next look; zero
        where one may go through what is there, or the last one did. touched: (nc,) which contacts touched in that."""
        if self.went_through(t, h, touched):
            return 0
        steps = MANY_STEPS
        known_of = [(c, self._known(c, t)) for c in self._list()]
        self.system.run(BOUND_SPEEDS)
        for c, known in known_of:
            if math.isinf(known.near):
                continue
            speed, _ = known.speed(self.system)
            speed += known.driven(self.system, t, h)[0]
            acceleration, distance = SAFETY * self._gravity, self._distance(known, t)
            way = speed * h + 0.5 * acceleration * h * h
            if known.search is not None and way > distance:
                lost = self.system.gaps[c, 0] >= NOTHING_THERE or not self.apart[c]
                if lost or known.moved(t) + way > known.elsewhere:
                    found = self.find(t, c, way)
                    if found is not None:
                        # it has not been elsewhere longer than in the last step
                        self.apart[c] = found.gap > -_DEEPER * way
                distance = self._distance(known, t)
            # what is behind a contour goes through it
            if self.apart[c] and way > max(distance, _THROUGH * known.near):
                self.hasty = c
                return 0
            if self.apart[c] and way > max(distance, known.near):
                # so far that the parabola of the gap may not tell
                self._far[c] = self.system.state.copy()
            certain = distance if known.search is None else known.elsewhere - known.moved(t)
            steps = min(steps, max(int(min(time_to_cover(max(certain, 0.0), speed, acceleration) / h, MANY_STEPS)), 1))
        return steps

    def forget_way(self) -> None:
        """No step has led to the state from which the next one goes."""
        self._far.clear()

    def went_through(self, t: float, h: float, touched: np.ndarray) -> bool:
        """Whether an open contact that did not touch has been closed on the straight way of the last step, which was
        long."""
        far, self._far = self._far, {}
        system, nq = self.system, self.system.nq
        far = {c: before for c, before in far.items() if system.modes[c] == FREE and not touched[c]}
        if not far:
            return False
        end, through = system.state.copy(), False
        for c, before in far.items():
            for part in (i / _WAY_STATIONS for i in range(_WAY_STATIONS + 1)):
                system.stage_state[:] = before + part * (end - before)
                system.stage_state[:nq] = pin.interpolate(system.model, before[:nq], end[:nq], part)
                load_state(system.address)
                system.evaluate_kinematics(t - (1.0 - part) * h)
                inside = system.contact_real[c, DOMAIN] >= 0.0
                if inside and system.gaps[c, 0] < -_GRAZES * system.contact_real[c, LENGTH]:
                    self.hasty, through = c, True
        system.stage_state[:] = end
        load_state(system.address)
        system.evaluate_kinematics(t)
        return through

    def _known(self, c: int, t: float) -> _Open:
        if c not in self._open:
            self._open[c] = _Open(self.system, c, t)
        return self._open[c]

    def _distance(self, known: _Open, t: float) -> float:
        """How far bodies are apart, at least, in m; zero where that is not known."""
        system, c = self.system, known.c
        if known.search is not None:
            return max(known.distance - known.moved(t), 0.0)
        if system.contact_real[c, DOMAIN] < 0.0 and system.gaps[c, 0] >= NOTHING_THERE:
            return 0.0
        return max(abs(float(system.gaps[c, 0])), 0.0)

    def may_stand(self, t: float, step: float) -> bool:
        """Whether the trial step to the state at t, which is evaluated, went no further than it was to, and past
        nothing; where it did not, the next one is shorter."""
        system = self.system
        system.run(BOUND_SPEEDS)
        for c, allowed in self._allowed.items():
            known = self._open[c]
            speed, _ = known.speed(self.system)
            drive, _ = known.driven(self.system, t - step, step)
            speed += drive
            system.contact_real[c, SPEEDING] = abs(speed - self._speeds[c]) / step
            way = max(speed, self._speeds[c]) * step
            if way > _TOO_FAR * allowed:
                self._cut = 0.5 * step
                return False
            lost = self.system.gaps[c, 0] >= NOTHING_THERE
            if known.search is not None and self.apart[c] and (lost or known.moved(t) > known.elsewhere):
                candidates = known.search.search(t).candidates
                if any(-_DEEPER * way < found.gap < 0.0 and not self._is_present(c, found) for found in candidates):
                    self._cut = 0.5 * step
                    return False
        return True

    def are_plain(self, t: float) -> bool:
        """Whether all open contacts are such that compiled steps can tell how long they stay apart."""
        return all(self.apart[c] and self._known(c, t).is_plain for c in self._controlled)

    def are_any(self) -> bool:
        """Whether there are open contacts. No error is controlled in where they are, which matters to nobody."""
        contacts = self._list() if FREE in self.system.modes.tolist() else []
        if contacts != self._controlled:
            self._control(contacts)
        return bool(contacts)

    def _control(self, contacts: list[int]) -> None:
        self.is_near, self._controlled = False, contacts
        system = self.system
        first = system.nq + system.nv
        system.absolute[first : first + 4 * system.nc] = self._absolute[first : first + 4 * system.nc]
        for c in contacts:
            system.absolute[first + 4 * c : first + 4 * c + 4] = 0.0

    # ---------------------------------------------------------------- nearest points

    def find(self, t: float, c: int, entered: float = 0.0) -> Candidate | None:
        """Look for the nearest points of contact c at the evaluated state; None where they are not others than before,
        which are then in `system.state`. entered: by how much in m bodies may have got inside each other; where they
        have, is nearest."""
        system, known = self.system, self._open[c]
        search = known.search
        assert search is not None
        nearest = search.search(t)
        known.rotation, known.centre = search.pose()
        known.distance, known.elsewhere, known.time = nearest.distance, nearest.elsewhere, t
        inside = [found for found in nearest.candidates if -entered < found.gap < 0.0]
        found = min(inside, key=lambda each: each.gap) if inside else nearest.candidate
        if found is None or self._is_present(c, found):
            return None
        if not inside and system.contact_real[c, DOMAIN] >= 0.0 and 0.0 <= system.gaps[c, 0] <= abs(found.gap):
            # where it is followed is nearer than what was found
            return None
        self._put(c, (found.location, found.branch, found.determinant_sign, found.charts))
        self.relocated.add(c)
        return found

    def _put(self, c: int, place: _Place) -> None:
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
            known = self._known(c, t)
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
        search = self._known(c, t).search
        if search is None:
            return False
        found = search.search(t).candidate
        if found is not None and self._is_present(c, found):
            return found.gap > 0.0
        self.find(t, c)
        return True

    def _is_present(self, c: int, found: Candidate) -> bool:
        """Whether a candidate is where contact c is."""
        system, same = self.system, SAME * self.system.contact_real[c, LENGTH]
        if not abs(system.gaps[c, 0] - found.gap) < same:
            # elsewhere, or on another side of body 1
            return False
        present = system.frames[2 * c + 1, ORIGIN] + system.derivatives[2 * c + 1, 0]
        return bool(np.linalg.norm(present - found.point) < same)
