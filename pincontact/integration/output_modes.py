"""Modes that hold at the outputs of time stepping, found when somebody asks for more than q and v."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ..dynamics.modes import ModeSolver
from ..layout import EVENT, FRICTION_EVENT, MODE, NORMAL_EVENT, STICK

if TYPE_CHECKING:
    from ..dynamics.system import System
    from ..friction.solve import ContactSolver


class OutputModes:
    """Decides modes at one output after the other, with the state in a system that nobody else uses.

    A contact at rest may be about to slip, or have come to rest only to slip on, the other way: held there, its force
    would lie outside its cone. It slips with the force that friction has in the direction it takes. One that is about
    to open would pull: it is open, or slides held up by friction alone.
    """

    def __init__(self, system: System, contact_solver: str = "auto") -> None:
        self._system, self._contact_solver = system, contact_solver
        self._solver: ContactSolver | None = None

    @contextmanager
    def at(self, t: float) -> Iterator[bool]:
        """Modes that hold at t, for the time being; whether they are others than the step's end has."""
        system = self._system
        held = [c for c in system.closed() if system.contact_int[c, MODE] == STICK]
        kept = None
        if held and (status := system.evaluate(t)) <= EVENT:
            modes = ModeSolver(system, self._contact_solver)
            if self._solver is not None:
                # an output does not depend on others
                self._solver.forget()
                modes.solver = self._solver
            event_functions, least = system.event_functions.tolist(), -modes.force_round_off()
            if any(min(event_functions[c][NORMAL_EVENT], event_functions[c][FRICTION_EVENT]) < least for c in held):
                kept = system.contact_int.copy(), system.contact_real.copy()
                if modes.resolve_modes(t, held, system.evaluate, status=status).status > EVENT:
                    system.contact_int[:], system.contact_real[:] = kept
                self._solver = modes.solver
        yield kept is not None
        if kept is not None:
            # a choice of redundant forces stays: it serves the next output, too
            system.contact_int[:], system.contact_real[:] = kept
