"""Bodies that rock or bounce to rest while they slide: low hops are resolved, since their landings brake."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from differential import check

import pincontact as pc

G, HALF, HEIGHT, DURATION = 9.81, 0.3, 0.2, 1.0
SPEED = 3.0


def _bar(mu: float, restitution: float, inertia: float) -> pc.Scene:
    """A body in the plane y = 0 with two feet, 1 kg, above a floor."""
    model = pin.Model()
    joint = 0
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("pitch", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
    scene = pc.Scene(model)
    scene.add_contour("floor", pc.Plane())
    for name, x in (("rear", -HALF), ("front", HALF)):
        scene.add_contour(name, pc.Point(), "pitch", pin.SE3(np.eye(3), np.array([x, 0.0, -HEIGHT])))
        scene.add_contact(name, name, "floor", pc.Coulomb(mu), restitution=restitution)
    return scene


def _errors(scene: pc.Scene, tilt: float, mu: float, start: float = 0.0, **options: object) -> tuple[float, float]:
    """Errors in m of x, and in m/s of its rate, after the body has come down and slides.

    The floor's impulse is 1 kg (g t + v_z), whatever the hops; friction takes mu times that: so v_x = v_x(0) - mu (g t
    + v_z), and x is its integral.
    """
    z = HEIGHT * math.cos(tilt) + HALF * math.sin(tilt)
    state = scene.initial_state([start, z, tilt], [SPEED, 0.0, 0.0], free=["rear", "front"], max_gap=1.0)
    run = pc.simulate(scene, state, DURATION, **options)
    assert run.status == 0, run.message
    assert sum(event.kind == "touch" for event in run.events) > 2
    np.testing.assert_allclose(run.q[-1, 1:], [HEIGHT, 0.0], atol=1e-9)
    fallen = z - HEIGHT
    x = start + SPEED * DURATION - mu * (0.5 * G * DURATION**2 - fallen)
    return abs(run.q[-1, 0] - x), abs(run.v[-1, 0] - SPEED + mu * G * DURATION)


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Sharp98"])
@pytest.mark.parametrize("restitution", [0.0, 0.3])
@pytest.mark.parametrize("mu", [0.1, 0.28])
def test_sliding_body_rocks_to_rest(method, restitution, mu):
    """A heavy bar thrown from foot to foot: each landing throws the other foot up, lower by a factor, without end."""
    scene = _bar(mu, restitution, inertia=0.3)
    # hops below 1e-8 m are left out by impulses that brake; 2e-5 m and m/s, and more, if these did not
    position, velocity = _errors(scene, 0.01, mu, method=method, rtol=1e-8, atol=1e-8)
    assert position < 1e-9
    assert velocity < 1e-9


def test_far_from_the_origin():
    """Gaps are known to the round-off of coordinates of 1e4 m there, and the body comes to rest all the same."""
    position, velocity = _errors(_bar(0.28, 0.0, 0.3), 0.01, 0.28, start=1e4, rtol=1e-8, atol=1e-8)
    # of hops as high as 1e-10 m, and the tolerance relative to x
    assert position < 1e-4
    assert velocity < 2e-5


def _flapping(rng: np.random.Generator, mu: float) -> tuple[pc.Scene, np.ndarray]:
    """A sliding body in the plane y = 0 on two feet, with arms that fall onto their stops and throw each other, and the
    feet, up; and its configuration."""
    model, joint = pin.Model(), 0
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("pitch", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    inertia = rng.uniform(0.02, 0.05) * np.eye(3)
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia), pin.SE3.Identity())
    raised, low, high = [], np.full(5, -100.0), np.full(5, 100.0)
    for side in (-1, 1):
        hinge = pin.SE3(np.eye(3), np.array([0.1 * side, 0.0, 0.1]))
        arm = model.addJoint(joint, pin.JointModelRY(), hinge, f"arm {side}")
        place = np.array([side * rng.uniform(0.1, 0.2), 0.0, 0.0])
        model.appendBodyToJoint(arm, pin.Inertia(rng.uniform(0.1, 0.3), place, 2e-3 * np.eye(3)), pin.SE3.Identity())
        low[arm - 1], high[arm - 1] = sorted((0.0, -float(side)))
        raised.append(-side * rng.uniform(0.005, 0.02))
    model.lowerPositionLimit, model.upperPositionLimit = low, high
    scene = pc.Scene(model)
    scene.add_contour("floor", pc.Plane())
    for name, x in (("rear", -HALF), ("front", HALF)):
        scene.add_contour(name, pc.Point(), "pitch", pin.SE3(np.eye(3), np.array([x, 0.0, -HEIGHT])))
        scene.add_contact(name, name, "floor", pc.Coulomb(mu))
    return scene, np.array([0.0, HEIGHT, 0.0, *raised])


@pytest.mark.parametrize("seed", range(12))
def test_hops_of_joints_that_are_left_out_brake(seed):
    """Joints that hop on their stops beside feet that slide, the lowest of them left out: the floor's impulse is that
    of all masses, whatever hops, and so is friction's."""
    rng = np.random.default_rng(seed)
    mu = rng.uniform(0.05, 0.2)
    scene, q = _flapping(rng, mu)
    run = pc.simulate(scene, scene.initial_state(q, [SPEED, 0.0, 0.0, 0.0, 0.0]), DURATION)
    assert run.status == 0, run.message
    # both arms come to their stops, and somebody is thrown up
    assert sum(event.kind == "limit" for event in run.events) > 1
    assert any(event.kind in ("release", "separate") for event in run.events)
    np.testing.assert_allclose(run.q[-1, 1:], [HEIGHT, 0.0, 0.0, 0.0], atol=1e-9)
    data = scene.model.createData()
    start, end = (np.array(pin.centerOfMass(scene.model, data, at)) for at in (q, run.q[-1]))
    way = SPEED * DURATION - mu * (0.5 * G * DURATION**2 + end[2] - start[2])
    # the tolerance of some ten steps; 1e-6 to 1e-4 m where what leaves hops out does not brake
    assert abs(end[0] - start[0] - way) < 1e-8
    assert abs(run.v[-1, 0] - SPEED + mu * G * DURATION) < 1e-8


