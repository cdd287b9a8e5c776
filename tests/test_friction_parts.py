"""Friction of two directions and friction that falls with speed: the parts that forces are made with."""

import math

import numpy as np
import pytest
from calling import from_python

import pincontact as pc
from pincontact.friction import ellipse
from pincontact.friction.stribeck import stribeck
from pincontact.layout import ANISOTROPIC, ASPECT

set_friction_scaling = from_python(ellipse.set_friction_scaling)
scale_pair = from_python(ellipse.scale_pair)
friction_direction = from_python(ellipse.friction_direction)
friction_length = from_python(ellipse.friction_length)


def stretched(aspect, x, y):
    """Integers and numbers of a contact whose first direction is (x, y), and its stretch (2, 2)."""
    integers, numbers = np.zeros(200, dtype=np.int64), np.zeros(400)
    integers[ANISOTROPIC], numbers[ASPECT] = 1, aspect
    set_friction_scaling(numbers, x, y)
    matrix = np.array([scale_pair(numbers, 1.0, 0.0), scale_pair(numbers, 0.0, 1.0)]).T
    return integers, numbers, matrix


@pytest.mark.parametrize("aspect", [0.3, 1.0, 4.0])
@pytest.mark.parametrize("angle", np.linspace(0.1, 6.0, 7))
def test_stretch_of_two_directions(angle, aspect):
    """1 along the first direction, whatever its length, and the aspect across it; forces on the ellipse are of length
    one, and the force against a slip is the one that takes most power from it."""
    first = np.array([math.cos(angle), math.sin(angle)])
    across = np.array([-first[1], first[0]])
    integers, numbers, matrix = stretched(aspect, *(3.7 * first))
    assert matrix @ first == pytest.approx(first, abs=1e-14)
    assert matrix @ across == pytest.approx(aspect * across, abs=1e-14)
    turns = np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False)
    rim = np.c_[np.cos(turns), np.sin(turns)] @ np.array([first, aspect * across])
    for force in rim[::50]:
        assert friction_length(integers, numbers, *force) == pytest.approx(1.0, rel=1e-13)
        assert friction_length(integers, numbers, *(-2.5 * force)) == pytest.approx(2.5, rel=1e-13)
    for turn in (0.0, 0.7, 2.0, 4.4):
        slip = np.array([math.cos(turn), math.sin(turn)])
        force = slip.copy()
        friction_direction(integers, numbers, force)
        assert friction_length(integers, numbers, *force) == pytest.approx(1.0, rel=1e-13)
        best = (rim @ slip).max()
        # of 400 points one is within half a degree of the best, which is as flat as a parabola
        assert best <= force @ slip <= best * (1.0 + 1e-3)


def test_one_coefficient_needs_no_stretch():
    integers, numbers = np.zeros(200, dtype=np.int64), np.zeros(400)
    direction = np.array([0.6, 0.8])
    friction_direction(integers, numbers, direction)
    assert direction.tolist() == [0.6, 0.8]
    assert friction_length(integers, numbers, 3.0, 4.0) == 5.0
    # nothing slides
    integers, numbers, _ = stretched(2.0, 1.0, 0.0)
    direction[:] = 0.0
    friction_direction(integers, numbers, direction)
    assert not direction.any()


def test_stribecks_curve():
    assert stribeck(0.6, 0.2, 0.5, 2.0, 0.0) == 0.6
    assert stribeck(0.6, 0.2, 0.5, 2.0, 0.5) == pytest.approx(0.2 + 0.4 / math.e, rel=1e-14)
    assert stribeck(0.6, 0.2, 0.5, 3.0, 1.0) == pytest.approx(0.2 + 0.4 * math.exp(-8.0), rel=1e-14)
    assert stribeck(0.6, 0.2, 1e-6, 50.0, 1e6) == 0.2
    law = pc.Stribeck(0.2, 0.6, 0.5, 1.0)
    assert law.coefficient([[0.0, 0.5]]) == pytest.approx(np.array([[0.6, 0.2 + 0.4 / math.e]]), rel=1e-14)


def test_coefficients_of_laws():
    plain, static = pc.Coulomb(0.3), pc.Coulomb((0.3, 0.6), (0.4, 0.8))
    falling, ideal = pc.Stribeck((0.2, 0.1), (0.6, 0.3), 0.5), pc.NoSlip(rolling=0.1)
    found = [(law.sliding, law.sticking, law.onset, law.aspect) for law in (plain, static, falling, ideal)]
    assert found == [(0.3, 0.3, 0.3, 1.0), (0.3, 0.4, 0.3, 2.0), (0.2, 0.6, 0.6, 0.5), (math.inf,) * 3 + (1.0,)]
    assert [law.resists_turning for law in (plain, pc.Coulomb(0.3, spinning=0.1), ideal)] == [False, True, True]
    assert static.coefficient(np.ones((2, 3))).tolist() == [[0.3] * 3] * 2
    assert pc.Coulomb(0.0).sliding == pc.Coulomb(0.0, viscous=0.0, spinning=0.0).viscous == 0.0
    for mu, mu_static in (((0.3, 0.0), None), ((0.0, 0.3), None), ((0.3,), None), ((1, 2, 3), None), (0.3, 0.29),
                          ((0.3, 0.6), (0.4, 0.7)), ((0.3, 0.6), 0.7), (math.inf, None), (-0.1, None)):  # fmt: skip
        with pytest.raises(pc.FrictionError):
            pc.Coulomb(mu, mu_static)
    for speed, exponent in ((0.0, 2.0), (0.1, 0.99), (0.1, 50.1)):
        with pytest.raises(pc.FrictionError):
            pc.Stribeck(0.2, 0.3, speed, exponent)
    assert pc.Stribeck(0.2, 0.3, 0.1, 50.0).exponent == 50.0
