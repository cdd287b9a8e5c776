"""Redundant contacts in time stepping: what holds, which loads, however the world and the contacts are laid out."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from random_motions import Motion
from scipy.optimize import linprog, nnls
from shared import one_body
from test_dead_centres import random_crank
from test_loads import body_on_feet, normal_problem

import pincontact as pc
from pincontact.friction.choices import Units, chosen_forces, holding_forces
from pincontact.friction.cone import SLIP, STICK

GRAVITY, SIDES = 9.81, 64


def can_hold(points, mu, push):
    """Whether forces inside pyramids of 64 sides within the cones balance the weight of 1 kg and a push (6,)."""
    n = len(points)
    balance = np.vstack([np.tile(np.eye(3), n), np.hstack([pin.skew(p) for p in points])])
    angles = 2.0 * math.pi * np.arange(SIDES) / SIDES
    sides = np.column_stack([np.cos(angles), np.sin(angles), np.full(SIDES, -mu * math.cos(math.pi / SIDES))])
    found = linprog(
        np.zeros(3 * n),
        A_ub=np.kron(np.eye(n), sides),
        b_ub=np.zeros(n * SIDES),
        A_eq=balance,
        b_eq=-push - np.array([0.0, 0.0, -GRAVITY, 0.0, 0.0, 0.0]),
        bounds=(None, None),
    )
    return found.status == 0


def least_friction(points, push):
    """The coefficient from which on feet hold, 1e-3 of it too large at most; None above 1.5."""
    low, high = 0.0, 1.5
    if not can_hold(points, high, push):
        return None
    while high - low > 1e-5:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if can_hold(points, middle, push) else (middle, high)
    return high


@pytest.mark.parametrize("seed", range(3))
def test_feet_slip_only_when_there_is_no_choice(seed):
    """A push jumps to what forces inside the cones can just hold, or just cannot."""
    rng = np.random.default_rng(seed)
    least = None
    while least is None or least < 0.1:
        n, height = int(rng.integers(4, 7)), rng.uniform(0.05, 0.15)
        angles = 2.0 * math.pi * (np.arange(n) / n + rng.uniform(0.0, 0.1, n))
        reach = rng.uniform(0.1, 0.2, n)
        points = np.column_stack([reach * np.cos(angles), reach * np.sin(angles), np.full(n, -height)])
        push = np.array([*rng.normal(size=2) * 3.0, rng.normal(), *(rng.normal(size=2) * 0.2), rng.normal() * 0.5])
        least = least_friction(points, push)

    def control(t, q, v):
        return push * (t > 0.0205)

    for share, holds in ((1.01, True), (0.98, False)):
        scene = body_on_feet(points, share * least)
        state = scene.initial_state([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0])
        for step in (1e-3, 2e-4):
            given = {"method": "Moreau", "step": step, "control": control, "breakpoints": [0.0205]}
            run = pc.simulate(scene, state, 0.1, **given)
            assert run.status == 0, run.message
            # round-off of a hundred steps, or half a per cent of a push for 80 ms
            moved = float(np.abs(run.q[-1] - run.q[0]).max())
            assert (moved < 1e-12) == holds, (share, step, moved)
            assert any(event.kind == "slip" for event in run.events) != holds


def least_loads(points, mu, inertia, v):
    """The least loads that are not negative and keep all gaps closed: least squares with the gaps' weight 1e6."""
    operator, base = normal_problem(points, mu, 1.0, inertia, v)
    inverse = np.linalg.inv(inertia)
    mobilities = [3.0 + np.trace(-pin.skew(p) @ inverse @ pin.skew(p)) for p in points]
    units = np.sqrt(np.array(mobilities) / 3.0 * (1.0 + np.asarray(mu) ** 2))
    return nnls(np.vstack([1e6 * operator, np.diag(units)]), np.append(-1e6 * base, np.zeros(len(points))))[0]


def sliding_feet(rng):
    n, height = int(rng.integers(4, 8)), rng.uniform(0.02, 0.1)
    points = np.column_stack([rng.uniform(-0.2, 0.2, (n, 2)), np.full(n, -height)])
    mu, inertia = rng.uniform(0.05, 0.5, n), 0.02 * np.diag(rng.uniform(0.5, 1.0, 3))
    return points, mu, inertia, np.array([*rng.normal(size=2), 0.0, 0.0, 0.0, rng.normal()])


