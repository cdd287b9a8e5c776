"""What a scene holds: contours on frames, and contacts between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pinocchio as pin

from .contours.base import Contour
from .friction.laws import FrictionLaw
from .geometry.patterns import Pattern

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .contours.motion import Motion


@dataclass(frozen=True, eq=False)
class AttachedContour:
    """A contour carried by a frame of the model; `Scene.add_contour` makes it.

    Attributes
    ----------
    name : str
    contour : Contour
    frame : str
        Name of the frame, or of a joint that has none.
    placement : pin.SE3
        Contour in frame.
    motion : Motion, optional
        A further placement as a function of time, applied after it.
    joint : int
        The frame's joint; 0 is the world.
    placement_in_joint : pin.SE3
        Contour in joint, without the motion.
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
    """A persistent contact of two contours; `Scene.add_contact` makes it.

    Attributes
    ----------
    name : str
    first, second : AttachedContour
        In the user's order.
    friction : FrictionLaw, optional
        None where there is none.
    bilateral : bool
        Whether the contact never opens.
    pattern : Pattern
    location : (u_first, u_second), optional
        The user's guess of the location parameters, in m or rad.
    side : {1, -1}, optional
        On which side of e_3 body 1 lies; None is decided by the initial state.
    restitution : float
        Newton's coefficient, 0 to 1.
    """

    name: str
    first: AttachedContour
    second: AttachedContour
    friction: FrictionLaw | None
    bilateral: bool
    pattern: Pattern
    location: tuple[ArrayLike | None, ArrayLike | None] | None
    side: int | None
    restitution: float

    def __repr__(self) -> str:
        law = "frictionless" if self.friction is None else repr(self.friction)
        return f"<Contact {self.name!r}: {self.pattern.name} of {self.first.name!r} and {self.second.name!r}, {law}>"

    @property
    def swapped(self) -> bool:
        """Whether the user named the contours the other way round than the paper does, which has k2 >= k1."""
        return self.first.contour.dimension > self.second.contour.dimension

    @property
    def body1(self) -> AttachedContour:
        """The paper's body 1, the contour with fewer parameters; the first one where both have as many."""
        return self.second if self.swapped else self.first

    @property
    def body2(self) -> AttachedContour:
        """The paper's body 2."""
        return self.first if self.swapped else self.second


class Assembly:
    """The data of a `Scene`.

    Attributes
    ----------
    model : pin.Model
    contours : dict of str to AttachedContour
        In the order in which they were added.
    contacts : dict of str to Contact
        Likewise.
    """

    model: pin.Model
    contours: dict[str, AttachedContour]
    contacts: dict[str, Contact]


def characteristic_length(contact: Contact) -> float:
    """The contact's natural length in m: the smaller contour's size, 1 m if neither has one."""
    sizes = [s.contour.size for s in (contact.first, contact.second)]
    finite = [s for s in sizes if math.isfinite(s) and s > 0.0]
    return min(finite) if finite else 1.0
