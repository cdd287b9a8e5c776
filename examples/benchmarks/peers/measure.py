"""Timing one engine on one scene: a ladder of settings, each timed and compared with the reference."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .problem import Problem


class Unsupported(Exception):
    """An engine that is not installed, or cannot express a scene; the message says which and why."""


@dataclass(frozen=True)
class Case:
    """One method with one setting. run: a whole simulation from the start, which is what is timed; positions: what it
    returned as markers (n, markers, 3); counts: the same as {"steps": ..., "evaluations": ...}."""

    method: str
    setting: str
    run: Callable[[], Any]
    positions: Callable[[Any], np.ndarray]
    counts: Callable[[Any], dict[str, int]]


# Runs at least, where several are asked for.
_LEAST = 2


@dataclass(frozen=True)
class Effort:
    """How long to measure. longest: s of a single run beyond which the ladder of a method ends, three times that in
    scenes of many events; repeats: runs whose lower median is taken, as long as they take together less than `total` s;
    every: take each n-th rung of a ladder only."""

    longest: float = 0.6
    repeats: int = 21
    total: float = 0.15
    every: int = 1


QUICK = Effort(longest=1.0, repeats=1, total=0.0, every=2)


@dataclass
class Row:
    """One line of the result. error in m, seconds: median of `runs`; both nan if the run failed, and note says how."""

    scene: str
    engine: str
    method: str
    setting: str
    seconds: float = math.nan
    error: float = math.nan
    steps: int | None = None
    evaluations: int | None = None
    runs: int = 0
    note: str = ""
    # s of the fixed piece of work of `pace`, as it was around these runs
    pace: float = math.nan


@dataclass(frozen=True)
class Engine:
    """What a module of this folder gives. cases: settings from coarse to fine, grouped by method; raises Unsupported.

    settings: for people, what was chosen and why, by method.
    """

    name: str
    version: Callable[[], str]
    cases: Callable[[Problem], Iterator[Case]]
    settings: dict[str, str] = field(default_factory=dict)


def largest_distance(found: np.ndarray, expected: np.ndarray) -> float:
    """The error measure: m, over all times and markers; nan unless all times were reached."""
    if found.shape != expected.shape or not np.isfinite(found).all():
        return math.nan
    return float(np.linalg.norm(found - expected, axis=2).max())


def pace() -> float:
    """Seconds of a fixed piece of work in plain Python, the least of three: how fast the machine is just now."""
    least = math.inf
    for _ in range(3):
        began, total = time.perf_counter(), 0.0
        for i in range(3000):
            total += 0.5 * i
        least = min(least, time.perf_counter() - began)
    return least


def timed(run: Callable[[], Any]) -> tuple[float, float, Any]:
    """Seconds of a run, the same over the pace around it, and what it returned."""
    before, began = pace(), time.perf_counter()
    result = run()
    seconds = time.perf_counter() - began
    return seconds, seconds / (0.5 * (before + pace())), result


def measure(engine: Engine, problem: Problem, reference: np.ndarray, effort: Effort) -> Iterator[Row]:
    """Rows of one engine on one scene.

    The first run of each method is thrown away, so that compilation, imports and cold caches are in no figure. A ladder
    ends once a run takes longer than `effort.longest`.
    """
    warm: set[str] = set()
    finished: set[str] = set()
    rung: dict[str, int] = {}
    for case in engine.cases(problem):
        rung[case.method] = rung.get(case.method, -1) + 1
        if case.method in finished or rung[case.method] % effort.every:
            continue
        row = Row(problem.name, engine.name, case.method, case.setting)
        try:
            if case.method not in warm:
                warm.add(case.method)
                case.run()
            seconds, share, result = timed(case.run)
            runs = [(share, seconds)]
            while len(runs) < effort.repeats and (len(runs) < _LEAST or sum(taken for _, taken in runs) < effort.total):
                again, share, _ = timed(case.run)
                runs.append((share, again))
            # the lower one of two: a machine that stalls only adds
            share, seconds = statistics.median_low(runs)
            row.seconds, row.runs, row.pace = seconds, len(runs), seconds / share
            counts = case.counts(result)
            row.steps, row.evaluations = counts.get("steps"), counts.get("evaluations")
            row.error = largest_distance(case.positions(result), reference)
            row.note = "did not reach the end" if math.isnan(row.error) else ""
            if seconds > (3.0 if problem.events else 1.0) * effort.longest:
                finished.add(case.method)
        except Exception as failure:  # whatever an engine raises is a result of that engine, not the benchmark's end
            row.note = " ".join(str(failure).split())[:160] or type(failure).__name__
        yield row
