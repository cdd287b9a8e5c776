"""A scene's equations around one state, with the mode of every contact held as it is there."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ..dynamics.system import System
from ..dynamics.units import unwhiten, whiten
from ..errors import SingularContactError, SolverError
from ..geometry.carriers import ORIGIN
from ..geometry.patterns import ON_CURVE
from ..integration.results import FAILURES, SINGULAR_CONTACT, Stop
from ..integration.runge_kutta import RungeKutta
from ..integration.stages import move_charts
from ..integration.tableaux import tableau
from ..integration.transitions import Transitions
from ..layout import (
    EVENT,
    FREE,
    FRICTION_MARGIN,
    FROZEN,
    LENGTH,
    MODE,
    NORMAL_MARGIN,
    PATTERN,
    SLIPPING,
    STICK,
    TANGENTS,
)
from ..state import Correction, State, check_state, check_vector, read_discrete, write_discrete
from .kinematics import jacobians
from .ranks import Directions

if TYPE_CHECKING:
    from ..scene import Scene

# Richardson's table: halvings of the step. The first step is a tenth of the natural length, where the truncation error
# of the last columns is far below round-off.
_LEVELS = 7
FIRST_STEP = 0.1
# Differences that are all below so many times their estimated errors are round-off: nothing changes.
ABOVE_NOISE = 10.0
# Forces below this fraction of the loads have no sign.
_FORCE_ROUND_OFF = 1e-9
_PROJECTIONS = 20


def derivative(f: Callable[[float], np.ndarray], step: float, levels: int = _LEVELS) -> tuple[np.ndarray, float]:
    """f'(0) and its estimated error, by Richardson's extrapolation of central differences over step, step / 2, ...

    Steps at which f raises a ContactError (a contact point lost) are left out.
    Raises SolverError when two of them do not remain.
    """
    best, least = None, math.inf
    previous: list[np.ndarray] = []
    failure: Exception | None = None
    for level in range(levels):
        h = step / 2.0**level
        try:
            row = [(f(h) - f(-h)) / (2.0 * h)]
        except (SolverError, SingularContactError) as error:
            failure, previous = error, []
            continue
        for j, coarser in enumerate(previous):
            row.append(row[j] + (row[j] - coarser) / (4.0 ** (j + 1) - 1.0))
            error_estimate = max(
                float(np.abs(row[-1] - row[-2]).max(initial=0.0)), float(np.abs(row[-1] - coarser).max(initial=0.0))
            )
            if error_estimate < least:
                best, least = row[-1], error_estimate
        previous = row
    if best is None:
        raise SolverError(f"the equations of motion cannot be differentiated at this state: {failure}")
    return best, least


class Instant:
    """The equations of motion near a state of a scene; arrays in the order of Pinocchio's velocity coordinates.

    tau (nv,): joint torques, zero by default. decide: find out which contacts stick, slip and open at the state, as a
    run that starts there would; otherwise closed contacts with friction that are at rest are taken to stick.
    q, v, tau, t: the state; `system` holds the last evaluation.
    Raises ArgumentError for a state of another scene, StateError for a bad tau, SolverError or SingularContactError
    where the state has no accelerations.
    """

    def __init__(self, scene: Scene, state: State, tau: Any | None = None, decide: bool = True) -> None:
        check_state(scene, state)
        self.scene, self.model = scene, scene.model
        contacts = list(scene.contacts.values())
        self.system = system = System(scene.model, contacts, resistances=True)
        self.t = float(state.t)
        self.tau = check_vector("tau", np.zeros(system.nv) if tau is None else tau, system.nv)
        self.q, self.v = state.q.copy(), state.v.copy()
        self._location = state.location.copy()
        system.tau[:] = self.tau
        write_discrete(system, state.discrete)
        self._set_modes(state, decide)
        self.evaluate()
        self._location = system.location[: system.nc].copy()
        # the natural length of the motion in m, by which steps of differences are chosen
        lengths = system.contact_real[: system.nc, LENGTH]
        self.length = min(1.0, float(lengths.min(initial=1.0)))

    def _set_modes(self, state: State, decide: bool) -> None:
        system = self.system
        names = list(self.scene.contacts)
        rk = RungeKutta(system, tableau("DOP853"), 1e-10, 1e-12, None)
        rk.begin_at(state.q, state.v, state.location)
        transitions = Transitions(rk, names, [0.0] * system.nc, 0.0)
        try:
            if decide:
                transitions.begin(self.t)
            else:
                rk.evaluate(self.t)
                transitions.modes_from_velocities()
        except Stop as stop:
            kind = SingularContactError if stop.code == SINGULAR_CONTACT else SolverError
            raise kind(stop.args[0]) from None

    # ---------------------------------------------------------------- evaluation

    def evaluate(
        self,
        q: np.ndarray | None = None,
        v: np.ndarray | None = None,
        tau: np.ndarray | None = None,
        t: float | None = None,
    ) -> np.ndarray:
        """Accelerations (nv,) at (q, v, tau, t), each by default the state's own; a copy."""
        system = self.system
        system.q[:] = self.q if q is None else q
        system.v[:] = self.v if v is None else v
        system.tau[:] = self.tau if tau is None else tau
        system.location[: system.nc] = self._location
        status = system.evaluate(self.t if t is None else t)
        if status > EVENT:
            code, reason = FAILURES[status]
            raise (SingularContactError if code == SINGULAR_CONTACT else SolverError)(reason)
        return system.acceleration.copy()

    def moved(self, direction: np.ndarray, q: np.ndarray | None = None) -> np.ndarray:
        """The configuration moved along a tangent direction (nv,)."""
        return pin.integrate(self.model, self.q if q is None else q, direction)

    def step_along(self, direction: np.ndarray) -> float:
        """First step of differences along a configuration direction (nv,) in m and rad."""
        return FIRST_STEP * self.length / max(float(np.abs(direction).max(initial=0.0)), 1e-300)

    def starting(self) -> list[str]:
        """Contacts that begin to slip, or to turn against their resistance, at this very state."""
        names = list(self.scene.contacts)
        return [names[self.system.owner(int(i))] for i in np.flatnonzero(self.system.contact_int[:, FROZEN])]

    def follow(self) -> None:
        """Look for contact points from those of the last evaluation on, in charts that suit them."""
        system = self.system
        start = system.nq + system.nv
        here = slice(start, start + 4 * system.nc)
        system.state[here] = system.location[: system.nc].ravel()
        move_charts(system.table)
        self._location = system.state[here].reshape(system.nc, 4).copy()

    # ---------------------------------------------------------------- constraints

    def constrained(self) -> list[tuple[int, int]]:
        """(item, basis row) of every constrained component of v_c, or of omega where turning is resisted: normals,
        then tangents in stick. Items are contacts, then resistances to turning."""
        integers = self.system.contact_int
        normals, tangents = [], []
        for c in [*self.system.closed(), *self.system.resisting()]:
            if c < self.system.nc:
                normals.append((c, 2))
            if integers[c, PATTERN] == ON_CURVE:
                normals.append((c, 1))
            if integers[c, MODE] == STICK:
                tangents += [(c, row) for row in range(integers[c, TANGENTS])]
        return normals + tangents

    def holonomic(self) -> list[tuple[int, int]]:
        """The rows among `constrained` that are rates of gaps (GC)."""
        integers = self.system.contact_int
        return [
            (c, row) for c, row in self.constrained() if row == 2 or (row == 1 and integers[c, PATTERN] == ON_CURVE)
        ]

    def rows(self, which: list[tuple[int, int]]) -> np.ndarray:
        """(len(which), nv) constraint rows of the last evaluation."""
        out = [self.system.rows[c, row] for c, row in which]
        return np.array(out).reshape(len(which), self.system.nv)

    def velocities(self, which: list[tuple[int, int]]) -> np.ndarray:
        """Components of v_c of the last evaluation, drives included."""
        return np.array([self.system.basis[c, row] @ self.system.slip[c] for c, row in which])

    def gaps(self, which: list[tuple[int, int]]) -> np.ndarray:
        """Gaps in m of holonomic rows of the last evaluation."""
        return np.array([self.system.gaps[c, 2 - row] for c, row in which])

    def biases(self, which: list[tuple[int, int]]) -> np.ndarray:
        """The part of the constrained components' rates that accelerations do not make."""
        return np.array([self.system.bias[c, row] for c, row in which])

    def projected(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(q, v) near the state moved onto the constraints.

        Raises SolverError where they are too far away.
        """
        constrained, holonomic = self.constrained(), self.holonomic()
        for _ in range(_PROJECTIONS):
            self.evaluate(q, v)
            gaps = self.gaps(holonomic)
            if np.abs(gaps).max(initial=0.0) <= 1e-13 * self.length:
                break
            q = self.moved(-self._shortest_change(holonomic, gaps), q)
        else:
            raise SolverError("the constraints cannot be satisfied near this state")
        return q, v - self._shortest_change(constrained, self.velocities(constrained))

    def row_size(self, item: int) -> float:
        """What the size of an item's rows, in the metric of the mass matrix, could be if nothing in them cancelled."""
        system = self.system
        c = system.owner(item)
        size = 0.0
        for side in (2 * c, 2 * c + 1):
            point = system.frames[side, ORIGIN] + system.derivatives[side, 0]
            linear, angular = jacobians(system, side, point)
            size = math.hypot(size, float(np.linalg.norm(whiten(system, (linear if item == c else angular).T))))
        return size

    def directions(self, which: list[tuple[int, int]]) -> Directions:
        """The constraint rows of the last evaluation, in the metric of the mass matrix."""
        sizes = {item: self.row_size(item) for item, _ in which}
        return Directions(whiten(self.system, self.rows(which).T), np.array([sizes[item] for item, _ in which]))

    def least_change(self, which: list[tuple[int, int]], wanted: np.ndarray) -> np.ndarray:
        """(nv,) or (nv, k) the change of velocity, least in the norm of the mass matrix, that changes the constrained
        components by what is wanted, (len(which),) or (len(which), k)."""
        return unwhiten(self.system, self.directions(which).reach(wanted))

    def _shortest_change(self, which: list[tuple[int, int]], wanted: np.ndarray) -> np.ndarray:
        """As `least_change`, but the least in the coordinates themselves."""
        change, free = self.least_change(which, wanted), self.free_directions(which)
        return np.asarray(change - free @ (free.T @ change))

    def free_directions(self, which: list[tuple[int, int]]) -> np.ndarray:
        """(nv, n) orthonormal velocities that leave the constrained components as they are."""
        return np.linalg.qr(unwhiten(self.system, self.directions(which).complement))[0]

    # ---------------------------------------------------------------- results

    def forces(self) -> dict[str, np.ndarray]:
        """Contact -> force (3,) on the second contour given, world axes, of the last evaluation."""
        system = self.system
        out = {}
        for c, contact in enumerate(system.contacts):
            sign = 0.0 if system.contact_int[c, MODE] == FREE else -1.0 if contact.swapped else 1.0
            out[contact.name] = sign * (system.basis[c].T @ system.force[c]) + 0.0
        return out

    def torques(self) -> dict[str, np.ndarray]:
        """Contact -> torque (3,) that resists its turning, on the second contour given, world axes."""
        system = self.system
        out = {contact.name: np.zeros(3) for contact in system.contacts}
        for item in system.resisting():
            contact = system.contacts[system.owner(item)]
            out[contact.name] += (-1.0 if contact.swapped else 1.0) * (system.basis[item].T @ system.force[item])
        return out

    def points(self) -> dict[str, np.ndarray]:
        """Contact -> contact point (3,), world, of the last evaluation."""
        system = self.system
        return {
            contact.name: system.frames[2 * c + 1, 3] + system.derivatives[2 * c + 1, 0]
            for c, contact in enumerate(system.contacts)
        }

    def holds(self) -> bool:
        """Whether in the last evaluation no unilateral contact pulls and no sticking one exceeds its limit."""
        margins = self.system.margins
        slack = -_FORCE_ROUND_OFF * max(1.0, float(np.abs(self.system.bias_forces).max(initial=0.0)))
        return all(
            margins[c, NORMAL_MARGIN] >= slack and margins[c, FRICTION_MARGIN] >= slack
            for c in [*self.system.closed(), *self.system.resisting()]
        )

    def driven(self) -> bool:
        """Whether anything depends on time explicitly."""
        return any(c.motion is not None or c.contour.time_dependent for c in self.scene.contours.values())

    def slips(self) -> bool:
        """Whether any contact slides with friction, or turns against its resistance."""
        return bool((self.system.contact_int[:, MODE] == SLIPPING).any())

    def state(self, q: np.ndarray, v: np.ndarray) -> State:
        """The state at (q, v), contact points followed from this one's."""
        self.evaluate(q, v)
        system = self.system
        return State(
            self.scene,
            system.q.copy(),
            system.v.copy(),
            self.t,
            system.location[: system.nc].copy(),
            read_discrete(system),
            Correction({}, {}, 0.0, 0.0),
        )
