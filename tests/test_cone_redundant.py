"""Redundant contacts and singular systems: the parts that choose among many forces, each alone."""

import math
from itertools import product

import numpy as np
import pytest
from calling import from_python
from scipy.optimize import nnls
from test_cone import newton_workspace

from pincontact import linalg
from pincontact.friction import redundant
from pincontact.friction.cone import CONE, HUGE, LARGEST_FRICTION, OPEN, RANK_TOLERANCE, SLIP, STICK
from pincontact.friction.least_loads import SCRATCH_ROWS, _move, least_of

least_norm = from_python(linalg.least_norm)
largest_entry = from_python(linalg.largest_entry)
factor_definite = from_python(linalg.factor_definite)
solve_definite = from_python(linalg.solve_definite)
solve_lower = from_python(linalg.solve_lower)
factor_matrix = from_python(linalg.factor_matrix)
spring = from_python(redundant.spring)
has_factors = from_python(redundant.has_factors)
is_inside = from_python(redundant.is_inside)
project = from_python(redundant.project)
bend = from_python(redundant.bend)
move_inside = from_python(redundant.move_inside, CONE)
spring = from_python(redundant.spring)

SEEDS = pytest.mark.parametrize("seed", range(3))


# ------------------------------------------------------------------------------------------------ linear algebra


@pytest.mark.parametrize(
    ("length", "speed", "sine", "expected"),
    [(1.2, 0.25, 0.5, 2.4), (1.2, 4.0, 0.5, 0.15), (1.2, 0.0, 0.5, HUGE), (0.0, 0.2, 0.5, 0.0),
     (0.0, 0.0, 0.5, HUGE), (0.0, 0.0, 0.0, 0.0)],
)  # fmt: skip
def test_stiffness_of_a_turning_slip(length, speed, sine, expected):
    """Friction over the speed: a small change of slip across turns it by so much."""
    assert spring(0, np.array([length]), np.array([speed]), np.array([sine])) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize("n", range(10))
def test_largest_entries_of_any_length(n):
    x = np.random.default_rng(n).normal(size=n)
    for k in range(n):
        for sign in (1.0, -1.0):
            z = x.copy()
            z[k] = 9.0 * sign
            assert largest_entry(z) == 9.0
    assert largest_entry(x) == np.abs(x).max(initial=0.0)


@pytest.mark.parametrize("tolerance", [0.0, 1e-12])
@pytest.mark.parametrize(("rows", "n", "rank"), [(1, 1, 1), (2, 2, 2), (2, 2, 1), (3, 3, 3), (5, 5, 5), (5, 5, 3),
                                                 (3, 6, 3), (4, 6, 2), (6, 4, 4), (4, 4, 0), (2, 4, 2),
                                                 (2, 3, 1), (4, 2, 2)])  # fmt: skip
def test_systems_are_solved_by_the_least_x(rows, n, rank, tolerance):
    rng = np.random.default_rng([rows, n, rank])
    if tolerance == 0.0 and not rank == rows == n:
        # what is said to be regular is
        return
    for _ in range(20):
        matrix = rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, n))
        rhs = matrix @ rng.normal(size=n)
        a, x, gram, order = matrix.copy(), np.full(n, 7.0), np.zeros((n + 1, n)), np.zeros(n, dtype=np.int64)
        assert least_norm(a, rhs.copy(), rows, n, x, gram, order, tolerance) == rank
        expected = np.linalg.pinv(matrix, rcond=1e-12) @ rhs if rank else np.zeros(n)
        # round-off times the square of condition numbers of a few hundred
        assert x == pytest.approx(expected, abs=1e-9 * (1.0 + np.abs(expected).max()))
        if 0 < rank < n and (rows, n) != (2, 2):
            # what is left of the system: its rows, triangular, and the Cholesky factor of their products
            left = np.triu(a[:rank])
            assert left.diagonal() == pytest.approx(np.ones(rank), rel=1e-13)
            spread = np.zeros((rank, n))
            spread[:, order] = left
            assert np.linalg.matrix_rank(np.vstack([spread, matrix]), 1e-9) == rank
            factor = np.tril(gram[:rank, :rank])
            assert factor @ factor.T == pytest.approx(left @ left.T, abs=1e-12 * np.abs(left @ left.T).max())


