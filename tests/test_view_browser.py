"""The page of a replay in a real browser, without a display: does it draw, seek and show what the run says.

Skipped where there is no Chromium; then the page has been checked as text and data only (`test_view.py`).
"""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from fake_run import HOP_START, SLIP_END, fake_run, placement

import pincontact as pc
from pincontact.view import export_html
from pincontact.view.replay import MORE_PARTS, PARTS

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium found: pages are not opened, only read")

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
    "--window-size=800,600",
    "--virtual-time-budget=3000",
]

# Runs after the page's own script: looks at three.js' objects at some times, and leaves what it saw in the page.
PROBE = """
<script>
ready.then(() => {
  const base = ["meshcat", "pincontact"];
  const node = (...names) => viewer.scene_tree.find(base.concat(names)).object;
  const seen = TIMES.map((time) => {
    run(false);
    seek(time);
    viewer.scene.updateMatrixWorld();
    const body = node("bodies", "root"), arrow = node("contacts", "rim|floor", "normal");
    const trace = node("contacts", "rim|floor", "trace", "<object>");
    return {
      position: body.position.toArray(), quaternion: body.quaternion.toArray(), arrow: arrow.visible,
      stick: node("contacts", "rim|floor", "normal", "shaft", "stick").visible,
      trace: trace.geometry.drawRange.count, clock: element("clock").textContent,
      mode: element("contacts").querySelector("tr").cells[1].textContent,
    };
  });
  const output = document.createElement("pre");
  output.id = "seen";
  output.textContent = JSON.stringify(seen);
  document.body.appendChild(output);
});
</script>
"""

# Stands before all other scripts: what the page says to the console.
LISTEN = """
<script>
const said = [];
for (const kind of ["warn", "error"]) console[kind] = (...words) => said.push(words.join(" "));
window.addEventListener("error", (event) => said.push(event.message));
</script>
"""

# Which nodes under the drawing have triangles in the picture, with their colours.
LOOK = """
<script>
ready.then(() => {
  run(false);
  seek(info.duration);
  viewer.scene.updateMatrixWorld(true);
  viewer.camera.updateMatrixWorld(true);
  const inside = (mesh) => {
    mesh.geometry.computeBoundingSphere();
    const centre = mesh.geometry.boundingSphere.center.clone().applyMatrix4(mesh.matrixWorld).project(viewer.camera);
    return Math.abs(centre.x) < 1 && Math.abs(centre.y) < 1;
  };
  const seen = [];
  const walk = (node, path) => {
    if (!node.object.visible) return;
    const object = node.object;
    object.children.forEach((child) => {
      if (child.isMesh && child.visible && child.geometry.attributes.position.count > 0 && inside(child)) {
        seen.push([path, child.material.color.getHex(), child.geometry.drawRange.count]);
      }
    });
    for (const [name, child] of Object.entries(node.children)) walk(child, path + "/" + name);
  };
  walk(viewer.scene_tree.find(["meshcat", "pincontact"]), "");
  const bar = element("time").getBoundingClientRect();
  const output = document.createElement("pre");
  output.id = "seen";
  output.textContent = JSON.stringify({
    seen, said, note: element("note").textContent, slider: [bar.width, bar.height, bar.right, bar.bottom],
    rows: [...element("contacts").querySelectorAll("tr")].filter((row) => row.style.display !== "none").length,
    summary: element("contacts").querySelector("summary").textContent,
    ticks: [...element("ticks").querySelectorAll("button")].map((tick) => tick.title),
    width: window.innerWidth,
  });
  document.body.appendChild(output);
});
</script>
"""


