"""The robot itself, drawn by Pinocchio's own visualiser, and what else is known of its visual geometry."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterable
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from .drawing import Drawing

# m: shapes that reach further are taken as unbounded.
_UNBOUNDED = 1e6
# Rotations that take the axes of a Collada file to those of Z_UP. MeshLab writes Y_UP whatever the axes are.
_UPRIGHT = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
_IGNORES_AXES = "MeshLab"


class _Recorder:
    """Stands for a meshcat window: keeps what is sent."""

    def __init__(self) -> None:
        self.commands: list[dict[str, Any]] = []

    def send(self, command: Any) -> None:
        self.commands.append(command.lower())


def draw_robot(
    drawing: Drawing, model: pin.Model, visual: pin.GeometryModel, path: Callable[[pin.GeometryObject], str]
) -> None:
    """Draw a robot's visual geometry as Pinocchio's `MeshcatVisualizer` does, each object in its joint's frame.

    path: meshcat's path of each object. Pinocchio warns of what it cannot draw.
    """
    import meshcat
    from pinocchio.visualize import MeshcatVisualizer
    from pinocchio.visualize.meshcat_visualizer import loadMesh

    class Visualizer(MeshcatVisualizer):  # type: ignore[misc]
        def getViewerNodeName(self, geometry_object: pin.GeometryObject, geometry_type: pin.GeometryType) -> str:
            return path(geometry_object)

        def loadMeshFromFile(self, geometry_object: pin.GeometryObject) -> Any:
            if geometry_object.name in plain:
                mesh = loadMesh(geometry_object.geometry)
                # Pinocchio has scaled them; the visualiser scales all that comes from files, in its placements.
                mesh.vertices = mesh.vertices / geometry_object.meshScale
                return mesh
            return super().loadMeshFromFile(geometry_object)

    # meshcat's viewer merges the parts of a Collada file, and fails or misplaces them where it cannot: these are drawn
    # from the triangles that Pinocchio has loaded.
    visual = visual.copy()
    files = {item.meshPath for item in visual.geometryObjects if _is_collada(item)}
    read = {file: _read_collada(file) for file in files}
    plain = set()
    for item in filter(_is_collada, visual.geometryObjects):
        merges, upright = read[item.meshPath]
        # Pinocchio leaves out which axis is up.
        item.placement = item.placement * pin.SE3(upright, np.zeros(3))
        if not merges:
            plain.add(item.name)
    recorder = _Recorder()
    visualizer = Visualizer(model, None, visual)
    visualizer.initViewer(meshcat.Visualizer.view_into(recorder, meshcat.path.Path()))
    for geometry in visual.geometryObjects:
        color = geometry_color(geometry) if geometry.name in plain else None
        visualizer.loadViewerGeometryObject(geometry, pin.GeometryType.VISUAL, color)
    # With every joint at the origin, placements are those in the joints' frames.
    for joint in range(model.njoints):
        visualizer.data.oMi[joint] = pin.SE3.Identity()
    visualizer.updatePlacements(pin.GeometryType.VISUAL)
    for command in recorder.commands:
        if command["type"] == "set_object":
            # What stands beside the object is nothing to the viewer.
            command.pop("materials", None)
            for item in command["object"]["geometries"]:
                # an older name, of which the viewer complains
                if item["type"] == "_meshfile":
                    item["type"] = "_meshfile_geometry"
            _rename(command["object"])
    drawing.commands += recorder.commands


def _read_collada(path: str) -> tuple[bool, np.ndarray]:
    """Whether meshcat's viewer makes one mesh of a Collada file: all its parts have the same kinds of data at their
    vertices, and none hangs below another. And the rotation, (3, 3), that makes it upright."""
    kinds, inside, nested = set(), 0, False
    up, tool = "", ""
    for event, element in ElementTree.iterparse(path, events=("start", "end")):
        tag = element.tag.rsplit("}", 1)[-1]
        if tag == "node":
            inside += 1 if event == "start" else -1
            nested = nested or inside > 1
        elif event == "end" and tag in ("triangles", "polylist", "polygons"):
            kinds.add(frozenset((i.get("semantic"), i.get("set")) for i in element if i.tag.endswith("input")))
        elif event == "end" and tag == "up_axis":
            up = (element.text or "").strip()
        elif event == "end" and tag == "authoring_tool":
            tool = element.text or ""
    return len(kinds) <= 1 and not nested, _UPRIGHT.get("" if _IGNORES_AXES in tool else up, np.eye(3))


def _is_collada(geometry: pin.GeometryObject) -> bool:
    return bool(geometry.meshPath.lower().endswith(".dae"))


def geometry_color(geometry: pin.GeometryObject) -> list[float]:
    """RGBA of a geometry that has one colour: that of the URDF, or its Collada file's first."""
    # Black is what files say that leave colour to the mesh; it would show no shading.
    if _is_collada(geometry) and not (geometry.overrideMaterial and geometry.meshColor[:3].any()):
        return _plain_color(geometry.meshPath)
    return [float(x) for x in geometry.meshColor]


def _plain_color(path: str) -> list[float]:
    """RGBA of the first material of a Collada file that has a colour; light grey without one."""
    for _, element in ElementTree.iterparse(path):
        if element.tag.endswith("diffuse"):
            for color in element:
                if color.tag.endswith("color") and color.text:
                    return [*(float(x) for x in color.text.split()[:3]), 1.0]
    return [0.8, 0.8, 0.8, 1.0]


def _rename(description: dict[str, Any]) -> None:
    """Identifiers by position instead of random ones: equal objects are then equal bytes, and pages reproducible."""
    parts = [*description["geometries"], *description["materials"], *description.get("textures", [])]
    parts += [*description.get("images", []), description["object"]]
    names = {part["uuid"]: str(uuid.UUID(int=number)) for number, part in enumerate(parts)}
    for part in parts:
        for key, value in part.items():
            if isinstance(value, str) and value in names:
                part[key] = names[value]


def geometry_reach(geometry: pin.GeometryObject) -> float:
    """About the radius in m of the geometry about its joint; 0 for unbounded or empty shapes."""
    shape = geometry.geometry
    shape.computeLocalAABB()
    low, high = np.asarray(shape.aabb_local.min_), np.asarray(shape.aabb_local.max_)
    if not (np.abs([low, high]) < _UNBOUNDED).all():
        return 0.0
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    return float(np.linalg.norm(geometry.placement.act(centre)) + half.max())


def shown_by(geometries: Iterable[pin.GeometryObject], points: np.ndarray, tolerance: float) -> bool:
    """Whether all points, (n, 3) in the joint's frame, lie on the surfaces of these geometries, to a tolerance in m."""
    import coal

    tip, request, result = coal.Sphere(0.0), coal.DistanceRequest(), coal.DistanceResult()
    left = list(points)
    for geometry in geometries:
        placement = coal.Transform3s(geometry.placement.rotation, geometry.placement.translation)
        far = []
        for point in left:
            result.clear()
            at = coal.Transform3s(np.eye(3), point)
            if not abs(coal.distance(geometry.geometry, placement, tip, at, request, result)) <= tolerance:
                far.append(point)
        left = far
    return not left
