"""Forces of contacts that stick redundantly: one inside all cones, where there is any.

The accelerations do not depend on the choice among redundant forces, but whether the contacts can hold does: the
least-norm forces may leave their cones while others do not. Admissible forces are a convex set; its point taken here is
the analytic centre (Boyd, Vandenberghe, Convex Optimization, Sec. 8.5), held back from growing without bound by a
quadratic term: it is unique, depends smoothly on the loads, and is as far as can be from where something would slip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

# A null direction: unit rows that combine to less than this (the square root of the kernels' rank tolerance).
_NULL = 3e-6
# Forces count as admissible if they are inside their cones by this fraction of the largest force.
_INSIDE = 1e-9
_NEWTON_STEPS = 60
_SHARPENINGS = 14
_SHARPENING = 8.0
_BACKTRACKS = 50
_CONVERGED = 1e-9
# Half the square of the largest force of interest, relative to those given.
_SQUARE = 50.0


@dataclass(frozen=True)
class Cone:
    """factor x[normal] + offset >= |x[tangents]|, of forces x; or of a number alone, where there are no tangents."""

    normal: int
    factor: float
    offset: float
    tangents: tuple[int, ...] = ()


def null_space(directions: np.ndarray) -> np.ndarray:
    """(n, k) combinations of the n force directions (n, nv) that act on nothing, k may be 0."""
    sizes = np.linalg.norm(directions, axis=1)
    sizes[sizes == 0.0] = 1.0
    left, singular, _ = np.linalg.svd(directions / sizes[:, None])
    rank = int(np.sum(singular > _NULL))
    return left[:, rank:] / sizes[:, None]


def central_force(forces: np.ndarray, null: np.ndarray, cones: list[Cone]) -> np.ndarray | None:
    """The central one of the forces `forces` + `null` z inside all cones; None where there is none (but on the rim).

    forces: (n,); null: (n, k) from `null_space`. Phase one lowers the amount by which all cones are enlarged until it
    is negative, phase two centres; both by Newton's method on the cones' logarithmic barriers.
    """
    unit = float(np.abs(forces).max(initial=0.0))
    if null.shape[1] == 0 or unit == 0.0 or not cones:
        return None
    # one scale for all: the quadratic term then does not depend on the basis, and keeps the symmetries of the scene
    null = null / np.abs(null).max()
    parts = [_Barrier(cone, forces / unit, null, unit) for cone in cones]
    worst = min(part.value(np.zeros(null.shape[1])) for part in parts)
    z = np.zeros(null.shape[1] + 1)
    z[-1] = max(0.0, 1.0 - worst) if worst <= _INSIDE else 0.0
    if worst <= _INSIDE:
        pressure = 1.0
        for _ in range(_SHARPENINGS):
            z = _minimise(parts, z, pressure)
            if z[-1] < -_INSIDE:
                break
            # the least enlargement is lower by no more than the number of logarithms (and the square) over the pressure
            if z[-1] > (2.0 * len(parts) + _SQUARE) / pressure:
                return None
            pressure *= _SHARPENING
        else:
            return None
        z[-1] = 0.0
    z = _minimise(parts, z, None)
    return forces + unit * null @ z[:-1]


class _Barrier:
    """-log(s^2 - |t|^2) of one cone in the variables (z, enlargement)."""

    def __init__(self, cone: Cone, forces: np.ndarray, null: np.ndarray, unit: float) -> None:
        k = null.shape[1]
        self.rows = np.zeros((1 + len(cone.tangents), k + 1))
        self.rows[0, :k], self.rows[0, k] = cone.factor * null[cone.normal], 1.0
        self.start = np.zeros(1 + len(cone.tangents))
        self.start[0] = cone.factor * forces[cone.normal] + cone.offset / unit
        for i, tangent in enumerate(cone.tangents):
            self.rows[1 + i, :k], self.start[1 + i] = null[tangent], forces[tangent]
        self.signs = np.ones(1 + len(cone.tangents))
        self.signs[1:] = -1.0

    def value(self, z: np.ndarray) -> float:
        """How far inside the cone."""
        x = self.start + self.rows[:, : z.size] @ z
        return float(x[0] - np.linalg.norm(x[1:]))

    def barrier(self, z: np.ndarray) -> float:
        """The barrier at a point inside."""
        x = self.start + self.rows @ z
        return -math.log(float(self.signs @ (x * x)))

    def derivatives(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and Hessian of the barrier at a point inside."""
        x = self.start + self.rows @ z
        inside = float(self.signs @ (x * x))
        slope = 2.0 * self.rows.T @ (self.signs * x)
        curvature = 2.0 * self.rows.T @ (self.signs[:, None] * self.rows)
        return -slope / inside, np.outer(slope, slope) / inside**2 - curvature / inside


def _minimise(parts: list[_Barrier], z: np.ndarray, pressure: float | None) -> np.ndarray:
    """Newton with backtracking on barriers + |z|^2 / 2 + pressure times the enlargement, which None keeps fixed."""
    free = z.size if pressure is not None else z.size - 1

    def inside(point: np.ndarray) -> bool:
        return all(part.value(point) > 0.0 for part in parts)

    def cost(point: np.ndarray) -> float:
        total = 0.5 * float(point[:-1] @ point[:-1]) + (pressure or 0.0) * float(point[-1])
        return total + sum(part.barrier(point) for part in parts)

    for _ in range(_NEWTON_STEPS):
        gradient, hessian = np.append(z[:-1], pressure or 0.0), np.eye(z.size)
        hessian[-1, -1] = 0.0
        for part in parts:
            slope, curvature = part.derivatives(z)
            gradient, hessian = gradient + slope, hessian + curvature
        step = np.zeros_like(z)
        step[:free] = -np.linalg.solve(hessian[:free, :free], gradient[:free])
        decrement = -float(gradient @ step)
        if not decrement > _CONVERGED:
            break
        size, before = 1.0, cost(z)
        for _ in range(_BACKTRACKS):
            if inside(z + size * step) and cost(z + size * step) <= before - 0.1 * size * decrement:
                break
            size *= 0.5
        else:
            break
        z = z + size * step
        if pressure is not None and z[-1] < -_INSIDE:
            break
    return z
