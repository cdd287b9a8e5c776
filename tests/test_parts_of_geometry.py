"""Parts of the search for contact points, each looked at alone: cells, samples, starts, candidates."""

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
import scipy
from calling import from_python
from made_systems import made_system
from shared import one_body

import pincontact as pc
from pincontact.constraints.kinematics import _is_solved, basis_at_contact
from pincontact.contours.base import F_1, F_2, F
from pincontact.dynamics.system import System
from pincontact.geometry import cells, nearest
from pincontact.geometry.frames import curve_normal_axis
from pincontact.geometry.location import NORMAL, conditioning, solve_location
from pincontact.geometry.nearest import NearestSearch, Whole, bend
from pincontact.geometry.patterns import CROSSING_CURVES, ON_CURVE, ON_SURFACE
from pincontact.geometry.search import _seeds, find_candidates, sample, stationary_points
from pincontact.layout import FREE, K1, K2, LENGTH, MODE, NOTHING_THERE, OK, PATTERN, SYSTEM

UNKNOWN = np.full(4, np.nan)
basis_of, solve_of = from_python(basis_at_contact), from_python(solve_location)
conditioning_of = from_python(conditioning, SYSTEM)


def free_body(joint=None):
    return one_body(joint or pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)))


def system_of(shape, ground, q, joint=None, placement=None, side=1, motion=None):
    scene = pc.Scene(free_body(joint))
    scene.add_contour("shape", shape, frame="body")
    scene.add_contour("ground", ground, placement=placement, motion=motion)
    scene.add_contact("c", "shape", "ground", side=side)
    system = System(scene.model, list(scene.contacts.values()))
    system.q[:] = q
    system.evaluate_kinematics(0.0)
    return system


def turned(seed):
    quaternion = np.random.default_rng(seed).normal(size=4)
    return quaternion / np.linalg.norm(quaternion)


# Cells and what they say of a contour.


@pytest.mark.parametrize(
    ("contour", "finest"),
    [(pc.SplineCurve(np.random.default_rng(5).normal(size=(9, 3))), 0.01), (pc.Torus(0.6, 0.2), 0.03)],
    ids=["curve", "surface"],
)
def test_cells_cover_a_contour_once(contour, finest):
    """Each point is in one cell, and within its radius; the nearest samples are those by all distances, and what is
    left out is farther away by as much as was asked for."""
    generator, k = np.random.default_rng(1), contour.dimension
    samples = np.array([2.0, 0.0, 0.0]) + generator.normal(size=(300, 3))
    search = cells.search_workspace(contour, cells.SampleTree(samples))
    search.box[:k] = contour.domain
    rotation, place, own = pin.exp3(np.array([0.3, -1.0, 0.5])), np.array([0.1, 0.2, 0.3]), np.array([1.0, 0.5, 0.2])
    search.pose[:3], search.pose[3], search.pose[4] = rotation, place, own
    samples = (samples - own) @ rotation.T + place
    for beyond in (math.inf, 0.2):
        search.numbers["beyond"], search.numbers["around"], search.numbers["finest"] = beyond, 0.05, finest
        cells.near_cells(search.address)
        n = int(search.counts["cells"])
        assert (128 if k == 1 else 576) < n <= 4096 or beyond < 1.0
        middles, halves, points, reaches = (
            a[:n] for a in (search.middles, search.halves, search.points, search.reaches)
        )
        np.testing.assert_allclose(points, contour.evaluate_many(middles[:, :k])[:, F], atol=1e-15)
        distances, nearest = scipy.spatial.cKDTree(samples).query(points)
        np.testing.assert_allclose(search.distances[:n], distances, rtol=1e-12)
        assert (search.order[search.pairs[:n]] == nearest).all()
        low, high = np.array(contour.domain).T
        places = low + (high - low) * generator.random((200, k))
        away = scipy.spatial.cKDTree(samples).query(contour.evaluate_many(places)[:, F])[0]
        for u, point, distance in zip(places, contour.evaluate_many(places)[:, F], away):
            inside = (np.abs(middles[:, :k] - u) < halves[:, :k]).all(axis=1)
            assert inside.sum() == (1 if beyond > 1.0 else inside.any())
            if inside.any():
                assert np.linalg.norm(points[inside][0] - point) <= reaches[inside][0]
            else:
                assert distance > distances.min() + beyond
        if beyond > 1.0:
            all_of_them = n
            volume = np.prod(2.0 * halves[:, :k], axis=1)
            assert volume.sum() == pytest.approx(np.prod(high - low), rel=1e-12)
        else:
            assert 0 < n < all_of_them


def uneven(u):
    angle = u + 0.3 * math.sin(u)
    return 0.4 * math.cos(angle), 0.4 * math.sin(angle), 0.0


