"""Dense output: the state and the contacts of a run at any time."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from functools import cached_property

import numpy as np

from .arguments import reals
from .display import shortened
from .errors import ArgumentError, SolverError
from .integration.pieces import Pieces
from .integration.results import Stop
from .records import Record, Recorded
from .scene import Scene
from .state import State
from .tracks import ContactTrack, evaluate_tracks

# Times may be outside a run by so much of its largest time, as those of linspace are.
_ROUND_OFF = 1e-12


def time_slack(first: float, last: float) -> float:
    """By how much in s times may be outside a run from first to last: that much is their round-off."""
    return _ROUND_OFF * max(abs(first), abs(last))


class Sample:
    """A run at one time, or at several: what `Trajectory.sol` returns.

    Parameters
    ----------
    scene : Scene
        The scene of the run.
    t : float or (n,) array
        Time in s.
    q : (nq,) or (n, nq) array
        Configuration.
    v : (nv,) or (n, nv) array
        Velocity.
    recorded : Recorded
        What else is known, a row for each time.
    alone : bool
        Whether it is one time, whose arrays then have no axis of time.
    """

    def __init__(
        self, scene: Scene, t: np.ndarray, q: np.ndarray, v: np.ndarray, recorded: Recorded, alone: bool
    ) -> None:
        self.t: float | np.ndarray = float(t[0]) if alone else t
        self.q: np.ndarray = q[0] if alone else q
        self.v: np.ndarray = v[0] if alone else v
        self._scene, self._rows, self._alone = scene, (t, q, v, recorded), alone

    @cached_property
    def contacts(self) -> Mapping[str, ContactTrack]:
        """Contacts by name, evaluated when first asked for; for one time, their arrays have no axis of time."""
        tracks, _ = evaluate_tracks(self._scene, *self._rows)
        return {name: track.at(0) for name, track in tracks.items()} if self._alone else tracks

    def __repr__(self) -> str:
        times = f"t = {self.t:.9g} s" if self._alone else f"{np.size(self.t)} times"
        return f"<Sample at {times}: nq {self._rows[1].shape[1]}, contacts {shortened(self._scene.contacts)}>"


class DenseOutput:
    """Evaluates a run between its steps, on the integrator's own interpolants.

    Parameters
    ----------
    scene : Scene
        The scene of the run.
    start : State
        Where the run started from.
    pieces : Pieces
        The interpolants of its steps; their system belongs to this object from now on.
    with_torques : bool
        Whether torques act on the joints.
    """

    def __init__(self, scene: Scene, start: State, pieces: Pieces, with_torques: bool) -> None:
        self._scene, self._start, self._pieces, self._with_torques = scene, start, pieces, with_torques
        self._lock = threading.Lock()

    def __call__(self, t: float | np.ndarray) -> Sample:
        """See `Trajectory.sol`."""
        times = self._check(t)
        order = np.argsort(times, kind="stable")
        # one system for all who ask
        with self._lock:
            record = Record(self._pieces.system, self._start, self._with_torques)
            try:
                self._pieces.write(times[order], record.flush)
            except Stop as stop:
                raise SolverError(stop.message) from None
            sorted_t, q, v, unpack = record.rows(self._scene)
        back = np.argsort(order)
        return Sample(self._scene, sorted_t[back], q[back], v[back], unpack().rows(back), np.ndim(t) == 0)

    def _check(self, t: float | np.ndarray) -> np.ndarray:
        times = reals("t must be times in s", t)
        if times.ndim > 1:
            raise ArgumentError(f"t must be a time or times (n,), got an array of shape {times.shape}")
        times = times.reshape(-1)
        if not np.isfinite(times).all():
            raise ArgumentError(f"t must be finite, got {t!r}")
        if not len(self._pieces):
            raise ArgumentError("the run has made no step: there is no time at which it could be evaluated")
        low, high = self._pieces.range
        slack = time_slack(low, high)
        if times.size and (times.min() < low - slack or times.max() > high + slack):
            raise ArgumentError(f"t must lie in [{low:.9g}, {high:.9g}], got {t!r}")
        clipped: np.ndarray = np.clip(times, low, high)
        return clipped
