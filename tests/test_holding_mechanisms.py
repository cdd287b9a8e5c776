"""Contacts of mechanisms that have fewer coordinates than the contact has directions: they hold by forces that no
motion feels, as far as there are such forces inside the cone."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq

import pincontact as pc

STEP = 2e-4


def random_rotation(rng):
    return pin.Quaternion(rng.normal(size=4)).normalized().matrix()


def arm_model(rng, links):
    """A random arm with a frame "tip", and q."""
    model = pin.Model()
    parent, place = 0, pin.SE3.Identity()
    for k in range(links):
        axis = rng.normal(size=3)
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis)), place, f"j{k}")
        model.appendBodyToJoint(
            parent, pin.Inertia(1.0, rng.normal(size=3) * 0.1, np.diag(rng.uniform(0.005, 0.01, 3))), pin.SE3.Identity()
        )
        place = pin.SE3(random_rotation(rng), rng.normal(size=3) * 0.3)
    model.addFrame(pin.Frame("tip", parent, 0, pin.SE3(np.eye(3), rng.normal(size=3) * 0.3), pin.FrameType.OP_FRAME))
    return model, rng.uniform(-1.0, 1.0, links)


def tip_of(model, q):
    """Place (3,) of the tip, and its Jacobian (6, nv) in world axes."""
    data = model.createData()
    jacobian = pin.computeFrameJacobian(model, data, q, model.getFrameId("tip"), pin.LOCAL_WORLD_ALIGNED)
    pin.updateFramePlacements(model, data)
    return data.oMf[model.getFrameId("tip")].translation, jacobian


def arm(rng, mu):
    """A random two-link arm whose tip stays on a random plane through it: it moves in one direction only."""
    model, q = arm_model(rng, 2)
    tip, jacobian = tip_of(model, q)
    turned = random_rotation(rng)
    scene = pc.Scene(model)
    point = scene.add_contour("tip", pc.Point(), "tip")
    plane = scene.add_contour("plane", pc.Plane(), placement=pin.SE3(turned, tip))
    scene.add_contact("tip", point, plane, friction=pc.Coulomb(mu), bilateral=True)
    return scene, q, turned.T @ jacobian[:3]


def least_coefficient(scene, q, rows):
    """The least of tangential over normal force among those that hold the arm: F + z null, z whatever."""
    weight = pin.computeGeneralizedGravity(scene.model, scene.model.createData(), q)
    force, null = np.linalg.lstsq(rows.T, weight, rcond=None)[0], np.linalg.svd(rows.T)[2][2]
    # the projective line of (force, null): all its directions, those of no `force` but in the limit
    angles = np.linspace(-0.5, 0.5, 200_001)[1:-1] * math.pi
    all_forces = force + np.tan(angles)[:, None] * np.linalg.norm(force) * null
    return float((np.linalg.norm(all_forces[:, :2], axis=1) / np.abs(all_forces[:, 2])).min())


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("seed", range(4))
def test_rests_where_forces_inside_the_cone_hold(seed, method):
    """With 5 % more than the least coefficient it rests, with 5 % less it slips."""
    for part in (1.05, 0.95):
        rng = np.random.default_rng(seed)
        scene, q, rows = arm(rng, 1.0)
        mu = part * least_coefficient(scene, q, rows)
        scene, _, _ = arm(np.random.default_rng(seed), mu)
        run = pc.simulate(scene, scene.initial_state(q), 0.01, method=method, dt=STEP if method == "Moreau" else None)
        assert run.status == 0, run.message
        moved = float(np.abs(run.q[-1] - q).max())
        assert (moved < 1e-9) if part > 1.0 else (moved > 1e-7), moved


@pytest.mark.parametrize("seed", range(5))
def test_what_slips_goes_on_though_it_might_jam(seed):
    """With friction that feeds on its own load there may also be forces that stop it at once, in steps of any size: the
    fixed point of the load leads away from those with which it slips."""
    scene, q, rows = arm(np.random.default_rng(seed), 1.0)
    scene, _, _ = arm(np.random.default_rng(seed), 0.95 * least_coefficient(scene, q, rows))
    state = scene.initial_state(q)
    for step in (1e-3, 1e-6):
        run = pc.simulate(scene, state, 10.0 * step, method="Moreau", dt=step)
        exact = pc.simulate(scene, state, 10.0 * step)
        assert run.status == exact.status == 0, (run.message, exact.message)
        # the second order of 10 steps of 1 ms
        assert np.abs(run.v[-1] - exact.v[-1]).max() < 1e-3 * np.abs(exact.v[-1]).max()


@pytest.mark.parametrize("seed", range(4))
def test_comes_to_rest_and_stays(seed):
    """It slides, stops, and holds by other forces than those of its slip; time stepping is off by what is covered in
    one step."""
    rng = np.random.default_rng(100 + seed)
    scene, q, rows = arm(rng, 1.0)
    scene, _, _ = arm(np.random.default_rng(100 + seed), 1.5 * least_coefficient(scene, q, rows))
    along = np.array([-rows[2, 1], rows[2, 0]])
    state = scene.initial_state(q, 0.02 * along / np.linalg.norm(along))
    exact = pc.simulate(scene, state, 0.1)
    assert exact.status == 0
    stopped = [event.time for event in exact.events if event.kind == "stick"]
    run = pc.simulate(scene, state, 0.1, method="Moreau", dt=STEP)
    assert run.status == 0, run.message
    if len(stopped) == len(exact.events) == 1 and stopped[0] < 0.09:
        assert np.abs(run.v[-1]).max() < 1e-12
        assert np.abs(run.q[-1] - exact.q[-1]).max() < 0.02 * STEP


RADIUS = 0.02


def striker(seed, length):
    """A random three-link arm whose tip, a ball that rolls ideally and resists rolling, strikes a plane in 0.1 ms:
    scene, start, rows (5, 3) of contact and rolling, whose forces are five for three coordinates, and what would stop
    it, (3,)."""
    rng = np.random.default_rng(seed)
    model, q = arm_model(rng, 3)
    model.gravity.linear = np.zeros(3)
    tip, jacobian = tip_of(model, q)
    turned = random_rotation(rng)
    foot = -RADIUS * turned[:, 2]
    rows = turned.T @ (jacobian[:3] - pin.skew(foot) @ jacobian[3:])
    v = rng.normal(size=3)
    v *= -0.3 / (rows[2] @ v)
    scene = pc.Scene(model)
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), "tip")
    plane = scene.add_contour("plane", pc.Plane(), placement=pin.SE3(turned, tip + foot))
    scene.add_contact("c", ball, plane, friction=pc.NoSlip(rolling=length))
    momentum = pin.computeMinverse(model, model.createData(), q)
    momentum = np.linalg.solve(np.triu(momentum) + np.triu(momentum, 1).T, -v)
    return (
        scene,
        scene.initial_state(q - 1e-4 * v, v, free=["c"]),
        np.vstack([rows, turned.T[:2] @ jacobian[3:]]),
        momentum,
    )


def least_length(rows, momentum):
    """The least of the torque against rolling over the normal force, among the impulses that stop the arm."""
    force, null = np.linalg.lstsq(rows.T, momentum, rcond=None)[0], np.linalg.svd(rows.T)[2][3:]
    size, least = np.linalg.norm(force), math.inf
    distances = size * np.tan(np.linspace(0.0, 0.5 * math.pi, 2001)[:-1])
    for turn in np.linspace(0.0, 2.0 * math.pi, 721):
        forces = force + distances[:, None] * (math.cos(turn) * null[0] + math.sin(turn) * null[1])
        pressed = forces[forces[:, 2] > 0.0]
        ratios = np.linalg.norm(pressed[:, 3:], axis=1) / pressed[:, 2]
        least = min(least, float(ratios.min(initial=math.inf)))
    return least


@pytest.mark.parametrize("seed", [0, 13, 24, 41])
def test_ideal_rolling_that_strikes_does_not_slip_where_it_can_be_held(seed):
    """Resistance to rolling wedges it: with 10 % more than the least length the arm stops, with 10 % less it slips."""
    least = least_length(*striker(seed, 1.0)[2:])
    for part, options in product((1.1, 0.9), ({"method": "Moreau", "dt": STEP}, {"method": "DOP853"})):
        scene, state, _, _ = striker(seed, part * least)
        run = pc.simulate(scene, state, 2e-3, **options)
        assert run.status == 0, run.message
        moves = float(np.abs(run.v[-1]).max())
        assert (moves < 1e-12) if part > 1.0 else (moves > 1e-3), moves


def slip_by_friction_alone(rows, inverse, v):
    """Velocities after an impact without a load: T against the slip that is left, as large as it takes that the gap
    stays closed. rows (3, nv): t1, t2, n."""
    gram, before = rows @ inverse @ rows.T, rows @ v

    def pull(share):
        return -np.linalg.solve(gram[:2, :2] + math.exp(share) * np.eye(2), before[:2])

    found = brentq(lambda share: gram[2, :2] @ pull(share) + before[2], -20.0, 20.0, xtol=1e-13)
    return v + inverse @ rows[:2].T @ pull(found)


@pytest.mark.parametrize("seed", [24, 38, 43, 53, 68, 79])
def test_what_strikes_and_cannot_be_held_is_held_up_by_friction_alone(seed):
    """With a length a little too short; no impulses were found, as the large friction of ideal rolling had a load, and
    the load a torque."""
    scene, state, _, _ = striker(seed, 0.9 * least_length(*striker(seed, 1.0)[2:]))
    run = pc.simulate(scene, state, 1.01e-4)
    assert run.status == 0, run.message
    (touch,) = [event for event in run.events if event.kind == "touch"]
    turned = scene.contours["plane"].placement.rotation
    jacobian = tip_of(scene.model, touch.q)[1]
    rows = turned.T @ (jacobian[:3] + RADIUS * pin.skew(turned[:, 2]) @ jacobian[3:])
    inverse = pin.computeMinverse(scene.model, scene.model.createData(), touch.q)
    v = slip_by_friction_alone(rows, np.triu(inverse) + np.triu(inverse, 1).T, touch.v)
    after = run.v[np.searchsorted(run.t, touch.time)]
    # round-off times the condition number of a contact's mobility
    np.testing.assert_allclose(after, v, rtol=0.0, atol=1e-8 * np.abs(v).max())


@pytest.mark.parametrize("seed", [39, 43, 53, 68, 70])
def test_what_is_held_comes_to_rest_for_good(seed):
    """What is left of its velocity falls by 1e-15 in every step, to numbers whose squares are zero: for these no
    forces were found."""
    scene, state, _, _ = striker(seed, 1.1 * least_length(*striker(seed, 1.0)[2:]))
    run = pc.simulate(scene, state, 1.3e-4, method="Moreau", dt=1e-6)
    assert run.status == 0, run.message
    assert not run.v[-1].any()


@pytest.mark.parametrize("law", [pc.NoSlip(), pc.Coulomb(1e4)], ids=["ideal", "rough"])
def test_what_rails_let_friction_press_is_held(law):
    """A mass on rails in a plane is drawn up and along, from another plane that leans out of that: forces across the
    rails, which move nothing, press it on. With loads of nothing beside friction none of these were found."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        lean, along, up = rng.uniform(0.05, 1.0), rng.uniform(-5.0, 5.0), rng.uniform(0.0, 25.0)
        model = pin.Model()
        joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
        joint = model.addJoint(joint, pin.JointModelPZ(), pin.SE3.Identity(), "z")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame("mass", joint, pin.SE3.Identity(), 0)
        scene = pc.Scene(model)
        place = pin.SE3(pin.utils.rotate("x", lean), np.zeros(3))
        plane = scene.add_contour("plane", pc.Plane(), placement=place)
        scene.add_contact("c", scene.add_contour("point", pc.Point(), "mass"), plane, friction=law)

        def control(t, q, v, along=along, up=up):
            return t * np.array([along, up])

        run = pc.simulate(scene, scene.initial_state([0.0, 0.0]), 1.0, control=control)
        assert run.status == 0 and not run.events, (seed, run.message)
        assert np.abs(run.q).max() < 1e-12
        assert run.contacts["c"].normal_force.min() >= 0.0
