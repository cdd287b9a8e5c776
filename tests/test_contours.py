"""Contours in closed form, revolutions, splines and charts against independent differentiation."""

import copy
import itertools
import math

import numpy as np
import pytest
import random_contacts
from calling import from_python
from scipy.interpolate import BSpline, make_interp_spline
from shared import kinds_of

import pincontact.contours as pc
from pincontact.contours import charts as chart_kernels
from pincontact.contours.base import F_1, F_2, F_11, F_12, F_22, F
from pincontact.errors import ContourError

convert_chart = from_python(chart_kernels.convert_chart)
preferred_chart = from_python(chart_kernels.preferred_chart)

# Closed forms repeat the reference's arithmetic in double precision: a few ulp of the largest term.
ROUNDING = 2e-15

ORDERS = {
    1: {(0,): 0, (1,): 1, (2,): 3},
    2: {(0, 0): 0, (1, 0): 1, (0, 1): 2, (2, 0): 3, (1, 1): 4, (0, 2): 5},
}


def reference(formula, point, orders, radius=0.05, nodes=16):
    """Derivatives of an analytic formula by Cauchy's integral in extended precision.

    formula maps complex extended-precision numbers to three of them; the trapezoidal rule on a circle of the given
    radius is exact up to (radius / distance of the nearest singularity) ** nodes, rounding to 1e-19 / radius ** 2.
    """
    angles = 8 * np.arctan(np.longdouble(1)) * np.arange(nodes) / nodes
    circle = np.cos(angles) + 1j * np.sin(angles)
    shifts = np.meshgrid(*[radius * circle for _ in point], indexing="ij")
    arguments = [np.clongdouble(x) + shift for x, shift in zip(point, shifts)]
    zero = np.zeros_like(arguments[0])
    values = [np.asarray(part + zero) for part in formula(*arguments)]
    found = {}
    for order in orders:
        weight = np.ones_like(arguments[0])
        for axis, n in enumerate(order):
            shape = [1] * len(point)
            shape[axis] = nodes
            weight = weight * (math.factorial(n) / np.longdouble(radius) ** n / nodes * circle**-n).reshape(shape)
        found[order] = np.array([float((weight * part).sum().real) for part in values])
    return found


def largest_error(contour, formula, points, chart=0, t=0.0, radius=0.05):
    """Largest deviation of any derivative over the points, relative to the size of the derivatives there."""
    worst = 0.0
    for point in points:
        expected = reference(formula, point, ORDERS[contour.dimension], radius)
        rows = contour.evaluate(point, t, chart)
        scale = max(np.abs(value).max() for value in expected.values())
        for order, row in ORDERS[contour.dimension].items():
            worst = max(worst, np.abs(rows[row] - expected[order]).max() / scale)
    return worst


def grid(*ranges, n=9, seed=5):
    """Both ends, the middle and random values of each range, combined."""
    generator = np.random.default_rng(seed)
    axes = [np.unique([a, b, 0.5 * (a + b), *generator.uniform(a, b, n - 3)]) for a, b in ranges]
    return list(itertools.product(*axes))


TURN = (-math.pi, math.pi)
POLES = (-math.pi / 2, math.pi / 2)

COSINE = np.array([[0.1, -0.2, 0.3], [1.0, 0.2, 0.1], [0.1, 0.3, -0.2], [0.05, 0.0, 0.02]])
SINE = np.array([[0.0, 0.0, 0.0], [0.1, 1.2, 0.3], [-0.2, 0.1, 0.0], [0.03, 0.02, 0.07]])


def fourier(u):
    return [
        sum(COSINE[k, i] * np.cos(k * u) + SINE[k, i] * np.sin(k * u) for k in range(len(COSINE))) for i in range(3)
    ]


def fourier_sum(u):
    return u, math.cos(u), 0.0


CURVES = {
    "line": (pc.Line(), lambda u: (u, 0, 0), (-5.0, 5.0)),
    "circle": (pc.Circle(0.3), lambda u: (0.3 * np.cos(u), 0.3 * np.sin(u), 0), TURN),
    "ellipse": (pc.Ellipse(2.0, 0.5), lambda u: (2.0 * np.cos(u), 0.5 * np.sin(u), 0), TURN),
    "helix": (
        pc.Helix(0.7, -0.4),
        lambda u: (0.7 * np.cos(u), 0.7 * np.sin(u), -0.4 * u / (2 * np.longdouble(math.pi))),
        (-10.0, 10.0),
    ),
    "cycloid": (pc.Cycloid(1.5), lambda u: (1.5 * (u + np.sin(u)), 1.5 * (1 - np.cos(u)), 0), TURN),
    "fourier": (pc.FourierCurve(COSINE, SINE), fourier, TURN),
}


@pytest.mark.parametrize("name", CURVES)
def test_closed_form_curves(name):
    contour, formula, limits = CURVES[name]
    assert largest_error(contour, formula, grid(limits, n=40)) < ROUNDING


def test_cycloid_keeps_its_digits_at_the_bottom():
    # y = R (1 - cos u) is 2e-16 there: a difference would have no digits left.
    u = 2e-8
    assert pc.Cycloid(1.0).point(u)[1] == pytest.approx(u * u / 2, rel=1e-15)


