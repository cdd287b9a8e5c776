"""Formulas as contours: traced tapes and fits against independent differentiation."""

import functools
import math
from math import cos, sin

import numba
import numpy as np
import pytest
from calling import instructions, traced_tape
from scipy.special import j0, j1, jv
from test_contours import ROUNDING, grid, reference

import pincontact.contours as pc
from pincontact.contours.base import (
    F_1,
    F_1T,
    F_2,
    F_2T,
    F_11,
    F_12,
    F_22,
    F_T,
    F_TT,
    F,
)
from pincontact.contours.graph import Untraceable
from pincontact.contours.piecewise import fitted
from pincontact.contours.splines import height_spline
from pincontact.contours.tape import COUNT, traced
from pincontact.errors import ContourError

CURVE_IN_TIME = {(0, 0): F, (1, 0): F_1, (2, 0): F_11, (0, 1): F_T, (1, 1): F_1T, (0, 2): F_TT}
SURFACE_IN_TIME = {
    (0, 0, 0): F,
    (1, 0, 0): F_1,
    (0, 1, 0): F_2,
    (2, 0, 0): F_11,
    (1, 1, 0): F_12,
    (0, 2, 0): F_22,
    (0, 0, 1): F_T,
    (1, 0, 1): F_1T,
    (0, 1, 1): F_2T,
    (0, 0, 2): F_TT,
}


def check(rows, expected, orders, tolerance):
    scale = max(1.0, *(np.abs(value).max() for value in expected.values()))
    for order, row in orders.items():
        error = np.abs(rows[row] - expected[order]).max() / scale
        assert error < tolerance, f"derivative {order} is off by {error:.1e}"


# Every function, in each of its spellings, and what it is in complex arithmetic; on (0.2, 0.8).
UNARY = {
    "sin": ([math.sin, np.sin], np.sin),
    "cos": ([math.cos, np.cos], np.cos),
    "tan": ([math.tan, np.tan], np.tan),
    "asin": ([math.asin, np.arcsin], np.arcsin),
    "acos": ([math.acos, np.arccos], np.arccos),
    "atan": ([math.atan, np.arctan], np.arctan),
    "sinh": ([math.sinh, np.sinh], np.sinh),
    "cosh": ([math.cosh, np.cosh], np.cosh),
    "tanh": ([math.tanh, np.tanh], np.tanh),
    "asinh": ([math.asinh, np.arcsinh], np.arcsinh),
    "acosh": ([lambda x: math.acosh(1.5 + x), lambda x: np.arccosh(1.5 + x)], lambda x: np.arccosh(1.5 + x)),
    "atanh": ([math.atanh, np.arctanh], np.arctanh),
    "exp": ([math.exp, np.exp], np.exp),
    "exp2": ([np.exp2, lambda x: 2**x], lambda x: np.exp(x * np.log(np.longdouble(2)))),
    "expm1": ([math.expm1, np.expm1], np.expm1),
    "log": ([math.log, np.log], np.log),
    "log1p": ([math.log1p, np.log1p], np.log1p),
    "log2": ([math.log2, np.log2, lambda x: math.log(x, 2)], lambda x: np.log(x) / np.log(np.longdouble(2))),
    "log10": ([math.log10, np.log10], lambda x: np.log(x) / np.log(np.longdouble(10))),
    "sqrt": ([math.sqrt, np.sqrt, lambda x: x**0.5], np.sqrt),
    "square": ([np.square, lambda x: x**2, lambda x: x * x, lambda x: pow(x, 2)], lambda x: x * x),
    "reciprocal": ([np.reciprocal, lambda x: 1 / x, lambda x: x**-1], lambda x: 1 / x),
    "abs": ([abs, math.fabs, np.abs, np.absolute], lambda x: x),
    "radians": ([math.radians, np.radians, np.deg2rad], lambda x: x * np.longdouble(math.pi / 180)),
    "degrees": ([math.degrees, np.degrees, np.rad2deg], lambda x: x / np.longdouble(math.pi / 180)),
    "powers": (
        [lambda x: x**3 + x**2.5 + x**-1.5, lambda x: math.pow(x, 3) + np.power(x, 2.5) + x**-1.5],
        lambda x: x**3 + np.exp(2.5 * np.log(x)) + np.exp(-1.5 * np.log(x)),
    ),
    "exponent": (
        [lambda x: 1.7**x, lambda x: math.pow(1.7, x), lambda x: np.power(1.7, x)],
        lambda x: np.exp(x * np.log(np.longdouble(1.7))),
    ),
    "to itself": (
        [lambda x: x**x, lambda x: math.pow(x, x), lambda x: np.float_power(x, x)],
        lambda x: np.exp(x * np.log(x)),
    ),
    "atan2": ([lambda x: math.atan2(x, 1 + x), lambda x: np.arctan2(x, 1 + x)], lambda x: np.arctan(x / (1 + x))),
    "atan2 with numbers": (
        [lambda x: math.atan2(0.5, x) + math.atan2(x, 2)],
        lambda x: np.arctan(0.5 / x) + np.arctan(x / 2),
    ),
    "hypot": (
        [lambda x: math.hypot(x, 2), lambda x: np.hypot(2, x), lambda x: math.hypot(x, 1, math.sqrt(3))],
        lambda x: np.sqrt(x * x + 4),
    ),
    "arithmetic": (
        [lambda x: -(2 * x - 3) / (x + 4) + +x - (1 - x) * (x - 1) - x / 8 + 7 / (x + 2)],
        lambda x: -(2 * x - 3) / (x + 4) + x - (1 - x) * (x - 1) - x / 8 + 7 / (x + 2),
    ),
}


