"""Redundant forces of contacts at rest: those well inside all cones, where there are any.

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

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..errors import ArgumentError
from .barrier import INSIDE, SCRATCH_ROWS, TO_BOUNDARY, minimise, way_inside
from .cone import LARGEST_FRICTION, STICK
from .problem import checked_problem
from .solve import ContactSolution

# A null direction: unit rows that combine to less than this (the square root of the kernels' rank tolerance).
_NULL = 3e-6
_SHARPENING = 8.0
# Size of the forces of interest, relative to those of least norm.
_LARGEST = 1e3
# Normal forces that the choice changes by less than this part of others are not redundant.
_FIXED = 1e-9
_SIGNS = np.array([1.0, -1.0, -1.0])
# Velocities relative to the terms that cancel in them.
_AT_REST = 1e-9


@dataclass(frozen=True)
class Cone:
    """factor x[normal] + offset >= |scaling x[tangents]|, of forces x; or >= 0, where there are no tangents.

    scaling (2, 2): None for round cones.
    """

    normal: int
    factor: float
    offset: float
    tangents: tuple[int, ...] = ()
    scaling: np.ndarray | None = None


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
    if unit <= INSIDE * largest:
        unit = largest
    barriers = _Barriers(cones, least / unit, null, unit)
    if barriers.unloaded():
        return None
    z = np.linalg.lstsq(null, (forces - least) / unit, rcond=None)[0]
    values = barriers.values(z)
    if values.min() <= INSIDE:
        found = _enter(barriers, z, values)
        if found is None:
            return None
        z = found
    point = _minimise(barriers, np.append(z, 0.0))
    z = point[:-1]
    curvature, change = barriers.curvature(point, span)
    # the unit changes along, too
    change -= np.outer(2.0 * z, span.T @ (least / unit))
    try:
        response = np.linalg.solve(curvature + np.eye(z.size), change)
    except np.linalg.LinAlgError:
        # on the rim, but for round-off
        return None
    return Choice(least + unit * null @ z, -null @ response, span)


def _enter(barriers: _Barriers, z: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """A point inside all cones (phase one), from one of these distances inside; None where there is none."""
    count = values.size
    # as far outside as the others are inside: the steps to come are of that size
    start = max(sorted(map(abs, values.tolist()))[count // 2], 10.0 * INSIDE) - float(values.min())
    point = np.append(z, start)
    pressure = 2.0 * count / start
    before: np.ndarray | None = None
    while True:
        point = _minimise(barriers, point, pressure)
        if point[-1] < -INSIDE:
            return point[:-1]
        # the least enlargement is lower by no more than the number of logarithms (and the square's part in the
        # balance, for forces of interest) over the pressure
        size = float(np.linalg.norm(point[:-1]))
        within = (2.0 * count + max(size * (_LARGEST - size), 0.0)) / pressure
        if point[-1] > within or within < INSIDE:
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
            n = len(cone.tangents)
            self.parts[i, 1 : 1 + n, cone.tangents] = np.eye(n) if cone.scaling is None else cone.scaling.T
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
        return bool((self.start[fixed, 0] <= INSIDE).any())

    def towards(self, point: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The point after that step, or as far along it as is well inside."""
        way = way_inside(self.at(point).ravel(), self.flat @ step)
        return point + min(1.0, TO_BOUNDARY * way) * step

    def curvature(self, point: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k, k) Hessian by z of the sum of barriers at a point inside, and (k, r) change of the gradient for forces
        that change along the directions (n, r)."""
        x, k = self.at(point), point.size - 1
        length = np.hypot(x[:, 1], x[:, 2])
        # s^2 - |t|^2 without the cancellation near the boundary
        inside = (x[:, 0] - length) * (x[:, 0] + length)
        slopes = -2.0 * (_SIGNS * x) / inside[:, None]
        bent = slopes[:, :, None] * slopes[:, None, :] - (2.0 / inside)[:, None, None] * np.diag(_SIGNS)
        rows = np.concatenate([self.rows[:, :, :k], self.parts @ directions], axis=2)
        curved = self.flat[:, :k].T @ (bent @ rows).reshape(len(self.flat), -1)
        return curved[:, :k], curved[:, k:]


def _minimise(barriers: _Barriers, point: np.ndarray, pressure: float = 0.0) -> np.ndarray:
    """The lowest point of barriers + |z|^2 / 2 + pressure times the enlargement, see `minimise`, from one inside."""
    found, flat = point.copy(), barriers.flat
    scratch = np.empty((SCRATCH_ROWS, max(flat.shape)))
    minimise(flat, barriers.start.ravel(), found, pressure, np.empty((point.size, point.size)), scratch)
    return found


def centred_forces(
    delassus: npt.ArrayLike, b: npt.ArrayLike, mu: npt.ArrayLike, solution: ContactSolution
) -> ContactSolution:
    """The solution with other forces where sticking contacts are redundant: well inside their cones.

    All that changes are the forces of the contacts at rest (u = 0), by combinations that move nothing (G dF = 0), so
    that the velocities stay. The new forces are the most central ones: they maximise the sum of log(mu^2 F_n^2 -
    |F_t|^2) less half the square of their distance from the forces of least norm, in units of these, which bounds what
    contacts that press against each other could add to themselves. They are unique, change smoothly with the problem,
    and hold on under changes that would take forces of least norm out of the cones. Where no forces lie inside the
    cones (all are about to slip) the solution is returned as it is.

    Parameters
    ----------
    delassus, b, mu
        As for `solve_contacts`.
    solution : ContactSolution
        A solution of it.

    Returns
    -------
    ContactSolution

    Raises
    ------
    ArgumentError
        For a problem that `solve_contacts` would refuse, or a solution of another size.

    Examples
    --------
    Two feet of one body, which together carry 10 N, share the load:

    >>> import numpy as np
    >>> import pincontact as pc
    >>> rows = np.vstack([np.eye(3), np.eye(3)])
    >>> delassus, b = rows @ rows.T, np.tile([0.0, 0.0, -10.0], 2)
    >>> solution = pc.solve_contacts(delassus, b, 0.5)
    >>> pc.centred_forces(delassus, b, 0.5, solution).forces[:, 2].round(6).tolist()
    [5.0, 5.0]
    """
    matrix, b, friction = checked_problem(delassus, b, mu)
    contacts = len(friction)
    if not isinstance(solution, ContactSolution):
        raise ArgumentError(f"the solution must be one of solve_contacts, got {type(solution).__name__}")
    if solution.modes.shape[0] != contacts:
        raise ArgumentError(f"the solution has {solution.modes.shape[0]} contacts, the problem has {contacts}")
    # At rest counts, not the mode: a force of least norm on its cone's edge slips at zero speed, and a contact that
    # only just touches can take a load.
    size = (np.abs(b) + np.abs(matrix) @ np.abs(solution.forces.ravel())).reshape(-1, 3).max(axis=1)
    speed = np.abs(solution.velocities).max(axis=1)
    stuck = np.flatnonzero((speed <= _AT_REST * np.maximum(size, _AT_REST * size.max(initial=0.0))) & (friction > 0.0))
    rows = (3 * stuck[:, None] + np.arange(3)).ravel()
    values, vectors = np.linalg.eigh(matrix[np.ix_(rows, rows)])
    cones = [
        Cone(3 * i + 2, min(float(friction[c]), LARGEST_FRICTION), 0.0, (3 * i, 3 * i + 1)) for i, c in enumerate(stuck)
    ]
    null = null_space(vectors * np.sqrt(np.maximum(values, 0.0)))
    found = central_force(solution.forces[stuck].ravel(), null, cones)
    if found is None:
        return solution
    moved, modes = solution.forces.copy(), solution.modes.copy()
    moved[stuck], modes[stuck] = found.forces.reshape(-1, 3), STICK
    velocities = (matrix @ moved.ravel() + b).reshape(-1, 3)
    return replace(solution, forces=moved, velocities=velocities, modes=modes)
