"""One self-contained page: meshcat's viewer, the drawing, and a bar with time, speed and contact modes."""

from __future__ import annotations

import base64
import gzip
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
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>@TITLE@</title>
<style>
  body { margin: 0; font: 13px/1.45 system-ui, sans-serif; color: #1d2733; }
  #meshcat-pane { width: 100vw; height: 100vh; height: 100dvh; overflow: hidden; }
  .panel { background: rgba(255, 255, 255, 0.86); border-radius: 6px; padding: 4px 10px; pointer-events: auto; }
  body > .dg.main .close-button { background: rgba(255, 255, 255, 0.86); color: #1d2733; text-shadow: none; }
  #contacts { position: absolute; z-index: 2; left: 12px; top: 12px; max-width: calc(100vw - 44px); max-height: 45vh;
              overflow: auto; }
  #contacts summary { cursor: pointer; }
  #contacts table { border-spacing: 8px 1px; font-variant-numeric: tabular-nums; }
  #contacts th { text-align: left; font-weight: 600; }
  #contacts td.number { text-align: right; min-width: 6.5em; }
  .swatch { display: inline-block; width: 0.75em; height: 0.75em; border-radius: 50%; margin-right: 0.4em; }
  .line { display: inline-block; width: 1em; height: 3px; margin-right: 0.4em; vertical-align: middle; }
  #low { position: absolute; z-index: 2; left: 12px; right: 12px; bottom: 12px; pointer-events: none;
         display: flex; flex-direction: column; gap: 8px; }
  #plots { align-self: flex-end; }
  body.beside #meshcat-pane { width: calc(100vw - 466px); }
  body.beside #plots canvas { width: 420px; height: min(420px, 60vh); }
  #plots summary { cursor: pointer; }
  #plots canvas { display: block; width: min(420px, 40vw); height: min(260px, 36vh); cursor: crosshair; }
  #bar { padding: 6px 12px; display: flex; flex-wrap: wrap; gap: 4px 12px; align-items: center; }
  #bar button#play { width: 5.5em; min-height: 32px; }
  #clock { min-width: 8em; text-align: right; font-variant-numeric: tabular-nums; }
  #track { position: relative; flex: 1 1 220px; padding-top: 16px; }
  #track input { width: 100%; margin: 0; display: block; height: 28px; touch-action: none; }
  #ticks { position: absolute; left: 8px; right: 8px; top: 0; height: 18px; }
  #ticks button { position: absolute; top: 12px; width: 12px; height: 12px; margin: 0 0 0 -6px; padding: 0; border: 0;
                  background: linear-gradient(#555, #555) center / 2px 100% no-repeat; cursor: pointer; }
  #ticks span { position: absolute; top: -2px; font-size: 11px; line-height: 14px; white-space: nowrap;
                transform: translateX(-50%); pointer-events: none; }
  #note { align-self: flex-start; max-width: 50vw; display: none; }
  @media (max-width: 640px) {
    #track { flex: 1 1 100%; order: -1; }
    #track input { height: 40px; }
    #contacts { max-height: 26vh; font-size: 12px; }
    #contacts td.number { min-width: 5em; }
    #contacts .on { display: none; }
    #plots canvas { width: calc(100vw - 44px); height: 22vh; }
    body > .dg.main { display: none; }
    #clock { min-width: 7em; flex: 1; }
  }
</style>
</head>
<body>
<div id="meshcat-pane"></div>
<details id="contacts" class="panel" open><summary></summary><table></table></details>
<div id="low">
<div id="note" class="panel"></div>
<details id="plots" class="panel"><summary>forces</summary><canvas></canvas></details>
<div id="bar" class="panel">
  <button id="play">pause</button>
  <div id="track"><div id="ticks"></div><input id="time" type="range" min="0" value="0" aria-label="time"></div>
  <span id="clock"></span>
  <label>speed <select id="speed"></select></label>
  <label><input id="loop" type="checkbox"> repeat</label>
</div>
</div>
<script>@VIEWER@</script>
<script>
"use strict";
const info = @INFO@;
// Where in the packed bytes each command lies; what several commands have in common is there once.
const commands = @COMMANDS@;
const packed = "@PACKED@";
</script>
<script>@SCRIPT@</script>
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


def pack_commands(commands: list[dict[str, Any]]) -> tuple[list[list[int]], bytes]:
    """Commands as MessagePack, compressed, with equal objects stored once: the four legs of a robot are one mesh.

    Returns for each command the borders of its pieces, [start, end, start, end], in the bytes before compression,
    and these bytes compressed (gzip).
    """
    import umsgpack  # type: ignore[import-untyped]

    pieces: dict[bytes, int] = {}
    places: list[list[int]] = []
    size = 0
    for command in commands:
        head = {key: value for key, value in command.items() if key != "object"}
        start = umsgpack.packb(head)
        if "object" in command:
            # One more entry of the map: its number is in the low half of the first byte.
            start = bytes([start[0] + 1]) + start[1:] + umsgpack.packb("object")
        place = []
        for piece in (start, *([umsgpack.packb(command["object"])] if "object" in command else [])):
            if piece not in pieces:
                pieces[piece] = size
                size += len(piece)
            place += [pieces[piece], pieces[piece] + len(piece)]
        places.append(place)
    # No time stamp: pages of one run are equal.
    return places, gzip.compress(b"".join(pieces), 6, mtime=0)


def render_page(commands: list[dict[str, Any]], info: dict[str, Any], title: str) -> str:
    """The page as text.

    commands: meshcat's, in order; info: what the bar shows (see `replay.page_info`); title: plain text.
    """
    places, packed = pack_commands(commands)
    parts = {
        "@TITLE@": html.escape(title),
        "@VIEWER@": _script_safe(viewer_script()),
        "@INFO@": _script_safe(json.dumps(info, allow_nan=False, separators=(",", ":"))),
        "@COMMANDS@": json.dumps(places, separators=(",", ":")),
        "@PACKED@": base64.b64encode(packed).decode("ascii"),
        "@SCRIPT@": _script_safe((Path(__file__).parent / "page.js").read_text(encoding="utf-8")),
    }
    page = _PAGE
    # A part's text is never searched for the next one's mark.
    pieces = []
    for mark, text in parts.items():
        before, page = page.split(mark)
        pieces += [before, text]
    return "".join([*pieces, page])
