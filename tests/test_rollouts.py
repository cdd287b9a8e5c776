"""Rollouts in threads are loops of steps, bit for bit; runs in threads are runs one after the other."""

import math
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np
import pinocchio as pin
import pytest
from calling import from_python
from random_scenes import random_scene
from stress.random_runs import box, chain
from test_moreau import block_scene, double_pendulum
from test_stepper import bouncing

import pincontact as pc
from pincontact.friction.centred import null_space
from pincontact.integration import impulse_cones
from pincontact.integration.impulse_choices import may_be_redundant
from pincontact.integration.impulse_layout import STEP, step_workspace
from pincontact.layout import FREE, SLIPPING, STICK

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

from quadruped import quadruped, standing

# on the quadruped's joints alone: what no push of its body makes
TWIST = np.r_[np.zeros(6), np.sin(np.arange(12.0))]


def loop(scene, state, torques, dt, substeps, **options):
    """What `rollout` does for one start, by steps; and the modes that contacts had."""
    stepper, modes = pc.Stepper(scene, state, dt, **options), set()
    q, v = np.full((len(torques), scene.model.nq), np.nan), np.full((len(torques), scene.model.nv), np.nan)
    for i, tau in enumerate(torques):
        try:
            for _ in range(substeps):
                stepper.step(tau)
                modes.update(stepper.modes.tolist())
        except pc.ContactError:
            return q, v, modes
        q[i], v[i] = stepper.q, stepper.v
    return q, v, modes


def same_as_loops(scene, states, torques, dt=1e-3, substeps=1, **options):
    """Check rollouts in one thread and in three against loops; the status, and all modes there were."""
    found = pc.rollout(scene, states, torques, dt, substeps, threads=1, **options)
    for one, three in zip(found, pc.rollout(scene, states, torques, dt, substeps, threads=3, **options)):
        np.testing.assert_array_equal(one, three)
    q, v, status = found
    seen = set()
    for i, rows in enumerate(torques):
        state = states if isinstance(states, pc.State) else states[i]
        q_i, v_i, modes = loop(scene, state, rows, dt, substeps, **options)
        np.testing.assert_array_equal(q[i], q_i)
        np.testing.assert_array_equal(v[i], v_i)
        assert (status[i] != 0) == np.isnan(q[i]).any()
        seen |= modes
    return status, seen


def random_torques(shape, size, seed=0):
    return np.random.default_rng(seed).normal(size=shape) * size


def test_block():
    """Slides, sticks, tips and opens."""
    scene, state = block_scene(0.4)
    others = [pc.Stepper(scene, state, 1e-3).step([4.0 * i, 0, 0, 0, 0, 0], 20 * i) for i in range(1, 4)]
    torques = random_torques((4, 40, 6), [20.0, 20.0, 25.0, 1.0, 1.0, 1.0])
    status, modes = same_as_loops(scene, [state, *others], torques, substeps=5)
    assert not status.any()
    assert modes == {FREE, STICK, SLIPPING}


def test_quadruped():
    scene = quadruped()
    state = standing(scene)
    torques = pc.inverse_dynamics(scene, state).tau + random_torques((3, 30, 1), 1.0) * TWIST
    status, modes = same_as_loops(scene, state, torques, substeps=3)
    assert not status.any()
    assert modes >= {STICK, SLIPPING}


