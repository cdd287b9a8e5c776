"""Linearised motion against closed forms: the benchmark bicycle, disks, pendulums, and against perturbed runs."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import expm
from shared import one_body

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf"
G = 9.81


def model_of(name):
    return pc.Scene.from_urdf(URDF / f"{name}.urdf", floating_base=True)


# ---------------------------------------------------------------------------------------------------- bicycle

# Table 1 of Meijaard, Papadopoulos, Ruina, Schwab (2007): x forward, z down.
WHEEL_BASE, TRAIL, TILT = 1.02, 0.08, math.pi / 10.0
REAR = {"r": 0.3, "m": 2.0, "xx": 0.0603, "yy": 0.12}
BODY = {"x": 0.3, "z": -0.9, "m": 85.0, "xx": 9.2, "xz": 2.4, "zz": 2.8}
FORK = {"x": 0.9, "z": -0.7, "m": 4.0, "xx": 0.05892, "xz": -0.00756, "zz": 0.00708}
FRONT = {"r": 0.35, "m": 3.0, "xx": 0.1405, "yy": 0.28}


def bicycle_matrices():
    """M, C1, K0, K2 of M q'' + v C1 q' + (g K0 + v^2 K2) q = f in lean and steer, by the paper's Appendix A."""
    w, c, s, k = WHEEL_BASE, TRAIL, math.sin(TILT), math.cos(TILT)
    total = REAR["m"] + BODY["m"] + FORK["m"] + FRONT["m"]
    x_t = (BODY["x"] * BODY["m"] + FORK["x"] * FORK["m"] + w * FRONT["m"]) / total
    z_t = (-REAR["r"] * REAR["m"] + BODY["z"] * BODY["m"] + FORK["z"] * FORK["m"] - FRONT["r"] * FRONT["m"]) / total
    parts = (REAR, BODY, FORK, FRONT)
    t_xx = sum(p["xx"] for p in parts) + REAR["m"] * REAR["r"] ** 2 + FRONT["m"] * FRONT["r"] ** 2
    t_xx += BODY["m"] * BODY["z"] ** 2 + FORK["m"] * FORK["z"] ** 2
    t_xz = BODY["xz"] + FORK["xz"] + FRONT["m"] * w * FRONT["r"]
    t_xz -= BODY["m"] * BODY["x"] * BODY["z"] + FORK["m"] * FORK["x"] * FORK["z"]
    t_zz = REAR["xx"] + BODY["zz"] + FORK["zz"] + FRONT["xx"]
    t_zz += BODY["m"] * BODY["x"] ** 2 + FORK["m"] * FORK["x"] ** 2 + FRONT["m"] * w**2
    # the front assembly
    m_a = FORK["m"] + FRONT["m"]
    x_a = (FORK["x"] * FORK["m"] + w * FRONT["m"]) / m_a
    z_a = (FORK["z"] * FORK["m"] - FRONT["r"] * FRONT["m"]) / m_a
    up, ahead = (FORK["z"] - z_a, -FRONT["r"] - z_a), (FORK["x"] - x_a, w - x_a)
    a_xx = FORK["xx"] + FRONT["xx"] + FORK["m"] * up[0] ** 2 + FRONT["m"] * up[1] ** 2
    a_xz = FORK["xz"] - FORK["m"] * ahead[0] * up[0] - FRONT["m"] * ahead[1] * up[1]
    a_zz = FORK["zz"] + FRONT["xx"] + FORK["m"] * ahead[0] ** 2 + FRONT["m"] * ahead[1] ** 2
    u_a = (x_a - w - c) * k - z_a * s
    a_ll = m_a * u_a**2 + a_xx * s * s + 2.0 * a_xz * s * k + a_zz * k * k
    a_lx = -m_a * u_a * z_a + a_xx * s + a_xz * k
    a_lz = m_a * u_a * x_a + a_xz * s + a_zz * k
    mu = c / w * k
    s_r, s_f = REAR["yy"] / REAR["r"], FRONT["yy"] / FRONT["r"]
    s_t, s_a = s_r + s_f, m_a * u_a + mu * total * x_t
    mass = np.array([[t_xx, a_lx + mu * t_xz], [a_lx + mu * t_xz, a_ll + 2.0 * mu * a_lz + mu * mu * t_zz]])
    k0 = np.array([[total * z_t, -s_a], [-s_a, -s_a * s]])
    k2 = np.array([[0.0, (s_t - total * z_t) / w * k], [0.0, (s_a + s_f * s) / w * k]])
    c1 = np.array(
        [
            [0.0, mu * s_t + s_f * k + t_xz / w * k - mu * total * z_t],
            [-(mu * s_t + s_f * k), a_lz / w * k + mu * (s_a + t_zz / w * k)],
        ]
    )
    return mass, c1, k0, k2


def bicycle():
    scene = model_of("bicycle")
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    floor = scene.add_contour("floor", pc.Plane())
    for name, wheel in (("rear", REAR), ("front", FRONT)):
        rim = scene.add_contour(name, pc.Circle(wheel["r"]), f"{name}_wheel", upright)
        scene.add_contact(name, rim, floor, friction=pc.NoSlip())
    return scene


def straight(scene, speed):
    model = scene.model
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[2], v[0] = REAR["r"], speed
    for name, wheel in (("rear", REAR), ("front", FRONT)):
        v[model.joints[model.getJointId(f"{name}_axle")].idx_v] = speed / wheel["r"]
    return scene.initial_state(q, v)


def test_published_matrices_of_the_bicycle():
    """The independent check is itself checked, against digits printed in the paper."""
    mass, c1, k0, k2 = bicycle_matrices()
    printed = {
        "M": (mass, [[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]]),
        "C1": (c1, [[0.0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]]),
        "K0": (k0, [[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]]),
        "K2": (k2, [[0.0, 76.59734589573222], [0.0, 2.65431523794604]]),
    }
    for name, (found, expected) in printed.items():
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13 * 100.0, err_msg=name)


@pytest.mark.parametrize("speed", [0.0, 1.0, 3.0, 4.29238253634111, 5.0, 6.02426201538837, 8.0, 10.0])
def test_benchmark_bicycle(speed):
    """State and input matrix in lean and steer, and the eigenvalues. Differences reach 1e-11; 1e-9 shows any term."""
    scene = bicycle()
    full = pc.linearize(scene, straight(scene, speed), coordinates=("root_joint.wx", "steer"))
    assert full.error < 1e-9
    assert full.A.shape == (10, 10)
    assert full.positions == 7
    found = full.without_symmetries()
    lean, steer, speed_of_spin = (found.names.index(f"v:{n}") for n in ("root_joint.wx", "steer", "rear_axle"))
    order = [found.names.index("q:root_joint.wx"), found.names.index("q:steer"), lean, steer, speed_of_spin]
    matrix = found.A[np.ix_(order, order)]
    mass, c1, k0, k2 = bicycle_matrices()
    # the paper's steer is positive to the right, the joint's to the left
    flip = np.diag([1.0, -1.0])
    stiffness = flip @ np.linalg.solve(mass, G * k0 + speed**2 * k2) @ flip
    damping = flip @ np.linalg.solve(mass, speed * c1) @ flip
    expected = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]])
    np.testing.assert_allclose(matrix[:4, :4], expected, rtol=0.0, atol=1e-9)
    # to first order the speed neither feels lean and steer nor is felt by them
    np.testing.assert_allclose(matrix[4], 0.0, atol=1e-9)
    np.testing.assert_allclose(matrix[:, 4], 0.0, atol=1e-9)
    axis = scene.model.joints[scene.model.getJointId("steer")].idx_v
    np.testing.assert_allclose(
        found.B[order[2:4], axis], flip @ np.linalg.solve(mass, flip @ [0.0, 1.0]), rtol=0.0, atol=1e-9
    )
    values = found.eigenvalues
    # the speed's own is zero
    values = np.delete(values, np.argmin(np.abs(values)))
    exact = np.linalg.eigvals(expected)
    apart = np.abs(values[:, None] - exact[None, :])
    assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-9


# ---------------------------------------------------------------------------------------------------- disks


def disk():
    scene = model_of("disk")
    rim, floor = scene.add_contour("rim", pc.Circle(0.3), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", rim, floor, friction=pc.NoSlip())
    return scene


MASS, RADIUS, J1, J3 = 2.0, 0.3, 0.045, 0.09


def circling(tilt, spin, precession):
    """(q, v) of the disk, its axis at an angle from the vertical, rolling; spin about the axis is absolute."""
    q = np.r_[0.0, 0.0, RADIUS * math.sin(tilt), pin.Quaternion(pin.utils.rotate("y", tilt)).coeffs()]
    omega = np.array([-precession * math.sin(tilt), 0.0, spin])
    return q, np.r_[-np.cross(omega, [RADIUS, 0.0, 0.0]), omega]


def steady_spin(tilt, precession):
    """(J3 + m R^2) Omega omega3 = J1 Omega^2 cos(tilt) - m g R cot(tilt)."""
    loads = J1 * precession**2 * math.cos(tilt) - MASS * G * RADIUS / math.tan(tilt)
    return loads / ((J3 + MASS * RADIUS**2) * precession)


@pytest.mark.parametrize("spin", [3.0, 6.0, 12.0])
def test_upright_disk(spin):
    """(J1 + m R^2) J1 lambda^2 = m g R J1 - J3 (J3 + m R^2) spin^2."""
    scene = disk()
    state = scene.initial_state(*circling(0.5 * math.pi, spin, 0.0))
    found = pc.linearize(scene, state).without_symmetries()
    whole = MASS * RADIUS**2
    square = (MASS * G * RADIUS * J1 - J3 * (J3 + whole) * spin**2) / ((J1 + whole) * J1)
    root = np.sqrt(complex(square))
    values = found.eigenvalues
    # heading and spin rate are free: two zeros
    assert sorted(np.abs(values))[1] < 1e-9
    for value in (root, -root):
        assert np.abs(values - value).min() < 1e-9


@pytest.mark.parametrize("mass", [1e-6, 2.0])
@pytest.mark.parametrize("radius", [1e-3, 1e3])
def test_upright_disk_of_any_size(radius, mass):
    """The same formula from a millimetre to a kilometre; relative, as steps of differences go with the size."""
    thin, axial = 0.25 * mass * radius**2, 0.5 * mass * radius**2
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(mass, np.zeros(3), np.diag([thin, thin, axial])), "disk")
    scene = pc.Scene(model)
    rim, floor = scene.add_contour("rim", pc.Circle(radius), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", rim, floor, friction=pc.NoSlip())
    spin = 2.0 * math.sqrt(G / radius)
    rotation = pin.utils.rotate("x", 0.5 * math.pi)
    q = np.r_[0.0, 0.0, radius, pin.Quaternion(rotation).coeffs()]
    v = np.r_[rotation.T @ [spin * radius, 0.0, 0.0], rotation.T @ [0.0, spin, 0.0]]
    found = pc.linearize(scene, scene.initial_state(q, v)).without_symmetries()
    whole = mass * radius**2
    square = (mass * G * radius * thin - axial * (axial + whole) * spin**2) / ((thin + whole) * thin)
    frequency = math.sqrt(-square)
    assert np.abs(found.eigenvalues - 1j * frequency).min() < 1e-10 * frequency


def test_circling_disk_and_its_perturbed_run():
    """A = constant in axes that turn with the disk and its own spin; the linear motion is the perturbed one's limit."""
    scene = disk()
    tilt, precession = 1.2, 1.3
    q, v = circling(tilt, steady_spin(tilt, precession), precession)
    state = scene.initial_state(q, v)
    assert max(state.correction.dq, state.correction.dv) < 1e-12
    found = pc.linearize(scene, state)
    assert found.defect < 1e-9
    assert found.error < 1e-8
    essential = found.without_symmetries()
    assert essential.A.shape == (4, 4)
    x = np.zeros(4)
    x[0] = 1e-5
    duration = 0.7
    apart = []
    for sign in (1.0, -1.0):
        start = scene.initial_state(
            pin.integrate(scene.model, q, sign * essential.dq_dx @ x), v + sign * essential.dv_dx @ x
        )
        run = pc.simulate(scene, start, duration, rtol=1e-12, atol=1e-14)
        rotation = pin.Quaternion(run.q[-1, 3:]).matrix()
        apart.append([math.acos(rotation[2, 2]), run.v[-1, 5], np.hypot(*(rotation @ run.v[-1, 3:])[:2])])
    change = 0.5 * (np.array(apart[0]) - np.array(apart[1]))
    y = expm(essential.A * duration) @ x
    dq, dv = essential.dq_dx @ y, essential.dv_dx @ y
    # the same three quantities at the state: tilt = angle about body y, spin, horizontal part of the angular velocity
    rotation, omega = pin.Quaternion(q[3:]).matrix(), v[3:]
    level = (rotation @ omega)[:2]
    turned = rotation @ (np.cross(dq[3:], omega) + dv[3:])
    expected = np.array([dq[4], dv[5], level @ turned[:2] / np.linalg.norm(level)])
    # central difference of the nonlinear motion: third order in 1e-5
    np.testing.assert_allclose(change, expected, rtol=0.0, atol=1e-11)
    assert np.abs(expected).max() > 1e-6


