"""Newton steps for contacts that are redundant: many rows, few directions in which the bodies move.

The Delassus matrix (3n, 3n) of rank r is G = L L^T with L (3n, r), and Newton's matrix, sliding contacts included, is a
product of factors as narrow. Where a sliding contact turns, -|u_t| stands on the diagonal, too: the turning is a spring
across the direction of slip, kappa = |F_t| / |u_t|, which is taken into the metric

    N = I + sum of kappa w w^T,   w = L^T d_perp

so that L N^-1 L^T is what the other unknowns see. All of this costs (rows) (rank)^2 instead of (rows)^2 (rank).

Of the forces there are many then; `move_inside` chooses.

In `low_rank` are, by their first index, matrices with rows of length 3n: FACTOR, L^T; TILTED, C^-1 L^T with N = C C^T;
ROWS, the equations; BENT, these after what a projection does to its argument; and in BENT's last rows, from 3n on,
DUAL, MISSING, TARGET, NEAREST, STEP.
"""

from __future__ import annotations

from math import sqrt

from ..arrays import INTEGERS, REALS, array_type
from ..callback import separate_kernel
from ..jit import BOOLEAN, INTEGER, SEVERAL, kernel
from ..linalg import (
    complete_basis,
    factor_definite,
    inner,
    largest_pivot,
    least_norm,
    solve_definite,
    solve_lower,
    subtract_row,
)
from .cone import CONE, HUGE, LARGEST_FRICTION, RANK_TOLERANCE, SLIP, STICK
from .least_loads import least_loads

FACTOR, TILTED, ROWS, BENT = range(4)
DUAL, MISSING, TARGET, STEP, NEAREST = range(5)

# Springs stiffer than this are left to elimination without factors: at rest a direction of slip means nothing.
_STIFFEST = 1e6
# Forces are moved into cones of this part of the width, raised by this part of the mean load, the next after so many
# steps: wide margins are found in fewer steps, and last longer, but may not be there.
_AIMS = (0.9, 0.99, 0.999)
_MARGINS = (1e-2, 1e-3, 1e-4)
_STEPS = 10
# Part of the dual function's largest curvature that is added where projections have none.
_DAMPING = 1e-3
# A step that goes beyond its best point so far that the slope there is this part of the first is shortened, at most to
# this part.
_OVERSHOT, _SHORTEST = 0.5, 1e-2


@kernel
def spring(i, length, speed, sine):
    """kappa of a sliding contact, 0 for none; infinite where its direction is unknown."""
    reach = sine[i] * length[i]
    if reach > 0.0:
        return reach / speed[i] if speed[i] > 0.0 else HUGE
    return 0.0 if speed[i] > 0.0 or sine[i] == 0.0 else HUGE


@kernel
def has_factors(rank, unknowns, mu, modes, length, speed, sine):
    """Whether `low_rank_solve` can do Newton's step, and is cheaper; or chooses the loads, as where everything slides:
    the least ones, whatever the slips turn by."""
    stiffest = 0.0
    slides = True
    for i in range(mu.shape[0]):
        slides = slides and modes[i] != STICK
        if modes[i] == SLIP:
            stiffest = max(stiffest, spring(i, length, speed, sine))
    return rank > 0 and (slides or 2 * rank <= unknowns) and stiffest <= _STIFFEST


@kernel
def tilt_factor(cone, rank, source, modes):
    """The factor in the metric that the springs of turning slips make (module docstring), and, in shift (rank,), what
    their turning does; arc (n,): the springs."""
    direction, arc, shift, gram = cone.direction, cone.arc, cone.shift, cone.gram
    factor, tilted = cone.low_rank[FACTOR], cone.low_rank[TILTED]
    n = modes.shape[0]
    bent = False
    for i in range(n):
        arc[i] = spring(i, cone.length, cone.speed, cone.sine) if modes[i] == SLIP else 0.0
        bent = bent or arc[i] > 0.0
    for k in range(rank):
        shift[k] = 0.0
        for j in range(tilted.shape[1]):
            tilted[k, j] = factor[k, j]
    if not bent:
        return
    across = cone.rhs
    for k in range(rank):
        for j in range(k + 1):
            gram[k, j] = 1.0 if j == k else 0.0
    for i in range(n):
        if arc[i] > 0.0:
            for k in range(rank):
                across[k] = direction[2 * i] * factor[k, 3 * i + 1] - direction[2 * i + 1] * factor[k, 3 * i]
            for k in range(rank):
                subtract_row(gram[k, : k + 1], across[: k + 1], -arc[i] * across[k])
    factor_definite(gram, rank)
    solve_lower(gram, rank, tilted.shape[1], tilted)
    for i in range(n):
        if arc[i] > 0.0:
            d1 = direction[2 * i]
            d2 = direction[2 * i + 1]
            load = -arc[i] * (d1 * source[3 * i + 1] - d2 * source[3 * i])
            for k in range(rank):
                shift[k] += load * (d1 * tilted[k, 3 * i + 1] - d2 * tilted[k, 3 * i])


