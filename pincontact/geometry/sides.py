"""On which side of a contour that has ends a body is that has not come over it yet.

What the contour would go on as says nothing of that; the contour itself does, where it is nearest to the body's middle.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..contacts import Contact, may_be_beside
from ..contours.base import F_T, F_TT
from ..layout import CHART, CLOSED_FORM, K1, LENGTH, OVERLAP, PATTERN, SAME_PLACE, SIDE
from ..workspace import Workspace
from .carriers import OMEGA, ORIGIN, VELOCITY
from .location import NO_CLOSED_FORM
from .patterns import ON_SURFACE, PLANAR
from .search import Candidate, nearest_point
from .single_touch import middle_of, reach_of

# A contact is nowhere near an end if it is so many times farther from it than the body: or on the other side of an arc.
_FAR = 2.0
# Curves that are this part of a contact's length apart may touch.
_TOUCHES = 1e-6


class Beside:
    """The body of a contact of a system (`dynamics.system`) that has no ends, or is smaller, in any state, as seen from
    the piece, the other one, which has ends.

    nearest: (k2,) parameters of the piece's point that is nearest to the middle of the body at the last look; distance:
    how far from it that is, in m; side: of the piece's normal on which the body is, +1 or -1, 0 where its middle is on
    neither, or it is a point.
    """

    def __init__(self, system: Workspace, c: int) -> None:
        self.system, self.c = system, c
        body, self.piece = system.contacts[c].body1.contour, system.contacts[c].body2.contour
        self._middle, self._reach = middle_of(body), reach_of(body)
        self.nearest, self.distance, self.side = np.zeros(self.piece.dimension), 0.0, 0
        self._off = float(np.linalg.norm(self._middle))
        # where the middle was at the last look, when, and how far it may go from there
        self._place, self._time, self._way = np.zeros(3), math.nan, 0.0
        # speed in m/s and acceleration in m/s^2 of the piece's nearest point by its dependence on time, then
        self._rate = self.bending = 0.0

    @staticmethod
    def is_seen(system: Workspace, c: int) -> bool:
        """Whether body 2 of contact c has ends beside which body 1 may be, and that matters: its side is told, or it
        has to be followed."""
        contact, integers = system.contacts[c], system.contact_int[c]
        if integers[PATTERN] not in (PLANAR, ON_SURFACE):
            return False
        followed = integers[CLOSED_FORM] == NO_CLOSED_FORM or (integers[K1] != 0 and contact.side is None)
        return bool(followed) and may_be_beside(contact.body1.contour, contact.body2.contour)

    def place(self) -> np.ndarray:
        """(3,) middle of the body in m in the piece's frame, as last evaluated."""
        own, other = self.system.frames[2 * self.c : 2 * self.c + 2]
        return np.asarray(other[:3].T @ (own[:3] @ self._middle + own[ORIGIN] - other[ORIGIN]))

    def speed(self) -> float:
        """Its speed towards the piece in m/s, at most."""
        own, other = self.system.frames[2 * self.c : 2 * self.c + 2].tolist()
        turning = math.hypot(*own[OMEGA]) * self._off
        turning += math.hypot(*other[OMEGA]) * (math.dist(own[ORIGIN], other[ORIGIN]) + self._off)
        return math.dist(own[VELOCITY], other[VELOCITY]) + turning + self._rate

    def left(self, t: float) -> float:
        """How far in m the middle may go before the body may touch, or is on another side, for all that was seen."""
        if self.piece.time_dependent and t != self._time:
            return 0.0
        return max(self._way - float(np.linalg.norm(self.place() - self._place)), 0.0)

    def look(self, t: float) -> bool:
        """See on which side the body is at the last evaluation; whether it is over the piece: the nearest point is at
        none of its ends."""
        self._place, self._time, piece, numbers = self.place(), t, self.piece, self.system.contact_real[self.c]
        u, values = nearest_point(piece, self._place, t)
        across = values[2] if piece.dimension == 2 else np.array([0.0, 0.0, 1.0])
        normal, way = np.cross(values[1], across), self._place - values[0]
        height, self.distance = float(normal @ way / np.linalg.norm(normal)), float(np.linalg.norm(way))
        if piece.time_dependent:
            self._rate, self.bending = np.linalg.norm(values[F_T]).item(), np.linalg.norm(values[F_TT]).item()
        self.nearest, self._speeds = u, np.linalg.norm(values[1 : 1 + piece.dimension], axis=1)
        # so little, in any case, that it cannot touch before the next look from another side
        self._way = max(abs(height), self.distance - self._reach, float(numbers[OVERLAP]))
        is_on = abs(height) <= SAME_PLACE * numbers[LENGTH] or self.system.contact_int[self.c, K1] == 0
        self.side = 0 if is_on else int(np.sign(height))
        return not any(u[a] in ends for a, ends in enumerate(piece.ends().reshape(2, 2)[: piece.dimension]))

    def is_turned(self) -> bool:
        """Whether the contact is, at the last look, on another side than the body, and none is given."""
        return self.system.contacts[self.c].side is None and self.side * self.system.contact_int.item(self.c, SIDE) < 0

    def is_far(self) -> bool:
        """Whether the contact is, at the last look, nowhere near where the piece is nearest."""
        if self.system.side_int[2 * self.c + 1, CHART] != 0:
            return False
        away = self.system.location[self.c, 2:][: self.piece.dimension] - self.nearest
        return not float(np.abs(away * self._speeds).sum()) <= _FAR * (self.distance + self._reach)


