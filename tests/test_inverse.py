"""Inverse dynamics and contact forces as Pinocchio's external forces, on random contacts of all patterns."""

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from random_contacts import PATTERNS, RandomContact
from turning_ball import MASS, RADIUS, G, ball, on_the_floor

import pincontact as pc
from pincontact.dynamics.system import System
from pincontact.layout import EVENT
from pincontact.state import write_discrete

URDF = Path(__file__).resolve().parent.parent / "urdf"
SHAPES = {
    "P-2C": ("Point", "Ellipse"),
    "P-3C": ("Point", "Helix"),
    "P-S": ("Point", "Ellipsoid"),
    "2C-2C": ("Circle", "Ellipse"),
    "3C-3C": ("Circle", "Helix"),
    "3C-S": ("Circle", "Ellipsoid"),
    "S-S": ("Sphere", "Ellipsoid"),
}
FRICTIONS = {"smooth": None, "rolling": pc.NoSlip(), "rough": pc.Coulomb(0.3)}
# rounding of a few matrix products, by the conditioning of the contacts and masses
ROUND_OFF = 1e-10


def evaluated(scene, state, tau):
    """A system with accelerations at a state of a run, in the modes of the run."""
    system = System(scene.model, list(scene.contacts.values()))
    system.q[:], system.v[:], system.tau[:] = state.q, state.v, tau
    system.location[: system.nc] = state.location
    write_discrete(system, state.discrete)
    assert system.evaluate(state.t) <= EVENT
    return system


def moving(pattern, friction, seed=2):
    """A contact a little way into its motion under constant torques, and the run."""
    contact = RandomContact(pattern, SHAPES[pattern], seed=seed, friction=FRICTIONS[friction])
    tau = np.random.default_rng(seed).normal(size=contact.scene.model.nv)
    run = pc.simulate(contact.scene, contact.state, 0.02, control=lambda t, q, v: tau)
    assert run.status == 0, run.message
    return contact.scene, run, tau


@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_forward_dynamics_by_pinocchio(pattern, friction):
    """pin.aba under the contacts' forces makes the scene's own accelerations."""
    scene, run, tau = moving(pattern, friction)
    model, data = scene.model, scene.model.createData()
    for index in (0, -1):
        state = run.state(index)
        expected = evaluated(scene, state, tau).acceleration
        scale = 1.0 + np.abs(expected).max()
        for forces in (run.external_forces(index), pc.external_forces(scene, state, tau)):
            found = pin.aba(model, data, state.q, state.v, tau, forces)
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=ROUND_OFF * scale)


@pytest.mark.parametrize("friction", ["smooth", "rolling"])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_inverse_of_forward_dynamics(pattern, friction):
    """The accelerations of a motion under torques need no larger torques, and pin.rnea under the forces agrees."""
    scene, run, tau = moving(pattern, friction, seed=8)
    model, state = scene.model, run.state()
    a = evaluated(scene, state, tau).acceleration.copy()
    found = pc.inverse_dynamics(scene, state, a, actuation=np.eye(model.nv))
    scale = 1.0 + np.abs(tau).max() + np.abs(a).max()
    assert np.linalg.norm(found.tau) <= np.linalg.norm(tau) * (1.0 + 1e-12)
    forces = pc.external_forces(scene, state, forces=found.forces)
    needed = pin.rnea(model, model.createData(), state.q, state.v, a, forces)
    np.testing.assert_allclose(needed, found.tau, rtol=0.0, atol=ROUND_OFF * scale)
    # only one set of forces goes with these torques: the contact's own under them
    again = pc.external_forces(scene, state, found.tau)
    for one, other in zip(forces, again):
        np.testing.assert_allclose(one.vector, other.vector, rtol=0.0, atol=1e-8 * scale)


