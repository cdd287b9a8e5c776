"""Friction on what drives alone move along: bodies that no joint moves that way rub all the same, in time stepping."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pincontact as pc

MU, G, SPEED, DURATION = 0.3, 9.81, 1.0, 0.3


def _slider(
    motion: pc.Motion, turn: float, tip: pc.Contour, law: pc.FrictionLaw, beside: bool = False
) -> tuple[pc.Scene, pc.State]:
    """A tip that joints move along x and z only, on a plate; its contact basis is turned about the normal. beside:
    another body lies on a plane that it cannot leave."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    joint = model.addJoint(joint, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("slider", joint, pin.SE3.Identity(), 0)
    if beside:
        joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "other")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame("other", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    first = scene.add_contour("tip", tip, "slider")
    plate = scene.add_contour("plate", pc.Plane(), placement=pin.SE3(_turned(turn), np.zeros(3)), motion=motion)
    scene.add_contact("c", first, plate, friction=law)
    height = 0.0 if isinstance(tip, pc.Point) else tip.size
    if beside:
        scene.add_contact("beside", scene.add_contour("other", pc.Point(), "other"), plate, bilateral=True)
    return scene, scene.initial_state([0.0, height, *[0.0] * beside], [SPEED, 0.0, *[0.0] * beside])


def _turned(angle: float) -> np.ndarray:
    return pin.utils.rotate("z", angle)


@pytest.mark.parametrize(("turn", "tip"), [(0.6, pc.Point()), (0.0, pc.Sphere(0.1))], ids=["point", "sphere"])
@pytest.mark.parametrize(("across", "beside"), [(1.0, False), (-0.2, False), (1e-3, False), (1.0, True)])
def test_slider_on_belt(across, beside, turn, tip):
    """The belt runs across the slider's way: its friction mu N u / |(u, V)| along the way is of second order in h,
    whatever the basis, and what cannot open elsewhere."""
    belt = pc.ConstantTwist(linear=_turned(-turn) @ np.array([0.0, across, 0.0]))
    scene, state = _slider(belt, turn, tip, pc.Coulomb(MU), beside)
    exact = solve_ivp(
        lambda t, y: [y[1], -MU * G * y[1] / math.hypot(y[1], across)],
        (0.0, DURATION),
        [0.0, SPEED],
        rtol=1e-11,
        atol=1e-13,
    ).y[0, -1]
    for h in (1e-3, 2.5e-4):
        run = pc.simulate(scene, state, DURATION, method="Moreau", dt=h, energies=True)
        track, u = run.contacts["c"], run.v[:, 0]
        # (mu g h)^2 / V, times the duration and a factor
        assert run.status == 0 and abs(run.q[-1, 0] - exact) <= 0.1 * h * h
        assert (track.mode == 2).all()
        # in a step a given slip is changed by 1e-9 of what forces change others by
        assert np.abs(run.energies().balance).max() <= 1e-11
        force = MU * G * np.column_stack([u, np.full(u.size, -across), 0.0 * u]) / np.hypot(u, across)[:, None]
        np.testing.assert_allclose(track.force, force - [0.0, 0.0, G], rtol=0.0, atol=1e-9)
    stepper = pc.Stepper(scene, state, dt=1e-4)
    stepper.step(np.zeros(scene.model.nv))
    # the mean over a step, in which the direction turns by mu g h / V
    np.testing.assert_allclose(stepper.forces["c"], track.force[0], rtol=0.0, atol=2e-3)


@pytest.mark.parametrize("law", [pc.Coulomb(0.2), pc.Coulomb(2.0, mu_static=3.0), pc.Coulomb(0.1, viscous=0.5)])
@pytest.mark.parametrize("face", [pc.Plane(), pc.Line()], ids=["plane", "line"])
def test_cam_and_follower(face, law):
    """A cam that a motion turns rubs on a follower that moves up and down: in a plane, too."""
    radius, eccentricity, rate = 0.05, 0.02, 15.0
    model = pin.Model()
    model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "guide")
    model.appendBodyToJoint(1, pin.Inertia(0.3, np.zeros(3), 1e-4 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("follower", 1, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    upright = pin.utils.rotate("x", 0.5 * np.pi)
    turning = pc.ConstantTwist(angular=(0.0, 0.0, rate), center=(-eccentricity, 0.0, 0.0))
    cam = scene.add_contour(
        "cam", pc.Circle(radius), "universe", pin.SE3(upright, np.array([eccentricity, 0.0, 0.0])), turning
    )
    down = upright if isinstance(face, pc.Line) else pin.utils.rotate("x", np.pi)
    scene.add_contact("c", cam, scene.add_contour("face", face, "follower", pin.SE3(down, np.zeros(3))), friction=law)
    state = scene.initial_state([radius], [eccentricity * rate])
    times = np.linspace(0.0, 0.5, 26)
    run = pc.simulate(scene, state, 0.5, method="Moreau", dt=5e-4, t_eval=times)
    exact = pc.simulate(scene, state, 0.5, t_eval=times)
    assert run.status == 0, run.message
    assert not run.events and not exact.events
    np.testing.assert_allclose(run.q[:, 0], radius + eccentricity * np.sin(rate * times), rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(run.contacts["c"].mode, 2)
    np.testing.assert_allclose(run.contacts["c"].force, exact.contacts["c"].force, rtol=0.0, atol=1e-6)
