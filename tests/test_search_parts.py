"""Parts of the search for contact points: guesses, samples, boxes, cells, and what a step may not pass."""

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
import scipy
from test_parts_of_geometry import MOVED, UNKNOWN, free_body, system_of, turned

import pincontact as pc
from pincontact.contours.base import F
from pincontact.contours.charts import convert_chart
from pincontact.errors import PatternError
from pincontact.geometry.nearest import NearestSearch
from pincontact.geometry.patterns import find_pattern
from pincontact.geometry.search import _within, find_candidates, sample, spaced, stationary_points
from pincontact.layout import LAST_NORMAL_X, LOCATION_FAILED, OK, SIDE

UPRIGHT = [0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("shape", "ground", "q"),
    [
        (pc.Sphere(0.1), pc.Plane(), [0.3, 0.2, 0.15, *UPRIGHT]),
        (pc.Circle(0.1), pc.Plane(), [0.3, 0.2, 0.15, *turned(4)]),
        (pc.Point(), pc.Sphere(0.5), [0.3, 0.2, 0.6, *UPRIGHT]),
        (pc.Sphere(0.1), pc.Sphere(0.5), [0.3, 0.2, 0.6, *UPRIGHT]),
    ],
    ids=["ball on plane", "ring on plane", "point on ball", "ball on ball"],
)
def test_a_complete_guess_names_one_of_the_solutions_in_closed_form(shape, ground, q):
    system = system_of(shape, ground, q)
    every = find_candidates(system, 0.0, UNKNOWN)
    assert len(every) == (4 if isinstance(ground, pc.Sphere) and shape.dimension else 2)
    for wanted in every:
        # parameters of the first charts
        guess = wanted.location + 0.01
        for side, contour in enumerate((shape, ground)):
            u = guess[2 * side : 2 * side + 2]
            u[:] = convert_chart(contour.kind, contour.shape_row(), wanted.charts[side], *u, 0)
        (found,) = find_candidates(system, 0.0, guess)
        assert found.branch == wanted.branch
        assert found.point == pytest.approx(wanted.point, abs=1e-9)


@pytest.mark.parametrize("side", [1, -1])
def test_starts_in_any_charts(side):
    """Coordinates in other charts name the same place, and its side, which is that of the near end of an ellipsoid."""
    system = system_of(pc.Ellipsoid(0.1, 0.2, 0.3), pc.Sphere(1.0), [0.3, 0.5, 0.9, *turned(3)], side=side)
    every = find_candidates(system, 0.0, UNKNOWN)
    assert {found.side for found in every} == {1, -1}
    for wanted in every:
        for charts in itertools.product((0, 1), repeat=2):
            start = wanted.location + 1e-3
            for k, contour in enumerate((pc.Ellipsoid(0.1, 0.2, 0.3), pc.Sphere(1.0))):
                u = start[2 * k : 2 * k + 2]
                u[:] = convert_chart(contour.kind, contour.shape_row(), wanted.charts[k], *u, charts[k])
            (found,), _ = stationary_points(system, 0.0, np.array([start]), [1], charts=charts)
            assert found.is_at(wanted, 1.0) and found.side == wanted.side


def oblique(u, v):
    return (u + 5.0 * v, v, 0.1 * u * v)


def test_normals_of_samples_are_unit_vectors_across_both_tangents():
    """Of a surface whose parameter lines meet at an angle of 11 degrees, and of one with a pole, which has none."""
    sheet = pc.ParametricSurface(oblique, ((-1.0, 1.0), (-1.0, 1.0)))
    _, _, normals, tangents = sample(sheet, MOVED, 0.0, 1.0, np.full(2, np.nan))
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(normals)), rel=1e-12)
    for tangent in tangents:
        assert np.abs(np.einsum("ij,ij->i", normals, tangent)).max() < 1e-12
    fan = pc.ParametricSurface(lambda u, v: (u * np.cos(v), u * np.sin(v), 0.0), ((0.0, 1.0), (0.0, 1.0)))
    _, points, normals, tangents = sample(fan, pin.SE3.Identity(), 0.0, 1.0, np.array([0.0, np.nan]))
    assert not points.any()
    assert not normals.any()
    assert not tangents[1].any()


