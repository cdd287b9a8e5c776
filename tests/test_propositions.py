"""The paper's propositions 1 to 7 on random contours, each in its corrected form, through `pincontact.analyze`."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from random_contacts import PATTERNS, RandomContact, is_line_contact, motions_of, names_of

import pincontact as pc

# Table 1: equations m, parameters k, geometric constraints nu, velocity constraints of rolling.
TABLE = {
    "P-2C": (2, 1, 1, 1),
    "P-3C": (3, 1, 2, 1),
    "P-S": (3, 2, 1, 2),
    "2C-2C": (3, 2, 1, 1),
    "3C-3C": (3, 2, 1, 2),
    "3C-S": (4, 3, 1, 2),
    "S-S": (5, 4, 1, 2),
}
# Rounding of sums of some numbers of order 10, divided by a conditioning of 0.05 at worst.
ROUNDING = 1e-11
# Differences of eighth order, see `random_contacts`.
DIFFERENCES = 1e-7

EACH_PATTERN = pytest.mark.parametrize("pattern", PATTERNS)
CHECKED = settings(max_examples=12, deadline=None, derandomize=True, database=None)


def draw_contact(data, pattern, friction=None):
    names = tuple(data.draw(st.sampled_from(names_of(pattern, body))) for body in (1, 2))
    motions = tuple(data.draw(st.sampled_from(motions_of(pattern))) for _ in range(2))
    assume(not is_line_contact(pattern, names))
    on_world, seed = data.draw(st.booleans()), data.draw(st.integers(0, 10**6))
    contact = RandomContact(pattern, names, motions, on_world, seed, friction)
    assume(contact.at().condition > 0.05)
    return contact


def analyzed(contact, h=0.0):
    """The contact's equations h s along its motion."""
    q, v = contact.along(h)
    guess = contact.state.location + h * contact.rates
    state = dataclasses.replace(contact.state, q=q, v=v, t=contact.state.t + h, location=guess)
    return pc.analyze(contact.scene, state)["c"]


def sizes(*values):
    return 1.0 + max(np.abs(value).max() for value in values)


