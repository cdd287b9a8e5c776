"""The rolling disk: a thin disk from a URDF on a plane, then over a dome.

Four runs of the same robot: rolling without slip as an ideal constraint and with Coulomb friction, which agree; a start
that slides and comes to roll; and a disk that rolls over a dome until it slips and takes off. Each prints its events,
energy balance, constraint residuals and how much faster than real time it ran.

    python examples/rolling_disk.py [--html FILE] [--replay]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "disk.urdf"
RADIUS = 0.3


def disk_on(contour: pc.Contour, friction: pc.FrictionLaw | None, placement: pin.SE3 | None = None) -> pc.Scene:
    """The disk with its rim on a contour of the world."""
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    rim = scene.add_contour("rim", pc.Circle(RADIUS), frame="disk")
    ground = scene.add_contour("ground", contour, placement=placement)
    scene.add_contact("rim/ground", rim, ground, friction=friction)
    return scene


def tilted(tilt: float, spin: float, height: float = 0.0, sliding: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """q and v of the disk: its axis `tilt` rad from vertical, turning with `spin` rad/s, its centre moving so as to
    roll, plus `sliding` m/s along its track."""
    rotation = pin.utils.rotate("y", tilt)
    q = np.r_[0.0, 0.0, height + RADIUS * np.sin(tilt), pin.Quaternion(rotation).coeffs()]
    # the lowest point of the rim, seen from the centre in body axes, must be at rest
    omega = np.array([0.3, 0.5, spin])
    lowest = np.array([RADIUS, 0.0, 0.0])
    return q, np.r_[-np.cross(omega, lowest) + np.array([0.0, sliding, 0.0]), omega]


def simulate(title: str, scene: pc.Scene, state: pc.State, duration: float) -> pc.Trajectory:
    """Run, and print what happened."""
    run = pc.simulate(scene, state, duration, rtol=1e-10, atol=1e-12, energies=True)
    energies = run.energies()
    print(f"\n{title}: {run.message}")
    for event in run.events:
        print(f"  t = {event.time:.10f} s  {event.contact}: {event.kind}")
    worst = max(values.max() for values in run.residuals().values())
    assert energies.friction_work is not None
    print(f"  centre at the end           {np.array2string(run.q[-1, :3], precision=9)} m")
    print(f"  energy                      {energies.total[0]:.6f} J -> {energies.total[-1]:.6f} J")
    print(f"  friction work               {energies.friction_work[-1]:.6f} J")
    print(f"  energy balance, worst       {np.abs(energies.balance).max():.1e} J")
    print(f"  constraint residual, worst  {worst:.1e}")
    stats = run.stats
    print(f"  {stats['steps']} steps, {stats['rhs']} evaluations, {duration / stats['wall_time']:.0f} times real time")
    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay of the dome as an HTML file")
    parser.add_argument("--replay", action="store_true", help="play each run in a Meshcat viewer")
    arguments = parser.parse_args()

    runs = {}
    floor = pc.Plane()
    rolling = disk_on(floor, pc.NoSlip())
    runs["rolling"] = simulate("Rolling, no slip", rolling, rolling.initial_state(*tilted(1.2, 5.0)), 5.0)
    rough = disk_on(floor, pc.Coulomb(mu=0.8))
    runs["rough"] = simulate("Rolling, Coulomb mu = 0.8", rough, rough.initial_state(*tilted(1.2, 5.0)), 5.0)
    apart = np.linalg.norm(runs["rolling"].q[-1, :3] - runs["rough"].q[-1, :3])
    print(f"\nThe two end {apart:.1e} m apart.")

    smooth = disk_on(floor, pc.Coulomb(mu=0.2))
    state = smooth.initial_state(*tilted(1.2, 5.0, sliding=1.0))
    runs["slip_then_roll"] = simulate("Sliding start, Coulomb mu = 0.2", smooth, state, 3.0)

    dome = disk_on(pc.Sphere(2.0), pc.Coulomb(mu=0.7), pin.SE3(np.eye(3), np.array([0.0, 0.0, -2.0])))
    state = dome.initial_state(*tilted(1.4, 5.0))
    runs["dome"] = simulate("Over a dome, Coulomb mu = 0.7", dome, state, 1.5)

    if arguments.html:
        print(f"wrote {pc.export_html(runs['dome'], arguments.html)}")
    if arguments.replay:
        for run in runs.values():
            pc.replay(run)


if __name__ == "__main__":
    main()
