"""Bounds of formulas over boxes, and the search that they serve: where a function is smooth, which path it takes."""

import itertools
import math

import numpy as np
import pytest
from calling import from_python

import pincontact.contours as pc
from pincontact.contours import branches, tape
from pincontact.contours.branches import _beside_root, _between, _Search, survey
from pincontact.contours.enclosures import ORIGIN, SIGN, Interval, _away, is_end, is_risky, margins, of_one, of_two
from pincontact.contours.formula import Formula
from pincontact.contours.trace import RISK, Path
from pincontact.errors import ContourError

function_of_one = from_python(tape.function_of_one)
function_of_two = from_python(tape.function_of_two)

INF = math.inf


@pytest.fixture(autouse=True)
def quiet():
    """Bounds may be infinite: the package does not warn of that either."""
    with np.errstate(all="ignore"):
        yield


def interval(lo, hi):
    return Interval(np.array([float(lo)]), np.array([float(hi)]))


def ends(found):
    return float(found.lo[0]), float(found.hi[0])


# Where each function of one variable is looked at: on both sides of where it turns, if it does.
PLACES = {
    tape.SQUARE: (-1.0, 1.4),
    tape.INVERSE: (0.3, 2.0),
    tape.POWER_CONSTANT: (0.3, 2.0),
    tape.SQRT: (0.3, 2.0),
    tape.EXP: (-1.0, 1.4),
    tape.EXPM1: (-1.0, 1.4),
    tape.LOG: (0.3, 2.0),
    tape.LOG1P: (-0.6, 2.0),
    tape.TAN: (-1.2, 0.9),
    tape.ASIN: (-0.8, 0.6),
    tape.ATAN: (-1.0, 1.4),
    tape.SINH: (-1.0, 1.4),
    tape.COSH: (-1.0, 1.4),
    tape.TANH: (-1.0, 1.4),
    tape.ASINH: (-1.0, 1.4),
    tape.ACOSH: (1.2, 2.0),
    tape.ATANH: (-0.8, 0.6),
}


@pytest.mark.parametrize("op", PLACES)
def test_bounds_of_one_variable_are_the_range(op):
    """Neither less nor more than the least and largest of many samples, for values and slopes."""
    low, high = PLACES[op]
    generator = np.random.default_rng(3)
    exponents = (3.0, 2.0, 4.0, 1.5, 0.5, -1.0, -2.0, -0.5) if op == tape.POWER_CONSTANT else (1.5, -2.0)
    boxes = [(low, high), *np.sort(generator.uniform(low, high, (4, 2)), axis=1).tolist()]
    for c, (a, b) in itertools.product(exponents, boxes):
        found = of_one(op, c, interval(a, b))
        samples = np.array([function_of_one(op, float(x), c)[:2] for x in np.linspace(a, b, 51)])
        for bounds, column in zip(found, samples.T):
            # between samples, an extremum is missed by the square of their distance
            slack = 4e-3 * (b - a) ** 2 + 1e-12
            assert ends(bounds) == pytest.approx((column.min(), column.max()), abs=slack)
            assert bounds.lo[0] <= column.min() + 1e-13
            assert bounds.hi[0] >= column.max() - 1e-13


def test_whole_powers_of_either_sign():
    assert ends(interval(-2.0, 1.0).power(3.0)) == (-8.0, 1.0)
    assert ends(interval(-2.0, 1.0).power(4.0)) == (0.0, 16.0)
    assert ends(interval(-2.0, -1.0).power(-3.0)) == (-1.0, -0.125)
    assert ends(interval(-2.0, 1.0).power(-2.0)) == (-INF, INF)
    assert ends(interval(-2.0, 4.0).power(0.5)) == (0.0, 2.0)


