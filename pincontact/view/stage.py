"""The parts of a replay drawn below Meshcat's nodes: bodies, contours, contact points, traces and forces."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..display import MODE_NAMES
from ..geometry.frames import dual_basis
from ..layout import FRICTIONLESS, SLIPPING, STICK
from . import arrows, meshes
from .drawing import FRONT_SIDE, Drawing
from .outlines import contour_meshes, contour_opacity, shades
from .palette import MODE_COLORS
from .picture import Picture
from .robot import draw_robot, shown_by
from .sampling import (
    ContactFrames,
    configurations,
    contact_frames,
    contour_placements,
    joint_placements,
    quaternions,
    turning_rate,
)

_TRACE_COLOR = (0.10, 0.10, 0.14)
_POINT_COLOR = (0.08, 0.08, 0.10)
# Drawn over everything else: a contact point is always hidden inside the bodies that touch there.
_ON_TOP = {"depthTest": False, "transparent": True, "side": FRONT_SIDE, "renderOrder": 10}
# Pushed back a little, so that curves and traces that lie in a surface are not half swallowed by it.
_BEHIND_LINES = {"polygonOffset": True, "polygonOffsetFactor": 1.0, "polygonOffsetUnits": 1.0}

# Points of all traces together, and of one at least; and how far a body turns from one to the next, rad.
_TRACE_POINTS, _FEWEST, _TURN, _TRACE_SIDES = 30000, 600, 0.1, 6
_SNAPSHOTS = 40
_SHOWN_SAMPLES = 24


class Stage:
    """Draws the parts of one run."""

    def __init__(self, drawing: Drawing, run: Any, picture: Picture) -> None:
        self.drawing, self.run, self.scene, self.model = drawing, run, run.scene, run.scene.model
        self.moments, self.times, self.placements = picture.moments, picture.times, picture.placements
        self.contacts, self.sign = picture.contacts, picture.sign
        self.size, self.mark, self.line = picture.size, picture.mark, 0.012 * picture.mark

    def body(self, joint: int, *names: str) -> str:
        return self.drawing.path("bodies", str(self.model.names[joint]), *names)

    def move_bodies(self) -> None:
        """One animated node a joint; what belongs to the body hangs below it and stands still there."""
        for joint in range(1, self.model.njoints):
            placement = self.placements[:, joint]
            self.drawing.transform(self.body(joint), placement[0])
            self._animate(self.body(joint), placement)

    def _animate(self, path: str, placement: np.ndarray) -> None:
        self.drawing.animate_placement(path, self.times, placement[:, :3, 3], quaternions(placement[:, :3, :3]))

    def _attach(self, path: str, attached: Any, world: np.ndarray) -> None:
        """Place a node below its body's as the contour is; world: (n, 4, 4), its placements at the frames."""
        if attached.motion is None:
            self.drawing.transform(path, attached.placement_in_joint.homogeneous)
            return
        local = np.linalg.inv(self.placements[:, attached.joint]) @ world
        self.drawing.transform(path, local[0])
        self._animate(path, local)

    def draw_robot(self) -> None:
        visual = self.scene.visual_model
        if visual is not None:
            draw_robot(self.drawing, self.model, visual, lambda item: self.body(item.parentJoint, "visuals", item.name))

    def draw_contours(self, with_robot: bool) -> None:
        """All contours, but for surfaces that the body's own visual geometry shows already."""
        visuals = self.scene.visual_model.geometryObjects if with_robot and self.scene.visual_model else []
        pictured = {geometry.parentJoint for geometry in visuals}
        for name, attached in self.scene.contours.items():
            joint, contour = attached.joint, attached.contour
            world = contour_placements(attached, self.placements, self.moments)
            near = self._contact_points_in(name, world)
            if joint in pictured and contour.dimension == 2 and joint != 0 and self._is_shown(attached, near):
                continue
            path = self.body(joint, "contours", name)
            self._attach(path, attached, world)
            filled = joint != 0 and joint not in pictured and not self._carries_point(name)
            opacity = contour_opacity(contour, joint)
            moments = [self.moments[0]]
            if contour.time_dependent:
                moments = list(self.moments[:: max(1, len(self.moments) // _SNAPSHOTS)])
            for number, moment in enumerate(moments):
                parts = contour_meshes(contour, near, self.size, self.line, joint, filled, float(moment))
                nodes = (path, f"at {number}") if len(moments) > 1 else (path,)
                base = "/".join(nodes)
                for part, mesh in parts.items():
                    color = (1.0, 1.0, 1.0) if mesh.colors is not None else tuple(0.75 * shades(joint)[1])
                    # A see-through surface must not hide from three.js what lies behind it.
                    extra = {"depthWrite": False} if opacity < 1.0 else _BEHIND_LINES
                    self.drawing.mesh(f"{base}/{part}", mesh, (*color, opacity), opacity == 1.0, **extra)
                if len(moments) > 1:
                    until = moments[number + 1] if number + 1 < len(moments) else np.inf
                    visible = (self.moments >= moment) & (self.moments < until)
                    self.drawing.animate_visibility(base, self.times, visible)

    def _is_shown(self, attached: Any, near: np.ndarray) -> bool:
        """Whether the body's visual geometry lies where it touches; near: (n, 3), in the contour's frame."""
        if attached.motion is not None:
            return False
        if not np.any(near):
            return True
        few = near[np.linspace(0, len(near) - 1, min(len(near), _SHOWN_SAMPLES)).astype(int)]
        placement = attached.placement_in_joint
        geometries = [g for g in self.scene.visual_model.geometryObjects if g.parentJoint == attached.joint]
        size = attached.contour.size if np.isfinite(attached.contour.size) else self.size
        return shown_by(geometries, few @ placement.rotation.T + placement.translation, 0.1 * size)

    def _carries_point(self, name: str) -> bool:
        """Whether a point runs along this contour: then it is a wire, not the edge of a disc."""
        pairs = [(c.first, c.second) for c in self.scene.contacts.values()]
        partners = [b for a, b in pairs if a.name == name] + [a for a, b in pairs if b.name == name]
        return any(partner.contour.dimension == 0 for partner in partners)

    def _contact_points_in(self, name: str, world: np.ndarray) -> np.ndarray:
        """All contact points of a contour in its own frame, (n, 3); its origin if there are none."""
        points = []
        for contact, frames in self.contacts.items():
            sides = self.scene.contacts[contact]
            if name in (sides.first.name, sides.second.name) and frames.touching.any():
                points.append(_into(world, frames.point)[frames.touching])
        return np.concatenate(points) if points else np.zeros((1, 3))

    def draw_points(self) -> None:
        marker = meshes.sphere(0.03 * self.mark)
        for name, frames in self.contacts.items():
            path = self.drawing.path("contacts", name, "point")
            self.drawing.mesh(path, marker, _POINT_COLOR, False, **{**_ON_TOP, "renderOrder": 11})
            self.drawing.animate(path, "position", "vector3", self.times, frames.point)
            self.drawing.animate_visibility(path, self.times, frames.touching)

    def draw_traces(self) -> None:
        """The contact point's way through the world and over each moving body, growing with time."""
        if not self.contacts:
            return
        # Finer than the frames: a wheel turns a good part of a radian between two of them, a top many times round.
        start, end = self.moments[0], self.moments[-1]
        sides = [side for contact in self.scene.contacts.values() for side in (contact.first, contact.second)]
        turned = turning_rate(self.run, {side.joint for side in sides}) * (end - start)
        wanted = max(4 * (len(self.moments) - 1), int(turned / _TURN))
        moments = np.linspace(start, end, min(wanted, max(_FEWEST, _TRACE_POINTS // len(self.contacts))) + 1)
        q = configurations(self.run, moments)
        placements = joint_placements(self.model, q)
        for name in self.contacts:
            frames = contact_frames(self.run, name, moments, q, placements)
            contact = self.scene.contacts[name]
            self._trace(self.drawing.path("contacts", name, "trace"), frames.point, frames.touching, moments)
            for side in (contact.first, contact.second):
                if side.joint == 0 and side.motion is None:
                    continue
                path = self.body(side.joint, "traces", f"{name} on {side.name}")
                world = contour_placements(side, self.placements, self.moments)
                self._attach(path, side, world)
                finer = contour_placements(side, placements, moments)
                self._trace(path, _into(finer, frames.point), frames.touching, moments)

    def _trace(self, path: str, points: np.ndarray, touching: np.ndarray, moments: np.ndarray) -> None:
        tubes, indices, until = [], 0, []
        for phase in np.split(np.arange(len(points)), 1 + np.flatnonzero(touching[1:] != touching[:-1])):
            kept = phase[meshes.simplify(points[phase], meshes.SIMPLIFIED * self.size, 0.2 * self.size)]
            if not touching[phase[0]] or len(kept) < 2:
                continue
            tubes.append(meshes.tube(points[kept], 0.67 * self.line, False, _TRACE_SIDES))
            ends = indices + 6 * _TRACE_SIDES * np.arange(len(kept))
            until.append(np.column_stack([moments[kept], ends]))
            indices = ends[-1]
        if not tubes:
            return
        self.drawing.mesh(path, meshes.join(tubes), _TRACE_COLOR)
        # What is drawn of it grows: a property of the geometry, below meshcat's own object node.
        drawn = np.concatenate(until)
        drawn = np.floor(np.interp(self.moments, drawn[:, 0], drawn[:, 1]))
        self.drawing.animate(f"{path}/<object>", "geometry[drawRange].count", "number", self.times, drawn)

    def draw_forces(self, scale: float) -> None:
        head = 0.13 * self.mark
        for name, frames in self.contacts.items():
            for part, vectors in (("normal", frames.normal), ("friction", frames.friction)):
                modes = [m for m in (FRICTIONLESS, STICK, SLIPPING) if (frames.mode == m).any()]
                if part == "friction":
                    modes = [m for m in modes if m != FRICTIONLESS]
                arrow = arrows.place_arrow(frames.point, self.sign[name] * scale * vectors, head)
                if modes and arrow.visible.any():
                    self._arrow(self.drawing.path("contacts", name, part), arrow, frames, modes)

    def draw_axes(self, dual: bool) -> None:
        """The contact frame e_1, e_2, e_3 (red, green, blue), or its dual basis m^1, m^2, m^3 (the same, paler)."""
        for name, frames in self.contacts.items():
            axes = frames.frame
            if dual:
                axes = np.array([dual_basis(np.ascontiguousarray(frame)) for frame in axes])
            for j in range(3):
                # thin ones on thick ones, which they hide where a frame is orthogonal
                head = (0.05 if dual else 0.1) * self.mark
                arrow = arrows.place_arrow(frames.point, 0.6 * self.mark * axes[:, :, j], head)
                path = self.drawing.path("contacts", name, f"{'m' if dual else 'e'}{j + 1}")
                color = np.where(np.arange(3) == j, 0.85, 0.55 if dual else 0.1)
                self._place(path, arrow, frames.touching)
                for piece, mesh in (("shaft", arrows.unit_shaft()), ("head", arrows.unit_head())):
                    self.drawing.mesh(f"{path}/{piece}/axis", mesh, color, False, **_ON_TOP)

    def draw_cones(self) -> None:
        """Circular friction cones, from the contact point towards the body on which the arrows show the force."""
        for name, frames in self.contacts.items():
            contact = self.scene.contacts[name]
            law = contact.friction
            if law is None or not np.isfinite(law.sticking) or law.aspect != 1.0 or contact.pattern.constraints == 2:
                continue
            height = 0.8 * self.mark / np.hypot(1.0, law.sticking)
            arrow = arrows.place_arrow(frames.point, self.sign[name] * _unit(frames.normal), self.mark)
            path = self.drawing.path("contacts", name, "cone")
            if not arrow.visible.any():
                continue
            self.drawing.animate_placement(path, self.times, arrow.tail, arrow.quaternion)
            self.drawing.animate_visibility(path, self.times, arrow.visible & frames.touching)
            shape = meshes.lathe(np.array([[0.0, 0.0], [law.sticking * height, height]]), 40)
            self.drawing.mesh(path, shape, (0.95, 0.75, 0.2, 0.35), False, **{**_ON_TOP, "renderOrder": 9})

    def _arrow(self, path: str, arrow: arrows.Arrow, frames: ContactFrames, modes: list[int]) -> None:
        self._place(path, arrow, frames.touching)
        drawing, times = self.drawing, self.times
        for piece, mesh in (("shaft", arrows.unit_shaft()), ("head", arrows.unit_head())):
            for mode in modes:
                node = f"{path}/{piece}/{MODE_NAMES[mode]}"
                drawing.mesh(node, mesh, MODE_COLORS[mode], False, **_ON_TOP)
                drawing.animate_visibility(node, times, frames.mode == mode)

    def _place(self, path: str, arrow: arrows.Arrow, shown: np.ndarray) -> None:
        drawing, times = self.drawing, self.times
        drawing.animate_placement(path, times, arrow.tail, arrow.quaternion)
        drawing.animate_visibility(path, times, arrow.visible & shown)
        drawing.animate(f"{path}/shaft", "scale", "vector3", times, arrow.shaft_scale)
        drawing.animate(f"{path}/head", "position", "vector3", times, arrow.head_position)
        drawing.animate(f"{path}/head", "scale", "vector3", times, arrow.head_scale)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """(n, 3) vectors at length 1; zero stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)


def _into(placements: np.ndarray, points: np.ndarray) -> np.ndarray:
    """World points, (n, 3), in the frames placed by (n, 4, 4)."""
    return np.einsum("nji,nj->ni", placements[:, :3, :3], points - placements[:, :3, 3])
