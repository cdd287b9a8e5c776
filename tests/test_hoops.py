"""Hoops and tori around a ball, nearly on its axis: all of them is as near to it but for little, and what is nearest
runs round them fast. The distances are closed forms."""

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq
from shared import one_body

import pincontact as pc
from pincontact.integration.locator import EventLocator

BALL = 0.3
RINGS = {"hoop": (pc.Circle, 0.0), "torus": (pc.Torus, 0.04)}


def gap(q, radius, tube):
    """Of the nearest point of a ring to the ball at the origin."""
    pose = pin.XYZQUATToSE3(q)
    centre = pose.rotation.T @ -pose.translation
    return np.hypot(np.hypot(*centre[:2]) - radius, centre[2]) - tube - BALL


@pytest.mark.parametrize("kind", RINGS)
@pytest.mark.parametrize("seed", range(4))
def test_a_ring_bounces_on_a_ball(seed, kind):
    rng, (shape, tube) = np.random.default_rng(seed), RINGS[kind]
    radius = rng.uniform(0.1, 0.28)
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([0.011, 0.011, 0.02]))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia))
    scene.add_contour("ring", shape(*([radius, tube] if tube else [radius])), "body")
    scene.add_contour("ball", pc.Sphere(BALL))
    law = pc.Coulomb(0.4) if seed % 2 else None
    names = ("ring", "ball")[:: 1 if rng.random() < 0.5 else -1]
    scene.add_contact("c", *names, law, restitution=rng.choice([0.0, 0.5, 0.8]))
    turned = pin.exp3(np.r_[0.3 * rng.normal(size=2), 0.0]) @ pin.utils.rotate("z", rng.uniform(0.0, 6.0))
    height = np.sqrt((BALL + tube) ** 2 - radius**2) + rng.uniform(0.02, 0.1)
    q = np.r_[0.02 * rng.normal(size=2), height, pin.Quaternion(turned).coeffs()]
    v = np.r_[0.1 * rng.normal(size=3), rng.normal(size=3)]
    while gap(q, radius, tube) < 0.005:
        q[2] += 0.01
    run = pc.simulate(scene, scene.initial_state(q, v, free=["c"]), 0.4, dense_output=True, energies=True)
    assert run.status == 0 and "behind" not in run.message, run.message
    assert any(event.kind == "touch" for event in run.events)
    assert min(gap(one, radius, tube) for one in run.sol(np.linspace(0.0, 0.4, 2000)).q) > -1e-8
    assert np.abs(run.energies().balance).max() < 1e-7


@pytest.mark.parametrize("seed", range(10))
def test_a_hoop_that_starts_beside_a_ball_is_outside(seed):
    """Whichever of its points Newton's method finds first."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.1, 0.28)
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3))))
    scene.add_contact(
        "c", scene.add_contour("hoop", pc.Circle(radius), "body"), scene.add_contour("ball", pc.Sphere(BALL))
    )
    turned = pin.exp3(np.r_[0.01 * rng.normal(size=2), rng.uniform(0.0, 3.0)])
    q = np.r_[0.003 * rng.normal(size=2), np.sqrt(BALL**2 - radius**2) + 0.004, pin.Quaternion(turned).coeffs()]
    while gap(q, radius, 0.0) < 1e-3:
        q[2] += 1e-3
    apart, speed = gap(q, radius, 0.0), 0.5
    state = scene.initial_state(q, [*(turned.T @ [0.0, 0.0, -speed]), 0.0, 0.0, 0.0], free=["c"])
    run = pc.simulate(scene, state, 0.05)
    assert run.contacts["c"].gap[0] == pytest.approx(apart, abs=1e-12)

    # it falls without turning
    def apart_at(t):
        return gap(q - (speed * t + 0.5 * 9.81 * t * t) * np.eye(7)[2], radius, 0.0)

    inside = next(t for t in np.linspace(0.0, 0.05, 501) if apart_at(t) < 0.0)
    touch = brentq(apart_at, inside - 1e-4, inside, xtol=1e-12)
    assert run.events[0].kind == "touch" and run.events[0].time == pytest.approx(touch, abs=1e-8)


@pytest.mark.parametrize("misses", [1, 3])
def test_a_touch_that_was_not_seen_is_looked_for_again(misses, monkeypatch):
    """Nothing of the steps that ended inside is left in the outputs, nor are users' events told of them."""
    scene = pc.Scene(one_body(pin.JointModelTranslation(), pin.Inertia.FromSphere(1.0, 0.1)))
    scene.add_contact("c", scene.add_contour("ball", pc.Sphere(0.1), "body"), scene.add_contour("floor", pc.Plane()))
    start, times = scene.initial_state([0.0, 0.0, 0.6], np.zeros(3), free=["c"]), np.linspace(0.0, 0.6, 601)
    given = {"t_eval": times, "events": [lambda t, q, v: q[2] - 0.1 + 1e-3], "max_step": 0.05}
    first, left = EventLocator.first, [misses]

    def misses_some(locator, *arguments):
        found = first(locator, *arguments)
        if found is None or not left[0]:
            return found
        left[0] -= 1
        return None

    monkeypatch.setattr(EventLocator, "first", misses_some)
    run = pc.simulate(scene, start, 0.6, **given)
    assert run.status == 0 and left == [0]
    assert [(event.kind, event.time) for event in run.events] == [("touch", pytest.approx(math.sqrt(1.0 / 9.81)))]
    np.testing.assert_array_equal(run.t, times)
    fall = np.maximum(0.6 - 0.5 * 9.81 * times**2, 0.1)
    np.testing.assert_allclose(run.q[:, 2], fall, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("turned", range(3))
@pytest.mark.parametrize("swapped", [False, True])
def test_a_torus_slides_down_a_pole_that_it_touches_twice(swapped, turned):
    """The far side of its tube is no third place, though it is inside the pole by the width of the tube where the near
    side touches: runs ended there, or not, by the order of names and the world's axes."""
    major, minor, pole, mass = 0.9313583604593519, 0.036975227615555877, 0.36104271916971203, 1.8918066005874985
    moments = mass * major**2 * np.array([0.5, 0.5, 1.0])
    world = np.eye(3)
    if turned:
        world = pin.Quaternion(
            *(lambda x: x / np.linalg.norm(x))(np.random.default_rng(99 + 2 * turned).normal(size=4))
        )
        world = world.matrix()
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(mass, np.zeros(3), np.diag(moments))))
    scene.model.gravity.linear = world @ [0.0, 0.0, -9.81]
    contours = [
        scene.add_contour("torus", pc.Torus(major, minor), "body"),
        scene.add_contour("pole", pc.Cylinder(pole), placement=pin.SE3(world, np.zeros(3))),
    ]
    for name in ("first", "second"):
        scene.add_contact(name, *contours[:: -1 if swapped else 1], friction=pc.Coulomb(0.8))
    lean = world @ pin.Quaternion(0.99587279, 0.09076008, 0.0, 0.0).normalized().matrix()
    q = [*world @ [major - minor - pole, 0.0, 0.0], *pin.Quaternion(lean).coeffs()]
    v = [-0.7175534698, 0.1710621777, -1.8508866656, 0.9040371579, 6.0515715845, 1.2161515143]
    run = pc.simulate(scene, scene.initial_state(q, v, max_gap=0.3 * major, free=["second"]), 2.0)
    assert run.status == 0, run.message
    assert any(event.kind == "touch" and event.contact == "second" for event in run.events)