@pytest.mark.parametrize("op", [tape.MULTIPLY, tape.DIVIDE, tape.ATAN2])
def test_bounds_of_two_variables_close_in_on_the_value(op):
    """They hold for all points of a box, and what they add to that shrinks with it."""
    generator = np.random.default_rng(4)
    for _ in range(6):
        x, y = generator.uniform(0.5, 2.0, 2)
        x, y = x * generator.choice([-1.0, 1.0]), y * (1.0 if op == tape.ATAN2 else generator.choice([-1.0, 1.0]))
        for width in (0.2, 1e-3, 1e-6):
            a, b = x - 0.4 * width, y - 0.3 * width
            found = of_two(op, interval(a, a + width), interval(b, b + width))
            points = [(a + i * width / 4, b + j * width / 4) for i in range(5) for j in range(5)]
            samples = np.array([function_of_two(op, *point)[:3] for point in points])
            for bounds, column in zip(found, samples.T):
                lo, hi = ends(bounds)
                assert lo <= column.min() + 1e-14
                assert hi >= column.max() - 1e-14
                # products of ranges know nothing of each other: each adds at most its own width times the other
                assert hi - lo <= np.ptp(column) + 20.0 * width
    # where the angle jumps, and where it has no value, nothing less than a turn
    for box in ((interval(-0.1, 0.1), interval(-1.0, -0.5)), (interval(-0.1, 0.1), interval(-0.1, 0.1))):
        assert ends(of_two(tape.ATAN2, *box)[0]) == (-math.pi, math.pi)
    assert ends(of_two(tape.ATAN2, interval(0.1, 1.0), interval(-1.0, 1.0))[0]) == pytest.approx(
        (math.atan2(0.1, 1.0), math.atan2(0.1, -1.0)), abs=1e-15
    )


def test_bounds_of_cosines():
    generator = np.random.default_rng(5)
    for _ in range(150):
        a = float(generator.uniform(-9.0, 9.0))
        b = a + float(generator.choice([0.01, 0.5, 2.0, 3.5, 5.0, 7.0]))
        samples = np.cos(np.linspace(a, b, 2001))
        # (7 / 2000)^2 / 8
        assert ends(interval(a, b).cosine()) == pytest.approx((samples.min(), samples.max()), abs=2e-6)
    for a, b in ((-INF, 1.0), (1.0, INF), (-INF, INF)):
        assert ends(interval(a, b).cosine()) == (-1.0, 1.0)


def test_arithmetic_of_bounds_with_unbounded_ends():
    assert ends(interval(0.0, 0.0) * interval(-INF, INF)) == (0.0, 0.0)
    assert ends(interval(0.0, 1.0) * interval(2.0, INF)) == (0.0, INF)
    assert ends(interval(-2.0, 3.0) * interval(-5.0, 4.0)) == (-15.0, 12.0)
    assert ends(interval(1.0, 2.0) + interval(-INF, 5.0)) == (-INF, 7.0)
    assert ends(Interval(np.array([math.nan]), np.array([math.nan]))) == (-INF, INF)
    assert ends(interval(1.0, 2.0).affine(-3.0, 1.0)) == (-5.0, -2.0)
    assert ends(interval(1.0, 2.0).affine(3.0, 1.0)) == (4.0, 7.0)
    assert ends(interval(1.0, 2.0).affine(0.0, 4.0)) == (4.0, 4.0)
    assert ends(interval(-3.0, 2.0).clipped(-1.0)) == (-1.0, 2.0)
    assert ends(interval(-3.0, 2.0).clipped(-1.0, 0.5)) == (-1.0, 0.5)
    assert ends(interval(-3.0, 2.0).meets(interval(-1.0, 9.0))) == (-1.0, 2.0)
    # which touch but for rounding
    assert ends(interval(0.0, 1.0).meets(interval(1.0 + 1e-15, 2.0))) == (1.0, 1.0 + 1e-15)
    assert ends(interval(-3.0, 2.0).absolute()) == (0.0, 3.0)
    assert ends(interval(-3.0, -2.0).absolute()) == (2.0, 3.0)
    assert ends(interval(-3.0, 2.0).square()) == (0.0, 9.0)
    assert float(interval(-3.0, 2.0).magnitude[0]) == 3.0
    assert [float(interval(*x).distance[0]) for x in ((2, 3), (-3, -2))] == [2.0, 2.0]
    assert float(interval(-3.0, 2.0).distance[0]) < 0.0
    assert ends(interval(2.0, 4.0).inverse()) == (0.25, 0.5)
    assert ends(interval(-4.0, -2.0).inverse()) == (-0.5, -0.25)
    for crossing in ((-1.0, 1.0), (0.0, 1.0), (-1.0, 0.0)):
        assert ends(interval(*crossing).inverse()) == (-INF, INF)


