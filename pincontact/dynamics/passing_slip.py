"""Slip that only passes zero, as at the dead centre of a crank: contacts that no force can make stick."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import array_entry
from ..constraints.kinematics import ROW_ROUND_OFF
from ..geometry.small import dot
from ..jit import BOOLEAN, INTEGER, REAL, SEVERAL
from ..layout import EVENT, FRICTIONLESS, JOINT_END, LENGTH, MODE, STICK, TANGENTS, UNILATERAL
from ..linalg import RANK_TOLERANCE, inner, largest_entry, least_norm, orthonormal_basis, subtract_row
from .directions import freeze_slip
from .units import unwhiten, whitened_velocity

if TYPE_CHECKING:
    from .system import System


# Stick that leaves more than this part of the relative acceleration that it has to end cannot be: its rows vanish, or
# other constraints take their place. Exact solutions leave round-off, such ones all of it.
_UNHELD = 1e-6
# What stick may take from the velocity, in the mass metric: this part of it, and this many absolute tolerances: so far
# is slip that counts as ended from zero.
_TAKEN, _TAKEN_TOLERANCES = 1e-3, 1e4
# What errors of steps explain, in tolerances.
EXPLAINED = 1e3
# Relative size below which singular values are zero, as pivots are in `linalg`.
_SINGULAR = math.sqrt(RANK_TOLERANCE)


class PassingSlip:
    """Finds contacts that cannot stick although their slip velocity is zero, and lets them slide on."""

    system: System

    def _let_pass(self, t: float, undecided: list[int], evaluate: Callable[[float], int]) -> dict[int, float]:
        """Let slide on what cannot stick although its v_c is zero, as at the dead centre of a crank; which, with the
        relative acceleration in m/s^2 that it has. The last evaluation is one with all undecided ones sticking.

        There v_c vanishes because of the place, its rows do or are those of other constraints, and no force ends it.
        Its friction does not change that acceleration, which is therefore that without friction.
        """
        system = self.system
        passing: dict[int, float] = {}
        while True:
            c = self._unheld([i for i in undecided if i not in passing])
            if c is None:
                return passing
            system.contact_int[c, MODE] = FRICTIONLESS
            if evaluate(t) > EVENT:
                system.contact_int[c, MODE] = STICK
                evaluate(t)
                return passing
            tangents = int(system.contact_int[c, TANGENTS])
            along = system.rows[c, :tangents] @ system.acceleration + system.bias[c, :tangents]
            freeze_slip(system, c, along)
            passing[c] = float(np.linalg.norm(along))
            evaluate(t)

    def _unheld(self, undecided: list[int]) -> int | None:
        """One of these contacts that cannot stick at the last evaluation's velocity, if there is one."""
        system = self.system
        count = system.counters.row_count
        # resistances to what drives alone turn, too: no joint holds that
        first = system.nc + system.ng
        contacts = [c for c in undecided if c < system.nc or (c >= first and not system.rows[c].any())]
        if not contacts or count == 0:
            return None
        speed = self._speed(system.v)
        if not 0.0 < speed < math.inf:
            return None
        given = system.rows, system.bias, system.row_index[:count], system.acceleration, system.free_acceleration
        # independent rows are held exactly
        if count != system.counters.row_rank and not meets_all(*given):
            for c in contacts:
                motion = self._held_by_others(c), system.free_acceleration, system.v
                tangents, length = system.contact_int.item(c, TANGENTS), system.contact_real.item(c, LENGTH)
                if accelerates(system.rows[c], system.bias[c], *motion, tangents, length):
                    return c
        held = np.zeros(system.items, dtype=np.int64)
        for c in contacts:
            held[c] = system.contact_int.item(c, TANGENTS)
        rows, index = system.whitened_rows[:count], system.row_index[:count]
        scratch = np.empty((count + system.nv + 1, system.nv)), np.empty(count + system.nv)
        order, allowed = np.empty(system.nv, dtype=np.int64), self.negligible(speed)
        found = takes_more(rows, index, held, system.basis, system.slip, allowed, *scratch, order)
        return found if found >= 0 else None

    def _held_by_others(self, c: int) -> np.ndarray:
        """Accelerations (nv,) that meet all constrained rows of the last evaluation but the tangents of contact c, and
        of those what the others leave free. Which rows the evaluation's own leave out depends on their order."""
        system, count = self.system, self.system.counters.row_count
        index, rows = system.row_index[:count], system.whitened_rows[:count]
        own = (index[:, 0] == c) & (index[:, 1] < system.contact_int.item(c, TANGENTS))
        y = whitened_velocity(system, system.free_acceleration)
        way = np.eye(system.nv)
        for part in (~own, own):
            left = -system.bias[index[part, 0], index[part, 1]] - rows[part] @ y
            combined, singular, directions = np.linalg.svd(rows[part] @ way.T)
            kept = int((singular > _SINGULAR * np.linalg.norm(rows[part], axis=1).max(initial=0.0)).sum())
            y = y + (combined.T @ left)[:kept] / singular[:kept] @ directions[:kept] @ way
            way = directions[kept:] @ way
        return unwhiten(system, y)

    def _held_in_vain(self) -> bool:
        """Whether what may open, or a joint coordinate that dry friction holds, takes part in what no acceleration
        gives all constrained rows of the last evaluation: a body that has rolled over an edge onto a face cannot turn
        about the one on the other; and at its dead centre a joint comes to rest because of the place, and others go on.
        Which of the rows the forces leave out depends on their order, so its own acceleration does not tell."""
        system = self.system
        if system.counters.row_count == system.counters.row_rank:
            return False
        joints = {system.nc + g for g in system.held() if system.joint_int[g, JOINT_END] == 0}
        unilateral = {c for c in system.closed() if system.contact_int[c, UNILATERAL]}
        # one alone has nothing beside it
        may_open = unilateral if len(unilateral) > 1 else set()
        if not (joints or may_open):
            return False
        count, nv = system.counters.row_count, system.nv
        index = system.row_index[:count]
        may_go = np.array([c in joints or (row == 2 and c in may_open) for c, row in index.tolist()])
        given = system.rows, system.bias, system.free_acceleration, system.whitened_rows[:count]
        scratch = np.empty((nv, count)), np.empty((count, count)), np.empty((2, count))
        return bool(misses_any(*given, index, may_go, *scratch))

    def _speed(self, v: np.ndarray) -> float:
        """The size of a velocity in the mass metric of the last evaluation, in which half a square is an energy."""
        whitened = whitened_velocity(self.system, v)
        return math.sqrt(whitened.dot(whitened))

    def _of_units(self) -> float:
        """The size, in the mass metric of the last evaluation, of a velocity of 1 in all coordinates that do not move
        each other."""
        return math.sqrt(sum(self.system.mass.diagonal().tolist()))

    def negligible(self, speed: float | None = None) -> float:
        """What constraints may take from a velocity of this size, or else from the present one, in the mass metric of
        the last evaluation."""
        speed = self._speed(self.system.v) if speed is None else speed
        rtol, atol = self.system.scale.tolist()
        return max(max(_TAKEN, rtol) * speed, _TAKEN_TOLERANCES * atol * self._of_units())

    def taken_from(self, before: np.ndarray) -> tuple[float, float]:
        """How far the velocity is from what it was, and how large that was, in the last evaluation's mass metric."""
        return self._speed(self.system.v - before), self._speed(before)

    def explained(self, speed: float) -> float:
        """How far a velocity of this size may be from what it was for errors of steps to explain it, where slips have
        ended: what counts as ended is so far from zero."""
        return EXPLAINED * self.tolerance(speed)

    def tolerance(self, speed: float) -> float:
        """The error that steps may make in a velocity of this size in the mass metric of the last evaluation."""
        rtol, atol = self.system.scale.tolist()
        return rtol * speed + atol * self._of_units()


