"""The contact problem of an evaluated state, of accelerations (modes) or of velocities (impacts).

Units are cones, discs or loads: three columns L^-T row^T in the order (t1, t2, n), zero where the unit has no such row.
Normals of bilateral contacts, and their tangents where these cannot slip, are equations E y = w, which are eliminated:
with S the units' columns, y = E^+ w + (1 - E^+ E) S F, and the equations' multipliers are E^+T (E^+ w - S F). The
friction of a bilateral contact is a unit without normal force, a disc whose radius goes with the length of its normals'
multipliers, whatever their signs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy

from ..friction.loads import Loads
from ..geometry.patterns import ON_CURVE
from ..layout import ANISOTROPIC, PATTERN, TANGENTS, UNILATERAL
from .friction_scaling import friction_scaling

if TYPE_CHECKING:
    from .system import System

# Equations that combine to less than this, relative to their size, are redundant, and of units what they leave of less.
REDUNDANT = 1e-9
# Multiplications up to which BLAS does a product in one thread.
_ALONE = 2**17


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
    """(nv,) L v, half of whose square is the kinetic energy of v. Above its diagonal the factor is zero."""
    # of so few numbers the operator @ takes twice as long
    whitened: np.ndarray = system.factor.dot(v)
    return whitened


class ContactProblem:
    """u = G F + b of contacts, joint coordinates and resistances to turning, without what equations decide.

    relative(item, rows): what moves along these rows of an item without forces, velocities or accelerations. After
    `add` and `add_contacts`, `assemble` makes, for n units and m equations: stack, reduced (nv, 3n), columns before and
    after elimination; before, base (3n,); start (nv,), what equations alone do; equations, multipliers (m, nv), E and
    E^+T; gram, weights as `delassus`; mu, normal, tangents (n,); impossible: whether equations close a contact.

    units: item -> its unit; normals: bilateral contact -> equations of its normals; shapes: unit -> scaling of its
    friction ellipse (`friction_scaling`), in whose coordinates its cone is round; radii: unit -> constant radius;
    slides: unit -> (2,) direction of its friction; lifted: unit -> (2,) tangential force by which alone it is held up.
    """

    def __init__(self, system: System, relative: Callable[[int, list[int]], np.ndarray]) -> None:
        self.system, self.relative = system, relative
        self.units: dict[int, int] = {}
        self.normals: dict[int, list[int]] = {}
        self.shapes: dict[int, np.ndarray] = {}
        self.radii: dict[int, float] = {}
        self.slides: dict[int, np.ndarray] = {}
        self.lifted: dict[int, np.ndarray] = {}
        self._rows_of_equations: list[tuple[int, int]] = []
        self._columns: list[np.ndarray] = []
        self._before: list[np.ndarray] = []
        self._mu: list[float] = []
        # of each unit: rows of its item, which rows of the unit they are, and whether they are turned round
        self._places: list[tuple[list[int], list[int], float]] = []

    def add(self, item: int, rows: Sequence[int], mu: float, sign: float = 1.0, places: Sequence[int] = ()) -> int:
        """Add a unit of these rows of an item, turned round by a sign of -1; returns which one it is. places: which
        rows of the unit they are, if others."""
        system, unit, rows, places = self.system, len(self._mu), list(rows), list(places or rows)
        columns, before = np.zeros((system.nv, 3)), np.zeros(3)
        columns[:, places] = sign * whiten(system, system.rows[item, rows].T)
        before[places] = sign * self.relative(item, rows)
        if item < system.nc and system.contact_int[item, ANISOTROPIC]:
            self.shapes[unit] = shape = friction_scaling(system, item)
            columns[:, :2], before[:2] = columns[:, :2] @ shape, shape @ before[:2]
        self.units[item] = unit
        self._columns.append(columns)
        self._before.append(before)
        self._mu.append(mu)
        self._places.append((rows, places, sign))
        return unit

    def add_contacts(self, closed: Collection[int], mu: np.ndarray) -> None:
        """Add these contacts and their resistances to turning. mu (items,): coefficients up to which friction holds."""
        system, integers = self.system, self.system.contact_int
        for c in closed:
            rows, limit = contact_rows(integers[c, TANGENTS]), float(mu[c])
            if integers[c, UNILATERAL]:
                self.add(c, rows if limit > 0.0 else (2,), limit)
                continue
            normals = [1, 2] if integers[c, PATTERN] == ON_CURVE else [2]
            tangents = [row for row in rows if row not in normals]
            first = len(self._rows_of_equations)
            self.normals[c] = list(range(first, first + len(normals)))
            self._rows_of_equations += [(c, row) for row in normals + (tangents if math.isinf(limit) else [])]
            if 0.0 < limit < math.inf:
                self.add(c, tangents, limit)
        for item in system.resisting():
            if system.owner(item) in closed:
                self.add(item, range(integers[item, TANGENTS]), float(mu[item]))

    def assemble(self) -> None:
        """Eliminate the equations from the units."""
        system, nv = self.system, self.system.nv
        self.stack = np.concatenate(self._columns, axis=1) if self._columns else np.zeros((nv, 0))
        self.before, self.mu = np.array(self._before).reshape(-1), np.array(self._mu)
        self.normal = np.array([float(places.count(2)) for _, places, _ in self._places])
        self.tangents = np.array([float(len(places)) for _, places, _ in self._places]) - self.normal
        self.reduced, self.start, self.base = self.stack, np.zeros(nv), self.before.copy()
        self.impossible = False
        equations = self._rows_of_equations
        self.equations = np.array([whiten(system, system.rows[c, row]) for c, row in equations]).reshape(-1, nv)
        if equations:
            left, singular, right = np.linalg.svd(self.equations, full_matrices=False)
            kept = singular > REDUNDANT * singular[0]
            basis = right[kept]
            self.multipliers = left[:, kept] / singular[kept] @ basis
            self.start = -np.array([self.relative(c, [row])[0] for c, row in equations]) @ self.multipliers
            self.base += self.stack.T @ self.start
            self.reduced = self.stack - basis.T @ (basis @ self.stack)
            # what equations decide is what they leave to round-off
            decided = np.linalg.norm(self.reduced, axis=0) <= REDUNDANT * np.linalg.norm(self.stack, axis=0)
            self.reduced[:, decided] = 0.0
            terms = np.abs(self.before) + np.abs(self.stack).T @ np.abs(self.start)
            self.base[decided & (np.abs(self.base) <= REDUNDANT * terms)] = 0.0
            self.impossible = bool((self.base[2::3] < 0.0)[decided[2::3]].any())
        self.gram, self.weights = delassus(self.reduced)

    @property
    def is_cone(self) -> bool:
        """Whether it is a cone problem: every disc's radius is a multiple of its unit's normal force, or constant."""
        lone = sum(n == 0.0 and t > 0.0 for n, t in zip(self.normal.tolist(), self.tangents.tolist()))
        return not self.slides and not self.lifted and lone == len(self.radii)

    def cone_problem(self, base: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The cone problem with this base in which units without normal force have radii (n,): a force of their own
        that makes up for a load."""
        base, lone = base.copy(), self.normal == 0.0
        base[2::3][lone] = -radii[lone] * self.weights[2::3][lone]
        return self.gram, base, np.where(lone & (self.tangents > 0.0), 1.0, self.mu)

    def loads(self) -> Loads:
        """The problem with the loads of all discs as functions of the forces."""
        system, n = self.system, self.mu.size
        mu, drag, directions = self.mu.copy(), np.eye(3 * n), np.zeros(2 * n)
        radius_base, radius_rows = np.zeros((n, 2)), np.zeros((n, 2, 3 * n))
        for item, u in self.units.items():
            c, k = system.owner(item), 3 * u
            if u in self.radii:
                mu[u], radius_base[u, 0] = 1.0, self.radii[u]
            elif c in self.normals:
                places = self.normals[c]
                radius_base[u, : len(places)] = self.multipliers[places] @ self.start
                radius_rows[u, : len(places)] = -self.multipliers[places] @ self.stack
            elif c in self.units:
                radius_rows[u, 0, 3 * self.units[c] + 2] = self.normal[self.units[c]]
            if u in self.lifted:
                drag[k : k + 2, k + 2], drag[k + 2, k + 2], mu[u] = self.lifted[u], 0.0, 0.0
            elif u in self.slides and self.normal[u]:
                drag[k : k + 2, k + 2], mu[u] = -mu[u] * self.slides[u], 0.0
            elif u in self.slides:
                directions[2 * u : 2 * u + 2] = self.slides[u]
        rows = radius_rows.reshape(2 * n, -1)
        return Loads(self.gram, self.base, self.normal, self.tangents, mu, radius_base.ravel(), rows, drag, directions)

    def parents(self) -> np.ndarray:
        """(n,) units whose normal forces limit the others: their own, or that of their contact; -1 where equations
        do."""
        owners = [self.system.owner(item) for item in self.units]
        found = np.array([self.units.get(c, -1) for c in owners], dtype=int)
        return np.where((found >= 0) & (self.normal[found] > 0.0), found, -1)

    def of_items(self, values: np.ndarray, forces: bool) -> np.ndarray:
        """(items, 3) forces or velocities along the rows of items, from those of the units (3n,)."""
        out = np.zeros((self.system.items, 3))
        if forces:
            values = np.where(self.weights > 0.0, 0.0, values)
        for item, u in self.units.items():
            (rows, places, sign), value = self._places[u], values[3 * u : 3 * u + 3].copy()
            if u in self.shapes:
                shape = self.shapes[u] if forces else np.linalg.inv(self.shapes[u])
                value[:2] = shape @ value[:2]
            out[item, rows] = sign * value[places]
        if forces and self.normals:
            items, rows = np.array(self._rows_of_equations).T
            out[items, rows] = self.multipliers @ (self.start - self.stack @ values)
        return out

    def of_units(self, forces: np.ndarray) -> np.ndarray:
        """(3n,) forces of the units, from those along the rows of items (items, 3)."""
        out = np.zeros((self.mu.size, 3))
        for item, u in self.units.items():
            rows, places, sign = self._places[u]
            out[u, places] = sign * forces[item, rows]
            if u in self.shapes:
                out[u, :2] = np.linalg.solve(self.shapes[u], out[u, :2])
        return out.reshape(-1)


