"""Contact problems some of whose contacts slide already, and whose torques resist turning in proportion to loads.

Unknowns are normal forces, N >= 0, w >= 0, N w = 0 with w the relative acceleration, and forces on disks, whose radius
is given or a multiple of one of the normal forces. The friction of what slides has a known direction and goes with its
normal force: F = N (n - mu d). So the operator, A = J_n M^-1 (J_n - mu d J_t)^T where everything slides, is not
symmetric, and need not be of any definiteness: there may be several solutions, or none (Painleve).

With P_+ and P_D the projections on what is not negative and on a disk, solutions are the zeros of

    N - P_+(N - w)     and     T - P_D(T - w_t).

Newton's method finds them from near by (Alart, Curnier, Comput. Methods Appl. Mech. Engrg. 92, 1991). What is near is
suggested by the present forces, by the symmetric cone problem in which what slides has so large a velocity along its
direction that it can do nothing else, and, of few contacts, by each choice of those that carry a load. Where more
contacts stick than bodies can feel, as four wheels on a floor, full steps may go to and fro between two choices of what
sticks: steps that are halved until the residual falls then get there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

# Residual, in units of the largest acceleration without forces, up to which a zero is one.
TOLERANCE = 1e-10
_NEWTON_STEPS = 40
# How often one is halved, and by which part of its linear forecast the square of what has to vanish then falls.
_HALVINGS, _FALL = 12, 1e-3
# Below this fraction of what it is without friction, a contact's own operator has lost positivity.
_POSITIVE = 1e-9
# Relative singular values below this are those of redundant contacts.
_RANK = 1e-11
# Nearly redundant contacts, whose smallest singular value is below this part of the largest, may have any determinant.
_LOST = 1e-3
# Normal forces whose choices of loaded ones are all tried, without and with disks.
_TRIED, _TRIED_WITH_DISKS = 10, 6
# Velocities of what slides, in units of the largest acceleration without forces, in the symmetric problem.
_SPEEDS = (1e3, 1e6)


@dataclass
class Disk:
    """|F| <= factor N[normal], of the forces in these rows of the problem; where `normal` is None, |F| <= radius, or
    with a load (a (k,), B (k, m)) |F| <= factor |a + B forces|, of all forces."""

    rows: list[int]
    factor: float = 0.0
    normal: int | None = None
    radius: float = 0.0
    load: tuple[np.ndarray, np.ndarray] | None = None


@dataclass
class Loads:
    """The problem u = gram F + base over n units of three rows.

    normals: rows with F >= 0, u >= 0, F u = 0; drag: normal row -> (m,) forces in all rows that go with a unit of it;
    disks: what else is unknown. Forces in other rows are zero.
    """

    gram: np.ndarray
    base: np.ndarray
    normals: list[int]
    drag: dict[int, np.ndarray] = field(default_factory=dict)
    disks: list[Disk] = field(default_factory=list)


class LoadSolver:
    """Solves such problems. After `solve` returned True, `forces` (m,) and `velocities` (m,) are a solution; after it
    returned False, `proved` says whether there is none, or none was found.

    guess_first: begin from what `guess` finds, and from the last forces where that leads nowhere. unguessed: how often
    it did not, of problems begun so.
    pressed: for each of the normals, whether it carries a load; slid: for each disk, whether the force is on its rim.
    """

    def __init__(self, guess_first: bool = False) -> None:
        self.guess_first, self.unguessed = guess_first, 0
        self.forces = self.velocities = np.zeros(0)
        self.pressed = np.zeros(0, dtype=bool)
        self.slid: list[bool] = []
        self.residual = 0.0
        self.proved = False

    def solve(self, problem: Loads, forces: np.ndarray, guess: Callable[[float], np.ndarray | None]) -> bool:
        """Solve it from forces (m,), those of `guess`(velocity of what slides), and from all choices of few loads."""
        scaled = ScaledLoads(problem)
        self.proved = lost = False
        for start, loaded, halved in self._starts(scaled, forces, guess):
            y, residual = scaled.newton(start, loaded, halved)
            if residual <= TOLERANCE and scaled.is_lost(y):
                lost = True
            elif residual <= TOLERANCE:
                self.forces = scaled.forces(y)
                self.velocities = problem.gram @ self.forces + problem.base
                self.velocities[np.abs(self.velocities) <= TOLERANCE * scaled.largest] = 0.0
                self.pressed, self.slid = scaled.modes(y)
                self.residual = residual
                return True
        # every choice of loads is one linear system, and none of them has a solution
        self.proved = not lost and not problem.disks and len(problem.normals) <= _TRIED
        return False

    def _starts(
        self, scaled: ScaledLoads, forces: np.ndarray, guess: Callable[[float], np.ndarray | None]
    ) -> Iterator[tuple[np.ndarray, np.ndarray | None, bool]]:
        """Forces to begin from, which normals are loaded where that is prescribed, and whether steps are halved."""
        present = scaled.unknowns(forces)
        if not self.guess_first:
            yield present, None, False
        count, disks = len(scaled.problem.normals), bool(scaled.problem.disks)
        for speed in _SPEEDS:
            found = guess(speed * scaled.largest)
            if found is not None:
                yield scaled.unknowns(found), None, False
        if self.guess_first:
            self.unguessed += 1
            yield present, None, False
        if count <= (_TRIED_WITH_DISKS if disks else _TRIED):
            # what is closed stays closed, if it can
            for number in range(count, -1, -1):
                for chosen in combinations(range(count), number):
                    loaded = np.zeros(count, dtype=bool)
                    loaded[list(chosen)] = True
                    yield np.zeros(scaled.base.size), loaded, False
        if disks:
            yield present, None, True
            yield np.where(np.arange(present.size) < count, present, 0.0), None, True
            yield np.zeros(present.size), None, True


class ScaledLoads:
    """The problem in unknowns y without units: normal forces first, then those of disks."""

    def __init__(self, problem: Loads) -> None:
        self.problem = problem
        normals, m = problem.normals, problem.base.size
        rows = [*normals, *(row for disk in problem.disks for row in disk.rows)]
        diagonal = problem.gram.diagonal().reshape(-1, 3).mean(axis=1)
        scale = np.repeat(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 3)
        self.rows, self.scale = rows, scale[rows]
        self.expand = np.zeros((m, len(rows)))
        self.expand[rows, np.arange(len(rows))] = 1.0
        for k, row in enumerate(normals):
            if row in problem.drag:
                self.expand[:, k] += problem.drag[row]
        self.largest = float(np.abs(problem.base).max(initial=0.0)) or 1.0
        unit = float(np.abs(scale[rows] * problem.base[rows]).max(initial=0.0)) or 1.0
        self.expand *= self.scale
        self.unit = unit
        self.operator = self.scale[:, None] * (problem.gram @ self.expand)[rows]
        self.base = self.scale * problem.base[rows] / unit
        own = problem.gram.diagonal()[normals] * self.scale[: len(normals)] ** 2
        count = len(normals)
        self.passive = self.operator.diagonal()[:count] <= _POSITIVE * own
        self.disks: list[_ScaledDisk] = []
        at = count
        for disk in problem.disks:
            places = np.arange(at, at + len(disk.rows))
            at += len(disk.rows)
            own = self.scale[places[0]]
            if disk.normal is not None:
                k = normals.index(disk.normal)
                self.disks.append(_ScaledDisk(places, disk.factor * self.scale[k] / own, k))
            elif disk.load is not None:
                load = disk.load[0] / unit, disk.load[1] @ self.expand
                self.disks.append(_ScaledDisk(places, disk.factor / own, None, load))
            else:
                self.disks.append(_ScaledDisk(places, disk.radius / (own * unit), None))

    def forces(self, y: np.ndarray) -> np.ndarray:
        """(m,) forces of unknowns."""
        return self.unit * (self.expand @ y)

    def unknowns(self, forces: np.ndarray) -> np.ndarray:
        """The unknowns in forces (m,) along the problem's rows."""
        return np.nan_to_num(forces[self.rows] / (self.scale * self.unit))

    def newton(self, y: np.ndarray, loaded: np.ndarray | None, halved: bool = False) -> tuple[np.ndarray, float]:
        """The zero that Newton's method comes to from there, and its residual, infinite where that is no solution.

        loaded: which normal forces are to be there, or None; halved: whether steps are halved until values fall.
        """
        best, least = y, math.inf
        for step in range(_NEWTON_STEPS):
            values, jacobian = self._equations(y, loaded)
            if not np.isfinite(values).all():
                break
            residual = _relative(values, y)
            if residual < least:
                best, least = y, residual
                if residual <= 1e-3 * TOLERANCE:
                    break
            elif least <= TOLERANCE:
                break
            change = -np.linalg.lstsq(jacobian, values, rcond=_RANK)[0]
            part, size = 1.0, float(values @ values)
            for _ in range(_HALVINGS if halved else 0):
                there, _ = self._equations(y + part * change, loaded)
                if there @ there < (1.0 - _FALL * part) * size:
                    break
                part *= 0.5
            y = y + part * change
            if loaded is not None and not self.disks and step == 1:
                break
        return best, least if self._admissible(best) else math.inf

    def residual(self, y: np.ndarray) -> float:
        """How far the unknowns are from a zero."""
        return _relative(self._equations(y, None)[0], y)

    def is_lost(self, y: np.ndarray) -> bool:
        """Whether the operator of what is loaded at a zero has lost positivity: its determinant, positive without
        friction, is negative. From this zero compliances lead away, and as a rule there are others."""
        jacobian = self._equations(y, None)[1]
        sizes = np.linalg.norm(jacobian, axis=1)
        jacobian = jacobian / np.where(sizes > 0.0, sizes, 1.0)[:, None]
        singular = np.linalg.svd(jacobian, compute_uv=False)
        return bool(singular.size and singular[-1] > _LOST * singular[0] and np.linalg.slogdet(jacobian)[0] < 0.0)

    def _equations(self, y: np.ndarray, loaded: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """What has to vanish, and its derivative; loaded: see `newton`."""
        count, n = len(self.problem.normals), self.base.size
        identity = np.eye(n)
        w = self.operator @ y + self.base
        press = y[:count] - w[:count] > 0.0 if loaded is None else loaded
        values = np.where(press, w[:count], y[:count])
        jacobian = np.where(np.append(press, np.ones(n - count, dtype=bool))[:, None], self.operator, identity)
        values = np.append(values, w[count:])
        for disk in self.disks:
            places = disk.places
            radius = disk.radius(y, press)
            p = y[places] - w[places]
            size = float(np.sqrt(p @ p))
            if size <= radius:
                continue
            along = p / size
            values[places] = y[places] - radius * along
            turn = radius / size * (np.eye(places.size) - np.outer(along, along))
            jacobian[places] = identity[places] - turn @ (identity[places] - self.operator[places])
            slope = disk.slope(y)
            if slope is not None:
                jacobian[places] -= np.outer(along, slope)
        return values, jacobian

    def modes(self, y: np.ndarray) -> tuple[np.ndarray, list[bool]]:
        """Which normals carry a load, and on which disks the force is on the rim."""
        w = self.operator @ y + self.base
        count = len(self.problem.normals)
        # what redundant contacts carry may be round-off
        pressed = y[:count] - w[:count] > TOLERANCE * (1.0 + float(np.abs(y).max(initial=0.0)))
        sizes = [float(np.linalg.norm(y[disk.places] - w[disk.places])) for disk in self.disks]
        return pressed, [size > disk.radius(y, pressed) for size, disk in zip(sizes, self.disks)]

    def _admissible(self, y: np.ndarray) -> bool:
        """Whether nothing pulls or closes; a contact whose own force would not part the bodies carries nothing."""
        count = len(self.problem.normals)
        small = TOLERANCE * (1.0 + float(np.abs(y).max(initial=0.0)))
        w = self.operator[:count] @ y + self.base[:count]
        return bool((y[:count] >= -small).all() and (w >= -small).all() and (y[:count][self.passive] <= small).all())


def _relative(values: np.ndarray, y: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0)) / (1.0 + float(np.abs(y).max(initial=0.0)))


@dataclass
class _ScaledDisk:
    """A disk in unknowns: its places among them, its factor, the unknown that is its normal force, its load."""

    places: np.ndarray
    factor: float
    normal: int | None
    load: tuple[np.ndarray, np.ndarray] | None = None

    def radius(self, y: np.ndarray, pressed: np.ndarray) -> float:
        """At the unknowns y."""
        if self.load is not None:
            return self.factor * float(np.linalg.norm(self.load[0] + self.load[1] @ y))
        if self.normal is None:
            return self.factor
        if math.isinf(self.factor):
            return math.inf if pressed[self.normal] else 0.0
        return self.factor * max(float(y[self.normal]), 0.0)

    def slope(self, y: np.ndarray) -> np.ndarray | None:
        """(n,) derivative of the radius, None where it is constant."""
        if self.load is not None:
            there = self.load[0] + self.load[1] @ y
            length = float(np.linalg.norm(there))
            return self.factor / length * (there @ self.load[1]) if length > 0.0 else None
        if self.normal is None or not (y[self.normal] > 0.0 and math.isfinite(self.factor)):
            return None
        slope = np.zeros(y.size)
        slope[self.normal] = self.factor
        return slope
