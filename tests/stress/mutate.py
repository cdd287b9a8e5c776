"""Mutation run: one change at a time in the numerics, and whether the suite notices it.

    python tests/stress/mutate.py [--count 400] [--seed 0] [--jobs 2] [--only TEXT] [--survey FILE]

Signs, operators, indices and constants of the functions in `FOLDERS` are changed one at a time, at places drawn at
random. Each change is shown to the fast part of the suite: the tests that take less than `LIMIT` seconds uncompiled and
reach the changed function, those that are quick and reach little else first. Everything runs uncompiled
(`NUMBA_DISABLE_JIT`), so that a change costs no compilation. The tests are collected once; a forked process puts the
change into the code of the functions. Where a function was called before the tests, and none of them notices,
everything is imported again with the change.

First the survey: each test's duration, and the functions of the package that it reaches. `--survey` keeps it in a file;
another run with that file looks at new and changed files of tests only, without the tests known to be slow. (Delete the
file when the package has changed a good deal.)

Thresholds (constants below 1e-3 or above 1e3, named ones, and what multiplies them) are left out: a tolerance half as
large again is no mistake. So are lengths of views, longer slices that kernels read, seeds of random numbers, messages
of errors, annotations, and * for / where only the sign of the result is looked at.

Prints each change that no test noticed, and exits with 1 if one of them is not in `HARMLESS`, or if fewer than 95 % are
noticed.
"""

from __future__ import annotations

import argparse
import ast
import gc
import hashlib
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import asdict, dataclass
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "pincontact"
FOLDERS = ("contours", "geometry", "constraints", "dynamics", "friction")
# It computes nothing, but finds addresses, for compiled code alone: uncompiled, nothing calls it. What it finds is
# checked each time (`_agrees`) and by tests of its own.
NO_NUMERICS = ("pincontact/dynamics/pinocchio_calls.py",)
# s: a test that takes the processor longer, uncompiled, is not in the fast part; what the tests of one change may take
# it together, and how long they take when they hang
LIMIT, BUDGET, PATIENCE = 2.0, 60.0, 150
# the part of the changes that has to be noticed
WANTED = 0.95

