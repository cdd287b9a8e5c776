"""Random motions, each followed in several ways that must agree.

    python tests/stress/differential.py [--count 10000] [--seed 0] [--jobs 2] [--only SEED]

Every motion is run (a) at default options by a random event-driven method, (b) at tight tolerances in short steps, (c)
by time stepping in two sizes of steps, (d) as (a), with the whole world turned and contacts made in another order. Runs
that end with status 0 must agree within what their tolerances, and the halving of steps, explain. A motion that its
own start, or its loads, decide no better is told apart by what small changes of these do to (b) alone. Nothing may gain
energy. Prints how many runs ended with which status, what disagrees, and, for a hundred of those that ended before
their time, whether a solution existed.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import linprog

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from random_motions import Motion, kind_of, random_motion

import pincontact as pc
from pincontact.dynamics.system import System
from pincontact.integration.discrete import write_discrete
from pincontact.layout import FRICTIONLESS, OK

METHODS = ("DOP853", "DOP853", "DOP853", "RK45", "RK23", "Sharp98")
TIGHT: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-13}
STEP = 1e-3
OUTPUTS = 20
# ends before their time of which is said whether a solution existed
ENDS_ASKED = 100
MAX_STEPS = 10_000
# What runs at default tolerances (1e-8) may differ by, in every component of q, where errors do not grow and speeds are
# those of 1 m/s: a hundred steps' and events'. RK23 takes a hundred times as many steps.
CLOSE = {"DOP853": 1e-6, "Sharp98": 1e-6, "RK45": 1e-6, "RK23": 1e-5}
# An error of up to so many times what errors of the tolerances grow to counts as theirs if, with a hundredth of the
# tolerances, it falls to the last part:
# what begins with a square root, a graze or a rebound, goes with a power of them below one, and rebounds may be many.
CONVERGING, FALLS_TO = 1e2, 0.2
# m: what bodies overlap by, at most: slips in slow friction and rebounds that end
INSIDE, INSIDE_STEPS = 1e-4, 2.0
# m/s and rad/s that rebounds which end take or leave: 1 mm/s at a tenth of a metre
REST = 1e-2
# Energy made, over the largest kinetic energy: by errors of the tolerance, and of first order of a time step.
GAIN, GAIN_STEPS = 1e-6, 0.1
# s: impacts nearer to each other are one at default tolerances, which know positions to 1e-7 m.
SAME = 1e-7
# Errors of time stepping, over those that halving shows, and over what its velocities cover in a step.
HALVED, COVERED = 4.0, 2.0


@dataclass
class Finding:
    """What one seed showed. statuses: by kind of run; wrong: what disagrees; undecided: what does for a reason."""

    seed: int
    kind: str
    statuses: dict[str, int] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    undecided: list[str] = field(default_factory=list)
    ends: list[tuple[str, str]] = field(default_factory=list)
    seconds: float = 0.0


class Runs:
    """The runs of one motion."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.times = motion.t + np.linspace(0.0, motion.duration, OUTPUTS + 1)

    def run(self, motion: Motion | None = None, **options: Any) -> pc.Trajectory:
        motion = motion or self.motion
        given: dict[str, Any] = {"max_steps": MAX_STEPS, "t_eval": self.times, "energies": True} | options
        if motion.control is not None:
            given |= {"control": motion.control, "breakpoints": motion.breakpoints}
        return pc.simulate(motion.scene, motion.state(), motion.duration, **given)

    def tight(self, motion: Motion | None = None) -> pc.Trajectory:
        return self.run(motion, max_step=self.motion.duration / 200.0, **TIGHT)

    def stepped(self, step: float, motion: Motion | None = None) -> pc.Trajectory:
        # as many as halved steps are
        most = max(MAX_STEPS, int(2.0 * self.motion.duration / step))
        return self.run(motion, method="Moreau", step=step, max_steps=most)

    def bounces(self, contact: str | None) -> bool:
        return contact in self.motion.scene.contacts and self.motion.scene.contacts[contact].restitution > 0.0

    def apart(self, one: pc.Trajectory, two: pc.Trajectory) -> np.ndarray:
        """Largest difference so far of any component of q, at the outputs that both have."""
        n = min(self.reached(one), self.reached(two))
        model = self.motion.scene.model
        apart = [np.abs(pin.difference(model, one.q[i], two.q[i])).max(initial=0.0) for i in range(n)]
        return np.maximum.accumulate(np.array(apart)) if n else np.zeros(0)

    def reached(self, run: pc.Trajectory) -> int:
        """How many of the outputs a run has; one that ends early has a row for its end besides."""
        n = min(run.t.size, self.times.size)
        return int((np.abs(run.t[:n] - self.times[:n]) < 1e-9).sum())

    def changed(self, size: float, rng: np.random.Generator) -> Motion:
        """The motion with its start and its weights changed by `size`."""
        motion, model = self.motion, self.motion.scene.model
        other = motion.rebuilt(gravity=1.0 + size * rng.choice([-1.0, 1.0]))
        v = motion.v + size * rng.normal(size=model.nv)
        q = pin.integrate(model, motion.q, size * rng.normal(size=model.nv))
        at_ends = (model.lowerPositionLimit > -1e300) | (model.upperPositionLimit < 1e300)
        if q.size == model.nv and at_ends.any():
            q = np.where(at_ends, motion.q, q)
        for start in (replace(other, q=q, v=v), replace(other, v=v), other):
            try:
                start.state()
            except pc.ContactError:
                continue
            return start
        return other

    def spread(self, size: float, exact: pc.Trajectory) -> np.ndarray:
        """How far apart changes of `size` bring tight runs, at every output, beyond what they are themselves."""
        spread = np.zeros(OUTPUTS + 1)
        for i in range(2):
            run = self.tight(self.changed(size, np.random.default_rng(i)))
            apart = self.apart(run, exact)
            spread[: apart.size] = np.maximum(spread[: apart.size], apart)
            if apart.size:
                spread[apart.size :] = np.maximum(spread[apart.size :], apart[-1])
        return np.maximum(spread - 5.0 * size * (1.0 + self.times - self.times[0]), 0.0)


