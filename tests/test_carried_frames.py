"""Frames of contours carried by joints and drives, against differences of their poses along rigid motions."""

import numpy as np
import pinocchio as pin
import pytest
from calling import from_python

from pincontact.geometry import carriers

place_on_joint, add_drive, point_velocity, point_bias = map(
    from_python, (carriers.place_on_joint, carriers.add_drive, carriers.point_velocity, carriers.point_bias)
)
H = 2e-4
# Differences of second order: H^2 times third derivatives of some hundreds, and roundings over H^2.
NEAR = {"rel": 1e-4, "abs": 1e-4}


class Course:
    """A rigid motion and, at t = 0, its velocity and acceleration in its own axes: of the origin, then of rotation."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.start = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        self.v, self.w, self.a, self.alpha = rng.normal(size=(4, 3))

    def __call__(self, t):
        turn = pin.exp3(t * self.w + 0.5 * t * t * self.alpha)
        return self.start * pin.SE3(turn, t * self.v + 0.5 * t * t * self.a)


def frame_of(course):
    """The rows of a frame at t = 0: rotation, origin, velocity, omega, acceleration, alpha."""
    before, here, after = course(-H), course(0.0), course(H)
    turns = [pin.log3(pose.rotation @ here.rotation.T) for pose in (before, after)]
    points = [pose.translation for pose in (before, here, after)]
    return np.array(
        [
            *here.rotation,
            points[1],
            (points[2] - points[0]) / (2 * H),
            (turns[1] - turns[0]) / (2 * H),
            (points[0] - 2 * points[1] + points[2]) / H**2,
            (turns[1] + turns[0]) / H**2,
        ]
    )


def placed(course, base, gravity=(0.0, 0.0, 0.0)):
    """The frame of a contour at `base` on a joint, from what Pinocchio says of the joint."""
    frame, gravity = np.zeros((8, 3)), np.array(gravity)
    velocity = np.concatenate([course.v, course.w])
    # a spatial acceleration is that of what passes the origin; gravity is subtracted by Pinocchio
    spatial = course.a - np.cross(course.w, course.v) - course.start.rotation.T @ gravity
    rotation = np.ascontiguousarray(course.start.rotation.T)
    numbers = np.concatenate([base.rotation.ravel(), base.translation])
    bias = np.concatenate([spatial, course.alpha])
    place_on_joint(numbers, rotation, course.start.translation, velocity, bias, gravity, frame, np.zeros((8, 3)))
    return frame


@pytest.mark.parametrize("seed", range(3))
def test_a_frame_on_a_joint(seed):
    course, base = Course(seed), pin.SE3(pin.exp3(np.array([0.3, -0.8, 0.5])), np.array([0.7, 0.2, -0.4]))
    frame = placed(course, base, np.array([0.3, -9.0, 2.0]))
    assert frame == pytest.approx(frame_of(lambda t: course(t) * base), **NEAR)


@pytest.mark.parametrize("seed", range(3))
def test_a_frame_that_is_driven_on_its_joint(seed):
    course, drive = Course(seed), Course(seed + 10)
    frame = placed(course, pin.SE3.Identity())
    turn = drive.start.rotation
    motion = [turn.ravel(), drive.start.translation, turn @ drive.v, turn @ drive.w, turn @ drive.a, turn @ drive.alpha]
    add_drive(np.concatenate(motion), frame, np.zeros((8, 3)))
    assert frame == pytest.approx(frame_of(lambda t: course(t) * drive(t)), **NEAR)


@pytest.mark.parametrize("seed", range(3))
def test_a_point_that_moves_in_its_frame(seed):
    course, (c, c_t, c_tt) = Course(seed), np.random.default_rng(seed).normal(size=(3, 3))
    frame = placed(course, pin.SE3.Identity())
    rho, rho_t, rho_tt = (course.start.rotation @ vector for vector in (c, c_t, c_tt))
    before, here, after = (course(t).act(c + t * c_t + 0.5 * t * t * c_tt) for t in (-H, 0.0, H))
    velocity, bias = np.full(3, np.nan), np.full(3, np.nan)
    point_velocity(frame, rho, rho_t, velocity)
    point_bias(frame, rho, rho_t, rho_tt, bias, np.zeros(3))
    assert velocity == pytest.approx((after - before) / (2 * H), **NEAR)
    assert bias == pytest.approx((before - 2 * here + after) / H**2, **NEAR)
