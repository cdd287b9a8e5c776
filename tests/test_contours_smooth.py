"""Shapes are what was given: what repeats, what is smooth, and where; what is not is refused by name."""

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
import scipy
from scipy.special import j0
from shared import one_body
from test_contours_formulas import FORMS, expression

import pincontact as pc
from pincontact.contours.base import F_1, F_11, F
from pincontact.contours.enclosures import FAULTS, Interval, of_one, of_two
from pincontact.contours.piecewise import fitted
from pincontact.contours.tape import ATAN2, COSH, MULTIPLY, SQUARE, function_of_one, function_of_two, traced
from pincontact.errors import ContourError

TURNS = (-1000, -3, -1, 1, 2, 1000)
PERIOD = 1.3


def blind(function):
    """The same function as compiled code, into which nobody can look."""
    ufunc = np.frompyfunc(function, 1, 1)
    return lambda x: float(ufunc(x))


# What is periodic repeats.


def bump(u):
    """Smooth between 0 and PERIOD, and zero with two derivatives at both ends; a polynomial does not repeat."""
    return (4.0 * u * (PERIOD - u) / PERIOD**2) ** 3


def ring(function=bump, t=0.0):
    def f(u):
        r, angle = 1.0 + 0.1 * function(u) * math.cos(t), 2.0 * math.pi * u / PERIOD
        return r * math.cos(angle), r * math.sin(angle), 0.1 * math.sin(angle)

    return f


def tube(first, second):
    """A torus whose tube is thicker in places, as `first` of u and `second` of v say."""

    def f(u, v):
        a, b = 2.0 * math.pi * u / PERIOD, 2.0 * math.pi * v / PERIOD
        r = 0.3 + 0.05 * first(u) + 0.05 * second(v)
        return (1.0 + r * math.cos(b)) * math.cos(a), (1.0 + r * math.cos(b)) * math.sin(a), r * math.sin(b)

    return f


def blind_pair(function):
    """A profile that nobody can look into."""
    r, z = (blind(lambda s, i=i: function(s)[i]) for i in range(2))
    return lambda s: (r(s), z(s))


def closed_profile(function):
    """A ring's cross section, away from the axis."""
    return lambda s: (2.0 + ring(function)(s)[0], ring(function)(s)[1])


ONE, BOTH = (0.0, PERIOD), ((0.0, PERIOD), (0.0, PERIOD))
PERIODIC = {
    "traced curve": lambda: pc.ParametricCurve(ring(), ONE, periodic=True),
    "fitted curve": lambda: pc.ParametricCurve(ring(blind(bump)), ONE, periodic=True),
    "traced curve in time": lambda: pc.ParametricCurve(lambda u, t: ring(t=t)(u), ONE, periodic=True),
    "fitted curve in time": lambda: pc.ParametricCurve(
        lambda u, t: ring(t=blind(math.sin)(t))(u), ONE, periodic=True, time_domain=(0.0, 2.0)
    ),
    "traced surface": lambda: pc.ParametricSurface(tube(bump, bump), BOTH, (True, True)),
    "first parameter": lambda: pc.ParametricSurface(tube(bump, math.cos), BOTH, (True, False)),
    "second parameter": lambda: pc.ParametricSurface(tube(math.cos, bump), BOTH, (False, True)),
    "surface in time": lambda: pc.ParametricSurface(
        lambda u, v, t: tube(lambda x: bump(x) * math.cos(3.0 * t), bump)(u, v), BOTH, (True, True)
    ),
    "fitted surface": lambda: pc.ParametricSurface(tube(blind(bump), bump), BOTH, (True, True)),
    "traced profile": lambda: pc.SurfaceOfRevolution(closed_profile(bump), ONE, True),
    "fitted profile": lambda: pc.SurfaceOfRevolution(closed_profile(blind(bump)), ONE, True),
    "profile through points": lambda: pc.SurfaceOfRevolution(
        [(2.0 + 0.5 * math.cos(a), 0.6 * math.sin(a)) for a in np.arange(24) * math.pi / 12.0], periodic=True
    ),
    "spline": lambda: pc.SplineCurve([ring()(u) for u in np.arange(20) * PERIOD / 20], periodic=True),
    "spline of degree 4": lambda: pc.SplineCurve(
        [ring()(u) for u in np.arange(20) * PERIOD / 20], periodic=True, degree=4
    ),
    "spline surface": lambda: pc.SplineSurface(
        np.array([[tube(bump, bump)(u, v) for v in np.arange(12) * PERIOD / 12] for u in np.arange(13) * PERIOD / 13]),
        (True, True),
    ),
    "Fourier": lambda: pc.FourierCurve([[0, 0, 0], [1, 0, 0.1], [0.1, 0, 0]], [[0, 0, 0], [0, 1, 0], [0, 0.1, 0]]),
    "circle": lambda: pc.Circle(0.3),
    "arc of one turn": lambda: pc.Circle(0.3, (0.0, 2.0 * math.pi)),
    "ellipse": lambda: pc.Ellipse(0.3, 0.2),
    "cylinder": lambda: pc.Cylinder(0.3, (None, (-1.0, 1.0))),
    "torus": lambda: pc.Torus(0.3, 0.1),
}


