"""A scene's equations around one state, with the mode of every contact held as it is there."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ..dynamics.energy import REST_SPEED
from ..dynamics.joints import JointLimit, joint_limits
from ..dynamics.redistribution import RedundantForces
from ..dynamics.units import unwhiten, whiten
from ..errors import SingularContactError, SolverError
from ..geometry.carriers import ORIGIN
from ..geometry.chart_changes import move_charts
from ..geometry.patterns import ON_CURVE
from ..integration.accuracy import REST
from ..integration.contradictions import apart, refuse_apart
from ..integration.discrete import write_discrete
from ..integration.resolution import FORCE_ROUND_OFF
from ..integration.results import FAILURES, SINGULAR_CONTACT, Stop
from ..integration.run_system import RunSystem
from ..integration.runge_kutta import RungeKutta
from ..integration.tableaux import tableau
from ..integration.transitions import Transitions
from ..layout import (
    CURVE_SPEED,
    EVENT,
    FREE,
    FRICTION_EVENT,
    FROZEN,
    HIGH_END,
    JOINT_END,
    JOINT_SIGN,
    LENGTH,
    LOW_END,
    MODE,
    MU_STATIC,
    NO_FORCE,
    NORMAL_EVENT,
    PATTERN,
    SLIPPING,
    STICK,
    TANGENTS,
)
from ..state import Correction, State, check_state, check_vector, coordinates_of, state_of
from .ranks import Directions

if TYPE_CHECKING:
    from ..scene import Scene

# Richardson's table: halvings of the step. The first step is a tenth of the natural length, where the truncation error
# of the last columns is far below round-off.
_LEVELS = 7
FIRST_STEP = 0.1
# Differences that are all below so many times their estimated errors are round-off: nothing changes.
ABOVE_NOISE = 10.0
# The part of a step of differences over which it is found how fast slip changes along it.
_PROBE = 1e-5
# Projections of a configuration at most, until gaps are less than this part of the natural length.
_PROJECTIONS, _CLOSED = 20, 1e-13


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


def jacobian(
    f: Callable[[np.ndarray], np.ndarray],
    directions: np.ndarray,
    steps: Sequence[float] | np.ndarray,
    levels: int = _LEVELS,
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of f at zero along directions (n, k), one a column, and their k estimated errors; steps: the first
    ones of differences along each. See `derivative`."""
    found = [derivative(lambda h, x=x: f(h * x), step, levels) for x, step in zip(directions.T, steps)]  # type: ignore[misc]
    columns, errors = [column for column, _ in found], np.array([error for _, error in found])
    return np.stack(columns, axis=-1) if columns else np.zeros((f(np.zeros(len(directions))).size, 0)), errors


