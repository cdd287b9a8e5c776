"""A run at other times than its own: frames for a replay, at an even rate."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..arguments import check_positive, is_number
from ..contours.motion import connected
from ..dynamics.system import System
from ..errors import ArgumentError
from ..geometry.carriers import ORIGIN
from ..geometry.frames import contact_frame
from ..integration.discrete import write_discrete
from ..layout import FREE, OK, PATTERN, SLIPPING


@dataclass
class ContactFrames:
    """One contact at the times of the frames.

    mode: (n,) ints; point: (n, 3) world, m; normal, friction: (n, 3) the two parts of the force on the second
    contour, world, N; frame: (n, 3, 3) contact frames, where they were asked for. While the contact is open the forces
    are zero and the point stays on body 1 where it was.
    """

    mode: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    friction: np.ndarray
    frame: np.ndarray

    @property
    def touching(self) -> np.ndarray:
        return self.mode != FREE


def frame_times(t: np.ndarray, fps: float, speed: float, max_frames: int) -> np.ndarray:
    """Even times from the first to the last of t for a replay at fps frames per second of the viewer's time.

    t: (n,) in s; speed: seconds of motion per second of replay. Returns (m,), both ends included, at most
    max_frames: a longer run gets fewer frames per second, never a missing end.
    Raises ArgumentError for a rate or speed that is not positive, or fewer than two frames.
    """
    check_positive(fps=fps, speed=speed)
    if not (is_number(max_frames) and max_frames >= 2):
        raise ArgumentError(f"max_frames must be at least 2, got {max_frames!r}")
    if len(t) == 0:
        raise ArgumentError("the run has no recorded time to show")
    duration = float(t[-1] - t[0])
    # The tolerance keeps a whole number of frames whole.
    wanted = np.ceil(duration * fps / speed * (1.0 - 1e-12)) + 1.0
    return np.linspace(t[0], t[-1], int(np.clip(wanted, 2, max_frames)))


def intervals(t: np.ndarray, times: np.ndarray) -> np.ndarray:
    """For each of `times`, the row i of t with t[i] <= time < t[i + 1]; the last interval holds the last time.

    Where t repeats (before and after an event) the later row counts.
    """
    rows = np.searchsorted(t, times, side="right") - 1
    return np.clip(rows, 0, max(len(t) - 2, 0))


class Motion:
    """q as a smooth function of time between the rows of a run.

    Between two rows: the cubic in the tangent space of the first row's q that meets q and v at both ends, fourth
    order in the spacing. Where the velocities do not tell of the same motion as the configurations (an impact in
    between, rows half a turn apart) the shortest path instead, which is what the rows alone say. Places of free bodies
    follow cubics in the world, not screws: a ball that rolls stays on its table however far it rolls between two rows.
    """

    def __init__(self, model: pin.Model, t: np.ndarray, q: np.ndarray, v: np.ndarray) -> None:
        self._model = model
        self._t, self._q, self._v = t, q, v
        self._row = -1
        self._cubic = (np.zeros(0),) * 3
        joints = [joint for joint in model.joints if joint.shortname() == "JointModelFreeFlyer"]
        self._free = [(joint.idx_q, joint.idx_v) for joint in joints]
        self._places: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def _prepare(self, row: int) -> None:
        model = self._model
        h = self._t[row + 1] - self._t[row]
        q0, q1 = self._q[row], self._q[row + 1]
        d = pin.difference(model, q0, q1)
        start = h * self._v[row]
        end = h * (pin.dDifference(model, q0, q1, pin.ArgumentPosition.ARG1) @ self._v[row + 1])
        expected = 0.5 * (start + end)
        if not np.linalg.norm(d - expected) <= 0.5 * max(np.linalg.norm(d), np.linalg.norm(expected)):
            start = end = d
        self._row = row
        self._cubic = _cubic(d, start, end)
        self._places = []
        for at, v_at in self._free:
            moved = q1[at : at + 3] - q0[at : at + 3]
            ends = (moved, moved)
            if start is not end:
                rows = ((q0, self._v[row]), (q1, self._v[row + 1]))
                ends = tuple(h * pin.Quaternion(q[at + 3 : at + 7]).matrix() @ v[v_at : v_at + 3] for q, v in rows)
            self._places.append(_cubic(moved, *ends))

    def __call__(self, time: float, row: int) -> np.ndarray:
        """q, (nq,), at a time between rows `row` and `row + 1`."""
        if len(self._t) < 2 or not self._t[row + 1] > self._t[row]:
            return self._q[row]
        if row != self._row:
            self._prepare(row)
        s = (time - self._t[row]) / (self._t[row + 1] - self._t[row])
        q = pin.integrate(self._model, self._q[row], _at(self._cubic, s))
        for (at, _), place in zip(self._free, self._places):
            q[at : at + 3] = self._q[row, at : at + 3] + _at(place, s)
        return q


def _cubic(d: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients of s, s^2, s^3 of the cubic from 0 to d with these derivatives at both ends."""
    return start, 3.0 * d - 2.0 * start - end, start + end - 2.0 * d


