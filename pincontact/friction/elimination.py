"""Linear systems of contacts, singular ones too, without allocation.

`least_norm`: elimination with complete pivoting; `factor_matrix`: a semidefinite matrix as a product of narrow factors;
`factor_gram`, `solve_gram`: Cholesky's factorisation of a definite one.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from ..arrays import INTEGERS, REALS, array_type
from ..callback import separate_kernel
from ..jit import INTEGER, REAL, kernel

# Unsigned: an index that cannot be negative is not looked at for that.
ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)


@kernel
def subtract_row(x, y, factor):
    """x -= factor y, with views as arguments: indices that start at zero can be done several at a time."""
    for j in range(x.shape[0]):
        x[j] -= factor * y[j]


@kernel
def largest_entry(x):
    """Largest |x_j|; four at a time, which do not wait for each other."""
    n = x.shape[0]
    first = 0.0
    second = 0.0
    third = 0.0
    fourth = 0.0
    for quarter in range(n // 4):
        j = np.uint64(quarter) * FOUR
        first = max(first, abs(x[j]))
        second = max(second, abs(x[j + ONE]))
        third = max(third, abs(x[j + TWO]))
        fourth = max(fourth, abs(x[j + THREE]))
    for j in range(n - n % 4, n):
        first = max(first, abs(x[j]))
    return max(max(first, second), max(third, fourth))


@kernel
def dot(x, y):
    """Sum of x_j y_j, in four parts that do not wait for each other."""
    n = x.shape[0]
    first = 0.0
    second = 0.0
    third = 0.0
    fourth = 0.0
    for quarter in range(n // 4):
        j = np.uint64(quarter) * FOUR
        first += x[j] * y[j]
        second += x[j + ONE] * y[j + ONE]
        third += x[j + TWO] * y[j + TWO]
        fourth += x[j + THREE] * y[j + THREE]
    for j in range(n - n % 4, n):
        first += x[j] * y[j]
    return (first + second) + (third + fourth)


_MATRIX, _VECTOR = array_type(REALS, 2), array_type(REALS, 1)


@separate_kernel(INTEGER, _MATRIX, _VECTOR, INTEGER, INTEGER, _VECTOR, _MATRIX, array_type(INTEGERS, 1), REAL)
def least_norm(a, rhs, rows, n, x, gram, order, tolerance):
    """x (n,) of least norm with a x = rhs for a consistent system that may be singular; returns the rank.

    Elimination with complete pivoting, stopped at the first pivot below tolerance times the largest, then least
    norm in the row space; tolerance 0 says that a is regular, and rows alone are exchanged. a (>= rows, >= n) and
    rhs (rows,) are overwritten: where the rank is below n, the first rows of a, as many as the rank, are then unit
    upper trapezoidal, its columns in the order of order (n,), and gram (> rank, >= n) has the Cholesky factor of their
    products. Where it is n, and tolerance positive, a[0, 0] then has the sign of the determinant, and for
    its size the last pivot relative to the largest.
    """
    if n == 2 and rows == 2:
        # one contact that slips: what complete pivoting would come to
        largest = max(abs(a[0, 0]), abs(a[0, 1]), abs(a[1, 0]), abs(a[1, 1]))
        determinant = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
        if abs(determinant) > tolerance * largest * largest:
            x[0] = (rhs[0] * a[1, 1] - a[0, 1] * rhs[1]) / determinant
            x[1] = (a[0, 0] * rhs[1] - rhs[0] * a[1, 0]) / determinant
            a[0, 0] = determinant / (largest * largest)
            return 2
    for j in range(n):
        order[j] = j
    largest = 0.0
    pivot = 0.0
    sign = 1.0
    rank = 0
    for k in range(min(rows, n)):
        pivot = -1.0
        p = k
        q = k
        for i in range(k, rows):
            size = largest_entry(a[i, k:n]) if tolerance > 0.0 else abs(a[i, k])
            if size > pivot:
                pivot = size
                p = i
        if tolerance > 0.0:
            while q < n - 1 and abs(a[p, q]) != pivot:
                q += 1
        if k == 0:
            largest = pivot
        if not pivot > tolerance * largest:
            break
        rank += 1
        if ((p != k) != (q != k)) != (a[p, q] < 0.0):
            sign = -sign
        if p != k:
            for j in range(n):
                swap = a[k, j]
                a[k, j] = a[p, j]
                a[p, j] = swap
            swap = rhs[k]
            rhs[k] = rhs[p]
            rhs[p] = swap
        if q != k:
            for i in range(rows):
                swap = a[i, k]
                a[i, k] = a[i, q]
                a[i, q] = swap
            swapped = order[k]
            order[k] = order[q]
            order[q] = swapped
        inverse = 1.0 / a[k, k]
        for j in range(k, n):
            a[k, j] *= inverse
        rhs[k] *= inverse
        for i in range(k + 1, rows):
            factor = a[i, k]
            if factor != 0.0:
                subtract_row(a[i, k:n], a[k, k:n], factor)
                rhs[i] -= factor * rhs[k]

    if rank == n:
        for k in range(n - 1, -1, -1):
            rhs[k] -= dot(a[k, k + 1 : n], rhs[k + 1 : n])
        for j in range(n):
            x[order[j]] = rhs[j]
        a[0, 0] = sign * pivot / largest
        return rank
    for i in range(rank):
        for j in range(i + 1):
            gram[i, j] = dot(a[i, i:n], a[j, i:n])
    factor_gram(gram, rank)
    solve_gram(gram, rank, rhs)
    combined = gram[rank]
    for j in range(n):
        combined[j] = 0.0
    for k in range(rank):
        subtract_row(combined[k:n], a[k, k:n], -rhs[k])
    for j in range(n):
        x[order[j]] = combined[j]
    return rank


@kernel
def factor_matrix(g, factor, rest, tolerance):
    """Rows (r, 3n) of L^T in factor, largest pivots first; returns r, or 0 if it is more than half of 3n.

    Cholesky's factor with diagonal pivoting of g (3n, 3n), positive semidefinite, up to pivots of `tolerance` times the
    largest; rest (3n,): scratch.
    """
    rows = g.shape[0]
    for j in range(rows):
        rest[j] = g[j, j]
    largest = 0.0
    for k in range(rows // 2 + 1):
        pivot = 0.0
        p = 0
        for j in range(rows):
            if rest[j] > pivot:
                pivot = rest[j]
                p = j
        largest = max(largest, pivot)
        if not pivot > tolerance * largest:
            return k
        row = factor[k]
        source = g[p]
        for j in range(rows):
            row[j] = source[j]
        for i in range(k):
            subtract_row(row, factor[i], factor[i, p])
        inverse = 1.0 / sqrt(pivot)
        for j in range(rows):
            row[j] *= inverse
            rest[j] -= row[j] * row[j]
        rest[p] = 0.0
    return 0


@kernel
def factor_gram(gram, n):
    """Cholesky factor of a positive definite matrix (n, n), of which the lower triangle is read and overwritten."""
    for i in range(n):
        for j in range(i + 1):
            total = gram[i, j] - dot(gram[i, :j], gram[j, :j])
            gram[i, j] = sqrt(total) if i == j else total / gram[j, j]


@kernel
def solve_gram(gram, n, x):
    """Solve with a matrix (n, n) of which `factor_gram` has left the factor; x (n,) is overwritten."""
    for i in range(n):
        x[i] = (x[i] - dot(gram[i, :i], x[:i])) / gram[i, i]
    for i in range(n - 1, -1, -1):
        x[i] /= gram[i, i]
        subtract_row(x[:i], gram[i, :i], x[i])
