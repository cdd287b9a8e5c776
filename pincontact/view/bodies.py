"""What is drawn of the bodies: the robot's visual geometry, and the contours as tubes, discs and surfaces."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np
import pinocchio as pin

from ..contours.base import PLANE
from . import meshes
from .drawing import Drawing
from .meshes import Mesh

# Light and dark shade of each body in turn; the world's are grey.
_WORLD = (np.array([0.80, 0.82, 0.84]), np.array([0.70, 0.72, 0.75]))
_SHADES = (
    (np.array([0.98, 0.80, 0.42]), np.array([0.86, 0.55, 0.18])),
    (np.array([0.56, 0.76, 0.93]), np.array([0.24, 0.49, 0.76])),
    (np.array([0.72, 0.88, 0.60]), np.array([0.40, 0.65, 0.30])),
    (np.array([0.85, 0.70, 0.90]), np.array([0.58, 0.38, 0.68])),
)


def shades(joint: int) -> tuple[np.ndarray, np.ndarray]:
    """The light and the dark colour of a joint's body, RGB in [0, 1]."""
    return _WORLD if joint == 0 else _SHADES[(joint - 1) % len(_SHADES)]


def geometry_mesh(geometry: pin.GeometryObject) -> Mesh | None:
    """The triangles of a geometry object in its own frame, scaled; None for a shape that has none here."""
    import coal

    shape = geometry.geometry
    if isinstance(shape, coal.Box):
        return meshes.box(2.0 * np.asarray(shape.halfSide))
    if isinstance(shape, coal.Sphere):
        return meshes.ellipsoid(np.full(3, shape.radius))
    if isinstance(shape, coal.Ellipsoid):
        return meshes.ellipsoid(np.asarray(shape.radii))
    if isinstance(shape, coal.Cylinder):
        return meshes.cylinder(shape.radius, 2.0 * shape.halfLength)
    if isinstance(shape, coal.Capsule):
        return meshes.capsule(shape.radius, 2.0 * shape.halfLength)
    if isinstance(shape, coal.Cone):
        return meshes.cone(shape.radius, 2.0 * shape.halfLength)
    if isinstance(shape, coal.BVHModelBase):
        triangles = [_corners(shape.tri_indices(i)) for i in range(shape.num_tris)]
        return meshes.soup(np.asarray(shape.vertices()), np.array(triangles))
    if isinstance(shape, coal.Convex):
        polygons = [_corners(shape.polygons(i)) for i in range(shape.num_polygons)]
        return meshes.soup(np.asarray(shape.points()), np.array(polygons))
    return None


def _corners(triangle: Any) -> tuple[int, int, int]:
    # Iterating over one of coal's ends in an IndexError, which now and then comes out as a SystemError instead.
    return triangle[0], triangle[1], triangle[2]


def draw_geometry(drawing: Drawing, path: str, geometry: pin.GeometryObject) -> None:
    """Draw one object of a geometry model below its joint's node.

    A Collada file with materials of its own is passed on whole; everything else is drawn from the triangles that
    Pinocchio has loaded, in the colour of the robot's description. What cannot be drawn is named in a warning.
    """
    placement = geometry.placement.homogeneous
    if geometry.meshPath.lower().endswith(".dae") and not geometry.overrideMaterial:
        from pinocchio.visualize.meshcat_visualizer import DaeMeshGeometry

        # A node's path is all that the command lacks.
        command = DaeMeshGeometry(geometry.meshPath).lower()
        drawing.add("set_object", path, object=command["object"])
        scale = np.append(np.asarray(geometry.meshScale, dtype=float).reshape(3), 1.0)
        drawing.transform(path, placement @ np.diag(scale))
        return
    mesh = geometry_mesh(geometry)
    if mesh is None:
        kind = type(geometry.geometry).__name__
        warnings.warn(f"geometry {geometry.name!r} ({kind}) is not drawn.", UserWarning, stacklevel=2)
        return
    drawing.mesh(path, mesh, tuple(np.asarray(geometry.meshColor, dtype=float)))
    drawing.transform(path, placement)


