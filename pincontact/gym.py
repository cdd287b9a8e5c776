"""A Gymnasium environment on a scene: joint torques in, steps of `Stepper`, observations and rewards out.

Needs the extra `gym`; `import pincontact.gym` raises MissingExtraError without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, ClassVar

import numpy as np

from .arguments import NOT_REAL, check_count, real_array, reals
from .errors import ArgumentError, SingularContactError, SolverError
from .extras import required
from .scene import Scene
from .state import State, check_state
from .stepper import Stepper

required("gymnasium", "environments need gymnasium", "pincontact[gym]")
import gymnasium  # noqa: E402

__all__ = ["ContactEnv"]


def positions_and_velocities(stepper: Stepper) -> np.ndarray:
    """The observation unless another is given: q and v, (nq + nv,)."""
    return np.concatenate([stepper.q, stepper.v])


class ContactEnv(gymnasium.Env):
    """A scene as a Gymnasium environment.

    An action (n,) within [-1, 1] scales the torque limits of the actuated coordinates; the torques are held for
    `substeps` steps of `dt`. An episode is *terminated* where `terminate` says so. It is *truncated* after
    `max_episode_steps`, and where the scene cannot go on (no contact impulses were found, a contact degenerates): that
    belongs to the simulation, not to the task, and says nothing of the value of the state. The observation is then that
    of the last step that could be made, and `info["failure"]` says why.

    Equal seeds and actions give equal numbers, to the last bit.

    Parameters
    ----------
    scene : Scene
        The scene; environments may share it.
    state : State
        Where episodes start.
    joints : iterable of str
        Names of the actuated joints; all their velocity coordinates are, in this order.
    reward : callable
        `reward(stepper, torques)` is a number, after every action; stepper has q, v, t, forces and modes, torques (nv,)
        are those of the action.
    torque_limits : float or (n,) array, optional
        Largest torques or forces of the actuated coordinates, N m or N; the model's effort limits if not given.
    observe : callable, optional
        `observe(stepper)` is an array of constant shape; q and v in one if not given.
    terminate : callable, optional
        `terminate(stepper)` says whether the episode is over.
    start : callable, optional
        `start(rng)` is the State in which an episode starts, given a `numpy.random.Generator` that `reset` seeds.
    dt : float, optional
        Step in s, 1e-3 if not given.
    substeps : int
        Steps an action.
    max_episode_steps : int, optional
        Actions an episode.
    step : float, optional
        Another name of dt.

    Raises
    ------
    ArgumentError
        For a joint that the model does not have, limits that are not positive and finite, and what `Stepper` refuses.

    Examples
    --------
    A wheel in a vertical plane, which a torque on its axle drives along a floor:

    >>> import numpy as np
    >>> import pinocchio as pin
    >>> import pincontact as pc
    >>> from pincontact.gym import ContactEnv
    >>> model = pin.Model()
    >>> along = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "along")
    >>> up = model.addJoint(along, pin.JointModelPZ(), pin.SE3.Identity(), "up")
    >>> axle = model.addJoint(up, pin.JointModelRY(), pin.SE3.Identity(), "axle")
    >>> model.appendBodyToJoint(axle, pin.Inertia.FromSphere(2.0, 0.3), pin.SE3.Identity())
    >>> scene = pc.Scene(model)
    >>> wheel, floor = scene.add_contour("wheel", pc.Sphere(0.3), "axle"), scene.add_contour("floor", pc.Plane())
    >>> contact = scene.add_contact("c", wheel, floor, pc.Coulomb(0.8))
    >>> state = scene.initial_state([0.0, 0.3, 0.0])
    >>> env = ContactEnv(scene, state, ["axle"], lambda stepper, tau: stepper.v[0], torque_limits=1.0)
    >>> observation, info = env.reset(seed=0)
    >>> observation, reward, terminated, truncated, info = env.step(np.array([0.5]))
    >>> bool(reward > 0.0), terminated, truncated
    (True, False, False)
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self,
        scene: Scene,
        state: State,
        joints: Iterable[str],
        reward: Callable[[Stepper, np.ndarray], float],
        torque_limits: float | np.ndarray | None = None,
        observe: Callable[[Stepper], np.ndarray] = positions_and_velocities,
        terminate: Callable[[Stepper], bool] | None = None,
        start: Callable[[np.random.Generator], State] | None = None,
        dt: float | None = None,
        substeps: int = 10,
        max_episode_steps: int | None = None,
        *,
        step: float | None = None,
    ) -> None:
        if not isinstance(joints, Iterable):
            raise ArgumentError(f"joints must be names of joints, got {joints!r}")
        joints = [joints] if isinstance(joints, str) else list(joints)
        # what environments like this one are made from
        self._given = (scene, state, joints, reward, torque_limits, observe, terminate, start)
        for name, count in (("substeps", substeps), ("max_episode_steps", max_episode_steps)):
            check_count(name, count, optional=name == "max_episode_steps")
        for name, function in (("reward", reward), ("observe", observe), ("terminate", terminate), ("start", start)):
            if not (callable(function) or (function is None and name in ("terminate", "start"))):
                raise ArgumentError(f"{name} must be callable, got {function!r}")
        self.stepper = Stepper(scene, state, dt, step=step)
        self._steps_given = (self.stepper.dt, substeps, max_episode_steps)
        self._start_state, self._start = state, start
        self._observe, self._reward, self._terminate = observe, reward, terminate
        self._substeps, self._max_episode_steps = int(substeps), max_episode_steps
        self._columns = _columns(scene, joints)
        self._limits = _limits(scene, self._columns, torque_limits)
        self._tau = np.zeros(scene.model.nv)
        # actions of the episode so far; None where it is over, or none has begun
        self._taken: int | None = None
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self._columns),), np.float64)
        shape = self._observation().shape
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            Seeds the generator that `start` is given.
        options : dict, optional
            `{"state": State}`: where to start this time, as for a planner.

        Returns
        -------
        observation : array
            What `observe` makes of the start.
        info : dict
            `t`: time in s.

        Raises
        ------
        ArgumentError
            For other options, and for a state that is none of the scene.
        """
        super().reset(seed=seed)
        unknown = set(options or {}) - {"state"}
        if unknown:
            raise ArgumentError(f"reset takes the option 'state', got {', '.join(map(repr, sorted(unknown)))}")
        state = (options or {}).get("state")
        if state is None:
            state = self._start_state if self._start is None else self._start(self.np_random)
        check_state(self.stepper.scene, state)
        self.stepper.reset(state)
        self._taken = 0
        return self._observation(), {"t": self.stepper.t}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take an action.

        Parameters
        ----------
        action : (n,) array
            Torques as parts of their limits; what is beyond [-1, 1] is cut off.

        Returns
        -------
        observation : array
            After the action, or where it could not be finished.
        reward : float
        terminated, truncated : bool
            See `ContactEnv`.
        info : dict
            `t`: time in s; `failure`: why the scene could not go on, where that is so.

        Raises
        ------
        ArgumentError
            For an action of another shape, or that is not finite.
        gymnasium.error.ResetNeeded
            Where no episode has begun, or the last one is over.
        """
        if self._taken is None:
            raise gymnasium.error.ResetNeeded("the episode is over: reset the environment before the next action.")
        self._tau[self._columns] = self._limits * self._checked(action)
        info: dict[str, Any] = {}
        try:
            self.stepper.step(self._tau, self._substeps)
        except (SolverError, SingularContactError) as error:
            info["failure"] = str(error)
        self._taken += 1
        info["t"] = self.stepper.t
        reward = float(self._reward(self.stepper, self._tau))
        terminated = self._terminate is not None and bool(self._terminate(self.stepper))
        truncated = "failure" in info or self._taken == self._max_episode_steps
        if terminated or truncated:
            self._taken = None
        return self._observation(), reward, terminated, truncated, info

    def vector(self, count: int, autoreset_mode: str = "NextStep") -> gymnasium.vector.SyncVectorEnv:
        """Environments like this one side by side, each with a stepper of its own on the same scene.

        Parameters
        ----------
        count : int
            How many.
        autoreset_mode : {"NextStep", "SameStep", "Disabled"}
            When an environment whose episode is over begins the next one, as in Gymnasium.

        Returns
        -------
        gymnasium.vector.SyncVectorEnv
            Observations, rewards and ends have a row for each; `reset(seed=s)` seeds them with s, s + 1, ...

        Raises
        ------
        ArgumentError
            For a count below 1.
        """
        check_count("count", count)
        make = [lambda: type(self)(*self._given, *self._steps_given)] * int(count)
        return gymnasium.vector.SyncVectorEnv(make, autoreset_mode=autoreset_mode)

    def _observation(self) -> np.ndarray:
        return np.array(self._observe(self.stepper), dtype=np.float64)

    def _checked(self, action: Any) -> np.ndarray:
        parts = reals("an action must be an array of numbers", action)
        if parts.shape != self.action_space.shape:
            raise ArgumentError(f"an action must have shape {self.action_space.shape}, got {parts.shape}")
        if not np.isfinite(parts).all():
            raise ArgumentError(f"an action must be finite, got {action!r}")
        clipped: np.ndarray = np.clip(parts, -1.0, 1.0)
        return clipped


