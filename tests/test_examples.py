"""The gallery: each script's main() in a short form, its numbers against closed forms and published ones."""

import importlib.util
import math
from importlib import metadata
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


def test_billiards():
    found = run_example("billiards")
    # integrated at 1e-10
    for name in ("slides", "rolls", "spins", "place"):
        assert found[name] == pytest.approx(found[f"expected_{name}"], rel=1e-9)
    assert found["place"] < 0.5 and found["events"] == 3


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


def test_paper_section6():
    found = run_example("paper_section6")
    # both sides are integrated at 1e-11, over some ten radians of turning
    for name in ("q", "v", "force", "location", "rates", "traces"):
        assert found[f"rolling_{name}"] < 1e-8 and found[f"sliding_{name}"] < 1e-8, name
    # the same formulas at the same state
    assert max(found["rolling_matrices"], found["sliding_matrices"]) < 1e-11
    # Prop. 5: without slip both traces are of one length
    assert found["rolling_way"] > 6.0 and found["rolling_apart"] < 1e-9
    assert found["sliding_apart"] > 0.1 and 1.0 < found["sticks_at"] < 2.0


def test_paper_section6_is_drawn(tmp_path):
    pytest.importorskip("matplotlib", reason="Matplotlib is in the extra `plot`")
    run_example("paper_section6", duration=0.2, plot=tmp_path / "section6.png")
    assert (tmp_path / "section6.png").stat().st_size > 10_000


def test_ball_in_bowl():
    found = run_example("ball_in_bowl", duration=2.0)
    assert found["swing"] == pytest.approx(found["swing_closed_form"], rel=1e-10)
    assert found["rate"] == pytest.approx(found["rate_closed_form"], rel=1e-9)
    assert found["rest_offset"] < 1e-9
    assert found["height_drift"] < 1e-9


def test_rover():
    found = run_example("rover", duration=3.0)
    assert found["drive_events"] == 0
    # both turnings are alike: back to straight ahead, a lane to the left
    assert found["x"] > 1.0 and found["y"] > 0.3
    # the wheels' rolling constraints, projected to rounding after each step
    assert found["sideways"] < 1e-12
    assert found["largest_yaw_rate"] > 0.5
    assert found["yaw_error"] < 1e-12 * 20.0
    assert found["gentle"] == pytest.approx(found["gentle_closed_form"], rel=1e-10)
    assert found["gentle_slip"] < 1e-12
    # an acceleration that is constant: integrated at 1e-10
    assert found["spinning"] == pytest.approx(found["spinning_closed_form"], rel=1e-9)
    assert found["spinning"] < found["gentle"]
    assert found["spinning_slip"] > 1.0


def test_quadruped():
    found = run_example("quadruped")
    assert found["status"] == 0
    # an equilibrium held by springs: nothing moves but rounding
    assert found["rest_drift"] < 1e-11
    assert found["weight_error"] < 1e-10
    assert found["cone"] == pytest.approx(0.2, rel=1e-7)
    # a step of time stepping, and the half one by which its forces are older
    assert abs(found["coarse"] - found["slips_at"]) < 2e-3
    assert found["others_stick"] == 1.0
    # what a step of 1 ms leaves of the contact's own motion, cubed
    assert found["others_slip"] < 1e-8
    assert found["slid"] > 2e-3
    assert found["sticks_again"] == 1.0


def test_wiping_arm():
    found = run_example("wiping_arm", samples=48)
    assert found["status"] == 0 and found["events"] == 0
    # what series of 24 terms leave out
    assert found["force_error"] < 20.0 * 1e-3
    assert found["angle_error"] < 1e-3
    assert found["radius_error"] < 1e-4
    assert found["cone"] < 1e-12
    # the trapezoidal rule over the outputs
    assert found["work_error"] < 1e-4
    assert found["up_and_down"] > 5e-3
    # nearly the circle's length: the pad's centre cuts corners in the valleys
    assert found["way"] == pytest.approx(2.0 * math.pi * 0.1, rel=0.02)


def test_panda_rolls_ball():
    try:
        metadata.distribution("example-robot-data")
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: the Panda arm is not simulated")
    found = run_example("panda_rolls_ball")
    assert found["status"] == 0 and found["events"] == 0
    assert found["slip"] < 1e-12
    assert found["residual"] < 1e-12
    assert found["least_force"] > 5.0
    assert found["largest_ratio"] < 0.6
    # half, but for the finger's being round
    assert found["ball_share"] == pytest.approx(0.5, abs=0.03)
    # the area that the ball's centre goes round, pi (2 cm)^2, over R^2, and more for the finger's roundness
    assert math.radians(7.0) < found["turned"] < math.radians(30.0)


def test_panda_without_its_description_says_what_is_missing(monkeypatch):
    def missing(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", missing)
    with pytest.raises(RuntimeError, match=r"pincontact\[robots\].*example-robot-data"):
        run_example("panda_rolls_ball")
