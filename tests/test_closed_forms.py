"""Motions known in closed form, over whole runs.

Integrated at rtol = 1e-12 unless said otherwise; bounds of 1e-10 leave the global error of some periods a factor of ten
and show a wrong coefficient in the tenth digit.
"""

import math

import numpy as np
import pinocchio as pin
import pytest
from reference import build
from scipy.special import ellipj, ellipk
from shared import body_scene

import pincontact as pc

G = 9.81
TIGHT = {"rtol": 1e-12, "atol": 1e-14}


def ball_scene(radius, mass, surface, friction, side=None, placement=None, motion=None):
    moment = 0.4 * mass * radius**2
    scene = body_scene(pin.JointModelFreeFlyer(), mass, (moment, moment, moment))
    ball = scene.add_contour("ball", pc.Sphere(radius), "body")
    ground = scene.add_contour("ground", surface, placement=placement, motion=motion)
    scene.add_contact("c", ball, ground, friction=friction, side=side)
    return scene


def bead_scene(contour, friction=None, mass=0.3, side=None, placement=None, bilateral=False, location=None):
    """A point mass on a curve or a surface of the world."""
    scene = body_scene(pin.JointModelTranslation(), mass, (0.0, 0.0, 0.0))
    bead, guide = (
        scene.add_contour("bead", pc.Point(), "body"),
        scene.add_contour("guide", contour, placement=placement),
    )
    guess = None if location is None else (None, location)
    scene.add_contact("c", bead, guide, friction=friction, side=side, bilateral=bilateral, location=guess)
    return scene


def free_ball(position, velocity, omega):
    """(q, v) of a free joint that is not turned: world and body axes agree."""
    return np.array([*position, 0.0, 0.0, 0.0, 1.0]), np.array([*velocity, *omega])


def run(scene, q, v, duration, n=101, **options):
    state = scene.initial_state(q, v)
    # closed forms give consistent states: nothing to correct but rounding
    assert state.correction.dq <= 1e-13
    assert state.correction.dv <= 1e-12
    times = np.linspace(0.0, duration, n)
    # steps of time stepping have no tolerances
    tolerances = {} if options.get("method") == "Moreau" else TIGHT
    result = pc.simulate(scene, state, duration, t_eval=times, **(tolerances | options))
    assert result.status == 0, result.message
    return result


def pendulum(amplitude, omega0, t):
    """theta(t) of theta'' = -omega0^2 sin(theta) from rest at the amplitude: sin(theta/2) = k cd(omega0 t, k)."""
    k = math.sin(0.5 * amplitude)
    sn, _, _, _ = ellipj(omega0 * t + ellipk(k * k), k * k)
    return 2.0 * np.arcsin(k * sn)


# ---------------------------------------------------------------------------------------------------- rolling disks


