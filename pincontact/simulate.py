"""Run a scene: the call that users make."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from .arguments import NOT_REAL, check_flag, is_count, is_number, real_array
from .dynamics.joints import check_guards
from .dynamics.spare import Spare, put_back, take_spare
from .errors import ArgumentError, ContactError
from .integration.driver import Driver, Options
from .integration.events import UserEvent
from .integration.results import CONTROL_FAILED, Stop
from .integration.runge_kutta import RungeKutta
from .integration.tableaux import tableau
from .integration.transitions import Transitions
from .jit import compile_kernels
from .layout import BAD_TIME, BAD_TORQUE, CLOSED_COUNT, DRIVES_EVALUATED, EVALUATION_COUNT, NEWTON_COUNT, ROWS_FORMED
from .scene import Scene
from .state import State, check_state, write_discrete
from .trajectory import Record, Trajectory

if TYPE_CHECKING:
    from .dynamics.system import System

# So many numbers take less time as a list than as an array.
_SHORT = 50

Control = Callable[[float, np.ndarray, np.ndarray], Any]


def simulate(
    scene: Scene,
    state: State,
    duration: float,
    *,
    rtol: float = 1e-8,
    atol: float = 1e-10,
    t_eval: Any | None = None,
    method: str = "DOP853",
    control: Control | None = None,
    events: Any | None = None,
    progress: bool = False,
    energies: bool = False,
    max_step: float = math.inf,
    first_step: float | None = None,
    fixed_step: float | None = None,
    step: float | None = None,
    max_steps: int = 1_000_000,
) -> Trajectory:
    """Integrate a scene from a state over a duration in s.

    rtol, atol: relative and absolute tolerance of every component of q (tangent to its manifold), v and the location.
    t_eval: times at which the result is wanted, None for every accepted step. method: "DOP853", "RK45"
    or "RK23"; "Sharp98" for errors of 1e-10, at rtol of 1e-5 and less; or "Moreau": time stepping with impulses, for
    many contacts, impacts and jams, of constant `step` in s (default 1e-3) and without error control.
    control: called as control(t, q, v), returns joint torques (nv,); must be smooth between events. q (nq,) and v (nv,)
    are read-only views of the integrator's own arrays, which the next call overwrites: copy what is kept.
    events: functions g(t, q, v) whose zeros are reported; attributes `terminal` and `direction` as in `solve_ivp`.
    progress: show a bar. energies: integrate the work of friction, drives, torques and damping along (see
    `Trajectory.energies`). max_step, first_step in s; fixed_step: constant steps without error control;
    max_steps: accepted and rejected together.

    The model's position limits and dry joint friction are part of its dynamics in every method: a joint stops at a
    limit without rebound and is let go when the limit's force would pull; it sticks within its range of dry friction.
    Effort and velocity limits are not enforced: a control has to keep to them itself.

    Returns a Trajectory, also when the run could not go on: see its `status` and `message`.
    Raises ArgumentError or StateError for bad arguments, before any work is done.
    """
    _check(scene, state, duration, rtol, atol, max_step, first_step, fixed_step, max_steps, step)
    times = _output_times(t_eval, state.t, duration)
    users = UserEvent.wrap(events)
    check_flag("progress", progress)
    check_flag("energies", energies)
    if control is not None and not callable(control):
        raise ArgumentError(f"control must be callable as control(t, q, v), got {control!r}")
    if not isinstance(method, str):
        raise ArgumentError(f"method must be a name such as 'DOP853', got {method!r}")
    if step is not None and method != "Moreau":
        raise ArgumentError(f"step is for method 'Moreau'; method {method!r} takes fixed_step or max_step")
    pair = None if method == "Moreau" else tableau(method)
    if pair is not None and fixed_step is None and rtol > pair.coarsest:
        raise ArgumentError(
            f"rtol must be at most {pair.coarsest:g} for method {method!r}, whose error estimate does not hold for "
            f"longer steps, got {rtol:g}; method 'DOP853' takes it"
        )
    if pair is None:
        # imported, and with it kernels to compile, for those who use it
        from .integration import moreau  # noqa: F401
    compile_kernels()
    began = time.perf_counter()
    contacts = list(scene.contacts.values())
    spare = take_spare(scene, energies, resistances=pair is not None)
    system = spare.system
    if pair is not None:
        # time stepping brings what is beyond its limits back
        check_guards(system.guards, state.q)
    write_discrete(system, state.discrete)
    torque = _Torque(control, system) if control is not None else None

    def failed_control(t: float) -> None:
        if system.callback_error is not None:
            raise system.callback_error
        failure = system.drive_failure
        if failure is None and torque is not None:
            failure = torque.why_failed()
        if failure is not None:
            raise Stop(CONTROL_FAILED, failure)

    if pair is None:
        run = _simulate_moreau(
            scene, state, duration, step, spare, users, times, max_steps, torque, failed_control, progress, began
        )
        if run.success:
            put_back(scene, spare)
        return run
    rk = RungeKutta(system, pair, rtol, atol, torque.ask if torque is not None else None)
    rk.begin_at(state.q, state.v, state.location)
    record = Record(system, with_torques=control is not None or system.ng + system.nr > 0)
    transitions = Transitions(rk, list(scene.contacts), [c.restitution for c in contacts], duration, failed_control)
    options = Options(times, max_step, max_steps, fixed_step, first_step)
    with _Bar(progress, state.t, duration) as bar:
        driver = Driver(rk, transitions, users, record.add, record.flush, options, bar.update if progress else None)
        code, message = driver.run(state.t, state.t + duration)
    modes = transitions.modes
    stats = {
        "rhs": rk.evaluations,
        "steps": driver.steps,
        "rejected": driver.rejected,
        "outputs": len(record),
        **_counts(system),
        "cone_problems": modes.cone_problems,
        "qp": modes.solver.qp_count if modes.cone_problems else 0,
        "cone_residual": modes.worst_residual,
        "redistributions": modes.redistributions,
        "wall_time": time.perf_counter() - began,
    }
    run = Trajectory.from_record(scene, record, transitions.events, code, message, stats)
    if run.success:
        put_back(scene, spare)
    return run


def _simulate_moreau(
    scene: Scene,
    state: State,
    duration: float,
    step: float | None,
    spare: Spare,
    users: list[UserEvent],
    times: np.ndarray | None,
    max_steps: int,
    torque: _Torque | None,
    failed_control: Callable[[float], None],
    progress: bool,
    began: float,
) -> Trajectory:
    """The run of method "Moreau" on a spare's system, whose discrete state is set."""
    from .integration.moreau import DEFAULT_STEP, MoreauDriver, MoreauStep
    from .integration.stages import load_state

    size = DEFAULT_STEP if step is None else step
    system, stepper = spare.system, spare.stepper
    end = system.nq + system.nv
    system.state[: system.nq], system.state[system.nq : end] = state.q, state.v
    system.state[end : end + 4 * system.nc] = state.location.ravel()
    if stepper is None:
        stepper = spare.stepper = MoreauStep(system, system.contacts)
    else:
        stepper.renew()
    record = Record(system, with_torques=torque is not None or stepper.acts_on_joints, by_steps=True)

    def add(t: float) -> None:
        # forces on the joints of limits, friction and resistance to turning go with the torques, so that contact forces
        # can be found again
        tau = system.tau.copy() if stepper.acts_on_joints else None
        if tau is not None:
            system.tau += stepper.joint_force
        record.add(t, stepper.torques if stepper.resists_turning else None)
        if tau is not None:
            system.tau[:] = tau

    with _Bar(progress, state.t, duration) as bar:
        driver = MoreauDriver(
            stepper,
            users,
            add,
            record.flush,
            size,
            times,
            max_steps,
            torque.ask if torque is not None else None,
            failed_control,
            bar.update if progress else None,
        )
        code, message = driver.run(state.t, state.t + duration)
    if times is None and not len(record):
        # as in the other methods: a run that cannot begin has the state that it was to begin from
        system.stage_state[:] = system.state
        load_state(system.table)
        add(state.t)
    stats = {
        "steps": driver.steps,
        "outputs": len(record),
        **_counts(system),
        "cone_problems": stepper.cone_problems,
        "rigid": stepper.rigid,
        "softened": stepper.softened,
        "decided": stepper.decided,
        "qp": stepper.solver.qp_count,
        "cone_residual": stepper.worst_residual,
        "wall_time": time.perf_counter() - began,
    }
    return Trajectory.from_record(scene, record, driver.events, code, message, stats)


