"""What a scene doesn't need is not computed: the counts of ten runs of one second, as a table.

    python examples/benchmarks/skipped.py [--readme]

--readme: put the table between its markers in README.md.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import pincontact as pc

BEGIN, END = "<!-- skipped: begin -->", "<!-- skipped: end -->"
COLUMNS = ("rhs", "contact_rows", "closed_form", "newton", "drives", "cone_problems", "qp", "outputs")


def body(placement: pin.SE3 | None = None) -> pin.Model:
    """One free body of 1 kg under gravity."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([0.02, 0.02, 0.03])), pin.SE3.Identity())
    model.addBodyFrame("body", joint, placement or pin.SE3.Identity(), 0)
    return model


def scene_of(shape: pc.Contour, floor: pc.Contour, friction: Any, motion: Any = None, **contact: Any) -> pc.Scene:
    """A body with one contour on one of the world."""
    scene = pc.Scene(body())
    first = scene.add_contour("shape", shape, frame="body")
    scene.add_contact("contact", first, scene.add_contour("floor", floor, motion=motion), friction=friction, **contact)
    return scene


def run(scene: pc.Scene, q: Any, v: Any, free: tuple[str, ...] = (), **options: Any) -> pc.Trajectory:
    """One second."""
    return pc.simulate(scene, scene.initial_state(q, v, free=free), 1.0, **{"t_eval": [1.0], **options})


DISK = np.r_[0.0, 0.0, 0.3 * math.sin(1.2), pin.Quaternion(pin.utils.rotate("y", 1.2)).coeffs()]
BALL = np.array([0.0, 0.0, 0.1, 0.3, 0.0, 0.0, math.sqrt(0.91)])
SIN, COS = 2.0 * BALL[3] * BALL[6], 1.0 - 2.0 * BALL[3] ** 2
ROLL = np.array([0.3, 0.2, 0.0, 0.5, 0.3, 6.0])


def waves(x: float, y: float) -> float:
    """A ground that no closed form knows."""
    return 0.02 * math.sin(3.0 * x) * math.cos(2.0 * y)


CASES: dict[str, Callable[[], pc.Trajectory]] = {
    "disk, frictionless": lambda: run(scene_of(pc.Circle(0.3), pc.Plane(), None), DISK, ROLL),
    "disk, rolling (`NoSlip`)": lambda: run(scene_of(pc.Circle(0.3), pc.Plane(), pc.NoSlip()), DISK, ROLL),
    "ball, clear slip": lambda: run(
        scene_of(pc.Sphere(0.1), pc.Plane(), pc.Coulomb(0.05)), BALL, [3.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    ),
    "ball, rolling (`Coulomb`)": lambda: run(
        scene_of(pc.Sphere(0.1), pc.Plane(), pc.Coulomb(0.9)), BALL, [0.5, 0.0, 0.0, 0.0, 5.0 * COS, -5.0 * SIN]
    ),
    "ball slips, then rolls": lambda: run(
        scene_of(pc.Sphere(0.1), pc.Plane(), pc.Coulomb(0.2)), BALL, [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
    ),
    "ball on waves": lambda: run(
        scene_of(pc.Sphere(0.1), pc.HeightField(waves), pc.NoSlip()), BALL, np.zeros(6)
    ),
    "ball on a heaving plate": lambda: run(
        scene_of(
            pc.Sphere(0.1), pc.Plane(), pc.NoSlip(), pc.HarmonicMotion((0.0, 0.0, 0.01), 2.0)
        ),
        BALL,
        np.zeros(6),
    ),
    "ball in free flight": lambda: run(
        scene_of(pc.Sphere(0.1), pc.Plane(), pc.Coulomb(0.3)), BALL + np.eye(7)[2] * 9.0, np.zeros(6), ("contact",)
    ),
    "free body, no contact": lambda: run(pc.Scene(body()), BALL, np.zeros(6)),
    "disk, 101 outputs": lambda: run(
        scene_of(pc.Circle(0.3), pc.Plane(), pc.NoSlip()), DISK, ROLL, t_eval=np.linspace(0.0, 1.0, 101)
    ),
}  # fmt: skip


def table() -> str:
    """The counts as a Markdown table."""
    lines = [f"| one second of | {' | '.join(COLUMNS)} |", "|---|" + "---:|" * len(COLUMNS)]
    for name, case in CASES.items():
        stats = case().stats
        lines.append(f"| {name} | {' | '.join(str(stats[column]) for column in COLUMNS)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--readme", action="store_true", help="also rewrite the table in README.md")
    text = table()
    print(text)
    if parser.parse_args().readme:
        readme = Path(__file__).parents[2] / "README.md"
        before, rest = readme.read_text().split(BEGIN)
        readme.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}")


if __name__ == "__main__":
    main()