def gain(run: pc.Trajectory, passive: bool, stepped: bool) -> float:
    """Energy made, over the largest kinetic energy, or what was turned over between outputs."""
    energies = run.energies()
    scale = max(float(energies.kinetic.max()), 1e-3) + float(np.abs(energies.total - energies.total[0]).max())
    works = energies.friction_work, energies.drive_work, energies.torque_work, energies.damping_work
    scale += sum(float(np.abs(work).max()) for work in works if work is not None)
    # what is lost is as much as the quadrature of works misses where slip all but ends
    balance = energies.balance
    found = 0.0 if stepped else float(max(balance.max(), -0.1 * balance.min()))
    if passive:
        found = max(found, float((energies.total - np.minimum.accumulate(energies.total)).max()))
    return found / scale


def samples(contour: pc.Contour) -> np.ndarray:
    """Points all over a contour of finite extent, (n, 3), in its own frame."""
    ends = np.array(contour.domain, dtype=float).reshape(-1, 2)
    if not np.isfinite(ends).all():
        return np.zeros((0, 3))
    lines = [np.linspace(low, high, 720 if len(ends) == 1 else 180) for low, high in ends]
    parameters = np.array(list(itertools.product(*lines)))
    return contour.evaluate_many(parameters.reshape(len(parameters), len(ends)))[:, 0]


def overlap(motion: Motion, run: pc.Trajectory) -> np.ndarray:
    """How far in m bodies are below the grounds that they may touch, at every output: by samples of all of the body,
    not by the nearest points that the run knows. Of grounds that are fixed planes and height fields, half a metre
    inside their ends, which are edges that nobody declared."""
    scene, data = motion.scene, motion.scene.model.createData()
    deepest = np.zeros(len(run.q))
    pairs = {(c.first.name, c.second.name): c for c in scene.contacts.values() if not c.bilateral and c.side != -1}
    for contact in pairs.values():
        body, ground = contact.first, contact.second
        shape = ground.contour
        if not isinstance(shape, (pc.Plane, pc.HeightField)) or ground.motion or shape.time_dependent:
            continue
        points, ends = samples(body.contour), np.array(shape.domain)
        for i, q in enumerate(run.q):
            pin.forwardKinematics(scene.model, data, q)
            onto = (data.oMi[ground.joint] * ground.placement_in_joint).actInv(
                data.oMi[body.joint] * body.placement_in_joint
            )
            x = points @ onto.rotation.T + onto.translation
            x = x[((x[:, :2] > ends[:, 0] + 0.5) & (x[:, :2] < ends[:, 1] - 0.5)).all(axis=1)]
            if len(x):
                deepest[i] = max(deepest[i], float((shape.evaluate_many(x[:, :2])[:, 0, 2] - x[:, 2]).max()))
    return deepest


