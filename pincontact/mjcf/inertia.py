"""Inertias of the bodies of an MJCF file: given, or those of their geoms, with the compiler's bounds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..errors import ModelError
from .document import ORIENTATIONS, Document, Element, z_turned_to

# Principal moments beyond the triangle inequality by no more than this are those of a flat body, rounded.
_TRIANGLE = 1e-9
# Masses and volumes below this are none, as for MuJoCo.
_SMALL = 1e-14
_DENSITY = 1000.0
# Types of geoms and how many sizes each has.
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
TYPES = (*SIZES, "plane", "hfield", "mesh", "sdf")


@dataclass(frozen=True, eq=False)
class Geom:
    """A geom in the frame of its body. size: radii and half lengths in m, as many as `SIZES` says of its type."""

    element: Element
    type: str
    size: np.ndarray
    placement: pin.SE3

    @property
    def fitted(self) -> bool:
        """Whether its size is that of a mesh."""
        return self.element.has("mesh") and self.type in SIZES


def read_geom(element: Element, frame: pin.SE3) -> Geom:
    """frame: placement of the element's surroundings in the body."""
    kind = element.choice("type", TYPES, "sphere")
    count = SIZES.get(kind, 0)
    if count == 0 or element.has("mesh"):
        return Geom(element, kind, np.zeros(count), frame * element.placement())
    if not element.has("fromto"):
        size = element.numbers("size", 1, 3)
        placement = element.placement()
    else:
        if kind == "sphere":
            raise element.error("fromto goes with a capsule, cylinder, ellipsoid or box, not with a sphere")
        ends = element.numbers("fromto", 6, 6).reshape(2, 3)
        along = ends[0] - ends[1]
        length = float(np.linalg.norm(along))
        if length < _SMALL:
            raise element.error(f"fromto joins two points that are the same, got {element.text('fromto')!r}")
        radius = element.numbers("size", 1, 3)[:1]
        size = np.array([*np.repeat(radius, count - 1), 0.5 * length])
        placement = pin.SE3(z_turned_to(along / length), 0.5 * (ends[0] + ends[1]))
    if size.size < count or not (size[:count] > 0.0).all():
        raise element.error(f"size of a {kind} must be {count} positive numbers, got {element.text('size')!r}")
    return Geom(element, kind, size[:count], frame * placement)


def body_inertia(
    document: Document, what: str, inertial: Element | None, geoms: Sequence[Geom], placement: pin.SE3
) -> pin.Inertia:
    """The inertia of a body in its own frame.

    what: the body, for messages. placement: of the body in its parent, where the compiler's bounds put their mass.
    """
    compiler = document.compiler
    source = compiler.choice("inertiafromgeom", ("true", "false", "auto"), "auto")
    found = None if inertial is None else _given(inertial)
    if source == "true" or (source == "auto" and inertial is None):
        found = _of_geoms(document, geoms) or found
    if found is None:
        # with bounds MuJoCo has mass even where there is no body: at this place
        found = pin.Inertia(0.0, placement.translation, np.zeros((3, 3)))
    return _bounded(document, what, found)


def _given(inertial: Element) -> pin.Inertia:
    for name in ("mass", "pos"):
        if not inertial.has(name):
            raise inertial.error(f"{name} is missing")
    place = inertial.placement()
    mass = inertial.not_negative("mass")
    if inertial.has("fullinertia"):
        for name in ("diaginertia", *ORIENTATIONS):
            if inertial.has(name):
                raise inertial.error(f"both fullinertia and {name} are given")
        xx, yy, zz, xy, xz, yz = inertial.numbers("fullinertia", 6, 6)
        moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        moments = place.rotation @ np.diag(inertial.numbers("diaginertia", 3, 3, (0.0, 0.0, 0.0))) @ place.rotation.T
    return pin.Inertia(mass, place.translation, moments)


def _of_geoms(document: Document, geoms: Sequence[Geom]) -> pin.Inertia | None:
    low, high = document.compiler.numbers("inertiagrouprange", 2, 2, (0.0, 5.0))
    total = None
    for geom in geoms:
        if low <= geom.element.number("group") <= high:
            inertia = _of_geom(geom)
            if inertia is not None:
                total = inertia if total is None else total + inertia
    return total


def _of_geom(geom: Geom) -> pin.Inertia | None:
    """The inertia of a geom in the frame of its body; None where it has no mass."""
    element = geom.element
    density = element.not_negative("density", _DENSITY)
    mass = element.not_negative("mass", math.nan)
    if geom.type in ("plane", "hfield") or mass == 0.0 or (math.isnan(mass) and density == 0.0):
        return None
    if geom.type not in SIZES or geom.fitted:
        raise element.error(
            "the inertia of a body is to follow from that of a mesh, which is not computed; give the body an "
            "<inertial>, or this geom mass='0'"
        )
    if element.flag("shellinertia"):
        raise element.error("the inertia of a shell is not computed; give the body an <inertial>")
    a, b, c = (*geom.size, *[geom.size[-1]] * (3 - geom.size.size))
    volume = {
        "sphere": 4.0 / 3.0 * math.pi * a**3,
        "capsule": math.pi * a**2 * (2.0 * b + 4.0 / 3.0 * a),
        "cylinder": math.pi * a**2 * 2.0 * b,
        "ellipsoid": 4.0 / 3.0 * math.pi * a * b * c,
        "box": 8.0 * a * b * c,
    }[geom.type]
    if math.isnan(mass):
        mass = density * volume
    if mass <= _SMALL or volume <= _SMALL:
        return None
    make = {
        "sphere": lambda: pin.Inertia.FromSphere(mass, a),
        "capsule": lambda: pin.Inertia.FromCapsule(mass, a, 2.0 * b),
        "cylinder": lambda: pin.Inertia.FromCylinder(mass, a, 2.0 * b),
        "ellipsoid": lambda: pin.Inertia.FromEllipsoid(mass, a, b, c),
        "box": lambda: pin.Inertia.FromBox(mass, 2.0 * a, 2.0 * b, 2.0 * c),
    }[geom.type]
    return geom.placement.act(make())


def _bounded(document: Document, what: str, inertia: pin.Inertia) -> pin.Inertia:
    """The inertia with the compiler's least mass and moments, and its answer to moments that no body has."""
    compiler = document.compiler
    least = compiler.not_negative("boundinertia")
    mass = max(inertia.mass, compiler.not_negative("boundmass"))
    moments, axes = np.linalg.eigh(inertia.inertia)
    bounded = np.maximum(moments, least)
    if moments[0] < -_TRIANGLE * abs(moments[2]) and least == 0.0:
        raise ModelError(f"{document.file}: {what}: a principal moment of inertia is {moments[0]:.6g} kg m^2")
    if bounded[0] + bounded[1] < bounded[2] * (1.0 - _TRIANGLE):
        if not compiler.flag("balanceinertia"):
            listed = ", ".join(f"{moment:.6g}" for moment in bounded)
            raise ModelError(
                f"{document.file}: {what}: no body has the principal moments of inertia {listed} kg m^2 (A + B >= C); "
                "the compiler's balanceinertia='true' makes them equal"
            )
        bounded = np.full(3, bounded.mean())
    if (bounded == moments).all():
        return pin.Inertia(mass, inertia.lever, inertia.inertia)
    return pin.Inertia(mass, inertia.lever, axes @ np.diag(bounded) @ axes.T)