def test_falling_disk_is_not_steady():
    scene = disk()
    q, v = circling(1.0, 5.0, 0.1)
    with pytest.raises(pc.StateError, match=r"not steady.*off by"):
        pc.linearize(scene, scene.initial_state(q, v))


# ---------------------------------------------------------------------------------------------------- beads and balls


def hoop(rate=None):
    scene = model_of("bead")
    motion = None if rate is None else pc.ConstantTwist(angular=(0.0, rate, 0.0))
    bead = scene.add_contour("bead", pc.Point(), "bead")
    ring = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    wire = scene.add_contour("hoop", pc.Circle(0.4), placement=ring, motion=motion)
    scene.add_contact("c", bead, wire)
    return scene


def test_bead_in_a_hoop():
    """The pendulum, stable below and unstable above."""
    scene = hoop()
    for height, sign in ((-0.4, -1.0), (0.4, 1.0)):
        found = pc.linearize(scene, scene.initial_state([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0])).without_symmetries()
        squares = found.eigenvalues**2
        assert np.abs(squares - sign * G / 0.4).min() < 1e-9


def test_bead_in_a_rotating_hoop():
    """A drive that turns: time is part of the symmetry. Equilibrium at cos = g / (R W^2), frequency W sin."""
    rate = 8.0
    scene = hoop(rate)
    angle = math.acos(G / (0.4 * rate**2))
    start = np.array([0.4 * math.sin(angle + 0.05), 0.0, -0.4 * math.cos(angle + 0.05), 0.0, 0.0, 0.0, 1.0])
    steady = pc.find_steady_motion(scene, start, [0.0, 0.4 * math.sin(angle) * rate, 0.0, 0.0, 0.0, 0.0])
    assert steady.state.q[2] == pytest.approx(-0.4 * math.cos(angle), abs=1e-10)
    values = pc.linearize(scene, steady.state).without_symmetries().eigenvalues
    assert np.abs(values - 1j * rate * math.sin(angle)).min() < 1e-8


