"""Parts of kernels are not callable from Python; tests that look at one alone compile a way in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

from pincontact.jit import _ENTRY_OPTIONS, _OPTIONS


def from_python(part: Callable[..., Any]) -> Callable[..., Any]:
    """A function that calls the part, compiled like an entry kernel but not cached."""
    if numba.config.DISABLE_JIT:
        return part

    @numba.njit(**_OPTIONS, **_ENTRY_OPTIONS)
    def call(*arguments):
        return part(*arguments)

    return call
