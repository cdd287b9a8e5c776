"""Joints at their ends: the lower and the upper one are one thing, seen in a mirror; contacts that close there."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

JOINTS, DURATION = 6, 0.5


def _falling_chain(seed: int, mirrored: bool) -> pc.Trajectory:
    """A hanging chain of hinges between stops, thrown at random.

    In the mirror each hinge turns about the opposite axis: its coordinate changes its sign, its ends their places.
    """
    rng = np.random.default_rng(seed)
    sign = -1.0 if mirrored else 1.0
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for k in range(JOINTS):
        hinge = pin.JointModelRevoluteUnaligned(np.array([0.0, sign, 0.0]))
        parent = model.addJoint(parent, hinge, place, f"hinge {k}")
        lever = np.array([rng.uniform(-0.03, 0.03), 0.0, -rng.uniform(0.05, 0.3)])
        body = pin.Inertia(rng.uniform(0.1, 2.0), lever, rng.uniform(1e-4, 1e-3) * np.eye(3))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.25]))
    ends = np.sort(sign * np.array([-rng.uniform(0.0, 0.05, JOINTS), rng.uniform(0.0, 0.05, JOINTS)]), axis=0)
    model.lowerPositionLimit, model.upperPositionLimit = ends
    friction = rng.uniform(0.0, 0.01, JOINTS) * rng.integers(0, 2, JOINTS)
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = -friction, friction
    scene = pc.Scene(model)
    state = scene.initial_state(np.zeros(JOINTS), sign * rng.normal(size=JOINTS))
    run: pc.Trajectory = pc.simulate(scene, state, DURATION)
    return run


@pytest.mark.parametrize("seed", range(12))
def test_mirrored_chain_moves_alike(seed):
    run, mirrored = _falling_chain(seed, False), _falling_chain(seed, True)
    assert run.status == mirrored.status == 0, (run.message, mirrored.message)
    told = [(event.joint, event.kind) for event in run.events]
    assert len(told) >= 8
    assert told == [(event.joint, event.kind) for event in mirrored.events]
    # round-off, which impacts amplify
    np.testing.assert_allclose(run.q[-1], -mirrored.q[-1], atol=1e-7)


@pytest.mark.parametrize("options", [{}, {"method": "RK45"}, {"method": "Moreau", "step": 1e-4}])
@pytest.mark.parametrize("shift", [-1e-15, 0.0, 1e-15])
def test_contact_that_rebounds_where_a_joint_ends(shift, options):
    """A ball on a vertical slider whose lower end is where it touches the floor: both strike at once, and the ball
    leaves with e times its speed, whichever comes first by rounding."""
    radius, restitution, height = 0.1, 0.5, 0.05
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, radius), pin.SE3.Identity())
    model.addBodyFrame("ball", joint, pin.SE3.Identity(), 0)
    model.lowerPositionLimit, model.upperPositionLimit = np.array([radius + shift]), np.array([1.0])
    scene = pc.Scene(model)
    floor, ball = scene.add_contour("floor", pc.Plane()), scene.add_contour("ball", pc.Sphere(radius), "ball")
    scene.add_contact("c", ball, floor, restitution=restitution)
    fall = math.sqrt(2.0 * height / 9.81)
    state = scene.initial_state([radius + height], [0.0], free=["c"])
    run = pc.simulate(scene, state, fall * (1.0 + restitution), **options)
    assert run.status == 0, run.message
    # the top of the hop; impacts of time stepping are known to their step, over which the ball goes 1e-4 m
    assert run.q[-1, 0] == pytest.approx(radius + restitution**2 * height, abs=1.5e-4 if "step" in options else 1e-7)
