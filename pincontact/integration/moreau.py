"""Time stepping with impulses (Moreau's midpoint method): for many contacts, impacts, accumulating bounces and jams.

Every step solves one cone problem in velocities and impulses, whatever happens within it; nothing is located and no
mode is kept. Second order in h while modes last, first order through their changes; see `impulses` for the equations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..callback import kernel_address
from ..dynamics.system import System
from ..friction.attempt import NEAR, WARM_PASSES, solve_cones
from ..friction.cone import OPEN as OPENS
from ..friction.cone import SLIP as SLIPS
from ..friction.cone import STICK as STICKS
from ..friction.loads import TOLERANCE as PRODUCT_TOLERANCE
from ..friction.product import SETTLED, Product
from ..friction.solve import ContactSolver
from ..jit import compile_kernels
from ..layout import (
    CHART,
    CONDITION,
    CONTACT_INTS,
    DOMAIN,
    FREE,
    FRICTIONLESS,
    LOCATION_FAILED,
    MODE,
    NO_FORCE,
    OK,
    SINGULAR,
    SLIPPING,
    STICK,
    TOO_LONG,
    UNILATERAL,
    VISCOUS,
)
from .choices import Units, chosen_forces, holding_forces
from .contradictions import contradiction
from .events import UserEvent
from .impulse_layout import (
    APART,
    ASKED,
    ASKED_WITH,
    CALL_FAILED,
    CHANGED,
    CHOOSING,
    CONE_RESIDUAL,
    CONE_TASK,
    CONE_TOLERANCE,
    COUPLED,
    DRY_FRICTION,
    HELD,
    HOLDING,
    JOINT_INTS,
    KEPT,
    KEPT_HIGH,
    KEPT_LOW,
    LAST,
    LOOKED_FOR,
    LOWER_LIMIT,
    NEQ,
    ON_CONTACT,
    ON_JOINT,
    ON_LOADED,
    ON_TURN,
    OPEN_LOADS,
    PARENT,
    RIGID_STEPS,
    ROW_COUNT,
    ROW_MASK,
    ROW_STEPS,
    ROWS_DONE,
    RUN_END,
    RUN_START,
    SHIFT,
    SOLVED_HERE,
    STEP_LIMIT,
    STEP_SIZE,
    STEPS,
    THOROUGH,
    TOGETHER,
    TOUCHED,
    TURNS,
    UNIT_INDEX,
    UNIT_KIND,
    UNIT_LOAD,
    UNITS,
    UPPER_LIMIT,
    WANTED,
    WATCHED,
    H,
    step_workspace,
)
from .impulse_problem import assemble
from .impulse_steps import (
    ACCEPT,
    APPROVED,
    AT_END,
    AT_LIMIT,
    ATTEMPT,
    ATTEMPTED,
    BEGIN,
    CONE_LEFT,
    FRESH,
    INNER_OUTPUT_LEFT,
    MARCH,
    MARCHING,
    OUTPUT_LEFT,
    SLIVER,
    SOLVED,
    STEP,
    UNSOLVED,
    run_steps,
)
from .open_contacts import MANY_STEPS, OpenContacts
from .results import (
    CLOSED_APART,
    CONTOUR_ENDS,
    CONTRADICTION,
    FAILURES,
    FINISHED,
    FLIES_THROUGH,
    TERMINATED,
    Event,
    Stop,
)
from .results import STEP_LIMIT as AT_STEP_LIMIT
from .sign_changes import resolve, with_dips, zero_between
from .stages import load_state, move_charts
from .steps import run_task

if TYPE_CHECKING:
    from ..contacts import Contact
    from ..dynamics.joints import Guard

DEFAULT_STEP = 1e-3

# Compliances relative to the contacts' own, tried in turn where the cone problem has no solution.
_COMPLIANCES = (1e-10, 1e-8, 1e-6, 1e-4)
# What such a solution's forces may be, as velocities, relative to the largest one in b.
_LARGEST_FORCE = 10.0
# How modes are looked for, quickly in every step, at length (milliseconds) where nothing else has helped; without the
# search whose linear algebra rounds differently with the alignment of memory.
_SEARCHES = ("sweeps", "path")
# Motion in one step (rad or m) from which on a failure is put down to steps that are too long.
_RUNAWAY = 10.0
# Motion in one step (rad or m) below which no body has turned far in it.
_TURNS_FAR = 0.3
# Accuracy of the time of a user's event, relative to the step.
_EVENT_ACCURACY = 1e-12

# What steps call by address, in the order of the columns of "calls".
_CALLED = (run_task, solve_cones, assemble, move_charts)
# Arrays of a step that hold addresses, or that there are within a call only.
_OWN = ("calls", "cone_tables", "rows_tau", "rows_q", "rows_v")

# Rows of a rollout, up to which their room is kept for the next one.
_ROWS_KEPT = 10_000

Torque = Callable[[float], None]


def joint_constraints(guards: Sequence[Guard]) -> tuple[np.ndarray, np.ndarray]:
    """Position limits and dry friction of joints, as `impulses` takes them: (nj, JOINT_INTS) int and (nj, 2)."""
    ints: list[tuple[int, int, int, int]] = []
    reals: list[tuple[float, float]] = []
    for g, guard in enumerate(guards):
        if guard.dry:
            ints.append((DRY_FRICTION, guard.index_q, guard.index_v, g))
            reals.append((0.5 * (guard.high_force - guard.low_force), 0.5 * (guard.high_force + guard.low_force)))
        for which, limit in ((LOWER_LIMIT, guard.low_end), (UPPER_LIMIT, guard.high_end)):
            if math.isfinite(limit):
                ints.append((which, guard.index_q, guard.index_v, g))
                reals.append((limit, 0.0))
    return np.array(ints, dtype=np.int64).reshape(-1, JOINT_INTS), np.array(reals).reshape(-1, 2)


class _Rows:
    """Rows of torques, q and v, and where they are: to ask for an address takes as long as to copy many rows."""

    def __init__(self, n: int, nq: int, nv: int) -> None:
        self.tau, self.q, self.v = np.empty((n, nv)), np.empty((n, nq)), np.empty((n, nv))
        self.arrays = {"rows_tau": self.tau, "rows_q": self.q, "rows_v": self.v}


class MoreauStep:
    """One system, with all guards of its model, that goes forward by steps of Moreau's method.

    The state at the step's start is `system.state`; `attempt` leaves the new one in `system.stage_state`, and may be
    called again with another size; `accept` makes it the start. Arrays (views, world axes, one row a contact):
    forces (nc, 3): mean force over the last step on the contour named second, N; torques (nc, 3): what resisted its
    spinning and rolling, N m;
    touch_time, edge_time (nc,): s after the step's start at which a contact closed, or opened at the end of a contour,
    negative where it did not.
    """

    def __init__(self, system: System, contacts: Sequence[Contact]) -> None:
        # these kernels are compiled for those who use them
        compile_kernels(friction=True, several=True, stepping=True)
        self.system = system
        self._viscous = bool((system.contact_real[: system.nc, VISCOUS] > 0.0).any())
        joint_int, joint_real = joint_constraints(system.guards)
        self.joints = len(joint_int)
        laws = [contact.friction for contact in contacts if contact.friction is not None]
        turns = sum((law.spinning > 0.0) + (law.rolling > 0.0) for law in laws)
        self.resists_turning = turns > 0
        # whether forces act on joints that are neither torques nor contact forces
        self.acts_on_joints = self.joints > 0 or self.resists_turning
        self.step_arrays = arrays = step_workspace(
            system.nq, system.nv, system.nc, system.ng, self.joints, turns, int(system.sizes["nblocks"])
        )
        arrays.joint_int[: self.joints], arrays.joint_real[: self.joints] = joint_int, joint_real
        for c, contact in enumerate(contacts):
            arrays.restitution[c] = contact.restitution
            arrays.sticking[c] = 0.0 if contact.friction is None else contact.friction.sticking
            arrays.orientation[c] = -1.0 if contact.swapped else 1.0
        self.solver = ContactSolver(stages=_SEARCHES, quick=True)
        self.forces = arrays.forces[: system.nc]
        self.torques = arrays.torques[: system.nc]
        self.touch_time = arrays.touch_time[: system.nc]
        self.edge_time = arrays.edge_time[: system.nc]
        self.start_mode = arrays.start_mode[: system.nc]
        self.joint_impulse = arrays.joint_impulse[: system.nv]
        self._counts, self._numbers = arrays.counts, arrays.numbers
        self._rows: _Rows | None = None
        self._looks = OpenContacts(system).watches()
        self._problems: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        arrays.calls[: len(_CALLED)] = [kernel_address(entry) for entry in _CALLED]
        arrays.calls[CALL_FAILED] = id(False)
        arrays.numbers[CONE_TOLERANCE], arrays.counts[CONE_TASK] = self.solver.tolerance, self.solver.task
        arrays.keep()
        self._begin_anew()

    def _begin_anew(self) -> None:
        system = self.system
        self.softened = self.settled = self._left = 0
        # by how much the radii of friction were off in settled steps, relative to the largest
        self.settled_off = 0.0
        self.open = OpenContacts(system)
        self._asked: tuple[Callable[[], bool], tuple[()]] | None = None
        self._share_tables()
        if self._viscous:
            # the mass matrix with viscous friction couples branches of the tree
            system.parents[:] = np.arange(max(system.nv, 1)) - 1

    def choose(self, contact_solver: str) -> None:
        """How contact problems are solved, see `ContactSolver.choose`."""
        self.solver.choose(contact_solver)
        self._counts[CONE_TASK] = self.solver.task

    def renew(self) -> None:
        """Be as new, for a system that is as new: buffers are kept, nothing in them matters."""
        self.step_arrays.restore()
        self.solver.renew()
        self._begin_anew()

    # ---------------------------------------------------------------- steps

    def ask(self, torque: Torque | None) -> None:
        """Set the function that sets `system.tau` for the system's (q, v) at the middle of every step, and for every
        output: torque(t). None for constant torques."""
        # kept alive here: the kernels know the addresses only
        self._asked = None
        calls = self.step_arrays.calls
        # one by one: several at once take many times as long
        calls[ASKED] = calls[ASKED_WITH] = 0
        if torque is None:
            return
        self.system.asks = True
        self._asked = self.system.callback_of(torque), ()
        calls[ASKED], calls[ASKED_WITH] = (id(part) for part in self._asked)

    def _run(self, task: int, t: float = 0.0, h: float = 0.0, found: int = FRESH) -> int:
        """A task of `run_steps`, with the cone problems that it leaves. Raises what `System.check_callbacks` does."""
        result = run_steps(self.system.address, self.step_arrays.address, task, found, t, h)
        while result == CONE_LEFT:
            solved = self._solve(int(self._counts[UNITS]), bool(self._counts[THOROUGH]))
            result = run_steps(
                self.system.address, self.step_arrays.address, task, SOLVED if solved else UNSOLVED, t, h
            )
        if self.system.asks:
            self.system.check_callbacks()
        return result

    def begin(self, t: float) -> int:
        """Start from `system.state`; closed contacts get the mode that their v_c shows. Returns a status."""
        self.open.forget_way()
        return self._run(BEGIN, t)

    def attempt(self, t: float, h: float) -> int:
        """A step of size h from the start at t; returns a status of `layout`."""
        return self._run(ATTEMPT, t, h)

    def accept(self, t: float) -> None:
        """The attempted state becomes the start; t is its time."""
        self._run(ACCEPT, t)

    def set_run(self, start: float, end: float, size: float, count: int, limit: int, watched: bool) -> None:
        """What `step` and `march` go by: count steps of a size in s, the last of which ends at the end, but not more
        than the limit; watched: every step is looked at before it is accepted."""
        numbers, counts = self._numbers, self._counts
        numbers[RUN_START], numbers[RUN_END], numbers[STEP_SIZE] = start, end, size
        counts[STEPS], counts[LAST], counts[STEP_LIMIT] = 0, count, limit
        counts[WATCHED], counts[TURNS] = watched, self.resists_turning

    def advance(self, count: int) -> int:
        """So many steps of the run, accepted; returns a status of `layout`: where that is not OK, of the step after the
        last accepted one."""
        counts, last = self._counts, self._counts.item(STEPS) + count
        counts[LAST] = last
        status = MARCHING
        while status == MARCHING or counts.item(STEPS) < last:
            if self._looks:
                # what opens in a step is looked at before the next one
                steps = self.look() if FREE in self.system.modes.tolist() else 1
                if steps == 0:
                    return FLIES_THROUGH
                counts[LAST] = min(last, counts.item(STEPS) + steps)
            status = self._run(STEP)
            if status not in (OK, MARCHING):
                break
        return status

    def advance_by_rows(self, tau: np.ndarray, count: int) -> tuple[int, np.ndarray, np.ndarray]:
        """So many steps under the torques in each row of tau (n, nv), n at least 1; returns a status as `advance` does,
        and q (m, nq) and v (m, nv) after every row that was finished."""
        system, counts, n = self.system, self._counts, len(tau)
        rows = self._rows
        if rows is None or n > len(rows.q):
            rows = _Rows(n, system.nq, system.nv)
            self._rows = rows if n <= _ROWS_KEPT else None
        if self._looks:
            return self._advance_row_by_row(tau, count, rows)
        rows.tau[:n] = tau
        for name, array in rows.arrays.items():
            self.step_arrays.put(name, array)
        counts[ROW_COUNT], counts[ROWS_DONE], counts[ROW_STEPS] = n, 0, count
        system.tau[:] = tau[0]
        try:
            status = self.advance(count)
        finally:
            counts[ROW_COUNT] = 0
        done = counts.item(ROWS_DONE)
        return status, rows.q[:done].copy(), rows.v[:done].copy()

    def _advance_row_by_row(self, tau: np.ndarray, count: int, rows: _Rows) -> tuple[int, np.ndarray, np.ndarray]:
        """`advance_by_rows` with looks at open contacts in between."""
        nq, nv = self.system.nq, self.system.nv
        status, done = OK, 0
        for row in tau:
            self.system.tau[:] = row
            status = self.advance(count)
            if status != OK:
                break
            rows.q[done], rows.v[done] = self.system.state[:nq], self.system.state[nq : nq + nv]
            done += 1
        return status, rows.q[:done].copy(), rows.v[:done].copy()

    def limit(self, most: int, ahead: int) -> None:
        """Let `march` stop after so many steps of the run, and after so many from here."""
        self._counts[STEP_LIMIT] = min(most, self.steps + ahead)

    def look(self) -> int:
        """How many steps of the run may be taken before open contacts are looked at again: all, where there are none
        that may be elsewhere; none, where a step may go through what is there."""
        if not (self._looks and FREE in self.system.modes.tolist()):
            return MANY_STEPS
        size = self._numbers.item(STEP_SIZE)
        t = self._numbers.item(RUN_START) + self.steps * size
        steps = self.open.look(t, size, self.touch_time >= 0.0)
        if self.open.has_moved:
            self.open.has_moved = False
            self._take_locations(t)
        return steps

    def flew_through(self, t: float) -> bool:
        """Whether the last step, which ended at t, carried an open contact through what was near, unnoticed."""
        return self._looks and self.open.went_through(t, self.size, self.touch_time >= 0.0)

    def _take_locations(self, t: float) -> None:
        """Start the next step with locations that others have set in `system.state`."""
        system, arrays = self.system, self.step_arrays
        system.stage_state[:] = system.state
        load_state(system.address)
        system.evaluate_kinematics(t)
        for c in range(system.nc):
            if system.modes[c] != FREE:
                continue
            arrays.start_location[c], arrays.start_rates[c] = system.location[c], system.rates[c]
            arrays.start_gap[c], arrays.start_slip[c] = system.gaps[c, 0], system.slip[c]
            arrays.start_normal[c] = system.basis[c, [2, 1]] @ system.slip[c]
            domain = system.contact_real[c, DOMAIN]
            arrays.start_domain[c], arrays.behind[c] = domain, domain < 0.0 > system.gaps[c, 0]
            known = arrays.known[c]
            known[:CONTACT_INTS], known[CONTACT_INTS:] = (
                system.contact_int[c],
                system.side_int[2 * c : 2 * c + 2, CHART],
            )

    def march(self, approved: bool = False) -> int:
        """Steps and outputs until something is to be done here: see `run_steps`; approved: beginning with the attempted
        step."""
        return self._run(MARCH, found=APPROVED if approved else FRESH)

    @property
    def steps(self) -> int:
        """Accepted steps of the run."""
        return self._counts.item(STEPS)

    @steps.setter
    def steps(self, number: int) -> None:
        self._counts[STEPS] = number

    @property
    def changed(self) -> bool:
        """Whether any mode, sign or chart is another than before the last accepted step."""
        return bool(self._counts.item(CHANGED))

    @property
    def known(self) -> tuple[np.ndarray, np.ndarray]:
        """Integers (nc, CONTACT_INTS) and charts (nc, 2) of contacts after the last accepted step; views."""
        known = self.step_arrays.known[: self.system.nc]
        return known[:, :CONTACT_INTS], known[:, CONTACT_INTS:]

    # ---------------------------------------------------------------- cone problems

    def _solve(self, n: int, thorough: bool) -> bool:
        """Solve the assembled problem of n units; its solution is where `advance` looks for it."""
        problem = self._problems.get(n)
        if problem is None:
            arrays = self.step_arrays
            problem = self._problems[n] = (
                arrays.delassus[: 9 * n * n].reshape(3 * n, 3 * n),
                arrays.loads[: 3 * n],
                arrays.friction[:n],
            )
        solver, counts = self.solver, self._counts
        if counts[HOLDING] == WANTED:
            self._hold(n, *problem)
            counts[HOLDING] = LOOKED_FOR
            self._hand_over(n)
            return True
        if counts[CHOOSING]:
            self._choose(n, *problem)
            self._hand_over(n)
            return True
        self._left += 1
        solved, touched = False, bool(counts[TOUCHED])
        if counts[COUPLED] == APART:
            if self.step_arrays.cone_tables[n]:
                # the usual path has been tried
                solved = solver.search(*problem, afresh=touched)
            else:
                solved = solver.solve(*problem, afresh=touched)
                self._share_tables()
            solved = solved or self._stay(n, *problem)
            if not solved and np.isin(self.step_arrays.unit_int[:n, UNIT_KIND], (ON_LOADED, ON_TURN)).any():
                counts[COUPLED] = TOGETHER
        if not solved and counts[COUPLED] != APART:
            solved = self._solve_together(n, *problem)
        if not solved and not (thorough and self._solve_hard(n, *problem)):
            return False
        self._numbers[CONE_RESIDUAL] = max(self._numbers[CONE_RESIDUAL], solver.residual)
        self._hand_over(n)
        return True

    def _hand_over(self, n: int) -> None:
        """Put the solver's solution for n units where the compiled steps read it."""
        solver, arrays = self.solver, self.step_arrays
        arrays.cone_forces[: 3 * n], arrays.cone_velocities[: 3 * n] = solver.forces, solver.velocities
        arrays.cone_modes[:n] = solver.modes

    def _units(
        self,
        n: int,
        delassus: np.ndarray,
        b: np.ndarray,
        mu: np.ndarray,
        modes: np.ndarray,
        forces: np.ndarray,
        velocities: np.ndarray,
    ) -> Units:
        """The problem, with modes (n,), forces and velocities (3n,), for those that choose among redundant forces."""
        ints = self.step_arrays.unit_int[:n]
        real = ints[:, ROW_MASK, None] >> np.arange(3) & 1 != 0
        turns = ints[:, UNIT_KIND] == ON_TURN
        parents = np.where(real[:, 2], np.arange(n), np.where(turns, ints[:, PARENT], -1))
        loads, directions = self.step_arrays.unit_real[:n, UNIT_LOAD], self.step_arrays.whitened[: 3 * n]
        pairs = forces.reshape(-1, 3), velocities.reshape(-1, 3)
        return Units(delassus, b, mu, directions, real, parents, loads, modes, *pairs)

    def _hold(self, n: int, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> None:
        """Replace a solution that lets go what was at rest by one that does not, if there is one."""
        solver = self.solver
        solver.address(n)
        held = self.step_arrays.unit_int[:n, HELD] != 0
        before = solver.kept()
        # what is to carry nothing in slip may be needed to hold
        for closed in (SLIPS, OPENS) if (held & (before[0] == OPENS)).any() else (SLIPS,):
            modes = np.where(held & ((before[0] == SLIPS) | (before[0] == closed)), STICKS, before[0])
            if self._holds(n, delassus, b, mu, modes, before, held):
                return
        solver.warm_start(*before)

    def _stay(self, n: int, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Let all units stay at rest, where all were and the searches have found nothing."""
        ints = self.step_arrays.unit_int[:n]
        if (ints[:, UNIT_KIND] != ON_CONTACT).any():
            return False
        if not np.isin(self.start_mode[ints[:, UNIT_INDEX]], (STICK, FRICTIONLESS)).all():
            return False
        modes, nothing = np.where(mu > 0.0, STICKS, SLIPS), np.zeros(3 * n)
        return self._holds(n, delassus, b, mu, modes, (modes, nothing, nothing), mu > 0.0)

    def _holds(
        self,
        n: int,
        delassus: np.ndarray,
        b: np.ndarray,
        mu: np.ndarray,
        modes: np.ndarray,
        before: tuple[np.ndarray, np.ndarray, np.ndarray],
        held: np.ndarray,
    ) -> bool:
        """Whether there are forces in these modes (n,), which are the solver's then; held (n,): what must not slip."""
        solver = self.solver
        found = holding_forces(self._units(n, delassus, b, mu, modes, *before[1:]))
        if found is None:
            return False
        velocities = delassus @ found + b
        velocities[np.repeat(modes == STICKS, 3)] = 0.0
        solver.warm_start(modes, found, velocities)
        solver.residual = solve_cones(delassus, b, mu, solver.address(n), NEAR, WARM_PASSES, solver.tolerance, 0, 1)
        return solver.residual <= solver.tolerance and not (held & (solver.modes == SLIPS)).any()

    def _choose(self, n: int, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> None:
        """Replace redundant forces that depend on the last ones by those that the rule has."""
        solver = self.solver
        address = solver.address(n)
        before = solver.kept()
        found = chosen_forces(self._units(n, delassus, b, mu, *before))
        if found is None:
            return
        solver.warm_start(before[0], found, delassus @ found + b)
        residual = solve_cones(delassus, b, mu, address, NEAR, WARM_PASSES, solver.tolerance, 0, 1)
        if not residual <= solver.tolerance:
            solver.warm_start(*before)

    def _share_tables(self) -> None:
        """Let compiled steps know where the solver works."""
        for size, address in self.solver.addresses():
            if size < self.step_arrays.cone_tables.size:
                self.step_arrays.cone_tables[size] = address

    @property
    def cone_problems(self) -> int:
        """How many there have been."""
        return self._left + int(self._counts[SOLVED_HERE])

    @property
    def decided(self) -> dict[str, int]:
        """How many of them were solved by which stage of the solver."""
        return self.solver.decided

    @property
    def rigid(self) -> int:
        """Steps whose problem had a solution in rigid geometry only."""
        return int(self._counts[RIGID_STEPS])

    @property
    def open_loads(self) -> int:
        """Problems in which rigid bodies leave open how redundant contacts share loads on which the motion depends."""
        return int(self._counts[OPEN_LOADS])

    @property
    def worst_residual(self) -> float:
        """The largest residual of any cone problem."""
        return float(self._numbers[CONE_RESIDUAL])

    def _solve_hard(self, n: int, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """What the quick searches did not solve: with a little compliance in the contacts, since with redundant ones b
        may be out of reach by a little; then without rebounds, and at length; then, with friction that goes with other
        loads, what has a solution unless bodies are crushed.

        (Several points of a body that must not slip, of which one rebounds, are an example.)
        """
        solver, together = self.solver, self._counts[COUPLED] != APART
        if not together and self._solve_softened(delassus, b, mu):
            return True
        b[2::3] += self._numbers[KEPT] * self.step_arrays.unit_real[:n, SHIFT]
        self._numbers[KEPT] = self._numbers[KEPT_LOW] = self._numbers[KEPT_HIGH] = 0.0
        if not together:
            solver.quick = False
            found = solver.solve(delassus, b, mu)
            solver.quick = True
            if found:
                return True
        self._counts[COUPLED] = TOGETHER
        return self._solve_together(n, delassus, b, mu) or self._settle(n, delassus, b, mu)

    def _solve_softened(self, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """The solution with the least compliance that gives one."""
        solver = self.solver
        diagonal = np.einsum("ii->i", delassus)
        stiff = diagonal.copy()
        unit = np.repeat(stiff.reshape(-1, 3).mean(axis=1), 3)
        largest = _LARGEST_FORCE * float(np.abs(b).max())
        for share in _COMPLIANCES:
            diagonal[:] = stiff + share * unit
            if solver.solve(delassus, b, mu):
                # contacts that wedge each other are held by next to nothing but the compliance
                if float((unit * np.abs(solver.forces)).max()) <= largest:
                    self.softened += 1
                    return True
                solver.forget()
        diagonal[:] = stiff
        return False

    def _product(self, n: int, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> Product:
        """The problem with the loads that it takes as given as functions of the forces."""
        arrays, counts = self.step_arrays, self._counts
        ints, numbers = arrays.unit_int[:n], arrays.unit_real[:n]
        masks = ints[:, ROW_MASK]
        load, slope = np.zeros((n, 2)), np.zeros((n, 2, 3 * n))
        # impulses of equations: share - overlap^T F, carried back to their rows
        e, size = int(counts[NEQ]), arrays.equation_factor.shape[0]
        index = arrays.equation_index[:e]
        known = np.c_[arrays.equation_share[:e], -arrays.overlap.reshape(-1, size)[: 3 * n, :e].T]
        factor = np.tril(arrays.equation_factor[:e, :e])
        # of redundant ones the least, as in `impulse_review`
        says = factor.diagonal() > 0.0
        root = np.sqrt(arrays.equation_unit[:e]) if not says.all() else np.ones(e)
        impulses = np.linalg.pinv((factor[:, says] / root[:, None]).T) @ known[says] / root[:, None]
        for u, (kind, c, parent) in enumerate(ints[:, [UNIT_KIND, UNIT_INDEX, PARENT]].tolist()):
            if masks[u] & 4:
                slope[u, 0, 3 * u + 2] = 1.0
            elif kind == ON_TURN and parent >= 0:
                slope[u, 0, 3 * parent + 2] = 1.0
            elif kind == ON_JOINT:
                load[u, 0] = numbers[u, UNIT_LOAD]
            else:
                rows = np.flatnonzero((index[:, 0] == c) & (index[:, 1] >= (2 if kind == ON_TURN else 0)))
                for k, row in enumerate(rows):
                    load[u, k], slope[u, k] = impulses[row, 0], impulses[row, 1:]
        base = np.where(np.stack([masks >> row & 1 for row in range(3)], axis=1).ravel() != 0, b, 0.0)
        normal, tangents = (masks >> 2 & 1).astype(float), ((masks & 1) + (masks >> 1 & 1)).astype(float)
        return Product(delassus, base, normal, tangents, mu.copy(), load.ravel(), slope.reshape(2 * n, 3 * n))

    def _solve_together(self, n: int, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Solve the problem for forces and loads at once."""
        product = self._product(n, delassus, b, mu)
        forces, residual = product.solve(self.solver.start(n))
        if not residual <= PRODUCT_TOLERANCE:
            self._nearest = forces
            return False
        chosen = chosen_forces(self._units(n, delassus, b, mu, product.modes(forces), forces, delassus @ forces + b))
        if chosen is not None:
            # what slides turns a little
            chosen, accuracy = product.refine(chosen)
            if accuracy <= PRODUCT_TOLERANCE:
                forces, residual = chosen, accuracy
        self._take(product, forces, residual)
        return True

    def _settle(self, n: int, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Solve it with friction that goes with the loads that came nearest to a solution."""
        product = self._product(n, delassus, b, mu)
        forces, residual, off = product.settle(self._nearest)
        # ideal rolling has no other friction to go with
        slips = np.abs((delassus @ forces + b).reshape(-1, 3)[:, :2]).max(axis=1)
        slipping = np.isinf(mu) & (forces[2::3] > 0.0) & (slips > SETTLED * np.abs(b).max(initial=0.0))
        if not residual <= SETTLED or slipping.any():
            return False
        self.settled += 1
        self.settled_off = max(self.settled_off, off)
        self._take(product, forces, residual)
        return True

    def _take(self, product: Product, forces: np.ndarray, residual: float) -> None:
        """Let the solver have these forces as its own."""
        modes, velocities = product.modes(forces), product.gram @ forces + product.base
        forces[2::3] = np.where(
            product.normal > 0.0, forces[2::3], product.radii(forces) / np.where(product.mu > 0.0, product.mu, 1.0)
        )
        self.solver.warm_start(modes, forces, velocities)
        self.solver.residual = residual

    def describe(self, status: int, t: float) -> Stop:
        """The Stop for a failed status, naming the contact and the number."""
        code, reason = FAILURES[status]
        where = number = ""
        if status == CONTRADICTION:
            reason = contradiction(self.system, t + float(self._numbers[H])) or reason
        system = self.system
        if status in (SINGULAR, LOCATION_FAILED) and system.nc:
            c = int(np.argmin(np.abs(system.contact_real[: system.nc, CONDITION])))
            where = f"contact {system.contacts[c].name!r} ({system.contacts[c].pattern.name}): "
            number = f"; conditioning of J {abs(system.contact_real[c, CONDITION]):.3g}"
        elif status == CONTOUR_ENDS:
            where = f"contact {system.contacts[self.nearest_end()].name!r} "
        elif status == FLIES_THROUGH:
            where = f"contact {system.contacts[self.open.hasty].name!r}: "
        elif status == CLOSED_APART:
            gaps = np.where(system.modes != FREE, np.abs(system.gaps[: system.nc, 0]), 0.0)
            c = int(np.argmax(gaps))
            where, number = f"contact {system.contacts[c].name!r}: ", f" by {gaps[c]:.3g} m"
        elif status == NO_FORCE:
            ints = self.step_arrays.unit_int[: int(self._counts[UNITS])]
            contacts = dict.fromkeys(ints[ints[:, UNIT_KIND] != ON_JOINT, UNIT_INDEX].tolist())
            number = f" at {', '.join(repr(system.contacts[c].name) for c in contacts)}" if contacts else ""
            number += f"; relative residual {self.solver.residual:.3g}"
        h, fastest = (
            float(self._numbers[H]),
            float(np.abs(system.state[system.nq : system.nq + system.nv]).max(initial=0.0)),
        )
        if status == TOO_LONG and self._asked is not None and h * fastest < _TURNS_FAR:
            reason = (
                f"the control is too stiff for steps of {h:.6g} s: the velocity at the middle of a step, which its "
                "torques depend on, does not settle"
            )
        if h * fastest > _RUNAWAY:
            # as where a control is too stiff for the step: other reasons are consequences
            number += f"; a coordinate moves by {h * fastest:.3g} (rad or m) in a step of {h:.6g} s: it may be too long"
        return Stop(code, f"t = {t:.9g} s: {where}{reason}{number}")

    def nearest_end(self) -> int:
        """Of the contacts that cannot open the one nearest to the end of a contour, or furthest beyond it."""
        system = self.system
        bilateral = system.contact_int[: system.nc, UNILATERAL] == 0
        return int(np.argmin(np.where(bilateral, system.contact_real[: system.nc, DOMAIN], math.inf)))

    @property
    def size(self) -> float:
        """Size in s of the last attempt."""
        return float(self._numbers[H])

    @property
    def joint_force(self) -> np.ndarray:
        """(nv,) mean force over the last step of joint limits, dry friction, and what resists spinning and rolling."""
        return self.joint_impulse / self._numbers[H] if self._numbers[H] > 0.0 else np.zeros_like(self.joint_impulse)

    # ---------------------------------------------------------------- copies

    def copy_to(self, other: MoreauStep) -> None:
        """Give the step of an equal system all that the next step depends on, warm starts of the solver included."""
        for name in self.step_arrays.layout.arrays:
            if name not in _OWN:
                getattr(other.step_arrays, name)[...] = getattr(self.step_arrays, name)
        mine, its = self.system, other.system
        for name in ("state", "stage_state", "q", "v", "tau", "location", "contact_int", "contact_real"):
            getattr(its, name)[...] = getattr(mine, name)
        its.side_int[:, CHART] = mine.side_int[:, CHART]
        other.solver.forget()
        for solution in self.solver.warm_starts():
            other.solver.warm_start(*solution)
        other._share_tables()

    def forget(self) -> None:
        """Let the next step depend on the state alone."""
        self.solver.forget()


class MoreauDriver:
    """A run of constant steps, with outputs and users' events.

    record(t): called for outputs outside compiled steps, with the state in the system. flush(): makes room for rows
    that compiled steps write. torque: see `MoreauStep.ask`; progress(t): called now and then, or None.
    t_eval: output times in s, None for every step. breakpoints: times in s, in order within the run, at which steps
    end.
    """

    def __init__(
        self,
        step: MoreauStep,
        users: list[UserEvent],
        record: Callable[[float], None],
        flush: Callable[[], None],
        size: float,
        t_eval: np.ndarray | None,
        max_steps: int,
        torque: Torque | None,
        progress: Callable[[float], None] | None,
        breakpoints: Sequence[float] = (),
    ) -> None:
        self.breakpoints, self._earlier_steps = breakpoints, 0
        self.step, self.system, self.users = step, step.system, users
        self.record, self.flush, self.size, self.max_steps = record, flush, size, max_steps
        self.torque, self.progress = torque, progress
        self.events: list[Event] = []
        self.system.set_output_times(t_eval)

    def run(self, t: float, t_end: float) -> tuple[int, str]:
        """Step from t to t_end (s); returns a code of `results` and a message. Raises what users' functions do."""
        self.step.ask(self.torque)
        try:
            self._run(t, t_end)
        except Stop as stop:
            return stop.code, stop.message
        finally:
            # nothing of the user's is kept
            self.step.ask(None)
        return FINISHED, "the end of the interval was reached" + self._settled() + self._left_open()

    def _settled(self) -> str:
        """What is to be said of problems that had no solution, or none that was found."""
        count = self.step.settled
        if count == 0:
            return ""
        off = f"off by up to {self.step.settled_off:.2g} of the largest"
        return f"; {count} cone problems were settled with the friction of other loads, {off}"

    def _left_open(self) -> str:
        """What is to be said of loads on which the motion depends, and of which more than one choice is right."""
        count = self.step.open_loads
        if count == 0:
            return ""
        return f"; in {count} cone problems rigid bodies leave open how redundant contacts share loads while some slide"

    def _run(self, start: float, end: float) -> None:
        step = self.step
        self._plan(start, end)
        self._check(step.begin(start), start)
        for event in self.users:
            event.value = event.value_at(start, self.system)
        self._output(start)
        for jump in self.breakpoints:
            # so much before it that no rounding of the step takes it for a whole one, and gets there
            self._run_until(start, max(start, jump - 2.0 * SLIVER * self.size))
            while self._next_output <= jump:
                self._record(self._next_output, asked=False)
                self.system.output_done()
            self._earlier_steps += step.steps
            step.steps = 0
            start = math.nextafter(jump, math.inf)
            before = self.system.modes.copy()
            self._check(step.begin(start), start)
            for c, contact in enumerate(self.system.contacts):
                if before[c] == STICK and self.system.contact_int[c, MODE] == SLIPPING:
                    self._announce(jump, contact.name, "slip")
        self._run_until(start, end)

    def _run_until(self, start: float, end: float) -> None:
        step, size, count = self.step, self.size, self._plan(start, end)
        most = self.max_steps - self._earlier_steps
        why = MARCHING
        while why != AT_END:
            self.flush()
            approved = why == ATTEMPTED
            ahead = 1 if approved else step.look()
            step.limit(most, ahead)
            why = step.march(approved)
            i = step.steps
            t, t_new = start + i * size, end if i >= count - 1 else start + (i + 1) * size
            if why == ATTEMPTED:
                self._user_events(t, t_new)
                self._report(t, t_new)
            elif why == OUTPUT_LEFT:
                self._output(end if i == count else t, asked=True)
            elif why == INNER_OUTPUT_LEFT:
                self._record(float(self._next_output), asked=True)
                self.system.output_done()
            elif why == AT_LIMIT and i >= most:
                raise Stop(AT_STEP_LIMIT, f"t = {t:.9g} s: the limit of {self.max_steps} steps was reached")
            elif why == CONTOUR_ENDS:
                raise self._end_of_contour(t, t + step.size)
            elif why == AT_LIMIT and ahead == 0:
                self._check(FLIES_THROUGH, t)
            elif why not in (MARCHING, AT_END, AT_LIMIT):
                self._check(why, t)
            if self.progress is not None:
                i = step.steps
                self.progress(end if i == count else start + i * size)
        if step.flew_through(end):
            self._check(FLIES_THROUGH, end)

    def _plan(self, start: float, end: float) -> int:
        """Prepare steps of constant size, the last of which ends at the end; returns how many there are."""
        size = self.size
        count = max(math.ceil((end - start) / size - SLIVER), 1) if end > start else 0
        self.step.set_run(start, end, size, count, self.max_steps - self._earlier_steps, bool(self.users))
        return count

    @property
    def steps(self) -> int:
        """Accepted steps so far."""
        return self._earlier_steps + self.step.steps

    def _check(self, status: int, t: float) -> None:
        if status != OK:
            if status in (SINGULAR, LOCATION_FAILED):
                self._announce(t, None, "singular")
            raise self.step.describe(status, t)

    def _attempt(self, t: float, t_new: float) -> None:
        h = t_new - t
        if abs(h - self.size) <= SLIVER * self.size:
            # not what rounding has made of it
            h = self.size
        status = self.step.attempt(t, h)
        if status == CONTOUR_ENDS:
            raise self._end_of_contour(t, t_new)
        self._check(status, t)

    def _end_of_contour(self, t: float, t_new: float) -> Stop:
        """Step from t to where a contact that cannot open reaches the end of a contour, which it does before t_new."""
        step = self.step
        name = self.system.contacts[step.nearest_end()].name
        inside, outside = t, t_new
        while outside - inside > _EVENT_ACCURACY * (t_new - t):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if step.attempt(t, middle - t) == OK else (inside, middle)
        if inside > t:
            self._attempt(t, inside)
            if self.users:
                self._user_events(t, inside)
            self._report(t, inside)
            step.accept(inside)
            step.steps += 1
        self._announce(inside, name, "edge")
        self._output(inside)
        return step.describe(CONTOUR_ENDS, inside)

    def _report(self, t: float, t_new: float) -> None:
        """What happened to the contacts in the attempted step."""
        step, names = self.step, [c.name for c in self.system.contacts]
        found: list[tuple[float, str, str]] = []
        for c, name in enumerate(names):
            before, after = int(step.start_mode[c]), int(self.system.contact_int[c, MODE])
            edge = float(step.edge_time[c])
            if step.touch_time[c] >= 0.0:
                found.append((t + float(step.touch_time[c]), name, "touch"))
            if edge >= 0.0:
                found.append((t + max(edge, float(step.touch_time[c])), name, "edge"))
            elif step.touch_time[c] >= 0.0:
                continue
            elif before != FREE and after == FREE:
                found.append((t_new, name, "separate"))
            elif before == STICK and after == SLIPPING:
                found.append((t_new, name, "slip"))
            elif before == SLIPPING and after == STICK:
                found.append((t_new, name, "stick"))
        for when, name, kind in sorted(found, key=lambda entry: entry[0]):
            self._announce(when, name, kind)

    def _announce(self, t: float, contact: str | None, kind: str, index: int = -1) -> None:
        self.events.append(Event(t, contact, kind, self.system.q.copy(), self.system.v.copy(), index))

    # ---------------------------------------------------------------- outputs

    @property
    def _next_output(self) -> float:
        return float(self.system.scalars["next_output"])

    def _output(self, t: float, asked: bool = False) -> None:
        """Record the state at t, once for every output time that falls on it; asked: torques are set for it."""
        if self.system.counters["record_steps"]:
            self._record(t, asked)
            return
        while self._next_output <= t + SLIVER * self.size:
            self._record(t, asked)
            self.system.output_done()

    def _record(self, t: float, asked: bool) -> None:
        if self.torque is not None and not asked:
            self.torque(t)
            self.system.check_torques(t)
        self.record(t)

    # ---------------------------------------------------------------- users' events

    def _user_events(self, t: float, t_new: float) -> None:
        """Locate the zeros of users' functions in the attempted step by shorter ones; a terminal one ends the run.

        Where to look is told by the functions on the straight way from the step's start to its end.
        """
        system, users = self.system, self.users
        nq, nv = system.nq, system.nv
        ends = [(state[:nq].copy(), state[nq : nq + nv].copy()) for state in (system.state, system.stage_state)]
        values = [event.value_at(t_new, system) for event in users]
        found: list[tuple[float, int]] = []
        looked = False
        for event, after in zip(users, values):
            on_the_way = self._cached(event, after, partial(self._value_between, event, ends, t, t_new))
            samples = with_dips(on_the_way, resolve(on_the_way, event.value, after))
            turns = sum((low < 0.0) != (high < 0.0) or high == 0.0 for (_, low), (_, high) in pairwise(samples))
            if turns == 0:
                continue
            looked = True
            stepped = self._cached(event, after, partial(self._value_after, event, t, t_new))
            # one zero lies between the ends; of several, those which shorter steps find there, too
            places = [0.0, 1.0] if turns == 1 and event.crosses(event.value, after) else [s for s, _ in samples]
            for low, high in pairwise(places):
                if event.crosses(stepped(low), stepped(high)):
                    found.append((t + self._root(stepped, low, high) * (t_new - t), event.index))
        for when, i in sorted(found):
            self._attempt(t, when)
            self._announce(when, None, "user", i)
            if users[i].terminal:
                self._report(t, when)
                self.step.accept(when)
                self.step.steps += 1
                if self.system.counters["record_steps"]:
                    self._output(when)
                raise Stop(TERMINATED, "a terminal event occurred")
        if looked:
            # shorter steps have taken its place
            self._attempt(t, t_new)
        for event, value in zip(users, values):
            event.value = value

    @staticmethod
    def _cached(event: UserEvent, after: float, value: Callable[[float], float]) -> Callable[[float], float]:
        """A function of fractions of a step, with the values that are known at both ends, asked once for each place."""
        known = {0.0: event.value, 1.0: after}

        def cached(place: float) -> float:
            if place not in known:
                known[place] = value(place)
            return known[place]

        return cached

    def _value_between(
        self, event: UserEvent, ends: list[tuple[np.ndarray, np.ndarray]], t: float, t_new: float, place: float
    ) -> float:
        (q0, v0), (q1, v1) = ends
        q = pin.interpolate(self.system.model, q0, q1, place)
        return event.value_of(t + place * (t_new - t), q, v0 + place * (v1 - v0), self.system)

    def _value_after(self, event: UserEvent, t: float, t_new: float, place: float) -> float:
        """After a step that is shorter by that factor."""
        when = t + place * (t_new - t)
        self._attempt(t, when)
        return event.value_at(when, self.system)

    @staticmethod
    def _root(value: Callable[[float], float], low: float, high: float) -> float:
        if value(high) == 0.0 or math.isinf(value(low)) or math.isinf(value(high)):
            return high
        return zero_between(value, low, high, _EVENT_ACCURACY)
