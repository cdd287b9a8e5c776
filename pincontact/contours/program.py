"""From a formula to numbers that the kernels read: a tape where it can be traced, else a fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import ContourError
from . import tape as ops
from .base import Contour, F
from .branches import Survey, names, place, survey
from .fits import fit
from .formula import REACH, Formula, trials
from .piecewise import fitted
from .tape import traced
from .trace import ROWS

# A traced formula repeats the user's operations up to rounding; more than this is another function.
_AGREEMENT = 1e-9
# A closed formula meets itself up to the rounding of the ends of its domain, which are multiples of pi with ten digits
# at least; derivatives multiply that by the order of the highest harmonic.
_SEAM = (1e-9, 1e-8, 1e-8)
_SEAM_ROUNDING = 1e-13
# Where a seam is looked at: so many values of the other parameter, and so many times.
_SEAM_POINTS = 97
_SEAM_TIMES = 8
# Neighbouring values of the other parameter are looked at by these parts of a step later, so that no lattice is left.
_SEAM_STAGGER = (0.0, 0.3, 0.6)
# Derivatives given by the user: wrong ones are wrong by far more, and a fit's second derivatives are this good.
_DERIVATIVE_AGREEMENT = 1e-6


@dataclass
class Program:
    """What became of a formula.

    evaluator:       kernel of the contour that evaluates it
    time_dependent:  t occurs in it
    constants:       for each output its value if it depends on no variable, else None
    error:           of the fit in the formula's unit, 0 for a tape
    times:           (first, last) time in s at which it is tried; none where t does not occur
    """

    evaluator: Any
    pool: np.ndarray
    time_dependent: bool
    constants: tuple[float | None, ...]
    error: float
    times: tuple[tuple[float, float], ...] = ()


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
        pool = known.tape.pool
        if known.tape.time_dependent:
            pool[ops.TIMES : ops.TIMES + 2] = known.times
        for axis, wraps in enumerate(periodic):
            if wraps:
                pool[ops.PERIODS + 2 * axis : ops.PERIODS + 2 * axis + 2] = domain[axis]
        program = Program(traced, pool, known.tape.time_dependent, known.tape.constants, 0.0)
        _check_seams(formula, program, domain, periodic, points)
    program.times = tuple(timed) if program.time_dependent else ()
    contour = Contour(program.evaluator, formula.parameters, pool=program.pool)
    for point, value in zip(points, expected):
        time = float(point[-1]) if formula.takes_time else 0.0
        found = contour.evaluate(point[: formula.parameters], time)[:, : formula.outputs]
        shown = ", ".join(f"{number:.6g}" for number in point)
        _compare(formula.owner, f"f({shown})", found[F], value, np.abs(expected).max(), _AGREEMENT)
        if derivatives is not None:
            given = formula.derivatives(derivatives, *point.tolist())
            rows = list(ROWS[formula.variables][1:])
            size = max(np.abs(given).max(), np.abs(expected).max())
            _compare(formula.owner, f"a derivative at ({shown})", found[rows], given, size, _DERIVATIVE_AGREEMENT)
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
    timed = formula.takes_time
    if timed and formula.parameters == 2:
        raise ContourError(
            f"{formula.owner}: a surface that depends on time must be made of elementary functions, "
            f"but tracing it failed: {known.reason}"
        )
    if timed and (time_domain is None or not np.isfinite(time_domain).all()):
        raise ContourError(
            f"{formula.owner}: tracing f(u, t) failed: {known.reason}; write it with elementary functions, or give "
            "time_domain=(first, last) so that it can be fitted"
        )
    if not np.isfinite(box).all():
        raise ContourError(
            f"{formula.owner}: tracing f failed: {known.reason}; it can be fitted on a finite domain only, got "
            f"{box[: formula.parameters]}"
        )
    second = None
    if derivatives is not None:
        given = derivatives

        def second(*arguments: float) -> np.ndarray:
            return formula.derivatives(given, *arguments)

    closed = [*periodic, False][: len(box)]
    result = fit(formula.owner, formula, box, closed, second, timed, known.breaks, known.places)
    return Program(fitted, result.pool, timed, (None,) * formula.outputs, result.error)


def _compare(owner: str, what: str, found: np.ndarray, expected: np.ndarray, size: float, tolerance: float) -> None:
    """ContourError naming both numbers if they differ by more than `tolerance` of `size`."""
    difference = np.abs(found - expected)
    if not (difference <= tolerance * max(size, 1e-300)).all():
        worst = np.unravel_index(int(np.argmax(np.nan_to_num(difference, nan=np.inf))), difference.shape)
        raise ContourError(
            f"{owner}: {what}: the formula as compiled gives {float(found[worst])!r}, the user's function "
            f"{float(expected[worst])!r} (entry {[int(i) for i in worst]})"
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
    contour = Contour(program.evaluator, formula.parameters, pool=program.pool)
    timed = formula.takes_time
    spans = np.ptp(points, axis=0)
    rows = list(ROWS[formula.variables])
    variables = range(len(formula.variables))
    orders = [(), *((i,) for i in variables), *((i, j) for i in variables for j in variables if i <= j)]

    def evaluated(point: np.ndarray) -> np.ndarray:
        return contour.evaluate(point[: formula.parameters].tolist(), float(point[-1]) if timed else 0.0)[rows]

    samples = np.array([evaluated(point) for point in points])
    extent, far = np.ptp(samples[:, 0], axis=0).max(), np.abs(samples[:, 0]).max()
    for axis, wraps in enumerate(periodic):
        if not wraps:
            continue
        low, high = domain[axis]
        for point in _seam(formula, domain, axis, points):
            ends = []
            for end in (low, high):
                point[axis] = end
                ends.append(evaluated(point))
            for row, order in enumerate(orders):
                per = math.prod(float(spans[i]) for i in order)
                size = np.abs(samples[:, row]).max() + extent / per
                allowed = _SEAM[len(order)] * size + _SEAM_ROUNDING * far / per
                if not np.abs(ends[0][row] - ends[1][row]).max() <= allowed:
                    by = " and ".join(names(formula.variables)[i] for i in order)
                    raise ContourError(
                        f"{formula.owner}: periodic in parameter {axis}, but "
                        f"{f'the derivative of f by {by}' if order else 'f'} is {ends[0][row].tolist()} at {low} and "
                        f"{ends[1][row].tolist()} at {high} (seen at {place(formula.variables, point)})"
                    )


def _seam(
    formula: Formula, domain: Sequence[tuple[float, float]], axis: int, points: np.ndarray
) -> Iterator[np.ndarray]:
    """Points along the seam of a parameter: other parameters all over their domain, and times all over theirs."""
    count = _SEAM_POINTS if formula.parameters == 2 else 1
    low, high = points.min(axis=0), points.max(axis=0)
    for i in range(count):
        for j in range(_SEAM_TIMES if formula.takes_time else 1):
            point = low.copy()
            if formula.parameters == 2:
                point[1 - axis] += (high - low)[1 - axis] * i / (count - 1)
                a, b = domain[1 - axis]
                if np.isfinite(domain[1 - axis]).all():
                    point[1 - axis] = a + (b - a) * i / (count - 1)
            if formula.takes_time:
                point[-1] += (high - low)[-1] * (j + _SEAM_STAGGER[i % 3]) / (_SEAM_TIMES - 1)
            yield point
