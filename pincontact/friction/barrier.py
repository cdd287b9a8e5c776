"""The analytic centre of forces inside cones, of which `centred` makes the choice among redundant ones.

Forces F = least + unit N^T z, with rows N that move nothing, are sought at the lowest point of the cones' logarithmic
barriers and |z|^2 / 2, from inside (`minimise`). What gets there (`enter`) lowers the amount by which all cones are
enlarged, the variable after z, until it is negative. Both are Newton's method.
"""

from __future__ import annotations

import math

from ..arrays import array_entry
from ..jit import REAL, SEVERAL, kernel
from ..linalg import RANK_TOLERANCE, factor_definite, inner, orthonormal_basis, solve_definite, subtract_row
from .cone import cone_step
from .least_loads import FIXED

_NEWTON_STEPS = 60
_CONVERGED = 1e-9
# Forces count as admissible if they are inside their cones by this fraction of the largest force.
INSIDE = 1e-9
# Part of the way to the nearest boundary that a step may go.
TO_BOUNDARY = 0.95
# Steps are shortened to this part at least.
_SHORTEST = 1e-15
# By how much the pressure grows that lowers the enlargement.
_SHARPENING = 8.0
# Least size of cones enlarged at first, in units of the forces.
_OFF_TIPS = 1e-3
# Size of the forces of interest, relative to those of least norm.
_LARGEST = 1e3
# Directions that others combine to but for this part are no directions of their own.
_RANK = 1e-12
# A null direction: unit rows that combine to less than this.
_NULL = math.sqrt(RANK_TOLERANCE)
# Rows of scratch of `centre`.
SLOPE, CHANGE, AFTER, CONES, WAY, POINT, ALONG, START = range(8)
SCRATCH_ROWS = 8


@kernel
def barrier_derivatives(rows, x, n, slope, hessian):
    """Slope (n,) and Hessian (n, n), its lower triangle, of the barriers by the first n variables, at (s, t1, t2) x."""
    for i in range(n):
        slope[i] = 0.0
        for j in range(i + 1):
            hessian[i, j] = 0.0
    for a in range(0, x.shape[0], 3):
        length = math.hypot(x[a + 1], x[a + 2])
        # s^2 - |t|^2 without the cancellation near the boundary
        inside = (x[a] - length) * (x[a] + length)
        s, t1, t2 = -2.0 * x[a] / inside, 2.0 * x[a + 1] / inside, 2.0 * x[a + 2] / inside
        for i in range(n):
            first, second, third = rows[a, i], rows[a + 1, i], rows[a + 2, i]
            along = s * first + t1 * second + t2 * third
            slope[i] += along
            for j in range(i + 1):
                bent = first * rows[a, j] - second * rows[a + 1, j] - third * rows[a + 2, j]
                other = s * rows[a, j] + t1 * rows[a + 1, j] + t2 * rows[a + 2, j]
                hessian[i, j] += along * other - 2.0 / inside * bent


@kernel
def way_inside(x, dx):
    """Largest step along dx (3 m,) from x (3 m,) that stays inside all cones, at most 1 / `TO_BOUNDARY`."""
    way = 1.0 / TO_BOUNDARY
    for i in range(0, x.shape[0], 3):
        way = min(way, cone_step(x[i + 1], x[i + 2], x[i], dx[i + 1], dx[i + 2], dx[i]))
    return way


@kernel
def stiffness(pressure):
    """Weight of the square: on the way into the cones, under pressure, one that holds back no forces of interest."""
    return 1.0 if pressure == 0.0 else _LARGEST**-2


@kernel
def cost(x, point, k, pressure):
    """Barriers of (s, t1, t2) in x + `stiffness` |z|^2 / 2 + pressure times the enlargement, of a point; infinite
    outside."""
    total = pressure * point[k]
    for a in range(0, x.shape[0], 3):
        length = math.hypot(x[a + 1], x[a + 2])
        if not x[a] > length:
            return math.inf
        total -= math.log((x[a] - length) * (x[a] + length))
    return total + 0.5 * stiffness(pressure) * inner(point, point, k)


