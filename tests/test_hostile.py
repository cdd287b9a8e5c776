"""What users get wrong: it is told to them in a typed error, and no state, run or stepper is left half written."""

import copy
import dataclasses
import math
import pickle
import re
import sys
import threading

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

REST = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])
SLIDING = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])


def ball_model(mass=1.0):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    if mass:
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(mass, 0.1), pin.SE3.Identity())
    model.addBodyFrame("ball", joint, pin.SE3.Identity(), 0)
    return model


def ball_scene(friction=None, model=None):
    scene = pc.Scene(ball_model() if model is None else model)
    ball, floor = (
        scene.add_contour("ball", pc.Sphere(0.1), "ball"),
        scene.add_contour("floor", pc.Plane()),
    )
    scene.add_contact("c", ball, floor, friction=friction)
    return scene


@pytest.fixture
def scene():
    return ball_scene(pc.Coulomb(0.2))


@pytest.fixture
def state(scene):
    return scene.initial_state(REST, SLIDING)


# ---------------------------------------------------------------------------------------------------- scenes


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"name": 3}, pc.ContourError, "3"),
        ({"frame": None}, pc.ModelError, "None"),
        ({"frame": ["universe"]}, pc.ModelError, "universe"),
        ({"motion": "up and down"}, pc.ContourError, "up and down"),
        ({"motion": pc.Plane()}, pc.ContourError, "Plane"),
    ],
)
def test_contours(scene, options, error, text):
    with pytest.raises(error, match=text):
        scene.add_contour(**({"name": "new", "contour": pc.Point()} | options))
    assert list(scene.contours) == ["ball", "floor"]


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"name": None}, pc.ArgumentError, "None"),
        ({"bilateral": None}, pc.ArgumentError, "bilateral"),
        ({"bilateral": np.array([1, 2])}, pc.ArgumentError, "bilateral"),
        ({"pattern": ["S-S"]}, pc.PatternError, "S-S"),
        ({"side": np.array([1, -1])}, pc.ArgumentError, "side"),
        ({"side": "1"}, pc.ArgumentError, "side"),
    ],
)
def test_contacts(scene, options, error, text):
    with pytest.raises(error, match=text):
        scene.add_contact(**({"name": "new", "first": "ball", "second": "floor"} | options))
    assert list(scene.contacts) == ["c"]


def test_numbers_of_numpy(scene):
    contact = scene.add_contact("new", "ball", "floor", restitution=np.float32(0.5), side=np.int64(1))
    assert contact.restitution == 0.5 and contact.side == 1


def test_joints_that_mimic():
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "leader")
    second = model.addJoint(first, pin.JointModelRX(), pin.SE3.Identity(), "follower")
    for joint in (first, second):
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    with pytest.raises(pc.ModelError, match="follower"):
        pc.Scene(pin.transformJointIntoMimic(model, first, second, 2.0, 0.0))


def test_joints_that_were_not_added_depth_first():
    """Their mass matrix is wrong where the joints below another do not follow it; other orders are fine."""
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(40):
        model, parents = pin.Model(), [0]
        for j in range(1, 6):
            parents.append(int(rng.integers(0, j)))
            place = pin.SE3(pin.utils.rotate("y", rng.uniform(-1, 1)), rng.uniform(-1, 1, 3))
            model.addJoint(parents[j], pin.JointModelRX(), place, f"joint{j}")
            model.appendBodyToJoint(j, pin.Inertia.FromSphere(1.0, 0.1), place)
        q, data = rng.uniform(-1, 1, 5), model.createData()
        rest = pin.rnea(model, data, q, np.zeros(5), np.zeros(5))
        columns = np.array([pin.rnea(model, data, q, np.zeros(5), one) - rest for one in np.eye(5)])
        mass = np.triu(pin.crba(model, data, q, pin.Convention.WORLD))
        # both are sums of some ten terms of size one
        right = np.allclose(mass, np.triu(columns), atol=1e-12)
        if right:
            pc.Scene(model)
            continue
        refused += 1
        with pytest.raises(pc.ModelError, match="depth first") as caught:
            pc.Scene(model)
        joint, above, between = (int(name) for name in re.findall(r"'joint(\d)'", str(caught.value))[:3])
        below = [above]
        while parents[below[-1]]:
            below.append(parents[below[-1]])
        chain = joint
        while chain not in (0, above):
            chain = parents[chain]
        assert chain == above < between < joint and between not in (above, joint)
    assert 5 < refused < 35


