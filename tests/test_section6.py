"""The paper's worked example (Sec. 6): a thin disk on a rough plane, every printed equation against the package.

Joints along and about the axes of Eq. 36 make Pinocchio's coordinates the paper's q1..q6. Misprints of the paper are
corrected where a comment says so. Angles keep s_q5 > 0, so that cos(beta*) = 1 is the rim's lowest point, and -1 its
highest, which touches the plane from below: the paper's other solution. The contact has sin(beta*) = 0; what is printed
with sin(beta*) is held against differentiation at any beta*, and against what of the package goes to other points of
the rim. 1000 random states (fewer where one takes milliseconds), compared to 1e-10: rounding of products of a few
numbers of order 10 is far below.
"""

import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest
from calling import from_python
from made_systems import made_system

import pincontact as pc
from pincontact.dynamics.system import System
from pincontact.geometry import location
from pincontact.geometry.patterns import PATTERNS as TABLE
from pincontact.integration.discrete import write_discrete
from pincontact.layout import K1, K2, OK, PATTERN, SYSTEM

MASS, RADIUS, GRAVITY, MU = 1.7, 0.45, 9.81, 0.3
J1, J3 = 0.25 * MASS * RADIUS**2, 0.5 * MASS * RADIUS**2
STATES = 1000
TOLERANCE = 1e-10


def disk_scene(friction, location=None):
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
    scene.add_contact("rim/floor", rim, floor, friction=friction, bilateral=True, location=location)
    return scene


def random_state(rng, beta=0.0):
    """(q, q') with the rim at beta on the plane for now and the next instant (Eqs. 51, 61 for beta = 0), slipping."""
    q, v = rng.uniform(-2.0, 2.0, 6), rng.uniform(-3.0, 3.0, 6)
    q[3], q[5] = rng.uniform(-math.pi, math.pi, 2)
    q[4] = rng.uniform(0.1, math.pi - 0.1)
    _, _, s5, c5 = sines(q)
    sb, cb = math.sin(beta), math.cos(beta)
    q[2] = RADIUS * s5 * cb
    v[2] = RADIUS * (c5 * cb * v[4] - s5 * sb * v[5])
    return q, v


def rolling(q, v, cb):
    """The same with the velocity constraints (62) satisfied, where sin(beta*) = 0."""
    s4, c4, s5, c5 = sines(q)
    v = v.copy()
    v[0] = RADIUS * cb * (s4 * c5 * v[3] + c4 * s5 * v[4] + s4 * v[5])
    v[1] = -RADIUS * cb * (c4 * c5 * v[3] - s4 * s5 * v[4] + c4 * v[5])
    return v


def sines(q):
    """s4, c4, s5, c5."""
    return math.sin(q[3]), math.cos(q[3]), math.sin(q[4]), math.cos(q[4])


class Evaluation:
    """The package's numbers at any (q, q') of the scene."""

    def __init__(self, friction, cb):
        self.cb, beta = cb, math.acos(cb)
        q, v = random_state(np.random.default_rng(0), beta)
        self.scene = disk_scene(friction, ([beta - q[5]], None))
        self.start = self.scene.initial_state(q, v)
        self.system = System(self.scene.model, list(self.scene.contacts.values()))
        write_discrete(self.system, self.start.discrete)

    def state(self, q, v):
        """(q, q') as a state on the same branch."""
        return dataclasses.replace(self.start, q=q, v=v)

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


@pytest.fixture(scope="module", params=[1.0, -1.0], ids=["lowest", "highest"])
def cb(request):
    """cos(beta*) at the contact."""
    return request.param


@pytest.fixture(scope="module")
def frictionless(cb):
    return Evaluation(None, cb)


@pytest.fixture(scope="module")
def stuck(cb):
    return Evaluation(pc.NoSlip(), cb)


@pytest.fixture(scope="module")
def sliding(cb):
    return Evaluation(pc.Coulomb(MU), cb)


@pytest.fixture(scope="module")
def states(cb):
    rng = np.random.default_rng(6)
    return [random_state(rng, math.acos(cb)) for _ in range(STATES)]


