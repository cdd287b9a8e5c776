"""Parts of impacts, each alone: how much of the restitution is kept, the work of impulses, loads that are iterated."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pincontact.dynamics import impact
from pincontact.dynamics.energy import KEPT_ACCURACY


class Bouncing:
    """A problem whose impulses would create energy beyond a part of the restitution."""

    driven = False

    def __init__(self, most):
        self.most, self.asked = most, []

    def solve(self, solver, kept):
        self.asked.append(kept)
        return np.array([kept, 1.0])

    def work(self, y):
        # a part of it on the joints
        creates = y[0] > self.most
        return (2e-3 if creates else -3.0), -1e-3, 10.0


@pytest.mark.parametrize("most", [0.0, 3e-4, 0.1, 0.37, 0.5, 0.8123, 0.9996, 1.0])
def test_as_much_of_the_restitution_is_kept_as_creates_no_energy(most, monkeypatch):
    problem = Bouncing(most)
    monkeypatch.setattr(impact, "_Problem", lambda *arguments: problem)
    monkeypatch.setattr(impact, "unwhiten", lambda system, y: 2.0 * y)
    system = SimpleNamespace(v=np.array([5.0, 6.0]))
    found = impact.apply_impact(system, None, [], [], {})
    if most == 1.0:
        assert problem.asked == [1.0]
        assert found.kept == 1.0
    else:
        assert most - KEPT_ACCURACY <= found.kept <= most
        # halved until it is known, and once more for what is taken
        assert len(problem.asked) <= 13
    assert (found.contacts, found.drives, found.joints) == (-3.0, 0.0, -1e-3)
    assert system.v.tolist() == [5.0 + 2.0 * found.kept, 8.0]


def test_without_impulses_there_is_no_impact(monkeypatch):
    monkeypatch.setattr(impact, "_Problem", lambda *arguments: SimpleNamespace(solve=lambda solver, kept: None))
    system = SimpleNamespace(v=np.zeros(2))
    assert impact.apply_impact(system, None, [], [], {}) is None
    assert not system.v.any()


@pytest.mark.parametrize("seed", range(3))
def test_work_of_impulses(seed):
    """Of each impulse along its mean velocity; the size is the sum of what it is made of."""
    rng = np.random.default_rng(seed)
    problem = object.__new__(impact._Problem)
    problem.stack, problem.before = rng.normal(size=(5, 9)), rng.normal(size=9)
    problem.forces, problem.contacts = rng.normal(size=9), 2
    y = rng.normal(size=5)
    problem.forces[3] = 0.0
    contacts = joints = size = 0.0
    for k in range(9):
        before, after = problem.before[k], problem.before[k] + problem.stack[:, k] @ y
        work = 0.5 * problem.forces[k] * (before + after)
        size += 0.5 * abs(problem.forces[k]) * (abs(before) + abs(after))
        if k < 6:
            contacts += work
        else:
            joints += work
    assert problem.work(y) == pytest.approx((contacts, joints, size), rel=1e-13)


class Answering:
    """A solver whose normal impulses follow from the loads that it is given, and what it was asked."""

    def __init__(self, answer):
        self.answer, self.asked = answer, []

    def solve(self, gram, b, mu):
        self.asked.append(b.copy())
        self.forces = self.answer(b, len(self.asked))
        return self.forces is not None


def carrying(mu=0.4):
    """A contact and its resistance, whose third row is missing."""
    problem = object.__new__(impact._Problem)
    problem.before, problem.start = np.zeros(6), np.zeros(4)
    problem.stack = problem.reduced = np.vstack([np.eye(6)[[0, 1, 2, 3]]])
    problem.rebound, problem.mu = np.zeros(2), np.array([mu, 0.02])
    problem.loaded, problem.carried = {}, {1: 0}
    problem.weights = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.5])
    problem.gram = np.eye(6)
    return problem


def test_resistances_get_the_load_of_their_contacts():
    """Until it changes no more; an impulse of no load asks for no other."""
    problem = carrying()
    problem.before[2], problem.rebound[0] = -1.0, -0.5
    # the load of the last round halves what is missing
    solver = Answering(lambda b, count: np.array([0.0, 0.0, 2.0 - 0.5**count, 0.3, 0.0, 7.0]))
    y = problem.solve(solver, 0.8)
    assert y == pytest.approx([0.0, 0.0, 2.0, 0.3], abs=1e-9)
    assert [b[2] for b in solver.asked] == [-1.0 - 0.8 * 0.5] * len(solver.asked)
    # the weight of the missing row stands for the load
    assert solver.asked[0][5] == 0.0
    assert [b[5] for b in solver.asked[1:4]] == pytest.approx([-2.5 * 1.5, -2.5 * 1.75, -2.5 * 1.875], rel=1e-14)
    # after twelve rounds the mean with the last; changes fall to the accuracy, by halves
    assert 36 <= len(solver.asked) <= 45
    assert problem.forces[5] == 0.0
    # no load
    solver = Answering(lambda b, count: np.zeros(6))
    assert not problem.solve(solver, 1.0).any()
    assert len(solver.asked) == 1
    # none that is found, or that settles
    assert problem.solve(Answering(lambda b, count: None), 1.0) is None
    solver = Answering(lambda b, count: np.array([0.0, 0.0, float(count), 0.0, 0.0, 0.0]))
    assert problem.solve(solver, 1.0) is None
    assert len(solver.asked) == 100
