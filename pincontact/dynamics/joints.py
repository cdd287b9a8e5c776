"""Joint limits, locks and dry joint friction, as the model states them.

A coordinate that has limits or dry friction is an item beside the contacts. It moves, under a dry friction that opposes
it, or it is held: by friction, whose force is then anything in its range, or by a limit, which bounds the force on one
side only. A held coordinate is one constraint row, as a contact's normal is. Effort and velocity limits are not
enforced.

A coordinate whose limits coincide is locked: q = value, v = 0, with whatever force that takes. That is an equation
which nothing ends, and which leaves the force out of all others. So the coordinate is left out of the equations of
motion, which are those of the mechanism with this joint welded, see `System`.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..errors import ModelError, StateError
from .manifold import VECTOR, configuration_blocks

# A coordinate beyond its end by no more than this (rad or m) is at it.
END_SLACK = 1e-9


@dataclass(frozen=True)
class JointLimit:
    """A coordinate with a limit or dry friction: joint name, indices in q and v, range of the dry friction force in N
    or N m (low <= 0 <= high), range of q (infinite without a limit; always so where the configuration is no vector)."""

    joint: str
    index_q: int
    index_v: int
    low_force: float
    high_force: float
    low_end: float
    high_end: float

    @property
    def dry(self) -> bool:
        """Whether there is dry friction."""
        return self.low_force < self.high_force


@dataclass(frozen=True)
class JointLock:
    """A coordinate that is locked: joint name, indices in q and v, its value in rad or m."""

    joint: str
    index_q: int
    index_v: int
    value: float


def joint_locks(model: pin.Model) -> list[JointLock]:
    """The coordinates of a model whose limits coincide, of joints whose configuration is a vector."""
    values = model.lowerPositionLimit
    if not (same := values == model.upperPositionLimit).any():
        return []
    return [
        JointLock(joint_of(model, iv + k), iq + k, iv + k, float(values[iq + k]))
        for kind, iq, iv, n in configuration_blocks(model)
        for k in range(n)
        if kind == VECTOR and same[iq + k] and math.isfinite(values[iq + k])
    ]


def check_locks(locks: Sequence[JointLock], q: np.ndarray) -> None:
    """Raises StateError for a locked coordinate that is not where it is locked, with the numbers."""
    for lock in locks:
        if not abs(q[lock.index_q] - lock.value) <= END_SLACK:
            raise StateError(
                f"joint {lock.joint!r}: q[{lock.index_q}] = {q[lock.index_q]:.9g}, but both its position limits are "
                f"{lock.value:.9g}, where it is locked; start there, or set the model's limits to infinity"
            )


def joint_limits(model: pin.Model) -> list[JointLimit]:
    """The coordinates of a model that have limits (`lowerPositionLimit`, `upperPositionLimit`, of joints whose
    configuration is a vector) or dry friction (`lowerDryFrictionLimit`, `upperDryFrictionLimit`), but for locked ones.

    Raises ModelError for a range that is empty, or a friction that does not oppose motion; warns of one that opposes it
    in one direction only.
    """
    limits = []
    unbounded = np.finfo(float).max
    low_forces, high_forces = model.lowerDryFrictionLimit.tolist(), model.upperDryFrictionLimit.tolist()
    low_ends, high_ends = model.lowerPositionLimit.tolist(), model.upperPositionLimit.tolist()
    for kind, iq, iv, n in configuration_blocks(model):
        for k in range(n):
            low_force, high_force = low_forces[iv + k], high_forces[iv + k]
            low_end, high_end = -math.inf, math.inf
            if kind == VECTOR:
                low_end = low_ends[iq + k] if low_ends[iq + k] > -unbounded else -math.inf
                high_end = high_ends[iq + k] if high_ends[iq + k] < unbounded else math.inf
            if low_force == high_force == 0.0 and low_end == -math.inf and high_end == math.inf:
                continue
            joint = joint_of(model, iv + k)
            if not low_force <= 0.0 <= high_force:
                raise ModelError(f"joint {joint!r}: dry friction from {low_force} to {high_force} does not contain 0")
            if (low_force == 0.0) != (high_force == 0.0):
                warnings.warn(
                    f"joint {joint!r}: dry friction from {low_force + 0.0:g} to {high_force:g} acts one way only; "
                    "set both lowerDryFrictionLimit and upperDryFrictionLimit (model.friction is the latter alone).",
                    stacklevel=2,
                )
            if not low_end <= high_end:
                raise ModelError(f"joint {joint!r}: the position limits {low_end} to {high_end} are an empty range")
            if low_end < high_end:
                limits.append(JointLimit(joint, iq + k, iv + k, low_force, high_force, low_end, high_end))
    return limits


def check_joint_limits(limits: list[JointLimit], q: np.ndarray) -> None:
    """Raises StateError for a coordinate beyond its limits, with the number."""
    for limit in limits:
        value = q[limit.index_q]
        if value < limit.low_end - END_SLACK or value > limit.high_end + END_SLACK:
            raise StateError(
                f"joint {limit.joint!r}: q[{limit.index_q}] = {value:.9g} is beyond the position limits "
                f"[{limit.low_end:.9g}, {limit.high_end:.9g}]; start within them, or set the model's limits to infinity"
            )


def without_inertia(model: pin.Model, data: pin.Data, q: np.ndarray) -> str:
    """Why the mass matrix is not positive at q, for a message: the joint that moves most in the motion of least
    inertia."""
    mass = pin.crba(model, data, q, pin.Convention.WORLD)
    moments, motions = np.linalg.eigh(np.triu(mass) + np.triu(mass, 1).T)
    joint = joint_of(model, int(np.abs(motions[:, 0]).argmax()))
    return (
        f"the mass matrix is not positive definite in this configuration: joint {joint!r} moves nothing that has "
        f"inertia (least eigenvalue {moments[0]:.3g}); give its body some, or its motor (model.armature)"
    )


def check_model(model: pin.Model) -> None:
    """ModelError for joints that mimic others or were not added depth first, and for a second frame "universe"."""
    mimics = [name for name, joint in zip(model.names, model.joints) if "Mimic" in joint.shortname()]
    if mimics:
        raise ModelError(
            f"joints that mimic others have no dynamics in Pinocchio: {', '.join(mimics)}; lock them or "
            "let them be joints of their own"
        )
    interrupted = interrupted_joint(model)
    if interrupted is not None:
        joint, parent, between = interrupted
        raise ModelError(
            f"joint {joint!r}, below {parent!r}, was added after {between!r}, which is not: Pinocchio's mass "
            f"matrix is wrong for such an order; add all joints below {parent!r} directly after it (depth first)"
        )
    if any(frame.name == "universe" for frame in list(model.frames)[1:]) or "universe" in list(model.names)[1:]:
        raise ModelError("the model has a joint or frame named 'universe', which is the name of the world")


def interrupted_joint(model: pin.Model) -> tuple[str, str, str] | None:
    """A joint, one that it is below, and one between them in the model's order that is not: Pinocchio's algorithms take
    the joints below another for those that follow it. None where no order is broken."""
    for subtree in list(model.subtrees)[1:]:
        joints = subtree.tolist()
        for before, joint in itertools.pairwise(joints):
            if joint != before + 1:
                return str(model.names[joint]), str(model.names[joints[0]]), str(model.names[before + 1])
    return None


def joint_of(model: pin.Model, index_v: int) -> str:
    """Name of the joint of a velocity coordinate."""
    for j in range(1, model.njoints):
        start = model.joints[j].idx_v
        if start <= index_v < start + model.joints[j].nv:
            return str(model.names[j])
    raise ModelError(f"velocity coordinate {index_v} belongs to no joint")
