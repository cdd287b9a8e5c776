"""The paper's Propositions 1 to 7 on random contacts of all seven patterns, in the form in which they hold.

Corrections: Proposition 4 is about integrability itself, not about a term of Eq. 21 being there (planar rolling and
crossing curves always integrate); Proposition 5 is a relation of velocities; components along e_j belong to m^j
(Eq. 21).
Geometry is computed here from contours and Pinocchio's placements, apart from the kernels that are tested.
"""

import itertools
import math
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from random_contacts import PATTERNS, PLANAR, START, RandomContact, _moved, contacts
from scipy.special import ellipeinc
from shared import one_body

import pincontact as pc
from pincontact.geometry.frames import contact_frame, dual_basis
from pincontact.geometry.patterns import PATTERNS as TABLE

# Differences of eighth order are good to some 1e-11; splines are four times differentiable at their knots only.
DIFFERENCES = 1e-8
# Products of some ten numbers of order one, divided by at most the conditioning.
ROUNDING = 1e-11
EACH_PATTERN = pytest.mark.parametrize("pattern", PATTERNS)
CHECKED = settings(max_examples=4, deadline=None, derandomize=True, database=None)
# Table 1: equations m, location parameters k; constraints nu = m - k.
TABLE_1 = {
    "P-2C": (2, 1),
    "P-3C": (3, 1),
    "P-S": (3, 2),
    "2C-2C": (3, 2),
    "3C-3C": (3, 2),
    "3C-S": (4, 3),
    "S-S": (5, 4),
}
C1_IMPLIES_C2 = ("P-2C", "P-3C", "P-S", "3C-3C")
# Both bodies keep their contact points, or the one coordinate of rolling is an arc length.
HOLONOMIC = ("P-2C", "P-3C", "P-S", "2C-2C", "3C-3C")


def assert_close(found, expected, tolerance):
    scale = 1.0 + np.abs(expected).max(initial=0.0)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance * scale)


def analyzed(contact):
    return pc.analyze(contact.scene, contact.state)["c"]


def world_shapes(contact, q, location, t):
    """Both contours' derivatives (10, 3) with their points in row 0, in world axes, at location parameters (k,)."""
    model = contact.scene.model
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    k1, _ = PATTERNS[contact.pattern]
    shapes, poses = [], []
    parameters = (location[:k1], location[k1:])
    for attached, u, chart in zip(contact.scene.contours.values(), parameters, contact.state.discrete[0, 1:3]):
        pose = data.oMi[attached.joint] * attached.placement_in_joint
        if attached.motion is not None:
            pose = pose * attached.motion.placement(t)
        rows = attached.contour.evaluate(u, t, int(chart)) @ pose.rotation.T
        rows[0] += pose.translation
        shapes.append(rows)
        poses.append(pose)
    return shapes[0], shapes[1], poses[1].rotation[:, 2]


def frame_of(contact, first, second, plane_normal):
    return contact_frame(TABLE[contact.pattern].code, first, second, plane_normal, contact.at().basis)


def turned(contact, axis, angle):
    """q with body 1 turned about an axis through the contact point, which stays where it is."""
    q = contact.state.q.copy()
    point = analyzed(contact).point
    if contact.pattern in PLANAR:
        pose = pin.SE3(np.array([[q[2], -q[3], 0], [q[3], q[2], 0], [0, 0, 1.0]]), np.array([q[0], q[1], 0.0]))
    else:
        pose = pin.XYZQUATToSE3(q[:7])
    rotation = pin.exp3(angle * axis / np.linalg.norm(axis))
    pose = pin.SE3(rotation, point - rotation @ point) * pose
    if contact.pattern in PLANAR:
        q[:4] = *pose.translation[:2], pose.rotation[0, 0], pose.rotation[1, 0]
    else:
        q[:7] = pin.SE3ToXYZQUAT(pose)
    return q


