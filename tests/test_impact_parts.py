"""Parts of impacts, each alone: how much of the restitution is kept, the work of impulses, loads that are iterated."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

import pincontact as pc
from pincontact.dynamics import impact
from pincontact.dynamics.units import delassus
from pincontact.friction.solve import ContactSolver
from pincontact.geometry.patterns import ON_CURVE
from pincontact.layout import (
    ANISOTROPIC,
    CONTACT_INTS,
    CONTACT_REALS,
    CURVE_SPEED,
    JOINT_END,
    JOINT_INTS,
    MOTION_KIND,
    MU,
    OWNER,
    PATTERN,
    SCALING_11,
    SCALING_12,
    SCALING_22,
    SIDE_INTS,
    TANGENTS,
    TIME_DEPENDENT,
    UNILATERAL,
)


class Bouncing:
    """A problem whose impulses would create energy beyond a part of the restitution."""

    driven, rebound = False, np.ones(3)
    gain, most_kept = impact._Problem.gain, impact._Problem.most_kept

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
        assert most - 1e-11 <= found.kept <= most
        # halved until it is known, as a jump has no slope, and once more for what is taken
        assert len(problem.asked) <= 100
    assert (found.contacts, found.drives, found.joints) == (-3.0, 0.0, -1e-3)
    assert system.v.tolist() == [5.0 + 2.0 * found.kept, 8.0]


def test_without_impulses_there_is_no_impact(monkeypatch):
    monkeypatch.setattr(
        impact, "_Problem", lambda *arguments: SimpleNamespace(solve=lambda solver, kept: None, rebound=np.ones(3))
    )
    system = SimpleNamespace(v=np.zeros(2))
    assert impact.apply_impact(system, None, [], [], {}) is None
    assert not system.v.any()


def test_a_rebound_that_is_left_no_way_is_none(monkeypatch):
    """Dependent constraints have impulses for it at no part of the restitution but none."""
    asked = []

    def solve(solver, kept):
        asked.append(kept)
        return np.zeros(2) if kept == 0.0 else None

    problem = SimpleNamespace(solve=solve, rebound=np.ones(3), work=lambda y: (-3.0, -1e-3, 10.0), driven=False)
    monkeypatch.setattr(impact, "_Problem", lambda *arguments: problem)
    monkeypatch.setattr(impact, "unwhiten", lambda system, y: y)
    found = impact.apply_impact(SimpleNamespace(v=np.zeros(2)), None, [], [], {})
    assert found.kept == 0.0 and asked == [1.0, 0.0]


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


def carrying(mu=0.4):
    """A contact and its resistance, whose third row is missing."""
    problem = object.__new__(impact._Problem)
    problem.system = SimpleNamespace(owner=lambda item: 0)
    problem.impossible = False
    problem.units, problem.normals, problem.radii, problem.slides, problem.lifted = {0: 0, 1: 1}, {}, {}, {}, {}
    problem.before, problem.start, problem.base = np.zeros(6), np.zeros(4), np.zeros(6)
    problem.stack = problem.reduced = np.vstack([np.eye(6)[[0, 1, 2, 3]]])
    problem.rebound, problem.mu = np.zeros(2), np.array([mu, 0.02])
    problem.normal, problem.tangents = np.array([1.0, 0.0]), np.array([2.0, 2.0])
    problem.sliding = problem.mu
    problem.weights = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.5])
    problem.gram = np.eye(6)
    return problem


@pytest.mark.parametrize("rests", [True, False])
def test_resistances_get_the_load_of_their_contacts(rests):
    """What is missing in the normal direction is the load; below its length times that, turning ends."""
    problem = carrying()
    problem.base[2], problem.rebound[0] = -1.0, -0.5
    problem.base[3] = -0.01 if rests else -0.3
    y = problem.solve(None, 0.8)
    assert y == pytest.approx([0.0, 0.0, 1.4, 0.01 if rests else 0.02 * 1.4], abs=1e-12)
    assert problem.forces[4:].tolist() == [0.0, 0.0]
    # no load
    problem.base[2] = problem.rebound[0] = 1.0
    assert problem.solve(None, 1.0) == pytest.approx(np.zeros(4), abs=1e-12)


# ---------------------------------------------------------------------------------------------- units and equations

# a contact with an ellipse, one without friction, bilateral ones: on a curve, with an ellipse, ideal, with one tangent,
# without friction; and one that does not take part. Resistances of the first, of that on a curve, and of the last
CLOSED, ENDS = [0, 1, 2, 3, 4, 5, 6], [0, 2]
ELLIPSE = np.array([[1.2, 0.3], [0.3, 0.7]])
EQUATIONS = [(2, 1), (2, 2), (3, 2), (4, 2), (4, 0), (4, 1), (5, 2), (6, 2)]


def colliding(seed, nv=26):
    rng = np.random.default_rng(seed)
    n = 14
    integers, numbers = np.zeros((n, CONTACT_INTS), dtype=np.int64), np.zeros((n, CONTACT_REALS))
    integers[:, TANGENTS], integers[[0, 1, 7], UNILATERAL] = 2, 1
    integers[[2, 5, 12], TANGENTS], integers[2, PATTERN] = 1, ON_CURVE
    integers[[0, 3], ANISOTROPIC] = 1
    numbers[:, [SCALING_11, SCALING_12, SCALING_22]] = 1.2, 0.3, 0.7
    numbers[:, MU] = rng.uniform(0.2, 0.4, n)
    numbers[[1, 6], MU], numbers[4, MU] = 0.0, math.inf
    integers[11:, OWNER] = 0, 2, 7
    limits = np.zeros((3, JOINT_INTS), dtype=np.int64)
    limits[:, JOINT_END] = 1, 0, -1
    rows = 0.1 * rng.normal(size=(n, 3, nv))
    for i in range(n):
        for row in range(3):
            rows[i, row, (2 * i + row) % nv] += 1.0
    return SimpleNamespace(
        nv=nv, nc=8, ng=3, v=np.zeros(nv), contact_int=integers, contact_real=numbers, joint_int=limits, rows=rows,
        factor=np.eye(nv) + 0.1 * np.tril(rng.normal(size=(nv, nv))), slip=rng.normal(size=(n, 3)),
        basis=np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(n)]),
        side_int=np.zeros((16, SIDE_INTS), dtype=np.int64), resisting=lambda: [11, 12, 13],
        owner=lambda i: int(integers[i, OWNER]) if i >= 11 else i,
    )  # fmt: skip


def units(system):
    """(item, rows along which it has impulses, shape of its cone or None) of each unit, in their order."""
    return [
        (0, [0, 1, 2], ELLIPSE), (1, [2], None), (2, [0], None), (3, [0, 1], ELLIPSE), (5, [0], None),
        (11, [0, 1], None), (12, [0], None), (8, [2], None), (10, [2], None),
    ]  # fmt: skip


def velocities_of(system):
    out = np.einsum("cij,cj->ci", system.basis, system.slip)
    # of joint coordinates the third number is the velocity itself
    out[8:11] = system.slip[8:11]
    return out


@pytest.mark.parametrize("seed", range(3))
def test_units_and_equations_of_an_impact(seed):
    system = colliding(seed)
    # a tangent that nothing moves along
    system.rows[0, 1] = 0.0
    problem = impact._Problem(system, CLOSED, ENDS, {0: 0.5, 1: 0.25})
    velocity, whiten = velocities_of(system), np.linalg.inv(system.factor.T)
    stack, before = np.zeros((9, 3, system.nv)), np.zeros((9, 3))
    for u, (item, rows, shape) in enumerate(units(system)):
        # an upper end stops what goes up
        sign = -1.0 if item == 8 else 1.0
        stack[u, rows], before[u, rows] = sign * system.rows[item, rows] @ whiten.T, sign * velocity[item, rows]
        if shape is not None:
            stack[u, :2], before[u, :2] = shape @ stack[u, :2], shape @ before[u, :2]
    assert problem.stack == pytest.approx(stack.reshape(27, -1).T, abs=1e-13)
    assert problem.before == pytest.approx(before.ravel(), abs=1e-14)
    mu = system.contact_real[:, MU]
    assert problem.sliding == pytest.approx([mu[0], 0.0, mu[2], mu[3], mu[5], mu[11], mu[12], 0.0, 0.0])
    approach = np.minimum(velocity[:2, 2], 0.0)
    assert problem.rebound == pytest.approx([0.5 * approach[0], 0.25 * approach[1]] + [0.0] * 7)
    # which impulses are the loads of what
    assert problem.normals == {2: [0, 1], 3: [2], 4: [3], 5: [6], 6: [7]}
    forces = np.random.default_rng(seed).normal(size=27)
    y = problem.start + problem.reduced @ forces
    impulses = np.linalg.lstsq(problem.equations.T, y - problem.stack @ forces)[0]
    posed = problem.loads()
    loads = posed.radius_base + posed.radius_rows @ forces
    expected = np.zeros((9, 2))
    expected[[0, 1, 5, 7, 8], 0] = forces[[2, 5, 2, 23, 26]]
    expected[2] = expected[6] = impulses[[0, 1]]
    expected[[3, 4], 0] = impulses[[2, 6]]
    assert loads.reshape(-1, 2) == pytest.approx(expected, abs=1e-12)
    assert problem.contacts == 7
    equations = np.array([system.rows[c, row] for c, row in EQUATIONS]) @ whiten.T
    assert problem.equations == pytest.approx(equations, abs=1e-13)
    # the least change that fulfils them, and what impulses do besides
    wanted = -np.array([velocity[c, row] for c, row in EQUATIONS])
    assert problem.start == pytest.approx(np.linalg.pinv(equations) @ wanted, abs=1e-12)
    projection = np.eye(system.nv) - np.linalg.pinv(equations) @ equations
    assert problem.reduced == pytest.approx(projection @ problem.stack, abs=1e-12)
    assert not problem.driven
    for column in (MOTION_KIND, TIME_DEPENDENT):
        for c, driven in ((0, True), (6, True), (7, False)):
            for side in (0, 1):
                system.side_int[:] = 0
                system.side_int[2 * c + side, column] = 3
                assert impact._Problem(system, CLOSED, ENDS, {}).driven is driven


def test_equations_that_say_the_same():
    """Redundant bilateral contacts share; without equations or units there is nothing to project."""
    system = colliding(1)
    system.rows[6], system.slip[6], system.basis[6] = system.rows[3], system.slip[3], system.basis[3]
    system.rows[3, :2] = system.rows[6, :2] = 0.0
    problem = impact._Problem(system, [3, 6], [], {})
    row = np.linalg.solve(system.factor.T, system.rows[3, 2])
    assert problem.start == pytest.approx(-row * velocities_of(system)[3, 2] / (row @ row), abs=1e-12)
    assert problem.equations @ problem.reduced == pytest.approx(np.zeros((2, 3)), abs=1e-12)
    alone = impact._Problem(system, [0], [], {})
    assert not alone.start.any()
    assert alone.reduced is alone.stack
    nothing = impact._Problem(system, [6], [], {})
    assert nothing.stack.shape == (system.nv, 0)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kept", [0.4, 1.0])
def test_impulses_obey_the_laws_of_all_units(kept, seed):
    """Newton's restitution of what is unilateral, equations of the rest, Coulomb's law with the loads' impulses."""
    system = colliding(seed)
    problem = impact._Problem(system, CLOSED, ENDS, {0: 0.5, 1: 0.25})
    y = problem.solve(ContactSolver(), kept)
    assert y is not None
    velocity = velocities_of(system)
    after = velocity + np.einsum("irk,k->ir", system.rows, np.linalg.solve(system.factor, y))
    for c, row in EQUATIONS:
        assert after[c, row] == pytest.approx(0.0, abs=1e-9)
    # all of it is the work of the units and equations
    rest = np.linalg.lstsq(problem.equations.T, y - problem.stack @ problem.forces)
    assert problem.equations.T @ rest[0] + problem.stack @ problem.forces == pytest.approx(y, abs=1e-9)
    normals = dict(zip(EQUATIONS, rest[0].tolist()))
    forces = problem.forces.reshape(-1, 3)
    loads = {0: forces[0, 2], 1: forces[1, 2], 2: math.hypot(normals[2, 1], normals[2, 2]), 3: abs(normals[3, 2]),
             5: abs(normals[5, 2])}  # fmt: skip
    loads |= {11: loads[0], 12: loads[2]}
    for u, (item, rows, shape) in enumerate(units(system)):
        w = (-1.0 if item == 8 else 1.0) * after[item]
        if 2 in rows:
            rebound = kept * {0: 0.5, 1: 0.25}.get(item, 0.0) * min(velocity[item, 2], 0.0)
            assert min(forces[u, 2], w[2] + rebound) == pytest.approx(0.0, abs=1e-9)
        tangents = [row for row in rows if row < 2]
        if not tangents:
            continue
        slip = shape @ w[:2] if shape is not None else w[tangents]
        aim = forces[u, tangents] - slip
        radius = system.contact_real[item, MU] * loads[item]
        length = np.linalg.norm(aim)
        # 1e-10 of the cones, 1e-12 of loads
        assert forces[u, tangents] == pytest.approx(aim * min(1.0, radius / length), abs=1e-8)
    # with what is missing at rest
    assert not forces[:, 2][[2, 3, 4, 5, 6]].any()


