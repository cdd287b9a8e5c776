"""From a formula to numbers that the kernels read: a tape where it can be traced, else a fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from ..errors import ContourError
from . import tape as ops
from .base import Contour, F
from .branches import Survey, names, place, survey
from .fits import fit
from .formula import REACH, Formula, spread, trials
from .piecewise import fitted
from .trace import ROWS, Program

# A traced formula repeats the user's operations up to rounding; more than this is another function.
_AGREEMENT = 1e-9
# A closed formula meets itself up to the rounding of the ends of its domain, which are multiples of pi with ten digits
# at least; derivatives multiply that by the order of the highest harmonic.
_SEAM = (1e-9, 1e-8, 1e-8)
_SEAM_ROUNDING = 1e-13
# At so many values of the other parameter and times a seam is looked at.
_SEAM_POINTS = 800
# Derivatives given by the user: wrong ones are wrong by far more, and a fit's second derivatives are this good.
_DERIVATIVE_AGREEMENT = 1e-6


def compiled(
    formula: Formula,
    domain: Sequence[tuple[float, float]],
    periodic: Sequence[bool],
    derivatives: Callable[..., Any] | None = None,
    time_domain: tuple[float, float] | None = None,
) -> Program:
    """Trace the formula or, where that is not possible, fit it; then compare the result with it.

    Raises ContourError where the result and the formula disagree, or where neither way is open.
    """
    if derivatives is not None and not callable(derivatives):
        raise ContourError(f"{formula.owner}: derivatives must be a function, got {derivatives!r}")
    for axis, (low, high) in enumerate(domain):
        if periodic[axis] and not (math.isfinite(low) and math.isfinite(high)):
            raise ContourError(f"{formula.owner}: periodic, but the domain ({low}, {high}) is infinite")
    timed = [(0.0, REACH) if time_domain is None else time_domain] if formula.takes_time else []
    box = [*domain, *timed]
    points = trials(box)
    expected = np.array([formula(*point.tolist()) for point in points])
    known = survey(formula, box, time_domain is None)
    if known.tape is None:
        program = _fitted(formula, box, periodic, derivatives, time_domain, known)
    else:
        program = known.tape
        pool = program.pool
        if program.time_dependent:
            pool[ops.TIMES : ops.TIMES + 2] = known.times
        for axis, wraps in enumerate(periodic):
            if wraps:
                pool[ops.PERIODS + 2 * axis : ops.PERIODS + 2 * axis + 2] = domain[axis]
        _check_seams(formula, program, domain, periodic, points)
    program.times = tuple(timed) if program.time_dependent else ()
    contour = Contour(program.evaluator, formula.parameters, pool=program.pool)
    k = formula.parameters
    found = np.array([contour.evaluate(point[:k], *point[k:])[:, : formula.outputs] for point in points])
    size = max(np.abs(expected).max(), 1e-300)
    _compare(formula.owner, "f", points, found[:, [F]], expected[:, None], _AGREEMENT * size)
    if derivatives is not None:
        given = np.array([formula.derivatives(derivatives, *point.tolist()) for point in points])
        rows, size = list(ROWS[formula.variables][1:]), max(size, np.abs(given).max())
        _compare(formula.owner, "a derivative", points, found[:, rows], given, _DERIVATIVE_AGREEMENT * size)
    return program


def _fitted(
    formula: Formula,
    box: Sequence[tuple[float, float]],
    periodic: Sequence[bool],
    derivatives: Callable[..., Any] | None,
    time_domain: tuple[float, float] | None,
    known: Survey,
) -> Program:
    """box: (low, high) of each argument, that of time last."""
    timed, failed = formula.takes_time, f"{formula.owner}: tracing f failed: {known.reason}"
    if timed and formula.parameters == 2:
        raise ContourError(f"{failed}; a surface that depends on time must be made of elementary functions")
    if timed and (time_domain is None or not np.isfinite(time_domain).all()):
        raise ContourError(
            f"{failed}; write it with elementary functions, or give time_domain=(first, last) so that it can be fitted"
        )
    if not np.isfinite(box).all():
        raise ContourError(f"{failed}; it can be fitted on a finite domain only, got {box[: formula.parameters]}")
    second = None if derivatives is None else partial(formula.derivatives, derivatives)
    closed = [*periodic, False][: len(box)]
    result = fit(formula.owner, formula, box, closed, second, timed, known.breaks, known.places)
    return Program(fitted, result.pool, timed, result.constants, result.error)


def _compare(
    owner: str, what: str, points: np.ndarray, found: np.ndarray, expected: np.ndarray, tolerance: float
) -> None:
    """ContourError naming both numbers if they differ by more than the tolerance somewhere."""
    difference = np.nan_to_num(np.abs(found - expected), nan=np.inf)
    if difference.max() > tolerance:
        worst = np.unravel_index(int(np.argmax(difference)), difference.shape)
        raise ContourError(
            f"{owner}: {what} at ({', '.join(f'{number:.6g}' for number in points[worst[0]])}): the formula as "
            f"compiled gives {float(found[worst])!r}, the user's function {float(expected[worst])!r} "
            f"(entry {[int(i) for i in worst[1:]]})"
        )


def _check_seams(
    formula: Formula,
    program: Program,
    domain: Sequence[tuple[float, float]],
    periodic: Sequence[bool],
    points: np.ndarray,
) -> None:
    """ContourError unless both ends of periodic parameters are the same in value and first and second derivatives.

    These are what the dynamics use: those by the parameters, by time and mixed ones.
    """
    k = formula.parameters
    contour = Contour(program.evaluator, k, pool=program.pool)
    rows, variables = list(ROWS[formula.variables]), range(len(formula.variables))
    orders = [(), *((i,) for i in variables), *((i, j) for i in variables for j in variables if i <= j)]
    samples = np.array([contour.evaluate(point[:k], *point[k:])[rows] for point in points])
    extent, far = np.ptp(samples[:, 0], axis=0).max(), np.abs(samples[:, 0]).max()
    low, high = points.min(axis=0), points.max(axis=0)
    spans = high - low
    for axis, ends in enumerate(domain):
        if np.isfinite(ends).all():
            low[axis], high[axis] = ends
    along = spread(low, high, _SEAM_POINTS if len(variables) > 1 else 1)
    for axis, point in product([axis for axis, wraps in enumerate(periodic) if wraps], along):
        values = []
        for end in domain[axis]:
            at = np.where(np.arange(len(point)) == axis, end, point)
            values.append(contour.evaluate(at[:k], *at[k:])[rows])
        for row, order in enumerate(orders):
            per = math.prod(float(spans[i]) for i in order)
            size = np.abs(samples[:, row]).max() + extent / per
            allowed = _SEAM[len(order)] * size + _SEAM_ROUNDING * far / per
            if not np.abs(values[0][row] - values[1][row]).max() <= allowed:
                by = " and ".join(names(formula.variables)[i] for i in order)
                raise ContourError(
                    f"{formula.owner}: periodic in parameter {axis}, but "
                    f"{f'the derivative of f by {by}' if order else 'f'} is {values[0][row].tolist()} at "
                    f"{domain[axis][0]} and {values[1][row].tolist()} at {domain[axis][1]} "
                    f"(seen at {place(formula.variables, at)})"
                )
