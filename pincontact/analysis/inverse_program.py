"""Inverse dynamics within limits: least squares on several levels, over the admissible motions and forces of a state.

In the free directions s of `Problem`, within its cones and half-spaces, one after the other,

    reach     the weighted distance of the accelerations from those wanted is least,
    efforts   the norm of the efforts, among what is as near,
    forces    the distance of contact forces from chosen ones, among what has these efforts.

Each level is a `ConeLeastSquares` in what the one before leaves free, and begins inside. The first is left out as long
as the accelerations wanted can be reached, which the second finds out. Where they cannot, the multipliers of the first
are a certificate; where nothing is admissible, those of the least enlargement of all limits.
"""

from __future__ import annotations

from itertools import cycle, product
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InfeasibleError, SolverError
from ..friction.centred import Cone, central_force
from ..friction.cone_least_squares import ConeLeastSquares, ConeSolution, Region
from ..geometry.patterns import ON_CURVE
from ..layout import MODE, PATTERN, SLIPPING, TANGENTS, UNILATERAL
from .actuation import Actuation, read_actuation
from .farkas import FarkasCertificate, certificate_of
from .instant import Instant
from .inverse_loads import shares_of
from .inverse_problem import Options, Problem, Wanted
from .tasks import TaskReader

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from ..scene import Scene
    from ..state import State

# Directions that move tasks, efforts or forces by less than this part of what moves them most do not move them.
_NULL, _CLEARLY = 1e-9, 1e-12
# Iterations for the directions of normal forces of contacts that cannot open, and their tolerance.
_ROUNDS, _CONVERGED = 20, 1e-9
# Of so many of them each choice of signs is tried; the others go with these, in their order.
_CHOSEN = 4


class Solved:
    """What a program found: the problem, u, by how much the wanted accelerations are missed, in the norm of the
    weighted tasks, and why."""

    def __init__(
        self, problem: Problem, u: np.ndarray, shortfall: float, certificate: FarkasCertificate | None
    ) -> None:
        self.problem, self.shortfall, self.certificate = problem, shortfall, certificate
        low, high = problem.resting.low / problem.load, problem.resting.high / problem.load
        # exactly, where the program is content with round-off
        u[problem.holding] = np.clip(u[problem.holding], low, high)
        self.u = u
        self.efforts = problem.load * u[problem.efforts]
        self.components = problem.load * u[problem.components]
        self.holding = problem.load * u[problem.holding]


