"""ProxQP as the finder of contact modes: quadratic programs around a force estimate (Sec. 5.3).

ProxQP takes linear constraints. Each program has the cones' tangent planes at the last forces, two more facets
across, and the cones' curvature in its Hessian, so that a sequence of them converges to the cones' solution as
Newton's method does; one or two are enough to find the modes, and the Newton of `cone` does the rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .cone import assemble_qp

# The pull towards the last forces that makes a singular Delassus matrix definite (unit-sized scaling).
PROXIMAL = 1e-6
ACCURACY = 1e-6
# Binary digits of the forces that are passed on.
GRAIN_BITS = 26
# A degenerate program can keep ProxQP busy for seconds; one that needs more than this is better left.
ITERATIONS = 100


class ConeQP:
    """One ProxQP object for problems of one size, updated in place and warm-started."""

    def __init__(self, contacts: int):
        from proxsuite import proxqp

        rows = 3 * contacts
        self.hessian = np.eye(rows)
        self.gradient = np.zeros(rows)
        self.facets = np.zeros((4 * contacts, rows))
        self.upper = np.zeros(4 * contacts)
        self.lower = np.full(4 * contacts, -1e20)
        self.unit = np.ones(rows)
        self.estimate = np.zeros(rows)
        self._work = np.zeros(8 * contacts)
        self._solved = proxqp.QPSolverOutput.PROXQP_SOLVED
        self._qp: Any = proxqp.dense.QP(rows, 0, 4 * contacts)
        settings = self._qp.settings
        settings.eps_abs = ACCURACY
        settings.eps_rel = 0.0
        settings.max_iter = ITERATIONS
        settings.max_iter_in = ITERATIONS
        # Starting from the previous result is slower and fails more often when the problem is another one.
        settings.initial_guess = proxqp.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
        settings.compute_preconditioner = False
        self._initialised = False

    def restart(self) -> None:
        """Forget the last forces: the next program is the first of a sequence."""
        self.estimate[:] = 0.0

    def solve(self, delassus: np.ndarray, b: np.ndarray, mu: np.ndarray) -> bool:
        """Solve the program around `estimate` (3n,) and put its forces there; False if ProxQP gave up.

        delassus (3n, 3n), b (3n,), mu (n,): the contact problem in the caller's units; `estimate * unit` are forces.
        """
        assemble_qp(
            delassus,
            b,
            mu,
            self.estimate,
            PROXIMAL,
            self.hessian,
            self.gradient,
            self.facets,
            self.upper,
            self.unit,
            self._work,
        )
        qp = self._qp
        if self._initialised:
            qp.update(H=self.hessian, g=self.gradient, C=self.facets, u=self.upper)
        else:
            qp.init(self.hessian, self.gradient, None, None, self.facets, self.lower, self.upper)
            self._initialised = True
        qp.solve()
        self.estimate[:] = qp.results.x
        largest = np.abs(self.estimate).max(initial=0.0)
        if 0.0 < largest < np.inf:
            # ProxQP's last digits depend on where in memory its matrices are; its accuracy is far from these.
            grain = 2.0 ** (np.frexp(largest)[1] - GRAIN_BITS)
            self.estimate[:] = grain * np.rint(self.estimate / grain)
        return bool(qp.results.info.status == self._solved and np.isfinite(self.estimate).all())