def first_over(apart: np.ndarray, allowed: np.ndarray | float) -> int | None:
    """Index of the first output at which more than what is allowed lies between two runs."""
    over = np.flatnonzero(apart > np.broadcast_to(allowed, apart.shape))
    return int(over[0]) if over.size else None


def crushed(motion: Motion, state: pc.State) -> bool:
    """Whether no velocity keeps all bodies apart that touch: no impulse can stop them from overlapping."""
    contacts = list(motion.scene.contacts.values())
    system = System(motion.scene.model, contacts)
    discrete = state.discrete.copy()
    discrete[:, 0] = FRICTIONLESS
    write_discrete(system, discrete)
    system.q[:], system.v[:], system.location[: system.nc] = state.q, state.v, state.location
    if not contacts or system.evaluate_kinematics(state.t) != OK:
        return False
    touching = np.abs(system.gaps[: system.nc, 0]) < 1e-6
    rows = system.rows[: system.nc, 2][touching]
    speeds = np.einsum("ij,ij->i", system.basis[: system.nc, 2], system.slip[: system.nc])[touching]
    # the change of v that leaves the least speed of approach, which is the last unknown
    least = linprog(
        np.append(np.zeros(system.nv), 1.0),
        A_ub=-np.column_stack([rows, np.ones(len(rows))]),
        b_ub=speeds,
        bounds=[(None, None)] * system.nv + [(0.0, None)],
    )
    return bool(least.fun > 1e-6)


def solution_after(runs: Runs, name: str, run: pc.Trajectory, exact: pc.Trajectory, **options: Any) -> str:
    """What is known of a motion after a run of these options has ended before its time."""
    if run.status == -8:
        return "none: a bilateral contact at the end of its contour"
    if run.status == -3 and "degenerates" in run.message:
        return "none of a point contact, which becomes one along a line"
    # outputs need not be where it has ended
    state = runs.run(t_eval=None, **options).state(-1)
    if run.status == -4 and crushed(runs.motion, state):
        return "none: crushed, whatever the impulses"
    if name == "steps":
        return "yes, the tight run went on" if exact.status == 0 else "unknown, the tight run ended as well"
    motion, rest = runs.motion, runs.motion.t + runs.motion.duration - state.t
    given: dict[str, Any] = {"step": 1e-4, "max_steps": MAX_STEPS}
    if motion.control is not None:
        given |= {"control": motion.control, "breakpoints": motion.breakpoints}
    after = pc.simulate(motion.scene, state, min(rest, 0.01), method="Moreau", **given)
    if after.status < 0:
        return f"none found: time stepping ends with {after.status} there"
    for count, means in (("softened", "compliance"), ("settled", "friction of other loads")):
        if after.stats[count]:
            return f"only with {means}, in {after.stats[count]} steps"
    return "yes, time stepping goes on"


def judge(
    runs: Runs, one: pc.Trajectory, exact: pc.Trajectory, name: str, method: str, finding: Finding, motion: Motion
) -> None:
    """Compare a run of `motion` by a method at its default tolerances, with errors of these, with the exact one."""
    close = CLOSE[method]
    # tolerances are relative to what moves
    close *= max(1.0, float(np.abs(exact.v).max(initial=0.0)))
    apart = runs.apart(one, exact)
    if first_over(apart, close) is None:
        return
    # what errors of the tolerances grow to
    growth = 1.0 + runs.spread(1e-9, exact)[: apart.size] / 1e-9
    i = first_over(apart, close * growth)
    if i is None:
        finding.undecided.append(f"{name}: {apart.max():.1e} apart, errors grow {growth.max():.1e} times")
        return
    # rebounds below 1 mm/s, and hops lower than gaps are known, end in contact
    struck = [e.time for e in exact.events if e.kind == "touch" and runs.bounces(e.contact)]
    if struck:
        since = np.maximum(runs.times[: apart.size] - min(struck), 0.0)
        if first_over(apart, (close + REST * since) * growth) is None:
            finding.undecided.append(f"{name}: {apart.max():.1e} apart, after rebounds that end")
            return
    # where a change of 1e-9 is too small to turn what one of 1e-7 does
    wider = np.maximum(runs.spread(1e-7, exact), runs.spread(1e-6, exact))[: apart.size]
    if first_over(apart, np.maximum(close * growth, 10.0 * wider)) is None:
        finding.undecided.append(f"{name}: {apart.max():.1e} apart, changes of 1e-6 make {wider.max():.1e}")
        return
    finer = runs.run(motion, method=method, rtol=1e-10, atol=1e-12)
    nearer = runs.apart(finer, exact)
    # a run that ends early tells as much as it has
    n = nearer.size
    begins = first_over(apart, CONVERGING * np.maximum(close * growth, 10.0 * wider)) is None
    if n > i and begins and nearer.max() < FALLS_TO * apart[:n].max():
        finding.undecided.append(
            f"{name}: {apart.max():.1e} apart, {nearer.max():.1e} with a hundredth of the tolerance"
        )
        return
    if strikes_within(SAME, *near_until(runs, apart, close), one, exact):
        finding.undecided.append(f"{name}: {apart.max():.1e} apart, two impacts as near as positions are known")
        return
    if one.stats["open_loads"] or exact.stats["open_loads"]:
        finding.undecided.append(f"{name}: {apart.max():.1e} apart, and say that redundant loads are open")
        return
    finding.wrong.append(f"{name}: {apart[i]:.1e} apart at {runs.times[i]:.3f} s, {apart.max():.1e} later")


