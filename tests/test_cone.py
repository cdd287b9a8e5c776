"""The contact problem: closed forms, random problems against an independent check, degenerate and impossible ones."""

import itertools
import math
import runpy
from pathlib import Path

import numpy as np
import pytest
from calling import from_python
from shared import rotation

from pincontact import linalg
from pincontact.errors import ArgumentError, InfeasibleError, SolverError
from pincontact.friction import newton, redundant, solve
from pincontact.friction.centred import centred_forces
from pincontact.friction.cone import CONE, RANK_TOLERANCE, cone_workspace
from pincontact.friction.homotopy import follow_homotopy
from pincontact.friction.solve import OPEN, SLIP, STICK, ContactSolver, solve_contacts
from pincontact.friction.starts import solve_cones

GRAVITY = 9.81

newton_step = from_python(newton.newton_step, CONE)
factor_matrix = from_python(linalg.factor_matrix)
least_norm = from_python(linalg.least_norm)
move_inside = from_python(redundant.move_inside, CONE)


def complementarity_errors(delassus, b, mu, forces):
    """Coulomb's law with De Saxce's correction at every contact, written out in NumPy; relative, without units.

    The natural map F - P_K(F - rho (u + mu |u_t| n)) with the exact projection on the second-order cone, for finite
    mu. It amplifies round-off in u by 1 + mu and in F by 1 + mu again, by which it is divided.
    """
    forces = np.asarray(forces).reshape(-1, 3)
    u = (delassus @ forces.ravel() + b).reshape(-1, 3)
    terms = (np.abs(delassus) @ np.abs(forces.ravel()) + np.abs(b)).reshape(-1, 3).max(axis=1)
    errors = np.zeros(len(mu))
    sizes = np.zeros(len(mu))
    for i, friction in enumerate(mu):
        trace = np.trace(delassus[3 * i : 3 * i + 3, 3 * i : 3 * i + 3])
        rho = 3.0 / trace if trace > 0.0 else 1.0
        corrected = u[i] + [0.0, 0.0, friction * np.hypot(u[i, 0], u[i, 1])]
        x = forces[i] - rho * corrected
        length = np.hypot(x[0], x[1])
        if length <= friction * x[2]:
            projected = x
        elif friction * length <= -x[2]:
            projected = np.zeros(3)
        else:
            normal = (x[2] + friction * length) / (1.0 + friction**2)
            projected = np.array([*(friction * normal / length * x[:2] if length else (0.0, 0.0)), normal])
        # In units of sqrt(energy), so that the sizes of different contacts can be compared.
        errors[i] = np.linalg.norm(forces[i] - projected) / math.sqrt(rho) / (1.0 + friction) ** 2
        sizes[i] = np.linalg.norm(forces[i]) / math.sqrt(rho) + math.sqrt(rho) * terms[i]
    return errors / np.maximum(sizes, 1e-5 * sizes.max())


def check(delassus, b, mu, solution, accuracy=1e-10):
    """The solution obeys Coulomb's law to `accuracy`, the tolerance it was accepted at, and says so consistently."""
    assert complementarity_errors(delassus, b, np.asarray(mu), solution.forces).max() <= accuracy
    assert solution.residual <= accuracy
    np.testing.assert_allclose(
        solution.velocities.ravel(),
        delassus @ solution.forces.ravel() + b,
        # Two orders of summation of the same terms, amplified by the scaling: a few hundred units of round-off.
        atol=1e-13 * (np.abs(delassus) @ np.abs(solution.forces.ravel()) + np.abs(b)).max(),
    )


def skew(r):
    return np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])


def feet(rng, contacts):
    """Feet of one rigid body, of any mass and size, on a plane or on slopes: singular for three and more."""
    mass, size = 10.0 ** rng.uniform(-3, 3), 10.0 ** rng.uniform(-1, 1)
    inertia = mass * size**2 * rng.uniform(0.05, 1.0, 3)
    plane = rng.random() < 0.5
    jacobian = np.zeros((3 * contacts, 6))
    for i in range(contacts):
        r = size * rng.uniform(-1, 1, 3)
        basis = np.eye(3)
        if plane:
            r[2] = -0.5 * size
        else:
            basis = rotation(rng)
            if basis[2] @ r > 0.0:
                basis[[0, 2]] *= -1.0
        jacobian[3 * i : 3 * i + 3] = basis @ np.c_[np.eye(3), -skew(r)]
    delassus = (jacobian / np.r_[np.full(3, mass), inertia]) @ jacobian.T
    twist = np.r_[rng.normal(size=3) - [0, 0, 2.0], rng.normal(size=3) / size]
    return 0.5 * (delassus + delassus.T), jacobian @ twist


def chain(rng, contacts):
    """Bodies that touch each other and the ground, with masses up to a factor of 1e6 apart."""
    bodies = rng.integers(1, contacts + 2)
    ratio = rng.choice([1.0, 1e2, 1e4, 1e6])
    mass = np.repeat(ratio ** rng.uniform(-0.5, 0.5, bodies), 6) * np.tile([1, 1, 1, 0.2, 0.3, 0.4], bodies)
    jacobian = np.zeros((3 * contacts, 6 * bodies))
    for i in range(contacts):
        first, second = rng.integers(bodies), rng.integers(-1, bodies)
        basis = rotation(rng)
        block = basis @ np.c_[np.eye(3), -skew(rng.uniform(-1, 1, 3))]
        jacobian[3 * i : 3 * i + 3, 6 * first : 6 * first + 6] = block
        if second not in (-1, first):
            block = basis @ np.c_[np.eye(3), -skew(rng.uniform(-1, 1, 3))]
            jacobian[3 * i : 3 * i + 3, 6 * second : 6 * second + 6] = -block
    delassus = (jacobian / mass) @ jacobian.T
    return 0.5 * (delassus + delassus.T), jacobian @ rng.normal(size=6 * bodies)


def dense(rng, contacts):
    """No structure at all: strong coupling between tangential and normal directions, any rank."""
    factor = rng.normal(size=(3 * contacts, rng.integers(contacts, 3 * contacts + 4)))
    delassus = factor @ factor.T
    return 0.5 * (delassus + delassus.T), factor @ rng.normal(size=factor.shape[1])


def random_friction(rng, contacts):
    kind = rng.integers(4)
    if kind == 0:
        return np.full(contacts, rng.uniform(0.0, 1.0))
    if kind == 1:
        return 10.0 ** rng.uniform(-2, 1, contacts)
    if kind == 2:
        return rng.uniform(0.0, 10.0, contacts)
    return rng.choice([0.0, 0.3, 1.0], contacts)


def cold_problem(rng, problem, contacts):
    delassus, b = problem(rng, contacts)
    return delassus, b, random_friction(rng, contacts)


