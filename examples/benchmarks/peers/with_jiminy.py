"""Jiminy: its wheel and fixed-frame constraints, integrated by its own methods.

It carries a Pinocchio of its own, which cannot share a process with another; `pinocchio` is that one here.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import numpy as np

from .measure import Case, Engine, Unsupported
from .scenes import NO_SLIP, Problem, Touch, marked

DIGITS = range(2, 11)
STEPS = (1, 2, 3, 5, 10, 20, 50, 100, 200, 500)
LONGEST = 0.02  # the largest step that Jiminy allows, s
# of the stabilisation, Hz. The start satisfies the constraints, and any stabilisation made the disk's error larger
FREQUENCY = 0.0


def _core() -> Any:
    logging.disable(logging.WARNING)
    import jiminy_py.core

    return jiminy_py.core


def _frame(model, touch: Touch, name: str) -> str:
    import pinocchio as pin

    joint = model.getJointId(f"{touch.first.body} joint")
    model.addFrame(pin.Frame(name, joint, 0, pin.SE3(np.eye(3), np.array(touch.first.place)), pin.FrameType.OP_FRAME))
    return name


def build(problem: Problem, stepper: dict[str, Any]):
    """An engine with the scene in it."""
    core = _core()
    from .pinocchio_model import build_model

    model = build_model(problem)
    kinds = [(touch.first.kind, touch.second.kind, touch.mu == NO_SLIP) for touch in problem.touches]
    if not all(kind in (("disk", "plane", True), ("point", "plane", False)) for kind in kinds):
        a, b, rolls = next(k for k in kinds if k not in (("disk", "plane", True), ("point", "plane", False)))
        raise Unsupported(f"no constraint for a {a} {'rolling' if rolls else 'sliding'} on a {b}")
    names = [_frame(model, touch, f"contact {i}") for i, touch in enumerate(problem.touches)]
    robot = core.Robot("robot")
    robot.initialize(model)
    for name, touch in zip(names, problem.touches):
        if touch.first.kind == "disk":
            constraint = core.WheelConstraint(
                name, touch.first.size[0], np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0])
            )
        else:
            constraint = core.FrameConstraint(name, [True, True, True, False, False, False])
        robot.add_constraint(name, constraint)
        constraint.baumgarte_freq = FREQUENCY
    stiffness, rest, damping = (np.zeros(model.nv) for _ in range(3))
    angles = np.zeros(model.nv, dtype=int)
    for body, (iq, iv) in zip(problem.bodies, problem.slices().values()):
        stiffness[iv], rest[iv], damping[iv] = body.stiffness, body.rest, body.damping
        angles[iv] = iq.start
    if stiffness.any() or damping.any():

        def springs(t, q, v, measured, out) -> None:
            out[:] = stiffness * (rest - q[angles]) - damping * v

        robot.controller = core.FunctionalController(None, springs)
    engine = core.Engine()
    engine.add_robot(robot)
    options = engine.get_options()
    options["stepper"].update(stepper)
    options["constraints"]["regularization"] = 0.0
    options["world"]["gravity"][:3] = problem.gravity
    for name in ("enableAcceleration", "enableConfiguration", "enableVelocity"):
        options["telemetry"][name] = False
    engine.set_options(options)
    return engine


def case(problem: Problem, label: str, setting: str, stepper: dict[str, Any]) -> Case:
    engine = build(problem, stepper)
    interval = problem.duration / problem.intervals

    def run() -> tuple[np.ndarray, int]:
        rows = np.empty((problem.intervals + 1, problem.q.size))
        rows[0] = problem.q
        engine.reset(False, False)
        engine.start(problem.q, problem.v)
        state = engine.robot_states[0]
        for i in range(problem.intervals):
            engine.step(interval)
            rows[i + 1] = state.q
        steps = int(engine.stepper_state.iter)
        engine.stop()
        return rows, steps

    return Case(label, setting, run, lambda found: marked(problem, found[0]), lambda found: {"steps": found[1]})


def _cases(problem: Problem) -> Iterator[Case]:
    longest = problem.duration / problem.intervals
    for digits in DIGITS:
        rtol = 10.0**-digits
        options = {"odeSolver": "runge_kutta_dopri", "tolRel": rtol, "tolAbs": 1e-2 * rtol, "dtMax": LONGEST}
        yield case(problem, "Dormand-Prince", f"rtol 1e-{digits}", options)
    for each in STEPS:
        step = longest / each
        if step > LONGEST:
            continue
        yield case(problem, "RK4", f"step {step:.3g} s", {"odeSolver": "runge_kutta_4", "dtMax": step})


def _version() -> str:
    from importlib.metadata import version

    return version("jiminy-py")


_COMMON = "wheel or fixed-frame constraints, no stabilisation, no regularisation; "
ENGINE = Engine(
    "Jiminy",
    _version,
    _cases,
    {
        "Dormand-Prince": _COMMON + "atol = rtol / 100, steps up to 0.02 s (its limit)",
        "RK4": _COMMON + "constant steps",
    },
)