def test_every_kind_is_in_the_tables_of_the_tests():
    closed = {type(contour).__name__ for contour, *_ in (*CURVES.values(), *SURFACES.values())}
    of_functions_or_data = {
        *("HeightField", "ParametricCurve", "ParametricSurface", "Point", "SplineCurve", "SplineSurface"),
        "SurfaceOfRevolution",
    }
    untested = kinds_of(pc.Contour) - closed - of_functions_or_data
    random = {type(make(1.0)).__name__ for table in random_contacts.TABLES.values() for make in table.values()}
    missing = kinds_of(pc.Contour) - random - {"Point"}
    assert not (untested or missing), f"CURVES and SURFACES lack {untested}, the tables of random_contacts.py {missing}"


def ellipsoid(a, b, c, chart=0):
    def formula(u, v):
        lengths = (a, b, c) if chart == 0 else (b, c, a)
        x = lengths[0] * np.cos(v) * np.cos(u)
        y = lengths[1] * np.cos(v) * np.sin(u)
        z = lengths[2] * np.sin(v)
        return (x, y, z) if chart == 0 else (z, x, y)

    return formula


def cone(u, v):
    s, c = np.longdouble(math.sin(0.4)), np.longdouble(math.cos(0.4))
    return v * s * np.cos(u), v * s * np.sin(u), v * c


SURFACES = {
    "plane": (pc.Plane(), 0, lambda u, v: (u, v, 0), ((-3.0, 3.0), (-3.0, 3.0))),
    "sphere": (pc.Sphere(0.2), 0, ellipsoid(0.2, 0.2, 0.2), (TURN, POLES)),
    "sphere, chart 1": (pc.Sphere(0.2), 1, ellipsoid(0.2, 0.2, 0.2, 1), (TURN, POLES)),
    "ellipsoid": (pc.Ellipsoid(1.0, 2.0, 0.3), 0, ellipsoid(1.0, 2.0, 0.3), (TURN, POLES)),
    "ellipsoid, chart 1": (pc.Ellipsoid(1.0, 2.0, 0.3), 1, ellipsoid(1.0, 2.0, 0.3, 1), (TURN, POLES)),
    "cylinder": (
        pc.Cylinder(0.4),
        0,
        lambda u, v: (0.4 * np.cos(u), 0.4 * np.sin(u), v),
        (TURN, (-2.0, 2.0)),
    ),
    "cone": (pc.Cone(0.4), 0, cone, (TURN, (0.0, 3.0))),
    "torus": (
        pc.Torus(1.0, 0.3),
        0,
        lambda u, v: ((1 + 0.3 * np.cos(v)) * np.cos(u), (1 + 0.3 * np.cos(v)) * np.sin(u), 0.3 * np.sin(v)),
        (TURN, TURN),
    ),
}


@pytest.mark.parametrize("name", SURFACES)
def test_closed_form_surfaces(name):
    contour, chart, formula, ranges = SURFACES[name]
    assert largest_error(contour, formula, grid(*ranges), chart) < ROUNDING


def outward(contour, u, chart=0):
    rows = contour.evaluate(u, chart=chart)
    return np.cross(rows[F_1], rows[F_2]), rows[F]


@pytest.mark.parametrize(
    ("contour", "direction"),
    [
        (pc.Plane(), lambda p: (0, 0, 1)),
        (pc.Sphere(2.0), lambda p: p),
        (pc.Ellipsoid(1.0, 2.0, 3.0), lambda p: p / np.array([1.0, 4.0, 9.0])),
        (pc.Cylinder(0.5), lambda p: p * (1, 1, 0)),
        (pc.Cone(0.5), lambda p: (p[0], p[1], -np.hypot(p[0], p[1]) * math.tan(0.5))),
        (pc.Torus(1.0, 0.2), lambda p: p - np.array([p[0], p[1], 0]) / np.hypot(p[0], p[1])),
        (pc.HeightField(lambda x, y: math.sin(x) * y), lambda p: (-math.cos(p[0]) * p[1], -math.sin(p[0]), 1)),
        (
            pc.SurfaceOfRevolution(lambda s: (math.sin(s), -2 * math.cos(s)), (0.0, math.pi)),
            lambda p: p / np.array([1, 1, 4]),
        ),
        # The same body with its profile run downwards.
        (
            pc.SurfaceOfRevolution(lambda s: (math.sin(s), 2 * math.cos(s)), (0.0, math.pi)),
            lambda p: p / np.array([1, 1, 4]),
        ),
        (pc.SurfaceOfRevolution(lambda s: (s, 0 * s), (0.0, 1.0)), lambda p: (0, 0, 1)),
        (pc.SurfaceOfRevolution(lambda s: (2 - s, 0 * s), (0.0, 1.0)), lambda p: (0, 0, 1)),
    ],
    ids=lambda value: value.name if isinstance(value, pc.Contour) else "",
)
def test_normals_point_outwards(contour, direction):
    generator = np.random.default_rng(11)
    low, high = np.nan_to_num(np.array(contour.domain).T, posinf=2.0, neginf=-2.0)
    for chart, _ in itertools.product(contour.charts, range(40)):
        u = low + (high - low) * generator.random(2)
        if contour.name == "SurfaceOfRevolution" and chart:
            u = convert(contour, 0, u, chart)
        normal, p = outward(contour, u, chart)
        wanted = np.array(direction(p))
        cosine = normal @ wanted / np.linalg.norm(normal) / np.linalg.norm(wanted)
        # 1 - cosine is quadratic in the angle; 1e-12 leaves room for points near the poles of chart 0.
        assert cosine > 1 - 1e-12


