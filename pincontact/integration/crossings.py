"""Where samples of event functions show that one turns negative, or may have been between two of them."""

from __future__ import annotations

from ..arrays import view
from ..jit import BOOLEAN, INTEGER, REAL, entry_kernel, kernel
from ..layout import GAP_EVENT, NOTHING_THERE, SPEED_EVENT


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
    return kind != GAP_EVENT or before >= 0.0 or apart


@kernel
def has_valley(left, middle, right, first, last):
    """Whether there may be a lowest point below zero between three samples, the first or the last ones of a step."""
    higher = max(left, right)
    # a parabola's valley is no deeper than half the change between samples; infinite values compare
    if 0.0 <= middle <= min(left, right) and middle < higher:
        return 1.5 * middle < 0.5 * higher
    # one that lies between the first two samples, or the last two, has its lowest one at an end of the step
    if first and 0.0 <= left < middle and 1.5 * left < 0.5 * higher:
        return True
    return last and 0.0 <= right < middle and 1.5 * right < 0.5 * higher


@kernel
def _find_crossings(samples, apart, found):
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


@kernel
def _find_valleys(samples, found):
    count, n = 0, samples.shape[0]
    for i in range(n - 2):
        for c in range(samples.shape[1]):
            for kind in range(samples.shape[2]):
                left, middle, right = samples[i, c, kind], samples[i + 1, c, kind], samples[i + 2, c, kind]
                if has_valley(left, middle, right, i == 0, i == n - 3):
                    found[count, 0], found[count, 1], found[count, 2] = i, c, kind
                    count += 1
    return count


_SAMPLES, _PLACES = REAL[:, :, ::1], INTEGER[:, ::1]


@entry_kernel(_SAMPLES, BOOLEAN[::1], _PLACES)
def find_crossings(samples, apart, found):
    """Event functions (items, EVENTS_PER_CONTACT) that turn negative between two of n samples (n, items, ...): rows of
    the first one's place, the item and the kind, in order, into found; how many. apart (nc,): contacts whose gaps are
    known to have been positive."""
    return _find_crossings(view(samples), view(apart), view(found))


@entry_kernel(_SAMPLES, _PLACES)
def find_valleys(samples, found):
    """The same for those that may have been below zero between three samples, of which the first one's place is
    found."""
    return _find_valleys(view(samples), view(found))
