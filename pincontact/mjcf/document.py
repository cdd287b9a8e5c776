"""What an MJCF file says: inclusions and default classes resolved, every attribute known by name.

Elements and attributes are looked up in lists of what this package reads, of what makes forces that it leaves out, and
of what does not bear on the motion of rigid bodies. What is in none of these lists is reported, not passed over.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..errors import ModelError

Attributes = dict[str, str]

# At most one of these may be given.
ORIENTATIONS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
_POSE = ("pos", *ORIENTATIONS)
_SOLVER = ("solref", "solimp", "margin", "gap")
_OF_LIMITS = ("solreflimit", "solimplimit", "solreffriction", "solimpfriction", "margin")
_ACTUATORS = (
    *("actuator", "general", "motor", "position", "velocity", "intvelocity", "orientation", "pid", "damper"),
    *("cylinder", "muscle", "adhesion", "dcmotor", "plugin"),
)
# Elements whose defaults are given under another name.
_SHARED = dict.fromkeys(_ACTUATORS, "actuator") | dict.fromkeys(("spatial", "fixed"), "tendon")

# Of each element that is read, the attributes that are read, then those that are known not to matter here.
_KNOWN: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "compiler": (
        (
            *("angle", "autolimits", "balanceinertia", "boundinertia", "boundmass", "coordinate", "eulerseq"),
            *("inertiafromgeom", "inertiagrouprange", "settotalmass", "assetdir", "meshdir", "strippath", "alignfree"),
        ),
        (
            *("texturedir", "discardvisual", "fusestatic", "fitaabb", "usethread", "saveinertial", "conflict"),
            *("convexhull", "exactmeshinertia", "passthrough", "savecanonical", "savecompiled"),
        ),
    ),
    "option": (
        ("gravity", "density", "viscosity"),
        (
            *("timestep", "apirate", "impratio", "wind", "magnetic", "integrator", "cone", "jacobian", "solver"),
            *("iterations", "tolerance", "ls_iterations", "ls_tolerance", "noslip_iterations", "noslip_tolerance"),
            *("ccd_iterations", "ccd_tolerance", "mpr_iterations", "mpr_tolerance", "sdf_iterations", "collision"),
            *("sdf_initpoints", "sleep_tolerance", "actuatorgroupdisable"),
            *("o_margin", "o_solref", "o_solimp", "o_friction"),
        ),
    ),
    "flag": (
        ("constraint", "equality", "frictionloss", "limit", "spring", "damper", "passive", "gravity"),
        (
            *("contact", "clampctrl", "warmstart", "filterparent", "actuation", "refsafe", "sensor", "midphase"),
            *("eulerdamp", "autoreset", "nativeccd", "island", "multiccd", "override", "energy", "fwdinv"),
            *("invdiscrete", "sleep", "diagexact", "ipc", "speculative"),
        ),
    ),
    "body": (("name", "childclass", *_POSE, "gravcomp"), ("user", "mocap", "sleep", "simple", "fuse")),
    "frame": (("childclass", *_POSE), ("name",)),
    "inertial": (("mass", "diaginertia", "fullinertia", *_POSE), ()),
    "joint": (
        (
            *("name", "class", "type", "pos", "axis", "range", "limited", "ref", "damping", "armature"),
            *("frictionloss", "stiffness", "springdamper", "actuatorfrcrange", "actuatorfrclimited"),
        ),
        ("group", "user", "springref", "springyield", "actuatorgravcomp", *_OF_LIMITS),
    ),
    "freejoint": (("name", "align"), ("group",)),
    "geom": (
        (
            *("name", "class", "type", "size", *_POSE, "fromto", "mass", "density", "shellinertia", "mesh"),
            *("group", "contype", "conaffinity", "rgba", "material"),
        ),
        (
            *("condim", "priority", "friction", "solmix", *_SOLVER, "hfield", "fitscale", "fluidshape", "fluidcoef"),
            *("user", "adhesion", "castshadow", "surfacevel"),
        ),
    ),
    "site": (("name", "class", *_POSE, "fromto"), ("type", "size", "group", "material", "mesh", "rgba", "user")),
    "tendon": (
        ("name", "class", "range", "limited", "stiffness", "damping", "frictionloss", "armature"),
        (
            *("group", "user", "springlength", "springyield", "width", "material", "rgba", *_OF_LIMITS),
            *("actuatorfrcrange", "actuatorfrclimited"),
        ),
    ),
    "mesh": (
        ("name", "class", "file", "scale", "refpos", "refquat"),
        (
            *("vertex", "normal", "texcoord", "face", "content_type", "inertia", "maxhullvert", "smoothnormal"),
            *("material", "builtin", "params", "octree_maxdepth"),
        ),
    ),
    "worldbody": ((), ()),
}
# Elements within those that are read whole.
_CHILDREN: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("joint", "freejoint", "inertial", "site", "flag"), ()),
    "geom": ("plugin",),
    "compiler": ("lengthrange",),
    "option": ("flag",),
}
_WITHOUT_DEFAULTS = ("freejoint", "inertial", "worldbody", "body", "frame", "key")
# Parts of the file that do not bear on the motion.
_SECTIONS_READ = ("compiler", "option", "default", "worldbody", "asset", "keyframe", "equality", "tendon", "actuator")
_SECTIONS_IGNORED = ("size", "visual", "statistic", "custom", "contact", "sensor", "extension")
_DEFAULTS_IGNORED = ("camera", "light", "texture", "pair", "skin")


class Element:
    """One element of the file with the attributes of its default class, and typed access to them.

    what: its kind and name, for messages.
    """

    def __init__(self, document: Document, tag: str, attributes: Attributes, what: str) -> None:
        self.document, self.tag, self.attributes, self.what = document, tag, attributes, what

    def error(self, text: str) -> ModelError:
        return ModelError(f"{self.document.file}: {self.what}: {text}")

    def has(self, name: str) -> bool:
        return name in self.attributes

    def text(self, name: str, default: str = "") -> str:
        return self.attributes.get(name, default)

    def choice(self, name: str, allowed: tuple[str, ...], default: str) -> str:
        value = self.text(name, default)
        if value not in allowed:
            raise self.error(f"{name} must be one of {', '.join(allowed)}, got {value!r}")
        return value

    def flag(self, name: str, default: bool = False) -> bool:
        return self.choice(name, ("true", "false"), "true" if default else "false") == "true"

    def numbers(self, name: str, least: int, most: int, default: Iterable[float] = ()) -> np.ndarray:
        """Between least and most finite numbers, or the default."""
        if name not in self.attributes:
            return np.array(list(default), dtype=float)
        given = self.attributes[name]
        try:
            values = np.array([float(part) for part in given.split()])
        except ValueError:
            values = np.full(0, math.nan)
        if not least <= values.size <= most or not np.isfinite(values).all():
            count = f"{least}" if least == most else f"{least} to {most}"
            what = "a finite number" if most == 1 else f"{count} finite numbers"
            raise self.error(f"{name} must be {what}, got {given!r}")
        return values

    def number(self, name: str, default: float = 0.0) -> float:
        return float(self.numbers(name, 1, 1, (default,))[0])

    def not_negative(self, name: str, default: float = 0.0) -> float:
        value = self.number(name, default)
        if value < 0.0:
            raise self.error(f"{name} must not be negative, got {value}")
        return value

    def placement(self) -> pin.SE3:
        """The pose that `pos` and an orientation give in the frame of the parent."""
        return pin.SE3(self.rotation(), self.numbers("pos", 3, 3, (0.0, 0.0, 0.0)))

    def rotation(self) -> np.ndarray:
        given = [name for name in ORIENTATIONS if name in self.attributes]
        if len(given) > 1:
            raise self.error(f"its orientation is given by {given[0]} and by {given[1]}")
        if not given:
            return np.eye(3)
        name = given[0]
        if name == "quat":
            return pin.Quaternion(*self._direction(name, self.numbers(name, 4, 4))).matrix()
        to_radians = self.document.angle
        if name == "axisangle":
            values = self.numbers(name, 4, 4)
            return turned(self._direction(name, values[:3]), to_radians * values[3])
        if name == "euler":
            result = np.eye(3)
            for letter, angle in zip(self.document.eulerseq, to_radians * self.numbers(name, 3, 3)):
                turn = turned(np.eye(3)["xyz".index(letter.lower())], angle)
                # lower case: about axes that turn along; upper case: about those of the parent
                result = result @ turn if letter.islower() else turn @ result
            return result
        if name == "zaxis":
            return z_turned_to(self._direction(name, self.numbers(name, 3, 3)))
        values = self.numbers(name, 6, 6)
        x = self._direction(name, values[:3])
        y = self._direction(name, values[3:] - x * (x @ values[3:]))
        return np.column_stack([x, y, np.cross(x, y)])

    def _direction(self, name: str, vector: np.ndarray) -> np.ndarray:
        return unit(self, name, vector)


def unit(element: Element, name: str, vector: np.ndarray) -> np.ndarray:
    """The vector at length 1, or a ModelError for one that is too short."""
    length = float(np.linalg.norm(vector))
    if length < 1e-14:
        raise element.error(f"{name} has no direction, got {element.text(name)!r}")
    return vector / length


def turned(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation (3, 3) about a unit axis."""
    return pin.AngleAxis(float(angle), np.asarray(axis, dtype=float)).matrix()


