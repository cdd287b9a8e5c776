"""Numbers of contours and motions as users give them: splines, profiles, tapes, twists, and what is known of them."""

import functools
import math

import numpy as np
import pinocchio as pin
import pytest
from calling import instructions
from scipy.interpolate import BSpline

import pincontact.contours as pc
from pincontact.contours import branches, checks, fits, piecewise, revolution, substitutes, tape
from pincontact.contours.base import Contour
from pincontact.contours.branches import _beside_root, _Search, survey
from pincontact.contours.formula import Formula
from pincontact.contours.piecewise import fitted
from pincontact.contours.tape import traced
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
    return Contour(traced, 1, pool=path.tape().pool).point(u)[0]


def test_a_sign_moves_into_a_sum_and_nothing_else_does():
    # exact, and one instruction less
    assert instructions(lambda u, v: -(2.0 * u + 1.0), "uv", 1) == 1
    assert instructions(lambda u, v: -(2.0 * u + 3.0 * v), "uv", 1) == 1
    # other factors would round otherwise than the user's code does
    assert instructions(lambda u, v: 0.1 * (0.7 * u + 0.3), "uv", 1) == 2
    assert instructions(lambda u, v: 0.1 * (0.7 * u + 0.3 * v), "uv", 1) == 2
    for u in np.random.default_rng(1).uniform(-9.0, 9.0, 50):
        assert point_of(lambda u: 0.1 * (0.7 * u + 0.3), u) == 0.1 * (0.7 * u + 0.3)
        assert point_of(lambda u: -(0.7 * u + 0.3), u) == -(0.7 * u + 0.3)


def test_quotients_are_one_instruction_that_rounds_as_the_users_code_does():
    """The product with an inverse rounds twice."""

    def quotient(u):
        return (0.7 * u + 0.3) / (u * u + 1.0)

    assert instructions(lambda u, v: u / v, "uv", 1) == 1
    for u in np.random.default_rng(2).uniform(-9.0, 9.0, 50):
        assert point_of(quotient, u) == quotient(u)


@pytest.mark.parametrize(("value", "wanted"), [(0.0, 2.0), (0.5, 1.0), (-0.5, 1.0), (1.0, 1.0)])
def test_what_is_not_zero_is_true(value, wanted):
    assert Path(lambda u: 1.0 if u else 2.0, "u", 1, [value]).tape().constants == (wanted,)


def test_python_functions_of_numpy_are_left_as_they_are():
    assert substitutes.replaced(np.full, {}) is np.full
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
    for f in (lambda u: (u, math.gamma(u + 2.0), 0.0), lambda u: (u, math.sin(u), 0.0)):
        plain = pc.ParametricCurve(f, (-1.0, 1.0))
        timed = pc.ParametricCurve(f, (-1.0, 1.0), time_domain=(2.0, 5.0))
        assert timed.kind == plain.kind
        assert not timed.time_dependent
        for u in (-0.7, 0.3, 0.9):
            assert timed.evaluate(u, 3.0) == pytest.approx(plain.evaluate(u), abs=1e-15)
    with pytest.raises(ContourError, match="give time_domain"):
        pc.ParametricCurve(lambda u, t: (u, math.gamma(u + t + 2.0), 0.0), (-1.0, 1.0))


# Motions.


def steady(axis, t):
    return pin.SE3(pin.exp3(t * np.array(axis)), np.array([math.cos(t), math.sin(t), 0.3]))


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)])
@pytest.mark.parametrize("turns", [1, 2])
def test_a_closed_path_of_an_odd_number_of_turns(axis, turns):
    """The quaternion closes after two rounds only; the motion after each, whenever it begins."""
    n, begin = 24 * turns, 2.0
    angles = 2.0 * math.pi * turns * np.arange(n) / n
    times = begin + 2.0 * math.pi * turns * np.arange(n + 1) / n
    motion = pc.SplineMotion(times, [steady(axis, angle) for angle in angles], periodic=True)
    for t in np.linspace(-8.0, 20.0, 40):
        row, exact = motion.evaluate(t), steady(axis, t - begin)
        # interpolation by degree 5 in steps of pi / 12
        assert row[:9].reshape(3, 3) == pytest.approx(exact.rotation, abs=1e-6)
        assert row[9:12] == pytest.approx(exact.translation, abs=1e-5)
        assert row[15:18] == pytest.approx(axis, abs=1e-4)


