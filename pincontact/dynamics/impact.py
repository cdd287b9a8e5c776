"""Impacts: Newton restitution and Coulomb friction in impulses, by the same cone problem as the modes.

Everything that is closed takes part at once. Bilateral contacts' normals, and tangents that cannot slip, are equations
and are eliminated; friction of bilateral contacts is a disk whose radius follows from their normal impulse; ends of
joints' ways take part as normals, without restitution. Dry joint friction is a finite force and has no impulse.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq

from ..friction.choices import Units, chosen_forces, holding_loads
from ..friction.cone import PAINLEVE_LIMIT, SLIP, STICK
from ..friction.feasibility import crushing_combination
from ..friction.loads import TOLERANCE, LoadSolver
from ..friction.solve import ContactSolver
from ..layout import (
    CURVE_SPEED,
    JOINT_END,
    MODE,
    MOTION_KIND,
    MU,
    MU_STATIC,
    SLIPPING,
    TANGENTS,
    TIME_DEPENDENT,
)
from ..layout import STICK as STICKING
from .energy import ENERGY_SLACK
from .event_functions import IDEAL_FRICTION
from .units import REDUNDANT, ContactProblem, relative_velocity, unwhiten, whitened_velocity

if TYPE_CHECKING:
    from .system import System

# What accelerates, as a part of the slip, where an impact without collision is looked for: solvers know velocities to a
# hundredth of that.
_AHEAD = 1e-8
# Velocities that contradict each other by this part of the largest one, or of 1 m/s, are known no better.
_AGREES = 1e-9
# Friction is as much larger there as takes slip beyond where it counts as jammed.
_BEYOND = 1.0 + 10.0 * PAINLEVE_LIMIT
# Impulses that differ by no more than this part of the largest are those of the same solution.
_NEAR = 1e-3
# A choice turns the slip, and with it what is to be chosen, at most so often.
_TURNS = 50
# How accurately is known which part of the restitution makes no energy.
_KEPT_TO = 1e-12


@dataclass(frozen=True)
class Impact:
    """Work in J of an impact: contact impulses on v_c, on drives, ends of joints' ways; kept: factor of restitution."""

    contacts: float
    drives: float
    joints: float
    kept: float


def apply_impact(
    system: System,
    solver: ContactSolver,
    closed: list[int],
    ends: list[int],
    restitution: dict[int, float],
    struck: Collection[int] = (),
    jammed: bool = False,
) -> Impact | None:
    """Change the system's v by the impulses of an impact; None if no impulses satisfy the laws.

    Uses rows, v_c and the factor of M of the last evaluation. closed: contacts that take part; ends: joint
    coordinates that are held at an end; restitution: contact -> coefficient, applied to the approach speed of v_c, 0
    for others, and lowered where it would create energy (`energy`); struck: contacts that were open before; jammed:
    an impact without collision, which no impulses would solve, too: the one that time stepping finds, however short its
    steps, is the solution with what accelerates in a short time.

    Tangential impulses obey Coulomb's law with the final slip velocity. The coefficient is that of the speed of slip
    before; what was at rest holds up to that of sticking, and has that of sliding if it does not hold.
    """
    problem = _Problem(system, closed, ends, restitution, struck, jammed)
    y: np.ndarray | None
    if jammed:
        pushed = _Problem(system, closed, ends, restitution, struck, True, _time_ahead(system, closed))
        y = problem.jam(solver, pushed)
    else:
        y = problem.solve(solver, 1.0)
    kept = 1.0
    if problem.rebound.any() and (y is None or problem.gain(y) > 0.0):
        # constraints that depend on each other may leave a rebound no way: as in time stepping, there is none then
        kept = 0.0 if y is None else problem.most_kept(solver)
        y = problem.solve(solver, kept)
    if y is None:
        return None
    contacts, joints, _ = problem.work(y)
    drives = 0.0
    if problem.driven:
        # what the joints receive and the relative velocities do not account for
        before = whitened_velocity(system, system.v)
        drives = float(y @ before + 0.5 * y @ y) - contacts - joints
    system.v[:] += unwhiten(system, y)
    return Impact(contacts, drives, joints, kept)


