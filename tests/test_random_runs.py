"""Whole runs of random scenes: nothing is known of the motion but what every motion must keep."""

import math
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from random_contacts import PATTERNS, RandomContact, is_line_contact, motions_of, names_of
from shared import one_body
from test_moreau import random_scene

import pincontact as pc

# more friction than this meets Painleve paradoxes on the long arms of these bodies
LAWS = (None, pc.NoSlip(), pc.Coulomb(0.1), pc.Coulomb(0.02))
RUNS = 12


def random_contact(pattern, seed):
    rng = np.random.default_rng(seed)
    while True:
        names = tuple(str(rng.choice(names_of(pattern, body))) for body in (1, 2))
        motions = tuple(str(rng.choice(motions_of(pattern))) for _ in range(2))
        law = LAWS[int(rng.integers(len(LAWS)))]
        if is_line_contact(pattern, names):
            continue
        contact = RandomContact(pattern, names, motions, bool(rng.random() < 0.5), int(rng.integers(10**6)), law)
        if contact.at().condition > 0.1:
            return contact, law


@pytest.mark.parametrize("pattern", PATTERNS)
def test_energy_account_and_force_law(pattern):
    """Energy changes by the work of friction and of the drives; forces obey Coulomb's law; constraints hold. A run may
    end early only at the end of a contour or where two bodies have rolled into a line contact."""
    finished = 0
    for seed in range(RUNS):
        contact, law = random_contact(pattern, seed)
        run = pc.simulate(contact.scene, contact.state, 0.3, rtol=1e-9, atol=1e-11, energies=True, max_steps=2000)
        assert run.t.size > 1, (contact, run.message)
        track, energies = run.contacts["c"], run.energies()
        if run.status != 0 and run.events[-1].kind != "edge":
            assert np.nanmin(track.conditioning) < 1e-5, (contact, run.message)
        finished += run.status == 0
        scale = 1.0 + np.abs(energies.total).max() + np.abs(energies.drive_work).max()
        # accumulated error of some hundred steps at rtol = 1e-9
        assert np.abs(energies.balance).max() <= 1e-6 * scale, contact
        if isinstance(law, pc.Coulomb):
            excess = track.tangential_force - law.mu * np.abs(track.normal_force)
            assert (excess <= 1e-8 * (1.0 + np.abs(track.normal_force))).all(), contact
        # Newton's error of the location grows as 1 / conditioning
        well = track.conditioning > 1e-2
        assert well.any(), contact
        for kind, values in run.residuals().items():
            assert values[well].max(initial=0.0) <= 1e-11, (contact, kind)
    assert finished >= RUNS // 2


def ground(rng):
    if rng.random() < 0.7:
        return pc.Plane()
    return pc.HeightField(lambda x, y: 0.05 * math.sin(2.0 * x) * math.cos(1.5 * y))


def thrown_body(seed):
    """A disk, an ellipsoid or a ball thrown over a rough ground: (scene, q, v, mu)."""
    rng = np.random.default_rng(seed)
    mu, mass = float(rng.choice([0.05, 0.1, 0.2, 0.4, 0.8])), rng.uniform(0.3, 3.0)
    rotation = pin.utils.rotate("z", rng.uniform(-3.0, 3.0)) @ pin.utils.rotate("y", rng.uniform(0.5, 1.3))
    rotation = rotation @ pin.utils.rotate("z", rng.uniform(-3.0, 3.0))
    axes = np.sort(rng.uniform(0.1, 0.4, 3))[::-1]
    if seed % 3 == 0:
        shape, moments = pc.Circle(axes[0]), 0.25 * mass * axes[0] ** 2 * np.array([1.0, 1.0, 2.0])
        height = axes[0] * math.hypot(rotation[2, 0], rotation[2, 1])
    else:
        axes = axes if seed % 3 == 1 else np.full(3, axes[0])
        shape = pc.Ellipsoid(*axes) if seed % 3 == 1 else pc.Sphere(axes[0])
        moments = 0.2 * mass * (np.sum(axes**2) - axes**2)
        height = float(np.linalg.norm(axes * rotation[2]))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(mass, np.zeros(3), np.diag(moments))))
    body, floor = scene.add_contour("body", shape, "body"), scene.add_contour("floor", ground(rng))
    scene.add_contact("c", body, floor, friction=pc.Coulomb(mu))
    q = np.array([0.0, 0.0, height, *pin.Quaternion(rotation).coeffs()])
    return scene, q, np.concatenate([rng.normal(size=3), 3.0 * rng.normal(size=3)]), mu


# Ends of 3D slip at which the direction turns fast are where steps could stall, starts of slip on a nearly flat disk
# where energy could be made.
@pytest.mark.parametrize("block", range(2))
def test_slip_and_stick_of_thrown_bodies(block):
    """Many ends and starts of slip: the run goes on, no energy is won, forces stay in their cones."""
    for seed in range(6 * block, 6 * block + 6):
        scene, q, v, mu = thrown_body(seed)
        state = scene.initial_state(q, v, max_gap=0.2)
        run = pc.simulate(scene, state, 1.0, energies=True, max_steps=3000)
        track, energies = run.contacts["c"], run.energies()
        if run.status != 0:
            # a rim in a hollow may touch at another point before that
            twice = run.status == -3 and "another point" in run.message
            assert twice or run.events[-1].kind == "singular", (seed, run.message)
            assert twice or track.conditioning[-1] < 1e-5, seed
        kinds = {event.kind for event in run.events}
        if "touch" not in kinds:
            # impacts lose energy that is no work along the way
            assert np.abs(energies.balance).max() <= 1e-6 * (1.0 + abs(energies.total[0])), seed
        assert np.diff(energies.friction_work).max(initial=0.0) <= 1e-6, seed
        assert np.diff(energies.total).max(initial=0.0) <= 1e-6, seed
        assert (track.tangential_force <= mu * track.normal_force + 1e-7).all(), seed
        alternate = [event.kind for event in run.events if event.kind in ("stick", "slip")]
        assert all(a != b for a, b in pairwise(alternate)) or "touch" in kinds, seed


def test_impacts_of_several_contacts():
    """Two bodies with up to six contacts of all laws fall on a floor: nothing hangs, every impact is in the account."""
    for seed in range(8):
        scene, state = random_scene(np.random.default_rng(seed))
        run = pc.simulate(scene, state, 0.6, energies=True, max_steps=5000)
        assert run.status == 0, (seed, run.message)
        assert np.isfinite(run.q).all(), seed
        assert np.isfinite(run.v).all(), seed
        energies = run.energies()
        scale = energies.kinetic.max()
        # a hop that is left out gives back at its start the friction of its end: hops of 1e-8 m last for 1e-4 s
        since = np.searchsorted(run.t, run.t - 1e-3)
        for energy in (energies.friction_work, energies.total):
            assert (energy - np.minimum.accumulate(energy)[since]).max() <= 1e-7 * scale, seed
        assert np.abs(energies.balance).max() <= 1e-6 * scale, seed
        for name in scene.contacts:
            assert np.nanmin(run.contacts[name].gap) >= -1e-6, seed
