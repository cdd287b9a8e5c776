"""What a run writes down of every output, and how that is read back: rows of numbers, joined runs, loaded states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any

import numpy as np

from .contacts import Contact
from .dynamics.energy import energies_at
from .integration.discrete import discrete_part, read_discrete, write_discrete
from .integration.output_modes import OutputModes
from .integration.recording import BLOCK, INTEGERS_PER_CONTACT
from .integration.run_system import RunSystem
from .integration.slow_slip import frozen_directions, present_directions, set_frozen_directions
from .integration.steps import RECORD
from .layout import CONTACT_INTS, EVENT, FREE, FROZEN_COLUMNS
from .scene import Scene
from .state import State
from .system_cache import put_back, take_system
from .workspace import address_of


class Record:
    """Rows written during a run: what is needed to rebuild everything else.

    start: the state that the run starts from; steps_by: the contact solver of time stepping, None in other runs: the
    modes in the rows are then those of steps, see `OutputModes`.
    """

    def __init__(self, system: RunSystem, start: State, with_torques: bool, steps_by: str | None = None) -> None:
        self.system, self.with_torques, self.steps_by = system, with_torques, steps_by
        # works are counted from there on, whatever the outputs
        counts = system.sizes.nwork > 0
        self._total_at_start = np.array(sum(energies_at(system.model, start.q, start.v))) if counts else None
        nc = system.nc
        self._row = _row_of(system.nq, system.nv, nc, system.sizes.nwork, nc if system.nr else 0)
        system.counters.row_width = width = self._row.itemsize // 8
        if width not in system.row_blocks:
            reals = np.empty((BLOCK, width))
            whole = np.empty((BLOCK, max(nc, 1) * INTEGERS_PER_CONTACT), dtype=np.int64)
            named = (("recorded_reals", reals), ("recorded_integers", whole))
            system.row_blocks[width] = [(name, block, address_of(block)) for name, block in named]
        blocks = system.row_blocks[width]
        self._reals, self._integers = (system.put(*block) for block in blocks)
        self._blocks: list[tuple[np.ndarray, np.ndarray]] = []
        self._resistances: list[np.ndarray] = []

    def __len__(self) -> int:
        return sum(len(block[0]) for block in self._blocks) + self.system.counters.recorded

    def add(self, t: float, resistances: np.ndarray | None = None) -> None:
        """The state in the system at t; (nc, 3) torques that resist spinning and rolling, where there are any."""
        if resistances is not None:
            self._resistances.append(resistances.copy())
        self.flush()
        self.system.run(RECORD, t)

    def flush(self, always: bool = False) -> None:
        """Put a full block of rows aside; always: also one that is not full."""
        count = self.system.counters.recorded
        if count == BLOCK or (always and count):
            self._blocks.append((self._reals[:count].copy(), self._integers[:count].copy()))
            self.system.counters.recorded = 0

    def rows(self, scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, Callable[[], Recorded]]:
        """Times (n,), configurations (n, nq), velocities (n, nv), and what gives the rest of all rows of the scene."""
        self.flush(always=True)
        blocks = self._blocks or [(self._reals[:0].copy(), self._integers[:0].copy())]
        values, integers = blocks[0] if len(blocks) == 1 else (np.concatenate(parts) for parts in zip(*blocks))
        columns = values.view(self._row)[:, 0]
        t, q, v = (columns[name].copy() for name in ("t", "q", "v"))
        contacts = self.system.contacts
        swapped = [contact.swapped for contact in contacts]
        rest = partial(_unpack, columns, integers, swapped, self.with_torques, self._resistances, self._total_at_start)
        if self.steps_by is not None and contacts:
            works = self._row["works"].shape[0] > 0
            rest = partial(_with_output_modes, rest, scene, contacts, works, self.steps_by, t, q, v)
        return t, q, v, rest


@cache
def _row_of(nq: int, nv: int, nc: int, nwork: int, turning: int) -> np.dtype[np.void]:
    """A row of numbers as `record_row` writes it."""
    of_joints = [("t", float), ("q", float, (nq,)), ("v", float, (nv,)), ("torques", float, (nv,))]
    works = ("works", float, (nwork,))
    of_contacts = {"location": (nc, 4), "frozen": (nc, FROZEN_COLUMNS), "forces": (nc, 3)}
    shapes = {**of_contacts, "resistances": (turning, 3)}
    return np.dtype([*of_joints, works, *((name, float, shape) for name, shape in shapes.items())])


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a run keeps of every output besides t, q and v, to rebuild everything else from.

    location (n, nc, 4); discrete (n, nc, DISCRETE_COLUMNS), see `State`; directions (n, nc, 3) prescribed slip
    directions; works (n, NUMBER_OF_WORKS) in J; torques (n, nv) of the user and on joints; resistances (n, nc, 3)
    torques in N m on the second contours; total energy at the run's start in J; forces: output ->
    contact forces (nc, 3) in their bases, where contacts alone would have others. None for what was not recorded.
    """

    location: np.ndarray
    discrete: np.ndarray
    directions: np.ndarray
    works: np.ndarray | None
    torques: np.ndarray | None
    resistances: np.ndarray | None
    total_at_start: np.ndarray | None
    forces: dict[int, np.ndarray] = field(default_factory=dict)

    def arrays(self) -> dict[str, np.ndarray]:
        """Those that are there."""
        return {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}

    def rows(self, which: np.ndarray) -> Recorded:
        """These outputs, in this order."""
        chosen = {name: array[which] for name, array in self.arrays().items() if name in _PER_OUTPUT}
        forces = {new: self.forces[old] for new, old in enumerate(which.tolist()) if old in self.forces}
        return replace(self, **chosen, forces=forces)