# ---------------------------------------------------------------------------------------------- closed forms


def incline(angle, mass=2.0):
    """A particle at rest on a slope: downhill is t1."""
    return np.eye(3) / mass, GRAVITY * np.array([math.sin(angle), 0.0, -math.cos(angle)])


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.29])
def test_block_below_the_friction_angle_sticks(angle):
    delassus, b = incline(angle)
    solution = solve_contacts(delassus, b, 0.3)
    assert solution.modes.tolist() == [STICK]
    weight = 2.0 * GRAVITY
    expected = [[-weight * math.sin(angle), 0.0, weight * math.cos(angle)]]
    np.testing.assert_allclose(solution.forces, expected, atol=1e-14 * weight)
    # Zero, not small: a stuck contact does not creep.
    np.testing.assert_allclose(solution.velocities, 0.0, atol=1e-14 * GRAVITY)
    assert solution.qp_count == 0


@pytest.mark.parametrize("angle", [0.30, 0.8, 1.5])
def test_block_above_the_friction_angle_slides(angle):
    mu = 0.3
    delassus, b = incline(angle)
    solution = solve_contacts(delassus, b, mu)
    assert solution.modes.tolist() == [SLIP]
    normal = 2.0 * GRAVITY * math.cos(angle)
    np.testing.assert_allclose(solution.forces, [[-mu * normal, 0.0, normal]], atol=1e-13 * GRAVITY)
    expected = GRAVITY * (math.sin(angle) - mu * math.cos(angle))
    np.testing.assert_allclose(solution.velocities, [[expected, 0.0, 0.0]], atol=1e-13 * GRAVITY)
    np.testing.assert_allclose(solution.dissipation, mu * normal * expected, rtol=1e-12)
    check(delassus, b, [mu], solution)


def test_block_exactly_at_the_friction_angle_holds():
    mu = 0.3
    delassus, b = incline(math.atan(mu))
    solution = solve_contacts(delassus, b, mu)
    # Stick and slip agree here; either is right, and the acceleration is zero in both.
    assert solution.modes[0] in (STICK, SLIP)
    np.testing.assert_allclose(solution.velocities, 0.0, atol=1e-13 * GRAVITY)
    np.testing.assert_allclose(solution.cone_excess, 0.0, atol=1e-13 * GRAVITY)
    check(delassus, b, [mu], solution)


def test_a_block_thrown_upwards_separates():
    solution = solve_contacts(np.eye(3), [1.0, 2.0, 3.0], 0.5)
    assert solution.modes.tolist() == [OPEN]
    assert not solution.forces.any()
    np.testing.assert_array_equal(solution.velocities, [[1.0, 2.0, 3.0]])


@pytest.mark.parametrize("seed", range(20))
def test_slip_made_by_hand_in_an_anisotropic_matrix(seed):
    """b is computed from a chosen force and slip; the slip is then not along b_t."""
    rng = np.random.default_rng(seed)
    factor = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
    delassus = factor @ factor.T
    mu, normal, speed = rng.uniform(0.05, 0.3), rng.uniform(0.1, 10.0), rng.uniform(0.01, 5.0)
    angle = rng.uniform(0.0, 2.0 * math.pi)
    d = np.array([math.cos(angle), math.sin(angle)])
    force = np.array([*(-mu * normal * d), normal])
    b = np.array([*(speed * d), 0.0]) - delassus @ force
    assert abs(d[0] * b[1] - d[1] * b[0]) > 1e-3 * np.linalg.norm(b)
    solution = solve_contacts(delassus, b, mu)
    assert solution.modes.tolist() == [SLIP]
    # Small mu and moderate coupling: there is one solution only, found to round-off times the condition of G.
    np.testing.assert_allclose(solution.forces[0], force, atol=1e-12 * (normal + speed))
    np.testing.assert_allclose(solution.velocities[0, :2], speed * d, atol=1e-12 * (normal + speed))


def test_four_feet_share_the_weight_equally():
    """A square table at rest: least norm is the symmetric choice among the redundant forces."""
    mass, half = 3.0, 0.4
    corners = [(half, half), (-half, half), (-half, -half), (half, -half)]
    jacobian = np.vstack([np.c_[np.eye(3), -skew(np.array([x, y, -0.5]))] for x, y in corners])
    delassus = (jacobian / np.array([mass] * 3 + [0.2, 0.2, 0.3])) @ jacobian.T
    b = jacobian @ np.array([0.0, 0.0, -GRAVITY, 0.0, 0.0, 0.0])
    solution = solve_contacts(delassus, b, 0.5)
    assert solution.modes.tolist() == [STICK] * 4
    np.testing.assert_allclose(solution.forces, [[0.0, 0.0, mass * GRAVITY / 4]] * 4, atol=1e-12 * mass * GRAVITY)
    np.testing.assert_allclose(solution.velocities, 0.0, atol=1e-12 * GRAVITY)


def test_a_contact_that_moves_along_its_normal_only_up_to_a_ratio():
    """Rank one: j j^T with one degree of freedom; the force is any on a plane, and must be one in the cone."""
    j = np.array([0.9, -0.5, 0.2])
    delassus = np.outer(j, j)
    b = -3.0 * j
    solution = solve_contacts(delassus, b, 0.4)
    np.testing.assert_allclose(solution.velocities, 0.0, atol=1e-13)
    assert solution.cone_excess[0] <= 1e-12
    check(delassus, b, [0.4], solution)


# ------------------------------------------------------------------------------------------------- friction


def enumerate_frictionless(normal_matrix, normal_b):
    """The linear complementarity problem by trying every set of closed contacts (positive definite matrix)."""
    n = len(normal_b)
    for closed in itertools.chain.from_iterable(itertools.combinations(range(n), k) for k in range(n + 1)):
        index = list(closed)
        force = np.zeros(n)
        force[index] = np.linalg.solve(normal_matrix[np.ix_(index, index)], -normal_b[index])
        if (force >= 0.0).all() and (normal_matrix @ force + normal_b >= -1e-12).all():
            return force
    raise AssertionError("a positive definite problem has a solution")


@pytest.mark.parametrize("seed", range(10))
def test_frictionless_contacts_solve_the_linear_complementarity_problem(seed):
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(12, 20))
    delassus, b = factor @ factor.T, rng.normal(size=12)
    solution = solve_contacts(delassus, b, 0.0)
    expected = enumerate_frictionless(delassus[2::3, 2::3], b[2::3])
    # Round-off times the condition number of a 4 x 4 block of a random Gram matrix, below 1e3.
    np.testing.assert_allclose(solution.forces[:, 2], expected, atol=1e-12 * max(1.0, expected.max()))
    assert not solution.forces[:, :2].any()
    check(delassus, b, np.zeros(4), solution)


