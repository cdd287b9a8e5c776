"""Slow slip in three dimensions, whose direction turns faster than it moves: it is prescribed and found by collocation.

The equation that turns the direction of slip has the stiffness mu N / (m |v_c|), which no explicit method can follow
where |v_c| is small: not out of stick at the friction limit, where v_c and the relative acceleration are zero and v_c
grows as c t^2 u(t) / 2 with a smooth direction u(t); not just beyond the angle of friction, where it grows as a t u(t)
with a small a, however long; not in creeping motions. The direction itself changes slowly there. So it is prescribed
as a polynomial of time, which leaves a smooth, non-stiff motion, and the coefficients are found such that v_c has no
component across it (collocation).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import array_entry
from ..jit import BOOLEAN, INTEGER, REAL
from ..layout import (
    ACROSS_X,
    CONTACT_REALS,
    DIRECTION_X,
    EVENT,
    FROZEN,
    FROZEN_COLUMNS,
    POLYNOMIAL,
    POLYNOMIAL_SIZE,
    SPAN,
    START,
    START_SPEED,
)
from .steps import ACROSS_SLIP

if TYPE_CHECKING:
    from ..dynamics.system import System
    from .runge_kutta import RungeKutta

# Fractions of the span at which v_c is made parallel to the direction, and others at which that is checked.
_NODES = (0.2, 0.45, 0.7, 0.9, 1.0)
_CHECKS = (0.32, 0.58, 0.8, 0.96)
# All of them behind the start, and which is next in time.
_SHARES = np.array([0.0, *_NODES, *_CHECKS])
_IN_ORDER = np.argsort(_SHARES).tolist()[1:]
_PERTURBATION = 1e-4
_ITERATIONS = 8
_HALVINGS = 30
# Several slips that start at once, of one body as a rule, have more directions than it has ways to move: next to no
# motion decides among them. Those that can be followed were found at the third and fourth span; trying all the others
# costs as much as all steps of a second.
_TRIES_OF_SEVERAL = 5
# v_c across the prescribed direction, relative to the velocity tolerance, that is accepted between the nodes, and the
# fraction of it that is left at the nodes.
_ACCEPTED = 0.03
_CONVERGED = 0.05
# The same relative to slip that has grown from rest.
_ALIGNED = 0.1
# What a span is shortened to that cannot be followed.
SHORTER, _SMALLEST_PART = 0.5, 0.01
# A span that slip ends in is shortened to this part of the way to its end.
_STOP_FRACTION = 0.8
# Residuals that have grown by this factor will not come down any more.
_DIVERGED = 3.0


class SlowSlip:
    """Slip with prescribed directions, from the accepted state at t on.

    powers: of these contacts (or resistances) v_c grows with this power of the time; 2 out of stick at its limit, 1
    from rest, 0 where it is there already. until_event(t, step): the part of the last trial step, which has been
    interpolated, in which nothing else happens, 1 where that is all of it.
    """

    def __init__(
        self, rk: RungeKutta, t: float, powers: dict[int, int], until_event: Callable[[float, float], float]
    ) -> None:
        self.rk, self.t, self.powers, self.until_event = rk, t, powers, until_event
        self.contacts = list(powers)
        # (contacts, shares) of the largest v_c, as slips grow with their powers of the time
        self._growth = _SHARES[1:] ** np.array([*powers.values()])[:, None]

    def follow(self, span: float, shortest: float) -> float | None:
        """Move the accepted state on; returns how long in s that took, None if it failed.

        The contacts are in slip with frozen directions. span: longest time in s to try; it is shortened until the
        direction polynomial is accurate and uneventful, not below `shortest`. On success `system.new_state` is the
        state after it, unprojected.
        """
        system = self.rk.system
        tolerance = system.scale[1] + system.scale[0] * float(np.abs(system.v).max(initial=0.0))
        several = sum(power > 0 for power in self.powers.values()) > 1
        tries = _TRIES_OF_SEVERAL if several else _HALVINGS
        coefficients = np.zeros((len(self.contacts), POLYNOMIAL_SIZE))
        tolerance *= _ACCEPTED
        grown = self._grown(tolerance)
        while tries > 0 and span >= shortest:
            system.contact_real[self.contacts, START : SPAN + 1] = self.t, span
            part = self._collocate(span, tolerance, grown, coefficients)
            if part < 1.0:
                tries -= 1
            else:
                part = self.until_event(self.t, span)
                if part == 1.0:
                    return span
            span *= part
            # the same directions in a shorter time
            coefficients *= part ** np.arange(POLYNOMIAL_SIZE)
        return None

    def _collocate(self, span: float, tolerance: float, grown: np.ndarray, coefficients: np.ndarray) -> float:
        """Broyden's iteration on the polynomials' coefficients, from those given, which become the best ones; the part
        of the span that is to be tried next, 1 where v_c ends up along the direction everywhere."""
        found = self._across(span, coefficients)
        # what directions change is little against what makes steps inaccurate
        if found is None or not self.rk.error < 1.0:
            return SHORTER if found is None else self._within_error()
        start = coefficients.copy()
        jacobian: np.ndarray | None = None
        for _ in range(_ITERATIONS):
            aligned = is_aligned(*found, grown, tolerance, 1.0, len(_NODES) + len(_CHECKS))
            if aligned or is_aligned(*found, grown, tolerance, _CONVERGED, len(_NODES)):
                break
            if jacobian is None:
                if self._pulls is None:
                    return 0.0
                jacobian = self._jacobian(span * self._pulls, found[1][:, :POLYNOMIAL_SIZE])
                residual = found[0][:, :POLYNOMIAL_SIZE].ravel()
                largest = _DIVERGED * float(np.abs(residual).max())
            try:
                step = -np.linalg.solve(jacobian, residual)
            except np.linalg.LinAlgError:
                found = None
                break
            coefficients += step.reshape(coefficients.shape)
            found = self._across(span, coefficients) if np.abs(coefficients).max() < 1.0 else None
            if found is None or not np.abs(found[0][:, :POLYNOMIAL_SIZE]).max() <= largest:
                found = None
                break
            before, residual = residual, found[0][:, :POLYNOMIAL_SIZE].ravel()
            jacobian += np.outer(residual - before - jacobian @ step, step) / (step @ step)
        else:
            found = None
        if found is None:
            turned = float(np.abs(coefficients).max())
            coefficients[:] = start
            return max(_SMALLEST_PART, SHORTER / max(turned, 1.0))
        part = self._until_end(found[1], tolerance)
        if part < 1.0:
            return part
        # the last trial step has left the state at the end of the span in new_state
        return 1.0 if aligned and self.rk.error < 1.0 else SHORTER

    def _within_error(self) -> float:
        """The part of the span after which the last trial step's error is as small as it has to be."""
        order = self.rk.system.scalars.error_order
        return max(_SMALLEST_PART, SHORTER * self.rk.error ** (-1.0 / (order + 1.0)))

    def _grown(self, tolerance: float) -> np.ndarray:
        """(contacts,) whether slips grow from rest, or are that slow that the tolerance leaves them no direction."""
        slowest = tolerance / _ALIGNED
        speeds = self.rk.system.contact_real[self.contacts, START_SPEED].tolist()
        return np.array([power > 0 or not speed > slowest for power, speed in zip(self.powers.values(), speeds)])

    def _until_end(self, along: np.ndarray, tolerance: float) -> float:
        """The part of the span in which slips go on, from v_c along the directions: those that are there have to stay
        faster than the tolerance, or than a part of what they are; the others have to grow. 1 where that is all of it.
        """
        part = 1.0
        for m, speeds in enumerate(along.tolist()):
            start = self.rk.system.contact_real.item(self.contacts[m], START_SPEED)
            if self.powers[self.contacts[m]] > 0 or not 0.0 < start < math.inf:
                part = part if min(speeds) > 0.0 else min(part, SHORTER)
                continue
            least = min(tolerance, _ALIGNED * start)
            left = [speed - least for speed in (start, *speeds)]
            before = 0
            for after in _IN_ORDER:
                if left[after] <= 0.0:
                    way = _SHARES[after] - _SHARES[before]
                    end = _SHARES[before] + way * left[before] / (left[before] - left[after])
                    part = min(part, float(_STOP_FRACTION * end))
                    break
                before = after
        return part

    @cached_property
    def _pulls(self) -> np.ndarray | None:
        """(contacts, contacts) what the acceleration of each in m/s^2 across its direction changes by as that of
        another turns by 1 rad, in the accepted state; None where that cannot be evaluated. Only slips that turn ask
        for it."""
        rk, system, contacts = self.rk, self.rk.system, self.contacts
        rk.load(system.state)
        columns: list[np.ndarray] = []
        before = np.zeros(len(contacts))
        directions = [system.basis[c, :2] @ system.contact_real[c, DIRECTION_X : DIRECTION_X + 3] for c in contacts]
        for turned in (None, *contacts):
            system.contact_real[contacts, POLYNOMIAL] = 0.0
            if turned is not None:
                system.contact_real[turned, POLYNOMIAL] = _PERTURBATION
            if rk.evaluate(self.t) > EVENT:
                return None
            along = system.relative_acceleration[contacts]
            across = np.array([x * a[1] - y * a[0] for (x, y), a in zip(directions, along)])
            if turned is None:
                before = across
            else:
                columns.append((across - before) / _PERTURBATION)
        return np.array(columns).T

    def _jacobian(self, pulls: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """An approximation to the derivative of v_c across the directions at the nodes by the coefficients.

        pulls: (contacts, contacts) in m/s, speeds: (contacts, nodes) along the directions. A turn by p s^j leaves
        a p s^(j+1) / (j+1) of v_c across the direction, as friction pulls aside from then on, and itself turns the
        direction against v_c.
        """
        n, k = POLYNOMIAL_SIZE, len(self.contacts)
        s, orders = np.array(_NODES)[:, None], np.arange(n)
        out = np.zeros((k, n, k, n))
        for m, power in enumerate(self.powers.values()):
            out[m] = pulls[m][None, :, None] * (s ** (orders + 1 - power) / (orders + 1))[:, None, :]
            out[m, :, m] -= speeds[m][:, None] * s**orders
        return out.reshape(k * n, k * n)

    def _across(self, span: float, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """(contacts, shares) v_c across and along the prescribed directions at the nodes and then between them, divided
        by the shares' powers."""
        system, contacts = self.rk.system, self.contacts
        system.contact_real[contacts, POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE] = coefficients
        system.across[0] = _SHARES[1:]
        if system.run(ACROSS_SLIP, self.t, span) > EVENT:
            return None
        n = system.items + 1
        return system.across[1:n][contacts] / self._growth, system.across[n:][contacts] / self._growth


@array_entry(REAL[:, ::1], REAL[:, ::1], BOOLEAN[::1], REAL, REAL, INTEGER)
def is_aligned(across, along, grown, tolerance, within, count):
    """Whether v_c (contacts, shares) is across the directions by no more than `within` of the tolerance, or, where it
    has grown from rest, of its own size: it goes on in the direction that it shows. count: of shares to look at."""
    for m in range(across.shape[0]):
        allowed = tolerance
        for k in range(count if grown[m] else 0):
            allowed = min(allowed, _ALIGNED * abs(along[m, k]))
        for k in range(count):
            if not abs(across[m, k]) <= within * allowed:
                return False
    return True


def frozen_directions(integers: np.ndarray, columns: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(n, nc, 3) prescribed slip directions, world axes; zero where v_c tells the direction.

    integers (n, nc, ...): the contacts' integers; columns (n, nc, FROZEN_COLUMNS): their reals from START on;
    t (n,) in s.
    """
    out = np.zeros((*columns.shape[:2], 3))
    if not integers[:, :, FROZEN].any():
        return out
    for row, c in np.argwhere(integers[:, :, FROZEN] != 0):
        numbers = np.zeros(CONTACT_REALS)
        numbers[START : START + FROZEN_COLUMNS] = columns[row, c]
        out[row, c] = _direction(numbers, (t[row] - numbers[START]) / numbers[SPAN])
    return out


def present_directions(system: System) -> np.ndarray:
    """(nc, 3) the same of a system's contacts, where they do not change."""
    out = np.zeros((system.nc, 3))
    for c in range(system.nc):
        if system.contact_int[c, FROZEN]:
            out[c] = system.contact_real[c, DIRECTION_X : DIRECTION_X + 3]
    return out


def set_frozen_directions(system: System, directions: np.ndarray) -> None:
    """Prescribe constant slip directions, as `frozen_directions` gives them, to the contacts that are marked so."""
    for c in range(system.nc):
        if system.contact_int[c, FROZEN]:
            numbers = system.contact_real[c]
            numbers[DIRECTION_X : DIRECTION_X + 3] = directions[c]
            numbers[POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE] = 0.0


def _direction(numbers: np.ndarray, share: float) -> np.ndarray:
    turn = float(np.polynomial.polynomial.polyval(share, numbers[POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE]))
    return numbers[DIRECTION_X : DIRECTION_X + 3] + turn * numbers[ACROSS_X : ACROSS_X + 3]
