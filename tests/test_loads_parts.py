"""Contacts and discs whose radii follow from the forces: the parts of the solver, each alone."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from pincontact.friction import loads
from pincontact.friction.cone import OPEN, SLIP, STICK
from pincontact.friction.loads import LARGE_FRICTION, Loads, gauss_seidel_loads
from pincontact.friction.scaled_loads import TOLERANCE, Chosen, ScaledLoads, radius_at

SEEDS = pytest.mark.parametrize("seed", range(6))


def made_problem(rng, given=False, slides=()):
    """Units of all kinds: contacts with two tangents, with one and with none, a resistance to turning of the first
    contact's load, a bilateral contact whose load is a combination of forces, dry friction, and no force at all.
    given: radii are numbers; slides: which of them have a direction of slip."""
    n = 7
    factor = np.eye(3 * n) + 0.25 * rng.normal(size=(3 * n, 3 * n)) / math.sqrt(n)
    scales = np.repeat(10.0 ** rng.uniform(-0.5, 0.5, n), 3)
    gram = scales[:, None] * (factor @ factor.T) * scales
    normal = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    tangents = np.array([2.0, 1.0, 0.0, 2.0, 2.0, 1.0, 0.0])
    mu = np.array([0.8, 0.3, 0.0, 0.2, 0.5, 1.0, 0.0])
    radius_base, radius_rows = np.zeros(2 * n), np.zeros((2 * n, 3 * n))
    radius_base[10] = 0.3
    if given:
        mu[:], radius_base[::2] = 1.0, rng.uniform(0.1, 1.0, n)
    else:
        radius_rows[0, 2] = radius_rows[2, 5] = radius_rows[6, 2] = 1.0
        radius_rows[8:10], radius_base[8:10] = 0.1 * rng.normal(size=(2, 3 * n)), rng.normal(size=2)
    base = scales * rng.normal(size=3 * n)
    base[2:9:3] -= 1.0 * scales[2:9:3]
    directions = np.zeros((n, 2))
    for i in slides:
        directions[i, : int(tangents[i])] = on_circle = rng.normal(size=int(tangents[i]))
        directions[i] /= np.linalg.norm(on_circle)
    return Loads(gram, base, normal, tangents, mu, radius_base, radius_rows, directions=directions.ravel())


def swept(problem):
    """What `gauss_seidel_loads` is given of a problem."""
    one, two = (problem.gram, problem.normal, problem.tangents), (problem.radius_base, problem.radius_rows)
    return *one, problem.coefficients, *two, problem.along


def radii_at(problem, forces):
    load = (problem.radius_base + problem.radius_rows @ forces).reshape(-1, 2)
    return [mu * math.hypot(*pair) for mu, pair in zip(problem.mu, load)]


def follows_the_laws(problem, forces, radii, accuracy):
    """Each unit's modes, once it is clear that its law holds."""
    u, modes = problem.gram @ forces + problem.base, []
    for i, radius in enumerate(radii):
        k, count, stiffness = 3 * i, int(problem.tangents[i]), problem.gram[3 * i, 3 * i]
        forces_t, u_t = forces[k : k + count], u[k : k + count]
        assert not forces[k + count : k + 2].any()
        if problem.normal[i]:
            assert forces[k + 2] >= -1e-15
            assert u[k + 2] >= -accuracy
            assert forces[k + 2] * u[k + 2] == pytest.approx(0.0, abs=accuracy)
        else:
            assert forces[k + 2] == 0.0
        if np.linalg.norm(u_t) > accuracy:
            assert forces_t == pytest.approx(-radius * u_t / np.linalg.norm(u_t), abs=accuracy / stiffness)
        assert np.linalg.norm(forces_t) <= radius + accuracy / stiffness
        is_open = forces[k + 2] == 0.0 if problem.normal[i] else radius == 0.0
        slips = np.linalg.norm(u_t) > accuracy or problem.mu[i] == 0.0
        modes.append(OPEN if is_open else SLIP if slips else STICK)
    return modes


def radii_of(problem):
    return problem.radius_base, problem.radius_rows