def normal_rows(pattern):
    """Components of v_c along the normals e_j of the frame (Def. 5): the geometric constraints."""
    return (1, 2) if pattern == "P-3C" else (2,)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_conditions_and_counts(pattern, data):
    """Propositions 1 and 2: m conditions hold at the contact, k of them give the location, nu are left. C2 is no
    further condition for points and for crossing curves."""
    contact = draw_contact(data, pattern)
    m, k, nu, rolling = TABLE[pattern]
    found = analyzed(contact)
    entry = contact.scene.contacts["c"].pattern
    assert (entry.equations, entry.parameters, entry.constraints, entry.tangents) == (m, k, nu, rolling)
    nv = contact.scene.model.nv
    assert found.f.shape == (m,)
    assert found.J.shape == (m, k)
    assert found.f_q.shape == (m, nv)
    assert np.abs(found.f).max() <= 1e-13
    assert np.linalg.matrix_rank(found.J) == k


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_rates_satisfy_all_conditions(pattern, data):
    """Eq. 5 for all m conditions: those not used for p' hold because the velocity satisfies the geometric constraints.
    The explicit part f_t is that of the drives."""
    contact = draw_contact(data, pattern)
    found = analyzed(contact)
    v = contact.state.v
    residual = found.f_q @ v + found.J @ found.rates + found.f_t
    assert np.abs(residual).max() <= ROUNDING * sizes(found.f_q, found.J, found.rates, found.f_t)
    if all(drive is None for drive in contact.drives) and not any(
        attached.contour.time_dependent for attached in contact.scene.contours.values()
    ):
        assert np.abs(found.f_t).max() <= 1e-14 * sizes(found.f_q)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_frame_and_its_dual(pattern, data):
    """Definition 5, Eq. 26, and components of v_c in an oblique frame: v_c = sum of v_c^j e_j."""
    contact = draw_contact(data, pattern)
    found, here = analyzed(contact), contact.at()
    np.testing.assert_allclose(np.linalg.norm(found.frame, axis=0), 1.0, rtol=1e-14)
    np.testing.assert_allclose(found.dual_frame.T @ found.frame, np.eye(3), atol=1e-13 / here.condition)
    e1, e2, e3 = found.frame.T
    np.testing.assert_allclose(e1, here.second[1] / np.linalg.norm(here.second[1]), atol=1e-14)
    if pattern in ("P-S", "3C-S", "S-S"):
        np.testing.assert_allclose(e2, here.second[2] / np.linalg.norm(here.second[2]), atol=1e-14)
    elif pattern == "3C-3C":
        np.testing.assert_allclose(e2, here.first[1] / np.linalg.norm(here.first[1]), atol=1e-14)
    normal = np.cross(e1, e2)
    np.testing.assert_allclose(e3, normal / np.linalg.norm(normal), atol=1e-13 / here.condition)
    np.testing.assert_allclose(found.frame @ found.components, found.v_c, rtol=0.0, atol=1e-12 * sizes(found.v_c))


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_geometric_constraints_as_velocities(pattern, data):
    """Proposition 3: v_c has no component along the normals, and the gap's rate is that component."""
    contact = draw_contact(data, pattern)
    found = analyzed(contact)
    for row in normal_rows(pattern):
        assert abs(found.components[row]) <= 1e-12 * sizes(found.v_c)
    assert np.abs(found.rows @ contact.state.v + found.drift - found.components).max() <= 1e-12 * sizes(found.rows)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_rates_of_the_components(pattern, data):
    """d v_c^j / dt = rows a + bias in the frame that turns with the contact, slipping: m^j' . v_c included."""
    contact = draw_contact(data, pattern)
    found = analyzed(contact)
    rate = contact.derivative(lambda h: analyzed(contact, h).components)
    expected = found.rows @ contact.acceleration + found.bias
    # crossing curves and oblique parameter lines magnify differences by 1 / conditioning
    assert np.abs(rate - expected).max() <= DIFFERENCES * sizes(expected) / found.conditioning


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_rolling_traces(pattern, data):
    """Propositions 4 and 5 and Eq. 19: without slip both traces have the same velocity, so that arc lengths grow
    equally and point the same way; a point's trace stands still, which makes its velocity constraints holonomic."""
    contact = draw_contact(data, pattern, pc.NoSlip())
    found, here = analyzed(contact), contact.at()
    assert np.abs(found.v_c).max() <= 1e-12
    k1, k2 = PATTERNS[pattern]
    first = here.first[1 : 1 + k1].T @ found.rates[:k1]
    second = here.second[1 : 1 + k2].T @ found.rates[k1:]
    assert np.abs(first - second).max() <= ROUNDING * sizes(found.rates)
    if k1 == 0:
        assert np.abs(found.rates).max() <= ROUNDING


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_multipliers_are_force_components(pattern, data):
    """Propositions 6 and 7: with the Appell-Chetaev rows d v_c^j / d v, the multipliers of the equations of motion are
    the components F_j = e_j . F of the contact force in the dual frame. The force reported makes accelerations that
    keep every constraint."""
    contact = draw_contact(data, pattern, pc.NoSlip())
    model, state = contact.scene.model, contact.state
    found = analyzed(contact)
    track = pc.simulate(contact.scene, state, 0.0).contacts["c"]
    force, multipliers = track.force[0], track.multipliers[0]
    np.testing.assert_allclose(multipliers, found.frame.T @ force, rtol=0.0, atol=1e-12 * sizes(force))
    np.testing.assert_allclose(found.dual_frame @ multipliers, force, rtol=0.0, atol=1e-11 * sizes(force))
    data_ = model.createData()
    acceleration = pin.aba(model, data_, state.q, state.v, found.rows.T @ multipliers)
    rates = found.rows @ acceleration + found.bias
    tangential = {"P-2C": (0,), "2C-2C": (0,), "P-3C": (0,)}.get(pattern, (0, 1))
    kept = [*tangential, *normal_rows(pattern)]
    # accelerations are large where masses are small against forces: relative to both
    scale = sizes(found.rows @ acceleration, found.bias, force)
    assert np.abs(rates[kept]).max() <= 1e-10 * scale / found.conditioning
