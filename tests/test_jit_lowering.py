"""What kernels are written in means compiled what it means in Python: indices, loops, numbers, tuples, calls."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from types import FunctionType

import numba
import numpy as np
import pytest
from calling import from_python
from numba.core.errors import UnsupportedError

import pincontact
from pincontact.jit import CHECKED, INTEGER, _Cache, entry_kernel, kernel

INF, NAN = math.inf, math.nan
TABLE = (0.5, 1.5, 2.5)
LOW, HIGH = 2, 5


def compare(part, cases):
    """The part gives to the bit what it gives in Python, in its result and in its arrays."""
    # parts cannot be called from Python
    names = {name: getattr(value, "py_func", value) for name, value in globals().items()}
    function = getattr(part, "py_func", part)
    plain, compiled = FunctionType(function.__code__, names), from_python(part)
    for arguments in cases:
        copies = [a.copy() if isinstance(a, np.ndarray) else a for a in arguments]
        expected, result = plain(*copies), compiled(*arguments)
        np.testing.assert_array_equal(np.array(result, dtype=float), np.array(expected, dtype=float))
        for given, copy in zip(arguments, copies):
            if isinstance(given, np.ndarray):
                np.testing.assert_array_equal(given, copy)


@kernel
def indexed(a, b, c, k):
    a[-1] = b[0, -2] + b[-1, k]
    b[k, 1] += c[-1, k, 0] * c[k, -1, -1]
    row, block, tail = b[k], c[1], a[k:]
    row[2] = tail[1]
    block[0, 1] = -tail[0]
    part = row[1:-1]
    part[0] = part.shape[0] + 10.0 * b.shape[1] + 100.0 * c.shape[0]
    ends, first, whole = b[k, 1:], a[:k], b[1:]
    ends[1] += first[0] + whole[0, 0]
    square = a[:4].reshape(2, 2)
    square[1, 0] = 7.0
    return part.shape[0], ends.shape[0], first.shape[0], whole.shape[0]


def test_indices_and_slices():
    random = np.random.default_rng(0)
    cases = [[random.normal(size=shape) for shape in (6, (3, 4), (3, 3, 2))] + [k] for k in (1, 2)]
    compare(indexed, cases)


@kernel
def columns(a, k):
    column = a[:, k]
    total = 0.0
    for i in range(column.shape[0]):
        column[i] *= 2.0
        total += column[i]
    inner = column[1:3]
    inner[0] = total
    return total + inner.shape[0] + column[-1]


def test_arrays_with_gaps():
    a = np.random.default_rng(1).normal(size=(4, 3))
    compare(columns, [(a, 1), (a[:, 1:], 0), (np.asfortranarray(a), 2)])


@kernel
def looped(a, n):
    last, found, steps = -1, 0.0, 0
    for i in range(n):
        last = i
        if a[i] > 2.0:
            found = a[i]
            break
    for i in range(n - 1, -1, -1):
        for j in range(i, n, 2):
            if j == 3:
                continue
            a[i] += 0.125 * a[j]
            steps += 1
    k = 0
    while k < n and a[k] < 10.0:
        mark = a[k]
        k += 1
    for i in range(4, 1):
        steps += 1000 * i
    for i in range(1, 9, 3):
        steps += i
        i += 100
    return last, found, steps, k, mark


def test_loops():
    compare(looped, [(np.array([0.5, 1.0, 1.5, 3.0, 0.25, 0.1]), n) for n in (1, 4, 6)])


@kernel
def counted(x, y, n, m):
    return (
        x * n + m / y - n, n // m, n % m, x**2, x**3, n * m - m, n & 6, abs(x), -x, -n, int(x * 10.0), float(n) / m,
        min(x, y), max(x, y), max(x, y, 0.0), min(n, m), max(n, m, 3), n in (LOW, HIGH), n == m, not n > m, bool(x > y),
        x < y, x <= y, x != y, x == y, x >= y, math.sqrt(abs(x)), math.atan2(y, 2.0),
    )  # fmt: skip


def test_numbers():
    reals, integers = ((1.5, -0.25), (-2.0, 3.0), (0.5, 0.5)), ((5, 3), (-7, 2), (2, 5), (6, 6))
    compare(counted, [(*real, *integer) for real in reals for integer in integers])


@kernel
def extremes(x, y):
    return min(x, y), max(x, y), x < y, x == y, x != y


def test_what_is_not_a_number():
    compare(extremes, [(NAN, 1.0), (1.0, NAN), (INF, -INF), (-0.0, 0.0)])


@kernel
def shares(pair, factor=2.0, offset=1):
    first, second = pair
    return second * factor, first + offset, factor > 2.0


@kernel
def nothing(a):
    a[0] += 1.0


@kernel
def called(a, k):
    x, y, large = shares((a[0], a[1]))
    buffers = (a, a[1:], k, x)
    rest, number = buffers[1:3]
    result = shares((y, x), offset=number, factor=3.0)
    if large:
        nothing(a)
    elif k > 0:
        nothing(rest)
    both = (x, y) if k > 1 else (y, x)
    return result[0], result[1], TABLE[k % 3], both[0], both[1], len(TABLE)


def test_tuples_and_calls():
    compare(called, [(np.array([1.0, 2.0, 3.0]), k) for k in (0, 1, 2)])


@pytest.mark.skipif(numba.config.DISABLE_JIT or CHECKED, reason="this is of the package's own lowering")
def test_what_kernels_cannot_do_is_refused():
    @kernel
    def stepping(a):
        return a[::2][0]

    @entry_kernel(INTEGER)
    def entry(n):
        return n

    @kernel
    def calling(n):
        return entry(n)

    with pytest.raises(UnsupportedError, match="slices with a step"):
        from_python(stepping)(np.zeros(4))
    with pytest.raises(UnsupportedError, match="which is none of its kind"):
        from_python(calling)(1)


WITHOUT = """
import sys