# ---------------------------------------------------------------------------------------------------- Table 1


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_table_1(pattern, data):
    """m equations in k location parameters; k of them determine those, and nu = m - k constrain q (Proposition 2)."""
    contact = data.draw(contacts(pattern))
    found = analyzed(contact)
    m, k = TABLE_1[pattern]
    assert (found.f.size, found.location.size, found.J.shape) == (m, k, (m, k))
    assert_close(found.f, np.zeros(m), ROUNDING)
    # J has full rank, so p is a function of q; what it leaves of f are nu independent functions of q alone (Eq. 8)
    left, singular, _ = np.linalg.svd(found.J)
    assert singular[-1] > 1e-6 * singular[0]
    remaining = np.linalg.svd(left[:, k:].T @ found.f_q, compute_uv=False)
    assert remaining.size == m - k
    assert remaining[-1] > 1e-6
    entry = contact.scene.contacts["c"].pattern
    assert (entry.equations, entry.parameters, entry.constraints) == (m, k, m - k)
    # only a point on a spatial curve loses two degrees of freedom
    assert m - k == (2 if pattern == "P-3C" else 1)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_rates_of_location(pattern, data):
    """Eq. 6 with all m equations: along a motion that keeps the constraints, f_q q' + J p' + f_t = 0."""
    contact = data.draw(contacts(pattern))
    found = analyzed(contact)
    assert_close(found.f_q @ contact.state.v + found.J @ found.rates + found.f_t, np.zeros(found.f.size), 1e-9)


# ---------------------------------------------------------------------------------------------------- Proposition 1


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_proposition_1(pattern, data):
    """Bodies turned about their common point keep C1. C2 follows in four patterns, and is lost in the other three."""
    contact = data.draw(contacts(pattern))
    angle = data.draw(st.floats(0.2, 1.0))
    here = analyzed(contact)
    k1, k2 = PATTERNS[pattern]
    implied = pattern in C1_IMPLIES_C2
    if pattern in PLANAR:
        axis = np.array([0.0, 0.0, 1.0])
    elif implied:
        axis = np.random.default_rng(data.draw(st.integers(0, 1000))).normal(size=3)
    else:
        axis = np.cross(here.frame[:, 2], contact.at().first[1])
    q = turned(contact, axis, angle)
    first, second, plane_normal = world_shapes(contact, q, here.location, START)
    assert_close(second[0] - first[0], np.zeros(3), ROUNDING)  # C1
    assume(pattern != "3C-3C" or np.linalg.norm(np.cross(first[1], second[1])) > 1e-3)
    frame = frame_of(contact, first, second, plane_normal)
    tangents = np.array([*first[1 : 1 + k1], *second[1 : 1 + k2]])
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    out_of_plane = np.abs(tangents @ frame[:, 2]).max()
    if implied:
        assert out_of_plane <= 1e-12
        assert here.f.size == (2 if pattern in PLANAR else 3)
    else:
        # the turned tangent was in the plane, at a right angle to the axis
        assert out_of_plane >= math.sin(angle) - 1e-9


# ---------------------------------------------------------------------------------------------------- Propositions 2, 3


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_proposition_3(pattern, data):
    """d/dt (r_2 - r_1) . e_j = v_c . e_j for the normal e_j, along motions that part and press: p moves as it likes."""
    contact = data.draw(contacts(pattern))
    contact.state.v[:] += contact.acceleration
    here = analyzed(contact)
    normals = here.frame[:, 1:3] if pattern == "P-3C" else here.frame[:, 2:3]

    def gap(h):
        q, _ = contact.along(h)
        first, second, plane_normal = world_shapes(contact, q, contact.at(h).location, START + h)
        difference = second[0] - first[0]
        if pattern == "P-3C":
            # any two normals of the curve that turn smoothly
            e1 = second[1] / np.linalg.norm(second[1])
            return [(n - (n @ e1) * e1) @ difference for n in normals.T]
        return [frame_of(contact, first, second, plane_normal)[:, 2] @ difference]

    assert_close(contact.derivative(gap), normals.T @ here.v_c, DIFFERENCES)
    # the normals are their own duals: these components of v_c are contravariant ones, too (Eq. 12)
    assert_close(normals.T @ here.v_c, here.components[-normals.shape[1] :], ROUNDING)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_constraints_stay_closed_along_runs(pattern):
    """Runs are projected on what Eq. 16 says; `test_unprojected` has steps that are not."""
    contact = _running(pattern, None)
    run = pc.simulate(contact.scene, contact.state, 0.3, rtol=1e-9, atol=1e-11)
    assert run.success, run.message
    residuals = run.residuals()
    # projected after every step to rounding in units of the contours' size
    assert max(residuals[kind].max() for kind in ("C1", "C2", "GC")) < 1e-12


