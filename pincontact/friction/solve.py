"""The contact problem with Coulomb friction: who sticks, slips and separates, and the forces (Sec. 5.3).

What has to be found is the modes; whatever suggests them, the Newton of `cone` computes the forces and its judge
accepts or refuses them. The suggestions come from, cheapest first,

    warm          the modes and forces of the last solution
    qp            a sequence of ProxQP programs (`qp`)
    interior      the interior-point method of `cone`, from several starting points
    pgs           Pinocchio's projected Gauss-Seidel solver
    restart       the last forces, perturbed, and arbitrary modes
    continuation  the frictionless solution, followed while friction grows

A single contact needs no search: all of its states can be tried (`exact`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..errors import ArgumentError, SolverError
from .cone import (
    CLASSIFY,
    INTERIOR_STARTS,
    LARGEST_FRICTION,
    OPEN,
    SLIP,
    STICK,
    TINY,
    WARM,
    cone_memory,
    interior_point,
    solve_cones,
)
from .qp import ConeQP

__all__ = ["OPEN", "SLIP", "STICK", "ContactSolution", "ContactSolver", "solve_contacts"]

# Newton passes per start: mode corrections included, most starts need fewer than five.
NEWTON_PASSES = 20
# Programs per search: a third one rarely finds what two did not.
QP_LIMIT = 2
STAGES = ("qp", "interior", "pgs", "restart", "continuation")
RESTARTS = 400
SMALLEST_FRICTION_STEP = 1e-4
# Pinocchio's cones are finite; its forces only suggest modes.
PGS_FRICTION = 1e4
PGS_ACCURACY = 1e-10
PGS_ITERATIONS = 300


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
        self._settings.absolute_feasibility_tol = PGS_ACCURACY
        self._settings.absolute_complementarity_tol = PGS_ACCURACY
        self._settings.relative_feasibility_tol = PGS_ACCURACY
        self._settings.relative_complementarity_tol = PGS_ACCURACY
        self._settings.max_iterations = PGS_ITERATIONS
        self._solver = pin.PGSConstraintSolver(3 * contacts)

    def solve(self, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> np.ndarray | None:
        """Forces (3n,) as Pinocchio's solver leaves them, or None if they are not finite."""
        pin = self._pin
        if self._friction is None or not np.array_equal(self._friction, mu):
            self._models = pin.StdVec_ConstraintModel()
            self._datas = pin.StdVec_ConstraintData()
            for value in mu:
                contact = pin.PointContactConstraintModel(self._model, 0)
                contact.setFriction(min(float(value), PGS_FRICTION))
                model = pin.ConstraintModel(contact)
                self._models.append(model)
                self._datas.append(model.createData())
            self._friction = mu.copy()
        # Unit-sized blocks and b, as everywhere: its tolerances are absolute in part.
        trace = np.diagonal(delassus).reshape(-1, 3).sum(axis=1)
        scale = np.repeat(np.sqrt(3.0 / np.where(trace > 0.0, trace, 3.0)), 3)
        unit = np.abs(scale * b).max() or 1.0
        result = pin.PGSSolverResult()
        operator = pin.DelassusOperatorDense(scale[:, None] * delassus * scale)
        self._solver.solve(operator, scale * b / unit, self._models, self._datas, self._settings, result)
        forces = result.retrieveConstraintImpulses()
        return forces * scale * unit if np.isfinite(forces).all() else None