# Changes that no test can notice, with the reason: (file, function, line of the code as it stands, change)
HARMLESS: dict[tuple[str, str, str, str], str] = {
    (
        "pincontact/contours/charts.py", "turned_back", "u1, u2 = u1 + math.pi, 2.0 * middle - u2", "+ -> -",
    ): "half a turn either way",
    (
        "pincontact/contours/motion.py", "__init__", "if q @ previous < 0.0:", "0.0 -> 0.5",
    ): "neighbours of so fine a grid are nearly one quaternion, or its negative",
    (
        "pincontact/contours/motion.py", "__call__", "if values[3:] @ near < 0.0:", "0.0 -> 0.5",
    ): "neighbours of so fine a grid are nearly one quaternion, or its negative",
    (
        "pincontact/contours/enclosures.py", "_away", "return x.lo if c > 0.0 else -x.hi", "0.0 -> 0.5",
    ): "a sign is 1 or -1",
    (
        "pincontact/contours/branches.py", "_path_of",
        "open_ = np.flatnonzero((out < 0) & among(number))", "0 -> 1",
    ): "where two paths hold they are the same function",
    (
        "pincontact/geometry/nearest.py", "_divided",
        "signs = [(-1, 0), (1, 0)] if dimension == 1 else [(-1, -1), (-1, 1), (1, -1), (1, 1)]", "0 -> 1",
    ): "cells of a curve have no width",
    (
        "pincontact/contours/parametric.py", "_arguments",
        'numbers["size"] = next((size for size in (half_diagonal(contour, t) for t in moments) if size > 0.0), 0.0)',
        "0.0 -> 0.5",
    ): "what has a tangent at one of these times is more than a point then",
    (
        "pincontact/contours/branches.py", "_end_early",
        "ends = high[high[:, self.time] <= self.known_times[0], self.time]", "index 0 -> 1",
    ): "no box is between the first and the last time of the domain",
    (
        "pincontact/contours/branches.py", "_examine",
        "early = high[:, self.time] <= self.known_times[0]", "index 0 -> 1",
    ): "no box is between the first and the last time of the domain",
    (
        "pincontact/contours/branches.py",
        "breaks",
        "for a, b in sorted(thin, key=lambda edge: edge[0][axis]):",
        "index 0 -> 1",
    ): "edges this thin do not overlap, so that both of their ends have the same order",
    (
        "pincontact/contours/base.py",
        "turning",
        "n = 720",
        "720 -> 721",
    ): "the sum over a whole turn has converged to rounding",
    (
        "pincontact/contours/fits.py",
        "fit",
        "if narrow or math.prod(len(b) - 1 for b in lines) > _MOST_PIECES[dimension]:",
        "1 -> 2",
    ): "a limit of effort, by one more of thousands",
    (
        "pincontact/friction/newton.py", "active_set_solve", "respond(g, c, f, u, size, cone.x)", "index 7 -> 8",
    ): "numbers to work in, any that hold nothing",
    (
        "pincontact/friction/newton.py", "active_set_solve",
        "force = -c[2] / stiffness if c[2] * stiffness < 0.0 else 0.0", "0.0 -> 0.5",
    ): "where a slip begins from: Newton's modes are corrected where it cannot be",
    (
        "pincontact/friction/starts.py", "try_start",
        "rank = factor_matrix(g, cone.low_rank[FACTOR], cone.rhs, RANK_TOLERANCE) if n > 1 else 0", "> -> <",
    ): "with and without factors Newton's steps are the same to round-off",
    (
        "pincontact/friction/centred.py", "add_contact",
        "self.append(Cone(normal, mu, 0.0, tuple(tangents), scaling) if tangents else Cone(normal, 1.0, 0.0))",
        "1.0 -> 1.5",
    ): "the logarithm of a multiple has the same derivatives",
    (
        "pincontact/contours/motion.py", "_spline_motion", "piecewise(pool[_SPLINE_SCRATCH:], t, 0.0, 0.0, rows)",
        "0.0 -> 0.5",
    ): "a spline of one variable does not read the others",
    (
        "pincontact/contours/branches.py", "_examine",
        "slope = np.sort(slopes[k, box, j, 0] * followed.checks[k][3])", "* -> /",
    ): "a sign is 1 or -1",
    (
        "pincontact/friction/starts.py", "try_start",
        "trials[2, i] = 2 if abs(velocities[3 * i]) + abs(velocities[3 * i + 1]) <= still else 1", "index 1 -> 2",
    ): "where the corrections of modes begin: the same solution is found",
    (
        "pincontact/friction/redundant.py", "move_inside", "if step % _STEPS == 0:", "== -> !=",
    ): "the slope says when a step went too far: other steps, the same end",
    (
        "pincontact/dynamics/system.py", "_map_calls", 'callback["model"] = calls.native[0, 1]', "index 0 -> 1",
    ): "an address, for compiled code alone; what is found there is checked with every model",
    (
        "pincontact/friction/loads.py", "modes",
        "if slides or float(np.linalg.norm(aim)) > radii[i] * (1.0 + TOLERANCE):",
        "* -> /",
    ): "a tolerance, on one side of the limit or the other",
    (
        "pincontact/friction/redundant.py", "move_inside",
        "slope = 0.0",
        "0.0 -> 0.5",
    ): "set again at the first step",
    (
        "pincontact/friction/solve.py", "_gauss_seidel",
        "space.forces[:] = 0.0",
        "0.0 -> 0.5",
    ): "where the sweeps begin: they end at the same solution",
    (
        "pincontact/friction/starts.py", "try_start",
        "rank = factor_matrix(g, cone.low_rank[FACTOR], cone.rhs, RANK_TOLERANCE) if n > 1 else 0",
        "1 -> 2",
    ): "with and without factors Newton's steps are the same to round-off",
    (
        "pincontact/friction/starts.py", "try_start",
        "trials[2, i] = 2 if abs(velocities[3 * i]) + abs(velocities[3 * i + 1]) <= still else 1",
        "+ -> -",
    ): "where the corrections of modes begin: the same solution is found",
    (
        "pincontact/friction/homotopy.py", "follow_homotopy",
        "if x[rows] <= target or x[rows] > 1.0:",
        "1.0 -> 1.5",
    ): "a path that has turned back never comes to its end",
    (
        "pincontact/friction/loads.py", "newton",
        "if chosen is not None and not self.curved and step == 1:",
        "1 -> 2",
    ): "the equations are linear then: a second step changes nothing but rounding",
    (
        "pincontact/friction/loads.py", "is_lost",
        "return bool(alone and np.linalg.slogdet(jacobian)[0] < 0.0)",
        "0.0 -> 0.5",
    ): "the sign of a regular matrix is 1 or -1",
    (
        "pincontact/linalg.py", "least_norm",
        "for k in range(n - 1, -1, -1):",
        "1 -> 2",
    ): "the last row has nothing right of its diagonal; other ends of the range are noticed",
    (
        "pincontact/friction/newton.py", "active_set_solve",
        "near = 0",
        "0 -> 1",
    ): "where there is nothing to choose, asking for a choice changes nothing",
    (
        "pincontact/contours/enclosures.py", "_of_one",
        "pole = _away(op, 0.0, x, x) <= 0.0",
        "0.0 -> 0.5",
    ): "a tangent has no constant",
    (
        "pincontact/friction/barrier.py", "minimise",
        "lower = cost(x, after, k, pressure) <= before - 0.1 * size * decrement",
        "0.1 -> 0.15000000000000002",
    ): "what part of the foreseen fall a step must have: the same minimum is found",
    (
        "pincontact/friction/loads.py", "_starts",
        "found = guess(speed * scaled.largest)",
        "* -> /",
    ): "where searches begin; what they find is a solution or none",
    (
        "pincontact/dynamics/passing_slip.py", "_unheld",
        "most = np.abs(system.free_acceleration).max() + np.abs(system.v).max() ** 2",
        "2 -> 3",
    ): "what rounding is measured by",
    (
        "pincontact/friction/barrier.py", "enter",
        "within = (2.0 * count + max(size * (_LARGEST - size), 0.0)) / pressure",
        "* -> /",
    ): "a bound that is far from tight: when the search for a point inside is given up",
    (
        "pincontact/contours/branches.py", "survey",
        "if not search.single and not reason:",
        "and -> or",
    ): "one of two reasons, in a message",
    (
        "pincontact/geometry/nearest.py", "bend",
        "centres, _ = _cells(box, (_CURVE_CELLS,) if contour.dimension == 1 else (_SURFACE_CELLS,) * 2)",
        "2 -> 3",
    ): "numbers of cells beyond the parameters belong to none",
    (
        "pincontact/dynamics/least_forces.py", "solve_for_least",
        "scratch[j, count] = multipliers[j] if operator[j, count] != 0.0 else 0.0",
        "0.0 -> 0.5",
    ): "rows without a weight are by themselves, and what they get is multiplied by that weight",
    (
        "pincontact/geometry/planar.py", "moves_in_plane",
        "if body1.contour.dimension == 0:",
        "0 -> 1",
    ): "asked for safety: a plane that turns alone about a line on which the point stays would do as well",
    (
        "pincontact/contours/revolution.py", "_cap",
        "if error < 0.5 * best[0]:",
        "index 0 -> 1",
    ): "another of the fits, which is refused where it is not good enough",
    (
        "pincontact/dynamics/directions.py", "_project",
        "along += shape @ system.relative_acceleration[i, :2] / mobility",
        "/ -> *",
    ): "how long the steps to a fixed point are, which is looked at afterwards",
    (
        "pincontact/contours/program.py", "_check_seams",
        "extent, far = np.ptp(samples[:, 0], axis=0).max(), np.abs(samples[:, 0]).max()", "0 -> 1",
    ): "the size by which rounding is allowed for",
    (
        "pincontact/geometry/nearest.py", "search", "if len(whole.points) == 1:", "1 -> 2",
    ): "a tree of one point finds it, too",
    (
        "pincontact/friction/redundant.py", "move_inside", "if first[i + 1] > row + 1:", "+ -> -",
    ): "where this unit has one number, the next unit's is written, and written again with that unit",
    (
        "pincontact/friction/redundant.py", "move_inside", "for j in range(k + 1):", "1 -> 2",
    ): "what is above the diagonal is not read",
    (
        "pincontact/friction/solve.py", "complementarity",
        "tangential += np.where(finite, self.mu, 0.0) * speed * self.forces[:, 2]", "0.0 -> 0.5",
    ): "what is not finite is left out of the sum in the next line",
    (
        "pincontact/linalg.py", "_take_pivot", "pivot, best = rank, -1.0", "1.0 -> 1.5",
    ): "less than any square, as is any negative number",
}  # fmt: skip