@pytest.mark.parametrize("name", PERIODIC)
def test_periodic_contours_repeat_with_all_derivatives(name):
    contour = PERIODIC[name]()
    assert any(contour.periodic)
    generator = np.random.default_rng(1)
    low, high = np.array(contour.domain).T
    for _, t in itertools.product(range(4), (0.0, 0.7, 1.9)):
        u = low + (high - low) * generator.random(contour.dimension)
        there = contour.evaluate(u, t)
        for turns in TURNS:
            far = u + turns * (high - low) * contour.periodic
            # The parameter itself is rounded, to 1e3 periods times 1e-16; each derivative multiplies by up to 10 per
            # period, and second derivatives of splines and fits change by 1e4 times that from interval to interval.
            scale = np.abs(there).max()
            assert np.abs(contour.evaluate(far, t) - there).max() < 1e-9 * scale
            assert np.abs(contour.evaluate(far, t)[F] - there[F]).max() < 1e-11 * scale


def test_motions_repeat():
    times = np.linspace(0.0, 2.0, 9)
    poses = [
        pin.SE3(pin.exp3(np.array([0.3 * math.cos(a), 0.2 * math.sin(a), 0.1])), np.array([math.sin(a), 0.0, 1.0]))
        for a in math.pi * times[:-1]
    ]
    turning = [pin.SE3(pin.utils.rotate("z", a), np.array([math.cos(a), 0.0, 0.0])) for a in math.pi * times[:-1]]
    for motion in (
        pc.SplineMotion(times, poses, periodic=True),
        pc.SplineMotion(times, turning, periodic=True),
        pc.HarmonicMotion((0.1, 0.0, 0.0), 0.5, axis=(0.0, 0.0, 1.0), angle=0.3),
    ):
        for t, turns in itertools.product((0.0, 0.3, 1.7), TURNS):
            # rounding of the time, 1e3 periods times 1e-16, times second derivatives of some 100
            assert motion.evaluate(t + 2.0 * turns) == pytest.approx(motion.evaluate(t), abs=1e-9)


def wheel(periodic_rim):
    """A wheel in a plane whose rim rolls on a line: one floating body in the xy plane, gravity along -y."""
    model = one_body(pin.JointModelPlanar(), pin.Inertia(1.0, np.zeros(3), 0.04 * np.eye(3)), "wheel")
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    scene = pc.Scene(model)
    rim = scene.add_contour("rim", periodic_rim, frame="wheel")
    scene.add_contact("rim/floor", rim, scene.add_contour("floor", pc.Line()), friction=pc.NoSlip())
    return scene


@pytest.mark.parametrize("spin", [-12.0, 12.0])
@pytest.mark.parametrize("hidden", [False, True])
def test_a_wheel_with_a_periodic_rim_rolls_many_turns_on_its_true_curve(spin, hidden):
    """The formula is that of one turn. The gap is computed from the shape itself, not from the contour."""
    radius = 0.3

    def shape(u):
        return radius * (1.0 + 0.02 * (4.0 * u * (1.0 - u)) ** 3)

    length = blind(shape) if hidden else shape

    def rim(u):
        angle = 2.0 * math.pi * u
        return length(u) * math.cos(angle), length(u) * math.sin(angle), 0.0

    scene = wheel(pc.ParametricCurve(rim, (0.0, 1.0), periodic=True))
    state = scene.initial_state([0.0, 0.31, 1.0, 0.0], [-radius * spin, 0.0, spin])
    run = pc.simulate(scene, state, duration=3.0, energies=True, t_eval=np.linspace(0.0, 3.0, 61))
    assert run.status == 0, run.message
    angle = np.unwrap(np.arctan2(run.q[:, 3], run.q[:, 2]))
    assert abs(angle[-1] - angle[0]) > 5.0 * 2.0 * math.pi

    def height(u, q):
        part = u - math.floor(u)
        a = 2.0 * math.pi * part
        return q[1] + shape(part) * (q[3] * math.cos(a) + q[2] * math.sin(a))

    for q in run.q:
        lowest = (-0.25 - math.atan2(q[3], q[2]) / (2.0 * math.pi)) % 1.0
        found = scipy.optimize.minimize_scalar(
            height, bounds=(lowest - 0.1, lowest + 0.1), args=(q,), method="bounded", options={"xatol": 1e-12}
        )
        # the lowest point of the true rim lies on the line: some roundings of 0.3 m
        assert abs(found.fun) < 5e-15
    # 12 J; rtol 1e-8 over five turns, with a third derivative that jumps once a turn
    assert abs(run.energies().balance).max() < 1e-8


def test_random_periodic_formulas_are_taken_and_repeat():
    generator = np.random.default_rng(5)
    for _ in range(60):
        harmonics = generator.uniform(-0.1, 0.1, (4, 2))
        low = generator.uniform(-20.0, 20.0)
        period = generator.uniform(0.1, 30.0)
        power, size = int(generator.integers(3, 6)), generator.uniform(0.05, 0.5)

        def f(u, harmonics=harmonics, low=low, period=period, power=power, size=size):
            x = (u - low) / period
            a = 2.0 * math.pi * x
            r = 1.0 + sum(c * math.cos(k * a) + s * math.sin(k * a) for k, (c, s) in enumerate(harmonics, 1)) / 3.0
            r += size * (4.0 * x * (1.0 - x)) ** power
            return r * math.cos(a), r * math.sin(a), 0.0

        curve = pc.ParametricCurve(f, (low, low + period), periodic=True)
        assert curve.evaluator is traced
        for u in low + period * generator.random(4):
            for turns in TURNS[1:-1]:
                assert np.abs(curve.point(u + turns * period) - np.array(f(u))).max() < 1e-12