def disk_scene():
    scene = pc.Scene.from_urdf(Path(__file__).resolve().parents[1] / "urdf" / "disk.urdf", floating_base=True)
    rim, floor = scene.add_contour("rim", pc.Circle(0.3), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("rim", rim, floor, friction=pc.Coulomb(0.8))
    q = pin.neutral(scene.model)
    q[2], q[3:] = 0.2796, [0, 0.564642, 0, 0.825336]
    return scene, q


def test_rolling_disk():
    """A circle on a plane, whose contact coordinates are followed by Newton's method."""
    scene, q = disk_scene()
    starts = [scene.initial_state(q, [0, 0, 0, 0, 0, spin]) for spin in (0.0, 3.0, 8.0)]
    same_as_loops(scene, starts, random_torques((3, 30, 6), 0.3), substeps=4)


def test_strikes():
    """A ball that bounces, and boxes that are thrown: contacts open, strike and open again."""
    scene, state = bouncing()
    assert same_as_loops(scene, state, random_torques((2, 40, 6), 1.0), 2e-3, 10)[1] == {FREE, SLIPPING}
    for seed in range(3):
        scene, state = box(np.random.default_rng(seed))
        same_as_loops(scene, state, random_torques((2, 30, 6), 0.1), substeps=10)


def test_limits_and_dry_friction_of_joints():
    for seed in range(4):
        scene, state = chain(np.random.default_rng(seed))
        nv = scene.model.nv
        scene.model.lowerDryFrictionLimit[:], scene.model.upperDryFrictionLimit[:] = -0.1, 0.2
        scene.model.lowerPositionLimit[:], scene.model.upperPositionLimit[:] = state.q - 0.05, state.q + 0.08
        same_as_loops(scene, state, random_torques((3, 20, nv), 2.0, seed), substeps=5)


@pytest.mark.parametrize("part", range(4))
def test_random_scenes(part):
    """All joints, laws, drives and limits, by a stepper that has had other starts before."""
    for seed in range(part, 24, 4):
        scene, state, _ = random_scene(seed)
        torques = random_torques((3, 10, scene.model.nv), 1.0, seed)
        same_as_loops(scene, state, torques, 2e-3, 3)


def test_nearest_points_that_are_searched():
    """An ellipsoid over a wavy ground: what was found on the way of one start is not known to the next."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia.FromEllipsoid(1.0, 0.1, 0.08, 0.05), pin.SE3.Identity())
    scene = pc.Scene(model)
    ground = pc.HeightField(lambda x, y: 0.05 * math.sin(3.0 * x) * math.cos(3.0 * y), domain=((-2.0, 2.0),) * 2)
    scene.add_contour("body", pc.Ellipsoid(0.1, 0.08, 0.05), "root")
    scene.add_contour("ground", ground)
    scene.add_contact("c", "body", "ground", friction=pc.Coulomb(0.4), restitution=0.3)
    starts = [
        scene.initial_state([0.1 * i, 0, 0.2, 0, 0, 0, 1], [1.0, 0.2 * i, 0, 3.0, 2.0, 1.0], free=["c"])
        for i in range(2)
    ]
    same_as_loops(scene, starts, random_torques((2, 3, 6), 0.05), 2e-3, 20)


def test_a_reset_forgets_what_was_found():
    """Nearest points on a ground that changes with time hold for their instant: at the same one another start has its
    own."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia.FromEllipsoid(1.0, 0.1, 0.08, 0.05), pin.SE3.Identity())
    scene = pc.Scene(model)
    wave = pc.HeightField(lambda x, y, t: 0.05 * math.sin(3.0 * x - t) * math.cos(3.0 * y), domain=((-2.0, 2.0),) * 2)
    scene.add_contour("body", pc.Ellipsoid(0.1, 0.08, 0.05), "root")
    scene.add_contact("c", "body", scene.add_contour("ground", wave))
    high, low = (scene.initial_state([0, 0, z, 0, 0, 0, 1], free=["c"]) for z in (1.0, 0.15))
    again, new = pc.Stepper(scene, high), pc.Stepper(scene, low)
    again.step(np.zeros(6))
    again.reset(low)
    for stepper in (again, new):
        stepper.step(np.zeros(6))
    found, expected = (stepper._step.open._known[0, True].distance for stepper in (again, new))
    assert found == expected < 0.2


def test_proxqp():
    scene, state = block_scene(0.4)
    same_as_loops(scene, state, random_torques((2, 5, 6), [20.0, 20.0, 5.0, 1.0, 1.0, 1.0]), contact_solver="proxqp")


def test_failures_are_statuses():
    """A double pendulum that is driven until it turns too far in a step, beside one that is not; and the rows before it
    failed."""
    scene = double_pendulum()
    torques = np.zeros((4, 300, 2))
    torques[1::2] = [0.0, 5.0]
    state = scene.initial_state([0.0, 0.1])
    status, _ = same_as_loops(scene, state, torques, 0.02, 3)
    assert status.tolist() == [0, -9, 0, -9]
    q, _, _ = pc.rollout(scene, state, torques, 0.02, 3)
    assert 0 < np.isfinite(q[1, :, 0]).sum() < 300


def test_starts_that_fail_at_once():
    """A disk that lies flat touches along its rim."""
    scene, q = disk_scene()
    fine, flat = scene.initial_state(q), scene.initial_state(q)
    flat.q[2], flat.q[3:] = 0.0, [0, 0, 0, 1]
    with pytest.raises(pc.SingularContactError):
        pc.Stepper(scene, flat)
    for threads in (1, 2):
        q, v, status = pc.rollout(scene, [flat, fine, flat], np.zeros((3, 4, 6)), threads=threads)
        assert status.tolist() == [-3, 0, -3]
        assert np.isnan(q[::2]).all()
        assert np.isnan(v[::2]).all()
        np.testing.assert_array_equal(q[1], pc.Stepper(scene, fine).rollout(np.zeros((4, 6)))[0])


def test_one_state_one_torque():
    scene, state = block_scene(0.3)
    torques = random_torques((3, 5, 6), 3.0)
    q, v, status = pc.rollout(scene, state, torques[0])
    assert (q.shape, v.shape, status.shape) == ((1, 5, 7), (1, 5, 6), (1,))
    for same in (pc.rollout(scene, [state] * 3, torques[0]), pc.rollout(scene, state, [torques[0]] * 3)):
        np.testing.assert_array_equal(same[0], np.repeat(q, 3, axis=0))
    # as they lie in memory
    np.testing.assert_array_equal(pc.rollout(scene, state, np.asfortranarray(torques))[0][0], q[0])
    assert [part.shape for part in pc.rollout(scene, [], np.zeros((0, 4, 6)))] == [(0, 4, 7), (0, 4, 6), (0,)]
    assert [part.shape for part in pc.rollout(scene, state, np.zeros((2, 0, 6)))] == [(2, 0, 7), (2, 0, 6), (2,)]


def test_arguments_are_checked_before_any_step(monkeypatch):
    scene, state = block_scene(0.3)
    other = block_scene(0.3)[1]
    monkeypatch.setattr(pc.Stepper, "_make", lambda *given, **options: pytest.fail("work was begun"))
    spoilt = np.zeros((2, 3, 6))
    spoilt[1, 2, 4] = math.inf
    for error, message, given in [
        (pc.ArgumentError, "another scene", ([state, other], np.zeros((2, 3, 6)))),
        (pc.ArgumentError, "initial_state", ([state, 3], np.zeros((2, 3, 6)))),
        (pc.ArgumentError, "initial_state", (state.q, np.zeros((2, 3, 6)))),
        (pc.StateError, "2 starts, there are 3", ([state] * 3, np.zeros((2, 3, 6)))),
        (pc.StateError, r"\(B, T, 6\)", (state, np.zeros((2, 3, 5)))),
        (pc.StateError, r"\(B, T, 6\)", (state, np.zeros(6))),
        (pc.StateError, r"torques\[1, 2, 4\] is inf", (state, spoilt)),
        (pc.ArgumentError, "threads", (state, np.zeros((3, 6)), 1e-3, 1, 0)),
        (pc.ArgumentError, "substeps", (state, np.zeros((3, 6)), 1e-3, 1.5)),
        (pc.ArgumentError, "dt", (state, np.zeros((3, 6)), 0.0)),
        (pc.ArgumentError, "pd must be", (state, np.zeros((3, 6)), 1e-3, 1, 1, "auto", 3.0)),
        (
            pc.StateError,
            "target must have shape",
            (state, np.zeros((3, 6)), 1e-3, 1, 1, "auto", (0, 0, np.zeros((2, 7)))),
        ),
    ]:
        with pytest.raises(error, match=message):
            pc.rollout(scene, *given)
    with pytest.raises(pc.ArgumentError, match="Scene"):
        pc.rollout(scene.model, state, np.zeros((3, 6)))


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="about compiled steps")
def test_the_lock_is_released(monkeypatch):
    """While one thread is in compiled steps others run Python: with an interval of a minute for switching they would
    otherwise wait until it ends."""
    scene, state = block_scene(0.3)
    stepper = pc.Stepper(scene, state)
    stepper.step(np.zeros(6), 10)
    entered, seen = [], []
    run = stepper._step._run

    def noted(*given):
        entered.append(len(seen))
        return run(*given)

    monkeypatch.setattr(stepper._step, "_run", noted)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(60.0)
    try:
        with ThreadPoolExecutor(1) as pool:
            future = pool.submit(stepper.step, np.zeros(6), 5000)
            while not future.done():
                seen.append(None)
                # lets the other one have the lock
                time.sleep(1e-5)
    finally:
        sys.setswitchinterval(interval)
    # this thread went on between calls of the compiled steps, which make 256 each
    assert len(entered) >= 19
    assert len(set(entered)) > 1