@pytest.mark.parametrize("flipped", [(1,), (2, 3), (5,), (0, 4)])
def test_quaternions_of_either_sign_are_one_rotation(flipped, monkeypatch):
    """Poses name no signs; whatever comes out of a matrix, the way between two of them is the short one."""
    from pincontact.contours import motion as module

    times = np.arange(8.0)
    poses = [steady((0.6, 0.0, 0.8), 0.5 * t) for t in times]
    expected = pc.SplineMotion(times, poses).pool
    usual, signs = module._coordinates, iter([-1.0 if i in flipped else 1.0 for i in range(8)])

    def coordinates(pose):
        found = usual(pose)
        found[3:] *= next(signs)
        return found

    monkeypatch.setattr(module, "_coordinates", coordinates)
    again = module.SplineMotion(times, poses)
    monkeypatch.undo()
    plain = module.Motion((), expected)
    plain.kind = module.MOTION_SPLINE
    for t in (0.2, 3.3, 6.7):
        assert again.evaluate(t) == pytest.approx(plain.evaluate(t), abs=1e-13)


def test_numbers_of_motions():
    # an axis of any length; without one, no turn
    assert pc.HarmonicMotion(axis=(0.0, 0.1, 0.2), angle=0.5, turn_phase=0.3).parameters[3:6] == pytest.approx(
        np.array([0.0, 1.0, 2.0]) / math.sqrt(5.0)
    )
    amplitude = np.array([0.1, 0.2, 0.3])
    still = pc.HarmonicMotion(amplitude, 2.0, center=(1.0, 2.0, 3.0)).evaluate(0.125)
    # at the end of its way
    expected = [*np.eye(3).ravel(), *amplitude, *np.zeros(6), *(-((4.0 * math.pi) ** 2) * amplitude), *np.zeros(3)]
    assert still == pytest.approx(expected, abs=1e-13)
    for bad, match in (({"axis": (0.0, 0.0, 0.0)}, "must not be zero"), ({"angle": 0.1}, "needs an axis")):
        with pytest.raises(ContourError, match=match):
            pc.HarmonicMotion(**bad)

    def at_rest(t):
        return pin.SE3.Identity(), np.zeros(6), np.zeros(6)

    assert pc.CallableMotion(at_rest).fit_error == 0.0
    fitted = pc.CallableMotion(lambda t: pin.SE3(np.eye(3), np.array([math.sin(t), 0.0, 0.0])), time_domain=(0.0, 3.0))
    assert 0.0 < fitted.fit_error < 1e-14


# Fits and seams.


def test_fits_are_kept_as_what_they_are():
    def f(u, v):
        return u, v, math.gamma(u + 3.0) * v

    surface = pc.ParametricSurface(f, ((-0.5, 0.5), (0.0, 1.0)))
    assert surface.evaluator is fitted
    assert surface.fit_error > 0.0
    rows = surface.evaluate((0.2, 0.5))
    assert rows[4, 2] == pytest.approx((math.gamma(3.2 + 1e-5) - math.gamma(3.2 - 1e-5)) / 2e-5, abs=1e-7)


@pytest.mark.parametrize("times", [None, (0.0, 1.0)])
def test_surfaces_in_time_are_not_fitted(times):
    with pytest.raises(ContourError, match="a surface that depends on time must be made of elementary"):
        pc.ParametricSurface(lambda u, v, t: (u, v, math.gamma(u + 3.0 + t)), ((0.0, 1.0),) * 2, time_domain=times)


# Places.


def test_places_of_many_boxes_and_of_many_edges():
    """The largest boxes of a path; of edges, some from the first to the last, a little before and after each."""
    search = _Search(Formula("test", lambda u, v: u, 2, 1), ((0.0, 10.0), (0.0, 0.1)), False)
    search.paths = [None, None]
    sizes = np.random.default_rng(4).permutation(100) / 100.0
    corners = [(np.array([0.1 * i, 0.0]), np.array([0.1 * i + 0.01 + 0.05 * s, 0.05])) for i, s in enumerate(sizes)]
    search.cells = [(i % 2, *box) for i, box in enumerate(corners)]
    places = search.places()
    assert places.shape == (80, 2)
    for number in (0, 1):
        own = {i for i, (low, high) in enumerate(corners) if any(((low < p) & (p < high)).all() for p in places)}
        largest = sorted(range(number, 100, 2), key=lambda i: -sizes[i])[:40]
        assert {i for i in own if i % 2 == number} == set(largest)
    search.paths, search.cells = [], []
    for count in (1, 39, 79, 100, 200):
        lows = np.linspace(1.0, 9.0, count)
        width = 1e-9 * 10.0
        search.edges = [(np.array([low, 0.02]), np.array([low + width, 0.06])) for low in lows]
        places = search.places()
        assert min(count, 20) <= len(places) <= 82
        assert places[:, 1] == pytest.approx(np.full(len(places), 0.02 + 0.4637 * 0.04), abs=1e-15)
        steps = places[:, 0] - lows[np.abs(places[:, :1] - lows).argmin(axis=1)]
        # both sides of the edge, farther from it than it is wide
        assert (np.abs(steps) > 2.0 * width).all()
        assert np.abs(steps).max() < 10.0 * width
        assert (steps > 0.0).sum() == (steps < 0.0).sum()
        assert places[:, 0].min() == pytest.approx(1.0, abs=1e-6)
        assert places[:, 0].max() > 8.5 or count == 1