def test_least_radius_of_curvature():
    """Of contours whose curvature is the same everywhere, or along each parameter line."""
    for contour, radius in (
        (pc.Sphere(0.3), 0.3),
        (pc.Circle(0.3), 0.3),
        (pc.Cylinder(0.3), 0.3),
        (pc.Torus(0.6, 0.2), 0.2),
        # radius^2 + climb^2 over radius
        (pc.Helix(0.3, 2.0 * math.pi * 0.4), (0.09 + 0.16) / 0.3),
        # whose acceleration along the curve is no curvature
        (pc.ParametricCurve(uneven, (0.0, 2 * math.pi), periodic=True), 0.4),
        (pc.Plane(), math.inf),
        (pc.Line(), math.inf),
        (pc.Point(), math.inf),
    ):
        assert bend(contour, 0.0) == pytest.approx(radius, rel=1e-9)
    # a ripple of 1 m^-1 along u2, that is shallow at most places: between the curvature at its crests and twice that
    ripple = pc.HeightField(lambda x, y: 0.01 * math.sin(10.0 * y), domain=((-1.0, 1.0), (-1.0, 1.0)))
    assert 1.0 < bend(ripple, 0.0) < 1.1
    growing = pc.ParametricCurve(lambda u, t: ((1.0 + t) * math.cos(u), (1.0 + t) * math.sin(u), 0.0), (0.0, 3.0))
    assert bend(growing, 1.0) == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize(
    "contour",
    [
        pc.Circle(0.3),
        pc.Ellipse(0.3, 0.1, (0.0, 1.0)),
        pc.Ellipsoid(0.3, 0.2, 0.1),
        pc.Plane(((0.0, 1.0), (2.0, 5.0))),
        pc.Cylinder(0.3, (None, (1.0, 2.0))),
    ],
    ids=lambda c: c.name,
)
def test_a_contour_as_samples_with_radii(contour):
    """Every point of it is within the radius of a sample and within the ball; both are not much larger than needed."""
    whole = Whole(contour, 0.0)
    assert whole.rounding == 0.0
    parameters = whole.parameters[:, : contour.dimension]
    assert np.abs(contour.evaluate_many(parameters[::50])[:, F] - whole.points[::50]).max() < 1e-15
    generator = np.random.default_rng(2)
    low, high = np.array(contour.domain).T
    points = contour.evaluate_many(low + (high - low) * generator.random((300, contour.dimension)))[:, F]
    corners = contour.evaluate_many(np.array(list(itertools.product(*contour.domain))))[:, F]
    every = np.concatenate([points, corners])
    away = scipy.spatial.cKDTree(whole.points).query(every)[0].max()
    assert away <= whole.radius <= 3.0 * away
    extent = np.linalg.norm(every - whole.centre, axis=1).max()
    assert extent <= whole.extent <= 1.1 * extent + 2.0 * whole.radius
    box = 0.5 * (whole.points.min(axis=0) + whole.points.max(axis=0))
    assert whole.centre == pytest.approx(box, abs=1e-15)


def test_points_and_balls_are_their_centres():
    ball, point = Whole(pc.Sphere(0.3), 0.0), Whole(pc.Point(), 0.0)
    assert (ball.rounding, ball.radius, ball.extent) == (0.3, 0.0, 0.0)
    assert (point.rounding, point.radius, point.extent) == (0.0, 0.0, 0.0)
    assert ball.points.tolist() == point.points.tolist() == [[0.0, 0.0, 0.0]]
    assert not ball.centre.any()


def test_a_torus_is_its_centre_circle():
    tube, circle = Whole(pc.Torus(0.6, 0.2), 0.0), Whole(pc.Circle(0.6), 0.0)
    assert tube.rounding == 0.2 and tube.points.tolist() == circle.points.tolist()
    assert (tube.radius, tube.extent, tube.size) == (circle.radius, circle.extent, circle.extent + 0.2)


def torus_distance(major, minor):
    return lambda p: math.hypot(math.hypot(p[0], p[1]) - major, p[2]) - minor


# Ground, its distance from a point in its own frame, and places in front of it.
GROUNDS = {
    "torus": (pc.Torus(0.6, 0.2), torus_distance(0.6, 0.2), [(0.2, 0.3, 0.5), (0.9, -0.4, 0.3), (-0.3, 0.9, -0.2)]),
    "cylinder": (pc.Cylinder(0.3), lambda p: math.hypot(p[0], p[1]) - 0.3, [(0.6, 0.3, 2.5), (-0.2, 0.7, -9.0)]),
    "bounded": (
        pc.Cylinder(0.3, (None, (-1.0, 1.0))),
        lambda p: math.hypot(p[0], p[1]) - 0.3,
        [(0.6, 0.3, 0.5), (-0.2, 0.7, -0.8)],
    ),
}
MOVED = pin.SE3(pin.exp3(np.array([0.4, -0.7, 1.1])), np.array([0.3, -0.2, 0.5]))


@pytest.mark.parametrize("shape", [pc.Point(), pc.Sphere(0.05)], ids=lambda c: c.name)
@pytest.mark.parametrize("ground", GROUNDS)
def test_nearest_points_of_balls(ground, shape):
    """Against closed forms: the distance, a bound of it, and a bound of what is farther away than the neighbourhood."""
    contour, distance, places = GROUNDS[ground]
    radius = shape.size
    for k, place in enumerate(places):
        world = MOVED.act(np.array(place))
        system = system_of(shape, contour, [*world, *turned(k)], placement=MOVED)
        search = NearestSearch(system, 0, 0.0)
        exact = distance(place) - radius
        found = search.search(0.0)
        assert found.candidate is not None
        assert found.candidate.gap == pytest.approx(exact, abs=1e-9)
        own = MOVED.actInv(found.candidate.point)
        assert np.linalg.norm(own - np.array(place)) == pytest.approx(exact + radius, abs=1e-9)
        # cells are resolved to a twentieth of the distance or of the radius of curvature; there and back
        fine = 2.0 * 0.05 * max(exact + radius, search.bend)
        assert exact - fine <= found.distance <= exact
        neighbourhood = 0.5 * search.bend
        window = [(low, high) if high - low < 7.0 else (place[2] - 2.0, place[2] + 2.0) for low, high in contour.domain]
        samples = contour.evaluate_many(contour.samples((90, 90), window))[:, F]
        outside = np.linalg.norm(samples - own, axis=1) > neighbourhood
        beyond = (np.linalg.norm(samples - np.array(place), axis=1) - radius)[outside].min()
        assert found.distance <= found.elsewhere <= beyond
        # no worse than the resolution, and nothing beyond the neighbourhood is promised
        assert found.elsewhere >= min(beyond - 0.03, exact + neighbourhood) - 2.0 * fine


