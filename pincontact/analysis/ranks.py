"""Ranks of constraint rows and actuators, decided against sizes that mean something.

Rows of forces and of torques, and coordinates in m and in rad, have no common unit. And where everything cancels, as in
what contacts leave to the actuators when they carry all loads, nothing but round-off is left, next to which no entry is
small. So directions are taken in the metric of the mass matrix, and each one is held against the size that it had
before anything was subtracted.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..constraints.kinematics import ROW_ROUND_OFF
from ..dynamics.units import REDUNDANT


class Directions:
    """Directions (n, m), one a column, and the size (m,) that each would have if nothing in it cancelled.

    precision: to which part of their sizes they are known.
    """

    def __init__(self, columns: np.ndarray, sizes: np.ndarray, precision: float = ROW_ROUND_OFF) -> None:
        self._sizes = np.where(sizes > 0.0, sizes, 1.0)
        left, values, right = np.linalg.svd(columns / self._sizes)
        rank = int((values > max(REDUNDANT, precision)).sum())
        self._left, self._values, self._right = left[:, :rank], values[:rank], right[:rank].T
        # (n, n - rank) orthonormal: what is orthogonal to all of them
        self.complement = left[:, rank:]
        self._dependent = right[rank:].T
        # and to what it is known
        self.complement_precision = precision / float(self._values.min(initial=1.0))

    @property
    def redundant(self) -> bool:
        """Whether any combination of them makes nothing."""
        return bool(self._dependent.shape[1])

    @cached_property
    def _redundant(self) -> np.ndarray:
        """(m, m - rank) orthonormal: combinations that make nothing."""
        return np.linalg.qr(self._dependent / self._sizes[:, None])[0]

    def combine(self, wanted: np.ndarray) -> np.ndarray:
        """x (m,) of least norm with columns x = wanted (n,), or as near to it as can be."""
        x = self._right @ ((self._left.T @ wanted) / self._values) / self._sizes
        return np.asarray(x - self._redundant @ (self._redundant.T @ x))

    def reach(self, wanted: np.ndarray) -> np.ndarray:
        """y (n,) or (n, k) of least norm with columns^T y = wanted (m,) or (m, k), or as near to it as can be."""
        scaled = (wanted.T / self._sizes).T
        return np.asarray(self._left @ ((self._right.T @ scaled).T / self._values).T)