def random_betas(count=100):
    """(q, q', beta) with a point at beta, anywhere on the rim, on the plane."""
    rng = np.random.default_rng(7)
    for beta in rng.uniform(-math.pi, math.pi, count):
        yield *random_state(rng, beta), beta


def assert_equal(found, expected):
    error = np.abs(np.asarray(found) - np.asarray(expected))
    assert error.max() <= TOLERANCE * (1.0 + np.abs(expected).max()), (found, expected)


# ------------------------------------------------------------------------------- Sec. 6.1: the disk and its rim


def printed_rim(q, beta):
    """Eqs. 38 and 39: a point of the rim and its unit tangent (whose last component is + s5 s_beta, and whose
    denominator is a norm)."""
    s4, c4, s5, c5 = sines(q)
    sb, cb = math.sin(beta), math.cos(beta)
    point = q[:3] + RADIUS * np.array([c4 * c5 * cb - s4 * sb, s4 * c5 * cb + c4 * sb, -s5 * cb])
    return point, np.array([-(c4 * c5 * sb + s4 * cb), -s4 * c5 * sb + c4 * cb, s5 * sb])


def rim_point(q, xi):
    """A point of the rim by the three rotations in Eq. 36; takes complex numbers."""

    def turn(about, angle):
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]] if about == "z" else [[c, 0, s], [0, 1, 0], [-s, 0, c]])

    rotation = turn("z", q[3]) @ turn("y", q[4]) @ turn("z", q[5])
    return q[:3] + rotation @ (RADIUS * np.array([np.cos(xi), np.sin(xi), 0.0]))


def derivative(function, x, direction):
    """Directional derivative by a complex step: exact to rounding."""
    return np.imag(function(np.asarray(x) + 1e-100j * np.asarray(direction))) / 1e-100


def jacobian_of(function, x):
    return np.array([derivative(function, x, unit) for unit in np.eye(len(x))]).T


def test_rotation_and_rim(frictionless, states):
    """Eqs. 36, 38 and 39."""
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
        position, tangent = printed_rim(q, q[5] + xi)
        derivatives = rim.evaluate(xi)
        assert_equal(pose.act(derivatives[0]), position)
        assert_equal(pose.rotation @ derivatives[1] / np.linalg.norm(derivatives[1]), tangent)


def test_rim_at_any_beta():
    """Eqs. 38 and 39 against rotations and differentiation."""
    for q, _, beta in random_betas():
        xi = beta - q[5]
        position, tangent = printed_rim(q, beta)
        assert_equal(rim_point(q, xi), position)
        assert_equal(derivative(lambda x, q=q: rim_point(q, x), xi, 1.0) / RADIUS, tangent)


# ------------------------------------------------------------------------------- Sec. 6.2: conditions and location


def conditions(q, p, simplified):
    """f_1 .. f_4 of Eq. 44, or of 42 and 43; take complex numbers."""
    s4, c4, s5, c5 = np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4])
    sb, cb = np.sin(q[5] + p[0]), np.cos(q[5] + p[0])
    turned = 0.0 if simplified else RADIUS * sb
    return np.array(
        [
            q[0] + RADIUS * c4 * c5 * cb - s4 * turned - p[1],
            q[1] + RADIUS * s4 * c5 * cb + c4 * turned - p[2],
            q[2] - RADIUS * s5 * cb,
            sb if simplified else s5 * sb,
        ]
    )


def test_contact_conditions(frictionless, states):
    """Eqs. 44, 50 and 51: the location found satisfies all four conditions, on the branch that was begun on."""
    for q, v in states:
        frictionless(q, v)
        xi, eta1, eta2 = frictionless.location
        s4, c4, _, c5 = sines(q)
        cb = frictionless.cb
        assert_equal(conditions(q, frictionless.location, True), np.zeros(4))
        assert_equal(math.cos(q[5] + xi), cb)
        assert_equal([eta1, eta2], [q[0] + RADIUS * cb * c4 * c5, q[1] + RADIUS * cb * s4 * c5])
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


