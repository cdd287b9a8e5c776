"""How efforts act on a model's velocity coordinates, and their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..arguments import reals
from ..errors import ArgumentError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False)
class Actuation:
    """matrix (nv, na): torques are matrix @ efforts. limited (k,): coordinates whose torques are limited; rows (k, na)
    of unit length and ends (k,) in N and N m: |rows @ efforts| <= ends."""

    matrix: np.ndarray
    limited: np.ndarray
    rows: np.ndarray
    ends: np.ndarray


def read_actuation(model: pin.Model, given: ArrayLike | Sequence[str] | None) -> Actuation:
    """The actuation that `actuation_matrix` reads, with the model's `effortLimit`."""
    matrix, limits = actuation_matrix(model, given), np.asarray(model.effortLimit)
    # the largest number is Pinocchio's default
    limited = np.flatnonzero((limits < np.finfo(float).max) & matrix.any(axis=1))
    lengths = np.linalg.norm(matrix[limited], axis=1)
    return Actuation(matrix, limited, matrix[limited] / lengths[:, None], limits[limited] / lengths)


def actuation_matrix(model: pin.Model, actuation: ArrayLike | Sequence[str] | None) -> np.ndarray:
    """(nv, na): how efforts act on the velocity coordinates; from a matrix, joint names or None (all joints but a
    free-flying root). Raises ArgumentError."""
    nv = model.nv
    if isinstance(actuation, str):
        actuation = [actuation]
    if actuation is None:
        start = 6 if model.njoints > 1 and model.joints[1].shortname() == "JointModelFreeFlyer" else 0
        return np.eye(nv)[:, start:]
    if isinstance(actuation, Sequence) and all(isinstance(name, str) for name in actuation):
        picked: list[int] = []
        for name in actuation:
            if not model.existJointName(name):
                raise ArgumentError(f"actuation: unknown joint {name!r}; joints: {', '.join(list(model.names)[1:])}")
            joint = model.joints[model.getJointId(name)]
            picked.extend(range(joint.idx_v, joint.idx_v + joint.nv))
        return np.eye(nv)[:, picked]
    matrix = reals(f"actuation must be a matrix ({nv}, na) or joint names", actuation)
    if matrix.ndim != 2 or matrix.shape[0] != nv or not np.isfinite(matrix).all():
        raise ArgumentError(f"actuation must be a finite matrix ({nv}, na) or joint names, got shape {matrix.shape}")
    return matrix
