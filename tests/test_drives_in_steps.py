"""How fast prescribed motions go in a step, by which steps of open contacts are bounded."""

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
