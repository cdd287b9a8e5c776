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


def test_steps_that_make_energy_are_divided():
    """A disk that all but lies on waves: its contact runs round the rim in a few steps of 1 ms, one of which made fifty
    times its energy."""
    _, motion = random_motion(730099)
    exact = pc.simulate(motion.scene, motion.state(), motion.duration)
    for step in (1e-3, 1e-4):
        run = pc.simulate(motion.scene, motion.state(), motion.duration, method="Moreau", dt=step)
        assert run.status == 0 and run.stats["energy_gained"] < 1e-9, run.message
        assert run.stats["energy_error"] > 1e-3 and "contact forces have changed the energy" in run.message
        if step > 1e-4:
            # a step of 1 ms stands for several
            assert len(run.t) > 1 + round(motion.duration / step)
        else:
            # the error of first order in the step, of some hundred thousand m/s^2 of the contact as it runs round
            assert np.abs(run.q[-1] - exact.q[-1]).max() < 0.02
        kinetic, potential = np.array([energies_at(motion.scene.model, q, v) for q, v in zip(run.q, run.v)]).T
        # of a velocity that is off by up to 8 %
        assert np.diff(kinetic + potential).max() < 0.16 * kinetic.max()


def disk_in_a_bowl(seed):
    """A disk, thrown into a paraboloid, rolls, slides and flops on its rim: scene and start."""
    rng = np.random.default_rng(seed)
    radius, steep = rng.uniform(0.05, 0.2), rng.uniform(0.3, 1.0)
    inertia = radius**2 * np.diag([0.25, 0.25, 0.5])
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), inertia), "disk"))
    rim = scene.add_contour("rim", pc.Circle(radius), "disk")
    bowl = scene.add_contour("bowl", pc.HeightField(lambda x, y: steep * (x * x + y * y)))
    scene.add_contact("c", rim, bowl, friction=[None, pc.Coulomb(1.0), pc.NoSlip()][seed % 3])
    turned = pin.Quaternion(pin.exp3(rng.normal(size=3))).coeffs()
    v = np.concatenate([rng.normal(size=3), 5.0 * rng.normal(size=3)])
    return scene, scene.initial_state(np.r_[rng.uniform(-0.1, 0.1, 2), 0.5, turned], v, max_gap=1.5)


def test_energy_that_steps_take_is_told():
    """What neither friction, impacts nor anything else explains, of disks that flop in bowls: as the balance of works
    has it, which is computed from states and works, whether energy was lost or made. Some lose a fifth of theirs."""
    told = lost = 0
    for seed in (6, 8, 13, 22):
        scene, state = disk_in_a_bowl(seed)
        run = pc.simulate(scene, state, 0.5, method="Moreau", dt=1e-3, energies=True)
        energies, error = run.energies(), run.stats["energy_error"]
        found = np.ptp(energies.balance) / energies.kinetic.max()
        # smaller ones partly cancel in what the works miss, and steps of impacts have errors of their own
        assert abs(error - found) < 0.15 * found + 3e-4, (seed, run.message)
        assert ("contact forces have changed the energy" in run.message) == (error > 1e-3)
        told += error > 1e-3
        lost += -energies.balance.min() > 1e-2 * energies.kinetic.max()
    assert told == 2 and lost == 1


def test_energy_that_something_gives_is_not_told():
    """A ball on a floor that moves up, and one that a control lifts."""
    scene = ball_scene()
    state = scene.initial_state(upright(0.0, 0.0, 0.1))
    run = pc.simulate(scene, state, 0.1, method="Moreau", control=lambda t, q, v: np.array([0, 0, 40.0, 0, 0, 0]))
    assert run.status == 0 and "energy" not in run.message and "energy_gained" not in run.stats
    assert run.stats["energy_error"] < 1e-9
    model = scene.model
    lift = pc.Scene(model)
    lift.add_contour("ball", pc.Sphere(0.1), "body")
    lift.add_contour("floor", pc.Plane(), motion=pc.ConstantTwist(linear=(0.0, 0.0, 1.0)))
    lift.add_contact("c", "ball", "floor")
    state = lift.initial_state(upright(0.0, 0.0, 0.1), np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    run = pc.simulate(lift, state, 0.1, method="Moreau")
    assert run.status == 0 and "energy" not in run.message and "energy_gained" not in run.stats
    assert run.stats["energy_error"] < 1e-9
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