# -------------------------------------------------------------------------------------------------- the changes


@dataclass(frozen=True)
class Change:
    """One change: in which file and function, at which node of the file's tree."""

    file: str
    function: str
    node: int
    line: int
    what: str

    @property
    def text(self) -> str:
        return (ROOT / self.file).read_text().splitlines()[self.line - 1].strip()


_SWAPPED: dict[type, type] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.Gt,
    ast.LtE: ast.GtE,
    ast.Gt: ast.Lt,
    ast.GtE: ast.LtE,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
_SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">"}
_SIGNS |= {ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.And: "and", ast.Or: "or"}


def _changed(node: ast.AST, index: bool) -> tuple[str, ast.AST] | None:
    """What the change of a node is, and the node that takes its place; None where there is none."""
    if isinstance(node, (ast.BinOp, ast.AugAssign, ast.BoolOp)) and type(node.op) in _SWAPPED:
        new = deepcopy(node)
        new.op = _SWAPPED[type(node.op)]()
        return f"{_SIGNS[type(node.op)]} -> {_SIGNS[type(new.op)]}", new
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in _SWAPPED:
        new = deepcopy(node)
        new.ops = [_SWAPPED[type(node.ops[0])]()]
        return f"{_SIGNS[type(node.ops[0])]} -> {_SIGNS[type(new.ops[0])]}", new
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return "sign dropped", node.operand
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        value = node.value
        if index:
            # next to it, or the one before where that would be the last of three
            other: float = value - 1 if value == 2 else value + 1
        elif isinstance(value, int):
            other = value + 1
        elif value == 0.0:
            other = 0.5
        elif 1e-3 <= abs(value) <= 1e3:
            other = 1.5 * value
        else:
            return None
        return f"{'index ' if index else ''}{value!r} -> {other!r}", ast.Constant(other)
    return None