def convert(contour, chart, u, new_chart):
    return convert_chart(contour.kind, contour.shape_row(), chart, u[0], u[1], new_chart)


def preferred(contour, chart, u):
    return preferred_chart(contour.kind, chart, contour.shape_row(), u[0], u[1])


ATLASES = [
    pc.Sphere(0.7),
    pc.Ellipsoid(1.0, 0.5, 2.0),
    pc.SurfaceOfRevolution(lambda s: (math.cos(s), 0.5 * math.sin(s)), (-math.pi / 2, math.pi / 2)),
]


@pytest.mark.parametrize("contour", ATLASES, ids=lambda c: c.name)
def test_charts_describe_the_same_points(contour):
    generator = np.random.default_rng(3)
    for other, _ in itertools.product(contour.charts[1:], range(200)):
        u = np.array([generator.uniform(*TURN), generator.uniform(*POLES)])
        v = convert(contour, 0, u, other)
        # Each conversion and evaluation rounds once or twice.
        assert np.abs(contour.point(v, chart=other) - contour.point(u)).max() < 2e-15
        back = convert(contour, other, v, 0)
        assert np.abs(contour.point(back) - contour.point(u)).max() < 2e-15
        # Angles are ill-conditioned near the pole, by 1 / cos u2.
        assert np.abs(np.subtract(back, u)).max() < 4e-15 / math.cos(u[1])


@pytest.mark.parametrize("contour", ATLASES, ids=lambda c: c.name)
def test_a_path_over_a_pole_stays_regular(contour):
    """A great circle a hair's breadth beside both poles: chart switches, no jump, no degenerate normal."""
    charts, switches = [0], 0
    u = (0.0, 0.0)
    previous = contour.point(u)
    for angle in np.linspace(0, 2 * math.pi, 400):
        latitude = math.asin(math.sin(angle) * math.cos(1e-9))
        target = (math.copysign(1e-9, 1) if math.cos(angle) > 0 else math.pi - 1e-9, latitude)
        u = convert(contour, 0, target, charts[-1])
        chart = preferred(contour, charts[-1], u)
        if chart != charts[-1]:
            u = convert(contour, charts[-1], u, chart)
            switches += 1
        charts.append(chart)
        assert preferred(contour, chart, u) == chart  # no switching back at once
        rows = contour.evaluate(u, chart=chart)
        assert np.abs(rows[F] - contour.point(target)).max() < 2e-15
        assert np.linalg.norm(rows[F] - previous) < 2 * math.pi / 399 * contour.size * 1.5
        area = np.linalg.norm(np.cross(rows[F_1], rows[F_2]))
        assert area > 0.05 * contour.size * min(contour.size, 0.5)
        previous = rows[F]
    assert 4 <= switches <= 6  # into and out of each polar region, the start may add one


def test_hysteresis_of_sphere_charts():
    sphere = pc.Sphere(1.0)
    boundary = math.acos(0.5)
    assert preferred(sphere, 0, (0.3, boundary - 1e-6)) == 0
    assert preferred(sphere, 0, (0.3, boundary + 1e-6)) == 1
    assert preferred(sphere, 0, (0.3, boundary + math.pi / 2)) == 1  # overshot over the pole
    there = convert(sphere, 0, (0.3, boundary + 1e-6), 1)
    assert math.cos(there[1]) > 0.8
    for contour in (pc.Cylinder(1.0), pc.Torus(2.0, 1.0), pc.Plane(), pc.Cone(0.3)):
        assert preferred(contour, 0, (0.1, 0.2)) == 0


def test_conversion_of_an_overshot_latitude_keeps_the_normal_outside():
    sphere = pc.Sphere(1.0)
    normal, point = outward(sphere, convert(sphere, 0, (0.4, math.pi / 2 + 0.2), 1), 1)
    assert normal @ point > 0.5


# Revolutions: the caps at the poles against their analytic continuation.


@pytest.mark.parametrize("chart", [1, 2])
def test_cap_of_a_sphere(chart):
    ball = pc.SurfaceOfRevolution(lambda s: (0.5 * math.cos(s), 0.5 * math.sin(s)), POLES)

    def formula(a, b):
        # Added to the square so that no node of the integral is at the removable singularity of sin d / d.
        d = np.sqrt(a * a + b * b + np.longdouble(1e-35))
        g = 0.5 * np.sin(d) / d
        height = 0.5 * np.cos(d)
        return (a * g, -b * g, -height) if chart == 1 else (a * g, b * g, height)

    points = [(0.0, 0.0), (1e-9, -2e-9), (1e-4, 0.0), (0.01, 0.02), (0.1, -0.2), (0.3, 0.4), (0.5, 0.5), (-0.8, 0.7)]
    # Near the pole the fits of g and k lose two to three digits in their second derivatives.
    assert largest_error(ball, formula, points, chart) < 2e-13