# What does not close is refused.


@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize(
    ("seam", "message"),
    [
        (lambda u: 1e-6 * u, "f is|the function jumps"),
        (
            lambda u: 0.06 * 4.0 * u * (PERIOD - u) / PERIOD,
            "derivative of f by u is|first derivative jumps",
        ),  # 7 degrees
        (lambda u: 1e-5 * u * (PERIOD - u), "derivative of f by u is|first derivative jumps"),
        (lambda u: 1e-4 * u**2 * (PERIOD - u) ** 3, "by u and u is|second derivative jumps"),
    ],
)
def test_curves_that_do_not_close_are_refused(seam, message, hidden):
    with pytest.raises(ContourError, match=rf"period.*({message})|({message}).*period"):
        pc.ParametricCurve(ring(blind(seam) if hidden else seam), ONE, periodic=True)
    with pytest.raises(ContourError, match=message):
        pc.SurfaceOfRevolution(closed_profile(blind(seam) if hidden else seam), ONE, periodic=True)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_seams_are_looked_at_all_along_and_at_many_times(order):
    """They close at t = 0, or everywhere but in a part of the other parameter."""

    def open_seam(u):
        return u ** (order + 1) * (PERIOD - u) ** order if order else u

    def in_time(u, t):
        return ring(lambda x: open_seam(x) * t)(u)

    with pytest.raises(ContourError, match="periodic in parameter 0"):
        pc.ParametricCurve(in_time, ONE, periodic=True)
    with pytest.raises(ContourError, match="periodic"):
        pc.ParametricCurve(
            lambda u, t: ring(lambda x: open_seam(x) * blind(math.sin)(t))(u), ONE, True, time_domain=(0.0, 1.0)
        )
    generator = np.random.default_rng(order)
    for axis in (0, 1):
        middle = PERIOD * generator.random()

        def f(u, v, t, axis=axis, middle=middle):
            across, along = (u, v) if axis == 0 else (v, u)
            local = math.exp(-(((along - middle) / 0.03) ** 2)) * math.sin(t)
            r = 0.3 + 0.1 * open_seam(across) * local
            a, b = 2.0 * math.pi * u / PERIOD, 2.0 * math.pi * v / PERIOD
            return (1.0 + r * math.cos(b)) * math.cos(a), (1.0 + r * math.cos(b)) * math.sin(a), r * math.sin(b)

        wraps = (axis == 0, axis == 1)
        with pytest.raises(ContourError, match=f"periodic in parameter {axis}"):
            pc.ParametricSurface(f, BOTH, wraps)
        with pytest.raises(ContourError, match=f"periodic in parameter {axis}"):
            pc.ParametricSurface(lambda u, v, f=f: f(u, v, 1.0), BOTH, wraps)
        pc.ParametricSurface(lambda u, v, t, f=f: f(u, v, 0.0 * t), BOTH, wraps)


def test_a_given_spline_that_is_called_periodic_must_close():
    u = np.linspace(0.0, PERIOD, 30)
    almost = np.array([ring(lambda x: 0.01 * x * (PERIOD - x))(x) for x in u])
    with pytest.raises(ContourError, match="periodic, but derivative 1"):
        pc.SplineCurve(scipy.interpolate.make_interp_spline(u, almost, k=5), periodic=True)


# What is smooth is taken, what is not is refused.

D = (-1.0, 1.0)


