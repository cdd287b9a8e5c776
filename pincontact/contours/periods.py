"""Parameters that repeat: the one place where a parameter many turns away is brought back into its domain."""

from __future__ import annotations

import math

from ..jit import kernel


@kernel
def wrapped(u, low, high):
    """The parameter in [low, high] that is a whole number of periods from u; both ends stay what they are."""
    if low <= u <= high:
        return u
    period = high - low
    u -= period * math.floor((u - low) / period)
    # rounding may leave it just outside
    if u < low:
        return low
    if u > high:
        return high
    return u
