"""Named arrays, and the one table of addresses through which the compiled kernels see them.

Unpacking ten array arguments costs a kernel call 0.7 us, as much as Pinocchio needs for a free body. So every entry
kernel takes one int64 table; slot i of it is the address of array i, and `reals`, `integers`, `matrix`, `cube` make
views of the arrays without copying. Pinocchio's own `data` is read in place in the same way.

The owner of the arrays (`Memory`) must outlive every kernel call on its table, and no array in it may be resized.
"""

from __future__ import annotations

import ctypes
import math
from functools import cache
from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic

from .jit import CHECKED

if numba.config.DISABLE_JIT:
    # The same views in plain Python, so that every kernel also runs (slowly) without compilation.
    def _view(address: int, shape: tuple[int, ...], kind: Any) -> np.ndarray:
        count = int(np.prod(shape))
        if CHECKED and 8 * count > _room.get(int(address), 0):
            raise IndexError(f"a view of {count} numbers on an array of {_room.get(int(address), 0) // 8}")
        if count == 0:
            return np.zeros(shape, dtype=np.float64 if kind is ctypes.c_double else np.int64)
        pointer = ctypes.cast(int(address), ctypes.POINTER(kind))
        return np.ctypeslib.as_array(pointer, shape=(count,)).reshape(shape)

    def reals(address, n):
        return _view(address, (n,), ctypes.c_double)

    def integers(address, n):
        return _view(address, (n,), ctypes.c_int64)

    def integer_matrix(address, n, m):
        return _view(address, (n, m), ctypes.c_int64)

    def matrix(address, n, m):
        return _view(address, (n, m), ctypes.c_double)

    def cube(address, n, m, k):
        return _view(address, (n, m, k), ctypes.c_double)

