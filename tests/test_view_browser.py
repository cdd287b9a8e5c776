"""The page of a replay in a real browser, without a display: does it draw, seek and show what the run says.

Skipped where there is no Chromium; then the page has been checked as text and data only (`test_view.py`).
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from fake_run import HOP_START, SLIP_END, fake_run, placement

from pincontact.view import export_html

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
(() => {
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
      mode: element("contacts").rows[0].cells[1].textContent,
    };
  });
  const output = document.createElement("pre");
  output.id = "seen";
  output.textContent = JSON.stringify(seen);
  document.body.appendChild(output);
})();
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
