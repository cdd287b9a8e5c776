"""Scene files: a robot, its contours and contacts, where it starts and how to run it, in TOML or YAML.

The tables of a file are those of the Python interface, with its names, units and defaults:

    urdf, package_dirs, floating_base, gravity      the model; paths are relative to the file. Instead of urdf: mjcf or
                                                    sdf, as Scene.from_mjcf and Scene.from_sdf read them
    [constants]                                     names for formulas, such as R = 0.3
    [collision]                                     Scene.add_contours_from_collision: links, kinds
    [contours.<name>]                               kind and its parameters, frame, xyz, rpy or quaternion, motion
    [contacts."<name>"]                             between = [first, second], friction, bilateral, pattern, location,
                                                    side, restitution
    [initial]                                       q, v, t, free, max_gap
    [simulation]                                    duration, outputs and the options of `simulate`

Wherever a number is expected, a text is a formula of constants: rpy = ["pi / 2", 0, 0]. Numbers are finite, but for
ends of intervals and max_step. In YAML, too, a key stands once and is a text, and numbers are decimal (YAML 1.2).
"""

from __future__ import annotations

import inspect
import math
import os
import sys
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from .arguments import warn_of_order
from .contours import CallableMotion, Contour, HeightField, Motion
from .errors import ArgumentError, MissingExtraError, SceneFileError
from .expressions import CONSTANTS, FUNCTIONS, compiled
from .friction.laws import LAWS, FrictionLaw, NoSlip
from .loaded_scene import LoadedScene
from .scene import Scene
from .scene_tables import (
    Converter,
    Mismatch,
    Table,
    as_array,
    as_flag,
    as_flags,
    as_formulas,
    as_height,
    as_integer,
    as_interval,
    as_number,
    as_number_or_infinity,
    as_numbers,
    as_pose,
    as_poses,
    as_profile,
    as_rectangle,
    as_rotation,
    as_side,
    as_text,
    as_texts,
    as_vector,
    listed,
    suggestion,
)
from .simulate import simulate

if TYPE_CHECKING:
    from .state import State

# Names that formulas use themselves.
_VARIABLES = ("u", "u1", "u2", "s", "x", "y", "t")


def load_scene(path: str | os.PathLike[str]) -> LoadedScene:
    """Read a scene file and find its initial state.

    Parameters
    ----------
    path : str or Path
        A .toml file; .yaml and .yml where PyYAML is installed.

    Returns
    -------
    LoadedScene

    Raises
    ------
    SceneFileError
        For a file that cannot be read and for everything in it that is missing, unknown or out of bounds; with the file
        and the key.
    NoContactError, SingularContactError
        Where the contours do not touch as the initial state demands.
    MissingExtraError
        For YAML without PyYAML.

    Examples
    --------
    >>> import pincontact as pc
    >>> loaded = pc.load_scene("examples/scenes/ball_on_turntable.toml")
    >>> loaded.outputs, loaded.simulate(duration=0.5).t.size
    (201, 201)
    """
    file = Path(path)
    root = Table(file, "", _parse(file), {})
    root.allow(*_MODEL, "constants", "collision", "contours", "contacts", "initial", "simulation")
    constants = root.table("constants")
    if constants is not None:
        _read_constants(constants)
    scene = _read_model(root)
    collision = root.table("collision")
    if collision is not None:
        _read_collision(collision, scene)
    for entry in root.tables("contours"):
        _read_contour(entry, scene)
    for entry in root.tables("contacts"):
        _read_contact(entry, scene)
    state = _read_initial(root.table("initial"), scene, root)
    settings, outputs = _read_simulation(root.table("simulation"))
    return LoadedScene(file, scene, state, settings, outputs)


def _parse(file: Path) -> dict[str, Any]:
    """The file's content. TOML's errors carry line and column."""
    suffix = file.suffix.lower()
    if suffix not in (".toml", ".yaml", ".yml"):
        raise SceneFileError(f"{file}: a scene file ends in .toml, .yaml or .yml")
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneFileError(f"{file} cannot be read: {error}") from error
    failures: tuple[type[Exception], ...]
    if suffix == ".toml":
        toml = import_module("tomllib" if sys.version_info >= (3, 11) else "tomli")
        read, failures = toml.loads, (toml.TOMLDecodeError, RecursionError)
    else:
        try:
            import yaml

            from .yaml_text import SceneLoader
        except ImportError:
            raise MissingExtraError(f"{file}: YAML needs the package PyYAML; TOML needs nothing") from None
        read, failures = partial(yaml.load, Loader=SceneLoader), (yaml.YAMLError, RecursionError)
    try:
        content = read(text)
    except failures as error:
        raise SceneFileError(f"{file} is not valid {suffix[1:].upper()}: {error}") from error
    if not isinstance(content, dict):
        raise SceneFileError(f"{file}: expected tables such as contours and contacts, got {content!r}")
    return content


