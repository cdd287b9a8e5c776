"""Open contacts that start beside the ends of their contours, where only what these would go on as is near."""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

RADIUS = 0.3
UPRIGHT = pin.utils.rotate("x", 0.5 * math.pi)


def wheel():
    model, joint = pin.Model(), 0
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("turn", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), 0.09 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("wheel", joint, pin.SE3.Identity(), 0)
    return model


def scene_of(contour, placement, side=None):
    scene = pc.Scene(wheel())
    scene.add_contour("rim", pc.Circle(RADIUS), "wheel", placement=pin.SE3(UPRIGHT, np.zeros(3)))
    scene.add_contour("piece", contour, placement=placement)
    scene.add_contact("c", "rim", "piece", side=side)
    return scene


@pytest.mark.parametrize("side", (None, -1))
@pytest.mark.parametrize("seed", range(4))
def test_a_wheel_beside_a_line_whose_continuation_cuts_it(seed, side):
    """Thrown over the end, it lands on the line at the instant that free fall tells."""
    rng = np.random.default_rng(seed)
    height, away, rise = rng.uniform(0.02, 0.2), rng.uniform(0.4, 1.0), rng.uniform(0.1, 0.5)
    scene = scene_of(pc.Line((0.0, 9.0)), pin.SE3(UPRIGHT, np.array([0.0, 0.0, height])), side)
    state = scene.initial_state([-away, RADIUS, 0.0], free=["c"])
    up = math.sqrt(2.0 * 9.81 * (height + rise))
    lands = (up + math.sqrt(2.0 * 9.81 * rise)) / 9.81
    speed = 2.0 * away * 9.81 / up
    thrown = scene.initial_state(state.q, [speed, up, 0.0], free=["c"])
    for options, accuracy in (({}, 1e-6), ({"method": "Moreau", "dt": 1e-3}, 2e-3)):
        run = pc.simulate(scene, thrown, lands + 0.1, **options)
        assert run.status == 0, run.message
        assert [e.kind for e in run.events if e.kind == "touch"] == ["touch"]
        # time stepping tells a touch at the end of its step, and falls by half a step's more
        assert run.events[0].time == pytest.approx(lands, abs=accuracy)
        assert run.q[-1, 1] == pytest.approx(height + RADIUS, abs=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_an_arc_tells_sides_by_its_end(seed):
    """Before a hollow, on its tangent, the wheel is outside of what the arc would go on as, and yet on its inner side;
    before a hill it is outside, too, and there it stays."""
    rng = np.random.default_rng(seed)
    half, radius, away = rng.uniform(0.2, 1.3), rng.uniform(0.8, 2.0), rng.uniform(0.5, 1.5)
    for hollow in (True, False):
        middle = -0.5 * math.pi if hollow else 0.5 * math.pi
        centre = np.array([0.0, 0.0, radius if hollow else -radius])
        arc = pc.Circle(radius, domain=(middle - half, middle + half))
        end = centre + radius * np.array([-math.sin(half), 0.0, -math.cos(half) if hollow else math.cos(half)])
        slope = -half if hollow else half
        along = np.array([math.cos(slope), 0.0, math.sin(slope)])
        place = end - away * along + RADIUS * np.array([-along[2], 0.0, along[0]])
        state = scene_of(arc, pin.SE3(UPRIGHT, centre)).initial_state([place[0], place[2], 0.0], free=["c"])
        assert state.discrete[0, 3] == (-1 if hollow else 1)
        # near that end, and not on the opposite side of the circle
        assert abs(state.location[0, 2] - (middle - half if hollow else middle + half)) < 0.5 * math.pi
        given = scene_of(arc, pin.SE3(UPRIGHT, centre), 1).initial_state([place[0], place[2], 0.0], free=["c"])
        assert given.discrete[0, 3] == 1


def test_events_of_equal_runs_are_equal(tmp_path):
    """Also after a file, and not where a number is another."""
    scene = scene_of(pc.Line((-9.0, 9.0)), pin.SE3(UPRIGHT, np.zeros(3)))
    run = pc.simulate(scene, scene.initial_state([0.0, 0.5, 0.0], free=["c"]), 0.5)
    other = pc.simulate(scene, scene.initial_state([0.1, 0.5, 0.0], free=["c"]), 0.5)
    run.save(tmp_path / "run.npz")
    assert run.events and run.events == pc.Trajectory.load(tmp_path / "run.npz", scene).events
    assert run.events != other.events and run.events[0] != "touch"


@pytest.mark.parametrize(("seed", "rtol"), [(188, 1e-8), (199, 1e-6)])
def test_what_slides_over_an_edge_does_not_strike_it(seed, rtol):
    """A sphere on a turning body passes the end of a table, whose edge has a contact of its own. As far as gaps are
    known it touches the edge a little before, where the normals of both are all but parallel: to stop the bounce that
    this makes would take all of the motion across."""
    rng = np.random.default_rng(seed)
    rng.choice([0.0, 0.3])
    radius, model = rng.uniform(0.01, 0.04), pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia.FromEllipsoid(1.0, 0.08, 0.05, 0.05), pin.SE3.Identity())
    scene = pc.Scene(model)
    across = pin.SE3(pin.utils.rotate("z", 0.5 * math.pi), np.zeros(3))
    table = [
        scene.add_contour("top", pc.Plane(domain=((-1.0, 0.0), (-1.0, 1.0)))),
        scene.add_contour("edge", pc.Line((-1.0, 1.0)), placement=across),
    ]
    levers = [np.array([0.08, 0.0, 0.0]), np.array([-0.08, 0.0, 0.0])][: int(rng.integers(1, 3))]
    for k, lever in enumerate(levers):
        ball = scene.add_contour(f"ball{k}", pc.Sphere(radius), "body", placement=pin.SE3(np.eye(3), lever))
        for shape in table:
            scene.add_contact(f"{ball.name}-{shape.name}", ball, shape)
    turned = pin.exp3(0.8 * rng.normal(size=3))
    lowest = min((turned @ lever)[2] for lever in levers)
    height = radius - lowest + rng.uniform(0.0, 0.02)
    q = np.array([-rng.uniform(0.05, 0.15), 0.0, height, *pin.Quaternion(turned).coeffs()])
    speed = turned.T @ [rng.uniform(0.3, 2.0), 0.2 * rng.normal(), 0.0]
    start = scene.initial_state(q, np.r_[speed, 3.0 * rng.normal(size=3)], free=list(scene.contacts))
    run = pc.simulate(scene, start, 0.35, rtol=rtol, atol=1e-2 * rtol)
    exact = pc.simulate(scene, start, 0.35, rtol=1e-11, atol=1e-13)
    assert run.status == exact.status == 0
    # hops slower than the least speed of a rebound, 1 mm/s, are left out or not
    np.testing.assert_allclose(run.q[-1], exact.q[-1], rtol=0.0, atol=2e-4)
