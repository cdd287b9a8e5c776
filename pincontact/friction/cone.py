"""Coulomb's law at n contacts as a second-order-cone complementarity problem, solved to round-off (Sec. 5.3).

Contact i has three rows in the order (t1, t2, n), orthonormal. Given the Delassus matrix G (3n, 3n), symmetric
positive semidefinite, b (3n,) and mu (n,), the forces F and u = G F + b (relative accelerations, or velocities
if F are impulses) satisfy at every contact one of

    open   F = 0,             u_n >= 0
    stick  |F_t| <= mu F_n,   u = 0
    slip   F_t = -mu F_n d,   u = (s d, 0),  |d| = 1, s >= 0

which is the complementarity of F in the cone K = {|F_t| <= mu F_n} with u + mu |u_t| n in the dual cone (De
Saxce's correction). An infinite mu is the limit of large ones: u_t = 0 wherever F_n > 0; the limit leaves one more
state, a slip that is held up by friction alone, F_n = 0 and F_t = -|F_t| d.

What is solved here is a Newton iteration on the equations of given modes, with the modes corrected as it goes,
and the judge of the result. Where the modes come from is the business of `solve`.

Scaling. Everything below runs on a problem without units: the forces of contact i are divided by s_i and its u
multiplied by it, s_i = (trace(G_ii) / 3)^(-1/2), which leaves the cones as they are and makes the diagonal blocks
unit-sized; then b is divided by its largest entry.

Judge. The residual is that of the two projections

    F_n - max(F_n - u_n, 0)     and     F_t - P_D(F_t - u_t),   D the disk of radius mu max(F_n, 0),

which vanish together exactly where F - P_K(F - (u + mu |u_t| n)) does but, unlike that, stay well-conditioned for
large mu. It is taken relative to |b_i| + sum_j |G_ij| |F_j|, the size of the terms that cancel in it, with a floor at
`FLOOR` times the largest of these over the contacts, and a cap at `CANCELLATION` times the largest b, so that forces
growing without bound do not pass for a solution. Hence it does not depend on units.
"""

from __future__ import annotations

from math import atan2, cos, inf, pi, sin, sqrt

from ..jit import REAL, entry_kernel, kernel
from ..memory import Memory

OPEN, STICK, SLIP = 0, 1, 2

# A contact whose forces and velocities are this much smaller than another's is judged on the other's scale.
FLOOR = 1e-5
# Forces this much larger than what b asks for are only accepted if u is as accurate as without them.
CANCELLATION = 1e4
# Newton stops below this residual at once; above it, when a pass no longer improves the residual.
ROUND_OFF = 1e-14
# A pivot this much below the largest one is a redundant direction: Delassus matrices carry round-off at 1e-15.
RANK_TOLERANCE = 1e-12
# A slip speed this far below zero (scaled) turns slip into stick; less is round-off on a redundant contact.
SPEED_TOLERANCE = 1e-12
# Relative changes of the forces above this are a new choice among redundant forces, below it a refinement.
REFINEMENT = 1e-2
# Projections onto cones and equations by turns, the part of the cones' width that is aimed at, and how much further
# than to the projection a step goes, of sticking and of sliding contacts: more than 2 ends sooner in wide sets.
PROJECTIONS = 30
AIM, RELAXATION, PUSH = 0.98, 2.5, 4.0
# Directions tried in the scan for a single contact's slip; the function scanned has four zeros at most.
SCAN = 64
CANDIDATES = 12
HUGE = 1e300
# Outside this range a cone is too flat or too steep to tell modes by; Newton uses the true coefficient.
LEAST_FRICTION, LARGEST_FRICTION = 1e-6, 1e2
# Larger coefficients make the QP's facets too steep for it; the modes found are then corrected by Newton.
QP_FRICTION = 100.0


