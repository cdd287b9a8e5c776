"""Time stepping tells of energy that its errors make."""

import numpy as np
import pinocchio as pin
import pytest
from random_motions import random_motion
from shared import one_body
from test_moreau import ball_scene, upright

import pincontact as pc
from pincontact.dynamics.energy import energies_at


def test_growing_energy_is_told():
    """A box thrown on a rough floor: the first-order errors of long steps in which it strikes make energy."""
    _, motion = random_motion(70039)
    assert motion.passive
    runs = [
        pc.simulate(motion.scene, motion.state(), 1.0, method="Moreau", step=step, energies=True)
        for step in (1e-2, 1e-3)
    ]
    for run in runs:
        total = run.energies().total
        gained = (total - np.minimum.accumulate(total)).max()
        scale = run.energies().kinetic.max() + np.ptp(total)
        # only some of the outputs are looked at
        assert 0.0 < run.stats["energy_gained"] <= 1.05 * gained / scale
    assert runs[0].stats["energy_gained"] > 1e-3 > 10.0 * runs[1].stats["energy_gained"]
    assert "the energy has grown by 0.003" in runs[0].message
    assert "energy" not in runs[1].message


def test_steps_that_make_energy_are_refused():
    """A disk that all but lies on waves: its contact runs round the rim in a few steps of 1 ms, one of which made fifty
    times its energy."""
    _, motion = random_motion(730099)
    exact = pc.simulate(motion.scene, motion.state(), motion.duration)
    for step in (1e-3, 1e-4):
        run = pc.simulate(motion.scene, motion.state(), motion.duration, method="Moreau", dt=step)
        if step > 1e-4:
            assert run.status == -9, run.message
        else:
            assert run.status == 0 and run.stats["energy_gained"] < 1e-9, run.message
            # the error of first order in the step, of some hundred thousand m/s^2 of the contact as it runs round
            assert np.abs(run.q[-1] - exact.q[-1]).max() < 0.02
        kinetic, potential = np.array([energies_at(motion.scene.model, q, v) for q, v in zip(run.q, run.v)]).T
        # of a velocity that is off by up to 8 %
        assert np.diff(kinetic + potential).max() < 0.16 * kinetic.max()


def test_energy_that_something_gives_is_not_told():
    """A ball on a floor that moves up, and one that a control lifts."""
    scene = ball_scene()
    state = scene.initial_state(upright(0.0, 0.0, 0.1))
    run = pc.simulate(scene, state, 0.1, method="Moreau", control=lambda t, q, v: np.array([0, 0, 40.0, 0, 0, 0]))
    assert run.status == 0 and "energy" not in run.message and "energy_gained" not in run.stats
    model = scene.model
    lift = pc.Scene(model)
    lift.add_contour("ball", pc.Sphere(0.1), "body")
    lift.add_contour("floor", pc.Plane(), motion=pc.ConstantTwist(linear=(0.0, 0.0, 1.0)))
    lift.add_contact("c", "ball", "floor")
    state = lift.initial_state(upright(0.0, 0.0, 0.1), np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    run = pc.simulate(lift, state, 0.1, method="Moreau")
    assert run.status == 0 and "energy" not in run.message and "energy_gained" not in run.stats
    assert run.q[-1, 2] == pytest.approx(0.2, abs=1e-9)


@pytest.mark.parametrize("mu", [0.2, 0.4, 3.0**-0.5, 0.7])
def test_round_off_is_no_energy(mu):
    """A block on a slope whose friction just holds it: what it moves by is 1e-16 m, and its energy is of one sign."""
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.004 * np.eye(3)), "block")
    scene, slope = pc.Scene(model), pin.utils.rotate("y", np.arctan(mu))
    floor = scene.add_contour("floor", pc.Plane(), placement=pin.SE3(slope, np.zeros(3)))
    for k, (x, y) in enumerate(((0.1, 0.1), (0.1, -0.1), (-0.1, 0.0))):
        foot = scene.add_contour(f"p{k}", pc.Point(), "block", pin.SE3(np.eye(3), np.array([x, y, -0.05])))
        scene.add_contact(f"p{k}", foot, floor, friction=pc.Coulomb(mu))
    state = scene.initial_state(np.r_[slope @ [0.0, 0.0, 0.05], pin.Quaternion(slope).coeffs()])
    for step in (1e-2, 1e-3):
        run = pc.simulate(scene, state, 1.0, method="Moreau", step=step)
        assert run.status == 0
        assert np.abs(run.q[-1] - state.q).max() < 1e-12
        assert run.stats["energy_gained"] == 0.0 and "energy" not in run.message
