"""`pincontact.analyze` on random contacts of all patterns: the conditions and each of their derivatives, components of
v_c in an oblique frame and their rates, the equations of motion."""

import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, reject, settings
from hypothesis import strategies as st
from random_contacts import PATTERNS, PLANAR, START, RandomContact, contacts

import pincontact as pc

# Differences of eighth order, see `random_contacts`; derivatives of conditions have no conditioning in them.
DIFFERENCES = 1e-8
LAWS = {"smooth": None, "rolling": pc.NoSlip(), "rough": pc.Coulomb(0.2, viscous=0.1)}
EACH_PATTERN = pytest.mark.parametrize("pattern", PATTERNS)
CHECKED = settings(max_examples=4, deadline=None, derandomize=True, database=None)


def analyzed(contact, h=0.0):
    """The contact's equations h s along its motion."""
    q, v = contact.along(h)
    guess = contact.state.location + h * contact.rates
    state = dataclasses.replace(contact.state, q=q, v=v, t=contact.state.t + h, location=guess)
    return pc.analyze(contact.scene, state)["c"]


def conditions(contact, q, location, t):
    """f (m,) at any (q, p, t), from contours and Pinocchio's placements: r_first - r_second, then e_3 . tau_1."""
    model, k1 = contact.scene.model, PATTERNS[contact.pattern][0]
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    shapes, rotations = [], []
    named = contact.scene.contacts["c"]
    for attached, u in zip((named.body1, named.body2), (location[:k1], location[k1:]), strict=True):
        pose = data.oMi[attached.joint] * attached.placement_in_joint
        if attached.motion is not None:
            pose = pose * attached.motion.placement(t)
        rows = attached.contour.evaluate(u, t) @ pose.rotation.T
        rows[0] += pose.translation
        shapes.append(rows)
        rotations.append(pose.rotation)
    first, second = shapes
    difference = (first[0] - second[0]) * (-1.0 if named.body1 is named.second else 1.0)
    if contact.pattern in PLANAR:
        c1 = rotations[1].T[:2] @ difference
        normal = np.cross(second[1], rotations[1][:, 2])
    else:
        c1, normal = difference, np.cross(second[1], second[2])
    if k1 == 0 or contact.pattern == "3C-3C":
        return c1
    tangents = first[1 : 1 + k1] / np.linalg.norm(first[1 : 1 + k1], axis=1)[:, None]
    return np.concatenate([c1, tangents @ normal / np.linalg.norm(normal)])


def assert_close(found, expected):
    scale = 1.0 + np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=DIFFERENCES * scale)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_derivatives_of_the_conditions(pattern, data):
    """f_q, J and f_t one by one (Eq. 5), along random directions; their sum vanishes on the motion in any case."""
    contact = data.draw(contacts(pattern, reversible=True))
    assume((contact.state.discrete[0, 1:3] == 0).all())  # other charts have other parameters
    found, q, t = analyzed(contact), contact.state.q, START
    p = found.location
    assert_close(found.f, conditions(contact, q, p, t))
    assert_close(
        found.f_q @ contact.state.v, contact.derivative(lambda h: conditions(contact, contact.along(h)[0], p, t))
    )
    direction = np.random.default_rng(p.size).normal(size=p.size)
    assert_close(found.J @ direction, contact.derivative(lambda h: conditions(contact, q, p + h * direction, t)))
    assert_close(found.f_t, contact.derivative(lambda h: conditions(contact, q, p, t + h)))


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_components_of_the_relative_velocity(pattern, data):
    """v_c = sum of v_c^j e_j with v_c^j = m^j . v_c = rows v + drift (Eqs. 12, 26), in frames that may be oblique."""
    contact = data.draw(contacts(pattern, reversible=True))
    found = analyzed(contact)
    scale = (1.0 + np.abs(found.v_c).max()) / contact.at().condition
    np.testing.assert_allclose(np.linalg.norm(found.frame, axis=0), 1.0, rtol=1e-14)
    np.testing.assert_allclose(found.dual_frame.T @ found.frame, np.eye(3), atol=1e-14 / contact.at().condition)
    np.testing.assert_allclose(found.frame @ found.components, found.v_c, rtol=0.0, atol=1e-13 * scale)
    rest = dataclasses.replace(contact.state, v=np.zeros_like(contact.state.v))
    np.testing.assert_allclose(found.drift, pc.analyze(contact.scene, rest)["c"].components, atol=1e-12 * scale)
    np.testing.assert_allclose(found.rows @ contact.state.v + found.drift, found.components, atol=1e-12 * scale)
    for row in (1, 2) if pattern == "P-3C" else (2,):
        assert abs(found.components[row]) <= 1e-12 * scale


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_rates_of_the_components(pattern, data):
    """d v_c^j / dt = rows a + bias in the frame that turns with the contact, slipping: m^j' . v_c included."""
    contact = data.draw(contacts(pattern, reversible=True))
    found = analyzed(contact)
    if pattern == "P-3C":
        # the frame's normals are made from the world axis that is least along the curve, which may change to another
        assume(abs(abs(found.frame[2, 0]) - 0.9) > 0.02)
    rate = contact.derivative(lambda h: analyzed(contact, h).components)
    expected = found.rows @ contact.acceleration + found.bias
    scale = (1.0 + np.abs(expected).max()) / found.conditioning
    assert np.abs(rate - expected).max() <= 10.0 * DIFFERENCES * scale
    assert_close(contact.derivative(lambda h: analyzed(contact, h).location), found.rates)


