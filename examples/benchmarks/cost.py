"""What one evaluation costs against `pin.aba` on the same model: by pattern and contour, robot, number of contacts.

An evaluation is what an integrator needs at one state: Pinocchio's terms, the contacts' kinematics, forces and
accelerations, in stick. Times are lower quartiles of many short batches of both, by turns: what interrupts a machine
only adds to them. The last sections show where the time of whole runs goes: see `breakdown.py`.

    python examples/benchmarks/cost.py [--only SECTION] [--csv FILE]
"""

from __future__ import annotations

import argparse
import csv
import math
import statistics
from collections.abc import Callable

import numpy as np
import pinocchio as pin
from breakdown import breakdown, disk, evaluation_parts
from timing import by_turns, free_body

import pincontact as pc
from pincontact.dynamics.system import System
from pincontact.integration.discrete import write_discrete
from pincontact.integration.run_system import RunSystem
from pincontact.layout import MODE, MU, STICK

_RUNS = 15
Writer = Callable[[str, float, float, float], None]


def planar_body() -> pin.Model:
    """One body of 1 kg that moves in the xy-plane."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "planar")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([0.02, 0.03, 0.04])), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    return model


def _circle(radius: float) -> Callable[[float], tuple[float, float, float]]:
    return lambda u: (radius * math.cos(u), radius * math.sin(u), 0.0)


def _hills(x: float, y: float) -> tuple[float, float, float]:
    return x, y, 0.02 * math.sin(3.0 * x) * math.cos(2.0 * y)


def _grid() -> pc.Contour:
    x = np.linspace(-1.0, 1.0, 21)
    points = np.array([[(a, b, 0.02 * math.sin(3.0 * a) * math.cos(2.0 * b)) for b in x] for a in x])
    return pc.SplineSurface(points)


def _closed_spline() -> pc.Contour:
    angles = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
    points = np.array([[0.3 * math.cos(a), 0.28 * math.sin(a), 0.0] for a in angles])
    return pc.SplineCurve(points, periodic=True)


def scenes() -> list[tuple[str, str, pin.Model, pc.Contour, pc.Contour, np.ndarray]]:
    """(pattern, shapes, model, contour of the body, contour of the world, configuration near contact)."""
    free, plane2 = free_body(), planar_body()

    def upright(height: float, tilt: float = 0.3) -> np.ndarray:
        return np.r_[0.1, 0.05, height, math.sin(tilt / 2), 0.0, 0.0, math.cos(tilt / 2)]

    def disk(height: float) -> np.ndarray:
        return np.r_[0.0, 0.0, height, pin.Quaternion(pin.utils.rotate("y", 1.2)).coeffs()]

    rim = 0.3 * math.sin(1.2)
    flat = np.array([0.1, 0.3, 1.0, 0.0])
    return [
        ("3C-S", "Circle / Plane", free, pc.Circle(0.3), pc.Plane(), disk(rim)),
        ("3C-S", "ParametricCurve / Plane", free, pc.ParametricCurve(_circle(0.3), (-9.0, 9.0)), pc.Plane(), disk(rim)),
        ("3C-S", "Circle / Sphere", free, pc.Circle(0.3), pc.Sphere(2.0), disk(rim + 2.0)),
        ("3C-S", "SplineCurve / Plane", free, _closed_spline(), pc.Plane(), disk(rim)),
        ("S-S", "Sphere / Plane", free, pc.Sphere(0.1), pc.Plane(), upright(0.1)),
        ("S-S", "Ellipsoid / Plane", free, pc.Ellipsoid(0.2, 0.15, 0.1), pc.Plane(), upright(0.107)),
        ("S-S", "Sphere / Sphere", free, pc.Sphere(0.1), pc.Sphere(1.0), upright(1.094)),
        ("S-S", "Ellipsoid / Ellipsoid", free, pc.Ellipsoid(0.2, 0.15, 0.1), pc.Ellipsoid(1.0, 0.9, 0.8),
         upright(0.905)),
        ("S-S", "Torus / Ellipsoid", free, pc.Torus(0.3, 0.1), pc.Ellipsoid(1.0, 0.9, 0.8), upright(0.98, 1.3)),
        ("S-S", "Sphere / ParametricSurface", free, pc.Sphere(0.1),
         pc.ParametricSurface(_hills, ((-2.0, 2.0), (-2.0, 2.0))), upright(0.105)),
        ("S-S", "Sphere / SplineSurface", free, pc.Sphere(0.1), _grid(), upright(0.105)),
        ("P-S", "Point / Plane", free, pc.Point(), pc.Plane(), upright(0.0)),
        ("P-S", "Point / Sphere", free, pc.Point(), pc.Sphere(1.0), upright(0.994)),
        ("P-3C", "Point / Helix", free, pc.Point(), pc.Helix(0.3, 0.2), np.r_[0.3, 0.0, 0.0, 0.1, 0.0, 0.0, 0.995]),
        ("3C-3C", "Circle / Line", free, pc.Circle(0.3), pc.Line(), disk(rim)),
        ("2C-2C", "Circle / Line", plane2, pc.Circle(0.3), pc.Line(), flat),
        ("2C-2C", "Ellipse / Line", plane2, pc.Ellipse(0.3, 0.3001), pc.Line(), flat),
        ("P-2C", "Point / Cycloid", plane2, pc.Point(), pc.Cycloid(0.25), np.array([0.1, 0.005, 1.0, 0.0])),
    ]  # fmt: skip


def prepare(model: pin.Model, body: pc.Contour, world: pc.Contour, q: np.ndarray) -> tuple[System, str]:
    """A system in stick at a consistent state, and its pattern."""
    scene = pc.Scene(model)
    moving = scene.add_contour("body", body, frame="body")
    fixed = scene.add_contour("world", world)
    contact = scene.add_contact("contact", moving, fixed, friction=pc.NoSlip(), bilateral=True)
    q = q.copy()
    if model.nq == 7:
        q[3:] /= np.linalg.norm(q[3:])
    state = scene.initial_state(q, np.full(model.nv, 0.1), max_gap=0.2)
    system = System(model, [contact])
    write_discrete(system, state.discrete)
    system.q[:], system.v[:], system.location[:] = state.q, state.v, state.location
    system.contact_int[0, MODE], system.contact_real[0, MU] = STICK, math.inf
    if system.evaluate(0.0) > 1:
        raise SystemExit(f"{contact.pattern.name}: the state cannot be evaluated")
    return system, contact.pattern.name


def against_aba(system: System) -> tuple[float, float, float]:
    """Microseconds of an evaluation of the system and of `pin.aba` on its model, and their ratio."""
    model, data, tau = system.model, system.model.createData(), np.zeros(system.nv)
    cost, aba = by_turns(lambda: system.evaluate(0.0), lambda: pin.aba(model, data, system.q, system.v, tau))
    return cost, aba, cost / aba


# ---------------------------------------------------------------- patterns and contours


def patterns(write: Writer) -> None:
    """One contact on one body, for every pattern and kind of contour."""
    print(f"{'pattern':8s} {'shapes':28s} {'evaluation':>11s} {'pin.aba':>9s} {'ratio':>6s} {'to disk':>8s}")
    reference = 0.0
    for expected, shapes, model, body, world, q in scenes():
        system, pattern = prepare(model, body, world, q)
        assert pattern == expected, (shapes, pattern)
        cost, aba, ratio = against_aba(system)
        reference = reference or ratio
        write(f"{pattern} {shapes}", cost, aba, ratio)
        print(f"{pattern:8s} {shapes:28s} {cost:8.2f} us {aba:6.2f} us {ratio:6.2f} {ratio / reference:8.2f}")


# ---------------------------------------------------------------- robots and numbers of contacts


def legged(legs: int, joints: int) -> tuple[pin.Model, list[str]]:
    """A floating base with legs of revolute joints; the frames at their ends."""
    model = free_body()
    feet = []
    for leg in range(legs):
        parent = 1
        placement = pin.SE3(np.eye(3), np.array([0.3 * math.cos(2.1 * leg), 0.3 * math.sin(2.1 * leg), 0.0]))
        for k in range(joints):
            kind = (pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRY())[k % 3]
            parent = model.addJoint(parent, kind, placement, f"leg{leg}_{k}")
            inertia = pin.Inertia(0.2, np.array([0.0, 0.0, -0.1]), np.diag([1e-3, 1e-3, 1e-4]))
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.2]))
        feet.append(f"foot{leg}")
        model.addFrame(pin.Frame(feet[-1], parent, 0, placement, pin.FrameType.BODY))
    return model, feet


def arm(joints: int = 7) -> tuple[pin.Model, list[str]]:
    """A chain of revolute joints on the ground, and the frame at its end."""
    model = pin.Model()
    parent, placement = 0, pin.SE3.Identity()
    for k in range(joints):
        parent = model.addJoint(parent, pin.JointModelRZ() if k % 2 == 0 else pin.JointModelRY(), placement, f"j{k}")
        model.appendBodyToJoint(
            parent, pin.Inertia(1.0, np.array([0.0, 0.0, 0.1]), np.diag([2e-3, 2e-3, 1e-3])), pin.SE3.Identity()
        )
        placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2]))
    model.addFrame(pin.Frame("tip", parent, 0, placement, pin.FrameType.BODY))
    return model, ["tip"]


def humanoid() -> tuple[pin.Model, list[str]]:
    """Pinocchio's sample humanoid, with two points on each foot."""
    model = pin.buildSampleModelHumanoid()
    ends = [j for j in range(1, model.njoints) if not len(model.children[j])]
    frames = []
    for j in ends[:2]:
        for k, x in enumerate((-0.1, 0.1)):
            frames.append(f"sole{j}_{k}")
            placement = pin.SE3(np.eye(3), np.array([x, 0.02 * k, -0.05]))
            model.addFrame(pin.Frame(frames[-1], j, 0, placement, pin.FrameType.BODY))
    return model, frames


