"""Feet at rest under a growing push: they hold until no forces inside their cones do, elliptic ones included."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import linprog
from test_loads import body_on_feet

import pincontact as pc

GRAVITY, SIDES = 9.81, 256


def onset(points, mu, push):
    """First time of a slip under a push that grows from zero to `push` (6,) in a second; infinite without one."""
    scene = body_on_feet(points, [pc.Coulomb(pair, along="floor") for pair in mu])
    state = scene.initial_state([0.0, 0.0, -points[0, 2], 0.0, 0.0, 0.0, 1.0], np.zeros(6))
    run = pc.simulate(scene, state, 1.0, control=lambda t, q, v: t * push)
    assert run.status == 0, run.message
    return next((event.time for event in run.events), math.inf)


def longest_hold(points, mu, push):
    """The largest part of the push that forces in polygons of 256 sides within the ellipses balance, with 1 kg."""
    n = len(points)
    balance = np.vstack([np.tile(np.eye(3), n), np.hstack([np.cross(p, np.eye(3)).T for p in points])])
    angles = 2.0 * math.pi * np.arange(SIDES) / SIDES
    cones = [np.column_stack([np.cos(angles) / a, np.sin(angles) / b, np.full(SIDES, -1.0)]) for a, b in mu]
    sides = np.zeros((n * SIDES, 3 * n + 1))
    for i, cone in enumerate(cones):
        sides[i * SIDES : (i + 1) * SIDES, 3 * i : 3 * i + 3] = cone
    found = linprog(
        np.append(np.zeros(3 * n), -1.0),
        A_ub=sides,
        b_ub=np.zeros(n * SIDES),
        A_eq=np.column_stack([balance, push]),
        b_eq=[0.0, 0.0, GRAVITY, 0.0, 0.0, 0.0],
        bounds=[(None, None)] * (3 * n) + [(0.0, None)],
    )
    assert found.status == 0
    return -float(found.fun)


@pytest.mark.parametrize("count", [3, 4, 5])
@pytest.mark.parametrize("mu", [(0.7, 0.2), (0.2, 0.7)])
@pytest.mark.parametrize("angle", [0.0, 40.0, 90.0])
def test_pushed_at_the_centre_of_mass(count, mu, angle):
    """Loads differ, by tipping, and so do the least forces from those that hold longest: all feet slide at once."""
    angles = 0.3 + 2.0 * math.pi * np.arange(count) / count
    points = np.column_stack([0.15 * np.cos(angles), 0.15 * np.sin(angles), np.full(count, -0.05)])
    direction = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    limit = GRAVITY / np.linalg.norm(direction / mu)
    push = np.append(1.1 * limit * direction, np.zeros(4))
    # each choice of forces leaves about the square of what the last one left of the way: the last is some 1e-8
    assert onset(points, [mu] * count, push) == pytest.approx(1.0 / 1.1, abs=1e-7)


@pytest.mark.parametrize("seed", [0, 1, 4, 10, 13, 59, 67])
def test_pushed_anyhow(seed):
    """Feet of different friction in two directions, under a force and a torque."""
    rng = np.random.default_rng(seed)
    count, height = int(rng.integers(3, 6)), rng.uniform(0.03, 0.1)
    angles = 2.0 * math.pi * (np.arange(count) / count + rng.uniform(0.0, 0.1, count))
    reach = rng.uniform(0.1, 0.2, count)
    points = np.column_stack([reach * np.cos(angles), reach * np.sin(angles), np.full(count, -height)])
    mu = rng.uniform(0.1, 0.6, (count, 2)).tolist()
    push = np.array([*rng.normal(size=2), 0.0, *(0.05 * rng.normal(size=2)), 0.3 * rng.normal()])
    part = longest_hold(points, mu, push)
    # polygons of 256 sides, inscribed, are 8e-5 smaller
    assert onset(points, mu, 1.1 * part * push) == pytest.approx(1.0 / 1.1, rel=1.5e-4)


@pytest.mark.parametrize("friction", [pc.Coulomb(0.7), pc.Coulomb(1.0), pc.NoSlip()], ids=str)
@pytest.mark.parametrize("seed", range(5))
def test_a_foot_tips_over_an_edge(seed, friction):
    """As the zero-moment point comes to an edge of the foot, both corners beyond it lose their loads at once, in any
    order: what others could carry there, forces inside their cones or none, is at the edge of them all."""
    rng = np.random.default_rng(seed)
    ends, height = rng.uniform(0.04, 0.15, (2, 2)), rng.uniform(0.3, 0.6)
    corners = [(x, y, -height) for x in (ends[0, 0], -ends[0, 1]) for y in (ends[1, 0], -ends[1, 1])]
    points = np.array([corners[i] for i in rng.permutation(4)])
    angle = rng.uniform(0.0, 2.0 * math.pi)
    push = np.array([math.cos(angle), math.sin(angle)])
    ways = [ends[k, 0] / push[k] if push[k] > 0.0 else -ends[k, 1] / push[k] for k in range(2)]
    tips = min(ways) / height * GRAVITY
    scene = body_on_feet(points, [friction] * 4)
    state = scene.initial_state([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0], np.zeros(6))

    def control(t, q, v):
        return np.r_[pin.Quaternion(q[3:7]).matrix()[:2].T @ push * (10.0 * t), np.zeros(3)]

    duration = 0.1 * tips + 0.1
    run = pc.simulate(scene, state, duration, control=control)
    assert run.status == 0, run.message
    first = {event.contact: event.time for event in run.events if event.kind == "separate"}
    assert len(first) == 2
    # loads are known to be zero to 1e-8 of the largest, and fall for a second
    np.testing.assert_allclose([*first.values()], 0.1 * tips, rtol=1e-6)
    stepped = pc.simulate(scene, state, duration, control=control, method="Moreau", step=2e-4)
    # it turns by some 0.1 rad, and begins to up to a step late
    assert np.abs(run.q[-1] - stepped.q[-1]).max() < 1e-4


@pytest.mark.parametrize("seed", [3, 18, 19, 24, 32])
def test_feet_begin_to_slide_alike_in_any_order(seed):
    """Redundant feet that begin to slide together have the least loads from then on, whatever held them before, and
    whatever loads the solution of the cone problem had."""
    rng = np.random.default_rng(seed)
    count, height, mu = int(rng.integers(4, 7)), rng.uniform(0.1, 0.3), rng.uniform(0.3, 0.6)
    angles = np.sort(rng.uniform(0.0, 2.0 * math.pi, count))
    points = np.column_stack([0.2 * np.cos(angles), 0.15 * np.sin(angles), np.full(count, -height)])
    push, torque = rng.normal(size=3) * [1.0, 1.0, 0.3], rng.normal(size=3)
    force, torque = 12.0 * push / np.linalg.norm(push), 0.6 * torque
    inertia = np.diag(rng.uniform(0.015, 0.05, 3))

    def control(t, q, v):
        turned = pin.Quaternion(q[3:7]).matrix().T
        return t * np.r_[turned @ force, turned @ torque]

    runs = []
    for order in (points, points[::-1]):
        scene = body_on_feet(order, mu, inertia=inertia)
        state = scene.initial_state([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0], np.zeros(6))
        runs.append(pc.simulate(scene, state, 0.8, control=control))
        assert runs[-1].status == 0, runs[-1].message
        assert runs[-1].stats["open_loads"] == 0
    # to the default tolerances
    np.testing.assert_allclose(runs[0].q[-1], runs[1].q[-1], atol=1e-8)
    stepped = pc.simulate(scene, state, 0.8, control=control, method="Moreau", step=5e-4)
    # it slides at up to 1 m/s, and begins up to a step late
    assert np.abs(stepped.q[-1] - runs[1].q[-1]).max() < 7e-4
