"""Contours without ends: which part of them is near a place, and balls that are thrown at them. Distances are computed
independently, from dense samples."""

import math

import numpy as np
import pinocchio as pin
import pytest
import scipy

import pincontact as pc
from pincontact.contours.base import ALL, F
from pincontact.contours.evaluation import contour_kernel
from pincontact.contours.tails import ends_near
from pincontact.geometry.search import ends_within


@contour_kernel
def drifting(chart, shape, pool, u1, u2, t, out):
    """A curve of somebody's own: bounds of it are not known."""
    out[0, 0], out[0, 1], out[0, 2] = 0.2 * u1 + math.sin(u1), math.cos(u1), 0.0
    out[1, 0], out[1, 1], out[1, 2] = 0.2 + math.cos(u1), -math.sin(u1), 0.0
    out[3, 0], out[3, 1], out[3, 2] = -math.sin(u1), -math.cos(u1), 0.0


def sheet(u, v):
    return (2.0 * u, 0.5 * v, 0.1 * np.sin(9.0 * u) * np.cos(3.0 * v))


HALF, OPEN = (0.3, math.inf), (ALL, ALL)
# their formulas get away from everywhere, and how far has bounds
BOUNDED = {
    "helix": pc.Helix(0.1, -0.07),
    "wave": pc.ParametricCurve(lambda u: (0.01 * u, 0.3 * np.sin(u), 0.0), ALL),
    "loops": pc.ParametricCurve(lambda u: (0.1 * u - 0.3 * np.sin(u), 0.1 - 0.3 * np.cos(u), 0.0), ALL),
    "cubic": pc.ParametricCurve(lambda u: (u**3 + u, 0.2 * u, 0.0), ALL),
    "half": pc.ParametricCurve(lambda u: (1.0 - u, np.sin(9.0 * u), 0.0), HALF),
    "travelling wave": pc.ParametricCurve(lambda u, t: (u - 0.2 * t, 0.3 * np.sin(5.0 * u - t), 0.0), ALL),
    "line": pc.Line(),
    "tube": pc.Cylinder(0.2),
    "cone": pc.Cone(0.4),
    "sheet": pc.ParametricSurface(sheet, OPEN),
}
# of these the formula tells no bounds
UNBOUNDED = {
    "spiral": pc.ParametricCurve(lambda u: (0.1 * u * np.cos(u), 0.1 * u * np.sin(u), 0.0), HALF),
    "slanting": pc.ParametricSurface(lambda u, v: (u + v, u - v, 0.1 * np.sin(9.0 * u)), OPEN),
    "own": pc.Contour(drifting, 1, planar=True, size=math.inf, convex_side=0),
}


@pytest.mark.parametrize("name", [*BOUNDED, *UNBOUNDED])
def test_all_that_is_near_a_place_is_between_the_ends(name):
    """From samples far beyond them; bounds leave at most so much more as the values at which they are known are apart,
    a fifth, and as the contour goes to and fro."""
    contour = (BOUNDED | UNBOUNDED)[name]
    t, rng = 0.7, np.random.default_rng(4)
    u = np.linspace(-120.0, 120.0, 24_001) if contour.dimension == 1 else np.linspace(-6.0, 6.0, 241)
    axes = [u[(u >= low) & (u <= high)] for low, high in contour.domain]
    grid = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    points = contour.evaluate_many(grid, t)[:, F]
    for _ in range(20):
        # beside one of the points that are near its origin
        near = points[np.linalg.norm(points, axis=1) < 1.0]
        place, radius = near[rng.integers(len(near))] + rng.normal(size=3) * 0.1, rng.uniform(0.05, 0.5)
        radius += np.linalg.norm(points - place, axis=1).min()
        within = grid[np.linalg.norm(points - place, axis=1) <= radius]
        for a in range(contour.dimension):
            low, high = ends_within(contour, a, t, place, radius)
            assert low <= within[:, a].min() and within[:, a].max() <= high
            if name in BOUNDED:
                assert (low, high) == ends_near(contour, a, place, radius, t)
            elif np.isinf(contour.domain[a]).any():
                assert np.isinf(ends_near(contour, a, place, radius, t)).any()
        if name in ("helix", "line", "tube"):
            climb = {"helix": -0.07 / (2.0 * math.pi)}.get(name, 1.0)
            along = place[0] if name == "line" else place[2]
            ends = sorted([(along - radius) / climb, (along + radius) / climb])
            # a quarter of an octave each, and the least of the values
            assert low >= ends[0] - 0.2 * abs(ends[0]) - 1e-6 and high <= ends[1] + 0.2 * abs(ends[1]) + 1e-6