def test_conditions_and_jacobians_at_any_beta():
    """Eqs. 42 and 43 are r_1 - r_2 and the tangent's height; 45 to 47 are the derivatives of 44."""
    rng = np.random.default_rng(8)
    for q, _, beta in random_betas():
        p = np.array([beta - q[5], *rng.uniform(-2.0, 2.0, 2)])
        point, tangent = rim_point(q, p[0]), derivative(lambda x, q=q: rim_point(q, x), p[0], 1.0) / RADIUS
        assert_equal(conditions(q, p, False), [*(point - [p[1], p[2], 0.0]), tangent[2]])
        jacobian, by_q = printed_jacobians(q, beta)
        assert_equal(jacobian_of(lambda x, q=q: conditions(q, x, True)[[0, 1, 3]], p), jacobian)
        assert_equal(jacobian_of(lambda x, p=p: conditions(x, p, True)[[0, 1, 3]], q), by_q)
        assert_equal(np.linalg.det(jacobian), math.cos(beta))


def test_newtons_step_at_any_beta():
    """What the package solves for the location (C1 along both tangents of the plane, C2) is f_1, f_2 and f_4 of Eqs.
    42 and 43, wherever the rim and the plane's point are."""
    jacobian, residual = (
        from_python(part, SYSTEM) for part in (location.location_jacobian, location.location_residual)
    )
    solve, rng, rim = from_python(location.solve_location), np.random.default_rng(9), pc.Circle(RADIUS)
    system = made_system(1)
    system.contact_int[0, [PATTERN, K1, K2]] = TABLE["3C-S"].code, 1, 2
    system.vectors[location.NORMAL] = 0.0, 0.0, 1.0
    for q, _, beta in random_betas():
        q[2] += rng.uniform(-1.0, 1.0)
        p = np.array([beta - q[5], *rng.uniform(-2.0, 2.0, 2)])
        rotation = np.array([rim_point(np.r_[0, 0, 0, q[3:]], xi) / RADIUS for xi in (0.0, 0.5 * math.pi)]).T
        rotation = np.column_stack([rotation, np.cross(*rotation.T)])
        first, second = system.derivatives
        first[:] = rim.evaluate(p[0]) @ rotation.T
        second[:3] = [[p[1], p[2], 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        system.vectors[location.DIFFERENCE] = second[0] - first[0] - q[:3]
        jacobian(system, 0)
        residual(system, 0)
        solve(1, 2, system.location_system)
        by_p = jacobian_of(lambda x, q=q: conditions(q, x, False)[[0, 1, 3]], p)
        step = -np.linalg.solve(by_p, conditions(q, p, False)[[0, 1, 3]])
        assert_equal(system.location_system[3, [0, 2, 3]], step)


def test_location_rates(frictionless, states):
    """Eq. 48, and Eq. 6 with the Jacobians (45) to (47)."""
    cb = frictionless.cb
    for q, v in states:
        frictionless(q, v)
        s4, c4, s5, c5 = sines(q)
        explicit = [
            -v[5],
            v[0] - RADIUS * s4 * c5 * cb * v[3] - RADIUS * c4 * s5 * cb * v[4],
            v[1] + RADIUS * c4 * c5 * cb * v[3] - RADIUS * s4 * s5 * cb * v[4],
        ]
        assert_equal(frictionless.rates, explicit)
        jacobian, by_q = printed_jacobians(q, q[5] + frictionless.location[0])
        assert_equal(frictionless.rates, -np.linalg.solve(jacobian, by_q @ v))


# ------------------------------------------------------------------------------- Sec. 6.3: relative velocity


def velocity_rows(q, beta):
    """The matrix below (60), (6, 3), for v_c = v_2 - v_1 as in (53) at any point of the rim: its third row and the
    signs restored."""
    s4, c4, s5, c5 = sines(q)
    sb, cb = math.sin(beta), math.cos(beta)
    rows = [
        [s4 * c5 * cb + c4 * sb, -c4 * c5 * cb + s4 * sb, 0.0],
        [c4 * s5 * cb, s4 * s5 * cb, c5 * cb],
        [c4 * c5 * sb + s4 * cb, s4 * c5 * sb - c4 * cb, -s5 * sb],
    ]
    return np.vstack([-np.eye(3), RADIUS * np.array(rows)])


def printed_velocity(q, v, beta):
    """Eq. 53 (third component with - R s5 s_beta q6')."""
    s4, c4, s5, c5 = sines(q)
    sb, cb = math.sin(beta), math.cos(beta)
    return [
        -v[0]
        + RADIUS * (s4 * c5 * cb * v[3] + c4 * s5 * cb * v[4] + c4 * c5 * sb * v[5] + c4 * sb * v[3] + s4 * cb * v[5]),
        -v[1]
        - RADIUS * (c4 * c5 * cb * v[3] - s4 * s5 * cb * v[4] - s4 * c5 * sb * v[5] - s4 * sb * v[3] + c4 * cb * v[5]),
        -v[2] + RADIUS * c5 * cb * v[4] - RADIUS * s5 * sb * v[5],
    ]


def test_relative_velocity(frictionless, states):
    """Eqs. 53 and 54, and their derivatives by q'."""
    cb = frictionless.cb
    for q, v in states:
        v = v + np.array([0.0, 0.0, 0.7, 0.0, 0.0, 0.0])  # v_c^3 is more than the zero of the constraint
        frictionless(q, v)
        s4, c4, s5, c5 = sines(q)
        beta = q[5] + frictionless.location[0]
        explicit = [
            -v[0] + RADIUS * cb * (s4 * c5 * v[3] + c4 * s5 * v[4] + s4 * v[5]),
            -v[1] - RADIUS * cb * (c4 * c5 * v[3] - s4 * s5 * v[4] + c4 * v[5]),
            -v[2] + RADIUS * cb * c5 * v[4],
        ]
        slip = frictionless.system.slip[0]
        assert_equal(slip, printed_velocity(q, v, beta))
        assert_equal(slip, explicit)
        assert_equal(frictionless.rows.T, velocity_rows(q, beta))


def test_relative_velocity_at_any_beta():
    """Eq. 53 against differentiation, and against the package's v_c of a point on the rim that touches the plane."""
    for q, v, beta in random_betas():
        xi = beta - q[5]
        slip = -derivative(lambda x, xi=xi: rim_point(x, xi), q, v)
        assert_equal(printed_velocity(q, v, beta), slip)
        assert_equal(velocity_rows(q, beta).T @ v, slip)
        assert_equal(-jacobian_of(lambda x, xi=xi: rim_point(x, xi), q), velocity_rows(q, beta).T)
        scene = disk_scene(None)
        place = pin.SE3(np.eye(3), RADIUS * np.array([math.cos(xi), math.sin(xi), 0.0]))
        other = pc.Scene(scene.model)
        tip, floor = other.add_contour("tip", pc.Point(), "disk", place), other.add_contour("floor", pc.Plane())
        other.add_contact("tip/floor", tip, floor, bilateral=True)
        found = pc.analyze(other, other.initial_state(q, v))["tip/floor"]
        assert_equal(found.v_c, slip)
        assert_equal(found.rows.T, velocity_rows(q, beta))
        assert_equal(found.location, rim_point(q, xi)[:2])


def test_velocity_constraints_and_traces(stuck, states):
    """Eqs. 55, 56, 61, 62: where v_c = 0 both traces have the same direction and the same speed of arc length."""
    for q, v in states:
        v = rolling(q, v, stuck.cb)
        stuck(q, v)
        assert_equal(stuck.system.slip[0], np.zeros(3))
        s4, c4, _, _ = sines(q)
        xi, eta1, eta2 = stuck.rates
        assert_equal([eta1, eta2], [-RADIUS * stuck.cb * s4 * xi, RADIUS * stuck.cb * c4 * xi])
        assert_equal(RADIUS * abs(xi), math.hypot(eta1, eta2))


# ------------------------------------------------------------------------------- Sec. 6.4: dynamics


def test_angular_velocity(frictionless, states):
    """Eq. 57 in the frame turned by q4 and q5 but not spinning, and by q6 in the disk's own."""
    model = frictionless.scene.model
    data = model.createData()
    for q, v in states:
        pin.forwardKinematics(model, data, q, v)
        _, _, s5, c5 = sines(q)
        printed = np.array([-v[3] * s5, v[4], v[3] * c5 + v[5]])
        assert_equal(data.v[6].angular, pin.utils.rotate("z", q[5]).T @ printed)


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


def constraint_bias(q, v, cb):
    """d(velocity_rows)/dt^T q' where sin(beta*) stays zero, by differences of the printed matrix: truncation h^4,
    rounding 1e-16 / h."""
    h = 1e-3
    before2, before, after, after2 = (velocity_rows(q + i * h * v, math.acos(cb)) for i in (-2, -1, 1, 2))
    return ((8.0 * (after - before) - (after2 - before2)) / (12.0 * h)).T @ v


def test_rolling_dynamics(stuck, states):
    """Eq. 60 with the multipliers that keep (61) and (62): accelerations and forces of the paper's own equations.

    The bias comes from differences, good to 1e-9.
    """
    for q, v in states:
        v = rolling(q, v, stuck.cb)
        system = stuck(q, v)
        rows = velocity_rows(q, math.acos(stuck.cb))
        matrix = np.block([[mass_matrix(q), -rows], [rows.T, np.zeros((3, 3))]])
        solution = np.linalg.solve(matrix, np.concatenate([generalized_forces(q, v), -constraint_bias(q, v, stuck.cb)]))
        scale = 1.0 + np.abs(solution).max()
        np.testing.assert_allclose(system.acceleration, solution[:6], rtol=0.0, atol=1e-9 * scale)
        np.testing.assert_allclose(stuck.force, solution[6:], rtol=0.0, atol=1e-9 * scale)
        residual = mass_matrix(q) @ system.acceleration - generalized_forces(q, v) - rows @ stuck.force
        assert np.abs(residual).max() <= TOLERANCE * scale


def test_sliding_dynamics(sliding, states):
    """Eqs. 60 and 63: slip, with friction along the slip velocity; what `simulate` reports at its first instant."""
    for q, v in states[:100]:
        track = pc.simulate(sliding.scene, sliding.state(q, v), 0.0).contacts["rim/floor"]
        slip, force = track.slip_velocity[0], track.force[0]
        rows = velocity_rows(q, math.acos(sliding.cb))
        assert_equal(slip, rows.T @ v)
        tangential = slip[:2] / np.linalg.norm(slip[:2])
        assert_equal(force[:2], -MU * abs(force[2]) * tangential)
        assert_equal(track.multipliers[0], force)
        # the normal force of the paper's equations: friction's direction taken from the slip above
        direction = np.array([*(-MU * tangential), 1.0]) if force[2] > 0.0 else np.array([*(MU * tangential), 1.0])
        matrix = np.block([[mass_matrix(q), -(rows @ direction)[:, None]], [rows[:, 2][None, :], np.zeros((1, 1))]])
        right = np.concatenate([generalized_forces(q, v), [-constraint_bias(q, v, sliding.cb)[2]]])
        normal = np.linalg.solve(matrix, right)[6]
        assert abs(normal - force[2]) <= 1e-9 * (1.0 + abs(normal))


# ------------------------------------------------------------------------------- the same through `analyze`


def test_analysis(frictionless, states):
    """Conditions (42, 43), their Jacobians, the frame (41), v_c, M and H (60) as `analyze` gives them."""
    for q, v in states[:200]:
        found = pc.analyze(frictionless.scene, frictionless.state(q, v))["rim/floor"]
        s4, c4, s5, c5 = sines(q)
        beta = q[5] + found.location[0]
        sb, cb = math.sin(beta), math.cos(beta)
        assert_equal(found.f, conditions(q, found.location, False))
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
        rows = velocity_rows(q, beta)
        assert_equal(found.v_c, rows.T @ v)
        assert_equal(found.components, rows.T @ v)
        assert_equal(found.rows.T, rows)
        assert_equal(found.drift, np.zeros(3))
        np.testing.assert_allclose(found.bias, constraint_bias(q, v, frictionless.cb), rtol=0.0, atol=1e-9)
        assert_equal(found.M, mass_matrix(q))
        assert_equal(found.H, generalized_forces(q, v))
