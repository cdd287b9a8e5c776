"""Contact forces for Pinocchio: as external forces on joints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..arguments import NOT_REAL, real_array
from ..contacts import Contact
from ..errors import ArgumentError, StateError
from .instant import Instant

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..scene import Scene
    from ..state import State


def joint_forces(
    model: pin.Model,
    data: pin.Data,
    contacts: Iterable[Contact],
    points: Mapping[str, np.ndarray],
    forces: Mapping[str, np.ndarray],
    torques: Mapping[str, np.ndarray],
) -> pin.StdVec_Force:
    """Forces on all joints, each in its joint's frame, from contact forces on second contours at world points and
    torques on these.

    data: with up to date placements of the joints (oMi).
    """
    out = pin.StdVec_Force()
    total = [pin.Force.Zero() for _ in range(model.njoints)]
    for contact in contacts:
        point, force, torque = points[contact.name], forces[contact.name], torques[contact.name]
        if not (np.any(force) or np.any(torque)):
            continue
        # about the world's origin
        wrench = pin.Force(force, np.cross(point, force) + torque)
        for joint, acting in ((contact.second.joint, wrench), (contact.first.joint, -wrench)):
            if joint > 0:
                total[joint] += data.oMi[joint].actInv(acting)
    out.extend(total)
    return out


def forces_of_locks(
    instant: Instant,
    a: np.ndarray,
    tau: np.ndarray,
    forces: Mapping[str, np.ndarray],
    torques: Mapping[str, np.ndarray],
) -> np.ndarray:
    """(locks,) in N and N m: what locked coordinates carry under torques and contact forces that make these
    accelerations (nv,)."""
    system, model = instant.system, instant.model
    if not system.locked:
        return np.zeros(0)
    outside = joint_forces(model, system.data, system.contacts, instant.points(), forces, torques)
    needed = pin.rnea(model, model.createData(), instant.q, instant.v, a, outside) - tau
    return np.asarray(needed[system.locked])


def external_forces(
    scene: Scene, state: State, tau: ArrayLike | None = None, *, forces: Mapping[str, ArrayLike] | None = None
) -> pin.StdVec_Force:
    """The contacts' forces at a state as Pinocchio's external forces.

    With them `pin.aba(model, data, q, v, tau - damping * v, fext)` gives the scene's accelerations (Pinocchio's own
    algorithms leave the model's joint damping out, and dry friction and limits of joints). Torques that resist spinning
    and rolling are among them, but not with given forces.

    Parameters
    ----------
    scene : Scene
    state : State
        A state of this scene.
    tau : (nv,) array_like, optional
        Joint torques that act in N and N m, zero if not given.
    forces : mapping of str to (3,) array_like, optional
        Forces of contacts in N on the second contour, world axes, instead of those of the motion at the state; contacts
        that are not named carry none.

    Returns
    -------
    pin.StdVec_Force
        One for each joint, in the joint's frame, in N and N m.

    Raises
    ------
    ArgumentError
        For a state of another scene or an unknown contact.
    StateError
        For a bad tau or force.
    SolverError, SingularContactError
        Where there are no forces.
    """
    instant = Instant(scene, state, tau, decide=forces is None)
    if forces is None:
        acting, torques = instant.forces(), instant.torques()
    else:
        torques = dict.fromkeys(scene.contacts, np.zeros(3))
        acting = torques | check_forces(scene, forces)
    system = instant.system
    return joint_forces(scene.model, system.data, system.contacts, instant.points(), acting, torques)


def check_forces(scene: Scene, forces: Mapping[str, ArrayLike]) -> dict[str, np.ndarray]:
    """Given contact forces as finite arrays (3,)."""
    if not isinstance(forces, Mapping):
        raise ArgumentError(f"forces must be a mapping from contacts to forces (3,), got {type(forces).__name__}")
    out = {}
    for name, force in forces.items():
        if name not in scene.contacts:
            raise ArgumentError(f"forces: unknown contact {name!r}; contacts: {', '.join(scene.contacts) or 'none'}")
        try:
            array = real_array(force)
        except NOT_REAL:
            array = np.zeros(0)
        if array.shape != (3,) or not np.isfinite(array).all():
            raise StateError(f"forces[{name!r}] must be 3 finite numbers in world axes, got {force!r}")
        out[name] = array
    return out
