"""A run written down in closed form, for tests of what only reads runs: a wheel rolls along a circle, slipping at
first, and hops once.

The wheel stands upright (radius 0.3 m) and its centre moves along a circle of radius 0.8 m at 0.9 m/s.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pinocchio as pin

import pincontact as pc
from pincontact.trajectory import ContactTrack, Energies

RADIUS, TURN, SPEED, MASS, GRAVITY, MU = 0.3, 0.8, 0.9, 2.0, 9.81, 0.4
SLIP_END, HOP_START, HOP_END, END = 0.6, 2.0, 2.2, 3.0


def wheel_model() -> pin.Model:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    inertia = pin.Inertia(MASS, np.zeros(3), np.diag([0.045, 0.045, 0.09]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("disk", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    return model


def height(t: float) -> float:
    """How far the wheel has left the floor, m."""
    if not HOP_START <= t <= HOP_END:
        return 0.0
    s = t - HOP_START
    return 0.5 * GRAVITY * s * (HOP_END - HOP_START - s)


def placement(t: float) -> pin.SE3:
    """The wheel's placement: its axis level, tangential to the circle, rolled by the path's length."""
    heading = SPEED * t / TURN
    rolled = -SPEED * t / RADIUS
    rotation = pin.rpy.rpyToMatrix(0.0, 0.0, heading + 0.5 * np.pi)
    rotation = rotation @ pin.rpy.rpyToMatrix(0.5 * np.pi, 0.0, 0.0) @ pin.rpy.rpyToMatrix(0.0, 0.0, rolled)
    centre = np.array([TURN * np.cos(heading), TURN * np.sin(heading), RADIUS + height(t)])
    return pin.SE3(rotation, centre)


def velocity(t: float) -> np.ndarray:
    """(6,) body velocity of the wheel, from central differences of its placement (error 1e-9, relative)."""
    h = 1e-5
    return pin.log6(placement(t - h).inverse() * placement(t + h)).vector / (2.0 * h)


def point(t: np.ndarray) -> np.ndarray:
    """(n, 3) contact points on the floor."""
    heading = SPEED * t / TURN
    return np.column_stack([TURN * np.cos(heading), TURN * np.sin(heading), np.zeros_like(t)])


def fake_run(rows: int = 121, name: str = "rim/floor") -> SimpleNamespace:
    """A run as `simulate` returns it, as far as replay and plots read it."""
    t = np.linspace(0.0, END, rows)
    mode = np.where(t < SLIP_END, 2, 1)
    mode = np.where((t >= HOP_START) & (t < HOP_END), -1, mode)
    touching = mode != -1

    heading = SPEED * t / TURN
    ahead = np.column_stack([-np.sin(heading), np.cos(heading), 0.0 * t])
    inwards = np.column_stack([-np.cos(heading), -np.sin(heading), 0.0 * t])
    normal_force = np.where(touching, MASS * GRAVITY, 0.0)
    friction = np.where(mode == 2, MU * MASS * GRAVITY, MASS * SPEED**2 / TURN) * touching
    along = np.where((mode == 2)[:, None], ahead, -inwards)
    force = -normal_force[:, None] * (0.0, 0.0, 1.0) + friction[:, None] * along
    points = point(t)
    points[~touching] = np.nan
    slip = np.where(mode == 2, 1.0 - t / SLIP_END, 0.0)

    scene = pc.Scene(wheel_model())
    rim, floor = scene.add_contour("rim", pc.Circle(RADIUS), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact(name, rim, floor, friction=pc.Coulomb(MU))
    frame = np.tile(np.eye(3), (rows, 1, 1))
    # The lowest point of the rim, in the turning wheel.
    lowest = np.where(touching, SPEED * t / RADIUS - 0.5 * np.pi, np.nan)
    track = ContactTrack(
        location=np.column_stack([lowest, points[:, :2]]),
        location_first=lowest[:, None],
        location_second=points[:, :2],
        rates=np.where(touching, SPEED, np.nan)[:, None] * np.column_stack([np.full(rows, 1.0 / RADIUS), ahead[:, :2]]),
        charts=np.zeros((rows, 2), dtype=np.int64),
        point=points,
        frame=frame,
        dual_frame=frame,
        force=force,
        multipliers=force,
        normal_force=normal_force,
        tangential_force=friction,
        torque=np.zeros((rows, 3)),
        slip_velocity=slip[:, None] * ahead,
        mode=mode,
        gap=np.array([height(x) for x in t]),
        conditioning=np.ones(rows),
    )
    potential = MASS * GRAVITY * (RADIUS + np.array([height(x) for x in t]))
    kinetic = np.full(rows, 0.75 * MASS * SPEED**2)
    work = -0.5 * np.minimum(t, SLIP_END)
    q, v = np.array([pin.SE3ToXYZQUAT(placement(x)) for x in t]), np.array([velocity(x) for x in t])

    discrete = scene.initial_state(q[0], v[0]).discrete

    return SimpleNamespace(
        t=t,
        q=q,
        v=v,
        # Charts, sides and branches are those of the start; enough of them for contacts that a test adds.
        state=lambda row: SimpleNamespace(discrete=np.repeat(discrete, 3, axis=0)),
        status=0,
        message="reached the end",
        events=[
            SimpleNamespace(time=SLIP_END, contact=name, kind="stick", joint=None),
            SimpleNamespace(time=HOP_START, contact=name, kind="separate", joint=None),
            SimpleNamespace(time=HOP_END, contact=name, kind="touch", joint=None),
            SimpleNamespace(time=2.5, contact=None, kind="user", joint=None),
        ],
        scene=scene,
        contacts={name: track},
        energies=lambda: Energies(kinetic, potential, friction_work=work, drive_work=np.zeros(rows)),
        residuals=lambda: {"GC": np.full(rows, 1e-15), "VC": np.full(rows, 3e-16)},
    )
