"""Implicit PD actuators: against linear solutions, with gains far too stiff for the step, and in contact."""

import gc
import math
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import expm
from test_moreau import G, block_scene, body_scene, double_pendulum, joint_scene, slide_scene

import pincontact as pc
from pincontact.integration.actuators import fitted_weight

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

from quadruped import FOOT, SHANK, quadruped, standing, weight

NONE = math.inf


def mass_on_a_rail(kp, kd, target, dt, q=0.0, v=0.0, mass=1.0, **options):
    scene = joint_scene(lower=-NONE, upper=NONE, mass=mass, **options)
    stepper = pc.Stepper(scene, scene.initial_state([q], [v]), dt)
    stepper.pd(kp, kd, [target])
    return stepper


def exact(kp, kd, target, t, q, v, mass=1.0):
    """(q, v) of the linear oscillator."""
    rest = target - mass * G / kp
    flow = expm(np.array([[0.0, 1.0], [-kp / mass, -kd / mass]]) * t)
    return flow @ [q - rest, v] + [rest, 0.0]


@pytest.mark.parametrize("kd", [0.0, 4.0, 40.0, 120.0], ids=["undamped", "underdamped", "critical", "overdamped"])
def test_second_order(kd):
    kp, target, q, v, t = 400.0, 0.4, 0.1, -1.0, 0.25
    errors = []
    for steps in (125, 250, 500):
        stepper = mass_on_a_rail(kp, kd, target, t / steps, q, v)
        stepper.step([0.0], steps)
        errors.append(np.abs(np.r_[stepper.q, stepper.v / 20.0] - exact(kp, kd, target, t, q, v) / [1.0, 20.0]).max())
    # asymptotic at these steps: 20 rad/s and up to 0.004 s
    assert 1.85 < math.log2(errors[0] / errors[1]) < 2.3
    assert 1.85 < math.log2(errors[1] / errors[2]) < 2.3
    assert errors[2] < 2e-4


def linear_step(kp, kd, dt, mass=1.0):
    """The matrix of one step of (q, v) about the target, without gravity."""
    columns = []
    for start in np.eye(2):
        stepper = mass_on_a_rail(kp, kd, mass * G / kp, dt, *start, mass=mass)
        stepper.step([0.0])
        columns.append(np.r_[stepper.q, stepper.v])
    return np.array(columns).T


@pytest.mark.parametrize("z", [1e-3, 0.05, 0.1, 0.3, 2.0, 30.0])
def test_critical_damping_decays_exactly(z):
    """The double eigenvalue of a step is exp(-z), z = dt kd / (2 m): its characteristic polynomial is that."""
    dt, mass = 1e-3, 2.0
    kd = 2.0 * mass * z / dt
    step = linear_step(kd * kd / (4.0 * mass), kd, dt, mass)
    # round-off of a matrix whose off-diagonal entries are z / dt and dt
    assert np.trace(step) == pytest.approx(2.0 * math.exp(-z), rel=1e-9, abs=1e-11 * (1.0 + z))
    assert np.linalg.det(step) == pytest.approx(math.exp(-2.0 * z), rel=1e-9, abs=1e-11 * (1.0 + z))


def test_weights_join():
    """Series and formula, and their limits."""
    for z in (0.0999999, 0.1, 0.1000001):
        assert fitted_weight(z) == pytest.approx(1.0 / (1.0 - math.exp(-z)) - 1.0 / z, abs=1e-12)
    assert fitted_weight(0.0) == 0.5
    assert fitted_weight(1e9) == pytest.approx(1.0, abs=2e-9)


@pytest.mark.parametrize("stiff", [1.0, 1e2, 1e6, 1e10])
@pytest.mark.parametrize("ratio", [0.0, 0.01, 0.3, 1.0, 30.0])
def test_no_gains_make_a_step_unstable(stiff, ratio):
    """kp dt^2 = stiff; kd relative to critical damping."""
    dt = 1e-3
    kp = stiff / dt**2
    step = linear_step(kp, ratio * 2.0 * math.sqrt(kp), dt)
    scaled = step * [[1.0, 1.0 / dt], [dt, 1.0]]
    # without damping on the unit circle, a double eigenvalue in the limit: to the root of round-off of large gains
    assert np.abs(np.linalg.eigvals(scaled)).max() <= 1.0 + (1e-7 if ratio == 0.0 else 1e-9)


