"""An arm wipes a curved surface with a constant force, by inverse dynamics at 1 kHz and no plan made beforehand.

The pad of urdf/arm.urdf slides round a circle on waves. Each millisecond one call of `inverse_dynamics` finds the
torques, within their limits, for the acceleration that the tool ought to have and the force with which it ought to
press: 20 N along the surface's normal where the pad is, and mu times that against its sliding, which is Coulomb's law.
The contact keeps the pad on the surface: nothing is said about its height. The simulated normal force stays at 20 N,
and the friction's work is mu N times the way that the pad slides.

    python examples/arm_wipes_in_closed_loop.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "arm.urdf"
PAD, REACH = 0.02, 0.07
CENTRE, RADIUS, PERIOD = (0.42, 0.0), 0.1, 2.0
HEIGHT, WAVE, TABLE = 0.008, 24.0, 0.15
PRESS, MU = 20.0, 0.3
# of the tool's errors, 1/s: critically damped; of joints, N m
RATE, EFFORT = 30.0, 60.0


def height(x: float, y: float) -> float:
    """Of the surface in m."""
    return HEIGHT * math.cos(WAVE * x) * math.cos(WAVE * y)


def normal(x: float, y: float) -> np.ndarray:
    """Upward unit normal of the surface."""
    slope_x = -HEIGHT * WAVE * math.sin(WAVE * x) * math.cos(WAVE * y)
    slope_y = -HEIGHT * WAVE * math.cos(WAVE * x) * math.sin(WAVE * y)
    n = np.array([-slope_x, -slope_y, 1.0])
    return n / np.linalg.norm(n)


def arm() -> pc.Scene:
    scene = pc.Scene.from_urdf(URDF)
    model = scene.model
    model.effortLimit = np.full(model.nv, EFFORT)
    tool = model.frames[model.getFrameId("tool")]
    at_pad = pin.SE3(np.eye(3), np.array([0.0, 0.0, REACH]))
    model.addFrame(pin.Frame("pad", tool.parentJoint, 0, tool.placement * at_pad, pin.FrameType.OP_FRAME))
    pad = scene.add_contour("pad", pc.Sphere(PAD), "tool", at_pad)
    ends = tuple((c - 0.18, c + 0.18) for c in CENTRE)
    placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, TABLE]))
    surface = scene.add_contour("surface", pc.HeightField(height, domain=ends), placement=placement)
    scene.add_contact("pad", pad, surface, friction=pc.Coulomb(MU))
    return scene


def circle(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the pad's centre ought to be seen from above, (x, y), its velocity and acceleration."""
    rate = 2.0 * math.pi / PERIOD
    out = RADIUS * np.array([math.cos(rate * t), math.sin(rate * t)])
    return out + CENTRE, rate * np.array([-out[1], out[0]]), -(rate**2) * out


def start(scene: pc.Scene) -> pc.State:
    """The pad on the surface at the circle's begin, its tool upright and on its way, by Newton's method."""
    model = scene.model
    data, frame = model.createData(), model.getFrameId("pad")
    (x, y), velocity, _ = circle(0.0)
    down = pin.utils.rotate("y", math.pi)
    # the centre of a pad that touches the surface from above, seen from the point below it
    point = np.array([x, y])
    for _ in range(50):
        point = np.array([x, y]) - PAD * normal(*point)[:2]
    wanted = pin.SE3(down, np.array([*point, TABLE + height(*point)]) + PAD * normal(*point))
    q = np.array([0.0, 0.6, 1.7, 0.0, math.pi - 2.3, 0.0])
    for _ in range(100):
        pin.framesForwardKinematics(model, data, q)
        error = pin.log6(data.oMf[frame].actInv(wanted))
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        step = np.linalg.solve(pin.Jlog6(wanted.actInv(data.oMf[frame])) @ jacobian, error.vector)
        q = q + step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-300))
    n = normal(*point)
    # along the surface
    climb = -float(n[:2] @ velocity) / n[2]
    jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    return scene.initial_state(q, np.linalg.solve(jacobian, [*velocity, climb, 0.0, 0.0, 0.0]))


def main(html: Path | None = None, duration: float = 2.0, dt: float = 1e-3) -> dict[str, float]:
    scene = arm()
    model = scene.model
    data, frame, axes = model.createData(), model.getFrameId("pad"), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    begin = state = start(scene)
    stepper = pc.Stepper(scene, state, dt=dt)
    found: pc.InverseDynamics | None = None
    torques, pressed, off, tilt, way, work, efforts, heights = [], [], 0.0, 0.0, 0.0, 0.0, 0.0, []
    while stepper.t < duration - 0.5 * dt:
        pin.forwardKinematics(model, data, state.q, state.v)
        pin.updateFramePlacements(model, data)
        place, twist = data.oMf[frame], pin.getFrameVelocity(model, data, frame, axes)
        aim, rate, acceleration = circle(state.t)
        error = aim - place.translation[:2]
        off = max(off, float(np.linalg.norm(error)))
        upright = pin.log3(place.rotation @ pin.utils.rotate("y", math.pi).T)
        tilt = max(tilt, float(np.linalg.norm(upright)))
        along = acceleration + 2.0 * RATE * (rate - twist.linear[:2]) + RATE**2 * error
        x, y = state.location_of("pad")[1]
        n = normal(x, y)
        # of the pad's material on the surface
        sliding = twist.linear + np.cross(twist.angular, -PAD * n)
        force = PRESS * (MU * sliding / np.linalg.norm(sliding) - n)
        # its height is the contact's
        wanted = {"pad": np.array([*along, 0.0, *(-2.0 * RATE * twist.angular - RATE**2 * upright)])}
        weights = {"pad": [1.0, 1.0, 0.0, 1.0, 1.0, 1.0]}
        found = pc.inverse_dynamics(
            scene, state, wanted, weights=weights, forces={"pad": force}, effort_limits=True, warm=found
        )
        torques.append(found.tau)
        efforts = max(efforts, float(np.abs(found.efforts).max()))
        state = stepper.step(found.tau)
        on_surface = stepper.forces["pad"]
        pressed.append(-float(on_surface @ n))
        way += dt * float(np.linalg.norm(sliding))
        work -= dt * float(on_surface @ sliding)
        heights.append(TABLE + height(x, y))
    result = {
        "force_error": float(np.abs(np.array(pressed) - PRESS).max()),
        "mean_force": float(np.mean(pressed)),
        "off_circle": off,
        "tilt": tilt,
        "way": way,
        "work_error": abs(work / (-MU * PRESS * way) - 1.0),
        "largest_effort": efforts,
        "up_and_down": float(np.ptp(heights)),
        "slides": float(stepper.modes[0] == 2),
    }
    waves = 1e3 * result["up_and_down"]
    print(f"{way:.3f} m slid over waves of {waves:.1f} mm, {1e3 * off:.3f} mm off the circle at most")
    print(f"normal force {PRESS} N kept to {result['force_error']:.1e} N, torques at most {efforts:.1f} N m")
    print(f"friction worked {work:.6f} J; mu N times the way is {-MU * PRESS * way:.6f} J")
    if html is not None:
        played = pc.simulate(
            scene,
            begin,
            duration,
            control=lambda t, q, v: torques[min(int(t / dt + 1e-6), len(torques) - 1)],
            method="Moreau",
            dt=dt,
        )
        print(f"wrote {pc.export_html(played, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
