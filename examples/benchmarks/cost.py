"""What one evaluation costs, for every pattern and kind of contour, as a ratio to `pin.aba` on the same model.

An evaluation is what an integrator needs at one state: Pinocchio's terms, the contacts' kinematics, forces and
accelerations, in stick. Times are medians of several batches; ratios are taken within the same batches, since machines
are noisy.

    python examples/benchmarks/cost.py [--csv FILE]
"""

from __future__ import annotations

import argparse
import csv
import math
import statistics
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

import pincontact as pc
from pincontact.dynamics.system import System
from pincontact.layout import MODE, MU, STICK
from pincontact.state import write_discrete

BATCHES, CALLS = 15, 2000


def free_body() -> pin.Model:
    """One free body of 1 kg."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([0.02, 0.03, 0.04])), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    return model


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


def batch(call: Callable[[], object]) -> float:
    """Seconds per call of one batch."""
    began = time.perf_counter()
    for _ in range(CALLS):
        call()
    return (time.perf_counter() - began) / CALLS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--csv", help="also write the table to this file")
    arguments = parser.parse_args()
    rows = []
    print(f"{'pattern':8s} {'shapes':28s} {'evaluation':>11s} {'pin.aba':>9s} {'ratio':>6s} {'to disk':>8s}")
    reference = 0.0
    for expected, shapes, model, body, world, q in scenes():
        system, pattern = prepare(model, body, world, q)
        assert pattern == expected, (shapes, pattern)
        data, tau = model.createData(), np.zeros(model.nv)
        pairs = [
            (batch(lambda: system.evaluate(0.0)), batch(lambda: pin.aba(model, data, system.q, system.v, tau)))  # noqa: B023
            for _ in range(BATCHES)
        ]
        ratio = statistics.median(a / b for a, b in pairs)
        cost, aba = (statistics.median(p[i] for p in pairs) * 1e6 for i in (0, 1))
        reference = reference or ratio
        rows.append((pattern, shapes, cost, aba, ratio, ratio / reference))
        print(f"{pattern:8s} {shapes:28s} {cost:8.2f} us {aba:6.2f} us {ratio:6.2f} {ratio / reference:8.2f}")
    if arguments.csv:
        with open(arguments.csv, "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["pattern", "shapes", "evaluation_us", "aba_us", "ratio", "ratio_to_disk"])
            writer.writerows(rows)


if __name__ == "__main__":
    main()