class Instant:
    """The equations of motion near a state of a scene; arrays in the order of Pinocchio's velocity coordinates.

    tau (nv,): joint torques, zero by default. decide: find out which contacts stick, slip and open at the state, and
    which joints are held by dry friction or an end of their way, as a run that starts there would. Otherwise closed
    contacts with friction that are at rest are taken to stick, and joints at rest are free; those that move have their
    dry friction.
    q, v, tau, t: the state; `system` holds the last evaluation.
    Raises ArgumentError for a state of another scene, StateError for a bad tau, SolverError or SingularContactError
    where the state has no accelerations.
    """

    def __init__(self, scene: Scene, state: State, tau: Any | None = None, decide: bool = True) -> None:
        check_state(scene, state)
        self.scene, self.model = scene, scene.model
        self._coordinates = coordinates_of(scene.model)
        contacts = list(scene.contacts.values())
        self.system = system = RunSystem(scene.model, contacts, limits=joint_limits(scene.model), resistances=True)
        self.tau = check_vector("tau", np.zeros(system.nv) if tau is None else tau, system.nv)
        # forces of the modes at hand are of no use where they are not decided
        self._decide = decide
        self._take(state, decide)
        # the natural length of the motion in m, by which steps of differences are chosen
        lengths = system.contact_real[: system.nc, LENGTH]
        self.length = min(1.0, float(lengths.min(initial=1.0)))

    def move_to(self, state: State) -> None:
        """Take another state of the scene, with contacts and joints as for `decide=False`.

        Contacts that stick in the state, as the last step of time stepping left it, do so here, too, where they creep.
        """
        check_state(self.scene, state, self._coordinates)
        self._take(state, False)
        modes = self.system.contact_int[: self.system.nc, MODE]
        started = np.flatnonzero((modes == SLIPPING) & (state.discrete[:, 0] == STICK))
        if not started.size:
            return
        creeping = started[np.linalg.norm(self._slip(started), axis=1) <= REST_SPEED]
        if creeping.size:
            modes[creeping] = STICK
            self.evaluate()

    def _take(self, state: State, decide: bool) -> None:
        system = self.system
        self.t, self.q, self.v = float(state.t), state.q.copy(), state.v.copy()
        self._location = state.location.copy()
        system.tau[:] = self.tau
        write_discrete(system, state.discrete)
        self._set_modes(state, decide)
        self.evaluate()
        self._location = system.location[: system.nc].copy()

    @cached_property
    def _transitions(self) -> Transitions:
        rk = RungeKutta(self.system, tableau("DOP853"), 1e-10, 1e-12, None)
        return Transitions(rk, list(self.scene.contacts), [0.0] * self.system.nc, 0.0)

    def _set_modes(self, state: State, decide: bool) -> None:
        system, transitions = self.system, self._transitions
        rk = transitions.rk
        rk.begin_at(state.q, state.v, state.location)
        try:
            if decide:
                transitions.begin(self.t)
            else:
                rk.evaluate(self.t)
                refuse_apart(apart(system, system.closed()))
                transitions.changes.set_from_velocities()
                slow = self._rest_speed
                for g, limit in enumerate(system.limits):
                    speed = float(self.v[limit.index_v])
                    transitions.modes.release(g, 0 if abs(speed) <= slow else 1 if speed > 0.0 else -1)
        except Stop as stop:
            kind = SingularContactError if stop.code == SINGULAR_CONTACT else SolverError
            raise kind(stop.args[0]) from None

    def at_rest(self, speed: float) -> bool:
        """Whether a joint velocity is round-off."""
        return abs(speed) <= self._rest_speed

    @property
    def _rest_speed(self) -> float:
        return REST * (1.0 + float(np.abs(self.v).max(initial=0.0)))

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
        if status > EVENT and (self._decide or status != NO_FORCE):
            code, reason = FAILURES[status]
            raise (SingularContactError if code == SINGULAR_CONTACT else SolverError)(reason)
        return system.acceleration.copy()

    def moved(self, direction: np.ndarray, q: np.ndarray | None = None) -> np.ndarray:
        """The configuration moved along a tangent direction (nv,), but for what is locked."""
        return pin.integrate(self.model, self.q if q is None else q, direction * self.system.moves)

    def varied(self, change: np.ndarray, q: np.ndarray | None = None, v: np.ndarray | None = None) -> np.ndarray:
        """Accelerations where a change (2 nv,) has moved (q, v), by default the state's own."""
        dq, dv = np.split(change, 2)
        return self.evaluate(self.moved(dq, q), (self.v if v is None else v) + dv)

    def step_along(self, change: np.ndarray, q: np.ndarray | None = None, v: np.ndarray | None = None) -> float:
        """First step of differences along a change (2 nv,) of the configuration, in m and rad, and of the velocity,
        from (q, v), by default the state's own.

        Accelerations are quadratic in v but for slip, whose direction turns, and whose friction changes, within a
        change of v_c of its own size.
        """
        largest = np.abs(change.reshape(2, -1)).max(axis=1, initial=0.0)
        fastest = max(1.0, float(np.abs(self.v if v is None else v).max(initial=0.0)))
        step = FIRST_STEP / max(*(largest / [self.length, fastest]).tolist(), 1e-300)
        sliding = np.flatnonzero(self.system.contact_int[:, MODE] == SLIPPING)
        if not sliding.size:
            return step
        probe, slips = _PROBE * step, []
        for h in (-probe, probe):
            self.varied(h * change, q, v)
            slips.append(self._slip(sliding))
        rate = np.linalg.norm(slips[1] - slips[0], axis=1) / (2.0 * probe)
        size = np.linalg.norm(0.5 * (slips[0] + slips[1]), axis=1)
        scale = self.system.contact_real[sliding, CURVE_SPEED]
        size = np.minimum(size, np.where(scale > 0.0, scale, math.inf))
        return float(min(step, FIRST_STEP * (size / np.maximum(rate, 1e-300)).min()))

    def _slip(self, items: np.ndarray) -> np.ndarray:
        """(len(items), 2) tangential components of v_c, or of omega, that friction sees, of the last evaluation."""
        system = self.system
        along = np.einsum("cij,cj->ci", system.basis[items, :2], system.slip[items])
        along[system.contact_int[items, TANGENTS] < 2, 1] = 0.0
        return along

    def starting(self) -> list[str]:
        """What begins to slip, to turn against its resistance or to move against its dry friction at this state."""
        system = self.system
        moving = [abs(float(self.v[limit.index_v])) > self._rest_speed for limit in system.limits]
        signs = system.joint_int[: system.ng, JOINT_SIGN]
        items = np.flatnonzero(system.contact_int[:, FROZEN]).tolist()
        items += [system.nc + g for g in range(system.ng) if signs[g] != 0 and not moving[g]]
        return [self._name(item) for item in items]

    def at_limit(self) -> list[str]:
        """What rests with friction just at its limit: it would move for one sign of a deviation. Nothing where forces
        are redundant, of which others might bear."""
        system, constrained = self.system, self.constrained()
        if self.directions(constrained).redundant:
            return []
        friction, normal = system.event_functions[:, FRICTION_EVENT], system.event_functions[:, NORMAL_EVENT]
        sticks = (system.contact_int[:, MODE] == STICK) & np.isfinite(system.contact_real[:, MU_STATIC])
        margins, joints = np.where(sticks, friction, math.inf), slice(system.nc, system.nc + system.ng)
        margins[joints] = np.minimum(friction, normal)[joints]
        least = FORCE_ROUND_OFF * float(np.abs([system.bias_forces, self.tau]).max(initial=0.0))
        return [self._name(i) for i in dict.fromkeys(item for item, _ in constrained) if margins[i] < least]

    def _name(self, item: int) -> str:
        """What an item is called in messages."""
        limit = self._limit(item)
        if limit is not None:
            return f"joint {limit.joint!r}"
        return f"contact {self.system.contacts[self.system.owner(item)].name!r}"

    def _limit(self, item: int) -> JointLimit | None:
        """The limited joint coordinate that is this item."""
        g = item - self.system.nc
        return self.system.limits[g] if 0 <= g < self.system.ng else None

    def follow(self) -> None:
        """Look for contact points from those of the last evaluation on, in charts that suit them."""
        location = self.system.parts(self.system.state)[2]
        location[:] = self.system.location[: self.system.nc]
        move_charts(self.system.address)
        self._location = location.copy()

    # ---------------------------------------------------------------- constraints

    def constrained(self) -> list[tuple[int, int]]:
        """(item, basis row) of every constrained component of v_c, of omega where turning is resisted, or of a held
        joint's velocity: normals, then tangents in stick. Items are those of `RunSystem`."""
        integers = self.system.contact_int
        normals, tangents = [], [(self.system.nc + g, 2) for g in self.system.held()]
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
        system = self.system
        by_friction = {system.nc + g for g in system.held() if system.joint_int[g, JOINT_END] == 0}
        on_curves = set(np.flatnonzero(system.contact_int[:, PATTERN] == ON_CURVE).tolist())
        return [
            (c, row) for c, row in self.constrained() if c not in by_friction and row >= (1 if c in on_curves else 2)
        ]

    def rows(self, which: list[tuple[int, int]]) -> np.ndarray:
        """(len(which), nv) constraint rows of the last evaluation."""
        out = [self.system.rows[c, row] for c, row in which]
        return np.array(out).reshape(len(which), self.system.nv)

    def velocities(self, which: list[tuple[int, int]]) -> np.ndarray:
        """Components of v_c of the last evaluation, drives included."""
        return np.array([self.system.basis[c, row] @ self.system.slip[c] for c, row in which])

    def gaps(self, which: list[tuple[int, int]]) -> np.ndarray:
        """Gaps in m of holonomic rows of the last evaluation; ways of held joints to their ends."""
        return np.array([self.system.gaps[c, 2 - row] - self._end(c) for c, row in which])

    def _end(self, item: int) -> float:
        """Where a joint coordinate that is held at an end has it; 0 for contacts."""
        if self._limit(item) is None:
            return 0.0
        g = item - self.system.nc
        return float(self.system.joint_real[g, LOW_END if self.system.joint_int[g, JOINT_END] < 0 else HIGH_END])

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
            if np.abs(gaps).max(initial=0.0) <= _CLOSED * self.length:
                break
            q = self.moved(-self._shortest_change(holonomic, gaps), q)
        else:
            raise SolverError("the constraints cannot be satisfied near this state")
        return q, v - self._shortest_change(constrained, self.velocities(constrained))

    def row_size(self, item: int) -> float:
        """What the size of an item's rows, in the metric of the mass matrix, could be if nothing in them cancelled."""
        system = self.system
        if self._limit(item) is not None:
            return float(np.linalg.norm(whiten(system, system.rows[item, 2])))
        c = system.owner(item)
        size = 0.0
        for side in (2 * c, 2 * c + 1):
            point = system.frames[side, ORIGIN] + system.derivatives[side, 0]
            linear, angular = system.jacobians(side, point)
            size = math.hypot(size, float(np.linalg.norm(whiten(system, (linear if item == c else angular).T))))
        return size

    def directions(self, which: list[tuple[int, int]]) -> Directions:
        """The constraint rows of the last evaluation, in the metric of the mass matrix."""
        sizes = {item: self.row_size(item) for item, _ in which}
        columns, lengths = whiten(self.system, self.rows(which).T), np.array([sizes[item] for item, _ in which])
        return Directions(columns, lengths, self.system.moves)

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
        second = slice(1, 2 * system.nc, 2)
        points = system.frames[second, ORIGIN] + system.derivatives[second, 0]
        return {contact.name: point for contact, point in zip(system.contacts, points)}

    def holds(self) -> bool:
        """Whether in the last evaluation nothing unilateral pulls and nothing that rests exceeds its friction. Of
        redundant forces those inside all cones are chosen where the least are not, if there are any."""
        return self._lies_within() or RedundantForces(self.system).choose(self.t, self.system.evaluate)

    def _lies_within(self) -> bool:
        """Whether all forces of the last evaluation are within their bounds, but for round-off."""
        system = self.system
        items = [*system.closed(), *system.resisting(), *(system.nc + g for g in system.held())]
        margins = system.event_functions[items][:, [NORMAL_EVENT, FRICTION_EVENT]]
        slack = FORCE_ROUND_OFF * max(1.0, float(np.abs(system.bias_forces).max(initial=0.0)))
        return bool((margins >= -slack).all())

    def driven(self) -> bool:
        """Whether anything depends on time explicitly."""
        return any(c.motion is not None or c.contour.time_dependent for c in self.scene.contours.values())

    def slips(self) -> bool:
        """Whether any contact slides with friction, or turns against its resistance."""
        return bool((self.system.contact_int[:, MODE] == SLIPPING).any())

    def state(self, q: np.ndarray, v: np.ndarray) -> State:
        """The state at (q, v), contact points followed from this one's."""
        self.evaluate(q, v)
        return state_of(self.scene, self.system, self.t, Correction())
