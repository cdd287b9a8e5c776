"""A run at other times than its own: frames for a replay, at an even rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..arguments import check_positive, is_number
from ..errors import ArgumentError
from ..layout import FREE, FRICTIONLESS, SLIPPING, STICK
from .arrows import continuous

MODE_NAMES = {FREE: "free", FRICTIONLESS: "frictionless", STICK: "stick", SLIPPING: "slip"}


@dataclass
class ContactFrames:
    """One contact at the times of the frames.

    mode: (n,) ints; point: (n, 3) world, m; normal, friction: (n, 3) the two parts of the force on the second
    contour, world, N. While the contact is free the forces are zero and the point stays on body 1 where it was.
    """

    mode: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    friction: np.ndarray

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
    between, rows half a turn apart) the shortest path instead, which is what the rows alone say.
    """

    def __init__(self, model: pin.Model, t: np.ndarray, q: np.ndarray, v: np.ndarray) -> None:
        self._model = model
        self._t, self._q, self._v = t, q, v
        self._row = -1
        self._cubic = (np.zeros(0),) * 3

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
        self._cubic = (start, 3.0 * d - 2.0 * start - end, start + end - 2.0 * d)

    def __call__(self, time: float, row: int) -> np.ndarray:
        """q, (nq,), at a time between rows `row` and `row + 1`."""
        if len(self._t) < 2 or not self._t[row + 1] > self._t[row]:
            return self._q[row]
        if row != self._row:
            self._prepare(row)
        s = (time - self._t[row]) / (self._t[row + 1] - self._t[row])
        linear, square, cube = self._cubic
        return pin.integrate(self._model, self._q[row], s * (linear + s * (square + s * cube)))


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
    return continuous(np.array([pin.Quaternion(R).coeffs() for R in rotations]))


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
    """(n,) numbers, equal for consecutive rows of one phase: one contact, one chart, increasing times."""
    cut = (touching[1:] != touching[:-1]) | (chart[1:] != chart[:-1]) | ~(t[1:] > t[:-1])
    return np.concatenate([[0], np.cumsum(cut)])


def contact_frames(run: Any, name: str, times: np.ndarray, placements: np.ndarray) -> ContactFrames:
    """One contact of a run at the given times, when the joints are at placements, (n, njoints, 4, 4).

    Forces and location parameters are interpolated by monotone cubics, each phase of contact by itself: no component
    of a force overshoots the recorded ones or leaks into a free phase. The point is that of body 1's contour at its
    parameters, so that it lies on the contour however far apart the rows are.
    """
    from scipy.interpolate import PchipInterpolator

    contact, track = run.scene.contacts[name], run.contacts[name]
    t, body = np.asarray(run.t, dtype=float), contact.body1
    dimension = body.contour.dimension
    location, chart = track.location[:, :dimension], track.charts[:, 0]
    normal, friction = split_force(contact, track)
    rows = np.column_stack([normal, friction, location])
    touching = (track.mode != FREE) & np.isfinite(rows).all(axis=1)
    row = intervals(t, times)
    # The last time belongs to the last row, not to the one before it.
    row = np.where(times >= t[-1], len(t) - 1, row)

    values = np.where(touching[row][:, None], rows[row], 0.0)
    phase = _phases(t, touching, chart)
    for number in np.unique(phase[touching]):
        members = np.flatnonzero(phase == number)
        # Between the last row of a phase and the next phase there is nothing to interpolate with.
        inside = (phase[row] == number) & (times <= t[members[-1]])
        if len(members) > 1 and inside.any():
            values[inside] = PchipInterpolator(t[members], rows[members], axis=0)(times[inside])

    shown = touching[row]
    held = np.maximum.accumulate(np.where(shown, np.arange(len(times)), -1))
    held = np.where(held >= 0, held, int(np.argmax(shown)))
    carrier = contour_placements(body, placements, times)
    points = np.empty((len(times), 3))
    for i, k in enumerate(held):
        local = body.contour.point(list(values[k, 6:]), float(times[i]), int(chart[row[k]]))
        points[i] = carrier[i, :3, :3] @ local + carrier[i, :3, 3]
    return ContactFrames(np.where(shown, track.mode[row], FREE), points, values[:, 0:3], values[:, 3:6])
