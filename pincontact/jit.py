"""Compilation of the numerical kernels: once, cached on disk, announced.

Two decorators. `kernel` marks a part that other kernels call; `entry_kernel` marks what Python calls. Every
entry kernel takes one table of addresses and sizes (see `memory.py`), so that one compiled signature serves
every scene and a call costs a fraction of a microsecond.

Numba invalidates a cached function when its own file changes, not when a callee in another file does. The
cache directory is therefore keyed by a hash of all of the package's sources.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import njit, types

from .jit_parts import PartCompiler

_PACKAGE = Path(__file__).parent
# Kernels allocate nothing and return no arrays: reference counting, dearer than the numerics, is left out.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True, "_nrt": False}

_PART_OPTIONS: dict[str, Any] = (
    {"pipeline_class": PartCompiler, "no_cpython_wrapper": True, "no_cfunc_wrapper": True} if PartCompiler else {}
)


def _source_hash() -> str:
    # numba keeps machine code by the path of its source, so another copy of the package is another cache
    digest = hashlib.sha256(f"{numba.__version__} {_PACKAGE}".encode())
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cache_directory() -> Path:
    """Where the compiled kernels of this version of the package are kept.

    `NUMBA_CACHE_DIR` is honoured; the default is the user's cache folder.
    """
    if numba.config.CACHE_DIR:
        base = Path(numba.config.CACHE_DIR)
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", str(Path.home() / "AppData" / "Local")))
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache")))
    return base / "pincontact" / _source_hash()


_CACHE = cache_directory()
_SIGNATURES: list[tuple[Any, tuple[Any, ...], bool]] = []


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """A numerical routine called by other kernels; compiled into its callers, and not callable from Python."""
    return njit(**_OPTIONS, **_PART_OPTIONS)(function)


def entry_kernel(*arguments: Any, aside: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A routine called from Python with arguments of these numba types; compiled once and cached on disk.

    aside: compiled in a second process, while the first compiles those that share their parts with each other.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        previous = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(_CACHE)
        try:
            compiled = njit(cache=True, **_OPTIONS)(function)
        finally:
            numba.config.CACHE_DIR = previous
        _SIGNATURES.append((compiled, arguments, aside))
        return compiled

    return decorate


TABLE = types.int64[::1]
INTEGER = types.int64
REAL = types.float64


def compile_kernels() -> None:
    """Compile every entry kernel that has no machine code on disk yet, with one line to the user.

    Done before the first scene runs; later processes load from disk what they use, when they use it. Kernels
    marked `aside` are compiled in a second process meanwhile.
    """
    if numba.config.DISABLE_JIT:
        return
    marker = _CACHE / f"compiled-{len(_SIGNATURES)}"
    if marker.exists():
        return
    print("pincontact: compiling kernels, once for this version (under half a minute) ...", file=sys.stderr)
    worker = _start_worker()
    compile_share(aside=False)
    if worker is not None:
        worker.wait()
    # what the worker has compiled is loaded from disk; without a worker this is where it gets done
    compile_share(aside=True)
    try:
        _CACHE.mkdir(parents=True, exist_ok=True)
        marker.touch()
    except OSError:
        pass


def compile_share(aside: bool) -> None:
    """Compile the kernels marked `aside`, or the others."""
    for compiled, arguments, marked in _SIGNATURES:
        if marked == aside:
            compiled.compile(arguments)


def _start_worker() -> subprocess.Popen[bytes] | None:
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path))
    command = "import pincontact; from pincontact.jit import compile_share; compile_share(aside=True)"
    try:
        return subprocess.Popen(
            [sys.executable, "-c", command], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
    except OSError:
        return None
