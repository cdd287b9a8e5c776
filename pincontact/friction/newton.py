"""Newton's iteration on the equations of given modes, with the modes corrected as it goes (see `cone`).

All states of a single contact are tried, if need be: no search is left to others.
"""

from __future__ import annotations

from math import atan2, cos, pi, sin

from ..arrays import REALS, array_type
from ..callback import separate_kernel
from ..jit import CALLED, INTEGER, REAL, kernel
from ..linalg import least_norm
from .cone import (
    CANDIDATES,
    HUGE,
    OPEN,
    RANK_TOLERANCE,
    SLIP,
    STICK,
    cone_angle,
    natural_map_residual,
    respond,
    start_slip,
    turn_direction,
)
from .redundant import has_factors, low_rank_solve, move_inside, turn_slips

# Newton stops below this residual at once; above it, when a pass no longer improves the residual.
ROUND_OFF = 1e-14
# A slip speed this far below zero (scaled) turns slip into stick; less is round-off on a redundant contact.
SPEED_TOLERANCE = 1e-12
# Redundant forces are chosen once more where slips have turned by more than this (rad) since: at once if that is less
# than this part of the turn before, else when all is solved and so many passes are left.
CONVERGED_TURN, TURN_RATE, PASSES_LEFT = 1e-11, 0.5, 3
# Relative changes of the forces above this are a new choice among redundant forces, below it a refinement.
REFINEMENT = 1e-2
# A refinement that leaves more than this part of the residual does not converge any more.
STALLED = 0.5
# Directions tried in the scan for a single contact's slip; the function scanned has four zeros at most.
SCAN = 64

_VECTOR = array_type(REALS, 1)


@kernel
def write_system(cone, g, source, mu, modes):
    """Newton's matrix and right-hand side of the unknowns that `first` counts, see `newton_step`."""
    direction, length, speed, sine, cosine = cone.direction, cone.length, cone.speed, cone.sine, cone.cosine
    a, rhs, row_of_g, first = cone.system, cone.rhs, cone.row, cone.first
    n = mu.shape[0]
    for i in range(n):
        k = 3 * i
        for r in range(first[i + 1] - first[i]):
            row = first[i] + r
            d1 = 0.0
            d2 = 1.0
            p = k + r
            q = k + r
            if modes[i] == SLIP:
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


@kernel
def newton_step(cone, g, c, mu, modes, f, u, refine, near, start, rank):
    """One Newton step on the equations of the modes; f (3n,) is updated, and the slips' directions and lengths.

    Unknown are f at sticking contacts and, at slipping ones, the length of the force and its turning (as an arc).
    With refine false the forces solved for have least norm; with refine true their change has. near: where these leave
    the cones they are moved inside, near to start (3n,). rank: of the matrix factors in `redundant`, or 0.
    Returns how many directions there are in which the forces may change, whether they were moved, and the largest
    tangent of an angle by which slips have turned.
    """
    direction, length, speed, sine, cosine = cone.direction, cone.length, cone.speed, cone.sine, cone.cosine
    x, aim, first, arc = cone.x, cone.row, cone.first, cone.arc
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
        return first[n], False, 0.0

    source = u if refine else c
    factored = has_factors(rank, first[n], mu, modes, length, speed, sine)
    if factored:
        found = low_rank_solve(cone, rank, source, modes)
    else:
        write_system(cone, g, source, mu, modes)
        found = least_norm(cone.system, cone.rhs, first[n], first[n], x, cone.gram, cone.order, RANK_TOLERANCE)
    free = first[n] - found
    if refine:
        for i in range(n):
            row = first[i]
            if modes[i] == STICK:
                for r in range(3):
                    x[row + r] += f[3 * i + r]
            elif modes[i] == SLIP:
                x[row] += length[i]
    moved = near and free > 0 and move_inside(cone, found, mu, modes, f if refine else start)

    for i in range(n):
        k = 3 * i
        row = first[i]
        if modes[i] == STICK:
            for r in range(3):
                aim[k + r] = x[row + r]
        else:
            pushed = x[row] if modes[i] == SLIP else 0.0
            aim[k] = -sine[i] * pushed * direction[2 * i]
            aim[k + 1] = -sine[i] * pushed * direction[2 * i + 1]
            aim[k + 2] = cosine[i] * pushed
    if factored:
        turn_slips(cone, rank, source, mu, modes, f, refine)
    for k in range(3 * n):
        f[k] = aim[k]
    turned = 0.0
    for i in range(n):
        if modes[i] == SLIP:
            k = 3 * i
            row = first[i]
            if mu[i] > 0.0:
                along = arc[i] if factored else x[row + 1]
                turned = max(turned, turn_direction(direction, i, along, sine[i] * length[i] + speed[i]))
            length[i] = x[row]
            f[k] = -sine[i] * length[i] * direction[2 * i]
            f[k + 1] = -sine[i] * length[i] * direction[2 * i + 1]
    return free, moved, turned


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


