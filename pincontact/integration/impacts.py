"""Impacts: contacts that close and joints that reach an end of their way, the impulses, and the modes after them."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from ..dynamics.contact_modes import held_up_by_friction
from ..dynamics.directions import slip_direction
from ..dynamics.energy import REST_SPEED
from ..dynamics.event_functions import FORCE_EVENTS
from ..dynamics.friction_scaling import associated
from ..dynamics.impact import apply_impact, coefficient, crushing_items
from ..dynamics.modes import rest_mode
from ..dynamics.positivity import is_positive
from ..dynamics.units import REDUNDANT, unwhiten, whiten, whitened_velocity
from ..layout import (
    EVENT,
    FREE,
    FRICTIONLESS,
    MODE,
    MU,
    NO_FORCE,
    SLIP_RATE,
    SLIP_SPEED,
    SLIPPING,
    STICK,
    TANGENTS,
    UNILATERAL,
)
from .accuracy import count_rebound, gap_rate, gap_resolution, may_stop, rest_speed
from .contradictions import crushed
from .ends import comes_in, waits
from .penetration import Penetration
from .results import FAILURES, GAP_TOLERANCE, STEP_TOO_SMALL, Stop
from .slip_onset import SlipOnset

# After an impact what leaves faster than this, in m/s, opens.
_LEAVING_SPEED = 1e-3 * REST_SPEED
# What stops takes so many times more where constraints are next to dependent than each of them does.
_NEXT_TO_DEPENDENT = 1e2
# Slips that change by less than this part of the fastest one have not jammed: accelerations do that in a short time.
_LEAST_JAM = 1e-6
# Slip that friction slows so many times faster than anything else accelerates it is about to jam, or has.
_JAMMED = 1e4
# So often what has jammed does so again at once.
_JAMS = 100
# Slip this many times faster than a bounce goes on in its direction when friction of its impulse is taken from it.
_FASTER = 2.0


class Impacts:
    """Impacts of the state that `onset` goes on from; methods return the time after them.

    restitution: (nc,) coefficients.
    """

    def __init__(self, onset: SlipOnset, penetration: Penetration, restitution: list[float]) -> None:
        self.onset, self.penetration, self.restitution = onset, penetration, restitution
        self.changes, self.system, self.rk = onset.changes, onset.system, onset.rk
        self.joints, self.reports = self.changes.joints, self.changes.reports
        # m/s: the slips that the last impact left
        self._rubbing = np.zeros(0)
        # and whether friction alone, of ideal rolling, holds one of them up
        self._rubs_alone = False
        # what goes on after the last impact, however low its bounce
        self._lasting: set[int] = set()
        # modes, slips, q and v before the last impact
        self._before = (np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros(0), np.zeros(0))

    def touch(self, t: float, c: int) -> float:
        """Contact c closes: impulses on all closed contacts, then new modes from the velocities after them."""
        system, penetration, modes = self.system, self.penetration, self.system.contact_int[:, MODE]
        # whatever touches at the same instant, by symmetry, takes part; what dips does not, whatever its depth
        due = [c, *(i for i in self._due() if i != c)]
        grazing = [i for i in due if self._grazes(i)]
        for i in grazing:
            penetration.tolerate(i, penetration.resolution(i))
        due = [i for i in due if i not in grazing]
        if not due:
            self.changes.accept_with_other_forces(t)
            return t
        waiting = [i for i in due if waits(system, i, due)]
        touching = [i for i in due if i not in waiting]
        rebounding = {i: self.restitution[i] for i in touching if self._rebounds(i)}
        unopened: dict[int, int] = {}
        for i in touching:
            closed = penetration.has_stayed_closed(i)
            count_rebound(system, i, -gap_rate(system, i), closed)
            if i not in rebounding and closed and i in penetration.barely_open:
                # as far as gaps are known it has not opened
                unopened[i], event = penetration.barely_open.pop(i)
                self.reports.withdraw(event)
            else:
                self.reports.announce(t, i, "touch")
            modes[i] = rest_mode(system.contact_real[i, MU])
        if rebounding:
            self.reports.check_rebounds(t, touching[0])
        else:
            self.reports.check_chatter(t, touching[0])
        count = len(self.reports.events)
        after = self.collide(t, touching, rebounding)
        self._announce_others(t, touching)
        names = {event.contact for event in self.reports.events[count:]}
        for i, before in unopened.items():
            if modes[i] == FREE:
                if self.reports.names[i] not in names:
                    self.reports.announce(t, i, "separate")
            elif modes[i] != before:
                self.reports.announce_friction(t, i, bool(modes[i] == SLIPPING))
        for i in waiting:
            if modes[i] == FREE and self._is_due(i) and gap_rate(system, i) <= _LEAVING_SPEED:
                return self.touch(after, i)
        return after

    def collide_alone(self, t: float) -> float:
        """Joints have struck ends of their ways, and are held there, or a motion has jumped: impulses as in `touch`, in
        which contacts take part that touch at the same instant."""
        due = self._due()
        if due:
            return self.touch(t, due[0])
        after = self.collide(t, [], {})
        self._announce_others(t, [])
        return after

    def jam(self, t: float) -> float | None:
        """Impact without collision, where forces in slip have grown without bound; the new time, None where no impulses
        change slips."""
        system, changes = self.system, self.changes
        integers, limits = system.contact_int.copy(), system.joint_int.copy()
        after = self.collide(t, [], {}, jammed=True)
        modes, slips, _, _ = self._before
        sliding = modes == SLIPPING
        least = max(rest_speed(system), _LEAST_JAM * np.abs(slips[sliding]).max(initial=0.0))
        if np.abs(system.slip - slips)[sliding].max(initial=0.0) <= least:
            system.contact_int[:], system.joint_int[:] = integers, limits
            self.rk.load(system.state)
            changes.evaluate_rows(t)
            return None
        self._announce_others(t, [])
        return after

    def _due(self) -> list[int]:
        """Open contacts that touch now, as far as instants are told apart, and do not leave."""
        system, tolerated = self.system, self.penetration.contacts
        opened = [c for c, mode in enumerate(system.modes.tolist()) if mode == FREE and c not in tolerated]
        near = [c for c in opened if (self.onset.open.apart[c] or comes_in(system, c)) and self._is_due(c)]
        return [c for c in near if gap_rate(system, c) <= _LEAVING_SPEED]

    def _is_due(self, c: int) -> bool:
        """Whether open contact c touches now, as far as instants are told apart.

        However gently ideal rolling comes in, all its slip ends then: that may come no earlier than leaves its way.
        """
        system, accuracy = self.system, self.penetration.accuracy(c)
        if not self.penetration.touches(c) or math.isfinite(system.contact_real[c, MU]):
            return self.penetration.touches(c)
        gap = abs(float(system.gaps[c, 0])) - self.penetration.resolution(c)
        return gap * self.changes.slip_speed(c) <= accuracy * max(-gap_rate(system, c), 0.0)

    def _grazes(self, c: int) -> bool:
        """Whether open contact c, of ideal rolling, would leave without a touch from no deeper than gaps are known: a
        touch, however gentle, ends all its slip."""
        system = self.system
        if math.isfinite(system.contact_real[c, MU]):
            return False
        speed, rise = gap_rate(system, c), float(system.rows[c, 2] @ system.acceleration + system.bias[c, 2])
        return rise > 0.0 and speed * speed <= 2.0 * rise * self.penetration.resolution(c)

    def _announce_others(self, t: float, touching: list[int]) -> None:
        """Announce slips, and turning, that the last impact has begun, ended or turned round; not of what touched."""
        system, (modes, slips, q, v) = self.system, self._before
        for i in [*system.closed(), *system.resisting()]:
            slid, slides = modes[i] == SLIPPING, bool(system.contact_int[i, MODE] == SLIPPING)
            if system.owner(i) in touching or not (slid or modes[i] == STICK):
                continue
            if slid != slides or (slides and system.slip[i] @ slips[i] <= 0.0):
                self.reports.announce_at(t, i, self.reports.friction_event(i, slides), q, v)

    def _rebounds(self, c: int) -> bool:
        """Whether contact c comes in so fast that it leaves again."""
        return -self.restitution[c] * gap_rate(self.system, c) > REST_SPEED

    def collide(self, t: float, touching: list[int], restitution: dict[int, float], jammed: bool = False) -> float:
        """Impulses on all closed contacts and ends of joints, then new modes from the velocities after them.

        touching: contacts that have struck, whose modes the caller announces; restitution: coefficients of those that
        rebound; jammed: see `apply_impact`.
        """
        system, changes = self.system, self.changes
        self._before = system.contact_int[:, MODE].copy(), system.slip.copy(), system.q.copy(), system.v.copy()
        changes.started.clear()
        near = self._close_near(touching)
        changes.evaluate_rows(t)
        closed, ends = system.closed(), self.joints.held_at_ends()
        deep = any(c in self.penetration.contacts for c in closed)
        energy = sum(changes.energies()) if deep else 0.0
        impact = apply_impact(system, changes.modes.solver, closed, list(ends), restitution, {*touching, *near}, jammed)
        if impact is None:
            crushing = crushing_items(system, closed, list(ends))
            if crushing:
                raise crushed(t, [self.reports.describe(i) for i in crushing])
            names = ", ".join(repr(self.reports.names[i]) for i in touching or closed) or "a joint's limit"
            raise Stop(FAILURES[NO_FORCE][0], f"t = {t:.9g} s: no impulses satisfy Coulomb's law at {names}")
        self.rk.keep_velocity()
        struck, kinetic = system.v.copy(), changes.energies()[0] if deep else 0.0
        changes.count_works(impact.contacts, impact.drives, impact.joints)
        if jammed:
            self._jam_on(t)
        changes.evaluate_rows(t)
        self._rubbing, self._rubs_alone = self._slips()
        self._open_leaving(closed)
        speeds = {g: abs(float(system.v[system.limits[g].index_v])) for g in ends}
        self.joints.set_from_velocities({g: end for g, end in ends.items() if speeds[g] <= _LEAVING_SPEED})
        changes.set_from_velocities(after_impact=True)
        before = changes.counted_energy()
        changes.stop_jammed(t)
        self._brake(t)
        # what stays closed with a normal velocity (a bounce that is none) stops here, which may turn slow slips
        if self._project(t):
            changes.stop_jammed(t)
        else:
            changes.set_from_velocities(after_impact=True)
        self._end_short_motions(t, closed, ends)
        self._announce_opened(t, closed, touching, near)
        changes.count_loss(before)
        if deep:
            self._return_lift(t, energy + impact.drives, struck, kinetic)
        # slips of the projected velocities: what had one before may be at rest now
        undecided = changes.set_from_velocities(after_impact=True)
        return self.onset.resolve(t, undecided, silent=True)

    # ---------------------------------------------------------------- what takes part, and what leaves

    def _close_near(self, touching: list[int]) -> list[int]:
        """Let all take part in an impact that is as near as symmetric motions leave it, whatever it does before:
        contacts, which are returned, and ends of joints.

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
            and self.onset.open.apart[c]
            and c not in self.penetration.contacts
            and self.restitution[c] == 0.0
            and self._is_due(c)
            and not waits(system, c, touching)
        ]
        for c in near:
            modes[c] = rest_mode(system.contact_real[c, MU])
        self.joints.hold_near()
        return near

    def _open_leaving(self, closed: list[int]) -> None:
        """Open contacts that leave what they have struck, however slowly where others cannot be kept beside them."""
        system, penetration = self.system, self.penetration
        below = {i: -float(system.gaps[i, 0]) for i in closed}
        unilateral = [i for i in closed if system.contact_int[i, UNILATERAL]]
        leaving = [i for i in unilateral if self._leaves(i, below[i] - penetration.accuracy(i))]
        kept = {i: gap_rate(system, i) for i in closed if i not in leaving}
        self._lasting.clear()
        if not self._stops_alone(kept):
            self._lasting.update(i for i in unilateral if kept.get(i, 0.0) > rest_speed(system))
        for i in [*leaving, *self._lasting]:
            system.contact_int[i, MODE] = FREE
            penetration.thrown_off.add(i)
            if below[i] > gap_resolution(system)[i]:
                # rebounds from where it is
                penetration.tolerate(i, below[i])

    def _leaves(self, i: int, below: float) -> bool:
        """Whether contact i leaves what it has struck; inside it would have to rise by `below` in m, if positive."""
        leaving, system = gap_rate(self.system, i), self.system
        falling = -float(system.rows[i, 2] @ system.free_acceleration + system.bias[i, 2])
        return leaving > _LEAVING_SPEED and leaving * leaving > 2.0 * falling * max(below, 0.0)

    def _stops_alone(self, speeds: dict[int, float]) -> bool:
        """Whether what leaves in these contacts, at these speeds in m/s, can be stopped by about what each of them
        takes. Where constraints are next to dependent, as of four wheels on uneven ground, to stop bounces,
        however low, may take any part of the velocity."""
        system = self.system
        if len(speeds) < 2:
            return True
        rows = np.array([whiten(system, system.rows[i, 2]) for i in speeds])
        lengths, wanted = np.linalg.norm(rows, axis=1), np.array([*speeds.values()])
        moving = lengths > 0.0
        rows, alone = rows[moving] / lengths[moving, None], wanted[moving] / lengths[moving]
        taken = float(np.linalg.norm(np.linalg.lstsq(rows, alone, rcond=REDUNDANT)[0]))
        return taken <= max(_NEXT_TO_DEPENDENT * float(np.abs(alone).sum()), self.changes.modes.negligible())

    def _announce_opened(self, t: float, closed: list[int], touching: list[int], near: list[int]) -> None:
        """Announce what has been thrown off by what others have struck, and what has struck besides."""
        for i in closed:
            opened = self.system.contact_int[i, MODE] == FREE
            if i in near and not opened:
                self.reports.announce(t, i, "touch")
            elif opened and i not in near and i not in touching:
                self.reports.announce(t, i, "separate")

    def _slips(self) -> tuple[np.ndarray, bool]:
        """Speeds in m/s of the slips of closed contacts that have dry friction, and of bounces that would end turning
        against a resistance, and whether a contact slides whose friction `_brake` does not know: of ideal rolling, or
        of a bilateral contact, whose impulse may turn round."""
        system, slowest = self.system, rest_speed(self.system)
        coefficients = {c: system.contact_real.item(c, MU) for c in system.closed()}
        speeds = {c: self.changes.slip_speed(c) for c, mu in coefficients.items() if mu > 0.0}
        sliding = [c for c, speed in speeds.items() if speed > slowest]
        rough = [c for c in sliding if coefficients[c] < math.inf]
        known = [c for c in rough if system.contact_int[c, UNILATERAL]]
        turning = {i: self.changes.slip_speed(i) for i in system.resisting()}
        ending = [speed * self._bounce_that_ends(i) for i, speed in turning.items() if speed > slowest]
        return np.array([*(speeds[c] for c in rough), *ending]), len(known) < len(sliding)

    def _bounce_that_ends(self, i: int) -> float:
        """Speed in m/s of a bounce whose impulse ends turning at 1 rad/s against resistance i."""
        rows, tangents = self.system.rows, int(self.system.contact_int[i, TANGENTS])
        normal, *turning = (whiten(self.system, row) for row in [rows[self.system.owner(i), 2], *rows[i, :tangents]])
        braked = coefficient(self.system, i) * max(float(row @ row) for row in turning)
        return float(normal @ normal) / braked if braked > 0.0 else math.inf

    def _resolution(self, i: int, speed: float) -> float:
        """Way in m or rad below which a motion of item i at this speed in m/s or rad/s is none.

        To leave it out moves impulses by its duration, which leaves no more than that way; but where a contact slides,
        friction goes with the impulses, and what is left of its slip goes with the root of the way.
        """
        way = float(gap_resolution(self.system)[i])
        resolved = self._rubs_alone or self._rubbing.max(initial=0.0) > speed
        return way if resolved else max(way, float(self.system.gap_accuracy[i]) / GAP_TOLERANCE)

    def _resolution_of_bounces(self, i: int, speed: float) -> float:
        """The same of a motion that ends where it has begun: `_brake` lets friction go with the impulses that leave it
        out, which leaves no more than that way, too, unless they end slips or turn them round, or friction that goes
        with no load holds something up."""
        if not self._rubs_alone and self._rubbing.min(initial=math.inf) > _FASTER * speed:
            return max(float(gap_resolution(self.system)[i]), float(self.system.gap_accuracy[i]) / GAP_TOLERANCE)
        return self._resolution(i, speed)

    def _brake(self, t: float) -> None:
        """Stop what stays closed or is held, but leaves: by impulses that come with friction of what slides."""
        system = self.system
        # what is stopped, how fast it is, where the normals of contacts are among it, and what acts there if any slides
        rows: list[np.ndarray] = []
        speeds: list[float] = []
        places: dict[int, int] = {}
        braking: dict[int, np.ndarray] = {}
        slips: dict[int, np.ndarray] = {}
        for i in [*system.closed(), *(system.nc + g for g in system.held()), *system.resisting()]:
            integers, on_joint = system.contact_int[i], system.nc <= i < system.nc + system.ng
            tangents = int(integers[TANGENTS]) if integers[MODE] == STICK and not on_joint else 0
            normals = (2,) if i < system.nc + system.ng else ()
            for row in sorted({*range(tangents), *normals}):
                rows.append(system.rows[i, row])
                speeds.append(float(system.slip[i, 2] if on_joint else system.basis[i, row] @ system.slip[i]))
            if normals:
                places[i] = len(rows) - 1
            owner = system.owner(i)
            loaded = system.contact_int[owner, UNILATERAL] and not held_up_by_friction(system, owner)
            if integers[MODE] == SLIPPING and loaded:
                friction, k = coefficient(system, i) * associated(system, i, slip_direction(system, i)), places[owner]
                braking[k] = braking.get(k, rows[k]) - friction @ system.rows[i, :2]
                slips[i] = (system.basis[i, :2] @ system.slip[i])[: integers[TANGENTS]]
        if not braking or max(map(abs, speeds)) <= rest_speed(system):
            return
        # one by one: BLAS starts threads for many columns, which cost more
        normal = np.array([whiten(system, row) for row in rows]).T
        pushed = normal.copy()
        for k, action in braking.items():
            pushed[:, k] = whiten(system, action)
        change = pushed @ np.linalg.lstsq(normal.T @ pushed, -np.array(speeds), rcond=REDUNDANT)[0]
        change = unwhiten(system, change)
        # slips that would become others have friction of other directions
        for i, slip in slips.items():
            if _FASTER * np.linalg.norm(system.rows[i, : slip.size] @ change) > np.linalg.norm(slip):
                return
        system.v[:] += change
        self.rk.keep_velocity()
        self.changes.evaluate_rows(t)

    def _return_lift(self, t: float, energy: float, struck: np.ndarray, kinetic: float) -> None:
        """After an impact of contacts that had penetrated, and have been lifted out.

        The motion has what it fell too far, and gives back what the lift takes beyond what the impact took.
        energy: in J, that of the motion before the impact, and of drives; struck, kinetic: v and energy after it.
        """
        system, changes = self.system, self.changes
        ended, potential = changes.energies()
        last = system.v.copy()
        # Drives have velocities of their own, to which the rest of v is M-orthogonal: half of them is what a projection
        # puts back when v is halved. Slips have no say in it, and may leave no forces there.
        modes = system.contact_int[:, MODE]
        modes[modes == SLIPPING] = FRICTIONLESS
        velocity = system.stage_state[system.nq : system.nq + system.nv]
        whole = velocity.copy()
        velocity *= 0.5
        self.rk.load(system.stage_state)
        changes.project(t, explained=True)
        driven = 2.0 * velocity - whole
        # what has ended since the impact had an energy beside drives; these have done work on it, of either sign
        drives = 2.0 * system.v - last
        relative = [whitened_velocity(system, v - drives) for v in (last, struck)]
        own, before = (0.5 * float(v @ v) for v in relative)
        driving = ended - own - (kinetic - before)
        excess = ended + potential - energy - driving
        weight = pin.computeTotalMass(system.model) * float(np.linalg.norm(system.model.gravity.linear))
        if excess > own + weight * float(system.gap_accuracy.max()):
            raise Stop(
                STEP_TOO_SMALL,
                f"t = {t:.9g} s: to lift out what has dipped before it struck takes {excess:.3g} J, and the motion has "
                f"{own:.3g} J",
            )
        kept = min(max(1.0 - excess / own, 0.0), 1.0) if own > 0.0 else 0.0
        velocity[:] = driven + math.sqrt(kept) * (whole - driven)
        self.rk.load(system.stage_state)
        changes.evaluate_rows(t)
        changes.count_works(friction=(kept - 1.0) * own - driving, drives=driving)

    # ---------------------------------------------------------------- motions too short to be told from rest

    def _end_short_motions(self, t: float, contacts: list[int], ends: dict[int, int]) -> None:
        """End what an impact has begun and would end within distances shorter than positions are known to: slips, and
        bounces of what took part, contacts and ends of joints (coordinate -> end).

        Else a body that comes to rest goes on for ever: such a slip's friction tips it, and what tips falls as far
        below the ground as its touch is noticed late; and coupled joints that are pressed onto their ends throw each
        other off them in turn.
        """
        system, changes, joints = self.system, self.changes, self.joints
        modes = system.contact_int[:, MODE]
        # what would not stay at rest: it goes on from there, later, at a speed of its own
        lasting: set[int] = set()
        for _ in range(2 * system.items + 1):
            if self.rk.evaluate(t) > EVENT:
                return
            before = system.contact_int.copy(), system.joint_int.copy(), system.stage_state.copy()
            slips = [c for c in system.closed() if modes[c] == SLIPPING and self._stops_soon(c)]
            slips = [c for c in slips if c not in lasting]
            left = [g for g in ends if joints.is_free(g)]
            bounces = [g for g in left if joints.returns_soon(g, ends[g], self._resolution_of_bounces)]
            # dry joints that soon stop throw others back onto their ends
            stops = [g for g in range(system.ng) if joints.is_free(g) and joints.stops_soon(g, self._resolution)]
            stops = [g for g in stops if system.nc + g not in lasting]
            touches = [c for c in contacts if modes[c] == FREE and self._returns_soon(t, c) and c not in self._lasting]
            if touches and not self._stops_alone({c: gap_rate(system, c) for c in [*system.closed(), *touches]}):
                self._lasting.update(touches)
                touches = []
            if not (slips or stops or bounces or touches):
                return
            for c in touches:
                modes[c] = rest_mode(system.contact_real[c, MU])
            if touches:
                changes.set_from_velocities(after_impact=True)
            modes[slips] = STICK
            for g in stops:
                changes.modes.hold(g, 0)
            for g in bounces:
                changes.modes.hold(g, ends[g])
            self._brake(t)
            if not self._project(t):
                changes.set_from_velocities(after_impact=True)
            elif self.rk.evaluate(t) <= EVENT:
                ended = [*slips, *(system.nc + g for g in stops)]
                beyond = [i for i in ended if min(system.event_functions[i, FORCE_EVENTS]) < 0.0]
                if beyond:
                    lasting.update(beyond)
                    system.contact_int[:], system.joint_int[:] = before[:2]
                    self.rk.load(before[2])

    def _project(self, t: float) -> bool:
        """Put the state on its constraints; False where the slips that it has leave no forces. Then those have been
        stopped that may be, and others are to be decided anew: a bounce that is none has its own slip."""
        system, modes = self.system, self.system.contact_int[:, MODE]
        if self.rk.project(t, False):
            return True
        slowest = rest_speed(system)
        bouncing = [c for c in system.closed() if modes[c] == SLIPPING and abs(gap_rate(system, c)) > slowest]
        modes[bouncing] = FRICTIONLESS
        sliding = may_stop(system)
        if sliding:
            self.changes.stop_slips(t, sliding)
            return False
        if bouncing and self.rk.project(t, False):
            self.changes.set_from_velocities(after_impact=True)
            if self.rk.evaluate(t) <= EVENT:
                return False
        # the slip that an impact has left jams at once
        self._jam_on(t)
        return False

    def _jam_on(self, t: float) -> None:
        """Impacts without collision while slips jam: slower ones may have other friction, and jam at once again."""
        system, changes, ends = self.system, self.changes, list(self.joints.held_at_ends())
        for _ in range(_JAMS):
            changes.evaluate_rows(t)
            changes.set_from_velocities(after_impact=True)
            if self.rk.evaluate(t) <= EVENT and is_positive(system):
                return
            changes.evaluate_rows(t)
            impact = apply_impact(system, changes.modes.solver, system.closed(), ends, {}, jammed=True)
            if impact is None:
                raise self.reports.failure(t, NO_FORCE)
            self.rk.keep_velocity()
            changes.count_works(impact.contacts, impact.drives, impact.joints)

    def _stops_soon(self, c: int) -> bool:
        """Whether the slip of contact c ends in a distance that is shorter than positions are known to. Right behind a
        jam forces are as large as can be, in their first moments, and tell nothing of it."""
        system = self.system
        speed, rate = system.contact_real[c, [SLIP_SPEED, SLIP_RATE]].tolist()
        free = system.rows[c] @ system.free_acceleration + system.bias[c]
        lasts = -rate <= _JAMMED * float(np.abs(free).max())
        return bool(rate < 0.0 and lasts and speed * speed <= -2.0 * rate * self._resolution(c, speed))

    def _returns_soon(self, t: float, c: int) -> bool:
        """Whether contact c comes back from no further than gaps are known."""
        if c in self.penetration.contacts or abs(float(self.system.gaps[c, 0])) > self.penetration.accuracy(c):
            return False
        speed, back = gap_rate(self.system, c), -self.changes.modes.gap_acceleration(t, c)
        return back > 0.0 and speed * speed <= 2.0 * back * self._resolution_of_bounces(c, speed)
