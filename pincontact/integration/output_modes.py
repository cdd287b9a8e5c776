"""Modes that hold at the outputs of time stepping, found when somebody asks for more than q and v."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..dynamics.modes import ModeSolver
from ..layout import EVENT, FRICTION_EVENT, MODE, NORMAL_EVENT, STICK
from .accuracy import REST

if TYPE_CHECKING:
    from ..dynamics.system import System
    from ..friction.solve import ContactSolver


class OutputModes:
    """Decides modes at one output after the other, with the state in a system that nobody else uses.

    A contact at rest may be about to slip, or have come to rest only to slip on, the other way: held there, its force
    would lie outside its cone. It slips with the force that friction has in the direction it takes. One that is about
    to open would pull: it is open, or slides held up by friction alone. A choice of redundant forces stays: it serves
    the next output, too.
    """

    def __init__(self, system: System, contact_solver: str = "auto") -> None:
        self._system, self._contact_solver = system, contact_solver
        # no error is controlled, and velocities at rest are round-off: no slip that passes through zero
        system.scale[:] = REST
        self._solver: ContactSolver | None = None

    def resolve(self, t: float) -> bool:
        """Give the system the modes that hold at t; whether they may be others than the step's end has."""
        system = self._system
        closed = system.closed()
        if not closed or (status := system.evaluate(t)) > EVENT:
            return False
        held = [c for c in closed if system.contact_int[c, MODE] == STICK]
        modes = ModeSolver(system, self._contact_solver)
        if self._solver is not None:
            # an output does not depend on others
            self._solver.forget()
            modes.solver = self._solver
        functions = system.event_functions
        margins = np.append(functions[closed, NORMAL_EVENT], functions[held, FRICTION_EVENT])
        if np.min(margins) >= -modes.force_round_off():
            return False
        integers, numbers = system.contact_int.copy(), system.contact_real.copy()
        if modes.resolve_modes(t, held, system.evaluate, status=status).status > EVENT:
            system.contact_int[:], system.contact_real[:] = integers, numbers
        self._solver = modes.solver
        return True
