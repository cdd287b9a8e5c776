"""The nearest points of two contours that are apart, wherever they are, and what is known of all others.

Contours are covered by cells: samples, each with a radius within which all points of its cell lie. What is farther than
the nearest sample, less its radius, is left out, the rest divided; Newton's method goes on from the best samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from ..contours import Contour, HeightField, Plane, Sphere
from ..layout import CLOSED_FORM, DETERMINANT_SIGN, FRICTIONLESS, MODE, PATTERN, SIDE
from ..workspace import Workspace
from .carriers import ORIGIN
from .location import NO_CLOSED_FORM
from .patterns import CROSSING_CURVES
from .search import Candidate, evaluated, grid, refine, spaced

# Cells of a curve and along each parameter of a surface to begin with, how often they are divided, and how many are.
_CURVE_CELLS, _SURFACE_CELLS = 128, 24
_DIVISIONS, _MOST_CELLS = 12, 4096
# Samples of the contour that is taken as a whole.
_WHOLE_CURVE, _WHOLE_SURFACE = 192, (48, 24)
# What tangents within a cell are longer by than the longest that was seen.
_LONGER = 1.2
# Starts of Newton's method, and cells that are resolved, relative to the distance and to the radius of curvature.
_STARTS = 6
_FINE, _FINEST = 0.05, 0.05
# Steps of Newton's method from the best samples to the points of their contour that are nearest to the other one's.
_FOOT_STEPS = 4
# Radius of the neighbourhood of a nearest point that has no other one, in radii of curvature.
_NEIGHBOURHOOD = 0.5
# Radii of curvature beyond this, in m, count as this.
_LARGEST = 100.0
# Part of the bends that may be sharper than the radius of curvature that counts: those of poles are the parameters'.
_SHARPEST = 0.9


@dataclass(frozen=True)
class Nearest:
    """What a search has found. candidates: stationary points, the nearest first; distance: of any points of the
    contours, at least; elsewhere: of any points outside the first candidate's neighbourhood, at least; in m."""

    candidates: list[Candidate]
    distance: float
    elsewhere: float

    @property
    def candidate(self) -> Candidate | None:
        """The nearest stationary point, None without any."""
        return self.candidates[0] if self.candidates else None


class Whole:
    """A contour of finite extent as samples. points (n, 3), parameters (n, 2), counts: samples along each parameter,
    radius: of a sample's cell, in m; centre (3,), extent: of a ball around it, in m; rounding: radius of a ball whose
    centre stands for it."""

    def __init__(self, contour: Contour, t: float) -> None:
        self.contour, self.rounding = contour, 0.0
        self.counts: tuple[int, ...] = (1,)
        self.parameters, self.points, self.radius = np.zeros((1, 2)), np.zeros((1, 3)), 0.0
        if isinstance(contour, Sphere):
            self.rounding = contour.shape[0]
        elif contour.dimension > 0:
            counts = (_WHOLE_CURVE,) if contour.dimension == 1 else _WHOLE_SURFACE
            self.counts = counts
            centres, half = _cells(contour.domain, counts)
            values = evaluated(contour, centres, t)
            self.parameters, self.points = centres, values[:, 0]
            self.radius = float(_reaches(values, half).max())
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        self.centre = 0.5 * (low + high)
        self.extent = float(np.linalg.norm(self.points - self.centre, axis=1).max()) + self.radius

    @cached_property
    def tree(self) -> scipy.spatial.cKDTree:
        """Finds the samples nearest to points in the contour's frame."""
        return scipy.spatial.cKDTree(self.points)

    @property
    def size(self) -> float:
        """Radius in m of a ball around all of it."""
        return self.extent + self.rounding


