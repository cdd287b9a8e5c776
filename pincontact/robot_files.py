"""Robots from MJCF and SDF files, as far as Pinocchio reads them; URDF is `Scene.from_urdf`."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from .errors import MissingExtraError, ModelError

# model, visual shapes, collision shapes
Robot = tuple[pin.Model, pin.GeometryModel | None, pin.GeometryModel | None]


def read_mjcf(file: str) -> Robot:
    """See `Scene.from_mjcf`."""
    gravity, closures = _mjcf_extras(file)
    try:
        model = pin.buildModelFromMJCF(file)
    except Exception as error:
        raise _unreadable(file, "an MJCF", error) from error
    if gravity is not None:
        # Pinocchio does not read it
        model.gravity.linear = gravity
    _warn_of_closures(file, closures)
    shapes: list[pin.GeometryModel | None] = []
    for kind in (pin.GeometryType.VISUAL, pin.GeometryType.COLLISION):
        try:
            shapes.append(pin.buildGeomFromMJCF(model, file, kind))
        except (ValueError, RuntimeError, IndexError):
            # a mesh that is missing does not matter to the motion
            shapes.append(None)
    return model, shapes[0], shapes[1]


def _mjcf_extras(file: str) -> tuple[np.ndarray | None, int]:
    """Gravity in m/s^2, where the file gives it, and the number of its loop closures."""
    _check_exists(file, "MJCF")
    try:
        root = ElementTree.parse(file).getroot()
    except (ElementTree.ParseError, OSError) as error:
        raise ModelError(f"{file} cannot be read as an MJCF: {error}") from error
    closures = sum(len(equality) for equality in root.iter("equality"))
    gravity = None
    for option in root.iter("option"):
        text = option.get("gravity")
        if text is None:
            continue
        try:
            gravity = np.array([float(part) for part in text.split()])
        except ValueError:
            gravity = np.zeros(0)
        if gravity.shape != (3,) or not np.isfinite(gravity).all():
            raise ModelError(f"{file}: option gravity must be 3 finite numbers, got {text!r}")
    return gravity, closures


def read_sdf(file: str, floating_base: bool, package_dirs: Sequence[str], root_link: str) -> Robot:
    """See `Scene.from_sdf`."""
    if not getattr(pin, "WITH_SDFORMAT", False):
        raise MissingExtraError(
            f"{file}: this build of Pinocchio ({pin.__version__}) reads no SDF (pinocchio.WITH_SDFORMAT is False); "
            "builds with SDFormat do, such as those of conda-forge"
        )
    _check_exists(file, "SDF")
    try:
        model, closures, collision, visual = pin.buildModelsFromSdf(
            file,
            package_dirs=list(package_dirs),
            root_joint=pin.JointModelFreeFlyer() if floating_base else None,
            root_link_name=root_link,
        )
    except Exception as error:
        raise _unreadable(file, "an SDF", error) from error
    _warn_of_closures(file, len(closures))
    return model, visual, collision


def _check_exists(file: str, kind: str) -> None:
    if not os.path.isfile(file):
        raise ModelError(f"{kind} file not found: {file}")


def _unreadable(file: str, kind: str, error: Exception) -> ModelError:
    # Pinocchio's messages name source files first and say what is wrong in the last line
    lines = [line for line in str(error).splitlines() if line.strip()]
    return ModelError(f"{file} cannot be read as {kind}: {lines[-1].strip() if lines else type(error).__name__}")


def _warn_of_closures(file: str, count: int) -> None:
    if count:
        warnings.warn(f"{file}: {count} equality constraints (loop closures) are left out", stacklevel=4)
