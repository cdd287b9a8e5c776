"""Compilation of the numerical kernels: once, cached on disk, announced.

Three decorators. `kernel` marks a part that other kernels call, `inlined_kernel` one that a single kernel calls, and
`entry_kernel` what Python calls. An entry kernel takes the address of a workspace (see `workspace.py`), so that one
compiled signature serves every scene and a call costs a fraction of a microsecond.

Numba invalidates a cached function when its own file changes, not when a callee in another file does. Each
entry kernel's cache directory is therefore keyed by a hash of its module's source and of all that it imports.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numba
from numba import njit, types
from numba.extending import register_jitable

from .log import log

_PACKAGE = Path(__file__).parent
# Kernels allocate nothing and return no arrays: reference counting, dearer than the numerics, is left out. They run
# without the interpreter's lock, which `callback.call_python` takes, so that other threads compute at the same time.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False, "nogil": True}
# The checked build, for tests: numba's own compilation with its bounds checks, memory that nobody has written is NaN.
CHECKED = os.environ.get("PINCONTACT_CHECKED", "") not in ("", "0")
if CHECKED:
    _OPTIONS["boundscheck"] = True

# Parts are called from kernels alone.
_PART_OPTIONS: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


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
    digest = hashlib.sha256(f"{numba.__version__} {_PACKAGE} {CHECKED}".encode())
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
        # empty is as good as unset (XDG Base Directory Specification)
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "pincontact"


_CACHE = cache_root()
# When an entry kernel is compiled: before the first run, before the first with Coulomb friction, before the first with
# several contacts, before the first by time stepping, when it is first called.
ALWAYS, FRICTION, SEVERAL, STEPPING, CALLED = range(5)


class Entry(NamedTuple):
    """An entry kernel: compiled function, argument types, whether compiled aside, cache directory, and when."""

    compiled: Any
    arguments: tuple[Any, ...]
    aside: bool
    directory: Path
    when: int

    @property
    def missing(self) -> bool:
        """Whether it may have no machine code on disk yet."""
        return not (self.directory / _MARKER).exists()

    def compile(self) -> None:
        """Compile it, or load it."""
        # what a compiler makes is kept or goes at once: looking for garbage is a tenth of its time
        collecting = gc.isenabled()
        gc.disable()
        try:
            self.compiled.compile(self.arguments)
        except Exception as error:
            if not self.directory.exists():
                raise
            # files that a crash or a full disk has left; an error of another kind comes again
            log.warning("a kernel on disk cannot be read (%s); compiling it again ...", error)
            shutil.rmtree(self.directory, ignore_errors=True)
            self.compiled.compile(self.arguments)
        finally:
            if collecting:
                gc.enable()

    def mark(self) -> None:
        """Note on disk that it is compiled."""
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            (self.directory / _MARKER).touch()
        except OSError:
            pass


ENTRIES: list[Entry] = []

# how many of them were registered when all were known to be compiled, for each choice of what is needed
_complete: dict[tuple[int, ...], int] = {}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """A numerical routine called by other kernels, compiled with its callers; called from Python it runs as Python."""
    if numba.config.DISABLE_JIT:
        return function
    return register_jitable(**_OPTIONS, **_PART_OPTIONS)(function)


def inlined_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel with one caller, which is compiled as part of it: numba repeats machine code at each level of calls, and
    takes long over large functions, so this is for what stands between a large kernel and its parts."""
    if numba.config.DISABLE_JIT:
        return function
    inlined: Callable[..., Any] = njit(inline="always", **_OPTIONS, **_PART_OPTIONS)(function)
    return inlined


def entry_kernel(
    *arguments: Any, aside: bool = False, when: int = ALWAYS
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A routine called from Python with arguments of these numba types; compiled once and cached on disk.

    aside: compiled in a second process, while the first compiles those that share their parts with each other. when:
    see ALWAYS.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        previous = numba.config.CACHE_DIR
        directory = _CACHE / source_hash(Path(function.__code__.co_filename))
        numba.config.CACHE_DIR = str(directory)
        try:
            compiled = njit(cache=True, **_OPTIONS)(function)
        finally:
            numba.config.CACHE_DIR = previous
        entry = Entry(compiled, arguments, aside, directory, when)
        ENTRIES.append(entry)
        return compiled if numba.config.DISABLE_JIT else _announced(entry)

    return decorate


def _announced(entry: Entry) -> Callable[..., Any]:
    """The kernel, which tells the user so where the first call has to compile it."""
    compiled, unknown = entry.compiled, True

    @functools.wraps(compiled.py_func)
    def call(*values: Any) -> Any:
        nonlocal unknown
        if unknown:
            missing = entry.missing
            if missing:
                log.info("compiling a kernel, once for this version (some seconds) ...")
            entry.compile()
            if missing:
                entry.mark()
            unknown = False
        return compiled(*values)

    return call


# A file in a cache directory whose kernels are all compiled.
_MARKER = "compiled"
INTEGER = types.int64
REAL = types.float64


def compile_kernels(friction: bool = False, several: bool = False, stepping: bool = False) -> None:
    """Compile entry kernels that have no machine code on disk yet, with one line to the user.

    Done before the first scene runs; later processes load from disk what they use, when they use it. Kernels
    marked `aside` are compiled in a second process meanwhile.
    friction, several, stepping: those for Coulomb friction, for several contacts and for time stepping, too.
    """
    asked = {FRICTION: friction, SEVERAL: several, STEPPING: stepping}
    needed = (ALWAYS, *(when for when, wanted in asked.items() if wanted))
    if numba.config.DISABLE_JIT or _complete.get(needed) == len(ENTRIES):
        return
    missing = [entry for entry in ENTRIES if entry.when in needed and entry.missing]
    if missing:
        log.info("compiling kernels, once for this version (half a minute or so) ...")
        beside = [entry for entry in missing if entry.aside]
        own = [entry for entry in missing if not entry.aside]
        worker = _start_worker(needed) if beside and own else None
        for entry in own:
            entry.compile()
        if worker is not None:
            worker.wait()
        # what the worker has compiled is loaded from disk; without a worker this is where it gets done
        for entry in beside:
            entry.compile()
        for entry in missing:
            entry.mark()
    _complete[needed] = len(ENTRIES)


def compile_aside(*needed: int) -> None:
    """The worker's share: kernels marked `aside` that are not on disk."""
    for entry in ENTRIES:
        if entry.aside and entry.when in needed and entry.missing:
            entry.compile()


def _start_worker(needed: tuple[int, ...]) -> subprocess.Popen[bytes] | None:
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(os.path.abspath(path) for path in sys.path if path))
    modules = ", ".join(sorted({entry.compiled.py_func.__module__ for entry in ENTRIES}))
    command = f"import {modules}; from pincontact.jit import compile_aside; compile_aside(*{needed})"
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