@pytest.mark.parametrize("charted", [False, True])
def test_a_ring_within_a_hollow(charted):
    """Its nearest point is found where the location equations have the other sign than outside."""
    ground = pc.Ellipsoid(0.5, 0.4, 0.3) if charted else pc.Torus(0.6, 0.3)
    place = [0.3, 0.1, 0.02] if charted else [0.72, 0.1, 0.02]
    q = [*place, *turned(5)]
    system = system_of(pc.Circle(0.06), ground, q, side=-1)
    found = NearestSearch(system, 0, 0.0).search(0.0).candidate
    angles = np.linspace(0.0, 2.0 * math.pi, 361)
    ring = 0.06 * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    ring = ring @ pin.Quaternion(np.array(q[3:])).matrix().T + np.array(place)
    samples = ground.evaluate_many(ground.samples((200, 120)))[:, F]
    exact = scipy.spatial.cKDTree(samples).query(ring)[0].min()
    # samples 0.015 m apart are good to half of that squared over the distance
    assert found.gap == pytest.approx(exact, abs=1e-3)


def test_what_is_far_from_the_nearest_point_is_known_to_be_far():
    """Close to a cylinder, along its axis: the distance and the chord from the nearest point are at right angles."""
    radius, d = 0.3, 0.01
    placement = pin.SE3(pin.exp3(np.array([0.4, -0.7, 1.1])), np.array([1.3, -0.2, 0.5]))
    world = placement.act(np.array([radius + d, 0.0, 0.2]))
    system = system_of(pc.Point(), pc.Cylinder(radius), [*world, *UPRIGHT], placement=placement)
    search = NearestSearch(system, 0, 0.0)
    found = search.search(0.0)
    assert found.candidate.gap == pytest.approx(d, abs=1e-12)
    chord = 0.5 * search.bend
    # of cells beyond it, which are as large as a twentieth of the radius of curvature
    fine = 0.05 * search.bend
    # a tenth of the radius around a point has been looked at
    assert min(math.hypot(d, chord) - fine, d + 0.1 * radius) <= found.elsewhere <= math.hypot(d, chord + 2.0 * fine)


def test_cells_are_not_divided_without_end():
    """From the middle of what is nearly a ball all of it is equally near."""
    system = system_of(pc.Point(), pc.Ellipsoid(0.5, 0.5001, 0.5002), [0.0, 0.0, 0.0, *UPRIGHT])
    search = NearestSearch(system, 0, 0.0)
    search.search(0.0)
    assert 576 < search._cells.counts["cells"] <= 4096


@pytest.mark.parametrize("beyond", [0.0, 0.2])
def test_the_part_of_a_domain_that_is_looked_at(beyond):
    """As far from the foot of a body's centre as anything that is nearest to any point of it may be, no farther."""
    ring, centre = pc.Circle(0.1), np.array([0.3, -0.2, 0.5])
    placement = pin.SE3(pin.exp3(np.array([0.4, -0.7, 1.1])), np.array([1.3, -0.2, 0.5]))
    q = [*placement.act(centre), *turned(3)]
    field = pc.HeightField(lambda x, y: 0.1 + 0.0 * x, domain=((-math.inf, math.inf), (-1.0, 0.1)))
    search = NearestSearch(system_of(ring, field, q, placement=placement), 0, 0.0)
    # from a point of the ground at this height, by the ring's diameter: to any that may be as near to another point
    extent = search.whole.extent
    assert extent == pytest.approx(0.1, rel=0.05)
    reach = 0.4 + 2.0 * extent + beyond
    first, second = search._box(0.0, centre, beyond)
    assert first == pytest.approx((0.3 - reach, 0.3 + reach), rel=1e-12)
    # cut to its domain, from the nearest place in it
    assert second == pytest.approx((max(-1.0, -0.2 - reach), 0.1), rel=1e-12)
    off = search._box(0.0, np.array([0.3, 0.5, 0.5]), beyond)[1]
    assert off == pytest.approx((max(-1.0, 0.1 - math.hypot(0.4, 0.4) - 2.0 * extent - beyond), 0.1), rel=1e-12)


