"""Locations in closed form, against the contours themselves: directions, extreme points, nearest points."""

import math

import numpy as np
import pinocchio as pin
import pytest
from calling import from_python

import pincontact
import pincontact.contours as pc
from pincontact.constraints import kinematics
from pincontact.geometry import location as parts
from pincontact.geometry.location import POINT_ON_SPHERE, SPHERE_ON_SPHERE

solve_location, distance_to_ends = from_python(parts.solve_location), from_python(kinematics.distance_to_ends)
nearest_on_sphere, round_on_plane, point_to_plane, unwrapped = map(
    from_python, (parts.nearest_on_sphere, parts.round_on_plane, parts.point_to_plane, parts.unwrapped)
)
UNIT = pc.Sphere(1.0)


def frame(seed, origin):
    rotation = pin.exp3(np.random.default_rng(seed).normal(size=3))
    return np.concatenate([rotation, [origin], np.zeros((4, 3))])


def scratch():
    return np.full((2, 3), np.nan)


def direction(contour_frame, u, chart):
    """Of the point u of a unit sphere, seen from its centre."""
    return contour_frame[:3] @ UNIT.point(u, chart=chart)


@pytest.mark.parametrize("charts", [(0, 0), (1, 0), (0, 1), (1, 1)])
@pytest.mark.parametrize("form", [POINT_ON_SPHERE, SPHERE_ON_SPHERE])
def test_the_line_through_two_centres(form, charts):
    """Each branch names the side of both centres on which the spheres are touched."""
    rng = np.random.default_rng(2)
    # along each axis alone, too, at half a metre and at other distances
    for apart in (*rng.normal(size=(5, 3)), *0.5 * np.eye(3), *-0.3 * np.eye(3)):
        origin = rng.normal(size=3).round(1)
        one, two = frame(3, origin + apart), frame(4, origin)
        unit = (one[3] - two[3]) / np.linalg.norm(one[3] - two[3])
        for branch in (-1, 1) if form == POINT_ON_SPHERE else (-2, -1, 1, 2):
            start = rng.uniform(-9.0, 9.0, 4)
            location = start.copy()
            assert nearest_on_sphere(form, charts, one, two, branch, location, scratch())
            away = unit if branch > 0 else -unit
            assert direction(two, location[2:], charts[1]) == pytest.approx(away, abs=1e-14)
            assert abs(location[2] - start[2]) <= math.pi
            assert abs(location[3]) <= 0.5 * math.pi
            if form == POINT_ON_SPHERE:
                assert (location[:2] == start[:2]).all()
                continue
            # one beside the other, or within it
            opposite = -away if abs(branch) == 1 else away
            assert direction(one, location[:2], charts[0]) == pytest.approx(opposite, abs=1e-14)
            assert abs(location[0] - start[0]) <= math.pi


@pytest.mark.parametrize("origin", [0.0, 0.5])
def test_centres_that_coincide_have_no_line(origin):
    one, two = frame(3, np.full(3, origin)), frame(4, np.full(3, origin))
    for form in (POINT_ON_SPHERE, SPHERE_ON_SPHERE):
        location = np.arange(4.0)
        assert not nearest_on_sphere(form, (0, 0), one, two, 1, location, scratch())
        assert location.tolist() == [0.0, 1.0, 2.0, 3.0]


ROUND = [pc.Circle(0.3), pc.Ellipse(0.5, 0.2), pc.Sphere(0.3), pc.Ellipsoid(0.5, 0.2, 0.3)]


@pytest.mark.parametrize("contour", ROUND, ids=lambda c: c.name)
@pytest.mark.parametrize("branch", [-1.0, 1.0])
def test_extreme_points_along_the_normal_of_a_plane(contour, branch):
    rng = np.random.default_rng(5)
    k = contour.dimension
    for seed in range(6):
        one, two = frame(seed, rng.normal(size=3)), frame(seed + 20, rng.normal(size=3))
        normal = branch * two[:3, 2] @ one[:3]
        every = contour.evaluate_many(contour.samples((60, 31)[:k]))[:, 0] @ normal
        for chart in contour.charts:
            start = rng.uniform(-9.0, 9.0, 4)
            location = start.copy()
            kind, shape = contour.kind, contour.shape_row()
            assert round_on_plane(kind, chart, shape, one, two, 2, branch, location, scratch())
            rows = contour.evaluate(location[:k], chart=chart)
            assert rows[0] @ normal >= every.max()
            # nothing changes to first order
            assert rows[1 : 1 + k] @ normal == pytest.approx(np.zeros(k), abs=1e-15)
            assert abs(location[0] - start[0]) <= math.pi
            assert (location[k:] == start[k:]).all()


