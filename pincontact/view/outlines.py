"""How contours are drawn: as tubes, discs and checkered surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..contours.base import PLANE
from . import meshes
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


def tile_size(size: float) -> float:
    """Edge in m of a floor's fields for a scene of that size: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(size))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= size * (1.0 + 1e-12)))


def contour_meshes(
    contour: Any, near: np.ndarray, size: float, line: float, joint: int, filled: bool, t: float
) -> dict[str, Mesh]:
    """What to draw of a contour, in its own frame, by the name of the part.

    near: (n, 3) points in the contour's frame, which an unbounded contour is drawn around;
    size: the scene's, m; line: radius of what is drawn for a curve, m;
    filled: fill closed planar curves, for want of another picture of the body;
    t: time in s for contours that depend on it. Surfaces and discs are checkered so that their turning shows.
    """
    light, dark = shades(joint)
    centre = 0.5 * (near.min(axis=0) + near.max(axis=0))
    radius = float(np.linalg.norm(near - centre, axis=1).max()) + 2.5 * size
    if contour.dimension == 0:
        return {"point": meshes.sphere(2.5 * line)}
    domain = meshes.drawn_domain(contour, centre, radius, t)
    if contour.dimension == 1:
        closed = bool(contour.periodic[0])
        points = meshes.smooth_polyline(contour, domain, size, t)
        if closed:
            points = points[:-1]
        parts = {"curve": meshes.tube(points, line, closed)}
        if filled and closed and contour.planar:
            parts["disc"] = meshes.fan(points, light, dark)
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