def test_cap_and_profile_agree_where_one_takes_over():
    lens = pc.SurfaceOfRevolution(lambda s: (s * math.exp(-0.2 * s * s), 0.3 * math.cosh(s) - 0.01 * s**4), (0.0, 1.3))
    reach = math.sqrt(lens.pool[2])
    assert 0.02 < reach < 1.3
    inside = lens.evaluate((reach * (1 - 1e-14), 0.0), chart=1)
    outside = lens.evaluate((reach * (1 + 1e-14), 0.0), chart=1)
    # The fit's second derivatives at its end against a formula with 1 / d^2: both near 1e-13.
    assert np.abs(inside - outside).max() < 1e-11

    def formula(a, b):
        w = a * a + b * b
        g = np.exp(-np.longdouble(0.2) * w)
        d = np.sqrt(w + 0j)
        return a * g, -b * g, np.longdouble(0.3) * np.cosh(d) - np.longdouble(0.01) * w * w

    assert largest_error(lens, formula, [(0.0, 0.0), (0.02, 0.03), (0.1, 0.2), (0.6, 0.5)], 1) < 2e-13


def test_revolution_away_from_the_axis():
    vase = pc.SurfaceOfRevolution(lambda s: (1 + 0.3 * math.sin(2 * s), s), (-1.0, 2.0))

    def formula(u, v):
        r = 1 + np.longdouble(0.3) * np.sin(2 * v)
        return r * np.cos(u), r * np.sin(u), v

    assert largest_error(vase, formula, grid(TURN, (-1.0, 2.0))) < ROUNDING
    assert vase.convex_side == 0
    assert preferred(vase, 0, (0.0, -1.0)) == 0  # no poles


def test_revolution_through_points_is_smooth_at_its_poles():
    s = np.linspace(0, np.pi, 41)
    egg = pc.SurfaceOfRevolution(np.column_stack([np.sin(s), -1.5 * np.cos(s)]))
    low, high = egg.domain[1]
    for i in range(41):  # passes through the points; parameter by chords
        chord = np.linalg.norm(np.diff(np.column_stack([np.sin(s), -1.5 * np.cos(s)])[: i + 1], axis=0), axis=1)
        point = egg.point((0.0, low + chord.sum()))
        assert np.abs(point - (np.sin(s[i]), 0.0, -1.5 * np.cos(s[i]))).max() < 1e-13
    # The curvature at the pole is that of the spheroid, 1.5, up to the interpolation error.
    rows = egg.evaluate((0.0, 0.0), chart=1)
    curvature = rows[F_11] @ (0, 0, 1) / (rows[F_1] @ rows[F_1])
    assert curvature == pytest.approx(1.5, rel=1e-5)
    assert np.abs(rows[F_12]).max() < 1e-12
    assert egg.convex_side == 1
    # Second derivatives go through the pole without a jump: chart 1 along a diameter.
    before, after = (egg.evaluate((x, 0.0), chart=1) for x in (-1e-7, 1e-7))
    assert np.abs(before[[3, 4, 5]] - after[[3, 4, 5]]).max() < 1e-5
    reach = math.sqrt(egg.pool[2])
    inside, outside = (egg.evaluate((0.0, reach * x), chart=1) for x in (1 - 1e-13, 1 + 1e-13))
    # Beyond the fit second derivatives come from divisions by d^3, d about 0.03.
    assert np.abs(inside - outside).max() < 1e-9
    assert preferred(egg, 0, (0.2, high)) == 2


def test_closed_profile():
    s = 2 * np.pi * np.arange(30) / 30
    ring = pc.SurfaceOfRevolution(np.column_stack([2 + 0.5 * np.cos(s), 0.5 * np.sin(s)]), periodic=True)
    assert ring.periodic == (True, True)
    low, high = ring.domain[1]
    # The spline's own continuity is as good as SciPy's periodic solve: rounding, times 1 / h^2 in second derivatives.
    assert np.abs(ring.evaluate((0.1, low)) - ring.evaluate((0.1, high))).max() < 1e-10
    u = np.array([0.3, 0.4 * (high - low)])
    point = ring.point(u)
    # 30 points, degree 5: interpolation error (2 pi / 30)^6 / 6! or so.
    assert np.hypot(np.hypot(point[0], point[1]) - 2, point[2]) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(
    ("profile", "domain", "message"),
    [
        (lambda s: (s, s), (0.0, 1.0), "apex"),
        (lambda s: (s, abs(s) ** 3 + 0.0 * s), (0.0, 1.0), "odd"),
        (lambda s: (math.sqrt(s), s), (0.0, 1.0), "arc length"),
        (lambda s: (s * s, s**4), (0.0, 1.0), "tangentially"),
        (lambda s: (s - 0.3, s), (0.0, 1.0), "crosses"),
        (lambda s: (math.sin(s), -math.cos(s)), (0.0, 3.2), "crosses"),
        (lambda s: (s, s, s), (0.0, 1.0), "2 numbers"),
        (lambda s: (s, 1 + 0 * s), None, "domain"),
        (lambda s: (1 + s, s), (0.0, math.inf), "finite"),
        (lambda s, t: (1 + s, s), (0.0, 1.0), "time"),
        ([[0.0, 0.0], [1.0, 1.0], [1.0, 1.0], [2.0, 0.0], [2.0, 1.0], [1, 3], [1, 4]], None, "coincide"),
        ([[-1.0, 0.0], [1.0, 1.0]], None, "other side"),
    ],
)
def test_profiles_that_are_refused(profile, domain, message):
    with pytest.raises(ContourError, match=message):
        pc.SurfaceOfRevolution(profile, domain)


