"""Linearised motion against the flow of runs: how deviations grow, for all laws, stops and drives."""

import math

import numpy as np
import pinocchio as pin
import pytest
from random_scenes import resting_chain
from scipy.linalg import expm
from shared import one_body

import pincontact as pc
from pincontact.analysis.instant import Instant
from pincontact.analysis.symmetry import find_symmetries

LAWS = {
    "coulomb": pc.Coulomb(0.3),
    "stribeck": pc.Stribeck(0.2, 0.4, 0.3),
    "two directions": pc.Coulomb((0.2, 0.4), along="floor"),
    "viscous": pc.Coulomb(0.3, viscous=0.3),
    "viscous alone": pc.Coulomb(0.0, viscous=0.5),
    "spinning resistance": pc.Coulomb(0.3, spinning=0.01),
    "ideal rolling": pc.NoSlip(),
    "rolling resistance": pc.NoSlip(rolling=0.01),
    "frictionless": None,
}
# Deviations: their square is what central differences leave out, 1e-12 / STEP what runs do.
STEP = 3e-5


def steady_torques(scene, state, tau):
    """The torques nearest to tau without accelerations in the modes that the state has."""
    instant = Instant(scene, state, tau)
    a = instant.evaluate()
    gains = np.column_stack([instant.evaluate(tau=tau + unit) - a for unit in np.eye(a.size)])
    return tau - np.linalg.lstsq(gains, a, rcond=1e-10)[0]


def check_flow(scene, state, tau, duration=0.2, step=STEP):
    """expm(A T) is what runs make of small deviations, seen from axes that go along with the symmetry followed."""
    found = pc.linearize(scene, state, tau)
    assert found.error < 1e-8
    instant = Instant(scene, state, tau)
    symmetries = find_symmetries(instant)
    combination, _ = symmetries.fit(state.q, state.v, instant.evaluate())
    along = expm(duration * symmetries.brackets(symmetries.right @ combination + symmetries.twist))

    def end(dq, dv):
        start = scene.initial_state(pin.integrate(scene.model, state.q, dq), state.v + dv)
        run = pc.simulate(scene, start, duration, rtol=1e-12, atol=1e-13, control=lambda t, q, v: tau)
        assert run.status == 0, run.message
        assert not run.events
        return run.q[-1], run.v[-1]

    rest = np.zeros(scene.model.nv)
    q_end, v_end = end(rest, rest)
    np.testing.assert_allclose(along @ v_end, state.v, rtol=0.0, atol=1e-9)
    flow = expm(found.A * duration)
    # differences of third order, in a motion whose deviations grow that much
    tolerance = 1e-7 * max(1.0, np.abs(flow).max()) ** 2
    # a map that is wrong in any entry is wrong in almost any direction
    count = found.A.shape[0]
    for x in np.linalg.qr(np.random.default_rng(count).normal(size=(count, 3)))[0].T:
        (q1, v1), (q2, v2) = (end(s * step * found.dq_dx @ x, s * step * found.dv_dx @ x) for s in (1.0, -1.0))
        apart = pin.difference(scene.model, q_end, q1) - pin.difference(scene.model, q_end, q2)
        dq, dv = along @ apart / (2.0 * step), along @ (v1 - v2) / (2.0 * step)
        np.testing.assert_allclose(dq, found.dq_dx @ flow @ x, rtol=0.0, atol=tolerance)
        np.testing.assert_allclose(dv, found.dv_dx @ flow @ x, rtol=0.0, atol=tolerance)
    return found


def block(law, feet):
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([0.01, 0.02, 0.025]))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia, "block", joint="joint"))
    floor = scene.add_contour("floor", pc.Plane())
    for i, (x, y) in enumerate(feet):
        foot = scene.add_contour(f"foot {i}", pc.Point(), "block", pin.SE3(np.eye(3), np.array([x, y, -0.1])))
        scene.add_contact(f"c{i}", foot, floor, friction=law)
    return scene


FEET = [(0.2, 0.1), (0.2, -0.1), (-0.2, 0.03)]
LEVEL = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("law", "turning"),
    # a plane that has directions lets no circle be steady
    [(law, turning) for law in list(LAWS)[:6] for turning in (0.0, 0.7) if not (law == "two directions" and turning)],
)
def test_block_drawn_over_a_plane(law, turning):
    """Straight on and in a circle, by forces fixed in the body, with its load on one side."""
    scene = block(LAWS[law], FEET)
    state = scene.initial_state(LEVEL, [0.5, 0.2, 0.0, 0.0, 0.0, turning])
    found = check_flow(scene, state, steady_torques(scene, state, np.array([0.0, 0.0, 0.0, 0.1, 0.3, 0.0])))
    # speed, direction of the slip, turning: places and heading are all that is symmetric; spinning resistance holds
    at_rest = law == "spinning resistance" and not turning
    heading_matters = law == "two directions"
    assert found.without_symmetries().A.shape[0] == (2 if at_rest else 4 if heading_matters else 3)


@pytest.mark.parametrize("feet", [1, 4])
@pytest.mark.parametrize("law", ["coulomb", "stribeck"])
def test_slip_of_fewer_and_more_feet(law, feet):
    """A ball that turns on the spot it slides on, and loads that are indeterminate."""
    if feet == 4:
        scene = block(LAWS[law], [(0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1)])
    else:
        scene = ball(LAWS[law])
    state = scene.initial_state(LEVEL, [0.5, 0.1, 0.0, 0.0, 0.0, 0.8])
    check_flow(scene, state, steady_torques(scene, state, np.zeros(6)))