@pytest.mark.parametrize("name", UNARY)
def test_every_function_and_its_derivatives(name):
    spellings, exact = UNARY[name]
    for function in spellings:

        def f(u, v, t, function=function):
            x = 0.3 * u + 0.2 * v * v + 0.1 * u * t
            return u + x, v + function(x), x * function(x)

        surface = pc.ParametricSurface(f, ((0.5, 1.0), (0.3, 0.8)))
        assert surface.evaluator is traced
        assert surface.time_dependent

        def formula(u, v, t):
            # The constants of f are doubles; so are these.
            x = np.longdouble(0.3) * u + np.longdouble(0.2) * v * v + np.longdouble(0.1) * u * t
            return u + x, v + exact(x), x * exact(x)

        for point in [(0.5, 0.3, 0.1), (1.0, 0.8, 0.5), (0.77, 0.41, 0.33)]:
            rows = surface.evaluate(point[:2], point[2])
            # A chain of about ten operations in double precision, each of which rounds once.
            check(rows, reference(formula, point, SURFACE_IN_TIME, radius=0.02), SURFACE_IN_TIME, 2e-14)


def test_powers_are_smooth_at_zero():
    curve = pc.ParametricCurve(lambda u: (u**2, u**3, u**4 + 0.5 * u), (-1.0, 1.0))
    assert curve.evaluate(0.0)[[F, F_1, F_11]].tolist() == [[0, 0, 0], [0, 0, 0.5], [2, 0, 0]]
    assert curve.evaluate(-0.5)[[F, F_1, F_11]].tolist() == [[0.25, -0.125, -0.1875], [-1, 0.75, 0], [2, -3, 3]]


RADIUS = 0.3


def offset(x):
    return helper(x, RADIUS) + 1


def helper(x, scale=2.0):
    return scale * sin(x) * np.cos(x)


def recursive(x, n):
    return x if n == 0 else math.sin(recursive(x, n - 1)) + x / 2


class Ring:
    def __init__(self, radius):
        self.radius = radius

    def __call__(self, u):
        return self.radius * math.cos(u), self.radius * math.sin(u), helper(u)

    def method(self, u):
        return self(u)

    @staticmethod
    def static(u):
        return cos(u), sin(u), offset(u)


