"""Many runs of time stepping at once, in threads: for sampling, learning and predictive control."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from typing import TYPE_CHECKING, Any

import numpy as np

from .arguments import check_count, time_step
from .cores import available_cores
from .errors import ArgumentError, StateError
from .friction.solve import check_contact_solver
from .integration.moreau import DEFAULT_STEP
from .integration.results import FAILURES, FINISHED
from .layout import OK
from .scene import Scene
from .state import State, check_finite, check_rows, check_state, coordinates_of
from .stepper import Stepper
from .system_cache import put_back, take_system

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# shapes of rows, all starts alike or each its own
_ROWS = {3: "(B, T, {})", 2: "(T, {})"}


def rollout(
    scene: Scene,
    states: State | Sequence[State],
    torques: ArrayLike,
    dt: float | None = None,
    substeps: int = 1,
    threads: int | None = None,
    contact_solver: str = "auto",
    pd: tuple[ArrayLike, ArrayLike, ArrayLike] | None = None,
    *,
    step: float | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Simulate B starts under T rows of torques each, by the steps of `Stepper`, in parallel threads.

    Every start gives the numbers of a new `Stepper`, to the last bit, whatever the number of threads. The steps are
    compiled code that runs without the interpreter's lock. It comes back to Python, one thread at a time, for rare cone
    problems, for open contacts whose nearest points have to be searched, for prescribed motions that are Python
    functions, and for all problems with contact_solver="proxqp". Where Pinocchio itself is reached through Python only
    (an installation without the functions that the package calls by address) threads gain little: there start
    processes, by `sweep` for example.

    Parameters
    ----------
    scene : Scene
        The scene, which must not change meanwhile.
    states : State or sequence of State
        The B starts, states of this scene; one state is the start of all.
    torques : array_like (B, T, nv) or (T, nv)
        Generalised forces in N and N m, each row held for `substeps` steps; (T, nv) for all starts alike.
    dt : float, optional
        Step in s, 1e-3 if not given.
    substeps : int
        Steps per row.
    threads : int or None
        Threads at most, None for one a processor.
    contact_solver : {"auto", "proxqp"}
        How Coulomb's law is solved, as for `simulate`.
    pd : (kp, kd, target) or None
        Implicit PD actuators as `Stepper.pd` gives them, here with a target (nq,), or one for each row of torques,
        (T, nq) or (B, T, nq).
    step : float, optional
        Another name of dt.

    Returns
    -------
    q : ndarray (B, T, nq)
        Configurations after each row.
    v : ndarray (B, T, nv)
        Velocities after each row, m/s and rad/s.
    status : ndarray (B,) of int
        0 where all rows were finished, else why that start could not go on, a number as `Trajectory.status` has. Rows
        that were not finished are NaN. Other starts go on.

    Raises
    ------
    ArgumentError, StateError
        For arguments that are not as above, before any step.

    Notes
    -----
    What a callable motion raises is raised as it is.

    Examples
    --------
    >>> import numpy as np, pinocchio as pin, pincontact as pc
    >>> model = pin.buildSampleModelManipulator()
    >>> scene = pc.Scene(model)
    >>> start = scene.initial_state(pin.neutral(model))
    >>> torques = np.random.default_rng(0).normal(size=(8, 50, model.nv))
    >>> q, v, status = pc.rollout(scene, start, torques, dt=1e-3, substeps=4)
    >>> q.shape, v.shape, status.tolist()
    ((8, 50, 6), (8, 50, 6), [0, 0, 0, 0, 0, 0, 0, 0])
    """
    dt = time_step(dt, step) or DEFAULT_STEP
    check_count("substeps", substeps)
    check_count("threads", threads, optional=True)
    check_contact_solver(contact_solver)
    starts, rows = _starts(scene, states, torques)
    nq, nv = scene.model.nq, scene.model.nv
    b, t = rows.shape[:2]
    gains, targets = _actuators(pd, nq, b, t)
    q, v, status = np.full((b, t, nq), np.nan), np.full((b, t, nv), np.nan), np.full(b, FINISHED)
    if not b or not t:
        return q, v, status
    systems, steppers = [], []
    for _ in range(min(threads or available_cores(), b)):
        # a start that fails at once is a status, too
        stepper, system = Stepper.__new__(Stepper), take_system(scene, works=False, resistances=False)
        stepper._make(scene, system.stepper(), dt, contact_solver)
        if gains is not None:
            stepper.pd(*gains)
        steppers.append(stepper)
        systems.append(system)
    waiting = deque(range(b))

    def work(stepper: Stepper) -> None:
        for i in _taken(waiting):
            found = stepper._begin(starts[i])
            if found == OK:
                given = None if targets is None else targets[i]
                found, q_i, v_i = stepper._step.advance_by_rows(rows[i], int(substeps), given)
                q[i, : len(q_i)], v[i, : len(v_i)] = q_i, v_i
            if found != OK:
                status[i] = FAILURES[found][0]

    _in_threads(work, steppers, waiting)
    for system in systems:
        put_back(scene, system)
    return q, v, status


