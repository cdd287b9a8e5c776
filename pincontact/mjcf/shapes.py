"""What of an MJCF file is drawn, and what can be made into contours: its geoms as geometry models."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from .document import Document, Element
from .inertia import SIZES, Geom
from .model import Body

_COLOUR = (0.5, 0.5, 0.5, 1.0)
# Geoms of higher groups are for contacts alone, by a habit of those who write such files.
_LAST_DRAWN_GROUP = 2


def read_shapes(
    document: Document, bodies: list[Body]
) -> tuple[pin.GeometryModel, pin.GeometryModel, list[str], list[str]]:
    """Visual and collision shapes, named after their body and numbered, and those of each that could not be read.

    A geom that touches nothing (contype and conaffinity 0) is no collision shape; one of a group above 2 is not drawn;
    the world's planes are not drawn, and half-spaces to collide with.
    """
    reader = _Reader(document)
    models = pin.GeometryModel(), pin.GeometryModel()
    unread: tuple[list[str], list[str]] = [], []
    for body in bodies:
        numbers = [0, 0]
        for geom in body.geoms:
            element = geom.element
            collides = element.number("contype", 1.0) != 0.0 or element.number("conaffinity", 1.0) != 0.0
            drawn = (not collides or element.number("group") <= _LAST_DRAWN_GROUP) and geom.type != "plane"
            uses = [use for use, wanted in enumerate((drawn, collides)) if wanted]
            try:
                shape, path, scale = reader.shape(geom)
            except _Unread as reason:
                for use in uses:
                    unread[use].append(f"{element.what} ({reason})")
                continue
            for use in uses:
                models[use].addGeometryObject(
                    pin.GeometryObject(
                        f"{body.name}_{numbers[use]}",
                        body.joint,
                        body.frame,
                        body.placement * geom.placement,
                        shape,
                        path,
                        scale,
                        True,
                        reader.colour(element),
                    )
                )
                numbers[use] += 1
    return models[0], models[1], unread[0], unread[1]


class _Unread(Exception):
    """Why a shape cannot be read."""


class _Reader:
    def __init__(self, document: Document) -> None:
        import coal

        self._coal = coal
        self._loader = coal.CachedMeshLoader()
        self._document = document
        self._meshes: dict[str, Element] = {}
        self._materials: dict[str, Element] = {}
        for node in document.sections("asset"):
            if node.tag == "mesh":
                element = document.element(node)
                self._meshes[element.text("name") or Path(element.text("file")).stem] = element
            elif node.tag == "material":
                self._materials[node.get("name", "")] = document.element(node)

    def shape(self, geom: Geom) -> tuple[Any, str, np.ndarray]:
        """The shape, its mesh file or its kind in capitals, and its scale."""
        if geom.type == "mesh":
            return self._mesh(geom.element.text("mesh"))
        coal, size, one = self._coal, geom.size, np.ones(3)
        if geom.type == "plane":
            return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), "HALFSPACE", one
        if geom.type not in SIZES:
            raise _Unread(f"of type {geom.type}")
        if geom.fitted:
            raise _Unread("fitted to a mesh")
        make = {
            "sphere": lambda: coal.Sphere(size[0]),
            "capsule": lambda: coal.Capsule(size[0], 2.0 * size[1]),
            "cylinder": lambda: coal.Cylinder(size[0], 2.0 * size[1]),
            "ellipsoid": lambda: coal.Ellipsoid(*size),
            "box": lambda: coal.Box(*(2.0 * size)),
        }[geom.type]
        return make(), geom.type.upper(), one

    def _mesh(self, name: str) -> tuple[Any, str, np.ndarray]:
        if name not in self._meshes:
            raise _Unread(f"there is no mesh {name!r}")
        element = self._meshes[name]
        if not element.has("file"):
            raise _Unread(f"mesh {name!r} has no file")
        if element.has("refpos") or element.has("refquat"):
            raise _Unread(f"mesh {name!r} has a frame of its own")
        compiler = self._document.compiler
        given = Path(element.text("file"))
        if compiler.flag("strippath"):
            given = Path(given.name)
        folder = compiler.text("meshdir", compiler.text("assetdir"))
        path = Path(self._document.file).parent / folder / given
        if not path.is_file():
            raise _Unread(f"mesh file not found: {path}")
        scale = element.numbers("scale", 3, 3, (1.0, 1.0, 1.0))
        try:
            return self._loader.load(str(path), scale), str(path), scale
        except (ValueError, RuntimeError) as error:
            raise _Unread(f"mesh file cannot be read: {path}") from error

    def colour(self, element: Element) -> np.ndarray:
        """RGBA: the geom's own, else its material's."""
        material = self._materials.get(element.text("material"))
        owner = element if element.has("rgba") or material is None else material
        return owner.numbers("rgba", 4, 4, _COLOUR)
