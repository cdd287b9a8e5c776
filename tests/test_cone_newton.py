"""Newton's iteration of the contact solver, each of its parts alone: one step, mode corrections, directions of slip."""

import math

import numpy as np
import pytest
from calling import from_python
from test_cone import newton_errors, newton_workspace
from test_cone_parts import problem, residual_of

from pincontact.friction import newton
from pincontact.friction.cone import CANDIDATES, CONE, OPEN, SLIP, STICK

newton_step = from_python(newton.newton_step, CONE)
correct_modes = from_python(newton.correct_modes)
close_touching = from_python(newton.close_touching)
slip_equation = from_python(newton.slip_equation)
slip_angles = from_python(newton.slip_angles)
active_set_solve = from_python(newton.active_set_solve, CONE)

SEEDS = pytest.mark.parametrize("seed", range(4))


def edge(mu, angle):
    """The unit force on the cone's surface against a slip in this direction."""
    half = math.atan(mu)
    return np.array([-math.sin(half) * math.cos(angle), -math.sin(half) * math.sin(angle), math.cos(half)])


# ------------------------------------------------------------------------------------------------ one step


@pytest.mark.parametrize("refine", [False, True])
@SEEDS
def test_a_step_solves_newtons_equations(seed, refine):
    """Without a factor of the matrix, all modes mixed: the equations as written out, from any state."""
    rng = np.random.default_rng(seed)
    n = 5
    for _ in range(8):
        g, c, _ = problem(rng, n)
        mu = rng.choice([0.0, 0.3, 2.0], n)
        modes = rng.permutation(np.array([OPEN, STICK, STICK, SLIP, SLIP]))
        modes[mu == 0.0] = rng.choice([OPEN, SLIP])
        cone = newton_workspace(n)
        angles = rng.uniform(0.0, 2.0 * math.pi, n)
        cone.direction[:] = np.c_[np.cos(angles), np.sin(angles)].ravel()
        cone.length[:], cone.speed[:] = rng.uniform(0.2, 2.0, (2, n))
        cone.sine[:], cone.cosine[:] = mu / np.hypot(1.0, mu), 1.0 / np.hypot(1.0, mu)
        f = np.zeros((n, 3))
        for i in range(n):
            if modes[i] == STICK:
                f[i] = rng.normal(size=3)
            elif modes[i] == SLIP:
                f[i] = cone.length[i] * edge(mu[i], angles[i])
        f = f.ravel()
        before, known = f.copy(), {name: getattr(cone, name).copy() for name in CONE.arrays}
        u = g @ f + c
        assert newton_step(cone, g, c, mu, modes, f, u, refine, False, before, 0)[:2] == (0, False)
        # what slips with friction has turned by atan(arc / (friction force + speed))
        new = cone.direction.reshape(n, 2)
        assert np.linalg.norm(new, axis=1) == pytest.approx(np.ones(n), rel=1e-13)
        turned = np.arctan2(new[:, 1], new[:, 0]) - angles
        arcs = np.tan(turned) * (known["sine"] * known["length"] + known["speed"])
        arcs[(modes != SLIP) | (mu == 0.0)] = 0.0
        errors, size = newton_errors(
            g, u if refine else c, mu, modes, known, f - refine * before, arcs, refine, cone.length
        )
        # round-off times condition numbers of up to 1e4
        assert errors == pytest.approx(np.zeros(errors.size), abs=1e-10 * size)
        for i in range(n):
            force = f[3 * i : 3 * i + 3]
            if modes[i] == SLIP:
                expected = cone.length[i] * edge(mu[i], math.atan2(new[i, 1], new[i, 0]))
                assert force == pytest.approx(expected, abs=1e-12 * size)
            elif modes[i] == OPEN:
                assert not force.any()
            if modes[i] != SLIP or mu[i] == 0.0:
                assert (new[i] == known["direction"][2 * i : 2 * i + 2]).all()


def test_a_slip_that_neither_pushes_nor_moves_keeps_its_direction():
    cone = newton_workspace(1)
    cone.direction[0] = 1.0
    cone.sine[:], cone.cosine[:] = 0.6, 0.8
    f, c = np.zeros(3), np.array([0.0, 0.0, -2.0])
    newton_step(cone, np.eye(3), c, np.array([0.75]), np.array([SLIP]), f, c, False, False, f, 0)
    # the length whose normal part is the load
    assert f == pytest.approx([-1.5, 0.0, 2.0], rel=1e-14)
    assert cone.direction.tolist() == [1.0, 0.0]


