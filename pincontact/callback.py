"""Calls from compiled code by address: how a kernel reaches Pinocchio without leaving its loop, and another kernel.

Kernels run without the interpreter's lock. For a call into Python they take it and go through Python's own C interface,
so any callable will do; where Pinocchio's functions are not reached by their own addresses (see `pinocchio_calls`), it
is they, with their arguments. A kernel that is called by its address is not compiled into its caller once more.
"""

from __future__ import annotations

import ctypes
from functools import cache
from inspect import Parameter, Signature
from typing import Any

import numba
from numba import types
from numba.extending import intrinsic

from .jit import ENTRIES, INTEGER

# `call_python(function, arguments, failure)`: addresses of a callable, of its tuple of arguments and of the result that
# means failure (False); returns whether it succeeded. An exception stays set, and is raised where the kernel returns.
call_python: Any


def kernel_caller(returned: Any, *arguments: Any) -> Any:
    """`f(address, ...)` for kernels: calls the entry kernel of these numba types at an address that `kernel_address`
    gives, and returns what it returns."""
    if numba.config.DISABLE_JIT:
        return lambda address, *values: _thing(address)(*values)

    def definition(typing_context, address, *given):
        def generate(context, builder, signature, values):
            from llvmlite import ir

            kinds = [context.get_value_type(kind) for kind in arguments]
            function = ir.FunctionType(context.get_value_type(returned), kinds)
            return builder.call(builder.inttoptr(values[0], function.as_pointer()), values[1:])

        return returned(types.int64, *arguments), generate

    # numba reads the number of arguments off the signature
    names = ("typing_context", "address", *(f"argument{i}" for i in range(len(arguments))))
    definition.__signature__ = Signature([Parameter(n, Parameter.POSITIONAL_OR_KEYWORD) for n in names])  # type: ignore[attr-defined]
    return intrinsic(definition)


def _thing(address: int) -> Any:
    return ctypes.cast(int(address), ctypes.py_object).value


if numba.config.DISABLE_JIT:

    def call_python(function, arguments, failure):
        return _thing(function)(*_thing(arguments)) is not _thing(failure)

else:

    @intrinsic
    def call_python(typing_context, function, arguments, failure):
        def generate(context, builder, signature, values):
            # imported when code is generated: it costs as much as the rest of the package
            from llvmlite import ir
            from numba.core import cgutils

            pointer = ir.IntType(8).as_pointer()
            call = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(pointer, [pointer, pointer]), "PyObject_CallObject"
            )
            release = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(ir.VoidType(), [pointer]), "Py_DecRef"
            )
            callable_, arguments_, failure_ = (builder.inttoptr(value, pointer) for value in values)
            state = ir.IntType(32)
            take = cgutils.get_or_insert_function(builder.module, ir.FunctionType(state, []), "PyGILState_Ensure")
            leave = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(ir.VoidType(), [state]), "PyGILState_Release"
            )
            # whether the thread has the lock or not
            before = builder.call(take, [])
            result = builder.call(call, [callable_, arguments_])
            # releasing nothing is allowed
            builder.call(release, [result])
            builder.call(leave, [before])
            failed = builder.or_(cgutils.is_null(builder, result), builder.icmp_unsigned("==", result, failure_))
            return builder.not_(failed)

        return types.boolean(types.int64, types.int64, types.int64), generate


# any function of five integers or addresses, or of the first few of them
call_by_address = kernel_caller(INTEGER, *(INTEGER,) * 5)


@cache
def kernel_address(entry: Any) -> int:
    """Where `kernel_caller` finds an entry kernel."""
    if numba.config.DISABLE_JIT:
        return id(entry)
    (known,) = (known for known in ENTRIES if known.compiled.py_func is entry.__wrapped__)
    known.compile()
    result = known.compiled.overloads[known.arguments]
    return int(result.library.get_pointer_to_function(result.fndesc.llvm_cfunc_wrapper_name))
