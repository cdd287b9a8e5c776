"""Bodies on two feet in ideal rolling and one with friction, on a floor that shakes: feet slide, jam, hop and land
beside each other. Runs at default tolerances are near runs at tight ones."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from random_motions import G, axis, default_and_tight, free_body, frequency

import pincontact as pc

DURATION = 0.3


def shaken_tripod(rng: np.random.Generator) -> tuple[pc.Scene, pc.State]:
    mass, height = rng.uniform(0.5, 5.0), rng.uniform(0.03, 0.15)
    scene = pc.Scene(free_body(mass, mass * rng.uniform(0.005, 0.01, 3)))
    omega = frequency(rng)
    reach = min(rng.uniform(0.5, 2.0) * G / omega**2, 0.2)
    motion = pc.HarmonicMotion(
        reach * axis(rng),
        omega / (2.0 * math.pi),
        rng.uniform(0.0, 6.0),
        axis(rng),
        reach * rng.uniform(0.0, 3.0) * (rng.random() < 0.6),
    )
    slope = pin.SE3(pin.exp3(rng.uniform(0.0, 0.3) * axis(rng)), np.zeros(3))
    floor = scene.add_contour("floor", pc.Plane(), placement=slope, motion=motion)
    turn = rng.uniform(0.0, 6.0)
    for i in range(3):
        angle, radius = turn + 2.0 * math.pi * i / 3, rng.uniform(0.08, 0.2)
        place = pin.SE3(np.eye(3), np.array([radius * math.cos(angle), radius * math.sin(angle), -height]))
        foot = scene.add_contour(f"foot {i}", pc.Point(), "body", place)
        scene.add_contact(f"foot {i}", foot, floor, pc.NoSlip() if i < 2 else pc.Coulomb(rng.uniform(0.0, 0.4)))
    q = np.array([*slope.rotation[:, 2] * height, *pin.Quaternion(slope.rotation).coeffs()])
    return scene, scene.initial_state(q, np.zeros(6), max_gap=0.3)


# Each has what the others have not: a hop left out beside ideal rolling that slides (24), touches taken together
# that end such a slip too early (6), slips that jam after an impact (69), ideal rolling that is let go as another
# foot begins to slip (36, 99), rattles in each period of the floor, the later ones as fine as the first
# (153), touches 1e-6 s apart (89).
@pytest.mark.parametrize("seed", [6, 24, 36, 69, 89, 99, 153])
def test_default_tolerances_follow_tight_ones(seed):
    scene, state = shaken_tripod(np.random.default_rng(seed))
    # a third of it has hundreds of events of the last one
    run, tight = default_and_tight(scene, state, 0.33 * DURATION if seed == 153 else DURATION)
    # a hundred times the tolerance: each of up to 100 events adds to it; 1e-5 and more for each mechanism alone
    np.testing.assert_allclose(run.q, tight.q, atol=1e-6)


def test_load_that_runs_out_with_its_friction():
    """The load of the foot that has friction sinks to zero, its limit of friction with it: it slips and opens within
    5e-8 s, and neither at once."""
    scene, state = shaken_tripod(np.random.default_rng(40))
    run = pc.simulate(scene, state, DURATION)
    assert run.status == 0, run.message


# Feet that strike while one has dipped leave slips of 1e-6 m/s that end there, on a floor that moves (84); friction
# alone holds a foot up, beside one that slides or sticks (89, 156).
@pytest.mark.parametrize(("seed", "tight", "duration"), [(84, True, 0.13), (89, True, 0.07), (156, False, 0.16)])
def test_strikes_and_forces_that_were_refused(seed, tight, duration):
    scene, state = shaken_tripod(np.random.default_rng(seed))
    options = {"rtol": 1e-11, "atol": 1e-13, "max_step": DURATION / 200.0} if tight else {}
    run = pc.simulate(scene, state, duration, t_eval=np.linspace(0.0, duration, 31), **options)
    assert run.status == 0, run.message
    other = pc.simulate(scene, state, duration, t_eval=run.t, rtol=1e-9, atol=1e-11)
    # as far as the tolerances of both let a chain of impacts be known
    np.testing.assert_allclose(run.q, other.q, atol=1e-6)