def z_turned_to(direction: np.ndarray) -> np.ndarray:
    """The shortest rotation (3, 3) that takes the z axis to a unit vector; about x where that is -z."""
    axis = np.array([-direction[1], direction[0], 0.0])
    sine = float(np.linalg.norm(axis))
    return turned(axis / sine if sine > 1e-14 else np.array([1.0, 0.0, 0.0]), math.atan2(sine, direction[2]))


class Document:
    """An MJCF file with its inclusions, settings and default classes.

    What has an effect on the motion and cannot be part of a model is noted by `leave_out`; `summary` tells it.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        # effect -> whose; the order is that of the file
        self._left_out: dict[str, dict[str, None]] = {}
        self._unknown: dict[str, None] = {}
        root = _parse(file, file)
        if root.tag != "mujoco":
            raise ModelError(f"{file} cannot be read as an MJCF: its first element is <{root.tag}>, not <mujoco>")
        self._include(root, Path(file).resolve().parent, [os.path.realpath(file)])
        self.root = root
        self.angle, self.eulerseq = 1.0, "xyz"
        # element -> its default attributes, of each class
        self._classes: dict[str, dict[str, Attributes]] = {"main": {}}
        for section in root:
            if section.tag == "default":
                self._read_default(section, None)
        self.compiler = self._settings("compiler")
        self._read_compiler()
        self.option = self._settings("option")
        self.flags = self._settings("flag", "option/flag")
        for section in root:
            if section.tag not in (*_SECTIONS_READ, *_SECTIONS_IGNORED, "deformable"):
                self._unknown[f"<{section.tag}>"] = None
        for flex in root.iterfind("deformable/flex"):
            raise ModelError(f"{file}: <flex> {flex.get('name')!r} is no rigid body, and cannot be read")

    # ------------------------------------------------------------------------------------------------ elements

    def element(
        self, node: ElementTree.Element, owner: str = "", childclass: str | None = None, kind: str | None = None
    ) -> Element:
        """An element with its defaults.

        owner: what it belongs to, for the message of one without a name. kind: under which its defaults are kept, if
        not under its tag.
        """
        kind = node.tag if kind is None else kind
        name = node.get("name")
        article = "an" if node.tag[0] in "aeiou" else "a"
        what = f"{node.tag} {name!r}" if name is not None else f"{article} {node.tag}{owner and f' of {owner!r}'}"
        attributes = dict(node.attrib)
        if kind not in _WITHOUT_DEFAULTS:
            chosen = attributes.get("class", childclass or "main")
            self.check_class(chosen, what)
            attributes = _merged(self._classes[chosen].get(kind, {}), attributes)
        self._note_unknown(kind, node)
        return Element(self, node.tag, attributes, what)

    def sections(self, path: str) -> Iterator[ElementTree.Element]:
        """The elements below all sections of a kind."""
        return (node for section in self.root.iterfind(path) for node in section)

    def check_class(self, name: str, what: str) -> None:
        if name not in self._classes:
            raise ModelError(f"{self.file}: {what}: there is no default class {name!r}")

    def off(self, flag: str) -> bool:
        """Whether the file disables a kind of force."""
        return self.flags.choice(flag, ("enable", "disable"), "enable") == "disable"

    def summary(self) -> str | None:
        """What to warn of, in one sentence or two; None for nothing."""
        parts = []
        if self._left_out:
            effects = (f"{effect} ({', '.join(owners)})" for effect, owners in self._left_out.items())
            parts.append(f"left out, though it changes the motion: {'; '.join(effects)}")
        if self._unknown:
            parts.append(f"not known here, and left out: {', '.join(self._unknown)}")
        return f"{self.file}: {'; '.join(parts)}" if parts else None

    def leave_out(self, effect: str, owner: str) -> None:
        self._left_out.setdefault(effect, {})[owner] = None

    def _note_unknown(self, kind: str, node: ElementTree.Element) -> None:
        """Note attributes and elements within an element that are not in the lists."""
        for name in node.attrib if kind in _KNOWN else ():
            if not any(name in names for names in _KNOWN[kind]):
                self._unknown[f"{name} of <{node.tag}>"] = None
        for child in node if kind in _CHILDREN else ():
            if child.tag not in _CHILDREN[kind]:
                self._unknown[f"<{child.tag}> of <{node.tag}>"] = None

    # ------------------------------------------------------------------------------------------------ settings

    def _settings(self, tag: str, path: str | None = None) -> Element:
        """All elements of a kind as one; later ones win."""
        attributes: Attributes = {}
        for node in self.root.iterfind(path or tag):
            self._note_unknown(tag, node)
            attributes.update(node.attrib)
        return Element(self, tag, attributes, tag)

    def _read_compiler(self) -> None:
        compiler = self.compiler
        if compiler.choice("angle", ("degree", "radian"), "degree") == "degree":
            self.angle = math.pi / 180.0
        self.eulerseq = compiler.text("eulerseq", "xyz")
        if len(self.eulerseq) != 3 or not set(self.eulerseq) <= set("xyzXYZ"):
            raise compiler.error(f"eulerseq must be three letters of xyzXYZ, got {self.eulerseq!r}")
        # files that use global ones are of versions of MuJoCo before 2.3.4
        compiler.choice("coordinate", ("local",), "local")

    def _read_default(self, node: ElementTree.Element, parent: str | None) -> None:
        name = node.get("class") or ("main" if parent is None else "")
        if not name or (parent is not None and name in self._classes):
            raise ModelError(f"{self.file}: a default class within {parent!r} needs a name of its own, got {name!r}")
        if parent is None:
            # only MuJoCo's own name for it is allowed; older files used others
            name = "main"
        else:
            self._classes[name] = dict(self._classes[parent])
        known = self._classes[name]
        for child in node:
            if child.tag in (*_KNOWN, *_SHARED, "equality", "material"):
                tag = _SHARED.get(child.tag, child.tag)
                self._note_unknown(tag, child)
                known[tag] = _merged(known.get(tag, {}), child.attrib)
            elif child.tag not in ("default", *_DEFAULTS_IGNORED):
                self._unknown[f"<{child.tag}> in default class {name!r}"] = None
        for child in node.iterfind("default"):
            self._read_default(child, name)
        if parent is None and node.get("class"):
            # elements may ask for the first class by the name it has in the file
            self._classes[str(node.get("class"))] = known

    # ------------------------------------------------------------------------------------------------ inclusions

    def _include(self, root: ElementTree.Element, folder: Path, open_files: list[str]) -> None:
        """Replace <include> elements by what is in their files, whose paths start at the main file's folder."""
        for parent in [node for node in root.iter() if node.find("include") is not None]:
            children: list[ElementTree.Element] = []
            for child in parent:
                children.extend(self._included(child, folder, open_files) if child.tag == "include" else [child])
            parent[:] = children

    def _included(
        self, node: ElementTree.Element, folder: Path, open_files: list[str]
    ) -> Iterable[ElementTree.Element]:
        path = folder / node.get("file", "")
        if not path.is_file():
            raise ModelError(f"{self.file}: the file that it includes was not found: {path}")
        real = os.path.realpath(path)
        if real in open_files:
            raise ModelError(f"{self.file}: {path} includes itself")
        inner = _parse(str(path), self.file)
        self._include(inner, folder, [*open_files, real])
        return inner


def _parse(path: str, file: str) -> ElementTree.Element:
    try:
        return ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, OSError, ValueError) as error:
        where = "" if path == file else f" ({path})"
        raise ModelError(f"{file} cannot be read as an MJCF{where}: {error}") from error


def _merged(defaults: Attributes, own: Attributes) -> Attributes:
    """Own attributes over defaults, whose orientation is dropped where there is another."""
    kept = defaults
    if any(name in own for name in ORIENTATIONS):
        kept = {name: value for name, value in defaults.items() if name not in ORIENTATIONS}
    return {**kept, **own}
