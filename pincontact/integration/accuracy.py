"""What a run can tell from zero: gaps, rates of gaps and slip speeds, as the event handling uses them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..layout import LENGTH
from .results import GAP_TOLERANCE

if TYPE_CHECKING:
    from ..dynamics.system import System

# Slip slower than this (m/s, absolute and relative to the largest velocity) counts as rest where modes are set anew.
_REST = 1e-9


def gap_accuracy(system: System) -> np.ndarray:
    """(items,) errors of gaps in m, and of the distances of joint coordinates from their ends, in m or rad.

    They are GAP_TOLERANCE times the tolerance of positions, at the contact's length; joint coordinates are of unit
    size.
    """
    lengths = np.ones(system.items)
    lengths[: system.nc] = system.contact_real[: system.nc, LENGTH]
    relative, absolute = system.scale
    return GAP_TOLERANCE * (absolute + relative * lengths)


def rest_speed(system: System) -> float:
    """Slip slower than this, in m/s, counts as rest."""
    return _REST * (1.0 + max(map(abs, system.v.tolist()), default=0.0))


def gap_rate(system: System, c: int) -> float:
    """Speed in m/s at which the bodies of contact c part, from the last evaluation."""
    (x, y, z), (u, v, w) = system.basis[c, 2].tolist(), system.slip[c].tolist()
    return float(x * u + y * v + z * w)
