"""Many runs over a grid or a list of parameters: in processes, on a cluster, streamed to a file, resumed."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import multiprocessing
import os
import pickle
import signal
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from .. import __version__
from ..cores import available_cores
from ..errors import ArgumentError, SolverError
from ..jit import compile_kernels
from ..loaded_scene import LoadedScene
from ..progress import progress_bar
from ..scene import Scene
from ..simulate import simulate
from ..state import State
from ..trajectory import Trajectory
from .fingerprint import fingerprint
from .sweep_file import FORMAT, Row, open_rows
from .sweep_table import SweepTable, flat_row

# How many runs may wait in an executor whose number of workers is not known: enough for a large cluster.
_QUEUE = 4096
_QUEUE_PER_WORKER = 4
_TRACEBACK_LINES = 40

Figures = dict[str, Any]
# A parameter's: a number, a text, None, or a sequence of these.
Value = bool | float | str | None | Sequence[Any] | np.ndarray


def sweep(
    build: Callable[..., Any],
    parameters: Mapping[str, Iterable[Value]] | Iterable[Mapping[str, Value]] | np.ndarray,
    *,
    names: Sequence[str] | None = None,
    measure: Callable[[Trajectory], Mapping[str, Any]] | None = None,
    file: str | os.PathLike[str] | None = None,
    runs: str | os.PathLike[str] | None = None,
    resume: bool | str = True,
    retry: bool = False,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> SweepTable:
    """Call a function with many sets of parameters, simulate what it describes, and collect figures.

    A run that raises is a row with its `error`; so is one that takes its process down. Ctrl-C ends the runs under way
    and leaves a file from which the same call goes on.

    Parameters
    ----------
    build : callable
        Called as build(**parameters) where the run is made (models and scenes do not travel between processes). It
        returns (scene, state, options), with `simulate`'s arguments as a dict; or what `load_scene` returns; or a
        Trajectory; or a mapping of figures, from names to numbers, texts, None, or arrays or lists of these.
    parameters : mapping of str to sequence, sequence of mappings, or (n, k) array
        Values of each parameter, for the grid of all combinations, the last name running fastest; or a list of dicts, a
        structured array, or an array with k `names`, for a list of samples. Values are numbers, texts, None, and
        sequences of these.
    names : sequence of str, optional
        Of the columns of an array.
    measure : callable, optional
        measure(run) returns a mapping of figures of a Trajectory, instead of status, message, events and steps
        (counts), t_end, q_end, v_end.
    file : str or Path, optional
        Rows are appended to it as they come (JSON lines). An interrupted sweep goes on where it was: rows in the file
        are not run again.
    runs : str or Path, optional
        A folder that keeps every Trajectory (`Trajectory.load(row["run"])`), reachable from every worker.
    resume : bool or {"anyway"}
        False begins the file anew; "anyway" goes on with a file although `build`, `measure` or the package have
        changed, which is an error otherwise.
    retry : bool
        Whether rows of the file that failed are run again.
    executor : concurrent.futures.Executor, optional
        Any, such as Dask's `client.get_executor()` or mpi4py's MPIPoolExecutor. If not given, the sweep makes processes
        of its own. Then `build` and `measure` must be functions of a module, and a script needs
        `if __name__ == "__main__":`.
    workers : int, optional
        Number of these processes, one for each core if not given; with 0 all runs are made in this process.
    progress : bool
        Whether to show a bar.

    Returns
    -------
    SweepTable
        A row for each run, in the order of the parameters.

    Raises
    ------
    ArgumentError
        For bad arguments, and for a file that does not belong to this sweep or is in use.
    TrajectoryError
        For a file that is damaged.
    SolverError
        Where no worker can be started, or an executor broke.

    Examples
    --------
    >>> import pincontact as pc
    >>> def build(mu):
    ...     scene = pc.Scene.from_urdf("urdf/ball.urdf", floating_base=True)
    ...     ball, floor = scene.add_contour("ball", pc.Sphere(0.1), "ball"), scene.add_contour("floor", pc.Plane())
    ...     scene.add_contact("ball", ball, floor, friction=pc.Coulomb(mu))
    ...     return scene, scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [1.0, 0, 0, 0, 0, 0]), {"duration": 0.5}
    >>> def measure(run):
    ...     return {"rolls_after": run.events[0].time}
    >>> table = pc.sweep(build, {"mu": [0.1, 0.2]}, measure=measure, workers=0, progress=False)
    >>> table.column("rolls_after").round(6).tolist()  # 2 v / (7 mu g)
    [0.291248, 0.145624]
    """
    samples, grid = _samples(parameters, names)
    for name, call in (("build", build), ("measure", measure)):
        if not callable(call) and not (name == "measure" and call is None):
            raise ArgumentError(f"{name} must be callable, got {call!r}")
    if resume not in (True, False, "anyway"):
        raise ArgumentError(f"resume must be True, False or 'anyway', got {resume!r}")
    if workers is not None and (executor is not None or isinstance(workers, bool) or workers < 0):
        what = "cannot be given with an executor" if executor is not None else f"must be 0 or more, got {workers!r}"
        raise ArgumentError(f"workers {what}")
    if runs is not None:
        Path(runs).mkdir(parents=True, exist_ok=True)
        runs = str(Path(runs).resolve())
    began = time.perf_counter()
    keys = [_key(sample) for sample in samples]
    header = {
        "sweep": FORMAT,
        "names": list(samples[0]) if samples else [],
        "build": _title(build),
        "fingerprint": fingerprint(build) + ("" if measure is None else fingerprint(measure)),
        "version": __version__,
    }
    with open_rows(None if file is None else Path(file), header, resume) as (stored, write):
        done = {key: stored[key] for key in keys if key in stored and not (retry and stored[key]["error"])}
        # a set of parameters that is given twice is run once
        waiting = {key: sample for key, sample in zip(keys, samples) if key not in done}
        with progress_bar(progress, len(done) + len(waiting), initial=len(done), unit="run") as bar:
            _Sweep(build, measure, runs, waiting, done, write, bar).run(executor, workers)
    names = tuple(samples[0]) if samples else tuple(grid or ())
    return SweepTable([flat_row(done[key]) for key in keys], names, grid, time.perf_counter() - began)


# ---------------------------------------------------------------------------------------------------- parameters


def _samples(parameters: Any, names: Sequence[str] | None) -> tuple[list[Row], dict[str, list[Any]] | None]:
    """The sets of parameters as plain data, and the grid's axes."""
    is_array = isinstance(parameters, np.ndarray)
    if names is not None and not (is_array and parameters.dtype.names is None):
        raise ArgumentError("names are for parameters given as an array (n, k)")
    if isinstance(parameters, Mapping):
        axes = {}
        for name, values in parameters.items():
            if isinstance(values, (str, bytes, Mapping)) or not hasattr(values, "__iter__"):
                raise ArgumentError(f"parameter {name!r} must be a sequence of values, got {values!r}")
            axes[_name(name)] = [_plain(value, f"parameter {name!r}") for value in values]
        return [dict(zip(axes, values)) for values in itertools.product(*axes.values())], axes
    if is_array:
        names = parameters.dtype.names or names
        rows = parameters.reshape(-1) if parameters.dtype.names else parameters
        if parameters.dtype.names is None and (rows.ndim != 2 or names is None or len(names) != rows.shape[1]):
            count = "no names" if names is None else f"{len(names)} names"
            raise ArgumentError(
                f"parameters as an array must be structured, or (n, k) with k names; got {parameters.shape}, {count}"
            )
        parameters = [dict(zip(names or (), row)) for row in rows.tolist()]
    if not isinstance(parameters, Iterable):
        raise ArgumentError(f"parameters must be a dict, a list of dicts or an array, got {parameters!r}")
    samples: list[Row] = []
    for i, entry in enumerate(parameters):
        if not isinstance(entry, Mapping):
            raise ArgumentError(f"parameters[{i}] must be a dict, got {entry!r}")
        samples.append({_name(name): _plain(value, f"parameters[{i}][{name!r}]") for name, value in entry.items()})
        if samples[i].keys() != samples[0].keys():
            raise ArgumentError(f"parameters[{i}] has the names {list(entry)}, parameters[0] has {list(samples[0])}")
    return samples, None