def test_bodies_without_inertia():
    with pytest.raises(pc.ModelError, match="mass matrix"):
        ball_scene(model=ball_model(mass=0.0)).initial_state(REST)


def test_a_model_without_joints():
    scene = pc.Scene(pin.Model())
    run = pc.simulate(scene, scene.initial_state([]), 0.1)
    assert run.status == 0 and run.q.shape == (run.t.size, 0) and run.t[-1] == 0.1


# ---------------------------------------------------------------------------------------------------- states


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"q": REST * 1j}, pc.StateError, "q must be 7 numbers"),
        ({"q": [10**400] * 7}, pc.StateError, "q must be 7 numbers"),
        ({"t": "now"}, pc.StateError, "now"),
        ({"t": np.zeros(1)}, pc.StateError, "t must be finite"),
        ({"free": None}, pc.ArgumentError, "free"),
        ({"free": [["c"]]}, pc.ArgumentError, "free"),
        ({"max_gap": "wide"}, pc.ArgumentError, "wide"),
        ({"max_gap": math.nan}, pc.ArgumentError, "nan"),
        ({"max_gap": -1.0}, pc.ArgumentError, "-1"),
    ],
)
def test_starts(scene, options, error, text):
    with pytest.raises(error, match=text):
        scene.initial_state(**({"q": REST} | options))


def test_one_free_contact_by_its_name(scene):
    assert scene.initial_state(REST + np.eye(7)[2], free="c").discrete[0, 0] == -1


SPOILT = {
    "q[0] is nan": lambda s: s.q.__setitem__(0, math.nan),
    "norm 0": lambda s: s.q.__setitem__(slice(3, 7), 0.0),
    "v[1] is inf": lambda s: s.v.__setitem__(1, math.inf),
    "q must have 7": lambda s: dataclasses.replace(s, q=np.zeros(3)),
    "v must have 6": lambda s: dataclasses.replace(s, v=np.zeros(60)),
    "q must be an array": lambda s: dataclasses.replace(s, q=None),
    "t must be finite, got inf": lambda s: dataclasses.replace(s, t=math.inf),
    "t must be finite, got '0'": lambda s: dataclasses.replace(s, t="0"),
    "location[0, 1] is nan": lambda s: dataclasses.replace(s, location=np.array([[0.0, math.nan, 0.0, 0.0]])),
    "location must have shape (1, 4)": lambda s: dataclasses.replace(s, location=np.zeros((1, 7))),
    "discrete must have shape": lambda s: dataclasses.replace(s, discrete=s.discrete[:, :3]),
    "no mode 99": lambda s: s.discrete.__setitem__((0, 0), 99),
    "'ball' has no chart 9": lambda s: s.discrete.__setitem__((0, 1), 9),
}


@pytest.mark.parametrize("text", SPOILT)
def test_states_that_were_written_to(scene, state, text):
    spoilt = SPOILT[text](state) or state
    calls = [
        lambda: pc.simulate(scene, spoilt, 0.1),
        lambda: pc.simulate(scene, spoilt, 0.1, method="Moreau"),
        lambda: pc.Stepper(scene, spoilt),
        lambda: pc.analyze(scene, spoilt),
        lambda: pc.linearize(scene, spoilt),
        lambda: pc.inverse_dynamics(scene, spoilt),
        lambda: pc.external_forces(scene, spoilt),
    ]
    for call in calls:
        with pytest.raises(pc.StateError) as caught:
            call()
        assert text in str(caught.value)


