"""Whether a function is still the one that it was: a hash of what it does."""

from __future__ import annotations

import ast
import hashlib
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import partial
from types import CodeType, FunctionType
from typing import Any

import numpy as np


def fingerprint(function: Any) -> str:
    """Names what a function does: its code, defaults and enclosed values, and whatever of its own module it uses.

    Comments, blank lines and other modules do not count.
    """
    digest = hashlib.sha256()
    for part in _described(function, set()):
        digest.update(part.encode())
    return digest.hexdigest()[:16]


def _described(value: Any, seen: set[int]) -> Iterator[str]:
    if id(value) in seen:
        return
    if isinstance(value, FunctionType):
        seen.add(id(value))
        yield _code(value)
        yield from _described(value.__defaults__ or (), seen)
        yield from _described(value.__kwdefaults__ or {}, seen)
        for cell in value.__closure__ or ():
            with suppress(ValueError):
                yield from _described(cell.cell_contents, seen)
        for name in sorted(_names(value.__code__)):
            used = value.__globals__.get(name)
            own = getattr(used, "__module__", None) == value.__module__
            if own or isinstance(used, (bool, int, float, str, tuple, np.ndarray)):
                yield name
                yield from _described(used, seen)
    elif isinstance(value, partial):
        for part in (value.func, value.args, value.keywords):
            yield from _described(part, seen)
    elif isinstance(value, type):
        seen.add(id(value))
        yield _code(value)
    elif inspect.ismethod(value):
        yield from _described(value.__func__, seen)
        yield from _described(value.__self__, seen)
    elif isinstance(value, Mapping):
        for name in value:
            yield repr(name)
            yield from _described(value[name], seen)
    elif isinstance(value, (list, tuple)):
        for entry in value:
            yield from _described(entry, seen)
    elif isinstance(value, np.ndarray):
        yield f"{value.shape}{value.dtype}{hashlib.sha256(value.tobytes()).hexdigest()}"
    elif value is None or isinstance(value, (bool, int, float, complex, str, bytes)):
        yield repr(value)
    elif hasattr(value, "__dict__"):
        seen.add(id(value))
        yield from _described(type(value), seen)
        yield from _described(vars(value), seen)
    else:
        yield type(value).__qualname__


def _names(code: CodeType) -> set[str]:
    inner = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    return set(code.co_names).union(*(_names(constant) for constant in inner))


def _code(value: Any) -> str:
    """Source without comments and layout; the compiled code where there is no source."""
    try:
        return ast.dump(ast.parse(textwrap.dedent(inspect.getsource(value))))
    except (OSError, TypeError, SyntaxError):
        code = getattr(value, "__code__", None)
        return repr(value) if code is None else _compiled(code)


def _compiled(code: CodeType) -> str:
    constants = [
        # the order of a set of texts changes from process to process
        _compiled(c) if isinstance(c, CodeType) else repr(sorted(c, key=repr) if isinstance(c, frozenset) else c)
        for c in code.co_consts
    ]
    return f"{code.co_code.hex()}{constants}{code.co_names}"
