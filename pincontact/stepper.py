"""Fixed steps for controllers and learning loops: torque in, state and contact forces out."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from .arguments import check_count, time_step
from .display import shortened
from .dynamics.joints import joint_limits
from .errors import SingularContactError, SolverError, StateError
from .friction.solve import check_contact_solver
from .integration.actuators import actuators_of
from .integration.contradictions import refuse_apart
from .integration.discrete import discrete_views, read_discrete, views_of_system
from .integration.moreau import DEFAULT_STEP, MoreauStep
from .integration.run_system import RunSystem
from .layout import LOCATION_FAILED, NOT_FINITE, OK, SINGULAR
from .scene import Scene
from .state import State, check_finite, check_rows, check_state, check_vector, coordinates_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


class Stepper:
    """Advances a scene by constant steps with the torque held constant in each (method "Moreau" of `simulate`).

    All arrays are allocated once. Those of the attributes, and of the state that `step` returns, are views that the
    next step overwrites; `state` makes copies. The same start and the same torques give the same numbers to the last
    bit, and so does a stepper that is copied or pickled in between. Steps are made without the interpreter's lock:
    steppers of their own run in threads side by side, one stepper belongs to one thread at a time.

    Parameters
    ----------
    scene : Scene
    state : State
        Where it starts, a state of this scene.
    dt : float, optional
        Step in s, 1e-3 if not given.
    contact_solver : {"auto", "proxqp"}
        How Coulomb's law is solved, as for `simulate`.
    step : float, optional
        Another name of dt.

    Attributes
    ----------
    q : (nq,) array
        Configuration, in m and rad.
    v : (nv,) array
        Velocity, in m/s and rad/s.
    modes : (nc,) array of int
        -1 open, 0 frictionless, 1 stick, 2 slip, in the order of the scene's contacts.
    forces : dict of str to (3,) array
        Mean force of each contact over the last step in N, on the second contour given, world axes.
    torques : dict of str to (3,) array
        What resists spinning and rolling in N m, likewise.
    target : (nq,) array
        Where the actuators of `pd` aim; may be written to between steps.
    actuation : (nv,) array
        Their mean torques over the last step, in N and N m.

    Raises
    ------
    ArgumentError
        For a dt that is not positive and finite or given by both its names, a state of another scene, or another
        contact_solver.
    StateError
        For a state whose numbers cannot be used.
    SingularContactError
        Where contacts degenerate at the state.

    Examples
    --------
    A ball is pushed for a tenth of a second, and rolls on:

    >>> import numpy as np
    >>> import pincontact as pc
    >>> scene = pc.Scene.from_urdf("urdf/ball.urdf", floating_base=True)
    >>> ball = scene.add_contour("ball", pc.Sphere(0.1), frame="ball")
    >>> floor = scene.add_contour("floor", pc.Plane())
    >>> contact = scene.add_contact("ball/floor", floor, ball, friction=pc.Coulomb(0.5))
    >>> stepper = pc.Stepper(scene, scene.initial_state([0, 0, 0.1, 0, 0, 0, 1]), dt=1e-3)
    >>> for _ in range(100):
    ...     state = stepper.step([0, 0, 0, 0, 0.2 - 0.01 * stepper.v[4], 0])
    >>> state = stepper.step([0] * 6, count=100)
    >>> speed, turning = np.linalg.norm(stepper.v[:3]), np.linalg.norm(stepper.v[3:])
    >>> round(stepper.t, 9), bool(speed > 0.2 and abs(speed - 0.1 * turning) < 1e-12)
    (0.2, True)
    >>> bool(abs(stepper.forces["ball/floor"][2] - 9.81 * scene.model.inertias[1].mass) < 1e-9)
    True
    """

    def __init__(
        self,
        scene: Scene,
        state: State,
        dt: float | None = None,
        contact_solver: str = "auto",
        *,
        step: float | None = None,
    ) -> None:
        dt = time_step(dt, step) or DEFAULT_STEP
        check_contact_solver(contact_solver)
        check_state(scene, state)
        contacts = list(scene.contacts.values())
        system = RunSystem(scene.model, contacts, limits=joint_limits(scene.model))
        self._make(scene, MoreauStep(system, contacts), dt, contact_solver)
        self.reset(state)

    def _make(self, scene: Scene, step: MoreauStep, dt: float, contact_solver: str) -> None:
        """All but the start, by steps that are as new and only this stepper's."""
        self.scene, self.dt, self._contact_solver = scene, dt, contact_solver
        self._coordinates = coordinates_of(scene.model)
        self._step = step
        self._system = system = step.system
        self._step.cones.choose(contact_solver)
        nv = system.nv
        self.q, self.v, self._location, _ = (_locked(part) for part in system.parts(system.state))
        self._discrete_buffer = discrete = read_discrete(system)
        self._shown = discrete_views(discrete, *self._step.known)
        self._written = views_of_system(discrete, system)
        self._discrete = _locked(discrete)
        self.modes = self._discrete[:, 0]
        self.forces = {name: _locked(self._step.forces[c]) for c, name in enumerate(scene.contacts)}
        self.torques = {name: _locked(self._step.torques[c]) for c, name in enumerate(scene.contacts)}
        self.target = self._step.target
        self.target[:] = pin.neutral(scene.model)
        self.actuation = _locked(self._step.step_arrays.actuation[:nv])
        self._shape, self._tau = (nv,), system.tau
        self._parts = vars(State(scene, self.q, self.v, 0.0, self._location, self._discrete))
        self._start = 0.0

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
        """Start again from a state of the same scene, as if newly made; actuators and their target stay.

        Parameters
        ----------
        state : State

        Raises
        ------
        ArgumentError
            For a state of another scene.
        StateError
            For a state whose numbers cannot be used, or whose closed contacts are apart.
        SingularContactError
            Where its contacts degenerate.
        SolverError
            Where it cannot begin for another reason.
        """
        check_state(self.scene, state, self._coordinates)
        self._raise_for(self._begin(state))

    def _begin(self, state: State) -> int:
        """Start from a state that has been checked; a status of `layout`."""
        system = self._system
        # a state of this very stepper may be made of views of what is written here: of the same parts
        system.put_state(system.state, state.q, state.v, state.location)
        self._discrete_buffer[:] = state.discrete
        for source, target in self._written:
            target[...] = source
        system.tau[:] = 0.0
        self._start = float(state.t)
        self._step.set_run(self._start, math.inf, self.dt, 0, 0, False)
        self._step.forget()
        status = self._step.begin(self._start)
        refuse_apart(self._step.apart)
        self._show_modes()
        return status

    def pd(self, kp: ArrayLike, kd: ArrayLike, target: ArrayLike) -> None:
        """Give the joints PD actuators, in place of those that they had.

        Their torques are kp (target - q) - kd v, to which the tau of `step` is added. They act implicitly, also in the
        cone problems of contacts: no gains make the steps unstable, and steps are of second order in dt. What is too
        fast for dt is damped as by a step of its own length. To change the target write to `stepper.target`; a target
        velocity w is the tau kd w.

        Parameters
        ----------
        kp, kd : float or array_like (nv,)
            Gains in N m/rad and N m s/rad (N/m and N s/m of prismatic joints), at least 0. A number is the gain of
            every joint of one degree of freedom. kp is for coordinates that are a joint's own, also of unbounded
            rotations, where it pulls the shorter way round; not for free, planar and spherical joints. Locked joints,
            whose limits coincide, get no torque.
        target : array_like (nq,)
            Configuration in which they have no torque at rest; of coordinates without kp the number does not matter.

        Raises
        ------
        ArgumentError
            For gains that are negative, not finite, of another shape, or kp where no coordinate can have a target.
        StateError
            For a target of another size or with entries that are not finite.

        Examples
        --------
        >>> import pinocchio as pin, pincontact as pc
        >>> model = pin.buildSampleModelManipulator()
        >>> scene = pc.Scene(model)
        >>> stepper = pc.Stepper(scene, scene.initial_state(pin.neutral(model)), dt=1e-3)
        >>> stepper.pd(1e6, 2e3, [0.5] * model.nq)
        >>> for _ in range(1000):
        ...     _ = stepper.step([0.0] * model.nv)
        >>> bool(abs(stepper.q - 0.5).max() < 1e-3)
        True
        """
        actuators = actuators_of(self.scene.model, kp, kd)
        self.target[:] = check_vector("target", target, self.target.size)
        self._step.actuate(actuators)

    def step(self, tau: ArrayLike, count: int = 1) -> State:
        """One step, or several, under joint torques that are held constant.

        After an error the stepper is where the last step that could be made has ended. What a callable motion raises is
        passed on as it is.

        Parameters
        ----------
        tau : (nv,) array_like
            Joint torques in N and N m.
        count : int
            Number of steps, at least 1.

        Returns
        -------
        State
            At the end, made of views.

        Raises
        ------
        StateError
            For a tau of another shape or with entries that are not finite.
        ArgumentError
            For a count below 1.
        SingularContactError
            Where contacts degenerate.
        SolverError
            Where no impulses were found.
        """
        tau = self._check_torque(tau)
        if type(count) is not int or count != 1:
            check_count("count", count)
            count = int(count)
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
                check_vector("target", self.target, self.target.size)
            self._raise_for(status)
        if count > 1 or step.changed:
            self._show_modes()
        # as State(...) would, at a quarter of its price
        state = State.__new__(State)
        state.__dict__.update(self._parts)
        state.__dict__["t"] = self.t
        return state

    def rollout(self, torques: ArrayLike, count: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Steps under a sequence of torques, without a call from Python for each step: for sampling and learning.

        Parameters
        ----------
        torques : (n, nv) array_like
            Joint torques in N and N m, row by row.
        count : int
            Number of steps for which each row is held, at least 1.

        Returns
        -------
        q : (n, nq) array
            Configurations after each row, in m and rad.
        v : (n, nv) array
            Velocities, in m/s and rad/s.

        Raises
        ------
        StateError
            For torques of another shape or with entries that are not finite.
        ArgumentError, SingularContactError, SolverError
            As `step` does. The stepper is then where the last step that could be made has ended, at `t`.
        """
        rows = check_rows("torques", torques, self._shape[0], {2: "(n, {})"})
        check_count("count", count)
        if not len(rows):
            return np.empty((0, self.q.size)), np.empty((0, self.v.size))
        try:
            status, q, v = self._step.advance_by_rows(rows, int(count))
        finally:
            self._show_modes()
        if status == NOT_FINITE:
            check_finite("torques", rows)
            check_finite("target", self.target)
        self._raise_for(status)
        return q, v

    def _show_modes(self) -> None:
        """Modes, signs and charts are those after the last step, whatever may have been attempted since."""
        for target, source in self._shown:
            target[...] = source

    def _check_torque(self, tau: ArrayLike) -> np.ndarray:
        if type(tau) is not np.ndarray or tau.dtype != np.float64 or tau.shape != self._shape:
            if np.shape(tau) != self._shape:
                raise StateError(f"tau must have shape {self._shape}, got {np.shape(tau)}")
            return check_vector("tau", tau, self._shape[0])
        # entries that are not finite make accelerations that are not, which costs nothing to notice
        return tau

    def _raise_for(self, status: int) -> None:
        if status == OK:
            return
        message = self._step.describe(status, self.t).message
        if status in (SINGULAR, LOCATION_FAILED):
            raise SingularContactError(message)
        raise SolverError(message)

    def copy(self) -> Stepper:
        """Another stepper in the same situation, warm starts included: both go on alike, to the last bit.

        Returns
        -------
        Stepper
        """
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


def _locked(array: np.ndarray) -> np.ndarray:
    """A view that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view