def test_parameters_without_end_are_looked_at_where_something_may_be_near():
    """A rod of 4 m for each unit of its parameter, of which its contact was last at 0.5."""
    rod = pc.ParametricSurface(
        lambda u, v: (0.1 * np.cos(u), 0.1 * np.sin(u), 4.0 * v),
        ((0.0, 2.0 * math.pi), (-math.inf, math.inf)),
        (True, False),
    )
    system = system_of(pc.Sphere(0.05), rod, [0.5, 0.0, 2.0, *UPRIGHT])
    system.location[0, 2:] = 0.0, 0.5
    search = NearestSearch(system, 0, 0.0)
    _, (low, high) = search._box(0.0, np.array([0.5, 0.0, 2.0]), 0.3)
    # 0.4 m to the centre, and 0.3 beyond, of which the rod is 0.4 m away: to the next quarters of octaves
    along = math.sqrt(0.7**2 - 0.4**2)
    for end, exact in ((low, 0.5 - along / 4.0), (high, 0.5 + along / 4.0)):
        assert abs(end - 0.5) >= abs(exact - 0.5) and abs(math.log2(end / exact)) < 0.25


def test_the_parameters_at_which_a_ball_faces_a_point():
    ball = pc.Sphere(0.1)
    system = system_of(ball, pc.Torus(0.6, 0.2), [0.2, 0.3, 0.7, *turned(6)], placement=MOVED)
    search = NearestSearch(system, 0, 0.0)
    rotation, centre = search.pose()
    points = np.random.default_rng(3).normal(size=(5, 3))
    for point, u in zip(points, search._facing(points)):
        away = point - centre
        facing = rotation @ ball.point(u)
        assert facing == pytest.approx(0.1 * away / np.linalg.norm(away), abs=1e-14)


@pytest.mark.parametrize(("ground", "crossing"), [(pc.Helix(0.6, 0.3, (-9.0, 9.0)), True), (pc.Torus(0.6, 0.2), False)])
def test_a_normal_that_turns_over_within_a_step(ground, crossing):
    """Crossing curves went through parallel, where their normal jumps; others' normals cannot."""
    system = system_of(pc.Circle(0.3), ground, [0.5, 0.1, 0.2, *turned(2)])
    found = find_candidates(system, 0.0, UNKNOWN)[0]

    def status(last):
        system.location[0] = found.location
        system.contact_real[0, LAST_NORMAL_X : LAST_NORMAL_X + 3] = last
        return system.evaluate_kinematics(0.0)

    assert status(np.zeros(3)) == OK
    normal = system.basis[0, 2].copy()
    across = system.basis[0, 0].copy()
    for last in (normal, 0.3 * normal + across):
        assert status(last) == OK
    for last in (-normal, across - 0.3 * normal):
        assert status(last) == (LOCATION_FAILED if crossing else OK)


