"""Three rings in each other on a floor, in a plane: where the innermost one loses its load it slides, held up by
friction alone, which presses it on the next one though that one gives way."""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

DURATION = 1.5


def rings(seed, law):
    """Rings that roll on each other, none of them even; gravity is along -y. Returns scene and start."""
    rng = np.random.default_rng(seed)
    model, radii, inner = pin.Model(), [rng.uniform(0.5, 1.0)], []
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    for k in range(3):
        inner.append(radii[k] * rng.uniform(0.8, 0.95))
        radii.append(inner[k] * rng.uniform(0.3, 0.97))
        joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), f"ring {k}")
        reach, angle, mass = radii[k] * rng.uniform(0.0, 0.3), rng.uniform(0.0, 6.0), rng.uniform(0.3, 3.0)
        lever = np.array([reach * math.cos(angle), reach * math.sin(angle), 0.0])
        inertia = mass * radii[k] ** 2 * rng.uniform(0.4, 0.95)
        model.appendBodyToJoint(joint, pin.Inertia(mass, lever, inertia * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(f"ring {k}", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor, q, v = scene.add_contour("floor", pc.Line()), [], []
    place, speed = np.array([0.0, radii[0]]), np.zeros(2)
    turn = rng.uniform(-4.0, 4.0)
    for k in range(3):
        outer = scene.add_contour(f"outer {k}", pc.Circle(radii[k]), f"ring {k}")
        if k == 0:
            speed = np.array([-radii[0] * turn, 0.0])
            scene.add_contact("0", outer, floor, friction=law)
        else:
            way, angle, rate = inner[k - 1] - radii[k], rng.uniform(-2.5, -0.6), rng.uniform(-3.0, 3.0)
            place = place + way * np.array([math.cos(angle), math.sin(angle)])
            speed = speed + way * rate * np.array([-math.sin(angle), math.cos(angle)])
            turn = (turn * inner[k - 1] - way * rate) / radii[k]
            hole = scene.add_contour(f"inner {k - 1}", pc.Circle(inner[k - 1]), f"ring {k - 1}")
            scene.add_contact(str(k), outer, hole, friction=law)
        q += [*place, 1.0, 0.0]
        v += [*speed, turn]
    return scene, scene.initial_state(q, v)


@pytest.mark.parametrize("seed", [0, 26, 27, 60, 61, 69])
def test_ideal_rolling_is_the_limit_of_large_friction(seed):
    runs = []
    for law in (pc.NoSlip(), pc.Coulomb(1e4)):
        scene, state = rings(seed, law)
        runs.append(pc.simulate(scene, state, DURATION, max_steps=3000))
        assert runs[-1].status == 0, runs[-1].message
    # the innermost loses its load, and takes it again
    assert "slip" in [event.kind for event in runs[0].events]
    # in m and rad: the load that large friction needs, 1e-4 of the friction, moves the rings so far in a second
    np.testing.assert_allclose(runs[0].q[-1], runs[1].q[-1], rtol=0.0, atol=2e-4)
