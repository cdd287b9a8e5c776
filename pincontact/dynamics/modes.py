"""Who sticks, who slips, who opens: the modes of all contacts at one state (Sec. 5.3).

Where a contact slides, its friction is known. Where it does not, the modes are those of the second-order-cone
complementarity at acceleration level: F in K_mu, u = G F + b, u + mu |u_t| n in the dual cone, complementary.
The cheap guess, everything undecided sticks, is tried first: if all forces lie inside their cones (of redundant ones,
those of one choice), it is the solution.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..friction import cone
from ..friction.loads import Disk, Loads, LoadSolver
from ..friction.solve import ContactSolver
from ..geometry.patterns import ON_CURVE
from ..layout import (
    ANISOTROPIC,
    EVENT,
    FREE,
    FRICTION_MARGIN,
    FRICTIONLESS,
    FROZEN,
    GUARD_END,
    GUARD_SIGN,
    GUARD_V,
    HIGH_FORCE,
    LENGTH,
    LOW_FORCE,
    MODE,
    MU,
    MU_NOW,
    MU_STATIC,
    NO_FORCE,
    NORMAL_MARGIN,
    NORMAL_SIGN,
    OK,
    PATTERN,
    SLIP_RATE,
    SLIP_SIGN,
    SLIPPING,
    STICK,
    TANGENTS,
    UNILATERAL,
    VISCOUS,
)
from .directions import align_slips, freeze_slip, slip_direction
from .linear import RANK_TOLERANCE
from .redundant import Choice, Cone, central_force, null_space
from .stretches import associated, opposed_slip, stretch
from .units import contact_rows, delassus, unit_columns, unwhiten, whiten, whitened_velocity

if TYPE_CHECKING:
    from .system import System

# Fixed point on loads where ideal rolling takes part: iterations in all, undamped ones, relative change that ends it.
_FIXED_POINT_ITERATIONS, _UNDAMPED, _FIXED_POINT_TOLERANCE = 100, 12, 1e-12
_ROUND_OFF = 1e-11
# Relative accelerations below this fraction of the free ones are round-off: no slip.
_STILL = 1e-13
# Stick that leaves more than this part of the relative acceleration that it has to end cannot be: its rows vanish, or
# other constraints take their place. Exact solutions leave round-off, such ones all of it.
_UNHELD = 1e-6
# Rounding of a row per m of its arms, with a margin.
_ROUNDING = 1e-13
# What stick may take from the velocity, in the mass metric: this part of it, and this many absolute tolerances: so far
# is slip that counts as ended from zero.
_TAKEN, _TAKEN_TOLERANCES = 1e-3, 1e4
# Viscous friction by which a contact is held up is all of it to so much.
_AT_ALL = 1e-6
# So often the directions of slip that begins, and what of redundant loads is carried where, are brought together.
_ROUNDS = 4
# Changes of mode for every contact and coordinate where they are made one by one.
_CHANGES = 4
# So often the same modes may come back: directions of slip that are found on the way may be others.
_RETURNS = 2
# Relative size below which singular values are zero, as pivots are in `dynamics.linear`.
_SINGULAR = math.sqrt(RANK_TOLERANCE)


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


@dataclass
class _Problem:
    """A cone problem G F + b over contacts, held coordinates and resistances, in this order.

    gram (3n, 3n), base (3n,), limits (n,); weights (3n,): diagonal of rows that are missing, else 0; shapes: contact
    unit -> stretch in whose coordinates its cone is round; turns: resistance -> its unit.
    """

    gram: np.ndarray
    base: np.ndarray
    weights: np.ndarray
    limits: np.ndarray
    shapes: dict[int, np.ndarray] = field(default_factory=dict)
    turns: dict[int, int] = field(default_factory=dict)


class _Solution(NamedTuple):
    """Forces (n, 3) and relative accelerations (n, 3) of a cone problem's units, and their modes (n,)."""

    forces: np.ndarray
    velocities: np.ndarray
    modes: np.ndarray
    residual: float


