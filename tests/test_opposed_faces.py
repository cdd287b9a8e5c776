"""Bodies between opposed faces, without play or next to none: the load goes from one face to the other, and only what
carries it rubs. Bodies that fit are squeezed by nothing."""

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pincontact as pc

DOWN = pin.utils.rotate("x", math.pi)


def body(model, joint, name, inertia, parent=0, place=None):
    index = model.addJoint(parent, joint, pin.SE3.Identity() if place is None else place, name)
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    model.addBodyFrame(name, index, pin.SE3.Identity(), 0)
    return index


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize(("play", "rtol"), [(0.0, 1e-4), (0.0, 1e-8), (1e-12, 1e-8), (1e-10, 1e-8), (1e-6, 1e-4)])
def test_a_load_that_changes_sides_brakes_nothing(play, rtol, order):
    """A point slides between two planes while what presses it to the lower one comes to press it to the upper one: the
    impulse with which it gets there is as small as the play."""
    model, mu, speed, turn = pin.Model(), 0.2, 5.0, 0.43
    model.gravity.linear = np.zeros(3)
    body(model, pin.JointModelTranslation(), "point", pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))))
    scene = pc.Scene(model)
    point = scene.add_contour("tip", pc.Point(), "point")
    faces = {"low": pin.SE3.Identity(), "high": pin.SE3(DOWN, np.array([0.0, 0.0, play]))}
    for name in list(faces)[::order]:
        scene.add_contact(
            name, point, scene.add_contour(f"{name} face", pc.Plane(), placement=faces[name]), pc.Coulomb(mu)
        )
    state = scene.initial_state([0.0, 0.0, 0.0], [speed, 0.0, 0.0], free=["high"] if play else [])
    run = pc.simulate(
        scene, state, 1.0, rtol=rtol, atol=0.01 * rtol, control=lambda t, q, v: np.array([0.0, 0.0, 10.0 * (t - turn)])
    )
    assert run.status == 0, run.message
    exact = speed - mu * 10.0 * (0.5 * turn**2 + 0.5 * (1.0 - turn) ** 2)
    # while it goes over there it does not rub; that is less than the root of the play
    assert run.v[-1, 0] == pytest.approx(exact, abs=10.0 * rtol + math.sqrt(play))


@pytest.mark.parametrize("mu", [0.0, 0.2])
@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8, 1e-10])
def test_a_cam_fits_into_its_yoke(mu, rtol):
    """A disk on an eccentric axis moves a yoke by two faces, of which it touches both, and presses on one. Faces that
    contradict each other by round-off crush nothing."""
    radius, off, inertia, mass, angle, speed = 0.1, 0.03, 0.01, 1.0, 0.3, 5.0
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    body(model, pin.JointModelRZ(), "cam", pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3)))
    body(model, pin.JointModelPX(), "yoke", pin.Inertia(mass, np.zeros(3), np.eye(3)))
    scene = pc.Scene(model)
    disk = scene.add_contour("disk", pc.Circle(radius), "cam", pin.SE3(np.eye(3), np.array([off, 0.0, 0.0])))
    for side in (1.0, -1.0):
        place = pin.SE3(pin.utils.rotate("z", -0.5 * math.pi * side), np.array([side * radius, 0.0, 0.0]))
        face = scene.add_contour(f"face {side:+.0f}", pc.Line(), "yoke", place)
        scene.add_contact(f"c{side:+.0f}", disk, face, pc.Coulomb(mu) if mu else None)
    state = scene.initial_state([angle, off * math.cos(angle)], [speed, -off * math.sin(angle) * speed])
    run = pc.simulate(scene, state, 1.0, rtol=rtol, atol=0.01 * rtol)
    assert run.status == 0, run.message

    def rate(t, y):
        """The yoke is at off cos(q); the load on it is mass times its acceleration, and rubs at the disk's side."""
        q, w = y
        s, c, sign = math.sin(q), math.cos(q), math.copysign(1.0, w)

        def left(a):
            load = -mass * off * (a * s + w * w * c)
            # friction acts across the load, where the disk's surface has the speed w (radius + off |cos|) or less
            arm = radius + math.copysign(off, load) * c
            return inertia * a - (load * off * s - sign * mu * abs(load) * arm)

        # linear in a, on either side of zero load
        for a0, a1 in ((-w * w * c / s, -w * w * c / s + 1.0), (-w * w * c / s, -w * w * c / s - 1.0)):
            slope = (left(a1) - left(a0)) / (a1 - a0)
            a = a0 - left(a0) / slope
            if (a - a0) * (a1 - a0) >= 0.0:
                return [w, a]
        raise AssertionError("no acceleration")

    exact = solve_ivp(rate, (0.0, 1.0), [angle, speed], rtol=1e-11, atol=1e-12, max_step=0.01).y[:, -1]
    np.testing.assert_allclose([run.q[-1, 0], run.v[-1, 0]], exact, rtol=0.0, atol=1e-7 + 100.0 * rtol)