def test_open_contacts_have_no_forces_and_leave_nothing_to_choose():
    cone = newton_workspace(2)
    f = np.ones(6)
    modes = np.full(2, OPEN)
    left = newton_step(cone, np.eye(6), f, np.ones(2), modes, f, f.copy(), True, True, f, 0)
    assert left == (0, False, 0.0)
    assert not f.any()


@pytest.mark.parametrize("refine", [False, True])
def test_a_step_counts_the_directions_in_which_forces_may_change(refine):
    rng = np.random.default_rng(0)
    for rank in (3, 5, 7):
        g, c, mu = problem(rng, 4, rank)
        modes = np.array([STICK, SLIP, STICK, STICK])
        cone = newton_workspace(4)
        cone.direction[::2] = 1.0
        cone.length[:] = cone.speed[:] = 1.0
        cone.sine[:], cone.cosine[:] = mu / np.hypot(1.0, mu), 1.0 / np.hypot(1.0, mu)
        f = np.ones(12)
        left = newton_step(cone, g, g @ c, mu, modes, f, g @ (f + c), refine, False, f, 0)
        # eleven unknowns; that the slip turns where it points is one equation more than the bodies' motions
        assert left[:2] == (11 - (rank + 1), False)


# ------------------------------------------------------------------------------------------------ modes


def corrected(mode, f, u, mu=0.5, length=1.0, direction=(1.0, 0.0)):
    """The mode of the second of two contacts, how many changed, and what is known of its slip."""
    modes = np.array([OPEN, mode])
    forces, velocities = np.array([0.0, 0.0, 0.0, *f]), np.array([9.0, 9.0, 9.0, *u])
    directions, lengths, speeds = np.array([0.6, 0.8, *direction]), np.array([7.0, length]), np.array([7.0, 7.0])
    changes = correct_modes(np.array([0.5, mu]), modes, forces, velocities, directions, lengths, speeds)
    assert modes[0] == OPEN
    assert (lengths[0], speeds[0]) == (7.0, 7.0)
    assert directions[:2].tolist() == [0.6, 0.8]
    return modes[1], changes, lengths[1], speeds[1], directions[2:].tolist()


def test_modes_are_corrected_where_forces_or_velocities_contradict_them():
    # open: until it approaches; without friction there is no rest
    assert corrected(OPEN, [0, 0, 0], [3, 3, 0])[:2] == (OPEN, 0)
    assert corrected(OPEN, [0, 0, 0], [3, 3, -0.1])[:3] == (STICK, 1, 0.0)
    assert corrected(OPEN, [0, 0, 0], [3, 3, -0.1], mu=0.0)[:3] == (SLIP, 1, 0.0)
    # rest: while the force is in the cone
    assert corrected(STICK, [0.3, -0.4, 1.0], [0, 0, 0])[:2] == (STICK, 0)
    assert corrected(STICK, [0, 0, -0.1], [0, 0, 0])[:2] == (OPEN, 1)
    assert corrected(STICK, [0, 0, 0.0], [0, 0, 0])[:2] == (STICK, 0)
    mode, changes, length, speed, direction = corrected(STICK, [0.6, -0.8, 1.0], [0, 0, 0])
    assert (mode, changes, speed) == (SLIP, 1, 0.0)
    assert direction == pytest.approx([-0.6, 0.8])
    # the part of the force along the cone's surface
    assert length == pytest.approx((0.5 * 1.0 + 1.0) / math.hypot(1.0, 0.5), rel=1e-14)
    assert corrected(STICK, [0.6, 0.0, 1.0], [0, 0, 0])[0] == SLIP
    assert corrected(STICK, [0.0, 0.6, 1.0], [0, 0, 0])[0] == SLIP
    # slip: while it pushes and goes on, forwards
    assert corrected(SLIP, [-0.5, 0, 1], [2, 9, 0])[:4] == (SLIP, 0, 1.0, 2.0)
    assert corrected(SLIP, [-0.5, 0, 1], [2, 3, 0], direction=(0.6, 0.8))[:4] == (SLIP, 0, 1.0, pytest.approx(3.6))
    assert corrected(SLIP, [0.5, 0, -1], [2, 9, 0], length=-0.1)[:2] == (OPEN, 1)
    assert corrected(SLIP, [0, 0, 0], [2, 0, 0], length=0.0)[:2] == (SLIP, 0)
    assert corrected(SLIP, [-0.5, 0, 1], [-1e-6, 0, 0])[:2] == (STICK, 1)
    assert corrected(SLIP, [-0.5, 0, 1], [-1e-14, 0, 0])[:4] == (SLIP, 0, 1.0, 0.0)
    assert corrected(SLIP, [0, 0, 1], [-1, 0, 0], mu=0.0)[:4] == (SLIP, 0, 1.0, 0.0)


