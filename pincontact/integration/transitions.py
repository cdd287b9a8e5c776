"""Mode changes: what happens at an event, and how slip starts from rest."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from operator import sub

import numpy as np

from ..dynamics.directions import freeze_slip
from ..dynamics.energy import REST_SPEED, energies_at
from ..dynamics.impact import apply_impact
from ..dynamics.joints import END_SLACK, without_inertia
from ..dynamics.modes import Decision, ModeSolver, rest_mode, shares_viscous_force
from ..dynamics.stretches import opposed_slip
from ..dynamics.system import FORCE_SLACK
from ..dynamics.units import whiten
from ..geometry.patterns import ON_CURVE
from ..layout import (
    CONDITION,
    DIRECTION_X,
    DOMAIN,
    DOMAIN_MARGIN,
    EVENT,
    FREE,
    FRICTION_MARGIN,
    FROZEN,
    GAP_MARGIN,
    GUARD_END,
    GUARD_SIGN,
    LIMIT_SLACK,
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
    POLYNOMIAL,
    POLYNOMIAL_SIZE,
    SINGULAR,
    SLIP_RATE,
    SLIP_SIGN,
    SLIP_SPEED,
    SLIPPING,
    SPEED_MARGIN,
    START_SPEED,
    STICK,
    TANGENTS,
    UNILATERAL,
)
from .dips import Dips
from .open_contacts import OpenContacts
from .results import (
    ADVICE,
    CHATTER,
    END_OF_CONTOUR,
    FAILURES,
    GAP_TOLERANCE,
    SINGULAR_CONTACT,
    STEP_TOO_SMALL,
    Event,
    Stop,
)
from .runge_kutta import RungeKutta
from .slow_slip import SlowSlip
from .stages import DAMPING_WORK, DRIVE_WORK, FRICTION_WORK, NUMBER_OF_WORKS
from .steps import FAILED_FACTOR

# Slip slower than this (m/s, absolute and relative to the largest velocity) counts as rest where modes are set anew.
_REST = 1e-9
# Chatter: so many mode changes within this fraction of the run, or so many within this fraction of it (and at most
# this time in s) for every contact and guarded joint coordinate. Rebounds are not counted, they end by themselves.
_CHATTER_EVENTS, _CHATTER_SPAN = 40, 1e-9
_DENSE_EVENTS, _DENSE_SPAN, _DENSE_TIME = 500, 1e-2, 1.0
# Contacts named in the message.
_CHATTER_NAMES = 3
# Below this conditioning of the location equations, a failure is that of a contact that degenerates.
_DEGENERATE = 1e-5
# The start of slip is followed over times down to this fraction of the seed's.
_SHORTEST_START = 1e-3
# Where it cannot be followed, slip is seeded after this fraction of the usual time.
_SHORT_SEED = 1e-2
# So often a seed is shortened, to a millionth, where the motion turns within it: a disk that is almost flat turns round
# in microseconds.
_SHORTENINGS = 10
# Slip from rest starts slowly where friction turns it this many times faster than it grows.
_SLOW_START = 30.0
# A motion that jumps at a breakpoint moves bodies by no more than so many times what gaps are known to.
_JUMP_REACHES = 10.0
# What is added to the slack of a limit of friction that was reached without slip, as a factor, and where that ends.
_SLACK_GROWTH, _LARGEST_SLACK = 4.0, 1e-10
_DIRECTION = slice(DIRECTION_X, DIRECTION_X + 3)
_NONE: Mapping[int, np.ndarray] = {}
# A margin this far from zero, relative to the largest force, where its sign changes has no root there.
_JUMP = 1e-6
# Friction margins below this part of the limit, and loads below this part of the largest, are zero where no choice
# among redundant forces can raise them.
_AT_LIMIT = 1e-6
# So often, and so much shorter each time, is looked for slip that a seed has not shown.
_LOOKS_FOR_SLIP, _SHORTER_SEED = 3, 0.1
# Where contacts open as stick ends, they do after this fraction of the usual time.
_OPENING_SEED = 1e-4
# Forces below zero, or above their limit, by less than this part of the largest one are no events while slip starts.
_FORCE_ACCURACY = 1e-6
# A gap that is closed already counts as so much of what gaps are known to.
_LEAST_WAY = 1e-2
# After an impact what leaves faster than this, in m/s, opens.
_LEAVING_SPEED = 1e-3 * REST_SPEED


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
    ) -> None:
        # Writes the outputs that fall into a short step (start, size in s) taken here; the driver sets it.
        self.emit: Callable[[float, float], None] = lambda t, step: None
        self.rk, self.system, self.names, self.restitution, self.span = rk, rk.system, names, restitution, span
        self.modes = ModeSolver(rk.system)
        self.events: list[Event] = []
        self._recent: list[tuple[float, int]] = []
        # whether the state carries the account of works
        self._counts_works = rk.system.ny > rk.system.nq + rk.system.nv + 4 * rk.system.nc
        # what was last said of each guarded coordinate: see `_guard_state`
        self._guards: list[tuple[bool, int]] = []
        self.dips = Dips(rk, self.modes)
        self._reach = self.dips.reach
        self.open = OpenContacts(rk.system)
        # contacts that have opened, and not been apart by more than gaps are known: their mode before, and the event
        self._barely_open: dict[int, tuple[int, Event]] = {}
        # closed contacts of the initial state that come in
        self._striking: list[int] = []
        # directions in which slip began or went on since the last impact
        self._started: dict[int, np.ndarray] = {}
        # Longest time in s that the start of slip may take with a prescribed direction; the driver keeps it current.
        self.longest_start = 0.0
        # Slip from rest is seeded after this time in s: its error is of third order in it.
        self.seed = min(
            (1e-2 * max(float(rk.system.scale[0]), 1e-14)) ** (1.0 / 3.0), 1e-2 * span if span > 0.0 else 1.0
        )

    # ---------------------------------------------------------------- reports

    def announce(self, t: float, contact: int | None, kind: str, index: int = -1) -> None:
        """Add an event with the system's present state."""
        system, name, joint = self.system, None, None
        if contact is not None:
            name, joint = self._name(contact)
        self.events.append(Event(t, name, kind, system.q.copy(), system.v.copy(), index, joint))

    def _name(self, index: int) -> tuple[str | None, str | None]:
        """Name of the contact of an item, or else of the joint of a guarded coordinate."""
        nc, ng = self.system.nc, self.system.ng
        if nc <= index < nc + ng:
            return None, self.system.guards[index - nc].joint
        return self.names[self.system.owner(index)], None

    def _describe(self, index: int) -> str:
        name, joint = self._name(index)
        return f"contact {name!r}" if name is not None else f"joint {joint!r}"

    def give_up(self, t: float, failure: int) -> Stop:
        """The Stop for an evaluation's status, naming the contact, its pattern and the number."""
        if (failure == LOCATION_FAILED or failure not in FAILURES) and self._degenerates(t):
            failure = SINGULAR
        if failure not in FAILURES:
            return Stop(STEP_TOO_SMALL, f"t = {t:.9g} s: the step size fell below its floor{self._largest_slide()}")
        code, reason = FAILURES[failure]
        if failure == NO_FORCE and self.modes.proved:
            reason = "no contact forces satisfy Coulomb's law (Painleve)"
        elif failure == NO_FORCE and self.system.counters["lost_positivity"]:
            reason = "friction between several contacts leaves more than one solution (Painleve)"
        if failure == MASS_NOT_POSITIVE:
            reason = without_inertia(self.system.model, self.system.data, self.system.q)
        advice = f"; {ADVICE}" if failure == NO_FORCE else ""
        culprit = self._culprit(failure)
        if code == SINGULAR_CONTACT:
            self.announce(t, culprit, "singular")
        where, number = "", ""
        if culprit is not None:
            where = f"contact {self.names[culprit]!r} ({self.system.contacts[culprit].pattern.name}): "
            if code == SINGULAR_CONTACT:
                number = f"; conditioning of J {abs(self.system.contact_real[culprit, CONDITION]):.3g}"
        return Stop(code, f"t = {t:.9g} s: {where}{reason}{number}{advice}")

    def _largest_slide(self) -> str:
        """What a message adds where something slides: friction may let forces grow without bound (Painleve)."""
        sliding = [c for c, mode in enumerate(self.system.modes.tolist()) if mode == SLIPPING]
        if not sliding:
            return ""
        forces = np.linalg.norm(self.system.force[sliding], axis=1)
        name = self.names[sliding[int(forces.argmax())]]
        return f"; the largest force on what slides is {forces.max():.3g} N at contact {name!r}; {ADVICE}"

    def _degenerates(self, t: float) -> bool:
        """Whether a closed contact is as good as singular at the accepted state, which is evaluated."""
        system = self.system
        closed = system.closed()
        if not closed:
            return False
        self.rk.load(system.state)
        self.rk.evaluate(t)
        return bool(np.abs(system.contact_real[closed, CONDITION]).min() < _DEGENERATE)

    def _culprit(self, failure: int) -> int | None:
        system = self.system
        if failure == NO_FORCE:
            slipping = [c for c in range(system.nc) if system.contact_int[c, MODE] == SLIPPING]
            return slipping[0] if slipping else None
        if failure in (SINGULAR, LOCATION_FAILED) and system.nc:
            return int(np.argmin(np.abs(system.contact_real[: system.nc, CONDITION])))
        return None

    def _check_chatter(self, t: float, c: int) -> None:
        recent = self._recent
        recent.append((t, c))
        dense = _DENSE_EVENTS * self.system.items
        limits = (_CHATTER_EVENTS, _CHATTER_SPAN * self.span), (dense, min(_DENSE_SPAN * self.span, _DENSE_TIME))
        for count, span in limits:
            if len(recent) > count and t - recent[-count - 1][0] <= span:
                often = Counter(i for _, i in recent[-count:]).most_common(_CHATTER_NAMES)
                raise Stop(
                    CHATTER,
                    f"t = {t:.9g} s: {count} mode changes within {t - recent[-count - 1][0]:.3g} s (chatter), most of "
                    f"{', '.join(self._describe(i) for i, _ in often)}; {ADVICE}",
                )
        if len(recent) > 2 * dense:
            del recent[:dense]

    # ---------------------------------------------------------------- start

    def begin(self, t: float) -> None:
        """Modes of the initial state (see `begin_at`), and its slope. Slip that starts from rest is still frozen, and
        what strikes at the start (see `strike`) has not yet.

        A state that does not keep to its constraints is put on them; what that takes counts as work of friction.
        """
        system, rk = self.system, self.rk
        status = rk.evaluate(t)
        if status in (LOCATION_FAILED, SINGULAR, MASS_NOT_POSITIVE):
            raise self.give_up(t, status)
        # a list takes a fraction of the time of array functions
        start, energy = system.state.tolist(), self._counted_energy()
        if system.ng:
            self._guards_from_velocities()
        given = system.contact_int.tobytes()
        self._open_moving(t)
        undecided = self.modes_from_velocities()
        unchanged = not (system.ng or undecided) and given == system.contact_int.tobytes()
        stands = status == OK and unchanged and system.counters["lost_positivity"] == 0
        if stands and not self.held_up():
            # the evaluation stands
            self._project(t, True, explained=True)
            rk.accept()
        else:
            self._stop_jammed(t)
            self._settle(t, undecided, _NONE, True, explained=True)
        if self._counts_works:
            self._count_loss(energy)
            rk.accept()
        if max(map(abs, map(sub, system.state.tolist(), start)), default=0.0) > _REST:
            # it was not on its constraints, where the modes were decided
            rk.load(system.state)
            if rk.evaluate_start(t) > EVENT:
                raise self.give_up(t, NO_FORCE)
        self._guards = [self._guard_state(g) for g in range(system.ng)]
        if FREE in system.modes.tolist():
            if not self.dips.take_up(t, self.seed):
                raise self.give_up(t, NO_FORCE)
            self.open.begin(self._slack)

    def pass_jump(self, t: float) -> float:
        """A control or a motion may have jumped at t: modes of the accepted state anew, and impacts; the new time."""
        system, rk = self.system, self.rk
        self._started.clear()
        rk.load(system.state)
        status = rk.evaluate(t)
        if status in (LOCATION_FAILED, SINGULAR, MASS_NOT_POSITIVE):
            raise self.give_up(t, status)
        for c in system.closed():
            if abs(system.gaps[c]).max() > _JUMP_REACHES * self._reach(c):
                raise Stop(
                    STEP_TOO_SMALL,
                    f"t = {t:.9g} s: a motion jumps, which moves the bodies of contact {self.names[c]!r} "
                    f"{system.gaps[c, 0]:.3g} m apart at once",
                )
        energy, before = self._counted_energy(), system.contact_int[:, MODE].copy()
        if system.ng:
            self._guards_from_velocities()
        self._open_moving(t)
        undecided = self.modes_from_velocities()
        for c in [*system.closed(), *system.resisting()]:
            if before[c] == STICK and system.contact_int[c, MODE] == SLIPPING:
                self._announce_friction(t, c, True)
        self._stop_jammed(t)
        self._settle(t, undecided, _NONE, False)
        self._count_loss(energy)
        rk.accept()
        struck = self.strike(t)
        return self.start_frozen(t) if struck is None else struck

    def _open_moving(self, t: float) -> None:
        """Open the closed contacts of the initial state whose normal velocity is not zero: they part, or strike."""
        system = self.system
        self._striking.clear()
        for c in system.closed():
            speed = self._leaves_at(c)
            if abs(speed) > REST_SPEED and system.contact_int[c, UNILATERAL]:
                system.contact_int[c, MODE] = FREE
                if speed > 0.0:
                    self.announce(t, c, "separate")
                else:
                    self._striking.append(c)

    def strike(self, t: float) -> float | None:
        """Impacts at the start of a run, of closed contacts and joints at their ends that come in; the new time, or
        None without any."""
        system = self.system
        stops = False
        for g, guard in enumerate(system.guards):
            if system.contact_int[system.nc + g, MODE] != FREE:
                continue
            position, speed = float(system.q[guard.index_q]), float(system.v[guard.index_v])
            low, high = position <= guard.low_end + END_SLACK, position >= guard.high_end - END_SLACK
            if (low and speed < 0.0) or (high and speed > 0.0):
                self._stop_joint(t, g, -1 if low else 1)
                stops = True
        if self._striking:
            return self._touch(t, self._striking[0])
        return self._collide(t, [], {}) if stops else None

    def modes_from_velocities(self, after_impact: bool = False) -> list[int]:
        """Give closed contacts and their resistances the mode that their slip shows; returns those at rest whose
        friction is undecided.

        Ideal rolling slides where it did, or after an impact that left it without a normal impulse.
        """
        system, numbers = self.system, self.system.contact_real
        undecided, rest_speed = [], -1.0
        for c in [*system.closed(), *system.resisting()]:
            integers, mu = system.contact_int[c], numbers.item(c, MU)
            slid = after_impact or integers.item(MODE) == SLIPPING
            integers[FROZEN] = 0
            integers[MODE] = rest_mode(mu)
            if integers[UNILATERAL]:
                integers[NORMAL_SIGN] = abs(integers.item(NORMAL_SIGN))
            if mu == 0.0 or (math.isinf(mu) and not (slid and integers[UNILATERAL])):
                continue
            along = system.basis[c] @ system.slip[c]
            speed = abs(along[0]) if integers[TANGENTS] == 1 else math.hypot(along[0], along[1])
            rest_speed = rest_speed if rest_speed > 0.0 else self._rest_speed()
            if speed > rest_speed:
                integers[MODE] = SLIPPING
                integers[SLIP_SIGN] = 1 if along[0] >= 0.0 else -1
                self._guess_normal(system.owner(c))
            elif math.isfinite(mu):
                undecided.append(c)
        return undecided

    def _rest_speed(self) -> float:
        """Slip slower than this, in m/s, counts as rest."""
        return _REST * (1.0 + max(map(abs, self.system.v.tolist()), default=0.0))

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
        if self.system.nc <= c < self.system.nc + self.system.ng:
            return self._switch_guard(t, c - self.system.nc, kind)
        if kind == GAP_MARGIN:
            return self._touch(t, c)
        self._check_chatter(t, c)
        integers = self.system.contact_int[c]
        if kind == FRICTION_MARGIN and shares_viscous_force(self.system, c):
            # all of its viscous friction from here on, and a load that grows from zero
            self.modes.load(c)
            return self._go_on(t)
        if kind == FRICTION_MARGIN and integers[MODE] == SLIPPING:
            self._end_jams(t, [c])
            return self.start_frozen(t)
        if kind in (NORMAL_MARGIN, FRICTION_MARGIN):
            if self._redistribute(t, c, kind):
                return t
            c, kind = self._limiting(c, kind)
        if kind == DOMAIN_MARGIN:
            self.announce(t, c, "edge")
            if not integers[UNILATERAL]:
                raise Stop(END_OF_CONTOUR, f"t = {t:.9g} s: contact {self.names[c]!r} reached the end of a contour")
            integers[MODE] = FREE
            return self.resolve(t, self._sticking())
        if kind == NORMAL_MARGIN:
            if integers[UNILATERAL]:
                if self._closes_again(t, c):
                    return self._leave_stick(t, c)
                if self.modes.share(t, c, self.rk.evaluate):
                    return self._go_on(t)
                before = int(integers[MODE])
                integers[MODE] = FREE
                self.announce(t, c, "separate")
                self._barely_open[c] = before, self.events[-1]
            else:
                # at zero the force itself tells no sign
                integers[NORMAL_SIGN] *= -1
            return self.resolve(t, self._sticking())
        if kind == SPEED_MARGIN:
            direction = self.slip_direction(c)
            self.system.contact_int[c, MODE] = STICK
            return self.resolve(t, self._sticking(), at_rest={c: direction})
        assert kind == FRICTION_MARGIN
        after = self._leave_stick(t, c)
        numbers = self.system.contact_real[c]
        if self.system.contact_int[c, MODE] == STICK:
            # rounding has it that it sticks all the same: it is not asked again before that shows
            numbers[LIMIT_SLACK] = min(_SLACK_GROWTH * numbers[LIMIT_SLACK], _LARGEST_SLACK)
        else:
            numbers[LIMIT_SLACK] = FORCE_SLACK
        return after

    def _go_on(self, t: float) -> float:
        """Take the state with other forces, of which none has jumped."""
        if self.rk.evaluate(t) > EVENT:
            raise self.give_up(t, NO_FORCE)
        self._project(t, True)
        self.rk.accept()
        return t

    def _redistribute(self, t: float, c: int, kind: int) -> bool:
        """Whether other ones among redundant forces keep all modes, of which margin `kind` of item c ends one."""
        system = self.system
        if self.rk.evaluate(t) > EVENT:
            return False
        # a force that jumps, as where contacts cease to be redundant, is not one of choice
        if system.margins[c, kind] > _JUMP * float(np.abs(system.force).max()):
            return False
        ended = c if kind == NORMAL_MARGIN and c < system.nc and system.contact_int[c, UNILATERAL] else None
        if not self.modes.redistribute(t, self.rk.evaluate, ended):
            return False
        self._project(t)
        self.rk.accept()
        return True

    def _limiting(self, c: int, kind: int) -> tuple[int, int]:
        """The margin that ends a mode, where margin `kind` of contact c is zero and no other redundant forces would do.

        Forces that shrink to nothing leave their cone anywhere: whether the others have reached the limit of friction,
        so that all slip and the unloaded contact with them, or that contact opens, is seen at the others.
        """
        system = self.system
        if not self.modes.redundant or c >= system.nc or not system.contact_int[c, UNILATERAL]:
            return c, kind
        loads = np.abs(system.force[: system.nc, 2])
        loads[loads <= _AT_LIMIT * loads.max(initial=0.0)] = 0.0
        if loads[c] > 0.0:
            return c, kind
        limits = {i: float(system.contact_real[i, MU_STATIC] * loads[system.owner(i)]) for i in self._sticking()}
        limited = [i for i, limit in limits.items() if abs(system.margins[i, FRICTION_MARGIN]) < _AT_LIMIT * limit]
        return (max(limited, key=lambda i: loads[system.owner(i)]), FRICTION_MARGIN) if limited else (c, NORMAL_MARGIN)

    def slip_direction(self, c: int) -> np.ndarray:
        """Unit vector, world axes, of the slip of an item that slides; zero where there is none."""
        system = self.system
        along = system.basis[c, :2] @ system.slip[c]
        if system.contact_int[c, TANGENTS] == 1:
            along = np.array([float(system.contact_int[c, SLIP_SIGN]), 0.0])
        elif system.contact_int[c, FROZEN]:
            along = system.basis[c, :2] @ system.contact_real[c, _DIRECTION]
        speed = math.hypot(along[0], along[1])
        return along @ system.basis[c, :2] / speed if speed > 0.0 else np.zeros(3)

    def come_to_rest(self, t: float, ended: dict[int, np.ndarray]) -> float:
        """The slip of these contacts has ended, in these directions: each sticks, or slides on."""
        contacts = list(ended)
        for c in contacts:
            self._check_chatter(t, c)
        self.system.contact_int[contacts, MODE] = STICK
        if np.isinf(self.system.contact_real[contacts, MU]).any():
            # what is left of v_c is no start of a slip in another direction, in which it may take another force
            self._project(t)
        return self.resolve(t, self._sticking(), at_rest=ended)

    def _sticking(self) -> list[int]:
        """Contacts and resistances that stick by Coulomb friction: a change elsewhere may upset them."""
        system = self.system
        return [
            c
            for c in [*system.closed(), *system.resisting()]
            if system.contact_int[c, MODE] == STICK and math.isfinite(system.contact_real[c, MU])
        ]

    def resolve(
        self,
        t: float,
        undecided: list[int],
        at_rest: Mapping[int, np.ndarray] = _NONE,
        silent: bool = False,
        beyond: int | None = None,
    ) -> float:
        """Decide the modes of contacts at rest, project, and start those that slip.

        at_rest: contacts that have just come to rest and the directions of their slip till then; what slips on as it
        did is no event. silent: announce separations only. beyond: a contact whose static friction has been exceeded.
        """
        self._settle(t, undecided, at_rest, silent, beyond)
        return self.start_frozen(t)

    def _settle(
        self,
        t: float,
        undecided: list[int],
        at_rest: Mapping[int, np.ndarray],
        silent: bool,
        beyond: int | None = None,
        explained: bool = False,
    ) -> None:
        system, rk = self.system, self.rk
        before, signs = system.contact_int[:, MODE].copy(), system.contact_int[:, SLIP_SIGN].copy()
        self._decide(t, undecided, beyond)
        self._project(t, True, explained)
        rk.accept()
        for c in [*range(system.nc), *system.resisting()]:
            mode = int(system.contact_int[c, MODE])
            if mode == FREE and before[c] != FREE:
                self.announce(t, c, "separate")
            elif silent:
                continue
            elif c in at_rest:
                if mode != SLIPPING or self._goes_back(c, at_rest[c]):
                    self._announce_friction(t, c, mode == SLIPPING)
            elif shares_viscous_force(system, c):
                continue
            elif mode == SLIPPING and (before[c] == STICK or signs[c] != system.contact_int[c, SLIP_SIGN]):
                self._announce_friction(t, c, True)
        self._announce_guards(t)

    def _goes_back(self, c: int, ended: np.ndarray) -> bool:
        """Whether item c slips on against the direction in which its slip has ended.

        Where slip is slower than it is known, that direction is noise; the one in which it started is not.
        """
        direction = self.slip_direction(c)
        return bool(direction @ ended <= 0.0 and direction @ self._started.get(c, ended) <= 0.0)

    def _announce_friction(self, t: float, c: int, slips: bool) -> None:
        """A contact, or what resists its turning, has begun to slip or come to rest."""
        turns = c >= self.system.nc
        self.announce(t, c, ("turn" if turns else "slip") if slips else ("hold" if turns else "stick"))

    def _decide(self, t: float, undecided: list[int], beyond: int | None = None) -> Decision:
        """Decide modes; the last evaluation is the one in them."""
        decision = self.modes.decide(t, undecided, self.rk.evaluate, beyond)
        if decision.status > EVENT:
            raise self.give_up(t, decision.status)
        self._fix_normal_signs(t)
        return decision

    # ---------------------------------------------------------------- joints

    def _guards_from_velocities(self, struck: Sequence[int] = ()) -> None:
        """Hold the coordinates that rest at an end or by dry friction, free the others; struck: those that have been
        held at an end in an impact, and are unless they leave it."""
        system = self.system
        rest_speed = self._rest_speed()
        stays = {
            g: int(system.guard_int[g, GUARD_END])
            for g in struck
            if not self._leaves(system.nc + g, abs(system.v[system.guards[g].index_v]), self._guard_reach)
        }
        for g, guard in enumerate(system.guards):
            position, speed = float(system.q[guard.index_q]), float(system.v[guard.index_v])
            end = -1 if position <= guard.low_end + END_SLACK else int(position >= guard.high_end - END_SLACK)
            if g in stays:
                self.modes.hold(g, stays[g])
            elif abs(speed) > rest_speed:
                self.modes.release(g, 1 if speed > 0.0 else -1)
            elif end != 0 or guard.dry:
                self.modes.hold(g, end)
            else:
                self.modes.release(g, 0)

    def _announce_guards(self, t: float) -> None:
        """Events of the guarded coordinates whose state is not what it was. At the start of a run nothing is."""
        for g, before in enumerate(self._guards):
            now = self._guard_state(g)
            if now == before:
                continue
            self._guards[g] = now
            if now[0]:
                kind = "limit" if now[1] else "stick"
            elif before[0] and before[1]:
                kind = "release"
            elif before[0] or before[1] * now[1] < 0:
                kind = "slip"
            else:
                continue
            self.announce(t, self.system.nc + g, kind)

    def _guard_state(self, g: int) -> tuple[bool, int]:
        """Whether coordinate g is held, and at which end (0: by friction), or in which direction it slips."""
        system = self.system
        held = system.contact_int[system.nc + g, MODE] != FREE
        return bool(held), int(system.guard_int[g, GUARD_END if held else GUARD_SIGN])

    def _switch_guard(self, t: float, g: int, kind: int) -> float:
        """Margin `kind` of guarded joint coordinate g has reached zero at t."""
        system = self.system
        index = system.nc + g
        if kind in (GAP_MARGIN, DOMAIN_MARGIN):
            self._check_chatter(t, index)
            self._stop_joint(t, g, -1 if kind == GAP_MARGIN else 1)
            return self._collide(t, [], {})
        self._check_chatter(t, index)
        if kind == SPEED_MARGIN:
            speed = float(system.v[system.guards[g].index_v])
            if abs(speed) > self._rest_speed():
                # a short step of another's slip has carried it through zero: it slides the other way now
                self.modes.release(g, 1 if speed > 0.0 else -1)
            else:
                self.modes.hold(g, 0)
        elif self._redistribute(t, index, kind):
            return t
        else:
            self.modes.release(g, 1 if kind == NORMAL_MARGIN else -1)
        return self.resolve(t, self._sticking())

    @property
    def _guard_reach(self) -> float:
        """Accuracy to which a coordinate's way to its end is known, in m or rad."""
        return GAP_TOLERANCE * float(self.system.scale.sum())

    def _stop_joint(self, t: float, g: int, end: int) -> None:
        """Guarded joint coordinate g has come to an end of its way, and is held there."""
        self.announce(t, self.system.nc + g, "limit")
        self._guards[g] = True, end
        self.modes.hold(g, end)

    def _project(self, t: float, evaluated: bool = False, explained: bool = False) -> None:
        """Put the state on its constraints; explained: by an impact, say, whatever that takes from the velocity."""
        before = None if explained else self.system.v.copy()
        if not self.rk.project(t, evaluated):
            if self.rk.evaluate(t) == NO_FORCE:
                raise self.give_up(t, NO_FORCE)
            raise Stop(STEP_TOO_SMALL, f"t = {t:.9g} s: the projection on the constraints failed")
        if before is None:
            return
        taken, speed, allowed = self.modes.taken_from(before)
        if taken > allowed:
            raise Stop(
                STEP_TOO_SMALL,
                f"t = {t:.9g} s: the projection on the constraints failed: it would change the velocity, of size "
                f"{speed:.3g} in the mass metric, by {taken:.3g}",
            )

    def _fix_normal_signs(self, t: float) -> None:
        """Flip the assumed sign of a sliding bilateral contact's normal force where it came out the other way."""
        system = self.system
        for c in system.closed():
            integers = system.contact_int[c]
            slips = integers[MODE] == SLIPPING or system.resists(c)
            if slips and not integers[UNILATERAL] and integers[PATTERN] != ON_CURVE:
                self.rk.evaluate(t)
                if system.margins[c, NORMAL_MARGIN] < -self.modes.force_round_off():
                    integers[NORMAL_SIGN] *= -1
                    self.rk.evaluate(t)

    # ---------------------------------------------------------------- slip from rest

    def start_frozen(self, t: float) -> float:
        """Slip that starts with a finite acceleration: one tiny step in the given direction, so that v_c has one."""
        rk, system = self.rk, self.system
        frozen = [c for c, marked in enumerate(system.contact_int[:, FROZEN].tolist()) if marked]
        if not frozen:
            return t
        tau = min(self.seed**1.5, self.until_touch())
        if self._starts_slowly(t, frozen):
            took = SlowSlip(rk, frozen, 1, self._uneventful).follow(t, self.longest_start, tau)
            if took is not None:
                self.emit(t, took)
                rk.load(system.new_state)
                return self._end_start(t + took)
            for c in frozen:
                system.contact_real[c, POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE] = 0.0
            rk.load(system.state)
            rk.evaluate_start(t)
        tau = self._attempt(t, tau)
        self.emit(t, tau)
        rk.load(system.new_state)
        return self._end_start(t + tau)

    def _starts_slowly(self, t: float, frozen: list[int]) -> bool:
        """Whether friction turns any of these slips, which start from rest, much faster than they grow."""
        system = self.system
        self.rk.load(system.state)
        if self.longest_start <= 0.0 or self.rk.evaluate(t) > EVENT:
            return False
        for c in frozen:
            numbers, direction = system.contact_real[c], system.basis[c, :2] @ system.contact_real[c, _DIRECTION]
            aside = whiten(system, direction[0] * system.rows[c, 1] - direction[1] * system.rows[c, 0])
            friction = math.hypot(system.force[c, 0], system.force[c, 1])
            if friction * (aside @ aside) > _SLOW_START * numbers[SLIP_RATE]:
                return True
        return False

    def _leave_stick(self, t: float, c: int) -> float:
        """Contact c has reached its friction limit, which for ideal rolling, where mu is without bound, is F_n = 0.

        With one tangent the slip's sign is known. With two its direction is not: stick runs on for a short time tau,
        and the cone problem there tells who slips and where to. From there `slow_slip` follows the direction; where it
        cannot, slip is a_t tau / 2 after tau, since the relative acceleration grows from zero: an error of order tau^3.
        """
        rk, system = self.rk, self.system
        if system.contact_int[c, TANGENTS] == 1:
            self._guess_normal(system.owner(c))
            freeze_slip(system, c, -system.force[c, :1])
            self._announce_friction(t, c, True)
            return self.resolve(t, self._sticking())
        if system.contact_real[c, MU_STATIC] > system.contact_real[c, MU]:
            # friction falls to its sliding value: slip starts with a finite acceleration
            return self.resolve(t, self._sticking(), beyond=c)
        self._project(t)
        rk.accept()
        # the friction that stick asks for at its limit is against the slip to come
        limit = opposed_slip(system, c, system.force[c, :2]) @ system.basis[c, :2]
        start_q, start_v = system.q.copy(), system.v.copy()
        # the step that led here resolves what decides; a seed that is longer may pass a load by
        tau = min(self.seed, self.until_touch(), self.longest_start if self.longest_start > 0.0 else math.inf)
        modes = system.contact_int.copy()
        tau, decision, seeded = self._run_on(t, tau)
        for _ in range(_LOOKS_FOR_SLIP):
            if decision.started or decision.opened:
                break
            # the limit may have been exceeded in between
            system.contact_int[:] = modes
            rk.load(system.state)
            if rk.evaluate_start(t) > EVENT:
                raise self.give_up(t, NO_FORCE)
            tau, decision, seeded = self._run_on(t, _SHORTER_SEED * tau)
        if decision.opened:
            # a jump of the forces (Painleve) opens contacts at once, not when slip would show
            system.contact_int[:] = modes
            rk.load(system.state)
            if rk.evaluate_start(t) > EVENT:
                raise self.give_up(t, NO_FORCE)
            tau, decision, seeded = self._run_on(t, _OPENING_SEED * tau)
        for slipping in decision.started:
            kind = "slip" if slipping < system.nc else "turn"
            self.events.append(Event(t, self._name(slipping)[0], kind, start_q, start_v))
        for opened in decision.opened:
            self.announce(t + tau, opened, "separate")
        started = [i for i in decision.started if system.contact_int[i, FROZEN]]
        if started and not decision.opened:
            if c in started:
                freeze_slip(system, c, system.basis[c, :2] @ limit)
            slow = SlowSlip(rk, started, 2, self._uneventful)
            span = slow.follow(t, self.longest_start, _SHORTEST_START * tau)
            if span is not None:
                self.emit(t, span)
                rk.load(system.new_state)
                return self._end_start(t + span)
            # not even a short start can be followed: seed the slip as close to its beginning as v_c can show it
            system.contact_int[started, MODE] = STICK
            rk.load(system.state)
            if rk.evaluate_start(t) > EVENT:
                raise self.give_up(t, NO_FORCE)
            tau, _, seeded = self._run_on(t, _SHORT_SEED * tau)
        self.emit(t, tau)
        rk.load(seeded)
        return self._end_start(t + tau)

    def follow_slow_slip(self, t: float, span: float, shortest: float) -> float | None:
        """Move the accepted state at t on with prescribed directions of all slip that has them in v_c; the time after
        it, None where that did not do and nothing has changed. span, shortest: times in s to try."""
        rk, system = self.rk, self.system
        rk.load(system.state)
        rk.evaluate(t)
        slipping = [c for c in range(system.items) if system.contact_real[c, START_SPEED] < math.inf]
        for c in slipping:
            freeze_slip(system, c, system.basis[c, :2] @ system.slip[c])
        took = SlowSlip(rk, slipping, 0, self._uneventful).follow(t, span, shortest)
        system.contact_int[:, FROZEN] = 0
        if took is not None:
            rk.load(system.new_state)
            # where slip is as good as over, v_c has no direction of its own to go on with
            if rk.evaluate(t + took) <= EVENT:
                system.contact_int[slipping, FROZEN] = 1
                self.emit(t, took)
                rk.load(system.new_state)
                return self._end_start(t + took)
        rk.load(system.state)
        if rk.evaluate_start(t) > EVENT:
            raise self.give_up(t, NO_FORCE)
        return None

    # ---------------------------------------------------------------- ideal rolling without normal force

    def _closes_again(self, t: float, c: int) -> bool:
        """Whether ideal rolling whose normal force is zero would close if it were let go.

        Without F_t the gap's second derivative jumps to -J_n M^-1 J_t^T F_t. Where that is negative, but rises, the gap
        dips before it opens: a dip that is small enough is let be.
        """
        system = self.system
        integers = system.contact_int[c]
        if integers[MODE] != STICK or system.contact_real[c, MU] < math.inf:
            return False
        self.rk.accept()
        integers[MODE] = FREE
        depth = self.dips.foresee(t, c, min(self.seed, self.longest_start))
        integers[MODE] = STICK
        if self.rk.evaluate_start(t) > EVENT:
            raise self.give_up(t, NO_FORCE)
        if not self.dips.may_be(c, depth):
            return True
        self.dips.let(c, depth)
        return False

    def watch_gaps(self, stepped: bool) -> None:
        """Look which contacts that have opened are apart at the accepted state, which is evaluated, or closed again.

        stepped: whether the last attempt led there in the present modes.
        """
        system = self.system
        for c in {*self.dips.contacts, *self._barely_open}:
            apart = system.gaps[c, 0] > self._reach(c)
            if apart or system.contact_int[c, MODE] != FREE:
                self._barely_open.pop(c, None)
                self.dips.end(c)
            elif stepped and system.highest[c, GAP_MARGIN] > self._reach(c):
                self._barely_open.pop(c, None)

    def note_sides(self, scanned: bool) -> None:
        """Take down which open contacts are apart at the accepted state, which is evaluated.

        scanned: whether events were looked for in the step that led there.
        """
        if FREE in self.system.modes.tolist():
            self.open.note(None if scanned else self._slack)

    def stay_apart(self, t: float) -> bool:
        """Whether compiled steps can tell how long open contacts stay apart, and nothing else is to be looked at."""
        return not self.dips.contacts and not self._barely_open and not self.system.ng and self.open.are_plain(t)

    def _slack(self, c: int) -> float:
        """How deep in m open contact c may be."""
        return self._reach(c) + self.dips.depths.item(c)

    def held_up(self) -> list[int]:
        """Contacts of ideal rolling that slide held up by friction alone."""
        modes, mu = self.system.modes.tolist(), self.system.contact_real[:, MU].tolist()
        return [c for c, mode in enumerate(modes) if mode == SLIPPING and mu[c] == math.inf]

    def _stop_jammed(self, t: float) -> None:
        """Stop slips that friction alone would have to hold up and cannot: the force it takes grows without bound."""
        sliding = self.held_up()
        if sliding and self.rk.evaluate(t) <= EVENT:
            sliding = [c for c in sliding if self.system.margins[c, FRICTION_MARGIN] < 0.0]
        if sliding:
            self._stop_slips(t, sliding)

    def end_jams(self, t: float) -> float:
        """End the slips of the accepted state that friction alone holds up, since no step is short enough to follow
        them."""
        sliding = self.held_up()
        for c in sliding:
            self._check_chatter(t, c)
        self.rk.load(self.system.state)
        self._evaluate_rows(t)
        self._end_jams(t, sliding)
        return self.start_frozen(t)

    def _end_jams(self, t: float, contacts: list[int]) -> None:
        energy = self._counted_energy()
        self._stop_slips(t, contacts)
        self._count_loss(energy)
        self._settle(t, self._sticking(), dict.fromkeys(contacts, np.zeros(3)), False)

    def _stop_slips(self, t: float, contacts: list[int]) -> None:
        """End slips at once, by the least change of velocity that does it."""
        self.system.contact_int[contacts, MODE] = STICK
        self._project(t, explained=True)

    def _counted_energy(self) -> float:
        """Energy in J of the system's state, where works are counted."""
        return sum(self._energies()) if self._counts_works else 0.0

    def _count_loss(self, before: float) -> None:
        """Book what projections took from the energy `before` as work of friction."""
        if self._counts_works:
            self.system.stage_state[FRICTION_WORK - NUMBER_OF_WORKS] += self._counted_energy() - before

    def until_touch(self) -> float:
        """Time in s that gaps of open contacts, and ways of joints to their ends, last at their present rates."""
        system = self.system
        left = math.inf
        for c in range(system.nc):
            approach = -self._leaves_at(c)
            watched = system.contact_int[c, MODE] == FREE and self.open.apart[c]
            if watched and system.contact_real[c, DOMAIN] >= 0.0 and approach > 0.0:
                reach = self._reach(c)
                way = float(system.gaps[c, 0] + self.dips.depths[c]) + reach
                left = min(left, max(way, _LEAST_WAY * reach) / approach)
        for g, guard in enumerate(system.guards):
            speed = float(system.v[guard.index_v])
            if system.contact_int[system.nc + g, MODE] == FREE and speed != 0.0:
                position, reach = float(system.q[guard.index_q]), self._guard_reach
                way = (guard.high_end - position if speed > 0.0 else position - guard.low_end) + reach
                left = min(left, max(way, _LEAST_WAY * reach) / abs(speed))
                rate = float(system.acceleration[guard.index_v])
                if guard.dry and rate * speed < 0.0:
                    # dry friction ends its slip
                    left = min(left, max(abs(speed), self._rest_speed()) / abs(rate))
        return left

    def _uneventful(self) -> bool:
        """Whether nothing opened, closed or began to slip in the last attempt, as far as gaps and forces are known."""
        system = self.system
        n = system.items
        lowest = system.lowest[:n]
        reach = np.array([self._reach(c) if c < system.nc else GAP_TOLERANCE * system.scale.sum() for c in range(n)])
        force = _FORCE_ACCURACY * float(np.abs(system.force[:n]).max(initial=0.0))
        touchable = np.ones(n, dtype=bool)
        touchable[: system.nc] = self.open.apart
        return bool(
            (lowest[touchable, GAP_MARGIN] >= -reach[touchable] - self.dips.depths[:n][touchable]).all()
            and (lowest[:, DOMAIN_MARGIN] >= -reach).all()
            and (lowest[:, [NORMAL_MARGIN, FRICTION_MARGIN]] >= -force).all()
        )

    def _attempt(self, t: float, tau: float) -> float:
        """A step from the accepted state of tau, or of as much less as its error asks for; how long it is."""
        for _ in range(_SHORTENINGS):
            status = self.rk.attempt(t, tau)
            if status == OK and self.rk.error < 1.0:
                return tau
            tau *= FAILED_FACTOR
        raise self.give_up(t, NO_FORCE)

    def _run_on(self, t: float, tau: float) -> tuple[float, Decision, np.ndarray]:
        """Stick runs on from the accepted state for tau, or less (see `_attempt`), where the modes are decided anew.

        Returns how long, the decision, and the state there with the slip velocity a_t tau / 2 added.
        """
        rk, system = self.rk, self.system
        tau = self._attempt(t, tau)
        rk.load(system.new_state)
        self._project(t + tau)
        stick = system.stage_state.copy()
        acceleration = system.acceleration.copy()
        decision = self._decide(t + tau, self._sticking())
        change = 0.5 * tau * (system.acceleration - acceleration)
        rk.load(stick)
        system.v[:] += change
        rk.keep_velocity()
        return tau, decision, system.stage_state.copy()

    def _end_start(self, t: float) -> float:
        """Slip has a direction of its own from here on."""
        for c in np.flatnonzero(self.system.contact_int[:, FROZEN]):
            self._started[int(c)] = self.slip_direction(int(c))
        self.system.contact_int[:, FROZEN] = 0
        sliding = self.held_up()
        if not sliding:
            self._project(t)
        elif not self.rk.project(t, False):
            # v_c has come out in a direction in which friction alone holds nothing up: that slip has jammed
            self._stop_slips(t, sliding)
        self.rk.accept()
        return t

    # ---------------------------------------------------------------- impact

    def _touch(self, t: float, c: int) -> float:
        """Contact c closes: impulses on all closed contacts, then new modes from the velocities after them."""
        system = self.system
        integers = system.contact_int
        # whatever touches at the same instant, by symmetry, takes part
        touching = [c]
        for i in range(system.nc):
            if i != c and integers[i, MODE] == FREE and self._touches(i) and self._leaves_at(i) <= _LEAVING_SPEED:
                touching.append(i)
        rebounds = {}
        modes: dict[int, int] = {}
        for i in touching:
            approach = self._leaves_at(i)
            if -self.restitution[i] * approach > REST_SPEED:
                rebounds[i] = self.restitution[i]
            if i in self._barely_open and i not in rebounds and self._stayed_near(i):
                # as far as gaps are known it has not opened
                modes[i], event = self._barely_open.pop(i)
                self.events = [other for other in self.events if other is not event]
            else:
                self.announce(t, i, "touch")
            integers[i, MODE] = rest_mode(system.contact_real[i, MU])
        if not rebounds:
            self._check_chatter(t, c)
        count = len(self.events)
        after = self._collide(t, touching, rebounds)
        for i, before in modes.items():
            now = int(integers[i, MODE])
            if now == FREE:
                if not any(event.contact == self.names[i] for event in self.events[count:]):
                    self.announce(t, i, "separate")
            elif now != before:
                self._announce_friction(t, i, now == SLIPPING)
        return after

    def _touches(self, c: int) -> bool:
        """Whether the gap of an open contact is no larger than gaps are known, between points inside both domains."""
        return bool(self.system.contact_real[c, DOMAIN] >= 0.0 and abs(self.system.gaps[c, 0]) <= self._reach(c))

    def _leaves_at(self, c: int) -> float:
        """Speed in m/s at which the bodies of a contact part."""
        (x, y, z), (u, v, w) = self.system.basis[c, 2].tolist(), self.system.slip[c].tolist()
        return float(x * u + y * v + z * w)

    def _stayed_near(self, c: int) -> bool:
        """Whether the gap of an open contact is, and was in the last attempt, no larger than gaps are known."""
        reach = self._reach(c)
        return bool(abs(self.system.gaps[c, 0]) <= reach and self.system.highest[c, GAP_MARGIN] <= reach)

    def _collide(self, t: float, touching: list[int], restitution: dict[int, float]) -> float:
        """Impulses on all closed contacts and ends of joints, then new modes from the velocities after them.

        touching: contacts that have struck, whose modes the caller announces.
        """
        system, rk = self.system, self.rk
        integers = system.contact_int
        self._started.clear()
        near = self._close_near()
        self._evaluate_rows(t)
        closed = system.closed()
        deep = any(c in self.dips.contacts for c in closed)
        energy = sum(self._energies()) if deep else 0.0
        sides = {g: int(system.guard_int[g, GUARD_END]) for g in system.held() if system.guard_int[g, GUARD_END] != 0}
        ends = list(sides)
        impact = apply_impact(system, self.modes.solver, closed, ends, restitution)
        if impact is None:
            names = ", ".join(repr(self.names[i]) for i in touching or closed) or "a joint's limit"
            raise Stop(FAILURES[NO_FORCE][0], f"t = {t:.9g} s: no impulses satisfy Coulomb's law at {names}; {ADVICE}")
        rk.keep_velocity()
        if self._counts_works:
            works = system.stage_state[-NUMBER_OF_WORKS:]
            works[FRICTION_WORK] += impact.contacts
            works[DRIVE_WORK] += impact.drives
            works[DAMPING_WORK] += impact.joints
        self._evaluate_rows(t)
        for i in closed:
            leaving = self._leaves_at(i)
            if integers[i, UNILATERAL]:
                depth = max(-float(system.gaps[i, 0]) - self._reach(i), 0.0)
                if self._leaves(i, leaving, depth + self._reach(i)):
                    integers[i, MODE] = FREE
                    if i not in touching and i not in near:
                        # thrown off by what others have struck
                        self.announce(t, i, "separate")
                    if depth > 0.0:
                        # rebounds from where it is
                        self.dips.start_at(i, depth)
        for i in near:
            if integers[i, MODE] != FREE:
                self.announce(t, i, "touch")
        self._guards_from_velocities(ends)
        undecided = self.modes_from_velocities(after_impact=True)
        before = self._counted_energy()
        self._stop_jammed(t)
        # what stays closed with a normal velocity (a hop that is none) stops here, which may turn slow slips
        if rk.project(t, False):
            self._stop_jammed(t)
        else:
            self._stop_slips(t, self.held_up())
        if self._end_short_motions(t, closed, sides):
            undecided = self.modes_from_velocities(after_impact=True)
        self._count_loss(before)
        if deep:
            self._leave_dips(t, energy + impact.drives)
        return self.resolve(t, undecided, silent=True)

    def _close_near(self) -> list[int]:
        """Let all take part in an impact that is as near as positions are known, whatever it does before: contacts,
        which are returned, and ends of joints.

        What leaves by then may be thrown back at once. Left to an impact of its own, which throws the first one back,
        both would go to and fro, ever slower, between places that are the same as far as they are known. What rebounds
        is left to its own impacts.
        """
        system, modes = self.system, self.system.contact_int[:, MODE]
        near = [
            c
            for c in range(system.nc)
            if modes[c] == FREE
            and system.contact_int[c, UNILATERAL]
            and self.open.apart[c]
            and c not in self.dips.contacts
            and self.restitution[c] == 0.0
            and self._touches(c)
        ]
        for c in near:
            modes[c] = rest_mode(system.contact_real[c, MU])
        for g, guard in enumerate(system.guards):
            if modes[system.nc + g] == FREE:
                position, reach = float(system.q[guard.index_q]), self._guard_reach
                if position - guard.low_end <= reach:
                    self.modes.hold(g, -1)
                elif guard.high_end - position <= reach:
                    self.modes.hold(g, 1)
        return near

    def _leaves(self, i: int, leaving: float, reach: float) -> bool:
        """Whether item i leaves what it has struck, at this speed in m/s: a hop lower than gaps are known is none."""
        system = self.system
        falling = abs(float(system.rows[i, 2] @ system.free_acceleration + system.bias[i, 2]))
        return leaving > _LEAVING_SPEED and leaving * leaving > 2.0 * falling * reach

    def _leave_dips(self, t: float, energy: float) -> None:
        """After an impact of contacts in dips, out of which they have been lifted.

        The motion has what it fell too far, and gives back what the lift takes beyond what the impact took.
        energy: in J, that of the motion before the impact, and of drives.
        """
        system = self.system
        kinetic, potential = self._energies()
        excess = min(max(kinetic + potential - energy, 0.0), kinetic)
        if excess > 0.0:
            velocities = slice(system.nq, system.nq + system.nv)
            system.stage_state[velocities] *= math.sqrt(1.0 - excess / kinetic)
            self.rk.load(system.stage_state)
            # drives have velocities of their own
            self._project(t, explained=True)
        if self._counts_works:
            system.stage_state[FRICTION_WORK - NUMBER_OF_WORKS] -= excess

    def _energies(self) -> tuple[float, float]:
        """Kinetic and potential energy in J at the system's (q, v)."""
        return energies_at(self.system.model, self.system.q, self.system.v)

    def _evaluate_rows(self, t: float) -> None:
        """Evaluate what an impact needs: rows, v_c and the factor of M; forces there may be none."""
        status = self.rk.evaluate(t)
        if status > EVENT and status != NO_FORCE:
            raise self.give_up(t, LOCATION_FAILED)

    def _end_short_motions(self, t: float, contacts: list[int], sides: dict[int, int]) -> bool:
        """End what an impact has begun and would end within distances shorter than positions are known to: slips, and
        hops of what took part, contacts and ends of joints (coordinate -> end); whether there was any.

        Else a body that comes to rest goes on for ever: such a slip's friction tips it, and what tips falls as far
        below the ground as its touch is noticed late; and coupled joints that are pressed onto their ends throw each
        other off them in turn.
        """
        system, modes = self.system, self.system.contact_int[:, MODE]
        for count in range(system.items + 1):
            if self.rk.evaluate(t) > EVENT:
                break
            slips = [c for c in system.closed() if modes[c] == SLIPPING and self._stops_short(c)]
            left = [g for g in sides if modes[system.nc + g] == FREE]
            hops = [g for g in left if self._joint_hops(g, sides[g])]
            # dry joints that soon stop are what throws others back onto their ends
            dry = [g for g in range(system.ng) if modes[system.nc + g] == FREE] if left else []
            stops = [g for g in dry if self._joint_stops_short(g)]
            touches = [c for c in contacts if modes[c] == FREE and self._hops(t, c)]
            if not (slips or stops or hops or touches):
                return count > 0
            for c in touches:
                modes[c] = rest_mode(system.contact_real[c, MU])
            if touches:
                self.modes_from_velocities(after_impact=True)
            modes[slips] = STICK
            for g in stops:
                self.modes.hold(g, 0)
            for g in hops:
                self.modes.hold(g, sides[g])
            self._project(t, explained=True)
        return True

    def _stops_short(self, c: int) -> bool:
        """Whether the slip of contact c ends in a distance that is shorter than positions are known to."""
        speed, rate = self.system.contact_real[c, [SLIP_SPEED, SLIP_RATE]]
        return bool(rate < 0.0 and speed * speed <= -2.0 * rate * self._reach(c))

    def _joint_stops_short(self, g: int) -> bool:
        """The same of joint coordinate g, which slides against its dry friction."""
        guard, sign = self.system.guards[g], int(self.system.guard_int[g, GUARD_SIGN])
        speed, rate = self.system.v[guard.index_v], sign * self.system.acceleration[guard.index_v]
        return bool(guard.dry and sign != 0 and rate < 0.0 and speed * speed <= -2.0 * rate * self._guard_reach)

    def _joint_hops(self, g: int, end: int) -> bool:
        """Whether joint coordinate g comes back to the end that it leaves from no further than gaps are known."""
        index = self.system.guards[g].index_v
        speed, back = self.system.v[index], end * self.system.acceleration[index]
        return bool(back > 0.0 and speed * speed <= 2.0 * back * self._guard_reach)

    def _hops(self, t: float, c: int) -> bool:
        """The same of contact c."""
        reach = self._reach(c)
        if c in self.dips.contacts or abs(float(self.system.gaps[c, 0])) > reach:
            return False
        speed, back = self._leaves_at(c), -self.modes.gap_acceleration(t, c)
        return back > 0.0 and speed * speed <= 2.0 * back * reach
