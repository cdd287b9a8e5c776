"""Triangle meshes and polylines as arrays, in metres: what the viewer draws, computed without it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..contours.base import F_1, F_2, Contour, F

_FULL_TURN = 2.0 * np.pi
# How far lines may be from what they stand for, as a part of the scene's size: less than a pixel.
SIMPLIFIED = 5e-4


@dataclass
class Mesh:
    """Triangles with one normal, and possibly one colour, per vertex.

    vertices, normals: (n, 3); faces: (m, 3) indices; colors: (n, 3) in [0, 1] or None.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    colors: np.ndarray | None = None


def lathe(profile: np.ndarray, sides: int = 24) -> Mesh:
    """The surface swept by a polyline of (radius, height) pairs turning about z.

    profile: (n, 2), the outside on the right-hand side when walking along it. Every segment keeps its own
    normals, so that edges stay sharp; smooth shapes come from many short segments.
    """
    angles = np.linspace(0.0, _FULL_TURN, sides + 1)
    c, s = np.cos(angles), np.sin(angles)
    vertices, normals, faces = [], [], []
    for count, (start, end) in enumerate(pairwise(profile)):
        along = end - start
        length = np.hypot(*along)
        outward = np.array([along[1], -along[0]]) / length if length > 0.0 else np.array([1.0, 0.0])
        for radius, height in (start, end):
            vertices.append(np.column_stack([radius * c, radius * s, np.full_like(c, height)]))
            normals.append(np.column_stack([outward[0] * c, outward[0] * s, np.full_like(c, outward[1])]))
        faces.append(_strip(sides) + 2 * count * (sides + 1))
    return Mesh(np.concatenate(vertices), np.concatenate(faces), np.concatenate(normals))


def _strip(cells: int) -> np.ndarray:
    """(2 cells, 3) triangles between two rows of cells + 1 vertices each."""
    low = np.arange(cells)
    high = low + cells + 1
    return np.concatenate([np.column_stack([low, low + 1, high]), np.column_stack([low + 1, high + 1, high])])