def _name(name: Any) -> str:
    if not isinstance(name, str) or not name.isidentifier() or name in ("error", "run"):
        raise ArgumentError(f"a parameter's name must be an identifier other than 'error' and 'run', got {name!r}")
    return name


def _plain(value: Any, what: str) -> Any:
    """Numbers, texts, None and lists of these, as JSON keeps them."""
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (list, tuple)):
        return [_plain(entry, what) for entry in value]
    raise ArgumentError(f"{what} must be a number, a text, None or a sequence of these, got {value!r}")


def _key(sample: Row) -> str:
    """Names one set of parameters, whatever their order."""
    return hashlib.sha256(json.dumps(sample, sort_keys=True).encode()).hexdigest()[:24]


# ---------------------------------------------------------------------------------------------------- one run


def _perform(build: Callable[..., Any], measure: Any, folder: str | None, key: str, sample: Row) -> Row:
    """One run, in whatever process: what goes into the file, as plain data. Never raises but for an interrupt."""
    began = time.perf_counter()
    figures: Figures = {}
    error = ""
    trace: list[str] = []
    try:
        made = build(**sample)
        if isinstance(made, Mapping):
            figures = _checked_figures(made, "build")
        else:
            figures = _figures_of(_run(made), measure, folder, key)
        for name in figures:
            if name in sample or name == "error":
                raise ArgumentError(f"figure {name!r} has the name of a parameter or of the error")
    except (Exception, SystemExit) as failure:
        figures = {}
        error = f"{type(failure).__name__}: {failure}"
        trace = "".join(traceback.format_exception(failure)).splitlines()[-_TRACEBACK_LINES:]
    row = {"key": key, "parameters": sample, "figures": figures, "error": error}
    return row | ({"traceback": trace} if trace else {}) | {"seconds": time.perf_counter() - began}