# Operation, constant, arguments at which it is smooth and how far from where it is not, arguments at which it is not.
MARGINS = [
    (SIGN, 1.0, [(0.3, 0.0, 0.3)], [(-0.3, 0.0)]),
    (SIGN, -1.0, [(-0.3, 0.0, 0.3)], [(0.3, 0.0)]),
    (tape.SQRT, 0.0, [(0.3, 0.0, 0.3)], [(0.0, 0.0), (-0.1, 0.0)]),
    (tape.LOG, 0.0, [(0.3, 0.0, 0.3)], [(0.0, 0.0), (-0.1, 0.0)]),
    (tape.POWER_CONSTANT, 1.5, [(0.3, 0.0, 0.3)], [(0.0, 0.0), (-0.1, 0.0)]),
    (tape.POWER_CONSTANT, -0.5, [(0.3, 0.0, 0.3)], [(0.0, 0.0), (-0.1, 0.0)]),
    (tape.POWER_CONSTANT, 2.5, [(0.3, 0.0, 0.3)], [(-0.1, 0.0)]),
    (tape.POWER_CONSTANT, -2.0, [(0.3, 0.0, 0.3), (-0.3, 0.0, 0.3)], [(0.0, 0.0)]),
    (tape.INVERSE, 5.0, [(0.3, 0.0, 0.3), (-0.3, 0.0, 0.3)], [(0.0, 0.0)]),
    (tape.LOG1P, 0.0, [(-0.7, 0.0, 0.3)], [(-1.0, 0.0), (-1.2, 0.0)]),
    (tape.ASIN, 0.0, [(0.7, 0.0, 0.3), (-0.7, 0.0, 0.3)], [(-1.0, 0.0), (1.0, 0.0), (1.2, 0.0), (-1.2, 0.0)]),
    (tape.ATANH, 0.0, [(0.7, 0.0, 0.3), (-0.7, 0.0, 0.3)], [(-1.0, 0.0), (1.0, 0.0), (1.2, 0.0), (-1.2, 0.0)]),
    (tape.ACOSH, 0.0, [(1.3, 0.0, 0.3)], [(1.0, 0.0), (0.8, 0.0)]),
    (tape.TAN, 0.0, [(0.0, 0.0, 1.0), (math.pi, 0.0, 1.0), (1.0, 0.0, math.cos(1.0))], []),
    (tape.ATAN2, 0.0, [(0.0, 0.3, 0.3), (0.3, -9.0, 0.3), (-0.3, -9.0, 0.3)], [(0.0, -0.3), (0.0, 0.0)]),
    (ORIGIN, 0.0, [(0.3, 0.0, 0.3), (0.1, -0.3, 0.3), (-0.3, 0.2, 0.3)], [(0.0, 0.0)]),
]


@pytest.mark.parametrize(("op", "c", "smooth", "rough"), MARGINS)
def test_margins_are_distances_from_where_a_function_is_not_smooth(op, c, smooth, rough):
    for x, y, margin in smooth:
        assert float(_away(op, c, interval(x, x), interval(y, y))[0]) == pytest.approx(margin, abs=1e-15)
        # a box is as near as its nearest point
        box = interval(x - 0.05, x + 0.05), interval(y - 0.05, y + 0.05)
        corners = [
            float(_away(op, c, interval(a, a), interval(b, b))[0])
            for a in np.linspace(x - 0.05, x + 0.05, 5)
            for b in np.linspace(y - 0.05, y + 0.05, 5)
        ]
        assert float(_away(op, c, *box)[0]) == pytest.approx(min(corners), abs=1e-15)
    for x, y in rough:
        assert float(_away(op, c, interval(x, x), interval(y, y))[0]) <= 0.0
        # nor is a box with such a point inside
        assert float(_away(op, c, interval(x - 0.1, x + 0.1), interval(y - 0.1, y + 0.1))[0]) <= 0.0
    if op == tape.TAN:
        assert float(_away(op, c, interval(1.5, 1.6), interval(0.0, 0.0))[0]) <= 0.0
    if op >= tape.SQUARE:
        whole = c == round(c) and c > 0.0 and op == tape.POWER_CONSTANT
        assert is_risky(op, c) == (not whole)