# Splines.


def wavy(n=20):
    u = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(u) * (1 + 0.2 * np.cos(3 * u)), np.sin(u), 0.3 * np.sin(2 * u)])


@pytest.mark.parametrize("degree", [4, 5, 6])
@pytest.mark.parametrize("periodic", [False, True])
def test_spline_curves_interpolate_and_are_smooth(degree, periodic):
    points = wavy()
    parameters = np.linspace(0, 3, 21) ** 1.3 if periodic else np.linspace(0, 3, 20) ** 1.3
    curve = pc.SplineCurve(points, periodic=periodic, degree=degree, parameters=parameters)
    through = np.vstack([points, points[:1]]) if periodic else points
    expected = make_interp_spline(parameters, through, k=degree, bc_type="periodic" if periodic else None)
    for u, point in zip(parameters, through):
        assert np.abs(curve.point(u) - point).max() < 1e-13
    generator = np.random.default_rng(1)
    low, high = curve.domain[0]
    scale = [np.abs(expected(np.linspace(low, high, 300), nu=n)).max() for n in range(3)]
    for u in generator.uniform(low, high, 100):
        rows = curve.evaluate(u)
        for n, row in enumerate((F, F_1, F_11)):
            # The change of basis within an interval costs degree^2 ulp per differentiation.
            assert np.abs(rows[row] - expected(u, nu=n)).max() < 1e-12 * scale[n]
    knots = np.unique(expected.t[(expected.t > low) & (expected.t < high)])
    for knot in [*knots, *([low] if periodic else [])]:
        left, right = curve.evaluate(np.nextafter(knot, -9)), curve.evaluate(knot)
        for n, row in enumerate((F, F_1, F_11)):
            assert np.abs(left[row] - right[row]).max() < 1e-11 * scale[n]
        # Third derivative: slopes of f_11 on both sides, extrapolated to the knot.
        h = 1e-4
        sides = [
            [(curve.evaluate(knot + s * k * h)[F_11] - right[F_11]) / (s * k * h) for k in (1, 2)] for s in (-1, 1)
        ]
        third = [2 * near - far for near, far in sides]
        size = np.abs(expected(np.linspace(low, high, 300), nu=3)).max()
        # The extrapolation is second order in h; a jump of the third derivative would be of the order of its size.
        assert np.abs(third[0] - third[1]).max() < 1e-4 * size


def test_spline_from_scipy_and_its_checks():
    knots = np.r_[[0.0] * 6, 1.0, 2.0, 3.0, [4.0] * 6]
    generator = np.random.default_rng(4)
    given = BSpline(knots, generator.normal(size=(9, 3)), 5)
    curve = pc.SplineCurve(given)
    assert curve.domain == ((0.0, 4.0),)
    for u in np.linspace(0, 4, 33):
        assert np.abs(curve.evaluate(u)[[F, F_1, F_11]] - [given(u, nu=n) for n in range(3)]).max() < 1e-12
    double = BSpline(np.r_[[0.0] * 5, 1.0, 1.0, [2.0] * 5], generator.normal(size=(7, 3)), 4)
    with pytest.raises(ContourError, match="2 times differentiable"):
        pc.SplineCurve(double)
    with pytest.raises(ContourError, match="derivative 0"):
        pc.SplineCurve(given, periodic=True)
    with pytest.raises(ContourError, match="degree"):
        pc.SplineCurve(wavy(), degree=3)
    with pytest.raises(ContourError, match="too few"):
        pc.SplineCurve(wavy(5))
    with pytest.raises(ContourError, match="coincide"):
        pc.SplineCurve(np.repeat(wavy(6), 2, axis=0))
    with pytest.raises(ContourError, match="increase"):
        pc.SplineCurve(wavy(6), parameters=[0, 1, 3, 2, 4, 5])
    with pytest.raises(ContourError, match=r"points\[2, 1\] is not finite"):
        bad = wavy()
        bad[2, 1] = np.nan
        pc.SplineCurve(bad)


def test_a_spline_beyond_its_ends_goes_on_twice_differentiable():
    curve = pc.SplineCurve(wavy(), parameters=np.arange(20.0))
    end = curve.evaluate(19.0)
    beyond = curve.evaluate(19.5)
    assert beyond[F_11] == pytest.approx(end[F_11], rel=1e-12)
    assert beyond[F_1] == pytest.approx(end[F_1] + 0.5 * end[F_11], rel=1e-12)
    assert beyond[F] == pytest.approx(end[F] + 0.5 * end[F_1] + 0.125 * end[F_11], rel=1e-12)


