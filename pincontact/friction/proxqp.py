"""Coulomb's law by a sequence of ProxQP programs (Sec. 5.3).

The law at n contacts (see `cone`) is no optimisation problem, but with the disks of friction given it is one. With
radii r (n,) Coulomb's law is the optimality of the convex program

    min F' G F / 2 + b' F      subject to      F_n >= 0,  |F_t| <= r

whose multipliers are u_n and the speeds of slip: friction with given loads. The sequence puts r = mu F_n of the last
program's forces F. Its fixed points are exactly the solutions of the law.

It is one of a family. With cones |F_t| <= mu ((1 - theta) F_n(last) + theta F_n) in the constraints, and De Saxce's
shift theta mu |u_t| n of the last program in the gradient, the fixed points are the same for all theta: what the cone's
multiplier adds to u_n the shift takes away. theta = 1 is De Saxce and Feng's form and Acary and Cadoux's sequence of
convex programs; theta = 0 is the above, where the shift is zero. What differs is the rate. For one sliding contact with
G = g I the error of theta = 1 shrinks by mu^2 / (1 + mu^2), slowly where friction is high; theta = 0 is exact at once.
In general, with the modes as they are, N the normal rows of the contacts that press and D the directions of slip, a
small change of r changes F_n by (N G N')^-1 N G D dr: the sequence contracts where mu times that, the coupling
of normal and tangential directions, is less than one. On the random problems of examples/benchmarks/cone.py theta = 0
was the best of all values tried.

Four things make the sequence converge in practice.

    facets      ProxQP takes linear constraints: each disk is the square around it that touches it in the direction of
                the last force, bounds of the components along and across. The disk's curvature times its multiplier,
                slip speed over radius, is in the Hessian, so that the forces turn as they do in Newton's method for the
                disks (sequential quadratic programming).
    proximal    A term that pulls to the last forces makes singular matrices definite and far steps shorter, as the
                damping of a Levenberg-Marquardt method does. It shrinks with the natural-map residual of these
                (`cone.natural_map_residual`), to a size that only matters where forces are redundant.
    relaxation  Where one change of the forces goes back on the one before (rates below -1: cycles), only part of
                it is made, and more again where it does not.
    series      From the second beginning on, changes in one direction are summed as a geometric series (Aitken). Its
                limit is behind where the changes grow: a fixed point that the sequence alone would leave.

Of ProxQP's results only that counts which bounds are reached; the forces are computed again from these. In directions
of redundant forces, where only the proximal term decides, its accuracy says little, and its last digits depend on where
in memory its factors happen to be. So the same problem gives the same bits.

Nothing of this has to converge to the end: after each program Newton's method (`newton`) is tried from its forces, in
the modes that these and their velocities suggest. What it ends at is the solution if its natural-map residual is within
the tolerance; else the sequence goes on.

The sequence begins at the forces of the last solution; without these, or where it has not come to an end, at parts of
the normal forces that each contact would have alone. It gives up where the forces grow beyond all bounds.

Sources: De Saxce and Feng, Math. Comput. Modelling 28 (1998) 225; Acary, Cadoux, Lemarechal and Malick, ZAMM 91 (2011)
155 (theta = 1); Panagiotopoulos, Ing. Archiv 44 (1975) 421 (theta = 0); Acary and Brogliato, Numerical Methods for
Nonsmooth Dynamical Systems, Springer 2008, ch. 13; Bambade, El-Kazdadi, Taylor and Carpentier, ProxQP, RSS 2022.
"""

from __future__ import annotations

from collections.abc import Callable
from math import floor, frexp, ldexp, sqrt
from typing import Any

import numpy as np

from ..arrays import array_entry
from ..jit import REAL, SEVERAL, kernel
from ..linalg import factor_definite, inner, solve_definite
from .cone import ESCAPED, HUGE, LARGEST_FRICTION, natural_map_residual, respond, scale_problem
from .cone_least_squares import UNBOUNDED

