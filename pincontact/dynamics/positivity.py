"""Whether friction takes its positivity from the operator of slip: then there are no forces, or several (Painleve).

`constraint_rows` is where the operator is taken apart.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..friction.cone import COMMON_LIMIT, PAINLEVE_LIMIT
from ..geometry.patterns import ON_CURVE
from ..jit import kernel
from ..layout import LIFT, MODE, PATTERN, ROLLING_ROW, SLIPPING, SPINNING_ROW, UNILATERAL
from ..linalg import RANK_TOLERANCE, inner, subtract_row
from .least_forces import is_normal_of_curve

if TYPE_CHECKING:
    from .system import System

# Whose operator has lost positivity, see `loses_positivity`.
NOTHING_LOST, CURVES_LOST, CONTACT_LOST = range(3)


def is_positive(system: System) -> bool:
    """Whether the determinant of the last evaluation's operator is positive, see `equations.solve_slip`, however
    little, or there is none since rows are redundant."""
    counters = system.counters
    return bool(counters.row_rank < counters.row_count or system.delassus.item(0, 0) > 0.0)


@kernel
def slips(system, c):
    """Whether friction goes with the normal force of item c: it slips, or what resists its turning does."""
    integers = system.contact_int
    spinning, rolling = integers[c, SPINNING_ROW], integers[c, ROLLING_ROW]
    turns = (spinning > 0 and integers[spinning, MODE] == SLIPPING) or (
        rolling > 0 and integers[rolling, MODE] == SLIPPING
    )
    return integers[c, MODE] == SLIPPING or turns


@kernel
def hold_others(system, n):
    """Eliminate from the operator of slip the rows that do not slip, as if these were held, into `constraint_rows`.

    In its last column is the diagonal without friction, as in `delassus`; in `right_side`, for the first of the two
    normals of a point on a curve, the product of both.
    """
    operator, left, right, whitened = system.delassus, system.constraint_rows, system.right_side, system.whitened_rows
    for r in range(n):
        for j in range(n + 1):
            left[r, j] = operator[r, j]
        pair = r + 1 < n and slides_on_curve(system, r)
        right[r] = inner(whitened[r], whitened[r + 1], system.sizes.nv) if pair else 0.0
    for p in range(n):
        pivot = left[p, p]
        if slips(system, system.row_index[p, 0]) or not pivot > RANK_TOLERANCE * operator[p, p]:
            continue
        for r in range(n):
            if slides_on_curve(system, r):
                right[r] -= left[r, p] * left[r + 1, p] / pivot
            left[r, n] -= left[r, p] * left[r, p] / pivot
        for r in range(n):
            if r != p:
                subtract_row(left[r, :n], left[p, :n], left[r, p] / pivot)


@kernel
def cannot_open(system, r):
    """Whether row r is the normal of a bilateral contact that slips, of which there is one."""
    c, integers = system.row_index[r, 0], system.contact_int[system.row_index[r, 0]]
    normal = system.row_index[r, 1] == 2 and integers[UNILATERAL] == 0 and integers[PATTERN] != ON_CURVE
    return normal and slips(system, c)


@kernel
def share_operators(system, n):
    """Whether contacts that slip and cannot open do not do so alone: then they have one operator in common, and what
    else slips has its own where they keep closed as well."""
    shared = others = 0
    for r in range(n):
        if cannot_open(system, r):
            shared += 1
        elif slips(system, system.row_index[r, 0]):
            others += 1
    return shared > 1 or (shared == 1 and others > 0)


@kernel
def hold_without_friction(system, n):
    """Eliminate from the operator without friction the rows that do not slip or cannot open, into `constraint_rows`;
    the determinant of the latter, as parts of their diagonal, 0 where they are next to redundant."""
    left, whitened, whole, determinant = system.constraint_rows, system.whitened_rows, system.delassus, 1.0
    for r in range(n):
        for j in range(n):
            left[r, j] = inner(whitened[r], whitened[j], system.sizes.nv)
    for k in range(2 * n):
        # what does not slip first
        p, shared = k % n, k >= n
        if slips(system, system.row_index[p, 0]) != shared or (shared and not cannot_open(system, p)):
            continue
        pivot = left[p, p]
        if not pivot > max((COMMON_LIMIT if shared else RANK_TOLERANCE) * whole[p, n], 0.0):
            if shared:
                return 0.0
            continue
        if shared:
            determinant *= pivot / whole[p, n]
        for r in range(n):
            if r != p:
                subtract_row(left[r, :n], left[p, :n], left[r, p] / pivot)
    return determinant


@kernel
def hold_closed(system, n):
    """Eliminate from `constraint_rows` the rows that slip and cannot open, with friction, out of all others; their
    determinant, as parts of their diagonal without friction."""
    left, operator, done, determinant = system.constraint_rows, system.delassus, system.permutation, 1.0
    for r in range(n):
        done[r] = 0 if cannot_open(system, r) else 1
    while True:
        # the largest pivot, for there may be none on the diagonal
        row = column = -1
        largest = -1.0
        for r in range(n):
            for j in range(n if done[r] == 0 else 0):
                size = abs(left[r, j]) / math.sqrt(operator[r, n] * operator[j, n]) if done[j] == 0 else -1.0
                if size > largest:
                    row, column, largest = r, j, size
        if row < 0 or largest == 0.0:
            return determinant if row < 0 else 0.0
        if row != column:
            for k in range(n):
                left[row, k], left[column, k] = left[column, k], left[row, k]
            determinant = -determinant
        pivot = left[column, column]
        done[column], determinant = 1, determinant * pivot / operator[column, n]
        for r in range(n):
            if done[r] == 0 or not cannot_open(system, r):
                subtract_row(left[r, :n], left[column, :n], left[r, column] / pivot)


@kernel
def loses_positivity(system, n):
    """Whether the operator of a contact that slips has lost positivity: there is no force then, or there are two.

    It is the contact's own where all that does not slip is held, as it would be by joints, against what it is without
    friction. Where that is next to nothing its normal force is one of redundant ones, and the least unevenness decides
    which sign it has. Contacts that cannot open have one in common, its determinant, and keep closed beside others.
    CURVES_LOST where only points on curves have lost theirs: see `curve_loses_positivity`.
    """
    operator, left, right, lost, common = (
        system.delassus,
        system.constraint_rows,
        system.right_side,
        NOTHING_LOST,
        1.0,
    )
    frictionless = hold_without_friction(system, n) if share_operators(system, n) else 0.0
    hold_others(system, n)
    for r in range(n):
        if slides_on_curve(system, r) and curve_loses_positivity(system, r, n):
            lost = CURVES_LOST
    if frictionless > 0.0:
        common = hold_closed(system, n) / frictionless
    for r in range(n):
        right[r] = left[r, r]
    if frictionless > 0.0:
        hold_without_friction(system, n)
    for r in range(n):
        c, own = system.row_index[r, 0], left[r, r] if frictionless > 0.0 else left[r, n]
        if is_normal_of_curve(system.contact_int, c, system.row_index[r, 1]) or not slips(system, c):
            continue
        numbers = system.contact_real[c]
        if frictionless > 0.0 and cannot_open(system, r):
            numbers[LIFT] = common
        else:
            # what carries nothing has a negative diagonal
            loaded = own > COMMON_LIMIT * operator[r, n] > 0.0
            numbers[LIFT] = right[r] / own if loaded else 1.0
        if not numbers[LIFT] > PAINLEVE_LIMIT:
            return CONTACT_LOST
    return lost


@kernel
def slides_on_curve(system, r):
    """Whether rows r and r + 1 are the two normals of a point that slips on a spatial curve."""
    integers = system.contact_int[system.row_index[r, 0]]
    return system.row_index[r, 1] == 2 and integers[PATTERN] == ON_CURVE and integers[MODE] == SLIPPING


@kernel
def curve_loses_positivity(system, r, n):
    """Whether that of a point on a curve has, of both its normals, the rows r and r + 1 of `hold_others`.

    Its determinant is that of the frictionless one times 1 - mu l . k, k = G_nn^-1 G_nt, whichever normals are taken;
    where all motions are in one plane with the tangent, its trace is.
    """
    left, both = system.constraint_rows, system.right_side[r]
    trace, size = left[r, n] + left[r + 1, n], left[r, n] * left[r + 1, n] - both * both
    if not trace > COMMON_LIMIT * (system.delassus[r, n] + system.delassus[r + 1, n]):
        return False
    if is_plane(trace, size):
        return not left[r, r] + left[r + 1, r + 1] > PAINLEVE_LIMIT * trace
    determinant = left[r, r] * left[r + 1, r + 1] - left[r, r + 1] * left[r + 1, r]
    return not determinant > PAINLEVE_LIMIT * size


@kernel
def is_plane(trace, determinant):
    """Whether all motions along two normals, whose operator has this trace and determinant, are in one plane."""
    return not determinant > RANK_TOLERANCE * trace**2
