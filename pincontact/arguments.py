"""Checks of what users pass to the calls: numbers and arrays of them."""

from __future__ import annotations

import math
import warnings
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import ArgumentError, ContactError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Counts have to fit into 64 bits, also when multiplied by a few.
_LARGEST_COUNT = 10**18
# What `real` and `real_array` raise.
NOT_REAL = (TypeError, ValueError, OverflowError)


def real(value: Any) -> float:
    """A real number as a float, NaN and infinity included.

    Raises TypeError or OverflowError for all else: texts, truth values, complex numbers, None, arrays with entries.
    """
    if type(value) is float:
        return value
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"no real number: {value!r}.")
    return float(value)


def number(what: str, value: Any, error: type[ContactError] = ArgumentError) -> float:
    """`real`, or the error that says what the value must be: "radius must be a number"."""
    try:
        return real(value)
    except NOT_REAL:
        raise error(f"{what}, got {value!r}") from None


def is_number(value: Any) -> bool:
    """Whether it is a real number that a float can hold, infinity included and NaN not."""
    try:
        return not math.isnan(real(value))
    except NOT_REAL:
        return False


def is_count(value: Any) -> bool:
    """Whether it is a whole number, at least 1, that 64 bits can hold and add to."""
    return is_number(value) and 1 <= value <= _LARGEST_COUNT and int(value) == value


def check_count(name: str, value: Any, optional: bool = False) -> None:
    """Raise ArgumentError for what is no such number; optional: None is one, too."""
    if not (is_count(value) or (optional and value is None)):
        raise ArgumentError(f"{name} must be a whole number, at least 1, got {value!r}")


def check_positive(**numbers: Any) -> None:
    """Raise ArgumentError naming the first of these that is not a positive finite number."""
    for name, value in numbers.items():
        if not (is_number(value) and math.isfinite(value) and value > 0.0):
            raise ArgumentError(f"{name} must be positive and finite, got {value!r}")


def time_step(dt: float | None, step: float | None) -> float | None:
    """The step of time in s that a call is given by one of its two names, `dt` or `step`, or None for neither.

    Raises ArgumentError for both at once, and for what is not positive and finite.
    """
    if dt is not None and step is not None:
        raise ArgumentError(f"step is another name of dt: give one of them, got dt={dt!r} and step={step!r}")
    name, value = ("dt", dt) if step is None else ("step", step)
    if value is None:
        return None
    check_positive(**{name: value})
    return real(value)


def check_tolerance(tolerance: Any) -> None:
    """Raise ArgumentError for what is no positive number."""
    if not (is_number(tolerance) and tolerance > 0.0):
        raise ArgumentError(f"tolerance must be positive, got {tolerance!r}")


def check_flag(name: str, value: Any) -> None:
    """Raise ArgumentError for what is neither True nor False."""
    if not isinstance(value, (bool, np.bool_)):
        raise ArgumentError(f"{name} must be True or False, got {value!r}")


def real_array(value: ArrayLike) -> np.ndarray:
    """A float copy of any shape. Raises TypeError, ValueError or OverflowError for what is no array of real numbers."""
    array = np.asarray(value)
    if array.dtype.kind == "O":
        return np.array([real(entry) for entry in array.flat]).reshape(array.shape)
    if array.dtype.kind not in "iuf":
        # NumPy would read numbers out of text, drop imaginary parts, and take truth values for 0 and 1
        raise TypeError(f"an array of {array.dtype}.")
    return np.array(array, dtype=float)


def reals(what: str, value: Any, error: type[ContactError] = ArgumentError) -> np.ndarray:
    """`real_array`, or the error that says what the value must be: "q must be 7 numbers"."""
    try:
        return real_array(value)
    except NOT_REAL:
        raise error(f"{what}, got {value!r}") from None


def warn_of_order(what: str, quaternion: ArrayLike, stacklevel: int) -> None:
    """Warn of the quaternion that is no turn where the real part comes first, and half a turn here."""
    if np.array_equal(quaternion, (1.0, 0.0, 0.0, 0.0)):
        warnings.warn(
            f"{what} is (1, 0, 0, 0), half a turn about x: the order is x, y, z, w, and (0, 0, 0, 1) is no turn; where "
            "half a turn is meant, (-1, 0, 0, 0) says so without this warning.",
            stacklevel=stacklevel + 1,
        )


def output_number(index: Any, n: int) -> int:
    """The number of one of n outputs, negative from the end; ArgumentError for anything else."""
    if isinstance(index, (bool, np.bool_)) or not isinstance(index, (int, np.integer)):
        raise ArgumentError(
            f"index must be the number of an output, a whole number, got {index!r}; between outputs there is "
            "run.sol(t), with dense_output=True"
        )
    if not -n <= index < n:
        raise ArgumentError(f"index must be the number of an output, from {-n} to {n - 1}, got {index}")
    return int(index)