def _tripod(rng: np.random.Generator, friction: pc.Friction) -> tuple[pc.Scene, pc.State]:
    """A body of 1 kg on three feet, dropped from 5 cm, tilted and turning."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag(rng.uniform(0.005, 0.012, 3)))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    scene = pc.Scene(model)
    scene.add_contour("floor", pc.Plane())
    height, names = rng.uniform(0.05, 0.12), ["foot 0", "foot 1", "foot 2"]
    for i, name in enumerate(names):
        angle, reach = 2.0 * math.pi * i / 3.0, rng.uniform(0.08, 0.15)
        place = pin.SE3(np.eye(3), np.array([reach * math.cos(angle), reach * math.sin(angle), -height]))
        scene.add_contour(name, pc.Point(), "body", place)
        scene.add_contact(name, name, "floor", friction)
    tilt = pin.exp3(np.append(0.05 * rng.normal(size=3)[:2], 0.0))
    q = np.array([0.0, 0.0, height + 0.05, *pin.Quaternion(tilt).coeffs()])
    v = np.array([*0.1 * rng.normal(size=2), 0.0, *0.2 * rng.normal(size=3)])
    return scene, scene.initial_state(q, v, free=names, max_gap=1.0)


@pytest.mark.parametrize(
    ("friction", "seed"), [(pc.Coulomb(0.3), seed) for seed in (104, 106, 110, 114, 117)] + [(pc.NoSlip(), 122)]
)
def test_short_slips_among_hops(friction, seed):
    """A body that rocks to rest on three feet: slips that end within the accuracy of positions are not cut short.

    At the speed v of a slip that ends in v^2 / (2 a) the other feet's loads are others than in stick, so that what is
    cut changes their hops by the order v, the root of the accuracy.
    """
    scene, state = _tripod(np.random.default_rng(seed), friction)
    default = pc.simulate(scene, state, 0.8, method="DOP853")
    tight = pc.simulate(scene, state, 0.8, method="DOP853", rtol=1e-11, atol=1e-13, max_step=0.01)
    assert default.status == tight.status == 0, (default.message, tight.message)
    apart = pin.difference(scene.model, default.q[-1], tight.q[-1])
    # ten times the tolerance; some were 1e-6 m or ended in chatter when slips that end within 1e-8 m were cut
    np.testing.assert_allclose(apart, 0.0, atol=1e-7)


def test_a_joint_that_has_just_left_its_end():
    """It hops lower than positions are known; it is not at its end in the impact of another (5.7e-3 off)."""
    finding = check(91168)
    assert not finding.wrong and set(finding.statuses.values()) == {0}, finding


def _pressed_arm(rng: np.random.Generator) -> tuple[pc.Scene, pc.State, np.ndarray]:
    """Four links with stops whose tip slides in a slot, with torques that press them onto the stops."""
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    for name, size in zip("abcd", rng.uniform(0.15, 0.4, 4)):
        mass = rng.uniform(0.3, 2.0)
        parent = model.addJoint(parent, pin.JointModelRZ(), place, name)
        body = pin.Inertia(mass, np.array([0.5 * size, 0.0, 0.0]), 0.08 * mass * size**2 * np.eye(3))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([size, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, place, pin.FrameType.OP_FRAME))
    q = rng.uniform(-1.0, 1.0, 4)
    model.lowerPositionLimit = q - rng.uniform(0.0, 0.05, 4)
    model.upperPositionLimit = q + rng.uniform(0.02, 0.05, 4)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    tip = data.oMf[model.getFrameId("tip")].translation
    scene = pc.Scene(model)
    scene.add_contour("tip", pc.Point(), "tip")
    turned = pin.utils.rotate("z", rng.uniform(0.0, 6.0))
    scene.add_contour("slot", pc.Line(), placement=pin.SE3(turned, tip))
    scene.add_contact("tip", "tip", "slot", pc.Coulomb(rng.uniform(0.1, 0.5)), bilateral=True, pattern="P-2C")
    tau = 5.0 * rng.normal(size=4)
    return scene, scene.initial_state(q, 2.0 * rng.normal(size=4), max_gap=0.3), tau


@pytest.mark.parametrize("seed", [4, 9, 36, 44])
def test_joints_that_rattle_beside_a_bilateral_contact(seed):
    """Hops of joints on their stops have impulses in the slot, and these friction, on whichever side they are."""
    scene, state, tau = _pressed_arm(np.random.default_rng(seed))
    times = np.linspace(0.0, 0.3, 16)
    options = {"t_eval": times, "control": lambda t, q, v: tau}
    run = pc.simulate(scene, state, 0.3, **options)
    tight = pc.simulate(scene, state, 0.3, rtol=1e-11, atol=1e-13, **options)
    assert run.status == tight.status == 0, (run.message, tight.message)
    assert len(run.events) < 200
    # 1e-7 and less; hops that are left out leave 3e-6 and more
    np.testing.assert_allclose(run.q, tight.q, atol=5e-7)
