"""Contacts declared twice, at one place, do what one of them does."""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

G = 9.81


def two_bodies(*kinds):
    """Bodies "A", "B" on these joints, of 0.3 kg."""
    model = pin.Model()
    for name, kind in zip("AB", kinds):
        joint = model.addJoint(0, kind, pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(0.3, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    return model


@pytest.mark.parametrize("contacts", [1, 2, 3])
@pytest.mark.parametrize("limit", [None, 0.6])
@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_what_slides_without_a_load_while_another_body_strikes(method, limit, contacts):
    """No gravity: ball B goes on as it is, ball A strikes the floor and stays there, for nothing lifts it."""
    model = two_bodies(pin.JointModelFreeFlyer(), pin.JointModelFreeFlyer())
    model.gravity.linear = np.zeros(3)
    scene = pc.Scene(model)
    scene.add_contour("floor", pc.Plane())
    for name in ("A", *(f"B{i}" for i in range(contacts))):
        scene.add_contour(name, pc.Sphere(0.1), name[0])
        scene.add_contact(name, name, "floor", friction=pc.Coulomb(0.4, limit))
    q, v = pin.neutral(model), np.zeros(12)
    q[[2, 7, 9]] = 0.15, 1.0, 0.1
    v[:6], v[6] = [0.3, 0.1, -0.8, 1.0, 2.0, 3.0], 0.4
    run = pc.simulate(scene, scene.initial_state(q, v, free=["A"]), 0.3, method=method)
    assert run.status == 0, run.message
    np.testing.assert_allclose(run.q[-1, 7:10], [1.12, 0.0, 0.1], atol=1e-9)
    assert run.q[-1, 2] == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize("contacts", [1, 2, 3])
@pytest.mark.parametrize("mu", [0.1, 0.3])
def test_ideal_rolling_that_loses_its_load_while_another_contact_slides(mu, contacts):
    """A is pushed against the side of B, which slides on the floor, and hangs there by friction without bound; the push
    turns into a pull. Then A falls, and B slides on alone."""
    mass, push, rate, speed = 0.3, 2.0, 20.0, 3.0
    model = two_bodies(pin.JointModelTranslation(), pin.JointModelTranslation())
    scene = pc.Scene(model)
    scene.add_contour("floor", pc.Plane())
    scene.add_contour("foot", pc.Point(), "B")
    scene.add_contact("foot", "foot", "floor", friction=pc.Coulomb(mu))
    side = pin.SE3(pin.utils.rotate("y", -math.pi / 2), np.array([-0.1, 0.0, 0.0]))  # its normal is -x
    names = []
    for i in range(contacts):
        scene.add_contour(f"tip {i}", pc.Point(), "A", pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0])))
        scene.add_contour(f"side {i}", pc.Plane(), "B", side)
        names.append(scene.add_contact(f"c{i}", f"tip {i}", f"side {i}", friction=pc.NoSlip()).name)
    q, v = np.array([-0.2, 0.0, 0.5, 0.0, 0.0, 0.0]), np.array([speed, 0.0, 0.0, speed, 0.0, 0.0])

    def control(t, q, v):
        return np.array([push - rate * t, 0.0, 0.0, 0.0, 0.0, 0.0])

    run = pc.simulate(scene, scene.initial_state(q, v), 0.3, control=control)
    assert run.status == 0, run.message
    # B carries both; alone it is as slow to stop as A with a pull of mu m g
    loads = [name for name in names for event in run.events if (event.contact, event.kind) == (name, "separate")]
    assert sorted(loads) == names
    parted = next(event.time for event in run.events if event.kind == "separate")
    total = run.contacts["foot"].normal_force[0]
    assert total == pytest.approx(2.0 * mass * G, rel=1e-9)
    fallen = run.q[-1, 2] - 0.5
    assert fallen == pytest.approx(-0.5 * G * (0.3 - parted) ** 2, abs=1e-9)
    # with A's weight on it: acceleration a of both, and push - rate t = m a as they part
    assert push - rate * parted == pytest.approx(
        mass * (push - rate * parted - 2.0 * mu * mass * G) / (2.0 * mass), abs=1e-6
    )


@pytest.mark.parametrize("seed", range(24))
def test_balls_that_roll_on_each_other_by_ideal_friction_until_they_part(seed):
    """Two balls on a floor, one of which slides there: the motion is that of one contact between them."""
    ends = []
    for contacts in (1, 2):
        rng = np.random.default_rng(seed)
        model = two_bodies(pin.JointModelFreeFlyer(), pin.JointModelFreeFlyer())
        model.gravity.linear = np.array([*rng.normal(size=2), -10.0])
        scene = pc.Scene(model)
        scene.add_contour("floor", pc.Plane())
        for name, mu in (("A", 0.9), ("B", rng.uniform(0.03, 0.3))):
            scene.add_contour(name, pc.Sphere(0.1), name)
            scene.add_contact(name, name, "floor", friction=pc.Coulomb(mu))
        for i in range(contacts):
            for name in "AB":
                scene.add_contour(f"{name}{i}", pc.Sphere(0.1), name)
            scene.add_contact(f"c{i}", f"A{i}", f"B{i}", friction=pc.NoSlip())
        q, v, torques = pin.neutral(model), np.zeros(12), 0.5 * rng.normal(size=12)
        q[[2, 7, 9]] = 0.1, 0.2, 0.1
        v[3:6], v[9:12] = 3.0 * rng.normal(size=(2, 3))
        rate = rng.uniform(5.0, 15.0)

        def control(t, q, v, torques=torques, rate=rate):
            return torques + np.r_[1.5 - rate * t, np.zeros(11)]

        run = pc.simulate(scene, scene.initial_state(q, v, max_gap=0.01), 0.4, control=control)
        ends.append((run.status, run.q[-1]))
    # some of them jam, whose forces no event-driven method finds
    assert ends[0][0] == ends[1][0] in (0, -4)
    if ends[0][0] == 0:
        np.testing.assert_allclose(ends[0][1], ends[1][1], atol=1e-6)