def closure(scale):
    shift = 2 * scale

    def inner(u):
        def innermost(x):
            return shift * math.sin(x)

        return [scale * u, innermost(u), sum(math.cos(k * u) for k in range(1, 4))]

    return inner


def filled(u):
    out = np.zeros(3)
    out[0] = math.cos(u)
    out[1:] = np.array([math.sin(u), u])
    return out


def rotated(u):
    angle = 0.3
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return turn @ np.array([np.cos(u), 2 * np.sin(u), u], dtype=float)


def vectorial(u):
    p = np.asarray([np.cos(u), np.sin(u), 1 + u * u])
    tangent = np.array([-np.sin(u), np.cos(u), 2 * u])
    return p + 0.1 * np.cross(p, tangent) / np.linalg.norm(tangent) + 0.01 * np.sin(p) * np.dot(p, p)


def local_import(u):
    import math as m

    import numpy

    return m.cos(u), numpy.sin(u), float(u) * m.pi


@numba.njit
def compiled(u):
    return math.cos(u), math.sin(u), 0.2 * u


SPELLINGS = {
    "global helper": lambda u: (math.cos(u), math.sin(u), offset(u)),
    "recursion": lambda u: (u, recursive(u, 3), 1.0),
    "callable object": Ring(0.4),
    "inherited call": type("Child", (Ring,), {})(0.4),
    "bound method": Ring(0.4).method,
    "static method": Ring.static,
    "closure": closure(0.7),
    "array filled in": filled,
    "rotation matrix": rotated,
    "vector algebra": vectorial,
    "import inside": local_import,
    "partial": functools.partial(lambda a, u: (a * u, math.sin(u), cos(a)), 0.5),
    "numba": compiled,
    "numpy scalar constants": lambda u: np.array([np.float64(2.0) * u, u * np.int64(3), np.pi - u]),
    "array of constants": lambda u: np.array([1.0, 2.0, 3.0]) * u + np.arange(3),
    "keyword default": lambda u, a=0.3: (u, a * u * u, math.sqrt(1 + u * u)),
}


@pytest.mark.parametrize("name", SPELLINGS)
def test_ways_of_writing_a_function(name):
    function = SPELLINGS[name]
    curve = pc.ParametricCurve(function, (-1.0, 2.0))
    assert curve.evaluator is traced
    assert curve.fit_error == 0.0
    for u in (-0.9, 0.3, 1.7):
        rows = curve.evaluate(u)
        assert np.abs(rows[F] - np.asarray(function(u), dtype=float)).max() < 1e-15 * 20
        h = 1e-3
        values = {k: np.asarray(function(u + k * h), dtype=float) for k in range(-3, 4)}
        first = (45 * (values[1] - values[-1]) - 9 * (values[2] - values[-2]) + values[3] - values[-3]) / (60 * h)
        second = (270 * (values[1] + values[-1]) - 27 * (values[2] + values[-2]) + 2 * (values[3] + values[-3])) / (
            180 * h * h
        ) - 490 * values[0] / (180 * h * h)
        # Sixth-order differences: rounding 1e-16 / h and 1e-16 / h^2.
        assert np.abs(rows[F_1] - first).max() < 1e-11
        assert np.abs(rows[F_11] - second).max() < 1e-8


FORMS = (
    "({0} + {1})",
    "({0} - {1})",
    "({0} * {1})",
    "({0}) / (3 + sin({1}))",
    "sin({0})",
    "cos({0})",
    "exp(sin({0}))",
    "sqrt(2 + cos({0}))",
    "tanh({0})",
    "log(2.5 + sin({0}))",
    "(2 + sin({0})) ** cos({1})",
    "cos({0}) ** 3",
    "-({0})",
)


def expression(generator, depth, names="uvt", forms=FORMS):
    """A random formula of these variables as text; smooth wherever its arguments are real."""
    if depth == 0:
        return str(generator.choice([*names, f"{generator.uniform(-2, 2):.3f}"]))
    parts = [expression(generator, depth - 1, names, forms) for _ in range(2)]
    return str(generator.choice([form.format(*parts) for form in forms]))


