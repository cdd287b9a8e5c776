"""Parts of what makes contours and motions of functions, each looked at alone: paths, fits, seams, profiles."""

import itertools
import math
import operator

import numpy as np
import pinocchio as pin
import pytest
from calling import instructions, traced_tape

import pincontact.contours as pc
from pincontact.contours import fits, revolution
from pincontact.contours.base import Contour
from pincontact.contours.fits import fit
from pincontact.contours.formula import spread, takes_time, trials
from pincontact.contours.graph import Untraceable
from pincontact.contours.piecewise import fitted
from pincontact.contours.tape import traced
from pincontact.contours.trace import Path
from pincontact.errors import ContourError

# Functions that take decisions, what they decide, and where they are looked at.
DECISIONS = {
    "floor": (lambda u: math.floor(2.3 * u) + u, lambda u: math.floor(2.3 * u)),
    "ceil": (lambda u: math.ceil(2.3 * u) * u, lambda u: math.ceil(2.3 * u)),
    "trunc": (lambda u: math.trunc(2.3 * u) + u, lambda u: (u < 0.0, math.trunc(2.3 * u))),
    "int": (lambda u: int(2.3 * u) + u, lambda u: (u < 0.0, int(2.3 * u))),
    "round": (lambda u: round(2.3 * u) + u, lambda u: round(2.3 * u)),
    "round to a tenth": (lambda u: round(0.3 * u, 1) + u, lambda u: round(0.3 * u, 1)),
    "rint": (lambda u: np.rint(2.3 * u) + u, lambda u: round(2.3 * u)),
    "fix": (lambda u: np.fix(2.3 * u) + u, lambda u: (u < 0.0, int(2.3 * u))),
    "floor division": (lambda u: u // 0.7 + u, lambda u: u // 0.7),
    "division of a constant": (lambda u: 3.0 // (u + 2.6) + u, lambda u: 3.0 // (u + 2.6)),
    "remainder": (lambda u: u % 0.7, lambda u: u // 0.7),
    "of a constant": (lambda u: 3.0 % (u + 2.6), lambda u: 3.0 // (u + 2.6)),
    "of two": (lambda u: (3.0 + u) % (2.6 - u), lambda u: (3.0 + u) // (2.6 - u)),
    "mod": (lambda u: np.mod(u, 0.7), lambda u: u // 0.7),
    "fmod": (lambda u: math.fmod(u, 0.7), lambda u: (u < 0.0, int(u / 0.7))),
    "divmod": (lambda u: divmod(u, 0.7)[0] + 3.0 * divmod(u, 0.7)[1], lambda u: u // 0.7),
    "divmod of a constant": (lambda u: sum(divmod(3.0, u + 2.6)), lambda u: 3.0 // (u + 2.6)),
    "abs": (lambda u: abs(u - 0.3), lambda u: u < 0.3),
    "less": (lambda u: u * u if u < 0.3 else u, lambda u: u < 0.3),
    "at most": (lambda u: u * u if u <= 0.3 else u, lambda u: u <= 0.3),
    "more": (lambda u: u * u if u > 0.3 else u, lambda u: u > 0.3),
    "at least": (lambda u: u * u if u >= 0.3 else u, lambda u: u >= 0.3),
    "compared with an expression": (lambda u: u * u if 0.15 - u > 0.3 - 2.0 * u else u, lambda u: u > 0.15),
    "sign": (lambda u: np.sign(u - 0.3) * u, lambda u: u < 0.3),
    "copysign": (lambda u: math.copysign(u - 0.2, u + 0.3), lambda u: (u < 0.2, u < -0.3)),
    "maximum": (lambda u: np.maximum(u, 0.3) + u, lambda u: u < 0.3),
    "minimum": (lambda u: np.minimum(u, 0.3) + u, lambda u: u < 0.3),
    "clip": (lambda u: np.clip(u, -0.3, 0.4), lambda u: (u < -0.3, u > 0.4)),
    "heaviside": (lambda u: np.heaviside(u - 0.3, 0.5) * u, lambda u: u < 0.3),
}


@pytest.mark.parametrize("name", DECISIONS)
def test_a_path_holds_where_its_decisions_are_the_same(name):
    """It is the function there, and where it is not the path it does not say so."""
    function, decided = DECISIONS[name]
    points = np.random.default_rng(len(name)).uniform(-2.0, 2.0, 40)
    for at in points[:8]:
        path = Path(function, "u", 1, [float(at)])
        assert path.reason == ""
        holds = path.holds(points[:, None])
        same = np.array([decided(float(u)) == decided(float(at)) for u in points])
        # a path may be narrower than it need be where a decision does not matter to the outcome, but not wider
        assert (holds == same).all()
        curve = Contour(traced, 1, pool=path.tape().pool)
        for u in points[holds]:
            assert curve.point(float(u))[0] == pytest.approx(float(function(float(u))), abs=4e-15)


def test_equality_and_truth_are_decided_by_the_sign():
    for function, value in (
        (lambda u: 1.0 if u == 0.3 else 2.0, 2.0),
        (lambda u: 1.0 if u != 0.3 else 2.0, 1.0),
        (lambda u: 1.0 if u - 0.3 else 2.0, 1.0),
    ):
        path = Path(function, "u", 1, [0.5])
        assert path.tape().constants == (value,)
        assert path.holds(np.array([[0.4], [0.2]])).tolist() == [True, False]
    path = Path(lambda u: 1.0 if u == 0.3 else 2.0, "u", 1, [0.3])
    assert path.tape().constants == (1.0,)


def test_a_number_that_leaves_the_graph_makes_a_path_without_a_tape():
    path = Path(lambda u: math.gamma(u), "u", 1, [0.5])
    assert "compiled code" in path.reason
    assert path.checks == []


def test_what_of_numpy_is_no_function_of_a_parameter():
    for function, reason in (
        (lambda u: np.logaddexp.reduce(u), "np.logaddexp of a parameter"),
        (lambda u: np.logaddexp(u, [u, 1.0])[0], "np.logaddexp of a parameter"),
        (lambda u: np.cbrt(u), "compiled code"),
        (lambda u: np.linalg.norm(np.array([u, 1.0]), 1), "with options"),
        (lambda u: complex(u).real, "compiled code"),
        (lambda u: [1.0, 2.0][u], "indices must be integers"),
        (lambda u: u + "a", "str where a number was expected"),
    ):
        path = Path(function, "u", 1, [0.5])
        assert reason in path.reason
    # numbers that are none of a parameter stay what they are
    assert instructions(lambda u: np.cbrt(8.0) * u + np.linalg.norm(np.array([3.0, 4.0]), 1), "u", 1) == 1


ALGEBRA = {
    "sum of multiples": (lambda u, v: 2.0 * (3.0 * u - v) - 4.0 * (v - u), lambda u, v: 10.0 * u - 6.0 * v),
    "sign of a sum": (lambda u, v: -(2.0 * u + 3.0 * v) + 1.0, lambda u, v: 1.0 - 2.0 * u - 3.0 * v),
    "sign of a shift": (lambda u, v: -(2.0 * u + 3.0), lambda u, v: -2.0 * u - 3.0),
    "product of multiples": (lambda u, v: (2.0 * u) * (-3.0 * v), lambda u, v: -6.0 * u * v),
    "square of a multiple": (lambda u, v: (2.0 * u) * (-3.0 * u), lambda u, v: -6.0 * u * u),
    "what cancels": (lambda u, v: (u + v) - (u + v) + u / u, lambda u, v: 1.0),
    "quotients": (lambda u, v: u / 4.0 + 4.0 / (u + 3.0) - v / (u + 3.0), lambda u, v: u / 4 + (4 - v) / (u + 3)),
    "powers": (lambda u, v: (u + 3.0) ** 3 + 2.0**v + (u + 3.0) ** v, lambda u, v: (u + 3) ** 3 + 2**v + (u + 3) ** v),
    "roots": (lambda u, v: (u + 3.0) ** 0.5 + (u + 3.0) ** -1, lambda u, v: math.sqrt(u + 3) + 1 / (u + 3)),
    "least powers": (lambda u, v: u**0 + u**1 + u**2, lambda u, v: 1 + u + u * u),
    "norm": (lambda u, v: np.linalg.norm(np.array([u, v, 2.0])), lambda u, v: math.sqrt(u * u + v * v + 4)),
    "hypot of three": (lambda u, v: math.hypot(u, v, 2.0), lambda u, v: math.sqrt(u * u + v * v + 4)),
    "sum of many": (lambda u, v: math.fsum([u, v, 2.0, u]), lambda u, v: 2 * u + v + 2),
    "base": (lambda u, v: math.log(u + 3.0, v + 3.0), lambda u, v: math.log(u + 3) / math.log(v + 3)),
    "base of a number": (lambda u, v: math.log(5.0, v + 3.0), lambda u, v: math.log(5) / math.log(v + 3)),
    "angles": (lambda u, v: math.radians(u) + math.degrees(v), lambda u, v: u * math.pi / 180 + v * 180 / math.pi),
    "angle to a number": (lambda u, v: math.atan2(u, 2.0), lambda u, v: math.atan(u / 2)),
    "angle of a number": (lambda u, v: math.atan2(1.5, v), lambda u, v: math.pi / 2 - math.atan(v / 1.5)),
    "hypot with a number": (lambda u, v: math.hypot(u, 2.0), lambda u, v: math.sqrt(u * u + 4)),
    "arrays": (
        lambda u, v: (np.array([[1.0, u], [v, 2.0]]) @ np.array([u, 3.0]))[1] + np.ones(3)[0] * v + np.zeros(2)[1],
        lambda u, v: u * v + 6 + v,
    ),
    "element by element": (
        lambda u, v: np.sin(np.array([u, v])).sum() + np.exp(np.array([0.0, v])).sum(),
        lambda u, v: math.sin(u) + math.sin(v) + 1 + math.exp(v),
    ),
    "nothing of a parameter": (lambda u, v: 0.0 * u + 0.0 / (u + 9.0) + np.cos(0.5), lambda u, v: math.cos(0.5)),
}  # fmt: skip


@pytest.mark.parametrize("name", ALGEBRA)
def test_what_is_simplified_stays_the_same(name):
    function, expected = ALGEBRA[name]
    found = traced_tape(function, "uv", 1)
    surface = Contour(traced, 2, pool=found.pool)
    for u, v in np.random.default_rng(3).uniform(-1.5, 1.5, (10, 2)).tolist():
        assert surface.point((u, v))[0] == pytest.approx(expected(u, v), rel=4e-15, abs=4e-15)


# Fits.


def of_two(x, y):
    return np.array([math.exp(0.3 * x - 0.2 * y), x * y * y])


@pytest.mark.parametrize("given", [False, True])
def test_a_fit_is_the_function_with_its_derivatives(given):
    """Of one and of two arguments, on domains that are neither of size two nor around zero."""

    def wave(x):
        return np.array([math.sin(3.0 * x), math.exp(x)])

    def wave_derivatives(x):
        return np.array([[3 * math.cos(3 * x), math.exp(x)], [-9 * math.sin(3 * x), math.exp(x)]])

    def derivatives(x, y):
        e = math.exp(0.3 * x - 0.2 * y)
        return np.array([[0.3 * e, y * y], [-0.2 * e, 2 * x * y], [0.09 * e, 0], [-0.06 * e, 2 * y], [0.04 * e, 2 * x]])

    one = fit("test", wave, [(0.5, 1.2)], [False], wave_derivatives if given else None)
    assert one.error < 1e-14
    curve = Contour(fitted, 1, pool=one.pool)
    for x in np.linspace(0.5, 1.2, 23):
        rows = curve.evaluate(float(x))
        assert rows[0, :2] == pytest.approx(wave(x), abs=2e-14)
        # a rounding of the values, times the square of (2 / 0.35) 12^2
        assert rows[[1, 3], :2] == pytest.approx(wave_derivatives(x), abs=1e-9)
    two = fit("test", of_two, [(0.5, 1.2), (2.0, 5.0)], [False, False], derivatives if given else None)
    assert two.error < 1e-12
    surface = Contour(fitted, 2, pool=two.pool)
    for x, y in itertools.product(np.linspace(0.5, 1.2, 5), np.linspace(2.0, 5.0, 6)):
        rows = surface.evaluate((x, y))
        assert rows[0, :2] == pytest.approx(of_two(x, y), rel=1e-13)
        # values up to 30
        assert rows[[1, 2, 3, 4, 5], :2] == pytest.approx(derivatives(x, y), abs=3e-8)


def test_derivatives_that_are_given_improve_a_fit():
    """Second derivatives as good as those given: closer to them than those of values alone."""

    def wave(x):
        return np.array([math.sin(9.0 * x)])

    def derivatives(x):
        return np.array([[9 * math.cos(9 * x)], [-81 * math.sin(9 * x)]])

    off = []
    for given in (derivatives, None):
        curve = Contour(fitted, 1, pool=fit("test", wave, [(0.0, 1.0)], [False], given).pool)
        points = np.linspace(0.0, 1.0, 201)
        off.append(max(abs(curve.evaluate(float(x))[3, 0] + 81 * math.sin(9 * x)) for x in points))
        assert max(abs(curve.point(float(x))[0] - math.sin(9 * x)) for x in points) < 4e-15
    assert off[0] < 0.5 * off[1]


def test_points_at_which_a_fit_is_compared():
    """All over the domain without gaps or ends of pieces, some in each piece, and those that are asked for."""
    for lines in ([np.array([0.0, 0.25, 2.0])], [np.array([0.0, 0.25, 2.0]), np.array([-1.0, 0.999, 1.0])]):
        n = len(lines)
        places = np.full((1, n), 0.125)
        points, at = fits._points(lines, fits._boxes(lines), places)
        low, high = np.array([b[0] for b in lines]), np.array([b[-1] for b in lines])
        assert ((points >= low) & (points <= high)).all()
        assert points[-1] == pytest.approx(places[0])
        for b, x, i in zip(lines, points.T, at.T):
            assert ((b[i] <= x) & (x <= b[i + 1])).all()
            assert not np.isin(x[:-1], b).any()
        # no square of a twelfth of the domain without one, for 2000 points and more; every piece has four
        m = 12
        cells = np.floor((points - low) / (high - low) * m).astype(int)
        assert len({tuple(c) for c in np.minimum(cells, m - 1)}) == m**n
        pieces, counts = np.unique(at, axis=0, return_counts=True)
        assert len(pieces) == math.prod(len(b) - 1 for b in lines)
        assert counts.min() >= 4
    assert len(fits._points([np.array([0.0, 1.0])], fits._boxes([np.array([0.0, 1.0])]), None)[0]) == 2000 + 4
    # the last one of a domain is in its last piece
    line = [np.array([0.0, 0.5, 1.0])]
    at = fits._points(line, fits._boxes(line), np.array([[1.0], [0.5], [0.0]]))[1]
    assert at[-3:].ravel().tolist() == [1, 1, 0]


def test_first_pieces_begin_where_a_function_changes():
    def breaks(low, high, *known):
        return fits._first_breaks((low, high), known).tolist()

    assert breaks(0.0, 4.0) == [0.0, 2.0, 4.0]
    assert breaks(0.0, 4.0, 1.0, 3.0) == [0.0, 1.0, 3.0, 4.0]
    # not where pieces would be too short for second derivatives
    assert breaks(0.0, 4.0, 1.0, 1.0001) == [0.0, 2.0, 4.0]
    assert breaks(0.0, 4.0, 0.0001, 1.0) == [0.0, 1.0, 4.0]
    assert breaks(0.0, 4.0, 1.0, 3.9999) == [0.0, 1.0, 4.0]
    assert fits._refined(np.array([0.0, 1.0, 3.0]), {1}).tolist() == [0.0, 1.0, 2.0, 3.0]
    assert fits._refined(np.array([0.0, 1.0, 3.0]), {0, 1}).tolist() == [0.0, 0.5, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("function", "breaks", "message"),
    [
        # largest at an end of the other argument, up to the last node before it
        (lambda x, y: max(x - 0.25, 0.0) * (y + 2.0), ((0.25,), ()), r"first.* by (3.0|2.9)\S+ near \(0.25, 0.9"),
        (lambda x, y: max(y - 0.25, 0.0) * (x + 2.0), ((), (0.25,)), r"first.* by (3.0|2.9)\S+ near \(0.9\S*, 0.25"),
        (lambda x, y: (2.0 if y > 0.25 else 0.0) + x, ((), (0.25,)), r"the function jumps by 2.0e.00 near \(\S*, 0.25"),
        (lambda x, y: max(x - 0.25, 0) ** 2 * (2 - y), ((0.25,), ()), r"second.* by (6.0|5.9)\S+ near \(0.25, -0.9"),
    ],
)  # fmt: skip
def test_pieces_of_two_arguments_that_do_not_meet(function, breaks, message):
    def values(x, y):
        return np.array([1.0, function(x, y)])

    with pytest.raises(ContourError, match=message):
        fit("test", values, [(-1.0, 1.0), (-1.0, 1.0)], [False, False], breaks=breaks)


def test_seams_of_fits():
    """A saw tooth of value, slope and curvature is refused between its ends, where it is called periodic only."""
    for f, message in (
        (lambda x: x, r"the function jumps by 2.0e.00 between the ends of parameter 0, which is periodic, near \(1\)"),
        (lambda x: x * x, "its first derivative jumps by 4.0e.00 between the ends"),
        (lambda x: x**3 - x, "its second derivative jumps by 1.2e.01 between the ends"),
    ):
        fit("test", lambda x, f=f: np.array([f(x)]), [(-1.0, 1.0)], [False])
        with pytest.raises(ContourError, match=message):
            fit("test", lambda x, f=f: np.array([f(x)]), [(-1.0, 1.0)], [True])
    for axis in range(2):
        periodic = [i == axis for i in range(2)]
        with pytest.raises(ContourError, match=f"jumps by .* between the ends of parameter {axis}"):
            fit("test", lambda x, y: np.array([x * y + x + y]), [(-1.0, 1.0), (0.0, 3.0)], periodic)


def test_a_function_that_is_not_smooth_is_fitted_nowhere():
    with pytest.raises(ContourError, match=r"leaves an error of \S+ near \(0.3"):
        fit("test", lambda x: np.array([abs(x - 0.3)]), [(-1.0, 1.0)], [False])
    with pytest.raises(ContourError, match=r"leaves an error of \S+ near \(0.3.*, "):
        fit("test", lambda x, y: np.array([abs(x - 0.3)]), [(-1.0, 1.0), (0.0, 1.0)], [False, False])


# Formulas.


def test_how_many_arguments_a_function_has():
    for function, parameters, wanted in (
        (lambda u: u, 1, False),
        (lambda u, t: u, 1, True),
        (lambda u, v: u, 2, False),
        (lambda u, v, t: u, 2, True),
        (lambda u, t=0.0: u, 1, True),
        (lambda u, scale=1.0: u, 1, False),
        (lambda u, scale=1.0, t=0.0: u, 1, False),
        (lambda *u: u, 1, False),
        (math.sin, 1, False),
        (np.sin, 1, False),
    ):
        assert takes_time("test", function, parameters) == wanted
    for function, parameters in ((lambda: 0, 1), (lambda u: u, 2), (lambda u, v, t: u, 1)):
        with pytest.raises(ContourError, match="it takes"):
            takes_time("test", function, parameters)


def test_values_at_which_formulas_are_tried():
    domain = [(-math.inf, 5.0), (3.0, math.inf), (-math.inf, math.inf)]
    values = trials(domain)
    assert np.array_equal(values, trials(domain))
    assert values.shape[0] > 10
    for column, (low, high) in zip(values.T, [(2.0, 5.0), (3.0, 6.0), (-3.0, 3.0)]):
        assert low <= column.min() < low + 0.2 * (high - low)
        assert high - 0.2 * (high - low) < column.max() <= high


def test_points_are_spread_evenly():
    """No gap is much longer than that of a lattice, along each side."""
    for low, high in (([0.0], [1.0]), ([1.0, -2.0], [2.0, 3.0]), ([0.0, 0.0, 0.0], [1.0, 5.0, 0.1])):
        low, high = np.array(low), np.array(high)
        points = spread(low, high, 800)
        assert points.shape == (800, len(low))
        for axis in range(len(low)):
            along = np.sort(np.concatenate([[low[axis]], points[:, axis], [high[axis]]]))
            assert 0.0 < np.diff(along).max() < 8.0 * (high - low)[axis] / 800
        if len(low) == 2:
            counts = np.histogram2d(*points.T, bins=10, range=list(zip(low, high)))[0]
            assert counts.min() >= 5


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_surfaces_that_do_not_close(axis, order):
    """In value, first or second derivatives, at one place of the other parameter only."""

    def saw(x):
        return (x, x * x, x**3 - x)[order]

    def made(size, narrow):
        def f(u, v):
            x, y = (u, v) if axis == 0 else (v, u)
            bend = size * saw(x) * math.exp(-narrow * y * y)
            return math.cos(math.pi * x), math.sin(math.pi * x), y + bend

        domain = ((-1.0, 1.0), (-2.0, 2.0)) if axis == 0 else ((-2.0, 2.0), (-1.0, 1.0))
        return pc.ParametricSurface(f, domain, periodic=(axis == 0, axis == 1))

    name = "u1" if axis == 0 else "u2"
    what = ("but f is", f"derivative of f by {name} is", f"derivative of f by {name} and {name} is")[order]
    with pytest.raises(ContourError, match=f"periodic in parameter {axis}, .*{what}"):
        made(1e-4, 0.0)
    with pytest.raises(ContourError, match=f"periodic in parameter {axis}, "):
        made(1e-4, 40.0)
    made(0.0, 0.0)


# Profiles.


def test_which_way_a_revolution_faces():
    for profile, domain, hand in (
        (lambda s: (1.0 + 0.1 * s, s), (0.0, 1.0), 1.0),
        (lambda s: (1.0 + 0.1 * s, -s), (0.0, 1.0), -1.0),
        # flat: up, whichever way it is run along
        (lambda s: (1.0 + s, 0.0), (0.0, 1.0), -1.0),
        (lambda s: (2.0 - s, 0.0), (0.0, 1.0), 1.0),
    ):
        surface = pc.SurfaceOfRevolution(profile, domain)
        assert surface.shape[0] == hand
        rows = surface.evaluate((0.3, 0.5))
        normal = np.cross(rows[1], rows[2])
        outward = [math.cos(0.3), hand * math.sin(0.3), 0.0] if rows[2, 2] != 0.0 else [0.0, 0.0, 1.0]
        assert normal @ outward > 0.0


def test_which_revolutions_are_convex():
    def side(profile, low, high):
        return pc.SurfaceOfRevolution(profile, (low, high)).convex_side

    half = math.pi / 2
    assert side(lambda s: (math.cos(s), 2.0 * math.sin(s)), -half, half) == 1
    assert side(lambda s: (math.cos(s), -2.0 * math.sin(s)), -half, half) == 1
    assert side(lambda s: (math.cos(s) * (1.0 + 0.4 * math.cos(2 * s)), math.sin(s)), -half, half) == 1
    # a waist, inwards around the axis, and a dent in the profile
    assert side(lambda s: (math.cos(s) * (1.0 - 0.4 * math.cos(s) ** 2), math.sin(s)), -half, half) == 0
    assert side(lambda s: (1.0 + 0.1 * s * s, s), -1.0, 1.0) == 0
    assert side(lambda s: (1.0 - 0.1 * s * s, s), -1.0, 1.0) == 1
    # with a single pole there is an open end, whose other side is touched, too
    assert side(lambda s: (math.sin(s), -math.cos(s)), 0.0, 1.0) == 0


def test_a_cap_is_fitted_to_rounding_as_far_as_it_reaches():
    for profile, end, towards in (
        (lambda s: (math.sin(s), -math.cos(s)), 0.0, 1.0),
        (lambda s: (math.sin(3.0 - s) * 2.0, math.cosh(s - 3.0)), 3.0, -1.0),
    ):
        tape = traced_tape(profile, "u", 2)
        curve = Contour(traced, 1, pool=tape.pool)
        pool, reach = revolution._cap("test", curve, end, towards, 0.8, 1.0)
        cap = Contour(fitted, 1, pool=pool)
        assert 0.05**2 < reach < 0.8**2
        for d in np.linspace(0.0, 1.0, 21) * math.sqrt(reach):
            g, k = cap.point(d * d)[:2]
            r, z = profile(end + towards * d)
            # g is r / d, to a rounding of r
            assert d * g == pytest.approx(r, abs=4e-15)
            assert k == pytest.approx(z, abs=4e-15)
    # where a fit of all of it is not to rounding, it is of less
    steep = traced_tape(lambda s: (s / (1.0 + 40.0 * s * s), 1.0 / (1.0 + 40.0 * s * s)), "u", 2)
    steep = Contour(traced, 1, pool=steep.pool)
    pool, reach = revolution._cap("test", steep, 0.0, 1.0, 0.8, 1.0)
    assert 1e-4 < reach < 0.3**2
    cap = Contour(fitted, 1, pool=pool)
    for w in np.linspace(0.0, reach, 11):
        assert cap.point(w)[:2] == pytest.approx(np.full(2, 1.0 / (1.0 + 40.0 * w)), abs=2e-14)
    for profile, message in (
        (lambda s: (s, 0.5 * s), "apex.*dz/dr = 0.5"),
        (lambda s: (s + 0.1 * s * s, s * s), "r must be odd"),
        (lambda s: (s, s * s + 0.1 * s**3), "z even"),
        (lambda s: (s**3, s * s), "tangentially"),
    ):
        curve = Contour(traced, 1, pool=traced_tape(profile, "u", 2).pool)
        with pytest.raises(ContourError, match=message):
            revolution._cap("test", curve, 0.0, 1.0, 0.8, 1.0)


@pytest.mark.parametrize("ends", ["low", "high", "both", "closed"])
def test_a_profile_of_points_passes_them_and_the_axis(ends):
    """Points of a spheroid or a ring; where they reach the axis, r is odd and z even in the distance from there."""
    start, stop = {"low": (0.0, 2.0), "high": (1.0, math.pi), "both": (0.0, math.pi), "closed": (0.0, 0.0)}[ends]
    if ends == "closed":
        angles = 2 * math.pi * np.arange(24) / 24
        points = np.column_stack([2.0 + 0.5 * np.cos(angles), 0.5 * np.sin(angles)])
    else:
        angles = np.linspace(start, stop, 25)
        points = np.column_stack([np.sin(angles), -1.5 * np.cos(angles)])
        points[np.abs(points) < 1e-12] = 0.0
    surface = pc.SurfaceOfRevolution(points, periodic=ends == "closed")
    closed = np.concatenate([points, points[:1]]) if ends == "closed" else points
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    assert surface.domain[1] == pytest.approx((0.0, s[-1]), rel=1e-15)
    for length, (r, z) in zip(s, closed):
        assert surface.point((0.0, length)) == pytest.approx([r, 0.0, z], abs=1e-13)
    assert surface.charts == {"low": (0, 1), "high": (0, 2), "both": (0, 1, 2), "closed": (0,)}[ends]
    for chart in surface.charts[1:]:
        # a diameter of the cap is even in z and odd in r, with its derivatives
        for x in (0.02, 0.1):
            a, b = (surface.evaluate((sign * x, 0.0), chart=chart) for sign in (1.0, -1.0))
            assert a[0] == pytest.approx(b[0] * [-1.0, 1.0, 1.0], abs=1e-14)
            assert a[3] == pytest.approx(b[3] * [-1.0, 1.0, 1.0], abs=1e-10)
        # (z''/r'^2) of the spheroid at its pole, up to the interpolation: (pi / 24)^4 or so
        rows = surface.evaluate((0.0, 0.0), chart=chart)
        assert abs(rows[3, 2]) / (rows[1] @ rows[1]) == pytest.approx(1.5, rel=1e-3)


# Motions.


def rocking(t, wrong=None, by=0.0):
    c, s = math.cos(2.0 * t), math.sin(2.0 * t)
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    pose = pin.SE3(pin.exp3(0.7 * s * axis), np.array([0.3 * s, 0.2 * c, 0.1 * t**3]))
    velocity = np.array([0.6 * c, -0.4 * s, 0.3 * t * t, *(1.4 * c * axis)])
    acceleration = np.array([-1.2 * s, -0.8 * c, 0.6 * t, *(-2.8 * s * axis)])
    both = np.concatenate([velocity, acceleration])
    if wrong is not None:
        group = both[3 * (wrong // 3) : 3 * (wrong // 3) + 3]
        both[wrong] += by * np.abs(group).max()
    return pose, both[:6], both[6:]


@pytest.mark.parametrize("wrong", range(12))
def test_wrong_derivatives_of_a_motion_are_named(wrong):
    name = ("velocity", "angular velocity", "acceleration", "angular acceleration")[wrong // 3]
    with pytest.raises(ContourError, match=rf"CallableMotion: {name}\[{wrong % 3}\] of f\(0.137\)"):
        pc.CallableMotion(lambda t: rocking(t, wrong, 0.05))
    # half a percent may be what somebody rounds
    pc.CallableMotion(lambda t: rocking(t, wrong, 0.002))
    # they are compared within the times of interest
    with pytest.raises(ContourError, match=rf"{name}\[{wrong % 3}\] of f\(10.274"):
        pc.CallableMotion(lambda t: rocking(t, wrong, 0.05), time_domain=(10.0, 12.0))
    with pytest.raises(ContourError, match=rf"{name}\[{wrong % 3}\] of f\(11.236"):
        pc.CallableMotion(lambda t: rocking(t, wrong, 0.05 if t > 11.0 else 0.0), time_domain=(10.0, 12.0))


def test_a_harmonic_motion_in_closed_form():
    amplitude, frequency, phase = np.array([0.1, -0.2, 0.3]), 0.7, 0.4
    axis, angle, turn_frequency, turn_phase = np.array([2.0, -1.0, 2.0]), 0.8, 0.3, 1.1
    center = np.array([0.5, -0.4, 0.2])
    motion = pc.HarmonicMotion(amplitude, frequency, phase, axis, angle, turn_frequency, turn_phase, center)
    same = pc.HarmonicMotion(amplitude, frequency, phase, axis, angle, center=center)
    for t in (0.0, 0.3, 2.1):
        turn = angle * math.sin(2 * math.pi * turn_frequency * t + turn_phase)
        rotation = pin.exp3(turn * axis / 3.0)
        position = center - rotation @ center + amplitude * math.sin(2 * math.pi * frequency * t + phase)
        row = motion.evaluate(t)
        assert row[:9].reshape(3, 3) == pytest.approx(rotation, abs=1e-15)
        assert row[9:12] == pytest.approx(position, abs=1e-15)
        assert motion.placement(t).homogeneous[:3] == pytest.approx(np.column_stack([rotation, position]), abs=1e-15)
        # of the turn at the translation's frequency, from zero
        turn = angle * math.sin(2 * math.pi * frequency * t)
        assert same.evaluate(t)[:9].reshape(3, 3) == pytest.approx(pin.exp3(turn * axis / 3.0), abs=1e-15)
    still = pc.HarmonicMotion(amplitude)
    assert still.evaluate(0.25)[9:12] == pytest.approx(amplitude, rel=1e-15)
    assert still.evaluate(0.25)[:9].tolist() == np.eye(3).ravel().tolist()


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_poses_that_go_round_many_times_keep_their_rates(sense):
    """Signs of quaternions do not matter: a fit and a spline of a steady turn have its rate everywhere."""

    def steady(t):
        turn = pin.Quaternion(pin.exp3(np.array([0.0, 0.0, sense * t])))
        return pin.SE3(turn.matrix(), np.array([math.cos(t), 0.0, t]))

    fitted = pc.CallableMotion(steady, time_domain=(0.0, 14.0))
    splined = pc.SplineMotion(np.linspace(0.0, 14.0, 71), [steady(t) for t in np.linspace(0.0, 14.0, 71)])
    for t in np.linspace(0.05, 13.95, 40):
        expected = [-math.sin(t), 0.0, 1.0, 0.0, 0.0, sense]
        assert fitted.evaluate(t)[12:18] == pytest.approx(expected, abs=1e-10)
        # interpolation by degree 5 of steps of 0.2: 0.2^5 over some hundreds, more at the ends
        assert splined.evaluate(t)[12:18] == pytest.approx(expected, abs=1e-4)
    with pytest.raises(ContourError, match=r"poses 2 and 3 are 3.1\d+ rad apart"):
        turns = [0.0, 0.3, 0.6, 3.73, 4.0, 4.4, 4.8]
        pc.SplineMotion(np.arange(7.0), [steady(t) for t in turns])
    # far, but clear: 2.7 rad
    pc.SplineMotion(np.arange(7.0), [steady(t) for t in [0.0, 0.3, 0.6, 3.3, 4.0, 4.4, 4.8]])


def test_what_is_no_placement():
    good = np.eye(4)
    times = np.arange(7.0)
    for change, message in (
        ((0, 0, -1.0), "not a placement"),
        ((0, 1, 0.01), "rotation is off by 1.0e-02"),
        ((3, 0, 1e-3), "not a placement"),
        ((3, 3, 1.1), "not a placement"),
        ((0, 3, math.inf), "not finite"),
    ):
        bad = good.copy()
        bad[change[:2]] = change[2]
        with pytest.raises(ContourError, match=message):
            pc.SplineMotion(times, [good, good, bad, good, good, good, good])
    # six digits of a file will do, and come out orthogonal
    rounded = good.copy()
    rounded[:3, :3] = pin.exp3(np.array([0.3, 0.2, 0.1])).round(6)
    motion = pc.SplineMotion(times, [rounded] * 7)
    rotation = motion.placement(2.5).rotation
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-14)
    assert rotation == pytest.approx(rounded[:3, :3], abs=2e-6)


@pytest.mark.parametrize("begin", [0.0, 2.0])
def test_what_begins_as_a_point_is_a_contour_at_other_times(begin):
    """A ring, a sheet and a field of heights that grow; what is a point, or a line, at all times is none."""
    domain = (begin, begin + 3.0)

    def grown(t):
        return t - begin

    ring = pc.ParametricCurve(
        lambda u, t: (grown(t) * np.cos(u), grown(t) * np.sin(u), 0.0), (0.0, 2.0 * math.pi), True, time_domain=domain
    )
    sheet = pc.ParametricSurface(
        lambda u, v, t: (grown(t) * u, grown(t) * v, u * v), ((-1.0, 1.0),) * 2, time_domain=domain
    )
    assert ring.point(0.0, begin + 2.0) == pytest.approx([2.0, 0.0, 0.0], abs=1e-15)
    # half a diagonal of the square around it, at one of the times at which it was looked at
    assert 0.0 < ring.size < 3.0 * math.sqrt(2.0)
    assert 0.0 < sheet.size < 3.0 * math.sqrt(3.0)
    with pytest.raises(ContourError, match="f_1 vanishes all over"):
        pc.ParametricCurve(lambda u, t: (t, 0.0 * u, 1.0), (0.0, 1.0), time_domain=domain)
    with pytest.raises(ContourError, match="f_1 x f_2 vanishes all over"):
        pc.ParametricSurface(lambda u, v, t: (t * (u + v), u + v, 1.0), ((0.0, 1.0),) * 2, time_domain=domain)
    # one that is more than a point at the start has the size that it has then
    assert pc.ParametricCurve(lambda u, t: ((1.0 + t) * u, u, 0.0), (0.0, 1.0)).size == pytest.approx(math.sqrt(0.5))


def test_arrays_of_no_dimension_are_numbers():
    """Of a symbol or of a number, on either side of an operator."""
    for function, value in (
        (lambda u: u + np.asarray(u), 1.4),
        (lambda u: np.asarray(u, dtype=object) * u, 0.49),
        (lambda u: u - np.asarray(2.0), -1.3),
        (lambda u: np.sin(np.asarray(u)) / np.asarray(2), math.sin(0.7) / 2.0),
    ):
        tape = traced_tape(lambda u, function=function: (function(u), u, 0.0), "u", 3)
        assert Contour(traced, 1, pool=tape.pool).point(0.7)[0] == pytest.approx(value, rel=1e-15)
    with pytest.raises(Untraceable, match="list where a number was expected"):
        traced_tape(lambda u: operator.add(u, [1.0]), "u", 1)
