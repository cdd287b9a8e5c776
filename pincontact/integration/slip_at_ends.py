"""Slip in three dimensions at the ends of steps: where it ends its direction is singular, and where it is slow friction
turns it faster than explicit steps follow."""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..dynamics.resistance import count_items
from ..geometry.small import dot
from ..jit import BOOLEAN, NOTHING, kernel
from ..layout import (
    FROZEN,
    LAST_NORMAL_X,
    LAST_RATE,
    LAST_SPEED,
    LAST_STEP,
    MODE,
    MU,
    NEXT_NORMAL_X,
    SLIP_RATE,
    SLIP_SPEED,
    SLIPPING,
    START_RATE,
    START_SLIP_X,
    START_SPEED,
    START_TOLERANCE,
    STOP_ERROR,
    STOP_TIME,
    SYSTEM,
    TANGENTS,
)
from ..linalg import inner, whiten

# No step goes further than this fraction of the way to the end of slip, or than all of it but this many times the error
# with which that is foretold, and this fraction; that where the way is shorter than this part of the last step, so that
# the error of a step leaves slip its direction.
_STOP_FRACTION = 0.8
_FORETOLD, _LEAST_LEFT, _SHORT = 4.0, 1e-3, 0.3
# Part of what the last linear step may leave out that steps are to leave to it.
_MARGIN = 0.1
# Steps of Newton's method to the end of a polynomial, and the change, relative to the way, that ends them.
_NEWTON_STEPS, _KNOWN = 8, 1e-9
# Slip has ended once its speed is down to the error that steps are allowed to make in it, where its direction is noise,
# or once one linear step to its end leaves out no more than a part of that error. Where steps no longer get anywhere
# near the end, the speed that counts as ended is doubled at every trial step, so many times at most. It has been halved
# -STALLED times where to end the slip would take more from the velocity than such errors do: beside constraints that
# leave next to nothing of its rows it is known that much better, since steps are projected on these.
LEFT_OUT = 0.05
STOP_DOUBLINGS = 10
_PROGRESS = 0.9
# Growth by which a slip has got away from its slowest point.
_ESCAPE = 2.0
# A slip turns round where it passes zero within this part of its speeds before and after that.
_PASSES = 0.1
# Speed in m/s that counts as ended whatever the tolerances.
_SMALLEST_STOP_SPEED = 1e-13
# Steps of more than this over the time in which friction turns a slip are held back by stability, not by accuracy: the
# pairs' limits are 2.5, 3.3 and 6.4. Between, down to the second, steps are now the one and now the other.
STIFF, ACCURATE = 2.0, 0.5


@separate_kernel(NOTHING, SYSTEM.type)
def note_end(system):
    """From the last evaluation, that of STAGE_STATE, what the next step is held against: each contact's normal, the
    speed and rate of every 3D slip with the error that is allowed in it, and how fast friction turns it.
    """
    nv, n, v = system.sizes.nv, count_items(system), system.v
    relative, absolute = system.scale[0], system.scale[1]
    turning = 0.0
    for c in range(n):
        contact, number, basis = system.contact_int[c], system.contact_real[c], system.basis[c]
        for i in range(3):
            number[NEXT_NORMAL_X + i] = basis[2, i]
        before, rate = number[START_SPEED], number[START_RATE]
        number[START_SPEED] = math.inf
        if contact[MODE] != SLIPPING or contact[TANGENTS] != 2 or contact[FROZEN] != 0 or not number[MU] > 0.0:
            continue
        number[START_SPEED], number[START_RATE] = number[SLIP_SPEED], number[SLIP_RATE]
        for i in range(3):
            number[START_SLIP_X + i] = system.slip[c, i]
        turning = max(turning, _turning_rate(system, c))
        allowed = _SMALLEST_STOP_SPEED
        for row in range(3):
            line, value = system.rows[c, row], 0.0
            for k in range(nv):
                value += abs(line[k]) * (absolute + relative * abs(v[k]))
            allowed = max(allowed, value)
        number[START_TOLERANCE] = allowed
        _foretell_stop(system, c, before, rate)
        number[LAST_SPEED], number[LAST_RATE], number[LAST_STEP] = before, rate, system.scalars.step
    system.scalars.turning_rate = turning