# Arrays that `attempt.solve_cones` works in, by slot of its table of addresses.
SLOTS = (
    "modes",  # (n,) int: in and out
    "forces",  # (3n,): in and out
    "velocities",  # (3n,): in and out
    "counts",  # (COUNTS_LENGTH,) int: see below
    "reached",  # (1,): out, the least residual where it is above the tolerance
    "scaled",  # (3n, 3n) the Delassus matrix without units
    "system",  # (3n + 1, 3n + 1) Newton's matrix
    "gram",  # (3n + 1, 3n + 1)
    "vectors",  # (8, 3n)
    "scalars",  # (7, n)
    "directions",  # (2n,) of slip
    "angles",  # (CANDIDATES,)
    "order",  # (3n + 1,) int: permutation of the elimination
    "first",  # (n + 1,) int: first unknown of each contact
    "trial",  # (3, n) int: modes tried, modes started from, which contacts touched
    "path",  # (8, 3n + 1) point, tangent, ... of `path.follow_path`
    "solver",  # machine code of `attempt.cones_at`, not an array
)
(
    MODES, FORCES, VELOCITIES, COUNTS, REACHED, SCALED, SYSTEM, GRAM, VECTORS, SCALARS, DIRECTIONS, ANGLES, ORDER,
    FIRST, TRIAL, PATH, SOLVER,
) = range(len(SLOTS))  # fmt: skip
# In "counts": Newton passes of the last start; whether modes and forces are a solution, to begin from; what decided the
# last problem; how often there was something to begin from, and how often each of the deciders did.
PASSES, KNOWN, DECIDED, TRIED, TIMES = range(5)
DECIDERS = ("warm", "exact", "sweeps", "path", "qp")
BY_WARM, BY_EXACT, BY_SWEEPS, BY_PATH, BY_QP = range(len(DECIDERS))
COUNTS_LENGTH = TIMES + len(DECIDERS)


def cone_memory(contacts: int) -> Memory:
    """The arrays of `SLOTS` for problems of this many contacts; modes start as STICK, everything else as zero."""
    rows = 3 * contacts
    memory = Memory(SLOTS)
    memory.integers("modes", contacts)[:] = STICK
    memory.reals("forces", rows)
    memory.reals("velocities", rows)
    memory.integers("counts", COUNTS_LENGTH)
    memory.reals("reached", 1)
    memory.reals("scaled", rows, rows)
    memory.reals("system", rows + 1, rows + 1)
    memory.reals("gram", rows + 1, rows + 1)
    memory.reals("vectors", 8, rows)
    memory.reals("scalars", 7, contacts)
    memory.reals("directions", 2 * contacts)
    memory.reals("angles", CANDIDATES)
    memory.integers("order", rows + 1)
    memory.integers("first", contacts + 1)
    memory.integers("trial", 3, contacts)
    memory.reals("path", 8, rows + 1)
    return memory


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
    for j in range(0, n - 3, 4):
        first = max(first, abs(x[j]))
        second = max(second, abs(x[j + 1]))
        third = max(third, abs(x[j + 2]))
        fourth = max(fourth, abs(x[j + 3]))
    for j in range(n - n % 4, n):
        first = max(first, abs(x[j]))
    return max(max(first, second), max(third, fourth))


@kernel
def minimum_norm_solve(a, rhs, n, x, gram, order, tolerance):
    """x (n,) of least norm with a x = rhs for a consistent system that may be singular; returns the rank.

    Elimination with complete pivoting, stopped at the first pivot below tolerance times the largest, then least
    norm in the row space; tolerance 0 says that a is regular, and rows alone are exchanged. a and gram are
    (>= n, >= n); a and rhs (n,) are overwritten, gram and order (n,) are scratch.
    """
    for j in range(n):
        order[j] = j
    largest = 0.0
    rank = 0
    for k in range(n):
        pivot = -1.0
        p = k
        q = k
        for i in range(k, n):
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
        if p != k:
            for j in range(n):
                swap = a[k, j]
                a[k, j] = a[p, j]
                a[p, j] = swap
            swap = rhs[k]
            rhs[k] = rhs[p]
            rhs[p] = swap
        if q != k:
            for i in range(n):
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
        for i in range(k + 1, n):
            factor = a[i, k]
            if factor != 0.0:
                subtract_row(a[i, k:n], a[k, k:n], factor)
                rhs[i] -= factor * rhs[k]

    # Now the first `rank` rows of a are unit upper trapezoidal.
    if rank == n:
        for k in range(n - 1, -1, -1):
            total = rhs[k]
            for j in range(k + 1, n):
                total -= a[k, j] * rhs[j]
            rhs[k] = total
        for j in range(n):
            x[order[j]] = rhs[j]
        return rank
    for i in range(rank):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, n):
                total += a[i, k] * a[j, k]
            for k in range(j):
                total -= gram[i, k] * gram[j, k]
            if i == j:
                gram[i, i] = sqrt(total)
            else:
                gram[i, j] = total / gram[j, j]
    for i in range(rank):
        for k in range(i):
            rhs[i] -= gram[i, k] * rhs[k]
        rhs[i] /= gram[i, i]
    for i in range(rank - 1, -1, -1):
        for k in range(i + 1, rank):
            rhs[i] -= gram[k, i] * rhs[k]
        rhs[i] /= gram[i, i]
    for j in range(n):
        total = 0.0
        for k in range(min(j + 1, rank)):
            total += a[k, j] * rhs[k]
        x[order[j]] = total
    return rank