def test_a_model_that_grew(scene, state):
    scene.model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "late")
    for method in ("DOP853", "Moreau"):
        with pytest.raises(pc.StateError, match="q must have 8 entries, got 7"):
            pc.simulate(scene, state, 0.1, method=method)


@pytest.mark.parametrize("call", [pc.simulate, pc.Stepper, pc.analyze, pc.linearize, pc.inverse_dynamics])
def test_swapped_arguments(scene, state, call):
    duration = (1.0,) if call is pc.simulate else ()
    with pytest.raises(pc.ArgumentError, match="Scene, got State"):
        call(state, scene, *duration)
    with pytest.raises(pc.ArgumentError, match="got Scene"):
        call(scene, scene, *duration)


# ---------------------------------------------------------------------------------------------------- runs


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"rtol": 10**400}, "rtol"),
        ({"step": 10**400, "method": "Moreau"}, "step"),
        ({"max_steps": None}, "max_steps"),
        ({"max_steps": math.inf}, "max_steps"),
        ({"max_steps": 2.5}, "max_steps"),
        ({"max_steps": 10**30}, "max_steps"),
        ({"method": ["DOP853"]}, "method"),
        ({"method": np.zeros(2)}, "method"),
        ({"t_eval": "0.1"}, "t_eval"),
        ({"t_eval": [0.1j]}, "t_eval"),
        ({"t_eval": np.array([0.1 + 0.0j])}, "t_eval"),
        ({"t_eval": (t for t in [0.0])}, "t_eval"),
    ],
)
def test_arguments_of_simulate(scene, state, options, text):
    with pytest.raises(pc.ArgumentError, match=text):
        pc.simulate(scene, state, 0.1, **options)


@pytest.mark.parametrize(
    ("name", "value"), [("terminal", np.zeros(2)), ("terminal", 3), ("direction", math.nan), ("direction", "up")]
)
def test_attributes_of_events(scene, state, name, value):
    def event(t, q, v):
        return 1.0

    setattr(event, name, value)
    with pytest.raises(pc.ArgumentError, match=name):
        pc.simulate(scene, state, 0.1, events=event)


UNUSABLE_EVENTS = [
    (lambda t, q, v: None, "failed with TypeError"),
    (lambda t, q, v: q, "failed with TypeError"),
    (lambda t, q, v: "left", "failed with ValueError"),
    (lambda t, q, v: 10**400, "failed with OverflowError"),
    (lambda t, q, v: math.nan if t > 0.05 else 1.0, "returned nan"),
    (lambda t, q, v: t > 0.05, "returned False, not a number that changes its sign"),
    (lambda t, q, v: v[0] >= 0.0, "returned True, not a number that changes its sign"),
]


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize(("event", "text"), UNUSABLE_EVENTS)
def test_events_that_are_no_numbers_end_the_run(scene, state, method, event, text):
    run = pc.simulate(scene, state, 0.1, events=[lambda t, q, v: 1.0, event], method=method)
    assert run.status == -5 and f"events[1] {text}" in run.message
    assert np.isfinite(run.q).all() and run.t[-1] < 0.1


def test_events_without_a_definite_value(scene, state):
    """A function that answers differently each time: its signs at both ends need not be those that were seen."""
    random = np.random.default_rng(3)
    run = pc.simulate(scene, state, 0.1, events=lambda t, q, v: random.standard_normal())
    assert run.status == 0 and any(e.kind == "user" for e in run.events)


def test_events_of_any_size(scene, state):
    """Products of such values vanish or overflow; their signs are what counts."""
    for size in (1e-200, 1e200):
        run = pc.simulate(scene, state, 0.1, events=lambda t, q, v, size=size: size * (t - 0.05))
        # linear in time, so exact but for the root finder's tolerance of the step
        assert [e.time for e in run.events if e.kind == "user"] == pytest.approx([0.05], abs=1e-14)


@pytest.mark.parametrize("options", [{"atol": 1e-300, "rtol": 0.0}, {"control": lambda t, q, v: np.full(6, 1e300)}])
def test_sizes_that_overflow(scene, state, options):
    run = pc.simulate(scene, state, 0.1, max_steps=300, **options)
    assert run.status < 0 and np.isfinite(run.q).all()


