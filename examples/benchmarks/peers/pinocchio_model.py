"""A scene's mechanism as a `pin.Model`, for the engines that stand on Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .problem import WORLD, Body, Problem

_ALIGNED = {
    ("revolute", (1.0, 0.0, 0.0)): pin.JointModelRX,
    ("revolute", (0.0, 1.0, 0.0)): pin.JointModelRY,
    ("revolute", (0.0, 0.0, 1.0)): pin.JointModelRZ,
    ("prismatic", (1.0, 0.0, 0.0)): pin.JointModelPX,
    ("prismatic", (0.0, 1.0, 0.0)): pin.JointModelPY,
    ("prismatic", (0.0, 0.0, 1.0)): pin.JointModelPZ,
}


def _joint(body: Body) -> pin.JointModel:
    if body.joint == "free":
        return pin.JointModelFreeFlyer()
    if body.joint == "translation":
        return pin.JointModelTranslation()
    aligned = _ALIGNED.get((body.joint, body.axis))
    if aligned is not None:
        return aligned()
    general = {"revolute": pin.JointModelRevoluteUnaligned, "prismatic": pin.JointModelPrismaticUnaligned}
    return general[body.joint](np.array(body.axis))


def build_model(problem: Problem) -> pin.Model:
    """Joints in the order of the bodies, a body frame for each, joint damping; springs are the engine's business."""
    model = pin.Model()
    model.gravity.linear = np.array(problem.gravity)
    joints = {WORLD: 0}
    for body in problem.bodies:
        placement = pin.SE3(np.array(body.turn), np.array(body.place))
        joint = model.addJoint(joints[body.parent], _joint(body), placement, f"{body.name} joint")
        joints[body.name] = joint
        inertia = pin.Inertia(body.mass, np.array(body.com), np.array(body.inertia))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addBodyFrame(body.name, joint, pin.SE3.Identity(), 0)
    # each body's numbers in v; set whole, since the model hands out a copy
    damping = np.zeros(model.nv)
    for body, (_, iv) in zip(problem.bodies, problem.slices().values()):
        damping[iv] = body.damping
    model.damping = damping
    return model
