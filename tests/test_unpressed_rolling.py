"""Ideal rolling on a wall that nothing presses it onto: the limit of Coulomb's law, with no friction without a load.

A wheel of mass m, radius R and inertia k m R^2 beside a vertical wall. Pressed it rolls, and gravity accelerates it by
g / (1 + k); not pressed it falls freely and turns on; pressed again its slip ends at once, which keeps its angular
momentum about the contact.
"""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc
from pincontact import NoSlip

G = 9.81
EXACT = [{}, {"method": "RK45"}, {"method": "Sharp98"}, {"rtol": 1e-11, "atol": 1e-13}]
METHODS = [*EXACT, {"method": "Moreau", "dt": 2e-4}]


class Wheel:
    """A wheel on the left of a wall, of random size: across x, up z, turning about y; v = R omega where it rolls."""

    def __init__(self, rng, spatial, friction=None):
        self.mass, self.radius, self.k = rng.uniform(0.3, 3.0), rng.uniform(0.05, 0.5), rng.uniform(0.3, 1.0)
        model, joint = pin.Model(), 0
        for kind in (pin.JointModelPX(), pin.JointModelPZ(), pin.JointModelRY()):
            joint = model.addJoint(joint, kind, pin.SE3.Identity(), f"joint_{joint}")
        inertia = self.k * self.mass * self.radius**2 * np.eye(3)
        model.appendBodyToJoint(joint, pin.Inertia(self.mass, np.zeros(3), inertia), pin.SE3.Identity())
        model.addBodyFrame("wheel", joint, pin.SE3.Identity(), 0)
        self.scene = scene = pc.Scene(model)
        if spatial:
            rim = scene.add_contour("rim", pc.Sphere(self.radius), "wheel")
            face, place = pc.Plane(), pin.SE3(pin.utils.rotate("y", -np.pi / 2), np.zeros(3))
        else:
            upright = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.zeros(3))
            rim = scene.add_contour("rim", pc.Circle(self.radius), "wheel", placement=upright)
            face, place = pc.Line(), pin.SE3(np.eye(3)[:, [2, 0, 1]], np.zeros(3))
        wall = scene.add_contour("wall", face, placement=place)
        scene.add_contact("wall", rim, wall, friction=friction or NoSlip())

    def start(self, v, omega=None, x=0.0, approach=0.0):
        """A state beside the wall, at this distance from it."""
        omega = v / self.radius if omega is None else omega
        free = ["wall"] if x or approach else []
        return self.scene.initial_state([-self.radius - x, 0.0, 0.0], [approach, v, omega], free=free)

    def rolls(self, z, v, t):
        """Height and speed after rolling for t."""
        return z + v * t - 0.5 * G / (1.0 + self.k) * t**2, v - G / (1.0 + self.k) * t

    def grips(self, v, omega):
        """The speed of rolling after its slip has ended at once."""
        return (v + self.k * self.radius * omega) / (1.0 + self.k)


