"""Random runs of time stepping, of all kinds; the long form is a command, see `stress/random_runs.py`."""

import numpy as np
import pinocchio as pin
import pytest
from stress.random_runs import KINDS, check

import pincontact as pc


@pytest.mark.parametrize("kind", range(len(KINDS)))
def test_random_runs(kind):
    """No energy from friction or impacts, no NaN, no hang, no error."""
    for seed in range(kind, 48, len(KINDS)):
        _, fault = check(seed)
        assert not fault, seed


@pytest.mark.parametrize("seed", [1611, 2791, 5207, 5399, 5903, 12707])
def test_chains_at_their_stops(seed):
    """Contact and joint stops that hold a chain together, and impacts that wedge it (2791, 12707)."""
    kind, fault = check(seed)
    assert kind == "chain"
    assert not fault


def sled(rng):
    """A body with four points at random places that slide in a hollow sphere, which one of them cannot leave, so that
    the others' normals are redundant together with its own: scene and start."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "sled")
    model.appendBodyToJoint(
        joint, pin.Inertia(1.0, np.zeros(3), np.diag(rng.uniform(0.02, 0.06, 3))), pin.SE3.Identity()
    )
    model.addBodyFrame("sled", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    bowl, centre = scene.add_contour("bowl", pc.Sphere(1.0)), np.array([0.0, 0.0, -0.85])
    for i in range(4):
        turn, aside = 0.5 * np.pi * i + rng.uniform(-0.3, 0.3), rng.uniform(0.3, 0.6)
        place = np.array([aside * np.cos(turn), aside * np.sin(turn), -np.sqrt(1.0 - aside**2)])
        point = scene.add_contour(f"p{i}", pc.Point(), "sled", pin.SE3(np.eye(3), place - centre))
        scene.add_contact(f"c{i}", point, bowl, side=-1, bilateral=i == 3)
    spin = 3.0 * rng.normal(size=3)
    return scene, scene.initial_state([*centre, 0, 0, 0, 1], [*np.cross(spin, centre), *spin])


@pytest.mark.parametrize("seed", [0, 4, 5, 9, 12, 15, 17, 21])
def test_redundant_normals_keep_to_a_curved_ground(seed):
    """What second order adds to rigid geometry is taken from rows and equations alike: in long steps nothing opens, and
    errors are of second order."""
    scene, state = sled(np.random.default_rng(seed))
    exact = pc.simulate(scene, state, 0.2)
    errors = []
    for step in (2e-2, 1e-2):
        run = pc.simulate(scene, state, 0.2, method="Moreau", dt=step)
        assert run.status == 0 and not run.events, run.events
        errors.append(np.abs(run.q[-1] - exact.q[-1]).max())
    # 4, with turns of up to 0.2 rad in a step
    assert 3.0 < errors[0] / errors[1] < 5.0