# Programs per beginning, and the beginnings: how much of the normal forces that contacts would have alone, the proximal
# term per residual, and from which cosine of two changes on they count as a series (2: never).
PROGRAMS = 40
BEGINNINGS = ((0.5, 3e-2, 2.0), (0.0, 1e-3, 0.98), (0.5, 1e-2, 0.98))
# The least proximal term: blocks of the scaled Delassus matrix are of size one.
LEAST_PROXIMAL = 1e-6
# Largest curvature of a disk: one with no radius has a corner.
CURVATURE = 1e3
# Two changes go back on each other below this cosine; what is left of the relaxation then, what it grows by else, and
# the least; and how many times the last change a series may sum to.
BACKWARDS, LESS, MORE, LEAST_STEP = -0.2, 0.6, 1.2, 0.1
REACH = 30.0
# ProxQP's accuracy, and binary digits of the forces that are passed on: where force and multiplier of a bound are zero,
# either answer may come, and they agree to fewer digits than all.
ACCURACY, GRAIN_BITS = 1e-6, 26
# Corrections of the bounds that it has found, and multipliers of the wrong sign that are round-off: those of redundant
# forces are as small as its accuracy.
CORRECTIONS, PULLS = 10, 1e-14
# A degenerate program can keep ProxQP busy for seconds; one that needs more than this is better left.
ITERATIONS = 100
# Rows of `_vectors` (8, 3n): b, forces and velocities without units; the unit of the forces; the last program's forces
# and multipliers, the last change, scratch. Of `_scalars` (4, n): scale, scratch, directions of the squares. Entries of
# `_state`: residual of the forces, relaxation, largest force found, and what belongs to the beginning.
C, F, U, UNIT, FOUND, MULTIPLIERS, CHANGE, SCRATCH = range(8)
SCALE, SIZE, ALONG = range(3)
RESIDUAL, STEP, LARGEST, PULL, ONWARDS = range(5)


class ConePrograms:
    """The sequence for problems of one size; one ProxQP object, updated in place.

    Counters: programs, iterations (of ProxQP, inner ones), failures (sequences that came to no solution).
    """

    def __init__(self, contacts: int):
        from proxsuite import proxqp

        rows = 3 * contacts
        self.programs = self.iterations = self.failures = 0
        self._scaled = np.eye(rows)
        self._vectors = np.zeros((8, rows))
        self._scalars = np.zeros((4, contacts))
        self._state = np.zeros(5)
        self._hessian, self._factor, self._gradient = np.eye(rows), np.eye(rows), np.zeros(rows)
        self._lower, self._upper = np.zeros(rows), np.full(rows, UNBOUNDED)
        self._qp: Any = proxqp.dense.QP(rows, 0, 0, box_constraints=True)
        settings = self._qp.settings
        settings.eps_abs = ACCURACY
        settings.eps_rel = 0.0
        settings.max_iter = settings.max_iter_in = ITERATIONS
        # Starting from the previous result is slower and fails more often: another facet is active.
        settings.initial_guess = proxqp.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
        settings.compute_preconditioner = False
        self._qp.init(self._hessian, self._gradient, None, None, None, None, None, self._lower, self._upper)

    @property
    def counts(self) -> tuple[int, int, int]:
        """The counters."""
        return self.programs, self.iterations, self.failures

    def renew(self) -> None:
        """Counters are as new."""
        self.programs = self.iterations = self.failures = 0

    def solve(
        self,
        delassus: np.ndarray,
        b: np.ndarray,
        mu: np.ndarray,
        forces: np.ndarray,
        warm: bool,
        finish: Callable[[], bool],
        programs: int,
    ) -> bool:
        """Whether `finish()` took the forces of a program for the beginning of a solution.

        delassus (3n, 3n), b (3n,), mu (n,): the problem; forces (3n,): the last ones, of use if warm, and those of
        each program before `finish` is called; programs: at most so many for each beginning.
        """
        for beginning in ((-1.0, *BEGINNINGS[0][1:]), *BEGINNINGS) if warm else BEGINNINGS:
            begin_programs(delassus, b, mu, forces, *beginning, self._scaled, self._vectors, self._scalars, self._state)
            for _ in range(programs):
                if self._solve_program(mu, forces) and finish():
                    return True
                relax_forces(mu, forces, self._scaled, self._vectors, self._scalars, self._state)
                if not self._state[LARGEST] <= ESCAPED:
                    break
                if finish():
                    return True
        self.failures += 1
        return False

    def _solve_program(self, mu: np.ndarray, forces: np.ndarray) -> bool:
        """Put the forces of the program around the last ones into forces (3n,); False if they are not finite."""
        program = self._hessian, self._gradient, self._lower, self._upper
        write_program(mu, self._scaled, self._vectors, self._scalars, self._state, *program)
        qp = self._qp
        qp.update(H=self._hessian, g=self._gradient, l_box=self._lower, u_box=self._upper)
        qp.solve()
        self.programs += 1
        self.iterations += int(qp.results.info.iter)
        self._vectors[FOUND], self._vectors[MULTIPLIERS] = qp.results.x, qp.results.z
        take_forces(forces, self._vectors, self._scalars, self._state, *program, self._factor)
        return bool(self._state[LARGEST] <= ESCAPED)