@pytest.mark.parametrize("kind", ["waves", "bowl"])
def test_nearest_points_of_a_ball_and_a_wide_ground_in_either_order(kind):
    """The distance of the centre from the ground, whichever body is named first and however near the ball is."""
    heights = {"waves": lambda x, y: 0.05 * np.sin(2.0 * x + 0.5 * y), "bowl": lambda x, y: 0.3 * x * x + 0.2 * y * y}
    field = pc.HeightField(heights[kind], domain=((-9.0, 9.0), (-9.0, 9.0)))
    rng, radius = np.random.default_rng(17), 0.04
    for gap in (0.0, 1e-9, 1e-4, 0.01, 0.1, 0.4):
        foot = field.evaluate(rng.uniform(-1.0, 1.0, 2))
        normal = np.cross(foot[1], foot[2])
        centre = foot[0] + (gap + radius) * normal / np.linalg.norm(normal)
        ball = pin.SE3(pin.Quaternion(turned(rng.integers(1000))).matrix(), centre)
        for first, second, relative in ((pc.Sphere(radius), field, ball), (field, pc.Sphere(radius), ball.inverse())):
            q = pin.SE3ToXYZQUAT(MOVED * relative)
            found = NearestSearch(system_of(first, second, q, placement=MOVED), 0, 0.0).search(0.0)
            # the radii of curvature of both grounds are larger than these gaps: no other point is as near
            assert found.candidate.gap == pytest.approx(gap, abs=1e-12)
            assert found.distance <= gap + 1e-12


def test_nearest_points_of_a_ring_beside_a_torus():
    ring, torus = pc.Circle(0.08), pc.Torus(0.6, 0.2)
    q = [0.5, 0.4, 0.5, *turned(5)]
    system = system_of(ring, torus, q)
    turn = pin.Quaternion(np.array(q[3:])).matrix()
    angles = np.linspace(0.0, 2.0 * math.pi, 20001)
    points = 0.08 * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles]) @ turn.T + np.array(q[:3])
    exact = min(map(torus_distance(0.6, 0.2), points))
    search = NearestSearch(system, 0, 0.0)
    rotation, centre = search.pose()
    assert rotation == pytest.approx(turn, abs=1e-14)
    assert centre == pytest.approx(q[:3], abs=1e-3)
    found = search.search(0.0)
    # samples of 3e-5 m are good to their square over a radius
    assert found.candidate.gap == pytest.approx(exact, abs=1e-7)
    # a ring is looked for from its centre: cells may be coarser by a part of its extent
    assert exact - 0.06 <= found.distance <= exact
    assert found.elsewhere >= found.distance


def test_how_far_a_search_may_look_without_finding_others():
    """Half the smaller radius of curvature, or in a hollow what is left of its radius beside body 1."""
    far = [0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 1.0]
    ball, torus = pc.Sphere(0.05), pc.Torus(0.6, 0.2)
    assert NearestSearch(system_of(ball, torus, far), 0, 0.0).bend == pytest.approx(0.15, rel=1e-9)
    assert NearestSearch(system_of(pc.Sphere(0.15), torus, far), 0, 0.0).bend == pytest.approx(0.075, rel=1e-9)
    assert NearestSearch(system_of(pc.Point(), torus, far), 0, 0.0).bend == pytest.approx(0.2, rel=1e-9)
    flat = pc.HeightField(lambda x, y: 0.1 * x, domain=((-1.0, 1.0), (-1.0, 1.0)))
    assert NearestSearch(system_of(pc.Point(), flat, far), 0, 0.0).bend == 100.0
    system = system_of(pc.Cylinder(0.1), pc.HeightField(lambda x, y: 0.1 * x), far)
    with pytest.raises(ValueError, match="unbounded"):
        NearestSearch(system, 0, 0.0)


def test_which_contacts_are_searched():
    far = [0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 1.0]
    for shape, ground, wanted in (
        (pc.Sphere(0.1), pc.Plane(), False),
        (pc.Sphere(0.1), pc.Torus(0.6, 0.2), True),
        (pc.Circle(0.1), pc.Helix(0.6, 0.2), True),
        (pc.Line((-0.1, 0.1)), pc.Line(), False),
        (pc.Point(), pc.Helix(0.6, 0.2), True),
    ):
        assert nearest.is_searched(system_of(shape, ground, far), 0) == wanted


# Samples and starts.


@pytest.mark.parametrize(
    "contour",
    [pc.Helix(0.4, 0.3), pc.Cylinder(0.3), pc.Torus(0.6, 0.2), pc.Point(), pc.Circle(0.2)],
    ids=lambda c: c.name,
)
def test_samples_are_of_the_placed_contour(contour):
    k = contour.dimension
    for guess in (np.full(2, np.nan), np.array([0.3, np.nan]), np.array([np.nan, 0.3])):
        if k < 2 and not np.isnan(guess[k:]).all():
            continue
        parameters, points, normals, tangents = sample(contour, MOVED, 0.0, 1.5, guess)
        assert len(tangents) == k
        for a, (low, high) in enumerate(contour.domain):
            column = parameters[:, a]
            if not np.isnan(guess[a]):
                assert set(column) == {guess[a]}
                continue
            # all of it, or of what is within the window, but for a thousandth at each end
            if contour.name == "Helix":
                # 1.9 m of height are 39.8 rad: the next quarter of an octave
                low, high = -(2.0**5.5), 2.0**5.5
            elif not math.isfinite(high - low):
                low, high = -1.5, 1.5
            inset = 1e-3 * (high - low)
            assert (column.min(), column.max()) == pytest.approx((low + inset, high - inset), rel=1e-12)
            steps = np.diff(np.unique(column))
            assert steps.max() == pytest.approx(steps.min(), rel=1e-6)
            assert steps.max() < 0.05 * (high - low)
        for i in range(0, len(points), 97):
            rows = contour.evaluate(parameters[i, :k])
            assert np.abs(MOVED.act(rows[F]) - points[i]).max() < 1e-15
            for tangent, row in zip(tangents, (F_1, F_2)):
                wanted = MOVED.rotation @ rows[row] / np.linalg.norm(rows[row])
                assert np.abs(tangent[i] - wanted).max() < 1e-14
                assert abs(tangent[i] @ normals[i]) < 1e-14
            if k:
                assert np.linalg.norm(normals[i]) == pytest.approx(1.0, rel=1e-14)
            if k == 1:
                # in the plane of planar curves
                assert abs(normals[i] @ MOVED.rotation[:, 2]) < 1e-14


