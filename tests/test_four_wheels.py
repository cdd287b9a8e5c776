"""Cars with four wheels on nearly flat ground, of which three carry: each touch of the fourth leaves next to nothing to
one of the others."""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc
from pincontact.integration.results import CHATTER, Stop
from pincontact.integration.transitions import Transitions

RADIUS, DURATION = 0.08, 0.5
UP = pin.SE3(pin.utils.rotate("x", 0.5 * np.pi), np.zeros(3))


def car(ground, track, base, mu, speed):
    """A rigid car that drives straight ahead onto the ground, rolling; its left front wheel starts open."""
    model = pin.Model()
    body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    inertia = pin.Inertia(6.0, np.array([0.01, 0.0, 0.02]), np.diag([0.05, 0.1, 0.12]))
    model.appendBodyToJoint(body, inertia, pin.SE3.Identity())
    wheels = {"fl": (0.5, 0.5), "fr": (0.5, -0.5), "rl": (-0.5, 0.5), "rr": (-0.5, -0.5)}
    for name, (ahead, side) in wheels.items():
        place = pin.SE3(np.eye(3), np.array([ahead * base, side * track, 0.0]))
        joint = model.addJoint(body, pin.JointModelRUBY(), place, name)
        model.appendBodyToJoint(joint, pin.Inertia(0.5, np.zeros(3), np.diag([1e-3, 1.6e-3, 1e-3])), pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("ground", pc.HeightField(ground, domain=((-1.5, 2.0), (-1.5, 1.5))))
    for name in wheels:
        rim = scene.add_contour(name, pc.Circle(RADIUS), frame=name, placement=UP)
        scene.add_contact(name, rim, floor, friction=pc.Coulomb(mu))
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[2] = RADIUS + max(ground(ahead * base, side * track) for ahead, side in wheels.values())
    v[0], v[6:] = speed, speed / RADIUS
    return scene, scene.initial_state(q, v, free=["fl"])


def waves(seed):
    rng = np.random.default_rng(seed)
    height, k, phase = 10.0 ** rng.uniform(-5.5, -4.0), rng.uniform(2.0, 8.0, 2), rng.uniform(0.0, 6.0, 2)
    return lambda x, y: height * np.sin(k[0] * x + phase[0]) * np.sin(k[1] * y + phase[1])


@pytest.mark.parametrize("seed", [7, 8])
def test_wheels_that_touch_do_not_stop_a_car(seed):
    """Waves of 0.01 to 0.1 mm: the car rocks from three wheels to three others. A hop is lower than gaps are known, but
    to stop it on four wheels, which no motion ahead keeps down all, took all of the car's speed."""
    speed = 0.5
    ends = []
    for rtol in (1e-5, 1e-6, 1e-8):
        scene, state = car(waves(seed), 0.3, 0.35, 0.8, speed)
        run = pc.simulate(scene, state, DURATION, rtol=rtol, atol=0.01 * rtol, energies=True)
        assert run.status == 0, run.message
        # of 1.1 J: what wheels strike at 0.1 mm takes less than a thousandth
        energies = run.energies()
        assert energies.total[-1] > energies.total[0] - 1e-3
        ends.append(run.v[-1])
    # hops that are left out differ, and take next to nothing
    np.testing.assert_allclose(ends[1][0], ends[2][0], atol=1e-6)
    np.testing.assert_allclose(ends[0][0], ends[2][0], atol=1e-5)


def test_hops_end_only_where_that_takes_what_they_are_worth():
    """A fast car on short wheelbase: wheels that leave what others have struck by less than a touch is known are not
    stopped together, which would take 4 % of the car's speed. Time stepping tells the speed."""
    scene, state = car(waves(20), 0.374, 0.285, 0.353, 1.148)
    run = pc.simulate(scene, state, DURATION, rtol=1e-6, atol=1e-8)
    assert run.status == 0, run.message
    stepped = pc.simulate(scene, state, DURATION, method="Moreau", dt=1e-3)
    np.testing.assert_allclose(run.v[-1][0], stepped.v[-1][0], atol=1e-4)


def test_a_fallback_goes_on_with_the_velocity_of_a_turned_base(monkeypatch):
    """A pitched body that flies on by time stepping, from where the first touch ends the run: in Pinocchio's axes."""
    model = pin.Model()
    body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(body, pin.Inertia(1.0, np.zeros(3), 4e-3 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("body", body, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    ball = scene.add_contour("ball", pc.Sphere(0.1), frame="body")
    scene.add_contact("c", ball, scene.add_contour("floor", pc.Plane()), friction=pc.Coulomb(0.5))
    turn = pin.Quaternion(pin.rpy.rpyToMatrix(0.4, 1.1, -0.7))
    q = np.array([0.0, 0.0, 0.2, *turn.coeffs()])
    v = np.r_[turn.matrix().T @ np.array([0.8, -0.3, 0.5]), 1.0, -2.0, 3.0]
    state = scene.initial_state(q, v, free=["c"])

    def fails(self, t, *_):
        raise Stop(CHATTER, f"t = {t:.9g} s: fails")

    stepped = pc.simulate(scene, state, DURATION, method="Moreau", dt=1e-4)
    monkeypatch.setattr(Transitions, "switch", fails)
    run = pc.simulate(scene, state, DURATION, fallback="Moreau", dt=1e-4)
    assert run.status == 0 and "fallback" in [event.kind for event in run.events]
    # in m, of 0.4: the error of time steps
    np.testing.assert_allclose(run.q[-1, :3], stepped.q[-1, :3], atol=2e-4)


def test_messages_say_what_slides_and_what_goes_on():
    """A run at its limit of steps names the contacts, and what gets further; so does one that may fall back."""
    scene, state = car(waves(4), 0.3, 0.35, 0.8, 0.5)
    run = pc.simulate(scene, state, DURATION, max_steps=5)
    assert run.status == -2
    assert "'fr'" in run.message and "max_steps" in run.message and 'method="Moreau"' in run.message
    # of which nothing goes on from here
    assert "fallback" not in run.message
