"""The contact problem at acceleration level, in which sliding friction is a multiple of the loads, and its solution.

Of contacts, held coordinates and resistances. Where nothing slides and no load is another unit's, it is a cone problem,
F in K_mu, u = G F + b, u + mu |u_t| n in the dual cone, complementary (`friction.cone`). Else it is one of loads and
discs (`friction.loads`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..friction.cone import OPEN, STICK
from ..friction.loads import LARGE_FRICTION, LoadSolver
from ..friction.solve import NO_PROGRAMS, ContactSolver
from ..layout import (
    JOINT_END,
    MODE,
    MU_NOW,
    SLIPPING,
)
from .contact_modes import held_up_by_friction
from .directions import slip_direction
from .units import ContactProblem, relative_velocity, unwhiten, whiten

if TYPE_CHECKING:
    from .system import System

# No slip that has just ended has a velocity left.
AT_REST: Mapping[int, float] = {}


class ModeSolution(NamedTuple):
    """Forces and relative accelerations (items, 3) along the rows of items, modes (items,) of their units, residual;
    largest: the largest acceleration without forces."""

    forces: np.ndarray
    velocities: np.ndarray
    modes: np.ndarray
    residual: float
    largest: float


class LoadedCones:
    """Solves contact problems of accelerations; keeps the solvers' buffers.

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

    def _pose(
        self, closed: list[int], held: list[int], ahead: Mapping[int, float] = AT_REST, normals: bool = False
    ) -> ContactProblem:
        """The problem of the last evaluation. What sticks holds up to `_limits`; what slides goes on as it does. ahead:
        times in s in which friction is to end the slip velocities of these items, if they stick, as in a time step of
        that size; normals: and loads the normal velocities, which are met otherwise."""
        system = self.system
        integers, numbers = system.contact_int, system.contact_real
        slides = integers[:, MODE] == SLIPPING
        mu = np.where(slides, numbers[:, MU_NOW], self._limits)
        lifted = [c for c in closed if held_up_by_friction(system, c)]
        mu[lifted] = LARGE_FRICTION
        joints, free = [system.nc + g for g in held], system.free_acceleration
        if held:
            free = free + unwhiten(system, whiten(system, self._push(held) @ system.rows[joints, 2]))
        at_ends = {system.nc + g for g in held if system.joint_int[g, JOINT_END] != 0}

        def relative(i: int, rows: list[int]) -> np.ndarray:
            rates = system.rows[i, rows] @ free + system.bias[i, rows]
            if i in ahead and not slides[i] and i not in at_ends:
                stopped = relative_velocity(system, i, rows) / ahead[i]
                met = (np.array(rows) == 2) & (i < system.nc) & (not normals)
                rates += np.where(met, 0.0, stopped)
            return rates

        problem = ContactProblem(system, relative)
        problem.add_contacts(closed, mu)
        for item, u in problem.units.items():
            if slides[item] and mu[item] > 0.0:
                shape, direction = problem.shapes.get(u, np.eye(2)), slip_direction(system, item)
                if item in lifted:
                    problem.lifted[u] = -np.linalg.solve(shape, direction)
                else:
                    along = shape @ direction
                    problem.slides[u] = along / (float(np.linalg.norm(along)) or 1.0)
        for g in held:
            # about its middle, friction is a disc of constant radius; at an end, what the end adds to friction only
            # pushes away from it
            end, (low, high) = int(system.joint_int[g, JOINT_END]), system.joint_real[g, :2]
            if end == 0:
                problem.radii[problem.add(system.nc + g, (2,), 1.0, places=(0,))] = 0.5 * (high - low)
            else:
                problem.add(system.nc + g, (2,), 0.0, -end)
        problem.assemble()
        return problem

    def _push(self, held: list[int]) -> np.ndarray:
        """(held,) forces of held coordinates that their units are measured from: the middle of the range of their dry
        friction, or what it has at their end."""
        low, high = self.system.joint_real[held, :2].T
        end = self.system.joint_int[held, JOINT_END]
        return np.where(end == 0, 0.5 * (low + high), np.where(end < 0, low, high))

    def _solve_posed(self, problem: ContactProblem, held: list[int]) -> ModeSolution | None:
        """Its solution; None where there is none, or none was found."""
        system = self.system
        self.cone_problems += 1
        if problem.impossible:
            self.proved = True
            return None
        joints, push = [system.nc + g for g in held], self._push(held)
        radii = np.zeros(problem.mu.size)
        radii[list(problem.radii)] = list(problem.radii.values())
        cones = problem.cone_problem(problem.base, radii)
        if problem.is_cone:
            solver = self.solver
            if not solver.solve(*cones):
                self.proved = solver.certificate is not None
                return None
            forces, velocities, modes = solver.forces, solver.velocities, solver.modes
            residual = float(solver.residual)
        else:
            loads, found = problem.loads(), self.loads
            present = system.force.copy()
            present[joints, 2] -= push
            start = problem.of_units(present)
            start[2::3] = np.maximum(start[2::3], 0.0)
            for u in problem.lifted:
                start[3 * u + 2] = math.hypot(*start[3 * u : 3 * u + 2])

            def guess(speed: float) -> np.ndarray | None:
                """Forces of the symmetric problem in which what slides has that velocity, and discs their present
                radii."""
                pushed = problem.base.copy()
                for u, direction in problem.slides.items():
                    pushed[3 * u : 3 * u + 2] += speed * direction
                for u, pull in problem.lifted.items():
                    pushed[3 * u : 3 * u + 2] -= speed * pull
                posed = problem.cone_problem(pushed, loads.radii(start))
                return self.solver.forces if self.solver.solve(*posed) else None

            if not found.solve(loads, start, guess):
                self.proved = found.proved
                return None
            forces, velocities, residual = found.forces, found.velocities, found.residual
            modes = loads.modes(forces)
        of_items = np.full(system.items, STICK)
        of_items[list(problem.units)] = modes
        for item, u in problem.units.items():
            if u in problem.lifted:
                of_items[item] = STICK if forces[3 * u : 3 * u + 2].any() else OPEN
        actual = problem.of_items(forces, True)
        actual[joints, 2] += push
        # dry friction, too, is known to this part of what it does
        largest = float(np.abs(cones[1]).max(initial=0.0))
        return ModeSolution(actual, problem.of_items(velocities, False), of_items, residual, largest)
