"""Run a scene: the call that users make."""

from __future__ import annotations

import inspect
import math
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .arguments import check_flag, is_count, is_number, reals, time_step
from .control import Control, torque_of
from .dynamics.energy import energy_gained
from .dynamics.joints import check_joint_limits
from .errors import ArgumentError, sentence
from .friction.solve import check_contact_solver
from .integration.discrete import read_discrete, write_discrete
from .integration.driver import Driver
from .integration.events import UserEvent
from .integration.options import Options
from .integration.pieces import Pieces
from .integration.results import (
    CHATTER,
    CONTROL_FAILED,
    MODEL_FAILED,
    NO_CONTACT_FORCE,
    STEP_TOO_SMALL,
    Event,
)
from .integration.runge_kutta import RungeKutta
from .integration.tableaux import Tableau, tableau
from .integration.transitions import Transitions
from .progress import progress_bar
from .records import Record
from .scene import Scene
from .solution import DenseOutput, time_slack
from .state import State, check_state
from .system_cache import put_back, take_system
from .trajectory import Trajectory

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .dynamics.system import System, Torque
    from .integration.moreau_driver import MoreauDriver

# Time steps are at least so long, relative to the latest time: shorter ones would not move it on.
_SHORTEST_STEP = float(np.finfo(float).eps)
# Rounding of times, relative to the duration, that a run reports: more than the default tolerance.
_LARGEST_ROUNDING = 1e-8
# What ends a run whose motion may go on all the same.
_FALLS_BACK = (STEP_TOO_SMALL, NO_CONTACT_FORCE, CHATTER, MODEL_FAILED)
# Errors of energy that a run of time stepping reports, by their names in its stats, and from which size on.
_TOLD = {
    "energy_gained": "the energy has grown",
    "energy_error": "contact forces have changed the energy, as the geometry changes in a step,",
}
_TOLD_FROM = 1e-3
_BAR = "{l_bar}{bar}| {n:.3g}/{total:.3g} s [{elapsed}]"

EventFunction = Callable[[float, np.ndarray, np.ndarray], float]


