"""The nearest points of two contours that are apart, wherever they are, and what is known of all others.

Contours are covered by cells: samples, each with a radius within which all points of its cell lie. What is farther than
the nearest sample, less its radius, is left out, the rest divided; Newton's method goes on from the best samples.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from ..contours import (
    Circle,
    Contour,
    Cylinder,
    Ellipsoid,
    HeightField,
    ParametricCurve,
    Plane,
    Point,
    Sphere,
    Torus,
)
from ..contours.base import LINE
from ..layout import (
    CLOSED_FORM,
    DETERMINANT_SIGN,
    FRICTIONLESS,
    LENGTH,
    MODE,
    PATTERN,
    SAME_PLACE,
    SIDE,
    SINGULAR,
)
from ..workspace import Workspace
from .carriers import ORIGIN
from .cells import (
    CURVE_CELLS,
    FINEST,
    LONGER,
    MOST_FEET,
    SURFACE_CELLS,
    SampleTree,
    find_feet,
    lowest_cells,
    near_cells,
    put_samples,
    search_workspace,
)
from .location import CYLINDERS, NO_CLOSED_FORM
from .patterns import CROSSING_CURVES
from .search import Candidate, ends_within, evaluated, grid, spaced, stationary_points

# Samples of the contour that is taken as a whole.
_WHOLE_CURVE, _WHOLE_SURFACE = 192, (48, 24)
# Starts of Newton's method from what is nearest, and as many from what may be inside.
_STARTS = MOST_FEET // 2
# Radius of the neighbourhood of a nearest point that has no other one, in radii of curvature.
_NEIGHBOURHOOD = 0.5
# How far from an end it is looked whether what is nearest there is so farther inside, as a part of the whole.
_INSIDE = 0.1
# What is no overlap of samples: round-off where they touch.
_OVERLAP = 1e-9
# How far around points it is looked, as a part of the contact's length.
_SEEN = 0.1
# By how much that may grow from one search to the next.
_GROWTH = 2.0
# Radii of curvature beyond this, in m, count as this.
_LARGEST = 100.0
# Part of the bends that may be sharper than the radius of curvature that counts: those of poles are the parameters'.
_SHARPEST = 0.9


@dataclass(frozen=True)
class Nearest:
    """What a search has found beside places that are taken. candidates: stationary points, the nearest first; distance:
    of any points of the contours, at least; elsewhere: of any points outside the first candidate's neighbourhood, at
    least; in m. is_around: bodies are inside each other, but have no stationary points there, or singular ones: they
    have touched along a line."""

    candidates: list[Candidate]
    distance: float
    elsewhere: float
    is_around: bool = False

    @property
    def candidate(self) -> Candidate | None:
        """The nearest stationary point, None without any."""
        return self.candidates[0] if self.candidates else None


class _Survey(NamedTuple):
    """Cells that are near: middles (n, 3) in the divided contour's frame, radii (n,), distances (n,) of their middles
    and least ones of their points; how far it has been looked, in m."""

    points: np.ndarray
    reaches: np.ndarray
    distances: np.ndarray
    least: np.ndarray
    resolved: float


class Whole:
    """A contour of finite extent as samples of its core, from which all that it has is as far as its rounding: the
    centre of a ball, the centre circle of a torus, the axis of a cylinder where nothing can be within that
    (`is_solid`), or itself. points (n, 3), parameters (n, 2), counts: samples along each parameter, radius: of a
    sample's cell, in m; centre (3,), extent: of a ball around the core, in m; rounding in m."""

    def __init__(self, contour: Contour, t: float, is_solid: bool = False) -> None:
        self.contour, self.core, self.rounding = contour, contour, 0.0
        if isinstance(contour, Sphere):
            self.core, self.rounding = Point(), contour.shape[0]
        elif isinstance(contour, Torus):
            self.core, self.rounding = Circle(contour.shape[0]), contour.shape[1]
        elif is_solid:
            axis = ParametricCurve(lambda u: (0.0 * u, 0.0 * u, u), contour.domain[1])
            self.core, self.rounding = axis, contour.shape[0]
        self.counts: tuple[int, ...] = (1,)
        self.parameters, self.points, self.radius = np.zeros((1, 2)), np.zeros((1, 3)), 0.0
        if self.core.dimension > 0:
            counts = (_WHOLE_CURVE,) if self.core.dimension == 1 else _WHOLE_SURFACE
            self.counts = counts
            centres, half = _cells(self.core.domain, counts)
            values = evaluated(self.core, centres, t)
            self.parameters, self.points = centres, values[:, 0]
            self.radius = float(_reaches(values, half).max())
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        self.centre = 0.5 * (low + high)
        self.extent = float(np.linalg.norm(self.points - self.centre, axis=1).max()) + self.radius

    @property
    def size(self) -> float:
        """Radius in m of a ball around all of it."""
        return self.extent + self.rounding

    @functools.cached_property
    def tree(self) -> SampleTree:
        """The samples, to search for those near a place."""
        return SampleTree(self.points)


