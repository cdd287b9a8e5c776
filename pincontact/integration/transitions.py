"""Mode changes: what happens at an event, and how slip starts from rest."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..dynamics.impact import apply_impact
from ..dynamics.modes import Decision, ModeSolver, freeze_slip, rest_mode
from ..dynamics.stretches import opposed_slip
from ..geometry.patterns import ON_CURVE
from ..layout import (
    CONDITION,
    DOMAIN_MARGIN,
    EVENT,
    FREE,
    FRICTION_MARGIN,
    FROZEN,
    GAP_MARGIN,
    LOCATION_FAILED,
    MASS_NOT_POSITIVE,
    MODE,
    MU,
    MU_STATIC,
    NO_FORCE,
    NORMAL_1,
    NORMAL_MARGIN,
    NORMAL_SIGN,
    OK,
    PATTERN,
    SINGULAR,
    SLIP_SIGN,
    SLIPPING,
    SPEED_MARGIN,
    STICK,
    TANGENTS,
    UNILATERAL,
)
from .results import CHATTER, END_OF_CONTOUR, FAILURES, SINGULAR_CONTACT, STEP_TOO_SMALL, Event, Stop
from .runge_kutta import RungeKutta
from .slip_start import start_slip

if TYPE_CHECKING:
    pass

# Slip slower than this (m/s, absolute and relative to the largest velocity) counts as rest where modes are set anew.
_REST = 1e-9
# So many events within this fraction of the run mean chatter.
_CHATTER_EVENTS = 40
_CHATTER_SPAN = 1e-9
# The start of slip is followed over times down to this fraction of the seed's.
_SHORTEST_START = 1e-3
# Where it cannot be followed, slip is seeded after this fraction of the usual time.
_SHORT_SEED = 1e-2
# A rebound slower than this, in m/s, closes the contact.
REST_SPEED = 1e-3


class Transitions:
    """Changes the modes of a system whose state is in `stage_state`, and leaves it ready for the next step.

    Methods return the time, which a start of slip moves on by a short seed step; they raise Stop where the run ends.
    """

    def __init__(
        self,
        rk: RungeKutta,
        names: list[str],
        restitution: list[float],
        span: float,
        failed_control: Callable[[float], None],
    ) -> None:
        # Writes the outputs that fall into a short step (start, size in s) taken here; the driver sets it.
        self.emit: Callable[[float, float], None] = lambda t, step: None
        self.rk, self.system, self.names, self.restitution, self.span = rk, rk.system, names, restitution, span
        self.failed_control = failed_control
        self.modes = ModeSolver(rk.system)
        self.events: list[Event] = []
        self._recent: list[float] = []
        # Longest time in s that the start of slip may take with a prescribed direction; the driver keeps it current.
        self.longest_start = 0.0
        # Slip from rest is seeded after this time in s: its error is of third order in it.
        self.seed = min(
            (1e-2 * max(float(rk.system.scale[0]), 1e-14)) ** (1.0 / 3.0), 1e-2 * span if span > 0.0 else 1.0
        )

    # ---------------------------------------------------------------- reports

    def announce(self, t: float, contact: int | None, kind: str, index: int = -1) -> None:
        """Add an event with the system's present state."""
        name = None if contact is None else self.names[contact]
        self.events.append(Event(t, name, kind, self.system.q.copy(), self.system.v.copy(), index))

    def give_up(self, t: float, failure: int) -> Stop:
        """The Stop for an evaluation's status, naming the contact, its pattern and the number."""
        self.failed_control(t)
        if failure not in FAILURES:
            return Stop(STEP_TOO_SMALL, f"t = {t:.9g} s: the step size fell below its floor")
        code, reason = FAILURES[failure]
        culprit = self._culprit(failure)
        if code == SINGULAR_CONTACT:
            self.announce(t, culprit, "singular")
        where, number = "", ""
        if culprit is not None:
            where = f"contact {self.names[culprit]!r} ({self.system.contacts[culprit].pattern.name}): "
            if code == SINGULAR_CONTACT:
                number = f"; conditioning of J {abs(self.system.contact_real[culprit, CONDITION]):.3g}"
        return Stop(code, f"t = {t:.9g} s: {where}{reason}{number}")

    def _culprit(self, failure: int) -> int | None:
        system = self.system
        if failure == NO_FORCE:
            slipping = [c for c in range(system.nc) if system.contact_int[c, MODE] == SLIPPING]
            return slipping[0] if slipping else None
        if failure in (SINGULAR, LOCATION_FAILED) and system.nc:
            return int(np.argmin(np.abs(system.contact_real[: system.nc, CONDITION])))
        return None

    def _check_chatter(self, t: float) -> None:
        self._recent.append(t)
        if len(self._recent) > _CHATTER_EVENTS:
            self._recent.pop(0)
            if t - self._recent[0] <= _CHATTER_SPAN * self.span:
                raise Stop(CHATTER, f"t = {t:.9g} s: {_CHATTER_EVENTS} mode changes without progress (chatter)")

    # ---------------------------------------------------------------- start

    def begin(self, t: float) -> None:
        """Modes of the initial state in `system.state`, and its slope. Slip that starts from rest is still frozen."""
        system, rk = self.system, self.rk
        rk.load(system.state)
        status = rk.evaluate(t)
        self.failed_control(t)
        if status in (LOCATION_FAILED, SINGULAR, MASS_NOT_POSITIVE):
            raise self.give_up(t, status)
        self._settle(t, self.modes_from_velocities(), None, True)

    def modes_from_velocities(self) -> list[int]:
        """Give closed contacts the mode that v_c shows; returns those at rest whose friction is undecided."""
        system = self.system
        rest_speed = _REST * (1.0 + float(np.abs(system.v).max(initial=0.0)))
        undecided = []
        for c in system.closed():
            integers = system.contact_int[c]
            mu = system.contact_real[c, MU]
            integers[FROZEN] = 0
            integers[MODE] = rest_mode(mu)
            if mu == 0.0 or math.isinf(mu):
                continue
            along = system.basis[c] @ system.slip[c]
            speed = abs(along[0]) if integers[TANGENTS] == 1 else math.hypot(along[0], along[1])
            if speed > rest_speed:
                integers[MODE] = SLIPPING
                integers[SLIP_SIGN] = 1 if along[0] >= 0.0 else -1
                self._guess_normal(c)
            else:
                undecided.append(c)
        return undecided

    def _guess_normal(self, c: int) -> None:
        """Sign (or direction) of a bilateral contact's normal force as in the last evaluation."""
        integers, numbers, force = self.system.contact_int[c], self.system.contact_real[c], self.system.force[c]
        if integers[UNILATERAL]:
            return
        if integers[PATTERN] == ON_CURVE:
            size = math.hypot(force[1], force[2])
            if size > 0.0:
                numbers[NORMAL_1 : NORMAL_1 + 2] = force[2] / size, force[1] / size
        else:
            integers[NORMAL_SIGN] = 1 if force[2] >= 0.0 else -1

    # ---------------------------------------------------------------- events

    def switch(self, t: float, c: int, kind: int) -> float:
        """Margin `kind` of contact c has reached zero at t."""
        self._check_chatter(t)
        integers = self.system.contact_int[c]
        if kind == GAP_MARGIN:
            return self._touch(t, c)
        if kind == DOMAIN_MARGIN:
            self.announce(t, c, "edge")
            if not integers[UNILATERAL]:
                raise Stop(END_OF_CONTOUR, f"t = {t:.9g} s: contact {self.names[c]!r} reached the end of a contour")
            integers[MODE] = FREE
            return self.resolve(t, self._sticking())
        if kind == NORMAL_MARGIN:
            if integers[UNILATERAL]:
                integers[MODE] = FREE
                self.announce(t, c, "separate")
            else:
                # at zero the force itself tells no sign
                integers[NORMAL_SIGN] *= -1
            return self.resolve(t, self._sticking())
        if kind == SPEED_MARGIN:
            return self.come_to_rest(t, c)
        assert kind == FRICTION_MARGIN
        return self._leave_stick(t, c)

    def come_to_rest(self, t: float, c: int) -> float:
        """The slip of contact c has ended: it sticks, or slides on in another direction."""
        self.system.contact_int[c, MODE] = STICK
        return self.resolve(t, self._sticking(), at_rest=c)

    def _sticking(self) -> list[int]:
        """Contacts that stick by Coulomb friction: a change elsewhere may upset them."""
        system = self.system
        return [
            c
            for c in system.closed()
            if system.contact_int[c, MODE] == STICK and math.isfinite(system.contact_real[c, MU])
        ]

    def resolve(
        self,
        t: float,
        undecided: list[int],
        at_rest: int | None = None,
        silent: bool = False,
        beyond: int | None = None,
    ) -> float:
        """Decide the modes of contacts at rest, project, and start those that slip.

        at_rest: a contact that has just come to rest, whose fate is announced; silent: announce separations only.
        beyond: a contact whose static friction has been exceeded.
        """
        self._settle(t, undecided, at_rest, silent, beyond)
        return self.start_frozen(t)

    def _settle(
        self, t: float, undecided: list[int], at_rest: int | None, silent: bool, beyond: int | None = None
    ) -> None:
        system, rk = self.system, self.rk
        before = system.modes.copy()
        signs = system.contact_int[: system.nc, SLIP_SIGN].copy()
        self._decide(t, undecided, beyond)
        self._project(t)
        rk.accept()
        for c in range(system.nc):
            mode = int(system.contact_int[c, MODE])
            if mode == FREE and before[c] != FREE:
                self.announce(t, c, "separate")
            elif silent:
                continue
            elif c == at_rest:
                self.announce(t, c, "stick" if mode == STICK else "slip")
            elif mode == SLIPPING and (before[c] == STICK or signs[c] != system.contact_int[c, SLIP_SIGN]):
                self.announce(t, c, "slip")

    def _decide(self, t: float, undecided: list[int], beyond: int | None = None) -> Decision:
        decision = self.modes.decide(t, undecided, self.rk.evaluate, beyond)
        if decision.status > EVENT:
            raise self.give_up(t, decision.status)
        self._fix_normal_signs(t)
        return decision

    def _project(self, t: float) -> None:
        if not self.rk.project(t, False):
            self.failed_control(t)
            raise Stop(STEP_TOO_SMALL, f"t = {t:.9g} s: the projection on the constraints failed")

    def _fix_normal_signs(self, t: float) -> None:
        """Flip the assumed sign of a sliding bilateral contact's normal force where it came out the other way."""
        system = self.system
        for c in system.closed():
            integers = system.contact_int[c]
            if integers[MODE] == SLIPPING and not integers[UNILATERAL] and integers[PATTERN] != ON_CURVE:
                self.rk.evaluate(t)
                if system.margins[c, NORMAL_MARGIN] < -self.modes.force_round_off():
                    integers[NORMAL_SIGN] *= -1
                    self.rk.evaluate(t)

    # ---------------------------------------------------------------- slip from rest

    def start_frozen(self, t: float) -> float:
        """Slip that starts with a finite acceleration: one tiny step in the given direction, so that v_c has one."""
        rk, system = self.rk, self.system
        if not system.contact_int[: system.nc, FROZEN].any():
            return t
        tau = self.seed**1.5
        if rk.attempt(t, tau) != OK:
            raise self.give_up(t, NO_FORCE)
        self.emit(t, tau)
        rk.load(system.new_state)
        system.contact_int[: system.nc, FROZEN] = 0
        self._project(t + tau)
        rk.accept()
        return t + tau

    def _leave_stick(self, t: float, c: int) -> float:
        """Contact c has reached its friction limit.

        With one tangent the slip's sign is known. With two its direction is not: stick runs on for a short time tau,
        and the cone problem there tells who slips and where to. From there `slip_start` follows the direction; where it
        cannot, slip is a_t tau / 2 after tau, since the relative acceleration grows from zero: an error of order tau^3.
        """
        rk, system = self.rk, self.system
        if system.contact_int[c, TANGENTS] == 1:
            self._guess_normal(c)
            freeze_slip(system, c, -system.force[c, :1])
            self.announce(t, c, "slip")
            return self.resolve(t, [])
        if system.contact_real[c, MU_STATIC] > system.contact_real[c, MU]:
            # friction falls to its sliding value: slip starts with a finite acceleration
            return self.resolve(t, self._sticking(), beyond=c)
        self._project(t)
        rk.accept()
        # the friction that stick asks for at its limit is against the slip to come
        limit = opposed_slip(system, c, system.force[c, :2]) @ system.basis[c, :2]
        start_q, start_v = system.q.copy(), system.v.copy()
        tau = self.seed
        decision, seeded = self._run_on(t, tau)
        for slipping in decision.started:
            self.events.append(Event(t, self.names[slipping], "slip", start_q, start_v))
        for opened in decision.opened:
            self.announce(t + tau, opened, "separate")
        started = [i for i in decision.started if system.contact_int[i, FROZEN]]
        if started and not decision.opened:
            if c in started:
                freeze_slip(system, c, system.basis[c, :2] @ limit)
            span = start_slip(rk, t, started, self.longest_start, _SHORTEST_START * tau)
            if span is not None:
                self.emit(t, span)
                rk.load(system.new_state)
                return self._end_start(t + span)
            # not even a short start can be followed: seed the slip as close to its beginning as v_c can show it
            system.contact_int[started, MODE] = STICK
            rk.load(system.state)
            if rk.evaluate_start(t) > EVENT:
                raise self.give_up(t, NO_FORCE)
            tau *= _SHORT_SEED
            seeded = self._run_on(t, tau)[1]
        self.emit(t, tau)
        rk.load(seeded)
        return self._end_start(t + tau)

    def _run_on(self, t: float, tau: float) -> tuple[Decision, np.ndarray]:
        """Stick runs on from the accepted state for tau, where the modes are decided anew; also returns the state there
        with the slip velocity a_t tau / 2 added."""
        rk, system = self.rk, self.system
        if rk.attempt(t, tau) != OK:
            raise self.give_up(t, NO_FORCE)
        rk.load(system.new_state)
        self._project(t + tau)
        stick = system.stage_state.copy()
        acceleration = system.acceleration.copy()
        decision = self._decide(t + tau, self._sticking())
        stick[system.nq : system.nq + system.nv] += 0.5 * tau * (system.acceleration - acceleration)
        return decision, stick

    def _end_start(self, t: float) -> float:
        """Slip has a direction of its own from here on."""
        self.system.contact_int[: self.system.nc, FROZEN] = 0
        self._project(t)
        self.rk.accept()
        return t

    # ---------------------------------------------------------------- impact

    def _touch(self, t: float, c: int) -> float:
        """Contact c closes: impulses on all closed contacts, then new modes from the velocities after them."""
        system, rk = self.system, self.rk
        self.announce(t, c, "touch")
        integers = system.contact_int
        integers[c, MODE] = rest_mode(system.contact_real[c, MU])
        if rk.evaluate(t) > EVENT:
            raise self.give_up(t, LOCATION_FAILED)
        closed = system.closed()
        approach = float(system.basis[c, 2] @ system.slip[c])
        rebound = -self.restitution[c] * approach
        restitution = {c: self.restitution[c] if rebound > REST_SPEED else 0.0}
        if not apply_impact(system, self.modes.solver, closed, restitution):
            raise Stop(FAILURES[NO_FORCE][0], f"t = {t:.9g} s: no impulses satisfy Coulomb's law at {self.names[c]!r}")
        system.stage_state[system.nq : system.nq + system.nv] = system.v
        if rk.evaluate(t) > EVENT:
            raise self.give_up(t, LOCATION_FAILED)
        for i in closed:
            leaving = float(system.basis[i, 2] @ system.slip[i])
            if integers[i, UNILATERAL] and leaving > REST_SPEED * 1e-3:
                integers[i, MODE] = FREE
        return self.resolve(t, self.modes_from_velocities(), silent=True)
