"""Contact problems with several solutions: a run takes the same one in all methods and orders of contacts."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from differential import Runs, check
from random_motions import random_motion
from shared import one_body

import pincontact as pc
from pincontact.friction.solve import OPEN, STICK, ContactSolver

METHODS = ({}, {"method": "Moreau", "step": 1e-3}, {"method": "Moreau", "step": 1e-4})
# The point of the hinged bar is this far below and beside its hinge.
BELOW, BESIDE = 0.4, 0.1


def hinged_bar(mu):
    """A bar on a hinge whose end touches the ground; with mu > BESIDE / BELOW it jams itself, whatever lifts it."""
    scene = pc.Scene(one_body(pin.JointModelRY(), pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), "bar"))
    end = pin.SE3(np.eye(3), np.array([BESIDE, 0.0, -BELOW]))
    ground = scene.add_contour("ground", pc.Plane(), placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, -BELOW])))
    point = scene.add_contour("end", pc.Point(), "bar", placement=end)
    scene.add_contact("c", point, ground, pc.Coulomb(mu))
    return scene


@pytest.mark.parametrize("options", METHODS)
@pytest.mark.parametrize("mu", [0.9 * BESIDE / BELOW, 1.1 * BESIDE / BELOW])
def test_what_rests_stays_where_forces_can_hold_it(mu, options):
    """A torque lifts the end: it opens, or friction jams it: N (mu BELOW - BESIDE) = torque has a solution N > 0.
    That of leaving the ground is there in both."""
    scene = hinged_bar(mu)
    # a turn about y moves the end, which is beside the hinge, down
    run = pc.simulate(
        scene, scene.initial_state([0.0], [0.0]), 0.2, control=lambda t, q, v: np.array([-0.5]), **options
    )
    assert run.status == 0, run.message
    if mu * BELOW > BESIDE:
        np.testing.assert_allclose(run.q, 0.0, rtol=0.0, atol=1e-12)
        assert run.contacts["c"].mode[-1] == 1
    else:
        # t^2 torque / (2 I), to first order of a step
        assert run.q[-1, 0] == pytest.approx(-0.5 * 0.5 / 0.1 * 0.2**2, abs=2.5 * options.get("step", 1e-9))
        assert run.contacts["c"].mode[-1] == -1


@pytest.mark.parametrize(
    "seed",
    [
        31043,  # a box that strikes with ideal rolling corners
        55252,  # a chain that jams as it strikes
        55828,  # a chain at rest between two surfaces, which could open
        91852,  # ideal rolling beside a joint in dry friction, which could open from the first step on
    ],
)
def test_all_methods_take_the_same(seed):
    """In turned worlds and other orders of contacts, event-driven and by time stepping."""
    finding = check(seed)
    assert not finding.wrong and min(finding.statuses.values()) == 0, finding


@pytest.mark.parametrize("seed", [91852, 90040])
def test_runs_know_no_earlier_runs(seed):
    """The solver's tables are kept for the scene's next run, not what they held."""
    motion = random_motion(seed)[1]
    fresh, stepped = Runs(motion), {"method": "Moreau", "step": 1e-3, "max_steps": 1000}
    first = fresh.run(**stepped)
    other = motion.rebuilt(gravity=0.3)
    pc.simulate(motion.scene, replace(motion, v=-2.0 * motion.v).state(), 0.05, **stepped | {"max_steps": 50})
    fresh.run(motion=other, **stepped)
    again = fresh.run(**stepped)
    np.testing.assert_array_equal(first.q, again.q)
    np.testing.assert_array_equal(first.v, again.v)


def sticks_or_opens(rng, n):
    """Contacts that do not feel each other, of which each can stick under F = -G^-1 b, in its cone, or open."""
    one, b = np.array([[1.0, 0.0, -0.9], [0.0, 1.0, 0.0], [-0.9, 0.0, 1.0]]), np.array([-1.0, 0.0, 0.1])
    matrix = np.zeros((3 * n, 3 * n))
    for i, size in enumerate(rng.uniform(0.2, 5.0, n)):
        matrix[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = size * one
    return matrix, np.tile(b, n), np.full(n, 2.0)


@pytest.mark.parametrize("n", [2, 3])
def test_a_solution_found_afresh_knows_no_past(n):
    """From the last modes there is one solution for each of these; afresh all stick."""
    problem = sticks_or_opens(np.random.default_rng(n), n)
    for past in itertools.product((OPEN, STICK), repeat=n):
        solver = ContactSolver(nearest=False)
        solver.warm_start(np.array(past), np.zeros(3 * n), np.zeros(3 * n))
        assert solver.solve(*problem) and solver.modes.tolist() == list(past)
        assert solver.solve(*problem, afresh=True) and solver.modes.tolist() == [STICK] * n
        np.testing.assert_allclose(solver.velocities, 0.0, rtol=0.0, atol=1e-14)


def test_what_others_throw_off_is_announced():
    """A joint strikes its stop, and later a contact strikes: each time the impact lifts the other contact."""
    run = Runs(random_motion(50212)[1]).run()
    happened = [(event.kind, event.contact) for event in run.events if 0.0 < event.time < 0.05]
    assert happened == [("limit", None), ("separate", "c0"), ("touch", "c1"), ("touch", "c0"), ("separate", "c1")]


def ball_in_groove(seed, friction):
    """A ball starts from rest on one flank of a groove, and rolls down until it touches the other one."""
    rng = np.random.default_rng(seed)
    radius, (left, right) = rng.uniform(0.05, 0.2), rng.uniform(0.3, 1.2, 2)
    inertia = pin.Inertia(1.0, np.zeros(3), rng.uniform(0.2, 0.6) * radius**2 * np.eye(3))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia, "ball"))
    ball = scene.add_contour("ball", pc.Sphere(radius), "ball")
    for name, tilt in (("left", left), ("right", -right)):
        plane = scene.add_contour(name, pc.Plane(), placement=pin.SE3(pin.utils.rotate("y", tilt), np.zeros(3)))
        scene.add_contact(name, ball, plane, friction)
    up, down = np.array([math.sin(left), 0.0, math.cos(left)]), np.array([math.cos(left), 0.0, -math.sin(left)])
    other = np.array([-math.sin(right), 0.0, math.cos(right)])
    # 5 cm from the other flank
    centre = radius * up + (radius + 0.05 - radius * up @ other) / (down @ other) * down
    return scene, scene.initial_state(np.r_[centre, 0.0, 0.0, 0.0, 1.0], np.zeros(6), free=["right"])


@pytest.mark.parametrize("friction", [pc.NoSlip(), pc.Coulomb(0.8), pc.Coulomb(3.0)], ids=str)
@pytest.mark.parametrize("seed", (1, 3, 6))
def test_a_ball_is_not_caught_in_a_groove(seed, friction):
    """As it strikes, forces of any size between the flanks could hold it there at once, and it rolls up the other one
    instead. What is left of rebounds that grow ever lower comes to rest (seed 3)."""
    scene, state = ball_in_groove(seed, friction)
    run = pc.simulate(scene, state, 0.2)
    stepped = pc.simulate(scene, state, 0.2, method="Moreau", step=2e-4)
    assert run.status == stepped.status == 0, (run.message, stepped.message)
    # it rolls at up to 1 m/s, and strikes up to a step late
    assert np.abs(run.q[-1] - stepped.q[-1]).max() < 1e-3
    assert run.contacts["left"].mode[-1] == stepped.contacts["left"].mode[-1]