def test_only_points_on_spatial_curves_have_two_gaps():
    for ground, two in ((pc.Helix(0.6, 0.3, (-9.0, 9.0)), True), (pc.Torus(0.6, 0.2), False)):
        system = system_of(pc.Point(), ground, [0.5, 0.3, 0.2, *UPRIGHT])
        system.location[0] = find_candidates(system, 0.0, UNKNOWN)[0].location
        system.gaps[0] = 7.0
        assert system.evaluate_kinematics(0.0) == OK
        difference = system.frames[1, 3] + system.derivatives[1, 0] - system.frames[0, 3] - system.derivatives[0, 0]
        gaps = system.basis[0] @ difference
        assert system.gaps[0] == pytest.approx([gaps[2], gaps[1] if two else 0.0], abs=1e-15)
        assert gaps[0] == pytest.approx(0.0, abs=1e-12)
        assert abs(gaps[1]) > 0.05 if two else abs(gaps[1]) < 1e-12


@pytest.mark.parametrize("side", [1, -1])
def test_the_normal_points_from_body_1_into_body_2(side):
    """Whatever side is assumed; the rows are an orthonormal right-handed basis."""
    for shape, ground in itertools.product((pc.Circle(0.05), pc.Sphere(0.05)), (pc.Torus(0.6, 0.2), pc.Cylinder(0.6))):
        system = system_of(shape, ground, [0.9, 0.1, 0.05, *turned(8)], side=side)
        for candidate in find_candidates(system, 0.0, UNKNOWN):
            system.location[0] = candidate.location
            assert system.evaluate_kinematics(0.0) == OK
            basis, second = system.basis[0], system.derivatives[1]
            assert basis @ basis.T == pytest.approx(np.eye(3), abs=1e-14)
            assert np.linalg.det(basis) == pytest.approx(1.0)
            assert np.cross(basis[0], second[1]) == pytest.approx(np.zeros(3), abs=1e-14)
            outward = np.cross(second[1], second[2])
            assert system.contact_int[0, SIDE] == side
            assert basis[2] @ outward * side < 0.0


def test_parameters_of_a_field_are_lengths_however_it_is_made():
    x = np.linspace(-1.0, 1.0, 8)
    for field in (pc.HeightField(lambda x, y: x * y), pc.HeightField(x, x, np.outer(x, x))):
        assert field.lengths
    assert not pc.Torus(0.6, 0.2).lengths


def test_candidates_of_contours_that_are_placed_somewhere():
    """Points are the world's, wherever the frames are and however fast."""
    system = system_of(pc.Circle(0.1), pc.Torus(0.6, 0.2), [1.3, 0.4, 0.2, *turned(2)], placement=MOVED)
    system.v[:] = np.arange(1.0, 7.0)
    for found in find_candidates(system, 0.0, UNKNOWN):
        assert found.point == pytest.approx(MOVED.act(pc.Torus(0.6, 0.2).point(found.location[2:])), abs=1e-12)


def test_stationary_points_on_the_other_side_are_not_the_nearest():
    """In the tube of a torus a ring bends to its inside, whichever side was named."""
    q = [0.72, 0.1, 0.02, *turned(5)]
    found = [
        NearestSearch(system_of(pc.Circle(0.06), pc.Torus(0.6, 0.3), q, side=side), 0, 0.0).search(0.0)
        for side in (-1, 1)
    ]
    assert found[0].candidate.side == -1
    assert found[1].candidate is None
    assert found[1].elsewhere == found[1].distance == found[0].distance > 0.0


def test_rows_of_derivatives_that_a_contour_has_not_are_left_alone():
    curve = pc.ParametricCurve(lambda u, t: (u, 0.1 * t * u * u, 0.1 * np.sin(u + t)), (-2.0, 2.0))
    system = system_of(pc.Point(), curve, [0.4, 0.1, 0.3, *UPRIGHT])
    system.derivatives[:, [2, 4, 5, 8]] = 7.0
    system.derivatives[0, [1, 3, 7]] = 7.0
    assert system.evaluate_kinematics(0.6) == OK
    assert (system.derivatives[:, [2, 4, 5, 8]] == 7.0).all()
    assert (system.derivatives[0, [1, 3, 7]] == 7.0).all()


