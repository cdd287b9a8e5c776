"""Dense factorisations for the kernels, in place and without allocation."""

from __future__ import annotations

import math

from ..jit import kernel

# A pivot below this fraction of its row's diagonal counts as zero: redundant constraints.
RANK_TOLERANCE = 1e-11


@kernel
def inner(a, b, n):
    """Product of the first n numbers of two vectors, in four sums that need not wait for each other."""
    first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
    whole = n - n % 4
    for k in range(0, whole, 4):
        first += a[k] * b[k]
        second += a[k + 1] * b[k + 1]
        third += a[k + 2] * b[k + 2]
        fourth += a[k + 3] * b[k + 3]
    for k in range(whole, n):
        first += a[k] * b[k]
    return (first + second) + (third + fourth)


@kernel
def factorize_tree(matrix, parents, n, factor):
    """Lower factor L with L^T L = matrix, a symmetric positive matrix of which the lower triangle is given.

    parents (n,): a row's parent is another before it, or -1; a row has entries left of its diagonal at its chain of
    parents only, in the matrix and so in L (the mass matrix of a kinematic tree: Featherstone, Rigid Body Dynamics
    Algorithms, Sec. 6.5). Others are not touched. False if the matrix is not positive. Works in place.
    """
    for k in range(n):
        factor[k, k] = matrix[k, k]
        i = parents[k]
        while i >= 0:
            factor[k, i] = matrix[k, i]
            i = parents[i]
    for k in range(n - 1, -1, -1):
        row = factor[k]
        if not row[k] > 0.0:
            return False
        row[k] = math.sqrt(row[k])
        inverse = 1.0 / row[k]
        i = parents[k]
        while i >= 0:
            row[i] *= inverse
            i = parents[i]
        i = parents[k]
        while i >= 0:
            target, share = factor[i], row[i]
            j = i
            while j >= 0:
                target[j] -= share * row[j]
                j = parents[j]
            i = parents[i]
    return True


@kernel
def whiten(factor, parents, n, right, out):
    """out = L^-T right, so that products of whitened vectors are products by the inverse matrix (may be in place)."""
    for k in range(n):
        out[k] = right[k]
    for k in range(n - 1, -1, -1):
        # constraint rows are zero but for the joints that move the contact
        if out[k] == 0.0:
            continue
        row = factor[k]
        value = out[k] / row[k]
        out[k] = value
        i = parents[k]
        while i >= 0:
            out[i] -= row[i] * value
            i = parents[i]


@kernel
def unwhiten(factor, parents, n, right, out):
    """out = L^-1 right (may be in place)."""
    for k in range(n):
        row, value = factor[k], right[k]
        i = parents[k]
        while i >= 0:
            value -= row[i] * out[i]
            i = parents[i]
        out[k] = value / row[k]


@kernel
def solve_semidefinite(system, n, permutation, x, scratch):
    """Minimum-norm solution of a consistent symmetric positive semidefinite system.

    system (n, n): overwritten; x (n,): right-hand side in, solution out; permutation (n,) int and scratch (n, n + 1).
    Cholesky with diagonal pivoting, A = P L L^T P^T with L of full column rank r; where r < n the solution of
    least norm is L (L^T L)^-2 L^T b in pivoted order.
    Returns the rank.
    """
    for i in range(n):
        permutation[i] = i
        scratch[i, n] = system[i, i]
    rank = n
    for k in range(n):
        pivot = k
        best = -1.0
        for i in range(k, n):
            scale = scratch[permutation[i], n]
            ratio = system[i, i] / scale if scale > 0.0 else 0.0
            if ratio > best:
                best, pivot = ratio, i
        if not best > RANK_TOLERANCE:
            rank = k
            break
        if pivot != k:
            permutation[k], permutation[pivot] = permutation[pivot], permutation[k]
            for j in range(k):
                system[k, j], system[pivot, j] = system[pivot, j], system[k, j]
            # swap row and column k and pivot of the remaining lower triangle
            system[k, k], system[pivot, pivot] = system[pivot, pivot], system[k, k]
            for j in range(k + 1, pivot):
                system[j, k], system[pivot, j] = system[pivot, j], system[j, k]
            for j in range(pivot + 1, n):
                system[j, k], system[j, pivot] = system[j, pivot], system[j, k]
        root = math.sqrt(system[k, k])
        system[k, k] = root
        for i in range(k + 1, n):
            system[i, k] /= root
        for j in range(k + 1, n):
            for i in range(j, n):
                system[i, j] -= system[i, k] * system[j, k]
    for i in range(n):
        scratch[i, n] = x[permutation[i]]
    if rank == n:
        for i in range(n):
            value = scratch[i, n]
            for k in range(i):
                value -= system[i, k] * scratch[k, n]
            scratch[i, n] = value / system[i, i]
        for i in range(n - 1, -1, -1):
            value = scratch[i, n]
            for k in range(i + 1, n):
                value -= system[k, i] * scratch[k, n]
            scratch[i, n] = value / system[i, i]
    else:
        _least_norm(system, n, rank, scratch)
    for i in range(n):
        x[permutation[i]] = scratch[i, n]
    return rank


