"""Cone problems of an evaluated state, for modes and for impacts, from its units one after the other.

A unit is one cone: three columns L^-T row^T in the order (t1, t2, n), zero where the unit has no such row.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import scipy

from ..layout import ANISOTROPIC
from .friction_scaling import stretch

if TYPE_CHECKING:
    from .system import System


def whiten(system: System, row: np.ndarray) -> np.ndarray:
    """L^-T row^T, for a row (nv,) or columns (nv, n), with the factor L of M = L^T L from the last evaluation."""
    return _solved(system.factor.T, row, False)


def unwhiten(system: System, column: np.ndarray) -> np.ndarray:
    """L^-1 column: a change of v (or acceleration) from its whitened form."""
    return _solved(system.factor.T, column, True)


def _solved(upper: np.ndarray, right: np.ndarray, transposed: bool) -> np.ndarray:
    """Solution of the triangular system; NaN where the factor is singular. The bare routines: checks cost more.

    LAPACK's own for several columns starts threads however small they are, and waits for them.
    """
    if not all(upper.diagonal().tolist()):
        return np.full_like(right, np.nan)
    if right.ndim == 1:
        return scipy.linalg.lapack.dtrtrs(upper, right, trans=int(transposed))[0]
    return scipy.linalg.blas.dtrsm(1.0, upper, right, trans_a=int(transposed))


def whitened_velocity(system: System, v: np.ndarray) -> np.ndarray:
    """L v, for v (nv,) or columns (nv, n), half of whose square is the kinetic energy of v. BLAS's own for triangles
    starts threads, too."""
    return np.where(_lower(system.nv), system.factor, 0.0) @ v


@cache
def _lower(n: int) -> np.ndarray:
    """(n, n) where a lower triangle is."""
    return np.tri(n, dtype=bool)


class Units:
    """Units of contacts, joint coordinates and resistances to turning.

    relative(item, rows): what moves along these rows of an item without forces, velocities or accelerations. Of each
    unit: columns (nv, 3); start (3,), what moves along it; mu; normal and tangents, how many rows it has of either;
    shapes: unit -> scaling of its friction ellipse (`friction_scaling`), in whose coordinates its cone is round.
    """

    def __init__(self, system: System, relative: Callable[[int, list[int]], np.ndarray]) -> None:
        self.system, self.relative = system, relative
        self.columns: list[np.ndarray] = []
        self.start: list[np.ndarray] = []
        self.mu: list[float] = []
        self.normal: list[float] = []
        self.tangents: list[float] = []
        self.shapes: dict[int, np.ndarray] = {}

    def add(self, item: int, rows: Sequence[int], mu: float, sign: float = 1.0, places: Sequence[int] = ()) -> int:
        """Add a unit of these rows of an item, turned round by a sign of -1; returns which one it is. places: which
        rows of the unit they are, if others."""
        system, unit, rows, places = self.system, len(self.mu), list(rows), list(places or rows)
        columns, start = np.zeros((system.nv, 3)), np.zeros(3)
        columns[:, places] = sign * whiten(system, system.rows[item, rows].T)
        start[places] = sign * self.relative(item, rows)
        if item < system.nc and system.contact_int[item, ANISOTROPIC]:
            self.shapes[unit] = shape = stretch(system, item)
            columns[:, :2], start[:2] = columns[:, :2] @ shape, shape @ start[:2]
        self.columns.append(columns)
        self.start.append(start)
        self.mu.append(mu)
        self.normal.append(float(places.count(2)))
        self.tangents.append(float(len(places) - places.count(2)))
        return unit

    @property
    def stack(self) -> np.ndarray:
        """(nv, 3n) the columns of all units."""
        return np.hstack(self.columns) if self.columns else np.zeros((self.system.nv, 0))


def contact_rows(tangents: int) -> tuple[int, ...]:
    """Rows of a contact with this many tangents."""
    return (0, 2) if tangents == 1 else (0, 1, 2)


def delassus(stack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3n, 3n) Delassus matrix of n units, and (3n,) the diagonal's weights of rows that are missing, else 0.

    A missing row becomes an isolated one as heavy as the unit's real ones, since the solver scales by their mean.
    """
    gram = stack.T @ stack
    diagonal = gram.diagonal().copy()
    if all(diagonal.tolist()):
        return gram, np.zeros(diagonal.size)
    largest = np.repeat(diagonal.reshape(-1, 3).max(axis=1, initial=0.0), 3)
    weights = np.where(diagonal == 0.0, np.where(largest > 0.0, largest, 1.0), 0.0)
    gram.flat[:: len(gram) + 1] += weights
    return gram, weights