def _is_room(node: ast.AST) -> bool:
    """Whether it makes an array or a view of one: a longer one does no harm, a shorter one the checked build finds."""
    named = node.func if isinstance(node, ast.Call) else None
    name = named.id if isinstance(named, ast.Name) else named.attr if isinstance(named, ast.Attribute) else ""
    return name in ("reals_at", "integers_at", "matrix_at", "integer_matrix_at", "scratch", "zeros")


def _is_threshold(node: ast.AST) -> bool:
    """Whether it is a constant of its module, or a number that no formula has but a tolerance."""
    if isinstance(node, ast.Constant) and isinstance(node.value, float):
        return not (node.value == 0.0 or 1e-3 <= abs(node.value) <= 1e3)
    if not (isinstance(node, ast.Name) and node.id.isupper()):
        return False
    # public names in capitals are places in arrays, but for these
    return node.id.startswith("_") or any(word in node.id for word in ("TOLERANCE", "ROUND_OFF", "AT_REST"))


def _has_sign_only(node: ast.AST) -> bool:
    """Whether of a product or a quotient only the sign matters, which is the same for both."""
    return (
        isinstance(node, ast.Compare)
        and isinstance(node.comparators[0], ast.Constant)
        and node.comparators[0].value == 0.0
        and isinstance(node.left, ast.BinOp)
        and isinstance(node.left.op, (ast.Mult, ast.Div))
    )


def _is_reshape(node: ast.AST) -> bool:
    """Whether it gives an array another shape: one that does not fit is refused, and any negative length is -1."""
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "reshape"


