"""What is to be seen in a replay, and from where: the motion at its frames, the size of the scene, camera and light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import ArgumentError
from ..tracks import model_of
from .drawing import Drawing
from .robot import geometry_reach
from .sampling import (
    ContactFrames,
    configurations,
    contact_frames,
    contour_placements,
    frame_times,
    friction_limit,
    intervals,
    joint_placements,
)

_ROOT = ("meshcat", "pincontact")
# Where the camera stands, its vertical field of view in degrees, the narrowest window that shows everything, width over
# height, and the part of the height that is free of panels.
_VIEW_FROM = np.array([0.506, -0.759, 0.409]) / np.linalg.norm([0.506, -0.759, 0.409])
_FIELD_OF_VIEW, ASPECT, FREE_HEIGHT = 40.0, 1.3, 0.8
# Arrows, markers and lines are scaled with the scene, or with this part of the distance that it is seen from.
_LEAST_MARK = 0.15


@dataclass
class Picture:
    """A composed replay.

    times: (n,) of the frames, s, from 0; moments: (n,) the same in the run; placements: (n, njoints, 4, 4) of the
    joints; size: of the scene, m; mark: the length that arrows, markers and lines are scaled with, m;
    low, high: (3,) corners of the box that holds the motion; target: (3,) what the camera looks at first; distance: of
    the camera, m; contacts: by name; sign: +1 where arrows show the force on the second contour; limits: of friction,
    (n,) in N, or None.
    """

    drawing: Drawing
    times: np.ndarray
    moments: np.ndarray
    placements: np.ndarray
    size: float
    mark: float
    low: np.ndarray
    high: np.ndarray
    target: np.ndarray
    distance: float
    followed: np.ndarray | None
    contacts: dict[str, ContactFrames]
    sign: dict[str, float]
    limits: dict[str, np.ndarray | None]

    def commands(self, environment: bool, repetitions: int = 1, time_scale: float = 1.0) -> list[dict[str, Any]]:
        """All commands. environment: set background, light and camera, too; time_scale: stretches the replay."""
        drawing = Drawing(self.drawing.root)
        drawing.delete(drawing.path())
        if environment:
            _set_environment(drawing, self)
        drawing.commands += self.drawing.commands
        if environment or self.followed is not None:
            _set_camera(drawing, self)
        drawing.take_animation(self.drawing)
        return drawing.finish(repetitions=repetitions, time_scale=time_scale)


def frame(run: Any, fps: float, speed: float, max_frames: int, follow: str | None, axes: bool = False) -> Picture:
    """A replay in which nothing is drawn yet; axes: with contact frames. Raises ArgumentError, TrajectoryError."""
    if not hasattr(run, "scene"):
        raise ArgumentError(f"a run is needed, got {type(run).__name__}")
    scene = run.scene
    moments = frame_times(np.asarray(run.t, dtype=float), fps, speed, max_frames)
    model = model_of(run)
    q = configurations(run, moments)
    placements = joint_placements(model, q)
    contacts = {name: contact_frames(run, name, moments, q, placements, axes) for name in scene.contacts}
    followed = None if follow is None else _followed_path(scene, follow, moments, placements, contacts)

    size = scene_size(scene, placements, contacts)
    centres, radii = what_moves(scene, placements, contacts, size)
    low, high = (centres - radii[:, None]).min(axis=0), (centres + radii[:, None]).max(axis=0)
    if followed is None:
        target = 0.5 * (low + high)
        distance = fitting_distance(centres - target, radii)
    else:
        target, distance = followed[0], 4.5 * size

    # A run of no length is shown as a picture that lasts for one frame.
    times = moments - moments[0] if moments[-1] > moments[0] else np.array([0.0, 1.0 / fps])
    mark = max(size, _LEAST_MARK * distance)
    sign = {name: _arrow_sign(contact) for name, contact in scene.contacts.items()}
    limits = {name: _limits(run, name, moments, contacts[name]) for name in contacts}
    return Picture(
        Drawing(_ROOT),
        times,
        moments,
        placements,
        size,
        mark,
        low,
        high,
        target,
        distance,
        followed,
        contacts,
        sign,
        limits,
    )


def _limits(run: Any, name: str, moments: np.ndarray, frames: ContactFrames) -> np.ndarray | None:
    """The friction limit in N at the frames."""
    speed = np.nan_to_num(np.linalg.norm(run.contacts[name].slip_velocity, axis=1))
    speed = speed[intervals(np.asarray(run.t, dtype=float), moments)]
    return friction_limit(run.scene.contacts[name].friction, frames.mode, np.linalg.norm(frames.normal, axis=1), speed)


def scene_size(scene: Any, placements: np.ndarray, contacts: dict[str, ContactFrames]) -> float:
    """A length in m, that of the largest thing that moves."""
    model = scene.model
    lengths = [
        contour.contour.size
        for contour in scene.contours.values()
        if np.isfinite(contour.contour.size) and contour.joint != 0
    ]
    if scene.visual_model is not None:
        moving = [g for g in scene.visual_model.geometryObjects if g.parentJoint != 0]
        lengths += [geometry_reach(geometry) for geometry in moving]
    if model.njoints > 2:
        origins = placements[0, 1:, :3, 3]
        lengths.append(0.5 * float(np.linalg.norm(origins.max(axis=0) - origins.min(axis=0))))
    largest = max(lengths, default=0.0)
    if largest > 0.0:
        return largest
    # Only points move: a tenth of the way they go.
    paths = [placements[:, 1:, :3, 3].reshape(-1, 3), *(c.point for c in contacts.values())]
    points = np.concatenate(paths)
    extent = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0))) if len(points) else 0.0
    return 0.1 * extent if extent > 0.0 else 1.0


def what_moves(
    scene: Any, placements: np.ndarray, contacts: dict[str, ContactFrames], size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Balls that hold all that is to be seen: the moving bodies and the contact points, with room for short arrows.

    placements: (n, njoints, 4, 4); size: of the scene, m. Returns centres (m, 3), world, and radii (m,), in m.
    """
    reach = np.full(scene.model.njoints, 0.05 * size)
    for contour in scene.contours.values():
        if np.isfinite(contour.contour.size):
            offset = float(np.linalg.norm(contour.placement_in_joint.translation))
            reach[contour.joint] = max(reach[contour.joint], offset + contour.contour.size)
    if scene.visual_model is not None:
        for geometry in scene.visual_model.geometryObjects:
            reach[geometry.parentJoint] = max(reach[geometry.parentJoint], geometry_reach(geometry))
    bodies = placements[:, 1:, :3, 3]
    centres = [bodies.reshape(-1, 3)] + [c.point[c.touching] for c in contacts.values()]
    points = sum(len(c) for c in centres[1:])
    radii = np.concatenate([np.tile(reach[1:], len(bodies)), np.full(points, 0.4 * size)])
    if len(radii) == 0:
        return np.zeros((1, 3)), np.array([size])
    return np.concatenate(centres), radii


