"""Parts of the choice of modes, each alone, on systems of random rows: cone problems and their solutions by loads."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from pincontact.dynamics.mode_problem import mode_problem
from pincontact.dynamics.modes import ModeSolver
from pincontact.friction import cone
from pincontact.friction.loads import LARGE_FRICTION
from pincontact.layout import (
    ANISOTROPIC,
    CONTACT_INTS,
    CONTACT_REALS,
    FRICTION_EVENT,
    HIGH_FORCE,
    JOINT_END,
    JOINT_INTS,
    JOINT_REALS,
    LOW_FORCE,
    MODE,
    MU,
    MU_NOW,
    NORMAL_EVENT,
    OWNER,
    SCALING_11,
    SCALING_12,
    SCALING_22,
    SLIP_SIGN,
    SLIPPING,
    STICK,
    TANGENTS,
    UNILATERAL,
)

SEEDS = pytest.mark.parametrize("seed", range(6))
# contacts: two that slide (one along one tangent), three undecided ones, of which one is anisotropic, one with one
# tangent; held: at no end, at the lower and at the upper one; resistances to turning of two contacts
CONTACTS, HELD, RESISTING = [0, 1, 2, 3, 4], [0, 1, 2], [8, 9]
ELLIPSE = np.array([[1.2, 0.3], [0.3, 0.7]])


def made(rng, ideal=False):
    """A system after an evaluation, and its solver: rows of 24 velocities in all."""
    n, nv = 10, 24
    integers, numbers = np.zeros((n, CONTACT_INTS), dtype=np.int64), np.zeros((n, CONTACT_REALS))
    integers[:, TANGENTS], integers[:, UNILATERAL], integers[:, MODE] = 2, 1, STICK
    integers[[1, 4], TANGENTS] = 1
    integers[[0, 1], MODE], integers[1, SLIP_SIGN] = SLIPPING, -1
    integers[3, ANISOTROPIC] = 1
    numbers[3, [SCALING_11, SCALING_12, SCALING_22]] = ELLIPSE[0, 0], ELLIPSE[0, 1], ELLIPSE[1, 1]
    integers[9, TANGENTS], integers[9, MODE] = 1, SLIPPING
    integers[9, SLIP_SIGN], integers[8, OWNER], integers[9, OWNER] = 1, 2, 1
    numbers[:, MU] = numbers[:, MU_NOW] = rng.uniform(0.1, 0.4, n)
    if ideal:
        numbers[2, MU] = math.inf
    limits, bounds = np.zeros((3, JOINT_INTS), dtype=np.int64), np.zeros((3, JOINT_REALS))
    limits[:, JOINT_END] = 0, -1, 1
    bounds[:, LOW_FORCE], bounds[:, HIGH_FORCE] = [-0.2, -0.3, -0.1], [0.3, 0.1, 0.2]
    rows = np.zeros((n, 3, nv))
    for i in range(n):
        rows[i] = 0.15 * rng.normal(size=(3, nv))
        for row in range(3):
            rows[i, row, (3 * i + row) % nv] += 1.0
    factor = np.eye(nv) + 0.1 * np.tril(rng.normal(size=(nv, nv)))
    bias, free = 0.1 * rng.normal(size=(n, 3)), rng.normal(size=nv)
    # that of a joint coordinate is its acceleration
    bias[5:8] = 0.0
    for c in CONTACTS:
        # most of them close
        bias[c, 2] = -(rows[c, 2] @ free) - rng.uniform(-0.2, 1.0)
    system = SimpleNamespace(
        nv=nv, nc=5, ng=3, items=n, contact_int=integers, contact_real=numbers, joint_int=limits, joint_real=bounds,
        rows=rows, factor=factor, bias=bias, free_acceleration=free, force=np.zeros((n, 3)),
        basis=np.array([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(n)]), slip=rng.normal(size=(n, 3)),
        owner=lambda i: int(integers[i, OWNER]),
    )  # fmt: skip
    solver = ModeSolver(system)
    solver._limits[:] = numbers[:, MU] * 1.2
    return system, solver


def actual_forces(system, forces, shapes):
    """(n, 3) forces along the rows of all items, from those of the problem's units."""
    out = np.zeros((10, 3))
    for i, c in enumerate(CONTACTS):
        out[c] = forces[i]
        if i in shapes:
            out[c, :2] = shapes[i] @ forces[i, :2]
        if system.contact_int[c, TANGENTS] == 1:
            out[c, 1] = 0.0
    out[5, 2] = 0.05 + forces[5, 0]
    out[6, 2], out[7, 2] = -0.3 + forces[6, 2], 0.2 - forces[7, 2]
    out[8, :2], out[9, 0] = forces[8, :2], forces[9, 0]
    return out


