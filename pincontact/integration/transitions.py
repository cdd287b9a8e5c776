"""Transitions: what happens at the start of a run, at a breakpoint and at an event, by the kind of event.

Each kind is a part of its own: `slip_onset`, `impacts`, `joint_events`, `penetration`. All of them decide modes
by `mode_changes` and announce events by `reports`.
"""

from __future__ import annotations

import math
from operator import sub

import numpy as np

from ..dynamics.energy import REST_SPEED
from ..dynamics.modes import ModeSolver, shares_viscous_force
from ..dynamics.system import FORCE_SLACK
from ..geometry.patterns import CROSSING_CURVES
from ..layout import (
    DOMAIN,
    DOMAIN_EVENT,
    EVENT,
    FREE,
    FRICTION_EVENT,
    FRICTIONLESS,
    LENGTH,
    LIMIT_SLACK,
    LOCATION_FAILED,
    MASS_NOT_POSITIVE,
    MODE,
    MU,
    NO_FORCE,
    NORMAL_EVENT,
    NORMAL_SIGN,
    OK,
    PATTERN,
    SINGULAR,
    SLIPPING,
    SPEED_EVENT,
    STICK,
    UNILATERAL,
)
from .accuracy import gap_rate, gaps_at_once, held_up, may_stop, next_to_nothing, rest_speed
from .contradictions import apart, jump_apart, jump_into, refuse_apart, touch_elsewhere
from .impacts import Impacts
from .joint_events import JointEvents
from .mode_changes import ModeChanges
from .nearness import places_of
from .open_contacts import OpenContacts
from .penetration import Penetration
from .reports import Reports, left_behind
from .results import END_OF_CONTOUR, LASTING_REBOUNDS, OVERLAPS_AT_END, SLIPS_LATE, Stop
from .runge_kutta import RungeKutta
from .slip_onset import SlipOnset

# A start that is changed by more than this (in units of q and v) was not on its constraints when modes were decided.
_MOVED = 1e-9
# A motion that jumps at a breakpoint moves bodies by no more than so many times the error of gaps.
_JUMP_REACHES = 10.0
# What is added to the slack of a limit of friction that was reached without slip, as a factor, and where that ends: at
# what counts as no load.
_SLACK_GROWTH, _LARGEST_SLACK = 4.0, 1e-8


