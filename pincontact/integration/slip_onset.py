"""Onset of slip: out of stick at the friction limit, from rest, and slow slip that is followed in steps of its own.

Slip that begins has no direction in v_c yet. It is given one (`freeze_slip`), in which a short step is taken. Where
friction turns slow slip faster than it grows, the direction is found by collocation (`slow_slip`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from ..dynamics.contact_modes import set_normal
from ..dynamics.directions import freeze_slip
from ..dynamics.event_functions import FORCE_EVENTS
from ..dynamics.friction_scaling import opposed_slip
from ..dynamics.modes import Decision
from ..dynamics.units import whiten
from ..layout import (
    DIRECTION_X,
    DOMAIN,
    DOMAIN_EVENT,
    EVENT,
    EVENTS_PER_CONTACT,
    FREE,
    FRICTION_EVENT,
    FROZEN,
    GAP_EVENT,
    LEFT_ROW,
    MODE,
    MU,
    MU_STATIC,
    NO_FORCE,
    NORMAL_EVENT,
    OK,
    POLYNOMIAL,
    POLYNOMIAL_SIZE,
    RIGHT_ROW,
    SLIP_RATE,
    SLIP_SPEED,
    SLIPPING,
    SPEED_EVENT,
    START_SPEED,
    STICK,
    TANGENTS,
)
from .accuracy import gap_rate, held_up, may_stop, rest_speed, speed_round_off
from .contradictions import projection_failure
from .crossings import LEFT_OUT, NOT_SOUGHT, UNKNOWN
from .mode_changes import ModeChanges
from .open_contacts import OpenContacts
from .results import Stop
from .slip_at_ends import STIFF
from .slow_slip import SHORTER, follow_slips
from .steps import FAILED_FACTOR, FIND_EARLIEST

# The start of slip is followed over times down to this fraction of the seed's.
_SHORTEST_START = 1e-3
# Where it cannot be followed, slip is seeded after this fraction of the usual time.
_SHORT_SEED = 1e-2
# So often a seed is shortened, to a billionth, where the motion turns within it: a disk that is almost flat turns round
# in microseconds, and of two wheels on one axle that slip by 1e-8 m/s one takes over the slip of the other in 1e-9 s.
_SHORTENINGS = 16
# Slip from rest starts slowly where friction turns it this many times faster than it grows.
_SLOW_START = 30.0
# So often, and so much shorter each time, is looked for slip that a seed has not shown.
_LOOKS_FOR_SLIP, _SHORTER_SEED = 3, 0.1
# Friction is at its limit but for this part of it: redundant forces are known no better there.
_AT_LIMIT = 1e-5
# Where contacts open as stick ends, they do after this fraction of the usual time.
_OPENING_SEED = 1e-4
# Forces below zero, or above their limit, by less than this part of the largest one are no events while slip starts.
_FORCE_ACCURACY = 1e-6
# A start of slip may last until slip is so many times as fast as v is known, if it grows as it begins to.
_SHOWN = 1e3
# Steps that a touch or an end is foreseen in go this part of the way to it, so that it is found in the next one.
_UP_TO_EVENT = 0.999
# Slip this part of v, or of 1 m/s, and slower has no direction that is known to a percent.
_ROUND_OFF = 1e-13
# A gap that is closed already counts as so much of its accuracy.
_LEAST_WAY = 1e-2


class SlipOnset:
    """Starts slips of the state that `changes` has decided the modes of; methods return the time after it.

    depths: (items,) how much deeper in m than their accuracy open contacts may be, see `penetration`.
    seed: time in s after which slip from rest is seeded: its error is of third order in it.
    longest: the longest time in s that the start of slip may take, and left: that of the run, or until the next
    breakpoint; the driver keeps them current.
    age: how long in s slip went on that has started since this was set to zero.
    emit(t, step): writes the outputs that fall into a short step (start, size in s) taken here; the driver sets it.
    """

    def __init__(self, changes: ModeChanges, opened: OpenContacts, depths: np.ndarray, span: float) -> None:
        self.changes, self.rk, self.system = changes, changes.rk, changes.system
        self.open, self.depths = opened, depths
        self.longest, self.left = 0.0, math.inf
        self.age = 0.0
        # the event that the last step met at its end: item and kind
        self.pending: tuple[int, int] | None = None
        self._foreseen = (math.nan, 0, 0)
        # items whose slip could not be followed from their limits the last time
        self._lost: set[int] = set()
        self.emit: Callable[[float, float], None] = lambda t, step: None
        # the cube root of the relative tolerance, and no more than a hundredth of the run
        cube_root = (1e-2 * max(float(self.system.scale[0]), 1e-14)) ** (1.0 / 3.0)
        self.seed = min(cube_root, 1e-2 * span if span > 0.0 else 1.0)
        changes.ahead = _SHORTEST_START * self.seed

    def resolve(
        self,
        t: float,
        undecided: list[int],
        at_rest: Mapping[int, np.ndarray] | None = None,
        silent: bool = False,
        beyond: int | None = None,
    ) -> float:
        """Decide the modes of contacts at rest (see `ModeChanges.update_modes`), and start those that slip."""
        self.changes.update_modes(t, undecided, at_rest, silent, beyond)
        return self.start(t)

    # ---------------------------------------------------------------- from rest, with a finite acceleration

    def start(self, t: float) -> float:
        """Start slip that has been given a direction: by a tiny step in that direction, so that v_c has one."""
        system = self.system
        frozen = system.frozen()
        if not frozen or self.left <= 0.0:
            # what starts as the run ends has no time to
            return t
        tau = min(self.seed**1.5, self.until_touch(), self.left)
        if self._goes_on(t, frozen, tau):
            tau = min(self.changes.ahead, tau)
        elif self._starts_slowly(t, frozen):
            slowest = min(self.system.contact_real[frozen, SLIP_RATE].tolist())
            took = self._follow(t, dict.fromkeys(frozen, 1), max(self.longest, self._until_shown(slowest, 1)), tau)
            if took is not None:
                return self._end(t, took, system.new_state)
            system.contact_real[frozen, POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE] = 0.0
            self.rk.evaluate_start(t)
        tau, _ = self._step_beside(t, tau)
        return self._end(t, tau, system.new_state)

    def give_way(self, t: float, failure: Stop) -> float:
        """Go on from a state that cannot be projected on constraints which have depended on each other; the new time.

        What such constraints leave open, up to round-off, they hold as soon as it shows, by forces without bound.
        Friction has a bound, and loads only push: what they hold gives way, which changes the velocity next to nothing.
        Where that will not do `failure` is raised.
        """
        system, changes = self.system, self.changes
        modes, reports = system.contact_int[:, MODE].copy(), changes.reports
        if not changes.let_slide(t):
            raise failure
        after, contacts = system.contact_int[:, MODE], np.arange(system.items) < system.nc
        for c in np.flatnonzero((modes != FREE) & (after == FREE) & contacts).tolist():
            reports.announce(t, c, "separate")
        for c in np.flatnonzero((modes == STICK) & (after == SLIPPING)).tolist():
            reports.announce_friction(t, c, True)
        changes.joints.announce_changes(t)
        self.rk.accept()
        return self.start(t)

    def _lose_hold(self, t: float) -> float | None:
        """Let give way what sticks where constraints that depend on each other at the accepted state are independent a
        short time later; the new time, None where they are not."""
        system = self.system
        if system.counters.row_rank == system.counters.row_count:
            return None
        tau, _ = self._step_beside(t, self._short())
        self.rk.load(system.new_state)
        if self.changes.closes(t + tau):
            self.changes.evaluate_accepted(t)
            return None
        failure = projection_failure(system, t + tau)
        self.emit(t, tau)
        self.rk.load(system.new_state)
        return self.give_way(t + tau, failure)

    def _short(self) -> float:
        """Time in s for which stick runs on. The step that led here resolves what decides; a longer one may pass a load
        by."""
        return min(self.seed, self.until_touch(), self.longest if self.longest > 0.0 else math.inf)

    def _goes_on(self, t: float, frozen: list[int], tau: float) -> bool:
        """Whether any of these slips is there already, and faster than what it grows by within tau s."""
        self.rk.load(self.system.state)
        if self.rk.evaluate(t) > EVENT:
            return False
        rates = self.system.contact_real[frozen, SLIP_RATE].tolist()
        return any(self.changes.slip_speed(c) > tau * abs(rate) for c, rate in zip(frozen, rates))

    def _starts_slowly(self, t: float, frozen: list[int]) -> bool:
        """Whether friction turns any of these slips, which start from rest, much faster than they grow."""
        system = self.system
        self.rk.load(system.state)
        if self.longest <= 0.0 or self.rk.evaluate(t) > EVENT:
            return False
        for c in frozen:
            numbers = system.contact_real[c]
            direction = system.basis[c, :2] @ numbers[DIRECTION_X : DIRECTION_X + 3]
            aside = whiten(system, direction[0] * system.rows[c, 1] - direction[1] * system.rows[c, 0])
            friction = math.hypot(system.force[c, 0], system.force[c, 1])
            if friction * (aside @ aside) > _SLOW_START * numbers[SLIP_RATE]:
                return True
        return False

    # ---------------------------------------------------------------- out of stick, at the friction limit

    def leave_stick(self, t: float, c: int) -> float:
        """Contact c has reached its friction limit, which for ideal rolling, where mu is without bound, is F_n = 0.

        With one tangent the slip's sign is known. With two its direction is followed by `slow_slip`. Those at their
        limits slip, against the friction that stick asks for. Where that cannot be followed, stick runs on for a short
        time tau, and the cone problem there tells who slips and where to. Where that cannot, either, slip is a_t tau /
        2 after tau, since the relative acceleration grows from zero: an error of order tau^3.
        """
        system, changes = self.system, self.changes
        if system.contact_int[c, TANGENTS] == 1:
            set_normal(system, system.owner(c), system.force[system.owner(c)])
            freeze_slip(system, c, -system.force[c, :1])
            changes.reports.announce_friction(t, c, True)
            return self.resolve(t, changes.sticking())
        if self.left <= 0.0:
            return t
        if system.contact_real[c, MU_STATIC] > system.contact_real[c, MU]:
            # friction falls to its sliding value: slip starts with a finite acceleration
            return self.resolve(t, changes.sticking(), beyond=c)
        # the state is on its constraints, and evaluated
        self.rk.accept()
        after = self._lose_hold(t)
        if after is not None:
            return after
        # the friction that stick asks for at its limit is against the slip to come
        limits = {i: self._limit(i) for i in {c, *changes.at_known_limit()}}
        start_q, start_v = system.q.copy(), system.v.copy()
        # what is next to its limit may be due a little later
        for slipping in (limits, {c: limits[c]}) if len(limits) > 1 else (limits,):
            took = self._follow_limits(t, slipping)
            if took is not None:
                for i in slipping:
                    changes.reports.announce_at(t, i, changes.reports.friction_event(i, True), start_q, start_v)
                return self._end(t, took, system.new_state)
        tau, decision, seeded = self._find_slip(t, c)
        for item in decision.started:
            changes.reports.announce_at(t, item, changes.reports.friction_event(item, True), start_q, start_v)
        for item in decision.opened:
            changes.reports.announce(t + tau, item, "separate")
        started = [i for i in decision.started if system.contact_int[i, FROZEN]]
        if started and not decision.opened:
            if c in started:
                freeze_slip(system, c, system.basis[c, :2] @ limits[c])
            span = max(self.longest, self._until_shown(min(decision.started.values()) / tau, 2))
            # what could not be followed from its limits cannot from here
            if self._lost != set(started):
                took = self._follow(t, dict.fromkeys(started, 2), span, _SHORTEST_START * tau)
            if took is not None:
                return self._end(t, took, system.new_state)
            # not even a short start can be followed: seed the slip as close to its beginning as v_c can show it
            system.contact_int[started, MODE] = STICK
            changes.evaluate_accepted(t)
            tau, _, seeded = self._run_on(t, c, _SHORT_SEED * tau)
        return self._end(t, tau, seeded)

    def _limit(self, c: int) -> np.ndarray:
        """(3,) direction in world axes of a slip against which the friction of item c is."""
        direction: np.ndarray = opposed_slip(self.system, c, self.system.force[c, :2]).dot(self.system.basis[c, :2])
        return direction

    def _follow_limits(self, t: float, limits: Mapping[int, np.ndarray]) -> float | None:
        """Follow the slip of items at their limits in these directions; how long in s, None where that did not do and
        nothing has changed."""
        system, items, solver = self.system, [*limits], self.changes.modes
        self._lost.clear()
        # in a shorter time slip may not show
        if self.longest < self.seed or not all(map(self._is_known_in_slip, items)):
            return None
        modes, forces = system.contact_int.copy(), solver.reference()
        for c, direction in limits.items():
            freeze_slip(system, c, system.basis[c, :2].dot(direction))
        span = min(self.longest, self.until_touch())
        redundant = system.counters.row_rank < system.counters.row_count
        # what still sticks may hold what has redundant forces at its limit, and loads are others in slip
        if not redundant or (not self.changes.sticking() and solver.choose(t, self.rk.evaluate)):
            took = self._follow(t, dict.fromkeys(items, 2), span, self.changes.ahead)
            if took is None:
                self._lost.update(items)
            elif self._shows(items):
                return took
            self.pending = None
        system.contact_int[:] = modes
        solver.take_back(forces)
        self.changes.evaluate_accepted(t)
        return None

    def _is_known_in_slip(self, c: int) -> bool:
        """Whether item c has, as it begins to slip, two tangents and the friction that has held it."""
        mu, holds = self.system.contact_real.item(c, MU), self.system.contact_real.item(c, MU_STATIC)
        return bool(mu == holds < math.inf and self.system.contact_int.item(c, TANGENTS) == 2)

    def _shows(self, items: list[int]) -> bool:
        """Whether slips that have been followed are there at the end, so that v_c has a direction to go on with, no
        slower than round-off leaves one."""
        system = self.system
        slowest = _ROUND_OFF * (1.0 + max(map(abs, system.v.tolist())))
        return all(system.contact_real.item(i, SLIP_SPEED) > slowest for i in items)

    def _find_slip(self, t: float, c: int) -> tuple[float, Decision, np.ndarray]:
        """Let stick run on from the accepted state, which is evaluated, until something slips or opens; see `_run_on`.
        What is not at its limit there, and begins later to slip, is left to then."""
        modes, at_limit = self.system.contact_int.copy(), {c, *self.changes.at_limit(_AT_LIMIT)}
        tau, decision, seeded = self._run_on(t, c, self._short())
        longest = tau
        for _ in range(_LOOKS_FOR_SLIP):
            if decision.opened or (decision.started and at_limit.issuperset(decision.started)):
                break
            # the limit may have been exceeded in between
            shorter = self._run_on(t, c, _SHORTER_SEED * tau, modes)
            if decision.started and not (shorter[1].started or shorter[1].opened):
                tau, decision, seeded = self._run_on(t, c, tau, modes)
                break
            tau, decision, seeded = shorter
        if not (decision.started or decision.opened):
            # what sticks at all these times sticks: short ones would be taken again and again
            tau, decision, seeded = self._run_on(t, c, longest, modes)
        if decision.opened:
            # a jump of the forces (Painleve) opens contacts at once, not when slip would show; a load that runs out
            # with the friction it allows does not
            sooner = self._run_on(t, c, _OPENING_SEED * tau, modes)
            if sooner[1].started or sooner[1].opened:
                return sooner
            tau, decision, seeded = self._run_on(t, c, tau, modes)
        return tau, decision, seeded

    def _run_on(
        self, t: float, c: int, tau: float, modes: np.ndarray | None = None
    ) -> tuple[float, Decision, np.ndarray]:
        """Stick runs on from the accepted state for tau, or less (see `_trial_step`), where the modes are decided anew.

        c: an item that is at its limit. modes: integers of the items to start with, where they are not the present
        ones. Returns how long, the decision, and the state there with the slip velocity a_t tau / 2 added.
        """
        rk, system, changes = self.rk, self.system, self.changes
        if modes is not None:
            system.contact_int[:] = modes
            changes.evaluate_accepted(t)
        tau, beside = self._step_beside(t, tau)
        system.contact_int[beside, FROZEN] = 0
        rk.load(system.new_state)
        changes.project(t + tau, stepped=True)
        stick = system.stage_state.copy()
        acceleration = system.acceleration.copy()
        decision = changes.resolve_modes(t + tau, changes.sticking(), c)
        change = 0.5 * tau * (system.acceleration - acceleration)
        rk.load(stick)
        energy = changes.counted_energy()
        system.v[:] += change
        rk.keep_velocity()
        changes.count_loss(energy)
        return tau, decision, system.stage_state.copy()

    def _until_shown(self, growth: float, power: int) -> float:
        """Time in s after which v_c shows slip that grows from zero with this power of the time: slower, it would be
        taken for slip that ends. growth: the derivative of that order of its speed, in m/s^2 or m/s^3."""
        system = self.system
        shown = _SHOWN * float(system.scale[1] + system.scale[0] * np.abs(system.v).max(initial=0.0))
        lasts = float((power * shown / growth) ** (1.0 / power)) if growth > 0.0 else 0.0
        return min(lasts, self.seed, self.until_touch(), self.left)

    # ---------------------------------------------------------------- slow slip

    def follow_slow_slip(self, t: float, span: float, shortest: float) -> float | None:
        """Move the accepted state at t on with prescribed directions of all slip that has them in v_c; the time after
        it, None where that did not do and nothing has changed. span, shortest: times in s to try."""
        rk, system = self.rk, self.system
        rk.load(system.state)
        rk.evaluate(t)
        slipping = self._turning()
        for c in slipping:
            freeze_slip(system, c, system.basis[c, :2] @ system.slip[c])
        took = self._follow(t, dict.fromkeys(slipping, 0), span, shortest)
        system.contact_int[:, FROZEN] = 0
        if took is not None:
            rk.load(system.new_state)
            # where slip is as good as over, v_c has no direction of its own to go on with
            if rk.evaluate(t + took) <= EVENT:
                system.contact_int[slipping, FROZEN] = 1
                return self._end(t, took, system.new_state)
        self.pending = None
        self.changes.evaluate_accepted(t)
        return None

    # ---------------------------------------------------------------- steps

    def _trial_step(self, t: float, tau: float) -> float:
        """A step from the accepted state of tau, or of as much less as its error asks for; how long it is."""
        for _ in range(_SHORTENINGS):
            if self.rk.try_step(t, tau) == OK and self.rk.error < 1.0:
                return tau
            tau *= FAILED_FACTOR
        raise self.changes.reports.failure(t, NO_FORCE)

    def _follow(self, t: float, powers: dict[int, int], span: float, shortest: float) -> float | None:
        """A step with prescribed directions of slip, and of what slides already; see `follow_slips`."""
        system, self.pending, self._foreseen = self.system, None, (math.nan, 0, 0)
        beside = self._prescribe_beside()
        took = follow_slips(self.rk, t, dict.fromkeys(beside, 0) | powers, span, shortest, self._until_event)
        if took is None and beside:
            system.contact_int[beside, FROZEN] = 0
            took = follow_slips(self.rk, t, powers, span, shortest, self._until_event)
        return took

    def _prescribe_beside(self) -> list[int]:
        """Prescribe the directions that v_c shows to what slides already beside what begins to; which that is."""
        system = self.system
        beside = [c for c in self._turning() if not system.contact_int[c, FROZEN]]
        for c in beside:
            freeze_slip(system, c, system.basis[c, :2] @ system.slip[c])
        return beside

    def _step_beside(self, t: float, tau: float) -> tuple[float, list[int]]:
        """`_trial_step`, and the items whose slip beside friction turns too fast for it, and which are followed."""
        if not self.system.scalars.turning_rate * tau > STIFF:
            return self._trial_step(t, tau), []
        system, beside = self.system, self._prescribe_beside()
        took = follow_slips(self.rk, t, dict.fromkeys(beside, 0), tau, _SHORTEST_START * tau, lambda *_: 1.0)
        if took is not None:
            return took, beside
        # with constant directions what comes to rest would go on behind that
        system.contact_int[beside, FROZEN] = 0
        return self._trial_step(t, tau), []

    def _turning(self) -> list[int]:
        """What slides in a direction that it may change."""
        system = self.system
        sliding = [c for c, mode in enumerate(system.contact_int[:, MODE].tolist()) if mode == SLIPPING]
        return [c for c in sliding if system.contact_real.item(c, START_SPEED) < math.inf]

    def _end(self, t: float, tau: float, state: np.ndarray) -> float:
        """Accept the state after a step of size tau; slip has a direction of its own from there on."""
        self.emit(t, tau)
        t += tau
        self.rk.load(state)
        changes, integers, frozen = self.changes, self.system.contact_int, self.system.frozen()
        for c in frozen:
            changes.started[c] = changes.slip_direction(c)
            self.age = tau
        integers[:, FROZEN] = 0
        jammed = may_stop(self.system) if self.rk.evaluate(t) == NO_FORCE else held_up(self.system)
        if not jammed:
            changes.project(t)
        elif not self.rk.project(t, False):
            # v_c has come out in a direction in which there are no forces: that slip has jammed
            changes.stop_slips(t, jammed)
        self._stick_again(t, frozen)
        self.rk.accept()
        return t

    def _stick_again(self, t: float, started: list[int]) -> None:
        """Have what began to slip stick where no slip shows, as of redundant contacts that move together if at all, if
        there are forces for that: v_c has no direction there."""
        integers = self.system.contact_int
        hidden = [c for c in started if integers[c, MODE] == SLIPPING and not self._shows([c])]
        if len(hidden) in (0, len(started)):
            return
        integers[hidden, MODE] = STICK
        if not self.changes.modes.choose(t, self.rk.evaluate):
            integers[hidden, MODE] = SLIPPING
            self.changes.modes.choose(t, self.rk.evaluate)

    def _until_event(self, t: float, step: float) -> float:
        """The part of the last trial step, which has been interpolated, in which nothing opens, closes, begins to slip
        or comes to rest, within the errors of gaps and forces; 1 where that is all of it."""
        system, n = self.system, self.system.items
        happens, lowest = self.rk.alarm, system.lowest[:n]
        if happens:
            allowed = np.full((n, EVENTS_PER_CONTACT), math.inf)
            touchable = np.ones(n, dtype=bool)
            touchable[: system.nc] = self.open.apart
            allowed[touchable, GAP_EVENT] = (system.gap_accuracy + self.depths)[touchable]
            allowed[:, DOMAIN_EVENT] = system.gap_accuracy
            force = _FORCE_ACCURACY * float(np.abs(system.force[:n]).max(initial=0.0))
            allowed[:, [NORMAL_EVENT, FRICTION_EVENT]] = force
            # slips with prescribed directions are looked at along these
            allowed[system.contact_int[:n, FROZEN] == 0, SPEED_EVENT] = speed_round_off(system)
            happens = not (lowest >= -allowed).all()
        if not happens:
            foreseen, item, kind = self._foreseen
            self.pending = (item, kind) if step == foreseen and kind in FORCE_EVENTS else None
            return 1.0
        for row, share in ((LEFT_ROW, 0.0), (RIGHT_ROW, 1.0)):
            exists, values = system.look(t, step, share)
            if not exists:
                return SHORTER
            system.scan_shares[row], system.scan_event_functions[row, :n] = share, values
        left, right = (system.scan_event_functions[row, :n] for row in (LEFT_ROW, RIGHT_ROW))
        crosses = np.where((left > 0.0) & (right < 0.0), UNKNOWN, NOT_SOUGHT)
        system.sought[:n] = np.where(np.isinf(allowed), LEFT_OUT, crosses)
        found = system.run(FIND_EARLIEST, t, step)
        if found < 0:
            return SHORTER
        item, kind = divmod(found, EVENTS_PER_CONTACT)
        part = system.scan_shares.item(RIGHT_ROW)
        if kind not in FORCE_EVENTS:
            part *= _UP_TO_EVENT
        self._foreseen = part * step, item, kind
        return part

    def until_touch(self) -> float:
        """Time in s that gaps of open contacts, and ways of joints to their ends, last at their present rates."""
        system, accuracy = self.system, self.system.gap_accuracy
        left = math.inf
        for c, mode in enumerate(system.modes.tolist()):
            approach = -gap_rate(system, c) if mode == FREE and self.open.apart[c] else 0.0
            if approach > 0.0 and system.contact_real[c, DOMAIN] >= 0.0:
                way = float(system.gaps[c, 0] + self.depths[c] + accuracy[c])
                left = min(left, max(way, _LEAST_WAY * float(accuracy[c])) / approach)
        for g, limit in enumerate(system.limits):
            speed = float(system.v[limit.index_v])
            if self.changes.joints.is_free(g) and speed != 0.0:
                position, reach = float(system.q[limit.index_q]), float(accuracy[system.nc + g])
                way = (limit.high_end - position if speed > 0.0 else position - limit.low_end) + reach
                left = min(left, max(way, _LEAST_WAY * reach) / abs(speed))
                rate = float(system.acceleration[limit.index_v])
                if limit.dry and rate * speed < 0.0:
                    # dry friction ends its slip
                    left = min(left, max(abs(speed), rest_speed(system)) / abs(rate))
        return left