@SEEDS
def test_cone_problems_are_those_of_the_motion(seed):
    """Velocities of the units are accelerations that their forces make; what has no row stands alone."""
    rng = np.random.default_rng(seed)
    system, solver = made(rng, ideal=bool(seed % 2))
    problem = mode_problem(system, solver._limits, CONTACTS, [3, 4], HELD, RESISTING)
    assert problem.turns == {8: 8, 9: 9}
    assert list(problem.shapes) == [3]
    assert problem.shapes[3] == pytest.approx(ELLIPSE)
    limits = solver._limits
    ideal = limits[2] if seed % 2 else 0.0
    assert problem.limits == pytest.approx([0.0, 0.0, ideal, limits[3], limits[4], 1.0, 0.0, 0.0, 1.0, 1.0])
    forces = rng.normal(size=(10, 3))
    inverse = np.linalg.inv(system.factor.T @ system.factor)
    actual = actual_forces(system, forces, problem.shapes)
    acceleration = system.free_acceleration + inverse @ np.einsum("irk,ir->k", system.rows, actual)
    relative = system.rows @ acceleration + system.bias
    velocities = (problem.gram @ forces.ravel() + problem.base).reshape(-1, 3)
    missing = problem.weights.reshape(-1, 3) > 0.0
    expected = np.zeros((10, 3), dtype=bool)
    expected[[1, 4], 1] = expected[5, 1:] = expected[[6, 7], :2] = expected[[8, 9], 2] = expected[9, 1] = True
    assert (missing == expected).all()
    relative[3, :2] = ELLIPSE @ relative[3, :2]
    for g, (column, sign) in enumerate(((0, 1.0), (2, 1.0), (2, -1.0))):
        relative[5 + g, column] = sign * (system.rows[5 + g, 2] @ acceleration)
    assert velocities[~missing] == pytest.approx(relative[~missing], abs=1e-12)
    # a load of the middle of its range, and no other
    alone = problem.weights * forces.ravel()
    alone[17] -= 0.25 * problem.weights[17]
    assert velocities[missing] == pytest.approx(alone.reshape(-1, 3)[missing], abs=1e-12)


def on_disk(aim, radius):
    length = np.linalg.norm(aim)
    return aim * min(1.0, radius / length) if length > 0.0 else aim


@SEEDS
@pytest.mark.parametrize("ideal", [False, True])
def test_solutions_follow_the_laws_of_what_slides_and_what_rests(ideal, seed):
    rng = np.random.default_rng([1, seed])
    system, solver = made(rng, ideal)
    problem = mode_problem(system, solver._limits, CONTACTS, [3, 4], HELD, RESISTING)
    if ideal:
        problem.limits[2] = math.inf
    solution = solver._solve_with_loads(problem, CONTACTS, HELD, RESISTING)
    assert solution is not None
    assert solution.residual <= 1e-9
    assert solver.cone_problems == 1
    forces, modes = solution.forces, solution.modes
    velocities = (problem.gram @ forces.ravel() + problem.base).reshape(-1, 3)
    close = 1e-9
    missing = problem.weights.reshape(-1, 3) > 0.0
    assert solution.velocities[~missing] == pytest.approx(velocities[~missing], abs=close)
    normal = forces[:, 2]
    for i in (*range(5), 6, 7):
        assert normal[i] >= -close
        assert velocities[i, 2] >= -close
        assert normal[i] * velocities[i, 2] == pytest.approx(0.0, abs=close)
    along = (system.basis[0, :2] @ system.slip[0]) / np.linalg.norm(system.basis[0, :2] @ system.slip[0])
    mu = system.contact_real[:, MU_NOW]
    assert forces[0, :2] == pytest.approx(-mu[0] * normal[0] * along, abs=close)
    assert forces[1, :2] == pytest.approx([mu[1] * normal[1], 0.0], abs=close)
    assert forces[9, :2] == pytest.approx([-mu[9] * normal[1], 0.0], abs=close)
    disks = [(3, 2, problem.limits[3] * normal[3]), (4, 1, problem.limits[4] * normal[4]), (5, 1, 0.25)]
    disks.append((8, 2, solver._limits[8] * normal[2]))
    for i, count, radius in disks:
        aim = forces[i, :count] - velocities[i, :count]
        assert forces[i, :count] == pytest.approx(on_disk(aim, max(radius, 0.0)), abs=close)
        if radius > 1e-9 and np.linalg.norm(velocities[i, :count]) > 1e-6:
            assert modes[i] == cone.SLIP
    if ideal:
        # that slips at most which friction holds up, with next to no load
        pull = np.linalg.norm(forces[2, :2])
        assert np.abs(velocities[2, :2]).max() < close or normal[2] <= 1.001 * pull / LARGE_FRICTION
    elif not ideal:
        assert not forces[2, :2].any()
    for i in range(5):
        # ideal rolling may slide without a load
        if not (ideal and i == 2):
            assert (modes[i] == cone.OPEN) == (normal[i] <= 1e-12)


