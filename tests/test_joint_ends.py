"""Joints at their ends: the lower and the upper one are one thing, seen in a mirror; contacts that close there."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from shared import one_body

import pincontact as pc

JOINTS, DURATION = 6, 0.5


def _falling_chain(seed: int, mirrored: bool) -> pc.Trajectory:
    """A hanging chain of hinges between stops, thrown at random.

    In the mirror each hinge turns about the opposite axis: its coordinate changes its sign, its ends their places.
    """
    rng = np.random.default_rng(seed)
    sign = -1.0 if mirrored else 1.0
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for k in range(JOINTS):
        hinge = pin.JointModelRevoluteUnaligned(np.array([0.0, sign, 0.0]))
        parent = model.addJoint(parent, hinge, place, f"hinge {k}")
        lever = np.array([rng.uniform(-0.03, 0.03), 0.0, -rng.uniform(0.05, 0.3)])
        body = pin.Inertia(rng.uniform(0.1, 2.0), lever, rng.uniform(1e-4, 1e-3) * np.eye(3))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.25]))
    ends = np.sort(sign * np.array([-rng.uniform(0.0, 0.05, JOINTS), rng.uniform(0.0, 0.05, JOINTS)]), axis=0)
    model.lowerPositionLimit, model.upperPositionLimit = ends
    friction = rng.uniform(0.0, 0.01, JOINTS) * rng.integers(0, 2, JOINTS)
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = -friction, friction
    scene = pc.Scene(model)
    state = scene.initial_state(np.zeros(JOINTS), sign * rng.normal(size=JOINTS))
    run: pc.Trajectory = pc.simulate(scene, state, DURATION)
    return run


@pytest.mark.parametrize("seed", range(12))
def test_mirrored_chain_moves_alike(seed):
    run, mirrored = _falling_chain(seed, False), _falling_chain(seed, True)
    assert run.status == mirrored.status == 0, (run.message, mirrored.message)
    told = [(event.joint, event.kind) for event in run.events]
    assert len(told) >= 8
    assert told == [(event.joint, event.kind) for event in mirrored.events]
    # round-off, which impacts amplify
    np.testing.assert_allclose(run.q[-1], -mirrored.q[-1], atol=1e-7)


@pytest.mark.parametrize("options", [{}, {"method": "RK45"}, {"method": "Moreau", "step": 1e-4}])
@pytest.mark.parametrize("shift", [-1e-15, 0.0, 1e-15])
def test_contact_that_rebounds_where_a_joint_ends(shift, options):
    """A ball on a vertical slider whose lower end is where it touches the floor: both strike at once, and the ball
    leaves with e times its speed, whichever comes first by rounding."""
    radius, restitution, height = 0.1, 0.5, 0.05
    model = one_body(pin.JointModelPZ(), pin.Inertia.FromSphere(1.0, radius), "ball")
    model.lowerPositionLimit, model.upperPositionLimit = np.array([radius + shift]), np.array([1.0])
    scene = pc.Scene(model)
    floor, ball = scene.add_contour("floor", pc.Plane()), scene.add_contour("ball", pc.Sphere(radius), "ball")
    scene.add_contact("c", ball, floor, restitution=restitution)
    fall = math.sqrt(2.0 * height / 9.81)
    state = scene.initial_state([radius + height], [0.0], free=["c"])
    run = pc.simulate(scene, state, fall * (1.0 + restitution), **options)
    assert run.status == 0, run.message
    # the top of the hop; impacts of time stepping are known to their step, over which the ball goes 1e-4 m
    assert run.q[-1, 0] == pytest.approx(radius + restitution**2 * height, abs=1.5e-4 if "step" in options else 1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_what_touches_takes_part_where_a_joint_strikes(seed):
    """Two sliders fly one behind the other, as near as gaps are told from zero, and the first strikes its end: the same
    impact as on a wall there, also where their contact may rebound."""
    rng = np.random.default_rng(seed)
    masses, restitution, radius = rng.uniform(0.5, 2.0, 2), rng.choice([0.0, 0.7]), 0.05
    gap, apart = rng.choice([0.0, 1e-17, 1e-13]), 2.0 * radius
    after = []
    for on_a_wall in (False, True):
        model = pin.Model()
        model.gravity = pin.Motion.Zero()
        for name, mass in zip("ab", masses):
            joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), name)
            model.appendBodyToJoint(joint, pin.Inertia.FromSphere(mass, radius), pin.SE3.Identity())
        model.upperPositionLimit = np.array([10.0, 10.0 if on_a_wall else 0.3])
        scene = pc.Scene(model)
        balls = [scene.add_contour(name, pc.Sphere(radius), frame=name) for name in "ab"]
        scene.add_contact("between", *balls, restitution=restitution)
        if on_a_wall:
            facing = pin.SE3(pin.utils.rotate("y", -0.5 * np.pi), np.array([0.3 + radius, 0.0, 0.0]))
            scene.add_contact("wall", balls[1], scene.add_contour("wall", pc.Plane(), placement=facing))
        state = scene.initial_state([0.0, apart + gap], [1.0, 1.0], free=list(scene.contacts))
        run = pc.simulate(scene, state, 0.3)
        assert run.status == 0, run.message
        after.append(run.v[-1])
    np.testing.assert_allclose(after[0], after[1], atol=1e-12)
    np.testing.assert_allclose(after[0], 0.0, atol=1e-12)


# what happens to a hinge with these ends, dry friction, start and torque
SWINGS = {
    "strikes": ((-0.3, 0.5), 0.01, (0.4, 2.0), 0.0),
    "swings to rest": ((-1.5, 1.5), 0.3, (1.0, 0.0), 0.0),
    "strikes and comes to rest": ((-0.2, 0.5), 0.3, (0.4, 2.0), 0.0),
    "is driven to and fro": ((-1.5, 1.5), 0.3, (0.0, 0.0), 1.0),
    "is pressed to an end": ((0.0, 1.0), 0.0, (0.0, 0.0), 1.0),
    "begins with a strike": ((0.0, 1.0), 0.2, (0.0, -1.0), 1.0),
}


def _swing(ends: tuple[float, float], friction: float, torque: float, start: tuple[float, float], **options) -> list:
    """Kinds and times of the events of a hanging hinge, under torque sin 5 t."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(1, pin.Inertia(1.0, np.array([0.0, 0.0, -0.25]), 0.02 * np.eye(3)), pin.SE3.Identity())
    (model.lowerPositionLimit[0], model.upperPositionLimit[0]) = ends
    model.lowerDryFrictionLimit[0], model.upperDryFrictionLimit[0] = -friction, friction
    scene, (q, v) = pc.Scene(model), start
    run = pc.simulate(
        scene, scene.initial_state([q], [v]), 3.0, control=lambda t, q, v: torque * np.sin([5.0 * t]), **options
    )
    assert run.status == 0 and all(event.joint == "hinge" and event.contact is None for event in run.events)
    return [(event.kind, event.time) for event in run.events]


