"""Parts of kernels are not callable from Python; tests that look at one alone compile a way in."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numba

from pincontact.jit import _OPTIONS


def from_python(part: Callable[..., Any]) -> Callable[..., Any]:
    """A function that calls the part, compiled like an entry kernel but not cached, and with little optimisation, which
    is most of the time that compilation takes."""
    if numba.config.DISABLE_JIT:
        return part

    @numba.njit(**_OPTIONS)
    def compiled(*arguments):
        return part(*arguments)

    @functools.wraps(part)
    def call(*arguments: Any) -> Any:
        usual = numba.config.OPT
        numba.config.OPT = type(usual)(1)
        try:
            return compiled(*arguments)
        finally:
            numba.config.OPT = usual

    return call