def curve(function, domain=D, **options):
    return pc.ParametricCurve(lambda u: (u, function(u), 0.0), domain, **options)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: math.sqrt(x * x), "u = .*e-10: f takes the square root of a quantity that falls to zero"),
        (lambda x: (x * x) ** 0.5, "square root"),
        (lambda x: math.sqrt(x * x - 0.6 * x + 0.09), "u = 0.3.*square root"),
        (lambda x: np.linalg.norm(np.array([x, 0.0 * x])), "square root"),
        (lambda x: math.hypot(x, 0.0), "square root"),
        (lambda x: math.hypot(x - 0.3, x * x - 0.09), "u = 0.3.*square root"),
        (lambda x: (x * x) ** 1.5, "a power"),
        (lambda x: (x * x) ** (0.5 + 0.1 * x), "logarithm"),
        (lambda x: 1.0 / (x - 0.7), "denominator"),
        (lambda x: math.sin(x - 0.1) / (x - 0.1), "denominator"),
        (lambda x: (x - 0.2) ** -2, "a power"),
        (lambda x: math.log((x + 0.5) ** 2), "logarithm"),
        (lambda x: math.tan(2.0 * x), "tangent"),
        (lambda x: math.acos(math.cos(x)), "arc sine or cosine"),
        (lambda x: math.asin(math.sin(2.0 * x)), "arc sine or cosine"),
        (lambda x: math.acosh(1.0 + x * x), "inverse hyperbolic cosine"),
        (lambda x: math.atan2(x, -1.0), "f jumps by 6.28e.00.*atan2"),
        (lambda x: math.atan2(x - 0.3, -1.0) ** 2, "derivatives by up to.*atan2"),
        (lambda x: math.atan2(x * x, x), "angle of a vector that vanishes"),
        (lambda x: abs(x), "first derivative jumps by 2.0e.00 near .0."),
        (lambda x: math.fabs(x - 0.3), "first derivative jumps by 2.0e.00 near .0.3."),
        (lambda x: x * x / abs(x - 0.1) if x != 0.1 else 0.0, "near"),
        (lambda x: x * abs(x), "second derivative jumps by 4.0e.00 near .0."),
        (lambda x: max(x, 0.0), "first derivative jumps by 1"),
        (lambda x: np.maximum(x, 0.1), "first derivative jumps by 1.* near .0.1"),
        (lambda x: np.where(x > 0.1, x, 0.1), "first derivative jumps by 1.* near .0.1"),
        (lambda x: np.clip(x, -0.2, 0.4), "first derivative jumps by 1.*"),
        (lambda x: np.sign(x - 0.3), "jumps by 2.* near .0.3"),
        (lambda x: math.copysign(1.0, x), "the function jumps by 2.* near .0."),
        (lambda x: math.floor(3.0 * x), "the function jumps by 1"),
        (lambda x: math.ceil(3.0 * x), "the function jumps by 1"),
        (lambda x: round(3.0 * x), "the function jumps by 1"),
        (lambda x: int(2.3 * x), "the function jumps by 1"),
        (lambda x: x % 0.7, "the function jumps by 7.0e-01"),
        (lambda x: x // 0.7, "the function jumps by 1"),
        (lambda x: math.fmod(x + 2.0, 1.1), "the function jumps by 1.1"),
        (lambda x: 0.3 if x > 0 else 0.0, "the function jumps by 3.0e-01 near .0."),
        (lambda x: 0.3 if x * x > 0.25 else 0.0, "the function jumps by 3.0e-01 near .-?0.5"),
        (lambda x: x * x if x > 0.3 else 0.6 * x - 0.09, "second derivative jumps by 2.0e.00 near .0.3."),
        (lambda x: float(np.interp(x, [-1.0, 0.0, 1.0], [0.0, 0.0, 1.0])), "first derivative jumps by 1.* near .0."),
        (lambda x: float(np.interp(x, [-1.0, 0.123, 1.0], [0.0, 0.0, 1.0])), "near .0.12"),
    ],
)
def test_kinks_and_jumps_are_refused_where_they_are(function, message):
    with pytest.raises(ContourError, match=message):
        curve(function)


@pytest.mark.parametrize(
    ("function", "evaluator"),
    [
        (lambda x: math.sqrt(1.0 - x * x), traced),  # an end of the domain is where a shape may end so
        (lambda x: math.sqrt(1.0 + x), traced),
        (lambda x: math.acos(x), traced),
        (lambda x: math.hypot(x, 1e-4), traced),
        (lambda x: math.sqrt(x * x - 0.6 * x + 0.0901), traced),
        (lambda x: (x * x) ** 2.5, traced),
        (lambda x: abs(x - 2.0), traced),
        (lambda x: max(x, -1.5) + np.minimum(x, 3.0) + np.clip(x, -2.0, 2.0), traced),
        (lambda x: (x + 1.5) % 4.0, traced),
        (lambda x: math.acos(math.cos(x + 1.5)), traced),
        (lambda x: math.tan(x), traced),
        (lambda x: math.cos(3.0 * math.atan2(x, -1.0)), traced),  # the angle jumps, its cosine does not
        (lambda x: 0.2 if x < 7.0 else 1.0, traced),
        (lambda x: abs(x) ** 3, fitted),
        (lambda x: max(x - 0.3, 0.0) ** 3, fitted),
        (lambda x: x**3 if x > 0.3 else 0.27 * x - 0.054 + 0.9 * (x - 0.3) ** 2, fitted),
        (lambda x: math.cos(2.0 * math.pi * (x % 1.0)), fitted),
        (lambda x: math.sin(x) / x if x != 0.0 else 1.0, fitted),
        (lambda x: math.sin(x) / x if abs(x) > 1e-8 else 1.0, fitted),
        (lambda x: math.exp(-1.0 / x) if x > 0.0 else 0.0, fitted),
        (lambda x: j0(x) if x < 0.2 else j0(x) + (x - 0.2) ** 3, fitted),
    ],
)
def test_smooth_functions_are_taken(function, evaluator):
    found = curve(function)
    assert found.evaluator is evaluator
    assert found.fit_error < 1e-13
    for u in np.random.default_rng(2).uniform(*D, 50):
        assert found.point(u)[1] == pytest.approx(float(function(u)), abs=1e-13)
        h = 1e-4
        second = (float(function(u + h)) - 2.0 * float(function(u)) + float(function(u - h))) / h**2
        # differences: rounding 1e-16 / h^2; third derivatives that jump, h; near the ends of roots nothing is compared
        if abs(u) < 0.9:
            assert found.evaluate(u)[F_11, 1] == pytest.approx(second, abs=2e-3, rel=1e-2)


