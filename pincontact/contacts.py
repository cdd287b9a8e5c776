"""What a scene holds: contours on frames, and contacts between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pinocchio as pin

from .contours.base import Contour
from .friction.laws import FrictionLaw
from .geometry.patterns import Pattern

if TYPE_CHECKING:
    from .contours.motion import Motion


@dataclass(frozen=True, eq=False)
class AttachedContour:
    """A contour carried by a frame of the model.

    placement: contour in frame. motion: placement of time, applied after it, or None.
    joint, placement_in_joint: where the frame's joint carries it (joint 0 is the world).
    """

    name: str
    contour: Contour
    frame: str
    placement: pin.SE3
    motion: Motion | None
    joint: int
    placement_in_joint: pin.SE3

    def __repr__(self) -> str:
        motion = "" if self.motion is None else f", moved by {self.motion!r}"
        return f"<AttachedContour {self.name!r}: {self.contour!r} on frame {self.frame!r}{motion}>"


@dataclass(frozen=True, eq=False)
class Contact:
    """A persistent contact of two contours.

    body1, body2: the paper's order (k2 >= k1); swapped says whether the user named them the other way round.
    side: +1 or -1, on which side of e_3 body 1 lies; None is decided by the initial state.
    """

    name: str
    first: AttachedContour
    second: AttachedContour
    friction: FrictionLaw | None
    bilateral: bool
    pattern: Pattern
    location: tuple[Any, Any] | None
    side: int | None
    restitution: float

    def __repr__(self) -> str:
        law = "frictionless" if self.friction is None else repr(self.friction)
        return f"<Contact {self.name!r}: {self.pattern.name} of {self.first.name!r} and {self.second.name!r}, {law}>"

    @property
    def swapped(self) -> bool:
        return self.first.contour.dimension > self.second.contour.dimension

    @property
    def body1(self) -> AttachedContour:
        return self.second if self.swapped else self.first

    @property
    def body2(self) -> AttachedContour:
        return self.first if self.swapped else self.second


class Assembly:
    """A Pinocchio model, contours on its frames and contacts between them: the data of a `Scene`, in the order in which
    they were added."""

    model: pin.Model
    contours: dict[str, AttachedContour]
    contacts: dict[str, Contact]


def characteristic_length(contact: Contact) -> float:
    """The contact's natural length in m: the smaller contour's size, 1 m if neither has one."""
    sizes = [s.contour.size for s in (contact.first, contact.second)]
    finite = [s for s in sizes if math.isfinite(s) and s > 0.0]
    return min(finite) if finite else 1.0
