"""The contact solver's last resorts, and sizes and signs that its parts go by, each alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy
from calling import from_python
from test_cone_parts import problem
from test_cone_starts import is_solution, regular
from test_load_solver import made_problem

from pincontact import linalg
from pincontact.friction import barrier, cone, solve
from pincontact.friction.centred import Cone, central_force
from pincontact.friction.cone import KNOWN, STICK
from pincontact.friction.feasibility import crushing_combination
from pincontact.friction.loads import LoadSolver, ScaledLoads
from pincontact.friction.solve import ContactSolver

least_norm = from_python(linalg.least_norm)
gauss_seidel_pass = from_python(cone.gauss_seidel_pass)
barrier_minimum, barrier_cost = from_python(barrier.minimise), from_python(barrier.cost)
barrier_derivatives = from_python(barrier.barrier_derivatives)

SEEDS = pytest.mark.parametrize("seed", range(4))


# ---------------------------------------------------------------------------------------------- last resorts


@SEEDS
def test_sweeps_after_other_stages(seed):
    """From nothing where nothing is known, whatever the buffers hold."""
    delassus, b, mu = regular(np.random.default_rng(seed), 3)
    solver = ContactSolver(stages=("path", "sweeps"))
    space = solver._workspace(3)
    space.forces[:] = 1e9
    assert not space.counts[KNOWN]
    assert solver._gauss_seidel((delassus, b, mu))
    is_solution(delassus, b, mu, space)
    assert solver.residual <= 1e-12
    solver.tolerance = -1.0
    assert not solver._gauss_seidel((delassus, b, mu))


def test_nothing_to_solve():
    fresh = LoadSolver()
    assert (fresh.residual, fresh.proved, fresh.forces.size) == (0.0, False, 0)
    found = solve.solve_contacts(np.zeros((0, 0)), np.zeros(0), 0.3)
    assert (found.residual, found.iterations, found.qp_count, found.decided_by) == (0.0, 0, 0, "exact")
    assert found.forces.shape == found.velocities.shape == (0, 3)
    assert found.modes.shape == found.mu.shape == (0,)


# ---------------------------------------------------------------------------------------------- sizes and signs


@SEEDS
@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_signs_of_determinants(unit, n, seed):
    """Where the rank is full, with pivots of any size; its size is that of the last against the largest."""
    rng = np.random.default_rng([n, seed])
    for _ in range(10):
        matrix = unit * rng.normal(size=(n, n))
        a, right, x = matrix.copy(), rng.normal(size=n), np.zeros(n)
        wanted = np.linalg.solve(matrix, right)
        arguments = a, right, n, n, x, np.zeros((n + 1, n)), np.zeros(n, dtype=np.int64), 1e-12
        assert least_norm(*arguments) == n
        assert x == pytest.approx(wanted, abs=1e-12 * np.linalg.cond(matrix) * np.abs(wanted).max())
        assert np.sign(a[0, 0]) == np.sign(np.linalg.det(matrix))
        # complete pivots do not grow by much
        assert abs(a[0, 0]) <= 4.0
        if n == 1:
            assert abs(a[0, 0]) == pytest.approx(1.0)


@SEEDS
def test_sweeps_of_soft_contacts(seed):
    """Mobilities far below one are mobilities."""
    rng = np.random.default_rng(seed)
    g, c, mu = problem(rng, 3)
    g *= 1e-3
    f = np.abs(rng.normal(size=9))
    u = g @ f + c
    last = u.copy()
    rounds = 400
    for _ in range(rounds):
        gauss_seidel_pass(g, mu, f, u)
    assert u == pytest.approx(g @ f + c, abs=1e-12 * rounds * np.abs(g).max() * np.abs(f).max())
    assert np.abs(u - last).max() > 1e-3
    # nothing pulls, and as good as nothing closes
    assert (f[2::3] >= 0.0).all()
    assert u[2::3].min() >= -1e-3 * np.abs(c).max()


@SEEDS
def test_units_of_loads(seed):
    made = made_problem(np.random.default_rng(seed))[0].posed()
    for factor in (1e-3, 1e4):
        made.base *= factor
        scaled = ScaledLoads(made)
        assert scaled.largest == np.abs(made.base).max()
        # the largest is one
        assert np.abs(scaled.base).max() == pytest.approx(1.0, rel=1e-14)
        y = np.random.default_rng(seed).normal(size=scaled.base.size)
        forces = scaled.forces(y)
        assert scaled.unknowns(forces) == pytest.approx(y, rel=1e-12)
        velocities = (made.gram @ forces + made.base)[scaled.rows]
        assert scaled.operator @ y + scaled.base == pytest.approx(velocities * scaled.scale / scaled.unit, rel=1e-9)
    made.base[:] = 0.0
    scaled = ScaledLoads(made)
    assert (scaled.largest, scaled.unit) == (1.0, 1.0)
    assert not scaled.base.any()


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_jaws_that_close(unit):
    """Forces that move nothing and press what closes; none where anything gives way by more than 1e-7, or nothing
    closes."""
    # two contacts on either side of a body that moves along one direction
    rows = np.zeros((6, 1))
    rows[2], rows[5] = 1.0, -1.0
    gram, b = unit * rows @ rows.T, np.array([0.0, 0.0, -1.0, 0.0, 0.0, -0.5])
    found = crushing_combination(gram, b)
    assert found is not None
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    # scaled such that together they close by one of the largest b, in their units
    assert -(found @ b[2::3]) / (np.sqrt(3.0 / unit)) == pytest.approx(1.0, rel=1e-6)
    assert crushing_combination(gram, -b) is None
    assert crushing_combination(gram, np.zeros(6)) is None
    b[5] = 1.5
    assert crushing_combination(gram, b) is None
    b[5] = -0.5
    # a soft jaw: w |y|_G >= closing
    for share, proof in ((0.3e-7, True), (3e-7, False)):
        soft = gram.copy()
        soft[2, 2] *= 1.0 + share**2
        assert (crushing_combination(soft, b) is not None) == proof
    # a contact that nothing moves has no unit: its force is a number that is one
    assert crushing_combination(np.zeros((3, 3)), np.array([0.0, 0.0, -2.0])).tolist() == [1.0]
    b[2] = np.nan
    gram[0, 0] = np.inf
    with np.errstate(invalid="ignore"):
        assert crushing_combination(gram, b) is None


# ---------------------------------------------------------------------------------------------- central forces


@SEEDS
@pytest.mark.parametrize("pressure", [0.5, 40.0, 0.0])
def test_minima_of_barriers(pressure, seed):
    """The slope of barriers, of the square of z and of the pressure on the enlargement vanishes, or all cones are
    entered."""
    rng = np.random.default_rng(seed)
    k, m = 3, 4
    rows, start = rng.normal(size=(3 * m, k + 1)), rng.normal(size=3 * m)
    rows[:, k] = np.tile([1.0, 0.0, 0.0], m)
    # the first cone is well inside wherever z is small, so that the others decide
    start[0::3] += 1.0

    def at(point):
        return start + rows @ point

    def depth(point):
        x = at(point).reshape(-1, 3)
        return float((x[:, 0] - np.hypot(x[:, 1], x[:, 2])).min())

    point = np.append(0.3 * rng.normal(size=k), 0.0)
    point[k] = max(0.2 - depth(point), 0.1)
    before, scratch = point.copy(), np.zeros((barrier.SCRATCH_ROWS, 3 * m))
    barrier_minimum(rows, start, point, k, pressure, np.zeros((k + 1, k + 1)), scratch)
    assert depth(point) > 0.0
    slope, hessian = np.zeros(k + 1), np.zeros((k + 1, k + 1))
    barrier_derivatives(rows, at(point), k + 1, slope, hessian)
    # forces a thousand times as large as the least are of interest
    weight = 1e-6 if pressure > 0.0 else 1.0
    whole, size = slope + np.append(weight * point[:k], pressure), 1e-6 * depth(point)
    for i, unit in enumerate(size * np.eye(k + 1)):
        ahead, behind = point + unit, point - unit
        rise = barrier_cost(at(ahead), ahead, k, pressure) - barrier_cost(at(behind), behind, k, pressure)
        # round-off of a sum of logarithms over the step
        assert whole[i] == pytest.approx(rise / (2.0 * size), rel=1e-5, abs=1e-14 / size)
        slopes = []
        for moved in (ahead, behind):
            slopes.append(np.zeros(k + 1))
            barrier_derivatives(rows, at(moved), k + 1, slopes[-1], hessian.copy())
        column = (slopes[0] - slopes[1])[i:] / (2.0 * size)
        assert hessian[i:, i] == pytest.approx(column, rel=1e-5, abs=1e-6 * np.abs(hessian).max())
    if pressure == 0.0:
        # a given enlargement stays; a decrement of 1e-9 is left
        assert point[k] == before[k]
        assert np.abs(whole[:k]).max() < 1e-3
        return
    assert point[k] < -1e-9 or np.abs(whole).max() < 1e-3 * max(1.0, pressure)
    # a light pressure leaves cones enlarged
    assert pressure > 1.0 or point[k] > 0.0


@pytest.mark.parametrize("seed", range(10))
def test_forces_far_from_the_least_are_found(seed):
    """A load that only a press along a self-stress holds, 30 to 1000 times as hard: the cone widens slowly along it."""
    rng = np.random.default_rng(seed)
    forces = np.array([10.0 ** rng.uniform(-1.0, 1.0), *rng.normal(size=2), *10.0 ** rng.uniform(-1.5, 0.0, 2)])
    null = np.array([1.0, *rng.normal(size=2), *rng.uniform(0.1, 0.6, 2) * 0.01])
    cones = [Cone(0), Cone(0, 0.01, 0.0, (3, 4))]

    def inside(z):
        f = forces + z * null
        return 0.01 * f[0] - math.hypot(f[3], f[4])

    needed = scipy.optimize.brentq(inside, 0.0, 1e6) * np.linalg.norm(null) / np.linalg.norm(forces)
    found = central_force(forces, null[:, None], cones)
    assert needed > 1000.0 or found is not None
    if found is not None:
        change = found.forces - forces
        assert 0.01 * found.forces[0] > math.hypot(*found.forces[3:])
        np.testing.assert_allclose(change, change[0] * null, rtol=0.0, atol=1e-9 * abs(change[0]))


def test_two_opposite_contacts_hold_what_a_harder_squeeze_would():
    """A point pinched between two walls: forces of the last problem that are too small for the weight are moved inside
    their cones, since there are such forces, rather than let slip."""
    axes = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    rows = np.vstack([axes, axes * [[1.0], [-1.0], [-1.0]]])
    delassus, mu = rows @ rows.T, np.array([0.8, 0.8])
    b = rows @ [0.0, 0.0, -1.0]
    solver = ContactSolver(nearest=True)
    solver.address(2)
    forces = np.array([0.0, 0.5, 0.5, 0.0, -0.5, 0.5])
    solver.warm_start(np.full(2, STICK), forces, np.zeros(6))
    assert solver.solve(delassus, b, mu)
    assert (solver.modes == STICK).all()
    found = solver.forces.reshape(2, 3)
    assert (np.hypot(found[:, 0], found[:, 1]) <= mu * found[:, 2] * (1.0 + 1e-12)).all()
    # one of the equations of a point of 1 kg, solved to round-off
    assert delassus @ solver.forces + b == pytest.approx(np.zeros(6), abs=1e-12)


def test_a_new_solver_has_done_nothing():
    solver = ContactSolver()
    assert (solver.residual, solver.jammed, solver.qp_count) == (0.0, False, 0)