def geometry_reach(geometry: pin.GeometryObject) -> float:
    """Radius in m of the geometry about its joint; 0 for unbounded or unknown shapes."""
    import coal

    shape = geometry.geometry
    if isinstance(shape, coal.BVHModelBase):
        vertices = np.asarray(shape.vertices())
    else:
        mesh = geometry_mesh(geometry)
        vertices = np.zeros((0, 3)) if mesh is None else mesh.vertices
    if len(vertices) == 0:
        return 0.0
    placed = vertices @ geometry.placement.rotation.T + geometry.placement.translation
    return float(np.linalg.norm(placed, axis=1).max())


def shown_by(geometries: Iterable[pin.GeometryObject], points: np.ndarray, tolerance: float) -> bool:
    """Whether all points, (n, 3) in the joint's frame, lie on the surfaces of these geometries, to a tolerance in m."""
    left = points
    for geometry in geometries:
        mesh = geometry_mesh(geometry)
        if mesh is None or len(left) == 0:
            continue
        local = (left - geometry.placement.translation) @ geometry.placement.rotation
        left = left[meshes.distance(mesh, local) > tolerance]
    return len(left) == 0


def tile_size(size: float) -> float:
    """Edge in m of a floor's fields for a scene of that size: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(size))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= size * (1.0 + 1e-12)))


def contour_meshes(contour: Any, near: np.ndarray, size: float, joint: int, filled: bool, t: float) -> dict[str, Mesh]:
    """What to draw of a contour, in its own frame, by the name of the part.

    near: (n, 3) points in the contour's frame, which an unbounded contour is drawn around;
    size: the scene's, m; filled: fill closed planar curves, for want of another picture of the body;
    t: time in s for contours that depend on it. Surfaces and discs are checkered so that their turning shows.
    """
    light, dark = shades(joint)
    centre = 0.5 * (near.min(axis=0) + near.max(axis=0))
    radius = float(np.linalg.norm(near - centre, axis=1).max()) + 2.5 * size
    if contour.dimension == 0:
        return {"point": meshes.ellipsoid(np.full(3, 0.03 * size), 20)}
    domain = meshes.drawn_domain(contour, centre, radius, t)
    if contour.dimension == 1:
        closed = bool(contour.periodic[0])
        line = meshes.smooth_polyline(contour, domain, size, t)
        if closed:
            line = line[:-1]
        parts = {"curve": meshes.tube(line, 0.012 * size, closed)}
        if filled and closed and contour.planar:
            parts["disc"] = meshes.fan(line, light, dark)
        return parts
    if contour.kind == PLANE:
        edge = tile_size(0.7 * size)
        # Not more fields than the eye can use or a page should carry.
        while radius / edge > 30.0:
            edge *= 2.0
        low, high = np.floor(domain[:, 0] / edge), np.ceil(domain[:, 1] / edge)
        counts = (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)
        points, normals = meshes.sample_surface(contour, np.column_stack([low, high]) * edge, counts, t)
        odd = int(low[0] + low[1]) % 2
        mesh = meshes.checkered(points, normals, *((dark, light) if odd else (light, dark)), (1, 1))
    else:
        # One that changes is drawn many times over.
        cells = 3 if contour.time_dependent else 6
        points, normals = meshes.sample_surface(contour, domain, (8 * cells + 1, 6 * cells + 1), t)
        mesh = meshes.checkered(points, normals, light, dark, (cells, cells))
    return {"surface": mesh}


def contour_opacity(contour: Any, joint: int) -> float:
    """Surfaces of the world that may enclose what moves are drawn so that one sees through."""
    return 0.35 if joint == 0 and contour.dimension == 2 and any(contour.periodic) else 1.0
