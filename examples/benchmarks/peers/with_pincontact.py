"""pincontact itself: its four pairs over a ladder of tolerances, its time stepping over a ladder of steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin

import pincontact as pc

from .measure import Case, Engine
from .pinocchio_model import build_model
from .scenes import NO_SLIP, WORLD, Problem, Shape, Touch, marked

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
    state = build_scene(written).initial_state(problem.q, problem.v)
    return replace(problem, q=np.array(state.q), v=np.array(state.v))


def _springs(problem: Problem) -> Callable[[float, np.ndarray, np.ndarray], np.ndarray] | None:
    """Joint springs as a controller; dampers are the model's own."""
    sprung = [(body, *where) for body, where in zip(problem.bodies, problem.slices().values()) if body.stiffness]
    if not sprung:
        return None
    nv = problem.v.size
    # springs on the last joints of the tree, as here, are a slice, which is the cheapest to read and to write
    iq, iv = sprung[0][1].start, sprung[0][2].start
    stiffness, rest = (np.array([getattr(body, name) for body, _, _ in sprung]) for name in ("stiffness", "rest"))
    assert problem.q.size - iq == stiffness.size == nv - iv, "springs must be on the last joints"
    torque = np.zeros(nv)
    free, preload = torque[iv:], stiffness * rest

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        np.multiply(stiffness, q[iq:], out=free)
        np.subtract(preload, free, out=free)
        return torque

    return control


def simulate(problem: Problem, method: str, **options) -> Callable[[], pc.Trajectory]:
    """A run with outputs at the problem's times."""
    scene = build_scene(problem)
    state = scene.initial_state(problem.q, problem.v)
    times, control = problem.times, _springs(problem)
    return lambda: pc.simulate(scene, state, problem.duration, t_eval=times, method=method, control=control, **options)


def rollout(problem: Problem, each: int) -> Callable[[], np.ndarray]:
    """The motion by a `Stepper`, `each` steps at a time between the outputs: configurations (n, nq)."""
    scene, step = build_scene(problem), problem.duration / (problem.intervals * each)
    state, torques = scene.initial_state(problem.q, problem.v), np.zeros((problem.intervals, problem.v.size))
    stepper = pc.Stepper(scene, state, step)

    def run() -> np.ndarray:
        stepper.reset(state)
        rows = np.empty((problem.intervals + 1, problem.q.size))
        rows[0], rows[1:] = state.q, stepper.rollout(torques, each)[0]
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
    # torques are constant in its steps, which springs are not
    for each in MOREAU_INTERVALS if _springs(problem) is None else ():
        steps = problem.intervals * each
        yield Case(
            "Stepper",
            f"step {problem.duration / steps:.3g} s",
            rollout(problem, each),
            lambda rows: marked(problem, rows),
            lambda rows, steps=steps: {"steps": steps},  # type: ignore[misc]
        )


def reference(problem: Problem) -> tuple[np.ndarray, str, float]:
    """Positions to compare with, where they are from, and how sure they are (m)."""
    tight = positions(problem, simulate(problem, "DOP853", rtol=1e-13, atol=1e-15)())
    if problem.closed_form is not None:
        exact = problem.closed_form(problem.times)
        return exact, "closed form", float(np.linalg.norm(tight - exact, axis=2).max())
    other = positions(problem, simulate(problem, "DOP853", rtol=1e-12, atol=1e-14, max_step=0.003 * problem.duration)())
    sure = float(np.linalg.norm(tight - other, axis=2).max())
    return tight, "self-converged: DOP853 at rtol 1e-13", max(sure, math.ulp(1.0))


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