def slides_instead(motion: Motion, stepped: pc.Trajectory, exact: pc.Trajectory, until: float) -> bool:
    """Whether ideal rolling slides up to that time in time stepping which the exact run lets go, to dip: both say that
    they do."""

    def slides(run: pc.Trajectory, name: str) -> bool:
        return any(e.kind == "slip" and e.contact == name and e.time <= until for e in run.events)

    ideal = [name for name, contact in motion.scene.contacts.items() if isinstance(contact.friction, pc.NoSlip)]
    return any(slides(stepped, name) and not slides(exact, name) for name in ideal)


def strikes_within(step: float, since: float, until: float, *runs: pc.Trajectory) -> bool:
    """Whether two impacts of different contacts or stops are less than a step apart: steps take them as one, and the
    first may keep the second from striking in the exact run."""
    for run in runs:
        struck = [(e.time, e.contact) for e in run.events if e.kind in ("touch", "limit") and since < e.time <= until]
        if any(t1 - t0 < step and one != two for (t0, one), (t1, two) in pairwise(struck)):
            return True
    return False


def near_until(runs: Runs, apart: np.ndarray, allowed: float) -> tuple[float, float]:
    """The outputs between which runs come to be further apart than that."""
    i = first_over(apart, allowed) or 0
    return float(runs.times[max(i - 1, 0)]), float(runs.times[i])


def judge_steps(runs: Runs, exact: pc.Trajectory, finding: Finding) -> None:
    """Compare time stepping with the exact run: steps are halved until it is near, or nearer by half and more."""
    first, second = runs.stepped(STEP), runs.stepped(0.5 * STEP)
    finding.statuses["steps"], finding.statuses["half steps"] = first.status, second.status
    for run, step in ((first, STEP), (second, 0.5 * STEP)):
        made = gain(run, runs.motion.passive, stepped=True)
        if run.status == 0 and made > GAIN_STEPS:
            finding.wrong.append(f"steps of {step}: gains {made:.1e} of its energy")
        inside = overlap(runs.motion, run).max(initial=0.0)
        if inside > INSIDE_STEPS * step * max(1.0, float(np.abs(run.v).max(initial=0.0))):
            finding.wrong.append(f"steps of {step}: bodies are {inside:.1e} m inside each other")
    if first.status != 0:
        solution = solution_after(runs, "steps", first, exact, method="Moreau", step=STEP)
        finding.ends.append((f"steps: {first.status}: {first.message}", solution))
    if min(first.status, second.status, exact.status) < 0:
        return
    speed = max(float(np.abs(exact.v).max()), 1e-2)
    halved, apart = runs.apart(first, second), runs.apart(second, exact)
    n = min(halved.size, apart.size)
    if first_over(apart[:n], HALVED * halved[:n] + COVERED * 0.5 * STEP * speed) is None:
        return
    found, step = [apart], 0.5 * STEP
    # an impact that is nearly another, within 0.3 %, is told from it in steps of a hundredth of a millisecond only
    for _ in range(5):
        step *= 0.5
        run = runs.stepped(step)
        if run.status < 0:
            break
        found.append(runs.apart(run, exact))
        if found[-1].max() < 0.3 * apart.max() or first_over(found[-1], COVERED * step * speed) is None:
            return
    wide = np.maximum(runs.spread(1e-5, exact), runs.spread(STEP, exact))[: found[-1].size]
    i = first_over(found[-1], 5.0 * wide + COVERED * step * speed)
    said = " ".join(f"{a.max():.1e}" for a in found)
    if i is None:
        finding.undecided.append(f"steps: {said} apart, changes of {STEP} make {wide.max():.1e}")
    elif slides_instead(runs.motion, second, exact, float(runs.times[i])):
        finding.undecided.append(f"steps: {said} apart, ideal rolling is let go with a force")
    elif any(r.stats["open_loads"] for r in (first, second, exact)):
        finding.undecided.append(f"steps: {said} apart, and say that redundant loads are open")
    elif strikes_within(step, *near_until(runs, found[-1], COVERED * step * speed), exact, run):
        finding.undecided.append(f"steps: {said} apart, two impacts within a step")
    else:
        finding.wrong.append(f"steps: {said} apart with halved steps, {found[-1][i]:.1e} at {runs.times[i]:.3f} s")