class InverseProgram:
    """The programs of one scene, which go on from call to call: evaluation, facets, multipliers, the last forces.

    The scene and its model must stay as they are.
    """

    def __init__(self, scene: Scene, state: State) -> None:
        self.instant = Instant(scene, state, decide=False)
        self.instant.move_to(state)
        self.tasks = TaskReader(scene.model)
        self._contacts = list(scene.contacts.values())
        self._levels = {name: ConeLeastSquares() for name in ("accelerations", "efforts", "forces", "certificate")}
        self._reach, self._efforts, self._forces, self._elastic = self._levels.values()
        self._reached = True
        self._last: np.ndarray | None = None
        # by item and row, of the last call and of the one before
        self._last_forces: dict[tuple[int, int], float] = {}
        self._before: dict[tuple[int, int], float] = {}
        self._sizes: dict[int, float] = {}
        self._all_joints: Actuation | None = None

    def actuation(self, given: ArrayLike | Sequence[str] | None) -> Actuation:
        """See `read_actuation`."""
        if given is not None:
            return read_actuation(self.instant.model, given)
        self._all_joints = self._all_joints or read_actuation(self.instant.model, None)
        return self._all_joints

    def fits(self, scene: Scene) -> bool:
        """Whether it was made for this scene with these contacts."""
        return self.instant.scene is scene and self._contacts == list(scene.contacts.values())

    @property
    def programs(self) -> dict[str, int]:
        """How many quadratic programs ProxQP has solved, by what they were for."""
        return {name: level.programs for name, level in self._levels.items()}

    def solve(self, wanted: Wanted) -> Solved:
        """At the state of `instant`.

        Raises InfeasibleError with a certificate, SolverError where the equations cannot be balanced.
        """
        self._before = self._last_forces
        system = self.instant.system
        two_sided = [
            c
            for c in system.closed()
            if not system.contact_int[c, UNILATERAL]
            and system.contacts[c].name not in wanted.given
            and (system.contact_int[c, TANGENTS] > 0 or system.resists(c))
            and (wanted.options.cones or self._slides(c))
        ]
        if not two_sided:
            return self._solve_in_units(wanted, {}, [], [])
        # friction that goes with |F_n| is not convex: each choice of signs is a program
        best: Solved | None = None
        failure = SolverError("the nearest accelerations are others")
        for signs in product((1.0, -1.0), repeat=min(len(two_sided), _CHOSEN)):
            try:
                found = self._find_directions(wanted, dict(zip(two_sided, cycle(signs))), two_sided)
            except SolverError as error:
                failure = error
                continue
            if best is None or _merit(found) < _merit(best):
                best, forces = found, self._last_forces
        if best is not None and (best.certificate is None or wanted.options.unreachable == "nearest"):
            self._last_forces = forces
            return Solved(best.problem, best.u, best.shortfall, None)
        raise SolverError(
            f"inverse dynamics: nothing was found for either sign of the normal force of contacts that cannot open, "
            f"{', '.join(repr(system.contacts[c].name) for c in two_sided)}: {failure}"
        )

    def _slides(self, c: int) -> bool:
        """Whether contact c slides, or turns against a resistance."""
        system = self.instant.system
        items = [c, *(i for i in system.resisting() if system.owner(i) == c)]
        return bool((system.contact_int[items, MODE] == SLIPPING).any())

    def _find_directions(self, wanted: Wanted, signs: dict[int, float], two_sided: list[int]) -> Solved:
        """With these signs of the normal forces of contacts that cannot open. Of points on curves, whose normal forces
        have directions instead, those that agree with what is found with them, from those without the contacts' cones
        on: these, or by their signs the opposite ones."""
        instant, integers = self.instant, self.instant.system.contact_int
        turning = [c for c in two_sided if integers[c, PATTERN] == ON_CURVE]
        given = {(c, 2): sign for c, sign in signs.items() if c not in turning}
        if not turning:
            return self._solve_in_units(wanted, given, [], two_sided)
        unlimited, shares = turning, given
        for _ in range(_ROUNDS):
            found = self._solve_in_units(wanted, shares, unlimited, two_sided)
            problem = found.problem
            again = shares_of(instant, problem.items, found.components)
            if not unlimited and np.abs(again - problem.shares).max(initial=0.0) <= _CONVERGED:
                return found
            if unlimited:
                again *= [signs[c] if c in turning and row != 0 else 1.0 for c, row in problem.items]
            unlimited, shares = [], dict(zip(problem.items, again.tolist())) | given
        raise SolverError("the directions of normal forces do not converge")

    # ---------------------------------------------------------------- levels

    def _solve_in_units(
        self, wanted: Wanted, shares: dict[tuple[int, int], float], unlimited: list[int], two_sided: list[int]
    ) -> Solved:
        """Once more in units of its own size where an answer is a small part of what was wanted."""
        answer: np.ndarray | None = None
        while True:
            problem = Problem(self.instant, wanted, shares, unlimited, two_sided, self._sizes, answer)
            found = self._solve(problem, wanted)
            answer = self._last = problem.units * found.u
            if not problem.small(answer):
                return found

    def _solve(self, problem: Problem, wanted: Wanted) -> Solved:
        options, start, basis = wanted.options, problem.start, problem.basis
        level = _Tasks(problem, wanted)
        last = self._last
        known = last is not None and last.size == start.size
        guess = basis.T @ (last / problem.units - start) if known else np.zeros(basis.shape[1])
        rows, rest = basis[problem.efforts], start[problem.efforts]
        point, null, shortfall, certificate, solution = level.point, level.null, 0.0, None, None
        inner = problem.region.restricted(start + basis @ point, basis @ null)
        if self._reached:
            solution = self._efforts.solve(rows @ null, -(rest + rows @ point), inner, null.T @ guess)
        if solution is None:
            region = problem.region.restricted(start, basis)
            nearest, shortfall, certificate = self._nearest(problem, level, region, guess, options)
            point = nearest.y
            if certificate is not None:
                null = _null(np.vstack([level.matrix, region.shared(nearest)]))
            inner = region.restricted(point, null, keep=True)
            solution = self._efforts.solve(rows @ null, -(rest + rows @ point), inner, np.zeros(null.shape[1]))
            if solution is None:
                raise SolverError("inverse dynamics: ProxQP did not find the least efforts")
        point = point + null @ solution.y
        free = _null(rows @ null)
        if free.shape[1]:
            free = _null(np.vstack([rows @ null, inner.shared(solution)]))
        if free.shape[1]:
            inner = inner.restricted(solution.y, free, keep=True)
            point = self._choose_forces(problem, options.redundant, point, null @ free, inner)
        found = Solved(problem, start + basis @ point, shortfall, certificate)
        self._last_forces = dict(zip(problem.items, found.components.tolist()))
        return found

    def _nearest(
        self, problem: Problem, level: _Tasks, region: Region, guess: np.ndarray, options: Options
    ) -> tuple[ConeSolution, float, FarkasCertificate | None]:
        """The nearest accelerations, their distance, and why there is one."""
        nearest = self._reach.solve(level.matrix, level.right, region, guess)
        if nearest is None:
            # from a point inside, if there is one
            nearest = self._reach.solve(level.matrix, level.right, region, self._inside(problem, level, region))
        if nearest is None:
            raise SolverError("inverse dynamics: ProxQP did not find the nearest accelerations within the limits")
        unit = float(np.linalg.norm(level.matrix @ nearest.y - level.right))
        shortfall = level.scale * unit
        self._reached = shortfall <= options.tolerance * level.size
        if self._reached:
            return nearest, 0.0, None
        scale = 1.0
        if not nearest.exact and unit < 1.0:
            # multipliers are as large as the distance; in units of it they are known better
            again = self._reach.solve(level.matrix / unit, level.right / unit, region, nearest.y)
            if again is not None:
                nearest, scale = again, unit
                shortfall = level.scale * float(np.linalg.norm(level.matrix @ nearest.y - level.right))
        task = level.rows.T @ (level.matrix @ nearest.y - level.right) / (level.scale * scale**2)
        wanted = problem.start + problem.basis @ level.point
        certificate = certificate_of(problem, nearest.cones, nearest.rows, task, wanted)
        if options.unreachable == "error":
            self._reached = True
            raise InfeasibleError(
                f"inverse dynamics: the accelerations are out of reach, by {shortfall:.3g} in the norm of the weights, "
                f"for {certificate}",
                certificate,
            )
        return nearest, shortfall, certificate

    def _choose_forces(
        self, problem: Problem, redundant: str, point: np.ndarray, free: np.ndarray, region: Region
    ) -> np.ndarray:
        """The point with the forces nearest to what is chosen, among point + free @ x."""
        basis = problem.basis[problem.components]
        forces, rows = problem.start[problem.components] + basis @ point, basis @ free
        aim = np.zeros(forces.size)
        if redundant == "last":
            aim = np.array([self._before.get(item, 0.0) for item in problem.items]) / problem.load
        elif redundant == "centred":
            # in the coordinates of the cones, and all other limits
            values = np.concatenate([region.apexes.ravel(), *_distances(region, None)])
            slopes = np.vstack([region.cones.reshape(-1, free.shape[1]), *_distances(region, free)])
            count = 3 * len(region.cones)
            cones = [Cone(i, tangents=(i + 1, i + 2)) for i in range(0, count, 3)]
            cones += [Cone(i) for i in range(count, values.size)]
            found = central_force(values, slopes, cones)
            if found is not None:
                return point + free @ np.linalg.lstsq(slopes, found.forces - values, rcond=None)[0]
        solution = self._forces.solve(rows, aim - forces, region, np.zeros(free.shape[1]))
        return point if solution is None else point + free @ solution.y

    def _inside(self, problem: Problem, level: _Tasks, region: Region) -> np.ndarray:
        """A point of the region; InfeasibleError where nothing is admissible whatever the accelerations."""
        elastic = region.elastic()
        n, total = region.rows.shape[1], elastic.rows.shape[1]
        matrix = np.hstack([np.zeros((total - n, n)), np.eye(total - n)])
        found = self._elastic.solve(matrix, np.zeros(total - n), elastic, np.zeros(total))
        if found is None:
            raise SolverError("inverse dynamics: ProxQP found neither forces within the limits nor a reason why")
        if region.contains(found.y[:n]):
            return found.y[:n]
        # those of a row and of its elastic one
        count = len(region.rows)
        on_cones, on_rows = found.cones, found.rows[:count] + found.rows[count:]
        task = np.zeros(problem.span.shape[1])
        at = problem.start + problem.basis @ level.point
        certificate = certificate_of(problem, on_cones, on_rows, task, at)
        raise InfeasibleError(
            f"inverse dynamics: no forces within the limits keep these contacts, whatever the accelerations, for "
            f"{certificate}",
            certificate,
        )