@dataclass(eq=False)
class _Request:
    """A run that is asked for: the arguments of `simulate`, and what `check` makes of them.

    began: the clock's time in s; pair: the Runge-Kutta pair, None for time stepping; users: events of the user; times:
    of outputs in s, or None for every step; jumps: the breakpoints in order, inside the run.
    """

    scene: Scene
    state: State
    duration: float
    rtol: float
    atol: float
    t_eval: ArrayLike | None
    method: str
    control: Control | None
    events: EventFunction | Sequence[EventFunction] | None
    progress: bool
    energies: bool
    max_step: float
    first_step: float | None
    fixed_step: float | None
    dt: float | None
    max_steps: int
    breakpoints: ArrayLike | None
    fallback: str | None
    contact_solver: str
    dense_output: bool
    step: float | None
    began: float = field(default_factory=time.perf_counter)
    pair: Tableau | None = None
    users: list[UserEvent] = field(default_factory=list)
    times: np.ndarray | None = None
    jumps: list[float] = field(default_factory=list)

    def check(self) -> None:
        """Raise what `simulate` raises for its arguments, before any work is done."""
        check_state(self.scene, self.state)
        _check_numbers(duration=self.duration, rtol=self.rtol, atol=self.atol, max_step=self.max_step)
        steps = {"first_step": self.first_step, "fixed_step": self.fixed_step}
        _check_numbers(**{name: size for name, size in steps.items() if size is not None})
        if math.isinf(max(self.duration, self.rtol, self.atol)):
            given = f"{self.duration}, {self.rtol}, {self.atol}"
            raise ArgumentError(f"duration, rtol and atol must be finite, got {given}")
        if not is_count(self.max_steps):
            raise ArgumentError(f"max_steps must be a whole number from 1 to 1e18, got {self.max_steps!r}")
        if self.fallback not in (None, "Moreau"):
            raise ArgumentError(f"fallback must be 'Moreau' or None, got {self.fallback!r}")
        if self.fallback is not None and self.method == "Moreau":
            raise ArgumentError("fallback is for the event-driven methods, such as 'DOP853'; method 'Moreau' has none")
        self.dt, start, end = time_step(self.dt, self.step), self.state.t, self.state.t + self.duration
        latest = max(abs(start), abs(end)) if self.duration > 0.0 else 0.0
        if self.dt is not None and self.dt < _SHORTEST_STEP * latest:
            raise ArgumentError(f"dt must be longer than times near {latest:.6g} s are rounded by, got {self.dt}")
        check_contact_solver(self.contact_solver)
        self.times, self.jumps = _output_times(self.t_eval, start, end), _breakpoints(self.breakpoints, start, end)
        self.users = UserEvent.wrap(self.events)
        for name in ("progress", "energies", "dense_output"):
            check_flag(name, getattr(self, name))
        if self.control is not None and not callable(self.control):
            raise ArgumentError(f"control must be callable as control(t, q, v), got {self.control!r}")
        self._check_method()

    def _check_method(self) -> None:
        """Find the method's pair, and check that it takes what is given."""
        if not isinstance(self.method, str):
            raise ArgumentError(f"method must be a name such as 'DOP853', got {self.method!r}")
        self.pair = None if self.method == "Moreau" else tableau(self.method)
        if self.dt is not None and "Moreau" not in (self.method, self.fallback):
            raise ArgumentError(f"dt is for method 'Moreau'; method {self.method!r} takes fixed_step or max_step")
        if self.dense_output and "Moreau" in (self.method, self.fallback):
            raise ArgumentError("dense_output is for the event-driven methods, such as 'DOP853', without a fallback")
        if self.pair is not None and self.fixed_step is None and self.rtol > self.pair.coarsest:
            raise ArgumentError(
                f"rtol must be at most {self.pair.coarsest:g} for method {self.method!r}, whose error estimate does "
                f"not hold for longer steps, got {self.rtol:g}; method 'DOP853' takes it"
            )
        if self.pair is None:
            # as SciPy does, of options that have no effect
            defaults = inspect.signature(simulate).parameters
            names = ("rtol", "atol", "max_step", "first_step", "fixed_step")
            unused = [name for name in names if getattr(self, name) != defaults[name].default]
            if unused:
                warnings.warn(
                    f"{', '.join(unused)} have no effect with method 'Moreau', whose step is dt.", stacklevel=4
                )

    def torque(self, system: System) -> Torque | None:
        """What asks the control for a system's torques."""
        return None if self.control is None else torque_of(self.control, system)

    def run(self, driver: Driver | MoreauDriver, result: Callable[[int, str], Trajectory]) -> Trajectory:
        """Run a driver; result(code, message): the trajectory so far. What users' functions raise is passed on, with
        that."""
        start = self.state.t
        with progress_bar(self.progress, self.duration, unit="s", bar_format=_BAR) as bar:
            driver.progress = (lambda t: bar.update(t - start - bar.n)) if self.progress else None
            try:
                code, message = driver.run(start, start + self.duration)
            except BaseException as error:
                run = result(CONTROL_FAILED, driver.system.tell(error))
                if driver.system.is_own(error):
                    return run
                _attach(error, run)
                raise
            rounded = float(np.spacing(max(abs(start), abs(start + self.duration))))
            if rounded > _LARGEST_ROUNDING * self.duration > 0.0:
                message += f"; times near {start:.6g} s are rounded by {rounded:.3g} s, of {self.duration:.3g} s"
            return result(code, message)