@SEEDS
def test_solutions_begin_from_the_last_forces(seed, monkeypatch):
    """In the coordinates in which cones are round; what pulls begins from none. What slides goes with the loads."""
    rng = np.random.default_rng([2, seed])
    system, solver = made(rng)
    system.force = rng.normal(size=(10, 3))
    problem = mode_problem(system, solver._limits, CONTACTS, [3, 4], HELD, RESISTING)
    asked = []
    monkeypatch.setattr(solver.loads, "solve", lambda loads, start, guess: asked.append((loads, start)))
    assert solver._solve_with_loads(problem, CONTACTS, HELD, RESISTING) is None
    (loads, start) = asked[0]
    expected = np.zeros((10, 3))
    expected[:5, 2] = np.maximum(system.force[:5, 2], 0.0)
    expected[3, :2] = np.linalg.solve(ELLIPSE, system.force[3, :2])
    expected[4, :2], expected[8, :2] = system.force[4, :2], system.force[8, :2]
    assert start.reshape(-1, 3) == pytest.approx(expected, abs=1e-14)
    assert np.flatnonzero(loads.normal).tolist() == [0, 1, 2, 3, 4, 6, 7]
    assert np.flatnonzero((loads.drag != np.eye(30)).any(axis=0)).tolist() == [2, 5]
    discs = np.flatnonzero(loads.mu * loads.tangents)
    assert discs.tolist() == [3, 4, 5, 8]
    assert loads.tangents[discs].tolist() == [2.0, 1.0, 1.0, 2.0]
    carriers = [np.flatnonzero(loads.radius_rows[2 * i]).tolist() for i in discs]
    assert carriers == [[11], [14], [], [8]]
    assert loads.radius_base[10] == 0.25


@SEEDS
@pytest.mark.parametrize("contacts", [[0], [0, 2], [1, 3, 4]])
def test_contacts_alone(contacts, seed):
    rng = np.random.default_rng([3, seed, len(contacts)])
    system, solver = made(rng)
    problem = mode_problem(system, solver._limits, contacts, [c for c in contacts if c > 1], [], [])
    assert problem.gram.shape == (3 * len(contacts),) * 2
    solution = solver._solve_with_loads(problem, contacts, [], [])
    forces, velocities = solution.forces, (problem.gram @ solution.forces.ravel() + problem.base).reshape(-1, 3)
    for i, c in enumerate(contacts):
        normal, mu = forces[i, 2], system.contact_real[c, MU_NOW]
        assert min(normal, velocities[i, 2]) == pytest.approx(0.0, abs=1e-9)
        if c < 2:
            along = np.array([-1.0, 0.0])
            if c == 0:
                along = system.basis[0, :2] @ system.slip[0]
                along /= np.linalg.norm(along)
            assert forces[i, :2] == pytest.approx(-mu * normal * along, abs=1e-9)
        else:
            count = int(system.contact_int[c, TANGENTS])
            aim = forces[i, :count] - velocities[i, :count]
            wanted = on_disk(aim, problem.limits[i] * normal)
            assert forces[i, :count] == pytest.approx(wanted, abs=1e-9)


def test_whether_all_forces_lie_inside_their_cones():
    """Of closed contacts, held coordinates and resistances of closed contacts, and of no others; zero is inside."""
    solver = object.__new__(ModeSolver)
    event_functions = np.ones((9, 5))
    solver.system = SimpleNamespace(
        nc=3, ng=3, event_functions=event_functions, closed=lambda: [0, 2], held=lambda: [1], resisting=lambda: [7]
    )
    watched = {(i, margin) for i in (0, 2, 4, 7) for margin in (NORMAL_EVENT, FRICTION_EVENT)}
    assert solver._holds()
    for i in range(9):
        for margin in range(5):
            for value in (0.0, -1e-12):
                event_functions[i, margin] = value
                assert solver._holds() == (value == 0.0 or (i, margin) not in watched)
            event_functions[i, margin] = 1.0
