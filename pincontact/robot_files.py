"""Robots from URDF, MJCF and SDF files. What changes their motion and cannot be read is refused, or named in a
warning."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree

import pinocchio as pin

from .errors import MissingExtraError, ModelError
from .mjcf.document import Document
from .mjcf.model import Builder, note_forces
from .mjcf.shapes import read_shapes


class Robot(NamedTuple):
    """What a file gives: a model, its shapes, and the collision shapes that could not be read, with the reasons."""

    model: pin.Model
    visual_model: pin.GeometryModel | None
    collision_model: pin.GeometryModel | None
    unread: tuple[str, ...] = ()


# ---------------------------------------------------------------------------------------------------- URDF


def read_urdf(file: str, floating_base: bool, package_dirs: str | Sequence[str] | None) -> Robot:
    """See `Scene.from_urdf`."""
    _check_exists(file, "URDF")
    try:
        model = (
            pin.buildModelFromUrdf(file, pin.JointModelFreeFlyer()) if floating_base else pin.buildModelFromUrdf(file)
        )
        root = ElementTree.parse(file).getroot()
    except Exception as error:
        raise _unreadable(file, "a URDF", error) from error
    mimics = [
        f"{joint.get('name')!r} (mimics {mimic.get('joint')!r})"
        for joint in root.findall("joint")
        for mimic in joint.findall("mimic")
    ]
    if mimics:
        warnings.warn(
            f"{file}: joints that mimic others move on their own here, as they have no dynamics in Pinocchio: "
            f"{', '.join(mimics)}; lock them, or let a control or a contact couple them",
            stacklevel=3,
        )
    folders = _folders(file, package_dirs)
    visual, undrawn = _urdf_shapes(model, root, "visual", folders)
    collision, unread = _urdf_shapes(model, root, "collision", folders)
    _warn_of_shapes(file, [*undrawn, *unread])
    return Robot(model, visual, collision, tuple(unread))


def _urdf_shapes(
    model: pin.Model, root: ElementTree.Element, tag: str, folders: list[str]
) -> tuple[pin.GeometryModel, list[str]]:
    """The shapes of a URDF of one kind, and those whose meshes cannot be read: they do not matter to the motion."""
    kind = pin.GeometryType.VISUAL if tag == "visual" else pin.GeometryType.COLLISION

    def build(owner: pin.Model, robot: ElementTree.Element) -> pin.GeometryModel:
        text = ElementTree.tostring(robot, encoding="unicode")
        return pin.buildGeomFromUrdfString(owner, text, kind, package_dirs=folders)

    try:
        return build(model, root), []
    except (ValueError, RuntimeError, IndexError):
        pass
    unread = []
    for link in root.iter("link"):
        for shape in link.findall(tag):
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            # Pinocchio alone knows where it looks for a file, and what it can read
            lone = ElementTree.Element("robot", name="r")
            ElementTree.SubElement(lone, "link", name="l").append(shape)
            try:
                build(pin.buildModelFromXML(ElementTree.tostring(lone, encoding="unicode")), lone)
            except (ValueError, RuntimeError, IndexError):
                link.remove(shape)
                unread.append(f"{tag} of link {link.get('name')!r} (mesh {mesh.get('filename')})")
    try:
        return build(model, root), unread
    except (ValueError, RuntimeError, IndexError) as error:
        return pin.GeometryModel(), [*unread, f"every {tag} ({_last_line(error)})"]


# ---------------------------------------------------------------------------------------------------- MJCF


def read_mjcf(file: str) -> Robot:
    """See `Scene.from_mjcf`."""
    _check_exists(file, "MJCF")
    document = Document(file)
    built = Builder(document)
    note_forces(document)
    visual, collision, undrawn, unread = read_shapes(document, built.bodies)
    summary = document.summary()
    if summary is not None:
        warnings.warn(summary, stacklevel=3)
    _warn_of_shapes(file, [*undrawn, *unread])
    return Robot(built.model, visual, collision, tuple(unread))


# ---------------------------------------------------------------------------------------------------- SDF


def read_sdf(file: str, floating_base: bool, package_dirs: str | Sequence[str] | None, root_link: str) -> Robot:
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
            package_dirs=_folders(file, package_dirs),
            root_joint=pin.JointModelFreeFlyer() if floating_base else None,
            root_link_name=root_link,
        )
    except Exception as error:
        raise _unreadable(file, "an SDF", error) from error
    if closures:
        warnings.warn(f"{file}: {len(closures)} loop closures are left out", stacklevel=3)
    return Robot(model, visual, collision)


# ---------------------------------------------------------------------------------------------------- all of them


def _folders(file: str, package_dirs: str | Sequence[str] | None) -> list[str]:
    """Where meshes are looked for: the file's own folder last."""
    given = [package_dirs] if isinstance(package_dirs, str) else list(package_dirs or [])
    return [*given, os.path.dirname(os.path.abspath(file))]


def _check_exists(file: str, kind: str) -> None:
    if not os.path.isfile(file):
        raise ModelError(f"{kind} file not found: {file}")


def _unreadable(file: str, kind: str, error: Exception) -> ModelError:
    return ModelError(f"{file} cannot be read as {kind}: {_last_line(error)}")


def _last_line(error: Exception) -> str:
    # Pinocchio's messages name source files first and say what is wrong in the last line
    lines = [line for line in str(error).splitlines() if line.strip()]
    return lines[-1].strip() if lines else type(error).__name__


def _warn_of_shapes(file: str, unread: Sequence[str]) -> None:
    if unread:
        warnings.warn(f"{file}: shapes that could not be read: {', '.join(dict.fromkeys(unread))}", stacklevel=4)
