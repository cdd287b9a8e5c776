"""Whether two contours can touch at one place only, wherever their bodies go.

A convex body has a largest radius of curvature. Where a ball of that radius rolls freely over another contour, and is
inside it nowhere, the body touches it at one place, too, whatever its orientation (Blaschke's rolling theorem). Over a
plane, and on the outside of a convex body, balls of any radius do; inside a convex body, over graphs and on tori those
that are smaller than every radius of curvature.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import scipy

from ..contours import Contour, HeightField, Line, Plane, Torus, tape
from ..contours.bends import bends_less
from ..contours.piecewise import breaks_of, chebyshev_nodes, fitted
from ..contours.splines import height_spline
from ..layout import PATTERN
from ..workspace import Workspace
from .carriers import ORIGIN
from .patterns import PLANAR

# Samples of a curve and of a surface; how far in m from the origin those of an unbounded one are.
_CURVE, _SURFACE, _WINDOW = 2000, 4000, 10.0
# Of each piece of a piecewise polynomial, along each parameter, at least; and pieces that are looked at, at most.
_OF_PIECE, _PIECES = 4, 4096
# Multiples of these, less whole numbers, fill a length and a square evenly (the inverse of the golden ratio, and of the
# plastic number and its square).
_GOLDEN, _PLASTIC = np.array([0.6180339887498949]), np.array([0.7548776662466927, 0.5698402909980532])
# Balls are taken for larger by this part: what is between samples shows by its square.
_LARGER = 1.05
_ROUND_OFF = 1e-9
# Samples that show narrow places are no farther apart than this part of the radius.
_FINE = 0.25


def touches_once(system: Workspace, c: int) -> bool:
    """Whether the contours of contact c, as it is evaluated, can touch at no other point at the same time; not where
    that is not known."""
    contours = system.contacts[c].body1.contour, system.contacts[c].body2.contour
    if any(contour.dimension == 0 for contour in contours):
        return True
    if any(contour.time_dependent for contour in contours):
        return False
    return any(_touches_once(system, c, side) for side in (0, 1))


def _touches_once(system: Workspace, c: int, side: int) -> bool:
    """The same, where the contour on this side is that of the convex body."""
    own = (system.contacts[c].body1, system.contacts[c].body2)[side].contour
    other = (system.contacts[c].body1, system.contacts[c].body2)[1 - side].contour
    in_plane = bool(system.contact_int[c, PATTERN] == PLANAR)
    flat = (in_plane or other.dimension == 2) and _is_flat(other)
    if flat and isinstance(own, Torus):
        # except where it lies flat, along a whole circle
        return True
    if own.convex_side == 0 or not np.isfinite(own.domain).all():
        return False
    if flat or not (in_plane or (own.dimension == other.dimension == 2)):
        return flat
    towards = _side_of(system, c, side)
    radius = _largest_radius(own, in_plane)
    return towards == other.convex_side or (math.isfinite(radius) and _rolls_freely(other, towards, radius, in_plane))


def _is_flat(contour: Contour) -> bool:
    """Whether it is a plane or a line, or a formula that does nothing but multiply by numbers and add."""
    if contour.evaluator is not tape.traced:
        return isinstance(contour, (Plane, Line))
    end = tape.INSTRUCTIONS + tape.INSTRUCTION_SIZE * int(contour.pool[tape.COUNT])
    operations = contour.pool[tape.INSTRUCTIONS : end : tape.INSTRUCTION_SIZE]
    return bool(np.isin(operations, (tape.LINEAR, tape.AFFINE)).all())


def _side_of(system: Workspace, c: int, side: int) -> int:
    """On which side of the other contour's normal the body on this side of contact c is, +1 or -1."""
    one, two = 2 * c + side, 2 * c + 1 - side
    frames, derivatives = system.frames, system.derivatives
    own = (system.contacts[c].body1, system.contacts[c].body2)[side].contour
    middle = frames[one, :3] @ middle_of(own) + frames[one, ORIGIN]
    across = derivatives[two, 2] if system.contact_int[c, PATTERN] != PLANAR else frames[two, :3, 2]
    normal = np.cross(derivatives[two, 1], across)
    return 1 if normal @ (middle - frames[two, ORIGIN] - derivatives[two, 0]) > 0.0 else -1


@functools.lru_cache(maxsize=64)
def _samples(contour: Contour) -> np.ndarray:
    """f and its derivatives (n, 10, 3) all over a contour: in each of its pieces, or at places that no period of its
    shape repeats."""
    if contour.dimension == 0:
        return np.zeros((1, 10, 3))
    count, steps = (_CURVE, _GOLDEN) if contour.dimension == 1 else (_SURFACE, _PLASTIC)
    if _is_piecewise(contour):
        of_piece = max(_OF_PIECE, math.ceil((count / _pieces(contour)) ** (1.0 / contour.dimension)))
        within = 0.5 + 0.5 * chebyshev_nodes(of_piece - 1)
        lines = [(breaks[:-1, None] + np.diff(breaks)[:, None] * within).ravel() for breaks in breaks_of(contour.pool)]
        return contour.evaluate_many(np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(lines)))
    low, high = np.array([(max(low, -_WINDOW), min(high, _WINDOW)) for low, high in contour.domain]).T
    parts = np.mod((np.arange(count)[:, None] + 0.5) * steps, 1.0)
    return contour.evaluate_many(low + (high - low) * parts)