def test_heaving_drive_is_not_steady():
    scene = model_of("ball")
    ball = scene.add_contour("ball", pc.Sphere(0.1), "ball")
    plate = scene.add_contour("plate", pc.Plane(), motion=pc.HarmonicMotion((0.0, 0.0, 0.01), frequency=1.0))
    scene.add_contact("c", ball, plate)
    with pytest.raises(pc.StateError, match="drive"):
        pc.linearize(scene, scene.initial_state([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]))


def test_ball_in_an_ellipsoidal_bowl():
    """Two frequencies at the lowest point, sqrt(5 g / (7 (R_i - r))) with the bowl's radii of curvature R_i."""
    scene = model_of("ball")
    ball = scene.add_contour("ball", pc.Sphere(0.1), "ball")
    a, b, c = 1.2, 0.9, 0.7
    bowl = scene.add_contour("bowl", pc.Ellipsoid(a, b, c), placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, c])))
    scene.add_contact("c", ball, bowl, friction=pc.Coulomb(0.5), side=-1)
    rest = pc.find_equilibrium(scene, [0.02, -0.03, 0.101, 0.0, 0.0, 0.0, 1.0])
    values = pc.linearize(scene, rest.state).without_symmetries().eigenvalues
    for curvature in (a * a / c, b * b / c):
        assert np.abs(values - 1j * math.sqrt(5.0 * G / (7.0 * (curvature - 0.1)))).min() < 1e-8