def by_formula(radius, climb):
    return pc.ParametricCurve(lambda u: (radius * np.cos(u), radius * np.sin(u), climb * u), (-math.inf, math.inf))


@pytest.mark.parametrize("make", [lambda r, c: pc.Helix(r, 2.0 * math.pi * c), by_formula], ids=["Helix", "formula"])
@pytest.mark.parametrize("seed", range(4))
def test_what_goes_on_for_ever_in_angles_is_followed_as_far_as_it_is_near(make, seed):
    """The nearest turn of a helix is found at any height, against samples of 1e-4 rad."""
    rng = np.random.default_rng(seed)
    radius, climb = rng.uniform(0.1, 0.5), rng.uniform(0.01, 0.1) * rng.choice([-1.0, 1.0])
    place = np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3.0, 3.0)])
    system = system_of(pc.Point(), make(radius, climb), [*place, 0.0, 0.0, 0.0, 1.0])
    found = find_candidates(system, 0.0, UNKNOWN)[0]
    u = place[2] / climb + np.linspace(-10.0, 10.0, 200001)
    points = np.column_stack([radius * np.cos(u), radius * np.sin(u), climb * u])
    nearest_one = np.linalg.norm(points - place, axis=1).min()
    # samples are good to the square of their distance over the radius
    assert abs(found.gap) == pytest.approx(nearest_one, abs=1e-7)


def test_samples_of_what_goes_on_for_ever():
    """To where it is outside the window, to the next quarter of an octave, or as many as there may be; from a domain's
    end where it has one."""
    # 3.4 m from the origin, at 0.1 m a radian
    end = 2.0**5.25
    for contour, window, ends, count in (
        (pc.Helix(0.4, 0.2 * math.pi), 3.0, (-end, end), 314),
        (pc.Helix(0.4, 0.2 * math.pi, (5.0, math.inf)), 3.0, (5.0, end), 241),
        (pc.Helix(0.4, 0.2 * math.pi, (-math.inf, 40.0)), 3.0, (-end, 40.0), 322),
        # that never leaves it, and is one radius a radian
        (pc.Helix(0.4, 0.0), 1.0, (-358.4, 358.4), 2868),
        (by_formula(0.4, 0.1), 3.0, (-end, end), 241),
    ):
        parameters, *_ = sample(contour, MOVED, 0.0, window, np.full(2, np.nan))
        inset = 1e-3 * (ends[1] - ends[0])
        assert (parameters[0, 0], parameters[-1, 0]) == pytest.approx((ends[0] + inset, ends[1] - inset), rel=1e-12)
        assert len(parameters) == pytest.approx(count, abs=1)
    surface = pc.ParametricSurface(
        lambda u, v: (0.1 * u, np.cos(v), np.sin(v)), ((-math.inf, math.inf), (0.0, 2.0 * math.pi)), (False, True)
    )
    parameters, *_ = sample(surface, MOVED, 0.0, 3.0, np.full(2, np.nan))
    assert len(parameters) == 61 * 31
    # 4 m from the origin
    assert parameters[:, 0].max() == pytest.approx(2.0**5.5 * (1.0 - 2e-3), rel=1e-12)


@pytest.mark.parametrize(
    ("shape", "ground"),
    [
        (pc.Torus(0.3, 0.1), pc.Ellipsoid(0.5, 0.4, 0.3)),
        (pc.Circle(0.3), pc.Torus(0.6, 0.2)),
        (pc.Point(), pc.Torus(0.6, 0.2)),
    ],
    ids=["S-S", "3C-S", "P-S"],
)
def test_starts_are_pairs_that_are_near_or_near_and_aligned(shape, ground):
    system = system_of(shape, ground, [0.4, 0.5, 0.6, *turned(3)])
    one, two = (np.concatenate([system.frames[i, :3].ravel(), system.frames[i, 3]]) for i in (0, 1))
    poses = [pin.SE3(rows[:9].reshape(3, 3), rows[9:]) for rows in (one, two)]
    starts = np.array(_seeds(system, 0.0, UNKNOWN))
    assert 3 <= len(starts) <= 24
    k1 = shape.dimension

    def gaps(parameters):
        first = shape.evaluate(parameters[:k1])
        second = ground.evaluate(parameters[2:4])
        apart = np.linalg.norm(poses[0].act(first[F]) - poses[1].act(second[F]))
        normal = np.cross(second[F_1], second[F_2])
        normal = poses[1].rotation @ (normal / np.linalg.norm(normal))
        across = [abs(poses[0].rotation @ first[1 + a] @ normal) / np.linalg.norm(first[1 + a]) for a in range(k1)]
        return apart, max(across, default=0.0)

    found = np.array([gaps(start) for start in starts])
    # the nearest pair there is, up to the spacing of samples
    own = shape.evaluate_many(shape.samples((60, 60)[:k1] or 2))[:, F] @ poses[0].rotation.T + poses[0].translation
    other = ground.evaluate_many(ground.samples((60, 60)))[:, F] @ poses[1].rotation.T + poses[1].translation
    least = scipy.spatial.cKDTree(other).query(own)[0].min()
    assert found[:, 0].min() <= least + 0.03
    if k1:
        # tangents in the other's tangent plane, up to the angle between samples
        assert found[:, 1].min() < 0.1
        # a pair is one of neighbours: no farther than bodies of this size can be
        assert found[:, 0].max() < 2.0
        # and apart from each other, for each of the ways to weigh alignment
        assert len({tuple(start) for start in starts}) >= len(starts) // 3


