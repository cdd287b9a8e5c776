"""Step-size control of the Runge-Kutta pairs."""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..dynamics.resistance import count_items
from ..jit import NOTHING, REAL, kernel
from ..layout import EVENT, START_RATE, START_SPEED, SYSTEM
from .stages import evaluate, fill_slope, hand_over

# Safety, and the bounds of one change.
_SAFETY = 0.8
_SMALLEST_FACTOR = 0.2
_LARGEST_FACTOR = 10.0
# Weights of the present and the last error in the exponent, and the least that is remembered of the last, lest a tiny
# error keep steps from growing. Hardly a step is rejected then: a fifth fewer evaluations at loose tolerances, a
# twelfth at 1e-6, than with the present error alone and a safety of 0.9.
_PRESENT, _PAST = 0.76, 0.24
_SMALLEST_LAST_ERROR = 1e-2
# Sizes of the state and its slope, in tolerances, below which they tell nothing of the first step, and what it is then,
# in s; safety of the first step: a longer one costs a rejection, a shorter one next to nothing.
_SMALL_SIZE = 1e-5
_SMALL_STEP = 1e-6
_FIRST_FRACTION = 0.5
# Steps that end within this fraction of a step from the end, or from an output time, end there.
SLIVER = 1e-9
# Trial steps after which compiled steps come back all the same, for the keyboard's and the progress bar's sake.
BATCH = 256
# After a rejection by a failed evaluation the step shrinks by this factor.
FAILED_FACTOR = 0.25
# Steps of the longest size that is allowed differ by up to this part, in the sequence of the golden ratio.
_IRREGULAR, _GOLDEN = 0.3, 0.6180339887498949


@kernel
def next_step(h, error, last_error, order, rejected):
    """Step size after a trial step of size h with this error norm; last_error: that of the accepted step before.

    After a rejection by the error alone; else a PI controller (Hairer, Wanner, Solving ODEs II, Sec. IV.2).
    """
    if error == 0.0:
        return h if rejected else _LARGEST_FACTOR * h
    exponent = 1.0 / (order + 1.0)
    if rejected:
        return h * min(1.0, max(_SMALLEST_FACTOR, _SAFETY * error**-exponent))
    factor = _SAFETY * error ** (-_PRESENT * exponent) * max(last_error, _SMALLEST_LAST_ERROR) ** (_PAST * exponent)
    return h * min(_LARGEST_FACTOR, max(_SMALLEST_FACTOR, factor))


@kernel
def _distance(state, a, b, absolute, relative):
    """Root mean square of a - b over all controlled components, in the tolerances of the state; -1 without any."""
    count, total = 0, 0.0
    for i in range(state.shape[0]):
        if absolute[i] > 0.0:
            count += 1
            value = (a[i] - b[i]) / (absolute[i] + relative * abs(state[i]))
            total += value * value
    return math.sqrt(total / count) if count > 0 else -1.0


@separate_kernel(NOTHING, SYSTEM.type, REAL, REAL)
def first_step(system, t, span):
    """NEXT_STEP: the first step from STATE, from the sizes of the state, of its slope and of that one's rate, all in
    tolerances; span: time in s that there is, and the step where nothing is controlled.

    The rate comes from a small Euler step (Hairer, Norsett, Wanner, Sec. II.4). Their step (0.01 / size)^(1 / order)
    has no unit of time, and is far too long for what turns fast; rate over slope has one, but is a guess at one
    instant. The lesser of both is within a factor of three of what the control settles at.
    """
    sizes, scalars = system.sizes, system.scalars
    ny, n = sizes.ny, count_items(system)
    state, stage_state = system.state, system.stage_state
    slope, moved = system.slopes[0], system.next_slope
    absolute, relative = system.absolute, system.scale[0]
    scalars.next_step = span
    for i in range(ny):
        moved[i] = 0.0
    size, rate = _distance(state, state, moved, absolute, relative), _distance(state, slope, moved, absolute, relative)
    if size < 0.0 or span == 0.0:
        return
    # sizes that overflow leave nothing to go by
    h = _SMALL_STEP
    if _SMALL_SIZE <= size < math.inf and _SMALL_SIZE <= rate < math.inf:
        h = min(0.01 * size / rate, span)
        for i in range(ny):
            stage_state[i] = state[i] + h * slope[i]
        hand_over(system, stage_state)
        if evaluate(system, t + h, 0) <= EVENT:
            fill_slope(system, stage_state, moved)
            change = _distance(state, slope, moved, absolute, relative) / h
            exponent = 1.0 / (scalars.error_order + 1.0)
            longer = (0.01 / max(rate, change)) ** exponent
            if change > 0.0:
                longer = min(longer, (10.0 * change / rate / rate) ** exponent * rate / change)
            if longer < math.inf:
                h = max(h, _FIRST_FRACTION * longer)
        hand_over(system, state)
    for c in range(n):
        # slip that has just begun turns within the time that it has gone on
        speed, rate = system.contact_real[c, START_SPEED], abs(system.contact_real[c, START_RATE])
        if speed < _FIRST_FRACTION * h * rate:
            h = speed / (_FIRST_FRACTION * rate)
    scalars.next_step = min(h, span)


@kernel
def irregular(count):
    """Part of the longest step that step number count may take: never twice the same, so that nothing periodic is seen
    in the same phase for long."""
    share = _GOLDEN * (count + 1)
    return 1.0 - _IRREGULAR * (share - math.floor(share))
