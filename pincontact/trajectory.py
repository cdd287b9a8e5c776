"""Results of a run: states, contact tracks, events, counts; stored and read back."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin

from .contacts import Contact, characteristic_length
from .dynamics.energy import energies_at
from .errors import TrajectoryError
from .geometry.frames import contact_frame, dual_basis
from .integration.output_modes import OutputModes
from .integration.recording import BLOCK, INTEGERS_PER_CONTACT
from .integration.results import Event
from .integration.run_system import RunSystem
from .integration.slow_slip import frozen_directions, present_directions, set_frozen_directions
from .integration.steps import RECORD
from .layout import (
    CHART,
    CONDITION,
    CONTACT_INTS,
    EVENT,
    FREE,
    FROZEN_COLUMNS,
    STICK,
)
from .scene import Scene
from .state import Correction, State, discrete_part, read_discrete, write_discrete
from .system_cache import put_back, take_system
from .workspace import address_of

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

_FORMAT = 1
# Outputs whose contacts are evaluated before they are put together: some MB.
_CHUNK = 1024
# Of two runs in a row these counts are the larger one, others their sum.
_LARGEST_STATS = ("cone_residual", "wall_time")


class Record:
    """Rows written during a run: what is needed to rebuild everything else.

    start: the state that the run starts from; by_steps: the modes in the rows are those of steps of a constant size,
    see `OutputModes`.
    """

    def __init__(self, system: RunSystem, start: State, with_torques: bool, by_steps: bool = False) -> None:
        self.system, self.with_torques, self.by_steps = system, with_torques, by_steps
        # works are counted from there on, whatever the outputs
        counts = system.sizes["nwork"] > 0
        self._total_at_start = np.array(sum(energies_at(system.model, start.q, start.v))) if counts else None
        nq, nv, nc = system.nq, system.nv, system.nc
        # t, q, v, tau, works, location, frozen directions' columns, redundant forces chosen, resistances to turning
        turns = 3 * nc if system.nr else 0
        self._widths = (1, nq, nv, nv, int(system.sizes["nwork"]), 4 * nc, FROZEN_COLUMNS * nc, 3 * nc, turns)
        system.counters["row_width"] = width = sum(self._widths)
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
        return sum(len(block[0]) for block in self._blocks) + int(self.system.counters["recorded"])

    def add(self, t: float, resistances: np.ndarray | None = None) -> None:
        """The state in the system at t; (nc, 3) torques that resist spinning and rolling, where there are any."""
        if resistances is not None:
            self._resistances.append(resistances.copy())
        self.flush()
        self.system.run(RECORD, t)

    def flush(self, always: bool = False) -> None:
        """Put a full block of rows aside; always: also one that is not full."""
        count = int(self.system.counters["recorded"])
        if count == BLOCK or (always and count):
            self._blocks.append((self._reals[:count].copy(), self._integers[:count].copy()))
            self.system.counters["recorded"] = 0

    def rows(self, scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, Callable[[], Recorded]]:
        """Times (n,), configurations (n, nq), velocities (n, nv), and what gives the rest of all rows of the scene."""
        self.flush(always=True)
        blocks = self._blocks or [(self._reals[:0].copy(), self._integers[:0].copy())]
        values, integers = blocks[0] if len(blocks) == 1 else (np.concatenate(parts) for parts in zip(*blocks))
        system, at = self.system, 1 + self._widths[1]
        swapped = [contact.swapped for contact in system.contacts]
        t, q, v = values[:, 0].copy(), values[:, 1:at].copy(), values[:, at : at + self._widths[2]].copy()
        rest = partial(
            _unpack,
            values,
            integers,
            self._widths,
            swapped,
            self.with_torques,
            self._resistances,
            self._total_at_start,
        )
        if self.by_steps and system.nc:
            rest = partial(_with_output_modes, rest, scene, system.contacts, self._widths[4] > 0, t, q, v)
        return t, q, v, rest


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a run keeps of every output besides t, q and v, to rebuild everything else from.

    location (n, nc, 4); discrete (n, nc, DISCRETE_COLUMNS), see `State`; directions (n, nc, 3) prescribed slip
    directions; works (n, NUMBER_OF_WORKS) and total energy at the run's start in J; torques (n, nv) of the user and on
    joints; resistances (n, nc, 3) torques in N m on the second contours; references: output -> redundant forces chosen
    there (nc, 3). None for what was not recorded.
    """

    location: np.ndarray
    discrete: np.ndarray
    directions: np.ndarray
    works: np.ndarray | None
    total_at_start: np.ndarray | None
    torques: np.ndarray | None
    resistances: np.ndarray | None
    references: dict[int, np.ndarray] = field(default_factory=dict)


