"""The cone problem's matrices from whitened constraint rows, for modes and for impacts.

A unit is one cone: three columns L^-T row^T in the order (t1, t2, n), zero where the unit has no such row.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy

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
    """L v: half of its square is the kinetic energy of v. BLAS's own for triangles starts threads, too."""
    return np.tril(system.factor) @ v


def unit_columns(system: System, index: int, rows: Sequence[int], sign: float = 1.0) -> np.ndarray:
    """(nv, 3) the unit of contact `index` (or of joint coordinate `index` - nc), with these of its rows only."""
    columns = whiten(system, system.rows[index].T)
    for row in {0, 1, 2}.difference(rows):
        columns[:, row] = 0.0
    return columns if sign == 1.0 else sign * columns


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
