"""Arrays that compiled kernels and Python see under the same names.

A `Layout` declares arrays, once: name, kind of number, dimensions. A `Workspace` holds the arrays of one layout. To a
kernel it is a single value, the address of a table of its arrays' addresses and extents: `system.mass[i, j]` reads
the array in place, whatever its size, so one compiled kernel serves every scene, and a call costs a fraction of a
microsecond. Python uses the same names; Pinocchio's own `data` is read in place in the same way.

A workspace must outlive every kernel call that is given it, and no array in it may be resized.
"""

from __future__ import annotations

import ctypes
import math
from functools import cache
from itertools import compress, takewhile
from typing import TYPE_CHECKING, Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, lower_getattr_generic, models, register_model

from .arrays import INTEGERS, REALS, ROOM, address_of, array_type, item_type, make_view, parts_of
from .jit import CHECKED

# Words of an array in a workspace's table: its address and up to three extents.
_WORDS = 4


def record(kind: np.dtype[Any], *names: str) -> np.dtype[Any]:
    """A record of numbers of one kind."""
    return np.dtype([(name, kind) for name in names])


class Scratch(NamedTuple):
    """What an array holds that is written before it is read."""

    kind: np.dtype[Any]


class Layout:
    """Names, kinds and extents of the arrays of a kind of workspace.

    arrays: name -> (REALS, INTEGERS or a record's dtype, or one of these as `Scratch`, and the extents, none for a
    single record: numbers, or names of sizes that a workspace is given, see `Workspace.allocate`)
    """

    def __init__(self, name: str, **arrays: tuple[Any, ...]):
        self.name = name
        self.scratch = {array for array, (kind, *_) in arrays.items() if isinstance(kind, Scratch)}
        self.extents: dict[str, tuple[Any, ...]] = {array: declared[1:] for array, declared in arrays.items()}
        kinds = {
            array: declared[0].kind if array in self.scratch else declared[0] for array, declared in arrays.items()
        }
        self.arrays = {array: (kind, len(self.extents[array])) for array, kind in kinds.items()}
        # the last extents, where they are the same in all workspaces, are constants to kernels
        self.inner = {array: _numbers_at_end(extents[1:]) for array, extents in self.extents.items()}
        self.places = {array: i for i, array in enumerate(arrays)}
        self._known: dict[tuple[str, ...], list[tuple[str, tuple[Any, ...]]]] = {}
        # numba's type of such a workspace, and `at(address)` for entry kernels, which are given the address
        self.type = _TYPES[name] = WorkspaceType(self)
        self.at = _workspace_at(self.type)

    def known_by(self, sizes: tuple[str, ...]) -> list[tuple[str, tuple[Any, ...]]]:
        """Arrays and extents, of those whose extents are numbers, or among these sizes."""
        if sizes not in self._known:
            known = [all(isinstance(extent, int) or extent in sizes for extent in of) for of in self.extents.values()]
            self._known[sizes] = list(compress(self.extents.items(), known))
        return self._known[sizes]


def _numbers_at_end(extents: tuple[Any, ...]) -> tuple[int, ...]:
    numbers = len(list(takewhile(lambda extent: isinstance(extent, int), reversed(extents))))
    return extents[len(extents) - numbers :]


class WorkspaceType(types.Record):
    """numba's type of workspaces of one layout: a record of addresses and extents, whose fields read as arrays."""

    def __init__(self, layout: Layout):
        words = types.NestedArray(types.int64, (_WORDS,))
        fields = [(name, {"type": words, "offset": 8 * _WORDS * i}) for i, name in enumerate(layout.arrays)]
        super().__init__(fields, 8 * _WORDS * len(fields), True)
        self.name = f"Workspace({layout.name})"
        self.layout = layout

    def __reduce__(self) -> Any:
        # numba keeps the types of arguments beside machine code
        return _workspace_type, (self.layout.name,)

    def typeof(self, key: str) -> Any:
        return array_type(*self.layout.arrays[key])


_TYPES: dict[str, WorkspaceType] = {}


def _workspace_type(name: str) -> WorkspaceType:
    return _TYPES[name]


def _workspace_at(kind: WorkspaceType) -> Any:
    if numba.config.DISABLE_JIT:
        return lambda given: given if isinstance(given, Workspace) else ctypes.cast(int(given), ctypes.py_object).value

    @intrinsic
    def at(typing_context, address):
        def generate(context, builder, signature, values):
            return builder.inttoptr(values[0], context.get_value_type(kind))

        return kind(types.int64), generate

    return at


