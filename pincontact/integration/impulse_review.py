"""Whether the solution of a step's cone problem stands (see `impulses`), and the work that its impulses do."""

from __future__ import annotations

import math

from ..dynamics.energy import ENERGY_SLACK, KEPT_ACCURACY
from ..dynamics.equations import inner
from ..friction import cone
from ..friction.elimination import factor_gram, solve_gram
from ..jit import kernel
from ..layout import NO_FORCE
from ..workspace import square
from .impulse_layout import (
    APART,
    APPROACH,
    AT_REST,
    COUPLED,
    FREE_CHANGE,
    FREE_RATE,
    IMPULSE_TIME,
    KEPT,
    KEPT_HIGH,
    KEPT_LOW,
    MIDPOINT,
    NEQ,
    ON_JOINT,
    ON_LOADED,
    ON_TURN,
    PARENT,
    REVIEWS,
    ROW_MASK,
    SHIFT,
    SLID,
    SLIDING,
    START_T1,
    START_T2,
    STICKING_AGAIN,
    TOGETHER,
    TOUCHES,
    UNIT_INDEX,
    UNIT_KIND,
    UNIT_LOAD,
    UNITS,
)
from .impulse_problem import are_redundant

# What `advance` returns: the step is done, or the cone problem was changed and must be solved again.
DONE, AGAIN = 0, -1

# Fixed point on the loads that cone problems take as given: change that ends it, reviews after which it is left.
LOAD_CHANGE = 1e-12
# The same for resistance to turning, whose loads come from a cone problem solved to this accuracy.
TURN_LOAD_CHANGE = 1e-10
PATIENCE = 12
REVIEW_LIMIT = 200


@kernel
def equation_impulses(system, step):
    """Impulses of the equations that go with the cones' forces, R^T P = share - overlap^T F; of redundant ones the
    least, with contacts' forces in the units of `dynamics.equations.unit_of_force`."""
    counts = step.counts
    n, nequations = counts[UNITS], counts[NEQ]
    forces = step.cone_forces
    overlap, factor = step.overlap, step.equation_factor
    share, impulse = step.equation_share, step.equation_impulse
    for e in range(nequations):
        impulse[e] = share[e]
        for r in range(3 * n):
            impulse[e] -= overlap[r, e] * forces[r]
    if are_redundant(factor, nequations):
        gram = system.delassus
        _least_impulses(factor, step.equation_unit, nequations, gram, impulse)
        return
    for e in range(nequations - 1, -1, -1):
        value = impulse[e]
        for j in range(e + 1, nequations):
            value -= factor[j, e] * impulse[j]
        impulse[e] = value / factor[e, e]


@kernel
def _least_impulses(factor, unit, n, gram, impulse):
    """P with R^T P = impulse (n,), in and out, and the least sum of P^2 times its units; gram (n, n): scratch."""
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for e in range(i, n):
                value += factor[e, i] * factor[e, j] / unit[e]
            gram[i, j] = value
        if factor[i, i] == 0.0:
            # says nothing
            gram[i, i], impulse[i] = 1.0, 0.0
    factor_gram(gram, n)
    solve_gram(gram, n, impulse[:n])
    for e in range(n - 1, -1, -1):
        value = 0.0
        for j in range(e + 1):
            value += factor[e, j] * impulse[j]
        impulse[e] = value / unit[e]


@kernel
def _normal_load(step, c, lowest):
    """Length of the normal impulse that the equations give contact c; its normals are the rows from the lowest on."""
    counts = step.counts
    index = step.equation_index
    impulse = step.equation_impulse
    total = 0.0
    for e in range(counts[NEQ]):
        if index[e, 0] == c and index[e, 1] >= lowest:
            total += impulse[e] * impulse[e]
    return math.sqrt(total)


@kernel
def velocity_change(step, nv, out):
    """out (nv,) = change of velocity by all impulses, whitened."""
    counts = step.counts
    n, nequations = counts[UNITS], counts[NEQ]
    equations, share = step.equations, step.equation_share
    forces, whitened = step.cone_forces, step.whitened
    for k in range(nv):
        out[k] = 0.0
    for e in range(nequations):
        for k in range(nv):
            out[k] += share[e] * equations[e, k]
    for r in range(3 * n):
        if forces[r] != 0.0:
            for k in range(nv):
                out[k] += forces[r] * whitened[r, k]


