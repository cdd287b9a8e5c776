"""The path to a solution of the contact problem: its equations, their derivatives, and that it is followed."""

import math

import numpy as np
import pytest
from calling import from_python
from test_cone_parts import problem, scaled

from pincontact.friction import homotopy
from pincontact.friction.cone import HUGE, LARGEST_FRICTION, LEAST_FRICTION, cone_workspace

cone_units = from_python(homotopy.cone_units)
cone_step = from_python(homotopy.cone_step)
homotopy_residual = from_python(homotopy.homotopy_residual)
homotopy_matrix = from_python(homotopy.homotopy_matrix)
homotopy_slope = from_python(homotopy.homotopy_slope)

SEEDS = pytest.mark.parametrize("seed", range(3))


# ------------------------------------------------------------------------------------------------ cones


def frictions(mu):
    """The coefficients that cones are made circular with."""
    return np.where(mu > 0.0, np.clip(mu, LEAST_FRICTION, LARGEST_FRICTION), 1.0)


@SEEDS
def test_units_make_cones_circular_and_blocks_unit_sized(seed):
    rng = np.random.default_rng(seed)
    n = 6
    g, c, mu = problem(rng, n)
    mu[:4] = 0.0, 1e-9, math.inf, 1e-3
    g[15:] = g[:, 15:] = 0.0
    weight = np.zeros(3 * n)
    unit = cone_units(g, c, mu, weight)
    assert unit == pytest.approx(np.abs(weight * c).max(), rel=1e-14)
    rows = weight.reshape(n, 3)
    assert (rows[:, 0] == rows[:, 1]).all()
    # |F_t| <= mu F_n of F = weight f is |f_t| <= f_n
    assert rows[:, 2] * frictions(mu) == pytest.approx(rows[:, 0], rel=1e-14)
    blocks = (weight[:, None] * g * weight).diagonal().reshape(n, 3).sum(axis=1)
    assert blocks == pytest.approx([3.0] * 5 + [0.0], rel=1e-13)
    assert rows[5, 0] == 1.0


@SEEDS
def test_units_of_light_contacts(seed):
    rng = np.random.default_rng(seed)
    g, c, mu = problem(rng, 2)
    g *= 1e-3
    weight = np.zeros(6)
    cone_units(g, c, mu, weight)
    blocks = (weight[:, None] * g * weight).diagonal().reshape(2, 3).sum(axis=1)
    assert blocks == pytest.approx([3.0, 3.0], rel=1e-13)


def test_units_without_load():
    assert cone_units(np.eye(3), np.zeros(3), np.ones(1), np.zeros(3)) == 1.0


def depth(x):
    """How far inside the cone, below zero outside."""
    return x[2] - math.hypot(x[0], x[1])


