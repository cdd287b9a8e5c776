"""Compilation of the numerical kernels: once, cached on disk, announced.

Two decorators. `kernel` marks a part that other kernels call; `entry_kernel` marks what Python calls. Every
entry kernel takes one table of addresses and sizes (see `memory.py`), so that one compiled signature serves
every scene and a call costs a fraction of a microsecond.

Numba invalidates a cached function when its own file changes, not when a callee in another file does. Each
entry kernel's cache directory is therefore keyed by a hash of its module's source and of all that it imports.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import njit, types

from .jit_parts import EntryCompiler, PartCompiler

_PACKAGE = Path(__file__).parent
# Kernels allocate nothing and return no arrays: reference counting, dearer than the numerics, is left out. They keep
# the interpreter's lock: some call back into Python.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}

_PART_OPTIONS: dict[str, Any] = (
    {"pipeline_class": PartCompiler, "no_cpython_wrapper": True, "no_cfunc_wrapper": True} if PartCompiler else {}
)
_ENTRY_OPTIONS: dict[str, Any] = {"pipeline_class": EntryCompiler} if EntryCompiler else {}


_IMPORT = re.compile(r"^ *from (\.+)([\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_texts: dict[Path, bytes] = {}
_imports: dict[Path, list[Path]] = {}


def _imported_files(file: Path) -> list[Path]:
    """The package's files that a file of it imports."""
    if file in _imports:
        return _imports[file]
    _texts[file] = file.read_bytes()
    found = []
    for dots, module, names in _IMPORT.findall(_texts[file].decode()):
        base = file.parents[len(dots) - 1].joinpath(*filter(None, module.split(".")))
        candidates = [base.with_suffix(".py"), base / "__init__.py"]
        candidates += [base / f"{name}.py" for name in re.findall(r"\w+", names)]
        found += [path for path in candidates if path.is_file()]
    _imports[file] = found
    return found


def source_hash(file: Path) -> str:
    """Key of all that the machine code of a file's kernels depends on: it, what it imports, numba, where they are."""
    reached = {file}
    waiting = [file]
    while waiting:
        for path in _imported_files(waiting.pop()):
            if path not in reached:
                reached.add(path)
                waiting.append(path)
    # numba keeps machine code by the path of its source, so another copy of the package is another cache
    digest = hashlib.sha256(f"{numba.__version__} {_PACKAGE}".encode())
    for path in sorted(reached):
        digest.update(_texts[path])
    return digest.hexdigest()[:16]


def cache_root() -> Path:
    """Where compiled kernels are kept: `NUMBA_CACHE_DIR` if set, else the user's cache folder."""
    if numba.config.CACHE_DIR:
        base = Path(numba.config.CACHE_DIR)
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", str(Path.home() / "AppData" / "Local")))
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache")))
    return base / "pincontact"


_CACHE = cache_root()
# entry kernels: compiled function, argument types, whether compiled aside, cache directory
ENTRIES: list[tuple[Any, tuple[Any, ...], bool, Path]] = []


# how many of them are known to be compiled
_complete = 0


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """A numerical routine called by other kernels; compiled into its callers, and not callable from Python."""
    if numba.config.DISABLE_JIT:
        return function
    part = njit(**_OPTIONS, **_PART_OPTIONS)(function)
    call_template = part.get_call_template

    def one_version(arguments: Any, keywords: dict[str, Any]) -> Any:
        """Not a version for each constant argument: inlining sees the constants anyway."""
        plain = {name: types.unliteral(argument) for name, argument in keywords.items()}
        return call_template([types.unliteral(argument) for argument in arguments], plain)

    part.get_call_template = one_version
    return part


def entry_kernel(*arguments: Any, aside: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A routine called from Python with arguments of these numba types; compiled once and cached on disk.

    aside: compiled in a second process, while the first compiles those that share their parts with each other.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        previous = numba.config.CACHE_DIR
        directory = _CACHE / source_hash(Path(function.__code__.co_filename))
        numba.config.CACHE_DIR = str(directory)
        try:
            compiled = njit(cache=True, **_OPTIONS, **_ENTRY_OPTIONS)(function)
        finally:
            numba.config.CACHE_DIR = previous
        ENTRIES.append((compiled, arguments, aside, directory))
        return compiled

    return decorate


# A file in a cache directory whose kernels are all compiled.
_MARKER = "compiled"
TABLE = types.int64[::1]
INTEGER = types.int64
REAL = types.float64


def compile_kernels() -> None:
    """Compile every entry kernel that has no machine code on disk yet, with one line to the user.

    Done before the first scene runs; later processes load from disk what they use, when they use it. Kernels
    marked `aside` are compiled in a second process meanwhile.
    """
    global _complete
    if numba.config.DISABLE_JIT or _complete == len(ENTRIES):
        return
    missing = [marked for *_, marked, directory in ENTRIES if not (directory / _MARKER).exists()]
    if not missing:
        _complete = len(ENTRIES)
        return
    print("pincontact: compiling kernels, once for this version (under half a minute) ...", file=sys.stderr)
    worker = _start_worker() if any(missing) and not all(missing) else None
    compile_share(aside=False)
    if worker is not None:
        worker.wait()
    # what the worker has compiled is loaded from disk; without a worker this is where it gets done
    compile_share(aside=True)
    for *_, directory in ENTRIES:
        try:
            directory.mkdir(parents=True, exist_ok=True)
            (directory / _MARKER).touch()
        except OSError:
            pass


def compile_share(aside: bool) -> None:
    """Compile the kernels marked `aside`, or the others."""
    for compiled, arguments, marked, directory in ENTRIES:
        if marked == aside and not (directory / _MARKER).exists():
            compiled.compile(arguments)


def _start_worker() -> subprocess.Popen[bytes] | None:
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(os.path.abspath(path) for path in sys.path if path))
    modules = ", ".join(sorted({compiled.py_func.__module__ for compiled, *_ in ENTRIES}))
    command = f"import {modules}; from pincontact.jit import compile_share; compile_share(aside=True)"
    try:
        # from where this package lies: another checkout in the present folder would be imported first
        return subprocess.Popen(
            [sys.executable, "-c", command],
            cwd=_PACKAGE.parent,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None