def _at(cubic: tuple[np.ndarray, np.ndarray, np.ndarray], s: float) -> np.ndarray:
    linear, square, cube = cubic
    return s * (linear + s * (square + s * cube))


def configurations(run: Any, times: np.ndarray) -> np.ndarray:
    """q of a run at the given times, (n, nq)."""
    t, q, v = (np.asarray(x, dtype=float) for x in (run.t, run.q, run.v))
    motion = Motion(run.scene.model, t, q, v)
    return np.array([motion(time, row) for time, row in zip(times, intervals(t, times))])


def joint_placements(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """World placements of all joints; q: (n, nq). Returns (n, njoints, 4, 4), homogeneous."""
    data = model.createData()
    placements = np.empty((len(q), model.njoints, 4, 4))
    for row, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        for joint in range(model.njoints):
            placements[row, joint] = data.oMi[joint].homogeneous
    return placements


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """(n, 4) unit quaternions (x, y, z, w) of (n, 3, 3) rotations, sign-continuous."""
    return connected(np.array([pin.Quaternion(R).coeffs() for R in rotations]))


def split_force(contact: Any, track: Any) -> tuple[np.ndarray, np.ndarray]:
    """The normal and the friction part of a contact's force on its second contour, each (n, 3), world, in N.

    A point on a spatial curve has one tangential direction, e_1, and all the rest is normal; otherwise the normal
    part is along e_3 (Definition 5).
    """
    force, frame = np.nan_to_num(track.force), np.nan_to_num(track.frame)
    if contact.pattern.constraints == 2:
        tangent = frame[:, :, 0]
        friction = np.einsum("ij,ij->i", force, tangent)[:, None] * tangent
        return force - friction, friction
    normal = frame[:, :, 2]
    part = np.einsum("ij,ij->i", force, normal)[:, None] * normal
    return part, force - part


def contour_placements(attached: Any, placements: np.ndarray, times: np.ndarray) -> np.ndarray:
    """World placements of a contour, (n, 4, 4), from those of all joints, (n, njoints, 4, 4), at these times."""
    carrier = placements[:, attached.joint] @ attached.placement_in_joint.homogeneous
    if attached.motion is None:
        return carrier
    return carrier @ np.array([attached.motion.placement(t).homogeneous for t in times])


def _phases(t: np.ndarray, touching: np.ndarray, chart: np.ndarray) -> np.ndarray:
    """(n,) numbers, equal for consecutive rows of one phase: touching or not, two charts (n, 2), increasing times."""
    cut = (touching[1:] != touching[:-1]) | (chart[1:] != chart[:-1]).any(axis=1) | ~(t[1:] > t[:-1])
    return np.concatenate([[0], np.cumsum(cut)])


def contact_frames(
    run: Any, name: str, times: np.ndarray, q: np.ndarray, placements: np.ndarray, axes: bool = False
) -> ContactFrames:
    """One contact of a run at the given times.

    q: (n, nq), the configurations then; placements: (n, njoints, 4, 4), those of the joints.

    The contact point, and the contact frame if `axes` asks for it, are located anew at each time; the location
    parameters of the run's rows, interpolated, are only where the search starts. Forces are interpolated by monotone
    cubics, each phase of contact by itself: no component overshoots the recorded ones or leaks into an open phase.
    """
    from scipy.interpolate import PchipInterpolator

    contact, track = run.scene.contacts[name], run.contacts[name]
    t, dimension = np.asarray(run.t, dtype=float), contact.body1.contour.dimension
    charts = track.charts
    normal, friction = split_force(contact, track)
    rows = np.column_stack([normal, friction, track.location])
    touching = (track.mode != FREE) & np.isfinite(rows).all(axis=1)
    row = intervals(t, times)
    # The last time belongs to the last row, not to the one before it.
    row = np.where(times >= t[-1], len(t) - 1, row)

    values = np.where(touching[row][:, None], rows[row], 0.0)
    phase = _phases(t, touching, charts)
    for number in np.unique(phase[touching]):
        members = np.flatnonzero(phase == number)
        # Between the last row of a phase and the next phase there is nothing to interpolate with.
        inside = (phase[row] == number) & (times <= t[members[-1]])
        if len(members) > 1 and inside.any():
            values[inside] = PchipInterpolator(t[members], rows[members], axis=0)(times[inside])

    shown = touching[row]
    held = np.maximum.accumulate(np.where(shown, np.arange(len(times)), -1))
    held = np.where(held >= 0, held, int(np.argmax(shown)))
    carrier = contour_placements(contact.body1, placements, times)
    locator = _Locator(run, name)
    points, frames = np.empty((len(times), 3)), np.tile(np.eye(3), (len(times), 1, 1))
    for i, k in enumerate(held):
        found = locator.find(int(row[i]), q[i], float(times[i]), values[i, 6:]) if shown[i] else False
        if found:
            points[i] = locator.point
            if axes:
                frames[i] = locator.frame()
        else:
            # An open contact's point stays on body 1 where it was.
            local = contact.body1.contour.point(
                list(values[k, 6 : 6 + dimension]), float(times[i]), int(charts[row[k], 0])
            )
            points[i] = carrier[i, :3, :3] @ local + carrier[i, :3, 3]
            frames[i] = frames[i - 1] if i else frames[i]
    return ContactFrames(np.where(shown, track.mode[row], FREE), points, values[:, 0:3], values[:, 3:6], frames)


class _Locator:
    """Finds the contact point of one contact at any configuration near a row of a run."""

    def __init__(self, run: Any, name: str) -> None:
        contact = run.scene.contacts[name]
        self._run, self._number = run, list(run.scene.contacts).index(name)
        self._system = System(run.scene.model, [contact])
        self._sizes = contact.body1.contour.dimension, contact.body2.contour.dimension
        self._row = -1

    def find(self, row: int, q: np.ndarray, t: float, location: np.ndarray) -> bool:
        """Whether there is a contact point; location: (k,) where to start from."""
        system, (k1, k2) = self._system, self._sizes
        if row != self._row:
            # charts, sides and branches hold between rows
            self._discrete = self._run.state(row).discrete[self._number : self._number + 1]
            self._row = row
        write_discrete(system, self._discrete)
        system.q[:], system.v[:] = q, 0.0
        system.location[0] = 0.0
        system.location[0, :k1], system.location[0, 2 : 2 + k2] = location[:k1], location[k1:]
        return bool(system.evaluate_kinematics(t) == OK and np.isfinite(self.point).all())

    @property
    def point(self) -> np.ndarray:
        """(3,) the point on body 1, world."""
        return np.array(self._system.frames[0][ORIGIN] + self._system.derivatives[0][0])

    def frame(self) -> np.ndarray:
        """(3, 3) e_1, e_2, e_3 (Definition 5) as columns, world."""
        system = self._system
        first, second = system.derivatives[0].copy(), system.derivatives[1].copy()
        pattern = int(system.contact_int[0, PATTERN])
        return np.array(contact_frame(pattern, first, second, system.frames[1][0:3, 2].copy(), system.basis[0]))


def friction_limit(law: Any, mode: np.ndarray, normal: np.ndarray, speed: np.ndarray) -> np.ndarray | None:
    """Largest dry friction force in N that a law allows, (n,); None where it sets no single limit.

    mode: (n,); normal: (n,) in N; speed: (n,) of slip, m/s. Sliding contacts have the coefficient of their speed, all
    others the one up to which they stick.
    """
    if law is None or not np.isfinite(law.sticking) or law.aspect != 1.0:
        return None
    slipping = mode == SLIPPING
    coefficient = np.full(slipping.shape, law.sticking)
    coefficient[slipping] = law.coefficient(speed[slipping])
    return coefficient * normal


def turning_rate(run: Any, joints: Iterable[int], most: int = 500) -> float:
    """The fastest turning in rad/s of any of these joints' bodies, at the rows of a run, or `most` of them."""
    model = run.scene.model
    data = model.createData()
    fastest = 0.0
    for row in range(0, len(run.t), max(1, len(run.t) // most)):
        pin.forwardKinematics(model, data, np.asarray(run.q[row]), np.asarray(run.v[row]))
        fastest = max([fastest, *(float(np.linalg.norm(data.v[j].angular)) for j in joints)])
    return fastest