@SEEDS
def test_solutions_follow_the_laws(seed):
    rng = np.random.default_rng(seed)
    problem = made_problem(rng)
    forces, residual = problem.solve(rng.normal(size=problem.base.size))
    assert residual <= TOLERANCE
    assert problem.radii(forces) == pytest.approx(radii_at(problem, forces), rel=1e-13)
    # zero, where they are but for round-off
    forces[np.abs(forces) < 1e-15] = 0.0
    # a residual of 1e-10 in units of the problem
    modes = follows_the_laws(problem, forces, radii_at(problem, forces), 1e-8)
    assert problem.modes(forces).tolist() == modes
    # once found it is kept, after the first sweeps, and from no forces it is the same
    again, _ = problem.solve(np.zeros_like(forces))
    assert again == pytest.approx(forces, abs=1e-8)


@SEEDS
@pytest.mark.parametrize("slides", [(4,), (3, 4, 5)])
def test_what_slides_goes_on_along_its_direction(slides, seed):
    """Whatever the signs of the loads: friction has the length of their norm, against the slip."""
    problem = made_problem(np.random.default_rng([7, seed]), slides=slides)
    # low enough that every load decides alone
    problem.mu[4] = 0.1
    forces, residual = problem.solve(np.zeros(problem.base.size))
    assert residual <= TOLERANCE
    radii = radii_at(problem, forces)
    for i in slides:
        direction = problem.directions[2 * i : 2 * i + 2]
        assert forces[3 * i : 3 * i + 2] == pytest.approx(-radii[i] * direction, abs=1e-9)
        assert problem.modes(forces)[i] == (SLIP if radii[i] > 0.0 else OPEN)
    # with it, all else obeys its law; what slides is pushed along
    u = problem.gram @ forces + problem.base
    pushed = replace(problem, base=problem.base.copy())
    for i in slides:
        pushed.base[3 * i : 3 * i + 2] += problem.directions[2 * i : 2 * i + 2] - u[3 * i : 3 * i + 2]
    follows_the_laws(pushed, forces, radii, 1e-8)
    again, residual = problem.refine(forces + 1e-3 * np.random.default_rng(seed).normal(size=forces.size))
    assert residual <= TOLERANCE
    assert again == pytest.approx(forces, abs=1e-8)


@SEEDS
def test_derivatives_of_what_has_to_vanish(seed):
    """Against differences, whose error is that of second derivatives: 1e-6 squared, over 1e-6."""
    rng = np.random.default_rng([8, seed])
    scaled = ScaledLoads(made_problem(rng, slides=(4,)))
    y = rng.normal(size=scaled.rows.size)
    columns = [scaled.equations(y + 1e-6 * d)[0] - scaled.equations(y - 1e-6 * d)[0] for d in np.eye(y.size)]
    assert scaled.equations(y)[1] == pytest.approx(np.array(columns).T / 2e-6, abs=1e-7)


@SEEDS
def test_signs_of_loads_may_be_chosen(seed):
    """Friction of known direction under a load of known sign: linear; where the load has the other one, no solution."""
    rng = np.random.default_rng([9, seed])
    problem = made_problem(rng, slides=(4,))
    # that of dry friction, of the others none; a load of one number
    problem.mu[[0, 1, 3]], problem.radius_rows[9], problem.radius_base[9] = 0.0, 0.0, 0.0
    problem.mu[4] = 0.1
    scaled = ScaledLoads(problem)
    assert scaled.discs["along_1"][scaled.discs["signed"] != 0].any() and scaled.discs["signed"].sum() == 1
    assert (scaled.curved, scaled.choices) == (True, 4)
    found = []
    for signs in ((1.0,), (-1.0,)):
        for loaded in product((True, False), repeat=3):
            y, residual = scaled.newton(np.zeros(scaled.rows.size), Chosen(np.array(loaded), signs))
            if residual <= TOLERANCE:
                forces = scaled.forces(y)
                load = problem.radius_base[8] + problem.radius_rows[8] @ forces
                assert math.copysign(1.0, load) == signs[0]
                found.append(forces)
    assert len(found) == 1
    assert problem.solve(np.zeros(21))[0] == pytest.approx(found[0], abs=1e-8)


