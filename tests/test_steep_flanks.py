"""Posts, ridges and steps with flanks much higher than wide: nothing goes in unseen. And bodies that start on an axis
of symmetry. Depths are those of dense samples, times of touches those of free fall."""

import math

import numpy as np
import pinocchio as pin
import pytest
from test_open_contacts import G, body, touches

import pincontact as pc
from pincontact.geometry.nearest import NearestSearch

# A step of 1 ms at up to 3 m/s, over round edges of some mm, and the accuracy of events.
DEEP = {"Moreau": 2e-3, "DOP853": 1e-6}


def flanks(generator):
    """A height field z(x, y) whose flanks are a few widths wide, its width and its height in m."""
    kind, width, height = (
        generator.integers(3),
        10 ** generator.uniform(-2.6, -1.6),
        10 ** generator.uniform(-1.4, -0.4),
    )
    turn = generator.uniform(0.0, math.pi)
    c, s = math.cos(turn), math.sin(turn)
    if kind == 0:
        return lambda x, y: height * np.exp(-(x * x + y * y) / (2.0 * width**2)), width, height
    if kind == 1:
        return lambda x, y: height * np.exp(-((c * x + s * y) ** 2) / (2.0 * width**2)), width, height
    return lambda x, y: 0.5 * height * (1.0 + np.tanh((c * x + s * y) / width)), width, height


def depth(q, field, radius):
    """How deep in m a ball is inside the ground: its centre's distance from samples that are refined where these are
    nearest."""
    half, middle = radius, q[:2].copy()
    for _ in range(4):
        line = np.linspace(-half, half, 121)
        x, y = np.meshgrid(middle[0] + line, middle[1] + line)
        squares = (x - q[0]) ** 2 + (y - q[1]) ** 2 + (field(x, y) - q[2]) ** 2
        i = np.unravel_index(squares.argmin(), squares.shape)
        middle, half = np.array([x[i], y[i]]), 0.08 * half
    distance = math.sqrt(squares.min())
    return radius - distance if q[2] > field(*q[:2]) else radius + distance


def thrown(seed, contacts=2):
    """A ball at random flanks, its scene, state, radius and the field."""
    generator = np.random.default_rng(seed)
    field, width, height = flanks(generator)
    radius, way = 10 ** generator.uniform(-1.9, -1.0), generator.uniform(0.0, 2.0 * math.pi)
    along = np.array([math.cos(way), math.sin(way)])
    start = -(generator.uniform(0.2, 0.5) + radius) * along + generator.uniform(-1.0, 1.0, 2) * (radius + width)
    speed, rolls = generator.uniform(0.8, 3.0), generator.random() < 0.5
    # only from where the ground is flat
    rolls = rolls and depth([*start, field(*start) + radius], field, radius) < 1e-9
    z = field(*start) + radius + (0.0 if rolls else generator.uniform(0.02, height))
    own = pc.Sphere(radius)
    scene = pc.Scene(body(own))
    scene.add_contour("ball", own, frame="body")
    scene.add_contour("ground", pc.HeightField(field, domain=((-2.0, 2.0), (-2.0, 2.0))))
    names = [f"c{i}" for i in range(contacts)]
    for name in names:
        scene.add_contact(name, "ball", "ground", restitution=0.5)
    rolling = np.array([-along[1], along[0], 0.0]) * speed / radius if rolls else np.zeros(3)
    v = np.r_[speed * along, 0.0, rolling]
    state = scene.initial_state([*start, z, 0.0, 0.0, 0.0, 1.0], v, free=names[1:] if rolls else names)
    return scene, state, radius, field


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("seed", [0, 2, 3])
def test_balls_at_steep_flanks(seed, method):
    """They strike and go on; where more places touch than contacts are declared, it is told there."""
    scene, state, radius, field = thrown(seed)
    run = pc.simulate(scene, state, 0.5, method=method)
    assert run.status == 0 or "declare another contact" in run.message, run.message
    assert max(depth(q, field, radius) for q in run.q) < DEEP[method]
    assert run.status == 0 or run.t[-1] > 0.1