@pytest.mark.parametrize("seed", [1, 2])
def test_loads_of_sliding_feet(seed):
    """One rule in both kinds of methods, where some of the feet carry nothing, too."""
    rng = np.random.default_rng(seed)
    compared = without = 0
    for _ in range(40):
        points, mu, inertia, v = sliding_feet(rng)
        scene = body_on_feet(points, mu, 1.0, inertia)
        state = scene.initial_state([0, 0, -points[0, 2], 0, 0, 0, 1], v)
        run = pc.simulate(scene, state, 0.0)
        if run.status != 0 or any(run.contacts[c].mode[0] != 2 for c in scene.contacts):
            continue
        stepper = pc.Stepper(scene, state, 1e-7)
        stepper.step(np.zeros(6))
        exact = np.array([run.contacts[c].normal_force[0] for c in scene.contacts])
        stepped = np.array([-stepper.forces[c][2] for c in scene.contacts])
        loads = least_loads(points, mu, inertia, v)
        # what 1e-6 m/s^2 are worth in the weights
        np.testing.assert_allclose(exact, loads, rtol=0.0, atol=1e-4)
        # what forces change by in 1e-7 s
        np.testing.assert_allclose(stepped, exact, rtol=0.0, atol=1e-4)
        compared += 1
        without += bool((exact < 1e-9).any())
    assert compared > 15
    assert without > 3


def units_of_feet(points, mu, inertia, v, step=1e-6):
    """The problem of one short step, everything sliding."""
    n = len(points)
    rows = np.vstack([np.hstack([np.eye(3), -pin.skew(p)]) for p in points])
    factor = np.linalg.cholesky(np.linalg.inv(pin.Inertia(1.0, np.zeros(3), inertia).matrix()))
    directions, gyroscopic = rows @ factor, -np.linalg.solve(inertia, np.cross(v[3:], inertia @ v[3:]))
    rate = np.concatenate([[0.0, 0.0, -GRAVITY], gyroscopic])
    spin = np.concatenate([np.cross(v[3:], np.cross(v[3:], p)) for p in points])
    base = rows @ v + step * (rows @ rate + spin)
    slips = (rows @ v).reshape(n, 3)
    return Units(
        directions @ directions.T,
        base,
        np.asarray(mu),
        np.ones((n, 3), dtype=bool),
        np.arange(n),
        np.zeros(n),
        np.full(n, SLIP),
        np.zeros((n, 3)),
        slips,
    )


def test_chosen_forces():
    """The least loads where all slide; where one foot sticks, forces inside the cones that keep to the equations."""
    rng = np.random.default_rng(0)
    stuck = 0
    for _ in range(40):
        points, mu, inertia, v = sliding_feet(rng)
        units = units_of_feet(points, mu, inertia, v)
        chosen = chosen_forces(units)
        if chosen is not None:
            # as above
            loads = least_loads(points, mu, inertia, v)
            np.testing.assert_allclose(1e6 * chosen[2::3], loads, rtol=0.0, atol=1e-4)
        # turned about the first foot, which sticks
        v = np.concatenate([-np.cross([0.0, 0.0, v[5]], points[0]), [0.0, 0.0, v[5]]])
        units = units_of_feet(points, np.append(5.0, mu[1:]), inertia, v)
        units.modes[0] = STICK
        chosen = chosen_forces(units)
        if chosen is None:
            continue
        u = (units.gram @ chosen + units.base).reshape(-1, 3)
        forces = chosen.reshape(-1, 3)
        # relative to 1e-5 m/s of a step's weight
        assert np.abs(u[0]).max() < 1e-14
        assert np.abs(u[:, 2]).max() < 1e-14
        assert forces[:, 2].min() >= 0.0
        assert (np.hypot(forces[:, 0], forces[:, 1]) <= units.friction * forces[:, 2] * (1.0 + 1e-9)).all()
        stuck += 1
    assert stuck > 10


