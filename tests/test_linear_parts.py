"""Factorisations of the equations of motion, and the choice among redundant forces, each part alone."""

import math

import numpy as np
import pytest
from calling import from_python

from pincontact import linalg
from pincontact.friction import barrier
from pincontact.friction.centred import Cone, central_force, null_space

inner = from_python(linalg.inner)
factorize_tree = from_python(linalg.factorize_tree)
whiten = from_python(linalg.whiten)
whiten_rows = from_python(linalg.whiten_rows)
unwhiten = from_python(linalg.unwhiten)
factor_definite = from_python(linalg.factor_definite)
solve_gram = from_python(linalg.solve_gram)
orthonormal_basis = from_python(linalg.orthonormal_basis)
way_inside = from_python(barrier.way_inside)

SEEDS = pytest.mark.parametrize("seed", range(3))
# each coordinate's parent: a chain, a tree, separate bodies
TREES = ([-1, 0, 1, 2, 3, 4], [-1, 0, 1, 1, 3, 0, 5, 2], [-1, -1, 0, 1, 3, 2, -1])


@pytest.mark.parametrize("n", range(11))
def test_products_of_vectors_of_any_length(n):
    a, b = np.random.default_rng(n).normal(size=(2, n + 2))
    assert inner(a, b, n) == pytest.approx(a[:n] @ b[:n], abs=1e-14)


@pytest.mark.parametrize("pivot", [0.0, -2.0])
def test_what_is_not_definite_has_no_factor(pivot):
    """Compiled or not: the first pivot that is not positive, and what follows from it, is no number."""
    lower = np.array([[2.0, 0.0, 0.0], [0.5, 1.5, 0.0], [0.3, -0.2, 1.0]])
    matrix = lower @ lower.T
    matrix[1, 1] += pivot - 1.5**2
    factor_definite(matrix, 3)
    np.testing.assert_allclose(matrix[:, 0], lower[:, 0], rtol=1e-15)
    assert np.isnan([matrix[1, 1], matrix[2, 1], matrix[2, 2]]).all()


def tree_matrix(rng, parents):
    """A positive matrix with the pattern of a tree's inertia: L^T L of a factor with that pattern."""
    n = len(parents)
    factor = np.zeros((n, n))
    for k in range(n):
        factor[k, k] = rng.uniform(0.5, 2.0)
        i = parents[k]
        while i >= 0:
            factor[k, i] = rng.normal()
            i = parents[i]
    return factor, factor.T @ factor


