"""One contact problem from what is known of it: the last modes and forces, projected Gauss-Seidel (see `solve`)."""

from __future__ import annotations

from ..arrays import REALS, array_entry, array_type
from ..callback import separate_kernel
from ..jit import INTEGER, REAL, kernel
from ..linalg import factor_matrix
from .cone import (
    BY_EXACT,
    BY_GAUSS_SEIDEL,
    BY_WARM,
    CHOICES,
    CONE,
    DECIDED,
    FOLLOWS,
    HUGE,
    KNOWN,
    PASSES,
    RANK_TOLERANCE,
    SEARCHED,
    SLIP,
    STICK,
    TIMES,
    classify,
    cone_at,
    gauss_seidel_pass,
    respond,
    scale_problem,
)
from .newton import active_set_solve
from .redundant import FACTOR

# How a problem is begun, see `solve_cones`: numbers to be added, from the last modes with none.
WARM, NEAREST, CLASSIFY, GAUSS_SEIDEL, USUAL, AFRESH = 0, 1, 2, 4, 8, 16
# Nothing is tried.
NOTHING = -1

# Newton passes for one contact, all of whose states are tried, and for several: most starts need fewer than five, mode
# corrections included, and what needs more is found sooner elsewhere.
NEWTON_PASSES_OF_ONE, NEWTON_PASSES = 20, 8
# Gauss-Seidel passes, more for more contacts.
GAUSS_SEIDEL_PASSES, PASSES_PER_CONTACT = 10, 2
# What the searches aim at, relative to the tolerance; the last ones are content with that.
STRICTNESS = 0.01
# Velocities of the last solution that count as none, relative to b.
AT_REST = 1e-9


_MATRIX, _VECTOR = array_type(REALS, 2), array_type(REALS, 1)


@separate_kernel(REAL, CONE.type, _MATRIX, _VECTOR, _VECTOR, INTEGER, REAL)
def try_start(cone, delassus, b, mu, task, tolerance):
    """A start of one kind, see `solve_cones`; returns the residual."""
    n = mu.shape[0]
    modes = cone.modes
    forces = cone.forces
    velocities = cone.velocities
    counts = cone.counts
    g, c, f, u = cone.scaled, cone.c, cone.f, cone.u
    scale, trial, touching = cone.scale, cone.trial_modes, cone.touching
    near, by_forces, relaxes = task & NEAREST != 0 and n > 1, task & CLASSIFY != 0, task & GAUSS_SEIDEL != 0
    unit = scale_problem(delassus, b, n, g, c, scale, u)
    for i in range(n):
        trial[i] = modes[i]
        for k in range(3 * i, 3 * i + 3):
            f[k] = forces[k] / (scale[i] * unit)
        still = AT_REST * unit / scale[i]
        touching[i] = 0
        if near and not by_forces and abs(velocities[3 * i + 2]) <= still:
            touching[i] = 2 if abs(velocities[3 * i]) + abs(velocities[3 * i + 1]) <= still else 1
    rank = factor_matrix(g, cone.low_rank[FACTOR], cone.rhs, RANK_TOLERANCE) if n > 1 else 0
    if by_forces:
        respond(g, c, f, u, cone.size, cone.rhs)
        for _ in range(GAUSS_SEIDEL_PASSES + PASSES_PER_CONTACT * n if relaxes else 0):
            gauss_seidel_pass(g, mu, f, u)
        classify(mu, f, u, trial)
    passes = NEWTON_PASSES if n > 1 or by_forces else NEWTON_PASSES_OF_ONE
    residual, used, tried, directions, follows = active_set_solve(
        cone, g, c, mu, trial, f, u, passes, tolerance, near, touching, rank
    )
    counts[PASSES] = used
    if residual <= tolerance:
        counts[CHOICES], counts[FOLLOWS] = directions, 1 if follows else 0
        for i in range(n):
            modes[i] = trial[i]
            for k in range(3 * i, 3 * i + 3):
                forces[k] = f[k] * (scale[i] * unit)
                velocities[k] = u[k] * unit / scale[i]
    counts[SEARCHED] = 1 if tried > 1 else 0
    return residual


@kernel
def try_usual_starts(delassus, b, mu, cone, task, tolerance):
    """From the last solution, if there is one, or afresh, then by Gauss-Seidel; see USUAL of `solve_cones`."""
    n = mu.shape[0]
    modes = cone.modes
    forces = cone.forces
    counts = cone.counts
    reached = cone.reached
    residual = HUGE
    near, gauss_seidel = task & NEAREST, task & GAUSS_SEIDEL
    if task & AFRESH != 0:
        velocities = cone.velocities
        for i in range(n):
            modes[i] = STICK if mu[i] > 0.0 else SLIP
            for k in range(3 * i, 3 * i + 3):
                forces[k] = velocities[k] = 0.0
        counts[KNOWN] = 1
    known = counts[KNOWN] != 0
    if not known and (n == 1 or gauss_seidel != 0):
        for k in range(3 * n):
            forces[k] = 0.0
    if known or n == 1:
        if not known:
            modes[0] = STICK
        residual = try_start(cone, delassus, b, mu, near, tolerance)
        if residual <= tolerance:
            counts[DECIDED] = BY_WARM if known and counts[SEARCHED] == 0 else BY_EXACT
    if not residual <= tolerance and gauss_seidel != 0:
        tolerance *= STRICTNESS
        residual = try_start(cone, delassus, b, mu, near + CLASSIFY + GAUSS_SEIDEL, tolerance)
        counts[DECIDED] = BY_GAUSS_SEIDEL
    reached[0] = residual
    if not residual <= tolerance:
        return HUGE
    counts[KNOWN] = 1
    counts[TIMES + counts[DECIDED]] += 1
    return residual


@array_entry(REAL[:, ::1], REAL[::1], REAL[::1], INTEGER, INTEGER, REAL)
def solve_cones(delassus, b, mu, address, task, tolerance):
    """Forces and velocities of n contacts from what is known of them; returns the residual.

    delassus (3n, 3n) symmetric, b (3n,), mu (n,): the problem; address: that of a `cone_workspace` for n contacts.
    task says how it is begun, by numbers that are added:
      WARM          from the modes and forces in the cone
      NEAREST       redundant forces may be the nearest to these: the velocities are needed, too
      CLASSIFY      from the forces alone: the modes are read off the natural map's projections
      GAUSS_SEIDEL  with CLASSIFY: after passes of projected Gauss-Seidel over the forces
      USUAL         from the last solution, if KNOWN of the cone's "counts" is not zero, or if there is one contact,
                    which needs none; with GAUSS_SEIDEL added, where that fails, by that; with AFRESH added from all at
                    rest, so that the solution is the same whatever the last one was. What decided, and how often, is
                    counted in "counts"; where nothing did, HUGE is returned, and the residual is in "reached".
      NOTHING       alone: not at all
    On success (residual <= tolerance) modes, forces and velocities are written, otherwise (but for AFRESH) none is.
    """
    if task == NOTHING:
        return HUGE
    cone = cone_at(address)
    if task & USUAL != 0:
        return try_usual_starts(delassus, b, mu, cone, task, tolerance)
    return try_start(cone, delassus, b, mu, task, tolerance)
