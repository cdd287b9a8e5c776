"""Many starts at once: `pc.rollout` beside MuJoCo's `rollout`, in one thread and in several.

Three scenes of the work-precision benchmark's kind, each from starts whose velocities are scaled by 0.9 to 1.1: the
rolling disk, the quadruped on joint springs, and a block that slides to rest on four feet. The error is the largest
distance of any marker from a run to rtol 1e-13, over all output times of the first, a middle and the last start. Times
are of the whole batch, per start: on the wall, and of all processors together, which is the one to compare on a busy
machine. Speed-up: wall time in one thread over that in several.

    python examples/benchmarks/rollouts.py [--starts 64] [--threads 2] [--scenes disk_roll,quadruped,block]
        [--repeats 5] [--quick]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from peers.problem import FLOOR, Body, Problem, Shape, Touch, marked
from peers.scenes import SCENES
from peers.with_pincontact import build_scene, consistent, reference

import pincontact as pc

# steps in each of the output intervals
OURS, MUJOCO = (1, 2, 5, 10, 50), (5, 20, 50, 200, 1000)


def block() -> Problem:
    """A block slides on four feet, without turning, and comes to rest."""
    feet = [Shape("point", (), "block", (x, y, -0.05)) for x in (-0.2, 0.2) for y in (-0.1, 0.1)]
    return Problem(
        "block", "block sliding to rest on four feet", (Body("block", "free", 2.0, np.diag([0.02, 0.03, 0.04])),),
        tuple(Touch(foot, FLOOR, 0.3) for foot in feet), np.array([0, 0, 0.05, 0, 0, 0, 1.0]),
        np.array([1.0, 0.6, 0, 0, 0, 0]), 0.8, (("block", (0.2, 0.1, -0.05)),), "a foot",
    )  # fmt: skip


PROBLEMS: dict[str, Callable[[], Problem]] = {
    "disk_roll": SCENES["disk_roll"],
    "quadruped": SCENES["quadruped"],
    "block": block,
}

# the configurations (B, intervals, nq) that a run with so many threads gives
Run = Callable[[int], np.ndarray]


def ours(problems: list[Problem]) -> Iterator[tuple[str, float, Run]]:
    """Springs as implicit actuators, dampers as the model's own."""
    problem = problems[0]
    scene, nv, n = build_scene(problem), problem.v.size, problem.intervals
    states = [scene.initial_state(p.q, p.v) for p in problems]
    torques = np.zeros((len(states), n, nv))
    kp, rest = np.zeros(nv), np.array(problem.q)
    for body, (iq, iv) in zip(problem.bodies, problem.slices().values()):
        if body.stiffness:
            kp[iv], rest[iq] = body.stiffness, body.rest
    pd = (kp, 0.0, rest) if kp.any() else None
    for each in OURS:
        dt = problem.duration / (n * each)

        def run(threads: int, dt: float = dt, each: int = each) -> np.ndarray:
            q, _, status = pc.rollout(scene, states, torques, dt, each, threads, pd=pd)
            if status.any():
                raise RuntimeError(f"status {status}")
            return q

        yield "pincontact", dt, run


def mujocos(problems: list[Problem]) -> Iterator[tuple[str, float, Run]]:
    try:
        import mujoco
        from mujoco.rollout import Rollout
    except ImportError:
        print("MuJoCo is not installed")
        return
    from peers.with_mujoco import METHODS, _coordinates, build

    n = problems[0].intervals
    for label in ("implicit", "RK4"):
        integrator, options = METHODS[label]
        for each in MUJOCO:
            dt = problems[0].duration / (n * each)
            whole, first = mujoco.mjtState.mjSTATE_FULLPHYSICS, []
            for problem in problems:
                model, data = build(problem, dt, integrator, options)
                first.append(np.empty(mujoco.mj_stateSize(model, whole)))
                mujoco.mj_getState(model, data, first[-1], whole)
            starts = np.array(first)

            def run(threads: int, model=model, starts: np.ndarray = starts, each: int = each) -> np.ndarray:
                datas = [mujoco.MjData(model) for _ in range(threads)]
                with Rollout(nthread=threads if threads > 1 else 0) as rollout:
                    states, _ = rollout.rollout([model] * len(starts), datas, starts, nstep=n * each)
                rows = states[:, each - 1 :: each, 1 : 1 + model.nq]
                return np.array([_coordinates(problems[0], model, q) for q in rows])

            yield f"MuJoCo {label}", dt, run


def timed(run: Run, threads: int, repeats: int) -> tuple[np.ndarray, np.ndarray]:
    """Least wall and processor times in s of runs in one thread and in several, by turns: [[wall, processor], ...]; and
    what the last run gave."""
    least = np.full((2, 2), np.inf)
    for _ in range(repeats):
        for times, count in zip(least, (1, threads)):
            began, before = time.perf_counter(), time.process_time()
            q = run(count)
            np.minimum(times, (time.perf_counter() - began, time.process_time() - before), out=times)
    return least, q


def main(arguments: list[str] | None = None) -> list[tuple[str, str, float, float, float, float]]:
    """Print the tables; returns (scene, engine, step in s, error in m, wall time in one thread, in several, in s)."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=64)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--scenes", default=",".join(PROBLEMS))
    parser.add_argument("--repeats", type=int, default=5, help="runs by turns, of which the least time counts")
    parser.add_argument("--quick", action="store_true", help="one run each, without the shortest steps")
    options = parser.parse_args(arguments)
    rows = []
    print(f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}; times per start, of {options.starts}")
    for name in options.scenes.split(","):
        problem = consistent(PROBLEMS[name]())
        problems = [replace(problem, v=scale * problem.v) for scale in np.linspace(0.9, 1.1, options.starts)]
        watched = sorted({0, options.starts // 2, options.starts - 1})
        expected = [reference(problems[i])[0][1:] for i in watched]
        print(f"\n{problem.title}, {problem.duration} s\n{'':18}{'step':>10}{'error':>10}{'wall 1':>11}", end="")
        print(f"{f'wall {options.threads}':>11}{'CPU 1':>11}{f'CPU {options.threads}':>11}{'speed-up':>10}")
        for engine in (ours, mujocos):
            for k, (label, dt, run) in enumerate(engine(problems)):
                if options.quick and k % len(OURS) > 2:
                    continue
                repeats = 1 if options.quick else options.repeats
                try:
                    if not options.quick:
                        run(1)
                    ((wall, work), (walls, works)), q = timed(run, options.threads, repeats)
                except RuntimeError as failure:
                    print(f"{label:18}{dt:10.2g}  {str(failure)[:60]}")
                    continue
                error = max(
                    float(np.linalg.norm(marked(problem, q[i]) - right, axis=2).max())
                    for i, right in zip(watched, expected)
                )
                scaled = [1e6 * t / options.starts for t in (wall, walls, work, works)]
                print(f"{label:18}{dt:8.2g} s{error:8.1e} m" + "".join(f"{t:8.0f} us" for t in scaled), end="")
                print(f"{wall / walls:10.2f}")
                rows.append((name, label, dt, error, wall, walls))
    return rows


if __name__ == "__main__":
    main()
