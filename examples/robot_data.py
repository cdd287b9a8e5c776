"""Where the packages of the extra `robots` keep their files; run, the robots of a description and a look at one.

    python examples/robot_data.py [DESCRIPTION] [--html FILE]

The first URDF of the description (Go2's if none is given) swings freely from its root, without contacts.
"""

from __future__ import annotations

import argparse
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import pincontact as pc


class RobotDataMissing(RuntimeError):
    """A description is not installed."""


def robot_data(description: str) -> Path:
    """The folder that holds example-robot-data with this robot. Raises RobotDataMissing where there is none."""
    path = _located("example-robot-data", "cmeel.prefix/share")
    if not (path / "example-robot-data" / "robots" / description).is_dir():
        raise RobotDataMissing(f'{description} is missing: pip install "pincontact[robots]" (example-robot-data).')
    return path


def gymnasium_model(file: str) -> Path:
    """A MuJoCo model of Gymnasium's. Raises RobotDataMissing where there is none."""
    path = _located("gymnasium", f"gymnasium/envs/mujoco/assets/{file}")
    if not path.is_file():
        raise RobotDataMissing(f'{file} is missing: pip install "pincontact[robots,mjcf]" (gymnasium).')
    return path


def _located(package: str, file: str) -> Path:
    try:
        return Path(str(metadata.distribution(package).locate_file(file)))
    except metadata.PackageNotFoundError:
        return Path(file)


def main(description: str = "go2_description", html: Path | None = None) -> dict[str, Any]:
    share = robot_data(description)
    files = sorted((share / "example-robot-data" / "robots" / description).rglob("*.urdf"))
    for file in files:
        print(file)
    scene = pc.Scene.from_urdf(files[0], package_dirs=share)
    # knees that cannot be straight are as straight as they can
    q = np.clip(pin.neutral(scene.model), scene.model.lowerPositionLimit, scene.model.upperPositionLimit)
    run = pc.simulate(scene, scene.initial_state(q), 0.5, rtol=1e-5, atol=1e-7)
    print(run.message)
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return {"files": [file.name for file in files], "status": run.status}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("description", nargs="?", default="go2_description", help="a folder of example-robot-data")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    arguments = parser.parse_args()
    try:
        main(arguments.description, arguments.html)
    except RobotDataMissing as error:
        raise SystemExit(str(error)) from None