def standing(model: pin.Model, frames: list[str]) -> RunSystem:
    """A system whose frames' origins stick to planes of the world through them."""
    rng = np.random.default_rng(3)
    q = pin.integrate(model, pin.neutral(model), 0.2 * rng.standard_normal(model.nv))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    scene = pc.Scene(model)
    for i, frame in enumerate(frames):
        where = data.oMf[model.getFrameId(frame)].translation
        foot = scene.add_contour(f"foot{i}", pc.Point(), frame=frame)
        floor = scene.add_contour(f"floor{i}", pc.Plane(), placement=pin.SE3(np.eye(3), where.copy()))
        scene.add_contact(f"contact{i}", foot, floor, friction=pc.NoSlip())
    state = scene.initial_state(q, np.zeros(model.nv))
    system = RunSystem(model, list(scene.contacts.values()))
    write_discrete(system, state.discrete)
    system.q[:], system.v[:], system.location[: system.nc] = state.q, state.v, state.location
    system.contact_int[: system.nc, MODE], system.contact_real[: system.nc, MU] = STICK, math.inf
    if system.evaluate(0.0) > 1:
        raise SystemExit(f"{model.name}: the state cannot be evaluated")
    return system


def robots(write: Writer) -> None:
    """Robots that stand on their feet."""
    print(f"\n{'robot':34s} {'evaluation':>11s} {'pin.aba':>9s} {'ratio':>6s} {'Pinocchio part':>15s}")
    for name, (model, frames) in (
        ("1 free body, 1 contact", (free_body(), ["body"])),
        ("7-dof arm, 1 contact", arm()),
        ("18-dof quadruped, 4 feet", legged(4, 3)),
        ("humanoid, 4 contacts", humanoid()),
    ):
        system = standing(model, frames)
        cost, aba, ratio = against_aba(system)
        terms, _ = evaluation_parts(system, standing(model, frames))
        write(f"{name} (nv = {model.nv})", cost, aba, ratio)
        print(f"{name + f' (nv = {model.nv})':34s} {cost:8.2f} us {aba:6.2f} us {ratio:6.2f} {terms:12.2f} us")


