"""Friction that depends on the speed of slip."""

from __future__ import annotations

import math

from ..jit import kernel

# Slip so many times faster than the curve's speed has the sliding coefficient to the last bit; powers stay finite.
_FAR = 1e3


def stribeck(onset: float, sliding: float, scale: float, exponent: float, speed: float) -> float:
    """Coefficient of friction at a speed of slip in m/s: sliding + (onset - sliding) exp(-(speed / scale)^exponent)."""
    return sliding + (onset - sliding) * math.exp(-(min(speed / scale, _FAR) ** exponent))


stribeck_kernel = kernel(stribeck)