# Candidates.


def test_the_nearest_point_of_an_ellipse():
    a, b = 0.5, 0.3
    angles = np.linspace(-math.pi, math.pi, 20001)
    x, y = a * np.cos(angles), b * np.sin(angles)
    for place in ((0.05, 0.03), (-0.1, 0.02), (0.7, 0.2), (0.1, 0.5), (-0.6, -0.2)):
        system = system_of(pc.Point(), pc.Ellipse(a, b), [*place, 1.0, 0.0], joint=pin.JointModelPlanar())
        found = find_candidates(system, 0.0, UNKNOWN)[0]
        distances = np.hypot(x - place[0], y - place[1])
        u = found.location[2]
        # samples 3e-4 apart are good to that, and to its square over a radius
        assert u == pytest.approx(angles[distances.argmin()], abs=4e-4)
        assert abs(found.gap) == pytest.approx(distances.min(), abs=1e-7)
        assert found.point == pytest.approx([a * math.cos(u), b * math.sin(u), 0.0], abs=1e-15)
        assert abs(found.gap) == pytest.approx(math.dist(found.point[:2], place), abs=1e-14)
        assert found.side == 0
        # starts are those of the one point and its neighbours on the curve
        assert all(abs(start[2] - u) < 0.1 for start in _seeds(system, 0.0, UNKNOWN))


def test_a_guess_is_followed_alone_and_comes_back_into_the_domain():
    a, b, place = 0.5, 0.3, (0.05, 0.03)
    system = system_of(pc.Point(), pc.Ellipse(a, b), [*place, 1.0, 0.0], joint=pin.JointModelPlanar())
    every = find_candidates(system, 0.0, UNKNOWN)
    for c, turns in itertools.product(every, (-3, 0, 2)):
        guess = np.array([np.nan, np.nan, c.location[2] + 0.01 + 2.0 * math.pi * turns, np.nan])
        (found,) = find_candidates(system, 0.0, guess)
        assert found.location[2] == pytest.approx(c.location[2], abs=1e-12)
    # an arc that ends before: only on its continuation, where that is asked for
    arc = system_of(pc.Point(), pc.Ellipse(a, b, (2.0, 3.0)), [0.7, 0.2, 1.0, 0.0], joint=pin.JointModelPlanar())
    assert find_candidates(arc, 0.0, UNKNOWN) == []
    (beyond,) = find_candidates(arc, 0.0, UNKNOWN, beyond=True)
    assert not 2.0 <= beyond.location[2] <= 3.0
    starts = np.array([[0.0, 0.0, beyond.location[2], 0.0]])
    assert not stationary_points(arc, 0.0, starts, [1])[0]
    assert stationary_points(arc, 0.0, starts, [1], inside=False)[0]


def test_two_circles_beside_each_other():
    """Four pairs of points have a common normal; the nearest of them is found, where both bend away."""
    system = system_of(pc.Circle(0.2), pc.Circle(0.5), [0.9, 0.3, 1.0, 0.0], joint=pin.JointModelPlanar())
    found = find_candidates(system, 0.0, UNKNOWN)
    middle = math.hypot(0.9, 0.3)
    possible = np.array([abs(middle + i * 0.5 + j * 0.2) for i in (-1, 1) for j in (-1, 1)])
    gaps = [abs(c.gap) for c in found]
    assert gaps == sorted(gaps)
    assert all(np.abs(possible - gap).min() < 1e-13 for gap in gaps)
    assert found[0].gap == pytest.approx(middle - 0.7, abs=1e-13)
    assert found[0].side == 1


# A body on the x axis beside or within a torus of radii 0.6 and 0.2: of all points on the axis at which both have a
# common normal, the gap along it and the side of the torus's outward normal on which the body bends away, 0 where the
# difference of the curvatures has no sign.
ON_AXIS = [
    # small: outside; in the tube; in the hole
    (pc.Ellipsoid(0.05, 0.06, 0.07), 0.9, {0.8: [(0.05, 1), (-0.15, -1)]}),
    (pc.Circle(0.05), 0.9, {0.8: [(0.05, 1), (-0.15, -1)]}),
    (pc.Ellipsoid(0.05, 0.06, 0.07), 0.3, {0.4: [(0.05, 1), (-0.15, -1)]}),
    (pc.Ellipsoid(0.05, 0.06, 0.07), 0.62, {0.8: [(0.13, -1)]}),
    # too large for the hole: a saddle there, on both sides of it
    (pc.Ellipsoid(0.5, 0.5, 0.51), -0.15, {0.4: [(0.05, 0), (1.05, 0)], -0.8: [(-0.15, 0)], 0.8: [(-1.45, 1)]}),
]


