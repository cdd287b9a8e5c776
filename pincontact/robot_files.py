"""Robots from URDF, MJCF and SDF files. What changes their motion and cannot be read is refused, or named in a
warning."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from .arguments import check_flag
from .errors import ArgumentError, MissingExtraError, ModelError, sentence

Folders = str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None

# What warnings are about.
_LEFT_OUT, _UNREAD = "left out, though it changes the motion", "shapes that could not be read"


class Robot(NamedTuple):
    """What a file gives: a model, its shapes, and the collision shapes that could not be read, with the reasons."""

    model: pin.Model
    visual_model: pin.GeometryModel | None
    collision_model: pin.GeometryModel | None
    unread: tuple[str, ...] = ()


# ---------------------------------------------------------------------------------------------------- URDF


# What is known of a URDF's elements: attributes, and elements within. Shapes and what is not of the robot's motion are
# not looked into.
_URDF = {
    "robot": ("name version", "link joint material transmission gazebo sensor ros2_control"),
    "link": (
        "name type",
        "inertial visual collision contact sensor self_collision_checking collision_checking self_filter",
    ),
    "joint": (
        "name type dont_collapse",
        "origin parent child axis limit dynamics mimic calibration safety_controller hardwareInterface",
    ),
    "inertial": ("", "origin mass inertia"),
    "origin": ("xyz rpy", ""),
    "mass": ("value", ""),
    "inertia": ("ixx ixy ixz iyy iyz izz", ""),
    "parent": ("link", ""),
    "child": ("link", ""),
    "axis": ("xyz", ""),
    "limit": ("lower upper effort velocity acceleration deceleration jerk", ""),
    "dynamics": ("damping friction", ""),
    "mimic": ("joint multiplier offset", ""),
}
# Of these there may be many, each with a name.
_MANY = ("link", "joint")


def read_urdf(file: str, floating_base: bool, package_dirs: Folders) -> Robot:
    """See `Scene.from_urdf`."""
    check_flag("floating_base", floating_base)
    folders = _folders(file, package_dirs)
    _check_exists(file, "URDF")
    try:
        root = ElementTree.parse(file).getroot()
    except (ElementTree.ParseError, OSError, ValueError) as error:
        raise _unreadable(file, "a URDF", error) from error
    remarks = _urdf_remarks(file, root)
    try:
        model = (
            pin.buildModelFromUrdf(file, pin.JointModelFreeFlyer()) if floating_base else pin.buildModelFromUrdf(file)
        )
    except Exception as error:
        raise _unreadable(file, "a URDF", error) from error
    visual, undrawn = _urdf_shapes(model, root, "visual", folders)
    collision, unread = _urdf_shapes(model, root, "collision", folders)
    _warn(file, {**remarks, _UNREAD: [*undrawn, *unread]})
    return Robot(model, visual, collision, tuple(unread))


def _urdf_remarks(file: str, root: ElementTree.Element) -> dict[str, list[str]]:
    """What to warn of. Raises ModelError for what Pinocchio would take, but not as it is meant."""
    if root.tag != "robot":
        raise ModelError(f"{file} cannot be read as a URDF: its first element is <{root.tag}>, not <robot>")
    odd, locked, mimics, left_out = [], [], [], []
    for link in root.findall("link"):
        name, inertial = repr(link.get("name")), link.find("inertial")
        if inertial is not None and not _can_be_of_a_body(f"{file}: link {name}", inertial):
            odd.append(name)
    for joint in root.findall("joint"):
        name, kind = repr(joint.get("name")), joint.get("type")
        axis, limit, dynamics = (joint.find(tag) for tag in ("axis", "limit", "dynamics"))
        direction = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
        if kind not in ("fixed", "floating") and not any(_floats(direction)):
            raise ModelError(f"{file}: joint {name}: its axis has no direction, got {direction!r}")
        if kind == "planar" and any(_floats(direction)[:2]):
            raise ModelError(
                f"{file}: joint {name}: its plane is normal to {direction!r} (1 0 0 where no axis is given), and "
                'Pinocchio takes z for all planar joints: write <axis xyz="0 0 1"/>, and turn the joint by its <origin>'
            )
        ends = limit is not None and bool({"lower", "upper"} & set(limit.attrib))
        if kind in ("floating", "planar"):
            # Pinocchio reads them for joints of one coordinate only
            given = {} if dynamics is None else dynamics.attrib
            left_out += [f"{key} of joint {name}" for key, value in given.items() if any(_floats(value))]
            left_out += [f"limits of joint {name}"] * ends
        elif kind in ("revolute", "prismatic") and limit is not None and not ends:
            locked.append(name)
        mimics += [f"{name} mimics {mimic.get('joint')!r}" for mimic in joint.findall("mimic")]
    unknown: dict[str, list[str]] = {}
    for what, owner in _unknown_in(root, "the robot"):
        unknown.setdefault(what, []).append(owner)
    return {
        "no body has the inertia of these links, of which a principal moment is negative": odd,
        "these joints cannot move, as their limits are 0 where neither lower nor upper is given": locked,
        "these joints move on their own here, as there are no dynamics of mimics in Pinocchio": mimics,
        _LEFT_OUT: left_out,
        "not known here, and left out": [
            f"{what} of {of[0]}{f' and {len(of) - 1} more' if of[1:] else ''}" for what, of in unknown.items()
        ],
    }


def _can_be_of_a_body(owner: str, inertial: ElementTree.Element) -> bool:
    """Whether its principal moments are not negative; raises ModelError for what the parser would replace by zeros."""
    values: dict[str, float] = {}
    for tag in ("mass", "inertia"):
        element = inertial.find(tag)
        for name in _URDF[tag][0].split():
            text = None if element is None else element.get(name)
            number = _floats(text or "")
            if len(number) != 1 or not math.isfinite(number[0]):
                raise ModelError(f"{owner}: {name} of its {tag} must be a finite number, got {text!r}")
            values[name] = number[0]
    if values["value"] < 0.0:
        raise ModelError(f"{owner}: its mass must not be negative, got {values['value']}")
    xx, xy, xz, yy, yz, zz = (values[name] for name in _URDF["inertia"][0].split())
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    # rounding of what is written with six digits, and a micrometre
    return bool(moments[0] >= -1e-6 * abs(moments[2]) - 1e-12 * values["value"])


def _unknown_in(element: ElementTree.Element, owner: str) -> Iterator[tuple[str, str]]:
    """What is not in the list, or there once more than it is read, and whose it is."""
    attributes, children = (known.split() for known in _URDF[element.tag])
    for name in element.attrib:
        if name not in attributes and not name.startswith("{"):
            yield (name if element.tag in _MANY else f"{name} of <{element.tag}>"), owner
    seen: set[str] = set()
    for child in element:
        if not isinstance(child.tag, str) or child.tag.startswith("{"):
            continue
        if child.tag not in children:
            yield f"<{child.tag}>", owner
        elif child.tag in _URDF:
            if child.tag in seen and child.tag not in _MANY:
                yield f"a second <{child.tag}>", owner
            seen.add(child.tag)
            yield from _unknown_in(child, f"{child.tag} {child.get('name')!r}" if child.tag in _MANY else owner)


def _floats(text: str) -> list[float]:
    """The numbers in a text; none where some part is none."""
    try:
        return [float(part) for part in text.split()]
    except ValueError:
        return []


def _urdf_shapes(
    model: pin.Model, root: ElementTree.Element, tag: str, folders: list[str]
) -> tuple[pin.GeometryModel, list[str]]:
    """The shapes of a URDF of one kind, and those that cannot be read: they do not matter to the motion.

    What is not read is taken out of the file's elements: behind it the parser finds no more shapes of the link.
    """
    kind = pin.GeometryType.VISUAL if tag == "visual" else pin.GeometryType.COLLISION

    def build(owner: pin.Model, robot: ElementTree.Element) -> pin.GeometryModel:
        text = ElementTree.tostring(robot, encoding="unicode")
        return pin.buildGeomFromUrdfString(owner, text, kind, package_dirs=folders)

    try:
        shapes = build(model, root)
        if shapes.ngeoms == len(root.findall(f"link/{tag}")):
            return shapes, []
    except (ValueError, RuntimeError, IndexError):
        pass
    unread = []
    for link in root.findall("link"):
        for shape in link.findall(tag):
            # Pinocchio alone knows where it looks for a file, and what it can read
            lone = ElementTree.Element("robot", root.attrib)
            ElementTree.SubElement(lone, "link", name="l").append(shape)
            try:
                if build(pin.buildModelFromXML(ElementTree.tostring(lone, encoding="unicode")), lone).ngeoms:
                    continue
            except (ValueError, RuntimeError, IndexError):
                pass
            link.remove(shape)
            mesh, kinds = shape.find("geometry/mesh"), [f"<{kind.tag}>" for kind in shape.findall("geometry/*")]
            what = " ".join(kinds) or "no geometry" if mesh is None else f"mesh {mesh.get('filename')}"
            unread.append(f"{tag} of link {link.get('name')!r} ({what})")
    try:
        return build(model, root), unread
    except (ValueError, RuntimeError, IndexError) as error:
        return pin.GeometryModel(), [*unread, f"every {tag} ({_last_line(error)})"]


# ---------------------------------------------------------------------------------------------------- MJCF


def read_mjcf(file: str) -> Robot:
    """See `Scene.from_mjcf`."""
    _check_exists(file, "MJCF")
    try:
        from . import mjcf
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f'{file}: MJCF files are read by MuJoCo\'s compiler, which needs: pip install "pincontact[mjcf]"'
        ) from error
    model, (visual, collision), left_out, (undrawn, unread) = mjcf.read(file)
    effects = [f"{effect} ({', '.join(owners)})" for effect, owners in left_out.items()]
    _warn(file, {_LEFT_OUT: effects, _UNREAD: [*undrawn, *unread]})
    return Robot(model, visual, collision, tuple(unread))


# ---------------------------------------------------------------------------------------------------- SDF


def read_sdf(file: str, floating_base: bool, package_dirs: Folders, root_link: str) -> Robot:
    """See `Scene.from_sdf`."""
    check_flag("floating_base", floating_base)
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
    _warn(file, {_LEFT_OUT: [f"{len(closures)} loop closures"] if closures else []})
    return Robot(model, visual, collision)


# ---------------------------------------------------------------------------------------------------- all of them


def _folders(file: str, package_dirs: Folders) -> list[str]:
    """Where meshes are looked for: the file's own folder last."""
    given = [package_dirs] if isinstance(package_dirs, (str, os.PathLike)) else package_dirs or ()
    try:
        folders = [os.fspath(folder) for folder in given]
    except TypeError:
        raise ArgumentError(f"package_dirs must be one folder or several, got {package_dirs!r}") from None
    return [*folders, os.path.dirname(os.path.abspath(file))]


def _check_exists(file: str, kind: str) -> None:
    if not os.path.isfile(file):
        raise ModelError(f"{kind} file not found: {file}")


def _unreadable(file: str, kind: str, error: Exception) -> ModelError:
    return ModelError(f"{file} cannot be read as {kind}: {_last_line(error)}")


def _last_line(error: Exception) -> str:
    # Pinocchio's messages name source files first and say what is wrong in the last line
    lines = [line for line in str(error).splitlines() if line.strip()]
    return lines[-1].strip() if lines else type(error).__name__


def _warn(file: str, found: Mapping[str, Sequence[str]]) -> None:
    """One warning of a file, as by its reader's caller: remarks, each with what it is about."""
    remarks = [f"{remark}: {', '.join(dict.fromkeys(of))}" for remark, of in found.items() if of]
    if remarks:
        warnings.warn(sentence(f"{file}: {'; '.join(remarks)}"), stacklevel=4)