@cache
def _running(pattern, friction):
    """A contact that can be run: smooth contours, well placed. Seeds are tried in turn."""
    names = {
        "P-2C": ("Point", "Ellipse"),
        "P-3C": ("Point", "Helix"),
        "P-S": ("Point", "oblique ParametricSurface"),
        "2C-2C": ("Ellipse", "Line"),
        "3C-3C": ("Helix", "Line"),
        "3C-S": ("Circle", "oblique ParametricSurface"),
        "S-S": ("Ellipsoid", "oblique ParametricSurface"),
    }[pattern]
    tried = (RandomContact(pattern, names, seed=seed, friction=friction) for seed in itertools.count())
    return next(contact for contact in tried if contact.at().condition > 0.5)


# ---------------------------------------------------------------------------------------------------- Proposition 4


def joint_bracket(x, y, planar):
    """Commutator of two constant body twists of the free (or planar) joints: se(3) for each of them."""
    out = np.zeros_like(x)
    size = 3 if planar else 6
    for i in range(0, x.size, size):
        a, b = x[i : i + size], y[i : i + size]
        if planar:
            out[i : i + 3] = b[2] * a[1] - a[2] * b[1], a[2] * b[0] - b[2] * a[0], 0.0
        else:
            out[i : i + 3] = np.cross(a[3:], b[:3]) - np.cross(b[3:], a[:3])
            out[i + 3 : i + 6] = np.cross(a[3:], b[3:])
    return out


def curvature(contact, rng):
    """Frobenius: the exterior derivatives d a(X, Y) of the constraint forms on admissible X, Y, and a scale for them.

    They vanish for all such X, Y where the constraints of stick (velocity and geometric) integrate.
    """
    planar = contact.pattern in PLANAR
    size = 4 if planar else 7
    state = contact.state
    wanted = [0, 2] if planar else [0, 1, 2]
    rest = np.zeros_like(state.v)

    def rows(q):
        there = contact.evaluate(q, rest, START)
        return (there.dual.T @ there.basis.T @ there.rows)[wanted]

    def along(x):
        """Derivative of the forms along the constant twist x, (c, nv)."""
        parts = x.reshape(-1, 3 if planar else 6)

        def at(h):
            return rows(np.concatenate([_moved(p, h * s) for p, s in zip(state.q.reshape(-1, size), parts)]))

        return contact.derivative(at)

    forms = rows(state.q)
    admissible = np.linalg.svd(forms)[2][len(wanted) :]
    values, terms = [], []
    for _ in range(3):
        x, y = (rng.normal(size=len(admissible)) @ admissible for _ in range(2))
        parts = along(x) @ y, -along(y) @ x, -forms @ joint_bracket(x, y, planar)
        values.append(sum(parts))
        terms.append([np.abs(part).max() for part in parts])
    return np.abs(values).max(), 1.0 + np.max(terms)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_proposition_4(pattern, data):
    """A point that sticks and two crossing curves keep their location: holonomic; planar rolling is, too.

    A free curve or surface that rolls on a surface is not: the forms of its constraints have a curvature. Joints can
    take it away.
    """
    contact = data.draw(contacts(pattern))
    value, scale = curvature(contact, np.random.default_rng(data.draw(st.integers(0, 1000))))
    if pattern in HOLONOMIC:
        assert value <= 10.0 * DIFFERENCES * scale
    else:
        # far above what differences can do; random directions of nine or three dimensions never are all in a leaf
        assert value >= 1e-3


@pytest.mark.parametrize("pattern", ["P-2C", "P-3C", "P-S", "3C-3C"])
@CHECKED
@given(data=st.data())
def test_location_does_not_move_in_stick(pattern, data):
    """v_c = 0 and independent tangents leave nothing for p' (Eq. 11): this is why these constraints integrate."""
    contact = data.draw(contacts(pattern, friction=pc.NoSlip()))
    found = analyzed(contact)
    assert_close(found.v_c, np.zeros(3), ROUNDING)
    assert_close(found.rates, np.zeros(found.rates.size), 1e-9)


@pytest.mark.parametrize("pattern", ["P-2C", "P-3C", "P-S", "3C-3C"])
def test_location_stays_put_along_runs(pattern):
    contact = _running(pattern, pc.NoSlip())
    run = pc.simulate(contact.scene, contact.state, 0.3, rtol=1e-10, atol=1e-12)
    assert run.success, run.message
    location = run.contacts["c"].location
    # nothing but the integration's error over some twenty steps at 1e-10
    np.testing.assert_allclose(location, np.broadcast_to(location[0], location.shape), rtol=0.0, atol=1e-8)
    assert np.abs(run.q[-1] - run.q[0]).max() > 0.01  # the bodies themselves moved


