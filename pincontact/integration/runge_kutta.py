"""An explicit pair on a compiled system: its tables, and single tasks of a step as methods."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from ..layout import (
    EVENT,
    OK,
)
from .accuracy import set_accuracy
from .stages import load_state
from .steps import ACCEPT, FINISH_STEP, FIRST_STEP, INTERPOLATION_STAGES, KEEP_VELOCITY, START, TRIAL_STEP
from .tableaux import Tableau

if TYPE_CHECKING:
    import numpy as np

    from ..dynamics.system import Torque
    from .run_system import RunSystem

# Margin on the depth of a parabola's dip between two stages.
_DIP = 1.5

# From this relative tolerance on an interpolant without stages of its own is as good as one with them.
_LOOSE = 1e-7


class RungeKutta:
    """One integrator on one system.

    The state at the step's start is `system.state` with its slope in slot 0; `try_step` leaves the new state in
    `system.new_state` and the error norm in `error`; nothing of the start is lost before `accept`.
    torque: fills `system.tau` for (t, system.q, system.v); or None.
    """

    def __init__(self, system: RunSystem, method: Tableau, rtol: float, atol: float, torque: Torque | None) -> None:
        if method.extra and rtol >= _LOOSE:
            method = method.without_extra_stages
        self.system, self.method = system, method
        system.before_evaluation(torque)
        for table in method.tables:
            system.put(*table)
        system.sizes.nstages = method.stages
        system.counters.estimate_after, system.counters.extra_stages = method.estimate_after, method.extra
        system.scalars.error_order = method.error_order
        system.counters.dense_nested = method.nested
        system.scalars.dip = _DIP * method.widest**2
        system.counters.parent_axes = system.turns
        system.scale[0], system.scale[1] = rtol, atol
        set_accuracy(system, rtol, atol)
        system.absolute.fill(atol)
        # no error is estimated in parameters that nothing depends on
        system.absolute[system.unfollowed] = 0.0

    @property
    def evaluations(self) -> int:
        """How many evaluations there have been."""
        return self.system.counters.evaluation_count

    @property
    def error(self) -> float:
        """Error norm of the last trial step, 1 at the tolerance."""
        return self.system.scalars.error_norm

    @property
    def alarm(self) -> bool:
        """Whether an event function was negative in any stage of the last trial step, or may have been between them."""
        return bool(self.system.counters.alarm)

    def evaluate_start(self, t: float) -> int:
        """Evaluate at system.state and store its slope; the state is what `stage_state` holds afterwards."""
        return self.system.run(START, t)

    def evaluate(self, t: float) -> int:
        """Torque, Pinocchio and kernel at (q, v) of the system."""
        return self.system.evaluate(t)

    def try_step(self, t: float, h: float) -> int:
        """A step of size h from the state at t; returns a status."""
        return self.system.run(TRIAL_STEP, t, h)

    def finish_step(self, t: float) -> int:
        """What follows every accepted state (see `steps.finish_step`); returns a status."""
        return self.system.run(FINISH_STEP, t)

    def interpolate(self, t: float, h: float) -> bool:
        """Dense output of the trial step, by the extra stages of the method; False if one of them fails."""
        return self.system.run(INTERPOLATION_STAGES, t, h) <= EVENT

    def cubic(self, h: float) -> Callable[[float], np.ndarray]:
        """State at a fraction theta of the trial step of size h, from the slopes at both ends alone."""
        system = self.system
        start, change = system.state.copy(), system.new_state - system.state
        first = h * system.slopes[0] - change
        last = change - h * system.slopes[self.method.stages]

        def state_at(theta: float) -> np.ndarray:
            rest = 1.0 - theta
            out: np.ndarray = start + theta * (change + rest * (rest * first + theta * last))
            return out

        return state_at

    def begin_at(self, q: np.ndarray, v: np.ndarray, location: np.ndarray) -> None:
        """Make (q, v) and the contact coordinates (nc, 4) the state at the step's start, and the next one evaluated."""
        system = self.system
        system.stage_state[:] = 0.0
        system.put_state(system.stage_state, q, 0.0, location)
        load_state(system.address)
        # to the last bit: there and back again would round
        system.v[:] = v
        self.keep_velocity()
        system.state[:] = system.stage_state

    def keep_velocity(self) -> None:
        """Make `system.v` the velocity of `stage_state`, whose configuration is the one evaluated last."""
        self.system.run(KEEP_VELOCITY)

    def load(self, y: np.ndarray) -> None:
        """Make y the state that the next evaluation sees."""
        self.system.stage_state[...] = y
        load_state(self.system.address)

    def project(self, t: float, evaluated: bool, error: float = math.inf) -> bool:
        """Put `stage_state` on the constraints; whether it succeeded. error: see `projection.project`."""
        return self.system.project(t, evaluated, error) == OK

    def accept(self) -> None:
        """The projected state becomes the next step's start; its slope is that of the last evaluation."""
        self.system.run(ACCEPT)

    def first_step(self, t: float, span: float) -> float:
        """Size of the first step from the state at t, at most span; one evaluation."""
        self.system.run(FIRST_STEP, t, span)
        return self.system.scalars.next_step
