"""Which of redundant forces: those that hold what was at rest, and the least loads of what slides.

Redundant contacts may hold by some of the forces that do the same and slip by others, and the problem may have a
solution of either kind. Contacts slip only when there is no choice: what is looked for are forces inside all cones with
which everything stays at rest that was, the same analytic centre as in the event-driven methods.

Where contacts slide the choice moves the bodies. There, too, it is that of the event-driven methods: the least forces,
if these are inside their cones; else the least loads that are not negative where everything slides, and the analytic
centre where something sticks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np

from ..linalg import RANK_TOLERANCE
from .centred import Cone, central_force, rows_at_rest
from .cone import OPEN, SLIP, STICK
from .least_loads import least_of
from .loads import TOLERANCE, Loads

# What may be left of the largest b where the equations contradict each other by no more than round-off.
_LEFT = 1e-9
# What `Units` know of each.
_OF_UNITS = ("friction", "real", "loads", "modes", "forces", "velocities")
# Of loads that may go either way so many choices are tried.
_SIGNS_TRIED = 16


@dataclass(frozen=True)
class Units:
    """A cone problem of n units, of a time step or an impact, and what is known of its solution.

    gram (3n, 3n), base (3n,), friction (n,): the problem; real (n, 3): which rows are; parents (n,): the unit of whose
    normal force a multiple limits the others, -1 where loads (n,) are given; modes (n,): of the solution, what is to be
    held at rest included; forces, velocities (n, 3).
    """

    gram: np.ndarray
    base: np.ndarray
    friction: np.ndarray
    real: np.ndarray
    parents: np.ndarray
    loads: np.ndarray
    modes: np.ndarray
    forces: np.ndarray
    velocities: np.ndarray

    def with_loads(self, of: np.ndarray, base: np.ndarray, rows: np.ndarray) -> Units:
        """The problem in which the loads of these k units, which it takes as given, are unknown: base (k,) + rows (k,
        3n) @ forces, each an equation in the row that only fills up its unit's cone."""
        gram, b, real, parents = (array.copy() for array in (self.gram, self.base, self.real, self.parents))
        k = 3 * of + 2
        weights = gram[k, k]
        gram[k] -= weights[:, None] * rows
        b[k] = -weights * base
        real[of, 2], parents[of] = True, of
        return replace(self, gram=gram, base=b, real=real, parents=parents)

    def groups(self) -> list[np.ndarray]:
        """The units that act on each other."""
        n = self.modes.size
        coupled = (self.gram != 0.0).reshape(n, 3, n, 3).any(axis=(1, 3)) | np.eye(n, dtype=bool)
        limited = np.flatnonzero(self.parents >= 0)
        coupled[limited, self.parents[limited]] = coupled[self.parents[limited], limited] = True
        return connected_groups(coupled)

    def part(self, members: np.ndarray) -> Units:
        """The problem of a group of units."""
        if members.size == self.modes.size:
            return self
        rows, places = rows_of(members), np.full(self.modes.size + 1, -1)
        places[members] = np.arange(members.size)
        return replace(
            self,
            gram=self.gram[np.ix_(rows, rows)],
            base=self.base[rows],
            parents=places[self.parents[members]],
            **{name: getattr(self, name)[members] for name in _OF_UNITS},
        )


def holding_forces(units: Units, only: bool = False) -> np.ndarray | None:
    """(3n,) central forces of these modes; None where there are none, or no choice. only: where there is no choice the
    only ones, inside their cones or not."""
    unknowns = _Unknowns(units)
    if not unknowns.solve(only):
        return None
    return unknowns.central() if unknowns.null.shape[1] else unknowns.whole()


