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
    POLYNOMIAL,
    POLYNOMIAL_SIZE,
    SPAN,
    START,
)
from .steps import ACROSS_SLIP, run_task

if TYPE_CHECKING:
    from ..dynamics.system import System
    from .runge_kutta import RungeKutta

# Fractions of the span at which v_c is made parallel to the direction, and others at which that is checked.
_NODES = (0.2, 0.45, 0.7, 0.9, 1.0)
_CHECKS = (0.32, 0.58, 0.8, 0.96, 0.0)
_PERTURBATION = 1e-4
_ITERATIONS = 8
_HALVINGS = 30
# v_c across the prescribed direction, relative to the velocity tolerance, that is accepted between the nodes, and the
# fraction of it that is left at the nodes.
_ACCEPTED = 0.1
_CONVERGED = 0.05
# Residuals that have grown by this factor will not come down any more.
_DIVERGED = 3.0


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
            rk.system.contact_real[c, [START, SPAN]] = t, span
        if _collocate(rk, t, contacts, span, _ACCEPTED * tolerance) and uneventful():
            return span
        span *= 0.5
    return None


def _collocate(rk: RungeKutta, t: float, contacts: list[int], span: float, tolerance: float) -> bool:
    """Broyden's iteration on the polynomials' coefficients; whether v_c ends up along the direction everywhere."""
    coefficients = np.zeros(POLYNOMIAL_SIZE * len(contacts))
    residual = _across(rk, t, contacts, span, coefficients, _NODES)
    if residual is None:
        return False
    jacobian = _jacobian(rk, t, contacts, span, residual)
    if jacobian is None:
        return False
    largest = _DIVERGED * float(np.abs(residual).max())
    for _ in range(_ITERATIONS):
        try:
            step = -np.linalg.solve(jacobian, residual)
        except np.linalg.LinAlgError:
            return False
        coefficients += step
        if not np.abs(coefficients).max() < 1.0:
            return False
        found = _across(rk, t, contacts, span, coefficients, _NODES)
        if found is None or not np.abs(found).max() <= largest:
            return False
        if np.abs(found).max() <= _CONVERGED * tolerance:
            break
        jacobian += np.outer(found - residual - jacobian @ step, step) / (step @ step)
        residual = found
    else:
        return False
    between = _across(rk, t, contacts, span, coefficients, _CHECKS)
    # the last attempt has left the state at the end of the span in new_state
    return between is not None and float(np.abs(between).max()) <= tolerance and rk.error < 1.0


def _jacobian(rk: RungeKutta, t: float, contacts: list[int], span: float, residual: np.ndarray) -> np.ndarray | None:
    """An approximation to the derivative of `residual` by the coefficients; None where an evaluation fails.

    A turn by p s^j leaves -a p s^(j+1) / (j+1) of v_c across the direction, as friction pulls aside from then on, and
    itself turns the direction against v_c = b s^2. Each contact's a and b follow from one turn of j = 0.
    """
    n = POLYNOMIAL_SIZE
    s = np.array(_NODES)
    shapes = np.array([[s ** (j - 1) / (j + 1), s**j] for j in range(n)])
    out = np.zeros((len(residual), len(residual)))
    for i in range(len(contacts)):
        turn = np.zeros(len(residual))
        turn[n * i] = _PERTURBATION
        moved = _across(rk, t, contacts, span, turn, _NODES)
        if moved is None:
            return None
        for m in range(len(contacts)):
            change = (moved - residual)[n * m : n * (m + 1)] / _PERTURBATION
            pull = np.linalg.lstsq(shapes[0].T, change, rcond=None)[0]
            out[n * m : n * (m + 1), n * i : n * (i + 1)] = (pull @ shapes).T
    return out


def _across(
    rk: RungeKutta, t: float, contacts: list[int], span: float, coefficients: np.ndarray, shares: tuple[float, ...]
) -> np.ndarray | None:
    """v_c across the prescribed directions, divided by the share squared (v_c grows so), at shares of the span."""
    system = rk.system
    system.contact_real[contacts, POLYNOMIAL : POLYNOMIAL + POLYNOMIAL_SIZE] = coefficients.reshape(len(contacts), -1)
    system.across[0] = shares
    if run_task(system.table, ACROSS_SLIP, t, span) > EVENT:
        return None
    return system.across[np.array(contacts) + 1, : np.count_nonzero(shares)].ravel()


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
