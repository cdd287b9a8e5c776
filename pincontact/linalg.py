"""Dense linear algebra of the kernels, in place and without allocation: one factorisation of each kind.

`factorize_tree`: Cholesky's of a kinematic tree's mass matrix; `factor_definite`: of any positive definite one;
`solve_gram`: with pivots, of products of rows that may depend on each other; `factor_matrix`: of a semidefinite matrix,
as a product of narrow factors; `least_norm`: elimination with complete pivoting of any consistent system.
"""

from __future__ import annotations

from math import nan, sqrt

from .arrays import INTEGERS, REALS, array_type
from .callback import separate_kernel
from .jit import INTEGER, REAL, inlined_kernel, kernel

# A pivot below this fraction of its row's diagonal counts as zero, and a singular value below that of the largest:
# redundant constraints. In time stepping they are so up to a multiple of it: to take from velocities what cone
# problems, which are solved to 1e-10, leave open would change them by more than a step does.
RANK_TOLERANCE, NEXT_TO_REDUNDANT = 1e-11, 1e2


# --------------------------------------------------------------------------------------------------------- vectors


@kernel
def inner(a, b, n):
    """Product of the first n numbers of two vectors, in four sums that need not wait for each other."""
    first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
    k = 0
    while k + 3 < n:
        first += a[k] * b[k]
        second += a[k + 1] * b[k + 1]
        third += a[k + 2] * b[k + 2]
        fourth += a[k + 3] * b[k + 3]
        k += 4
    if k + 1 < n:
        first += a[k] * b[k]
        second += a[k + 1] * b[k + 1]
        k += 2
    if k < n:
        third += a[k] * b[k]
    return (first + second) + (third + fourth)


@kernel
def largest_entry(x):
    """Largest |x_j|; four at a time, which do not wait for each other."""
    n = x.shape[0]
    first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
    whole = n - n % 4
    for j in range(0, whole, 4):
        first = max(first, abs(x[j]))
        second = max(second, abs(x[j + 1]))
        third = max(third, abs(x[j + 2]))
        fourth = max(fourth, abs(x[j + 3]))
    for j in range(whole, n):
        first = max(first, abs(x[j]))
    return max(max(first, second), max(third, fourth))


@kernel
def subtract_row(x, y, factor):
    """x -= factor y, with views as arguments: indices that start at zero can be done several at a time."""
    for j in range(x.shape[0]):
        x[j] -= factor * y[j]


# -------------------------------------------------------------------------------------- positive definite matrices


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
        pivot = row[k]
        if not pivot > 0.0:
            return False
        # rows above wait for no root
        inverse = 1.0 / pivot
        i = parents[k]
        while i >= 0:
            target, share = factor[i], row[i] * inverse
            j = i
            while j >= 0:
                target[j] -= share * row[j]
                j = parents[j]
            i = parents[i]
        row[k] = sqrt(pivot)
        inverse = 1.0 / row[k]
        i = parents[k]
        while i >= 0:
            row[i] *= inverse
            i = parents[i]
    return True


@kernel
def whiten(factor, parents, n, right, out):
    """out = L^-T right, so that products of whitened vectors are products by the inverse matrix (may be in place)."""
    for k in range(n):
        out[k] = right[k]
    for k in range(n - 1, -1, -1):
        _whiten_one(factor[k], parents, k, out)


@kernel
def whiten_rows(factor, parents, n, rows, count):
    """`whiten` the first rows, as many as count, in place; side by side, as they need not wait for each other."""
    for k in range(n - 1, -1, -1):
        for r in range(count):
            _whiten_one(factor[k], parents, k, rows[r])


@kernel
def _whiten_one(row, parents, k, out):
    """Coordinate k of L^-T out, by row k of L, and what it leaves of the others."""
    # constraint rows are zero but for the joints that move the contact
    if out[k] == 0.0:
        return
    # the division waits for nothing
    value = out[k] * (1.0 / row[k])
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
        last = i = parents[k]
        while i >= 0:
            i = parents[i]
            if i >= 0:
                value -= row[i] * out[i]
        if last >= 0:
            # the others need not wait for it
            value -= row[last] * out[last]
        out[k] = value * (1.0 / row[k])


@kernel
def factor_definite(matrix, n):
    """Cholesky factor of a positive definite matrix (n, n), of which the lower triangle is read and overwritten; not a
    number from the first pivot on that is not positive."""
    for i in range(n):
        for j in range(i):
            matrix[i, j] = (matrix[i, j] - inner(matrix[i], matrix[j], j)) / matrix[j, j]
        pivot = matrix[i, i] - inner(matrix[i], matrix[i], i)
        # Python's root has no value for it
        matrix[i, i] = sqrt(pivot) if pivot > 0.0 else nan


