"""Impacts: Newton restitution and Coulomb friction in impulses, by the same cone problem as the modes.

Everything that is closed takes part at once. Bilateral contacts' normals, and tangents that cannot slip, are equations
and are eliminated; friction of bilateral contacts is a disk whose radius follows from their normal impulse; ends of
joints' ways take part as normals, without restitution. Dry joint friction is a finite force and has no impulse.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..friction.cone import SLIP
from ..friction.solve import ContactSolver
from ..friction.stribeck import stribeck
from ..geometry.patterns import ON_CURVE
from ..layout import (
    JOINT_END,
    MODE,
    MOTION_KIND,
    MU,
    MU_FAST,
    MU_STATIC,
    PATTERN,
    STICK,
    STRIBECK_EXPONENT,
    STRIBECK_SPEED,
    TANGENTS,
    TIME_DEPENDENT,
    UNILATERAL,
)
from .energy import ENERGY_SLACK, KEPT_ACCURACY
from .friction_scaling import stretch
from .units import contact_rows, delassus, unit_columns, unwhiten, whiten, whitened_velocity

if TYPE_CHECKING:
    from .system import System

# Equations that combine to less than this, relative to their size, are redundant.
_REDUNDANT = 1e-9
# Fixed point on normal impulses that are loads of others: its iterations, and the change, as a part of the largest
# impulse, at which it ends; cone problems are solved to about a tenth of that.
_LOAD_ITERATIONS = 100
_LOAD_CHANGE = 1e-10
_UNDAMPED = 12
# Coefficients that stand in for infinite ones where redundant contacts' ideal rolling contradicts itself by round-off.
_LARGE_FRICTION = (1e4, 1e2)


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
) -> Impact | None:
    """Change the system's v by the impulses of an impact; None if no impulses satisfy the laws.

    Uses rows, v_c and the factor of M of the last evaluation. closed: contacts that take part; ends: guarded joint
    coordinates that are held at an end; restitution: contact -> coefficient, applied to the approach speed of v_c, 0
    for others, and lowered where it would create energy (`energy`); struck: contacts that were open before.

    Tangential impulses obey Coulomb's law with the final slip velocity. The coefficient is that of the speed of slip
    before; what was at rest holds up to that of sticking, and has that of sliding if it does not hold.
    """
    problem = _Problem(system, closed, ends, restitution, struck)
    kept, low, high = 1.0, 0.0, 1.0
    while True:
        y = problem.solve(solver, kept)
        if y is None:
            return None
        contacts, joints, size = problem.work(y)
        creates = contacts + joints > ENERGY_SLACK * size
        if kept == 1.0 and not creates:
            break
        low, high = (low, kept) if creates else (kept, high)
        if high - low < KEPT_ACCURACY:
            if kept == low:
                break
            kept = low
        else:
            kept = 0.5 * (low + high)
    drives = 0.0
    if problem.driven:
        # what the joints receive and the relative velocities do not account for
        before = whitened_velocity(system, system.v)
        drives = float(y @ before + 0.5 * y @ y) - contacts - joints
    system.v[:] += unwhiten(system, y)
    return Impact(contacts, drives, joints, kept)


class _Problem:
    """Units and equations of one impact, in whitened changes of velocity y = L (v+ - v-)."""

    def __init__(
        self,
        system: System,
        closed: list[int],
        ends: list[int],
        restitution: dict[int, float],
        struck: Collection[int] = (),
    ) -> None:
        integers = system.contact_int
        velocity = {c: system.basis[c] @ system.slip[c] for c in closed}
        equations: list[tuple[int, int]] = []
        units: list[np.ndarray] = []
        before, rebound, mu, sliding = [], [], [], []
        # unit -> rows among the equations that carry its normal impulse
        self.loaded: dict[int, list[int]] = {}
        places_of: dict[int, int] = {}
        normals_of: dict[int, list[int]] = {}
        for c in closed:
            rows, limit = contact_rows(integers[c, TANGENTS]), _coefficient(system, c)
            rested = integers[c, MODE] == STICK and c not in struck
            holding = float(system.contact_real[c, MU_STATIC]) if rested else limit
            if integers[c, UNILATERAL]:
                columns, before_c = unit_columns(system, c, rows if limit > 0.0 else (2,)), velocity[c].copy()
                # elliptic cones are round in other coordinates
                shape = stretch(system, c)
                columns[:, :2], before_c[:2] = columns[:, :2] @ shape, shape @ before_c[:2]
                places_of[c] = len(units)
                units.append(columns)
                before.append(before_c * (np.abs(columns).max(axis=0, initial=0.0) > 0.0))
                rebound.append(restitution.get(c, 0.0) * min(velocity[c][2], 0.0))
                mu.append(holding)
                sliding.append(limit)
                continue
            normals = [1, 2] if integers[c, PATTERN] == ON_CURVE else [2]
            tangents = [row for row in rows if row not in normals]
            stuck = normals + (tangents if math.isinf(limit) else [])
            places = normals_of[c] = list(range(len(equations), len(equations) + len(normals)))
            equations += [(c, row) for row in stuck]
            if 0.0 < limit < math.inf:
                self.loaded[len(units)] = places
                columns, before_c = unit_columns(system, c, tangents), velocity[c] * np.isin(range(3), tangents)
                if len(tangents) == 2:
                    shape = stretch(system, c)
                    columns[:, :2], before_c[:2] = columns[:, :2] @ shape, shape @ before_c[:2]
                units.append(columns)
                before.append(before_c)
                rebound.append(0.0)
                mu.append(holding)
                sliding.append(limit)
        # unit of a resistance to turning -> unit that carries its contact's normal impulse
        self.carried: dict[int, int] = {}
        for item in system.resisting():
            c = system.owner(item)
            if c not in closed:
                continue
            if integers[c, UNILATERAL]:
                self.carried[len(units)] = places_of[c]
            else:
                self.loaded[len(units)] = normals_of[c]
            tangents = list(range(integers[item, TANGENTS]))
            units.append(unit_columns(system, item, tangents))
            before.append((system.basis[item] @ system.slip[item]) * np.isin(range(3), tangents))
            rebound.append(0.0)
            mu.append(float(system.contact_real[item, MU]))
            sliding.append(mu[-1])
        self.contacts = len(units)
        for g in ends:
            sign = -float(system.joint_int[g, JOINT_END])
            units.append(unit_columns(system, system.nc + g, (2,), sign))
            before.append(np.array([0.0, 0.0, sign * system.slip[system.nc + g, 2]]))
            rebound.append(0.0)
            mu.append(0.0)
            sliding.append(0.0)
        self.stack = np.hstack(units) if units else np.zeros((system.nv, 0))
        self.before = np.array(before).reshape(-1)
        self.rebound, self.holding, self.sliding = np.array(rebound), np.array(mu), np.array(sliding)
        self.forces = np.zeros(3 * len(units))
        sides = system.side_int[[2 * c + side for c in closed for side in range(2)]]
        self.driven = bool(sides[:, [MOTION_KIND, TIME_DEPENDENT]].any())
        self.equations = np.array([whiten(system, system.rows[c, row]) for c, row in equations]).reshape(-1, system.nv)
        wanted = -np.array([velocity[c][row] for c, row in equations])
        self.start = np.linalg.lstsq(self.equations, wanted, rcond=_REDUNDANT)[0] if equations else np.zeros(system.nv)
        span = np.linalg.svd(self.equations, full_matrices=False) if equations else None
        self.reduced = self.stack
        if span is not None:
            basis = span[2][span[1] > _REDUNDANT * span[1][0]]
            self.reduced = self.stack - basis.T @ (basis @ self.stack)
        self.gram, self.weights = delassus(self.reduced)

    def solve(self, solver: ContactSolver, kept: float) -> np.ndarray | None:
        """y with `kept` of the restitution, or None."""
        b = self.before + self.stack.T @ self.start
        b[2::3] += kept * self.rebound
        b[self.weights > 0.0] = 0.0
        mu, loads = self.holding.copy(), np.zeros(len(self.holding))
        for iteration in range(_LOAD_ITERATIONS):
            for u in (*self.loaded, *self.carried):
                b[3 * u + 2] = -self.weights[3 * u + 2] * loads[u]
            if mu.size:
                if not self._solve_cones(solver, b, mu):
                    return None
                slips = (solver.modes == SLIP) & (mu > self.sliding)
                if slips.any():
                    mu[slips] = self.sliding[slips]
                    continue
                self.forces = np.where(self.weights > 0.0, 0.0, solver.forces)
            y = self.start + self.reduced @ self.forces
            change, size = 0.0, float(np.abs(self.forces).max(initial=0.0))
            found = {u: float(self.forces[3 * carrier + 2]) for u, carrier in self.carried.items()}
            if self.loaded:
                impulses = np.linalg.lstsq(self.equations.T, y - self.stack @ self.forces, rcond=_REDUNDANT)[0]
                found |= {u: float(np.linalg.norm(impulses[places])) for u, places in self.loaded.items()}
            for u, load in found.items():
                change, size = max(change, abs(load - loads[u])), max(size, load)
                loads[u] = load if iteration < _UNDAMPED else 0.5 * (load + loads[u])
            if change <= _LOAD_CHANGE * size:
                return y
        return None

    def _solve_cones(self, solver: ContactSolver, b: np.ndarray, mu: np.ndarray) -> bool:
        ideal = np.isinf(mu)
        return solver.solve(self.gram, b, mu, afresh=True) or (
            bool(ideal.any())
            and any(solver.solve(self.gram, b, np.where(ideal, large, mu), afresh=True) for large in _LARGE_FRICTION)
        )

    def work(self, y: np.ndarray) -> tuple[float, float, float]:
        """Work of the contacts' and of the joints' impulses, and the sum of the sizes of all terms."""
        after = self.before + self.stack.T @ y
        terms = 0.5 * self.forces * (self.before + after)
        split = 3 * self.contacts
        size = 0.5 * np.abs(self.forces) @ (np.abs(self.before) + np.abs(after))
        return float(terms[:split].sum()), float(terms[split:].sum()), float(size)


def _coefficient(system: System, c: int) -> float:
    """Coefficient of friction of contact c at its present speed of slip."""
    numbers = system.contact_real[c]
    if numbers[STRIBECK_SPEED] == 0.0:
        return float(numbers[MU])
    speed = float(np.linalg.norm(system.basis[c, : system.contact_int[c, TANGENTS]] @ system.slip[c]))
    return stribeck(numbers[MU], numbers[MU_FAST], numbers[STRIBECK_SPEED], numbers[STRIBECK_EXPONENT], speed)
