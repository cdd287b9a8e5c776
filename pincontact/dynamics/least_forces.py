"""Redundant forces of slip: the least of them, measured in units of their mobility, and contacts that carry none.

Where constraint rows depend on each other, many forces give the same accelerations. The least are taken, each divided
by its unit (`unit_of_force`), so that the choice does not depend on what lengths and masses are measured in.
"""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..geometry.patterns import ON_CURVE
from ..jit import INTEGER, NOTHING, SEVERAL, kernel
from ..layout import (
    ANISOTROPIC,
    EVENT,
    FRICTIONLESS,
    MODE,
    MU,
    MU_NOW,
    NORMAL_EVENT,
    NORMAL_SIGN,
    OK,
    PATTERN,
    SCALING_11,
    SCALING_12,
    SLIPPING,
    SYSTEM,
    TANGENTS,
    UNILATERAL,
)
from ..linalg import RANK_TOLERANCE, inner, least_norm, whiten

# A contact without a load stays closed by itself where its relative acceleration, in units of what cancels in it and in
# m/s^2, is no more than this.
_CLOSES = 1e-8
# Mobility along a row, relative to the largest of its contact, that is round-off: no joint moves the bodies along it.
IMMOBILE = 1e-24


@kernel
def is_normal_of_curve(contact_int, c, row):
    """Whether a row is one of the two normals of a point on a spatial curve."""
    return row != 0 and contact_int[c, PATTERN] == ON_CURVE


@kernel
def unit_of_force(system, c, row, own):
    """What a multiplier is measured in where forces are redundant: a contact's force is as large as its length times
    the root of its mobility, the mean of J M^-1 J^T over its directions. Those that the contact has not, or along which
    no joint moves it, count as the largest.

    So do the equations of cone problems, without units: redundant loads are the same in both. own: n M^-1 n^T.
    """
    integers, numbers, rows = system.contact_int[c], system.contact_real[c], system.rows[c]
    nv, work, tangents = system.sizes.nv, system.work, integers[TANGENTS]
    on_curve = is_normal_of_curve(system.contact_int, c, row)
    if not on_curve and (row != 2 or integers[MODE] == FRICTIONLESS or tangents == 0):
        return own
    total, largest, missing = own, own, 0
    for i in range(2):
        if on_curve:
            # the other normal and the tangent: the same whichever normals are taken
            whiten(system.factor, system.parents, nv, rows[(row + 1 + i) % 3], work)
        elif i >= tangents:
            missing += 1
            continue
        else:
            if integers[ANISOTROPIC] != 0:
                # row i of the friction ellipse's scaling
                first, second = numbers[SCALING_11 + i], numbers[SCALING_12 + i]
                for k in range(nv):
                    work[k] = first * rows[0, k] + second * rows[1, k]
            else:
                for k in range(nv):
                    work[k] = rows[i, k]
            whiten(system.factor, system.parents, nv, work, work)
        size = inner(work, work, nv)
        missing += size <= IMMOBILE * own
        total += size
        largest = max(largest, size)
    total += missing * largest
    force = 1.0
    if integers[MODE] == SLIPPING and numbers[MU] < math.inf:
        force += numbers[MU_NOW] * numbers[MU_NOW]
    return force * total / 3.0


@kernel
def weigh_forces(system, count):
    """The operator (count, count) with forces in their units, into `delassus`; its last column is the factor from a
    force in its unit to N."""
    operator, whitened, directions = system.delassus, system.whitened_rows, system.whitened_forces
    nv, row_index = system.sizes.nv, system.row_index
    for j in range(count):
        own = inner(whitened[j], whitened[j], nv)
        unit = unit_of_force(system, row_index[j, 0], row_index[j, 1], own)
        operator[j, count] = 1.0 / math.sqrt(unit) if own > 0.0 else 0.0
        for i in range(count):
            operator[i, j] = inner(whitened[i], directions[j], nv) * operator[j, count]


@kernel
def carries_nothing(system, r):
    """Whether row r is the normal of a unilateral contact that stays closed without a load (NORMAL_SIGN is 0)."""
    c, row = system.row_index[r, 0], system.row_index[r, 1]
    integers = system.contact_int[c]
    return c < system.sizes.nc and row == 2 and integers[UNILATERAL] != 0 and integers[NORMAL_SIGN] == 0


@kernel
def count_unloaded(system, count):
    """How many of the rows are such normals."""
    unloaded = 0
    for j in range(count):
        unloaded += carries_nothing(system, j)
    return unloaded


@kernel
def leave_unloaded(system, count):
    """Zero the columns of contacts that carry nothing in `delassus`, and mark them by -1 in its last one."""
    operator = system.delassus
    for j in range(count):
        if carries_nothing(system, j):
            operator[j, count] = -1.0
            for i in range(count):
                operator[i, j] = 0.0


@separate_kernel(NOTHING, SYSTEM.type, INTEGER, when=SEVERAL)
def solve_for_least(system, count):
    """Multipliers of least norm in their units, from the right-hand sides in their place."""
    operator, multipliers, scratch = system.delassus, system.multipliers, system.constraint_rows
    right = system.right_side
    weigh_forces(system, count)
    leave_unloaded(system, count)
    for j in range(count):
        right[j] = multipliers[j] if operator[j, count] != 0.0 else 0.0
    least_norm(operator, right, count, count, multipliers, scratch, system.permutation, RANK_TOLERANCE)
    for j in range(count):
        multipliers[j] *= max(operator[j, count], 0.0)


@separate_kernel(INTEGER, SYSTEM.type, INTEGER, when=SEVERAL)
def unloaded_event_functions(system, count):
    """Event functions of contacts that carry nothing: how far from the least forces a load of theirs would be; EVENT
    where one is negative, or where such a contact does not stay closed by itself.

    The forces are least among those that are not negative if N = A^T y + s in their units, with s >= 0 at those that
    are zero (Kuhn and Tucker).
    """
    nv, operator, multipliers, scratch = system.sizes.nv, system.delassus, system.multipliers, system.constraint_rows
    right = system.right_side
    weigh_forces(system, count)
    loaded = 0
    for j in range(count):
        if operator[j, count] > 0.0 and not carries_nothing(system, j):
            for i in range(count):
                scratch[loaded, i] = operator[i, j]
            right[loaded] = multipliers[j] / operator[j, count]
            loaded += 1
    least_norm(scratch, right, loaded, count, multipliers, operator, system.permutation, RANK_TOLERANCE)
    status = OK
    for j in range(count):
        if not carries_nothing(system, j):
            continue
        c, load = system.row_index[j, 0], 0.0
        for i in range(count):
            load += inner(system.whitened_rows[i], system.whitened_forces[j], nv) * multipliers[i]
        margin = -load * operator[j, count] * operator[j, count]
        free, held = system.bias[c, 2], inner(system.rows[c, 2], system.acceleration, nv)
        if abs(held + free) > _CLOSES * (abs(held) + abs(free) + 1.0):
            margin = -1.0
        system.event_functions[c, NORMAL_EVENT] = margin
        if margin < 0.0:
            status = EVENT
    return status