@kernel
def impulse_work(step, nv, h, scratch):
    """Work of the contacts' impulses on v_c, of the joints' units, the sum of the sizes of all terms, and the kinetic
    energy that these impulses bring beyond what the smooth forces account for within the step.

    Work: an impulse times the mean of the velocities at the step's ends, or of its part in an impact times that of the
    velocities right before and after it. Kinetic energy: always those at the step's ends. Impulses of equations do no
    work on v_c. Large impulses that nearly cancel (a wedged chain) magnify what the smooth forces do around their
    instants, which is known to first order only: no more of it is counted than the change of velocity and that by the
    smooth forces allow. scratch: (nv,).
    """
    counts, numbers_of_step = step.counts, step.numbers
    kept = numbers_of_step[KEPT]
    n = counts[UNITS]
    unit_int = step.unit_int
    unit_real = step.unit_real
    forces, velocities = step.cone_forces, step.cone_velocities
    on_contacts, on_joints, size, meanwhile = 0.0, 0.0, 0.0, 0.0
    for u in range(n):
        ints, numbers = unit_int[u], unit_real[u]
        work = 0.0
        for row in range(2):
            if ints[ROW_MASK] >> row & 1 != 0:
                mean = velocities[3 * u + row]
                if ints[MIDPOINT] == 0:
                    mean += numbers[START_T1 + row]
                work += 0.5 * forces[3 * u + row] * mean
        size += abs(work)
        if ints[TOUCHES] != 0:
            after = velocities[3 * u + 2] + kept * numbers[SHIFT]
            gained = numbers[IMPULSE_TIME] * numbers[FREE_RATE]
            later = (h - numbers[IMPULSE_TIME]) * numbers[FREE_RATE]
            before = numbers[APPROACH]
            if numbers[SHIFT] > 0.0:
                after -= later
                gained -= later
            elif later < 0.0 and before < 0.0:
                # it stays: the part of the impulse that holds it for the rest of the step does no work
                before *= before / (before + later)
                gained -= numbers[APPROACH] - before
            # what the smooth forces do before and after the impact
            meanwhile += 0.5 * forces[3 * u + 2] * gained
            work += 0.5 * forces[3 * u + 2] * (before + after)
            size += 0.5 * forces[3 * u + 2] * (abs(numbers[APPROACH]) + abs(after))
        if ints[UNIT_KIND] == ON_JOINT:
            on_joints += work
        else:
            on_contacts += work
    kinetic = on_contacts + on_joints - meanwhile
    velocity_change(step, nv, scratch)
    accounted = numbers_of_step[FREE_CHANGE] * math.sqrt(inner(scratch, scratch, nv))
    on_contacts += max(-accounted, min(meanwhile, accounted)) - meanwhile
    return on_contacts, on_joints, size, kinetic - accounted


@kernel
def slips_back(ints, values, first, second):
    """Whether the slip of a unit that slid at the step's start turns by a right angle or more, so that it may as well
    come to rest within the step; first, second: the solution's velocities."""
    if ints[MIDPOINT] != 0:
        first -= values[START_T1]
        second -= values[START_T2]
    return first * values[START_T1] + second * values[START_T2] <= 0.0


@kernel
def may_rest(step, u):
    """Whether unit u slid at the step's start and comes to rest in this solution, or slips back, and nothing that it is
    coupled with slides on: what passes by a place of rest, while others slide, does not stop there."""
    counts = step.counts
    n = counts[UNITS]
    unit_int = step.unit_int
    unit_real = step.unit_real
    velocities, modes = step.cone_velocities, step.cone_modes
    friction, delassus = step.friction, square(step.delassus, 3 * n)
    if unit_int[u, SLID] == 0 or unit_int[u, MIDPOINT] != 0:
        return False
    for w in range(n):
        if unit_int[w, SLID] == 0 or modes[w] == cone.STICK or (w != u and friction[w] == 0.0):
            continue
        if slips_back(unit_int[w], unit_real[w], velocities[3 * w], velocities[3 * w + 1]):
            continue
        for i in range(3 * u, 3 * u + 3):
            for j in range(3 * w, 3 * w + 3):
                if delassus[i, j] != 0.0:
                    return False
    return True