def test_coefficients_at_the_speed_before():
    system = colliding(2)
    assert impact.coefficient(system, 3) == system.contact_real[3, MU]
    system.contact_real[:, CURVE_SPEED] = 0.5
    system.contacts = [SimpleNamespace(friction=pc.Stribeck(0.2, 0.6, 0.5))] * 6
    for c, tangents in ((3, 2), (5, 1)):
        speed = np.linalg.norm(velocities_of(system)[c, :tangents])
        expected = 0.2 + 0.4 * math.exp(-((speed / 0.5) ** 2))
        assert impact.coefficient(system, c) == pytest.approx(expected, rel=1e-12)


def test_work_on_drives_is_what_the_joints_receive_besides(monkeypatch):
    """Of impulses y along the mean of both velocities, in whitened ones."""
    system = colliding(3, 28)
    system.v = np.random.default_rng(3).normal(size=28)
    problem = Bouncing(1.0)
    y = np.random.default_rng(4).normal(size=28)
    problem.driven, problem.solve = True, lambda solver, kept: y
    problem.work = lambda y: (-3.0, -1e-3, 10.0)
    monkeypatch.setattr(impact, "_Problem", lambda *arguments: problem)
    before = system.v.copy()
    found = impact.apply_impact(system, None, [], [], {})
    assert system.factor @ (system.v - before) == pytest.approx(y, abs=1e-12)
    mass = system.factor.T @ system.factor
    received = 0.5 * (system.v @ mass @ system.v - before @ mass @ before)
    assert found.drives == pytest.approx(received + 3.0 + 1e-3, rel=1e-11)