@kernel
def place(rows, start, point, n, x):
    """The (s, t1, t2) of all cones at a point of n variables."""
    for a in range(x.shape[0]):
        x[a] = start[a] + inner(rows[a], point, n)


@kernel
def minimise(rows, start, point, k, pressure, hessian, scratch):
    """Newton with backtracking from a point (z, enlargement), which is overwritten, to the lowest cost, or until the
    enlargement is negative. With pressure 0 that stays."""
    free, weight = k + 1 if pressure > 0.0 else k, stiffness(pressure)
    slope, step, after = scratch[SLOPE], scratch[CHANGE], scratch[AFTER]
    x, dx = scratch[CONES, : start.shape[0]], scratch[WAY, : start.shape[0]]
    for _ in range(_NEWTON_STEPS):
        place(rows, start, point, k + 1, x)
        before, lower = cost(x, point, k, pressure), False
        barrier_derivatives(rows, x, free, slope, hessian)
        slope[k] = slope[k] + pressure if free > k else 0.0
        step[k] = -slope[k]
        for i in range(k):
            slope[i] += weight * point[i]
            hessian[i, i] += weight
            step[i] = -slope[i]
        factor_definite(hessian, free)
        solve_definite(hessian, free, step)
        decrement = -inner(slope, step, free)
        # so near the rim that round-off decides there is no number; the last step leaves the square of itself
        last = not decrement > _CONVERGED
        lower = last and decrement > 0.0
        for a in range(x.shape[0]):
            dx[a] = inner(rows[a], step, k + 1)
        size = 1.0 if last else TO_BOUNDARY * way_inside(x, dx)
        while not lower and size > _SHORTEST and not last:
            for i in range(k + 1):
                after[i] = point[i] + size * step[i]
            place(rows, start, after, k + 1, x)
            lower = cost(x, after, k, pressure) <= before - 0.1 * size * decrement
            size *= 1.0 if lower else 0.5
        for i in range(free if lower else 0):
            point[i] += size * step[i]
        if last or not lower or (pressure > 0.0 and point[k] < -INSIDE):
            return


@kernel
def enter(rows, start, point, k, hessian, scratch):
    """Move a point (z, 0) into all cones (phase one); False where there is no such point."""
    x, count, lowest, size = scratch[CONES, : start.shape[0]], start.shape[0] // 3, math.inf, 0.0
    place(rows, start, point, k + 1, x)
    for a in range(0, 3 * count, 3):
        value = x[a] - math.hypot(x[a + 1], x[a + 2])
        lowest = min(lowest, value)
        size += abs(value)
    if lowest > INSIDE:
        return True
    # as far outside as the others are inside: the steps to come are of that size; not so near to the tips of all cones
    # that the square is round-off beside the barriers
    point[k] = max(size / count, _OFF_TIPS) - lowest
    pressure = 2.0 * count / point[k]
    while True:
        minimise(rows, start, point, k, pressure, hessian, scratch)
        if point[k] < -INSIDE:
            point[k] = 0.0
            return True
        # the least enlargement is lower by no more than the number of logarithms (and the square's part in the
        # balance, for forces of interest) over the pressure
        size = math.sqrt(inner(point, point, k))
        within = (2.0 * count + stiffness(pressure) * max(size * (_LARGEST - size), 0.0)) / pressure
        if not (point[k] <= within and within >= INSIDE):
            return False
        pressure *= _SHARPENING


@kernel
def tangent(rows, start, point, k, spanned, hessian, scratch, slope):
    """slope (n - k, n - k or more): in its rows what z does, in its unit, as forces grow along each direction that does
    something; spanned (n - k,): by how much the unit does. False on the rim, where round-off decides."""
    m, rest = start.shape[0], spanned.shape[0]
    n, x, by = k + 1 + rest, scratch[CONES, :m], scratch[SLOPE]
    place(rows, start, point, k + 1, x)
    barrier_derivatives(rows, x, n, by, hessian)
    for j in range(rest):
        for i in range(k):
            slope[j, i] = 2.0 * point[i] * spanned[j] - hessian[k + 1 + j, i]
    for i in range(k):
        hessian[i, i] += 1.0
    factor_definite(hessian, k)
    for j in range(rest):
        solve_definite(hessian, k, slope[j])
    return hessian[k - 1, k - 1] > 0.0


