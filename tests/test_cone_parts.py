"""Parts of the contact solver, each alone: what the solver as a whole would repair is seen here."""

import math

import numpy as np
import pytest
from calling import from_python

from pincontact.errors import ArgumentError
from pincontact.friction import cone
from pincontact.friction.cone import OPEN, SLIP, STICK
from pincontact.friction.problem import checked_problem

scale_problem = from_python(cone.scale_problem)
respond = from_python(cone.respond)
contact_residual = from_python(cone.contact_residual)
natural_map_residual = from_python(cone.natural_map_residual)
start_slip = from_python(cone.start_slip)
classify = from_python(cone.classify)
turn_direction = from_python(cone.turn_direction)
gauss_seidel_pass = from_python(cone.gauss_seidel_pass)

SEEDS = pytest.mark.parametrize("seed", range(3))
# of a few dozen terms of order one
ROUND_OFF = 1e-13


def problem(rng, contacts, rank=None):
    """A Delassus matrix (3n, 3n), b (3n,) and coefficients (n,)."""
    factor = rng.normal(size=(3 * contacts, 3 * contacts if rank is None else rank))
    return factor @ factor.T, rng.normal(size=3 * contacts), rng.uniform(0.1, 1.5, contacts)


def scaled(delassus, b):
    """The problem without units, and the units of the forces."""
    n = len(b) // 3
    g, c, scale, rest = np.zeros_like(delassus), np.zeros(3 * n), np.zeros(n), np.zeros(3 * n)
    largest = scale_problem(delassus, b, n, g, c, scale, rest)
    return g, c, scale, largest


def on_disk(p, radius):
    """The nearest point of a disk."""
    length = np.linalg.norm(p)
    return p if length <= radius else p * (radius / length)


def residual_of(f, u, mu):
    """The two projections of the module, as they stand there."""
    normal = abs(f[2] - max(f[2] - u[2], 0.0))
    return max(normal, np.linalg.norm(f[:2] - on_disk(f[:2] - u[:2], mu * max(f[2], 0.0))))


# ------------------------------------------------------------------------------------------- problem and natural map


@SEEDS
def test_a_scaled_problem_has_unit_blocks_and_the_same_solutions(seed):
    rng = np.random.default_rng(seed)
    sizes = np.repeat(10.0 ** rng.uniform(-3, 3, 4), 3)
    delassus, b, _ = problem(rng, 4)
    delassus, b = sizes[:, None] * delassus * sizes, sizes * b
    g, c, scale, largest = scaled(delassus, b)
    for i in range(4):
        assert np.trace(g[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]) == pytest.approx(3.0, rel=ROUND_OFF)
    assert np.abs(c).max() == pytest.approx(1.0, rel=ROUND_OFF)
    # forces s |b| f have the velocities |b| u / s
    f, unit = rng.normal(size=12), np.repeat(scale, 3)
    u = delassus @ (unit * largest * f) + b
    assert g @ f + c == pytest.approx(unit * u / largest, abs=ROUND_OFF * np.abs(g).sum())


def test_contacts_that_do_not_move_and_no_load_are_left_as_they_are():
    delassus = np.zeros((6, 6))
    delassus[3:, 3:] = 4.0 * np.eye(3)
    g, c, scale, largest = scaled(delassus, np.zeros(6))
    assert scale.tolist() == [1.0, 0.5]
    assert largest == 1.0
    assert not c.any()
    assert (g == np.diag([0.0] * 3 + [1.0] * 3)).all()


@SEEDS
def test_velocities_and_the_terms_that_cancel_in_them(seed):
    rng = np.random.default_rng(seed)
    g, c, _ = problem(rng, 3)
    f, u, size = rng.normal(size=9), np.zeros(9), np.zeros(3)
    respond(g, c, f, u, size, np.zeros(9))
    assert u == pytest.approx(g @ f + c, abs=ROUND_OFF * np.abs(g).sum())
    assert size == pytest.approx((np.abs(g) @ np.abs(f) + np.abs(c)).reshape(3, 3).sum(axis=1), rel=ROUND_OFF)


@SEEDS
def test_residual_of_a_contact(seed):
    rng = np.random.default_rng(seed)
    for _ in range(200):
        f, u, mu = rng.normal(size=3), rng.normal(size=3), rng.choice([0.0, 0.3, 2.0])
        if rng.random() < 0.5:
            u *= 0.1
        assert contact_residual(*f, *u, mu) == pytest.approx(residual_of(f, u, mu), abs=ROUND_OFF)


def test_residual_keeps_the_digits_that_a_huge_force_would_hide():
    assert contact_residual(0.0, 0.0, 1e30, 0.0, 0.0, 3e-9, 0.5) == 3e-9
    assert contact_residual(0.0, 0.0, 1e30, 3e-9, 4e-9, 0.0, 0.5) == 5e-9