def _run(made: Any) -> Trajectory:
    if isinstance(made, Trajectory):
        return made
    if isinstance(made, LoadedScene):
        return made.simulate()
    if isinstance(made, tuple) and len(made) == 3:
        scene, state, options = made
        if isinstance(scene, Scene) and isinstance(state, State) and isinstance(options, Mapping):
            return simulate(scene, state, **options)
    raise ArgumentError(
        "build must return (scene, state, options of simulate), a loaded scene, a Trajectory or a mapping of figures; "
        f"got {type(made).__name__}"
    )


def _figures_of(run: Trajectory, measure: Any, folder: str | None, key: str) -> Figures:
    if measure is not None:
        figures = _checked_figures(measure(run), "measure")
    else:
        last = slice(-1, None)
        figures = {
            "status": run.status,
            "message": run.message,
            "t_end": float(run.t[-1]) if run.t.size else None,
            "events": len(run.events),
            "steps": run.stats.get("steps"),
            "q_end": [float(x) for x in run.q[last].ravel()],
            "v_end": [float(x) for x in run.v[last].ravel()],
        }
    if folder is not None:
        target = os.path.join(folder, f"{key}.npz")
        # a file with this name is a whole one
        os.replace(run.save(f"{target}.{os.getpid()}.part"), target)
        figures["run"] = target
    return figures


def _checked_figures(figures: Any, what: str) -> Figures:
    if not isinstance(figures, Mapping):
        raise ArgumentError(f"{what} must return a mapping of figures, got {type(figures).__name__}")
    return {str(name): _plain(value, f"figure {name!r}") for name, value in figures.items()}


# ---------------------------------------------------------------------------------------------------- all runs