def fitting_distance(centres: np.ndarray, radii: np.ndarray) -> float:
    """From how far, in m, the camera sees all of these balls between the page's panels.

    centres: (n, 3) from the point that it looks at; radii: (n,), both in m.
    """
    right, upwards = _across(_VIEW_FROM)
    slope = np.tan(0.5 * np.radians(_FIELD_OF_VIEW))
    across = (np.abs(centres @ right) + radii) / (ASPECT * slope)
    along = (np.abs(centres @ upwards) + radii) / (FREE_HEIGHT * slope)
    return float((centres @ _VIEW_FROM + np.maximum(across, along)).max())


def _across(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """To the right and upwards, as seen against a unit direction."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    return right, np.cross(direction, right)


def fitting_force_scale(contacts: dict[str, ContactFrames], length: float) -> float:
    """Metres per newton that make large forces about that long, in m.

    The 95th percentile decides, so that one impact does not shrink everything else.
    """
    forces = [np.linalg.norm(c.normal + c.friction, axis=1)[c.touching] for c in contacts.values()]
    magnitudes = np.concatenate(forces) if forces else np.zeros(0)
    magnitudes = magnitudes[magnitudes > 0.0]
    return 0.9 * length / float(np.percentile(magnitudes, 95.0)) if len(magnitudes) else length


def _arrow_sign(contact: Any) -> float:
    """+1 where the arrows show the force on the second contour, -1 where they show that on the first."""
    return -1.0 if contact.second.joint == 0 and contact.first.joint != 0 else 1.0


def _followed_path(
    scene: Any, name: str, times: np.ndarray, placements: np.ndarray, contacts: dict[str, ContactFrames]
) -> np.ndarray:
    """World positions, (n, 3), of the contact, contour or frame with this name."""
    model = scene.model
    if name in contacts:
        return contacts[name].point
    if name in scene.contours:
        return contour_placements(scene.contours[name], placements, times)[:, :3, 3]
    if isinstance(name, str) and model.existFrame(name):
        frame = model.frames[model.getFrameId(name)]
        joint, placement = frame.parentJoint, frame.placement.homogeneous
        return (placements[:, joint] @ placement)[:, :3, 3]
    raise ArgumentError(f"follow={name!r} is not the name of a contact, a contour or a frame")


def _set_environment(drawing: Drawing, picture: Picture) -> None:
    """Background and light for a scene of any size; meshcat's own are made for about a metre."""
    drawing.set_property("/Background", "top_color", [0.78, 0.86, 0.93])
    drawing.set_property("/Background", "bottom_color", [0.97, 0.98, 0.99])
    drawing.set_property("/Axes", "visible", False)
    drawing.set_property("/Grid", "visible", False)
    for lamp in ("PointLightNegativeX", "PointLightPositiveX", "FillLight"):
        drawing.set_property(f"/Lights/{lamp}", "visible", False)
    drawing.set_property("/Lights/AmbientLight/<object>", "intensity", 0.62)

    # A sun that casts shadows. Its shadow camera looks at the origin, where the camera looks, too.
    if picture.followed is None:
        low, high = picture.low - picture.target, picture.high - picture.target
    else:
        low, high = np.full(3, -5.0 * picture.size), np.full(3, 5.0 * picture.size)
    corners = np.array(np.meshgrid(*zip(low, high))).reshape(3, -1).T
    towards = np.array([0.35, -0.45, 1.0])
    towards /= np.linalg.norm(towards)
    reach = float(np.abs(corners).max()) * np.sqrt(3.0) + picture.size
    # three.js orients the camera with its own vertical, which is the world's z here.
    right, upwards = _across(towards)
    x, y = corners @ right, corners @ upwards
    margin = 0.5 * picture.size
    sun = {
        "uuid": "sun",
        "type": "DirectionalLight",
        "color": 0xFFFFFF,
        "intensity": 0.55,
        "castShadow": True,
        "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *(float(c) for c in 2.0 * reach * towards), 1],
        "shadow": {
            "mapSize": [2048, 2048],
            "bias": -0.0005,
            "normalBias": 0.02 * picture.size,
            "radius": 2.0,
            "camera": {
                "uuid": "sun-camera",
                "type": "OrthographicCamera",
                "left": float(x.min()) - margin,
                "right": float(x.max()) + margin,
                "top": float(y.max()) + margin,
                "bottom": float(y.min()) - margin,
                "near": 0.05 * reach,
                "far": 4.0 * reach,
                "zoom": 1,
            },
        },
    }
    drawing.add(
        "set_object",
        "/Lights/Sun",
        object={
            "metadata": {"version": 4.5, "type": "Object"},
            "geometries": [],
            "materials": [],
            "object": sun,
        },
    )


def _set_camera(drawing: Drawing, picture: Picture) -> None:
    """Look at the motion from in front, right and above; with something to follow, stay with it.

    Meshcat's camera turns about its own origin but looks at the world's, so that moving the camera's node turns
    it away. What moves is the drawing: the point to look at is brought to the viewer's origin.
    """
    camera = "/Cameras/default/rotated/<object>"
    x, y, z = picture.distance * _VIEW_FROM
    # The camera's node is turned about x, so that three.js' vertical is the world's z.
    drawing.set_property(camera, "position", [float(x), float(z), float(-y)])
    drawing.set_property(camera, "fov", _FIELD_OF_VIEW)
    drawing.set_property(camera, "near", 0.01 * picture.distance)
    drawing.set_property(camera, "far", 100.0 * picture.distance)
    placement = np.eye(4)
    placement[:3, 3] = -picture.target
    drawing.transform(drawing.path(), placement)
    if picture.followed is not None:
        drawing.animate(drawing.path(), "position", "vector3", picture.times, -picture.followed)