# ---------------------------------------------------------------------------------------------------- the model


def _read_constants(table: Table) -> None:
    """Constants may use those above them."""
    for name in table.content:
        if not name.isidentifier() or name in (*_VARIABLES, *FUNCTIONS, *CONSTANTS):
            raise table.error(name, "this name cannot be given to a constant")
        table.constants[name] = table.get(name, as_number)


_ROBOTS = {"urdf": Scene.from_urdf, "mjcf": Scene.from_mjcf, "sdf": Scene.from_sdf}
_MODEL = (*_ROBOTS, "package_dirs", "floating_base", "gravity")


def _read_model(root: Table) -> Scene:
    folder = root.file.resolve().parent
    packages = [str(folder / part) for part in root.get("package_dirs", as_texts, [])]
    kind, *others = [kind for kind in _ROBOTS if kind in root.content] or ["urdf"]
    if others:
        raise root.error(others[0], f"the model is given by {kind} already")
    robot = folder / root.get(kind, as_text)
    options: dict[str, Any] = {"floating_base": root.get("floating_base", as_flag, False), "package_dirs": packages}
    if kind == "mjcf":
        if options["floating_base"]:
            raise root.error("floating_base", "a base that moves has a <freejoint> in its MJCF file")
        options = {}
    scene: Scene = root.attempt(kind, _ROBOTS[kind], robot, **options)
    gravity = root.get("gravity", as_vector(3), None)
    if gravity is not None:
        scene.model.gravity.linear = np.array(gravity)
    return scene


# ---------------------------------------------------------------------------------------------------- contours


def _read_collision(table: Table, scene: Scene) -> None:
    table.allow("links", "kinds")
    given = {key: table.get(key, as_texts) for key in table.content}
    table.attempt("", scene.add_contours_from_collision, **given)


# How arguments of these types are read; others are numbers, in lists or not.
_BY_TYPE: dict[str, Converter] = {
    "float": as_number,
    "int": as_integer,
    "bool": as_flag,
    "str": as_text,
    "tuple[float, float]": as_interval,
    "tuple[bool, bool]": as_flags,
    "tuple[tuple[float, float], tuple[float, float]]": as_rectangle,
    "Domain": as_rectangle,
}
# And these by their names.
_BY_NAME: dict[str, Converter] = {
    "ParametricCurve.f": as_formulas(3, "u", "t"),
    "ParametricSurface.f": as_formulas(3, "u1", "u2", "t"),
    "HeightField.f": as_height,
    "SurfaceOfRevolution.profile": as_profile,
    "SplineMotion.poses": as_poses,
}


def _keys(call: Callable[..., Any], *left_out: str) -> dict[str, Converter]:
    """The arguments of a call that a table may have as keys, and how their values are read."""
    found = {}
    for name, parameter in inspect.signature(call).parameters.items():
        convert = _BY_TYPE.get(parameter.annotation.removesuffix(" | None"), as_array)
        if parameter.default == math.inf:
            convert = as_number_or_infinity
        if name not in left_out:
            found[name] = _BY_NAME.get(f"{call.__name__}.{name}", convert)
    return found


def _kinds(base: type) -> dict[str, Any]:
    """The public classes of this kind."""
    contours = vars(import_module(".contours", __package__))
    found = {name: contours[name] for name in contours["__all__"]}
    return {name: kind for name, kind in found.items() if isinstance(kind, type) and base in kind.__mro__[1:]}


def _of_kind(table: Table, base: type) -> Any:
    kinds = _kinds(base)
    name = table.get("kind", as_text)
    if name not in kinds:
        raise table.error("kind", f"there is no {name!r}; {suggestion(name, set(kinds))}")
    return kinds[name]


def _constructed(table: Table, kind: type, *others: str) -> Any:
    """An object of a class from the keys that its constructor names; others: what else the table may have."""
    keys = _keys(kind, "derivatives")
    signature: Mapping[str, inspect.Parameter] = inspect.signature(kind).parameters
    required = {name for name in keys if signature[name].default is inspect.Parameter.empty}
    if kind is HeightField:
        # a function of x and y, or a grid, whose x is the first argument
        grid = {"f": as_array, **{name: keys[name] for name in ("y", "z", "degree")}}
        function = {name: keys[name] for name in ("f", "domain", "time_domain")}
        keys, required = (grid, {"f", "y", "z"}) if "z" in table.content else (function, {"f"})
    called = {name: "x" if name == "f" and "z" in keys else name for name in keys}
    table.allow("kind", *others, *called.values())
    given = {name: key for name, key in called.items() if key in table.content or name in required}
    return table.attempt("", kind, **{name: table.get(key, keys[name]) for name, key in given.items()})


