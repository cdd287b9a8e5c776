"""Driven contours: placements and their time derivatives against differentiation of the placement alone."""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact.contours as pc
from pincontact.contours.motion import MOTION_CALLABLE, MOTION_SPLINE
from pincontact.errors import ContourError


def differentiated(motion, t, h=2e-3):
    """(velocity, angular velocity, acceleration, angular acceleration) from placements by eighth-order differences.

    Truncation (rate h)^8, rounding 1e-16 / h and 1e-16 / h^2.
    """
    first = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    second = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
    rows = np.array([motion.evaluate(t + k * h) for k in range(-4, 5)])
    rotation = rows[:, :9].reshape(-1, 3, 3)
    here = rotation[4]
    speed = np.einsum("k,kij->ij", first, rotation) / h @ here.T
    change = np.einsum("k,kij->ij", second, rotation) / h**2 @ here.T - speed @ speed

    def vector(matrix):
        return 0.5 * np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])

    return np.concatenate([first @ rows[:, 9:12] / h, vector(speed), second @ rows[:, 9:12] / h**2, vector(change)])


def poses(n=12, seed=1):
    generator = np.random.default_rng(seed)
    turns = np.cumsum(generator.normal(scale=0.3, size=(n, 3)), axis=0)
    return [pin.SE3(pin.exp3(turn), position) for turn, position in zip(turns, generator.normal(size=(n, 3)))]


def spinning(t):
    return pin.SE3(pin.exp3(np.array([2.5 * t, 0.3 * math.sin(t), 0.1])), np.array([math.cos(t), t * t, 0.1]))


def gone(t):
    raise KeyError("no path")


def by_hand(t):
    """A turn about z through the origin while rising, with its derivatives written out."""
    angle = 0.3 * math.sin(2 * t)
    c, s = math.cos(angle), math.sin(angle)
    pose = pin.SE3(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), np.array([0, 0, t**3]))
    velocity = np.array([0, 0, 3 * t * t, 0, 0, 0.6 * math.cos(2 * t)])
    return pose, velocity, np.array([0, 0, 6 * t, 0, 0, -1.2 * math.sin(2 * t)])


