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

import difflib
import inspect
import math
import os
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from . import contours as shapes
from .arguments import is_number, warn_of_order
from .contours import Contour, Motion
from .errors import ArgumentError, FrictionError, MissingExtraError, SceneFileError
from .expressions import CONSTANTS, FUNCTIONS, compiled, evaluate
from .friction.laws import Coulomb, FrictionLaw, NoSlip, Stribeck
from .scene import Scene

if TYPE_CHECKING:
    from .state import State
    from .trajectory import Trajectory

# Names that formulas use themselves.
_VARIABLES = ("u", "u1", "u2", "s", "x", "y", "t")
_REQUIRED: Any = object()
# Quaternions in files have a few digits; a norm further off than this is a mistake.
_NORM_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """What a scene file describes.

    scene, state: ready for `simulate`. settings: the options of `simulate` that the file gives, outputs excepted.
    outputs: number of equally spaced output times, or the times in s themselves, or None for every step.
    """

    path: Path
    scene: Scene
    state: State
    settings: dict[str, Any]
    outputs: int | tuple[float, ...] | None = None

    def options(self, **changes: Any) -> dict[str, Any]:
        """Keyword arguments for `simulate`: the file's, with changes; t_eval follows from outputs and duration.

        Raises ArgumentError where neither the file nor the changes say the duration.
        """
        options = {**self.settings, **changes}
        if "duration" not in options:
            raise ArgumentError(f"{self.path}: simulation.duration is not in the file, and none was given")
        if "t_eval" not in options and self.outputs is not None:
            start, duration = self.state.t, options["duration"]
            if isinstance(self.outputs, int):
                options["t_eval"] = np.linspace(start, start + duration, self.outputs)
            else:
                # a shorter run than the file's keeps the outputs it reaches
                options["t_eval"] = [t for t in self.outputs if "duration" not in changes or t <= start + duration]
        return options

    def simulate(self, **changes: Any) -> Trajectory:
        """Run the scene with the file's settings; changes are arguments of `pincontact.simulate`."""
        from .simulate import simulate

        return simulate(self.scene, self.state, **self.options(**changes))


def load_scene(path: str | os.PathLike[str]) -> LoadedScene:
    """Read a scene file (.toml; .yaml and .yml where PyYAML is installed) and find its initial state.

    Raises SceneFileError, with the file and the key, for a file that cannot be read and for everything in it that is
    missing, unknown or out of bounds; NoContactError and SingularContactError where the contours do not touch as the
    initial state demands; MissingExtraError for YAML without PyYAML.
    """
    file = Path(path)
    root = _Table(file, "", _parse(file), {})
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


# ---------------------------------------------------------------------------------------------------- tables


class _Mismatch(Exception):
    """A value is not what was expected; the text says what was."""


Converter = Callable[[Any, Mapping[str, float]], Any]


