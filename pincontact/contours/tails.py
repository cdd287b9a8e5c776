"""Where contours without ends go: boxes around all that they have beyond a value of a parameter."""

from __future__ import annotations

import functools
import math

import numpy as np

from .base import Contour
from .bends import enclosed
from .curves import line, round_curve
from .enclosures import Interval
from .surfaces import straight_profile
from .tape import traced

# Values of a parameter beyond which boxes are known, upwards from zero and downwards.
_UPWARDS = 2.0 ** np.arange(-20.0, 24.0, 0.25)
_VALUES = np.concatenate([-_UPWARDS[::-1], [0.0], _UPWARDS])


def ends_near(contour: Contour, a: int, place: np.ndarray, radius: float, t: float) -> tuple[float, float]:
    """Ends of parameter a beyond which a contour has no point within a radius in m of a place (3,) in its frame: those
    of its domain, or values in it; infinite where that is not found out."""
    below, above = _tails(contour, a, t if contour.time_dependent else 0.0)
    far = [
        np.linalg.norm(np.maximum(np.maximum(low - place, place - high), 0.0), axis=1) > radius
        for low, high in (below, above)
    ]
    low, high = contour.domain[a]
    if math.isinf(low) and far[0].any():
        low = float(_VALUES[far[0]].max())
    if math.isinf(high) and far[1].any():
        high = float(_VALUES[far[1]].min())
    return low, high


@functools.lru_cache(maxsize=64)
def _tails(contour: Contour, a: int, t: float) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Boxes, low and high ends (n, 3), around what a contour has below each of the values, and above."""
    low, high = (np.full((contour.dimension, len(_VALUES)), [[end] for end in ends]) for ends in zip(*contour.domain))
    ends = np.clip(_VALUES, *contour.domain[a])
    upper, lower = high.copy(), low.copy()
    upper[a] = lower[a] = ends
    with np.errstate(all="ignore"):
        return _enclosing(contour, low, upper, t), _enclosing(contour, lower, high, t)


def _enclosing(contour: Contour, low: np.ndarray, high: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Low and high ends (n, 3) of boxes around what a contour has in boxes (k, n) of its parameters; infinite where
    that is not known."""
    shape, u = contour.shape, [Interval(*ends) for ends in zip(low, high)]
    known: list[Interval]
    if contour.evaluator is traced:
        when = np.full((int(contour.time_dependent), low.shape[1]), t)
        known = [jet.value for jet in enclosed(contour.pool, Interval(np.vstack([low, when]), np.vstack([high, when])))]
    elif contour.evaluator is round_curve:
        turn = u[0].cosine(), u[0].affine(1.0, -0.5 * math.pi).cosine()
        known = [turn[0].affine(shape[0]), turn[1].affine(shape[1]), u[0].affine(shape[2])]
    elif contour.evaluator is straight_profile:
        across = u[1].affine(shape[1], shape[0]).magnitude
        known = [*2 * [Interval(-across, across)], u[1].affine(shape[2])]
    elif contour.evaluator is line:
        known = [u[0], *2 * [Interval(*np.zeros((2, low.shape[1])))]]
    else:
        known = 3 * [Interval(*np.full((2, low.shape[1]), math.nan))]
    return np.stack([part.lo for part in known], axis=1), np.stack([part.hi for part in known], axis=1)