# contours do not change, nor do any of their parts, but for those that depend on time
_whole = functools.lru_cache(maxsize=64)(Whole)


def _instant(contour: Contour, t: float) -> float:
    """The time to which what a contour is at t belongs: of most of them, any."""
    return t if contour.time_dependent else 0.0


@functools.lru_cache(maxsize=64)
def bend(contour: Contour, t: float) -> float:
    """Least radius of curvature in m of a contour, poles of its parameters left out; infinite for what is straight."""
    if contour.dimension == 0:
        return math.inf
    if isinstance(contour, Sphere):
        return contour.shape[0]
    box = [(max(low, -_window(contour)), min(high, _window(contour))) for low, high in contour.domain]
    centres, _ = _cells(box, (CURVE_CELLS,) if contour.dimension == 1 else (SURFACE_CELLS,) * 2)
    values = evaluated(contour, centres, t)
    sharpest = np.zeros(len(values))
    for first, second in ((1, 3), (2, 5))[: contour.dimension]:
        across = np.linalg.norm(np.cross(values[:, first], values[:, second]), axis=1)
        speed = np.maximum(np.linalg.norm(values[:, first], axis=1), 1e-100)
        sharpest = np.maximum(sharpest, across / speed**3)
    curvature = float(np.quantile(sharpest, _SHARPEST))
    return 1.0 / curvature if curvature > 0.0 else math.inf


def _window(contour: Contour) -> float:
    return contour.size if math.isfinite(contour.size) else 10.0


