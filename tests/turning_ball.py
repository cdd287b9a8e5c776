"""A solid ball on a plane, for what resists its spinning and rolling."""

import math

import numpy as np
import pinocchio as pin
from shared import one_body

import pincontact as pc

G = 9.81
MASS = 0.4
RADIUS = 0.05


def ball(friction, slope=0.0, bilateral=False, motion=None):
    """A solid ball on a plane; x is downhill."""
    moments = 0.4 * MASS * RADIUS**2 * np.eye(3)
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(MASS, np.zeros(3), moments), "ball")
    model.gravity.linear = G * np.array([math.sin(slope), 0.0, -math.cos(slope)])
    scene = pc.Scene(model)
    surface = scene.add_contour("surface", pc.Sphere(RADIUS), "ball")
    floor = scene.add_contour("floor", pc.Plane(), motion=motion)
    scene.add_contact("c", surface, floor, friction=friction, bilateral=bilateral)
    return scene


def on_the_floor(scene, v=None):
    q = pin.neutral(scene.model)
    q[2] = RADIUS
    return scene.initial_state(q, np.zeros(6) if v is None else np.asarray(v, dtype=float))