def _loaded(builder: Any, table: Any, place: int) -> Any:
    """A word of a table."""
    word = ir.IntType(64)
    return builder.load(builder.gep(builder.bitcast(table, word.as_pointer()), [ir.Constant(word, place)]))


register_model(WorkspaceType)(models.RecordModel)


@lower_getattr_generic(WorkspaceType)
def _attribute(context: Any, builder: Any, kind: WorkspaceType, value: Any, name: str) -> Any:
    item, dimensions = kind.layout.arrays[name]
    first = _WORDS * kind.layout.places[name]
    kind_of_array = array_type(item, dimensions)
    inner = [ir.Constant(ir.IntType(64), extent) for extent in kind.layout.inner[name]]
    words = [_loaded(builder, value, first + i) for i in range(1 + dimensions - len(inner))] + inner
    if not dimensions:
        return builder.inttoptr(words[0], context.get_value_type(kind_of_array))
    pointer = builder.inttoptr(words[0], context.get_data_type(item_type(item)).as_pointer())
    return make_view(context, builder, kind_of_array, pointer, words[1:])


def _at_address(dimensions: int, item: np.dtype[Any]) -> Any:
    """`f(address, *shape)` for kernels: a view of the memory at an address, rows contiguous."""
    if numba.config.DISABLE_JIT:
        kind = ctypes.c_double if item == REALS else ctypes.c_int64

        def view(address: int, *shape: int) -> np.ndarray:
            count = math.prod(shape)
            if CHECKED and 8 * count > ROOM.get(int(address), 0):
                raise IndexError(f"a view of {count} numbers on an array of {ROOM.get(int(address), 0) // 8}.")
            if count == 0:
                return np.zeros(shape, item)
            pointer = ctypes.cast(int(address), ctypes.POINTER(kind))
            return np.ctypeslib.as_array(pointer, shape=(count,)).reshape(shape)

        return view
    kind = array_type(item, dimensions)

    def typed() -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            pointer = builder.inttoptr(values[0], context.get_data_type(item_type(item)).as_pointer())
            return make_view(context, builder, kind, pointer, list(values[1:]))

        return kind(*(types.int64,) * (1 + dimensions)), generate

    # numba reads the number of arguments off the signature
    if dimensions == 1:
        return intrinsic(lambda typing_context, address, n: typed())
    return intrinsic(lambda typing_context, address, n, m: typed())


# `reals_at(address, n)`, `integers_at(address, n)`, `matrix_at(address, n, m)`, `integer_matrix_at(address, n, m)`
reals_at, integers_at = _at_address(1, REALS), _at_address(1, INTEGERS)
matrix_at, integer_matrix_at = _at_address(2, REALS), _at_address(2, INTEGERS)

if numba.config.DISABLE_JIT:

    def flat(array):
        return array.reshape(-1)

    def square(array, n):
        return array[: n * n].reshape(n, n)

else:

    @intrinsic
    def flat(typing_context, array):
        """All numbers of an array of reals, as a vector."""

        def generate(context, builder, signature, values):
            data, shape = parts_of(context, builder, array, values[0])
            size = shape[0]
            for extent in shape[1:]:
                size = builder.mul(size, extent)
            return make_view(context, builder, signature.return_type, data, [size])

        return array_type(REALS, 1)(array), generate

    @intrinsic
    def square(typing_context, array, n):
        """The first n^2 numbers of a vector of reals as a matrix (n, n)."""

        def generate(context, builder, signature, values):
            data, _ = parts_of(context, builder, array, values[0])
            return make_view(context, builder, signature.return_type, data, [values[1], values[1]])

        return array_type(REALS, 2)(array, types.int64), generate


# Numbers in the pieces that memory is taken in, and on whose multiples arrays begin (64 bytes).
_CHUNK = 4096
_ALIGNMENT = 8
_NOTHING = np.zeros(0)
# What the checked build finds in integers that nobody has written: no index.
_UNSET = -(1 << 40)


class Numbers(ctypes.Structure):
    """A single record, whose numbers are attributes, as they are to kernels; by their names they are those of
    NumPy's records, which take as long to read one as it takes to call a kernel."""

    __slots__ = ()
    dtype: np.dtype[Any]

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    def __getitem__(self, name: str | list[str]) -> Any:
        return np.ndarray((), self.dtype, memoryview(self))[name][()]

    def __setitem__(self, name: str | list[str], number: Any) -> None:
        np.ndarray((), self.dtype, memoryview(self))[name] = number


