"""Embedded Runge-Kutta pairs as data; the coefficients are SciPy's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853, RK45

from ..errors import ArgumentError


@dataclass(frozen=True, eq=False)
class Tableau:
    """An explicit pair with dense output.

    stages:     evaluations that make up the new state; stage number `stages` is the evaluation there
    order:      of the propagated solution; error_order: exponent that step-size control assumes
    a, c:       rows and nodes of all stages, the new state (row `stages`) and the interpolant's extra ones
    errors:     (2, n) weights of one or two error estimates
    estimate_after: stage after which the error is known
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

    def interpolant(self, step: float, y0: np.ndarray, y1: np.ndarray, slopes: np.ndarray) -> Interpolant:
        """Dense output of a step from y0 to y1, slopes of the stages and extra stages given."""
        if self.name == "DOP853":
            f = np.empty((7, y0.size))
            delta = y1 - y0
            f[0] = delta
            f[1] = step * slopes[0] - delta
            f[2] = 2.0 * delta - step * (slopes[self.stages] + slopes[0])
            f[3:] = step * (DOP853.D @ slopes[: DOP853.D.shape[1]])
            return _NestedInterpolant(y0.copy(), f)
        return _PowerInterpolant(y0.copy(), step * (slopes[: self.stages + 1].T @ RK45.P))


class Interpolant:
    """y(theta) for theta in [0, 1]."""

    def __call__(self, theta: float) -> np.ndarray:
        raise NotImplementedError


class _NestedInterpolant(Interpolant):
    """Hairer's form for DOP853: order 7."""

    def __init__(self, y0: np.ndarray, f: np.ndarray):
        self._y0, self._f = y0, f

    def __call__(self, theta: float) -> np.ndarray:
        y = np.zeros_like(self._y0)
        for i, f in enumerate(self._f[::-1]):
            y += f
            y *= theta if i % 2 == 0 else 1.0 - theta
        return y + self._y0


class _PowerInterpolant(Interpolant):
    """Polynomial in theta without constant term: order 4."""

    def __init__(self, y0: np.ndarray, coefficients: np.ndarray):
        self._y0, self._coefficients = y0, coefficients

    def __call__(self, theta: float) -> np.ndarray:
        powers = np.cumprod(np.full(self._coefficients.shape[1], theta))
        return self._y0 + self._coefficients @ powers


def _dop853() -> Tableau:
    n = DOP853.n_stages
    a = np.zeros((n + 4, n + 4))
    c = np.zeros(n + 4)
    a[:n, :n], c[:n] = DOP853.A[:n, :n], DOP853.C[:n]
    a[n, :n], c[n] = DOP853.B, 1.0
    a[n + 1 :, : n + 4], c[n + 1 :] = DOP853.A_EXTRA, DOP853.C_EXTRA
    errors = np.zeros((2, n + 4))
    errors[0, : n + 1], errors[1, : n + 1] = DOP853.E5, DOP853.E3
    return Tableau("DOP853", n, 8, 7, a, c, errors, n - 1, 3)


def _rk45() -> Tableau:
    n = RK45.n_stages
    a = np.zeros((n + 1, n + 1))
    c = np.zeros(n + 1)
    a[:n, : RK45.A.shape[1]], c[:n] = RK45.A, RK45.C
    a[n, :n], c[n] = RK45.B, 1.0
    errors = np.zeros((2, n + 1))
    errors[0] = RK45.E
    return Tableau("RK45", n, 5, 4, a, c, errors, n, 0)


_TABLEAUX = {"DOP853": _dop853, "RK45": _rk45}


def tableau(method: str) -> Tableau:
    """The tableau of a method's name; ArgumentError for an unknown one."""
    if method not in _TABLEAUX:
        raise ArgumentError(f"unknown method {method!r}; one of {', '.join(_TABLEAUX)}")
    return _TABLEAUX[method]()
