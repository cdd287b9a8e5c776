"""Newton's method on the logarithmic barriers of cones, of which `centred` makes central forces."""

from __future__ import annotations

import math

from ..arrays import view
from ..jit import REAL, SEVERAL, entry_kernel, kernel
from ..linalg import factor_definite, inner, solve_definite

_NEWTON_STEPS = 60
_BACKTRACKS = 50
_CONVERGED = 1e-9
# Forces count as admissible if they are inside their cones by this fraction of the largest force.
INSIDE = 1e-9
# Part of the way to the nearest boundary that a step may go.
TO_BOUNDARY = 0.95
# Rows of scratch that `minimise` takes, beside the Hessian.
SCRATCH_ROWS = 5


@kernel
def barrier_derivatives(rows, x, point, pressure, slope, hessian):
    """Slope (n,) and Hessian (n, n), its lower triangle, of `_cost` at a point."""
    n = point.shape[0]
    for i in range(n):
        slope[i] = point[i]
        for j in range(i):
            hessian[i, j] = 0.0
        hessian[i, i] = 1.0
    slope[n - 1], hessian[n - 1, n - 1] = pressure, 0.0
    for a in range(0, x.shape[0], 3):
        length = math.hypot(x[a + 1], x[a + 2])
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
        length = math.hypot(x[i + 1], x[i + 2])
        a = dx[i] * dx[i] - dx[i + 1] * dx[i + 1] - dx[i + 2] * dx[i + 2]
        b = x[i] * dx[i] - x[i + 1] * dx[i + 1] - x[i + 2] * dx[i + 2]
        c = (x[i] - length) * (x[i] + length)
        # a w^2 + 2 b w + c = 0, the least positive root, as c / (-b + sqrt(b^2 - a c)); none where that is not
        # positive. From inside b^2 >= a c; they are equal in cones without tangents, but for rounding.
        below = math.sqrt(max(b * b - a * c, 0.0)) - b
        if below > 0.0:
            way = min(way, c / below)
    return way


@kernel
def _cost(x, point, step, size, pressure):
    """Barriers of (s, t1, t2) in x + |z|^2 / 2 + pressure times the enlargement, at point + size step; infinite
    outside."""
    total, n = 0.0, point.shape[0]
    for a in range(0, x.shape[0], 3):
        length = math.hypot(x[a + 1], x[a + 2])
        if not x[a] > length:
            return math.inf
        total -= math.log((x[a] - length) * (x[a] + length))
    for i in range(n - 1):
        z = point[i] + size * step[i]
        total += 0.5 * z * z
    return total + pressure * (point[n - 1] + size * step[n - 1])


@kernel
def _minimise(rows, start, point, pressure, hessian, scratch):
    n, m = point.shape[0], start.shape[0]
    free = n if pressure > 0.0 else n - 1
    slope, step, x, dx, after = scratch[0, :n], scratch[1, :n], scratch[2, :m], scratch[3, :m], scratch[4, :m]
    for _ in range(_NEWTON_STEPS):
        for a in range(m):
            x[a] = start[a] + inner(rows[a], point, n)
        barrier_derivatives(rows, x, point, pressure, slope, hessian)
        factor_definite(hessian, free)
        for i in range(n):
            step[i] = -slope[i] if i < free else 0.0
        solve_definite(hessian, free, step)
        decrement = -inner(slope, step, n)
        # so near the rim that round-off decides there is no number
        if not decrement > _CONVERGED:
            # the last step leaves the square of itself
            for i in range(n if decrement > 0.0 else 0):
                point[i] += step[i]
            return
        for a in range(m):
            dx[a] = inner(rows[a], step, n)
        size, before, falls = TO_BOUNDARY * way_inside(x, dx), _cost(x, point, step, 0.0, pressure), False
        for _ in range(_BACKTRACKS):
            for a in range(m):
                after[a] = x[a] + size * dx[a]
            falls = _cost(after, point, step, size, pressure) <= before - 0.1 * size * decrement
            if falls:
                break
            size *= 0.5
        if not falls:
            return
        for i in range(n):
            point[i] += size * step[i]
        if pressure > 0.0 and point[n - 1] < -INSIDE:
            return


@entry_kernel(REAL[:, ::1], REAL[::1], REAL[::1], REAL, REAL[:, ::1], REAL[:, ::1], when=SEVERAL)
def minimise(rows, start, point, pressure, hessian, scratch):
    """Newton with backtracking from a point (n,), which is overwritten, on barriers + |z|^2 / 2 + pressure times the
    enlargement, the point's last number; it ends where that is negative. Pressure 0 keeps it fixed.

    rows (3 m, n), start (3 m,): s and t of m cones are start + rows point, and s > |t| is inside; hessian (n, n),
    scratch (SCRATCH_ROWS, at least n and 3 m): overwritten.
    """
    _minimise(view(rows), view(start), view(point), pressure, view(hessian), view(scratch))
