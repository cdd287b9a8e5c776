"""Contacts and discs whose radii follow from the forces, as one generalised equation.

Unknowns are the forces F (3n,) of n units with rows (t1, t2, n), and u = G F + b. A unit is a contact, with a normal
force N >= 0, u_n >= 0, N u_n = 0, or has none. Every unit has a disc for its tangential force T, of radius

    mu |a + B F|,    a (2,) and B (2, 3n) constant:

mu N for a contact, a length times the contact's N for its resistance to turning, mu times the force of eliminated
equations for a bilateral contact, a number for dry friction. With the projections on N >= 0 and on the discs, F is a
solution where F = P(F - u) in all units at once.

Projected Gauss-Seidel comes near, whatever it starts from; Newton's method for the same equations (`loads`) ends at
round-off. With radii that are given and do not change both solve a convex problem. It has a solution whatever the
radii, unless bodies are crushed, and that takes energy: the work F . (b + G F / 2) is the least there is, at most that
of no forces, zero. So where friction leaves no solution, or none is found, there is one for the radii of the last
forces (`solve_with_radii`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..jit import CALLED, INTEGER, REAL, entry_kernel
from .cone import LARGEST_FRICTION, OPEN, SLIP, STICK
from .loads import TOLERANCE, Disk, Loads, ScaledLoads

# Sweeps before every try of Newton's method.
_SWEEPS = (20, 100, 500, 2500)
# With given radii, which need no more than patience.
_SETTLING = (100, 1000, 5000)
# Residual up to which forces of given radii are taken.
SETTLED = 1e-6


@dataclass
class Product:
    """The problem. gram (3n, 3n), base (3n,); normal (n,): which units have a normal force; tangents (n,): how many
    tangential ones, 0, 1 or 2; mu (n,); radius_base (2n,), radius_rows (2n, 3n): a and B, by twos. Other rows have no
    force. All are C-contiguous float64."""

    gram: np.ndarray
    base: np.ndarray
    normal: np.ndarray
    tangents: np.ndarray
    mu: np.ndarray
    radius_base: np.ndarray
    radius_rows: np.ndarray

    def solve(self, forces: np.ndarray) -> tuple[np.ndarray, float]:
        """Forces (3n,) from those given, and their residual: above `loads.TOLERANCE` that is no solution."""
        return self._search(forces, _SWEEPS)

    def refine(self, forces: np.ndarray) -> tuple[np.ndarray, float]:
        """The solution (3n,) that Newton's method comes to from forces near to it, and its residual."""
        scaled = ScaledLoads(self._loads())
        y, residual = scaled.newton(scaled.unknowns(forces), None)
        return scaled.forces(y), residual

    def solve_with_radii(self, forces: np.ndarray) -> tuple[np.ndarray, float, float]:
        """Forces (3n,) for the radii that these have, their residual, and how far the radii are from those of the
        result, relative to the largest."""
        radii = self.radii(forces)
        given = Product(
            self.gram,
            self.base,
            self.normal,
            self.tangents,
            np.ones_like(self.mu),
            np.stack([radii, np.zeros_like(radii)], axis=1).ravel(),
            np.zeros_like(self.radius_rows),
        )
        found, residual = given._search(forces, _SETTLING)
        off = np.abs(self.radii(found) - radii).max(initial=0.0) / (float(radii.max(initial=0.0)) or 1.0)
        return found, residual, float(off)

    def radii(self, forces: np.ndarray) -> np.ndarray:
        """(n,) of the discs at forces (3n,)."""
        loads = np.linalg.norm((self.radius_base + self.radius_rows @ forces).reshape(-1, 2), axis=1)
        return np.where(loads > 0.0, np.minimum(self.mu, LARGEST_FRICTION), 0.0) * loads

    def modes(self, forces: np.ndarray) -> np.ndarray:
        """(n,) OPEN: no normal force, or no radius where there is none; SLIP: on the disc's rim; else STICK."""
        velocities, radii = self.gram @ forces + self.base, self.radii(forces)
        modes = np.full(self.mu.size, STICK)
        for i, count in enumerate(self.tangents.astype(int)):
            k = 3 * i
            if (forces[k + 2] if self.normal[i] else radii[i]) <= 0.0:
                modes[i] = OPEN
                continue
            weight = float(self.gram.diagonal()[k : k + 3].max()) or 1.0
            aim = forces[k : k + count] - velocities[k : k + count] / weight
            if self.mu[i] == 0.0 or float(np.linalg.norm(aim)) > radii[i] * (1.0 + TOLERANCE):
                modes[i] = SLIP
        return modes

    def _search(self, forces: np.ndarray, rounds: tuple[int, ...]) -> tuple[np.ndarray, float]:
        """The best of what sweeps and Newton's method come to, and its residual."""
        scaled = ScaledLoads(self._loads())
        f = np.zeros_like(forces)
        for i, count in enumerate(self.tangents.astype(int)):
            f[3 * i : 3 * i + count] = forces[3 * i : 3 * i + count]
            f[3 * i + 2] = forces[3 * i + 2] if self.normal[i] else 0.0
        best, least = f.copy(), math.inf
        for sweeps in rounds:
            u = self.gram @ f + self.base
            gauss_seidel_product(
                self.gram, self.normal, self.tangents, self.mu, self.radius_base, self.radius_rows, f, u, sweeps
            )
            if not np.isfinite(f).all():
                break
            y, residual = scaled.newton(scaled.unknowns(f), None)
            swept = scaled.residual(scaled.unknowns(f))
            if residual <= TOLERANCE:
                return scaled.forces(y), residual
            if swept <= least:
                best, least = f.copy(), swept
        return best, least

    def _loads(self) -> Loads:
        n = self.mu.size
        problem = Loads(self.gram, self.base, [3 * i + 2 for i in range(n) if self.normal[i]])
        for i, count in enumerate(self.tangents.astype(int)):
            if count and self.mu[i] > 0.0:
                load = self.radius_base[2 * i : 2 * i + 2], self.radius_rows[2 * i : 2 * i + 2]
                own = 3 * i + 2 if self.normal[i] and load[1][0, 3 * i + 2] == 1.0 else None
                problem.disks.append(Disk([3 * i + j for j in range(count)], float(self.mu[i]), own, load=load))
        return problem


