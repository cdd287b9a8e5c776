"""The least loads that are not negative: the choice among redundant forces of what slides, in every method."""

from __future__ import annotations

from math import sqrt

import numpy as np

from ..arrays import array_entry
from ..jit import INTEGER, REAL, SEVERAL, kernel
from ..linalg import RANK_TOLERANCE, factor_definite, inner, largest_entry, solve_definite, subtract_row

# Loads are negative that are below zero by this part of the largest.
_ROUND_OFF = 1e-13
# A load that changes by less than this part of all that the equations leave open does not.
FIXED = 1e-9
# Rows of scratch of `least_loads`: the least solution whatever its signs, multipliers, and what these may become.
START, PUSH, TRIAL = range(3)
SCRATCH_ROWS = 3


@kernel
def multipliers_of(null, held, m, scratch, gram):
    """What pushes the m loads held (m,) from where they are in START to zero, into TRIAL; whether the last one is
    independent of the others. If not, far along what changes none of them."""
    trial, last = scratch[TRIAL], m - 1
    for i in range(m):
        trial[i] = -scratch[START, held[i]]
        for j in range(i + 1):
            gram[i, j] = 0.0
            for r in range(null.shape[0]):
                gram[i, j] += null[r, held[i]] * null[r, held[j]]
    factor_definite(gram, last)
    own = gram[last]
    for j in range(last):
        own[j] = (own[j] - inner(own, gram[j], j)) / gram[j, j]
    least = RANK_TOLERANCE * own[last]
    # more than the equations leave open depend on each other, whatever round-off has made of loads that nearly do
    left = own[last] - inner(own, own, last) if m <= null.shape[0] else 0.0
    own[last] = sqrt(max(left, least))
    solve_definite(gram, m, trial)
    return left > least


@kernel
def let_go(held, m, scratch):
    """Go from the multipliers towards those in TRIAL until one is zero, and let go what has none; how many are left."""
    push, trial, share = scratch[PUSH], scratch[TRIAL], 1.0
    for i in range(m):
        if not trial[i] > 0.0:
            share = min(share, push[i] / (push[i] - trial[i]))
    left = 0
    for i in range(m):
        value = push[i] + share * (trial[i] - push[i])
        if value > 0.0 and (share == 1.0 or trial[i] > 0.0 or push[i] / (push[i] - trial[i]) > share):
            held[left], push[left] = held[i], value
            left += 1
    return left


@kernel
def least_loads(null, bounded, x, held, gram, scratch):
    """Move x (n,), the least solution of equations that leave the orthonormal rows of null (k, n or more) open, to the
    least one that is not negative where bounded (n,) is not zero; False where there is none.

    An active-set method on the multipliers of what is held at zero, one load after the other (Lawson and Hanson,
    Solving Least Squares Problems, Ch. 23). held (n + 1,) integers, gram (k + 1, k + 1), scratch (SCRATCH_ROWS, n or
    more): are overwritten.
    """
    n, k, start = x.shape[0], null.shape[0], scratch[START]
    for j in range(n):
        start[j] = x[j]
    largest, m = largest_entry(x), 0
    for _ in range(3 * n):
        lowest, p = -_ROUND_OFF * largest, -1
        for j in range(n):
            if bounded[j] != 0.0 and x[j] < lowest:
                lowest, p = x[j], j
        if p < 0:
            for j in range(n):
                if bounded[j] != 0.0:
                    x[j] = max(x[j], 0.0)
            return True
        held[m], scratch[PUSH, m] = p, 0.0
        before, m, size = m, m + 1, 0.0
        for r in range(k):
            size += null[r, p] ** 2
        if size <= FIXED * FIXED:
            return False
        while before != m:
            independent = multipliers_of(null, held, m, scratch, gram)
            before, m = m, let_go(held, m, scratch)
            # nothing else gives way: it is as negative, whatever the others
            if m == 0 or (m == before and not independent):
                return False
        for j in range(n):
            x[j] = start[j]
        for r in range(k):
            along = 0.0
            for i in range(m):
                along += null[r, held[i]] * scratch[PUSH, i]
            subtract_row(x, null[r], -along)
        for i in range(m):
            x[held[i]] = 0.0
    return False


_VECTOR, _MATRIX = REAL[::1], REAL[:, ::1]


@array_entry(_MATRIX, _VECTOR, _VECTOR, INTEGER[::1], _MATRIX, _MATRIX, when=SEVERAL)
def _move(null, bounded, x, held, gram, scratch):
    return least_loads(null, bounded, x, held, gram, scratch)


def least_of(least: np.ndarray, null: np.ndarray, bounded: np.ndarray) -> np.ndarray | None:
    """(n,) the least solution of equations that is not negative where bounded (n,), of the least (n,) with any signs
    and orthonormal rows (k, n) that the equations leave open; None where there is none."""
    k, n = null.shape
    x, held, scratch = least.copy(), np.zeros(n + 1, dtype=np.int64), np.empty((SCRATCH_ROWS, n + 1))
    found = _move(np.ascontiguousarray(null), bounded.astype(float), x, held, np.empty((k + 1, k + 1)), scratch)
    return x if found else None