def test_the_pieces_of_branches_meet_where_the_branches_do():
    """A join with two derivatives is followed to rounding, because a piece begins there."""
    joined = curve(lambda x: (x - 0.3) ** 3 if x > 0.3 else 0.0)
    for u in (0.3 - 1e-9, 0.3, 0.3 + 1e-9, 0.31, 0.9):
        # rounding, times (2 / h)^2 12^4 in second derivatives of pieces of a quarter of the domain and more
        assert joined.evaluate(u)[F_11, 1] == pytest.approx(6.0 * max(u - 0.3, 0.0), abs=2e-9)


# Smooth everywhere, but some of them close to where they would not be.
CLOSE_FORMS = (
    "sqrt(1.2 + cos({0}))",
    "log(1.1 + sin({0}))",
    "hypot({0}, 0.1)",
    "atan2(1.1 + sin({0}), {1})",
    "asin(0.9 * sin({0}))",
    "1 / (0.1 + ({0})**2)",
    "abs(2.1 + sin({0}))",
    "max(sin({0}), -1.5)",
    "acosh(1.1 + cosh(sin({0})))",
    "tan(0.7 * sin({0}))",
    "atanh(0.9 * sin({0}))",
    "log1p(0.9 * cos({0}))",
    "(1.1 + cos({0}))**1.5",
    "sqrt(({0})**2 + ({1})**2 + 0.01)",
)


def random_function(generator, names, depth=3):
    text = expression(generator, depth, names, FORMS + CLOSE_FORMS)
    return eval(f"lambda {', '.join(names)}: {text}", dict(vars(math)))


def test_random_smooth_formulas_are_traced():
    generator = np.random.default_rng(17)
    kinds = {"u": 60, "ut": 20, "uv": 30, "uvt": 10}
    for names, count in kinds.items():
        for i in range(count):
            f = random_function(generator, names)
            domain = (-math.inf, math.inf) if i % 4 == 0 else (-1.5, 2.0)
            if "v" in names:
                contour = pc.ParametricSurface(
                    eval(f"lambda {', '.join(names)}: (u, v, f({', '.join(names)}))", {"f": f}), (domain, domain)
                )
                assert contour.evaluator is traced
            else:
                contour = pc.ParametricCurve(
                    eval(f"lambda {', '.join(names)}: (u, f({', '.join(names)}), 0)", {"f": f}), domain
                )
                assert contour.evaluator is traced


def test_random_smooth_functions_are_fitted():
    """The noise of fits does not pass for kinks: as often as not on dyadic places, with many and few pieces."""
    generator = np.random.default_rng(18)
    for i in range(40):
        f = random_function(generator, "u", 2)
        if i % 2:
            # ends that meet: a function of an angle
            contour = pc.ParametricCurve(
                lambda u, f=f: (math.cos(u), math.sin(u), blind(f)(math.sin(u))), (-math.pi, math.pi), periodic=True
            )
        else:
            contour = curve(blind(f), (-1.5, 2.0))
        assert contour.evaluator is fitted
        # ends of the domain included, relative to the largest coordinate
        assert contour.fit_error < 1e-13 * max(1.0, np.abs(contour.evaluate_many(contour.samples(50))[:, F]).max())