def _unpack(
    values: np.ndarray,
    integers: np.ndarray,
    widths: tuple[int, ...],
    swapped: list[bool],
    with_torques: bool,
    of_steps: list[np.ndarray],
    total_at_start: np.ndarray | None,
) -> Recorded:
    """The columns of rows `values` (n, sum of widths) and of the contacts' integers.

    of_steps: torques that resist turning, (nc, 3) a row, where they are not in the rows.
    """
    n, nc = len(values), len(swapped)
    ends = np.cumsum(widths)
    t = values[:, 0]
    parts = [values[:, end - width : end].copy() for width, end in zip(widths[3:], ends[3:])]
    torques, works, location, frozen, references, resistances = parts
    whole = integers[:, : nc * INTEGERS_PER_CONTACT].reshape(n, nc, INTEGERS_PER_CONTACT)
    if of_steps:
        resistances = np.array(of_steps)
    elif widths[-1]:
        orientation = np.array([-1.0 if second_first else 1.0 for second_first in swapped])
        resistances = orientation[:, None] * resistances.reshape(n, nc, 3)
    references = references.reshape(n, nc, 3)
    return Recorded(
        location.reshape(n, nc, 4),
        discrete_part(whole[:, :, :CONTACT_INTS], whole[:, :, CONTACT_INTS:]),
        frozen_directions(whole, frozen.reshape(n, nc, FROZEN_COLUMNS), t),
        works if works.shape[1] else None,
        total_at_start,
        torques if with_torques else None,
        resistances if resistances.shape[1] else None,
        {int(i): references[i] for i in np.flatnonzero(references.any(axis=(1, 2)))},
    )


def _with_output_modes(
    unpack: Callable[[], Recorded],
    scene: Scene,
    contacts: list[Contact],
    works: bool,
    t: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
) -> Recorded:
    """What was recorded, with the modes that hold at the outputs in place of the steps' own."""
    recorded = unpack()
    resting = np.flatnonzero((recorded.discrete[:, :, 0] == STICK).any(axis=1)).tolist()
    if not resting:
        return recorded
    # the run's own system, if nothing has been added to the scene since
    cached = take_system(scene, works, resistances=False) if list(scene.contacts.values()) == contacts else None
    system = RunSystem(scene.model, contacts) if cached is None else cached.system
    modes = OutputModes(system)
    for i in resting:
        _load_output(system, recorded, i, q[i], v[i])
        with modes.at(float(t[i])) as others:
            if others:
                recorded.discrete[i] = read_discrete(system)
                recorded.directions[i] = present_directions(system)
            if system.scalars["has_reference"]:
                recorded.references[i] = system.reference[: system.nc].copy()
    if cached is not None:
        put_back(scene, cached)
    return recorded


