"""Elliptic friction cones for the solver of round ones: stretches of contacts (see `friction.ellipse`) as matrices."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..layout import ANISOTROPIC, SCALING_11, SCALING_12, SCALING_22

if TYPE_CHECKING:
    from .system import System


def stretch(system: System, c: int) -> np.ndarray:
    """(2, 2) the stretch A of contact c in its basis (t1, second), as of the last evaluation."""
    if not system.contact_int[c, ANISOTROPIC]:
        return np.eye(2)
    a, b, d = system.contact_real[c, [SCALING_11, SCALING_12, SCALING_22]]
    return np.array([[a, b], [b, d]])


def associated(system: System, c: int, direction: np.ndarray) -> np.ndarray:
    """(2,) `friction_direction` of a unit direction of slip (2,), which stays as it is."""
    out = direction.copy()
    if system.contact_int[c, ANISOTROPIC]:
        scaling = stretch(system, c)
        stretched = scaling @ direction
        out = scaling @ stretched / np.linalg.norm(stretched)
    return out


def opposed_slip(system: System, c: int, force: np.ndarray) -> np.ndarray:
    """(2,) a slip direction that friction at its limit opposes with a force (2,), along (t1, second)."""
    if not system.contact_int[c, ANISOTROPIC]:
        return -force
    inverse = np.linalg.inv(stretch(system, c))
    return -inverse @ inverse @ force
