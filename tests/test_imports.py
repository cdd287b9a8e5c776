"""Heavy packages are imported where they are used, and not before; looked at in a process of its own."""

import subprocess
import sys
from pathlib import Path

import numba

from pincontact.jit import cache_root

CODE = """
import sys


def loaded(*names):
    return [name for name in names if name in sys.modules]


sys.path.insert(0, sys.argv[2])
import pincontact.view, pincontact.view.plots

found = loaded("meshcat", "matplotlib", "zmq", "umsgpack", "IPython", "proxsuite")
assert not found, f"{found} at import"

import numpy as np
from pincontact.friction.solve import ContactSolver, solve_contacts

contact = [1.0, 0.0, -1.0]
solve_contacts(np.eye(3), contact, 0.5)
solve_contacts(np.eye(6), contact * 2, 0.5)
assert not loaded("proxsuite"), "for contact problems that are solved without a program"
assert ContactSolver(stages=("qp",)).solve(np.eye(6), np.array(contact * 2), np.full(2, 0.5))
assert loaded("proxsuite")

from fake_run import fake_run
from pincontact.view import export_html
import subprocess

started = []
popen = subprocess.Popen.__init__
subprocess.Popen.__init__ = lambda self, *args, **options: started.append(args) or popen(self, *args, **options)
export_html(fake_run(), sys.argv[1])
assert not started, started
found = loaded("meshcat", "matplotlib", "zmq", "IPython")
assert not found, f"{found} for a page"
"""


def test_nothing_heavy_is_imported_until_used(tmp_path):
    command = [sys.executable, "-c", CODE, str(tmp_path / "run.html"), str(Path(__file__).parent)]
    # not from the checkout: the installed package is meant, and its compiled kernels
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=Path(__file__).parent)
    assert done.returncode == 0, done.stderr


def test_an_empty_cache_folder_counts_as_none(monkeypatch):
    """Kernels are never kept in the present folder (XDG Base Directory Specification)."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    assert cache_root().is_absolute()
