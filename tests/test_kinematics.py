"""Contact kinematics against differences along smooth motions: location rates, v_c, the gap's rate, the bias of the
acceleration. All seven patterns, every kind of contour, fixed, driven and changing with time."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from random_contacts import PATTERNS, carried, contacts

# Differences of eighth order are good to some 1e-11; splines are four times differentiable at their knots only.
TOLERANCE = 1e-8


@st.composite
def anywhere(draw, pattern):
    """A random contact of a pattern; half of them off the constraints, where all of this holds, too."""
    contact = draw(contacts(pattern))
    if draw(st.booleans()):
        assume(contact.move_off(draw(st.integers(0, 10**6))))
    return contact


def assert_close(found, expected, factor=1.0):
    scale = 1.0 + np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=factor * TOLERANCE * scale)


EACH_PATTERN = pytest.mark.parametrize("pattern", PATTERNS)
CHECKED = settings(max_examples=5, deadline=None, derandomize=True, database=None)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_location_rates(pattern, data):
    contact = data.draw(anywhere(pattern))
    assert_close(contact.derivative(lambda h: contact.at(h).location), contact.at().rates)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_relative_velocity_and_its_rows(pattern, data):
    """v_c is the difference of the material points' velocities (Eq. 10); its rows are its derivatives by v."""
    contact = data.draw(anywhere(pattern))
    points = contact.derivative(contact.material_points)
    here = contact.at()
    assert_close(here.slip, points[1] - points[0])
    state = contact.state
    at_rest = contact.evaluate(state.q, np.zeros_like(state.v), state.t)
    np.testing.assert_allclose(here.rows @ state.v, here.basis @ (here.slip - at_rest.slip), rtol=0.0, atol=1e-13)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_gap_rate_is_the_normal_velocity(pattern, data):
    """Proposition 3: the geometric constraints' rates are the normal components of v_c, also when the bodies part."""
    contact = data.draw(anywhere(pattern))
    contact.state.v[:] += contact.acceleration  # parting or pressing: n . v_c is not zero
    here = contact.at()

    def gaps(h):
        there = contact.at(h)
        if pattern != "P-3C":
            return there.gaps[:1]
        difference = there.gaps @ there.basis[[2, 1]]
        return [n @ difference for n in carried(here, there)]

    normals = here.basis[1:] if pattern == "P-3C" else here.basis[2:]
    assert_close(contact.derivative(gaps), normals @ here.slip)


@EACH_PATTERN
@CHECKED
@given(data=st.data())
def test_bias_of_the_acceleration(pattern, data):
    """Rates of v_c along the motion: rows a + bias. The normals turn, which v_c meets in slip; tangents are held."""
    contact = data.draw(anywhere(pattern))
    here = contact.at()

    def components(h):
        there = contact.at(h)
        tangent, second, _ = here.basis
        if pattern == "P-3C":
            return [tangent @ there.slip, *(carried(here, there) @ there.slip)]
        return [tangent @ there.slip, second @ there.slip, there.basis[2] @ there.slip]

    assert_close(contact.derivative(components), here.rows @ contact.acceleration + here.bias, factor=10.0)
