"""Runs as recordings for the rerun viewer, which is imported when one is written (the extra `rerun`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arguments import check_positive
from ..extras import required
from .drawing import Drawing
from .meshes import Mesh, lathe
from .palette import MODE_COLORS, contact_color
from .picture import Picture, fitting_force_scale, frame
from .plots import limit
from .robot import geometry_color
from .stage import Stage

if TYPE_CHECKING:
    import pinocchio as pin
    import rerun

    from ..trajectory import Trajectory

_TIMELINE = "time"
_ENERGIES = ("kinetic", "potential", "total", "friction_work", "drive_work", "torque_work", "damping_work")


def export_rerun(
    run: Trajectory,
    path: str | Path,
    *,
    fps: float = 30.0,
    max_frames: int = 3000,
    force_scale: float | None = None,
) -> Path:
    """Write a run as a recording for the rerun viewer: `rerun FILE` shows it.

    Below `scene` are the robot, the contours, contact points, their traces as wholes, and arrows of normal forces and
    friction, as in a replay; below `plots`, at the run's own times, forces with their limits, gaps and slip speeds in m
    and m/s, q, v and energies; under `events` the events. The timeline is `time`, in s.

    Parameters
    ----------
    run : Trajectory
        With its scene.
    path : str or Path
        The file, by custom with the suffix `.rrd`.
    fps, max_frames, force_scale
        As for `replay`.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ArgumentError
        For an argument out of bounds.
    TrajectoryError
        For a run that was read from a file without its scene.
    MissingExtraError
        Without rerun (the extra `rerun`).
    OSError
        If the file cannot be written.
    """
    if force_scale is not None:
        check_positive(force_scale=force_scale)
    picture = frame(run, fps, 1.0, max_frames, None)
    rr = required("rerun", "recordings need rerun", "pincontact[rerun]")
    target = Path(path)
    # an error of the operating system, if there is one, before rerun turns it into another
    target.open("wb").close()
    stream = rr.RecordingStream("pincontact")
    try:
        stream.save(target)
        drawing = _Recording(stream, picture.moments)
        stage = Stage(drawing, run, picture)
        stage.move_bodies()
        if run.scene.visual_model is not None:
            for geometry in run.scene.visual_model.geometryObjects:
                _log_geometry(drawing, stage.body(geometry.parentJoint, "visuals", geometry.name), geometry)
        stage.draw_contours(with_robot=True)
        stage.draw_traces()
        drawing.write()
        _log_contacts(drawing, picture, force_scale or fitting_force_scale(picture.contacts, picture.mark))
        _log_plots(drawing, run)
        stream.flush()
    finally:
        stream.disconnect()
    return target


class _Recording(Drawing):
    """Takes what a `Stage` draws, and writes it to a recording: `write`, once all is known.

    What stands still is static there, and static data would hide data in time.
    """

    def __init__(self, stream: rerun.RecordingStream, moments: np.ndarray) -> None:
        super().__init__(("scene",))
        self.stream, self.moments = stream, moments
        self._placed: dict[str, np.ndarray] = {}
        self._meshes: dict[str, tuple[Mesh, Any]] = {}
        self._shown: dict[str, np.ndarray] = {}
        self.log("/scene", _rerun().ViewCoordinates.RIGHT_HAND_Z_UP)

    def log(self, path: str, *parts: Any) -> None:
        self.stream.log(_entity(path), *parts, static=True)

    def columns(self, path: str, times: np.ndarray, columns: Any) -> None:
        """Data with one row a time, (n,) in s."""
        # The SDK takes a list of columns; each knows what it holds.
        index = _rerun().TimeColumn(_TIMELINE, duration=np.asarray(times, dtype=float))
        _rerun().send_columns(_entity(path), [index], columns, recording=self.stream)

    def transform(self, path: str, matrix: np.ndarray) -> None:
        self._placed[path] = matrix

    def mesh(self, path: str, mesh: Mesh, color: Any = (1.0, 1.0, 1.0), shadows: bool = True, **material: Any) -> None:
        self._meshes[path] = mesh, color

    def animate_placement(self, path: str, times: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> None:
        self._placed.pop(path, None)
        rr = _rerun()
        # a run of no length has two frames at one moment
        self.columns(path, self.moments, rr.Transform3D.columns(translation=position, quaternion=quaternion))

    def animate_visibility(self, path: str, times: np.ndarray, visible: np.ndarray) -> None:
        self._shown[path] = visible

    def animate(self, path: str, name: str, kind: str, times: np.ndarray, values: np.ndarray) -> None:
        """Nothing: traces do not grow here."""

    def set_property(self, path: str, name: str, value: Any) -> None:
        """Nothing: it is a command to meshcat's viewer."""

    def write(self) -> None:
        """Write what stands still, and what is there for a while."""
        rr = _rerun()
        for path, matrix in self._placed.items():
            self.log(path, rr.Transform3D(translation=matrix[:3, 3], mat3x3=matrix[:3, :3]))
        for path, (mesh, color) in self._meshes.items():
            parts = {} if mesh.colors is None else {"vertex_colors": np.rint(255 * mesh.colors).astype(np.uint8)}
            drawn = rr.Mesh3D(
                vertex_positions=mesh.vertices,
                triangle_indices=mesh.faces,
                vertex_normals=mesh.normals,
                albedo_factor=_rgba(color),
                **parts,
            )
            visible = next((shown for above, shown in self._shown.items() if path.startswith(above + "/")), None)
            if visible is None:
                self.log(path, drawn)
                continue
            for row in np.flatnonzero(np.diff(visible.astype(int), prepend=0)):
                self.stream.set_time(_TIMELINE, duration=float(self.moments[row]))
                self.stream.log(_entity(path), drawn if visible[row] else rr.Clear(recursive=False))
            self.stream.reset_time()


