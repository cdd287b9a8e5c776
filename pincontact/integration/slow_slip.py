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
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import array_entry
from ..dynamics.evaluation import PLACES_OF_ALL
from ..dynamics.sliding import slip_direction
from ..geometry.small import dot
from ..jit import BOOLEAN, CALLED, INTEGER, REAL, kernel
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
from ..linalg import inner, least_norm
from .stages import evaluate, hand_over
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
    system, k = rk.system, len(powers)
    relative, absolute = system.scale.tolist()
    tolerance = _ACCEPTED * (absolute + relative * max(map(abs, system.v.tolist()), default=0.0))
    tries = _TRIES_OF_SEVERAL if sum(power > 0 for power in powers.values()) > 1 else _HALVINGS
    part: float
    # whether slips grow from rest, or are that slow that the tolerance leaves them no direction
    slowest = tolerance / _ALIGNED
    grown = [power > 0 or not system.contact_real.item(c, START_SPEED) > slowest for c, power in powers.items()]
    items, size = np.array([*powers.items()], dtype=np.int64).reshape(k, 2), k * POLYNOMIAL_SIZE
    coefficients, order = np.zeros((k, POLYNOMIAL_SIZE)), np.empty(size, dtype=np.int64)
    # the pulls are not known yet
    memory = np.full(k * (2 * _LOOKS + k) + size * (4 + 3 * size), math.nan)
    given = tolerance, items, np.array(grown, dtype=bool), coefficients, memory, order
    while tries > 0 and span >= shortest:
        part = system.checked(collocate(system.address, t, span, *given))
        if part < 1.0:
            tries -= 1
        else:
            part = until_event(t, span)
            if part == 1.0:
                return span
        span *= part
        # the same directions in a shorter time
        coefficients *= part ** np.arange(POLYNOMIAL_SIZE)
    return None