class _Table:
    """One table of the file: typed access, and errors that name file and key."""

    def __init__(self, file: Path, where: str, content: Any, constants: dict[str, float]) -> None:
        self.file, self.where, self.constants = file, where, constants
        if not isinstance(content, dict):
            raise SceneFileError(f"{file}: {where}: expected a table, got {content!r}")
        self.content: dict[str, Any] = content
        self.name = ""

    def path(self, key: str) -> str:
        quoted = key if key.replace("_", "").replace("-", "").isalnum() else f'"{key}"'
        return ".".join(part for part in (self.where, quoted if key else "") if part)

    def error(self, key: str, text: str) -> SceneFileError:
        where = self.path(key)
        return SceneFileError(f"{self.file}: {where}: {text}" if where else f"{self.file}: {text}")

    def get(self, key: str, convert: Converter, default: Any = _REQUIRED) -> Any:
        """The converted value of a key, or its default."""
        if key not in self.content:
            if default is _REQUIRED:
                raise self.error(key, "is missing")
            return default
        value = self.content[key]
        try:
            return convert(value, self.constants)
        except _Mismatch as mismatch:
            raise self.error(key, f"expected {mismatch}, got {value!r}") from None
        except (ArgumentError, FrictionError) as error:
            raise self.error(key, str(error)) from error

    def table(self, key: str) -> _Table | None:
        """A table within this one, None if there is none."""
        if key not in self.content:
            return None
        inner = _Table(self.file, self.path(key), self.content[key], self.constants)
        inner.name = key
        return inner

    def tables(self, key: str) -> list[_Table]:
        """The tables within the table `key`, each under its own name."""
        outer = self.table(key)
        if outer is None:
            return []
        inner = [outer.table(name) for name in outer.content]
        return [entry for entry in inner if entry is not None]

    def attempt(self, key: str, call: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """call(...), whose complaints about arguments become the file's."""
        try:
            return call(*arguments, **options)
        except ValueError as error:
            raise self.error(key, str(error)) from error

    def allow(self, *keys: str) -> None:
        """Raises SceneFileError for a key that is none of these."""
        for key in self.content:
            if key not in keys:
                raise self.error(key, f"unknown key; {_suggestion(key, keys)}")


def _suggestion(name: str, known: Collection[str]) -> str:
    by_case = {candidate.lower(): candidate for candidate in sorted(known)}
    close = difflib.get_close_matches(str(name).lower(), by_case, n=2)
    if close:
        return f"did you mean {' or '.join(by_case[match] for match in close)}?"
    return f"expected one of {', '.join(sorted(known))}"


# ---------------------------------------------------------------------------------------------------- values


def _number(value: Any, constants: Mapping[str, float]) -> float:
    # formulas of what is not finite are refused where they are evaluated
    if isinstance(value, str) or (is_number(value) and math.isfinite(value)):
        return _end(value, constants)
    raise _Mismatch("a number (finite), or a formula of constants")


def _end(value: Any, constants: Mapping[str, float]) -> float:
    """A number that may be infinite, as an end of an interval is."""
    if isinstance(value, str):
        return evaluate(value, constants)
    if not is_number(value):
        raise _Mismatch("a number, or a formula of constants")
    return float(value)


def _integer(value: Any, _: Mapping[str, float]) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise _Mismatch("a whole number")
    return value


def _flag(value: Any, _: Mapping[str, float]) -> bool:
    if not isinstance(value, bool):
        raise _Mismatch("true or false")
    return value


def _text(value: Any, _: Mapping[str, float]) -> str:
    if not isinstance(value, str):
        raise _Mismatch("a text")
    return value


def _texts(value: Any, _: Mapping[str, float]) -> list[str]:
    if isinstance(value, str):
        return [value]
    if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
        raise _Mismatch("a list of texts")
    return value


def _numbers(value: Any, constants: Mapping[str, float]) -> list[float]:
    if not isinstance(value, list):
        raise _Mismatch("a list of numbers")
    return [_number(entry, constants) for entry in value]


def _array(value: Any, constants: Mapping[str, float]) -> Any:
    """Numbers in lists in lists."""
    return [_array(entry, constants) for entry in value] if isinstance(value, list) else _number(value, constants)


def _vector(count: int) -> Converter:
    def convert(value: Any, constants: Mapping[str, float]) -> list[float]:
        if not isinstance(value, list) or len(value) != count:
            raise _Mismatch(f"{count} numbers")
        return _numbers(value, constants)

    return convert


def _interval(value: Any, constants: Mapping[str, float]) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise _Mismatch("[low, high]")
    return _end(value[0], constants), _end(value[1], constants)


def _rectangle(value: Any, constants: Mapping[str, float]) -> tuple[Any, Any]:
    if not isinstance(value, list) or len(value) != 2 or not all(isinstance(part, list) for part in value):
        raise _Mismatch("[[low, high], [low, high]]")
    return _interval(value[0], constants), _interval(value[1], constants)


def _flags(value: Any, _: Mapping[str, float]) -> tuple[bool, bool]:
    if not isinstance(value, list) or len(value) != 2 or not all(isinstance(part, bool) for part in value):
        raise _Mismatch("two of true and false")
    return value[0], value[1]


def _formulas(count: int, *variables: str) -> Converter:
    """A function of the variables (and of t, if that occurs) with this many results; one result alone is a number."""

    def convert(value: Any, constants: Mapping[str, float]) -> Callable[..., Any]:
        listed = value if isinstance(value, list) else [value]
        if len(listed) != count or not all(isinstance(part, (str, int, float)) for part in listed):
            what = f"{count} formulas" if count > 1 else "a formula"
            raise _Mismatch(f"{what} in {', '.join(variables)}")
        return compiled([str(part) for part in listed], variables, constants)

    return convert


def _height(value: Any, constants: Mapping[str, float]) -> Callable[..., Any]:
    function = _formulas(1, "x", "y", "t")(value, constants)
    if function.__code__.co_argcount == 3:  # type: ignore[attr-defined]
        return lambda x, y, t: function(x, y, t)[0]
    return lambda x, y: function(x, y)[0]


def _profile(value: Any, constants: Mapping[str, float]) -> Any:
    """Points (r, z), or two formulas in s."""
    if isinstance(value, list) and value and all(isinstance(point, list) for point in value):
        return _array(value, constants)
    return _formulas(2, "s")(value, constants)


def _side(value: Any, _: Mapping[str, float]) -> int:
    if isinstance(value, bool) or value not in (1, -1):
        raise _Mismatch("1 or -1")
    return int(value)


def _rotation(content: Mapping[str, Any], constants: Mapping[str, float]) -> np.ndarray:
    """From rpy (rad, about fixed x, y, z as in URDF) or quaternion (x, y, z, w)."""
    if "rpy" in content and "quaternion" in content:
        raise _Mismatch("rpy or quaternion, not both")
    if "quaternion" in content:
        quaternion = np.array(_vector(4)(content["quaternion"], constants))
        norm = float(np.linalg.norm(quaternion))
        if not abs(norm - 1.0) <= _NORM_TOLERANCE:
            raise _Mismatch(f"a quaternion (x, y, z, w) of norm 1 instead of {norm:.6g}")
        return pin.Quaternion(*(quaternion / norm)[[3, 0, 1, 2]]).matrix()
    return pin.rpy.rpyToMatrix(*_vector(3)(content.get("rpy", [0.0, 0.0, 0.0]), constants))


def _pose(value: Any, constants: Mapping[str, float]) -> pin.SE3:
    if not isinstance(value, dict) or not set(value) <= {"xyz", "rpy", "quaternion"}:
        raise _Mismatch("a placement {xyz = [..], rpy = [..] or quaternion = [..]}")
    translation = np.array(_vector(3)(value.get("xyz", [0.0, 0.0, 0.0]), constants))
    return pin.SE3(_rotation(value, constants), translation)


def _poses(value: Any, constants: Mapping[str, float]) -> list[pin.SE3]:
    if not isinstance(value, list):
        raise _Mismatch("a list of placements")
    return [_pose(entry, constants) for entry in value]


# ---------------------------------------------------------------------------------------------------- the model


def _read_constants(table: _Table) -> None:
    """Constants may use those above them."""
    for name in table.content:
        if not name.isidentifier() or name in (*_VARIABLES, *FUNCTIONS, *CONSTANTS):
            raise table.error(name, "this name cannot be given to a constant")
        table.constants[name] = table.get(name, _number)


_MODEL = ("urdf", "mjcf", "sdf", "package_dirs", "floating_base", "gravity")


def _read_model(root: _Table) -> Scene:
    folder = root.file.resolve().parent
    packages = [str(folder / part) for part in root.get("package_dirs", _texts, [])]
    kinds = [kind for kind in ("urdf", "mjcf", "sdf") if kind in root.content] or ["urdf"]
    if len(kinds) > 1:
        raise root.error(kinds[1], f"the model is given by {kinds[0]} already")
    kind = kinds[0]
    robot = folder / root.get(kind, _text)
    options: dict[str, Any] = {"floating_base": root.get("floating_base", _flag, False), "package_dirs": packages}
    if kind == "mjcf":
        if options["floating_base"]:
            raise root.error("floating_base", "a base that moves has a <freejoint> in its MJCF file")
        options = {}
    make = {"urdf": Scene.from_urdf, "mjcf": Scene.from_mjcf, "sdf": Scene.from_sdf}[kind]
    scene: Scene = root.attempt(kind, make, robot, **options)
    gravity = root.get("gravity", _vector(3), None)
    if gravity is not None:
        scene.model.gravity.linear = np.array(gravity)
    return scene


# ---------------------------------------------------------------------------------------------------- contours


def _read_collision(table: _Table, scene: Scene) -> None:
    options = {"links": table.get("links", _texts, None), "kinds": table.get("kinds", _texts, None)}
    table.allow(*options)
    given = {key: value for key, value in options.items() if value is not None}
    table.attempt("", scene.add_contours_from_collision, **given)


_CONTOURS: dict[type[Contour], dict[str, Converter]] = {
    shapes.Point: {},
    shapes.Line: {"domain": _interval},
    shapes.Circle: {"radius": _number, "domain": _interval},
    shapes.Ellipse: {"a": _number, "b": _number, "domain": _interval},
    shapes.Helix: {"radius": _number, "pitch": _number, "domain": _interval},
    shapes.Cycloid: {"radius": _number, "domain": _interval},
    shapes.FourierCurve: {"cosine": _array, "sine": _array},
    shapes.SplineCurve: {"points": _array, "periodic": _flag, "degree": _integer, "parameters": _numbers},
    shapes.ParametricCurve: {
        "f": _formulas(3, "u", "t"),
        "domain": _interval,
        "periodic": _flag,
        "time_domain": _interval,
    },
    shapes.Plane: {"domain": _rectangle},
    shapes.Sphere: {"radius": _number},
    shapes.Ellipsoid: {"a": _number, "b": _number, "c": _number},
    shapes.Cylinder: {"radius": _number, "domain": _rectangle},
    shapes.Cone: {"half_angle": _number, "domain": _rectangle},
    shapes.Torus: {"major": _number, "minor": _number},
    shapes.SurfaceOfRevolution: {"profile": _profile, "domain": _interval, "periodic": _flag},
    shapes.SplineSurface: {"points": _array, "periodic": _flags, "degree": _integer, "parameters": _array},
    shapes.ParametricSurface: {
        "f": _formulas(3, "u1", "u2", "t"),
        "domain": _rectangle,
        "periodic": _flags,
        "time_domain": _interval,
    },
}
# A height field is a function of x and y, or a grid; each is its own set of parameters.
_HEIGHT_FUNCTION: dict[str, Converter] = {"f": _height, "domain": _rectangle, "time_domain": _interval}
_HEIGHT_GRID: dict[str, Converter] = {"x": _numbers, "y": _numbers, "z": _array, "degree": _integer}

_MOTIONS: dict[type[Motion], dict[str, Converter]] = {
    shapes.ConstantTwist: {"angular": _vector(3), "linear": _vector(3), "center": _vector(3)},
    shapes.HarmonicMotion: {
        "amplitude": _vector(3),
        "frequency": _number,
        "phase": _number,
        "axis": _vector(3),
        "angle": _number,
        "turn_frequency": _number,
        "turn_phase": _number,
        "center": _vector(3),
    },
    shapes.SplineMotion: {"times": _numbers, "poses": _poses, "periodic": _flag},
}


def _of_kind(table: _Table, kinds: Mapping[str, Any]) -> str:
    kind = table.get("kind", _text)
    if kind not in kinds:
        raise table.error("kind", f"there is no {kind!r}; {_suggestion(kind, set(kinds))}")
    return kind


def _constructed(table: _Table, kind: type, parameters: Mapping[str, Converter]) -> Any:
    """An object of a class from the keys that its constructor names."""
    signature = inspect.signature(kind).parameters
    options = {
        name: table.get(name, convert)
        for name, convert in parameters.items()
        if name in table.content or signature[name].default is inspect.Parameter.empty
    }
    return table.attempt("", kind, **options)


_PLACEMENT = ("xyz", "rpy", "quaternion")


def _read_contour(table: _Table, scene: Scene) -> None:
    kinds = {kind.__name__: kind for kind in _CONTOURS}
    name = _of_kind(table, {**kinds, "HeightField": None})
    if name == "HeightField":
        parameters = _HEIGHT_GRID if "z" in table.content else _HEIGHT_FUNCTION
    else:
        parameters = _CONTOURS[kinds[name]]
    table.allow("kind", "frame", *_PLACEMENT, "motion", *parameters)
    frame = table.get("frame", _text, "universe")
    placement = _read_placement(table)
    drive = table.table("motion")
    motion = None if drive is None else _read_motion(drive)
    contour = (
        _height_field(table, parameters) if name == "HeightField" else _constructed(table, kinds[name], parameters)
    )
    table.attempt("", scene.add_contour, table.name, contour, frame, placement, motion)


def _height_field(table: _Table, parameters: Mapping[str, Converter]) -> Contour:
    optional = ("domain", "degree", "time_domain")
    options = {
        name: table.get(name, convert)
        for name, convert in parameters.items()
        if name in table.content or name not in optional
    }
    # the constructor's first argument is the function, or the grid's x
    first = options.pop(next(iter(parameters)))
    return table.attempt("", shapes.HeightField, first, **options)


def _read_placement(table: _Table) -> pin.SE3:
    xyz = table.get("xyz", _vector(3), [0.0, 0.0, 0.0])
    key = "rpy" if "rpy" in table.content else "quaternion"
    rotation = table.get(key, lambda _, constants: _rotation(table.content, constants), np.eye(3))
    warn_of_order(f"{table.file}: {table.path('quaternion')}", table.content.get("quaternion", ()), stacklevel=4)
    return pin.SE3(rotation, np.array(xyz))


def _read_motion(table: _Table) -> Motion:
    kinds = {kind.__name__: kind for kind in _MOTIONS}
    kind = _of_kind(table, {**kinds, "CallableMotion": None})
    if kind != "CallableMotion":
        table.allow("kind", *_MOTIONS[kinds[kind]])
        return _constructed(table, kinds[kind], _MOTIONS[kinds[kind]])
    table.allow("kind", "xyz", "rpy", "time_domain")
    zero = compiled(["0", "0", "0"], ("t",))
    position, angles = (table.get(key, _formulas(3, "t"), zero) for key in ("xyz", "rpy"))
    domain = table.get("time_domain", _interval)
    return table.attempt("", shapes.CallableMotion, _moving_pose(position, angles), domain)


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
            raise _Mismatch(expected)
        options: dict[str, Any] = {key: _number(value[key], constants) for key in _LAW_NUMBERS if key in value}
        if "along" in value:
            options["along"] = _text(value["along"], constants)
        if _is_no_slip(value["mu"]):
            if not set(value) <= {"mu", "spinning", "rolling"}:
                raise _Mismatch('mu = "no slip" with spinning and rolling at most')
            return NoSlip(**options)
        options |= {key: _coefficient(value[key], constants) for key in ("mu", "mu_static") if key in value}
        if "speed" in value:
            if "mu_static" not in value:
                raise _Mismatch("mu_static, too, where friction depends on speed")
            return Stribeck(**options)
        if "exponent" in value:
            raise _Mismatch("speed, too, where there is an exponent")
        return Coulomb(**options)
    if isinstance(value, str):
        if value.lower() in ("none", "frictionless"):
            return None
        if _is_no_slip(value):
            return NoSlip()
        try:
            return Coulomb(evaluate(value, constants))
        except ArgumentError:
            raise _Mismatch(expected) from None
    return Coulomb(_number(value, constants))


def _is_no_slip(value: Any) -> bool:
    return isinstance(value, str) and value.lower().replace(" ", "").replace("_", "").replace("-", "") == "noslip"


def _coefficient(value: Any, constants: Mapping[str, float]) -> Any:
    return _vector(2)(value, constants) if isinstance(value, list) else _number(value, constants)


def _location(value: Any, constants: Mapping[str, float]) -> tuple[Any, Any]:
    """A guess for each contour; an empty list where there is none."""
    if not isinstance(value, list) or len(value) != 2:
        raise _Mismatch("[guess for the first contour, guess for the second], a number, a list, or [] each")
    parts = [_numbers(part if isinstance(part, list) else [part], constants) or None for part in value]
    return parts[0], parts[1]


def _pair(value: Any, constants: Mapping[str, float]) -> list[str]:
    if not isinstance(value, list) or len(value) != 2:
        raise _Mismatch("the names of two contours")
    return _texts(value, constants)


def _read_contact(table: _Table, scene: Scene) -> None:
    table.allow("between", "friction", "bilateral", "pattern", "location", "side", "restitution")
    first, second = table.get("between", _pair)
    for name in (first, second):
        if name not in scene.contours:
            raise table.error("between", f"there is no contour {name!r}; {_suggestion(name, set(scene.contours))}")
    options: dict[str, Any] = {
        "friction": table.get("friction", _friction, None),
        "bilateral": table.get("bilateral", _flag, False),
        "pattern": table.get("pattern", _text, None),
        "location": table.get("location", _location, None),
        "side": table.get("side", _side, None),
        "restitution": table.get("restitution", _number, 0.0),
    }
    table.attempt("", scene.add_contact, table.name, first, second, **options)


# ---------------------------------------------------------------------------------------------------- the state


def _joint_q(joint: Any, value: Any, constants: Mapping[str, float]) -> np.ndarray:
    """A joint's part of q: its coordinates, an angle for a continuous joint, a placement for a free one."""
    if isinstance(value, dict):
        if joint.nq != 7:
            raise _Mismatch(f"{joint.nq} numbers, a placement is for a free joint")
        return pin.SE3ToXYZQUAT(_pose(value, constants))
    numbers = _numbers(value if isinstance(value, list) else [value], constants)
    if len(numbers) == 1 and (joint.nq, joint.nv) == (2, 1):
        return np.array([math.cos(numbers[0]), math.sin(numbers[0])])
    if len(numbers) != joint.nq:
        raise _Mismatch(f"{joint.nq} numbers for a joint of type {joint.shortname()}")
    return np.array(numbers)


def _joint_v(joint: Any, value: Any, constants: Mapping[str, float]) -> np.ndarray:
    numbers = _numbers(value if isinstance(value, list) else [value], constants)
    if len(numbers) != joint.nv:
        raise _Mismatch(f"{joint.nv} numbers for a joint of type {joint.shortname()}")
    return np.array(numbers)


def _read_coordinates(table: _Table, key: str, model: pin.Model) -> np.ndarray:
    """q or v: all numbers in Pinocchio's order, or a table of joints, the others at their neutral value or at rest."""
    position = key == "q"
    result = pin.neutral(model) if position else np.zeros(model.nv)
    if not isinstance(table.content.get(key), dict):
        return np.array(table.get(key, _vector(result.size), list(result)))
    joints = table.table(key)
    assert joints is not None
    names = list(model.names)[1:]
    for name in joints.content:
        if name not in names:
            raise joints.error(name, f"there is no such joint; {_suggestion(name, names)}")
        joint = model.joints[names.index(name) + 1]
        start = joint.idx_q if position else joint.idx_v
        part = joints.get(name, partial(_joint_q if position else _joint_v, joint))
        result[start : start + part.size] = part
    return result


def _read_initial(table: _Table | None, scene: Scene, root: _Table) -> State:
    given = table if table is not None else _Table(root.file, "initial", {}, root.constants)
    given.allow("q", "v", "t", "free", "max_gap")
    q, v = (_read_coordinates(given, key, scene.model) for key in ("q", "v"))
    t = given.get("t", _number, 0.0)
    options = {"free": given.get("free", _texts, []), "max_gap": given.get("max_gap", _number, None)}
    return given.attempt("", scene.initial_state, q, v, t, **options)


# ---------------------------------------------------------------------------------------------------- the run

_SETTINGS: dict[str, Converter] = {
    "duration": _number,
    "rtol": _number,
    "atol": _number,
    "method": _text,
    "energies": _flag,
    "max_step": _end,
    "first_step": _number,
    "fixed_step": _number,
    "step": _number,
    "max_steps": _integer,
    "fallback": _text,
    "breakpoints": _numbers,
}


def _outputs(value: Any, constants: Mapping[str, float]) -> int | tuple[float, ...]:
    if isinstance(value, list):
        return tuple(_numbers(value, constants))
    if isinstance(value, bool) or not isinstance(value, int) or value < 2:
        raise _Mismatch("a number of output times, at least 2, or a list of times")
    return value


def _read_simulation(table: _Table | None) -> tuple[dict[str, Any], int | tuple[float, ...] | None]:
    if table is None:
        return {}, None
    table.allow("outputs", *_SETTINGS)
    settings = {key: table.get(key, convert, None) for key, convert in _SETTINGS.items()}
    outputs = table.get("outputs", _outputs, None)
    return {key: value for key, value in settings.items() if value is not None}, outputs
