"""Ideal rolling that is let go with a force: how deep its gap dips before it opens by itself, and how deep it may."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..layout import DOMAIN, EVENT, FREE, LENGTH, MODE, MU, OK, UNILATERAL
from .results import GAP_TOLERANCE

if TYPE_CHECKING:
    from ..dynamics.modes import ModeSolver
    from .runge_kutta import RungeKutta

# Ideal rolling that is let go with a force may dip by this part of the contact's length before it opens by itself, too
# little to be seen. A disk that rolls off a sphere, as the references know it, does by 4.4e-4, foreseen to 3 %.
_DEEPEST = 1e-3
# A dip this many times deeper than was foreseen is none, and touches.
_SLACK = 2.0


class Dips:
    """The open contacts of a system that may be deeper than gaps are known.

    depths (items,): by how much, in m; the event locator reads it.
    """

    def __init__(self, rk: RungeKutta, modes: ModeSolver) -> None:
        self._rk, self._modes = rk, modes
        self.depths = np.zeros(rk.system.items)
        self.contacts: set[int] = set()

    def reach(self, c: int) -> float:
        """Accuracy in m to which the gap of contact c is known."""
        relative, absolute = self._rk.system.scale.tolist()
        return GAP_TOLERANCE * (absolute + relative * self._rk.system.contact_real.item(c, LENGTH))

    def may_be(self, c: int, depth: float) -> bool:
        """Whether contact c may be let go to dip by depth in m."""
        return depth <= max(self.reach(c), self._deepest(c))

    def _deepest(self, c: int) -> float:
        return _DEEPEST * float(self._rk.system.contact_real[c, LENGTH])

    def let(self, c: int, depth: float) -> None:
        """Let open contact c get as deep in m as foreseen, and somewhat deeper, before it touches."""
        if depth > self.reach(c):
            self.start_at(c, _SLACK * depth)

    def start_at(self, c: int, depth: float) -> None:
        """Let open contact c get so deep in m."""
        self.depths[c] = depth
        self.contacts.add(c)

    def end(self, c: int) -> None:
        """Contact c is apart, or closed."""
        self.depths[c] = 0.0
        self.contacts.discard(c)

    def foresee(self, t: float, c: int, tau: float, gap: float = 0.0, rate: float = 0.0) -> float:
        """How deep in m the gap of an open contact gets from the accepted state on; infinite if it does not recover.

        tau: time in s over which the rate j of the gap's second derivative a is measured; gap, rate: its value in m
        and first derivative. From 0 and 0 it dips by 2 |a|^3 / (3 j^2). The accepted state's evaluation is lost.
        """
        rk, system = self._rk, self._rk.system
        first = later = math.nan
        if rk.evaluate_start(t) <= EVENT:
            first = self._modes.gap_acceleration(t, c)
        if first >= 0.0 and rate >= 0.0:
            return max(0.0, -gap)
        if tau > 0.0 and rk.attempt(t, tau) == OK:
            rk.load(system.new_state)
            if rk.evaluate(t + tau) <= EVENT:
                later = self._modes.gap_acceleration(t + tau, c)
        jerk = (later - first) / tau if tau > 0.0 else math.nan
        if not jerk > 0.0:
            return math.inf
        # the later root of rate + first s + jerk s^2 / 2; where there is none the gap only rises
        root = first * first - 2.0 * jerk * rate
        lowest = max(math.sqrt(root) - first, 0.0) / jerk if root > 0.0 else 0.0
        return max(-(gap + lowest * (rate + lowest * (0.5 * first + lowest * jerk / 6.0))), 0.0)

    def take_up(self, t: float, tau: float) -> bool:
        """Take up the dips in the midst of which a run starts; False where the start cannot be evaluated any more."""
        rk, system = self._rk, self._rk.system
        deep = [
            c
            for c in range(system.nc)
            if system.contact_int[c, MODE] == FREE
            and system.contact_int[c, UNILATERAL]
            and math.isinf(system.contact_real[c, MU])
            and system.contact_real[c, DOMAIN] >= 0.0
            and -self._deepest(c) <= system.gaps[c, 0] < -self.reach(c)
        ]
        for c in deep:
            gap, rate = float(system.gaps[c, 0]), float(system.basis[c, 2] @ system.slip[c])
            depth = self.foresee(t, c, tau, gap, rate)
            if depth <= self._deepest(c):
                self.let(c, depth)
            rk.load(system.state)
            if rk.evaluate_start(t) > EVENT:
                return False
        return True
