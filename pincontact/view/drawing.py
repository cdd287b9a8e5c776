"""Meshcat's drawing commands as plain data, with animation tracks packed as binary arrays.

The same list of commands is sent to a live viewer or written into a page. Nothing of meshcat is imported here: its
Python classes store an animation key by key and always interpolate smoothly; as plain data a track is two arrays.
"""

from __future__ import annotations

import uuid
from typing import Any

import numpy as np

from .meshes import Mesh

# Codes of typed arrays in meshcat's MessagePack dialect.
_UINT8, _INT16, _UINT16, _UINT32, _FLOAT32 = 0x12, 0x13, 0x14, 0x16, 0x17
_ARRAYS: dict[int, tuple[str, Any]] = {
    _UINT8: ("Uint8Array", np.uint8),
    _INT16: ("Int16Array", "<i2"),
    _UINT16: ("Uint16Array", "<u2"),
    _UINT32: ("Uint32Array", "<u4"),
    _FLOAT32: ("Float32Array", "<f4"),
}
# The viewer does not care for an animation's path; the server does: it informs a browser that connects later about
# its nodes in the order of their making, and the animation has to come after all it binds to.
_ANIMATION_NODE = "/animation"
# three.js: draw both faces, or only the front one.
BOTH_SIDES, FRONT_SIDE = 2, 0


def color_number(rgb: Any) -> int:
    """0xRRGGBB of a colour with components in [0, 1]."""
    red, green, blue = (round(255 * float(np.clip(c, 0.0, 1.0))) for c in tuple(rgb)[:3])
    return (red << 16) | (green << 8) | blue


def _typed(array: np.ndarray, code: int) -> Any:
    import umsgpack  # type: ignore[import-untyped]

    return umsgpack.Ext(code, np.ascontiguousarray(array, dtype=_ARRAYS[code][1]).tobytes())


def _attribute(array: np.ndarray, code: int, normalized: bool = False) -> dict[str, Any]:
    return {
        "itemSize": 1 if array.ndim == 1 else array.shape[1],
        "type": _ARRAYS[code][0],
        "array": _typed(array, code),
        "normalized": normalized,
    }


