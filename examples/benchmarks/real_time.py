"""The longest times of a step in a control loop, in steps of 1 ms.

Loops: a quadruped that stands and sways on implicit PD actuators with moving targets; one that trots on actuators and
torques, with footfalls; a block on four feet, pushed to and fro, whose redundant feet stick and slip. A motion is made
in twenty passes that are the same to the last bit. Printed are the quantiles of a step's time on the wall, which on a
busy machine are those of its other work, on the processor, and of the least that the step took on the wall in any pass,
which is its own work; and whether the loop allocates anything, counted by tracemalloc in a loop of its own.

    python examples/benchmarks/real_time.py [--steps 1000000] [--loops standing,trot,block]
"""

from __future__ import annotations

import argparse
import gc
import math
import os
import sys
import time
import tracemalloc
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path

import numpy as np
from peers.event_scenes import forced_block, trot
from peers.problem import Problem
from peers.with_pincontact import consistent, stepper_of

import pincontact as pc

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from quadruped import quadruped, standing

STEP, PASSES = 1e-3, 20
STIFFNESS, DAMPING = 2000.0, 20.0
# steps of a period of the targets, of which there is a table: the loop is the stepper's alone
PERIOD = 2000


@dataclass
class Loop:
    """A stepper, where it starts, and endless rows of torques and of targets for its steps."""

    stepper: pc.Stepper
    state: pc.State
    torques: Iterable[np.ndarray]
    targets: Iterable[np.ndarray]


def standing_loop(steps: int) -> Loop:
    """The body bobs by 2 cm or so and sways, on four feet, one of them on ice."""
    scene = quadruped()
    state = standing(scene)
    stepper = pc.Stepper(scene, state, STEP)
    stepper.pd(STIFFNESS, DAMPING, state.q)
    targets = np.tile(state.q, (PERIOD, 1))
    for i in range(PERIOD):
        phase = 2.0 * math.pi * i / PERIOD
        targets[i, 8::3] += 0.1 * math.sin(phase)
        targets[i, 9::3] -= 0.2 * math.sin(phase)
        targets[i, 7::3] += 0.05 * math.sin(2.0 * phase)
    return Loop(stepper, state, cycle([np.zeros(scene.model.nv)]), cycle(targets))


def driven_loop(make: Callable[[], Problem]) -> Callable[[int], Loop]:
    """A scene of the work-precision benchmark."""

    def loop(steps: int) -> Loop:
        problem = consistent(make())
        assert problem.drive is not None
        stepper, state = stepper_of(problem, STEP)
        torques = problem.drive(STEP * (np.arange(steps) + 0.5))
        return Loop(stepper, state, cycle(torques), cycle([np.array(stepper.target)]))

    return loop


LOOPS: dict[str, Callable[[int], Loop]] = {
    "standing": standing_loop,
    "trot": driven_loop(trot),
    "block": driven_loop(forced_block),
}


def run(loop: Loop, out: np.ndarray) -> None:
    """As many steps as there are rows of (wall, processor) time in ns."""
    stepper, target, clock, processor = loop.stepper, loop.stepper.target, time.perf_counter_ns, time.thread_time_ns
    steps = range(len(out))
    for i, tau, aim in zip(steps, loop.torques, loop.targets):
        before = processor()
        began = clock()
        target[:] = aim
        stepper.step(tau)
        out[i, 0] = clock() - began
        out[i, 1] = processor() - before


def measured(loop: Loop, steps: int) -> np.ndarray:
    """(PASSES, steps, 2) times on the wall and on the processor, in us."""
    times = np.empty((PASSES, steps, 2))
    loop.torques, loop.targets = (list(islice(rows, steps)) for rows in (loop.torques, loop.targets))
    run(loop, times[0, : 2 * PERIOD])
    gc.collect()
    gc.disable()
    try:
        for part in times:
            loop.stepper.reset(loop.state)
            run(loop, part)
    finally:
        gc.enable()
    return 1e-3 * times


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--loops", default=",".join(LOOPS))
    options = parser.parse_args(arguments)
    steps = max(options.steps // PASSES, 1)
    for name in options.loops.split(","):
        loop = LOOPS[name](steps)
        times = measured(loop, steps)
        print(f"{name}: load {os.getloadavg()[0]:.1f}; {PASSES} passes of {steps} steps, us")
        print(f"{'':10}{'wall':>10}{'processor':>12}{f'least of {PASSES}':>14}")
        columns = *times.reshape(-1, 2).T, times[:, :, 0].min(axis=0)
        for share in (0.5, 0.9, 0.99, 0.999, 0.9999, 1.0):
            wall, work, least = (np.quantile(column, share) for column in columns)
            print(f"{100.0 * share:8.5g} %{wall:10.1f}{work:12.1f}{least:14.1f}")
        room = times[0]
        loop.stepper.reset(loop.state)
        tracemalloc.start()
        run(loop, room[:PERIOD])
        before, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        run(loop, room[: 5 * PERIOD])
        after, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        print(f"memory after {len(room[: 5 * PERIOD])} steps more: {after - before} bytes; {peak - before} at work")


if __name__ == "__main__":
    main()