@pytest.mark.parametrize("speed", [1e-2, 1e-4])
@pytest.mark.parametrize("law", ["coulomb", "stribeck"])
def test_slow_slip(law, speed):
    """Friction turns within the slip's own size, however small that is."""
    scene = block(LAWS[law], FEET)
    state = scene.initial_state(LEVEL, speed * np.array([1.0, 0.3, 0.0, 0.0, 0.0, 0.2]))
    tau = steady_torques(scene, state, np.zeros(6))
    found = pc.linearize(scene, state, tau)
    assert found.error < 1e-8 * np.abs(found.A).max()
    # relative to mu g / speed
    rate = -found.without_symmetries().eigenvalues.real.min()
    assert 0.1 < rate * speed / 3.0 < 10.0


# ---------------------------------------------------------------------------------------------------- drives


def ball(law, motion=None):
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.004 * np.eye(3)), "ball", joint="joint")
    scene = pc.Scene(model)
    sphere = scene.add_contour("ball", pc.Sphere(0.1), "ball")
    scene.add_contact("c", sphere, scene.add_contour("floor", pc.Plane(), motion=motion), friction=law)
    return scene


@pytest.mark.parametrize("law", list(LAWS))
def test_ball_on_a_belt_and_on_a_turntable(law):
    """It slides on the spot on the one, under a force, and rolls or turns on the other's centre."""
    if law not in ("ideal rolling", "rolling resistance"):
        scene = ball(LAWS[law], pc.ConstantTwist(linear=(0.6, -0.2, 0.0)))
        state = scene.initial_state(LEVEL)
        check_flow(scene, state, steady_torques(scene, state, np.zeros(6)))
    scene = ball(LAWS[law], pc.ConstantTwist(angular=(0.0, 0.0, 1.1)))
    spin = 1.1 if "resistance" in law or law == "two directions" else -0.7
    state = scene.initial_state(LEVEL, [0.0, 0.0, 0.0, 0.0, 0.0, spin])
    check_flow(scene, state, steady_torques(scene, state, np.zeros(6)))


def wheel(rng, law, motion):
    """A wheel held upright, with friction of its axle."""
    model = pin.Model()
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    z = model.addJoint(x, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    spin = model.addJoint(z, pin.JointModelRY(), pin.SE3.Identity(), "spin")
    for joint in (z, spin):
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([0.02, 0.03, 0.02])), pin.SE3.Identity())
    model.addBodyFrame("wheel", spin, pin.SE3.Identity(), 0)
    model.damping = np.array([rng.choice([0.0, 0.3]), 0.0, rng.choice([0.0, 0.05])])
    dry = rng.choice([0.0, 0.1])
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = np.array([0, 0, -dry]), np.array([0, 0, 2 * dry])
    scene = pc.Scene(model)
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    rim = scene.add_contour("rim", pc.Circle(0.2), "wheel", upright)
    scene.add_contact("c", rim, scene.add_contour("floor", pc.Plane(), motion=motion), friction=law)
    return scene


@pytest.mark.parametrize("law", list(LAWS))
def test_wheel_that_rolls_or_spins(law):
    rng = np.random.default_rng(len(law))
    for motion in (None, pc.ConstantTwist(linear=(0.4, 0.0, 0.0))):
        scene = wheel(rng, LAWS[law], motion)
        state = scene.initial_state([0.0, 0.2, 0.3], [rng.uniform(-0.5, 0.5), 0.0, rng.choice([-1, 1]) * 4.0])
        check_flow(scene, state, steady_torques(scene, state, np.zeros(3)))


# ---------------------------------------------------------------------------------------------------- joints


@pytest.mark.parametrize("seed", range(5))
def test_dry_friction_and_stops(seed):
    scene, q, v, tau = resting_chain(seed)
    found = check_flow(scene, scene.initial_state(q, v), tau)
    model = scene.model
    held = (v == 0.0) & (model.lowerDryFrictionLimit < 0.0)
    stopped = (q == model.lowerPositionLimit) | (q == model.upperPositionLimit)
    assert found.positions == model.nv - stopped.sum()
    assert found.A.shape[0] == found.positions + model.nv - (held | stopped).sum()


def test_slider_held_by_dry_friction():
    """It stays wherever it is put; beyond its friction it begins to move, and then nothing but that is linear."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = np.array([-2.0]), np.array([2.0])
    scene = pc.Scene(model)
    rest = scene.initial_state([0.0])
    np.testing.assert_array_equal(pc.linearize(scene, rest, [1.5]).A, [[0.0]])
    with pytest.raises(pc.StateError, match="joint 'slider' begins to slip"):
        pc.linearize(scene, rest, [2.5])
    with pytest.raises(pc.StateError, match="joint 'slider' rests with its friction just at the limit"):
        pc.linearize(scene, rest, [2.0])
    moving = pc.linearize(scene, scene.initial_state([0.0], [0.3]), [2.0])
    np.testing.assert_allclose(moving.A, [[0.0, 1.0], [0.0, 0.0]], rtol=0.0, atol=1e-12)


def test_friction_just_at_its_limit():
    """A ball turned with all that rolling resistance holds."""
    scene = ball(pc.Coulomb(0.3, rolling=0.02))
    rest = scene.initial_state(LEVEL)
    limit = 0.02 * scene.model.gravity.linear[2]
    with pytest.raises(pc.StateError, match="contact 'c' rests with its friction just at the limit"):
        pc.linearize(scene, rest, [0.0, 0.0, 0.0, limit, 0.0, 0.0])
    assert pc.linearize(scene, rest, [0.0, 0.0, 0.0, 0.99 * limit, 0.0, 0.0]).A.shape == (6, 6)