def test_all_changes_of_modes_are_counted():
    modes = np.array([OPEN, OPEN, STICK, STICK, SLIP, SLIP, SLIP])
    f = np.array([[0.0, 0.0, 0.0]] * 2 + [[0.0, 0.0, -1.0], [9.0, 0.0, 1.0]] + [[0.0, 0.0, 1.0]] * 3)
    u = np.zeros((7, 3))
    u[:2, 2] = -1.0
    u[5, 0] = -1.0
    length = np.array([1.0, 1.0, 1.0, 1.0, -1.0, 1.0, 1.0])
    direction = np.tile([1.0, 0.0], 7)
    assert correct_modes(np.full(7, 0.5), modes, f.ravel(), u.ravel(), direction, length, np.zeros(7)) == 6
    assert modes.tolist() == [STICK, STICK, OPEN, SLIP, OPEN, STICK, SLIP]


def test_what_touched_is_closed_again():
    touching, mu = np.array([0, 1, 2, 2, 0, 1, 1, 2]), np.array([1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0])
    modes = np.array([OPEN, OPEN, OPEN, OPEN, SLIP, STICK, SLIP, SLIP])
    assert close_touching(mu, modes, touching)
    assert modes.tolist() == [OPEN, SLIP, STICK, SLIP, SLIP, STICK, SLIP, STICK]
    # that is all there is to do
    assert not close_touching(mu, modes, touching)
    assert modes.tolist() == [OPEN, SLIP, STICK, SLIP, SLIP, STICK, SLIP, STICK]
    for i in range(8):
        # whichever of them it is
        one = np.array([STICK, STICK, SLIP, SLIP, STICK, SLIP, OPEN, STICK])[i : i + 1]
        before = one.copy()
        assert close_touching(mu[i : i + 1], one, touching[i : i + 1]) == (one != before).any()


# ------------------------------------------------------------------------------------------------ one contact


@SEEDS
def test_the_equation_of_a_slip_says_that_it_goes_straight_on(seed):
    rng = np.random.default_rng(seed)
    for _ in range(20):
        g, c, (mu,) = problem(rng, 1)
        angle = rng.uniform(0.0, 2.0 * math.pi)
        equation, stiffness, d1, d2 = slip_equation(g, c, mu, angle)
        assert (d1, d2) == pytest.approx((math.cos(angle), math.sin(angle)))
        # the force that stops the approach
        force = -c[2] / stiffness * edge(mu, angle)
        u = g @ force + c
        assert u[2] == pytest.approx(0.0, abs=1e-10 * (1.0 + np.abs(force).max()))
        across = d1 * u[1] - d2 * u[0]
        assert equation == pytest.approx(across * stiffness, abs=1e-10)


def on_circle(coefficients):
    """Angles at which a trigonometric polynomial, coefficients of z^2 to z^-2, vanishes."""
    zeros = np.roots(coefficients)
    return np.angle(zeros[np.abs(np.abs(zeros) - 1.0) < 1e-6])


def zeros_and_touches(g, c, mu):
    """Angles at which the slip equation, of second degree, vanishes, and those where it comes near zero and turns."""
    values = [slip_equation(g, c, mu, turn)[0] for turn in 2.0 * math.pi * np.arange(8) / 8]
    spectrum = np.fft.fft(values) / 8
    assert abs(spectrum[3]) + abs(spectrum[4]) < 1e-12 * np.abs(values).max()
    orders = np.array([2, 1, 0, -1, -2])
    coefficients = spectrum[orders]
    flat = on_circle(1j * orders * coefficients)
    height = [(np.exp(1j * orders * angle) @ coefficients).real for angle in flat]
    bend = [-(np.exp(1j * orders * angle) @ (orders**2 * coefficients)).real for angle in flat]
    return on_circle(coefficients), flat[np.array(height) * bend > 0.0]


