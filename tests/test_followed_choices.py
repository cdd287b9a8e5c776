"""Choices among redundant forces of slip are followed as friction turns with the motion."""

from __future__ import annotations

import numpy as np
import pytest
from test_take_off import on_falling_floor

import pincontact as pc
from pincontact.dynamics.redistribution import RedundantForces
from pincontact.layout import EVENT, MODE, SLIPPING


# of 42 no slip leaves a choice
@pytest.mark.parametrize("seed", [*range(36, 42), *range(43, 60)])
def test_choices_are_followed_as_friction_turns(seed, monkeypatch):
    choose, parts = RedundantForces.redistribute, []

    def watched(self, t, evaluate, ended=None):
        """Compares a choice of slip, followed along the motion for a short time, with one that is made there: notes
        the part that is missing of the way between."""
        system, rk = self.system, evaluate.__self__
        found = choose(self, t, evaluate, ended)
        if not found or not system.scalars["has_reference"] or not (system.contact_int[:, MODE] == SLIPPING).any():
            return found
        state, choice, modes, h = system.stage_state.copy(), self.reference(), system.contact_int.copy(), 2e-6
        if rk.evaluate_start(t) <= EVENT:
            start = system.force.copy()
            rk.load(state + h * system.slopes[0])
            known, followed = evaluate(t + h) <= EVENT, system.force.copy()
            if known and choose(self, t + h, evaluate):
                parts.append(np.abs(system.force - followed).max() / np.abs(system.force - start).max())
            self.take_back(choice)
        system.contact_int[:] = modes
        rk.load(state)
        evaluate(t)
        return found

    monkeypatch.setattr(RedundantForces, "redistribute", watched)
    scene, state, leaves = on_falling_floor(np.random.default_rng(seed))
    pc.simulate(scene, state, 1.2 * leaves)
    assert parts
    # the square of 2e-6 s in times of some milliseconds; one that follows the loads alone is off by a third of the way,
    # and one that depends on the choices before by as much
    assert np.median(parts) < 1e-3
