"""Ranks of constraint rows, decided against sizes that mean something.

Rows of forces and of torques, and coordinates in m and in rad, have no common unit. And where everything cancels
nothing but round-off is left, next to which no entry is small. So directions are taken in the metric of the mass
matrix, and each one is held against the size that it had before anything was subtracted.
"""

from __future__ import annotations

import numpy as np

from ..dynamics.units import REDUNDANT


class Directions:
    """Directions (n, m), one a column, and the size (m,) that each would have if nothing in it cancelled; of the n
    coordinates those alone matter that `moves` (n,) is not 0 for.

    complement: (n, k) orthonormal, what moves and is orthogonal to all of them. redundant: whether any combination of
    them makes nothing.
    """

    def __init__(self, columns: np.ndarray, sizes: np.ndarray, moves: np.ndarray) -> None:
        self._sizes = np.where(sizes > 0.0, sizes, 1.0)
        moving = np.flatnonzero(moves)
        left = np.zeros((len(columns), moving.size))
        left[moving], values, right = np.linalg.svd((columns / self._sizes)[moving])
        rank = int((values > REDUNDANT).sum())
        self._left, self._values, self._right = left[:, :rank], values[:rank], right[:rank].T
        self.complement, self.redundant = left[:, rank:], rank < columns.shape[1]

    def reach(self, wanted: np.ndarray) -> np.ndarray:
        """y (n,) or (n, k) of least norm with columns^T y = wanted (m,) or (m, k), or as near to it as can be."""
        scaled = (wanted.T / self._sizes).T
        return np.asarray(self._left @ ((self._right.T @ scaled).T / self._values).T)
