"""The nearest points of two contours that are apart, wherever they are, and what is known of all others.

Contours are covered by cells: samples, each with a radius within which all points of its cell lie. What is farther than
the nearest sample, less its radius, is left out, the rest divided; Newton's method goes on from the best samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from ..contours import Contour, HeightField, Plane, Sphere
from ..layout import CLOSED_FORM, DETERMINANT_SIGN, FRICTIONLESS, MODE, PATTERN, SIDE
from ..workspace import Workspace
from .carriers import ORIGIN
from .location import NO_CLOSED_FORM
from .patterns import CROSSING_CURVES
from .search import Candidate, refine

# Cells of a curve and along each parameter of a surface to begin with, how often they are divided, and how many are.
_CURVE_CELLS, _SURFACE_CELLS = 128, 24
_DIVISIONS, _MOST_CELLS = 12, 4096
# Samples of body 1, which is taken as a whole.
_WHOLE_CURVE, _WHOLE_SURFACE = 192, (48, 24)
# What tangents within a cell are longer by than the longest that was seen.
_LONGER = 1.2
# Starts of Newton's method, and cells that are resolved, relative to the distance and to the radius of curvature.
_STARTS = 6
_FINE, _FINEST = 0.05, 0.05
# Radius of the neighbourhood of a nearest point that has no other one, in radii of curvature.
_NEIGHBOURHOOD = 0.5
# Radii of curvature beyond this, in m, count as this.
_LARGEST = 100.0
# Part of the bends that may be sharper than the radius of curvature that counts: those of poles are the parameters'.
_SHARPEST = 0.9


@dataclass(frozen=True)
class Nearest:
    """What a search has found. candidate: the nearest stationary point, None without any; distance: of any points of
    the contours, at least; elsewhere: of any points outside the candidate's neighbourhood, at least; in m."""

    candidate: Candidate | None
    distance: float
    elsewhere: float


class Whole:
    """A contour of finite extent as samples. points (n, 3), parameters (n, 2), radius: of a sample's cell, in m;
    centre (3,), extent: of a ball around it, in m; rounding: radius of a ball whose centre stands for it."""

    def __init__(self, contour: Contour, t: float) -> None:
        self.rounding = 0.0
        self.parameters, self.points, self.radius = np.zeros((1, 2)), np.zeros((1, 3)), 0.0
        if isinstance(contour, Sphere):
            self.rounding = contour.shape[0]
        elif contour.dimension > 0:
            counts = (_WHOLE_CURVE,) if contour.dimension == 1 else _WHOLE_SURFACE
            centres, half = _cells(contour.domain, counts)
            values = _values(contour, centres, t)
            self.parameters, self.points = centres, values[:, 0]
            self.radius = float(_reaches(values, half).max())
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        self.centre = 0.5 * (low + high)
        self.extent = float(np.linalg.norm(self.points - self.centre, axis=1).max()) + self.radius


def bend(contour: Contour, t: float) -> float:
    """Least radius of curvature in m of a contour, poles of its parameters left out; infinite for what is straight."""
    if contour.dimension == 0:
        return math.inf
    if isinstance(contour, Sphere):
        return contour.shape[0]
    box = [(max(low, -_window(contour)), min(high, _window(contour))) for low, high in contour.domain]
    centres, _ = _cells(box, (_CURVE_CELLS,) if contour.dimension == 1 else (_SURFACE_CELLS,) * 2)
    values = _values(contour, centres, t)
    sharpest = np.zeros(len(values))
    for first, second in ((1, 3), (2, 5))[: contour.dimension]:
        squared = np.einsum("ni,ni->n", values[:, first], values[:, first])
        across = values[:, second] - values[:, first] * (
            np.einsum("ni,ni->n", values[:, first], values[:, second]) / np.maximum(squared, 1e-300)
        ).reshape(-1, 1)
        sharpest = np.maximum(sharpest, np.linalg.norm(across, axis=1) / np.maximum(squared, 1e-300))
    curvature = float(np.quantile(sharpest, _SHARPEST))
    return 1.0 / curvature if curvature > 0.0 else math.inf


def _window(contour: Contour) -> float:
    return contour.size if math.isfinite(contour.size) else 10.0