@dataclass(frozen=True)
class ContactSolution:
    """Forces and relative velocities of n contacts that obey Coulomb's law; rows are (t1, t2, n).

    forces:      (n, 3), N (or N s, if b was a velocity)
    velocities:  (n, 3), u = G F + b: m/s^2 (or m/s)
    modes:       (n,) OPEN, STICK or SLIP
    residual:    relative residual of the judge (see `cone`), without units
    iterations:  Newton passes of the start that decided
    qp_count:    programs that ProxQP was given
    decided_by:  "warm", "exact", or the stage of the search: see the module
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
        """(n,) F . (u + mu |u_t| n), zero up to round-off; F_n u_n where mu is infinite."""
        speed = np.hypot(self.velocities[:, 0], self.velocities[:, 1])
        finite = np.isfinite(self.mu)
        tangential = np.einsum("ij,ij->i", self.forces[:, :2], self.velocities[:, :2])
        tangential += np.where(finite, self.mu, 0.0) * speed * self.forces[:, 2]
        return self.forces[:, 2] * self.velocities[:, 2] + np.where(finite, tangential, 0.0)

    @property
    def dissipation(self) -> np.ndarray:
        """(n,) -F_t . u_t, the power that friction takes, never negative beyond round-off."""
        return -np.einsum("ij,ij->i", self.forces[:, :2], self.velocities[:, :2])


class ContactSolver:
    """Solves contact problems one after the other, each from the last one's modes. Nothing is validated here.

    After `solve` returns True, `modes` (n,), `forces` (3n,), `velocities` (3n,) and `residual` hold the solution; the
    arrays are buffers that the next call overwrites. When it returns False they are what they were before, and
    `residual` is the least that was reached.

    tolerance: relative residual up to which a solution is accepted
    stages:    how the modes are looked for where a warm start is missing or refused, in this order

    Counters: polish_count (warm starts tried), qp_count, pgs_count, interior_count, and decided (by stage).
    """

    def __init__(self, tolerance: float = 1e-10, stages: tuple[str, ...] = STAGES):
        self.tolerance = tolerance
        self.stages = stages
        self.residual = 0.0
        self.decided_by = ""
        self.polish_count = 0
        self.qp_count = 0
        self.pgs_count = 0
        self.interior_count = 0
        self.decided = dict.fromkeys(("warm", "exact", *stages), 0)
        self._qp_before = 0
        self._spaces: dict[int, _Workspace] = {}
        self._space = self._workspace(1)

    @property
    def iterations(self) -> int:
        """Newton passes of the last call that was accepted or refused."""
        return int(self._space.counts[0])

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

    def solve(self, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Solve one problem: delassus (3n, 3n) C-contiguous, b (3n,), mu (n,), all float64. True if solved."""
        contacts = mu.shape[0]
        self._qp_before = self.qp_count
        space = self._space
        if space.contacts != contacts:
            space = self._workspace(contacts)
        if space.warm or contacts == 1:
            warm = space.warm
            if not warm:
                space.modes[0] = STICK
                space.forces[:] = 0.0
            self.polish_count += 1
            residual = solve_cones(delassus, b, mu, space.table, WARM, NEWTON_PASSES, self.tolerance)
            if residual <= self.tolerance:
                self.residual = residual
                space.warm = True
                self.decided_by = "warm" if warm and not space.counts[1] else "exact"
                self.decided[self.decided_by] += 1
                return True
            self.residual = residual
        return self._search(space, delassus, b, mu)

    def _search(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """The stages after the warm one, in their order."""
        self.residual = np.inf
        if not (np.isfinite(delassus).all() and np.isfinite(b).all()):
            return False
        before = space.modes.copy(), space.forces.copy(), space.velocities.copy(), space.warm
        searches = {
            "qp": self._search_qp,
            "interior": self._search_interior,
            "pgs": self._search_pgs,
            "restart": self._search_restarts,
            "continuation": self._search_continuation,
        }
        for stage in self.stages:
            if searches[stage](space, delassus, b, mu):
                self.decided_by = stage
                self.decided[stage] += 1
                return True
        space.modes[:], space.forces[:], space.velocities[:], space.warm = before
        return False

    def _newton(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray, task: int) -> bool:
        """Newton and judge from the workspace's forces; True if accepted."""
        residual = solve_cones(delassus, b, mu, space.table, task, NEWTON_PASSES, self.tolerance)
        if residual <= self.tolerance:
            self.residual = residual
            space.warm = True
            return True
        self.residual = min(self.residual, residual)
        return False

    def _search_qp(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """A sequence of QPs, each around the forces of the last."""
        if space.qp is None:
            space.qp = ConeQP(space.contacts)
        space.qp.restart()
        for _ in range(QP_LIMIT):
            self.qp_count += 1
            finished = space.qp.solve(delassus, b, mu)
            if not np.isfinite(space.qp.estimate).all():
                return False
            space.forces[:] = space.qp.estimate * space.qp.unit
            if self._newton(space, delassus, b, mu, CLASSIFY):
                return True
            if not finished:
                return False
        return False

    def _search_pgs(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Modes from Pinocchio's projected Gauss-Seidel."""
        if space.pgs is None:
            space.pgs = _PinocchioPGS(space.contacts)
        self.pgs_count += 1
        forces = space.pgs.solve(delassus, b, mu)
        if forces is None:
            return False
        space.forces[:] = forces
        return self._newton(space, delassus, b, mu, CLASSIFY)

    def _search_interior(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Modes from the interior-point method, from one starting point after the other."""
        for start, (first_force, first_velocity) in enumerate(INTERIOR_STARTS):
            self.interior_count += 1
            # Complete pivoting costs several times more, and is needed for extreme mass ratios only.
            pivoting = 0.0 if start == 0 else TINY
            interior_point(delassus, b, mu, space.table, first_force, first_velocity, pivoting)
            if np.isfinite(space.forces).all() and self._newton(space, delassus, b, mu, CLASSIFY):
                return True
        return False

    def _search_restarts(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Newton from the last forces, perturbed, and from arbitrary modes; their sequence is always the same."""
        if not np.isfinite(space.forces).all():
            return False
        forces = space.forces.reshape(-1, 3).copy()
        reach = np.minimum(mu, LARGEST_FRICTION)
        typical = np.linalg.norm(forces)
        generator = np.random.default_rng(0)
        for attempt in range(RESTARTS):
            factor, first, second = generator.normal(size=(3, space.contacts))
            if attempt % 2:
                # Any modes at all; what the forces are is then of little importance.
                space.modes[:] = generator.integers(3, size=space.contacts)
                space.forces[:] = typical * generator.normal(size=3 * space.contacts)
                task = WARM
            else:
                trial = forces * (10.0**factor)[:, None]
                trial[:, 0] += 0.5 * first * reach * trial[:, 2]
                trial[:, 1] += 0.5 * second * reach * trial[:, 2]
                space.forces[:] = trial.ravel()
                task = CLASSIFY
            if self._newton(space, delassus, b, mu, task):
                return True
        return False

    def _search_continuation(self, space: _Workspace, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """From the frictionless solution, which is that of a convex problem, to the true friction in small steps.

        A fold of the path of solutions ends it; the step is then as small as it may be.
        """
        target = np.minimum(mu, LARGEST_FRICTION)
        refused = self.residual
        if not self._search_interior(space, delassus, b, np.zeros_like(mu)):
            return False
        reached, step = 0.0, 0.1
        while reached < 1.0 and step > SMALLEST_FRICTION_STEP:
            goal = min(reached + step, 1.0)
            if self._newton(space, delassus, b, mu if goal == 1.0 else goal * target, WARM):
                reached, step = goal, 1.5 * step
            else:
                step *= 0.5
        if reached < 1.0:
            # What was solved on the way were other problems.
            self.residual = refused
        return reached == 1.0

    def solution(self, mu: np.ndarray) -> ContactSolution:
        """The last problem's solution as a value of its own."""
        return ContactSolution(
            forces=self.forces.reshape(-1, 3).copy(),
            velocities=self.velocities.reshape(-1, 3).copy(),
            modes=self.modes.copy(),
            residual=self.residual,
            iterations=self.iterations,
            qp_count=self.qp_count - self._qp_before,
            decided_by=self.decided_by,
            mu=np.array(mu, dtype=float),
        )


def solve_contacts(
    delassus: npt.ArrayLike,
    b: npt.ArrayLike,
    mu: npt.ArrayLike,
    warm: ContactSolution | None = None,
    tolerance: float = 1e-10,
) -> ContactSolution:
    """Forces F and u = G F + b of n contacts under Coulomb's law, exactly (Sec. 5.3; see `cone` for the statement).

    delassus:  (3n, 3n) Delassus matrix G, symmetric positive semidefinite; 1/kg; rows (t1, t2, n) per contact
    b:         (3n,) or (n, 3) relative accelerations in m/s^2 (or velocities in m/s) at zero contact force
    mu:        (n,) or one number: coefficients of friction; 0 is frictionless, inf never slips while it presses
    warm:      a solution of a similar problem with as many contacts, to start from
    tolerance: relative residual up to which a solution is accepted

    Where contacts are redundant the forces are one choice among several; u is not affected.

    Raises ArgumentError for wrong shapes, numbers that are not finite or a matrix that is not symmetric or has a
    negative diagonal; SolverError, with the residual, where there is no solution or none was found.
    """
    matrix = np.ascontiguousarray(delassus, dtype=float)
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
    allowed = 1e-8 * np.sqrt(np.outer(diagonal, diagonal)) + 1e-14 * diagonal.max(initial=0.0)
    asymmetry = np.abs(matrix - matrix.T)
    if (asymmetry > allowed).any():
        row, column = np.unravel_index(np.argmax(asymmetry - allowed), matrix.shape)
        worst = (int(row), int(column))
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
