"""Calls from compiled code by address: how a kernel reaches Pinocchio without leaving its loop, and another kernel.

Kernels run without the interpreter's lock. For a call into Python they take it and go through Python's own C interface,
so any callable will do; where Pinocchio's functions are not reached by their own addresses (see `pinocchio_calls`), it
is they, with their arguments.

A kernel that is called by its address is not compiled into its caller once more. `separate_kernel` makes such kernels,
which are called by their names like any other: each is compiled and cached by itself, before or after its callers, in
this or another process. A call costs some nanoseconds. One that is missing where it is called is fetched by Python.
"""

from __future__ import annotations

import ctypes
import inspect
from collections.abc import Callable
from functools import cache
from inspect import Parameter, Signature
from typing import Any

import numba
from llvmlite import binding, ir
from numba import cfunc, types
from numba.extending import intrinsic, lower_builtin, type_callable

from .jit import ALWAYS, ENTRIES, INTEGER, KERNEL_OPTIONS, SEPARATE, Entry, cache_directory

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
            return _succeeded(builder, *(builder.inttoptr(value, _POINTER) for value in values))

        return types.boolean(types.int64, types.int64, types.int64), generate


_WORD, _STATE, _POINTER = ir.IntType(64), ir.IntType(32), ir.IntType(8).as_pointer()


def _succeeded(builder: Any, function: Any, arguments: Any, failure: Any) -> Any:
    """LLVM's call of a Python callable, and whether it returned something else than what means failure."""
    # imported when code is generated: it costs as much as the rest of the package
    from numba.core.cgutils import get_or_insert_function

    def of_python(name: str, returned: Any, *kinds: Any) -> Any:
        return get_or_insert_function(builder.module, ir.FunctionType(returned, kinds), name)

    # whether the thread has the lock or not
    before = builder.call(of_python("PyGILState_Ensure", _STATE), [])
    result = builder.call(of_python("PyObject_CallObject", _POINTER, _POINTER, _POINTER), [function, arguments])
    # releasing nothing is allowed
    builder.call(of_python("Py_DecRef", ir.VoidType(), _POINTER), [result])
    builder.call(of_python("PyGILState_Release", ir.VoidType(), _STATE), [before])
    failed = builder.icmp_unsigned("==", result, ir.Constant(_POINTER, None))
    return builder.not_(builder.or_(failed, builder.icmp_unsigned("==", result, failure)))


class _Separate:
    """Machine code of a separate kernel; `compile` and `overloads` are those of numba's compiled functions.

    Its callers know a symbol, that of two words in memory: the address of its machine code, once there is some, and
    that of a callable which fetches it.
    """

    def __init__(self, function: Callable[..., Any], returned: Any, arguments: tuple[Any, ...], when: int):
        self.py_func, self.returned, self.arguments = function, returned, arguments
        self.entry = Entry(self, arguments, cache_directory(function), when)
        self.overloads: dict[Any, Any] = {}
        self._fetch = self.entry.prepare
        self._words = (ctypes.c_int64 * 2)(0, id(self._fetch))
        self._symbol = self.entry.name
        binding.add_symbol(self._symbol, ctypes.addressof(self._words))

    def compile(self, arguments: tuple[Any, ...]) -> None:
        self.overloads[arguments] = code = cfunc(self.returned(*arguments), cache=True, **KERNEL_OPTIONS)(self.py_func)
        self._words[0] = code.address

    def typed(self, context: Any) -> Callable[..., Any]:
        """numba's typing of a call."""

        def typed(*given: Any) -> Any:
            return self.returned(*self.arguments)

        # numba reads the parameters off the signature
        typed.__signature__ = inspect.signature(self.py_func)  # type: ignore[attr-defined]
        return typed

    def call(self, context: Any, builder: Any, signature: Any, values: Any) -> Any:
        """LLVM's call of it. Where fetching it raises, the result is 0, and the exception stays set."""
        module, nothing = builder.module, ir.Constant(_POINTER, None)
        if self._symbol not in module.globals:
            ir.GlobalVariable(module, ir.ArrayType(_WORD, 2), self._symbol)
        place, fetch = (
            builder.gep(module.globals[self._symbol], [ir.Constant(_WORD, 0), ir.Constant(_WORD, i)]) for i in range(2)
        )
        with builder.if_then(builder.icmp_unsigned("==", builder.load(place), ir.Constant(_WORD, 0)), likely=False):
            _succeeded(builder, builder.inttoptr(builder.load(fetch), _POINTER), nothing, nothing)
        address = builder.load(place)
        returned = context.get_value_type(self.returned)
        function = ir.FunctionType(returned, [context.get_value_type(kind) for kind in self.arguments])
        before = builder.block
        with builder.if_then(builder.icmp_unsigned("!=", address, ir.Constant(_WORD, 0)), likely=True):
            result = builder.call(builder.inttoptr(address, function.as_pointer()), values)
            inside = builder.block
        value = builder.phi(returned)
        value.add_incoming(ir.Constant(returned, None), before)
        value.add_incoming(result, inside)
        return value


def separate_kernel(
    returned: Any, *arguments: Any, when: int = ALWAYS
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A kernel of these numba types, the returned one first, that is compiled as a function of its own.

    Python calls it as Python, like any `kernel`. when: see `jit.ALWAYS`.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        if not numba.config.DISABLE_JIT:
            separate = _Separate(function, returned, arguments, when)
            SEPARATE[function] = separate.entry
            ENTRIES.append(separate.entry)
            type_callable(function)(separate.typed)
            lower_builtin(function, *arguments)(separate.call)
        return function

    return decorate


# any function of five integers or addresses, or of the first few of them
call_by_address = kernel_caller(INTEGER, *(INTEGER,) * 5)


@cache
def kernel_address(entry: Any) -> int:
    """Where `kernel_caller` finds an entry kernel."""
    if numba.config.DISABLE_JIT:
        return id(entry)
    (known,) = (known for known in ENTRIES if known.compiled.py_func is entry.__wrapped__)
    known.prepare()
    result = known.compiled.overloads[known.arguments]
    return int(result.library.get_pointer_to_function(result.fndesc.llvm_cfunc_wrapper_name))