MOTIONS = {
    "twist": pc.ConstantTwist((0.3, -1.2, 2.0), (0.1, 0.2, -0.3), (0.5, 0.1, -0.4)),
    "belt": pc.ConstantTwist(linear=(1.0, 0.0, 0.0)),
    "heave": pc.HarmonicMotion((0.0, 0.02, 0.05), 0.7, 0.4),
    "rocking": pc.HarmonicMotion(
        (0.1, 0.0, 0.0),
        0.5,
        0.1,
        axis=(1.0, 2.0, -1.0),
        angle=1.4,
        turn_frequency=0.3,
        turn_phase=1.0,
        center=(0.3, -0.2, 0.6),
    ),
    "spline": pc.SplineMotion(np.linspace(0, 3, 12) ** 1.1, poses()),
    "closed spline": pc.SplineMotion(np.linspace(0, 4, 13), poses(), periodic=True),
    "fitted": pc.CallableMotion(spinning, time_domain=(0.0, 4.0)),
    "callable": pc.CallableMotion(by_hand),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_derivatives(name):
    motion = MOTIONS[name]
    for t in np.random.default_rng(8).uniform(0.1, 2.9, 12):
        row = motion.evaluate(t)
        rotation = row[:9].reshape(3, 3)
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-14
        expected = differentiated(motion, t)
        scale = 1 + np.abs(row).max()
        # Splines are C4: differences across one of their knots are of lower order.
        tolerance = 1e-6 if "spline" in name else 1e-9
        assert np.abs(row[12:18] - expected[:6]).max() < tolerance * 1e-2 * scale
        assert np.abs(row[18:] - expected[6:]).max() < tolerance * scale


def test_spline_derivatives_between_knots():
    """Away from knots a spline is analytic, so that there the differences show all digits."""
    times = np.arange(12.0)
    motion = pc.SplineMotion(times, poses())
    for t in (0.5, 3.4, 7.7, 10.5):
        row, expected = motion.evaluate(t), differentiated(motion, t, h=0.01)
        scale = 1 + np.abs(row).max()
        assert np.abs(row[12:18] - expected[:6]).max() < 1e-12 * scale
        assert np.abs(row[18:] - expected[6:]).max() < 1e-10 * scale


def test_spline_passes_its_poses_twice_differentiably():
    times, given = np.linspace(0, 3, 12) ** 1.1, poses()
    motion = pc.SplineMotion(times, given)
    for t, pose in zip(times, given):
        assert np.abs(motion.placement(t).homogeneous - pose.homogeneous).max() < 1e-13
        before, after = motion.evaluate(np.nextafter(t, -1)), motion.evaluate(np.nextafter(t, 9))
        assert np.abs(before - after).max() < 1e-10 * (1 + np.abs(after).max())
    with_matrices = pc.SplineMotion(times, [pose.homogeneous for pose in given])
    assert np.abs(with_matrices.evaluate(0.7) - motion.evaluate(0.7)).max() == 0.0


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_closed_spline_of_whole_turns(turns):
    """An odd number of turns flips the quaternion's sign; the rotation must not notice."""
    angles = np.linspace(0, 2 * np.pi * turns, 12 * turns, endpoint=False)
    given = [pin.SE3(pin.exp3(np.array([0, 0, a])), np.array([math.cos(a), 0.0, 0.0])) for a in angles]
    motion = pc.SplineMotion(np.linspace(0, turns, 12 * turns + 1), given, periodic=True)
    for t in (0.0, 0.3, turns - 0.01):
        row = motion.evaluate(t)
        assert np.abs(row - motion.evaluate(t + turns)).max() < 1e-9
        # 12 poses a turn, degree 5: the rate of a uniform rotation comes out to (2 pi / 12)^5 / 5! or so.
        assert row[15:18] == pytest.approx([0, 0, 2 * np.pi], abs=1e-3)


def test_fitted_motion_is_the_function():
    motion = MOTIONS["fitted"]
    assert motion.kind == MOTION_SPLINE
    assert motion.fit_error < 1e-12
    for t in np.linspace(0, 4, 57):
        assert np.abs(motion.placement(t).homogeneous - spinning(t).homogeneous).max() < 1e-12


def test_callable_motion_reports_what_it_is_given():
    motion = MOTIONS["callable"]
    assert motion.kind == MOTION_CALLABLE
    pose, velocity, acceleration = by_hand(0.8)
    row = motion.evaluate(0.8)
    assert row[:9].tolist() == pose.rotation.ravel().tolist()
    assert row[9:12].tolist() == pose.translation.tolist()
    assert row[12:].tolist() == [*velocity, *acceleration]


def test_twist_closed_form():
    table = pc.ConstantTwist((0.0, 0.0, 2.0), center=(1.0, 0.0, 0.0))
    row = table.evaluate(math.pi / 4)
    # A quarter turn about (1, 0): the origin, one metre west of the axis, is one metre south of it.
    assert row[9:12] == pytest.approx([1.0, -1.0, 0.0], abs=1e-15)
    assert row[12:15] == pytest.approx([2.0, 0.0, 0.0], abs=1e-15)
    assert row[18:21] == pytest.approx([0.0, 4.0, 0.0], abs=1e-14)
    assert row[15:18].tolist() == [0.0, 0.0, 2.0]
    assert pc.Motion().evaluate(3.0).tolist() == [1, 0, 0, 0, 1, 0, 0, 0, 1, *[0] * 15]


def bounces(t):
    return pin.SE3(np.eye(3), np.array([0.0, 0.0, abs(t - 0.5) * (t - 0.5)]))


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: pc.ConstantTwist((1.0, 2.0)), r"angular must have shape \(3\)"),
        (lambda: pc.ConstantTwist((1.0, 2.0, math.nan)), r"angular\[2\] is not finite"),
        (lambda: pc.HarmonicMotion((0, 0, 1), math.inf), "frequency must be finite"),
        (lambda: pc.HarmonicMotion(angle=0.3), "needs an axis"),
        (lambda: pc.HarmonicMotion(angle=0.3, axis=(0, 0, 0)), "axis must not be zero"),
        (lambda: pc.SplineMotion(np.arange(4.0), poses(4)), "too few"),
        (lambda: pc.SplineMotion(np.arange(5.0), poses(6)), r"shape \(6\)"),
        (lambda: pc.SplineMotion([0, 1, 2, 2, 3, 4], poses(6)), "increase"),
        (lambda: pc.SplineMotion(np.arange(6.0), [np.eye(4)] * 5 + [2 * np.eye(4)]), r"poses\[5\] is not a placement"),
        (
            lambda: pc.SplineMotion(
                np.arange(6.0), [pin.SE3(pin.exp3(np.array([0, 0, a])), np.zeros(3)) for a in (0, 1, 2, 5, 6, 7)]
            ),
            "poses 2 and 3 are 3.000 rad apart",
        ),
        (lambda: pc.CallableMotion(spinning), "time_domain"),
        (lambda: pc.CallableMotion(3.0), "function is needed"),
        (lambda: pc.CallableMotion(spinning, (0.0, math.inf)), "finite"),
        (lambda: pc.CallableMotion(lambda t: (by_hand(t)[0], by_hand(t)[1])), "pose, velocity, acceleration"),
        (
            lambda: pc.CallableMotion(lambda t: (by_hand(t)[0], 2 * by_hand(t)[1], by_hand(t)[2])),
            "differences give",
        ),
        (lambda: pc.CallableMotion(lambda t: by_hand(abs(t - 0.2))[0], (0.0, 1.0)), "near.*breakpoints"),
        (lambda: pc.CallableMotion(bounces, (0.0, 1.0)), "near.*breakpoints"),
        (lambda: pc.CallableMotion(gone), r"gone\(0\) raised KeyError: 'no path'"),
        (
            lambda: pc.CallableMotion(lambda t: by_hand(t) if t < 0.5 else gone(t)),
            r"lambda.*\(0.61\d*\) raised KeyError",
        ),
        (lambda: pc.CallableMotion(lambda t: by_hand(t)[0] if t < 0.7 else gone(t), (0.0, 1.0)), "raised KeyError"),
    ],
)
def test_bad_motions_are_refused_by_name(build, message):
    with pytest.raises(ContourError, match=message):
        build()


def test_a_motion_made_of_a_function_keeps_it():
    """What a function raises in a run, after it was made, is its own."""

    def fails_late(t):
        return by_hand(t) if t < 5.0 else gone(t)

    motion = pc.CallableMotion(fails_late)
    with pytest.raises(KeyError, match="no path"):
        motion.evaluate(6.0)


@pytest.mark.parametrize(
    ("name", "attribute"), [("heave", "frequency"), ("twist", "angular"), ("callable", "function")]
)
def test_motions_have_no_other_attributes(name, attribute):
    """A number of a motion is read when it is made: setting it later would do nothing."""
    motion = MOTIONS[name]
    with pytest.raises(AttributeError, match=rf"{type(motion).__name__} has no attribute '{attribute}'.*parameters"):
        setattr(motion, attribute, 2.0)
    assert not hasattr(motion, attribute)


def test_motions_of_ones_own_may_have_any():
    class Swing(pc.HarmonicMotion):
        def __init__(self):
            super().__init__((0.1, 0.0, 0.0))
            self.label = "swing"

    assert Swing().label == "swing"