@entry_kernel(
    REAL[:, ::1], REAL[::1], REAL[::1], REAL[::1], REAL[::1], REAL[:, ::1], REAL[::1], REAL[::1], INTEGER, when=CALLED
)  # fmt: skip
def gauss_seidel_product(gram, normal, tangents, mu, radius_base, radius_rows, f, u, sweeps):
    """Passes of projected Gauss-Seidel over all units; f (3n,) and u = gram f + base (3n,) are updated."""
    n, rows = mu.shape[0], f.shape[0]
    for _ in range(sweeps):
        for i in range(n):
            k = 3 * i
            if normal[i] > 0.0 and gram[k + 2, k + 2] > 0.0:
                change = max(f[k + 2] - u[k + 2] / gram[k + 2, k + 2], 0.0) - f[k + 2]
                if change != 0.0:
                    f[k + 2] += change
                    for j in range(rows):
                        u[j] += change * gram[k + 2, j]
            if tangents[i] == 0.0:
                continue
            two = tangents[i] > 1.0
            stiffness = gram[k, k]
            if two:
                half = 0.5 * (gram[k, k] - gram[k + 1, k + 1])
                stiffness = 0.5 * (gram[k, k] + gram[k + 1, k + 1]) + math.sqrt(half * half + gram[k, k + 1] ** 2)
            if stiffness <= 0.0:
                continue
            first, second = radius_base[2 * i], radius_base[2 * i + 1]
            for j in range(rows):
                first += radius_rows[2 * i, j] * f[j]
                second += radius_rows[2 * i + 1, j] * f[j]
            radius = min(mu[i], LARGEST_FRICTION) * math.hypot(first, second)
            p1 = f[k] - u[k] / stiffness
            p2 = f[k + 1] - u[k + 1] / stiffness if two else 0.0
            length = math.hypot(p1, p2)
            shrink = radius / length if length > radius else 1.0
            change1 = shrink * p1 - f[k]
            change2 = shrink * p2 - f[k + 1] if two else 0.0
            f[k] += change1
            f[k + 1] += change2
            for j in range(rows):
                u[j] += change1 * gram[k, j] + change2 * gram[k + 1, j]