@dataclass
class _Sweep:
    """The runs of one call: waiting, sets of parameters by key, become rows in `done`, which `write` stores."""

    build: Callable[..., Any]
    measure: Callable[[Trajectory], Mapping[str, Any]] | None
    folder: str | None
    waiting: dict[str, Row]
    done: dict[str, Row]
    write: Callable[[Row], None]
    bar: Any

    def run(self, executor: Executor | None, workers: int | None) -> None:
        if not self.waiting:
            return
        if executor is not None:
            lost = self._on(executor, list(self.waiting), _QUEUE)
            if lost:
                raise SolverError(f"the executor broke with {len(lost)} runs under way; the rows so far are kept")
        elif workers == 0:
            for key in self.waiting:
                self._keep(_perform(*self._task(key)))
        else:
            self._in_processes(min(workers or available_cores(), len(self.waiting)))

    def _task(self, key: str) -> tuple[Any, ...]:
        return self.build, self.measure, self.folder, key, self.waiting[key]

    def _keep(self, row: Row) -> None:
        self.write(row)
        self.done[row["key"]] = row
        self.bar.update(1)

    def _on(self, executor: Executor, keys: list[str], queue: int) -> list[str]:
        """Run on an executor; returns the keys that were under way when it broke."""
        pending: dict[Future[Row], str] = {}
        waiting = deque(keys)
        # waiting on all of them at each turn would cost their number squared
        finished: SimpleQueue[Future[Row]] = SimpleQueue()
        lost: list[str] = []
        try:
            while True:
                while waiting and not lost and len(pending) < queue:
                    try:
                        future = executor.submit(_perform, *self._task(waiting[0]))
                    except BrokenExecutor:
                        lost.append(waiting[0])
                        break
                    pending[future] = waiting.popleft()
                    future.add_done_callback(finished.put)
                if not pending:
                    return lost
                future = finished.get()
                key = pending.pop(future)
                try:
                    self._keep(future.result())
                except BrokenExecutor:
                    lost.append(key)
                except Exception as failure:
                    # the executor's own trouble: a function that cannot travel, a worker that was lost
                    self._keep(self._failure(key, f"{type(failure).__name__}: {failure}"))
        except BaseException:
            for future in pending:
                future.cancel()
            raise

    def _failure(self, key: str, error: str) -> Row:
        return {"key": key, "parameters": self.waiting[key], "figures": {}, "error": error, "seconds": math.nan}

    def _in_processes(self, workers: int) -> None:
        """Run in processes of our own; a run that takes its process down is found by running it alone."""
        for what, function in (("build", self.build), ("measure", self.measure)):
            try:
                pickle.dumps(function)
            except Exception as error:
                raise ArgumentError(
                    f"{what} cannot be sent to other processes ({error}): it must be a function of a module, not a "
                    "lambda or a function within another; or pass workers=0, or an executor that can send it"
                ) from None
        # kernels are compiled here once, those of method "Moreau" too, and not by every worker
        import_module("..integration.moreau", __package__)
        compile_kernels(several=True, stepping=True)
        while keys := self._missing(self.waiting):
            suspects = self._pool(workers, keys, _QUEUE_PER_WORKER * workers)
            while suspects:
                # one of them did it: one by one, it shows itself
                for key in self._pool(1, suspects, 1):
                    self._keep(self._failure(key, "BrokenProcessPool: the run ended its process (crash, no memory)"))
                suspects = self._missing(suspects)

    def _missing(self, keys: Iterable[str]) -> list[str]:
        return [key for key in keys if key not in self.done]

    def _pool(self, workers: int, keys: list[str], queue: int) -> list[str]:
        """Run in new processes; returns the keys that were under way when one of them ended by itself."""
        # forked children of a process with threads (BLAS, a notebook) may hang. Ctrl-C is for the process that sweeps
        context, ignored = multiprocessing.get_context("spawn"), (signal.SIGINT, signal.SIG_IGN)
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=signal.signal, initargs=ignored)
        try:
            try:
                missing = pool.submit(_arrives, pickle.dumps((self.build, self.measure))).result()
            except BrokenExecutor as error:
                raise SolverError(
                    "the worker processes ended before they had started: a script that sweeps needs "
                    'if __name__ == "__main__": around its own work, since its workers import it'
                ) from error
            if missing:
                raise ArgumentError(f"build cannot be imported by worker processes ({missing}): put it in a module")
            return self._on(pool, keys, queue)
        except BaseException:
            for process in list((pool._processes or {}).values()):
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _arrives(functions: bytes) -> str:
    """Why a worker cannot read what it shall call; nothing if it can."""
    try:
        pickle.loads(functions)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


def _title(function: Any) -> str:
    inner = function.func if isinstance(function, partial) else function
    return f"{getattr(inner, '__module__', '?')}.{getattr(inner, '__qualname__', type(inner).__qualname__)}"