def test_what_never_gets_away_is_looked_at_for_long():
    """A helix that does not climb goes round for ever."""
    low, high = ends_within(pc.Helix(0.1, 0.0), 0, 0.0, np.zeros(3), 0.3)
    assert high == -low and 2.0 * math.pi < high < math.inf


def helix(rng):
    radius, pitch = rng.uniform(0.03, 0.12), rng.uniform(0.05, 0.3)
    return pc.Helix(radius, pitch), lambda u: (radius * np.cos(u), radius * np.sin(u), pitch * u / (2.0 * np.pi))


def wave(rng):
    height, rate = rng.uniform(0.02, 0.1), rng.uniform(20.0, 60.0)

    def f(u):
        return 0.1 * u, height * np.sin(0.1 * rate * u), height * np.cos(0.07 * rate * u)

    return pc.ParametricCurve(f, ALL), f


def loops(rng):
    radius = rng.uniform(0.02, 0.06)
    arm = rng.uniform(0.5, 2.5) * radius

    def f(u):
        return radius * u - arm * np.sin(u), -arm * np.cos(u), 0.0 * u

    return pc.ParametricCurve(f, ALL), f


def hills(rng):
    height, rate = rng.uniform(0.02, 0.05), rng.uniform(10.0, 25.0)

    def f(u, v):
        return 0.1 * u, 0.1 * v, height * np.sin(0.1 * rate * u) * np.cos(0.08 * rate * v)

    return pc.ParametricSurface(f, OPEN), f


def thrown(make, seed):
    """A scene, in which a ball without turning is thrown at a wire or a ground without ends, its start, and the gap of
    the ball at a place of its centre."""
    rng = np.random.default_rng(seed)
    contour, f = make(rng)
    radius = rng.uniform(0.01, 0.04)
    turn = rng.normal(size=3) if contour.dimension == 1 else 0.3 * rng.normal(size=3)
    placement = pin.SE3(pin.exp3(turn), 0.1 * rng.normal(size=3))
    u = np.linspace(-60.0, 60.0, 120_001) if contour.dimension == 1 else np.linspace(-6.0, 6.0, 601)
    samples = np.column_stack([part.ravel() for part in f(*np.meshgrid(*contour.dimension * [u], indexing="ij"))])

    tree = scipy.spatial.cKDTree(samples, compact_nodes=False, balanced_tree=False)

    def gap(centre):
        return tree.query(placement.actInv(centre))[0] - radius

    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("ball", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    ball, ground = (
        scene.add_contour("b", pc.Sphere(radius), "ball"),
        scene.add_contour("s", contour, placement=placement),
    )
    for i in range(4):
        scene.add_contact(f"c{i}", ball, ground, restitution=1.0)
    # in 0.2 s beside a place that is near the contour's origin
    velocity, aim = np.array([*0.3 * rng.normal(size=2), -1.5]), placement.act(rng.uniform(-0.07, 0.07, 3))
    place = aim - 0.2 * velocity + np.array([0.0, 0.0, 0.5 * 9.81 * 0.2**2])
    return scene, place, velocity, gap


@pytest.mark.parametrize("make", [helix, wave, loops, hills])
def test_balls_do_not_pass_through_what_has_no_ends(make):
    """They touch where they are nearest, though a way of some turns along a wire leads there from where they were."""
    for seed in range(5):
        scene, place, velocity, gap = thrown(make, seed)
        state = scene.initial_state(place, velocity, free=list(scene.contacts))
        # an impact within a step of 0.5 ms leaves an overlap of what the ball goes in it
        for options, overlap in (({}, 1e-6), ({"method": "Moreau", "dt": 5e-4}, 1e-3)):
            run = pc.simulate(scene, state, 0.4, t_eval=np.linspace(0.0, 0.4, 81), **options)
            assert run.status == 0, (seed, options, run.message)
            assert min(map(gap, run.q)) > -overlap, (seed, options)
            if run.events:
                t = run.events[0].time
                # samples are 1e-4 m apart along wires and 2e-3 m on the ground, which is good to half of that squared
                # over distances of 0.01 m; time stepping knows places to second order, and times to these
                there = gap(place + t * velocity - np.array([0.0, 0.0, 0.5 * 9.81 * t * t]))
                assert there == pytest.approx(0.0, abs=2e-4 if make is hills else 1e-5), (seed, options)
