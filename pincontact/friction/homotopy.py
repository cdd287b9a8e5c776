"""A homotopy to a solution of the contact problem, for problems that no other start solves (Sec. 5.3).

The cones are scaled to |f_t| <= f_n; then y = (u_t, u_n / mu + |u_t|) is in the same cone, and orthogonal to f. With
the product of the cone's algebra, f o y = (f_n y_t + y_n f_t, f . y), and its unit e, that is f o y = 0. The path is

    f o y = t e,    y = G f + b + (1 - t) (0, 0, |u_t|) + t r    (|u_t| rounded off by t)

with r such that f = y = e solves it at t = 1; there De Saxce's term is off, the problem monotone and the solution
the only one. A path that starts at the only solution cannot come back to it: followed by arc length, round the
points where t turns, it comes to a solution at t = 0, unless the forces grow without bound. On the way it stays well
inside the cones, which is where modes can be told; between redundant forces it ends at the best centred ones.
"""

from __future__ import annotations

from math import sqrt

from ..arrays import array_entry
from ..jit import INTEGER, REAL, SEVERAL, kernel
from ..linalg import least_norm
from .cone import (
    ESCAPED,
    HUGE,
    LARGEST_FRICTION,
    LEAST_FRICTION,
    cone_at,
    cone_step,
    scale_problem,
)

# Part of the way to the cones' boundary that a step takes at most.
BACK_OFF = 0.99
CORRECTIONS = 5
# The first step, in units of f and of the logarithm of t; how much longer the next may be than one that took so many
# corrections; how much shorter the next try than one that took too many.
FIRST_STEP, LONGER, SHORTER = 0.1, (4.0, 2.5, 1.5, 1.0, 0.7), 0.4
# Steps below the first, or below the round-off of x, lead nowhere.
SHORTEST_STEP, ROUND_OFF_STEP = 1e-8, 1e-13
# Of the terms that cancel in y.
ROUND_OFF = 1e-14
# Of `cone.homotopy_rows`: r of the problem, what is left of y's equation, units of forces, y's change along the path.
_R, _GAP, _WEIGHT, _SLOPE = range(4)


@kernel
def cone_units(g, c, mu, weight):
    """weight (3n,) that makes a scaled problem's cones circular and its blocks unit-sized; returns the unit of c."""
    unit = 0.0
    for i in range(mu.shape[0]):
        k = 3 * i
        friction = min(max(mu[i], LEAST_FRICTION), LARGEST_FRICTION) if mu[i] > 0.0 else 1.0
        trace = g[k, k] + g[k + 1, k + 1] + g[k + 2, k + 2] / (friction * friction)
        weight[k] = sqrt(3.0 / trace) if trace > 0.0 else 1.0
        weight[k + 1] = weight[k]
        weight[k + 2] = weight[k] / friction
        for r in range(k, k + 3):
            unit = max(unit, abs(weight[r] * c[r]))
    return unit if unit > 0.0 else 1.0


@kernel
def homotopy_residual(a, c, r, x, y, h, gap):
    """Residuals of the path's equations at x = (f, t) and y (3n,); returns the largest relative to t, or `HUGE`.

    h (3n,) = f o y - t e and gap (3n,) = G f + ... - y (module docstring): output; a (3n, 3n), c, r (3n,): the problem
    in circular cones. Of the gap, round-off is no part: it is an equally small change of b. `HUGE`: outside the cones.
    """
    rows = y.shape[0]
    t = x[rows]
    worst = 0.0
    for k in range(0, rows, 3):
        inside = x[k + 2] > sqrt(x[k] ** 2 + x[k + 1] ** 2) and y[k + 2] > sqrt(y[k] ** 2 + y[k + 1] ** 2)
        if not (inside and t > 0.0):
            return HUGE
        h[k] = x[k + 2] * y[k] + y[k + 2] * x[k]
        h[k + 1] = x[k + 2] * y[k + 1] + y[k + 2] * x[k + 1]
        h[k + 2] = x[k] * y[k] + x[k + 1] * y[k + 1] + x[k + 2] * y[k + 2] - t
        for q in range(k, k + 3):
            total = c[q] + t * r[q]
            absolute = abs(total) + abs(y[q])
            for j in range(rows):
                term = a[q, j] * x[j]
                total += term
                absolute += abs(term)
            if q == k + 2:
                total += (1.0 - t) * sqrt(y[k] ** 2 + y[k + 1] ** 2 + t * t)
            gap[q] = total - y[q]
            worst = max(worst, abs(h[q]), abs(gap[q]) - ROUND_OFF * absolute)
    return worst / t


