"""Robots people bring: python tests/stress/robots.py [robot ...] [--runs limp,standing] [--methods ...]

Every robot of example-robot-data that Pinocchio loads, with spheres at its last links, over a plane: dropped limp from
1 cm, and held by PD at its reference configuration, for half a second, each robot and motion in a process of its own.
Prints a table: how far coarser steps move the end (half as many of time stepping, and a tolerance of 1e-6), which tells
what is chaotic, with an f where time stepping needs steps of 5 us to tell impacts apart, and a c where changes of the
start by 1e-6 rad and m are added, since methods end apart; and for each method status,
processor time in s, and as a multiple of time stepping's, events, and how far the end is from time stepping's. The
event-driven methods run with fallback="Moreau"; F marks the runs that needed it, with what stopped them.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from own_process import in_own_process

import pincontact as pc
from pincontact.dynamics.joints import joint_limits, joint_locks

METHODS = ("Moreau", "DOP853", "RK45")
RUNS = ("limp", "standing")
DURATION, STEP = 0.5, 1e-3
# s: steps that tell impacts apart which longer ones have at once, halved or not. The four knees of B1 reach their stops
# within 90 us.
FINE_STEP = 5e-6
# s that kernels may take to compile
COMPILATION = 60.0
# m: of the spheres at the last links, and what they are dropped from
RADIUS, HEIGHT = 0.02, 0.01
FRICTION = 0.7
# rad/s, and a fraction of critical damping: what PD makes of each joint with the inertia that it moves
STIFFNESS, DAMPING = 15.0, 1.0
# An event-driven run takes no more than so many times the time of time stepping.
FACTOR = 20.0
# rad and m: changes of the start that tell what is chaotic, and how many are tried
DISTURBANCE, DISTURBANCES = 1e-6, 3
# m: changes of the end up to the first count as none, beyond the second as chaos; an end further than so many times the
# change from time stepping's is a fault.
_SMALL, _CHAOTIC, _APART = 1e-3, 1e-2, 10.0
# s: shorter runs are timed a second time
_LONG = 2.0
# m: feet are what is no higher over the lowest sphere; what stands starts so far over the floor
_LEVEL, _START = 0.05, 1e-3
# Inertia that PD counts with, as a multiple of what the joint itself moves, at most.
_HEAVIEST = 5.0
# Reference configurations by what SRDF files call them, in this order.
POSTURES = ("standing", "half_sitting", "home", "default")

# Files below example-robot-data's folder "robots": those that walk, drive or fly, and those that are mounted.
FREE = (
    "a1_description/urdf/a1",
    "alex_description/urdf/alex_nub_hands",
    "alexander_description/urdf/alexander_v1.lowerBodyOnly",
    "anymal_b_simple_description/robots/anymal",
    "anymal_b_simple_description/robots/anymal-kinova",
    "anymal_c_simple_description/urdf/anymal",
    "b1_description/urdf/b1",
    "b1_description/urdf/b1-z1",
    "bolt_description/robots/bolt",
    "borinot_description/urdf/borinot_flying_arm_2",
    "centauro_description/urdf/centauro",
    "g1_description/urdf/g1_29dof_rev_1_0",
    "g1_description/urdf/g1_29dof_with_hand_rev_1_0",
    "go1_description/urdf/go1",
    "go2_description/urdf/go2",
    "hector_description/robots/quadrotor_base",
    "hextilt_description/urdf/hextilt_flying_arm_5",
    "human_description/robots/human",
    "hyq_description/robots/hyq_no_sensors",
    "icub_description/robots/icub",
    "icub_description/robots/icub_reduced",
    "iris_description/robots/iris_simple",
    "laikago_description/urdf/laikago",
    "pr2_description/urdf/pr2",
    "quadruped_description/urdf/quadruped",
    "romeo_description/urdf/romeo",
    "romeo_description/urdf/romeo_small",
    "simple_humanoid_description/urdf/simple_humanoid",
    "simple_humanoid_description/urdf/simple_humanoid_classical",
    "solo_description/robots/solo",
    "solo_description/robots/solo12",
    "talos_data/robots/talos_full_v2",
    "talos_data/robots/talos_reduced",
    "tiago_description/robots/tiago",
    "tiago_description/robots/tiago_dual",
    "tiago_pro_description/robots/tiago_pro",
)
# Some of these robots' joints move nothing that has inertia, the human's where the axes of three of them come into one
# plane: their motors get some, in kg m^2.
LIGHT = ("human_description/robots/human", "icub_description/robots/icub", "romeo_description/urdf/romeo")
ARMATURE = 1e-4
FIXED = (
    "allegro_hand_description/urdf/allegro_left_hand",
    "allegro_hand_description/urdf/allegro_right_hand",
    "asr_twodof_description/urdf/TwoDofs",
    "baxter_description/urdf/baxter",
    "double_pendulum_description/urdf/double_pendulum",
    "double_pendulum_description/urdf/double_pendulum_continuous",
    "double_pendulum_description/urdf/double_pendulum_simple",
    "finger_edu_description/robots/finger_edu",
    "kinova_description/robots/kinova",
    "panda_description/urdf/panda",
    "so_arm_description/urdf/so101",
    "talos_data/robots/talos_left_arm",
    "ur_description/urdf/ur3_gripper",
    "ur_description/urdf/ur5_joint_limited_robot",
    "ur_description/urdf/ur10_robot",
    "xarm_description/urdf/xarm7",
    "z1_description/urdf/z1",
)
ROBOTS = {
    # two files have one name
    file.split("_simple")[0] if file.endswith("/anymal") else Path(file).name: file
    for file in (*FREE, *FIXED)
}


def robots_folder() -> Path | None:
    """Where example-robot-data keeps its robots; None where it is not installed."""
    try:
        share = metadata.distribution("example-robot-data").locate_file("cmeel.prefix/share")
    except metadata.PackageNotFoundError:
        return None
    folder = Path(str(share)) / "example-robot-data" / "robots"
    return folder if folder.is_dir() else None


@dataclass
class Robot:
    """A scene with spheres at the last links, at rest with the lowest one HEIGHT over the floor."""

    scene: pc.Scene
    q: np.ndarray
    free: bool
    feet: list[str]

    @property
    def model(self) -> pin.Model:
        return self.scene.model


def load(folder: Path, file: str) -> Robot:
    """Raises what Pinocchio or Scene do of models that cannot be used."""
    free, urdf = file in FREE, str(folder / f"{file}.urdf")
    model = pin.buildModelFromUrdf(urdf, pin.JointModelFreeFlyer()) if free else pin.buildModelFromUrdf(urdf)
    q = _posture(model, folder / file.split("/")[0] / "srdf")
    # the posture of a file, and the neutral one, may lie beyond the model's limits
    _keep_within(model, q)
    if file in LIGHT:
        model.armature[6 if free else 0 :] = ARMATURE
    if free:
        q[:7] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    scene = pc.Scene(model)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    parents = set(list(model.parents)[1:])
    feet: list[tuple[float, str]] = []
    for j in range(1, model.njoints):
        bodies = [f for f in model.frames if f.parentJoint == j and f.type == pin.FrameType.BODY]
        if j in parents or not bodies:
            continue
        placements = {f.name: data.oMf[model.getFrameId(f.name, pin.FrameType.BODY)].translation[2] for f in bodies}
        lowest = min(placements, key=lambda name: placements[name])
        feet.append((float(placements[lowest]), lowest))
    bottom = min(height for height, _ in feet) - RADIUS - HEIGHT
    floor_at = 0.0
    if free:
        q[2] = -bottom
    else:
        floor_at = bottom
    floor = scene.add_contour("floor", pc.Plane(), placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, floor_at])))
    for _, name in feet:
        sphere = scene.add_contour(name, pc.Sphere(RADIUS), name)
        scene.add_contact(name, sphere, floor, friction=pc.Coulomb(FRICTION))
    return Robot(scene, q, free, [name for _, name in feet])


def _keep_within(model: pin.Model, q: np.ndarray) -> None:
    """Move q to the nearest configuration within the model's limits."""
    for limit in joint_limits(model):
        q[limit.index_q] = min(max(q[limit.index_q], limit.low_end), limit.high_end)
    for lock in joint_locks(model):
        q[lock.index_q] = lock.value


