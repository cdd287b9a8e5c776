"""Small things that many tests need."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

import pincontact as pc


def one_body(kind: pin.JointModel, inertia: pin.Inertia, name: str = "body", joint: str | None = None) -> pin.Model:
    """One body on a joint at the world's origin, and a frame of this name in the body's axes. joint: its name, if it is
    another one."""
    model = pin.Model()
    index = model.addJoint(0, kind, pin.SE3.Identity(), joint or name)
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    model.addBodyFrame(name, index, pin.SE3.Identity(), 0)
    return model


def body_scene(
    kind: pin.JointModel, mass: float, moments: Sequence[float] = (1, 1, 1), gravity: Sequence[float] = (0, 0, -9.81)
) -> pc.Scene:
    """One body on one joint; frame "body" at its centre of mass. moments: principal ones, in kg m^2."""
    model = one_body(kind, pin.Inertia(mass, np.zeros(3), np.diag(moments)), joint="joint")
    model.gravity.linear = np.array(gravity)
    return pc.Scene(model)


def rotation(rng: np.random.Generator) -> np.ndarray:
    """A random rotation matrix."""
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return basis * np.sign(np.linalg.det(basis))


def kinds_of(base: type) -> set[str]:
    """Names of the public classes derived from a public one."""
    return {name for name in pc.__all__ if isinstance(kind := getattr(pc, name), type) and base in kind.__mro__[1:]}


def kinds(run: pc.Trajectory, *which: str) -> list[str]:
    """Kinds of the events of a run, or those of them that are asked for."""
    return [event.kind for event in run.events if not which or event.kind in which]