@pytest.mark.parametrize("name", SWINGS)
def test_events_of_joints_in_steps(name):
    """Time stepping tells of the ends and the dry friction of joints what the exact run does, a step later."""
    ends, friction, start, torque = SWINGS[name]
    exact, h = _swing(ends, friction, torque, start), 1e-3
    assert len(exact) >= 2
    for options in ({}, {"events": lambda t, q, v: 1.0}, {"breakpoints": [0.7, 1.0]}):
        found = _swing(ends, friction, torque, start, method="Moreau", dt=h, **options)
        # what sets off at the start does so in the first step; a slip that turns back may rest in between
        begun = found[0] == ("slip", pytest.approx(h))
        rests = [a for a, b in pairwise(found) if (a[0], b[0]) == ("stick", "slip") and b[1] - a[1] < 2.0 * h]
        found = [event for event in found[1 if begun else 0 :] if event not in rests]
        assert [kind for kind, _ in found] == [kind for kind, _ in exact]
        # the end of the step, what it is let go in the next one; errors of first order add some steps in 3 s
        late = [time - when for (_, time), (_, when) in zip(found, exact)]
        assert -h < min(late) and max(late) < 3.0 * h
        # within the step: as exact as the motion
        assert all(abs(after) < h for (kind, _), after in zip(exact, late) if kind == "limit")


def hand_in_flight(rng):
    """A body of 10 to 60 kg with chains of light links, all of whose joints are at an end of their ways."""
    model = pin.Model()
    body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    weight = pin.Inertia(rng.uniform(10.0, 60.0), 0.1 * rng.normal(size=3), np.diag(rng.uniform(1.0, 3.0, 3)))
    model.appendBodyToJoint(body, weight, pin.SE3.Identity())
    for chain in range(4):
        parent = body
        for k in range(4):
            place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(0.02, 0.2, 3) * 0.5**k)
            low, open_ = float(rng.choice([-1.0, 0.0])), rng.uniform(0.2, 1.0)
            ends = np.array([9.0]), np.array([9.0]), np.array([low]), np.array([low + open_])
            axis = rng.normal(size=3)
            joint = pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis))
            parent = model.addJoint(parent, joint, place, f"{chain}{k}", *ends)
            moments = np.diag(rng.uniform(0.5, 1.0, 3)) * 10.0 ** rng.uniform(-7, -4)
            link = pin.Inertia(10.0 ** rng.uniform(-2, -1), 0.01 * rng.normal(size=3), moments)
            model.appendBodyToJoint(parent, link, pin.SE3.Identity())
    at_ends = np.where(rng.random(16) < 0.5, model.lowerPositionLimit[7:], model.upperPositionLimit[7:])
    return pc.Scene(model), np.r_[0.0, 0.0, 5.0, pin.Quaternion(pin.exp3(rng.normal(size=3))).coeffs(), at_ends]


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_nothing_presses_joints_onto_their_ends_in_flight(method):
    """Their forces are round-off, whose sign let joints go and stopped them hundreds of times."""
    rng = np.random.default_rng(6)
    for _ in range(5):
        scene, q = hand_in_flight(rng)
        v = np.r_[rng.normal(size=3), np.zeros(19)]
        run = pc.simulate(scene, scene.initial_state(q, v), 0.5, method=method)
        assert run.status == 0 and not run.events, run.message
        np.testing.assert_allclose(run.q[-1, 7:], q[7:], atol=1e-12)


def test_a_small_torque_lets_a_joint_go_in_flight():
    """A torque that grows through zero at 0.1 s lets a link go, though it never accelerates it by more than
    2e-6 rad/s^2."""
    rng = np.random.default_rng(8)
    scene, q = hand_in_flight(rng)
    model = scene.model
    k = model.nv - 1
    moved = float(np.diag(pin.crba(model, model.createData(), q))[k])
    away = 1.0 if q[k + 1] == model.lowerPositionLimit[k + 1] else -1.0

    def control(t, q, v):
        torque = np.zeros(model.nv)
        torque[k] = away * 1e-5 * moved * (t - 0.1)
        return torque

    run = pc.simulate(scene, scene.initial_state(q), 0.3, control=control)
    assert run.status == 0, run.message
    # it lets others go by what it takes along; what counts as zero is 1e-14 of what moves the whole robot
    released = [event.time for event in run.events if (event.joint, event.kind) == ("33", "release")]
    assert released[0] == pytest.approx(0.1, abs=1e-3)
