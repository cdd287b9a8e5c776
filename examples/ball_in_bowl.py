"""A ball in a bowl: resting, rocking, and going round at a steady height.

A uniform ball rolls without slip in a spherical bowl. Its rest is found from somewhere up the wall, and the linearised
motion there swings at sqrt(5 g / (7 (R - r))), slower than a pendulum by what goes into spin. Then a steady motion is
asked for: round the bowl at 40 degrees from the lowest point, whose rate without spin about the normal is
sqrt(5 g / (7 (R - r) cos 40)). A run from there stays on its circle.

    python examples/ball_in_bowl.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "ball.urdf"
RADIUS, BOWL, G = 0.1, 1.0, 9.81


def main(html: Path | None = None, duration: float = 5.0) -> dict[str, float]:
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), "ball")
    bowl = scene.add_contour("bowl", pc.Sphere(BOWL), placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, BOWL])))
    scene.add_contact("ball", ball, bowl, friction=pc.NoSlip(), side=-1)
    arm = BOWL - RADIUS

    def up_the_wall(angle: float) -> np.ndarray:
        return np.r_[arm * math.sin(angle), 0.0, BOWL - arm * math.cos(angle), 0.0, 0.0, 0.0, 1.0]

    rest = pc.find_equilibrium(scene, up_the_wall(0.5))
    swing = float(np.abs(pc.linearize(scene, rest.state).without_symmetries().eigenvalues.imag).max())

    angle = math.radians(40.0)
    rate = math.sqrt(5.0 * G / (7.0 * arm * math.cos(angle)))

    def kept(q: np.ndarray, v: np.ndarray) -> list[float]:
        """The height, and no spin about the normal."""
        rotation = pin.Quaternion(q[3:]).matrix()
        normal = (np.array([0.0, 0.0, BOWL]) - q[:3]) / arm
        return [q[2] - (BOWL - arm * math.cos(angle)), normal @ rotation @ v[3:]]

    # a rough guess: the centre's velocity round the bowl, and the spin that rolling needs
    speed = 1.1 * rate * arm * math.sin(angle)
    turning = -speed / RADIUS * np.array([math.cos(angle), 0.0, math.sin(angle)])
    steady = pc.find_steady_motion(scene, up_the_wall(angle), np.r_[0.0, speed, 0.0, turning], conditions=kept)
    v = steady.state.v
    found = float(np.linalg.norm(v[:3])) / (arm * math.sin(angle))
    run = pc.simulate(scene, steady.state, duration, rtol=1e-10, atol=1e-12)
    result = {
        "swing": swing,
        "swing_closed_form": math.sqrt(5.0 * G / (7.0 * arm)),
        "rate": found,
        "rate_closed_form": rate,
        "height_drift": float(np.abs(run.q[:, 2] - run.q[0, 2]).max()),
        "rest_offset": float(np.linalg.norm(rest.state.q[:2])),
    }
    print(
        f"rest found {result['rest_offset']:.1e} m from the lowest point; swings at {swing:.9f} rad/s "
        f"(closed form {result['swing_closed_form']:.9f})"
    )
    print(
        f"round at 40 degrees in {steady.iterations} steps: {found:.9f} rad/s (closed form {rate:.9f}); "
        f"height kept to {result['height_drift']:.1e} m for {duration:g} s"
    )
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
