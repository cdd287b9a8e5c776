"""A cam and its follower: the motor's torque by inverse dynamics, and the speed at which the follower jumps.

An eccentric disk turns about a fixed shaft and lifts a flat-faced follower, a planar contact of a circle with a line.
Inverse dynamics gives the torque that keeps the shaft at constant speed, at sixteen angles; fed to the motor as a
Fourier series of the angle it does so in a simulation. The follower is held down by its weight alone: above
sqrt(g / eccentricity) it lifts off, at the angle where its acceleration reaches g, which the run finds as an event.

    python examples/cam_follower.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "cam_follower.urdf"
RADIUS, ECCENTRICITY, G = 0.06, 0.02, 9.81


def cam() -> pc.Scene:
    """The cam's centre lies off the shaft by the eccentricity along the link's x axis."""
    scene = pc.Scene.from_urdf(URDF)
    scene.model.gravity.linear = np.array([0.0, -G, 0.0])
    disk = scene.add_contour("cam", pc.Circle(RADIUS), "cam", pin.SE3(np.eye(3), np.array([ECCENTRICITY, 0.0, 0.0])))
    face = scene.add_contour("face", pc.Line(domain=(-0.1, 0.1)), "follower")
    scene.add_contact("cam", disk, face)
    return scene


def at(scene: pc.Scene, angle: float, rate: float) -> pc.State:
    """The shaft at an angle in rad, turning at a rate in rad/s; the follower at radius + eccentricity sin(angle)."""
    model = scene.model
    q, v = np.zeros(model.nq), np.zeros(model.nv)
    shaft, guide = (model.joints[model.getJointId(name)] for name in ("shaft", "guide"))
    q[shaft.idx_q : shaft.idx_q + 2] = math.cos(angle), math.sin(angle)
    q[guide.idx_q] = RADIUS + ECCENTRICITY * math.sin(angle)
    v[shaft.idx_v], v[guide.idx_v] = rate, ECCENTRICITY * rate * math.cos(angle)
    return scene.initial_state(q, v)


def main(html: Path | None = None) -> dict[str, float]:
    scene = cam()
    model = scene.model
    shaft = model.joints[model.getJointId("shaft")]
    guide = model.joints[model.getJointId("guide")]

    def torques(rate: float) -> Callable[[float], float]:
        angles = 2.0 * math.pi * np.arange(16) / 16
        samples = []
        for angle in angles:
            wanted = np.zeros(model.nv)
            wanted[guide.idx_v] = -ECCENTRICITY * rate**2 * math.sin(angle)
            found = pc.inverse_dynamics(scene, at(scene, angle, rate), wanted, actuation=["shaft"])
            samples.append(found.tau[shaft.idx_v])
        series = np.fft.rfft(samples)[:8] / 8.0
        series[0] *= 0.5
        return lambda angle: float((series * np.exp(1j * angle * np.arange(8))).real.sum())

    def turned(rate: float, duration: float) -> pc.Trajectory:
        torque = torques(rate)

        def motor(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
            tau = np.zeros(model.nv)
            tau[shaft.idx_v] = torque(math.atan2(q[shaft.idx_q + 1], q[shaft.idx_q]))
            return tau

        return pc.simulate(scene, at(scene, 0.0, rate), duration, control=motor, rtol=1e-9)

    critical = math.sqrt(G / ECCENTRICITY)
    slow = turned(0.9 * critical, 3.0 * 2.0 * math.pi / (0.9 * critical))
    speeds = slow.v[:, shaft.idx_v]
    fast = turned(1.2 * critical, 0.99 * math.pi / (1.2 * critical))
    jump = next(event for event in fast.events if event.kind == "separate")
    angle = math.atan2(jump.q[shaft.idx_q + 1], jump.q[shaft.idx_q])
    result = {
        "critical": critical,
        "slow_events": len(slow.events),
        "slow_force": float(slow.contacts["cam"].normal_force.min()),
        "speed_error": float(np.abs(speeds / speeds[0] - 1.0).max()),
        "jump_angle": angle,
        "expected_angle": math.asin(1.0 / 1.2**2),
    }
    print(f"{speeds[0]:.3f} rad/s: {slow.message} speed kept to {result['speed_error']:.1e}, no events")
    print(
        f"{fast.v[0, shaft.idx_v]:.3f} rad/s: the follower jumps at {angle:.9f} rad "
        f"(closed form {result['expected_angle']:.9f})"
    )
    if html is not None:
        print(f"wrote {pc.export_html(slow, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
