"""Time stepping with impulses (Moreau's midpoint method): for many contacts, impacts, accumulating bounces and jams.

Every step solves one cone problem in velocities and impulses, whatever happens within it; nothing is located and no
mode is kept. Second order in h while modes last, first order through their changes; see `impulses` for the equations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq

from ..dynamics.modes import ModeSolver, rest_mode
from ..dynamics.system import System
from ..errors import ContourError
from ..friction.solve import ContactSolver
from ..jit import compile_kernels
from ..layout import (
    CHART,
    CONDITION,
    EVENT,
    FREE,
    FRICTION_MARGIN,
    FROZEN,
    GUARD_END,
    LOCATION_FAILED,
    MODE,
    MU,
    NO_FORCE,
    NORMAL_MARGIN,
    NOT_FINITE,
    OK,
    SINGULAR,
    SLIP_SIGN,
    SLIPPING,
    STICK,
    TANGENTS,
    TOO_LONG,
    VISCOUS,
)
from ..memory import address_of
from .events import UserEvent
from .impulse_layout import (
    ACCELERATION,
    CONE_FORCES,
    CONE_MODES,
    CONE_VELOCITIES,
    DRY_FRICTION,
    HAS_TREND,
    JOINT_INTS,
    KEPT,
    KEPT_HIGH,
    KEPT_LOW,
    LOWER_LIMIT,
    MEAN_VELOCITY,
    MISS,
    RIGID,
    SHIFT,
    STEP_SLOTS,
    TOUCHED,
    UNITS,
    UPPER_LIMIT,
    H,
    step_memory,
)
from .impulse_problem import assemble
from .impulse_review import AGAIN
from .impulses import advance, commit, predict_midpoint
from .results import CONTROL_FAILED, FAILURES, FINISHED, STEP_LIMIT, TERMINATED, Event, Stop
from .stages import load_state, move_charts
from .steps import KINEMATICS, SETTLE, run_task

if TYPE_CHECKING:
    from ..contacts import Contact
    from ..dynamics.joints import Guard

DEFAULT_STEP = 1e-3

# Compliances relative to the contacts' own, tried in turn where the cone problem has no solution.
_COMPLIANCES = (1e-10, 1e-8, 1e-6, 1e-4)
# What such a solution's forces may be, as velocities, relative to the largest one in b.
_LARGEST_FORCE = 10.0
# A step is corrected where the velocity at its midpoint was off by this fraction, at most so many times; corrections
# that leave it off by the last have not converged.
_FAR = 0.005
_CORRECTIONS = 8
_LOST = 0.03
# How modes are looked for, quickly in every step, at length (milliseconds) where nothing else has helped; without the
# search whose linear algebra rounds differently with the alignment of memory.
_SEARCHES = ("sweeps", "path")
# Slip slower than this (m/s, relative to the largest velocity or 1) counts as rest where a run starts.
_REST = 1e-9
# Steps that end within this fraction of a step from the end, or from an output time, end there.
_SLIVER = 1e-9
# Accuracy of the time of a user's event, relative to the step.
_EVENT_ACCURACY = 1e-12

Torque = Callable[[float], bool]


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


class MoreauStep:
    """One system, with all guards of its model, that goes forward by steps of Moreau's method.

    The state at the step's start is `system.state`; `attempt` leaves the new one in `system.stage_state`, and may be
    called again with another size; `accept` makes it the start. Arrays (views, world axes, one row a contact):
    forces (nc, 3): mean force over the last step on the contour named second, N; torques (nc, 3): what resisted its
    spinning and rolling, N m;
    touch_time (nc,): s after the step's start at which a contact closed, negative where it did not.
    """

    def __init__(self, system: System, contacts: Sequence[Contact]) -> None:
        # these kernels are compiled for those who use them
        compile_kernels()
        self.system = system
        self._viscous = bool((system.contact_real[: system.nc, VISCOUS] > 0.0).any())
        joint_int, joint_real = joint_constraints(system.guards)
        self.joints = len(joint_int)
        laws = [contact.friction for contact in contacts if contact.friction is not None]
        turns = sum((law.spinning > 0.0) + (law.rolling > 0.0) for law in laws)
        self.resists_turning = turns > 0
        # whether forces act on joints that are neither torques nor contact forces
        self.acts_on_joints = self.joints > 0 or self.resists_turning
        self.memory = memory = step_memory(system.nq, system.nv, system.nc, system.ng, self.joints, turns)
        self.table = memory.table
        memory["joint_int"][: self.joints], memory["joint_real"][: self.joints] = joint_int, joint_real
        for c, contact in enumerate(contacts):
            memory["restitution"][c] = contact.restitution
            memory["sticking"][c] = 0.0 if contact.friction is None else contact.friction.sticking
            memory["orientation"][c] = -1.0 if contact.swapped else 1.0
        self.solver = ContactSolver(stages=_SEARCHES, quick=True)
        self.forces = memory["forces"][: system.nc]
        self.torques = memory["torques"][: system.nc]
        self.touch_time = memory["touch_time"][: system.nc]
        self.start_mode = memory["start_mode"][: system.nc]
        self.joint_impulse = memory["joint_impulse"][: system.nv]
        self._counts, self._numbers = memory["counts"], memory["numbers"]
        self._problems: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._solutions: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._charted = system.charted
        memory.keep()
        self._begin_anew()

    def _begin_anew(self) -> None:
        system = self.system
        self.cone_problems = self.rigid = self.softened = 0
        self.worst_residual = 0.0
        self._loaded = -1
        if self._viscous:
            # the mass matrix with viscous friction couples branches of the tree
            system.memory["parents"][:] = np.arange(max(system.nv, 1)) - 1

    def renew(self) -> None:
        """Be as new, for a system that is as new: buffers are kept, nothing in them matters."""
        self.memory.restore()
        self.solver.renew()
        self._solutions.clear()
        self._begin_anew()

    # ---------------------------------------------------------------- start

    def begin(self, t: float) -> int:
        """Start from `system.state`; closed contacts get the mode that their v_c shows. Returns a status."""
        system = self.system
        system.stage_state[:] = system.state
        load_state(system.table)
        status = system.evaluate_kinematics(t)
        if status != OK:
            return status
        rest_speed = _REST * max(1.0, float(np.abs(system.v).max(initial=0.0)))
        for c in system.closed():
            ints, mu = system.contact_int[c], system.contact_real[c, MU]
            along = system.basis[c] @ system.slip[c]
            speed = abs(along[0]) if ints[TANGENTS] == 1 else math.hypot(along[0], along[1])
            ints[FROZEN] = 0
            ints[MODE] = SLIPPING if speed > rest_speed and 0.0 < mu < math.inf else rest_mode(mu)
            ints[SLIP_SIGN] = 1 if along[0] >= 0.0 else -1
        # joints at their stops are found by the first step
        system.contact_int[system.nc : system.nc + system.ng, MODE] = FREE
        system.guard_int[:, GUARD_END] = 0
        self.memory["load"][:] = 0.0
        self.forces[:] = 0.0
        self.torques[:] = 0.0
        self.joint_impulse[:] = 0.0
        self.touch_time[:] = -1.0
        self._counts[TOUCHED] = 0
        commit(system.table, self.table, 0)
        return OK

    # ---------------------------------------------------------------- one step

    def attempt(self, t: float, h: float, torque: Torque | None = None) -> int:
        """A step of size h from the start at t; returns a status of `layout`.

        torque(t + h / 2): sets `system.tau` for the system's (q, v); False, which returns NOT_FINITE, where it fails.
        """
        system, counts = self.system, self._counts
        self._numbers[H] = h
        known = int(counts[HAS_TREND])
        status = self._advance(t, h, torque)
        if status == OK and (counts[TOUCHED] or not known):
            # The step is taken again with what it tells: the mean velocity where impacts change it, else, where there
            # is no last step to tell it, the acceleration.
            nq, nv = system.nq, system.nv
            counts[HAS_TREND] = MEAN_VELOCITY
            if not counts[TOUCHED]:
                self.memory["trend"][:nv] = (system.stage_state[nq : nq + nv] - self.memory["start_v"][:nv]) / h
                counts[HAS_TREND] = ACCELERATION
            status = self._advance(t, h, torque)
        # A step in which bodies turn far is taken again with its own mean velocity: the implicit midpoint rule, which
        # stays stable where the velocity foretold from the last step does not.
        for _ in range(_CORRECTIONS):
            if status != OK or counts[TOUCHED] or not self._numbers[MISS] > _FAR:
                break
            counts[HAS_TREND] = MEAN_VELOCITY
            status = self._advance(t, h, torque)
            if status in (LOCATION_FAILED, SINGULAR):
                status = TOO_LONG
        else:
            if status == OK and self._numbers[MISS] > _LOST:
                status = TOO_LONG
        counts[HAS_TREND] = known
        return status if status != OK else run_task(system.table, SETTLE, t + h, 0.0)

    def _advance(self, t: float, h: float, torque: Torque | None) -> int:
        """Midpoint, cone problem, end of the step."""
        table = self.system.table
        predict_midpoint(table, self.table)
        middle = t + 0.5 * h
        if torque is not None and not torque(middle):
            return NOT_FINITE
        status = run_task(table, KINEMATICS, middle, 0.0)
        if status != OK:
            return status
        self._counts[RIGID] = 0
        status = self._impulses()
        if status == NO_FORCE and not self._counts[RIGID]:
            # redundant contacts may contradict each other by what only rigid geometry leaves out
            self._counts[RIGID] = 1
            self.rigid += 1
            status = self._impulses()
        return self._impulses(thorough=True) if status == NO_FORCE else status

    def _impulses(self, thorough: bool = False) -> int:
        """Cone problem and end of the step. thorough: with compliance, and with all means of the solver."""
        table = self.system.table
        status = assemble(table, self.table)
        if status != OK:
            return status
        n = int(self._counts[UNITS])
        while True:
            if n and not self._solve(n, thorough):
                return NO_FORCE
            status = advance(table, self.table)
            if status != AGAIN:
                return status

    def _solve(self, n: int, thorough: bool) -> bool:
        """Solve the assembled problem of n units; its solution is where `advance` looks for it."""
        problem = self._problems.get(n)
        if problem is None:
            memory = self.memory
            problem = self._problems[n] = (
                memory["delassus"][: 9 * n * n].reshape(3 * n, 3 * n),
                memory["loads"][: 3 * n],
                memory["friction"][:n],
            )
        self.cone_problems += 1
        solver = self.solver
        if not solver.solve(*problem) and not (thorough and self._solve_hard(n, *problem)):
            return False
        if solver.residual > self.worst_residual:
            self.worst_residual = solver.residual
        if self._loaded != n:
            # each size has buffers of its own
            self._solutions[n] = solver.modes, solver.forces, solver.velocities
            self.table[CONE_FORCES] = address_of(solver.forces)
            self.table[CONE_VELOCITIES] = address_of(solver.velocities)
            self.table[CONE_MODES] = address_of(solver.modes)
            self._loaded = n
        return True

    def _solve_hard(self, n: int, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """What the quick searches did not solve: with a little compliance in the contacts, since with redundant ones b
        may be out of reach by a little; then without rebounds, and at length.

        (Several points of a body that must not slip, of which one rebounds, are an example.)
        """
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
        b[2::3] += self._numbers[KEPT] * self.memory["unit_real"][:n, SHIFT]
        self._numbers[KEPT] = self._numbers[KEPT_LOW] = self._numbers[KEPT_HIGH] = 0.0
        solver.quick = False
        found = solver.solve(delassus, b, mu)
        solver.quick = True
        return found

    def accept(self, t: float) -> bool:
        """The attempted state becomes the start; t is its time. Whether any mode, sign or chart is another now."""
        system = self.system
        changed = commit(system.table, self.table, 1)
        if self._charted and move_charts(system.table):
            system.stage_state[:] = system.state
            load_state(system.table)
            system.evaluate_kinematics(t)
            changed = commit(system.table, self.table, 0)
        return changed

    @contextmanager
    def modes_of_output(self, t: float) -> Iterator[None]:
        """Modes that hold at the end of the step, for what is recorded of it.

        A contact at rest may be about to slip, or have come to rest only to slip on, the other way: held there, its
        force would lie outside its cone. It slips with the force that friction has in the direction it takes. One that
        is about to open would pull: it is open, or slides held up by friction alone.
        """
        system = self.system
        held = [c for c in system.closed() if system.contact_int[c, MODE] == STICK]
        kept = None
        if held and system.evaluate(t) <= EVENT:
            modes = ModeSolver(system)
            margins = system.margins[held][:, [NORMAL_MARGIN, FRICTION_MARGIN]]
            if (margins < -modes.force_round_off()).any():
                kept = system.contact_int.copy(), system.contact_real.copy()
                if modes.decide(t, held, system.evaluate).status > EVENT:
                    system.contact_int[:], system.contact_real[:] = kept
        yield
        if kept is not None:
            # a choice of redundant forces stays: it serves the next output, too
            system.contact_int[:], system.contact_real[:] = kept

    def describe(self, status: int, t: float) -> Stop:
        """The Stop for a failed status, naming the contact and the number."""
        code, reason = FAILURES[status]
        where = number = ""
        system = self.system
        if status in (SINGULAR, LOCATION_FAILED) and system.nc:
            c = int(np.argmin(np.abs(system.contact_real[: system.nc, CONDITION])))
            where = f"contact {system.contacts[c].name!r} ({system.contacts[c].pattern.name}): "
            number = f"; conditioning of J {abs(system.contact_real[c, CONDITION]):.3g}"
        elif status == NO_FORCE:
            number = f"; relative residual {self.solver.residual:.3g}"
        return Stop(code, f"t = {t:.9g} s: {where}{reason}{number}")

    @property
    def joint_force(self) -> np.ndarray:
        """(nv,) mean force over the last step of joint limits, dry friction, and what resists spinning and rolling."""
        return self.joint_impulse / self._numbers[H] if self._numbers[H] > 0.0 else np.zeros_like(self.joint_impulse)

    # ---------------------------------------------------------------- copies

    def copy_to(self, other: MoreauStep) -> None:
        """Give the step of an equal system all that the next step depends on, warm starts of the solver included."""
        for name in STEP_SLOTS:
            other.memory[name][...] = self.memory[name]
        mine, its = self.system, other.system
        for name in ("state", "stage_state", "q", "v", "tau", "location", "contact_int", "contact_real"):
            getattr(its, name)[...] = getattr(mine, name)
        its.side_int[:, CHART] = mine.side_int[:, CHART]
        for solution in self._solutions.values():
            other.solver.warm_start(*solution)

    def forget(self) -> None:
        """Let the next step depend on the state alone."""
        self.solver.forget()
        self._solutions.clear()
        self._loaded = -1


class MoreauDriver:
    """A run of constant steps, with outputs and users' events.

    record(t): called for every output with the state in the system. torque and failed_control: see `simulate`;
    progress(t): called after every step, or None. t_eval: output times in s, None for every step.
    """

    def __init__(
        self,
        step: MoreauStep,
        users: list[UserEvent],
        record: Callable[[float], None],
        size: float,
        t_eval: np.ndarray | None,
        max_steps: int,
        torque: Torque | None,
        failed_control: Callable[[float], None],
        progress: Callable[[float], None] | None,
    ) -> None:
        self.step, self.system, self.users = step, step.system, users
        self.record, self.size, self.t_eval, self.max_steps = record, size, t_eval, max_steps
        self.torque, self.failed_control, self.progress = torque, failed_control, progress
        self.events: list[Event] = []
        self.steps = self.outputs = 0

    def run(self, t: float, t_end: float) -> tuple[int, str]:
        """Step from t to t_end (s); returns a code of `results` and a message."""
        try:
            self._run(t, t_end)
        except Stop as stop:
            return stop.code, stop.message
        except ContourError:
            if self.system.drive_failure is None:
                raise
            return CONTROL_FAILED, self.system.drive_failure
        return FINISHED, "the end of the interval was reached"

    def _run(self, start: float, end: float) -> None:
        step = self.step
        self._check(step.begin(start), start)
        for event in self.users:
            event.value = self._value(event, start)
        self._output(start)
        # steps are counted, so that their rounding does not add up
        count = max(math.ceil((end - start) / self.size - _SLIVER), 1) if end > start else 0
        for i in range(count):
            t = start + i * self.size
            if self.steps >= self.max_steps:
                raise Stop(STEP_LIMIT, f"t = {t:.9g} s: the limit of {self.max_steps} steps was reached")
            t_new = end if i == count - 1 else start + (i + 1) * self.size
            self._inner_outputs(t, t_new)
            self._attempt(t, t_new)
            self._user_events(t, t_new)
            self._accept(t, t_new)
            self._output(t_new)

    def _check(self, status: int, t: float) -> None:
        if status != OK:
            self.failed_control(t)
            if status in (SINGULAR, LOCATION_FAILED):
                self._announce(t, None, "singular")
            raise self.step.describe(status, t)

    def _attempt(self, t: float, t_new: float) -> None:
        h = t_new - t
        if abs(h - self.size) <= _SLIVER * self.size:
            # not what rounding has made of it
            h = self.size
        self._check(self.step.attempt(t, h, self.torque), t)

    def _accept(self, t: float, t_new: float) -> None:
        """Make the attempted step the state, and report what happened to the contacts in it."""
        step, names = self.step, [c.name for c in self.system.contacts]
        found: list[tuple[float, str, str]] = []
        for c, name in enumerate(names):
            before, after = int(step.start_mode[c]), int(self.system.contact_int[c, MODE])
            if step.touch_time[c] >= 0.0:
                found.append((t + float(step.touch_time[c]), name, "touch"))
            elif before != FREE and after == FREE:
                found.append((t_new, name, "separate"))
            elif before == STICK and after == SLIPPING:
                found.append((t_new, name, "slip"))
            elif before == SLIPPING and after == STICK:
                found.append((t_new, name, "stick"))
        for when, name, kind in sorted(found, key=lambda entry: entry[0]):
            self._announce(when, name, kind)
        step.accept(t_new)
        self.steps += 1
        if self.progress is not None:
            self.progress(t_new)

    def _announce(self, t: float, contact: str | None, kind: str, index: int = -1) -> None:
        self.events.append(Event(t, contact, kind, self.system.q.copy(), self.system.v.copy(), index))

    # ---------------------------------------------------------------- outputs

    def _output(self, t: float) -> None:
        """Record the state at t, once for every output time that falls on it."""
        times = self.t_eval
        if times is None:
            self._record(t)
            return
        while self.outputs < times.size and times[self.outputs] <= t + _SLIVER * self.size:
            self._record(t)

    def _inner_outputs(self, t: float, t_new: float) -> None:
        """Outputs inside a step: each by a shorter step of its own, which is then dropped."""
        times = self.t_eval
        while times is not None and self.outputs < times.size and times[self.outputs] < t_new - _SLIVER * self.size:
            when = float(times[self.outputs])
            self._attempt(t, when)
            self._record(when)

    def _record(self, t: float) -> None:
        if self.torque is not None and not self.torque(t):
            self.failed_control(t)
        self.record(t)
        self.outputs += 1

    # ---------------------------------------------------------------- users' events

    def _value(self, event: UserEvent, t: float) -> float:
        return float(event.function(t, self.system.q.copy(), self.system.v.copy()))

    def _user_events(self, t: float, t_new: float) -> None:
        """Locate the zeros of users' functions in the attempted step by shorter ones; a terminal one ends the run."""
        values = [self._value(event, t_new) for event in self.users]
        crossed = [i for i, event in enumerate(self.users) if event.crosses(values[i])]
        if not crossed:
            for event, value in zip(self.users, values):
                event.value = value
            return
        for when, i in sorted((self._root(self.users[i], values[i], t, t_new), i) for i in crossed):
            self._attempt(t, when)
            self._announce(when, None, "user", i)
            if self.users[i].terminal:
                self._accept(t, when)
                if self.t_eval is None:
                    self._output(when)
                raise Stop(TERMINATED, "a terminal event occurred")
        self._attempt(t, t_new)
        for event, value in zip(self.users, values):
            event.value = value

    def _root(self, event: UserEvent, value: float, t: float, t_new: float) -> float:
        if value == 0.0:
            return t_new
        known = {t: event.value, t_new: value}

        def function(when: float) -> float:
            if when not in known:
                self._attempt(t, when)
                known[when] = self._value(event, when)
            return known[when]

        return float(brentq(function, t, t_new, xtol=_EVENT_ACCURACY * (t_new - t)))
