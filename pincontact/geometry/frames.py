"""The paper's contact frame (Definition 5), which may be oblique, and its dual basis (Eq. 26)."""

from __future__ import annotations

import numpy as np

from .patterns import CROSSING_CURVES, ON_CURVE, ON_SURFACE

# A curve whose tangent has a larger z component than this counts as steep.
STEEP = 0.9


def contact_frame(
    pattern: int, first: np.ndarray, second: np.ndarray, plane_normal: np.ndarray, basis: np.ndarray
) -> np.ndarray:
    """Unit vectors e_1, e_2, e_3 as columns (..., 3, 3), world axes; of one contact, or of many instants of it.

    pattern: code of `patterns`. first, second (..., 3 or more, 3): derivatives of both contours, world axes, their
    points in row 0. plane_normal (..., 3): k of planar patterns. basis (..., 3, 3): rows t1, second, n; its two normals
    are taken for a point on a spatial curve.
    """
    e1 = _unit(second[..., 1, :])
    if pattern == ON_CURVE:
        return np.stack([e1, basis[..., 1, :], basis[..., 2, :]], axis=-1)
    if pattern == ON_SURFACE:
        e2 = _unit(second[..., 2, :])
    elif pattern == CROSSING_CURVES:
        e2 = _unit(first[..., 1, :])
    else:
        e2 = plane_normal
    return np.stack([e1, e2, _unit(np.cross(e1, e2))], axis=-1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]


def dual_basis(frame: np.ndarray) -> np.ndarray:
    """Basis dual to a contact frame: dual[..., :, i] . frame[..., :, j] = delta_ij (Eq. 26).

    frame (..., 3, 3): vectors as columns; may be oblique, not degenerate. Returns the same layout.
    """
    return np.swapaxes(np.linalg.inv(frame), -1, -2)


def curve_normal_axis(tangent: np.ndarray) -> np.ndarray:
    """The world axis from which the normals of a spatial curve are made: z, or x where the curve climbs steeply."""
    return np.array([0.0, 0.0, 1.0]) if abs(tangent[2]) < STEEP else np.array([1.0, 0.0, 0.0])