@SEEDS
def test_a_step_ends_on_the_cone(seed):
    rng = np.random.default_rng(seed)
    far = 0
    for k in range(300):
        x = rng.normal(size=3)
        x[2] = math.hypot(x[0], x[1]) + rng.uniform(1e-3, 2.0)
        d = rng.normal(size=3)
        if k % 10 == 0:
            # along a line of the surface, either way; straight down; along the axis
            d = [np.array([0.6, 0.8, 1.0]), np.array([0.6, 0.8, -1.0]), np.array([0, 0, -1.0]), x][k // 10 % 4]
        step = cone_step(*x, *d)
        if step >= 1e10:
            far += 1
            assert depth(x + 1e6 * d) >= 0.0
            continue
        # round-off of a quadratic equation's solution, times the slope of the depth
        assert depth(x + step * d) == pytest.approx(0.0, abs=1e-9 * (1.0 + step * np.abs(d).max()))
        for part in np.linspace(0.0, 0.999, 20):
            assert depth(x + part * step * d) > 0.0
    assert 20 < far < 200


def test_a_step_as_good_as_along_the_surface_keeps_its_digits():
    # 1.1 + s = (1 + 2^-30) s; squares round to 2^-31 of their difference
    assert cone_step(0.0, 0.0, 1.1, 1.0 + 2.0**-30, 0.0, 1.0) == pytest.approx(1.1 * 2.0**30, rel=2e-9)


def test_no_step_leaves_the_cone_without_a_direction():
    assert cone_step(0.1, 0.2, 1.0, 0.0, 0.0, 0.0) == 1e10


# ------------------------------------------------------------------------------------------------ equations


def on_path(rng, n):
    """A point x = (f, t) in the cones, the problem in circular cones, and y there as a function of x."""
    a, c, _ = problem(rng, n)
    r = rng.normal(size=3 * n)
    x = rng.normal(size=3 * n + 1)
    x[2::3] = np.hypot(x[:-1:3], x[1::3]) + rng.uniform(0.1, 1.0, n)
    x[-1] = rng.uniform(0.2, 0.9)
    # into the cones
    c[2::3] += 20.0 * n

    def y_of(x):
        t = x[-1]
        y = a @ x[:-1] + c + t * r
        y[2::3] += (1.0 - t) * np.sqrt(y[::3] ** 2 + y[1::3] ** 2 + t**2)
        return y

    return a, c, r, x, y_of


def products(x, y):
    """f o y - t e, contact by contact."""
    f, y, out = x[:-1].reshape(-1, 3), y.reshape(-1, 3), []
    for p, q in zip(f, y):
        out += [p[2] * q[0] + q[2] * p[0], p[2] * q[1] + q[2] * p[1], p @ q - x[-1]]
    return np.array(out)


@SEEDS
def test_residuals_of_the_paths_equations(seed):
    rng = np.random.default_rng(seed)
    a, c, r, x, y_of = on_path(rng, 3)
    exact = y_of(x)
    for off in (0.0, 1.0):
        y = exact + off * rng.normal(size=9)
        h, gap = np.zeros(9), np.zeros(9)
        worst = homotopy_residual(a, c, r, x, y, h, gap)
        assert h == pytest.approx(products(x, y), rel=1e-13, abs=1e-12)
        expected = a @ x[:-1] + c + x[-1] * r - y
        expected[2::3] += (1.0 - x[-1]) * np.sqrt(y[::3] ** 2 + y[1::3] ** 2 + x[-1] ** 2)
        assert gap == pytest.approx(expected, abs=1e-11)
        # relative to t
        assert worst == pytest.approx(max(np.abs(h).max(), np.abs(expected).max()) / x[-1], rel=1e-10)


def test_the_gap_counts_beyond_round_off():
    """Where f o y = t e holds to the bit, what is missing in y counts, but not the last digits of large terms."""
    a, c, r = np.diag([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]), np.zeros(3)
    x, y, h, gap = np.array([0.0, 0.0, 1.0, 1.0]), np.array([0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3)
    assert homotopy_residual(a, c, r, x, y, h, gap) == pytest.approx(0.0, abs=1e-13)
    c[2] = 1.5
    assert homotopy_residual(a, c, r, x, y, h, gap) == pytest.approx(0.5, rel=1e-13)
    c[2] = 0.5
    assert homotopy_residual(a, c, r, x, y, h, gap) == pytest.approx(0.5, rel=1e-13)
    # 1e4 of a load against as much of a force: the sum is exact to 1e-12
    a[2, 2], c[2] = 1e4, 1.0 - 1e4 + 1e-11
    assert homotopy_residual(a, c, r, x, y, h, gap) <= 0.0
    a[2, 2], r[2], c[2] = 0.0, 1e4, 1.0 - 1e4 + 1e-9
    assert homotopy_residual(a, c, r, x, y, h, gap) == pytest.approx(1e-9, rel=1e-2)


def test_outside_of_the_cones_there_is_no_path():
    a, c, r, x, y_of = on_path(np.random.default_rng(0), 2)
    y, h, gap = y_of(x), np.zeros(6), np.zeros(6)
    assert homotopy_residual(a, c, r, x, y, h, gap) < HUGE
    for place in range(2):
        for array in (x, y):
            kept = array[3 * place + 2]
            array[3 * place + 2] = 0.99 * math.hypot(*array[3 * place : 3 * place + 2])
            assert homotopy_residual(a, c, r, x, y, h, gap) == HUGE
            array[3 * place + 2] = kept
    for t in (0.0, -0.1):
        x[-1] = t
        assert homotopy_residual(a, c, r, x, y, h, gap) == HUGE


@SEEDS
def test_derivatives_of_the_paths_equations(seed):
    """Against central differences of the equations, y as a function of x."""
    rng = np.random.default_rng(seed)
    a, _, r, x, y_of = on_path(rng, 3)
    step = 1e-5
    unit = np.eye(10)
    slopes = np.array([(y_of(x + step * d) - y_of(x - step * d)) / (2.0 * step) for d in unit]).T
    ahead = np.array([products(x + step * d, y_of(x + step * d)) for d in unit])
    behind = np.array([products(x - step * d, y_of(x - step * d)) for d in unit])
    derivative = ((ahead - behind) / (2.0 * step)).T
    # step^2 times third derivatives, and round-off over step
    accuracy = 1e-7 * np.abs(derivative).max()
    border, system = rng.normal(size=10), np.full((10, 10), 5.0)
    homotopy_matrix(a, r, x, y_of(x), border, system)
    assert system[:9] == pytest.approx(derivative, abs=accuracy)
    # lengths count t by its logarithm
    assert system[9] == pytest.approx([*border[:9], border[9] / x[9] ** 2], rel=1e-14)
    change, slope = rng.normal(size=10), np.zeros(9)
    homotopy_slope(a, r, x, y_of(x), change, slope)
    assert slope == pytest.approx(slopes @ change, abs=accuracy)
    # gaps that are there already are closed with the change
    rest = 1e-4 * rng.normal(size=9)
    closed = rest.copy()
    homotopy_slope(a, r, x, y_of(x), np.zeros(10), closed)
    turn = np.zeros(9)
    y, t = y_of(x), x[-1]
    for k in (0, 3, 6):
        turn[k + 2] = y[k : k + 2] @ rest[k : k + 2] / math.sqrt(y[k : k + 2] @ y[k : k + 2] + t * t)
    assert closed == pytest.approx(rest + (1.0 - t) * turn, abs=1e-15)


# ------------------------------------------------------------------------------------------------ the path


def point(delassus, b, mu, size, forces, t):
    """The residual of the path's equations at forces (3n,), in the units of the module, and the part of the way that
    these are inside their cones."""
    n = len(mu)
    g, c, scale, largest = scaled(delassus, b)
    weight = np.zeros(3 * n)
    unit = cone_units(g, c, mu, weight) / size
    f = forces / (weight * unit * np.repeat(scale, 3) * largest)
    a, c = weight[:, None] * g * weight, weight * c / unit
    for i in np.flatnonzero(mu == 0.0):
        rows = [3 * i, 3 * i + 1]
        a[rows] = a[:, rows] = c[rows] = 0.0
    e = np.tile([0.0, 0.0, 1.0], n)
    r = e - c - a @ e
    y = a @ f + c + t * r
    y[2::3] += (1.0 - t) * np.sqrt(y[::3] ** 2 + y[1::3] ** 2 + t**2)
    inside = min(depth(k) for k in [*f.reshape(n, 3), *y.reshape(n, 3)])
    return np.abs(products(np.append(f, t), y)).max() / t, inside, f


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
@SEEDS
def test_what_is_returned_lies_on_the_path(seed, size):
    rng = np.random.default_rng(seed)
    n, tube = 3, 1e-3
    delassus, b, mu = problem(rng, n)
    delassus, b = 1e-3 * delassus, 50.0 * b
    mu[0] = (0.0, math.inf, 0.5)[seed]
    memory = cone_workspace(n)
    assert homotopy.follow_homotopy(delassus, b, mu, memory.address, 1.0, tube, size, 0) == 1.0
    residual, inside, f = point(delassus, b, mu, size, memory.forces, 1.0)
    assert f == pytest.approx(np.tile([0.0, 0.0, 1.0], n), abs=1e-13)
    # f = y = e
    assert (residual, inside) == (pytest.approx(0.0, abs=1e-13), pytest.approx(1.0, rel=1e-12))
    steps = 0
    for stop in (0.5, 1e-2, 1e-4):
        reached = 1.0
        while reached > stop:
            reached = homotopy.follow_homotopy(delassus, b, mu, memory.address, stop, tube, size, 1)
            steps += 1
            residual, inside, f = point(delassus, b, mu, size, memory.forces, reached)
            # as near as the tube is wide, and what a gap as wide times the forces adds
            assert residual <= tube * (1.0 + 3.0 * np.abs(f).max())
            assert inside > 0.0
        if mu[0] == 0.0:
            assert np.abs(f[:2]).max() <= 2.0 * tube
    # four digits of t in some ten steps: Newton's corrections let them grow, and its tangent lets them be long; the
    # steep cone of infinite friction takes more
    assert steps <= ({0.1: 23, 1.0: 31, 10.0: 51} if mu[0] > 1e3 else {0.1: 11, 1.0: 9, 10.0: 16})[size]
    # a call that has nothing to do leaves things as they are
    forces = memory.forces.copy()
    assert homotopy.follow_homotopy(delassus, b, mu, memory.address, 0.5, tube, size, 9) == reached
    assert memory.forces == pytest.approx(forces, rel=1e-14)


@SEEDS
def test_the_path_leaves_contacts_without_friction_without_tangential_forces(seed):
    """Their tangential velocity is what it is, and what it does to the normal forces is in the equations of no row."""
    rng = np.random.default_rng(seed)
    delassus, b, mu = problem(rng, 4)
    mu[rng.integers(2)], mu[2] = 0.0, 0.0
    memory = cone_workspace(4)
    homotopy.follow_homotopy(delassus, b, mu, memory.address, 1.0, 0.01, 1.0, 0)
    assert homotopy.follow_homotopy(delassus, b, mu, memory.address, 1e-9, 0.01, 1.0, 300) <= 1e-9
    f = memory.forces.reshape(4, 3)
    smooth = mu == 0.0
    assert not f[smooth, :2].any()
    gap = (delassus @ memory.forces + b).reshape(4, 3)[smooth, 2]
    # up to the path's t in units of the scaled problem
    assert np.abs(f[smooth, 2] * gap).max() <= 1e-6 * (1.0 + np.abs(f).max())
    assert gap.min() >= -1e-6
    assert f[:, 2].min() >= -1e-6


@SEEDS
def test_the_path_ends_at_a_solution(seed):
    """Its distance from one falls with t, down to the end."""
    rng = np.random.default_rng(seed)
    n = 4
    delassus, b, mu = problem(rng, n)
    memory = cone_workspace(n)
    homotopy.follow_homotopy(delassus, b, mu, memory.address, 1.0, 0.01, 1.0, 0)
    for stop in (1e-3, 1e-6, 1e-9):
        assert homotopy.follow_homotopy(delassus, b, mu, memory.address, stop, 0.01, 1.0, 200) <= stop
        f = memory.forces.reshape(n, 3)
        u = (delassus @ memory.forces + b).reshape(n, 3)
        size = 1.0 + np.abs(f).max()
        dual = u[:, 2] + mu * np.hypot(u[:, 0], u[:, 1])
        # both in their cones, and orthogonal, up to t times units of the scaled problem, below 1e3
        assert (mu * f[:, 2] - np.hypot(f[:, 0], f[:, 1])).min() >= -1e-12 * size
        assert (mu * dual - mu * mu * np.hypot(u[:, 0], u[:, 1])).min() >= -1e3 * stop * size
        assert np.abs(np.einsum("ij,ij->i", f[:, :2], u[:, :2]) + f[:, 2] * dual).max() <= 1e3 * stop * size**2


def test_a_path_without_end_leaves_for_infinity():
    memory = cone_workspace(1)
    args = np.diag([1.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0]), np.ones(1), memory.address
    homotopy.follow_homotopy(*args, 1.0, 0.01, 1.0, 0)
    assert homotopy.follow_homotopy(*args, 1e-9, 0.01, 1.0, 500) == HUGE


def test_errors_are_corrected_as_newtons_method_does():
    """An error of 1e-6 in y, in any of its places, is 1e-12 after one correction: the next step may be longer by as
    much as after a step that took one."""
    rng = np.random.default_rng(2)
    delassus, b, mu = problem(rng, 2)
    memory = cone_workspace(2)
    start = delassus, b, mu, memory.address
    homotopy.follow_homotopy(*start, 1.0, 1e-3, 1.0, 0)
    homotopy.follow_homotopy(*start, 0.3, 1e-9, 1.0, 100)
    kept = memory.homotopy.copy()
    for place in range(6):
        memory.homotopy[:] = kept
        memory.homotopy[6, place] += 1e-6
        # a step as good as none
        memory.homotopy[5, 0] = 1e-7
        homotopy.follow_homotopy(*start, 1e-3, 1e-9, 1.0, 1)
        assert memory.homotopy[5, 0] == pytest.approx(1e-7 * homotopy.LONGER[1], rel=1e-12)