class Transitions:
    """Changes the modes of a system whose state is in `stage_state`, and leaves it ready for the next step.

    Methods return the time, which a start of slip moves on by a short seed step; they raise Stop where the run ends.
    names, restitution: of the contacts; span: duration of the run in s; contact_solver: as for `simulate`.
    """

    def __init__(
        self, rk: RungeKutta, names: list[str], restitution: list[float], span: float, contact_solver: str = "auto"
    ) -> None:
        self.rk, self.system = rk, rk.system
        self.modes = ModeSolver(rk.system, contact_solver)
        self.reports = Reports(rk, self.modes, names, span)
        self.open = OpenContacts(rk.system)
        self.penetration = Penetration(rk, self.modes)
        self.joints = JointEvents(rk.system, self.modes, self.reports, self.penetration.depths)
        self.changes = ModeChanges(rk, self.modes, self.reports, self.joints)
        self.onset = SlipOnset(self.changes, self.open, self.penetration.depths, span)
        self.impacts = Impacts(self.onset, self.penetration, restitution)
        # contacts that slip as soon as anything moves, and stick where modes were decided
        self.slips_late: set[int] = set()
        # closed contacts of the initial state that come in
        self._striking: list[int] = []
        # when redundant forces were chosen anew last, and for which contacts
        self._chosen_at = math.nan
        self._chosen_for: set[int] = set()

    # ---------------------------------------------------------------- start and breakpoints

    def begin(self, t: float) -> None:
        """Modes of the initial state, and its slope. Slip that starts from rest is only given its direction, and what
        strikes at the start (see `strike`) has not yet.

        A state that does not keep to its constraints is put on them; what that takes counts as work of friction.
        """
        system, rk, changes = self.system, self.rk, self.changes
        status = self._evaluate(t)
        refuse_apart(apart(system, system.closed()))
        # a list takes a fraction of the time of array functions
        start, energy, given = system.state.tolist(), changes.counted_energy(), system.contact_int.tobytes()
        undecided = self._modes_from_velocities(t)
        unchanged = not (system.ng or undecided) and given == system.contact_int.tobytes()
        stands = status == OK and unchanged and system.counters.lost_positivity == 0
        if stands and not held_up(system):
            changes.project(t, True, explained=True)
        else:
            changes.stop_jammed(t)
            changes.update_modes(t, undecided, silent=True, explained=True)
        changes.count_loss(energy)
        rk.accept()
        if max(map(abs, map(sub, system.state.tolist(), start)), default=0.0) > _MOVED:
            # it was not on its constraints, where the modes were decided
            changes.evaluate_accepted(t)
        self._open_ahead(t)
        self.joints.begin()
        if FREE in system.modes.tolist():
            if not self.penetration.begin(t, self.onset.seed):
                raise self.reports.failure(t, NO_FORCE)
            self.open.begin(self.penetration.slack)

    def remarks(self, t: float) -> str:
        """What is to be said at t, the end of a run, of contacts that rebound all the time, slip late, or are inside
        each other."""
        system, nc, said, listed = self.system, self.system.nc, "", self.reports.listed
        lasting, late = np.flatnonzero(system.lasting_rebounds[:nc]).tolist(), sorted(self.slips_late)
        said += f"; {listed(lasting)} {LASTING_REBOUNDS}; smaller tolerances follow them" if lasting else ""
        said += f"; {listed(late)} {SLIPS_LATE}" if late else ""
        if self.open.apart.all():
            return said
        # steps in which these are not apart end in an evaluation of all
        self.open.follow(t)
        gaps, ways = np.where(self.open.apart, 0.0, system.gaps[:nc, 0]), system.contact_real[:nc, DOMAIN]
        return said + left_behind(system, gaps, ways, self.open, t)

    def _open_ahead(self, t: float) -> None:
        """Open the contacts of the accepted state that open as soon as it has moved."""
        changes, integers, limits = self.changes, self.system.contact_int.copy(), self.system.joint_int.copy()
        opened, slipping = changes.look_ahead(t)
        if opened:
            self.system.contact_int[opened, MODE] = FREE
            try:
                changes.update_modes(t, changes.sticking())
            except Stop:
                self.system.contact_int[:], self.system.joint_int[:] = integers, limits
                changes.evaluate_accepted(t)
                opened = []
        for c in opened:
            self.reports.announce(t, c, "separate")
        self.slips_late.update(c for c in slipping if self.system.contact_int[c, MODE] == STICK)

    def pass_jump(self, t: float) -> float:
        """A control or a motion may have jumped at t: modes of the accepted state anew, and impacts; the new time."""
        system, rk, changes = self.system, self.rk, self.changes
        changes.started.clear()
        rk.load(system.state)
        self._evaluate(t)
        for c in system.closed():
            if abs(system.gaps[c]).max() > _JUMP_REACHES * self.penetration.accuracy(c):
                raise jump_apart(t, self.reports.names[c], system.gaps[c, 0])
        energy, before = changes.counted_energy(), system.contact_int[:, MODE].copy()
        undecided = self._modes_from_velocities(t)
        if self._contradicts_equations():
            struck = self.strike(t)
            return self.impacts.collide_alone(t) if struck is None else struck
        for c in [*system.closed(), *system.resisting()]:
            if before[c] == STICK and system.contact_int[c, MODE] == SLIPPING:
                self.reports.announce_friction(t, c, True)
        changes.stop_jammed(t)
        changes.update_modes(t, undecided)
        changes.count_loss(energy)
        rk.accept()
        self._open_ahead(t)
        struck = self.strike(t)
        return self.onset.start(t) if struck is None else struck

    def _contradicts_equations(self) -> bool:
        """Whether velocities, which have jumped, are none that closed contacts allow: impulses put that right."""
        system, allowed = self.system, rest_speed(self.system)
        ideal = [c for c in system.closed() if system.contact_real[c, MU] == math.inf]
        slips = any(self.changes.slip_speed(c) > allowed for c in ideal)
        return slips or any(abs(gap_rate(system, c)) > allowed for c in system.closed())

    def _evaluate(self, t: float) -> int:
        """Evaluate a state whose modes are not decided yet; its status, if forces are all that may be missing."""
        status = self.rk.evaluate(t)
        if status in (LOCATION_FAILED, SINGULAR, MASS_NOT_POSITIVE):
            raise self.reports.failure(t, status)
        return status

    def _modes_from_velocities(self, t: float) -> list[int]:
        """Modes that the velocities show; contacts at rest whose friction is undecided. Closed contacts whose normal
        velocity is not zero are opened: they part, or strike."""
        system = self.system
        if system.ng:
            self.joints.set_from_velocities()
        self._striking.clear()
        for c in system.closed():
            speed = gap_rate(system, c)
            if abs(speed) > REST_SPEED and system.contact_int[c, UNILATERAL]:
                system.contact_int[c, MODE] = FREE
                if speed > 0.0:
                    self.reports.announce(t, c, "separate")
                else:
                    self._striking.append(c)
        return self.changes.set_from_velocities()

    def strike(self, t: float) -> float | None:
        """Impacts at the start of a run, of closed contacts and joints at their ends that come in; the new time, or
        None without any."""
        stops = self.joints.stop_those_at_ends(t)
        if self._striking:
            return self.impacts.touch(t, self._striking[0])
        return self.impacts.collide_alone(t) if stops else None

    # ---------------------------------------------------------------- events

    def switch(self, t: float, c: int, kind: int, chosen: bool) -> float:
        """Event function `kind` of item c has reached zero at t. chosen: whether no other redundant forces would do."""
        if c < self.system.nc and self.system.contact_int[c, MODE] == FREE:
            if c in self.open.overlapping:
                raise touch_elsewhere(t, self.reports.names[c], OVERLAPS_AT_END)
            if self.open.has_leapt(c, self.penetration.slack(c)):
                return self._leap(t, c)
            self._hand_over(t, c)
            return self.impacts.touch(t, c)
        self.reports.check_chatter(t, c)
        if self.system.nc <= c < self.system.nc + self.system.ng:
            return self._switch_joint(t, c, kind, chosen)
        if kind == DOMAIN_EVENT:
            return self._reach_end(t, c)
        if kind == SPEED_EVENT:
            direction = self.changes.slip_direction(c)
            self.system.contact_int[c, MODE] = STICK
            return self.onset.resolve(t, self.changes.sticking(), at_rest={c: direction})
        if kind == FRICTION_EVENT and shares_viscous_force(self.system, c):
            # all of its viscous friction from here on, and a load that grows from zero
            self.modes.load(c)
            self.changes.accept_with_other_forces(t)
            return t
        if kind == FRICTION_EVENT and self.system.contact_int[c, MODE] in (SLIPPING, FRICTIONLESS):
            self.changes.end_jams(t, [c])
            return self.onset.start(t)
        unloaded = self.changes.unloaded(t)
        if self.system.owner(c) in unloaded:
            return self._open(t, unloaded)
        if not (chosen or self._is_again(t, c)) and self.changes.redistribute(t, c, kind):
            return t
        c, kind = self.changes.limiting(c, kind)
        return self._lose_load(t, c) if kind == NORMAL_EVENT else self._reach_limit(t, c)

    def misses(self, t: float) -> bool:
        """Whether bodies that were apart are inside each other at t, the end of a trial step in which none was seen to
        touch, as where no nearest point was found on the way. Evaluates the kinematics there."""
        system, opened = self.system, self.open
        self.rk.load(system.new_state)
        system.evaluate_kinematics(t)
        crosses = (system.contact_int[:, PATTERN] == CROSSING_CURVES) | (system.contact_int[:, UNILATERAL] == 0)
        for c in np.flatnonzero((system.modes == FREE) & opened.apart & ~crosses[: system.nc]).tolist():
            within = system.gaps[c, 0] < 0.0 <= system.contact_real[c, DOMAIN] and c not in opened.passed
            if within and opened.has_leapt(c, self.penetration.slack(c)) and opened.is_inside(t, c):
                return True
        return False

    def _is_again(self, t: float, c: int) -> bool:
        """Whether redundant forces have been chosen anew at this very instant for contact c, which did not do: others
        have lost their loads then in turn, and together they have none to share."""
        if t != self._chosen_at:
            self._chosen_at = t
            self._chosen_for.clear()
        found = c in self._chosen_for
        self._chosen_for.add(c)
        return found

    def _leap(self, t: float, c: int) -> float:
        """The gap of contact c has leapt from one sign to the other, which is no touch: two curves have become
        parallel, where their common normal turns round, or Newton's method has gone over to other stationary points.
        Where a motion jumps, the bodies have done so."""
        self.changes.accept_with_other_forces(t)
        if not self.open.loses(t, c):
            raise jump_into(t, self.reports.names[c])
        return t

    def _switch_joint(self, t: float, c: int, kind: int, chosen: bool) -> float:
        """Event function `kind` of item c, a limited joint coordinate, has reached zero."""
        if not chosen and kind in (NORMAL_EVENT, FRICTION_EVENT) and self.changes.redistribute(t, c, kind):
            return t
        if self.joints.switch(t, c - self.system.nc, kind):
            return self.impacts.collide_alone(t)
        ended = {c: np.zeros(3)} if kind == SPEED_EVENT else {}
        after = self.onset.resolve(t, self.changes.sticking(), at_rest=ended)
        if not ended:
            self._set_slack(c, c - self.system.nc in self.system.held())
        return after

    def _reach_end(self, t: float, c: int) -> float:
        """The point of contact c reaches the end of a contour."""
        integers = self.system.contact_int[c]
        self.reports.announce(t, c, "edge")
        if not integers[UNILATERAL]:
            raise Stop(END_OF_CONTOUR, f"t = {t:.9g} s: contact {self.reports.names[c]!r} reached the end of a contour")
        integers[MODE] = FREE
        return self.onset.resolve(t, self.changes.sticking())

    def _hand_over(self, t: float, c: int) -> None:
        """Open the contacts that are about to reach an end where contact c, of the same two bodies, touches: a body
        that rolls onto the corner there would stand on both, as far as gaps tell, and stop."""
        system, bodies = self.system, self.system.contacts[c].bodies
        # a curved body is as far above it where it is rolled to from here
        way = math.sqrt(2.0 * float(gaps_at_once(system)[c] * system.contact_real[c, LENGTH]))
        for i in system.closed():
            ends = system.contact_int[i, UNILATERAL] and system.contact_real[i, DOMAIN] <= way
            if not ends or system.contacts[i].bodies != bodies:
                continue
            (_, place), (_, other) = places_of(system, [c, i], c)
            if np.linalg.norm(place - other) <= way:
                self.reports.announce(t, i, "edge")
                system.contact_int[i, MODE], self.open.apart[i] = FREE, False

    def _lose_load(self, t: float, c: int) -> float:
        """The normal force of contact c is zero: it opens, or the force changes its side, or the contact slips."""
        integers, together = self.system.contact_int[c], [c]
        if not integers[UNILATERAL]:
            return self._turn_normal(t, c)
        if integers[MODE] == STICK and math.isinf(self.system.contact_real[c, MU]):
            together = self._rolls_unloaded(c)
            lost = self.modes.lose_friction(t, self.rk.evaluate)
            if c in lost and not self._parts_soon(t, c):
                for i in lost:
                    self.reports.announce_friction(t, i, True)
                return self.onset.resolve(t, self.changes.sticking())
            if self._closes_again(t, together):
                return self._reach_limit(t, c)
        # where neither a part nor all of its viscous friction holds it up, it opens
        if self.modes.share(t, c, self.rk.evaluate):
            self.changes.accept_with_other_forces(t)
            return t
        self.rk.accept()
        opened, _ = self.changes.look_ahead(t)
        return self._open(t, opened if c in opened else together)

    def _rolls_unloaded(self, c: int) -> list[int]:
        """Contact c, ideal rolling whose normal force is zero, and others, of redundant ones, whose are with it."""
        system = self.system
        if system.counters.row_rank == system.counters.row_count:
            return [c]
        rolls = (system.modes == STICK) & np.isinf(system.contact_real[: system.nc, MU])
        rolls &= system.contact_int[: system.nc, UNILATERAL] != 0
        least = [next_to_nothing(system, i, NORMAL_EVENT) for i in range(system.nc)]
        rolls &= np.abs(system.force[: system.nc, 2]) <= least
        rolls[c] = True
        return [int(i) for i in np.flatnonzero(rolls)]

    def _turn_normal(self, t: float, c: int) -> float:
        """The normal force of bilateral contact c changes its sign, which the force itself, as good as zero, does not
        tell."""
        integers, least = self.system.contact_int[c], next_to_nothing(self.system, c, NORMAL_EVENT)
        sign = -int(integers[NORMAL_SIGN])
        integers[NORMAL_SIGN] = sign
        after = self.onset.resolve(t, self.changes.sticking())
        if integers[NORMAL_SIGN] != sign and abs(self.system.force[c, 2]) <= least:
            integers[NORMAL_SIGN] = sign
            self.changes.evaluate_accepted(after)
        return after

    def _open(self, t: float, contacts: list[int]) -> float:
        """These contacts open."""
        modes = self.system.contact_int[:, MODE]
        for c in contacts:
            self.penetration.barely_open[c] = int(modes[c]), self.reports.announce(t, c, "separate")
            modes[c] = FREE
        return self.onset.resolve(t, self.changes.sticking())

    def _parts_soon(self, t: float, c: int) -> bool:
        """Whether contact c, closed in the accepted state and without a load, would be pulled next."""
        self.rk.accept()
        tau = min(self.onset.seed, self.onset.longest)
        pulled = False
        if tau > 0.0 and self.rk.try_step(t, tau) == OK:
            self.rk.load(self.system.new_state)
            pulled = self.rk.evaluate(t + tau) <= EVENT and bool(self.system.event_functions[c, NORMAL_EVENT] < 0.0)
        self.changes.evaluate_accepted(t)
        return pulled

    def _closes_again(self, t: float, contacts: list[int]) -> bool:
        """Whether any of these contacts, ideal rolling, would close if they were let go; see `penetration`."""
        self.rk.accept()
        closes = self.penetration.closes_again(t, contacts, min(self.onset.seed, self.onset.longest))
        self.changes.evaluate_accepted(t)
        return closes

    def _reach_limit(self, t: float, c: int) -> float:
        """The friction of item c has reached its limit in stick."""
        after = self.onset.leave_stick(t, c)
        self._set_slack(c, self.system.contact_int[c, MODE] == STICK)
        return after

    def _set_slack(self, c: int, sticks: bool) -> None:
        """The friction of item c has reached its limit. Where rounding has it that it sticks all the same, it is not
        asked again before that shows."""
        numbers = self.system.contact_real[c]
        numbers[LIMIT_SLACK] = min(_SLACK_GROWTH * numbers[LIMIT_SLACK], _LARGEST_SLACK) if sticks else FORCE_SLACK

    def come_to_rest(self, t: float, ended: dict[int, np.ndarray]) -> float:
        """The slip of these contacts, which are to stick, has ended in these directions: each sticks, or slides on."""
        for c in ended:
            self.reports.check_chatter(t, c)
        ideal = any(math.isinf(self.system.contact_real.item(c, MU)) for c in ended)
        # what is left of v_c is no start of a slip in another direction, in which it may take another force
        if ideal and not self.rk.project(t, False):
            # other slips that are as good as over leave no forces
            others = may_stop(self.system)
            self.changes.stop_slips(t, others)
            ended = ended | dict.fromkeys(others, np.zeros(3))
        return self.onset.resolve(t, self.changes.sticking(), at_rest=ended)

    def end_jams(self, t: float) -> float | None:
        """End the slips of the accepted state, whose rows are evaluated, that no step is short enough to follow: those
        that may be stopped, or by an impact without collision; None where there are none."""
        sliding = held_up(self.system)
        for c in sliding or np.flatnonzero(self.system.contact_int[:, MODE] == SLIPPING).tolist():
            self.reports.check_chatter(t, c)
        after = None if sliding else self.impacts.jam(t)
        if after is not None:
            return after
        sliding = may_stop(self.system)
        if not sliding:
            return None
        self.changes.end_jams(t, sliding)
        return self.onset.start(t)

    # ---------------------------------------------------------------- accepted states

    def note_sides(self, scanned: bool) -> None:
        """Take down which open contacts are apart at the accepted state, which is evaluated.

        scanned: whether events were looked for in the step that led there.
        """
        if FREE in self.system.modes.tolist():
            self.open.note(None if scanned else self.penetration.slack)

    def stay_apart(self, t: float) -> bool:
        """Whether compiled steps can tell how long open contacts stay apart, and nothing else is to be looked at."""
        penetration = self.penetration
        watched = penetration.contacts or penetration.barely_open or penetration.thrown_off or self.system.ng
        return not watched and self.open.are_plain()
