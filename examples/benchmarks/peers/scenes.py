"""The benchmark's scenes: here those of contacts that stay, roll, slide or begin to roll once."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .event_scenes import EVENT_SCENES
from .problem import (
    CENTRE,
    FLOOR,
    NO_SLIP,
    WORLD,
    Body,
    G,
    Problem,
    Shape,
    Touch,
    balanced,
    free,
    marked,
    matrix,
    quaternion,
    rotation,
)


def _disk(name: str, title: str, mu: float, duration: float, start, velocity, omega) -> Problem:
    radius, mass = 0.5, 1.0
    disk = Body("disk", "free", mass, np.diag([0.25, 0.25, 0.5]) * mass * radius**2)
    turn = matrix(np.array(start[3:]))
    q, v = free(start[:3], turn, velocity, omega)
    touch = Touch(Shape("disk", (radius,), "disk"), FLOOR, mu)
    return Problem(name, title, (disk,), (touch,), q, v, duration, (("disk", CENTRE),), "centre of the disk")


def disk_roll() -> Problem:
    """A disk set rolling, leaning and turning."""
    start = (0.0, 0.0, 0.46601954298361314, 0.02822036175522495, 0.5639368173333493, 0.28300577276742545,
             0.7752977555872641)  # fmt: skip
    velocity = (0.8728241492559128, -2.34688285494568, 0.05454167276294253)
    return _disk("disk_roll", "rolling disk", NO_SLIP, 5.0, start, velocity, (0.3, 0.2, 5.0))


def disk_slip_roll() -> Problem:
    """A spinning disk thrown on the floor: it slips for 1.41 s and then rolls."""
    start = (0.0, 0.0, 0.47449230967779304, -0.05841225982838808, 0.5821742236685737, 0.0809612189947759,
             0.8069116817945531)  # fmt: skip
    velocity = (0.3, 0.5, 0.06306447247905378)
    return _disk("disk_slip_roll", "disk, slip then roll", 0.2, 3.0, start, velocity, (0.2, 0.4, -9.0))


def rattleback() -> Problem:
    """A stone that is spun, pitches, stops and turns the other way; its product of inertia does it."""
    inertia = np.array([[2.0e-4, -2.0e-5, 0.0], [-2.0e-5, 1.6e-3, 0.0], [0.0, 0.0, 1.7e-3]])
    stone = Body("stone", "free", 1.0, inertia, com=(0.0, 0.0, -0.01))
    tilt = math.radians(0.5)
    turn = rotation((0.0, 1.0, 0.0), tilt) @ rotation((1.0, 0.0, 0.0), tilt)
    q = np.r_[0.0, 0.0, 0.02, quaternion(turn)]
    v = np.array([0.00106, 0.0792, 0.0, 0.0, 0.0, -5.0])
    touch = Touch(Shape("ellipsoid", (0.2, 0.03, 0.02), "stone"), FLOOR, NO_SLIP, bilateral=True)
    return Problem("rattleback", "rattleback through its reversal", (stone,), (touch,), q, v, 5.0,
                   (("stone", (0.2, 0.0, 0.0)),), "tip of the stone, 0.2 m from its centre")  # fmt: skip


def tippe_top() -> Problem:
    """A ball whose centre of mass is off its centre spins and slides on its way to stand on its head."""
    mass, radius, offset = 0.006, 0.015, 0.003
    ball = Body("ball", "free", mass, np.diag([8e-7, 8e-7, 7e-7]), com=(0.0, 0.0, -offset))
    turn = rotation((1.0, 0.0, 0.0), 0.1)
    q, v = free((0.0, 0.0, radius), turn, (0.0, 0.0, 0.0), (0.0, 0.0, 180.0))
    touch = Touch(Shape("sphere", (radius,), "ball"), FLOOR, 0.3)
    return Problem("tippe_top", "tippe top: sliding sphere", (ball,), (touch,), q, v, 0.5,
                   (("ball", ball.com),), "centre of mass")  # fmt: skip


def ball_in_bowl() -> Problem:
    """A ball rolls to and fro in a bowl: a pendulum of length 7/5 (R - r), whose motion is an elliptic function."""
    radius, bowl, amplitude, mass = 0.2, 1.0, 1.2, 0.5
    length = bowl - radius
    ball = Body("ball", "free", mass, np.eye(3) * 0.4 * mass * radius**2)
    start = (length * math.sin(amplitude), 0.0, -length * math.cos(amplitude))
    q, v = free(start, np.eye(3), np.zeros(3), np.zeros(3))

    def closed_form(times: np.ndarray) -> np.ndarray:
        from scipy.special import ellipj, ellipk

        k = math.sin(0.5 * amplitude)
        sn = ellipj(math.sqrt(5.0 * G / (7.0 * length)) * times + ellipk(k * k), k * k)[0]
        theta = 2.0 * np.arcsin(k * sn)
        return length * np.column_stack([np.sin(theta), np.zeros_like(theta), -np.cos(theta)])[:, None, :]

    touch = Touch(Shape("sphere", (radius,), "ball"), Shape("bowl", (bowl,)), NO_SLIP, side=-1)
    return Problem("ball_in_bowl", "ball in a bowl", (ball,), (touch,), q, v, 4.0,
                   (("ball", CENTRE),), "centre of the ball", closed_form)  # fmt: skip


def bead_on_helix() -> Problem:
    """A bead slides down a helical wire with friction."""
    bead = Body("bead", "translation", 0.2, np.zeros((3, 3)))
    touch = Touch(Shape("point", (), "bead"), Shape("helix", (0.3, 0.2 * math.pi)), 0.1, bilateral=True)
    return Problem("bead_on_helix", "bead on a helix, with friction", (bead,), (touch,), np.array([0.3, 0.0, 0.0]),
                   np.array([0.0, -0.6, -0.2]), 2.0, (("bead", CENTRE),), "bead")  # fmt: skip


def cam() -> Problem:
    """A flat-faced follower on an eccentric circular cam that turns freely: one energy, hence one quadrature."""
    radius, eccentricity, moment, mass, spin = 0.1, 0.03, 0.02, 0.6, 8.0
    bodies = (
        Body("cam", "revolute", 1.0, np.diag([0.02, 0.02, moment])),
        Body("follower", "prismatic", mass, np.eye(3) * 1e-3, axis=(0.0, 1.0, 0.0)),
    )
    q, v = np.array([0.0, radius]), np.array([spin, eccentricity * spin])

    def closed_form(times: np.ndarray) -> np.ndarray:
        # theta'^2 = 2 (E - m g e sin theta) / (J + m e^2 cos^2 theta): dt / dtheta is smooth and periodic, so its
        # Fourier series, and hence t(theta), is exact to rounding
        n = 256
        grid = 2.0 * math.pi * np.arange(n) / n

        def slowness(theta: np.ndarray) -> np.ndarray:
            energy = 0.5 * (moment + mass * eccentricity**2) * spin**2
            heavy = moment + mass * eccentricity**2 * np.cos(theta) ** 2
            return np.sqrt(heavy / (2.0 * (energy - mass * G * eccentricity * np.sin(theta))))

        series = np.fft.rfft(slowness(grid)) / n
        order = np.arange(1, n // 2)
        rates = 2.0 * series[1 : n // 2] / (1j * order)

        def elapsed(theta: np.ndarray) -> np.ndarray:
            waves = np.exp(1j * np.multiply.outer(theta, order)) - 1.0
            return series[0].real * theta + (waves @ rates).real

        theta = times / series[0].real
        for _ in range(8):
            theta = theta - (elapsed(theta) - times) / slowness(theta)
        zero = np.zeros_like(theta)
        edge = eccentricity * np.column_stack([np.cos(theta), np.sin(theta), zero])
        lift = np.column_stack([zero, radius + eccentricity * np.sin(theta), zero])
        return np.stack([edge, lift], axis=1)

    touch = Touch(Shape("line", (), "follower"), Shape("circle", (radius,), "cam", (eccentricity, 0.0, 0.0)), 0.0)
    return Problem("cam", "cam and flat follower", bodies, (touch,), q, v, 3.0,
                   (("cam", (eccentricity, 0.0, 0.0)), ("follower", CENTRE)), "centre of the cam's circle, follower",
                   closed_form, gravity=(0.0, -G, 0.0))  # fmt: skip


def bicycle() -> Problem:
    """The benchmark bicycle (Meijaard et al. 2007), uncontrolled at 4.6 m/s, started with a roll rate of 0.5 rad/s.

    Its tables are given in axes with z down; here z is up and x forward.
    """
    base, trail, tilt, speed, rolling = 1.02, 0.08, math.pi / 10.0, 4.6, 0.5
    rear, front = 0.3, 0.35
    flat = rotation((1.0, 0.0, 0.0), -0.5 * math.pi)  # a wheel's axis is its z; it points to the left
    frame_at, fork_height = np.array([0.3, 0.0, 0.9]), 0.7
    fork_at = np.array([base + trail - fork_height * math.tan(tilt), 0.0, fork_height])

    def tensor(xx: float, yy: float, zz: float, xz: float) -> np.ndarray:
        return np.array([[xx, 0.0, -xz], [0.0, yy, 0.0], [-xz, 0.0, zz]])

    def seen(point: np.ndarray, origin: np.ndarray) -> tuple[float, float, float]:
        x, y, z = np.asarray(point, float) - origin
        return float(x), float(y), float(z)

    bodies = (
        Body("frame", "free", 85.0, tensor(9.2, 11.0, 2.8, 2.4)),
        Body("rear wheel", "revolute", 2.0, np.diag([0.0603, 0.0603, 0.12]), "frame",
             seen(np.array([0.0, 0.0, rear]), frame_at), flat),
        Body("fork", "revolute", 4.0, tensor(0.05892, 0.06, 0.00708, -0.00756), "frame", seen(fork_at, frame_at),
             axis=(-math.sin(tilt), 0.0, math.cos(tilt)), com=seen(np.array([0.9, 0.0, 0.7]), fork_at)),
        Body("front wheel", "revolute", 3.0, np.diag([0.1405, 0.1405, 0.28]), "fork",
             seen(np.array([base, 0.0, front]), fork_at), flat),
    )  # fmt: skip
    velocity = np.array([speed, 0.0, 0.0]) + np.cross([rolling, 0.0, 0.0], frame_at)
    q, v = free(frame_at, np.eye(3), velocity, (rolling, 0.0, 0.0))
    touches = (
        Touch(Shape("disk", (rear,), "rear wheel"), FLOOR, NO_SLIP),
        Touch(Shape("disk", (front,), "front wheel"), FLOOR, NO_SLIP),
    )
    return Problem("bicycle", "bicycle", bodies, touches, np.r_[q, 0.0, 0.0, 0.0],
                   np.r_[v, speed / rear, 0.0, speed / front], 5.0, (("frame", CENTRE),),
                   "centre of mass of frame and rider")  # fmt: skip


def arm_on_dome() -> Problem:
    """A six-axis arm with damped joints lies with its ball tip on a dome and slides down it, with friction."""
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

    def rod(mass: float, length: float) -> np.ndarray:
        across = mass * length**2 / 12.0 + 1e-3
        return np.diag([across, across, 2e-3])

    damping = 8.0
    bodies = (
        Body("shoulder", "revolute", 4.0, rod(4.0, 0.2), WORLD, (0.0, 0.0, 0.3), axis=z, damping=damping),
        Body("upper arm", "revolute", 3.5, rod(3.5, 0.4), "shoulder", (0.0, 0.0, 0.1), axis=y, com=(0.0, 0.0, 0.2),
             damping=damping),
        Body("forearm", "revolute", 2.5, rod(2.5, 0.35), "upper arm", (0.0, 0.0, 0.4), axis=y, com=(0.0, 0.0, 0.17),
             damping=damping),
        Body("wrist 1", "revolute", 1.0, rod(1.0, 0.1), "forearm", (0.0, 0.0, 0.35), axis=z, damping=0.5),
        Body("wrist 2", "revolute", 1.0, rod(1.0, 0.1), "wrist 1", (0.0, 0.0, 0.08), axis=x, damping=0.5),
        Body("hand", "revolute", 0.6, rod(0.6, 0.1), "wrist 2", (0.0, 0.0, 0.08), axis=y, com=(0.0, 0.0, 0.05),
             damping=0.5),
    )  # fmt: skip
    q, v = np.array([0.2, 0.5, 1.3, 0.4, 0.2, 0.6]), np.zeros(6)
    # the dome is put under the tip as the arm stands, off its top so that it slides down
    radius, tip = 1.0, 0.02
    tip_at = (0.0, 0.0, 0.1)
    draft = Problem("", "", bodies, (), q, v, 0.0, (("hand", tip_at),), "")
    reached = marked(draft, q[None])[0, 0]
    away = np.array([0.1, 0.4, 1.0]) / np.linalg.norm([0.1, 0.4, 1.0])
    centre = reached - (radius + tip) * away
    touch = Touch(Shape("sphere", (tip,), "hand", tip_at), Shape("sphere", (radius,), place=tuple(centre)), 0.15)
    return Problem("arm_on_dome", "robot arm sliding on a dome", bodies, (touch,), q, v, 1.0,
                   (("hand", tip_at), ("forearm", CENTRE)), "tip and elbow")  # fmt: skip


def quadruped() -> Problem:
    """A quadruped stands on four sticking point feet while its base sways on joint springs.

    The springs carry the weight at the start, so that nothing jumps; the base is then given a push.
    """
    x, y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    thigh, shank, lean, stiffness = 0.2, 0.2, 0.7, 40.0
    bodies = [Body("base", "free", 12.0, np.diag([0.1, 0.25, 0.3]))]
    touches, angles = [], []
    for name, forward, left in (("fl", 1, 1), ("fr", 1, -1), ("rl", -1, 1), ("rr", -1, -1)):
        hip = (0.2 * forward, 0.08 * left, 0.0)
        spring = {"damping": 0.3, "stiffness": stiffness}
        bodies += [
            Body(f"{name} hip", "revolute", 0.6, np.diag([1e-3, 1e-3, 1e-3]), "base", hip, axis=x, **spring),
            Body(f"{name} thigh", "revolute", 0.9, np.diag([4e-3, 4e-3, 8e-4]), f"{name} hip",
                 (0.0, 0.06 * left, 0.0), axis=y, com=(0.0, 0.0, -0.08), **spring),
            Body(f"{name} shank", "revolute", 0.2, np.diag([8e-4, 8e-4, 5e-5]), f"{name} thigh", (0.0, 0.0, -thigh),
                 axis=y, com=(0.0, 0.0, -0.1), **spring),
        ]  # fmt: skip
        angles += [0.0, lean * forward, -2.0 * lean * forward]
        touches.append(Touch(Shape("point", (), f"{name} shank", (0.0, 0.0, -shank)), FLOOR, 0.8))
    q = np.r_[0.0, 0.0, (thigh + shank) * math.cos(lean), 0.0, 0.0, 0.0, 1.0, angles]
    v = np.r_[0.12, 0.08, 0.0, 0.15, -0.2, 0.25, np.zeros(12)]
    sprung = balanced(tuple(bodies), q, tuple(touches))
    return Problem("quadruped", "standing quadruped, base swaying", sprung, tuple(touches), q, v, 2.0,
                   (("base", CENTRE),), "origin of the base", starts_at_stick=True)  # fmt: skip


SMOOTH_SCENES: dict[str, Callable[[], Problem]] = {
    make.__name__: make
    for make in (
        disk_roll,
        disk_slip_roll,
        rattleback,
        tippe_top,
        ball_in_bowl,
        bead_on_helix,
        cam,
        bicycle,
        arm_on_dome,
        quadruped,
    )
}
SCENES = SMOOTH_SCENES | EVENT_SCENES