def test_nothing_holds_where_there_is_no_choice():
    points = np.array([[0.1, 0.0, -0.1], [-0.1, 0.1, -0.1], [-0.1, -0.1, -0.1]])
    units = units_of_feet(points, np.full(3, 0.5), 0.01 * np.eye(3), np.zeros(6))
    units.modes[0] = STICK
    assert holding_forces(units) is None
    assert chosen_forces(units) is None


@pytest.mark.parametrize("seed", range(2))
def test_points_on_curves_in_turned_worlds(seed):
    """The normals of a point on a spatial curve are any two, and nothing depends on which."""
    crank, begin, _, _ = random_crank(seed)
    scene = crank.scene("P-3C")
    motion = Motion.of(scene, scene.initial_state(*crank.place(*begin)), 0.5)
    rng = np.random.default_rng(seed)
    run = pc.simulate(scene, motion.state(), 0.5, method="Moreau", step=1e-3)
    assert run.status == 0, run.message
    for turn in (np.array([0.8, 0.0, 0.0]), rng.normal(size=3), rng.normal(size=3)):
        turned = motion.rebuilt(pin.SE3(pin.exp3(turn), np.zeros(3)))
        other = pc.simulate(turned.scene, turned.state(), 0.5, method="Moreau", step=1e-3)
        assert other.status == 0, other.message
        # round-off of 500 steps, of fixed points that end at 1e-12; with other normals it was 0.1 off
        np.testing.assert_allclose(other.q[-1], run.q[-1], rtol=0.0, atol=1e-8)


def rail(order, mu):
    """A body in a plane whose three points slide on one line, in this order, with friction of their own."""
    model = one_body(pin.JointModelPlanar(), pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), "base")
    model.gravity.linear = np.array([0.0, -GRAVITY, 0.0])
    scene = pc.Scene(model)
    line = scene.add_contour("line", pc.Line())
    for i in order:
        place = pin.SE3(np.eye(3), np.array([[-0.2, 0.05, 0.15][i], -0.1, 0.0]))
        point = scene.add_contour(f"p{i}", pc.Point(), "base", place)
        scene.add_contact(f"p{i}", point, line, pc.Coulomb(mu[i]), bilateral=True, pattern="P-2C")
    return scene


def test_redundant_bilateral_contacts_share_in_any_order():
    """They shared by the order in which they were made."""
    ends = []
    for order in ([0, 1, 2], [2, 0, 1], [1, 2, 0]):
        scene = rail(order, (0.1, 0.2, 0.4))
        state = scene.initial_state([0.0, 0.1, 1.0, 0.0], [2.0, 0.0, 0.0])
        run = pc.simulate(scene, state, 0.3, method="Moreau", step=1e-3)
        assert run.status == 0, run.message
        ends.append(run.q[-1, 0])
    # round-off of 300 steps, of fixed points that end at 1e-12
    np.testing.assert_allclose(ends, ends[0], rtol=0.0, atol=1e-9)