def sphere(radius: float, sides: int = 20) -> Mesh:
    """A ball about the origin; its normals are as smooth as it."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, sides // 2 + 1)
    mesh = lathe(np.column_stack([np.cos(angle), np.sin(angle)]), sides)
    return Mesh(radius * mesh.vertices, mesh.faces, mesh.vertices)


def tube(points: np.ndarray, radius: float, closed: bool, sides: int = 8) -> Mesh:
    """A tube around a polyline.

    points: (n, 3), n >= 2, consecutive ones distinct; closed: the last one joins the first.
    The cross-sections are carried along by parallel transport, and untwisted where the tube closes.
    """
    ahead = np.roll(points, -1, axis=0) - points
    tangents = ahead + np.roll(ahead, 1, axis=0)
    if not closed:
        tangents[0], tangents[-1] = ahead[0], ahead[-2]
    # Where the line turns back on itself the two chords cancel; the outgoing one will do.
    length = np.linalg.norm(tangents, axis=1, keepdims=True)
    tangents = np.where(length > 1e-9 * np.abs(points).max(), tangents, ahead)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)

    across = np.empty_like(points)
    across[0] = np.cross(tangents[0], np.eye(3)[np.argmin(np.abs(tangents[0]))])
    across[0] /= np.linalg.norm(across[0])
    for i in range(1, len(points)):
        carried = across[i - 1] - (across[i - 1] @ tangents[i]) * tangents[i]
        norm = np.linalg.norm(carried)
        across[i] = carried / norm if norm > 1e-6 else across[i - 1]
    twist = np.zeros(len(points))
    if closed:
        last = across[-1] - (across[-1] @ tangents[0]) * tangents[0]
        mismatch = np.arctan2(np.cross(across[0], last) @ tangents[0], across[0] @ last)
        twist = -mismatch * np.linspace(0.0, 1.0, len(points))
    third = np.cross(tangents, across)

    angles = np.linspace(0.0, _FULL_TURN, sides + 1)[None, :, None] + twist[:, None, None]
    normals = np.cos(angles) * across[:, None] + np.sin(angles) * third[:, None]
    if closed:
        points = np.concatenate([points, points[:1]])
        normals = np.concatenate([normals, normals[:1]])
    vertices = points[:, None] + radius * normals
    rows = len(points) - 1
    faces = np.concatenate([_strip(sides) + row * (sides + 1) for row in range(rows)])
    return Mesh(vertices.reshape(-1, 3), faces, normals.reshape(-1, 3))


def join(parts: list[Mesh]) -> Mesh:
    """Several meshes as one, their faces in the order given; all of them have colours, or none has."""
    colors = [part.colors for part in parts if part.colors is not None]
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets)]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate(colors) if colors else None,
    )


def simplify(points: np.ndarray, tolerance: float, longest: float) -> np.ndarray:
    """Which points of a polyline to keep: no dropped one is further than `tolerance` from the line.

    points: (n, 3), n >= 1; tolerance, longest: in m; no chord skips points to become longer than `longest`.
    Returns indices in increasing order, the first one included; points closer than half the tolerance to the
    last one kept are dropped, so that a resting point leaves only itself.
    """
    kept, start, count = [0], 0, len(points)
    while start < count - 1:
        # Doubling, then halving: the longest admissible chord in a logarithmic number of trials.
        good, step = start + 1, 1
        while start + 2 * step < count and _chord_holds(points, start, start + 2 * step, tolerance, longest):
            step *= 2
            good = start + step
        while step > 1:
            step //= 2
            if good + step < count and _chord_holds(points, start, good + step, tolerance, longest):
                good += step
        if np.linalg.norm(points[good] - points[kept[-1]]) > 0.5 * tolerance:
            kept.append(good)
        start = good
    return np.array(kept)


def _chord_holds(points: np.ndarray, start: int, end: int, tolerance: float, longest: float) -> bool:
    chord = points[end] - points[start]
    square = float(chord @ chord)
    if square > longest**2:
        return False
    offset = points[start + 1 : end] - points[start]
    along = np.clip(offset @ chord / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(offset))
    distance = offset - along[:, None] * chord
    return bool((np.einsum("ij,ij->i", distance, distance) <= tolerance**2).all())


def fan(points: np.ndarray, light: np.ndarray, dark: np.ndarray, sectors: int = 8) -> Mesh:
    """The star-shaped area inside a closed planar polyline, in sectors of two colours, so that spin shows.

    points: (n, 3), n >= 3; light, dark: RGB in [0, 1].
    """
    centre = points.mean(axis=0)
    following = np.roll(points, -1, axis=0)
    vertices = np.stack([np.broadcast_to(centre, points.shape), points, following], axis=1)
    area = np.cross(points - centre, following - centre).sum(axis=0)
    normal = area / max(np.linalg.norm(area), np.finfo(float).tiny)
    odd = (np.arange(len(points)) * sectors // len(points)) % 2
    colors = np.repeat(np.where(odd[:, None] == 1, dark, light), 3, axis=0)
    count = 3 * len(points)
    return Mesh(
        vertices.reshape(count, 3),
        np.arange(count).reshape(-1, 3),
        np.broadcast_to(normal, (count, 3)).copy(),
        colors,
    )


def checkered(
    points: np.ndarray, normals: np.ndarray, light: np.ndarray, dark: np.ndarray, fields: tuple[int, int]
) -> Mesh:
    """A grid of points as a checkered surface.

    points, normals: (n, m, 3); fields: how many grid cells make one field, in each direction.
    """
    rows, columns = points.shape[0] - 1, points.shape[1] - 1
    parts = []
    for i in range(0, rows, fields[0]):
        for j in range(0, columns, fields[1]):
            field = (slice(i, i + fields[0] + 1), slice(j, j + fields[1] + 1))
            part, normal = points[field], normals[field]
            high, wide = part.shape[0] - 1, part.shape[1] - 1
            # Two triangles a cell, counter-clockwise seen along -(d/du1 x d/du2).
            corner = (np.arange(high)[:, None] * (wide + 1) + np.arange(wide)).reshape(-1, 1)
            first = corner + np.array([0, wide + 1, wide + 2])
            second = corner + np.array([0, wide + 2, 1])
            color = dark if (i // fields[0] + j // fields[1]) % 2 else light
            part, normal = part.reshape(-1, 3), normal.reshape(-1, 3)
            parts.append(Mesh(part, np.concatenate([first, second]), normal, np.tile(color, (len(part), 1))))
    return join(parts)


def smooth_polyline(contour: Contour, domain: np.ndarray, size: float, t: float = 0.0) -> np.ndarray:
    """Points along a curve, as many as it takes to look smooth, both ends included, in the contour's frame.

    domain: (1, 2), low and high of the parameter; size: of the scene, m. Returns (n, 3).
    """
    count = 65
    while True:
        points = contour.polyline(count, domain, t)
        chords = np.diff(points, axis=0)
        length = np.linalg.norm(chords, axis=1)
        # sin of the turn between neighbours is their cross product over their lengths
        turn = np.linalg.norm(np.cross(chords[:-1], chords[1:]), axis=1)
        if count > 8000 or (turn <= 0.12 * length[:-1] * length[1:]).all():
            break
        count = 2 * count - 1
    kept = simplify(points, SIMPLIFIED * size, np.inf)
    # The end may have been dropped as too close to the last point kept.
    return points[np.append(kept[:-1], len(points) - 1)] if len(kept) > 2 else points[[0, -1]]


def sample_surface(
    contour: Contour, domain: np.ndarray, counts: tuple[int, int], t: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Points and unit normals of a surface over a grid of its first chart, in the contour's frame.

    domain: (2, 2), low and high of u1 and of u2; counts: grid points in each direction.
    Returns two (counts[0], counts[1], 3) arrays.
    """
    parameters = contour.samples(counts, domain)
    rows = contour.evaluate_many(parameters, t)
    normals = np.cross(rows[:, F_1], rows[:, F_2])
    length = np.linalg.norm(normals, axis=1)
    # At a pole of the chart the normal a little further inside is as good as the eye can tell.
    regular = length > 1e-9 * np.linalg.norm(rows[:, F_1], axis=1).max() * np.linalg.norm(rows[:, F_2], axis=1)
    for i in np.flatnonzero(~regular):
        inside = parameters[i] + 1e-4 * (domain.mean(axis=1) - parameters[i])
        row = contour.evaluate(inside, t)
        normals[i] = np.cross(row[F_1], row[F_2])
        length[i] = np.linalg.norm(normals[i])
    normals /= np.maximum(length, np.finfo(float).tiny)[:, None]
    return rows[:, F].reshape(*counts, 3), normals.reshape(*counts, 3)