@pytest.mark.parametrize(
    ("height", "width", "beside", "method"), [(0.05, 0.004, 0.03, "Moreau"), (0.05, 0.008, 0.045, "DOP853")]
)
def test_a_ball_rolls_against_a_thin_post(height, width, beside, method):
    def field(x, y):
        return height * np.exp(-(x * x + y * y) / (2.0 * width**2))

    own = pc.Sphere(0.05)
    scene = pc.Scene(body(own))
    scene.add_contour("ball", own, frame="body")
    scene.add_contour("ground", pc.HeightField(field, domain=((-2.0, 2.0), (-2.0, 2.0))))
    for name in ("c0", "c1"):
        scene.add_contact(name, "ball", "ground", friction=pc.Coulomb(0.2))
    state = scene.initial_state([-0.3, beside, 0.05, 0, 0, 0, 1], [1.0, 0.0, 0.0, 0.0, 20.0, 0.0], free=["c1"])
    run = pc.simulate(scene, state, 0.4, method=method)
    assert run.status == 0, run.message
    assert len(touches(run)) >= 1
    assert max(depth(q, field, 0.05) for q in run.q) < DEEP[method]


# ---------------------------------------------------------------- axes of symmetry

ALONG_Y = pin.SE3(pin.utils.rotate("x", math.pi / 2), np.zeros(3))
TILTED = pin.SE3(pin.utils.rotate("x", math.pi / 2 - 0.3), np.zeros(3))


def on_axis(shape, placement, z, v=None, own=None, side=None):
    own = own or pc.Sphere(0.03)
    scene = pc.Scene(body(own))
    scene.add_contour("ball", own, frame="body")
    scene.add_contour("around", shape, placement=placement)
    scene.add_contact("c", "ball", "around", side=side)
    return scene, scene.initial_state([0.0, 0.0, z, 0.0, 0.0, 0.0, 1.0][: scene.model.nq], v, free=["c"])


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize(
    ("shape", "placement", "z", "way"),
    [
        (pc.Cylinder(0.1), ALONG_Y, 0.0, 0.07),
        (pc.Cylinder(0.1), TILTED, 0.0, 0.07 / math.cos(0.3)),
        (pc.HeightField(lambda x, y: 5.0 * (x * x + y * y)), None, 0.3, 0.27),
        (pc.Torus(0.2, 0.02), None, 0.5, None),
        (pc.Circle(0.2), None, 0.5, None),
        (pc.Cylinder(0.1), None, 0.0, None),
    ],
    ids=["tube", "tilted", "bowl", "ring", "hoop", "pipe"],
)
def test_starts_on_an_axis(shape, placement, z, way, method):
    """What is nearest all around touches where it comes to in free fall, or nowhere."""
    scene, state = on_axis(shape, placement, z)
    run = pc.simulate(scene, state, 0.4, method=method)
    assert run.status == 0, run.message
    # the accuracy of gaps at the speed of the touch
    expected = [] if way is None else [pytest.approx(math.sqrt(2.0 * way / G), abs=1e-5)]
    assert touches(run) == expected


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("shape", [pc.Circle(0.02), pc.Torus(0.03, 0.01)], ids=["hoop", "ring"])
def test_what_touches_all_around_is_told(shape, method):
    scene, state = on_axis(shape, None, 0.1)
    run = pc.simulate(scene, state, 0.3, method=method)
    # the ball touches a hoop of 2 cm at this height of its centre, the ring at this one
    touch = math.sqrt(0.03**2 - 0.02**2) if isinstance(shape, pc.Circle) else math.sqrt(0.04**2 - 0.03**2)
    assert run.status == -3 and "along a line or a circle" in run.message, run.message
    # where nothing tells the inside of bodies, to a tenth of the radius
    assert run.q[-1, 2] == pytest.approx(touch, abs=5e-3)


def test_starts_on_an_axis_that_are_refused():
    with pytest.raises(pc.SingularContactError, match="side=-1"):
        on_axis(pc.Cylinder(0.1), ALONG_Y, 0.0, own=pc.Point())
    # closed forms are not looked for anew
    with pytest.raises(pc.SingularContactError, match="move q a little"):
        on_axis(pc.Sphere(0.3), None, 0.0)
    # inside all around
    with pytest.raises(pc.SingularContactError, match="move q a little"):
        on_axis(pc.Cylinder(0.02), ALONG_Y, 0.0)


# ---------------------------------------------------------------- what steps of constant size may go through