def bumpy(n1=14, n2=17):
    u, v = np.meshgrid(np.linspace(0, 2, n1), np.linspace(0, 3, n2), indexing="ij")
    return np.stack([u + 0.1 * v * v, v - 0.1 * u, 0.3 * np.sin(2 * u) * np.cos(v)], axis=2)


def test_spline_surface_interpolates_and_differentiates():
    u1, u2 = np.linspace(0, 1, 14) ** 1.1, np.linspace(0, 2, 17)
    surface = pc.SplineSurface(bumpy(), parameters=(u1, u2))
    points = bumpy()
    for i, j in itertools.product(range(0, 14, 3), range(0, 17, 4)):
        assert np.abs(surface.point((u1[i], u2[j])) - points[i, j]).max() < 1e-13
    first = make_interp_spline(u1, points, k=5, axis=0)
    generator = np.random.default_rng(2)
    for a, b in zip(generator.uniform(0, 1, 60), generator.uniform(0, 2, 60)):
        rows = surface.evaluate((a, b))
        for (n, m), row in ORDERS[2].items():
            expected = make_interp_spline(u2, first(a, nu=n), k=5)(b, nu=m)
            # Interpolating in the other order rounds differently; second derivatives amplify that by (5 / h)^2.
            assert np.abs(rows[row] - expected).max() < 1e-10


def test_periodic_spline_surface_closes():
    u = 2 * np.pi * np.arange(24) / 24
    v = 2 * np.pi * np.arange(16) / 16
    a, b = np.meshgrid(u, v, indexing="ij")
    r = 2 + 0.5 * np.cos(b)
    torus = pc.SplineSurface(np.stack([r * np.cos(a), r * np.sin(a), 0.5 * np.sin(b)], axis=2), (True, True))
    (_, end1), (_, end2) = torus.domain
    for w in np.linspace(0, end2, 7):
        assert np.abs(torus.evaluate((0.0, w)) - torus.evaluate((end1, w))).max() < 1e-11
        assert np.abs(torus.evaluate((0.1, w)) - torus.evaluate((0.1 - 3 * end1, w))).max() < 1e-11
    normal, point = outward(torus, (1.0, 0.3))
    assert normal @ (point - 2 * np.array([point[0], point[1], 0]) / np.hypot(*point[:2])) > 0
    with pytest.raises(ContourError, match="first direction"):
        pc.SplineSurface(bumpy(4, 9))
    with pytest.raises(ContourError, match="shape"):
        pc.SplineSurface(np.zeros((8, 8)))


def test_height_field_from_a_grid():
    x, y = np.linspace(-1, 1, 21), np.linspace(0, 2, 23)
    field = pc.HeightField(x, y, np.sin(x)[:, None] * np.cos(y))
    for a, b in [(-1.0, 0.0), (0.3, 1.1), (0.999, 1.999), (1.0, 2.0)]:
        rows = field.evaluate((a, b))
        assert rows[F, :2].tolist() == [a, b]
        assert rows[[F_1, F_2], :2].tolist() == [[1, 0], [0, 1]]
        assert not rows[[F_11, F_12, F_22], :2].any()
        s, c = math.sin(a), math.cos(a)
        sy, cy = math.sin(b), math.cos(b)
        expected = [s * cy, c * cy, -s * sy, -s * cy, -c * sy, -s * cy]
        # Quintic interpolation at h = 0.1: h^6 for the values, h^4 for second derivatives at the boundary.
        assert np.abs(rows[[F, F_1, F_2, F_11, F_12, F_22], 2] - expected).max() < 1e-4
        assert abs(rows[F, 2] - expected[0]) < 1e-8
    with pytest.raises(ContourError, match="shape"):
        pc.HeightField(x, y, np.zeros((3, 3)))
    with pytest.raises(ContourError, match="needs x, y and z"):
        pc.HeightField(x, y)


def test_height_field_grid_reproduces_polynomials():
    x, y = np.linspace(-1, 1, 9), np.linspace(0, 2, 8)
    field = pc.HeightField(x, y, (x**3)[:, None] * y**2 - y**5)
    for a, b in [(0.123, 0.456), (-0.9, 1.9)]:
        rows = field.evaluate((a, b))[:, 2]
        expected = [a**3 * b**2 - b**5, 3 * a * a * b * b, 2 * a**3 * b - 5 * b**4]
        expected += [6 * a * b * b, 6 * a * a * b, 2 * a**3 - 20 * b**3]
        # A quintic spline holds these polynomials exactly; what is left is the rounding of the interpolation.
        assert np.abs(rows[:6] - expected).max() < 1e-11


# What every contour says about itself.