@SEEDS
def test_a_load_that_is_round_off_holds_nothing(seed):
    """What moves away is open, whatever rounding leaves of its force."""
    problem = made_problem(np.random.default_rng(seed))
    problem.base[8] = 5.0
    forces, residual = problem.solve(np.zeros(21))
    assert residual <= TOLERANCE
    assert (problem.gram @ forces + problem.base)[8] > 0.1
    forces[8] = 1e-17
    assert problem.modes(forces)[2] == OPEN


def test_all_modes_occur():
    found = set()
    for seed in range(12):
        problem = made_problem(np.random.default_rng(seed))
        modes = problem.modes(problem.solve(np.zeros(21))[0])
        found |= {(i, int(mode)) for i, mode in enumerate(modes)}
    assert {(i, mode) for i in (0, 1) for mode in (OPEN, SLIP, STICK)} <= found
    assert {(3, SLIP), (3, STICK), (4, SLIP), (5, SLIP), (5, STICK), (6, OPEN)} <= found


@SEEDS
def test_forces_of_given_radii(seed):
    """Those of the forces that are given; how far the result's own are from these is told, relative to the largest."""
    rng = np.random.default_rng([1, seed])
    problem = made_problem(rng)
    start = rng.uniform(0.0, 1.0, problem.base.size)
    radii = np.array(radii_at(problem, start))
    forces, modes, residual, off = problem.solve_with_radii(start)
    assert residual <= TOLERANCE
    forces[np.abs(forces) < 1e-15] = 0.0
    # those of friction that goes with the given radii, not with the loads that there are
    assert modes.tolist() == follows_the_laws(problem, forces, radii, 1e-8)
    assert off == pytest.approx(np.abs(np.array(radii_at(problem, forces)) - radii).max() / radii.max(), rel=1e-12)
    assert off > 0.0
    # a solution's radii are its own
    solution, _ = problem.solve(start)
    settled, _, _, off = problem.solve_with_radii(solution)
    assert settled == pytest.approx(solution, abs=1e-8)
    assert off < 1e-8
    # forces take energy: no more than none would
    work = settled @ (problem.base + 0.5 * problem.gram @ settled)
    assert work <= 1e-12
    # in N, where no radius is there to compare with
    problem.radius_base[:] = 0.0
    found, _, _, off = problem.solve_with_radii(np.zeros_like(start))
    assert off == pytest.approx(max(radii_at(problem, found)), rel=1e-12)
    problem.mu[:] = 0.0
    assert problem.solve_with_radii(start)[3] == 0.0


@SEEDS
@pytest.mark.parametrize("given", [False, True])
def test_a_sweep_goes_from_unit_to_unit(given, seed):
    """Each unit's forces as if the others' stayed: the normal one exactly, those of a disc by the block's largest
    eigenvalue. Velocities are those of the forces."""
    rng = np.random.default_rng([2, seed])
    problem = made_problem(rng, given, slides=(4,) if seed % 2 else ())
    problem.mu[3] = math.inf
    if seed == 0:
        # nothing moves along these
        problem.gram[3:6] = problem.gram[:, 3:6] = 0.0
    start = rng.uniform(-0.5, 1.0, problem.base.size)
    start[[4, 6, 7, 9, 11, 14, 16, 17, 18, 19, 20]] = 0.0
    expected = start.copy()
    for i in range(problem.mu.size):
        k, count = 3 * i, int(problem.tangents[i])
        if problem.normal[i] and problem.gram[k + 2, k + 2] > 0.0:
            u = problem.gram[k + 2] @ expected + problem.base[k + 2]
            expected[k + 2] = max(expected[k + 2] - u / problem.gram[k + 2, k + 2], 0.0)
        block = slice(k, k + count)
        stiffness = np.linalg.eigvalsh(problem.gram[block, block]).max(initial=0.0)
        if stiffness == 0.0:
            continue
        load = problem.radius_base[2 * i : 2 * i + 2] + problem.radius_rows[2 * i : 2 * i + 2] @ expected
        radius = min(problem.mu[i], LARGE_FRICTION) * np.linalg.norm(load)
        p = expected[block] - (problem.gram[block] @ expected + problem.base[block]) / stiffness
        expected[block] = p * min(1.0, radius / np.linalg.norm(p))
        if problem.along[2 * i : 2 * i + 2].any():
            expected[block] = -radius * problem.along[2 * i : 2 * i + count]
    f, u = start.copy(), problem.gram @ start + problem.base
    arrays = swept(problem)
    gauss_seidel_loads(*arrays, f, u, 1)
    assert f == pytest.approx(expected, abs=1e-12)
    assert u == pytest.approx(problem.gram @ f + problem.base, abs=1e-12)
    twice, u = start.copy(), problem.gram @ start + problem.base
    gauss_seidel_loads(*arrays, twice, u, 2)
    gauss_seidel_loads(*arrays, f, u.copy() * 0.0 + problem.gram @ f + problem.base, 1)
    assert twice == pytest.approx(f, abs=1e-12)