def test_what_is_risky_and_what_has_an_end():
    for op in (tape.EXP, tape.SINH, tape.COSH, tape.TANH, tape.ATAN, tape.ASINH, tape.SQUARE):
        assert not is_risky(op, 0.0)
        assert not is_end(op, 0.0)
    for c in (2.0, 3.0):
        assert not is_risky(tape.POWER_CONSTANT, c)
    for c in (2.5, -1.5):
        assert is_end(tape.POWER_CONSTANT, c)
    assert not is_end(tape.POWER_CONSTANT, -2.0)
    for op in (tape.SQRT, tape.LOG, tape.LOG1P, tape.ASIN, tape.ACOSH, tape.ATANH):
        assert is_end(op, 0.0)
    for op in (tape.INVERSE, tape.TAN, tape.ATAN2, ORIGIN):
        assert not is_end(op, 0.0)


FORMULAS = [
    lambda u, v: (3.0 + u * v) ** (u - v) + v / (u + 4.0),
    lambda u, v: math.sqrt(2.0 + math.sin(u) * v - 0.3 * u),
    lambda u, v: 1.0 / (3.0 - u * math.cos(v) + math.exp(0.2 * u)),
    lambda u, v: math.log(3.0 + u - v * v / 4.0),
    lambda u, v: math.hypot(u - 3.0, 2.0 * v),
    lambda u, v: math.sqrt(5.0 + math.tanh(u) + v / (3.0 + u)),
]


@pytest.mark.parametrize("number", range(len(FORMULAS)))
def test_margins_of_formulas_over_boxes(number):
    """Bounds of a check's margin and of its slopes hold for all points of the box; those of the margin are off by the
    square of the box's size only."""
    path = Path(FORMULAS[number], "uv", 1, [0.1, 0.2])
    checks = [check for check, kind in zip(path.checks, path.kinds) if kind == RISK]
    assert checks
    order = path.graph.reachable([index for check in checks for index in check[1:3]])

    def at(u, v):
        point = np.array([[u, v]])
        return margins(path.graph.nodes, order, checks, "uv", point, point, point)

    generator = np.random.default_rng(number)
    for width in (0.5, 0.05, 0.005):
        low = generator.uniform(-1.0, 0.5, (3, 2))
        high = low + width * generator.uniform(0.5, 1.0, (3, 2))
        inside = low + 0.4 * (high - low)
        least, there, slopes = margins(path.graph.nodes, order, checks, "uv", low, high, inside)
        assert least.shape == there.shape == (len(checks), 3)
        assert slopes.shape == (len(checks), 3, 2, 2, 2)
        for box in range(3):
            points = list(itertools.product(*(np.linspace(low[box, i], high[box, i], 5) for i in range(2))))
            found = np.array([at(*point)[1][:, 0] for point in points])
            # as the least of many samples, but for what is quadratic in the size
            assert (least[:, box] <= found.min(axis=0) + 1e-14).all()
            assert (least[:, box] >= found.min(axis=0) - 3.0 * width**2).all()
            assert there[:, box] == pytest.approx(at(*inside[box])[1][:, 0], abs=1e-15)
            h = 1e-6
            for k, (_, first, second, _) in enumerate(checks):
                for argument, index in enumerate((first, second)):
                    for i in range(2):
                        for u, v in points[::6]:
                            step = h * np.eye(2)[i]
                            ahead, behind = (
                                path_value(path, order, index, u + s * step[0], v + s * step[1]) for s in (1, -1)
                            )
                            slope = (ahead - behind) / (2 * h)
                            lo, hi = slopes[k, box, i, argument]
                            # 1e-16 / h of rounding
                            assert lo - 1e-8 <= slope <= hi + 1e-8
                            assert hi - lo <= 10.0 * width


