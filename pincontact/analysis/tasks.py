"""Wanted accelerations as rows: of all joints, or of joints and frames by name, each with a weight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from ..arguments import reals
from ..errors import ArgumentError, StateError
from ..state import check_vector

Accelerations = npt.ArrayLike | Mapping[str, npt.ArrayLike] | None
Weights = npt.ArrayLike | Mapping[str, npt.ArrayLike] | None


@dataclass(frozen=True, eq=False)
class Tasks:
    """rows (r, nv) @ acceleration = wanted (r,), with weights (r,); rows and weights None: all coordinates, in the norm
    of the mass matrix."""

    rows: np.ndarray | None
    wanted: np.ndarray
    weights: np.ndarray | None


class TaskReader:
    """Reads tasks for the states of one model."""

    def __init__(self, model: pin.Model) -> None:
        self._model, self._data, self._rest = model, model.createData(), np.zeros(model.nv)

    def read(self, wanted: Accelerations, weights: Weights, q: np.ndarray, v: np.ndarray) -> Tasks:
        """Tasks at (q, v) from the arguments of `inverse_dynamics`.

        Raises ArgumentError for an unknown name or a weight that is negative, StateError for other sizes.
        """
        nv = self._model.nv
        if not isinstance(wanted, Mapping):
            goal = self._rest if wanted is None else check_vector("acceleration", wanted, nv)
            if weights is None:
                return Tasks(None, goal, None)
            if isinstance(weights, Mapping):
                raise ArgumentError(f"weights of a vector of accelerations must be one or {nv} numbers, not a mapping")
            return Tasks(np.eye(nv), goal, _weights("weights", weights, nv))
        if weights is not None and not isinstance(weights, Mapping):
            raise ArgumentError("weights of named accelerations must be a mapping from their names")
        for name in weights or {}:
            if name not in wanted:
                raise ArgumentError(f"weights: no acceleration of {name!r} is wanted")
        rows, goals, sizes, moved = [np.zeros((0, nv))], [np.zeros(0)], [np.zeros(0)], False
        for name, value in wanted.items():
            if not isinstance(name, str) or name == self._model.names[0]:
                raise ArgumentError(f"acceleration: the model has no joint or frame {name!r} that can move")
            if not self._model.existJointName(name) and not moved:
                pin.forwardKinematics(self._model, self._data, q, v, self._rest)
                pin.computeJointJacobians(self._model, self._data)
                moved = True
            part, goal = self._named(name, value)
            rows.append(part)
            goals.append(goal)
            sizes.append(_weights(f"weights[{name!r}]", 1.0 if weights is None else weights.get(name, 1.0), goal.size))
        return Tasks(np.vstack(rows), np.concatenate(goals), np.concatenate(sizes))

    def _named(self, name: str, value: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Rows and goals of a joint's coordinates, or of a frame: 3 numbers for its origin, 6 with its rotation."""
        model, data = self._model, self._data
        what = f"acceleration[{name!r}]"
        if model.existJointName(name):
            joint = model.joints[model.getJointId(name)]
            rows = np.zeros((joint.nv, model.nv))
            rows[:, joint.idx_v : joint.idx_v + joint.nv] = np.eye(joint.nv)
            return rows, check_vector(what, value, joint.nv)
        if not model.existFrame(name):
            raise ArgumentError(f"acceleration: the model has no joint or frame {name!r}")
        frame, axes = model.getFrameId(name), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        size = 6 if np.shape(value) == (6,) else 3
        goal = check_vector(what, value, size)
        pin.updateFramePlacement(model, data, frame)
        drift = pin.getFrameClassicalAcceleration(model, data, frame, axes).vector
        # Pinocchio gives a matrix of one column as a vector
        jacobian = pin.getFrameJacobian(model, data, frame, axes).reshape(6, model.nv)
        return jacobian[:size], goal - drift[:size]


def _weights(what: str, given: npt.ArrayLike, size: int) -> np.ndarray:
    """(size,) weights from one number or as many."""
    array = reals(f"{what} must be numbers", given)
    if array.shape not in ((), (size,)):
        raise StateError(f"{what} must be one number or {size}, got shape {array.shape}")
    if not (np.isfinite(array) & (array >= 0.0)).all():
        raise ArgumentError(f"{what} must be finite and not negative, got {given!r}")
    return np.broadcast_to(array, (size,))
