"""PAL's humanoid Talos on two flat feet, each of four corner points, raising its arms.

Eight contacts carry the robot, which is 24 constraints for 18 that feet can have: the forces of single corners are not
unique, what they add up to is. Joint springs hold the posture about torques from inverse dynamics; the arms rise to the
front. At the end, at rest, the centre of pressure, from the contact forces, is below the centre of mass, from
Pinocchio, which has moved forward. No corner slips or lifts.

The description is not part of this package: pip install "pincontact[robots]", or example-robot-data by itself.

    python examples/talos.py [--html FILE]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin
from robot_data import RobotDataMissing, robot_data

import pincontact as pc

# of a sole, m
HALF_LENGTH, HALF_WIDTH, MU = 0.1, 0.06, 0.6
# N m / rad and N m s / rad, of legs and torso, which carry the body, and of arms and head; what sways is damped more
BODY_GAINS, ARM_GAINS, SWAYS = (4000.0, 120.0), (60.0, 1.5), (300.0, ("3_joint", "4_joint", "5_joint"))
RISE, ANGLE = 1.0, -1.0


def talos() -> tuple[pc.Scene, np.ndarray]:
    """The robot on its soles' corners, with its grippers locked, and its half sitting posture."""
    share = robot_data("talos_data")
    folder = share / "example-robot-data" / "robots" / "talos_data"
    urdf = str(folder / "robots" / "talos_reduced.urdf")
    whole, _, shapes = pin.buildModelsFromUrdf(urdf, package_dirs=[str(share)], root_joint=pin.JointModelFreeFlyer())
    pin.loadReferenceConfigurations(whole, str(folder / "srdf" / "talos.srdf"), False)
    posture = np.array(whole.referenceConfigurations["half_sitting"])
    grippers = [whole.getJointId(name) for name in whole.names if "gripper" in name]
    model, visual = pin.buildReducedModel(whole, shapes, grippers, posture)
    scene = pc.Scene(model, visual)
    floor = scene.add_contour("floor", pc.Plane())
    for side in ("left", "right"):
        for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            corner = pin.SE3(np.eye(3), np.array([x * HALF_LENGTH, y * HALF_WIDTH, 0.0]))
            name = f"{side} {'front' if x > 0 else 'back'} {'left' if y > 0 else 'right'}"
            point = scene.add_contour(name, pc.Point(), f"{side}_sole_link", corner)
            scene.add_contact(name, point, floor, friction=pc.Coulomb(MU))
    q = np.array(model.referenceConfigurations["half_sitting"])
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    q[2] -= data.oMf[model.getFrameId("left_sole_link")].translation[2]
    return scene, q


def pressure(run: pc.Trajectory, row: int) -> np.ndarray:
    """(2,) centre of pressure on the floor, m."""
    tracks = list(run.contacts.values())
    loads = np.array([track.normal_force[row] for track in tracks])
    return loads @ np.array([track.point[row, :2] for track in tracks]) / loads.sum()


def main(html: Path | None = None, duration: float = 3.0) -> dict[str, float]:
    scene, q = talos()
    model = scene.model
    state = scene.initial_state(q)
    arms = [model.joints[model.getJointId(f"arm_{side}_4_joint")].idx_v for side in ("left", "right")]
    lowered = state.q[7:].copy()
    data = model.createData()
    names = list(model.names)[2:]
    heavy = [name.startswith(("leg", "torso")) for name in names]
    stiffness, damping = np.where(np.array(heavy)[:, None], BODY_GAINS, ARM_GAINS).T
    damping[[name.startswith("leg") and name.endswith(SWAYS[1]) for name in names]] = SWAYS[0]

    def wanted(t: float) -> np.ndarray:
        """Joint angles: the elbows bend from rest to rest."""
        part = min(t / RISE, 1.0)
        posture = lowered.copy()
        posture[np.array(arms) - 6] += ANGLE * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        return posture

    holding = pc.inverse_dynamics(scene, state).tau

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        tau = holding.copy()
        tau[6:] -= stiffness * (q[7:] - wanted(t)) + damping * v[6:]
        return tau

    times = np.linspace(0.0, duration, 91)
    run = pc.simulate(scene, state, duration, control=control, rtol=1e-6, t_eval=times)
    centres = [pin.centerOfMass(model, data, row)[:2].copy() for row in (run.q[0], run.q[-1])]
    weight = pin.computeTotalMass(model) * 9.81
    tracks = list(run.contacts.values())
    result = {
        "status": run.status,
        "start_apart": float(np.linalg.norm(pressure(run, 0) - centres[0])),
        "end_apart": float(np.linalg.norm(pressure(run, -1) - centres[1])),
        "moved": float(centres[1][0] - centres[0][0]),
        "end_speed": float(np.abs(run.v[-1]).max()),
        "weight_error": float(abs(sum(track.normal_force[0] for track in tracks) / weight - 1.0)),
        "least_load": float(min(track.normal_force.min() for track in tracks)),
        "corner_speed": float(max(np.linalg.norm(track.slip_velocity, axis=1).max() for track in tracks)),
        "all_stick": float(
            all((track.mode == 1).all() for track in tracks) and not any(event.contact for event in run.events)
        ),
    }
    print(
        f"{run.message} The centre of mass moves forward by {1e3 * result['moved']:.2f} mm; the centre of pressure "
        f"is {1e3 * result['start_apart']:.0e} mm from it at first and {1e3 * result['end_apart']:.2f} mm at last"
    )
    print(f"corners slip with {result['corner_speed']:.0e} m/s at most, the least load is {result['least_load']:.1f} N")
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    try:
        main(parser.parse_args().html)
    except RobotDataMissing as missing:
        raise SystemExit(str(missing)) from missing