def _counts(system: System) -> dict[str, int]:
    """What evaluations have done so far."""
    counters = system.counters.tolist()
    return {
        "pinocchio": counters[EVALUATION_COUNT],
        "newton": counters[NEWTON_COUNT],
        "closed_form": counters[CLOSED_COUNT],
        "contact_rows": counters[ROWS_FORMED],
        "drives": counters[DRIVES_EVALUATED],
    }


def _check(
    scene: Scene,
    state: State,
    duration: float,
    rtol: float,
    atol: float,
    max_step: float,
    first_step: float | None,
    fixed_step: float | None,
    max_steps: int,
    step: float | None,
) -> None:
    check_state(scene, state)
    needed = (("duration", duration), ("rtol", rtol), ("atol", atol), ("max_step", max_step))
    optional = (("first_step", first_step), ("fixed_step", fixed_step), ("step", step))
    for name, value in (*needed, *((name, value) for name, value in optional if value is not None)):
        if not is_number(value):
            raise ArgumentError(f"{name} must be a number, got {value!r}")
        if not value > 0.0 and (value < 0.0 or name not in ("duration", "rtol")):
            raise ArgumentError(f"{name} must be positive, got {value}")
    if step is not None and math.isinf(step):
        raise ArgumentError("step must be finite, got inf")
    if not math.isfinite(duration) or math.isinf(rtol) or math.isinf(atol):
        raise ArgumentError(f"duration, rtol and atol must be finite, got {duration}, {rtol}, {atol}")
    if not is_count(max_steps):
        raise ArgumentError(f"max_steps must be a whole number from 1 to 1e18, got {max_steps!r}")


