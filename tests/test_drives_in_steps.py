"""How fast prescribed motions go in a step, by which steps of open contacts are bounded."""

import math

import numpy as np
import pinocchio as pin
import pytest
from shared import one_body

import pincontact as pc
from pincontact.integration.nearness import Drives, Nearness
from pincontact.integration.run_system import RunSystem


@pytest.mark.parametrize("linear", [0.0, 2.0, -2.0])
def test_a_paddle_is_as_fast_as_its_turning_makes_it_where_the_ball_is(linear):
    """A plate turns about its frame's origin at 3 rad/s, and slides; the ball is 0.7 m from there."""
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)))
    scene = pc.Scene(model)
    scene.add_contour("ball", pc.Sphere(0.1), "body")
    motion = pc.ConstantTwist(linear=[0.0, linear, 0.0], angular=[0.0, 0.0, 3.0])
    scene.add_contour("plate", pc.Plane(), motion=motion)
    scene.add_contact("c", "ball", "plate")
    system = RunSystem(model, list(scene.contacts.values()))
    system.q[:] = [0.7, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]
    system.evaluate_kinematics(0.0)
    speed, _ = Nearness(system, 0, 0.0, Drives()).driven(system, 0.0, 0.01)
    # the distance of the ball's middle from the origin that turns
    assert speed >= abs(linear) + 3.0 * np.hypot(0.7, 0.5) - 0.1


@pytest.mark.parametrize("law", [pc.Coulomb(0.02), pc.Coulomb(0.3), pc.Stribeck(0.2, 0.4, 0.1)], ids=str)
@pytest.mark.parametrize("from_rest", [False, True])
@pytest.mark.parametrize("slides", [False, True])
def test_a_follower_held_to_a_driven_cam_slides(slides, from_rest, law):
    """The cam alone determines how it slides, which no friction ends: the roller's normal is all that can move."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    if slides:
        joint, q, place = pin.JointModelPY(), 0.0, pin.SE3.Identity()
        follower = pc.Line()
    else:
        arm, offset, centre = 0.3, np.array([-0.3, 0.05]), np.array([0.02, 0.0])
        away = centre - offset
        reach = np.linalg.norm(away)
        q = math.atan2(away[1], away[0]) + math.acos((arm**2 + reach**2 - 0.1**2) / (2.0 * arm * reach))
        joint, place = pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([*offset, 0.0]))
        follower = pc.Circle(0.02)
    index = model.addJoint(0, joint, place, "follower")
    model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("follower", index, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    if from_rest:
        # turns by 1 - cos
        drive = pc.HarmonicMotion(np.zeros(3), 1.0, 0.5 * math.pi, [0.0, 0.0, 1.0], 0.5)
    else:
        drive = pc.ConstantTwist(angular=[0.0, 0.0, 3.0])
    shape = pc.FourierCurve([[0.02, 0.0], [0.08, 0.0]], [[0.0, 0.0], [0.0, 0.08]])
    cam = scene.add_contour("cam", shape, motion=drive)
    at = pin.SE3(np.eye(3), np.array([0.0 if slides else 0.3, 0.0, 0.0]))
    roller = scene.add_contour("roller", follower, "follower", at)
    scene.add_contact("c", cam, roller, friction=law, bilateral=True)
    state = scene.initial_state([0.08 if slides else q], max_gap=0.1)
    run, steps = pc.simulate(scene, state, 0.4), pc.simulate(scene, state, 0.4, method="Moreau", dt=1e-3)
    assert run.status == steps.status == 0, (run.message, steps.message)
    np.testing.assert_allclose(steps.q[-1], run.q[-1], atol=1e-7)
    # the midpoint rule, whose accelerations are off by the square of the step
    np.testing.assert_allclose(steps.contacts["c"].force[-1], run.contacts["c"].force[-1], rtol=1e-3, atol=1e-3)