def crushing_items(system: System, closed: list[int], ends: list[int]) -> list[int]:
    """Contacts of those closed, and joints (nc + coordinate) of those at their ends, whose normal impulses prove that
    none keep bodies apart; none where there is no such proof."""
    problem = _Problem(system, closed, ends, {})
    pressing = crushing_combination(problem.gram, problem.base)
    return [] if pressing is None else [item for item, unit in problem.units.items() if pressing[unit] > 0.0]


class _Problem(ContactProblem):
    """The problem of one impact, in whitened changes of velocity y = L (v+ - v-).

    slip (3n,): of contacts that slide with two tangents, along these; zero elsewhere.
    """

    def __init__(
        self,
        system: System,
        closed: list[int],
        ends: list[int],
        restitution: dict[int, float],
        struck: Collection[int] = (),
        jammed: bool = False,
        ahead: float = 0.0,
    ) -> None:
        integers = system.contact_int

        def relative(item: int, rows: list[int]) -> np.ndarray:
            speed = relative_velocity(system, item, rows)
            if ahead > 0.0:
                speed = speed + ahead * (system.rows[item, rows] @ system.free_acceleration + system.bias[item, rows])
            return speed

        super().__init__(system, relative)
        mu = system.contact_real[:, MU].copy()
        mu[closed] = [coefficient(system, c) for c in closed]
        holding = mu.copy()
        for c in closed:
            if integers[c, MODE] == STICKING and c not in struck:
                holding[c] = system.contact_real[c, MU_STATIC]
        if jammed:
            mu, holding = _BEYOND * mu, _BEYOND * holding
        self.add_contacts(closed, holding)
        self.contacts = len(self.units)
        for g in ends:
            self.add(system.nc + g, (2,), 0.0, -float(system.joint_int[g, JOINT_END]))
        self.assemble()
        self.sliding = mu[list(self.units)]
        self.sliding[self.contacts :] = 0.0
        self.rebound = np.zeros(self.mu.size)
        for c, u in self.units.items():
            if self.normal[u] and c < system.nc:
                self.rebound[u] = restitution.get(c, 0.0) * min(self.before[3 * u + 2], 0.0)
        self.forces, self.slip = np.zeros((2, self.before.size))
        for c, u in self.units.items():
            if c < system.nc and integers[c, MODE] == SLIPPING and integers[c, TANGENTS] == 2 and mu[c] < math.inf:
                self.slip[3 * u : 3 * u + 2] = self.before[3 * u : 3 * u + 2]
        self._keep_within_reach(_AGREES * (1.0 + float(np.abs(system.v).max(initial=0.0))))
        sides = [2 * c + side for c in closed for side in range(2)]
        self.driven = any(
            system.side_int.item(i, MOTION_KIND) or system.side_int.item(i, TIME_DEPENDENT) for i in sides
        )

    def _keep_within_reach(self, allowed: float) -> None:
        """Take out of the normal velocities what no motion could follow, where that is no more than allowed (m/s): of a
        body that fits between others they contradict each other by round-off."""
        normals = self.reduced[:, 2::3]
        if normals.shape[1] > 1:
            wanted = self.base[2::3] * (self.normal > 0.0)
            out = wanted - normals.T @ np.linalg.lstsq(normals.T, wanted, rcond=REDUNDANT)[0]
            if np.abs(out).max() <= allowed:
                self.base[2::3] -= out

    def solve(self, solver: ContactSolver, kept: float) -> np.ndarray | None:
        """y with `kept` of the restitution, or None."""
        b = self.base.copy()
        b[2::3] += kept * self.rebound
        mu = self.mu.copy()
        while mu.size:
            if self.impossible:
                return None
            modes = self._hold(b, mu, self._search(solver, b, mu))
            if modes is None:
                return None
            mu, modes = self._let_unpressed_go(solver, b, mu, modes)
            slips = (modes == SLIP) & (mu > self.sliding)
            if not slips.any():
                self._choose(b, mu, modes)
                break
            mu[slips] = self.sliding[slips]
        return self._y()

    def jam(self, solver: ContactSolver, pushed: _Problem) -> np.ndarray | None:
        """y of the solution near to that of the problem with what accelerates, or None.

        As in time stepping, slip that goes on is opposed along the mean of what it is before and after; along the
        latter, where some of it ends or turns back.
        """
        for slip in (self.slip, np.zeros(self.base.size)):
            for problem in (self, pushed):
                problem.base += slip
            found = pushed.solve(solver, 1.0) is not None
            if found:
                self.forces = self._near(pushed.forces)
            for problem in (self, pushed):
                problem.base -= slip
            after = (pushed.gram @ pushed.forces + pushed.base) * (slip != 0.0)
            along = np.einsum("ij,ij->i", after.reshape(-1, 3), slip.reshape(-1, 3))
            if found and (along[slip.reshape(-1, 3).any(axis=1)] > 0.0).all():
                break
        if not found:
            return None
        # what accelerates parts no bodies
        loaded = 3 * np.flatnonzero((self.normal > 0.0) & (self.forces[2::3] > 0.0)) + 2
        rows, parting = self.reduced[:, loaded], (self.gram @ self.forces + self.base)[loaded]
        y: np.ndarray = self._y() - np.linalg.lstsq(rows.T, parting, rcond=REDUNDANT)[0]
        return y

    def _near(self, forces: np.ndarray) -> np.ndarray:
        """Impulses (3n,) of a solution near to these, which are those of a little other velocities; else these. No
        impulses at all may be a solution, too."""
        if not forces.size:
            return forces
        found, residual = self.loads().refine(forces)
        change = np.abs(found - forces).max(initial=0.0)
        return found if residual <= TOLERANCE and change <= _NEAR * np.abs(forces).max(initial=0.0) else forces

    def _y(self) -> np.ndarray:
        """y of the present impulses."""
        return self.start + self.reduced @ self.forces

    def _let_unpressed_go(
        self, solver: ContactSolver, b: np.ndarray, mu: np.ndarray, modes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients and modes (n,) without the friction of ideal rolling that has a tangential impulse in these, but
        no load, neither with its friction nor without."""
        found, tangential = self.forces, np.linalg.norm(self.forces.reshape(-1, 3)[:, :2], axis=1)
        unpressed = np.isinf(mu) & (self.normal > 0.0) & (self.forces[2::3] * IDEAL_FRICTION < tangential)
        while unpressed.any():
            without = np.where(unpressed, 0.0, mu)
            others = self._hold(b, without, self._search(solver, b, without))
            still = unpressed & (self.forces[2::3] * IDEAL_FRICTION <= tangential)
            if others is not None and (still == unpressed).all():
                return without, others
            unpressed, self.forces = still & (others is not None), found
        return mu, modes

    def _search(self, solver: ContactSolver, b: np.ndarray, mu: np.ndarray) -> np.ndarray | None:
        """Modes (n,) of a solution, whose impulses are `forces` then, or None."""
        if self.is_cone and solver.solve(self.gram, b, mu, afresh=True):
            self.forces = np.where(self.weights > 0.0, 0.0, solver.forces)
            return solver.modes
        loads, start = replace(self.loads(), base=b, mu=mu), np.zeros(b.size)
        self.forces, residual = loads.refine(start)
        if not residual <= TOLERANCE:
            self.forces, residual = loads.solve(start)
        if not residual <= TOLERANCE:
            found = LoadSolver()

            def guess(speed: float) -> np.ndarray | None:
                """With radii that are given it is a cone problem, whose loads tell others."""
                gram, base, limits = self.cone_problem(b, loads.radii(start))
                posed = gram, base, np.where(self.normal > 0.0, loads.coefficients, limits)
                return np.where(self.weights > 0.0, 0.0, solver.forces) if solver.solve(*posed, afresh=True) else None

            if found.solve(loads, start, guess):
                self.forces, residual = loads.refine(found.forces)
        return loads.modes(self.forces) if residual <= TOLERANCE else None

    def _hold(self, b: np.ndarray, mu: np.ndarray, modes: np.ndarray | None) -> np.ndarray | None:
        """Modes (n,) after ideal rolling that slips, or for which no impulses were found, is held, if it can be: what
        resists its turning may be needed for that, too."""
        held = np.isinf(mu)
        if modes is None:
            self.forces, before = np.zeros(b.size), np.where(mu > 0.0, STICK, SLIP)
        else:
            held, before = held & (modes == SLIP), modes
            if held.any():
                slips = np.abs(self.gram @ self.forces + b).reshape(-1, 3)[:, :2].max(axis=1)
                held &= slips > TOLERANCE * float(np.abs(b).max())
        if not held.any():
            return modes
        coupled, parents = replace(self.loads(), base=b, mu=mu), self.parents()
        turns = (self.normal == 0.0) & (parents >= 0) & held[parents]
        for sticks in (held, held | turns):
            units = self._units(b, mu, np.where(sticks, STICK, before))
            found = holding_loads(units, coupled, held, parents < 0)
            if found is not None:
                self.forces = found[0]
                return coupled.modes(self.forces)
        return modes

    def _units(self, b: np.ndarray, mu: np.ndarray, modes: np.ndarray) -> Units:
        """The problem with its present impulses, in these modes (n,)."""
        parents, real = self.parents(), self.weights.reshape(-1, 3) == 0.0
        present = self.forces.reshape(-1, 3), (self.gram @ self.forces + b).reshape(-1, 3)
        return Units(self.gram, b, mu, real, parents, np.zeros(mu.size), modes, *present)

    def _choose(self, b: np.ndarray, mu: np.ndarray, modes: np.ndarray) -> None:
        """Of redundant impulses take those that the rule for sliding contacts has, where these solve the problem, too:
        bodies between others may be squeezed by any, which their friction would feel."""
        loads = replace(self.loads(), base=b, mu=mu)
        for _ in range(_TURNS):
            chosen = chosen_forces(self._units(b, mu, modes))
            if chosen is None:
                break
            chosen, residual = loads.refine(chosen)
            if residual > TOLERANCE:
                break
            change = float(np.abs(chosen - self.forces).max())
            self.forces, modes = chosen, loads.modes(chosen)
            # friction turns with the slip that the choice changes
            if change <= _KEPT_TO * float(np.abs(chosen).max()):
                break

    def gain(self, y: np.ndarray) -> float:
        """Energy that impulses make, as a part of the sizes of all terms, beyond what is round-off."""
        contacts, joints, size = self.work(y)
        return (contacts + joints) / size - ENERGY_SLACK if size > 0.0 else 0.0

    def most_kept(self, solver: ContactSolver) -> float:
        """The largest part of the restitution with which impulses make no energy; 0 where any makes some."""

        def gain(kept: float) -> float:
            y = self.solve(solver, kept)
            # what has no solution is as bad as can be
            return 1.0 if y is None else self.gain(y)

        if gain(0.0) > 0.0:
            return 0.0
        return max(float(brentq(gain, 0.0, 1.0, xtol=_KEPT_TO)) - _KEPT_TO, 0.0)

    def work(self, y: np.ndarray) -> tuple[float, float, float]:
        """Work of the contacts' and of the joints' impulses, and the sum of the sizes of all terms."""
        after = self.before + self.stack.T @ y
        terms = 0.5 * self.forces * (self.before + after)
        split = 3 * self.contacts
        size = 0.5 * np.abs(self.forces) @ (np.abs(self.before) + np.abs(after))
        return float(terms[:split].sum()), float(terms[split:].sum()), float(size)


def _time_ahead(system: System, closed: list[int]) -> float:
    """Time in s in which contacts accelerate by a part of their slip that is small, and not lost in round-off."""
    slip = np.einsum("cij,cj->ci", system.basis[closed], system.slip[closed])
    rates = system.rows[closed] @ system.free_acceleration + system.bias[closed]
    largest = float(np.abs(rates).max(initial=0.0))
    return _AHEAD * float(np.abs(slip).max(initial=0.0)) / largest if largest > 0.0 else 0.0


def coefficient(system: System, c: int) -> float:
    """Coefficient of friction of contact c at its present speed of slip."""
    numbers = system.contact_real[c]
    if numbers[CURVE_SPEED] == 0.0:
        return float(numbers[MU])
    speed = float(np.linalg.norm(system.basis[c, : system.contact_int[c, TANGENTS]] @ system.slip[c]))
    law = system.contacts[c].friction
    assert law is not None
    return float(law.coefficient(speed))