def _rerun() -> Any:
    import rerun

    return rerun


def _entity(path: str) -> str:
    return str(_rerun().new_entity_path(path.strip("/").split("/")))


def _rgba(color: Any) -> list[int]:
    return [round(255 * float(x)) for x in (*color, 1.0)[:4]]


def _log_geometry(drawing: _Recording, path: str, geometry: pin.GeometryObject) -> None:
    """A visual geometry in its joint's frame; unbounded ones are left out."""
    import coal

    rr, shape, color = _rerun(), geometry.geometry, [_rgba(geometry_color(geometry))]
    solid: dict[str, Any] = {"colors": color, "fill_mode": "solid"}
    drawn: Any = None
    if isinstance(shape, coal.Box):
        drawn = rr.Boxes3D(half_sizes=[shape.halfSide], **solid)
    elif isinstance(shape, coal.Sphere):
        drawn = rr.Ellipsoids3D(half_sizes=[[shape.radius] * 3], **solid)
    elif isinstance(shape, coal.Ellipsoid):
        drawn = rr.Ellipsoids3D(half_sizes=[shape.radii], **solid)
    elif isinstance(shape, coal.Cylinder):
        drawn = rr.Cylinders3D(lengths=[2.0 * shape.halfLength], radii=[shape.radius], **solid)
    elif isinstance(shape, coal.Capsule):
        ends = {"lengths": [2.0 * shape.halfLength], "translations": [[0.0, 0.0, -shape.halfLength]]}
        drawn = rr.Capsules3D(radii=[shape.radius], **ends, **solid)
    elif isinstance(shape, coal.Cone):
        profile = [[0.0, -shape.halfLength], [shape.radius, -shape.halfLength], [0.0, shape.halfLength]]
        drawing.mesh(path, lathe(np.array(profile), 40), geometry_color(geometry))
    elif isinstance(shape, coal.BVHModelBase):
        triangles = map(shape.tri_indices, range(shape.num_tris))
        faces = np.array([(triangle[0], triangle[1], triangle[2]) for triangle in triangles])
        vertices = np.asarray(shape.vertices())[faces]
        normals = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
        # mirrored triangles go round the other way
        normals *= np.sign(np.prod(geometry.meshScale))
        normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]
        corners = np.arange(3 * len(faces)).reshape(-1, 3)
        flat = Mesh(vertices.reshape(-1, 3), corners, np.repeat(normals, 3, axis=0))
        drawing.mesh(path, flat, geometry_color(geometry))
    else:
        return
    drawing.transform(path, geometry.placement.homogeneous)
    if drawn is not None:
        drawing.log(path, drawn)


def _log_contacts(drawing: _Recording, picture: Picture, scale: float) -> None:
    """Contact points and arrows; nothing where a contact is open."""
    rr = _rerun()
    for name, frames in picture.contacts.items():
        shown = frames.touching
        at = drawing.path("contacts", name, "point")
        points = rr.Points3D.columns(positions=frames.point[shown], radii=np.full(shown.sum(), 0.025 * picture.mark))
        drawing.columns(at, picture.moments, points.partition(lengths=shown.astype(int)))
        for part, vectors in (("normal", frames.normal), ("friction", frames.friction)):
            seen = shown & vectors.any(axis=1)
            colors = [_rgba(MODE_COLORS[int(mode)]) for mode in frames.mode[seen]]
            arrows = rr.Arrows3D.columns(
                origins=frames.point[seen],
                vectors=picture.sign[name] * scale * vectors[seen],
                radii=np.full(seen.sum(), 0.017 * picture.mark),
                colors=np.array(colors, dtype=np.uint8).reshape(-1, 4),
            )
            at = drawing.path("contacts", name, part)
            drawing.columns(at, picture.moments, arrows.partition(lengths=seen.astype(int)))


def _log_plots(drawing: _Recording, run: Trajectory) -> None:
    """Numbers over time, at the rows of the run; NaN, of open contacts, leaves a gap."""
    rr, plots = _rerun(), Drawing(("plots",))
    t = np.asarray(run.t, dtype=float)

    def curve(values: np.ndarray, *names: str, color: str | None = None) -> None:
        path = plots.path(*names)
        rows = np.asarray(values, dtype=float).reshape(len(t), -1)
        if color is not None:
            drawing.log(path, rr.SeriesLines(colors=[[int(color[i : i + 2], 16) for i in (1, 3, 5)]]))
        data = rr.Scalars.columns(scalars=rows.reshape(-1))
        drawing.columns(path, t, data.partition(lengths=np.full(len(t), rows.shape[1])))

    for number, (name, track) in enumerate(run.contacts.items()):
        color = contact_color(number)
        speed = np.linalg.norm(track.slip_velocity, axis=1)
        curve(track.normal_force, "forces", name, "normal", color=color)
        curve(track.tangential_force, "forces", name, "friction", color=color)
        largest = limit(run, name)
        if largest is not None:
            curve(largest, "forces", name, "limit", color=color)
        curve(speed, "slip_speed", name, color=color)
        curve(track.gap, "gap", name, color=color)
        curve(track.mode, "mode", name, color=color)
    curve(run.q, "q")
    curve(run.v, "v")
    energies = run.energies()
    for name in _ENERGIES:
        values = getattr(energies, name)
        if values is not None:
            curve(values, "energy", name)
    if run.events:
        named = [(event.contact or event.joint, event.kind) for event in run.events]
        texts = [f"{name}: {kind}" if name else kind for name, kind in named]
        times = np.array([event.time for event in run.events])
        drawing.columns("/events", times, rr.TextLog.columns(text=texts))
