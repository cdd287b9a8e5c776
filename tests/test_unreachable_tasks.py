"""Inverse dynamics where contacts leave little of what is wanted.

A cart's wheels spin in place, slipping, and what holds it does not let it turn. What is left of a wanted acceleration
is round-off, next to which torques and accelerations of any size would count as means to it.
"""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc
from pincontact.analysis.instant import Instant

MU, RADIUS, G = 0.8, 0.1, 9.81


def spinning_cart(seed: int, wall: bool):
    """Three wheels, anywhere, that spin forwards at any speed; with a wall the nose is against it."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    cart = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "cart")
    inertia = pin.Inertia(10.0, np.array([0.25, 0.0, 0.05]), np.diag([0.2, 0.4, 0.5]))
    model.appendBodyToJoint(cart, inertia, pin.SE3.Identity())
    model.addBodyFrame("body", cart, pin.SE3.Identity(), 0)
    places = np.array([[0.0, 0.2, 0.0], [0.0, -0.2, 0.0], [0.6, 0.0, 0.0]])
    places[:, :2] += 0.05 * rng.normal(size=(3, 2))
    # friction in proportion to the loads does not turn the cart if its weight is in the middle
    places[:, 1] -= places[:, 1].mean()
    for k, place in enumerate(places):
        wheel = model.addJoint(cart, pin.JointModelRY(), pin.SE3(np.eye(3), place), f"axle {k}")
        inertia = pin.Inertia(0.5, np.zeros(3), np.diag([1.5e-3, 2.5e-3, 1.5e-3]))
        model.appendBodyToJoint(wheel, inertia, pin.SE3.Identity())
        model.addBodyFrame(f"wheel {k}", wheel, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    upright = pin.SE3(pin.utils.rotate("x", math.pi / 2), np.zeros(3))
    for k in range(3):
        rim = scene.add_contour(f"rim {k}", pc.Circle(RADIUS), f"wheel {k}", upright)
        # what resists its spinning is at rest, and holds
        scene.add_contact(f"wheel {k}", rim, floor, friction=pc.Coulomb(MU, spinning=5e-4))
    if wall:
        front = pin.SE3(pin.utils.rotate("y", -math.pi / 2), np.array([0.85, 0.0, 0.0]))
        ahead = scene.add_contour("wall", pc.Plane(), placement=front)
        nose = scene.add_contour("nose", pc.Sphere(0.05), "body", pin.SE3(np.eye(3), np.array([0.8, 0.0, -0.05])))
        scene.add_contact("nose", nose, ahead, friction=pc.Coulomb(0.3))
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[2], v[6:] = RADIUS, rng.uniform(3.0, 6.0, 3)
    return scene, scene.initial_state(q, v)


@pytest.mark.parametrize("cones", [False, True])
@pytest.mark.parametrize("wall", [False, True])
def test_round_off_moves_nothing(wall, cones):
    """Friction alone accelerates the cart, whatever the torques are; the least torques for the rest are moderate."""
    for seed in range(6):
        scene, state = spinning_cart(seed, wall)
        forward = 0.0 if wall else MU * G
        for yaw, along in ((0.0, 0.0), (0.1, 0.0), (0.0, 0.1)):
            wanted = np.array([along, 0.0, 0.0, 0.0, 0.0, yaw])
            found = pc.inverse_dynamics(scene, state, {"body": wanted}, cones=cones)
            np.testing.assert_allclose(found.missed, math.hypot(forward - along, yaw), rtol=0.0, atol=1e-6)
            # N m: the cart needs none
            assert np.abs(found.tau).max() <= 1e-6, (seed, wanted, found.tau)
        # a wheel spins faster; in a run the torques do so
        found = pc.inverse_dynamics(scene, state, {"axle 0": 1.0}, cones=cones)
        assert found.missed <= 1e-6
        assert np.abs(found.tau).max() <= 10.0
        if cones:
            a, unique = Instant(scene, state, found.tau).evaluate(), 6 if wall else 9
            # how wall and floor share the weight is open, and with it what brakes the wheels
            np.testing.assert_allclose(a[:unique], found.acceleration[:unique], rtol=0.0, atol=1e-5)


def test_what_newtons_method_proves_counts_wherever_proxqp_stops():
    """Heavy loads and light wheels: ProxQP reaches its last iteration near the solution."""
    scene, state = spinning_cart(30, True)
    found = pc.inverse_dynamics(scene, state, {"axle 1": -20.0}, cones=True)
    assert found.missed <= 1e-6
    assert np.abs(found.tau).max() <= 10.0
