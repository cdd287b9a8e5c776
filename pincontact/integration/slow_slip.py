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
from ..dynamics.evaluation import PLACES_OF_ALL
from ..dynamics.sliding import slip_direction
from ..geometry.small import dot
from ..jit import INTEGER, REAL, inlined_kernel, kernel
from ..layout import (
    ACROSS_X,
    CONTACT_REALS,
    DIRECTION_X,
    EVENT,
    FROZEN,
    FROZEN_COLUMNS,
    OK,
    POLYNOMIAL,
    POLYNOMIAL_SIZE,
    SLIP_SPEED,
    SPAN,
    START,
    START_SPEED,
    system_at,
)
from .stages import evaluate
from .trial_steps import interpolation, load_interpolated, start, trial_step

if TYPE_CHECKING:
    from ..dynamics.system import System
    from .runge_kutta import RungeKutta

# Fractions of the span at which v_c is made parallel to the direction, and others behind them at which that is checked;
# which is next in time, and which is the last.
_SHARES = (0.2, 0.45, 0.7, 0.9, 1.0, 0.32, 0.58, 0.8, 0.96)
_IN_ORDER = tuple(sorted(range(len(_SHARES)), key=_SHARES.__getitem__))
_LOOKS, _LAST = len(_SHARES), POLYNOMIAL_SIZE - 1
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


def follow_slips(
    rk: RungeKutta,
    t: float,
    powers: dict[int, int],
    span: float,
    shortest: float,
    until_event: Callable[[float, float], float],
) -> float | None:
    """Move the accepted state at t on by slip with prescribed directions; how long in s that took, None if it failed.

    powers: of these contacts (or resistances), in slip with frozen directions, v_c grows with this power of the time; 2
    out of stick at its limit, 1 from rest, 0 where it is there already. span: longest time in s to try; it is shortened
    until the direction polynomial is accurate and uneventful, not below `shortest`. until_event(t, step): the part of
    the last trial step, which has been interpolated, in which nothing else happens, 1 where that is all of it.
    On success `system.new_state` is the state after it, unprojected, and SLIP_SPEED that of these contacts there.
    """
    system, looks = rk.system, _Looks(rk, t, powers)
    tries = _TRIES_OF_SEVERAL if sum(power > 0 for power in powers.values()) > 1 else _HALVINGS
    while tries > 0 and span >= shortest:
        part = looks.collocate(span)
        if part < 1.0:
            tries -= 1
        else:
            part = until_event(t, span)
            if part == 1.0:
                for c, speed in zip(powers, looks.speeds[1, :, _LAST].tolist()):
                    system.contact_real[c, SLIP_SPEED] = speed
                return span
        span *= part
        # the same directions in a shorter time
        looks.coefficients *= part ** np.arange(POLYNOMIAL_SIZE)
    return None


class _Looks:
    """Steps from the accepted state at t with directions of these slips, see `follow_slips`.

    coefficients (k, POLYNOMIAL_SIZE): of the directions; speeds (2, k, shares): v_c across and along them, divided by
    the shares' powers.
    """

    def __init__(self, rk: RungeKutta, t: float, powers: dict[int, int]) -> None:
        self.rk, self.system, self.t, self.powers, k = rk, rk.system, t, powers, len(powers)
        relative, absolute = self.system.scale.tolist()
        fastest = max(map(abs, self.system.v.tolist()), default=0.0)
        self.tolerance = _ACCEPTED * (absolute + relative * fastest)
        # whether slips grow from rest, or are that slow that the tolerance leaves them no direction
        starts, slowest = [self.system.contact_real.item(c, START_SPEED) for c in powers], self.tolerance / _ALIGNED
        table = [(c, power, power > 0 or not speed > slowest) for (c, power), speed in zip(powers.items(), starts)]
        self._items = np.array(table, dtype=np.int64).reshape(k, 3)
        self.coefficients, self.speeds = np.zeros((k, POLYNOMIAL_SIZE)), np.empty((2, k, _LOOKS))

    def collocate(self, span: float) -> float:
        """Broyden's iteration on the coefficients, from those that there are, which become the best ones; the part of
        the span that is to be tried next, 1 where v_c ends up along the direction everywhere."""
        part, scalars = self._look(span), self.system.scalars
        # what directions change is little against what makes steps inaccurate
        if math.isnan(part):
            return SHORTER
        if not scalars.error_norm < 1.0:
            return max(_SMALLEST_PART, SHORTER * scalars.error_norm ** (-1.0 / (scalars.error_order + 1.0)))
        if part <= 1.0:
            return part
        if self._pulls is None:
            return 0.0
        nodes, start = self.speeds[0, :, :POLYNOMIAL_SIZE], self.coefficients.copy()
        jacobian, residual = self._jacobian(span * self._pulls), nodes.flatten()
        largest = _DIVERGED * float(np.abs(residual).max())
        for _ in range(1, _ITERATIONS):
            try:
                step = -np.linalg.solve(jacobian, residual)
            except np.linalg.LinAlgError:
                break
            self.coefficients += step.reshape(start.shape)
            part = self._look(span) if np.abs(self.coefficients).max() < 1.0 else math.nan
            if part <= 1.0:
                return part
            before, residual = residual, nodes.flatten()
            if math.isnan(part) or not np.abs(residual).max() <= largest:
                break
            jacobian += np.outer(residual - before - jacobian @ step, step) / (step @ step)
        turned = float(np.abs(self.coefficients).max())
        self.coefficients[:] = start
        return max(_SMALLEST_PART, SHORTER / max(turned, 1.0))

    def _look(self, span: float) -> float:
        """`look_along`."""
        given = self.tolerance, self._items, self.coefficients, self.speeds
        result: float = self.system.checked(look_along(self.system.address, self.t, span, *given))
        return result

    @cached_property
    def _pulls(self) -> np.ndarray | None:
        """(k, k) what the acceleration of each in m/s^2 across its direction changes by as that of another turns by 1
        rad, in the accepted state; None where that cannot be evaluated. Only slips that turn ask for it."""
        rk, system, contacts = self.rk, self.system, [*self.powers]
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

    def _jacobian(self, pulls: np.ndarray) -> np.ndarray:
        """An approximation to the derivative of v_c across the directions at the nodes by the coefficients; pulls:
        (k, k) in m/s. A turn by p s^j leaves a p s^(j+1) / (j+1) of v_c across the direction, as friction pulls aside
        from then on, and itself turns the direction against v_c."""
        n, k = POLYNOMIAL_SIZE, len(self.powers)
        s, orders = np.array(_SHARES[:n])[:, None], np.arange(n)
        out = np.zeros((k, n, k, n))
        for m, power in enumerate(self.powers.values()):
            out[m] = pulls[m][None, :, None] * (s ** (orders + 1 - power) / (orders + 1))[:, None, :]
            out[m, :, m] -= self.speeds[1, m, :n, None] * s**orders
        return out.reshape(k * n, k * n)