def _is_seed(node: ast.AST) -> bool:
    """Whether it makes a generator of random numbers: any others are as good."""
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "default_rng"


def _lengthened(function: ast.FunctionDef) -> set[int]:
    """Constants whose change makes a view longer: ends of slices of fixed length that a kernel reads. What they are
    handed to takes three numbers, or so many as it is told; only what is as long as a count is asked for its length."""
    names = [d.func if isinstance(d, ast.Call) else d for d in function.decorator_list]
    if not any(isinstance(name, ast.Name) and name.id.endswith("kernel") for name in names):
        return set()
    out = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice) and isinstance(node.ctx, ast.Load):
            begin, end = node.slice.lower, node.slice.upper
            if isinstance(end, ast.BinOp) and isinstance(end.op, ast.Add) and begin is not None:
                # where the view begins, plus its length
                end = end.right if ast.dump(end.left) == ast.dump(begin) else None
            # (2 becomes 1, which is shorter)
            if isinstance(end, ast.Constant) and end.value != 2:
                out.add(id(end))
    return out


def _numeric(function: ast.AST) -> Iterator[tuple[ast.AST, bool]]:
    """Nodes of a function that compute, and whether each stands in an index; not in messages, annotations, defaults,
    nor what only says how long a view is or how large a tolerance."""
    if isinstance(function, (ast.FunctionDef, ast.Lambda)):
        body = function.body if isinstance(function.body, list) else [function.body]
        waiting = [(node, False) for node in body]
    else:
        waiting = []
    spared: set[int] = _lengthened(function) if isinstance(function, ast.FunctionDef) else set()
    while waiting:
        node, index = waiting.pop()
        if isinstance(node, (ast.Raise, ast.JoinedStr, ast.FunctionDef, ast.ClassDef, ast.Assert)):
            continue
        if _is_room(node) or _is_seed(node):
            continue
        if isinstance(node, ast.BinOp) and (_is_threshold(node.left) or _is_threshold(node.right)):
            continue
        if id(node) not in spared:
            yield node, index
        if _has_sign_only(node):
            spared.add(id(node.left))  # type: ignore[attr-defined]
        for name, value in ast.iter_fields(node):
            if name == "annotation" or (name == "args" and _is_reshape(node)):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    waiting.append((child, index or (isinstance(node, ast.Subscript) and name == "slice")))


def changes() -> list[Change]:
    """All changes there are."""
    found = []
    for folder in FOLDERS:
        for path in sorted((PACKAGE / folder).rglob("*.py")):
            if str(path.relative_to(ROOT)) in NO_NUMERICS:
                continue
            tree = ast.parse(path.read_text())
            numbers = {id(node): i for i, node in enumerate(ast.walk(tree))}
            for function in ast.walk(tree):
                if not isinstance(function, ast.FunctionDef):
                    continue
                for node, index in _numeric(function):
                    changed = _changed(node, index)
                    if changed is not None:
                        where = str(path.relative_to(ROOT))
                        line = getattr(node, "lineno", function.lineno)
                        found.append(Change(where, function.name, numbers[id(node)], line, changed[0]))
    return found


