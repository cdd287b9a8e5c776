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


def _own(name: str) -> str:
    """A file beside this one."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


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
        "@SCRIPT@": _script_safe(_own("page.js")),
    }
    page = _own("page.htm")
    # A part's text is never searched for the next one's mark.
    pieces = []
    for mark, text in parts.items():
        before, page = page.split(mark)
        pieces += [before, text]
    return "".join([*pieces, page])