@pytest.mark.parametrize("law", LAWS)
@EACH_PATTERN
@settings(CHECKED, max_examples=3)
@given(data=st.data())
def test_equations_of_motion(pattern, law, data):
    """M a = H + rows^T multipliers (Eq. 31) gives accelerations that Pinocchio finds with the contact's wrenches, and
    along which differences of v_c^j vanish where it is constrained."""
    contact = data.draw(contacts(pattern, friction=LAWS[law], oblique=True, reversible=True))
    model, state = contact.scene.model, contact.state
    rng = np.random.default_rng(state.v.size)
    model.damping, tau = rng.uniform(0.1, 0.5, model.nv), rng.normal(size=model.nv)
    found = pc.analyze(contact.scene, state, tau)["c"]
    try:
        wrenches = pc.external_forces(contact.scene, state, tau)
    except pc.SolverError:
        with pytest.raises(pc.SolverError):
            assert found.force
        reject()
    other = model.createData()
    acting = tau - model.damping * state.v
    direction = rng.normal(size=model.nv)
    moved = pin.rnea(model, other, state.q, state.v, direction) - acting
    # rounding of a few products, by the conditioning of masses and contact
    scale = (1.0 + np.abs(found.force).max()) / found.conditioning
    np.testing.assert_allclose(found.M @ direction - found.H, moved, rtol=0.0, atol=1e-11 * scale)
    np.testing.assert_allclose(found.dual_frame @ found.multipliers, found.force, rtol=0.0, atol=1e-13 * scale)
    acceleration = np.linalg.solve(found.M, found.H + found.rows.T @ found.multipliers)
    by_pinocchio = pin.aba(model, other, state.q, state.v, acting, wrenches)
    np.testing.assert_allclose(acceleration, by_pinocchio, rtol=0.0, atol=1e-10 * scale)
    contact.acceleration = acceleration
    if pattern == "P-3C":
        assume(abs(abs(found.frame[2, 0]) - 0.9) > 0.02)
    rate = contact.derivative(lambda h: analyzed(contact, h).components)
    normals = [1, 2] if pattern == "P-3C" else [2]
    held = normals if law != "rolling" else [0, 2] if pattern in PLANAR else [0, 1, 2]
    assert np.abs(rate[held]).max() <= 10.0 * DIFFERENCES * scale * (1.0 + np.abs(acceleration).max())
    if law != "rolling":
        assert found.force @ found.v_c <= 1e-11 * scale


def test_analysis_needs_a_state_of_the_scene():
    one, other = (RandomContact("P-S", ("Point", "Plane"), seed=seed) for seed in (1, 2))
    with pytest.raises(pc.ArgumentError, match="another scene"):
        pc.analyze(one.scene, other.state)


def test_analysis_checks_torques():
    contact = RandomContact("P-S", ("Point", "Plane"), seed=1)
    for tau, text in (([1.0], r"tau must have 12 entries"), (np.full(12, np.nan), r"tau\[0\] is nan")):
        with pytest.raises(pc.StateError, match=text):
            pc.analyze(contact.scene, contact.state, tau)


def test_forces_are_those_of_the_state_that_was_given():
    """They are solved for when they are asked for, and the state may have been written to by then."""
    contact = RandomContact("P-S", ("Point", "Ellipsoid"), seed=2, friction=pc.Coulomb(0.2))
    first, second = (pc.analyze(contact.scene, contact.state)["c"] for _ in range(2))
    expected = first.force
    contact.state.v[:] *= 2.0
    np.testing.assert_array_equal(second.force, expected)
    assert np.abs(pc.analyze(contact.scene, contact.state)["c"].force - expected).max() > 1e-3


def test_parallel_rods_are_singular():
    """Parallel rods: 3C-3C has no frame, and no numbers are given."""
    contact = RandomContact("3C-3C", ("Line", "Line"), on_world=True, seed=3)
    rod, rail = contact.scene.contours.values()
    along = rail.placement_in_joint.rotation[:, 0]
    turn = pin.Quaternion.FromTwoVectors(rod.placement_in_joint.rotation[:, 0], along)
    q = np.array([*contact.state.q[:3], *turn.coeffs()])
    state = dataclasses.replace(contact.state, q=q)
    with pytest.raises(pc.SingularContactError):
        pc.analyze(contact.scene, state)
    assert math.isfinite(pc.analyze(contact.scene, contact.state)["c"].conditioning)
