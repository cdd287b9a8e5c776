"""One call of the contact solver's kernel: what it begins from, what it counts, and what it leaves alone."""

import math

import numpy as np
import pytest
from test_cone_newton import feet_at_rest, is_held
from test_cone_parts import problem, residual_of

from pincontact.friction import starts
from pincontact.friction.cone import (
    BY_EXACT,
    BY_GAUSS_SEIDEL,
    BY_WARM,
    DECIDED,
    DECIDERS,
    HUGE,
    KNOWN,
    OPEN,
    PASSES,
    SLIP,
    STICK,
    TIMES,
    cone_workspace,
)  # fmt: skip
from pincontact.friction.feasibility import crushing_combination
from pincontact.friction.solve import ContactSolution, ContactSolver, solve_contacts
from pincontact.friction.starts import solve_cones

SEEDS = pytest.mark.parametrize("seed", range(3))
SWEEPS = starts.CLASSIFY + starts.GAUSS_SEIDEL


def is_solution(delassus, b, mu, memory):
    n = len(mu)
    forces, velocities = memory.forces, memory.velocities
    assert velocities == pytest.approx(delassus @ forces + b, abs=1e-12 * np.abs(b).max())
    for i in range(n):
        f, u = forces[3 * i : 3 * i + 3], velocities[3 * i : 3 * i + 3]
        unit = math.sqrt(np.trace(delassus[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]) / 3.0)
        assert residual_of(f * unit, u / unit, mu[i]) <= 1e-9 * np.abs(b).max() / unit
        mode = memory.modes[i]
        assert {OPEN: not f.any(), STICK: np.abs(u).max() <= 1e-9 * np.abs(b).max(), SLIP: True}[int(mode)]


def regular(rng, n, unit=1.0):
    g, b, mu = problem(rng, n)
    return unit * (np.eye(3 * n) + 0.2 * g / n), b, mu


@SEEDS
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("task", [starts.WARM, starts.NEAREST, SWEEPS, SWEEPS + starts.NEAREST])
def test_each_start_leads_to_a_solution(task, unit, seed):
    rng = np.random.default_rng(seed)
    n = 3
    delassus, b, mu = regular(rng, n, unit)
    memory = cone_workspace(n)
    memory.velocities[:] = 0.0
    residual = solve_cones(delassus, b, mu, memory.address, task, 1e-10)
    assert residual <= 1e-10
    is_solution(delassus, b, mu, memory)
    assert 1 <= memory.counts[PASSES] <= starts.NEWTON_PASSES
    # where the solution is known, its modes and forces lead to it at once
    before = memory.forces.copy()
    memory.forces[:] *= 1.0 + 1e-9
    assert solve_cones(delassus, b, mu, memory.address, task, 1e-10) <= 1e-10
    assert memory.counts[PASSES] <= 3
    assert memory.forces == pytest.approx(before, rel=1e-9, abs=1e-12 * np.abs(before).max())


@SEEDS
def test_what_fails_leaves_everything_alone(seed):
    rng = np.random.default_rng(seed)
    delassus, b, mu = regular(rng, 2)
    memory = cone_workspace(2)
    memory.forces[:], memory.velocities[:] = rng.normal(size=(2, 6))
    kept = {name: getattr(memory, name).copy() for name in ("modes", "forces", "velocities")}
    assert solve_cones(delassus, b, mu, memory.address, starts.NOTHING, 1e-10) == HUGE
    for task in (starts.WARM, starts.NEAREST, starts.CLASSIFY, SWEEPS):
        assert solve_cones(delassus, b, mu, memory.address, task, -1.0) >= 0.0
    for name, array in kept.items():
        assert (getattr(memory, name) == array).all()


def test_what_decided_is_counted():
    rng = np.random.default_rng(0)
    usual = starts.USUAL + starts.NEAREST + starts.GAUSS_SEIDEL
    for n in (1, 3):
        delassus, b, mu = regular(rng, n)
        memory = cone_workspace(n)
        counts = memory.counts
        assert solve_cones(delassus, b, mu, memory.address, usual, 1e-10) <= 1e-10
        is_solution(delassus, b, mu, memory)
        first = BY_EXACT if n == 1 else BY_GAUSS_SEIDEL
        assert (counts[KNOWN], counts[DECIDED]) == (1, first)
        assert counts[TIMES + first] == 1
        for k in range(2):
            assert solve_cones(delassus, b * (1.0 + 1e-3), mu, memory.address, usual, 1e-10) <= 1e-10
            assert (counts[DECIDED], counts[TIMES + BY_WARM]) == (BY_WARM, k + 1)
        assert counts[TIMES:].sum() == 3
        reached = float(memory.reached[0])
        assert 0.0 <= reached <= 1e-12
        # the mode of one contact is another's: all its states are tried
        memory.modes[:] = OPEN if memory.modes[0] != OPEN else STICK
        memory.forces[:] = 5.0
        assert solve_cones(delassus, b, mu, memory.address, usual, 1e-10) <= 1e-10
        is_solution(delassus, b, mu, memory)
        # without sweeps there is nothing else for several
        blocked = np.zeros_like(delassus)
        kept = memory.forces.copy()
        for task in (usual, usual - starts.GAUSS_SEIDEL, usual - starts.NEAREST):
            assert solve_cones(blocked, np.full(3 * n, -1.0), mu, memory.address, task, 1e-10) == HUGE
            assert memory.reached[0] > 1e-3
        assert (memory.forces == kept).all()
        counts[KNOWN] = 0
        known = counts[TIMES:].sum()
        found = solve_cones(delassus, b, mu, memory.address, starts.USUAL, 1e-10)
        assert (found <= 1e-10) == (n == 1)
        assert counts[TIMES:].sum() == known + (n == 1)