def drawn_domain(contour: Contour, centre: np.ndarray, radius: float, t: float = 0.0) -> np.ndarray:
    """The part of a contour's parameter domain to draw: all of it where bounded, else what is near.

    centre: (3,) in the contour's frame; radius: in m. An unbounded parameter is cut to the values at which the
    contour comes within `radius` of `centre`, the other parameter being anywhere in its own domain.
    Returns (dimension, 2), low and high of each parameter.
    """
    domain = np.array(contour.domain, dtype=float).reshape(contour.dimension, 2)
    unbounded = [a for a in range(contour.dimension) if not np.isfinite(domain[a]).all()]
    if not unbounded:
        return domain

    def window(bounds: np.ndarray, reach: float) -> np.ndarray:
        low = np.where(np.isfinite(bounds[:, 0]), bounds[:, 0], np.minimum(-reach, bounds[:, 1] - reach))
        high = np.where(np.isfinite(bounds[:, 1]), bounds[:, 1], np.maximum(reach, bounds[:, 0] + reach))
        return np.column_stack([low, high])

    # Parameters may be metres or radians, and the motion far from their origin: the window doubles until its
    # outer half holds nothing near.
    best = window(domain, 1.0)
    for power in range(-3, 28):
        trial = window(domain, 2.0**power * radius)
        near = _near(contour, trial, centre, radius, t)
        if near is not None:
            best = near
            inner = window(domain, 2.0 ** (power - 1) * radius)
            if all(near[a, 0] >= inner[a, 0] and near[a, 1] <= inner[a, 1] for a in unbounded):
                break
    for _ in range(8):
        closer = _near(contour, np.where(np.isfinite(domain), domain, best), centre, radius, t)
        if closer is None:
            break
        best = closer
    return np.where(np.isfinite(domain), domain, best)


def _near(contour: Contour, window: np.ndarray, centre: np.ndarray, radius: float, t: float) -> np.ndarray | None:
    """A box of parameters that holds all of a window that comes within radius of centre, or None if nothing does."""
    count = 65 if contour.dimension == 1 else 33
    axes = [np.linspace(low, high, count) for low, high in window]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    points = contour.evaluate_many(grid.reshape(-1, contour.dimension), t)[:, F].reshape(*grid.shape[:-1], 3)
    # What lies between two samples is at most about half their distance away from the nearer one.
    gaps = [np.linalg.norm(np.diff(points, axis=a), axis=-1).max() for a in range(contour.dimension)]
    near = np.linalg.norm(points - centre, axis=-1) <= radius + 0.5 * float(np.linalg.norm(gaps))
    if not near.any():
        return None
    step = (window[:, 1] - window[:, 0]) / (count - 1)
    low = np.maximum(grid[near].min(axis=0) - 0.5 * step, window[:, 0])
    high = np.minimum(grid[near].max(axis=0) + 0.5 * step, window[:, 1])
    return np.column_stack([low, high])