def test_pivots_are_the_largest_there_are():
    """A system that rounds to nonsense where small pivots come first, in the two unknowns of one slip, too."""
    for n in (2, 3):
        matrix = np.ones((n, n)) + np.eye(n)
        matrix[0, 0] = 1e-17
        rhs = matrix @ np.arange(1.0, n + 1.0)
        for tolerance in (0.0, 1e-12):
            x, gram, order = np.zeros(n), np.zeros((n + 1, n)), np.zeros(n, dtype=np.int64)
            assert least_norm(matrix.copy(), rhs.copy(), n, n, x, gram, order, tolerance) == n
            assert x == pytest.approx(np.arange(1.0, n + 1.0), rel=1e-13)


@pytest.mark.parametrize("entry", range(4))
def test_rank_of_two_unknowns_is_seen_whatever_their_units(entry):
    for unit in (1e-9, 1.0, 1e9):
        # columns as good as parallel: the determinant is small against the largest entry's square
        matrix = np.full((2, 2), 1e-4)
        matrix.flat[entry] = 1.0
        matrix.flat[3 - entry] = 1e-8 * (1.0 + 1e-7)
        x, gram, order = np.zeros(2), np.zeros((3, 2)), np.zeros(2, dtype=np.int64)
        assert least_norm(unit * matrix, unit * matrix.sum(axis=1), 2, 2, x, gram, order, 1e-12) == 1
        matrix.flat[3 - entry] = 0.3
        assert least_norm(unit * matrix, unit * matrix @ [2.0, -3.0], 2, 2, x, gram, order, 1e-12) == 2
        assert x == pytest.approx([2.0, -3.0], rel=1e-12)


@SEEDS
def test_gram_matrices(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 9))
    matrix = root @ root.T
    x = rng.normal(size=6)
    gram, solved = np.tril(matrix) + np.triu(np.full((6, 6), 5.0), 1), matrix @ x
    factor_definite(gram, 6)
    assert np.tril(gram) == pytest.approx(np.linalg.cholesky(matrix), rel=1e-12)
    solve_definite(gram, 6, solved)
    assert solved == pytest.approx(x, abs=1e-11)
    rows = np.c_[root, np.full((6, 1), 7.0)]
    solve_lower(gram, 6, 9, rows)
    assert np.tril(gram) @ rows[:, :9] == pytest.approx(root, abs=1e-11)
    # columns beyond are left alone
    assert (rows[:, 9] == 7.0).all()


@SEEDS
def test_factors_of_singular_matrices(seed):
    rng = np.random.default_rng(seed)
    for rank in (1, 4, 6, 7):
        root = rng.normal(size=(rank, 12))
        g, factor = root.T @ root, np.full((7, 12), 5.0)
        found = factor_matrix(g, factor, np.zeros(12), RANK_TOLERANCE)
        # narrower than half, or not at all
        assert found == (rank if 2 * rank <= 12 else 0)
        if found:
            assert factor[:found].T @ factor[:found] == pytest.approx(g, abs=1e-12 * np.abs(g).max())
            # the largest pivot comes first
            assert (factor[0] ** 2).max() == pytest.approx(g.diagonal().max(), rel=1e-13)
    assert factor_matrix(np.zeros((6, 6)), factor, np.zeros(6), RANK_TOLERANCE) == 0


# ------------------------------------------------------------------------------------------------ springs


def test_springs_of_slips_that_turn():
    def of(length, speed, sine):
        return spring(1, np.array([7.0, length]), np.array([7.0, speed]), np.array([7.0, sine]))

    # |F_t| / |u_t|
    assert of(3.0, 2.0, 0.5) == 0.75
    assert of(0.0, 2.0, 0.5) == 0.0
    assert of(3.0, 2.0, 0.0) == 0.0
    assert of(3.0, 0.0, 0.0) == 0.0
    # nothing to tell its direction by, or nothing but the force
    assert of(0.0, 0.0, 0.5) == HUGE
    assert of(3.0, 0.0, 0.5) == HUGE


