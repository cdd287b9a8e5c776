"""Equations of a step's cone problem, u = 0: normals of bilateral contacts, and ideal rolling of these.

They are eliminated before the problem is solved: their whitened rows are made orthonormal, R = L^-T rows^T = basis
times `equation_factor`^T, units lose their parts in that basis (`overlap`), and impulses follow from the cones' forces.
"""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..dynamics.least_forces import unit_of_force
from ..geometry.patterns import ON_CURVE
from ..jit import NOTHING, STEPPING, kernel
from ..layout import MU, PATTERN, SYSTEM, TANGENTS, UNILATERAL
from ..linalg import RANK_TOLERANCE, factor_definite, inner, solve_definite, whiten
from .impulse_layout import STEP
from .impulse_velocities import beyond_rigid, free_gain, start_velocity

# An equation of which less than this part is left after orthogonalisation is redundant.
REDUNDANT = math.sqrt(RANK_TOLERANCE)


@kernel
def _add_equation(system, step, c, row):
    """One more equation u = 0, orthogonalised (twice, for round-off) against those before."""
    nv, e = system.sizes.nv, step.counts.equations
    basis, factor, share, beyond = step.equations, step.equation_factor, step.equation_share, step.equation_beyond
    own = basis[e]
    step.equation_index[e, 0], step.equation_index[e, 1] = c, row
    whiten(system.factor, system.parents, nv, system.rows[c, row], own)
    whole = math.sqrt(inner(own, own, nv))
    for j in range(e):
        factor[e, j] = 0.0
    for _ in range(2):
        for j in range(e):
            part = inner(own, basis[j], nv)
            factor[e, j] += part
            for k in range(nv):
                own[k] -= part * basis[j, k]
    rest = math.sqrt(inner(own, own, nv))
    independent = rest > REDUNDANT * whole
    factor[e, e] = rest if independent else 0.0
    for k in range(nv):
        own[k] = own[k] / rest if independent else 0.0
    start, gain = start_velocity(system, step, c, row), free_gain(system, step, c, row)
    value, left_out = -start - gain, -beyond_rigid(system, step, c, row, start, gain)
    for j in range(e):
        value -= factor[e, j] * share[j]
        left_out -= factor[e, j] * beyond[j]
    share[e] = value / rest if independent else 0.0
    beyond[e] = left_out / rest if independent else 0.0
    step.counts.equations = e + 1


@separate_kernel(NOTHING, SYSTEM.type, STEP.type, when=STEPPING)
def gather_equations(system, step):
    """Bilateral normals and ideal rolling of bilateral contacts."""
    contact_int, contact_real = system.contact_int, system.contact_real
    for c in range(system.sizes.nc):
        if contact_int[c, UNILATERAL] == 0:
            rolls, two = contact_real[c, MU] == math.inf, contact_int[c, TANGENTS] == 2
            second_normal = contact_int[c, PATTERN] == ON_CURVE
            for row in range(2, -1, -1):
                if row == 2 or (row == 1 and second_normal) or (rolls and (row == 0 or two)):
                    _add_equation(system, step, c, row)
    if not _are_redundant(step):
        return
    nv, index, unit = system.sizes.nv, step.equation_index, step.equation_unit
    rows, factor, parents, work = system.rows, system.factor, system.parents, system.work
    for e in range(step.counts.equations):
        c, row = index[e, 0], index[e, 1]
        whiten(factor, parents, nv, rows[c, row], work)
        own, unit[e] = inner(work, work, nv), 1.0
        if own > 0.0:
            unit[e] = unit_of_force(system, c, row, own)


@kernel
def _are_redundant(step):
    """Whether any equation says what those before it do."""
    factor, redundant = step.equation_factor, False
    for e in range(step.counts.equations):
        redundant = redundant or factor[e, e] == 0.0
    return redundant


@kernel
def equation_impulses(system, step):
    """Impulses of the equations that go with the cones' forces, R^T P = share - overlap^T F; of redundant ones the
    least, with contacts' forces in the units of `dynamics.least_forces.unit_of_force`."""
    n, m = step.counts.units, step.counts.equations
    forces, overlap, factor = step.cone_forces, step.overlap, step.equation_factor
    share, impulse = step.equation_share, step.equation_impulse
    for e in range(m):
        impulse[e] = share[e]
        for r in range(3 * n):
            impulse[e] -= overlap[r, e] * forces[r]
    if _are_redundant(step):
        _least_impulses(factor, step.equation_unit, m, system.delassus, impulse)
        return
    for e in range(m - 1, -1, -1):
        value = impulse[e]
        for j in range(e + 1, m):
            value -= factor[j, e] * impulse[j]
        impulse[e] = value / factor[e, e]


@kernel
def _least_impulses(factor, unit, n, gram, impulse):
    """P with R^T P = impulse (n,), in and out, and the least sum of P^2 times its units; gram (n, n): scratch."""
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for e in range(i, n):
                value += factor[e, i] * factor[e, j] / unit[e]
            gram[i, j] = value
        if factor[i, i] == 0.0:
            # says nothing
            gram[i, i], impulse[i] = 1.0, 0.0
    factor_definite(gram, n)
    solve_definite(gram, n, impulse)
    for e in range(n - 1, -1, -1):
        value = 0.0
        for j in range(e + 1):
            value += factor[e, j] * impulse[j]
        impulse[e] = value / unit[e]


@kernel
def normal_load(step, c, lowest):
    """Length of the normal impulse that the equations give contact c; its normals are the rows from the lowest on."""
    index, impulse, total = step.equation_index, step.equation_impulse, 0.0
    for e in range(step.counts.equations):
        if index[e, 0] == c and index[e, 1] >= lowest:
            total += impulse[e] * impulse[e]
    return math.sqrt(total)