def test_holonomy_of_a_rolling_ball():
    """Rolled around a rectangle, a ball comes back to its place turned: no function of q alone can forbid that."""
    radius, sides = 0.1, ((0.12, 0.0), (0.0, 0.07), (-0.12, 0.0), (0.0, -0.07))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia.FromSphere(1.0, radius), "ball", joint="root"))
    scene.add_contour("ball", pc.Sphere(radius), "ball")
    scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", "ball", "floor", friction=pc.NoSlip())
    pose = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.0, 0.0, radius]))
    start = pose.copy()
    for dx, dy in sides:
        omega = np.array([-dy, dx, 0.0]) / radius  # for one second; it rolls without spinning
        for part in np.linspace(0.0, 1.0, 5):
            rotation = pin.exp3(part * omega) @ pose.rotation
            here = pin.SE3(rotation, pose.translation + part * np.array([dx, dy, 0.0]))
            v = np.concatenate([rotation.T @ [dx, dy, 0.0], rotation.T @ omega])
            state = scene.initial_state(pin.SE3ToXYZQUAT(here), v)
            # this motion keeps every constraint: nothing had to be corrected
            assert max(state.correction.dq, state.correction.dv) < 1e-14
            assert np.abs(pc.analyze(scene, state)["c"].v_c).max() < 1e-14
        pose = here
    np.testing.assert_allclose(pose.translation, start.translation, atol=1e-15)
    turn = pin.log3(pose.rotation @ start.rotation.T)
    a, b = sides[0][0] / radius, sides[1][1] / radius
    loop = pin.exp3(np.array([b, 0, 0])) @ pin.exp3(np.array([0, -a, 0])) @ pin.exp3(np.array([-b, 0, 0]))
    np.testing.assert_allclose(turn, pin.log3(loop @ pin.exp3(np.array([0, a, 0]))), atol=1e-13)
    assert np.linalg.norm(turn) > 0.5
    # to leading order it is the area inside, over the radius squared, about the vertical
    assert turn[2] == pytest.approx(-a * b, rel=0.5)