@kernel
def solve_definite(factor, n, x):
    """Solve with a matrix (n, n) of which `factor_definite` has left the factor; x (n,) is overwritten."""
    for i in range(n):
        x[i] = (x[i] - inner(factor[i], x, i)) / factor[i, i]
    for i in range(n - 1, -1, -1):
        x[i] /= factor[i, i]
        subtract_row(x[:i], factor[i], x[i])


@kernel
def solve_lower(factor, n, columns, rows):
    """rows (n, columns) = L^-1 rows, L the factor that `factor_definite` has left."""
    for k in range(n):
        row = rows[k, :columns]
        for j in range(k):
            subtract_row(row, rows[j], factor[k, j])
        inverse = 1.0 / factor[k, k]
        for j in range(columns):
            row[j] *= inverse


# ------------------------------------------------------------------------------------------- orthonormal vectors


@kernel
def orthonormal_basis(vectors, tolerance, basis):
    """Orthonormal rows (n, n), of which the first span those of vectors (m, n), but for what is below the tolerance of
    the largest; returns how many these are. vectors: overwritten. Gram and Schmidt with pivoting, twice over."""
    n, m, least, k = basis.shape[0], vectors.shape[0], 0.0, 0
    while k < n:
        pivot, p = least, -1
        for i in range(m):
            size = inner(vectors[i], vectors[i], n)
            if size > pivot:
                pivot, p = size, i
        if p < 0:
            break
        if k == 0:
            least = tolerance * tolerance * pivot
        for j in range(n):
            basis[k, j] = vectors[p, j]
        take_orthonormal(basis, k, n)
        for i in range(m):
            subtract_row(vectors[i], basis[k], inner(vectors[i], basis[k], n))
        k += 1
    complete_basis(basis, k, n)
    return k


@kernel
def take_orthonormal(basis, k, n):
    """Make row k of the basis orthogonal to those before it, and of unit length."""
    own = basis[k, :n]
    for j in range(k):
        subtract_row(own, basis[j], inner(own, basis[j], n))
    inverse = 1.0 / sqrt(inner(own, own, n))
    for j in range(n):
        own[j] *= inverse


@kernel
def complete_basis(basis, rank, n):
    """Rows from `rank` on with which the first ones of the basis (n, n or more) are a whole one."""
    for k in range(rank, n):
        # the axis of which most is left
        most, p = -1.0, 0
        for i in range(n):
            left = 1.0
            for j in range(k):
                left -= basis[j, i] ** 2
            if left > most:
                most, p = left, i
        own = basis[k, :n]
        for i in range(n):
            own[i] = 1.0 if i == p else 0.0
        for j in range(k):
            subtract_row(own, basis[j], basis[j, p])
        take_orthonormal(basis, k, n)


# ------------------------------------------------------------------------------------------- singular systems


@kernel
def solve_gram(rows, m, n, lower, permutation, x, scratch, tolerance):
    """Least-norm solution of the consistent system (R R^T) x = b, R the rows (m, n); returns its rank.

    tolerance: a pivot below this fraction of its row's diagonal counts as zero, RANK_TOLERANCE as a rule.

    x (m,): b in, solution out; lower (m, m + 1), permutation (m,) int and scratch (m, m + 1) are overwritten.
    Cholesky with pivoting, R R^T = P L L^T P^T with L of full column rank r; only the columns of R R^T that are needed
    are formed, so the cost is linear in m where r stays small. Where r < m the solution of least norm is
    L (L^T L)^-2 L^T b in pivoted order. Row i of L is row permutation[i] of lower.
    """
    if m == 0:
        return 0
    for i in range(m):
        permutation[i] = i
        diagonal = inner(rows[i], rows[i], n)
        lower[i, m - 1], lower[i, m] = (1.0 / diagonal, 1.0) if diagonal > 0.0 else (0.0, 0.0)
    rank = 0
    while rank < m:
        inverse = _take_pivot(lower, permutation, rank, m, tolerance)
        if inverse == 0.0:
            break
        p = permutation[rank]
        own = lower[p]
        for i in range(rank + 1, m):
            other = permutation[i]
            line = lower[other]
            value = (inner(rows[p], rows[other], n) - inner(own, line, rank)) * inverse
            line[m] -= value * value * line[m - 1]
            line[rank] = value
        rank += 1
    solve_factored(lower, permutation, m, rank, x, scratch)
    return rank