# Traced arithmetic.


POWERS = [0.0, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, -1.0, -1.5, 2.5]


def test_powers_and_quotients_of_all_sorts():
    """Each is what Python makes of it; a power of the parameter is one operation at most."""
    for number in POWERS:
        for function in (
            lambda u, c=number: u**c,
            lambda u, c=number: c / u,
            lambda u, c=number: c * u,
            lambda u, c=number: u + c,
            lambda u, c=number: u - c,
            lambda u, c=number: c - u,
            lambda u, c=number: u / (c or 3.0),
            lambda u, c=number: (abs(c) + 0.5) ** u,
        ):
            for u in (0.4, 1.7):
                # a power of a number is an exponential
                assert point_of(function, u) == pytest.approx(function(u), rel=4e-16)
    assert [Path(lambda u, c=c: u**c, "u", 1, [0.4]).tape().pool[tape.COUNT] for c in POWERS] == [
        *[0, 1, 1, 0],
        *[1] * 6,
    ]
    # the simplest operation there is, for what is known of where it is smooth
    for power, same in (
        (lambda u: u**-1, lambda u: 1.0 / u),
        (lambda u: u**0.5, math.sqrt),
        (lambda u: u**2, lambda u: u * u),
    ):
        pools = [Path(f, "u", 1, [0.4]).tape().pool for f in (power, same)]
        assert pools[0].tolist() == pools[1].tolist()
    for base in (0.0, -2.0):
        assert "not smooth" in Path(lambda u, base=base: base**u, "u", 1, [0.4]).reason
    assert Path(lambda u: 1.0**u, "u", 1, [0.4]).tape().constants == (1.0,)


def ellipse_of(k, sense, n=4):
    """k times around, in one sense or the other."""
    cosine, sine = np.zeros((n, 2)), np.zeros((n, 2))
    cosine[k, 0], sine[k, 1] = 0.3, 0.2 * sense
    return pc.FourierCurve(cosine, sine)


@pytest.mark.parametrize(("k", "sense", "wanted"), [(1, 1, 1), (1, -1, -1), (2, 1, 0), (3, -1, 0)])
def test_how_often_a_curve_goes_around(k, sense, wanted):
    assert ellipse_of(k, sense).convex_side == wanted


def test_curves_with_hollows_or_cusps_or_in_space_are_not_convex():
    for cosine, sine in (
        # a hollow, a cusp, an eight, out of its plane
        ([[0, 0], [1, 0], [0.3, 0]], [[0, 0], [0, 1], [0, 0.3]]),
        ([[0, 0], [2, 0], [-1, 0]], [[0, 0], [0, 2], [0, -1]]),
        ([[0, 0], [1, 0], [0, 0]], [[0, 0], [0, 0], [0, 1]]),
        ([[0, 0, 0], [1, 0, 0.1]], [[0, 0, 0], [0, 1, 0]]),
    ):
        assert pc.FourierCurve(cosine, sine).convex_side == 0


def test_sizes_of_revolutions():
    """The largest radius, or half the height of what is tall."""
    assert pc.SurfaceOfRevolution(lambda s: (0.5 + 0.1 * s, 4.0 * s), (0.0, 1.0)).size == pytest.approx(2.0, rel=1e-12)
    assert pc.SurfaceOfRevolution(lambda s: (2.5 + 0.1 * s, 4.0 * s), (0.0, 1.0)).size == pytest.approx(2.6, rel=1e-12)


def test_flags():
    for given, wanted in ((0, False), (1, True), (np.int64(0), False), (np.bool_(True), True), (False, False)):
        assert checks.flag("test", "name", given) is wanted
        assert checks.flags("test", "name", (given, True)) == (wanted, True)
        assert checks.flags("test", "name", (True, given)) == (True, wanted)
    for bad in (2, -1, 0.0, 1.0, "yes", None):
        with pytest.raises(ContourError, match=r"name must be True or False"):
            checks.flag("test", "name", bad)
        for i in (0, 1):
            with pytest.raises(ContourError, match=rf"name\[{i}\] must be True or False"):
                checks.flags("test", "name", (bad, True) if i == 0 else (True, bad))
    for bad in ((True,), (True, False, True), "ab", 1, None):
        with pytest.raises(ContourError, match="name must be a pair of booleans"):
            checks.flags("test", "name", bad)