def side_of_crossing(system: Workspace, c: int) -> int:
    """On which side of e_3 body 1 is whose curve crosses that of body 2, as last evaluated, +1 or -1: that on which the
    curves are apart, or, where they touch as far as is known, as edges of solids that slide on each other do, that of
    the mass of what carries them; 0 where neither tells."""
    side, gap, length = int(system.contact_int[c, SIDE]), float(system.gaps[c, 0]), system.contact_real[c, LENGTH]
    if abs(gap) > SAME_PLACE * length:
        return side if gap > 0.0 else -side
    contact, towards = system.contacts[c], 0.0
    for i, body in enumerate((contact.body1, contact.body2)):
        if body.joint != 0:
            frame = system.frames[2 * c + i]
            mass = body.placement_in_joint.actInv(system.model.inertias[body.joint].lever)
            way = frame[:3] @ mass - system.derivatives[2 * c + i, 0]
            # e_3 leads from body 1 to body 2
            towards += (-1.0, 1.0)[i] * float(system.basis[c, 2] @ way)
    return 0 if abs(towards) <= SAME_PLACE * length else side if towards > 0.0 else -side


def crossings_apart(system: Workspace, c: int, candidates: list[Candidate]) -> list[Candidate]:
    """Of the places at which curves cross those where they are apart, or touch: on the side of contact c if that is
    given, else on either one but where the contact is, lest they go through each other there."""
    side, same = int(system.contact_int[c, SIDE]), _TOUCHES * system.contact_real[c, LENGTH]
    present = system.frames[2 * c + 1, ORIGIN] + system.derivatives[2 * c + 1, 0]
    apart = []
    for one in candidates:
        gap = one.gap * one.side * side
        keeps = system.contacts[c].side is not None or np.linalg.norm(one.point - present) < same
        if gap >= -same:
            apart.append(replace(one, gap=gap, side=side))
        elif not keeps:
            apart.append(replace(one, gap=-gap, side=-side))
    return apart


def side_of_all(single: Workspace, t: float) -> int:
    """On which side of body 2 body 1 is, from which it is apart, as evaluated, by any of its points: where body 2 has
    no ends, or bends away from that point; 0 elsewhere."""
    contact, (own, other) = single.contacts[0], single.frames[:2]
    one, two = contact.body1.contour, contact.body2.contour
    if single.contact_int[0, PATTERN] not in (ON_SURFACE, PLANAR):
        return 0
    point = own[:3] @ one.point(middle_of_domains(contact)[: one.dimension].tolist(), t) + own[ORIGIN]
    local = other[:3].T @ (point - other[ORIGIN])
    _, values = nearest_point(two, local, t)
    normal = np.cross(values[1], values[2] if two.dimension == 2 else [0.0, 0.0, 1.0])
    side = int(np.sign(normal @ (local - values[0])))
    return 0 if np.isfinite(two.ends()).any() and side != two.convex_side else side


def middle_of_domains(contact: Contact) -> np.ndarray:
    """(4,) contact coordinates in the middle of both domains, 0 where these are infinite."""
    middle = np.zeros(4)
    for offset, body in ((0, contact.body1), (2, contact.body2)):
        for a, ends in enumerate(body.contour.domain):
            middle[offset + a] = 0.5 * sum(ends) if np.isfinite(ends).all() else 0.0
    return middle
