"""The checked build finds an index that leaves its array, and what is read before it is written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

ROOT = Path(__file__).parents[1]


def in_checked_build(folder: Path, script: str, **environment: str) -> subprocess.CompletedProcess[str]:
    # kernels are cached by the file that they are in
    file = folder / "script.py"
    file.write_text(script)
    return subprocess.run(
        [sys.executable, str(file)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "PINCONTACT_CHECKED": "1", **environment},
        capture_output=True,
        text=True,
    )


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_an_index_outside_its_array_is_an_error(tmp_path):
    script = """
import numpy as np
from pincontact.jit import INTEGER, REAL, entry_kernel, kernel
from pincontact.callback import kernel_address, kernel_caller
from pincontact.workspace import matrix_at

call_kernel = kernel_caller(INTEGER, INTEGER, REAL, INTEGER)

@kernel
def part(a, i, j):
    return a[i, j]

@entry_kernel(INTEGER, REAL, INTEGER)
def entry(address, x, i):
    return int(part(matrix_at(address, 2, 3), i, 1))

@entry_kernel(INTEGER, INTEGER, INTEGER)
def by_address(function, address, i):
    return call_kernel(function, address, 0.0, i)

values = np.arange(6.0)
at = values.ctypes.data
for function, arguments in ((entry, (at, 0.0)), (by_address, (kernel_address(entry), at))):
    assert function(*arguments, 1) == 4
    for i in (2, -3, 1 << 40):
        try:
            function(*arguments, i)
        except IndexError:
            print("found")
"""
    done = in_checked_build(tmp_path, script)
    assert done.returncode == 0, done.stderr
    # an entry kernel that another calls by its address cannot raise through it: Python reports the error
    assert done.stdout.count("found") + done.stderr.count("Exception ignored") == 6, done.stderr


def test_an_array_beyond_the_memory_at_its_address_is_an_error(tmp_path):
    """Of uncompiled kernels, which know how long each array is."""
    script = """
from pincontact.workspace import REALS, Layout, Workspace, matrix_at
workspace = Workspace(Layout("test", a=(REALS, "n", "m")))
workspace.zeros("a", 2, 3)
address = workspace.table[0, 0]
assert matrix_at(address, 2, 3).shape == (2, 3)
try:
    matrix_at(address, 3, 3)
except IndexError as error:
    print(error)
"""
    done = in_checked_build(tmp_path, script, NUMBA_DISABLE_JIT="1")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "a view of 9 numbers on an array of 6.\n"


def test_memory_that_nobody_has_written_is_no_number(tmp_path):
    script = """
from pincontact.workspace import INTEGERS, REALS, Layout, Workspace
workspace = Workspace(Layout("test", a=(REALS, "n"), b=(INTEGERS, "n"), c=(REALS, "n")))
print(workspace.scratch("a", 2), workspace.scratch("b", 1)[0] < -2**32, workspace.zeros("c", 2))
"""
    assert in_checked_build(tmp_path, script).stdout == "[nan nan] True [0. 0.]\n"


def test_an_array_of_kernels_is_put(tmp_path):
    """Assigned it would be another one for Python than for kernels. What changes it in place may."""
    script = """
import numpy as np
from pincontact.workspace import REALS, Layout, Workspace
workspace = Workspace(Layout("test", a=(REALS, "n", 3)))
workspace.zeros("a", 2, 3)
workspace.a += 1.0
assert workspace.a.sum() == 6.0
try:
    workspace.a = np.zeros((2, 3))
except AttributeError as error:
    print(error)
for other in (np.zeros(3), np.zeros((2, 4))):
    try:
        workspace.put("a", other)
    except ValueError as error:
        print(error)
workspace.put("a", np.zeros((5, 3)))
"""
    done = in_checked_build(tmp_path, script)
    assert done.returncode == 0, done.stderr
    told = "a is declared with 2 extents, (3,) the last, got"
    assert done.stdout.splitlines() == ["a is an array of kernels: put it.", f"{told} (3,).", f"{told} (2, 4)."]