@kernel
def scale_problem(delassus, b, n, scaled, c, scale):
    """Write the problem without units; returns the factor taken out of b.

    delassus (3n, 3n), b (3n,): the problem; scaled (3n, 3n), c (3n,), scale (n,): output.
    """
    for i in range(n):
        trace = delassus[3 * i, 3 * i] + delassus[3 * i + 1, 3 * i + 1] + delassus[3 * i + 2, 3 * i + 2]
        scale[i] = sqrt(3.0 / trace) if trace > 0.0 else 1.0
    largest = 0.0
    for i in range(n):
        for r in range(3):
            c[3 * i + r] = scale[i] * b[3 * i + r]
            largest = max(largest, abs(c[3 * i + r]))
    if largest == 0.0:
        largest = 1.0
    for i in range(3 * n):
        c[i] /= largest
        s = scale[i // 3]
        for j in range(n):
            product = s * scale[j]
            scaled[i, 3 * j] = product * delassus[i, 3 * j]
            scaled[i, 3 * j + 1] = product * delassus[i, 3 * j + 1]
            scaled[i, 3 * j + 2] = product * delassus[i, 3 * j + 2]
    return largest


@kernel
def respond(g, c, f, u, size):
    """u = g f + c (3n,); in size (n,), per contact, the sum of the absolute terms in u."""
    n = c.shape[0] // 3
    for i in range(n):
        size[i] = 0.0
        for r in range(3 * i, 3 * i + 3):
            total = c[r]
            absolute = abs(c[r])
            for j in range(3 * n):
                term = g[r, j] * f[j]
                total += term
                absolute += abs(term)
            u[r] = total
            # A sum, through which what is not a number gets to the judge.
            size[i] += absolute


@kernel
def contact_residual(f1, f2, fn, u1, u2, un, mu):
    """Residual of the two projections (module docstring) at one contact, in the units of f and u."""
    # The same as |fn - max(fn - un, 0)|, but not lost in the rounding of a huge force.
    normal = abs(min(fn, un))
    p1 = f1 - u1
    p2 = f2 - u2
    length = sqrt(p1 * p1 + p2 * p2)
    if mu < HUGE:
        radius = mu * max(fn, 0.0)
        if length <= radius:
            return max(normal, sqrt(u1 * u1 + u2 * u2))
        shrink = radius / length
        return max(normal, sqrt((f1 - shrink * p1) ** 2 + (f2 - shrink * p2) ** 2))
    stuck = sqrt(u1 * u1 + u2 * u2)
    # Infinite mu at F_n = 0: the disk may have any radius while u_n = 0 too, and none otherwise.
    radius = sqrt(f1 * f1 + f2 * f2)
    shrink = radius / length if length > radius else 1.0
    sliding = sqrt((f1 - shrink * p1) ** 2 + (f2 - shrink * p2) ** 2)
    limit = max(max(abs(fn), min(radius, abs(un))), sliding)
    return max(normal, min(stuck, limit)) if fn > 0.0 else max(normal, limit)


@kernel
def judge(mu, f, u, size):
    """Largest relative residual over the contacts (module docstring); infinite if anything is not finite."""
    n = mu.shape[0]
    largest = 0.0
    for i in range(n):
        if not size[i] < HUGE:
            return inf
        largest = max(largest, size[i])
    worst = 0.0
    for i in range(n):
        k = 3 * i
        residual = contact_residual(f[k], f[k + 1], f[k + 2], u[k], u[k + 1], u[k + 2], mu[i])
        if not residual < HUGE:
            return inf
        if residual > 0.0:
            worst = max(worst, residual / min(max(size[i], FLOOR * largest), CANCELLATION))
    return worst


@kernel
def cone_angle(mu):
    """Sine and cosine of the cone's half angle: a force on its boundary is x (-sine d, cosine)."""
    if mu < HUGE:
        cosine = 1.0 / sqrt(1.0 + mu * mu)
        return mu * cosine, cosine
    return 1.0, 0.0


@kernel
def start_slip(k, mu, f, u, direction, i):
    """Put the direction with which Newton starts a slip into row i; returns the force's length and the speed."""
    sine, cosine = cone_angle(mu)
    d1 = u[k] - f[k]
    d2 = u[k + 1] - f[k + 1]
    length = sqrt(d1 * d1 + d2 * d2)
    if length > 0.0:
        d1 /= length
        d2 /= length
    else:
        d1 = 1.0
        d2 = 0.0
    direction[2 * i] = d1
    direction[2 * i + 1] = d2
    x = f[k + 2] * cosine - (d1 * f[k] + d2 * f[k + 1]) * sine
    return max(x, 0.0), max(d1 * u[k] + d2 * u[k + 1], 0.0)


@kernel
def classify(mu, f, u, modes):
    """Modes (n,) suggested by approximate forces and velocities: where the projections of the judge land."""
    n = mu.shape[0]
    for i in range(n):
        k = 3 * i
        p1 = f[k] - u[k]
        p2 = f[k + 1] - u[k + 1]
        if not f[k + 2] > u[k + 2]:
            modes[i] = OPEN
        elif mu[i] > 0.0 and sqrt(p1 * p1 + p2 * p2) <= min(mu[i], LARGEST_FRICTION) * f[k + 2]:
            modes[i] = STICK
        else:
            modes[i] = SLIP


@kernel
def turn_direction(direction, i, arc, radius):
    """Turn the direction in row i by an arc."""
    if radius > 0.0:
        d1 = direction[2 * i]
        d2 = direction[2 * i + 1]
        turn = arc / radius
        norm = sqrt(1.0 + turn * turn)
        direction[2 * i] = (d1 - turn * d2) / norm
        direction[2 * i + 1] = (d2 + turn * d1) / norm


@kernel
def newton_step(g, c, mu, modes, f, u, refine, buffers):
    """One Newton step on the equations of the modes; f (3n,) is updated, and the slips' directions and lengths.

    Unknown are f at sticking contacts and, at slipping ones, the length of the force and its turning (as an arc).
    With refine false the forces solved for have least norm; with refine true their change has.
    """
    direction, length, speed, sine, cosine, a, rhs, x, row_of_g, gram, order, first = buffers[1:]
    n = mu.shape[0]
    first[0] = 0
    for i in range(n):
        unknowns = 0
        if modes[i] == STICK:
            unknowns = 3
        elif modes[i] == SLIP:
            unknowns = 2 if mu[i] > 0.0 else 1
        first[i + 1] = first[i] + unknowns
    if first[n] == 0:
        for k in range(3 * n):
            f[k] = 0.0
        return first[n]

    source = u if refine else c
    for i in range(n):
        k = 3 * i
        for r in range(first[i + 1] - first[i]):
            row = first[i] + r
            d1 = 0.0
            d2 = 1.0
            p = k + r
            q = k + r
            if modes[i] == SLIP:
                p = k + 2
                q = k + 2
                if r == 1:
                    # The row of d turned by a right angle: d_perp . u_t = 0.
                    d1 = direction[2 * i]
                    d2 = -direction[2 * i + 1]
                    p = k + 1
                    q = k
            rhs[row] = -(d1 * source[p] + d2 * source[q])
            for j in range(3 * n):
                row_of_g[j] = d1 * g[p, j] + d2 * g[q, j]
            for j in range(n):
                m = 3 * j
                column = first[j]
                if modes[j] == STICK:
                    a[row, column] = row_of_g[m]
                    a[row, column + 1] = row_of_g[m + 1]
                    a[row, column + 2] = row_of_g[m + 2]
                elif modes[j] == SLIP:
                    e1 = direction[2 * j]
                    e2 = direction[2 * j + 1]
                    along = row_of_g[m] * e1 + row_of_g[m + 1] * e2
                    a[row, column] = cosine[j] * row_of_g[m + 2] - sine[j] * along
                    if mu[j] > 0.0:
                        reach = sine[j] * length[j]
                        total = reach + speed[j]
                        across = row_of_g[m] * e2 - row_of_g[m + 1] * e1
                        turned = reach * across
                        if i == j and r == 1:
                            # u_t = speed d turns too.
                            turned -= speed[j]
                        a[row, column + 1] = turned / total if total > 0.0 else 0.0

    rank = minimum_norm_solve(a, rhs, first[n], x, gram, order, RANK_TOLERANCE)

    for i in range(n):
        k = 3 * i
        row = first[i]
        if modes[i] == OPEN:
            f[k] = 0.0
            f[k + 1] = 0.0
            f[k + 2] = 0.0
        elif modes[i] == STICK:
            for r in range(3):
                f[k + r] = x[row + r] + (f[k + r] if refine else 0.0)
        else:
            total = sine[i] * length[i] + speed[i]
            length[i] = x[row] + (length[i] if refine else 0.0)
            if mu[i] > 0.0:
                turn_direction(direction, i, x[row + 1], total)
                # the arc's radius, which `ease` needs
                x[row + 1] = total
            f[k] = -sine[i] * length[i] * direction[2 * i]
            f[k + 1] = -sine[i] * length[i] * direction[2 * i + 1]
            f[k + 2] = cosine[i] * length[i]
    return first[n] - rank


@kernel
def correct_modes(mu, modes, f, u, direction, length, speed):
    """Change the modes that the forces and velocities contradict; returns how many were changed."""
    n = mu.shape[0]
    changes = 0
    for i in range(n):
        k = 3 * i
        if modes[i] == OPEN:
            if u[k + 2] < 0.0:
                modes[i] = STICK if mu[i] > 0.0 else SLIP
                length[i] = 0.0
                changes += 1
        elif modes[i] == STICK:
            if f[k + 2] < 0.0:
                modes[i] = OPEN
                changes += 1
            elif f[k] ** 2 + f[k + 1] ** 2 > (mu[i] * f[k + 2]) ** 2:
                modes[i] = SLIP
                length[i], speed[i] = start_slip(k, mu[i], f, u, direction, i)
                changes += 1
        else:
            speed[i] = direction[2 * i] * u[k] + direction[2 * i + 1] * u[k + 1]
            if length[i] < 0.0:
                modes[i] = OPEN
                changes += 1
            elif mu[i] > 0.0 and speed[i] < -SPEED_TOLERANCE:
                modes[i] = STICK
                changes += 1
            speed[i] = max(speed[i], 0.0)
    return changes


@kernel
def ease(mu, modes, f, direction, length, last, rank, a, gram, order, first, x, change, inner):
    """Move redundant forces that are outside their cones into them, along the null space of Newton's last matrix.

    From the solution nearest to the forces `last` (3n,), by projections onto narrower cones and the equations by turns:
    few will do, and the forces stay inside when loads change. f (3n,) and length (n,) are updated. rank, a, gram,
    order, x: as `newton_step` left them, of rank below the number of unknowns; change, inner (>= that many): scratch.
    """
    n = mu.shape[0]
    unknowns = first[n]
    for i in range(n):
        row = first[i]
        if modes[i] == STICK:
            for r in range(3):
                x[row + r] = f[3 * i + r]
        elif modes[i] == SLIP:
            x[row] = length[i]
            if mu[i] > 0.0:
                f[3 * i] = x[row + 1]
                x[row + 1] = 0.0
    for turn in range(PROJECTIONS):
        inside = True
        for j in range(unknowns):
            change[j] = 0.0
        for i in range(n):
            row = first[i]
            k = 3 * i
            if modes[i] == STICK:
                tangential = sqrt(x[row] ** 2 + x[row + 1] ** 2)
                friction = min(mu[i], LARGEST_FRICTION)
                inside = inside and tangential <= friction * x[row + 2]
                friction *= AIM
                if turn == 0:
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
                if turn == 0:
                    sine, cosine = cone_angle(mu[i])
                    along = direction[2 * i] * last[k] + direction[2 * i + 1] * last[k + 1]
                    change[row] = cosine * last[k + 2] - sine * along - x[row]
                else:
                    change[row] = PUSH * max(-x[row], 0.0)
        if inside:
            break
        # what of the change is in the row space would violate the equations
        for i in range(rank):
            total = 0.0
            for j in range(i, unknowns):
                total += a[i, j] * change[order[j]]
            for k in range(i):
                total -= gram[i, k] * inner[k]
            inner[i] = total / gram[i, i]
        for i in range(rank - 1, -1, -1):
            total = inner[i]
            for k in range(i + 1, rank):
                total -= gram[k, i] * inner[k]
            inner[i] = total / gram[i, i]
        for i in range(rank):
            for j in range(i, unknowns):
                change[order[j]] -= inner[i] * a[i, j]
        for j in range(unknowns):
            x[j] += change[j]
    for i in range(n):
        row = first[i]
        k = 3 * i
        if modes[i] == STICK:
            for r in range(3):
                f[k + r] = x[row + r]
        elif modes[i] == SLIP:
            if mu[i] > 0.0:
                turn_direction(direction, i, x[row + 1], f[k])
            sine, cosine = cone_angle(mu[i])
            length[i] = x[row]
            f[k] = -sine * length[i] * direction[2 * i]
            f[k + 1] = -sine * length[i] * direction[2 * i + 1]
            f[k + 2] = cosine * length[i]


@kernel
def close_touching(mu, modes, touching):
    """Stick for contacts that were at rest, and slip for others that touched; whether that changes any mode.

    Among redundant contacts modes of such are a matter of choice: for a force on its cone's edge, or none, there may be
    one inside. touching (n,): 0 for contacts that had a normal velocity, 1 for a tangential one alone, 2 for none.
    """
    n = mu.shape[0]
    changed = False
    for i in range(n):
        mode = modes[i]
        if touching[i] == 2 and mu[i] > 0.0:
            mode = STICK
        elif touching[i] > 0 and mode == OPEN:
            mode = SLIP
        changed = changed or mode != modes[i]
        modes[i] = mode
    return changed


@kernel
def slip_equation(g, c, mu, angle):
    """At one contact (3 x 3) slipping along d(angle): d_perp . u_t = 0, freed of fractions.

    The force length x that makes u_n = 0 is -c_n / stiffness; returns (equation, stiffness, d1, d2).
    """
    sine, cosine = cone_angle(mu)
    d1 = cos(angle)
    d2 = sin(angle)
    push1 = cosine * g[0, 2] - sine * (g[0, 0] * d1 + g[0, 1] * d2)
    push2 = cosine * g[1, 2] - sine * (g[1, 0] * d1 + g[1, 1] * d2)
    stiffness = cosine * g[2, 2] - sine * (g[2, 0] * d1 + g[2, 1] * d2)
    equation = (d1 * c[1] - d2 * c[0]) * stiffness - c[2] * (d1 * push2 - d2 * push1)
    return equation, stiffness, d1, d2


@kernel
def slip_angles(g, c, mu, angles):
    """Angles of d at which one contact (3 x 3) may slip, into angles (at least `CANDIDATES`,); returns how many.

    The slip equations have a root where a trigonometric polynomial of second degree is zero, at most four times; a
    scan finds these and the places where a pair of them meets. The directions of c_t and of the coupling g_tn
    cover the singular matrices, for which every direction is a root.
    """
    angles[0] = atan2(c[1], c[0])
    angles[1] = atan2(-c[1], -c[0])
    angles[2] = atan2(g[1, 2], g[0, 2])
    angles[3] = atan2(-g[1, 2], -g[0, 2])
    count = 4
    step = 2.0 * pi / SCAN
    before = slip_equation(g, c, mu, -step)[0]
    here = slip_equation(g, c, mu, 0.0)[0]
    for k in range(SCAN):
        angle = k * step
        after = slip_equation(g, c, mu, angle + step)[0]
        crosses = (here > 0.0) != (after > 0.0)
        touches = before * here > 0.0 and here * after > 0.0 and abs(here) <= min(abs(before), abs(after))
        if (crosses or touches) and count < CANDIDATES:
            low = angle if crosses else angle - step
            high = angle + step
            for _ in range(40):
                # Bisection where the sign changes, golden section where |equation| is least: Newton does the rest.
                p = 0.5 * (low + high) if crosses else high - 0.6180339887498949 * (high - low)
                q = high if crosses else low + 0.6180339887498949 * (high - low)
                at_p = slip_equation(g, c, mu, p)[0]
                at_q = slip_equation(g, c, mu, q)[0]
                if (at_p > 0.0) != (at_q > 0.0) if crosses else abs(at_q) < abs(at_p):
                    low = p
                elif crosses:
                    high = p
                else:
                    high = q
            angles[count] = 0.5 * (low + high)
            count += 1
        before = here
        here = after
    return count


@kernel
def settle(g, c, mu, modes, f, u, angles, start, start_modes, passes, tolerance, near, touching, buffers):
    """Newton with corrected modes, from modes (n,) and f (3n,); returns residual, passes used, attempts made.

    Redundant contacts get the forces of least norm; where these contradict the modes, the forces nearest to the
    ones given. near > 0: these are a solution of a similar problem, whose redundant modes are tried first. They are
    given the forces nearest to them that lie inside the cones, where those of least norm do not (2), or at once (1).
    One contact is solved exactly: if the start given does not lead to a solution, every other one that there can be is
    tried until the judge accepts: open, stick, and slip along each of `slip_angles`.
    touching (n,): see `close_touching`, of use if near > 0; start (3n,), start_modes (n,): scratch.
    """
    size, direction, length, speed, sine, cosine, a, rhs, x, row_of_g, gram, order, first = buffers
    n = mu.shape[0]
    for i in range(n):
        sine[i], cosine[i] = cone_angle(mu[i])
        start_modes[i] = modes[i]
        for k in range(3 * i, 3 * i + 3):
            start[k] = f[k]
    attempts = 0
    candidates = 0
    closed = False
    again = False
    while True:
        if attempts == 1 or again:
            for i in range(n):
                modes[i] = start_modes[i]
                for k in range(3 * i, 3 * i + 3):
                    f[k] = start[k]
        elif attempts == 2 or attempts == 3:
            modes[0] = OPEN if attempts == 2 else STICK
            f[0] = 0.0
            f[1] = 0.0
            f[2] = 0.0
        elif attempts > 3:
            if attempts == 4:
                candidates = slip_angles(g, c, mu[0], angles)
            _, stiffness, d1, d2 = slip_equation(g, c, mu[0], angles[attempts - 4])
            force = -c[2] / stiffness if c[2] * stiffness < 0.0 else 0.0
            modes[0] = SLIP
            f[0] = -sine[0] * force * d1
            f[1] = -sine[0] * force * d2
            f[2] = cosine[0] * force
        respond(g, c, f, u, size)
        closed = near > 0 and close_touching(mu, modes, touching)
        slipping = False
        for i in range(n):
            length[i] = 0.0
            speed[i] = 0.0
            direction[2 * i] = 1.0
            direction[2 * i + 1] = 0.0
            if modes[i] == SLIP:
                slipping = True
                length[i], speed[i] = start_slip(3 * i, mu[i], f, u, direction, i)

        residual = HUGE
        refine = attempts == 1 or near == 1
        again = False
        for k in range(passes):
            before = residual
            open_directions = newton_step(g, c, mu, modes, f, u, refine, buffers)
            if near > 0 and open_directions == 0:
                # nothing to choose
                near = 0
                again = closed
                if again:
                    break
            if near > 0:
                matrix_rank = first[n] - open_directions
                last = f if refine else start
                ease(mu, modes, f, direction, length, last, matrix_rank, a, gram, order, first, x, rhs, row_of_g)
            respond(g, c, f, u, size)
            residual = judge(mu, f, u, size)
            stalled = residual > 0.5 * before
            if residual <= ROUND_OFF:
                return residual, k + 1, attempts
            if not residual < HUGE:
                break
            changes = correct_modes(mu, modes, f, u, direction, length, speed)
            if changes == 0 and stalled and residual <= tolerance:
                return residual, k + 1, attempts
            if attempts == 0 and changes > 0 and open_directions > 0:
                again = True
                break
            if changes == 0 and stalled and refine:
                break
            refine = attempts == 1 or near > 0 or (changes == 0 and residual < REFINEMENT)
        if residual <= tolerance:
            return residual, passes, attempts
        if near > 0 or closed:
            # what slips turns as its forces change: once more from the ones given; then from the modes alone
            near = 1 if near == 2 and slipping else 0
            again = True
            continue
        attempts += 1
        if n > 1 and not again:
            return residual, passes, attempts
        if n == 1 and attempts > 4 and attempts >= 4 + candidates:
            return residual, passes, attempts


@kernel
def sweep(g, mu, f, u):
    """One Gauss-Seidel pass of the judge's projections over all contacts; f (3n,) and u = g f + c (3n,) are updated."""
    n = mu.shape[0]
    rows = 3 * n
    for i in range(n):
        k = 3 * i
        stiffness = g[k + 2, k + 2]
        change = max(f[k + 2] - u[k + 2] / stiffness, 0.0) - f[k + 2] if stiffness > 0.0 else 0.0
        if change != 0.0:
            f[k + 2] += change
            for j in range(rows):
                u[j] += change * g[k + 2, j]
        half = 0.5 * (g[k, k] - g[k + 1, k + 1])
        stiffness = 0.5 * (g[k, k] + g[k + 1, k + 1]) + sqrt(half * half + g[k, k + 1] ** 2)
        if stiffness > 0.0:
            p1 = f[k] - u[k] / stiffness
            p2 = f[k + 1] - u[k + 1] / stiffness
            radius = min(mu[i], LARGEST_FRICTION) * f[k + 2]
            length = sqrt(p1 * p1 + p2 * p2)
            shrink = radius / length if length > radius else 1.0
            change1 = shrink * p1 - f[k]
            change2 = shrink * p2 - f[k + 1]
            f[k] += change1
            f[k + 1] += change2
            for j in range(rows):
                u[j] += change1 * g[k, j] + change2 * g[k + 1, j]


@entry_kernel(
    REAL[:, ::1], REAL[::1], REAL[::1], REAL[::1], REAL, REAL[:, ::1], REAL[::1], REAL[:, ::1], REAL[::1],
    REAL[::1], REAL[::1], aside=True,
)  # fmt: skip
def assemble_qp(delassus, b, mu, f, proximal, hessian, gradient, facets, upper, unit, work):
    """The quadratic program around scaled forces f (3n,): min f' H f / 2 + g' f with facets f <= upper.

    Four tangent planes per contact, the first at the direction of f itself; the cone's curvature times its
    multiplier |u_t| in the Hessian; De Saxce's shift mu |u_t| n and the proximal pull to f in the gradient.
    hessian (3n, 3n), gradient (3n,), facets (4n, 3n; zero outside the contacts' blocks), upper (4n,): output;
    unit (3n,): output, the forces that scaled ones are counted in; work (8n,): scratch.
    """
    n = mu.shape[0]
    rows = 3 * n
    c = work[0:rows]
    u = work[rows : 2 * rows]
    scale = work[2 * rows : 2 * rows + n]
    size = work[2 * rows + n : 2 * rows + 2 * n]
    largest = scale_problem(delassus, b, n, hessian, c, scale)
    respond(hessian, c, f, u, size)
    for i in range(n):
        k = 3 * i
        friction = min(mu[i], QP_FRICTION)
        length = sqrt(f[k] ** 2 + f[k + 1] ** 2)
        d1 = u[k] - f[k]
        d2 = u[k + 1] - f[k + 1]
        slip = 0.0
        if length > 0.0:
            d1 = -f[k]
            d2 = -f[k + 1]
        norm = sqrt(d1 * d1 + d2 * d2)
        if norm > 0.0:
            d1 /= norm
            d2 /= norm
        else:
            d1 = 1.0
            d2 = 0.0
        if length > 0.0:
            slip = max(d1 * u[k] + d2 * u[k + 1], 0.0)
        curvature = min(slip / length, 1e3) if length > 0.0 else 0.0
        for r in range(3):
            gradient[k + r] = c[k + r] - proximal * f[k + r]
            hessian[k + r, k + r] += proximal
            unit[k + r] = scale[i] * largest
        gradient[k + 2] += friction * slip
        hessian[k, k] += curvature * d2 * d2
        hessian[k, k + 1] -= curvature * d1 * d2
        hessian[k + 1, k] -= curvature * d1 * d2
        hessian[k + 1, k + 1] += curvature * d1 * d1
        sine, cosine = cone_angle(friction)
        for j in range(4):
            row = 4 * i + j
            e1 = (-d1, d1, -d2, d2)[j]
            e2 = (-d2, d2, d1, -d1)[j]
            facets[row, k] = cosine * e1
            facets[row, k + 1] = cosine * e2
            facets[row, k + 2] = -sine
            upper[row] = 0.0
        if friction == 0.0:
            # No cone is left but F_n >= 0; the tangential forces are decoupled, and stay zero.
            for j in range(4):
                row = 4 * i + j
                upper[row] = 1.0
                for r in range(3):
                    facets[row, k + r] = 0.0
            upper[4 * i] = 0.0
            facets[4 * i, k + 2] = -1.0
            hessian[k, k] += 1.0
            hessian[k + 1, k + 1] += 1.0
            for r in range(2):
                gradient[k + r] = 0.0
                for j in range(rows):
                    if j != k + r:
                        hessian[k + r, j] = 0.0
                        hessian[j, k + r] = 0.0
