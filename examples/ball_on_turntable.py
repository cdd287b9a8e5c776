"""A ball on a turntable: circles at two sevenths of the table's rate.

A uniform ball rolls without slip on a table that turns at a constant rate. It is not flung off: wherever and however
fast it starts, its centre goes round a circle at 2/7 of the table's rate, with a centre and a radius that depend on the
start. The run measures the rate from the path and closes seven circles while the table makes twenty-four and a half.

    python examples/ball_on_turntable.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "ball.urdf"
RADIUS, RATE = 0.1, 3.0


def main(html: Path | None = None, circles: int = 7) -> dict[str, float]:
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), "ball")
    table = scene.add_contour("table", pc.Plane(), motion=pc.ConstantTwist(angular=(0.0, 0.0, RATE)))
    scene.add_contact("ball", ball, table, friction=pc.NoSlip())
    # what is given is made consistent: the spin follows from rolling
    state = scene.initial_state([0.4, 0.0, RADIUS, 0.0, 0.0, 0.0, 1.0], [0.1, 0.2, 0.0, 0.0, 0.0, 0.0])
    duration = circles * 2.0 * math.pi / (2.0 / 7.0 * RATE)
    times = np.linspace(0.0, duration, 100 * circles + 1)
    run = pc.simulate(scene, state, duration, rtol=1e-11, atol=1e-13, t_eval=times)
    path = run.q[:, :2]
    # the circle through three points of the path: the chords' bisectors meet in its centre
    a, b, c = path[0], path[33], path[67]
    centre = np.linalg.solve(2.0 * np.array([b - a, c - a]), [b @ b - a @ a, c @ c - a @ a])
    radii = np.linalg.norm(path - centre, axis=1)
    angles = np.unwrap(np.arctan2(*(path - centre).T[::-1]))
    result = {
        "rate_ratio": float((angles[-1] - angles[0]) / duration / RATE),
        "roundness": float(np.ptp(radii)),
        "radius": float(radii[0]),
        "expected_radius": float(np.linalg.norm(state.v[:2])) / (2.0 / 7.0 * RATE),
        "closing": float(np.linalg.norm(path[-1] - path[0])),
    }
    print(
        f"{run.message} A circle of {radii[0]:.6f} m about ({centre[0]:.6f}, {centre[1]:.6f}) m, "
        f"round to {np.ptp(radii):.1e} m"
    )
    print(
        f"at {result['rate_ratio']:.12f} of the table's rate (2/7 = {2 / 7:.12f}); closes to {result['closing']:.1e} m"
    )
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
