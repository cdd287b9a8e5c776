"""Redundant forces of contacts at rest, well inside their cones: the end of the homotopy of a convex problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..errors import ArgumentError
from .cone import RANK_TOLERANCE, STICK, cone_workspace
from .homotopy import follow_homotopy
from .problem import checked_problem
from .solve import PATH_STEPS, ContactSolution

# The value of t at which redundant forces count as centred.
CENTRE = 1e-9
# Velocities relative to the terms that cancel in them.
AT_REST = 1e-9
TINY = 1e-300


def centred_forces(
    delassus: npt.ArrayLike, b: npt.ArrayLike, mu: npt.ArrayLike, solution: ContactSolution
) -> ContactSolution:
    """The solution with other forces where sticking contacts are redundant: well inside their cones.

    All that changes are the forces of the contacts at rest (u = 0), by combinations that move nothing (G dF = 0), so
    that the velocities stay. The new forces are the most central ones: they maximise the sum of log(mu^2 F_n^2 -
    |F_t|^2) less a linear term, which bounds what contacts that press against each other could add to themselves. They
    are unique, change smoothly with the problem, and hold on under changes that would take forces of least norm out of
    the cones. Where no forces lie inside the cones (all are about to slip) the solution is returned as it is.

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
    # At rest counts, not the mode: a force of least norm on its cone's edge slips at zero speed, and a contact that
    # only just touches can take a load.
    terms = np.abs(b) + np.abs(matrix) @ np.abs(solution.forces.ravel())
    size = terms.reshape(-1, 3).max(axis=1)
    speed = np.abs(solution.velocities).max(axis=1)
    stuck = np.flatnonzero((speed <= AT_REST * np.maximum(size, AT_REST * size.max(initial=0.0))) & (friction > 0.0))
    if not stuck.size:
        return solution
    rows = (3 * stuck[:, None] + np.arange(3)).ravel()
    block = np.ascontiguousarray(matrix[np.ix_(rows, rows)])
    forces = solution.forces[stuck].ravel()
    limits = friction[stuck]
    space = cone_workspace(len(stuck))
    # The contacts keep still: u = 0 is b with the opposite of what the forces do. Without De Saxce's term, which is of
    # no account at rest, the problem is convex, and its path comes to the centre of all solutions.
    still = -(block @ forces)
    for tube in (0.01, 0.002, 0.0002):
        follow_homotopy(block, still, limits, space.address, 1.0, tube, 1.0, 0.0, 0)
        follow_homotopy(block, still, limits, space.address, 1e3 * CENTRE, tube, 1.0, 0.0, PATH_STEPS)
        # The last stretch in a narrow tube: the centre is only as exact as that.
        if follow_homotopy(block, still, limits, space.address, CENTRE, 1e-6, 1.0, 0.0, PATH_STEPS) <= CENTRE:
            break
    else:
        return solution
    centred = space.forces.copy()
    # To round-off: the least change that makes up for the rest of t.
    scale = np.repeat(np.sqrt(3.0 / np.maximum(np.diagonal(block).reshape(-1, 3).sum(axis=1), TINY)), 3)
    values, vectors = np.linalg.eigh(scale[:, None] * block * scale)
    kept = values > RANK_TOLERANCE * values[-1]
    for _ in range(2):
        missing = scale * (block @ (forces - centred))
        centred += scale * (vectors[:, kept] @ ((vectors[:, kept].T @ missing) / values[kept]))
    inside = np.hypot(centred[::3], centred[1::3]) < limits * centred[2::3]
    off = np.abs(block @ (centred - forces))
    if not (inside.all() and (off <= 1e-3 * AT_REST * terms[rows].max()).all()):
        return solution
    moved, modes = solution.forces.copy(), solution.modes.copy()
    moved[stuck], modes[stuck] = centred.reshape(-1, 3), STICK
    velocities = (matrix @ moved.ravel() + b).reshape(-1, 3)
    return replace(solution, forces=moved, velocities=velocities, modes=modes)
