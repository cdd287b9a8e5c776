"""The solver of contact problems whose friction goes with loads, alone, on problems made from their solutions."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from pincontact.friction.cone import OPEN, SLIP
from pincontact.friction.loads import Loads, LoadSolver, ScaledLoads

SEEDS = pytest.mark.parametrize("seed", range(8))


@dataclass
class Disk:
    """|F| <= factor N[normal], of the forces in these rows; where `normal` is None, |F| <= radius."""

    rows: list[int]
    factor: float = 0.0
    normal: int | None = None
    radius: float = 0.0


@dataclass
class Problem:
    """normals: rows with F >= 0, u >= 0, F u = 0; drag: normal row -> forces in all rows that go with a unit of it;
    disks: what else is unknown."""

    gram: np.ndarray
    base: np.ndarray
    normals: list[int]
    drag: dict[int, np.ndarray] = field(default_factory=dict)
    disks: list[Disk] = field(default_factory=list)

    def posed(self):
        n = self.base.size // 3
        loads = Loads(
            self.gram, self.base, np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(2 * n), np.zeros((2 * n, 3 * n)),
            np.eye(3 * n),
        )  # fmt: skip
        for row in self.normals:
            loads.normal[row // 3], loads.radius_rows[2 * (row // 3), row] = 1.0, 1.0
        for row, along in self.drag.items():
            loads.drag[:, row] += along
        for disk in self.disks:
            i = disk.rows[0] // 3
            loads.tangents[i], loads.mu[i] = len(disk.rows), disk.factor if disk.normal is not None else 1.0
            loads.radius_base[2 * i], loads.radius_rows[2 * i] = disk.radius, 0.0
            if disk.normal is not None:
                loads.radius_rows[2 * i, disk.normal] = 1.0
        return loads


def check_modes(problem, forces, pressed, slid):
    """Units whose normal forces do not press are open, of the others' discs those that slide slip."""
    modes, loads = problem.posed().modes(forces), dict(zip(problem.normals, pressed))
    for row, presses in loads.items():
        assert (modes[row // 3] != OPEN) == presses
    for disk, slides in zip(problem.disks, slid):
        if disk.normal is None or loads[disk.normal]:
            assert (modes[disk.rows[0] // 3] == SLIP) == slides


def no_guess(speed):
    return None


def made_problem(rng, coupling=0.3, redundant=False):
    """A problem and its solution (forces, velocities, which normals press, which disks slide).

    Units: two that slide, one closed with friction on a disk, one open with such a disk, ideal rolling, a resistance of
    the first one's load, dry friction.
    """
    n = 7
    size = 3 * n
    scales = np.repeat(10.0 ** rng.uniform(-1.0, 1.0, n), 3)
    factor = np.eye(size) + coupling * rng.normal(size=(size, size)) / math.sqrt(size)
    gram = scales[:, None] * (factor @ factor.T) * scales
    normals = [2, 5, 8, 11, 14]
    disks = [
        Disk([6, 7], 0.5, 8), Disk([9, 10], 0.4, 11), Disk([12, 13], math.inf, 14), Disk([15, 16], 0.3, 2),
        Disk([18], radius=2.0 / scales[18]),
    ]  # fmt: skip
    drag = {}
    for k in (0, 1):
        angle = rng.uniform(0.0, 2.0 * math.pi)
        drag[3 * k + 2] = np.zeros(size)
        drag[3 * k + 2][3 * k : 3 * k + 2] = 0.3 * np.array([math.cos(angle), math.sin(angle)])
    y, w = np.zeros(size), np.zeros(size)
    pressed = rng.random(5) < 0.7
    # that of the open disk is open; the resistance's load is there
    pressed[[0, 2, 4]], pressed[3] = True, False
    for row, presses in zip(normals, pressed):
        (y if presses else w)[row] = rng.uniform(0.5, 2.0) / (scales[row] if presses else 1.0 / scales[row])
    slid = []
    for disk in disks:
        radius = disk.radius if disk.normal is None else disk.factor * y[disk.normal] if y[disk.normal] else 0.0
        direction = rng.normal(size=len(disk.rows))
        direction /= np.linalg.norm(direction)
        slides = bool(rng.random() < 0.5 or radius == 0.0) and radius < math.inf
        slid.append(slides)
        if slides:
            y[disk.rows] = radius * direction
            w[disk.rows] = -rng.uniform(0.5, 2.0) * scales[disk.rows] * direction
        else:
            y[disk.rows] = 0.6 * min(radius, 1.0 / scales[disk.rows[0]]) * direction
    forces = y.copy()
    for row, along in drag.items():
        forces += y[row] * along
    return Problem(gram, w - gram @ forces, normals, drag, disks), forces, w, pressed, slid


def errors(problem, forces, velocities):
    """How far forces and velocities are from the laws of the problem, each in the others' units."""
    diagonal = problem.gram.diagonal().reshape(-1, 3).mean(axis=1).repeat(3)
    y, w = forces * np.sqrt(diagonal), velocities / np.sqrt(diagonal)
    out = [np.abs(problem.gram @ forces + problem.base - velocities).max() / np.abs(problem.base).max()]
    out += [abs(min(y[row], w[row])) for row in problem.normals]
    rest = np.ones(forces.size, dtype=bool)
    rest[problem.normals] = False
    for row, along in problem.drag.items():
        rest[along != 0.0] = False
        dragged = along != 0.0
        out.append(np.abs((forces - forces[row] * along)[dragged] * np.sqrt(diagonal)[dragged]).max())
    for disk in problem.disks:
        rest[disk.rows] = False
        load = 1.0 if disk.normal is None else forces[disk.normal]
        radius = (disk.radius if disk.normal is None else disk.factor * load if load else 0.0) * math.sqrt(
            diagonal[disk.rows[0]]
        )
        if math.isinf(radius):
            out.append(np.abs(w[disk.rows]).max())
            continue
        p = y[disk.rows] - w[disk.rows]
        length = np.linalg.norm(p)
        out.append(np.abs(y[disk.rows] - (p if length <= radius else p * (radius / length))).max())
    out.append(np.abs(forces[rest]).max(initial=0.0))
    return np.array(out)


@SEEDS
def test_solutions_are_kept_and_found_again_from_near_by(seed):
    """All kinds of units together; Newton's steps are exact where modes do not change."""
    rng = np.random.default_rng(seed)
    problem, forces, velocities, pressed, slid = made_problem(rng)
    # the laws as they are written out here hold for it
    assert errors(problem, forces, velocities).max() < 1e-12
    solver = LoadSolver()
    for near in (0.0, 1e-3):
        start = forces * (1.0 + near * rng.uniform(-1.0, 1.0, forces.size))
        assert solver.solve(problem.posed(), start, no_guess)
        # round-off times a condition number of up to 1e3
        assert solver.forces == pytest.approx(forces, abs=1e-9 * np.abs(forces).max())
        assert solver.velocities == pytest.approx(velocities, abs=1e-9 * np.abs(problem.base).max())
        check_modes(problem, solver.forces, pressed, slid)
        assert solver.residual <= 1e-10
        # zero, not small
        assert not solver.velocities[problem.normals][pressed].any()
    scaled = ScaledLoads(problem.posed())
    start = scaled.unknowns(forces * (1.0 + 1e-4 * rng.uniform(-1.0, 1.0, forces.size)))
    y, residual = scaled.newton(start)
    assert residual <= 1e-13
    assert scaled.forces(y) == pytest.approx(forces, abs=1e-10 * np.abs(forces).max())


@SEEDS
def test_steps_converge_as_newtons_do(seed):
    """The error is squared from step to step: the derivative is the right one for each kind of unit."""
    rng = np.random.default_rng(seed)
    problem, forces, *_ = made_problem(rng)
    scaled = ScaledLoads(problem.posed())
    start = scaled.unknowns(forces * (1.0 + 1e-3 * rng.uniform(-1.0, 1.0, forces.size)))
    y, _ = scaled.newton(start, steps=4)
    # 1e-3, 1e-5, 1e-9, round-off, where curvatures and condition numbers are of some ten
    assert scaled.forces(y) == pytest.approx(forces, abs=1e-10 * np.abs(forces).max())


@SEEDS
def test_units_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    problem, forces, _, pressed, slid = made_problem(rng)
    units = np.repeat(10.0 ** rng.uniform(-4.0, 4.0, 7), 3)
    other = replace(
        problem,
        gram=units[:, None] * problem.gram * units,
        base=1e3 * units * problem.base,
        drag={row: along * units[row] / units for row, along in problem.drag.items()},
        disks=[
            replace(disk, radius=1e3 * disk.radius / units[disk.rows[0]])
            if disk.normal is None
            else replace(disk, factor=disk.factor * units[disk.normal] / units[disk.rows[0]])
            for disk in problem.disks
        ],
    )
    solver = LoadSolver()
    assert solver.solve(other.posed(), 1e3 * forces / units * (1.0 + 1e-4), no_guess)
    assert solver.forces == pytest.approx(1e3 * forces / units, rel=1e-8, abs=1e-8 * np.abs(forces).max() / units.max())
    check_modes(other, solver.forces, pressed, slid)


@SEEDS
def test_a_solution_is_found_from_nothing(seed):
    """By the choices of what carries a load, or by the guess, whose velocities are in units of the problem."""
    rng = np.random.default_rng(seed)
    problem, forces, _, _, _ = made_problem(rng)
    solver = LoadSolver()
    nothing = np.zeros(forces.size)
    assert solver.solve(problem.posed(), nothing, no_guess)
    assert errors(problem, solver.forces, solver.velocities).max() < 1e-8
    asked = []

    def guess(speed):
        asked.append(speed)
        return None if len(asked) == 1 else forces

    # so that the first try is none
    bad = np.full(forces.size, math.nan)
    before = solver.forces
    if solver.solve(problem.posed(), bad, guess) and asked:
        largest = np.abs(problem.base).max()
        assert asked == [1e3 * largest, 1e6 * largest][: len(asked)]
    assert solver.forces is not before


def linear_problem(operator, base):
    """Normal forces alone: each contact's normal force drags the others' velocities as the operator says."""
    n = len(base)
    gram, full, drag = np.zeros((6 * n, 6 * n)), np.zeros(6 * n), {}
    # a second body for each, through whose tangential forces everything goes that is not symmetric
    gram[2 : 3 * n : 3, 2 : 3 * n : 3] = np.diag(np.ones(n))
    for i in range(n):
        drag[3 * i + 2] = np.zeros(6 * n)
        for j in range(n):
            row = 3 * n + 3 * j
            gram[row, 3 * j + 2] = gram[3 * j + 2, row] = 1.0
            gram[row, row] = 4.0
            drag[3 * i + 2][row] = operator[j, i] - float(i == j)
    full[2 : 3 * n : 3] = base
    return Problem(gram, full, [3 * i + 2 for i in range(n)], drag)


def complementary(operator, base):
    """Every N >= 0 with A N + b >= 0, N (A N + b) = 0, by the choices of loads."""
    n, found = len(base), []
    for choice in range(2**n):
        loaded = [i for i in range(n) if choice >> i & 1]
        forces = np.zeros(n)
        if loaded:
            forces[loaded] = np.linalg.solve(operator[np.ix_(loaded, loaded)], -base[loaded])
        if (forces >= 0.0).all() and (operator @ forces + base >= -1e-12).all():
            found.append(forces)
    return found


@SEEDS
def test_loads_of_what_slides_are_found_or_proved_to_be_none(seed):
    """Operators of any definiteness; a contact that its own force would not part from the other carries nothing."""
    rng = np.random.default_rng(seed)
    found = proved = 0
    for _ in range(10):
        n = int(rng.integers(1, 5))
        operator, base = np.eye(n) + 0.8 * rng.normal(size=(n, n)), rng.normal(size=n) - 0.5
        solutions = [
            forces for forces in complementary(operator, base) if not (forces[operator.diagonal() <= 0.0] > 0.0).any()
        ]
        problem = linear_problem(operator, base)
        solver = LoadSolver()
        if solver.solve(problem.posed(), np.zeros(6 * n), no_guess):
            found += 1
            forces = solver.forces[problem.normals]
            # of systems with condition numbers of up to 1e4
            assert min(np.abs(forces - other).max() for other in solutions) < 1e-9 * (1.0 + np.abs(forces).max())
            assert solver.velocities[problem.normals] == pytest.approx(operator @ forces + base, abs=1e-9)
            # zero, not small
            assert (forces[forces < 1e-9] == 0.0).all()
        else:
            assert not solutions
            assert solver.proved
            proved += 1
    assert found and proved


def test_where_disks_take_part_nothing_is_proved():
    problem = linear_problem(np.array([[-1.0]]), np.array([-1.0]))
    solver = LoadSolver()
    assert not solver.solve(problem.posed(), np.zeros(6), no_guess)
    assert solver.proved
    problem.disks.append(Disk([0], radius=1.0))
    assert not solver.solve(problem.posed(), np.zeros(6), no_guess)
    assert not solver.proved


def test_of_several_solutions_one_that_lasts_is_first():
    """Two contacts each of which could carry all, or both a part: with compliances, what is shared does not last."""
    operator, base = np.array([[1.0, 2.0], [2.0, 1.0]]), np.array([-1.0, -1.0])
    assert len(complementary(operator, base)) == 3
    # stiff springs and dampers under both contacts: an unstable equilibrium
    springs = np.block([[np.zeros((2, 2)), np.eye(2)], [-operator, -operator]])
    assert np.linalg.eigvals(springs).real.max() > 0.1
    solver = LoadSolver()
    # from a guess that leads nowhere, and from the solution that does not last
    for start in (np.zeros(6), np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1.0]) / 3.0):
        problem = linear_problem(operator, base)
        assert solver.solve(problem.posed(), start, no_guess)
        assert sorted(solver.forces[problem.normals]) == pytest.approx([0.0, 1.0], abs=1e-12)


def test_redundant_loads_are_the_least():
    """Two contacts that do the same carry as much."""
    operator, base = np.ones((2, 2)), np.array([-1.0, -1.0])
    solver = LoadSolver()
    problem = linear_problem(operator, base)
    assert solver.solve(problem.posed(), np.zeros(12), no_guess)
    assert solver.forces[problem.normals] == pytest.approx([0.5, 0.5], rel=1e-12)


def wheels(rng):
    """Four wheels of a chassis, of which one slides and three have disks: more friction than six coordinates feel."""
    places = np.array([[1, 0.5, -0.5], [1, -0.5, -0.5], [-1, 0.5, -0.5], [-1, -0.5, -0.5]])
    rows = np.zeros((12, 6))
    for i, (x, y, z) in enumerate(places + 0.1 * rng.standard_normal((4, 3))):
        rows[3 * i : 3 * i + 3, :3] = np.eye(3)
        rows[3 * i : 3 * i + 3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    weak = 10.0 ** rng.uniform(-9.0, -6.0)
    own = rng.standard_normal((12, 12))
    gram = rows @ np.diag([1.0, 1.0, 1.0, *rng.uniform(1.0, 8.0, 3)]) @ rows.T + weak * own @ own.T
    gram += np.diag(np.tile([0.0, 0.0, 0.2], 4))
    base = rows @ np.r_[rng.uniform(-0.1, 0.1, 2), -1.0, rng.uniform(-0.3, 0.3, 3)]
    base += 0.01 * math.sqrt(weak) * rng.standard_normal(12)
    angle, drag = rng.uniform(0.0, 2.0 * math.pi), np.zeros(12)
    drag[6:8] = -0.7 * np.array([math.cos(angle), math.sin(angle)])
    disks = [Disk([3 * i, 3 * i + 1], 0.7, 3 * i + 2) for i in (0, 1, 3)]
    return Problem(gram, base, [2, 5, 8, 11], {8: drag}, disks), rng.standard_normal(12)


def test_wheels_that_nearly_share_their_friction():
    """Full steps alone go to and fro in one of six of these. A few are beyond sweeps, too."""
    solved = 0
    for seed in range(30):
        problem, start = wheels(np.random.default_rng(seed))
        solver = LoadSolver()
        if not solver.solve(problem.posed(), start, no_guess):
            assert not solver.proved
            continue
        solved += 1
        forces, velocities = solver.forces, solver.velocities
        normals = problem.normals
        # 1e-10 relative to the largest acceleration, with forces of up to a hundred times the weight
        assert (forces[normals] >= -1e-8).all() and (velocities[normals] >= -1e-8).all()
        assert np.abs(forces[normals] * velocities[normals]).max() < 1e-8
        for disk in problem.disks:
            assert np.linalg.norm(forces[disk.rows]) <= 0.7 * max(forces[disk.normal], 0.0) + 1e-8
    assert solved >= 28


def bilateral_problem(rng):
    """Random discs whose radii go with all forces, one of whose solutions, in which some stick, is known; and that."""
    n = int(rng.integers(1, 4))
    motions = rng.normal(size=(3 * n, int(rng.integers(1, 2 * n + 1))))
    motions[2::3] = 0.0
    gram = motions @ motions.T
    gram[range(2, 3 * n, 3), range(2, 3 * n, 3)] = 1.0
    mu, two_normals, sticks = rng.uniform(0.1, 2.0, n), rng.random(n) < 0.3, rng.random(n) < 0.3
    rows = rng.normal(size=(n, 2, 3 * n))
    rows[:, :, 2::3], rows[~two_normals, 1] = 0.0, 0.0
    held = motions.reshape(n, 3, -1)[sticks, :2].reshape(-1, motions.shape[1])
    v = rng.normal(size=motions.shape[1])
    slip = (motions @ (v - np.linalg.pinv(held) @ held @ v)).reshape(n, 3)
    forces, loads = np.zeros((n, 3)), rng.uniform(0.1, 1.0, n)
    for i, speed in enumerate(np.linalg.norm(slip, axis=1)):
        angle = rng.uniform(0.0, 2.0 * math.pi)
        along = np.array([math.cos(angle), math.sin(angle)]) * rng.uniform(0.0, 0.95)
        forces[i, :2] = mu[i] * loads[i] * (along if speed < 1e-9 else -slip[i, :2] / speed)
    angles = np.where(two_normals, rng.uniform(0.0, 2.0 * math.pi, n), math.pi * rng.integers(0, 2, n))
    radius_base = loads[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]) - rows @ forces.ravel()
    base = slip.ravel() - gram @ forces.ravel()
    parts = np.zeros(n), np.full(n, 2.0), mu, radius_base.ravel(), rows.reshape(2 * n, 3 * n)
    return Loads(gram, base, *parts), forces.ravel()


@pytest.mark.parametrize("first", range(0, 1200, 200))
def test_friction_and_loads_that_feed_on_each_other(first):
    """A solution is found from nothing, wherever there is one; not always the known one, as there may be several."""
    for seed in range(first, first + 100):
        problem, known = bilateral_problem(np.random.default_rng(seed))
        scaled = ScaledLoads(problem)
        assert scaled.residual(scaled.unknowns(known)) < 1e-10
        forces, residual = problem.solve(np.zeros(known.size))
        assert residual < 1e-10, seed
        slip, radii = (problem.gram @ forces + problem.base).reshape(-1, 3)[:, :2], problem.radii(forces)
        friction = forces.reshape(-1, 3)[:, :2]
        # friction within its disc, and against slip on its rim
        assert (np.linalg.norm(friction, axis=1) <= radii * (1.0 + 1e-8) + 1e-10).all()
        power = np.einsum("ij,ij->i", friction, slip)
        off = np.abs(power + radii * np.linalg.norm(slip, axis=1))
        assert (off <= 1e-8 * (1.0 + radii) * (1.0 + np.linalg.norm(slip, axis=1))).all()