@array_entry(
    INTEGER, REAL, REAL, REAL, INTEGER[:, ::1], BOOLEAN[::1], REAL[:, ::1], REAL[::1], INTEGER[::1], when=CALLED
)
def collocate(address, t, span, tolerance, items, grown, coefficients, memory, order):
    """Broyden's iteration on the polynomials' coefficients (k, POLYNOMIAL_SIZE), from those given, which become the
    best ones; the part of the span that is to be tried next, 1 where v_c ends up along the direction everywhere.

    items (k, 2): contacts (or resistances), and powers of the time; grown (k,): which grow from rest; memory, order:
    scratch, of which the pulls are kept, NaN where they are not known.
    """
    system, k, n = system_at(address), items.shape[0], POLYNOMIAL_SIZE
    size, at = k * n, 2 * _LOOKS * k
    across, along = memory[: _LOOKS * k].reshape(k, _LOOKS), memory[_LOOKS * k : at].reshape(k, _LOOKS)
    pulls, at = memory[at : at + k * k].reshape(k, k), at + k * k
    vectors, at = memory[at : at + 4 * size].reshape(4, size), at + 4 * size
    begun, residual, right, step = vectors[0], vectors[1], vectors[2], vectors[3]
    matrices = memory[at:].reshape(3 * size, size)
    scalars, largest, aligned, found = system.scalars, -1.0, False, False
    if not _look_along(system, t, span, items, coefficients, across, along):
        return SHORTER
    # what directions change is little against what makes steps inaccurate
    if not scalars.error_norm < 1.0:
        return max(_SMALLEST_PART, SHORTER * scalars.error_norm ** (-1.0 / (scalars.error_order + 1.0)))
    for i in range(size):
        begun[i] = coefficients[i // n, i % n]
    for _ in range(_ITERATIONS):
        aligned = is_aligned(across, along, grown, tolerance, 1.0, _LOOKS)
        found = aligned or is_aligned(across, along, grown, tolerance, _CONVERGED, n)
        if found:
            break
        if largest < 0.0:
            # only slips that turn ask for them
            if math.isnan(pulls[0, 0]) and not _find_pulls(system, t, items, pulls, right):
                return 0.0
            _begin_jacobian(span, items, pulls, along, matrices)
            largest = _DIVERGED * _take_residual(across, residual)
        for i in range(size):
            right[i] = -residual[i]
            for j in range(size):
                matrices[size + i, j] = matrices[i, j]
        copy = matrices[size:]
        if least_norm(copy, right, size, size, step, matrices[2 * size :], order, 0.0) < size:
            break
        for i in range(size):
            coefficients[i // n, i % n] += step[i]
        if not _largest(coefficients) < 1.0 or not _look_along(system, t, span, items, coefficients, across, along):
            break
        for i in range(size):
            # what the Jacobian foretells
            right[i] = residual[i] + inner(matrices[i], step, size)
        if not _take_residual(across, residual) <= largest:
            break
        square = inner(step, step, size)
        for i in range(size):
            for j in range(size):
                matrices[i, j] += (residual[i] - right[i]) * step[j] / square
    if not found:
        turned = _largest(coefficients)
        for i in range(size):
            coefficients[i // n, i % n] = begun[i]
        return max(_SMALLEST_PART, SHORTER / max(turned, 1.0)) if turned < math.inf else _SMALLEST_PART
    part = _until_end(system, items, along, tolerance)
    if part < 1.0:
        return part
    # the last trial step has left the state at the end of the span in new_state
    for m in range(k):
        system.contact_real[items[m, 0], SLIP_SPEED] = math.hypot(across[m, _LAST], along[m, _LAST])
    return 1.0 if aligned and scalars.error_norm < 1.0 else SHORTER


@kernel
def _look_along(system, t, span, items, coefficients, across, along):
    """v_c across and along the prescribed directions at the shares of a step from the state at t, which is tried,
    divided by the shares' powers; whether that can be evaluated."""
    for m in range(items.shape[0]):
        numbers = system.contact_real[items[m, 0]]
        numbers[START], numbers[SPAN] = t, span
        for j in range(POLYNOMIAL_SIZE):
            numbers[POLYNOMIAL + j] = coefficients[m, j]
    if start(system, t) > EVENT or trial_step(system, t, span, False) != OK or interpolation(system, t, span) > EVENT:
        return False
    direction = system.vectors[0]
    for i in range(_LOOKS):
        share = _SHARES[i]
        load_interpolated(system, share)
        if evaluate(system, t + share * span, PLACES_OF_ALL) > EVENT:
            return False
        for m in range(items.shape[0]):
            c, growth = items[m, 0], 1.0
            for _ in range(items[m, 1]):
                growth *= share
            basis, slip = system.basis[c], system.slip[c]
            slip_direction(system.contact_int[c], system.contact_real[c], slip, basis, t + share * span, direction)
            first, second = dot(basis[0], slip), dot(basis[1], slip)
            across[m, i] = (direction[0] * second - direction[1] * first) / growth
            along[m, i] = (direction[0] * first + direction[1] * second) / growth
    return True


@kernel
def _find_pulls(system, t, items, pulls, before):
    """pulls (k, k): what the acceleration of each in m/s^2 across its direction changes by as that of another turns by
    1 rad, in the accepted state; whether that can be evaluated. before (k,): scratch."""
    state, stage_state = system.state, system.stage_state
    for i in range(system.sizes.ny):
        stage_state[i] = state[i]
    hand_over(system, stage_state)
    for turned in range(-1, items.shape[0]):
        for m in range(items.shape[0]):
            system.contact_real[items[m, 0], POLYNOMIAL] = _PERTURBATION if m == turned else 0.0
        if evaluate(system, t, 0) > EVENT:
            return False
        for m in range(items.shape[0]):
            c = items[m, 0]
            basis, forward = system.basis[c], system.contact_real[c, DIRECTION_X:]
            rate = system.relative_acceleration[c]
            aside = dot(basis[0], forward) * rate[1] - dot(basis[1], forward) * rate[0]
            if turned < 0:
                before[m] = aside
            else:
                pulls[m, turned] = (aside - before[m]) / _PERTURBATION
    return True


@kernel
def _begin_jacobian(span, items, pulls, along, out):
    """An approximation to the derivative of v_c across the directions at the nodes by the coefficients.

    A turn by p s^j leaves a p s^(j+1) / (j+1) of v_c across the direction, as friction pulls aside from then on, and
    itself turns the direction against v_c.
    """
    n = POLYNOMIAL_SIZE
    for i in range(items.shape[0] * n):
        m, node, share = i // n, i % n, _SHARES[i % n]
        for other in range(items.shape[0]):
            for j in range(n):
                slope = span * pulls[m, other] * share ** (j + 1 - items[m, 1]) / (j + 1)
                out[i, other * n + j] = slope - (along[m, node] * share**j if other == m else 0.0)


@kernel
def _take_residual(across, residual):
    """v_c across the directions at the nodes, as one vector; its largest entry, NaN if one is."""
    size = 0.0
    for i in range(residual.shape[0]):
        residual[i] = across[i // POLYNOMIAL_SIZE, i % POLYNOMIAL_SIZE]
        size = abs(residual[i]) if not abs(residual[i]) <= size else size
    return size


@kernel
def _largest(coefficients):
    """The largest of all coefficients, infinite if one is no number."""
    size = 0.0
    for m in range(coefficients.shape[0]):
        for j in range(POLYNOMIAL_SIZE):
            size = max(size, abs(coefficients[m, j]) if coefficients[m, j] == coefficients[m, j] else math.inf)
    return size


@kernel
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
