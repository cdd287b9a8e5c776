"""Whether a function is still the one that it was: a hash of what it does."""

from __future__ import annotations

import ast
import hashlib
import inspect
import io
import pickle
import textwrap
from types import CellType, CodeType, FunctionType
from typing import Any

import numpy as np


def fingerprint(function: Any) -> str:
    """Names what a function does: its code, defaults and enclosed values, and whatever of its own module it uses.

    Comments, blank lines and other modules do not count.
    """
    pickled = io.BytesIO()
    _Descriptions(pickled).dump(function)
    return hashlib.sha256(pickled.getvalue()).hexdigest()[:16]


class _Descriptions(pickle.Pickler):
    """Pickles values with the code of functions and classes in place of their names."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file, protocol=4)
        # no memo: whether two equal values are one object differs between processes
        self.fast = True
        self._seen: set[Any] = set()

    def persistent_id(self, value: Any) -> Any:
        if isinstance(value, (set, frozenset)):
            # the order of texts in them changes from process to process
            return sorted(map(repr, value))
        if not isinstance(value, (FunctionType, type)):
            return None
        if value in self._seen:
            return value.__qualname__
        self._seen.add(value)
        return (_code(value), *(_enclosed(value) if isinstance(value, FunctionType) else ()))

    def reducer_override(self, value: Any) -> Any:
        try:
            return value.__reduce_ex__(4)
        except TypeError:
            # what cannot be stored, such as a lock
            return str, (type(value).__qualname__,)


def _enclosed(function: FunctionType) -> list[Any]:
    """Values that a function brings with it, and those of its module that it uses."""
    cells = [cell.cell_contents for cell in function.__closure__ or () if cell != _EMPTY]
    out = [function.__defaults__, function.__kwdefaults__, *cells]
    for name in sorted(_names(function.__code__)):
        used = function.__globals__.get(name)
        own = getattr(used, "__module__", None) == function.__module__
        if own or isinstance(used, (bool, int, float, str, tuple, np.ndarray)):
            out += [name, used]
    return out


# a variable that has no value yet
_EMPTY = CellType()


def _names(code: CodeType) -> set[str]:
    inner = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    return set(code.co_names).union(*(_names(constant) for constant in inner))


def _code(value: Any) -> Any:
    """Source without comments and layout; the compiled code where there is no source."""
    try:
        return ast.dump(ast.parse(textwrap.dedent(inspect.getsource(value))))
    except (OSError, TypeError, SyntaxError):
        code = getattr(value, "__code__", None)
        return repr(value) if code is None else _compiled(code)


def _compiled(code: CodeType) -> list[Any]:
    constants = [_compiled(c) if isinstance(c, CodeType) else c for c in code.co_consts]
    return [code.co_code, constants, code.co_names]
