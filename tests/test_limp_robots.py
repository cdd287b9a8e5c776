"""Robots whose joints hold nothing, dropped from a small height: they fold up under their weight, on feet that slide,
creep and stick."""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

DURATION = 0.3


def limp(seed):
    """A random quadruped or biped with legs of two or three joints, on points or balls. Returns scene and start."""
    rng = np.random.default_rng(seed)
    legs, links = int(rng.choice([2, 4, 4])), int(rng.integers(2, 4))
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia.FromBox(rng.uniform(3.0, 10.0), 0.4, 0.2, 0.1), pin.SE3.Identity())
    places = [(x, y) for x in (0.2, -0.2) for y in (0.12, -0.12)] if legs == 4 else [(0.0, 0.12), (0.0, -0.12)]
    length, angles = rng.uniform(0.12, 0.25), []
    for k, place in enumerate(places):
        parent, at = base, pin.SE3(np.eye(3), np.array([*place, 0.0]))
        for j, kind in enumerate("XYY"[-links:]):
            parent = model.addJoint(parent, getattr(pin, f"JointModelR{kind}")(), at, f"leg {k} {j}")
            mass, way = rng.uniform(0.2, 0.6), 0.0 if kind == "X" else length
            inertia = pin.Inertia.FromCylinder(mass, 0.02, way or 0.03)
            model.appendBodyToJoint(parent, inertia, pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * way])))
            at = pin.SE3(np.eye(3), np.array([0.0, 0.0, -way]))
        model.addBodyFrame(f"foot {k}", parent, at, 0)
        sign = 1.0 if place[0] >= 0.0 or rng.random() < 0.5 else -1.0
        bend = sign * rng.uniform(0.2, 0.9)
        angles += ([rng.uniform(-0.1, 0.1)] if links == 3 else []) + [bend, -2.0 * bend]
    q, v, data = pin.neutral(model), np.zeros(model.nv), model.createData()
    q[7:] = angles
    if rng.random() < 0.5:
        q[7:] += 0.05 * rng.normal(size=model.nq - 7)
    pin.framesForwardKinematics(model, data, q)
    feet = [f"foot {k}" for k in range(legs)]
    q[2] = rng.uniform(0.001, 0.03) - min(data.oMf[model.getFrameId(foot)].translation[2] for foot in feet)
    if rng.random() < 0.5:
        v[:6] = 0.2 * rng.normal(size=6)
    mu, radius = rng.uniform(0.3, 1.0), rng.choice([0.0, 0.02])
    q[2] += radius
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for foot in feet:
        shape = scene.add_contour(foot, pc.Sphere(radius) if radius else pc.Point(), foot)
        scene.add_contact(foot, shape, floor, friction=pc.Coulomb(mu))
    return scene, scene.initial_state(q, v, free=feet, max_gap=1.0)


@pytest.mark.parametrize("seed", [8, 19, 34])
def test_loose_tolerances_refuse_nothing(seed):
    """Feet creep by less than the error of steps in velocities, which is known much better beside feet that stick: to
    end that slip took a hundred times more from the joints, again and again, and forces were none."""
    scene, state = limp(seed)
    exact = pc.simulate(scene, state, DURATION)
    assert exact.status == 0, exact.message
    for rtol in (1e-4, 1e-6):
        run = pc.simulate(scene, state, DURATION, rtol=rtol, atol=0.01 * rtol)
        assert run.status == 0, run.message
        # in m and rad: velocities of up to 50 rad/s, after some ten touches
        np.testing.assert_allclose(run.q[-1], exact.q[-1], rtol=0.0, atol=100.0 * rtol)