@pytest.mark.parametrize("contour", ROUND[:2], ids=lambda c: c.name)
@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_disk_that_lies_flat_has_no_extreme_point(contour, turns):
    def located(tilt):
        one = np.concatenate([pin.exp3(np.array(tilt)), np.zeros((5, 3))])
        two = np.concatenate([np.eye(3), np.zeros((5, 3))])
        location = np.full(4, 7.0)
        found = round_on_plane(contour.kind, 0, contour.shape_row(), one, two, 2, 1.0, location, scratch())
        return bool(found), location

    found, location = located([0.0, 0.0, 0.5 * turns])
    assert not found
    assert (location == 7.0).all()
    # tilted about either axis by whatever angle it is not flat, and its highest point is at one end of an axis
    for tilt in (0.01, math.asin(0.5), 1.2):
        assert located([tilt, 0.0, 0.0])[1][0] % (2.0 * math.pi) == pytest.approx(0.5 * math.pi)
        assert located([0.0, tilt, 0.0])[1][0] % (2.0 * math.pi) == pytest.approx(math.pi)


def test_the_foot_of_a_point_on_a_plane():
    rng = np.random.default_rng(6)
    for seed in range(5):
        ground, point = frame(seed, rng.normal(size=3)), rng.normal(size=3)
        location = np.array([5.0, 6.0, np.nan, np.nan])
        point_to_plane(point, ground, 2, location)
        assert location[:2].tolist() == [5.0, 6.0]
        foot = ground[:3] @ [*location[2:], 0.0] + ground[3]
        # what is left is along the normal
        assert np.cross(point - foot, ground[:3, 2]) == pytest.approx(np.zeros(3), abs=1e-14)


def test_the_angle_nearest_to_another():
    for near in np.linspace(-20.0, 20.0, 37):
        for angle in (-3.0, 0.2, 3.1):
            found = unwrapped(angle, near)
            assert abs(found - near) <= math.pi + 1e-14
            turns = (found - angle) / (2.0 * math.pi)
            assert turns == pytest.approx(round(turns), abs=1e-14)


@pytest.mark.parametrize("k1", [0, 1, 2])
def test_singular_equations_are_left_as_they_are(k1):
    """Body 1's equations are those of C1 once more, or the same twice."""
    for k2 in (1, 2):
        if k1 > k2:
            continue
        system = np.random.default_rng(k1).normal(size=(4, 8))
        if k1 == 0:
            system[0, :3] = 0.0
        elif k1 == 2:
            system[2] = system[1]
        else:
            system[1] = 0.0
        before = system.copy()
        assert solve_location(k1, k2, system) == 0.0
        assert (system == before).all()


def test_distances_to_the_ends_of_a_domain():
    ends = np.array([-1.0, 2.0, 3.0, 7.0])
    u = np.array([0.5, 4.5])
    for dimension, wanted in ((0, 9.0), (1, 1.5), (2, 1.5)):
        assert distance_to_ends(dimension, u, 0, ends, 9.0) == wanted
        assert distance_to_ends(dimension, u, 1, ends, 9.0) == 9.0
    for v, wanted in (([-0.9, 5.0], 0.1), ([1.8, 5.0], 0.2), ([0.5, 3.3], 0.3), ([0.5, 6.6], 0.4), ([0.5, 7.5], -0.5)):
        assert distance_to_ends(2, np.array(v), 0, ends, 9.0) == pytest.approx(wanted, rel=1e-12)
    assert distance_to_ends(2, u, 0, ends, 0.01) == 0.01


@pytest.mark.parametrize("shape", [pc.Circle(0.3), pc.Ellipse(0.5, 0.2), pc.Point()], ids=lambda c: c.name)
@pytest.mark.parametrize("side", [-1, 1])
def test_a_line_is_met_as_a_traced_one_is(shape, side):
    """A motion over a line in closed form, and over the same line as a formula, whose contact is found by iteration."""
    runs = []
    for line in (pc.Line(), pc.ParametricCurve(lambda u: (u, 0.0 * u, 0.0 * u), (-9.0, 9.0))):
        model = pin.Model()
        joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "planar")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.04 * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
        # e_3 of a line is -y
        model.gravity = pin.Motion(np.array([1.0, 9.0 * side, 0.0]), np.zeros(3))
        scene = pincontact.Scene(model)
        # the point is off the centre of mass
        at = pin.SE3(np.eye(3), np.array([0.0, 0.1, 0.0]) * (shape.dimension == 0))
        scene.add_contour("body", shape, "body", placement=at)
        scene.add_contour("line", line)
        scene.add_contact("c", "body", "line", pincontact.Coulomb(0.2), side=side, restitution=0.3)
        state = scene.initial_state([0.1, -0.8 * side, math.cos(0.4), math.sin(0.4)], [0.5, 0.0, 1.0], free=["c"])
        runs.append(pincontact.simulate(scene, state, 0.7))
    one, two = runs
    assert one.status == two.status == 0, (one.message, two.message)
    assert any(event.kind == "touch" for event in one.events)
    assert [event.kind for event in one.events] == [event.kind for event in two.events]
    # tolerances of 1e-8, over impacts
    np.testing.assert_allclose(one.q[-1], two.q[-1], atol=1e-6)
    assert one.stats["newton"] == 0 and one.stats["closed_form"] > 0
    assert two.stats["newton"] > 0 and two.stats["closed_form"] == 0