def test_redundant_forces_alone_are_asked_for(monkeypatch):
    """Whether other forces would hold what begins to slip is asked where there are other ones: four corners of a block,
    not four feet of a quadruped, whose rows are independent."""
    asked = []
    hold = impulse_cones.ImpulseSolver._hold
    monkeypatch.setattr(impulse_cones.ImpulseSolver, "_hold", lambda self, p: (asked.append(p.n), hold(self, p)))
    scene = quadruped()
    state = standing(scene)
    torques = pc.inverse_dynamics(scene, state).tau + random_torques((2, 30, 1), 1.0) * TWIST
    pc.rollout(scene, state, torques, threads=1)
    assert not asked
    # in the plane of its joints there is one way to slip
    model = pin.Model()
    for joint in (pin.JointModelPX(), pin.JointModelPZ()):
        last = model.addJoint(model.njoints - 1, joint, pin.SE3.Identity(), str(joint))
        model.appendBodyToJoint(last, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    slider = pc.Scene(model)
    point, floor = slider.add_contour("point", pc.Point(), model.names[2]), slider.add_contour("floor", pc.Plane())
    slider.add_contact("c", point, floor, friction=pc.Coulomb(0.4))
    pushes = np.c_[6.0 * np.sin(0.05 * np.arange(400.0)), np.zeros(400)]
    stepper = pc.Stepper(slider, slider.initial_state([0.0, 0.0]))
    modes = [stepper.step(push).discrete[0, 0] for push in pushes]
    assert {*modes} == {STICK, SLIPPING}
    assert not asked
    block, start = block_scene(0.4)
    pc.rollout(block, start, random_torques((1, 20, 6), 20.0), threads=1)
    assert 4 in asked


def test_rows_that_cannot_be_redundant():
    """What the kernel finds independent leaves no choice among forces at their limits of friction, either."""
    redundant = from_python(may_be_redundant, STEP)
    rng, counts = np.random.default_rng(5), {True: 0, False: 0}
    for _ in range(400):
        n, nv = int(rng.integers(1, 5)), int(rng.integers(3, 14))
        step = step_workspace(nv, nv, n, 0, 0, 0, 1)
        rows = rng.normal(size=(3 * n, nv))
        if rng.random() < 0.5 and n > 1:
            # nearly, or quite, what the others are
            others = rng.normal(size=3 * n - 1) @ rows[1:]
            rows[0] = others + 10.0 ** rng.uniform(-9.0, 0.0) * rows[0] * (rng.random() < 0.8)
        rows *= 10.0 ** rng.uniform(-3.0, 3.0, (3 * n, 1))
        masks = rng.choice([1, 3, 4, 7], n)
        real = masks[:, None] >> np.arange(3) & 1 != 0
        rows[~real.ravel()] = 0.0
        step.units["mask"][:n], step.whitened[: 3 * n, :nv] = masks, rows
        step.delassus[: 9 * n * n] = (rows @ rows.T + np.diag(1.0 - real.ravel())).ravel()
        found = redundant(step, nv, n, np.zeros((3 * n, 3 * n + 1)), np.zeros(3 * n, dtype=np.int64))
        counts[found] += 1
        if not found:
            assert null_space(rows[real.ravel()]).shape[1] == 0
            slides = real.all(axis=1)
            angle, mu = rng.uniform(0.0, 7.0, n), rng.uniform(0.0, 3.0, n)
            limits = [
                rows[3 * u + 2] + mu[u] * (math.cos(angle[u]) * rows[3 * u] + math.sin(angle[u]) * rows[3 * u + 1])
                for u in range(n)
                if slides[u]
            ]
            assert not limits or null_space(np.array(limits)).shape[1] == 0
        if real.sum() > nv:
            assert found
    assert min(counts.values()) > 50
    # no room
    assert redundant(step, nv, n, np.zeros((0, 1)), np.zeros(0, dtype=np.int64))
    # a normal row that acts on nothing bears any load; friction that does bears none
    room = np.zeros((6, 7)), np.zeros(6, dtype=np.int64)
    for idle, expected in ((2, True), (1, False), (0, False)):
        step = step_workspace(6, 6, 2, 0, 0, 0, 1)
        step.units["mask"][:2] = 7
        rows = np.eye(6)
        rows[idle] = 0.0
        step.whitened[:6, :6], step.delassus[:36] = rows, (rows @ rows.T).ravel()
        assert redundant(step, 6, 2, *room) == expected


def controlled(seed):
    scene, state, _ = random_scene(seed)
    torques = np.random.default_rng(seed).normal(size=scene.model.nv)

    def control(t, q, v):
        return math.cos(3.0 * t) * torques - 0.1 * v

    return scene, state, control


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("python", [False, True])
def test_runs_in_threads(method, python):
    """With a control, which takes the lock, and without."""

    def run(seed):
        scene, state, control = controlled(seed)
        options = {"step": 2e-3} if method == "Moreau" else {"rtol": 1e-6, "atol": 1e-8}
        return pc.simulate(scene, state, 0.2, method=method, control=control if python else None, **options)

    seeds = list(range(12))
    alone = [run(seed) for seed in seeds]
    with ThreadPoolExecutor(4) as pool:
        for one, other in zip(alone, pool.map(run, seeds)):
            assert one.status == other.status
            np.testing.assert_array_equal(one.t, other.t)
            np.testing.assert_array_equal(one.q, other.q)


def test_controls_that_raise_in_threads():
    """Each thread gets its own exception."""

    def run(i):
        scene, state = bouncing()

        def control(t, q, v):
            if t > 0.01 * i:
                raise ZeroDivisionError(i)
            return np.zeros(6)

        with pytest.raises(ZeroDivisionError) as caught:
            pc.simulate(scene, state, 0.5, control=control)
        return caught.value.args[0]

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(run, range(16))) == list(range(16))