def test_patterns_of_pairs_and_mechanisms():
    """Planar where the mechanism keeps the plane, unless another one is wanted; who wants one gets it, or is told."""
    circle, line, helix, plane, point = pc.Circle(1.0), pc.Line(), pc.Helix(1.0, 1.0), pc.Plane(), pc.Point()
    for one, two, spatial, planar in (
        (point, circle, "P-3C", "P-2C"),
        (circle, line, "3C-3C", "2C-2C"),
        (point, helix, "P-3C", "P-3C"),
        (helix, circle, "3C-3C", "3C-3C"),
        (point, plane, "P-S", "P-S"),
        (circle, plane, "3C-S", "3C-S"),
        (plane, plane, "S-S", "S-S"),
    ):
        for keeps, name in ((False, spatial), (True, planar)):
            assert find_pattern("c", one, two, None, keeps).name == name
            assert find_pattern("c", one, two, name, keeps).name == name
            assert find_pattern("c", one, two, spatial, keeps).name == spatial
        if planar != spatial:
            with pytest.raises(PatternError, match="can leave the plane"):
                find_pattern("c", one, two, planar, False)
    with pytest.raises(PatternError, match="a point against a point"):
        find_pattern("c", point, point, None, False)
    with pytest.raises(PatternError, match="not S-S"):
        find_pattern("c", point, plane, "S-S", False)
    with pytest.raises(PatternError, match="unknown pattern"):
        find_pattern("c", point, plane, "P-P", False)


@pytest.mark.parametrize("turned_about", [None, *np.eye(3)], ids=["still", "x", "y", "z"])
@pytest.mark.parametrize("shift", [0.0, 1e-3])
def test_which_mechanisms_stay_in_a_plane(turned_about, shift):
    """A planar joint's circle, driven or not, in the plane of a line or a little beside it."""

    def pattern(frames, placement):
        scene = pc.Scene(free_body(pin.JointModelPlanar()))
        motion = None if turned_about is None else pc.HarmonicMotion(axis=turned_about, angle=0.1)
        scene.add_contour("a", pc.Circle(0.1), frame=frames[0], placement=placement, motion=motion)
        scene.add_contour("b", pc.Ellipse(0.5, 0.4), frame=frames[1])
        return scene.add_contact("c", "a", "b").pattern.name

    planar = (turned_about is None or turned_about[2] == 1.0) and shift == 0.0
    for frames in (("body", "universe"), ("universe", "body")):
        for turn in (0.0, math.pi):
            placement = pin.SE3(pin.exp3(np.array([turn, 0.0, 0.0])), np.array([0.3, 0.2, shift]))
            assert pattern(frames, placement) == ("2C-2C" if planar else "3C-3C")
        tilted = pin.SE3(pin.exp3(np.array([1e-3, 0.0, 0.0])), np.array([0.3, 0.2, 0.0]))
        assert pattern(frames, tilted) == "3C-3C"


def ring_of(scale):
    """A ring with that many turns in each 2 pi of its parameter."""
    end = 2.0 * math.pi / scale
    return pc.ParametricCurve(lambda u: (0.1 * np.cos(scale * u), 0.1 * np.sin(scale * u), 0.0 * u), (0.0, end), True)


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
def test_locations_are_exact_whatever_parameters_mean(scale):
    """Steps of Newton's method count as lengths, on either body."""
    ring, torus = ring_of(scale), pc.Torus(0.6, 0.2)
    q = [1.0, 0.1, 0.05, *turned(8)]
    exact = find_candidates(system_of(ring_of(1.0), torus, q), 0.0, UNKNOWN)[0].location
    system = system_of(ring, torus, q)
    system.location[0] = exact + np.array([0.02, 0.0, 0.02, 0.02])
    system.location[0, 0] /= scale
    assert system.evaluate_kinematics(0.0) == OK
    assert system.location[0] * [scale, 1.0, 1.0, 1.0] == pytest.approx(exact, abs=1e-12)
    point = system_of(pc.Point(), ring, [0.07, 0.04, 0.02, *UPRIGHT])
    point.location[0, 2] = (math.atan2(0.04, 0.07) + 0.02) / scale
    assert point.evaluate_kinematics(0.0) == OK
    assert point.location[0, 2] * scale == pytest.approx(math.atan2(0.04, 0.07), abs=1e-12)