def test_a_guided_wheel_is_holonomic():
    """3C-S on joints that keep the wheel in a plane: driven to and fro, its place remains a function of its angle."""
    radius, model, joint = 0.3, pin.Model(), 0
    for name, kind in (("x", pin.JointModelPX), ("z", pin.JointModelPZ), ("angle", pin.JointModelRY)):
        joint = model.addJoint(joint, kind(), pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([0.02, 0.045, 0.02])), pin.SE3.Identity())
    model.addBodyFrame("wheel", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    scene.add_contour("rim", pc.Circle(radius), "wheel", upright)
    scene.add_contour("floor", pc.Plane())
    assert scene.add_contact("c", "rim", "floor", friction=pc.NoSlip()).pattern.name == "3C-S"
    state = scene.initial_state([0.0, radius, 0.4], [0.0, 0.0, 0.0])
    run = pc.simulate(scene, state, 2.0, control=lambda t, q, v: np.array([0.0, 0.0, math.cos(3.0 * t)]), rtol=1e-10)
    assert run.success, run.message
    x, angle = run.q[:, 0], run.q[:, 2] - 0.4
    assert np.ptp(x) > 0.1 and np.ptp(np.sign(run.v[:, 2])) == 2.0
    # integrated at 1e-10
    np.testing.assert_allclose(x, radius * angle, rtol=0.0, atol=1e-9)


def test_planar_rolling_is_an_arc_length():
    """2C-2C: what an ellipse rolls over on a line is the length of its own arc, however fast and in whatever sense."""
    a, b = 0.4, 0.25
    model = one_body(pin.JointModelPlanar(), pin.Inertia(1.0, np.zeros(3), 0.05 * np.eye(3)), "ellipse", joint="root")
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    scene = pc.Scene(model)
    scene.add_contour("ellipse", pc.Ellipse(a, b), "ellipse")
    scene.add_contour("line", pc.Line())
    scene.add_contact("c", "ellipse", "line", friction=pc.NoSlip(), bilateral=True, location=(-0.5 * math.pi, 0.0))
    state = scene.initial_state(np.array([0.0, b, 1.0, 0.0]), np.array([0.9, 0.0, -3.0]))
    times = np.linspace(0.0, 2.0, 101)
    run = pc.simulate(scene, state, 2.0, rtol=1e-12, atol=1e-14, t_eval=times)
    assert run.success, run.message
    u = np.unwrap(run.contacts["c"].location_first[:, 0])
    # arc length of (a cos u, b sin u), counted from the end of the minor axis
    arc = a * ellipeinc(u + 0.5 * math.pi, 1.0 - (b / a) ** 2)
    s = run.contacts["c"].location_second[:, 0]
    # turned clockwise it rolls forwards; 1e-9 is the run's global error at tolerances of 1e-12
    np.testing.assert_allclose(s - s[0], arc - arc[0], rtol=0.0, atol=1e-9)
    assert np.ptp(arc) > 0.1


# ---------------------------------------------------------------------------------------------------- Proposition 5


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_proposition_5(pattern, data):
    """In rolling both traces have the same velocity vector in the world: aligned, and of equal arc-length speed."""
    contact = data.draw(contacts(pattern, friction=pc.NoSlip()))
    here = contact.at()
    k1, k2 = PATTERNS[pattern]
    trace1, trace2 = here.rates[:k1] @ here.first[1 : 1 + k1], here.rates[k1:] @ here.second[1 : 1 + k2]
    assert_close(trace1, trace2, 1e-9)
    if pattern in ("2C-2C", "3C-S", "S-S"):
        assert np.linalg.norm(trace2) > 1e-6  # and they do move


@pytest.mark.parametrize("pattern", ["2C-2C", "3C-S", "S-S"])
@CHECKED
@given(data=st.data())
def test_traces_differ_by_the_slip_velocity(pattern, data):
    """Eq. 11: without rolling the two traces' velocities differ by v_c, so that Proposition 5 is about v_c = 0."""
    contact = data.draw(contacts(pattern))
    here = contact.at()
    k1, k2 = PATTERNS[pattern]
    trace1, trace2 = here.rates[:k1] @ here.first[1 : 1 + k1], here.rates[k1:] @ here.second[1 : 1 + k2]
    assert_close(trace1 - trace2, here.slip, 1e-9)
    assert np.linalg.norm(here.slip) > 1e-3


# ---------------------------------------------------------------------------------------------------- Proposition 6


def equation_31(contact, wanted):
    """Multipliers of Eq. 31 for some of the constraints v_c^j = 0: dense linear algebra from Pinocchio's terms."""
    model, state, found = contact.scene.model, contact.state, analyzed(contact)
    data = model.createData()
    pin.computeAllTerms(model, data, state.q, state.v)
    mass = np.triu(data.M) + np.triu(data.M, 1).T
    rows, bias = found.rows[wanted], found.bias[wanted]
    free = np.linalg.solve(mass, -data.nle)
    return np.linalg.solve(rows @ np.linalg.solve(mass, rows.T), -(rows @ free + bias)), found


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_proposition_6_in_stick(pattern, data):
    """Multipliers of velocity and geometric constraints are the force's components in the dual frame, F_j = e_j . F."""
    contact = data.draw(contacts(pattern, friction=pc.NoSlip(), oblique=True))
    wanted = [0, 2] if pattern in PLANAR else [0, 1, 2]
    multipliers, found = equation_31(contact, wanted)
    track = _start(contact)
    expected = np.zeros(3)
    expected[wanted] = multipliers
    assert_close(track.multipliers[0], expected, 1e-9)
    assert_close(track.force[0], found.dual_frame @ expected, 1e-9)
    assert_close(track.multipliers[0], found.frame.T @ track.force[0], ROUNDING)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_proposition_6_without_friction(pattern, data):
    """The same with the geometric constraints alone; the force is along the normals."""
    contact = data.draw(contacts(pattern, oblique=True))
    wanted = [1, 2] if pattern == "P-3C" else [2]
    multipliers, found = equation_31(contact, wanted)
    track = _start(contact)
    assert_close(track.multipliers[0][wanted], multipliers, 1e-9)
    assert_close(track.force[0], found.dual_frame[:, wanted] @ multipliers, 1e-9)


def _start(contact):
    """The contact's track at the state itself."""
    run = pc.simulate(contact.scene, contact.state, 0.0)
    assume(run.success)
    return run.contacts["c"]


# ---------------------------------------------------------------------------------------------------- Proposition 7


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_proposition_7(pattern, data):
    """Appell-Chetaev: d v_c^j / d q' is the virtual displacement m^j . d(r_2 - r_1)/dq at fixed location parameters."""
    contact = data.draw(contacts(pattern))
    found = analyzed(contact)
    size = 4 if pattern in PLANAR else 7
    parts = contact.state.q.reshape(-1, size)
    nv = contact.state.v.size

    def displacement(step, h):
        steps = (h * step).reshape(len(parts), -1)
        q = np.concatenate([_moved(part, s) for part, s in zip(parts, steps)])
        first, second, _ = world_shapes(contact, q, found.location, START)
        return second[0] - first[0]

    virtual = np.column_stack([contact.derivative(lambda h, e=e: displacement(e, h)) for e in np.eye(nv)])
    assert_close(found.rows, found.dual_frame.T @ virtual, DIFFERENCES)
    # v_c is affine in q', and what does not come from q' comes from drives
    assert_close(found.components, found.rows @ contact.state.v + found.drift, ROUNDING)
    if all(drive is None for drive in contact.drives) and not any(
        attached.contour.time_dependent for attached in contact.scene.contours.values()
    ):
        assert_close(found.drift, np.zeros(3), ROUNDING)


# ---------------------------------------------------------------------------------------------------- Coulomb's law


@EACH_PATTERN
@CHECKED
@given(data=st.data(), mu=st.floats(0.02, 0.3))
def test_coulomb_in_oblique_frames(pattern, data, mu):
    """|F_t| = mu |F_n| is a relation of lengths, F_t is opposite to v_c, in world axes, whatever the contact frame."""
    contact = data.draw(contacts(pattern, friction=pc.Coulomb(mu), oblique=True))
    found = analyzed(contact)
    normals = found.frame[:, 1:3] if pattern == "P-3C" else found.frame[:, 2:3]
    slip = found.v_c - normals @ (normals.T @ found.v_c)
    speed = np.linalg.norm(slip)
    assume(speed > 1e-3)
    track = _start(contact)
    force = track.force[0]
    normal = normals @ (normals.T @ force)
    assert track.mode[0] == 2
    # force on body 2, v_c of body 2 against body 1
    assert_close(force - normal, -mu * np.linalg.norm(normal) * slip / speed, 1e-9)
    assert_close(track.normal_force[0] ** 2, np.linalg.norm(normal) ** 2, 1e-9)
    assert_close(track.tangential_force[0], mu * np.linalg.norm(normal), 1e-9)
    # the same from the multipliers: |F_t|^2 = F_i F_j m^i . m^j over the tangential ones
    if pattern in ("P-S", "3C-S", "S-S", "3C-3C"):
        tangential, dual = track.multipliers[0][:2], track.dual_frame[0][:, :2]
        assert_close(tangential @ (dual.T @ dual) @ tangential, (mu * np.linalg.norm(normal)) ** 2, 1e-9)


def test_multipliers_are_no_orthonormal_components():
    """The frames of these tests are oblique enough to tell: adding squares of multipliers is off by percents."""
    errors = []
    for seed in range(20):
        contact = RandomContact("P-S", ("Point", "oblique ParametricSurface"), seed=seed, friction=pc.Coulomb(0.2))
        run = pc.simulate(contact.scene, contact.state, 0.0)
        if run.success and run.contacts["c"].mode[0] == 2:
            track = run.contacts["c"]
            errors.append(abs(math.hypot(*track.multipliers[0][:2]) / track.tangential_force[0] - 1.0))
    assert len(errors) > 10 and np.median(errors) > 0.02


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_dual_frame(pattern, data):
    """Eq. 26, and Definition 5's angles: normals at right angles to all tangents, tangents at any angle."""
    contact = data.draw(contacts(pattern, oblique=True))
    found = analyzed(contact)
    assert_close(found.dual_frame.T @ found.frame, np.eye(3), ROUNDING)
    assert_close(dual_basis(found.dual_frame), found.frame, ROUNDING)
    assert_close(np.linalg.norm(found.frame, axis=0), np.ones(3), 1e-14)
    assert_close(found.frame[:, 2] @ found.frame[:, :2], np.zeros(2), ROUNDING)
    assert_close(found.dual_frame[:, 2], found.frame[:, 2], ROUNDING)