def _in_threads(work: Callable[[Stepper], None], steppers: Sequence[Stepper], waiting: deque[int]) -> None:
    """work(stepper) for each of them in a thread of its own, while starts are waiting. Raises what the work raises."""
    if len(steppers) == 1:
        work(steppers[0])
        return
    with ThreadPoolExecutor(len(steppers)) as pool:
        try:
            done, _ = wait([pool.submit(work, stepper) for stepper in steppers], return_when=FIRST_EXCEPTION)
        finally:
            # after an exception or an interrupt the others end with the starts that they are at
            waiting.clear()
    for future in done:
        future.result()


def _taken(waiting: deque[int]) -> Iterator[int]:
    """Numbers of starts, each of which one thread takes."""
    while True:
        try:
            yield waiting.popleft()
        except IndexError:
            return


def _starts(scene: Scene, states: Any, torques: ArrayLike) -> tuple[list[State], np.ndarray]:
    """B states, and B rows of torques (B, T, nv), which have been checked."""
    if not isinstance(scene, Scene):
        raise ArgumentError(f"the first argument must be a Scene, got {type(scene).__name__}")
    if not isinstance(states, (State, Sequence)):
        raise ArgumentError(f"states must come from scene.initial_state(q, v), got {type(states).__name__}")
    coordinates = coordinates_of(scene.model)
    starts = [states] if isinstance(states, State) else list(states)
    for state in starts:
        check_state(scene, state, coordinates)
    rows = check_finite("torques", check_rows("torques", torques, scene.model.nv, _ROWS))
    if rows.ndim == 2:
        rows = np.broadcast_to(rows, (len(starts), *rows.shape))
    if isinstance(states, State):
        starts *= len(rows)
    if len(rows) != len(starts):
        raise StateError(f"torques are for {len(rows)} starts, there are {len(starts)} states")
    return starts, rows


def _actuators(pd: Any, nq: int, b: int, t: int) -> tuple[tuple[Any, Any, Any] | None, np.ndarray | None]:
    """What `Stepper.pd` is given, and targets (b, t, nq) where they vary."""
    if pd is None:
        return None, None
    if not isinstance(pd, tuple) or len(pd) != 3:
        raise ArgumentError(f"pd must be (kp, kd, target), got {pd!r}")
    kp, kd, target = pd
    if np.ndim(target) < 2:
        return (kp, kd, target), None
    targets = check_finite("target", check_rows("target", target, nq, _ROWS))
    if targets.shape not in ((t, nq), (b, t, nq)):
        raise StateError(f"target must have shape ({nq},), {(t, nq)} or {(b, t, nq)}, got {targets.shape}")
    targets = np.broadcast_to(targets, (b, t, nq))
    return (kp, kd, targets[0, 0] if targets.size else np.zeros(nq)), targets
