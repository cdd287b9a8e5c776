"""Replay of a run in Meshcat, live or as one HTML file: bodies, contours, contact points, traces and forces."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arguments import check_positive
from ..display import MODE_NAMES
from ..errors import ArgumentError
from ..extras import required
from ..layout import FREE
from ..tracks import model_of
from .drawing import Command, Drawing, color_number
from .palette import MODE_COLORS, contact_color
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
from .stage import ROOT, Stage

if TYPE_CHECKING:
    import meshcat
    from pinocchio.visualize import MeshcatVisualizer

    from ..trajectory import Trajectory

PARTS = ("robot", "contours", "points", "traces", "forces")
# Drawn on request only.
MORE_PARTS = ("frames", "dual_frames", "cones")

# Where the camera stands, its vertical field of view in degrees, the narrowest window that shows everything, width over
# height, and the part of the height that is free of panels.
_VIEW_FROM = np.array([0.506, -0.759, 0.409]) / np.linalg.norm([0.506, -0.759, 0.409])
_FIELD_OF_VIEW, _ASPECT, _FREE_HEIGHT = 40.0, 1.3, 0.8
# Arrows, markers and lines are scaled with the scene, or with this part of the distance that it is seen from.
_LEAST_MARK = 0.15


def replay(
    run: Trajectory,
    *,
    fps: float = 30.0,
    speed: float = 1.0,
    viewer: meshcat.Visualizer | MeshcatVisualizer | None = None,
    open: bool = True,
    force_scale: float | None = None,
    follow: str | None = None,
    show: Collection[str] = PARTS,
    max_frames: int = 3000,
    repetitions: int = 1,
) -> meshcat.Visualizer:
    """Play a run in a Meshcat viewer.

    Forces are drawn on the body that moves: on the second contour of the contact as it was given, unless that one
    belongs to the world and the first does not. Green arrows stick, red ones slip, blue ones are frictionless.

    Parameters
    ----------
    run : Trajectory
        With its scene.
    fps : float
        Frames per second of the replay.
    speed : float
        Seconds of motion per second of replay.
    viewer : meshcat.Visualizer or pinocchio.visualize.MeshcatVisualizer, optional
        Where to draw; a new one, if not given.
    open : bool
        Whether to open a browser for a viewer that is started here.
    force_scale : float, optional
        Length of the force arrows in m/N; fitted to the scene, if not given.
    follow : str, optional
        Name of a contact, contour or frame which the camera stays with.
    show : collection of str
        What to draw: "robot", "contours", "points", "traces" and "forces", if not given; on request also "frames" and
        "dual_frames", the contact frames (e_1 red, e_2 green, e_3 blue) and their duals (paler), and "cones", circular
        friction cones.
    max_frames : int
        A longer run gets fewer frames per second.
    repetitions : int
        How often it is played before it stops.

    Returns
    -------
    meshcat.Visualizer
        Pass it again as `viewer` to draw the next run in the same window.

    Raises
    ------
    ArgumentError
        For an argument out of bounds, an unknown name, or a run of no duration.
    TrajectoryError
        For a run that was read from a file without its scene.
    MissingExtraError
        Without meshcat.
    """
    picture = compose(run, fps, speed, max_frames, force_scale, follow, show)
    if repetitions < 1:
        raise ArgumentError(f"repetitions must be at least 1, got {repetitions}")
    own = viewer is None
    if viewer is None:
        viewer = required("meshcat", "a replay needs meshcat", "meshcat").Visualizer()
    drawn: meshcat.Visualizer = getattr(viewer, "viewer", viewer)
    for command in picture.commands(environment=own, repetitions=repetitions, time_scale=1.0 / speed):
        drawn.window.send(Command(command))
    if own and open:
        drawn.open()
    return drawn


def export_html(
    run: Trajectory,
    path: str | Path,
    *,
    fps: float = 30.0,
    max_frames: int = 3000,
    speed: float = 1.0,
    force_scale: float | None = None,
    follow: str | None = None,
    show: Collection[str] = PARTS,
    title: str = "pincontact",
) -> Path:
    """Write a replay as one HTML file that needs neither network nor Python.

    The page has a time slider with a mark at each event, a choice of speeds, and each contact's mode and forces. No
    server or browser is started. `#t=1.5` after the file's address opens it paused at that time in s.

    Parameters
    ----------
    run : Trajectory
        With its scene.
    path : str or Path
        The file.
    fps, max_frames, speed, force_scale, follow, show
        As for `replay`.
    title : str
        Of the page.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ArgumentError
        For an argument out of bounds, an unknown name, or a run of no duration.
    TrajectoryError
        For a run that was read from a file without its scene.
    MissingExtraError
        Without meshcat.
    OSError
        If the file cannot be written.
    """
    from .page import render_page

    if not isinstance(title, str):
        raise ArgumentError(f"title must be text, got {title!r}")
    picture = compose(run, fps, speed, max_frames, force_scale, follow, show)
    text = render_page(picture.commands(environment=True), page_info(picture, run, speed), title)
    target = Path(path)
    target.write_text(text, encoding="utf-8")
    return target


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


def compose(
    run: Any,
    fps: float,
    speed: float,
    max_frames: int,
    force_scale: float | None,
    follow: str | None,
    show: Collection[str],
) -> Picture:
    """Everything of a replay that does not depend on where it is shown. Raises ArgumentError."""
    if not isinstance(show, Collection):
        raise ArgumentError(f"show must be names of parts, got {show!r}; possible: {', '.join(PARTS)}")
    parts = {show} if isinstance(show, str) else {str(part) for part in show}
    possible = (*PARTS, *MORE_PARTS)
    unknown = sorted(parts.difference(possible))
    if unknown:
        raise ArgumentError(f"show has unknown parts {', '.join(unknown)}; possible: {', '.join(possible)}")
    if force_scale is not None:
        check_positive(force_scale=force_scale)
    picture = frame(run, fps, speed, max_frames, follow, axes=not parts.isdisjoint(("frames", "dual_frames")))
    stage = Stage(picture.drawing, run, picture)
    stage.move_bodies()
    if "robot" in parts:
        stage.draw_robot()
    if "contours" in parts:
        stage.draw_contours(with_robot="robot" in parts)
    if "points" in parts:
        stage.draw_points()
    if "traces" in parts:
        stage.draw_traces()
    if "forces" in parts:
        stage.draw_forces(force_scale or fitting_force_scale(picture.contacts, picture.mark))
    if "cones" in parts:
        stage.draw_cones()
    for part in ("frames", "dual_frames"):
        if part in parts:
            stage.draw_axes(dual=part == "dual_frames")
    return picture


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
        Drawing(ROOT),
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
    across = (np.abs(centres @ right) + radii) / (_ASPECT * slope)
    along = (np.abs(centres @ upwards) + radii) / (_FREE_HEIGHT * slope)
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


def page_info(picture: Picture, run: Any, speed: float) -> dict[str, Any]:
    """What the bar of the page shows; numbers only, times in s, forces in N."""
    times = picture.times
    contacts = []
    for number, (name, frames) in enumerate(picture.contacts.items()):
        contact = run.scene.contacts[name]
        contacts.append(
            {
                "name": name,
                "color": contact_color(number),
                "on": (contact.second if picture.sign[name] > 0.0 else contact.first).name,
                "mode": [int(m) for m in frames.mode],
                "normal": _short(np.linalg.norm(frames.normal, axis=1)),
                "friction": _short(np.linalg.norm(frames.friction, axis=1)),
                "limit": _short(picture.limits[name]),
            }
        )
    return {
        "start": float(picture.moments[0]),
        "duration": float(times[-1]),
        "step": float(times[1] - times[0]),
        "frames": len(times),
        "speed": float(speed),
        "aspect": _ASPECT,
        "height": _FREE_HEIGHT,
        "open": FREE,
        "contacts": contacts,
        "events": [[float(e.time), e.contact or e.joint or "", e.kind] for e in run.events],
        "modes": {
            str(mode): {
                "name": name,
                "color": f"#{color_number(MODE_COLORS[mode]):06x}",
            }
            for mode, name in MODE_NAMES.items()
        },
    }


def _short(values: np.ndarray | None) -> list[float] | None:
    return None if values is None else [float(f"{x:.5g}") for x in values]


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