def path_value(path, order, index, u, v):
    return float(path.values(np.array([[u, v]]), order)[index].lo[0])


# The search.


def test_places_between_ends_that_may_be_infinite():
    """Part of the way; without ends, 0, 1, 3, 7... further and further out."""
    one = np.array([1.0])
    assert _between(-one, 3 * one, 0.25) == pytest.approx([0.0], abs=1e-15)
    assert _between(-one, 3 * one, 0.5) == [1.0]
    inf = np.array([INF])
    for ends_, wanted in (((-inf, inf), 0.0), ((0 * one, inf), 1.0), ((one, inf), 3.0), ((3 * one, inf), 7.0)):
        assert _between(*ends_, 0.5) == [wanted]
        low, high = ends_
        for part in (0.1, 0.4637, 0.9):
            assert low < _between(low, high, part) < high
    assert _between(-inf, 0 * one, 0.5) == [-1.0]
    assert _between(-inf, -one, 0.5) == [-3.0]
    assert _between(-5 * one, inf, 0.5) == [1.0]
    # another part is another place
    assert _between(-inf, inf, 0.4) != _between(-inf, inf, 0.5)
    assert _between(one, inf, 0.4) != _between(one, inf, 0.5)


def test_a_cut_beside_a_root():
    """The root is on the wanted side, nearby, whatever the slope is within its bounds."""
    generator = np.random.default_rng(6)
    for _ in range(300):
        low, width = float(generator.uniform(-2.0, 2.0)), float(generator.choice([1e-6, 0.1, 2.0]))
        high, tiny = low + width, 1e-9 * width
        slope = float(generator.uniform(0.3, 3.0) * generator.choice([-1.0, 1.0]))
        spread = abs(slope) * float(generator.choice([0.0, 1e-4, 0.02]))
        root = low + width * float(generator.uniform(0.2, 0.8))
        x = low + width * float(generator.uniform(0.3, 0.6))
        found = _beside_root(low, high, (x, slope * (x - root), slope - spread, slope + spread), tiny, 99.0)
        assert low < found < high
        # the root is known up to (x - root) spread / slope; the cut is clear of that, and no farther than is needed
        doubt = 0.4 * tiny + 4.0 * width * spread / abs(slope)
        known = abs(x - root) * spread / abs(slope)
        assert known < root - found <= 1.01 * doubt + 1e-15
    # from a box that begins there, the other side
    first = _beside_root(0.0, 1.0, (0.3, -0.2, 1.0, 1.0), 1e-6, 99.0)
    second = _beside_root(first, 1.0, (0.6, 0.1, 1.0, 1.0), 1e-6, 99.0)
    assert first < 0.5 < second < 0.5 + 1e-6
    # no root inside, a slope that may be zero, too uncertain, or without bounds
    for line in (
        (0.5, 3.0, 1.0, 1.0),
        (0.5, -3.0, 1.0, 1.0),
        (0.5, 0.1, -1.0, 1.0),
        (0.5, 0.1, 0.0, 1.0),
        (0.5, 0.1, 1.0, 1.2),
        (0.5, 0.1, 1.0, INF),
        (0.5, 0.1, -INF, 1.0),
    ):
        assert _beside_root(0.0, 1.0, line, 1e-9, 99.0) == 99.0
    assert _beside_root(0.0, INF, (0.5, 0.1, 1.0, 1.0), 1e-9, 99.0) == 99.0


def searched(f, domain):
    search = _Search(Formula("test", f, len(domain), 1), domain, False)
    search.run()
    return search


