"""Does a mechanism keep two contours in one plane? (patterns P-2C and 2C-2C)"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

if TYPE_CHECKING:
    from ..contacts import AttachedContour

# So many configurations, as far from the neutral one, at instants so far apart, in s.
_SAMPLES, _FAR, _LATER = 4, 0.7, 0.37
_TOLERANCE = 1e-9


def moves_in_plane(model: pin.Model, body1: AttachedContour, body2: AttachedContour) -> bool:
    """Whether contour 1 stays in the xy-plane of contour 2 in every configuration.

    Tested where it must hold: at a few configurations made from fixed pseudo-random velocities, the relative
    Jacobian has no motion out of the plane, and the planes coincide. Contours with a prescribed motion
    count as planar if their placement keeps to the plane at a few instants.
    """
    rng = np.random.default_rng(20)
    data = model.createData()
    for sample in range(_SAMPLES):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-_FAR, _FAR, model.nv))
        pin.computeJointJacobians(model, data, q)
        pose1, pose2 = (pose_of(data, body, _LATER * sample) for body in (body1, body2))
        normal = pose2.rotation[:, 2]
        apart = pose1.translation - pose2.translation
        allowed = _TOLERANCE * (1.0 + np.linalg.norm(apart))
        if abs(normal @ apart) > allowed:
            return False
        if body1.contour.dimension > 0 and abs(abs(normal @ pose1.rotation[:, 2]) - 1.0) > _TOLERANCE:
            return False
        jacobian = _jacobian(model, data, body1, pose1) - _jacobian(model, data, body2, pose1)
        if np.abs(normal @ jacobian[:3]).max(initial=0.0) > allowed:
            return False
        turning = jacobian[3:] - np.outer(normal, normal @ jacobian[3:])
        if body1.contour.dimension > 0 and np.abs(turning).max(initial=0.0) > _TOLERANCE:
            return False
        # body 2 may turn in space only if body 1 turns with it; its own plane is then carried along
        if body1.contour.dimension == 0:
            carried = _jacobian(model, data, body2, pose1)[3:]
            carried -= np.outer(normal, normal @ carried)
            if np.abs(carried).max(initial=0.0) > _TOLERANCE and body2.joint not in list(model.supports[body1.joint]):
                return False
    return True


def pose_of(data: pin.Data, body: AttachedContour, t: float) -> pin.SE3:
    """Placement of a contour in the world, of joints as in the data."""
    pose = data.oMi[body.joint] * body.placement_in_joint
    if body.motion is not None:
        pose = pose * body.motion.placement(t)
    return pose


def _jacobian(model: pin.Model, data: pin.Data, body: AttachedContour, at: pin.SE3) -> np.ndarray:
    """(6, nv): velocity of the body's point at `at`, and its angular velocity, world axes."""
    if body.joint == 0:
        return np.zeros((6, model.nv))
    jacobian = np.array(pin.getJointJacobian(model, data, body.joint, pin.ReferenceFrame.WORLD)).reshape(6, model.nv)
    jacobian[:3] += np.cross(jacobian[3:].T, at.translation).T
    return jacobian
