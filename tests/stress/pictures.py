"""Pictures of robots people bring: python tests/stress/pictures.py [robot ...] [--folder FOLDER]

Every robot of example-robot-data is drawn in Chromium twice: as a replay, and by Pinocchio's own `MeshcatVisualizer`
alone, Collada files that meshcat cannot merge included, under the same light, from the same side. Prints a table: size
of the page in MB, seconds to write it, commands that could not be carried out in the replay (0 is right) and in
Pinocchio's drawing, pixels that show the robot in each, and how much of Pinocchio's robot the replay shows. The
pictures are left in the folder.
"""

from __future__ import annotations

import argparse
import html
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
from robots import FREE, ROBOTS, _posture, robots_folder

import pincontact as pc
from pincontact.view import robot as drawn_robot
from pincontact.view.replay import PARTS

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=640,480",
    "--virtual-time-budget=4000",
]


def still(folder: Path, file: str) -> SimpleNamespace:
    """A robot in its reference configuration, as a run of one frame."""
    urdf = str(folder / f"{file}.urdf")
    model = pin.buildModelFromUrdf(urdf, pin.JointModelFreeFlyer()) if file in FREE else pin.buildModelFromUrdf(urdf)
    places = [str(folder.parent.parent), str(folder.parent), str(folder)]
    visual = pin.buildGeomFromUrdf(model, urdf, pin.GeometryType.VISUAL, package_dirs=places)
    q = _posture(model, folder / file.split("/")[0] / "srdf")
    return SimpleNamespace(
        scene=pc.Scene(model, visual),
        t=np.array([0.0, 0.2]),
        q=np.array([q, q]),
        v=np.zeros((2, model.nv)),
        contacts={},
        events=[],
    )


def picture(page: Path, folder: Path) -> np.ndarray | None:
    """(height, width, 3) what the browser shows of a page; None where it does not come to an end."""
    from PIL import Image

    image = page.with_suffix(".png")
    image.unlink(missing_ok=True)
    profile = f"--user-data-dir={folder / 'profile'}"
    try:
        command = [BROWSER, *FLAGS, profile, f"--screenshot={image}", f"{page.as_uri()}#t=0"]
        subprocess.run(command, capture_output=True, timeout=120)
    except subprocess.TimeoutExpired:
        return None
    return np.asarray(Image.open(image).convert("RGB"), dtype=int)[20:380] if image.exists() else None


def failed(page: Path, folder: Path) -> int:
    """Commands that a page could not carry out."""
    command = [BROWSER, *FLAGS, f"--user-data-dir={folder / 'profile'}", "--dump-dom", page.as_uri()]
    try:
        dom = subprocess.run(command, capture_output=True, text=True, timeout=120).stdout
    except subprocess.TimeoutExpired:
        return -1
    note = re.search(r'<div id="note"[^>]*>(.*?)</div>\s*<div id="bar"', dom, re.S)
    return len(re.findall("not drawn", html.unescape(note.group(1)))) if note else -1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    parser.add_argument("--folder", type=Path, default=Path("pictures"))
    options = parser.parse_args()
    share, faults = robots_folder(), 0
    if share is None or BROWSER is None:
        print("example-robot-data and Chromium are needed")
        return 2
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    print(
        f"{'robot':26s} {'MB':>5s} {'s':>5s} {'failed':>6s} {'theirs':>6s} {'pixels':>7s} {'theirs':>7s} {'shown':>6s}"
    )
    for name in options.robots:
        run = still(share, ROBOTS[name])
        page, other, empty = (folder / f"{name}{part}.html" for part in ("", "_pinocchio", "_empty"))
        start = time.perf_counter()
        pc.export_html(run, page)
        seconds = time.perf_counter() - start
        merges, drawn_robot._merges = drawn_robot._merges, lambda path: True
        try:
            pc.export_html(run, other)
        finally:
            drawn_robot._merges = merges
        pc.export_html(run, empty, show=[part for part in PARTS if part != "robot"])
        for x in (page, other, empty):
            # what the page says would hide the robot
            text = x.read_text(encoding="utf-8")
            x.write_text(text.replace("</head>", "<style>#note { visibility: hidden; }</style></head>", 1), "utf-8")
        images = [picture(x, folder) for x in (page, other, empty)]
        misses = [failed(x, folder) for x in (page, other)]
        pixels = [0, 0]
        shown = float("nan")
        if all(image is not None for image in images):
            masks = [np.abs(image - images[2]).sum(axis=2) > 30 for image in images[:2]]
            pixels = [int(mask.sum()) for mask in masks]
            shown = float((masks[0] & masks[1]).sum() / max(1, pixels[1]))
        faults += misses[0] != 0 or pixels[0] < 300
        print(
            f"{name:26s} {page.stat().st_size / 1e6:5.1f} {seconds:5.1f} {misses[0]:6d} {misses[1]:6d} "
            f"{pixels[0]:7d} {pixels[1]:7d} {shown:6.2f}",
            flush=True,
        )
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
