"""Cone problems in which sliding friction and the limits of resistances to turning are multiples of the loads.

Where nothing slides, the cone problem is the whole problem. Else it is one of loads and discs (`friction.loads`).
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..friction.loads import Loads, LoadSolver
from ..friction.solve import NO_PROGRAMS, ContactSolver
from ..layout import (
    MODE,
    MU,
    MU_NOW,
    SLIPPING,
)
from .directions import slip_direction
from .friction_scaling import associated
from .mode_problem import ModeProblem

if TYPE_CHECKING:
    from .system import System


class ModeSolution(NamedTuple):
    """Forces (n, 3) and relative accelerations (n, 3) of a cone problem's units, and their modes (n,)."""

    forces: np.ndarray
    velocities: np.ndarray
    modes: np.ndarray
    residual: float


class LoadedCones:
    """Solves cone problems of modes with the friction of what slides and the limits of resistances as multiples of the
    loads; keeps the solvers' buffers.

    cone_problems: how many were posed; proved: whether there are no forces where the last search found none.
    """

    def __init__(self, system: System, contact_solver: str = "auto") -> None:
        self.system = system
        self._contact_solver = contact_solver
        self.cone_problems = 0
        self.proved = False
        # coefficients of friction of what may stick
        self._limits = np.zeros(system.items)

    @cached_property
    def solver(self) -> ContactSolver:
        """Made when the first cone problem is posed."""
        # the loads that what slides is given must be those that evaluations find, which are of least norm
        return ContactSolver(nearest=False, contact_solver=self._contact_solver)

    @property
    def program_counts(self) -> dict[str, int]:
        """What ProxQP did for them, see `ContactSolver.program_counts`."""
        if not self.cone_problems:
            return NO_PROGRAMS
        counts = self.solver.program_counts
        return counts | {"qp_failures": counts["qp_failures"] + self.loads.unguessed}

    @cached_property
    def loads(self) -> LoadSolver:
        """Made when the first problem with loads is posed."""
        return LoadSolver(guess_first=self._contact_solver == "proxqp")

    def _solve_with_loads(
        self, problem: ModeProblem, closed: list[int], held: list[int], resisting: list[int]
    ) -> ModeSolution | None:
        """Its solution, with the friction of what slides and the limits of resistances as multiples of the loads; None
        where there is none, or none was found."""
        system = self.system
        integers, numbers = system.contact_int, system.contact_real
        gram, base, turns = problem.gram, problem.base, problem.turns
        sliding = [i for i, c in enumerate(closed) if integers[c, MODE] == SLIPPING and numbers[c, MU] > 0.0]
        self.cone_problems += 1
        if not sliding and not turns:
            solver = self.solver
            if not solver.solve(gram, base, problem.limits):
                self.proved = solver.certificate is not None
                return None
            forces, velocities = solver.forces.reshape(-1, 3).copy(), solver.velocities.reshape(-1, 3).copy()
            return ModeSolution(forces, velocities, solver.modes, float(solver.residual))
        n, size = len(closed), base.size
        units, limits = size // 3, problem.limits.copy()
        mu = problem.limits.copy()
        radius_base, radius_rows, drag = np.zeros(2 * units), np.zeros((2 * units, size)), np.eye(size)
        start, slips = np.zeros(size), np.zeros(size)
        for i, c in enumerate(closed):
            start[3 * i + 2] = max(float(system.force[c, 2]), 0.0)
            radius_rows[2 * i, 3 * i + 2] = 1.0
            if i in sliding:
                direction = slip_direction(system, c)
                pull = _unscaled(problem.shapes, i, associated(system, c, direction))
                drag[3 * i : 3 * i + 2, 3 * i + 2] = -numbers[c, MU_NOW] * pull
                slips[3 * i : 3 * i + 2] = problem.shapes[i] @ direction if i in problem.shapes else direction
                mu[i], limits[i] = 0.0, numbers[c, MU_NOW]
            elif mu[i] > 0.0:
                start[3 * i : 3 * i + 2] = _unscaled(problem.shapes, i, system.force[c, :2])
        for i, g in enumerate(held, start=n):
            low, high = system.joint_real[g, :2]
            radius_base[2 * i] = 0.5 * (high - low)
        for i, u in turns.items():
            owner = 3 * closed.index(system.owner(i)) + 2
            if integers[i, MODE] == SLIPPING:
                slips[3 * u : 3 * u + 2] = direction = slip_direction(system, i)
                drag[3 * u : 3 * u + 2, owner], mu[u] = -numbers[i, MU_NOW] * direction, 0.0
            else:
                mu[u], radius_rows[2 * u, owner] = self._limits[i], 1.0
                start[3 * u : 3 * u + 2] = system.force[i, :2]

        def guess(speed: float) -> np.ndarray | None:
            """Forces of the symmetric problem in which what slides has that velocity, and turns have these loads."""
            pushed = base + speed * slips
            for i, u in turns.items():
                load = start[3 * closed.index(system.owner(i)) + 2]
                pushed[3 * u + 2] = -float(numbers[i, MU]) * load * problem.weights[3 * u + 2]
            return self.solver.forces if self.solver.solve(gram, pushed, limits) else None

        loads = Loads(gram, base, problem.normal, problem.tangents, mu, radius_base, radius_rows, drag)
        found = self.loads
        if not found.solve(loads, start, guess):
            self.proved = found.proved
            return None
        modes = loads.modes(found.forces)
        return ModeSolution(found.forces.reshape(-1, 3), found.velocities.reshape(-1, 3), modes, found.residual)


def _unscaled(shapes: dict[int, np.ndarray], i: int, force: np.ndarray) -> np.ndarray:
    """A tangential force (2,) in the coordinates in which the cone of unit i is round."""
    return np.linalg.solve(shapes[i], force) if i in shapes else force