def test_random_kinks_and_jumps_are_refused():
    """At dyadic places of the domain and others, of all sizes, in branches, in absolute values and in compiled code."""
    generator = np.random.default_rng(19)
    for i in range(24):
        smooth = random_function(generator, "u", 2)
        place = (
            float(generator.choice([0.0, 0.5, -0.25, 0.125, -0.875]))
            if i % 2
            else float(generator.uniform(-0.95, 0.95))
        )
        order = i % 3
        size = 10.0 ** generator.uniform((-9.0, -7.0, -4.0)[order], 0.0)
        ways = [
            lambda u, s=smooth, p=place, c=size, k=order: s(u) + (c * (u - p) ** k if u > p else 0.0),
            lambda u, s=smooth, p=place, c=size, k=order: (
                s(u) + (c * abs(u - p) * (u - p) ** (k - 1) if k else c * np.sign(u - p))
            ),
            lambda u, s=smooth, p=place, c=size, k=order: (
                s(u) + 0.5 * c * (1.0 + np.heaviside(u - p, 1.0)) * (u - p) ** k
            ),
        ]
        if order < 2 or i % 2:
            # compiled code with a curvature that jumps: seen on dyadic places; elsewhere from 1e-2 or so
            ways.append(blind(ways[0]))
        with pytest.raises(ContourError, match=r"jumps|leaves an error"):
            curve(ways[(i // 6) % len(ways)])


@pytest.mark.parametrize("width", [1e-2, 1e-7])
def test_branches_are_followed_however_narrow_they_are(width):
    generator = np.random.default_rng(3)
    for _ in range(2):
        middle = float(generator.uniform(-0.9, 0.9))
        for f in (
            lambda u, m=middle: 0.1 if m - width < u < m else 0.0,
            lambda u, m=middle: 0.1 if abs(u - m) < width else 0.0,
            lambda u, m=middle: 0.1 if (u - m) ** 2 < width**2 else 0.0,
            lambda u, m=middle: 0.1 if math.cos(u - m) > math.cos(width) else 0.0,
            lambda u, m=middle: j0(u) + 0.1 if abs(u - m) < width else j0(u),
        ):
            with pytest.raises(ContourError, match=rf"near \({middle:.2f}"[:-1]):
                curve(f)


def test_narrow_smooth_branches_and_bumps_are_fitted():
    """What is narrow and smooth is part of the shape: a branch of 1 % and, in compiled code, a bump of 1 %."""

    def branch(u):
        return 0.01 * (4.0 * (u - 0.4) * (0.41 - u) / 0.01**2) ** 4 if 0.4 < u < 0.41 else 0.0

    def peak(u):
        return 0.01 * math.exp(-(((u - 0.317) / 0.004) ** 2))

    for function, place in ((branch, 0.405), (blind(peak), 0.317)):
        found = curve(function)
        assert found.evaluator is fitted
        assert found.point(place)[1] == pytest.approx(0.01, abs=1e-14)
        assert found.fit_error < 1e-13


def test_kinks_at_later_times_are_refused():
    """A formula that ends at some time, since it has no value from there on, is none with a kink."""
    for f in (
        lambda u, t: (u, math.sqrt((t - 20.0) ** 2), 0.0),
        lambda u, t: (u, ((t - 500.0) ** 2) ** 1.5, 0.0),
    ):
        with pytest.raises(ContourError, match=r"not smooth near .* t = (20|500): .*falls to zero; .*time_domain"):
            pc.ParametricCurve(f, (-1.0, 1.0))
    assert pc.ParametricCurve(lambda u, t: (u, math.sqrt(20.0 - t), 0.0), (-1.0, 1.0)).time_dependent


def test_surfaces_with_kinks_are_refused():
    box = ((-1.0, 1.0), (-1.0, 1.0))
    for f, domain, message in (
        (lambda x, y: math.hypot(x, y), None, "square root"),
        (lambda x, y: math.hypot(x - 50.3, y + 7.0), None, "u1 = 50.3, u2 = -7: .*square root"),
        (lambda x, y: math.sqrt((x - y) ** 2), None, "square root"),
        (lambda x, y: math.sqrt(x * x - 2.0 * x * y + y * y), box, "square root"),
        (lambda x, y: 1.0 / (1.0 + 0.5 * math.sin(x) + 0.5 * math.cos(y)), None, "denominator"),
        (lambda x, y: (x * x + y * y) * math.atan2(y, x), ((-2.0, -1.0), (-1.0, 1.0)), "f jumps by"),
        (lambda x, y: 0.1 if x > 0.3 else 0.0, box, r"the function jumps by 1.0e-01 near \(0.3, "),
        (lambda x, y: max(y, 0.0), box, r"first derivative jumps by 1.0e.00 near \(.*, 0\)"),
        (lambda x, y: 0.1 if x > 0.3 else 0.0, None, r"it branches at u1 = 0.3; it can be fitted on a finite domain"),
        (lambda x, y: float(np.interp(y, [-1.0, 0.0, 1.0], [0.0, 0.0, 1.0])), box, r"first derivative.*, 0\)"),
        (lambda x, y: 0.1 if (x - 0.3) ** 2 + (y - 0.2) ** 2 < 1e-6 else 0.0, box, r"near \(0.[23]\d*, 0.[12]\d*\)"),
    ):
        with pytest.raises(ContourError, match=message):
            pc.HeightField(f, domain=domain)
    for f, domain in (
        (lambda x, y: math.sqrt(1e-4 + x * x + y * y), None),
        (lambda x, y: math.sqrt(x * x - 2.0 * x * y + y * y + 1e-4), box),
        (lambda x, y: 1.0 / (1.01 + 0.5 * math.sin(x) + 0.5 * math.cos(y)), None),
        (lambda x, y: (x * x + y * y) * math.cos(3.0 * math.atan2(y, x)), ((-2.0, -1.0), (-1.0, 1.0))),
        (lambda x, y: abs(5.0 + x + y), box),
    ):
        assert pc.HeightField(f, domain=domain).evaluator is traced
    joined = pc.HeightField(lambda x, y: max(x - 0.3, 0.0) ** 3 * (1.0 + y), domain=box)
    assert joined.evaluator is fitted
    assert joined.evaluate((0.3, 0.5))[F_11, 2] == pytest.approx(0.0, abs=1e-8)  # as for curves


def test_kinks_in_time_are_refused():
    def moving(f, **options):
        return pc.ParametricCurve(lambda u, t: (u, f(u, t), 0.0), D, **options)

    with pytest.raises(ContourError, match=r"t = 5: f takes the square root.*time_domain"):
        moving(lambda u, t: math.sqrt((t - 5.0) ** 2))
    with pytest.raises(ContourError, match=r"t = 7: f takes the arc sine"):
        moving(lambda u, t: math.asin(1.0 - (t - 7.0) ** 2 / 100.0))
    with pytest.raises(ContourError, match="branches at t = 1"):
        moving(lambda u, t: min(t, 1.0))
    with pytest.raises(ContourError, match=r"first derivative jumps by 1.0e.00 near \(.*, 1\)"):
        moving(lambda u, t: min(t, 1.0), time_domain=(0.0, 4.0))
    with pytest.raises(ContourError, match="t = 5: f takes the square root"):
        pc.HeightField(lambda x, y, t: x + math.sqrt((t - 5.0) ** 2))
    for f, good, bad in (
        (lambda u, t: math.sqrt(5.0 - t), (-7.0, 0.0, 4.9), (5.1, 8.0)),
        (lambda u, t: abs(t + 2.0), (-1.9, 0.0, 100.0), (-2.1, -8.0)),
        (lambda u, t: abs(2.0 + t + 0.5 * u), (0.0, 100.0), (-2.6, -8.0)),
        (lambda u, t: max(0.0, t), (0.0, 100.0), (-0.1, -8.0)),
    ):
        made = moving(f)
        assert made.evaluator is traced
        for t in good:
            assert made.point(0.3, t)[1] == pytest.approx(f(0.3, t), abs=1e-14)
        # no value is better than that of another branch
        assert all(math.isnan(made.point(0.3, t)[1]) for t in bad)
    limited = moving(lambda u, t: math.sqrt((t - 5.0) ** 2), time_domain=(0.0, 4.0))
    assert [limited.point(0.3, t)[1] for t in (0.0, 4.0)] == [5.0, 1.0]
    assert math.isnan(limited.point(0.3, 5.5)[1])
    assert moving(lambda u, t: min(t, 1.0), time_domain=(0.0, 0.9)).evaluator is traced
    assert moving(lambda u, t: math.sqrt(1.0 + t)).evaluator is traced  # not defined before t = -1
    assert pc.HeightField(lambda x, y, t: x + math.sqrt((t - 5.0) ** 2), time_domain=(0.0, 4.0)).evaluator is traced
    ramp = moving(lambda u, t: 0.0 if t < 1.0 else (t - 1.0) ** 4 * (1.0 + u), time_domain=(0.0, 2.0))
    assert ramp.point(0.5, 1.7)[1] == pytest.approx(1.5 * 0.7**4, abs=1e-14)


def test_motions_that_jump_are_refused():
    def lift(t):
        return pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3 if t > 0.5 else 0.0]))

    def late(t):
        return pin.SE3(np.eye(3), np.array([0.0, 0.0, max(t - 0.5, 0.0)]))

    for f in (lift, late):
        with pytest.raises(ContourError, match=r"jumps by .* near \(0.5\)|near \(0\.(5|4)"):
            pc.CallableMotion(f, time_domain=(0.0, 1.0))


