"""Who sticks, who slips, who opens: the modes of all contacts at one state (Sec. 5.3).

Where a contact slides, its friction is known. Where it does not, the modes are those of the second-order-cone
complementarity at acceleration level. They are resolved in this order:

1. What cannot stick slides on (`passing_slip`).
2. Everything undecided sticks: if all forces lie inside their cones (of redundant ones, those of one choice:
   `redistribution`), that is the solution.
3. The cone problem (`mode_problem`), with the friction of what slides in proportion to the loads (`mode_loads`). Slip
   that begins is turned to where it goes under the loads of the evaluation.
4. Where laws are no cones (bilateral contacts, viscous friction that ends as contacts open), one change of mode after
   the other (`mode_changes`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..friction import cone
from ..layout import (
    EVENT,
    FREE,
    FRICTION_EVENT,
    FROZEN,
    JOINT_END,
    MODE,
    MU,
    MU_STATIC,
    NO_FORCE,
    NORMAL_SIGN,
    OK,
    SLIP_RATE,
    SLIPPING,
    STICK,
    UNILATERAL,
)
from .contact_modes import Decision, drags, held_up_by_friction, rest_mode, shares_viscous_force
from .directions import align_slips, freeze_slip
from .mode_changes import ModeChanges
from .mode_loads import LoadedCones
from .mode_problem import mode_problem
from .passing_slip import PassingSlip

if TYPE_CHECKING:
    from .system import System


__all__ = ["Decision", "ModeSolver", "rest_mode", "shares_viscous_force"]

# Relative accelerations below this fraction of the free ones are round-off: no slip; or below so many residuals.
_STILL, _KNOWN = 1e-13, 10.0
# So often the directions of slip that begins, and what of redundant loads is carried where, are brought together.
_ROUNDS = 4


class ModeSolver(ModeChanges, PassingSlip, LoadedCones):
    """Resolves the modes of all contacts at a state; keeps the cone solver's buffers and counts what it did.

    contact_solver: see `ContactSolver`. worst_residual: the largest of the cone problems'.
    """

    def __init__(self, system: System, contact_solver: str = "auto") -> None:
        ModeChanges.__init__(self, system)
        LoadedCones.__init__(self, system, contact_solver)
        self.worst_residual = 0.0

    def resolve_modes(
        self, t: float, undecided: list[int], evaluate, beyond: int | None = None, status: int | None = None
    ) -> Decision:
        """Set the modes of the undecided contacts (closed, at rest against each other, with friction) at the state.

        All contacts stay as they are otherwise, except that a unilateral one whose normal force would pull opens. Held
        joint coordinates are undecided, too. Redundant forces are chosen anew.
        evaluate(t): evaluates the system at its (q, v). beyond: a contact whose static limit has been reached.
        status: that of the last evaluation, if it was one at the state with all undecided ones sticking.
        """
        system = self.system
        integers = system.contact_int
        self.proved = False
        loaded = self._load_all()
        for c in undecided:
            integers[c, MODE] = STICK
            integers[c, FROZEN] = 0
        if status is None or not loaded or system.scalars["has_reference"] != 0.0:
            self._take_reference(None)
            status = evaluate(t)
        if status > EVENT and status != NO_FORCE:
            return Decision(status)
        passing = self._let_pass(t, undecided, evaluate)
        if passing:
            undecided = [c for c in undecided if c not in passing]
            status = evaluate(t)
            if status > EVENT and status != NO_FORCE:
                return Decision(status)
        positive = system.counters["lost_positivity"] == 0
        if (
            beyond is None
            and positive
            and (status == OK or (status == EVENT and (self._holds() or self.redistribute(t, evaluate))))
        ):
            # without an event every force lies inside its cone
            return Decision(status, passing)
        if beyond is None and positive:
            status = self._let_joints_go(t, evaluate)
            if status <= EVENT:
                return Decision(status, passing)
        # contacts beyond their static limit are held by sliding friction at most, the others by static friction
        self._limits = system.contact_real[:, MU_STATIC].copy()
        exceeded = system.event_functions[:, FRICTION_EVENT] < 0.0
        if beyond is not None:
            exceeded[beyond] = True
        self._limits[exceeded] = system.contact_real[exceeded, MU]
        decision = self._solve(t, undecided, evaluate)
        decision.started.update(passing)
        decision.started = {c: a for c, a in decision.started.items() if integers[c, MODE] == SLIPPING}
        return decision

    def _let_joints_go(self, t: float, evaluate) -> int:
        """Let held joint coordinates go, one after the other, whose forces exceed their bounds; the status, if no
        contact has to change then. Otherwise modes are what they were, and evaluated.

        Of redundant contacts a cone problem may let one slip with a joint, though others would hold.
        """
        system = self.system
        modes, limits = system.contact_int.copy(), system.joint_int.copy()
        released: dict[int, tuple[int, int]] = {}
        status = NO_FORCE
        for _ in range(2 * len(system.held())):
            if not (self._hold_one(released) or self._release_one(released)):
                if status == OK or (status == EVENT and self._holds()):
                    return status
                break
            status = evaluate(t)
            if status > EVENT:
                break
        if released:
            system.contact_int[:], system.joint_int[:] = modes, limits
            evaluate(t)
        return NO_FORCE

    def _solve(self, t: float, undecided: list[int], evaluate) -> Decision:
        """The cone problem over all closed contacts, held coordinates and resistances to turning; what slides enters
        as known forces, resistances at rest as disks whose radius follows from the load."""
        system = self.system
        integers = system.contact_int
        closed, held, resisting = system.closed(), system.held(), system.resisting()
        if any(not integers[c, UNILATERAL] or held_up_by_friction(system, c) for c in closed):
            return self._decide_without_cones(t, undecided, closed, evaluate)
        dragging = [c for c in closed if drags(system, c)]
        modes, limits = integers.copy(), system.joint_int.copy()
        decision = self._solve_cones(t, undecided, closed, held, resisting, evaluate)
        if dragging and not self._stay_open(t, [c for c in dragging if c in decision.opened], decision, evaluate):
            # viscous friction ends where contacts open, which no cone knows
            integers[:], system.joint_int[:] = modes, limits
            return self._decide_without_cones(t, undecided, closed, evaluate)
        if not self._align(t, decision, evaluate):
            # redundant loads are others in slip: decide with those, or not at all
            integers[:], system.joint_int[:] = modes, limits
            return self._decide_without_cones(t, undecided, closed, evaluate)
        return decision

    def _stay_open(self, t: float, opened: list[int], decision: Decision, evaluate) -> bool:
        """Whether the last evaluation, in the modes of this decision, leaves contacts open that it has opened."""
        if decision.status > EVENT:
            return False
        stay = all(self.gap_acceleration(t, c) >= 0.0 for c in opened)
        if opened:
            evaluate(t)
        return stay

    def _solve_cones(
        self, t: float, undecided: list[int], closed: list[int], held: list[int], resisting: list[int], evaluate
    ) -> Decision:
        """`_solve` where nothing else decides than cones."""
        system = self.system
        integers, numbers = system.contact_int, system.contact_real
        decision = Decision(OK, solved=True)
        n = len(closed)
        while True:
            problem = mode_problem(system, self._limits, closed, undecided, held, resisting)
            solution = self._solve_with_loads(problem, closed, held, resisting)
            if solution is None:
                decision.status = NO_FORCE
                return decision
            # what gives way has sliding friction from then on, which may change all the rest
            begun = [c for i, c in enumerate(closed) if c in undecided and solution.modes[i] == cone.SLIP]
            begun = [c for c in begun if self._limits[c] > numbers[c, MU]]
            if not begun:
                break
            self._limits[begun] = numbers[begun, MU]
        base, shapes, turns = problem.base, problem.shapes, problem.turns
        decision.residual = solution.residual
        self.worst_residual = max(self.worst_residual, decision.residual)
        velocities, forces, modes = solution.velocities, solution.forces, solution.modes
        for i, shape in shapes.items():
            velocities[i, :2], forces[i, :2] = np.linalg.solve(shape, velocities[i, :2]), shape @ forces[i, :2]
        # as far as they are known
        still = max(_STILL, _KNOWN * solution.residual) * max(map(abs, base.tolist()))
        for i, c in enumerate(closed):
            mode = modes[i]
            # among redundant contacts one may carry nothing without leaving
            if mode == cone.OPEN and velocities[i, 2] > still:
                integers[c, MODE] = FREE
                decision.opened.append(c)
                continue
            if mode == cone.OPEN and integers[c, MODE] == SLIPPING:
                integers[c, NORMAL_SIGN] = 0
            if c in undecided or (mode == cone.SLIP and math.isinf(numbers[c, MU])):
                rate = float(np.hypot(velocities[i, 0], velocities[i, 1]))
                if mode == cone.STICK or rate <= still:
                    # among redundant contacts one may be at its limit of friction without sliding
                    integers[c, MODE] = STICK
                else:
                    freeze_slip(system, c, velocities[i, :2])
                    decision.started[c] = rate
        for i, u in turns.items():
            rate = float(np.hypot(velocities[u, 0], velocities[u, 1]))
            if i in undecided and modes[u] != cone.STICK and rate > still:
                freeze_slip(system, i, velocities[u, :2])
                decision.started[i] = rate
        for i, g in enumerate(held, start=n):
            mode, end = modes[i], int(system.joint_int[g, JOINT_END])
            if end == 0 and mode == cone.SLIP and abs(velocities[i, 0]) > still:
                self.release(g, 1 if velocities[i, 0] > 0.0 else -1)
            elif end != 0 and mode == cone.OPEN and velocities[i, 2] > still:
                self.release(g, -end)
        decision.status = evaluate(t)
        if decision.status <= EVENT and not self._holds() and not self.redistribute(t, evaluate):
            self._keep_solution(t, closed, held, turns, forces, evaluate)
        return decision

    def _align(self, t: float, decision: Decision, evaluate) -> bool:
        """Turn slip that begins to where it goes under the loads of the last evaluation, and evaluate in it; False
        where under these loads it does not begin in these modes."""
        started = [c for c in decision.started if self.system.contact_int[c, MODE] == SLIPPING]
        if decision.status > EVENT or not started:
            return True
        aligned = False
        for _ in range(_ROUNDS):
            # loads that are chosen anew turn it
            aligned = align_slips(self.system, t, started, evaluate)
            if not aligned or self._holds() or not self.redistribute(t, evaluate):
                break
        decision.started.update((c, float(self.system.contact_real[c, SLIP_RATE])) for c in started)
        return aligned

    def _keep_solution(
        self, t: float, closed: list[int], held: list[int], turns: dict[int, int], forces: np.ndarray, evaluate
    ) -> None:
        """Take the cone solver's forces, on the rim of their cones, for the choice among redundant ones."""
        system = self.system
        reference = np.zeros_like(system.reference)
        for i, c in enumerate(closed):
            reference[c] = forces[i]
        for item, u in turns.items():
            if system.contact_int[item, MODE] == STICK:
                reference[item, :2] = forces[u, :2]
        for i, g in enumerate(held, start=len(closed)):
            end, (low, high) = system.joint_int[g, JOINT_END], system.joint_real[g, :2]
            extra = forces[i, 0] if end == 0 else -end * forces[i, 2]
            reference[system.nc + g, 2] = extra + (0.5 * (low + high) if end == 0 else (low if end < 0 else high))
        self._take_reference(reference)
        evaluate(t)