def test_what_is_convex_says_so():
    for contour in (pc.Sphere(1.0), pc.Ellipsoid(1.0, 2.0, 3.0), pc.Cylinder(1.0), pc.Cone(0.3), pc.Circle(1.0)):
        assert contour.convex_side == 1
    for contour in (pc.Cylinder(1.0, ((0.0, 1.0), None)), pc.Torus(2.0, 1.0), pc.Plane(), pc.Line(), pc.Point()):
        assert contour.convex_side == 0


@pytest.mark.parametrize("place", [(0.6, 0.0, 0.5), (0.1, -0.2, 0.6)])
def test_the_nearest_of_several_stationary_points_of_a_ring(place):
    wave = pc.HeightField(
        lambda x, y: 0.2 * np.cos(3.0 * x) + 0.05 * x + 0.1 * y * y, domain=((-3.0, 3.0), (-1.0, 1.0))
    )
    q = [*place, *turned(2)]
    found = NearestSearch(system_of(pc.Circle(0.2), wave, q), 0, 0.0).search(0.0).candidate
    angles = np.linspace(0.0, 2.0 * math.pi, 241)
    ring = 0.2 * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    ring = ring @ pin.Quaternion(np.array(q[3:])).matrix().T + np.array(place)
    x, y = np.meshgrid(np.linspace(-1.5, 1.5, 401), np.linspace(-0.8, 0.8, 201))
    points = np.stack([x, y, 0.2 * np.cos(3.0 * x) + 0.05 * x + 0.1 * y * y], -1).reshape(-1, 3)
    # samples 8e-3 m apart are good to their square over the distance
    assert found.gap == pytest.approx(scipy.spatial.cKDTree(points).query(ring)[0].min(), abs=5e-4)


def test_relative_velocity_on_a_ground_that_turns():
    """A turntable carries what is on it along its own way, and a torus beside its axis, too."""
    motion = pc.ConstantTwist((0.3, -0.2, 2.0), (0.1, 0.0, 0.2), (0.1, 0.2, 0.0))
    for ground, place in ((pc.Plane(), [0.5, 0.4, 0.05]), (pc.Torus(0.6, 0.2), [0.9, 0.2, 0.1])):
        system = system_of(pc.Sphere(0.05), ground, [*place, *turned(1)], motion=motion)
        system.v[:] = 0.3, -0.2, 0.1, 0.4, 0.5, -0.6
        turn = pin.Quaternion(np.array(turned(1))).matrix()
        system.location[0] = find_candidates(system, 0.0, UNKNOWN)[0].location
        assert system.evaluate_kinematics(0.0) == OK
        point = system.frames[0, 3] + system.derivatives[0, 0]
        other = system.frames[1, 3] + system.derivatives[1, 0]
        own = turn @ (system.v[:3] + np.cross(system.v[3:], turn.T @ (point - np.array(place))))
        carried = np.array([0.1, 0.0, 0.2]) + np.cross([0.3, -0.2, 2.0], other - np.array([0.1, 0.2, 0.0]))
        assert system.slip[0] == pytest.approx(carried - own, abs=1e-13)