@kernel
def weigh(g, mu, vectors, scalars, state):
    """Velocities and residual of the forces in the vectors."""
    respond(g, vectors[C], vectors[F], vectors[U], scalars[SIZE], vectors[SCRATCH])
    state[RESIDUAL] = natural_map_residual(mu, vectors[F], vectors[U], scalars[SIZE])


@kernel
def into_cones(mu, f):
    """Move forces (3n,) that pull, or are outside their disks, to where they are not."""
    for i in range(mu.shape[0]):
        k = 3 * i
        f[k + 2] = max(f[k + 2], 0.0)
        length = sqrt(f[k] ** 2 + f[k + 1] ** 2)
        radius = min(mu[i], LARGEST_FRICTION) * f[k + 2]
        if length > radius:
            f[k] *= radius / length
            f[k + 1] *= radius / length


@array_entry(
    REAL[:, ::1], REAL[::1], REAL[::1], REAL[::1], REAL, REAL, REAL, REAL[:, ::1], REAL[:, ::1], REAL[:, ::1],
    REAL[::1], when=SEVERAL,
)  # fmt: skip
def begin_programs(delassus, b, mu, forces, share, pull, onwards, scaled, vectors, scalars, state):
    """The problem without units, and the sequence's first forces.

    share: below zero they are forces (3n,), else that much of the normal forces that contacts would have alone.
    pull, onwards: see `BEGINNINGS`.
    scaled (3n, 3n), vectors (8, 3n), scalars (4, n), state (5,): output, see `ConePrograms`.
    """
    g = scaled
    n = mu.shape[0]
    largest = scale_problem(delassus, b, n, g, vectors[C], scalars[SCALE], vectors[SCRATCH])
    for i in range(n):
        for k in range(3 * i, 3 * i + 3):
            vectors[UNIT, k] = scalars[SCALE, i] * largest
            vectors[F, k] = forces[k] / vectors[UNIT, k] if share < 0.0 else 0.0
            vectors[CHANGE, k] = 0.0
        k = 3 * i + 2
        if share >= 0.0 and g[k, k] > 0.0:
            vectors[F, k] = share * max(-vectors[C, k], 0.0) / g[k, k]
    state[STEP], state[PULL], state[ONWARDS] = 1.0, pull, onwards
    weigh(scaled, mu, vectors, scalars, state)


@kernel
def turn_pairs(scalars, x, backwards):
    """Components of each contact (3n,) along and across its direction in place of the first two, or backwards."""
    for i in range(scalars.shape[1]):
        k = 3 * i
        d1 = scalars[ALONG, i]
        d2 = -scalars[ALONG + 1, i] if backwards else scalars[ALONG + 1, i]
        first = x[k]
        x[k] = d1 * first + d2 * x[k + 1]
        x[k + 1] = d1 * x[k + 1] - d2 * first


@array_entry(
    REAL[::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1], REAL[::1], REAL[:, ::1], REAL[::1], REAL[::1], REAL[::1],
    when=SEVERAL,
)  # fmt: skip
def write_program(mu, scaled, vectors, scalars, state, hessian, gradient, lower, upper):
    """The program around forces f and velocities u: min x' H x / 2 + g' x with lower <= x <= upper.

    Three variables for each contact: the force along the last one's direction in the tangent plane, across it, and the
    normal force, which is not negative.
    hessian (3n, 3n), gradient, lower, upper (3n,), and the directions in scalars: output.
    """
    g = scaled
    f = vectors[F]
    u = vectors[U]
    n = mu.shape[0]
    proximal = max(state[PULL] * min(state[RESIDUAL], 1.0), LEAST_PROXIMAL)
    for i in range(n):
        k = 3 * i
        d1 = -f[k]
        d2 = -f[k + 1]
        if d1 == 0.0 and d2 == 0.0:
            d1 = u[k]
            d2 = u[k + 1]
        norm = sqrt(d1 * d1 + d2 * d2)
        scalars[ALONG, i] = d1 / norm if norm > 0.0 else 1.0
        scalars[ALONG + 1, i] = d2 / norm if norm > 0.0 else 0.0
    for k in range(3 * n):
        for j in range(3 * n):
            hessian[k, j] = g[k, j]
        hessian[k, k] += proximal
        gradient[k] = vectors[C, k] - proximal * f[k]
        turn_pairs(scalars, hessian[k], False)
    turn_pairs(scalars, gradient, False)
    for i in range(n):
        k = 3 * i
        d1 = scalars[ALONG, i]
        d2 = scalars[ALONG + 1, i]
        for j in range(3 * n):
            first = hessian[k, j]
            hessian[k, j] = d1 * first + d2 * hessian[k + 1, j]
            hessian[k + 1, j] = d1 * hessian[k + 1, j] - d2 * first
        length = sqrt(f[k] * f[k] + f[k + 1] * f[k + 1])
        if length > 0.0:
            hessian[k + 1, k + 1] += min(max(d1 * u[k] + d2 * u[k + 1], 0.0) / length, CURVATURE)
        upper[k] = upper[k + 1] = min(mu[i], LARGEST_FRICTION) * max(f[k + 2], 0.0)
        lower[k] = lower[k + 1] = -upper[k]