# A function of one or two parameters, its domain, where it changes for each of them, and how many boxes are enough.
BRANCHING = [
    (lambda u: abs(u - 0.3), ((-1.0, 1.0),), [[0.3]], 8),
    (lambda u: abs(u), ((-1.0, 2.0),), [[0.0]], 8),
    (lambda u: abs(u) + abs(u - 0.7), ((-1.0, 2.0),), [[0.0, 0.7]], 16),
    (lambda u: abs(math.sin(u) - 0.2), ((0.0, 2.0),), [[math.asin(0.2)]], 24),
    (lambda u: u if u < 5.0 else 2.0 * u - 5.0, ((0.0, INF),), [[5.0]], 60),
    (lambda u, v: max(u, 0.2) * v, ((-1.0, 1.0), (0.0, 3.0)), [[0.2], []], 8),
    (lambda u, v: abs(v + 0.4) * (u + 2.0), ((-1.0, 1.0), (-3.0, 3.0)), [[], [-0.4]], 8),
    (lambda u, v: abs(v + 0.4) * abs(u - 0.1), ((-1.0, 1.0), (-3.0, 3.0)), [[0.1], [-0.4]], 40),
]


@pytest.mark.parametrize(("f", "domain", "changes", "enough"), BRANCHING)
def test_the_domain_is_cut_into_boxes_of_one_path_each(f, domain, changes, enough):
    search = searched(f, domain)
    assert not search.single
    assert not len(search.boxes)
    # all of it, once: the parts of lengths add up, and random points are in one box each
    boxes = [*((a, b) for _, a, b in search.cells), *search.edges]
    assert len(boxes) <= enough
    generator = np.random.default_rng(7)
    far = np.minimum(search.end, 50.0)
    points = generator.uniform(search.start, far, (100, len(domain)))
    for point in points:
        assert sum(((a <= point) & (point <= b)).all() for a, b in boxes) == 1
    if np.isfinite(domain).all():
        assert sum(np.prod(b - a) for a, b in boxes) == pytest.approx(np.prod(search.end - search.start), rel=1e-12)
    for number, a, b in search.cells:
        inside = generator.uniform(a, np.minimum(b, np.maximum(a + 1.0, 50.0)), (5, len(domain)))
        assert search.paths[number].holds(inside).all()
    for a, b in search.edges:
        assert ((b - a) <= 2.0 * branches._TINY * search.size).any()
        assert (b > a).all()
    # where paths change, to rounding
    found = search.breaks()
    assert [len(places) for places in found] == [len(places) for places in changes]
    for places, wanted in zip(found, changes):
        # the last halving is of a rounding of the domain's length, or of the place's own
        assert places == pytest.approx(wanted, rel=3e-16, abs=3e-16 * float(search.size.max()))
    # paths are looked at on both sides of that, in a finite domain
    places = search.places()
    if not np.isfinite(domain).all():
        assert places.shape == (0, len(domain))
        return
    assert ((places >= search.start) & (places <= search.end)).all()
    numbers = search._path_of(places, np.zeros(len(places), dtype=int))
    assert set(numbers) == set(range(len(search.paths)))
    for axis, wanted in enumerate(changes):
        for x in wanted:
            apart = places[:, axis] - x
            near = np.abs(apart) <= 10.0 * branches._TINY * search.size[axis]
            assert (apart[near] > 0.0).any()
            assert (apart[near] < 0.0).any()
    # and in the largest boxes of each, whose middles are farther away than that
    for number in range(len(search.paths)):
        largest = max((b - a)[0] for path, a, b in search.cells if path == number)
        mine = [(a, b) for path, a, b in search.cells if path == number and (b - a)[0] == largest]
        assert any(((p > a) & (p < b)).all() for p in places for a, b in mine)


