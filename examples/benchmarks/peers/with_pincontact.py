"""pincontact itself: its four pairs over a ladder of tolerances, its time stepping over a ladder of steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin

import pincontact as pc

from .measure import Case, Engine, largest_distance
from .pinocchio_model import build_model
from .problem import NO_SLIP, WORLD, Problem, Shape, Touch, marked

# largest and smallest rtol; between 1 and 1e-2 there are two in every decade
PAIRS = {"DOP853": (1.0, 1e-12), "Sharp98": (1e-5, 1e-12), "RK45": (1.0, 1e-10), "RK23": (1.0, 1e-5)}
TOLERANCES = (1.0, 0.3, 0.1, 0.03, *(10.0**-digits for digits in range(2, 13)))
MOREAU_INTERVALS = (1, 2, 3, 5, 10, 20, 50, 200, 500, 1000)  # steps in each interval between outputs


def _contour(shape: Shape) -> pc.Contour:
    kinds: dict[str, Callable[..., pc.Contour]] = {
        "disk": pc.Circle,
        "circle": pc.Circle,
        "sphere": pc.Sphere,
        "bowl": pc.Sphere,
        "ellipsoid": pc.Ellipsoid,
        "plane": pc.Plane,
        "line": pc.Line,
        "point": pc.Point,
        "helix": pc.Helix,
    }
    return kinds[shape.kind](*shape.size)


def _law(touch: Touch) -> pc.Coulomb | pc.NoSlip | None:
    if touch.mu == 0.0:
        return None
    return pc.NoSlip() if touch.mu == NO_SLIP else pc.Coulomb(touch.mu)


def build_scene(problem: Problem) -> pc.Scene:
    """The problem as a user of the package would write it."""
    scene = pc.Scene(build_model(problem))
    for i, touch in enumerate(problem.touches):
        contours = []
        for end, shape in (("a", touch.first), ("b", touch.second)):
            frame = "universe" if shape.body == WORLD else shape.body
            placement = pin.SE3(np.eye(3), np.array(shape.place))
            contours.append(scene.add_contour(f"{i} {end}", _contour(shape), frame, placement))
        scene.add_contact(f"{i}", *contours, friction=_law(touch), bilateral=touch.bilateral, side=touch.side)
    return scene


def consistent(problem: Problem) -> Problem:
    """The problem with its start corrected onto the constraints, which every engine then gets."""
    written = problem
    if problem.starts_at_stick:
        written = replace(problem, touches=tuple(replace(touch, mu=NO_SLIP) for touch in problem.touches))
    state = start(build_scene(written), problem)
    return replace(problem, q=np.array(state.q), v=np.array(state.v))


def start(scene: pc.Scene, problem: Problem) -> pc.State:
    """The problem's start as a state of its scene."""
    apart = tuple(f"{i}" for i, touch in enumerate(problem.touches) if touch.apart)
    return scene.initial_state(problem.q, problem.v, free=apart)


def _springs(problem: Problem) -> tuple[slice, slice, np.ndarray, np.ndarray] | None:
    """Where in q and in v the joints with springs are, their stiffness and their rest; dampers are the model's own."""
    places = [(body, *where) for body, where in zip(problem.bodies, problem.slices().values())]
    sprung = [i for i, (body, _, _) in enumerate(places) if body.stiffness]
    if not sprung:
        return None
    # a slice is the cheapest to read and to write: what is between them has springs of no stiffness
    between = places[sprung[0] : sprung[-1] + 1]
    assert all(body.sizes == (1, 1) for body, _, _ in between), "springs are for joints of one coordinate"
    stiffness, rest = (np.array([getattr(body, name) for body, _, _ in between]) for name in ("stiffness", "rest"))
    (_, iq, iv), (_, jq, jv) = between[0], between[-1]
    return slice(iq.start, jq.stop), slice(iv.start, jv.stop), stiffness, rest


def control_of(problem: Problem) -> Callable[[float, np.ndarray, np.ndarray], np.ndarray] | None:
    """Springs and what drives the scene, as a controller."""
    springs, drive = _springs(problem), problem.drive
    if springs is None and drive is None:
        return None
    torque = np.zeros(problem.v.size)
    if springs is not None:
        iq, iv, stiffness, rest = springs
        sprung, preload = torque[iv], stiffness * rest
    if drive is not None:
        # amplitude sin(rate t + phase) without a sine for every coordinate
        rate, ahead, across = drive.rate, drive.amplitude * np.cos(drive.phase), drive.amplitude * np.sin(drive.phase)
        if not across.any():
            across = None

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        if drive is not None:
            np.multiply(ahead, math.sin(rate * t), out=torque)
            if across is not None:
                np.add(torque, across * math.cos(rate * t), out=torque)
            if springs is not None:
                np.add(sprung, preload - stiffness * q[iq], out=sprung)
        else:
            np.multiply(stiffness, q[iq], out=sprung)
            np.subtract(preload, sprung, out=sprung)
        return torque

    return control