@kernel
def _foretell_stop(system, c, before, rate_before):
    """STOP_ERROR, what one linear step to the end of slip c leaves out, in m/s (of positions, in m), and STOP_TIME, how
    long in s a step may be before that end, from its speed and rate now and at the start of the last step."""
    number, h = system.contact_real[c], system.scalars.step
    speed, rate = number[START_SPEED], number[START_RATE]
    number[STOP_ERROR] = number[STOP_TIME] = math.inf
    if not (rate < 0.0 and speed > 0.0):
        return
    left = speed / -rate
    number[STOP_TIME] = _STOP_FRACTION * left
    if not (before < math.inf and h > 0.0):
        return
    # what the rate changes by over h goes with the square of the time, and slip turns as it slows down
    missed = abs(speed - before - rate_before * h) * (left / h) ** 2
    basis, slip, along = system.basis[c], system.slip[c], system.relative_acceleration[c]
    turned = abs(dot(basis[0], slip) * along[1] - dot(basis[1], slip) * along[0]) / speed * left
    number[STOP_ERROR] = max(max(missed, turned), 0.5 * speed * left)
    bend = abs(rate - rate_before) / h
    near = _near_end(number, h, before, rate_before, turned, bend)
    if near > 0.0:
        number[STOP_TIME] = near
        return
    # on the parabola that the rates give, whose second derivative is that half a step ago
    square = rate * rate - 2.0 * (rate - rate_before) / h * speed
    if not square > 0.0:
        return
    last_rate = math.sqrt(square)
    way = 2.0 * speed / (last_rate - rate)
    part = way / h
    if part < _SHORT:
        error = abs(speed - before - 0.5 * h * (rate + rate_before)) * part * part * (2.0 * part + 3.0) + turned
        near = _before(number, way, error / last_rate, bend)
        number[STOP_TIME] = max(_STOP_FRACTION * min(way, left), near)


@kernel
def _before(number, way, error, bend):
    """How far a step may go that ends before slip does, on a way that is known with this error, both in s; bend: how
    fast its rate changes, in m/s^3."""
    # no nearer than one linear step goes with a margin, which leaves out half the rate, and half the bend, times t^2
    near = way - math.sqrt(_MARGIN * LEFT_OUT * number[START_TOLERANCE] / max(-number[START_RATE], bend))
    return min(near, (1.0 - _LEAST_LEFT) * way - _FORETOLD * error)


@kernel
def _near_end(number, h, before, rate_before, turned, bend):
    """The same on the polynomial of the speeds and rates now, h ago and a step before that, 0 where that tells nothing;
    its last term is taken for its error. turned: a further one, in m/s; bend: see `_before`."""
    speed, rate, back = number[START_SPEED], number[START_RATE], h + number[LAST_STEP]
    if not (number[LAST_SPEED] < math.inf and number[LAST_STEP] > 0.0):
        return 0.0
    # divided differences (Newton, Hermite), each node twice
    now, past, ago = (speed - before) / h, (before - number[LAST_SPEED]) / number[LAST_STEP], number[LAST_STEP]
    a, b = (rate - now) / h, (now - rate_before) / h
    c, d = (rate_before - past) / ago, (past - number[LAST_RATE]) / ago
    third, c, d = (a - b) / h, (b - c) / back, (c - d) / ago
    fourth, c = (third - c) / back, (c - d) / back
    fifth = (fourth - c) / back
    x = speed / -rate
    for _ in range(_NEWTON_STEPS):
        near, square = x + h, x * x * (x + h) * (x + h)
        value = speed + x * (rate + x * (a + near * third)) + square * (fourth + (x + back) * fifth)
        slope = rate + x * (2.0 * a + (3.0 * x + 2.0 * h) * third)
        slope += 2.0 * x * near * (x + near) * (fourth + (x + back) * fifth) + square * fifth
        if not slope < 0.0:
            return 0.0
        change = value / -slope
        x += change
        if not 0.0 < x <= back:
            return 0.0
        if abs(change) <= _KNOWN * x:
            break
    error = abs(fifth * x * x * (x + h) * (x + h) * (x + back)) + turned + abs(change * slope)
    near = _before(number, x, error / -slope, bend)
    return near if near > _STOP_FRACTION * x else 0.0


