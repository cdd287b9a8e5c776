"""Parts of contours, each looked at alone: meshes, charts, tapes, splines."""

import itertools
import math
from collections import Counter

import numpy as np
import pytest
from calling import from_python, instructions, traced_tape
from scipy.interpolate import BSpline

import pincontact.contours as pc
from pincontact.contours import charts, piecewise, tape
from pincontact.contours.base import F_1, F_2, F, half_diagonal, turning
from pincontact.contours.periods import wrapped
from pincontact.contours.piecewise import Direction, chebyshev_nodes, fitted, pack
from pincontact.errors import ContourError

turned_back = from_python(charts.turned_back)
is_across_pole = from_python(charts.is_across_pole)
preferred_chart = from_python(charts.preferred_chart)
convert_chart = from_python(charts.convert_chart)
function_of_one = from_python(tape.function_of_one)
function_of_two = from_python(tape.function_of_two)
wrapped_ = from_python(wrapped)

QUARTER = math.pi / 2


# Meshes and what is known of a shape.


def edges(faces):
    """How often each edge is run along, by its direction."""
    return Counter((int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1)))


def area_and_volume(vertices, faces):
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    return 0.5 * np.linalg.norm(across, axis=1).sum(), np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def test_a_closed_mesh_has_each_edge_once_in_each_direction():
    vertices, faces = pc.Torus(2.0, 0.5).mesh((7, 5))
    assert vertices.shape == (35, 3)
    assert len(faces) == 70
    found = edges(faces)
    assert set(found.values()) == {1}
    assert {(b, a) for a, b in found} == set(found)
    # of the tube's pentagons: the seventh part of a turn each, by Pappus' rule for prisms between planes
    volume = area_and_volume(vertices, faces)[1]
    pentagon = 2.5 * 0.25 * math.sin(2 * math.pi / 5)
    wedge = 7 * math.sin(2 * math.pi / 7)
    exact = wedge * 2.0 * pentagon
    # the two triangles of a quadrilateral that is not flat fold in or out by a few parts in a hundred
    assert volume == pytest.approx(exact, rel=0.05)


