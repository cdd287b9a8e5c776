"""Checks of the numbers that users give to contours and motions; each raises a ContourError naming owner and number."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arguments import NOT_REAL, number, real, real_array
from ..errors import ContourError


def finite(owner: str, **numbers: Any) -> tuple[float, ...]:
    """The given numbers as finite floats."""
    checked = []
    for name, value in numbers.items():
        found = number(f"{owner}: {name} must be a number", value, ContourError)
        if not np.isfinite(found):
            raise ContourError(f"{owner}: {name} must be finite, got {found}")
        checked.append(found)
    return tuple(checked)


def positive(owner: str, **lengths: Any) -> tuple[float, ...]:
    """The given lengths as positive finite floats."""
    checked = finite(owner, **lengths)
    for name, length in zip(lengths, checked):
        if not length > 0.0:
            raise ContourError(f"{owner}: {name} must be positive and finite, got {length}")
    return checked


def interval(owner: str, name: str, ends: Any) -> tuple[float, float]:
    """(low, high) as floats with low < high, either of which may be infinite."""
    try:
        low, high = (real(end) for end in ends)
    except NOT_REAL:
        raise ContourError(f"{owner}: {name} must be two numbers (low, high), got {ends!r}") from None
    if not low < high:
        raise ContourError(f"{owner}: {name} must have low < high, got ({low}, {high})")
    return low, high


def flag(owner: str, name: str, value: Any) -> bool:
    """True or False."""
    if isinstance(value, (bool, np.bool_)) or (isinstance(value, (int, np.integer)) and value in (0, 1)):
        return bool(value)
    raise ContourError(f"{owner}: {name} must be True or False, got {value!r}")


def pair(owner: str, name: str, given: Any, what: str) -> tuple[Any, Any]:
    """Both parts of what is said of both parameters of a surface."""
    try:
        # of two letters neither says anything
        first, second = given if not isinstance(given, (str, bytes)) else list(given)[2:]
    except (TypeError, ValueError):
        raise ContourError(f"{owner}: {name} must be a pair of {what}, got {given!r}") from None
    return first, second


def flags(owner: str, name: str, values: Any) -> tuple[bool, bool]:
    """Two truth values, one for each parameter of a surface."""
    first, second = pair(owner, name, values, "booleans")
    return flag(owner, f"{name}[0]", first), flag(owner, f"{name}[1]", second)


def array(owner: str, name: str, given: Any, *shape: int | None) -> np.ndarray:
    """A finite float array of this shape (None: any length)."""
    try:
        values = real_array(given)
    except NOT_REAL:
        raise ContourError(f"{owner}: {name} must be an array of numbers") from None
    if values.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, values.shape)):
        wanted = ", ".join("n" if n is None else str(n) for n in shape)
        raise ContourError(f"{owner}: {name} must have shape ({wanted}), got {values.shape}")
    if not np.isfinite(values).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
        raise ContourError(f"{owner}: {name}{list(where)} is not finite")
    return values


def in_space(values: np.ndarray) -> np.ndarray:
    """Rows (x, y) or (x, y, z) as (n, 3), with z = 0 where they have none."""
    out = np.zeros((len(values), 3))
    out[:, : values.shape[1]] = values
    return out