def simulate(
    scene: Scene,
    state: State,
    duration: float,
    *,
    rtol: float = 1e-8,
    atol: float = 1e-10,
    t_eval: ArrayLike | None = None,
    method: str = "DOP853",
    control: Control | None = None,
    events: EventFunction | Sequence[EventFunction] | None = None,
    progress: bool = False,
    energies: bool = False,
    max_step: float = math.inf,
    first_step: float | None = None,
    fixed_step: float | None = None,
    dt: float | None = None,
    max_steps: int = 1_000_000,
    breakpoints: ArrayLike | None = None,
    fallback: str | None = None,
    contact_solver: str = "auto",
    dense_output: bool = False,
    step: float | None = None,
) -> Trajectory:
    """Integrate a scene's motion from a state on.

    The model's position limits and dry joint friction are part of its dynamics in every method: a joint stops at a
    limit without rebound and is let go when the limit's force would pull; it sticks within its range of dry friction.
    Effort and velocity limits are not enforced: a control has to keep to them itself.

    Parameters
    ----------
    scene : Scene
    state : State
        Where the motion starts, from `Scene.initial_state`, `Trajectory.state` or `Stepper.state`.
    duration : float
        In s, >= 0.
    rtol, atol : float
        Relative and absolute tolerance of every component of q (tangent to its manifold, in m and rad), of v and of the
        location parameters. As max_step, first_step and fixed_step, of event-driven methods: a warning says so where
        "Moreau" is given others than the defaults.
    t_eval : (n,) array_like, optional
        Times in s, in order, at which the result is wanted; every accepted step, if not given.
    method : {"DOP853", "RK45", "RK23", "Sharp98", "Moreau"}
        "DOP853", "RK45" and "RK23" are the Runge-Kutta pairs of SciPy's `solve_ivp`; "Sharp98" is for errors of 1e-10,
        at rtol of 1e-5 and less. These locate events. "Moreau" is time stepping with impulses, for many contacts,
        impacts and jams, with constant steps and without error control.
    control : callable, optional
        Called as control(t, q, v), returns joint torques (nv,) in N and N m; must be smooth between events. q (nq,) and
        v (nv,) are read-only views of the integrator's own arrays, which the next call overwrites: copy what is kept. A
        function compiled by numba (`@numba.njit`) is called without Python.
    events : callable or sequence of callables, optional
        Functions g(t, q, v) whose zeros are reported, also where there are several within a step; attributes `terminal`
        (True or False) and `direction` as in SciPy's `solve_ivp`.
    progress : bool
        Whether to show a bar.
    energies : bool
        Whether to integrate the work of friction, prescribed motions, torques and damping along (see
        `Trajectory.energies`).
    max_step, first_step : float, optional
        The longest and the first step in s. Without a max_step, what varies with time (a control, a contour that is
        moved unsteadily) is looked at every 0.1 s at least, also where nothing moves; a shorter pulse needs
        breakpoints.
    fixed_step : float, optional
        Constant steps in s without error control, of an event-driven method.
    dt : float, optional
        Step in s of method "Moreau", 1e-3 if not given.
    max_steps : int
        Accepted and rejected ones together; a run that needs more ends with status -2.
    breakpoints : sequence of float, optional
        Times in s, in any order, at which a control or a motion jumps: steps end there, and the modes of contacts are
        decided anew. Those that are not inside the run are ignored.
    fallback : {"Moreau"}, optional
        Lets a run that cannot go on (status -1, -4, -6 or -7) go on by time stepping, with `dt`, from its last good
        state on; an event of kind "fallback" says where.
    contact_solver : {"auto", "proxqp"}
        How Coulomb's law is solved where stick or slip is undecided: the cheapest ways first, or by a sequence of
        ProxQP programs. What these leave unsolved is solved as by "auto" and counted in stats["qp_failures"], programs
        in "qp", their iterations in "qp_iterations".
    dense_output : bool
        Whether to keep the interpolants of all steps, some kB each, for `Trajectory.sol`; for event-driven methods
        without fallback.
    step : float, optional
        Another name of dt.

    Returns
    -------
    Trajectory
        Also when the run could not go on: see its `status` and `message`.

    Raises
    ------
    ArgumentError
        For an argument out of bounds or a state of another scene, before any work is done.
    StateError
        For a state whose numbers cannot be used, or whose closed contacts are apart, likewise.

    Notes
    -----
    What control, events and callable motions raise is passed on as it is. Everything up to there is then a Trajectory,
    too, of status -5: the attribute `run` of the exception, also of a KeyboardInterrupt.

    Examples
    --------
    A solid ball that slides at 1 m/s rolls after 2 v / (7 mu g), at 5/7 of its speed:

    >>> import numpy as np
    >>> import pincontact as pc
    >>> scene = pc.Scene.from_urdf("urdf/ball.urdf", floating_base=True)
    >>> ball = scene.add_contour("ball", pc.Sphere(0.1), frame="ball")
    >>> floor = scene.add_contour("floor", pc.Plane())
    >>> contact = scene.add_contact("ball/floor", ball, floor, friction=pc.Coulomb(0.2))
    >>> state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [1.0, 0, 0, 0, 0, 0])
    >>> run = pc.simulate(scene, state, duration=0.5)
    >>> [(event.kind, round(event.time, 6)) for event in run.events]
    [('stick', 0.145624)]
    >>> run.status, round(float(np.linalg.norm(run.v[-1, :3])), 6)
    (0, 0.714286)
    """
    request = _Request(
        scene, state, duration, rtol, atol, t_eval, method, control, events, progress, energies, max_step, first_step,
        fixed_step, dt, max_steps, breakpoints, fallback, contact_solver, dense_output, step,
    )  # fmt: skip
    request.check()
    return _simulate_moreau(request) if request.pair is None else _simulate_by_events(request, request.pair)