@pytest.mark.parametrize("parents", TREES)
@SEEDS
def test_inertias_of_trees(seed, parents):
    rng = np.random.default_rng(seed)
    parents = np.array(parents)
    n = len(parents)
    expected, matrix = tree_matrix(rng, parents)
    lower = np.tril(matrix) + np.triu(np.full((n, n), 9.0), 1)
    for factor in (np.zeros((n, n)), lower.copy()):
        # apart, and in place
        assert factorize_tree(factor if factor.any() else lower, parents, n, factor)
        mask = expected != 0.0
        assert factor[mask] == pytest.approx(expected[mask], rel=1e-11, abs=1e-12)
    right, out = rng.normal(size=n), np.full(n, 9.0)
    right[: n // 3] = 0.0
    whiten(factor, parents, n, right, out)
    assert out == pytest.approx(np.linalg.solve(expected.T, right), abs=1e-11)
    sparse = np.zeros(n)
    sparse[n // 2] = 2.0
    whiten(factor, parents, n, sparse, sparse)
    assert sparse == pytest.approx(np.linalg.solve(expected.T, 2.0 * np.eye(n)[n // 2]), abs=1e-11)
    rows = rng.normal(size=(4, n)) * (rng.random((4, n)) < 0.7)
    whitened = rows.copy()
    whiten_rows(factor, parents, n, whitened, 3)
    np.testing.assert_allclose(whitened[:3].T, np.linalg.solve(expected.T, rows[:3].T), atol=1e-11)
    assert (whitened[3] == rows[3]).all()
    right = rng.normal(size=n)
    unwhiten(factor, parents, n, right, out)
    assert out == pytest.approx(np.linalg.solve(expected, right), abs=1e-11)
    unwhiten(factor, parents, n, right, right)
    assert right == pytest.approx(out, abs=0.0)


def test_what_is_not_positive_is_no_inertia():
    for k in range(3):
        matrix = np.eye(3)
        for value in (0.0, -0.5, math.nan):
            matrix[k, k] = value
            assert not factorize_tree(matrix, np.array([-1, 0, 1]), 3, np.zeros((3, 3)))
    # nor the complement of its last part
    assert not factorize_tree(np.array([[0.2, 0.0], [0.5, 1.0]]), np.array([-1, 0]), 2, np.zeros((2, 2)))
    assert factorize_tree(np.array([[0.3, 0.0], [0.5, 1.0]]), np.array([-1, 0]), 2, np.zeros((2, 2)))


@pytest.mark.parametrize(("n", "rank"), [(1, 1), (4, 4), (7, 7), (4, 2), (7, 5), (7, 1), (5, 0)])
@SEEDS
def test_singular_systems_get_their_least_solution(seed, n, rank):
    rng = np.random.default_rng([seed, n, rank])
    for _ in range(4):
        # sizes of rows that differ: ranks are relative to each row's own
        rows = rng.normal(size=(n, rank)) @ rng.normal(size=(rank, 9)) * 10.0 ** rng.uniform(-2, 2, (n, 1))
        matrix = rows @ rows.T
        b = matrix @ rng.normal(size=n) if rank else np.zeros(n)
        # (R R^T)^+ b
        least = np.linalg.pinv(rows, rcond=1e-9).T @ np.linalg.pinv(rows, rcond=1e-9) @ b if rank else np.zeros(n)
        x = b.copy()
        lower, order = np.zeros((n, n + 1)), np.zeros(n, dtype=np.int64)
        found = solve_gram(rows, n, 9, lower, order, x, np.zeros((n, n + 1)), linalg.RANK_TOLERANCE)
        assert found == rank
        # what it solves, and that it is the least: condition numbers of up to 1e4, squared
        assert matrix @ x == pytest.approx(b, abs=1e-6 * (np.abs(b).max(initial=0.0) + 1e-300))
        assert x == pytest.approx(least, abs=1e-5 * (1e-300 + np.abs(least).max(initial=0.0)))


@pytest.mark.parametrize(("n", "count", "rank"), [(1, 1, 1), (4, 4, 4), (7, 9, 3), (7, 2, 2), (5, 3, 0), (9, 9, 8)])
@SEEDS
def test_bases_begin_with_what_vectors_span(seed, n, count, rank):
    rng = np.random.default_rng([seed, n, count])
    for smallest in (0.0, -4.0):
        # sizes that differ: the last is orthogonal, too, though it is what large numbers leave
        vectors = rng.normal(size=(count, rank)) * 10.0 ** np.linspace(0.0, smallest, rank) @ rng.normal(size=(rank, n))
        basis = np.full((n, n), math.nan)
        assert orthonormal_basis(vectors.copy(), 1e-9, basis) == rank
        # round-off of n products
        assert basis @ basis.T == pytest.approx(np.eye(n), abs=1e-13)
        assert np.abs(vectors @ basis[rank:].T).max(initial=0.0) <= 1e-12 * np.abs(vectors).max()


# ------------------------------------------------------------------------------------------------ redundant forces


@SEEDS
def test_combinations_that_act_on_nothing(seed):
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(7, 4)) @ rng.normal(size=(4, 6)) * 10.0 ** rng.uniform(-3, 3, (7, 1))
    null = null_space(directions)
    assert null.shape == (7, 3)
    assert np.linalg.matrix_rank(null) == 3
    sizes = np.linalg.norm(directions, axis=1)
    assert np.abs(directions.T @ null).max() < 1e-12 * sizes.max() * np.abs(null).max()
    assert null_space(np.eye(3)).shape == (3, 0)
    # a row that is zero is free
    assert np.abs(null_space(np.diag([1.0, 0.0, 2.0]))[:, 0]).tolist() == [0.0, 1.0, 0.0]


def feet(rng, n, mu):
    """Directions (3n, 6) of feet's forces (t1, t2, n), their cones, and forces inside these."""
    points = np.c_[rng.uniform(-1.0, 1.0, (n, 2)), np.zeros(n)]
    directions = np.vstack([np.c_[np.eye(3), np.cross(point, np.eye(3))] for point in points])
    cones = [Cone(3 * i + 2, mu, 0.0, (3 * i, 3 * i + 1)) for i in range(n)]
    inside = np.c_[rng.uniform(-0.4, 0.4, (n, 2)) * mu, np.ones(n)].ravel() * np.repeat(rng.uniform(0.5, 2.0, n), 3)
    return directions, cones, inside


def barrier_slope(forces, cones, null, least, unit):
    """Slope by z of -sum log(s^2 - |t|^2) + |z|^2 / 2, by differences of it; forces = least + unit null z."""
    z = np.linalg.lstsq(null, (forces - least) / unit, rcond=None)[0]

    def cost(z):
        x = least / unit + null @ z
        total = 0.5 * z @ z
        for cone in cones:
            s = cone.factor * x[cone.normal] + cone.offset / unit
            total -= math.log(s**2 - sum(x[t] ** 2 for t in cone.tangents))
        return total

    step = 1e-5
    return np.array([(cost(z + step * d) - cost(z - step * d)) / (2.0 * step) for d in np.eye(z.size)])


@pytest.mark.parametrize("outside", [False, True])
@SEEDS
def test_central_forces_are_central(seed, outside):
    """They do what the given ones do, lie inside all cones, and the barriers' slope vanishes there."""
    rng = np.random.default_rng(seed)
    directions, cones, inside = feet(rng, 5, 0.6)
    # and two numbers with limits of their own
    directions = np.vstack([directions, rng.normal(size=(1, 6)), directions[2]])
    cones += [Cone(15, 1.0, 2.0), Cone(15, -1.0, 3.0), Cone(16, 1.0, 0.0)]
    forces = np.r_[inside, 0.5, 1.0]
    null = null_space(directions)
    if outside:
        forces = forces + null @ (200.0 * rng.normal(size=null.shape[1]) / np.abs(null).max())
    choice = central_force(forces, null, cones)
    assert directions.T @ choice.forces == pytest.approx(directions.T @ forces, abs=1e-9 * np.abs(forces).max())
    for cone in cones:
        tangential = math.sqrt(sum(choice.forces[t] ** 2 for t in cone.tangents))
        assert cone.factor * choice.forces[cone.normal] + cone.offset > tangential
    # distances from the forces of least norm count as they are
    across = np.linalg.qr(null)[0]
    span = np.linalg.svd(directions.T)[2][: 17 - null.shape[1]].T
    least = span @ (span.T @ forces)
    unit = np.linalg.norm(least)
    # of a Newton that ends at a decrement of 1e-9
    assert barrier_slope(choice.forces, cones, across, least, unit) == pytest.approx(np.zeros(null.shape[1]), abs=2e-3)
    assert choice.span @ choice.span.T == pytest.approx(span @ span.T, abs=1e-9)
    # and it follows the loads along its tangent: what that leaves is of second order
    load = rng.normal(size=choice.span.shape[1])
    errors = []
    for size in (1e-2, 5e-3):
        moved = central_force(forces + size * choice.span @ load, null, cones).forces
        tangent = choice.forces + size * (choice.span + choice.slope) @ load
        errors.append(np.abs(moved - tangent).max())
        assert np.abs(moved - choice.forces).max() > 3.0 * errors[-1]
    assert errors[1] < 0.4 * errors[0] + 1e-4
    assert np.abs(directions.T @ choice.slope).max() < 1e-9


def test_where_no_forces_lie_inside_there_is_no_choice():
    rng = np.random.default_rng(1)
    directions, cones, inside = feet(rng, 4, 0.5)
    null = null_space(directions)
    pull = inside.copy()
    pull[2::3] -= 3.0
    assert central_force(pull, null, cones) is None
    assert central_force(inside, null[:, :0], cones) is None
    assert central_force(0.0 * inside, null, cones) is None
    assert central_force(inside, null, []) is None
    # at the limit as a whole: no room
    slide = np.tile([0.5, 0.0, 1.0], 4)
    assert central_force(slide, null, cones) is None
    # one that carries nothing, whatever the others do
    directions = np.block([[directions, np.zeros((12, 1))], [np.zeros((1, 6)), np.ones((1, 1))]])
    null = null_space(directions)
    assert central_force(np.r_[inside, 0.0], null, [*cones, Cone(12, 1.0, 0.0)]) is None
    assert central_force(np.r_[inside, 1.0], null, [*cones, Cone(12, 1.0, 0.0)]) is not None


def depths(x):
    """How far inside their cones."""
    return x[:, 0] - np.hypot(x[:, 1], x[:, 2])


@SEEDS
def test_the_way_out_of_cones(seed):
    rng = np.random.default_rng(seed)
    for _ in range(100):
        x, dx = rng.normal(size=(2, 2, 3))
        x[:, 0] = np.hypot(x[:, 1], x[:, 2]) + rng.uniform(0.01, 1.0, 2)
        if rng.random() < 0.3:
            # one without tangents
            x[1, 1:] = dx[1, 1:] = 0.0
        way = way_inside(x.ravel(), dx.ravel())
        for part in np.linspace(0.0, 0.999, 15):
            assert depths(x + part * way * dx).min() > 0.0
        if way < 1.0 / barrier.TO_BOUNDARY:
            # of double roots only half the digits are left
            assert depths(x + way * dx).min() == pytest.approx(0.0, abs=1e-6)
        else:
            assert way == 1.0 / barrier.TO_BOUNDARY
