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
from .contours import (
    CallableMotion,
    Circle,
    Cone,
    ConstantTwist,
    Contour,
    Cycloid,
    Cylinder,
    Ellipse,
    Ellipsoid,
    FourierCurve,
    HarmonicMotion,
    HeightField,
    Helix,
    Line,
    Motion,
    ParametricCurve,
    ParametricSurface,
    Plane,
    Point,
    Sphere,
    SplineCurve,
    SplineMotion,
    SplineSurface,
    SurfaceOfRevolution,
    Torus,
)
from .errors import ArgumentError, MissingExtraError, SceneFileError
from .expressions import CONSTANTS, FUNCTIONS, compiled, evaluate
from .friction.laws import Coulomb, FrictionLaw, NoSlip, Stribeck
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
    suggestion,
)

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


_MODEL = ("urdf", "mjcf", "sdf", "package_dirs", "floating_base", "gravity")


def _read_model(root: Table) -> Scene:
    folder = root.file.resolve().parent
    packages = [str(folder / part) for part in root.get("package_dirs", as_texts, [])]
    kinds = [kind for kind in ("urdf", "mjcf", "sdf") if kind in root.content] or ["urdf"]
    if len(kinds) > 1:
        raise root.error(kinds[1], f"the model is given by {kinds[0]} already")
    kind = kinds[0]
    robot = folder / root.get(kind, as_text)
    options: dict[str, Any] = {"floating_base": root.get("floating_base", as_flag, False), "package_dirs": packages}
    if kind == "mjcf":
        if options["floating_base"]:
            raise root.error("floating_base", "a base that moves has a <freejoint> in its MJCF file")
        options = {}
    make = {"urdf": Scene.from_urdf, "mjcf": Scene.from_mjcf, "sdf": Scene.from_sdf}[kind]
    scene: Scene = root.attempt(kind, make, robot, **options)
    gravity = root.get("gravity", as_vector(3), None)
    if gravity is not None:
        scene.model.gravity.linear = np.array(gravity)
    return scene


# ---------------------------------------------------------------------------------------------------- contours


def _read_collision(table: Table, scene: Scene) -> None:
    options = {"links": table.get("links", as_texts, None), "kinds": table.get("kinds", as_texts, None)}
    table.allow(*options)
    given = {key: value for key, value in options.items() if value is not None}
    table.attempt("", scene.add_contours_from_collision, **given)


_CONTOURS: dict[type[Contour], dict[str, Converter]] = {
    Point: {},
    Line: {"domain": as_interval},
    Circle: {"radius": as_number, "domain": as_interval},
    Ellipse: {"a": as_number, "b": as_number, "domain": as_interval},
    Helix: {"radius": as_number, "pitch": as_number, "domain": as_interval},
    Cycloid: {"radius": as_number, "domain": as_interval},
    FourierCurve: {"cosine": as_array, "sine": as_array},
    SplineCurve: {"points": as_array, "periodic": as_flag, "degree": as_integer, "parameters": as_numbers},
    ParametricCurve: {
        "f": as_formulas(3, "u", "t"),
        "domain": as_interval,
        "periodic": as_flag,
        "time_domain": as_interval,
    },
    Plane: {"domain": as_rectangle},
    Sphere: {"radius": as_number},
    Ellipsoid: {"a": as_number, "b": as_number, "c": as_number},
    Cylinder: {"radius": as_number, "domain": as_rectangle},
    Cone: {"half_angle": as_number, "domain": as_rectangle},
    Torus: {"major": as_number, "minor": as_number},
    SurfaceOfRevolution: {"profile": as_profile, "domain": as_interval, "periodic": as_flag},
    SplineSurface: {"points": as_array, "periodic": as_flags, "degree": as_integer, "parameters": as_array},
    ParametricSurface: {
        "f": as_formulas(3, "u1", "u2", "t"),
        "domain": as_rectangle,
        "periodic": as_flags,
        "time_domain": as_interval,
    },
}
# A height field is a function of x and y, or a grid; each is its own set of parameters.
_HEIGHT_FUNCTION: dict[str, Converter] = {"f": as_height, "domain": as_rectangle, "time_domain": as_interval}
_HEIGHT_GRID: dict[str, Converter] = {"x": as_numbers, "y": as_numbers, "z": as_array, "degree": as_integer}

