"""One self-contained page: meshcat's viewer, the drawing, and a bar with time, speed and contact modes."""

from __future__ import annotations

import base64
import html
import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..errors import MissingExtraError

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>@TITLE@</title>
<style>
  body { margin: 0; font: 13px/1.45 system-ui, sans-serif; color: #1d2733; }
  #meshcat-pane { width: 100vw; height: 100vh; overflow: hidden; }
  .panel { position: absolute; background: rgba(255, 255, 255, 0.82); border-radius: 6px; }
  #contacts { left: 12px; top: 12px; padding: 6px 10px; border-collapse: separate; border-spacing: 8px 1px;
              font-variant-numeric: tabular-nums; }
  #contacts th { text-align: left; font-weight: 600; }
  #contacts td.number { text-align: right; min-width: 6.5em; }
  #contacts .swatch { display: inline-block; width: 0.75em; height: 0.75em; border-radius: 50%;
                      margin-right: 0.4em; }
  #bar { left: 12px; right: 12px; bottom: 12px; padding: 6px 12px; display: flex; gap: 12px;
         align-items: center; }
  #bar button { width: 5.5em; }
  #clock { min-width: 8em; text-align: right; font-variant-numeric: tabular-nums; }
  #track { position: relative; flex: 1; }
  #track input { width: 100%; margin: 0; display: block; }
  #ticks { position: absolute; left: 8px; right: 8px; top: -4px; height: 4px; pointer-events: none; }
  #ticks i { position: absolute; width: 2px; height: 6px; margin-left: -1px; background: #555; }
</style>
</head>
<body>
<div id="meshcat-pane"></div>
<table id="contacts" class="panel"></table>
<div id="bar" class="panel">
  <button id="play">pause</button>
  <div id="track"><div id="ticks"></div><input id="time" type="range" min="0" value="0"></div>
  <span id="clock"></span>
  <label>speed <select id="speed"></select></label>
  <label><input id="loop" type="checkbox"> repeat</label>
</div>
<script>@VIEWER@</script>
<script>
"use strict";
const info = @INFO@;
const commands = [
@COMMANDS@
];
const viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
for (const text of commands) {
  viewer.handle_command_bytearray(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)));
}
const animator = viewer.animator;
const element = (id) => document.getElementById(id);

const slider = element("time");
slider.max = info.duration;
slider.step = info.duration / 10000;
for (const [time, contact, kind] of info.events) {
  const tick = document.createElement("i");
  tick.title = (contact ? contact + ": " : "") + kind;
  tick.style.left = (100 * (time - info.start)) / info.duration + "%";
  element("ticks").appendChild(tick);
}

const speeds = [0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10];
if (!speeds.includes(info.speed)) speeds.push(info.speed);
for (const value of speeds.sort((a, b) => a - b)) {
  const label = value + "\\u00d7";
  element("speed").add(new Option(label, value, false, value === info.speed));
}
const applySpeed = () => { animator.mixer.timeScale = Number(element("speed").value); };
element("speed").addEventListener("change", applySpeed);
applySpeed();

const rows = info.contacts.map((contact) => {
  const row = element("contacts").insertRow();
  const head = document.createElement("th");
  head.textContent = contact.name;
  head.title = "the arrows show the force on " + contact.on;
  row.appendChild(head);
  const mode = row.insertCell();
  const swatch = document.createElement("span");
  swatch.className = "swatch";
  const word = document.createElement("span");
  mode.append(swatch, word);
  const normal = row.insertCell(), friction = row.insertCell(), on = row.insertCell();
  normal.className = friction.className = "number";
  on.textContent = "on " + contact.on;
  return { contact, swatch, word, normal, friction };
});
if (rows.length === 0) element("contacts").style.display = "none";

function show(time) {
  slider.value = time;
  element("clock").textContent = "t = " + (info.start + time).toFixed(3) + " s";
  const frame = Math.max(0, Math.min(info.frames - 1, Math.floor(time / info.step + 1e-6)));
  for (const row of rows) {
    const mode = row.contact.mode[frame];
    row.word.textContent = info.modes[mode].name;
    row.swatch.style.background = info.modes[mode].color;
    row.normal.textContent = "N = " + row.contact.normal[frame].toPrecision(4) + " N";
    row.friction.textContent = "T = " + row.contact.friction[frame].toPrecision(4) + " N";
  }
}

let running = false;
function run(on) {
  running = on;
  if (running) animator.play(); else animator.pause();
  element("play").textContent = running ? "pause" : "play";
}
function seek(time) {
  animator.seek(time);
  animator.display_progress(time);
  show(time);
}
element("play").addEventListener("click", () => run(!running));
slider.addEventListener("input", () => seek(Number(slider.value)));
document.addEventListener("keydown", (event) => {
  if (event.code === "Space" && event.target === document.body) { event.preventDefault(); run(!running); }
});
function follow() {
  requestAnimationFrame(follow);
  // The scrubber and buttons of meshcat's own panel may have moved the animation, too.
  if (animator.playing !== running) {
    if (running && element("loop").checked) run(true);
    else { running = animator.playing; element("play").textContent = running ? "pause" : "play"; }
  }
  if (Number(slider.value) !== animator.time) show(animator.time);
}
run(true);
// "page.html#t=1.5" opens the page paused at that time.
const wanted = /[#&]t=([-+.0-9e]+)/.exec(location.hash);
if (wanted) {
  run(false);
  seek(Math.max(0, Math.min(info.duration, Number(wanted[1]) - info.start)));
} else {
  show(0);
}
follow();
</script>
</body>
</html>
"""


def viewer_script() -> str:
    """The viewer that comes with meshcat, as one script; read without importing meshcat.

    Raises MissingExtraError when meshcat or its script is not installed.
    """
    spec = find_spec("meshcat")
    if spec is None or spec.origin is None:
        raise MissingExtraError("a replay needs meshcat, which is not installed: pip install meshcat")
    path = Path(spec.origin).parent / "viewer" / "dist" / "main.min.js"
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise MissingExtraError(f"this installation of meshcat has no viewer script: {error}") from error


def _script_safe(text: str) -> str:
    """Text that cannot end the script element which it stands in."""
    return text.replace("</", "<\\/").replace("<!--", "<\\!--")


def render_page(commands: list[dict[str, Any]], info: dict[str, Any], title: str) -> str:
    """The page as text.

    commands: meshcat's, in order; info: what the bar shows (see `replay.page_info`); title: plain text.
    """
    import umsgpack  # type: ignore[import-untyped]

    packed = [base64.b64encode(umsgpack.packb(command)).decode("ascii") for command in commands]
    parts = {
        "@TITLE@": html.escape(title),
        "@VIEWER@": _script_safe(viewer_script()),
        "@INFO@": _script_safe(json.dumps(info, allow_nan=False)),
        "@COMMANDS@": ",\n".join(f'"{text}"' for text in packed),
    }
    page = _PAGE
    # The big parts last and once each: a part's text is never searched for the next one's mark.
    pieces = []
    for mark, text in parts.items():
        before, page = page.split(mark)
        pieces += [before, text]
    return "".join([*pieces, page])
