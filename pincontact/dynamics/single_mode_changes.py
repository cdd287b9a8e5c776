"""Single changes of modes: joint coordinates that are let go, and contacts that a part of viscous friction holds up."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..layout import (
    EVENT,
    FREE,
    FRICTION_EVENT,
    FRICTIONLESS,
    HIGH_FORCE,
    JOINT_END,
    JOINT_SIGN,
    JOINT_V,
    LOW_FORCE,
    MODE,
    NORMAL_EVENT,
    NORMAL_SIGN,
    OK,
    SLIP_SIGN,
    SLIPPING,
    TANGENTS,
)
from .contact_modes import drags, shares_viscous_force
from .redistribution import RedundantForces

# Accelerations below this part of the free ones are round-off.
ROUND_OFF = 1e-11
# Viscous friction by which a contact is held up is all of it to so much.
_AT_ALL = 1e-6


class SingleModeChanges(RedundantForces):
    """Changes single modes of contacts and joint coordinates."""

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
        for g, (end, sign) in released.items():
            if self._rate(g, sign) < -ROUND_OFF:
                del released[g]
                self.hold(g, end)
                return True
        return False

    def _all_go(self, released: dict[int, tuple[int, int]]) -> bool:
        """Whether all joint coordinates that were let go begin to move."""
        return all(self._rate(g, sign) > ROUND_OFF for g, (_, sign) in released.items())

    def _rate(self, g: int, sign: int) -> float:
        """Acceleration of joint coordinate g in the direction of `sign`, as a part of the largest free one, if anything
        accelerates the bodies."""
        system, largest = self.system, float(np.abs(self.system.free_acceleration).max())
        return sign * float(system.acceleration[system.joint_int[g, JOINT_V]]) / (largest or 1.0)

    def share(self, t: float, c: int, evaluate: Callable[[float], int]) -> bool:
        """Keep contact c, whose normal force would pull, closed without one, by a part of its viscous friction; False
        where that is not needed, or does not do. Then the contact is what it was.

        Viscous friction ends as a contact opens. Where it pushes the bodies apart, they would close again at once: the
        contact can neither stay closed nor open. Between both, a part of the friction keeps it where it is (the
        solution of Filippov, and the limit of ever shorter rebounds).
        """
        system = self.system
        integers = system.contact_int[c]
        if not drags(system, c) or shares_viscous_force(system, c):
            return False
        mode, sign = int(integers[MODE]), int(integers[SLIP_SIGN])
        integers[MODE] = FREE
        if evaluate(t) <= EVENT and self.gap_acceleration(t, c) < 0.0:
            self._hold_by_share(c)
            if evaluate(t) <= EVENT and not self._takes_all(c):
                loads = system.event_functions[system.closed(), NORMAL_EVENT]
                if system.event_functions[c, NORMAL_EVENT] >= 0.0 and (loads >= -self.force_round_off()).all():
                    return True
        integers[MODE], integers[NORMAL_SIGN], integers[SLIP_SIGN] = mode, 1, sign
        evaluate(t)
        return False

    def _hold_by_share(self, c: int) -> None:
        """Let a part of its viscous friction hold up contact c, which slides."""
        system, integers = self.system, self.system.contact_int[c]
        integers[MODE], integers[NORMAL_SIGN] = SLIPPING, -1
        if integers[TANGENTS] == 1:
            integers[SLIP_SIGN] = 1 if system.basis[c, 0] @ system.slip[c] >= 0.0 else -1

    def _takes_all(self, c: int) -> bool:
        """Whether contact c is held up by more than all of its viscous friction. It starts with all of it."""
        system = self.system
        force = math.hypot(system.force[c, 0], system.force[c, 1])
        return bool(system.event_functions[c, FRICTION_EVENT] < -_AT_ALL * force)

    def pressed(self, contacts: list[int]) -> list[int]:
        """Which of these contacts, of ideal rolling that is frictionless without a load, have one in the last
        evaluation."""
        modes, functions = self.system.contact_int[:, MODE], self.system.event_functions
        return [c for c in contacts if modes[c] == FRICTIONLESS and functions[c, FRICTION_EVENT] < 0.0]

    def gap_acceleration(self, t: float, c: int) -> float:
        """Second derivative in m/s^2 of the gap of an open contact in the last evaluation; NaN if it has no rows."""
        system = self.system
        if system.evaluate_kinematics(t) != OK:
            return math.nan
        return float(system.rows[c, 2] @ system.acceleration + system.bias[c, 2])
