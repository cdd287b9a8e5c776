"""Steps of an explicit pair on a compiled system: Pinocchio call, kernel call, Pinocchio call, ..."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..dynamics.projection import project
from ..layout import ERROR_NORM, EVENT, K1, K2, NOT_FINITE, NSTAGES, OK, STEP
from .stages import begin_stage, evaluate_stage, load_state, store_slope
from .tableaux import Interpolant, Tableau

if TYPE_CHECKING:
    from ..dynamics.system import System

# Step-size control: safety, and the bounds of one change.
SAFETY = 0.9
SMALLEST_FACTOR = 0.2
LARGEST_FACTOR = 10.0

Torque = Callable[[float], bool]


class RungeKutta:
    """One integrator on one system.

    The state at the step's start is `system.state` with its slope in slot 0; `attempt` leaves the new state in
    `system.new_state` and the error norm in `error`; nothing of the start is lost before `accept`.
    torque: fills `system.tau` for (t, system.q, system.v), False when the user's control failed; or None.
    """

    def __init__(self, system: System, method: Tableau, rtol: float, atol: float, torque: Torque | None) -> None:
        self.system, self.method, self.torque = system, method, torque
        n = method.c.size
        system.coefficients[:] = 0.0
        system.coefficients[:n, :n] = method.a
        system.nodes[:] = 0.0
        system.nodes[:n] = method.c
        system.weights_error[:] = 0.0
        system.weights_error[:, :n] = method.errors
        system.sizes[NSTAGES] = method.stages
        system.scale[:] = rtol, atol
        system.absolute[:] = atol
        start = system.nq + system.nv
        for c in range(system.nc):
            for body, k in enumerate((system.contact_int[c, K1], system.contact_int[c, K2])):
                system.absolute[start + 4 * c + 2 * body + k : start + 4 * c + 2 * body + 2] = 0.0
        self.error = 0.0
        self.evaluations = 0
        self.alarm = False
        self._plan = [(s, int(s == method.estimate_after)) for s in range(1, method.stages + 1)]

    def evaluate_start(self, t: float) -> int:
        """Evaluate at system.state and store its slope; the state is what `stage_state` holds afterwards."""
        system = self.system
        system.stage_state[:] = system.state
        load_state(system.table)
        status = self.evaluate(t)
        if status <= EVENT:
            store_slope(system.table, 0)
        return status

    def evaluate(self, t: float) -> int:
        """Torque, Pinocchio and kernel at (q, v) of the system."""
        if self.torque is not None and not self.torque(t):
            return NOT_FINITE
        self.evaluations += 1
        return self.system.evaluate(t)

    def attempt(self, t: float, h: float, adaptive: bool = False) -> int:
        """A step of size h from the state at t; returns a status.

        adaptive: leave the step's end unevaluated where the error estimate already rejects it. Afterwards `alarm` tells
        whether an event function was negative in any stage.
        """
        system = self.system
        table, model, data, q, v = system.table, system.model, system.data, system.q, system.v
        compute, torque, drives = pin.computeAllTerms, self.torque, system.python_drives
        scalars, nodes, last = system.scalars, system.nodes, self.method.stages
        scalars[STEP] = h
        self.alarm = False
        begin_stage(table, 1)
        for s, estimate in self._plan:
            if adaptive and s == last > self.method.estimate_after and scalars[ERROR_NORM] >= 1.0:
                break
            if torque is not None and not torque(t + nodes[s] * h):
                return NOT_FINITE
            if drives:
                system.fill_drives(t + nodes[s] * h)
            compute(model, data, q, v)
            self.evaluations += 1
            system.pinocchio_calls += 1
            status = evaluate_stage(table, t, s, estimate)
            if status != OK:
                if status != EVENT:
                    return status
                self.alarm = True
        self.error = float(scalars[ERROR_NORM])
        return OK

    def next_step(self, h: float, rejected: bool) -> float:
        """Step size after an attempt of size h with the present error."""
        exponent = -1.0 / (self.method.error_order + 1)
        if self.error == 0.0:
            factor = LARGEST_FACTOR
        else:
            factor = min(LARGEST_FACTOR, max(SMALLEST_FACTOR, SAFETY * self.error**exponent))
        return h * (min(1.0, factor) if rejected else factor)

    def interpolant(self, t: float, h: float) -> Interpolant | None:
        """Dense output of the attempted step; needs the extra stages of the method. None if one of them fails."""
        system, method = self.system, self.method
        for s in range(method.stages + 1, method.stages + 1 + method.extra):
            begin_stage(system.table, s)
            if self.evaluate(t + method.c[s] * h) > EVENT:
                return None
            store_slope(system.table, s)
        return method.interpolant(h, system.state, system.new_state, system.slopes)

    def load(self, y: np.ndarray) -> None:
        """Make y the state that the next evaluation sees."""
        self.system.stage_state[:] = y
        load_state(self.system.table)

    def project(self, t: float, evaluated: bool) -> bool:
        """Put `stage_state` on the constraints (see `dynamics.projection`)."""
        return project(self.system, t, evaluated, self.evaluate)

    def accept(self) -> None:
        """The projected state becomes the next step's start; its slope is that of the last evaluation."""
        system = self.system
        store_slope(system.table, 0)
        system.state[:] = system.stage_state

    def first_step(self, t: float, span: float) -> float:
        """A cautious first step from the sizes of the state and its slope (Hairer, Norsett, Wanner, Sec. II.4)."""
        system = self.system
        used = system.absolute > 0.0
        scale = system.absolute[used] + system.scale[0] * np.abs(system.state[used])
        size = math.sqrt(np.mean((system.state[used] / scale) ** 2))
        slope = math.sqrt(np.mean((system.slopes[0][used] / scale) ** 2))
        h = 1e-6 if size < 1e-5 or slope < 1e-5 else 0.01 * size / slope
        return min(h, span)
