"""Bodies and scenes that are stressed."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pinocchio as pin

import pincontact as pc

G = 9.81


def free_body(mass: float, inertia: Iterable[float], gravity: float = G) -> pin.Model:
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.diag(list(inertia))), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    return model


def disk(radius=0.5, mass=1.0, friction=None, gravity=G) -> pc.Scene:
    moment = mass * radius**2
    scene = pc.Scene(free_body(mass, (0.25 * moment, 0.25 * moment, 0.5 * moment), gravity))
    rim, floor = scene.add_contour("rim", pc.Circle(radius), "body"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", rim, floor, friction=friction)
    return scene


def leaning(radius: float, lean: float) -> np.ndarray:
    """q of a disk whose axis leans by `lean` from the vertical."""
    return np.array([0.0, 0.0, radius * math.sin(lean), 0.0, math.sin(0.5 * lean), 0.0, math.cos(0.5 * lean)])


def ball(radius=0.2, mass=1.0, friction=None, axes=None) -> pc.Scene:
    """A ball, or an ellipsoid of these axes, on a plane; inertia of a solid one."""
    axes = np.full(3, radius) if axes is None else np.asarray(axes, float)
    moments = 0.2 * mass * (np.sum(axes**2) - axes**2)
    scene = pc.Scene(free_body(mass, moments))
    shape = pc.Sphere(radius) if np.ptp(axes) == 0.0 else pc.Ellipsoid(*axes)
    body, floor = scene.add_contour("ball", shape, "body"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", body, floor, friction=friction)
    return scene


def ball_in_bowl(radius: float, gap: float, friction, direction=None) -> pc.Scene:
    """A ball in a bowl that is wider by gap; the poles of both are off the path.

    direction: from the centres to where they touch, where the search shall not look for it.
    """
    moment = 0.4 * radius**2
    scene = pc.Scene(free_body(1.0, (moment, moment, moment)))
    tilted = pin.SE3(pin.utils.rotate("x", 0.7), np.zeros(3)), pin.SE3(pin.utils.rotate("y", 1.3), np.zeros(3))
    body = scene.add_contour("ball", pc.Sphere(radius), "body", tilted[0])
    bowl = scene.add_contour("bowl", pc.Sphere(radius + gap), placement=tilted[1])
    location = None
    if direction is not None:
        local = [place.rotation.T @ np.asarray(direction) for place in tilted]
        u1, u2 = ((math.atan2(y, x), math.asin(z)) for x, y, z in local)
        location = (u1, u2)
    scene.add_contact("c", body, bowl, friction=friction, side=-1, location=location)
    return scene


def bead_on_hoop(ratio: float) -> tuple[pc.Scene, float]:
    """A bead of 0.2 kg on a hoop of `ratio` times its mass that turns about its vertical diameter; the hoop's moment
    of inertia about it."""
    bead, radius = 0.2, 0.4
    hoop = ratio * bead
    model = pin.Model()
    turning = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hoop")
    moment = 0.5 * hoop * radius**2
    inertia = pin.Inertia(hoop, np.zeros(3), np.diag([moment, 2 * moment, moment]))
    model.appendBodyToJoint(turning, inertia, pin.SE3.Identity())
    model.addBodyFrame("hoop", turning, pin.SE3.Identity(), 0)
    sliding = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "bead")
    model.appendBodyToJoint(sliding, pin.Inertia(bead, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addBodyFrame("bead", sliding, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    point = scene.add_contour("bead", pc.Point(), "bead")
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    scene.add_contact("c", point, scene.add_contour("ring", pc.Circle(radius), "hoop", upright))
    return scene, moment


def crossed_rods(angle: float, slope: float, moment: float) -> pc.Scene:
    """A straight rod on a rail of that slope, which it crosses at an angle."""
    scene = pc.Scene(free_body(1.0, (moment, moment, 0.01)))
    rod = scene.add_contour("rod", pc.Line(), "body", pin.SE3(pin.utils.rotate("z", angle), np.zeros(3)))
    rail = scene.add_contour("rail", pc.Line(), placement=pin.SE3(pin.utils.rotate("y", slope), np.zeros(3)))
    scene.add_contact("c", rod, rail, bilateral=True, location=(0.0, 0.0))
    return scene


def rod_on_ground(mu: float, length: float = 0.5) -> pc.Scene:
    """A rod of half-length `length` in the xy-plane, whose tip slides on the ground: Painleve's."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -G, 0.0])
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root")
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([1.0, 1.0, length**2 / 3.0]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addBodyFrame("rod", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    tip = scene.add_contour("tip", pc.Point(), "rod", pin.SE3(np.eye(3), np.array([-length, 0.0, 0.0])))
    ground = scene.add_contour("ground", pc.Line())
    scene.add_contact("tip/ground", tip, ground, friction=pc.Coulomb(mu), side=-1)
    return scene


def rod_state(scene: pc.Scene, lean: float, speed: float, length: float = 0.5) -> pc.State:
    """The rod's state while its tip slides at `speed` along x and the rod does not turn."""
    c, s = math.cos(lean), math.sin(lean)
    return scene.initial_state([length * c, length * s, c, s], [c * speed, -s * speed, 0.0])


def point_on_ramp(mu: float | None, angle: float, turn: float = 0.0) -> pc.Scene:
    """A point mass of 1 kg on a ramp that goes down along +x; its first tangent is turned from that."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    ramp = pin.SE3(pin.utils.rotate("y", angle) @ pin.utils.rotate("z", turn), np.zeros(3))
    body, floor = scene.add_contour("body", pc.Point(), "body"), scene.add_contour("ramp", pc.Plane(), placement=ramp)
    scene.add_contact("c", body, floor, friction=None if mu is None else pc.Coulomb(mu))
    return scene


def table(feet: int, mu: float | None, angle: float, height: float = 0.2) -> pc.Scene:
    """A round table of 1 kg on `feet` points, on a ramp that goes down along +x."""
    scene = pc.Scene(free_body(1.0, (0.05, 0.05, 0.08)))
    ramp = scene.add_contour("ramp", pc.Plane(), placement=pin.SE3(pin.utils.rotate("y", angle), np.zeros(3)))
    for i in range(feet):
        turn = 2.0 * math.pi * i / feet
        place = pin.SE3(np.eye(3), np.array([0.5 * math.cos(turn), 0.5 * math.sin(turn), -height]))
        foot = scene.add_contour(f"foot {i}", pc.Point(), "body", place)
        scene.add_contact(f"foot {i}", foot, ramp, friction=None if mu is None else pc.Coulomb(mu))
    return scene


def table_state(scene: pc.Scene, angle: float, speed: float = 0.0, height: float = 0.2) -> pc.State:
    rotation = pin.utils.rotate("y", angle)
    q = np.array([*(height * rotation[:, 2]), *pin.Quaternion(rotation).coeffs()])
    return scene.initial_state(q, [speed, 0.0, 0.0, 0.0, 0.0, 0.0])