else:

    def _view_intrinsic(dimensions: int, item: Any) -> Any:
        """An intrinsic f(address, n, ...) that makes a C-contiguous view, with no reference counted."""
        array_type = types.Array(item, dimensions, "C")

        def implementation(typing_context, *arguments):
            def generate(context, builder, signature, values):
                address, shape = values[0], list(values[1:])
                # see `jit_lowering`
                make_view = getattr(context, "make_view", None)
                if make_view is not None:
                    data = builder.inttoptr(address, context.get_value_type(item).as_pointer())
                    return make_view(builder, array_type, data, shape)
                # imported when code is generated: it costs as much as the rest of the package
                from numba.np.arrayobj import make_array, populate_array

                size = context.get_constant(types.intp, item.bitwidth // 8)
                strides = [size]
                for extent in reversed(shape[1:]):
                    strides.insert(0, builder.mul(strides[0], extent))
                view = make_array(array_type)(context, builder)
                data = builder.inttoptr(address, context.get_value_type(item).as_pointer())
                populate_array(view, data=data, shape=shape, strides=strides, itemsize=size, meminfo=None)
                return view._getvalue()

            return array_type(*(types.int64,) * (1 + dimensions)), generate

        # numba reads the number of arguments off the signature
        shapes = {
            1: lambda typing_context, address, n: implementation(typing_context, address, n),
            2: lambda typing_context, address, n, m: implementation(typing_context, address, n, m),
            3: lambda typing_context, address, n, m, k: implementation(typing_context, address, n, m, k),
        }
        return intrinsic(shapes[dimensions])

    # reals(address, n), integers(address, n): views (n,) of the memory at an address;
    # matrix, integer_matrix (address, n, m) and cube (address, n, m, k): rows contiguous.
    reals = _view_intrinsic(1, types.float64)
    integers = _view_intrinsic(1, types.int64)
    matrix = _view_intrinsic(2, types.float64)
    integer_matrix = _view_intrinsic(2, types.int64)
    cube = _view_intrinsic(3, types.float64)


# Numbers in the pieces that memory is taken in, and on whose multiples arrays begin (64 bytes).
_CHUNK = 4096
_ALIGNMENT = 8


# Of arrays whose addresses were asked for: how many bytes there are from there on. Kept by the checked build only.
_room: dict[int, int] = {}


def address_of(array: np.ndarray) -> int:
    """The address of an array's first element."""
    address = int(array.__array_interface__["data"][0])
    if CHECKED:
        _room[address] = array.nbytes
    return address


_NOTHING = np.zeros(0)
# What the checked build finds in integers that nobody has written: no index.
_UNSET = -(1 << 40)
_REAL, _INTEGER = np.dtype(np.float64), np.dtype(np.int64)


@cache
def _numbers(slots: tuple[str, ...]) -> dict[str, int]:
    return {name: i for i, name in enumerate(slots)}


class Memory:
    """Arrays by name, in the order of `slots`, and the table of their addresses."""

    _piece: np.ndarray
    _cut_off: int

    def __init__(self, slots: tuple[str, ...]):
        self._slots = _numbers(slots)
        self.table = np.zeros(len(slots), dtype=np.int64)
        self._arrays: dict[str, np.ndarray] = {}
        # new arrays are cut from one: a fraction of the time of making each
        self._pieces: list[np.ndarray] = []
        self._address = 0
        # names of what has come since `keep`, and what they stood for then
        self._since: dict[str, np.ndarray | None] = {}
        self._start_piece()

    def put(self, name: str, array: np.ndarray, address: int = 0) -> np.ndarray:
        """Place an array in its slot; it is kept alive as long as this memory is. address: its own, where known."""
        self._name(name, array)
        self.table[self._slots[name]] = address_of(array) if CHECKED or not address else address
        return array

    def reals(self, name: str, *shape: int) -> np.ndarray:
        """A new zero float64 array in the slot of that name."""
        return self._cut(name, shape, _REAL)

    def integers(self, name: str, *shape: int) -> np.ndarray:
        """A new zero int64 array in the slot of that name."""
        return self._cut(name, shape, _INTEGER)

    def scratch(self, name: str, *shape: int) -> np.ndarray:
        """A new float64 array that is to be written before it is read: NaN in the checked build."""
        array = self.reals(name, *shape)
        if CHECKED:
            array.fill(math.nan)
        return array

    def integer_scratch(self, name: str, *shape: int) -> np.ndarray:
        """The same for int64, where the checked build puts a number that is no index."""
        array = self.integers(name, *shape)
        if CHECKED:
            array.fill(_UNSET)
        return array

    def _cut(self, name: str, shape: tuple[int, ...], kind: Any) -> np.ndarray:
        room = -(-math.prod(shape) // _ALIGNMENT) * _ALIGNMENT
        start = self._cut_off
        if start + room > self._piece.size:
            self._piece, start = np.zeros(max(room, _CHUNK)), 0
            self._pieces.append(self._piece)
            self._address = address_of(self._piece)
        self._cut_off = start + room
        array = np.ndarray(shape, kind, self._piece, 8 * start)
        self._name(name, array)
        self.table[self._slots[name]] = address_of(array) if CHECKED else self._address + 8 * start
        return array

    def _name(self, name: str, array: np.ndarray) -> None:
        if name not in self._since:
            self._since[name] = self._arrays.get(name)
        self._arrays[name] = array

    def keep(self) -> None:
        """Remember all there is now, for `restore`."""
        # of the last piece what arrays have been cut from: a copy should not drive them out of the processor's cache
        used = [*self._pieces[:-1], *(piece[: self._cut_off] for piece in self._pieces[-1:])]
        self._kept = len(self._pieces), [(part, part.copy()) for part in used], self.table.copy()
        self._since.clear()
        self._start_piece()

    def restore(self) -> None:
        """Make everything what it was at `keep`, bit by bit: arrays made since are gone, those put here stay theirs."""
        pieces, used, table = self._kept
        for part, values in used:
            np.copyto(part, values)
        del self._pieces[pieces:]
        self.table[:] = table
        for name, array in self._since.items():
            if array is None:
                del self._arrays[name]
            else:
                self._arrays[name] = array
        self._since.clear()
        self._start_piece()

    def _start_piece(self) -> None:
        """Let the next array be cut from a new piece, where all is zero."""
        self._piece, self._cut_off = _NOTHING, 0

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]
