"""A Franka arm rolls a ball over a table with its fingertip.

A ball lies between the table and a spherical fingertip of the Panda arm, held by Coulomb friction alone. The arm
presses and takes the fingertip once round a circle, under an impedance controller. Both contacts stick all the way:
the ball goes half as far as the finger, and comes back turned, as rolling bodies do.

The arm's description is not part of this package: pip install "pincontact[robots]", or example-robot-data by itself.

    python examples/panda_rolls_ball.py [--html FILE]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
from robot_data import RobotDataMissing, robot_data

import pincontact as pc

BALL_URDF = Path(__file__).resolve().parent.parent / "urdf" / "ball.urdf"
BALL, TIP, MU = 0.1, 0.015, 0.6
CIRCLE, PRESS = 0.04, 15.0
ARM_JOINTS = 7
READY = np.array([0.0, -0.2, 0.0, -2.4, 0.0, 2.2, math.pi / 4])


def arm_with_fingers_closed() -> tuple[pin.Model, pin.GeometryModel]:
    share = robot_data("panda_description")
    urdf = share / "example-robot-data" / "robots" / "panda_description" / "urdf" / "panda.urdf"
    model, _, visual = pin.buildModelsFromUrdf(str(urdf), package_dirs=[str(share)])
    fingers = [model.getJointId(f"panda_finger_joint{i}") for i in (1, 2)]
    return pin.buildReducedModel(model, visual, fingers, pin.neutral(model))


def fingertip_above(model: pin.Model, frame: int, wanted: pin.SE3) -> np.ndarray:
    """Joint angles that put a frame somewhere, by Newton's method with the least steps."""
    data, q = model.createData(), READY.copy()
    for _ in range(100):
        pin.framesForwardKinematics(model, data, q)
        error = pin.log6(data.oMf[frame].actInv(wanted)).vector
        if np.linalg.norm(error) < 1e-12:
            return q
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        q += np.linalg.lstsq(pin.Jlog6(wanted.actInv(data.oMf[frame])) @ jacobian, error, rcond=None)[0]
    raise ArithmeticError(f"the fingertip cannot reach {wanted.translation}: {np.linalg.norm(error):.1e} are left.")


def main(html: Path | None = None, duration: float = 2.5) -> dict[str, float]:
    arm, visual = arm_with_fingers_closed()
    hand = arm.getFrameId("panda_hand")
    reach = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1034 + 0.006]))
    tip = arm.addFrame(
        pin.Frame(
            "fingertip", arm.frames[hand].parentJoint, hand, arm.frames[hand].placement * reach, pin.FrameType.OP_FRAME
        )
    )
    ball = pin.buildModelFromUrdf(str(BALL_URDF), pin.JointModelFreeFlyer(), "ball_joint")
    ball_visual = pin.buildGeomFromUrdf(ball, str(BALL_URDF), pin.GeometryType.VISUAL)
    model, shapes = pin.appendModel(arm, ball, visual, ball_visual, 0, pin.SE3.Identity())

    scene = pc.Scene(model, shapes)
    fingertip = scene.add_contour("fingertip", pc.Sphere(TIP), "fingertip")
    sphere = scene.add_contour("ball", pc.Sphere(BALL), "ball")
    table = scene.add_contour("table", pc.Plane())
    scene.add_contact("fingertip/ball", fingertip, sphere, friction=pc.Coulomb(MU))
    scene.add_contact("ball/table", sphere, table, friction=pc.Coulomb(MU))

    start = pin.SE3(pin.utils.rotate("x", math.pi), np.array([0.45, 0.0, 2.0 * BALL + TIP]))
    q = np.r_[fingertip_above(arm, tip, start), 0.45, 0.0, BALL, 0.0, 0.0, 0.0, 1.0]
    state = scene.initial_state(q)

    data = arm.createData()

    def goal(t: float) -> np.ndarray:
        """Where the fingertip should be: from rest once round the circle to rest."""
        part = min(t / duration, 1.0)
        angle = 2.0 * math.pi * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        return start.translation + CIRCLE * np.array([math.cos(angle) - 1.0, math.sin(angle), 0.0])

    def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Weight and gyroscopic terms, a spring along the table, a constant press, and a spring against turning."""
        q_arm, v_arm = q[:ARM_JOINTS], v[:ARM_JOINTS]
        bias = pin.rnea(arm, data, q_arm, v_arm, np.zeros(ARM_JOINTS))
        jacobian = pin.computeFrameJacobian(arm, data, q_arm, tip, pin.LOCAL_WORLD_ALIGNED)
        pin.updateFramePlacement(arm, data, tip)
        place, twist = data.oMf[tip], jacobian @ v_arm
        force = 2500.0 * (goal(t) - place.translation) - 120.0 * twist[:3]
        force[2] = -PRESS - 60.0 * twist[2]
        turn = place.rotation @ pin.log3(place.rotation.T @ start.rotation)
        tau = np.zeros(model.nv)
        tau[:ARM_JOINTS] = bias + jacobian.T @ np.r_[force, 60.0 * turn - 3.0 * twist[3:]] - 0.5 * v_arm
        return tau

    run = pc.simulate(scene, state, duration, control=control, rtol=1e-8)
    tracks = [run.contacts[name] for name in scene.contacts]
    tips = np.empty((len(run.t), 3))
    for k, row in enumerate(run.q):
        pin.framesForwardKinematics(arm, data, row[:ARM_JOINTS])
        tips[k] = data.oMf[tip].translation
    first, last = (pin.Quaternion(row[ARM_JOINTS + 3 :]).matrix() for row in (run.q[0], run.q[-1]))
    farthest = int(np.argmax(np.linalg.norm(tips - tips[0], axis=1)))
    moved = run.q[farthest, ARM_JOINTS : ARM_JOINTS + 2] - run.q[0, ARM_JOINTS : ARM_JOINTS + 2]
    result = {
        "status": run.status,
        "events": len(run.events),
        "slip": float(max(np.linalg.norm(track.slip_velocity, axis=1).max() for track in tracks)),
        "largest_ratio": float(max((track.tangential_force / track.normal_force).max() for track in tracks)),
        "least_force": float(min(track.normal_force.min() for track in tracks)),
        "residual": float(max(values.max() for values in run.residuals().values())),
        "went": float(np.linalg.norm(tips[farthest] - tips[0])),
        "ball_share": float(np.linalg.norm(moved) / np.linalg.norm(tips[farthest, :2] - tips[0, :2])),
        "turned": float(np.linalg.norm(pin.log3(first.T @ last))),
    }
    print(
        f"{run.message} The finger went {1e3 * result['went']:.1f} mm away, the ball {result['ball_share']:.3f} of that"
    )
    print(
        f"both contacts stick: slip below {result['slip']:.0e} m/s, friction at most {result['largest_ratio']:.2f} "
        f"of the load (mu = {MU}), load at least {result['least_force']:.1f} N"
    )
    print(f"back where it began the ball has turned by {math.degrees(result['turned']):.2f} degrees")
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