@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_effort_of_one_actuator(pattern, friction):
    """One actuator that pulls along the torques: its effort is 1, the contact's force that of the motion, friction
    included; and with that force given, all torques follow without the law of friction."""
    scene, run, tau = moving(pattern, friction, seed=8)
    model, state = scene.model, run.state()
    a = evaluated(scene, state, tau).acceleration.copy()
    force = run.contacts["c"].force[-1]
    scale = 1.0 + np.abs(force).max()
    found = pc.inverse_dynamics(scene, state, a, actuation=tau[:, None])
    np.testing.assert_allclose(found.efforts, [1.0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.forces["c"], force, rtol=0.0, atol=1e-8 * scale)
    given = pc.inverse_dynamics(scene, state, a, actuation=np.eye(model.nv), forces={"c": force})
    np.testing.assert_allclose(given.tau, tau, rtol=0.0, atol=1e-9 * scale)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_acceleration_by_default_keeps_the_contact(pattern):
    scene, run, _ = moving(pattern, "rolling")
    state, model = run.state(), scene.model
    found = pc.inverse_dynamics(scene, state, actuation=np.eye(model.nv))
    kinematics = pc.analyze(scene, state)["c"]
    defects = kinematics.rows @ found.acceleration + kinematics.bias
    count = {"P-2C": (0, 2), "2C-2C": (0, 2)}.get(pattern, (0, 1, 2))
    assert np.abs(defects[list(count)]).max() <= ROUND_OFF * (1.0 + np.abs(kinematics.bias).max())
    # nearest zero in the norm of M: orthogonal to every motion that the contact allows
    mass = pin.crba(model, model.createData(), state.q)
    rows = kinematics.rows[list(count)]
    free = np.linalg.svd(rows)[2][rows.shape[0] :]
    np.testing.assert_allclose(
        free @ mass @ found.acceleration, 0.0, atol=1e-9 * (1.0 + np.abs(found.acceleration).max())
    )


def bicycle():
    scene = pc.Scene.from_urdf(URDF / "bicycle.urdf", floating_base=True)
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    floor = scene.add_contour("floor", pc.Plane())
    for name, radius in (("rear", 0.3), ("front", 0.35)):
        rim = scene.add_contour(name, pc.Circle(radius), f"{name}_wheel", upright)
        scene.add_contact(name, rim, floor, friction=pc.NoSlip())
    q = pin.neutral(scene.model)
    q[2] = 0.3
    return scene, scene.initial_state(q)


def test_pedalling():
    """The torque at the rear wheel for an acceleration a: r a (m + I_R / r_R^2 + I_F / r_F^2), by power."""
    scene, state = bicycle()
    model, forward = scene.model, 1.5
    a = np.zeros(model.nv)
    a[0] = forward
    for name, radius in (("rear", 0.3), ("front", 0.35)):
        a[model.joints[model.getJointId(f"{name}_axle")].idx_v] = forward / radius
    found = pc.inverse_dynamics(scene, state, a, actuation=["rear_axle"])
    expected = 0.3 * forward * (94.0 + 0.12 / 0.09 + 0.28 / 0.35**2)
    assert found.efforts == pytest.approx([expected], rel=1e-12)
    total = sum(found.forces.values())
    # on the floor
    np.testing.assert_allclose(total, [-94.0 * forward, 0.0, -94.0 * 9.81], rtol=0.0, atol=1e-9)
    front = found.forces["front"]
    assert front[0] == pytest.approx(0.28 / 0.35**2 * forward, rel=1e-10)
    # braking with both wheels is shared such that the torques are least
    shared = pc.inverse_dynamics(scene, state, -a, actuation=["rear_axle", "front_axle"])
    assert np.linalg.norm(shared.efforts) < expected
    assert shared.efforts @ [1.0 / 0.3, 1.0 / 0.35] == pytest.approx(-expected / 0.3, rel=1e-12)


def test_forces_of_a_free_root():
    """Without actuators named, the root of a floating robot has none: leaning cannot be held by the joints."""
    scene, state = bicycle()
    tipped = state.q.copy()
    tipped[1], tipped[2] = -0.3 * math.sin(0.1), 0.3 * math.cos(0.1)
    tipped[3:7] = [math.sin(0.05), 0.0, 0.0, math.cos(0.05)]
    leaning = scene.initial_state(tipped)
    with pytest.raises(pc.SolverError, match=r"leave .* of the equations of motion"):
        pc.inverse_dynamics(scene, leaning)
    held = pc.inverse_dynamics(scene, leaning, actuation=np.eye(scene.model.nv))
    assert held.residual < 1e-9


@pytest.mark.parametrize("steeper", [0.9, 1.1])
@pytest.mark.parametrize("bilateral", [False, True])
def test_resistance_to_turning_says_what_it_holds_with(steeper, bilateral):
    """A ball at rest on a ramp, where the torque that keeps it is m g sin R, against length m g cos; beside it one that
    a motor spins up against what resists its spinning."""
    rolling, spinning = 4e-3, 1e-3
    slope = math.atan(steeper * rolling / RADIUS)
    scene = ball(pc.Coulomb(0.5, rolling=rolling, spinning=spinning), slope, bilateral)
    # the floor is the second contour
    weight = MASS * G
    found = pc.inverse_dynamics(scene, on_the_floor(scene))
    assert {turn.kind: turn.contact for turn in found.held} == {"rolling": "c", "spinning": "c"}
    turns = {turn.kind: turn for turn in found.held}
    np.testing.assert_allclose(
        turns["rolling"].torque, [0.0, weight * math.sin(slope) * RADIUS, 0.0], rtol=0.0, atol=1e-12
    )
    assert turns["rolling"].limit == pytest.approx(rolling * weight * math.cos(slope), rel=1e-12)
    assert turns["spinning"].limit == pytest.approx(spinning * weight * math.cos(slope), rel=1e-12)
    np.testing.assert_allclose(turns["spinning"].torque, 0.0, rtol=0.0, atol=1e-12)
    assert turns["rolling"].within == (steeper < 1.0)
    assert turns["spinning"].within
    np.testing.assert_allclose(sum(turn.torque for turn in found.held), found.torques["c"], rtol=0.0, atol=1e-15)
    # it is within exactly where a run stays at rest
    run = pc.simulate(scene, on_the_floor(scene), 0.1)
    # round-off, against 0.1 m/s
    assert (np.abs(run.v).max() <= 1e-15) == turns["rolling"].within


def test_what_turns_or_is_given_is_not_held():
    scene = ball(pc.Coulomb(0.5, rolling=4e-3, spinning=1e-3))
    state = on_the_floor(scene, [0.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    (turn,) = pc.inverse_dynamics(scene, state, actuation=np.eye(6)).held
    assert turn.kind == "rolling"
    resting, force = on_the_floor(scene), [0.0, 0.0, -MASS * G]
    assert pc.inverse_dynamics(scene, resting, actuation=np.eye(6), forces={"c": force}).held == ()
    assert pc.inverse_dynamics(*bicycle(), actuation=np.eye(9)).held == ()


def test_bad_arguments():
    scene, state = bicycle()
    model = scene.model
    up = np.zeros(model.nv)
    up[2] = 1.0
    with pytest.raises(pc.StateError, match=r"takes contact '(rear|front)' apart at -?1"):
        pc.inverse_dynamics(scene, state, up)
    aside = np.zeros(model.nv)
    aside[1] = 1.0
    with pytest.raises(pc.StateError, match=r"takes contact '(rear|front)' into slip"):
        pc.inverse_dynamics(scene, state, aside)
    with pytest.raises(pc.StateError, match="acceleration must have 9 entries, got 3"):
        pc.inverse_dynamics(scene, state, [0.0, 0.0, 0.0])
    with pytest.raises(pc.ArgumentError, match=r"unknown joint 'pedal'; joints: .*rear_axle"):
        pc.inverse_dynamics(scene, state, actuation=["pedal"])
    with pytest.raises(pc.ArgumentError, match=r"finite matrix \(9, na\)"):
        pc.inverse_dynamics(scene, state, actuation=np.eye(3))
    with pytest.raises(pc.ArgumentError, match="unknown contact 'side'; contacts: rear, front"):
        pc.external_forces(scene, state, forces={"side": np.zeros(3)})
    with pytest.raises(pc.StateError, match=r"forces\['rear'\] must be 3 finite numbers"):
        pc.inverse_dynamics(scene, state, forces={"rear": [0.0, math.nan, 0.0]})
