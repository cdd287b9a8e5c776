"""Contacts some of which slide already, and discs whose radii follow from the forces, as one generalised equation.

Unknowns are the forces of n units with rows (t1, t2, n), and u = G F + b. A unit is a contact, with a normal force
N >= 0, u_n >= 0, N u_n = 0, or has none. It may have a disc for its tangential force T, of radius

    mu |a + B F|,    a (2,) and B (2, 3n) constant:

mu N for a contact, a length times the contact's N for its resistance to turning, mu times the force of eliminated
equations for a bilateral contact, a number for dry friction. The friction of what slides already has a known direction
and goes with its normal force, F = N (n - mu d): then the operator, J_n M^-1 (J_n - mu d J_t)^T where everything
slides, is not symmetric, and need not be of any definiteness: there may be several solutions, or none (Painleve).

With the projections on N >= 0 and on the discs, F is a solution where it is the projection of F - u in all units at
once. Newton's method finds it from near by (Alart, Curnier, Comput. Methods Appl. Mech. Engrg. 92, 1991), and ends at
round-off. Where nothing slides, projected Gauss-Seidel comes near, whatever it starts from, unless friction and loads
feed on each other: then friction grows from nothing in small parts. Else what is near is suggested by the present
forces; by the symmetric cone problem in which what slides has so large a velocity along its direction that it can do
nothing else; and, of few contacts, by each choice of those that carry a load. Where more contacts stick than bodies can
feel, as four wheels on a floor, full steps may go to and fro between two choices of what sticks: steps that are halved
until the residual falls then get there.

With radii that are given and do not change the problem is convex. It has a solution whatever the radii, unless bodies
are crushed, and that takes energy: the work F . (b + G F / 2) is the least there is, at most that of no forces, zero.
So where friction leaves no solution, or none is found, there is one for the radii of the last forces
(`solve_with_radii`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from ..jit import CALLED, INTEGER, REAL, entry_kernel
from .cone import OPEN, SLIP, STICK
from .scaled_loads import TOLERANCE, Chosen, ScaledLoads

# Coefficient that stands in for an infinite one: what has to slip then is held up by friction with next to no load.
LARGE_FRICTION = 1e4
# Coefficient with which that load is round-off.
_INFINITE = 1e16
# Smaller ones, by which forces come to those of that one: as friction doubles, a load that is left halves.
_GROWING = tuple(2.0**k for k in range(14))
# A load that is less than so many times that at which it slips is one at which it slips.
_AT_LIMIT = 3.0
# Normal forces whose choices of loaded ones are all tried, without and with discs.
_TRIED, _TRIED_WITH_DISCS = 10, 6
# Velocity of what slides, in units of the largest acceleration without forces, in the symmetric problem.
_SPEED = 1e3
# Gauss-Seidel passes before every try of Newton's method; with given radii, which need no more than patience.
_PASSES, _PASSES_WITH_RADII = (20, 100, 500, 2500), (100, 1000, 5000)
# In how many parts friction is let grow where Gauss-Seidel comes to nothing.
_PARTS = (20, 200)
# Residual up to which forces of given radii are taken.
RADII_TOLERANCE = 1e-6


@dataclass
class Loads:
    """The problem. gram (3n, 3n), base (3n,); normal (n,): which units have a normal force; tangents (n,): how many
    tangential ones, 0, 1 or 2; mu (n,); radius_base (2n,), radius_rows (2n, 3n): a and B, by twos; drag (3n, 3n): whole
    forces for a unit of each, where friction goes with what causes it, else None; directions (2n,): of slip, by twos,
    where it has one already, which forces on the rims of discs oppose, else zero, or None. Other rows have no force of
    their own. All are C-contiguous float64."""

    gram: np.ndarray
    base: np.ndarray
    normal: np.ndarray
    tangents: np.ndarray
    mu: np.ndarray
    radius_base: np.ndarray
    radius_rows: np.ndarray
    drag: np.ndarray | None = None
    directions: np.ndarray | None = None

    def solve(self, forces: np.ndarray) -> tuple[np.ndarray, float]:
        """Forces (3n,) from those given, and their residual: above `TOLERANCE` that is no solution."""
        return self._unloaded(*self._gauss_seidel(forces, _PASSES))

    def refine(self, forces: np.ndarray) -> tuple[np.ndarray, float]:
        """The solution (3n,) that Newton's method comes to from forces near to it, and its residual."""
        scaled = ScaledLoads(self)
        y, residual = scaled.newton(scaled.unknowns(forces))
        return self._unloaded(scaled.forces(y), residual)

    def _unloaded(self, forces: np.ndarray, residual: float) -> tuple[np.ndarray, float]:
        """A solution without the loads by which large friction holds up what slips in spite of infinite friction."""
        lifted = np.isinf(self.mu) & (self.normal > 0.0)
        if not residual <= TOLERANCE or not lifted.any():
            return forces, residual
        lifted &= self.modes(forces) == SLIP
        loads, start = 3 * np.flatnonzero(lifted) + 2, forces.copy()
        # the unknown is the radius instead of the load
        drag = np.eye(self.base.size) if self.drag is None else self.drag.copy()
        drag[loads, loads] = 1.0 / _INFINITE
        start[loads] = np.hypot(forces[loads - 2], forces[loads - 1])
        scaled = ScaledLoads(replace(self, mu=np.where(lifted, _INFINITE, self.mu), drag=drag))
        y, exact = scaled.newton(scaled.unknowns(start))
        if not exact <= TOLERANCE:
            return forces, residual
        forces = scaled.forces(y)
        forces[loads] = 0.0
        return forces, exact

    def solve_with_radii(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
        """Forces (3n,) for the radii that these have, modes (n,) and residual with these radii, and how far they are
        from those of the result, relative to the largest."""
        radii = self.radii(forces)
        given = replace(
            self,
            mu=np.sign(self.mu),
            radius_base=np.stack([radii, np.zeros_like(radii)], axis=1).ravel(),
            radius_rows=np.zeros_like(self.radius_rows),
        )
        found, residual = given._gauss_seidel(forces, _PASSES_WITH_RADII)
        off = np.abs(self.radii(found) - radii).max(initial=0.0) / (float(radii.max(initial=0.0)) or 1.0)
        return found, given.modes(found), residual, float(off)

    def radii(self, forces: np.ndarray) -> np.ndarray:
        """(n,) of the discs at forces (3n,)."""
        loads = np.linalg.norm((self.radius_base + self.radius_rows @ forces).reshape(-1, 2), axis=1)
        return self.coefficients * loads

    @property
    def coefficients(self) -> np.ndarray:
        """(n,) finite ones."""
        return np.where(np.isinf(self.mu), LARGE_FRICTION, self.mu)

    @property
    def along(self) -> np.ndarray:
        """(2n,) `directions`, zero where there are none."""
        return np.zeros(2 * self.mu.size) if self.directions is None else self.directions

    def velocities(self, forces: np.ndarray) -> np.ndarray:
        """(3n,) at forces (3n,) of a solution; what is round-off is zero."""
        velocities = self.gram @ forces + self.base
        velocities[np.abs(velocities) <= TOLERANCE * float(np.abs(self.base).max(initial=0.0))] = 0.0
        return velocities

    def modes(self, forces: np.ndarray) -> np.ndarray:
        """(n,) OPEN: no normal force, or no radius where there is none; SLIP: on the disc's rim, or held up by
        friction alone; else STICK."""
        modes, radii = np.full(self.mu.size, STICK), self.radii(forces)
        velocities, least = self.velocities(forces), TOLERANCE * float(np.abs(self.base).max(initial=0.0))
        for i, count in enumerate(self.tangents.astype(int)):
            k = 3 * i
            weight = float(self.gram.diagonal()[k : k + 3].max()) or 1.0
            # a force that is round-off presses nothing together that moves apart
            load = forces[k + 2] - velocities[k + 2] / weight if self.normal[i] else radii[i]
            if load <= 0.0:
                held_up = math.isinf(self.mu[i]) and weight * np.abs(forces[k : k + 2]).max() > least
                modes[i] = SLIP if held_up else OPEN
                continue
            aim = forces[k : k + count] - velocities[k : k + count] / weight
            slides = self.mu[i] == 0.0 or self.along[2 * i : 2 * i + 2].any()
            if slides or float(np.linalg.norm(aim)) > radii[i] * (1.0 + TOLERANCE):
                modes[i] = SLIP
        return modes

    def _gauss_seidel(self, forces: np.ndarray, rounds: tuple[int, ...]) -> tuple[np.ndarray, float]:
        """The best of what Gauss-Seidel and Newton's method come to, and its residual."""
        scaled, mu = ScaledLoads(self), self.coefficients
        drag = np.eye(self.base.size) if self.drag is None else self.drag
        # velocities for a unit of each, and radii
        response, radius_rows = np.ascontiguousarray((self.gram @ drag).T), self.radius_rows @ drag
        f = np.zeros_like(forces)
        f[scaled.rows] = forces[scaled.rows]
        best, least = f.copy(), math.inf
        for passes in rounds:
            u = f @ response + self.base
            gauss_seidel_loads(
                response, self.normal, self.tangents, mu, self.radius_base, radius_rows, self.along, f, u, passes
            )
            if not np.isfinite(f).all():
                break
            y, residual = scaled.newton(scaled.unknowns(f))
            reached = scaled.residual(scaled.unknowns(f))
            if residual <= TOLERANCE:
                return scaled.forces(y), residual
            if reached <= least:
                best, least = f.copy(), reached
        for parts in _PARTS:
            y = scaled.unknowns(np.zeros_like(forces))
            for part in range(1, parts + 1):
                y, residual = scaled.with_friction(part / parts).newton(y)
                if not residual <= TOLERANCE:
                    break
            else:
                return scaled.forces(y), residual
        return drag @ best, least


class LoadSolver:
    """Solves problems some of whose contacts slide. After `solve` returned True, `forces` (3n,) and `velocities` (3n,)
    are a solution; after it returned False, `proved` says whether there is none, or none was found.

    guess_first: begin from what `guess` finds, and from the last forces where that leads nowhere. unguessed: how often
    it did not, of problems begun so.
    """

    def __init__(self, guess_first: bool = False) -> None:
        self.guess_first, self.unguessed = guess_first, 0
        self.forces = self.velocities = np.zeros(0)
        self.residual = 0.0
        self.proved = False

    def solve(self, problem: Loads, forces: np.ndarray, guess: Callable[[float], np.ndarray | None]) -> bool:
        """Solve it from forces (3n,), those of `guess`(velocity of what slides), and from all choices of few loads."""
        scaled = ScaledLoads(problem)
        self.proved = lost = False
        for start, chosen, halved in self._starts(problem, scaled, forces, guess):
            y, residual = scaled.newton(start, chosen, halved)
            if residual <= TOLERANCE and scaled.is_lost(y):
                lost = True
            elif residual <= TOLERANCE:
                # loads of redundant contacts may be round-off
                small = TOLERANCE * (1.0 + float(np.abs(y).max(initial=0.0)))
                loads = scaled.normals["place"]
                y[loads[y[loads] <= small]] = 0.0
                self.forces = scaled.forces(y)
                self.velocities = problem.velocities(self.forces)
                self.residual = residual
                return True
        # every choice of loads is one linear system, and none of them has a solution
        self.proved = not lost and not scaled.curved and scaled.choices <= _TRIED
        return False

    def _starts(
        self, problem: Loads, scaled: ScaledLoads, forces: np.ndarray, guess: Callable[[float], np.ndarray | None]
    ) -> Iterator[tuple[np.ndarray, Chosen | None, bool]]:
        """Forces to begin from, loads that are prescribed, if they are, and whether steps are halved."""
        present = scaled.unknowns(forces)
        if not self.guess_first:
            yield present, None, False
        found = guess(_SPEED * scaled.largest)
        if found is not None:
            yield scaled.unknowns(found), None, False
        if self.guess_first:
            self.unguessed += 1
            yield present, None, False
        if scaled.choices <= (_TRIED_WITH_DISCS if scaled.curved else _TRIED):
            count = scaled.normals.size
            # what is closed stays closed, if it can
            for number in range(count, -1, -1):
                for places in combinations(range(count), number):
                    loaded = np.zeros(count, dtype=bool)
                    loaded[list(places)] = True
                    for signs in product((1.0, -1.0), repeat=scaled.choices - count):
                        yield np.zeros(present.size), Chosen(loaded, signs), False
        if np.isinf(problem.mu).any():
            yield scaled.unknowns(_grown(problem, forces)), None, True
        if scaled.discs.size:
            yield scaled.unknowns(problem.solve(np.nan_to_num(forces))[0]), None, False
            yield present, None, True


def _grown(problem: Loads, forces: np.ndarray) -> np.ndarray:
    """Forces (3n,) near a solution with friction without bound, as they become while it grows; from `forces` on.

    The direction of friction changes all at once where next to no load is left, and steps from afar go to and fro.
    """
    solver, unbounded = LoadSolver(), np.isinf(problem.mu)
    for large in (*_GROWING, LARGE_FRICTION):
        grown = replace(problem, mu=np.where(unbounded, large, problem.mu))
        scaled = ScaledLoads(grown)
        # what is left of the loads of what slips goes with the inverse of friction
        start, least = forces.copy(), np.linalg.norm(forces.reshape(-1, 3)[:, :2], axis=1) / large
        start[2::3] = np.where(unbounded & (forces[2::3] < _AT_LIMIT * least), least, forces[2::3])
        y, residual = scaled.newton(scaled.unknowns(start), halved=True)
        if residual <= TOLERANCE and not scaled.is_lost(y):
            forces = scaled.forces(y)
        elif solver.solve(grown, forces, lambda speed: None):
            forces = solver.forces
    return forces


@entry_kernel(
    REAL[:, ::1], REAL[::1], REAL[::1], REAL[::1], REAL[::1], REAL[:, ::1], REAL[::1], REAL[::1], REAL[::1], INTEGER,
    when=CALLED,
)  # fmt: skip
def gauss_seidel_loads(response, normal, tangents, mu, radius_base, radius_rows, along, f, u, passes):
    """Passes of projected Gauss-Seidel over all units; f (3n,) and u = response^T f + base (3n,) are updated."""
    n, rows = mu.shape[0], f.shape[0]
    for _ in range(passes):
        for i in range(n):
            k = 3 * i
            if normal[i] > 0.0 and response[k + 2, k + 2] > 0.0:
                change = max(f[k + 2] - u[k + 2] / response[k + 2, k + 2], 0.0) - f[k + 2]
                if change != 0.0:
                    f[k + 2] += change
                    for j in range(rows):
                        u[j] += change * response[k + 2, j]
            if tangents[i] == 0.0:
                continue
            two = tangents[i] > 1.0
            stiffness = response[k, k]
            if two:
                half = 0.5 * (response[k, k] - response[k + 1, k + 1])
                stiffness = 0.5 * (response[k, k] + response[k + 1, k + 1])
                stiffness += math.sqrt(half * half + response[k, k + 1] ** 2)
            if stiffness <= 0.0:
                continue
            first, second = radius_base[2 * i], radius_base[2 * i + 1]
            for j in range(rows):
                first += radius_rows[2 * i, j] * f[j]
                second += radius_rows[2 * i + 1, j] * f[j]
            radius = mu[i] * math.hypot(first, second)
            p1 = f[k] - u[k] / stiffness
            p2 = f[k + 1] - u[k + 1] / stiffness if two else 0.0
            length = math.hypot(p1, p2)
            shrink = radius / length if length > radius else 1.0
            if along[2 * i] != 0.0 or along[2 * i + 1] != 0.0:
                p1, p2, shrink = along[2 * i], along[2 * i + 1], -radius
            change1 = shrink * p1 - f[k]
            change2 = shrink * p2 - f[k + 1] if two else 0.0
            f[k] += change1
            f[k + 1] += change2
            for j in range(rows):
                u[j] += change1 * response[k, j] + change2 * response[k + 1, j]
