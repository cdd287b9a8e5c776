"""Where the shaft and the head of an arrow go, for many vectors at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..contours.motion import connected
from .meshes import Mesh, lathe

# Proportions of an arrow that is long enough for its full head.
HEAD_LENGTH, HEAD_RADIUS, SHAFT_RADIUS = 1.0, 0.34, 0.13


def unit_shaft() -> Mesh:
    """A cylinder of radius 1 about z from z = 0 to 1."""
    return lathe(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), 20)


def unit_head() -> Mesh:
    """A cone of radius 1 about z, its base at z = 0, its tip at z = 1."""
    return lathe(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), 28)


def rotation_from_z(directions: np.ndarray) -> np.ndarray:
    """The shortest turns that take the z axis to the given unit vectors.

    directions: (n, 3). Returns (n, 4) quaternions (x, y, z, w) of unit length; -z is reached by half a turn
    about x. Consecutive quaternions lie on the same half of the sphere.
    """
    x, y, z = directions.T
    # q is parallel to (cross(e_z, d), 1 + e_z.d); near -z the cosine cancels and the sine carries the digits.
    sine_squared = x * x + y * y
    w = np.where(z >= 0.0, 1.0 + z, sine_squared / np.maximum(1.0 - z, 1.0))
    quaternion = np.column_stack([-y, x, np.zeros_like(x), w])
    norm = np.linalg.norm(quaternion, axis=1)
    opposite = norm < 1e-150
    quaternion[opposite] = (1.0, 0.0, 0.0, 0.0)
    norm[opposite] = 1.0
    return connected(quaternion / norm[:, None])


@dataclass
class Arrow:
    """Placements of an arrow over n times. The unit shaft and head are scaled in the arrow's frame, z along it.

    tail: (n, 3) world; quaternion: (n, 4) (x, y, z, w); shaft_scale, head_scale: (n, 3);
    head_position: (n, 3) in the arrow's frame; visible: (n,) bool, False where the vector vanishes.
    """

    tail: np.ndarray
    quaternion: np.ndarray
    shaft_scale: np.ndarray
    head_position: np.ndarray
    head_scale: np.ndarray
    visible: np.ndarray


def place_arrow(tail: np.ndarray, vector: np.ndarray, head: float) -> Arrow:
    """An arrow from each tail along each vector, as long as the vector.

    tail, vector: (n, 3) in m; head: length in m of the head of a long arrow. An arrow shorter than twice its
    head shrinks as a whole, so that its tip is always at tail + vector.
    """
    length = np.linalg.norm(vector, axis=1)
    visible = length > 1e-3 * head
    direction = np.zeros_like(vector)
    direction[:, 2] = 1.0
    np.divide(vector, length[:, None], out=direction, where=visible[:, None])
    # Hold the last direction through times when there is none, so that nothing whirls while hidden.
    last = np.maximum.accumulate(np.where(visible, np.arange(len(length)), -1))
    direction = np.where(last[:, None] >= 0, direction[np.maximum(last, 0)], direction)

    shrink = np.minimum(1.0, length / (2.0 * HEAD_LENGTH * head))
    # Zero scales make singular matrices; what is this small is hidden anyway.
    size = np.maximum(shrink, 1e-4) * head
    head_length = HEAD_LENGTH * size
    shaft = np.maximum(length - head_length, 1e-4 * head)
    zero = np.zeros_like(length)
    return Arrow(
        tail=tail,
        quaternion=rotation_from_z(direction),
        shaft_scale=np.column_stack([SHAFT_RADIUS * size, SHAFT_RADIUS * size, shaft]),
        head_position=np.column_stack([zero, zero, np.maximum(length - head_length, 0.0)]),
        head_scale=np.column_stack([HEAD_RADIUS * size, HEAD_RADIUS * size, head_length]),
        visible=visible,
    )
