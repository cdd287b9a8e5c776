"""Newton's method for loads and discs (see `loads`), in unknowns without units."""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..arrays import INTEGERS, REALS, array_entry, item_type
from ..jit import CALLED, INTEGER, REAL, kernel
from ..linalg import RANK_TOLERANCE, inner, largest_entry, least_norm, orthonormal_basis, subtract_row
from ..workspace import by_name
from .cone import COMMON_LIMIT, PAINLEVE_LIMIT

if TYPE_CHECKING:
    from .loads import Loads

# Residual, in units of the largest acceleration without forces, up to which a zero is one.
TOLERANCE = 1e-10
NEWTON_STEPS = 40
# How often one is halved, and by which part of its linear forecast the square of what has to vanish then falls.
_HALVINGS, _FALL = 12, 1e-3

# A normal force: where it is among the unknowns; whether it would not part the bodies by itself; whether it is there:
# UNDECIDED, or 0 or 1.
NORMAL = np.dtype([("place", INTEGERS), ("passive", INTEGERS), ("loaded", INTEGERS)])
UNDECIDED = -1
# A disc: its `count` unknowns begin at `first`; its factor and a, see `loads`; own: its load is the unit's normal
# force, of which there is none below zero; along_1, along_2: the direction of slip, zero where it has none; signed:
# whether its load is one of known direction, along which friction is linear; sign: of that load, or 0 where it is not
# prescribed.
DISC = np.dtype(
    [
        *((name, INTEGERS) for name in ("first", "count", "own", "signed")),
        *((name, REALS) for name in ("factor", "base_1", "base_2", "along_1", "along_2", "sign")),
    ]
)


class Chosen(NamedTuple):
    """Which normal forces are there, and the signs of the loads of the discs that are `signed`."""

    loaded: np.ndarray
    signs: tuple[float, ...]


