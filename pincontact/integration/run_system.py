"""A system with the memory of a run: the states and slopes of steps, output times, and the tasks of compiled steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..dynamics.system import System
from ..layout import EVENT, LOOK_ROW
from .steps import LOOK, PROJECT, PROJECT_EVALUATED, run_task

# So many output times there is room for in every system.
_FEW_TIMES = 256
_NO_TIMES = np.zeros(0)


class RunSystem(System):
    """What one run needs, laid out once. Arguments are those of `System`."""

    def __init__(self, *given: Any, **options: Any) -> None:
        super().__init__(*given, **options)
        ny, items = self.ny, max(self.items, 1)
        # blocks of rows to be recorded, by their width, which all runs of this system fill
        self.row_blocks: dict[int, list[tuple[str, np.ndarray, int]]] = {}
        self.allocate(run_ny=ny, run_items=items)
        # see `accuracy.set_accuracy`; zero in time stepping
        self.gap_accuracy, self.lowest_resolved, self.lowest_rebounds, self.rebound_speeds = np.zeros((4, self.items))
        self.lasting_rebounds = np.zeros(self.items, dtype=bool)
        self._few_times = self.scratch("output_times", _FEW_TIMES)
        self._few_at = self.table[self.layout.places["output_times"], 0].item()
        self.put("output_times", self._few_times[:0], self._few_at)

    def parts(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """q, v, contact coordinates (nc, 4) and works of a state; views."""
        nq, to, end = self.nq, self.nq + self.nv, self.nq + self.nv + 4 * self.nc
        return state[:nq], state[nq:to], state[to:end].reshape(self.nc, 4), state[end:]

    def put_state(self, state: np.ndarray, q: np.ndarray, v: np.ndarray | float, location: np.ndarray) -> None:
        """Write these into a state."""
        for part, value in zip(self.parts(state), (q, v, location)):
            part[:] = value

    def run(self, task: int, t: float = 0.0, h: float = 0.0) -> int:
        """A task of `steps.run_task`; returns what it does, raises what `check_callbacks` does."""
        return self.checked(run_task(self.address, task, t, h))

    def look(self, t: float, step: float, share: float) -> tuple[bool, np.ndarray]:
        """Event functions plus `slack` at a share of the step from t that was interpolated last: whether they could be
        evaluated, and a view (items, EVENTS_PER_CONTACT) of a row that others overwrite.

        The gap of an open contact is NOTHING_THERE where no nearest point was found.
        """
        self.scan_shares[LOOK_ROW] = share
        self.run(LOOK, t, step)
        return bool(self.scan_status[LOOK_ROW] <= EVENT), self.scan_event_functions[LOOK_ROW, : self.items]

    def project(self, t: float, evaluated: bool = False, error: float = math.inf) -> int:
        """Put (q, v) and location of `stage_state` on the constraints; returns a status of `layout`.

        evaluated: the system has just been evaluated at that state; error: see `projection.project`.
        """
        return self.run(PROJECT_EVALUATED if evaluated else PROJECT, t, error)

    def set_output_times(self, times: np.ndarray | None) -> None:
        """Output times in s, in order, of a run that begins; None for an output at every step."""
        counters, given = self.counters, _NO_TIMES if times is None else times
        if given.size <= _FEW_TIMES:
            # an array's address takes longer to find than these to copy
            self._few_times[: given.size] = given
            self.put("output_times", self._few_times[: given.size], self._few_at)
        else:
            self.put("output_times", np.ascontiguousarray(given))
        counters.output_count, counters.outputs_done, counters.record_steps = given.size, 0, times is None
        self.announce_output()

    def announce_output(self) -> None:
        """Tell the compiled steps when the next output is due."""
        done = self.counters.outputs_done
        self.scalars.next_output = self.output_times[done] if done < self.output_times.size else math.inf

    def output_done(self) -> None:
        """Go on to the next output time."""
        self.counters.outputs_done += 1
        self.announce_output()
