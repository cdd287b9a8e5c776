"""The contact problem with Coulomb friction: who sticks, slips and separates, and the forces (Sec. 5.3).

Three ways to find the modes, cheapest first; whatever they say, the Newton of `cone` computes the forces and its
judge accepts or refuses them:

    warm    the modes and forces of the last solution
    qp      a sequence of ProxQP programs
    pgs     Pinocchio's projected Gauss-Seidel solver

and when all of these are refused, the interior-point method of `cone` from several starting points (`interior`). A
single contact needs no such search: its states can be enumerated (`exact`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..errors import ArgumentError, SolverError
from .cone import CLASSIFY, INTERIOR_STARTS, OPEN, SLIP, STICK, TINY, WARM, cone_memory, interior_point, solve_cones
from .qp import ConeQP

__all__ = ["OPEN", "SLIP", "STICK", "ContactSolution", "ContactSolver", "solve_contacts"]

NEWTON_PASSES = 20
QP_LIMIT = 2
STAGES = ("qp", "interior", "pgs")
_PGS_FRICTION = 1e4


class _Workspace:
    """Buffers, warm start and helper solvers for problems of one size."""

    def __init__(self, contacts: int):
        self.contacts = contacts
        self.memory = cone_memory(contacts)
        self.table = self.memory.table
        self.modes = self.memory["modes"]
        self.forces = self.memory["forces"]
        self.velocities = self.memory["velocities"]
        self.counts = self.memory["counts"]
        self.warm = False
        self.qp: ConeQP | None = None
        self.pgs: _PinocchioPGS | None = None


class _PinocchioPGS:
    """Pinocchio's PGSConstraintSolver on problems of one size."""

    def __init__(self, contacts: int):
        import pinocchio as pin

        self._pin = pin
        self._model = pin.Model()
        self._models = pin.StdVec_ConstraintModel()
        self._datas = pin.StdVec_ConstraintData()
        self._friction: np.ndarray | None = None
        self._settings = pin.PGSSolverSettings()
        self._settings.absolute_feasibility_tol = 1e-10
        self._settings.absolute_complementarity_tol = 1e-10
        self._settings.relative_feasibility_tol = 1e-10
        self._settings.relative_complementarity_tol = 1e-10
        self._settings.max_iterations = 300
        self._solver = pin.PGSConstraintSolver(3 * contacts)

    def solve(self, matrix: np.ndarray, b: np.ndarray, mu: np.ndarray) -> np.ndarray | None:
        """Forces (3n,) as Pinocchio's solver leaves them, or None if they are not finite."""
        pin = self._pin
        if self._friction is None or not np.array_equal(self._friction, mu):
            self._models = pin.StdVec_ConstraintModel()
            self._datas = pin.StdVec_ConstraintData()
            for value in mu:
                contact = pin.PointContactConstraintModel(self._model, 0)
                contact.setFriction(min(float(value), _PGS_FRICTION))
                model = pin.ConstraintModel(contact)
                self._models.append(model)
                self._datas.append(model.createData())
            self._friction = mu.copy()
        # Unit-sized blocks and b, as everywhere: its tolerances are absolute in part.
        trace = np.diagonal(matrix).reshape(-1, 3).sum(axis=1)
        scale = np.repeat(np.sqrt(3.0 / np.where(trace > 0.0, trace, 3.0)), 3)
        unit = np.abs(scale * b).max() or 1.0
        result = pin.PGSSolverResult()
        delassus = pin.DelassusOperatorDense(scale[:, None] * matrix * scale)
        self._solver.solve(delassus, scale * b / unit, self._models, self._datas, self._settings, result)
        forces = result.retrieveConstraintImpulses()
        return forces * scale * unit if np.isfinite(forces).all() else None


@dataclass(frozen=True)
class ContactSolution:
    """Forces and relative velocities of n contacts that obey Coulomb's law; rows are (t1, t2, n).

    forces:      (n, 3), N (or N s, if b was a velocity)
    velocities:  (n, 3), u = G F + b: m/s^2 (or m/s)
    modes:       (n,) OPEN, STICK or SLIP
    residual:    relative residual of the judge (see `cone`), without units
    iterations:  Newton passes (or sweeps) of the stage that decided
    qp_count:    programs solved by ProxQP
    decided_by:  "warm", "exact", "qp", "pgs" or "interior"
    mu:          (n,) the coefficients
    """

    forces: np.ndarray
    velocities: np.ndarray
    modes: np.ndarray
    residual: float
    iterations: int
    qp_count: int
    decided_by: str
    mu: np.ndarray

    @property
    def cone_excess(self) -> np.ndarray:
        """(n,) |F_t| - mu F_n, never positive beyond round-off where mu is finite; 0 for infinite mu."""
        tangential = np.hypot(self.forces[:, 0], self.forces[:, 1])
        finite = np.isfinite(self.mu)
        return np.where(finite, tangential - np.where(finite, self.mu, 0.0) * self.forces[:, 2], 0.0)

    @property
    def complementarity(self) -> np.ndarray:
        """(n,) F . (u + mu |u_t| n), zero up to round-off; F . u for infinite mu in stick."""
        speed = np.hypot(self.velocities[:, 0], self.velocities[:, 1])
        shift = np.where(np.isfinite(self.mu), self.mu, 0.0) * speed * self.forces[:, 2]
        return np.einsum("ij,ij->i", self.forces, self.velocities) + shift

    @property
    def dissipation(self) -> np.ndarray:
        """(n,) -F_t . u_t, the power that friction takes, never negative beyond round-off."""
        return -np.einsum("ij,ij->i", self.forces[:, :2], self.velocities[:, :2])