def _columns(scene: Scene, joints: list[str]) -> np.ndarray:
    """Velocity coordinates of these joints."""
    if not isinstance(scene, Scene):
        raise ArgumentError(f"the first argument must be a Scene, got {type(scene).__name__}")
    model = scene.model
    columns: list[int] = []
    for name in joints:
        if not isinstance(name, str) or not model.existJointName(name):
            raise ArgumentError(f"the model has no joint {name!r}; joints: {', '.join(list(model.names)[1:])}")
        joint = model.joints[model.getJointId(name)]
        columns += range(joint.idx_v, joint.idx_v + joint.nv)
    if len(set(columns)) != len(columns) or not columns:
        raise ArgumentError(f"joints must name at least one joint, and each once, got {joints!r}")
    return np.array(columns)


def _limits(scene: Scene, columns: np.ndarray, given: float | np.ndarray | None) -> np.ndarray:
    """(n,) torque limits of the actuated coordinates."""
    limits = scene.model.effortLimit[columns] if given is None else given
    try:
        limits = np.broadcast_to(real_array(limits), columns.shape)
    except NOT_REAL:
        raise ArgumentError(f"torque_limits must be a number, or {columns.size} of them, got {given!r}") from None
    if not (np.isfinite(limits).all() and (limits > 0.0).all()):
        where = " (not given: those of the model)" if given is None else ""
        raise ArgumentError(f"torque_limits{where} must be positive and finite, got {limits.tolist()}")
    return limits
