"""The gallery: each script's main() in a short form, its numbers against closed forms and published ones."""

import ast
import base64
import importlib.util
import math
import re
import sys
from importlib import metadata
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def run_example(name, function="main", **options):
    # examples import what they share
    if str(EXAMPLES) not in sys.path:
        sys.path.insert(0, str(EXAMPLES))
    specification = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return getattr(module, function)(**options)


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


def test_paper_section6_is_drawn(tmp_path, monkeypatch):
    """Contact coordinates above, lengths of both traces below; the paper's dots lie on the package's lines."""
    pyplot = pytest.importorskip("matplotlib.pyplot", reason="Matplotlib is in the extra `plot`")
    drawn = []
    monkeypatch.setattr(pyplot, "close", drawn.append)
    run_example("paper_section6", duration=0.2, plot=tmp_path / "section6.png")
    assert (tmp_path / "section6.png").stat().st_size > 10_000
    monkeypatch.undo()
    (figure,) = drawn
    titles = [ax.get_title() for ax in figure.axes]
    assert [title.split(";")[0] for title in titles[:2]] == ["rolling", "sliding"]
    for ax, count in zip(figure.axes, (3, 3, 2, 2)):
        lines, dots = (
            [line for line in ax.lines if (line.get_linestyle() == "None") == dotted] for dotted in (False, True)
        )
        assert len(lines) == len(dots) == count
        for line, dot in zip(lines, dots):
            at = [list(line.get_xdata()).index(time) for time in dot.get_xdata()]
            # both are integrated at 1e-11
            assert line.get_ydata()[at] == pytest.approx(dot.get_ydata(), abs=1e-8)
    rolling, sliding = ([line.get_ydata()[-1] for line in ax.lines[:2]] for ax in figure.axes[2:])
    assert rolling[0] == pytest.approx(rolling[1], abs=1e-9) and abs(sliding[0] - sliding[1]) > 1e-2
    pyplot.close(figure)


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


def needs(*packages):
    """Skip where a package with robots is not installed."""
    for package in packages:
        try:
            metadata.distribution(package)
        except metadata.PackageNotFoundError:
            pytest.skip(f"{package} is not installed, whose robot is simulated")


def test_quadruped_lifts_foot():
    found = run_example("quadruped_lifts_foot", duration=1.8, dt=5e-3)
    assert found["raised"] == pytest.approx(0.03, rel=1e-3)
    assert found["trunk_error"] < 1e-4
    # three feet at rest but for what the controller's rates leave
    assert found["load_error"] < 1e-2
    assert found["least_load"] > 10.0
    assert found["largest_ratio"] < 0.6
    assert found["largest_effort"] < 8.0
    # rounding, of loads of 60 N
    assert found["residual"] < 1e-11
    assert found["lifted_force"] == 0.0


def test_arm_wipes_in_closed_loop():
    found = run_example("arm_wipes_in_closed_loop", duration=0.4, dt=2e-3)
    assert found["slides"] == 1.0
    # torques are those of the step's begin: of first order in the step
    assert found["force_error"] < 20.0 * 1e-2
    assert found["mean_force"] == pytest.approx(20.0, rel=2e-3)
    assert found["work_error"] < 2e-3
    assert found["off_circle"] < 1e-3
    assert found["largest_effort"] < 60.0
    assert found["up_and_down"] > 1e-3


def test_rover_drives_curve():
    found = run_example("rover_drives_curve", duration=2.5, dt=5e-3)
    assert found["sliding"] == 0.0
    assert found["limited"] > 10.0
    # what is trusted in, and no more
    assert found["largest_ratio"] == pytest.approx(0.45, abs=1e-6)
    assert found["speed"] == pytest.approx(1.4, rel=1e-5)
    # forces of a step along the axes at its end
    assert found["sideways"] == pytest.approx(found["expected_sideways"], rel=1e-3)
    assert found["transfer"] == pytest.approx(found["expected_transfer"], rel=1e-3)
    assert found["off_circle"] < 0.02


def test_panda_rolls_ball():
    needs("example-robot-data")
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


def test_ball_on_plate():
    pytest.importorskip("gymnasium", reason="needs gymnasium: pip install pincontact[gym]")
    found = run_example("ball_on_plate", duration=0.6)
    # it starts 172 mm away, near a corner, and 0.29 m/s fast: left alone it would fall off
    assert found["start"] == pytest.approx(math.hypot(0.14, 0.1), abs=1e-12)
    assert found["fell"] == 0.0 and found["end"] < 0.9 * found["start"] and found["speed"] < 0.2
    # a run under the planned torques is the episode, to the last bit
    assert found["replayed"] == 0.0


