"""The work-precision benchmark's own parts, without peers: errors fall with the tolerance, files can be read."""

import csv
import math
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numba
import numpy as np
import pytest

import pincontact as pc
from pincontact.dynamics.pinocchio_calls import PinocchioCalls

BENCHMARKS = Path(__file__).parents[1] / "examples" / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import breakdown  # noqa: E402
import cone  # noqa: E402
import cost  # noqa: E402
import real_time  # noqa: E402
import rollouts  # noqa: E402
import timing  # noqa: E402
import work_precision  # noqa: E402
from peers import problem as numbers  # noqa: E402
from peers import with_pincontact, with_pinocchio  # noqa: E402
from peers.event_scenes import EVENT_SCENES  # noqa: E402
from peers.measure import Row, largest_distance  # noqa: E402
from peers.scenes import SCENES  # noqa: E402


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("work_precision")
    result = work_precision.main(["--scenes", "cam,disk_roll", "--peers", "none", "--quick", "--output", str(folder)])
    return result, folder


@pytest.mark.parametrize("scene", ["cam", "disk_roll"])
def test_errors_fall_with_the_tolerance(finished, scene):
    """A hundredth of rtol gains at least a factor of three, down to rounding (1e-11 m over metres of path)."""
    rows = finished[0].rows
    for method, least in (("DOP853", 5), ("Sharp98", 3), ("RK45", 3), ("Moreau", 2)):
        runs = [row for row in rows if row.scene == scene and row.method == method]
        # the longest steps of time stepping may be too long, and are then refused; and with a tolerance as large as the
        # motion nothing falls with it, or a run ends early
        coarse = ("rtol 1", "rtol 0.3")
        errors = [row.error for row in runs if "the step is too long" not in row.note and row.setting not in coarse]
        assert len(errors) >= least
        assert np.isfinite(errors).all()
        above = [e for e in errors if e > 1e-11]
        assert all(finer < coarser / 3.0 for coarser, finer in pairwise(above))
        # the coarsest and the finest setting are far apart: a ladder that stalls would not get here
        assert errors[-1] < 5e-2 * errors[0]


def test_closed_form_is_met(finished):
    """The cam's quadrature and the integration at the tightest tolerance know nothing of each other."""
    best = min(row.error for row in finished[0].rows if row.scene == "cam" and row.method == "DOP853")
    assert best < 1e-12


def test_files(finished):
    """A row in the CSV for each run, a figure for each scene, small enough for a README."""
    result, folder = finished
    with open(folder / "work_precision.csv") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(result.rows)
    assert {row["scene"] for row in rows} == {"cam", "disk_roll"}
    np.testing.assert_array_equal([float(row["error"]) for row in rows], [row.error for row in result.rows])
    for name in ("cam", "disk_roll"):
        assert 1_000 < (folder / f"work_precision_{name}.png").stat().st_size < 60_000


def test_section_names_the_winner(finished, tmp_path):
    """A peer that is quicker at one level, and only there, is named with that level, and between the marks."""
    result = finished[0]
    problem, ours = result.problems["cam"], [row for row in result.rows if row.scene == "cam"]
    quickest = work_precision.fastest(ours, 1e-2)
    assert quickest is not None
    peer = Row("cam", "Peer", "m", "s", seconds=0.5 * quickest.seconds, error=0.9e-2)
    small = work_precision.Result(
        {"cam": problem}, {"cam": ""}, {}, [1e-2], [*ours, peer], {"pincontact": "0", "Peer": "1"}
    )
    assert [(scene, level, row.engine) for scene, level, row, _ in work_precision.losses(small)] == [
        ("cam", 1e-1, "Peer"),
        ("cam", 1e-2, "Peer"),
    ]
    readme = tmp_path / "README.md"
    readme.write_text("before\n" + "\nold\n".join(work_precision.MARKS) + "\nafter\n")
    for _ in range(2):  # writing it again changes nothing
        work_precision.write_section(readme, work_precision.section(small))
    text = readme.read_text()
    assert text.startswith("before\n") and text.endswith("\nafter\n")
    assert "old" not in text
    assert "Peer on the cam and flat follower at errors of 1e-01 to 1e-02 m" in " ".join(text.split())
    assert text.count(work_precision.MARKS[0]) == 1
    # one that is slower is named where it comes closest
    peer.seconds = 1.5 * quickest.seconds
    assert not work_precision.losses(small)
    assert "Where a peer wins: nowhere in this run. Closest comes Peer on the cam" in " ".join(
        work_precision.section(small).split()
    )
    peer.seconds = 0.5 * quickest.seconds
    # a motion that is as small as an error says nothing of it: the cam's circle goes round with a radius of 3 cm
    assert result.reach["cam"] == pytest.approx(0.06, rel=0.01)
    small.reach["cam"] = result.reach["cam"]
    assert [level for _, level, _, _ in work_precision.losses(small)] == [1e-2]
    assert "from its start: cam and flat follower 0.06 m." in " ".join(work_precision.section(small).split())


