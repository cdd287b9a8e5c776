"""Newton steps for contacts that are redundant: many rows, few directions in which the bodies move.

The Delassus matrix (3n, 3n) of rank r is G = L L^T with L (3n, r), and Newton's matrix, sliding contacts included, is a
product of factors as narrow. Where a sliding contact turns, -|u_t| stands on the diagonal, too: the turning is a spring
across the direction of slip, kappa = |F_t| / |u_t|, which is taken into the metric

    N = I + sum of kappa w w^T,   w = L^T d_perp

so that L N^-1 L^T is what the other unknowns see. All of this costs (rows) (rank)^2 instead of (rows)^2 (rank). In
`low_rank` are, by their first index, matrices with rows of length 3n: FACTOR, L^T; TILTED, C^-1 L^T with N = C C^T;
ROWS, what is left of the equations in elimination.

Of the forces there are many then; `move_inside` chooses.
"""

from __future__ import annotations

from math import sqrt

from ..jit import kernel
from .cone import HUGE, LARGEST_FRICTION, RANK_TOLERANCE, SLIP, STICK
from .elimination import dot, largest_entry, least_norm, solve_gram, subtract_row

FACTOR, TILTED, ROWS = 0, 1, 2

# Springs stiffer than this are left to elimination without factors: at rest a direction of slip means nothing.
STIFFEST = 1e6
# Projections onto cones and equations by turns, the part of the cones' width that is aimed at, and how much further
# than to the projection a step goes, of sticking and of sliding contacts: more than 2 ends sooner in wide sets.
PROJECTIONS = 30
AIM, RELAXATION, PUSH = 0.98, 2.5, 4.0


@kernel
def factor_matrix(g, factor, rest):
    """Rows (r, 3n) of L^T in factor, largest pivots first; returns r, or 0 if factor has too few rows for that.

    g (3n, 3n): scaled Delassus matrix; rest (3n,): scratch.
    """
    rows = g.shape[0]
    for j in range(rows):
        rest[j] = g[j, j]
    largest = 0.0
    for k in range(factor.shape[0]):
        pivot = 0.0
        p = 0
        for j in range(rows):
            if rest[j] > pivot:
                pivot = rest[j]
                p = j
        largest = max(largest, pivot)
        if not pivot > RANK_TOLERANCE * largest:
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
def spring(i, length, speed, sine):
    """kappa of a sliding contact, 0 for none; infinite where its direction is unknown."""
    reach = sine[i] * length[i]
    if reach > 0.0:
        return reach / speed[i] if speed[i] > 0.0 else HUGE
    return 0.0 if speed[i] > 0.0 or sine[i] == 0.0 else HUGE


@kernel
def has_factors(rank, unknowns, mu, modes, length, speed, sine):
    """Whether `low_rank_solve` can do Newton's step, and is cheaper."""
    if rank == 0 or 2 * rank > unknowns:
        return False
    stiffest = 0.0
    for i in range(mu.shape[0]):
        if modes[i] == SLIP:
            stiffest = max(stiffest, spring(i, length, speed, sine))
    return stiffest <= STIFFEST


@kernel
def low_rank_solve(rank, source, mu, modes, buffers):
    """Newton's step with the factors: x of least norm of what `first` counts, one unknown for a slip; returns its rank.

    source (3n,): what u is without x, see `newton_step`. `turn_slips` is the rest of the step.
    """
    (
        direction, length, speed, sine, cosine, a, rhs, x, _, gram, order, first, arc, shift, low_rank,
    ) = buffers[1:]  # fmt: skip
    n = mu.shape[0]
    factor = low_rank[FACTOR]
    tilted = low_rank[TILTED]
    rows = low_rank[ROWS]
    first[0] = 0
    bent = False
    for i in range(n):
        first[i + 1] = first[i] + (3 if modes[i] == STICK else 1 if modes[i] == SLIP else 0)
        arc[i] = 0.0
        if modes[i] == SLIP:
            arc[i] = spring(i, length, speed, sine)
            bent = bent or arc[i] > 0.0
    unknowns = first[n]

    # metric, and the factor in it
    for k in range(rank):
        shift[k] = 0.0
        for j in range(tilted.shape[1]):
            tilted[k, j] = factor[k, j]
    if bent:
        for k in range(rank):
            for j in range(k + 1):
                gram[k, j] = 1.0 if j == k else 0.0
        for i in range(n):
            if arc[i] > 0.0:
                for k in range(rank):
                    rhs[k] = direction[2 * i] * factor[k, 3 * i + 1] - direction[2 * i + 1] * factor[k, 3 * i]
                for k in range(rank):
                    subtract_row(gram[k, : k + 1], rhs[: k + 1], -arc[i] * rhs[k])
        for k in range(rank):
            for j in range(k + 1):
                total = gram[k, j] - dot(gram[k, :j], gram[j, :j])
                gram[k, j] = sqrt(total) if j == k else total / gram[j, j]
            for j in range(k):
                subtract_row(tilted[k], tilted[j], gram[k, j])
            inverse = 1.0 / gram[k, k]
            for j in range(tilted.shape[1]):
                tilted[k, j] *= inverse
        for i in range(n):
            if arc[i] > 0.0:
                d1 = direction[2 * i]
                d2 = direction[2 * i + 1]
                load = -arc[i] * (d1 * source[3 * i + 1] - d2 * source[3 * i])
                for k in range(rank):
                    shift[k] += load * (d1 * tilted[k, 3 * i + 1] - d2 * tilted[k, 3 * i])

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
                a[k, row] = cosine[i] * t[3 * i + 2] - sine[i] * along
    for i in range(n):
        for r in range(first[i], first[i + 1]):
            rhs[r] = -source[3 * i + (r - first[i] if modes[i] == STICK else 2)]
    for k in range(rank):
        subtract_row(rhs[:unknowns], rows[k, :unknowns], shift[k])

    # Elimination with complete pivoting makes rows^T unit lower trapezoidal and solves with it, for a x (in x).
    equations = 0
    largest = 0.0
    for k in range(min(rank, unknowns)):
        pivot = -1.0
        p = k
        for i in range(k, rank):
            size = largest_entry(rows[i, :unknowns])
            if size > pivot:
                pivot = size
                p = i
        largest = max(largest, pivot)
        if not pivot > RANK_TOLERANCE * largest:
            break
        equations += 1
        if p != k:
            for j in range(unknowns):
                swap = rows[k, j]
                rows[k, j] = rows[p, j]
                rows[p, j] = swap
                swap = a[k, j]
                a[k, j] = a[p, j]
                a[p, j] = swap
        q = 0
        while q < unknowns - 1 and abs(rows[k, q]) != pivot:
            q += 1
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
    return least_norm(a, rhs, equations, unknowns, x, gram, order, RANK_TOLERANCE)


