"""Fixed-size linear algebra for the kernels: vectors of three and systems of at most four unknowns."""

from __future__ import annotations

import math

from ..jit import kernel


@kernel
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b, out):
    """out = a x b; out must not be a or b."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def add_cross(a, b, out):
    """out += a x b; out must not be a or b."""
    out[0] += a[1] * b[2] - a[2] * b[1]
    out[1] += a[2] * b[0] - a[0] * b[2]
    out[2] += a[0] * b[1] - a[1] * b[0]


@kernel
def triple(a, b, c):
    """a . (b x c)"""
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])


@kernel
def norm(a):
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@kernel
def rotate(rotation, a, out):
    """out = rotation a"""
    for i in range(3):
        out[i] = rotation[i, 0] * a[0] + rotation[i, 1] * a[1] + rotation[i, 2] * a[2]


@kernel
def rotate_back(rotation, a, out):
    """out = rotation^T a"""
    for i in range(3):
        out[i] = rotation[0, i] * a[0] + rotation[1, i] * a[1] + rotation[2, i] * a[2]


@kernel
def solve_in_place(system, n, columns):
    """Solve the n x n system in the first n columns for the right-hand sides in columns n .. columns-1, in place.

    Gaussian elimination with row pivoting. Returns the determinant; 0 leaves the right-hand sides undefined.
    """
    determinant = 1.0
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(system[i, k]) > abs(system[pivot, k]):
                pivot = i
        if system[pivot, k] == 0.0:
            return 0.0
        if pivot != k:
            determinant = -determinant
            for j in range(k, columns):
                system[k, j], system[pivot, j] = system[pivot, j], system[k, j]
        determinant *= system[k, k]
        for i in range(k + 1, n):
            factor = system[i, k] / system[k, k]
            if factor != 0.0:
                for j in range(k + 1, columns):
                    system[i, j] -= factor * system[k, j]
    for column in range(n, columns):
        for k in range(n - 1, -1, -1):
            value = system[k, column]
            for j in range(k + 1, n):
                value -= system[k, j] * system[j, column]
            system[k, column] = value / system[k, k]
    return determinant