@pytest.mark.parametrize(("friction", "share"), [(pc.NoSlip(), 1.5), (None, 1.0)])
def test_disk_in_a_circular_bowl(friction, share):
    """A planar mechanism, pattern 2C-2C: frequency^2 = g / ((R - r) (1 + I / m r^2)), I = 0 if it slides."""
    radius, bowl, mass = 0.2, 1.0, 0.7
    inertia = np.diag([1.0, 1.0, 0.5 * mass * radius**2])
    model = one_body(pin.JointModelPlanar(), pin.Inertia(mass, np.zeros(3), inertia), "disk")
    model.gravity.linear = np.array([0.0, -G, 0.0])
    scene = pc.Scene(model)
    rim = scene.add_contour("rim", pc.Circle(radius), "disk")
    wall = scene.add_contour("wall", pc.Circle(bowl))
    scene.add_contact("c", rim, wall, friction=friction)
    assert scene.contacts["c"].pattern.name == "2C-2C"
    angle = 0.3
    start = [(bowl - radius) * math.sin(angle), -(bowl - radius) * math.cos(angle), 1.0, 0.0]
    rest = pc.find_equilibrium(scene, start)
    np.testing.assert_allclose(rest.state.q[:2], [0.0, -(bowl - radius)], rtol=0.0, atol=1e-10)
    values = pc.linearize(scene, rest.state).without_symmetries().eigenvalues
    assert np.abs(values - 1j * math.sqrt(G / ((bowl - radius) * share))).min() < 1e-9