def _simulate_by_events(request: _Request, pair: Tableau) -> Trajectory:
    """The run of an event-driven method; with a fallback time stepping goes on where it could not."""
    scene, state, duration = request.scene, request.state, request.duration
    cached = take_system(scene, request.energies, resistances=True)
    system = cached.system
    # time stepping brings what is beyond its limits back
    check_joint_limits(system.limits, state.q)
    write_discrete(system, state.discrete)
    torque = request.torque(system)
    rk = RungeKutta(system, pair, request.rtol, request.atol, torque)
    rk.begin_at(state.q, state.v, state.location)
    with_torques = torque is not None or system.ng + system.nr > 0
    record = Record(system, state, with_torques)
    pieces = Pieces(system) if request.dense_output else None
    dense = None if pieces is None else DenseOutput(scene, state, pieces, with_torques)
    discrete = None if request.fallback is None else read_discrete
    sizes = request.max_step, request.max_steps, request.fixed_step, request.first_step
    options = Options(request.times, *sizes, request.jumps, discrete, pieces)
    restitution = [contact.restitution for contact in scene.contacts.values()]
    transitions = Transitions(rk, list(scene.contacts), restitution, duration, request.contact_solver)
    driver = Driver(rk, transitions, request.users, record.add, record.flush, options)

    def result(code: int, message: str) -> Trajectory:
        modes = transitions.modes
        stats = {
            "rhs": rk.evaluations,
            "steps": driver.steps,
            "rejected": driver.rejected,
            "outputs": len(record),
            **_counts(system),
            "cone_problems": modes.cone_problems,
            **modes.program_counts,
            "cone_residual": modes.worst_residual,
            "redistributions": modes.redistributions,
            "open_loads": driver.open_loads,
            "wall_time": time.perf_counter() - request.began,
        }
        return Trajectory(scene, *record.rows(scene), transitions.reports.events, code, message, stats, dense)

    run = request.run(driver, result)
    if run.success and dense is None:
        put_back(scene, cached)
    if request.fallback is not None and run.status in _FALLS_BACK:
        return _fall_back(run, driver, request)
    return run


def _fall_back(run: Trajectory, driver: Driver, request: _Request) -> Trajectory:
    """The run that time stepping makes of one that could not go on, both as one."""
    scene, state = request.scene, request.state
    t, good, discrete = driver.good or (state.t, None, state.discrete)
    start, works = state, None
    if good is not None:
        _, _, location, works = driver.system.parts(good)
        # Pinocchio's velocity, not that of a state, which may be in other axes
        driver.rk.load(good)
        start = State(scene, driver.system.q.copy(), driver.system.v.copy(), t, location, discrete)
    event = Event(t, None, "fallback", start.q.copy(), start.v.copy())
    rest = replace(
        request,
        state=replace(start, discrete=discrete),
        duration=request.duration - (t - state.t),
        max_steps=max(1, request.max_steps - driver.steps - driver.rejected),
        times=None if request.times is None else request.times[request.times > t],
        jumps=[jump for jump in request.jumps if jump > t],
    )
    return _simulate_moreau(rest, lambda end: run.followed_by(end, t, event, works if request.energies else None))