_PER_OUTPUT = ("location", "discrete", "directions", "works", "torques", "resistances")


def _unpack(
    columns: np.ndarray,
    integers: np.ndarray,
    swapped: list[bool],
    with_torques: bool,
    of_steps: list[np.ndarray],
    total_at_start: np.ndarray | None,
) -> Recorded:
    """What rows (n,) of numbers and the contacts' integers hold.

    of_steps: torques that resist turning, (nc, 3) a row, where they are not in the rows.
    """
    n, nc = columns.size, len(swapped)
    whole = integers[:, : nc * INTEGERS_PER_CONTACT].reshape(n, nc, INTEGERS_PER_CONTACT)
    turning = np.array(of_steps) if of_steps else None
    if columns["resistances"].shape[1]:
        turning = np.where(swapped, -1.0, 1.0)[:, None] * columns["resistances"]
    forces = columns["forces"]
    return Recorded(
        columns["location"],
        discrete_part(whole[:, :, :CONTACT_INTS], whole[:, :, CONTACT_INTS:]),
        frozen_directions(whole, columns["frozen"], columns["t"]),
        columns["works"] if columns["works"].shape[1] else None,
        columns["torques"] if with_torques else None,
        turning,
        total_at_start,
        {int(i): forces[i] for i in np.flatnonzero(forces.any(axis=(1, 2)))},
    )


def _with_output_modes(
    unpack: Callable[[], Recorded],
    scene: Scene,
    contacts: list[Contact],
    works: bool,
    contact_solver: str,
    t: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
) -> Recorded:
    """What was recorded, with the modes that hold at the outputs in place of the steps' own."""
    recorded = replace(unpack(), forces={})
    closed = np.flatnonzero((recorded.discrete[:, :, 0] != FREE).any(axis=1)).tolist()
    if not closed:
        return recorded
    # the run's own system, if nothing has been added to the scene since
    cached = take_system(scene, works, resistances=False) if list(scene.contacts.values()) == contacts else None
    system = RunSystem(scene.model, contacts) if cached is None else cached.system
    modes = OutputModes(system, contact_solver)
    for i in closed:
        load_output(system, recorded, i, q[i], v[i])
        kept = system.contact_int.copy(), system.contact_real.copy()
        if modes.resolve(float(t[i])):
            recorded.discrete[i] = read_discrete(system)
            recorded.directions[i] = present_directions(system)
        if system.scalars.has_reference and system.evaluate(float(t[i])) <= EVENT:
            recorded.forces[i] = system.force[: system.nc].copy()
        system.contact_int[:], system.contact_real[:] = kept
    if cached is not None:
        put_back(scene, cached)
    return recorded


def joined(one: Recorded, kept: int, two: Recorded, first: int, works: np.ndarray | None) -> Recorded:
    """The first `kept` rows of one and those of the other from `first` on, whose works begin at `works` (J)."""

    def rows(name: str) -> np.ndarray | None:
        a, b = getattr(one, name), getattr(two, name)
        if a is None and b is None:
            return None
        shape = (b if a is None else a).shape[1:]
        a, b = (np.zeros((len(of.discrete), *shape)) if x is None else x for x, of in ((a, one), (b, two)))
        return np.concatenate([a[:kept], b[first:]])

    if two.works is not None:
        two = replace(two, works=None if works is None else two.works + works)
    both: dict[str, Any] = {name: rows(name) for name in _PER_OUTPUT if name != "works"}
    done = None if one.works is None or two.works is None else rows("works")
    forces = {i: x for i, x in one.forces.items() if i < kept}
    forces |= {kept + i - first: x for i, x in two.forces.items() if i >= first}
    return replace(one, **both, works=done, forces=forces)


def load_output(system: RunSystem, recorded: Recorded, i: int, q: np.ndarray, v: np.ndarray) -> None:
    """Put the state of one output into a system; a choice of redundant forces in it stays."""
    system.q[:], system.v[:] = q, v
    system.location[: system.nc] = recorded.location[i]
    write_discrete(system, recorded.discrete[i])
    set_frozen_directions(system, recorded.directions[i])
    if recorded.torques is not None:
        system.tau[:] = recorded.torques[i]
