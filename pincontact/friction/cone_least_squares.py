"""Least squares within friction cones, by ProxQP with facets that are refined about the solution.

    min |A y - b|      subject to      |t_i(y)| <= s_i(y) for each cone,   low <= R y <= high

with s_i and t_i (two numbers) affine in y. A quadratic program takes half-spaces instead of cones: those that touch a
cone along directions d, d . t_i <= s_i. Each contains the cone, so that the programs are relaxations: where one has no
solution, there is none. Where the solution of one leaves a cone, the half-space that touches it nearest to the solution
is added (Kelley, J. SIAM 8 (1960) 703), in the place of one that is far away; the directions are kept for the
next problem, whose solution is near this one's as a rule.

Directions converge slower than Newton's method does. So after each program the smooth equations of what it found to be
active (rows at a bound, cones on their edge or at their apex) are solved to round-off: stationarity with the cones'
curvature, regularised as in a proximal method (no rank is needed). The result counts if it lies within all cones
and its multipliers have the right signs: these conditions are sufficient, as the problem is convex, wherever ProxQP
has stopped.

Multipliers make certificates: y is optimal, or a system has no solution (Farkas), if a combination of half-spaces says
so; that of a cone's facets is a vector of its dual cone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

# Directions per cone: the first four stay, and make a square pyramid.
_FIRST = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
_DIRECTIONS = 12
# Programs per problem. Each halves the angle to the solution at least.
_PROGRAMS = 40
# What ProxQP is asked for where Newton's method finishes, and where it does not; what is within a cone, and a
# multiplier that is not zero. All in the units of the problem, which are of size one.
_ACCURACY, _TIGHT, _WITHIN, _ACTIVE = 1e-6, 1e-8, 1e-7, 1e-5
# Its iterations, outer and inner; its first penalty of inequalities, for warm starts; and when it may say that there is
# no solution: its default takes narrow problems for impossible ones.
_ITERATIONS, _PENALTY, _IMPOSSIBLE = 200, 1e-3, 1e-9
# Newton's method: its regularisation, steps, guesses of what is active, and what counts as solved.
_REGULAR, _STEPS, _GUESSES, _SOLVED = 1e-9, 10, 8, 1e-11
# Multipliers larger than this part of the largest say what all solutions have in common, and larger than what Newton's
# method leaves of one that is zero.
_MULTIPLIED, _KNOWN = 1e-7, 1e-9
# Directions that move A by less than this part of what moves it most do not move it.
_DEPENDENT = 1e-9
# Cones this near to their apex are at it.
_APEX = 1e-7
# What stands for no bound in ProxQP; entries of matrices that are next to nothing.
UNBOUNDED, _ROUND_OFF = 1e20, 1e-13


@dataclass(frozen=True, eq=False)
class Region:
    """cones (m, 3, n), apexes (m, 3): s, t_1, t_2 of each cone are cones @ y + apexes; low <= rows (k, n) @ y <= high,
    entries of low and high may be infinite."""

    cones: np.ndarray
    apexes: np.ndarray
    rows: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def restricted(self, start: np.ndarray, basis: np.ndarray, keep: bool = False) -> Region:
        """The region in the variables x of y = start + basis @ x; keep: enlarged by what `start` lies outside."""
        apexes, offset = self.apexes + self.cones @ start, self.rows @ start
        low, high = self.low - offset, self.high - offset
        if keep:
            apexes[:, 0] += np.maximum(np.hypot(apexes[:, 1], apexes[:, 2]) - apexes[:, 0], 0.0)
            low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
        return Region(_without_round_off(self.cones @ basis), apexes, _without_round_off(self.rows @ basis), low, high)

    def shared(self, solution: ConeSolution) -> np.ndarray:
        """Rows (r, n) that have the same value in all solutions of a problem, given one.

        What is multiplied does no work in any solution: rows are at their bounds, and forces on an edge of a cone that
        is one ray, or at its apex.
        """
        x = self.apexes + self.cones @ solution.y
        largest = max(np.abs(solution.cones).max(initial=0.0), np.abs(solution.rows).max(initial=0.0))
        clearly = max(_MULTIPLIED * float(largest), _KNOWN if solution.exact else 10.0 * _TIGHT)
        pressed, at_rows = -solution.cones[:, 0] > clearly, np.abs(solution.rows) > clearly
        lengths = np.hypot(x[:, 1], x[:, 2])
        fixed = [self.rows[at_rows]]
        for i in np.flatnonzero(pressed):
            if lengths[i] <= _APEX:
                fixed.append(self.cones[i])
            else:
                fixed.append(self.cones[i, 1:] - np.outer(x[i, 1:] / lengths[i], self.cones[i, 0]))
        return np.vstack(fixed)

    def elastic(self) -> Region:
        """The region in the variables (y, w): each cone is wider by its w, each row by its own."""
        m, k = len(self.cones), len(self.rows)
        wider = np.zeros((m, 3, m + 2 * k))
        wider[np.arange(m), 0, np.arange(m)] = 1.0
        eye, none = np.eye(k), np.zeros((k, m))
        rows = np.vstack([np.hstack([self.rows, none, eye, 0.0 * eye]), np.hstack([self.rows, none, 0.0 * eye, -eye])])
        endless = np.full(k, np.inf)
        return Region(
            np.concatenate([self.cones, wider], axis=2),
            self.apexes,
            rows,
            np.concatenate([self.low, -endless]),
            np.concatenate([endless, self.high]),
        )

    def outside(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By how much y leaves each cone (m,) and each row's range (k,); negative inside."""
        x, value = self.apexes + self.cones @ y, self.rows @ y
        return np.hypot(x[:, 1], x[:, 2]) - x[:, 0], np.maximum(self.low - value, value - self.high)

    def contains(self, y: np.ndarray, slack: float = _WITHIN) -> bool:
        """Whether y lies inside, but for the slack."""
        cones, rows = self.outside(y)
        return float(cones.max(initial=-1.0)) <= slack and float(rows.max(initial=-1.0)) <= slack