# Smooth functions, their domains and how many boxes are enough to prove it: one where bounds are sharp.
PROVED = [
    (lambda u: math.sqrt(u * u + 1e-4), ((-1.0, 1.0),), 1),
    (lambda u: math.sqrt(1.0 - u * u), ((-1.0, 1.0),), 1),
    (lambda u: math.asin(0.999 * math.sin(u)), ((0.0, 6.0),), 1),
    (lambda u: 1.0 / (1.1 + math.sin(u)), ((0.0, 20.0),), 1),
    (lambda u: 1.0 / (u + 1.0), ((0.0, INF),), 1),
    (lambda u: 1.0 / (1.0 - u), ((-INF, 0.0),), 1),
    (lambda u: abs(u * u + 0.001), ((-1.0, 1.0),), 1),
    (lambda u: math.log(1.0 + u * u - u), ((-INF, INF),), 24),
    (lambda u: math.sqrt(4.0 + u * u * u - 3.0 * u), ((-2.0, 2.0),), 30),
    (lambda u: math.cos(math.atan2(u - 0.3, -1.0)), ((-1.0, 1.0),), 14),
    (lambda u, v: math.sqrt(u * u + v * v + 1e-2), ((-1.0, 1.0), (-2.0, 3.0)), 1),
    (lambda u, v: math.sqrt(1.0 + u) * v, ((-1.0, 1.0), (-2.0, 3.0)), 1),
    (lambda u, v: u + v if u * u + v * v > -0.01 else 0.0, ((-1.0, 1.0), (-1.0, 2.0)), 1),
    (lambda u, v: 1.0 / (1.5 + u * v - u + v), ((-0.5, 1.0), (0.0, 1.0)), 30),
    (lambda u, v: math.cos(math.atan2(v - 0.3, -1.0 - u * u)), ((-1.0, 1.0), (-1.0, 2.0)), 1200),
]


@pytest.mark.parametrize(("f", "domain", "enough"), PROVED)
def test_smooth_functions_are_proved_so_box_by_box(f, domain, enough):
    search = searched(f, domain)
    assert search.single
    assert search.paths[0].checks
    assert search.edges == []
    assert len(search.boxes) == 0
    assert len(search.cells) <= enough
    generator = np.random.default_rng(8)
    points = generator.uniform(np.maximum(search.start, -50.0), np.minimum(search.end, 50.0), (50, len(domain)))
    low, high = (np.array([cell[1 + i] for cell in search.cells]) for i in range(2))
    for point in points:
        assert ((low <= point) & (point <= high)).all(axis=1).sum() == 1
    # angles may jump in boxes that are narrow only, or where many have been seen
    for a, b in np.array(search.cuts).reshape(-1, 2, len(domain))[:50]:
        assert ((b - a) <= branches._CUT_WIDTH * search.size).any()


def test_what_is_known_of_a_function_before_it_is_compiled():
    def known(f, *domain, parameters=1, all_times=False):
        return survey(Formula("test", f, parameters, 1), domain, all_times)

    smooth = known(lambda u: math.sin(u), (-1.0, 1.0))
    assert smooth.tape is not None
    assert (smooth.reason, smooth.breaks, smooth.times, len(smooth.places)) == ("", [[]], (-INF, INF), 0)
    bent = known(lambda u: abs(u - 0.25), (-1.0, 1.0))
    assert bent.tape is None
    assert bent.reason == "it branches at u = 0.25"
    both = known(lambda u, v: abs(u - 0.25) * abs(v - 0.5), (-1.0, 1.0), (0.0, 1.0), parameters=2)
    assert both.reason == "it branches at u1 = 0.25, u2 = 0.5"
    blind = known(lambda u: complex(u).real, (-1.0, 1.0))
    assert "compiled code" in blind.reason
    many = known(lambda u: abs(math.floor(200.0 * u)), (-1.0, 1.0))
    assert many.tape is None
    assert "branches" in many.reason
    with pytest.raises(ContourError, match=r"test: not smooth near u = 0.25: f takes the square root"):
        known(lambda u: math.sqrt((u - 0.25) ** 2), (-1.0, 1.0))
    with pytest.raises(ContourError, match=r"near u1 = .*, u2 = .*denominator"):
        known(lambda u, v: 1.0 / (u - v), (-1.0, 1.0), (-1.0, 1.0), parameters=2)


