"""A light body that a heavy one presses to the floor is thrown to and fro faster than time can be told."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

RADIUS = 0.1


def stacked(heavy, restitution):
    """A light ball above the floor, and a heavy one above it, both falling."""
    model = pin.Model()
    for name, mass in (("light", 1.0), ("heavy", heavy)):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"{name} joint")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(mass, RADIUS), pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    light, top = (scene.add_contour(name, pc.Sphere(RADIUS), name) for name in ("light", "heavy"))
    scene.add_contact("below", light, floor, friction=pc.Coulomb(0.5), restitution=restitution)
    scene.add_contact("above", light, top, friction=pc.Coulomb(0.5), restitution=restitution)
    q = np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.42, 0.0, 0.0, 0.0, 1.0])
    return scene, scene.initial_state(q, free=["below", "above"])


def test_rebounds_at_one_time_end_a_run():
    """It says so, with all that came before, and time stepping goes on from there."""
    scene, state = stacked(1e8, 0.8)
    run = pc.simulate(scene, state, 0.18, fallback="Moreau")
    assert run.status == 0 and "rebounds" in run.message and "'above'" in run.message
    # both have fallen 10 cm
    (left,) = (event.time for event in run.events if event.kind == "fallback")
    assert left == pytest.approx(np.sqrt(2.0 * RADIUS / 9.81), rel=0.2)
    assert np.isfinite(run.q).all() and run.t[-1] == 0.18


def test_many_rebounds_that_end_are_no_chatter():
    """Hundreds, before the light ball is at rest below the heavy one, or beside it."""
    scene, state = stacked(500.0, 0.5)
    run = pc.simulate(scene, state, 0.3)
    assert run.status == 0, run.message
    assert sum(event.kind == "touch" for event in run.events) > 1000


@pytest.mark.parametrize("masses", [(1.0,) * 5, (1.0, 2.0, 0.5, 3.0, 1.5)])
def test_elastic_balls_keep_all_of_their_rebound(masses):
    """Five balls in a row without weight, of which the first strikes: restitution 1 keeps the energy to round-off, and
    round-off is no energy that a smaller rebound has to prevent. It took a thousandth of the velocities."""
    model, radius = pin.Model(), 0.05
    model.gravity.linear = np.zeros(3)
    for i, mass in enumerate(masses):
        joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), f"b{i}")
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(f"b{i}", joint, pin.SE3.Identity(), 0)
    # of unequal balls apart from each other the same pair strikes twice, which is no single step
    for gap in (0.0, 1e-5, 1e-3) if len(set(masses)) == 1 else (0.0,):
        scene = pc.Scene(model)
        balls = [scene.add_contour(f"b{i}", pc.Sphere(radius), f"b{i}") for i in range(5)]
        for i in range(4):
            scene.add_contact(f"c{i}", balls[i], balls[i + 1], restitution=1.0)
        q = np.r_[0.0, 0.15 + (2.0 * radius + gap) * np.arange(4)]
        state = scene.initial_state(q, [1.0, 0.0, 0.0, 0.0, 0.0], free=list(scene.contacts)[: 1 if gap == 0.0 else 4])
        exact = pc.simulate(scene, state, 0.3)
        for step in (1e-2, 1e-3, 1.1e-4):
            run = pc.simulate(scene, state, 0.3, method="Moreau", dt=step)
            assert run.status == exact.status == 0
            # round-off of positions of 1 m, over gaps
            np.testing.assert_allclose(run.v[-1], exact.v[-1], rtol=0.0, atol=1e-9)
