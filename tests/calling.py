"""Parts of kernels are not callable from Python; tests that look at one alone compile a way in."""

from __future__ import annotations

import functools
import gc
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from pincontact.arrays import View, make_view, parts_of
from pincontact.contours.graph import Untraceable
from pincontact.contours.tape import COUNT
from pincontact.contours.trace import Path
from pincontact.jit import CHECKED, KERNEL_OPTIONS
from pincontact.workspace import Layout, by_name


@functools.cache
def from_python(part: Callable[..., Any], layout: Layout | None = None) -> Callable[..., Any]:
    """A function that calls the part, compiled like an entry kernel but not cached, and without optimisation, which
    is most of the time that compilation takes. layout: that of the workspace which the part's first argument is, if
    any."""
    if numba.config.DISABLE_JIT:
        return part

    @numba.njit(**KERNEL_OPTIONS, no_cfunc_wrapper=True)
    def compiled(*arguments):
        return part(*_as_kernels_have_them(arguments))

    if layout is not None:
        at = layout.at

        @numba.njit(**KERNEL_OPTIONS, no_cfunc_wrapper=True)
        def compiled_at(address, *arguments):
            return part(at(address), *_as_kernels_have_them(arguments))

    @functools.wraps(part)
    def call(*arguments: Any) -> Any:
        usual, collects = numba.config.OPT, gc.isenabled()
        numba.config.OPT = type(usual)(0)
        # a compiler leaves little garbage, and looking for it takes a tenth of its time
        gc.disable()
        try:
            if layout is not None:
                return compiled_at(arguments[0].address, *arguments[1:])
            return compiled(*arguments)
        finally:
            numba.config.OPT = usual
            if collects:
                gc.enable()

    return call


@intrinsic
def _as_kernels_have_them(typing_context, arguments):
    """Arguments, contiguous arrays of numba's among them as those of kernels (see `arrays`)."""
    kinds = [_kernel_type(kind) for kind in arguments.types]

    def generate(context, builder, signature, values):
        items = []
        for i, (given, kind) in enumerate(zip(arguments.types, kinds)):
            item = builder.extract_value(values[0], i)
            if kind is not given:
                data, shape = parts_of(context, builder, given, item)
                item = make_view(context, builder, kind, data, shape)
            items.append(item)
        return context.make_tuple(builder, signature.return_type, items)

    return types.Tuple(kinds)(arguments), generate


def _kernel_type(given: Any) -> Any:
    contiguous = isinstance(given, types.Array) and given.layout == "C" and not CHECKED
    return View(given.dtype, given.ndim) if contiguous else given


def record_of(kind: np.dtype[Any], value: float = 0) -> Any:
    """A record with the same number in all fields, as workspaces have it."""
    return by_name(np.full((), value, kind))


def traced_tape(function: Callable[..., Any], variables: str, outputs: int) -> Any:
    """The tape of a function that takes no decisions. Raises Untraceable for others."""
    path = Path(function, variables, outputs, [0.6] * len(variables))
    if path.reason or path.graph.comparisons:
        raise Untraceable(path.reason or "it takes decisions")
    return path.tape()


def instructions(function: Callable[..., Any], variables: str, outputs: int) -> int:
    """How many instructions its tape has."""
    return int(traced_tape(function, variables, outputs).pool[COUNT])