@kernel
def _least_norm(lower, n, rank, scratch):
    """scratch[:, n] = L (L^T L)^-2 L^T scratch[:, n] for the n x rank trapezoid L."""
    # y = L^T b, then twice (L^T L)^-1 by its Cholesky factor, then L y
    for i in range(rank):
        value = 0.0
        for k in range(i, n):
            value += lower[k, i] * scratch[k, n]
        scratch[i, n] = value
    for i in range(rank):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, n):
                value += lower[k, i] * lower[k, j]
            for k in range(j):
                value -= scratch[i, k] * scratch[j, k]
            scratch[i, j] = math.sqrt(value) if i == j else value / scratch[j, j]
    for _ in range(2):
        for i in range(rank):
            value = scratch[i, n]
            for k in range(i):
                value -= scratch[i, k] * scratch[k, n]
            scratch[i, n] = value / scratch[i, i]
        for i in range(rank - 1, -1, -1):
            value = scratch[i, n]
            for k in range(i + 1, rank):
                value -= scratch[k, i] * scratch[k, n]
            scratch[i, n] = value / scratch[i, i]
    for i in range(n - 1, -1, -1):
        value = 0.0
        for k in range(min(i + 1, rank)):
            value += lower[i, k] * scratch[k, n]
        scratch[i, n] = value


@kernel
def solve_gram(rows, m, n, lower, permutation, x, scratch):
    """Least-norm solution of the consistent system (R R^T) x = b, R the rows (m, n).

    x (m,): b in, solution out; lower (m, m + 1), permutation (m,) int and scratch (m, m + 1) are overwritten.
    Cholesky with pivoting, R R^T = P L L^T P^T with L of full column rank r; only the columns of R R^T that are needed
    are formed, so the cost is linear in m where r stays small. Where r < m the solution of least norm is
    L (L^T L)^-2 L^T b in pivoted order. Returns the rank.
    """
    for i in range(m):
        permutation[i] = i
        scratch[i, m] = lower[i, m] = inner(rows[i], rows[i], n)
    rank = 0
    while rank < m:
        pivot, best = rank, -1.0
        for i in range(rank, m):
            p = permutation[i]
            ratio = lower[p, m] / scratch[p, m] if scratch[p, m] > 0.0 else 0.0
            if ratio > best:
                best, pivot = ratio, i
        if not best > RANK_TOLERANCE:
            break
        p = permutation[pivot]
        permutation[pivot] = permutation[rank]
        permutation[rank] = p
        own, known = rows[p], lower[p]
        root = math.sqrt(known[m])
        known[rank] = root
        for i in range(rank + 1, m):
            other, line = rows[permutation[i]], lower[permutation[i]]
            value = (inner(own, other, n) - inner(known, line, rank)) / root
            line[rank] = value
            line[m] -= value * value
        rank += 1
    for i in range(m):
        scratch[i, m] = x[permutation[i]]
    if rank == m:
        _solve_lower(lower, permutation, m, scratch)
    else:
        _solve_trapezoid(lower, permutation, m, rank, scratch)
    for i in range(m):
        x[permutation[i]] = scratch[i, m]
    return rank


@kernel
def _solve_lower(lower, permutation, m, scratch):
    """scratch[:, m] = (L L^T)^-1 scratch[:, m], row i of L being row permutation[i] of lower."""
    for i in range(m):
        row, value = lower[permutation[i]], scratch[i, m]
        for k in range(i):
            value -= row[k] * scratch[k, m]
        scratch[i, m] = value / row[i]
    for i in range(m - 1, -1, -1):
        row = lower[permutation[i]]
        value = scratch[i, m] / row[i]
        scratch[i, m] = value
        for k in range(i):
            scratch[k, m] -= row[k] * value


@kernel
def _solve_trapezoid(lower, permutation, m, rank, scratch):
    """scratch[:, m] = L (L^T L)^-2 L^T scratch[:, m] for the m x rank trapezoid L (rows as in `_solve_lower`)."""
    # y = L^T b, then twice (L^T L)^-1 by its Cholesky factor, then L y
    for i in range(rank):
        value = 0.0
        for k in range(i, m):
            value += lower[permutation[k], i] * scratch[k, m]
        scratch[i, m] = value
    for i in range(rank):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, m):
                value += lower[permutation[k], i] * lower[permutation[k], j]
            for k in range(j):
                value -= scratch[i, k] * scratch[j, k]
            scratch[i, j] = math.sqrt(value) if i == j else value / scratch[j, j]
    for _ in range(2):
        for i in range(rank):
            value = scratch[i, m]
            for k in range(i):
                value -= scratch[i, k] * scratch[k, m]
            scratch[i, m] = value / scratch[i, i]
        for i in range(rank - 1, -1, -1):
            value = scratch[i, m] / scratch[i, i]
            scratch[i, m] = value
            for k in range(i):
                scratch[k, m] -= scratch[i, k] * value
    for i in range(m - 1, -1, -1):
        row, value = lower[permutation[i]], 0.0
        for k in range(min(i + 1, rank)):
            value += row[k] * scratch[k, m]
        scratch[i, m] = value
