"""Compilation of the numerical kernels: once, cached on disk, announced.

Three decorators. `kernel` marks a part that other kernels call, `inlined_kernel` one that a single kernel calls, and
`entry_kernel` what Python calls. An entry kernel takes the address of a workspace (see `workspace.py`), so that one
compiled signature serves every scene and a call costs a fraction of a microsecond.

Numba optimises the machine code of a part again in each kernel that calls it, at every level of calls: a deep tree of
kernels takes several times as long to compile as its parts one by one. A fourth decorator, `callback.separate_kernel`,
marks where the tree is cut.

Numba invalidates a cached function when its own file changes, not when a callee in another file does. Each entry or
separate kernel's cache directory is therefore keyed by a hash of its module's source and of all that it imports.
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
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import numba
from numba import njit, types
from numba.extending import register_jitable

from .cores import available_cores
from .log import log

_PACKAGE = Path(__file__).parent
# Kernels allocate nothing and return no arrays: reference counting, dearer than the numerics, is left out. They run
# without the interpreter's lock, which `callback.call_python` takes, so that other threads compute at the same time.
KERNEL_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False, "nogil": True}
# The checked build, for tests: numba's own compilation with its bounds checks, memory that nobody has written is NaN.
CHECKED = os.environ.get("PINCONTACT_CHECKED", "") not in ("", "0")
if CHECKED:
    KERNEL_OPTIONS["boundscheck"] = True

# Parts are called from kernels alone.
_PART_OPTIONS: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


_IMPORT = re.compile(r"^ *from (\.+)([\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_NAME = re.compile(r"\w+")


@functools.cache
def _names_in(folder: str) -> frozenset[str]:
    return frozenset(os.listdir(folder)) if os.path.isdir(folder) else frozenset()


@functools.cache
def _read(file: str) -> tuple[bytes, tuple[str, ...]]:
    """Digest of a file's text, and the package's files that it imports."""
    text = Path(file).read_bytes()
    found = []
    for dots, module, names in _IMPORT.findall(text.decode()):
        base = os.path.dirname(file)
        for _ in dots[1:]:
            base = os.path.dirname(base)
        *folders, last = ["", *filter(None, module.split("."))]
        above = os.path.join(base, *folders) if last else base
        base = os.path.join(above, last) if last else base
        if last and f"{last}.py" in _names_in(above):
            found.append(f"{base}.py")
        inside = _names_in(base)
        wanted = ("__init__.py", *(f"{name}.py" for name in _NAME.findall(names)))
        found += [os.path.join(base, name) for name in wanted if name in inside]
    return hashlib.sha256(text).digest(), tuple(found)


@functools.cache
def source_hash(file: str) -> str:
    """Key of all that the machine code of a file's kernels depends on: it, what it imports, numba, where they are. Of a
    file elsewhere, which may call any kernel by any name: the whole package."""
    reached, waiting = {file}, [file]
    if not Path(file).is_relative_to(_PACKAGE):
        reached.update(map(str, _PACKAGE.rglob("*.py")))
    while waiting:
        new = [path for path in _read(waiting.pop())[1] if path not in reached]
        reached.update(new)
        waiting += new
    # numba keeps machine code by the path of its source, and before 0.68 by the time of its last change: another copy
    # of the package is another cache, and so was one that was installed again
    changed = 0 if numba.version_info.short >= (0, 68) else os.stat(file).st_mtime_ns
    digest = hashlib.sha256(f"{numba.__version__} {_PACKAGE} {CHECKED} {changed}".encode())
    for path in sorted(reached):
        digest.update(_read(path)[0])
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
# When a kernel is compiled: before the first run, before the first with several contacts, before the first by time
# stepping, when it is first called.
ALWAYS, SEVERAL, STEPPING, CALLED = range(4)


@contextmanager
def _compiling(directory: Path) -> Iterator[None]:
    """numba's settings while a kernel is compiled or loaded."""
    # what a compiler makes is kept or goes at once: looking for garbage is a tenth of its time
    collecting, vectorizes, folder = gc.isenabled(), numba.config.LOOP_VECTORIZE, numba.config.CACHE_DIR
    gc.disable()
    # most loops are over a few numbers: vectors do not pay, and looking for them takes a tenth of the time
    numba.config.LOOP_VECTORIZE, numba.config.CACHE_DIR = 0, str(directory)
    try:
        yield
    finally:
        numba.config.LOOP_VECTORIZE, numba.config.CACHE_DIR = vectorizes, folder
        if collecting:
            gc.enable()


class Entry(NamedTuple):
    """An entry or separate kernel: compiled function, argument types, cache directory, and when it is compiled."""

    compiled: Any
    arguments: tuple[Any, ...]
    directory: Path
    when: int

    @property
    def name(self) -> str:
        function = self.compiled.py_func
        return f"{function.__module__}.{function.__qualname__}"

    @property
    def missing(self) -> bool:
        """Whether it may have no machine code on disk yet."""
        return not self._marker.exists()

    @property
    def _marker(self) -> Path:
        """A file in the cache directory which says that it is compiled."""
        return self.directory / f"{self.name} is compiled"

    def compile(self) -> None:
        """Compile it, or load it; not the separate kernels that it calls."""
        if self.compiled.overloads:
            return
        with _compiling(self.directory):
            try:
                self.compiled.compile(self.arguments)
            except Exception as error:
                if not self.directory.exists():
                    raise
                # files that a crash or a full disk has left; an error of another kind comes again
                log.warning("a kernel on disk cannot be read (%s); compiling it again ...", error)
                shutil.rmtree(self.directory, ignore_errors=True)
                self.compiled.compile(self.arguments)

    def prepare(self) -> None:
        """Compile or load it with what it always calls; it may run then. The user is told if it takes time."""
        needed = [part for part in _parts(self.compiled.py_func) if part.when in {ALWAYS, self.when} - {CALLED}]
        missing = [entry for entry in (*needed, self) if not entry.compiled.overloads and entry.missing]
        if missing:
            log.info("compiling a kernel, once for this version (some seconds) ...")
        for entry in (*needed, self):
            entry.compile()
        for entry in missing:
            entry.mark()

    def mark(self) -> None:
        """Note on disk that it is compiled."""
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            self._marker.touch()
        except OSError:
            pass


