"""From a user's callable to numbers that the kernels read: a tape where it can be traced, else a fit."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import ContourError
from .base import SPLINE_CURVE, SPLINE_SURFACE, TAPE_CURVE, TAPE_SURFACE, Contour, F
from .fits import fit
from .trace import ROWS, Untraceable, trace

# How many parameter values a formula is tried at, and how far along an infinite domain and in time.
_TRIALS = 25
_REACH = 3.0
# A traced formula repeats the user's operations up to rounding; more than this is another function.
_AGREEMENT = 1e-9
# Derivatives given by the user: wrong ones are wrong by far more, and a fit's second derivatives are this good.
_DERIVATIVE_AGREEMENT = 1e-6


class Formula:
    """A user's callable, checked: its number of parameters, finite values of the right length.

    owner:       who asks, for messages
    parameters:  of the contour; the callable may take t after them
    outputs:     how many numbers it returns
    """

    def __init__(self, owner: str, function: Callable[..., Any], parameters: int, outputs: int = 3) -> None:
        if not callable(function):
            raise ContourError(f"{owner}: a function is needed, got {function!r}")
        self.owner = owner
        self.function = function
        self.parameters = parameters
        self.outputs = outputs
        self.takes_time = takes_time(owner, function, parameters)

    @property
    def variables(self) -> str:
        """The arguments as `trace` names them."""
        return ("u" if self.parameters == 1 else "uv") + ("t" if self.takes_time else "")

    def __call__(self, *arguments: float) -> np.ndarray:
        return self._checked(self.function, arguments, "function", (self.outputs,))

    def derivatives(self, given: Callable[..., Any], *arguments: float) -> np.ndarray:
        """All first, then all second derivatives by the arguments, as the user's second callable gives them."""
        n = len(arguments)
        return self._checked(given, arguments, "derivatives", (n + n * (n + 1) // 2, self.outputs))

    def _checked(
        self, function: Callable[..., Any], arguments: tuple[float, ...], what: str, shape: tuple[int, ...]
    ) -> np.ndarray:
        shown = ", ".join(f"{value:.6g}" for value in arguments)
        try:
            result = np.asarray(function(*arguments), dtype=float)
        except Exception as error:
            raise ContourError(f"{self.owner}: {what} raised {error!r} at ({shown})") from error
        if result.size != math.prod(shape):
            raise ContourError(
                f"{self.owner}: {what} must return {' x '.join(map(str, shape))} numbers, "
                f"at ({shown}) there are {result.size}"
            )
        if not np.isfinite(result).all():
            raise ContourError(f"{self.owner}: {what} is not finite at ({shown}): {result.tolist()}")
        return result.reshape(shape)


def takes_time(owner: str, function: Callable[..., Any], parameters: int) -> bool:
    """Whether the function has one more argument, t, than the contour has parameters."""
    try:
        arguments = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):  # some compiled callables have no signature
        return False
    positional = [a for a in arguments if a.kind in (a.POSITIONAL_ONLY, a.POSITIONAL_OR_KEYWORD)]
    needed = [a for a in positional if a.default is a.empty]
    if any(a.kind is a.VAR_POSITIONAL for a in arguments):
        return False
    if len(needed) == parameters + 1 or (
        len(positional) > parameters >= len(needed) and positional[parameters].name == "t"
    ):
        return True
    if len(needed) > parameters or len(positional) < parameters:
        raise ContourError(
            f"{owner}: the function must take {parameters} arguments, or {parameters + 1} with time; "
            f"it takes {len(needed)}"
        )
    return False


def trials(domain: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Reproducible random values (n, k) of parameters in the domain, and of the time (n,)."""
    low = [a if math.isfinite(a) else (b - _REACH if math.isfinite(b) else -_REACH) for a, b in domain]
    high = [b if math.isfinite(b) else (a + _REACH if math.isfinite(a) else _REACH) for a, b in domain]
    generator = np.random.default_rng(20240229)
    u = np.array(low) + (np.array(high) - np.array(low)) * generator.random((_TRIALS, len(domain)))
    return u, _REACH * generator.random(_TRIALS)


@dataclass
class Program:
    """What became of a formula.

    kind:            of the contour that evaluates it
    time_dependent:  t occurs in it
    constants:       for each output its value if it depends on no variable, else None
    error:           of the fit in the formula's unit, 0 for a tape
    """

    kind: int
    pool: np.ndarray
    time_dependent: bool
    constants: tuple[float | None, ...]
    error: float


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
    surface = formula.parameters == 2
    u, times = trials(domain)
    if time_domain is not None:
        times = time_domain[0] + (time_domain[1] - time_domain[0]) * times / _REACH
    points = np.column_stack([u, times]) if formula.takes_time else u
    expected = np.array([formula(*point.tolist()) for point in points])
    kinks: tuple[int, ...] = ()
    try:
        tape = trace(formula.function, formula.variables, formula.outputs)
        kind = TAPE_SURFACE if surface else TAPE_CURVE
        program = Program(kind, tape.pool, tape.time_dependent, tape.constants, 0.0)
        kinks = tape.kinks
    except Untraceable as reason:
        program = _fitted(formula, domain, periodic, derivatives, time_domain, str(reason))
    contour = Contour(program.kind, formula.parameters, pool=program.pool)
    signs = np.zeros(len(kinks))
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
        for i, slot in enumerate(kinks):
            sign = math.copysign(1.0, program.pool[slot])
            if signs[i] * sign < 0.0:
                raise ContourError(
                    f"{formula.owner}: not smooth: f takes the absolute value of a quantity whose sign at "
                    f"({shown}) is not the one elsewhere in the domain"
                )
            signs[i] = sign
    _check_periodic(formula, domain, periodic, u, np.abs(expected).max())
    return program


def _fitted(
    formula: Formula,
    domain: Sequence[tuple[float, float]],
    periodic: Sequence[bool],
    derivatives: Callable[..., Any] | None,
    time_domain: tuple[float, float] | None,
    reason: str,
) -> Program:
    timed = formula.takes_time
    if timed and formula.parameters == 2:
        raise ContourError(
            f"{formula.owner}: a surface that depends on time must be made of elementary functions, "
            f"but tracing it failed: {reason}"
        )
    if timed and time_domain is None:
        raise ContourError(
            f"{formula.owner}: tracing f(u, t) failed: {reason}; write it with elementary functions, or give "
            "time_domain=(first, last) so that it can be fitted"
        )
    box = [*domain, time_domain] if timed and time_domain is not None else list(domain)
    if not np.isfinite(box).all():
        raise ContourError(
            f"{formula.owner}: tracing f failed: {reason}; it can be fitted on a finite domain only, got {box}"
        )
    second = None
    if derivatives is not None:
        given = derivatives

        def second(*arguments: float) -> np.ndarray:
            return formula.derivatives(given, *arguments)

    result = fit(formula.owner, formula, box, [*periodic, False][: len(box)], second, timed)
    kind = SPLINE_SURFACE if formula.parameters == 2 else SPLINE_CURVE
    return Program(kind, result.pool, timed, (None,) * formula.outputs, result.error)


def _compare(owner: str, what: str, found: np.ndarray, expected: np.ndarray, size: float, tolerance: float) -> None:
    """ContourError naming both numbers if they differ by more than `tolerance` of `size`."""
    difference = np.abs(found - expected)
    if not (difference <= tolerance * max(size, 1e-300)).all():
        worst = np.unravel_index(int(np.argmax(np.nan_to_num(difference, nan=np.inf))), difference.shape)
        raise ContourError(
            f"{owner}: {what}: the formula as compiled gives {float(found[worst])!r}, the user's function "
            f"{float(expected[worst])!r} (entry {[int(i) for i in worst]})"
        )


def _check_periodic(
    formula: Formula,
    domain: Sequence[tuple[float, float]],
    periodic: Sequence[bool],
    u: np.ndarray,
    size: float,
) -> None:
    for axis, wraps in enumerate(periodic):
        if not wraps:
            continue
        low, high = domain[axis]
        if not (math.isfinite(low) and math.isfinite(high)):
            raise ContourError(f"{formula.owner}: periodic, but the domain ({low}, {high}) is infinite")
        for point in u[:3]:
            ends = []
            for end in (low, high):
                point[axis] = end
                ends.append(formula(*point.tolist(), *([0.0] if formula.takes_time else [])))
            # Trigonometric functions of 2 pi are this close to those of zero.
            if np.abs(ends[0] - ends[1]).max() > _AGREEMENT * size:
                raise ContourError(
                    f"{formula.owner}: periodic in parameter {axis}, but f is {ends[0]} at {low} and "
                    f"{ends[1]} at {high}"
                )