def _read_contour(table: Table, scene: Scene) -> None:
    kind = _of_kind(table, Contour)
    contour = _constructed(table, kind, "frame", "xyz", "rpy", "quaternion", "motion")
    frame = table.get("frame", as_text, "universe")
    placement = _read_placement(table)
    drive = table.table("motion")
    motion = None if drive is None else _read_motion(drive)
    table.attempt("", scene.add_contour, table.name, contour, frame, placement, motion)


def _read_placement(table: Table) -> pin.SE3:
    xyz = table.get("xyz", as_vector(3), [0.0, 0.0, 0.0])
    key = "rpy" if "rpy" in table.content else "quaternion"
    rotation = table.get(key, lambda _, constants: as_rotation(table.content, constants), np.eye(3))
    warn_of_order(f"{table.file}: {table.path('quaternion')}", table.content.get("quaternion", ()), stacklevel=4)
    return pin.SE3(rotation, np.array(xyz))


def _read_motion(table: Table) -> Motion:
    kind = _of_kind(table, Motion)
    if kind is not CallableMotion:
        motion: Motion = _constructed(table, kind)
        return motion
    table.allow("kind", "xyz", "rpy", "time_domain")
    zero = compiled(["0", "0", "0"], ("t",))
    position, angles = (table.get(key, as_formulas(3, "t"), zero) for key in ("xyz", "rpy"))
    domain = table.get("time_domain", as_interval)
    return table.attempt("", CallableMotion, _moving_pose(position, angles), domain)


def _moving_pose(position: Callable[..., Any], angles: Callable[..., Any]) -> Callable[[float], pin.SE3]:
    """The placement of time whose position and roll, pitch, yaw are given by formulas."""

    def at(function: Callable[..., Any], t: float) -> np.ndarray:
        return np.array(function(t) if function.__code__.co_argcount else function(), dtype=float)  # type: ignore[attr-defined]

    return lambda t: pin.SE3(pin.rpy.rpyToMatrix(*at(angles, t)), at(position, t))


# ---------------------------------------------------------------------------------------------------- contacts


_FRICTION = (
    '"none", "no slip", a coefficient, or {mu = .., mu_static = ..} (numbers or pairs of them) with any of speed, '
    "exponent, viscous, spinning, rolling and along"
)


def _friction(value: Any, constants: Mapping[str, float]) -> FrictionLaw | None:
    if isinstance(value, str) and value.lower() in ("none", "frictionless"):
        return None
    given = value if isinstance(value, dict) else {"mu": value}
    if "mu" not in given:
        raise Mismatch(_FRICTION)
    if _is_no_slip(given["mu"]):
        if not set(given) <= {"mu", "spinning", "rolling"}:
            raise Mismatch('mu = "no slip" with spinning and rolling at most')
        return NoSlip(**{key: as_number(number, constants) for key, number in given.items() if key != "mu"})
    # the first law that takes all keys
    for kind in LAWS:
        takes = inspect.signature(kind).parameters
        if set(given) <= set(takes):
            break
    else:
        raise Mismatch(_FRICTION)
    missing = [key for key, taken in takes.items() if taken.default is taken.empty and key not in given]
    if missing:
        raise Mismatch(f"{' and '.join(missing)}, too, where there is {' and '.join(list(given)[1:])}")
    convert = {"along": as_text, "mu": _coefficient, "mu_static": _coefficient}
    try:
        options = {key: convert.get(key, as_number)(entry, constants) for key, entry in given.items()}
    except ArgumentError:
        if isinstance(value, str):
            raise Mismatch(_FRICTION) from None
        raise
    law: FrictionLaw = kind(**options)
    return law


def _is_no_slip(value: Any) -> bool:
    return isinstance(value, str) and value.lower().replace(" ", "").replace("_", "").replace("-", "") == "noslip"


def _coefficient(value: Any, constants: Mapping[str, float]) -> Any:
    return as_vector(2)(value, constants) if isinstance(value, list) else as_number(value, constants)


def _location(value: Any, constants: Mapping[str, float]) -> tuple[Any, Any]:
    """A guess for each contour; an empty list where there is none."""
    guesses = listed(value, "[guess for the first contour, guess for the second], a number, a list, or [] each", 2)
    parts = [as_numbers(part if isinstance(part, list) else [part], constants) or None for part in guesses]
    return parts[0], parts[1]


