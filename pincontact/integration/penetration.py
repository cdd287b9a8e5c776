"""Contacts that have opened and are not yet apart: those that may penetrate a little first, and those that have moved
by less than gaps are known.

Ideal rolling is let go with a force. Without F_t the second derivative of its gap jumps to -J_n M^-1 J_t^T F_t. Where
that is negative, but rises, the bodies penetrate before the contact opens by itself. A penetration that is small enough
is tolerated.
"""

from __future__ import annotations

import math

import numpy as np

from ..dynamics.modes import ModeSolver
from ..layout import DOMAIN, EVENT, FREE, GAP_EVENT, LENGTH, MODE, MU, OK, UNILATERAL
from .accuracy import gap_rate, gap_resolution, gaps_at_once
from .ends import at_end, comes_in, deepest_at_end, passes_by
from .results import Event
from .runge_kutta import RungeKutta

# Ideal rolling that is let go with a force may penetrate by this part of the contact's length before it opens by
# itself, too little to be seen. A disk that rolls off a sphere, as the references know it, does by 4.4e-4, foreseen to
# 3 %.
_DEEPEST = 1e-3
# A gap this many times deeper than was foreseen does not open by itself, and touches.
_SLACK = 2.0
# A penetration is foreseen when its end is to this part of its depth.
_BACK = 0.1
_TRIALS = 10