@kernel
def homotopy_matrix(a, r, x, y, border, system):
    """system (3n + 1, 3n + 1) is the derivative of f o y - t e by x = (f, t), y in step, and the border as last row."""
    rows = y.shape[0]
    t = x[rows]
    for k in range(0, rows, 3):
        f1, f2, fn = x[k], x[k + 1], x[k + 2]
        y1, y2, yn = y[k], y[k + 1], y[k + 2]
        root = sqrt(y1 * y1 + y2 * y2 + t * t)
        grow = (1.0 - t) / root
        for j in range(rows + 1):
            if j < rows:
                d1 = a[k, j]
                d2 = a[k + 1, j]
                dn = a[k + 2, j] + grow * (y1 * d1 + y2 * d2)
            else:
                d1 = r[k]
                d2 = r[k + 1]
                dn = r[k + 2] - root + grow * (y1 * d1 + y2 * d2 + t)
            system[k, j] = fn * d1 + f1 * dn
            system[k + 1, j] = fn * d2 + f2 * dn
            system[k + 2, j] = f1 * d1 + f2 * d2 + fn * dn
        system[k, k] += yn
        system[k, k + 2] += y1
        system[k + 1, k + 1] += yn
        system[k + 1, k + 2] += y2
        system[k + 2, k] += y1
        system[k + 2, k + 1] += y2
        system[k + 2, k + 2] += yn
        system[k + 2, rows] -= 1.0
    for j in range(rows):
        system[rows, j] = border[j]
    system[rows, rows] = border[rows] / (t * t)


@kernel
def homotopy_slope(a, r, x, y, change, slope):
    """The change of y (3n,) that goes with a change (3n + 1,) of x = (f, t), added to slope (3n,)."""
    rows = y.shape[0]
    t = x[rows]
    for k in range(0, rows, 3):
        for q in range(k, k + 3):
            total = change[rows] * r[q]
            for j in range(rows):
                total += a[q, j] * change[j]
            slope[q] += total
        root = sqrt(y[k] ** 2 + y[k + 1] ** 2 + t * t)
        turn = (y[k] * slope[k] + y[k + 1] * slope[k + 1] + t * change[rows]) / root
        slope[k + 2] += (1.0 - t) * turn - root * change[rows]