@separate_kernel(INTEGER, array_type(REALS, 2), _VECTOR, REAL, _VECTOR, when=CALLED)
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
def start_slips(cone, mu, modes, f, u):
    """Directions, force lengths and speeds with which slips start; none for other contacts."""
    for i in range(mu.shape[0]):
        cone.length[i] = 0.0
        cone.speed[i] = 0.0
        cone.direction[2 * i] = 1.0
        cone.direction[2 * i + 1] = 0.0
        if modes[i] == SLIP:
            cone.length[i], cone.speed[i] = start_slip(3 * i, mu[i], f, u, cone.direction, i)


@kernel
def active_set_solve(cone, g, c, mu, modes, f, u, passes, tolerance, near, touching, rank):
    """Newton's method with modes corrected after each step, from modes (n,) and f (3n,); returns the residual, Newton
    passes used, starts tried, in how many directions forces may change, and whether these depend on those begun from.

    Redundant contacts get the forces of least norm; where these contradict the modes, the forces nearest to the
    ones given. near: these are a solution of a similar problem, whose redundant modes are tried first, with the forces
    nearest to them that lie inside the cones, where those of least norm do not.
    One contact is solved exactly: if the start given does not lead to a solution, every other one that there can be is
    tried until the residual is below the tolerance: open, stick, and slip along each of `slip_angles`.
    touching (n,): see `close_touching`, of use if near; rank: see `newton_step`.
    """
    size, direction, length, speed = cone.size, cone.direction, cone.length, cone.speed
    sine, cosine, start, start_modes = cone.sine, cone.cosine, cone.start, cone.start_modes
    n = mu.shape[0]
    for i in range(n):
        sine[i], cosine[i] = cone_angle(mu[i])
        start_modes[i] = modes[i]
        for k in range(3 * i, 3 * i + 3):
            start[k] = f[k]
    tried = candidates = open_directions = 0
    closed = again = False
    while True:
        if tried == 1 or again:
            for i in range(n):
                modes[i] = start_modes[i]
                for k in range(3 * i, 3 * i + 3):
                    f[k] = start[k]
        elif tried == 2 or tried == 3:
            modes[0] = OPEN if tried == 2 else STICK
        elif tried > 3:
            if tried == 4:
                candidates = slip_angles(g, c, mu[0], cone.angles)
            _, stiffness, d1, d2 = slip_equation(g, c, mu[0], cone.angles[tried - 4])
            force = -c[2] / stiffness if c[2] * stiffness < 0.0 else 0.0
            modes[0] = SLIP
            f[0] = -sine[0] * force * d1
            f[1] = -sine[0] * force * d2
            f[2] = cosine[0] * force
        closed = near and close_touching(mu, modes, touching)
        slipping = False
        for i in range(n):
            slipping = slipping or modes[i] == SLIP
        given = refine = tried == 1
        if slipping or refine:
            respond(g, c, f, u, size, cone.x)
        start_slips(cone, mu, modes, f, u)

        residual = HUGE
        again = False
        # whether forces are not those of least norm in the present modes
        follows = refine
        turned, last_turn = 0.0, HUGE
        for k in range(passes):
            before = residual
            open_directions, moved, turn = newton_step(cone, g, c, mu, modes, f, u, refine, near, start, rank)
            follows = (follows and refine) or moved
            if near and open_directions == 0:
                # nothing to choose
                near = False
                again = closed
                if again:
                    break
            respond(g, c, f, u, size, cone.x)
            residual = natural_map_residual(mu, f, u, size)
            stalled = refine and residual > STALLED * before
            # whether the choice was made for slips in other directions
            turned = turned + turn if refine else turn
            stale = not given and open_directions > 0 and turned > CONVERGED_TURN and k + PASSES_LEFT < passes
            stale = stale and (residual <= ROUND_OFF or turned <= TURN_RATE * last_turn)
            last_turn = turned
            if residual <= ROUND_OFF and not stale:
                return residual, k + 1, tried, open_directions, follows
            if not residual < HUGE:
                break
            changes = correct_modes(mu, modes, f, u, direction, length, speed)
            follows = follows or changes > 0
            if changes == 0 and stalled and residual <= tolerance:
                return residual, k + 1, tried, open_directions, follows
            if tried == 0 and changes > 0 and open_directions > 0 and not (near and residual <= tolerance):
                again = True
                break
            if changes == 0 and stalled:
                break
            refine = given or (not stale and (near or (changes == 0 and residual < REFINEMENT)))
        if residual <= tolerance:
            return residual, passes, tried, open_directions, follows
        if near or closed:
            # from the modes alone
            near, again = False, True
            continue
        tried += 1
        if n > 1 and not again:
            return residual, passes, tried, open_directions, follows
        if n == 1 and tried > 4 and tried >= 4 + candidates:
            return residual, passes, tried, open_directions, follows