@pytest.mark.parametrize("slope", [0.0, 3.0])
def test_windows_of_endless_parameters_are_measured_along_them(slope):
    """A plane that rises along its second parameter leaves the window in m sooner there."""
    plane = pc.HeightField(lambda x, y: 2.0 + slope * y)
    low, high, count = _within(plane, 1, 0.0, 10.0)
    # where it is 12 m from its origin, 2 m under it, to the next quarter of an octave
    for end in (low, high):
        assert np.linalg.norm(plane.point((0.0, end / 2.0**0.25))) < 12.0 < np.linalg.norm(plane.point((0.0, end)))
    flat = _within(plane, 0, 0.0, 10.0)
    assert flat[:2] == pytest.approx((-(2.0**3.75), 2.0**3.75), rel=1e-12)
    # as many samples per metre, up to the rounding of their number
    assert count / (high - low) == pytest.approx(flat[2] / (flat[1] - flat[0]) * np.hypot(1.0, slope), rel=0.1)


def test_what_is_inside_between_places_that_are_not():
    """A ring lies across a trough: both its sides are above, and its lowest place, between two places that cut the
    ground, is below it."""
    wave = pc.HeightField(lambda x, y: 0.05 * math.sin(4.0 * math.pi * x))
    q = np.array([-1.02086307, 0.36, -0.00815201794, 0.263322596, 1.97956699e-4, -0.964676357, -0.00779080759])
    q[3:] /= np.linalg.norm(q[3:])
    angles = np.linspace(0.0, 2.0 * math.pi, 10_000)
    circle = 0.08 * np.array([np.cos(angles), np.sin(angles), 0.0 * angles])
    x, _, z = q[:3, None] + pin.Quaternion(q[3:]).toRotationMatrix() @ circle
    lowest = int(np.argmin(z - 0.05 * np.sin(4.0 * math.pi * x)))
    slope = 0.2 * math.pi * math.cos(4.0 * math.pi * x[lowest])
    gaps = [found.gap for found in NearestSearch(system_of(pc.Circle(0.08), wave, q), 0, 0.0).search(0.0).candidates]
    # a vertical distance is seen along the normal, to second order in it over the radius of curvature
    depth = (z[lowest] - 0.05 * math.sin(4.0 * math.pi * x[lowest])) / math.hypot(1.0, slope)
    assert depth < -3e-3 and min(gaps) == pytest.approx(depth, rel=0.05)


@pytest.mark.parametrize(("distance", "count"), [(0.3, 8), (0.9, 8), (0.0, 600), (10.0, 3)])
def test_points_that_are_apart(distance, count):
    """The first ones in order, as one after the other tells; few are apart, and the last of them come late."""
    rng = np.random.default_rng(5)
    points, order, taken = rng.uniform(size=(1000, 3)), rng.permutation(1000)[:700], []
    for i in order.tolist():
        if len(taken) < count and all(np.linalg.norm(points[i] - points[j]) > distance for j in taken):
            taken.append(i)
    assert list(spaced(points, order, distance, count)) == taken


def test_a_line_that_points_at_a_cylinder_does_not_touch_along_it():
    """Its end is nearest, which no stationary point tells, nor do cells; one in the surface does touch."""
    radius, half, long = 0.22, 0.174, 0.118
    rng = np.random.default_rng(0)
    for _ in range(60):
        angle = rng.uniform(-math.pi, math.pi)
        outwards = np.array([math.cos(angle), math.sin(angle), 0.0])
        along = -outwards + 10.0 ** rng.uniform(-5.0, -1.0) * rng.normal(size=3)
        along /= np.linalg.norm(along)
        tip = (radius + rng.uniform(5e-4, 0.01)) * outwards + [0.0, 0.0, rng.uniform(-0.1, 0.1)]
        turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), along).coeffs()
        side = pc.Cylinder(radius, (None, (-half, half)))
        system = system_of(pc.Line((-long, long)), side, [*(tip - long * along), *turn])
        assert not NearestSearch(system, 0, 0.0).search(0.0).is_around
        up = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])).coeffs()
        for depth in (1e-4, 2e-3):
            system = system_of(pc.Line((-long, long)), side, [*((radius - depth) * outwards), *up])
            assert NearestSearch(system, 0, 0.0).search(0.0).is_around
