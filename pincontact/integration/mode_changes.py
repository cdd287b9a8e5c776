"""Modes that are decided anew at one instant: who sticks, slips or opens, the state projected accordingly, and the
events of what has changed."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from ..dynamics.contact_modes import set_normal
from ..dynamics.energy import energies_at
from ..dynamics.mode_loads import AT_REST
from ..dynamics.modes import Decision, ModeSolver, rest_mode, shares_viscous_force
from ..dynamics.redistribution import items_beside
from ..dynamics.units import REDUNDANT, whiten
from ..layout import (
    DIRECTION_X,
    EVENT,
    FREE,
    FRICTION_EVENT,
    FRICTIONLESS,
    FROZEN,
    LOCATION_FAILED,
    MODE,
    MU,
    MU_STATIC,
    NO_FORCE,
    NORMAL_EVENT,
    NORMAL_SIGN,
    SLIP_SIGN,
    SLIPPING,
    STICK,
    TANGENTS,
    UNILATERAL,
)
from .accuracy import held_up, may_stop, rest_speed
from .approach import time_to_cover
from .joint_events import JointEvents
from .reports import Reports
from .results import STEP_TOO_SMALL, Stop
from .runge_kutta import RungeKutta
from .stages import DAMPING_WORK, DRIVE_WORK, FRICTION_WORK, NUMBER_OF_WORKS

# An event function this far from zero, relative to the largest force, where its sign changes has no root there.
_JUMP = 1e-6
# Event functions of friction below this part of the limit, and loads below this part of the largest, are zero where no
# choice among redundant forces can raise them.
_AT_LIMIT = 1e-6
# Bodies that would come together, without forces, by less than this part of what accelerates them need none.
_NOTHING = 1e-7
# How far, in m and rad, a motion is looked ahead for constraints that become independent.
_AHEAD = 1e-4
# What constraints that showed as redundant have let a velocity miss, in what errors of steps explain.
_MISSED = 10.0
# Times over which what lies ahead is looked for, each so many times as long as the one before.
_LONGER = 10.0


class ModeChanges:
    """Changes the modes of the state in `stage_state`, projects it and accepts it; raises Stop where that fails."""

    def __init__(self, rk: RungeKutta, modes: ModeSolver, reports: Reports, joints: JointEvents) -> None:
        self.rk, self.system, self.modes, self.reports, self.joints = rk, rk.system, modes, reports, joints
        # s: so long slips that are there already, too slow to be known, take to show their directions
        self.ahead = 0.0
        # directions in which slip began or went on since the last impact
        self.started: dict[int, np.ndarray] = {}
        # whether the state carries the account of works
        self._counts_works = rk.system.ny > rk.system.nq + rk.system.nv + 4 * rk.system.nc

    # ---------------------------------------------------------------- modes

    def sticking(self) -> list[int]:
        """Contacts and resistances that stick by Coulomb friction: a change elsewhere may upset them."""
        return [c for c in [*self.system.closed(), *self.system.resisting()] if self._sticks(c)]

    def _sticks(self, c: int) -> bool:
        return self.system.contact_int.item(c, MODE) == STICK and math.isfinite(self.system.contact_real.item(c, MU))

    def set_from_velocities(self, after_impact: bool = False) -> list[int]:
        """Give closed contacts and their resistances the mode that their slip shows; returns those at rest whose
        friction is undecided.

        Ideal rolling slides where it did, or after an impact that left it without a normal impulse.
        """
        system, numbers = self.system, self.system.contact_real
        undecided, slowest = [], -1.0
        for c in [*system.closed(), *system.resisting()]:
            integers, mu = system.contact_int[c], numbers.item(c, MU)
            if math.isinf(mu) and integers.item(MODE) == FRICTIONLESS:
                # until it comes under a load
                continue
            slid = after_impact or integers.item(MODE) == SLIPPING
            integers[FROZEN] = 0
            integers[MODE] = rest_mode(mu)
            if integers[UNILATERAL]:
                integers[NORMAL_SIGN] = abs(integers.item(NORMAL_SIGN))
            if mu == 0.0 or (math.isinf(mu) and not (slid and integers[UNILATERAL])):
                continue
            slowest = slowest if slowest > 0.0 else rest_speed(system)
            if self.slip_speed(c) > slowest:
                integers[MODE] = SLIPPING
                integers[SLIP_SIGN] = 1 if system.basis[c, 0] @ system.slip[c] >= 0.0 else -1
                # as in the last evaluation
                set_normal(system, system.owner(c), system.force[system.owner(c)])
            elif math.isfinite(mu):
                undecided.append(c)
        return undecided

    def resolve_modes(
        self, t: float, undecided: list[int], beyond: int | None = None, ahead: Mapping[int, float] = AT_REST
    ) -> Decision:
        """Decide modes, see `ModeSolver.resolve_modes`; the last evaluation is the one in them. Slips that leave no
        forces and may be stopped are."""
        modes, limits = self.system.contact_int.copy(), self.system.joint_int.copy()
        decision = self.modes.resolve_modes(t, undecided, self.rk.evaluate, beyond, ahead=ahead)
        if decision.status == NO_FORCE:
            self.system.contact_int[:], self.system.joint_int[:] = modes, limits
            sliding = may_stop(self.system)
            if sliding:
                energy = self.counted_energy()
                self.stop_slips(t, sliding)
                self.count_loss(energy)
                decision = self.modes.resolve_modes(t, self.sticking(), self.rk.evaluate, beyond)
        if decision.status == NO_FORCE and self._is_redundant():
            # constraints that are next to redundant hold nothing
            decision = self._decide_over(t, self._time_ahead())
        if decision.status > EVENT:
            raise self.reports.failure(t, decision.status)
        return decision

    def update_modes(
        self,
        t: float,
        undecided: list[int],
        at_rest: Mapping[int, np.ndarray] | None = None,
        silent: bool = False,
        beyond: int | None = None,
        explained: bool = False,
    ) -> None:
        """Decide the modes of contacts at rest, project and accept the state, and announce what has changed.

        at_rest: contacts that have just come to rest and the directions of their slip till then; what slips on as it
        did is no event. silent: announce separations only. beyond: a contact whose static friction has been exceeded.
        explained: see `_project_decided`.
        """
        system, ending = self.system, self._joints_at_rest()
        at_rest = {**(at_rest or {}), **dict.fromkeys(ending, np.zeros(3))}
        self._hold(ending)
        before, signs = system.contact_int[:, MODE].tolist(), system.contact_int[:, SLIP_SIGN].tolist()
        # what is left of slips that have ended goes on where friction does not end it at once; what others have is none
        self.resolve_modes(t, undecided, beyond, dict.fromkeys(at_rest, self.ahead))
        self._project_decided(t, explained)
        # what comes to rest may hold more
        stopped = self._stopped(t, before) if at_rest else []
        if stopped:
            self._hold(stopped)
            at_rest = {**at_rest, **dict.fromkeys(stopped, np.zeros(3))}
            self.resolve_modes(t, self.sticking(), beyond, dict.fromkeys(at_rest, self.ahead))
            self._project_decided(t, explained)
        self.rk.accept()
        after = system.contact_int[:, MODE].tolist()
        for c in [*range(system.nc), *system.resisting()]:
            mode = after[c]
            if mode == FREE and before[c] != FREE:
                self.reports.announce(t, c, "separate")
            elif silent:
                continue
            elif c in at_rest:
                if mode != SLIPPING or self._goes_back(c, at_rest[c]):
                    self.reports.announce_friction(t, c, mode == SLIPPING)
            elif shares_viscous_force(system, c):
                continue
            elif (before[c] == STICK and mode in (SLIPPING, FRICTIONLESS)) or (
                mode == SLIPPING and signs[c] != system.contact_int[c, SLIP_SIGN]
            ):
                self.reports.announce_friction(t, c, True)
        self.joints.announce_changes(t)

    def _joints_at_rest(self) -> list[int]:
        """Dry joints that come to rest in the last evaluation. Taken for sliding, they would push on with all of their
        friction what has come to rest beside them, and may not hold it."""
        system, found = self.system, []
        slowest = rest_speed(system) if system.ng else 0.0
        for g, limit in enumerate(system.limits):
            speed, rate = float(system.v[limit.index_v]), float(system.acceleration[limit.index_v])
            if limit.dry and self.joints.is_free(g) and abs(speed) <= slowest and speed * rate < 0.0:
                found.append(system.nc + g)
        return found

    def _stopped(self, t: float, before: list[int]) -> list[int]:
        """What moves in these modes, but is at rest: items that slid till now, and which others keep from it, and what
        has begun to slip beside them. Empty without the former.

        Bodies do not turn at one contact whose others stick, and coupled joints stop together.
        """
        system = self.system
        integers, joints = system.contact_int, range(system.nc, system.nc + system.ng)
        slid = [mode == (FREE if i in joints else SLIPPING) for i, mode in enumerate(before)]
        moving = [i for i, mode in enumerate(integers[:, MODE].tolist()) if mode == SLIPPING]
        moving = [i for i in moving if system.contact_real.item(i, MU) < math.inf]
        sliding = [i for i in moving if not (integers[i, FROZEN] and slid[i])]
        sliding += [system.nc + g for g, limit in enumerate(system.limits) if limit.dry and self.joints.is_free(g)]
        if not any(slid[i] for i in sliding):
            return []
        self.rk.evaluate(t)
        slowest = rest_speed(system)
        at_rest = [i for i in sliding if self.slip_speed(i) <= slowest]
        return at_rest if any(slid[i] for i in at_rest) else []

    def _hold(self, items: list[int]) -> None:
        """Hold items that are at rest."""
        system = self.system
        for i in items:
            if system.nc <= i < system.nc + system.ng:
                self.modes.hold(i - system.nc, 0)
            else:
                system.contact_int[i, MODE] = STICK

    def slip_speed(self, i: int) -> float:
        """How fast item i slips in the last evaluation, in m/s or rad/s."""
        system = self.system
        if system.nc <= i < system.nc + system.ng:
            return abs(float(system.v[system.limits[i - system.nc].index_v]))
        along = system.basis[i] @ system.slip[i]
        return abs(along[0]) if system.contact_int[i, TANGENTS] == 1 else math.hypot(along[0], along[1])

    def slip_direction(self, c: int) -> np.ndarray:
        """Unit vector, world axes, of the slip of an item that slides; zero where there is none."""
        system, integers, tangents = self.system, self.system.contact_int[c], self.system.basis[c, :2]
        if integers[TANGENTS] == 1:
            return float(integers[SLIP_SIGN]) * tangents[0]
        frozen = integers[FROZEN] != 0
        along = tangents.dot(system.contact_real[c, DIRECTION_X : DIRECTION_X + 3] if frozen else system.slip[c])
        speed = math.hypot(*along.tolist())
        return along.dot(tangents) / speed if speed > 0.0 else np.zeros(3)

    def _goes_back(self, c: int, ended: np.ndarray) -> bool:
        """Whether item c slips on against the direction in which its slip has ended.

        Where slip is slower than it is known, that direction is noise; the one in which it started is not.
        """
        direction = self.slip_direction(c)
        return bool(direction @ ended <= 0.0 and direction @ self.started.get(c, ended) <= 0.0)

    # ---------------------------------------------------------------- jams

    def stop_jammed(self, t: float) -> None:
        """Stop slips that friction alone would have to hold up and cannot: the force it takes grows without bound."""
        system, sliding = self.system, held_up(self.system)
        if sliding and self.rk.evaluate(t) <= EVENT:
            sliding = [c for c in sliding if system.event_functions[c, FRICTION_EVENT] < 0.0]
        if not sliding:
            return
        # what takes no load goes on, without friction
        system.contact_int[sliding, MODE] = FRICTIONLESS
        jammed = self.modes.pressed(sliding) if self.rk.evaluate(t) <= EVENT else sliding
        if jammed:
            self.stop_slips(t, jammed)

    def stop_slips(self, t: float, contacts: list[int]) -> None:
        """End slips at once, by the least change of velocity that does it."""
        self.system.contact_int[contacts, MODE] = STICK
        self.project(t, explained=True)

    def end_jams(self, t: float, contacts: list[int]) -> None:
        """End the slips of jammed contacts, and decide the modes that follow."""
        energy = self.counted_energy()
        self.stop_slips(t, contacts)
        self.count_loss(energy)
        self.update_modes(t, self.sticking(), dict.fromkeys(contacts, np.zeros(3)))

    # ---------------------------------------------------------------- redundant forces

    def rests_on_redundant(self) -> bool:
        """Whether redundant forces of the modes move nothing: none slides."""
        system = self.system
        if not self._is_redundant():
            return False
        modes = system.contact_int[:, MODE].tolist()
        return all(modes[i] != SLIPPING for i in [*system.closed(), *system.resisting()])

    def _is_redundant(self) -> bool:
        """Whether the rows of the last evaluation depend on each other."""
        counters = self.system.counters
        return bool(counters.row_count > counters.row_rank)

    def redistribute(self, t: float, c: int, kind: int) -> bool:
        """Whether other ones among redundant forces keep all modes, of which event function `kind` of item c ends
        one."""
        # of independent rows there is one choice
        if not self._is_redundant() or self.rk.evaluate(t) > EVENT or not self.redistribute_within(t, c, kind):
            return False
        self.project(t)
        self.rk.accept()
        return True

    def unloaded(self, t: float) -> list[int]:
        """Contacts that open together: they carry next to nothing, and none of their forces is needed to keep their
        bodies as near as they are.

        As redundant loads shrink to nothing, each choice among them is soon over, however often it is made anew; and
        where some open before the others, what these carry is round-off.
        """
        system = self.system
        least, forces = max(_NOTHING, system.scale.item(0)), system.force.tolist()
        # bodies that are pressed together have forces of their own
        largest = 10.0 * least * self.modes.largest_load()
        idle = [c for c in system.closed() if max(map(abs, forces[c])) <= largest]
        closed = [c for c in idle if system.contact_int[c, UNILATERAL]]
        if not closed:
            return []
        kept, integers = self._kept(closed, idle), system.contact_int.copy()
        rows, bias = system.rows[closed, 2].copy(), system.bias[closed, 2].copy()
        system.contact_int[closed, MODE] = FREE
        # what others do without them
        known = self.rk.evaluate(t) <= EVENT
        rates = rows @ system.acceleration + bias
        sizes = np.abs(rows) @ np.abs(system.free_acceleration) + np.abs(bias)
        # what resists the turning of an open contact has been freed, too
        system.contact_int[:] = integers
        self.rk.evaluate(t)
        return [c for c, parts in zip(closed, ((rates >= -least * sizes) & ~kept).tolist()) if parts and known]

    def _kept(self, contacts: list[int], idle: list[int]) -> np.ndarray:
        """(n,) which of these contacts stay closed without a force, as the others, but for idle ones, keep them so: of
        four feet on a plane that stand on three."""
        system = self.system
        loaded = [c for c in system.closed() if c not in idle]
        rows = [system.rows[c, 2] for c in loaded]
        rows += [system.rows[c, row] for c in loaded for row in (0, 1) if self._sticks(c)]
        own = whiten(system, system.rows[contacts, 2].T)
        left = own
        if rows:
            others = whiten(system, np.array(rows).T)
            left = own - others @ np.linalg.lstsq(others, own, rcond=REDUNDANT)[0]
        return np.asarray(np.linalg.norm(left, axis=0) <= REDUNDANT * np.linalg.norm(own, axis=0))

    def redistribute_within(self, t: float, c: int, kind: int) -> bool:
        """The same of the last evaluation, within a step, for forces that move nothing. Those that leave an item at its
        limit stay chosen."""
        system = self.system
        # a force that jumps, as where contacts cease to be redundant, is not one of choice
        left = system.event_functions.item(c, kind)
        if left > 0.0 and left > _JUMP * max(map(abs, system.force.ravel().tolist())):
            return False
        ended = c if kind == NORMAL_EVENT and c < system.nc and system.contact_int[c, UNILATERAL] else None
        return self.modes.redistribute(t, self.rk.evaluate, ended) and not self._is_limited(c, kind)

    def _is_limited(self, c: int, kind: int) -> bool:
        """Whether the last choice leaves item c at its limit, to the relative tolerance."""
        sticks = kind == FRICTION_EVENT and self._sticks(c)
        return sticks and bool(self.at_limit(self.system.scale.item(0), [c]))

    def at_known_limit(self) -> list[int]:
        """The items that stick at the limit of their friction as far as that is known: redundant forces are brought up
        to it to the relative tolerance."""
        return self.at_limit(max(_AT_LIMIT, self.system.scale.item(0)) if self._is_redundant() else _AT_LIMIT)

    def limiting(self, c: int, kind: int) -> tuple[int, int]:
        """The event function that ends a mode, where `kind` of contact c is zero and no other redundant forces would
        do.

        Forces that shrink to nothing leave their cone anywhere: whether the others have reached the limit of friction,
        so that all slip and the unloaded contact with them, or that contact opens, is seen at the others.
        """
        system = self.system
        if not self.modes.redundant or c >= system.nc or not system.contact_int[c, UNILATERAL]:
            return c, kind
        loads = self._loads()
        if loads[c] > 0.0:
            return c, kind
        beside = items_beside(system, c)
        limited = [i for i in self.at_limit() if i in beside]
        return (max(limited, key=lambda i: loads[system.owner(i)]), FRICTION_EVENT) if limited else (c, NORMAL_EVENT)

    def at_limit(self, within: float = _AT_LIMIT, among: list[int] | None = None) -> list[int]:
        """The items that stick at the limit of their friction, but for this part of it. among: of which, where not of
        all."""
        system, loads = self.system, self._loads()
        sticking = self.sticking() if among is None else among
        limits = {i: system.contact_real.item(i, MU_STATIC) * loads[system.owner(i)] for i in sticking}
        left = system.event_functions[:, FRICTION_EVENT].tolist()
        return [i for i, limit in limits.items() if abs(left[i]) < within * limit]

    def _loads(self) -> list[float]:
        """Normal forces in N of all contacts, zero where they are next to nothing."""
        loads = [abs(normal) for normal in self.system.force[: self.system.nc, 2].tolist()]
        least = _AT_LIMIT * max(loads, default=0.0)
        return [load if load > least else 0.0 for load in loads]

    # ---------------------------------------------------------------- the state

    def project(self, t: float, evaluated: bool = False, explained: bool = False, stepped: bool = False) -> None:
        """Put the state on its constraints; explained: by an impact, say, whatever that takes from the velocity;
        stepped: by no more than errors of steps."""
        before = None if explained else self.system.v.copy()
        if not self.rk.project(t, evaluated):
            if self.rk.evaluate(t) == NO_FORCE:
                raise self.reports.failure(t, NO_FORCE)
            raise Stop(STEP_TOO_SMALL, f"t = {t:.9g} s: the projection on the constraints failed")
        if before is None:
            return
        taken, speed = self.modes.taken_from(before)
        if taken > (self.modes.explained(speed) if stepped else self.modes.negligible(speed)):
            raise Stop(
                STEP_TOO_SMALL,
                f"t = {t:.9g} s: the projection on the constraints failed: it would change the velocity, of size "
                f"{speed:.3g} in the mass metric, by {taken:.3g}",
            )

    def _project_decided(self, t: float, explained: bool) -> None:
        """Put the state, which has been evaluated in modes that have just been decided, on their constraints. Where
        that takes more from the velocity than slips that have ended, what sticks gives way if it can; explained: by
        an impact, say, whatever it takes."""
        if explained:
            self.project(t, True, explained=True)
            return
        state = self.system.stage_state.copy()
        if self.closes(t, True):
            return
        self.rk.load(state)
        if not self.let_slide(t):
            self.project(t, False)

    def closes(self, t: float, evaluated: bool = False, times: float = 1.0) -> bool:
        """Put the state on its constraints; whether it can be, by no more than so many times errors of steps."""
        before = self.system.v.copy()
        found = self.rk.project(t, evaluated)
        taken, speed = self.modes.taken_from(before)
        return found and taken <= times * self.modes.explained(speed)

    def let_slide(self, t: float) -> bool:
        """Let slide what friction cannot stop, see `ModeSolver.let_slide`, and project the state of stage_state; False
        where that does not do, and nothing has changed."""
        system = self.system
        integers, limits, state = system.contact_int.copy(), system.joint_int.copy(), system.stage_state.copy()
        self.evaluate_rows(t)
        # over a time in which loads count for more than what the velocity misses by, if that will do
        for longest in (self._time_ahead(), self.ahead):
            if self._decide_over(t, longest).status <= EVENT:
                changed = (system.contact_int[:, MODE] != integers[:, MODE]).any()
                if changed and self.closes(t, True, _MISSED):
                    return True
            system.contact_int[:], system.joint_int[:] = integers, limits
            self.rk.load(state)
            self.rk.evaluate(t)
        return False

    def _decide_over(self, t: float, longest: float) -> Decision:
        """`ModeSolver.let_slide` over this time in s. Constraints that are next to redundant leave a search hardly
        anything to go by: where it finds nothing, solutions over shorter times, in which they show, lead to it."""
        system, times = self.system, [longest]
        integers, limits, shorter = system.contact_int.copy(), system.joint_int.copy(), self.ahead
        while 0.0 < shorter < longest < math.inf:
            times.append(shorter)
            shorter *= _LONGER
        for ahead in [*times, longest] if len(times) > 1 else times:
            decision = self.modes.let_slide(t, self.rk.evaluate, ahead)
            if decision.status <= EVENT and ahead == longest:
                break
            system.contact_int[:], system.joint_int[:] = integers, limits
            self.rk.evaluate(t)
        return decision

    def _time_ahead(self) -> float:
        """Time in s in which the evaluated state moves by `_AHEAD`."""
        speed, rate = (float(np.abs(of).max()) for of in (self.system.v, self.system.acceleration))
        # half of it from both
        return time_to_cover(_AHEAD, speed, rate)

    def look_ahead(self, t: float) -> tuple[list[int], list[int]]:
        """The closed contacts that open, and those that slip, as soon as the accepted state has moved, however little:
        those of redundant ones that are held by no forces within bounds once their constraints are independent.

        Feet under upright legs, say, hold a body together, up to round-off, until it has moved enough for their
        constraints to show as the independent ones that they are at once. Which of them leave then does not depend on
        when it shows: they leave before.
        """
        system, rk, modes = self.system, self.rk, self.modes
        if not self._is_redundant() or rk.evaluate_start(t) > EVENT:
            return [], []
        h = self._time_ahead()
        if not h < math.inf:
            return [], []
        integers, limits, numbers = system.contact_int.copy(), system.joint_int.copy(), system.contact_real.copy()
        forces, rank = modes.reference(), system.counters.row_rank
        v, change = system.v.copy(), h * system.acceleration
        moved = pin.integrate(system.model, system.q, h * (v + 0.5 * change))
        system.put_state(system.stage_state, moved, 0.0, system.location[: system.nc])
        rk.load(system.stage_state)
        system.v[:] = v + change
        status, opened, slipping = rk.evaluate(t), [], []
        if (status <= EVENT or status == NO_FORCE) and system.counters.row_rank > rank:
            decision = self._decide_over(t, h)
            if decision.status <= EVENT:
                slips = (system.modes == SLIPPING) & (integers[: system.nc, MODE] == STICK)
                opened, slipping = decision.opened, np.flatnonzero(slips).tolist()
        system.contact_int[:], system.joint_int[:], system.contact_real[:] = integers, limits, numbers
        modes.take_back(forces)
        rk.load(system.state)
        rk.evaluate_start(t)
        return opened, slipping

    def evaluate_accepted(self, t: float) -> None:
        """Load the accepted state and evaluate it in the present modes."""
        if self.rk.evaluate_start(t) > EVENT:
            raise self.reports.failure(t, NO_FORCE)

    def evaluate_rows(self, t: float) -> None:
        """Evaluate what an impact needs: rows, v_c and the factor of M; forces there may be none."""
        status = self.rk.evaluate(t)
        if status > EVENT and status != NO_FORCE:
            raise self.reports.failure(t, LOCATION_FAILED)

    def accept_with_other_forces(self, t: float) -> None:
        """Accept the state with other forces, of which none has jumped."""
        if self.rk.evaluate(t) > EVENT:
            raise self.reports.failure(t, NO_FORCE)
        self.project(t, True)
        self.rk.accept()

    # ---------------------------------------------------------------- the account of works

    def energies(self) -> tuple[float, float]:
        """Kinetic and potential energy in J at the system's (q, v)."""
        return energies_at(self.system.model, self.system.q, self.system.v)

    def counted_energy(self) -> float:
        """Energy in J of the system's state, where works are counted."""
        return sum(self.energies()) if self._counts_works else 0.0

    def count_loss(self, before: float) -> None:
        """Book what projections took from the energy `before` in J as work of friction."""
        self.count_works(friction=self.counted_energy() - before)

    def count_works(self, friction: float = 0.0, drives: float = 0.0, damping: float = 0.0) -> None:
        """Add works in J to the account, where there is one."""
        if self._counts_works:
            works = self.system.stage_state[-NUMBER_OF_WORKS:]
            works[FRICTION_WORK] += friction
            works[DRIVE_WORK] += drives
            works[DAMPING_WORK] += damping
