"""Who sticks, who slips, who opens: the modes of all contacts at one state (Sec. 5.3).

Where a contact slides, its friction is known. Where it does not, the modes are those of the second-order-cone
complementarity at acceleration level. They are resolved in this order:

1. What cannot stick slides on (`passing_slip`).
2. Everything undecided sticks: if all forces lie inside their cones (of redundant ones, those of one choice:
   `redistribution`), that is the solution.
3. The contact problem (`mode_loads`), with the friction of what slides in proportion to the loads: a cone problem, or
   one of loads and discs, where contacts are bilateral, slide, resist turning or are held up by friction. Slip that
   begins is turned to where it goes under the loads of the evaluation.
4. Viscous friction that ends as contacts open is no cone: what opens against it is held up by a part of it, if it would
   close without it, and the contact problem is solved again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..friction import cone
from ..layout import (
    EVENT,
    FREE,
    FRICTION_EVENT,
    FRICTIONLESS,
    FROZEN,
    JOINT_END,
    MODE,
    MU,
    MU_STATIC,
    NO_FORCE,
    NORMAL_EVENT,
    NORMAL_SIGN,
    OK,
    SLIP_RATE,
    SLIPPING,
    STICK,
    TANGENTS,
    UNILATERAL,
)
from .contact_modes import (
    Decision,
    drags,
    held_up_by_friction,
    ideal_slip,
    rest_mode,
    set_normal,
    shares_viscous_force,
)
from .directions import align_slips, freeze_slip
from .event_functions import IDEAL_FRICTION
from .mode_loads import AT_REST, LoadedCones
from .passing_slip import PassingSlip
from .redistribution import AT_ZERO
from .single_mode_changes import ROUND_OFF, SingleModeChanges
from .units import relative_velocity, whiten

if TYPE_CHECKING:
    from .system import System


__all__ = ["Decision", "ModeSolver", "rest_mode", "shares_viscous_force"]

# Relative accelerations below this fraction of the free ones are round-off: no slip; or below so many residuals.
_STILL, _KNOWN = 1e-13, 10.0
# Slip that is this part of what slip to come is in a short time has its direction by both, not by the latter alone.
_SHOWS = 1e-3
# What is left of slips may take so many times as long as friction takes to end it.
_TO_STOP = 2.0
# Forces that are outside their bounds by this part of the largest one are none.
_CLEARLY = 1e-3
# So often the directions of slip that begins, and what of redundant loads is carried where, are brought together.
_ROUNDS = 4


class ModeSolver(SingleModeChanges, PassingSlip, LoadedCones):
    """Resolves the modes of all contacts at a state; keeps the cone solver's buffers and counts what it did.

    contact_solver: see `ContactSolver`. worst_residual: the largest of the cone problems'.
    """

    def __init__(self, system: System, contact_solver: str = "auto") -> None:
        SingleModeChanges.__init__(self, system)
        LoadedCones.__init__(self, system, contact_solver)
        self.worst_residual = 0.0

    def resolve_modes(
        self,
        t: float,
        undecided: list[int],
        evaluate: Callable[[float], int],
        beyond: int | None = None,
        status: int | None = None,
        ahead: Mapping[int, float] = AT_REST,
    ) -> Decision:
        """Set the modes of the undecided contacts (closed, at rest against each other, with friction) at the state.

        All contacts stay as they are otherwise, except that a unilateral one whose normal force would pull opens. Held
        joint coordinates are undecided, too. Redundant forces are chosen anew.
        evaluate(t): evaluates the system at its (q, v). beyond: a contact whose static limit has been reached.
        status: that of the last evaluation, if it was one at the state with all undecided ones sticking. ahead: see
        `_pose`.
        """
        system = self.system
        decision = self._decide(t, undecided, evaluate, beyond, status, ahead)
        if decision.status > EVENT or not self._rolling_unloaded():
            return decision
        found, forces = self._modes(), self.reference()
        lost = self.lose_friction(t, evaluate)
        if lost:
            left = [c for c in undecided if c not in lost and system.contact_int[c, MODE] == STICK]
            other = self._decide(t, left, evaluate, None if beyond in lost else beyond, None, ahead)
            if other.status <= EVENT and not self.pressed(lost):
                other.started = decision.started | other.started
                return other
            self._put(*found)
            self.take_back(forces)
            evaluate(t)
        return decision

    def lose_friction(self, t: float, evaluate: Callable[[float], int]) -> list[int]:
        """Let ideal rolling that has a tangential force, but no load in the last evaluation go on without friction,
        which no finite coefficient has there: where it then begins to slip, and takes no load, either."""
        unloaded = self._rolling_unloaded()
        if not unloaded:
            return []
        given = self._modes()
        while unloaded:
            self.system.contact_int[unloaded, MODE] = FRICTIONLESS
            found = evaluate(t) <= EVENT
            functions = self.system.event_functions
            left = [c for c in unloaded if found and min(functions[c, [NORMAL_EVENT, FRICTION_EVENT]]) >= 0.0]
            if left == unloaded and any(map(self._starts, unloaded)):
                return unloaded
            # it opens, or friction is what keeps its load away, or others take its force
            self._put(*given)
            evaluate(t)
            unloaded = left if left != unloaded else []
        return []

    def _modes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of all items, see `_put`."""
        system = self.system
        return system.contact_int.copy(), system.joint_int.copy(), system.contact_real.copy()

    def _put(self, integers: np.ndarray, limits: np.ndarray, numbers: np.ndarray) -> None:
        """Give all items these modes."""
        self.system.contact_int[:], self.system.joint_int[:], self.system.contact_real[:] = integers, limits, numbers

    def _rolling_unloaded(self) -> list[int]:
        """Ideal rolling that has a tangential force and next to no load in the last evaluation."""
        system, found = self.system, []
        integers, functions = system.contact_int, system.event_functions
        for c in system.closed():
            if math.isinf(system.contact_real.item(c, MU_STATIC)) and integers[c, MODE] == STICK:
                first, second, load = system.force[c].tolist()
                # times at which loads vanish are known to a part of this
                least = math.hypot(first, second) / IDEAL_FRICTION
                if integers[c, UNILATERAL] and abs(load) < 2.0 * least and functions[c, NORMAL_EVENT] < 0.5 * least:
                    found.append(c)
        return found

    def _starts(self, c: int) -> bool:
        """Whether contact c begins to slip in the last evaluation."""
        system, rows = self.system, [*range(int(self.system.contact_int[c, TANGENTS]))]
        rates = system.rows[c, rows] @ system.acceleration + system.bias[c, rows]
        return float(np.abs(rates).max()) > ROUND_OFF * float(np.abs(system.free_acceleration).max(initial=0.0))

    def _decide(
        self,
        t: float,
        undecided: list[int],
        evaluate: Callable[[float], int],
        beyond: int | None = None,
        status: int | None = None,
        ahead: Mapping[int, float] = AT_REST,
    ) -> Decision:
        """`resolve_modes`, but that ideal rolling may have a force without a load."""
        system = self.system
        integers = system.contact_int
        self.proved = False
        loaded = self._load_all()
        for c in undecided:
            integers[c, MODE] = STICK
            integers[c, FROZEN] = 0
        if status is None or not loaded or system.scalars.has_reference != 0.0:
            self._take_reference(None)
            status = evaluate(t)
        if status > EVENT and status != NO_FORCE:
            return Decision(status)
        lost = self.lose_friction(t, evaluate) if status == EVENT else []
        if lost:
            undecided, beyond = [c for c in undecided if c not in lost], None if beyond in lost else beyond
            status = evaluate(t)
        # forces that leave constraints unmet are none
        in_vain = self._held_in_vain()
        passing = {} if in_vain else self._let_pass(t, undecided, evaluate)
        if passing:
            undecided = [c for c in undecided if c not in passing]
            status = evaluate(t)
            if status > EVENT and status != NO_FORCE:
                return Decision(status)
        may_hold = beyond is None and system.counters.lost_positivity == 0 and not in_vain
        if may_hold and self._lie_in_cones(status, t, evaluate):
            return Decision(status, passing)
        if may_hold:
            status = self._let_joints_go(t, evaluate)
            if status <= EVENT:
                return Decision(status, passing)
        # contacts beyond their static limit are held by sliding friction at most, the others by static friction
        self._limits = system.contact_real[:, MU_STATIC].copy()
        exceeded = system.event_functions[:, FRICTION_EVENT] < 0.0
        if beyond is not None:
            exceeded[beyond] = True
        self._limits[exceeded] = system.contact_real[exceeded, MU]
        modes, limits = integers.copy(), system.joint_int.copy()
        longest = _TO_STOP * max(map(self._time_to_stop, set(ahead).intersection(undecided)), default=0.0)
        ahead = {i: max(time, longest) for i, time in ahead.items()}
        decision = self._solve(t, evaluate, passing, ahead)
        if ahead and self._is_contradicted(decision):
            # what is left of slips, which are known no better, decides nothing then
            integers[:], system.joint_int[:] = modes, limits
            evaluate(t)
            decision = self._solve(t, evaluate, passing)
        if passing and decision.status > EVENT:
            # friction may turn round what holds beside others what no rolling motion allows: wheels on one axle
            integers[:], system.joint_int[:] = modes, limits
            integers[list(passing), MODE], integers[list(passing), FROZEN] = STICK, 0
            evaluate(t)
            decision = self._solve(t, evaluate, {}, ahead)
        decision.started = {c: a for c, a in decision.started.items() if integers[c, MODE] == SLIPPING}
        return decision

    def _time_to_stop(self, i: int) -> float:
        """Time in s in which the friction of the last evaluation's load ends what is left of the slip of contact i, by
        itself; 0 where it has no load."""
        system = self.system
        speed, load = self._slip_speed(i), float(system.force[system.owner(i), 2])
        rows = [whiten(system, system.rows[i, row]) for row in range(int(system.contact_int[i, TANGENTS]))]
        rate = self._limits[i] * load * min((float(row @ row) for row in rows), default=0.0)
        return speed / rate if load > 0.0 and rate > 0.0 else 0.0

    def _is_contradicted(self, decision: Decision) -> bool:
        """Whether there are no forces in decided modes, or some that are clearly outside their bounds."""
        system = self.system
        if decision.status > EVENT:
            return True
        least = -_CLEARLY * float(np.abs(system.force).max(initial=0.0))
        items = [*system.closed(), *system.resisting()]
        return bool((system.event_functions[items][:, [NORMAL_EVENT, FRICTION_EVENT]] < least).any())

    def _let_joints_go(self, t: float, evaluate: Callable[[float], int]) -> int:
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
                # what is let go and goes nowhere is held: its friction is not all that it can be for good
                if self._all_go(released) and self._lie_in_cones(status, t, evaluate):
                    return status
                break
            status = evaluate(t)
            if status > EVENT:
                break
        if released:
            system.contact_int[:], system.joint_int[:] = modes, limits
            evaluate(t)
        return NO_FORCE

    def _solve(
        self,
        t: float,
        evaluate: Callable[[float], int],
        passing: dict[int, float],
        ahead: Mapping[int, float] = AT_REST,
    ) -> Decision:
        """The contact problem, once more with a part of the viscous friction of what it opens against that friction.
        Where parts of several are too many, as at one edge of a body, one of them may keep the others open. Where that
        does not do, either, all opens, and touches again."""
        system = self.system
        integers = system.contact_int
        start, limits = integers.copy(), system.joint_int.copy()
        modes, seen, shares = start, set[bytes](), True
        # what closes again, the fastest first; all but that, which a part of its friction may keep open, too
        parted: list[int] = []
        apart: list[int] = []
        while True:
            dragging = [c for c in system.closed() if drags(system, c)]
            sharing = [c for c in dragging if shares_viscous_force(system, c)]
            still_apart = [c for c in apart if integers[c, MODE] == FREE]
            decision = self._solve_contacts(t, evaluate, ahead)
            decision.opened += still_apart
            dragging += still_apart
            closing, full = self._contradicted(t, dragging, sharing, decision, evaluate) if shares else ([], [])
            parted = parted or closing
            if not closing and not full and (decision.status <= EVENT or not (seen or apart)):
                break
            seen.add(modes.tobytes())
            integers[:], system.joint_int[:] = modes, limits
            for c in full:
                self.load(c)
            for c in closing:
                self._hold_by_share(c)
            if decision.status > EVENT or integers.tobytes() in seen:
                apart = parted[1:] if not apart else []
                integers[:], shares = start, bool(apart)
                for c in apart:
                    integers[c, MODE] = FREE
                if apart:
                    self._hold_by_share(parted[0])
                seen.clear()
            modes = integers.copy()
            evaluate(t)
        # what begins beside it turns slip that goes on from rest, too
        decision.started = passing | decision.started
        begun = integers.copy(), system.contact_real.copy(), decision.started
        if not self._align(t, decision, evaluate) and not self._align_with_solution(t, decision, evaluate, begun):
            decision.status = NO_FORCE
        return decision

    def _contradicted(
        self, t: float, dragging: list[int], sharing: list[int], decision: Decision, evaluate
    ) -> tuple[list[int], list[int]]:
        """Of contacts with viscous friction, and those that a part of it holds up: what would close again once its
        friction has ended, and what needs more than all of it."""
        if decision.status > EVENT:
            return [], []
        full = [c for c in sharing if c not in decision.opened and self._takes_all(c)]
        closing = [c for c in dragging if c in decision.opened and c not in sharing]
        if closing:
            rates = {c: self.gap_acceleration(t, c) for c in closing}
            least = -ROUND_OFF * float(np.abs(self.system.free_acceleration).max(initial=0.0))
            closing = sorted((c for c in closing if rates[c] < least), key=lambda c: rates[c])
            # with forces, since gaps are looked at without
            evaluate(t)
        return closing, full

    def let_slide(self, t: float, evaluate: Callable[[float], int], ahead: float) -> Decision:
        """Let slide, of what sticks or is held, what friction cannot stop within `ahead` s, from the last evaluation.

        Rows that have depended on each other may become independent, and the velocity does not meet them: by slip much
        slower than it is known, which to end would take any part of the velocity, and so forces without bound. Friction
        has bounds: that slip goes on, against all of it, as with compliances, however stiff. So do loads, which only
        push: what they cannot keep closed opens.
        """
        self._take_reference(None)
        self._limits = self.system.contact_real[:, MU_STATIC].copy()
        return self._solve_contacts(t, evaluate, dict.fromkeys(range(self.system.items), ahead), True)

    def _solve_contacts(
        self, t: float, evaluate: Callable[[float], int], ahead: Mapping[int, float] = AT_REST, normals: bool = False
    ) -> Decision:
        """The modes of the contact problem's solution: of all closed contacts, held coordinates and resistances; ahead,
        normals: see `_pose`."""
        system = self.system
        integers, numbers = system.contact_int, system.contact_real
        closed, held = system.closed(), system.held()
        items = [*closed, *system.resisting()]
        decision = Decision(OK)
        while True:
            solution = self._solve_posed(self._pose(closed, held, ahead, normals), held)
            if solution is None:
                decision.status = NO_FORCE
                return decision
            # what gives way has sliding friction from then on, which may change all the rest
            begun = [i for i in items if integers[i, MODE] == STICK and solution.modes[i] == cone.SLIP]
            begun = [i for i in begun if self._limits[i] > numbers[i, MU]]
            if not begun:
                break
            self._limits[begun] = numbers[begun, MU]
        decision.residual, decision.forces = solution.residual, solution.forces
        self.worst_residual = max(self.worst_residual, decision.residual)
        velocities, kinds = solution.velocities, solution.modes
        # as far as they are known; what carries nothing is at the edge of slip, as far as its load is known
        still = max(_STILL, _KNOWN * solution.residual) * solution.largest
        loads = np.abs(solution.forces[[system.owner(i) for i in items], 2])
        idle = AT_ZERO * float(np.abs(solution.forces[closed, 2]).max(initial=0.0))
        for c in closed:
            # among redundant contacts one may carry nothing without leaving
            if kinds[c] == cone.OPEN and integers[c, UNILATERAL]:
                if velocities[c, 2] > still:
                    integers[c, MODE], integers[c, NORMAL_SIGN] = FREE, 1
                    decision.opened.append(c)
                elif ideal_slip(system, c):
                    # there is nothing that friction would have to hold up
                    integers[c, MODE] = FRICTIONLESS
                elif integers[c, MODE] == SLIPPING and not shares_viscous_force(system, c):
                    integers[c, NORMAL_SIGN] = 0
            elif not integers[c, UNILATERAL]:
                set_normal(system, c, solution.forces[c], self.force_round_off())
        for i, load in zip(items, loads.tolist()):
            rate = float(np.hypot(velocities[i, 0], velocities[i, 1]))
            slowest = still if load > idle else AT_ZERO * solution.largest
            # among redundant contacts one may be at its limit of friction without sliding
            if integers[i, MODE] == STICK and kinds[i] != cone.STICK and rate > slowest:
                goes_on = i in ahead and self._slip_speed(i) > _SHOWS * ahead[i] * rate
                freeze_slip(system, i, velocities[i, :2])
                if not goes_on:
                    decision.started[i] = rate
        for g in held:
            item, end = system.nc + g, int(system.joint_int[g, JOINT_END])
            rate = velocities[item, 2]
            if end == 0 and kinds[item] == cone.SLIP and abs(rate) > still:
                self.release(g, 1 if rate > 0.0 else -1)
            elif end != 0 and kinds[item] == cone.OPEN and -end * rate > still:
                self.release(g, -end)
        decision.status = evaluate(t)
        if decision.status > EVENT or self._holds():
            return decision
        # with other loads, what begins to slip might go back
        if not (self.redistribute(t, evaluate) and self._begins(t, decision, evaluate)):
            self._keep_solution(t, solution.forces, evaluate)
        return decision

    def _slip_speed(self, i: int) -> float:
        """How fast item i slips, in m/s."""
        rows = [*range(int(self.system.contact_int[i, TANGENTS]))]
        return math.hypot(*relative_velocity(self.system, i, rows).tolist())

    def _begins(self, t: float, decision: Decision, evaluate: Callable[[float], int]) -> bool:
        """Whether what begins to slip does so under the loads of the last evaluation, too, which may turn it: not where
        they balance with friction that is turned, at the limit of what holds."""
        back, started = self._going_back(decision), [*decision.started]
        if not back:
            return True
        least = _CLEARLY * max(decision.started.values(), default=0.0)
        grows = align_slips(self.system, t, started, evaluate) and not self._going_back(decision)
        return grows and bool((self.system.contact_real[started, SLIP_RATE] > least).any())

    def _going_back(self, decision: Decision) -> list[int]:
        """What begins to slip, but goes the other way under the loads of the last evaluation."""
        system = self.system
        started = [i for i in decision.started if system.contact_int[i, MODE] == SLIPPING]
        least = -ROUND_OFF * float(np.abs(system.free_acceleration).max(initial=0.0))
        return [i for i in started if not system.contact_real[i, SLIP_RATE] >= least]

    def _align(self, t: float, decision: Decision, evaluate: Callable[[float], int]) -> bool:
        """Turn slip that begins to where it goes under the loads of the last evaluation, and evaluate in it; False
        where under these loads it does not begin in these modes. What would go back then sticks beside the others."""
        integers, stuck = self.system.contact_int, False
        while True:
            started = [c for c in decision.started if integers[c, MODE] == SLIPPING]
            if decision.status > EVENT or not started:
                return not stuck
            aligned = False
            for _ in range(_ROUNDS):
                # loads that are chosen anew turn it
                aligned = align_slips(self.system, t, started, evaluate)
                if not aligned or self._holds() or not self.redistribute(t, evaluate):
                    break
            decision.started.update((c, float(self.system.contact_real[c, SLIP_RATE])) for c in started)
            back = self._going_back(decision) if aligned else []
            if not back:
                return aligned and (not stuck or self._holds())
            stuck = True
            integers[back, MODE], integers[back, FROZEN] = STICK, 0
            decision.started = {c: rate for c, rate in decision.started.items() if c not in back}
            decision.status = evaluate(t)

    def _align_with_solution(
        self,
        t: float,
        decision: Decision,
        evaluate: Callable[[float], int],
        begun: tuple[np.ndarray, np.ndarray, dict[int, float]],
    ) -> bool:
        """The same under the loads of the contact problem's solution, whose directions these are, where others leave
        slip no direction. begun: integers and numbers of all items, and what starts, with these."""
        system = self.system
        if decision.forces is None:
            return False
        system.contact_int[:], system.contact_real[:], decision.started = begun
        self._keep_solution(t, decision.forces, evaluate)
        return align_slips(system, t, [*decision.started], evaluate) and not self._going_back(decision)

    def _keep_solution(self, t: float, forces: np.ndarray, evaluate: Callable[[float], int]) -> None:
        """Take the solution's forces (items, 3), on the rim of their cones, for the choice among redundant ones."""
        system, reference = self.system, forces.copy()
        reference[[i for i in system.resisting() if system.contact_int[i, MODE] == SLIPPING]] = 0.0
        lifted = [c for c in system.closed() if held_up_by_friction(system, c)]
        # what evaluations scale there is friction
        reference[lifted, 2] = np.linalg.norm(forces[lifted, :2], axis=1)
        self._take_reference(reference)
        evaluate(t)