def options_of(path):
    """What calls of an example's script say of `--html`, and whether what it writes is printed."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    added = [
        call
        for call in calls
        if call.args and isinstance(call.args[0], ast.Constant) and call.args[0].value == "--html"
    ]
    metavars = [k.value.value for call in added for k in call.keywords if k.arg == "metavar"]
    writers = ("export_html(", "page_of_pictures(")
    said = [
        call for call in calls if ast.unparse(call.func) == "print" and any(w in ast.unparse(call) for w in writers)
    ]
    return metavars, len(said)


def test_html_is_a_file_in_every_example():
    """And each says what it wrote."""
    seen = 0
    for path in sorted(EXAMPLES.glob("*.py")):
        metavars, said = options_of(path)
        assert metavars == ["FILE"] and said == 1, path.name
        assert "[--html FILE]" in path.read_text(encoding="utf-8"), path.name
        seen += 1
    assert seen >= 25


def test_examples_call_a_step_of_time_dt():
    """The one name of the interface; `step` and its like are aliases for those who come from elsewhere."""
    for path in sorted(EXAMPLES.glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                named = {word.arg for word in node.keywords}
                assert not named & {"step", "time_step", "timestep"}, f"{path.name}:{node.lineno}"


def test_robot_data_lists_and_draws_a_description(tmp_path, capsys):
    needs("example-robot-data")
    # as it is without arguments: a robot whose knees cannot be straight
    assert run_example("robot_data") == {"files": ["go2.urdf"], "status": 0}
    page = tmp_path / "arm.html"
    found = run_example("robot_data", description="double_pendulum_description", html=page)
    assert "double_pendulum.urdf" in found["files"] and found["status"] == 0
    assert capsys.readouterr().out.endswith(f"wrote {page}\n") and "animation" in page.read_text(encoding="utf-8")


def test_gallery_page_holds_its_pictures(tmp_path):
    image = pytest.importorskip("PIL.Image")
    for name, color in (("rover", "red"), ("plots", "blue")):
        image.new("RGB", (4, 4), color).save(tmp_path / f"{name}.png")
    page = run_example("gallery", function="page_of_pictures", folder=tmp_path, target=tmp_path / "all.html")
    text = page.read_text(encoding="utf-8")
    names = re.findall(r"<figcaption>(\w+)</figcaption>", text)
    assert names == ["plots", "rover"]
    for name, data in zip(names, re.findall(r"base64,([^\"]+)", text)):
        assert base64.b64decode(data) == (tmp_path / f"{name}.png").read_bytes()


def test_go2():
    needs("example-robot-data")
    found = run_example("go2")
    assert found["status"] == 0 and found["events"] == 0
    # an equilibrium held by springs: nothing moves but rounding
    assert found["rest_drift"] < 1e-11
    assert found["weight_error"] < 1e-10
    # the trapezoidal rule over the outputs
    assert found["mean_error"] < 1e-4
    assert found["sway"] > 3e-3
    # what joint dampers leave a second after the push
    assert found["returns"] < 1e-4
    assert found["slip"] < 1e-12
    assert found["hard_status"] == 0 and found["hard_slips"] >= 2 and found["hard_slides"] > 1e-3


def test_talos():
    needs("example-robot-data")
    found = run_example("talos", duration=2.0)
    assert found["status"] == 0
    # statics at rest, to rounding of 90 kg; at the end the robot still sways a little
    assert found["start_apart"] < 1e-9 and found["weight_error"] < 1e-10
    assert found["moved"] > 0.01
    assert found["end_speed"] < 1e-2 and found["end_apart"] < 0.1 * found["moved"]
    assert found["all_stick"] == 1.0 and found["corner_speed"] < 1e-11
    assert found["least_load"] > 10.0


def test_mujoco_ant():
    pytest.importorskip("mujoco", reason="mujoco is not installed: it reads the ant, and runs beside it")
    needs("gymnasium")
    found = run_example("mujoco_ant")
    assert found["status"] == 0 and found["slips"] == found["sticks"] == 1.0
    assert found["rises"] > 0.02 and found["slides"] > 0.02
    # MuJoCo's contacts creep and give way: less than a hundredth of the motion
    assert found["height_apart"] < 2e-4
    assert found["angle_apart"] < 5e-4


def test_mecanum():
    found = run_example("mecanum", duration=1.6)
    for name in ("ahead", "sideways", "round"):
        assert found[f"{name}_status"] == 0 and found[f"{name}_least"] >= (2.0 if name == "round" else 4.0)
        # ellipsoids for barrels: 0.07 mm of 0.1 m, and the rollers' own slip when they take over
        assert found[f"{name}_bump"] < 2e-4
        assert found[f"{name}_ratio"] == pytest.approx(1.0, abs=0.03)
        assert found[f"{name}_across"] < 5e-3
    # straight ahead rollers do not turn, and nothing slips but where they meet
    assert found["ahead_ratio"] == pytest.approx(1.0, abs=2e-3)