def ball_held_twice(held, pressed):
    """A ball that slides and spins on a floor, which a bilateral and a unilateral contact keep it on at one point."""
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.004 * np.eye(3)), "ball"))
    contours = scene.add_contour("ball", pc.Sphere(0.1), "ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("held", *contours, friction=held, bilateral=True, side=1)
    scene.add_contact("pressed", *contours, friction=pressed, side=1)
    return scene, scene.initial_state([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0], [1.0, 0.2, 0.0, 0.0, 0.0, 3.0])


@pytest.mark.parametrize("step", [1e-3, 1e-4])
@pytest.mark.parametrize("held", [pc.Coulomb(0.3), pc.Coulomb(0.0), pc.NoSlip()], ids=["rough", "smooth", "ideal"])
@pytest.mark.parametrize("pressed", [pc.Coulomb(0.3), pc.Coulomb(0.0)], ids=["rough", "smooth"])
def test_loads_shared_with_bilateral_contacts_are_told(held, pressed, step):
    """What round-off leaves of rows that bilateral contacts have already has no forces; which of both carries the load
    matters where one slides, and where their friction differs."""
    scene, state = ball_held_twice(held, pressed)
    exact = pc.simulate(scene, state, 0.5)
    run = pc.simulate(scene, state, 0.5, method="Moreau", dt=step)
    assert exact.status == run.status == 0
    assert run.stats["energy_gained"] < 1e-12
    assert run.stats["cone_residual"] < 1e-9
    same = math.isinf(held.sliding) or held.sliding == pressed.sliding
    # of second order
    assert (np.abs(run.q[-1] - exact.q[-1]).max() < 2.0 * step**2) == same
    slides = not math.isinf(held.sliding) and max(held.sliding, pressed.sliding) > 0.0
    assert (run.stats["open_loads"] > 0) == ("leave open" in run.message) == slides


def box_and_capsule(seed, beside, law):
    """A start of a box with its centre of mass off its middle that slides on four corners, alone or with a capsule of
    this law at rest 5 m away."""
    rng = np.random.default_rng(seed)
    mass, half, mu = rng.uniform(0.3, 2.0), rng.uniform(0.05, 0.15, 3), rng.uniform(0.1, 0.6)
    body = pin.Inertia.FromBox(mass, *(2.0 * half))
    body.lever = rng.uniform(-0.3, 0.3, 3) * half
    model = one_body(pin.JointModelFreeFlyer(), body, "box")
    turn = rng.uniform(0.0, 6.28)
    q = [0.0, 0.0, half[2], 0.0, 0.0, math.sin(turn / 2), math.cos(turn / 2)]
    v = [*rng.uniform(-0.6, 0.6, 2), 0.0, 0.0, 0.0, rng.uniform(-6.0, 6.0)]
    if beside:
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "second")
        model.appendBodyToJoint(joint, pin.Inertia.FromCapsule(1.0, 0.1, 0.3), pin.SE3.Identity())
        model.addBodyFrame("capsule", joint, pin.SE3.Identity(), 0)
        q, v = [*q, 5.0, 0.0, 0.1, 0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)], [*v, *np.zeros(6)]
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for sign in (1, -1) if beside else ():
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15 * sign]))
        scene.add_contact(f"end {sign}", scene.add_contour(f"end {sign}", pc.Sphere(0.1), "capsule", place), floor, law)
    for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        corner = scene.add_contour(f"{x} {y}", pc.Point(), "box", pin.SE3(np.eye(3), half * [x, y, -1.0]))
        scene.add_contact(f"{x} {y}", corner, floor, friction=pc.Coulomb(mu))
    return scene, scene.initial_state(q, v)


# in time stepping a load at zero is one to the accuracy of its solver, from which the next ones are the nearest
@pytest.mark.parametrize(
    ("options", "apart"), [({"rtol": 1e-9, "atol": 1e-11}, 1e-7), ({"method": "Moreau", "dt": 1e-3}, 2e-2)]
)
@pytest.mark.parametrize("seed", [22, 34, 41, 43, 49])
def test_bodies_elsewhere_do_not_decide_how_loads_are_shared(seed, options, apart):
    """A body that rests leaves the loads of one that slides as they are: they were taken for the central ones of what
    sticks, up to 0.2 m/s off."""
    law = pc.Coulomb(0.8)
    starts = [box_and_capsule(seed, beside, law) for beside in (False, True)]
    runs = [pc.simulate(*start, 0.1, t_eval=[0.02, 0.1], **options) for start in starts]
    assert [run.status for run in runs] == [0, 0]
    if "rtol" in options:
        assert runs[0].message == runs[1].message
    for alone, whole in ((runs[0].q, runs[1].q[:, :7]), (runs[0].v, runs[1].v[:, :6])):
        np.testing.assert_allclose(whole, alone, rtol=0.0, atol=apart)


@pytest.mark.parametrize("seed", [22, 34, 41, 43, 49])
def test_what_resists_turning_elsewhere_leaves_no_loads_open(seed):
    """In time stepping, whose compiled steps note for each group of units whether there is a choice; the first problem
    has no loads yet to tell what slides."""
    law = pc.Coulomb(0.8, rolling=0.01)
    alone, whole = (
        pc.simulate(*box_and_capsule(seed, beside, law), 0.02, method="Moreau", dt=1e-3) for beside in (False, True)
    )
    assert alone.status == whole.status == 0
    assert alone.stats["open_loads"] == 0 and whole.stats["open_loads"] <= 1
    np.testing.assert_allclose(whole.v[:, :6], alone.v, rtol=0.0, atol=2e-2)