def test_steady_circular_rolling():
    """A disk leaning at a constant angle theta rolls along a circle with precession Omega if (J3 + m R^2) Omega omega3
    = J1 Omega^2 cos(theta) - m g R cot(theta)."""
    scene, state = build("disk_plane_steady_circle", native=True)
    mass, radius, theta, precession = 1.0, 0.5, 1.1, 2.0
    j1, j3 = 0.25 * mass * radius**2, 0.5 * mass * radius**2
    spin = (j1 * precession**2 * math.cos(theta) - mass * G * radius / math.tan(theta)) / (
        (j3 + mass * radius**2) * precession
    )
    times = np.linspace(0.0, 10.0, 101)
    result = pc.simulate(scene, state, 10.0, t_eval=times, **TIGHT)
    orbit = radius * spin / precession
    angle = precession * times
    position = np.column_stack(
        [orbit * (1.0 - np.cos(angle)), -orbit * np.sin(angle), np.full_like(times, radius * math.sin(theta))]
    )
    assert np.abs(result.q[:, :3] - position).max() <= 1e-10
    for q, t in zip(result.q, times):
        turns = pin.utils.rotate("z", precession * t) @ pin.utils.rotate("y", theta)
        rotation = turns @ pin.utils.rotate("z", (spin - precession * math.cos(theta)) * t)
        assert np.abs(pin.Quaternion(q[3:]).matrix() - rotation).max() <= 1e-10
    # the force on the plane: weight, and what bends the centre's path
    force = result.contacts["0"].force
    np.testing.assert_allclose(force[:, 2], -mass * G, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(
        np.hypot(force[:, 0], force[:, 1]), mass * abs(radius * spin * precession), rtol=0.0, atol=1e-9
    )


def test_energy_of_long_rolling():
    """1000 s of rolling at rtol = 1e-10: energy kept to 1e-8 (errors of 25 000 steps, not a bias of the projection)."""
    scene, state = build("disk_plane_roll", native=True)
    result = pc.simulate(scene, state, 1000.0, rtol=1e-10, atol=1e-12, t_eval=np.linspace(0.0, 1000.0, 201))
    assert result.status == 0
    energy = result.energies().total
    assert np.abs(energy / energy[0] - 1.0).max() <= 1e-8
    assert max(values.max() for values in result.residuals().values()) <= 1e-12


# ---------------------------------------------------------------------------------------------------- rolling balls


def test_sliding_ball_begins_to_roll():
    """A ball thrown without spin slips until t = 2 v0 / (7 mu g) and rolls on with 5/7 of its speed."""
    radius, mass, mu, v0 = 0.11, 6.0, 0.15, 3.0
    scene = ball_scene(radius, mass, pc.Plane(), pc.Coulomb(mu))
    direction = np.array([math.cos(0.4), math.sin(0.4), 0.0])
    result = run(scene, *free_ball((0.0, 0.0, radius), v0 * direction, np.zeros(3)), 1.2)
    rolls = 2.0 * v0 / (7.0 * mu * G)
    assert [event.kind for event in result.events] == ["stick"]
    assert abs(result.events[0].time - rolls) <= 1e-10
    t = np.minimum(result.t, rolls)
    path = v0 * t - 0.5 * mu * G * t**2 + 5.0 / 7.0 * v0 * (result.t - t)
    assert np.abs(result.q[:, :3] - path[:, None] * direction - [0.0, 0.0, radius]).max() <= 1e-10


def test_ball_in_spherical_bowl():
    """A ball rolls in a bowl, in a vertical plane, as a pendulum of length (R - r) 7/5."""
    radius, bowl = 0.2, 1.0
    length, amplitude = bowl - radius, 1.2
    scene = ball_scene(radius, 0.5, pc.Sphere(bowl), pc.NoSlip(), side=-1)
    start = (length * math.sin(amplitude), 0.0, -length * math.cos(amplitude))
    result = run(scene, *free_ball(start, np.zeros(3), np.zeros(3)), 4.0)
    theta = pendulum(amplitude, math.sqrt(5.0 * G / (7.0 * length)), result.t)
    expected = length * np.column_stack([np.sin(theta), np.zeros_like(theta), -np.cos(theta)])
    assert np.abs(result.q[:, :3] - expected).max() <= 1e-9


def test_ball_in_vertical_cylinder():
    """It does not fall: it bobs at sqrt(2/7) of the rate at which it goes round."""
    radius, cylinder, mass, around, omega_r = 0.05, 0.5, 0.2, 6.0, 8.0
    orbit = cylinder - radius
    scene = ball_scene(radius, mass, pc.Cylinder(cylinder), pc.NoSlip(), side=-1)
    omega = (omega_r, 0.0, -orbit * around / radius)
    result = run(scene, *free_ball((orbit, 0.0, 0.3), (0.0, orbit * around, 0.0), omega), 5.0)
    bobbing = math.sqrt(2.0 / 7.0) * around
    drop = (5.0 / 7.0 * G + 2.0 / 7.0 * radius * around * omega_r) / bobbing**2
    height = 0.3 - drop * (1.0 - np.cos(bobbing * result.t))
    angle = around * result.t
    expected = np.column_stack([orbit * np.cos(angle), orbit * np.sin(angle), height])
    assert np.abs(result.q[:, :3] - expected).max() <= 1e-9


def test_ball_on_turntable():
    """Its centre goes round a circle at 2/7 of the table's rate, wherever the circle is."""
    radius, turning = 0.1, 3.0
    start, velocity = np.array([0.4, 0.1, radius]), np.array([0.2, 0.3, 0.0])
    table = pc.ConstantTwist(angular=(0.0, 0.0, turning))
    scene = ball_scene(radius, 0.8, pc.Plane(), pc.NoSlip(), motion=table)
    # no slip: velocity - radius omega x z = Omega z x start
    slip = velocity - turning * np.array([-start[1], start[0], 0.0])
    omega = np.array([-slip[1] / radius, slip[0] / radius, 0.7])
    result = run(scene, *free_ball(start, velocity, omega), 6.0)
    rate = 2.0 / 7.0 * turning
    c, s = np.cos(rate * result.t), np.sin(rate * result.t)
    x = start[0] + (s * velocity[0] - (1.0 - c) * velocity[1]) / rate
    y = start[1] + ((1.0 - c) * velocity[0] + s * velocity[1]) / rate
    assert np.abs(result.q[:, :3] - np.column_stack([x, y, np.full_like(x, radius)])).max() <= 1e-9


def test_ball_on_shaken_plate():
    """A plate that moves sideways and up and down: the ball takes 2/7 of the sideways acceleration."""
    radius, mass, frequency, aside, up = 0.1, 0.8, 0.9, 0.12, 0.05
    shaking = 2.0 * math.pi * frequency
    plate = pc.HarmonicMotion(amplitude=(aside, 0.0, up), frequency=frequency)
    scene = ball_scene(radius, mass, pc.Plane(), pc.NoSlip(), motion=plate)
    vx, vy = 0.3, -0.2
    omega = (-vy / radius, (vx - aside * shaking) / radius, 0.0)
    result = run(scene, *free_ball((0.0, 0.0, radius), (vx, vy, up * shaking), omega), 3.0)
    t, sine = result.t, np.sin(shaking * result.t)
    x = (vx - 2.0 / 7.0 * aside * shaking) * t + 2.0 / 7.0 * aside * sine
    assert np.abs(result.q[:, :3] - np.column_stack([x, vy * t, radius + up * sine])).max() <= 1e-9
    track = result.contacts["c"]
    pressing = mass * (G - up * shaking**2 * sine)
    assert pressing.min() > 0.0
    np.testing.assert_allclose(track.normal_force, pressing, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(track.force[:, 0], 2.0 / 7.0 * mass * aside * shaking**2 * sine, rtol=0.0, atol=1e-8)


def test_disk_rolls_in_a_cylinder():
    """Planar rolling in a circular hole: a pendulum of length (R - r) 3/2."""
    radius, hole, mass = 0.15, 0.8, 0.6
    length, amplitude = hole - radius, 1.4
    scene = body_scene(pin.JointModelPlanar(), mass, (1.0, 1.0, 0.5 * mass * radius**2), (0.0, -G, 0.0))
    rim, wall = scene.add_contour("rim", pc.Circle(radius), "body"), scene.add_contour("wall", pc.Circle(hole))
    scene.add_contact("c", rim, wall, friction=pc.NoSlip())
    assert scene.contacts["c"].pattern.name == "2C-2C"
    q = np.array([length * math.sin(amplitude), -length * math.cos(amplitude), 1.0, 0.0])
    result = run(scene, q, np.zeros(3), 4.0)
    theta = pendulum(amplitude, math.sqrt(2.0 * G / (3.0 * length)), result.t)
    expected = length * np.column_stack([np.sin(theta), -np.cos(theta)])
    assert np.abs(result.q[:, :2] - expected).max() <= 1e-9
    turned = -length / radius * (theta - amplitude)
    np.testing.assert_allclose(result.q[:, 2], np.cos(turned), rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(result.q[:, 3], np.sin(turned), rtol=0.0, atol=1e-8)


# ---------------------------------------------------------------------------------------------------- points and beads


def test_bead_slides_down_a_helix():
    """Without friction the angle grows as half the square of time; the wire carries weight and turn."""
    radius, pitch, mass = 0.3, 0.5, 0.3
    climb = pitch / (2.0 * math.pi)
    scene = bead_scene(pc.Helix(radius, pitch), mass=mass)
    result = run(scene, np.array([radius, 0.0, 0.0]), np.zeros(3), 2.0)
    length = math.hypot(radius, climb)
    speeding = -G * climb / length**2
    u = 0.5 * speeding * result.t**2
    expected = np.column_stack([radius * np.cos(u), radius * np.sin(u), climb * u])
    assert np.abs(result.q - expected).max() <= 1e-10
    track = result.contacts["c"]
    np.testing.assert_allclose(track.location[:, 0], u, rtol=0.0, atol=1e-9)
    normal = mass * np.hypot(G * radius / length, radius * (speeding * result.t) ** 2)
    np.testing.assert_allclose(track.normal_force, normal, rtol=1e-10)
    np.testing.assert_allclose(track.tangential_force, 0.0, atol=1e-12)


@pytest.mark.parametrize("amplitude", [0.3, 1.2, 2.4])
def test_cycloid_is_isochronous(amplitude):
    """Arc length on a cycloid is a harmonic oscillator: the same period from every height."""
    radius = 0.25
    scene = bead_scene(pc.Cycloid(radius), placement=pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3)))
    start = np.array([radius * (amplitude + math.sin(amplitude)), 0.0, radius * (1.0 - math.cos(amplitude))])
    result = run(scene, start, np.zeros(3), 4.0)
    arc = 4.0 * radius * math.sin(0.5 * amplitude) * np.cos(math.sqrt(G / (4.0 * radius)) * result.t)
    u = 2.0 * np.arcsin(arc / (4.0 * radius))
    expected = radius * np.column_stack([u + np.sin(u), np.zeros_like(u), 1.0 - np.cos(u)])
    assert np.abs(result.q - expected).max() <= 1e-9


SLOPE = 0.5
TILTED = pin.SE3(pin.utils.rotate("y", SLOPE), np.zeros(3))
DOWNHILL, UPHILL_NORMAL = TILTED.rotation[:, 0], TILTED.rotation[:, 2]


def test_point_slides_down_an_incline():
    """Friction less than the slope: g (sin - mu cos) down the line of fall, from rest."""
    mu = 0.3
    scene = bead_scene(pc.Plane(), pc.Coulomb(mu), placement=TILTED)
    result = run(scene, np.zeros(3), np.zeros(3), 1.5)
    path = 0.5 * G * (math.sin(SLOPE) - mu * math.cos(SLOPE)) * result.t**2
    assert np.abs(result.q - path[:, None] * DOWNHILL).max() <= 1e-10
    assert (result.contacts["c"].mode[1:] == 2).all()


def test_point_comes_to_rest_and_stays():
    """Friction more than the slope: thrown downhill it stops after v0 / (g (mu cos - sin)) and does not creep."""
    mu, v0 = 0.9, 1.3
    scene = bead_scene(pc.Plane(), pc.Coulomb(mu), placement=TILTED)
    braking = G * (mu * math.cos(SLOPE) - math.sin(SLOPE))
    result = run(scene, np.zeros(3), v0 * DOWNHILL, 2.0)
    assert [event.kind for event in result.events] == ["stick"]
    stop = v0 / braking
    assert abs(result.events[0].time - stop) <= 1e-10
    t = np.minimum(result.t, stop)
    assert np.abs(result.q - (v0 * t - 0.5 * braking * t**2)[:, None] * DOWNHILL).max() <= 1e-10
    resting = result.t > stop
    assert np.ptp(result.q[resting], axis=0).max() <= 1e-15
    np.testing.assert_allclose(
        result.contacts["c"].force[resting], np.tile([0.0, 0.0, -0.3 * G], (resting.sum(), 1)), atol=1e-10
    )


@pytest.mark.parametrize(("excess", "slides"), [(1e-6, False), (-1e-6, True)])
def test_incline_at_the_friction_angle(excess, slides):
    """A millionth on either side of tan(slope) decides."""
    mu = math.tan(SLOPE) * (1.0 + excess)
    scene = bead_scene(pc.Plane(), pc.Coulomb(mu), placement=TILTED)
    result = run(scene, np.zeros(3), np.zeros(3), 2.0)
    if slides:
        path = 0.5 * G * (math.sin(SLOPE) - mu * math.cos(SLOPE)) * result.t**2
        assert path[-1] > 1e-6
        assert np.abs(result.q - path[:, None] * DOWNHILL).max() <= 1e-10
    else:
        assert np.abs(result.q).max() <= 1e-15


def block_scene(mu):
    """A block on four feet (redundant: one more normal force than the block has ways to go) on the incline."""
    size = np.array([0.2, 0.15, 0.05])
    scene = body_scene(pin.JointModelFreeFlyer(), 2.0, 2.0 / 3.0 * (np.sum(size**2) - size**2))
    ground = scene.add_contour("ground", pc.Plane(), placement=TILTED)
    for i, (x, y) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        corner = pin.SE3(np.eye(3), size * np.array([x, y, -1]))
        foot = scene.add_contour(f"foot {i}", pc.Point(), "body", corner)
        scene.add_contact(f"foot {i}", foot, ground, friction=pc.Coulomb(mu))
    quaternion = pin.Quaternion(TILTED.rotation).coeffs()
    return scene, np.array([*(size[2] * UPHILL_NORMAL), *quaternion])


@pytest.mark.parametrize(("margin", "options"), [(1.3, {}), (1.1, {"method": "Moreau", "step": 5e-3})])
def test_block_rests_on_an_incline(margin, options):
    """Below the friction angle nothing moves in a minute but by rounding, and the feet together carry the weight. Just
    below it only some of the many distributions of the forces over the feet are within all cones."""
    scene, q = block_scene(margin * math.tan(SLOPE))
    result = run(scene, q, np.zeros(6), 60.0, **options)
    assert result.events == []
    assert np.abs(result.q - q).max() <= 1e-12
    total = sum(track.force for track in result.contacts.values())
    np.testing.assert_allclose(total, np.tile([0.0, 0.0, -2.0 * G], (result.t.size, 1)), rtol=0.0, atol=1e-10)


def test_block_slides_down_an_incline():
    mu = 0.3
    scene, q = block_scene(mu)
    result = run(scene, q, np.zeros(6), 1.0)
    path = 0.5 * G * (math.sin(SLOPE) - mu * math.cos(SLOPE)) * result.t**2
    assert np.abs(result.q[:, :3] - q[:3] - path[:, None] * DOWNHILL).max() <= 1e-10
    # it leans forward: the front feet carry more, in pairs that differ by mu h / (half the length)
    normal = {name: track.normal_force for name, track in result.contacts.items()}
    front, back = normal["foot 0"] + normal["foot 1"], normal["foot 2"] + normal["foot 3"]
    weight = 2.0 * G * math.cos(SLOPE)
    np.testing.assert_allclose(front + back, weight, rtol=1e-10)
    np.testing.assert_allclose(front - back, weight * mu * 0.05 / 0.2, rtol=1e-9)


# ---------------------------------------------------------------------------------------------------- driven


def test_eccentric_cam():
    """A flat-faced follower on an eccentric circle: y = r + e sin(W t), whatever the friction is not."""
    radius, eccentricity, turning, mass = 0.1, 0.03, 5.0, 0.6
    scene = body_scene(pin.JointModelPY(), mass, gravity=(0.0, -G, 0.0))
    face = scene.add_contour("face", pc.Line(), "body")
    cam = scene.add_contour(
        "cam",
        pc.Circle(radius),
        placement=pin.SE3(np.eye(3), np.array([eccentricity, 0.0, 0.0])),
        motion=pc.ConstantTwist(angular=(0.0, 0.0, turning), center=(-eccentricity, 0.0, 0.0)),
    )
    scene.add_contact("c", face, cam)
    result = run(scene, np.array([radius]), np.array([eccentricity * turning]), 3.0)
    lift = eccentricity * np.sin(turning * result.t)
    assert np.abs(result.q[:, 0] - radius - lift).max() <= 1e-13
    track = result.contacts["c"]
    np.testing.assert_allclose(track.normal_force, mass * (G - turning**2 * lift), rtol=1e-10)
    np.testing.assert_allclose(track.location[:, 0], eccentricity * np.cos(turning * result.t), rtol=0.0, atol=1e-12)
