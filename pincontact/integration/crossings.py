"""Where event functions turn negative along a step that has been interpolated: samples, of which two or three show that
one does, or may have been, and the first zero between two of them."""

from __future__ import annotations

import math

from ..arrays import array_entry
from ..callback import separate_kernel
from ..dynamics.resistance import count_items
from ..jit import BOOLEAN, INTEGER, NOTHING, REAL, kernel
from ..layout import (
    DOMAIN_EVENT,
    EVENT,
    EVENTS_PER_CONTACT,
    GAP_EVENT,
    LEFT_ROW,
    LOOK_ROW,
    NOTHING_THERE,
    OK,
    RIGHT_ROW,
    SCAN_ROOM,
    SPEED_EVENT,
    SYSTEM,
)
from .sign_changes import ACCURACY, HUGE, LOOKS_FOR_ZERO, begin_bracket, narrow, zero_in
from .stages import evaluate
from .trial_steps import load_interpolated

# What `scan_on` has met: a sign change; what may be a minimum below zero; the end of the step, or of what can be
# evaluated.
CROSSES, MINIMUM, ENDS = 1, 2, 4
# What `sought` may be of an event function instead of the share of the step at which its zero is known: nothing is
# known; it is not sought; it is not sought either where others' zeros show that it is negative.
UNKNOWN, NOT_SOUGHT, LEFT_OUT = 2.0, -1.0, -2.0
# Halvings of the part of a step in which a mode may hold that was entered on its boundary.
_BISECTIONS = 40
# Looks for what crosses before the first crossing that was found, beyond one for each event function.
_ROUNDS = 4
# Event functions that are negative by this part of what they were cross zero at the same time. What is this part of
# their largest size in the step is zero, and so is that part of what they may be below zero.
_AT_ONCE, _ZERO, _OF_SLACK = 1e-12, 1e-14, 1e-3
# Zero of the polynomial through the samples, as a part of the step.
_POLYNOMIAL_ACCURACY = 1e-12


@kernel
def turns_negative(before, after, first, kind, apart):
    """Whether an event function does between two samples. first: these are the first ones; apart: see below."""
    # what is negative at the start counts as just having crossed
    if not after < 0.0 or before == NOTHING_THERE or (before < 0.0 and not first):
        return False
    # what has begun to slide by round-off in the other direction, and comes back, does not come to rest
    if kind == SPEED_EVENT:
        return before >= 0.0 or after < before
    # what comes from behind does not touch
    return (kind != GAP_EVENT and kind != DOMAIN_EVENT) or before >= 0.0 or apart


@kernel
def has_minimum(left, middle, right, first, last):
    """Whether there may be a lowest point below zero between three samples, the first or the last ones of a step."""
    higher = max(left, right)
    # a parabola's minimum is no deeper than half the change between samples; infinite values compare
    if 0.0 <= middle <= min(left, right) and middle < higher:
        return 1.5 * middle < 0.5 * higher
    # one that lies between the first two samples, or the last two, has its lowest one at an end of the step
    if first and 0.0 <= left < middle and 1.5 * left < 0.5 * higher:
        return True
    return last and 0.0 <= right < middle and 1.5 * right < 0.5 * higher


_SAMPLES, _PLACES = REAL[:, :, ::1], INTEGER[:, ::1]


@array_entry(_SAMPLES, BOOLEAN[::1], _PLACES)
def find_crossings(samples, apart, found):
    """Event functions (items, EVENTS_PER_CONTACT) that turn negative between two of n samples (n, items, ...): rows of
    the first one's place, the item and the kind, in order, into found; how many. apart (nc,): contacts whose gaps are
    known to have been positive."""
    count = 0
    for i in range(samples.shape[0] - 1):
        for c in range(samples.shape[1]):
            for kind in range(samples.shape[2]):
                # ways of joints, behind the contacts, come from nowhere
                known = c >= apart.shape[0] or apart[c]
                if turns_negative(samples[i, c, kind], samples[i + 1, c, kind], i == 0, kind, known):
                    found[count, 0], found[count, 1], found[count, 2] = i, c, kind
                    count += 1
    return count


@array_entry(_SAMPLES, _PLACES)
def find_minima(samples, found):
    """The same for those that may have been below zero between three samples, of which the first one's place is
    found."""
    count, n = 0, samples.shape[0]
    for i in range(n - 2):
        for c in range(samples.shape[1]):
            for kind in range(samples.shape[2]):
                left, middle, right = samples[i, c, kind], samples[i + 1, c, kind], samples[i + 2, c, kind]
                if has_minimum(left, middle, right, i == 0, i == n - 3):
                    found[count, 0], found[count, 1], found[count, 2] = i, c, kind
                    count += 1
    return count


# ---------------------------------------------------------------- along a step