def _without_round_off(matrix: np.ndarray) -> np.ndarray:
    """The matrix without entries that are next to nothing: multiplied by enough they would refute anything."""
    return np.where(np.abs(matrix) > _ROUND_OFF, matrix, 0.0)


@dataclass(frozen=True, eq=False)
class ConeSolution:
    """y (n,); multipliers of the cones (m, 3), in minus their dual cones, and of the rows (k,), positive at `high`:
    A^T (A y - b) + sum of cones^T multipliers + rows^T multipliers = 0; exact: to round-off, else to ProxQP's accuracy.
    """

    y: np.ndarray
    cones: np.ndarray
    rows: np.ndarray
    exact: bool = False

    def scaled(self, unit: float) -> ConeSolution:
        """That of a problem whose squares are larger by this factor."""
        return ConeSolution(self.y, unit * self.cones, unit * self.rows, self.exact)


class ConeLeastSquares:
    """Solves problems that follow on each other, such as those of a control loop; see the module's docstring.

    programs, iterations: of ProxQP, so far.
    """

    def __init__(self) -> None:
        self.programs = self.iterations = 0
        self._qp: Any = None
        self._size, self._impossible, self._converged = (-1, -1), False, True
        self._directions = np.zeros((0, _DIRECTIONS, 2))
        self._duals = np.zeros(0)

    def solve(self, matrix: np.ndarray, right: np.ndarray, region: Region, guess: np.ndarray) -> ConeSolution | None:
        """The solution for A (r, n) and b (r,), or None where ProxQP found none; guess (n,): where it may be."""
        n, m = matrix.shape[1], len(region.cones)
        if n == 0:
            empty = ConeSolution(np.zeros(0), np.zeros((m, 3)), np.zeros(len(region.rows)))
            return empty if region.contains(empty.y) else None
        if len(self._directions) != m:
            self._directions = np.zeros((m, _DIRECTIONS, 2))
            self._directions[:, :4] = _FIRST
        # the unit of A is anybody's choice, and tolerances are those of entries of size one
        largest = float(np.abs(matrix).max(initial=0.0))
        if m == len(region.rows) == 0:
            # ProxQP would divide by what does not move A
            y = np.linalg.lstsq(matrix, right, rcond=_DEPENDENT)[0] if largest > _ROUND_OFF else np.zeros(n)
            return ConeSolution(y, np.zeros((0, 3)), np.zeros(0), exact=True)
        unit = largest if largest > _ROUND_OFF else 1.0
        hessian, gradient = matrix.T @ matrix / unit**2, -matrix.T @ right / unit**2
        scale = max(1.0, float(np.abs(gradient).max(initial=0.0)))
        y, accuracy = guess, _ACCURACY
        for _ in range(_PROGRAMS):
            # of size one, as multipliers are, however far away the least is
            found = self._solve_program(hessian / scale, gradient / scale, region, y, accuracy)
            if found is None:
                return None
            found = found.scaled(scale)
            exact = _finish(hessian, gradient, region, found, scale)
            if exact is not None:
                self._touch(region, exact.y, -_WITHIN)
                return exact.scaled(unit**2)
            if not self._converged:
                return None
            y = found.y
            left = region.outside(y)[0].max(initial=0.0)
            if left <= _WITHIN and accuracy == _TIGHT:
                return found.scaled(unit**2)
            self._touch(region, y, _WITHIN)
            if left <= 1e2 * _ACCURACY:
                accuracy = _TIGHT
        return None

    def _solve_program(
        self, hessian: np.ndarray, gradient: np.ndarray, region: Region, guess: np.ndarray, accuracy: float
    ) -> ConeSolution | None:
        warm = self._size != (-1, -1)
        found = self._run_program(hessian, gradient, region, guess, accuracy)
        if not self._converged and warm and not self._impossible:
            # with the penalties of a problem before, ProxQP may go to and fro
            self._size = (-1, -1)
            found = self._run_program(hessian, gradient, region, guess, accuracy)
        return found

    def _run_program(
        self, hessian: np.ndarray, gradient: np.ndarray, region: Region, guess: np.ndarray, accuracy: float
    ) -> ConeSolution | None:
        from proxsuite import proxqp

        n, m, k = gradient.size, len(region.cones), len(region.rows)
        directions = self._directions
        used = np.asarray(directions.any(axis=2))
        # d . t - s, zero where there is no direction
        facets = directions @ region.cones[:, 1:] - used[..., None] * region.cones[:, :1]
        room = region.apexes[:, :1] - (directions @ region.apexes[:, 1:, None])[..., 0]
        count = m * _DIRECTIONS
        rows = np.concatenate([facets.reshape(count, n), region.rows])
        low, high = np.full(count + k, -UNBOUNDED), np.full(count + k, UNBOUNDED)
        high[:count][used.ravel()] = room[used]
        np.maximum(region.low, -UNBOUNDED, out=low[count:])
        np.minimum(region.high, UNBOUNDED, out=high[count:])
        if self._size != (n, count + k):
            self._qp = proxqp.dense.QP(n, 0, count + k)
            settings = self._qp.settings
            settings.eps_rel, settings.eps_primal_inf, settings.default_mu_in = 0.0, _IMPOSSIBLE, _PENALTY
            # squares are bounded
            settings.eps_dual_inf = 0.0
            settings.max_iter = settings.max_iter_in = _ITERATIONS
            settings.compute_preconditioner = False
            settings.initial_guess = proxqp.InitialGuess.WARM_START
            self._qp.init(hessian, gradient, None, None, rows, low, high)
            self._size, self._duals = (n, count + k), np.zeros(count + k)
        else:
            self._qp.update(H=hessian, g=gradient, C=rows, l=low, u=high)
        self._qp.settings.eps_abs = accuracy
        self._qp.solve(guess, np.zeros(0), self._duals)
        results = self._qp.results
        self.programs += 1
        self.iterations += int(results.info.iter)
        self._impossible = results.info.status == proxqp.QPSolverOutput.PROXQP_PRIMAL_INFEASIBLE
        self._converged = results.info.status == proxqp.QPSolverOutput.PROXQP_SOLVED
        duals = np.array(results.z)
        self._duals = duals if self._converged else np.zeros(count + k)
        if self._impossible or not (np.isfinite(results.x).all() and np.isfinite(duals).all()):
            return None
        on_facets = np.maximum(duals[:count], 0.0).reshape(m, _DIRECTIONS)
        cones = np.empty((m, 3))
        cones[:, 0] = -on_facets.sum(axis=1)
        cones[:, 1:] = (on_facets[:, None] @ directions)[:, 0]
        return ConeSolution(np.array(results.x), cones, duals[count:])

    def _touch(self, region: Region, y: np.ndarray, beyond: float) -> None:
        """Add facets towards y to the cones that it leaves by more than this."""
        x = region.apexes + region.cones @ y
        lengths = np.hypot(x[:, 1], x[:, 2])
        left = np.flatnonzero((lengths - x[:, 0] > beyond) & (lengths > 0.0))
        for i in left.tolist():
            direction = x[i, 1:] / lengths[i]
            along = self._directions[i] @ direction
            if along.max() >= 1.0 - 1e-15:
                continue
            unused = np.logical_not(self._directions[i].any(axis=1))
            place = int(np.argmax(unused)) if unused.any() else 4 + int(np.argmin(along[4:]))
            self._directions[i, place] = direction
            if self._duals.size:
                self._duals[i * _DIRECTIONS + place] = 0.0