def test_sliding_with_friction():
    """A point mass slides at a speed s down a slope of tan = mu: along it nothing changes, across it friction, which
    keeps its size, damps at mu g cos / s by its direction."""
    mu, speed = 0.3, 0.8
    slope = math.atan(mu)
    scene = model_of("bead")
    bead = scene.add_contour("bead", pc.Point(), "bead")
    tilted = pin.SE3(pin.utils.rotate("y", slope), np.zeros(3))
    plane = scene.add_contour("plane", pc.Plane(), placement=tilted)
    scene.add_contact("c", bead, plane, friction=pc.Coulomb(mu))
    downhill = tilted.rotation @ [1.0, 0.0, 0.0]
    state = scene.initial_state(np.r_[np.zeros(3), 0.0, 0.0, 0.0, 1.0], np.r_[speed * downhill, np.zeros(3)])
    found = pc.linearize(scene, state, coordinates=("root_joint.vy",))
    assert found.A.shape == (10, 10)
    across = found.names.index("v:root_joint.vy")
    assert found.A[across, across] == pytest.approx(-mu * G * math.cos(slope) / speed, rel=1e-9)
    values = found.without_symmetries().eigenvalues
    assert np.abs(values + mu * G * math.cos(slope) / speed).min() < 1e-8


def test_robot_without_contacts():
    """An arm held up by torques: Pinocchio's own derivatives, which are exact."""
    model = pin.buildSampleModelManipulator()
    data, rest = model.createData(), np.zeros(model.nv)
    q = pin.integrate(model, pin.neutral(model), np.random.default_rng(0).normal(size=model.nv))
    tau = pin.rnea(model, data, q, rest, rest)
    scene = pc.Scene(model)
    found = pc.linearize(scene, scene.initial_state(q), tau)
    pin.computeABADerivatives(model, data, q, rest, tau)
    inverse_mass = np.triu(data.Minv) + np.triu(data.Minv, 1).T
    n = model.nv
    np.testing.assert_allclose(found.A[:n], np.hstack([np.zeros((n, n)), np.eye(n)]), atol=1e-13)
    np.testing.assert_allclose(found.A[n:, :n], data.ddq_dq, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(found.A[n:, n:], data.ddq_dv, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(found.B[n:], inverse_mass, rtol=0.0, atol=1e-11)


# ---------------------------------------------------------------------------------------------------- arguments


def test_reduced_coordinates_describe_all_deviations():
    scene = disk()
    tilt, precession = 1.1, 1.5
    found = pc.linearize(scene, scene.initial_state(*circling(tilt, steady_spin(tilt, precession), precession)))
    x = np.random.default_rng(4).normal(size=found.A.shape[0])
    np.testing.assert_allclose(found.reduce(found.dq_dx @ x, found.dv_dx @ x), x, rtol=1e-13)
    # symmetries are invariant: position and heading turn into each other only
    orbit = found.symmetries
    image = found.A @ orbit
    left = image - orbit @ np.linalg.lstsq(orbit, image, rcond=1e-9)[0]
    assert np.abs(left).max() < 1e-8


def test_bad_arguments():
    scene, other = disk(), disk()
    state = scene.initial_state(*circling(0.5 * math.pi, 5.0, 0.0))
    with pytest.raises(pc.ArgumentError, match=r"unknown coordinate 'lean'.*root_joint\.wx"):
        pc.linearize(scene, state, coordinates=["lean"])
    with pytest.raises(pc.ArgumentError, match="coordinate 6 is not one of the 6"):
        pc.linearize(scene, state, coordinates=[6])
    with pytest.raises(pc.ArgumentError, match="another scene"):
        pc.linearize(other, state)
    with pytest.raises(pc.StateError, match="tau must have 6 entries, got 2"):
        pc.linearize(scene, state, [0.0, 1.0])
    with pytest.raises(pc.SingularContactError):
        flat = dataclasses.replace(state, q=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
        pc.linearize(scene, flat)


def test_contact_that_begins_to_slip():
    """A ball pushed at its centre along a plane, beyond what friction holds, from rest."""
    scene = model_of("ball")
    ball, floor = scene.add_contour("ball", pc.Sphere(0.1), "ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", ball, floor, friction=pc.Coulomb(0.05))
    state = scene.initial_state([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])
    with pytest.raises(pc.StateError, match="'c' begins to slip"):
        pc.linearize(scene, state, [5.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_nothing_is_left_of_a_rest_that_symmetries_explain():
    """A block that sticks on four corners: every deviation is another place on the floor."""
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), "block"))
    floor = scene.add_contour("floor", pc.Plane())
    for i, (x, y) in enumerate([(0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1)]):
        foot = scene.add_contour(f"foot {i}", pc.Point(), "block", pin.SE3(np.eye(3), np.array([x, y, -0.1])))
        scene.add_contact(f"c{i}", foot, floor, friction=pc.Coulomb(0.5))
    found = pc.linearize(scene, scene.initial_state([0, 0, 0.1, 0, 0, 0, 1]))
    rest = found.without_symmetries()
    assert rest.A.shape == (0, 0)


def mass_on(joints, placement):
    """A point of 0.5 kg, "p", carried by these joints one after the other."""
    model, parent = pin.Model(), 0
    for i, joint in enumerate(joints):
        parent = model.addJoint(parent, joint, placement if i == 0 else pin.SE3.Identity(), f"{i}")
    model.appendBodyToJoint(parent, pin.Inertia(0.5, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("p", parent, pin.SE3.Identity(), 0)
    return model


SLIDES = {
    "translation": [pin.JointModelTranslation()],
    "one after the other": [pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ()],
    "oblique": [
        pin.JointModelPrismaticUnaligned(np.array(axis) / np.linalg.norm(axis))
        for axis in ([1.0, 0.3, 0.0], [0.2, 1.0, 0.5], [-0.4, 0.1, 1.0])
    ],
}


@pytest.mark.parametrize("joints", SLIDES.values(), ids=SLIDES)
def test_conical_pendulum_on_joints_that_slide(joints):
    """Omega^2 = g / (R cos angle), and swings of Omega sqrt(1 + 3 cos^2 angle) about that; 1e-9 for the differences."""
    angle, turned = 0.7, pin.SE3(pin.exp3(np.array([0.4, -0.8, 1.1])), np.array([0.3, -0.2, 0.5]))
    scene = pc.Scene(mass_on(joints, turned))
    point, bowl = scene.add_contour("p", pc.Point(), "p"), scene.add_contour("bowl", pc.Sphere(1.0))
    scene.add_contact("c", point, bowl, side=-1)
    rate = math.sqrt(9.81 / math.cos(angle))
    model, data = scene.model, scene.model.createData()
    axes = pin.computeFrameJacobian(model, data, pin.neutral(model), model.getFrameId("p"), pin.LOCAL_WORLD_ALIGNED)[:3]
    place, velocity = np.array([math.sin(angle), 0.0, -math.cos(angle)]), np.array([0.0, rate * math.sin(angle), 0.0])
    q, v = np.linalg.solve(axes, place - turned.translation), np.linalg.solve(axes, velocity)
    found = pc.find_steady_motion(scene, q, v)
    np.testing.assert_allclose(found.state.q, q, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.state.v, v, rtol=0.0, atol=1e-9)
    values = pc.linearize(scene, found.state).without_symmetries().eigenvalues
    swing = rate * math.sqrt(1.0 + 3.0 * math.cos(angle) ** 2)
    np.testing.assert_allclose(np.sort(values.imag), [-swing, 0.0, swing], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("inertia", [0.1, 1e8, math.inf])
def test_bead_on_joints_that_slide_in_a_turning_hoop(inertia):
    """A hoop that is a body on a hinge, or driven (infinite inertia): cos angle = g / (R Omega^2)."""
    radius, rate, mass = 0.4, 7.0, 0.5
    angle = math.acos(9.81 / (radius * rate**2))
    model = mass_on([pin.JointModelTranslation()], pin.SE3.Identity())
    driven = math.isinf(inertia)
    q, v = [radius * math.sin(angle), 0.0, -radius * math.cos(angle)], [0.0, radius * math.sin(angle) * rate, 0.0]
    if not driven:
        hinge = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
        model.appendBodyToJoint(hinge, pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame("hoop", hinge, pin.SE3.Identity(), 0)
        q, v = [*q, 0.0], [*v, rate]
    scene = pc.Scene(model)
    point = scene.add_contour("p", pc.Point(), "p")
    motion = pc.ConstantTwist(angular=[0.0, rate, 0.0]) if driven else None
    upright = pin.SE3(pin.utils.rotate("x", math.pi / 2), np.zeros(3))
    hoop = scene.add_contour("hoop", pc.Circle(radius), "universe" if driven else "hoop", upright, motion=motion)
    scene.add_contact("c", point, hoop, pattern="P-3C")
    for conditions in (None, lambda q, v: [q[2] + radius * math.cos(angle)]):
        found = pc.find_steady_motion(scene, q, v, conditions=conditions)
        np.testing.assert_allclose(found.state.q, q, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(found.state.v, v, rtol=0.0, atol=1e-9)
    values = pc.linearize(scene, found.state).without_symmetries().eigenvalues
    own = mass * radius**2
    back = 4.0 * math.cos(angle) ** 2 * own / (inertia + own * math.sin(angle) ** 2)
    swing = rate * math.sin(angle) * math.sqrt(1.0 + back)
    assert values.imag.max() == pytest.approx(swing, abs=1e-8)
    assert np.abs(values.real).max() < 1e-8
