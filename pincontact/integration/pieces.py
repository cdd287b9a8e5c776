"""Dense output of a whole run: the interpolants of all its steps, each with the modes that it holds in."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..layout import OK
from .contradictions import projection_failure
from .steps import BLOCK_FULL, WRITE_OUTPUTS

if TYPE_CHECKING:
    from .run_system import RunSystem

# Besides the interpolant, what an evaluation within a step depends on and later steps change.
_ARRAYS = (
    "state",
    "dense",
    "contact_int",
    "contact_real",
    "joint_int",
    "reference",
    "reference_start",
    "reference_slope",
    "side_int",
)
_SCALARS = ("has_reference",)


class Piece(NamedTuple):
    """The interpolant of the step of this size (s) from `start`, which is followed up to `end`, and what else
    evaluations in it depend on: arrays and scalars by name."""

    start: float
    end: float
    size: float
    arrays: dict[str, np.ndarray]
    scalars: dict[str, float]


class Pieces:
    """Steps of a run, one after the other, and the states in them.

    system: the run's. It is kept when the run is over, with the user's control, and evaluates what is asked for in the
    same way as outputs of the run are.
    """

    def __init__(self, system: RunSystem) -> None:
        self.system = system
        self._pieces: list[Piece] = []
        self._ends: list[float] = []

    def __len__(self) -> int:
        return len(self._pieces)

    def __iter__(self) -> Iterator[Piece]:
        return iter(self._pieces)

    @property
    def range(self) -> tuple[float, float]:
        """Times in s at which the pieces begin and end."""
        return self._pieces[0].start, self._pieces[-1].end

    def keep(self, start: float, end: float, size: float) -> None:
        """Keep the interpolant of the trial step of this size (s) from `start`, where the system still is, up to
        `end`."""
        system, last = self.system, self._pieces[-1] if self._pieces else None
        arrays = {name: np.array(getattr(system, name)) for name in _ARRAYS}
        if last is not None:
            # most of it changes with the modes only
            for name, values in last.arrays.items():
                if np.array_equal(arrays[name], values):
                    arrays[name] = values
        scalars = {name: float(system.scalars[name]) for name in _SCALARS}
        self._pieces.append(Piece(start, end, size, arrays, scalars))
        self._ends.append(end)

    def drop(self) -> None:
        """Drop the last one again."""
        self._pieces.pop()
        self._ends.pop()

    def keep_line(self, start: float, end: float, rate: np.ndarray) -> None:
        """Keep a step from `start` to `end` in which the state changes at a constant rate."""
        dense = self.system.dense
        dense[:] = 0.0
        dense[0] = (end - start) * rate
        self.keep(start, end, end - start)

    def keep_point(self, t: float) -> None:
        """Keep the state at t, for a run that has no steps."""
        self.keep_line(t, float(np.nextafter(t, np.inf)), np.zeros_like(self.system.state))

    def write(self, times: np.ndarray, flush: Callable[[], None]) -> None:
        """Record the states at times (s), in order and within the range, as rows of the system's record; at the time of
        an event that before it. flush(): makes room for more rows. Raises Stop where one cannot be evaluated."""
        last = len(self._ends) - 1
        which = [min(bisect_left(self._ends, t), last) for t in times.tolist()]
        for i, group in groupby(range(len(which)), which.__getitem__):
            self._write(self._pieces[i], times[list(group)], flush)

    def _write(self, piece: Piece, times: np.ndarray, flush: Callable[[], None]) -> None:
        system = self.system
        for name, values in piece.arrays.items():
            getattr(system, name)[...] = values
        for name, value in piece.scalars.items():
            system.scalars[name] = value
        system.scalars.dense_start, system.scalars.dense_step = piece.start, piece.size
        system.set_output_times(times)
        write_outputs(system, float(times[-1]), flush)


def write_outputs(system: RunSystem, until: float, flush: Callable[[], None]) -> None:
    """Write the outputs up to a time (s) from the interpolant at hand; flush(): makes room for more rows."""
    status = BLOCK_FULL
    while status == BLOCK_FULL:
        flush()
        status = system.run(WRITE_OUTPUTS, until)
    if status != OK:
        raise projection_failure(system, system.scalars.next_output)
