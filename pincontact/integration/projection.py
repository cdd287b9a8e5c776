"""Projection of a state on the constraints, in the mass metric."""

from __future__ import annotations

import math

from ..callback import separate_kernel
from ..dynamics.evaluation import PLACES_OF_ALL, PLACES_OF_CLOSED, contact_corrections
from ..dynamics.passing_slip import EXPLAINED
from ..dynamics.resistance import count_items
from ..jit import BOOLEAN, INTEGER, REAL, kernel
from ..layout import EVENT, LOCATION_FAILED, OK, SYSTEM
from .results import CLOSED_APART, CONTRADICTION
from .stages import correct_state, evaluate, keep_places

# Corrections at most; they fall quadratically, from a start that is not on its constraints, too.
_PROJECTIONS = 12
# What a state is projected for.
TO_KEEP, TO_STEP_ON, TO_SHOW = range(3)
# Changes of q and v by less than this part of the tolerance leave accelerations what they are.
_CLOSE = 1e-1
# A change of q below this needs no further evaluation: what it leaves in gaps and v_c is quadratic, or below round-off.
_NEGLIGIBLE = 1e-14
# Residual (m, and m/s relative to the speeds) below which nothing is corrected.
_ROUND_OFF = 1e-16
# Corrections of q (m or rad) that are no corrections.
_LARGEST_CORRECTION = 1e3
# What redundant constraints may leave of velocities, relative to the largest or 1, and, of corrections of q (rad or m),
# times so much more.
CONTRADICTING, _OF_CORRECTION = 1e-5, 1e2
# What a projection may change q and v by, in the step's errors, or relative to them, whichever is more: no error of a
# step is larger, not even where a contour is smooth between its knots only.
_LEAST_EXPLAINED = 1e-6
# Gap in m that it may leave where corrections do not get small.
_PROJECTED_GAP = 1e-11

# Of `project_places`: a correction of q below the first of these leaves gaps of its square, and needs no further
# evaluation; nor does one after which Newton's method, whose corrections are as the squares of those before, has the
# next one below the other.
_SMALL_CORRECTION, _FORETOLD_CORRECTION = 1e-7, 1e-12
_PLACE_PROJECTIONS = 6
# Gaps in m that it may leave where corrections do not get that small.
_LEFT_GAP = 1e-7


@kernel
def _contradicts(system):
    """Whether the last correction leaves velocities that it was to take away, since constraints contradict each other:
    those of rigid geometry do by errors of the configuration only, that is by no more than its own correction."""
    scalars, v = system.scalars, system.v
    if scalars.velocity_left == 0.0:
        return False
    fastest = 1.0
    for k in range(v.shape[0]):
        fastest = max(fastest, abs(v[k]))
    return scalars.velocity_left > (CONTRADICTING + _OF_CORRECTION * scalars.correction_size) * fastest


@separate_kernel(INTEGER, SYSTEM.type, REAL, BOOLEAN, INTEGER, REAL)
def project(system, t, evaluated, purpose, error):
    """Put (q, v) and the contact coordinates of STAGE_STATE on the constraints, in the mass metric; a status.

    No gain to tune and no drift: Newton's iteration on the gaps with the factors of the last evaluation, and the exact
    linear projection of the velocity. The order of the integrator is kept, since the correction is of the size of its
    local error. Afterwards the accelerations are those of a state that differs by next to nothing.
    evaluated: the system has just been evaluated at that state, which saves one evaluation.
    purpose: TO_STEP_ON leaves constraints that are off by the square of a small part of the tolerance, and TO_SHOW the
    accelerations of another state; TO_KEEP is for states that are both shown and gone on from.
    error: norm of the error of the step that led here, infinite where that is not known. It is what the change has to
    be explained by: what takes more from q and v is a failure.
    """
    sizes, scalars, q = system.sizes, system.scalars, system.q
    beyond = count_items(system) - sizes.nc
    if sizes.nc + beyond == 0:
        status = OK if evaluated or purpose == TO_SHOW else evaluate(system, t, 0)
        return status if status > EVENT else OK
    # forces of limited joints and resistances are shown with the state, and redundant ones are those of its loads
    part = PLACES_OF_CLOSED if purpose == TO_SHOW and beyond == 0 and scalars.has_reference == 0.0 else 0
    for i in range(_PROJECTIONS):
        if i > 0 or not evaluated:
            status = evaluate(system, t, part)
            if status > EVENT:
                return status
        count = contact_corrections(system)
        if count == 0 or (scalars.gap_residual <= _ROUND_OFF and scalars.velocity_residual <= _ROUND_OFF):
            keep_places(system)
            return OK
        change = correct_state(system)
        if _contradicts(system):
            return CONTRADICTION
        explained = max(EXPLAINED, _LEAST_EXPLAINED / system.scale[0]) * max(error, 1.0) if error < math.inf else error
        if change > explained:
            return LOCATION_FAILED
        close = change <= _CLOSE
        size, largest = scalars.correction_size, 1.0
        for k in range(sizes.nq):
            largest = max(largest, abs(q[k]))
        if size <= _NEGLIGIBLE * largest or (close and purpose == TO_STEP_ON):
            return OK
        if not size < _LARGEST_CORRECTION:
            break
        if close and beyond == 0:
            part = PLACES_OF_CLOSED
    return OK if scalars.gap_residual < _PROJECTED_GAP else LOCATION_FAILED


@separate_kernel(INTEGER, SYSTEM.type, REAL)
def project_places(system, t):
    """Kinematics of STAGE_STATE, which is put on the constraints with whatever factor there is; a status.

    For a method that needs no accelerations; open contacts are evaluated too.
    """
    last = 0.0
    for _ in range(_PLACE_PROJECTIONS):
        status = evaluate(system, t, PLACES_OF_ALL)
        if status != OK:
            return status
        contact_corrections(system)
        correct_state(system)
        if _contradicts(system):
            return CONTRADICTION
        size = system.scalars.correction_size
        if size <= _SMALL_CORRECTION or size * size * size <= _FORETOLD_CORRECTION * last * last:
            return OK
        last = size
    return OK if system.scalars.gap_residual < _LEFT_GAP else CLOSED_APART