def test_random_formulas():
    generator = np.random.default_rng(2024)
    used = 0
    for _ in range(60):
        text = ", ".join(expression(generator, 3) for _ in range(3))
        real = eval(f"lambda u, v, t: ({text})", dict(vars(math)))
        tape = traced_tape(real, "uvt", 3)
        names = {name: getattr(np, name) for name in ("sin", "cos", "exp", "sqrt", "tanh", "log")}
        exact = eval(f"lambda u, v, t: ({text})", names)
        surface = pc.Contour(traced, 2, pool=tape.pool, time_dependent=tape.time_dependent)
        point = generator.uniform(-1, 1, 3)
        expected = reference(exact, point, SURFACE_IN_TIME, radius=0.02, nodes=12)
        # Depth three: conditioning of nested functions multiplies rounding by tens.
        check(surface.evaluate(point[:2], point[2]), expected, SURFACE_IN_TIME, 1e-13)
        used += tape.pool[COUNT] > 5
    assert used > 30


# Tape against closed forms: the same contour, written twice.


@pytest.mark.parametrize(
    ("closed", "formula"),
    [
        (pc.Circle(0.3), lambda u: (0.3 * math.cos(u), 0.3 * math.sin(u), 0)),
        (pc.Ellipse(0.3, 2.0), lambda u: (0.3 * math.cos(u), 2.0 * math.sin(u), 0.0)),
        (pc.Helix(0.3, 0.1), lambda u: (0.3 * math.cos(u), 0.3 * math.sin(u), 0.1 * u / (2 * math.pi))),
        (pc.Cycloid(0.3), lambda u: (0.3 * (u + math.sin(u)), 0.3 * (1 - math.cos(u)), 0)),
        (
            pc.Ellipsoid(1.0, 2.0, 3.0),
            lambda u, v: (math.cos(u) * math.cos(v), 2 * math.sin(u) * math.cos(v), 3 * math.sin(v)),
        ),
        (
            pc.Torus(2.0, 0.5),
            lambda u, v: (
                (2 + 0.5 * math.cos(v)) * math.cos(u),
                (2 + 0.5 * math.cos(v)) * math.sin(u),
                0.5 * math.sin(v),
            ),
        ),
    ],
    ids=lambda value: value.name if isinstance(value, pc.Contour) else "",
)
def test_tape_equals_closed_form(closed, formula):
    domain = closed.domain if np.isfinite(closed.domain).all() else ((-3.0, 3.0),)
    if closed.dimension == 1:
        traced = pc.ParametricCurve(formula, domain[0], closed.periodic[0])
    else:
        traced = pc.ParametricSurface(formula, domain, closed.periodic)
    assert traced.planar == closed.planar
    if closed.dimension == 1:
        assert traced.convex_side == closed.convex_side
    for u in grid(*domain):
        assert np.abs(traced.evaluate(u) - closed.evaluate(u)).max() < ROUNDING * closed.size


def test_height_field_of_a_function():
    field = pc.HeightField(lambda x, y: 0.1 * math.sin(3 * x) * math.cos(2 * y))
    rows = field.evaluate((0.3, 0.4))
    assert rows[[F, F_1, F_2], :2].tolist() == [[0.3, 0.4], [1, 0], [0, 1]]
    assert not rows[[F_11, F_12, F_22], :2].any()
    assert rows[F_12, 2] == pytest.approx(-0.6 * math.cos(0.9) * math.sin(0.8), rel=1e-14)
    moving = pc.HeightField(lambda x, y, t: 0.1 * math.sin(x - 2 * t))
    assert moving.time_dependent
    assert moving.evaluate((0.3, 0.0), 0.7)[[F_T, F_1T, F_TT], 2] == pytest.approx(
        [-0.2 * math.cos(-1.1), 0.2 * math.sin(-1.1), -0.4 * math.sin(-1.1)], rel=1e-14
    )
    assert pc.HeightField(np.arange(7.0), np.arange(8.0), np.zeros((7, 8))).evaluator is height_spline
    given = pc.HeightField(
        lambda x, y: j0(x) * y,
        domain=((1.0, 2.0), (0.0, 0.5)),
        derivatives=lambda x, y: (-j1(x) * y, j0(x), -0.5 * (j0(x) - jv(2, x)) * y, -j1(x), 0.0),
    )
    assert given.evaluator is fitted
    assert given.evaluate((1.3, 0.4))[F_11, 2] == pytest.approx(-0.2 * (j0(1.3) - jv(2, 1.3)), abs=2e-11)