def test_time_stepping_keeps_the_start_of_a_run_that_fails_at_once(scene, state):
    run = pc.simulate(scene, state, 0.1, method="Moreau", control=lambda t, q, v: v * math.nan)
    np.testing.assert_array_equal(run.t, [0.0])
    np.testing.assert_array_equal(run.q[0], state.q)
    np.testing.assert_array_equal(run.v[0], state.v)


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_a_control_that_simulates(scene, state, method):
    """Runs inside runs share nothing: what looks ahead finds what the run does later."""
    ahead = []

    def control(t, q, v):
        if not ahead:
            ahead.append(pc.simulate(scene, state, 0.05, method=method).q[-1])
        return np.zeros(6)

    run = pc.simulate(scene, state, 0.05, method=method, control=control)
    # as between a run with and without a control: the same steps, another order of the same evaluations at the most
    np.testing.assert_allclose(run.q[-1], ahead[0], atol=1e-9)


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_threads_on_one_scene(scene, state, method):
    results = [b""] * 6

    def work(i):
        control = (lambda t, q, v: np.zeros(6)) if i % 2 else None
        results[i] = pc.simulate(scene, state, 0.2, method=method, control=control, t_eval=[0.2]).q.tobytes()

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=work, args=(i,)) for i in range(len(results))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert len(set(results[::2])) == len(set(results[1::2])) == 1 and results[0]


# ---------------------------------------------------------------------------------------------------- copies, files


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy])
def test_copies_of_a_stepper_share_nothing(scene, state, duplicate):
    stepper = pc.Stepper(scene, state)
    stepper.step(np.zeros(6))
    twin, before = duplicate(stepper), stepper.q.copy()
    after = twin.step(np.zeros(6)).q.copy()
    np.testing.assert_array_equal(stepper.q, before)
    np.testing.assert_array_equal(stepper.step(np.zeros(6)).q, after)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_copies_of_states_and_runs(scene, state, duplicate):
    run = pc.simulate(scene, state, 0.1)
    twin = duplicate(state)
    again = pc.simulate(twin.scene, twin, 0.1)
    assert again.q.tobytes() == run.q.tobytes()
    assert duplicate(run).contacts["c"].force.tobytes() == run.contacts["c"].force.tobytes()


def test_runs_read_without_their_scene(scene, state, tmp_path):
    pytest.importorskip("matplotlib").use("Agg")
    from matplotlib import pyplot

    pc.simulate(scene, state, 0.1).save(tmp_path / "run.npz")
    run = pc.Trajectory.load(tmp_path / "run.npz")
    figure = run.plot()
    titles = [ax.get_title() for ax in figure.axes]
    assert "motion" in titles and "forces" in titles and "energy" not in titles
    assert len(figure.axes[0].get_lines()) == 7
    pyplot.close(figure)
    for call in (run.energies, lambda: run.external_forces(0)):
        with pytest.raises(pc.TrajectoryError, match="given its scene"):
            call()
    with pytest.raises(pc.TrajectoryError, match="int"):
        pc.Trajectory.load(tmp_path / "run.npz", scene=3)
    run.save(tmp_path / "again.npz")
    again = pc.Trajectory.load(tmp_path / "again.npz", scene)
    np.testing.assert_array_equal(again.contacts["c"].force, run.contacts["c"].force)
    assert [e.time for e in again.events] == [e.time for e in run.events] != []
    # not into a file that happens to be open
    with pytest.raises(TypeError):
        run.save(1)


@pytest.mark.parametrize(
    "options", [{"fps": "x"}, {"speed": None}, {"max_frames": None}, {"follow": 3}, {"show": None}, {"title": None}]
)
def test_arguments_of_replays(scene, state, tmp_path, options):
    run = pc.simulate(scene, state, 0.0)
    with pytest.raises(pc.ArgumentError, match=next(iter(options))):
        pc.export_html(run, tmp_path / "run.html", **options)
    assert not (tmp_path / "run.html").exists()


