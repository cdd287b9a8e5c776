"""The user's control: what asks it for a system's torques, from Python and, where numba has compiled it, without."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numba import types
from numba.extending import is_jitted

from .dynamics.system import Torque
from .errors import UnusableResult

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .dynamics.system import System

Control = Callable[[float, np.ndarray, np.ndarray], "ArrayLike"]


def torque_of(control: Control, system: System) -> Torque:
    """What asks a control for a system's torques.

    Asking raises what the control raises, UnusableResult for what are no torques; whether they are finite is left to
    the kernels, which note it.
    """
    # made once, and local to the function: a call costs what the control costs
    q, v, tau, shape = system.q.view(), system.v.view(), system.tau, (system.nv,)
    q.flags.writeable = v.flags.writeable = False
    real, arrays = np.dtype(float), np.ndarray

    def unusable(t: float, what: str) -> UnusableResult:
        return UnusableResult(f"t = {t:.9g} s: control returned {what}")

    def numbers(t: float, found: Any) -> np.ndarray:
        if found is None:
            raise unusable(t, f"None, not an array of shape {shape}")
        try:
            array = np.asarray(found)
            if array.dtype.kind != "c":
                return np.asarray(array, dtype=float)
        except (TypeError, ValueError) as error:
            raise unusable(t, f"{found!r}: {error}") from None
        # the conversion would drop imaginary parts
        raise unusable(t, f"complex numbers: {array.tolist()}")

    def ask(t: float) -> None:
        try:
            found = control(t, q, v)
        except BaseException:
            system.blame(f"t = {t:.9g} s: control")
            raise
        if type(found) is not arrays or found.dtype is not real:
            found = numbers(t, found)
        if found.shape != shape:
            raise unusable(t, f"an array of shape {found.shape}, not {shape}")
        # of a few numbers a slice would take twice as long
        tau[...] = found

    compiled = _compiled(control) if is_jitted(control) else None
    if compiled is None:
        return Torque(ask, None)
    call = compiled.ctypes
    arrays_of_system = [array.ctypes.data_as(call.argtypes[1]) for array in (system.q, system.v, tau)]

    def ask_compiled(t: float) -> None:
        if not call(t, *arrays_of_system, system.nq, system.nv):
            ask(t)

    return Torque(ask_compiled, compiled)


# What was compiled last, by control: numba's machine code of the control, and the C function that calls it. A control
# of which numba has made new code since (`recompile`) is compiled again.
_KNOWN: dict[Any, tuple[list[Any], Any]] = {}
_MOST_KNOWN = 64


def _compiled(control: Any) -> Any:
    """`_c_function` of a control, once for each."""
    known, function = _KNOWN.pop(control, ([], None))
    code = list(control.overloads.values())
    if not known or len(known) != len(code) or any(one is not other for one, other in zip(known, code)):
        function = _c_function(control)
        code = list(control.overloads.values())
    _KNOWN[control] = code, function
    if len(_KNOWN) > _MOST_KNOWN:
        # the one that was asked for the longest time ago
        del _KNOWN[next(iter(_KNOWN))]
    return function


def _c_function(control: Any) -> Any:
    """A C function (time, q, v, tau, nq, nv), arrays by their addresses, that asks a function compiled by numba for
    torques; or None where it returns no arrays of one axis.

    It returns 1; or 0 where the control raises or gives another number of torques: Python's way tells what it was.
    """
    pointer = types.CPointer(types.float64)

    def ask(t, q, v, tau, nq, nv):
        # copies: what the control does with them is its own affair
        found = control(t, numba.carray(q, nq).copy(), numba.carray(v, nv).copy())
        if len(found) != nv:
            return 0
        torques = numba.carray(tau, nv)
        for k in range(nv):
            torques[k] = found[k]
        return 1

    # an exception ends here; within a `try` numba takes three times as long over the function itself
    inner = numba.njit(ask)

    def ask_safely(t, q, v, tau, nq, nv):
        try:
            return inner(t, q, v, tau, nq, nv)
        except Exception:
            return 0

    signature = types.int64(types.float64, pointer, pointer, pointer, types.int64, types.int64)
    try:
        return numba.cfunc(signature)(ask_safely)
    except numba.NumbaError:
        return None
