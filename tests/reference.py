"""Reader of the reference trajectories in `data`: scenes as models and contacts, and how far a run is from them.

The references were computed with contours as expressions, automatic differentiation and two other integrators, which
agree to 1e-12 m and 4e-12 rad; forces to 2e-9 of their maximum. `scenes.json` says what each scene is; its free
joints have the velocity of the body's origin in world axes and the angular velocity in body axes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import pincontact as pc

DATA = Path(__file__).parent / "data"
SPECIFICATIONS: dict[str, dict[str, Any]] = json.loads((DATA / "scenes.json").read_text())
NAMES = list(SPECIFICATIONS)

PLANAR_PATTERNS = ("P-2C", "2C-2C")
# what the references call an event, and what the package calls it
KINDS = {"slip->stick": "stick", "stick->slip": "slip", "slip reversal": "slip", "detach": "separate"}
# contour in body, contour, drive
Shape = tuple[pc.Contour, pin.SE3, pc.Motion | None]


# ---------------------------------------------------------------------------------------------------- model


def build_model(name: str) -> pin.Model:
    """The scene's mechanism; a frame of the model for each body."""
    specification = SPECIFICATIONS[name]
    planar = specification["contacts"][0]["pattern"] in PLANAR_PATTERNS
    model = pin.Model()
    model.gravity.linear = np.array(specification["gravity"], dtype=float)
    joints = {"world": 0}
    for body in specification["bodies"]:
        placement = pin.SE3(np.eye(3), np.array(body.get("placement", {}).get("p", (0.0, 0.0, 0.0)), dtype=float))
        joint = joints[body.get("parent", "world")]
        for i, part in enumerate(joint_models(body["joint"], planar)):
            joint = model.addJoint(joint, part, placement if i == 0 else pin.SE3.Identity(), f"{body['name']} {i}")
        joints[body["name"]] = joint
        inertia = pin.Inertia(body["mass"], np.array(body.get("com", (0.0, 0.0, 0.0))), np.array(body["inertia"]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addBodyFrame(body["name"], joint, pin.SE3.Identity(), 0)
    return model


def joint_models(joint: dict[str, Any], planar: bool) -> list[Any]:
    """Pinocchio's joints, base first; a planar pattern needs a mechanism that keeps to the plane."""
    kind = joint["type"]
    if kind == "free":
        return [pin.JointModelFreeFlyer()]
    if kind == "planar":
        return [pin.JointModelPlanar()]
    if kind == "translation":
        return [pin.JointModelPX(), pin.JointModelPY()] if planar else [pin.JointModelTranslation()]
    axis = np.array(joint["axis"], dtype=float)
    return [pin.JointModelRevoluteUnaligned(axis) if kind == "revolute" else pin.JointModelPrismaticUnaligned(axis)]


def initial_coordinates(name: str) -> tuple[np.ndarray, np.ndarray]:
    """The scene's initial (q, v) as Pinocchio has them."""
    specification = SPECIFICATIONS[name]
    planar = specification["contacts"][0]["pattern"] in PLANAR_PATTERNS
    q, v = [], []
    for body in specification["bodies"]:
        position, velocity = (np.array(part, dtype=float) for part in specification["init"][body["name"]])
        kind = body["joint"]["type"]
        if kind == "free":
            quaternion = pin.Quaternion(*position[3:])
            q += [*position[:3], *quaternion.coeffs()]
            v += [*(quaternion.matrix().T @ velocity[:3]), *velocity[3:]]
        elif kind == "planar":
            c, s = math.cos(position[2]), math.sin(position[2])
            q += [position[0], position[1], c, s]
            v += [c * velocity[0] + s * velocity[1], -s * velocity[0] + c * velocity[1], velocity[2]]
        elif kind == "translation" and planar:
            q += [*position[:2]]
            v += [*velocity[:2]]
        else:
            q += [*position]
            v += [*velocity]
    return np.array(q), np.array(v)


# ---------------------------------------------------------------------------------------------------- contours


def function_of(contour: dict[str, Any]) -> Callable[..., tuple[float, float, float]]:
    """The contour's expression as a Python function of its parameters, and of t where t occurs."""
    timed = any("t" in compile(text, "contour", "eval").co_names for text in contour["expr"])
    arguments = ", ".join([*contour["vars"], *(["t"] if timed else [])])
    names = {"__name__": __name__, "sin": math.sin, "cos": math.cos}
    return eval(f"lambda {arguments}: ({', '.join(contour['expr'])})", names | contour["const"])


def from_expression(contour: dict[str, Any]) -> Shape:
    """The contour as a parametric one: its own chart, its own orientation. Angles are found by trial."""
    dimension, function = len(contour["vars"]), function_of(contour)
    if dimension == 0:
        return pc.Point(), pin.SE3(np.eye(3), np.array(function())), None
    timed = function.__code__.co_argcount > dimension
    turn = 2.0 * math.pi
    periodic = []
    for a in range(dimension):
        arguments = [0.3, 0.7, 1.1][: dimension + timed]
        moved = [value + turn if i == a else value for i, value in enumerate(arguments)]
        periodic.append(bool(np.allclose(function(*arguments), function(*moved), rtol=0.0, atol=1e-12)))
    domain = tuple((-math.pi, math.pi) if closed else (-math.inf, math.inf) for closed in periodic)
    if dimension == 1:
        return pc.ParametricCurve(function, domain[0], periodic[0]), pin.SE3.Identity(), None
    return pc.ParametricSurface(function, domain, tuple(periodic)), pin.SE3.Identity(), None


def turned(axis: str, angle: float, position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> pin.SE3:
    """A placement: turned about a coordinate axis, at a position."""
    return pin.SE3(pin.utils.rotate(axis, angle), np.array(position))


_UPRIGHT = turned("x", 0.5 * math.pi)  # a curve of the xy-plane in the xz-plane


def _heaving() -> pc.Motion:
    # z = H sin(W t) in the world, seen from the tilted frame that carries the plate
    amplitude = turned("x", -0.15).rotation @ np.array([0.0, 0.0, 0.05])
    return pc.HarmonicMotion(amplitude, frequency=6.0 / (2.0 * math.pi))


def _field(x: float, y: float) -> float:
    return 0.05 * math.sin(6.0 * x) * math.sin(5.0 * y + 0.3)


def _placed(contour: pc.Contour, placement: pin.SE3 | None = None, motion: pc.Motion | None = None) -> Shape:
    return contour, placement if placement is not None else pin.SE3.Identity(), motion


def _rolling_disk(name: str) -> tuple[Shape, Shape]:
    radius = SPECIFICATIONS[name]["contacts"][0]["B1"]["const"]["R"]
    return _placed(pc.Circle(radius)), _placed(pc.Plane())


@cache
def _native_shapes() -> dict[str, tuple[Shape | None, Shape]]:
    point = None
    return {
        "helix_bead_slip": (point, _placed(pc.Helix(0.3, 0.2 * math.pi))),
        "bead_on_free_hoop": (point, _placed(pc.Circle(0.4), _UPRIGHT)),
        "ellipse_bead_friction": (point, _placed(pc.Ellipse(0.5, 0.3))),
        "cycloid_small": (point, _placed(pc.Cycloid(0.25))),
        "rod_slide_regular_push": (point, _placed(pc.Line())),
        "point_in_ellipsoid_slip": (point, _placed(pc.Ellipsoid(0.6, 0.5, 0.4))),
        "arm_on_heightfield_frictionless": (point, _placed(pc.HeightField(_field))),
        "tripod_slide_straight": (point, _placed(pc.Plane())),
        "disk_in_circular_bowl_slip_then_roll": (_placed(pc.Circle(0.2)), _placed(pc.Circle(1.0))),
        "ellipse_on_line_roll": (_placed(pc.Ellipse(0.3, 0.2)), _placed(pc.Line())),
        "cam_eccentric_flat_follower": (
            _placed(pc.Line()),
            _placed(
                pc.Circle(0.1), turned("x", 0.0, (0.03, 0.0, 0.0)), pc.ConstantTwist((0, 0, 5), center=(-0.03, 0, 0))
            ),
        ),
        "ring_on_rod_slip_then_stick": (_placed(pc.Circle(0.2)), _placed(pc.Line(), turned("y", 0.05))),
        "ring_on_fixed_circle_frictionless": (_placed(pc.Circle(0.2)), _placed(pc.Circle(0.3), _UPRIGHT)),
        "disk_heaving_incline_roll": (_placed(pc.Circle(0.4)), _placed(pc.Plane(), turned("x", 0.15), _heaving())),
        "disk_on_sphere_detach": (_placed(pc.Circle(0.3)), _placed(pc.Sphere(2.0))),
        "ball_in_bowl_3d_roll": (_placed(pc.Sphere(0.15)), _placed(pc.Sphere(1.0))),
        "ellipsoid_on_plane_roll": (_placed(pc.Ellipsoid(0.3, 0.22, 0.15)), _placed(pc.Plane())),
        "ellipsoid_in_ellipsoid_slip_then_roll": (
            _placed(pc.Ellipsoid(0.25, 0.18, 0.12)),
            _placed(pc.Ellipsoid(1.2, 0.9, 0.7)),
        ),
        "ball_on_plane_through_pole": (_placed(pc.Sphere(0.1)), _placed(pc.Plane())),
        "two_free_ellipsoids_frictionless": (
            _placed(pc.Ellipsoid(0.25, 0.18, 0.12)),
            _placed(pc.Ellipsoid(0.3, 0.35, 0.2)),
        ),
        **{name: _rolling_disk(name) for name in NAMES if name.startswith("disk_plane")},
    }


def native_shapes(name: str) -> tuple[Shape | None, Shape] | None:
    """Both shapes of every contact as the package's own contours (None for body 1: the expression's point).

    The charts differ from the expressions'. None where there is no such shape.
    """
    return _native_shapes().get(name)


# Which side of e_3 body 1 lies on, where native shapes do not decide it: a point inside an ellipsoid, crossing curves
# (the native line and circle run along the expressions').
_NATIVE_SIDES = {
    "rod_slide_regular_push": -1,
    "point_in_ellipsoid_slip": -1,
    "ring_on_rod_slip_then_stick": -1,
    "ring_on_fixed_circle_frictionless": -1,
}
NATIVE_NAMES = [name for name in NAMES if native_shapes(name) is not None]


# ---------------------------------------------------------------------------------------------------- scenes and runs


def friction_of(contact: dict[str, Any], mode: str) -> pc.FrictionLaw | None:
    """No coefficient means frictionless, or ideal rolling where the scene sticks."""
    if contact["mu"] is not None:
        return pc.Coulomb(contact["mu"])
    return pc.NoSlip() if mode == "stick" else None


def build(name: str, native: bool = False) -> tuple[pc.Scene, pc.State]:
    """The scene and its initial state, with contours from expressions or the package's own."""
    specification = SPECIFICATIONS[name]
    scene = pc.Scene(build_model(name))
    shapes = native_shapes(name) if native else None
    for i, contact in enumerate(specification["contacts"]):
        attached = []
        for j, key in enumerate(("B1", "B2")):
            given = contact[key]
            shape = shapes[j] if shapes is not None else None
            contour, placement, motion = shape if shape is not None else from_expression(given)
            frame = "universe" if given["body"] == "world" else given["body"]
            attached.append(scene.add_contour(f"{i} {key}", contour, frame, placement, motion))
        k1 = len(contact["B1"]["vars"])
        start = specification["loc0"][i]
        scene.add_contact(
            str(i),
            *attached,
            friction=friction_of(contact, specification["mode0"][i]),
            bilateral=not contact["unilateral"],
            pattern=contact["pattern"],
            location=None if native else (start[:k1] if k1 else None, start[k1:]),
            side=_NATIVE_SIDES.get(name) if native else -int(contact["sg"]),
        )
    return scene, scene.initial_state(*initial_coordinates(name))


@dataclass(frozen=True)
class Reference:
    """One stored trajectory, a row per time.

    t (n,); of nb bodies: p (n, nb, 3) of the centre of mass, R (n, nb, 3, 3) body to world, v, w in world axes; of nc
    contacts: loc (parameters, contact by contact, body 1 before body 2), point, force on body 2, force_dual (e_j . F),
    frame (e_1, e_2, e_3 as columns), slip (v_c), mode (-1 open, 0 frictionless, 1 stick, 2 slip).
    """

    name: str
    until: float = math.inf

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        with np.load(DATA / f"{self.name}.npz") as file:
            rows = file["t"] <= self.until
            return {key: file[key][rows] for key in file.files}

    def __getitem__(self, key: str) -> np.ndarray:
        return self.arrays[key]

    @property
    def contacts(self) -> list[dict[str, Any]]:
        return SPECIFICATIONS[self.name]["contacts"]

    @property
    def events(self) -> list[dict[str, Any]]:
        return [event for event in SPECIFICATIONS[self.name]["events"] if event["t"] <= self.until]

    def away_from_events(self, seconds: float = 1e-3) -> np.ndarray:
        """Rows at which forces are as certain as the motion."""
        t = self["t"]
        return np.all([np.abs(t - event["t"]) > seconds for event in self.events] or [t >= t[0]], axis=0)


@cache
def reference(name: str, until: float = math.inf) -> Reference:
    return Reference(name, until)


@cache
def simulated(
    name: str, native: bool = False, rtol: float = 1e-10, method: str = "DOP853", until: float = math.inf
) -> pc.Trajectory:
    """The scene integrated on the reference's times."""
    scene, state = build(name, native)
    times = reference(name, until)["t"]
    return pc.simulate(scene, state, float(times[-1]), rtol=rtol, atol=1e-2 * rtol, t_eval=times, method=method)


# ---------------------------------------------------------------------------------------------------- errors


@dataclass(frozen=True)
class BodyMotion:
    """World motion of the bodies of a run: com (n, nb, 3), rotation (n, nb, 3, 3), com velocity, angular velocity."""

    p: np.ndarray
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray


def body_motion(name: str, run: pc.Trajectory) -> BodyMotion:
    model = run.scene.model
    data = model.createData()
    bodies = SPECIFICATIONS[name]["bodies"]
    n, nb = run.t.size, len(bodies)
    p, R, v, w = np.zeros((n, nb, 3)), np.zeros((n, nb, 3, 3)), np.zeros((n, nb, 3)), np.zeros((n, nb, 3))
    for i in range(n):
        pin.forwardKinematics(model, data, run.q[i], run.v[i])
        for b, body in enumerate(bodies):
            joint = model.frames[model.getFrameId(body["name"])].parentJoint
            pose = data.oMi[joint]
            velocity = pin.getVelocity(model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            arm = pose.rotation @ np.array(body.get("com", (0.0, 0.0, 0.0)))
            p[i, b], R[i, b] = pose.translation + arm, pose.rotation
            v[i, b], w[i, b] = velocity.linear + np.cross(velocity.angular, arm), velocity.angular
    return BodyMotion(p, R, v, w)


def farthest(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest distance between vectors (..., 3); NaN counts as infinitely far."""
    distance = np.linalg.norm(found - expected, axis=-1)
    return float(np.where(np.isnan(distance), np.inf, distance).max(initial=0.0))


def largest_angle(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest angle between rotations (..., 3, 3), from the chord |A - B|_F = 2 sqrt(2) sin(angle / 2)."""
    chord = np.linalg.norm(found - expected, axis=(-2, -1)) / (2.0 * math.sqrt(2.0))
    return float(2.0 * np.arcsin(np.clip(chord, 0.0, 1.0)).max())


def path_extent(positions: np.ndarray) -> float:
    """Largest extent in m of the space that all bodies' paths fill, at least a millimetre."""
    return max(float(np.ptp(positions.reshape(-1, 3), axis=0).max()), 1e-3)