def middle_of(contour: Contour) -> np.ndarray:
    """(3,) a point in m of a bounded contour's convex hull, which is inside of a convex one, in its frame."""
    return np.asarray(_samples(contour)[:, 0].mean(axis=0))


def reach_of(contour: Contour) -> float:
    """How far in m a bounded contour goes from its middle, as samples tell."""
    return float(np.linalg.norm(_samples(contour)[:, 0] - middle_of(contour), axis=1).max())


def _is_piecewise(contour: Contour) -> bool:
    return contour.evaluator in (fitted, height_spline)


def _pieces(contour: Contour) -> int:
    return math.prod(len(breaks) - 1 for breaks in breaks_of(contour.pool))


def _is_resolved(contour: Contour) -> bool:
    """Whether samples show all that it has."""
    if not _is_piecewise(contour):
        return contour.evaluator is not tape.traced
    return _pieces(contour) <= _PIECES


def _normals(values: np.ndarray, in_plane: bool) -> np.ndarray:
    """Unit normals (n, 3) at samples (n, 10, 3)."""
    normals = np.cross(values[:, 1], np.array([0.0, 0.0, 1.0]) if in_plane else values[:, 2])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


@functools.lru_cache(maxsize=64)
def _curvatures(contour: Contour, in_plane: bool) -> np.ndarray:
    """Principal curvatures (n, k) in 1/m, in order, at the samples, positive where it bends towards its normal."""
    values = _samples(contour)
    bent = np.einsum("nai,ni->na", values[:, 3:6], _normals(values, in_plane))
    if in_plane:
        return bent[:, :1] / np.einsum("ni,ni->n", values[:, 1], values[:, 1])[:, None]
    tangents = values[:, 1:3]
    shapes = np.linalg.solve(tangents @ np.swapaxes(tangents, 1, 2), bent[:, [[0, 1], [1, 2]]])
    middle = 0.5 * np.trace(shapes, axis1=1, axis2=2)
    half = np.sqrt(np.maximum(middle * middle - np.linalg.det(shapes), 0.0))
    return np.stack([middle - half, middle + half], axis=1)


def _largest_radius(contour: Contour, in_plane: bool) -> float:
    """The largest radius of curvature in m of a convex contour; infinite where it is straight."""
    least = float(np.abs(_curvatures(contour, in_plane)).min())
    return 1.0 / least if least > 0.0 else math.inf


def inner_radius(system: Workspace, c: int) -> float:
    """Radius in m of the largest ball that is known to roll freely inside one of the bodies of contact c, in the plane
    of planar curves: no step of less than its diameter goes through both bodies, and one of length s that begins and
    ends where they are apart has had them no deeper than s^2 / 8 over the radius inside each other."""
    in_plane = bool(system.contact_int[c, PATTERN] == PLANAR)
    contours = system.contacts[c].body1.contour, system.contacts[c].body2.contour
    bodies = (one for one in contours if one.dimension == (1 if in_plane else 2) and np.isfinite(one.domain).all())
    convex = [one for one in bodies if one.convex_side != 0 and not one.time_dependent]
    return max((1.0 / float(np.abs(_curvatures(one, in_plane)).max()) for one in convex), default=0.0)


@functools.lru_cache(maxsize=64)
def _rolls_freely(contour: Contour, side: int, radius: float, in_plane: bool) -> bool:
    """Whether a ball of this radius in m that touches a contour anywhere, on this side, is inside it nowhere."""
    radius *= _LARGER
    if _is_resolved(contour):
        is_larger = radius * float((side * _curvatures(contour, in_plane)).max()) >= 1.0
    else:
        is_larger = not bends_less(contour, side, 1.0 / radius)
    if is_larger or contour.convex_side != 0 or isinstance(contour, (HeightField, Torus)):
        return not is_larger
    # a narrow place, where parts face each other
    if contour.evaluator is tape.traced and not np.isfinite(contour.domain).all():
        return False
    values = _samples(contour)
    centres = values[:, 0] + side * radius * _normals(values, in_plane)
    tree = scipy.spatial.cKDTree(values[:, 0])
    spacing = tree.query(values[:, 0], k=2)[0][:, 1].max()
    return bool(spacing < _FINE * radius and tree.query(centres)[0].min() > (1.0 - _ROUND_OFF) * radius)