def test_a_roller_far_above_a_fast_cam():
    """Steps are as long as the roller is thick, where it is thrown, but not as the gap is wide."""
    radius, eccentric, throw = 0.015, 0.05, 0.02
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide")
    roller = model.addJoint(slide, pin.JointModelRY(), pin.SE3.Identity(), "roller")
    model.appendBodyToJoint(roller, pin.Inertia(0.6, np.zeros(3), 1e-4 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("roller", roller, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    scene.add_contour("roller", pc.Circle(radius), frame="roller", placement=ALONG_Y)
    cam = pc.FourierCurve(cosine=[[throw, 0.0], [eccentric, 0.0]], sine=[[0.0, 0.0], [0.0, eccentric]])
    scene.add_contour("cam", cam, placement=ALONG_Y, motion=pc.ConstantTwist(angular=[0.0, 0.0, 200.0]))
    scene.add_contact("c", "roller", "cam")
    state = scene.initial_state([math.sqrt((eccentric + radius) ** 2 - throw**2), 0.0])
    run, fine = (pc.simulate(scene, state, 0.4, method="Moreau", dt=dt) for dt in (1e-4, 5e-5))
    assert run.status == fine.status == 0, run.message
    assert run.contacts["c"].gap.max() > 0.5
    assert np.abs(run.q[-1, 0] - fine.q[-1, 0]) < 1e-3


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_a_ball_over_a_sharp_crest(method):
    """Steps of 2 mm, over a crest of a quarter of that: a ball of 5 cm is too thick to go through. It comes down onto
    the crest where both are nearest: their distance is that of free fall along the way."""

    def field(x, y):
        return 0.1 * np.exp(-x * x / (2.0 * 0.005**2)) + 0.0 * y

    own = pc.Sphere(0.05)
    scene = pc.Scene(body(own))
    scene.add_contour("ball", own, frame="body")
    scene.add_contour("ground", pc.HeightField(field, domain=((-2.0, 2.0), (-2.0, 2.0))))
    for name in ("c0", "c1"):
        scene.add_contact(name, "ball", "ground", restitution=0.5)
    state = scene.initial_state([-0.2, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0], [2.0, 0, 0, 0, 0, 0], free=["c0", "c1"])
    run = pc.simulate(scene, state, 0.2, method=method)
    assert run.status == 0, run.message
    t = np.linspace(0.08, 0.12, 4001)
    gaps = np.hypot(2.0 * t - 0.2, 0.1 - 0.5 * G * t * t) - 0.05
    # the crest is round, by less than a millimetre of the way
    assert touches(run)[0] == pytest.approx(t[np.argmax(gaps < 0.0)], abs=5e-4)
    assert max(depth(q, field, 0.05) for q in run.q) < DEEP[method]


@pytest.mark.parametrize("contacts", [1, 3])
def test_spare_contacts_do_not_end_inside(contacts):
    """A ball has fallen through a hoop; contacts that have no place left are nowhere."""
    scene = pc.Scene(body(pc.Sphere(0.05)))
    scene.add_contour("ball", pc.Sphere(0.05), frame="body")
    scene.add_contour("hoop", pc.Circle(0.1))
    names = [f"c{i}" for i in range(contacts)]
    for name in names:
        scene.add_contact(name, "ball", "hoop")
    state = scene.initial_state([0.01, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0], free=names)
    run = pc.simulate(scene, state, 0.8, method="Moreau")
    assert run.status == 0 and "inside" not in run.message, run.message


def test_tyres_are_looked_at_no_more_often_than_rims(monkeypatch):
    """A torus is as far from the ground as its centre circle, but for its tube."""
    looks, inner = [], NearestSearch._look
    monkeypatch.setattr(NearestSearch, "_look", lambda self, t: looks.append(t) or inner(self, t))
    upright = pin.Quaternion(pin.utils.rotate("x", math.pi / 2)).coeffs()
    counts = []
    for tyre in (pc.Circle(0.1), pc.Torus(0.08, 0.02)):
        scene = pc.Scene(body(tyre))
        scene.add_contour("tyre", tyre, frame="body")
        scene.add_contour("ground", pc.HeightField(lambda x, y: 0.02 * np.sin(3.0 * x) * np.cos(2.0 * y)))
        scene.add_contact("c", "tyre", "ground", friction=pc.Coulomb(0.7))
        state = scene.initial_state([0.0, 0.0, 0.1, *upright], [1.0, 0.0, 0.0, 0.0, 0.0, -10.0], max_gap=0.02)
        run = pc.simulate(scene, state, 0.3, method="Moreau")
        assert run.status == 0, run.message
        counts.append(len(looks))
        looks.clear()
    assert 0 < counts[1] < 2 * counts[0]