def test_explicit_gains_would():
    dt, kp = 1e-3, 1e8
    stepper = mass_on_a_rail(kp, 2e4, 0.5, dt)
    scene = stepper.scene
    explicit = pc.Stepper(scene, scene.initial_state([0.0]), dt)
    with np.errstate(all="ignore"):
        for _ in range(50):
            stepper.step([0.0])
            explicit.step(kp * (0.5 - explicit.q) - 2e4 * explicit.v)
    assert abs(explicit.q[0]) > 1e6
    # after 50 steps of a weight of 0.9: the rest under gravity
    assert stepper.q[0] == pytest.approx(0.5 - G / kp, abs=1e-9)


def test_coupled_joints_hold_still():
    """A double pendulum under gains a million times too stiff for explicit steps; targets that jump each 50 steps."""
    scene = double_pendulum()
    stepper = pc.Stepper(scene, scene.initial_state([0.0, 0.5]), 1e-3)
    stepper.pd([1e12, 1e7], [1e7, 1e4], [0.0, 0.5])
    rng = np.random.default_rng(2)
    for _ in range(10):
        stepper.target[:] = stepper.q + rng.uniform(-0.02, 0.02, 2)
        stepper.step([0.0, 0.0], 50)
        np.testing.assert_allclose(stepper.q, stepper.target, atol=1e-5)
        assert np.abs(stepper.v).max() < 1e-2


def test_rest_and_torque():
    """The spring carries the weight, and says so."""
    stepper = mass_on_a_rail(500.0, 60.0, 0.2, 1e-3, mass=3.0)
    stepper.step([0.0], 3000)
    assert stepper.q[0] == pytest.approx(0.2 - 3.0 * G / 500.0, abs=1e-12)
    assert stepper.actuation[0] == pytest.approx(3.0 * G, rel=1e-10)
    with pytest.raises(ValueError, match="read-only"):
        stepper.actuation[0] = 1.0


def test_momentum_and_contact():
    """A mass on a floor, pulled sideways and pressed down by stiff actuators: over every step the forces that are
    reported change the momentum, the closed contact ends at rest along its normal, and friction is Coulomb's."""
    mass, mu, dt = 1.5, 0.3, 1e-3
    scene = slide_scene(mu, mass)
    stepper = pc.Stepper(scene, scene.initial_state([0.0, 0.0, 0.0], [0.4, -0.2, 0.0]), dt)
    stepper.pd([3e6, 2e5, 1e7], [2e3, 1e2, 5e3], [0.01, 0.02, -1e-5])
    force, modes = stepper.forces["c"], set()
    for i in range(400):
        if i == 200:
            stepper.target[:2] = 0.011, 0.02
        before = stepper.v.copy()
        stepper.step([0.0, 0.0, 0.0])
        contact = -force
        gained = mass * (stepper.v - before) / dt
        total = contact + stepper.actuation - [0.0, 0.0, mass * G]
        np.testing.assert_allclose(gained, total, atol=1e-9 * np.abs(stepper.actuation).max())
        assert abs(stepper.q[2]) < 1e-12
        assert abs(stepper.v[2]) < 1e-10
        pressure, friction = contact[2], np.hypot(*contact[:2])
        assert pressure == pytest.approx(mass * G + 100.0, rel=1e-9)
        assert friction <= mu * pressure * (1.0 + 1e-9)
        modes.add(int(stepper.modes[0]))
        if stepper.modes[0] == 2:
            # opposed along the mean of slip, or where it turns back within the step along that at its end
            assert friction == pytest.approx(mu * pressure, rel=1e-9)
            ends = [before[:2] + stepper.v[:2], stepper.v[:2]]
            assert min(contact[:2] @ slip / (friction * np.hypot(*slip)) for slip in ends) < -1.0 + 1e-9
        else:
            assert np.abs(stepper.v[:2]).max() < 1e-12
    assert modes == {1, 2}