# Bounds.


def test_bounds_hold_for_every_operation():
    """Values and derivatives of the tape's functions at points of random boxes lie within the bounds of the boxes."""
    generator = np.random.default_rng(23)
    for op in range(SQUARE, COSH + 5):
        for _ in range(40):
            c = float(generator.choice([2.0, 3.0, -1.0, -2.0, 0.5, 1.5, 2.5, -0.5]))
            low, high = np.sort(generator.uniform(-3.0, 3.0, 2) * generator.choice([0.01, 0.3, 1.0]))
            with np.errstate(all="ignore"):
                value, slope = of_one(op, c, Interval(np.array([low]), np.array([high])))
            for x in [low, high, *generator.uniform(low, high, 20)]:
                try:
                    f, f_x, _ = (function_of_one.py_func if hasattr(function_of_one, "py_func") else function_of_one)(
                        op, float(x), c
                    )
                except (ValueError, ZeroDivisionError, OverflowError):
                    continue
                if isinstance(f, complex) or not np.isfinite([f, f_x]).all():
                    continue
                for bounds, number in ((value, f), (slope, f_x)):
                    slack = 1e-12 * (1.0 + abs(number))
                    assert bounds.lo[0] - slack <= number <= bounds.hi[0] + slack, (op, c, low, high, x)
    for op in range(MULTIPLY, ATAN2 + 1):
        for _ in range(100):
            box = np.sort(generator.uniform(-2.0, 2.0, (2, 2)) * generator.choice([0.1, 1.0]), axis=1)
            with np.errstate(all="ignore"):
                bounds = of_two(op, *(Interval(np.array([a]), np.array([b])) for a, b in box))
            for x, y in generator.uniform(box[:, 0], box[:, 1], (20, 2)).tolist():
                found = (function_of_two.py_func if hasattr(function_of_two, "py_func") else function_of_two)(op, x, y)
                for interval, number in zip(bounds, found):
                    slack = 1e-12 * (1.0 + abs(number))
                    assert interval.lo[0] - slack <= number <= interval.hi[0] + slack, (op, box, x, y)
    assert len(FAULTS) >= 10


# Charts.


def profiles(low_pole, high_pole, generator):
    """A random profile over (-1, 1) that meets the axis smoothly at the ends that are poles."""
    a, b = generator.uniform(0.05, 0.2, 2)
    # odd in the distance from poles: sines of angles that are multiples of pi there
    start, end = (0.0 if low_pole else 0.7), (math.pi if high_pole else math.pi - 0.7)

    def f(s):
        angle = start + (end - start) * 0.5 * (s + 1.0)
        return math.sin(angle) + a * math.sin(3.0 * angle), -math.cos(angle) - b * math.cos(2.0 * angle)

    return f


