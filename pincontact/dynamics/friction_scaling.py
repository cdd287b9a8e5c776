"""Elliptic friction cones for the solver of round ones: scalings of contacts (see `friction.ellipse`) as matrices."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..friction.ellipse import friction_direction
from ..layout import ANISOTROPIC, SCALING_11, SCALING_12, SCALING_22

if TYPE_CHECKING:
    from .system import System


def friction_scaling(system: System, c: int) -> np.ndarray:
    """(2, 2) the scaling A of contact c in its basis (t1, second), as of the last evaluation."""
    if not system.contact_int[c, ANISOTROPIC]:
        return np.eye(2)
    a, b, d = system.contact_real[c, [SCALING_11, SCALING_12, SCALING_22]]
    return np.array([[a, b], [b, d]])


def associated(system: System, c: int, direction: np.ndarray) -> np.ndarray:
    """(2,) `friction_direction` of a unit direction of slip (2,), which stays as it is."""
    out = direction.copy()
    friction_direction(system.contact_int[c], system.contact_real[c], out)
    return out


def opposed_slip(system: System, c: int, force: np.ndarray) -> np.ndarray:
    """(2,) a slip direction that friction at its limit opposes with a force (2,), along (t1, second)."""
    if not system.contact_int[c, ANISOTROPIC]:
        return -force
    inverse = np.linalg.inv(friction_scaling(system, c))
    return -inverse @ inverse @ force
