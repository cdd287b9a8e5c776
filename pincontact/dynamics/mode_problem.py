"""The cone problem at acceleration level from the last evaluation: units of contacts, held coordinates, resistances.

F in K_mu, u = G F + b, u + mu |u_t| n in the dual cone, complementary (`friction.cone`). Loads that friction of what
slides goes with are the subject of `mode_loads`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..layout import JOINT_END, MU, TANGENTS
from .units import Units, contact_rows, delassus, whiten

if TYPE_CHECKING:
    from .system import System


@dataclass
class ModeProblem:
    """A cone problem G F + b over contacts, held coordinates and resistances, in this order.

    gram (3n, 3n), base (3n,), limits (n,); weights (3n,): diagonal of rows that are missing, else 0; normal, tangents
    (n,): how many rows there are of either; shapes: unit -> scaling of its friction ellipse; turns: resistance -> its
    unit.
    """

    gram: np.ndarray
    base: np.ndarray
    weights: np.ndarray
    limits: np.ndarray
    normal: np.ndarray
    tangents: np.ndarray
    shapes: dict[int, np.ndarray]
    turns: dict[int, int]


def mode_problem(
    system: System, limits: np.ndarray, closed: list[int], undecided: list[int], held: list[int], resisting: list[int]
) -> ModeProblem:
    """The cone problem without the friction of what slides.

    limits (items,): coefficients of friction of what may stick.
    """
    integers, numbers = system.contact_int, system.contact_real
    units = Units(system, lambda i, rows: system.rows[i, rows] @ system.free_acceleration + system.bias[i, rows])
    for c in closed:
        mu = float(limits[c]) if c in undecided or math.isinf(numbers[c, MU]) else 0.0
        units.add(c, contact_rows(integers[c, TANGENTS]), mu)
    push, radii = np.zeros(system.nv), {}
    for g in held:
        item, end, (low, high) = system.nc + g, int(system.joint_int[g, JOINT_END]), system.joint_real[g, :2]
        # about its middle, friction is a disc of constant radius; at an end, what the end adds to friction only
        # pushes away from it
        push += (low, 0.5 * (low + high), high)[end + 1] * whiten(system, system.rows[item, 2])
        if end == 0:
            radii[units.add(item, (2,), 1.0, places=(0,))] = 0.5 * (high - low)
        else:
            units.add(item, (2,), 0.0, -end)
    turns = {i: units.add(i, range(integers[i, TANGENTS]), 1.0) for i in resisting}
    stack = units.stack
    gram, weights = delassus(stack)
    base = np.concatenate(units.start) + stack.T @ push
    base[weights > 0.0] = 0.0
    for u, radius in radii.items():
        base[3 * u + 2] = -radius * weights[3 * u + 2]
    rows = np.array(units.normal), np.array(units.tangents)
    return ModeProblem(gram, base, weights, np.array(units.mu), *rows, units.shapes, turns)
