"""Resistance to spinning and rolling: dry friction of the relative angular velocity, whose limit a contact's load sets.

A resistance is an item of its own beside contacts and limited joint coordinates, with the same arrays: its `slip` is
omega_2 - omega_1, its basis starts with the normal (spinning) or with the tangents (rolling), its force is the torque
on body 2, its coefficient a length. It sticks, slips or, while its contact is open, is free.
"""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..constraints.kinematics import NORMAL_RATE, ROW_ROUND_OFF, add_rotation_row
from ..geometry.carriers import ALPHA, OMEGA
from ..geometry.patterns import ON_CURVE
from ..geometry.small import dot
from ..jit import CALLED, INTEGER, NOTHING, kernel
from ..layout import (
    FREE,
    MODE,
    NORMAL_SIGN,
    OWNER,
    PATTERN,
    ROLLING_ROW,
    SPINNING_ROW,
    SUPPORT_SIZE,
    SYSTEM,
    TANGENTS,
    UNILATERAL,
)


@kernel
def count_items(system):
    """Contacts, limited joint coordinates and resistances: all that constraint rows may belong to."""
    beyond = system.joint_count[0] + system.resistance_count[0]
    return system.sizes.nc + beyond


@kernel
def resists(integers_c):
    """Whether a contact resists spinning or rolling."""
    return integers_c[SPINNING_ROW] + integers_c[ROLLING_ROW] > 0


@kernel
def free_with_owners(contact_int, first, total):
    """Free the resistances, items first .. total, of open contacts."""
    for i in range(first, total):
        if contact_int[contact_int[i, OWNER], MODE] == FREE:
            contact_int[i, MODE] = FREE


@kernel
def size_of_load(contact_int, force, c):
    """|F_n| of contact c from forces along the bases."""
    if contact_int[c, PATTERN] == ON_CURVE:
        return math.hypot(force[c, 1], force[c, 2])
    return abs(force[c, 2])


@kernel
def pulls(contact_int, force, c):
    """Whether the load of contact c has changed its sign, as it may within a trial step."""
    if contact_int[c, PATTERN] == ON_CURVE:
        return False
    return force[c, 2] < 0.0 if contact_int[c, UNILATERAL] != 0 else contact_int[c, NORMAL_SIGN] * force[c, 2] < 0.0


@kernel
def drop_unturned(row, nv):
    """Zero a row (nv,) of an angular velocity, sums of two cosines, of which only round-off is left: no joint turns the
    bodies about its axis."""
    for k in range(nv):
        if abs(row[k]) > ROW_ROUND_OFF:
            return
    for k in range(nv):
        row[k] = 0.0


@separate_kernel(NOTHING, SYSTEM.type, INTEGER, when=CALLED)
def resistance_kinematics(system, c):
    """Basis, relative angular velocity, rows and biases of contact c's resistances, after its own kinematics.

    The rate of a tangential component of omega leaves out what only turns the other tangential one into it: a
    resistance holds both or none, and where it gives way that turns the direction, not the speed.
    """
    sizes = system.sizes
    nv = sizes.nv
    contact_int = system.contact_int
    basis, slip = system.basis, system.slip
    bias, rows = system.bias, system.rows
    frames, normal_rate = system.frames, system.vectors[NORMAL_RATE]
    side_int = system.side_int
    jacobian, support = system.jacobian, system.support
    one, two = 2 * c, 2 * c + 1
    normal = basis[c, 2]
    for rolls in range(2):
        item = contact_int[c, ROLLING_ROW if rolls == 1 else SPINNING_ROW]
        if item == 0:
            continue
        # the normal comes first, or the tangents; in a plane everything rolls about its normal, the second vector
        shift = 2 if rolls == 0 else (0 if contact_int[item, TANGENTS] == 2 else 1)
        omega = slip[item]
        for i in range(3):
            omega[i] = frames[two, OMEGA, i] - frames[one, OMEGA, i]
            for row in range(3):
                basis[item, row, i] = basis[c, (row + shift) % 3, i]
        for row in range(contact_int[item, TANGENTS]):
            about = basis[item, row]
            bias[item, row] = dot(about, frames[two, ALPHA]) - dot(about, frames[one, ALPHA])
            if rolls == 1:
                bias[item, row] -= dot(omega, normal) * dot(about, normal_rate)
            else:
                bias[item, row] += dot(omega, normal_rate)
            for k in range(nv):
                rows[item, row, k] = 0.0
            for side in range(one, two + 1):
                sign = 1.0 if side == two else -1.0
                add_rotation_row(sign, jacobian, support[side], side_int[side, SUPPORT_SIZE], about, rows[item, row])
            drop_unturned(rows[item, row], nv)
