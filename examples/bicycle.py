"""The benchmark bicycle: self-stability.

A bicycle with a rigid rider and nobody at the handlebar, from urdf/bicycle.urdf: two thin wheels that roll without
slip on a plane. Its equations, linearised about straight running at constant speed, give the eigenvalues of lean and
steer at every speed: the weave oscillation dies out above 4.29 m/s and the capsize fall starts above 6.02 m/s, so in
between the bicycle keeps itself upright. Both speeds are found as roots, the eigenvalues printed over a sweep, and two
perturbed runs of the full nonlinear bicycle show one that recovers, at 5 m/s, and one whose weave grows, at 3 m/s.

    python examples/bicycle.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import brentq

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "bicycle.urdf"
WHEELS = {"rear": 0.3, "front": 0.35}


def bicycle() -> pc.Scene:
    """Two rolling rims on the floor."""
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    floor = scene.add_contour("floor", pc.Plane())
    for name, radius in WHEELS.items():
        rim = scene.add_contour(name, pc.Circle(radius), f"{name}_wheel", upright)
        scene.add_contact(name, rim, floor, friction=pc.NoSlip())
    return scene


def running(scene: pc.Scene, speed: float, lean_rate: float = 0.0) -> pc.State:
    """Upright, straight ahead at a speed in m/s; a push to the side makes it lean at a rate in rad/s."""
    model = scene.model
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[2], v[0], v[3] = WHEELS["rear"], speed, lean_rate
    # leaning turns the bicycle about the line on which the wheels stand
    v[1] = -lean_rate * WHEELS["rear"]
    for name, radius in WHEELS.items():
        v[model.joints[model.getJointId(f"{name}_axle")].idx_v] = speed / radius
    return scene.initial_state(q, v)


def eigenvalues(scene: pc.Scene, speed: float) -> np.ndarray:
    """The four of lean and steer in 1/s, the least stable first; the fifth is the zero of the speed."""
    motion = pc.linearize(scene, running(scene, speed)).without_symmetries()
    values = motion.eigenvalues
    return np.delete(values, np.argmin(np.abs(values)))


def weave(scene: pc.Scene, speed: float) -> float:
    """Growth rate of the oscillation in 1/s."""
    return max(value.real for value in eigenvalues(scene, speed) if value.imag != 0.0)


def capsize(scene: pc.Scene, speed: float) -> float:
    """Growth rate of the slow fall in 1/s."""
    return max(value.real for value in eigenvalues(scene, speed) if value.imag == 0.0)


def lean(run: pc.Trajectory) -> np.ndarray:
    """Angle in rad between the rear frame's plane and the vertical."""
    return np.array([math.asin(pin.Quaternion(q[3:7]).matrix()[2, 1]) for q in run.q])


def main(html: Path | None = None, duration: float = 5.0) -> dict[str, float]:
    scene = bicycle()
    print("speed (m/s)   eigenvalues of lean and steer (1/s)")
    for speed in range(11):
        print(f"{speed:8d}     ", "  ".join(f"{value:18.8f}" for value in eigenvalues(scene, float(speed))))
    result = {
        "weave_speed": float(brentq(lambda speed: weave(scene, speed), 4.0, 4.6, xtol=1e-10)),
        "capsize_speed": float(brentq(lambda speed: capsize(scene, speed), 5.8, 6.5, xtol=1e-10)),
    }
    print(f"self-stable from {result['weave_speed']:.11f} m/s (weave) to {result['capsize_speed']:.11f} m/s (capsize)")
    for speed in (5.0, 3.0):
        run = pc.simulate(scene, running(scene, speed, lean_rate=0.05), duration, rtol=1e-9)
        angles = np.abs(lean(run))
        early, late = (
            float(angles[(run.t - a) * (b - run.t) >= 0.0].max()) for a, b in ((0, 1), (duration - 1, duration))
        )
        print(f"{speed:.0f} m/s: {run.message} lean of {early:.4f} rad in the first second, {late:.4f} rad in the last")
        result[f"lean_ratio_{speed:.0f}"] = late / early
        if html is not None and speed == 5.0:
            print(f"wrote {pc.export_html(run, html, follow='rear')}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay at 5 m/s as an HTML file")
    main(parser.parse_args().html)