def _posture(model: pin.Model, folder: Path) -> np.ndarray:
    """The first known reference configuration of the SRDF files beside a robot that fits it, else the neutral one."""
    for file in sorted(folder.glob("*.srdf"), key=lambda path: len(path.name)):
        pin.loadReferenceConfigurations(model, str(file), False)
    known = model.referenceConfigurations
    for name in POSTURES:
        if name in known and known[name].size == model.nq and np.isfinite(known[name]).all():
            return np.array(known[name])
    return pin.neutral(model)


def pd_control(robot: Robot) -> Callable[[float, np.ndarray, np.ndarray], np.ndarray]:
    """Torques towards the reference configuration, which there hold up gravity, the feet's share of the weight, too.

    Gains are in proportion to the inertia that a joint moves, with the body's as far as explicit steps bear it.
    """
    model, data, wanted = robot.model, robot.model.createData(), robot.q.copy()
    pin.crba(model, data, wanted, pin.Convention.WORLD)
    # what a joint feels while all others are free
    inertia = 1.0 / np.diag(np.linalg.inv(np.triu(data.M) + np.triu(data.M, 1).T))
    held = np.array(pin.computeGeneralizedGravity(model, data, wanted))
    if robot.free:
        weight = pin.computeTotalMass(model) * -model.gravity981[2]
        pin.computeJointJacobians(model, data, wanted)
        pin.updateFramePlacements(model, data)
        heights = {name: data.oMf[model.getFrameId(name, pin.FrameType.BODY)].translation[2] for name in robot.feet}
        feet = [name for name in robot.feet if heights[name] < min(heights.values()) + _LEVEL]
        for name in feet:
            frame = model.getFrameId(name, pin.FrameType.BODY)
            rows = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            held -= rows[2] * weight / len(feet)
        carried = weight / -model.gravity981[2] * wanted[2] ** 2 / len(feet)
        inertia = np.minimum(inertia + carried, _HEAVIEST * inertia)
        inertia[:6] = held[:6] = 0.0
    stiffness, damping = STIFFNESS**2 * inertia, 2.0 * DAMPING * STIFFNESS * inertia

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return held + stiffness * pin.difference(model, q, wanted) - damping * v

    return control