_MATRIX = REAL[:, ::1]


@array_entry(_MATRIX, *(REAL[::1],) * 4, INTEGER, REAL)
def accelerates(rows, bias, acceleration, free, v, tangents, length):
    """Whether a contact of this length accelerates along its tangents, though these are held: rows (3, nv) and bias
    (3,) of the last evaluation, with its accelerations and those without forces."""
    left, rate, turning = 0.0, 0.0, 0.0
    for row in range(3):
        along, size, speed = bias[row], abs(bias[row]), 0.0
        for k in range(v.shape[0]):
            along += rows[row, k] * acceleration[k]
            size += abs(rows[row, k] * free[k])
            speed += abs(rows[row, k] * v[k])
        if row < tangents:
            left = max(left, abs(along))
        rate, turning = max(rate, size), max(turning, speed)
    # by what forces do and by what turns: either may vanish, and not by round-off of rows that are zero
    rounding = ROW_ROUND_OFF * max(length, 1.0) * (largest_entry(free) + largest_entry(v) ** 2)
    return left > max(_UNHELD * (rate + turning**2 / length), rounding)


@array_entry(REAL[:, :, ::1], _MATRIX, INTEGER[:, ::1], REAL[::1], REAL[::1], when=SEVERAL)
def meets_all(rows, bias, index, acceleration, free):
    """Whether an acceleration (nv,) gives all constrained rows of the last evaluation, of the items and rows of their
    bases in index (count, 2), what they ask for; free (nv,): that without forces."""
    met = True
    for r in range(index.shape[0]):
        c, along, largest = index[r, 0], bias[index[r, 0], index[r, 1]], 0.0
        for k in range(free.shape[0]):
            along += rows[c, index[r, 1], k] * acceleration[k]
        for row in range(3):
            size = abs(bias[c, row])
            for k in range(free.shape[0]):
                size += abs(rows[c, row, k] * free[k])
            largest = max(largest, size)
        met = met and abs(along) <= _UNHELD * largest
    return met


