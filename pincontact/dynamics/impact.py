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

from ..friction.cone import SLIP
from ..friction.loads import LARGE_FRICTION, TOLERANCE, Loads
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
from .units import Units, contact_rows, delassus, unwhiten, whiten, whitened_velocity

if TYPE_CHECKING:
    from .system import System

# Equations that combine to less than this, relative to their size, are redundant.
_REDUNDANT = 1e-9
# Coefficients that stand in for infinite ones where redundant contacts' ideal rolling contradicts itself by round-off.
_LARGE_FRICTION = (LARGE_FRICTION, 1e2)


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

        def relative(item: int, rows: list[int]) -> np.ndarray:
            # of joint coordinates the third number is the velocity itself
            on_joint = system.nc <= item < system.nc + system.ng
            return system.slip[item, rows] if on_joint else system.basis[item, rows] @ system.slip[item]

        units = Units(system, relative)
        equations: list[tuple[int, int]] = []
        # unit -> rows among the equations that carry its normal impulse
        self.loaded: dict[int, list[int]] = {}
        # contacts -> their units, or places of their normals among the equations; unit -> coefficient of sliding
        unit_of: dict[int, int] = {}
        normals_of: dict[int, list[int]] = {}
        sliding: dict[int, float] = {}
        for c in closed:
            rows, limit = contact_rows(integers[c, TANGENTS]), _coefficient(system, c)
            rested = integers[c, MODE] == STICK and c not in struck
            holding = float(system.contact_real[c, MU_STATIC]) if rested else limit
            if integers[c, UNILATERAL]:
                unit_of[c] = units.add(c, rows if limit > 0.0 else (2,), holding)
                sliding[unit_of[c]] = limit
                continue
            normals = [1, 2] if integers[c, PATTERN] == ON_CURVE else [2]
            tangents = [row for row in rows if row not in normals]
            normals_of[c] = list(range(len(equations), len(equations) + len(normals)))
            equations += [(c, row) for row in normals + (tangents if math.isinf(limit) else [])]
            if 0.0 < limit < math.inf:
                u = units.add(c, tangents, holding)
                self.loaded[u], sliding[u] = normals_of[c], limit
        # unit of a resistance to turning -> unit that carries its contact's normal impulse
        self.carried: dict[int, int] = {}
        for item in system.resisting():
            c = system.owner(item)
            if c in closed:
                u = units.add(item, range(integers[item, TANGENTS]), float(system.contact_real[item, MU]))
                if integers[c, UNILATERAL]:
                    self.carried[u] = unit_of[c]
                else:
                    self.loaded[u] = normals_of[c]
        self.contacts = len(units.mu)
        for g in ends:
            units.add(system.nc + g, (2,), 0.0, -float(system.joint_int[g, JOINT_END]))
        self.stack, self.before = units.stack, np.array(units.start).reshape(-1)
        self.holding = np.array(units.mu)
        self.rebound, self.sliding = np.zeros(self.holding.size), self.holding.copy()
        for c, u in unit_of.items():
            self.rebound[u] = restitution.get(c, 0.0) * min(self.before[3 * u + 2], 0.0)
        for u, limit in sliding.items():
            self.sliding[u] = limit
        self.forces = np.zeros(self.before.size)
        sides = system.side_int[[2 * c + side for c in closed for side in range(2)]]
        self.driven = bool(sides[:, [MOTION_KIND, TIME_DEPENDENT]].any())
        self.equations = np.array([whiten(system, system.rows[c, row]) for c, row in equations]).reshape(-1, system.nv)
        wanted = -np.array([relative(c, [row])[0] for c, row in equations])
        self.start = np.linalg.lstsq(self.equations, wanted, rcond=_REDUNDANT)[0] if equations else np.zeros(system.nv)
        span = np.linalg.svd(self.equations, full_matrices=False) if equations else None
        self.reduced = self.stack
        if span is not None:
            basis = span[2][span[1] > _REDUNDANT * span[1][0]]
            self.reduced = self.stack - basis.T @ (basis @ self.stack)
        self.gram, self.weights = delassus(self.reduced)
        self.loads = self._with_loads(units) if self.loaded or self.carried else None

    def _with_loads(self, units: Units) -> Loads:
        """The problem with the loads of its units as functions of the impulses, but for b."""
        n, size, normal, tangents = (
            self.holding.size,
            self.before.size,
            np.array(units.normal),
            np.array(units.tangents),
        )
        base, rows = np.zeros((n, 2)), np.zeros((n, 2, size))
        rows[np.arange(n), 0, 3 * np.arange(n) + 2] = normal
        for u, carrier in self.carried.items():
            rows[u, 0, 3 * carrier + 2] = 1.0
        if self.loaded:
            # impulses of equations, of redundant ones the least
            impulses = np.linalg.pinv(self.equations.T, rcond=_REDUNDANT)
            for u, places in self.loaded.items():
                base[u, : len(places)] = impulses[places] @ self.start
                rows[u, : len(places)] = impulses[places] @ (self.reduced - self.stack)
        return Loads(self.gram, self.before, normal, tangents, self.holding, base.ravel(), rows.reshape(2 * n, size))

    def solve(self, solver: ContactSolver, kept: float) -> np.ndarray | None:
        """y with `kept` of the restitution, or None."""
        b = self.before + self.stack.T @ self.start
        b[2::3] += kept * self.rebound
        b[self.weights > 0.0] = 0.0
        mu = self.holding.copy()
        while mu.size:
            if self.loads is None:
                if not self._solve_cones(solver, b, mu):
                    return None
                self.forces, modes = np.where(self.weights > 0.0, 0.0, solver.forces), solver.modes
            else:
                loads, nothing = replace(self.loads, base=b, mu=mu), np.zeros(b.size)
                self.forces, residual = loads.refine(nothing)
                if not residual <= TOLERANCE:
                    self.forces, residual = loads.solve(nothing)
                if not residual <= TOLERANCE:
                    return None
                modes = loads.modes(self.forces)
            slips = (modes == SLIP) & (mu > self.sliding)
            if not slips.any():
                break
            mu[slips] = self.sliding[slips]
        return self.start + self.reduced @ self.forces

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