def simulate(problem: Problem, method: str, **options) -> Callable[[], pc.Trajectory]:
    """A run with outputs at the problem's times."""
    scene = build_scene(problem)
    state = start(scene, problem)
    times, control = problem.times, control_of(problem)
    return lambda: pc.simulate(scene, state, problem.duration, t_eval=times, method=method, control=control, **options)


def stepper_of(problem: Problem, step: float) -> tuple[pc.Stepper, pc.State]:
    """A stepper whose actuators are the problem's springs, and where it starts."""
    scene = build_scene(problem)
    state = start(scene, problem)
    stepper = pc.Stepper(scene, state, step)
    if springs := _springs(problem):
        iq, iv, stiffness, rest = springs
        gains, target = np.zeros(problem.v.size), np.array(problem.q)
        gains[iv], target[iq] = stiffness, rest
        stepper.pd(gains, 0.0, target)
    return stepper, state


def rollout(problem: Problem, each: int) -> Callable[[], np.ndarray]:
    """The motion by a `Stepper`, `each` steps at a time between the outputs: configurations (n, nq).

    What drives the scene has the value of its steps' middles.
    """
    count = problem.intervals * each
    step = problem.duration / count
    stepper, state = stepper_of(problem, step)
    # rows of torques, and for how many steps each is held
    torques, held = np.zeros((problem.intervals, problem.v.size)), each
    if problem.drive is not None:
        torques, held = problem.drive(step * (np.arange(count) + 0.5)), 1

    def run() -> np.ndarray:
        stepper.reset(state)
        rows = np.empty((problem.intervals + 1, problem.q.size))
        rows[0], rows[1:] = state.q, stepper.rollout(torques, held)[0][each // held - 1 :: each // held]
        return rows

    return run


def positions(problem: Problem, run: pc.Trajectory) -> np.ndarray:
    if run.status != 0:
        raise RuntimeError(run.message)
    return marked(problem, run.q)


def _counts(run: pc.Trajectory) -> dict[str, int]:
    steps = int(run.stats["steps"])
    return {"steps": steps, "evaluations": int(run.stats.get("rhs", run.stats["pinocchio"]))}


def _cases(problem: Problem) -> Iterator[Case]:
    def shown(run: pc.Trajectory) -> np.ndarray:
        return positions(problem, run)

    for method, (coarsest, finest) in PAIRS.items():
        for rtol in TOLERANCES:
            if finest <= rtol <= coarsest:
                run = simulate(problem, method, rtol=rtol, atol=1e-2 * rtol)
                yield Case(method, f"rtol {rtol:g}", run, shown, _counts)
    for each in MOREAU_INTERVALS:
        step = problem.duration / (problem.intervals * each)
        yield Case("Moreau", f"step {step:.3g} s", simulate(problem, "Moreau", dt=step), shown, _counts)
    for each in MOREAU_INTERVALS:
        steps = problem.intervals * each
        yield Case(
            "Stepper",
            f"step {problem.duration / steps:.3g} s",
            rollout(problem, each),
            lambda rows: marked(problem, rows),
            lambda rows, steps=steps: {"steps": steps},  # type: ignore[misc]
        )


def reference(problem: Problem) -> tuple[np.ndarray, str, float]:
    """Positions to compare with, where they are from and what they were compared with, and how well they agree (m)."""

    def found(method: str, **options) -> np.ndarray:
        return positions(problem, simulate(problem, method, **options)())

    if problem.closed_form is not None:
        exact, tight = problem.closed_form(problem.times), found("DOP853", rtol=1e-13, atol=1e-15)
        return exact, "closed form; pincontact at rtol 1e-13 agrees", largest_distance(tight, exact)
    if problem.events:
        tight, other = found("DOP853", rtol=1e-11, atol=1e-13), found("Moreau", dt=problem.duration / 2e5)
        return tight, "DOP853 at rtol 1e-11; time stepping in 2e5 steps agrees", largest_distance(tight, other)
    tight = found("DOP853", rtol=1e-13, atol=1e-15)
    other = found("DOP853", rtol=1e-12, atol=1e-14, max_step=0.003 * problem.duration)
    sure = max(largest_distance(tight, other), math.ulp(1.0))
    return tight, "self-converged: DOP853 at rtol 1e-13; rtol 1e-12 and other steps agree", sure


ENGINE = Engine(
    "pincontact",
    lambda: pc.__version__,
    _cases,
    {
        **{name: f"rtol {most:g} to {least:g}, atol = rtol / 100" for name, (most, least) in PAIRS.items()},
        "Moreau": "1 to 1000 steps in each output interval",
        "Stepper": "the same, as `Stepper.rollout`",
    },
)
