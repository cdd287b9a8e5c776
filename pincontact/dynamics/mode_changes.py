"""Modes found by one change after the other, for contacts whose forces obey laws that are no cones.

Those are bilateral contacts, whose normal force has either sign, and those that friction alone holds up. Which mode is
changed next is the same for the same state: joint coordinates, normal forces, slip that would go back, the largest
excess of friction.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from ..geometry.patterns import ON_CURVE
from ..layout import (
    EVENT,
    FREE,
    FRICTION_EVENT,
    FRICTIONLESS,
    FROZEN,
    HIGH_FORCE,
    JOINT_END,
    JOINT_SIGN,
    JOINT_V,
    LOW_FORCE,
    MODE,
    MU,
    NO_FORCE,
    NORMAL_EVENT,
    NORMAL_SIGN,
    OK,
    PATTERN,
    SLIP_RATE,
    SLIP_SIGN,
    SLIPPING,
    STICK,
    TANGENTS,
    UNILATERAL,
)
from .contact_modes import Decision, drags, shares_viscous_force
from .directions import align_slips, freeze_slip
from .friction_scaling import opposed_slip
from .redistribution import RedundantForces

# Accelerations below this part of the free ones are round-off.
_ROUND_OFF = 1e-11
# Viscous friction by which a contact is held up is all of it to so much.
_AT_ALL = 1e-6
# Changes of mode for every contact and coordinate where they are made one by one.
_CHANGES = 4
# So often the same modes may come back: directions of slip that are found on the way may be others.
_RETURNS = 2


class ModeChanges(RedundantForces):
    """Changes modes of contacts and joint coordinates one at a time until all forces obey their laws."""

    def release(self, g: int, sign: int) -> None:
        """Let held coordinate g move in the direction of `sign`."""
        limit = self.system.joint_int[g]
        dry = self.system.joint_real[g, LOW_FORCE] < self.system.joint_real[g, HIGH_FORCE]
        limit[JOINT_SIGN], limit[JOINT_END] = sign if dry else 0, 0
        self.system.contact_int[self.system.nc + g, MODE] = FREE

    def hold(self, g: int, end: int) -> None:
        """Hold coordinate g at its lower (-1) or upper (+1) end, or by dry friction (0)."""
        self.system.joint_int[g, JOINT_SIGN], self.system.joint_int[g, JOINT_END] = 0, end
        self.system.contact_int[self.system.nc + g, MODE] = FRICTIONLESS

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
            if decision.status == NO_FORCE and self._open_jammed(t, closed, evaluate, decision):
                continue
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
            if (system.event_functions[closed, NORMAL_EVENT] < -self.force_round_off()).any():
                # as it has turned
                continue
            worst = self._exceeding(closed)
            if worst is None:
                decision.started = {c: float(system.contact_real[c, SLIP_RATE]) for c in started}
                self._stick_at_limits(t, decision, evaluate)
                return decision
            # what slides from the same modes as before has gone back, and will again
            seen[integers[:, : FROZEN + 1].tobytes() + system.joint_int.tobytes()] += 1
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
            low, high = (
                system.event_functions[system.nc + g, NORMAL_EVENT],
                system.event_functions[system.nc + g, FRICTION_EVENT],
            )
            if min(low, high) < -self.force_round_off():
                sign = 1 if low < high else -1
                released[g] = int(system.joint_int[g, JOINT_END]), sign
                self.release(g, sign)
                return True
        return False

    def _hold_one(self, released: dict[int, tuple[int, int]]) -> bool:
        """Hold a joint coordinate again that was let go and would go back, if there is one."""
        system = self.system
        for g, (end, sign) in released.items():
            rate = sign * float(system.acceleration[system.joint_int[g, JOINT_V]])
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
            if system.event_functions[c, NORMAL_EVENT] < -self.force_round_off():
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
                if integers[i, MODE] == STICK and system.event_functions[i, FRICTION_EVENT] < excess * scale:
                    worst, excess = i, system.event_functions[i, FRICTION_EVENT] / scale
        return worst

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
            holds = evaluate(t) <= EVENT and (system.event_functions[c, [NORMAL_EVENT, FRICTION_EVENT]] >= 0.0).all()
            if holds and system.contact_real[c, SLIP_RATE] > 0.0:
                decision.started[c] = float(system.contact_real[c, SLIP_RATE])
                return
            integers[[MODE, FROZEN]] = FREE, 0
        decision.opened.append(c)

    def _open_jammed(self, t: float, closed: list[int], evaluate, decision: Decision) -> bool:
        """Let a contact go that slides and whose force would pull it in by more than it pushes it out, if one stays
        apart without."""
        integers = self.system.contact_int
        for c in closed:
            if integers[c, MODE] != SLIPPING or not integers[c, UNILATERAL]:
                continue
            integers[c, MODE] = FREE
            if evaluate(t) <= EVENT and self.gap_acceleration(t, c) >= 0.0:
                decision.opened.append(c)
                return True
            integers[c, MODE] = SLIPPING
        return False

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
            if evaluate(t) <= EVENT and system.event_functions[c, NORMAL_EVENT] >= 0.0 and not self._takes_all(c):
                return True
        integers[MODE], integers[NORMAL_SIGN], integers[SLIP_SIGN] = mode, 1, sign
        evaluate(t)
        return False

    def _takes_all(self, c: int) -> bool:
        """Whether contact c is held up by more than all of its viscous friction. It starts with all of it."""
        system = self.system
        force = math.hypot(system.force[c, 0], system.force[c, 1])
        return bool(system.event_functions[c, FRICTION_EVENT] < -_AT_ALL * force)

    def _closes_without(self, t: float, c: int, evaluate) -> bool:
        """Whether contact c would close if it and what would pull without it were let go; it is open then."""
        system = self.system
        modes = system.contact_int[: system.nc, MODE].copy()
        system.contact_int[c, MODE] = FREE
        closes = False
        while evaluate(t) <= EVENT:
            pulls = system.event_functions[: system.nc, NORMAL_EVENT] < -self.force_round_off()
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
