"""A leg that dry friction of its joints holds slides like a rigid body, in outputs, too: with joints that are free its
foot may have no force, or two (Painleve)."""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

MU, GRAVITY, DURATION = 0.8, 9.81, 0.01


def trolley(seed, legs):
    """A body that moves without turning, on legs of two joints each in its plane, which are held. Returns scene and
    start, in which the body slides."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    base = model.addJoint(base, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(base, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    for leg in range(legs):
        parent, place = base, pin.SE3(np.eye(3), np.array([0.4 * leg, 0.0, 0.0]))
        for name in ("hip", "knee"):
            length = rng.uniform(0.1, 0.3)
            parent = model.addJoint(parent, pin.JointModelRY(), place, f"{name} {leg}")
            lever = np.array([0.0, 0.0, -0.5 * length])
            inertia = pin.Inertia(rng.uniform(0.05, 0.5), lever, 0.002 * length * np.eye(3))
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            place = pin.SE3(np.eye(3), 2.0 * lever)
        model.addFrame(pin.Frame(f"foot {leg}", parent, 0, place, pin.FrameType.OP_FRAME))
    bound = np.append([0.0, 0.0], np.full(2 * legs, 50.0))
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = -bound, bound
    q = np.append([0.0, 0.0], rng.uniform(-1.2, 1.2, 2 * legs))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    scene = pc.Scene(model)
    for leg in range(legs):
        name = f"foot {leg}"
        under = data.oMf[model.getFrameId(name)].translation
        floor = scene.add_contour(f"floor {leg}", pc.Plane(), placement=pin.SE3(np.eye(3), under))
        scene.add_contact(name, scene.add_contour(name, pc.Point(), frame=name), floor, friction=pc.Coulomb(MU))
    speed = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 1.0)
    return scene, scene.initial_state(q, speed * np.eye(model.nv)[0])


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("legs", [1, 2])
@pytest.mark.parametrize("seed", range(10))
def test_held_joints_count_as_held_in_outputs(seed, legs, method):
    scene, start = trolley(seed, legs)
    run = pc.simulate(scene, start, DURATION, method=method)
    assert run.status == 0, run.message
    weight = GRAVITY * sum(inertia.mass for inertia in scene.model.inertias)
    loads = sum(track.normal_force for track in run.contacts.values())
    np.testing.assert_allclose(loads, weight, rtol=1e-9)
    slowed = start.v[0] - np.sign(start.v[0]) * MU * GRAVITY * run.t
    np.testing.assert_allclose(run.v[:, 0], slowed, rtol=0.0, atol=1e-9)


def legs_that_stand(seed):
    """A planar body that stands on three legs, whose joints have dry friction. Returns scene and state."""
    rng = np.random.default_rng(seed)
    model, base = pin.Model(), 0
    for name, joint in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("turn", pin.JointModelRY())):
        base = model.addJoint(base, joint, pin.SE3.Identity(), name)
    model.appendBodyToJoint(base, pin.Inertia.FromBox(rng.uniform(2.0, 5.0), 0.4, 0.3, 0.2), pin.SE3.Identity())
    bound, q = [0.0] * 3, [0.0] * 3
    for leg, x in enumerate((-0.2, 0.2, 0.0)):
        parent, place = base, pin.SE3(np.eye(3), np.array([x, 0.0, -0.05]))
        for joint in range(int(rng.integers(1, 3))):
            parent = model.addJoint(parent, pin.JointModelRY(), place, f"joint {joint} of {leg}")
            lever = np.array([0.0, 0.0, -0.5 * rng.uniform(0.15, 0.3)])
            inertia = pin.Inertia(rng.uniform(0.2, 1.0), lever, 1e-3 * np.eye(3))
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            place = pin.SE3(np.eye(3), 2.0 * lever)
            bound.append(rng.uniform(0.1, 4.0))
            q.append(rng.uniform(-0.5, 0.5))
        model.addFrame(pin.Frame(f"foot {leg}", parent, 0, place, pin.FrameType.OP_FRAME))
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = -np.array(bound), np.array(bound)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(q))
    scene = pc.Scene(model)
    for leg in range(3):
        name = f"foot {leg}"
        under = data.oMf[model.getFrameId(name)].translation
        floor = scene.add_contour(f"floor {leg}", pc.Plane(), placement=pin.SE3(np.eye(3), under))
        law = pc.NoSlip() if rng.random() < 0.3 else pc.Coulomb(rng.uniform(0.3, 0.9))
        scene.add_contact(name, scene.add_contour(name, pc.Point(), frame=name), floor, friction=law)
    return scene, scene.initial_state(q)


@pytest.mark.parametrize("seed", [0, 2, 25])
def test_torques_at_the_edge_of_friction_stop_no_run(seed):
    """The least efforts that hold a body have forces at their limits: to ask again and again whether these are
    exceeded took steps of half a microsecond."""
    scene, state = legs_that_stand(seed)
    tau = pc.inverse_dynamics(scene, state, cones=True).tau
    run = pc.simulate(scene, state, 0.05, control=lambda t, q, v: tau, max_steps=300)
    assert run.status == 0, run.message
    # at rest but for the distance of a limit that is known to 1e-8
    assert np.abs(run.v[-1]).max() < 1e-6


@pytest.mark.parametrize("seed", range(8))
def test_forces_of_outputs_are_those_of_the_motion(seed):
    """A cart brakes on wheels of which dry friction holds some, which slide, while others roll: how they share the load
    is not for the contacts alone to choose."""
    rng = np.random.default_rng(seed)
    model, radius = pin.Model(), 0.1
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    body = pin.Inertia.FromBox(5.0, 0.4, 0.3, 0.1)
    model.appendBodyToJoint(root, body, pin.SE3(np.eye(3), np.array([rng.uniform(-0.05, 0.05), 0.0, 0.0])))
    wheels = {}
    for axle in (-0.2, 0.0, 0.2):
        for side in (-0.15, 0.15):
            place = pin.SE3(np.eye(3), np.array([axle, side, 0.0]))
            wheel = model.addJoint(root, pin.JointModelRY(), place, f"wheel {len(wheels)}")
            model.appendBodyToJoint(wheel, pin.Inertia.FromSphere(0.5, radius), pin.SE3.Identity())
            wheels[f"wheel {len(wheels)}"] = wheel
    model.upperDryFrictionLimit = np.r_[np.zeros(6), np.full(6, rng.uniform(0.2, 0.4))]
    model.lowerDryFrictionLimit = -model.upperDryFrictionLimit
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for name in wheels:
        scene.add_contact(name, floor, scene.add_contour(name, pc.Sphere(radius), name), pc.Coulomb(0.3))
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[2], v[0] = radius, 0.3
    run = pc.simulate(scene, scene.initial_state(q, v), 0.06, dense_output=True)
    assert run.status == 0, run.message
    changes = np.array([event.time for event in run.events])
    for t in np.arange(0.0025, 0.06, 0.005):
        if changes.size and np.abs(changes - t).min() < 1e-4:
            continue
        sample, h = run.sol(t), 1e-5
        rate = (run.sol(t + h).v[0] - run.sol(t - h).v[0]) / (2.0 * h)
        friction = sum(track.force[0] for track in sample.contacts.values())
        # tolerances of 1e-8 over 2 h
        assert friction == pytest.approx(pin.computeTotalMass(model) * rate, abs=0.02)
        assert min(track.normal_force for track in sample.contacts.values()) >= 0.0
