"""Numbers of contours and motions as users give them: splines, profiles, tapes, twists, and what is known of them."""

import functools
import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import BSpline

import pincontact.contours as pc
from pincontact.contours import branches, piecewise, revolution, trace
from pincontact.contours.base import TAPE_CURVE, Contour
from pincontact.contours.branches import _beside_root, _Search, survey
from pincontact.contours.formula import Formula
from pincontact.contours.trace import Path
from pincontact.errors import ContourError


def searched(f, domain, all_times=False):
    search = _Search(Formula("test", f, sum(not math.isnan(x[0]) for x in domain), 1), domain, all_times)
    search.run()
    return search


# Branches.


def test_a_function_with_branches_is_not_followed_for_ever():
    """A curved edge has no end of boxes: as soon as there are two paths, only so many are looked at."""
    search = searched(lambda u, v: abs(u * u + v * v - 0.5), ((-1.0, 1.0), (-1.0, 1.0)))
    assert not search.single
    # one more batch is examined than there is work for, each with both paths
    assert branches._MOST_WORK < search.work < 1.5 * branches._MOST_WORK


def test_places_of_functions_that_cannot_be_traced():
    """On every path, also if there is only one of them."""
    one = survey(Formula("test", lambda u: math.gamma(u), 1, 1), ((1.0, 2.0),), False)
    assert one.tape is None
    assert one.places.shape == (1, 1)
    assert 1.0 < one.places[0, 0] < 2.0
    # two large pieces, and a narrow one between them, which has its place
    bump = survey(Formula("test", lambda u: math.gamma(u) if 1.4 < u < 1.4001 else u, 1, 1), ((1.0, 2.0),), False)
    places = bump.places.ravel()
    assert ((places > 1.4) & (places < 1.4001)).any()
    assert (places < 1.4).any()
    assert (places > 1.4001).any()
    assert np.abs(places - 1.4).min() < 1e-8
    assert np.abs(places - 1.4001).min() < 1e-8


def test_cuts_beside_roots_that_are_anywhere():
    """All lines through the point within the bounds of the slope have their roots on one side of the cut."""
    rng = np.random.default_rng(11)
    found_sides = set()
    for _ in range(400):
        low, width = float(rng.uniform(-2.0, 2.0)), float(rng.choice([1e-6, 0.1, 2.0]))
        high, tiny = low + width, 1e-9 * width
        slope = float(rng.uniform(0.3, 3.0) * rng.choice([-1.0, 1.0]))
        spread = abs(slope) * float(rng.choice([0.0, 1e-4, 5e-3]))
        near = float(rng.choice([0.0, 1.0, 0.5])) + float(rng.choice([0.0, 1e-10, 1e-3, 0.03])) * float(
            rng.choice([-1, 1])
        )
        root, x = low + width * near, low + width * float(rng.uniform(0.1, 0.9))
        found = _beside_root(low, high, (x, slope * (x - root), slope - spread, slope + spread), tiny, math.inf)
        doubt = 0.4 * tiny + 4.0 * width * spread / abs(slope)
        if found == math.inf:
            # no room for a cut on either side
            assert not low + doubt < root - doubt < high - doubt or not low + doubt < root + doubt < high - doubt
            continue
        # parts on both sides of it are wider than the doubt
        assert low + doubt < found < high - doubt
        roots = [x - slope * (x - root) / s for s in (slope - spread, slope + spread)]
        assert all(r > found for r in roots) or all(r < found for r in roots)
        assert abs(found - root) <= 1.01 * doubt + 1e-15
        found_sides.add(found < root)
    assert found_sides == {True, False}


# Traces.


def point_of(function, u):
    path = Path(function, "u", 1, [u])
    assert path.reason == ""
    return Contour(TAPE_CURVE, 1, pool=path.tape("u").pool).point(u)[0]


def test_a_sign_moves_into_a_sum_and_nothing_else_does():
    def instructions(function):
        return trace.trace(function, "uv", 1).instructions

    # exact, and one instruction less
    assert instructions(lambda u, v: -(2.0 * u + 1.0)) == 1
    assert instructions(lambda u, v: -(2.0 * u + 3.0 * v)) == 1
    # other factors would round otherwise than the user's code does
    assert instructions(lambda u, v: 0.1 * (0.7 * u + 0.3)) == 2
    assert instructions(lambda u, v: 0.1 * (0.7 * u + 0.3 * v)) == 2
    for u in np.random.default_rng(1).uniform(-9.0, 9.0, 50):
        assert point_of(lambda u: 0.1 * (0.7 * u + 0.3), u) == 0.1 * (0.7 * u + 0.3)
        assert point_of(lambda u: -(0.7 * u + 0.3), u) == -(0.7 * u + 0.3)


@pytest.mark.parametrize(("value", "wanted"), [(0.0, 2.0), (0.5, 1.0), (-0.5, 1.0), (1.0, 1.0)])
def test_what_is_not_zero_is_true(value, wanted):
    assert Path(lambda u: 1.0 if u else 2.0, "u", 1, [value]).tape("u").constants == (wanted,)


def test_python_functions_of_numpy_are_left_as_they_are():
    assert trace._replace(np.full, {}) is np.full
    assert point_of(lambda u: np.full((2,), u)[1] + np.eye(2)[0, 0], 0.3) == 1.3


def outside(u):
    return math.sin(u)


def test_functions_whose_module_has_no_name():
    unnamed = type(outside)(outside.__code__, {"math": math})
    unnamed.__module__ = None
    assert point_of(unnamed, 0.3) == math.sin(0.3)
    assert point_of(functools.partial(lambda f, u: f(u), unnamed), 0.3) == math.sin(0.3)