@kernel
def solve_product(rows, a, rhs, rank, unknowns, x):
    """Solve rows^T (a x) = rhs for a x, given rows and a (rank, unknowns); returns how many equations a x are left.

    Elimination with complete pivoting makes rows^T unit lower trapezoidal, while a takes the inverse steps; a x is in
    rhs then. x: scratch.
    """
    equations = 0
    largest = 0.0
    for k in range(min(rank, unknowns)):
        pivot, p, q = largest_pivot(rows, rank, k, 0, unknowns)
        largest = max(largest, pivot)
        if not pivot > RANK_TOLERANCE * largest:
            break
        equations += 1
        if p != k:
            for j in range(unknowns):
                rows[k, j], rows[p, j] = rows[p, j], rows[k, j]
                a[k, j], a[p, j] = a[p, j], a[k, j]
        pivot = rows[k, q]
        inverse = 1.0 / pivot
        for j in range(unknowns):
            rows[k, j] *= inverse
            a[k, j] *= pivot
        for i in range(k + 1, rank):
            share = rows[i, q]
            subtract_row(rows[i, :unknowns], rows[k, :unknowns], share)
            subtract_row(a[k, :unknowns], a[i, :unknowns], -share)
            rows[i, q] = 0.0
        x[k] = rhs[q]
        subtract_row(rhs[:unknowns], rows[k, :unknowns], x[k])
    for k in range(equations):
        rhs[k] = x[k]
    return equations


_VECTOR, _MODES = array_type(REALS, 1), array_type(INTEGERS, 1)


@separate_kernel(INTEGER, CONE.type, INTEGER, _VECTOR, _MODES, when=SEVERAL)
def low_rank_solve(cone, rank, source, modes):
    """Newton's step with the factors: x of least norm of what `first` counts, one unknown for a slip; returns its rank.

    source (3n,): what u is without x, see `newton_step`. `turn_slips` is the rest of the step.
    """
    direction, first, a, rhs, shift = cone.direction, cone.first, cone.system, cone.rhs, cone.shift
    tilted, rows = cone.low_rank[TILTED], cone.low_rank[ROWS]
    n = modes.shape[0]
    first[0] = 0
    for i in range(n):
        first[i + 1] = first[i] + (3 if modes[i] == STICK else 1 if modes[i] == SLIP else 0)
    unknowns = first[n]
    tilt_factor(cone, rank, source, modes)
    # equations rows^T a x = rhs
    for k in range(rank):
        t = tilted[k]
        for i in range(n):
            row = first[i]
            if modes[i] == STICK:
                for r in range(3):
                    rows[k, row + r] = t[3 * i + r]
                    a[k, row + r] = t[3 * i + r]
            elif modes[i] == SLIP:
                along = direction[2 * i] * t[3 * i] + direction[2 * i + 1] * t[3 * i + 1]
                rows[k, row] = t[3 * i + 2]
                a[k, row] = cone.cosine[i] * t[3 * i + 2] - cone.sine[i] * along
    for i in range(n):
        for r in range(first[i], first[i + 1]):
            rhs[r] = -source[3 * i + (r - first[i] if modes[i] == STICK else 2)]
    for k in range(rank):
        subtract_row(rhs[:unknowns], rows[k, :unknowns], shift[k])
    equations = solve_product(rows, a, rhs, rank, unknowns, cone.x)
    return least_norm(a, rhs, equations, unknowns, cone.x, cone.gram, cone.order, RANK_TOLERANCE)


@kernel
def turn_slips(cone, rank, source, mu, modes, f, refine):
    """arc (n,): by how much slips turn in a step of `low_rank_solve` to the forces in cone.row, not turned yet."""
    direction, length, speed, sine = cone.direction, cone.length, cone.speed, cone.sine
    aim, arc, shift, tilted = cone.row, cone.arc, cone.shift, cone.low_rank[TILTED]
    n = mu.shape[0]
    for k in range(rank):
        shift[k] += inner(tilted[k], aim, 3 * n)
        if refine:
            shift[k] -= inner(tilted[k], f, 3 * n)
    for i in range(n):
        arc[i] = 0.0
        if modes[i] == SLIP and mu[i] > 0.0:
            d1 = direction[2 * i]
            d2 = direction[2 * i + 1]
            across = d1 * source[3 * i + 1] - d2 * source[3 * i]
            for k in range(rank):
                across += shift[k] * (d1 * tilted[k, 3 * i + 1] - d2 * tilted[k, 3 * i])
            arc[i] = across * (sine[i] * length[i] + speed[i]) / speed[i]