def distance(angles, angle):
    """From the nearest of some angles."""
    return np.abs((np.asarray(angles) - angle + math.pi) % (2.0 * math.pi) - math.pi).min()


@SEEDS
def test_every_direction_of_slip_is_found(seed):
    rng = np.random.default_rng(seed)
    seen = set()
    for _ in range(12):
        g, c, (mu,) = problem(rng, 1)
        zeros, touches = zeros_and_touches(g, c, mu)
        # two within a step of the scan are not told apart for sure
        both = [*zeros, *touches]
        if any(distance(np.delete(both, i), angle) < 0.2 for i, angle in enumerate(both) if len(both) > 1):
            continue
        seen.add(len(zeros))
        angles = np.full(CANDIDATES, math.nan)
        count = slip_angles(g, c, mu, angles)
        assert count == 4 + len(both)
        assert np.isnan(angles[count:]).all()
        for angle in zeros:
            # bisection is exact to 2^-40 of its step; the roots of the polynomial to its conditioning
            assert distance(angles[4:count], angle) < 1e-10
        for angle in touches:
            # where a function is least is known to the root of its own accuracy
            assert distance(angles[4:count], angle) < 1e-6
        # whatever the matrix: along the load, and along what the normal force pushes
        along = [math.atan2(c[1], c[0]), math.atan2(g[1, 2], g[0, 2])]
        for angle in (*along, along[0] + math.pi, along[1] + math.pi):
            assert distance(angles[:4], angle) < 1e-14
    assert 2 in seen


@pytest.mark.parametrize("angle", [0.0, 0.03, 1.0, 2.5, 4.0, 6.27])
def test_a_direction_in_which_two_meet_is_found(angle):
    rng = np.random.default_rng(7)
    g, _, (mu,) = problem(rng, 1)
    step = 1e-6
    # the equation is linear in c: one c for which it and its slope vanish there
    rows = np.array([[slip_equation(g, unit, mu, angle + turn)[0] for unit in np.eye(3)] for turn in (-step, step)])
    c = np.linalg.svd(np.array([rows.sum(axis=0), (rows[1] - rows[0]) / step]))[2][-1]
    angles = np.zeros(CANDIDATES)
    count = slip_angles(g, c, mu, angles)
    assert distance(angles[4:count], angle) < 1e-5


def solved(g, c, mu, modes, f, passes=20, tolerance=1e-10, near=False, touching=None):
    """What `active_set_solve` comes to from there: residual, passes, attempts, u; modes and forces are changed."""
    n = len(mu)
    u, cone = np.zeros(3 * n), newton_workspace(n)
    touching = np.zeros(n, dtype=np.int64) if touching is None else touching
    out = active_set_solve(cone, g, c, mu, modes, f, u, passes, tolerance, near, touching, 0)
    return *out[:3], u


@pytest.mark.parametrize("mode", [OPEN, STICK, SLIP])
@SEEDS
def test_one_contact_is_solved_from_any_start(seed, mode):
    rng = np.random.default_rng(seed)
    ended = set()
    for _ in range(25):
        g, c, _ = problem(rng, 1)
        # coupled strongly in every other one
        g = g if rng.random() < 0.5 else np.eye(3) + 0.1 * g
        mu, f = rng.choice([0.0, 0.3, 3.0], 1), rng.normal(size=3)
        modes = np.array([SLIP if mode == STICK and mu[0] == 0.0 else mode])
        residual, _, _, u = solved(g, c, mu, modes, f)
        # a contact of regular matrix has a solution
        assert residual <= 1e-10
        assert u == pytest.approx(g @ f + c, abs=1e-12 * np.abs(g).sum() * (1.0 + np.abs(f).max()))
        assert residual_of(f, u, mu[0]) <= 1e-9 * (1.0 + np.abs(f).max())
        ended.add(int(modes[0]))
        if modes[0] == OPEN:
            assert not f.any()
            assert u[2] >= 0.0
        elif modes[0] == STICK:
            assert np.abs(u).max() < 1e-10 * (1.0 + np.abs(f).max())
    assert ended == {OPEN, STICK, SLIP}


# ------------------------------------------------------------------------------------------------ several contacts