class Drawing:
    """A scene and one animation of it, as meshcat commands in the order in which they must be carried out.

    Paths are tuples of names; a name may contain any character, also the '/' that separates meshcat's.
    """

    def __init__(self, root: tuple[str, ...] = ()) -> None:
        self.root = root
        self.commands: list[dict[str, Any]] = []
        self._clips: dict[str, list[dict[str, Any]]] = {}
        self._names: dict[str, str] = {}

    def path(self, *names: str) -> str:
        """Meshcat's path of these names under the root."""
        return "/" + "/".join(self._escape(name) for name in (*self.root, *names))

    def _escape(self, name: str) -> str:
        # Two names must not become one when their slashes go.
        plain = name.replace("/", "|") or "unnamed"
        while self._names.setdefault(plain, name) != name:
            plain += "'"
        return plain

    def add(self, kind: str, path: str, **content: Any) -> None:
        self.commands.append({"type": kind, "path": path, **content})

    def delete(self, path: str) -> None:
        self.add("delete", path)

    def transform(self, path: str, matrix: np.ndarray) -> None:
        """Place a node; matrix: (4, 4), may carry a scale."""
        self.add("set_transform", path, matrix=[float(x) for x in matrix.T.reshape(-1)])

    def set_property(self, path: str, name: str, value: Any) -> None:
        self.add("set_property", path, property=name, value=value)

    def mesh(self, path: str, mesh: Mesh, color: Any = (1.0, 1.0, 1.0), shadows: bool = True, **material: Any) -> None:
        """Draw triangles.

        color: RGB or RGBA in [0, 1], multiplied by the mesh's own colours if it has any; shadows: whether it casts
        and receives them; material: further properties of three.js' material.
        """
        # Normals and colours need no more digits than the eye has.
        attributes = {
            "position": _attribute(mesh.vertices, _FLOAT32),
            "normal": _attribute(np.rint(32767.0 * mesh.normals), _INT16, normalized=True),
        }
        if mesh.colors is not None:
            colors = np.rint(255.0 * np.clip(mesh.colors, 0.0, 1.0))
            attributes["color"] = _attribute(colors, _UINT8, normalized=True)
        code = _UINT16 if len(mesh.vertices) <= 0xFFFF else _UINT32
        geometry = {"attributes": attributes, "index": _attribute(mesh.faces.reshape(-1), code)}
        opacity = float(color[3]) if len(color) > 3 else 1.0
        options = {
            "type": "MeshPhongMaterial",
            "color": color_number(color),
            "specular": 0x111111,
            "shininess": 40.0,
            "side": BOTH_SIDES,
            "opacity": opacity,
            "transparent": opacity < 1.0,
            "vertexColors": mesh.colors is not None,
            **material,
        }
        self._object(path, "Mesh", geometry, options)
        if not shadows:
            # The viewer switches shadows on for every object it makes.
            for name in ("castShadow", "receiveShadow"):
                self.set_property(f"{path}/<object>", name, False)

    def _object(self, path: str, kind: str, geometry: dict[str, Any], material: dict[str, Any]) -> None:
        # Names derived from the path keep the output of one run the same from export to export.
        names = {part: str(uuid.uuid5(uuid.NAMESPACE_URL, f"{path}#{part}")) for part in "gmo"}
        render_order = material.pop("renderOrder", 0)
        self.add(
            "set_object",
            path,
            object={
                "metadata": {"version": 4.5, "type": "Object"},
                "geometries": [{"uuid": names["g"], "type": "BufferGeometry", "data": geometry}],
                "materials": [{"uuid": names["m"], **material}],
                "object": {
                    "uuid": names["o"],
                    "type": kind,
                    "geometry": names["g"],
                    "material": names["m"],
                    "renderOrder": render_order,
                    "matrix": [float(x) for x in np.eye(4).reshape(-1)],
                },
            },
        )

    def animate(self, path: str, name: str, kind: str, times: np.ndarray, values: np.ndarray) -> None:
        """Let a property follow values over time, linearly between them (quaternions: along the arc).

        name: 'position', 'quaternion', 'scale' or any property three.js can bind; kind: 'vector3',
        'quaternion' or 'number'; times: (n,) in s; values: (n,) or (n, size).
        """
        self._track(path, name, kind, times, _typed(np.asarray(values).reshape(-1), _FLOAT32))

    def animate_placement(self, path: str, times: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> None:
        """Let a node move; position: (n, 3) in m, quaternion: (n, 4) as (x, y, z, w)."""
        self.animate(path, "position", "vector3", times, position)
        self.animate(path, "quaternion", "quaternion", times, quaternion)

    def animate_visibility(self, path: str, times: np.ndarray, visible: np.ndarray) -> None:
        """Show a node at some times only; visible: (n,) bool, each holding until the next time.

        Only the changes are stored, and the end of the animation.
        """
        visible = np.asarray(visible, dtype=bool)
        self.set_property(path, "visible", bool(visible[0]))
        if visible.all() or not visible.any():
            return
        keep = np.concatenate([[True], visible[1:] != visible[:-1]])
        keep[-1] = True
        self._track(path, "visible", "boolean", times[keep], [bool(x) for x in visible[keep]])

    def _track(self, path: str, name: str, kind: str, times: np.ndarray, values: Any) -> None:
        track = {"name": "." + name, "type": kind, "times": _typed(times, _FLOAT32), "values": values}
        self._clips.setdefault(path, []).append(track)

    def take_animation(self, other: Drawing) -> None:
        """Add the animation of another drawing to this one's."""
        for path, tracks in other._clips.items():
            self._clips.setdefault(path, []).extend(tracks)

    def finish(self, repetitions: int = 1, time_scale: float = 1.0) -> list[dict[str, Any]]:
        """All commands, the animation last: meshcat binds it to the nodes that exist by then.

        time_scale: seconds in the viewer per second of the tracks.
        """
        # Times are in seconds; meshcat divides them by the rate.
        animations = [
            {"path": path, "clip": {"fps": 1.0 / time_scale, "name": path, "tracks": tracks}}
            for path, tracks in self._clips.items()
        ]
        if not animations:
            return self.commands
        animation = {
            "type": "set_animation",
            "path": _ANIMATION_NODE,
            "animations": animations,
            "options": {"play": True, "repetitions": repetitions},
        }
        return [*self.commands, animation]


class Command:
    """One command in the form in which a meshcat window sends it."""

    def __init__(self, content: dict[str, Any]) -> None:
        self.content = content

    def lower(self) -> dict[str, Any]:
        return self.content
