"""Cone problems in which sliding friction and the limits of resistances to turning are multiples of the loads.

Where nothing slides, the cone problem is the whole problem. Else it is one of loads and disks (`friction.loads`); only
with ideal rolling, whose slip may be held up by friction alone, a fixed point on the loads is sought instead.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..friction import cone
from ..friction.loads import Disk, Loads, LoadSolver
from ..friction.solve import NO_PROGRAMS, ContactSolver
from ..layout import (
    JOINT_END,
    MODE,
    MU,
    MU_NOW,
    SLIPPING,
    TANGENTS,
)
from .directions import slip_direction
from .friction_scaling import associated
from .mode_problem import ModeProblem

if TYPE_CHECKING:
    from .system import System


# Fixed point on loads where ideal rolling takes part: iterations in all, undamped ones, relative change that ends it.
_FIXED_POINT_ITERATIONS, _UNDAMPED, _FIXED_POINT_TOLERANCE = 100, 12, 1e-12


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
        normals = [3 * i + 2 for i in range(n)]
        normals += [3 * i + 2 for i, g in enumerate(held, start=n) if system.joint_int[g, JOINT_END] != 0]
        loads = Loads(gram, base, normals)
        start, slips, limits = np.zeros(size), np.zeros(size), problem.limits.copy()
        for i, c in enumerate(closed):
            force = system.force[c].copy()
            tangents = int(integers[c, TANGENTS])
            start[3 * i + 2] = max(float(force[2]), 0.0)
            if i in sliding:
                direction = slip_direction(system, c)
                drag = loads.drag.setdefault(3 * i + 2, np.zeros(size))
                drag[3 * i : 3 * i + 2] = -numbers[c, MU_NOW] * _unscaled(
                    problem.shapes, i, associated(system, c, direction)
                )
                slips[3 * i : 3 * i + 2] = problem.shapes[i] @ direction if i in problem.shapes else direction
                limits[i] = numbers[c, MU_NOW]
            elif limits[i] > 0.0:
                loads.disks.append(Disk([3 * i + j for j in range(tangents)], float(limits[i]), 3 * i + 2))
                start[3 * i : 3 * i + 2] = _unscaled(problem.shapes, i, force[:2])
        for i, g in enumerate(held, start=n):
            if system.joint_int[g, JOINT_END] == 0:
                low, high = system.joint_real[g, :2]
                loads.disks.append(Disk([3 * i], radius=0.5 * (high - low)))
        for i, u in turns.items():
            owner, tangents = closed.index(system.owner(i)), int(integers[i, TANGENTS])
            if integers[i, MODE] == SLIPPING:
                slips[3 * u : 3 * u + 2] = direction = slip_direction(system, i)
                drag = loads.drag.setdefault(3 * owner + 2, np.zeros(size))
                drag[3 * u : 3 * u + 2] = -numbers[i, MU_NOW] * direction
            else:
                rows = [3 * u + j for j in range(tangents)]
                loads.disks.append(Disk(rows, float(self._limits[i]), 3 * owner + 2))
                start[3 * u : 3 * u + 2] = system.force[i, :2]

        def guess(speed: float) -> np.ndarray | None:
            """Forces of the symmetric problem in which what slides has that velocity, and turns have these loads."""
            pushed = base + speed * slips
            for i, u in turns.items():
                load = start[3 * closed.index(system.owner(i)) + 2]
                pushed[3 * u + 2] = -float(numbers[i, MU]) * load * problem.weights[3 * u + 2]
            return self.solver.forces if self.solver.solve(gram, pushed, limits) else None

        if np.isinf(limits[:n]).any():
            # ideal rolling may slide held up by friction alone, which is no zero of the equations of loads
            return self._iterate_loads(problem, loads, start, limits)
        if not self.loads.solve(loads, start, guess):
            self.proved = self.loads.proved
            return None
        found = self.loads
        modes = np.full(size // 3, cone.STICK)
        for row, pressed in zip(normals, found.pressed):
            modes[row // 3] = cone.STICK if pressed else cone.OPEN
        for disk, slid in zip(loads.disks, found.slid):
            if slid and modes[disk.rows[0] // 3] != cone.OPEN:
                modes[disk.rows[0] // 3] = cone.SLIP
        return ModeSolution(found.forces.reshape(-1, 3), found.velocities.reshape(-1, 3), modes, found.residual)

    def _iterate_loads(
        self, problem: ModeProblem, loads: Loads, start: np.ndarray, limits: np.ndarray
    ) -> ModeSolution | None:
        """The solution as a fixed point: cone problems with the friction and the limits that the last loads give."""
        base, solver, before = problem.base.copy(), self.solver, start
        limits = limits.copy()
        limits[[row // 3 for row in loads.drag if loads.drag[row][row - 2 : row].any()]] = 0.0
        for iteration in range(_FIXED_POINT_ITERATIONS):
            pull = np.zeros(base.size)
            for row, drag in loads.drag.items():
                pull += before[row] * drag
            for disk in loads.disks:
                if disk.normal is not None and disk.rows[0] // 3 != disk.normal // 3:
                    normal = 3 * (disk.rows[0] // 3) + 2
                    base[normal] = -disk.factor * before[disk.normal] * problem.weights[normal]
            self.cone_problems += 1
            if not solver.solve(problem.gram, base + problem.gram @ pull, limits):
                return None
            after = solver.forces + pull
            change = float(np.abs(after - before)[loads.normals].max())
            if change <= _FIXED_POINT_TOLERANCE * (1.0 + float(np.abs(after).max())):
                forces, velocities = after.reshape(-1, 3), solver.velocities.reshape(-1, 3).copy()
                return ModeSolution(forces, velocities, solver.modes, float(solver.residual))
            before = after if iteration < _UNDAMPED else 0.5 * (before + after)
        return None


def _unscaled(shapes: dict[int, np.ndarray], i: int, force: np.ndarray) -> np.ndarray:
    """A tangential force (2,) in the coordinates in which the cone of unit i is round."""
    return np.linalg.solve(shapes[i], force) if i in shapes else force