_MOTIONS: dict[type[Motion], dict[str, Converter]] = {
    ConstantTwist: {"angular": as_vector(3), "linear": as_vector(3), "center": as_vector(3)},
    HarmonicMotion: {
        "amplitude": as_vector(3),
        "frequency": as_number,
        "phase": as_number,
        "axis": as_vector(3),
        "angle": as_number,
        "turn_frequency": as_number,
        "turn_phase": as_number,
        "center": as_vector(3),
    },
    SplineMotion: {"times": as_numbers, "poses": as_poses, "periodic": as_flag},
}


def _of_kind(table: Table, kinds: Mapping[str, Any]) -> str:
    kind = table.get("kind", as_text)
    if kind not in kinds:
        raise table.error("kind", f"there is no {kind!r}; {suggestion(kind, set(kinds))}")
    return kind


def _constructed(table: Table, kind: type, parameters: Mapping[str, Converter]) -> Any:
    """An object of a class from the keys that its constructor names."""
    signature = inspect.signature(kind).parameters
    options = {
        name: table.get(name, convert)
        for name, convert in parameters.items()
        if name in table.content or signature[name].default is inspect.Parameter.empty
    }
    return table.attempt("", kind, **options)


_PLACEMENT = ("xyz", "rpy", "quaternion")


def _read_contour(table: Table, scene: Scene) -> None:
    kinds = {kind.__name__: kind for kind in _CONTOURS}
    name = _of_kind(table, {**kinds, "HeightField": None})
    if name == "HeightField":
        parameters = _HEIGHT_GRID if "z" in table.content else _HEIGHT_FUNCTION
    else:
        parameters = _CONTOURS[kinds[name]]
    table.allow("kind", "frame", *_PLACEMENT, "motion", *parameters)
    frame = table.get("frame", as_text, "universe")
    placement = _read_placement(table)
    drive = table.table("motion")
    motion = None if drive is None else _read_motion(drive)
    contour = (
        _height_field(table, parameters) if name == "HeightField" else _constructed(table, kinds[name], parameters)
    )
    table.attempt("", scene.add_contour, table.name, contour, frame, placement, motion)


def _height_field(table: Table, parameters: Mapping[str, Converter]) -> Contour:
    optional = ("domain", "degree", "time_domain")
    options = {
        name: table.get(name, convert)
        for name, convert in parameters.items()
        if name in table.content or name not in optional
    }
    # the constructor's first argument is the function, or the grid's x
    first = options.pop(next(iter(parameters)))
    return table.attempt("", HeightField, first, **options)


def _read_placement(table: Table) -> pin.SE3:
    xyz = table.get("xyz", as_vector(3), [0.0, 0.0, 0.0])
    key = "rpy" if "rpy" in table.content else "quaternion"
    rotation = table.get(key, lambda _, constants: as_rotation(table.content, constants), np.eye(3))
    warn_of_order(f"{table.file}: {table.path('quaternion')}", table.content.get("quaternion", ()), stacklevel=4)
    return pin.SE3(rotation, np.array(xyz))


def _read_motion(table: Table) -> Motion:
    kinds = {kind.__name__: kind for kind in _MOTIONS}
    kind = _of_kind(table, {**kinds, "CallableMotion": None})
    if kind != "CallableMotion":
        table.allow("kind", *_MOTIONS[kinds[kind]])
        return _constructed(table, kinds[kind], _MOTIONS[kinds[kind]])
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


_LAW_NUMBERS = ("speed", "exponent", "viscous", "spinning", "rolling")


def _friction(value: Any, constants: Mapping[str, float]) -> FrictionLaw | None:
    expected = (
        '"none", "no slip", a coefficient, or {mu = .., mu_static = ..} (numbers or pairs of them) with any of speed, '
        "exponent, viscous, spinning, rolling and along"
    )
    if isinstance(value, dict):
        if not {"mu"} <= set(value) <= {"mu", "mu_static", "along", *_LAW_NUMBERS}:
            raise Mismatch(expected)
        options: dict[str, Any] = {key: as_number(value[key], constants) for key in _LAW_NUMBERS if key in value}
        if "along" in value:
            options["along"] = as_text(value["along"], constants)
        if _is_no_slip(value["mu"]):
            if not set(value) <= {"mu", "spinning", "rolling"}:
                raise Mismatch('mu = "no slip" with spinning and rolling at most')
            return NoSlip(**options)
        options |= {key: _coefficient(value[key], constants) for key in ("mu", "mu_static") if key in value}
        if "speed" in value:
            if "mu_static" not in value:
                raise Mismatch("mu_static, too, where friction depends on speed")
            return Stribeck(**options)
        if "exponent" in value:
            raise Mismatch("speed, too, where there is an exponent")
        return Coulomb(**options)
    if isinstance(value, str):
        if value.lower() in ("none", "frictionless"):
            return None
        if _is_no_slip(value):
            return NoSlip()
        try:
            return Coulomb(evaluate(value, constants))
        except ArgumentError:
            raise Mismatch(expected) from None
    return Coulomb(as_number(value, constants))


