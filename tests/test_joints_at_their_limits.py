"""Joints that are held with all the dry friction they have, as by the least torques: rounding has them slip, rest."""

import numpy as np
import pinocchio as pin
import pytest
from random_motions import axis

import pincontact as pc


def random_arm(rng):
    """Three to six hinges about any axes, and the limits of their dry friction in N m."""
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for k in range(int(rng.integers(3, 7))):
        joint = pin.JointModelRevoluteUnaligned(axis(rng))
        parent = model.addJoint(parent, joint, place, f"j{k}")
        mass, length = rng.uniform(0.3, 2.0), rng.uniform(0.15, 0.4)
        moments = mass * length**2 * rng.uniform(0.06, 0.1, 3)
        inertia = pin.Inertia(mass, 0.1 * rng.normal(size=3), np.diag(moments))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        place = pin.SE3(pin.exp3(rng.normal(size=3)), np.array([length, 0.0, 0.0]))
    limits = rng.uniform(0.2, 1.0, model.nv)
    model.lowerDryFrictionLimit[:], model.upperDryFrictionLimit[:] = -limits, limits
    return model, limits


@pytest.mark.parametrize("seed", [5, 22, 225, 245, 268])
def test_joints_at_the_limit_of_their_friction(seed):
    """Half of them are drawn slowly from rest; the others stay where they are."""
    rng = np.random.default_rng(seed)
    model, limits = random_arm(rng)
    start = rng.uniform(-1.0, 1.0, model.nq)
    weight = pin.computeGeneralizedGravity(model, model.createData(), start)
    holding = (weight + rng.choice([-1.0, 1.0], model.nv) * limits) * (1.0 + 1e-15 * rng.normal(size=model.nv))
    stiffness, damping = rng.uniform(20.0, 200.0), rng.uniform(1.0, 5.0)
    bend = rng.uniform(-0.2, 0.2, model.nv) * (rng.random(model.nv) < 0.5)
    scene = pc.Scene(model)

    def control(t, q, v):
        return holding - stiffness * (q - start - bend * t**2) - damping * v

    state = scene.initial_state(start, np.zeros(model.nv))
    run = pc.simulate(scene, state, 0.5, control=control)
    assert run.status == 0, run.message
    stepped = pc.simulate(scene, state, 0.5, control=control, method="Moreau", step=1e-4)
    # of first order in the step, as halved steps show
    np.testing.assert_allclose(run.q[-1], stepped.q[-1], atol=1e-4)
