"""Sweeps: rows are right wherever they are made, failures stay alone, files survive interruption and notice changes."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import sweep_cases as cases

import pincontact as pc
from pincontact.analysis.fingerprint import fingerprint

HERE = Path(__file__).parent


def here(build, parameters, **options):
    """Runs in this process, without a bar."""
    return pc.sweep(build, parameters, progress=False, workers=0, **options)


def assert_right(table):
    """Distances of beads on ramps against the closed form; the default error of a run is far below 1e-7 m."""
    for row in table:
        assert row["error"] == ""
        assert row["distance"] == pytest.approx(cases.path(row["mu"], row["angle"]), abs=1e-7)


# ------------------------------------------------------------------------------------------------------- protocol


def test_grid_of_runs():
    grid = {"mu": np.array([0.1, 0.2, 0.3]), "angle": (0.2, 0.4)}
    table = here(cases.bead_on_ramp, grid, measure=cases.distance)
    assert_right(table)
    assert [(row["mu"], row["angle"]) for row in table] == [(m, a) for m in (0.1, 0.2, 0.3) for a in (0.2, 0.4)]
    expected = cases.path(*np.meshgrid([0.1, 0.2, 0.3], [0.2, 0.4], indexing="ij"))
    np.testing.assert_allclose(table.grid("distance"), expected, atol=1e-7)
    assert table.grid("force").shape == (3, 2, 3)
    structured = table.to_numpy()
    assert structured.dtype["force"].shape == (3,) and structured["distance"][0] == table[0]["distance"]
    assert table.columns == ("mu", "angle", "distance", "force", "error")


def test_figures_of_a_run_without_measure():
    (row,) = here(cases.bead_on_ramp, [{"mu": 0.1, "angle": 0.2}])
    run = pc.simulate(*cases.bead_on_ramp(0.1, 0.2)[:2], **cases.bead_on_ramp(0.1, 0.2)[2])
    assert (row["status"], row["t_end"], row["steps"], row["events"]) == (0, 0.2, run.stats["steps"], 0)
    assert row["q_end"] == run.q[-1].tolist() and row["v_end"] == run.v[-1].tolist()


def test_what_build_may_return():
    scene_file = HERE.parent / "examples" / "scenes" / "block_on_incline.toml"

    def build(kind):
        scene, state, options = cases.bead_on_ramp(0.1, 0.2)
        return {
            "trajectory": lambda: pc.simulate(scene, state, **options),
            "figures": lambda: {"status": -7},
            "file": lambda: pc.load_scene(scene_file),
            "nonsense": lambda: (scene, state),
        }[kind]()

    table = here(build, {"kind": ["trajectory", "figures", "file", "nonsense"]})
    assert [row.get("status") for row in table] == [0, -7, 0, None]
    assert table[3]["error"].startswith("ArgumentError: build must return (scene, state, options")
    assert table[2]["t_end"] == pc.load_scene(scene_file).settings["duration"]


@pytest.mark.parametrize(
    "parameters",
    [
        [{"mu": 0.1, "angle": 0.2}, {"mu": 0.3, "angle": 0.4}],
        np.array([(0.1, 0.2), (0.3, 0.4)], dtype=[("mu", float), ("angle", float)]),
    ],
)
def test_samples(parameters):
    table = here(cases.bead_on_ramp, parameters, measure=cases.distance)
    assert_right(table)
    np.testing.assert_array_equal(table.column("angle"), [0.2, 0.4])
    with pytest.raises(pc.ArgumentError, match="not over a grid"):
        table.grid("distance")


def test_samples_as_an_array():
    table = here(cases.bead_on_ramp, np.array([[0.1, 0.2], [0.3, 0.4]]), names=("mu", "angle"), measure=cases.distance)
    assert_right(table)
    with pytest.raises(pc.ArgumentError, match=r"\(2, 2\), 1 names"):
        here(cases.bead_on_ramp, np.zeros((2, 2)), names=("mu",))


def test_a_failed_run_is_a_row():
    table = here(cases.figures_or_trouble, {"x": [1, 2, 3, 4, 5]})
    assert [row["error"].split(":")[0] for row in table] == ["", "ValueError", "ArgumentError", "SystemExit", ""]
    assert "two is too much" in table[1]["error"] and "figure 'y'" in table[2]["error"]
    assert len(table.failed) == 3
    y = table.column("y")
    np.testing.assert_array_equal(y[[0, 4]], [1.0, 25.0])
    assert np.isnan(y[1:4]).all()
    assert table.column("word").tolist() == ["n1", "", "", "", "n5"]


def test_no_runs():
    assert len(here(cases.figures_or_trouble, {"x": []})) == 0
    assert here(cases.figures_or_trouble, []).to_numpy().size == 0


@pytest.mark.parametrize(
    ("parameters", "options", "message"),
    [
        ({"x": 3}, {}, "parameter 'x' must be a sequence"),
        ({"x": "abc"}, {}, "parameter 'x' must be a sequence"),
        ({"x": [object()]}, {}, "must be a number, a text"),
        ({"error": [1]}, {}, "an identifier other than"),
        ([{"x": 1}, {"y": 1}], {}, r"parameters\[1\] has the names \['y'\]"),
        ([3], {}, r"parameters\[0\] must be a dict"),
        (3, {}, "must be a dict, a list"),
        ({"x": [1]}, {"names": ("x",)}, "names are for"),
        ({"x": [1]}, {"workers": -1}, "0 or more, got -1"),
        ({"x": [1]}, {"workers": 2, "executor": ThreadPoolExecutor()}, "cannot be given with an executor"),
        ({"x": [1]}, {"resume": "perhaps"}, "resume must be"),
        ({"x": [1]}, {"file": "no/such/folder/rows"}, "cannot be written"),
    ],
)
def test_bad_arguments(parameters, options, message):
    with pytest.raises(pc.ArgumentError, match=message):
        pc.sweep(cases.figures_or_trouble, parameters, progress=False, **options)


# ------------------------------------------------------------------------------------------------------- processes


def test_worker_processes(tmp_path):
    """The same rows as in one process; trajectories are kept."""
    grid = {"mu": [0.1, 0.3], "angle": [0.2, 0.4]}
    table = pc.sweep(
        cases.bead_on_ramp, grid, measure=cases.distance, runs=tmp_path / "runs", workers=2, progress=False
    )
    assert_right(table)
    alone = here(cases.bead_on_ramp, grid, measure=cases.distance)
    assert [row["distance"] for row in table] == [row["distance"] for row in alone]
    stored = pc.Trajectory.load(table[2]["run"])
    assert np.linalg.norm(stored.q[-1]) == table[2]["distance"]
    assert len(list((tmp_path / "runs").iterdir())) == 4


def test_a_run_that_takes_its_process_down(tmp_path):
    file = tmp_path / "rows"
    table = pc.sweep(cases.crashes_at_two, {"x": [0, 1, 2]}, workers=1, file=file, progress=False)
    assert [row.get("y") for row in table] == [0, 1, None]
    assert "ended its process" in table[2]["error"]


def test_functions_that_cannot_travel():
    with pytest.raises(pc.ArgumentError, match="build cannot be sent"):
        pc.sweep(lambda x: {"y": x}, {"x": [1]}, progress=False)


def test_a_script_without_a_guard(tmp_path):
    """Its workers would sweep themselves: a typed error instead."""
    script = tmp_path / "script.py"
    script.write_text(
        "import pincontact as pc\n"
        "def build(x):\n    return {'y': x}\n"
        "try:\n    pc.sweep(build, {'x': [1, 2]}, workers=1, progress=False)\n"
        "except pc.SolverError as error:\n    print('typed:', error)\n"
    )
    done = run_script(script)
    assert "typed: the worker processes ended before they had started" in done.stdout
    assert "__main__" in done.stdout


def run_script(script):
    return subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120, env=environment())


def environment():
    return dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path))


@pytest.mark.skipif(sys.platform == "win32", reason="signals of consoles")
def test_interrupt_leaves_a_file_to_go_on_from(tmp_path):
    script, file = tmp_path / "script.py", tmp_path / "rows"
    script.write_text(
        "import signal\n"
        # a shell's background job ignores interrupts, and so do its children
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "import pincontact as pc\nimport sweep_cases\n"
        "if __name__ == '__main__':\n"
        f"    pc.sweep(sweep_cases.slow, {{'x': range(200)}}, workers=2, file={str(file)!r}, progress=False)\n"
    )
    # a group of its own, as a shell gives it: Ctrl-C reaches the workers too
    started = subprocess.Popen(
        [sys.executable, str(script)], env=environment(), stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 100.0
    while not (file.exists() and len(file.read_bytes().splitlines()) > 6) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(started.pid, signal.SIGINT)
    message = started.communicate(timeout=60)[1]
    assert started.returncode != 0 and "KeyboardInterrupt" in message
    before = pc.SweepTable.load(file)
    assert 5 <= len(before) < 200
    for process in set(before.column("process").tolist()):
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)
    # no more than what is there: rows that are kept are not made again
    kept = sorted(row["x"] for row in before)
    again = here(cases.slow, {"x": kept}, file=file)
    assert {row["process"] for row in again} == set(before.column("process"))


# ------------------------------------------------------------------------------------------------------- executors


@pytest.mark.parametrize("pool", [partial(ThreadPoolExecutor, 2), partial(ProcessPoolExecutor, 1)])
def test_executors_of_the_standard_library(pool):
    with pool() as executor:
        table = pc.sweep(cases.figures_or_trouble, {"x": [0, 1, 2, 3]}, executor=executor, progress=False)
    assert [row.get("y") for row in table] == [0, 1, None, None]


def test_an_executor_that_breaks(tmp_path):
    """Rows that came before are in the file, the others are not."""
    file = tmp_path / "rows"
    with ProcessPoolExecutor(1) as executor, pytest.raises(pc.SolverError, match="executor broke"):
        pc.sweep(cases.crashes_at_two, {"x": [0, 1, 2, 3]}, executor=executor, file=file, progress=False)
    assert not pc.SweepTable.load(file).failed


def test_a_cluster_of_dask(tmp_path):
    """A worker of a real cluster on this machine; even functions that plain pickling cannot send."""
    distributed = pytest.importorskip("distributed", reason="Dask's cluster is the extra `cluster`")
    shift = 0.05
    file = tmp_path / "rows"
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None, local_directory=str(tmp_path)
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        table = pc.sweep(
            lambda mu, angle: cases.bead_on_ramp(mu - shift, angle),
            {"mu": [0.15, 0.25, 0.35], "angle": [0.2, 0.4]},
            measure=lambda run: {**cases.distance(run), "process": os.getpid()},
            executor=client.get_executor(),
            file=file,
            progress=False,
        )
        workers = set(client.run(os.getpid).values())
    for row in table:
        assert row["error"] == ""
        assert row["distance"] == pytest.approx(cases.path(row["mu"] - shift, row["angle"]), abs=1e-7)
    assert set(table.column("process")) == workers and os.getpid() not in workers
    assert len(pc.SweepTable.load(file)) == 6


# ------------------------------------------------------------------------------------------------------- files


def calls(folder):
    return [int(line) for line in (folder / "calls").read_text().split()]


def test_rows_are_not_made_twice(tmp_path):
    file, folder = tmp_path / "rows", str(tmp_path)
    build = partial(cases.counted, folder=folder)
    first = here(build, {"x": [1, 2]}, file=file)
    second = here(build, {"x": [2, 3, 1, 3]}, file=file)
    assert calls(tmp_path) == [1, 2, 3]
    assert [row["y"] for row in second] == [4, 6, 2, 6]
    assert [row["y"] for row in first] == [2, 4]
    assert sorted(row["x"] for row in pc.SweepTable.load(file)) == [1, 2, 3]
    here(build, {"x": [1]}, file=file, resume=False)
    assert calls(tmp_path) == [1, 2, 3, 1]
    assert len(pc.SweepTable.load(file)) == 1


def test_failed_rows_are_tried_again_on_request(tmp_path):
    file, lamp = tmp_path / "rows", tmp_path / "lamp"

    def build(x):
        if x == 1 and not lamp.exists():
            raise RuntimeError("it is dark")
        return {"y": x}

    assert len(here(build, {"x": [0, 1]}, file=file).failed) == 1
    lamp.touch()
    assert len(here(build, {"x": [0, 1]}, file=file).failed) == 1
    assert not here(build, {"x": [0, 1]}, file=file, retry=True).failed
    assert not pc.SweepTable.load(file).failed


def test_a_line_that_a_crash_cut_short(tmp_path):
    file, folder = tmp_path / "rows", str(tmp_path)
    build = partial(cases.counted, folder=folder)
    here(build, {"x": [1, 2, 3]}, file=file)
    whole = file.read_bytes()
    for cut in (1, 10, len(whole.splitlines()[-1])):
        (tmp_path / "calls").unlink()
        file.write_bytes(whole[:-cut])
        assert [row["y"] for row in here(build, {"x": [1, 2, 3]}, file=file)] == [2, 4, 6]
        assert calls(tmp_path) == [3]
        assert [json.loads(line) for line in file.read_bytes().splitlines()][-1]["figures"] == {"y": 6}
    # nor may half a first line stop the next sweep
    file.write_bytes(whole[:5])
    assert len(here(build, {"x": [1, 2, 3]}, file=file)) == 3


@pytest.mark.parametrize(
    "content", ["a letter\n", '{"a": 1}\n', "no sweep", '{"sweep": 99, "names": [], "build": ""}\n']
)
def test_other_files_are_left_alone(tmp_path, content):
    file = tmp_path / "rows"
    file.write_text(content)
    for resume in (True, False):
        with pytest.raises(pc.TrajectoryError, match="rows"):
            here(cases.figures_or_trouble, {"x": [1]}, file=file, resume=resume)
    assert file.read_text() == content


def test_changes_are_noticed(tmp_path):
    file = tmp_path / "rows"
    here(cases.figures_or_trouble, {"x": [1]}, file=file)
    with pytest.raises(pc.ArgumentError, match=r"figures_or_trouble and build or measure have changed"):
        here(cases.crashes_at_two, {"x": [1]}, file=file)
    with pytest.raises(pc.ArgumentError, match=r"names have changed since \(from \['x'\] to \['z'\]\)"):
        here(cases.figures_or_trouble, {"z": [1]}, file=file)
    assert here(cases.crashes_at_two, {"x": [1, 5]}, file=file, resume="anyway").column("y").tolist() == [1, 5]


def test_one_sweep_at_a_time(tmp_path):
    pytest.importorskip("fcntl", reason="no file locks here")
    file = tmp_path / "rows"

    def build(x):
        return {"inner": here(cases.figures_or_trouble, {"x": [1]}, file=file)[0]["y"]}

    assert "in use by another sweep" in here(build, {"x": [1]}, file=file)[0]["error"]


SOURCE = """
LENGTH = 2.0
def used(x):
    return LENGTH * x
