"""Slips that leave no forces (Painleve): those that count as ended end at once, faster ones are refused."""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

G = 9.81


def _rod(angle, mu, inertia):
    """A rod of 1 kg and half length 1 m whose tip is on the floor, this much below its middle."""
    model, joint = pin.Model(), 0
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("pitch", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
    scene = pc.Scene(model)
    scene.add_contour("floor", pc.Plane())
    scene.add_contour("tip", pc.Point(), "pitch", pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0])))
    scene.add_contact("tip", "tip", "floor", pc.Coulomb(mu))
    return scene, np.array([0.0, math.sin(angle), angle])


@pytest.mark.parametrize("seed", range(8))
def test_slow_slips_that_jam_stick(seed):
    """Friction of a tip that slides ahead turns it into the floor by more than its load turns it out, and it falls: no
    load is one. A tip as slow as slip that has ended sticks, and the rod falls about it; a faster one is refused."""
    rng = np.random.default_rng(seed)
    angle, inertia = rng.uniform(0.9, 1.2), rng.uniform(0.05, 0.12)
    # the normal acceleration of a unit of load is 1 + cos(angle) (cos(angle) - mu sin(angle)) / inertia
    jams = (inertia + math.cos(angle) ** 2) / (math.sin(angle) * math.cos(angle))
    mu = jams * rng.uniform(1.1, 1.5)
    scene, q = _rod(angle, mu, inertia)
    run = pc.simulate(scene, scene.initial_state(q, [0.5, 0.0, 0.0]), 0.05)
    assert run.status == -4 and "Painleve" in run.message
    slow = 10.0 ** rng.uniform(-8.0, -7.0)
    run = pc.simulate(scene, scene.initial_state(q, [slow, 0.0, 0.0]), 0.05)
    assert run.status == 0, run.message
    # energy of a rod that turns about its tip, which stays where it was
    x, _, pitch = run.q[-1]
    assert abs(x + math.cos(pitch) - math.cos(angle)) < 1e-7
    speed = math.sqrt(2.0 * G * (math.sin(angle) - math.sin(pitch)) / (1.0 + inertia))
    # the slip that has ended, as it turns the rod
    assert abs(abs(run.v[-1][2]) - speed) < 1e-6