def radius_of(scaled, d, y):
    """The radius of a disc, and its derivative."""
    disc, rows, slope = scaled.discs.view(np.recarray)[d], scaled.radius_rows, np.empty(y.size)
    return radius_at(disc, rows[2 * d], rows[2 * d + 1], y, slope), slope


@SEEDS
def test_a_disc_of_the_own_normal_force_is_told_apart(seed):
    problem = made_problem(np.random.default_rng([3, seed]))
    scaled = ScaledLoads(problem)
    # unknowns in the order of rows: of the first contact 0, 1 and 2, of the second 3 and 5, of the third 8
    assert scaled.rows.tolist() == [0, 1, 2, 3, 5, 8, 9, 10, 12, 13, 15]
    assert scaled.normals["place"].tolist() == [2, 4, 5]
    assert scaled.discs[["first", "count"]].tolist() == [(0, 2), (3, 1), (6, 2), (8, 2), (10, 1)]
    assert scaled.discs["own"].tolist() == [1, 1, 0, 0, 0]
    forces = np.random.default_rng([4, seed]).uniform(0.5, 1.0, 21)
    forces[np.setdiff1d(np.arange(21), scaled.rows)] = 0.0
    y, units = scaled.unknowns(forces), scaled.scale * scaled.unit
    for d, i in enumerate((0, 1, 3, 4, 5)):
        radius, slope = radius_of(scaled, d, y)
        assert radius * units[scaled.discs["first"][d]] == pytest.approx(problem.radii(forces)[i], rel=1e-12)
        turned = [radius_of(scaled, d, y + 1e-6 * e)[0] - radius_of(scaled, d, y - 1e-6 * e)[0] for e in np.eye(y.size)]
        # by the square of the difference
        assert slope == pytest.approx(np.array(turned) / 2e-6, abs=1e-8)
    # below zero there is no load, and so no radius
    y[2] = -1.0
    assert radius_of(scaled, 0, y)[0] == 0.0 and not radius_of(scaled, 0, y)[1].any()
    # no friction, no disc; and a load that is another's is not its own
    problem.mu[0], problem.radius_rows[2] = 0.0, problem.radius_rows[6]
    discs = ScaledLoads(problem).discs
    assert discs[["first", "count"]].tolist() == [(1, 1), (4, 2), (6, 2), (8, 1)]
    assert not discs["own"][0]


def test_where_nothing_is_found_the_best_is_kept(monkeypatch):
    """Forces of the least residual that sweeps have come to; what is not finite is none."""
    problem = made_problem(np.random.default_rng(4))
    start = np.random.default_rng(5).normal(size=21)
    monkeypatch.setattr(loads.ScaledLoads, "newton", lambda scaled, y: (y, 1.0))
    far, near = (problem._gauss_seidel(start, rounds) for rounds in ((1,), (1, 3, 30)))
    assert 0.0 < near[1] < far[1]
    # one sweep, three and thirty, from where no other unit has a force: each goes on from the last
    arrays = swept(problem)
    for (found, _), sweeps in ((far, 1), (near, 34)):
        f = start.copy()
        f[[4, 6, 7, 11, 14, 16, 17, 18, 19, 20]] = 0.0
        gauss_seidel_loads(*arrays, f, problem.gram @ f + problem.base, sweeps)
        assert found == pytest.approx(f, abs=1e-12)
    problem.base[2] = -math.inf
    with np.errstate(all="ignore"):
        best, least = problem._gauss_seidel(start, (1, 3))
    assert np.isfinite(best).all()
    assert least == math.inf
