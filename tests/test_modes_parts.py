"""Parts of the choice of modes, each alone, on systems of random rows: contact problems and their solutions."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from pincontact.dynamics.directions import slip_direction
from pincontact.dynamics.modes import ModeSolver
from pincontact.friction import cone
from pincontact.friction.loads import LARGE_FRICTION
from pincontact.geometry.patterns import ON_CURVE
from pincontact.layout import (
    ANISOTROPIC,
    CONTACT_INTS,
    CONTACT_REALS,
    FRICTION_EVENT,
    FRICTIONLESS,
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
    PATTERN,
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
# contacts: two that slide (one along one tangent), one without friction, or ideal, and two that may stick, of which one
# is anisotropic, one has one tangent; held: at no end, at the lower and at the upper one; resistances to turning of two
CONTACTS, HELD, RESISTING = [0, 1, 2, 3, 4], [0, 1, 2], [8, 9]
ELLIPSE = np.array([[1.2, 0.3], [0.3, 0.7]])


def made(rng, ideal=False, bilateral=()):
    """A system after an evaluation, and its solver: rows of 24 velocities in all. bilateral: which contacts are."""
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
    integers[list(bilateral), UNILATERAL] = 0
    numbers[2, MU] = numbers[2, MU_NOW] = math.inf if ideal else 0.0
    if not ideal:
        integers[2, MODE] = FRICTIONLESS
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
        owner=lambda i: int(integers[i, OWNER]) if i > 7 else i, resisting=lambda: RESISTING,
    )  # fmt: skip
    solver = ModeSolver(system)
    solver._limits[:] = numbers[:, MU] * 1.2
    return system, solver


def motion(system, forces):
    """(n, 3) relative accelerations along all rows under forces (n, 3) of all items."""
    inverse = np.linalg.inv(system.factor.T @ system.factor)
    acceleration = system.free_acceleration + inverse @ np.einsum("irk,ir->k", system.rows, forces)
    return system.rows @ acceleration + system.bias


BILATERAL = pytest.mark.parametrize("bilateral", [(), (1, 4), (0, 2, 3)])


def rows_of(system, item):
    """Rows along which an item has forces that a unit knows."""
    if 5 <= item <= 7:
        return [2]
    tangents = list(range(int(system.contact_int[item, TANGENTS])))
    if item in RESISTING:
        return tangents
    friction = system.contact_real[item, MU] > 0.0
    return (tangents if friction else []) + [2]


@SEEDS
@BILATERAL
@pytest.mark.parametrize("ideal", [False, True])
def test_problems_are_those_of_the_motion(ideal, bilateral, seed):
    """Velocities of the units are accelerations that their forces make, together with those of the equations."""
    rng = np.random.default_rng(seed)
    system, solver = made(rng, ideal, bilateral)
    problem = solver._pose(CONTACTS, HELD)
    items = [i for i in (0, 1, 2, 3, 4, 8, 9, 5, 6, 7) if i != 2 or i not in bilateral]
    assert list(problem.units) == items
    assert list(problem.normals) == sorted(bilateral)
    assert list(problem.shapes) == [problem.units[3]]
    assert problem.shapes[problem.units[3]] == pytest.approx(ELLIPSE)
    wanted = np.where(system.contact_int[:, MODE] == SLIPPING, system.contact_real[:, MU_NOW], solver._limits)
    wanted[5:8] = 1.0, 0.0, 0.0
    assert problem.mu == pytest.approx(wanted[items])
    units = rng.normal(size=problem.base.size)
    forces = problem.of_items(units, True)
    forces[5:8, 2] += 0.05, -0.3, 0.2
    relative = motion(system, forces)
    velocities = problem.of_items(problem.gram @ units + problem.base, False)
    for item in items:
        rows = [row for row in rows_of(system, item) if row != 2 or item not in bilateral]
        assert velocities[item, rows] == pytest.approx(relative[item, rows], abs=1e-11)
    for c in bilateral:
        assert relative[c, 2] == pytest.approx(0.0, abs=1e-11)
        if c == 2 and ideal:
            assert relative[c] == pytest.approx(np.zeros(3), abs=1e-11)
    # there and back
    missing = problem.weights > 0.0
    assert problem.of_units(problem.of_items(units, True))[~missing] == pytest.approx(units[~missing], abs=1e-13)
    assert missing.sum() == sum(3 - len([r for r in rows_of(system, i) if r != 2 or i not in bilateral]) for i in items)


def on_disk(aim, radius):
    length = np.linalg.norm(aim)
    return aim * min(1.0, radius / length) if length > 0.0 else aim


@SEEDS
@BILATERAL
@pytest.mark.parametrize("ideal", [False, True])
def test_solutions_follow_the_laws_of_what_slides_and_what_rests(ideal, bilateral, seed):
    rng = np.random.default_rng([1, seed])
    system, solver = made(rng, ideal, bilateral)
    problem = solver._pose(CONTACTS, HELD)
    assert not problem.is_cone
    solution = solver._solve_posed(problem, HELD)
    assert solution is not None
    assert solution.residual <= 1e-9
    assert solver.cone_problems == 1
    forces, modes = solution.forces, solution.modes
    relative, close = motion(system, forces), 1e-9
    normal = forces[:, 2]
    for c in CONTACTS:
        if c in bilateral:
            assert relative[c, 2] == pytest.approx(0.0, abs=close)
            continue
        assert min(normal[c], relative[c, 2]) == pytest.approx(0.0, abs=close)
    load = np.abs(normal)
    along = (system.basis[0, :2] @ system.slip[0]) / np.linalg.norm(system.basis[0, :2] @ system.slip[0])
    mu = system.contact_real[:, MU_NOW]
    assert forces[0, :2] == pytest.approx(-mu[0] * load[0] * along, abs=close)
    assert forces[1, :2] == pytest.approx([mu[1] * load[1], 0.0], abs=close)
    assert forces[9, :2] == pytest.approx([-mu[9] * load[1], 0.0], abs=close)
    # an ellipse in the coordinates in which it is round
    round_force, round_slip = np.linalg.solve(ELLIPSE, forces[3, :2]), ELLIPSE @ relative[3, :2]
    discs = [
        (3, round_force, round_slip, solver._limits[3] * load[3]),
        (4, forces[4, :1], relative[4, :1], solver._limits[4] * load[4]),
        (5, forces[5, 2:] - 0.05, relative[5, 2:], 0.25),
        (8, forces[8, :2], relative[8, :2], solver._limits[8] * load[2]),
    ]
    for item, force, slip, radius in discs:
        assert force == pytest.approx(on_disk(force - slip, radius), abs=close)
        if radius > 1e-9 and np.linalg.norm(slip) > 1e-6:
            assert modes[item] == cone.SLIP
    # ends only push
    assert min(normal[6] + 0.3, relative[6, 2]) == pytest.approx(0.0, abs=close)
    assert min(0.2 - normal[7], -relative[7, 2]) == pytest.approx(0.0, abs=close)
    if ideal and 2 in bilateral:
        assert relative[2] == pytest.approx(np.zeros(3), abs=close)
    elif ideal:
        # that slips at most which friction holds up, with next to no load
        pull = np.linalg.norm(forces[2, :2])
        assert np.abs(relative[2, :2]).max() < close or normal[2] <= 1.001 * pull / LARGE_FRICTION
    else:
        assert not forces[2, :2].any()
    for c in CONTACTS:
        # ideal rolling may slide without a load
        if c not in bilateral and not (ideal and c == 2):
            assert (modes[c] == cone.OPEN) == (normal[c] <= 1e-12)


@SEEDS
@pytest.mark.parametrize("tangents", [1, 2])
def test_what_friction_holds_up_goes_with_its_friction(tangents, seed):
    """Ideal rolling that slides has no normal force: friction against its slip keeps it closed, or it opens."""
    rng = np.random.default_rng([4, seed, tangents])
    system, solver = made(rng, ideal=True)
    system.contact_int[2, [MODE, TANGENTS, SLIP_SIGN]] = SLIPPING, tangents, 1
    # it turns the bodies such that it lifts
    direction = slip_direction(system, 2)
    system.rows[2, 2] -= 0.5 * direction @ system.rows[2, :2]
    solution = solver._solve_posed(solver._pose([2], []), [])
    relative = motion(system, solution.forces)
    pull = -solution.forces[2, :2] @ direction
    assert solution.forces[2] == pytest.approx([*(-pull * direction), 0.0], abs=1e-12)
    assert min(pull, relative[2, 2]) == pytest.approx(0.0, abs=1e-9)
    assert solution.modes[2] == (cone.OPEN if pull == 0.0 else cone.STICK)


@SEEDS
def test_solutions_begin_from_the_last_forces(seed, monkeypatch):
    """In the coordinates in which cones are round; what pulls begins from none. What slides goes with the loads."""
    rng = np.random.default_rng([2, seed])
    system, solver = made(rng, bilateral=(4,))
    system.force = rng.normal(size=(10, 3))
    problem = solver._pose(CONTACTS, HELD)
    asked = []
    monkeypatch.setattr(solver.loads, "solve", lambda loads, start, guess: asked.append((loads, start)))
    assert solver._solve_posed(problem, HELD) is None
    (loads, start) = asked[0]
    start = dict(zip(problem.units, start.reshape(-1, 3)))
    for c in range(4):
        assert start[c][2] == max(system.force[c, 2], 0.0)
    assert start[3][:2] == pytest.approx(np.linalg.solve(ELLIPSE, system.force[3, :2]), abs=1e-14)
    assert start[4].tolist() == [system.force[4, 0], 0.0, 0.0]
    assert start[8].tolist() == [*system.force[8, :2], 0.0]
    assert start[5].tolist() == pytest.approx([system.force[5, 2] - 0.05, 0.0, 0.0])
    places = problem.units
    assert np.flatnonzero(loads.normal).tolist() == sorted(places[i] for i in (0, 1, 2, 3, 6, 7))
    assert np.flatnonzero((loads.drag != np.eye(30)).any(axis=0)).tolist() == [2, 5]
    discs = np.flatnonzero(loads.mu * loads.tangents)
    assert sorted(discs.tolist()) == sorted(places[i] for i in (3, 4, 5, 8, 9))
    carriers = {i: np.flatnonzero(loads.radius_rows[2 * places[i]]).tolist() for i in (3, 5, 8, 9)}
    assert carriers == {3: [11], 5: [], 8: [8], 9: [5]}
    assert loads.radius_base[2 * places[5]] == 0.25
    # of what slides already only the turning has a disc
    assert np.flatnonzero(loads.along).tolist() == [2 * places[9]]


@SEEDS
def test_guesses_are_symmetric_problems(seed, monkeypatch):
    """What slides has a velocity along, and its friction a limit; discs have the radii of the present loads."""
    rng = np.random.default_rng([5, seed])
    system, solver = made(rng)
    system.force = rng.normal(size=(10, 3))
    system.force[[1, 2], 2] = 1.5, 2.5
    problem = solver._pose(CONTACTS, HELD)
    guesses, asked = [], []

    class Asked:
        forces = object()

        def solve(self, gram, b, limits):
            asked.append((gram, b, limits))
            return len(asked) < 2

    solver.__dict__["solver"] = Asked()
    monkeypatch.setattr(solver.loads, "solve", lambda loads, start, guess: guesses.append(guess))
    solver._solve_posed(problem, HELD)
    assert guesses[0](7.0) is Asked.forces
    assert guesses[0](7.0) is None
    gram, b, limits = asked[0]
    expected, places = problem.base.copy(), problem.units
    along = system.basis[0, :2] @ system.slip[0]
    expected[:2] += 7.0 * along / np.linalg.norm(along)
    expected[3] -= 7.0
    expected[3 * places[9]] += 7.0
    for item, radius in ((8, solver._limits[8] * 2.5), (9, system.contact_real[9, MU_NOW] * 1.5), (5, 0.25)):
        row = 3 * places[item] + 2
        expected[row] = -radius * problem.weights[row]
    assert gram is problem.gram
    assert b == pytest.approx(expected, abs=1e-12)
    wanted = problem.mu.copy()
    wanted[[places[i] for i in (5, 8, 9)]] = 1.0
    assert limits == pytest.approx(wanted, abs=1e-15)


@SEEDS
@pytest.mark.parametrize("contacts", [[0], [0, 2], [1, 3, 4], [3, 4]])
@BILATERAL
def test_contacts_alone(bilateral, contacts, seed):
    rng = np.random.default_rng([3, seed, len(contacts)])
    system, solver = made(rng, bilateral=bilateral)
    system.resisting = list
    problem = solver._pose(contacts, [])
    slides = min(contacts) < 2 or (bilateral and not {3, 4}.isdisjoint({*bilateral} & {*contacts}))
    assert problem.is_cone == (not slides)
    solution = solver._solve_posed(problem, [])
    forces, relative = solution.forces, motion(system, solution.forces)
    for c in contacts:
        normal, mu = forces[c, 2], system.contact_real[c, MU_NOW]
        if c in bilateral:
            assert relative[c, 2] == pytest.approx(0.0, abs=1e-9)
        else:
            assert min(normal, relative[c, 2]) == pytest.approx(0.0, abs=1e-9)
        if c < 2:
            along = np.array([-1.0, 0.0])
            if c == 0:
                along = system.basis[0, :2] @ system.slip[0]
                along /= np.linalg.norm(along)
            assert forces[c, :2] == pytest.approx(-mu * abs(normal) * along, abs=1e-9)
        elif c > 2:
            count = int(system.contact_int[c, TANGENTS])
            shape = ELLIPSE if c == 3 else np.eye(1)
            force, slip = np.linalg.solve(shape, forces[c, :count]), shape @ relative[c, :count]
            wanted = on_disk(force - slip, solver._limits[c] * abs(normal))
            assert force == pytest.approx(wanted, abs=1e-9)


@SEEDS
@pytest.mark.parametrize("mode", [SLIPPING, STICK])
def test_friction_on_curves_goes_with_both_normals(mode, seed):
    rng = np.random.default_rng([6, seed])
    system, solver = made(rng, bilateral=(1,))
    system.contact_int[1, [PATTERN, MODE]], system.resisting = [ON_CURVE, mode], list
    solution = solver._solve_posed(solver._pose([1, 3], []), [])
    forces, relative = solution.forces, motion(system, solution.forces)
    assert relative[1, 1:] == pytest.approx([0.0, 0.0], abs=1e-9)
    load = math.hypot(*forces[1, 1:])
    assert load > 0.0
    if mode == SLIPPING:
        assert forces[1, 0] == pytest.approx(system.contact_real[1, MU_NOW] * load, abs=1e-9)
    else:
        aim = forces[1, :1] - relative[1, :1]
        assert forces[1, :1] == pytest.approx(on_disk(aim, solver._limits[1] * load), abs=1e-9)


@pytest.mark.parametrize("gap", [-0.3, 0.0, 0.3])
def test_what_equations_decide(gap):
    """A contact whose normal is a combination of bilateral contacts' moves with these, whatever its force: it opens,
    rests, or no force keeps it from closing."""
    system, solver = made(np.random.default_rng(7), bilateral=(2, 4))
    system.rows[3, 2] = 0.3 * system.rows[4, 2] + 0.7 * system.rows[2, 2]
    system.bias[3, 2] = 0.3 * system.bias[4, 2] + 0.7 * system.bias[2, 2] + gap
    problem = solver._pose([2, 3, 4], [])
    normal = 3 * problem.units[3] + 2
    assert not problem.reduced[:, normal].any()
    # no round-off
    assert problem.base[normal] == (pytest.approx(gap, abs=1e-12) if gap else 0.0)
    system.resisting = list
    solution = solver._solve_posed(solver._pose([2, 3, 4], []), [])
    if gap < 0.0:
        assert solution is None
        assert solver.proved
        return
    assert solution.forces[3] == pytest.approx(np.zeros(3), abs=1e-15)
    assert solution.modes[3] == cone.OPEN
    assert solution.velocities[3, 2] == pytest.approx(gap, abs=1e-12)


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
