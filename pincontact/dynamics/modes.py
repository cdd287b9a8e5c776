"""Who sticks, who slips, who opens: the modes of all contacts at one state (Sec. 5.3).

Where a contact slides, its friction is known. Where it does not, the modes are those of the second-order-cone
complementarity at acceleration level: F in K_mu, u = G F + b, u + mu |u_t| n in the dual cone, complementary.
The cheap guess, everything undecided sticks, is tried first: if all forces lie inside their cones it is the solution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

from ..friction import cone
from ..friction.solve import ContactSolver
from ..layout import (
    ACROSS_X,
    DIRECTION_X,
    EVENT,
    FREE,
    FRICTION_MARGIN,
    FRICTIONLESS,
    FROZEN,
    MODE,
    MU,
    MU_NOW,
    MU_STATIC,
    NO_FORCE,
    NORMAL_MARGIN,
    NORMAL_SIGN,
    PATTERN,
    POLYNOMIAL,
    POLYNOMIAL_SIZE,
    SLIP_RATE,
    SLIP_SIGN,
    SLIPPING,
    SPAN,
    START,
    STICK,
    TANGENTS,
    UNILATERAL,
)
from .stretches import associated, opposed_slip, stretches

if TYPE_CHECKING:
    from .system import System

_FIXED_POINT_ITERATIONS = 60
_FIXED_POINT_TOLERANCE = 1e-12
_ROUND_OFF = 1e-11
# Sliding accelerations below this fraction of the free ones are taken for the limit of stick (a continuous start).
CONTINUOUS_LIMIT = 1e-7


@dataclass
class Decision:
    """Outcome of `decide_modes`.

    status: of the evaluation in the new modes; started: contacts that begin to slip, with the relative acceleration
    in m/s^2 at which they do; opened: contacts that open; residual of the cone problem, 0 where none was solved.
    """

    status: int
    started: dict[int, float] = field(default_factory=dict)
    opened: list[int] = field(default_factory=list)
    residual: float = 0.0
    solved: bool = False


class ModeSolver:
    """Decides modes; keeps the cone solver's buffers and counts what it did."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.solver = ContactSolver()
        self.cone_problems = 0
        self.worst_residual = 0.0
        self._limits = np.zeros(system.nc)

    def decide(self, t: float, undecided: list[int], evaluate, beyond: int | None = None) -> Decision:
        """Set the modes of the undecided contacts (closed, at rest against each other, with friction) at the state.

        All contacts stay as they are otherwise, except that a unilateral one whose normal force would pull opens.
        evaluate(t): evaluates the system at its (q, v). beyond: a contact whose static limit has been reached.
        """
        system = self.system
        integers = system.contact_int
        before = {c: int(integers[c, MODE]) for c in system.closed()}
        for c in undecided:
            integers[c, MODE] = STICK
            integers[c, FROZEN] = 0
        status = evaluate(t)
        if status > EVENT and status != NO_FORCE:
            return Decision(status)
        if status != NO_FORCE and beyond is None and self._holds(before):
            return Decision(status)
        # contacts beyond their static limit are held by sliding friction at most, the others by static friction
        self._limits = system.contact_real[: system.nc, MU_STATIC].copy()
        exceeded = system.margins[: system.nc, FRICTION_MARGIN] < 0.0
        if beyond is not None:
            exceeded[beyond] = True
        self._limits[exceeded] = system.contact_real[: system.nc, MU][exceeded]
        decision = self._solve(t, undecided, evaluate)
        decision.started = {c: a for c, a in decision.started.items() if integers[c, MODE] == SLIPPING}
        return decision

    def force_round_off(self) -> float:
        """Forces in N (or N m) below which a sign means nothing, from the loads on the joints."""
        system = self.system
        loads = np.abs(system.data.nle) + np.abs(system.tau)
        return _ROUND_OFF * float(loads.max(initial=0.0))

    def _holds(self, closed: dict[int, int]) -> bool:
        """Whether every force of the last evaluation lies inside its cone."""
        margins = self.system.margins
        return all(margins[c, NORMAL_MARGIN] >= 0.0 and margins[c, FRICTION_MARGIN] >= 0.0 for c in closed)

    def _solve(self, t: float, undecided: list[int], evaluate) -> Decision:
        """The cone problem over all closed contacts; sliding ones and drives enter as known forces."""
        system = self.system
        integers, numbers = system.contact_int, system.contact_real
        closed = system.closed()
        bilateral = [c for c in closed if not integers[c, UNILATERAL]]
        if bilateral:
            return self._decide_bilateral(t, undecided, closed, evaluate)
        decision = Decision(0, solved=True)
        n = len(closed)
        whitened = {c: solve_triangular(system.factor, system.rows[c].T, lower=True) for c in closed}
        stack = np.hstack([whitened[c] for c in closed])
        # planar contacts have no second tangent: an isolated row of unit mass and no load
        missing = [3 * i + 1 for i, c in enumerate(closed) if integers[c, TANGENTS] == 1]
        stack[:, missing] = 0.0
        gram = stack.T @ stack
        gram[missing, missing] = 1.0
        base = np.concatenate([system.rows[c] @ system.free_acceleration + system.bias[c] for c in closed])
        base[missing] = 0.0
        mu = np.array([self._limits[c] if c in undecided or math.isinf(numbers[c, MU]) else 0.0 for c in closed])
        # elliptic cones are round in other coordinates
        scaling = stretches(system, closed)
        round_gram = gram if scaling is None else scaling @ gram @ scaling
        sliding = [i for i, c in enumerate(closed) if integers[c, MODE] == SLIPPING and numbers[c, MU] > 0.0]
        directions = np.zeros(3 * n)
        for i in sliding:
            directions[3 * i : 3 * i + 2] = associated(system, closed[i], _direction(system, closed[i]))
        loads = np.array([max(system.force[c, 2], 0.0) for c in closed])
        for _ in range(_FIXED_POINT_ITERATIONS if sliding else 1):
            b = base.copy()
            for i in sliding:
                pull = np.zeros(3 * n)
                pull[3 * i : 3 * i + 2] = -numbers[closed[i], MU_NOW] * loads[i] * directions[3 * i : 3 * i + 2]
                b += gram @ pull
            self.cone_problems += 1
            if not self.solver.solve(round_gram, b if scaling is None else scaling @ b, mu):
                decision.status = NO_FORCE
                return decision
            new_loads = self.solver.forces[2::3].copy()
            change = np.abs(new_loads - loads)[sliding].max(initial=0.0) if sliding else 0.0
            loads = new_loads
            if change <= _FIXED_POINT_TOLERANCE * (1.0 + np.abs(loads).max()):
                break
        else:
            decision.status = NO_FORCE
            return decision
        decision.residual = float(self.solver.residual)
        self.worst_residual = max(self.worst_residual, decision.residual)
        velocities, forces = self.solver.velocities, self.solver.forces
        if scaling is not None:
            velocities, forces = np.linalg.solve(scaling, velocities), scaling @ forces
        velocities, forces = velocities.reshape(n, 3), forces.reshape(n, 3)
        for i, c in enumerate(closed):
            mode = self.solver.modes[i]
            if mode == cone.OPEN:
                integers[c, MODE] = FREE
                decision.opened.append(c)
            elif c in undecided:
                if mode == cone.STICK:
                    integers[c, MODE] = STICK
                else:
                    rate = float(np.hypot(velocities[i, 0], velocities[i, 1]))
                    # a vanishing rate leaves the force to tell the direction
                    direction = velocities[i, :2] if rate > 0.0 else opposed_slip(system, c, forces[i, :2])
                    freeze_slip(system, c, direction)
                    decision.started[c] = rate
        decision.status = evaluate(t)
        return decision

    def _decide_bilateral(self, t: float, undecided: list[int], closed: list[int], evaluate) -> Decision:
        """Contacts that cannot open carry |F_n| of either sign, which is no cone: slide the one that exceeds its limit
        most against its stick force, and look again. Serves one-tangent and few two-tangent contacts."""
        system = self.system
        integers = system.contact_int
        decision = Decision(0)
        for _ in range(2 * len(closed) + 2):
            status = evaluate(t)
            decision.status = status
            if status > EVENT:
                return decision
            worst, excess = -1, 0.0
            for c in closed:
                if integers[c, MODE] == FREE:
                    continue
                if system.margins[c, NORMAL_MARGIN] < -self.force_round_off():
                    if integers[c, UNILATERAL]:
                        integers[c, MODE] = FREE
                        decision.opened.append(c)
                    else:
                        integers[c, NORMAL_SIGN] *= -1
                    worst = -2
                    break
                if integers[c, MODE] == STICK and system.margins[c, FRICTION_MARGIN] < excess:
                    worst, excess = c, system.margins[c, FRICTION_MARGIN]
            if worst == -1:
                return decision
            if worst >= 0:
                force = system.force[worst]
                if integers[worst, PATTERN] != 3:
                    integers[worst, NORMAL_SIGN] = 1 if force[2] >= 0.0 else -1
                freeze_slip(system, worst, opposed_slip(system, worst, force[:2]))
                if evaluate(t) > EVENT:
                    decision.status = NO_FORCE
                    return decision
                decision.started[worst] = float(system.contact_real[worst, SLIP_RATE])
        decision.status = NO_FORCE
        return decision


