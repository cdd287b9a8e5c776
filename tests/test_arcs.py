"""Contours that are a part of a turn: which of an angle's turns counts does not matter, at the start nor on the way."""

import math

import numpy as np
import pinocchio as pin
import pytest
import scipy
from scipy.optimize import brentq

import pincontact as pc

RADIUS, BALL, G = 1.0, 0.05, 9.81
# The cylinder's axis along y, u1 = pi / 2 at its bottom.
ACROSS = pin.SE3(np.column_stack([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.zeros(3))
METHODS = [{}, {"method": "Moreau", "step": 1e-3}]


def free_ball(radius: float, world: pin.SE3) -> pin.Model:
    """A ball that falls along -z of a world turned and moved by `world`."""
    model = pin.Model()
    model.gravity.linear = world.rotation @ np.array([0.0, 0.0, -G])
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), world, "root")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, radius), pin.SE3.Identity())
    model.addBodyFrame("ball", joint, pin.SE3.Identity(), 0)
    return model


def ball_in(arc: pc.Contour, world: pin.SE3) -> pc.Scene:
    scene = pc.Scene(free_ball(BALL, world))
    pipe = scene.add_contour("arc", arc, placement=world * ACROSS)
    scene.add_contact("c", scene.add_contour("ball", pc.Sphere(BALL), frame="ball"), pipe, side=-1)
    return scene


def somewhere(rng: np.random.Generator) -> pin.SE3:
    return pin.SE3(pin.Quaternion(*rng.normal(size=4)).normalized().matrix(), rng.normal(size=3))


@pytest.mark.parametrize("turns", [-1, 0, 1])
@pytest.mark.parametrize("options", METHODS)
def test_drops_into_an_arc(options, turns):
    """From anywhere below the lips' height, whichever turn the arc is written with: touch at hypot(x, z) = R - r."""
    rng = np.random.default_rng(turns + 1)
    arc = pc.Cylinder(RADIUS, domain=((2.0 * math.pi * turns - 0.1, 2.0 * math.pi * turns + math.pi + 0.1), None))
    for x, z in rng.uniform((-0.5, -0.3), (0.5, 0.0), (5, 2)).tolist():
        due = math.sqrt(2.0 / G * (z + math.sqrt((RADIUS - BALL) ** 2 - x**2)))
        scene = ball_in(arc, somewhere(rng))
        run = pc.simulate(scene, scene.initial_state([x, 0.0, z, 0, 0, 0, 1], free=["c"]), due + 0.05, **options)
        assert run.status == 0, run.message
        # free fall is exact in both, the time of a touch as far as steps know it
        assert [e.time for e in run.events if e.kind == "touch"][:1] == [pytest.approx(due, abs=1e-9)]


def flight(lip: float, speed: float) -> float | None:
    """How long a ball flies that leaves the right lip, at this angle above the axis' height; None where it comes down
    beside the arc, or within 0.05 rad of the other lip."""
    way = RADIUS - BALL
    x, z = way * math.cos(lip), way * math.sin(lip)
    vx, vz = -speed * math.sin(lip), speed * math.cos(lip)

    def beyond(t: float) -> float:
        return math.hypot(x + vx * t, z + vz * t - 0.5 * G * t * t) - way

    times = np.linspace(0.0, 3.0, 3000)[1:]
    outside = np.array([beyond(t) for t in times]) > 0.0
    # it flies out of the circle first, over which it comes in again
    out = np.flatnonzero(~outside[:-1] & outside[1:])
    if not out.size:
        return None
    lands = float(brentq(beyond, times[out[0]], times[out[0] + 1]))
    return lands if z + vz * lands - 0.5 * G * lands**2 < way * math.sin(lip - 0.05) else None


def traced(lip: float) -> pc.Contour:
    """The same, as a formula, of which nobody knows that it repeats."""
    return pc.ParametricSurface(lambda u, v: (math.cos(u), math.sin(u), v), ((-lip, math.pi + lip), (-9.0, 9.0)))


@pytest.mark.parametrize("shape", [lambda lip: pc.Cylinder(RADIUS, ((-lip, math.pi + lip), None)), traced])
@pytest.mark.parametrize("options", METHODS)
def test_flies_from_one_lip_to_the_other_side(options, shape):
    """A frictionless ball leaves over a lip and comes down on the other side, where the angle is a turn away from that
    of the way it has gone. Time stepping opens the contact at
    the end of a step, which moves the landing by some steps."""
    rng = np.random.default_rng(4)
    landed = 0
    while landed < 2:
        lip, square = rng.uniform(0.1, 0.6), rng.uniform(2.0, 30.0)
        due = flight(lip, math.sqrt(square))
        if due is None or square <= 1.1 * (RADIUS - BALL) * G * math.sin(lip):
            continue
        landed += 1
        scene = ball_in(shape(lip), somewhere(rng))
        start = math.sqrt(square + 2.0 * G * (RADIUS - BALL) * (1.0 + math.sin(lip)))
        state = scene.initial_state([0, 0, BALL - RADIUS, 0, 0, 0, 1], [start, 0, 0, 0, 0, 0])
        run = pc.simulate(scene, state, due + 1.0, **options)
        assert run.status == 0, run.message
        leaves, lands = (next(e.time for e in run.events if e.kind == kind) for kind in ("edge", "touch"))
        assert lands - leaves == pytest.approx(due, abs=1e-2 if options else 1e-7)