def changed_code(change: Change) -> Any:
    """The changed file, as a code object."""
    path = ROOT / change.file
    tree = ast.parse(path.read_text())
    target = list(ast.walk(tree))[change.node]

    class Put(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> Any:
            if node is target:
                return ast.copy_location(found[1], node)
            return self.generic_visit(node)

    index = change.what.startswith("index ")
    found = _changed(target, index)
    assert found is not None
    return compile(ast.fix_missing_locations(Put().visit(tree)), str(path), "exec")


# -------------------------------------------------------------------------------------------------- the survey


class TooSlow(BaseException):
    """A test has had its time."""


class Survey:
    """Plugin of pytest: duration of each test that passes in its time, and the functions of the package it reaches;
    names of the others. Tests known to be of the others are not run."""

    def __init__(self, slow: list[str]) -> None:
        self.tests: dict[str, Any] = {}
        self.slow = slow
        self._reached: set[Any] = set()
        self._seconds = 0.0

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        self.slow = [item.nodeid for item in items if item.nodeid in self.slow]
        items[:] = [item for item in items if item.nodeid not in self.slow]

    def pytest_runtest_protocol(self, item: Any, nextitem: Any) -> None:
        self._reached = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: Any) -> Iterator[None]:
        reached, package = self._reached, str(PACKAGE)

        def note(frame: Any, event: str, _: Any) -> None:
            if event == "call" and frame.f_code.co_filename.startswith(package):
                reached.add(frame.f_code)

        began = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, 1.5 * LIMIT)
        sys.setprofile(note)
        try:
            return (yield)
        finally:
            sys.setprofile(None)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            self._seconds = time.process_time() - began

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when != "call":
            return
        if report.passed and self._seconds <= LIMIT:
            places = {(code.co_filename, code.co_name) for code in self._reached}
            reached = sorted(f"{Path(file).relative_to(ROOT)}:{name}" for file, name in places)
            self.tests[report.nodeid] = {"seconds": self._seconds, "reached": reached}
        else:
            self.slow.append(report.nodeid)


def _too_slow(*_: Any) -> None:
    raise TooSlow


def survey(file: str, output: str) -> int:
    """Run the tests of one file with `Survey`, but those that the output knows as slow, and write what it found; in a
    process of its own."""
    signal.signal(signal.SIGPROF, _too_slow)
    plugin = Survey(json.loads(Path(output).read_text()))
    pytest.main([*OPTIONS, file], plugins=[plugin])
    Path(output).write_text(json.dumps({"hash": content_hash(file), "tests": plugin.tests, "slow": plugin.slow}))
    return 0


def content_hash(file: str) -> str:
    return hashlib.sha256((ROOT / file).read_bytes()).hexdigest()


# files of tests that start processes, look at whole runs only, or at other things than the numerics
LEFT_OUT = (
    "test_arguments", "test_bad_input", "test_benchmarks", "test_checked", "test_command_line", "test_differential",
    "test_documents", "test_examples", "test_hostile", "test_imports", "test_limits",
    "test_long_runs", "test_mjcf", "test_random", "test_reference", "test_robot", "test_scene_file", "test_short",
    "test_stepper", "test_sweep", "test_system_cache", "test_tableaux", "test_tables", "test_uncompiled",
    "test_users_exceptions", "test_view",
)  # fmt: skip
OPTIONS = ["-q", "-p", "no:cacheprovider", "-p", "no:faulthandler", "--no-header", "--tb=no", "-W", "ignore", "-rN"]


def environment() -> dict[str, str]:
    folders = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests/stress")]
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
    return {**os.environ, **threads, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(folders)}


def fast_part(jobs: int, known: dict[str, Any]) -> dict[str, Any]:
    """Of each file of tests: its hash, duration of each fast test and what it reaches, and names of the slow ones; as
    known where the file is what it was."""
    paths = [path for path in sorted((ROOT / "tests").rglob("test_*.py")) if not path.stem.startswith(LEFT_OUT)]
    files = [str(path.relative_to(ROOT)) for path in paths]
    found = {file: known[file] for file in files if file in known and known[file]["hash"] == content_hash(file)}
    waiting, running = [file for file in files if file not in found], []
    with tempfile.TemporaryDirectory() as folder:
        while waiting or running:
            while waiting and len(running) < jobs:
                file = waiting.pop()
                output = Path(folder) / f"{Path(file).stem}.json"
                output.write_text(json.dumps(known.get(file, {}).get("slow", [])))
                command = [sys.executable, __file__, "--survey-of", file, str(output)]
                process = subprocess.Popen(command, cwd=ROOT, env=environment(), stdout=subprocess.DEVNULL)
                running.append((process, file, output, time.monotonic()))
            for entry in list(running):
                process, file, output, began = entry
                if process.poll() is None:
                    continue
                running.remove(entry)
                if process.returncode != 0:
                    raise RuntimeError(f"the survey of {file} ended with {process.returncode}")
                found[file] = json.loads(output.read_text())
                print(f"{file}: {len(found[file]['tests'])} fast tests, {len(found[file]['slow'])} slow or failing, "
                      f"{time.monotonic() - began:.0f} s", flush=True)  # fmt: skip
            time.sleep(0.05)
    return found