@pytest.mark.parametrize("way", ["traced", "fitted", "points", "closed", "closed and fitted", "closed points"])
@pytest.mark.parametrize(("low_pole", "high_pole"), [(False, False), (True, False), (False, True), (True, True)])
def test_charts_are_those_that_exist(way, low_pole, high_pole):
    generator = np.random.default_rng(31)
    expected = (0, *([1] if low_pole else []), *([2] if high_pole else []))
    for _ in range(3):
        f = profiles(low_pole, high_pole, generator)
        closed = closed_profile(bump)
        if way.startswith("closed"):
            expected = (0,)
        if way == "traced":
            surface = pc.SurfaceOfRevolution(f, D)
        elif way == "fitted":
            surface = pc.SurfaceOfRevolution(blind_pair(f), D)
        elif way == "points":
            points = np.array([f(s) for s in np.linspace(-1.0, 1.0, 30)])
            surface = pc.SurfaceOfRevolution(np.maximum(points, [0.0, -np.inf]))
        elif way == "closed":
            surface = pc.SurfaceOfRevolution(closed, ONE, periodic=True)
        elif way == "closed and fitted":
            surface = pc.SurfaceOfRevolution(blind_pair(closed), ONE, periodic=True)
        else:
            surface = pc.SurfaceOfRevolution([closed(s) for s in np.arange(24) * PERIOD / 24], periodic=True)
        assert surface.charts == expected
        for chart in range(-1, 4):
            if chart in expected:
                assert np.isfinite(surface.evaluate((0.01, surface.domain[1][0] + 0.02), chart=chart)).all()
                continue
            with pytest.raises(ContourError, match=f"there is no number {chart}"):
                surface.evaluate((0.1, 0.1), chart=chart)
            with pytest.raises(ContourError, match=f"there is no number {chart}"):
                surface.evaluate_many(np.zeros((3, 2)), chart=chart)


def test_charts_of_all_other_contours():
    assert pc.Sphere(1.0).charts == pc.Ellipsoid(1.0, 2.0, 3.0).charts == (0, 1)
    for contour in (pc.Torus(2.0, 1.0), pc.Plane(), pc.Cylinder(1.0), pc.Cone(0.3), pc.Circle(1.0), pc.Point()):
        assert contour.charts == (0,)
        with pytest.raises(ContourError, match="no number 1"):
            contour.evaluate(np.zeros(contour.dimension), chart=1)


@pytest.mark.parametrize("closed", [False, True])
def test_contacts_of_surfaces_without_poles_are_found(closed):
    """The search for contact points tries the charts that there are: a tyre on a plane, a ball in a groove."""
    if closed:
        tyre = pc.SurfaceOfRevolution(
            lambda s: (0.3 + 0.1 * math.cos(s), 0.1 * math.sin(s)), (0.0, 2.0 * math.pi), periodic=True
        )
    else:
        tyre = pc.SurfaceOfRevolution(lambda s: (0.3 + 0.1 * math.cos(s), 0.1 * math.sin(s)), (-2.0, 2.0))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.04 * np.eye(3)), "wheel"))
    # the tyre comes second and first
    wheel = scene.add_contour("tyre", tyre, "wheel", placement=pin.SE3(pin.utils.rotate("x", 1.2), np.zeros(3)))
    scene.add_contact("c", wheel, scene.add_contour("floor", pc.Plane()), friction=pc.NoSlip())
    height = 0.3 * math.sin(1.2) + 0.1
    state = scene.initial_state([0.0, 0.0, height + 1e-5, 0, 0, 0, 1], [1.0, 0, 0, 0, 1.0 / height, 0])
    assert state.q[2] == pytest.approx(height, abs=1e-5)
    run = pc.simulate(scene, state, duration=0.5)
    assert run.status == 0, run.message
    assert (run.contacts["c"].charts == 0).all()
    assert (np.abs(run.contacts["c"].gap) < 1e-12).all()
    if closed:
        far = pc.simulate(scene, scene.initial_state(run.q[-1], run.v[-1], t=0.5), duration=1.0)
        assert far.status == 0, far.message
    with pytest.raises(pc.StateError, match="no chart 1"):
        bad = scene.initial_state([0.0, 0.0, height, 0, 0, 0, 1])
        bad.discrete[0, 1:3] = 1
        pc.simulate(scene, bad, duration=0.1)


def test_first_derivatives_of_a_periodic_surface_in_time_are_exact_after_turns():
    """Mixed derivatives by time survive the wrapping of both parameters."""
    surface = PERIODIC["surface in time"]()
    u, t, h = np.array([0.4, 0.9]), 0.7, 1e-5
    far = u + PERIOD * np.array([5, -7])
    difference = (surface.evaluate(far, t + h) - surface.evaluate(far, t - h)) / (2.0 * h)
    rows = surface.evaluate(far, t)
    # central differences: h^2 and rounding / h
    assert np.abs(rows[6] - difference[F]).max() < 1e-8
    assert np.abs(rows[7] - difference[F_1]).max() < 1e-7


def test_an_angle_that_does_not_matter_is_followed_at_other_times_too():
    """Its cut, a branch that only early times have, and the end of a root, all in one formula."""
    made = pc.ParametricCurve(
        lambda u, t: (u, math.cos(math.atan2(u, -1.0)) + abs(t + 2.0) + math.sqrt(6.0 - t), 0.0), D
    )
    assert made.evaluator is traced
    assert made.point(-0.3, 1.0)[1] == pytest.approx(math.cos(math.atan2(-0.3, -1.0)) + 3.0 + math.sqrt(5.0), abs=1e-14)
    with pytest.raises(ContourError, match="atan2"):
        pc.ParametricCurve(lambda u, t: (u, math.atan2(u, -1.0) + abs(t + 2.0) + math.sqrt(6.0 - t), 0.0), D)