def _finish(
    hessian: np.ndarray, gradient: np.ndarray, region: Region, found: ConeSolution, scale: float
) -> ConeSolution | None:
    """The solution to round-off, from one that ProxQP has found; None where Newton's method does not come to it."""
    slack = _SOLVED
    pushed = slack * scale
    sides = np.where(np.abs(found.rows) > _ACTIVE * scale, np.sign(found.rows), 0.0)
    pressed = -found.cones[:, 0] > _ACTIVE * scale
    x = region.apexes + region.cones @ found.y
    at_apex = pressed & (np.abs(x).max(axis=1, initial=0.0) <= _APEX)
    for _ in range(_GUESSES):
        solution = _solve_active(hessian, gradient, region, found, sides, pressed, at_apex, scale)
        if solution is None:
            return None
        # what is left is active, too; what would have to pull is not
        outside, value = region.outside(solution.y)[0], region.rows @ solution.y
        left, low, high = outside > slack, value < region.low - slack, value > region.high + slack
        pulls = solution.rows * sides < -pushed
        loose = pressed & (np.hypot(solution.cones[:, 1], solution.cones[:, 2]) > pushed - solution.cones[:, 0])
        if not (left.any() or low.any() or high.any() or pulls.any() or loose.any()):
            return solution
        if (loose & at_apex).any():
            return None
        sides = np.where(pulls, 0.0, sides) + high * (sides == 0.0) - low * (sides == 0.0)
        pressed = (pressed & ~loose) | left
    return None


