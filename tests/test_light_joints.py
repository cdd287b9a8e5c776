"""Light joints in dry friction that impacts elsewhere set in motion: they stop within what positions are known to."""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

WHEELS, DURATION = 4, 0.5


def _arm(rng):
    """Two links in a vertical plane that strike their stops, and wheels in dry friction on the last one."""
    model, joint = pin.Model(), 0
    for i in range(2):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3 * i]))
        joint = model.addJoint(joint, pin.JointModelRY(), place, f"link {i}")
        inertia = pin.Inertia(rng.uniform(0.2, 1.0), np.array([0.0, 0.0, -0.15]), 0.01 * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    for i in range(WHEELS):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1 * i]))
        wheel = model.addJoint(joint, pin.JointModelRY(), place, f"wheel {i}")
        moment = 10.0 ** rng.uniform(-11.0, -10.0)
        model.appendBodyToJoint(wheel, pin.Inertia(1e-3, np.zeros(3), moment * np.eye(3)), pin.SE3.Identity())
    model.lowerPositionLimit[:2], model.upperPositionLimit[:2] = -rng.uniform(0.1, 0.2, 2), rng.uniform(0.1, 0.2, 2)
    dry = np.r_[0.0, 0.0, rng.uniform(0.2, 1.0, WHEELS)]
    model.lowerDryFrictionLimit[:], model.upperDryFrictionLimit[:] = -dry, dry
    scene = pc.Scene(model)
    return scene.initial_state(np.r_[rng.uniform(-0.1, 0.1, 2), np.zeros(WHEELS)], np.r_[2.0, -2.0, np.zeros(WHEELS)])


@pytest.mark.parametrize("seed", range(4))
def test_they_stop_with_the_impact(seed):
    """They turn by 1e-11 to 1e-8 rad at each stop of a link: no motion at tolerances of 1e-8, but one at 1e-12."""
    state = _arm(np.random.default_rng(seed))
    scene = state.scene
    run = pc.simulate(scene, state, DURATION)
    exact = pc.simulate(scene, state, DURATION, rtol=1e-12, atol=1e-14)
    assert run.status == exact.status == 0, (run.message, exact.message)
    of_links = [event for event in run.events if event.joint.startswith("link")]
    assert len(of_links) >= 2 and len(run.events) == len(of_links)
    assert len(exact.events) > len(run.events)
    # a tolerance for each stop of a link
    assert np.abs(run.q[-1] - exact.q[-1]).max() < 1e-8 * len(of_links)