@kernel
def circular_problem(delassus, b, mu, size, cone):
    """The problem in circular cones (`cone_units`) into `cone.scaled`, `cone.c`, r and weight; returns the units of
    forces in them, the second that of the scaled problem."""
    n = mu.shape[0]
    rows = 3 * n
    g = cone.scaled
    c, r, weight = cone.c, cone.homotopy_rows[_R], cone.homotopy_rows[_WEIGHT]
    largest = scale_problem(delassus, b, n, g, c, cone.scale, r)
    unit = cone_units(g, c, mu, weight) / size
    for k in range(rows):
        c[k] *= weight[k] / unit
        for j in range(rows):
            g[k, j] *= weight[k] * weight[j]
            if (mu[k // 3] == 0.0 and k % 3 < 2) or (mu[j // 3] == 0.0 and j % 3 < 2):
                # Without friction the tangential forces are zero and what they would act on is of no interest.
                c[k] = 0.0 if mu[k // 3] == 0.0 and k % 3 < 2 else c[k]
                g[k, j] = 0.0
    for k in range(rows):
        r[k] = -c[k] + (1.0 if k % 3 == 2 else 0.0)
        for j in range(2, rows, 3):
            r[k] -= g[k, j]
    return unit, largest


@kernel
def correct_point(tube, cone):
    """Newton's corrections of the point ahead (x and y of the point after the next step), across the tangent; returns
    how many it took into the tube, -1 where these are not enough."""
    rows = cone.forces.shape[0]
    g, system = cone.scaled, cone.system
    c, r, gap, h = cone.c, cone.homotopy_rows[_R], cone.homotopy_rows[_GAP], cone.rhs
    point = cone.homotopy
    tangent, ahead, change, rhs = point[1], point[2], point[3], point[4]
    y_ahead = point[7][:rows]
    for correction in range(CORRECTIONS):
        error = homotopy_residual(g, c, r, ahead, y_ahead, h, gap)
        if error <= tube:
            return correction
        if not error < HUGE or correction == CORRECTIONS - 1:
            break
        homotopy_matrix(g, r, ahead, y_ahead, tangent, system)
        for k in range(0, rows, 3):
            root = sqrt(y_ahead[k] ** 2 + y_ahead[k + 1] ** 2 + ahead[rows] ** 2)
            turn = (y_ahead[k] * gap[k] + y_ahead[k + 1] * gap[k + 1]) / root
            change_n = gap[k + 2] + (1.0 - ahead[rows]) * turn
            rhs[k] = -h[k] - ahead[k + 2] * gap[k] - ahead[k] * change_n
            rhs[k + 1] = -h[k + 1] - ahead[k + 2] * gap[k + 1] - ahead[k + 1] * change_n
            rhs[k + 2] = -h[k + 2] - ahead[k] * gap[k] - ahead[k + 1] * gap[k + 1] - ahead[k + 2] * change_n
        rhs[rows] = 0.0
        least_norm(system, rhs, rows + 1, rows + 1, change, cone.gram, cone.order, 0.0)
        homotopy_slope(g, r, ahead, y_ahead, change, gap)
        for k in range(rows + 1):
            ahead[k] += change[k]
        for k in range(rows):
            y_ahead[k] += gap[k]
    return -1


@array_entry(REAL[:, ::1], REAL[::1], REAL[::1], INTEGER, REAL, REAL, REAL, INTEGER, when=SEVERAL)
def follow_homotopy(delassus, b, mu, address, target, tube, size, steps):
    """Forces (3n,) in the workspace where the path (module docstring) is down to t = target; returns the t reached.

    A target of 1 starts it; later calls go on, at most `steps` further. What is returned above the target was the end:
    the steps are used up, or became too short; `HUGE` says that the forces grow without bound.

    delassus, b, mu, address: as for `solve_cones`; tube: width round the path in which a point counts as on it,
    relative to t (in a narrow one the steps are too short to get onto another branch); size: of b, where f = y = e.
    All but target and steps as in the first call.
    """
    cone = cone_at(address)
    n = mu.shape[0]
    rows = 3 * n
    g = cone.scaled
    system = cone.system
    point = cone.homotopy
    x = point[0]
    tangent = point[1]
    ahead = point[2]
    change = point[3]
    rhs = point[4]
    memory = point[5]
    y = point[6][:rows]
    y_ahead = point[7][:rows]
    r, weight, slope = cone.homotopy_rows[_R], cone.homotopy_rows[_WEIGHT], cone.homotopy_rows[_SLOPE]
    unit, largest = circular_problem(delassus, b, mu, size, cone)
    if target == 1.0:
        for k in range(rows + 1):
            x[k] = 1.0 if k % 3 == 2 or k == rows else 0.0
            tangent[k] = 0.0
        for k in range(rows):
            y[k] = x[k]
        tangent[rows] = -1.0
        memory[0] = FIRST_STEP
    longest = memory[0]
    largest_x = 1.0
    for _ in range(steps):
        if x[rows] <= target or x[rows] > 1.0:
            break
        homotopy_matrix(g, r, x, y, tangent, system)
        for k in range(rows):
            rhs[k] = 0.0
        rhs[rows] = 1.0
        least_norm(system, rhs, rows + 1, rows + 1, change, cone.gram, cone.order, 0.0)
        norm = 0.0
        for k in range(rows):
            norm += change[k] * change[k]
        # The length counts t by its logarithm: on the last stretch the forces may change while t is almost nothing.
        norm = sqrt(norm + (change[rows] / x[rows]) ** 2)
        if not norm < HUGE:
            break
        for k in range(rows + 1):
            tangent[k] = change[k] / norm
        # How far along it the cones are left.
        for k in range(rows):
            slope[k] = 0.0
        homotopy_slope(g, r, x, y, tangent, slope)
        t = x[rows]
        step = 1e10
        for k in range(0, rows, 3):
            step = min(step, cone_step(x[k], x[k + 1], x[k + 2], tangent[k], tangent[k + 1], tangent[k + 2]))
            step = min(step, cone_step(y[k], y[k + 1], y[k + 2], slope[k], slope[k + 1], slope[k + 2]))
        if tangent[rows] < 0.0:
            step = min(step, -t / tangent[rows])
        step = min(BACK_OFF * step, longest)
        accepted = False
        shortest = SHORTEST_STEP + ROUND_OFF_STEP * largest_x
        while step > shortest and not accepted:
            for k in range(rows + 1):
                ahead[k] = x[k] + step * tangent[k]
            for k in range(rows):
                y_ahead[k] = y[k] + step * slope[k]
            corrections = correct_point(tube, cone)
            if corrections >= 0:
                accepted = True
                longest = step * LONGER[corrections]
            else:
                step *= SHORTER
        if not accepted:
            break
        largest_x = 0.0
        for k in range(rows + 1):
            x[k] = ahead[k]
            largest_x = max(largest_x, abs(x[k]))
        for k in range(rows):
            y[k] = y_ahead[k]
        if largest_x > ESCAPED:
            return HUGE
    memory[0] = longest
    for k in range(rows):
        cone.forces[k] = x[k] * weight[k] * unit * cone.scale[k // 3] * largest
    return x[rows]