@pytest.mark.parametrize("domain", [(0.0, math.inf), (-math.inf, 0.0), (-math.inf, math.inf)])
def test_what_cannot_be_proved_for_ever_is_proved_far_enough(domain):
    """The difference of two terms that grow without bounds has none in a box without ends."""
    search = searched(lambda u: math.sqrt(u**4 - u**2 + 1.0), (domain,))
    assert search.single
    assert len(search.boxes) == 0
    assert len(search.cells) < 200
    assert min(low[0] for _, low, _ in search.cells) == search.start[0]
    assert max(high[0] for *_, high in search.cells) == search.end[0]
    assert all(abs(low[0]) >= 1e6 or abs(high[0]) >= 1e6 for _, low, high in search.cells if np.isinf(high - low)[0])


def test_another_function_long_ago():
    """So long ago that where it changes is not looked for."""
    formula = Formula("test", lambda u, t: u + abs(t + 2e6), 1, 1)
    first, last = survey(formula, ((-1.0, 1.0), (0.0, 3.0)), True).times
    assert -2e6 <= first <= -1e6
    assert last == math.inf


def test_sizes_of_patches_and_of_what_grows():
    assert pc.Plane(((0.0, 3.0), (1.0, 5.0))).size == 2.5
    assert pc.Plane(((1.0, 7.0), (-9.0, -1.0))).size == 5.0
    assert pc.Plane((None, (0.0, 1.0))).size == math.inf
    # at one of its times, which no parameter is
    sheet = pc.ParametricSurface(
        lambda u, v, t: (t * u, t * (v - 10.0), u), ((-1.0, 1.0), (10.0, 12.0)), time_domain=(0.0, 3.0)
    )
    assert 0.0 < sheet.size <= 0.5 * math.hypot(3.0 * 2.0, 3.0 * 2.0, 2.0)


@pytest.mark.parametrize("degree", [1, 2, 5, 12])
def test_nodes_are_the_zeros_of_the_next_polynomial(degree):
    nodes = piecewise.chebyshev_nodes(degree)
    assert (np.diff(nodes) > 0.0).all()
    assert np.polynomial.chebyshev.chebval(nodes, [0.0] * (degree + 1) + [1.0]) == pytest.approx(
        np.zeros(degree + 1), abs=1e-14
    )


@pytest.mark.parametrize("other", [(-3.0, -2.0), (0.2, 0.7), (4.0, 9.0), (-1.0, 9.0)])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("both", [False, True])
def test_formulas_that_do_not_repeat_themselves_repeat_where_they_are_said_to(axis, other, both):
    """Whatever the domain of the other parameter is: before, within, after or around this one's."""

    def bump(x, low, high):
        # with two derivatives zero at both ends
        return ((x - low) * (high - x)) ** 3

    def f(u, v):
        x, y = (u, v) if axis == 0 else (v, u)
        z = bump(y, *other) if both else y
        return z, bump(x, 0.0, 1.0) * (2.0 + z), 0.0 * x

    domain = ((0.0, 1.0), other) if axis == 0 else (other, (0.0, 1.0))
    surface = pc.ParametricSurface(f, domain, (both or axis == 0, both or axis == 1))
    rng = np.random.default_rng(3)
    period = np.array([high - low for low, high in domain])
    for _ in range(5):
        inside = np.array([rng.uniform(*ends) for ends in domain])
        turns = rng.integers(-3, 4, 2) * np.array(surface.periodic)
        away = surface.evaluate(inside + turns * period)
        # a rounding of the parameter, times slopes of some hundreds
        assert away == pytest.approx(surface.evaluate(inside), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_pieces_of_different_sizes_meet_or_are_named(axis, order):
    """A polynomial in pieces, and one with a jump of known size in some derivative along one argument."""
    lines = [np.array([0.0, 0.25, 2.0]), np.array([-1.0, 0.25, 0.5, 1.0])]
    solve, nodes = fits._solver(2, False)

    def checked(size):
        def f(x, y):
            along = max((x, y)[axis] - 0.25, 0.0)
            return np.array([1.0, x**3 * y**2 - x * y + size * (along**order if along > 0.0 else 0.0)])

        pieces = {ends: solve @ fits._data(f, None, ends, nodes) for ends in fits._boxes(lines)}
        fits._check_joints("test", lines, (False, False), fits._assembled(lines, pieces), 8.0, "")

    checked(0.0)
    if order == 3:
        # third derivatives may jump
        checked(1.0)
        return
    name = ("the function", "its first derivative", "its second derivative")[order]
    place = r"\(0.25, " if axis == 0 else r"\(\S+, 0.25\)"
    with pytest.raises(ContourError, match=rf"{name} jumps by {(1, 1, 2)[order]}.0e.00 near {place}"):
        checked(1.0)
