"""How far the bodies of one contact are apart, or beside a place at which they touch, and how long that holds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..contours.base import F_T, F_TT, LINE, PLANE
from ..geometry.carriers import OMEGA, ORIGIN, VELOCITY
from ..geometry.location import POINT_ON_SPHERE, SPHERE_ON_SPHERE
from ..geometry.nearest import Nearest, NearestSearch, Whole, is_searched, least_whole
from ..geometry.single_touch import inner_radius
from ..layout import (
    APPROACH_SPEED,
    BRANCH,
    CHART,
    CLOSED_FORM,
    DETERMINANT_SIGN,
    EXTENT,
    FLAT,
    FREE,
    HULL_X,
    HULL_Z,
    LENGTH,
    NEXT,
    NOTHING_THERE,
    SAME_PLACE,
    SIDE,
    TURNING,
    WHOLE,
)
from .accuracy import SHALLOW

if TYPE_CHECKING:
    from ..contours.motion import Motion
    from ..dynamics.system import System
    from ..geometry.search import Candidate
    from .run_system import RunSystem

# How far bodies may move within a step where they are near, in radii of curvature.
_NEAR = 0.25
# A step that took bodies this many times as far as it was to is taken again.
TOO_FAR = 2.0
# How far one may go through nothing that is as thick as its radius of curvature says, in what they may move so.
_THROUGH = 8.0
# Instants of a step at which drives are looked at, and part of its size by which a drive's velocity may change in one.
_INSTANTS, _CHANGE = 16, 0.75
# Contact coordinates (4,), branch, sign of the determinant, and charts of an open contact.
Place = tuple[np.ndarray, int, int, tuple[int, int]]


def of_same_contours(system: System, c: int) -> list[int]:
    """Other contacts between the contours of contact c."""
    others, i = [], int(system.contact_int[c, NEXT])
    while i != c:
        others.append(i)
        i = int(system.contact_int[i, NEXT])
    return others


def places_of(system: System, contacts: list[int], c: int) -> list[np.ndarray]:
    """Where these contacts, of the contours of contact c, are in the evaluated state: points (2, 3) in the world of its
    body 1 and body 2; without those that are nowhere."""
    places = []
    for i in contacts:
        if system.modes[i] == FREE and system.gaps[i, 0] >= NOTHING_THERE:
            continue
        sides = slice(2 * i, 2 * i + 2)
        points = system.frames[sides, ORIGIN] + system.derivatives[sides, 0]
        places.append(points if system.contacts[i].body1 is system.contacts[c].body1 else points[::-1])
    return places


def touching_order(gap: float, rate: float, h: float, slack: float) -> tuple[float, float]:
    """Before others is what will be inside, and deeper, after h, but is not by more than the slack; then what is
    nearer."""
    return min(gap + h * rate, 0.0) if gap >= -slack else 0.0, abs(gap)


def instants(t: float, h: float) -> list[float]:
    """Times in s from t up to t + h at which drives are looked at."""
    return [t + h * (i + 0.5) / _INSTANTS for i in range(_INSTANTS)]


class Drives:
    """How fast prescribed motions go in the last step that was asked for, found once for all contacts."""

    def __init__(self) -> None:
        self._step = math.nan, math.nan
        self._sizes: dict[Motion, np.ndarray] = {}

    def sizes(self, motion: Motion, t: float, h: float) -> np.ndarray:
        """(4, n) speed in m/s, turning in rad/s, and the sizes of the rates of both, at `instants`."""
        if self._step != (t, h):
            self._step = t, h
            self._sizes.clear()
        if motion not in self._sizes:
            rows = np.array([motion.evaluate(when)[12:24] for when in instants(t, h)]).reshape(-1, 4, 3)
            self._sizes[motion] = np.linalg.norm(rows, axis=2).T
        return self._sizes[motion]


class Nearness:
    """What is known of the distance of the bodies of one contact, which is open, or of that beside the place at which
    they touch.

    search: as that of another contact of the same contours, if there is one; taken: other contacts of the same
    contours, and the contact itself where it is closed: what is looked for is not there. t: time in s; drives: those of
    all contacts.
    """

    def __init__(
        self, system: RunSystem, c: int, t: float, drives: Drives, search: NearestSearch | None = None
    ) -> None:
        self.system, self.c, self.contact, self._drives = system, c, system.contacts[c], drives
        self.is_open = bool(system.modes[c] == FREE)
        self.taken = of_same_contours(system, c) + ([] if self.is_open else [c])
        self.search = search
        # the smaller one of bounded contours, and its side
        self.whole: Whole | None = None
        self.side = 0
        one, two = self.contact.body1.contour, self.contact.body2.contour
        self._far = math.inf
        bodies = self.contact.body1, self.contact.body2
        # sides whose contours change with time
        self.changing = [2 * c + i for i, body in enumerate(bodies) if body.contour.time_dependent]
        self.is_driven = bool(self.changing) or any(body.motion is not None for body in bodies)
        if search is None and is_searched(system, c) and any(np.isfinite(shape.domain).all() for shape in (one, two)):
            self.search = NearestSearch(system, c, t)
        # whether it is of curves that may cross in several places
        self.crosses = self.search is not None and self.search.crosses
        if self.search is not None:
            self.side, self.whole = self.search.side, self.search.whole
        elif (found := least_whole((one, two), t)) is not None:
            self.side, self.whole = found
        form = system.contact_int[c, CLOSED_FORM]
        if form in (POINT_ON_SPHERE, SPHERE_ON_SPHERE):
            # within the other one there is nothing to fly through
            beside = form == SPHERE_ON_SPHERE and abs(int(system.contact_int[c, BRANCH])) == 1
            self._far = _NEAR * (two.size + (one.size if beside else 0.0))
        numbers = system.contact_real[c]
        numbers[EXTENT], system.contact_int[c, WHOLE] = -1.0, self.side
        if self.whole is not None:
            numbers[HULL_X : HULL_Z + 1], numbers[EXTENT] = self.whole.centre, self.whole.extent
        # whether its gap tells how far the bodies are apart, at least, and nothing but their velocities does how soon
        # they may touch
        self.is_plain = self.search is None and math.isinf(self._far) and not self.is_driven
        numbers[FLAT] = float(self.is_plain and two.kind in (LINE, PLANE))
        # distances that the last search has found, and the pose at which it did
        self.distance = self.elsewhere = -math.inf
        self.rotation: np.ndarray | None = None
        self.centre, self.time = np.zeros(3), t
        # whether they touch, for all that the last search has found, along a line
        self.touches_around = False
        # where it was on the divided contour as the last step began
        self.start = np.zeros(3)
        # gap and place that `follow` has left
        self.gap: float = math.nan
        self.place: Place | None = None

    @property
    def near(self) -> float:
        """How far in m bodies may move in a step where they are near each other; where it is searched, only after the
        first search."""
        return self._far if self.search is None else _NEAR * self.search.bend

    @property
    def through(self) -> float:
        """How far in m bodies may move in a step without going through each other where they are near: both are as
        thick as their radii of curvature say, or it is little for one of them."""
        return max(_THROUGH * self.near, _NEAR * inner_radius(self.system, self.c))

    @property
    def beside(self) -> float:
        """How far in m bodies were apart, at the last search, where they are not followed."""
        return self.elsewhere if self.is_open else self.distance

    def has_the_bodies_of(self, c: int) -> bool:
        """Whether contact c is of the same contours, in the same order and on the same side."""
        own, other, sides = self.contact, self.system.contacts[c], self.system.contact_int[:, SIDE]
        return own.body1 is other.body1 and own.body2 is other.body2 and bool(sides[self.c] == sides[c])

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
            if body.motion is not None:
                reach = float(np.linalg.norm(centre - system.frames[side, ORIGIN]))
                reach += self.whole.extent if self.whole is not None else 0.0
                sizes = self._drives.sizes(body.motion, t, h)
                speed = max(speed, float((sizes[0] + reach * sizes[1]).max()))
                change = max(change, float((sizes[2] + reach * sizes[3]).max()))
            if contour.time_dependent:
                for when in instants(t, h):
                    values = contour.evaluate(u.tolist(), when, int(system.side_int[side, CHART]))
                    speed = max(speed, float(np.linalg.norm(values[F_T])))
                    change = max(change, float(np.linalg.norm(values[F_TT])))
        return speed, _CHANGE * speed / change if change > 0.0 else math.inf

    def moved(self, t: float) -> float:
        """How far in m any point of body 1 has moved in the frame of body 2 since the last search, at most; infinite
        before the first."""
        search = self.search
        if search is None:
            return 0.0
        if self.rotation is None:
            return math.inf
        if self.changing:
            return 0.0 if t == self.time else math.inf
        rotation, centre = search.pose()
        turned = float(np.linalg.norm(rotation - self.rotation)) / math.sqrt(2.0)
        return float(np.linalg.norm(centre - self.centre)) + turned * search.whole.extent

    def is_followed(self, t: float) -> bool:
        """Whether its gap may be that of the nearest points, for all that is known from the last time."""
        gap = float(self.system.gaps[self.c, 0])
        return abs(gap - self.gap) <= self.moved(t) + SAME_PLACE * self.system.contact_real[self.c, LENGTH]

    def follow(self, t: float) -> None:
        """Take where it is as where bodies are nearest; what the last search has found counts no more."""
        system, c, integers = self.system, self.c, self.system.contact_int[self.c]
        assert self.search is not None
        self.distance = self.elsewhere = -math.inf
        (self.rotation, self.centre), self.time, self.gap = self.search.pose(), t, float(system.gaps[c, 0])
        charts = (int(system.side_int[2 * c, CHART]), int(system.side_int[2 * c + 1, CHART]))
        self.place = system.location[c].copy(), int(integers[BRANCH]), int(integers[DETERMINANT_SIGN]), charts

    def set_out(self) -> None:
        """A step begins at the evaluated state."""
        if self.search is not None:
            side = 2 * self.c + 1 - self.side
            self.start = self.search.on_divided(self.system.frames[side, ORIGIN] + self.system.derivatives[side, 0])

    def is_near(self, found: Candidate) -> bool:
        """Whether a candidate is in the neighbourhood, which has no other one, of where the contact was as the step
        began."""
        assert self.search is not None
        way = self.search.on_divided(found.points[1 - self.side]) - self.start
        return float(np.linalg.norm(way)) < self.search.neighbourhood

    def look(self, t: float) -> Nearest:
        """Search the nearest points at the evaluated state."""
        assert self.search is not None
        nearest = self.search.search(t, places_of(self.system, self.taken, self.c))
        self.touches_around = nearest.is_around
        return nearest

    def find(self, t: float) -> list[Candidate]:
        """The same; the distances that it finds are known from here on."""
        nearest = self.look(t)
        self._take_down(t, nearest.distance, nearest.elsewhere)
        return nearest.candidates

    def _take_down(self, t: float, distance: float, elsewhere: float) -> None:
        """What a search has found at the evaluated state."""
        assert self.search is not None
        (self.rotation, self.centre), self.time = self.search.pose(), t
        self.distance, self.elsewhere = distance, elsewhere

    def forget(self) -> None:
        """What was known is of fewer places than there are: others have left theirs."""
        self.rotation = None

    def order(self, found: Candidate, t: float, h: float, slack: float) -> tuple[float, float]:
        """By which candidates at the evaluated state are compared, see `touching_order`."""
        return touching_order(found.gap, self._gap_rate(found, t) if h > 0.0 else 0.0, h, slack)

    def _gap_rate(self, found: Candidate, t: float) -> float:
        """Rate in m/s of the gap at a candidate, at the evaluated state."""
        system, contour = self.system, self.contact.body2.contour
        frames = system.frames[2 * self.c : 2 * self.c + 2]
        values = contour.evaluate(found.location[2 : 2 + contour.dimension].tolist(), t, found.charts[1])
        shape = values @ frames[1, :3].T
        across = shape[2] if contour.dimension == 2 else frames[1, :3, 2]
        normal = -float(system.contact_int[self.c, SIDE]) * (pin.skew(shape[1]) @ across)
        rate = shape[F_T] if contour.time_dependent else np.zeros(3)
        for frame, point, sign in zip(frames, found.points, (-1.0, 1.0)):
            rate = rate + sign * (frame[VELOCITY] + pin.skew(frame[OMEGA]) @ (point - frame[ORIGIN]))
        return float(normal @ rate / np.linalg.norm(normal))

    def enters(self, t: float) -> Candidate | None:
        """Where bodies are inside each other at the evaluated state, beside the places that are taken; None where they
        are not. They cannot have got there farther than they have moved since the last search, or samples show; where
        shapes change, than steps may go."""
        assert self.search is not None
        if self.crosses:
            moved = self.moved(t)
            beside = min(self.find(t), key=lambda found: abs(found.gap), default=None)
            # they may have gone through each other since
            near = moved if moved < math.inf else float(self.system.gap_accuracy[self.c])
            return beside if beside is not None and abs(beside.gap) <= near else None
        if not self.search.may_overlap():
            return None
        shallow = SHALLOW * self.system.contact_real[self.c, LENGTH]
        way = TOO_FAR * max(self.near, self.distance) if self.changing else self.moved(t)
        deepest = max(way, shallow) if self.distance > -math.inf else shallow
        slack, same = float(self.system.gap_accuracy[self.c]), SAME_PLACE * self.system.contact_real[self.c, LENGTH]
        places = places_of(self.system, self.taken, self.c)
        apart = self.search.distance(t, places)
        if apart > 0.0:
            # wherever stationary points are
            self._take_down(t, apart, apart)
            return None
        inside = [
            found
            for found in self.find(t)
            # what comes out of where nobody knows that it is inside does not enter
            if -deepest <= found.gap < 0.0
            and not (found.gap >= -slack and self._gap_rate(found, t) > 0.0)
            # through a body from where another contact touches it: a point there is not deep inside
            and not (
                found.gap < -shallow
                and any((np.abs(found.points - place).max(axis=1) < same).any() for place in places)
            )
        ]
        return min(inside, key=lambda found: found.gap, default=None)