def test_residual_of_infinite_friction():
    """It is at rest and presses, is open, or slides along its force's opposite with F_n = u_n = 0."""
    inf = math.inf
    assert contact_residual(5.0, -7.0, 2.0, 0.0, 0.0, 0.0, inf) == 0.0
    assert contact_residual(0.0, 0.0, 0.0, 2.0, 1.0, 3.0, inf) == 0.0
    assert contact_residual(-3.0, -4.0, 0.0, 0.3, 0.4, 0.0, inf) == pytest.approx(0.0, abs=1e-15)
    # creeping under a load, sinking in, sliding across or along the force: by as much as is to be seen
    assert contact_residual(0.0, 0.0, 2.0, 0.03, 0.04, 0.0, inf) == pytest.approx(0.05, rel=1e-12)
    assert contact_residual(0.0, 0.0, 0.2, 0.03, 0.04, 0.0, inf) == pytest.approx(0.05, rel=1e-12)
    assert contact_residual(5.0, -7.0, 2.0, 0.0, 0.0, 0.1, inf) == pytest.approx(0.1, rel=1e-12)
    assert contact_residual(0.0, 0.0, 0.0, 0.0, 0.0, -0.1, inf) == pytest.approx(0.1, rel=1e-12)
    assert contact_residual(0.0, 0.0, -0.2, 0.0, 0.0, 0.0, inf) == pytest.approx(0.2, rel=1e-12)
    f, p = np.array([3.0, 4.0]), np.array([3.0 - 0.4, 4.0 + 0.3])
    across = np.linalg.norm(f - 5.0 * p / np.linalg.norm(p))
    assert contact_residual(*f, 0.0, 0.4, -0.3, 0.0, inf) == pytest.approx(across, rel=1e-12)
    assert contact_residual(3.0, 4.0, 0.0, 0.3, 0.4, 0.0, inf) == pytest.approx(0.5, rel=1e-12)
    # a tangential force on a contact that parts, without a normal one: the lesser of the two
    assert contact_residual(0.3, 0.4, 0.0, 0.0, 0.0, 2.0, inf) == pytest.approx(0.5, rel=1e-12)
    assert contact_residual(3.0, 4.0, 0.0, 0.0, 0.0, 0.1, inf) == pytest.approx(0.1, rel=1e-12)
    # pressed a little and slipping: held up by friction but for this much
    assert contact_residual(-3.0, -4.0, 0.01, 3.0, 4.0, 0.0, inf) == pytest.approx(0.01, rel=1e-12)


def test_the_judge_takes_residuals_relative_to_what_cancels():
    mu, nothing = np.full(2, 0.5), np.zeros(6)
    u = np.array([0.0, 0.0, -0.2, 0.0, 0.0, -0.03])
    assert natural_map_residual(mu, nothing, u, np.array([10.0, 1.0])) == pytest.approx(0.03, rel=1e-12)
    # not below the floor, nor beyond the cap
    u = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -1e-6])
    assert natural_map_residual(mu, nothing, u, np.array([10.0, 1e-9])) == pytest.approx(
        1e-6 / (cone.FLOOR * 10.0), rel=1e-12
    )
    u[5] = -3.0
    assert natural_map_residual(mu, nothing, u, np.array([1.0, 1e9])) == pytest.approx(
        3.0 / cone.CANCELLATION, rel=1e-12
    )
    # whichever contact is the worst
    u[2] = -8.0
    assert natural_map_residual(mu, nothing, u, np.array([1e9, 1e9])) == pytest.approx(
        8.0 / cone.CANCELLATION, rel=1e-12
    )
    assert natural_map_residual(mu, nothing, nothing, np.zeros(2)) == 0.0


@pytest.mark.parametrize("place", range(2))
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_the_judge_refuses_what_is_not_finite(place, value):
    mu, f, u, size = np.full(2, 0.5), np.zeros(6), np.zeros(6), np.ones(2)
    size[place] = value
    assert natural_map_residual(mu, f, u, size) == math.inf
    size[place], u[3 * place + 2] = 1.0, -1e301
    assert natural_map_residual(mu, f, u, size) == math.inf


# ------------------------------------------------------------------------------------------- modes and directions


@SEEDS
def test_a_slip_starts_against_the_force_that_the_disk_is_left_in(seed):
    rng = np.random.default_rng(seed)
    for _ in range(30):
        mu = rng.choice([0.0, 0.4, 2.0, math.inf])
        f, u, direction = rng.normal(size=6), rng.normal(size=6), np.full(4, 7.0)
        length, speed = start_slip(3, mu, f, u, direction, 1)
        d = direction[2:]
        assert (direction[:2] == 7.0).all()
        # F_t - u_t points against d, from outside of the disk
        assert np.linalg.norm(d) == pytest.approx(1.0, rel=ROUND_OFF)
        assert d @ (f[3:5] - u[3:5]) == pytest.approx(-np.linalg.norm(f[3:5] - u[3:5]), rel=ROUND_OFF)
        angle = math.atan(mu)
        edge = np.array([*(-math.sin(angle) * d), math.cos(angle)])
        # the nearest of the forces on this edge of the cone
        assert length == pytest.approx(max(edge @ f[3:], 0.0), abs=ROUND_OFF)
        assert speed == pytest.approx(max(d @ u[3:5], 0.0), abs=ROUND_OFF)
    assert start_slip(0, 0.5, np.array([0.0, 0.0, 1.0]), np.zeros(3), direction, 0)[1] == 0.0
    assert direction[:2].tolist() == [1.0, 0.0]


