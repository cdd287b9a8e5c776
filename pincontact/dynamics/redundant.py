"""Forces of contacts that stick redundantly: one inside all cones, where there is any.

The accelerations do not depend on the choice among redundant forces, but whether the contacts can hold does: the
least-norm forces may leave their cones while others do not. Admissible forces are a convex set; its point taken here is
the analytic centre (Boyd, Vandenberghe, Convex Optimization, Sec. 8.5), held back from growing without bound by a
quadratic term: it is unique, depends smoothly on the loads, and is as far as can be from where something would slip.

Loads change, and the centre with them: the choice follows its tangent. As loads come near what the contacts can carry,
the admissible forces shrink to a point. The centres are then a central path, smooth to its end as a rule (Halicka,
European Journal of Operational Research 143, 2002, for semidefinite programs), so that of the way to the limit a choice
along the tangent leaves about the square of what the last left; a constant one leaves a fixed part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# A null direction: unit rows that combine to less than this (the square root of the kernels' rank tolerance).
_NULL = 3e-6
# Forces count as admissible if they are inside their cones by this fraction of the largest force.
_INSIDE = 1e-9
_NEWTON_STEPS = 60
_SHARPENING = 8.0
_BACKTRACKS = 50
_CONVERGED = 1e-9
# Part of the way to the nearest boundary that a step may go.
_TO_BOUNDARY = 0.95
# Size of the forces of interest, relative to those of least norm.
_LARGEST = 1e3
# Normal forces that the choice changes by less than this part of others are not redundant.
_FIXED = 1e-9
_SIGNS = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Cone:
    """factor x[normal] + offset >= |x[tangents]|, of forces x; or of a number alone, where there are no tangents."""

    normal: int
    factor: float
    offset: float
    tangents: tuple[int, ...] = ()


@dataclass(frozen=True)
class Choice:
    """The central forces (n,) at some loads, and how they follow these.

    slope (n, r): what is added to forces of least norm that change by `span` y, y (r,); it acts on nothing.
    span (n, r): orthonormal, the directions of forces of least norm.
    """

    forces: np.ndarray
    slope: np.ndarray
    span: np.ndarray


def null_space(directions: np.ndarray) -> np.ndarray:
    """(n, k) combinations of the n force directions (n, nv) that act on nothing, k may be 0."""
    sizes = np.linalg.norm(directions, axis=1)
    sizes[sizes == 0.0] = 1.0
    left, singular, _ = np.linalg.svd(directions / sizes[:, None])
    rank = int(np.sum(singular > _NULL))
    return left[:, rank:] / sizes[:, None]


def central_force(forces: np.ndarray, null: np.ndarray, cones: list[Cone]) -> Choice | None:
    """The central one of the forces `forces` + `null` z inside all cones; None where there is none (but on the rim).

    forces: (n,); null: (n, k) from `null_space`. Phase one lowers the amount by which all cones are enlarged until it
    is negative, phase two centres; both by Newton's method on the cones' logarithmic barriers.
    """
    largest = float(np.abs(forces).max(initial=0.0))
    if null.shape[1] == 0 or largest == 0.0 or not cones:
        return None
    # one scale for all: the quadratic term then does not depend on the basis, and keeps the symmetries of the scene
    null = null / np.abs(null).max()
    basis = np.linalg.qr(null, mode="complete")[0]
    span = basis[:, null.shape[1] :]
    # about the least norm, in its units: the centre then is one of the loads alone, whatever was chosen before
    least = span @ (span.T @ forces)
    unit = float(np.linalg.norm(least))
    if unit <= _INSIDE * largest:
        unit = largest
    barriers = _Barriers(cones, least / unit, null, unit)
    if barriers.unloaded():
        return None
    z = np.linalg.lstsq(null, (forces - least) / unit, rcond=None)[0]
    values = barriers.values(z)
    if values.min() <= _INSIDE:
        found = _enter(barriers, z, values)
        if found is None:
            return None
        z = found
    point = _minimise(barriers, np.append(z, 0.0), None)
    z = point[:-1]
    hessian = barriers.derivatives(point)[1][:-1, :-1] + np.eye(z.size)
    # the unit changes along, too
    change = barriers.curvature_along(point, span) - np.outer(2.0 * z, span.T @ (least / unit))
    try:
        response = np.linalg.solve(hessian, change)
    except np.linalg.LinAlgError:
        # on the rim, but for round-off
        return None
    return Choice(least + unit * null @ z, -null @ response, span)


def _enter(barriers: _Barriers, z: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """A point inside all cones (phase one), from one of these distances inside; None where there is none."""
    count = values.size
    # as far outside as the others are inside: the steps to come are of that size
    start = max(float(np.median(np.abs(values))), 10.0 * _INSIDE) - float(values.min())
    point = np.append(z, start)
    pressure = 2.0 * count / start
    before: np.ndarray | None = None
    while True:
        point = _minimise(barriers, point, pressure)
        if point[-1] < -_INSIDE:
            return point[:-1]
        # the least enlargement is lower by no more than the number of logarithms (and the square's part in the
        # balance, for forces of interest) over the pressure
        size = float(np.linalg.norm(point[:-1]))
        within = (2.0 * count + max(size * (_LARGEST - size), 0.0)) / pressure
        if point[-1] > within or within < _INSIDE:
            return None
        pressure *= _SHARPENING
        last, before = before, point
        if last is not None:
            # the path is straight in 1 / pressure, nearly
            point = barriers.towards(point, (point - last) / _SHARPENING)


class _Barriers:
    """-log(s^2 - |t|^2) of all m cones in the variables (z, enlargement), where s and t are affine in them."""

    def __init__(self, cones: list[Cone], forces: np.ndarray, null: np.ndarray, unit: float) -> None:
        m, k = len(cones), null.shape[1]
        # (s, t1, t2) of each cone in terms of forces; a missing tangent is zero
        self.parts = np.zeros((m, 3, forces.size))
        self.start = np.zeros((m, 3))
        for i, cone in enumerate(cones):
            self.parts[i, 0, cone.normal] = cone.factor
            self.start[i, 0] = cone.offset / unit
            for j, tangent in enumerate(cone.tangents):
                self.parts[i, 1 + j, tangent] = 1.0
        self.start += self.parts @ forces
        self.rows = np.zeros((m, 3, k + 1))
        self.rows[:, :, :k] = self.parts @ null
        self.rows[:, 0, k] = 1.0
        self.flat = self.rows.reshape(3 * m, k + 1)

    def at(self, point: np.ndarray) -> np.ndarray:
        """(m, 3) the (s, t1, t2) at a point (z, enlargement)."""
        return self.start + (self.flat @ point).reshape(self.start.shape)

    def values(self, z: np.ndarray) -> np.ndarray:
        """(m,) how far inside each cone."""
        x = self.at(np.append(z, 0.0))
        return x[:, 0] - np.hypot(x[:, 1], x[:, 2])

    def unloaded(self) -> bool:
        """Whether a cone is left with no force by its normal part, whatever the choice."""
        fixed = np.abs(self.rows[:, 0, :-1]).max(axis=1) <= _FIXED
        return bool((self.start[fixed, 0] <= _INSIDE).any())

    def towards(self, point: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The point after that step, or as far along it as is well inside."""
        way = _way(self.at(point), (self.flat @ step).reshape(self.start.shape))
        return point + min(1.0, _TO_BOUNDARY * way) * step

    def derivatives(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (k + 1,) and Hessian of the sum of barriers at a point inside."""
        slopes, curvatures = _derivatives(self.at(point))
        curved = (curvatures @ self.rows).reshape(self.flat.shape)
        return self.flat.T @ slopes.ravel(), self.flat.T @ curved

    def curvature_along(self, point: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(k, r) change of the gradient by z for forces that change along the directions (n, r)."""
        curvatures = _derivatives(self.at(point))[1]
        curved = (curvatures @ (self.parts @ directions)).reshape(-1, directions.shape[1])
        return self.flat[:, :-1].T @ curved


def _derivatives(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (m, 3) and Hessians (m, 3, 3) of the barriers in (s, t1, t2)."""
    inside = _insides(x)
    slopes = -2.0 * (_SIGNS * x) / inside[:, None]
    curvatures = slopes[:, :, None] * slopes[:, None, :] - (2.0 / inside)[:, None, None] * np.diag(_SIGNS)
    return slopes, curvatures


def _insides(x: np.ndarray) -> np.ndarray:
    """(m,) s^2 - |t|^2, without the cancellation near the boundary."""
    length = np.hypot(x[:, 1], x[:, 2])
    return (x[:, 0] - length) * (x[:, 0] + length)


def _way(x: np.ndarray, dx: np.ndarray) -> float:
    """Largest step along dx (m, 3) from x (m, 3) that stays inside all cones, at most 1 / `_TO_BOUNDARY`."""
    a = (dx * dx) @ _SIGNS
    b = (x * dx) @ _SIGNS
    c = _insides(x)
    # a w^2 + 2 b w + c = 0, the least positive root, as c / (-b + sqrt(b^2 - a c)); none where that is not positive.
    # From inside b^2 >= a c; they are equal in cones without tangents, but for rounding.
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    below = root - b
    way = np.divide(c, below, out=np.full_like(c, np.inf), where=below > 0.0)
    return float(min(way.min(), 1.0 / _TO_BOUNDARY))


def _minimise(barriers: _Barriers, point: np.ndarray, pressure: float | None) -> np.ndarray:
    """Newton with backtracking on barriers + |z|^2 / 2 + pressure times the enlargement, which None keeps fixed."""
    free = point.size if pressure is not None else point.size - 1
    force = pressure or 0.0

    def cost(point: np.ndarray, x: np.ndarray) -> float:
        return float(0.5 * (point[:-1] @ point[:-1]) + force * point[-1] - np.log(_insides(x)).sum())

    for _ in range(_NEWTON_STEPS):
        gradient, hessian = barriers.derivatives(point)
        gradient[:-1] += point[:-1]
        gradient[-1] += force
        hessian.flat[: -1 : point.size + 1] += 1.0
        step = np.zeros_like(point)
        try:
            step[:free] = -np.linalg.solve(hessian[:free, :free], gradient[:free])
        except np.linalg.LinAlgError:
            # so near the rim that round-off decides
            break
        decrement = -float(gradient @ step)
        if not decrement > _CONVERGED:
            break
        x = barriers.at(point)
        dx = (barriers.flat @ step).reshape(x.shape)
        size, before = _TO_BOUNDARY * _way(x, dx), cost(point, x)
        for _ in range(_BACKTRACKS):
            after = x + size * dx
            within = bool((after[:, 0] > np.hypot(after[:, 1], after[:, 2])).all())
            if within and cost(point + size * step, after) <= before - 0.1 * size * decrement:
                break
            size *= 0.5
        else:
            break
        point = point + size * step
        if pressure is not None and point[-1] < -_INSIDE:
            break
    return point