@dataclass
class Outcome:
    """What became of one run; fell_back: whether time stepping had to finish it; distance: in m, of any joint at the
    end from time stepping's with half the step, or with FINE_STEP where it is far from that (NaN without one)."""

    status: int
    message: str
    seconds: float
    events: int
    evaluations: int
    fell_back: bool
    distance: float = math.nan


@dataclass
class Row:
    """One robot, one motion: an outcome for each method, and in m what coarser steps change; fine: those of time
    stepping with twice FINE_STEP; disturbed: with what small changes of the start change."""

    robot: str
    motion: str
    outcomes: dict[str, Outcome]
    changes: float
    fine: bool = False
    disturbed: bool = False

    @property
    def chaotic(self) -> bool:
        """Whether no method says itself where the robot ends."""
        return not self.changes < _CHAOTIC

    @property
    def mark(self) -> str:
        """What its changes are of besides coarser steps."""
        return "c" if self.disturbed else "f" if self.fine else " "

    def apart(self, outcome: Outcome) -> bool:
        """Whether it ends further from time stepping than coarser steps explain."""
        return outcome.distance > _APART * max(self.changes, _SMALL)

    def faults(self) -> Iterator[str]:
        """What is wrong with it, but for its times."""
        for method, outcome in self.outcomes.items():
            if outcome.status != 0:
                yield f"{method}: {outcome.status}, {outcome.message}"
            elif not self.chaotic and self.apart(outcome):
                changes = "coarser steps and small changes of the start" if self.disturbed else "coarser steps"
                yield f"{method}: {outcome.distance:.2g} m from time stepping; {changes} change {self.changes:.2g}"


