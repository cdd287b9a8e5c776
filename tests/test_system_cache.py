"""A scene's second run uses the arrays of its first: nothing but the time it takes may tell."""

import gc
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pinocchio as pin
import pytest
from reference import build

import pincontact as pc
from pincontact import system_cache
from pincontact.integration.run_system import RunSystem

DURATION = 0.4
TIMES = np.linspace(0.0, DURATION, 9)
BALL = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]


def block_on_slope():
    """A prismatic joint with a limit, dry friction and damping."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.gravity.linear = np.array([3.0, 0.0, -9.0])
    model.upperPositionLimit[0], model.lowerPositionLimit[0] = 0.1, -1.0
    model.upperDryFrictionLimit[0], model.lowerDryFrictionLimit[0] = 0.5, -0.5
    model.damping[0] = 0.3
    scene = pc.Scene(model)
    return scene, scene.initial_state([0.0], [0.2])


def ball_on(motion=None, friction=None, placement=None):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.004 * np.eye(3)), pin.SE3.Identity())
    scene = pc.Scene(model)
    # the frame is a joint's: its placement is used as it is given
    ball = scene.add_contour("ball", pc.Sphere(0.1), "ball", placement)
    floor = scene.add_contour("floor", pc.Plane(), motion=motion)
    scene.add_contact("ball", ball, floor, friction=friction or pc.Coulomb(0.2), restitution=0.5)
    return scene, scene.initial_state(BALL, [0.5, 0.2, 0.0, 0.0, 0.0, 1.0])


def heaving(t):
    z = np.array([0.0, 0.0, 1.0])
    pose = pin.SE3(np.eye(3), 0.01 * (1.0 - np.cos(6.0 * t)) * z)
    return pose, np.r_[0.06 * np.sin(6.0 * t) * z, 0, 0, 0], np.r_[0.36 * np.cos(6.0 * t) * z, 0, 0, 0]


def poses():
    return [pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.01 * np.sin(i) ** 2])) for i in range(8)]


SCENES = {
    "driven, called": lambda: ball_on(pc.CallableMotion(heaving)),
    "driven, spline": lambda: ball_on(pc.SplineMotion(np.linspace(0.0, 1.0, 8), poses())),
    "driven, oscillating": lambda: build("disk_heaving_incline_roll", native=True),
    "driven, turning": lambda: build("cam_eccentric_flat_follower", native=True),
    "spline surface": lambda: build("arm_on_heightfield_frictionless", native=True),
    "traced shapes": lambda: build("helix_bead_slip"),
    "charts": lambda: build("ball_on_plane_through_pole", native=True),
    "charts, slip": lambda: build("ellipsoid_in_ellipsoid_slip_then_roll", native=True),
    "redundant feet": lambda: build("tripod_slide_straight", native=True),
    "crossing curves": lambda: build("ring_on_rod_slip_then_stick", native=True),
    "limits and dry friction": block_on_slope,
}


def push(t, q, v):
    return 0.05 * np.cos(3.0 * t) - 0.01 * v


def simulated(scene, state, **options):
    tolerances = {} if options.get("method") == "Moreau" else {"rtol": 1e-6, "atol": 1e-8}
    return pc.simulate(scene, state, DURATION, **({"t_eval": TIMES} | tolerances | options))


def assert_same(a, b):
    """Every bit of two runs, except how long they took."""
    assert (a.status, a.message) == (b.status, b.message)
    every = [{"t": run.t, "q": run.q, "v": run.v, **vars(run._recorded)} for run in (a, b)]
    one, two = (values.pop("forces") for values in every)
    assert {i: forces.tobytes() for i, forces in one.items()} == {i: forces.tobytes() for i, forces in two.items()}
    for name, one in every[0].items():
        two = every[1][name]
        assert (one is None) == (two is None), name
        assert one is None or one.tobytes() == two.tobytes(), name
    assert [(e.time, e.contact, e.joint, e.kind, e.q.tobytes(), e.v.tobytes()) for e in a.events] == [
        (e.time, e.contact, e.joint, e.kind, e.q.tobytes(), e.v.tobytes()) for e in b.events
    ]
    assert {**a.stats, "wall_time": 0} == {**b.stats, "wall_time": 0}


def is_cached(scene):
    return any(system_cache._cache.get(scene, {}).values())


@pytest.mark.parametrize("name", SCENES)
def test_runs_are_the_same_bit_by_bit(name):
    """After runs with other methods, works and torques have left everything they could in the arrays."""
    ways = [
        {"method": "Moreau", "step": 0.02},
        {"energies": True, "control": push},
        {"method": "RK45", "t_eval": None},
        {"control": push, "events": lambda t, q, v: v[0] - 0.1},
        {},
    ]
    scene, state = SCENES[name]()
    firsts = [simulated(*SCENES[name](), **options) for options in ways]
    assert all(run.status == 0 for run in firsts), [run.message for run in firsts]
    kept = [run.q.copy() for run in firsts]
    for options, first in zip(ways, firsts, strict=True):
        simulated(scene, state, **options)
        assert is_cached(scene)
        assert_same(simulated(scene, state, **options), first)
    # nothing of an earlier run is written to
    assert all((run.q == q).all() for run, q in zip(firsts, kept, strict=True))


def set_damping(scene):
    scene.model.damping[:] = 0.1


def set_gravity(scene):
    scene.model.gravity.linear = np.array([0.5, 0.0, -5.0])


def set_mass(scene):
    scene.model.inertias[1].mass = 2.0


def set_limit(scene):
    scene.model.upperPositionLimit[0] = 0.01


def set_dry_friction(scene):
    scene.model.upperDryFrictionLimit[0], scene.model.lowerDryFrictionLimit[0] = 0.8, -0.6


def set_placement(scene):
    scene.contours["ball"].placement.translation[0] = 0.01


def set_motion(scene):
    scene.contours["floor"].motion.parameters[2] *= 2.0


CHANGES = [set_damping, set_gravity, set_mass, set_limit, set_dry_friction, set_placement, set_motion]


@pytest.mark.parametrize("change", CHANGES)
def test_what_is_written_to_a_model_or_a_motion_counts(change):
    def make():
        if change in (set_limit, set_dry_friction):
            return block_on_slope()
        motion = pc.HarmonicMotion((0.0, 0.0, 0.005), 1.0)
        return ball_on(motion, pc.Coulomb(0.3), pin.SE3.Identity())

    scene, state = make()
    before = simulated(scene, state)
    change(scene)
    fresh, fresh_state = make()
    change(fresh)
    changed = simulated(scene, state)
    assert_same(changed, simulated(fresh, fresh_state))
    assert changed.status == before.status == 0
    assert (changed.q != before.q).any()


def test_contacts_added_later_count():
    scene, state = ball_on()
    simulated(scene, state)
    wall = scene.add_contour(
        "wall", pc.Plane(), placement=pin.SE3(pin.utils.rotate("y", -np.pi / 2), np.r_[0.15, 0, 0])
    )
    scene.add_contact("wall", scene.contours["ball"], wall, restitution=0.5)
    run = simulated(scene, scene.initial_state(BALL, [0.5, 0.2, 0.0, 0.0, 0.0, 1.0], free=["wall"]))
    assert "wall" in {event.contact for event in run.events}


def test_runs_within_runs_and_in_other_threads():
    scene, state = ball_on()
    alone = simulated(scene, state)
    inner = []

    def control(t, q, v):
        if not inner:
            inner.append(simulated(scene, state))
        return np.zeros(6)

    outer = simulated(scene, state, control=control)
    assert_same(inner[0], alone)
    # what a control does is looked at every 0.1 s at least
    assert (outer.q == simulated(scene, state, max_step=0.1).q).all()
    found = []
    threads = [threading.Thread(target=lambda: found.append(simulated(scene, state))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    for run in found:
        assert_same(run, alone)


def test_runs_that_fail_leave_nothing_behind():
    scene, state = ball_on()
    first = simulated(scene, state)

    def fails(t, q, v):
        if t > 0.1:
            raise ValueError("no more")
        return np.full(6, 0.1)

    def raises(t, q, v):
        raise pc.ArgumentError("mine")

    with pytest.raises(ValueError, match="no more"):
        simulated(scene, state, control=fails)
    assert not is_cached(scene)
    assert_same(simulated(scene, state), first)
    with pytest.raises(pc.ArgumentError, match="mine"):
        simulated(scene, state, control=raises)
    assert_same(simulated(scene, state), first)


def test_nothing_of_the_user_is_kept_alive():
    scene, state = ball_on()

    class Control:
        def __call__(self, t, q, v):
            return np.zeros(6)

    control = Control()
    simulated(scene, state, control=control)
    gone = weakref.ref(control)
    del control
    gc.collect()
    assert is_cached(scene)
    assert gone() is None
    gone = weakref.ref(scene)
    del scene, state
    gc.collect()
    assert gone() is None


def test_threads_that_ask_a_run_at_once():
    """What each of them finds is kept once, whoever comes first; none comes too late for the recorded rows."""
    scene, state = ball_on()
    run = simulated(scene, state, method="Moreau", step=0.01)
    both, unpack = threading.Barrier(2, timeout=60.0), run._unpack

    def together():
        both.wait()
        return unpack()

    run._unpack = together
    with ThreadPoolExecutor(2) as pool:
        one, two = pool.map(lambda _: run.state(-1), range(2))
    assert one.discrete.tobytes() == two.discrete.tobytes()
    assert run._recorded is run._recorded


def rolled_out(scene, state, starts=3, threads=3):
    torques = np.random.default_rng(1).normal(size=(starts, 5, scene.model.nv))
    return pc.rollout(scene, state, torques, 1e-3, 4, threads=threads)


def test_rollouts_make_their_systems_once(monkeypatch):
    """The second call makes none, also after runs of other kinds; of more than there are processors those are not kept
    that nobody could use at once."""
    made = []
    monkeypatch.setattr(system_cache, "available_cores", lambda: 3)
    monkeypatch.setattr(
        system_cache, "RunSystem", lambda *given, **options: made.append(1) or RunSystem(*given, **options)
    )
    scene, state = ball_on()
    first = rolled_out(scene, state)
    assert len(made) == 3
    simulated(scene, state)
    assert len(made) == 4
    simulated(scene, state, method="Moreau", step=0.01)
    for threads in (1, 3):
        for one, other in zip(rolled_out(scene, state, threads=threads), first):
            np.testing.assert_array_equal(one, other)
    assert len(made) == 4
    rolled_out(scene, state, starts=8, threads=8)
    assert len(made) == 9
    assert sum(len(kept) for kept in system_cache._cache[scene].values()) == 4


def test_rollouts_see_what_was_changed():
    """Of a model that was written to, and of actuators and solvers that the next call has not."""
    scene, state = ball_on()
    first = rolled_out(scene, state)
    rolled = pc.rollout(scene, state, np.zeros((2, 5, 6)), 1e-3, 4, 2, "proxqp", (0.0, 3.0, state.q))
    assert (rolled[0] != first[0][:2]).any()
    for one, other in zip(rolled_out(scene, state), first):
        np.testing.assert_array_equal(one, other)
    set_gravity(scene)
    fresh, fresh_state = ball_on()
    set_gravity(fresh)
    for one, other, before in zip(rolled_out(scene, state), rolled_out(fresh, fresh_state), first):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == int or (one != before).any()


def test_rollouts_at_once():
    """From threads of the user's own: each has its systems."""
    scene, state = ball_on()
    alone = rolled_out(scene, state)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: rolled_out(scene, state), range(12)):
            for one, other in zip(found, alone):
                np.testing.assert_array_equal(one, other)


def test_rollouts_that_raise_keep_no_system():
    fails = []

    def shaken(t):
        if fails:
            raise ZeroDivisionError("the drive")
        return heaving(t)

    scene, state = ball_on(pc.CallableMotion(shaken))
    first = rolled_out(scene, state)
    fails.append(True)
    with pytest.raises(ZeroDivisionError, match="the drive"):
        rolled_out(scene, state)
    assert not is_cached(scene)
    fails.clear()
    for one, other in zip(rolled_out(scene, state), first):
        np.testing.assert_array_equal(one, other)
    gone = weakref.ref(scene)
    del scene, state
    gc.collect()
    assert gone() is None
