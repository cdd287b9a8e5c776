"""Bodies that rock or bounce to rest while they slide: low hops are resolved, since their landings brake."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

G, HALF, HEIGHT, DURATION = 9.81, 0.3, 0.2, 1.0
SPEED = 3.0


def _bar(mu: float, restitution: float, inertia: float) -> pc.Scene:
    """A body in the plane y = 0 with two feet, 1 kg, above a floor."""
    model = pin.Model()
    joint = 0
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("pitch", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
    scene = pc.Scene(model)
    scene.add_contour("floor", pc.Plane())
    for name, x in (("rear", -HALF), ("front", HALF)):
        scene.add_contour(name, pc.Point(), "pitch", pin.SE3(np.eye(3), np.array([x, 0.0, -HEIGHT])))
        scene.add_contact(name, name, "floor", pc.Coulomb(mu), restitution=restitution)
    return scene


def _errors(scene: pc.Scene, tilt: float, mu: float, start: float = 0.0, **options: object) -> tuple[float, float]:
    """Errors in m of x, and in m/s of its rate, after the body has come down and slides.

    The floor's impulse is 1 kg (g t + v_z), whatever the hops; friction takes mu times that: so v_x = v_x(0) - mu (g t
    + v_z), and x is its integral.
    """
    z = HEIGHT * math.cos(tilt) + HALF * math.sin(tilt)
    state = scene.initial_state([start, z, tilt], [SPEED, 0.0, 0.0], free=["rear", "front"], max_gap=1.0)
    run = pc.simulate(scene, state, DURATION, **options)
    assert run.status == 0, run.message
    assert sum(event.kind == "touch" for event in run.events) > 2
    np.testing.assert_allclose(run.q[-1, 1:], [HEIGHT, 0.0], atol=1e-9)
    fallen = z - HEIGHT
    x = start + SPEED * DURATION - mu * (0.5 * G * DURATION**2 - fallen)
    return abs(run.q[-1, 0] - x), abs(run.v[-1, 0] - SPEED + mu * G * DURATION)


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Sharp98"])
@pytest.mark.parametrize("restitution", [0.0, 0.3])
@pytest.mark.parametrize("mu", [0.1, 0.28])
def test_sliding_body_rocks_to_rest(method, restitution, mu):
    """A heavy bar thrown from foot to foot: each landing throws the other foot up, lower by a factor, without end."""
    scene = _bar(mu, restitution, inertia=0.3)
    # hops below 1e-13 m are left out, with the root of that times friction; 1.7e-4 m if hops of 1e-8 m were
    position, velocity = _errors(scene, 0.01, mu, method=method, rtol=1e-8, atol=1e-8)
    assert position < 2e-7
    assert velocity < 1e-6


def test_far_from_the_origin():
    """Gaps are known to the round-off of coordinates of 1e4 m there, and the body comes to rest all the same."""
    position, velocity = _errors(_bar(0.28, 0.0, 0.3), 0.01, 0.28, start=1e4, rtol=1e-8, atol=1e-8)
    # of hops as high as 1e-10 m, and the tolerance relative to x
    assert position < 1e-4
    assert velocity < 2e-5
