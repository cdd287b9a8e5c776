"""Results of a run: states, contact tracks, events, counts; stored and read back."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from .arguments import is_number, output_number
from .display import EVENTS_SHOWN, html_table, shortened
from .dynamics.energy import energies_at
from .energies import Energies
from .errors import TrajectoryError, sentence
from .integration.discrete import DISCRETE_COLUMNS
from .integration.results import Event
from .records import Recorded, joined
from .scene import Scene
from .solution import DenseOutput, Sample
from .state import Correction, State
from .tracks import ContactTrack, evaluate_tracks, model_of

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FORMAT = 1
# Of two runs in a row these counts are the larger one, others their sum.
_LARGEST_STATS = ("cone_residual", "wall_time")


class _Tracks(dict[str, ContactTrack]):
    """Contact tracks by name."""

    def __missing__(self, name: str) -> ContactTrack:
        raise TrajectoryError(f"unknown contact {name!r}; contacts: {', '.join(self) or 'none'}")


class Trajectory:
    """What `simulate` returns.

    Attributes
    ----------
    scene : Scene
    t : (n,) array
        Times of the outputs in s.
    q : (n, nq) array
        Configurations, in m and rad.
    v : (n, nv) array
        Velocities, in m/s and rad/s.
    events : list of Event
        In their order.
    status : int
        0 finished, 1 a terminal event, negative: the run could not go on.
    message : str
        Says so in words: for what could not go on, why.
    stats : dict
        Counts of evaluations, steps, solved problems, and `wall_time` in s.

    Examples
    --------
    >>> import pincontact as pc
    >>> scene = pc.Scene.from_urdf("urdf/ball.urdf", floating_base=True)
    >>> ball = scene.add_contour("ball", pc.Sphere(0.1), frame="ball")
    >>> floor = scene.add_contour("floor", pc.Plane())
    >>> contact = scene.add_contact("ball/floor", floor, ball, friction=pc.Coulomb(0.2))
    >>> state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [1.0, 0, 0, 0, 0, 0])
    >>> run = pc.simulate(scene, state, 0.1, t_eval=[0.0, 0.1], energies=True)
    >>> track = run.contacts["ball/floor"]
    >>> track.mode.tolist(), (track.tangential_force / track.normal_force).round(9).tolist()
    ([2, 2], [0.2, 0.2])
    >>> bool(abs(run.energies().balance[-1]) < 1e-9)
    True
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
        dense: DenseOutput | None = None,
    ) -> None:
        self.scene = scene
        self.t, self.q, self.v = t, q, v
        self.status, self.message, self.events, self.stats = status, sentence(message), events, stats
        self._unpack, self._dense = recorded, dense

    def __getstate__(self) -> dict[str, Any]:
        # the interpolants belong to the memory of the run
        return {**self.__dict__, "_dense": None}

    def followed_by(self, rest: Trajectory, t: float, event: Event, works: np.ndarray | None) -> Trajectory:
        """This run up to a time and, from its state there on, another one of the scene; it ends as that does.

        Parameters
        ----------
        rest : Trajectory
            The other run.
        t : float
            Where it starts, in s.
        event : Event
            Says so.
        works : (4,) array or None
            The works up to there in J, where they are recorded.

        Returns
        -------
        Trajectory
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
            partial(_joined, self, kept, rest, first, works),
            [*(e for e in self.events if e.time <= t), event, *rest.events],
            rest.status,
            f"{rest.message.removesuffix('.')}; by time stepping from t = {t:.9g} s on, since at {self.message}",
            stats,
        )

    @property
    def _recorded(self) -> Recorded:
        """Unpacked when first asked for: a run that only goes on needs none of it. Threads that ask at the same time
        get what the first of them has found."""
        parts = self.__dict__
        found: Recorded = parts["_found"] if "_found" in parts else parts.setdefault("_found", self._unpack())
        return found

    @cached_property
    def _evaluated(self) -> tuple[dict[str, ContactTrack], dict[str, dict[str, np.ndarray]]]:
        """Tracks and residuals by contact."""
        return evaluate_tracks(self.scene, self.t, self.q, self.v, self._recorded)

    @cached_property
    def contacts(self) -> Mapping[str, ContactTrack]:
        """Contact tracks by name, evaluated when first asked for."""
        return _Tracks(self._evaluated[0])

    @property
    def success(self) -> bool:
        """Whether the run reached its end or a terminal event."""
        return self.status >= 0

    def __repr__(self) -> str:
        return f"<Trajectory {self._times()}; {len(self.events)} events; status {self.status}: {self.message}>"

    def _times(self) -> str:
        n = self.t.size
        return f"of {n} outputs, {self.t[0]:.6g} to {self.t[-1]:.6g} s" if n else "without outputs"

    def _repr_html_(self) -> str:
        facts = [
            ("outputs", self._times()),
            ("status", f"{self.status}: {self.message}"),
            ("contacts", shortened(self.contacts)),
            ("stats", ", ".join(f"{key} {value:.6g}" for key, value in self.stats.items() if is_number(value))),
        ]
        shown = [(f"{e.time:.9g}", e.contact or e.joint or "", e.kind) for e in self.events[:EVENTS_SHOWN]]
        rest = len(self.events) - len(shown)
        if rest:
            shown.append(("...", "", f"{rest} more"))
        return html_table("Trajectory", ("of", "is"), facts) + html_table("Events", ("t [s]", "of", "kind"), shown)

    def sol(self, t: float | np.ndarray) -> Sample:
        """The run at any time in it: needs `simulate(..., dense_output=True)`.

        It has the accuracy of the integrator's interpolant, and its contacts are those of the state there: put on the
        constraints, with forces and modes of their own. At the time of an event it is what was before the event.

        Parameters
        ----------
        t : float or (n,) array
            Times in s, in any order.

        Returns
        -------
        Sample
            `t`, `q` (nq,), `v` (nv,) and `contacts`, a mapping from names to tracks without an axis of time (`force`
            (3,), `location` (k,), ...); for an array of times all with n rows. A control is called again at these
            times, for the torques.

        Raises
        ------
        ArgumentError
            For what is no time between start and end of the run.
        TrajectoryError
            Without dense output: not asked for, or the run was read from a file or pickled.
        SolverError
            Where the interpolated state cannot be put on the constraints.
        """
        if self._dense is None:
            raise TrajectoryError("the run has kept no dense output: simulate(..., dense_output=True)")
        return self._dense(t)

    def state(self, index: int = -1) -> State:
        """The state of one output, to start another run from.

        Parameters
        ----------
        index : int
            Of the output; negative ones count from the end.

        Returns
        -------
        State

        Raises
        ------
        ArgumentError
            For what is no number of an output.
        """
        index, recorded = output_number(index, self.t.size), self._recorded
        arrays = (self.q, self.v, recorded.location, recorded.discrete)
        q, v, location, discrete = (array[index].copy() for array in arrays)
        return State(self.scene, q, v, float(self.t[index]), location, discrete, Correction())

    # ------------------------------------------------------------------ contacts

    def external_forces(self, index: int = -1) -> pin.StdVec_Force:
        """The contacts' forces at one output as Pinocchio's external forces.

        `pin.aba(model, data, run.q[i], run.v[i], tau - damping * v, run.external_forces(i))` gives the run's
        accelerations.

        Parameters
        ----------
        index : int
            Of the output; negative ones count from the end.

        Returns
        -------
        pin.StdVec_Force
            One for each joint, in the joint's frame, in N and N m.

        Raises
        ------
        ArgumentError
            For what is no number of an output.
        TrajectoryError
            For a run that was read from a file without its scene.
        """
        from .analysis.forces import joint_forces

        index, model = output_number(index, self.t.size), model_of(self)
        data = model.createData()
        pin.forwardKinematics(model, data, self.q[index])
        tracks = {name: self.contacts[name] for name in self.scene.contacts}
        points = {name: np.nan_to_num(track.point[index]) for name, track in tracks.items()}
        forces = {name: track.force[index] for name, track in tracks.items()}
        torques = {name: track.torque[index] for name, track in tracks.items()}
        return joint_forces(model, data, self.scene.contacts.values(), points, forces, torques)

    def residuals(self) -> dict[str, np.ndarray]:
        """Worst constraint residual of all closed contacts at every output.

        Returns
        -------
        dict of str to (n,) array
            Without units. "C1": distance of the points r_1 and r_2, and "GC": the gap, both relative to the contact's
            length; "C2": e_3 . tangents of body 1; "VC": constrained components of v_c relative to the speeds.
        """
        by_contact, zero = self._evaluated[1].values(), np.zeros(self.t.size)
        return {kind: np.max([zero, *(r[kind] for r in by_contact)], axis=0) for kind in ("C1", "C2", "GC", "VC")}

    # ------------------------------------------------------------------ energies

    def energies(self) -> Energies:
        """Kinetic and potential energy at every output; works where the run recorded them (energies=True).

        Returns
        -------
        Energies

        Raises
        ------
        TrajectoryError
            For a run that was read from a file without its scene.
        """
        model, recorded = model_of(self), self._recorded
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

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything, contact tracks included, to an npz file; the scene and dense output are not stored.

        Parameters
        ----------
        path : str or os.PathLike
            The file; `.npz` is added to a name that does not end so, as NumPy does.

        Returns
        -------
        pathlib.Path
            The file that was written.
        """
        file_path = _with_suffix(path)
        (tracks, residuals), events = self._evaluated, self.events
        arrays = {"t": self.t, "q": self.q, "v": self.v, **self._recorded.arrays()}
        # not the scene's names: a run that was read without its scene has its tracks all the same
        for i, name in enumerate(tracks):
            arrays |= {f"track{i}.{key}": value for key, value in tracks[name].arrays().items()}
            arrays |= {f"residual{i}.{key}": value for key, value in residuals[name].items()}
        arrays["event_q"] = np.array([e.q for e in events]).reshape(len(events), self.q.shape[1])
        arrays["event_v"] = np.array([e.v for e in events]).reshape(len(events), self.v.shape[1])
        header = {
            "format": _FORMAT,
            "status": self.status,
            "message": self.message,
            "stats": self.stats,
            "contacts": list(tracks),
            "contours": [track.contours for track in tracks.values()],
            "events": [[e.time, e.contact, e.kind, e.index, e.joint] for e in self.events],
        }
        with file_path.open("wb") as file:
            np.savez_compressed(file, header=np.array(json.dumps(header)), **arrays)  # type: ignore[arg-type]
        return file_path

    @classmethod
    def load(cls, path: str | os.PathLike[str], scene: Scene | None = None) -> Trajectory:
        """Read a file of `save`; `.npz` is added to a name without it, unless there is such a file.

        Parameters
        ----------
        path : str or Path
        scene : Scene, optional
            The scene that was simulated, for replay and further runs. Without it a scene with an empty model stands in,
            and the stored arrays are all there is.

        Returns
        -------
        Trajectory

        Raises
        ------
        TrajectoryError
            For a file that is missing or not a stored trajectory, and for a scene with other contacts.
        """
        if scene is not None and not isinstance(scene, Scene):
            raise TrajectoryError(f"the scene must be a Scene, got {type(scene).__name__}")
        try:
            with np.load(path if os.path.exists(path) else _with_suffix(path), allow_pickle=False) as file:
                header = json.loads(str(file["header"]))
                arrays = {key: file[key] for key in file.files if key != "header"}
            if header["format"] != _FORMAT:
                raise TrajectoryError(f"{os.fspath(path)}: format {header['format']} is not {_FORMAT}")
            names = header["contacts"]
            contours = header.get("contours", [("", "")] * len(names))
            states = zip(header["events"], arrays["event_q"], arrays["event_v"])
            events = [Event(t, contact, kind, q, v, *rest) for (t, contact, kind, *rest), q, v in states]
            found = scene if scene is not None else Scene(pin.Model())
            required, optional = ("location", "discrete", "directions"), ("works", "torques", "resistances")
            # files of runs that did not tell which contacts were beside ends
            missing = DISCRETE_COLUMNS - arrays["discrete"].shape[2]
            arrays["discrete"] = np.pad(arrays["discrete"], ((0, 0), (0, 0), (0, missing)))
            kept = [arrays[key] for key in required] + [arrays.get(key) for key in (*optional, "total_at_start")]
            recorded, end = partial(Recorded, *kept), (header["status"], header["message"], header["stats"])
            run = cls(found, arrays["t"], arrays["q"], arrays["v"], recorded, events, *end)
            tracks = {
                name: ContactTrack(**_part(arrays, f"track{i}."), contours=tuple(contours[i]))
                for i, name in enumerate(names)
            }
            run._evaluated = tracks, {name: _part(arrays, f"residual{i}.") for i, name in enumerate(names)}
        except (OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile, zlib.error) as error:
            raise TrajectoryError(f"{os.fspath(path)} is not a stored trajectory: {error}") from error
        if scene is not None and list(scene.contacts) != names:
            raise TrajectoryError(f"the scene's contacts {list(scene.contacts)} are not those stored, {names}")
        return run

    # ------------------------------------------------------------------ tables

    def to_xarray(self) -> xarray.Dataset:
        """An xarray Dataset over t: q, v, energies, and everything of the contact tracks over a dimension `contact`.

        Returns
        -------
        xarray.Dataset

        Raises
        ------
        MissingExtraError
            Without xarray (the extra `data`).
        """
        from .tables import run_to_xarray

        return run_to_xarray(self)

    def to_pandas(self) -> pandas.DataFrame:
        """A DataFrame with a row for each output, its index t.

        Returns
        -------
        pandas.DataFrame
            Columns such as q.knee, v.root_joint[3], rim/floor.force.z and rim/floor.mode (frames are left to
            `to_xarray`).

        Raises
        ------
        MissingExtraError
            Without pandas (the extra `data`).
        """
        from .tables import run_to_pandas

        return run_to_pandas(self)

    # ------------------------------------------------------------------ views

    def plot(
        self, kinds: str | Sequence[str] | None = None, axes: Axes | Sequence[Axes] | np.ndarray | None = None
    ) -> Figure:
        """Plots of the run in one figure; single ones are in `pincontact.view.plots`.

        Parameters
        ----------
        kinds : str or sequence of str, optional
            Any of "motion", "forces", "cone", "slip", "location", "energy", "residuals"; all that the run has something
            for, if not given.
        axes : matplotlib.axes.Axes or sequence of them, optional
            As many axes to draw into; a new figure's, if not given.

        Returns
        -------
        matplotlib.figure.Figure
            Its axes are in the order of the kinds.

        Raises
        ------
        ArgumentError
            For an unknown kind, none at all, or another number of axes than of kinds.
        MissingExtraError
            Without Matplotlib (the extra `plot`).
        """
        from .view.plots import plot

        return plot(self, kinds, axes)


def _joined(one: Trajectory, kept: int, two: Trajectory, first: int, works: np.ndarray | None) -> Recorded:
    """What two runs have recorded, the second from where the first is left."""
    return joined(one._recorded, kept, two._recorded, first, works)


def _with_suffix(path: str | os.PathLike[str]) -> Path:
    name = os.fsdecode(path)
    return Path(name if name.endswith(".npz") else f"{name}.npz")


def _part(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {key[len(prefix) :]: value for key, value in arrays.items() if key.startswith(prefix)}