@kernel
def turn_slips(rank, source, mu, modes, f, refine, buffers):
    """arc (n,): by how much slips turn in a step of `low_rank_solve` to the forces in buffers[9], not turned yet."""
    direction, length, speed, sine = buffers[1:5]
    aim = buffers[9]
    arc, shift, low_rank = buffers[13:]
    n = mu.shape[0]
    tilted = low_rank[TILTED]
    for k in range(rank):
        shift[k] += dot(tilted[k], aim)
        if refine:
            shift[k] -= dot(tilted[k], f)
    for i in range(n):
        arc[i] = 0.0
        if modes[i] == SLIP and mu[i] > 0.0 and speed[i] > 0.0:
            d1 = direction[2 * i]
            d2 = direction[2 * i + 1]
            across = d1 * source[3 * i + 1] - d2 * source[3 * i]
            for k in range(rank):
                across += shift[k] * (d1 * tilted[k, 3 * i + 1] - d2 * tilted[k, 3 * i])
            arc[i] = across * (sine[i] * length[i] + speed[i]) / speed[i]


@kernel
def move_inside(rank, mu, modes, last, refine, buffers):
    """Move redundant forces that are outside their cones into them, along the null space of Newton's last matrix.

    From the solution nearest to the forces `last` (3n,), by projections onto narrower cones and the equations by turns:
    few will do, and the forces stay inside when loads change. What is moved is x, of forces and lengths, not of their
    changes; rank, and a, gram, order, first, as the solution left them, rank below the number of unknowns.
    refine: x is the nearest solution already.
    """
    direction, _, _, sine, cosine, a, change, x, inner, gram, order, first = buffers[1:13]
    n = mu.shape[0]
    unknowns = first[n]
    ordered = gram[rank]
    for turn in range(PROJECTIONS):
        inside = True
        for j in range(unknowns):
            change[j] = 0.0
        nearest = turn == 0 and not refine
        for i in range(n):
            row = first[i]
            k = 3 * i
            if modes[i] == STICK:
                tangential = sqrt(x[row] ** 2 + x[row + 1] ** 2)
                friction = min(mu[i], LARGEST_FRICTION)
                inside = inside and tangential <= friction * x[row + 2]
                friction *= AIM
                if nearest:
                    for r in range(3):
                        change[row + r] = last[k + r] - x[row + r]
                elif tangential > friction * x[row + 2]:
                    normal = max((x[row + 2] + friction * tangential) / (1.0 + friction * friction), 0.0)
                    shrink = friction * normal / tangential - 1.0 if tangential > 0.0 else 0.0
                    change[row] = RELAXATION * shrink * x[row]
                    change[row + 1] = RELAXATION * shrink * x[row + 1]
                    change[row + 2] = RELAXATION * (normal - x[row + 2])
            elif modes[i] == SLIP:
                inside = inside and x[row] >= 0.0
                if nearest:
                    along = direction[2 * i] * last[k] + direction[2 * i + 1] * last[k + 1]
                    change[row] = cosine[i] * last[k + 2] - sine[i] * along - x[row]
                else:
                    change[row] = PUSH * max(-x[row], 0.0)
        if inside:
            break
        # what of the change is in the row space would violate the equations
        for j in range(unknowns):
            ordered[j] = change[order[j]]
        for i in range(rank):
            inner[i] = dot(a[i, i:unknowns], ordered[i:unknowns])
        solve_gram(gram, rank, inner)
        for i in range(rank):
            subtract_row(ordered[i:unknowns], a[i, i:unknowns], inner[i])
        for j in range(unknowns):
            x[order[j]] += ordered[j]