def test_motions_of_python_functions():
    """They take the lock; what they raise ends the rollout."""
    fails = math.inf

    def shaken(t):
        if t > fails:
            raise ZeroDivisionError("the drive")
        z, speed, rate = 0.01 * math.sin(20.0 * t), 0.2 * math.cos(20.0 * t), -4.0 * math.sin(20.0 * t)
        return pin.SE3(np.eye(3), np.array([0.0, 0.0, z])), [0, 0, speed, 0, 0, 0], [0, 0, rate, 0, 0, 0]

    scene = pc.Scene(block_scene(0.3)[0].model)
    ball = scene.add_contour("ball", pc.Sphere(0.1), "body")
    floor = scene.add_contour("floor", pc.Plane(), motion=pc.CallableMotion(shaken))
    scene.add_contact("c", ball, floor, friction=pc.Coulomb(0.3))
    state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1])
    same_as_loops(scene, state, random_torques((4, 10, 6), 1.0), substeps=2)
    fails = 0.005
    with pytest.raises(ZeroDivisionError, match="the drive"):
        pc.rollout(scene, state, np.zeros((8, 10, 6)), threads=2)


def test_sweeps_on_threads():
    def build(speed):
        scene, state = bouncing()
        state.v[0] = speed
        return scene, state, {"duration": 0.3, "rtol": 1e-6}

    grid = {"speed": [0.1 * i for i in range(8)]}
    alone = pc.sweep(build, grid, workers=0, progress=False)
    with ThreadPoolExecutor(3) as pool:
        threads = pc.sweep(build, grid, executor=pool, progress=False)
    assert [row["error"] for row in threads] == [""] * 8
    assert [row["q_end"] for row in threads] == [row["q_end"] for row in alone]
