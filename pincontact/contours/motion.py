"""Driven placements."""

from __future__ import annotations

from ..jit import kernel


@kernel
def evaluate_motion(kind, parameters, pool, t, out):
    out[0] = 1.0
