"""Jiminy: its wheel and fixed-frame constraints, integrated by its own methods.

It carries a Pinocchio of its own, which cannot share a process with another; `pinocchio` is that one here.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import numpy as np

from .measure import Case, Engine, Unsupported
from .problem import NO_SLIP, WORLD, Problem, Touch, marked

DIGITS = range(2, 11)
STEPS = (1, 2, 3, 5, 10, 20, 50, 100, 200, 500)
LONGEST = 0.02  # the largest step that Jiminy allows, s
# of the stabilisation, Hz. The start satisfies the constraints, and any stabilisation made the disk's error larger
FREQUENCY = 0.0
# of contacts that open and slip, see `_event_cases`
EVENT_STEPS = (5, 10, 20, 50, 100, 200, 500, 1000)
SPRINGS = {"model": "spring_damper", "stiffness": 1e6, "damping": 2e3, "transitionVelocity": 1e-3,
           "transitionEps": 1e-5}  # fmt: skip


def _core() -> Any:
    logging.disable(logging.WARNING)
    import jiminy_py.core

    return jiminy_py.core


def _frame(model, touch: Touch, name: str) -> str:
    import pinocchio as pin

    joint = model.getJointId(f"{touch.first.body} joint")
    model.addFrame(pin.Frame(name, joint, 0, pin.SE3(np.eye(3), np.array(touch.first.place)), pin.FrameType.OP_FRAME))
    return name


def build(problem: Problem, stepper: dict[str, Any], contacts: dict[str, Any]):
    """An engine with the scene in it."""
    core = _core()
    from .pinocchio_model import build_model

    model = build_model(problem)
    if problem.events:
        if any((touch.first.kind, touch.second.kind, touch.second.body) != ("point", "plane", WORLD)
               for touch in problem.touches):  # fmt: skip
            raise Unsupported("contacts that open and slip are between points and the ground")
        return _with_points(problem, model, stepper, contacts)
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
    return _engine(problem, model, robot, stepper, {})


def _with_points(problem: Problem, model, stepper: dict[str, Any], contacts: dict[str, Any]):
    """An engine with points of the bodies that may slip on the ground and leave it."""
    robot = _core().Robot("robot")
    names = [_frame(model, touch, f"contact {i}") for i, touch in enumerate(problem.touches)]
    robot.initialize(model)
    robot.add_contact_points(names)
    return _engine(problem, model, robot, stepper, contacts | {"friction": problem.touches[0].mu})


def _engine(problem: Problem, model, robot, stepper: dict[str, Any], contacts: dict[str, Any]):
    """The engine of a robot, its springs, dampers and what drives it."""
    core = _core()
    stiffness, rest, damping = (np.zeros(model.nv) for _ in range(3))
    angles = np.zeros(model.nv, dtype=int)
    for body, (iq, iv) in zip(problem.bodies, problem.slices().values()):
        stiffness[iv], rest[iv], damping[iv] = body.stiffness, body.rest, body.damping
        angles[iv] = iq.start
    drive = problem.drive
    if stiffness.any() or damping.any() or drive is not None:

        def springs(t, q, v, measured, out) -> None:
            out[:] = stiffness * (rest - q[angles]) - damping * v
            if drive is not None:
                out[:] += drive.amplitude * np.sin(drive.rate * t + drive.phase)

        robot.controller = core.FunctionalController(None, springs)
    engine = core.Engine()
    engine.add_robot(robot)
    options = engine.get_options()
    options["stepper"].update(stepper)
    options["contacts"].update(contacts)
    options["constraints"]["regularization"] = 0.0
    options["world"]["gravity"][:3] = problem.gravity
    for name in ("enableAcceleration", "enableConfiguration", "enableVelocity"):
        options["telemetry"][name] = False
    engine.set_options(options)
    return engine


def case(
    problem: Problem, label: str, setting: str, stepper: dict[str, Any], contacts: dict[str, Any] | None = None
) -> Case:
    engine = build(problem, stepper, contacts or {})
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
    if problem.events:
        yield from _event_cases(problem, longest)
        return
    for digits in DIGITS:
        rtol = 10.0**-digits
        options = {"odeSolver": "runge_kutta_dopri", "tolRel": rtol, "tolAbs": 1e-2 * rtol, "dtMax": LONGEST}
        yield case(problem, "Dormand-Prince", f"rtol 1e-{digits}", options)
    for each in STEPS:
        step = longest / each
        if step > LONGEST:
            continue
        yield case(problem, "RK4", f"step {step:.3g} s", {"odeSolver": "runge_kutta_4", "dtMax": step})


def _event_cases(problem: Problem, longest: float) -> Iterator[Case]:
    """Contacts as constraints in steps, and as stiff springs with error control."""
    for each in EVENT_STEPS:
        step = longest / each
        if step <= LONGEST:
            # the stabilisation pulls feet that have come through the ground out of it within some steps
            contacts = {"model": "constraint", "stabilizationFreq": 0.05 / step}
            yield case(problem, "Euler, constraints", f"step {step:.3g} s",
                       {"odeSolver": "euler_explicit", "dtMax": step}, contacts)  # fmt: skip
    for digits in range(3, 9):
        rtol = 10.0**-digits
        options = {"odeSolver": "runge_kutta_dopri", "tolRel": rtol, "tolAbs": 1e-2 * rtol, "dtMax": LONGEST}
        yield case(problem, "Dormand-Prince, springs", f"rtol 1e-{digits}", options, SPRINGS)


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
        "Euler, constraints": "contact points as constraints in constant steps, stabilised at 0.05 / step",
        "Dormand-Prince, springs": "contact points on springs of 1e6 N/m and 2e3 N s/m, friction regularised below "
        "1e-3 m/s, atol = rtol / 100",
    },
)
