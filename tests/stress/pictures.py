"""Pictures of robots people bring: python tests/stress/pictures.py [robot ...] [--folder FOLDER]

Every robot of example-robot-data is drawn in Chromium twice: as a replay, and by what Pinocchio's own
`MeshcatVisualizer` sends for the same configuration, under the same light, from the same side. Prints a table: size of
the page in MB, seconds to write it and to open it, commands that the browser could not carry out for the replay (0 is
right) and for Pinocchio's drawing, pixels that show the robot, and how far both pictures agree: pixels that show it in
both, of those that show it in either. The pictures are left in the folder.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
from browser import PROGRAM, Browser
from robots import FREE, ROBOTS, _posture, robots_folder

import pincontact as pc
from pincontact.view.page import render_page
from pincontact.view.replay import compose, page_info
from pincontact.view.stage import ROOT


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


def look(browser: Browser, page: Path) -> tuple[np.ndarray | None, int]:
    """What the browser shows of a page, (height, width, 3), None where it does not come to an end; and how many
    commands the page could not carry out, -1 where it does not say."""
    from PIL import Image

    try:
        browser.open(page, "#t=0", listen=False)
        failed = len(re.findall("not drawn", browser.run("element('note').textContent")))
        browser.run("[element('note'), element('bar')].forEach((panel) => { panel.style.visibility = 'hidden'; })")
        image = browser.picture()
    except (RuntimeError, TimeoutError):
        return None, -1
    Image.fromarray(image.astype(np.uint8)).save(page.with_suffix(".png"))
    return image[20:], failed


def write_pinocchios(run: SimpleNamespace, page: Path) -> None:
    """What Pinocchio's `MeshcatVisualizer` sends by itself, under the light and the camera of the replay."""
    import meshcat
    from pinocchio.visualize import MeshcatVisualizer

    sent: list[dict[str, Any]] = []
    window = SimpleNamespace(send=lambda command: sent.append(command.lower()))
    visualizer = MeshcatVisualizer(run.scene.model, None, run.scene.visual_model)
    visualizer.initViewer(meshcat.Visualizer.view_into(window, meshcat.path.Path(ROOT[:1])))
    visualizer.loadViewerModel(ROOT[1])
    visualizer.display(run.q[0])
    for command in sent:
        command.pop("materials", None)
    picture = compose(run, 30.0, 1.0, 3000, None, None, ())
    *commands, animation = picture.commands(environment=True)
    # the first command deletes what is there
    page.write_text(render_page([*commands, *sent, animation], page_info(picture, run, 1.0), "Pinocchio's"), "utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    parser.add_argument("--folder", type=Path, default=Path("pictures"))
    options = parser.parse_args()
    share, faults = robots_folder(), 0
    if share is None or PROGRAM is None:
        print("example-robot-data and Chromium are needed")
        return 2
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    print(f"{'robot':26s} {'MB':>5s} {'s':>5s} {'open':>5s} {'failed':>6s} {'theirs':>6s} {'pixels':>7s} {'agree':>6s}")
    with tempfile.TemporaryDirectory() as profile, Browser(Path(profile), (640, 480)) as browser:
        for name in options.robots:
            run = still(share, ROBOTS[name])
            page, other, empty = (folder / f"{name}{part}.html" for part in ("", "_pinocchio", "_empty"))
            start = time.perf_counter()
            pc.export_html(run, page)
            written = time.perf_counter()
            image, failed = look(browser, page)
            opened = time.perf_counter()
            write_pinocchios(run, other)
            pc.export_html(run, empty, show=[])
            theirs, their_failed = look(browser, other)
            background, _ = look(browser, empty)
            pixels, agreement = 0, float("nan")
            if image is not None and theirs is not None and background is not None:
                mask, their_mask = (np.abs(seen - background).sum(axis=2) > 30 for seen in (image, theirs))
                pixels = int(mask.sum())
                agreement = float((mask & their_mask).sum() / max(1, (mask | their_mask).sum()))
            faults += failed != 0 or pixels < 300
            print(
                f"{name:26s} {page.stat().st_size / 1e6:5.1f} {written - start:5.1f} {opened - written:5.1f} "
                f"{failed:6d} {their_failed:6d} {pixels:7d} {agreement:6.2f}",
                flush=True,
            )
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
