"""A bead on a helical wire, with dry friction: a speed that the wire sets.

A bead slides down a vertical helix. The wire presses on it with the weight's share across the wire and, square with the
speed, with what bends its path; friction grows with the length of that two-component force. So however it starts, the
bead tends to the speed at which friction balances the slope: (v^2 curvature)^2 = (g sin a / mu)^2 - (g cos a)^2.

    python examples/bead_on_helix.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "bead.urdf"
RADIUS, PITCH, MU, G = 0.2, 0.5, 0.15, 9.81


def main(html: Path | None = None, duration: float = 6.0) -> dict[str, float]:
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    bead = scene.add_contour("bead", pc.Point(), "bead")
    wire = scene.add_contour("wire", pc.Helix(RADIUS, PITCH))
    scene.add_contact("bead", bead, wire, friction=pc.Coulomb(MU), location=(None, 0.0))
    slope = math.atan2(PITCH, 2.0 * math.pi * RADIUS)
    curvature = math.cos(slope) ** 2 / RADIUS
    limit = math.sqrt(math.sqrt((G * math.sin(slope) / MU) ** 2 - (G * math.cos(slope)) ** 2) / curvature)
    speeds = {}
    for name, start in (("slow", 0.0), ("fast", 2.0 * limit)):
        downwards = -start * np.array([0.0, math.cos(slope), math.sin(slope)])
        state = scene.initial_state([RADIUS, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], np.r_[downwards, np.zeros(3)])
        run = pc.simulate(scene, state, duration, rtol=1e-10, atol=1e-12, t_eval=np.linspace(0.0, duration, 601))
        speeds[name] = float(np.linalg.norm(run.v[-1, :3]))
        print(f"from {start:.3f} m/s: {run.message} {speeds[name]:.9f} m/s at the end, {run.q[-1, 2]:.3f} m down")
        if html is not None and name == "slow":
            print(f"wrote {pc.export_html(run, html)}")
    print(f"limit {limit:.9f} m/s")
    return {"limit": limit, "from_rest": speeds["slow"], "from_above": speeds["fast"]}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
