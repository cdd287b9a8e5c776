"""Forces that hold contacts at rest which a cone problem's solution lets slip.

Redundant contacts may hold by some of the forces that do the same and slip by others, and the problem may have a
solution of either kind. Contacts slip only when there is no choice: what is looked for are forces inside all cones with
which everything stays at rest that was, the same analytic centre as in the event-driven methods.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..dynamics.redundant import Cone, central_force, null_space
from ..friction.cone import OPEN, SLIP

# Relative singular values below this are those of redundant contacts.
_RANK = 1e-11
# What may be left of the largest b where the equations contradict each other by no more than round-off.
_LEFT = 1e-9


@dataclass(frozen=True)
class Units:
    """A cone problem of n units (see `impulse_problem`) and what is known of its solution.

    gram (3n, 3n), base (3n,), friction (n,): the problem; directions (3n, nv): gram's factor; real (n, 3): which rows
    are; loads (n,): what units without a normal row have for their normal force;
    modes (n,): of the solution, what is to be held at rest included; forces, velocities (n, 3).
    """

    gram: np.ndarray
    base: np.ndarray
    friction: np.ndarray
    directions: np.ndarray
    real: np.ndarray
    loads: np.ndarray
    modes: np.ndarray
    forces: np.ndarray
    velocities: np.ndarray


def holding_forces(units: Units) -> np.ndarray | None:
    """(3n,) central forces of these modes; None where there are none, or no choice."""
    size = units.base.size
    known, columns, rows, cones = np.zeros(size), [], [], []

    def add(row: int, column: np.ndarray) -> int:
        rows.append(row)
        columns.append(column)
        return len(rows) - 1

    for u, mode in enumerate(units.modes):
        if mode == OPEN:
            continue
        k, mu, pressed = 3 * u, float(units.friction[u]), bool(units.real[u, 2])
        own = np.eye(size)[k : k + 3]
        if mode == SLIP:
            if pressed:
                drag = np.zeros(size)
                speed = float(np.hypot(*units.velocities[u, :2]))
                if mu > 0.0 and speed > 0.0:
                    drag[k : k + 2] = -mu / speed * units.velocities[u, :2]
                cones.append(Cone(add(k + 2, own[2] + drag), 1.0, 0.0))
            else:
                known[k : k + 2] = units.forces[u, :2]
            continue
        normal = add(k + 2, own[2]) if pressed else 0
        tangents = tuple(add(k + i, own[i]) for i in range(2) if units.real[u, i])
        if not (tangents and math.isfinite(mu)):
            tangents, mu = (), 1.0
        if pressed:
            cones.append(Cone(normal, mu, 0.0, tangents))
        elif tangents:
            cones.append(Cone(normal, 0.0, mu * float(units.loads[u]), tangents))
    if len(rows) <= 1:
        return None
    expand = np.array(columns).T
    null = null_space(expand.T @ units.directions)
    if null.shape[1] == 0:
        return None
    scale = np.repeat(1.0 / np.sqrt(units.gram.diagonal().reshape(-1, 3).mean(axis=1)), 3)[rows]
    wanted = -scale * (units.base + units.gram @ known)[rows]
    operator = scale[:, None] * (units.gram @ expand)[rows] * scale
    forces = np.linalg.lstsq(operator, wanted, rcond=_RANK)[0]
    if np.abs(operator @ forces - wanted).max() > _LEFT * np.abs(units.base).max() * scale.max():
        return None
    found = central_force(scale * forces, null, cones)
    return None if found is None else known + expand @ found.forces
