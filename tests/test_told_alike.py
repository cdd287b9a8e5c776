"""Events that both kinds of methods tell alike: slips that an impact sets off elsewhere, and turning."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from shared import one_body

import pincontact as pc

RADIUS, STEP = 0.05, 2.5e-4


def struck_sled(rng):
    """A sled on three feet, at rest, sliding or spinning; a ball flies against its tilted side in 10 ms."""
    model = pin.Model()
    for name, mass in (("sled", 1.0), ("ball", rng.uniform(0.1, 2.0))):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(mass, 0.1), pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for k in range(3):
        angle = 2.0 * np.pi * (k + rng.uniform(0.0, 0.3)) / 3.0
        place = pin.SE3(np.eye(3), np.array([0.2 * np.cos(angle), 0.2 * np.sin(angle), -0.05]))
        foot = scene.add_contour(f"foot{k}", pc.Point(), "sled", place)
        scene.add_contact(f"foot{k}", foot, floor, friction=pc.Coulomb(rng.uniform(0.2, 0.6)))
    turned = pin.exp3(np.array([0.0, rng.uniform(0.9, 1.5), 0.0]))
    side = scene.add_contour("side", pc.Plane(), "sled", pin.SE3(turned, np.array([0.15, 0.0, 0.0])))
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), "ball")
    scene.add_contact("strikes", ball, side, friction=pc.Coulomb(0.3), restitution=rng.uniform(0.0, 0.9))
    q, v = pin.neutral(model), np.zeros(12)
    q[2] = 0.05
    speed = rng.uniform(0.5, 3.0)
    q[7:10] = [0.15, 0.03 * rng.normal(), 0.05] + turned[:, 2] * (RADIUS + 0.01 * speed)
    v[6:9] = -speed * turned[:, 2]
    if rng.random() < 0.5:
        v[[0, 1, 5]] = 0.3 * rng.normal(size=3)
    return scene, scene.initial_state(q, v, free=["strikes"])


def told(run, name):
    """Events of a contact at the time of the first touch of the ball, give or take a step."""
    touch = next(event.time for event in run.events if event.kind == "touch")
    return [event.kind for event in run.events if event.contact == name and abs(event.time - touch) < 1.1e-4]


@pytest.mark.parametrize("seed", range(10))
def test_slips_that_an_impact_sets_off_are_told(seed):
    """By both kinds of methods; the event-driven ones kept them to themselves."""
    scene, state = struck_sled(np.random.default_rng(seed))
    exact, stepped = (pc.simulate(scene, state, 0.02, **k) for k in ({}, {"method": "Moreau", "dt": 1e-4}))
    assert exact.status == stepped.status == 0
    feet = [name for name in scene.contacts if name != "strikes"]
    assert [told(exact, name) for name in feet] == [told(stepped, name) for name in feet]
    touch = next(event.time for event in exact.events if event.kind == "touch")
    for name in feet:
        before, after = exact.contacts[name].mode[np.searchsorted(exact.t, touch) + np.array([-1, 1])]
        assert (told(exact, name) == ["slip"]) or before != 1 or after != 2


def rolling_ball(rng):
    """A ball that resists rolling and spinning, in a bowl or on a floor, thrown and turned at random; what pushes and
    turns it changes at 0.1 s."""
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia.FromSphere(1.0, RADIUS), "ball"))
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), "ball")
    friction = pc.Coulomb(0.5, rolling=rng.uniform(2e-3, 5e-3), spinning=rng.uniform(2e-3, 5e-3))
    bowl = bool(rng.integers(2))
    if bowl:
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.4]))
        scene.add_contact("c", ball, scene.add_contour("bowl", pc.Sphere(0.4), placement=place), friction, side=-1)
    else:
        scene.add_contact("c", ball, scene.add_contour("floor", pc.Plane()), friction)
    angle = 0.3 if bowl else 0.0
    q = (
        [0.35 * np.sin(angle), 0.0, 0.4 - 0.35 * np.cos(angle), 0.0, 0.0, 0.0, 1.0]
        if bowl
        else [0, 0, RADIUS, 0, 0, 0, 1]
    )
    state = scene.initial_state(q, np.r_[0.2 * rng.normal(size=2), 0.0, 5.0 * rng.normal(size=3)])
    wrench = np.r_[rng.normal(size=2), 0.0, 0.1 * rng.normal(size=3)]

    def control(t, q, v):
        return wrench * (t > 0.1)

    return scene, state, {"control": control, "breakpoints": [0.1]}


def event_times(run, kind):
    """Times of events of this kind, without rest between a motion and the reverse one, of a step in time stepping."""
    times = {of: [event.time for event in run.events if event.kind == of] for of in ("turn", kind)}
    passing = [t for t in times[kind] if kind == "hold" and any(0.0 < u - t < 1.5 * STEP for u in times["turn"])]
    return [t for t in times[kind] if t not in passing]


# of 0 to 11; in 0 rolling passes by rest within a step, in which time stepping lets it rest
@pytest.mark.parametrize("seed", range(1, 6))
def test_turning_is_told_by_both_kinds_of_methods(seed):
    """Time stepping did not tell it."""
    scene, state, options = rolling_ball(np.random.default_rng(seed))
    exact = pc.simulate(scene, state, 0.6, **options)
    stepped = pc.simulate(scene, state, 0.6, method="Moreau", dt=STEP, **options)
    assert exact.status == stepped.status == 0
    for kind in ("turn", "hold", "slip", "stick"):
        first, second = (event_times(run, kind) for run in (exact, stepped))
        assert first == pytest.approx(second, abs=2.0 * STEP), kind
