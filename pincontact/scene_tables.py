"""Tables and values of a scene file: typed access, and errors that name the file and the key."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from .arguments import is_number
from .errors import ArgumentError, FrictionError, SceneFileError
from .expressions import compiled, evaluate

_REQUIRED: Any = object()
# Quaternions in files have a few digits; a norm further off than this is a mistake.
_NORM_TOLERANCE = 1e-3


class Mismatch(Exception):
    """A value is not what was expected; the text says what was."""


Converter = Callable[[Any, Mapping[str, float]], Any]


class Table:
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
        except Mismatch as mismatch:
            raise self.error(key, f"expected {mismatch}, got {value!r}") from None
        except (ArgumentError, FrictionError) as error:
            raise self.error(key, str(error)) from error

    def table(self, key: str) -> Table | None:
        """A table within this one, None if there is none."""
        if key not in self.content:
            return None
        inner = Table(self.file, self.path(key), self.content[key], self.constants)
        inner.name = key
        return inner

    def tables(self, key: str) -> list[Table]:
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
                raise self.error(key, f"unknown key; {suggestion(key, keys)}")


def suggestion(name: str, known: Collection[str]) -> str:
    by_case = {candidate.lower(): candidate for candidate in sorted(known)}
    close = difflib.get_close_matches(str(name).lower(), by_case, n=2)
    if close:
        return f"did you mean {' or '.join(by_case[match] for match in close)}?"
    return f"expected one of {', '.join(sorted(known))}"


# ---------------------------------------------------------------------------------------------------- values


def as_number(value: Any, constants: Mapping[str, float]) -> float:
    # formulas of what is not finite are refused where they are evaluated
    if isinstance(value, str) or (is_number(value) and math.isfinite(value)):
        return as_number_or_infinity(value, constants)
    raise Mismatch("a number (finite), or a formula of constants")


def as_number_or_infinity(value: Any, constants: Mapping[str, float]) -> float:
    """A number that may be infinite, as an end of an interval is."""
    if isinstance(value, str):
        return evaluate(value, constants)
    if not is_number(value):
        raise Mismatch("a number, or a formula of constants")
    return float(value)


def as_integer(value: Any, _: Mapping[str, float]) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise Mismatch("a whole number")
    return value


def _of_type(kind: type, what: str) -> Converter:
    def convert(value: Any, _: Mapping[str, float]) -> Any:
        if not isinstance(value, kind):
            raise Mismatch(what)
        return value

    return convert


as_flag, as_text = _of_type(bool, "true or false"), _of_type(str, "a text")


def as_texts(value: Any, _: Mapping[str, float]) -> list[str]:
    return [value] if isinstance(value, str) else listed(value, "a list of texts", kind=str)


def listed(value: Any, what: str, count: int | None = None, kind: type = object) -> list[Any]:
    """A list, of so many entries of this kind."""
    if not isinstance(value, list) or len(value) != (len(value) if count is None else count):
        raise Mismatch(what)
    if not all(isinstance(entry, kind) for entry in value):
        raise Mismatch(what)
    return value


def as_list(what: str, convert: Converter, count: int | None = None, kind: type = object) -> Converter:
    """A list, of so many entries of this kind, each converted."""
    return lambda value, constants: [convert(entry, constants) for entry in listed(value, what, count, kind)]


as_numbers = as_list("a list of numbers", as_number)
as_interval = as_list("[low, high]", as_number_or_infinity, 2)
as_rectangle = as_list("[[low, high], [low, high]]", as_interval, 2, list)
as_flags = as_list("two of true and false", as_flag, 2, bool)


def as_array(value: Any, constants: Mapping[str, float]) -> Any:
    """Numbers in lists in lists."""
    return [as_array(entry, constants) for entry in value] if isinstance(value, list) else as_number(value, constants)


def as_vector(count: int) -> Converter:
    return as_list(f"{count} numbers", as_number, count)


def as_formulas(count: int, *variables: str) -> Converter:
    """A function of the variables (and of t, if that occurs) with this many results; one result alone is a number."""

    def convert(value: Any, constants: Mapping[str, float]) -> Callable[..., Any]:
        listed = value if isinstance(value, list) else [value]
        if len(listed) != count or not all(isinstance(part, (str, int, float)) for part in listed):
            what = f"{count} formulas" if count > 1 else "a formula"
            raise Mismatch(f"{what} in {', '.join(variables)}")
        return compiled([str(part) for part in listed], variables, constants)

    return convert


def as_height(value: Any, constants: Mapping[str, float]) -> Callable[..., Any]:
    function = as_formulas(1, "x", "y", "t")(value, constants)
    if function.__code__.co_argcount == 3:  # type: ignore[attr-defined]
        return lambda x, y, t: function(x, y, t)[0]
    return lambda x, y: function(x, y)[0]


def as_profile(value: Any, constants: Mapping[str, float]) -> Any:
    """Points (r, z), or two formulas in s."""
    if isinstance(value, list) and value and all(isinstance(point, list) for point in value):
        return as_array(value, constants)
    return as_formulas(2, "s")(value, constants)


def as_side(value: Any, _: Mapping[str, float]) -> int:
    if isinstance(value, bool) or value not in (1, -1):
        raise Mismatch("1 or -1")
    return int(value)


def as_rotation(content: Mapping[str, Any], constants: Mapping[str, float]) -> np.ndarray:
    """From rpy (rad, about fixed x, y, z as in URDF) or quaternion (x, y, z, w)."""
    if "rpy" in content and "quaternion" in content:
        raise Mismatch("rpy or quaternion, not both")
    if "quaternion" in content:
        quaternion = np.array(as_vector(4)(content["quaternion"], constants))
        norm = float(np.linalg.norm(quaternion))
        if not abs(norm - 1.0) <= _NORM_TOLERANCE:
            raise Mismatch(f"a quaternion (x, y, z, w) of norm 1 instead of {norm:.6g}")
        return pin.Quaternion(*(quaternion / norm)[[3, 0, 1, 2]]).matrix()
    return pin.rpy.rpyToMatrix(*as_vector(3)(content.get("rpy", [0.0, 0.0, 0.0]), constants))


def as_pose(value: Any, constants: Mapping[str, float]) -> pin.SE3:
    if not isinstance(value, dict) or not set(value) <= {"xyz", "rpy", "quaternion"}:
        raise Mismatch("a placement {xyz = [..], rpy = [..] or quaternion = [..]}")
    translation = np.array(as_vector(3)(value.get("xyz", [0.0, 0.0, 0.0]), constants))
    return pin.SE3(as_rotation(value, constants), translation)


as_poses = as_list("a list of placements", as_pose)