def test_shape_facts():
    assert pc.Circle(1.0).convex_side == 1
    assert pc.Circle(1.0).planar
    assert pc.Circle(1.0).periodic == (True,)
    assert pc.Circle(1.0, domain=(0.0, 1.0)).periodic == (False,)
    assert pc.Circle(1.0, domain=(0.0, 1.0)).convex_side == 0
    for whole, part in (
        (pc.Cone(0.4), pc.Cone(0.4, ((0.0, 1.0), None))),
        (pc.Cylinder(0.2), pc.Cylinder(0.2, ((0.0, 1.0), None))),
    ):
        assert (whole.convex_side, part.convex_side) == (1, 0)
    assert pc.Circle(1.0, domain=(0.0, 2 * math.pi)).periodic == (True,)
    assert not pc.Helix(1.0, 1.0).planar
    assert pc.Line((-1.0, 3.0)).size == 2.0
    assert pc.Plane(((-3.0, 3.0), (-4.0, 4.0))).size == 5.0
    assert pc.Plane((None, (0.0, 1.0))).size == math.inf
    assert pc.Cylinder(0.5, (None, (0.0, 2.0))).domain == (TURN, (0.0, 2.0))
    assert pc.Cylinder(0.5, ((0.0, 1.0), None)).periodic == (False, False)
    assert pc.Cone(0.5).domain[1] == (0.0, math.inf)
    assert pc.Torus(2.0, 0.5).size == 2.5
    assert pc.Point().size == 0.0
    assert pc.Point().point().tolist() == [0, 0, 0]
    ball = pc.SurfaceOfRevolution(lambda s: (math.cos(s), math.sin(s)), POLES)
    barrel = pc.SurfaceOfRevolution(lambda s: (2 - s * s, s), (-1.0, 1.0))
    waisted = pc.SurfaceOfRevolution(lambda s: (2 + s * s, s), (-1.0, 1.0))
    bowl = pc.SurfaceOfRevolution(lambda s: (s, s * s), (0.0, 1.0))  # of a marble, or of a rocker
    assert [c.convex_side for c in (ball, barrel, waisted, bowl)] == [1, 1, 0, 0]
    assert ball.size == pytest.approx(1.0, rel=1e-4)
    u = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ellipse = np.column_stack([2 * np.cos(u), np.sin(u)])
    assert pc.SplineCurve(ellipse, periodic=True).convex_side == 1
    assert pc.SplineCurve(ellipse[::-1], periodic=True).convex_side == -1
    assert pc.SplineCurve(ellipse).convex_side == 0
    assert pc.SplineCurve(ellipse, periodic=True).planar
    assert not pc.SplineCurve(wavy(), periodic=True).planar
    # A limacon with a dent, and a figure of eight, bound nothing convex.
    assert pc.FourierCurve([[0, 0], [1, 0], [0.4, 0]], [[0, 0], [0, 1], [0, 0.4]]).convex_side == 0
    assert pc.FourierCurve([[0, 0], [1, 0], [0, 0]], [[0, 0], [0, 0], [0, 1]]).convex_side == 0
    assert pc.FourierCurve([[0, 0], [1, 0], [0.1, 0]], [[0, 0], [0, 1], [0, 0.1]]).convex_side == 1


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: pc.Circle(0.0), "radius must be positive and finite, got 0.0"),
        (lambda: pc.Circle(-1.0), "got -1.0"),
        (lambda: pc.Circle(math.nan), "nan"),
        (lambda: pc.Circle("wide"), "must be a number"),
        (lambda: pc.Circle(1.0, (0.0, 7.0)), "one turn"),
        (lambda: pc.Circle(1.0, (1.0, 0.0)), "low < high"),
        (lambda: pc.Line((1.0, 1.0)), "low < high"),
        (lambda: pc.Line((1.0, math.nan)), "low < high"),
        (lambda: pc.Line(3.0), "two numbers"),
        (lambda: pc.Ellipse(1.0, math.inf), "b must be finite"),
        (lambda: pc.Helix(1.0, math.inf), "pitch"),
        (lambda: pc.Cycloid(1.0, (-4.0, 0.0)), "cusps"),
        (lambda: pc.FourierCurve([[0, 0, 0]], [[0, 0, 0]]), "n > 0"),
        (lambda: pc.FourierCurve(np.zeros((3, 3)), np.zeros((3, 3))), "zero"),
        (lambda: pc.FourierCurve(np.ones((3, 3)), np.ones((2, 3))), "3 rows of cosine but 2 of sine"),
        (lambda: pc.Sphere(-2.0), "got -2.0"),
        (lambda: pc.Ellipsoid(1.0, 0.0, 1.0), "b must be positive"),
        (lambda: pc.Cylinder(1.0, domain=(1.0, 2.0)), r"domain\[0\]"),
        (lambda: pc.Cylinder(1.0, domain=((0.0, 9.0), None)), "one turn"),
        (lambda: pc.Cylinder(1.0, domain=3.0), "pair"),
        (lambda: pc.Cone(1.6), "less than pi/2, got 1.6"),
        (lambda: pc.Cone(0.5, (None, (-1.0, 1.0))), "apex"),
        (lambda: pc.Torus(1.0, 1.0), "less than major"),
        (lambda: pc.Circle(1.0).evaluate((1.0, 2.0)), "1 parameters, got 2"),
        (lambda: pc.Sphere(1.0).evaluate((1.0, 2.0), chart=2), "charts \\(0, 1\\), there is no number 2"),
    ],
)
def test_bad_numbers_are_refused_by_name(build, message):
    with pytest.raises(ContourError, match=message):
        build()


