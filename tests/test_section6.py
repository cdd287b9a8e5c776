"""The paper's worked example (Sec. 6): a thin disk on a rough plane, every printed equation against the package.

Joints along and about the axes of Eq. 36 make Pinocchio's coordinates the paper's q1..q6. Misprints of the paper are
corrected where a comment says so. Angles keep s_q5 > 0, so that cos(beta*) = 1 is the rim's lowest point; 1000 random
states (fewer where one takes milliseconds), compared to 1e-10: rounding of products of a few numbers of order 10 is far
below.
"""

import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc
from pincontact.dynamics.system import System
from pincontact.layout import OK
from pincontact.state import write_discrete

MASS, RADIUS, GRAVITY, MU = 1.7, 0.45, 9.81, 0.3
J1, J3 = 0.25 * MASS * RADIUS**2, 0.5 * MASS * RADIUS**2
STATES = 1000
TOLERANCE = 1e-10


def disk_scene(friction):
    model = pin.Model()
    joint = 0
    for i, part in enumerate(
        (
            pin.JointModelPX(),
            pin.JointModelPY(),
            pin.JointModelPZ(),
            pin.JointModelRZ(),
            pin.JointModelRY(),
            pin.JointModelRZ(),
        )
    ):
        joint = model.addJoint(joint, part, pin.SE3.Identity(), f"q{i + 1}")
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.zeros(3), np.diag([J1, J1, J3])), pin.SE3.Identity())
    model.addBodyFrame("disk", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    rim, floor = scene.add_contour("rim", pc.Circle(RADIUS), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("rim/floor", rim, floor, friction=friction, bilateral=True)
    return scene


def random_state(rng):
    """(q, q') with the geometric constraint and its rate satisfied (Eqs. 51, 61), slipping."""
    q, v = rng.uniform(-2.0, 2.0, 6), rng.uniform(-3.0, 3.0, 6)
    q[3], q[5] = rng.uniform(-math.pi, math.pi, 2)
    q[4] = rng.uniform(0.1, math.pi - 0.1)
    q[2] = RADIUS * math.sin(q[4])
    v[2] = RADIUS * math.cos(q[4]) * v[4]
    return q, v


def rolling(q, v):
    """The same with the velocity constraints (62) satisfied."""
    s4, c4, s5, c5 = sines(q)
    v = v.copy()
    v[0] = RADIUS * (s4 * c5 * v[3] + c4 * s5 * v[4] + s4 * v[5])
    v[1] = -RADIUS * (c4 * c5 * v[3] - s4 * s5 * v[4] + c4 * v[5])
    return v


def sines(q):
    """s4, c4, s5, c5."""
    return math.sin(q[3]), math.cos(q[3]), math.sin(q[4]), math.cos(q[4])


class Evaluation:
    """The package's numbers at any (q, q') of the scene."""

    def __init__(self, friction):
        self.scene = disk_scene(friction)
        q, v = random_state(np.random.default_rng(0))
        state = self.scene.initial_state(q, v)
        self.system = System(self.scene.model, list(self.scene.contacts.values()))
        write_discrete(self.system, state.discrete)

    def __call__(self, q, v):
        self.system.q[:], self.system.v[:] = q, v
        self.system.location[0] = 0.0
        assert self.system.evaluate(0.0) == OK
        return self.system

    @property
    def location(self):
        """xi*, eta_1*, eta_2*."""
        return self.system.location[0, [0, 2, 3]]

    @property
    def rates(self):
        return self.system.rates[0, [0, 2, 3]]

    @property
    def rows(self):
        """Derivatives of the world components of v_c by q', (3, 6): here e_j = m^j = i, j, k (Eq. 41)."""
        return self.system.basis[0].T @ self.system.rows[0]

    @property
    def force(self):
        """F_1, F_2, F_3 on the plane (Eq. 59)."""
        return self.system.basis[0].T @ self.system.force[0]


@pytest.fixture(scope="module")
def frictionless():
    return Evaluation(None)


@pytest.fixture(scope="module")
def stuck():
    return Evaluation(pc.NoSlip())


@pytest.fixture(scope="module")
def states():
    rng = np.random.default_rng(6)
    return [random_state(rng) for _ in range(STATES)]


def assert_equal(found, expected):
    error = np.abs(np.asarray(found) - np.asarray(expected))
    assert error.max() <= TOLERANCE * (1.0 + np.abs(expected).max()), (found, expected)


# ------------------------------------------------------------------------------- Sec. 6.1: the disk and its rim


def test_rotation_and_rim(frictionless, states):
    """Eqs. 36, 38 and 39 (the last z-component is + s5 s_beta, and the denominator is a norm)."""
    model, rng = frictionless.scene.model, np.random.default_rng(1)
    data = model.createData()
    rim = pc.Circle(RADIUS)
    for q, _ in states:
        s4, c4, s5, c5 = sines(q)
        s6, c6 = math.sin(q[5]), math.cos(q[5])
        pin.forwardKinematics(model, data, q)
        pose = data.oMi[6]
        printed = [
            [c4 * c5 * c6 - s4 * s6, -c4 * c5 * s6 - s4 * c6, c4 * s5],
            [s4 * c5 * c6 + c4 * s6, -s4 * c5 * s6 + c4 * c6, s4 * s5],
            [-s5 * c6, s5 * s6, c5],
        ]
        assert_equal(pose.rotation, printed)
        xi = rng.uniform(-math.pi, math.pi)
        sb, cb = math.sin(q[5] + xi), math.cos(q[5] + xi)
        derivatives = rim.evaluate(xi)
        position = q[:3] + RADIUS * np.array([c4 * c5 * cb - s4 * sb, s4 * c5 * cb + c4 * sb, -s5 * cb])
        assert_equal(pose.act(derivatives[0]), position)
        tangent = np.array([-(c4 * c5 * sb + s4 * cb), -s4 * c5 * sb + c4 * cb, s5 * sb])
        assert_equal(pose.rotation @ derivatives[1] / np.linalg.norm(derivatives[1]), tangent)


# ------------------------------------------------------------------------------- Sec. 6.2: conditions and location


def test_contact_conditions(frictionless, states):
    """Eqs. 44, 50 and 51: the location found satisfies all four conditions, on the branch cos(beta*) = 1."""
    for q, v in states:
        frictionless(q, v)
        xi, eta1, eta2 = frictionless.location
        s4, c4, s5, c5 = sines(q)
        sb, cb = math.sin(q[5] + xi), math.cos(q[5] + xi)
        conditions = [
            q[0] + RADIUS * c4 * c5 * cb - eta1,
            q[1] + RADIUS * s4 * c5 * cb - eta2,
            q[2] - RADIUS * s5 * cb,
            sb,
        ]
        assert_equal(conditions, np.zeros(4))
        assert cb > 0.0
        assert_equal([eta1, eta2], [q[0] + RADIUS * c4 * c5, q[1] + RADIUS * s4 * c5])
        assert_equal(frictionless.system.gaps[0, 0], 0.0)


def printed_jacobians(q, beta):
    """J (45) and f_q, whose blocks are diag(1, 1, 0) and W with its s and c restored (46, 47)."""
    s4, c4, s5, c5 = sines(q)
    sb, cb = math.sin(beta), math.cos(beta)
    jacobian = np.array([[-RADIUS * c4 * c5 * sb, -1.0, 0.0], [-RADIUS * s4 * c5 * sb, 0.0, -1.0], [cb, 0.0, 0.0]])
    by_q = np.zeros((3, 6))
    by_q[:, :3] = np.diag([1.0, 1.0, 0.0])
    by_q[:, 3:] = [
        [-RADIUS * s4 * c5 * cb, -RADIUS * c4 * s5 * cb, -RADIUS * c4 * c5 * sb],
        [RADIUS * c4 * c5 * cb, -RADIUS * s4 * s5 * cb, -RADIUS * s4 * c5 * sb],
        [0.0, 0.0, cb],
    ]
    return jacobian, by_q


def test_location_rates(frictionless, states):
    """Eq. 48, and Eq. 6 with the Jacobians (45) to (47)."""
    for q, v in states:
        frictionless(q, v)
        s4, c4, s5, c5 = sines(q)
        explicit = [
            -v[5],
            v[0] - RADIUS * s4 * c5 * v[3] - RADIUS * c4 * s5 * v[4],
            v[1] + RADIUS * c4 * c5 * v[3] - RADIUS * s4 * s5 * v[4],
        ]
        assert_equal(frictionless.rates, explicit)
        jacobian, by_q = printed_jacobians(q, q[5] + frictionless.location[0])
        assert_equal(frictionless.rates, -np.linalg.solve(jacobian, by_q @ v))


# ------------------------------------------------------------------------------- Sec. 6.3: relative velocity


def velocity_rows(q):
    """The matrix below (60), (6, 3), for v_c = v_2 - v_1 as in (54): its third row and the signs restored."""
    s4, c4, s5, c5 = sines(q)
    return np.array(
        [
            [-1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, -1.0],
            [RADIUS * s4 * c5, -RADIUS * c4 * c5, 0.0],
            [RADIUS * c4 * s5, RADIUS * s4 * s5, RADIUS * c5],
            [RADIUS * s4, -RADIUS * c4, 0.0],
        ]
    )


def test_relative_velocity(frictionless, states):
    """Eqs. 53 (third row with - R s5 s_beta q6') and 54, and their derivatives by q'."""
    for q, v in states:
        v = v + np.array([0.0, 0.0, 0.7, 0.0, 0.0, 0.0])  # v_c^3 is more than the zero of the constraint
        frictionless(q, v)
        s4, c4, s5, c5 = sines(q)
        beta = q[5] + frictionless.location[0]
        sb, cb = math.sin(beta), math.cos(beta)
        general = [
            -v[0]
            + RADIUS
            * (s4 * c5 * cb * v[3] + c4 * s5 * cb * v[4] + c4 * c5 * sb * v[5] + c4 * sb * v[3] + s4 * cb * v[5]),
            -v[1]
            - RADIUS
            * (c4 * c5 * cb * v[3] - s4 * s5 * cb * v[4] - s4 * c5 * sb * v[5] - s4 * sb * v[3] + c4 * cb * v[5]),
            -v[2] + RADIUS * c5 * cb * v[4] - RADIUS * s5 * sb * v[5],
        ]
        explicit = [
            -v[0] + RADIUS * (s4 * c5 * v[3] + c4 * s5 * v[4] + s4 * v[5]),
            -v[1] - RADIUS * (c4 * c5 * v[3] - s4 * s5 * v[4] + c4 * v[5]),
            -v[2] + RADIUS * c5 * v[4],
        ]
        slip = frictionless.system.slip[0]
        assert_equal(slip, general)
        assert_equal(slip, explicit)
        assert_equal(frictionless.rows.T, velocity_rows(q))


def test_velocity_constraints_and_traces(stuck, states):
    """Eqs. 55, 56, 61, 62: where v_c = 0 both traces have the same direction and the same speed of arc length."""
    for q, v in states:
        v = rolling(q, v)
        stuck(q, v)
        assert_equal(stuck.system.slip[0], np.zeros(3))
        s4, c4, _, _ = sines(q)
        xi, eta1, eta2 = stuck.rates
        assert_equal([eta1, eta2], [-RADIUS * s4 * xi, RADIUS * c4 * xi])
        assert_equal(RADIUS * abs(xi), math.hypot(eta1, eta2))


# ------------------------------------------------------------------------------- Sec. 6.4: dynamics


def mass_matrix(q):
    _, _, s5, c5 = sines(q)
    matrix = np.diag([MASS, MASS, MASS, J3 * c5**2 + J1 * s5**2, J1, J3])
    matrix[3, 5] = matrix[5, 3] = J3 * c5
    return matrix


def generalized_forces(q, v):
    """H below (60), with its third and fourth entries in their places."""
    s5, double = math.sin(q[4]), math.sin(2.0 * q[4])
    return np.array(
        [
            0.0,
            0.0,
            -MASS * GRAVITY,
            (J3 - J1) * v[3] * v[4] * double + J3 * v[5] * v[4] * s5,
            0.5 * (J1 - J3) * v[3] ** 2 * double - J3 * v[5] * v[3] * s5,
            J3 * v[3] * v[4] * s5,
        ]
    )


def test_mass_matrix_and_forces(frictionless, states):
    """M and H of Eq. 60 against Pinocchio's for this mechanism: the same coordinates, the same body."""
    model = frictionless.scene.model
    data = model.createData()
    for q, v in states:
        pin.computeAllTerms(model, data, q, v)
        assert_equal(np.triu(data.M), np.triu(mass_matrix(q)))
        assert_equal(data.nle, -generalized_forces(q, v))


def constraint_bias(q, v):
    """d(velocity_rows)/dt^T q' by differences of the printed matrix: truncation h^4, rounding 1e-16 / h."""
    h = 1e-3
    turn = (8.0 * (velocity_rows(q + h * v) - velocity_rows(q - h * v))) - (
        velocity_rows(q + 2.0 * h * v) - velocity_rows(q - 2.0 * h * v)
    )
    return (turn / (12.0 * h)).T @ v


def test_rolling_dynamics(stuck, states):
    """Eq. 60 with the multipliers that keep (61) and (62): accelerations and forces of the paper's own equations.

    The bias comes from differences, good to 1e-9.
    """
    for q, v in states:
        v = rolling(q, v)
        system = stuck(q, v)
        rows = velocity_rows(q)
        matrix = np.block([[mass_matrix(q), -rows], [rows.T, np.zeros((3, 3))]])
        solution = np.linalg.solve(matrix, np.concatenate([generalized_forces(q, v), -constraint_bias(q, v)]))
        scale = 1.0 + np.abs(solution).max()
        np.testing.assert_allclose(system.acceleration, solution[:6], rtol=0.0, atol=1e-9 * scale)
        np.testing.assert_allclose(stuck.force, solution[6:], rtol=0.0, atol=1e-9 * scale)
        residual = mass_matrix(q) @ system.acceleration - generalized_forces(q, v) - rows @ stuck.force
        assert np.abs(residual).max() <= TOLERANCE * scale


def test_sliding_dynamics(states):
    """Eqs. 60 and 63: slip, with friction along the slip velocity; what `simulate` reports at its first instant."""
    scene = disk_scene(pc.Coulomb(MU))
    for q, v in states[:100]:
        state = scene.initial_state(q, v)
        track = pc.simulate(scene, state, 0.0).contacts["rim/floor"]
        slip, force = track.slip_velocity[0], track.force[0]
        rows = velocity_rows(q)
        assert_equal(slip, rows.T @ v)
        tangential = slip[:2] / np.linalg.norm(slip[:2])
        assert_equal(force[:2], -MU * abs(force[2]) * tangential)
        assert_equal(track.multipliers[0], force)
        # the normal force of the paper's equations: friction's direction taken from the slip above
        direction = np.array([*(-MU * tangential), 1.0]) if force[2] > 0.0 else np.array([*(MU * tangential), 1.0])
        matrix = np.block([[mass_matrix(q), -(rows @ direction)[:, None]], [rows[:, 2][None, :], np.zeros((1, 1))]])
        right = np.concatenate([generalized_forces(q, v), [-constraint_bias(q, v)[2]]])
        normal = np.linalg.solve(matrix, right)[6]
        assert abs(normal - force[2]) <= 1e-9 * (1.0 + abs(normal))


# ------------------------------------------------------------------------------- the same through `analyze`


def test_analysis(states):
    """Conditions (42, 43), their Jacobians, the frame (41) and v_c as `analyze` gives them."""
    scene = disk_scene(None)
    start = scene.initial_state(*states[0])
    for q, v in states[:200]:
        found = pc.analyze(scene, dataclasses.replace(start, q=q, v=v))["rim/floor"]
        s4, c4, s5, c5 = sines(q)
        xi, eta1, eta2 = found.location
        beta = q[5] + xi
        sb, cb = math.sin(beta), math.cos(beta)
        conditions = [
            q[0] + RADIUS * (c4 * c5 * cb - s4 * sb) - eta1,
            q[1] + RADIUS * (s4 * c5 * cb + c4 * sb) - eta2,
            q[2] - RADIUS * s5 * cb,
            s5 * sb,
        ]
        assert_equal(found.f, conditions)
        jacobian, by_q = printed_jacobians(q, beta)
        # (44) is (42, 43) with s_beta = 0 put in and s_q5 divided out: combined with f_4 of (44) they are the same; f_3
        # has no row in (45) and (46)
        combined = np.array([[1.0, 0.0, -RADIUS * s4], [0.0, 1.0, RADIUS * c4], [0.0, 0.0, s5]])
        assert_equal(found.J[[0, 1, 3]], combined @ jacobian)
        assert_equal(found.J[2], [RADIUS * s5 * sb, 0.0, 0.0])
        assert_equal(found.f_q[[0, 1, 3]], combined @ by_q)
        assert_equal(found.f_q[2], [0.0, 0.0, 1.0, 0.0, -RADIUS * c5 * cb, RADIUS * s5 * sb])
        assert_equal(found.f_t, np.zeros(4))
        assert_equal(found.rates, -np.linalg.solve(jacobian, by_q @ v))
        assert_equal(found.frame, np.eye(3))
        assert_equal(found.dual_frame, np.eye(3))
        rows = velocity_rows(q)
        assert_equal(found.v_c, rows.T @ v)
        assert_equal(found.components, rows.T @ v)
        assert_equal(found.rows.T, rows)
        assert_equal(found.drift, np.zeros(3))
        np.testing.assert_allclose(found.bias, constraint_bias(q, v), rtol=0.0, atol=1e-9)