def test_factors_are_used_where_they_are_narrow_and_slips_are_known():
    mu, modes = np.ones(3), np.array([STICK, SLIP, OPEN])
    length, speed, sine = np.ones(3), np.array([0.0, 1.0, 0.0]), np.full(3, 0.5)
    assert has_factors(2, 4, mu, modes, length, speed, sine)
    assert not has_factors(2, 3, mu, modes, length, speed, sine)
    assert not has_factors(0, 4, mu, modes, length, speed, sine)
    # one that may point anywhere
    speed[1] = 0.0
    assert not has_factors(2, 4, mu, modes, length, speed, sine)
    speed[1] = 1e-9
    assert not has_factors(2, 4, mu, modes, length, speed, sine)
    modes[1] = STICK
    assert has_factors(2, 4, mu, modes, length, speed, sine)


# ------------------------------------------------------------------------------------------------ cones


MODES = np.array([STICK, OPEN, SLIP, STICK, SLIP, STICK])
# the second of the slips has an unknown besides, that is in no cone
FIRST = np.array([0, 3, 3, 4, 7, 9, 12])
MU = np.array([0.5, 0.4, 0.3, 2.0, 0.7, math.inf])


@SEEDS
def test_inside_means_every_contact(seed):
    rng = np.random.default_rng(seed)
    x = np.zeros(12)
    for i in np.flatnonzero(MODES == STICK):
        x[FIRST[i] + 2] = 1.0
        turn = rng.uniform(0.0, 2.0 * math.pi)
        x[FIRST[i] : FIRST[i] + 2] = 0.99 * min(MU[i], LARGEST_FRICTION) * np.array([math.cos(turn), math.sin(turn)])
    x[3], x[7], x[8] = 0.0, 0.1, -9.0
    assert is_inside(MU, MODES, FIRST, x)
    for i in np.flatnonzero(MODES != OPEN):
        outside = x.copy()
        if MODES[i] == STICK:
            outside[FIRST[i] : FIRST[i] + 2] *= 1.02
        else:
            outside[FIRST[i]] = -1e-3
        assert not is_inside(MU, MODES, FIRST, outside)


def narrow(z, aim, margin, mu):
    """The nearest point of a cone, by trying its surface: parts of a line in the plane of z and the axis."""
    friction, normal, tangential = aim * min(mu, LARGEST_FRICTION), z[2] - margin, math.hypot(z[0], z[1])
    if tangential <= friction * normal:
        return z
    edge = np.array([friction, 1.0]) / math.hypot(friction, 1.0)
    along = max(edge @ [tangential, normal], 0.0) * edge
    return np.array([*(along[0] * z[:2] / tangential if tangential else (0.0, 0.0)), along[1] + margin])


@pytest.mark.parametrize(("aim", "margin"), [(1.0, 0.0), (0.9, 0.2)])
@SEEDS
def test_projection_and_its_derivative(seed, aim, margin):
    rng = np.random.default_rng(seed)
    step = 1e-6
    for _ in range(25):
        z = rng.normal(size=12)
        p = np.full(12, 7.0)
        project(MU, MODES, FIRST, z, aim, margin, p)
        for i in range(6):
            own = slice(FIRST[i], FIRST[i + 1])
            if MODES[i] == STICK:
                assert p[own] == pytest.approx(narrow(z[own], aim, margin, MU[i]), abs=1e-13)
            elif MODES[i] == SLIP:
                assert p[own] == pytest.approx([max(z[FIRST[i]], margin), *z[FIRST[i] + 1 : FIRST[i + 1]]], abs=0.0)
        jacobian = np.zeros((12, 12))
        ahead, behind = np.zeros(12), np.zeros(12)
        for j, unit in enumerate(np.eye(12)):
            project(MU, MODES, FIRST, z + step * unit, aim, margin, ahead)
            project(MU, MODES, FIRST, z - step * unit, aim, margin, behind)
            jacobian[:, j] = (ahead - behind) / (2.0 * step)
        rows, bent = rng.normal(size=(4, 12)), np.full((4, 12), 7.0)
        bend(4, MU, MODES, FIRST, z, aim, margin, rows, bent)
        # third derivatives go with 1 / |z_t|^2, of which the least of these is above 1e-4
        assert bent == pytest.approx(rows @ jacobian, abs=1e-6)


