"""Where the packages of the extra `robots` keep their files."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path


class RobotDataMissing(RuntimeError):
    """A description is not installed."""


def robot_data(description: str) -> Path:
    """The folder that holds example-robot-data with this robot. Raises RobotDataMissing where there is none."""
    path = _located("example-robot-data", "cmeel.prefix/share")
    if not (path / "example-robot-data" / "robots" / description).is_dir():
        raise RobotDataMissing(f'{description} is missing: pip install "pincontact[robots]" (example-robot-data)')
    return path


def gymnasium_model(file: str) -> Path:
    """A MuJoCo model of Gymnasium's. Raises RobotDataMissing where there is none."""
    path = _located("gymnasium", f"gymnasium/envs/mujoco/assets/{file}")
    if not path.is_file():
        raise RobotDataMissing(f'{file} is missing: pip install "pincontact[robots,mjcf]" (gymnasium)')
    return path


def _located(package: str, file: str) -> Path:
    try:
        return Path(str(metadata.distribution(package).locate_file(file)))
    except metadata.PackageNotFoundError:
        return Path(file)
