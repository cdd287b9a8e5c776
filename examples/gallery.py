"""The pictures of the README: runs examples, opens their replays in a browser without a display, and keeps the view.

Needs a checkout, Chromium (or Chrome) and Pillow, which Matplotlib brings; examples whose robots are not installed are
left out.

    python examples/gallery.py [NAME ...] [--folder FOLDER] [--html FILE]  # pincontact/docs/figures by default
"""

from __future__ import annotations

import argparse
import base64
import importlib
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
FIGURES = HERE.parent / "pincontact" / "docs" / "figures"
WINDOW, PICTURE = (900, 560), (450, 280)
LARGEST = 80_000  # bytes
# The example, and the time in s at which it is shown.
SHOWN = {
    "rover": 2.6,
    "quadruped": 1.1,
    "wiping_arm": 0.9,
    "panda_rolls_ball": 1.6,
    "bicycle": 1.0,
    "rattleback": 2.0,
    "go2": 0.6,
    "talos": 2.0,
    "mujoco_ant": 1.0,
    "mecanum": 1.0,
}
# Without panels, with the camera as near as it sees all that moves, and the sun's shadows there, too.
CLOSE_UP = """(() => {
  const drawing = viewer.scene_tree.find(["meshcat", "pincontact"]), points = [], camera = viewer.camera;
  const look = (node) => {
    for (const child of node.object.children) {
      if (!child.isMesh || !child.visible) continue;
      const at = child.geometry.attributes.position, step = Math.max(1, Math.floor(at.count / 500));
      for (let i = 0; i < at.count; i += step) {
        points.push(camera.position.clone().fromBufferAttribute(at, i).applyMatrix4(child.matrixWorld));
      }
    }
    for (const [name, child] of Object.entries(node.children)) {
      if (child.object.visible && !["universe", "traces", "trace"].includes(name)) look(child);
    }
  };
  viewer.scene.updateMatrixWorld(true);
  look(drawing);
  const low = points[0].clone(), high = low.clone();
  points.forEach((point) => { low.min(point); high.max(point); });
  const middle = low.add(high).multiplyScalar(0.5);
  const [right, up, back] = [0, 1, 2].map((k) => middle.clone().setFromMatrixColumn(camera.matrixWorld, k));
  const slope = 0.9 * Math.tan(0.5 * camera.fov * Math.PI / 180);
  const distance = Math.max(...points.map((point) => {
    const away = point.sub(middle);
    const across = Math.max(Math.abs(away.dot(right)) / camera.aspect, Math.abs(away.dot(up)));
    return away.dot(back) + across / slope;
  }));
  const sun = viewer.scene_tree.find(["Lights", "Sun"]).object.children[0];
  for (const object of [drawing.object, sun]) object.position.sub(object.parent.worldToLocal(middle.clone()));
  sun.target.position.sub(sun.parent.worldToLocal(middle.clone()));
  sun.target.updateMatrixWorld();
  camera.position.setLength(distance);
  viewer.controls.update();
  for (const panel of document.querySelectorAll(".panel, .dg")) panel.style.display = "none";
  viewer.set_dirty();
})()"""


def example(name: str) -> Any:
    """The module of an example."""
    if str(HERE) not in sys.path:
        sys.path.insert(0, str(HERE))
    return importlib.import_module(name)


def replay(name: str, folder: Path) -> Path:
    """Run an example and return the page that it writes."""
    page = folder / f"{name}.html"
    example(name).main(html=page)
    return page


def picture(page: Path, time: float, browser: Any, target: Path) -> None:
    """What the page shows at a time, as a small PNG. browser: that of the tests."""
    from PIL import Image

    browser.open(page, f"#t={time}")
    browser.run(CLOSE_UP)
    save(Image.fromarray(browser.picture().astype("uint8")).resize(PICTURE, Image.Resampling.LANCZOS), target)


def save(image: Any, target: Path) -> None:
    """Write a PNG with as many colours as its size allows; the few pixels of an arrow keep theirs."""
    from PIL import Image

    for colors in (None, 256, 128, 64, 32):
        fewer = image if colors is None else image.quantize(colors, Image.Quantize.MAXCOVERAGE)
        fewer.save(target, optimize=True)
        if target.stat().st_size <= LARGEST:
            print(f"{target} ({target.stat().st_size / 1000:.0f} kB)")
            return
    raise ValueError(f"{target} has {target.stat().st_size} bytes with 32 colours, more than {LARGEST}")


def plots(folder: Path, target: Path) -> None:
    """The disk that slides and comes to roll: its forces, its way through the cone, its slip speed and its energy."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from PIL import Image

    import pincontact as pc

    disk = example("rolling_disk")
    scene = disk.disk_on(pc.Plane(), pc.Coulomb(mu=0.2))
    state = scene.initial_state(*disk.tilted(1.2, 5.0, sliding=1.0))
    run = pc.simulate(scene, state, 2.0, rtol=1e-9, energies=True)
    figure, grid = pyplot.subplots(2, 2, figsize=(9.0, 5.0), layout="constrained")
    run.plot(kinds=["forces", "cone", "slip", "energy"], axes=grid.reshape(-1))
    figure.savefig(folder / "plots.png", dpi=100)
    save(Image.open(folder / "plots.png").convert("RGB"), target)


def page_of_pictures(folder: Path, target: Path) -> Path:
    """Write the pictures of the gallery that are in a folder into one page, and return its path."""
    pictures = [file for file in sorted(folder.glob("*.png")) if file.stem in {*SHOWN, "plots"}]
    figures = [
        f'<figure><img alt="{file.stem}" src="data:image/png;base64,{base64.b64encode(file.read_bytes()).decode()}">'
        f"<figcaption>{file.stem}</figcaption></figure>"
        for file in pictures
    ]
    head = '<!doctype html><html lang="en"><meta charset="utf-8"><title>Gallery</title>'
    style = "<style>body { display: flex; flex-wrap: wrap; font-family: sans-serif }</style>"
    target.write_text("\n".join([head, style, *figures, "</html>\n"]), encoding="utf-8")
    return target


def main(target: Path = FIGURES, html: Path | None = None, names: Iterable[str] = ()) -> None:
    sys.path.insert(0, str(HERE.parent / "tests"))
    from browser import Browser

    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name, Browser(Path(name), WINDOW) as browser:
        folder = Path(name)
        for title in names or SHOWN:
            try:
                page = replay(title, folder)
            except (RuntimeError, ImportError) as error:
                print(f"left out {title}: {error}")
                continue
            picture(page, SHOWN[title], browser, target / f"{title}.png")
        if not names:
            plots(folder, target / "plots.png")
    if html is not None:
        print(f"wrote {page_of_pictures(target, html)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="of examples; all, if not given")
    parser.add_argument("--folder", type=Path, default=FIGURES)
    parser.add_argument("--html", type=Path, metavar="FILE", help="write all pictures into one HTML file")
    arguments = parser.parse_args()
    main(arguments.folder, arguments.html, arguments.names)