def build(x, scale=1.0):
    return {"y": used(x) * scale}
"""


def test_fingerprint_sees_what_matters(tmp_path):
    """Its own code, helpers, constants and defaults; not comments and blank lines."""

    def of(text):
        # a file of its own: sources are looked up by name
        path = tmp_path / f"module{len(list(tmp_path.iterdir()))}.py"
        path.write_text(text)
        names = {"__name__": "module"}
        exec(compile(text, str(path), "exec"), names)
        return fingerprint(names["build"])

    same = of(SOURCE)
    assert of(SOURCE.replace("    return LENGTH", "    # why\n\n    return LENGTH")) == same
    for old, new in (("LENGTH * x", "LENGTH / x"), ("2.0", "3.0"), ("scale=1.0", "scale=2.0"), ("* scale", "+ scale")):
        assert of(SOURCE.replace(old, new)) != same, (old, new)
    assert fingerprint(partial(cases.slow, x=1)) != fingerprint(partial(cases.slow, x=2))
    values = np.arange(3.0)
    assert fingerprint(lambda x: values * x) == fingerprint(lambda x: values * x)


# ------------------------------------------------------------------------------------------------------- tables


def test_pandas_and_xarray():
    pandas = pytest.importorskip("pandas", reason="pandas is in the extra `data`")
    xarray = pytest.importorskip("xarray", reason="xarray is in the extra `data`")
    table = here(cases.bead_on_ramp, {"mu": [0.1, 0.3], "angle": [0.2, 0.4, 0.5]}, measure=cases.distance)
    frame = table.to_pandas()
    assert isinstance(frame, pandas.DataFrame) and list(frame.columns) == list(table.columns)
    assert frame[(frame.mu == 0.3) & (frame.angle == 0.4)].distance.item() == table[4]["distance"]
    data = table.to_xarray()
    assert isinstance(data, xarray.Dataset) and data.force.dims == ("mu", "angle", "force_0")
    assert float(data.distance.sel(mu=0.3, angle=0.4)) == table[4]["distance"]
    samples = here(cases.figures_or_trouble, [{"x": 0}, {"x": 1}]).to_xarray()
    assert samples.y.dims == ("run",)


@pytest.mark.parametrize(("package", "method"), [("pandas", "to_pandas"), ("xarray", "to_xarray")])
def test_missing_packages(monkeypatch, package, method):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(pc.MissingExtraError, match=rf"{package}.*pincontact\[data\]"):
        getattr(here(cases.figures_or_trouble, {"x": [1]}), method)()


def test_progress(capsys):
    pc.sweep(cases.figures_or_trouble, {"x": [0, 1]}, workers=0)
    captured = capsys.readouterr()
    assert "2/2" in captured.err or "100 %" in captured.out
