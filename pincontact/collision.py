"""Contours from the primitive collision shapes of a robot's own model: balls, cylinders, capsules, boxes, planes."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin

from .contours import Circle, Contour, Cylinder, Ellipsoid, Line, Plane, Point, Sphere
from .errors import ArgumentError, ContourError, ModelError, sentence

KINDS = ("faces", "rims", "edges", "corners")

# Name of the part, kind of part, contour, placement in the shape's own frame.
Part = tuple[str, str, Contour, pin.SE3]

_AXES = "xyz"
_SIGNS = ((1.0, "+"), (-1.0, "-"))


def contours_from_collision(
    model: pin.Model,
    shapes: pin.GeometryModel | None,
    links: Iterable[str] | None,
    kinds: Collection[str],
    unread: Collection[str] = (),
) -> list[tuple[str, Contour, str, pin.SE3]]:
    """Name, contour, frame and placement in it of the parts that `Scene.add_contours_from_collision` adds.

    shapes: of the links, None where there are none. unread: names of shapes that could not be read, for messages.
    """
    wanted_kinds = _names("kinds", kinds)
    for kind in wanted_kinds:
        if kind not in KINDS:
            raise ArgumentError(f"kinds: unknown kind {kind!r}; one or more of {', '.join(KINDS)}")
    if shapes is None:
        raise ModelError("the scene was made from a model alone, without collision shapes; pass geometry=")
    if not isinstance(shapes, pin.GeometryModel):
        raise ArgumentError(f"geometry must be a pinocchio GeometryModel or None, got {type(shapes).__name__}")
    objects = list(shapes.geometryObjects)
    names = None if links is None else _links(model, objects, _names("links", links), unread)
    found: list[tuple[str, Contour, str, pin.SE3]] = []
    seen: list[str] = []
    ignored: list[str] = []
    for item in objects:
        frame = _carrier(model, item)
        if names is not None and frame.name not in names:
            continue
        shown = f"{item.name} ({type(item.geometry).__name__})"
        make = _SHAPES.get(type(item.geometry).__name__)
        if make is None:
            ignored.append(shown)
            continue
        seen.append(shown)
        try:
            parts = list(make(item.geometry))
        except ContourError as error:
            raise ContourError(f"collision shape {item.name!r}: {error}") from error
        in_frame = frame.placement.inverse() * item.placement
        for part, kind, contour, placement in parts:
            if kind in wanted_kinds:
                found.append((f"{item.name}_{part}", contour, frame.name, in_frame * placement))
    remarks = []
    if ignored:
        remarks.append(
            "collision shapes that are not spheres, ellipsoids, cylinders, capsules, boxes or half-spaces were "
            f"ignored: {', '.join(ignored)}"
        )
    if unread:
        remarks.append(f"collision shapes that could not be read: {', '.join(unread)}")
    if not found and (names is None or names):
        made = f"{' and '.join(wanted_kinds) or 'nothing'} of: {', '.join(seen) or 'no shape'}"
        raise ModelError("; ".join([f"no contour was found among {made}", *remarks]))
    if remarks:
        warnings.warn(sentence("; ".join(remarks)), stacklevel=3)
    return found


def _names(argument: str, given: Any) -> list[str]:
    """One name, or several, as a list; ArgumentError for anything else."""
    names = [given] if isinstance(given, str) or not isinstance(given, Iterable) else list(given)
    for name in names:
        if not isinstance(name, str):
            raise ArgumentError(f"{argument} must be names, got {name!r}")
    return names


def _links(model: pin.Model, objects: list[Any], links: list[str], unread: Collection[str]) -> set[str]:
    """The links asked for, once every one of them is known to have a collision shape."""
    having = {_carrier(model, item).name for item in objects}
    for name in sorted(set(links) - having):
        close = difflib.get_close_matches(name, sorted(having), n=3)
        hint = f"did you mean {' or '.join(close)}?" if close else f"links that have some: {', '.join(sorted(having))}"
        lost = f"; collision shapes that could not be read: {', '.join(unread)}" if unread else ""
        raise ModelError(f"link {name!r} has no collision shape; {hint}{lost}")
    return set(links)


def _carrier(model: pin.Model, item: pin.GeometryObject) -> pin.Frame:
    """The frame that carries a shape: its link, or the joint of one that was made without a link."""
    index = item.parentFrame
    return model.frames[index if index < model.nframes else model.getFrameId(model.names[item.parentJoint])]


def _at(axis: int, distance: float) -> pin.SE3:
    translation = np.zeros(3)
    translation[axis] = distance
    return pin.SE3(np.eye(3), translation)


def _axes(normal: int, sign: float) -> np.ndarray:
    """Rotation whose z axis is +-e_normal and whose x axis is the next one in cyclic order."""
    rotation = np.zeros((3, 3))
    rotation[(normal + 1) % 3, 0] = 1.0
    rotation[(normal + 2) % 3, 1] = sign
    rotation[normal, 2] = sign
    return rotation


def _side(shape: Any) -> Part:
    domain = (None, (-shape.halfLength, shape.halfLength))
    return "cylinder", "faces", Cylinder(shape.radius, domain=domain), pin.SE3.Identity()


def _cylinder(shape: Any) -> Iterator[Part]:
    yield _side(shape)
    for sign, mark in _SIGNS:
        # the rim's axis points out of the body
        placement = _at(2, sign * shape.halfLength) * pin.SE3(_axes(2, sign), np.zeros(3))
        yield f"rim_{mark}z", "rims", Circle(shape.radius), placement


def _capsule(shape: Any) -> Iterator[Part]:
    yield _side(shape)
    for sign, mark in _SIGNS:
        yield f"cap_{mark}z", "faces", Sphere(shape.radius), _at(2, sign * shape.halfLength)


def _box(shape: Any) -> Iterator[Part]:
    half = np.asarray(shape.halfSide, dtype=float)
    for axis, (sign, mark) in product(range(3), _SIGNS):
        a, b = half[(axis + 1) % 3], half[(axis + 2) % 3]
        placement = _at(axis, sign * half[axis]) * pin.SE3(_axes(axis, sign), np.zeros(3))
        yield f"face_{mark}{_AXES[axis]}", "faces", Plane(domain=((-a, a), (-b, b))), placement
    for axis, (sign1, mark1), (sign2, mark2) in product(range(3), _SIGNS, _SIGNS):
        # along the axis, at the corners of the other two; the line's z axis is one of those
        first, second = (other for other in range(3) if other != axis)
        position = np.zeros(3)
        position[first], position[second] = sign1 * half[first], sign2 * half[second]
        name = f"edge_{mark1}{_AXES[first]}{mark2}{_AXES[second]}"
        rotation = _axes((axis + 2) % 3, 1.0)
        yield name, "edges", Line(domain=(-half[axis], half[axis])), pin.SE3(rotation, position)
    for signs in product(_SIGNS, repeat=3):
        name = "corner_" + "".join(f"{mark}{axis}" for (_, mark), axis in zip(signs, _AXES))
        corner = half * [sign for sign, _ in signs]
        yield name, "corners", Point(), pin.SE3(np.eye(3), corner)


def _halfspace(shape: Any) -> Iterator[Part]:
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), shape.n).matrix()
    yield "plane", "faces", Plane(), pin.SE3(turn, shape.d * shape.n)


_SHAPES: dict[str, Callable[[Any], Iterable[Part]]] = {
    "Sphere": lambda shape: [("sphere", "faces", Sphere(shape.radius), pin.SE3.Identity())],
    "Ellipsoid": lambda shape: [("ellipsoid", "faces", Ellipsoid(*shape.radii), pin.SE3.Identity())],
    "Cylinder": _cylinder,
    "Capsule": _capsule,
    "Box": _box,
    "Halfspace": _halfspace,
}