@cache
def _numbers(kind: np.dtype[Any]) -> type[Numbers]:
    """The class of such records."""
    words = {REALS: ctypes.c_double, INTEGERS: ctypes.c_int64}
    fields = [(name, words[part]) for name, (part, *_) in (kind.fields or {}).items()]
    return type("Numbers", (Numbers,), {"__slots__": (), "_fields_": fields, "dtype": kind})


def by_name(array: np.ndarray) -> Any:
    """The array, or its single record, with fields that uncompiled kernels read as attributes."""
    if array.ndim == 0:
        return _numbers(array.dtype).from_buffer(array.data)
    return array.view(np.recarray) if array.dtype.names and numba.config.DISABLE_JIT else array


class Workspace:
    """The arrays of one layout, by name."""

    _piece: np.ndarray
    _cut_off: int

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    def __init__(self, layout: Layout):
        self.layout = layout
        self.table = np.zeros((len(layout.arrays), _WORDS), dtype=np.int64)
        # what kernels are given
        self.address = id(self) if numba.config.DISABLE_JIT else address_of(self.table)
        # new arrays are cut from one: a fraction of the time of making each
        self._pieces: list[np.ndarray] = []
        self._at = 0
        self._piece, self._cut_off = _NOTHING, 0

    if CHECKED:

        def __setattr__(self, name: str, value: Any) -> None:
            # kernels would go on reading the array that was there; `array += 1` assigns the same one
            if name != "layout" and name in self.layout.arrays and value is not self.__dict__.get(name):
                raise AttributeError(f"{name} is an array of kernels: put it.")
            super().__setattr__(name, value)

    def put(self, name: str, array: np.ndarray, address: int = 0) -> np.ndarray:
        """Place an array under its name; it is kept alive as long as this workspace is. address: its own, if known."""
        self._place(name, array, address_of(array) if CHECKED or not address else address)
        return array

    def allocate(self, **sizes: int) -> None:
        """Make the arrays that are not there yet and whose extents are numbers, or among these sizes."""
        for name, extents in self.layout.known_by(tuple(sizes)):
            if name not in self.__dict__:
                make = self.scratch if CHECKED and name in self.layout.scratch else self.zeros
                make(name, *[sizes.get(extent, extent) for extent in extents])

    def zeros(self, name: str, *shape: int) -> np.ndarray:
        """A new array of zeros under that name."""
        item = self.layout.arrays[name][0]
        words = math.prod(shape) * (item.itemsize // 8)
        room = -(-words // _ALIGNMENT) * _ALIGNMENT
        start = self._cut_off
        if start + room > self._piece.size:
            self._piece, start = np.zeros(max(room, _CHUNK)), 0
            self._pieces.append(self._piece)
            self._at = address_of(self._piece)
        self._cut_off = start + room
        array: np.ndarray = np.ndarray(shape, item, self._piece, 8 * start)
        self._place(name, array, address_of(array) if CHECKED else self._at + 8 * start)
        return array

    def scratch(self, name: str, *shape: int) -> np.ndarray:
        """A new array that is to be written before it is read: NaN, or no index, in the checked build."""
        array = self.zeros(name, *shape)
        for part in [array[field] for field in array.dtype.names or ()] or [array] if CHECKED else ():
            part.fill(math.nan if part.dtype == REALS else _UNSET)
        return array

    def _place(self, name: str, array: np.ndarray, address: int) -> None:
        inner, dimensions = self.layout.inner[name], self.layout.arrays[name][1]
        if array.ndim != dimensions or array.shape[array.ndim - len(inner) :] != inner:
            raise ValueError(f"{name} is declared with {dimensions} extents, {inner} the last, got {array.shape}.")
        self.__dict__[name] = by_name(array)
        self.table[self.layout.places[name], : 1 + array.ndim] = (address, *array.shape)

    def keep(self) -> None:
        """Remember all numbers, and what every name stands for, for `restore`."""
        named = {name: self.__dict__[name] for name in self.layout.arrays if name in self.__dict__}
        self._kept = [(piece, piece.copy()) for piece in self._pieces], self.table.copy(), named

    def restore(self) -> None:
        """Make everything what it was at `keep`, bit by bit: of arrays put here since, the workspace forgets where they
        are."""
        pieces, table, named = self._kept
        for piece, values in pieces:
            np.copyto(piece, values)
        self.table[:] = table
        self.__dict__.update(named)