@SEEDS
def test_modes_are_those_in_which_the_projections_land(seed):
    rng = np.random.default_rng(seed)
    n = 60
    mu, f, u = rng.choice([0.0, 0.4, 2.0, math.inf], n), rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    # one without any force
    f[0] = u[0] = 0.0
    # and steep cones, which are told apart as if they were not quite so steep
    f[1], u[1], mu[1] = [300.0, 0.0, 2.0], [0.0, 0.0, 1.0], math.inf
    modes = np.zeros(n, dtype=np.int64)
    classify(mu, f.ravel(), u.ravel(), modes)
    for i in range(2, n):
        radius = min(mu[i], cone.LARGEST_FRICTION) * f[i, 2]
        if f[i, 2] - u[i, 2] <= 0.0:
            assert modes[i] == OPEN
        elif mu[i] > 0.0 and np.linalg.norm(f[i, :2] - u[i, :2]) <= radius:
            assert modes[i] == STICK
        else:
            assert modes[i] == SLIP
    assert modes[:2].tolist() == [OPEN, SLIP]
    assert len(set(modes[2:])) == 3


def test_a_contact_without_friction_slips_even_at_rest():
    modes = np.zeros(2, dtype=np.int64)
    classify(np.array([0.0, 0.1]), np.array([0.0, 0.0, 1.0] * 2), np.zeros(6), modes)
    assert modes.tolist() == [SLIP, STICK]


def test_directions_turn_by_an_arc():
    direction = np.array([1.0, 0.0, 0.6, 0.8])
    assert turn_direction(direction, 1, 3.0, 4.0) == 0.75
    # by atan(arc / radius), to the left
    turned = math.atan2(0.8, 0.6) + math.atan2(3.0, 4.0)
    assert direction == pytest.approx([1.0, 0.0, math.cos(turned), math.sin(turned)], abs=1e-15)
    assert turn_direction(direction, 0, 3.0, 0.0) == 0.0
    assert direction[:2].tolist() == [1.0, 0.0]


@SEEDS
def test_a_sweep_projects_each_contact_in_its_turn(seed):
    rng = np.random.default_rng(seed)
    n = 4
    g, c, mu = problem(rng, n)
    mu[0] = math.inf
    # a contact that moves in one tangential direction alone, and one that does not move at all
    g[4] = g[:, 4] = g[5] = g[:, 5] = 0.0
    g[9:] = g[:, 9:] = 0.0
    # of any size
    g *= 10.0 ** rng.integers(-2, 2)
    f = np.abs(rng.normal(size=3 * n))
    u = g @ f + c
    expected = f.copy()
    for i in range(n):
        k = 3 * i
        if g[k + 2, k + 2] > 0.0:
            # the only load of this contact that stops it, where it presses
            rest = c[k + 2] + g[k + 2] @ expected - g[k + 2, k + 2] * expected[k + 2]
            expected[k + 2] = max(-rest / g[k + 2, k + 2], 0.0)
        stiffness = np.linalg.eigvalsh(g[k : k + 2, k : k + 2])[-1]
        if stiffness > 0.0:
            moved = expected[k : k + 2] - (g[k : k + 2] @ expected + c[k : k + 2]) / stiffness
            expected[k : k + 2] = on_disk(moved, min(mu[i], cone.LARGEST_FRICTION) * expected[k + 2])
    gauss_seidel_pass(g, mu, f, u)
    assert f == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())
    assert u == pytest.approx(g @ f + c, abs=1e-12 * np.abs(g).sum())


def test_a_nearly_symmetric_problem_is_made_symmetric():
    """Round-off of a product, not more; the rest stays as it is."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(6, 8))
    gram = rows @ rows.T
    error = 1e-10 * np.triu(rng.uniform(0.5, 1.0, (6, 6)), 1)
    matrix, b, mu = checked_problem(gram + error, np.arange(6.0), 0.3)
    assert (matrix == matrix.T).all()
    assert matrix == pytest.approx(gram + 0.5 * (error + error.T), rel=1e-14)
    assert (b.tolist(), mu.tolist()) == ([0.0, 1.0, 2.0, 3.0, 4.0, 5.0], [0.3, 0.3])
    with pytest.raises(ArgumentError, match="not symmetric"):
        checked_problem(gram + 1e4 * error, np.zeros(6), 0.3)
