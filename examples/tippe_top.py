"""The tippe top: spun fast, it turns upside down.

A sphere whose centre of mass lies below its centre is spun about the vertical at 180 rad/s, a little tilted, on a table
with Coulomb friction. The sliding friction at its lowest point lifts the centre of mass above the centre, against
gravity, at the expense of the spin, which relative to the body changes its sign; then the stem touches the table, the
sphere takes off, and the top goes on upside down on its stem. Friction takes energy all along, but as long as only the
sphere touches it cannot change Jellett's integral, the angular momentum along the line from the point of contact to the
centre of mass: a sharp test of friction in three dimensions.

    python examples/tippe_top.py [--html FILE]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "tippe_top.urdf"
RADIUS, STEM = 0.015, 0.005


def top() -> pc.Scene:
    """The top on a rough table: its sphere, and the round end of its stem."""
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    sphere = scene.add_contour("sphere", pc.Sphere(RADIUS), "top")
    end = scene.add_contour("end", pc.Sphere(STEM), "top", pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.016])))
    table = scene.add_contour("table", pc.Plane())
    scene.add_contact("sphere", sphere, table, friction=pc.Coulomb(mu=0.3))
    scene.add_contact("stem", end, table, friction=pc.Coulomb(mu=0.3))
    return scene


def jellett(scene: pc.Scene, run: pc.Trajectory) -> np.ndarray:
    """Angular momentum about the centre of mass times the vector from there to the contact point, in kg m^3/s."""
    inertia = scene.model.inertias[1]
    out = []
    for q, v, point in zip(run.q, run.v, run.contacts["sphere"].point):
        rotation = pin.Quaternion(q[3:]).matrix()
        centre = q[:3] + rotation @ inertia.lever
        out.append(rotation @ inertia.inertia @ v[3:] @ (point - centre))
    return np.array(out)


def main(html: Path | None = None, duration: float = 3.0) -> dict[str, float]:
    scene = top()
    tilt, spin = 0.1, 180.0
    rotation = pin.utils.rotate("x", tilt)
    q = np.r_[0.0, 0.0, RADIUS, pin.Quaternion(rotation).coeffs()]
    state = scene.initial_state(q, np.r_[np.zeros(3), rotation.T @ [0.0, 0.0, spin]], free=["stem"])
    times = np.linspace(0.0, duration, 601)
    run = pc.simulate(scene, state, duration, rtol=1e-9, atol=1e-12, t_eval=times, energies=True)
    axis = np.array([pin.Quaternion(q[3:]).matrix()[2, 2] for q in run.q])
    touch = next(event.time for event in run.events if event.kind == "touch")
    alone = run.t < touch
    integral = jellett(scene, run)[alone]
    energies = run.energies()
    result = {
        "stem_touches": touch,
        "largest_tilt": float(np.arccos(axis.min())),
        "jellett_drift": float(np.abs(integral / integral[0] - 1.0).max()),
        "energy_ratio": float(energies.total[alone][-1] / energies.total[0]),
        "energy_balance": float(np.abs(energies.balance[alone]).max() / energies.total[0]),
        "spin_about_axis": float(run.v[-1, 5]),
        "sphere_at_end": float(run.contacts["sphere"].mode[-1]),
    }
    print(run.message)
    for event in run.events:
        print(f"  t = {event.time:.6f} s  {event.contact}: {event.kind}")
    print(
        f"tilted by up to {result['largest_tilt']:.3f} rad; spin about its axis {spin:.0f} -> {run.v[-1, 5]:.1f} rad/s"
    )
    print(
        f"until the stem touched, {100 * (1 - result['energy_ratio']):.0f} % of the energy went; "
        f"Jellett's integral changed by {result['jellett_drift']:.1e} of itself"
    )
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