@pytest.mark.parametrize(("shape", "x", "expected"), ON_AXIS)
@pytest.mark.parametrize("side", [1, -1])
def test_the_gap_and_the_side_on_which_a_body_bends_away(shape, x, expected, side):
    system = system_of(shape, pc.Torus(0.6, 0.2), [x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], side=side)
    found = find_candidates(system, 0.0, UNKNOWN)
    assert [abs(c.gap) for c in found] == sorted(abs(c.gap) for c in found)
    for place, wanted in expected.items():
        here = [c for c in found if np.abs(c.point - [place, 0.0, 0.0]).max() < 1e-9]
        assert len(here) == len(wanted)
        for c, (gap, bends) in zip(here, wanted):
            # where bending does not tell, the gap is counted from the side assumed
            assert c.gap == pytest.approx(gap if bends else side * gap, abs=1e-12)
            assert c.side == bends


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize(
    ("shape", "ground"),
    [
        (pc.Point(), pc.Torus(0.6, 0.2)),
        (pc.Torus(0.1, 0.03), pc.Torus(0.6, 0.2)),
        (pc.Circle(0.1), pc.Torus(0.6, 0.2)),
        (pc.Circle(0.1), pc.Helix(0.6, 0.2)),
        (pc.Point(), pc.Helix(0.6, 0.2)),
    ],
    ids=["P-S", "S-S", "3C-S", "3C-3C", "P-3C"],
)
def test_equations_are_solved_for_tangents_of_any_length(shape, ground, scale):
    """Near a pole a tangent vanishes, and with it every equation: what counts are angles."""
    system = system_of(shape, ground, [0.9, 0.1, 0.3, *turned(2)])
    found = find_candidates(system, 0.0, UNKNOWN)[0]
    assert stationary_points(system, 0.0, found.location[None], [found.branch])[0]
    derivatives = system.derivatives.copy()
    tangents = [(0, 1 + a) for a in range(shape.dimension)] + [(1, 1 + a) for a in range(ground.dimension)]
    for body, row in tangents:
        system.derivatives[:] = derivatives
        system.derivatives[body, row] *= scale
        assert _is_solved(system, 0)
        # a hundredth of a rad off in the only way that matters
        length = np.linalg.norm(system.derivatives[body, row])
        away = system.frames[1, 3] - system.frames[0, 3] + derivatives[1, 0] - derivatives[0, 0]
        system.derivatives[body, row] += 0.01 * length * away / np.linalg.norm(away)
        assert not _is_solved(system, 0)


@pytest.mark.parametrize(
    ("shape", "ground"), [(pc.Sphere(0.05), pc.Helix(0.6, 0.2)), (pc.Ellipsoid(0.05, 0.04, 0.06), pc.Torus(0.6, 0.2))]
)
def test_open_contacts_are_not_followed_to_poles(shape, ground):
    """From starts all over, some of which lead there: where Newton's method ends, both tangents are at right angles to
    the way between the points, or the contact is nowhere."""
    system, lost = system_of(shape, ground, [0.3, 0.1, 0.2, *turned(2)]), 0
    system.contact_int[0, MODE] = FREE
    for start in np.random.default_rng(6).uniform(-3.0, 3.0, size=(300, 4)):
        system.location[0] = start
        assert system.evaluate_kinematics(0.0) == OK
        if system.gaps[0, 0] == NOTHING_THERE:
            lost += 1
            continue
        way = system.frames[1, 3] + system.derivatives[1, 0] - system.frames[0, 3] - system.derivatives[0, 0]
        for body, contour in enumerate((system.contacts[0].body1.contour, system.contacts[0].body2.contour)):
            for tangent in system.derivatives[body, 1 : 1 + contour.dimension]:
                assert abs(tangent @ way) <= 1e-6 * np.linalg.norm(tangent) * np.linalg.norm(way)
    assert 0 < lost < 300


def test_the_axis_that_normals_of_a_curve_are_made_from():
    """A world axis, of length one and well away from the tangent."""
    for tangent in np.random.default_rng(9).normal(size=(200, 3)):
        unit = tangent / np.linalg.norm(tangent)
        axis = curve_normal_axis(unit)
        assert sorted(axis) == [0.0, 0.0, 1.0]
        assert np.linalg.norm(np.cross(unit, axis)) > 0.4
    assert curve_normal_axis(np.array([1.0, 0.0, 0.0])).tolist() == [0.0, 0.0, 1.0]
    assert curve_normal_axis(np.array([0.0, 0.0, -1.0])).tolist() == [1.0, 0.0, 0.0]


@pytest.mark.parametrize("turns", [-2, 0, 3])
def test_a_location_comes_back_into_its_domain_whatever_chart_the_other_has(turns):
    """A ring that hangs over the pole of an ellipsoid, which is described by its other chart there."""
    ring, ground = pc.Circle(0.1), pc.Ellipsoid(0.5, 0.4, 0.3)
    turn = pin.Quaternion(pin.exp3(np.array([0.3, 1.2, 0.1]))).coeffs()
    system = system_of(ring, ground, [0.02, 0.01, 0.45, *turn])
    (first, *_) = find_candidates(system, 0.0, UNKNOWN)
    assert first.charts == (0, 1)
    # from the pole of the first chart, as a user would name it
    starts = np.array([[first.location[0] + 2.0 * math.pi * turns, 0.0, 0.4, 1.5]])
    (found,), _ = stationary_points(system, 0.0, starts, [1])
    assert found.charts == (0, 1)
    assert found.location == pytest.approx(first.location, abs=1e-9)
    assert found.gap == pytest.approx(first.gap, abs=1e-14)


@pytest.mark.parametrize("shape", [pc.Circle(0.3), pc.Point()], ids=["3C-3C", "P-3C"])
def test_starts_of_curves_that_cross_are_the_nearest_pairs(shape):
    """Their tangents are not to be aligned: each way to weigh that begins with the nearest pair."""
    ground = pc.Helix(0.6, 0.8, (-9.0, 9.0))
    system = system_of(shape, ground, [0.5, 0.4, 0.6, *turned(3)])
    starts = np.array(_seeds(system, 0.0, UNKNOWN))
    frames = system.frames

    def at(body, contour, u):
        return frames[body, :3] @ contour.point(u) + frames[body, 3]

    apart = [
        np.linalg.norm(at(0, shape, s[: shape.dimension]) - at(1, ground, s[2:3])) for s in starts
    ]  # fmt: skip
    own = [at(0, shape, u) for u in shape.samples(200)]
    least = scipy.spatial.cKDTree([at(1, ground, u) for u in np.linspace(-9.0, 9.0, 2000)]).query(own)[0].min()
    nearest_ = min(apart)
    assert least - 0.01 < nearest_ < least + 0.03
    first = starts[int(np.argmin(apart))]
    assert (np.abs(starts - first).max(axis=1) == 0.0).sum() == 3