@kernel
def _look(system, t, h, share, row):
    """Event functions plus slack at a share of the step, into a row of the scan."""
    load_interpolated(system, share)
    system.scan_shares[row], system.scan_status[row] = share, evaluate(system, t + share * h, 0)
    _take(system, system.event_functions, row)


@kernel
def _take(system, event_functions, row):
    """Event functions plus slack into a row of the scan; NaN where there are none."""
    unknown = math.nan if system.scan_status[row] > EVENT else 0.0
    for c in range(count_items(system)):
        for kind in range(EVENTS_PER_CONTACT):
            system.scan_event_functions[row, c, kind] = event_functions[c, kind] + system.slack[c, kind] + unknown


@separate_kernel(INTEGER, SYSTEM.type, REAL, REAL)
def scan_on(system, t, h):
    """Event functions at SCAN_SHARES of the step from t of size h that was interpolated last, behind the SCAN_COUNT
    samples that there are, to which it adds: to the end, or one sample behind a sign change. What it has met: CROSSES,
    MINIMUM and ENDS in one number."""
    counters, shares, samples = system.counters, system.scan_shares, system.scan_event_functions
    met, last, i = 0, SCAN_ROOM, counters.scan_count
    while i < last:
        if shares[0] == 0.0 and (i == 0 or shares[i] == 1.0):
            # the step's first or last stage, whose forces are chosen alike
            system.scan_status[i] = OK
            _take(system, samples[SCAN_ROOM + (0 if i == 0 else system.sizes.nstages)], i)
        elif i == 0:
            # where forces have been chosen anew, in the last evaluation
            system.scan_status[0] = OK
            _take(system, system.event_functions, 0)
        else:
            _look(system, t, h, shares[i], i)
        if system.scan_status[i] > EVENT:
            return met | ENDS | (MINIMUM if i > 2 and _meets_minimum(system, i - 3, True) else 0)
        i += 1
        counters.scan_count = i
        if met & CROSSES == 0 and i > 1 and _meets_crossing(system, i - 2):
            met |= CROSSES
            last = min(i + 1, SCAN_ROOM)
        if i > 2 and _meets_minimum(system, i - 3, i == SCAN_ROOM):
            met |= MINIMUM
    return met | ENDS if i == SCAN_ROOM else met


@kernel
def _meets_crossing(system, i):
    """Whether any event function turns negative between samples i and i + 1."""
    before, after = system.scan_event_functions[i], system.scan_event_functions[i + 1]
    for c in range(count_items(system)):
        for kind in range(EVENTS_PER_CONTACT):
            if turns_negative(before[c, kind], after[c, kind], i == 0, kind, True):
                return True
    return False


@kernel
def _meets_minimum(system, i, last):
    """Whether any event function may have been below zero between samples i and i + 2."""
    samples = system.scan_event_functions
    for c in range(count_items(system)):
        for kind in range(EVENTS_PER_CONTACT):
            left, middle, right = samples[i, c, kind], samples[i + 1, c, kind], samples[i + 2, c, kind]
            if has_minimum(left, middle, right, i == 0, last):
                return True
    return False


@separate_kernel(NOTHING, SYSTEM.type, REAL, REAL)
def look(system, t, h):
    """Event functions at one share of the step: see `RunSystem.look`."""
    _look(system, t, h, system.scan_shares[LOOK_ROW], LOOK_ROW)


# ---------------------------------------------------------------- between two samples


@kernel
def _sought(system, t, h, share, c, kind):
    """The event function whose zero is sought; where it cannot be evaluated is beyond the zero."""
    _look(system, t, h, share, LOOK_ROW)
    if system.scan_status[LOOK_ROW] > EVENT:
        return -1.0
    return system.scan_event_functions[LOOK_ROW, c, kind]


@separate_kernel(NOTHING, SYSTEM.type, REAL, REAL, INTEGER, INTEGER)
def find_zero(system, t, h, c, kind):
    """Where an event function of item c turns negative between the samples LEFT_ROW and RIGHT_ROW, or as near before or
    behind it as is told apart: into LOOK_ROW, which is the last evaluation."""
    shares, bracket = system.scan_shares, system.brackets[0]
    low, before = shares[LEFT_ROW], system.scan_event_functions[LEFT_ROW, c, kind]
    high, after = shares[RIGHT_ROW], system.scan_event_functions[RIGHT_ROW, c, kind]
    for _ in range(_BISECTIONS):
        if before > 0.0:
            break
        # the mode was entered on its boundary: look for the part where it holds first
        share = low + 0.5 * (high - low)
        value = _sought(system, t, h, share, c, kind)
        if value > 0.0:
            low, before = share, value
        else:
            high, after = share, value
    found = low
    if before > 0.0:
        least = _next_to_zero(system, c, kind)
        begin_bracket(bracket, low, before)
        share = narrow(bracket, high, after, ACCURACY)
        foreseen = _zero_of_polynomial(system, c, kind, low, high)
        if low < foreseen < high:
            share = foreseen
        for _ in range(LOOKS_FOR_ZERO):
            if math.isnan(share):
                break
            value = _sought(system, t, h, share, c, kind)
            share = narrow(bracket, share, value, ACCURACY)
            if abs(value) <= least:
                break
        found = zero_in(bracket)
    if shares[LOOK_ROW] != found:
        _look(system, t, h, found, LOOK_ROW)