def _simulate_moreau(request: _Request, finish: Callable[[Trajectory], Trajectory] = lambda run: run) -> Trajectory:
    """The run of method "Moreau"; finish: what is made of it."""
    # imported, and with it kernels to compile, for those who use it
    from .integration.moreau import DEFAULT_STEP
    from .integration.moreau_driver import MoreauDriver
    from .integration.stages import load_state

    scene, state = request.scene, request.state
    cached = take_system(scene, request.energies, resistances=False)
    system = cached.system
    write_discrete(system, state.discrete)
    torque = request.torque(system)
    system.put_state(system.state, state.q, state.v, state.location)
    stepper = cached.stepper()
    stepper.cones.choose(request.contact_solver)
    with_torques = torque is not None or stepper.acts_on_joints
    record = Record(system, state, with_torques, steps_by=request.contact_solver)

    def add(t: float) -> None:
        # forces on the joints of limits, friction and resistance to turning go with the torques, so that contact forces
        # can be found again
        tau = system.tau.copy() if stepper.acts_on_joints else None
        if tau is not None:
            system.tau[:] += stepper.joint_force
        record.add(t, stepper.torques if stepper.resists_turning else None)
        if tau is not None:
            system.tau[:] = tau

    size = DEFAULT_STEP if request.dt is None else request.dt
    outputs = request.times, request.max_steps, torque, request.jumps
    driver = MoreauDriver(stepper, request.users, add, record.flush, size, *outputs)

    def result(code: int, message: str) -> Trajectory:
        if not len(record):
            # as in the other methods: a run that cannot begin has the state that it was to begin from
            system.stage_state[:] = system.state
            load_state(system.address)
            driver.output(state.t, asked=True)
        wall_time = time.perf_counter() - request.began
        done = {"steps": driver.steps, "outputs": len(record)}
        stats = {**done, **_counts(system), **stepper.stats, "wall_time": wall_time}
        run = Trajectory(scene, *record.rows(scene), driver.events, code, message, stats)
        if system.is_passive:
            stats["energy_gained"] = energy_gained(scene.model, run.q, run.v)
        for name, what in _TOLD.items():
            if stats.get(name, 0.0) > _TOLD_FROM:
                message += f"; {what} by {stats[name]:.2g} of the largest, which shorter steps lessen"
        run.message = sentence(message)
        return finish(run)

    run = request.run(driver, result)
    if run.success:
        put_back(scene, cached)
    return run


def _attach(error: BaseException, run: Trajectory) -> None:
    """Make a run an exception's attribute `run`; a note says so where its class has something else of that name."""
    if not hasattr(type(error), "run") and isinstance(vars(error).get("run", run), Trajectory):
        # around a __setattr__ of the class, as of a frozen dataclass
        BaseException.__setattr__(error, "run", run)
    elif sys.version_info >= (3, 11):
        # a class that cannot be written to takes no notes either
        with suppress(Exception):
            error.add_note(f"pincontact: the run up to there is not kept, {type(error).__name__}.run is something else")


# counts of a run's evaluations, and their names among a system's counters
_COUNTS = {
    "pinocchio": "evaluation_count",
    "newton": "newton_count",
    "closed_form": "closed_count",
    "contact_rows": "rows_formed",
    "drives": "drives_evaluated",
}


def _counts(system: System) -> dict[str, int]:
    return {name: int(system.counters[key]) for name, key in _COUNTS.items()}


def _check_numbers(**numbers: Any) -> None:
    """ArgumentError for what is no number or not positive; a duration and a relative tolerance may be zero."""
    for name, value in numbers.items():
        if not is_number(value):
            raise ArgumentError(f"{name} must be a number, got {value!r}")
        may_be_zero = name in ("duration", "rtol")
        if not value > 0.0 and (value < 0.0 or not may_be_zero):
            raise ArgumentError(f"{name} must {'not be negative' if may_be_zero else 'be positive'}, got {value}")


def _output_times(t_eval: ArrayLike | None, t: float, end: float) -> np.ndarray | None:
    if t_eval is None:
        return None
    times = reals("t_eval must be times in s", t_eval).reshape(-1)
    if not times.size:
        return times
    # not where there are entries that are not numbers
    ordered = bool((times[1:] >= times[:-1]).all())
    if ordered and t <= times[0] and times[-1] <= end:
        return times
    if not np.isfinite(times).all():
        raise ArgumentError("t_eval has entries that are not finite")
    slack = time_slack(t, end)
    if times.min() < t - slack or times.max() > end + slack:
        raise ArgumentError(f"t_eval must lie in [{t}, {end}], got [{times.min()}, {times.max()}]")
    if not ordered:
        raise ArgumentError("t_eval must not decrease")
    return np.clip(times, t, end)


def _breakpoints(given: ArrayLike | None, t: float, end: float) -> list[float]:
    """Times inside the run, in order and once each; a run goes on from the next number behind each."""
    if given is None:
        return []
    times = reals("breakpoints must be times in s", given).reshape(-1)
    if not np.isfinite(times).all():
        raise ArgumentError(f"breakpoints must be finite, got {given!r}")
    return [time for time in np.unique(times).tolist() if t < time and math.nextafter(time, math.inf) < end]