def _is_no_slip(value: Any) -> bool:
    return isinstance(value, str) and value.lower().replace(" ", "").replace("_", "").replace("-", "") == "noslip"


def _coefficient(value: Any, constants: Mapping[str, float]) -> Any:
    return as_vector(2)(value, constants) if isinstance(value, list) else as_number(value, constants)


def _location(value: Any, constants: Mapping[str, float]) -> tuple[Any, Any]:
    """A guess for each contour; an empty list where there is none."""
    if not isinstance(value, list) or len(value) != 2:
        raise Mismatch("[guess for the first contour, guess for the second], a number, a list, or [] each")
    parts = [as_numbers(part if isinstance(part, list) else [part], constants) or None for part in value]
    return parts[0], parts[1]


def _pair(value: Any, constants: Mapping[str, float]) -> list[str]:
    if not isinstance(value, list) or len(value) != 2:
        raise Mismatch("the names of two contours")
    return as_texts(value, constants)


def _read_contact(table: Table, scene: Scene) -> None:
    table.allow("between", "friction", "bilateral", "pattern", "location", "side", "restitution")
    first, second = table.get("between", _pair)
    for name in (first, second):
        if name not in scene.contours:
            raise table.error("between", f"there is no contour {name!r}; {suggestion(name, set(scene.contours))}")
    options: dict[str, Any] = {
        "friction": table.get("friction", _friction, None),
        "bilateral": table.get("bilateral", as_flag, False),
        "pattern": table.get("pattern", as_text, None),
        "location": table.get("location", _location, None),
        "side": table.get("side", as_side, None),
        "restitution": table.get("restitution", as_number, 0.0),
    }
    table.attempt("", scene.add_contact, table.name, first, second, **options)


# ---------------------------------------------------------------------------------------------------- the state


def _joint_q(joint: Any, value: Any, constants: Mapping[str, float]) -> np.ndarray:
    """A joint's part of q: its coordinates, an angle for a continuous joint, a placement for a free one."""
    if isinstance(value, dict):
        if joint.nq != 7:
            raise Mismatch(f"{joint.nq} numbers, a placement is for a free joint")
        return pin.SE3ToXYZQUAT(as_pose(value, constants))
    numbers = as_numbers(value if isinstance(value, list) else [value], constants)
    if len(numbers) == 1 and (joint.nq, joint.nv) == (2, 1):
        return np.array([math.cos(numbers[0]), math.sin(numbers[0])])
    if len(numbers) != joint.nq:
        raise Mismatch(f"{joint.nq} numbers for a joint of type {joint.shortname()}")
    return np.array(numbers)


def _joint_v(joint: Any, value: Any, constants: Mapping[str, float]) -> np.ndarray:
    numbers = as_numbers(value if isinstance(value, list) else [value], constants)
    if len(numbers) != joint.nv:
        raise Mismatch(f"{joint.nv} numbers for a joint of type {joint.shortname()}")
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

_SETTINGS: dict[str, Converter] = {
    "duration": as_number,
    "rtol": as_number,
    "atol": as_number,
    "method": as_text,
    "energies": as_flag,
    "max_step": as_number_or_infinity,
    "first_step": as_number,
    "fixed_step": as_number,
    "dt": as_number,
    "step": as_number,
    "max_steps": as_integer,
    "dense_output": as_flag,
    "fallback": as_text,
    "contact_solver": as_text,
    "breakpoints": as_numbers,
}


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
    settings = {key: table.get(key, convert, None) for key, convert in _SETTINGS.items()}
    outputs = table.get("outputs", _outputs, None)
    if settings["dt"] is not None and settings["step"] is not None:
        raise table.error("step", "it is another name of dt, which is given, too")
    settings["dt"] = settings.pop("step") if settings["dt"] is None else settings["dt"]
    settings.pop("step", None)
    return {key: value for key, value in settings.items() if value is not None}, outputs