# Time.


def test_curve_that_depends_on_time():
    def f(u, t):
        r = 1 + 0.1 * math.sin(3 * u - 2 * t)
        return r * math.cos(u), r * math.sin(u), 0.0

    curve = pc.ParametricCurve(f, (-math.pi, math.pi), periodic=True)
    assert curve.time_dependent
    assert curve.planar
    assert curve.convex_side == 0

    def formula(u, t):
        r = 1 + np.longdouble(0.1) * np.sin(3 * u - 2 * t)
        return r * np.cos(u), r * np.sin(u), 0

    for point in grid((-math.pi, math.pi), (0.0, 5.0), n=6):
        check(curve.evaluate(point[:1], point[1]), reference(formula, point, CURVE_IN_TIME), CURVE_IN_TIME, 2e-14)


def test_time_that_does_not_matter_is_dropped():
    curve = pc.ParametricCurve(lambda u, t: (u, u * u + 0 * t, 0), (-1.0, 1.0))
    assert not curve.time_dependent
    assert pc.ParametricCurve(lambda u, t=0.0: (u, t * u, 0), (-1.0, 1.0)).time_dependent
    assert not pc.ParametricCurve(lambda u, a=2.0: (u, a * u, 0), (-1.0, 1.0)).time_dependent


# Size of tapes.


def test_common_parts_are_computed_once():
    tape = traced_tape(lambda u, v: (math.cos(u) * math.cos(v), math.sin(u) * math.cos(v), math.sin(v)), "uv", 3)
    assert tape.pool[COUNT] == 4  # one sine-cosine pair for u, one for v, two products
    assert instructions(lambda u: (u, 2 * u + 0 * math.sin(u), (u - u) + 1), "u", 3) == 1
    assert instructions(lambda u: (math.sin(u + 1), math.sin(1 + u), -math.sin(u + 1)), "u", 3) == 3
    assert instructions(lambda u: (u * 1.0, u**1, u + 0.0), "u", 3) == 0
    assert traced_tape(lambda u: (1, 2, 3.5), "u", 3).constants == (1.0, 2.0, 3.5)


@pytest.mark.parametrize(
    "function",
    [
        lambda u: (u, 1.0 if u > 0 else 0.0, 0),
        lambda u: (u, max(u, 0.0), 0),
        lambda u: (u, u % 2, 0),
        lambda u: (u, math.floor(u), 0),
        lambda u: (u, round(u), 0),
        lambda u: (u, j0(u), 0),
        lambda u: (u, [1, 2][u], 0),
        lambda u: (u, (-2) ** u, 0),
        lambda u: (u, np.interp(u, [0, 1], [0, 1]), 0),
        lambda u: (u, np.sign(u), 0),
        lambda u: (u, u == 1, 0),
        lambda u: (u, 1j * u, 0),
        lambda u: (u, u),
        lambda u: (u, "three", 0),
    ],
)
def test_what_cannot_be_traced_is_noticed(function):
    with pytest.raises(Untraceable):
        traced_tape(function, "u", 3)


# Fits.


def bessel(u):
    return np.array([u, j0(u), j1(u)])


def bessel_derivatives(u):
    first = np.array([1.0, -j1(u), 0.5 * (j0(u) - jv(2, u))])
    second = np.array([0.0, -0.5 * (j0(u) - jv(2, u)), 0.25 * (jv(3, u) - 3 * j1(u))])
    return first, second