def _places(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """(joints, 3) in m: where the joints are."""
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return np.array([placement.translation for placement in data.oMi])


def _disturbed(robot: Robot, q: np.ndarray, rng: np.random.Generator) -> pc.State:
    """A start at rest whose joints, within their limits, and height differ by DISTURBANCE and less."""
    model = robot.model
    change = DISTURBANCE * rng.uniform(-1.0, 1.0, model.nv)
    if robot.free:
        change[:6] = 0.0
    moved = pin.integrate(model, q, change)
    _keep_within(model, moved)
    if robot.free:
        moved[2] += DISTURBANCE
    return robot.scene.initial_state(moved, np.zeros(model.nv), free=list(robot.scene.contacts))


def measure(
    robot: Robot,
    motion: str,
    methods: tuple[str, ...],
    report: Callable[[Row], None] = lambda row: None,
    timed: bool = True,
) -> Row:
    """Run one motion in all methods; report(row): called with what is known after each. timed: by second runs."""
    scene, model = robot.scene, robot.model
    q = robot.q.copy()
    if motion == "standing" and robot.free:
        q[2] -= HEIGHT - _START
    state = scene.initial_state(q, np.zeros(model.nv), free=list(scene.contacts))
    control = pd_control(robot) if motion == "standing" else None

    def run(method: str, state: pc.State = state, times: int = 2, **options: Any) -> tuple[Outcome, np.ndarray]:
        seconds = math.inf
        # kernels, imports, and what a first run of a scene prepares, count for no method
        for _ in range(times if timed else 1):
            began = time.process_time()
            found = pc.simulate(scene, state, DURATION, method=method, control=control, **options)
            seconds = min(seconds, time.process_time() - began)
            if seconds > _LONG:
                break
        evaluations, fell_back = int(found.stats.get("rhs", 0)), any(e.kind == "fallback" for e in found.events)
        outcome = Outcome(found.status, found.message, seconds, len(found.events), evaluations, fell_back)
        return outcome, _places(model, found.q[-1])

    row = Row("", motion, {}, math.nan)
    half, ends = run("Moreau", step=0.5 * STEP)
    found = {}
    for method in methods:
        outcome, places = run(method, step=STEP, **({} if method == "Moreau" else {"fallback": "Moreau"}))
        found[method] = places
        if half.status == 0 and outcome.status == 0:
            outcome.distance = float(np.abs(places - ends).max())
        if method == "Moreau":
            row.changes = outcome.distance
        elif half.status == 0 and method == "DOP853":
            _, coarse = run(method, step=STEP, fallback="Moreau", rtol=1e-6, atol=1e-8)
            row.changes = float(np.maximum(row.changes, np.abs(places - coarse).max()))
        row.outcomes[method] = outcome
        report(row)
    if not row.chaotic and any(row.apart(outcome) for outcome in row.outcomes.values()):
        # longer steps have impacts at once that are not
        _, ends = run("Moreau", times=1, step=FINE_STEP)
        _, coarse = run("Moreau", times=1, step=2.0 * FINE_STEP)
        row.fine, row.changes = True, float(np.abs(ends - coarse).max())
        for method, places in found.items():
            row.outcomes[method].distance = float(np.abs(places - ends).max()) if method != "Moreau" else math.nan
        report(row)
        if any(row.apart(outcome) for outcome in row.outcomes.values()):
            others = [_disturbed(robot, q, np.random.default_rng(i)) for i in range(DISTURBANCES)]
            # time stepping in short steps takes long: asked where the other method shows no chaos
            for method, places in (("DOP853", found.get("DOP853")), ("Moreau", ends)):
                for other in others if places is not None and not row.chaotic else []:
                    options = {"step": FINE_STEP} if method == "Moreau" else {"step": STEP, "fallback": "Moreau"}
                    _, moved = run(method, other, times=1, **options)
                    row.changes = max(row.changes, float(np.abs(moved - places).max()))
            row.disturbed = True
            report(row)
    return row


def _work(file: str, motion: str, methods: tuple[str, ...], connection: Any) -> None:
    folder = robots_folder()
    assert folder is not None
    try:
        measure(load(folder, file), motion, methods, connection.send)
        connection.send(None)
    except Exception as error:
        # some of ours are not what they were once they have been sent
        connection.send(RuntimeError(f"{type(error).__name__}: {error}"))


def run_robot(file: str, motion: str, methods: tuple[str, ...], limit: float) -> tuple[Row | None, str]:
    """`measure` with a limit of so many s for each method; the row as far as it came, and what ended it early."""
    # the first one compiles kernels
    late = f"takes more than {limit:g} s"
    rows, trouble = in_own_process(_work, (file, motion, methods), lambda n: limit if n else limit + COMPILATION, late)
    return rows[-1] if rows else None, trouble


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", metavar="robot", help=f"any of {', '.join(ROBOTS)}; all by default")
    parser.add_argument("--limit", type=float, default=30.0, metavar="S", help="on the time of a run; 30 by default")
    parser.add_argument("--runs", default=",".join(RUNS))
    parser.add_argument("--methods", default=",".join(METHODS))
    options = parser.parse_args()
    if robots_folder() is None:
        parser.error('pip install "pincontact[robots]" brings the robots')
    for name in options.robots:
        if name not in ROBOTS:
            parser.error(f"there is no robot {name!r}")
    methods = tuple(options.methods.split(","))
    for motion in RUNS:
        # so that no time below is a compiler's
        run_robot(ROBOTS["a1"], motion, METHODS, COMPILATION)
    print(f"{'robot':32s} {'motion':8s} {'coarser':>8s}  " + "  ".join(f"{method:>34s}" for method in methods))
    bad = total = 0
    for name in options.robots or ROBOTS:
        for motion in options.runs.split(","):
            row, trouble = run_robot(ROBOTS[name], motion, methods, options.limit)
            total += 1
            outcomes = row.outcomes if row is not None else {}
            cells = [_cell(outcomes.get(method), outcomes.get("Moreau")) for method in methods]
            changes = (
                f"{row.changes:8.1e}{'c' if row.disturbed else 'f' if row.fine else ' '}"
                if row is not None
                else " " * 9
            )
            print(f"{name:32s} {motion:8s} {changes} " + "  ".join(cells).rstrip())
            faults = [*(row.faults() if row is not None else ()), *([trouble] if trouble else [])]
            for method, outcome in outcomes.items():
                if outcome.fell_back:
                    print(f"    {method}: {outcome.message}")
            for fault in faults:
                print(f"    {fault}")
            bad += bool(faults)
            sys.stdout.flush()
    print(f"{total} rows, {bad} with something wrong; each: status, s, times time stepping's, events, m from it")
    return 1 if bad else 0


def _cell(outcome: Outcome | None, other: Outcome | None) -> str:
    if outcome is None:
        return f"{'':34s}"
    factor = outcome.seconds / other.seconds if other is not None else math.nan
    status = f"{outcome.status}{'F' if outcome.fell_back else ''}"
    return f"{status:>3s} {outcome.seconds:7.2f} {factor:5.1f}x {outcome.events:6d} {outcome.distance:8.1e}"


if __name__ == "__main__":
    sys.exit(main())
