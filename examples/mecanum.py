"""A base on mecanum wheels, each with ten passive rollers, drives ahead, sideways and round.

A roller is an ellipsoid whose axis is inclined by 45 degrees to the wheel's; it turns freely. The floor is handed from
one to the next, within 0.07 mm of a round wheel. Speed controllers turn the wheels as the usual kinematics of mecanum
wheels ask for. These are nowhere in the simulation, which has 40 contacts of single rollers with friction; the base
goes where they say, up to what the floor's uneven way from roller to roller takes.

    python examples/mecanum.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

import pincontact as pc

# m: of wheels, of the circle on which the axes of rollers are, and of these from the base's centre
WHEEL, AXES, BASE, TRACK = 0.1, 0.075, 0.25, 0.2
ROLLERS, MU = 10, 0.7
# kg
BODY_MASS, WHEEL_MASS, ROLLER_MASS = 12.0, 0.8, 0.05
# N m s of the wheels' controllers, and N m s of rollers' bearings
GAIN, BEARING = 3.0, 1e-4
# Front or rear, left or right, and how rollers below are inclined: their axis is along (1, +-1, 0).
WHEELS = {"fl": (1, 1, -1), "fr": (1, -1, 1), "rl": (-1, 1, 1), "rr": (-1, -1, -1)}
# What is asked for: velocities of the base in m/s and rad/s, ahead, to the left and round.
COMMANDS = {"ahead": (0.3, 0.0, 0.0), "sideways": (0.0, 0.3, 0.0), "round": (0.0, 0.0, 0.6)}


def roller_axes() -> tuple[float, float]:
    """Semi-axes of a roller in m, across and along: the wheel has its radius below a roller and between two."""
    across = WHEEL - AXES
    # a plane that touches the wheel between two rollers is so inclined to their axes
    sine = math.sin(math.pi / ROLLERS) / math.sqrt(2.0)
    reach = WHEEL - AXES * math.cos(math.pi / ROLLERS)
    return across, math.sqrt((reach**2 - across**2 * (1.0 - sine**2)) / sine**2)


def mecanum() -> pc.Scene:
    """The base, with its rollers on the floor."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(root, pin.Inertia.FromBox(BODY_MASS, 0.6, 0.3, 0.1), pin.SE3.Identity())
    shapes = pin.GeometryModel()
    box = pin.GeometryObject("base", root, pin.SE3.Identity(), coal.Box(0.6, 0.28, 0.1))
    box.meshColor = np.array([0.2, 0.35, 0.6, 1.0])
    shapes.addGeometryObject(box)
    across, along = roller_axes()
    rollers = []
    for name, (front, left, inclined) in WHEELS.items():
        at = pin.SE3(np.eye(3), np.array([front * BASE, left * TRACK, 0.0]))
        wheel = model.addJoint(root, pin.JointModelRY(), at, name)
        hub = pin.Inertia.FromCylinder(WHEEL_MASS, 0.5 * AXES, 0.05)
        model.appendBodyToJoint(wheel, hub, pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3)))
        axis = np.array([1.0, inclined, 0.0]) / math.sqrt(2.0)
        below = pin.SE3(
            pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix(), np.array([0.0, 0.0, -AXES])
        )
        for k in range(ROLLERS):
            turned = pin.SE3(pin.utils.rotate("y", 2.0 * math.pi * k / ROLLERS), np.zeros(3))
            roller = model.addJoint(wheel, pin.JointModelRZ(), turned * below, f"{name}_{k}")
            body = pin.Inertia.FromEllipsoid(ROLLER_MASS, across, across, along)
            model.appendBodyToJoint(roller, body, pin.SE3.Identity())
            model.damping[model.joints[roller].idx_v] = BEARING
            shape = coal.Ellipsoid(across, across, along)
            item = pin.GeometryObject(f"{name}_{k}", roller, pin.SE3.Identity(), shape)
            item.meshColor = np.array([0.25, 0.25, 0.25, 1.0] if k % 2 else [0.75, 0.45, 0.2, 1.0])
            shapes.addGeometryObject(item)
            rollers.append(f"{name}_{k}")
    scene = pc.Scene(model, shapes)
    floor = scene.add_contour("floor", pc.Plane())
    for name in rollers:
        contour = scene.add_contour(name, pc.Ellipsoid(across, across, along), name)
        scene.add_contact(name, contour, floor, friction=pc.Coulomb(MU))
    return scene


def wheel_speeds(ahead: float, aside: float, turning: float) -> np.ndarray:
    """(4,) in rad/s, from the velocity of the base in its own axes: rollers do not slip along their axes."""
    return np.array(
        [
            (ahead - turning * left * TRACK + inclined * (aside + turning * front * BASE)) / WHEEL
            for front, left, inclined in WHEELS.values()
        ]
    )


def drive(scene: pc.Scene, command: tuple[float, float, float], duration: float) -> pc.Trajectory:
    """From rest, the command being reached within the first half second."""
    model = scene.model
    q = pin.neutral(model)
    q[2] = WHEEL
    state = scene.initial_state(q, free=[name for name in scene.contacts if not name.endswith("_0")])
    indices = [model.joints[model.getJointId(name)].idx_v for name in WHEELS]
    wanted = wheel_speeds(*command)

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        tau = np.zeros(model.nv)
        tau[indices] = GAIN * (wanted * min(t / 0.5, 1.0) - v[indices])
        return tau

    times = np.linspace(0.0, duration, round(60 * duration) + 1)
    return pc.simulate(scene, state, duration, control=control, method="Moreau", dt=1e-3, t_eval=times)


def main(html: Path | None = None, duration: float = 2.0) -> dict[str, float]:
    scene = mecanum()
    result: dict[str, float] = {}
    for name, command in COMMANDS.items():
        run = drive(scene, command, duration)
        # the mean motion of the second half, when the command has been reached
        first = int(np.argmax(run.t >= 0.5 * duration))
        before, after = (pin.XYZQUATToSE3(run.q[k, :7]) for k in (first, -1))
        twist = pin.log6(before.actInv(after)).vector / (run.t[-1] - run.t[first])
        found, asked = twist[[0, 1, 5]], np.array(command)
        along = int(np.argmax(np.abs(asked)))
        result[f"{name}_status"] = run.status
        result[f"{name}_ratio"] = float(found[along] / asked[along])
        result[f"{name}_across"] = float(np.abs(np.delete(found, along)).max())
        result[f"{name}_bump"] = float(np.ptp(run.q[:, 2]))
        touching = sum(track.mode >= 0 for track in run.contacts.values())
        result[f"{name}_least"] = float(touching.min())
        print(
            f"{name:8s} {run.message} {found[along]:.4f} of {asked[along]:.1f}, others {result[f'{name}_across']:.0e}; "
            f"up and down {1e3 * result[f'{name}_bump']:.3f} mm; {touching.min()} to {touching.max()} rollers touch"
        )
        if html is not None and name == "sideways":
            print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write the replay sideways as an HTML file")
    main(parser.parse_args().html)
