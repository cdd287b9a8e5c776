"""Fixed steps for controllers and learning loops: torque in, state and contact forces out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .arguments import NOT_REAL, is_count, is_number, real_array
from .display import shortened
from .dynamics.joints import joint_guards
from .errors import ArgumentError, SingularContactError, SolverError, StateError
from .friction.solve import check_contact_solver
from .integration.discrete import discrete_views, read_discrete, views_of_system
from .integration.moreau import DEFAULT_STEP, MoreauStep
from .integration.run_system import RunSystem
from .layout import LOCATION_FAILED, NOT_FINITE, OK, SINGULAR
from .scene import Scene
from .state import State, check_state, check_vector, coordinates_of


class Stepper:
    """Advances a scene by constant steps with the torque held constant in each (method "Moreau" of `simulate`).

    All arrays are allocated once. `q` (nq,), `v` (nv,), `modes` (nc,) and the arrays in `forces` (N), in `torques`
    (N m, what resists spinning and rolling) and in the state that `step` returns are views that the next step
    overwrites; `state` makes copies. The same start and the same torques give the same numbers to the last bit, and so
    does a stepper that is copied or pickled in between.

        stepper = pc.Stepper(scene, state, dt=1e-3)
        while True:
            state = stepper.step(controller(stepper.t, stepper.q, stepper.v))

    Parameters
    ----------
    scene : Scene
        The scene.
    state : State
        Where it starts, a state of this scene.
    dt : float
        Step in s.
    contact_solver : {"auto", "proxqp"}
        How Coulomb's law is solved, as for `simulate`.

    Raises
    ------
    ArgumentError
        For a dt that is not positive and finite, a state of another scene, or another contact_solver.
    """

    def __init__(self, scene: Scene, state: State, dt: float = DEFAULT_STEP, contact_solver: str = "auto") -> None:
        if not (is_number(dt) and 0.0 < dt < math.inf):
            raise ArgumentError(f"dt must be a positive number of seconds, got {dt!r}")
        check_contact_solver(contact_solver)
        check_state(scene, state)
        self.scene, self.dt, self._contact_solver = scene, float(dt), contact_solver
        self._coordinates = coordinates_of(scene.model)
        contacts = list(scene.contacts.values())
        self._system = system = RunSystem(scene.model, contacts, guards=joint_guards(scene.model))
        self._step = MoreauStep(system, contacts)
        self._step.cones.choose(contact_solver)
        nq, nv, nc = system.nq, system.nv, system.nc
        self.q, self.v = (_locked(part) for part in (system.state[:nq], system.state[nq : nq + nv]))
        self._location = _locked(system.state[nq + nv : nq + nv + 4 * nc].reshape(nc, 4))
        self._discrete_buffer = discrete = read_discrete(system)
        self._shown = discrete_views(discrete, *self._step.known)
        self._written = views_of_system(discrete, system)
        self._discrete = _locked(discrete)
        self.modes = self._discrete[:, 0]
        self.forces = {name: _locked(self._step.forces[c]) for c, name in enumerate(scene.contacts)}
        self.torques = {name: _locked(self._step.torques[c]) for c, name in enumerate(scene.contacts)}
        self._shape, self._tau = (nv,), system.tau
        self._parts = vars(State(scene, self.q, self.v, 0.0, self._location, self._discrete))
        self._start = 0.0
        self.reset(state)

    @property
    def t(self) -> float:
        """Time in s."""
        return self._start + self._step.steps * self.dt

    @property
    def state(self) -> State:
        """The present state, with arrays of its own: to keep, to reset to, or to simulate from."""
        q, v, location, discrete = (a.copy() for a in (self.q, self.v, self._location, self._discrete))
        return State(self.scene, q, v, self.t, location, discrete)

    def reset(self, state: State) -> None:
        """Start again from a state of the same scene, as if newly made.

        Raises ArgumentError for a state of another scene, SingularContactError where its contacts degenerate.
        """
        check_state(self.scene, state, self._coordinates)
        system = self._system
        nq, nv = system.nq, system.nv
        # a state of this very stepper may be made of views of what is written here: of the same parts
        system.state[:nq], system.state[nq : nq + nv] = state.q, state.v
        system.state[nq + nv : nq + nv + state.location.size] = state.location.ravel()
        self._discrete_buffer[:] = state.discrete
        for source, target in self._written:
            target[...] = source
        system.tau[:] = 0.0
        self._start = float(state.t)
        self._step.set_run(self._start, math.inf, self.dt, 0, 0, False)
        self._step.forget()
        self._raise_for(self._step.begin(self._start))
        self._show_modes()

    def step(self, tau: Any, count: int = 1) -> State:
        """One step, or count of them, under the joint torques tau (nv,) (N, N m), which are held constant; returns the
        state at the end, made of views.

        Raises StateError for a tau of another shape or with entries that are not finite, ArgumentError for a count
        below 1, SingularContactError where contacts degenerate, SolverError where no impulses were found, and what a
        callable motion raises, as it is; the stepper is then where the last step that could be made has ended.
        """
        tau = self._check_torque(tau)
        if type(count) is not int or count != 1:
            count = _check_count(count)
        step = self._step
        self._tau[:] = tau
        try:
            status = step.advance(count)
        except BaseException:
            # an interrupt, say, or what a motion raised
            self._show_modes()
            raise
        if status != OK:
            self._show_modes()
            if status == NOT_FINITE:
                check_vector("tau", tau, tau.size)
            self._raise_for(status)
        if count > 1 or step.changed:
            self._show_modes()
        # as State(...) would, at a quarter of its price
        state = State.__new__(State)
        state.__dict__.update(self._parts)
        state.__dict__["t"] = self.t
        return state

    def rollout(self, torques: Any, count: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Steps under the torques (N, N m) in each of n rows (n, nv), every one held for count steps; returns q (n, nq)
        and v (n, nv) after each row: for sampling and learning, without a call a step.

        Raises what `step` does; the stepper is then where the last step that could be made has ended, at `t`.
        """
        rows = self._check_rows(torques)
        count = _check_count(count)
        if not len(rows):
            return np.empty((0, self.q.size)), np.empty((0, self.v.size))
        try:
            status, q, v = self._step.advance_by_rows(rows, count)
        finally:
            self._show_modes()
        if status == NOT_FINITE and not np.isfinite(rows).all():
            i, j = np.argwhere(~np.isfinite(rows))[0]
            raise StateError(f"torques[{i}, {j}] is {rows[i, j]}")
        self._raise_for(status)
        return q, v

    def _show_modes(self) -> None:
        """Modes, signs and charts are those after the last step, whatever may have been attempted since."""
        for target, source in self._shown:
            target[...] = source

    def _check_torque(self, tau: Any) -> np.ndarray:
        if type(tau) is not np.ndarray or tau.dtype != np.float64 or tau.shape != self._shape:
            if np.shape(tau) != self._shape:
                raise StateError(f"tau must have shape {self._shape}, got {np.shape(tau)}")
            return check_vector("tau", tau, self._shape[0])
        # entries that are not finite make accelerations that are not, which costs nothing to notice
        return tau

    def _check_rows(self, torques: Any) -> np.ndarray:
        nv, rows = self._shape[0], torques
        if type(rows) is not np.ndarray or rows.dtype != np.float64:
            try:
                rows = real_array(torques)
            except NOT_REAL:
                raise StateError(f"torques must be numbers in rows of {nv}, got {torques!r}") from None
        if rows.ndim != 2 or rows.shape[1] != nv:
            raise StateError(f"torques must have shape (n, {nv}), got {rows.shape}")
        return rows

    def _raise_for(self, status: int) -> None:
        if status == OK:
            return
        message = self._step.describe(status, self.t).message
        if status in (SINGULAR, LOCATION_FAILED):
            raise SingularContactError(message)
        raise SolverError(message)

    def copy(self) -> Stepper:
        """Another stepper in the same situation, warm starts included: both go on alike, to the last bit."""
        twin = type(self).__new__(type(self))
        twin.__setstate__(self.__getstate__())
        return twin

    def __getstate__(self) -> dict[str, Any]:
        """What a pickled stepper consists of: its situation and the scene, not its memory."""
        return {
            "scene": self.scene,
            "state": self.state,
            "dt": self.dt,
            "contact_solver": self._contact_solver,
            "start": self._start,
            "step": self._step.kept(),
        }

    def __setstate__(self, kept: dict[str, Any]) -> None:
        Stepper.__init__(self, kept["scene"], kept["state"], kept["dt"], kept["contact_solver"])
        self._step.restore(kept["step"])
        self._show_modes()
        self._start = kept["start"]

    # buffers must not be shared; the scene, which does not change, is
    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Stepper:
        return self.copy()

    def __repr__(self) -> str:
        return f"<Stepper at t = {self.t:.9g} s, dt = {self.dt:g} s, contacts: {shortened(self.forces)}>"


def _check_count(count: Any) -> int:
    if not is_count(count):
        raise ArgumentError(f"count must be a whole number of steps, at least 1, got {count!r}")
    return int(count)


def _locked(array: np.ndarray) -> np.ndarray:
    """A view that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view