def test_times_for_which_a_formula_is_good():
    def times(f, first=0.0, last=3.0, all_times=True):
        return survey(Formula("test", f, 1, 1), ((-1.0, 1.0), (first, last)), all_times).times

    # without anything that might be rough, all; with something, those that were looked at
    assert times(lambda u, t: u * math.sin(t)) == (-INF, INF)
    assert times(lambda u, t: u / (1.0 + t * t)) == (-INF, INF)
    assert times(lambda u, t: u / (1.0 + t * t), all_times=False) == (0.0, 3.0)
    # before another branch it is another function
    for f, wanted in (
        (lambda u, t: u + abs(t + 5.0), -5.0),
        (lambda u, t: u * max(t, -0.5), -0.5),
        (lambda u, t: abs(t + 2.0 + 0.5 * u), -1.5),
        (lambda u, t: abs(t + 2.0) * abs(t + 4.0), -2.0),
    ):
        first, last = times(f)
        assert wanted <= first < wanted + 0.01
        assert last == INF
    # what has no value later, or earlier, is no other shape
    for f in (lambda u, t: u * math.sqrt(5.0 - t), lambda u, t: u * math.sqrt(t + 5.0)):
        assert times(f)[1] == INF
    # a pole, a kink and a jump to come are mistakes
    for f, match in (
        (lambda u, t: u / (t - 5.0), "t = 5: .*denominator"),
        (lambda u, t: u * math.hypot(t - 5.0, 0.0), "t = 5: .*square root"),
    ):
        with pytest.raises(ContourError, match=match):
            times(f)
    late = survey(Formula("test", lambda u, t: u + abs(t - 5.0), 1, 1), ((-1.0, 1.0), (0.0, 3.0)), True)
    assert late.tape is None
    assert late.reason.startswith("it branches at t = 5")


@pytest.mark.parametrize("c", [0.3, -0.7])
def test_angles_may_jump_where_nothing_else_does(c):
    domain = (-1.0, 1.0)

    def made(f, **options):
        return pc.ParametricCurve(lambda u: (u, f(u), 0.0), domain, **options)

    for f in (
        lambda u: math.cos(math.atan2(u - c, -1.0)),
        lambda u: math.sin(3.0 * math.atan2(u - c, -2.0)),
        lambda u: math.exp(math.sin(math.atan2(c - u, -1.0))),
    ):
        curve = made(f)
        for u in (c - 1e-3, c + 1e-3, 0.9, -0.9):
            assert curve.point(u)[1] == pytest.approx(f(u), abs=1e-14)
    for f, jump in (
        (lambda u: math.atan2(u - c, -1.0), "f jumps by 6.28e"),
        (lambda u: math.cos(0.5 * math.atan2(u - c, -1.0)), r"f jumps by \S+ and its derivatives by up to 1.00e.00"),
        (lambda u: math.sin(1.5 * math.atan2(u - c, -1.0)), "f jumps by 2.00e"),
    ):
        with pytest.raises(ContourError, match=f"near u = {c}: {jump}"):
            made(f)
    # in a surface, across one of its parameters, and in time
    with pytest.raises(ContourError, match=r"u2 = .*f jumps by 6.28"):
        pc.ParametricSurface(lambda u, v: (u, v, math.atan2(v - c, -2.0 - u)), (domain, domain))
    with pytest.raises(ContourError, match=r"t = 1.*f jumps by 6.28"):
        pc.ParametricCurve(lambda u, t: (u, math.atan2(t - 1.0, -2.0 - u), 0.0), domain)
    surface = pc.ParametricSurface(lambda u, v: (u, v, math.cos(math.atan2(v - c, -2.0 - u))), (domain, domain))
    assert surface.point((0.2, c + 0.01))[2] == pytest.approx(math.cos(math.atan2(0.01, -2.2)), abs=1e-15)


@pytest.mark.parametrize(("factor", "lo", "hi"), [(0.3, 1.3, 1.6), (-0.3, 0.4, 0.7), (2.0, 3.0, 5.0), (0.0, 1.0, 1.0)])
def test_intervals_of_affine_functions(factor, lo, hi):
    found = Interval(np.array([1.0]), np.array([2.0])).affine(factor, 1.0)
    assert (found.lo[0], found.hi[0]) == pytest.approx((lo, hi), abs=1e-15)
