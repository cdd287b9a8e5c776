"""Embedded Runge-Kutta pairs as data; the coefficients are SciPy's."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.integrate import DOP853, RK45

from ..errors import ArgumentError
from .dense import DENSE_ROWS
from .stages import MAX_STAGES


@dataclass(frozen=True, eq=False)
class Tableau:
    """An explicit pair with dense output.

    stages:     evaluations that make up the new state; stage number `stages` is the evaluation there
    order:      of the propagated solution; error_order: exponent that step-size control assumes
    a, c:       rows and nodes of all stages, the new state (row `stages`) and the interpolant's extra ones
    errors:     (2, n) weights of one or two error estimates
    estimate_after: stage after which the error is known
    dense:      (rows, n + 1) weights of the interpolant's coefficients, that of y_1 - y_0 last; nested: see `dense`
    """

    name: str
    stages: int
    order: int
    error_order: int
    a: np.ndarray
    c: np.ndarray
    errors: np.ndarray
    estimate_after: int
    extra: int
    dense: np.ndarray
    nested: bool

    @cached_property
    def tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """a, c, errors and dense with zeros around them, as the kernels take them."""
        n = self.c.size
        rows, columns = self.dense.shape
        a, c, errors = np.zeros((MAX_STAGES, MAX_STAGES)), np.zeros(MAX_STAGES), np.zeros((2, MAX_STAGES))
        dense = np.zeros((DENSE_ROWS, MAX_STAGES + 1))
        a[:n, :n], c[:n], errors[:, :n] = self.a, self.c, self.errors
        dense[:rows, : columns - 1], dense[:rows, -1] = self.dense[:, :-1], self.dense[:, -1]
        return a, c, errors, dense

    @cached_property
    def widest(self) -> float:
        """Largest distance between the nodes of two neighbouring stages, as a fraction of the step."""
        return float(np.diff(np.unique(self.c[: self.stages + 1])).max())


def _dop853() -> Tableau:
    n = DOP853.n_stages
    a = np.zeros((n + 4, n + 4))
    c = np.zeros(n + 4)
    a[:n, :n], c[:n] = DOP853.A[:n, :n], DOP853.C[:n]
    a[n, :n], c[n] = DOP853.B, 1.0
    a[n + 1 :, : n + 4], c[n + 1 :] = DOP853.A_EXTRA, DOP853.C_EXTRA
    errors = np.zeros((2, n + 4))
    errors[0, : n + 1], errors[1, : n + 1] = DOP853.E5, DOP853.E3
    # Hairer's form: the difference, the slopes at both ends, and four combinations of all stages
    dense = np.zeros((7, n + 5))
    dense[0, -1], dense[1, -1], dense[2, -1] = 1.0, -1.0, 2.0
    dense[1, 0], dense[2, 0], dense[2, n] = 1.0, -1.0, -1.0
    dense[3:, : n + 4] = DOP853.D
    return Tableau("DOP853", n, 8, 7, a, c, errors, n - 1, 3, dense, True)


def _rk45() -> Tableau:
    n = RK45.n_stages
    a = np.zeros((n + 1, n + 1))
    c = np.zeros(n + 1)
    a[:n, : RK45.A.shape[1]], c[:n] = RK45.A, RK45.C
    a[n, :n], c[n] = RK45.B, 1.0
    errors = np.zeros((2, n + 1))
    errors[0] = RK45.E
    dense = np.zeros((4, n + 2))
    dense[:, : n + 1] = RK45.P.T
    return Tableau("RK45", n, 5, 4, a, c, errors, n, 0, dense, False)


_TABLEAUX = {"DOP853": _dop853, "RK45": _rk45}


@cache
def tableau(method: str) -> Tableau:
    """The tableau of a method's name; ArgumentError for an unknown one."""
    if method not in _TABLEAUX:
        raise ArgumentError(f"unknown method {method!r}; one of {', '.join(_TABLEAUX)}, Moreau")
    return _TABLEAUX[method]()
