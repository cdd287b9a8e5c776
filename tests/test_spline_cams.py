"""Cams that are cubic splines, smooth between their knots only: steps over several knots have errors that they do not
know of."""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

DURATION = 0.3


def cam_and_follower(seed, points):
    """A flat follower on a convex cam that turns at constant speed, and is pressed on it; scene, start, and the
    follower's height h(t), the support function."""
    rng = np.random.default_rng(seed)
    mean, lobes, phase = rng.uniform(0.03, 0.06), int(rng.integers(1, 4)), rng.uniform(0.0, 6.0)
    lift, speed = mean * rng.uniform(0.02, 0.8 / (lobes**2 + 1)), rng.uniform(5.0, 120.0)
    angles = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    support, slope = mean + lift * np.cos(lobes * angles + phase), -lift * lobes * np.sin(lobes * angles + phase)
    outline = np.c_[
        support * np.cos(angles) - slope * np.sin(angles), support * np.sin(angles) + slope * np.cos(angles)
    ]
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    joint = model.addJoint(0, pin.JointModelPY(), pin.SE3.Identity(), "follower")
    model.appendBodyToJoint(joint, pin.Inertia(0.5, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    scene = pc.Scene(model)
    scene.add_contour("cam", pc.SplineCurve(outline, periodic=True), motion=pc.ConstantTwist(angular=(0, 0, speed)))
    scene.add_contour("flat", pc.Line(), frame="follower")
    scene.add_contact("c", "cam", "flat")

    def height(t):
        return mean + lift * np.cos(lobes * (0.5 * np.pi - speed * t) + phase)

    rate = lift * lobes * speed * np.sin(lobes * 0.5 * np.pi + phase)
    press = 0.65 * lift * (lobes * speed) ** 2 + 5.0
    return scene, scene.initial_state([height(0.0)], [rate]), height, lambda t, q, v: np.array([-press])


@pytest.mark.parametrize("options", [{}, {"rtol": 1e-10, "atol": 1e-12}, {"dense_output": True}], ids=str)
@pytest.mark.parametrize("points", [64, 200])
def test_steps_that_cannot_be_projected_are_made_shorter(points, options):
    """With "DOP853" a quarter of these runs ended with -1; outputs within the step are those of shorter ones."""
    times = np.linspace(0.0, DURATION, 400)
    for seed in range(10):
        scene, start, height, control = cam_and_follower(seed, points)
        run = pc.simulate(scene, start, DURATION, control=control, t_eval=times, **options)
        assert run.status == 0, (seed, run.message)
        np.testing.assert_array_equal(run.t, times)
        # by its knots, a cubic spline is 5/384 of the fourth derivative and power of their distance from the cam, of
        # some 0.02 m times 2 pi / points
        np.testing.assert_allclose(run.q[:, 0], height(times), rtol=0.0, atol=0.1 * (2.0 * np.pi / points) ** 4)