class ContactSolver:
    """Solves contact problems one after the other, each from the last one's modes. Nothing is validated here.

    After `solve` returns True, `modes` (n,), `forces` (3n,), `velocities` (3n,) and `residual` hold the solution; they
    are buffers that the next call overwrites. When it returns False they are what they were before.

    Counters: polish_count (warm Newton calls), qp_count, pgs_count, interior_count, and decided (by stage).
    """

    def __init__(self, tolerance: float = 1e-10, stages: tuple[str, ...] = STAGES):
        self.tolerance = tolerance
        self.stages = stages
        self.residual = 0.0
        self.iterations = 0
        self.decided_by = ""
        self.polish_count = 0
        self.qp_count = 0
        self.pgs_count = 0
        self.interior_count = 0
        self.decided = {"warm": 0, "exact": 0, "qp": 0, "pgs": 0, "interior": 0}
        self._spaces: dict[int, _Workspace] = {}
        self._space = self._workspace(1)

    def _workspace(self, contacts: int) -> _Workspace:
        space = self._spaces.get(contacts)
        if space is None:
            space = self._spaces[contacts] = _Workspace(contacts)
        self._space = space
        self.modes = space.modes
        self.forces = space.forces
        self.velocities = space.velocities
        return space

    def warm_start(self, modes: np.ndarray, forces: np.ndarray) -> None:
        """Begin the next problem of this size from these modes (n,) and forces (3n,) or (n, 3)."""
        space = self._workspace(len(modes))
        space.modes[:] = modes
        space.forces[:] = np.reshape(forces, -1)
        space.warm = True

    def forget(self) -> None:
        """Drop all warm starts."""
        for space in self._spaces.values():
            space.warm = False

    def solve(self, matrix: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Solve one problem: matrix (3n, 3n) C-contiguous, b (3n,), mu (n,), all float64. True if solved."""
        contacts = mu.shape[0]
        space = self._space
        if space.contacts != contacts:
            space = self._workspace(contacts)
        if space.warm or contacts == 1:
            warm = space.warm
            if not warm:
                space.modes[0] = STICK
                space.forces[:] = 0.0
            self.polish_count += 1
            residual = solve_cones(
                matrix, b, mu, space.table, WARM, NEWTON_PASSES, self.tolerance,
            )  # fmt: skip
            if residual <= self.tolerance:
                self.residual = residual
                space.warm = True
                self.decided_by = "warm" if warm and not space.counts[1] else "exact"
                self.decided[self.decided_by] += 1
                return True
            self.residual = residual
        return self._search(space, matrix, b, mu)

    def _search(self, space: _Workspace, matrix: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """The stages after the warm one, in their order."""
        self.residual = np.inf
        before = space.forces.copy()
        for stage in self.stages:
            if stage == "qp":
                solved = self._search_qp(space, matrix, b, mu)
            elif stage == "pgs":
                solved = self._search_pgs(space, matrix, b, mu)
            else:
                solved = self._search_interior(space, matrix, b, mu)
            if solved:
                self.decided_by = stage
                self.decided[stage] += 1
                return True
        space.forces[:] = before
        return False

    def _newton(self, space: _Workspace, matrix: np.ndarray, b: np.ndarray, mu: np.ndarray, task: int) -> bool:
        """Newton and judge from the workspace's forces; True if accepted."""
        residual = solve_cones(
            matrix, b, mu, space.table, task, NEWTON_PASSES, self.tolerance,
        )  # fmt: skip
        if residual <= self.tolerance:
            self.residual = residual
            space.warm = True
            return True
        self.residual = min(self.residual, residual)
        return False

    def _search_qp(self, space: _Workspace, matrix: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """A sequence of QPs, each around the forces of the last."""
        if space.qp is None:
            space.qp = ConeQP(space.contacts)
        space.qp.restart()
        for _ in range(QP_LIMIT):
            self.qp_count += 1
            finished = space.qp.solve(matrix, b, mu)
            if not np.isfinite(space.qp.estimate).all():
                return False
            space.forces[:] = space.qp.estimate * space.qp.unit
            if self._newton(space, matrix, b, mu, CLASSIFY):
                return True
            if not finished:
                return False
        return False

    def _search_pgs(self, space: _Workspace, matrix: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Modes from Pinocchio's projected Gauss-Seidel."""
        if space.pgs is None:
            space.pgs = _PinocchioPGS(space.contacts)
        self.pgs_count += 1
        forces = space.pgs.solve(matrix, b, mu)
        if forces is None:
            return False
        space.forces[:] = forces
        return self._newton(space, matrix, b, mu, CLASSIFY)

    def _search_interior(self, space: _Workspace, matrix: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Modes from the interior-point method, from one starting point after the other."""
        for start, (first_force, first_velocity) in enumerate(INTERIOR_STARTS):
            self.interior_count += 1
            # Complete pivoting costs several times more, and is needed for extreme mass ratios only.
            pivoting = 0.0 if start == 0 else TINY
            interior_point(matrix, b, mu, space.table, first_force, first_velocity, pivoting)
            if np.isfinite(space.forces).all() and self._newton(space, matrix, b, mu, CLASSIFY):
                return True
        return False

    def solution(self, mu: np.ndarray) -> ContactSolution:
        """The last problem's solution as a value of its own."""
        return ContactSolution(
            self.forces.reshape(-1, 3).copy(), self.velocities.reshape(-1, 3).copy(), self.modes.copy(), self.residual,
            self.iterations, self.qp_count, self.decided_by, np.array(mu, dtype=float),
        )  # fmt: skip


def solve_contacts(
    matrix: npt.ArrayLike,
    b: npt.ArrayLike,
    mu: npt.ArrayLike,
    warm: ContactSolution | None = None,
    tolerance: float = 1e-10,
) -> ContactSolution:
    """Forces F and u = G F + b of n contacts under Coulomb's law, exactly (Sec. 5.3; see `cone` for the statement).

    matrix:    (3n, 3n) Delassus matrix G, symmetric positive semidefinite; 1/kg; rows (t1, t2, n) per contact
    b:         (3n,) or (n, 3) relative accelerations in m/s^2 (or velocities in m/s) at zero contact force
    mu:        (n,) or one number: coefficients of friction; 0 is frictionless, inf never slips while it presses
    warm:      a solution of a similar problem with as many contacts, to start from
    tolerance: relative residual up to which a solution is accepted

    Where contacts are redundant the forces are one choice among several; u is not affected.

    Raises ArgumentError for wrong shapes, numbers that are not finite or a matrix that is not symmetric or has a
    negative diagonal; SolverError, with the residual, where there is no solution or none was found.
    """
    matrix = np.ascontiguousarray(matrix, dtype=float)
    b = np.ascontiguousarray(b, dtype=float).reshape(-1)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape[0] % 3:
        raise ArgumentError(f"the Delassus matrix must be (3n, 3n), got {matrix.shape}")
    contacts = matrix.shape[0] // 3
    if b.shape[0] != 3 * contacts:
        raise ArgumentError(f"b must have {3 * contacts} entries for {contacts} contacts, got {b.shape[0]}")
    given = np.asarray(mu, dtype=float)
    if given.ndim > 1 or given.size not in (1, contacts):
        raise ArgumentError(f"mu must be one number or ({contacts},), got shape {given.shape}")
    friction = np.array(np.broadcast_to(given, (contacts,)))
    if not (np.isfinite(matrix).all() and np.isfinite(b).all()):
        raise ArgumentError("the Delassus matrix and b must be finite")
    if np.isnan(friction).any() or (friction < 0.0).any():
        raise ArgumentError(f"mu must not be negative or NaN, got {friction.tolist()}")
    if not tolerance > 0.0:
        raise ArgumentError(f"tolerance must be positive, got {tolerance}")
    diagonal = np.diagonal(matrix)
    if contacts and diagonal.min() < 0.0:
        raise ArgumentError(f"the Delassus matrix has a negative diagonal entry, {diagonal.min()}")
    # |G_ij - G_ji| against sqrt(G_ii G_jj), the largest a positive semidefinite matrix allows: free of units.
    bound = np.sqrt(np.outer(diagonal, diagonal))
    asymmetry = np.abs(matrix - matrix.T)
    if (asymmetry > 1e-8 * bound).any():
        worst = np.unravel_index(np.argmax(asymmetry - 1e-8 * bound), matrix.shape)
        raise ArgumentError(f"the Delassus matrix is not symmetric: entries {worst} differ by {asymmetry[worst]:.3g}")
    if warm is not None and warm.modes.shape[0] != contacts:
        raise ArgumentError(f"warm is a solution of {warm.modes.shape[0]} contacts, the problem has {contacts}")
    if contacts == 0:
        empty = np.zeros((0, 3))
        return ContactSolution(empty, empty.copy(), np.zeros(0, dtype=np.int64), 0.0, 0, 0, "exact", friction)

    solver = ContactSolver(tolerance)
    if warm is not None:
        solver.warm_start(warm.modes, warm.forces)
    if not solver.solve(matrix, b, friction):
        raise SolverError(
            f"no forces satisfy Coulomb's law at these {contacts} contacts: relative residual {solver.residual:.3g}, "
            f"tolerance {tolerance:.3g}"
        )
    return solver.solution(friction)
