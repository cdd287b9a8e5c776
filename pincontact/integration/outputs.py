"""Where outputs are written in an event-driven run: at accepted states, and within steps from the dense output."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..dynamics.directions import freeze_slip
from ..layout import OK
from .pieces import Pieces, write_outputs
from .results import STEP_TOO_SMALL, Stop
from .runge_kutta import RungeKutta


def no_dense_output(t: float) -> Stop:
    """The Stop for a step that has none."""
    return Stop(STEP_TOO_SMALL, f"t = {t:.9g} s: the dense output of a step could not be evaluated")


class Outputs:
    """Writes the outputs at given times, or at every accepted state.

    record(t): writes the state in the system. flush(): makes room for the rows that compiled steps write. times: s,
    None for every accepted state. pieces: keeps the interpolants of all steps, where that is asked for.
    """

    def __init__(
        self,
        rk: RungeKutta,
        record: Callable[[float], None],
        flush: Callable[[], None],
        times: np.ndarray | None,
        pieces: Pieces | None = None,
    ) -> None:
        self.rk, self.system, self.record, self.flush = rk, rk.system, record, flush
        self.every_state, self.pieces = times is None, pieces
        self.system.set_output_times(times)

    def due(self, t: float) -> bool:
        """Whether an output is asked for at t or before."""
        return bool(self.system.scalars.next_output <= t)

    def need_dense(self, t: float) -> bool:
        """Whether a step that ends at t has to be interpolated for them."""
        return self.pieces is not None or self.due(t)

    def keep(self, t: float, end: float, size: float) -> None:
        """Keep the last interpolant, of a trial step from t of this size in s, up to `end`, where all are kept."""
        if self.pieces is not None:
            self.pieces.keep(t, end, size)

    def keep_shorter(self, t: float, taken: float, step: float) -> None:
        """Keep the interpolant of the part `taken` of a step from t that was taken to an event, where all are kept;
        that of the whole step where the shorter one has none. The trial step stays the shorter one."""
        if self.pieces is None:
            return
        new_state, error = self.system.new_state.copy(), self.rk.error
        for size in (taken, step):
            if self.rk.try_step(t, size) == OK and self.rk.interpolate(t, size):
                break
        else:
            raise no_dense_output(t)
        self.keep(t, t + taken, size)
        self.system.new_state[:], self.system.scalars.error_norm = new_state, error

    def __len__(self) -> int:
        """How many pieces are kept."""
        return 0 if self.pieces is None else len(self.pieces)

    def drop(self) -> None:
        """Drop what was kept last, where all are kept."""
        if self.pieces is not None:
            self.pieces.drop()

    def keep_only(self, count: int) -> None:
        """Drop what was kept after so many pieces."""
        for _ in range(count, len(self)):
            self.drop()

    def keep_end_of_slip(self, t: float, left: float, ended: dict[int, np.ndarray]) -> None:
        """Keep the straight line, of `left` in s from the accepted state at t, to the end of these items' slip, where
        all steps are kept. ended: their directions at its start; at its end v_c has none."""
        system = self.system
        if self.pieces is None:
            return
        integers, numbers = system.contact_int.copy(), system.contact_real.copy()
        for c, direction in ended.items():
            freeze_slip(system, c, system.basis[c, :2] @ direction)
        self.pieces.keep_line(t, t + left, system.slopes[0])
        system.contact_int[:], system.contact_real[:] = integers, numbers

    def write_state(self, t: float, at_their_times: bool = False) -> None:
        """The system's state at t has been accepted: write it, where all are, and for every output time that has come,
        as that of t or of the time that was asked for."""
        self.write_end(t)
        self.write_asked(t, at_their_times)

    def write_end(self, t: float) -> None:
        """Write the system's state where all are written."""
        if self.every_state:
            self.record(t)

    def write_asked(self, t: float, at_their_times: bool = False) -> None:
        """Write the system's state for every output time that has come; see `write_state`."""
        while self.due(t):
            self.record(self.system.scalars.next_output if at_their_times else t)
            self.system.output_done()

    def write_until(self, until: float) -> None:
        """Write the output times up to `until`, if there are any, in the step that was interpolated last."""
        if self.due(until):
            write_outputs(self.system, until, self.flush)

    def write_short_step(self, t: float, step: float) -> None:
        """Write the output times in the last trial step, from t, whatever its size in s."""
        if self.need_dense(t + step):
            self.interpolate(t, step)
            self.write_until(t + step)
            self.keep(t, t + step, step)

    def interpolate(self, t: float, step: float) -> None:
        """Make the dense output of the last trial step, which has to have one."""
        if not self.rk.interpolate(t, step):
            raise no_dense_output(t)