def _solve_active(
    hessian: np.ndarray,
    gradient: np.ndarray,
    region: Region,
    found: ConeSolution,
    sides: np.ndarray,
    pressed: np.ndarray,
    at_apex: np.ndarray,
    scale: float,
) -> ConeSolution | None:
    """Newton's method with rows at their bounds, sides (k,) -1 or 1, and cones `pressed` on, at their edges or apexes;
    None where it does not converge."""
    y = found.y
    n = y.size
    at_rows = np.flatnonzero(sides)
    bounds = np.where(sides > 0.0, region.high, region.low)[at_rows]
    edge, apex = np.flatnonzero(pressed & ~at_apex), np.flatnonzero(at_apex)
    fixed = np.vstack([region.rows[at_rows], region.cones[apex].reshape(-1, n)])
    aim = np.concatenate([bounds, -region.apexes[apex].ravel()])
    multipliers = np.concatenate([found.rows[at_rows], found.cones[apex].ravel(), -found.cones[edge, 0]])
    count, size = fixed.shape[0], n + multipliers.size
    cones, apexes = region.cones[edge], region.apexes[edge]
    tangents = cones[:, 1:]
    system, residual = np.zeros((size, size)), np.empty(size)
    system[:n, :n] = hessian
    system[:n, n : n + count], system[n : n + count, :n] = fixed.T, fixed
    regular, sizes = np.repeat([_REGULAR, -_REGULAR], [n, size - n]), np.repeat([scale, 1.0], [n, size - n])
    system.flat[:: size + 1] += regular
    d, last = np.zeros((0, 2)), np.inf
    for _ in range(_STEPS):
        if edge.size:
            x = apexes + cones @ y
            lengths = np.hypot(x[:, 1], x[:, 2])
            if not lengths.all():
                return None
            d = x[:, 1:] / lengths[:, None]
            slopes = np.einsum("mi,min->mn", d, tangents) - cones[:, 0]
            system[:n, n + count :], system[n + count :, :n] = slopes.T, slopes
            residual[n + count :] = lengths - x[:, 0]
        residual[:n] = hessian @ y + gradient + system[:n, n:] @ multipliers
        residual[n : n + count] = fixed @ y - aim
        error = max(abs(value) for value in (residual / sizes).tolist())
        # as far as round-off: certificates may be small
        if error <= 1e-16 or not error < 0.5 * last:
            break
        last = error
        if edge.size:
            across = d[:, :1] * tangents[:, 1] - d[:, 1:] * tangents[:, 0]
            curvature = np.maximum(multipliers[count:], 0.0) / lengths
            system[:n, :n] = hessian + (across.T * curvature) @ across
            system.flat[: n * size : size + 1] += _REGULAR
        step = np.linalg.solve(system, residual)
        y, multipliers = y - step[:n], multipliers - step[n:]
    if not error <= 10.0 * _SOLVED:
        return None
    rows, on_cones = np.zeros(len(region.rows)), np.zeros((len(region.cones), 3))
    rows[at_rows] = multipliers[: at_rows.size]
    on_cones[apex] = multipliers[at_rows.size : count].reshape(-1, 3)
    on_cones[edge, 0] = -multipliers[count:]
    on_cones[edge, 1:] = multipliers[count:, None] * d
    return ConeSolution(y, on_cones, rows, exact=True)
