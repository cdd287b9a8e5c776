"""Parts of kernels are not callable from Python; tests that look at one alone compile a way in."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from pincontact.jit import KERNEL_OPTIONS
from pincontact.workspace import Layout, _by_name


def from_python(part: Callable[..., Any], layout: Layout | None = None) -> Callable[..., Any]:
    """A function that calls the part, compiled like an entry kernel but not cached, and with little optimisation, which
    is most of the time that compilation takes. layout: that of the workspace which the part's first argument is, if
    any."""
    if numba.config.DISABLE_JIT:
        return part

    @numba.njit(**KERNEL_OPTIONS)
    def compiled(*arguments):
        return part(*arguments)

    if layout is not None:
        at = layout.at

        @numba.njit(**KERNEL_OPTIONS)
        def compiled_at(address, *arguments):
            return part(at(address), *arguments)

    @functools.wraps(part)
    def call(*arguments: Any) -> Any:
        usual = numba.config.OPT
        numba.config.OPT = type(usual)(1)
        try:
            if layout is not None:
                return compiled_at(arguments[0].address, *arguments[1:])
            return compiled(*arguments)
        finally:
            numba.config.OPT = usual

    return call


def record_of(kind: np.dtype[Any], value: float = 0) -> Any:
    """A record with the same number in all fields, as workspaces have it."""
    return _by_name(np.full((), value, kind))