def _direction(system: System, c: int) -> np.ndarray:
    """Slip direction of a sliding contact along (t1, second)."""
    if system.contact_int[c, TANGENTS] == 1:
        return np.array([float(system.contact_int[c, SLIP_SIGN]), 0.0])
    along = system.basis[c, :2] @ system.slip[c]
    speed = float(np.hypot(along[0], along[1]))
    if system.contact_int[c, FROZEN] or speed == 0.0:
        world = system.contact_real[c, DIRECTION_X : DIRECTION_X + 3]
        along = system.basis[c, :2] @ world
        speed = float(np.hypot(along[0], along[1]))
    return along / speed if speed > 0.0 else np.zeros(2)


def freeze_slip(system: System, c: int, direction: np.ndarray) -> None:
    """Let contact c slip in a given direction (components along t1, second) whatever its present v_c."""
    integers, numbers = system.contact_int[c], system.contact_real[c]
    integers[MODE] = SLIPPING
    if integers[TANGENTS] == 1:
        integers[SLIP_SIGN] = 1 if direction[0] >= 0.0 else -1
        integers[FROZEN] = 0
        return
    size = float(np.hypot(direction[0], direction[1]))
    unit = direction[:2] / size if size > 0.0 else np.array([1.0, 0.0])
    world = unit @ system.basis[c, :2]
    numbers[DIRECTION_X : DIRECTION_X + 3] = world
    numbers[ACROSS_X : ACROSS_X + 3] = np.cross(system.basis[c, 2], world)
    numbers[POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE] = 0.0
    numbers[START], numbers[SPAN] = 0.0, 1.0
    integers[FROZEN] = 1


def rest_mode(mu: float) -> int:
    """The mode of a closed contact that does not slide."""
    return FRICTIONLESS if mu == 0.0 else STICK