@pytest.mark.parametrize("size", [0.003, 0.03, 0.3, 30.0])
def test_starts_in_pipes_of_any_size(size):
    """A ball at rest in a half pipe without ends along its axis. An arc's angle was cut like a length, in m."""
    rng = np.random.default_rng(7)
    for lip in rng.uniform(-0.2, 0.3, 8).tolist():
        radius = size * rng.uniform(0.05, 0.3)
        scene = pc.Scene(free_ball(radius, pin.SE3.Identity()))
        pipe = scene.add_contour("pipe", pc.Cylinder(size, ((lip, math.pi - lip), None)), placement=ACROSS)
        scene.add_contact("c", scene.add_contour("ball", pc.Sphere(radius), frame="ball"), pipe)
        state = scene.initial_state([0.0, 0.0, radius - size, 0.0, 0.0, 0.0, 1.0])
        assert abs(state.correction.gaps["c"]) < 1e-9 * size


def wheel_in(arc: pc.Contour, radius: float) -> pc.Scene:
    """A wheel in the xz-plane within a planar arc, no side of which is given."""
    model, joint = pin.Model(), 0
    for kind in (pin.JointModelPX(), pin.JointModelPZ(), pin.JointModelRY()):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), kind.shortname())
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, radius), pin.SE3.Identity())
    model.addBodyFrame("wheel", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    rim = scene.add_contour("rim", pc.Circle(radius), frame="wheel", placement=ACROSS)
    scene.add_contact("c", rim, scene.add_contour("arc", arc, placement=ACROSS))
    return scene


@pytest.mark.parametrize("options", METHODS)
def test_starts_that_are_nowhere_touch_like_others(options):
    """Wheels that drop into an elliptic trough, of which some have no point at the start at which they are nearest: as
    in the whole ellipse that it is a part of."""
    starts = [(0.2186342171882829, 0.22185123996722114, 0.1640623460930266)]
    starts += np.random.default_rng(11).uniform((-0.3, 0.1, 0.05), (0.3, 0.3, 0.2), (6, 3)).tolist()
    nowhere = 0
    for x, z, radius in starts:
        times = []
        for domain in (None, (-2.0 * math.pi - 0.1, 0.1 - math.pi)):
            scene = wheel_in(pc.Ellipse(1.0, 0.8, domain), radius)
            state = scene.initial_state([x, z, 0.0], free=["c"])
            nowhere += not state.candidates["c"]
            run = pc.simulate(scene, state, 0.6, **options)
            assert run.status == 0, run.message
            times.append(next(event.time for event in run.events if event.kind == "touch"))
        assert times[1] == pytest.approx(times[0], abs=1e-9)
    assert nowhere


@pytest.mark.parametrize("options", METHODS)
def test_balls_start_open_wherever_they_are_beside_an_arch(options):
    """Also where no point of the arch between its ends is nearest, nor any of a ball faces it: they are outside all the
    same. Thrown at a point of the arch they touch it."""
    rng, radius, nowhere = np.random.default_rng(0), 0.03, 0
    u = np.linspace(-math.pi, math.pi, 20_001)
    arch = 0.05 * np.column_stack([u + np.sin(u), 1.0 - np.cos(u), 0.0 * u])
    some = scipy.spatial.cKDTree(arch[::20])
    for _ in range(30):
        model = free_ball(radius, pin.SE3.Identity())
        model.gravity.setZero()
        scene = pc.Scene(model)
        ball = scene.add_contour("ball", pc.Sphere(radius), frame="ball")
        scene.add_contact("c", ball, scene.add_contour("arch", pc.Cycloid(0.05)))
        place, aim = 0.5 * rng.normal(size=3), arch[rng.integers(5_000, 15_000)]
        # more than the ball's radius away from all of it
        place *= max(1.0, 0.3 / np.linalg.norm(place))
        ways, nearest = some.query(place + np.linspace(0.0, 1.0, 2001)[:, None] * (aim - place))
        first = int(np.argmax(ways < radius))
        state = scene.initial_state([*place, 0, 0, 0, 1], [*(aim - place), 0, 0, 0], free=["c"])
        nowhere += not state.candidates["c"]
        if not 5 < nearest[first] < some.n - 6:
            # it comes to an end first
            continue
        run = pc.simulate(scene, state, 1.0, **options)
        assert run.status == 0, run.message
        assert [event.kind for event in run.events][:1] == ["touch"]
        there = place + run.events[0].time * (aim - place)
        # samples are 3e-5 m apart: good to their square over the radius
        assert np.linalg.norm(arch - there, axis=1).min() == pytest.approx(radius, abs=1e-6)
    assert nowhere
