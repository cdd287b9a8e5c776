"""Bounds of curvatures: against derivatives at dense samples, and against closed forms."""

import math

import numpy as np
import pytest

import pincontact as pc
from pincontact.contours.bends import _bends, bends_less, enclosed
from pincontact.contours.enclosures import Interval
from pincontact.contours.tape import traced

# each of two variables between -0.9 and 0.9, all operations of tapes among them
FORMULAS = {
    "sums and products": lambda x, y: (1.0 + x * y - 0.3 * x) * (y - 2.0 * x) ** 2,
    "powers": lambda x, y: (1.5 + x) ** 3 + (2.0 + y) ** 2.5 + (1.2 + x * y) ** -2 + (2.0 + x) ** 1.5,
    "quotients": lambda x, y: (1.0 + x) / (2.0 + y * x) + 1.0 / (1.5 - y),
    "waves": lambda x, y: np.sin(3.0 * x + y) * np.cos(2.0 * y) + np.tan(x * y),
    "roots and logarithms": lambda x, y: np.sqrt(1.0 + x * x + y) * np.log(3.0 + x) + np.log1p(0.5 * y),
    "exponentials": lambda x, y: np.exp(-(x * x) - 2.0 * y * y) + np.expm1(x - y) + np.sinh(x) * np.cosh(y),
    "steps": lambda x, y: np.tanh(3.0 * x + y) + np.arctan(2.0 * y) * x + np.arcsinh(x - y),
    "inverse functions": lambda x, y: np.arcsin(0.9 * x) + np.arctanh(0.9 * y) + np.arccosh(2.0 + x * y),
    "angles": lambda x, y: np.arctan2(y + 0.2 * x, 2.0 + x),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_bounds_hold_all_samples(name):
    """Of values, first and second derivatives; over a point they are these."""
    f = FORMULAS[name]
    field = pc.HeightField(f, domain=((-0.9, 0.9), (-0.9, 0.9)))
    assert field.evaluator is traced
    rng = np.random.default_rng(3)
    for width in (0.0, 0.02, 0.4):
        low = rng.uniform(-0.9, 0.9 - width, size=(20, 2))
        places = low[:, None] + width * rng.uniform(size=(20, 50, 2))
        rows = field.evaluate_many(places.reshape(-1, 2)).reshape(20, 50, 10, 3)[:, :, [0, 1, 2, 3, 4, 5], 2]
        with np.errstate(all="ignore"):
            jet = enclosed(field.pool, Interval(low.T, low.T + width))[2]
        parts = [
            (jet.value.lo, jet.value.hi),
            *((jet.first.lo[i], jet.first.hi[i]) for i in range(2)),
            *((jet.second.lo[i, j], jet.second.hi[i, j]) for i, j in ((0, 0), (0, 1), (1, 1))),
        ]
        for k, (lo, hi) in enumerate(parts):
            off = 1e-11 * (1.0 + np.abs(rows[:, :, k]).max(axis=1))
            assert (rows[:, :, k].min(axis=1) >= lo - off).all() and (rows[:, :, k].max(axis=1) <= hi + off).all()
            if width == 0.0:
                np.testing.assert_allclose(lo, hi, rtol=1e-11, atol=1e-11)
            else:
                # no wider than they need be: in the smaller boxes by a few times what the samples span
                span = rows[:, :, k].max(axis=1) - rows[:, :, k].min(axis=1)
                assert width > 0.1 or (hi - lo < 20.0 * span + 0.02 * (1.0 + np.abs(rows[:, :, k]).max(axis=1))).all()


def curvature(contour, places, side):
    """The largest normal curvature towards that side, at places (n, k), in 1/m: by the shape operator."""
    largest = []
    for rows in contour.evaluate_many(places):
        if contour.dimension == 1:
            x, y = rows[1, :2]
            largest.append(side * (rows[3, 0] * y - rows[3, 1] * x) / math.hypot(x, y) ** 3)
            continue
        normal = np.cross(rows[1], rows[2])
        normal /= np.linalg.norm(normal)
        metric = rows[1:3] @ rows[1:3].T
        bent = np.array([[rows[3] @ normal, rows[4] @ normal], [rows[4] @ normal, rows[5] @ normal]])
        largest.append(np.linalg.eigvals(np.linalg.solve(metric, side * bent)).real.max())
    return np.maximum(largest, 0.0)


SADDLE = pc.ParametricSurface(lambda u, v: (u, v + 0.2 * u, u * v), domain=((-1.0, 1.0), (-1.0, 1.0)))
EGG = pc.ParametricCurve(
    lambda u: (math.cos(u) * (1.0 + 0.2 * math.sin(u)), 0.7 * math.sin(u), 0.0), (0.0, 2.0 * math.pi), periodic=True
)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("contour", [SADDLE, EGG, pc.HeightField(FORMULAS["steps"], domain=((-1, 1), (-1, 1)))])
def test_curvatures_are_bounded(contour, side):
    rng, (low, high) = np.random.default_rng(4), np.array(contour.domain).T
    places = rng.uniform(low, high, size=(4000, contour.dimension))
    exact = curvature(contour, places, side)
    # at a point all of it is exact but the metric of a surface, of which the least eigenvalue stands for any
    bounds = _bends(contour, side, places, places)
    assert (bounds >= exact - 1e-9).all() and (contour.dimension == 2 or np.allclose(bounds, exact, atol=1e-9))
    largest = float(exact.max())
    assert not bends_less(contour, side, 0.99 * largest)
    assert bends_less(contour, side, 2.5 * largest + 1e-6)


@pytest.mark.parametrize(
    ("f", "up", "down"),
    [
        # a e^(-r^2/w^2): 2 a / w^2 at the middle, and 4 a e^(-3/2) / w^2 at r = w sqrt(3/2)
        (lambda x, y: 0.05 * np.exp(-(x * x + y * y) / 0.05**2), 80.0 * math.exp(-1.5), 40.0),
        (lambda x, y: -0.05 * np.exp(-((x / 0.05) ** 2)), 40.0, 80.0 * math.exp(-1.5)),
        # a step s tanh(x / w): 4 s / (3 sqrt(3) w^2)
        (lambda x, y: 0.02 * np.tanh(x / 0.05) + 0.0 * y, 6.1584, 6.1584),
        (lambda x, y: 0.03 * np.sin(2.0 * x) + 0.02 * np.cos(y), 0.12, 0.12),
        (lambda x, y: 0.5 * (x * x + 2.0 * y * y), 2.0, 0.0),
    ],
    ids=["bump", "trench", "step", "waves", "bowl"],
)
def test_bends_of_a_ground_without_ends(f, up, down):
    """Nothing falls between samples: what is narrow is found wherever it is."""
    for at in (0.0, -212.3):
        ground = pc.HeightField(lambda x, y, at=at: f(x - at, y))
        for side, limit in ((1, up), (-1, down)):
            assert not bends_less(ground, side, 0.999 * limit)
            assert bends_less(ground, side, 3.5 * limit + 1e-6)
    assert not bends_less(pc.HeightField(lambda x, y: 1e-3 * x**4), 1, 10.0)


def test_what_is_no_traced_formula_is_not_bounded():
    assert not bends_less(pc.Sphere(1.0), -1, 10.0)
    assert not bends_less(pc.HeightField(lambda x, y, t: t * np.sin(x + y)), 1, 10.0)