# Drawing and searching.


def test_samples_cover_the_domain():
    assert pc.Point().samples().shape == (1, 0)
    circle = pc.Circle(1.0).samples(8)[:, 0]
    assert circle == pytest.approx(-math.pi + math.pi / 4 * np.arange(8))
    arc = pc.Circle(1.0, (0.0, 1.0)).samples(3)[:, 0]
    assert arc.tolist() == [0.0, 0.5, 1.0]
    sphere = pc.Sphere(1.0).samples((4, 3))
    assert sphere.shape == (12, 2)
    assert sphere[:3, 1].tolist() == [-math.pi / 2, 0.0, math.pi / 2]
    with pytest.raises(ContourError, match="window"):
        pc.Plane().samples(3)
    assert pc.Plane().samples(2, ((0, 1), (2, 3))).tolist() == [[0, 2], [0, 3], [1, 2], [1, 3]]
    half = pc.Cone(0.3).samples((3, 2), (None, (-1.0, 2.0)))
    assert set(half[:, 1]) == {0.0, 2.0}
    with pytest.raises(ContourError, match="window must have 2"):
        pc.Plane().samples(3, ((0, 1),))
    with pytest.raises(ContourError, match="at least 2"):
        pc.Circle(1.0).samples(1)


def test_polyline_of_a_closed_curve_closes():
    line = pc.Circle(2.0).polyline(60)
    assert np.abs(line[0] - line[-1]).max() < 1e-14
    length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
    assert length == pytest.approx(59 * 4 * math.sin(math.pi / 59), rel=1e-13)
    with pytest.raises(ContourError, match="not a curve"):
        pc.Plane().polyline()


def test_meshes_enclose_their_volume():
    """Volume by the divergence theorem: right only if every triangle is there once and faces outwards."""
    for contour, volume in [
        (pc.Sphere(1.0), 4 / 3 * math.pi),
        (pc.Ellipsoid(1.0, 2.0, 0.5), 4 / 3 * math.pi),
        (pc.Torus(2.0, 0.5), 2 * math.pi**2 * 2 * 0.25),
    ]:
        vertices, faces = contour.mesh((160, 80))
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        found = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
        # Inscribed polyhedra miss a part of the order (2 pi / n)^2.
        assert volume * 0.995 < found < volume
    vertices, faces = pc.Plane().mesh(3, ((0, 1), (0, 1)))
    assert vertices.shape == (9, 3)
    assert len(faces) == 8
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    with pytest.raises(ContourError, match="not a surface"):
        pc.Line().mesh()


def test_every_public_contour_has_an_example():
    for name in pc.__all__:
        assert ">>> " in getattr(pc, name).__doc__, name


@pytest.mark.parametrize(
    ("shape", "written"),
    [
        (pc.Plane(), "Plane()"),
        (pc.Plane(((-1, 1), None)), "Plane(domain=((-1, 1), None))"),
        (pc.Circle(np.float64(0.3)), "Circle(radius=0.3)"),
        (pc.Ellipsoid(1.0, c=3, b=2), "Ellipsoid(a=1.0, b=2, c=3)"),
        (pc.FourierCurve(COSINE, SINE), "FourierCurve(cosine=array(4, 3), sine=array(4, 3))"),
        (pc.ParametricCurve(fourier_sum, (-1, 1)), "ParametricCurve(f=fourier_sum, domain=(-1, 1))"),
        (pc.ConstantTwist(angular=(0, 0, 1)), "ConstantTwist(angular=(0, 0, 1))"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_contours_are_shown_as_they_were_written(shape, written):
    assert repr(shape) == written
    assert repr(copy.copy(shape)) == written


INF = math.inf


@pytest.mark.parametrize(
    ("shape", "ends"),
    [
        (pc.Point(), (-INF, INF, -INF, INF)),
        (pc.Circle(1.0), (-INF, INF, -INF, INF)),
        (pc.Circle(1.0, (0.0, 1.0)), (0.0, 1.0, -INF, INF)),
        (pc.Cycloid(1.0), (1e-4 - math.pi, math.pi - 1e-4, -INF, INF)),
        (pc.Plane(((-1, 2), None)), (-1.0, 2.0, -INF, INF)),
        (pc.Sphere(1.0), (-INF, INF, -INF, INF)),
        (pc.Cone(0.4, (None, (0.0, 2.0))), (-INF, INF, 1e-6, 2.0)),
        (pc.SurfaceOfRevolution(lambda s: (1.0 + 0.1 * s, s), (0.0, 2.0)), (-INF, INF, 0.0, 2.0)),
        (pc.SurfaceOfRevolution(lambda s: (math.sin(s), -math.cos(s)), (0.0, 2.0)), (-INF, INF, -INF, 2.0)),
        (pc.SurfaceOfRevolution(lambda s: (math.cos(s), math.sin(s)), (-1.0, math.pi / 2)), (-INF, INF, -1.0, INF)),
    ],
    ids=lambda value: repr(value) if isinstance(value, pc.Contour) else "",
)
def test_contacts_end_where_the_contour_does(shape, ends):
    assert shape.ends().tolist() == pytest.approx(ends)