# ---------------------------------------------------------------------------------------------------- analysis


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda s, x: pc.linearize(s, x, tolerance=None), "tolerance"),
        (lambda s, x: pc.linearize(s, x, coordinates=3), "coordinates"),
        (lambda s, x: pc.linearize(s, x, coordinates=[0.5]), "0.5"),
        (lambda s, x: pc.inverse_dynamics(s, x, tolerance="x"), "tolerance"),
        (lambda s, x: pc.inverse_dynamics(s, x, forces=3), "forces"),
        (lambda s, x: pc.inverse_dynamics(s, x, forces=np.zeros(3)), "forces"),
        (lambda s, x: pc.inverse_dynamics(s, x, actuation={"a": 1}), "actuation"),
        (lambda s, x: pc.inverse_dynamics(s, x, actuation=np.eye(6) * 1j), "actuation"),
        (lambda s, x: pc.external_forces(s, x, forces=[1]), "forces"),
        (lambda s, x: pc.find_equilibrium(s, REST, conditions=3), "conditions"),
        (lambda s, x: pc.find_equilibrium(s, REST, tolerance=math.nan), "tolerance"),
        (lambda s, x: pc.find_steady_motion(s, REST, SLIDING, conditions="x"), "conditions"),
        (lambda s, x: pc.find_steady_motion(x, REST, SLIDING), "State"),
        (lambda s, x: pc.solve_contacts("x", np.zeros(3), 0.5), "real numbers"),
        (lambda s, x: pc.solve_contacts(np.eye(3) * 1j, np.zeros(3), 0.5), "real numbers"),
        (lambda s, x: pc.solve_contacts(np.eye(3), np.zeros(3), pc.Coulomb(0.5)), "real numbers"),
        (lambda s, x: pc.solve_contacts(np.eye(3), np.zeros(3), 0.5, tolerance=None), "tolerance"),
        (lambda s, x: pc.solve_contacts(np.eye(3), np.zeros(3), 0.5, warm=np.zeros(3)), "warm"),
        (lambda s, x: pc.centred_forces(np.eye(3), np.zeros(3), 0.5, np.zeros(3)), "ndarray"),
    ],
)
def test_arguments_of_analyses(scene, state, call, text):
    with pytest.raises(pc.ArgumentError, match=text):
        call(scene, state)


def test_problems_of_any_size():
    """G and b in units in which their products leave the range of numbers."""
    b = np.array([0.1, 0.2, -1.0])
    for size in (1e-200, 1e200):
        # u = 0 at the only force: stick, well inside the cone
        np.testing.assert_allclose(pc.solve_contacts(size * np.eye(3), b, 0.5).forces[0], -b / size, rtol=1e-12)


@pytest.mark.parametrize(
    "make, text",
    [
        (lambda: pc.Circle(0.3).samples("a"), "at least 2 values are needed along each parameter, got 'a'"),
        (lambda: pc.Circle(0.3).samples(2.5), "got 2.5"),
        (lambda: pc.Sphere(0.3).mesh(None), "got None"),
        (lambda: pc.Plane().samples(3, 7), "window must have 2 entries, got 7"),
        (lambda: pc.SplineMotion([0.0, 1.0], None), "poses must be a sequence of placements, got NoneType"),
        (lambda: pc.SplineMotion(range(6), [pin.SE3.Identity()] * 6, periodic="no"), "periodic must be True or False"),
        (lambda: pc.SplineCurve(np.eye(6)[:, :3], periodic=np.zeros(2)), "periodic must be True or False"),
        (lambda: pc.SplineSurface(np.zeros((6, 6, 3)), periodic="no"), "periodic must be a pair of booleans, got 'no'"),
        (lambda: pc.ParametricSurface(lambda u, v: (u, v, 0.0), ((0, 1), (0, 1)), (1, 2)), r"periodic\[1\] must be"),
    ],
)
def test_contours_say_what_they_were_given(make, text):
    with pytest.raises(pc.ContourError, match=text):
        make()
