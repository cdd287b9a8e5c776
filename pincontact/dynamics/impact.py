"""A contact that closes: Newton restitution and Coulomb friction in impulses, by the same cone problem."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

from ..friction.solve import ContactSolver
from ..friction.stribeck import stribeck
from ..layout import MU, MU_FAST, STRIBECK_EXPONENT, STRIBECK_SPEED, TANGENTS, UNILATERAL
from .stretches import stretches

if TYPE_CHECKING:
    from .system import System


def apply_impact(system: System, solver: ContactSolver, closed: list[int], restitution: dict[int, float]) -> bool:
    """Change the system's v by the impulses of the closed contacts; False if no impulses satisfy the law.

    Uses rows, v_c and the factor of M of the last evaluation. restitution: contact -> coefficient, applied to the
    approach speed of v_c; other contacts get 0. Tangential impulses obey Coulomb's law with the final slip velocity,
    and the coefficient of the speed before.
    """
    n = len(closed)
    whitened = [solve_triangular(system.factor, system.rows[c].T, lower=True) for c in closed]
    stack = np.hstack(whitened)
    missing = [3 * i + 1 for i, c in enumerate(closed) if system.contact_int[c, TANGENTS] == 1]
    stack[:, missing] = 0.0
    gram = stack.T @ stack
    gram[missing, missing] = 1.0
    approach = np.concatenate([system.basis[c] @ system.slip[c] for c in closed])
    approach[missing] = 0.0
    for i, c in enumerate(closed):
        approach[3 * i + 2] += restitution.get(c, 0.0) * min(approach[3 * i + 2], 0.0)
    mu = np.array([_coefficient(system, c) for c in closed])
    scaling = stretches(system, closed)
    if not all(system.contact_int[c, UNILATERAL] for c in closed):
        # a bilateral contact takes impulses of both signs: no cone; its rows are plain equations
        solution = np.linalg.lstsq(gram, -approach, rcond=1e-12)[0]
    elif scaling is not None:
        if not solver.solve(scaling @ gram @ scaling, scaling @ approach, mu):
            return False
        solution = scaling @ solver.forces
    elif solver.solve(gram, approach, mu):
        solution = solver.forces
    else:
        return False
    system.v += solve_triangular(system.factor, stack @ solution.reshape(3 * n), lower=True, trans="T")
    return True


def _coefficient(system: System, c: int) -> float:
    """Coefficient of friction of contact c at its present speed of slip."""
    numbers = system.contact_real[c]
    if numbers[STRIBECK_SPEED] == 0.0:
        return float(numbers[MU])
    speed = float(np.linalg.norm(system.basis[c, : system.contact_int[c, TANGENTS]] @ system.slip[c]))
    return stribeck(numbers[MU], numbers[MU_FAST], numbers[STRIBECK_SPEED], numbers[STRIBECK_EXPONENT], speed)
