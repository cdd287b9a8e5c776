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

Here are the pieces: the problem without units, the residual of a result, and what forces and velocities say of modes.
`newton` solves the equations of given modes; where these come from is the business of `starts` and `solve`.

Scaling. Everything below runs on a problem without units: the forces of contact i are divided by s_i and its u
multiplied by it, s_i = (trace(G_ii) / 3)^(-1/2), which leaves the cones as they are and makes the diagonal blocks
unit-sized; then b is divided by its largest entry.

Residual of the natural map: that of the two projections

    F_n - max(F_n - u_n, 0)     and     F_t - P_D(F_t - u_t),   D the disk of radius mu max(F_n, 0),

which vanish together exactly where F - P_K(F - (u + mu |u_t| n)) does but, unlike that, stay well-conditioned for
large mu. It is taken relative to |b_i| + sum_j |G_ij| |F_j|, the size of the terms that cancel in it, with a floor at
`FLOOR` times the largest of these over the contacts, and a cap at `CANCELLATION` times the largest b, so that forces
growing without bound do not pass for a solution. Hence it does not depend on units.
"""

from __future__ import annotations

from math import inf, sqrt

from ..jit import kernel
from ..workspace import INTEGERS, REALS, Layout, Scratch, Workspace

OPEN, STICK, SLIP = 0, 1, 2

# A contact whose forces and velocities are this much smaller than another's is measured on the other's scale.
FLOOR = 1e-5
# Forces this much larger than what b asks for are only accepted if u is as accurate as without them.
CANCELLATION = 1e4
# A pivot this much below the largest one is a redundant direction: Delassus matrices carry round-off at 1e-15.
RANK_TOLERANCE = 1e-12
# Directions in which a single contact may slip, at most.
CANDIDATES = 12
# A slip operator whose pivot falls below this fraction of its frictionless value has lost positivity (Painleve).
PAINLEVE_LIMIT = 1e-9
# The operator of several contacts has lost it where their determinant is negative, and its last pivot, or smallest
# singular value, larger than this part of the largest: of nearly redundant ones the least unevenness decides the sign.
COMMON_LIMIT = 1e-3
HUGE = 1e300
# Scaled forces beyond this have left for infinity, where no solution is.
ESCAPED = 1e6
# Outside this range a cone is too flat or too steep to tell modes by; Newton uses the true coefficient.
LEAST_FRICTION, LARGEST_FRICTION = 1e-6, 1e2

# In "counts": Newton passes of the last start; whether modes and forces are a solution, to begin from; what decided the
# last problem; in how many directions the last solution's forces may change, and whether they depend on those that it
# was begun from; whether all states of a single contact were tried; how often each of the deciders did.
PASSES, KNOWN, OWNERS, DECIDED, CHOICES, FOLLOWS, SEARCHED, TIMES = range(8)
DECIDERS = ("warm", "exact", "sweeps", "path", "qp")
BY_WARM, BY_EXACT, BY_GAUSS_SEIDEL, BY_HOMOTOPY, BY_QP = range(len(DECIDERS))
UNDECIDED = -1
COUNTS_LENGTH = TIMES + len(DECIDERS)

_REALS, _INTEGERS = Scratch(REALS), Scratch(INTEGERS)
# What the solvers work in, by name; rows = 3n. But for what goes in and out, the problem is without units. Of slipping
# contacts: direction of slip (by twos), length of the force, speed.
CONE = Layout(
    "cone",
    modes=(INTEGERS, "contacts"),  # (n,) in and out
    forces=(REALS, "rows"),  # (3n,), in and out
    velocities=(_REALS, "rows"),  # (3n,), in and out
    counts=(INTEGERS, COUNTS_LENGTH),  # (COUNTS_LENGTH,) see above
    reached=(_REALS, 1),  # (1,): out, the least residual where it is above the tolerance
    scaled=(_REALS, "rows", "rows"),  # (3n, 3n) the Delassus matrix without units
    system=(_REALS, "bordered", "bordered"),  # (3n + 1, 3n + 1) Newton's matrix
    gram=(_REALS, "bordered", "bordered"),  # (3n + 1, 3n + 1)
    low_rank=(_REALS, 4, "tall", "rows"),  # (4, 3n + 5, 3n), see `redundant`
    c=(_REALS, "rows"),  # (3n,) b
    f=(_REALS, "rows"),  # (3n,) forces
    u=(_REALS, "rows"),  # (3n,) velocities, g f + c
    start=(_REALS, "rows"),  # (3n,) forces begun from
    rhs=(_REALS, "rows"),  # (3n,) of Newton's equations
    x=(_REALS, "rows"),  # (3n,) their unknowns
    row=(_REALS, "rows"),  # (3n,) scratch
    shift=(_REALS, "rows"),  # (3n,) see `redundant.tilt_factor`
    scale=(_REALS, "contacts"),  # (n,) factors from the forces to their units
    size=(_REALS, "contacts"),  # (n,) of the terms in u
    length=(_REALS, "contacts"),  # (n,)
    speed=(_REALS, "contacts"),  # (n,)
    sine=(_REALS, "contacts"),  # (n,) of the cones' half angles
    cosine=(_REALS, "contacts"),  # (n,)
    arc=(_REALS, "contacts"),  # (n,) by how much slips turn in a step
    direction=(_REALS, "pairs"),  # (2n,)
    angles=(_REALS, CANDIDATES),  # (CANDIDATES,) of slip of a single contact
    order=(_INTEGERS, "bordered"),  # (3n + 1,) permutation of the elimination
    first=(_INTEGERS, "ends"),  # (n + 1,) first unknown of each contact
    trial_modes=(_INTEGERS, "contacts"),  # (n,)
    start_modes=(_INTEGERS, "contacts"),  # (n,)
    touching=(_INTEGERS, "contacts"),  # (n,) see `newton.close_touching`
    homotopy=(_REALS, 8, "bordered"),  # (8, 3n + 1) point, tangent, ... of `homotopy.follow_homotopy`
    homotopy_rows=(_REALS, 4, "rows"),  # (4, 3n) r, gap, weight, ... of the same
)
cone_at = CONE.at


def cone_workspace(contacts: int) -> Workspace:
    """The arrays of `CONE` for problems of this many contacts; modes start as STICK."""
    rows, space = 3 * contacts, Workspace(CONE)
    space.allocate(
        contacts=contacts, ends=contacts + 1, pairs=2 * contacts, rows=rows, bordered=rows + 1, tall=rows + 5
    )
    space.modes[:], space.counts[DECIDED] = STICK, UNDECIDED
    return space


@kernel
def scale_problem(delassus, b, n, scaled, c, scale, factors):
    """Write the problem without units; returns the factor taken out of b.

    delassus (3n, 3n), b (3n,): the problem; scaled (3n, 3n), c (3n,), scale (n,): output; factors (3n,): scratch.
    """
    largest = 0.0
    for i in range(n):
        trace = delassus[3 * i, 3 * i] + delassus[3 * i + 1, 3 * i + 1] + delassus[3 * i + 2, 3 * i + 2]
        scale[i] = sqrt(3.0 / trace) if trace > 0.0 else 1.0
        for r in range(3 * i, 3 * i + 3):
            factors[r] = scale[i]
            c[r] = scale[i] * b[r]
            largest = max(largest, abs(c[r]))
    if largest == 0.0:
        largest = 1.0
    for i in range(3 * n):
        c[i] /= largest
        row = scaled[i]
        given = delassus[i]
        s = factors[i]
        for j in range(3 * n):
            row[j] = s * factors[j] * given[j]
    return largest


@kernel
def respond(g, c, f, u, size, terms):
    """u = g f + c (3n,); in size (n,), per contact, the sum of the absolute terms in u. terms (3n,): scratch.

    g is symmetric: column by column, so that all of u can be done at once.
    """
    rows = c.shape[0]
    for r in range(rows):
        u[r] = c[r]
        terms[r] = abs(c[r])
    for i in range(size.shape[0]):
        first = g[3 * i]
        second = g[3 * i + 1]
        third = g[3 * i + 2]
        f1 = f[3 * i]
        f2 = f[3 * i + 1]
        fn = f[3 * i + 2]
        for r in range(rows):
            t1 = first[r] * f1
            t2 = second[r] * f2
            tn = third[r] * fn
            u[r] += (t1 + t2) + tn
            terms[r] += (abs(t1) + abs(t2)) + abs(tn)
    for i in range(size.shape[0]):
        # A sum, through which what is not a number gets to the residual.
        size[i] = (terms[3 * i] + terms[3 * i + 1]) + terms[3 * i + 2]


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
def natural_map_residual(mu, f, u, size):
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
def cone_step(x1, x2, xn, d1, d2, dn):
    """Longest step from x, inside the cone |x_t| < x_n, along d until it leaves; at most 1e10."""
    curvature = dn * dn - d1 * d1 - d2 * d2
    slope = xn * dn - x1 * d1 - x2 * d2
    tangential = sqrt(x1 * x1 + x2 * x2)
    value = (xn - tangential) * (xn + tangential)
    step = 1e10
    if dn < 0.0:
        step = min(step, -xn / dn)
    discriminant = slope * slope - curvature * value
    if discriminant >= 0.0:
        root = sqrt(discriminant)
        q = -(slope + root) if slope > 0.0 else root - slope
        if curvature != 0.0 and q / curvature > 0.0:
            step = min(step, q / curvature)
        if q != 0.0 and value / q > 0.0:
            step = min(step, value / q)
    return step


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
    """Modes (n,) suggested by approximate forces and velocities: where the projections of the natural map land."""
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
    """Turn the direction in row i by an arc; returns the angle's tangent."""
    turn = arc / radius if radius > 0.0 else 0.0
    d1 = direction[2 * i]
    d2 = direction[2 * i + 1]
    norm = sqrt(1.0 + turn * turn)
    direction[2 * i] = (d1 - turn * d2) / norm
    direction[2 * i + 1] = (d2 + turn * d1) / norm
    return abs(turn)


@kernel
def gauss_seidel_pass(g, mu, f, u):
    """One pass of projected Gauss-Seidel over all contacts; f (3n,) and u = g f + c (3n,) are updated."""
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