class NearestSearch:
    """Searches the nearest points of one contact of a system (`dynamics.system`), which is in any state.

    The contour of less extent is taken as a whole; the other one is divided into cells.

    whole, divided: these contours; side: of the whole one, 0 or 1; bend: least radius of curvature of both, in m, near
    where the last search has found them nearest.
    Raises ValueError where neither contour is bounded.
    """

    def __init__(self, system: Workspace, c: int, t: float) -> None:
        self.system, self.c = system, c
        contours = system.contacts[c].body1.contour, system.contacts[c].body2.contour
        found = least_whole(contours, t)
        if found is None:
            raise ValueError("both contours are unbounded.")
        self.side, self.whole = found
        self.divided = contours[1 - self.side]
        one, two = (bend(contour, _instant(contour, t)) for contour in (self.whole.core, self.divided))
        self._bends = one, two
        self.bend = self._bend(math.inf)
        # sine of the angle at which curves cross
        self._across = 1.0
        self._single, self.crosses = system.alone(c), crosses_anywhere(system, c)
        # time and poses of the last search, and what it found, candidates where somebody has asked for them
        self._state: tuple[float, bytes] | None = None
        self._survey: _Survey
        self._found: tuple[list[Candidate], bool] | None = None

    @functools.cached_property
    def _cells(self) -> Workspace:
        return search_workspace(self.divided, self.whole.tree)

    def _bend(self, local: float) -> float:
        """The least radius of curvature that counts, in m; local: of the divided contour where it is near."""
        own, other, rounding = self._bends[0], min(self._bends[1], local), self.whole.rounding
        if rounding > 0.0:
            # in a hollow, what is left of its radius
            other = max(other - rounding, 0.5 * min(rounding, other))
        return min(own, other, _LARGEST)

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotation of the whole contour's frame in that of the divided one, and its centre there, as last evaluated."""
        own, other = self.system.frames[2 * self.c + self.side], self._frame()
        rotation = other[:3].T @ own[:3]
        return rotation, other[:3].T @ (own[ORIGIN] - other[ORIGIN]) + rotation @ self.whole.centre

    def _frame(self) -> np.ndarray:
        """The divided contour's frame, as last evaluated."""
        return self.system.frames[2 * self.c + 1 - self.side]

    @property
    def neighbourhood(self) -> float:
        """Radius in m around a nearest point within which there is no other one."""
        return _NEIGHBOURHOOD * self.bend * self._across

    def on_divided(self, point: np.ndarray) -> np.ndarray:
        """A point (3,) in the world in the divided contour's frame, as last evaluated."""
        frame = self._frame()
        return np.asarray(frame[:3].T @ (point - frame[ORIGIN]))

    def may_overlap(self) -> bool:
        """Whether the bodies may be inside each other, in the system's last evaluation; of a body with samples and an
        ellipsoid, or a ball, these tell, to their distance squared over the radius of curvature."""
        if not isinstance(self.divided, (Sphere, Ellipsoid)) or self.whole.rounding > 0.0:
            return True
        axes = np.array(self.divided.shape[:3] if isinstance(self.divided, Ellipsoid) else 3 * self.divided.shape[:1])
        rotation, centre = self.pose()
        points = ((self.whole.points - self.whole.centre) @ rotation.T + centre) / axes
        beyond, middle = np.einsum("ni,ni->n", points, points) - 1.0, centre / axes
        return bool((beyond * (middle @ middle - 1.0)).min() < -_OVERLAP)

    def search(self, t: float, taken: Sequence[np.ndarray] = ()) -> Nearest:
        """The nearest points at the system's (q, v).

        taken: pairs of points (2, 3) of body 1 and body 2, in the world, at which other contacts of the same contours
        are: nothing is looked for there.
        """
        self._survey_at(t)
        same, own = SAME_PLACE * self.system.contact_real[self.c, LENGTH], 1 - self.side
        if self._found is None:
            self._found = self._find(t)
        every, is_around = self._found
        found = [one for one in every if not any(np.abs(one.points - place).max() < same for place in taken)]
        if self.crosses:
            self._across = min((self._sine(t, one) for one in every[:1]), default=1.0)
        places = [pair[own] for pair in taken]
        elsewhere = self._beside([*places, *(one.points[own] for one in found[:1])])
        if self.crosses:
            length = self.system.contact_real[self.c, LENGTH]
            others = [one for one in found if not one.is_at(found[0], length)]
            gaps = [float(np.linalg.norm(place[1] - place[0])) for place in taken]
            distance = self._apart(found, self._beside(places), gaps)
            gaps += [abs(one.gap) for one in found[:1]]
            return Nearest(found, distance, max(distance, self._apart(others, elsewhere, gaps)), is_around)
        return Nearest(found, self._beside(places), elsewhere, is_around)

    def _sine(self, t: float, one: Candidate) -> float:
        """Of the angle at which curves cross at a candidate: the smaller it is, the nearer is the next place at which
        they do."""
        contact, ways = self.system.contacts[self.c], []
        for i, contour in enumerate((contact.body1.contour, contact.body2.contour)):
            slope = contour.evaluate(one.location[2 * i : 2 * i + 1].tolist(), t, one.charts[i])[1]
            ways.append(self.system.frames[2 * self.c + i, :3] @ slope / np.linalg.norm(slope))
        return float(np.linalg.norm(np.cross(*ways)))

    def _apart(self, found: list[Candidate], apart: float, gaps: list[float]) -> float:
        """How far in m curves that cross are apart beside places with these gaps, where these are all others that there
        are: more than cells tell, `apart`, where they are near; and no more than it takes until others may be there
        beside those places."""
        distance = max(apart, min((abs(one.gap) for one in found), default=self.neighbourhood))
        return min(distance, max(self.neighbourhood, min(gaps, default=math.inf)))

    def distance(self, t: float, taken: Sequence[np.ndarray]) -> float:
        """`Nearest.distance` alone, for which no stationary points are looked for."""
        self._survey_at(t)
        return self._beside([pair[1 - self.side] for pair in taken])

    def _survey_at(self, t: float) -> None:
        """Look, but not again for each of several contacts of the same contours."""
        state = t, self.system.frames[2 * self.c : 2 * self.c + 2, : ORIGIN + 1].tobytes()
        if state != self._state:
            self._state, self._survey, self._found = state, self._look(t), None

    def _beside(self, places: list[np.ndarray]) -> float:
        """The least distance of points in m that are in no neighbourhood of places (3,) in the world."""
        survey = self._survey
        away = np.ones(len(survey.points), dtype=bool)
        for place in places:
            way = np.linalg.norm(survey.points - self.on_divided(place), axis=1)
            away &= way > self.neighbourhood + survey.reaches
        return min(float(survey.least[away].min(initial=math.inf)), survey.resolved)

    def _look(self, t: float) -> _Survey:
        """The cells that are near, wherever other contacts are."""
        if self.whole.contour.time_dependent:
            self.whole = _whole(self.whole.contour, t)
            put_samples(self._cells, self.whole.tree)
        whole, cells, (rotation, centre) = self.whole, self._cells, self.pose()
        # in one step a body meets nothing that is farther off than it is large; a point, than a part of the ground is
        large = max(whole.size, _SEEN * self.system.contact_real[self.c, LENGTH])
        beyond = min(_NEIGHBOURHOOD * self.bend, large)
        cells.numbers["time"], cells.numbers["beyond"] = t, beyond
        cells.numbers["around"], cells.numbers["finest"] = whole.radius, FINEST * self.bend
        cells.box[: self.divided.dimension] = self._box(t, centre, beyond)
        cells.pose[:3], cells.pose[3], cells.pose[4] = rotation, centre, whole.centre
        near_cells(cells.address)
        sharpest = float(cells.numbers["sharpest"])
        # no larger than what has been looked at tells
        self.bend = min(self._bend(1.0 / sharpest if sharpest > 0.0 else math.inf), _GROWTH * beyond / _NEIGHBOURHOOD)
        count = int(cells.counts["cells"])
        points, reaches = cells.points[:count].copy(), cells.reaches[:count].copy()
        distances = cells.distances[:count] - whole.rounding
        least = np.maximum(distances - reaches - whole.radius, 0.0)
        # what is farther than that has been left out
        return _Survey(points, reaches, distances, least, float(distances.min()) + beyond)

    def _find(self, t: float) -> tuple[list[Candidate], bool]:
        """Candidates from the cells of the survey, the nearest first, and see `Nearest.is_around`."""
        whole, cells, neighbourhood = self.whole, self._cells, self.neighbourhood
        points, reaches, distances, least, _ = self._survey
        nearest = cells.order[cells.pairs[: len(points)]]
        cells.numbers["apart"] = neighbourhood
        lowest_cells(cells.address)
        starts = [(i, int(nearest[i])) for i in cells.lowest[: int(cells.counts["lowest"])].tolist()]
        if (distances + whole.rounding <= reaches + whole.radius).any():
            starts += self._deepest(points, neighbourhood)
        found, are_singular = self._candidates(t, starts)
        known = _nearest_of(found)
        if known > float(distances.min()) + whole.rounding and self._winds_around():
            every, singular = self._candidates(t, self._along(t, points))
            found = [one for one in every if one.gap > -neighbourhood]
            known, are_singular = _nearest_of(found), are_singular or singular
        # what is nearer than cells tell may be where a regular nearest point is
        touches = least.min() == 0.0 and known > float(reaches.max() + whole.radius)
        is_around = are_singular and not any(one.gap < 0.0 for one in found) and self._touch(t, distances, touches)
        return found, is_around

    def _touch(self, t: float, distances: np.ndarray, touches: bool) -> bool:
        """Whether bodies that have singular nearest points only touch, or are inside each other, and not just beyond an
        end of either contour: what is round, from whose surface its cells have these distances (n,), or samples
        behind a graph, or, of others, what cells tell: touches."""
        if len(self.whole.points) == 1 and self.whole.rounding == 0.0:
            return False
        i = int(np.argmin(distances))
        depth, place, margin = -distances[i], self._cells.middles[i], self._cells.halves[i]
        if self.whole.rounding == 0.0 and isinstance(self.divided, (Plane, HeightField)):
            rotation, centre = self.pose()
            samples = (self.whole.points - self.whole.centre) @ rotation.T + centre
            below = evaluated(self.divided, samples[:, :2], t)[:, 0, 2] - samples[:, 2]
            # a graph that is body 1 has the other body on any side
            sides = (1, -1) if self.side == 1 else (int(self.system.contact_int[self.c, SIDE]),)
            depths = min((side * below for side in sides), key=np.max)
            i = int(np.argmax(depths))
            depth, place, margin = depths[i], samples[i], np.full(2, depths[i])
        elif self.whole.rounding == 0.0:
            depth = math.inf if touches and not self._is_beside_ends(t, i) else 0.0
        ends = zip(place, margin, self.divided.domain, self.divided.periodic)
        within = all(wraps or low + near < u < high - near for u, near, (low, high), wraps in ends)
        return within and bool(depth > SAME_PLACE * self.system.contact_real[self.c, LENGTH])

    def _is_beside_ends(self, t: float, cell: int) -> bool:
        """Whether two contours with ends, of which cells tell that they may touch, do not: downhill from this cell and
        the sample next to it they come to an end, or, of curves, stay apart."""
        both, (rotation, centre), own = (self.divided, self.whole.core), self.pose(), self.divided.dimension
        if not np.isfinite([*both[0].ends(), *both[1].ends()]).any():
            return False
        sample = int(self._cells.order[self._cells.pairs[cell]])
        start = [*self._cells.middles[cell, :own], *self.whole.parameters[sample, : both[1].dimension]]
        axes = [(each, a) for each in both for a in range(each.dimension)]
        endless = (-math.inf, math.inf)
        low, high = np.array([endless if each.periodic[a] else each.domain[a] for each, a in axes]).T

        def values(place: np.ndarray) -> list[np.ndarray]:
            parts = zip(both, (place[:own], place[own:]))
            return [evaluated(each, u.reshape(1, -1), t)[0] for each, u in parts]

        def way(place: np.ndarray) -> np.ndarray:
            first, second = values(place)
            return first[0] - rotation @ (second[0] - self.whole.centre) - centre

        def slopes(place: np.ndarray) -> np.ndarray:
            first, second = values(place)
            return np.hstack([first[1 : 1 + own].T, -rotation @ second[1 : 1 + both[1].dimension].T])

        def nearest_within(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, float]:
            bounds, tight = (low, high), {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
            found = scipy.optimize.least_squares(way, np.clip(start, low, high), slopes, bounds, **tight)
            return found.x, float(np.linalg.norm(found.fun))

        place, distance = nearest_within(low, high)
        same, wide = (
            SAME_PLACE * self.system.contact_real[self.c, LENGTH],
            np.where(np.isfinite(high - low), high - low, 0),
        )
        # what is inside a surface is apart from it, too
        if distance > same and len(axes) == 2:
            return True
        # a distance that is least to its square does not know its place better
        at_low, at_high = (np.abs(place - end) <= math.sqrt(SAME_PLACE) * wide for end in (low, high))
        if not (at_low | at_high).any():
            return False
        # what is as near farther inside touches along a line
        inside = low + _INSIDE * wide * at_low, high - _INSIDE * wide * at_high
        return nearest_within(*inside)[1] > distance + same

    def _box(self, t: float, centre: np.ndarray, beyond: float) -> list[tuple[float, float]]:
        """The part of the divided contour's domain that what is near must be in."""
        contour, side = self.divided, 1 - self.side
        flat = isinstance(contour, (Plane, HeightField))
        around = centre[:2].copy() if flat else self.system.location[self.c, 2 * side : 2 * side + 2].copy()
        for a, (low, high) in enumerate(contour.domain):
            around[a] = min(max(around[a], low), high)
        values = contour.evaluate(around[: contour.dimension], t)
        reach = float(np.linalg.norm(values[0] - centre)) + 2.0 * self.whole.extent + beyond
        box = []
        for a, (low, high) in enumerate(contour.domain):
            if flat:
                # its parameters are lengths over its frame's plane
                low, high = max(low, around[a] - reach), min(high, around[a] + reach)
            elif not (math.isfinite(low) and math.isfinite(high)):
                low, high = ends_within(contour, a, t, centre, reach)
            box.append((low, high))
        return box

    def _deepest(self, points: np.ndarray, most: float) -> list[tuple[int, int]]:
        """Where bodies may be inside each other, by up to so much in m: of the divided contour's points (n, 3) and the
        whole one's samples, pairs in which these are farther away than their neighbours."""
        whole, (rotation, centre) = self.whole, self.pose()
        if len(whole.points) == 1:
            return []
        samples = (whole.points - whole.centre) @ rotation.T + centre
        distances, nearest = scipy.spatial.cKDTree(points).query(samples, distance_upper_bound=most)
        field = np.where(np.isinf(distances), -math.inf, distances).reshape(whole.counts)
        highest = np.flatnonzero((scipy.ndimage.maximum_filter(field, 3) == field).ravel() & np.isfinite(distances))
        order = highest[np.argsort(-distances[highest])]
        return [(int(nearest[i]), i) for i in spaced(samples, order, most, _STARTS)]

    def _winds_around(self) -> bool:
        """Whether the whole contour is a closed curve, or has one for a core, which may be as far from the divided one
        all along, but for less than cells tell: a hoop around a ball."""
        return self.whole.core.dimension == 1 and not np.isfinite([*self.whole.core.ends(), *self.divided.ends()]).any()

    def _along(self, t: float, points: np.ndarray) -> list[tuple[int, int]]:
        """Samples of the whole contour, a curve, that are nearer to the divided one than their neighbours, or farther,
        and its points (n, 3) that are next to them."""
        (rotation, centre), cells = self.pose(), self._cells
        samples = (self.whole.points - self.whole.centre) @ rotation.T + centre
        _, nearest = scipy.spatial.cKDTree(points).query(samples)
        apart = np.empty(len(samples))
        for first in range(0, len(samples), MOST_FEET):
            targets = samples[first : first + MOST_FEET]
            n = cells.counts["feet"] = len(targets)
            cells.targets[:n], cells.feet[:n] = targets, cells.middles[nearest[first : first + n]]
            find_feet(cells.address)
            feet = evaluated(self.divided, cells.feet[:n], t)[:, 0]
            apart[first : first + n] = np.linalg.norm(feet - targets, axis=1)
        before, after = np.roll(apart, 1), np.roll(apart, -1)
        extreme = ((apart <= before) & (apart <= after)) | ((apart >= before) & (apart >= after))
        return [(int(nearest[i]), i) for i in np.flatnonzero(extreme)[:MOST_FEET].tolist()]

    def _candidates(self, t: float, starts: list[tuple[int, int]]) -> tuple[list[Candidate], bool]:
        """Stationary points to which Newton's method leads, the nearest first, and whether any are singular. starts:
        cells and samples of the whole contour."""
        whole, cells, (rotation, centre) = self.whole, self._cells, self.pose()
        system, single, c, n = self.system, self._single, self.c, len(starts)
        single.q[:], single.v[:] = system.q, system.v
        single.contact_int[0, MODE], single.contact_int[0, SIDE] = FRICTIONLESS, system.contact_int[c, SIDE]
        single.contact_int[0, DETERMINANT_SIGN] = 0
        numbers, samples = np.array(starts).T
        cells.targets[:n] = (whole.points[samples] - whole.centre) @ rotation.T + centre
        cells.feet[:n], cells.counts["feet"] = cells.middles[numbers], n
        find_feet(cells.address)
        places = np.zeros((n, 4))
        own, other = slice(2 * self.side, 2 * self.side + 2), slice(2 - 2 * self.side, 4 - 2 * self.side)
        places[:, other], places[:, own] = cells.feet[:n], whole.parameters[samples]
        if whole.rounding > 0.0:
            places[:, own] = self._facing(evaluated(self.divided, cells.feet[:n], t)[:, 0])
        side = int(system.contact_int[c, SIDE])
        sides = (0, side) if system.contacts[c].body1.contour.dimension > 0 else (-1, 0, 1)
        every, statuses = stationary_points(single, t, places, [1] * n)
        found = [one for one in every if one.side in sides]
        if self.crosses:
            # which their shapes do not decide: that on which gaps are measured
            found = [replace(one, side=side) for one in found]
        found.sort(key=lambda one: float(np.linalg.norm(one.points[1] - one.points[0])))
        return found, SINGULAR in statuses

    def _facing(self, points: np.ndarray) -> np.ndarray:
        """Parameters (n, 2) of the whole contour, which has a core, at which it faces points (n, 3) in the divided
        one's frame."""
        rotation, centre = self.pose()
        x, y, z = ((points - centre) @ rotation + self.whole.centre).T
        along = z if isinstance(self.whole.contour, Cylinder) else np.arctan2(z, np.hypot(x, y) - self.whole.core.size)
        return np.stack([np.arctan2(y, x), along], axis=1)


def _nearest_of(found: list[Candidate]) -> float:
    """Distance in m of the points of the nearest one of candidates."""
    return min((float(np.linalg.norm(one.points[1] - one.points[0])) for one in found), default=math.inf)


def least_whole(contours: tuple[Contour, Contour], t: float) -> tuple[int, Whole] | None:
    """The smaller one of the contours that are bounded, and its side; None where none is. Of cylinders it is the
    thinner one, which may be within the other, but not the other within it."""
    bounded = [side for side in (0, 1) if np.isfinite(contours[side].domain).all()]
    if len(bounded) == 2 and all(isinstance(each, Cylinder) and each.periodic[0] for each in contours):
        side = int(contours[1].shape[0] < contours[0].shape[0])
        return side, _whole(contours[side], 0.0, True)
    wholes = [(side, _whole(contours[side], _instant(contours[side], t))) for side in bounded]
    return min(wholes, key=lambda found: found[1].size, default=None)


def is_searched(system: Workspace, c: int) -> bool:
    """Whether the nearest points of a contact have to be looked for: where no closed form gives them, or not while axes
    are parallel, and where lines do not cross, which are near each other at one place only."""
    contact, integers = system.contacts[c], system.contact_int[c]
    are_straight = contact.body1.contour.kind == contact.body2.contour.kind == LINE
    crosses = integers[PATTERN] == CROSSING_CURVES and are_straight
    return bool(integers[CLOSED_FORM] in (NO_CLOSED_FORM, CYLINDERS) and not crosses)


def crosses_anywhere(system: Workspace, c: int) -> bool:
    """Whether contact c is of curves that cross, which may be on one side of each other here and on the other one
    there: what comes near, at any of its places, is to touch there."""
    return bool(system.contact_int[c, PATTERN] == CROSSING_CURVES and is_searched(system, c))


def _cells(box: list[tuple[float, float]] | tuple[tuple[float, float], ...], counts: tuple[int, ...]):
    """Centres (n, 2) of equal cells of a box of parameters, and half their sizes (2,)."""
    axes, half = [], np.zeros(2)
    for a, (low, high) in enumerate(box):
        half[a] = 0.5 * (high - low) / counts[a]
        axes.append(low + half[a] * (2.0 * np.arange(counts[a]) + 1.0))
    return grid(axes), half


def _reaches(values: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Radii of cells around samples (n, 10, 3)."""
    return LONGER * (half[0] * np.linalg.norm(values[:, 1], axis=1) + half[1] * np.linalg.norm(values[:, 2], axis=1))