# -------------------------------------------------------------------------------------------------- the run


def put(change: Change) -> None:
    """Make a change in the functions that have been imported; where it is more than the code of functions (what a
    function has returned already, other free variables), that is not all of it."""
    path, codes, waiting = str(ROOT / change.file), {}, [changed_code(change)]
    while waiting:
        code = waiting.pop()
        codes[code.co_qualname, code.co_firstlineno] = code
        waiting += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    for function in gc.get_objects():
        if isinstance(function, FunctionType) and function.__code__.co_filename == path:
            code = codes[function.__code__.co_qualname, function.__code__.co_firstlineno]
            if len(code.co_freevars) == len(function.__code__.co_freevars):
                function.__code__ = code


def show_quickly(change: Change | None, tests: list[Any]) -> int:
    """Run tests that have been collected with a change put into what they have imported; in a process of its own.
    Returns how many had been run when one failed, or 0."""
    gc.unfreeze()
    if change is not None:
        put(change)
    for i, test in enumerate(tests):
        following = tests[i + 1] if i + 1 < len(tests) else None
        if any(report.failed for report in runtestprotocol(test, log=False, nextitem=following)):
            return i + 1
    return 0


def forked(run: Callable[[], int], output: Path) -> int:
    """A process that runs this in silence, and writes down what it returns."""
    process = os.fork()
    if process == 0:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE, PATIENCE))
        try:
            output.write_text(str(run()))
        finally:
            os._exit(0)
    return process


def show(change: Change, tests: list[str]) -> int:
    """Run tests with everything imported from the changed file; in a process of its own. Returns pytest's exit code."""
    from importlib.machinery import SourceFileLoader

    code, path, usual = changed_code(change), str(ROOT / change.file), SourceFileLoader.get_code

    def get_code(loader: Any, name: str) -> Any:
        return code if loader.path == path else usual(loader, name)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]
    return int(pytest.main([*OPTIONS, "-x", *tests]))


def chosen(change: Change, tests: dict[str, Any]) -> list[str]:
    """The tests that reach the change's function, as far as the budget goes: first those that reach little else, since
    they look at it closely, and are quick."""
    key, spent, out = f"{change.file}:{change.function}", 0.0, []
    reaching = [name for name in tests if key in tests[name]["reached"]]
    for name in sorted(reaching, key=lambda n: tests[n]["seconds"] * len(tests[n]["reached"])):
        spent += tests[name]["seconds"]
        if spent > BUDGET:
            break
        out.append(name)
    return out


def noticed(
    sample: list[Change], tests: dict[str, Any], items: dict[str, Any], before: set[tuple[str, str]], jobs: int
) -> Iterator[tuple[Change, str]]:
    """Each change with "noticed", "hangs", "unreached" or "" for one that no test noticed.

    It is shown to the tests as they are collected here. What they do not notice is made once more, before anything is
    imported, if it is in a function (file, name) that was called before the tests. A test that has failed must pass
    here without the change.
    """
    gc.collect()
    gc.freeze()
    passes: dict[str, bool] = {}
    running: dict[int, tuple[Change, list[str], bool]] = {}
    waiting = [(change, True) for change in reversed(sample)]
    with tempfile.TemporaryDirectory() as folder:
        while waiting or running:
            while waiting and len(running) < jobs:
                change, quick = waiting.pop()
                names = [name for name in chosen(change, tests) if passes.get(name, True)]
                if not names:
                    yield change, "unreached"
                    continue
                output = Path(folder) / f"{Path(change.file).stem}-{change.node}"
                output.unlink(missing_ok=True)
                if quick:
                    process = forked(lambda: show_quickly(change, [items[name] for name in names]), output)  # noqa: B023
                else:
                    given = json.dumps([asdict(change), names, str(output)])
                    command = [sys.executable, __file__, "--show", given]
                    process = os.posix_spawn(sys.executable, command, environment())
                running[process] = change, names, quick
            time.sleep(0.01)
            for process in list(running):
                change, names, quick = running[process]
                output = Path(folder) / f"{Path(change.file).stem}-{change.node}"
                ended, status = os.waitpid(process, os.WNOHANG)
                if not ended:
                    continue
                del running[process]
                if os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL):
                    yield change, "hangs"
                    continue
                failed = int(output.read_text()) if output.exists() else -1
                if failed > 0 and quick:
                    name = names[failed - 1]
                    if name not in passes:
                        alone = Path(folder) / "alone"
                        os.waitpid(forked(lambda: show_quickly(None, [items[name]]), alone), 0)  # noqa: B023
                        passes[name] = alone.read_text() == "0"
                    if not passes[name]:
                        waiting.append((change, True))
                        continue
                if failed != 0:
                    yield change, "noticed"
                elif quick and (str(ROOT / change.file), change.function) in before:
                    waiting.append((change, False))
                else:
                    yield change, ""


