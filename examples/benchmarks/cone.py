"""Contact problems with Coulomb friction: time and residual beside ProxQP, Pinocchio's PGS and ADMM, and clarabel.

Random problems of three kinds, 1 to 64 contacts each:

    feet    points of one rigid body on a plane or on slopes: redundant, the matrix is singular from three on
    bodies  bodies that touch each other and the ground, masses up to a factor of 1e6 apart, mu from 0 to 10
    dense   no structure, any rank, mu from 0 to 10

Every solver gets the same problems in units of one, and is asked for 1e-10. Times are per problem, the least of a few
calls; ratios are medians of those to pincontact's cold solve of the same problem in the same run. The residual is that
of Coulomb's law, F = P_K(F - (u + mu |u_t| n)), computed outside of all solvers. Clarabel is given the convex problem
that is left without mu |u_t|, and its residual is that of this one.

"proxqp alone" is `contact_solver="proxqp"` without the stages that take over where its programs find nothing.

    python examples/benchmarks/cone.py [--contacts 1 2 4 ...] [--count 20] [--csv FILE]
    python examples/benchmarks/cone.py --robustness 100000      cold solves of random problems; lists what failed
    python examples/benchmarks/cone.py --robustness 10000 --proxqp      the same by ProxQP's programs alone
"""

from __future__ import annotations

import argparse
import csv
import math
import statistics
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from pincontact.friction.solve import ContactSolver

ACCURACY = 1e-10
REPEATS = 3
CONTACTS = (1, 2, 4, 8, 16, 32, 64)
ROBUSTNESS_CONTACTS = (1, 2, 3, 4, 6, 8, 12, 16)

Problem = tuple[np.ndarray, np.ndarray, np.ndarray]


# ------------------------------------------------------------------------------------------------------- problems


def rotation(rng: np.random.Generator) -> np.ndarray:
    """A random rotation matrix."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def point_rows(basis: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(3, 6) rows of a body's velocity at a point, for linear and angular velocity."""
    x, y, z = point
    return basis @ np.c_[np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]]


