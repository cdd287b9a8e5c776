"""What a scene of the benchmark is: numbers from which every engine builds it for itself, and its kinematics.

Nothing here knows an engine. SI units; q and v of a body are what Pinocchio calls them: a free joint has q = (position,
quaternion x y z w) and v = (linear, angular velocity) in body axes; the other joints have their own coordinate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

G = 9.81
NO_SLIP = math.inf
WORLD = "world"
CENTRE = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Body:
    """A rigid body on a joint. place (3,), turn (3, 3): the joint's frame in the parent's; axis (3,) in that frame.

    com (3,) in body axes, inertia (3, 3) about it. damping, stiffness: of the joint's spring, which rests at `rest`.
    """

    name: str
    joint: str  # free, revolute, prismatic or translation
    mass: float
    inertia: np.ndarray
    parent: str = WORLD
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    damping: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers in q and in v."""
        return {"free": (7, 6), "translation": (3, 3)}.get(self.joint, (1, 1))


@dataclass(frozen=True)
class Shape:
    """A shape on a body, at a place in its frame.

    kind: disk (radius; axis z), sphere (radius), bowl (radius; the inside), ellipsoid (semi-axes), plane (z = 0), line
    (along x), point, helix (radius, pitch per turn).
    """

    kind: str
    size: tuple[float, ...] = ()
    body: str = WORLD
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)


FLOOR = Shape("plane")


@dataclass(frozen=True)
class Touch:
    """Two shapes in contact, or apart at the start; mu = 0 is frictionless, infinity ideal rolling or sticking."""

    first: Shape
    second: Shape
    mu: float
    side: int | None = None
    bilateral: bool = False
    apart: bool = False


@dataclass(frozen=True)
class Drive:
    """Generalised forces of time: amplitude * sin(rate t + phase), entries (nv,) as in v.

    Those of a free joint are along the axes of a body that does not turn.
    """

    amplitude: np.ndarray
    rate: float
    phase: np.ndarray

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Rows (n, nv) at times (n,)."""
        return self.amplitude * np.sin(np.multiply.outer(times, np.full_like(self.phase, self.rate)) + self.phase)


@dataclass(frozen=True)
class Problem:
    """A scene, its start (as written; made consistent before it is handed to the engines) and what is measured.

    markers: (body, point in its frame); the error is the largest distance of any of them from the reference at any of
    intervals + 1 equidistant times. closed_form: positions (n, markers, 3) at times (n,), or None. starts_at_stick:
    the start's velocity is made consistent with sticking contacts, not only with touching ones. events: contacts stick,
    slip, open and close again and again.
    """

    name: str
    title: str
    bodies: tuple[Body, ...]
    touches: tuple[Touch, ...]
    q: np.ndarray
    v: np.ndarray
    duration: float
    markers: tuple[tuple[str, tuple[float, float, float]], ...]
    measured: str
    closed_form: Callable[[np.ndarray], np.ndarray] | None = None
    gravity: tuple[float, float, float] = (0.0, 0.0, -G)
    intervals: int = 20
    starts_at_stick: bool = False
    drive: Drive | None = None
    events: bool = False

    @property
    def times(self) -> np.ndarray:
        return np.linspace(0.0, self.duration, self.intervals + 1)

    def body(self, name: str) -> Body:
        return next(b for b in self.bodies if b.name == name)

    def slices(self) -> dict[str, tuple[slice, slice]]:
        """Where each body's numbers are in q and in v."""
        found, iq, iv = {}, 0, 0
        for body in self.bodies:
            nq, nv = body.sizes
            found[body.name] = (slice(iq, iq + nq), slice(iv, iv + nv))
            iq, iv = iq + nq, iv + nv
        return found


# ---------------------------------------------------------------------------------------------------- kinematics


