"""Chains that lie on a pulley: what touches it can only slip together, and forces are redundant; one after the other
comes to rest while the others stick."""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc


def chain_on_pulley(seed):
    """Five to eight links that fall onto a turning disc with dry bearing friction, a sphere at each joint; and the
    coefficient of friction."""
    rng, model, upwards = np.random.default_rng(seed), pin.Model(), np.array([0.0, 0.0, 1.0])

    def body(joint, mass, lever, moment):
        model.appendBodyToJoint(joint, pin.Inertia(mass, lever, moment * np.eye(3)), pin.SE3.Identity())

    pulley = rng.uniform(0.1, 0.2)
    disc = model.addJoint(0, pin.JointModelRY(), pin.SE3(np.eye(3), upwards), "disc")
    body(disc, 1.0, np.zeros(3), rng.uniform(0.002, 0.02))
    count, length, radius = int(rng.integers(5, 9)), rng.uniform(0.06, 0.12), 0.01
    masses = rng.uniform(0.05, 0.3, count)
    left = -0.5 * count * length + rng.uniform(-0.6, 0.6) * length * 1.2
    q = [0.0, left, 1.0 + pulley + radius + rng.uniform(0.002, 0.03)]
    parent = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    parent, place = model.addJoint(parent, pin.JointModelPZ(), pin.SE3.Identity(), "z"), pin.SE3.Identity()
    shapes = []
    for i, mass in enumerate(masses):
        parent = model.addJoint(parent, pin.JointModelRY(), place, f"link{i}")
        body(parent, mass, np.array([0.5 * length, 0.0, 0.0]), mass * length**2 / 12.0 + 1e-6)
        place = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
        shapes.append((f"link{i}", place))
        q.append(rng.normal(0.0, 0.03))
    mu, bearing = float(rng.choice([0.0, 0.1, 0.3, 0.8])), rng.choice([0.0, 0.05, 0.5])
    model.upperDryFrictionLimit[0], model.lowerDryFrictionLimit[0] = bearing, -bearing
    model.damping[3:] = rng.choice([1e-3, 5e-3])
    v = np.zeros(model.nv)
    v[0] = rng.normal(0.0, 5.0)
    scene = pc.Scene(model)
    scene.add_contour("pulley", pc.Sphere(pulley), "disc")
    for name, placement in shapes:
        scene.add_contour(name, pc.Sphere(radius), name, placement=placement)
        scene.add_contact(name, name, "pulley", friction=pc.Coulomb(mu))
    return scene, scene.initial_state(q, v, free=list(scene.contacts)), mu


@pytest.mark.parametrize("seed", [4, 24, 46, 56])
def test_what_sticks_does_not_slip_with_what_comes_to_rest(seed):
    """Velocities of what sticks, which are zero but for the tolerance, are no slip that friction has to end."""
    scene, state, mu = chain_on_pulley(seed)
    run = pc.simulate(scene, state, 0.6, energies=True)
    assert run.status == 0, run.message
    assert any(event.kind == "stick" for event in run.events)
    for track in run.contacts.values():
        # what evaluations leave of forces at the limit
        assert (track.tangential_force <= mu * track.normal_force + 1e-5 * (1.0 + track.normal_force)).all()
    # tolerances, over a hundred events
    assert np.abs(run.energies().balance).max() < 1e-6