@pytest.mark.parametrize("given", [None, bessel_derivatives])
def test_fitted_curve(given):
    curve = pc.ParametricCurve(bessel, (0.0, 20.0), derivatives=given)
    assert curve.evaluator is fitted
    # Fitted to rounding: the largest entry is 20.
    assert 0.0 < curve.fit_error < 20 * 1e-14
    worst = np.zeros(3)
    for u in np.linspace(0, 20, 401):
        rows = curve.evaluate(u)
        first, second = bessel_derivatives(u)
        worst = np.maximum(
            worst, [np.abs(rows[r] - e).max() for r, e in ((F, bessel(u)), (F_1, first), (F_11, second))]
        )
    # Differentiating a polynomial of degree 12 on a piece of length 1 to 2 costs (12^2)^n rounding errors of 20;
    # derivatives that are given spare one of these factors per differentiation.
    assert worst[0] < 1e-13
    assert worst[1] < (1e-11 if given is None else 5e-13)
    assert worst[2] < (1e-9 if given is None else 2e-11)


def test_fitted_periodic_curve_closes():
    curve = pc.ParametricCurve(
        lambda u: (math.cos(u), math.sin(u), float(j0(math.sin(u)))), (-math.pi, math.pi), periodic=True
    )
    # One end of the last piece and one of the first: rounding, times (12^2)^2 in second derivatives.
    assert np.abs(curve.evaluate(-math.pi) - curve.evaluate(math.pi)).max() < 2e-9
    assert np.abs(curve.evaluate(0.3) - curve.evaluate(0.3 - 4 * math.pi)).max() < 1e-10
    flat = pc.ParametricCurve(lambda u: (j0(u), j1(u), 0.0), (0.1, 1.0))
    assert flat.planar


@pytest.mark.parametrize("with_derivatives", [False, True])
def test_fitted_surface(with_derivatives):
    def f(u, v):
        return np.array([u, v, j0(u) * math.sin(v)])

    def derivatives(u, v):
        (_, d, _), (_, dd, _) = bessel_derivatives(u)
        s, c = math.sin(v), math.cos(v)
        rows = np.zeros((5, 3))
        rows[0, 0] = rows[1, 1] = 1.0
        rows[:, 2] = d * s, j0(u) * c, dd * s, d * c, -j0(u) * s
        return rows

    surface = pc.ParametricSurface(f, ((0.0, 2.0), (0.0, 1.5)), derivatives=derivatives if with_derivatives else None)
    assert surface.evaluator is fitted
    assert surface.fit_error < 1e-13
    tolerance = 5e-11 if with_derivatives else 2e-9  # as for curves
    for u in grid((0.0, 2.0), (0.0, 1.5), n=8):
        rows = surface.evaluate(u)
        assert np.abs(rows[F] - f(*u)).max() < 1e-13
        assert np.abs(rows[[F_1, F_2, F_11, F_12, F_22]] - derivatives(*u)).max() < tolerance


def test_fitted_curve_in_time():
    curve = pc.ParametricCurve(lambda u, t: (u, float(j0(u - t)), 0.0), (0.0, 4.0), time_domain=(0.0, 2.0))
    assert curve.time_dependent
    x = 1.3 - 0.4
    d, dd = -j1(x), -0.5 * (j0(x) - jv(2, x))
    found = curve.evaluate(1.3, 0.4)[[F, F_1, F_11, F_T, F_1T, F_TT], 1]
    assert found == pytest.approx([j0(x), d, dd, -d, -dd, dd], abs=5e-10)