sys.modules["pincontact.jit_lowering"] = None
import numpy as np
from pincontact import jit
from pincontact.jit import REAL, TABLE, entry_kernel, kernel
from pincontact.memory import Memory, matrix

assert jit.PartCompiler is jit.EntryCompiler is None


@kernel
def corner(table):
    return matrix(table[0], 2, 3)[1, 2]


@entry_kernel(TABLE, REAL)
def scaled_corner(table, factor):
    return factor * corner(table)


memory = Memory(("a",))
memory.reals("a", 2, 3)[:] = np.arange(6.0).reshape(2, 3)
assert scaled_corner(memory.table, 2.0) == 10.0
"""


def test_kernels_compile_without_it(tmp_path):
    """As where numba's classes have changed: by numba alone."""
    file = tmp_path / "without.py"
    file.write_text(WITHOUT)
    paths = os.pathsep.join([str(Path(pincontact.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": paths}
    done = subprocess.run([sys.executable, str(file)], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="machine code")
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("keep", [0, 40, 400])
def test_kernels_on_disk_that_cannot_be_read_are_compiled_again(suffix, keep, tmp_path, monkeypatch, capsys):
    """Index or machine code cut short, as a crash or a full disk leaves them: the next process repairs that, and says
    so."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def seven_times(x):
        return 7 * x

    def called():
        compiled = numba.njit(cache=True)(seven_times)
        compiled._cache = _Cache(seven_times)
        assert compiled(3) == 21
        return sum(compiled.stats.cache_hits.values())

    assert [called(), called()] == [0, 1]
    assert capsys.readouterr().err == ""
    (file,) = tmp_path.rglob(f"*.{suffix}")
    file.write_bytes(file.read_bytes()[:keep])
    assert [called(), called()] == [0, 1]
    assert capsys.readouterr().err.count("cannot be read") == 1
