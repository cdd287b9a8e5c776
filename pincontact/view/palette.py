"""Colours: one of each mode, and one of each contact wherever contacts are distinguished."""

from __future__ import annotations

from ..layout import FREE, FRICTIONLESS, SLIPPING, STICK

MODE_COLORS = {
    FREE: (0.75, 0.75, 0.75),
    FRICTIONLESS: (0.20, 0.45, 0.85),
    STICK: (0.15, 0.62, 0.30),
    SLIPPING: (0.88, 0.25, 0.15),
}
# Matplotlib's "tab10" without its red, green and grey, which are modes, and darker shades of the same.
_CONTACTS = (
    "#1f77b4",
    "#ff7f0e",
    "#9467bd",
    "#8c564b",
    "#e377c2",
    "#bcbd22",
    "#17becf",
    "#0d3b66",
    "#a44a00",
    "#4b2e83",
    "#4a2c24",
    "#99267a",
    "#6b6c00",
    "#0a6872",
)


def contact_color(number: int) -> str:
    """The colour of a run's contact by its number in the scene; they repeat after fourteen."""
    return _CONTACTS[number % len(_CONTACTS)]
