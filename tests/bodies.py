"""Mechanisms that many tests stand on."""

from __future__ import annotations

import pinocchio as pin


def one_body(kind: pin.JointModel, inertia: pin.Inertia, name: str = "body", joint: str | None = None) -> pin.Model:
    """One body on a joint at the world's origin, and a frame of this name in the body's axes. joint: its name, if it is
    another one."""
    model = pin.Model()
    index = model.addJoint(0, kind, pin.SE3.Identity(), joint or name)
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    model.addBodyFrame(name, index, pin.SE3.Identity(), 0)
    return model