def rotation(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    """Rotation by an angle about an axis (Rodrigues)."""
    x = skew(np.array(axis) / np.linalg.norm(axis))
    return np.eye(3) + math.sin(angle) * x + (1.0 - math.cos(angle)) * x @ x


def skew(a: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def matrix(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix of a quaternion (x, y, z, w), which need not be of length one."""
    w, u = quaternion[3], skew(quaternion[:3])
    return np.eye(3) + 2.0 / (quaternion @ quaternion) * (w * u + u @ u)


def quaternion(turn: np.ndarray) -> np.ndarray:
    """Quaternion (x, y, z, w) of a rotation matrix."""
    pairs = 1.0 + np.array(
        [
            turn[0, 0] - turn[1, 1] - turn[2, 2],
            turn[1, 1] - turn[0, 0] - turn[2, 2],
            turn[2, 2] - turn[0, 0] - turn[1, 1],
            turn[0, 0] + turn[1, 1] + turn[2, 2],
        ]
    )
    largest = int(np.argmax(pairs))
    s = 2.0 * math.sqrt(pairs[largest])
    out = np.empty(4)
    out[largest] = 0.25 * s
    x = (turn - turn.T) / s
    odd = np.array([x[2, 1], x[0, 2], x[1, 0]])
    if largest == 3:
        out[:3] = odd
        return out
    out[3] = odd[largest]
    for i in range(3):
        if i != largest:
            out[i] = (turn[i, largest] + turn[largest, i]) / s
    return out


@dataclass
class Pose:
    """A body in the world: rotation (3, 3), origin (3,), velocity of the origin and angular velocity in world axes."""

    turn: np.ndarray
    place: np.ndarray
    velocity: np.ndarray
    omega: np.ndarray


def poses(problem: Problem, q: np.ndarray, v: np.ndarray | None = None) -> dict[str, Pose]:
    """Where every body is, and how it moves."""
    out = {WORLD: Pose(np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))}
    v = np.zeros(len(q)) if v is None else v
    for body, (iq, iv) in zip(problem.bodies, problem.slices().values()):
        parent, x, u = out[body.parent], q[iq], v[iv]
        turn, arm = parent.turn @ body.turn, parent.turn @ np.array(body.place)
        omega, relative = parent.omega, np.zeros(3)
        axis = turn @ np.array(body.axis)
        if body.joint == "free":
            turn, arm = turn @ matrix(x[3:]), arm + turn @ x[:3]
            relative, omega = turn @ u[:3], omega + turn @ u[3:]
        elif body.joint == "revolute":
            turn = turn @ rotation(body.axis, float(x[0]))
            omega = omega + axis * u[0]
        elif body.joint == "prismatic":
            arm, relative = arm + axis * x[0], axis * u[0]
        else:
            arm, relative = arm + turn @ x, turn @ u
        velocity = parent.velocity + np.cross(parent.omega, arm) + relative
        out[body.name] = Pose(turn, parent.place + arm, velocity, omega)
    return out


def marked(problem: Problem, configurations: np.ndarray) -> np.ndarray:
    """Positions (n, markers, 3) of the markers for configurations (n, nq)."""
    out = np.empty((len(configurations), len(problem.markers), 3))
    for i, q in enumerate(configurations):
        where = poses(problem, q)
        for k, (name, point) in enumerate(problem.markers):
            out[i, k] = where[name].place + where[name].turn @ np.array(point)
    return out


def free(position, turn, velocity, omega) -> tuple[np.ndarray, np.ndarray]:
    """(q, v) of a free joint from the velocity of its origin in world axes and the angular velocity in body axes."""
    return np.r_[position, quaternion(turn)], np.r_[turn.T @ np.asarray(velocity, float), omega]


def balanced(bodies: tuple[Body, ...], q: np.ndarray, feet: tuple[Touch, ...]) -> tuple[Body, ...]:
    """The bodies with joint springs that rest so that every foot carries the same part of the weight at q.

    The names of what is in a leg begin with the same two letters.
    """
    bare = Problem("", "", bodies, (), q, np.zeros(len(q)), 0.0, (), "")
    where, slices = poses(bare, q), bare.slices()
    force = np.array([0.0, 0.0, G * sum(body.mass for body in bodies) / len(feet)])
    found = []
    for body in bodies:
        if body.stiffness:
            foot = next(touch.first for touch in feet if touch.first.body[:2] == body.name[:2])
            leg = where[foot.body]
            arm = leg.place + leg.turn @ np.array(foot.place) - where[body.name].place
            torque = -(where[body.name].turn @ np.array(body.axis)) @ np.cross(arm, force)
            body = replace(body, rest=float(q[slices[body.name][0]][0] + torque / body.stiffness))
        found.append(body)
    return tuple(found)
