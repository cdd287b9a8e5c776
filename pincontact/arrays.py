"""Arrays of compiled kernels: an address and extents.

numba's own arrays count references, may be indexed from their end and are seven words or more, which every call passes
on. Those of kernels are an address and the extents: C-contiguous memory that somebody else owns. Indices are not
negative; slices are of the last index that is given, have no step and begin inside. The checked build has numba's
arrays, and its bounds checks, in their place.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import (
    intrinsic,
    lower_builtin,
    make_attribute_wrapper,
    models,
    overload_method,
    register_model,
    type_callable,
)

from .jit import ALWAYS, CHECKED, entry_kernel, kernel

REALS, INTEGERS = np.dtype(np.float64), np.dtype(np.int64)
_NUMBA: dict[np.dtype[Any], Any] = {REALS: types.float64, INTEGERS: types.int64}
_WORD = ir.IntType(64)


class View(types.Type):
    """numba's type of such arrays. item: numba's type of an element, a number or a record."""

    def __init__(self, item: Any, ndim: int):
        self.item, self.ndim = item, ndim
        super().__init__(f"View({item}, {ndim})")


@register_model(View)
class _ViewModel(models.StructModel):
    def __init__(self, manager: Any, view: View):
        extents = types.UniTuple(types.int64, view.ndim)
        super().__init__(manager, view, [("data", types.CPointer(view.item)), ("shape", extents)])


make_attribute_wrapper(View, "shape", "shape")


def item_type(item: np.dtype[Any]) -> Any:
    """numba's type of numbers, or of a record."""
    if item not in _NUMBA:
        _NUMBA[item] = numba.from_dtype(item)
    return _NUMBA[item]


def array_type(item: np.dtype[Any], dimensions: int) -> Any:
    """numba's type of a C-contiguous array, or of a single record."""
    if not dimensions:
        return item_type(item)
    return types.Array(item_type(item), dimensions, "C") if CHECKED else View(item_type(item), dimensions)


def make_view(context: Any, builder: Any, kind: Any, data: Any, shape: list[Any]) -> Any:
    """LLVM's value of an array of that type: pointer to its first element, extents."""
    if isinstance(kind, types.Array):
        # numba's own; imported when code is generated: it costs as much as the rest of the package
        from numba.np.arrayobj import make_array, populate_array

        size = context.get_constant(types.intp, kind.dtype.bitwidth // 8)
        steps = [builder.mul(stride, size) for stride in _strides(builder, shape)]
        array = make_array(kind)(context, builder)
        # its references are not counted
        populate_array(array, data=data, shape=shape, strides=steps, itemsize=size, meminfo=None)
        return array._getvalue()
    value = ir.Constant(context.get_value_type(kind), ir.Undefined)
    value = builder.insert_value(value, data, 0)
    for i, extent in enumerate(shape):
        value = builder.insert_value(value, extent, (1, i))
    return value


def _strides(builder: Any, shape: list[Any]) -> list[Any]:
    """Strides in elements of an array without gaps."""
    strides = [ir.Constant(_WORD, 1)]
    for extent in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], extent, flags=("nsw",)))
    return strides


def parts_of(context: Any, builder: Any, kind: Any, value: Any) -> tuple[Any, list[Any]]:
    """Pointer to the first element, and extents, of an array of kernels or numba's."""
    if isinstance(kind, View):
        return builder.extract_value(value, 0), [builder.extract_value(value, (1, i)) for i in range(kind.ndim)]
    array = context.make_array(kind)(context, builder, value)
    return array.data, [builder.extract_value(array.shape, i) for i in range(kind.ndim)]


def _items(index: Any) -> list[Any]:
    return list(index) if isinstance(index, types.BaseTuple) else [index]


def _found(view: View, index: Any) -> Any:
    """Type of what an index leads to, None if it is none of ours."""
    items = _items(index)
    slices = [i for i, item in enumerate(items) if isinstance(item, types.SliceType)]
    # without gaps where only the first dimension that is left has been cut
    if len(items) > view.ndim or slices not in ([], [len(items) - 1]):
        return None
    if not all(isinstance(item, (types.Integer, types.SliceType)) for item in items):
        return None
    ndim = view.ndim - len(items) + len(slices)
    return View(view.item, ndim) if ndim else view.item


@type_callable(operator.getitem)
def _type_getitem(context: Any) -> Any:
    def typer(view: Any, index: Any) -> Any:
        return _found(view, index) if isinstance(view, View) else None

    return typer


@type_callable(operator.setitem)
def _type_setitem(context: Any) -> Any:
    def typer(view: Any, index: Any, value: Any) -> Any:
        number = isinstance(value, (types.Number, types.Boolean))
        return types.none if isinstance(view, View) and number and _found(view, index) == view.item else None

    return typer


