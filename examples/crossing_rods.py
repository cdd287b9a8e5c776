"""Crossing rods: one rocks on the other.

A round rod lies across a thicker one that is fixed, and rolls on it without slip, two cylinders that touch at a point.
If the lower radius R exceeds the upper one r the balance is stable: the rod rocks at w^2 = g (R - r) / (k^2 + r^2), k
its radius of gyration. With friction it may also balance on a slope, off the top; the example finds the level balance
from a crooked start, linearises there, and lets the rod rock by a large angle, where the period is longer and energy is
kept.

    python examples/crossing_rods.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "rod.urdf"
UPPER, LOWER, G = 0.02, 0.15, 9.81


def rods() -> pc.Scene:
    """The lower rod along y with its top at the origin, the upper one along x."""
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    along_x = pin.SE3(pin.utils.rotate("y", 0.5 * math.pi), np.zeros(3))
    along_y = pin.SE3(pin.utils.rotate("x", -0.5 * math.pi), np.array([0.0, 0.0, -LOWER]))
    rod = scene.add_contour("rod", pc.Cylinder(UPPER), "rod", along_x)
    rest = scene.add_contour("rest", pc.Cylinder(LOWER), placement=along_y)
    scene.add_contact("rods", rod, rest, friction=pc.NoSlip())
    return scene


def rolled(tilt: float) -> np.ndarray:
    """q of the rod rolled over the lower one until it slopes by a tilt in rad about y."""
    along, out = np.array([math.cos(tilt), 0.0, -math.sin(tilt)]), np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    centre = np.array([0.0, 0.0, -LOWER]) + (LOWER + UPPER) * out - LOWER * tilt * along
    return np.r_[centre, pin.Quaternion(pin.utils.rotate("y", tilt)).coeffs()]


def main(html: Path | None = None, duration: float = 4.0) -> dict[str, float]:
    scene = rods()
    inertia = scene.model.inertias[1]
    closed_form = math.sqrt(G * (LOWER - UPPER) / (inertia.inertia[1, 1] / inertia.mass + UPPER**2))
    balance = pc.find_equilibrium(scene, rolled(0.1), conditions=lambda q: q[4:5])
    motion = pc.linearize(scene, balance.state).without_symmetries()
    linear = float(np.abs(motion.eigenvalues.imag).max())

    crossing = lambda t, q, v: q[4]  # noqa: E731
    crossing.direction = 1
    state = scene.initial_state(rolled(0.6), None)
    run = pc.simulate(scene, state, duration, rtol=1e-10, atol=1e-12, events=crossing)
    times = [event.time for event in run.events if event.kind == "user"]
    energy = run.energies().total
    result = {
        "frequency": linear,
        "closed_form": closed_form,
        "off_top": float(abs(balance.state.q[0])),
        "large_frequency": 2.0 * math.pi * (len(times) - 1) / (times[-1] - times[0]),
        "energy_drift": float(np.abs(energy / energy[0] - 1.0).max()),
    }
    print(f"level balance found {result['off_top']:.1e} m off the top; {run.message}")
    print(f"rocks at {linear:.9f} rad/s (closed form {closed_form:.9f}), by 0.6 rad at {result['large_frequency']:.6f}")
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