def axle(rng, count):
    """A free body on balls on one axis, y, that rolls on the wall: scene, mass, radius and k."""
    mass, radius, k = rng.uniform(0.3, 3.0), rng.uniform(0.05, 0.5), rng.uniform(0.3, 1.0)
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "joint")
    turning = mass * radius**2 * np.diag([rng.uniform(1.0, 2.0), k, rng.uniform(1.0, 2.0)])
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), turning), pin.SE3.Identity())
    model.addBodyFrame("axle", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    wall = scene.add_contour("wall", pc.Plane(), placement=pin.SE3(pin.utils.rotate("y", -np.pi / 2), np.zeros(3)))
    for i, y in enumerate(rng.uniform(0.1, 0.5) * np.linspace(-1.0, 1.0, count)):
        ball = scene.add_contour(f"ball {i}", pc.Sphere(radius), "axle", pin.SE3(np.eye(3), np.array([0.0, y, 0.0])))
        scene.add_contact(f"ball {i}", ball, wall, friction=NoSlip())
    return scene, mass, radius, k


@pytest.mark.parametrize("options", [{}, {"method": "RK45"}, {"method": "Moreau", "dt": 2e-4}], ids=str)
@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("ramp", [False, True])
def test_redundant_wheels_roll_while_they_are_pressed(ramp, count, options):
    """By a force in world axes, that ends; then nothing holds the body."""
    rng = np.random.default_rng(34)
    for _ in range(3):
        scene, _mass, radius, k = axle(rng, count)
        v, size = rng.uniform(-2.0, 2.0), rng.uniform(1.0, 100.0)
        ends, t = np.cumsum(rng.uniform(0.05, 0.2, 2)).round(3)

        def push(time, q, v, size=size, ends=ends):
            force = size * (max(ends - time, 0.0) if ramp else float(time < ends))
            return np.r_[pin.Quaternion(q[3:]).toRotationMatrix().T @ [force, 0.0, 0.0], np.zeros(3)]

        state = scene.initial_state([-radius, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, v, 0.0, v / radius, 0.0])
        run = pc.simulate(scene, state, t, control=push, breakpoints=[ends], **options)
        assert run.status == 0, run.message
        z, v = v * ends - 0.5 * G / (1.0 + k) * ends**2, v - G / (1.0 + k) * ends
        z, _ = falls(z, v, t - ends)
        accuracy = 20.0 * options["dt"] if "dt" in options else 1e-5
        np.testing.assert_allclose(run.q[-1, :3], [-radius, 0.0, z], atol=accuracy)
        np.testing.assert_allclose(run.v[-1, 4] * radius, v, atol=5.0 * accuracy)


def falls(z, v, t):
    return z + v * t - 0.5 * G * t**2, v - G * t


def close(run, wheel, z, v, omega, options):
    accuracy = 20.0 * options["dt"] if "dt" in options else 1e-5 if options else 1e-6
    np.testing.assert_array_equal(run.status, 0, run.message)
    np.testing.assert_allclose(run.q[-1, :2], [-wheel.radius, z], atol=accuracy * (1.0 + abs(z)))
    np.testing.assert_allclose(run.v[-1, 1:] * [1.0, wheel.radius], [v, omega * wheel.radius], atol=5.0 * accuracy)


@pytest.mark.parametrize("options", METHODS, ids=str)
@pytest.mark.parametrize("spatial", [False, True])
def test_it_falls_beside_the_wall(spatial, options):
    """From the start on, whether it rolls or slips there, and has no force; after an impact that made it roll."""
    rng = np.random.default_rng(31)
    for case in range(6):
        wheel, v, omega = Wheel(rng, spatial), rng.uniform(-2.0, 2.0), rng.uniform(-5.0, 5.0)
        t, struck = rng.uniform(0.1, 0.4), 0.0
        if case % 2:
            struck = 0.1 * t
            state = wheel.start(v, omega, 0.1, 0.1 / struck)
            z, v = falls(0.0, v, struck)
            v = wheel.grips(v, omega)
            omega = v / wheel.radius
        else:
            z, omega = 0.0, v / wheel.radius
            state = wheel.start(v)
        run = pc.simulate(wheel.scene, state, t, **options)
        close(run, wheel, *falls(z, v, t - struck), omega, options)
        np.testing.assert_allclose(run.contacts["wall"].force[-1], 0.0, atol=1e-9 * wheel.mass * G)


@pytest.mark.parametrize("options", METHODS, ids=str)
@pytest.mark.parametrize("spatial", [False, True])
@pytest.mark.parametrize("ramp", [False, True])
def test_it_rolls_while_it_is_pressed(ramp, spatial, options):
    """A force that ends and comes back, at once or by and by."""
    rng = np.random.default_rng(32)
    for _ in range(4):
        wheel, v, size = Wheel(rng, spatial), rng.uniform(-2.0, 2.0), rng.uniform(1.0, 100.0)
        ends, back, t = np.cumsum(rng.uniform(0.05, 0.2, 3)).round(3)

        def push(time, q, v, size=size, ends=ends, back=back):
            rises = max(ends - time, time - back, 0.0) if ramp else float(time < ends or time >= back)
            return np.array([size * rises, 0.0, 0.0])

        run = pc.simulate(wheel.scene, wheel.start(v), t, control=push, breakpoints=[ends, back], **options)
        z, v = wheel.rolls(0.0, v, ends)
        omega = v / wheel.radius
        z, v = falls(z, v, back - ends)
        v = wheel.grips(v, omega)
        z, v = wheel.rolls(z, v, t - back)
        close(run, wheel, z, v, v / wheel.radius, options)


@pytest.mark.parametrize("options", EXACT, ids=str)
def test_it_falls_as_with_large_coefficients(options):
    """Beside forces that change their sign, for both signs of what presses."""
    rng = np.random.default_rng(33)
    for _ in range(6):
        seed, size, rate = rng.integers(1000), rng.uniform(1.0, 50.0), rng.uniform(10.0, 40.0)
        v, phase, t = rng.uniform(-2.0, 2.0), rng.uniform(0.0, 6.0), 0.5

        def push(time, q, v, size=size, rate=rate, phase=phase):
            return np.array([max(size * np.sin(rate * time + phase), 0.0), 0.0, 0.0])

        ends = []
        for friction in (NoSlip(), pc.Coulomb(1e6)):
            wheel = Wheel(np.random.default_rng(seed), False, friction)
            run = pc.simulate(wheel.scene, wheel.start(v), t, control=push, **options)
            assert run.status == 0, run.message
            ends.append(np.r_[run.q[-1], run.v[-1]])
        np.testing.assert_allclose(*ends, atol=1e-3)
