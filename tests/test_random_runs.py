"""Whole runs of random scenes: nothing is known of the motion but what every motion must keep."""

import numpy as np
import pytest
from random_contacts import PATTERNS, RandomContact, is_line_contact, motions_of, names_of

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
    end early only where two bodies have rolled into a line contact."""
    finished = 0
    for seed in range(300, 300 + RUNS):
        contact, law = random_contact(pattern, seed)
        run = pc.simulate(contact.scene, contact.state, 0.3, rtol=1e-9, atol=1e-11, energies=True, max_steps=2000)
        assert run.t.size > 1, (contact, run.message)
        track, energies = run.contacts["c"], run.energies()
        if run.status != 0:
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
        for kind, values in run.residuals().items():
            assert values[well].max(initial=0.0) <= 1e-11, (contact, kind)
    assert finished >= RUNS // 2