def test_projection_on_the_axis():
    """Where there is no tangential part: above, below and far below the apex."""
    first, mu, modes = np.array([0, 3]), np.array([0.5]), np.array([STICK])
    rows, bent, p = np.array([[0.3, 0.2, 0.1]]), np.zeros((1, 3)), np.zeros(3)
    for normal, margin in product((2.0, 1.0, -1.0), (0.0, 1.0)):
        z = np.array([0.0, 0.0, normal])
        project(mu, modes, first, z, 1.0, margin, p)
        assert p.tolist() == [0.0, 0.0, max(normal, margin)]
        bend(1, mu, modes, first, z, 1.0, margin, rows, bent)
        assert np.isfinite(bent).all()
        if normal > margin:
            assert (bent == rows).all()
        elif normal < margin:
            assert not bent.any()


def nearest_inside(equations, target, last, mu, modes, first):
    """The least change from `last` to forces inside cones that fulfil the equations: Dykstra's alternating projections
    are slow, and simple."""
    x, kept = last.copy(), np.zeros((2, last.size))
    pseudo = np.linalg.pinv(equations)
    for _ in range(600):
        y = x + kept[0]
        x = y - pseudo @ (equations @ y - target)
        kept[0] = y - x
        y, p = x + kept[1], x.copy()
        project(mu, modes, first, y, redundant._AIMS[0], 0.0, p)
        x, kept[1] = p, y - p
    return x


@pytest.mark.parametrize("mode", [STICK, SLIP])
@SEEDS
def test_what_is_moved_inside_is_near_to_the_last_forces(seed, mode):
    """Of all that fulfil the equations in cones of nine tenths they are the nearest, but for the margin."""
    rng = np.random.default_rng(seed)
    n, rank = 6, 5
    modes = np.array([STICK] * 5 + [mode])
    # a slip's direction may be among the unknowns, too: it is in no cone
    first = np.concatenate([[0], np.cumsum(np.where(modes == STICK, 3, 1 + seed % 2))])
    unknowns, mu = first[-1], np.full(n, 0.6)
    moved = 0
    for _ in range(5):
        cone = newton_workspace(n)
        cone.first[:] = first
        turns = rng.uniform(0.0, 2.0 * math.pi, n)
        cone.direction[:] = np.c_[np.cos(turns), np.sin(turns)].ravel()
        sine, cosine = mu / np.hypot(1.0, mu), 1.0 / np.hypot(1.0, mu)
        cone.sine[:], cone.cosine[:] = sine, cosine
        last = rng.normal(size=(n, 3)) * 0.1 + [0.0, 0.0, 1.0]
        given = np.zeros(unknowns)
        for i in range(n):
            # of what slides, the length of the force along the cone's surface
            d = cone.direction[2 * i : 2 * i + 2]
            length = cosine[i] * last[i, 2] - sine[i] * (d @ last[i, :2])
            if modes[i] == STICK:
                given[first[i] : first[i + 1]] = last[i]
            else:
                given[first[i]] = length
        equations = rng.normal(size=(rank, unknowns))
        # other loads than those of the last forces, which there are forces for well inside
        other = 0.3 * np.tile([0, 0, 1.0], n)[:unknowns] * rng.uniform(-1, 1, unknowns)
        target = equations @ (given + other)
        cone.system[:rank, :unknowns], cone.rhs[:rank] = equations, target
        arguments = [getattr(cone, name) for name in ("x", "gram", "order")]
        assert least_norm(cone.system, cone.rhs, rank, unknowns, *arguments, 1e-12) == rank
        x = cone.x[:unknowns]
        if first[-1] - first[-2] == 2:
            given[-1] = x[-1]
        if is_inside(mu, modes, first, x):
            continue
        moved += 1
        move_inside(cone, rank, mu, modes, last.ravel())
        assert is_inside(mu, modes, first, x)
        assert equations @ x == pytest.approx(target, abs=1e-11)
        expected = nearest_inside(equations, target, given, mu, modes, first)
        # margins of a hundredth of the loads, and it ends as soon as it is inside, a tenth of friction away
        assert np.abs(x - expected).max() <= 0.06
        assert np.abs(x - given).max() <= np.abs(expected - given).max() + 0.03
    assert moved >= 2


