"""Calls from compiled code into Python: how a kernel reaches Pinocchio without leaving its loop.

The kernel holds the interpreter's lock and goes through Python's own C interface, so any callable will do; for a plain
scene it is Pinocchio's function itself, with its four arguments.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numba
from numba import types
from numba.extending import intrinsic

# `call_python(function, arguments, failure)`: addresses of a callable, of its tuple of arguments and of the result that
# means failure (False); returns whether it succeeded. An exception stays set, and is raised where the kernel returns.
call_python: Any

if numba.config.DISABLE_JIT:

    def call_python(function, arguments, failure):
        def thing(address: int) -> Any:
            return ctypes.cast(int(address), ctypes.py_object).value

        return thing(function)(*thing(arguments)) is not thing(failure)

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
            result = builder.call(call, [callable_, arguments_])
            # releasing nothing is allowed
            builder.call(release, [result])
            failed = builder.or_(cgutils.is_null(builder, result), builder.icmp_unsigned("==", result, failure_))
            return builder.not_(failed)

        return types.boolean(types.int64, types.int64, types.int64), generate
