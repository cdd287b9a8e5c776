"""Unitree's Go2 on its four round feet, pushed aside and coming back.

The robot holds its stance with joint springs and dampers about torques from inverse dynamics. A push grows and goes
within a second; all feet stick, so that the stance is what it was. A second push, three times as strong, makes feet
slip. The forces of the feet add up to weight and push at all times, and at rest nothing creeps.

The description is not part of this package: pip install "pincontact[robots]", or example-robot-data by itself.

    python examples/go2.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
from robot_data import RobotDataMissing, robot_data

import pincontact as pc

FEET = ("FL", "FR", "RL", "RR")
RADIUS, MU = 0.022, 0.6
HIP, THIGH, CALF = 0.0, 0.8, -1.5
STIFFNESS, DAMPING = 120.0, 4.0


def go2() -> pc.Scene:
    """Four round feet on the floor."""
    share = robot_data("go2_description")
    urdf = share / "example-robot-data" / "robots" / "go2_description" / "urdf" / "go2.urdf"
    scene = pc.Scene.from_urdf(urdf, floating_base=True, package_dirs=[share])
    floor = scene.add_contour("floor", pc.Plane())
    for name in FEET:
        foot = scene.add_contour(name, pc.Sphere(RADIUS), f"{name}_foot")
        scene.add_contact(name, foot, floor, friction=pc.Coulomb(MU))
    return scene


def standing(scene: pc.Scene) -> pc.State:
    """Knees bent, all feet on the floor."""
    model = scene.model
    q = pin.neutral(model)
    for name in FEET:
        for joint, angle in (("hip", HIP), ("thigh", THIGH), ("calf", CALF)):
            q[model.joints[model.getJointId(f"{name}_{joint}_joint")].idx_q] = angle
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    q[2] = RADIUS - data.oMf[model.getFrameId(f"{FEET[0]}_foot")].translation[2]
    return scene.initial_state(q)


def pushed(scene: pc.Scene, state: pc.State, push: float, duration: float) -> pc.Trajectory:
    """A run in which a force in N to the left acts on the body for a second, sin^2 of time."""
    holding = pc.inverse_dynamics(scene, state).tau

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        tau = holding.copy()
        tau[6:] -= STIFFNESS * (q[7:] - state.q[7:]) + DAMPING * v[6:]
        tau[:3] += pin.Quaternion(q[3:7]).matrix()[1] * force(push, t)
        return tau

    return pc.simulate(
        scene, state, duration, control=control, fallback="Moreau", t_eval=np.linspace(0.0, duration, 241)
    )


def force(push: float, t: float) -> float:
    return push * math.sin(math.pi * t) ** 2 if t < 1.0 else 0.0


def main(html: Path | None = None, push: float = 25.0) -> dict[str, float]:
    scene = go2()
    state = standing(scene)
    model = scene.model
    weight = pin.computeTotalMass(model) * 9.81
    rest = pushed(scene, state, 0.0, 1.0)
    run = pushed(scene, state, push, 2.0)
    hard = pushed(scene, state, 3.0 * push, 2.0)
    tracks = [run.contacts[name] for name in FEET]
    # Newton's law for the whole robot: the mean force of the floor is the weight, once everything is at rest again
    mean = sum(np.trapezoid(track.normal_force, run.t) for track in tracks) / 2.0
    result = {
        "status": run.status,
        "events": len(run.events),
        "rest_drift": float(np.abs(rest.q[-1] - rest.q[0]).max()),
        "weight_error": float(abs(sum(rest.contacts[name].normal_force[-1] for name in FEET) / weight - 1.0)),
        "mean_error": float(abs(mean / weight - 1.0)),
        "sway": float(np.abs(run.q[:, 1] - run.q[0, 1]).max()),
        "returns": float(np.abs(run.q[-1] - run.q[0]).max()),
        "slip": float(max(np.linalg.norm(track.slip_velocity, axis=1).max() for track in tracks)),
        "hard_status": hard.status,
        "hard_slips": float(sum((hard.contacts[name].mode == 2).any() for name in FEET)),
        "hard_slides": float(max(np.linalg.norm(np.ptp(hard.contacts[name].point, axis=0)) for name in FEET)),
    }
    print(f"one second at rest: q moves by {result['rest_drift']:.0e}")
    print(
        f"{push:.0f} N: {run.message} It sways by {1e3 * result['sway']:.1f} mm and ends {result['returns']:.1e} from "
        f"its stance; feet slip with {result['slip']:.0e} m/s at most"
    )
    print(f"{3.0 * push:.0f} N: {hard.message} {hard.events[:6]}")
    if html is not None:
        print(f"wrote {pc.export_html(hard, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    try:
        main(parser.parse_args().html)
    except RobotDataMissing as missing:
        raise SystemExit(str(missing)) from missing