def relative_velocity(system: System, item: int, rows: list[int]) -> np.ndarray:
    """v_c of a contact along these rows of its basis, what a resistance turns with, or a joint coordinate's velocity,
    which is its third number, from the last evaluation."""
    on_joint = system.nc <= item < system.nc + system.ng
    speeds: np.ndarray = system.slip[item, rows] if on_joint else system.basis[item, rows] @ system.slip[item]
    return speeds


def contact_rows(tangents: int) -> tuple[int, ...]:
    """Rows of a contact with this many tangents."""
    return (0, 2) if tangents == 1 else (0, 1, 2)


def delassus(stack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3n, 3n) Delassus matrix of n units, and (3n,) the diagonal's weights of rows that are missing, else 0.

    A missing row becomes an isolated one as heavy as the unit's real ones, since the solver scales by their mean.
    """
    gram = _products(stack)
    diagonal, weights = gram.diagonal().tolist(), np.zeros(len(gram))
    for i, own in enumerate(diagonal):
        if own == 0.0:
            first = i - i % 3
            gram[i, i] = weights[i] = max(diagonal[first : first + 3]) or 1.0
    return gram, weights


def _products(stack: np.ndarray) -> np.ndarray:
    """(n, n) products of n columns, many of which may be zero: those of joints have one row of three. BLAS does small
    ones alone; for large ones it starts threads that turn idly for longer than all takes."""
    nv, n = stack.shape
    if nv * n * n <= _ALONE:
        return stack.T @ stack
    out, real = np.zeros((n, n)), np.flatnonzero(stack.any(axis=0))
    columns = np.ascontiguousarray(stack[:, real])
    count = max(_ALONE // (nv * max(real.size, 1)), 1)
    for k in range(0, real.size, count):
        out[np.ix_(real[k : k + count], real)] = columns[:, k : k + count].T @ columns
    return out