# Splines, profiles and twists.


@pytest.mark.parametrize("columns", [2, 3])
def test_a_given_spline_in_the_plane_or_in_space(columns):
    """Two components are x and y; coefficients, points and table rows are as many as there were."""
    degree, n = 5, 9
    knots = np.concatenate([[0.0] * degree, np.linspace(0.0, 1.0, n - degree + 1), [1.0] * degree])
    given = BSpline(knots, np.random.default_rng(2).normal(size=(n, columns)), degree)
    curve = pc.SplineCurve(given)
    for u in np.linspace(0.0, 1.0, 7):
        assert curve.point(u)[:columns] == pytest.approx(given(u), abs=1e-13)
    assert curve.planar == (columns == 2)
    assert columns == 3 or curve.point(0.3)[2] == 0.0
    points = given(np.linspace(0.0, 1.0, 12))
    through = pc.SplineCurve(points, parameters=np.arange(12.0))
    assert through.domain == ((0.0, 11.0),)
    for i in (0, 5, 11):
        assert through.point(float(i))[:columns] == pytest.approx(points[i], abs=1e-13)
    table = np.random.default_rng(3).normal(size=(3, columns))
    wave = pc.FourierCurve(table, table)
    expected = table[0] + sum(table[k] * (math.cos(0.3 * k) + math.sin(0.3 * k)) for k in (1, 2))
    assert wave.point(0.3)[:columns] == pytest.approx(expected, abs=1e-14)
    assert wave.planar == (columns == 2)


def breaks_of(pool):
    start, count = int(pool[piecewise._BLOCKS + piecewise._BREAKS]), int(pool[piecewise._BLOCKS + piecewise._COUNT])
    return pool[start : start + count + 1]


@pytest.mark.parametrize("poles", [(0,), (-1,), (0, -1)])
def test_a_profile_of_points_is_one_polynomial_around_its_poles(poles):
    """As far from each of them as the cap may be fitted, and no farther."""
    angles = np.linspace(0.0 if 0 in poles else 0.4, math.pi if -1 in poles else 2.6, 20) ** 1.1
    angles *= (math.pi if -1 in poles else 2.6) / angles[-1]
    points = np.column_stack([np.sin(angles), -np.cos(angles)])
    points[np.abs(points) < 1e-12] = 0.0
    pool, (low, high), reaches = revolution._spline_profile("test", points, False)
    breaks = breaks_of(pool)
    for pole in poles:
        end = (low, high)[pole]
        assert np.abs(breaks - end).min() == pytest.approx(reaches[pole], rel=1e-9)
        # mirrored: as many pieces beyond it as there are before the other end
        assert (breaks < low).sum() >= (9 if 0 in poles else 0)
        assert (breaks > high).sum() >= (9 if -1 in poles else 0)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("bad", [False, True])
def test_an_end_of_a_profile_on_the_axis_is_a_pole_however_it_is_rounded(reverse, bad):
    """Zero up to rounding of the largest coordinate; more than that is a hole."""
    angles = np.linspace(0.0, 2.0, 25)
    points = np.column_stack([np.sin(angles), -np.cos(angles)])
    points[0, 0] = 1e-9 if bad else 1e-14
    surface = pc.SurfaceOfRevolution(points[::-1] if reverse else points)
    assert surface.charts == ((0,) if bad else (0, 2) if reverse else (0, 1))
    ends = surface.ends().tolist()
    low, high = surface.domain[1]
    assert ends[:2] == [-math.inf, math.inf]
    assert ends[2] == (-math.inf if not (bad or reverse) else low)
    assert ends[3] == (math.inf if not bad and reverse else high)


@pytest.mark.parametrize("rate", [0.0, 0.02, 0.3, 3.0])
def test_a_twist_of_any_rate(rate):
    """A screw about an axis through a point, from nothing at t = 0."""
    axis, center, linear = np.array([2.0, -1.0, 2.0]) / 3.0, np.array([0.3, 0.5, -0.2]), np.array([0.1, 0.2, 0.7])
    motion = pc.ConstantTwist(rate * axis, linear, center)
    for t in (0.0, 0.4, -1.3):
        turn = pin.exp3(rate * t * axis)
        row = motion.evaluate(t)
        assert row[:9].reshape(3, 3) == pytest.approx(turn, abs=1e-15)
        assert row[9:12] == pytest.approx(center - turn @ center + t * linear, abs=1e-15)
        arm = -turn @ center
        assert row[12:15] == pytest.approx(linear + rate * np.cross(axis, arm), abs=1e-15)
        assert row[15:18] == pytest.approx(rate * axis, abs=1e-15)
        assert row[18:21] == pytest.approx(rate**2 * np.cross(axis, np.cross(axis, arm)), abs=1e-14)
        assert not row[21:].any()


def test_times_belong_to_what_depends_on_time():
    """A time domain of a function without time has no meaning; fitted or traced it is what it is without."""
    for f in (lambda u: (u, abs(u - 0.3) ** 3.5, 0.0), lambda u: (u, math.sin(u), 0.0)):
        plain = pc.ParametricCurve(f, (-1.0, 1.0))
        timed = pc.ParametricCurve(f, (-1.0, 1.0), time_domain=(2.0, 5.0))
        assert timed.kind == plain.kind
        assert not timed.time_dependent
        for u in (-0.7, 0.3, 0.9):
            assert timed.evaluate(u, 3.0) == pytest.approx(plain.evaluate(u), abs=1e-15)
    with pytest.raises(ContourError, match="give time_domain"):
        pc.ParametricCurve(lambda u, t: (u, abs(u - t) ** 3.5, 0.0), (-1.0, 1.0))