def browse(page, folder, *flags):
    done = subprocess.run(
        [BROWSER, *FLAGS, f"--user-data-dir={folder}", *flags, page], capture_output=True, text=True, timeout=180
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_page_plays_in_a_browser(tmp_path):
    times = [0.3, 1.0, 2.1, 2.75]
    page = export_html(fake_run(), tmp_path / "run.html")
    text = page.read_text(encoding="utf-8")
    page.write_text(text.replace("</body>", PROBE.replace("TIMES", json.dumps(times)) + "</body>"), encoding="utf-8")
    dom = browse(page.as_uri(), tmp_path / "profile", "--dump-dom")
    found = re.search(r'<pre id="seen">(.*?)</pre>', dom, re.S)
    assert found, "the page's script did not come to its end"
    seen = json.loads(found.group(1))
    for time, state in zip(times, seen):
        expected = placement(time)
        # 2.1 s is the top of the hop; elsewhere the frames are 1/30 s apart and interpolated along chords: w^2 h^2 / 8
        # of 0.8 m is 1.4e-4 m.
        assert state["position"] == pytest.approx(expected.translation, abs=1e-3)
        x, y, z, w = state["quaternion"]
        axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        assert axis == pytest.approx(expected.rotation[:, 2], abs=1e-3)
        assert state["clock"] == f"t = {time:.3f} s"
    assert [state["mode"] for state in seen] == ["slip", "stick", "free", "stick"]
    assert [state["arrow"] for state in seen] == [True, True, False, True]
    assert [state["stick"] for state in seen if state["arrow"]] == [False, True, True]
    counts = [state["trace"] for state in seen]
    assert 0 < counts[0] < counts[1] < counts[2] < counts[3]
    assert SLIP_END < times[1] < HOP_START


def test_page_shows_the_wheel_and_its_arrow(tmp_path):
    image = pytest.importorskip("PIL.Image")
    page = export_html(fake_run(), tmp_path / "run.html", follow="rim/floor")
    picture = tmp_path / "page.png"
    browse(page.as_uri() + "#t=1.0", tmp_path / "profile", f"--screenshot={picture}")
    pixels = np.asarray(image.open(picture).convert("RGB"), dtype=int)
    red, green, blue = pixels[80:520].reshape(-1, 3).T
    # The wheel is orange and yellow, the arrow of a sticking contact green, the floor and the sky grey and blue.
    wheel = (red > green + 20) & (green > blue + 20)
    arrow = (green > red + 40) & (green > blue + 30)
    assert wheel.mean() > 0.02, "the wheel is not to be seen"
    assert arrow.sum() > 100, "the arrow is not to be seen"


# One scene of each kind


URDF = Path(__file__).parent.parent / "urdf"


def cart():
    """Meshes: STL, OBJ and Collada; the wheels roll."""
    scene = pc.Scene.from_urdf(URDF / "cart.urdf", floating_base=True)
    floor = scene.add_contour("floor", pc.Plane())
    for wheel in ("front_left", "front_right", "rear_left", "rear_right"):
        rim = scene.add_contour(wheel, pc.Sphere(0.1), wheel)
        scene.add_contact(wheel, rim, floor, friction=pc.Coulomb(0.6))
    v = np.r_[0.5, np.zeros(5), np.full(4, 5.0)]
    return scene, np.r_[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0, np.tile([1.0, 0.0], 4)], v


def ball():
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    surface, floor = scene.add_contour("ball", pc.Sphere(0.1), "ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("ball/floor", surface, floor, friction=pc.Coulomb(0.3))
    return scene, [0, 0, 0.1, 0, 0, 0, 1], [4.0, 0, 0, 0, 0, 0]


def wire():
    scene = pc.Scene.from_urdf(URDF / "bead.urdf", floating_base=True)
    bead, helix = scene.add_contour("bead", pc.Point(), "bead"), scene.add_contour("wire", pc.Helix(0.5, 0.2))
    scene.add_contact("bead/wire", bead, helix, friction=pc.Coulomb(0.1))
    return scene, [0.5, 0, 0, 0, 0, 0, 1], [0, -1.0, 0, 0, 0, 0]


def feet():
    """A block on 16 feet, with 16 more above the floor."""
    scene = pc.Scene.from_urdf(URDF / "block.urdf", floating_base=True)
    floor = scene.add_contour("floor", pc.Plane())
    for k in range(32):
        place = pin.SE3(np.eye(3), np.array([0.1 * (k % 4), 0.1 * (k // 4 % 4), 0.0 if k < 16 else 0.2]) - 0.15)
        scene.add_contact(f"foot {k}", scene.add_contour(f"foot {k}", pc.Sphere(0.02), "block", place), floor)
    return scene, [0, 0, 0.17, 0, 0, 0, 1], [0.5, 0, 0, 0, 0, 0]


@pytest.mark.parametrize(
    ("make", "drawn", "rows", "size"),
    [
        (cart, ["visuals", "contours", "traces", "normal", "point"], 4, (800, 600)),
        (ball, ["visuals", "contours", "traces", "normal", "friction", "point", "e1", "m3", "cone"], 1, (800, 600)),
        (wire, ["visuals", "contours", "trace", "normal", "point"], 1, (800, 600)),
        (feet, ["contours", "normal", "point"], 16, (800, 600)),
        (ball, ["visuals", "contours", "traces", "normal", "friction", "point"], 1, (390, 844)),
    ],
    ids=["meshes", "primitives", "wire", "32 contacts", "phone"],
)
def test_all_parts_are_in_the_picture(tmp_path, make, drawn, rows, size):
    scene, q, v = make()
    free = [name for name in scene.contacts if make is feet and int(name.split()[1]) >= 16]
    run = pc.simulate(scene, scene.initial_state(q, v, free=free), 0.2, rtol=1e-5, atol=1e-7)
    page = export_html(run, tmp_path / "run.html", show=[*PARTS, *(MORE_PARTS if "cone" in drawn else ())])
    text = page.read_text(encoding="utf-8").replace("<body>", "<body>" + LISTEN, 1)
    page.write_text(text.replace("</body>", LOOK + "</body>"), encoding="utf-8")
    dom = browse(page.as_uri(), tmp_path / "profile", f"--window-size={size[0]},{size[1]}", "--dump-dom")
    found = re.search(r'<pre id="seen">(.*?)</pre>', dom, re.S)
    assert found, "the page's script did not come to its end"
    state = json.loads(html.unescape(found.group(1)))
    assert state["said"] == [] and state["note"] == ""
    paths = [path for path, _, _ in state["seen"]]
    for part in drawn:
        assert any(part in path.split("/") for path in paths), (part, paths)
    bodies = {item.name for item in scene.visual_model.geometryObjects}
    assert bodies <= {path.split("/")[-1] for path in paths}
    assert state["rows"] == rows
    width, height, right, bottom = state["slider"]
    # room for a finger, within the window
    assert width > 150 and height >= 28 and right <= state["width"] and bottom <= size[1]
    if make is cart:
        colors = {path.split("/")[-1]: color for path, color, _ in state["seen"] if "visuals" in path}
        # of the URDF; of the Collada file, whose parts meshcat cannot merge
        assert colors["cart_0"] == 0xD83319 and colors["cart_1"] == 0x193FCC
        assert len(text.encode()) < 1.5e6