class Penetration:
    """Contacts that have opened and whose gap has not been positive since.

    depths (items,): how much deeper in m than the accuracy of gaps open contacts may be; the event locator reads it.
    contacts: those for which that is not zero. barely_open: mode before, and event, of contacts that have opened and
    were no further apart since than gaps are known. thrown_off: contacts that an impact has opened, while they were no
    further apart since.
    """

    def __init__(self, rk: RungeKutta, modes: ModeSolver) -> None:
        self._rk, self._modes = rk, modes
        self.depths = np.zeros(rk.system.items)
        self.contacts: set[int] = set()
        self.barely_open: dict[int, tuple[int, Event]] = {}
        self.thrown_off: set[int] = set()

    def accuracy(self, c: int) -> float:
        """Error in m of the gap of contact c."""
        return float(self._rk.system.gap_accuracy[c])

    def resolution(self, c: int) -> float:
        """Height in m below which a rebound of contact c is none."""
        return float(gap_resolution(self._rk.system)[c])

    def slack(self, c: int) -> float:
        """How deep in m open contact c may be."""
        return self.resolution(c) + float(self.depths[c])

    def touches(self, c: int) -> bool:
        """Whether an open contact touches now as far as instants are told apart, between points inside both domains, or
        about to be."""
        system, gap, least = self._rk.system, float(self._rk.system.gaps[c, 0]), float(gaps_at_once(self._rk.system)[c])
        if comes_in(system, c):
            touches = -max(least, deepest_at_end(system, c)) <= gap <= least
        else:
            touches = abs(gap) <= least and bool(system.contact_real[c, DOMAIN] > at_end(system))
        return touches and not passes_by(system, c)

    def has_stayed_closed(self, c: int) -> bool:
        """Whether contact c has opened, and the gap is and was zero within its error since, the last trial step
        included."""
        system, accuracy = self._rk.system, self.accuracy(c)
        return (
            (c in self.barely_open or c in self.thrown_off)
            and abs(system.gaps[c, 0]) <= accuracy
            and bool(system.highest[c, GAP_EVENT] <= accuracy)
        )

    def tolerate(self, c: int, depth: float) -> None:
        """Let open contact c get as deep in m."""
        self.depths[c] = depth
        self.contacts.add(c)

    def watch(self, stepped: bool) -> None:
        """Look which of these contacts are apart at the accepted state, which is evaluated, or closed again.

        stepped: whether the last trial step led there in the present modes.
        """
        system = self._rk.system
        for c in {*self.contacts, *self.barely_open, *self.thrown_off}:
            accuracy = self.accuracy(c)
            if system.gaps[c, 0] > accuracy or system.contact_int[c, MODE] != FREE:
                self.barely_open.pop(c, None)
                self.thrown_off.discard(c)
                self.depths[c] = 0.0
                self.contacts.discard(c)
            elif stepped and system.highest[c, GAP_EVENT] > accuracy:
                self.barely_open.pop(c, None)
                self.thrown_off.discard(c)

    # ---------------------------------------------------------------- ideal rolling that is let go

    def closes_again(self, t: float, contacts: list[int], tau: float) -> bool:
        """Whether any of these contacts, ideal rolling whose normal forces are zero in the accepted state, would close
        if they were let go; where they would only penetrate a little, that is tolerated. tau: see `_foresee`. The
        accepted state's evaluation is lost.
        """
        system, modes = self._rk.system, self._modes
        integers, limits, forces = system.contact_int.copy(), system.joint_int.copy(), modes.reference()
        system.contact_int[contacts, MODE] = FREE
        # what else slips or opens with them decides where the gaps go
        decision = modes.resolve_modes(t, [], self._rk.evaluate_start)
        known = decision.status <= EVENT
        depths = {c: self._foresee(t, c, tau) if known else math.inf for c in contacts}
        # an evaluation frees what resists the turning of an open contact, too
        system.contact_int[:], system.joint_int[:] = integers, limits
        modes.take_back(forces)
        if math.inf in depths.values():
            return True
        for c, depth in depths.items():
            self._tolerate_penetration(c, depth)
        return False

    def begin(self, t: float, tau: float) -> bool:
        """Tolerate penetrations in which a run starts; False where the start cannot be evaluated any more."""
        rk, system = self._rk, self._rk.system
        integers, numbers = system.contact_int[: system.nc], system.contact_real[: system.nc]
        rolled = (integers[:, MODE] == FREE) & (integers[:, UNILATERAL] != 0) & np.isinf(numbers[:, MU])
        for c in np.flatnonzero(rolled & (numbers[:, DOMAIN] >= 0.0)).tolist():
            gap = float(system.gaps[c, 0])
            if not -self._deepest(c) <= gap < -self.resolution(c):
                continue
            depth = self._foresee(t, c, tau, gap, gap_rate(system, c))
            if depth < math.inf:
                self._tolerate_penetration(c, depth)
            if rk.evaluate_start(t) > EVENT:
                return False
        return True

    def _deepest(self, c: int) -> float:
        """How deep in m contact c may penetrate."""
        return max(_DEEPEST * float(self._rk.system.contact_real[c, LENGTH]), self.accuracy(c))

    def _tolerate_penetration(self, c: int, depth: float) -> None:
        if depth > 0.0:
            self.tolerate(c, _SLACK * depth)

    def _foresee(self, t: float, c: int, tau: float, gap: float = 0.0, rate: float = 0.0) -> float:
        """How deep in m the gap of an open contact gets from the accepted state on; infinite if that is more than is
        tolerated, or it does not recover.

        tau: time in s over which the rate j of the gap's second derivative a is first measured; gap, rate: its value
        in m and first derivative. With a constant j it falls from 0 and 0 by 2 |a|^3 / (3 j^2) and is back after
        3 |a| / j. Trial steps over all of that show where it is then, and the mean of j until then. The accepted
        state's evaluation is lost.
        """
        first = math.nan
        if self._rk.evaluate_start(t) <= EVENT:
            first = self._modes.gap_acceleration(t, c)
        if first >= 0.0 and rate >= 0.0:
            return max(0.0, -gap)
        jerk = math.nan
        if tau > 0.0 and self._evaluate_after(t, tau):
            jerk = (self._modes.gap_acceleration(t + tau, c) - first) / tau
        for _ in range(_TRIALS):
            if not jerk > 0.0:
                break
            # the later root of the derivative; where there is none the gap only rises
            root = first * first - 2.0 * jerk * rate
            lowest = max(math.sqrt(root) - first, 0.0) / jerk if root > 0.0 else 0.0
            foreseen = -_cubic(lowest, gap, rate, first, jerk)
            if lowest <= 0.0 or foreseen <= 0.0:
                return max(0.0, -gap)
            end = 1.5 * lowest
            if foreseen > self._deepest(c):
                break
            if end <= tau:
                return foreseen
            if not self._evaluate_after(t, end):
                break
            error = float(self._rk.system.gaps[c, 0]) - _cubic(end, gap, rate, first, jerk)
            jerk += 6.0 * error / end**3
            if abs(error) <= _BACK * foreseen:
                found = self._evaluate_after(t, lowest)
                return max(-float(self._rk.system.gaps[c, 0]), 0.0) if found else math.inf
        return math.inf

    def _evaluate_after(self, t: float, tau: float) -> bool:
        """Evaluate what a trial step from the accepted state over tau leads to; whether that is possible."""
        rk = self._rk
        if rk.try_step(t, tau) != OK:
            return False
        rk.load(rk.system.new_state)
        return rk.evaluate(t + tau) <= EVENT


def _cubic(s: float, gap: float, rate: float, acceleration: float, jerk: float) -> float:
    """Gap after s seconds, from its value and derivatives."""
    return gap + s * (rate + s * (0.5 * acceleration + s * jerk / 6.0))