class NearestSearch:
    """Searches the nearest points of one contact of a system (`dynamics.system`), which is in any state.

    bend: least radius of curvature of both contours, in m. Raises ValueError where body 1 has no finite extent.
    """

    def __init__(self, system: Workspace, c: int, t: float) -> None:
        self.system, self.c = system, c
        contact = system.contacts[c]
        self.one: Contour = contact.body1.contour
        self.two: Contour = contact.body2.contour
        if not all(math.isfinite(low) and math.isfinite(high) for low, high in self.one.domain):
            raise ValueError("body 1 is unbounded.")
        self.whole = Whole(self.one, t)
        own, other, extent = bend(self.one, t), bend(self.two, t), self.whole.extent + self.whole.rounding
        self.bend = min(own, other, _LARGEST)
        if len(self.whole.points) == 1:
            # of points and balls nothing else can come near than what is; in a hollow, what is left of its radius
            self.bend = min(max(other - extent, 0.5 * min(own, other)), _LARGEST)
        self._single = system.alone(c)

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotation of body 1's contour in the frame of body 2's, and its centre there, as last evaluated."""
        one, two = self.system.frames[2 * self.c], self.system.frames[2 * self.c + 1]
        rotation = two[:3].T @ one[:3]
        return rotation, two[:3].T @ (one[ORIGIN] - two[ORIGIN]) + rotation @ self.whole.centre

    def search(self, t: float) -> Nearest:
        """The nearest points at the system's (q, v)."""
        if self.one.time_dependent:
            self.whole = Whole(self.one, t)
        whole, (rotation, centre) = self.whole, self.pose()
        neighbourhood = _NEIGHBOURHOOD * self.bend
        parameters, points, reaches = self._patch(t, centre, neighbourhood)
        pair = np.zeros(len(points), dtype=int)
        if len(whole.points) == 1:
            distances = np.linalg.norm(points - centre, axis=1)
        else:
            turned = (whole.points - whole.centre) @ rotation.T + centre
            distances, pair = scipy.spatial.cKDTree(turned).query(points)
        distances = distances - whole.rounding
        least = np.maximum(distances - reaches - whole.radius, 0.0)
        # what is inside a ball that stands for a contour is as far from it as its surface
        found = self._candidate(t, parameters, points, distances, pair, neighbourhood)
        distance = float(least.min())
        if found is None:
            return Nearest(None, distance, distance)
        two = self.system.frames[2 * self.c + 1]
        at = two[:3].T @ (found.point - two[ORIGIN])
        away = np.linalg.norm(points - at, axis=1) > neighbourhood + reaches
        elsewhere = min(float(least[away].min(initial=math.inf)), float(distances.min()) + neighbourhood)
        return Nearest(found, distance, elsewhere)

    def _patch(self, t: float, centre: np.ndarray, beyond: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cells of body 2 that may be nearest to body 1, or farther than that by `beyond` in m: parameters (n, 2),
        points (n, 3) in its frame, and radii (n,)."""
        contour, extent = self.two, self.whole.extent
        counts = (_CURVE_CELLS,) if contour.dimension == 1 else (_SURFACE_CELLS,) * 2
        centres, half = _cells(self._box(t, centre, beyond), counts)
        values = _values(contour, centres, t)
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
            fresh = _values(contour, parts[0], t)[:, 0]
            centres = np.concatenate([centres[~coarse], parts[0]])
            halves = np.concatenate([halves[~coarse], parts[1]])
            points = np.concatenate([points[~coarse], fresh])
        reaches = np.asarray(sum(longest[a] * halves[:, a] for a in range(contour.dimension)))
        return centres, points, reaches

    def _box(self, t: float, centre: np.ndarray, beyond: float) -> list[tuple[float, float]]:
        """The part of body 2's domain that what is near must be in."""
        contour = self.two
        flat = isinstance(contour, (Plane, HeightField))
        around = centre[:2].copy() if flat else self.system.location[self.c, 2:4].copy()
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

    def _candidate(
        self,
        t: float,
        parameters: np.ndarray,
        points: np.ndarray,
        distances: np.ndarray,
        pair: np.ndarray,
        apart: float,
    ) -> Candidate | None:
        """The nearest of the stationary points to which Newton's method leads from the best samples."""
        system, single, c = self.system, self._single, self.c
        single.q[:], single.v[:] = system.q, system.v
        single.contact_int[0, MODE], single.contact_int[0, SIDE] = FRICTIONLESS, system.contact_int[c, SIDE]
        single.contact_int[0, DETERMINANT_SIGN] = 0
        side = int(system.contact_int[c, SIDE])
        order = np.argsort(distances)
        left, best, shortest = order, None, math.inf
        for _ in range(_STARTS):
            if not left.size:
                break
            first = left[0]
            left = left[np.linalg.norm(points[left] - points[first], axis=1) > apart]
            start = np.zeros(4)
            start[2:] = parameters[first]
            if isinstance(self.one, Sphere):
                start[:2] = self._facing(points[first])
            else:
                start[:2] = self.whole.parameters[pair[first]]
            found = refine(single, t, start, 1, set())
            if found is None or (found.side not in (0, side) and self.one.dimension > 0):
                continue
            difference = single.frames[1, ORIGIN] + single.derivatives[1, 0]
            difference = difference - single.frames[0, ORIGIN] - single.derivatives[0, 0]
            length = float(np.linalg.norm(difference))
            if length < shortest:
                best, shortest = found, length
        return best

    def _facing(self, point: np.ndarray) -> tuple[float, float]:
        """Parameters of the ball that is body 1 at which it faces a point in body 2's frame."""
        rotation, centre = self.pose()
        x, y, z = rotation.T @ (point - centre)
        return math.atan2(y, x), math.atan2(z, math.hypot(x, y))


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
    if len(axes) == 1:
        return np.column_stack([axes[0], np.zeros_like(axes[0])]), half
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2), half


def _divided(centres: np.ndarray, halves: np.ndarray, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    smaller = 0.5 * halves
    signs = [(-1, 0), (1, 0)] if dimension == 1 else [(-1, -1), (-1, 1), (1, -1), (1, 1)]
    return (
        np.concatenate([centres + smaller * np.array(sign) for sign in signs]),
        np.concatenate([smaller] * len(signs)),
    )


def _values(contour: Contour, parameters: np.ndarray, t: float) -> np.ndarray:
    return contour.evaluate_many(parameters[:, : contour.dimension], t)


def _reaches(values: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Radii of cells around samples (n, 10, 3)."""
    return _LONGER * (half[0] * np.linalg.norm(values[:, 1], axis=1) + half[1] * np.linalg.norm(values[:, 2], axis=1))