@pytest.mark.parametrize("share", [0.9e-9, 1.1e-9])
def test_work_within_round_off_is_none(share, monkeypatch):
    problem = Bouncing(1.0)
    problem.work = lambda y: (10.0 * share + 1e-3, -1e-3, 10.0)
    monkeypatch.setattr(impact, "_Problem", lambda *arguments: problem)
    monkeypatch.setattr(impact, "unwhiten", lambda system, y: y)
    found = impact.apply_impact(SimpleNamespace(v=np.zeros(2)), None, [], [], {})
    assert (found.kept == 1.0) == (share < 1e-9)


def test_missing_rows_are_as_heavy_as_the_others():
    """Light ones, too; a unit without any has the weight 1."""
    stack = np.diag([0.1, 0.2, 0.0, 0.0, 0.0, 0.0])
    gram, weights = delassus(stack)
    assert weights == pytest.approx([0.0, 0.0, 0.04, 1.0, 1.0, 1.0], abs=1e-16)
    assert gram == pytest.approx(np.diag([0.01, 0.04, 0.04, 1.0, 1.0, 1.0]), abs=1e-16)


@pytest.mark.parametrize("size", [(5, 4), (61, 61), (120, 40)])
def test_large_products_are_made_in_parts(size):
    """Columns that are missing, two of three as those of joints or whole units, and more than BLAS does alone."""
    rng = np.random.default_rng(sum(size))
    nv, n = size
    stack = rng.normal(size=(nv, 3 * n)) * np.tile([0.0, 0.0, 1.0] if nv > 100 else [1.0, 0.0, 1.0], n)
    stack[:, :3] = 0.0
    gram, weights = delassus(stack)
    # round-off of sums of up to 120 numbers
    np.testing.assert_allclose(gram - np.diag(weights), stack.T @ stack, rtol=0.0, atol=1e-12 * nv)
    np.testing.assert_array_equal(weights > 0.0, ~stack.any(axis=0))