@SEEDS
@pytest.mark.parametrize("unit", [1e-8, 1e8])
def test_contacts_at_rest_stay_at_rest_whatever_the_units(seed, unit):
    """Redundant feet, at rest with forces inside, go on with forces inside; what moved slowly is not stopped."""
    rng = np.random.default_rng(seed)
    g, c, mu, inside = feet_at_rest(rng, 4)
    memory = cone_workspace(4)
    memory.modes[:], memory.forces[:], memory.velocities[:] = OPEN, inside / unit, 0.0
    assert solve_cones(unit * g, c, mu, memory.address, starts.NEAREST, 1e-10) <= 1e-10
    assert (memory.modes == STICK).all()
    assert is_held(memory.forces, mu * (1.0 + 1e-12))
    # a single contact that slides at 1e-6 of what acts on it
    edge = np.array([-0.5 - 1e-6, 0.0, 1.0])
    single = np.kron(np.eye(2), np.eye(3)) * unit
    b = -np.r_[edge, edge]
    memory = cone_workspace(2)
    memory.modes[:], memory.forces[:] = SLIP, -b / unit
    memory.velocities[:] = np.tile([1e-6, 0.0, 0.0], 2)
    assert solve_cones(single, b, np.full(2, 0.5), memory.address, starts.NEAREST, 1e-10) <= 1e-10
    assert memory.velocities == pytest.approx(np.tile([1e-6, 0.0, 0.0], 2), abs=1e-14)


# ------------------------------------------------------------------------------------------------ what is said of it


@SEEDS
def test_what_a_solution_says_of_itself(seed):
    rng = np.random.default_rng(seed)
    delassus, b, mu = regular(rng, 4)
    mu[0], mu[1] = math.inf, 0.0
    b[2::3] -= 1.0
    solution = solve_contacts(delassus, b, mu)
    excess, complementarity, dissipation = solution.cone_excess, solution.complementarity, solution.dissipation
    for i in range(4):
        f, u = solution.forces[i], solution.velocities[i]
        finite = math.isfinite(mu[i])
        assert dissipation[i] == pytest.approx(-f[:2] @ u[:2], abs=1e-13)
        assert excess[i] == pytest.approx(np.linalg.norm(f[:2]) - mu[i] * f[2] if finite else 0.0, abs=1e-13)
        assert complementarity[i] == pytest.approx(0.0, abs=1e-12)
    # of anything else they say by how much it is none
    other = ContactSolution(
        rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), np.zeros(3), 0.0, 0, 0, "", np.array([0.5, math.inf, 2.0])
    )
    for i in range(3):
        f, u, m = other.forces[i], other.velocities[i], other.mu[i]
        finite = math.isfinite(m)
        corrected = np.array([*u[:2], u[2] + m * np.linalg.norm(u[:2])]) if finite else np.array([0.0, 0.0, u[2]])
        assert other.complementarity[i] == pytest.approx(f @ corrected, rel=1e-12)
        assert other.cone_excess[i] == pytest.approx(np.linalg.norm(f[:2]) - m * f[2] if finite else 0.0, rel=1e-12)
        assert other.dissipation[i] == pytest.approx(-f[:2] @ u[:2], rel=1e-12)


@pytest.mark.parametrize("unit", [1e-8, 1.0, 1e8])
def test_proofs_that_there_is_no_solution_do_not_depend_on_units(unit):
    """Two jaws, and a third contact that has nothing to do with it."""
    column = np.zeros(9)
    column[[2, 5]] = 1.0, -1.0
    delassus = unit * (np.outer(column, column) + np.diag([1.0, 1.0, 0.0] * 2 + [1.0] * 3))
    b = np.array([0.3, 0.0, -1.0, 0.0, 0.2, -0.5, 0.0, 0.0, -2.0])
    pressing = crushing_combination(delassus, b)
    assert pressing[0] == pytest.approx(pressing[1], rel=1e-9)
    assert pressing[0] > 0.0
    assert pressing[2] == 0.0
    # jaws that open, stand still, or give way a little
    assert crushing_combination(delassus, b + np.array([0, 0, 2.0] * 3)) is None
    b[2] = 0.5
    assert crushing_combination(delassus, b) is None
    b[2] = -1.0
    assert crushing_combination(delassus + 1e-4 * unit * np.eye(9), b) is None
    assert crushing_combination(delassus * math.nan, b) is None
    assert crushing_combination(delassus, np.zeros(9)) is None


@SEEDS
def test_stages_count_what_they_did(seed):
    """Each stage alone, and what a renewed solver knows: nothing."""
    rng = np.random.default_rng(seed)
    delassus, b, mu = regular(rng, 3)
    for first, *others in (("sweeps",), ("path",), ("qp",), ("path", "sweeps")):
        programs = first == "qp"
        solver = ContactSolver(stages=(first, *others), contact_solver="proxqp" if programs else "auto")
        assert solver.solve(delassus, b, mu)
        assert solver.decided_by == first
        assert solver.decided == dict.fromkeys(DECIDERS, 0) | {first: 1}
        assert (solver.qp_count > 0) == programs
        assert solver.solution(mu).qp_count == solver.qp_count
        assert solver.solve(delassus, b, mu)
        # programs begin from the last forces, too
        assert solver.decided_by == ("qp" if programs else "warm")
        assert (solver.solution(mu).qp_count > 0) == programs
        assert len(solver.warm_starts()) == 1
        solver.renew()
        assert solver.decided_by == ""
        assert not any(solver.decided.values())
        assert (solver.qp_count, solver.residual) == (0, 0.0)
        assert solver.warm_starts() == []
        assert not solver.jammed
