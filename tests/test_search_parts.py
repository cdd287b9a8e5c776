"""Parts of the search for contact points: guesses, samples, boxes, cells, and what a step may not pass."""

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
import scipy
from test_parts_of_geometry import MOVED, UNKNOWN, system_of, turned

import pincontact as pc
from pincontact.contours.base import F
from pincontact.geometry import nearest
from pincontact.geometry.nearest import NearestSearch
from pincontact.geometry.search import _sample, find_candidates
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
        guess = wanted.location + 0.01
        (found,) = find_candidates(system, 0.0, guess)
        assert found.branch == wanted.branch
        assert found.point == pytest.approx(wanted.point, abs=1e-9)


def oblique(u, v):
    return (u + 5.0 * v, v, 0.1 * u * v)


def test_normals_of_samples_are_unit_vectors_across_both_tangents():
    """Of a surface whose parameter lines meet at an angle of 11 degrees, and of one with a pole, which has none."""
    sheet = pc.ParametricSurface(oblique, ((-1.0, 1.0), (-1.0, 1.0)))
    _, _, normals, tangents = _sample(sheet, MOVED, 0.0, 1.0, np.full(2, np.nan))
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(normals)), rel=1e-12)
    for tangent in tangents:
        assert np.abs(np.einsum("ij,ij->i", normals, tangent)).max() < 1e-12
    fan = pc.ParametricSurface(lambda u, v: (u * np.cos(v), u * np.sin(v), 0.0), ((0.0, 1.0), (0.0, 1.0)))
    _, points, normals, tangents = _sample(fan, pin.SE3.Identity(), 0.0, 1.0, np.array([0.0, np.nan]))
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
    assert math.hypot(d, chord) - fine <= found.elsewhere <= math.hypot(d, chord + 2.0 * fine)


def test_cells_are_not_divided_without_end():
    """From the middle of what is nearly a ball all of it is equally near."""
    system = system_of(pc.Point(), pc.Ellipsoid(0.5, 0.5001, 0.5002), [0.0, 0.0, 0.0, *UPRIGHT])
    search = NearestSearch(system, 0, 0.0)
    parameters, points, reaches = search._patch(0.0, np.zeros(3), 0.0)
    assert 576 < len(points) <= 4096
    assert len(parameters) == len(points) == len(reaches)


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


def test_lengths_of_parameters_without_end_are_those_where_it_is_touched():
    """A rod of 4 m for each unit of its parameter, from where its contact was last."""
    rod = pc.ParametricSurface(
        lambda u, v: (0.1 * np.cos(u), 0.1 * np.sin(u), 4.0 * v),
        ((0.0, 2.0 * math.pi), (-math.inf, math.inf)),
        (True, False),
    )
    system = system_of(pc.Sphere(0.05), rod, [0.5, 0.0, 2.0, *UPRIGHT])
    system.location[0, 2:] = 0.0, 0.5
    search = NearestSearch(system, 0, 0.0)
    _, (low, high) = search._box(0.0, np.array([0.5, 0.0, 2.0]), 0.3)
    # 0.4 m to the centre, and 0.3 beyond
    assert (low, high) == pytest.approx((0.5 - 0.7 / 4.0, 0.5 + 0.7 / 4.0), rel=1e-12)


def test_the_parameters_at_which_a_ball_faces_a_point():
    ball = pc.Sphere(0.1)
    system = system_of(ball, pc.Torus(0.6, 0.2), [0.2, 0.3, 0.7, *turned(6)], placement=MOVED)
    search = NearestSearch(system, 0, 0.0)
    rotation, centre = search.pose()
    for point in np.random.default_rng(3).normal(size=(5, 3)):
        away = point - centre
        facing = rotation @ ball.point(search._facing(point))
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


def test_a_field_is_one_however_it_is_made():
    x = np.linspace(-1.0, 1.0, 8)
    for field in (pc.HeightField(lambda x, y: x * y), pc.HeightField(x, x, np.outer(x, x))):
        assert nearest._is_height_field(field)
    assert not nearest._is_height_field(pc.Torus(0.6, 0.2))