@array_entry(INTEGER, REAL, REAL, REAL, INTEGER[:, ::1], REAL[:, ::1], REAL[:, :, ::1])
def look_along(address, t, span, tolerance, items, coefficients, speeds):
    """v_c across and along the prescribed directions at the shares of a step from the state at t, which is tried,
    divided by the shares' powers, into speeds (2, k, shares). The part of the span that is to be tried next, 1 where
    v_c is along the directions everywhere; 2 where it is not at the nodes, NaN where it cannot be evaluated.

    items (k, 3): contacts (or resistances), powers of the time, and whether slip grows from rest.
    """
    system, across, along = system_at(address), speeds[0], speeds[1]
    for m in range(items.shape[0]):
        numbers = system.contact_real[items[m, 0]]
        numbers[START], numbers[SPAN] = t, span
        for j in range(POLYNOMIAL_SIZE):
            numbers[POLYNOMIAL + j] = coefficients[m, j]
    if start(system, t) > EVENT or trial_step(system, t, span, False) != OK or interpolation(system, t, span) > EVENT:
        return math.nan
    direction = system.vectors[0]
    for i in range(_LOOKS):
        share = _SHARES[i]
        load_interpolated(system, share)
        if evaluate(system, t + share * span, PLACES_OF_ALL) > EVENT:
            return math.nan
        for m in range(items.shape[0]):
            c, growth = items[m, 0], 1.0
            for _ in range(items[m, 1]):
                growth *= share
            basis, slip = system.basis[c], system.slip[c]
            slip_direction(system.contact_int[c], system.contact_real[c], slip, basis, t + share * span, direction)
            first, second = dot(basis[0], slip), dot(basis[1], slip)
            across[m, i] = (direction[0] * second - direction[1] * first) / growth
            along[m, i] = (direction[0] * first + direction[1] * second) / growth
    aligned = is_aligned(across, along, items, tolerance, 1.0, _LOOKS)
    if not (aligned or is_aligned(across, along, items, tolerance, _CONVERGED, POLYNOMIAL_SIZE)):
        return 2.0
    part = _until_end(system, items, along, tolerance)
    # the trial step has left the state at the end of the span in new_state
    return part if part < 1.0 or (aligned and system.scalars.error_norm < 1.0) else SHORTER


@inlined_kernel
def _until_end(system, items, along, tolerance):
    """The part of the span in which slips go on, from v_c along the directions: those that are there have to stay
    faster than the tolerance, or than a part of what they are; the others have to grow. 1 where that is all of it."""
    part = 1.0
    for m in range(items.shape[0]):
        speed = system.contact_real[items[m, 0], START_SPEED]
        if items[m, 1] > 0 or not 0.0 < speed < math.inf:
            for i in range(_LOOKS):
                if not along[m, i] > 0.0:
                    part = min(part, SHORTER)
            continue
        least = min(tolerance, _ALIGNED * speed)
        share, left = 0.0, speed - least
        for i in _IN_ORDER:
            after = along[m, i] - least
            if after <= 0.0:
                part = min(part, _STOP_FRACTION * (share + (_SHARES[i] - share) * left / (left - after)))
                break
            share, left = _SHARES[i], after
    return part


@kernel
def is_aligned(across, along, items, tolerance, within, count):
    """Whether v_c (k, shares) is across the directions by no more than `within` of the tolerance, or, where it grows
    from rest, of its own size: it goes on in the direction that it shows. items (k, 3): see `look_along`; count: of
    shares to look at."""
    for m in range(across.shape[0]):
        allowed = tolerance
        for k in range(count if items[m, 2] != 0 else 0):
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