def test_smooth_branches_are_fitted_and_rough_ones_refused():
    def blend(u):  # third derivative jumps: twice differentiable is enough
        return u, (u**3 if u > 0.3 else u**3 + (u - 0.3) ** 4), 0.0

    curve = pc.ParametricCurve(blend, (-1.0, 1.0))
    assert curve.evaluate(0.30001)[F_11, 1] == pytest.approx(1.80006, abs=1e-7)
    for kinked in (lambda u: (u, u if u > 0.3 else 0.3, 0.0), lambda u: (u, float(u > 0.123), 0.0)):
        with pytest.raises(ContourError, match=r"near \(0\.(3|1|2)"):
            pc.ParametricCurve(kinked, (-1.0, 1.0))


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: pc.ParametricCurve(lambda u: (u, abs(u), 0), (-1.0, 1.0)),
            "first derivative jumps by 2.0e.00 near .0",
        ),
        (lambda: pc.ParametricCurve(lambda u: (u, u), (-1.0, 1.0)), "3 numbers"),
        (lambda: pc.ParametricCurve(lambda u: (u, math.log(u), 0), (-1.0, 1.0)), "raised ValueError"),
        (lambda: pc.ParametricCurve(lambda u: (u, math.nan, 0), (-1.0, 1.0)), "not finite"),
        (lambda: pc.ParametricCurve(lambda u: (1.0, 2.0, 3.0), (-1.0, 1.0)), "f_1 vanishes"),
        (lambda: pc.ParametricSurface(lambda u, v: (u, u, u), ((0, 1), (0, 1))), "f_1 x f_2 vanishes"),
        (lambda: pc.ParametricCurve(lambda u: (u, j0(u), 0), (0.0, math.inf)), "finite domain"),
        (lambda: pc.ParametricCurve(lambda u, t: (u, j0(u * t), 0), (0.0, 1.0)), "time_domain"),
        (lambda: pc.ParametricSurface(lambda u, v, t: (u, v, j0(t)), ((0, 1), (0, 1))), "elementary"),
        (lambda: pc.ParametricCurve(lambda u: (u, u, 0), (0.0, 1.0), periodic=True), "periodic in parameter 0"),
        (lambda: pc.ParametricCurve(lambda u: (u, u, 0), (0.0, math.inf), periodic=True), "infinite"),
        (lambda: pc.ParametricCurve(lambda: (1, 2, 3), (0.0, 1.0)), "takes 0"),
        (lambda: pc.ParametricCurve(lambda a, b, c: (1, 2, 3), (0.0, 1.0)), "takes 3"),
        (lambda: pc.ParametricCurve(7.0, (0.0, 1.0)), "function is needed"),
        (lambda: pc.ParametricCurve(lambda u: (u, u, 0), (1.0, 0.0)), "low < high"),
        (lambda: pc.ParametricSurface(lambda u, v: (u, v, 0), (0.0, 1.0)), r"domain\[0\]"),
        (lambda: pc.ParametricSurface(lambda u, v: (u, v, 0), 3.0), "low, high"),
        (lambda: pc.ParametricSurface(lambda u, v: (u, v, 0), ((0, 1), (0, 1)), True), "pair of booleans"),
        (
            lambda: pc.ParametricCurve(
                lambda u: (u, u * u, 0), (0.0, 1.0), derivatives=lambda u: ((1, 2 * u, 0), (0, 3, 0))
            ),
            r"a derivative at .* gives 2.0, the user's function 3.0",
        ),
        (
            lambda: pc.ParametricCurve(lambda u: (u, j0(u), 0), (0.0, 1.0), derivatives=lambda u: (1, 2, 3)),
            "2 x 3 numbers",
        ),
        (lambda: pc.ParametricCurve(lambda u: (u, u, 0), (0.0, 1.0), derivatives=3), "derivatives must be"),
        (lambda: pc.HeightField(lambda x, y: x, np.zeros(3)), "not both"),
    ],
)
def test_bad_formulas_are_refused_by_name(build, message):
    with pytest.raises(ContourError, match=message):
        build()


def test_a_function_with_a_hidden_argument_is_refused():
    state = np.random.default_rng(0)
    with pytest.raises(ContourError, match="the formula as compiled gives"):
        pc.ParametricCurve(lambda u: (u, state.random(), 0.0), (0.0, 1.0))