def test_unknown_names():
    with pytest.raises(SystemExit, match="unknown scenes: cab"):
        work_precision.main(["--scenes", "cab"])
    with pytest.raises(SystemExit, match="unknown peers: bullet"):
        work_precision.main(["--peers", "bullet"])


def test_error_measure():
    """The largest distance over times and markers; runs that ended early or went astray have none."""
    expected = np.zeros((3, 2, 3))
    found = expected.copy()
    found[1, 1] = (3e-3, 4e-3, 0.0)
    assert largest_distance(found, expected) == pytest.approx(5e-3, rel=1e-12)
    assert math.isnan(largest_distance(found[:2], expected))
    found[2, 0, 0] = math.nan
    assert math.isnan(largest_distance(found, expected))


@pytest.mark.parametrize("name", list(SCENES))
def test_kinematics_of_the_scenes(name):
    """The neutral kinematics that the peers start from agree with Pinocchio's, velocities included."""
    import pinocchio as pin
    from peers.pinocchio_model import build_model

    problem = SCENES[name]()
    model = build_model(problem)
    rng = np.random.default_rng(5)
    q = pin.integrate(model, problem.q, rng.normal(size=model.nv))
    v = rng.normal(size=model.nv)
    data = model.createData()
    pin.forwardKinematics(model, data, q, v)
    where = numbers.poses(problem, q, v)
    for body in problem.bodies:
        joint = model.getJointId(f"{body.name} joint")
        frame, velocity = data.oMi[joint], pin.getVelocity(model, data, joint, pin.LOCAL_WORLD_ALIGNED)
        pose = where[body.name]
        # sums of a few terms of size one
        np.testing.assert_allclose(pose.turn, frame.rotation, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(pose.place, frame.translation, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(pose.velocity, velocity.linear, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(pose.omega, velocity.angular, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(numbers.matrix(numbers.quaternion(pose.turn)), pose.turn, rtol=0.0, atol=1e-13)


def shortened(name, duration):
    return with_pincontact.consistent(replace(SCENES[name](), duration=duration, intervals=8))


@pytest.mark.parametrize("name, duration, kinds", [
    ("forced_block", 0.9, {"stick", "slip"}), ("belt", 2.0, {"stick", "slip"}), ("rattle", 0.85, {"touch", "separate"})
])  # fmt: skip
def test_event_scenes_have_closed_forms(name, duration, kinds):
    """Runs of the package in three ways, of which the closed forms know nothing. With error control they agree to the
    tolerance, some hundred steps of time stepping are off by first order at impacts, by second elsewhere."""
    problem = shortened(name, duration)
    exact = problem.closed_form(problem.times)
    run = with_pincontact.simulate(problem, "DOP853", rtol=1e-7, atol=1e-9)()
    assert kinds <= {event.kind for event in run.events}
    assert largest_distance(numbers.marked(problem, run.q), exact) < 1e-7
    steps = with_pincontact.simulate(problem, "Moreau", dt=duration / 800)()
    assert largest_distance(numbers.marked(problem, steps.q), exact) < (2e-3 if name == "rattle" else 2e-5)
    # forces of steps' middles; the same, but for the controller that time stepping asks
    rows = with_pincontact.rollout(problem, 100)()
    assert largest_distance(numbers.marked(problem, rows), exact) < (2e-3 if name == "rattle" else 2e-5)


def test_trot_of_others():
    """Footfalls of the quadruped by error control, by time stepping, and by Pinocchio's contact solver in steps of
    first order: they agree to the accuracy of each."""
    problem = shortened("trot", 0.2)
    run = with_pincontact.simulate(problem, "DOP853", rtol=1e-6, atol=1e-8)()
    kinds = [event.kind for event in run.events]
    # hops lower than gaps are known to at this tolerance are left out
    assert kinds.count("separate") > 2 and kinds.count("touch") >= 2
    expected = numbers.marked(problem, run.q)
    steps = with_pincontact.simulate(problem, "Moreau", dt=2e-4)()
    assert largest_distance(numbers.marked(problem, steps.q), expected) < 1e-4
    rows = with_pincontact.rollout(problem, 100)()
    assert largest_distance(numbers.marked(problem, rows), expected) < 2e-4
    coarse, fine = (with_pinocchio.stepped(problem, each) for each in (10, 40))
    errors = [largest_distance(case.positions(case.run()), expected) for case in (coarse, fine)]
    assert errors[1] < 5e-4
    assert errors[0] > 2.5 * errors[1]


def test_event_scenes_have_a_section_of_their_own(finished, tmp_path):
    """It is written once all of its scenes have been run, and only then."""
    readme = tmp_path / "README.md"
    readme.write_text("\n".join([*work_precision.MARKS, "between", *work_precision.EVENT_MARKS]))
    result = finished[0]
    before = readme.read_text()
    work_precision.write_sections(readme, result)
    assert readme.read_text() == before
    problems = {name: make() for name, make in EVENT_SCENES.items()}
    rows = [Row(name, "pincontact", "m", "s", seconds=1e-3, error=1e-5, pace=1.0) for name in problems]
    absent = [("Peer", "trot", "no legs"), ("Peer", "cam", "no cams")]
    ours = work_precision.Result(
        problems, dict.fromkeys(problems, ""), {}, [1e-6], rows, {"pincontact": "0"}, {}, absent
    )
    work_precision.write_sections(readme, ours)
    text = readme.read_text()
    assert text.startswith("\n".join([*work_precision.MARKS, "between"]))
    assert "| trotting quadruped (2 s) | **1**, – |" in text
    assert "Not run by Peer, for the reasons printed: trotting quadruped." in text


@pytest.mark.skipif(
    sys.platform != "linux" or bool(numba.config.DISABLE_JIT), reason="kernels call Pinocchio through Python"
)
def test_parts_of_an_evaluation_are_told_apart():
    """Pinocchio's part is what is left out where its functions do nothing; what is not told apart is no number."""
    one, other = (breakdown._evaluated(*breakdown.disk(None)) for _ in range(2))
    pinocchio, kernels = breakdown.evaluation_parts(one, other)
    assert pinocchio > 0.0
    assert kernels > 0.0
    other.pinocchio.native = None
    assert np.isnan(breakdown.evaluation_parts(one, other)).all()


def test_clock_counts_what_is_nested_once():
    """Two kinds of work, one within the other: what each takes itself adds up to the whole."""
    scene, state = breakdown._bouncing_ball()
    compiled, handler = breakdown.RunSystem.run, breakdown.driver.Driver._complete
    began = time.perf_counter()
    with breakdown.timed() as clock:
        run = pc.simulate(scene, state, 0.5, t_eval=[0.5])
    whole = time.perf_counter() - began
    assert [event.kind for event in run.events] == ["touch"]
    assert 0 < clock.evaluations < run.stats["rhs"]
    assert set(clock.inside) >= {"compiled", "handler"}
    assert 0.0 < sum(clock.inside.values()) + sum(clock.outside.values()) <= whole
    # and everything is as it was
    assert (breakdown.RunSystem.run, breakdown.driver.Driver._complete) == (compiled, handler)


@pytest.mark.parametrize("scene", ["block", "quadruped"])
def test_rollouts(scene, capsys, monkeypatch):
    """Errors of all starts fall with the step; springs are the actuators'."""
    monkeypatch.setattr(rollouts, "mujocos", lambda problems: iter(()))
    rows = rollouts.main(["--starts", "3", "--quick", "--scenes", scene])
    errors = [error for _, label, _, error, _, _ in rows if label == "pincontact"]
    assert len(errors) == 3
    assert errors[0] > 1.5 * errors[1] > 2.25 * errors[2]
    assert errors[2] < 1e-3
    assert "speed-up" in capsys.readouterr().out


@pytest.mark.parametrize("loop", ["standing", "trot", "block"])
def test_control_loop(loop, capsys):
    real_time.main(["--steps", "200", "--loops", loop])
    assert "99.9 %" in capsys.readouterr().out


def test_what_programs_solve_alone_is_counted_by_rank(capsys):
    count = 60
    unsolved = cone.program_shares(count, 0)
    lines = capsys.readouterr().out.splitlines()[unsolved:]
    assert unsolved <= 1
    assert lines[0].startswith(f"all: {count - unsolved} of {count} ")
    # dense problems of more rows than columns, feet from three on, and bodies with more contacts than motions
    full, redundant = (int(line.split(" of ")[1].split()[0]) for line in lines[1:3])
    assert full + redundant == count and min(full, redundant) >= 10


def test_programs_take_no_help_from_other_stages():
    solver = cone.programs_alone()
    for _, _, problem in cone.random_problems(10, 0):
        solver.forget()
        assert solver.solve(*problem)
    assert {name: count for name, count in solver.decided.items() if count} == {"qp": 10}


def test_cost_of_robots(monkeypatch, capsys):
    """Each takes longer than Pinocchio's part alone."""
    monkeypatch.setattr(timing, "BATCHES", 3)
    rows = []
    cost.robots(lambda *row: rows.append(row))
    assert len(rows) == 4 and all(0.0 < aba < spent for _, spent, aba, _ in rows)
    if PinocchioCalls(cost.free_body(), cost.free_body().createData(), np.zeros(7), np.zeros(6)).native is not None:
        parts = [float(line.split()[-2]) for line in capsys.readouterr().out.splitlines()[2:]]
        assert len(parts) == 4 and all(0.0 < part < spent for part, (_, spent, _, _) in zip(parts, rows))
