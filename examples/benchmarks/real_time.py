"""The longest times of a step in a control loop: the quadruped on implicit PD actuators with moving targets.

Every step sets new targets and makes one step of 1 ms. Printed are the quantiles of its time on the wall, which on a
busy machine are those of its other work, and on the processor; and whether the loop allocates anything, counted by
tracemalloc in a loop of its own.

    python examples/benchmarks/real_time.py [--steps 1000000]
"""

from __future__ import annotations

import argparse
import gc
import math
import os
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np

import pincontact as pc

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from quadruped import quadruped, standing

STIFFNESS, DAMPING = 2000.0, 20.0
# steps of a period of the targets, of which there is a table: the loop is the stepper's alone
PERIOD = 2000


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    count = parser.parse_args(arguments).steps
    scene = quadruped()
    state = standing(scene)
    stepper = pc.Stepper(scene, state, 1e-3)
    stepper.pd(STIFFNESS, DAMPING, state.q)
    tau, target = np.zeros(scene.model.nv), stepper.target
    # the body bobs by 2 cm or so and sways, on four feet, one of them on ice
    targets = np.tile(state.q, (PERIOD, 1))
    for i in range(PERIOD):
        phase = 2.0 * math.pi * i / PERIOD
        targets[i, 8::3] += 0.1 * math.sin(phase)
        targets[i, 9::3] -= 0.2 * math.sin(phase)
        targets[i, 7::3] += 0.05 * math.sin(2.0 * phase)
    rows = list(targets)
    times, clock, processor = np.empty((count, 2)), time.perf_counter_ns, time.thread_time_ns

    def loop(steps: int) -> None:
        for i in range(steps):
            before = processor()
            began = clock()
            target[:] = rows[i % PERIOD]
            stepper.step(tau)
            times[i, 0] = clock() - began
            times[i, 1] = processor() - before

    loop(min(count, 2 * PERIOD))
    gc.collect()
    gc.disable()
    try:
        loop(count)
    finally:
        gc.enable()
    print(f"load {os.getloadavg()[0]:.1f}; {count} steps, us\n{'':10}{'wall':>10}{'processor':>12}")
    for share in (0.5, 0.9, 0.99, 0.999, 0.9999, 1.0):
        wall, work = 1e-3 * np.quantile(times, share, axis=0)
        print(f"{100.0 * share:8.5g} %{wall:10.1f}{work:12.1f}")
    tracemalloc.start()
    loop(min(count, PERIOD))
    before, _ = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    loop(min(count, 5 * PERIOD))
    after, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    print(f"memory after {min(count, 5 * PERIOD)} steps more: {after - before} bytes; at most {peak - before} at work")


if __name__ == "__main__":
    main()
