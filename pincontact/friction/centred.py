"""Redundant forces of contacts at rest: those well inside all cones, where there are any.

The accelerations do not depend on the choice among redundant forces, but whether the contacts can hold does: the
least-norm forces may leave their cones while others do not. Admissible forces are a convex set; its point taken here is
the analytic centre (Boyd, Vandenberghe, Convex Optimization, Sec. 8.5), held back from growing without bound by a
quadratic term: it is unique, depends smoothly on the loads, and is as far as can be from where something would slip.

Loads change, and the centre with them: the choice follows its tangent. As loads come near what the contacts can carry,
the admissible forces shrink to a point. The centres are then a central path, smooth to its end as a rule (Halicka,
European Journal of Operational Research 143, 2002, for semidefinite programs), so that of the way to the limit a choice
along the tangent leaves about the square of what the last left; a constant one leaves a fixed part of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..errors import ArgumentError
from .barrier import SCRATCH_ROWS, centre, null_rows
from .cone import LARGEST_FRICTION, STICK
from .problem import checked_problem
from .solve import ContactSolution

# Velocities relative to the terms that cancel in them.
_AT_REST = 1e-9


class Cone(NamedTuple):
    """factor x[normal] + offset >= |x[tangents]|, of forces x; or >= 0, where there are no tangents."""

    normal: int
    factor: float = 1.0
    offset: float = 0.0
    tangents: tuple[int, ...] = ()


class Choice(NamedTuple):
    """The central forces (n,) at some loads, and their tangent.

    slope (n, r): what is added to forces of least norm that change by `span` y, y (r,); it acts on nothing.
    span (n, r): orthonormal, the directions of forces of least norm.
    """

    forces: np.ndarray
    slope: np.ndarray
    span: np.ndarray


def null_space(directions: np.ndarray) -> np.ndarray:
    """(n, k) combinations of the n force directions (n, nv) that act on nothing, k may be 0."""
    n, nv = directions.shape
    basis = np.empty((n, n))
    return basis[null_rows(np.ascontiguousarray(directions), np.empty((nv, n)), basis) :].T


def central_force(forces: np.ndarray, null: np.ndarray, cones: list[Cone]) -> Choice | None:
    """The central one of the forces `forces` + `null` z inside all cones; None where there is none (but on the rim).

    forces: (n,); null: (n, k) from `null_space`.
    """
    # a missing tangent is zero
    parts, offsets = np.zeros((3 * len(cones), len(forces))), np.zeros(3 * len(cones))
    for i, (normal, factor, offset, tangents) in enumerate(cones):
        parts[3 * i, normal], offsets[3 * i] = factor, offset
        for row, tangent in enumerate(tangents, 3 * i + 1):
            parts[row, tangent] = 1.0
    return central_choice(forces, null, parts, offsets)


def central_choice(forces: np.ndarray, null: np.ndarray, parts: np.ndarray, offsets: np.ndarray) -> Choice | None:
    """`central_force` of m cones s >= |t|, of which (s, t1, t2) are three rows of parts (3 m, n) times the forces +
    offsets (3 m,)."""
    n, k = null.shape
    if k == 0 or not offsets.size:
        return None
    found, basis, slope = np.array(forces), np.empty((n, n)), np.empty((n, n))
    rows, hessian = np.empty((offsets.size, n + 1)), np.empty((n + 1, n + 1))
    scratch = np.empty((SCRATCH_ROWS, max(n + 1, offsets.size)))
    k = centre(found, null.T.copy(), parts, offsets, basis, rows, hessian, scratch, slope)
    return Choice(found, (slope[: n - k, :k] @ basis[:k]).T, basis[k:].T) if k else None


def rows_at_rest(delassus: np.ndarray, b: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Along which rows n contacts are at rest with these forces (3n,), (n, 3).

    That counts, not the mode of a solution: a force of least norm on its cone's edge slips at zero speed, and a contact
    that only just touches can take a load.
    """
    size = (np.abs(b) + np.abs(delassus) @ np.abs(forces)).reshape(-1, 3).max(axis=1)
    speed = np.abs(delassus @ forces + b).reshape(-1, 3)
    return speed <= _AT_REST * np.maximum(size, _AT_REST * size.max(initial=0.0))[:, None]


def centred_forces(
    delassus: npt.ArrayLike, b: npt.ArrayLike, mu: npt.ArrayLike, solution: ContactSolution
) -> ContactSolution:
    """The solution with other forces where sticking contacts are redundant: well inside their cones.

    All that changes are the forces of the contacts at rest (u = 0), by combinations that move nothing (G dF = 0), so
    that the velocities stay. The new forces are the most central ones: they maximise the sum of log(mu^2 F_n^2 -
    |F_t|^2) less half the square of their distance from the forces of least norm, in units of these, which bounds what
    contacts that press against each other could add to themselves. They are unique, change smoothly with the problem,
    and hold on under changes that would take forces of least norm out of the cones. Where no forces lie inside the
    cones (all are about to slip) the solution is returned as it is.

    Parameters
    ----------
    delassus, b, mu
        As for `solve_contacts`.
    solution : ContactSolution
        A solution of it.

    Returns
    -------
    ContactSolution

    Raises
    ------
    ArgumentError
        For a problem that `solve_contacts` would refuse, or a solution of another size.

    Examples
    --------
    Two feet of one body, which together carry 10 N, share the load:

    >>> import numpy as np
    >>> import pincontact as pc
    >>> rows = np.vstack([np.eye(3), np.eye(3)])
    >>> delassus, b = rows @ rows.T, np.tile([0.0, 0.0, -10.0], 2)
    >>> solution = pc.solve_contacts(delassus, b, 0.5)
    >>> pc.centred_forces(delassus, b, 0.5, solution).forces[:, 2].round(6).tolist()
    [5.0, 5.0]
    """
    matrix, b, friction = checked_problem(delassus, b, mu)
    contacts = len(friction)
    if not isinstance(solution, ContactSolution):
        raise ArgumentError(f"the solution must be one of solve_contacts, got {type(solution).__name__}")
    if solution.modes.shape[0] != contacts:
        raise ArgumentError(f"the solution has {solution.modes.shape[0]} contacts, the problem has {contacts}")
    stuck = np.flatnonzero(rows_at_rest(matrix, b, solution.forces.ravel()).all(axis=1) & (friction > 0.0))
    rows = (3 * stuck[:, None] + np.arange(3)).ravel()
    values, vectors = np.linalg.eigh(matrix[np.ix_(rows, rows)])
    limits = np.minimum(friction[stuck], LARGEST_FRICTION).tolist()
    cones = [Cone(3 * i + 2, mu, tangents=(3 * i, 3 * i + 1)) for i, mu in enumerate(limits)]
    null = null_space(vectors * np.sqrt(np.maximum(values, 0.0)))
    found = central_force(solution.forces[stuck].ravel(), null, cones)
    if found is None:
        return solution
    moved, modes = solution.forces.copy(), solution.modes.copy()
    moved[stuck], modes[stuck] = found.forces.reshape(-1, 3), STICK
    velocities = (matrix @ moved.ravel() + b).reshape(-1, 3)
    return replace(solution, forces=moved, velocities=velocities, modes=modes)
