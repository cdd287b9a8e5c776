"""A user's callable as a formula: its arguments, and its values, checked."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import ContourError

# How many parameter values a formula is tried at, and how far along an infinite domain and in time.
_TRIALS = 25
REACH = 3.0
# Additive recurrences of the golden ratio and its generalisations, x^(n + 1) = x + 1 for n parameters, spread evenly.
_GOLDEN = {1: 1.6180339887498949, 2: 1.3247179572447460, 3: 1.2207440846057596}


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
        try:
            result = np.asarray(function(*arguments), dtype=float)
        except Exception as error:
            raise ContourError(f"{self.owner}: {what} raised {error!r} at {_shown(arguments)}") from error
        if result.size != math.prod(shape):
            raise ContourError(
                f"{self.owner}: {what} must return {' x '.join(map(str, shape))} numbers, "
                f"at {_shown(arguments)} there are {result.size}"
            )
        # of a few numbers a list takes a fraction of the time of array functions
        if not all(map(math.isfinite, result.ravel().tolist())):
            raise ContourError(f"{self.owner}: {what} is not finite at {_shown(arguments)}: {result.tolist()}")
        return result.reshape(shape)


def _shown(arguments: tuple[float, ...]) -> str:
    return f"({', '.join(f'{value:.6g}' for value in arguments)})"


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


def spread(low: np.ndarray, high: np.ndarray, count: int) -> np.ndarray:
    """Points (count, n), evenly spread between low and high (n,), on no lattice and never where halving puts one."""
    n = len(low)
    steps = np.arange(1, count + 1)[:, None] / _GOLDEN[n] ** np.arange(1, n + 1) % 1.0
    return low + (high - low) * steps


def trials(domain: Sequence[tuple[float, float]]) -> np.ndarray:
    """Reproducible random values (n, k) of parameters in the domain, at which formulas are tried."""
    low = [a if math.isfinite(a) else (b - REACH if math.isfinite(b) else -REACH) for a, b in domain]
    high = [b if math.isfinite(b) else (a + REACH if math.isfinite(a) else REACH) for a, b in domain]
    return np.random.default_rng(20240229).uniform(low, high, (_TRIALS, len(domain)))