@kernel
def review(step, nv, h, scratch):
    """Whether the solution stands; if not, b or the coefficients are changed and the problem is to be solved again.

    Slip is opposed along the mean of its velocities at both ends only while it goes on; a contact at rest that starts
    to slip does so with the sliding coefficient, and one whose slip turns back comes to rest first, if that of sticking
    holds it; loads that the problem takes as given are a fixed point, which is iterated a few times, then found
    together with the forces (see `friction.product`); and restitution is lowered where, together with friction, it
    would create energy (see `dynamics.energy`), or raise the kinetic energy by more than the smooth forces account for
    within a step. scratch: (nv,).
    """
    counts, numbers = step.counts, step.numbers
    n = counts[UNITS]
    unit_int = step.unit_int
    unit_real = step.unit_real
    forces, velocities = step.cone_forces, step.cone_velocities
    modes, friction = step.cone_modes, step.friction
    b, delassus = step.loads, square(step.delassus, 3 * n)
    counts[REVIEWS] += 1
    bounces = settles = stops = False
    for u in range(n):
        if unit_int[u, MIDPOINT] != 0:
            back = slips_back(unit_int[u], unit_real[u], velocities[3 * u], velocities[3 * u + 1])
            stops = stops or modes[u] == cone.STICK or back
    again = stops
    for u in range(n):
        ints, values = unit_int[u], unit_real[u]
        if values[STICKING_AGAIN] > 0.0 and modes[u] == cone.SLIP and may_rest(step, u):
            friction[u], values[STICKING_AGAIN] = values[STICKING_AGAIN], 0.0
            ints[AT_REST] = 1
            again = True
            continue
        # all at once, see `impulse_problem`
        if stops and ints[MIDPOINT] != 0:
            b[3 * u] -= values[START_T1]
            b[3 * u + 1] -= values[START_T2]
            ints[MIDPOINT] = 0
        if ints[AT_REST] != 0 and modes[u] == cone.SLIP:
            friction[u] = values[SLIDING]
            ints[AT_REST] = 0
            again = True
        if counts[COUPLED] == APART and (ints[UNIT_KIND] == ON_LOADED or ints[UNIT_KIND] == ON_TURN):
            turns = ints[UNIT_KIND] == ON_TURN
            if turns and ints[PARENT] >= 0:
                load = forces[3 * ints[PARENT] + 2]
            else:
                # what turns has one normal, and where it must not slip further equations; others have normals only
                load = _normal_load(step, ints[UNIT_INDEX], 2 if turns else 0)
            before = values[UNIT_LOAD]
            if abs(load - before) > (TURN_LOAD_CHANGE if turns else LOAD_CHANGE) * (load + before):
                values[UNIT_LOAD] = load
                b[3 * u + 2] = -delassus[3 * u + 2, 3 * u + 2] * values[UNIT_LOAD]
                again = settles = True
        if ints[TOUCHES] != 0 and values[SHIFT] > 0.0 and forces[3 * u + 2] > 0.0:
            bounces = True
    if settles and counts[REVIEWS] > PATIENCE:
        counts[COUPLED] = TOGETHER
    if again:
        return AGAIN if counts[REVIEWS] < REVIEW_LIMIT else NO_FORCE
    if not bounces:
        return DONE
    # bisection for the largest part of the restitution that creates no energy; 0 never does
    on_contacts, on_joints, size, excess = impulse_work(step, nv, h, scratch)
    creates = on_contacts + on_joints > ENERGY_SLACK * size or excess > 0.0
    if not creates and (numbers[KEPT] == 1.0 or numbers[KEPT_HIGH] - numbers[KEPT_LOW] < KEPT_ACCURACY):
        return DONE
    kept = numbers[KEPT]
    if creates:
        numbers[KEPT_HIGH] = kept
    else:
        numbers[KEPT_LOW] = kept
    if numbers[KEPT_HIGH] - numbers[KEPT_LOW] < KEPT_ACCURACY:
        numbers[KEPT] = numbers[KEPT_LOW]
        if kept == numbers[KEPT]:
            return DONE
    else:
        numbers[KEPT] = 0.5 * (numbers[KEPT_LOW] + numbers[KEPT_HIGH])
    for u in range(n):
        b[3 * u + 2] += (kept - numbers[KEPT]) * unit_real[u, SHIFT]
    return AGAIN if counts[REVIEWS] < REVIEW_LIMIT else NO_FORCE
