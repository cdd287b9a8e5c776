"""Bodies on several points that slide from one contour onto others of the same height: they are carried by all that
they are over."""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

MU = 0.3


def box(parts: dict[str, tuple[float, float]], yaw: float, speed: float, spin: float):
    """A box on four corners that slides along x over parts of a floor (name -> low and high end of x), on the first of
    which it starts."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.2 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("box", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    contours = {name: scene.add_contour(name, pc.Plane((ends, (-50.0, 50.0)))) for name, ends in parts.items()}
    for i, (x, y) in enumerate((x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)):
        corner = scene.add_contour(f"p{i}", pc.Point(), "box", pin.SE3(np.eye(3), np.array([x, y, -0.25])))
        for name in parts:
            scene.add_contact(f"{name}{i}", corner, contours[name], friction=pc.Coulomb(MU))
    others = [f"{name}{i}" for name in list(parts)[1:] for i in range(4)]
    q = [-0.75, 0.0, 0.25, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)]
    v = [speed * math.cos(yaw), -speed * math.sin(yaw), 0.0, 0.0, 0.0, spin]
    return scene, scene.initial_state(q, v, free=others)


def ends_at(q: np.ndarray) -> np.ndarray:
    return np.array([q[0], q[1], 2.0 * math.atan2(q[5], q[6])])


@pytest.mark.parametrize("seed", range(8))
def test_a_seam_is_not_felt(seed):
    """One floor in two parts: as on a floor of one part. Where loads of three corners carry the
    box a fourth one, which has come over the other part, had none for good (5e-3 to 4e-2 rad)."""
    rng = np.random.default_rng(seed)
    yaw, spin, speed = rng.uniform(-0.6, 0.6), rng.uniform(-2.0, 2.0), rng.uniform(2.5, 4.0)
    motion = yaw, speed, spin
    whole, start = box({"A": (-50.0, 50.0)}, *motion)
    parts, begin = box({"A": (-50.0, 0.0), "B": (0.0, 50.0)}, *motion)
    one = pc.simulate(whole, start, 0.6, rtol=1e-10, atol=1e-12)
    two = pc.simulate(parts, begin, 0.6, rtol=1e-10, atol=1e-12)
    assert one.status == two.status == 0, two.message
    np.testing.assert_allclose(ends_at(two.q[-1]), ends_at(one.q[-1]), rtol=0.0, atol=1e-9)
