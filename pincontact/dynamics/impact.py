"""A contact that closes: Newton restitution and Coulomb friction in impulses, by the same cone problem."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

from ..friction.solve import ContactSolver
from ..layout import MU, TANGENTS, UNILATERAL

if TYPE_CHECKING:
    from .system import System


def apply_impact(system: System, solver: ContactSolver, closed: list[int], restitution: dict[int, float]) -> bool:
    """Change the system's v by the impulses of the closed contacts; False if no impulses satisfy the law.

    Uses rows, v_c and the factor of M of the last evaluation. restitution: contact -> coefficient, applied to the
    approach speed of v_c; other contacts get 0. Tangential impulses obey Coulomb's law with the final slip velocity.
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
    mu = np.array([system.contact_real[c, MU] for c in closed])
    if not all(system.contact_int[c, UNILATERAL] for c in closed):
        # a bilateral contact takes impulses of both signs: no cone; its rows are plain equations
        solution = np.linalg.lstsq(gram, -approach, rcond=1e-12)[0]
    elif solver.solve(gram, approach, mu):
        solution = solver.forces
    else:
        return False
    system.v += solve_triangular(system.factor, stack @ solution.reshape(3 * n), lower=True, trans="T")
    return True
