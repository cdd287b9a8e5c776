"""Named arrays, and the one table of addresses through which the compiled kernels see them.

Unpacking ten array arguments costs a kernel call 0.7 us, as much as Pinocchio needs for a free body. So every entry
kernel takes one int64 table; slot i of it is the address of array i, and `reals`, `integers`, `matrix`, `cube` make
views of the arrays without copying. Pinocchio's own `data` is read in place in the same way.

The owner of the arrays (`Memory`) must outlive every kernel call on its table, and no array in it may be resized.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numba
import numpy as np
from numba import carray, types
from numba.core import cgutils
from numba.extending import intrinsic

from .jit import kernel

if numba.config.DISABLE_JIT:
    # The same views in plain Python, so that every kernel also runs (slowly) without compilation.
    def _view(address: int, shape: tuple[int, ...], kind: Any) -> np.ndarray:
        count = int(np.prod(shape))
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

    @intrinsic
    def _real_pointer(typing_context, address):
        def generate(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], cgutils.voidptr_t)

        return types.voidptr(types.int64), generate

    @kernel
    def reals(address, n):
        """float64 view (n,) of the memory at address."""
        return carray(_real_pointer(address), (n,), np.float64)

    @kernel
    def integers(address, n):
        """int64 view (n,) of the memory at address."""
        return carray(_real_pointer(address), (n,), np.int64)

    @kernel
    def integer_matrix(address, n, m):
        """int64 view (n, m), rows contiguous."""
        return carray(_real_pointer(address), (n, m), np.int64)

    @kernel
    def matrix(address, n, m):
        """float64 view (n, m), rows contiguous."""
        return carray(_real_pointer(address), (n, m), np.float64)

    @kernel
    def cube(address, n, m, k):
        """float64 view (n, m, k), last index contiguous."""
        return carray(_real_pointer(address), (n, m, k), np.float64)


def address_of(array: np.ndarray) -> int:
    """The address of an array's first element."""
    return int(array.__array_interface__["data"][0])


class Memory:
    """Arrays by name, in the order of `slots`, and the table of their addresses."""

    def __init__(self, slots: tuple[str, ...]):
        self._slots = {name: i for i, name in enumerate(slots)}
        self.table = np.zeros(len(slots), dtype=np.int64)
        self._arrays: dict[str, np.ndarray] = {}

    def put(self, name: str, array: np.ndarray) -> np.ndarray:
        """Place an array in its slot; it is kept alive as long as this memory is."""
        self._arrays[name] = array
        self.table[self._slots[name]] = address_of(array)
        return array

    def reals(self, name: str, *shape: int) -> np.ndarray:
        """A new zero float64 array in the slot of that name."""
        return self.put(name, np.zeros(shape))

    def integers(self, name: str, *shape: int) -> np.ndarray:
        """A new zero int64 array in the slot of that name."""
        return self.put(name, np.zeros(shape, dtype=np.int64))

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]