@pytest.mark.parametrize("shape", [pc.Sphere(0.1), pc.Ellipsoid(0.1, 0.1, 0.1), pc.Circle(0.1)], ids=lambda c: c.name)
@pytest.mark.parametrize("side", [1, -1])
def test_both_extreme_points_of_what_is_round_above_and_below_a_plane(shape, side):
    """The lower one of a body bends away upwards, whatever side is assumed; gaps are counted that way."""
    turn = pin.Quaternion(pin.exp3(np.array([math.pi / 2, 0.0, 0.0]))).coeffs()
    for height, wanted in ((0.15, [(0.05, 1), (-0.25, -1)]), (-0.15, [(0.05, -1), (-0.25, 1)])):
        system = system_of(shape, pc.Plane(), [0.3, 0.2, height, *turn], side=side)
        found = find_candidates(system, 0.0, UNKNOWN)
        assert [c.side for c in found] == [bends for _, bends in wanted]
        assert [c.gap for c in found] == pytest.approx([gap for gap, _ in wanted], abs=1e-15)


@pytest.mark.parametrize("seed", range(3))
def test_normals_of_curves_are_made_from_the_axis_that_is_least_along_them(seed):
    """Curves along the axes, where the other choice would be none, and any others."""
    generator = np.random.default_rng(seed)
    for tangent in (
        *np.eye(3),
        *-np.eye(3),
        *generator.normal(size=(20, 3)),
        *generator.normal(size=(9, 3)) * [0.3, 0.3, 2],
    ):
        derivatives, basis = np.zeros((10, 3)), np.zeros((3, 3))
        derivatives[1] = 0.4 * tangent
        basis_of(ON_CURVE, 1, derivatives, np.zeros(3), basis)
        unit = tangent / np.linalg.norm(tangent)
        axis = np.array([0.0, 0.0, 1.0]) if abs(unit[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
        assert curve_normal_axis(unit) == pytest.approx(axis)
        across = axis - (axis @ unit) * unit
        across /= np.linalg.norm(across)
        assert basis == pytest.approx(np.array([unit, across, np.cross(unit, across)]), abs=1e-14)


@pytest.mark.parametrize("place", [(0.6, 0.0, 0.5), (-0.9, 0.1, 0.6), (0.1, -0.2, 0.7)])
def test_the_nearest_of_several_stationary_points(place):
    """Off the frames' origins, and by the distance between the points, not by what Newton comes to first."""
    placement = pin.SE3(pin.exp3(np.array([0.3, 0.2, -0.4])), np.array([2.0, -1.0, 3.0]))
    domain = ((-3.0, 3.0), (-1.0, 1.0))
    wave = pc.HeightField(lambda x, y: 0.2 * np.cos(3.0 * x) + 0.05 * x + 0.1 * y * y, domain=domain)
    ball = 0.05
    system = system_of(pc.Sphere(ball), wave, [*placement.act(np.array(place)), *turned(2)], placement=placement)
    found = NearestSearch(system, 0, 0.0).search(0.0).candidate
    x, y = np.meshgrid(np.linspace(-2.0, 2.0, 801), np.linspace(-0.8, 0.8, 321))
    points = np.stack([x, y, 0.2 * np.cos(3.0 * x) + 0.05 * x + 0.1 * y * y], -1).reshape(-1, 3)
    # samples of 5e-3 m are good to their square over the distance
    exact = np.linalg.norm(points - np.array(place), axis=1).min() - ball
    assert found.gap == pytest.approx(exact, abs=1e-4)


@pytest.mark.parametrize(("k1", "k2"), [(0, 1), (1, 1), (0, 2), (1, 2), (2, 2)])
@pytest.mark.parametrize("seed", range(3))
def test_equations_of_the_location(seed, k1, k2):
    """C1 with the metric of body 2, then C2: the unknowns are u_1, u_2, and the determinant is theirs."""
    rng = np.random.default_rng([seed, k1, k2])
    system = rng.normal(size=(4, 8))
    metric, one, two, sides = system
    matrix = np.zeros((k1 + k2, k1 + k2))
    matrix[:k2, :k2] = np.array([[metric[0], metric[1]], [metric[1], metric[2]]])[:k2, :k2]
    for a, row in enumerate((one, two)[:k1]):
        matrix[:k2, k2 + a] = row[:k2]
        matrix[k2 + a, :k2] = row[2 : 2 + k2]
        matrix[k2 + a, k2:] = row[4 : 4 + k1]
    right = [*sides[:k2], *sides[2 : 2 + k1]]
    expected, determinant = np.linalg.solve(matrix, right), np.linalg.det(matrix)
    if k1 == k2 == 1:
        # columns in the other order
        determinant = -determinant
    singular = system.copy()
    assert solve_of(k1, k2, system) == pytest.approx(determinant, rel=1e-10)
    assert sides[2 : 2 + k2] == pytest.approx(expected[:k2], rel=1e-9)
    assert sides[:k1] == pytest.approx(expected[k2:], rel=1e-9)
    # nothing is found, or changed, at a focus
    singular[0, :3] = 0.0
    before = singular.copy()
    assert solve_of(k1, k2, singular) == 0.0
    assert (singular == before).all()


@pytest.mark.parametrize(("k1", "k2"), [(0, 1), (1, 1), (0, 2), (1, 2), (2, 2)])
def test_conditioning_has_no_units(k1, k2):
    """It is the determinant of C1 by unit tangents, and of C2 times a length."""
    system = made_system(2, rng=np.random.default_rng([7, k1, k2]))
    system.contact_real[1, LENGTH], system.contact_int[1, [K1, K2]] = 0.2, [k1, k2]
    first, second, normal = system.derivatives[2], system.derivatives[3], system.vectors[NORMAL]
    for pattern in (ON_SURFACE, CROSSING_CURVES):
        expected = 3.0
        for a in range(k2):
            expected /= np.linalg.norm(second[1 + a]) ** 2
        for a in range(k1):
            expected /= np.linalg.norm(first[1 + a]) ** 2
            expected *= 1.0 if pattern == CROSSING_CURVES else 0.2 / np.linalg.norm(normal)
        system.contact_int[1, PATTERN] = pattern
        assert conditioning_of(system, 1, 3.0) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("shape", [pc.Torus(0.3, 0.1), pc.Circle(0.3), pc.Point()], ids=lambda c: c.name)
def test_starts_are_apart_from_each_other(shape):
    """Of each weight of alignment, by a quarter of the contact's length on both bodies together."""
    system = system_of(shape, pc.Torus(0.6, 0.2), [0.4, 0.5, 0.6, *turned(3)])
    starts = np.array(_seeds(system, 0.0, UNKNOWN))
    length = system.contact_real[0, LENGTH]
    poses = [system.frames[i] for i in (0, 1)]
    k1 = shape.dimension
    places = np.array(
        [
            np.concatenate(
                [
                    poses[0][:3] @ shape.evaluate(start[:k1])[F] + poses[0][3],
                    poses[1][:3] @ pc.Torus(0.6, 0.2).evaluate(start[2:])[F] + poses[1][3],
                ]
            )
            for start in starts
        ]
    )
    distances = np.linalg.norm(places[:, None] - places[None], axis=2)
    # eight of each weight, if there are so many
    group = len(starts) // 3 if k1 else 1
    for i in range(3 if k1 else 1):
        own = distances[i * group : (i + 1) * group, i * group : (i + 1) * group]
        assert (own[~np.eye(group, dtype=bool)] > 0.25 * length).all()


@pytest.mark.parametrize(
    "contour",
    [
        pc.Torus(0.6, 0.2),
        pc.HeightField(lambda x, y, t: 0.1 * np.sin(2.0 * x + t) * np.cos(y - 0.3 * t)),
        pc.ParametricSurface(lambda u, v, t: (u + 0.1 * t * v, v, u * v * t), ((-2.0, 2.0), (-2.0, 2.0))),
        pc.Circle(0.7),
        pc.ParametricCurve(lambda u, t: (u, 0.1 * t * u * u, 0.1 * np.sin(u + t)), (-2.0, 2.0)),
    ],
    ids=lambda c: c.name + (" in time" if c.time_dependent else ""),
)
def test_derivatives_of_a_contour_in_world_axes(contour):
    """All of them that there are, those by time, too; others are not touched."""
    placement = pin.SE3(pin.exp3(np.array([0.2, 0.3, -0.2])), np.array([0.2, -0.1, 0.4]))
    place = placement.act(np.array([0.5, 0.4, 0.3]))
    system = system_of(pc.Point(), contour, [*place, 0.0, 0.0, 0.0, 1.0], placement=placement)
    system.location[0, 2:] = 0.4, 0.3
    system.derivatives[1] = 0.0
    system.evaluate_kinematics(0.6)
    k = contour.dimension
    expected = contour.evaluate(system.location[0, 2 : 2 + k], 0.6) @ placement.rotation.T
    assert system.derivatives[1] == pytest.approx(expected, abs=1e-14)
    assert bool(expected[6:].any()) == contour.time_dependent


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3)])
def test_spheres_beside_each_other_along_an_axis(axis):
    """Centres that differ in one coordinate only do not coincide."""
    scene = pc.Scene(free_body())
    small = scene.add_contour("small", pc.Sphere(0.1), frame="body")
    scene.add_contact("c", small, scene.add_contour("large", pc.Sphere(0.5)))
    track = pc.simulate(scene, scene.initial_state([*(0.6 * axis), 0.0, 0.0, 0.0, 1.0]), 1e-6).contacts["c"]
    assert track.point[0] == pytest.approx(0.5 * axis, abs=1e-15)


def test_relative_velocity_where_both_contours_move_in_time():
    """v_c is the difference of the velocities of material points; a contour that changes in time carries its own."""
    growing = pc.ParametricSurface(
        lambda u, v, t: (u, v, 0.3 * t + 0.1 * u * u + 0.05 * t * v), ((-2.0, 2.0), (-2.0, 2.0))
    )
    point = pc.ParametricCurve(lambda u, t: (u, 0.2 * t, 0.4 * u * u - 0.7 * t), (-2.0, 2.0))
    system = system_of(point, growing, [0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0])
    system.v[:] = 0.3, -0.2, 0.1, 0.4, 0.5, -0.6
    system.evaluate_kinematics(0.5)
    u1, u2 = system.location[0, 0], system.location[0, 2:]
    material = pin.exp3(np.zeros(3)) @ np.array([u1, 0.1, 0.4 * u1 * u1 - 0.35])
    own = system.v[:3] + np.cross(system.v[3:], material) + np.array([0.0, 0.2, -0.7])
    other = np.array([0.0, 0.0, 0.3 + 0.05 * u2[1]])
    assert system.slip[0] == pytest.approx(other - own, abs=1e-13)