def test_friction_against_a_spring():
    """The linear oscillator with Coulomb friction: it stops where the exact motion does, with second order before."""
    kp, kd, mu, target, q, v = 400.0, 2.0, 0.3, 0.0, 0.2, 0.0
    # slides towards the target until it turns: friction is a constant force
    at, t = exact(kp, kd, target + (mu * G + G) / kp, 0.1, q, v), 0.1
    errors = []
    for steps in (50, 100, 200):
        scene = slide_scene(mu)
        stepper = pc.Stepper(scene, scene.initial_state([q, 0.0, 0.0]), t / steps)
        stepper.pd([kp, 0.0, 0.0], [kd, 0.0, 0.0], [target, 0.0, 0.0])
        stepper.step(np.zeros(3), steps)
        errors.append(abs(stepper.q[0] - at[0]))
    assert errors[0] > 3.5 * errors[1] > 12.0 * errors[2]
    # 4 mu m g / kp less in each of seven periods
    stepper.step(np.zeros(3), 5000)
    assert stepper.modes[0] == 1
    assert abs(kp * stepper.q[0]) < mu * G


def test_quadruped_stands():
    """On joint gains 1000 times those which explicit steps take; its feet carry the weight."""
    scene = quadruped()
    state = standing(scene)
    stepper = pc.Stepper(scene, state, 1e-3)
    stepper.pd(1e5, 1e2, state.q)
    stepper.step(np.zeros(18), 500)
    assert np.abs(stepper.q[7:] - state.q[7:]).max() < 1e-3
    assert abs(stepper.v).max() < 1e-6
    assert sum(force[2] for force in stepper.forces.values()) == pytest.approx(-weight(scene), rel=1e-6)
    # actuators, weights and the forces of the feet are in balance at every joint
    model, data = scene.model, scene.model.createData()
    left = stepper.actuation - pin.computeGeneralizedGravity(model, data, stepper.q)
    pin.computeJointJacobians(model, data, stepper.q)
    for name, on_floor in stepper.forces.items():
        knee = model.getJointId(f"{name}_knee")
        centre = data.oMi[knee].act(np.array([0.0, 0.0, -SHANK])) - [0.0, 0.0, FOOT] - data.oMi[knee].translation
        jacobian = pin.getJointJacobian(model, data, knee, pin.LOCAL_WORLD_ALIGNED)
        left -= jacobian[:3].T @ on_floor + jacobian[3:].T @ np.cross(centre, on_floor)
    np.testing.assert_allclose(left, 0.0, atol=1e-5)
    assert not stepper.actuation[:6].any()
    assert np.abs(stepper.actuation).max() > 0.5


def test_unbounded_rotations_turn_the_shorter_way():
    scene = body_scene(pin.JointModelRUBZ(), 1.0)
    start, target = 3.0, -3.0
    stepper = pc.Stepper(scene, scene.initial_state([math.cos(start), math.sin(start)]), 1e-3)
    stepper.pd(100.0, 20.0, [math.cos(target), math.sin(target)])
    stepper.step([0.0])
    assert stepper.v[0] > 0.0
    # as a joint whose angle is a number, where the target is not on the other side of the seam
    plain = body_scene(pin.JointModelRZ(), 1.0)
    other = pc.Stepper(plain, plain.initial_state([start]), 1e-3)
    other.pd(100.0, 20.0, [target + 2.0 * math.pi])
    other.step([0.0])
    stepper.step([0.0], 700)
    other.step([0.0], 700)
    angle = math.atan2(stepper.q[1], stepper.q[0]) + 2.0 * math.pi
    assert angle == pytest.approx(other.q[0], abs=1e-12)


def test_damping_alone_follows_a_velocity():
    """Also of joints whose configuration is no vector: a ball whose turning is driven."""
    scene = body_scene(pin.JointModelSpherical(), 1.0, (0.3, 0.3, 0.3))
    stepper = pc.Stepper(scene, scene.initial_state([0, 0, 0, 1], [0.0, 0.0, 0.0]), 1e-3)
    stepper.pd(0.0, [0.0, 0.0, 60.0], [0, 0, 0, 1])
    stepper.step([0.0, 0.0, 60.0 * 2.0], 1000)
    np.testing.assert_allclose(stepper.v, [0.0, 0.0, 2.0], atol=1e-12)


