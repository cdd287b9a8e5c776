"""The choice among redundant forces of an evaluation: inside all cones, or the least loads of what slides.

Forces of least norm are what evaluations find. Where these leave their cones, the central ones (`friction.centred`)
are taken, and evaluations follow these as loads change. Where everything slides, loads are what is chosen: the least
ones that are not negative.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import array_entry
from ..friction.centred import Choice, central_choice, null_space
from ..friction.choices import connected_groups
from ..geometry.patterns import ON_CURVE
from ..jit import INTEGER, REAL, SEVERAL, kernel
from ..layout import (
    ANISOTROPIC,
    EVENT,
    FREE,
    FRICTION_EVENT,
    FRICTIONLESS,
    HIGH_FORCE,
    JOINT_END,
    LOW_FORCE,
    MODE,
    MU,
    MU_STATIC,
    NORMAL_EVENT,
    NORMAL_SIGN,
    OK,
    OWNER,
    PATTERN,
    SCALING_11,
    SCALING_12,
    SCALING_22,
    SLIPPING,
    STICK,
    TANGENTS,
    UNILATERAL,
)
from .contact_modes import held_up_by_friction, shares_viscous_force
from .units import REDUNDANT, whiten

if TYPE_CHECKING:
    from .system import System


# Forces below this part of the loads on the joints are round-off.
_ROUND_OFF = 1e-11


# A load that has come to zero is there within this part of the largest force: loads of slow slip change as fast as it
# turns, and time has a round-off.
AT_ZERO = 1e-8
# Parts of the forces that are smaller move nothing.
_MOVES = 1e-6


def leaves_loads_open(system: System) -> bool:
    """Whether the motion depends on how redundant contacts share loads, in the last evaluation, and no rule decides it:
    of what acts on each other some slide while others stick, joints are held, or torques resist turning."""
    count = system.counters.row_count
    if count == system.counters.row_rank:
        return False
    modes, mu = system.contact_int[:, MODE].tolist(), system.contact_real[:, MU].tolist()
    if SLIPPING not in modes or not (STICK in modes or system.ng or system.nr):
        return False
    index = system.row_index[:count]
    for group in row_groups(system):
        items = {*index[group, 0].tolist()}
        turning = [i for i in system.resisting() if system.owner(i) in items]
        rubbing = [c for c in items if c < system.nc and mu[c] > 0.0]
        slides = any(modes[i] == SLIPPING and mu[i] > 0.0 for i in [*rubbing, *turning])
        held = turning or any(i >= system.nc for i in items) or any(modes[c] == STICK for c in rubbing)
        if slides and held:
            # projections change the order of whitened rows
            rows, directions = whiten(system, system.rows[tuple(index[group].T)].T).T, system.whitened_forces[group]
            _, singular, right = np.linalg.svd(rows @ directions.T)
            changes = right[singular <= REDUNDANT * singular[0]] @ directions
            if np.abs(changes).max(initial=0.0) > _MOVES * np.abs(directions).max():
                return True
    return False


def row_groups(system: System) -> list[np.ndarray]:
    """The constraint rows of the last evaluation, by places in `row_index`, in groups that act on each other. Of loads
    that redundant contacts share each group has its own."""
    count = system.counters.row_count
    if system.trees.shape[1] < 2:
        return [np.arange(count)]
    index = system.row_index[:count]
    trees = (system.rows[tuple(index.T)] != 0.0) @ system.trees
    owners = np.array([system.owner(i) for i in index[:, 0].tolist()])
    return connected_groups((trees @ trees.T > 0.0) | (owners[:, None] == owners))


def items_beside(system: System, c: int) -> set[int]:
    """Contact c, and the items whose constraint rows of the last evaluation act on its own."""
    items = system.row_index[: system.counters.row_count, 0]
    return {i for group in row_groups(system) if c in items[group] for i in items[group].tolist()}


class RedundantForces:
    """Chooses among redundant forces of a system, and lets evaluations know the choice.

    redistributions: how often forces were chosen; redundant: whether forces at the last attempt to were redundant.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.redistributions = 0
        self.redundant = False

    def redistribute(self, t: float, evaluate: Callable[[float], int], ended: int | None = None) -> bool:
        """Choose other ones among redundant forces, such that all lie inside their cones; False where none do.

        ended: the contact whose load has come to zero, or comes back from there. Needs the last evaluation, whose
        accelerations stay what they are where nothing slides.
        """
        system = self.system
        count = system.counters.row_count
        if count == system.counters.row_rank:
            # of independent rows there is one choice
            return False
        slips, others, sliding = self._slipping(), row_groups(system), set()
        if slips:
            items, normals = system.row_index[:count, 0], {*system.closed()}
            groups = [(group, items[group].tolist()) for group in others]
            # where there are normals alone, and something slips, there is no force but loads to choose
            alone = [of for _, of in groups if normals.issuperset(of) and len({*of}) == len(of)]
            sliding = {c for of in alone if not slips.isdisjoint(of) for c in of}
            others = [group for group, of in groups if not sliding.issuperset(of)]
        if not sliding:
            return bool(self._choose_centre(t, evaluate, others, slips))
        signs, before = system.contact_int[:, NORMAL_SIGN].copy(), self.reference()
        chosen_for = ended if ended in sliding or not others else None
        if not self._choose_least_loads(t, evaluate, sorted(sliding), chosen_for):
            return False
        # loads have been chosen, if nothing else
        if not others or self._choose_centre(t, evaluate, others, slips) is not False:
            return True
        system.contact_int[:, NORMAL_SIGN] = signs
        self.take_back(before)
        evaluate(t)
        return False

    def _slipping(self) -> set[int]:
        """Contacts that slip, or turn against a resistance."""
        system, modes = self.system, self.system.contact_int[:, MODE].tolist()
        if SLIPPING not in modes:
            return set()
        return {system.owner(i) for i in [*system.closed(), *system.resisting()] if modes[i] == SLIPPING}

    def _choose_centre(
        self, t: float, evaluate: Callable[[float], int], groups: list[np.ndarray], slips: set[int]
    ) -> bool | None:
        """Choose the central ones among redundant forces of these groups of rows: whether all lie inside their cones
        then; None where there is no choice. slips: see `_slipping`."""
        system, count = self.system, self.system.counters.row_count
        index, rows = system.row_index[:count].copy(), system.whitened_rows[:count]
        forces, items = system.force[index[:, 0], index[:, 1]], index[:, 0]
        parts, offsets = self._cones(index)
        choices: list[Choice] = []
        followed: list[np.ndarray] = []
        self.redundant = False
        for group in groups:
            # along what no joint moves there is no force
            moving = group[rows[group].any(axis=1)]
            slipping = not slips.isdisjoint(items[group].tolist())
            directions = (system.whitened_forces[:count] if slipping else rows)[moving]
            if not moving.size:
                continue
            if not np.isfinite(directions).all():
                return False
            for r, (c, row) in zip(group.tolist(), index[group].tolist()) if slipping else ():
                if row == 2 and c < system.nc and held_up_by_friction(system, c):
                    forces[r] = math.hypot(system.force[c, 0], system.force[c, 1])
            # in slip the constraints leave open what moves bodies, too, see `leaves_loads_open`: if that were kept,
            # forces would depend on the choices before
            null = null_space(directions @ rows[moving].T if slipping else directions)
            self.redundant = self.redundant or null.shape[1] > 0
            own: Any = slice(None)
            if len(group) < count:
                own = np.repeat(parts[:, group].reshape(offsets.size // 3, 3 * len(group)).any(axis=1), 3)
            cones = parts[own] if len(moving) == count else np.ascontiguousarray(parts[own][:, moving])
            choice = central_choice(forces[moving], null, cones, offsets[own])
            if choice is not None:
                choices.append(choice)
                followed.append(index[moving])
            elif null.shape[1]:
                return False
        if not choices:
            return None
        before = self.reference()
        self._follow(np.concatenate(followed), choices)
        # of all items, unless others have been chosen for already
        among = None if sum(map(len, groups)) == count else {i for group in groups for i in items[group].tolist()}
        if evaluate(t) <= EVENT and self._holds(among):
            self.redistributions += 1
            return True
        self.take_back(before)
        evaluate(t)
        return False

    def choose(self, t: float, evaluate: Callable[[float], int]) -> bool:
        """Choose redundant forces of the present modes as if there had been no others; whether all forces lie inside
        their cones."""
        self._load_all()
        self._take_reference(None)
        return self._lie_in_cones(evaluate(t), t, evaluate)

    def _lie_in_cones(self, status: int, t: float, evaluate: Callable[[float], int]) -> bool:
        """Whether all forces of the last evaluation, of that status, lie inside their cones, or other ones among
        redundant forces do."""
        # without an event every force does
        return status == OK or (status == EVENT and (self._holds() or self.redistribute(t, evaluate)))

    def _load_all(self) -> bool:
        """Let every closed contact carry a load; whether all did."""
        integers = self.system.contact_int
        without = [c for c in self.system.closed() if integers[c, UNILATERAL] and integers[c, NORMAL_SIGN] != 1]
        for c in without:
            self.load(c)
        return not without

    def load(self, c: int) -> None:
        """Let closed contact c carry a load."""
        system = self.system
        if shares_viscous_force(system, c) and system.contact_real[c, MU] == 0.0:
            system.contact_int[c, MODE] = FRICTIONLESS
        system.contact_int[c, NORMAL_SIGN] = 1

    def _choose_least_loads(
        self, t: float, evaluate: Callable[[float], int], closed: list[int], ended: int | None
    ) -> bool:
        """Give the loads of these contacts, which slide, the least values that are not negative; False where contacts
        open instead.

        A contact that is to carry nothing stays closed by itself, as do four feet on a plane that stand on three. Loads
        then are continuous in time; those without it enter again where the least ones ask for them.
        ended: see `redistribute`.
        """
        system = self.system
        integers = system.contact_int
        before, reference = integers[:, NORMAL_SIGN].copy(), self.reference()
        closed = [c for c in closed if not shares_viscous_force(system, c)]
        if ended is not None and ended not in closed:
            return False
        seen = set()
        at_zero = max(self.force_round_off(), AT_ZERO * float(np.abs(system.force).max()))
        least = {c: -at_zero if c == ended else -self.force_round_off() for c in closed}
        self._take_reference(None)
        if ended is not None:
            integers[ended, NORMAL_SIGN] = 1 - integers[ended, NORMAL_SIGN]
        status = evaluate(t)
        while status <= EVENT:
            below = {c: float(system.event_functions[c, NORMAL_EVENT]) - least[c] for c in closed}
            worst = min(closed, key=lambda c: below[c], default=None)
            if worst is None or below[worst] >= 0.0:
                if ended is not None and integers[ended, NORMAL_SIGN] == before[ended]:
                    break
                self.redistributions += 1
                return True
            state = integers[closed, NORMAL_SIGN].tobytes(), worst
            if state in seen:
                break
            seen.add(state)
            # a bilateral one has a load of the other sign
            integers[worst, NORMAL_SIGN] = integers[worst, UNILATERAL] - integers[worst, NORMAL_SIGN]
            status = evaluate(t)
        integers[:, NORMAL_SIGN] = before
        self.take_back(reference)
        evaluate(t)
        return False

    def _follow(self, index: np.ndarray, choices: list[Choice]) -> None:
        """Take the choices for the reference, and let that move as they will. index (count, 2): the rows of all."""
        system = self.system
        forces = np.concatenate([choice.forces for choice in choices])
        slope, span = np.zeros((2, sum(choice.span.shape[1] for choice in choices), forces.size))
        row = column = 0
        for choice in choices:
            n, rank = choice.span.shape
            slope[row : row + rank, column : column + n] = choice.slope.T
            span[row : row + rank, column : column + n] = choice.span.T
            row, column = row + rank, column + n
        put_choice(index, forces, slope, span, system.reference_start, system.reference_slope)
        system.scalars.has_reference = 1.0

    def _take_reference(self, reference: np.ndarray | None) -> None:
        """Choose redundant forces nearest to these (nc + ng + nr, 3), or None: nearest to zero."""
        system = self.system
        system.scalars.has_reference = 0.0 if reference is None else 1.0
        if reference is not None:
            system.reference[:] = system.reference_start[:] = reference
            system.reference_slope[:] = 0.0

    def reference(self) -> tuple[float, list[np.ndarray]]:
        """The choice that evaluations follow, see `take_back`."""
        system = self.system
        arrays = (system.reference, system.reference_start, system.reference_slope)
        return system.scalars.has_reference, [array.copy() for array in arrays]

    def take_back(self, reference: tuple[float, list[np.ndarray]]) -> None:
        system = self.system
        system.scalars.has_reference = reference[0]
        for array, values in zip((system.reference, system.reference_start, system.reference_slope), reference[1]):
            array[:] = values

    def _cones(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The cones of the forces in these constraint rows (count, 2) of items and their bases, as `central_choice`
        takes them."""
        system = self.system
        most = system.nc + system.nr + 2 * system.ng
        parts, offsets = np.zeros((3 * most, len(index))), np.zeros(3 * most)
        contacts, joints = (system.contact_int, system.contact_real), (system.joint_int, system.joint_real)
        count = put_cones(*contacts, *joints, system.force, index, system.nc, system.ng, parts, offsets)
        return parts[: 3 * count], offsets[: 3 * count]

    def _holds(self, among: set[int] | None = None) -> bool:
        """Whether every force of the last evaluation lies inside its cone; among: of which items, with what resists
        their turning, where not of all."""
        system = self.system
        active = [*system.closed(), *(system.nc + g for g in system.held()), *system.resisting()]
        if among is not None:
            active = [i for i in active if not among.isdisjoint((i, system.owner(i)))]
        event_functions = system.event_functions.tolist()
        return all(
            event_functions[i][NORMAL_EVENT] >= 0.0 and event_functions[i][FRICTION_EVENT] >= 0.0 for i in active
        )

    def force_round_off(self) -> float:
        """Forces in N (or N m) below which a sign means nothing."""
        return _ROUND_OFF * self.largest_load()

    def largest_load(self) -> float:
        """The largest load on a joint, in N or N m, without constraints."""
        loads = zip(self.system.bias_forces.tolist(), self.system.tau.tolist())
        return max((abs(bias) + abs(torque) for bias, torque in loads), default=0.0)


_REALS, _INTEGERS = REAL[:, ::1], INTEGER[:, ::1]


@array_entry(_INTEGERS, REAL[::1], _REALS, _REALS, _REALS, REAL[:, :, ::1], when=SEVERAL)
def put_choice(index, forces, slope, span, start, slopes):
    """The forces of a choice in the rows index (count, 2) become the reference, and let that move as the choice will;
    slope, span (rank, count)."""
    for i in range(start.shape[0]):
        for row in range(3):
            start[i, row] = 0.0
            for k in range(slopes.shape[2]):
                slopes[0, 3 * i + row, k] = slopes[1, 3 * i + row, k] = 0.0
    for r in range(index.shape[0]):
        place = 3 * index[r, 0] + index[r, 1]
        start[index[r, 0], index[r, 1]] = forces[r]
        # what forces change by along the span, the choice changes by, and by its tangent
        for k in range(span.shape[0]):
            slopes[0, place, k], slopes[1, place, k] = span[k, r], span[k, r] + slope[k, r]


@array_entry(*(_INTEGERS, _REALS) * 2, _REALS, _INTEGERS, INTEGER, INTEGER, _REALS, REAL[::1], when=SEVERAL)
def put_cones(contact_int, contact_real, joint_int, joint_real, force, index, nc, ng, parts, offsets):
    """The cones of the forces in the constraint rows index (count, 2), see `RedundantForces._cones`, into parts and
    offsets, which are zero; how many."""
    m, first = 0, nc + ng
    for i in range(force.shape[0]):
        owner = contact_int[i, OWNER] if i >= first else i
        contact, mode, mu = contact_int[i], contact_int[i, MODE], contact_real[i, MU_STATIC]
        if (nc <= i < first) or contact_int[owner, MODE] == FREE or (i >= first and mode != STICK):
            continue
        tangents = contact[TANGENTS] if mode == STICK and mu < math.inf else 0
        if contact_int[owner, UNILATERAL] == 0:
            # its friction goes with the load of either sign
            if tangents == 0 or (i < nc and contact[PATTERN] == ON_CURVE):
                continue
            mu = math.copysign(mu, force[owner, 2])
        parts[3 * m, _place(index, owner, 2)] = mu if tangents > 0 else 1.0
        for row in range(tangents):
            put_tangent(contact, contact_real[i], row, _place(index, i, row), parts[3 * m + 1 : 3 * m + 3])
        m += 1
    for g in range(ng):
        end = joint_int[g, JOINT_END]
        low, high = joint_real[g, LOW_FORCE], joint_real[g, HIGH_FORCE]
        for sign, size, bounded in ((1.0, -low, end <= 0), (-1.0, high, end >= 0)):
            if contact_int[nc + g, MODE] != FREE and bounded and size < math.inf:
                parts[3 * m, _place(index, nc + g, 2)], offsets[3 * m] = sign, size
                m += 1
    return m


@kernel
def put_tangent(contact, number, row, place, parts):
    """A tangential force in its cone: friction that is not the same along all axes is stretched to a round one."""
    parts[row, place] = 1.0
    if contact[ANISOTROPIC] != 0:
        a, b, d = number[SCALING_11], number[SCALING_12], number[SCALING_22]
        first, second = (d, -b) if row == 0 else (-b, a)
        parts[0, place], parts[1, place] = first / (a * d - b * b), second / (a * d - b * b)


@kernel
def _place(index, item, row):
    """The constraint row that is a row of an item's basis."""
    r, last = 0, index.shape[0] - 1
    while r < last and (index[r, 0] != item or index[r, 1] != row):
        r += 1
    return r
