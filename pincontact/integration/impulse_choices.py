"""Whether a step's cone problem leaves a choice among forces, and of which units; compiled."""

from __future__ import annotations

import math

from ..friction import cone
from ..jit import kernel
from ..linalg import inner
from ..workspace import square
from .impulse_layout import APART, ON_CONTACT, ON_JOINT, ON_TURN

# Rows whose Gram determinant, of rows scaled to unit length, is larger are independent for `choices`, too: their least
# singular value is above 1e-5, that of forces at their limits of friction above 1e-5 / sqrt(2).
_INDEPENDENT = 1e-9


@kernel
def may_be_redundant(step, nv, n, factor, row_of):
    """Whether forces of the n units may be redundant. They are not where the rows are independent: the least eigenvalue
    of their Gram matrix, scaled to a unit diagonal, is at least its determinant over e. Friction that acts on nothing
    does not count, as that across a mechanism which moves in a plane: it is zero, and any other would hold less.

    factor (m, m), row_of (m,): room for so many rows; where there are more, they may be redundant.
    """
    whitened, delassus = step.whitened, square(step.delassus, 3 * n)
    count, room, determinant = 0, row_of.shape[0], 1.0
    for r in range(3 * n):
        if step.units[r // 3].mask >> r % 3 & 1 == 0:
            continue
        size = inner(whitened[r], whitened[r], nv)
        if size == 0.0 and r % 3 < 2:
            continue
        if size == 0.0 or count == room:
            return True
        rest, own = size, factor[count]
        for j in range(count):
            other = factor[j]
            own[j] = (delassus[r, row_of[j]] - inner(own, other, j)) / other[j]
            rest -= own[j] * own[j]
        determinant *= rest / size
        if not determinant > _INDEPENDENT:
            return True
        own[count], row_of[count] = math.sqrt(rest), r
        count += 1
    return False


@kernel
def _act(step, n, u, w):
    """Whether two units act on each other, directly or by the equations that have been eliminated."""
    units, delassus, overlap = step.units, square(step.delassus, 3 * n), step.overlap
    if units[u].parent == w or units[w].parent == u:
        return True
    for i in range(3 * u, 3 * u + 3):
        for j in range(3 * w, 3 * w + 3):
            if delassus[i, j] != 0.0:
                return True
    for e in range(step.counts.equations):
        own = other = False
        for row in range(3):
            own = own or overlap[3 * u + row, e] != 0.0
            other = other or overlap[3 * w + row, e] != 0.0
        if own and other:
            return True
    return False


@kernel
def _group(step, n):
    """Number groups of units that act on each other, by their first ones."""
    units = step.units
    for u in range(n):
        units[u].group = u
        for w in range(u):
            one, other = units[u].group, units[w].group
            if one != other and _act(step, n, u, w):
                for k in range(u + 1):
                    if units[k].group in (one, other):
                        units[k].group = min(one, other)


@kernel
def leaves_choice(step, n):
    """Whether there is a choice among the forces of the n units that moves the bodies, since some of them slide, and
    that is not yet what the rule has it, since it depends on the last forces: for each group of units that act on each
    other, which is noted.

    Where others stick, joints are held, or torques resist turning, rigid bodies leave loads open: that is counted, and
    with such torques the choice is left as it is. So do loads that unilateral contacts share with bilateral ones, which
    get all of them here.
    """
    units, address = step.units, step.cone_tables[n]
    tied = slips = choices = follows = opens = found = False
    for u in range(n):
        tied = tied or (units[u].tied != 0 and units[u].touches == 0)
        slips = slips or (units[u].kind < ON_JOINT and step.cone_modes[u] == cone.SLIP and step.friction[u] > 0.0)
    if address != 0 and step.counts.coupled == APART:
        known = cone.cone_at(address).counts
        choices, follows = known[cone.CHOICES] != 0, known[cone.FOLLOWS] != 0
    if not (choices or (tied and slips)):
        return False
    _group(step, n)
    for first in range(n):
        tied = slips = slides = holds = turns = rests = False
        for u in range(first, n):
            if units[u].group != first:
                continue
            tied = tied or (units[u].tied != 0 and units[u].touches == 0)
            kind, sticks = units[u].kind, step.cone_modes[u] == cone.STICK
            slid, rubs = step.cone_modes[u] == cone.SLIP, step.friction[u] > 0.0
            slips = slips or (kind < ON_JOINT and slid and rubs)
            turns = turns or (kind == ON_TURN and slid)
            rests = rests or (kind == ON_TURN and not slid)
            slides = slides or (kind == ON_CONTACT and rubs and slid)
            # dry friction at rest; a limit has no friction: what is held there slips
            joint_held = kind == ON_JOINT and (sticks or (slid and step.friction[u] == 0.0))
            holds = holds or (kind == ON_CONTACT and rubs and sticks) or joint_held
        shared, resists = tied and slips, turns or rests
        opens = opens or shared or (choices and ((slides and (holds or resists)) or (turns and holds)))
        chooses = choices and not shared and slides and not resists and follows
        found = found or chooses
        for u in range(first, n):
            if units[u].group == first:
                units[u].chooses = 1 if chooses else 0
    if opens:
        step.counts.open_loads += 1
    return found
