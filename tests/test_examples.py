"""The gallery: each script's main() in a short form, its numbers against closed forms and published ones."""

import importlib.util
import math
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def run_example(name, **options):
    specification = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module.main(**options)


def test_bicycle():
    found = run_example("bicycle", duration=3.0)
    # the published speeds; a root is as good as the eigenvalues, 1e-11, by their slope in the speed
    assert found["weave_speed"] == pytest.approx(4.29238253634111, abs=1e-9)
    assert found["capsize_speed"] == pytest.approx(6.02426201538837, abs=1e-9)
    # the slowest mode at 5 m/s decays at 0.32 1/s, over two seconds; at 3 m/s weave grows at 1.7 1/s
    assert found["lean_ratio_5"] < math.exp(-2.0 * 0.3)
    assert found["lean_ratio_3"] > 5.0


def test_rattleback():
    found = run_example("rattleback")
    assert found["backward_growth"] > 1.0
    assert found["forward_growth"] < 0.3 * found["backward_growth"]
    # it turns back within some times ln(1 rad / 0.5 degrees) / growth, and nearly as fast
    assert 1.0 < found["backward_reversal"] < 2.0 * math.log(1.0 / math.radians(0.5)) / found["backward_growth"]
    assert found["backward_least"] < -4.0
    assert found["forward_least"] > 4.0
    assert max(found["backward_energy"], found["forward_energy"]) < 1e-8


def test_tippe_top():
    found = run_example("tippe_top", duration=1.4)
    # the stem reaches the table where its end's lowest point does: R + a cos = r
    assert 0.5 < found["stem_touches"] < 1.4
    assert found["largest_tilt"] > math.acos(-(0.015 - 0.005) / 0.016) + 0.3
    # integrated at 1e-9
    assert found["jellett_drift"] < 1e-8
    assert found["energy_balance"] < 1e-8
    assert found["energy_ratio"] < 0.6
    # upside down it spins the other way round its own axis
    assert found["spin_about_axis"] < 0.0
    assert found["sphere_at_end"] == -1


def test_ball_on_turntable():
    found = run_example("ball_on_turntable", circles=2)
    assert found["rate_ratio"] == pytest.approx(2.0 / 7.0, abs=1e-9)
    assert found["roundness"] < 1e-9
    assert found["closing"] < 1e-9
    assert found["radius"] == pytest.approx(found["expected_radius"], rel=1e-9)


def test_bead_on_helix():
    found = run_example("bead_on_helix", duration=6.0)
    # both have come as near as the friction's relaxation lets them in 6 s
    assert found["from_rest"] == pytest.approx(found["limit"], rel=1e-5)
    assert found["from_above"] == pytest.approx(found["limit"], rel=1e-5)


def test_cam_follower():
    found = run_example("cam_follower")
    assert found["slow_events"] == 0
    assert found["slow_force"] > 0.0
    # as tight as the run's tolerance over three turns
    assert found["speed_error"] < 1e-7
    assert found["jump_angle"] == pytest.approx(found["expected_angle"], abs=1e-7)


def test_crossing_rods():
    found = run_example("crossing_rods", duration=3.5)
    assert found["frequency"] == pytest.approx(found["closed_form"], rel=1e-9)
    assert found["off_top"] < 1e-9
    assert 0.8 * found["frequency"] < found["large_frequency"] < found["frequency"]
    assert found["energy_drift"] < 1e-9


def test_ball_in_bowl():
    found = run_example("ball_in_bowl", duration=2.0)
    assert found["swing"] == pytest.approx(found["swing_closed_form"], rel=1e-10)
    assert found["rate"] == pytest.approx(found["rate_closed_form"], rel=1e-9)
    assert found["rest_offset"] < 1e-9
    assert found["height_drift"] < 1e-9
