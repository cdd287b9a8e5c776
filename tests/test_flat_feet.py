"""A humanoid whose ankles only pitch stands on flat feet, hips side by side: constraints of its soles are redundant
there and nowhere else. As soon as it leans, the sole that is easier to tip stands on its edge."""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

SHANK, ANKLE, CORNERS = 0.4, 0.06, ((0.12, 0.04), (0.12, -0.04), (-0.06, 0.04), (-0.06, -0.04))
JOINTS = (
    ("yaw", pin.JointModelRZ, 0.5, 0.0),
    ("roll", pin.JointModelRX, 0.5, 0.0),
    ("pitch", pin.JointModelRY, 3.0, SHANK),
    ("knee", pin.JointModelRY, 2.0, SHANK),
    ("ankle", pin.JointModelRY, 0.8, 0.0),
)


def humanoid(rng):
    """Scene and start, at rest with bent knees."""
    model, apart = pin.Model(), rng.uniform(0.16, 0.24)
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    trunk = pin.Inertia.FromBox(25.0, 0.2, 0.35, 0.5)
    model.appendBodyToJoint(base, trunk, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.25])))
    for side, y in (("left", 0.5 * apart), ("right", -0.5 * apart)):
        parent, place = base, np.array([0.0, y, 0.0])
        for name, joint, mass, length in JOINTS:
            parent = model.addJoint(parent, joint(), pin.SE3(np.eye(3), place), f"{side} {name}")
            place = np.array([0.0, 0.0, -length])
            model.appendBodyToJoint(parent, pin.Inertia.FromSphere(mass, 0.05), pin.SE3(np.eye(3), 0.5 * place))
        for i, corner in enumerate(CORNERS):
            at = pin.SE3(np.eye(3), np.array([*corner, -ANKLE]))
            model.addFrame(pin.Frame(f"{side} {i}", parent, 0, at, pin.FrameType.OP_FRAME))
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for name in [f"{side} {i}" for side in ("left", "right") for i in range(4)]:
        corner = scene.add_contour(name, pc.Point(), frame=name)
        scene.add_contact(name, floor, corner, friction=pc.Coulomb(rng.choice([0.5, 0.8])))
    bend, q = rng.uniform(0.2, 0.8), pin.neutral(model)
    q[7:] = np.tile([0.0, 0.0, -bend, 2.0 * bend, -bend], 2)
    q[2] = 2.0 * SHANK * np.cos(bend) + ANKLE
    return scene, scene.initial_state(q)


@pytest.mark.parametrize("seed", [1, 2, 3, 5, 9, 13, 20, 47])
def test_one_sole_tips(seed):
    """Decided by what velocities miss by, as constraints show as independent ones, both soles hopped off, or there were
    no forces."""
    rng = np.random.default_rng(seed)
    scene, start = humanoid(rng)
    push, rate = rng.normal(size=6) * np.array([10.0, 10.0, 5.0, 2.0, 2.0, 2.0]), rng.uniform(2.0, 8.0)
    held = pc.inverse_dynamics(scene, start, cones=True).tau[6:]

    def control(t, q, v):
        return np.r_[push * np.sin(rate * t), held - 400.0 * (q[7:] - start.q[7:]) - 20.0 * v[6:]]

    run = pc.simulate(scene, start, 0.3, control=control)
    assert run.status == 0, run.message
    assert [event.kind for event in run.events] == ["separate"] * 2
    assert {event.contact.split()[0] for event in run.events} in ({"left"}, {"right"})
    stepped = pc.simulate(scene, start, 0.3, control=control, method="Moreau", dt=2.5e-4)
    # it moves by 1e-2 in half a second: second order in the step but for its first hundredths of a second
    np.testing.assert_allclose(run.q[-1], stepped.q[-1], rtol=0.0, atol=2e-8)
