"""Energy of frictionless and rolling contacts between curved moving shapes, kept over long times."""

import math

import numpy as np
import pinocchio as pin
from shared import one_body

import pincontact as pc

DURATION = 100.0
# The energy drift of an order-8 method goes with its tolerance, here 1e-11 a step over some thousands of steps.
DRIFT = 1e-9


def free_body(model, name, mass, inertia):
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.diag(inertia)), pin.SE3.Identity())
    model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)


def energy_drift(scene, state, duration=DURATION, moves=0.5):
    run = pc.simulate(scene, state, duration, rtol=1e-12, atol=1e-14, t_eval=np.linspace(0.0, duration, 201))
    assert run.status == 0, run.message
    assert run.events == []
    total = run.energies().total
    kinetic = run.energies().kinetic.max()
    assert kinetic > 0.1, "nothing moves"
    # the contact point travels: this is no rest position
    assert np.ptp(run.contacts["contact"].location, axis=0).max() > moves
    return np.abs(total - total[0]).max() / max(abs(total[0]), kinetic)


def test_torus_rolls_in_an_ellipsoid():
    model = pin.Model()
    free_body(model, "torus", 1.0, [0.03, 0.03, 0.05])
    scene = pc.Scene(model)
    torus = scene.add_contour("torus", pc.Torus(0.2, 0.05), frame="torus")
    bowl = scene.add_contour("bowl", pc.Ellipsoid(1.5, 1.3, 1.0))
    scene.add_contact("contact", torus, bowl, friction=pc.NoSlip(), side=-1, bilateral=True)
    quaternion = pin.Quaternion(pin.utils.rotate("x", 0.5 * math.pi - 0.2)).coeffs()
    state = scene.initial_state(np.r_[0.0, 0.0, -0.752, quaternion], [0, 0, 0, 0.2, 0.3, 2.0], max_gap=0.1)
    assert energy_drift(scene, state) < DRIFT


def test_spline_wheel_on_spline_ground():
    model = one_body(pin.JointModelPlanar(), pin.Inertia(1.0, np.zeros(3), 0.02 * np.eye(3)), "wheel")
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    scene = pc.Scene(model)
    angles = np.linspace(0.0, 2.0 * np.pi, 33)[:-1]
    radius = 0.2 + 0.01 * np.cos(3.0 * angles)
    rim = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), 0.0 * angles])
    x = np.linspace(-3.0, 3.0, 61)
    ground = np.column_stack([x, 0.15 * x**2, 0.0 * x])
    wheel = scene.add_contour("wheel", pc.SplineCurve(rim, periodic=True), frame="wheel")
    valley = scene.add_contour("valley", pc.SplineCurve(ground))
    scene.add_contact("contact", wheel, valley, friction=pc.NoSlip(), bilateral=True)
    state = scene.initial_state([0.0, 0.2, 1.0, 0.0], [1.0, 0.0, -5.0], max_gap=0.1)
    assert energy_drift(scene, state) < DRIFT


def test_two_moving_rods_cross():
    """Two levers, one swinging in the xz-plane and one in the yz-plane, tied where they cross."""
    model = pin.Model()
    placements = (np.zeros(3), np.array([0.5, -0.5, 0.05]))
    for name, joint_model, arm, place in (
        ("first", pin.JointModelRY(), np.array([-0.3, 0.0, -0.1]), placements[0]),
        ("second", pin.JointModelRX(), np.array([0.0, 0.35, -0.1]), placements[1]),
    ):
        joint = model.addJoint(0, joint_model, pin.SE3(np.eye(3), place), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, arm, 0.02 * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    first = scene.add_contour("first", pc.Line(), frame="first")
    along_y = pin.SE3(pin.utils.rotate("z", 0.5 * math.pi), np.zeros(3))
    second = scene.add_contour("second", pc.Line(), frame="second", placement=along_y)
    scene.add_contact("contact", first, second, bilateral=True)
    state = scene.initial_state([-0.1, 0.0], [1.5, 0.0], max_gap=0.1)
    assert energy_drift(scene, state, moves=0.01) < DRIFT
