"""Random contacts of all seven patterns, touching by construction: any two contours, placed on free bodies so that
their points coincide and their tangents lie in one plane, at parameters known beforehand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from hypothesis import assume, reject
from hypothesis import strategies as st
from numba.core.config import DISABLE_JIT

import pincontact as pc
from pincontact.dynamics.system import System
from pincontact.geometry.frames import contact_frame, dual_basis
from pincontact.integration.discrete import write_discrete
from pincontact.layout import CONDITION, OK, PATTERN

# dimensions of both contours
PATTERNS = {
    "P-2C": (0, 1),
    "P-3C": (0, 1),
    "P-S": (0, 2),
    "2C-2C": (1, 1),
    "3C-3C": (1, 1),
    "3C-S": (1, 2),
    "S-S": (2, 2),
}
PLANAR = ("P-2C", "2C-2C")
EIGHTH_ORDER = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
START = 0.37  # s, so that driven contours are somewhere in the middle of their motion


def _closed_points(columns: int, size: float) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * math.pi, 12, endpoint=False)
    radius = 0.4 + 0.05 * np.cos(3.0 * angle)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.1 * np.sin(2.0 * angle)])
    return size * points[:, :columns]


def _grid_of_points(size: float) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.4, 0.6, 8), indexing="ij")
    z = 0.2 * np.sin(2.0 * x) * np.cos(1.5 * y)
    return size * np.stack([x + 0.1 * y, y - 0.05 * x**2, z], axis=-1)


def _grid_of_heights(size: float) -> pc.Contour:
    x, y = np.linspace(-1.0, 1.0, 14), np.linspace(-0.8, 1.2, 13)
    return pc.HeightField(x, y, 0.1 * size * np.sin(2.0 * x)[:, None] * np.cos(3.0 * y)[None, :])


def _planar_fourier(size: float) -> pc.Contour:
    cosine, sine = np.array([(0.02, 0.01), (0.4, 0.02), (0.03, 0.02)]), np.array([(0, 0), (0.03, 0.3), (0, 0.02)])
    return pc.FourierCurve(size * cosine, size * sine)


def _fourier(size: float) -> pc.Contour:
    cosine = np.array([(0, 0, 0), (0.4, 0.02, 0.1), (0.03, 0.02, 0.05)])
    sine = np.array([(0, 0, 0), (0.03, 0.3, 0), (0, 0.02, 0.04)])
    return pc.FourierCurve(size * cosine, size * sine)


_WIDE = (-math.inf, math.inf)
_PLANAR_CURVES: dict[str, Callable[[float], pc.Contour]] = {
    "Line": lambda s: pc.Line(),
    "Circle": lambda s: pc.Circle(0.3 * s),
    "Ellipse": lambda s: pc.Ellipse(0.4 * s, 0.25 * s),
    "Cycloid": lambda s: pc.Cycloid(0.3 * s),
    "planar FourierCurve": _planar_fourier,
    "planar SplineCurve": lambda s: pc.SplineCurve(_closed_points(2, s), periodic=True),
    "planar ParametricCurve": lambda s: pc.ParametricCurve(
        lambda u: (0.5 * s * math.sinh(u), 0.3 * s * math.cosh(u), 0.0), (-1.0, 1.0)
    ),
    "planar curve in time": lambda s: pc.ParametricCurve(
        lambda u, t: (u + 0.1 * math.sin(3.0 * t), 0.3 * s * math.sin(2.0 * u - 4.0 * t), 0.0), _WIDE
    ),
}
_SPACE_CURVES: dict[str, Callable[[float], pc.Contour]] = {
    "Line": lambda s: pc.Line(),
    "Circle": lambda s: pc.Circle(0.3 * s),
    "Ellipse": lambda s: pc.Ellipse(0.4 * s, 0.25 * s),
    "Helix": lambda s: pc.Helix(0.2 * s, 0.3 * s),
    "FourierCurve": _fourier,
    "SplineCurve": lambda s: pc.SplineCurve(_closed_points(3, s), periodic=True),
    "ParametricCurve": lambda s: pc.ParametricCurve(lambda u: (u, s * u**2, 0.5 * u**3), _WIDE),
    "curve in time": lambda s: pc.ParametricCurve(
        lambda u, t: (u, 0.2 * s * math.sin(2.0 * u + 3.0 * t), 0.1 * math.cos(u) * math.exp(-t)), _WIDE
    ),
}
_SURFACES: dict[str, Callable[[float], pc.Contour]] = {
    "Plane": lambda s: pc.Plane(),
    "Sphere": lambda s: pc.Sphere(0.5 * s),
    "Ellipsoid": lambda s: pc.Ellipsoid(0.5 * s, 0.4 * s, 0.3 * s),
    "Cylinder": lambda s: pc.Cylinder(0.4 * s),
    "Cone": lambda s: pc.Cone(0.5 * s),
    "Torus": lambda s: pc.Torus(0.6 * s, 0.2 * s),
    "SurfaceOfRevolution": lambda s: pc.SurfaceOfRevolution(
        lambda z: (0.3 * s + 0.1 * math.cos(2.0 * z), 0.4 * z), (-1.0, 1.0)
    ),
    "HeightField": lambda s: pc.HeightField(lambda x, y: 0.1 * s * math.sin(2.0 * x) * math.cos(3.0 * y)),
    "HeightField of a grid": _grid_of_heights,
    "SplineSurface": lambda s: pc.SplineSurface(_grid_of_points(s)),
    # parameter lines at some 60 degrees
    "oblique ParametricSurface": lambda s: pc.ParametricSurface(
        lambda u, v: (u + 0.5 * v, v, 0.2 * s * u * v + 0.1 * u**2), (_WIDE, _WIDE)
    ),
    "surface in time": lambda s: pc.ParametricSurface(
        lambda u, v, t: (u + 0.3 * v + 0.1 * math.sin(2.0 * t), v, 0.2 * s * math.sin(u - 3.0 * t) * math.cos(v)),
        (_WIDE, _WIDE),
    ),
}
TABLES = {"curve": _SPACE_CURVES, "planar curve": _PLANAR_CURVES, "surface": _SURFACES}
# touching along a whole line wherever they touch
_LINE_CONTACTS = {
    ("Line", "Line"),
    ("Line", "Plane"),
    ("Plane", "Plane"),
    ("Plane", "Cylinder"),
    ("Plane", "Cone"),
    ("Cylinder", "Plane"),
    ("Cone", "Plane"),
}


def is_line_contact(pattern: str, names: tuple[str, str]) -> bool:
    """Whether these two contours never touch in a single point."""
    return names in _LINE_CONTACTS and pattern != "3C-3C"


def names_of(pattern: str, body: int) -> list[str]:
    """Names of the contours that body 1 or 2 of a pattern may have."""
    dimension = PATTERNS[pattern][body - 1]
    if dimension == 0:
        return ["Point"]
    return list(_SURFACES if dimension == 2 else _PLANAR_CURVES if pattern in PLANAR else _SPACE_CURVES)


@cache
def contour(pattern: str, body: int, name: str) -> pc.Contour:
    """A contour of the pools above; body 1's is smaller, so that two of a kind do not fit into each other."""
    if name == "Point":
        return pc.Point()
    kind = "surface" if PATTERNS[pattern][body - 1] == 2 else "planar curve" if pattern in PLANAR else "curve"
    return _contour(kind, name, 0.7 if body == 1 else 1.0)


