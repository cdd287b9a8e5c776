"""What a scene holds: contours on frames, and contacts between them."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from .arguments import NOT_REAL, real_array
from .contours.base import Contour
from .errors import ArgumentError, ContactError, ContourError, ModelError
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

    @property
    def carrier(self) -> tuple[int, Motion | None]:
        """What carries the contour: a joint, and a prescribed motion."""
        return self.joint, self.motion

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
        On which side of e_3 body 1 lies; None is decided by the initial state, and wherever it comes over body 2.
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

    @cached_property
    def swapped(self) -> bool:
        """Whether `first` is body 2.

        So is the contour with more parameters, and a piece with ends beside which the other one may be, on a side that
        has to be seen.

        Returns
        -------
        bool
        """
        one, two = self.first.contour, self.second.contour
        if one.dimension != two.dimension:
            return one.dimension > two.dimension
        return self.side is None and not self.bilateral and may_be_beside(two, one)

    @property
    def bodies(self) -> frozenset[tuple[int, Motion | None]]:
        """What carries the two contours: joints, and prescribed motions."""
        return frozenset((self.first.carrier, self.second.carrier))

    @property
    def body1(self) -> AttachedContour:
        """The paper's body 1: the contour with fewer parameters, and what else `swapped` says."""
        return self.second if self.swapped else self.first

    @property
    def body2(self) -> AttachedContour:
        """The paper's body 2."""
        return self.first if self.swapped else self.second


def in_order(first: AttachedContour, second: AttachedContour) -> tuple[AttachedContour, AttachedContour]:
    """The contour with fewer parameters, then the other one; as they are where both have as many."""
    return (second, first) if first.contour.dimension > second.contour.dimension else (first, second)


def may_be_beside(body: Contour, piece: Contour) -> bool:
    """Whether a contour is a piece with ends beside which another one may be, which is bounded, and has none or is
    smaller."""
    if not (np.isfinite(piece.ends()).any() and np.isfinite(body.domain).all()):
        return False
    return not np.isfinite(body.ends()).any() or body.size < piece.size


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


# What `Scene.add_contacts` takes: one attached contour or its name, or several.
Contours = AttachedContour | str | Iterable[AttachedContour | str]


def in_pairs(firsts: Contours, seconds: Contours) -> list[tuple[str, AttachedContour | str, AttachedContour | str]]:
    """Name of the contact and its contours, for as many of both, or for one and many."""
    first, second = _listed("firsts", firsts), _listed("seconds", seconds)
    if len(first) != len(second) and 1 not in (len(first), len(second)):
        raise ArgumentError(
            f"firsts and seconds must be as many, or one of them one alone, got {len(first)} and {len(second)} contours"
        )
    pairs = zip(first, second) if len(first) == len(second) else product(first, second)
    return [(f"{_name(one)}-{_name(two)}", one, two) for one, two in pairs]


def _listed(argument: str, given: Contours) -> list[AttachedContour | str]:
    listed = [given] if isinstance(given, (AttachedContour, str)) else None
    if listed is None and isinstance(given, Iterable):
        listed = list(given)
    if listed is None or not all(isinstance(one, (AttachedContour, str)) for one in listed):
        raise ArgumentError(f"{argument} must be contours or names of contours, got {given!r}")
    return listed


def _name(given: AttachedContour | str) -> str:
    return given if isinstance(given, str) else given.name


def check_name(name: Any, error: type[ContactError]) -> None:
    """The error unless a name is a string."""
    if not isinstance(name, str):
        raise error(f"a name must be a string, got {name!r}")


def check_placement(contour: str, placement: Any) -> None:
    """ContourError unless a contour's placement is a finite pose."""
    if not isinstance(placement, pin.SE3) or not np.isfinite(placement.homogeneous).all():
        raise ContourError(f"contour {contour!r}: placement must be a finite pinocchio SE3, got {placement!r}")
    rotation = placement.rotation
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9) or np.linalg.det(rotation) < 0.0:
        raise ContourError(f"contour {contour!r}: the placement's rotation is not a rotation matrix")


def place_on_joint(model: pin.Model, contour: str, frame: str, placement: pin.SE3) -> tuple[int, pin.SE3]:
    """The joint that carries a contour, and its placement there, from its placement in a frame of that name: a body's
    where a joint has the same name, as is common in URDFs; ModelError where there is none."""
    if not isinstance(frame, str):
        raise ModelError(f"contour {contour!r}: frame must be the name of a frame, got {frame!r}")
    if not model.existFrame(frame):
        if model.existJointName(frame):
            return int(model.getJointId(frame)), placement
        names = [f.name for f in model.frames]
        close = difflib.get_close_matches(frame, names, n=3)
        hint = f"; did you mean {' or '.join(close)}?" if close else f"; frames: {', '.join(names[:20])}"
        raise ModelError(f"contour {contour!r}: the model has no frame {frame!r}{hint}")
    for kind in (pin.FrameType.BODY, pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT, pin.FrameType.OP_FRAME):
        if model.existFrame(frame, kind):
            carrier = model.frames[model.getFrameId(frame, kind)]
            return int(carrier.parentJoint), carrier.placement * placement
    raise ModelError(f"contour {contour!r}: frame {frame!r} is of a kind that cannot carry a contour")


def check_friction(contact: str, law: FrictionLaw, one: AttachedContour, two: AttachedContour, found: Pattern) -> None:
    """Whether a law has its directions at a contact of this pattern; ArgumentError otherwise."""
    if isinstance(getattr(law, "mu", None), tuple):
        if found.tangents != 2:
            raise ArgumentError(
                f"contact {contact!r}: friction of two directions needs two tangents; {found.name} has one"
            )
        along = two if law.along is None else {one.name: one, two.name: two}.get(law.along)
        if along is None:
            raise ArgumentError(
                f"contact {contact!r}: friction is along {law.along!r}, which is neither {one.name!r} nor {two.name!r}"
            )
        if along.contour.dimension == 0:
            raise ArgumentError(f"contact {contact!r}: friction is along {along.name!r}, a point, which has no tangent")
        if len(along.contour.charts) > 1:
            raise ArgumentError(
                f"contact {contact!r}: friction is along {along.name!r}, whose tangents change with its charts; name "
                "the other contour by along="
            )
    if law.spinning > 0.0 and found.tangents != 2:
        raise ArgumentError(f"contact {contact!r}: nothing spins about the normal of {found.name}; spinning must be 0")
    if law.rolling > 0.0 and found.constraints == 2:
        raise ArgumentError(f"contact {contact!r}: a point on a spatial curve does not roll; rolling must be 0")


def check_location(contact: str, first: AttachedContour, second: AttachedContour, location: Any) -> None:
    """ArgumentError unless a guess of location parameters is None or, for each contour, None or its numbers."""
    if location is None:
        return
    if not isinstance(location, (tuple, list)) or len(location) != 2:
        raise ArgumentError(f"contact {contact!r}: location must be a pair (u_first, u_second), got {location!r}")
    for owner, guess in zip((first, second), location):
        if guess is not None and not _are_finite(guess, owner.contour.dimension):
            raise ArgumentError(
                f"contact {contact!r}: the location guess of {owner.name!r} needs {owner.contour.dimension} "
                f"finite numbers, got {guess!r}"
            )


def _are_finite(values: Any, count: int) -> bool:
    """Whether these are so many finite numbers."""
    try:
        array = real_array(values)
    except NOT_REAL:
        return False
    return array.size == count and bool(np.isfinite(array).all())