def problem_of(jacobian: np.ndarray, mass: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Delassus matrix and free velocity of contacts with these rows."""
    delassus = (jacobian / mass) @ jacobian.T
    return np.ascontiguousarray(0.5 * (delassus + delassus.T)), jacobian @ velocity


def feet(rng: np.random.Generator, contacts: int) -> Problem:
    """Feet of one rigid body, half of the time on a plane; mu up to 1."""
    size, plane = 10.0 ** rng.uniform(-1, 1), rng.random() < 0.5
    mass = 10.0 ** rng.uniform(-3, 3) * np.r_[np.ones(3), size**2 * rng.uniform(0.05, 1.0, 3)]
    jacobian = np.zeros((3 * contacts, 6))
    for i in range(contacts):
        point = size * rng.uniform(-1, 1, 3)
        basis = np.eye(3) if plane else rotation(rng)
        if plane:
            point[2] = -0.5 * size
        elif basis[2] @ point > 0.0:
            basis[[0, 2]] *= -1.0
        jacobian[3 * i : 3 * i + 3] = point_rows(basis, point)
    twist = np.r_[rng.normal(size=3) - [0.0, 0.0, 2.0], rng.normal(size=3) / size]
    return *problem_of(jacobian, mass, twist), np.full(contacts, rng.uniform(0.0, 1.0))


def any_friction(rng: np.random.Generator, contacts: int) -> np.ndarray:
    """Coefficients from 0 to 10: all decades, or evenly, or a few common ones with 0 among them."""
    kind = rng.integers(3)
    if kind == 0:
        return 10.0 ** rng.uniform(-2, 1, contacts)
    return rng.uniform(0.0, 10.0, contacts) if kind == 1 else rng.choice([0.0, 0.3, 1.0], contacts)


def bodies(rng: np.random.Generator, contacts: int) -> Problem:
    """Bodies that touch each other and the ground at random."""
    count = int(rng.integers(1, contacts + 2))
    scale = rng.choice([1.0, 1e2, 1e4, 1e6]) ** rng.uniform(-0.5, 0.5, count)
    mass = np.repeat(scale, 6) * np.tile([1.0, 1.0, 1.0, 0.2, 0.3, 0.4], count)
    jacobian = np.zeros((3 * contacts, 6 * count))
    for i in range(contacts):
        first, second, basis = rng.integers(count), rng.integers(-1, count), rotation(rng)
        jacobian[3 * i : 3 * i + 3, 6 * first : 6 * first + 6] = point_rows(basis, rng.uniform(-1, 1, 3))
        if second not in (-1, first):
            jacobian[3 * i : 3 * i + 3, 6 * second : 6 * second + 6] = -point_rows(basis, rng.uniform(-1, 1, 3))
    return *problem_of(jacobian, mass, rng.normal(size=6 * count)), any_friction(rng, contacts)


def dense(rng: np.random.Generator, contacts: int) -> Problem:
    """Random rows of any rank."""
    size = int(rng.integers(contacts, 3 * contacts + 4))
    jacobian = rng.normal(size=(3 * contacts, size))
    return *problem_of(jacobian, np.ones(size), rng.normal(size=size)), any_friction(rng, contacts)


KINDS = (feet, bodies, dense)


def without_units(problem: Problem) -> Problem:
    """The same problem with unit-sized diagonal blocks and b: tolerances of other solvers are absolute in part."""
    delassus, b, mu = problem
    scale = np.repeat(np.sqrt(3.0 / np.diagonal(delassus).reshape(-1, 3).sum(axis=1)), 3)
    scaled = scale * b
    return np.ascontiguousarray(scale[:, None] * delassus * scale), scaled / (np.abs(scaled).max() or 1.0), mu


def residual(problem: Problem, forces: np.ndarray, coulomb: bool = True) -> float:
    """Largest |F - P_K(F - (u + mu |u_t| n))| over the contacts, relative to the terms in it; for unit-sized blocks.

    coulomb: False leaves mu |u_t| out. It amplifies round-off by (1 + mu)^2 in u and F, by which it is divided.
    """
    delassus, b, mu = problem
    f = forces.reshape(-1, 3)
    u = (delassus @ forces + b).reshape(-1, 3)
    terms = (np.abs(delassus) @ np.abs(forces) + np.abs(b)).reshape(-1, 3).max(axis=1) + np.linalg.norm(f, axis=1)
    x = f - u
    if coulomb:
        x[:, 2] -= mu * np.hypot(u[:, 0], u[:, 1])
    length = np.hypot(x[:, 0], x[:, 1])
    normal = np.maximum((x[:, 2] + mu * length) / (1.0 + mu**2), 0.0)
    shrink = np.divide(mu * normal, length, out=np.zeros_like(length), where=length > 0.0)
    outside = length > mu * x[:, 2]
    projected = np.where(outside[:, None], np.c_[shrink[:, None] * x[:, :2], normal], x)
    errors = np.linalg.norm(f - projected, axis=1) / (1.0 + mu) ** 2
    return float((errors / np.maximum(terms, 1e-5 * terms.max())).max()) if np.isfinite(forces).all() else math.inf


# -------------------------------------------------------------------------------------------------------- solvers


def programs_alone() -> ContactSolver:
    """ProxQP's programs with no other solver behind them; Newton's method finishes and judges, as always."""
    return ContactSolver(stages=("qp",), contact_solver="proxqp")


class Pincontact:
    """pincontact's solver, cold or with the solution of a problem whose b is off by 1e-3, as if other forces acted."""

    def __init__(self, warm: bool, programs: bool = False):
        self.warm = warm
        self.name = f"{'proxqp alone' if programs else 'pincontact'}, {'warm' if warm else 'cold'}"
        self.solver = programs_alone() if programs else ContactSolver()

    def prepare(self, problem: Problem) -> Callable[[], np.ndarray]:
        delassus, b, mu = problem
        solver = self.solver
        zero = np.zeros(b.shape)
        push = delassus @ np.cos(np.arange(len(b)))
        nearby = b + 1e-3 * push / np.abs(push).max()
        start = None
        if self.warm and solver.solve(delassus, nearby, mu):
            start = solver.modes.copy(), solver.forces.copy(), solver.velocities.copy()

        def call() -> np.ndarray:
            if start is None:
                solver.forget()
            else:
                solver.warm_start(*start)
            return solver.forces if solver.solve(delassus, b, mu) else zero

        return call


class Pinocchio:
    """One of Pinocchio's solvers on a dense Delassus operator, cold."""

    def __init__(self, kind: str):
        self.name = f"Pinocchio {kind}"
        self.kind = kind
        self.model = pin.Model()

    def prepare(self, problem: Problem) -> Callable[[], np.ndarray]:
        delassus, b, mu = problem
        models, datas = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
        for coefficient in mu:
            contact = pin.PointContactConstraintModel(self.model, 0)
            contact.setFriction(float(coefficient))
            models.append(pin.ConstraintModel(contact))
            datas.append(models[-1].createData())
        settings = getattr(pin, f"{self.kind}SolverSettings")()
        for which in ("absolute", "relative"):
            for what in ("feasibility", "complementarity"):
                setattr(settings, f"{which}_{what}_tol", ACCURACY)
        solver = getattr(pin, f"{self.kind}ConstraintSolver")(len(b))
        make_result = getattr(pin, f"{self.kind}SolverResult")

        def call() -> np.ndarray:
            result = make_result()
            solver.solve(pin.DelassusOperatorDense(delassus), b, models, datas, settings, result)
            return result.retrieveConstraintImpulses()

        return call


class Clarabel:
    """clarabel on min F' G F / 2 + b' F, F in the cones: contact without De Saxce's term."""

    name = "clarabel, convex"

    def prepare(self, problem: Problem) -> Callable[[], np.ndarray]:
        import clarabel
        from scipy import sparse

        delassus, b, mu = problem
        n = len(mu)
        # s = -A F = (mu F_n, F_t) in the second-order cone
        rows = np.zeros((3 * n, 3 * n))
        for i in range(n):
            rows[3 * i, 3 * i + 2] = -mu[i]
            rows[3 * i + 1, 3 * i] = rows[3 * i + 2, 3 * i + 1] = -1.0
            if mu[i] == 0.0:
                rows[3 * i, 3 * i + 2] = -1.0
        cones: list[Any] = []
        for coefficient in mu:
            if coefficient > 0.0:
                cones.append(clarabel.SecondOrderConeT(3))
            else:
                cones += [clarabel.NonnegativeConeT(1), clarabel.ZeroConeT(2)]
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        for name in ("tol_feas", "tol_gap_abs", "tol_gap_rel"):
            setattr(settings, name, ACCURACY)
        cost, matrix = sparse.csc_matrix(np.triu(delassus)), sparse.csc_matrix(rows)

        def call() -> np.ndarray:
            solver = clarabel.DefaultSolver(cost, b, matrix, np.zeros(3 * n), cones, settings)
            return np.array(solver.solve().x)

        return call


# ------------------------------------------------------------------------------------------------------ comparison


def least_time(call: Callable[[], np.ndarray]) -> tuple[float, np.ndarray]:
    """Seconds of the fastest of a few calls, and what the last one returned."""
    best = math.inf
    forces = np.zeros(0)
    for _ in range(REPEATS):
        began = time.perf_counter()
        forces = call()
        best = min(best, time.perf_counter() - began)
    return best, forces


def compare(contacts: tuple[int, ...], count: int, seed: int) -> list[dict[str, object]]:
    """One row for each kind, number of contacts and solver; printed as they come."""
    solvers: list[Any] = [Pincontact(False), Pincontact(True), Pincontact(False, True), Pincontact(True, True)]
    solvers += [Pinocchio("PGS"), Pinocchio("ADMM")]
    try:
        import clarabel  # noqa: F401

        solvers.append(Clarabel())
    except ImportError:
        print('clarabel is not installed (pip install ".[bench]"): left out', file=sys.stderr)
    rows: list[dict[str, object]] = []
    print(
        f"{'problems':8s} {'n':>3s} {'solver':18s} {'median us':>10s} {'largest us':>10s} {'ratio':>7s} "
        f"{'median residual':>15s} {'largest':>8s} {'to 1e-10':>9s}"
    )
    for kind in KINDS:
        for n in contacts:
            rng = np.random.default_rng([seed, n, KINDS.index(kind)])
            problems = [without_units(kind(rng, n)) for _ in range(count if n <= 16 else max(count // 4, 3))]
            times: dict[str, list[float]] = defaultdict(list)
            residuals: dict[str, list[float]] = defaultdict(list)
            for problem in problems:
                for solver in solvers:
                    seconds, forces = least_time(solver.prepare(problem))
                    times[solver.name].append(1e6 * seconds)
                    residuals[solver.name].append(residual(problem, forces, not isinstance(solver, Clarabel)))
            for solver in solvers:
                own, errors = times[solver.name], residuals[solver.name]
                ratio = statistics.median(a / b for a, b in zip(own, times[solvers[0].name], strict=True))
                row: dict[str, object] = {
                    "problems": kind.__name__, "contacts": n, "solver": solver.name,
                    "median_us": statistics.median(own), "largest_us": max(own), "ratio_to_cold": ratio,
                    "median_residual": statistics.median(errors), "largest_residual": max(errors),
                    "solved": sum(e <= ACCURACY for e in errors), "of": len(errors),
                }  # fmt: skip
                rows.append(row)
                print(
                    f"{kind.__name__:8s} {n:3d} {solver.name:18s} {row['median_us']:10.1f} {row['largest_us']:10.1f} "
                    f"{ratio:7.2f} {row['median_residual']:15.1e} {row['largest_residual']:8.1e} "
                    f"{row['solved']:5d}/{row['of']}",
                    flush=True,
                )
    return rows


def free_body_dynamics() -> Callable[[], np.ndarray]:
    """pin.aba of one free body: what times are compared with, measured between them."""
    model = pin.Model()
    body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(body, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    data, q, v = model.createData(), pin.neutral(model), np.ones(6)
    return lambda: pin.aba(model, data, q, v, v)


def held_starts(contacts: tuple[int, ...], count: int, seed: int) -> None:
    """Prints the times of warm starts for feet of one body and a b that is off by 1e-3, and how many of them hold."""
    print("\nfeet, warm, of which the last solution decides (in brackets: times of pin.aba of one free body):")
    solver, reference = Pincontact(True), free_body_dynamics()
    for n in contacts:
        rng = np.random.default_rng([seed, n])
        times, held, references, residuals = [], [], [], []
        for _ in range(count):
            problem = without_units(feet(rng, n))
            call = solver.prepare(problem)
            seconds, forces = least_time(call)
            references.append(1e6 * least_time(reference)[0])
            times.append(1e6 * seconds)
            if solver.solver.decided_by == "warm":
                held.append(1e6 * seconds)
                residuals.append(residual(problem, forces))
        if held:
            middle, unit = statistics.median(held), statistics.median(references)
            print(
                f"{n:3d} contacts: {len(held)} of {count}, median {middle:.1f} us [{middle / unit:.1f}], residual "
                f"{max(residuals):.1e} at most; of all {statistics.median(times):.1f} us"
            )


def random_problems(count: int, seed: int) -> Iterator[tuple[int, str, Problem]]:
    """Number, kind and problem 0 to count - 1 of a seed, each its own."""
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        n = int(rng.choice(ROBUSTNESS_CONTACTS))
        kind = KINDS[k % len(KINDS)]
        yield k, kind.__name__, kind(rng, n)


def program_shares(count: int, seed: int) -> int:
    """Cold solves of random problems by ProxQP's programs alone; prints what they solved and at what cost.

    A problem counts as redundant if its matrix has not full rank: then forces are not unique.
    """
    solver = programs_alone()
    solved: dict[bool, list[bool]] = {False: [], True: []}
    programs, iterations, residuals, times = [], [], [], []
    for k, kind, problem in random_problems(count, seed):
        redundant = bool(np.linalg.matrix_rank(without_units(problem)[0], hermitian=True) < len(problem[1]))
        before = solver.program_counts
        solver.forget()
        began = time.perf_counter()
        solved[redundant].append(solver.solve(*problem))
        times.append(1e6 * (time.perf_counter() - began))
        if not solved[redundant][-1]:
            print(f"problem {k}: {kind}, {len(problem[2])} contacts, residual {solver.residual:.1e}", flush=True)
            continue
        after = solver.program_counts
        programs.append(after["qp"] - before["qp"])
        iterations.append(after["qp_iterations"] - before["qp_iterations"])
        residuals.append(solver.residual)
    for name, some in (
        ("all", solved[False] + solved[True]),
        ("full rank", solved[False]),
        ("redundant", solved[True]),
    ):
        share = 100.0 * sum(some) / max(len(some), 1)
        print(f"{name}: {sum(some)} of {len(some)} solved by programs alone, {share:.3f} %")
    print(
        f"of those solved: {statistics.mean(programs):.2f} programs and {statistics.mean(iterations):.1f} iterations "
        f"on average, largest residual {max(residuals):.1e}; all: {statistics.median(times):.0f} us at the median"
    )
    return sum(some.count(False) for some in solved.values())


def robustness(count: int, seed: int) -> int:
    """Cold solves of random problems; prints failures and statistics."""
    decided: dict[int, Counter[str]] = defaultdict(Counter)
    times: dict[int, list[float]] = defaultdict(list)
    failures = 0
    worst = 0.0
    solver = ContactSolver()
    for k, kind, problem in random_problems(count, seed):
        n = len(problem[2])
        solver.forget()
        began = time.perf_counter()
        solved = solver.solve(*problem)
        times[n].append(1e6 * (time.perf_counter() - began))
        decided[n][solver.decided_by if solved else "failed"] += 1
        if solved:
            worst = max(worst, solver.residual)
        else:
            failures += 1
            print(f"problem {k}: {kind}, {n} contacts, residual {solver.residual:.1e}", flush=True)
    for n in sorted(times):
        ordered = sorted(times[n])
        print(
            f"{n:3d} contacts: {len(ordered)} problems, median {statistics.median(ordered):.1f} us, 99 % within "
            f"{ordered[int(0.99 * len(ordered))]:.0f} us, largest {ordered[-1] * 1e-3:.1f} ms; {dict(decided[n])}"
        )
    print(f"{failures} of {count} failed; largest residual of the others {worst:.1e}")
    return failures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--contacts", type=int, nargs="+", default=CONTACTS, help="numbers of contacts")
    parser.add_argument("--count", type=int, default=20, help="problems of each kind and number, a quarter beyond 16")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", help="also write the table to this file")
    parser.add_argument("--robustness", type=int, metavar="N", help="solve N random problems cold instead")
    parser.add_argument("--proxqp", action="store_true", help="of these N what ProxQP's programs solve alone")
    arguments = parser.parse_args()
    if arguments.proxqp:
        if not arguments.robustness:
            parser.error("--proxqp needs --robustness N")
        # it is no failure that others would take over
        program_shares(arguments.robustness, arguments.seed)
        return
    if arguments.robustness:
        sys.exit(1 if robustness(arguments.robustness, arguments.seed) else 0)
    rows = compare(tuple(arguments.contacts), arguments.count, arguments.seed)
    held_starts(tuple(n for n in arguments.contacts if n <= 16), 10 * arguments.count, arguments.seed)
    if arguments.csv:
        with open(arguments.csv, "w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