def holding_loads(units: Units, coupled: Loads, held: np.ndarray, given: np.ndarray) -> tuple[np.ndarray, float] | None:
    """(3n,) forces with which none of the units `held` (n,) slip, and their residual in the problem with loads as
    functions of the forces; None where none are found in these modes.

    given (n,): units whose loads the problem takes as given, and what sticks may change. One along its present
    direction, or against it, limits friction by no more than there is.
    """
    loaded = np.flatnonzero(given & (units.modes == STICK))
    base, rows = coupled.radius_base.reshape(-1, 2)[loaded], coupled.radius_rows.reshape(-1, 2, held.size * 3)[loaded]
    present = base + rows @ units.forces.ravel()
    size = np.linalg.norm(present, axis=1)[:, None]
    along = np.where(size > 0.0, present / np.where(size > 0.0, size, 1.0), [1.0, 0.0])
    for signs in islice(product((1.0, -1.0), repeat=loaded.size), _SIGNS_TRIED):
        d = np.array(signs)[:, None] * along
        found = holding_forces(
            units.with_loads(loaded, np.einsum("ki,ki->k", d, base), np.einsum("ki,kij->kj", d, rows)), only=True
        )
        if found is None:
            continue
        found, residual = coupled.refine(found)
        if residual <= TOLERANCE and not (held & (coupled.modes(found) == SLIP)).any():
            return found, residual
    return None


def connected_groups(coupled: np.ndarray) -> list[np.ndarray]:
    """Numbers of what is coupled, directly or by others; coupled (n, n): symmetric, True on its diagonal."""
    labels, n = np.arange(len(coupled)), len(coupled)
    while True:
        least = np.where(coupled, labels, n).min(axis=1, initial=n)
        if (least == labels).all():
            return [np.flatnonzero(labels == label) for label in np.unique(labels)]
        labels = least


def chosen_forces(units: Units, among: np.ndarray | None = None) -> np.ndarray | None:
    """(3n,) forces of these modes as the rule has them, for each group of units that act on each other by itself; None
    where there is no choice, or nothing slides. among (n,): units of which groups, where not of all."""
    forces, chosen = units.forces.ravel().copy(), False
    for members in units.groups():
        found = None if among is not None and not among[members].any() else _chosen_in_group(units.part(members))
        if found is not None:
            forces[rows_of(members)], chosen = found, True
    return forces if chosen else None


def rows_of(members: np.ndarray) -> np.ndarray:
    """The three rows of each of these units."""
    return (3 * members[:, None] + np.arange(3)).ravel()


def _chosen_in_group(units: Units) -> np.ndarray | None:
    """`chosen_forces` of one group."""
    rests = rows_at_rest(units.gram, units.base, units.forces.ravel())
    touches = (units.modes == OPEN) & (units.parents == np.arange(rests.shape[0])) & rests[:, 2]
    modes = np.where(touches, SLIP, units.modes)
    sticks = (modes == SLIP) & rests.all(axis=1) & (units.friction > 0.0)
    unknowns = _Unknowns(replace(units, modes=np.where(sticks, STICK, modes)))
    if not unknowns.slides or not unknowns.solve():
        return None
    return unknowns.central() if unknowns.sticks and not unknowns.inside() else unknowns.least()