@array_entry(
    REAL[::1], REAL[:, ::1], REAL[:, ::1], REAL[::1], REAL[:, ::1], REAL[::1], REAL[::1], REAL[::1], REAL[:, ::1],
    when=SEVERAL,
)  # fmt: skip
def take_forces(forces, vectors, scalars, state, hessian, gradient, lower, upper, factor):
    """Forces (3n,) with units from the bounds that a program's result has reached; factor (3n, 3n): scratch.

    A bound is reached where its multiplier is larger than what is left to it. The other variables follow from these;
    where they leave their bounds, or a bound would have to pull, that is corrected.
    """
    found = vectors[FOUND]
    reached = vectors[MULTIPLIERS]
    x = vectors[SCRATCH]
    rows = found.shape[0]
    for k in range(rows):
        multiplier = reached[k]
        reached[k] = 1.0 if multiplier >= upper[k] - found[k] else (-1.0 if -multiplier >= found[k] - lower[k] else 0.0)
    for _ in range(CORRECTIONS):
        for k in range(rows):
            x[k] = -gradient[k] if reached[k] == 0.0 else (upper[k] if reached[k] > 0.0 else lower[k])
        for k in range(rows):
            for j in range(rows):
                apart = reached[k] != 0.0 or reached[j] != 0.0
                factor[k, j] = (1.0 if j == k else 0.0) if apart else hessian[k, j]
                if reached[k] == 0.0 and reached[j] != 0.0:
                    x[k] -= hessian[k, j] * x[j]
        factor_definite(factor, rows)
        solve_definite(factor, rows, x)
        changed = False
        for k in range(rows):
            bound = reached[k]
            if bound != 0.0 and bound * (gradient[k] + inner(hessian[k], x, rows)) > PULLS:
                reached[k] = 0.0
            elif bound == 0.0 and not lower[k] <= x[k] <= upper[k]:
                reached[k] = 1.0 if x[k] > upper[k] else -1.0
            changed = changed or bound != reached[k]
        if not changed:
            break
    largest = 0.0
    for k in range(rows):
        found[k] = min(max(x[k], lower[k]), upper[k])
        if not abs(x[k]) < HUGE:
            state[LARGEST] = HUGE
            return
        largest = max(largest, abs(found[k]))
    state[LARGEST] = largest
    grain = ldexp(1.0, frexp(largest)[1] - GRAIN_BITS)
    for k in range(rows):
        found[k] = grain * floor(found[k] / grain + 0.5)
    turn_pairs(scalars, found, True)
    for k in range(rows):
        forces[k] = found[k] * vectors[UNIT, k]


@array_entry(REAL[::1], REAL[::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1], REAL[::1], when=SEVERAL)
def relax_forces(mu, forces, scaled, vectors, scalars, state):
    """Go on from the last forces towards those of the program, moved into the cones: all the way, part of it, or to
    the limit of the series."""
    if not state[LARGEST] <= ESCAPED:
        return
    f = vectors[F]
    found = vectors[FOUND]
    change = vectors[CHANGE]
    into_cones(mu, found)
    along = before = now = 0.0
    for k in range(f.shape[0]):
        step = found[k] - f[k]
        along += step * change[k]
        before += change[k] * change[k]
        now += step * step
        change[k] = step
    share = state[STEP]
    cosine = along / sqrt(before * now) if before * now > 0.0 else 0.0
    if cosine > state[ONWARDS]:
        # a geometric series, whose limit is ahead, or behind where it grows
        rest = before - along
        share = share * before / rest if abs(rest) * REACH > share * before else (REACH if rest >= 0.0 else -REACH)
    elif cosine < BACKWARDS:
        share = state[STEP] = max(LESS * share, LEAST_STEP)
    else:
        share = state[STEP] = min(MORE * share, 1.0)
    for k in range(f.shape[0]):
        f[k] += share * change[k]
        if cosine > state[ONWARDS]:
            change[k] = 0.0
    into_cones(mu, f)
    for k in range(f.shape[0]):
        forces[k] = f[k] * vectors[UNIT, k]
    weigh(scaled, mu, vectors, scalars, state)