def _output_times(t_eval: Any | None, t: float, duration: float) -> np.ndarray | None:
    if t_eval is None:
        return None
    try:
        times = real_array(t_eval)
    except NOT_REAL:
        raise ArgumentError(f"t_eval must be times in s, got {t_eval!r}") from None
    if times.ndim != 1:
        times = times.reshape(-1)
    # the end may be off by round-off, as from linspace
    end = t + duration
    slack = 1e-12 * max(abs(t), abs(end), duration)
    ordered = (times[1:] >= times[:-1]).all() if times.size > _SHORT else _is_ordered(times.tolist())
    if times.size and t <= times[0] and times[-1] <= end and ordered:
        return times
    if not np.isfinite(times).all():
        raise ArgumentError("t_eval has entries that are not finite")
    if times.size and (times.min() < t - slack or times.max() > t + duration + slack):
        raise ArgumentError(f"t_eval must lie in [{t}, {t + duration}], got [{times.min()}, {times.max()}]")
    if not ordered:
        raise ArgumentError("t_eval must not decrease")
    return np.minimum(np.maximum(times, t), t + duration)


def _is_ordered(times: list[float]) -> bool:
    # NaN, which sorting may leave where it is, is in the sum
    return sorted(times) == times and not math.isnan(sum(times))


class _Torque:
    """Asks the user's control and checks what it returns; a mistake ends the run, with its text.

    ask(t): torques for (t, q, v) of the system into its `tau`; False where there are none. Whether they are finite is
    left to the kernels, which note it. A call does the same and looks at that, too.
    """

    def __init__(self, control: Control, system: System) -> None:
        self._system = system
        self._failure: str | None = None
        # made once, and local to the function: a call costs what the control costs
        q, v, tau, shape = system.q.view(), system.v.view(), system.tau, (system.nv,)
        q.flags.writeable = v.flags.writeable = False
        real, asarray = np.dtype(float), np.asarray

        def ask(t: float) -> bool:
            try:
                found = control(t, q, v)
                if type(found) is not np.ndarray or found.dtype is not real:
                    found = asarray(found)
                    if found.dtype.kind == "c":
                        # the conversion would drop imaginary parts
                        self._failure = f"t = {t:.9g} s: control returned complex numbers: {found.tolist()}"
                        return False
                    found = asarray(found, dtype=float)
            except ContactError:
                raise
            except Exception as error:
                self._failure = f"t = {t:.9g} s: control raised {type(error).__name__}: {error}"
                return False
            if found.shape != shape:
                self._failure = f"t = {t:.9g} s: control returned an array of shape {found.shape}, not {shape}"
                return False
            tau[:] = found
            return True

        self.ask = ask

    def __call__(self, t: float) -> bool:
        if not self.ask(t):
            return False
        tau = self._system.tau
        finite = np.isfinite(tau)
        if not finite.all():
            self._system.scalars[[BAD_TORQUE, BAD_TIME]] = tau[int(np.argmin(finite))], t
            return False
        return True

    def why_failed(self) -> str | None:
        """What was wrong with the control, None if nothing was."""
        value, t = self._system.scalars[[BAD_TORQUE, BAD_TIME]]
        if self._failure is None and value != 0.0:
            self._failure = f"t = {t:.9g} s: control returned {value}"
        return self._failure


class _Bar:
    """A progress bar over simulated time; tqdm where it is installed, else a line of text."""

    def __init__(self, wanted: bool, t: float, duration: float) -> None:
        self._wanted, self._t, self._duration = wanted, t, duration
        self._bar: Any = None

    def __enter__(self) -> _Bar:
        if self._wanted:
            try:
                from tqdm import tqdm
            except ImportError:
                tqdm = PlainBar
            self._bar = tqdm(
                total=self._duration, unit="s", bar_format="{l_bar}{bar}| {n:.3g}/{total:.3g} s [{elapsed}]"
            )
        return self

    def update(self, t: float) -> None:
        self._bar.update(t - self._t)
        self._t = t

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()


class PlainBar:
    """What `progress=True` shows without tqdm: a percentage, at most a hundred times. total: in the unit of update."""

    def __init__(self, total: float, **_: Any) -> None:
        self._total, self._n, self._shown = total, 0.0, -1

    def update(self, n: float) -> None:
        self._n += n
        percent = int(100.0 * self._n / self._total) if self._total > 0.0 else 100
        if percent > self._shown:
            self._shown = percent
            print(f"\rpincontact: {percent:3d} %", end="", flush=True)

    def close(self) -> None:
        print()