@array_entry(_MATRIX, INTEGER[:, ::1], INTEGER[::1], REAL[:, :, ::1], _MATRIX, REAL, _MATRIX, REAL[::1], INTEGER[::1])
def takes_more(rows, index, held, basis, slip, allowed, matrix, vector, order):
    """The item whose slip is largest for its row, if the least velocity in the mass metric that ends all slips along
    `held` tangents of each item, and leaves the other constrained rows alone, is above what is allowed; else -1.

    rows (count, nv): whitened, of the items and rows of their bases in index (count, 2). matrix (count + nv + 1, nv),
    vector (count + nv,), order (nv,): scratch.
    """
    count, nv, found, most = rows.shape[0], rows.shape[1], -1, 0.0
    wanted, x = vector[:count], vector[count:]
    for r in range(count):
        c, row, length = index[r, 0], index[r, 1], math.sqrt(inner(rows[r], rows[r], nv))
        moves = 0.0 < length < math.inf
        for k in range(nv):
            matrix[r, k] = rows[r, k] / length if moves else 0.0
        wanted[r] = dot(basis[c, row], slip[c]) / length if moves and row < held[c] else 0.0
        if abs(wanted[r]) > most:
            found, most = c, abs(wanted[r])
    least_norm(matrix, wanted, count, nv, x, matrix[count:], order, _SINGULAR)
    return found if found >= 0 and inner(x, x, nv) > allowed * allowed else -1


@array_entry(REAL[:, :, ::1], _MATRIX, REAL[::1], _MATRIX, INTEGER[:, ::1], BOOLEAN[::1], *(_MATRIX,) * 3, when=SEVERAL)
def misses_any(rows, bias, free, whitened, index, may_go, vectors, basis, numbers):
    """Whether no acceleration gives all constrained rows what they ask for, some of those that may go (count,) less
    than that by what is no round-off.

    rows (items, 3, nv), bias (items, 3): of the last evaluation, with the accelerations without forces; whitened
    (count, nv): the constrained ones, of the items and rows of their bases in index (count, 2). vectors (nv, count),
    basis (count, count), numbers (2, count): scratch.
    """
    count, nv, largest = whitened.shape[0], whitened.shape[1], 0.0
    wanted, missed = numbers[0], numbers[1]
    for r in range(count):
        c, row, length = index[r, 0], index[r, 1], math.sqrt(inner(whitened[r], whitened[r], nv))
        moves = 0.0 < length < math.inf
        rate, size = bias[c, row], abs(bias[c, row])
        for k in range(nv):
            vectors[k, r] = whitened[r, k] / length if moves else 0.0
            rate += rows[c, row, k] * free[k]
            size += abs(rows[c, row, k] * free[k])
        missed[r] = wanted[r] = rate / length if moves else 0.0
        largest = max(largest, size / length if moves else 0.0)
    # accelerations give what is in the span of the unit vectors' components
    for i in range(orthonormal_basis(vectors, _SINGULAR, basis)):
        subtract_row(missed, basis[i], inner(basis[i], wanted, count))
    found = False
    for r in range(count):
        found = found or (may_go[r] and abs(missed[r]) > _UNHELD * largest)
    return found