def _pair(value: Any, constants: Mapping[str, float]) -> list[str]:
    return as_texts(listed(value, "the names of two contours", 2), constants)


def _read_contact(table: Table, scene: Scene) -> None:
    table.allow("between", *_OF_CONTACT)
    first, second = table.get("between", _pair)
    for name in (first, second):
        if name not in scene.contours:
            raise table.error("between", f"there is no contour {name!r}; {suggestion(name, set(scene.contours))}")
    options = {key: table.get(key, convert) for key, convert in _OF_CONTACT.items() if key in table.content}
    table.attempt("", scene.add_contact, table.name, first, second, **options)


_OF_CONTACT: dict[str, Converter] = {
    "friction": _friction,
    "bilateral": as_flag,
    "pattern": as_text,
    "location": _location,
    "side": as_side,
    "restitution": as_number,
}


# ---------------------------------------------------------------------------------------------------- the state


def _joint_q(joint: Any, value: Any, constants: Mapping[str, float]) -> np.ndarray:
    """A joint's part of q: its coordinates, an angle for a continuous joint, a placement for a free one."""
    if isinstance(value, dict):
        if joint.nq != 7:
            raise Mismatch(f"{joint.nq} numbers, a placement is for a free joint")
        return pin.SE3ToXYZQUAT(as_pose(value, constants))
    if (joint.nq, joint.nv) == (2, 1) and not (isinstance(value, list) and len(value) != 1):
        (angle,) = _joint_v(joint, value, constants)
        return np.array([math.cos(angle), math.sin(angle)])
    return _joint_v(joint, value, constants, joint.nq)


def _joint_v(joint: Any, value: Any, constants: Mapping[str, float], size: int | None = None) -> np.ndarray:
    """A joint's part of v, or so many numbers."""
    size = joint.nv if size is None else size
    numbers = as_numbers(value if isinstance(value, list) else [value], constants)
    if len(numbers) != size:
        raise Mismatch(f"{size} numbers for a joint of type {joint.shortname()}")
    return np.array(numbers)


def _read_coordinates(table: Table, key: str, model: pin.Model) -> np.ndarray:
    """q or v: all numbers in Pinocchio's order, or a table of joints, the others at their neutral value or at rest."""
    position = key == "q"
    result = pin.neutral(model) if position else np.zeros(model.nv)
    if not isinstance(table.content.get(key), dict):
        return np.array(table.get(key, as_vector(result.size), list(result)))
    joints = table.table(key)
    assert joints is not None
    names = list(model.names)[1:]
    for name in joints.content:
        if name not in names:
            raise joints.error(name, f"there is no such joint; {suggestion(name, names)}")
        joint = model.joints[names.index(name) + 1]
        start = joint.idx_q if position else joint.idx_v
        part = joints.get(name, partial(_joint_q if position else _joint_v, joint))
        result[start : start + part.size] = part
    return result


def _read_initial(table: Table | None, scene: Scene, root: Table) -> State:
    given = table if table is not None else Table(root.file, "initial", {}, root.constants)
    given.allow("q", "v", "t", "free", "max_gap")
    q, v = (_read_coordinates(given, key, scene.model) for key in ("q", "v"))
    t = given.get("t", as_number, 0.0)
    options = {"free": given.get("free", as_texts, []), "max_gap": given.get("max_gap", as_number, None)}
    return given.attempt("", scene.initial_state, q, v, t, **options)


# ---------------------------------------------------------------------------------------------------- the run

_SETTINGS = _keys(simulate, "scene", "state", "t_eval", "control", "events", "progress")


def _outputs(value: Any, constants: Mapping[str, float]) -> int | tuple[float, ...]:
    if isinstance(value, list):
        return tuple(as_numbers(value, constants))
    if isinstance(value, bool) or not isinstance(value, int) or value < 2:
        raise Mismatch("a number of output times, at least 2, or a list of times")
    return value


def _read_simulation(table: Table | None) -> tuple[dict[str, Any], int | tuple[float, ...] | None]:
    if table is None:
        return {}, None
    table.allow("outputs", *_SETTINGS)
    settings = {key: table.get(key, convert) for key, convert in _SETTINGS.items() if key in table.content}
    if "dt" in settings and "step" in settings:
        raise table.error("step", "it is another name of dt, which is given, too")
    if "step" in settings:
        settings["dt"] = settings.pop("step")
    return settings, table.get("outputs", _outputs, None)