@kernel
def is_inside(mu, modes, first, x):
    """Whether no unknown force leaves its cone."""
    for i in range(mu.shape[0]):
        row = first[i]
        if modes[i] == STICK:
            friction = min(mu[i], LARGEST_FRICTION)
            if not sqrt(x[row] ** 2 + x[row + 1] ** 2) <= friction * x[row + 2]:
                return False
        elif modes[i] == SLIP and not x[row] >= 0.0:
            return False
    return True


@kernel
def project(mu, modes, first, z, aim, margin, p):
    """p, the nearest to z in cones that are narrower by the factor aim and begin at a normal force of margin."""
    for i in range(mu.shape[0]):
        row = first[i]
        if modes[i] == STICK:
            friction = aim * min(mu[i], LARGEST_FRICTION)
            normal = z[row + 2] - margin
            tangential = sqrt(z[row] ** 2 + z[row + 1] ** 2)
            shrink = 1.0
            if tangential > friction * normal:
                normal = max((normal + friction * tangential) / (1.0 + friction * friction), 0.0)
                shrink = friction * normal / tangential if tangential > 0.0 else 0.0
            p[row] = shrink * z[row]
            p[row + 1] = shrink * z[row + 1]
            p[row + 2] = normal + margin
        elif modes[i] == SLIP:
            p[row] = max(z[row], margin)
            if first[i + 1] > row + 1:
                p[row + 1] = z[row + 1]


@kernel
def bend(rank, mu, modes, first, z, aim, margin, rows, bent):
    """bent, the rows (rank, unknowns) times the derivative of `project` at z."""
    for i in range(mu.shape[0]):
        row = first[i]
        if modes[i] == STICK:
            friction = aim * min(mu[i], LARGEST_FRICTION)
            normal = z[row + 2] - margin
            tangential = sqrt(z[row] ** 2 + z[row + 1] ** 2)
            inside = tangential <= friction * normal
            normal = max((normal + friction * tangential) / (1.0 + friction * friction), 0.0)
            d1 = z[row] / tangential if tangential > 0.0 else 1.0
            d2 = z[row + 1] / tangential if tangential > 0.0 else 0.0
            turn = friction * normal / tangential if tangential > 0.0 else 0.0
            share = 1.0 / (1.0 + friction * friction) if normal > 0.0 else 0.0
            for k in range(rank):
                r1 = rows[k, row]
                r2 = rows[k, row + 1]
                rn = rows[k, row + 2]
                if not inside:
                    along = share * (friction * (d1 * r1 + d2 * r2) + rn)
                    across = turn * (d1 * r2 - d2 * r1)
                    r1 = friction * along * d1 - across * d2
                    r2 = friction * along * d2 + across * d1
                    rn = along
                bent[k, row] = r1
                bent[k, row + 1] = r2
                bent[k, row + 2] = rn
        elif modes[i] == SLIP:
            for k in range(rank):
                bent[k, row] = rows[k, row] if z[row] > margin else 0.0
                if first[i + 1] > row + 1:
                    bent[k, row + 1] = rows[k, row + 1]


@kernel
def orthonormal_equations(cone, rank, unknowns):
    """The equations that `least_norm` has left in a and gram, as orthonormal rows (rank, unknowns) in ROWS, unknowns in
    their own order."""
    rows, a, gram, order = cone.low_rank[ROWS], cone.system, cone.gram, cone.order
    for k in range(rank):
        for j in range(unknowns):
            rows[k, order[j]] = a[k, j] if j >= k else 0.0
    solve_lower(gram, rank, unknowns, rows)


@kernel
def nearest_unknowns(cone, modes, last, slides, nearest):
    """The unknowns that are sought near: those of the forces last (3n,), none where everything slides. Returns the mean
    of the loads in x."""
    x, first, direction, sine, cosine = cone.x, cone.first, cone.direction, cone.sine, cone.cosine
    load = 0.0
    loads = 0
    for i in range(modes.shape[0]):
        row = first[i]
        k = 3 * i
        if modes[i] == STICK:
            loads += 1
            load += abs(x[row + 2])
            for r in range(3):
                nearest[row + r] = last[k + r]
        elif modes[i] == SLIP:
            loads += 1
            load += abs(x[row])
            nearest[row] = 0.0
            if not slides:
                nearest[row] = cosine[i] * last[k + 2]
                nearest[row] -= sine[i] * (direction[2 * i] * last[k] + direction[2 * i + 1] * last[k + 1])
            if first[i + 1] > row + 1:
                nearest[row + 1] = x[row + 1]
    return load / loads


