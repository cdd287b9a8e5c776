"""Carts whose feet slide, roll and come to rest together, some held by dry friction of their wheels' joints."""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc


def cart(kind, seed):
    """Scene and start of a cart on four wheels, with random dry friction in their joints, that rolls, and turns or
    not."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    center = np.array([rng.uniform(-0.05, 0.05), rng.uniform(-0.03, 0.03), 0.1])
    model.appendBodyToJoint(base, pin.Inertia(12.0, center, np.diag([0.2, 0.3, 0.4])), pin.SE3.Identity())
    radius, mu = rng.uniform(0.03, 0.1), rng.uniform(0.3, 0.8)
    places = [(x, y) for x in (0.2, -0.2) for y in (0.15, -0.15)]
    for i, place in enumerate(places):
        at = pin.SE3(np.eye(3), np.array([*place, 0.0]))
        joint = model.addJoint(base, pin.JointModelRY(), at, f"w{i}")
        model.appendBodyToJoint(joint, pin.Inertia(0.5, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(f"w{i}", joint, pin.SE3.Identity(), 0)
    # of what makes a wheel slide under its share of the weight
    share = 0.25 * pin.computeTotalMass(model) * 9.81 * mu * radius
    limit = np.array([0.0] * 6 + [rng.uniform(0.2, 1.5) * share for _ in places])
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = -limit, limit
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for i in range(len(places)):
        wheel = scene.add_contour(f"w{i}", pc.Sphere(radius), f"w{i}")
        scene.add_contact(f"w{i}", wheel, floor, friction=pc.Coulomb(mu))
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[2], v[0] = radius, rng.uniform(0.3, 1.0)
    v[6:] = v[0] / radius
    if kind == "turning":
        v[1], v[5] = rng.uniform(-0.5, 0.5), rng.uniform(-2.0, 2.0)
    return scene, scene.initial_state(q, v)


@pytest.mark.parametrize(("kind", "seed"), [("rolling", 26), ("rolling", 32), ("turning", 39)])
def test_wheels_and_feet_come_to_rest_at_once(kind, seed):
    """What comes to rest beside the slip that ends first is held, too: pushed on by joints that seemed to slide, feet
    would have no forces that hold them."""
    scene, state = cart(kind, seed)
    run = pc.simulate(scene, state, 0.8)
    assert run.status == 0, run.message
    np.testing.assert_allclose(run.v[-1], 0.0, atol=1e-12)
    last = [event for event in run.events if event.time > run.events[-1].time - 1e-9]
    assert len(last) >= 2 and {event.kind for event in last} == {"stick"}
    # while feet slide, nothing decides how they share the weight: of 120 random carts all were nearer than 3e-3
    stepped = pc.simulate(scene, state, 0.8, method="Moreau", step=1e-3)
    np.testing.assert_allclose(run.q[-1, :7], stepped.q[-1, :7], rtol=0.0, atol=5e-3)
