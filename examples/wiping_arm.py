"""An arm wipes a curved surface: its pad slides round a circle on waves, pressed on with a constant force.

The arm of urdf/arm.urdf carries a spherical pad that slides with Coulomb friction on a height field. One round of the
circle is solved for beforehand: joint angles that put the pad on the surface with the tool upright, and by inverse
dynamics the torques that move it so while the surface is pushed with 20 N along its normal and dragged with mu times
that. Played back as Fourier series with a weak joint controller, the simulated contact force stays at 20 N and the
friction's work is mu N times the way that the pad slides.

    python examples/wiping_arm.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "arm.urdf"
PAD, REACH = 0.02, 0.07
CENTRE, RADIUS, PERIOD = (0.42, 0.0), 0.1, 2.0
HEIGHT, WAVE = 0.008, 24.0
PRESS, MU = 20.0, 0.3


def height(x: float, y: float) -> float:
    """Of the surface in m."""
    return HEIGHT * math.cos(WAVE * x) * math.cos(WAVE * y)


def arm() -> pc.Scene:
    scene = pc.Scene.from_urdf(URDF)
    pad = scene.add_contour("pad", pc.Sphere(PAD), "tool", pin.SE3(np.eye(3), np.array([0.0, 0.0, REACH])))
    ends = tuple((c - 0.18, c + 0.18) for c in CENTRE)
    surface = scene.add_contour("surface", pc.HeightField(height, domain=ends), placement=TABLE)
    scene.add_contact("pad", pad, surface, friction=pc.Coulomb(MU))
    return scene


TABLE = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15]))


def normal(x: float, y: float) -> np.ndarray:
    """Upward unit normal of the surface."""
    slope_x = -HEIGHT * WAVE * math.sin(WAVE * x) * math.cos(WAVE * y)
    slope_y = -HEIGHT * WAVE * math.cos(WAVE * x) * math.sin(WAVE * y)
    n = np.array([-slope_x, -slope_y, 1.0])
    return n / np.linalg.norm(n)


def joint_angles(model: pin.Model, centre: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Angles that put the pad's centre at a point of the world with the tool pointing down, by Newton's method."""
    data = model.createData()
    frame = model.getFrameId("tool")
    wanted = pin.SE3(pin.utils.rotate("y", math.pi), centre + np.array([0.0, 0.0, REACH]))
    q = guess.copy()
    for _ in range(100):
        pin.framesForwardKinematics(model, data, q)
        error = pin.log6(data.oMf[frame].actInv(wanted))
        if np.linalg.norm(error.vector) < 1e-13:
            break
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        step = np.linalg.solve(pin.Jlog6(wanted.actInv(data.oMf[frame])) @ jacobian, error.vector)
        q += step * min(1.0, 0.3 / np.abs(step).max())
    return q


def series(samples: np.ndarray) -> Callable[[float, int], np.ndarray]:
    """The trigonometric polynomial through (n, m) samples of one period: a function of time and of the derivative."""
    terms = np.fft.rfft(samples, axis=0)[: len(samples) // 2] / len(samples)
    terms[1:] *= 2.0
    rates = 2j * math.pi * np.arange(len(terms)) / PERIOD

    def value(t: float, derivative: int = 0) -> np.ndarray:
        return (np.exp(rates * t) * rates**derivative @ terms).real

    return value


def main(html: Path | None = None, duration: float = 2.0, samples: int = 64) -> dict[str, float]:
    scene = arm()
    model = scene.model
    times = PERIOD * np.arange(samples) / samples
    angles = np.empty((samples, model.nq))
    q = np.array([0.0, 0.6, 1.7, 0.0, math.pi - 2.3, 0.0])
    for k, t in enumerate(times):
        x, y = CENTRE + RADIUS * np.array([math.cos(2.0 * math.pi * t / PERIOD), math.sin(2.0 * math.pi * t / PERIOD)])
        point = np.array([x, y, height(x, y)]) + TABLE.translation
        angles[k] = q = joint_angles(model, point + PAD * normal(x, y), q)
    planned = series(angles)

    torques = np.empty((samples, model.nv))
    for k, t in enumerate(times):
        state = scene.initial_state(planned(t, 0), planned(t, 1))
        at = pc.analyze(scene, state)["pad"]
        # v_c is the surface against the pad: it is dragged the other way
        along = -at.v_c / np.linalg.norm(at.v_c)
        force = PRESS * (MU * along - at.frame[:, 2])
        found = pc.inverse_dynamics(scene, state, planned(t, 2), forces={"pad": force}, tolerance=1e-6)
        torques[k] = found.tau
    prepared = series(torques)

    # springs that swing at 4 Hz with the arm as it stands, critically damped
    mass = pin.crba(model, model.createData(), angles[0])
    rate = 2.0 * math.pi * 4.0

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        error, error_rate = planned(t, 0) - q, planned(t, 1) - v
        return prepared(t, 0) + mass @ (rate**2 * error + 2.0 * rate * error_rate)

    start = scene.initial_state(planned(0.0, 0), planned(0.0, 1))
    run = pc.simulate(scene, start, duration, control=control, rtol=1e-8, energies=True)
    track, work = run.contacts["pad"], run.energies().friction_work
    assert work is not None
    # the way that the pad slides: its material goes by, while the contact point wanders over it
    speeds = np.linalg.norm(track.slip_velocity, axis=1)
    way = float(np.sum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(run.t)))
    centre = track.point[:, :2] - CENTRE
    result = {
        "events": len(run.events),
        "status": run.status,
        "force_error": float(np.abs(track.normal_force - PRESS).max()),
        "angle_error": float(max(np.abs(q - planned(t, 0)).max() for t, q in zip(run.t, run.q))),
        "radius_error": float(np.abs(np.linalg.norm(centre, axis=1) - RADIUS).max()),
        "cone": float(np.abs(track.tangential_force / track.normal_force - MU).max()),
        "way": way,
        "work_error": float(abs(work[-1] / (-MU * PRESS * way) - 1.0)),
        "up_and_down": float(np.ptp(track.point[:, 2])),
    }
    print(f"{run.message} {way:.3f} m slid over waves of {1e3 * result['up_and_down']:.1f} mm")
    print(
        f"normal force {PRESS} N kept to {result['force_error']:.1e} N, "
        f"joint angles to {result['angle_error']:.1e} rad, the circle to {result['radius_error']:.1e} m"
    )
    print(f"friction worked {work[-1]:.6f} J; mu N times the way is {MU * PRESS * way:.6f} J")
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