@kernel
def _turning_rate(system, c):
    """How fast friction turns the slip of item c into the direction in which it would go, in 1 / s: |F_t| w M^-1 w^T
    over the speed, with w the row across the slip."""
    nv, force, work = system.sizes.nv, system.force[c], system.work
    basis, rows, slip = system.basis[c], system.rows[c], system.slip[c]
    first, second = dot(basis[0], slip), dot(basis[1], slip)
    for k in range(nv):
        work[k] = first * rows[1, k] - second * rows[0, k]
    whiten(system.factor, system.parents, nv, work, work)
    speed = math.hypot(first, second)
    return math.hypot(force[0], force[1]) * inner(work, work, nv) / speed**3 if speed > 0.0 else 0.0


@kernel
def begin_next(system):
    """What was noted holds from here on; steps that slow slip makes stiff are counted."""
    n, scalars, counters = count_items(system), system.scalars, system.counters
    contact_real = system.contact_real
    for c in range(n):
        for i in range(3):
            contact_real[c, LAST_NORMAL_X + i] = contact_real[c, NEXT_NORMAL_X + i]
    turned = scalars.turning_rate * scalars.step
    if turned > STIFF:
        counters.stiff_steps += 1
    elif turned < ACCURATE:
        counters.stiff_steps = 0
    watch_slips(system, n, True)


@kernel
def watch_slips(system, n, accepted):
    """Count trial steps that bring no slip nearer to its end, while one that slows down is within reach of it."""
    scalars, counters = system.scalars, system.counters
    least, slowest, near = math.inf, math.inf, False
    for c in range(n):
        number = system.contact_real[c]
        speed = number[START_SPEED]
        if speed < math.inf:
            least = min(least, speed)
            if number[START_RATE] < 0.0:
                slowest = min(slowest, speed)
                near = near or speed <= number[START_TOLERANCE] * 2.0**STOP_DOUBLINGS
    if slowest == math.inf:
        # a slip that grows again has passed its slowest point: that was not its end
        if accepted and least < math.inf and least > _ESCAPE * scalars.slowest:
            scalars.slowest = math.inf
            counters.stalled = 0
        return
    if accepted and slowest < _PROGRESS * scalars.slowest:
        scalars.slowest = slowest
        counters.stalled = min(counters.stalled, 0)
    elif near and scalars.turning_rate * scalars.step <= STIFF:
        counters.stalled = doubled(counters.stalled)


@kernel
def doubled(stalled):
    """How often the speed that counts as ended has been doubled, once more; past the usual one, 0, lest it be halved
    again."""
    return min(stalled + 1 if stalled != -1 else 1, STOP_DOUBLINGS)


@kernel
def slip_ends(system, n):
    """Whether a slip is as good as over: it slows down, or should grow, and steps that friction holds back do not."""
    stalled = system.counters.stalled
    reach = 2.0**stalled
    for c in range(n):
        number = system.contact_real[c]
        speed, allowed = number[START_SPEED], number[START_TOLERANCE]
        if not (speed < math.inf and (number[START_RATE] < 0.0 or (stalled > 0 and speed <= allowed))):
            continue
        ended = max(allowed * reach, _SMALLEST_STOP_SPEED)
        if speed <= ended or number[STOP_ERROR] <= LEFT_OUT * min(allowed, ended):
            return True
    return False


@separate_kernel(BOOLEAN, SYSTEM.type)
def turns_round(system):
    """Whether a 3D slip has turned round within the trial step, whose end has been evaluated: on the straight way from
    what it was to what it is it passes next to zero, where friction jumps, or turns faster than the step resolves."""
    for c in range(count_items(system)):
        number, slip = system.contact_real[c], system.slip[c]
        if not number[START_SPEED] < math.inf:
            continue
        before = number[START_SLIP_X : START_SLIP_X + 3]
        along = dot(before, slip)
        if along >= 0.0:
            continue
        first, second = dot(before, before), dot(slip, slip)
        if min(first, second) <= number[START_TOLERANCE] ** 2:
            # so slow that steps do not know where to
            continue
        # squares of the area between both, and of the way from one to the other
        area, way = max(first * second - along * along, 0.0), first + second - 2.0 * along
        if area <= _PASSES**2 * way * min(first, second):
            return True
    return False


@kernel
def time_to_stop(system, n):
    """Time in s after which a step must end before slip does; infinite where none slows down."""
    least = math.inf
    for c in range(n):
        number = system.contact_real[c]
        if number[START_SPEED] < math.inf and number[START_RATE] < 0.0:
            least = min(least, number[STOP_TIME])
    return least
