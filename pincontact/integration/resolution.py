"""Whether a step resolves what decides its events: event functions as smooth functions of time, seen in its stages.

Where nothing moves, no error is estimated, however much the forces change that hold it: a step may span many periods
of a load. So the event functions of a step's stages are fitted by a polynomial of low degree. What it leaves is to be
small, against its size, or against its distance from zero, where nothing is decided; else the step is too
long. What moves the bodies limits steps long before that. Events are then looked for on the dense output, on which
event functions are exact.
"""

from __future__ import annotations

import math

import numpy as np

from ..callback import separate_kernel
from ..dynamics.event_functions import FORCE_EVENTS
from ..dynamics.resistance import count_items
from ..jit import NOTHING, kernel
from ..layout import (
    ERROR_ROWS,
    EVENTS_PER_CONTACT,
    KEPT_ROWS,
    MAX_STAGES,
    NOTHING_THERE,
    SCAN_ROOM,
    SYSTEM,
)
from .results import GAP_TOLERANCE
from .sign_changes import FAR, RESOLVED

# Degree of the polynomials where there are stages enough.
_DEGREE = 4
# Accuracy of the conditions of order two.
_ORDER_TWO = 1e-9
# Forces below this part of the largest, or of the loads, are round-off and have no sign.
FORCE_ROUND_OFF = 1e-9
# Steps this many times the least are not shortened for an event function: it jumps there.
_JUMP = 1e3


def roughness(a: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(m, n) weights of values in the stages a (n, n) at the nodes (n,), whose sums have the size of what the best
    polynomial leaves.

    Of equal nodes the last one counts. Stages of first order, in which not even a parabola is one, are left out where
    there are enough others.
    """
    used = [i for i, node in enumerate(nodes) if node not in nodes[i + 1 :]]
    accurate = [i for i in used if abs(a[i] @ nodes - 0.5 * nodes[i] ** 2) < _ORDER_TWO]
    if len(accurate) > _DEGREE + 2:
        used = accurate
    degree = min(_DEGREE, len(used) - 3)
    powers = np.vander(2.0 * nodes[used] - 1.0, degree + 1)
    out = np.zeros((len(used) - degree - 1, len(nodes)))
    out[:, used] = np.linalg.qr(powers, mode="complete")[0][:, degree + 1 :].T
    return out


@kernel
def keep_event_functions(system, index):
    """Keep the event functions of the last evaluation as those of stage number index."""
    n = count_items(system)
    kept = system.scan_event_functions
    event_functions = system.event_functions
    for c in range(n):
        for kind in range(EVENTS_PER_CONTACT):
            kept[SCAN_ROOM + index, c, kind] = event_functions[c, kind]


@kernel
def set_event_functions_aside(system):
    """Keep the event functions of the last evaluation, those of the next step's start."""
    keep_event_functions(system, KEPT_ROWS - 1)


@kernel
def take_event_functions_up(system):
    """The next step's start has the event functions that were set aside."""
    n = count_items(system)
    kept = system.scan_event_functions
    for c in range(n):
        for kind in range(EVENTS_PER_CONTACT):
            kept[SCAN_ROOM, c, kind] = kept[SCAN_ROOM + KEPT_ROWS - 1, c, kind]


@separate_kernel(NOTHING, SYSTEM.type)
def event_function_error(system):
    """Raise ERROR_NORM of the trial step where one of its event functions is not resolved: to 1 and more."""
    n, scalars = count_items(system), system.scalars
    lowest, highest = system.lowest, system.highest
    worst, floor, largest_force = 0.0, -1.0, 0.0
    if scalars.step <= _JUMP * scalars.floor:
        return
    for c in range(n):
        for kind in range(EVENTS_PER_CONTACT):
            low, high = lowest[c, kind], highest[c, kind]
            # what the best polynomial leaves is less than what the middle leaves
            if not low < high or 0.5 * math.sqrt(MAX_STAGES) * (high - low) <= FAR * low:
                continue
            if low == -math.inf or high >= NOTHING_THERE:
                continue
            if floor < 0.0:
                floor, largest_force = _floor(system), _largest_force(lowest, highest, n)
            allowed = max(RESOLVED * max(high, -low), FAR * low)
            is_force = kind in FORCE_EVENTS
            allowed = max(allowed, FORCE_ROUND_OFF * largest_force if is_force else floor)
            worst = max(worst, _left(system, c, kind) / allowed)
    if worst > 0.0:
        # errors of polynomials fall with another power of the step than those of the state
        scaled = worst ** ((scalars.error_order + 1.0) / (_DEGREE + 1.0))
        scalars.error_norm = max(scalars.error_norm, min(scaled, 1e100))


@kernel
def _left(system, c, kind):
    """What the best polynomial leaves of an event function in the trial step: the norm over its stages."""
    sizes = system.sizes
    kept = system.scan_event_functions
    weights = system.weights_error
    total = 0.0
    end = sizes.nstages
    for row in range(2, ERROR_ROWS):
        if weights[row, end] == 0.0:
            # no more rows
            break
        part = 0.0
        for s in range(end + 1):
            part += weights[row, s] * kept[SCAN_ROOM + s, c, kind]
        total += part * part
    return math.sqrt(total)


@kernel
def _floor(system):
    """Gaps in m and speeds in m/s below which nothing is known."""
    sizes, scale = system.sizes, system.scale
    velocities = system.state[sizes.nq :]
    size = 1.0
    for k in range(sizes.nv):
        size = max(size, abs(velocities[k]))
    return GAP_TOLERANCE * (scale[0] * size + scale[1])


@kernel
def _largest_force(lowest, highest, n):
    """Largest size of an event function that is a force."""
    size = 0.0
    for c in range(n):
        for kind in FORCE_EVENTS:
            size = max(size, max(abs(lowest[c, kind]), abs(highest[c, kind])))
    return size
