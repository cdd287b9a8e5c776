"""The unknowns, equations and limits of inverse dynamics at one state, without units.

Unknown are u = (z, e, F, h): accelerations a = a_0 + Z z that keep the contacts, efforts, components of contact forces,
and forces that hold joints at rest. Whitened (see `dynamics.units`), the equations of motion are

    a_0 + Z z = a_free + S e + J^T F + h

They leave u = start + basis @ s with s free. Limits are half-spaces and cones of u.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..dynamics.friction_scaling import friction_scaling
from ..dynamics.units import REDUNDANT, unwhiten, whiten, whitened_velocity
from ..errors import SolverError
from ..friction.cone_least_squares import Region
from ..geometry.patterns import ON_CURVE
from ..layout import ANISOTROPIC, MODE, MU_STATIC, PATTERN, SLIPPING, STICK, TANGENTS, UNILATERAL
from .actuation import Actuation
from .instant import Instant
from .inverse_loads import LEAST_LOAD, RestingJoints, joint_loads, unit_forces
from .ranks import Directions
from .tasks import Tasks

_ROUND = np.eye(2)
# Limits hold to 1e-7 of the units. Answers are in units that are not larger by more than this.
_SMALL = 0.1


@dataclass(frozen=True)
class Options:
    """Those of `inverse_dynamics` with these names; exact: accelerations that are not reached are an error."""

    cones: bool
    effort_limits: bool
    unreachable: str
    redundant: str
    tolerance: float
    exact: bool


@dataclass(frozen=True, eq=False)
class Wanted:
    """What a call asks for: tasks, actuation, and given contact forces."""

    tasks: Tasks
    actuation: Actuation
    given: dict[str, np.ndarray]
    options: Options


def opening_contacts(instant: Instant, given: dict[str, np.ndarray]) -> list[int]:
    """Closed contacts that are given no force, and so may open."""
    system = instant.system
    return [
        c
        for c in system.closed()
        if system.contact_int[c, UNILATERAL]
        and (force := given.get(system.contacts[c].name)) is not None
        and not force.any()
    ]


class Problem:
    """The problem of a call at the state of an instant.

    shares: of normal components, see `shares_of`; of others it is 1. unlimited: contacts whose cones are left out.
    two_sided: those that cannot open, with normal forces of these signs. sizes: sizes of the rows of items, which are
    kept from call to call.
    items: (item, row) of each component of force. origin (nv,), span (nv, nz): a_0 and Z, whitened. load, rate: what a
    unit of force is in N, and one of z in N / sqrt(kg): at least least_load and least_rate, those of what acts, and as
    large as what is wanted or, where limits let that be a small part only, as an `answer` that was found, in `units`.
    efforts, components, holding: slices of u. start (n,), basis (n, p): see the module. region: in u; owners: of its
    cones and rows, ("contact", its number) or ("joint", its index in v).
    """

    def __init__(
        self,
        instant: Instant,
        wanted: Wanted,
        shares: dict[tuple[int, int], float],
        unlimited: list[int],
        two_sided: list[int],
        sizes: dict[int, float],
        answer: np.ndarray | None = None,
    ) -> None:
        self.instant, system = instant, instant.system
        self._factor = np.tril(system.factor)
        self.opening = opening_contacts(instant, wanted.given)
        constrained = [item for item in instant.constrained() if system.owner(item[0]) not in self.opening]
        self.items = [item for item in constrained if system.contacts[system.owner(item[0])].name not in wanted.given]
        self.shares = np.array([shares.get(item, 1.0) for item in self.items])
        for item in {c for c, _ in constrained}.difference(sizes):
            sizes[item] = instant.row_size(item)
        rows, bias = instant.rows(constrained), instant.biases(constrained)
        lengths = np.array([sizes[c] for c, _ in constrained])
        self._keep(Directions(whiten(system, rows.T), lengths, system.moves), bias)
        self.resting, self.beginning, self._directions = self._joints(wanted)
        if self.resting.index.size:
            held = np.eye(system.nv)[self.resting.index]
            columns = whiten(system, np.vstack([rows, held]).T)
            lengths = np.append(lengths, np.linalg.norm(columns[:, len(rows) :], axis=0))
            self._keep(Directions(columns, lengths, system.moves), np.append(bias, np.zeros(len(held))))
        self._equate(wanted, answer)
        self.owners: list[tuple[str, int]] = []
        self.region = self._limits(wanted, unlimited, two_sided)

    def _keep(self, directions: Directions, bias: np.ndarray) -> None:
        self.origin, self.span = directions.reach(-bias), directions.complement

    def goal(self, tasks: Tasks) -> tuple[np.ndarray, np.ndarray]:
        """Weighted tasks as rows (r, nz) @ z = goal (r,), not yet in units of `rate`."""
        system = self.instant.system
        if tasks.rows is None or tasks.weights is None:
            return self.span, self._factor @ tasks.wanted - self.origin
        weights = np.sqrt(tasks.weights)
        whitened = whiten(system, tasks.rows.T).T
        free = whitened @ self.span
        # what contacts leave of a row that they take is round-off, and no direction
        left, size = np.linalg.norm(free, axis=1), np.linalg.norm(whitened, axis=1)
        free[left <= REDUNDANT * size.max(initial=0.0)] = 0.0
        return weights[:, None] * free, weights * (tasks.wanted - whitened @ self.origin)

    def _joints(self, wanted: Wanted) -> tuple[RestingJoints, np.ndarray, np.ndarray]:
        """Joints that rest and stay at rest, and friction of those that begin to move, as the tasks have it; those that
        are to move beyond their ends stay there."""
        instant = self.instant
        limits = instant.system.limits
        speeds = np.abs(instant.v[[limit.index_v for limit in limits]])
        if not instant.at_rest(float(speeds.min(initial=np.inf))):
            none, nowhere = np.zeros(0), np.zeros(instant.system.nv)
            return RestingJoints(np.zeros(0, dtype=int), none, none), nowhere, nowhere
        rows, goal = self.goal(wanted.tasks)
        z = np.linalg.lstsq(rows, goal, rcond=None)[0]
        a = unwhiten(instant.system, self.origin + self.span @ z)
        return joint_loads(instant, a, wanted.options.tolerance, stop=not wanted.options.exact)

    def _of_wanted(self, tasks: Tasks) -> np.ndarray:
        """z (nz, n) that tasks want in any case: that of all coordinates, or the least of each row."""
        rows, goal = self.goal(tasks)
        if tasks.rows is None:
            return (rows.T @ goal)[:, None]
        squares = (rows * rows).sum(axis=1)
        return rows.T * np.divide(goal, squares, out=np.zeros_like(goal), where=squares > 0.0)

    def _equate(self, wanted: Wanted, answer: np.ndarray | None) -> None:
        """Columns of the equations of motion, units, and the solutions."""
        instant, system = self.instant, self.instant.system
        nv, na = wanted.actuation.matrix.shape
        columns = np.zeros((nv, na + len(self.items) + self.resting.index.size))
        columns[:, :na] = wanted.actuation.matrix
        for k, (c, row) in enumerate(self.items):
            if system.contact_int[c, MODE] != SLIPPING and not system.nr:
                columns[:, na + k] = system.rows[c, row]
                continue
            for item, unit in unit_forces(instant, c, row, self.shares[k]).items():
                columns[:, na + k] += system.rows[item].T @ unit
        columns[self.resting.index, na + len(self.items) + np.arange(self.resting.index.size)] = 1.0
        # a joint that is locked needs no balance
        columns[system.locked] = 0.0
        self.columns = columns
        # what acts whatever is chosen
        known = self.beginning.copy()
        for c, contact in enumerate(system.contacts):
            if contact.name in wanted.given and c not in self.opening:
                sign = -1.0 if contact.swapped else 1.0
                known += system.rows[c].T @ (system.basis[c] @ (sign * wanted.given[contact.name]))
        self.known = known
        free = self._factor @ system.free_acceleration + whiten(system, known)
        whitened, nz = whiten(system, columns), self.span.shape[1]
        self.least_load = max(LEAST_LOAD, float(np.abs([system.bias_forces, known]).max(initial=0.0)))
        self.least_rate = max(LEAST_LOAD / self._factor.max(), float(np.linalg.norm(free - self.origin)))
        if answer is None:
            made = self._of_wanted(wanted.tasks)
            load, rate = np.abs(self._factor.T @ self.span @ made), np.linalg.norm(made, axis=0)
        else:
            load, rate = np.abs(answer[nz:]), np.linalg.norm(answer[:nz])
        self.load = max(self.least_load, float(load.max(initial=0.0)))
        self.rate = max(self.least_rate, float(rate.max(initial=0.0)))
        self.efforts, self.components = slice(nz, nz + na), slice(nz + na, nz + na + len(self.items))
        self.holding = slice(nz + na + len(self.items), nz + columns.shape[1])
        self.equations = np.hstack([self.span, whitened * (-self.load / self.rate)])
        right = (free - self.origin) / self.rate
        moving = np.flatnonzero(system.moves)
        equations, right, n = self.equations[moving], right[moving], moving.size
        q, r = np.linalg.qr(equations.T, mode="complete")
        diagonal = np.abs(np.diagonal(r))
        if r.shape[0] >= n and diagonal.min() > REDUNDANT * diagonal.max():
            self.start = q[:, :n] @ np.linalg.solve(r[:n].T, right)
            self.basis = q[:, n:]
            return
        left, values, rows = np.linalg.svd(equations)
        rank = int((values > REDUNDANT * values.max(initial=0.0)).sum())
        self.start, self.basis = rows[:rank].T @ ((left[:, :rank].T @ right) / values[:rank]), rows[rank:].T
        missing = self.rate * float(np.abs(equations @ self.start - right).max())
        if missing > wanted.options.tolerance * self.rate * max(1.0, float(np.abs(right).max())):
            raise SolverError(
                f"inverse dynamics: the actuators and contacts cannot balance the equations of motion whatever the "
                f"accelerations (by {missing:.3g} N / sqrt(kg))"
            )

    # ---------------------------------------------------------------- limits

    def _limits(self, wanted: Wanted, unlimited: list[int], two_sided: list[int]) -> Region:
        size, options, system = self.start.size, wanted.options, self.instant.system
        self._rows: list[tuple[np.ndarray, float, float]] = []
        self._row_owners: list[tuple[str, int]] = []
        limited = [*system.closed(), *system.resisting()] if options.cones else two_sided
        cones = self._cones([c for c in limited if system.owner(c) not in unlimited], two_sided, options.cones)
        for k, joint in enumerate(self.resting.index):
            unit = np.zeros(size)
            unit[self.holding.start + k] = 1.0
            ends = self.resting.low[k] / self.load, self.resting.high[k] / self.load
            self._add_row(unit, *ends, ("joint", int(joint)))
        for c in self.opening:
            self._keep_from_going_back(system.rows[c, 2], float(system.bias[c, 2]), ("contact", c))
        for joint in np.flatnonzero(self._directions):
            unit = np.zeros(system.nv)
            unit[joint] = self._directions[joint]
            self._keep_from_going_back(unit, 0.0, ("joint", int(joint)))
        self.owners += self._row_owners
        rows = np.array([row for row, _, _ in self._rows]).reshape(len(self._rows), size)
        low, high = np.array([(low, high) for _, low, high in self._rows]).reshape(-1, 2).T
        if options.effort_limits:
            actuation = wanted.actuation
            of_efforts, most = np.zeros((actuation.limited.size, size)), actuation.ends / self.load
            of_efforts[:, self.efforts] = actuation.rows
            rows = np.concatenate([rows, of_efforts])
            low, high = np.concatenate([low, -most]), np.concatenate([high, most])
            self.owners += [("joint", k) for k in actuation.limited.tolist()]
        stacked = np.array(cones).reshape(len(cones), 3, size)
        return Region(stacked, np.zeros((len(cones), 3)), rows, low, high)

    def _add_row(self, row: np.ndarray, low: float, high: float, owner: tuple[str, int]) -> None:
        self._rows.append((row, low, high))
        self._row_owners.append(owner)

    def _keep_from_going_back(self, row: np.ndarray, bias: float, owner: tuple[str, int]) -> None:
        """row (nv,) @ acceleration + bias is not negative."""
        whitened, full = whiten(self.instant.system, row), np.zeros(self.start.size)
        length = float(np.linalg.norm(whitened))
        full[: self.span.shape[1]] = (whitened @ self.span) / length
        self._add_row(full, -(float(whitened @ self.origin) + bias) / (self.rate * length), np.inf, owner)

    def _cones(self, among: list[int], two_sided: list[int], with_friction: bool) -> list[np.ndarray]:
        """Friction cones (3, n) of these items, where they are wanted, and, as rows, signs of normal forces."""
        system = self.instant.system
        index = {item: self.components.start + k for k, item in enumerate(self.items)}
        out = []
        for c in among:
            owner, integers = system.owner(c), system.contact_int[c]
            name = ("contact", owner)
            if (owner, 2) not in index:
                continue
            normal, rows = np.zeros(self.start.size), [2, 1] if system.contact_int[owner, PATTERN] == ON_CURVE else [2]
            for row in rows:
                normal[index[owner, row]] = self.shares[index[owner, row] - self.components.start]
            # along what no joint moves there is no load
            most = np.inf if system.rows[owner, rows].any() else 0.0
            limit = float(system.contact_real[c, MU_STATIC])
            limited = integers[MODE] == STICK and np.isfinite(limit) and integers[TANGENTS] > 0 and with_friction
            if c < system.nc and (c in two_sided or integers[UNILATERAL] or limited or system.resists(c)):
                self._add_row(normal, 0.0, most, name)
            if not limited:
                continue
            scale = np.linalg.inv(friction_scaling(system, c)) if integers[ANISOTROPIC] else _ROUND
            cone = np.zeros((3, self.start.size))
            # torques are in parts of their lever
            cone[0] = normal * (limit if c < system.nc else 1.0)
            for i in range(integers[TANGENTS]):
                cone[1:, index[c, i]] = scale[:, i] if c < system.nc else scale[:, i] / max(limit, 1e-300)
            out.append(cone)
            self.owners.append(name)
        return out

    # ---------------------------------------------------------------- results

    @property
    def units(self) -> np.ndarray:
        """(n,) of u in N / sqrt(kg), N and N m."""
        return np.repeat([self.rate, self.load], [self.efforts.start, self.start.size - self.efforts.start])

    def small(self, answer: np.ndarray) -> bool:
        """Whether an answer with units (n,) is a small part of the problem's units, which may be smaller."""
        nz = self.span.shape[1]
        load, rate = float(np.abs(answer[nz:]).max(initial=0.0)), float(np.linalg.norm(answer[:nz]))
        return max(load, self.least_load) < _SMALL * self.load or max(rate, self.least_rate) < _SMALL * self.rate

    def acceleration(self, u: np.ndarray) -> np.ndarray:
        """(nv,) that u (n,) means."""
        return unwhiten(self.instant.system, self.origin + self.rate * (self.span @ u[: self.span.shape[1]]))

    def missed(self, u: np.ndarray, tasks: Tasks) -> float:
        """By how much u (n,) misses the tasks: root of the sum of weight * error^2."""
        if tasks.rows is None or tasks.weights is None:
            return float(np.linalg.norm(whitened_velocity(self.instant.system, self.acceleration(u) - tasks.wanted)))
        return float(np.linalg.norm(np.sqrt(tasks.weights) * (tasks.rows @ self.acceleration(u) - tasks.wanted)))

    def unbalanced(self, u: np.ndarray, tasks: Tasks) -> float:
        """The largest entry, in N and N m, of what u (n,) lacks for all accelerations wanted, where tasks are these."""
        lacking = self._of_wanted(tasks).sum(axis=1) - self.rate * u[: self.span.shape[1]]
        return float(np.abs(self._factor.T @ (self.span @ lacking)).max(initial=0.0))

    def residual(self, u: np.ndarray) -> float:
        """The largest entry of what u leaves of the equations of motion, in N and N m."""
        change = self._factor @ (self.acceleration(u) - self.instant.system.free_acceleration)
        left = self._factor.T @ change - self.known - self.columns @ (self.load * u[self.efforts.start :])
        return float(np.abs(left).max(initial=0.0))