@pytest.mark.parametrize("seed", range(10))
def test_infinite_friction_holds_what_presses_and_lets_go_of_what_does_not(seed):
    rng = np.random.default_rng(seed)
    factor = np.eye(9) + 0.1 * rng.normal(size=(9, 9))
    delassus = factor @ factor.T
    b = rng.normal(size=9)
    solution = solve_contacts(delassus, b, math.inf)
    for mode, force, velocity in zip(solution.modes, solution.forces, solution.velocities):
        if mode == STICK:
            assert force[2] > 0.0
            np.testing.assert_allclose(velocity, 0.0, atol=1e-13)
        elif mode == OPEN:
            assert not force.any()
            assert velocity[2] >= 0.0
        else:
            # The limit of slipping under an ever smaller normal force.
            assert force[2] == 0.0
            np.testing.assert_allclose(velocity[2], 0.0, atol=1e-13)
            expected = -np.linalg.norm(force[:2]) * velocity[:2] / np.linalg.norm(velocity[:2])
            np.testing.assert_allclose(force[:2], expected, atol=1e-13)


def test_infinite_friction_is_the_limit_of_large_friction():
    """Here the tangential force that stops the slip also lifts the contact: it slips on at F_n = 0."""
    delassus = np.array([[1.0, 0.0, 0.8], [0.0, 1.0, 0.0], [0.8, 0.0, 1.0]])
    b = np.array([-1.0, 0.0, -0.5])
    limit = solve_contacts(delassus, b, math.inf)
    # By hand: F_n = 0, u_n = 0.8 F_1 - 0.5 = 0, so F_1 = 5/8 and u_1 = 5/8 - 1 < 0 opposes it.
    np.testing.assert_allclose(limit.forces, [[0.625, 0.0, 0.0]], atol=1e-14)
    np.testing.assert_allclose(limit.velocities, [[-0.375, 0.0, 0.0]], atol=1e-14)
    for mu in (1e3, 1e6, 1e9):
        large = solve_contacts(delassus, b, mu)
        # F_n = |F_t| / mu, which moves everything else by as much.
        np.testing.assert_allclose(large.forces, limit.forces, atol=2.0 / mu + 1e-14)
        assert large.modes.tolist() == [SLIP]


def test_frictional_and_ideal_contacts_mix():
    rng = np.random.default_rng(3)
    factor = np.eye(9) + 0.1 * rng.normal(size=(9, 9))
    delassus = factor @ factor.T
    b = np.tile([2.0, -1.0, -1.0], 3)
    solution = solve_contacts(delassus, b, [0.0, 0.4, math.inf])
    assert solution.modes.tolist() == [SLIP, SLIP, STICK]
    assert not solution.forces[0, :2].any()
    np.testing.assert_allclose(np.hypot(*solution.forces[1, :2]), 0.4 * solution.forces[1, 2], rtol=1e-13)
    np.testing.assert_allclose(solution.velocities[2], 0.0, atol=1e-14)


# -------------------------------------------------------------------------------------------- random problems


@pytest.mark.parametrize("contacts", [1, 2, 3, 4, 6, 8])
@pytest.mark.parametrize("problem", [feet, chain, dense], ids=lambda f: f.__name__)
def test_random_problems_are_solved(problem, contacts):
    rng = np.random.default_rng(100 + contacts)
    for _ in range(25):
        delassus, b, mu = cold_problem(rng, problem, contacts)
        check(delassus, b, mu, solve_contacts(delassus, b, mu))


@pytest.mark.parametrize("problem", [feet, chain, dense], ids=lambda f: f.__name__)
def test_every_number_of_contacts_up_to_sixteen_is_solved(problem):
    rng = np.random.default_rng(16)
    for contacts in [*range(1, 17)] * 3:
        delassus, b, mu = cold_problem(rng, problem, contacts)
        check(delassus, b, mu, solve_contacts(delassus, b, mu))


def numbered_problem(seed, k):
    """Problem k of a long batch: any structure, any number of contacts."""
    rng = np.random.default_rng([seed, k])
    contacts = int(rng.choice([1, 2, 3, 4, 6, 8, 12, 16]))
    return cold_problem(rng, [feet, chain, dense][k % 3], contacts)


@pytest.mark.parametrize(
    ("seed", "k"),
    [(0, 910), (0, 1015), (0, 1222), (0, 1309), (0, 1930), (0, 2393), (0, 2635), (1, 6256), (1, 11374), (7, 3444)],
)
def test_problems_that_no_quick_guess_solves(seed, k):
    """Found among a hundred thousand: mass ratios of 1e6 with mu near 10, forces that turn back along the path."""
    delassus, b, mu = numbered_problem(seed, k)
    solution = solve_contacts(delassus, b, mu)
    check(delassus, b, mu, solution)
    assert solution.decided_by in ("path", "sweeps")


@pytest.mark.parametrize("contacts", [24, 32, 64])
def test_many_contacts_are_solved(contacts):
    rng = np.random.default_rng(contacts)
    delassus, b, mu = cold_problem(rng, feet, contacts)
    check(delassus, b, mu, solve_contacts(delassus, b, mu))


def alone(stage):
    """A solver that has nothing but this stage."""
    return ContactSolver(stages=("qp",), contact_solver="proxqp") if stage == "qp" else ContactSolver(stages=(stage,))


@pytest.mark.parametrize("contacts", [2, 4, 8])
@pytest.mark.parametrize("stage", ["sweeps", "path", "qp"])
def test_every_way_to_the_modes_gives_the_same_solution(stage, contacts):
    """Small mu and a well-conditioned matrix: the solution is unique, and each stage alone finds it."""
    rng = np.random.default_rng(7)
    for _ in range(10):
        factor = np.eye(3 * contacts) + 0.1 * rng.normal(size=(3 * contacts, 3 * contacts))
        delassus, b = factor @ factor.T, rng.normal(size=3 * contacts)
        mu = rng.uniform(0.0, 0.5, contacts)
        solver = alone(stage)
        assert solver.solve(delassus, b, mu)
        assert solver.decided_by == stage
        expected = solve_contacts(delassus, b, mu)
        np.testing.assert_allclose(solver.forces, expected.forces.ravel(), atol=1e-12)