def feet_at_rest(rng, n, margin=1.0):
    """Scaled problem of n feet of one body (rank 6), and forces (3n,) that hold it at rest well inside their cones."""
    normals = rng.normal(size=(n, 3))
    jacobian = []
    for normal in normals:
        basis = np.linalg.qr(np.c_[normal, rng.normal(size=(3, 2))])[0][:, [1, 2, 0]]
        arm = rng.normal(size=3)
        jacobian.append(basis.T @ np.c_[np.eye(3), -np.cross(np.eye(3), arm)])
    jacobian = np.vstack(jacobian)
    mu = rng.uniform(0.4, 0.8, n)
    turns = rng.uniform(0.0, 2.0 * math.pi, n)
    share = 0.6 * mu * margin
    inside = np.c_[share * np.cos(turns), share * np.sin(turns), np.ones(n)] * rng.uniform(0.5, 1.5, n)[:, None]
    g = jacobian @ jacobian.T
    return g, -g @ inside.ravel(), mu, inside.ravel()


def is_held(forces, mu):
    rows = forces.reshape(-1, 3)
    return bool((np.hypot(rows[:, 0], rows[:, 1]) <= mu * rows[:, 2]).all())


@SEEDS
def test_redundant_forces_are_of_least_norm_or_the_nearest(seed):
    """Of least norm where these are in their cones, else nearest to those given, or, if asked, inside."""
    rng = np.random.default_rng(seed)
    least_held = nearest_held = moved = 0
    for k in range(12):
        g, c, mu, inside = feet_at_rest(rng, 4, margin=0.5)
        if k % 2:
            mu *= 2.5
        least = -np.linalg.pinv(g, rcond=1e-10) @ c
        given = inside * (1.0 + 0.02 * rng.normal(size=12))
        nearest = given - np.linalg.pinv(g, rcond=1e-10) @ (g @ given + c)
        modes, f = np.full(4, STICK), given.copy()
        residual, passes, attempts, u = solved(g, c, mu, modes, f)
        if is_held(least, mu):
            least_held += 1
            assert residual <= 1e-10
            assert (attempts, passes) == (0, 1) or residual > 1e-14
            assert f == pytest.approx(least, abs=1e-9)
            assert np.abs(u).max() < 1e-11
        elif is_held(nearest, mu) and residual <= 1e-10 and attempts == 1 and (modes == STICK).all():
            nearest_held += 1
            assert f == pytest.approx(nearest, abs=1e-9)
        # with a choice of forces inside: there are some, so that they are found, near to those given
        modes, f = np.full(4, STICK), given.copy()
        residual, _, _, u = solved(g, c, mu, modes, f, near=True, touching=np.full(4, 2))
        assert residual <= 1e-10
        assert (modes == STICK).all()
        assert is_held(f, mu * (1.0 + 1e-12))
        assert np.abs(u).max() < 1e-10
        if is_held(least, mu):
            assert f == pytest.approx(least, abs=1e-9)
        else:
            moved += 1
            assert np.abs(f - given).max() < 0.3
    assert least_held and moved and nearest_held


@pytest.mark.parametrize("n", [1, 2, 4])
def test_few_passes_lead_to_a_solution(n):
    """From rest everywhere and no forces; what is solved is, and what is not says so."""
    rng = np.random.default_rng(n)
    solutions = total = tries = 0
    for _ in range(60):
        g, c, mu = problem(rng, n)
        g = 0.3 * g / n + np.eye(3 * n)
        modes, f = np.full(n, STICK), np.zeros(3 * n)
        residual, passes, attempts, u = solved(g, c, mu, modes, f, passes=12)
        assert passes <= 12
        if residual > 1e-10:
            continue
        solutions += 1
        total += passes
        tries += attempts
        assert u == pytest.approx(g @ f + c, abs=1e-12)
        for i in range(n):
            rows = slice(3 * i, 3 * i + 3)
            assert residual_of(f[rows], u[rows], mu[i]) < 1e-9
            assert {OPEN: not f[rows].any(), STICK: np.abs(u[rows]).max() < 1e-9, SLIP: True}[modes[i]]
    # modes are corrected on the way, and Newton's steps converge as such do: some four passes, and few second tries
    assert solutions >= {1: 60, 2: 57, 4: 54}[n]
    assert total <= {1: 3.7, 2: 4.3, 4: 5.0}[n] * solutions
    assert tries <= 5