def test_copies_and_resets():
    """Copies have the actuators, a reset leaves them; without gains there are none."""
    scene, kp = double_pendulum(), [1e3, 2e3]
    state = scene.initial_state([0.3, 0.5])
    stepper, without = pc.Stepper(scene, state), pc.Stepper(scene, state)
    stepper.pd(kp, 3.0, [0.1, 0.2])
    first = stepper.step([0.0, 0.0], 50).q.copy()
    twin = stepper.copy()
    np.testing.assert_array_equal(twin.step([0.1, 0.0], 20).q, stepper.step([0.1, 0.0], 20).q)
    np.testing.assert_array_equal(twin.actuation, stepper.actuation)
    stepper.reset(state)
    np.testing.assert_array_equal(stepper.step([0.0, 0.0], 50).q, first)
    stepper.reset(state)
    stepper.pd(0.0, 0.0, [0.1, 0.2])
    np.testing.assert_array_equal(stepper.step([0.0, 0.0], 50).q, without.step([0.0, 0.0], 50).q)
    assert not stepper.actuation.any()


def test_rollouts_with_actuators():
    """One target, one for each row, one for each row of each start."""
    scene = quadruped()
    state = standing(scene)
    rng = np.random.default_rng(1)
    torques = 0.1 * rng.normal(size=(3, 20, 18))
    rows = np.tile(state.q, (3, 20, 1))
    rows[..., 7:] += 0.1 * rng.normal(size=(3, 20, 12))
    for target in (state.q, rows[0], rows):
        q, v, status = pc.rollout(scene, state, torques, 1e-3, 4, pd=(300.0, 3.0, target), threads=2)
        assert not status.any()
        for i in range(3):
            stepper = pc.Stepper(scene, state, 1e-3)
            stepper.pd(300.0, 3.0, state.q)
            targets = np.broadcast_to(target, rows.shape)[i]
            for k in range(20):
                stepper.target[:] = targets[k]
                stepper.step(torques[i, k], 4)
                np.testing.assert_array_equal(stepper.q, q[i, k])
                np.testing.assert_array_equal(stepper.v, v[i, k])


def test_targets_change_without_allocation():
    scene, state = block_scene(0.5)
    stepper = pc.Stepper(scene, state)
    stepper.pd(0.0, [0, 0, 0, 1.0, 1.0, 1.0], state.q)
    tau, targets = np.zeros(6), [state.q.copy(), state.q + 0.1]
    target = stepper.target

    def go(count):
        for i in range(count):
            target[:] = targets[i % 2]
            stepper.step(tau)

    go(100)
    gc.collect()
    tracemalloc.start()
    try:
        go(300)
        before, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        go(1000)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # as in test_stepper: objects of Python's own, no array
    assert after - before <= 1000
    assert peak - before <= 16_000


def test_arguments_are_checked():
    scene = quadruped()
    state = standing(scene)
    stepper = pc.Stepper(scene, state)
    good = np.r_[np.zeros(6), np.ones(12)]
    for kp, kd, message in [
        (-1.0, 0.0, "kp must be finite and at least 0, got -1"),
        (1.0, math.nan, "kd must be finite"),
        (1.0, math.inf, "kd must be finite"),
        (good[1:], 0.0, r"kp must be a number or have shape \(18,\), got shape \(17,\)"),
        (1.0, "3", "kd must be a number or 18 numbers"),
        (1.0, True, "kd must be a number or 18 numbers"),
        (np.where(np.arange(18) == 7, -2.0, good), 0.0, r"kp\[7\] must be finite and at least 0, got -2"),
        (np.ones(18), 1.0, r"kp\[0\] is 1.0: the configuration of joint 'root_joint' is no vector"),
    ]:
        with pytest.raises(pc.ArgumentError, match=message):
            stepper.pd(kp, kd, state.q)
    spoilt = state.q.copy()
    spoilt[9] = math.nan
    for target, message in [(state.q[1:], "target must have 19 entries"), (spoilt, r"target\[9\] is nan")]:
        with pytest.raises(pc.StateError, match=message):
            stepper.pd(1.0, 1.0, target)
    # nothing was changed by these
    assert stepper.step(np.zeros(18)).t == stepper.dt
    assert not stepper.actuation.any()
    stepper.pd(10.0, 1.0, state.q)
    stepper.target[8] = math.nan
    with pytest.raises(pc.StateError, match=r"target\[8\] is nan"):
        stepper.step(np.zeros(18))
    with pytest.raises(pc.StateError, match=r"target\[8\] is nan"):
        stepper.rollout(np.zeros((2, 18)))
    with pytest.raises(pc.StateError, match=r"target\[1, 3\] is nan"):
        pc.rollout(
            scene, state, np.zeros((2, 18)), pd=(1.0, 1.0, np.where(np.arange(38).reshape(2, 19) == 22, math.nan, 0.0))
        )