@kernel
def solve_factored(lower, permutation, m, rank, x, scratch):
    """`solve_gram` for another b, with the factor, the permutation and the rank that it has left."""
    # the rank is lower where the other rows of scratch are needed
    y = scratch[m - 1]
    for i in range(m):
        y[i] = x[permutation[i]]
    if rank == m:
        _solve_lower(lower, permutation, m, y)
    else:
        _solve_trapezoid(lower, permutation, m, rank, scratch, y)
    for i in range(m):
        x[permutation[i]] = y[i]


@inlined_kernel
def _take_pivot(lower, permutation, rank, m, tolerance):
    """Bring the row with the largest pivot, relative to its diagonal, to place `rank`; returns the inverse of its root,
    0 where none is left.

    Which part of each row's diagonal is left stands in column m, the diagonal's inverse in column m - 1, which the
    factor needs for the last row only.
    """
    pivot, best = rank, tolerance
    for i in range(rank, m):
        left = lower[permutation[i], m]
        if left > best:
            best, pivot = left, i
    if not best > tolerance:
        return 0.0
    permutation[rank], permutation[pivot] = permutation[pivot], permutation[rank]
    p = permutation[rank]
    inverse = sqrt(lower[p, m - 1] / best)
    lower[p, rank] = 1.0 / inverse
    return inverse


@inlined_kernel
def _solve_lower(lower, permutation, m, y):
    """y = (L L^T)^-1 y, y (m,) in pivoted order."""
    for i in range(m):
        row, value = lower[permutation[i]], y[i]
        for k in range(i):
            value -= row[k] * y[k]
        y[i] = value * (1.0 / row[i])
    for i in range(m - 1, -1, -1):
        row = lower[permutation[i]]
        value = y[i] * (1.0 / row[i])
        y[i] = value
        for k in range(i):
            y[k] -= row[k] * value


@kernel
def _solve_trapezoid(lower, permutation, m, rank, gram, y):
    """y = L (L^T L)^-2 L^T y for the m x rank trapezoid L, y (m,) in pivoted order; gram (rank, rank): scratch."""
    for i in range(rank):
        value = 0.0
        for k in range(i, m):
            value += lower[permutation[k], i] * y[k]
        y[i] = value
        for j in range(i + 1):
            value = 0.0
            for k in range(i, m):
                value += lower[permutation[k], i] * lower[permutation[k], j]
            gram[i, j] = value
    factor_definite(gram, rank)
    solve_definite(gram, rank, y)
    solve_definite(gram, rank, y)
    for i in range(m - 1, -1, -1):
        row, value = lower[permutation[i]], 0.0
        for k in range(min(i + 1, rank)):
            value += row[k] * y[k]
        y[i] = value


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
def largest_pivot(a, rows, k, first, n):
    """The largest |a_ij| of rows from k on and of columns from `first` on, (rows, n), with its row and its column."""
    pivot, p, q = -1.0, k, first
    for i in range(k, rows):
        size = largest_entry(a[i, first:n])
        if size > pivot:
            pivot, p = size, i
    while q < n - 1 and abs(a[p, q]) != pivot:
        q += 1
    return pivot, p, q


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
        pivot, p, q = largest_pivot(a, rows, k, k, n if tolerance > 0.0 else k + 1)
        if k == 0:
            largest = pivot
        if not pivot > tolerance * largest:
            break
        rank += 1
        if ((p != k) != (q != k)) != (a[p, q] < 0.0):
            sign = -sign
        if p != k:
            for j in range(n):
                a[k, j], a[p, j] = a[p, j], a[k, j]
            rhs[k], rhs[p] = rhs[p], rhs[k]
        if q != k:
            for i in range(rows):
                a[i, k], a[i, q] = a[i, q], a[i, k]
            order[k], order[q] = order[q], order[k]
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
            rhs[k] -= inner(a[k, k + 1 : n], rhs[k + 1 : n], n - k - 1)
        for j in range(n):
            x[order[j]] = rhs[j]
        a[0, 0] = sign * pivot / largest
        return rank
    for i in range(rank):
        for j in range(i + 1):
            gram[i, j] = inner(a[i, i:n], a[j, i:n], n - i)
    factor_definite(gram, rank)
    solve_definite(gram, rank, rhs)
    combined = gram[rank]
    for j in range(n):
        combined[j] = 0.0
    for k in range(rank):
        subtract_row(combined[k:n], a[k, k:n], -rhs[k])
    for j in range(n):
        x[order[j]] = combined[j]
    return rank
