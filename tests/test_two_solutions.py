"""Contact problems with several solutions: a run takes the same one in all methods and orders of contacts."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from differential import check

import pincontact as pc
from pincontact.friction.solve import ContactSolver
from pincontact.integration.sign_changes import zero_between

METHODS = ({}, {"method": "Moreau", "step": 1e-3}, {"method": "Moreau", "step": 1e-4})
# The point of the hinged bar is this far below and beside its hinge.
BELOW, BESIDE = 0.4, 0.1


def hinged_bar(mu):
    """A bar on a hinge whose end touches the ground; with mu > BESIDE / BELOW it jams itself, whatever lifts it."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("bar", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
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
        50212,  # a contact that strikes without rebound beside one that slides
    ],
)
def test_all_methods_take_the_same(seed):
    """In turned worlds and other orders of contacts, event-driven and by time stepping."""
    finding = check(seed)
    assert not finding.wrong and min(finding.statuses.values()) == 0, finding


def corners(order):
    """Delassus matrix of four corners of a cube, in an order, and b where it falls onto some of them."""
    places = np.array([[1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]])[order]
    rows = np.vstack([np.hstack([np.eye(3), -pin.skew(p)]) for p in places])
    weights = np.array([1.0, 1.0, 1.0, 1.5, 1.5, 1.5])
    velocity = np.array([0.3, 0.1, -0.2, 0.4, 1.0, -0.3])
    return np.ascontiguousarray(rows * weights @ rows.T), rows @ velocity


@pytest.mark.parametrize("mu", [0.3, 1.5, math.inf])
def test_an_afresh_solution_knows_no_past_and_no_order(mu):
    """Whatever was solved before, and however contacts are numbered."""
    given, n = np.full(4, mu), 4
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        order = rng.permutation(n)
        matrix, b = corners(order)
        solver = ContactSolver(nearest=False)
        solver.solve(matrix, rng.normal(size=3 * n), given)
        solver.warm_start(rng.integers(0, 3, n), rng.random(3 * n), rng.normal(size=3 * n))
        assert solver.solve(matrix, b, given, afresh=True)
        velocities = np.empty((n, 3))
        velocities[order] = solver.velocities.reshape(n, 3)
        found.append(velocities)
    # round-off of other orders of sums, of a problem of condition 10
    np.testing.assert_allclose(found, np.broadcast_to(found[0], (6, n, 3)), rtol=0.0, atol=1e-11)


def test_zeros_of_what_jumps():
    """Brent's method takes more steps than it is given where a function jumps from next to nothing to the infinite."""
    for place in (1e-12, 0.3, 1.0 - 1e-9):
        for least in (1e-300, 1.0):
            value = lambda x, place=place, least=least: least if x < place else -math.inf  # noqa: E731
            assert zero_between(value, 0.0, 1.0, 1e-15) == pytest.approx(place, abs=2e-15)
    assert zero_between(lambda x: math.cos(x) - x, 0.0, 1.0, 1e-15) == pytest.approx(0.7390851332151607, abs=1e-15)
