"""Time stepping where slip ends: what comes to rest within a step holds as it does in the event-driven methods."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from test_loads import body_on_feet

import pincontact as pc

STEPS = 1e-3 * np.linspace(0.9, 1.1, 12)


def slider(law, slope, tangents):
    """A mass that slides up a slope at 1 m/s, on a rail in a plane or on one side in space, and the direction in q."""
    plane = tangents == 1
    model = pin.Model()
    kind = pin.JointModelPlanar() if plane else pin.JointModelTranslation()
    joint = model.addJoint(0, kind, pin.SE3.Identity(), "mass")
    inertia = 0.01 * np.eye(3) if plane else np.zeros((3, 3))
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia), pin.SE3.Identity())
    model.addBodyFrame("mass", joint, pin.SE3.Identity(), 0)
    if plane:
        model.gravity.linear = np.array([0.0, -9.81, 0.0])
    scene = pc.Scene(model)
    turned = pin.SE3(pin.utils.rotate("z", slope) if plane else pin.utils.rotate("y", -slope), np.zeros(3))
    ground = scene.add_contour("ground", pc.Line() if plane else pc.Plane(), placement=turned)
    point = scene.add_contour("point", pc.Point(), "mass")
    scene.add_contact("c", point, ground, law, bilateral=plane)
    up = turned.rotation[:, 0]
    if plane:
        return scene, scene.initial_state([0.0, 0.0, 1.0, 0.0], [up[0], up[1], 0.0]), np.array([up[0], up[1], 0.0, 0.0])
    return scene, scene.initial_state(np.zeros(3), up), up


@pytest.mark.parametrize("tangents", [1, 2])
@pytest.mark.parametrize("law", [pc.Coulomb(0.3, mu_static=0.4), pc.Stribeck(0.3, 0.4, 1e-3)])
def test_what_stops_on_a_slope_is_held_by_static_friction(law, tangents):
    """tan of the slope is between both coefficients: at each of these steps it stops, and stays. With sliding friction
    in the step of its stop it went back down from there in one of ten."""
    for share in (0.33, 0.36, 0.39):
        slope = math.atan(share)
        scene, state, up = slider(law, slope, tangents)
        stops = 0.5 / (9.81 * (math.sin(slope) + 0.3 * math.cos(slope)))
        for step in STEPS:
            run = pc.simulate(scene, state, 0.5, method="Moreau", step=step, t_eval=[0.0, 0.3, 0.5])
            assert run.status == 0, run.message
            # what is left of a step's way at its end, and of Stribeck's millimetre per second
            assert run.q[-1] @ up == pytest.approx(stops, abs=1e-5 if isinstance(law, pc.Coulomb) else 1e-3)
            np.testing.assert_allclose(run.q[2], run.q[1], rtol=0.0, atol=1e-12)
            assert run.contacts["c"].mode[-1] == 1


@pytest.mark.parametrize("seed", range(4))
def test_sliding_feet_come_to_rest_where_forces_can_hold_them(seed):
    """A body slides against a push that the feet could hold if the rougher ones carried it, and that the least loads,
    which they have in slip, could not: it comes to rest, and stays, in any order of its feet. Feet opposite each other
    are alike, so it goes straight."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(0.0, 0.5) + np.array([0.0, rng.uniform(1.0, 2.0)])
    half = 0.15 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(2)])
    points, mu = np.vstack([half, -half]), np.tile([rng.uniform(0.5, 0.7), rng.uniform(0.05, 0.2)], 2)
    way = np.array([math.cos(direction := rng.uniform(0.0, 6.0)), math.sin(direction), 0.0])
    # of 1 kg: between the mean and the largest coefficient
    force = 9.81 * (mu.mean() + rng.uniform(0.3, 0.8) * (mu.max() - mu.mean()))
    push = np.concatenate([force * way, np.zeros(3)])
    for order in (np.arange(4), rng.permutation(4)):
        scene = body_on_feet(points[order], mu[order])
        start = np.concatenate([-0.5 * way, np.zeros(3)])
        state = scene.initial_state([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], start)
        given = {"control": lambda t, q, v: push, "t_eval": [0.0, 0.2, 0.4]}
        exact = pc.simulate(scene, state, 0.4, **given)
        assert exact.status == 0 and np.abs(exact.v[1:]).max() < 1e-12, exact.message
        for step in STEPS[::3]:
            run = pc.simulate(scene, state, 0.4, method="Moreau", step=step, **given)
            assert run.status == 0, run.message
            # a part of the way in the step of the stop
            np.testing.assert_allclose(run.q, exact.q, rtol=0.0, atol=2e-5)


@pytest.mark.parametrize("seed", range(6))
def test_redundant_feet_stay_at_rest_on_a_turning_plate(seed):
    """Gaps at a step's midpoint make feet that must not slip contradict each other by 1e-9 m/s where what they stand on
    turns: that needs neither compliance nor slip."""
    rng = np.random.default_rng(seed)
    n, height = int(rng.integers(4, 7)), rng.uniform(0.03, 0.1)
    angles = 2.0 * math.pi * (np.arange(n) / n + rng.uniform(0.0, 0.1, n))
    points = np.column_stack([0.15 * np.cos(angles), 0.15 * np.sin(angles), np.full(n, -height)])
    scene = body_on_feet(points, 1.0)
    plain = pc.Scene(scene.model)
    axes = rng.normal(size=(2, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    motion = pc.HarmonicMotion(0.004 * axes[0], 3.0, rng.uniform(0.0, 6.0), axes[1], 0.015)
    floor = plain.add_contour("floor", pc.Plane(), motion=motion)
    for i, point in enumerate(points):
        foot = plain.add_contour(f"foot {i}", pc.Point(), "base", pin.SE3(np.eye(3), point))
        law = pc.NoSlip() if i % 2 == 0 else pc.Coulomb(0.6)
        plain.add_contact(f"foot {i}", foot, floor, law)
    place = motion.placement(0.0) * pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
    q = np.concatenate([place.translation, pin.Quaternion(place.rotation).coeffs()])
    # carried along
    h = 1e-6
    ahead = motion.placement(h) * pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
    state = plain.initial_state(q, pin.log6(place.actInv(ahead)).vector / h, max_gap=0.1)
    given = {"t_eval": np.linspace(0.0, 0.5, 11)}
    exact = pc.simulate(plain, state, 0.5, **given)
    assert exact.status == 0 and not exact.events, exact.message
    for step in (2e-3, 5e-4):
        run = pc.simulate(plain, state, 0.5, method="Moreau", step=step, **given)
        assert run.status == 0, run.message
        assert not run.events
        assert run.stats["settled"] == run.stats["rigid"] == 0
        # places are put on the constraints
        np.testing.assert_allclose(run.q, exact.q, rtol=0.0, atol=1e-6)