@pytest.mark.parametrize(
    ("contour", "n", "window", "across", "along"),
    [
        (pc.Cylinder(0.5), (9, 4), (None, (0.0, 3.0)), 1, 2 * 9),
        (pc.Cylinder(0.5), (9, 4), ((0.0, 1.0), (0.0, 3.0)), 0, 2 * (8 + 3)),
        (pc.Plane(), (4, 6), ((0.0, 2.0), (1.0, 4.0)), 0, 2 * (3 + 5)),
    ],
)
def test_an_open_mesh_ends_at_its_window(contour, n, window, across, along):
    vertices, faces = contour.mesh(n, window)
    grid = (n[0] - 1 + across) * (n[1] - 1)
    assert len(faces) == 2 * grid
    found = edges(faces)
    assert set(found.values()) == {1}
    assert sum((b, a) not in found for a, b in found) == along
    low, high = window[1]
    start, end = window[0] or (-math.pi, math.pi)
    width = 2.0 * 0.5 * math.sin((end - start) / (n[0] - 1 + across) / 2.0) if contour.kind != pc.Plane().kind else 0.0
    exact = width * (n[0] - 1 + across) * (high - low) if width else (end - start) * (high - low)
    assert area_and_volume(vertices, faces)[0] == pytest.approx(exact, rel=1e-13)
    for face in faces[:: max(1, len(faces) // 7)]:
        a, b, c = vertices[face]
        outward = (a + b + c) * (1.0, 1.0, 0.0) if contour.kind != pc.Plane().kind else np.array([0.0, 0.0, 1.0])
        assert np.cross(b - a, c - a) @ outward > 0.0


def test_windows_are_cut_to_the_domain_unless_it_wraps():
    arc = pc.Circle(1.0, (0.0, 2.0))
    assert arc.samples(3, ((-5.0, 1.0),)).ravel().tolist() == [0.0, 0.5, 1.0]
    assert arc.samples(3, ((1.0, 9.0),)).ravel().tolist() == [1.0, 1.5, 2.0]
    assert pc.Circle(1.0).samples(3, ((4.0, 8.0),)).ravel().tolist() == [4.0, 6.0, 8.0]
    assert pc.Circle(1.0).polyline(5)[:, 0] == pytest.approx([-1.0, 0.0, 1.0, 0.0, -1.0], abs=1e-15)
    with pytest.raises(ContourError, match="runs over"):
        arc.samples(3, ((3.0, 4.0),))
    for bad in (1, 0, (2, 2), 2.5):
        with pytest.raises(ContourError, match="at least 2"):
            arc.samples(bad)
    assert len(arc.samples((2,))) == 2


def flower(lobes, depth):
    """A closed curve around the origin whose radius goes up and down."""
    return pc.ParametricCurve(
        lambda u: (
            (1.0 + depth * math.cos(lobes * u)) * math.cos(u),
            (1.0 + depth * math.cos(lobes * u)) * math.sin(u),
            0.0,
        ),
        (0.0, 2 * math.pi),
        periodic=True,
    )


def harmonics(*rows):
    cosine, sine = np.zeros((4, 2)), np.zeros((4, 2))
    for k, size, sense in rows:
        cosine[k, 0], sine[k, 1] = size, sense * size
    return pc.FourierCurve(cosine, sine)


def test_the_sense_in_which_a_curve_is_convex():
    assert turning(harmonics((1, 0.3, 1))) == 1
    assert turning(harmonics((1, 0.3, -1))) == -1
    # twice around, and three times
    assert turning(harmonics((2, 0.3, 1))) == 0
    assert turning(harmonics((3, 0.3, -1))) == 0
    # r = 1 + d cos(3 u) bends in where (1 + d)^2 ... at its hollows: r^2 + 2 r'^2 - r r'' < 0, for d > 1 / 10
    assert flower(3, 0.09).convex_side == 1
    assert flower(3, 0.11).convex_side == 0
    # a figure eight turns by nothing
    eight = pc.FourierCurve([[0, 0], [1, 0], [0, 0]], [[0, 0], [0, 0], [0, 1]])
    assert turning(eight) == 0
    # an arc does not close, a space curve is in no plane, and what changes with time is not known
    assert turning(pc.Circle(1.0, (0.0, 3.0))) == 0
    assert turning(pc.FourierCurve([[0, 0, 0], [1, 0, 0.1]], [[0, 0, 0], [0, 1, 0]])) == 0
    # a cusp has no tangent: the cardioid's
    cardioid = pc.FourierCurve([[0, 0], [2, 0], [-1, 0]], [[0, 0], [0, 2], [0, -1]])
    assert turning(cardioid) == 0


def test_arcs_and_turns():
    turn = 2.0 * math.pi
    for low, high, closed in (
        (0.0, turn, True),
        (-math.pi, math.pi, True),
        (10.0 * math.pi, 12.0 * math.pi, True),
        (0.0, turn - 1e-9, False),
        (1.0, 2.0, False),
    ):
        for curve in (pc.Circle(0.3, (low, high)), pc.Ellipse(0.3, 0.2, (low, high))):
            assert (curve.periodic, curve.convex_side) == ((closed,), int(closed))
            assert curve.domain == ((low, high),)
        around = pc.Cylinder(0.3, ((low, high), None))
        assert (around.periodic, around.convex_side) == ((closed, False), int(closed))
    for build in (pc.Circle, lambda *x: pc.Ellipse(0.3, *x), lambda r, d: pc.Cylinder(r, (d, None))):
        with pytest.raises(ContourError, match="must not exceed one turn"):
            build(0.3, (0.0, turn + 1e-9))
    # there and back along a line: some coefficient is enough
    for cosine, sine in (([0, 1], [0, 0]), ([0, 0], [0, 1])):
        curve = pc.FourierCurve(np.outer(cosine, [1, 2]), np.outer(sine, [1, 2]))
        along = cosine[1] * math.cos(0.3) + sine[1] * math.sin(0.3)
        assert curve.point(0.3) == pytest.approx([along, 2.0 * along, 0.0], rel=1e-15)
    with pytest.raises(ContourError, match="beyond the constant one are zero"):
        pc.FourierCurve([[1, 2], [0, 0]], [[0, 0], [0, 0]])


def test_half_the_diagonal_of_the_box():
    # ends and quarter turns are among the samples: exact boxes
    assert half_diagonal(pc.Line((-1.0, 2.0))) == pytest.approx(1.5, rel=1e-15)
    assert half_diagonal(pc.Plane(((0.0, 3.0), (1.0, 5.0)))) == pytest.approx(2.5, rel=1e-15)
    assert half_diagonal(pc.Circle(2.0)) == pytest.approx(0.5 * math.hypot(4.0, 4.0), rel=1e-15)
    assert half_diagonal(pc.Line()) == math.inf


def test_flags_are_true_or_false():
    points = np.column_stack([np.cos(np.arange(9.0) * 0.69), np.sin(np.arange(9.0) * 0.69)])
    for given, wanted in ((0, False), (1, True), (np.int64(0), False), (np.bool_(True), True), (True, True)):
        assert pc.SplineCurve(points, periodic=given).periodic == (wanted,)
    for bad in (2, -1, 0.0, 1.0, "yes", None):
        with pytest.raises(ContourError, match="periodic must be True or False"):
            pc.SplineCurve(points, periodic=bad)


def test_ends_are_those_at_which_a_contour_stops():
    inf = math.inf
    assert pc.Line((1.0, 2.0)).ends().tolist() == [1.0, 2.0, -inf, inf]
    assert pc.Plane(((1.0, 2.0), (3.0, 4.0))).ends().tolist() == [1.0, 2.0, 3.0, 4.0]
    assert pc.Cylinder(1.0, (None, (3.0, 4.0))).ends().tolist() == [-inf, inf, 3.0, 4.0]
    assert pc.Cylinder(1.0, ((1.0, 2.0), None)).ends().tolist() == [1.0, 2.0, -inf, inf]
    for contour in (pc.Sphere(1.0), pc.Ellipsoid(1.0, 2.0, 3.0), pc.Circle(1.0), pc.Torus(2.0, 1.0), pc.Point()):
        assert contour.ends().tolist() == [-inf, inf, -inf, inf]
    # short of the cusp and of the apex, where u' grows without bound, by less than what a user would miss
    for end, wanted in zip(pc.Cycloid(1.0).ends(), (-math.pi, math.pi)):
        assert 0.0 < abs(end - wanted) < 1e-3
        assert abs(end) < math.pi
    assert pc.Cycloid(1.0, (-1.0, 2.0)).ends().tolist() == [-1.0, 2.0, -inf, inf]
    assert 0.0 < pc.Cone(0.3).ends()[2] < 1e-3
    assert pc.Cone(0.3, (None, (1.0, 2.0))).ends().tolist() == [-inf, inf, 1.0, 2.0]


# Charts.


def mirrored(r_end, high):
    """A ball's profile whose low or high end is the only pole, and which does not begin at zero."""
    low = 1.0
    if high:
        return pc.SurfaceOfRevolution(lambda s: (math.cos(s - low) + r_end, math.sin(s - low)), (low, low + QUARTER))
    return pc.SurfaceOfRevolution(lambda s: (math.sin(s - low) + r_end, -math.cos(s - low)), (low, low + QUARTER))


ATLASES = {
    "sphere": pc.Sphere(0.7),
    "ellipsoid": pc.Ellipsoid(1.0, 0.5, 2.0),
    "both poles": pc.SurfaceOfRevolution(lambda s: (math.sin(s - 1.0), -2.0 * math.cos(s - 1.0)), (1.0, 1.0 + math.pi)),
    "low pole": mirrored(0.0, False),
    "high pole": mirrored(0.0, True),
}


def normal_of(contour, u, chart=0):
    rows = contour.evaluate(u, chart=chart)
    return np.cross(rows[F_1], rows[F_2])


@pytest.mark.parametrize("name", ATLASES)
def test_parameters_beyond_a_pole_come_back_to_the_same_point(name):
    """For any number of turns: the same point, within the poles, and the normal points outwards again."""
    contour = ATLASES[name]
    row, (low, high) = contour.shape_row(), contour.domain[1]
    turning_round = name in ("sphere", "ellipsoid")
    generator = np.random.default_rng(1)
    poles = [name != "high pole", name != "low pole"]
    tried = Counter()
    for _ in range(150):
        u1 = float(generator.uniform(-9.0, 9.0))
        if turning_round:
            u2 = float(generator.uniform(-16.0, 16.0))
        else:
            # beyond a pole by less than the profile's own length; an end without one is none
            u2 = float(generator.uniform(low - poles[0] * (high - low), high + poles[1] * (high - low)))
        v1, v2 = turned_back(contour.kind, 0, row, u1, u2)
        assert low <= v2 <= high
        assert np.abs(contour.point((v1, v2)) - contour.point((u1, u2))).max() < 1e-14
        across = is_across_pole(contour.kind, 0, row, u2)
        outward = normal_of(contour, (v1, v2))
        assert (normal_of(contour, (u1, u2)) @ outward < 0.0) == across
        if not across and low <= u2 <= high:
            assert (v1, v2) == (u1, u2)
        tried[bool(across)] += 1
    assert min(tried.values()) > 30
    # caps, and what has no poles, are left alone
    other = 1 if turning_round else contour.charts[-1]
    if not turning_round:
        assert turned_back(contour.kind, other, row, 0.3, 99.0) == (0.3, 99.0)
        # at a pole itself, and at an end that is none
        for end, pole in zip((low, high), poles):
            assert not is_across_pole(contour.kind, 0, row, end)
            beyond = end + (-1e-9 if end == low else 1e-9)
            assert bool(is_across_pole(contour.kind, 0, row, beyond)) == pole
    cylinder = pc.Cylinder(1.0)
    assert turned_back(cylinder.kind, 0, cylinder.shape_row(), 4.0, 5.0) == (4.0, 5.0)


@pytest.mark.parametrize("name", ["both poles", "low pole", "high pole"])
def test_a_cap_is_entered_near_its_pole_and_left_farther_away(name):
    contour = ATLASES[name]
    row, (low, high) = contour.shape_row(), contour.domain[1]

    def preferred(chart, u):
        return preferred_chart(contour.kind, chart, row, *u)

    for chart in (1, 2):
        end, towards = (low, 1.0) if chart == 1 else (high, -1.0)
        if chart not in contour.charts:
            assert preferred(0, (0.3, end + 1e-3 * towards)) == 0
            continue
        distances = np.linspace(1e-3, 0.999, 400) * 0.5 * (high - low)
        entered = max(d for d in distances if preferred(0, (0.3, end + d * towards)) == chart)
        for angle in (0.2, 1.7, -2.5):
            left = min(d for d in distances if preferred(chart, (d * math.cos(angle), d * math.sin(angle))) == 0)
            # room between the two, or a path along one of them would change charts without end
            assert 1.3 * entered < left < 0.5 * (high - low)
        # all of a chart is where it is good
        assert all((preferred(0, (0.3, end + d * towards)) == chart) == (d <= entered) for d in distances)
        assert preferred(0, (0.3, 0.5 * (low + high))) == (
            0 if name == "both poles" else preferred(0, (0.3, low + 0.5))
        )


@pytest.mark.parametrize("name", ATLASES)
def test_charts_describe_the_same_point_from_each_to_each(name):
    contour = ATLASES[name]
    generator = np.random.default_rng(2)
    low, high = contour.domain[1]
    row = contour.shape_row()
    for _ in range(20):
        u = float(generator.uniform(-3.0, 3.0)), float(generator.uniform(low + 0.01, high - 0.01))
        there = {0: u}
        for chart in contour.charts[1:]:
            there[chart] = convert_chart(contour.kind, row, 0, *u, chart)
        for a, b in itertools.product(contour.charts, repeat=2):
            v = convert_chart(contour.kind, row, a, *there[a], b)
            # a few roundings, of numbers of the size of the parameters
            assert np.abs(np.subtract(v, there[b])).max() < 2e-13
            assert np.abs(contour.point(v, chart=b) - contour.point(u)).max() < 1e-14


@pytest.mark.parametrize("name", ["both poles", "low pole", "high pole"])
def test_caps_have_the_derivatives_of_the_point_in_their_parameters(name):
    """Both where the cap's own fit holds and where the profile takes over; against differences of exact points."""
    contour = ATLASES[name]
    row, low_high = contour.shape_row(), contour.domain[1]
    h = 1e-4
    for chart in contour.charts[1:]:

        def point(a, b, chart=chart):
            # by way of the first chart, whose formulas these are not
            return contour.point(convert_chart(contour.kind, row, chart, a, b, 0))

        for radius in (0.05, 0.3, 0.7, 0.9):
            a, b = radius * math.cos(0.7), radius * math.sin(0.7)
            rows = contour.evaluate((a, b), chart=chart)
            first = (point(a + h, b) - point(a - h, b)) / (2 * h), (point(a, b + h) - point(a, b - h)) / (2 * h)
            second = (
                (point(a + h, b) - 2 * point(a, b) + point(a - h, b)) / h**2,
                (point(a + h, b + h) - point(a + h, b - h) - point(a - h, b + h) + point(a - h, b - h)) / (4 * h**2),
                (point(a, b + h) - 2 * point(a, b) + point(a, b - h)) / h**2,
            )
            assert np.abs(rows[0] - point(a, b)).max() < 1e-14
            # differences: h^2 times a third derivative of size one, and 1e-16 / h^2 of rounding
            assert np.abs(rows[1:3] - first).max() < 1e-7
            assert np.abs(rows[3:6] - second).max() < 2e-7
    assert low_high[0] == 1.0


# Tapes.


def derivatives(f, x, h=1e-4):
    """First and second derivatives by central differences of the fourth order."""
    values = [f(x + k * h) for k in (-2, -1, 0, 1, 2)]
    first = np.dot([1, -8, 0, 8, -1], values) / (12 * h)
    second = np.dot([-1, 16, -30, 16, -1], values) / (12 * h**2)
    return first, second


ONE = {
    tape.SQUARE: (lambda x, c: x * x, 0.7),
    tape.INVERSE: (lambda x, c: c / x, 0.7),
    tape.POWER_CONSTANT: (lambda x, c: x**c, 0.7),
    tape.SQRT: (lambda x, c: math.sqrt(x), 0.7),
    tape.EXP: (lambda x, c: math.exp(x), 0.7),
    tape.EXPM1: (lambda x, c: math.exp(x) - 1.0, 0.7),
    tape.LOG: (lambda x, c: math.log(x), 0.7),
    tape.LOG1P: (lambda x, c: math.log(1.0 + x), 0.7),
    tape.TAN: (lambda x, c: math.sin(x) / math.cos(x), 0.7),
    tape.ASIN: (lambda x, c: math.asin(x), 0.6),
    tape.ATAN: (lambda x, c: math.atan(x), 0.7),
    tape.SINH: (lambda x, c: 0.5 * (math.exp(x) - math.exp(-x)), 0.7),
    tape.COSH: (lambda x, c: 0.5 * (math.exp(x) + math.exp(-x)), 0.7),
    tape.TANH: (lambda x, c: math.sinh(x) / math.cosh(x), 0.7),
    tape.ASINH: (lambda x, c: math.log(x + math.sqrt(x * x + 1.0)), 0.7),
    tape.ACOSH: (lambda x, c: math.log(x + math.sqrt(x * x - 1.0)), 1.7),
    tape.ATANH: (lambda x, c: 0.5 * math.log((1.0 + x) / (1.0 - x)), 0.6),
}
TWO = {
    tape.MULTIPLY: lambda x, y: x * y,
    tape.DIVIDE: lambda x, y: x / y,
    tape.ATAN2: lambda x, y: math.atan2(x, y),
}


@pytest.mark.parametrize("op", ONE)
def test_functions_of_one_argument(op):
    formula, x = ONE[op]
    for c in (3.0, 2.0, 2.5, 1.5, 0.5, -1.0, -1.5):
        f, f_x, f_xx = function_of_one(op, x, c)
        first, second = derivatives(lambda z, c=c: formula(z, c), x)
        assert f == pytest.approx(formula(x, c), rel=4e-16)
        # rounding: 1e-16 / h and 1e-16 / h^2
        assert f_x == pytest.approx(first, rel=1e-10)
        assert f_xx == pytest.approx(second, rel=1e-6, abs=1e-6)


def test_powers_at_zero():
    """Where there are derivatives they are right; x^2.5 has two, x^1.5 one, x^0.5 none."""
    assert tuple(function_of_one(tape.POWER_CONSTANT, 0.0, 2.0)) == (0.0, 0.0, 2.0)
    assert tuple(function_of_one(tape.POWER_CONSTANT, 0.0, 3.0)) == (0.0, 0.0, 0.0)
    assert tuple(function_of_one(tape.POWER_CONSTANT, 0.0, 2.5)) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("op", TWO)
@pytest.mark.parametrize(("x", "y"), [(0.7, 1.9), (1.6, 0.4), (2.1, -1.3)])
def test_functions_of_two_arguments(op, x, y):
    formula = TWO[op]
    f, f_x, f_y, f_xx, f_xy, f_yy = function_of_two(op, x, y)
    assert f == pytest.approx(formula(x, y), rel=4e-16)
    by_x, by_xx = derivatives(lambda z: formula(z, y), x)
    by_y, by_yy = derivatives(lambda z: formula(x, z), y)
    by_xy = derivatives(lambda z: derivatives(lambda w: formula(w, z), x, 1e-3)[0], y, 1e-3)[0]
    # rounding: 1e-16 / h and 1e-16 / h^2; the mixed one has h^4 of truncation, too
    assert [f_x, f_y] == pytest.approx([by_x, by_y], rel=1e-9, abs=1e-11)
    assert [f_xx, f_yy] == pytest.approx([by_xx, by_yy], rel=1e-5, abs=1e-6)
    assert f_xy == pytest.approx(by_xy, rel=1e-8, abs=1e-9)


def test_a_tape_of_all_kinds_of_instructions():
    """All derivatives of one formula by all variables, against differences of the formula itself."""

    def formula(u, v, t):
        a = math.sin(u * v) + math.cos(v - 2.0 * t)
        b = math.hypot(u + 2.0, t) * math.exp(0.3 * v) - 2.0 * u
        return a * b, math.atan2(v, u + 2.0) / (1.0 + t * t) + 4.0, (u + 2.0) ** (v * t) - 0.5 * a

    shape = pc.ParametricSurface(formula, ((-1.0, 1.0), (0.5, 1.5)))
    assert shape.time_dependent
    h = 1e-3
    for u, v, t in ((0.3, 0.9, 0.4), (-0.6, 1.2, 1.7)):
        rows = shape.evaluate((u, v), t)
        x = np.array([u, v, t])

        def at(*steps, x=x):
            return np.array(formula(*(x + h * np.array(steps))))

        def difference(i, at=at):
            step = np.eye(3)[i]
            return sum(w * at(*(k * step)) for k, w in ((-2, 1), (-1, -8), (1, 8), (2, -1))) / (12 * h)

        def second(i, j, at=at):
            e, d = np.eye(3)[i], np.eye(3)[j]
            if i == j:
                weights = ((-2, -1), (-1, 16), (0, -30), (1, 16), (2, -1))
                return sum(w * at(*(k * e)) for k, w in weights) / (12 * h * h)
            pairs = ((-2, 1), (-1, -8), (1, 8), (2, -1))
            return sum(w * z * at(*(k * e + m * d)) for k, w in pairs for m, z in pairs) / (144 * h * h)

        # differences of the fourth order: h^4 times derivatives up to some hundreds, rounding of 1e-16 / h^2
        assert np.abs(rows[F] - at(0, 0, 0)).max() < 1e-14
        for row, i in ((1, 0), (2, 1), (6, 2)):
            assert np.abs(rows[row] - difference(i)).max() < 1e-9
        for row, (i, j) in ((3, (0, 0)), (4, (0, 1)), (5, (1, 1)), (7, (0, 2)), (8, (1, 2)), (9, (2, 2))):
            assert np.abs(rows[row] - second(i, j)).max() < 1e-8


def test_a_tape_of_a_parameter_and_time():
    curve = pc.ParametricCurve(lambda u, t: (math.sin(u) * t * t, u**3 * (t + 1.0), 2.0), (0.5, 2.0))
    u, t = 1.3, 0.8
    rows = curve.evaluate(u, t)
    s, c = math.sin(u), math.cos(u)
    assert rows[0] == pytest.approx([s * t * t, u**3 * (t + 1), 2.0], rel=1e-15)
    assert rows[1] == pytest.approx([c * t * t, 3 * u * u * (t + 1), 0.0], rel=1e-15)
    assert rows[3] == pytest.approx([-s * t * t, 6 * u * (t + 1), 0.0], rel=1e-15)
    assert rows[6] == pytest.approx([2 * s * t, u**3, 0.0], rel=1e-15)
    assert rows[7] == pytest.approx([2 * c * t, 3 * u * u, 0.0], rel=1e-15)
    assert rows[9] == pytest.approx([2 * s, 0.0, 0.0], rel=1e-15)
    assert not rows[[2, 4, 5, 8]].any()


def test_a_parameter_that_repeats_comes_back_into_its_domain():
    generator = np.random.default_rng(4)
    for _ in range(100):
        low, period = float(generator.uniform(-3, 3)), float(generator.uniform(0.1, 5))
        high = low + period
        inside = float(generator.uniform(low, high))
        assert wrapped_(inside, low, high) == inside
        for turns in (-7, -1, 1, 4):
            found = wrapped_(inside + turns * period, low, high)
            assert low <= found <= high
            # a rounding or two of numbers up to 40
            assert found == pytest.approx(inside, abs=2e-14)
        assert (wrapped_(low, low, high), wrapped_(high, low, high)) == (low, high)
        # the next numbers outside stay inside
        assert low <= wrapped_(math.nextafter(low, -9.0), low, high) <= high
        assert low <= wrapped_(math.nextafter(high, 9.0), low, high) <= high


# Splines.


def test_a_spline_whose_ends_carry_no_repeated_knots():
    """A closed uniform B-spline: its domain is between the knots that have all its functions."""
    degree, n = 5, 12
    angles = 2 * math.pi * np.arange(n + degree) / n
    control = np.column_stack([np.cos(angles), 0.6 * np.sin(angles)])
    knots = np.arange(n + 2 * degree + 1, dtype=float)
    given = BSpline(knots, control, degree)
    curve = pc.SplineCurve(given, periodic=True)
    assert curve.domain == ((float(degree), float(degree + n)),)
    assert curve.convex_side == 1
    for u in np.linspace(degree, degree + n, 40)[:-1]:
        rows = curve.evaluate(float(u))
        for row, order in ((0, 0), (1, 1), (3, 2)):
            # coefficients of each piece are made anew: a few roundings, times (degree / step)^order
            assert np.abs(rows[row, :2] - given(u, nu=order)).max() < 1e-12
        assert np.abs(curve.point(float(u) + n) - rows[0]).max() < 1e-13
    open_ended = BSpline(knots, np.vstack([control[:-1], control[-1:] + 0.01]), degree)
    with pytest.raises(ContourError, match="periodic, but derivative"):
        pc.SplineCurve(open_ended, periodic=True)
    assert pc.SplineCurve(open_ended).domain == curve.domain
    # a knot repeated before the domain begins is no corner; one inside is
    outside = knots.copy()
    outside[:4] = outside[0]
    assert pc.SplineCurve(BSpline(outside, control, degree)).domain == curve.domain
    inside = knots.copy()
    inside[8:11] = inside[8]
    with pytest.raises(ContourError, match="2 times differentiable"):
        pc.SplineCurve(BSpline(inside, control, degree))


def polynomial(x, order):
    return np.polynomial.Polynomial([0.3, -1.0, 0.5, 0.2, -0.1]).deriv(order)(x)


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("kind", ["chebyshev", "splines"])
def test_piecewise_polynomials_in_both_variables(kind, uneven):
    """A polynomial in two variables is met by any pieces, with its derivatives; beyond the ends it goes on as its
    quadratic there."""
    degree = 4
    lines = [np.array([0.0, 0.5, 1.0, 1.5, 2.0]), np.array([-1.0, 0.0, 1.0])]
    if uneven:
        lines = [np.array([0.0, 0.3, 0.4, 1.1, 2.0]), np.array([-1.0, 0.7, 1.0])]

    def value(x, y, i, j):
        return polynomial(x, i) * polynomial(0.5 * y + 1.0, j) * 0.5**j

    if kind == "chebyshev":
        directions = [Direction.chebyshev(b, degree) for b in lines]
    else:
        knots = [np.concatenate([[b[0]] * degree, b, [b[-1]] * degree]) for b in lines]
        directions = [Direction.splines(k, degree) for k in knots]
    nodes = [np.concatenate([0.5 * (a + b) + 0.5 * (b - a) * chebyshev_nodes(degree) for a, b in itertools.pairwise(c)])
             for c in lines]  # fmt: skip
    tables = []
    for direction, points in zip(directions, nodes):
        # the values of each function at the nodes, from the record of its pieces
        table = np.zeros((len(points), direction.functions))
        for row, x in enumerate(points):
            piece = min(int(np.searchsorted(direction.breaks, x, side="right")) - 1, len(direction.breaks) - 2)
            low, high = direction.breaks[piece], direction.breaks[piece + 1]
            local = np.polynomial.chebyshev.chebvander((2 * x - low - high) / (high - low), degree).ravel()
            basis = np.eye(degree + 1) if direction.basis is None else direction.basis[piece]
            start = int(direction.starts[piece])
            table[row, start : start + degree + 1] = basis @ local
        tables.append(np.linalg.pinv(table))
    data = value(nodes[0][:, None], nodes[1][None, :], 0, 0)
    coefficients = tables[0] @ data @ tables[1].T
    pool = pack(directions, np.stack([coefficients, 2.0 * coefficients], axis=-1), first=1)
    shape = pc.Contour(fitted, 2, pool=pool)
    points = [(x, y) for x in (0.0, 0.2, 0.3, 0.35, 1.0, 1.7, 2.0) for y in (-1.0, -0.4, 0.0, 0.8, 1.0)]
    for x, y in points:
        rows = shape.evaluate((x, y))
        assert not rows[:, 0].any()
        for row, (i, j) in ((0, (0, 0)), (1, (1, 0)), (2, (0, 1)), (3, (2, 0)), (4, (1, 1)), (5, (0, 2))):
            # the fit of the coefficients rounds; second derivatives of the shortest piece, by (2 / 0.1)^2 more
            assert rows[row, 1] == pytest.approx(value(x, y, i, j), abs=2e-11)
            assert rows[row, 2] == pytest.approx(2.0 * value(x, y, i, j), abs=4e-11)
    for x, end in ((-0.4, 0.0), (2.3, 2.0)):
        rows = shape.evaluate((x, 0.2))
        d = x - end
        for row, j in ((0, 0), (2, 1), (5, 2)):
            quadratic = [value(end, 0.2, k, j) for k in range(3)]
            assert rows[row, 1] == pytest.approx(quadratic[0] + d * quadratic[1] + d * d / 2 * quadratic[2], abs=2e-11)
        assert rows[1, 1] == pytest.approx(value(end, 0.2, 1, 0) + d * value(end, 0.2, 2, 0), abs=2e-11)
        assert rows[3, 1] == pytest.approx(value(end, 0.2, 2, 0), abs=2e-11)


@pytest.mark.parametrize(("breaks", "even"), [([0.5, 1.0, 1.5], True), ([-7.0, -3.0], True), ([0.5, 1.0, 1.6], False)])
def test_intervals_of_one_length_are_found_by_a_division(breaks, even):
    direction = Direction.chebyshev(np.array(breaks), 3)
    pool = pack([direction], np.zeros((direction.functions, 1)))
    assert bool(pool[piecewise._BLOCKS + piecewise._UNIFORM]) == even
    find = from_python(piecewise._interval)
    start, count = int(pool[piecewise._BLOCKS + piecewise._BREAKS]), len(breaks) - 1
    for u in np.concatenate([breaks, np.linspace(breaks[0] - 1.0, breaks[-1] + 1.0, 41), [math.nan]]):
        wanted = min(max(int(np.searchsorted(breaks, u, side="right")) - 1, 0), count - 1) if u == u else 0
        assert find(pool, start, count, even, float(u)) == wanted
        assert find(pool, start, count, False, float(u)) == wanted


def test_a_traced_function_keeps_what_is_common():
    """An expression that occurs again is computed once, a sine and a cosine of one angle together."""
    assert instructions(lambda u: (math.sin(u), math.cos(u), math.sin(u) * math.cos(u)), "u", 3) == 2
    assert instructions(lambda u: (2.0 * u + 1.0, 2.0 * (2.0 * u + 1.0), u), "u", 3) == 2
    assert instructions(lambda u: (u, 1.0 * u, u + 0.0), "u", 3) == 0
    found = traced_tape(lambda u, t: (u, 3.0, u - u), "ut", 3)
    assert found.constants == (None, 3.0, 0.0)
    assert not found.time_dependent
    assert found.pool[tape.COUNT] == 0