@type_callable(len)
def _type_len(context: Any) -> Any:
    def typer(view: Any) -> Any:
        return types.intp if isinstance(view, View) else None

    return typer


@lower_builtin(len, View)
def _len(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    return builder.extract_value(values[0], (1, 0))


def _element(context: Any, builder: Any, view: View, value: Any, index: Any, given: Any) -> tuple[Any, list[Any]]:
    """Pointer to what an index leads to, and the extents that are left."""
    kinds = _items(index)
    parts = (
        [builder.extract_value(given, i) for i in range(len(kinds))] if isinstance(index, types.BaseTuple) else [given]
    )
    data, shape = parts_of(context, builder, view, value)
    offset, extents = ir.Constant(_WORD, 0), shape[len(kinds) :]
    for kind, start, extent, stride in zip(kinds, parts, shape, _strides(builder, shape)):
        if isinstance(kind, types.SliceType):
            cut = context.make_helper(builder, kind, start)
            start = cut.start
            stop = builder.select(builder.icmp_signed("<", cut.stop, extent), cut.stop, extent)
            extents = [builder.sub(stop, start, flags=("nsw",)), *extents]
        else:
            start = context.cast(builder, start, kind, types.int64)
        offset = builder.add(offset, builder.mul(start, stride, flags=("nsw",)), flags=("nsw",))
    return builder.gep(data, [offset], inbounds=True), extents


def _getitem(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    (view, index), kind = signature.args, signature.return_type
    pointer, extents = _element(context, builder, view, values[0], index, values[1])
    if not isinstance(kind, View):
        # a number, or where a record is
        return context.unpack_value(builder, kind, pointer)
    return make_view(context, builder, kind, pointer, extents)


def _setitem(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    view, index, given = signature.args
    pointer, _ = _element(context, builder, view, values[0], index, values[1])
    builder.store(context.cast(builder, values[2], given, view.item), pointer)
    return context.get_dummy_value()


for _index in (types.Integer, types.SliceType, types.BaseTuple):
    lower_builtin(operator.getitem, View, _index)(_getitem)
    lower_builtin(operator.setitem, View, _index, types.Any)(_setitem)


@intrinsic
def _matrix(typing_context, array, n, m):
    def generate(context, builder, signature, values):
        data, _ = parts_of(context, builder, array, values[0])
        shape = [context.cast(builder, v, k, types.int64) for v, k in zip(values[1:], signature.args[1:])]
        return make_view(context, builder, signature.return_type, data, shape)

    return View(array.item, 2)(array, n, m), generate


@overload_method(View, "reshape")
def _reshape(array, n, m):
    return lambda array, n, m: _matrix(array, n, m)


# Of arrays whose addresses were asked for: how many bytes there are from there on. Kept by the checked build only.
ROOM: dict[int, int] = {}


def address_of(array: np.ndarray) -> int:
    """The address of an array's first element."""
    address = int(array.__array_interface__["data"][0])
    if CHECKED:
        ROOM[address] = array.nbytes
    return address


if numba.config.DISABLE_JIT:
    address = address_of
else:

    @intrinsic
    def address(typing_context, array):
        """Where an array's first element is."""

        def generate(context, builder, signature, values):
            return builder.ptrtoint(parts_of(context, builder, array, values[0])[0], _WORD)

        return types.int64(array), generate


if numba.config.DISABLE_JIT or CHECKED:

    def view(array):
        return array

    def as_array(array):
        return array

    if not numba.config.DISABLE_JIT:
        view, as_array = numba.extending.register_jitable(view), numba.extending.register_jitable(as_array)
else:

    def _conversion(kind_of: Any) -> Any:
        @intrinsic
        def convert(typing_context, array):
            def generate(context, builder, signature, values):
                data, shape = parts_of(context, builder, array, values[0])
                return make_view(context, builder, signature.return_type, data, shape)

            return kind_of(array)(array), generate

        return convert

    # numba's C-contiguous array as one of kernels, and one of kernels as numba's, for calls by address
    view = _conversion(lambda array: View(array.dtype, array.ndim))
    as_array = _conversion(lambda array: types.Array(array.item, array.ndim, "C"))


def array_entry(*arguments: Any, when: int = ALWAYS) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """`entry_kernel` for a kernel to which Python hands NumPy's arrays: it gets them as those of kernels."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        names = function.__code__.co_varnames[: len(arguments)]
        given = [f"view({name})" if isinstance(of, types.Array) else name for name, of in zip(names, arguments)]
        text = f"def {function.__name__}({', '.join(names)}):\n    return part({', '.join(given)})"
        scope: dict[str, Any] = {"__name__": function.__module__, "part": kernel(function), "view": view}
        # by its file numba knows where the machine code is kept
        exec(compile(text, function.__code__.co_filename, "exec"), scope)
        return entry_kernel(*arguments, when=when)(functools.wraps(function)(scope[function.__name__]))

    return decorate
