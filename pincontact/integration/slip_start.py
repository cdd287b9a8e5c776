"""Slip that grows from rest out of stick, in three dimensions.

At the friction limit v_c and the relative acceleration are zero: the direction of slip is undefined, and the equation
that turns it has the stiffness mu N / (m |v_c|), which no explicit method can follow. Just after the start v_c is
c t^2 u(t) / 2 with a smooth direction u(t). So the direction is prescribed as a polynomial of time, which leaves a
smooth, non-stiff motion, and its coefficients are found such that v_c has no component across it (collocation).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

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
    SPAN,
    START,
)

if TYPE_CHECKING:
    from ..dynamics.system import System
    from .runge_kutta import RungeKutta

# Fractions of the span at which v_c is made parallel to the direction, and others at which that is checked.
_NODES = (0.2, 0.45, 0.7, 0.9, 1.0)
_CHECKS = (0.32, 0.58, 0.8, 0.96)
_PERTURBATION = 1e-4
_NEWTON_STEPS = 5
_REFRESHES = 2
_HALVINGS = 30
# v_c across the prescribed direction, relative to the velocity tolerance, that is accepted between the nodes.
_ACCEPTED = 0.1
_CONVERGED = 1e-3


def start_slip(
    rk: RungeKutta, t: float, contacts: list[int], span: float, shortest: float, uneventful: Callable[[], bool]
) -> float | None:
    """Move the accepted state at t through the start of slip; returns how long in s that took, None if it failed.

    The contacts are in slip with frozen directions. span: longest time in s to try; it is halved until the direction
    polynomial is accurate and nothing else happens in it, which uneventful() tells from the last attempt's margins, not
    below `shortest`. On success `system.new_state` is the state after it, unprojected.
    """
    tolerance = rk.system.scale[1] + rk.system.scale[0] * float(np.abs(rk.system.v).max(initial=0.0))
    for _ in range(_HALVINGS):
        if span < shortest:
            return None
        for c in contacts:
            numbers = rk.system.contact_real[c]
            numbers[START], numbers[SPAN] = t, span
            numbers[POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE] = 0.0
        if _collocate(rk, t, contacts, span, tolerance) and uneventful():
            return span
        span *= 0.5
    return None


def _collocate(rk: RungeKutta, t: float, contacts: list[int], span: float, tolerance: float) -> bool:
    """Newton on the polynomials' coefficients; whether v_c ends up along the direction everywhere."""
    size = POLYNOMIAL_SIZE * len(contacts)
    coefficients = np.zeros(size)
    residual = _across(rk, t, contacts, span, coefficients, _NODES)
    if residual is None:
        return False
    for refresh in range(_REFRESHES):
        jacobian = np.zeros((size, size))
        for j in range(size):
            moved = coefficients.copy()
            moved[j] += _PERTURBATION
            other = _across(rk, t, contacts, span, moved, _NODES)
            if other is None:
                return False
            jacobian[:, j] = (other - residual) / _PERTURBATION
        if _newton(rk, t, contacts, span, tolerance, jacobian, coefficients, residual):
            break
        if refresh == _REFRESHES - 1 or not np.abs(coefficients).max() < 1.0:
            return False
    between = _across(rk, t, contacts, span, coefficients, _CHECKS)
    # the last attempt has left the state at the end of the span in new_state
    return between is not None and float(np.abs(between).max()) <= _ACCEPTED * tolerance and rk.error < 1.0


def _newton(
    rk: RungeKutta,
    t: float,
    contacts: list[int],
    span: float,
    tolerance: float,
    jacobian: np.ndarray,
    coefficients: np.ndarray,
    residual: np.ndarray,
) -> bool:
    """Steps with one Jacobian, updating coefficients and residual in place; whether they converged."""
    for _ in range(_NEWTON_STEPS):
        try:
            coefficients -= np.linalg.solve(jacobian, residual)
        except np.linalg.LinAlgError:
            return False
        if not np.abs(coefficients).max() < 1.0:
            return False
        found = _across(rk, t, contacts, span, coefficients, _NODES)
        if found is None:
            return False
        residual[:] = found
        if np.abs(residual).max() <= _CONVERGED * tolerance:
            return True
    return False


def _across(
    rk: RungeKutta, t: float, contacts: list[int], span: float, coefficients: np.ndarray, shares: tuple[float, ...]
) -> np.ndarray | None:
    """v_c across the prescribed directions, divided by the share squared (v_c grows so), at shares of the span."""
    system = rk.system
    for i, c in enumerate(contacts):
        system.contact_real[c, POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE] = coefficients[
            i * POLYNOMIAL_SIZE : (i + 1) * POLYNOMIAL_SIZE
        ]
    if rk.evaluate_start(t) > EVENT or rk.attempt(t, span) != OK:
        return None
    dense = rk.interpolant(t, span)
    if dense is None:
        return None
    out = np.zeros((len(contacts), len(shares)))
    for k, share in enumerate(shares):
        rk.load(dense(share))
        if rk.evaluate(t + share * span) > EVENT:
            return None
        for i, c in enumerate(contacts):
            direction = _direction(system.contact_real[c], share) @ system.basis[c, :2].T
            direction /= np.linalg.norm(direction)
            slip = system.basis[c, :2] @ system.slip[c]
            out[i, k] = (direction[0] * slip[1] - direction[1] * slip[0]) / share**2
    return out.ravel()


def frozen_directions(integers: np.ndarray, columns: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(n, nc, 3) prescribed slip directions, world axes; zero where v_c tells the direction.

    integers (n, nc, ...): the contacts' integers; columns (n, nc, FROZEN_COLUMNS): their reals from START on;
    t (n,) in s.
    """
    out = np.zeros((*columns.shape[:2], 3))
    for row, c in np.argwhere(integers[:, :, FROZEN] != 0):
        numbers = np.zeros(CONTACT_REALS)
        numbers[START : START + FROZEN_COLUMNS] = columns[row, c]
        out[row, c] = _direction(numbers, (t[row] - numbers[START]) / numbers[SPAN])
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
