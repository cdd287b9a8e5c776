"""Algebra of vectors of three numbers for the kernels."""

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
