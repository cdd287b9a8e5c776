"""Where the time of whole runs goes, per evaluation, step and event; a section of `cost.py`.

Compiled calls and cone problems are timed where Python makes them; what is left of a handler of events, and of the
loop around the steps, is Python's own. Within an evaluation Pinocchio's part is what it takes less where the addresses
of Pinocchio's functions are replaced by that of a function that does nothing: its terms stay those of the same state.
"""

from __future__ import annotations

import ctypes
import math
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from timing import by_turns, free_body

import pincontact as pc
from pincontact.friction.solve import ContactSolver
from pincontact.integration import driver, slip_steps
from pincontact.integration.discrete import write_discrete
from pincontact.integration.run_system import RunSystem
from pincontact.integration.steps import KEEP_VELOCITY, run_task

_RUNS = 15
# What Python calls for compiled work, and the driver's handlers of what may be an event.
_COMPILED = [(RunSystem, "run"), (RunSystem, "evaluate")]
_CONE = [(ContactSolver, "solve")]
_HANDLERS = [(driver.Driver, "_complete"), (slip_steps.SlipSteps, "end_slip"), (driver.Driver, "_slow_slip")]


@dataclass
class Clock:
    """Seconds by kind of work, each less what is nested in it, inside handlers of events and outside of them."""

    outside: dict[str, float] = field(default_factory=dict)
    inside: dict[str, float] = field(default_factory=dict)
    evaluations: int = 0
    _stack: list[list[Any]] = field(default_factory=list)

    def timed(self, kind: str, function: Callable[..., Any], counts: bool = False) -> Callable[..., Any]:
        """The function, timed; counts: it is a method whose evaluations are counted."""

        def call(*arguments: Any, **named: Any) -> Any:
            entry = [kind, 0.0]
            self._stack.append(entry)
            handles = any(other[0] == "handler" for other in self._stack)
            before = arguments[0].system.counters["evaluation_count"] if counts else 0
            began = time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                taken = time.perf_counter() - began
                self._stack.pop()
                if counts and not any(other[0] == "handler" for other in self._stack):
                    self.evaluations += int(arguments[0].system.counters["evaluation_count"] - before)
                if self._stack:
                    self._stack[-1][1] += taken
                spent = self.inside if handles else self.outside
                spent[kind] = spent.get(kind, 0.0) + taken - entry[1]

        return call


@contextmanager
def timed() -> Iterator[Clock]:
    """A clock that runs while the package's functions are replaced by timed ones."""
    clock, kept = Clock(), []
    for kind, places in (("compiled", _COMPILED), ("cone", _CONE), ("handler", _HANDLERS)):
        for owner, name in places:
            function = getattr(owner, name)
            kept.append((owner, name, function))
            setattr(owner, name, clock.timed(kind, function, counts=kind == "handler"))
    try:
        yield clock
    finally:
        for owner, name, function in kept:
            setattr(owner, name, function)


def disk(friction: Any) -> tuple[pc.Scene, pc.State]:
    """A disk of 0.3 m that leans and spins, on a plane."""
    scene = pc.Scene(free_body())
    rim = scene.add_contour("rim", pc.Circle(0.3), frame="body")
    scene.add_contact("contact", rim, scene.add_contour("floor", pc.Plane()), friction=friction)
    q = np.r_[0.0, 0.0, 0.3 * np.sin(1.2), pin.Quaternion(pin.utils.rotate("y", 1.2)).coeffs()]
    return scene, scene.initial_state(q, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 5.0]))