@cache
def _contour(kind: str, name: str, size: float) -> pc.Contour:
    return TABLES[kind][name](size)


def _pose(t: float) -> pin.SE3:
    return pin.SE3(pin.exp3(np.array([0.3 * math.sin(t), 0.5 * t, 0.1])), np.array([0.1 * t * t, 0.2 * t, 0.1]))


def _callable(t: float) -> tuple[pin.SE3, np.ndarray, np.ndarray]:
    c, s = math.cos(2.0 * t), math.sin(2.0 * t)
    angle = 0.4 * s
    pose = pin.SE3(pin.exp3(np.array([0.0, 0.0, angle])), np.array([0.1 * s, 0.2 * c, 0.0]))
    velocity = np.array([0.2 * c, -0.4 * s, 0.0, 0.0, 0.0, 0.8 * c])
    acceleration = np.array([-0.4 * s, -0.8 * c, 0.0, 0.0, 0.0, -1.6 * s])
    return pose, velocity, acceleration


_TIMES = np.linspace(-0.5, 2.0, 9)
_PLANAR_MOTIONS: dict[str, Callable[[], pc.Motion | None]] = {
    "fixed": lambda: None,
    "planar harmonic": lambda: pc.HarmonicMotion(
        (0.1, 0.05, 0.0), 0.6, 0.3, (0.0, 0.0, 1.0), 0.4, 0.5, 0.2, (0.1, 0.2, 0)
    ),
    "planar twist": lambda: pc.ConstantTwist((0.0, 0.0, 1.5), (0.3, -0.2, 0.0), (0.2, 0.1, 0.0)),
    "callable": lambda: pc.CallableMotion(_callable),
}
_MOTIONS: dict[str, Callable[[], pc.Motion | None]] = {
    "fixed": lambda: None,
    "harmonic": lambda: pc.HarmonicMotion((0.1, 0.05, -0.1), 0.6, 0.3, (1.0, 2.0, 3.0), 0.4, 0.5, 0.2, (0.1, 0.2, 0)),
    "twist": lambda: pc.ConstantTwist((0.5, -1.0, 0.8), (0.3, -0.2, 0.1), (0.2, 0.1, 0.0)),
    "spline": lambda: pc.SplineMotion(_TIMES, [_pose(t) for t in _TIMES]),
    "callable": lambda: pc.CallableMotion(_callable),
}


