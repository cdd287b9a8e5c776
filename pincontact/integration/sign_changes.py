"""Where a function of one variable changes its sign in an interval, however often: it is sampled until that shows."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from ..jit import kernel

# Places in an interval at which a function is sampled, irregular, lest they all be zeros of a sine.
_PLACES = (0.0, 0.1137, 0.2419, 0.3871, 0.5647, 0.7219, 0.8629, 1.0)
# Degree of the polynomial by which it is resolved, and what that may leave: a part of the largest value, or of the
# least.
_DEGREE = 3
RESOLVED, FAR = 1e-2, 0.125
# Halvings in a row of which one half is smooth: a jump is looked at no closer.
_HALVINGS = 6
# Looks at a function in an interval, at most: about a second.
MOST_LOOKS = 65536
# What stands for infinite values.
HUGE = 1e100
# Looks at the lowest point between two samples.
_LOOKS = 3
# Zeros of event functions in a step, as a part of it; looks for a zero, at most; round-off of places.
ACCURACY = 1e-15
LOOKS_FOR_ZERO = 128
_ROUND_OFF = 2.2e-16

_ROUGHNESS = np.linalg.qr(np.vander(_PLACES, _DEGREE + 1), mode="complete")[0][:, _DEGREE + 1 :].T

Samples = list[tuple[float, float]]


@kernel
def begin_bracket(bracket, place, value):
    """The first place at which a function is known that changes its sign behind it."""
    for i in range(3):
        bracket[2 * i], bracket[2 * i + 1] = place, max(-HUGE, min(value, HUGE))


@kernel
def narrow(bracket, place, value, accuracy):
    """Take the value of a function at a place into the bracket of a zero; where to look next, NaN where that is known.

    bracket: places and values (a, f(a), b, f(b), c, f(c)): of the last look, of one on the other side of the zero, and
    of the one before. By inverse quadratic interpolation where that is safe, else by bisection (Chandrupatla, Adv. Eng.
    Software 28 (1997) 145). Infinite values tell no more than their sign.
    """
    value = max(-HUGE, min(value, HUGE))
    bracket[4], bracket[5] = bracket[0], bracket[1]
    if (value < 0.0) != (bracket[1] < 0.0):
        bracket[4], bracket[5], bracket[2], bracket[3] = bracket[2], bracket[3], bracket[0], bracket[1]
    bracket[0], bracket[1] = place, value
    a, value_a, b, value_b, c, value_c = bracket[0], bracket[1], bracket[2], bracket[3], bracket[4], bracket[5]
    width, least = abs(b - a), accuracy + _ROUND_OFF * abs(a)
    if value == 0.0 or width <= 2.0 * least:
        return math.nan
    share = 0.5
    if b == c:
        share = value_a / (value_a - value_b)
    else:
        xi, phi = (a - b) / (c - b), (value_a - value_b) / (value_c - value_b)
        if phi * phi < xi and (1.0 - phi) ** 2 < 1.0 - xi:
            share = value_a / (value_b - value_a) * value_c / (value_b - value_c)
            share += (c - a) / (b - a) * value_a / (value_c - value_a) * value_b / (value_c - value_b)
    return a + max(least / width, min(1.0 - least / width, share)) * (b - a)


@kernel
def zero_in(bracket):
    """The place in a bracket, on either side of the zero, whose value is nearer to zero."""
    return bracket[0] if abs(bracket[1]) <= abs(bracket[3]) else bracket[2]


def asked_once(value: Callable[[float], float], known: dict[float, float]) -> Callable[[float], float]:
    """The function, asked once for each place besides those with known values: one that answers otherwise the next time
    (noise) has no root to be found."""

    def asked(place: float) -> float:
        if place not in known:
            known[place] = value(place)
        return known[place]

    return asked


def zero_between(value: Callable[[float], float], low: float, high: float, accuracy: float) -> float:
    """Where a function that has opposite signs at low and high is zero, or next to that behind it, also if it jumps."""
    bracket, place, before = [0.0] * 6, high, value(low)
    begin_bracket(bracket, low, before)
    for _ in range(LOOKS_FOR_ZERO):
        place = narrow(bracket, place, value(place), accuracy)
        if math.isnan(place):
            break
    is_behind = bracket[1] == 0.0 or (bracket[1] < 0.0) != (before < 0.0)
    return bracket[0] if is_behind else bracket[2]


def crossing_between(value: Callable[[float], float], low: float, high: float, accuracy: float) -> float:
    """`zero_between` of a function that is `asked_once`: the first zero where it stays zero, high where it is infinite
    at an end."""
    before, after = value(low), value(high)
    if math.isinf(before) or math.isinf(after):
        return high
    return zero_between(value if after != 0.0 else lambda place: value(place) or -before, low, high, accuracy)


def resolve(value: Callable[[float], float], at_start: float, at_end: float, looks: int = MOST_LOOKS) -> Samples:
    """(place, value) in order, from 0 to 1, so close that a cubic between them is as good as the function.

    at_start, at_end: its values there. Fewer where it jumps, which leaves one of two halves smooth; and where it takes
    more looks: there are at least that many samples then.
    """
    samples = {0.0: at_start, 1.0: at_end}

    def look(low: float, high: float) -> bool:
        """Sample an interval; whether a cubic is not as good as the function there."""
        inner = [low + (high - low) * place for place in _PLACES[1:-1]]
        samples.update((place, value(place)) for place in inner)
        return _rough([samples[place] for place in (low, *inner, high)])

    # intervals in which it is rough, with the halvings that are left where that is a jump
    rough = deque([(0.0, 1.0, _HALVINGS)] if look(0.0, 1.0) else [])
    while rough and len(samples) < looks:
        low, high, left = rough.popleft()
        middle = 0.5 * (low + high)
        samples[middle] = value(middle)
        halves = [half for half in ((low, middle), (middle, high)) if look(*half)]
        left = _HALVINGS if len(halves) == 2 else left - 1
        rough += [(*half, left) for half in halves if left > 0]
    return sorted(samples.items())


def _rough(values: list[float]) -> bool:
    """Whether the values at the places are not those of a cubic."""
    largest, least = max(map(abs, values)), min(map(abs, values))
    if min(values) < 0.0 < max(values):
        least = 0.0
    if largest == 0.0 or math.isinf(largest):
        return False
    # in parts of the largest, lest squares overflow
    rough = float(np.linalg.norm(_ROUGHNESS @ np.divide(values, largest)))
    return rough > max(RESOLVED, FAR * (least / largest))


def with_double_zeros(value: Callable[[float], float], samples: Samples) -> Samples:
    """The samples, and those places between them where the function has gone through zero and comes back."""
    found = []
    for triple in zip(samples, samples[1:], samples[2:]):
        sign = 1.0 if triple[1][1] > 0.0 else -1.0
        sizes = [sign * y for _, y in triple]
        if not (0.0 < sizes[1] <= sizes[0] and sizes[1] <= sizes[2]):
            continue
        points = [(x, size) for (x, _), size in zip(triple, sizes)]
        lowest = look_below_zero(lambda x, sign=sign: sign * value(x), points)  # type: ignore[misc]
        if lowest is not None:
            found.append((lowest[0], sign * lowest[1]))
    return sorted([*samples, *found])


def look_below_zero(value: Callable[[float], float], points: Samples) -> tuple[float, float] | None:
    """Look at the lowest points of parabolas through three points (place, value) for one where the function is not
    positive; (place, value) there, None if there is none."""
    for _ in range(_LOOKS):
        place = _vertex(points)
        if place is None:
            return None
        y = value(place)
        if y <= 0.0:
            return place, y
        points = sorted([*sorted(points, key=lambda point: point[1])[:2], (place, y)])
    return None


def _vertex(points: list[tuple[float, float]]) -> float | None:
    """Where the parabola through three points is lowest, strictly between the outer ones; None if it is not."""
    (x0, y0), (x1, y1), (x2, y2) = points
    if x0 == x1 or x1 == x2:
        return None
    first, second = (y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1)
    if not second > first:
        return None
    theta = 0.5 * (x0 + x1) - 0.5 * first * (x2 - x0) / (second - first)
    return theta if x0 < theta < x2 and theta != x1 else None
