"""Calls from one compiled kernel to another through the address of its machine code.

A kernel that calls another has it compiled into itself. Where that is large and has been compiled already, on behalf of
Python or in a second process, only its address need be known: numbers go in (addresses of arrays among them), a real
number comes out.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from .memory import address_of

if numba.config.DISABLE_JIT:
    _functions: dict[int, Any] = {}

    def code_address(entry: Any, arguments: tuple[Any, ...]) -> int:
        """A number by which `call_code` finds the function."""
        _functions[id(entry)] = entry
        return id(entry)

    def call_code(code, arguments):
        return _functions[int(code)](*arguments)

    def array_address(array):
        return address_of(np.asarray(array))

else:

    def code_address(entry: Any, arguments: tuple[Any, ...]) -> int:
        """The address of an entry kernel for these numba types, all numbers; compiled or loaded if it is not yet."""
        entry.compile(arguments)
        result = entry.overloads[arguments]
        return int(result.library.get_pointer_to_function(result.fndesc.llvm_cfunc_wrapper_name))

    @intrinsic
    def call_code(typing_context, code, arguments):
        """Call the kernel at an address of `code_address` with a tuple of numbers, of exactly its types."""

        def generate(context, builder, signature, values):
            from llvmlite import ir

            inputs = [context.get_value_type(kind) for kind in arguments.types]
            function = ir.FunctionType(context.get_value_type(types.float64), inputs)
            address = builder.inttoptr(values[0], function.as_pointer())
            return builder.call(address, [builder.extract_value(values[1], i) for i in range(len(inputs))])

        return types.float64(types.int64, arguments), generate

    @intrinsic
    def array_address(typing_context, array):
        """The address of an array's first element."""

        def generate(context, builder, signature, values):
            from numba.np.arrayobj import make_array

            data = make_array(array)(context, builder, values[0]).data
            return builder.ptrtoint(data, context.get_value_type(types.int64))

        return types.int64(array), generate