_VECTOR, _MATRIX = REAL[::1], REAL[:, ::1]


@array_entry(_VECTOR, _MATRIX, _MATRIX, _VECTOR, _MATRIX, _MATRIX, _MATRIX, _MATRIX, _MATRIX, when=SEVERAL)
def centre(forces, null, parts, offsets, basis, rows, hessian, scratch, slope):
    """Move forces (n,) along the rows of null (c, n) to the analytic centre of m cones s > |t|, (s, t1, t2) = parts
    (3 m, n) forces + offsets (3 m,); returns the number k of directions among these rows, or 0 where there is none, or
    no centre.

    basis (n, n): orthonormal rows, the first k of them those directions; slope (n, n): in row j by how much the centre
    moves along each of these as forces grow along row k + j of the basis.
    null, rows (3 m, n + 1), hessian (n + 1, n + 1), scratch (SCRATCH_ROWS, at least n + 1 and 3 m): are
    overwritten.
    """
    n, m = forces.shape[0], offsets.shape[0]
    k = orthonormal_basis(null, _RANK, basis)
    largest, size = 0.0, 0.0
    for i in range(n):
        largest = max(largest, abs(forces[i]))
    for j in range(k, n):
        size += inner(basis[j], forces, n) ** 2
    # about the least norm, in its units: the centre then is one of the loads alone, whatever was chosen before; where
    # that is next to nothing, bounds of forces are of interest, too
    for a in range(m):
        size += (offsets[a] / _LARGEST) ** 2
    unit = math.sqrt(size)
    if unit <= INSIDE * largest:
        unit = largest
    if k == 0 or unit == 0.0:
        return 0
    point, along, start = scratch[POINT], scratch[ALONG], scratch[START, :m]
    for j in range(n):
        along[j] = inner(basis[j], forces, n) / unit
        column = j if j < k else j + 1
        for a in range(m):
            rows[a, column] = inner(parts[a], basis[j], n)
    for a in range(m):
        start[a] = offsets[a] / unit + inner(rows[a, k + 1 :], along[k:], n - k)
        rows[a, k] = 1.0 if a % 3 == 0 else 0.0
    for a in range(0, m, 3):
        fixed = True
        for j in range(k):
            fixed = fixed and abs(rows[a, j]) <= FIXED
        # left without a normal part, whatever the choice
        if fixed and start[a] <= INSIDE:
            return 0
    for j in range(k):
        point[j] = along[j]
    point[k] = 0.0
    if not enter(rows, start, point, k, hessian, scratch):
        return 0
    minimise(rows, start, point, k, 0.0, hessian, scratch)
    if not tangent(rows, start, point, k, along[k:n], hessian, scratch, slope):
        return 0
    for i in range(n):
        forces[i] = 0.0
    for j in range(n):
        subtract_row(forces, basis[j], -unit * (point[j] if j < k else along[j]))
    return k


@array_entry(_MATRIX, _MATRIX, _MATRIX, when=SEVERAL)
def null_rows(directions, vectors, basis):
    """Combinations of the n directions (n, nv) that act on nothing, as rows of the basis (n, n) from the one on that is
    returned; vectors (nv, n): overwritten."""
    n, nv = directions.shape[0], directions.shape[1]
    for i in range(n):
        size = math.sqrt(inner(directions[i], directions[i], nv))
        for j in range(nv):
            vectors[j, i] = directions[i, j] / size if size > 0.0 else 0.0
    rank = orthonormal_basis(vectors, _NULL, basis)
    for i in range(n):
        size = math.sqrt(inner(directions[i], directions[i], nv))
        for j in range(rank, n):
            basis[j, i] /= size if size > 0.0 else 1.0
    return rank