def _merit(found: Solved) -> tuple[bool, float, float]:
    """What is reached is better, then what is nearer, then the smaller efforts."""
    missed = found.shortfall if found.certificate is not None else 0.0
    return found.certificate is not None, missed, float(np.linalg.norm(found.efforts))


class _Tasks:
    """The tasks in free directions: rows (r, nz) in z; matrix (r, p), right (r,) without units and without what no
    direction reaches; scale: their unit, size: that of the wanted accelerations; point (p,): where they are reached;
    null (p, k): orthonormal, what does not move them."""

    def __init__(self, problem: Problem, wanted: Wanted) -> None:
        rows, goal = problem.goal(wanted.tasks)
        nz = problem.span.shape[1]
        self.rows = rows * problem.rate
        self.scale = float(np.sqrt((self.rows * self.rows).sum(axis=1).max(initial=0.0))) or 1.0
        self.size = float(np.linalg.norm(goal)) + self.scale
        self.matrix = (self.rows @ problem.basis[:nz]) / self.scale
        missing = (goal - self.rows @ problem.start[:nz]) / self.scale
        left, values, right = np.linalg.svd(self.matrix)
        rank = int((values > _NULL * max(1.0, values.max(initial=0.0))).sum())
        reached = left[:, :rank].T @ missing
        self.right = left[:, :rank] @ reached
        self.point, self.null = right[:rank].T @ (reached / values[:rank]), right[rank:].T


def _null(matrix: np.ndarray) -> np.ndarray:
    """(n, k) orthonormal null directions of a matrix (m, n)."""
    if matrix.shape[0] >= matrix.shape[1] > 0:
        # as a rule there is none, which costs less to see
        squares = np.linalg.eigvalsh(matrix.T @ matrix)
        if squares[0] > _CLEARLY * max(1.0, squares[-1]):
            return np.zeros((matrix.shape[1], 0))
    _, values, rows = np.linalg.svd(matrix)
    return rows[int((values > _NULL * max(1.0, values.max(initial=0.0))).sum()) :].T


def _distances(region: Region, free: np.ndarray | None) -> list[np.ndarray]:
    """Distances from the finite ends of rows' ranges at zero, or with free directions their slopes; of those rows only
    that these move."""
    moved = np.abs(region.rows).max(axis=1, initial=0.0) > _NULL
    low, high = moved & np.isfinite(region.low), moved & np.isfinite(region.high)
    if free is None:
        return [-region.low[low], region.high[high]]
    return [region.rows[low], -region.rows[high]]
