"""Cone problems of time steps that the compiled ways do not solve, and choices among redundant forces."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..friction.choices import Units, chosen_forces, holding_forces, holding_loads, rows_of
from ..friction.cone import OPEN, SLIP, STICK
from ..friction.feasibility import crushing_combination
from ..friction.loads import RADII_TOLERANCE, Loads
from ..friction.loads import TOLERANCE as LOAD_TOLERANCE
from ..friction.solve import ContactSolver
from ..friction.starts import NEAREST, solve_cones
from ..workspace import Workspace
from .impulse_layout import APART, IN_VAIN, LOOKED_FOR, ON_JOINT, ON_LOADED, ON_TURN, TOGETHER, WANTED
from .impulse_problem import least_way

# Modes (n,), forces and velocities (3n,) of a solution.
Solution = tuple[np.ndarray, np.ndarray, np.ndarray]

# Compliances relative to the contacts' own, tried in turn where the cone problem has no solution.
_COMPLIANCES = (1e-10, 1e-8, 1e-6, 1e-4)
# What such a solution's forces may be, as velocities, relative to the largest one in b.
_LARGEST_FORCE = 10.0


@dataclass(frozen=True)
class _Problem:
    """The assembled problem of n units, views of the step's arrays: velocities = gram forces + base."""

    n: int
    gram: np.ndarray
    base: np.ndarray
    friction: np.ndarray
    units: np.ndarray

    @property
    def cones(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As the solver takes it."""
        return self.gram, self.base, self.friction

    def with_solution(self, modes: np.ndarray, forces: np.ndarray, velocities: np.ndarray | None = None) -> Units:
        """The problem with a solution of it, for those that choose among redundant forces."""
        units, velocities = self.units, self.gram @ forces + self.base if velocities is None else velocities
        real = self.real_rows
        turns = units["kind"] == ON_TURN
        parents = np.where(real[:, 2], np.arange(self.n), np.where(turns, units["parent"], -1))
        pairs = forces.reshape(-1, 3), velocities.reshape(-1, 3)
        return Units(*self.cones, real, parents, units["load"], modes, *pairs)

    @property
    def real_rows(self) -> np.ndarray:
        """(n, 3) which rows do not only fill up their cones."""
        real: np.ndarray = self.units["mask"][:, None] >> np.arange(3) & 1 != 0
        return real


class ImpulseSolver:
    """The solver of a step's cone problems, for what compiled code leaves of them.

    solver: the contact solver, whose tables the compiled code uses, too. Counters: problems that were left, solved with
    compliance (softened), or with the friction of other loads (settled), and by how much the radii of friction were off
    in the latter, relative to the largest.
    """

    def __init__(self, arrays: Workspace) -> None:
        self.solver = ContactSolver(quick=True)
        self._arrays, self._counts, self._numbers = arrays, arrays.counts, arrays.numbers
        self._numbers["cone_tolerance"], self._counts["cone_task"] = self.solver.tolerance, self.solver.task

    def choose(self, contact_solver: str) -> None:
        """How contact problems are solved from now on, see `ContactSolver.choose`."""
        self.solver.choose(contact_solver)
        self._counts["cone_task"] = self.solver.task

    def begin(self) -> None:
        """Count anew."""
        self.left = self.softened = self.settled = 0
        self.settled_off = 0.0
        self._share_tables()

    def restore(self, kept: list[tuple[np.ndarray, np.ndarray, np.ndarray, int]]) -> None:
        """Take the warm starts of another solver."""
        self.solver.forget()
        for solution in kept:
            self.solver.warm_start(*solution)
        self._share_tables()

    def makes_room(self) -> bool:
        """Whether there was no table yet for problems of the assembled one's size, which compiled code tries first."""
        n = self._counts["units"].item()
        if self._arrays.cone_tables[n] != 0:
            return False
        self.solver.address(n)
        self._share_tables()
        return True

    def solve(self) -> bool:
        """Solve the assembled problem; its solution is where `impulses.advance` looks for it."""
        arrays, counts, solver, problem = self._arrays, self._counts, self.solver, self._assembled()
        n, rows = problem.n, slice(3 * problem.n)
        if counts["holding"] == WANTED:
            counts["holding"] = LOOKED_FOR if self._hold(problem) else IN_VAIN
        elif counts["choosing"]:
            self._choose(problem)
        else:
            self.left += 1
            if not (self._search(problem) or (counts["thorough"] and self._search_hard(problem))):
                return False
            self._numbers["cone_residual"] = max(self._numbers["cone_residual"], solver.residual)
        arrays.cone_forces[rows], arrays.cone_velocities[rows] = solver.forces, solver.velocities
        arrays.cone_modes[:n] = solver.modes
        return True

    def crushing(self) -> list[tuple[bool, int]]:
        """Of the assembled problem those whose normal impulses prove that none keep bodies apart: whether they are
        joints, and the index of the contact or of the coordinate; none where there is no such proof."""
        problem = self._assembled()
        pressing = crushing_combination(problem.gram, problem.base)
        units = problem.units[[] if pressing is None else pressing > 0.0]
        return list(zip((units["kind"] == ON_JOINT).tolist(), units["index"].tolist()))

    def _assembled(self) -> _Problem:
        arrays, n = self._arrays, self._counts["units"].item()
        gram, rows = arrays.delassus[: 9 * n * n].reshape(3 * n, 3 * n), slice(3 * n)
        return _Problem(n, gram, arrays.loads[rows], arrays.friction[:n], arrays.units[:n])

    def _share_tables(self) -> None:
        """Let compiled steps know where the solver works."""
        for size, address in self.solver.addresses():
            if size < self._arrays.cone_tables.size:
                self._arrays.cone_tables[size] = address

    # ---------------------------------------------------------------- redundant forces

    def _hold(self, problem: _Problem) -> bool:
        """Replace a solution that lets go what was at rest by one in the same modes of all else that does not, if there
        is one."""
        solver = self.solver
        solver.address(problem.n)
        held = problem.units["held"] != 0
        before = solver.kept()
        rests, opened = held & (before[0] == SLIP), held & (before[0] == OPEN)
        # what resists turning may be needed to hold, and where it was to carry nothing in slip, again; what turns comes
        # to rest in impacts only
        parents, units = problem.units["parent"], problem.units
        turns = (units["kind"] == ON_TURN) & (parents >= 0) & held[parents]
        turns &= ~self._turning(problem) | (units["touches"][parents] != 0)
        lets_go, tries = rests | opened, (rests, rests | turns, rests | opened | turns)
        groups = [members for members in problem.with_solution(*before).groups() if lets_go[members].any()]
        # all are tried, whatever comes of the first
        return all([self._hold_group(problem, members, held, tries) for members in groups])

    def _hold_group(
        self, problem: _Problem, members: np.ndarray, held: np.ndarray, tries: tuple[np.ndarray, ...]
    ) -> bool:
        """The same of a group of units that act on each other. tries (n,): what is to stick."""
        before, own = self.solver.kept(), np.zeros(held.size, dtype=bool)
        own[members] = True
        wanted = (np.where(sticks & own, STICK, before[0]) for sticks in tries)
        for modes in {modes.tobytes(): modes for modes in wanted}.values():
            if self._holds(problem, members, modes, before, held & own):
                return True
        self.solver.warm_start(*before)
        return False

    def _holds(
        self, problem: _Problem, members: np.ndarray, modes: np.ndarray, before: Solution, held: np.ndarray
    ) -> bool:
        """Whether there are forces of these units in these modes (n,), which are the solver's then; held (n,): what
        must not slip."""
        units = problem.with_solution(modes, *before[1:])
        loaded = problem.units["kind"] == ON_LOADED
        if (loaded & (modes == STICK)).any():
            # loads that the problem takes as given, and what is held may change
            coupled = self._loads(problem)
            solution = holding_loads(units, coupled, held, loaded)
            if solution is None:
                return False
            self._take(coupled, *solution)
            self._counts["coupled"] = TOGETHER
            return True
        own = holding_forces(units.part(members))
        if own is None:
            return False
        found = units.forces.ravel().copy()
        found[rows_of(members)] = own
        velocities = problem.gram @ found + problem.base
        velocities[np.repeat(modes == STICK, 3)] = 0.0
        self.solver.residual = residual = self._solve_near(problem, modes, found, velocities)
        together = self._counts["coupled"] == TOGETHER or not residual <= self.solver.tolerance
        if together:
            if not (problem.units["parent"] >= 0).any():
                return False
            # what resists turning has other loads now
            coupled = self._loads(problem)
            found, residual = coupled.refine(found)
            if not residual <= LOAD_TOLERANCE:
                return False
            self._take(coupled, found, residual)
        if (held & (self.solver.modes == SLIP)).any():
            return False
        if together:
            self._counts["coupled"] = TOGETHER
        return True

    def _choose(self, problem: _Problem) -> None:
        """Replace redundant forces that depend on the last ones by those that the rule has."""
        solver = self.solver
        solver.address(problem.n)
        before = solver.kept()
        found = chosen_forces(problem.with_solution(*before), problem.units["chooses"] != 0)
        if found is None:
            return
        residual = self._solve_near(problem, before[0], found, problem.gram @ found + problem.base)
        if not residual <= solver.tolerance:
            solver.warm_start(*before)

    def _solve_near(self, problem: _Problem, modes: np.ndarray, forces: np.ndarray, velocities: np.ndarray) -> float:
        """Residual of the solution that Newton's method finds from this one."""
        solver = self.solver
        solver.warm_start(modes, forces, velocities)
        address = solver.address(problem.n)
        return float(solve_cones(*problem.cones, address, NEAREST, solver.tolerance))

    # ---------------------------------------------------------------- searches

    def _search(self, problem: _Problem) -> bool:
        """The quick ways; loads that the problem takes as given are then found together with the forces."""
        counts = self._counts
        if counts["coupled"] == APART:
            touched = bool(counts["touched"])
            # the usual ways have been tried
            if self.solver.search(*problem.cones, afresh=touched):
                return True
            if not np.isin(problem.units["kind"], (ON_LOADED, ON_TURN)).any():
                return False
            counts["coupled"] = TOGETHER
        return self._solve_together(problem)

    def _turning(self, problem: _Problem) -> np.ndarray:
        """(n,) which units slide or turn at the step's start."""
        start: np.ndarray = self._arrays.unit_start[: problem.n]
        h = self._numbers["h"]
        return np.abs(start).max(axis=1) * h > least_way(h)

    def _search_hard(self, problem: _Problem) -> bool:
        """What the quick searches did not solve: with a little compliance in the contacts, since with redundant ones b
        may be out of reach by a little; for forces and loads at once; then without rebounds; then, with friction that
        goes with other loads, what has a solution unless bodies are crushed.

        (Several points of a body that must not slip, of which one rebounds, are an example.)
        """
        counts, numbers = self._counts, self._numbers
        if counts["coupled"] == APART:
            if self._solve_softened(problem):
                return True
            counts["coupled"] = TOGETHER
            if self._solve_together(problem):
                return True
        problem.base[2::3] += numbers["kept"] * problem.units["shift"]
        numbers["kept"] = numbers["kept_low"] = numbers["kept_high"] = 0.0
        return self._solve_together(problem) or self._solve_with_given_radii(problem)

    def _solve_softened(self, problem: _Problem) -> bool:
        """The solution with the least compliance that gives one."""
        solver = self.solver
        diagonal = np.einsum("ii->i", problem.gram)
        stiff = diagonal.copy()
        unit = np.repeat(stiff.reshape(-1, 3).mean(axis=1), 3)
        largest = _LARGEST_FORCE * float(np.abs(problem.base).max())
        for share in _COMPLIANCES:
            diagonal[:] = stiff + share * unit
            if solver.solve(*problem.cones):
                # contacts that wedge each other are held by next to nothing but the compliance
                if float((unit * np.abs(solver.forces)).max()) <= largest:
                    self.softened += 1
                    return True
                solver.forget()
        diagonal[:] = stiff
        return False

    def _loads(self, problem: _Problem) -> Loads:
        """The problem with the loads that it takes as given as functions of the forces."""
        arrays, n, units = self._arrays, problem.n, problem.units
        load, slope = np.zeros((n, 2)), np.zeros((n, 2, 3 * n))
        # impulses of equations: share - overlap^T F, carried back to their rows
        e = self._counts["equations"].item()
        index = arrays.equation_index[:e]
        known = np.c_[arrays.equation_share[:e], -arrays.overlap[: 3 * n, :e].T]
        factor = np.tril(arrays.equation_factor[:e, :e])
        # of redundant ones the least, as in `impulse_equations`
        says = factor.diagonal() > 0.0
        root = np.sqrt(arrays.equation_unit[:e]) if not says.all() else np.ones(e)
        impulses = np.linalg.pinv((factor[:, says] / root[:, None]).T) @ known[says] / root[:, None]
        real = problem.real_rows
        for u, (kind, c, parent) in enumerate(units[["kind", "index", "parent"]].tolist()):
            if real[u, 2]:
                slope[u, 0, 3 * u + 2] = 1.0
            elif kind == ON_TURN and parent >= 0:
                slope[u, 0, 3 * parent + 2] = 1.0
            elif kind == ON_JOINT:
                load[u, 0] = units["load"][u]
            else:
                rows = np.flatnonzero((index[:, 0] == c) & (index[:, 1] >= (2 if kind == ON_TURN else 0)))
                for k, row in enumerate(rows):
                    load[u, k], slope[u, k] = impulses[row, 0], impulses[row, 1:]
        base = np.where(real.ravel(), problem.base, 0.0)
        normal, tangents = real[:, 2].astype(float), real[:, :2].sum(axis=1).astype(float)
        loads = load.ravel(), slope.reshape(2 * n, 3 * n)
        return Loads(problem.gram, base, normal, tangents, problem.friction.copy(), *loads)

    def _solve_together(self, problem: _Problem) -> bool:
        """Solve the problem for forces and loads at once."""
        coupled, residual = self._loads(problem), math.inf
        if self._counts["reviews"]:
            # what slides goes on, though it might jam: the solution nearest to where the fixed point began
            forces, residual = coupled.refine(self._arrays.first_forces[: 3 * problem.n])
        if not residual <= LOAD_TOLERANCE:
            forces, residual = coupled.solve(self.solver.start(problem.n))
        if not residual <= LOAD_TOLERANCE:
            self._nearest = forces
            return False
        chosen = chosen_forces(problem.with_solution(coupled.modes(forces), forces))
        if chosen is not None:
            # what slides turns a little
            chosen, accuracy = coupled.refine(chosen)
            if accuracy <= LOAD_TOLERANCE:
                forces, residual = chosen, accuracy
        self._take(coupled, forces, residual)
        return True

    def _solve_with_given_radii(self, problem: _Problem) -> bool:
        """Solve it with friction that goes with the loads that came nearest to a solution."""
        coupled, mu, base, loads = self._loads(problem), problem.friction, problem.base, self._nearest
        for _ in range(problem.n):
            forces, modes, residual, off = coupled.solve_with_radii(loads)
            # ideal rolling has no other friction to go with: what carries a load does not slip
            slips = np.abs((problem.gram @ forces + base).reshape(-1, 3)[:, :2]).max(axis=1)
            loaded = forces[2::3] > RADII_TOLERANCE * np.abs(forces).max(initial=0.0)
            slipping = np.isinf(mu) & loaded & (slips > RADII_TOLERANCE * np.abs(base).max(initial=0.0))
            if not slipping.any():
                break
            loads = np.where(np.repeat(slipping, 3), forces, loads)
        if not residual <= RADII_TOLERANCE or slipping.any():
            return False
        self.settled += 1
        self.settled_off = max(self.settled_off, off)
        self._take(coupled, forces, residual, modes)
        return True

    def _take(self, coupled: Loads, forces: np.ndarray, residual: float, modes: np.ndarray | None = None) -> None:
        """Let the solver have these forces as its own, in modes (n,) that they do not tell."""
        modes = coupled.modes(forces) if modes is None else modes
        velocities = coupled.gram @ forces + coupled.base
        given = coupled.radii(forces) / np.where(coupled.mu > 0.0, coupled.mu, 1.0)
        forces[2::3] = np.where(coupled.normal > 0.0, np.where(modes == OPEN, 0.0, forces[2::3]), given)
        self.solver.warm_start(modes, forces, velocities)
        self.solver.residual = residual