@kernel
def _next_to_zero(system, c, kind):
    """What is zero in an event function, as far as it is known."""
    size = max(abs(system.lowest[c, kind]), abs(system.highest[c, kind]))
    return max(_OF_SLACK * system.slack[c, kind], _ZERO * size if size < NOTHING_THERE else 0.0)


@kernel
def _zero_of_polynomial(system, c, kind, low, high):
    """A zero between two shares of the polynomial through all samples of an event function; NaN where it has none, or
    there are infinite ones."""
    shares, samples, n = system.scan_shares, system.scan_event_functions, system.counters.scan_count
    bracket, terms = system.brackets[1], system.brackets[2]
    for i in range(n):
        terms[i] = samples[i, c, kind]
        if not abs(terms[i]) < HUGE:
            return math.nan
    # divided differences (Newton)
    for k in range(1, n):
        for i in range(n - 1, k - 1, -1):
            terms[i] = (terms[i] - terms[i - 1]) / (shares[i] - shares[i - k])
    before, after = _polynomial(shares, terms, n, low), _polynomial(shares, terms, n, high)
    if not (before > 0.0 > after):
        return math.nan
    begin_bracket(bracket, low, before)
    share = narrow(bracket, high, after, _POLYNOMIAL_ACCURACY)
    for _ in range(LOOKS_FOR_ZERO):
        if math.isnan(share):
            break
        share = narrow(bracket, share, _polynomial(shares, terms, n, share), _POLYNOMIAL_ACCURACY)
    return zero_in(bracket)


@kernel
def _polynomial(shares, terms, n, share):
    value = 0.0
    for i in range(n - 1, -1, -1):
        value = value * (share - shares[i]) + terms[i]
    return value


@separate_kernel(INTEGER, SYSTEM.type, REAL, REAL)
def find_earliest(system, t, h):
    """The first of the event functions SOUGHT, which turn negative between the samples LEFT_ROW and RIGHT_ROW: its
    number, item times EVENTS_PER_CONTACT plus kind, and its zero in RIGHT_ROW.

    The zero of one is the next sample on the right, at which most others are seen to cross later, and some to have been
    negative in between.
    """
    shares, samples, sought, n = system.scan_shares, system.scan_event_functions, system.sought, count_items(system)
    left, right, found, count = samples[LEFT_ROW], samples[RIGHT_ROW], -1, 0
    for c in range(n):
        for kind in range(EVENTS_PER_CONTACT):
            count += sought[c, kind] >= 0.0
    for _ in range(count + _ROUNDS):
        # the one that is first on straight lines
        first, number = math.inf, -1
        for c in range(n):
            for kind in range(EVENTS_PER_CONTACT):
                if sought[c, kind] >= 0.0:
                    share = _zero_between(left[c, kind], right[c, kind])
                    if share < first:
                        first, number = share, c * EVENTS_PER_CONTACT + kind
        if number < 0:
            break
        item, what = number // EVENTS_PER_CONTACT, number % EVENTS_PER_CONTACT
        if sought[item, what] <= 1.0:
            _look(system, t, h, sought[item, what], LOOK_ROW)
        else:
            find_zero(system, t, h, item, what)
        if found >= 0 and shares[LOOK_ROW] >= shares[RIGHT_ROW]:
            break
        found = number
        _keep_right(system, n)
        for c in range(n):
            for kind in range(EVENTS_PER_CONTACT):
                if sought[c, kind] != LEFT_OUT:
                    # what has come down to that is zero there, too, as far as zeros are told apart
                    before = left[c, kind]
                    at_once = max(_AT_ONCE * before if before < NOTHING_THERE else 0.0, _next_to_zero(system, c, kind))
                    crosses = 0.0 < before != NOTHING_THERE and right[c, kind] < -at_once
                    sought[c, kind] = UNKNOWN if crosses else NOT_SOUGHT
        sought[item, what] = NOT_SOUGHT
    return found


@kernel
def _keep_right(system, n):
    """The last look is the sample on the right."""
    samples = system.scan_event_functions
    system.scan_shares[RIGHT_ROW], system.scan_status[RIGHT_ROW] = system.scan_shares[LOOK_ROW], OK
    for c in range(n):
        for kind in range(EVENTS_PER_CONTACT):
            samples[RIGHT_ROW, c, kind] = samples[LOOK_ROW, c, kind]


@kernel
def _zero_between(before, after):
    """Where the straight line between two values at 0 and 1 is zero; 1 where they are infinite or the same."""
    change = before - after
    share = before / change if change != 0.0 else math.inf
    return share if share < math.inf else 1.0
