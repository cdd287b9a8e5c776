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
def solve_semidefinite(matrix, n, permutation, x, lower):
    """Least-norm solution of a consistent symmetric positive semidefinite system; returns its rank.

    matrix (n, n): the lower triangle is read, all is overwritten; x (n,): right-hand side in, solution out;
    permutation (n,) int and lower (n, n + 1) are overwritten. The method is that of `solve_gram`.
    """
    for i in range(n):
        permutation[i] = i
        lower[i, n - 1] = lower[i, n] = matrix[i, i]
    rank = 0
    while rank < n and take_pivot(lower, permutation, rank, n):
        p = permutation[rank]
        for i in range(rank + 1, n):
            other = permutation[i]
            eliminate(lower, p, other, rank, n, matrix[max(p, other), min(p, other)])
        rank += 1
    # of the matrix, which is no longer needed, a factor of rank below n leaves the last column free
    solve_factored(lower, permutation, n, rank, x, matrix, matrix[:n, n - 1])
    return rank


@kernel
def solve_gram(rows, m, n, lower, permutation, x, scratch):
    """Least-norm solution of the consistent system (R R^T) x = b, R the rows (m, n); returns its rank.

    x (m,): b in, solution out; lower (m, m + 1), permutation (m,) int and scratch (m, m + 1) are overwritten.
    Cholesky with pivoting, R R^T = P L L^T P^T with L of full column rank r; only the columns of R R^T that are needed
    are formed, so the cost is linear in m where r stays small. Where r < m the solution of least norm is
    L (L^T L)^-2 L^T b in pivoted order. Row i of L is row permutation[i] of lower.
    """
    for i in range(m):
        permutation[i] = i
        lower[i, m - 1] = lower[i, m] = inner(rows[i], rows[i], n)
    rank = 0
    while rank < m and take_pivot(lower, permutation, rank, m):
        p = permutation[rank]
        for i in range(rank + 1, m):
            other = permutation[i]
            eliminate(lower, p, other, rank, m, inner(rows[p], rows[other], n))
        rank += 1
    solve_factored(lower, permutation, m, rank, x, scratch, scratch[:m, m])
    return rank


@kernel
def take_pivot(lower, permutation, rank, m):
    """Bring the row with the largest pivot, relative to its diagonal, to place `rank`; False where none is left.

    What is left of each row's diagonal stands in column m, the diagonal itself in column m - 1, which the factor needs
    for the last row only.
    """
    pivot, best = rank, -1.0
    for i in range(rank, m):
        p = permutation[i]
        ratio = lower[p, m] / lower[p, m - 1] if lower[p, m - 1] > 0.0 else 0.0
        if ratio > best:
            best, pivot = ratio, i
    if not best > RANK_TOLERANCE:
        return False
    p = permutation[pivot]
    permutation[pivot] = permutation[rank]
    permutation[rank] = p
    lower[p, rank] = math.sqrt(lower[p, m])
    return True


@kernel
def eliminate(lower, p, other, rank, m, product):
    """Entry of another row in column `rank`, of which row p has the pivot; product: the matrix's entry of both rows."""
    own, line = lower[p], lower[other]
    value = (product - inner(own, line, rank)) / own[rank]
    line[rank] = value
    line[m] -= value * value


@kernel
def solve_factored(lower, permutation, m, rank, x, gram, y):
    """x (m,) = the least-norm solution, from the factor of that rank; gram (rank, rank) and y (m,) are overwritten."""
    for i in range(m):
        y[i] = x[permutation[i]]
    if rank == m:
        _solve_lower(lower, permutation, m, y)
    else:
        _solve_trapezoid(lower, permutation, m, rank, gram, y)
    for i in range(m):
        x[permutation[i]] = y[i]


@kernel
def _solve_lower(lower, permutation, m, y):
    """y = (L L^T)^-1 y, y (m,) in pivoted order."""
    for i in range(m):
        row, value = lower[permutation[i]], y[i]
        for k in range(i):
            value -= row[k] * y[k]
        y[i] = value / row[i]
    for i in range(m - 1, -1, -1):
        row = lower[permutation[i]]
        value = y[i] / row[i]
        y[i] = value
        for k in range(i):
            y[k] -= row[k] * value


@kernel
def _solve_trapezoid(lower, permutation, m, rank, gram, y):
    """y = L (L^T L)^-2 L^T y for the m x rank trapezoid L, y (m,) in pivoted order."""
    # L^T y, then twice (L^T L)^-1 by its Cholesky factor, then L times that
    for i in range(rank):
        value = 0.0
        for k in range(i, m):
            value += lower[permutation[k], i] * y[k]
        y[i] = value
    for i in range(rank):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, m):
                value += lower[permutation[k], i] * lower[permutation[k], j]
            for k in range(j):
                value -= gram[i, k] * gram[j, k]
            gram[i, j] = math.sqrt(value) if i == j else value / gram[j, j]
    for _ in range(2):
        for i in range(rank):
            value = y[i]
            for k in range(i):
                value -= gram[i, k] * y[k]
            y[i] = value / gram[i, i]
        for i in range(rank - 1, -1, -1):
            value = y[i] / gram[i, i]
            y[i] = value
            for k in range(i):
                y[k] -= gram[i, k] * value
    for i in range(m - 1, -1, -1):
        row, value = lower[permutation[i]], 0.0
        for k in range(min(i + 1, rank)):
            value += row[k] * y[k]
        y[i] = value
