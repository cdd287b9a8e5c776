"""The cone problem at acceleration level from the last evaluation: units of contacts, held coordinates, resistances.

F in K_mu, u = G F + b, u + mu |u_t| n in the dual cone, complementary (`friction.cone`). Loads that friction of what
slides goes with are the subject of `mode_loads`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from ..layout import (
    ANISOTROPIC,
    JOINT_END,
    MODE,
    MU,
    STICK,
    TANGENTS,
)
from .friction_scaling import stretch
from .units import contact_rows, delassus, unit_columns, unwhiten, whiten, whitened_velocity

if TYPE_CHECKING:
    from .system import System


@dataclass
class ModeProblem:
    """A cone problem G F + b over contacts, held coordinates and resistances, in this order.

    gram (3n, 3n), base (3n,), limits (n,); weights (3n,): diagonal of rows that are missing, else 0; shapes: contact
    unit -> scaling A of the friction ellipse (`friction_scaling`), in whose coordinates its cone is round; turns:
    resistance -> its unit.
    """

    gram: np.ndarray
    base: np.ndarray
    weights: np.ndarray
    limits: np.ndarray
    shapes: dict[int, np.ndarray] = field(default_factory=dict)
    turns: dict[int, int] = field(default_factory=dict)


def all_stick(system: System, closed: list[int], undecided: list[int], held: list[int], resisting: list[int]) -> bool:
    """Whether the last evaluation's constraint rows are those of the cone problem: round cones and nothing else."""
    integers, numbers = system.contact_int, system.contact_real
    return (
        not (held or resisting)
        and system.counters["row_count"] == 3 * len(closed)
        and all(
            integers[c, MODE] == STICK
            and not integers[c, ANISOTROPIC]
            and (c in undecided or math.isinf(numbers[c, MU]))
            for c in closed
        )
    )


def problem_of_sticking(system: System, limits: np.ndarray, closed: list[int]) -> ModeProblem:
    """The cone problem where `all_stick`; limits (items,): coefficients of friction."""
    count = 3 * len(closed)
    # an evaluation lists the normal first
    whitened = system.whitened_rows[_normals_last(len(closed))]
    base = system.rows[closed].reshape(count, system.nv) @ system.free_acceleration
    base += system.bias[closed].reshape(count)
    gram, weights = delassus(whitened.T)
    if weights.any():
        base[weights > 0.0] = 0.0
    return ModeProblem(gram, base, weights, limits[closed])


def mode_problem(
    system: System, limits: np.ndarray, closed: list[int], undecided: list[int], held: list[int], resisting: list[int]
) -> ModeProblem:
    """The cone problem without the friction of what slides: units of contacts, held coordinates, resistances.

    limits (items,): coefficients of friction of what may stick.
    """
    integers, numbers = system.contact_int, system.contact_real
    n = len(closed)
    units = [unit_columns(system, c, contact_rows(integers[c, TANGENTS])) for c in closed]
    mu = [float(limits[c]) if c in undecided or math.isinf(numbers[c, MU]) else 0.0 for c in closed]
    # elliptic cones are round in other coordinates
    shapes = {i: stretch(system, c) for i, c in enumerate(closed) if integers[c, ANISOTROPIC]}
    for i, shape in shapes.items():
        units[i][:, :2] = units[i][:, :2] @ shape
    free = system.free_acceleration.copy()
    for g in held:
        end, (low, high) = system.joint_int[g, JOINT_END], system.joint_real[g, :2]
        # about its middle, friction is a disk of constant radius; at an end, what the end adds to friction only
        # pushes away from it
        middle = (low, 0.5 * (low + high), high)[end + 1]
        column = whiten(system, system.rows[system.nc + g, 2])
        free += unwhiten(system, column) * middle
        columns = np.zeros((system.nv, 3))
        columns[:, 0 if end == 0 else 2] = -column if end > 0 else column
        units.append(columns)
        mu.append(1.0 if end == 0 else 0.0)
    turns = {i: len(units) + k for k, i in enumerate(resisting)}
    for i in resisting:
        units.append(unit_columns(system, i, range(integers[i, TANGENTS])))
        mu.append(1.0)
    stack = np.hstack(units) if len(units) > 1 else units[0]
    gram, weights = delassus(stack)
    base = stack.T @ whitened_velocity(system, free)
    bias = system.bias[closed]
    for i, shape in shapes.items():
        bias[i, :2] = shape @ bias[i, :2]
    base[: 3 * n] += bias.reshape(-1)
    for i, u in turns.items():
        base[3 * u : 3 * u + 2] += system.bias[i, :2]
    if weights.any():
        base[weights > 0.0] = 0.0
    for i, g in enumerate(held, start=n):
        if system.joint_int[g, JOINT_END] == 0:
            low, high = system.joint_real[g, :2]
            base[3 * i + 2] = -0.5 * (high - low) * weights[3 * i + 2]
    return ModeProblem(gram, base, weights, np.array(mu), shapes, turns)


@cache
def _normals_last(n: int) -> np.ndarray:
    """(3n,) places of the rows (t1, t2, n) of n contacts whose rows are listed as (n, t1, t2)."""
    return (3 * np.arange(n)[:, None] + np.array([1, 2, 0])).reshape(-1)