@pytest.mark.parametrize("contacts", [1, 2, 5])
def test_units_do_not_matter(contacts):
    rng = np.random.default_rng(5)
    for _ in range(10):
        delassus, b, mu = cold_problem(rng, feet, contacts)
        reference = solve_contacts(delassus, b, mu)
        # Powers of two: not one bit of the scaled problem may change.
        for mass, speed in ((2.0**40, 1.0), (1.0, 2.0**-60), (2.0**-30, 2.0**50)):
            scaled = solve_contacts(delassus / mass, b * speed, mu)
            assert (scaled.modes == reference.modes).all()
            np.testing.assert_allclose(scaled.velocities, reference.velocities * speed, rtol=0, atol=1e-9 * speed)
            check(delassus / mass, b * speed, mu, scaled)


def test_turning_the_tangent_basis_turns_the_forces():
    rng = np.random.default_rng(8)
    turns = []
    for angle in rng.uniform(0.0, 2.0 * math.pi, 3):
        c, s = math.cos(angle), math.sin(angle)
        turns.append(np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))
    turn = np.zeros((9, 9))
    for i, block in enumerate(turns):
        turn[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    factor = np.eye(9) + 0.1 * rng.normal(size=(9, 9))
    delassus, b, mu = factor @ factor.T, rng.normal(size=9) - np.tile([0, 0, 1.0], 3), np.full(3, 0.3)
    straight = solve_contacts(delassus, b, mu)
    turned_matrix = turn @ delassus @ turn.T
    turned = solve_contacts(0.5 * (turned_matrix + turned_matrix.T), turn @ b, mu)
    assert (turned.modes == straight.modes).all()
    np.testing.assert_allclose(turned.forces.ravel(), turn @ straight.forces.ravel(), atol=1e-12)


# ------------------------------------------------------------------------------------------------ reproducibility


def misaligned(array):
    """A copy that starts 8 bytes off the alignment of a new array."""
    room = np.empty(array.size + 1)
    view = room[1:].reshape(array.shape)
    view[...] = array
    return view


@pytest.mark.parametrize("stage", ["sweeps", "path", "qp", None])
def test_the_same_problem_gives_the_same_bits(stage):
    rng = np.random.default_rng(12)
    solved = 0
    for problem in (feet, chain, dense) * 4:
        delassus, b, mu = cold_problem(rng, problem, 4)
        results = []
        for copy in (np.copy, misaligned, np.copy, misaligned):
            solver = alone(stage) if stage else ContactSolver()
            if solver.solve(copy(delassus), copy(b), copy(mu)):
                results.append((solver.forces.tobytes(), solver.velocities.tobytes(), solver.modes.tobytes()))
        assert len(results) in (0, 4)
        assert len(set(results)) <= 1
        solved += bool(results)
    # Gauss-Seidel and ProxQP alone do not find all modes.
    assert solved >= {"qp": 4, "sweeps": 9}.get(stage, 10)


# ---------------------------------------------------------------------------------------------- warm starting


@pytest.mark.parametrize("contacts", [1, 4, 16])
def test_a_warm_start_decides_in_one_polish(contacts):
    rng = np.random.default_rng(contacts)
    factor = np.eye(3 * contacts) + 0.1 * rng.normal(size=(3 * contacts, 3 * contacts)) / math.sqrt(contacts)
    delassus, b, mu = factor @ factor.T, np.tile([1.0, -0.5, -1.0], contacts), rng.uniform(0.1, 0.5, contacts)
    solver = ContactSolver()
    assert solver.solve(delassus, b, mu)
    before = dict(solver.decided), solver.qp_count
    for k in range(50):
        nearby = b + 1e-3 * math.sin(k) * np.cos(np.arange(3 * contacts))
        assert solver.solve(delassus, nearby, mu)
        assert solver.decided_by == "warm"
        assert complementarity_errors(delassus, nearby, mu, solver.forces).max() <= 1e-13
    assert solver.decided["warm"] == before[0]["warm"] + 50
    assert solver.qp_count == before[1]
    # Already solved: one Newton pass, no mode to change.
    assert solver.solve(delassus, nearby, mu)
    assert solver.iterations <= 2


def test_a_solution_can_be_the_warm_start_of_the_next():
    rng = np.random.default_rng(2)
    delassus, b, mu = cold_problem(rng, dense, 4)
    first = solve_contacts(delassus, b, mu)
    again = solve_contacts(delassus, b, mu, warm=first)
    assert again.decided_by == "warm"
    assert (again.modes == first.modes).all()


def test_warm_starts_change_modes_on_the_way():
    """From stick to slip to flight and back: Newton corrects the modes itself, without a QP."""
    solver = ContactSolver()
    mu = np.array([0.3])
    seen = []
    for angle in (0.1, 0.5, 2.0, 0.5, 0.1):
        delassus, b = incline(angle)
        assert solver.solve(delassus, b, mu)
        seen.append(int(solver.modes[0]))
    assert seen == [STICK, SLIP, OPEN, SLIP, STICK]
    assert solver.qp_count == 0


def test_a_warm_start_can_be_put_back():
    rng = np.random.default_rng(4)
    delassus, b, mu = cold_problem(rng, dense, 3)
    solver = ContactSolver()
    assert solver.solve(delassus, b, mu)
    modes, forces, velocities = solver.modes.copy(), solver.forces.copy(), solver.velocities.copy()
    assert solver.solve(delassus, -b, mu)
    solver.warm_start(modes, forces, velocities)
    assert solver.solve(delassus, b, mu)
    assert solver.decided_by == "warm"
    np.testing.assert_allclose(solver.forces, forces, atol=1e-12 * np.abs(forces).max())
    solver.forget()
    assert solver.solve(delassus, b, mu)
    assert solver.decided_by != "warm"


@pytest.mark.parametrize("contacts", [4, 8, 16])
def test_modes_of_redundant_contacts_hold_when_loads_change(contacts):
    """Other forces act on a body on many feet: its last modes and forces decide, though a search leaves forces on the
    edges of cones, and nothing else in the solution is worse for it."""
    rng = np.random.default_rng([contacts, 7])
    solver = ContactSolver()
    warm = count = 0
    while count < 60:
        delassus, b = feet(rng, contacts)
        mu = np.full(contacts, rng.uniform(0.1, 1.0))
        push = delassus @ rng.normal(size=3 * contacts)
        solver.forget()
        if not solver.solve(delassus, b, mu):
            continue
        count += 1
        changed = b + 1e-3 * np.abs(b).max() / np.abs(push).max() * push
        assert solver.solve(delassus, changed, mu)
        warm += solver.decided_by == "warm"
        check(delassus, changed, mu, solver.solution(mu))
        # round-off of a sum of 3n terms
        assert solver.decided_by != "warm" or solver.residual <= 1e-13
    # of these problems the edge of what can stick is near in one or two
    assert warm >= 0.96 * count


@pytest.mark.parametrize("contacts", [1, 2, 6, 12])
def test_kernels_solve_as_python_does(contacts):
    """One call of the compiled solver, and what is left to Python where it gives up, is `solve` to the bit."""
    rng = np.random.default_rng(contacts)
    whole, parts = ContactSolver(), ContactSolver()
    left = 0
    for problem in (feet, chain, dense) * 6:
        delassus, b, mu = cold_problem(rng, problem, contacts)
        for load in (b, 1.001 * b, -b):
            assert whole.solve(delassus, load, mu)
            residual = solve_cones(delassus, load, mu, parts.address(contacts), parts.task, parts.tolerance)
            if residual > parts.tolerance:
                left += 1
                assert parts.search(delassus, load, mu)
            for name in ("modes", "forces", "velocities"):
                np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    assert parts.decided == whole.decided
    assert sum(whole.decided.values()) == 54
    assert left == whole.decided["path"] + whole.decided["qp"]


def test_redundant_forces_follow_the_loads():
    """A load that moves to and fro over a table: forces stay in the cones, each step's near the last one's, and are
    decided without a search."""
    rng = np.random.default_rng(3)
    corners = np.c_[rng.uniform(-1.0, 1.0, (10, 2)), -np.ones(10)]
    jacobian = np.vstack([np.c_[np.eye(3), -skew(r)] for r in corners])
    delassus, mu = jacobian @ jacobian.T, np.full(10, 0.4)
    solver = ContactSolver()
    last = None
    for phase in np.linspace(0.0, 4.0 * math.pi, 200):
        wrench = np.array([2.0 * math.sin(phase), 1.0, -10.0, 0.0, 3.0 * math.cos(phase), math.sin(phase)])
        b = jacobian @ wrench
        assert solver.solve(delassus, b, mu)
        solution = solver.solution(mu)
        check(delassus, b, mu, solution)
        # at rest throughout
        assert np.abs(solution.velocities).max() <= 1e-12
        if last is not None:
            assert solution.decided_by == "warm"
            # a step changes the wrench by 0.2; least norm and nearest to the last are both a choice of this size
            assert np.abs(solution.forces - last).max() <= 1.5
        last = solution.forces


def test_slow_slip_is_not_taken_for_rest():
    """Feet that slide slowly go on sliding when they are solved again: rest is tried for what had no velocity."""
    rng = np.random.default_rng(5)
    corners = np.c_[rng.uniform(-1.0, 1.0, (6, 2)), np.zeros(6)]
    jacobian = np.vstack([np.c_[np.eye(3), -skew(r)] for r in corners])
    delassus, mu = jacobian @ jacobian.T, np.full(6, 0.5)
    solver = ContactSolver()
    for excess in (1e-2, 1e-4, 1e-6):
        b = jacobian @ np.array([0.5 * (1.0 + excess) * GRAVITY, 0.0, -GRAVITY, 0.0, 0.0, 0.0])
        solver.forget()
        for _ in range(3):
            assert solver.solve(delassus, b, mu)
            speeds = solver.velocities.reshape(-1, 3)[:, 0]
            # u is what remains of terms of some 10 m/s
            np.testing.assert_allclose(speeds, 0.5 * excess * GRAVITY, rtol=0.0, atol=1e-12)
        assert solver.decided_by == "warm"


def test_one_solver_serves_different_numbers_of_contacts():
    rng = np.random.default_rng(6)
    solver = ContactSolver()
    for contacts in (2, 1, 3, 2, 1):
        delassus, b, mu = cold_problem(rng, dense, contacts)
        assert solver.solve(delassus, b, mu)
        assert solver.forces.shape == (3 * contacts,)
        assert complementarity_errors(delassus, b, mu, solver.forces).max() <= 1e-10
        assert solver.solution(mu).forces.shape == (contacts, 3)


def test_a_solution_is_a_copy():
    solver = ContactSolver()
    delassus, b = incline(0.1)
    mu = np.array([0.3])
    assert solver.solve(delassus, b, mu)
    kept = solver.solution(mu)
    before = kept.forces.copy()
    assert solver.solve(delassus, 2.0 * b, mu)
    np.testing.assert_array_equal(kept.forces, before)


# ------------------------------------------------------------------------------------------- redundant contacts


def table_on_a_slope(angle, corners):
    """A body of 3 kg, its centre 0.5 m above its feet at `corners`, at rest on a slope; downhill is t1."""
    jacobian = np.vstack([np.c_[np.eye(3), -skew(np.array([x, y, -0.5]))] for x, y in corners])
    delassus = (jacobian / np.array([3.0] * 3 + [0.2, 0.2, 0.3])) @ jacobian.T
    gravity = GRAVITY * np.array([math.sin(angle), 0.0, -math.cos(angle), 0.0, 0.0, 0.0])
    return 0.5 * (delassus + delassus.T), jacobian @ gravity


SQUARE = [(0.4, 0.4), (-0.4, 0.4), (-0.4, -0.4), (0.4, -0.4)]


@pytest.mark.parametrize("ratio", [1.001, 1.1, 2.0, 10.0])
@pytest.mark.parametrize("angle", [0.1, 0.4])
def test_a_table_near_the_friction_angle_has_forces_inside_the_cones(angle, ratio):
    mu = ratio * math.tan(angle)
    delassus, b = table_on_a_slope(angle, SQUARE)
    solution = solve_contacts(delassus, b, mu)
    centred = centred_forces(delassus, b, mu, solution)
    check(delassus, b, np.full(4, mu), centred)
    assert centred.modes.tolist() == [STICK] * 4
    np.testing.assert_allclose(centred.velocities, 0.0, atol=1e-12 * GRAVITY)
    used = np.hypot(*centred.forces[:, :2].T) / (mu * centred.forces[:, 2])
    # All together they use 1 / ratio of the friction, so none can be better than that; each keeps a third of the room.
    assert used.max() < 1.0 - 0.33 * (1.0 - 1.0 / ratio)


def test_least_norm_forces_leave_the_cones_where_centred_ones_do_not():
    angle = 0.4
    mu = 1.1 * math.tan(angle)
    delassus, b = table_on_a_slope(angle, SQUARE)
    least = -np.linalg.pinv(delassus, rcond=1e-12) @ b
    assert (np.hypot(least[::3], least[1::3]) > mu * least[2::3]).any()
    centred = centred_forces(delassus, b, mu, solve_contacts(delassus, b, mu))
    assert centred.cone_excess.max() < 0.0


def test_centred_forces_change_smoothly_and_with_the_units():
    mu = 0.5
    before = None
    for angle in np.linspace(0.2, 0.44, 25):
        delassus, b = table_on_a_slope(angle, [*SQUARE, (0.1, 0.3), (-0.3, 0.0)])
        centred = centred_forces(delassus, b, mu, solve_contacts(delassus, b, mu))
        if before is not None:
            # 0.01 rad turn the weight by 1 %; the shares of six feet follow, by no more than a few times that.
            assert np.abs(centred.forces - before).max() < 0.03 * 3.0 * GRAVITY
        before = centred.forces
        # The same numbers but for the rounding of units, since the centre is found in those of the forces.
        heavier = centred_forces(delassus / 8.0, b, mu, solve_contacts(delassus / 8.0, b, mu))
        np.testing.assert_allclose(heavier.forces, 8.0 * centred.forces, atol=1e-9 * 8.0 * 3.0 * GRAVITY)


def test_jaws_that_could_squeeze_at_will_squeeze_moderately():
    rng = np.random.default_rng(9)
    delassus, b = jaws(rng, 2, closing=0.0)
    b = -delassus @ np.array([0.3, 0.1, 1.0, -0.2, 0.2, 1.0])
    # Falling out of the jaws is a solution, too; asked for is the one that holds.
    solver = ContactSolver()
    solver.warm_start(np.array([STICK, STICK]), np.array([0.3, 0.1, 1.0, -0.2, 0.2, 1.0]), np.zeros(6))
    assert solver.solve(delassus, b, np.full(2, 0.8))
    solution = solver.solution(np.full(2, 0.8))
    assert solution.modes.tolist() == [STICK, STICK]
    centred = centred_forces(delassus, b, 0.8, solution)
    check(delassus, b, np.full(2, 0.8), centred)
    # As large as the load, not as large as the cones allow, which is without bound.
    assert np.abs(centred.forces).max() < 100.0
    assert (-centred.cone_excess / centred.forces[:, 2]).min() > 0.1


def test_where_there_is_no_choice_or_no_room_the_forces_stay():
    delassus, b = incline(0.1)
    alone = solve_contacts(delassus, b, 0.3)
    np.testing.assert_allclose(centred_forces(delassus, b, 0.3, alone).forces, alone.forces, rtol=1e-12)
    sliding = solve_contacts(*incline(0.5), 0.3)
    assert centred_forces(*incline(0.5), 0.3, sliding) is sliding
    # All feet at their limit: one choice only.
    delassus, b = table_on_a_slope(0.3, SQUARE)
    limit = solve_contacts(delassus, b, math.tan(0.3))
    check(delassus, b, np.full(4, math.tan(0.3)), centred_forces(delassus, b, math.tan(0.3), limit))


def test_what_slides_keeps_its_forces():
    """Two bodies apart, a table at rest and a block that slides."""
    table, load = table_on_a_slope(0.3, SQUARE)
    delassus, b = np.zeros((15, 15)), np.zeros(15)
    delassus[:12, :12], b[:12] = table, load
    delassus[12:, 12:], b[12:] = incline(0.8)
    solution = solve_contacts(delassus, b, 0.4)
    centred = centred_forces(delassus, b, 0.4, solution)
    assert centred.modes.tolist() == [STICK] * 4 + [SLIP]
    np.testing.assert_array_equal(centred.forces[4], solution.forces[4])
    np.testing.assert_allclose(centred.velocities, solution.velocities, atol=1e-12 * GRAVITY)
    # Of 29 N in all, used to 77 %.
    assert centred.cone_excess[:4].max() < -0.5


def test_a_solution_of_another_problem_cannot_be_centred():
    one = solve_contacts(np.eye(3), [0.0, 0.0, -1.0], 0.5)
    with pytest.raises(ArgumentError, match="1 contacts, the problem has 2"):
        centred_forces(np.eye(6), np.zeros(6), 0.5, one)


# ------------------------------------------------------------------------------------------ impossible, invalid


def test_a_contact_that_cannot_give_way_and_approaches_has_no_solution():
    with pytest.raises(InfeasibleError, match=r"contacts \[0\] of 1") as caught:
        solve_contacts(np.zeros((3, 3)), [0.0, 0.0, -1.0], 0.5)
    assert caught.value.certificate[0] > 0.0
    with pytest.raises(SolverError, match=r"residual [0-9.]+"):
        solve_contacts(np.zeros((3, 3)), [0.0, 0.0, -1.0], 0.5, quick=True)


def test_two_contacts_of_which_one_cannot_give_way():
    delassus = np.zeros((6, 6))
    delassus[:3, :3] = np.eye(3)
    with pytest.raises(InfeasibleError, match=r"contacts \[1\] of 2"):
        solve_contacts(delassus, [0.0, 0.0, -1.0, 0.0, 0.0, -1.0], 0.5)


def jaws(rng, contacts, closing):
    """A body between two jaws that face each other, and more contacts around it; the jaws close or open on it."""
    frames = [np.eye(3), np.diag([1.0, -1.0, -1.0])] + [rotation(rng) for _ in range(contacts - 2)]
    points = [np.array([0.0, 0.0, -0.1]), np.array([0.0, 0.0, 0.1]), *rng.uniform(-0.1, 0.1, (contacts - 2, 3))]
    jacobian = np.vstack([frame @ np.c_[np.eye(3), -skew(point)] for frame, point in zip(frames, points)])
    delassus = (jacobian / rng.uniform(0.1, 10.0, 6)) @ jacobian.T
    b = jacobian @ rng.normal(size=6)
    b[2] -= closing
    return 0.5 * (delassus + delassus.T), b


@pytest.mark.parametrize("contacts", [2, 3, 4, 8])
def test_closing_jaws_have_no_solution_and_it_is_proved(contacts):
    rng = np.random.default_rng(contacts)
    for _ in range(3):
        delassus, b = jaws(rng, contacts, closing=1.0)
        with pytest.raises(InfeasibleError) as caught:
            solve_contacts(delassus, b, rng.uniform(0.1, 1.0, contacts))
        pressing = np.zeros(3 * contacts)
        pressing[2::3] = caught.value.certificate
        assert pressing.min() >= 0.0
        # u . y = F . G y + b . y < 0 for every F, against u_n >= 0.
        assert b @ pressing < 0.0
        # Round-off of the least squares, times the condition number of up to eight contacts of one body.
        assert np.abs(delassus @ pressing).max() <= 1e-10 * np.abs(delassus).max() * pressing.max()
        opening = jaws(rng, contacts, closing=-1.0)
        check(*opening, np.full(contacts, 0.3), solve_contacts(*opening, 0.3))


def test_belts_that_jam_a_body_are_given_up_soon(monkeypatch):
    """Contact b jams: the wedge of force cones holds it, b drives into it, and no normal forces alone contradict."""
    delassus, b, mu = jammed_problem()
    solver, begun = ContactSolver(), paths_begun(monkeypatch)
    assert not solver.solve(delassus, b, mu)
    assert solver.jammed
    assert solver.certificate is None
    # Two paths: no long search.
    assert len(begun) == 2
    with pytest.raises(SolverError, match="larger than any bound"):
        solve_contacts(delassus, b, mu)


def jammed_problem():
    """The first of a random sequence of loads out of reach of redundant contacts that has no solution."""
    rng = np.random.default_rng(0)
    for k in range(300):
        contacts = int(rng.choice([2, 3, 4, 8, 16]))
        delassus, b, mu = cold_problem(rng, [feet, chain, dense][k % 3], contacts)
        b = b + 0.5 * np.abs(b).max() * rng.normal(size=3 * contacts)
        if k == 42:
            return delassus, b, mu
    raise AssertionError("the sequence is longer")


def paths_begun(monkeypatch):
    """The paths that are begun from now on: what they start with."""
    begun = []

    def follow(*arguments):
        if arguments[4] == 1.0:
            begun.append(arguments[5:7])
        return follow_homotopy(*arguments)

    monkeypatch.setattr(solve, "follow_homotopy", follow)
    return begun


def test_quick_searches_are_short(monkeypatch):
    delassus, b, mu = jammed_problem()
    solver, begun = ContactSolver(quick=True), paths_begun(monkeypatch)
    assert not solver.solve(delassus, b, mu)
    assert len(begun) == 1
    # What is not hard is solved all the same.
    rng = np.random.default_rng(3)
    for problem in (feet, chain, dense) * 5:
        delassus, b, mu = cold_problem(rng, problem, 4)
        check(delassus, b, mu, solve_contacts(delassus, b, mu, quick=True))


def test_a_refused_problem_leaves_the_warm_start_alone():
    solver = ContactSolver()
    good = np.eye(6)
    b, mu = np.tile([1.0, 0.0, -1.0], 2), np.full(2, 0.5)
    assert solver.solve(good, b, mu)
    kept = solver.modes.copy(), solver.forces.copy(), solver.velocities.copy()
    blocked = good.copy()
    blocked[3:, 3:] = 0.0
    assert not solver.solve(blocked, b, mu)
    assert solver.residual > 1e-3
    for array, before in zip((solver.modes, solver.forces, solver.velocities), kept):
        np.testing.assert_array_equal(array, before)


@pytest.mark.parametrize("contacts", [1, 2])
def test_numbers_that_are_not_finite_are_refused_without_harm(contacts):
    solver = ContactSolver()
    b, mu = np.tile([1.0, 0.0, -1.0], contacts), np.full(contacts, 0.5)
    assert solver.solve(np.eye(3 * contacts), b, mu)
    forces = solver.forces.copy()
    assert not solver.solve(np.eye(3 * contacts), b * math.nan, mu)
    np.testing.assert_array_equal(solver.forces, forces)


@pytest.mark.parametrize(
    ("delassus", "b", "mu", "message"),
    [
        (np.eye(4), np.zeros(4), 0.5, r"\(4, 4\)"),
        (np.zeros((3, 6)), np.zeros(3), 0.5, r"\(3, 6\)"),
        (np.eye(3), np.zeros(6), 0.5, "got 6"),
        (np.eye(6), np.zeros(6), [0.1, 0.2, 0.3], r"\(3,\)"),
        (np.eye(3), [0.0, math.nan, 0.0], 0.5, "finite"),
        (np.diag([1.0, math.inf, 1.0]), np.zeros(3), 0.5, "finite"),
        (np.eye(3), np.zeros(3), -0.1, r"-0\.1"),
        (np.eye(3), np.zeros(3), math.nan, "NaN"),
        (np.eye(3) + np.triu(np.full((3, 3), 0.1), 1), np.zeros(3), 0.5, r"differ by 0\.1"),
        (np.diag([1.0, 1.0, -2.0]), np.zeros(3), 0.5, r"-2\.0"),
    ],
)
def test_invalid_arguments_are_named(delassus, b, mu, message):
    with pytest.raises(ArgumentError, match=message):
        solve_contacts(delassus, b, mu)


def test_an_unusable_tolerance_or_warm_start_is_refused():
    with pytest.raises(ArgumentError, match="tolerance"):
        solve_contacts(np.eye(3), np.zeros(3), 0.5, tolerance=0.0)
    one = solve_contacts(np.eye(3), [0.0, 0.0, -1.0], 0.5)
    with pytest.raises(ArgumentError, match="1 contacts, the problem has 2"):
        solve_contacts(np.eye(6), np.zeros(6), 0.5, warm=one)


def test_no_contacts_and_no_load():
    assert solve_contacts(np.zeros((0, 0)), np.zeros(0), 0.5).forces.shape == (0, 3)
    rest = solve_contacts(np.eye(6), np.zeros(6), 0.5)
    assert not rest.forces.any()
    assert not rest.velocities.any()


# ------------------------------------------------------------------------------------------------ linear algebra


@pytest.mark.parametrize("rank", [1, 4, 7, 10])
def test_solutions_of_least_norm_agree_with_the_pseudo_inverse(rank):
    rng = np.random.default_rng(rank)
    n = 10
    matrix = rng.normal(size=(n, rank)) @ rng.normal(size=(rank, n))
    rhs = matrix @ rng.normal(size=n)
    x = np.zeros(n)
    memory = cone_workspace(4)
    found = least_norm(matrix.copy(), rhs.copy(), n, n, x, memory.gram, memory.order, 1e-12)
    assert found == rank
    # Round-off times the square of the condition number on the row space, below 1e4 for these.
    expected = np.linalg.pinv(matrix, rcond=1e-12) @ rhs
    np.testing.assert_allclose(x, expected, atol=1e-8 * np.abs(expected).max())


def newton_workspace(contacts):
    """What Newton works in, all zero."""
    cone = cone_workspace(contacts)
    for name in CONE.arrays:
        getattr(cone, name)[:] = 0
    return cone


def newton_errors(g, source, mu, modes, known, change, arcs, refine, length):
    """What is left of the equations of given modes, linearised, and the size of the terms in them.

    change (3n,): of the forces, in the new directions of what slips; these turned by arcs (n,).
    """
    change = change.copy()
    turned = np.zeros(len(mu))
    for i in np.flatnonzero(modes == SLIP):
        d1, d2 = known["direction"][2 * i : 2 * i + 2]
        reach = known["sine"][i] * known["length"][i]
        total = reach + known["speed"][i]
        pushed = length[i] - refine * known["length"][i]
        change[3 * i : 3 * i + 3] = pushed * np.array(
            [-known["sine"][i] * d1, -known["sine"][i] * d2, known["cosine"][i]]
        )
        change[3 * i : 3 * i + 2] -= arcs[i] * reach / total * np.array([-d2, d1])
        turned[i] = arcs[i] * known["speed"][i] / total
    u = source + g @ change
    size = 1.0 + np.abs(g).max() * np.abs(change).max() + np.abs(turned).max()
    errors = []
    for i in range(len(mu)):
        if modes[i] == STICK:
            errors += list(u[3 * i : 3 * i + 3])
        elif modes[i] == SLIP:
            errors.append(u[3 * i + 2])
            if mu[i] > 0.0:
                d1, d2 = known["direction"][2 * i : 2 * i + 2]
                errors.append(d1 * u[3 * i + 1] - d2 * u[3 * i] - turned[i])
    return np.array(errors), size


@pytest.mark.parametrize("refine", [False, True])
@pytest.mark.parametrize(("contacts", "rank"), [(4, 3), (6, 5), (8, 6), (16, 6)])
def test_a_factor_of_the_matrix_gives_a_newton_step(contacts, rank, refine):
    """With the factor, slips that turn included, the step solves Newton's equations as written out."""
    rng = np.random.default_rng([contacts, rank])
    used = 0
    for _ in range(20):
        factor = rng.normal(size=(3 * contacts, rank))
        g = factor @ factor.T
        c = g @ rng.normal(size=3 * contacts)
        mu = rng.choice([0.0, 0.2, 0.9, 3.0], contacts)
        modes = rng.choice([OPEN, STICK, STICK, SLIP], contacts)
        modes[mu == 0.0] = SLIP
        cone = newton_workspace(contacts)
        angles = rng.uniform(0.0, 2.0 * math.pi, contacts)
        cone.direction[:] = np.c_[np.cos(angles), np.sin(angles)].ravel()
        # not so slow that a slip's direction would be as good as unknown
        cone.length[:], cone.speed[:] = rng.uniform(0.0, 2.0, (2, contacts))
        cone.speed += 1e-3
        cone.sine[:], cone.cosine[:] = mu / np.hypot(1.0, mu), 1.0 / np.hypot(1.0, mu)
        f = np.zeros((contacts, 3))
        for i in range(contacts):
            push = cone.length[i] * cone.sine[i] * cone.direction[2 * i : 2 * i + 2]
            slipping = np.r_[-push, cone.length[i] * cone.cosine[i]]
            f[i] = slipping if modes[i] == SLIP else rng.normal(size=3) * (modes[i] == STICK)
        f = f.ravel()
        before, known = f.copy(), {name: getattr(cone, name).copy() for name in CONE.arrays}
        u = g @ f + c
        found = factor_matrix(g, cone.low_rank[0], cone.shift, RANK_TOLERANCE)
        # rounding of 3n terms, times a condition number below 1e3
        np.testing.assert_allclose(cone.low_rank[0, :found].T @ cone.low_rank[0, :found], g, atol=1e-11)
        newton_step(cone, g, c, mu, modes, f, u, refine, False, before, found)
        slips, sticks = modes == SLIP, modes == STICK
        counts = 3 * sticks + slips * np.where(mu > 0.0, 2, 1)
        if cone.first[-1] != 3 * sticks.sum() + slips.sum() or found * 2 > counts.sum():
            continue
        used += 1
        turned = np.where(slips & (mu > 0.0), cone.arc, 0.0)
        source = u if refine else c
        errors, scale = newton_errors(g, source, mu, modes, known, f - refine * before, turned, refine, cone.length)
        # round-off times condition numbers of up to 1e4 of a random factor and its springs
        np.testing.assert_allclose(errors, 0.0, atol=1e-10 * scale)
    assert used >= 5


@pytest.mark.parametrize("mu", [0.01, 0.3, 2.0])
def test_redundant_forces_are_moved_into_cones_however_narrow(mu):
    rng = np.random.default_rng(5)
    contacts, rank = 12, 6
    moved = 0
    for _ in range(40):
        cone = newton_workspace(contacts)
        modes = rng.choice([STICK, STICK, SLIP], contacts)
        counts = np.where(modes == STICK, 3, 1)
        first = cone.first
        first[1:] = np.cumsum(counts)
        n = first[-1]
        cone.direction[::2] = 1.0
        cone.sine[:], cone.cosine[:] = mu / math.hypot(1.0, mu), 1.0 / math.hypot(1.0, mu)
        # forces at four fifths of friction's limit are one solution, so that there are some inside
        loads = rng.uniform(0.1, 1.0, contacts)
        inside = np.zeros(n)
        for i in range(contacts):
            turn = rng.uniform(0.0, 2.0 * math.pi)
            force = loads[i] * np.array([0.8 * mu * math.cos(turn), 0.8 * mu * math.sin(turn), 1.0])
            inside[first[i] : first[i + 1]] = force if modes[i] == STICK else loads[i]
        equations = rng.normal(size=(rank, n))
        cone.system[:rank, :n] = equations
        cone.rhs[:rank] = target = equations @ inside
        arguments = [getattr(cone, name) for name in ("x", "gram", "order")]
        assert least_norm(cone.system, cone.rhs, rank, n, *arguments, 1e-12) == rank
        x = cone.x
        np.testing.assert_allclose(equations @ x[:n], target, atol=1e-12 * n)
        before = x[:n].copy()
        move_inside(cone, rank, np.full(contacts, mu), modes, rng.normal(size=3 * contacts))
        moved += (x[:n] != before).any()
        np.testing.assert_allclose(equations @ x[:n], target, atol=1e-12 * n)
        for i in range(contacts):
            force = x[first[i] : first[i + 1]]
            assert math.hypot(*force[:2]) <= mu * force[2] if modes[i] == STICK else force[0] >= 0.0
    assert moved >= 35


def test_path_through_a_singular_matrix():
    """Contacts of free bodies whose matrix is singular: the path loses itself in round-off at t = 1e-9, the last search
    does not."""
    path = Path(__file__).parents[1] / "examples" / "benchmarks" / "cone.py"
    benchmark = runpy.run_path(str(path))
    number = 10534
    rng = np.random.default_rng([0, number])
    contacts = int(rng.choice(benchmark["ROBUSTNESS_CONTACTS"]))
    delassus, b, mu = benchmark["KINDS"][number % len(benchmark["KINDS"])](rng, contacts)
    assert np.linalg.matrix_rank(delassus, 1e-10) < 3 * contacts
    solver = ContactSolver()
    assert solver.solve(delassus, b, mu)
    assert solver.residual <= 1e-10
    # with the modes the next one is quick
    assert solver.solve(delassus, b, mu)
    assert solver.decided_by == "warm"
    # what is refused leaves the solution as it is
    forces = solver.forces.copy()
    assert not solver.solve(np.zeros_like(delassus), -np.ones_like(b), mu)
    np.testing.assert_array_equal(solver.forces, forces)