def motions_of(pattern: str) -> list[str]:
    return list(_PLANAR_MOTIONS if pattern in PLANAR else _MOTIONS)


@cache
def motion(name: str) -> pc.Motion | None:
    return (_MOTIONS | _PLANAR_MOTIONS)[name]()


# Contacts this close to a line contact have rates that grow without bound, and differences with them.
WELL_PLACED = 0.05


# ---------------------------------------------------------------------------------------------------- scenes


def _angle_between(low: np.ndarray, onto: np.ndarray) -> float:
    return math.atan2(onto[1], onto[0]) - math.atan2(low[1], low[0])


def _frame_from(third: np.ndarray, first: np.ndarray) -> np.ndarray:
    """A rotation matrix with the direction of `third` as last column and `first` made orthogonal to it as first."""
    z = third / np.linalg.norm(third)
    x = first - (first @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _parameters(shape: pc.Contour, rng: np.random.Generator) -> np.ndarray:
    """Random parameters well inside the domain: poles, cusps and apices are elsewhere."""
    values = []
    for (low, high), periodic in zip(shape.domain, shape.periodic):
        low, high = max(low, -0.8 if math.isinf(high) else low), min(high, 0.8)
        low = low if math.isfinite(low) else -0.8
        if isinstance(shape, pc.Cone) and len(values) == 1:
            low, high = 0.4, 0.9
        inset = 0.0 if periodic else 0.15 * (high - low)
        values.append(rng.uniform(low + inset, high - inset))
    return np.array(values)


def _orientation(pattern: str, first: np.ndarray, second: np.ndarray, plane: np.ndarray, rng: Any) -> np.ndarray:
    """Rotation of contour 1 in the world that satisfies C2. first: derivatives in its own frame; second: world."""
    k1 = PATTERNS[pattern][0]
    if pattern in PLANAR:
        turn = rng.uniform(-math.pi, math.pi)
        if k1 == 1:
            turn = _angle_between(first[1], second[1]) + (math.pi if rng.random() < 0.5 else 0.0)
        return pin.exp3(np.array([0.0, 0.0, turn]))
    if k1 == 0 or pattern == "3C-3C":
        return pin.exp3(rng.normal(size=3))
    normal = np.cross(second[1], second[2])
    direction = rng.uniform(-1.0, 1.0) * second[1] / np.linalg.norm(second[1]) + rng.uniform(-1.0, 1.0) * second[2]
    if k1 == 1:
        # the tangent goes along a direction of the tangent plane, the rest is turned about it at will
        world = _frame_from(direction, normal)
        return (
            world
            @ pin.exp3(np.array([0.0, 0.0, rng.uniform(-math.pi, math.pi)]))
            @ _frame_from(first[1], np.eye(3)[int(np.argmin(np.abs(first[1])))]).T
        )
    flip = 1.0 if rng.random() < 0.5 else -1.0
    return _frame_from(flip * normal, direction) @ _frame_from(np.cross(first[1], first[2]), first[1]).T


def _moved(q: np.ndarray, step: np.ndarray) -> np.ndarray:
    """A planar (q of 4) or free (q of 7) joint moved by a step in its own axes, exact to rounding for any size."""
    if q.size == 4:
        c, s = math.cos(step[2]), math.sin(step[2])
        x, y, cosine, sine = q
        position = [x + cosine * step[0] - sine * step[1], y + sine * step[0] + cosine * step[1]]
        return np.array([*position, cosine * c - sine * s, sine * c + cosine * s])
    angle = float(np.linalg.norm(step[3:]))
    half = 0.5 * step[3:] * np.sinc(angle / (2.0 * math.pi))
    rotation = pin.Quaternion(q[6], *q[3:6])
    turn = pin.Quaternion(math.cos(0.5 * angle), *half)
    return np.array([*(q[:3] + rotation.matrix() @ step[:3]), *(rotation * turn).coeffs()])


@dataclass(frozen=True)
class Snapshot:
    """What the kernels found at one (q, v, t), copied; names as in `pincontact.layout`."""

    location: np.ndarray
    rates: np.ndarray
    basis: np.ndarray
    slip: np.ndarray
    gaps: np.ndarray
    rows: np.ndarray
    bias: np.ndarray
    first: np.ndarray
    second: np.ndarray
    frame: np.ndarray
    dual: np.ndarray
    condition: float


def carried(here: Snapshot, there: Snapshot) -> np.ndarray:
    """Two normals of a curve: which are taken is a choice, so those of `here`, at right angles to the tangent there."""
    e1 = there.basis[0]
    return here.basis[1:] - np.outer(here.basis[1:] @ e1, e1)


class RandomContact:
    """A scene with one contact, its state, and evaluations nearby.

    reverse: whether the user names body 2 first, where the pattern tells bodies apart.
    """

    def __init__(
        self,
        pattern: str,
        names: tuple[str, str],
        motions: tuple[str, str] = ("fixed", "fixed"),
        on_world: bool = False,
        seed: int = 0,
        friction: pc.FrictionLaw | None = None,
        reverse: bool = False,
    ) -> None:
        self._arguments = (pattern, names, motions, on_world, seed, friction, reverse)
        rng = np.random.default_rng(seed)
        planar = pattern in PLANAR
        shapes = [contour(pattern, body, name) for body, name in zip((1, 2), names)]
        drives = [motion(name) for name in motions]
        u1, u2 = (_parameters(shape, rng) for shape in shapes)
        in_body = [self._placement(planar, rng) for _ in range(2)]
        model = pin.Model()
        for body in ("one",) if on_world else ("one", "two"):
            joint = model.addJoint(
                0, pin.JointModelPlanar() if planar else pin.JointModelFreeFlyer(), pin.SE3.Identity(), body
            )
            model.appendBodyToJoint(joint, self._inertia(rng), pin.SE3.Identity())
            model.addBodyFrame(body, joint, pin.SE3.Identity(), 0)
        pose2 = self._placement(planar, rng)
        world2 = pose2 * in_body[1] * self._driven(drives[1], START)
        second = shapes[1].evaluate(u2, START) @ world2.rotation.T
        first = shapes[0].evaluate(u1, START)
        rotation = _orientation(pattern, first, second, world2.rotation[:, 2], rng)
        world1 = pin.SE3(rotation, world2.translation + second[0] - rotation @ first[0])
        pose1 = world1 * (in_body[0] * self._driven(drives[0], START)).inverse()
        scene = pc.Scene(model)
        place2 = pose2 * in_body[1] if on_world else in_body[1]
        attached = (
            scene.add_contour("first", shapes[0], "one", in_body[0], drives[0]),
            scene.add_contour("second", shapes[1], "universe" if on_world else "two", place2, drives[1]),
        )
        order = slice(None, None, -1 if reverse else 1)
        scene.add_contact(
            "c",
            *attached[order],
            friction=friction,
            bilateral=True,
            pattern=pattern,
            location=(u1 if u1.size else None, u2)[order],
            side=1 if rng.random() < 0.5 else -1,
        )
        q = np.concatenate([self._coordinates(planar, pose) for pose in ((pose1,) if on_world else (pose1, pose2))])
        self.pattern, self.scene, self.drives = pattern, scene, drives
        self.k = PATTERNS[pattern]
        self.state = scene.initial_state(q, 0.3 * rng.normal(size=model.nv), START)
        self.acceleration = rng.normal(size=model.nv)
        self.system = System(model, list(scene.contacts.values()))
        write_discrete(self.system, self.state.discrete)
        self.begin()

    def begin(self) -> None:
        """What differences from the state need."""
        self.rates = np.zeros_like(self.state.location)
        condition = self.at().condition
        self.rates = self.system.rates.copy()
        # differences of eighth order, where the location's derivatives grow by rates / condition: rounding 1e-15 / step
        self.step = 1e-3 * min(1.0, condition) / (1.0 + float(np.abs(self.rates).max()))

    def __repr__(self) -> str:
        return f"RandomContact{self._arguments}"

    def with_friction(self, friction: pc.FrictionLaw) -> RandomContact:
        """The same contact with another law."""
        *others, _, reverse = self._arguments
        return RandomContact(*others, friction, reverse)

    @staticmethod
    def _inertia(rng: np.random.Generator) -> pin.Inertia:
        return pin.Inertia(rng.uniform(0.5, 2.0), 0.1 * rng.normal(size=3), np.diag(rng.uniform(0.1, 0.15, 3)))

    @staticmethod
    def _placement(planar: bool, rng: np.random.Generator) -> pin.SE3:
        if planar:
            return pin.SE3(pin.exp3(np.array([0.0, 0.0, rng.normal()])), np.array([*rng.normal(size=2), 0.0]))
        return pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))

    @staticmethod
    def _driven(drive: pc.Motion | None, t: float) -> pin.SE3:
        return pin.SE3.Identity() if drive is None else drive.placement(t)

    @staticmethod
    def _coordinates(planar: bool, pose: pin.SE3) -> np.ndarray:
        if planar:
            return np.array([*pose.translation[:2], pose.rotation[0, 0], pose.rotation[1, 0]])
        return pin.SE3ToXYZQUAT(pose)

    def move_off(self, seed: int) -> bool:
        """Leave the constraints: the bodies part or overlap by centimetres, and their speeds are any.

        False where the contact point is lost on the way, or is no longer well placed.
        """
        rng, state, system = np.random.default_rng(seed), self.state, self.system
        size = 3 if self.pattern in PLANAR else 6
        for part in state.q.reshape(state.v.size // size, -1):
            part[:] = _moved(part, 0.02 * rng.normal(size=size))
        state.v[:] += 0.3 * rng.normal(size=state.v.size)
        system.q[:], system.v[:], system.location[:] = state.q, state.v, state.location
        if system.evaluate_kinematics(START) != OK:
            return False
        state.location[:] = system.location
        self.begin()
        return self.at().condition > WELL_PLACED

    def along(self, h: float) -> tuple[np.ndarray, np.ndarray]:
        """(q, v) after h s along a curve on which q' = v and v' = `acceleration` at h = 0, where they are compared."""
        q, v, a = self.state.q, self.state.v, self.acceleration
        size = 3 if self.pattern in PLANAR else 6
        steps = (h * v + 0.5 * h * h * a).reshape(-1, size)
        moved = [_moved(part, step) for part, step in zip(q.reshape(len(steps), -1), steps)]
        return np.concatenate(moved), v + h * a

    def evaluate(self, q: np.ndarray, v: np.ndarray, t: float) -> Snapshot:
        """The contact's kinematics at (q, v, t), near the state; the gap need not be closed."""
        system = self.system
        system.q[:], system.v[:] = q, v
        system.location[:] = self.state.location + (t - START) * self.rates
        assert system.evaluate_kinematics(t) == OK
        first, second = system.derivatives[0].copy(), system.derivatives[1].copy()
        frame = contact_frame(
            int(system.contact_int[0, PATTERN]), first, second, system.frames[1, :3, 2], system.basis[0]
        )
        k1, k2 = self.k
        columns = [*range(k1), *range(2, 2 + k2)]
        return Snapshot(
            system.location[0, columns].copy(),
            system.rates[0, columns].copy(),
            system.basis[0].copy(),
            system.slip[0].copy(),
            system.gaps[0].copy(),
            system.rows[0].copy(),
            system.bias[0].copy(),
            first,
            second,
            frame,
            dual_basis(frame),
            abs(float(system.contact_real[0, CONDITION])),
        )

    def at(self, h: float = 0.0) -> Snapshot:
        """The kinematics on the curve of `along`, h s after the state."""
        return self.evaluate(*self.along(h), START + h)

    def derivative(self, function: Callable[[float], Any]) -> np.ndarray:
        """d/dh of function(h) at h = 0, by differences of eighth order."""
        values = np.array([function(h) for h in self.step * np.arange(-4, 5)])
        return np.tensordot(EIGHTH_ORDER / self.step, values, axes=1)

    def material_points(self, h: float) -> np.ndarray:
        """(2, 3) world points of both contours at the parameters of h = 0, from Pinocchio's placements alone."""
        model = self.scene.model
        data = model.createData()
        pin.forwardKinematics(model, data, self.along(h)[0])
        points = []
        for attached, u in zip(self.scene.contours.values(), self.state.location_of("c")):
            pose = data.oMi[attached.joint] * attached.placement_in_joint * self._driven(attached.motion, START + h)
            points.append(pose.act(attached.contour.point(u, START + h)))
        return np.array(points)


@st.composite
def contacts(draw, pattern, friction=None, oblique=False, reversible=False):
    """A random contact of a pattern: contours, motions and placements; half of them with the second on the world.

    reversible: half of them are named in the order that is not the paper's.
    """
    names = [draw(st.sampled_from(names_of(pattern, body))) for body in (1, 2)]
    if oblique and PATTERNS[pattern][1] == 2:
        names[1] = draw(st.sampled_from(["oblique ParametricSurface", "SplineSurface", "surface in time"]))
    motions = tuple(draw(st.sampled_from(motions_of(pattern))) for _ in range(2))
    assume(not is_line_contact(pattern, tuple(names)))
    try:
        contact = RandomContact(
            pattern,
            tuple(names),
            motions,
            draw(st.booleans()),
            draw(st.integers(0, 10**6)),
            friction=friction,
            reverse=reversible and draw(st.booleans()),
        )
    except ZeroDivisionError:
        # kernels that are not compiled raise where compiled ones have an infinite number, at a degenerate candidate
        assert DISABLE_JIT
        reject()
    assume(contact.at().condition > WELL_PLACED)
    return contact