class _Unknowns:
    """Forces of given modes as unknowns x without units, in which those of contacts count alike.

    sticks, slides: whether any force is one of sticking, any of sliding.
    """

    def __init__(self, units: Units) -> None:
        size = units.base.size
        self.units, self.known = units, np.zeros(size)
        self.rows: list[int] = []
        self.cones: list[Cone] = []
        self.sticks = self.slides = False
        columns: list[np.ndarray] = []
        scale = 1.0 / np.sqrt(units.gram.diagonal().reshape(-1, 3).mean(axis=1))
        # length of a contact's whole force for a unit of its normal force
        lengths: list[float] = []
        places: dict[int, int] = {}
        whole = np.eye(size)

        def add(row: int) -> int:
            columns.append(whole[row].copy())
            lengths.append(1.0)
            self.rows.append(row)
            return len(self.rows) - 1

        # those whose normal forces limit others come first
        for u in sorted(range(len(units.modes)), key=lambda u: units.parents[u] != u):
            mode, k, mu, parent = units.modes[u], 3 * u, float(units.friction[u]), int(units.parents[u])
            if mode == OPEN or (parent >= 0 and parent != u and parent not in places):
                continue
            if parent < 0:
                # the load that fills up its cone
                self.known[k + 2] = units.loads[u]
            if mode == SLIP and math.isinf(mu):
                # friction alone holds it: it carries no load
                self.slides, self.known[k : k + 2] = True, units.forces[u, :2]
                continue
            if parent == u:
                places[u] = add(k + 2)
            if mode == SLIP:
                self.slides = True
                speed = float(np.hypot(*units.velocities[u, :2]))
                if parent < 0:
                    self.known[k : k + 2] = units.forces[u, :2]
                elif mu > 0.0 and speed > 0.0:
                    columns[places[parent]][k : k + 2] -= mu / speed * units.velocities[u, :2]
                if parent == u:
                    lengths[places[u]] = math.hypot(1.0, mu)
                    self.cones.append(Cone(places[u]))
                continue
            tangents = [add(k + i) for i in range(2) if units.real[u, i]]
            if not math.isfinite(mu):
                # of ideal rolling: whatever forces
                tangents = []
            self.sticks = self.sticks or bool(tangents)
            if parent >= 0:
                self.cones.append(Cone(places[parent], mu if tangents else 1.0, 0.0, tuple(tangents)))
            elif tangents:
                self.cones.append(Cone(0, 0.0, mu * float(units.loads[u]), tuple(tangents)))
        self.expand = np.array(columns).T
        self.unit = scale[[row // 3 for row in self.rows]] / np.array(lengths)

    def solve(self, only: bool = False) -> bool:
        """Find the least forces of all; False where there are none, or they are the only ones and not asked for."""
        units, rows = self.units, self.rows
        alone = np.isinf(units.friction) & (units.modes == SLIP)
        if len(rows) <= 1 or alone.any():
            # what slides held up by friction alone has no load
            return False
        scale = self.unit
        wanted = -scale * (units.base + units.gram @ self.known)[rows]
        operator = scale[:, None] * (units.gram @ self.expand)[rows] * scale
        _, singular, right = np.linalg.svd(operator)
        rank = int(np.sum(singular > RANK_TOLERANCE * singular[0]))
        self.x = np.linalg.lstsq(operator, wanted, rcond=RANK_TOLERANCE)[0]
        self.null = right[rank:].T
        if self.null.shape[1] == 0 and not only:
            return False
        left = np.abs(operator @ self.x - wanted).max()
        return bool(left <= _LEFT * np.abs(units.base).max() * scale.max())

    def inside(self) -> bool:
        """Whether the least forces are inside all cones."""
        forces = self.unit * self.x
        return all(
            cone.factor * forces[cone.normal] + cone.offset >= np.linalg.norm(forces[list(cone.tangents)])
            for cone in self.cones
        )

    def central(self) -> np.ndarray | None:
        """(3n,) forces in the middle of what the cones admit, among all that the constraints leave open."""
        found = central_force(self.unit * self.x, self.unit[:, None] * self.null, self.cones)
        return None if found is None else self._whole(found.forces)

    def least(self) -> np.ndarray | None:
        """(3n,) the least forces of which no load is negative."""
        loads = [cone.normal for cone in self.cones if cone.factor > 0.0 and cone.offset == 0.0]
        x = least_of(self.x, self.null.T, np.isin(np.arange(self.x.size), loads))
        return None if x is None else self._whole(self.unit * x)

    def whole(self) -> np.ndarray:
        """(3n,) the least forces of all."""
        return self._whole(self.unit * self.x)

    def _whole(self, forces: np.ndarray) -> np.ndarray:
        return self.known + self.expand @ forces
