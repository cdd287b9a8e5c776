"""The discrete part of contacts: modes, charts, sides and signs, which hold between events."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..layout import BESIDE, CHART, MODE, SIDE, SIDE_INTS

if TYPE_CHECKING:
    from ..dynamics.system import System

# mode, both charts, and the rest of what is kept of a contact's integers
DISCRETE_COLUMNS = 3 + BESIDE - MODE


def discrete_part(contact_int: np.ndarray, charts: np.ndarray) -> np.ndarray:
    """(..., nc, DISCRETE_COLUMNS) the discrete part of contacts, given their integers and charts (..., nc, 2)."""
    out = np.empty((*contact_int.shape[:-1], DISCRETE_COLUMNS), dtype=np.int64)
    for target, source in discrete_views(out, contact_int, charts):
        target[...] = source
    return out


def discrete_views(
    discrete: np.ndarray, contact_int: np.ndarray, charts: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Which columns of the discrete part (..., nc, DISCRETE_COLUMNS) are which of contacts' integers and charts."""
    return [
        (discrete[..., 0], contact_int[..., MODE]),
        (discrete[..., 1:3], charts),
        (discrete[..., 3:], contact_int[..., SIDE : BESIDE + 1]),
    ]


def read_discrete(system: System) -> np.ndarray:
    """(nc, DISCRETE_COLUMNS) the discrete part of a system's contacts."""
    return discrete_part(*_discrete_of(system))


def _discrete_of(system: System) -> tuple[np.ndarray, np.ndarray]:
    """Integers and charts (nc, 2) of a system's contacts; views."""
    return system.contact_int[: system.nc], system.side_int.reshape(-1, 2, SIDE_INTS)[: system.nc, :, CHART]


def write_discrete(system: System, discrete: np.ndarray) -> None:
    """Set the discrete part of a system's contacts."""
    for source, target in views_of_system(discrete, system):
        target[...] = source


def views_of_system(discrete: np.ndarray, system: System) -> list[tuple[np.ndarray, np.ndarray]]:
    """`discrete_views` of a system's contacts."""
    return discrete_views(discrete, *_discrete_of(system))
