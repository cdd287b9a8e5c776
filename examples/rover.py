"""A wheeled robot: steered by the torques of its two wheels, and driven off with wheels that spin.

The robot of urdf/rover.urdf stands on two tyres (tori, Coulomb friction) and a frictionless caster. A speed controller
turns the difference of two torques into a curve: it drives an S and comes to a straight line again, its wheels sticking
all the way (their sideways constraints are one and the same), so that the axle never moves sideways and turns at
r (w_right - w_left) / track. Then it drives off at a
constant torque, once gently and once with more than the tyres hold; both accelerations have closed forms.

    python examples/rover.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "rover.urdf"
WHEEL, TYRE, HALF_TRACK = 0.08, 0.015, 0.17
CASTER, CASTER_RADIUS, CASTER_BEHIND = "caster", 0.03, 0.16
MU = 0.8


def rover() -> pc.Scene:
    """Two tyres and a caster on the floor."""
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    floor = scene.add_contour("floor", pc.Plane())
    axle = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    for name in ("left", "right"):
        tyre = scene.add_contour(name, pc.Torus(WHEEL - TYRE, TYRE), f"{name}_wheel", axle)
        scene.add_contact(name, tyre, floor, friction=pc.Coulomb(MU))
    centre = pin.SE3(np.eye(3), np.array([-CASTER_BEHIND, 0.0, CASTER_RADIUS - WHEEL]))
    caster = scene.add_contour(CASTER, pc.Sphere(CASTER_RADIUS), "base", centre)
    scene.add_contact(CASTER, caster, floor)
    return scene


def wheels(model: pin.Model) -> list[int]:
    """Indices of the left and the right wheel in v."""
    return [model.joints[model.getJointId(f"{name}_axle")].idx_v for name in ("left", "right")]


def standing(scene: pc.Scene) -> pc.State:
    q = pin.neutral(scene.model)
    q[2] = WHEEL
    return scene.initial_state(q)


def drive(scene: pc.Scene, duration: float) -> pc.Trajectory:
    """An S: up to 0.8 m/s, a curve to the left, one to the right, and straight on."""
    model = scene.model
    left, right = wheels(model)

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        part = t / duration
        speed = 0.8 * math.sin(min(2.0 * part, 0.5) * math.pi) ** 2
        turning = 2.2 * math.sin(2.0 * math.pi * part) * math.sin(math.pi * part) ** 2
        force, moment = 60.0 * (speed - v[0]), 4.0 * (turning - v[5])
        tau = np.zeros(model.nv)
        tau[left] = 0.5 * WHEEL * (force - moment / HALF_TRACK)
        tau[right] = 0.5 * WHEEL * (force + moment / HALF_TRACK)
        return tau

    return pc.simulate(scene, standing(scene), duration, control=control, rtol=1e-9, max_step=duration / 4)


def pull_away(scene: pc.Scene, torque: float) -> pc.Trajectory:
    """From rest with a constant torque in N m on both wheels."""
    tau = np.zeros(scene.model.nv)
    tau[wheels(scene.model)] = torque
    return pc.simulate(scene, standing(scene), 0.5, control=lambda t, q, v: tau, rtol=1e-10)


def closed_forms(model: pin.Model, torque: float) -> tuple[float, float]:
    """Acceleration in m/s^2 while both wheels roll, and while both spin."""
    base, wheel = model.inertias[1], model.inertias[2]
    mass, spin, g = base.mass + 2.0 * wheel.mass, wheel.inertia[1, 1], -model.gravity.linear[2]
    rolling = (2.0 * torque / WHEEL) / (mass + 2.0 * spin / WHEEL**2)
    # moments about the floor below the axle; unknown are the loads of both wheels, N, and of the caster, C:
    #   N + C = mass g,   mass a = mu N,
    #   x_base m_base g + b C = a (h m_base + 2 r m_wheel) + 2 (torque - mu N r / 2)
    height, ahead = WHEEL + base.lever[2], base.lever[0]
    share = MU / mass * (height * base.mass + 2.0 * WHEEL * wheel.mass) - MU * WHEEL
    weight = mass * g
    load = (ahead * base.mass * g + CASTER_BEHIND * weight - 2.0 * torque) / (CASTER_BEHIND + share)
    return rolling, MU * load / mass


def main(html: Path | None = None, duration: float = 4.0) -> dict[str, float]:
    scene = rover()
    model = scene.model
    left, right = wheels(model)
    run = drive(scene, duration)
    rate = WHEEL * (run.v[:, right] - run.v[:, left]) / (2.0 * HALF_TRACK)
    ratios = [run.contacts[name].tangential_force / run.contacts[name].normal_force for name in ("left", "right")]
    result = {
        "drive_events": len(run.events),
        "x": float(run.q[-1, 0]),
        "y": float(run.q[-1, 1]),
        "speed": float(run.v[-1, 0]),
        "sideways": float(np.abs(run.v[:, 1]).max()),
        "yaw_error": float(np.abs(run.v[:, 5] - rate).max()),
        "largest_yaw_rate": float(np.abs(rate).max()),
        "largest_ratio": float(np.max(ratios)),
    }
    print(
        f"an S, {result['x']:.2f} m, {result['y']:.2f} m to the side: {run.message} "
        f"axle sideways by at most {result['sideways']:.0e} m/s, "
        f"yaw rate off r (w_r - w_l) / track by {result['yaw_error']:.0e} rad/s; "
        f"friction at most {result['largest_ratio']:.2f} of the load"
    )
    for name, torque in (("gentle", 0.8), ("spinning", 2.4)):
        start = pull_away(scene, torque)
        expected = closed_forms(model, torque)[name == "spinning"]
        result[name] = float((start.v[-1, 0] - start.v[0, 0]) / (start.t[-1] - start.t[0]))
        result[f"{name}_closed_form"] = expected
        result[f"{name}_slip"] = float(np.linalg.norm(start.contacts["left"].slip_velocity[-1]))
        print(
            f"{torque} N m on each wheel: {result[name]:.9f} m/s^2 (closed form {expected:.9f}), "
            f"the wheels slip at {result[f'{name}_slip']:.3g} m/s in the end"
        )
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