def _joined(one: Recorded, kept: int, two: Recorded, first: int, works: np.ndarray | None) -> Recorded:
    """The first `kept` rows of one and those of the other from `first` on, whose works begin at `works` (J)."""

    def rows(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.concatenate([a[:kept], b[first:]])

    def present(a: np.ndarray | None, b: np.ndarray | None) -> np.ndarray | None:
        if a is None or b is None:
            given = a if a is not None else b
            if given is None:
                return None
            a, b = (x if x is not None else np.zeros((n, *given.shape[1:])) for x, n in zip((a, b), counts))
        return rows(a, b)

    counts = len(one.discrete), len(two.discrete)
    references = {i: x for i, x in one.references.items() if i < kept}
    references |= {kept + i - first: x for i, x in two.references.items() if i >= first}
    done = None if works is None or one.works is None or two.works is None else rows(one.works, two.works + works)
    return Recorded(
        rows(one.location, two.location),
        rows(one.discrete, two.discrete),
        rows(one.directions, two.directions),
        done,
        one.total_at_start,
        present(one.torques, two.torques),
        present(one.resistances, two.resistances),
        references,
    )


def _load_output(system: RunSystem, recorded: Recorded, i: int, q: np.ndarray, v: np.ndarray) -> None:
    """Put the state of one output into a system; a choice of redundant forces in it stays."""
    system.q[:], system.v[:] = q, v
    system.location[: system.nc] = recorded.location[i]
    write_discrete(system, recorded.discrete[i])
    set_frozen_directions(system, recorded.directions[i])
    if recorded.torques is not None:
        system.tau[:] = recorded.torques[i]


@dataclass(frozen=True, eq=False)
class ContactTrack:
    """One contact over time, a row per output; world axes, SI units.

    location:        (n, k) location parameters p* = (u_1, u_2) in the paper's order (k2 >= k1); while open, like
                     point and frame, of the nearest points
    location_first, location_second: the same by the user's contours; charts (n, 2) of (body 1, body 2)
    point:           (n, 3) contact point
    frame:           (n, 3, 3) e_1, e_2, e_3 of Definition 5 as columns
    dual_frame:      (n, 3, 3) m^1, m^2, m^3 as columns (Eq. 26)
    force:           (n, 3) on the second contour named by the user
    multipliers:     (n, 3) components of that force in the dual frame, F_j = e_j . F (Prop. 6)
    normal_force, tangential_force: (n,) in N; the normal one is positive in compression (a length for a point on a
                     spatial curve)
    torque:          (n, 3) what resists spinning and rolling, on the second contour, N m; by time stepping its mean
                     over the last step
    slip_velocity:   (n, 3) v_c, of the second contour's material point against the first's
    mode:            (n,) -1 open, 0 frictionless, 1 stick, 2 slip
    gap:             (n,) in m, positive when apart
    conditioning:    (n,) of the location equations, 1 good, 0 singular
    """

    location: np.ndarray
    location_first: np.ndarray
    location_second: np.ndarray
    charts: np.ndarray
    point: np.ndarray
    frame: np.ndarray
    dual_frame: np.ndarray
    force: np.ndarray
    multipliers: np.ndarray
    normal_force: np.ndarray
    tangential_force: np.ndarray
    torque: np.ndarray
    slip_velocity: np.ndarray
    mode: np.ndarray
    gap: np.ndarray
    conditioning: np.ndarray


@dataclass(frozen=True, eq=False)
class Energies:
    """Energies in J, (n,) each; works are None unless the run recorded them.

    kinetic is with the rotors' (armature). friction_work is that of contact forces on v_c, and of their impulses in
    impacts; damping_work that of joints' damping, dry friction and limits. total = kinetic + potential.
    Works are counted from the state that the run started from, whether that is an output or not, and with what impacts
    took out of it there; so is the balance: total - total_at_start - all works, what the integration lost or won.
    """

    kinetic: np.ndarray
    potential: np.ndarray
    friction_work: np.ndarray | None = None
    drive_work: np.ndarray | None = None
    torque_work: np.ndarray | None = None
    damping_work: np.ndarray | None = None
    total_at_start: float | None = None

    @property
    def total(self) -> np.ndarray:
        return self.kinetic + self.potential

    @property
    def balance(self) -> np.ndarray:
        works = (self.friction_work, self.drive_work, self.torque_work, self.damping_work)
        if self.total_at_start is None or any(w is None for w in works):
            raise TrajectoryError("the run did not record works: simulate(..., energies=True)")
        return self.total - self.total_at_start - sum(w for w in works if w is not None)


class _Tracks(Mapping[str, ContactTrack]):
    """Contact tracks by name, computed when first asked for."""

    def __init__(self, run: Trajectory) -> None:
        self._run = run

    def __getitem__(self, name: str) -> ContactTrack:
        tracks = self._run._all_tracks()
        if name not in tracks:
            raise TrajectoryError(f"unknown contact {name!r}; contacts: {', '.join(tracks) or 'none'}")
        return tracks[name]

    def __iter__(self) -> Iterator[str]:
        # a run that was read from a file has tracks, and perhaps no scene
        return iter(self._run.scene.contacts if self._run._tracks is None else self._run._tracks)

    def __len__(self) -> int:
        return sum(1 for _ in self)


class Trajectory:
    """What `simulate` returns.

    t (n,), q (n, nq), v (n, nv); status: 0 finished, 1 a terminal event, negative: could not go on (message says
    why); events: list of Event; stats: counts and wall time in s; contacts: name -> ContactTrack.
    """

    def __init__(
        self,
        scene: Scene,
        t: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        recorded: Callable[[], Recorded],
        events: list[Event],
        status: int,
        message: str,
        stats: dict[str, Any],
    ) -> None:
        self.scene = scene
        self.t, self.q, self.v = t, q, v
        self.status, self.message, self.events, self.stats = status, message, events, stats
        self._unpack: Callable[[], Recorded] | None = recorded
        self._tracks: dict[str, ContactTrack] | None = None
        self._residuals: dict[str, dict[str, np.ndarray]] = {}
        self.contacts: Mapping[str, ContactTrack] = _Tracks(self)

    @classmethod
    def from_record(
        cls, scene: Scene, record: Record, events: list[Event], status: int, message: str, stats: dict[str, Any]
    ) -> Trajectory:
        """From the rows of a run, however many there are."""
        return cls(scene, *record.rows(scene), events, status, message, stats)

    def followed_by(self, rest: Trajectory, t: float, event: Event, works: np.ndarray | None) -> Trajectory:
        """This run up to t (s) and, from its state there on, another one of the scene, as one, which ends as that does.

        event: says where; works (NUMBER_OF_WORKS,): J up to there, None where they are not recorded.
        """
        kept = int(np.searchsorted(self.t, t, side="right"))
        # where both have that state it is the end of the first
        first = 1 if kept and rest.t.size and self.t[kept - 1] == rest.t[0] else 0
        stats = dict(self.stats)
        for key, value in rest.stats.items():
            if key in _LARGEST_STATS:
                stats[key] = max(value, stats.get(key, 0.0))
            elif isinstance(value, int):
                stats[key] = value + stats.get(key, 0)
            else:
                stats[key] = value
        stats["outputs"] = kept + rest.t.size - first
        return Trajectory(
            self.scene,
            np.concatenate([self.t[:kept], rest.t[first:]]),
            np.concatenate([self.q[:kept], rest.q[first:]]),
            np.concatenate([self.v[:kept], rest.v[first:]]),
            lambda: _joined(self._recorded, kept, rest._recorded, first, works),
            [*(e for e in self.events if e.time <= t), event, *rest.events],
            rest.status,
            f"{rest.message}; by time stepping from t = {t:.9g} s on, since at {self.message}",
            stats,
        )

    @property
    def _recorded(self) -> Recorded:
        """Unpacked when first asked for: a run that only goes on needs none of it."""
        unpack, parts = self._unpack, self.__dict__
        if unpack is not None:
            # threads that ask at the same time get what the first of them has found
            parts.setdefault("_found", unpack())
            # and with it go the rows as they were written
            self._unpack = None
        return parts["_found"]  # type: ignore[no-any-return]

    @property
    def success(self) -> bool:
        """Whether the run reached its end or a terminal event."""
        return self.status >= 0

    def __repr__(self) -> str:
        return f"<Trajectory of {self.t.size} outputs, {len(self.events)} events, status {self.status}: {self.message}>"

    def state(self, index: int = -1) -> State:
        """The state of one output, to start another run from."""
        return State(
            self.scene,
            self.q[index].copy(),
            self.v[index].copy(),
            float(self.t[index]),
            self._recorded.location[index].copy(),
            self._recorded.discrete[index].copy(),
            Correction({}, {}, 0.0, 0.0),
        )

    # ------------------------------------------------------------------ contacts

    def external_forces(self, index: int = -1) -> pin.StdVec_Force:
        """The contacts' forces at one output as Pinocchio's external forces, one a joint, in the joint's frame.

        `pin.aba(model, data, run.q[i], run.v[i], tau - damping * v, run.external_forces(i))` gives the run's
        accelerations.
        """
        from .analysis.forces import joint_forces

        model = self._model()
        data = model.createData()
        pin.forwardKinematics(model, data, self.q[index])
        tracks = {name: self.contacts[name] for name in self.scene.contacts}
        points = {name: np.nan_to_num(track.point[index]) for name, track in tracks.items()}
        forces = {name: track.force[index] for name, track in tracks.items()}
        torques = {name: track.torque[index] for name, track in tracks.items()}
        return joint_forces(model, data, self.scene.contacts.values(), points, forces, torques)

    def _model(self) -> pin.Model:
        """The scene's model. Raises TrajectoryError where a bare scene stands in for it (see `load`)."""
        model = self.scene.model
        if self.q.shape[1] != model.nq:
            raise TrajectoryError(
                f"the run has configurations of {self.q.shape[1]} numbers and its scene's model needs {model.nq}; a "
                "run read from a file has to be given its scene: Trajectory.load(path, scene)"
            )
        return model

    def _all_tracks(self) -> dict[str, ContactTrack]:
        if self._tracks is None:
            self._tracks, self._residuals = _evaluate_tracks(self)
        return self._tracks

    def residuals(self) -> dict[str, np.ndarray]:
        """Worst constraint residual of all closed contacts at every output, (n,) each, without units.

        C1: |r_2 - r_1| and GC: the gap, relative to the contact's length; C2: e_3 . tangents of body 1; VC: constrained
        components of v_c relative to the speeds.
        """
        self._all_tracks()
        n = self.t.size
        return {
            kind: np.max([r[kind] for r in self._residuals.values()], axis=0) if self._residuals else np.zeros(n)
            for kind in ("C1", "C2", "GC", "VC")
        }

    # ------------------------------------------------------------------ energies

    def energies(self) -> Energies:
        """Kinetic and potential energy at every output; works where the run recorded them (energies=True)."""
        model, recorded = self._model(), self._recorded
        data = model.createData()
        found = np.array([energies_at(model, q, v, data) for q, v in zip(self.q, self.v)]).reshape(-1, 2)
        kinetic, potential = found.T
        if recorded.works is None:
            return Energies(kinetic, potential)
        friction, drives, torques, damping = recorded.works.T
        start = recorded.total_at_start
        if start is None and len(found):
            # files that are older than this number: from the first output on
            start = found[0].sum() - recorded.works[0].sum()
        return Energies(kinetic, potential, friction, drives, torques, damping, None if start is None else float(start))

    # ------------------------------------------------------------------ files

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything, contact tracks included, to an npz file. The scene itself is not stored."""
        tracks, recorded = self._all_tracks(), self._recorded
        arrays: dict[str, np.ndarray] = {
            "t": self.t,
            "q": self.q,
            "v": self.v,
            "location": recorded.location,
            "discrete": recorded.discrete,
            "directions": recorded.directions,
        }
        optional = {key: getattr(recorded, key) for key in ("works", "total_at_start", "torques", "resistances")}
        arrays |= {key: value for key, value in optional.items() if value is not None}
        # not the scene's names: a run that was read without its scene has its tracks all the same
        for i, name in enumerate(tracks):
            for key, value in vars(tracks[name]).items():
                arrays[f"track{i}.{key}"] = value
            for key, value in self._residuals[name].items():
                arrays[f"residual{i}.{key}"] = value
        arrays["event_q"] = np.array([e.q for e in self.events]).reshape(len(self.events), self.q.shape[1])
        arrays["event_v"] = np.array([e.v for e in self.events]).reshape(len(self.events), self.v.shape[1])
        header = {
            "format": _FORMAT,
            "status": self.status,
            "message": self.message,
            "stats": self.stats,
            "contacts": list(tracks),
            "events": [[e.time, e.contact, e.kind, e.index, e.joint] for e in self.events],
        }
        # a number would be a file that is open already
        with open(os.fspath(path), "wb") as file:
            np.savez_compressed(file, header=np.array(json.dumps(header)), **arrays)  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: str | os.PathLike[str], scene: Scene | None = None) -> Trajectory:
        """Read a file of `save`.

        scene: the scene that was simulated, for replay and further runs; without it a bare one stands in, and the
        stored arrays are all there is.
        Raises TrajectoryError for a file that is missing or not a stored trajectory.
        """
        if scene is not None and not isinstance(scene, Scene):
            raise TrajectoryError(f"the scene must be a Scene, got {type(scene).__name__}")
        try:
            with np.load(path, allow_pickle=False) as file:
                header = json.loads(str(file["header"]))
                arrays = {key: file[key] for key in file.files if key != "header"}
            if header["format"] != _FORMAT:
                raise TrajectoryError(f"{os.fspath(path)}: format {header['format']} is not {_FORMAT}")
            names = header["contacts"]
            events = [
                Event(time, contact, kind, q, v, index, *joint)
                for (time, contact, kind, index, *joint), q, v in zip(
                    header["events"], arrays["event_q"], arrays["event_v"]
                )
            ]
            run = cls(
                scene if scene is not None else Scene(pin.Model()),
                arrays["t"],
                arrays["q"],
                arrays["v"],
                partial(
                    Recorded,
                    *(arrays[key] for key in ("location", "discrete", "directions")),
                    *(arrays.get(key) for key in ("works", "total_at_start", "torques", "resistances")),
                ),
                events,
                header["status"],
                header["message"],
                header["stats"],
            )
            run._tracks = {name: ContactTrack(**_part(arrays, f"track{i}.")) for i, name in enumerate(names)}
            run._residuals = {name: _part(arrays, f"residual{i}.") for i, name in enumerate(names)}
        except (OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile, zlib.error) as error:
            raise TrajectoryError(f"{os.fspath(path)} is not a stored trajectory: {error}") from error
        if scene is not None and list(scene.contacts) != names:
            raise TrajectoryError(f"the scene's contacts {list(scene.contacts)} are not those stored, {names}")
        return run

    # ------------------------------------------------------------------ tables

    def to_xarray(self) -> xarray.Dataset:
        """An xarray Dataset over t: q, v, energies, and everything of the contact tracks over a dimension `contact`.

        Raises MissingExtraError without xarray (the extra `data`).
        """
        from .tables import run_to_xarray

        return run_to_xarray(self)

    def to_pandas(self) -> pandas.DataFrame:
        """A DataFrame with a row for each output, its index t: columns such as q.knee, v.root_joint[3],
        rim/floor.force.z and rim/floor.mode (frames are left to `to_xarray`).

        Raises MissingExtraError without pandas (the extra `data`).
        """
        from .tables import run_to_pandas

        return run_to_pandas(self)

    # ------------------------------------------------------------------ views

    def plot(self, **options: Any) -> Figure:
        """Figures of the run (needs the extra `plot`); see `pincontact.view.plots.plot`."""
        from .view.plots import plot

        return plot(self, **options)


def _part(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {key[len(prefix) :]: value for key, value in arrays.items() if key.startswith(prefix)}


def _evaluate_tracks(run: Trajectory) -> tuple[dict[str, ContactTrack], dict[str, dict[str, np.ndarray]]]:
    """Evaluate the contacts again at every output: the run itself keeps only what it cannot do without."""
    contacts = list(run.scene.contacts.values())
    system = RunSystem(run.scene.model, contacts)
    n, resistances = run.t.size, run._recorded.resistances
    tracks = {c.name: _empty_track(c, n) for c in contacts}
    residuals = {c.name: {kind: np.zeros(n) for kind in ("C1", "C2", "GC", "VC")} for c in contacts}
    for start in range(0, n if contacts else 0, _CHUNK):
        outputs = _evaluate_outputs(system, run, range(start, min(start + _CHUNK, n)))
        for c, contact in enumerate(contacts):
            _fill_track(outputs, c, contact, tracks[contact.name])
            if resistances is not None:
                tracks[contact.name].torque[outputs.rows] = resistances[outputs.rows, c]
            _fill_residuals(outputs, c, contact, residuals[contact.name])
    return tracks, residuals


class _Outputs(NamedTuple):
    """What evaluations at m outputs leave of the contacts, in the arrays of `RunSystem`, a row for each.

    rows (m,): which outputs they are; shapes (m, 2 nc, 3, 3): points and first derivatives, in world axes; frames (m,
    2 nc, 5, 3): rotation, place and velocity of what carries them; the rest (m, nc, ...), of sides (m, 2 nc).
    """

    rows: np.ndarray
    location: np.ndarray
    shapes: np.ndarray
    frames: np.ndarray
    basis: np.ndarray
    slip: np.ndarray
    gaps: np.ndarray
    force: np.ndarray
    modes: np.ndarray
    conditioning: np.ndarray
    charts: np.ndarray


def _evaluate_outputs(system: RunSystem, run: Trajectory, wanted: range) -> _Outputs:
    """Of the wanted outputs, those that can be evaluated."""
    nc, recorded = system.nc, run._recorded
    views = (
        system.location[:nc],
        system.derivatives[: 2 * nc, :3],
        system.frames[: 2 * nc, :5],
        system.basis[:nc],
        system.slip[:nc],
        system.gaps[:nc],
        system.force[:nc],
        system.modes,
        system.contact_real[:nc, CONDITION],
        system.side_int[: 2 * nc, CHART],
    )
    values = [np.empty((len(wanted), *view.shape), view.dtype) for view in views]
    rows: list[int] = []
    for i in wanted:
        _load_output(system, recorded, i, run.q[i], run.v[i])
        system.scalars["has_reference"] = float(i in recorded.references)
        system.reference[:nc] = recorded.references.get(i, 0.0)
        if system.evaluate(float(run.t[i])) <= EVENT:
            for array, view in zip(values, views):
                array[len(rows)] = view
            rows.append(i)
    return _Outputs(np.array(rows, dtype=np.int64), *(array[: len(rows)] for array in values))


def _empty_track(contact: Contact, n: int) -> ContactTrack:
    k1, k2 = contact.body1.contour.dimension, contact.body2.contour.dimension
    first, second = (k2, k1) if contact.swapped else (k1, k2)

    def nan(*shape: int) -> np.ndarray:
        return np.full((n, *shape), np.nan)

    return ContactTrack(
        nan(k1 + k2),
        nan(first),
        nan(second),
        np.zeros((n, 2), dtype=np.int64),
        nan(3),
        nan(3, 3),
        nan(3, 3),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, 3)),
        nan(3),
        np.full(n, FREE),
        nan(),
        nan(),
    )


def _fill_track(outputs: _Outputs, c: int, contact: Contact, track: ContactTrack) -> None:
    rows, one, two = outputs.rows, 2 * c, 2 * c + 1
    k1, k2 = contact.body1.contour.dimension, contact.body2.contour.dimension
    u1, u2 = outputs.location[:, c, :k1], outputs.location[:, c, 2 : 2 + k2]
    track.mode[rows] = modes = outputs.modes[:, c]
    track.location[rows] = np.hstack([u1, u2])
    track.location_first[rows], track.location_second[rows] = (u2, u1) if contact.swapped else (u1, u2)
    track.charts[rows] = outputs.charts[:, one : two + 1]
    first, second, carrier, basis = (
        outputs.shapes[:, one],
        outputs.shapes[:, two],
        outputs.frames[:, two],
        outputs.basis[:, c],
    )
    track.point[rows] = carrier[:, 3] + second[:, 0]
    frame = contact_frame(contact.pattern.code, first, second, carrier[:, 0:3, 2], basis)
    track.frame[rows], track.dual_frame[rows] = frame, dual_basis(frame)
    sign = -1.0 if contact.swapped else 1.0
    gaps = outputs.gaps[:, c]
    track.gap[rows] = gaps[:, 0] if contact.pattern.constraints == 1 else np.hypot(gaps[:, 0], gaps[:, 1])
    track.conditioning[rows] = np.abs(outputs.conditioning[:, c])
    track.slip_velocity[rows] = sign * outputs.slip[:, c]
    closed = modes != FREE
    along = outputs.force[closed, c]
    force = sign * np.einsum("nij,ni->nj", basis[closed], along)
    rows = rows[closed]
    track.force[rows] = force
    track.multipliers[rows] = np.einsum("nij,ni->nj", frame[closed], force)
    if contact.pattern.constraints == 2:
        normal, tangential = np.hypot(along[:, 1], along[:, 2]), np.abs(along[:, 0])
    else:
        normal, tangential = along[:, 2], np.hypot(along[:, 0], along[:, 1])
    track.normal_force[rows], track.tangential_force[rows] = normal, tangential


def _fill_residuals(outputs: _Outputs, c: int, contact: Contact, residuals: dict[str, np.ndarray]) -> None:
    closed = outputs.modes[:, c] != FREE
    rows, modes = outputs.rows[closed], outputs.modes[closed, c]
    first, second = outputs.shapes[closed, 2 * c], outputs.shapes[closed, 2 * c + 1]
    carriers, basis = outputs.frames[closed, 2 * c : 2 * c + 2], outputs.basis[closed, c]
    length = characteristic_length(contact)
    difference = (carriers[:, 1, 3] - carriers[:, 0, 3]) + (second[:, 0] - first[:, 0])
    residuals["C1"][rows] = np.linalg.norm(difference, axis=1) / length
    residuals["GC"][rows] = np.abs(outputs.gaps[closed, c]).max(axis=1) / length
    k1 = contact.body1.contour.dimension
    if k1 > 0 and contact.pattern.name != "3C-3C":
        tangents = first[:, 1 : 1 + k1]
        across = np.abs(np.einsum("nai,ni->na", tangents, basis[:, 2])) / np.linalg.norm(tangents, axis=2)
        residuals["C2"][rows] = across.max(axis=1)
    components = np.abs(np.einsum("nij,nj->ni", basis, outputs.slip[closed, c]))
    normals = slice(2 if contact.pattern.constraints == 1 else 1, 3)
    worst = components[:, normals].max(axis=1)
    held = components[:, : contact.pattern.tangents].max(axis=1, initial=0.0)
    speeds = np.linalg.norm(carriers[:, :, 4], axis=2).max(axis=1, initial=1.0)
    residuals["VC"][rows] = np.where(modes == STICK, np.maximum(worst, held), worst) / speeds