class ScaledLoads:
    """The problem in unknowns y without units: normal forces and those of discs, in the order of their rows.

    curved: whether equations are not linear where it is known what is loaded; choices: how many loads and signs of
    loads there are to choose.
    """

    def __init__(self, problem: Loads) -> None:
        m = problem.base.size
        sticks = np.where(problem.mu > 0.0, problem.tangents, 0.0)
        present = np.column_stack([sticks > 0.0, sticks > 1.0, problem.normal > 0.0])
        self.rows = np.flatnonzero(present)
        places = np.cumsum(present) - 1
        normals = places[2::3][present[:, 2]]
        diagonal = problem.gram.diagonal().reshape(-1, 3).mean(axis=1)
        scale = np.repeat(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 3)
        self.scale = scale[self.rows]
        self.largest = float(np.abs(problem.base).max(initial=0.0)) or 1.0
        self.unit = unit = float(np.abs(scale * problem.base)[self.rows].max(initial=0.0)) or 1.0
        drag = np.eye(m) if problem.drag is None else problem.drag
        self.expand = drag[:, self.rows] * self.scale
        self.operator = self.scale[:, None] * (problem.gram @ self.expand)[self.rows]
        self.base = self.scale * problem.base[self.rows] / unit
        own = (problem.gram.diagonal() * scale**2)[self.rows][normals]
        share = drag.diagonal()[self.rows][normals]
        own = np.where(share > 0.0, share, 1.0) * own
        self.normals = by_name(np.zeros(normals.size, NORMAL))
        self.normals["place"], self.normals["loaded"] = normals, UNDECIDED
        self.normals["passive"] = self.operator.diagonal()[normals] <= PAINLEVE_LIMIT * own
        units = np.flatnonzero(sticks)
        pairs = (2 * units[:, None] + np.arange(2)).ravel()
        self.radius_rows = problem.radius_rows[pairs] @ self.expand
        self.discs = discs = by_name(np.zeros(units.size, DISC))
        discs["first"], discs["count"] = places[3 * units], sticks[units]
        discs["factor"] = problem.coefficients[units] / scale[3 * units]
        discs["own"] = (problem.normal[units] > 0.0) & (problem.radius_rows[2 * units, 3 * units + 2] == 1.0)
        discs["base_1"], discs["base_2"] = problem.radius_base[pairs].reshape(-1, 2).T / unit
        discs["along_1"], discs["along_2"] = problem.along[pairs].reshape(-1, 2).T
        discs["along_2"][discs["count"] < 2] = 0.0
        slides = (discs["along_1"] != 0.0) | (discs["along_2"] != 0.0)
        discs["signed"] = slides & (discs["base_2"] == 0.0) & ~self.radius_rows[1::2].any(axis=1)
        self.curved = not discs["signed"].all()
        self.choices = normals.size + int(discs["signed"].sum())

    def with_friction(self, share: float) -> ScaledLoads:
        """The same with this share of its friction."""
        result = copy.copy(self)
        result.discs = self.discs.copy()
        result.discs["factor"] *= share
        return result

    def forces(self, y: np.ndarray) -> np.ndarray:
        """(3n,) forces of unknowns."""
        return self.unit * (self.expand @ y)

    def unknowns(self, forces: np.ndarray) -> np.ndarray:
        """The unknowns in forces (3n,) along the problem's rows."""
        return np.nan_to_num(forces[self.rows] / (self.scale * self.unit))

    def newton(
        self, y: np.ndarray, chosen: Chosen | None = None, halved: bool = False, steps: int = NEWTON_STEPS
    ) -> tuple[np.ndarray, float]:
        """The zero that Newton's method comes to from there, and its residual, infinite where that is no solution.

        chosen: loads that are prescribed; halved: whether steps are halved until values fall; steps: at most.
        """
        normals, discs, m = self.normals, self.discs, y.size
        if chosen is not None:
            normals, discs = normals.copy(), discs.copy()
            normals["loaded"] = chosen.loaded
            discs["sign"][discs["signed"] != 0] = chosen.signs
        y = np.array(y)
        room = np.empty((_MATRICES, m, m)), np.empty((_VECTORS, m)), np.empty(m, np.int64)
        return y, find_zero(self.operator, self.base, normals, discs, self.radius_rows, y, steps, halved, *room)

    def residual(self, y: np.ndarray) -> float:
        """How far the unknowns are from a zero."""
        return float(np.abs(self.equations(y)[0]).max(initial=0.0)) / (1.0 + float(np.abs(y).max(initial=0.0)))

    def is_lost(self, y: np.ndarray) -> bool:
        """Whether the operator of what is loaded at a zero has lost positivity: its determinant, positive without
        friction, is negative. From this zero compliances lead away, and as a rule there are others."""
        jacobian = self.equations(y)[1]
        sizes = np.linalg.norm(jacobian, axis=1)
        jacobian = jacobian / np.where(sizes > 0.0, sizes, 1.0)[:, None]
        singular = np.linalg.svd(jacobian, compute_uv=False)
        alone = singular.size and singular[-1] > COMMON_LIMIT * singular[0]
        return bool(alone and np.linalg.slogdet(jacobian)[0] < 0.0)

    def equations(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What has to vanish, and its derivative."""
        values, jacobian = np.empty(y.size), np.empty((y.size, y.size))
        y = np.ascontiguousarray(y)
        given = self.operator, self.base, self.normals, self.discs, self.radius_rows, y
        equations_at(*given, values, jacobian, np.empty(y.size))
        return values, jacobian


@kernel
def radius_at(disc, first_row, second_row, y, slope):
    """The radius of a disc, and its derivative."""
    m = y.shape[0]
    load_1, load_2 = disc.base_1 + inner(first_row, y, m), disc.base_2 + inner(second_row, y, m)
    if disc.sign != 0.0:
        for j in range(m):
            slope[j] = disc.factor * disc.sign * first_row[j]
        return disc.factor * disc.sign * load_1
    length = max(load_1, 0.0) if disc.own != 0 else math.hypot(load_1, load_2)
    share = disc.factor / length if length > 0.0 else 0.0
    for j in range(m):
        slope[j] = share * (load_1 * first_row[j] + load_2 * second_row[j])
    return disc.factor * length


@kernel
def write_equations(operator, base, normals, discs, rows, y, values, jacobian, slope):
    """What has to vanish at the unknowns y, and its derivative; slope (unknowns,): scratch."""
    m = y.shape[0]
    for i in range(m):
        values[i] = inner(operator[i], y, m) + base[i]
        for j in range(m):
            jacobian[i, j] = operator[i, j]
    for k in range(normals.shape[0]):
        i, loaded = normals[k].place, normals[k].loaded != 0
        if normals[k].loaded == UNDECIDED:
            loaded = y[i] - values[i] > 0.0
        if not loaded:
            values[i] = y[i]
            for j in range(m):
                jacobian[i, j] = 1.0 if i == j else 0.0
    for d in range(discs.shape[0]):
        disc = discs[d]
        i, two = disc.first, disc.count > 1
        radius = radius_at(disc, rows[2 * d], rows[2 * d + 1], y, slope)
        if disc.along_1 != 0.0 or disc.along_2 != 0.0:
            for k in range(disc.count):
                along = disc.along_2 if k == 1 else disc.along_1
                values[i + k] = y[i + k] + radius * along
                for j in range(m):
                    jacobian[i + k, j] = along * slope[j] + (1.0 if i + k == j else 0.0)
            continue
        p_1 = y[i] - values[i]
        p_2 = y[i + 1] - values[i + 1] if two else 0.0
        # no square of what diverges
        size = math.hypot(p_1, p_2)
        if size <= radius:
            continue
        along_1, along_2, turn = p_1 / size, p_2 / size, radius / size
        values[i] = y[i] - radius * along_1
        if two:
            values[i + 1] = y[i + 1] - radius * along_2
        for j in range(m):
            one_1, one_2 = 1.0 if i == j else 0.0, 1.0 if i + 1 == j else 0.0
            moved_1 = one_1 - operator[i, j]
            moved_2 = one_2 - operator[i + 1, j] if two else 0.0
            # what turns the force, across p; along it moves with the radius
            across = turn * (along_1 * moved_2 - along_2 * moved_1)
            jacobian[i, j] = one_1 + across * along_2 - along_1 * slope[j]
            if two:
                jacobian[i + 1, j] = one_2 - across * along_1 - along_2 * slope[j]


@kernel
def _residual(values, y):
    """How far unknowns are from a zero; infinite where values are not finite."""
    largest = 0.0
    for i in range(y.shape[0]):
        if not math.isfinite(values[i]):
            return math.inf
        largest = max(largest, abs(values[i]))
    return largest / (1.0 + largest_entry(y))


@kernel
def _admissible(operator, base, normals, discs, rows, y, slope):
    """Whether nothing pulls or closes; a contact whose own force would not part the bodies carries nothing."""
    m, small = y.shape[0], TOLERANCE * (1.0 + largest_entry(y))
    for d in range(discs.shape[0]):
        if discs[d].sign != 0.0 and not radius_at(discs[d], rows[2 * d], rows[2 * d + 1], y, slope) >= -small:
            return False
    for k in range(normals.shape[0]):
        i = normals[k].place
        if not (y[i] >= -small and inner(operator[i], y, m) + base[i] >= -small):
            return False
        if normals[k].passive != 0 and y[i] > small:
            return False
    return True


@kernel
def _least_squares(matrices, values, change, scratch, shares, order):
    """The least change (m,) of those that leave the least of the values by a Jacobian, the first of the matrices, which
    is singular: in orthonormal bases of what its rows and its columns span it is regular."""
    m, jacobian, other, of_rows, of_columns = change.shape[0], matrices[0], matrices[1], matrices[2], matrices[3]
    for i in range(m):
        for j in range(m):
            other[i, j] = jacobian[i, j]
    rank = orthonormal_basis(other, RANK_TOLERANCE, of_rows)
    for i in range(m):
        for j in range(m):
            other[i, j] = jacobian[j, i]
    rank = min(rank, orthonormal_basis(other, RANK_TOLERANCE, of_columns))
    for i in range(rank):
        scratch[i] = -inner(of_columns[i], values, m)
        for j in range(m):
            shares[j] = 0.0
        for k in range(m):
            subtract_row(shares, jacobian[k], -of_columns[i, k])
        for j in range(rank):
            other[i, j] = inner(shares, of_rows[j], m)
    least_norm(other, scratch, rank, rank, shares, jacobian, order, 0.0)
    for j in range(m):
        change[j] = 0.0
    for i in range(rank):
        subtract_row(change, of_rows[i], -shares[i])


_MATRIX, _VECTOR = REAL[:, ::1], REAL[::1]
_PROBLEM = _MATRIX, _VECTOR, item_type(NORMAL)[::1], item_type(DISC)[::1], _MATRIX
_MATRICES, _VECTORS = 4, 5


@array_entry(*_PROBLEM, _VECTOR, _VECTOR, _MATRIX, _VECTOR, when=CALLED)
def equations_at(operator, base, normals, discs, rows, y, values, jacobian, slope):
    """See `ScaledLoads.equations`."""
    write_equations(operator, base, normals, discs, rows, y, values, jacobian, slope)


@array_entry(*_PROBLEM, _VECTOR, INTEGER, INTEGER, REAL[:, :, ::1], _MATRIX, INTEGER[::1], when=CALLED)
def find_zero(operator, base, normals, discs, rows, y, steps, halved, matrices, vectors, order):
    """See `ScaledLoads.newton`: y is overwritten, the residual returned. matrices (_MATRICES, m, m), vectors
    (_VECTORS, m), order (m,): scratch for m unknowns."""
    m, jacobian, gram = y.shape[0], matrices[0], matrices[1]
    values, change, there, best, slope = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    least, linear = math.inf, True
    for k in range(normals.shape[0]):
        linear = linear and normals[k].loaded != UNDECIDED
    for d in range(discs.shape[0]):
        linear = linear and discs[d].sign != 0.0
    for j in range(m):
        best[j] = y[j]
    for step in range(steps):
        write_equations(operator, base, normals, discs, rows, y, values, jacobian, slope)
        residual = _residual(values, y)
        if residual == math.inf:
            break
        if residual < least:
            least = residual
            for j in range(m):
                best[j] = y[j]
            if residual <= 1e-3 * TOLERANCE:
                break
        elif least <= TOLERANCE:
            break
        size = inner(values, values, m)
        for j in range(m):
            values[j] = -values[j]
        if least_norm(jacobian, values, m, m, change, gram, order, RANK_TOLERANCE) < m:
            write_equations(operator, base, normals, discs, rows, y, values, jacobian, slope)
            _least_squares(matrices, values, change, there, slope, order)
        part = 1.0
        for _ in range(_HALVINGS if halved != 0 else 0):
            for j in range(m):
                there[j] = y[j] + part * change[j]
            write_equations(operator, base, normals, discs, rows, there, values, jacobian, slope)
            if inner(values, values, m) < (1.0 - _FALL * part) * size:
                break
            part *= 0.5
        for j in range(m):
            y[j] += part * change[j]
        if linear and step == 1:
            break
    for j in range(m):
        y[j] = best[j]
    return least if _admissible(operator, base, normals, discs, rows, y, slope) else math.inf