def check(seed: int) -> Finding:
    """All runs of a seed, compared."""
    began = time.process_time()
    finding = Finding(seed, kind_of(seed))
    try:
        _check(seed, finding)
    except pc.ContactError as error:
        finding.statuses["refused"] = 0
        finding.ends.append((f"{type(error).__name__}: {error}", ""))
    except Exception as error:
        finding.wrong.append(f"raised {error!r}")
    finding.seconds = time.process_time() - began
    return finding


def _check(seed: int, finding: Finding) -> None:
    _, motion = random_motion(seed)
    rng = np.random.default_rng(seed + 10**9)
    runs, method = Runs(motion), str(rng.choice(METHODS))
    default, exact = runs.run(method=method), runs.tight()
    world = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    other = motion.rebuilt(world, rng)
    turned = runs.run(other, method=method)
    for name, run in (("default", default), ("tight", exact), ("turned", turned)):
        finding.statuses[name] = run.status
        made = gain(run, motion.passive, stepped=False)
        if run.status == 0 and made > GAIN:
            finding.wrong.append(f"{name} ({method}): gains {made:.1e} of its energy")
        inside = overlap(other if name == "turned" else motion, run).max(initial=0.0)
        if inside > INSIDE:
            finding.wrong.append(f"{name} ({method}): bodies are {inside:.1e} m inside each other")
        if run.status != 0:
            solution = solution_after(runs, name, run, exact, method=method) if name == "default" else ""
            finding.ends.append((f"{name} ({method}): {run.status}: {run.message}", solution))
    if default.status == 0:
        judge(runs, default, exact, f"default ({method})", method, finding, motion)
        if turned.status == 0:
            judge(runs, turned, exact, f"turned ({method})", method, finding, other)
    judge_steps(runs, exact, finding)


def findings(seeds: range, jobs: int) -> Iterator[Finding]:
    if jobs == 1:
        yield from map(check, seeds)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(check, seeds, chunksize=4)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=8_000_000, help="the first; from 8,000,000 on of all kinds")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", type=int, help="this seed alone")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.count)
    if options.only is not None:
        seeds, options.jobs = range(options.only, options.only + 1), 1
    statuses: dict[str, Counter[int]] = {}
    wrong = undecided = asked = 0
    for finding in findings(seeds, options.jobs):
        for name, status in finding.statuses.items():
            statuses.setdefault(name, Counter())[status] += 1
        wrong += bool(finding.wrong)
        undecided += bool(finding.undecided)
        head = f"seed {finding.seed} ({finding.kind})"
        for text in finding.wrong:
            print(f"{head}: WRONG: {text}", flush=True)
        for text in finding.undecided:
            print(f"{head}: undecided: {text}", flush=True)
        for text, solution in finding.ends:
            print(f"{head}: ended: {text}", flush=True)
            if solution and asked < ENDS_ASKED:
                asked += 1
                print(f"{head}: solution: {solution}", flush=True)
        if finding.seconds > 10.0:
            print(f"{head}: took {finding.seconds:.1f} s", flush=True)
    for name, counts in statuses.items():
        print(f"{name:12s} {dict(sorted(counts.items(), reverse=True))}")
    print(f"{len(seeds)} motions, {wrong} wrong, {undecided} undecided")
    return min(wrong, 1)


if __name__ == "__main__":
    sys.exit(main())