class ModeSolver:
    """Decides modes; keeps the cone solver's buffers and counts what it did."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.cone_problems = 0
        self.redistributions = 0
        self.worst_residual = 0.0
        # whether the forces at the last attempt to redistribute were redundant
        self.redundant = False
        # time, constraint rows and forces of the last choice
        self._last: tuple[float, np.ndarray, np.ndarray] | None = None
        self._limits = np.zeros(system.items)
        # whether there are no forces where the last decision found none
        self.proved = False
        self.contact_solver = "auto"

    @cached_property
    def solver(self) -> ContactSolver:
        """Made when the first cone problem is posed."""
        # the loads that what slides is given must be those that evaluations find, which are of least norm
        return ContactSolver(nearest=False, contact_solver=self.contact_solver)

    @cached_property
    def loads(self) -> LoadSolver:
        """Made when the first problem with loads is posed."""
        return LoadSolver()

    def decide(
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
        # contacts beyond their static limit are held by sliding friction at most, the others by static friction
        self._limits = system.contact_real[:, MU_STATIC].copy()
        exceeded = system.margins[:, FRICTION_MARGIN] < 0.0
        if beyond is not None:
            exceeded[beyond] = True
        self._limits[exceeded] = system.contact_real[exceeded, MU]
        decision = self._solve(t, undecided, evaluate)
        decision.started.update(passing)
        decision.started = {c: a for c, a in decision.started.items() if integers[c, MODE] == SLIPPING}
        return decision

    def force_round_off(self) -> float:
        """Forces in N (or N m) below which a sign means nothing, from the loads on the joints."""
        loads = zip(self.system.bias_forces.tolist(), self.system.tau.tolist())
        return _ROUND_OFF * max((abs(bias) + abs(torque) for bias, torque in loads), default=0.0)

    def _holds(self) -> bool:
        """Whether every force of the last evaluation lies inside its cone."""
        system = self.system
        active = [*system.closed(), *(system.nc + g for g in system.held()), *system.resisting()]
        margins = system.margins.tolist()
        return all(margins[i][NORMAL_MARGIN] >= 0.0 and margins[i][FRICTION_MARGIN] >= 0.0 for i in active)

    # ---------------------------------------------------------------- slip that only passes zero

    def _let_pass(self, t: float, undecided: list[int], evaluate) -> dict[int, float]:
        """Let slide on what cannot stick although its v_c is zero, as at the dead centre of a crank; which, with the
        relative acceleration in m/s^2 that it has. The last evaluation is one with all undecided ones sticking.

        There v_c vanishes because of the place, its rows do or are those of other constraints, and no force ends it.
        Its friction does not change that acceleration, which is therefore that without friction.
        """
        system = self.system
        passing: dict[int, float] = {}
        while True:
            c = self._unheld([i for i in undecided if i not in passing])
            if c is None:
                return passing
            system.contact_int[c, MODE] = FRICTIONLESS
            if evaluate(t) > EVENT:
                system.contact_int[c, MODE] = STICK
                evaluate(t)
                return passing
            tangents = int(system.contact_int[c, TANGENTS])
            along = system.rows[c, :tangents] @ system.acceleration + system.bias[c, :tangents]
            freeze_slip(system, c, along)
            passing[c] = float(np.linalg.norm(along))
            evaluate(t)

    def _unheld(self, undecided: list[int]) -> int | None:
        """One of these contacts that cannot stick at the last evaluation's velocity, if there is one."""
        system = self.system
        count = int(system.counters["row_count"])
        contacts = [c for c in undecided if c < system.nc]
        if not contacts or count == 0:
            return None
        moving_as = whitened_velocity(system, system.v)
        speed = math.sqrt(moving_as @ moving_as)
        if not 0.0 < speed < math.inf:
            return None
        # independent rows are held exactly
        for c in contacts if count != system.counters["row_rank"] else ():
            tangents = int(system.contact_int[c, TANGENTS])
            left = system.rows[c, :tangents] @ system.acceleration + system.bias[c, :tangents]
            # by what forces do and by what turns: either may vanish
            sizes = np.abs(system.rows[c])
            turning = (sizes @ np.abs(system.v)).max() ** 2 / system.contact_real[c, LENGTH]
            rate = (sizes @ np.abs(system.free_acceleration) + np.abs(system.bias[c])).max() + turning
            # and not by round-off of rows that are zero
            most = np.abs(system.free_acceleration).max() + np.abs(system.v).max() ** 2
            rounding = _ROUNDING * max(system.contact_real[c, LENGTH], 1.0) * most
            if np.abs(left).max() > max(_UNHELD * rate, rounding):
                return c
        index, whitened = system.row_index[:count], system.whitened_rows[:count]
        allowed = self._negligible(speed)
        lengths = np.sqrt(np.einsum("rk,rk->r", whitened, whitened))
        slip = max(float(np.abs(system.basis[c] @ system.slip[c]).max()) for c in contacts)
        # rows that are as dependent as they may be magnify what is wanted no further
        if slip * math.sqrt(count) <= _SINGULAR * allowed * float(lengths.min()):
            return None
        items, row = index[:, 0], index[:, 1]
        moving = (lengths > 0.0) & np.isfinite(lengths)
        slips = np.isin(items, contacts) & (row < system.contact_int[items, TANGENTS]) & moving
        residual = np.where(slips, np.einsum("ri,ri->r", system.basis[items, row], system.slip[items]), 0.0)
        unit, wanted = whitened[moving] / lengths[moving, None], residual[moving] / lengths[moving]
        if float(np.linalg.norm(np.linalg.lstsq(unit, wanted, rcond=_SINGULAR)[0])) <= allowed:
            return None
        return int(items[slips][np.argmax(np.abs(residual[slips]) / lengths[slips])])

    def _negligible(self, speed: float) -> float:
        """What constraints may take from a velocity of this size, in the mass metric of the last evaluation."""
        rtol, atol = self.system.scale.tolist()
        return max(max(_TAKEN, rtol) * speed, _TAKEN_TOLERANCES * atol * float(np.linalg.norm(self.system.factor)))

    def taken_from(self, before: np.ndarray) -> tuple[float, float, float]:
        """How far the velocity is from what it was, how large that was, and how far it may be for errors of steps to
        explain it: in the mass metric of the last evaluation, in which half a square is an energy."""
        system = self.system
        size = float(np.linalg.norm(whitened_velocity(system, before)))
        change = float(np.linalg.norm(whitened_velocity(system, system.v - before)))
        return change, size, self._negligible(size)

    # ---------------------------------------------------------------- redundant forces

    def redistribute(self, t: float, evaluate, ended: int | None = None) -> bool:
        """Choose other ones among redundant forces, such that all lie inside their cones; False where none do.

        ended: the contact whose load has come to zero, or comes back from there. Needs the last evaluation, whose
        accelerations stay what they are, unless loads of what slides are chosen.
        """
        system = self.system
        count = int(system.counters["row_count"])
        if count == system.counters["row_rank"]:
            # of independent rows there is one choice
            return False
        index = system.row_index[:count].copy()
        closed = system.closed()
        slipping = any(system.contact_int[c, MODE] == SLIPPING for c in [*closed, *system.resisting()])
        if slipping and count == len(closed):
            # no force but loads to choose
            return self._unload(t, evaluate, ended)
        rows = system.whitened_rows[:count]
        directions = system.whitened_forces[:count] if slipping else rows
        if not np.isfinite(directions).all():
            return False
        null = null_space(directions)
        self.redundant = null.shape[1] > 0
        if not self.redundant:
            return False
        forces = system.force[index[:, 0], index[:, 1]]
        for r, (c, row) in enumerate(index):
            if row == 2 and c < system.nc and held_up_by_friction(system, c):
                forces[r] = math.hypot(system.force[c, 0], system.force[c, 1])
        found = central_force(forces, null, self._cones(index))
        if found is None:
            return False
        arrays = system.reference, system.reference_start, system.reference_rate, system.reference_slope
        kinds = "has_reference", "reference_moves", "reference_time"
        before, last = [array.copy() for array in arrays], self._last
        scalars = [system.scalars[kind] for kind in kinds]
        self._follow(t, index, found, rows @ (directions.T @ found.span), slipping)
        if evaluate(t) <= EVENT and self._holds():
            self.redistributions += 1
            return True
        for array, values in zip(arrays, before):
            array[:] = values
        for kind, value in zip(kinds, scalars):
            system.scalars[kind] = value
        self._last = last
        evaluate(t)
        return False

    def _load_all(self) -> bool:
        """Let every closed contact carry a load; whether all did."""
        integers = self.system.contact_int
        without = [c for c in self.system.closed() if integers[c, UNILATERAL] and integers[c, NORMAL_SIGN] != 1]
        for c in without:
            self.load(c)
        return not without

    def load(self, c: int) -> None:
        """Let closed contact c carry a load."""
        system = self.system
        if shares_viscous_force(system, c) and system.contact_real[c, MU] == 0.0:
            system.contact_int[c, MODE] = FRICTIONLESS
        system.contact_int[c, NORMAL_SIGN] = 1

    def _unload(self, t: float, evaluate, ended: int | None) -> bool:
        """Give the loads of what slides the least values that are not negative; False where contacts open instead.

        A contact that is to carry nothing stays closed by itself, as do four feet on a plane that stand on three. Loads
        then are continuous in time; those without it enter again where the least ones ask for them.
        ended: see `redistribute`.
        """
        system = self.system
        integers = system.contact_int
        before = integers[:, NORMAL_SIGN].copy()
        closed = [c for c in system.closed() if integers[c, UNILATERAL] and not shares_viscous_force(system, c)]
        if ended is not None and ended not in closed:
            return False
        seen = set()
        self._take_reference(None)
        if ended is not None:
            integers[ended, NORMAL_SIGN] = 1 - integers[ended, NORMAL_SIGN]
        status = evaluate(t)
        while status <= EVENT:
            margins = {c: float(system.margins[c, NORMAL_MARGIN]) for c in closed}
            worst = min(closed, key=lambda c: margins[c], default=None)
            if worst is None or margins[worst] >= -self.force_round_off():
                if ended is not None and integers[ended, NORMAL_SIGN] == before[ended]:
                    break
                self.redistributions += 1
                return True
            state = integers[closed, NORMAL_SIGN].tobytes(), worst
            if state in seen:
                break
            seen.add(state)
            integers[worst, NORMAL_SIGN] = 1 - integers[worst, NORMAL_SIGN]
            status = evaluate(t)
        integers[:, NORMAL_SIGN] = before
        evaluate(t)
        return False

    def _follow(self, t: float, index: np.ndarray, choice: Choice, operator: np.ndarray, slipping: bool) -> None:
        """Take the choice for the reference, and let that move as the choice will.

        index (count, 2): the constraint rows; operator (count, r): what forces along `choice.span` do to them. What
        slips changes directions of forces, too: there the tangent along loads is good for a first guess only, and
        after that the rate is the one since the last choice.
        """
        system = self.system
        c, row = index[:, 0], index[:, 1]
        last = self._last
        self._take_reference(np.zeros_like(system.reference))
        system.scalars["reference_moves"], system.scalars["reference_time"] = 1.0, t
        system.reference_start[:] = system.reference_rate[:] = system.reference_slope[:] = 0.0
        self._last = t, index, choice.forces
        if slipping and last is not None and last[0] < t and np.array_equal(last[1], index):
            system.reference_start[c, row] = choice.forces
            system.reference_rate[c, row] = (choice.forces - last[2]) / (t - last[0])
            return
        loads = -(np.einsum("rk,k->r", system.rows[c, row], system.free_acceleration) + system.bias[c, row])
        across = np.linalg.pinv(operator)
        system.reference_start[c, row] = choice.forces - choice.slope @ (across @ loads)
        rank = choice.span.shape[1]
        system.reference_slope[0, 3 * c + row, :rank] = across.T
        system.reference_slope[1, 3 * c + row, :rank] = choice.slope

    def _take_reference(self, reference: np.ndarray | None) -> None:
        """Choose redundant forces nearest to these (nc + ng + nr, 3), or None: nearest to zero."""
        system = self.system
        system.scalars["has_reference"] = 0.0 if reference is None else 1.0
        system.scalars["reference_moves"] = 0.0
        self._last = None
        if reference is not None:
            system.reference[:] = reference

    def _cones(self, index: np.ndarray) -> list[Cone]:
        """The cones of the forces in the constraint rows `index` (count, 2)."""
        system = self.system
        rows = {(int(c), int(row)): r for r, (c, row) in enumerate(index)}
        cones = []
        for c in system.closed():
            integers, mu = system.contact_int[c], float(system.contact_real[c, MU_STATIC])
            normal, sticks = rows[c, 2], integers[MODE] == STICK and math.isfinite(mu)
            tangents = tuple(rows[c, row] for row in range(integers[TANGENTS])) if sticks else ()
            if integers[UNILATERAL]:
                cones.append(Cone(normal, mu, 0.0, tangents) if tangents else Cone(normal, 1.0, 0.0))
            elif tangents and integers[PATTERN] != ON_CURVE:
                cones.append(Cone(normal, math.copysign(mu, system.force[c, 2]), 0.0, tangents))
        for i in system.resisting():
            if system.contact_int[i, MODE] == STICK:
                owner, tangents = system.owner(i), tuple(rows[i, row] for row in range(system.contact_int[i, TANGENTS]))
                limit = float(system.contact_real[i, MU_STATIC])
                if not system.contact_int[owner, UNILATERAL]:
                    limit = math.copysign(limit, system.force[owner, 2])
                cones.append(Cone(rows[owner, 2], limit, 0.0, tangents))
        for g in system.held():
            row, end = rows[system.nc + g, 2], system.guard_int[g, GUARD_END]
            if end <= 0:
                cones.append(Cone(row, 1.0, -float(system.guard_real[g, LOW_FORCE])))
            if end >= 0:
                cones.append(Cone(row, -1.0, float(system.guard_real[g, HIGH_FORCE])))
        return cones

    # ---------------------------------------------------------------- the cone problem

    def _solve(self, t: float, undecided: list[int], evaluate) -> Decision:
        """The cone problem over all closed contacts, held coordinates and resistances to turning; what slides enters
        as known forces, resistances at rest as disks whose radius follows from the load."""
        system = self.system
        integers = system.contact_int
        closed, held, resisting = system.closed(), system.held(), system.resisting()
        if any(not integers[c, UNILATERAL] or held_up_by_friction(system, c) for c in closed):
            return self._decide_without_cones(t, undecided, closed, evaluate)
        dragging = [c for c in closed if drags(system, c)]
        modes, guards = integers.copy(), system.guard_int.copy()
        decision = self._solve_cones(t, undecided, closed, held, resisting, evaluate)
        if dragging and not self._stay_open(t, [c for c in dragging if c in decision.opened], decision, evaluate):
            # viscous friction ends where contacts open, which no cone knows
            integers[:], system.guard_int[:] = modes, guards
            return self._decide_without_cones(t, undecided, closed, evaluate)
        if not self._align(t, decision, evaluate):
            # redundant loads are others in slip: decide with those, or not at all
            integers[:], system.guard_int[:] = modes, guards
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
            if self._all_stick(closed, undecided, held, resisting):
                problem = self._problem_of_sticking(closed)
            else:
                problem = self._problem(closed, undecided, held, resisting)
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
        still = _STILL * max(map(abs, base.tolist()))
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
            mode, end = modes[i], int(system.guard_int[g, GUARD_END])
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

    def _all_stick(self, closed: list[int], undecided: list[int], held: list[int], resisting: list[int]) -> bool:
        """Whether the last evaluation's constraint rows are those of the cone problem: round cones and nothing else."""
        system = self.system
        integers, numbers = system.contact_int, system.contact_real
        return (
            not (held or resisting)
            and system.counters["row_count"] == 3 * len(closed)
            and all(
                integers[c, MODE] == STICK
                and not integers[c, ANISOTROPIC]
                and (c in undecided or math.isinf(numbers[c, MU]))
                for c in closed
            )
        )

    def _problem_of_sticking(self, closed: list[int]) -> _Problem:
        """The cone problem where `_all_stick`."""
        system, count = self.system, 3 * len(closed)
        # an evaluation lists the normal first
        whitened = system.whitened_rows[_normals_last(len(closed))]
        base = system.rows[closed].reshape(count, system.nv) @ system.free_acceleration
        base += system.bias[closed].reshape(count)
        gram, weights = delassus(whitened.T)
        if weights.any():
            base[weights > 0.0] = 0.0
        return _Problem(gram, base, weights, self._limits[closed])

    def _problem(self, closed: list[int], undecided: list[int], held: list[int], resisting: list[int]) -> _Problem:
        """The cone problem without the pull of what slides: units of contacts, held coordinates, resistances."""
        system = self.system
        integers, numbers = system.contact_int, system.contact_real
        n = len(closed)
        units = [unit_columns(system, c, contact_rows(integers[c, TANGENTS])) for c in closed]
        mu = [float(self._limits[c]) if c in undecided or math.isinf(numbers[c, MU]) else 0.0 for c in closed]
        # elliptic cones are round in other coordinates
        shapes = {i: stretch(system, c) for i, c in enumerate(closed) if integers[c, ANISOTROPIC]}
        for i, shape in shapes.items():
            units[i][:, :2] = units[i][:, :2] @ shape
        free = system.free_acceleration.copy()
        for g in held:
            end, (low, high) = system.guard_int[g, GUARD_END], system.guard_real[g, :2]
            # about its middle, friction is a disk of constant radius; at an end, what the end adds to friction only
            # pushes away from it
            middle = (low, 0.5 * (low + high), high)[end + 1]
            column = whiten(system, system.rows[system.nc + g, 2])
            free += unwhiten(system, column) * middle
            columns = np.zeros((system.nv, 3))
            columns[:, 0 if end == 0 else 2] = -column if end > 0 else column
            units.append(columns)
            mu.append(1.0 if end == 0 else 0.0)
        turns = {i: len(units) + k for k, i in enumerate(resisting)}
        for i in resisting:
            units.append(unit_columns(system, i, range(integers[i, TANGENTS])))
            mu.append(1.0)
        stack = np.hstack(units) if len(units) > 1 else units[0]
        gram, weights = delassus(stack)
        base = stack.T @ whitened_velocity(system, free)
        bias = system.bias[closed]
        for i, shape in shapes.items():
            bias[i, :2] = shape @ bias[i, :2]
        base[: 3 * n] += bias.reshape(-1)
        for i, u in turns.items():
            base[3 * u : 3 * u + 2] += system.bias[i, :2]
        if weights.any():
            base[weights > 0.0] = 0.0
        for i, g in enumerate(held, start=n):
            if system.guard_int[g, GUARD_END] == 0:
                low, high = system.guard_real[g, :2]
                base[3 * i + 2] = -0.5 * (high - low) * weights[3 * i + 2]
        return _Problem(gram, base, weights, np.array(mu), shapes, turns)

    def _solve_with_loads(
        self, problem: _Problem, closed: list[int], held: list[int], resisting: list[int]
    ) -> _Solution | None:
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
            return _Solution(forces, velocities, solver.modes, float(solver.residual))
        n, size = len(closed), base.size
        normals = [3 * i + 2 for i in range(n)]
        normals += [3 * i + 2 for i, g in enumerate(held, start=n) if system.guard_int[g, GUARD_END] != 0]
        loads = Loads(gram, base, normals)
        start, slips, limits = np.zeros(size), np.zeros(size), problem.limits.copy()
        for i, c in enumerate(closed):
            force = system.force[c].copy()
            tangents = int(integers[c, TANGENTS])
            start[3 * i + 2] = max(float(force[2]), 0.0)
            if i in sliding:
                direction = slip_direction(system, c)
                drag = loads.drag.setdefault(3 * i + 2, np.zeros(size))
                drag[3 * i : 3 * i + 2] = -numbers[c, MU_NOW] * _unstretched(
                    problem.shapes, i, associated(system, c, direction)
                )
                slips[3 * i : 3 * i + 2] = problem.shapes[i] @ direction if i in problem.shapes else direction
                limits[i] = numbers[c, MU_NOW]
            elif limits[i] > 0.0:
                loads.disks.append(Disk([3 * i + j for j in range(tangents)], float(limits[i]), 3 * i + 2))
                start[3 * i : 3 * i + 2] = _unstretched(problem.shapes, i, force[:2])
        for i, g in enumerate(held, start=n):
            if system.guard_int[g, GUARD_END] == 0:
                low, high = system.guard_real[g, :2]
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
        return _Solution(found.forces.reshape(-1, 3), found.velocities.reshape(-1, 3), modes, found.residual)

    def _iterate_loads(
        self, problem: _Problem, loads: Loads, start: np.ndarray, limits: np.ndarray
    ) -> _Solution | None:
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
                return _Solution(forces, velocities, solver.modes, float(solver.residual))
            before = after if iteration < _UNDAMPED else 0.5 * (before + after)
        return None

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
            end, (low, high) = system.guard_int[g, GUARD_END], system.guard_real[g, :2]
            extra = forces[i, 0] if end == 0 else -end * forces[i, 2]
            reference[system.nc + g, 2] = extra + (0.5 * (low + high) if end == 0 else (low if end < 0 else high))
        self._take_reference(reference)
        evaluate(t)

    def release(self, g: int, sign: int) -> None:
        """Let held coordinate g move in the direction of `sign`."""
        guard = self.system.guard_int[g]
        dry = self.system.guard_real[g, LOW_FORCE] < self.system.guard_real[g, HIGH_FORCE]
        guard[GUARD_SIGN], guard[GUARD_END] = sign if dry else 0, 0
        self.system.contact_int[self.system.nc + g, MODE] = FREE

    def hold(self, g: int, end: int) -> None:
        """Hold coordinate g at its lower (-1) or upper (+1) end, or by dry friction (0)."""
        self.system.guard_int[g, GUARD_SIGN], self.system.guard_int[g, GUARD_END] = 0, end
        self.system.contact_int[self.system.nc + g, MODE] = FRICTIONLESS

    def _open(self, t: float, c: int, evaluate, decision: Decision) -> None:
        """Let contact c go, whose normal force would pull; or slide, if it is ideal rolling that this would close, or
        the end of viscous friction."""
        system = self.system
        integers, force = system.contact_int[c], system.force[c, :2].copy()
        if self.share(t, c, evaluate):
            return
        may_slide = integers[MODE] == STICK and math.isinf(system.contact_real[c, MU])
        integers[MODE] = FREE
        if may_slide and evaluate(t) <= EVENT and self.gap_acceleration(t, c) < 0.0:
            freeze_slip(system, c, -force)
            holds = evaluate(t) <= EVENT and (system.margins[c, [NORMAL_MARGIN, FRICTION_MARGIN]] >= 0.0).all()
            if holds and system.contact_real[c, SLIP_RATE] > 0.0:
                decision.started[c] = float(system.contact_real[c, SLIP_RATE])
                return
            integers[[MODE, FROZEN]] = FREE, 0
        decision.opened.append(c)

    def share(self, t: float, c: int, evaluate) -> bool:
        """Keep contact c, whose normal force would pull, closed without one, by a part of its viscous friction; False
        where that is not needed, or does not do. Then the contact is what it was.

        Viscous friction ends as a contact opens. Where it pushes the bodies apart, they would close again at once: the
        contact can neither stay closed nor open. Between both, a part of the friction keeps it where it is (the
        solution of Filippov, and the limit of ever shorter hops).
        """
        system = self.system
        integers = system.contact_int[c]
        if not drags(system, c) or shares_viscous_force(system, c):
            return False
        mode, sign = int(integers[MODE]), int(integers[SLIP_SIGN])
        if self._closes_without(t, c, evaluate):
            integers[MODE], integers[NORMAL_SIGN] = SLIPPING, -1
            if integers[TANGENTS] == 1:
                integers[SLIP_SIGN] = 1 if system.basis[c, 0] @ system.slip[c] >= 0.0 else -1
            if evaluate(t) <= EVENT and system.margins[c, NORMAL_MARGIN] >= 0.0 and not self._takes_all(c):
                return True
        integers[MODE], integers[NORMAL_SIGN], integers[SLIP_SIGN] = mode, 1, sign
        evaluate(t)
        return False

    def _takes_all(self, c: int) -> bool:
        """Whether contact c is held up by more than all of its viscous friction. It starts with all of it."""
        system = self.system
        force = math.hypot(system.force[c, 0], system.force[c, 1])
        return bool(system.margins[c, FRICTION_MARGIN] < -_AT_ALL * force)

    def _closes_without(self, t: float, c: int, evaluate) -> bool:
        """Whether contact c would close if it and what would pull without it were let go; it is open then."""
        system = self.system
        modes = system.contact_int[: system.nc, MODE].copy()
        system.contact_int[c, MODE] = FREE
        closes = False
        while evaluate(t) <= EVENT:
            pulls = system.margins[: system.nc, NORMAL_MARGIN] < -self.force_round_off()
            pulls &= (system.contact_int[: system.nc, UNILATERAL] != 0) & (system.modes[: system.nc] != FREE)
            if not pulls.any():
                closes = self.gap_acceleration(t, c) < 0.0
                break
            system.contact_int[: system.nc][pulls, MODE] = FREE
        modes[c] = FREE
        system.contact_int[: system.nc, MODE] = modes
        return closes

    def gap_acceleration(self, t: float, c: int) -> float:
        """Second derivative in m/s^2 of the gap of an open contact in the last evaluation; NaN if it has no rows."""
        system = self.system
        if system.evaluate_kinematics(t) != OK:
            return math.nan
        return float(system.rows[c, 2] @ system.acceleration + system.bias[c, 2])

    def _decide_without_cones(self, t: float, undecided: list[int], closed: list[int], evaluate) -> Decision:
        """Contacts that cannot open carry |F_n| of either sign, those that friction alone holds up none: both are no
        cones. Slide the one that exceeds its limit most, to where it goes then, and look again; what would go back
        sticks again. Serves one-tangent and few two-tangent contacts."""
        system = self.system
        integers = system.contact_int
        decision = Decision(OK)
        # joint coordinates that are let go, with the ends at which they were and the directions in which they go
        released: dict[int, tuple[int, int]] = {}
        seen: Counter[bytes] = Counter()
        for _ in range(_CHANGES * (len(closed) + system.ng + system.nr) + _CHANGES):
            decision.status = evaluate(t)
            if decision.status > EVENT:
                return decision
            if (
                self._hold_one(released)
                or self._release_one(released)
                or self._change_normal(t, closed, evaluate, decision)
            ):
                continue
            started = [c for c in decision.started if integers[c, MODE] == SLIPPING]
            back = self._goes_back(t, started, evaluate)
            if back is not None:
                integers[back, [MODE, FROZEN]] = STICK, 0
                continue
            if (system.margins[closed, NORMAL_MARGIN] < -self.force_round_off()).any():
                # as it has turned
                continue
            worst = self._exceeding(closed)
            if worst is None:
                decision.started = {c: float(system.contact_real[c, SLIP_RATE]) for c in started}
                self._stick_at_limits(t, decision, evaluate)
                return decision
            # what slides from the same modes as before has gone back, and will again
            seen[integers[:, : FROZEN + 1].tobytes() + system.guard_int.tobytes()] += 1
            if seen.most_common(1)[0][1] > _RETURNS:
                break
            force, owner = system.force[worst].copy(), system.owner(worst)
            if integers[owner, PATTERN] != ON_CURVE:
                integers[owner, NORMAL_SIGN] = 1 if system.force[owner, 2] >= 0.0 else -1
            freeze_slip(system, worst, opposed_slip(system, worst, force[:2]))
            decision.started[worst] = 0.0
        decision.status = NO_FORCE
        return decision

    def _still(self) -> float:
        """Relative accelerations in m/s^2 below which is round-off."""
        system = self.system
        count = int(system.counters["row_count"])
        c, row = system.row_index[:count].T
        return _ROUND_OFF * float((np.abs(system.rows[c, row]) @ np.abs(system.free_acceleration)).max(initial=0.0))

    def _stick_at_limits(self, t: float, decision: Decision, evaluate) -> None:
        """What is at its limit of friction and does not slide sticks, with the last evaluation's redundant forces."""
        rest = [c for c, rate in decision.started.items() if rate <= self._still()]
        if not rest:
            return
        for c in rest:
            self.system.contact_int[c, [MODE, FROZEN]] = STICK, 0
            del decision.started[c]
        self._take_reference(self.system.force)
        decision.status = evaluate(t)

    def _release_one(self, released: dict[int, tuple[int, int]]) -> bool:
        """Let a held joint coordinate move whose force exceeds a bound, if there is one."""
        system = self.system
        for g in system.held():
            low, high = system.margins[system.nc + g, NORMAL_MARGIN], system.margins[system.nc + g, FRICTION_MARGIN]
            if min(low, high) < -self.force_round_off():
                sign = 1 if low < high else -1
                released[g] = int(system.guard_int[g, GUARD_END]), sign
                self.release(g, sign)
                return True
        return False

    def _hold_one(self, released: dict[int, tuple[int, int]]) -> bool:
        """Hold a joint coordinate again that was let go and would go back, if there is one."""
        system = self.system
        for g, (end, sign) in released.items():
            rate = sign * float(system.acceleration[system.guard_int[g, GUARD_V]])
            if rate < -_ROUND_OFF * float(np.abs(system.free_acceleration).max()):
                del released[g]
                self.hold(g, end)
                return True
        return False

    def _change_normal(self, t: float, closed: list[int], evaluate, decision: Decision) -> bool:
        """Open a contact that pulls, or take the other sign of the normal force of a bilateral one; whether there was
        one to change."""
        system = self.system
        integers = system.contact_int
        for c in closed:
            if integers[c, MODE] == FREE:
                continue
            if system.margins[c, NORMAL_MARGIN] < -self.force_round_off():
                if integers[c, UNILATERAL]:
                    self._open(t, c, evaluate, decision)
                else:
                    integers[c, NORMAL_SIGN] *= -1
                return True
            if shares_viscous_force(system, c) and self._takes_all(c):
                self.load(c)
                return True
        return False

    def _goes_back(self, t: float, started: list[int], evaluate) -> int | None:
        """One of these items, whose slip begins, that friction would not let go anywhere; else they go where their
        accelerations point."""
        rates = self.system.contact_real[:, SLIP_RATE]
        if align_slips(self.system, t, started, evaluate):
            back = [c for c in started if rates[c] < -self._still()]
        else:
            back = started
        return min(back, key=lambda c: float(rates[c]), default=None)

    def _exceeding(self, closed: list[int]) -> int | None:
        """The item of closed contacts that sticks and exceeds its limit of friction most, if one does."""
        system = self.system
        integers = system.contact_int
        worst, excess = None, 0.0
        for c in closed:
            if integers[c, MODE] == FREE or shares_viscous_force(system, c):
                continue
            for i in (c, *(i for i in system.resisting() if system.owner(i) == c)):
                # in N, a resistance's divided by its length
                scale = 1.0 if i == c else float(system.contact_real[i, MU])
                if integers[i, MODE] == STICK and system.margins[i, FRICTION_MARGIN] < excess * scale:
                    worst, excess = i, system.margins[i, FRICTION_MARGIN] / scale
        return worst