ENTRIES: list[Entry] = []
# separate kernels (see `callback`)
SEPARATE: dict[Any, Entry] = {}


def _called(function: Any) -> list[FunctionType]:
    """The functions that a kernel calls."""
    named = (function.__globals__.get(name) for name in function.__code__.co_names)
    functions = (getattr(thing, "py_func", thing) for thing in named)
    return [called for called in functions if isinstance(called, FunctionType)]


@functools.cache
def _parts(function: Any) -> list[Entry]:
    """The separate kernels that a kernel calls, by itself or by others."""
    reached, waiting = {function}, [function]
    while waiting:
        new = [called for called in _called(waiting.pop()) if called not in reached]
        reached.update(new)
        waiting += new
    return [SEPARATE[called] for called in reached - {function} if called in SEPARATE]


@functools.cache
def _size(function: Any) -> int:
    """Bytes of code that are compiled with a kernel, those of what it calls among them."""
    parts = (called for called in _called(function) if called not in SEPARATE and called is not function)
    return len(function.__code__.co_code) + sum(map(_size, parts))


# how many of them were registered when all were known to be compiled, for each choice of what is needed
_complete: dict[tuple[int, ...], int] = {}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """A numerical routine called by other kernels, compiled with its callers; called from Python it runs as Python."""
    if numba.config.DISABLE_JIT:
        return function
    return register_jitable(**KERNEL_OPTIONS, **_PART_OPTIONS)(function)


def inlined_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel with one caller, which is compiled as part of it: numba repeats machine code at each level of calls, and
    takes long over large functions, so this is for what stands between a large kernel and its parts."""
    if numba.config.DISABLE_JIT:
        return function
    inlined: Callable[..., Any] = njit(inline="always", **KERNEL_OPTIONS, **_PART_OPTIONS)(function)
    return inlined


def cache_directory(function: Any) -> Path:
    """Where machine code of a kernel is kept."""
    return _CACHE / source_hash(function.__code__.co_filename)


def entry_kernel(
    *arguments: Any, when: int = ALWAYS, from_python: bool = True
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A routine called from Python with arguments of these numba types; compiled once and cached on disk.

    when: see ALWAYS. from_python: not only by its address.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        directory = cache_directory(function)
        with _compiling(directory):
            compiled = njit(cache=True, no_cpython_wrapper=not from_python, **KERNEL_OPTIONS)(function)
        entry = Entry(compiled, arguments, directory, when)
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
            entry.prepare()
            unknown = False
        try:
            return compiled(*values)
        except SystemError as error:
            # raised by a signal's handler within a call into Python, before the callable could note it
            if error.__cause__ is None:
                raise
            raise error.__cause__ from None

    return call


# Processes that compile at the same time, at most.
_MOST = 4
INTEGER = types.int64
REAL = types.float64
BOOLEAN = types.boolean
NOTHING = types.none


def compile_kernels(several: bool = False, stepping: bool = False, called: bool = False) -> None:
    """Compile kernels that have no machine code on disk yet, with one line to the user.

    Done before the first scene runs, in several processes; later ones load from disk what they use, when they use it.
    several, stepping, called: those for several contacts, for time stepping, and those that few scenes call, too; of
    the modules that are imported.
    """
    asked = {SEVERAL: several, STEPPING: stepping, CALLED: called}
    needed = (ALWAYS, *(when for when, wanted in asked.items() if wanted))
    if numba.config.DISABLE_JIT or _complete.get(needed) == len(ENTRIES):
        return
    missing = [entry for entry in ENTRIES if entry.when in needed and entry.missing]
    # the longest first, so that all processes end at the same time
    missing.sort(key=lambda entry: -_size(entry.compiled.py_func))
    if missing:
        log.info("compiling kernels, once for this version (half a minute or so) ...")
        with tempfile.TemporaryDirectory() as claims:
            workers = [_start_worker(claims, missing) for _ in range(min(available_cores(), len(missing), _MOST) - 1)]
            for entry in missing:
                if _claim(claims, entry):
                    entry.compile()
            for worker in workers:
                if worker is not None:
                    worker.wait()
        # what workers have compiled is loaded from disk; what one of them has left undone is done here
        for entry in missing:
            entry.compile()
            entry.mark()
    _complete[needed] = len(ENTRIES)


def _claim(claims: str, entry: Entry) -> bool:
    """Whether no other process compiles it."""
    try:
        (Path(claims) / entry.name).touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def compile_claimed(claims: str, names: list[str]) -> None:
    """A worker's share of these kernels."""
    entries = {entry.name: entry for entry in ENTRIES}
    for name in names:
        if name in entries and _claim(claims, entries[name]):
            entries[name].compile()


def _start_worker(claims: str, missing: list[Entry]) -> subprocess.Popen[bytes] | None:
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(os.path.abspath(path) for path in sys.path if path))
    modules = ", ".join(sorted({entry.compiled.py_func.__module__ for entry in missing}))
    names = [entry.name for entry in missing]
    command = f"import {modules}; from pincontact.jit import compile_claimed; compile_claimed({claims!r}, {names})"
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