def contacts(write: Writer) -> None:
    """1 to 64 points of one body on the ground."""
    print(f"\n{'contacts on one body':34s} {'evaluation':>11s} {'pin.aba':>9s} {'ratio':>6s}")
    numbers, ratios = [1, 2, 4, 8, 16, 32, 64], []
    for number in numbers:
        model = free_body()
        for i in range(number):
            angle = 2.4 * i
            placement = pin.SE3(np.eye(3), np.array([0.3 * math.cos(angle), 0.3 * math.sin(angle), 0.01 * (i % 3)]))
            model.addFrame(pin.Frame(f"p{i}", 1, 0, placement, pin.FrameType.BODY))
        system = standing(model, [f"p{i}" for i in range(number)])
        cost, aba, ratio = against_aba(system)
        ratios.append(ratio)
        write(f"{number} contacts on one body", cost, aba, ratio)
        print(f"{number:<34d} {cost:8.2f} us {aba:6.2f} us {ratio:6.2f}")
    exponent = np.polyfit(np.log(numbers[2:]), np.log(ratios[2:]), 1)[0]
    print(f"cost ~ contacts^{exponent:.2f} from 4 to 64")


# ---------------------------------------------------------------- steps


def steps(write: Writer) -> None:
    """Where the time of a run goes: the rolling disk, and its slip into rolling."""
    print(f"\n{'run of 5 s, rtol 1e-8':34s} {'total':>9s} {'set-up':>9s} {'per step':>10s} {'per evaluation':>15s}")
    for name, friction, outputs in (
        ("rolling disk, no outputs", pc.NoSlip(), [5.0]),
        ("rolling disk, 501 outputs", pc.NoSlip(), np.linspace(0.0, 5.0, 501)),
        ("sliding into rolling, 501 outputs", pc.Coulomb(0.2), np.linspace(0.0, 5.0, 501)),
    ):
        scene, state = disk(friction)
        run = pc.simulate(scene, state, 5.0, t_eval=outputs)
        total = statistics.median(
            pc.simulate(scene, state, 5.0, t_eval=outputs).stats["wall_time"] for _ in range(_RUNS)
        )
        setup = statistics.median(pc.simulate(scene, state, 0.0, t_eval=[0.0]).stats["wall_time"] for _ in range(_RUNS))
        each = (total - setup) / run.stats["rhs"]
        write(name, total * 1e6, math.nan, math.nan)
        print(
            f"{name:34s} {total * 1e3:6.2f} ms {setup * 1e3:6.2f} ms "
            f"{(total - setup) / run.stats['steps'] * 1e6:7.1f} us {each * 1e6:12.2f} us"
        )


SECTIONS = {"patterns": patterns, "robots": robots, "contacts": contacts, "steps": steps, "breakdown": breakdown}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--csv", help="also write the table to this file")
    parser.add_argument("--only", choices=SECTIONS, help="one section of the table")
    arguments = parser.parse_args()
    rows: list[tuple[str, float, float, float]] = []
    for name, section in SECTIONS.items():
        if arguments.only in (None, name):
            section(lambda *row: rows.append(row))
    if arguments.csv:
        with open(arguments.csv, "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["scene", "microseconds", "aba_us", "ratio"])
            writer.writerows(rows)


if __name__ == "__main__":
    main()