@cache
def _normals_last(n: int) -> np.ndarray:
    """(3n,) places of the rows (t1, t2, n) of n contacts whose rows are listed as (n, t1, t2)."""
    return (3 * np.arange(n)[:, None] + np.array([1, 2, 0])).reshape(-1)


def _unstretched(shapes: dict[int, np.ndarray], i: int, force: np.ndarray) -> np.ndarray:
    """A tangential force (2,) in the coordinates in which the cone of unit i is round."""
    return np.linalg.solve(shapes[i], force) if i in shapes else force


def held_up_by_friction(system: System, c: int) -> bool:
    """Whether contact c slides with F_n = 0 and a tangential force against its slip: ideal rolling, or what a part of
    its viscous friction keeps from closing."""
    ideal = system.contact_int[c, MODE] == SLIPPING and math.isinf(system.contact_real[c, MU])
    return bool(ideal) or shares_viscous_force(system, c)


def shares_viscous_force(system: System, c: int) -> bool:
    """Whether contact c is held up by a part of its viscous friction alone."""
    integers = system.contact_int[c]
    return bool(integers[MODE] == SLIPPING and integers[UNILATERAL] and integers[NORMAL_SIGN] < 0)


def drags(system: System, c: int) -> bool:
    """Whether contact c is unilateral and moves with viscous friction, which vanishes as it opens."""
    integers = system.contact_int[c]
    moves = integers[MODE] in (SLIPPING, FRICTIONLESS) and integers[UNILATERAL]
    return bool(moves and system.contact_real[c, VISCOUS] > 0.0)


def rest_mode(mu: float) -> int:
    """The mode of a closed contact that does not slide."""
    return FRICTIONLESS if mu == 0.0 else STICK
