"""Contours from a user's formula: curves f(u) or f(u, t), surfaces f(u1, u2) or f(u1, u2, t)."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import ContourError
from .base import TAPE_CURVE, TAPE_SURFACE, Contour, interval
from .trace import Tape, Untraceable, trace

# How many parameter values a formula is tried at, and how far along an infinite domain.
_TRIALS = 25
_REACH = 3.0
# A traced formula repeats the user's operations up to rounding; more than this is another function.
_AGREEMENT = 1e-9


class _Formula:
    """A user's callable, checked: its number of parameters, finite values of the right length."""

    def __init__(self, owner: str, function: Callable[..., Any], parameters: int, outputs: int) -> None:
        if not callable(function):
            raise ContourError(f"{owner}: a function is needed, got {function!r}")
        self.owner = owner
        self.function = function
        self.parameters = parameters
        self.outputs = outputs
        self.takes_time = _takes_time(owner, function, parameters)

    def __call__(self, *arguments: float) -> np.ndarray:
        shown = ", ".join(f"{value:.6g}" for value in arguments)
        try:
            result = np.asarray(self.function(*arguments), dtype=float).reshape(-1)
        except Exception as error:
            raise ContourError(f"{self.owner}: the function raised at ({shown}): {error!r}") from error
        if result.size != self.outputs:
            raise ContourError(
                f"{self.owner}: the function must return {self.outputs} numbers, "
                f"at ({shown}) it returned {result.size}"
            )
        if not np.isfinite(result).all():
            raise ContourError(f"{self.owner}: the function is not finite at ({shown}): {result}")
        return result


def _takes_time(owner: str, function: Callable[..., Any], parameters: int) -> bool:
    """Whether the function has one more argument, t, than the contour has parameters."""
    try:
        arguments = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):  # some compiled callables have no signature
        return False
    positional = [a for a in arguments if a.kind in (a.POSITIONAL_ONLY, a.POSITIONAL_OR_KEYWORD)]
    needed = [a for a in positional if a.default is a.empty]
    if len(needed) == parameters + 1 or (len(positional) > parameters and positional[parameters].name == "t"):
        return True
    if len(needed) > parameters or (len(positional) < parameters and len(positional) == len(arguments)):
        raise ContourError(
            f"{owner}: the function takes {len(needed)} arguments, "
            f"not {parameters} (or {parameters + 1} with time)"
        )
    return False


def trial_values(domain: Sequence[tuple[float, float]], count: int) -> np.ndarray:
    """Reproducible random values (count, len(domain)) of parameters in the domain."""
    generator = np.random.default_rng(20240229)
    low, high = window(domain, _REACH)
    return low + (high - low) * generator.random((count, len(domain)))


def window(domain: Sequence[tuple[float, float]], reach: float) -> tuple[np.ndarray, np.ndarray]:
    """The domain with infinite ends replaced by values `reach` away from the other end or from zero."""
    low, high = [], []
    for start, end in domain:
        low.append(start if math.isfinite(start) else (end - reach if math.isfinite(end) else -reach))
        high.append(end if math.isfinite(end) else (start + reach if math.isfinite(start) else reach))
    return np.array(low), np.array(high)


def _traced(formula: _Formula, domain: Sequence[tuple[float, float]]) -> Tape:
    """The formula's tape, compared with the formula itself all over the domain."""
    variables = ("u" if formula.parameters == 1 else "uv") + ("t" if formula.takes_time else "")
    tape = trace(formula.function, variables, formula.outputs)
    kind = TAPE_CURVE if formula.parameters == 1 else TAPE_SURFACE
    contour = Contour(kind, formula.parameters, pool=tape.pool)
    signs = np.zeros(len(tape.kinks))
    for u, t in zip(trial_values(domain, _TRIALS), np.linspace(0.0, _REACH, _TRIALS)):
        arguments = (*u.tolist(), float(t)) if formula.takes_time else tuple(u.tolist())
        expected = formula(*arguments)
        found = contour.evaluate(u, float(t))[0, : formula.outputs]
        difference = np.abs(found - expected)
        if not (difference <= _AGREEMENT * (1.0 + np.abs(expected).max())).all():
            worst = int(np.argmax(difference))
            raise ContourError(
                f"{formula.owner}: the traced formula gives {float(found[worst])!r} for component {worst} at "
                f"{arguments}, the function {float(expected[worst])!r}; it must depend on its arguments alone"
            )
        for k, slot in enumerate(tape.kinks):
            sign = math.copysign(1.0, tape.pool[slot])
            if signs[k] * sign < 0.0:
                raise ContourError(
                    f"{formula.owner}: not smooth: it takes the absolute value of a quantity "
                    f"that changes sign before {arguments}"
                )
            signs[k] = sign
    return tape


class ParametricCurve(Contour):
    """A curve f(u) or f(u, t) -> (x, y, z) in metres, t in s.

    f:          written with `math` or NumPy functions of numbers; it is turned into a tape once, so that no
                Python runs during a simulation and derivatives are exact
    domain:     (low, high) of u; may be infinite
    periodic:   f(low) and f(high) are the same point, smoothly joined

    Raises ContourError if f is not finite, not smooth or not made of elementary functions.
    """

    def __init__(self, f: Callable[..., Any], domain: tuple[float, float], periodic: bool = False) -> None:
        owner = "ParametricCurve"
        checked = (interval(owner, "domain", domain),)
        tape = _tape(_Formula(owner, f, 1, 3), checked)
        planar = tape.constants[2] == 0.0
        super().__init__(
            kind=TAPE_CURVE,
            dimension=1,
            pool=tape.pool,
            domain=checked,
            periodic=(bool(periodic),),
            planar=planar,
            time_dependent=tape.time_dependent,
        )
        _finish(self)


class ParametricSurface(Contour):
    """A surface f(u1, u2) or f(u1, u2, t) -> (x, y, z) in metres, t in s; its normal is along f_1 x f_2.

    f:          as in `ParametricCurve`
    domain:     ((low, high) of u1, (low, high) of u2); may be infinite
    periodic:   which parameters wrap around
    """

    def __init__(
        self,
        f: Callable[..., Any],
        domain: tuple[tuple[float, float], tuple[float, float]],
        periodic: tuple[bool, bool] = (False, False),
    ) -> None:
        owner = "ParametricSurface"
        checked = tuple(interval(owner, f"domain[{i}]", part) for i, part in enumerate(domain))
        tape = _tape(_Formula(owner, f, 2, 3), checked)
        super().__init__(
            kind=TAPE_SURFACE,
            dimension=2,
            pool=tape.pool,
            domain=checked,
            periodic=(bool(periodic[0]), bool(periodic[1])),
            time_dependent=tape.time_dependent,
        )
        _finish(self)


def _tape(formula: _Formula, domain: Sequence[tuple[float, float]]) -> Tape:
    try:
        return _traced(formula, domain)
    except Untraceable as reason:
        raise ContourError(f"{formula.owner}: the function cannot be traced: {reason}") from None


def _finish(contour: Contour) -> None:
    """Characteristic size from points all over a finite domain."""
    if np.isfinite(contour.domain).all():
        points = np.array([contour.point(u) for u in trial_values(contour.domain, _TRIALS)])
        object.__setattr__(contour, "size", 0.5 * float(np.linalg.norm(np.ptp(points, axis=0))))