@SEEDS
def test_least_loads(seed):
    """Against Lawson and Hanson's least squares; or no solution, where equations ask for what is negative."""
    rng = np.random.default_rng(seed)
    without = 0
    for _ in range(60):
        n = int(rng.integers(3, 15))
        rank = int(rng.integers(1, n))
        rows = np.linalg.qr(rng.normal(size=(n, rank)))[0].T
        bounded = rng.random(n) < 0.8
        loads = np.where(bounded, np.maximum(rng.normal(size=n), 0.0), rng.normal(size=n))
        target = rows @ loads
        null = np.linalg.svd(rows)[2][rank:]
        found = least_of(rows.T @ target, null, bounded)
        # free ones are differences of two that are not negative; the equations have the weight 1e6
        columns = np.hstack([np.eye(n), -np.eye(n)[:, ~bounded]])
        pairs = nnls(np.vstack([1e6 * rows, np.eye(n)]) @ columns, np.append(1e6 * target, np.zeros(n)))[0]
        # what the weights leave, times condition numbers of up to 1e4
        assert found == pytest.approx(columns @ pairs, abs=1e-8 * max(1.0, np.abs(loads).max()))
        assert rows @ found == pytest.approx(target, abs=1e-13 * n)
        assert found[bounded].min(initial=0.0) >= 0.0
        without += bool((found[bounded] == 0.0).any())
    assert without > 20
    # half the sum is -1
    least, null = np.full(4, -0.5), np.linalg.svd(np.full((1, 4), 0.5))[2][1:]
    assert least_of(least, null, np.full(4, True)) is None
    alone = least_of(least, null, np.array([True, True, True, False]))
    assert alone == pytest.approx([0.0, 0.0, 0.0, -2.0], abs=1e-15)


def test_no_more_loads_are_held_than_can_be():
    """Of loads next to each other round-off may take more for independent than the equations leave open: in one case of
    forty they were written behind the array, which is seen in what follows it."""
    for seed in range(1000):
        rng = np.random.default_rng(seed)
        k = int(rng.integers(1, 4))
        columns = rng.normal(size=(k, int(rng.integers(k + 2, 8))))
        n = columns.shape[1]
        for j in range(1, n):
            if rng.random() < 0.6:
                near = 10.0 ** rng.uniform(-9.0, -3.0) * rng.normal(size=k)
                columns[:, j] = rng.choice([-2.0, -0.5, 0.5, 2.0]) * columns[:, rng.integers(j)] + near
        null = np.ascontiguousarray(np.linalg.qr(columns.T)[0].T)
        x = rng.normal(size=n)
        x -= null.T @ (null @ x)
        memory, held = np.full((k + 1) ** 2 + 3 * n, 7.0), np.zeros(n + 1, dtype=np.int64)
        gram = memory[: (k + 1) ** 2].reshape(k + 1, k + 1)
        _move(null, np.ones(n), x, held, gram, np.empty((SCRATCH_ROWS, n + 1)))
        assert (memory[(k + 1) ** 2 :] == 7.0).all(), seed


@SEEDS
def test_where_all_slides_loads_are_least_and_turns_stay(seed):
    """Whatever solution is given: loads nearest to zero, turns nearest to what they are; against `least_of`."""
    rng = np.random.default_rng(seed)
    n, rank, moved = 6, 5, 0
    modes, mu = np.full(n, SLIP), np.full(n, 0.6)
    is_load = np.arange(2 * n) % 2 == 0
    for _ in range(10):
        cone = newton_workspace(n)
        cone.first[:] = 2 * np.arange(n + 1)
        equations = rng.normal(size=(rank, 2 * n))
        loads = np.where(is_load, np.maximum(rng.normal(size=2 * n), 0.0), rng.normal(size=2 * n))
        cone.system[:rank, : 2 * n], cone.rhs[:rank] = equations, equations @ loads
        arguments = [getattr(cone, name) for name in ("x", "gram", "order")]
        assert least_norm(cone.system, cone.rhs, rank, 2 * n, *arguments, 1e-12) == rank
        null = np.linalg.svd(equations)[2][rank:]
        x = cone.x[: 2 * n]
        x += null.T @ rng.normal(size=len(null))
        turns = np.where(is_load, 0.0, x)
        least = least_of(x - null.T @ (null @ (x - turns)), null, is_load)
        if (x[is_load] >= 0.0).all():
            continue
        moved += 1
        assert not move_inside(cone, rank, mu, modes, rng.normal(size=3 * n))
        # round-off times condition numbers of up to 1e3
        assert x == pytest.approx(least, abs=1e-11)
        assert equations @ x == pytest.approx(equations @ loads, abs=1e-11)
    assert moved >= 5