def _bouncing_ball() -> tuple[pc.Scene, pc.State]:
    scene = pc.Scene(free_body((0.001, 0.001, 0.001)))
    ball, floor = scene.add_contour("ball", pc.Sphere(0.05), frame="body"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("contact", ball, floor, friction=pc.Coulomb(0.3), restitution=0.8)
    q, v = np.r_[0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0], np.array([0.5, 0.0, 0.0, 0.0, 10.0, 0.0])
    return scene, scene.initial_state(q, v, free=["contact"])


def _box_on_feet() -> tuple[pc.Scene, pc.State]:
    scene = pc.Scene(free_body())
    floor = scene.add_contour("floor", pc.Plane())
    for i, (x, y) in enumerate(((0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1))):
        place = pin.SE3(np.eye(3), np.array([x, y, -0.1]))
        foot = scene.add_contour(f"foot{i}", pc.Point(), frame="body", placement=place)
        scene.add_contact(f"contact{i}", foot, floor, friction=pc.Coulomb(0.4))
    return scene, scene.initial_state(np.r_[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0], np.zeros(6))


def _push(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    # back and forth, in turn within what friction holds and beyond it
    return np.array([5.0 * np.sin(6.0 * t), 0.0, 0.0, 0.0, 0.0, 0.5 * np.cos(5.0 * t)])


def _evaluated(scene: pc.Scene, state: pc.State) -> RunSystem:
    system = RunSystem(scene.model, list(scene.contacts.values()))
    write_discrete(system, state.discrete)
    system.q[:], system.v[:], system.location[: system.nc] = state.q, state.v, state.location
    system.evaluate(0.0)
    return system


def evaluation_parts(system: RunSystem, twin: RunSystem) -> tuple[float, float]:
    """Microseconds of Pinocchio and of the kernels in one evaluation; nan where kernels call Pinocchio through Python,
    and the parts cannot be told apart.

    twin: another system in the same state, evaluated there; its terms are never again computed.
    """
    if twin.pinocchio.native is None:
        return math.nan, math.nan
    twin.pinocchio.native[:, 0] = ctypes.cast(ctypes.CDLL(None).labs, ctypes.c_void_p).value
    whole, kernels, call = by_turns(
        lambda: system.evaluate(0.0),
        lambda: twin.evaluate(0.0),
        lambda: run_task(system.address, KEEP_VELOCITY, 0.0, 0.0),
    )
    return whole - kernels, kernels - call


def breakdown(write: Callable[[str, float, float, float], None]) -> None:
    """Runs of 2 s at rtol 1e-8, without outputs."""
    cases: dict[str, tuple[tuple[pc.Scene, pc.State], dict[str, Any]]] = {
        "rolling disk": (disk(pc.NoSlip()), {}),
        "disk slips, then rolls": (disk(pc.Coulomb(0.2)), {}),
        "bouncing, spinning ball": (_bouncing_ball(), {}),
        "box on 4 feet, pushed": (_box_on_feet(), {"control": _push}),
    }
    for name, ((scene, state), options) in cases.items():

        def run(duration: float, scene: pc.Scene = scene, state: pc.State = state, options: Any = options) -> Any:
            return pc.simulate(scene, state, duration, t_eval=[duration], **options)

        result = run(2.0)
        if result.status < 0:
            raise SystemExit(f"{name}: {result.message}")
        total = statistics.median(run(2.0).stats["wall_time"] for _ in range(_RUNS))
        setup = statistics.median(run(0.0).stats["wall_time"] for _ in range(_RUNS))
        clocks = []
        for _ in range(_RUNS):
            with timed() as clock:
                run(2.0)
            clocks.append(clock)
        clock = sorted(clocks, key=lambda c: sum(c.outside.values()) + sum(c.inside.values()))[_RUNS // 2]
        parts = evaluation_parts(_evaluated(scene, state), _evaluated(scene, state))
        pinocchio, kernels = (1e-6 * part for part in parts)
        rhs, steps, events = result.stats["rhs"], result.stats["steps"], len(result.events)
        problems = f"{result.stats['cone_problems']} cone problems ({result.stats['qp']} programs of ProxQP)"
        counts = f"{rhs} evaluations, {steps} steps, {events} events, {problems}"
        print(f"\n{name}: {total * 1e3:.2f} ms, of which {setup * 1e3:.2f} ms set-up; {counts}")
        evaluation = pinocchio + kernels
        _show("an evaluation", evaluation, {"Pinocchio": pinocchio, "kernels": kernels})
        stepping, compiled = rhs - clock.evaluations, clock.outside.get("compiled", 0.0)
        loop = max(total - setup - sum(clock.outside.values()) - sum(clock.inside.values()), 0.0)
        of_steps = {
            f"{stepping / steps:.1f} evaluations": stepping * evaluation,
            "integrator and control": max(compiled - stepping * evaluation, 0.0),
            "Python": loop,
        }
        _show("a step", compiled + loop, of_steps, steps)
        write(f"{name}: a step", (compiled + loop) / steps * 1e6, math.nan, math.nan)
        if events:
            inside, within = clock.inside, clock.evaluations * evaluation
            of_events = {
                f"{clock.evaluations / events:.1f} evaluations": within,
                "cone problems": inside.get("cone", 0.0),
                "integrator and control": max(inside.get("compiled", 0.0) - within, 0.0),
                "Python": inside.get("handler", 0.0),
            }
            _show("an event", sum(inside.values()), of_events, events)
            write(f"{name}: an event", sum(inside.values()) / events * 1e6, math.nan, math.nan)


def _show(what: str, whole: float, parts: dict[str, float], number: int = 1) -> None:
    """A line of the table; seconds of so many at once."""
    texts = [f"{part} {seconds / number * 1e6:.2f}" for part, seconds in parts.items()]
    print(f"  {what:14s} {whole / number * 1e6:9.2f} us: {', '.join(texts)}")
