"""The rattleback: spun one way it pitches, stops and turns back.

An ellipsoidal stone whose principal axes of inertia are turned against its long and short axes rolls on a table
without slip. At a spin of -5 rad/s the steady rotation about the vertical is unstable: the linearised motion has an
eigenvalue with a positive real part, pitching grows from a tilt of half a degree, takes up the energy of the spin and
gives it back with the opposite sign. At +5 rad/s the unstable motion is a much slower one and the stone just goes on.
Nothing is lost on the way: rolling does no work.

    python examples/rattleback.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "rattleback.urdf"
SEMI_AXES = (0.2, 0.03, 0.02)


def stone() -> pc.Scene:
    """The stone on the table."""
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    body = scene.add_contour("stone", pc.Ellipsoid(*SEMI_AXES), "stone")
    table = scene.add_contour("table", pc.Plane())
    scene.add_contact("stone", body, table, friction=pc.NoSlip(), bilateral=True)
    return scene


def spun(scene: pc.Scene, spin: float, tilt: float) -> pc.State:
    """Turning about the vertical at a rate in rad/s, tilted in roll and pitch by an angle in rad."""
    q = np.r_[0.0, 0.0, SEMI_AXES[2], pin.Quaternion(pin.rpy.rpyToMatrix(tilt, tilt, 0.0)).coeffs()]
    rotation, up = pin.Quaternion(q[3:]).matrix(), np.array([0.0, 0.0, spin])
    resting = scene.initial_state(q)
    # the point that touches is at rest
    arm = resting.q[:3] - pc.analyze(scene, resting)["stone"].point
    return scene.initial_state(resting.q, np.r_[rotation.T @ np.cross(up, arm), rotation.T @ up])


def main(html: Path | None = None, duration: float = 5.0) -> dict[str, float]:
    scene = stone()
    result = {}
    for name, spin in (("backward", -5.0), ("forward", 5.0)):
        growth = pc.linearize(scene, spun(scene, spin, 0.0)).without_symmetries().eigenvalues[0]
        state = spun(scene, spin, math.radians(0.5))
        times = np.linspace(0.0, duration, 1001)
        run = pc.simulate(scene, state, duration, rtol=1e-10, atol=1e-12, t_eval=times)
        vertical = np.array([pin.Quaternion(q[3:]).matrix()[2] @ v[3:] for q, v in zip(run.q, run.v)])
        energy = run.energies().total
        back = np.flatnonzero(vertical * spin < 0.0)
        result |= {
            f"{name}_growth": float(growth.real),
            f"{name}_least": float((vertical * math.copysign(1.0, spin)).min()),
            f"{name}_reversal": float(run.t[back[0]]) if back.size else math.inf,
            f"{name}_energy": float(np.abs(energy - energy[0]).max()),
        }
        print(
            f"spun at {spin:+.0f} rad/s: pitching grows at {growth.real:.3f} 1/s; spin from {vertical.min():+.3f} to "
            f"{vertical.max():+.3f} rad/s, turns back after {result[f'{name}_reversal']:.2f} s"
        )
        if html is not None and name == "backward":
            print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay of the reversal")
    main(parser.parse_args().html)