def bend(contour: Contour, t: float) -> float:
    """Least radius of curvature in m of a contour, poles of its parameters left out; infinite for what is straight."""
    if contour.dimension == 0:
        return math.inf
    if isinstance(contour, Sphere):
        return contour.shape[0]
    box = [(max(low, -_window(contour)), min(high, _window(contour))) for low, high in contour.domain]
    centres, _ = _cells(box, (_CURVE_CELLS,) if contour.dimension == 1 else (_SURFACE_CELLS,) * 2)
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

    whole, divided: these contours; side: of the whole one, 0 or 1; bend: least radius of curvature of both, in m.
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
        own, other = bend(self.whole.contour, t), bend(self.divided, t)
        self.bend = min(own, other, _LARGEST)
        if len(self.whole.points) == 1:
            # of points and balls nothing else can come near than what is; in a hollow, what is left of its radius
            self.bend = min(max(other - self.whole.size, 0.5 * min(own, other)), _LARGEST)
        self._single = system.alone(c)

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotation of the whole contour's frame in that of the divided one, and its centre there, as last evaluated."""
        own, other = self.system.frames[2 * self.c + self.side], self._frame()
        rotation = other[:3].T @ own[:3]
        return rotation, other[:3].T @ (own[ORIGIN] - other[ORIGIN]) + rotation @ self.whole.centre

    def _frame(self) -> np.ndarray:
        """The divided contour's frame, as last evaluated."""
        return self.system.frames[2 * self.c + 1 - self.side]

    def search(self, t: float) -> Nearest:
        """The nearest points at the system's (q, v)."""
        if self.whole.contour.time_dependent:
            self.whole = Whole(self.whole.contour, t)
        whole, (rotation, centre) = self.whole, self.pose()
        neighbourhood = _NEIGHBOURHOOD * self.bend
        parameters, points, reaches = self._patch(t, centre, neighbourhood)
        distances, pair = whole.tree.query((points - centre) @ rotation + whole.centre)
        distances = distances - whole.rounding
        least = np.maximum(distances - reaches - whole.radius, 0.0)
        starts = [(int(i), int(pair[i])) for i in spaced(points, np.argsort(distances), neighbourhood, _STARTS)]
        if not least.all():
            starts += self._deepest(points, neighbourhood)
        found = self._candidates(t, parameters, starts)
        distance = float(least.min())
        if not found:
            return Nearest([], distance, distance)
        frame = self._frame()
        at = frame[:3].T @ (found[0][1] - frame[ORIGIN])
        away = np.linalg.norm(points - at, axis=1) > neighbourhood + reaches
        elsewhere = min(float(least[away].min(initial=math.inf)), float(distances.min()) + neighbourhood)
        return Nearest([candidate for candidate, _ in found], distance, elsewhere)

    def _patch(self, t: float, centre: np.ndarray, beyond: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cells of the divided contour that may be nearest to the whole one, or farther than that by `beyond` in m:
        parameters (n, 2), points (n, 3) in its frame, and radii (n,)."""
        contour, extent = self.divided, self.whole.extent
        counts = (_CURVE_CELLS,) if contour.dimension == 1 else (_SURFACE_CELLS,) * 2
        centres, half = _cells(self._box(t, centre, beyond), counts)
        values = evaluated(contour, centres, t)
        longest = [_LONGER * np.linalg.norm(values[:, 1 + a], axis=1).max() for a in range(contour.dimension)]
        halves = np.tile(half, (len(centres), 1))
        points = values[:, 0]
        for _ in range(_DIVISIONS):
            reaches = sum(longest[a] * halves[:, a] for a in range(contour.dimension))
            distances = np.linalg.norm(points - centre, axis=1)
            nearest = float((distances + reaches).min())
            kept = distances - reaches <= nearest + 2.0 * extent + beyond
            centres, halves, points, reaches = centres[kept], halves[kept], points[kept], reaches[kept]
            gap = max(nearest - extent, 0.0)
            coarse = reaches > max(_FINE * gap, _FINEST * self.bend)
            if not coarse.any() or len(centres) + 3 * coarse.sum() > _MOST_CELLS:
                break
            parts = _divided(centres[coarse], halves[coarse], contour.dimension)
            fresh = evaluated(contour, parts[0], t)[:, 0]
            centres = np.concatenate([centres[~coarse], parts[0]])
            halves = np.concatenate([halves[~coarse], parts[1]])
            points = np.concatenate([points[~coarse], fresh])
        reaches = np.asarray(sum(longest[a] * halves[:, a] for a in range(contour.dimension)))
        return centres, points, reaches

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
            if flat or not np.isfinite(contour.domain[a]).all():
                # a field's own parameters are lengths; others are as long as they are where it is touched
                width = reach / (1.0 if flat else max(float(np.linalg.norm(values[1 + a])), 1e-12))
                low, high = max(low, around[a] - width), min(high, around[a] + width)
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

    def _candidates(
        self, t: float, parameters: np.ndarray, starts: list[tuple[int, int]]
    ) -> list[tuple[Candidate, np.ndarray]]:
        """Stationary points to which Newton's method leads, the nearest first, with the divided contour's points (3,)
        in the world. starts: places in parameters (n, 2) of that, and samples of the whole one."""
        whole, (rotation, centre) = self.whole, self.pose()
        system, single, c = self.system, self._single, self.c
        single.q[:], single.v[:] = system.q, system.v
        single.contact_int[0, MODE], single.contact_int[0, SIDE] = FRICTIONLESS, system.contact_int[c, SIDE]
        single.contact_int[0, DETERMINANT_SIGN] = 0
        side = int(system.contact_int[c, SIDE])
        candidates: list[tuple[float, Candidate, np.ndarray]] = []
        own, other = slice(2 * self.side, 2 * self.side + 2), slice(2 - 2 * self.side, 4 - 2 * self.side)
        cells, samples = np.array(starts).T
        # what is inside a ball that stands for a contour is as far from it as its surface
        targets = (whole.points[samples] - whole.centre) @ rotation.T + centre
        for place, foot, sample in zip(*self._feet(parameters[cells], targets, t), samples):
            start = np.zeros(4)
            start[other] = place
            if isinstance(whole.contour, Sphere):
                start[own] = self._facing(foot)
            else:
                start[own] = whole.parameters[sample]
            found = refine(single, t, start, 1, set())
            if found is None or (found.side not in (0, side) and system.contacts[c].body1.contour.dimension > 0):
                continue
            touching = single.frames[:, ORIGIN] + single.derivatives[:2, 0]
            candidates.append((float(np.linalg.norm(touching[1] - touching[0])), found, touching[1 - self.side]))
        return [(found, point) for _, found, point in sorted(candidates, key=lambda each: each[0])]

    def _feet(self, u: np.ndarray, targets: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (n, 2) of the divided contour near u and their points (n, 3), nearer to targets (n, 3) in its
        frame: Newton's method, in which a surface's curvature counts where it keeps steps short."""
        contour, k = self.divided, self.divided.dimension
        low, high = np.array(contour.domain).reshape(k, 2).T
        u, least = u.copy(), np.full(len(u), math.inf)
        found, points = u.copy(), np.zeros_like(targets)
        for _ in range(_FOOT_STEPS):
            values = evaluated(contour, u, t)
            away = targets - values[:, 0]
            squares = np.einsum("ni,ni->n", away, away)
            nearer = squares < least
            if not nearer.any():
                break
            found[nearer], points[nearer], least[nearer] = u[nearer], values[nearer, 0], squares[nearer]
            bent = -np.einsum("nai,ni->na", values[:, 3:6], away)[:, [[0, 1], [1, 2]]][:, :k, :k]
            stretches, axes = np.linalg.eigh(bent)
            tangents = values[:, 1 : 1 + k]
            hessian = tangents @ np.swapaxes(tangents, 1, 2)
            hessian += (axes * np.maximum(stretches, 0.0)[:, None, :]) @ np.swapaxes(axes, 1, 2)
            step = np.linalg.pinv(hessian, hermitian=True) @ (tangents @ away[:, :, None])
            u[:, :k] = np.clip(u[:, :k] + step[:, :, 0], low, high)
        return found, points

    def _facing(self, point: np.ndarray) -> tuple[float, float]:
        """Parameters of the ball that is the whole contour at which it faces a point in the divided one's frame."""
        rotation, centre = self.pose()
        x, y, z = rotation.T @ (point - centre)
        return math.atan2(y, x), math.atan2(z, math.hypot(x, y))


def least_whole(contours: tuple[Contour, Contour], t: float) -> tuple[int, Whole] | None:
    """The smaller one of the contours that are bounded, and its side; None where none is."""
    bounded = [side for side in (0, 1) if np.isfinite(contours[side].domain).all()]
    wholes = [(side, Whole(contours[side], t)) for side in bounded]
    return min(wholes, key=lambda found: found[1].size, default=None)


def is_searched(system: Workspace, c: int) -> bool:
    """Whether the nearest points of a contact have to be looked for: where no closed form gives them."""
    integers = system.contact_int[c]
    return bool(integers[CLOSED_FORM] == NO_CLOSED_FORM and integers[PATTERN] != CROSSING_CURVES)


def _cells(box: list[tuple[float, float]] | tuple[tuple[float, float], ...], counts: tuple[int, ...]):
    """Centres (n, 2) of equal cells of a box of parameters, and half their sizes (2,)."""
    axes, half = [], np.zeros(2)
    for a, (low, high) in enumerate(box):
        half[a] = 0.5 * (high - low) / counts[a]
        axes.append(low + half[a] * (2.0 * np.arange(counts[a]) + 1.0))
    return grid(axes), half


def _divided(centres: np.ndarray, halves: np.ndarray, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    smaller, signs = 0.5 * halves, grid([np.array([-1.0, 1.0])] * dimension)
    return np.concatenate([centres + smaller * sign for sign in signs]), np.tile(smaller, (len(signs), 1))


def _reaches(values: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Radii of cells around samples (n, 10, 3)."""
    return _LONGER * (half[0] * np.linalg.norm(values[:, 1], axis=1) + half[1] * np.linalg.norm(values[:, 2], axis=1))