@kernel
def find_least(cone, rank, modes):
    """Move x, a solution of the orthonormal equations, to the least loads that are not negative, where everything
    slides; False where there are none. Slips turn as far as they do in x, as nearly as may be."""
    n, rows, bent, unknowns = modes.shape[0], cone.low_rank[ROWS], cone.low_rank[BENT], cone.first[modes.shape[0]]
    bounded, x, scratch = cone.row[:unknowns], cone.x[:unknowns], bent[3 * n :]
    away = scratch[NEAREST]
    for j in range(unknowns):
        bounded[j] = 0.0
    for i in range(n):
        if modes[i] == SLIP:
            bounded[cone.first[i]] = 1.0
    complete_basis(rows, rank, unknowns)
    # the nearest to those, whatever the signs
    for j in range(unknowns):
        away[j] -= x[j]
    for k in range(rank, unknowns):
        subtract_row(x, rows[k], -inner(rows[k], away, unknowns))
    return least_loads(rows[rank:unknowns], bounded, x, cone.order, bent, scratch)


@separate_kernel(BOOLEAN, CONE.type, INTEGER, _VECTOR, _MODES, _VECTOR, when=SEVERAL)
def move_inside(cone, rank, mu, modes, last):
    """Move redundant forces that are outside their cones into them, along the null space of Newton's last matrix.

    Sought is the solution of the equations R x = t that is nearest to the forces `last` (3n,) in cones a little
    narrower: x = P(last + R^T y) with P the projection onto these, and as many unknowns y as there are equations.
    R P = t is the gradient of a convex function of y, whose zero Newton's method finds (semismooth: P has kinks) in
    three or four steps, each x corrected to fulfil the equations, until it is inside. Where the cones leave no such
    margin, as little as there is of it the last forces had: they are corrected in the same way.
    Where everything slides, the loads move the bodies: there is one rule, the least ones that are not negative.
    What is moved is x, of forces and lengths, not of their changes; rank, and a, gram, order, first, as the solution
    left them, rank below the number of unknowns. Returns whether the result depends on the last forces.
    """
    x, p, z, gram, first, low_rank = cone.x, cone.rhs, cone.row, cone.gram, cone.first, cone.low_rank
    n = mu.shape[0]
    unknowns = first[n]
    if is_inside(mu, modes, first, x):
        return False
    rows = low_rank[ROWS]
    bent = low_rank[BENT]
    scratch = bent[3 * n :]
    y = scratch[DUAL]
    missing = scratch[MISSING]
    target = scratch[TARGET]
    nearest = scratch[NEAREST]
    change = scratch[STEP]
    orthonormal_equations(cone, rank, unknowns)
    for k in range(rank):
        target[k] = inner(rows[k], x, unknowns)
        y[k] = 0.0
    slides = unknowns > 0
    for i in range(n):
        slides = slides and modes[i] != STICK
    load = nearest_unknowns(cone, modes, last, slides, nearest)
    if slides:
        return not find_least(cone, rank, modes)
    slope = 0.0
    for step in range(len(_AIMS) * _STEPS):
        aim = _AIMS[step // _STEPS]
        if step % _STEPS == 0:
            slope = 0.0
        margin = _MARGINS[step // _STEPS] * load
        for j in range(unknowns):
            z[j] = nearest[j]
        for k in range(rank):
            subtract_row(z[:unknowns], rows[k, :unknowns], -y[k])
        project(mu, modes, first, z, aim, margin, p)
        for j in range(unknowns):
            x[j] = p[j]
        for k in range(rank):
            missing[k] = target[k] - inner(rows[k], p, unknowns)
            subtract_row(x[:unknowns], rows[k, :unknowns], -missing[k])
        if is_inside(mu, modes, first, x):
            return True
        ahead = inner(missing, change, rank)
        if slope > 0.0 and ahead < -_OVERSHOT * slope:
            share = max(slope / (slope - ahead), _SHORTEST)
            for k in range(rank):
                y[k] -= (1.0 - share) * change[k]
                change[k] *= share
            slope *= share
            continue
        bend(rank, mu, modes, first, z, aim, margin, rows, bent)
        for k in range(rank):
            for j in range(k + 1):
                gram[k, j] = inner(bent[k], rows[j], unknowns)
            gram[k, k] += _DAMPING
            change[k] = missing[k]
        factor_definite(gram, rank)
        solve_definite(gram, rank, change)
        for k in range(rank):
            y[k] += change[k]
        slope = inner(missing, change, rank)
    for j in range(unknowns):
        z[j] = nearest[j]
    for k in range(rank):
        subtract_row(z[:unknowns], rows[k, :unknowns], inner(rows[k], nearest, unknowns) - target[k])
    if is_inside(mu, modes, first, z):
        for j in range(unknowns):
            x[j] = z[j]
    return True