class Collected:
    """Plugin of pytest: hands the tests that it has collected, and the functions (file, name) that were called to
    collect them, to a function, instead of running them."""

    def __init__(self, use: Callable[[dict[str, Any], set[tuple[str, str]]], None]) -> None:
        self.use = use
        self.called: set[tuple[str, str]] = set()

    def pytest_collection(self) -> None:
        sys.setprofile(lambda frame, event, _: self.called.add((frame.f_code.co_filename, frame.f_code.co_name)))

    def pytest_runtestloop(self, session: Any) -> bool:
        sys.setprofile(None)
        self.use({item.nodeid: item for item in session.items}, self.called)
        return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=400, help="changes to make")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--only", default="", help="changes in files or functions whose names contain this")
    parser.add_argument("--survey", default="", help="file that keeps the survey")
    parser.add_argument("--show", help=argparse.SUPPRESS)
    parser.add_argument("--survey-of", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.survey_of:
        return survey(*options.survey_of)
    if options.show:
        change, names, output = json.loads(options.show)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE, PATIENCE))
        Path(output).write_text(str(show(Change(**change), names)))
        return 0
    kept = Path(options.survey) if options.survey else None
    files = fast_part(options.jobs, json.loads(kept.read_text()) if kept and kept.exists() else {})
    if kept:
        kept.write_text(json.dumps(files))
    tests = {name: test for found in files.values() for name, test in found["tests"].items()}
    everything = [change for change in changes() if options.only in f"{change.file}:{change.function}"]
    sample = random.Random(options.seed).sample(everything, min(options.count, len(everything)))
    print(f"{len(tests)} fast tests, {len(everything)} changes, {len(sample)} drawn", flush=True)
    os.environ.update(environment())
    os.chdir(ROOT)
    sys.path[:0] = environment()["PYTHONPATH"].split(os.pathsep)
    counts = dict.fromkeys(("noticed", "hangs", "harmless", "missed"), 0)
    run = [*OPTIONS, "--capture=no", *sorted({name.partition("::")[0] for name in tests})]
    pytest.main(
        run,
        plugins=[
            Collected(lambda items, before: report(noticed(sample, tests, items, before, options.jobs), counts)),
        ],
    )
    share = (counts["noticed"] + counts["hangs"]) / max(len(sample), 1)
    print(f"{share:.1%} of {len(sample)} changes were noticed: {counts}")
    return int(counts["missed"] > 0 or share < WANTED)


def report(results: Iterator[tuple[Change, str]], counts: dict[str, int]) -> None:
    """Count results, and print the changes that were not noticed."""
    for change, result in results:
        if result in ("noticed", "hangs"):
            counts[result] += 1
            if sum(counts.values()) % 20 == 0:
                print(f"{sum(counts.values())} tried", flush=True)
            continue
        reason = HARMLESS.get((change.file, change.function, change.text, change.what))
        counts["harmless" if reason else "missed"] += 1
        print(f"{change.file}:{change.line} {change.function}: {change.what} {'(unreached)' if result else ''}\n"
              f"    {change.text}\n    {reason or 'NOT EXPLAINED'}", flush=True)  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
