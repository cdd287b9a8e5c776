"""Runs in other packages' tables: the same numbers under the names that are written down."""

import sys

import numpy as np
import pytest
from stress_scenes import ball_in_bowl, disk, leaning

import pincontact as pc


@pytest.fixture(scope="module")
def run():
    scene = disk(0.5, 1.0, pc.Coulomb(0.3))
    state = scene.initial_state(leaning(0.5, 1.2), [0, 0, 0, 0.1, 0.4, 6.0], max_gap=0.1)
    return pc.simulate(scene, state, 0.5, t_eval=np.linspace(0.0, 0.5, 11), energies=True)


def test_xarray(run, tmp_path):
    xarray = pytest.importorskip("xarray", reason="xarray is in the extra `data`")
    data = run.to_xarray()
    assert isinstance(data, xarray.Dataset)
    track = run.contacts["c"]
    np.testing.assert_array_equal(data.force.sel(contact="c", axis="z"), track.force[:, 2])
    np.testing.assert_array_equal(data.frame.sel(contact="c", direction=3), track.frame[:, :, 2])
    np.testing.assert_array_equal(data.v.sel(velocity="root[5]"), run.v[:, 5])
    np.testing.assert_array_equal(data.friction_work, run.energies().friction_work)
    assert data.q.sel(t=0.25, method="nearest").shape == (7,)
    assert (data.attrs["status"], data.gap.attrs["units"]) == (0, "m")
    # a circle has one parameter, a plane two
    assert np.isnan(data.location_first[:, 0, 1]).all() and np.isfinite(data.location_second).all()
    assert "position" in pc.simulate(*still()).to_xarray().dims


def still():
    """A scene without contacts."""
    scene = pc.Scene(ball_in_bowl(0.1, 0.1, None).model)
    return scene, scene.initial_state([0, 0, 0, 0, 0, 0, 1.0]), 0.1


def test_pandas(run):
    pandas = pytest.importorskip("pandas", reason="pandas is in the extra `data`")
    frame = run.to_pandas()
    assert isinstance(frame, pandas.DataFrame) and frame.index.name == "t"
    np.testing.assert_array_equal(frame.index, run.t)
    np.testing.assert_array_equal(frame["q.root[2]"], run.q[:, 2])
    np.testing.assert_array_equal(frame["c.force.z"], run.contacts["c"].force[:, 2])
    np.testing.assert_array_equal(frame["c.mode"], run.contacts["c"].mode)
    np.testing.assert_array_equal(frame["c.location_second.2"], run.contacts["c"].location_second[:, 1])
    assert "c.location_first.2" not in frame
    assert len(pc.simulate(*still()).to_pandas().columns) == 13


def test_runs_read_from_files(run, tmp_path):
    pytest.importorskip("xarray", reason="xarray is in the extra `data`")
    run.save(tmp_path / "run.npz")
    stored = pc.Trajectory.load(tmp_path / "run.npz")
    data, frame = stored.to_xarray(), stored.to_pandas()
    np.testing.assert_array_equal(data.v.sel(velocity="5"), run.v[:, 5])
    np.testing.assert_array_equal(data.force.sel(contact="c"), run.contacts["c"].force)
    np.testing.assert_array_equal(frame["q.2"], run.q[:, 2])
    assert "kinetic" not in data


@pytest.mark.parametrize(("package", "method"), [("pandas", "to_pandas"), ("xarray", "to_xarray")])
def test_missing_packages(monkeypatch, run, package, method):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(pc.MissingExtraError, match=rf"{package}.*pincontact\[data\]"):
        getattr(run, method)()
