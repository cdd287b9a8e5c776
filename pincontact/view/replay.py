"""Replay of a run in Meshcat, live or as one HTML file: bodies, contours, contact points, traces and forces."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arguments import check_positive
from ..display import MODE_NAMES
from ..errors import ArgumentError
from ..extras import required
from ..layout import FREE
from .drawing import Command, color_number
from .palette import MODE_COLORS, contact_color
from .picture import ASPECT, FREE_HEIGHT, Picture, fitting_force_scale, frame
from .stage import Stage

if TYPE_CHECKING:
    import meshcat
    from pinocchio.visualize import MeshcatVisualizer

    from ..trajectory import Trajectory

PARTS = ("robot", "contours", "points", "traces", "forces")
# Drawn on request only.
MORE_PARTS = ("frames", "dual_frames", "cones")


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
        "aspect": ASPECT,
        "height": FREE_HEIGHT,
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
