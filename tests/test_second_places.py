"""Bodies that touch at a second place: told where no contact is declared for it, and right where one is. Places are
computed independently, from dense samples of the waves."""

import functools
import math

import numpy as np
import pinocchio as pin
import pytest
import scipy
from shared import one_body
from test_open_contacts import AMPLITUDE, LENGTH, G, body, fall, touches, waves
from test_search_parts import system_of

import pincontact as pc
from pincontact.geometry.nearest import NearestSearch
from pincontact.geometry.single_touch import touches_once
from pincontact.integration.discrete import write_discrete
from pincontact.integration.open_contacts import OpenContacts
from pincontact.integration.run_system import RunSystem
from pincontact.layout import CHART

# The ring stands in the xz-plane.
STANDING = pin.Quaternion(pin.rpy.rpyToMatrix(math.pi / 2, 0.0, 0.0)).coeffs()
SHAPES = [pc.Sphere(0.2), pc.Circle(0.2)]
RADIUS, TROUGH = 0.2, 0.75 * LENGTH


def scene_of(shape, contacts=1, mu=0.0, restitution=0.0):
    scene = pc.Scene(body(shape))
    scene.add_contour("shape", shape, frame="body")
    scene.add_contour("ground", waves())
    friction = pc.Coulomb(mu) if mu else None
    for i in range(contacts):
        scene.add_contact(f"c{i}", "shape", "ground", friction=friction, restitution=restitution)
    return scene


def at(shape, x, z):
    return np.array([x, 0.0, z, *(STANDING if isinstance(shape, pc.Circle) else (0.0, 0.0, 0.0, 1.0))])


def depth(run):
    """How far in m samples of the disk below the centre are inside the waves, at most, for each output."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2001)
    x = run.q[:, :1] + RADIUS * np.sin(angle)
    return (AMPLITUDE * np.sin(2.0 * np.pi * x / LENGTH) - run.q[:, 2:3] + RADIUS * np.cos(angle)).max(axis=1)


@functools.cache
def resting_place():
    """Height of the centre and slope (rad) at both places, of a disk across the trough."""
    across = np.linspace(0.0, RADIUS, 2_000_001)
    centre = AMPLITUDE * np.sin(2.0 * np.pi * (TROUGH + across) / LENGTH) + np.sqrt(RADIUS**2 - across**2)
    i = int(np.argmax(centre))
    return float(centre[i]), math.asin(across[i] / RADIUS)


@pytest.mark.parametrize(("shape", "mu"), [(SHAPES[0], 0.0), (SHAPES[1], 0.6)], ids=["ball", "ring"])
def test_a_second_place_is_told(shape, mu):
    """A disk goes down a wave into a trough that is narrower; what the run has is right, whenever it is to end."""
    scene = scene_of(shape, mu=mu)
    state = scene.initial_state(at(shape, 0.2, 0.25))
    pair = scene_of(shape, contacts=2, mu=mu)
    touch = touches(pc.simulate(pair, pair.initial_state(at(shape, 0.2, 0.25), free=["c1"]), 0.4, rtol=1e-9))[0]
    for method, after in (("DOP853", 1e-3), ("Moreau", 1e-3), ("DOP853", 0.1)):
        run = pc.simulate(scene, state, touch + after, method=method)
        assert run.status == -3 and "another point" in run.message, run.message
        assert run.t[-1] <= touch + 2e-3 and run.t[-1] > touch - 0.05
        # events: a thousandth of the radius at 0.3 m/s at least, whenever it was to end
        told = float(run.message.removeprefix("t = ").split()[0])
        assert abs(told - touch) < (3e-3 if method == "Moreau" else 1e-3)
        # in a step of 1 ms; events find it to a thousandth of the radius
        assert depth(run).max() < (2e-3 if method == "Moreau" else 2e-4)
    for method in ("DOP853", "Moreau"):
        assert pc.simulate(scene, state, touch - 2e-3, method=method).status == 0


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_at_rest_across_a_trough(method):
    """One contact is not enough from the start."""
    height, _ = resting_place()
    for shape in SHAPES:
        scene = scene_of(shape)
        run = pc.simulate(scene, scene.initial_state(at(shape, TROUGH, height)), 0.5, method=method)
        assert run.status == -3 and "another point" in run.message
        pair = scene_of(shape, contacts=2, mu=0.5)
        state = pair.initial_state(at(shape, TROUGH, height))
        run = pc.simulate(pair, state, 0.5, method=method)
        assert run.status == 0 and not run.events
        np.testing.assert_allclose(run.q[-1], state.q, atol=1e-9)
        forces = [run.contacts[name].force_on("shape")[-1] for name in ("c0", "c1")]
        np.testing.assert_allclose(sum(forces), [0.0, 0.0, G], atol=1e-6)
        # one on each side
        assert forces[0][0] * forces[1][0] < 0.0


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Moreau"])
def test_at_rest_across_the_only_trench(method):
    """Of a plane that is flat all around: no sample of all of it shows how sharp its curvature is there."""
    radius, x = 0.08, np.linspace(-0.08, 0.08, 200_001)
    height = float((-0.05 * np.exp(-((x / 0.05) ** 2)) + np.sqrt(radius**2 - x**2)).max())
    scene = pc.Scene(body(pc.Sphere(radius)))
    scene.add_contour("shape", pc.Sphere(radius), frame="body")
    scene.add_contour("ground", pc.HeightField(lambda x, y: -0.05 * np.exp(-((x / 0.05) ** 2))))
    scene.add_contact("c", "shape", "ground", friction=pc.Coulomb(0.6))
    run = pc.simulate(scene, scene.initial_state(at(pc.Sphere(radius), 0.0, height)), 0.1, method=method)
    assert run.status == -3 and "another point" in run.message
    assert height - 1e-3 < run.q[-1, 2] <= height + 1e-6


@pytest.mark.parametrize("method", ["DOP853", "Sharp98", "Moreau"])
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_second_contacts_strike(method, restitution):
    """A frictionless ball slides into the trough and strikes the other slope: by energy, and by the slopes."""
    height, slope = resting_place()
    scene = scene_of(pc.Sphere(RADIUS), contacts=2, restitution=restitution)
    state = scene.initial_state(at(pc.Sphere(RADIUS), 0.2, 0.25), free=["c1"])
    run = pc.simulate(scene, state, 0.45, method=method, **({} if method == "Moreau" else {"rtol": 1e-9}))
    assert run.status == 0, run.message
    first, then = (next(event.time for event in run.events if event.contact == name) for name in ("c1", "c0"))
    speed = math.sqrt(2.0 * G * (state.q[2] - height))
    # along the second slope and off it; the energy that is left is kept up to the next touch
    left = speed**2 * (math.cos(2.0 * slope) ** 2 + (restitution * math.sin(2.0 * slope)) ** 2)
    after = (run.t > first + 2e-3) & (run.t < first + 0.03)
    energy = 0.5 * (run.v[after, :3] ** 2).sum(axis=1) + G * (run.q[after, 2] - height)
    # time stepping: what gravity does in a step of 1 ms
    np.testing.assert_allclose(energy, 0.5 * left, atol=2e-2 if method == "Moreau" else 1e-6)
    assert first - then < 1e-3 and after.any()
    assert depth(run).max() < (1e-4 if method == "Moreau" else 1e-6)


def test_both_kinds_of_methods_settle_alike():
    """From above, both contacts open, into the trough, where a ball's ever shorter bounces from slope to slope end at
    rest. Rings: in the tests before and after this one."""
    height, _ = resting_place()
    scene = scene_of(SHAPES[0], contacts=2, mu=0.0)
    state = scene.initial_state(at(SHAPES[0], 0.2, 0.4), free=["c0", "c1"])
    runs = [pc.simulate(scene, state, 1.2, method=method) for method in ("DOP853", "Moreau")]
    for run in runs:
        assert run.status == 0, run.message
        np.testing.assert_allclose(run.q[-1][[0, 2]], [TROUGH, height], atol=1e-5)
        assert depth(run).max() < 1e-4
    first = [touches(run)[0] for run in runs]
    assert abs(first[0] - first[1]) < 1e-5


@pytest.mark.parametrize(("shape", "free"), [(SHAPES[0], ["c0"]), (SHAPES[1], ["c1"]), (SHAPES[1], ["c0", "c1"])])
def test_whatever_order_contours_are_named_in(shape, free):
    """Two contacts of one pair, the second with its contours the other way round."""
    height, _ = resting_place()
    scene = pc.Scene(body(shape))
    scene.add_contour("shape", shape, frame="body")
    scene.add_contour("ground", waves())
    for name, order in (("c0", ("shape", "ground")), ("c1", ("ground", "shape"))):
        scene.add_contact(name, *order, friction=pc.Coulomb(0.6))
    state = scene.initial_state(at(shape, 0.2, 0.25 if len(free) == 1 else 0.4), free=free)
    run = pc.simulate(scene, state, 1.1)
    assert run.status == 0, run.message
    np.testing.assert_allclose(run.q[-1][[0, 2]], [TROUGH, height], atol=1e-5)


def ask(shape, ground, q, side=1):
    """`touches_once` where they are nearest."""
    system = system_of(shape, ground, np.asarray(q, dtype=float), side=side)
    system.evaluate_kinematics(0.0)
    found = NearestSearch(system, 0, 0.0).search(0.0).candidate
    system.location[0], system.side_int[:2, CHART] = found.location, found.charts
    system.evaluate_kinematics(0.0)
    return touches_once(system, 0)


def lying(x, y, z):
    return x, y, z, 0.0, 0.0, 0.0, 1.0


BOWL = pc.Ellipsoid(1.0, 0.8, 0.7)


def terrain(lines, stone=0.0):
    """A flat grid of heights, 4 m across, with a stone at one node."""
    x, heights = np.linspace(-2.0, 2.0, lines), np.zeros((lines, lines))
    heights[lines // 5, lines // 3] = stone
    return pc.HeightField(x, x, heights)


UPRIGHT = (0.0, 0.0, 0.35, math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
# the least radius of curvature of the waves
BEND = LENGTH**2 / (4.0 * math.pi**2 * AMPLITUDE)


@pytest.mark.parametrize(
    ("shape", "ground", "q", "side", "once"),
    [
        (pc.Sphere(0.9 * BEND), waves(), lying(0.1, 0.0, 0.3), 1, True),
        (pc.Sphere(1.01 * BEND), waves(None), lying(0.1, 0.0, 0.3), 1, False),
        (pc.Point(), waves(), lying(0.1, 0.0, 0.3), 1, True),
        # a ring may lie flat
        (pc.Circle(0.05), waves(), lying(0.1, 0.0, 0.3), 1, False),
        (pc.Sphere(0.45), BOWL, lying(0.0, 0.02, -0.2), -1, True),
        (pc.Sphere(0.6), BOWL, lying(0.0, 0.02, -0.05), -1, False),
        (pc.Sphere(0.6), BOWL, lying(0.0, 0.02, 1.4), 1, True),
        # 0.2^2 / 0.1 < 0.7^2 < 0.4^2 / 0.1
        (pc.Ellipsoid(0.1, 0.2, 0.15), BOWL, lying(0.0, 0.02, -0.5), -1, True),
        (pc.Ellipsoid(0.1, 0.4, 0.15), BOWL, lying(0.0, 0.02, -0.2), -1, False),
        (pc.Ellipsoid(0.1, 0.4, 0.15), BOWL, lying(0.0, 0.02, 0.9), 1, True),
        (pc.Torus(0.3, 0.05), pc.Plane(), UPRIGHT, 1, True),
        # a stone as wide as one square of the grid; so many squares that not all of them are looked at
        (pc.Sphere(0.2), terrain(41), lying(0.5, 0.1, 0.3), 1, True),
        (pc.Sphere(0.2), terrain(41, stone=0.03), lying(0.5, 0.1, 0.3), 1, False),
        (pc.Sphere(0.2), terrain(101), lying(0.5, 0.1, 0.3), 1, False),
        # and of a formula
        (pc.Sphere(0.2), pc.HeightField(lambda x, y: 0.02 * np.tanh(x - 7.0)), lying(0.5, 0.1, 0.3), 1, True),
        (pc.Sphere(0.2), pc.HeightField(lambda x, y: 0.02 * np.tanh(50.0 * x)), lying(9.5, 0.1, 0.3), 1, False),
        # through the hole, over it
        (pc.Sphere(0.25), pc.Torus(0.6, 0.3), lying(0.6, 0.0, 0.6), 1, True),
        (pc.Sphere(0.35), pc.Torus(0.6, 0.3), lying(0.1, 0.0, 0.3), 1, False),
    ],
)
def test_shapes_that_touch_once(shape, ground, q, side, once):
    assert ask(shape, ground, q, side) == once


@pytest.mark.parametrize(
    ("f", "once"),
    [
        (lambda u, v: (u + v, v, 0.1 - 0.2 * u), True),
        # no samples would show that it is not flat
        (lambda u, v: (u, v, 0.01 * np.exp(-1e6 * (u - 3.0) ** 2)), False),
        (lambda u, v: (u, v, 1e-3 * u * v), False),
    ],
)
def test_planes_that_are_formulas(f, once):
    ground = pc.ParametricSurface(f, ((-math.inf, math.inf), (-math.inf, math.inf)))
    assert ask(pc.Circle(0.3), ground, UPRIGHT) == once


def test_nothing_is_watched_where_bodies_touch_once():
    for radius in (0.05, 0.2):
        scene = scene_of(pc.Sphere(radius))
        state = scene.initial_state(lying(0.2, 0.0, radius + 0.03), max_gap=0.1)
        system = RunSystem(scene.model, list(scene.contacts.values()))
        system.q[:], system.location[:] = state.q, state.location
        write_discrete(system, state.discrete)
        system.evaluate(0.0)
        assert OpenContacts(system).are_any(0.0) == (radius > BEND)


def test_what_touches_once_has_no_second_place():
    """Disks in a plane with closed curves of random bumps and dents, outside and inside: where it is said that they
    touch once, disks at dense samples overlap nothing, and are seen to elsewhere."""
    said = []
    for seed in range(14):
        rng = np.random.default_rng(seed)
        angles = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
        bumps = sum(rng.uniform(0.0, 0.3) * np.cos(k * angles + rng.uniform(0, 6.3)) / k for k in (2, 3, 4))
        points = (1.0 + bumps)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        curve = pc.SplineCurve(points, periodic=True)
        radius, inside = rng.uniform(0.15, 0.8), bool(rng.integers(2))
        values = curve.evaluate_many(np.linspace(*curve.domain[0], 4001)[:-1, None])
        tangents = values[:, 1, :2] / np.linalg.norm(values[:, 1, :2], axis=1)[:, None]
        out = np.stack([tangents[:, 1], -tangents[:, 0]], axis=1)
        centres = values[:, 0, :2] + radius * (-out if inside else out)
        nearest = scipy.spatial.cKDTree(values[:, 0, :2]).query(centres)[0].min()
        once = planar_once(curve, radius, centres[0])
        said.append(once)
        if once:
            assert nearest > radius - 1e-6, seed
        elif nearest > radius - 1e-6:
            # 5 % more do not go everywhere
            larger = values[:, 0, :2] + 1.051 * radius * (-out if inside else out)
            assert scipy.spatial.cKDTree(values[:, 0, :2]).query(larger)[0].min() < 1.051 * radius - 1e-6, seed
    assert 3 < sum(said) < 12


def planar_once(curve, radius, centre):
    model = one_body(pin.JointModelPlanar(), pin.Inertia.Random(), "disk")
    scene = pc.Scene(model)
    scene.add_contour("disk", pc.Circle(radius), frame="disk")
    scene.add_contour("curve", curve)
    scene.add_contact("c", "disk", "curve", bilateral=True)
    system = RunSystem(model, list(scene.contacts.values()))
    state = scene.initial_state([*centre, 1.0, 0.0])
    system.q[:], system.location[:] = state.q, state.location
    system.evaluate_kinematics(0.0)
    return touches_once(system, 0)


def test_contacts_of_one_pair_start_at_different_places():
    height, _ = resting_place()
    scene = scene_of(pc.Sphere(RADIUS), contacts=2)
    state = scene.initial_state(at(SHAPES[0], TROUGH, height))
    first, second = state.location[:, 2]
    assert abs(first + second - 2.0 * TROUGH) < 1e-6 and abs(first - second) > 0.1
    # and where there is only one place
    model = body(pc.Sphere(0.1))
    lone = pc.Scene(model)
    lone.add_contour("ball", pc.Ellipsoid(0.1, 0.12, 0.11), frame="body")
    lone.add_contour("egg", pc.Ellipsoid(1.0, 0.9, 0.8))
    for name in ("a", "b"):
        lone.add_contact(name, "ball", "egg", side=1)
    q = lying(0.0, 0.0, 0.91)
    with pytest.raises(pc.NoContactError, match=r"'b'.*other contacts"):
        lone.initial_state(q)
    for method in ("DOP853", "Moreau"):
        run = pc.simulate(lone, lone.initial_state(q, free=["b"]), 0.2, method=method)
        assert run.status == 0 and not touches(run), run.message
        assert np.isnan(run.contacts["b"].gap[1:]).all()
        assert fall(0.5) > 0.2


def narrow(kind, width, height):
    """A ground that is flat but for one place, along y or round."""

    def shape(x, y):
        along = x * x if kind in ("trench", "ridge") else x * x + y * y
        return height * np.exp(-along / width**2)

    def step(x, y):
        return 0.5 * height * (1.0 + np.tanh(x / width)) + 0.0 * y

    return step if kind == "step" else shape


def inside(states, shape, radius):
    """How far in m samples of a ball are below the ground, at most, in any state."""
    turn, tilt = (grid.ravel() for grid in np.meshgrid(np.linspace(-np.pi, np.pi, 181), np.linspace(0.0, 1.6, 121)))
    out = radius * np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    deepest = -math.inf
    for q in states:
        x, y, z = q[:3, None] + out
        deepest = max(deepest, float((shape(x, y) - z).max()))
    return deepest


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("kind", ["trench", "ridge", "step"])
def test_points_over_narrow_places(kind, method):
    """Thrown along grounds with and without ends."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        width = rng.uniform(0.01, 0.05)
        height = rng.uniform(0.02, 0.05) * (-1.0 if kind == "trench" else 1.0)
        ground = narrow(kind, width, height)
        scene = pc.Scene(body(pc.Point()))
        scene.add_contour("point", pc.Point(), frame="body")
        scene.add_contour("ground", pc.HeightField(ground, domain=None if seed % 2 else ((-2.0, 2.0), (-2.0, 2.0))))
        scene.add_contact("c", "point", "ground", friction=pc.Coulomb(0.5))
        position = [-0.3, 0.0, rng.uniform(0.005, 0.04)]
        velocity = [rng.uniform(1.0, 3.0), 0.1 * rng.normal(), rng.uniform(0.0, 0.3)]
        run = pc.simulate(scene, scene.initial_state(position, velocity, free=["c"]), 0.25, method=method)
        assert run.status == 0, (seed, run.message)
        below = ground(run.q[:, 0], run.q[:, 1]) - run.q[:, 2]
        assert below.max() < (1e-3 if method == "Moreau" else 1e-6), seed


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize(("kind", "seed"), [("trench", 0), ("pit", 1), ("ridge", 1), ("bump", 0), ("step", 0)])
def test_balls_over_narrow_places(kind, seed, method):
    """Thrown along a flat ground, with and without ends, at places narrower than they are, which few samples of all of
    it show."""
    rng = np.random.default_rng(seed)
    radius, width = rng.uniform(0.08, 0.15), rng.uniform(0.01, 0.05)
    height = rng.uniform(0.02, 0.05) * (-1.0 if kind in ("trench", "pit") else 1.0)
    ground = narrow(kind, width, height)
    scene = pc.Scene(body(pc.Sphere(radius)))
    scene.add_contour("ball", pc.Sphere(radius), frame="body")
    scene.add_contour("ground", pc.HeightField(ground, domain=None if seed else ((-2.0, 2.0), (-2.0, 2.0))))
    names = ["c0", "c1", "c2"]
    for name in names:
        scene.add_contact(name, "ball", "ground", friction=pc.Coulomb(0.5))
    q = lying(-0.3, 0.0, radius + rng.uniform(0.002, 0.02))
    state = scene.initial_state(q, [rng.uniform(1.0, 3.0), 0.1 * rng.normal(), 0.0, 0.0, 0.0, 0.0], free=names)
    run = pc.simulate(scene, state, 0.3, method=method)
    # crests of a millimetre's radius are too sharp for steps of as many
    told = method == "Moreau" and height > 0.0 and run.status in (-3, -9)
    assert run.status == 0 or told, run.message
    # before such a refusal some steps of 3 mm at most went in
    states = run.q[:-4] if told else run.q
    assert inside(states, ground, radius) < (1e-3 if method == "Moreau" else 1e-5)


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Moreau"])
def test_two_places_touch_at_once(method):
    """A ring falls flat upon a crest, which it touches at both sides."""
    ring = pc.Ellipse(0.08, 0.03)
    for contacts in (1, 2):
        scene = scene_of(ring, contacts=contacts)
        names = [f"c{i}" for i in range(contacts)]
        run = pc.simulate(
            scene, scene.initial_state(lying(0.625, 0.4, 0.1), free=names), 0.101, method=method, max_steps=5000
        )
        first = [event.time for event in run.events if event.kind == "touch"]
        assert first[0] == pytest.approx(fall(0.1 - AMPLITUDE), abs=1e-5)
        assert run.status == (0 if contacts == 2 else -3) and len(first) >= contacts, run.message


def rolls(seed, ground, radius, method):
    """A ball rolls without slip along x towards whatever there is at the origin of a ground that is flat elsewhere."""
    rng = np.random.default_rng(seed)
    speed, start = rng.uniform(0.5, 3.0), rng.uniform(2.0, 5.0) * radius
    scene = pc.Scene(body(pc.Sphere(radius)))
    scene.add_contour("ball", pc.Sphere(radius), frame="body")
    scene.add_contour("ground", ground)
    scene.add_contact("c", "ball", "ground", friction=pc.Coulomb(0.6))
    # past the middle of a pit, where it would touch all around
    beside = 0.1 * radius
    height = ground.point((-start, beside))[2]
    state = scene.initial_state(lying(-start, beside, radius + height), [speed, 0.0, 0.0, 0.0, speed / radius, 0.0])
    return pc.simulate(scene, state, 1.5 * start / speed, method=method)


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("kind", ["trench", "ridge", "pit", "bump", "step"])
def test_balls_roll_onto_narrow_places(kind, method):
    """What is narrower than a ball, on a ground of hundreds of its radii, touches it before it is inside."""
    # trenches and steps of others are too small to stop a ball
    seed = {"trench": 3, "step": 0}.get(kind, 1)
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.05, 0.3)
    width, up = rng.uniform(0.07, 0.4) * radius, 1.0 if kind in ("ridge", "bump", "step") else -1.0
    shape = narrow(kind, width, up * rng.uniform(0.5, 1.8) * width)
    run = rolls(seed, pc.HeightField(shape, domain=((-15.0, 15.0), (-15.0, 15.0))), radius, method)
    # past the middle of a small pit it rolls around its edge
    assert "another point" in run.message or (kind == "pit" and run.status == 0), run.message
    # a step of 1 ms at the speeds of these balls
    assert inside(run.q, shape, radius) < (5e-3 if method == "Moreau" else 1e-5)


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_balls_roll_on_where_hollows_are_curved_as_they_are(method):
    """Of two places a centimetre apart the one behind opens at 0.03 m/s, and would be back at once if nothing else held
    the ball; to leave that hop out, which the place in front does not let end, would stop the whole motion."""

    def ground(x, y):
        ridge = 0.08879444753139623 * np.exp(-(((x + 0.02813019) / 0.07914639952774832) ** 2))
        return ridge - 0.08150753464434125 * np.exp(-(((x - 0.07139037) / 0.18113307929984857) ** 2))

    radius, speed = 0.10615614243164619, 2.92542549
    scene = pc.Scene(body(pc.Sphere(radius)))
    scene.add_contour("ball", pc.Sphere(radius), frame="body")
    scene.add_contour("ground", pc.HeightField(ground, domain=((-9.0, 9.0), (-9.0, 9.0))))
    for name in ("c0", "c1"):
        scene.add_contact(name, "ball", "ground", friction=pc.Coulomb(0.108))
    q = lying(-0.434137818, 0.0, 0.106122442)
    state = scene.initial_state(q, [speed, 0.0, 0.0, 0.0, speed / radius, 0.0], free=["c1"])
    run = pc.simulate(scene, state, 0.1, method=method, energies=True, **({"dt": 1e-4} if method == "Moreau" else {}))
    assert run.status == 0, run.message
    # an impact that turns the velocity by the angle between both normals, less than a degree, or steps that do so
    energies = run.energies()
    assert energies.total[-1] > energies.total[0] - (3e-2 if method == "Moreau" else 1e-2) * energies.kinetic[0]
    assert run.q[-1, 0] > -0.15 and inside(run.q, ground, radius) < 1e-3


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("kind", ["pit", "trench"])
def test_drops_onto_an_axis_of_symmetry(kind, method):
    """Bodies that touch at two places at the same time, or all around, go through neither."""
    shape = narrow(kind, 0.03, -0.03)
    ball, disk = pc.Sphere(0.1), pc.Ellipsoid(0.1, 0.1, 0.09)
    for own, height, beside in ((ball, 0.6, 0.0), (ball, 0.3, 1e-9), (disk, 0.3, 0.0), (disk, 0.6, 1e-9)):
        scene = pc.Scene(body(own))
        scene.add_contour("own", own, frame="body")
        scene.add_contour("ground", pc.HeightField(shape))
        # given, or to be inferred
        scene.add_contact("c", "own", "ground", side=1 if height < 0.5 else None)
        state = scene.initial_state(lying(beside, 0.0, height), free=["c"])
        run = pc.simulate(scene, state, fall(height) + 0.1, method=method)
        assert run.status in (0, -3), run.message
        assert kind == "trench" or "along a line or a circle" in run.message, run.message
        if isinstance(own, pc.Sphere):
            # told where it touches, to a twentieth of the radius
            assert -5e-3 < inside(run.q, shape, 0.1) < (5e-3 if method == "Moreau" else 1e-5)
        if kind == "trench" and isinstance(own, pc.Sphere) and height > 0.5 and method != "Moreau":
            # one rim after the other
            assert run.status == 0 and len(touches(run)) >= 2, run.message
        assert 0.07 < run.q[-1, 2] < 0.101, (own, height, beside, run.message)


@pytest.mark.parametrize("contacts", [1, 2])
def test_a_place_that_is_found_too_late_is_told(contacts):
    """A ball rolls against a needle of half a millimetre, which no cell shows before the ball is inside."""
    scene = pc.Scene(body(pc.Sphere(0.05)))
    scene.add_contour("ball", pc.Sphere(0.05), frame="body")
    scene.add_contour("ground", pc.HeightField(lambda x, y: 0.05 * np.exp(-(x * x + y * y) / (2.0 * 0.0005**2))))
    names = [f"c{i}" for i in range(contacts)]
    for name in names:
        scene.add_contact(name, "ball", "ground", friction=pc.Coulomb(0.2))
    state = scene.initial_state(lying(-0.3, 0.03, 0.05), [1.0, 0.0, 0.0, 0.0, 20.0, 0.0], free=names[1:])
    run = pc.simulate(scene, state, 0.6)
    assert run.status == -3 and run.t[-1] == pytest.approx(0.26, abs=2e-3), run.message
    assert inside(run.q, lambda x, y: 0.05 * np.exp(-(x * x + y * y) / (2.0 * 0.0005**2)), 0.05) < 1e-3


def test_two_places_that_become_one():
    """A ball rolls along a groove that widens, on both flanks, until it reaches the bottom: the run says which contacts
    have come together, and what goes on."""
    # half the curvatures of the bottom where it starts and ends
    radius, width, flat = 0.1, 9.0, 2.5

    def ground(x, y):
        half = flat + (width - flat) / (1.0 + np.exp(12.0 * (x - 0.4)))
        return -0.15 * x + 0.05 * (np.sqrt(1.0 + 40.0 * half * y * y) - 1.0)

    model = pin.Model()
    body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(body, pin.Inertia.FromSphere(1.0, radius), pin.SE3.Identity())
    model.addBodyFrame("ball", body, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("ground", pc.HeightField(ground, domain=((-1.5, 2.0), (-0.5, 0.5))))
    ball = scene.add_contour("ball", pc.Sphere(radius), "ball")
    for name, side in (("left", 0.04), ("right", -0.04)):
        scene.add_contact(name, ball, floor, friction=pc.Coulomb(0.5), location=(None, (0.0, side)))
    x, y = np.meshgrid(np.linspace(-0.03, 0.03, 61), np.linspace(-0.099, 0.099, 2001))
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[2], v[0] = (ground(x, y) + np.sqrt(np.maximum(radius**2 - x * x - y * y, 0.0))).max(), 0.5
    state = scene.initial_state(q, v)
    run = pc.simulate(scene, state, 1.5)
    assert run.status in (-1, -3) and 0.1 < run.t[-1] < 1.5
    assert "'left'" in run.message and "'right'" in run.message and "together" in run.message
    assert 'method="Moreau"' in run.message
    stepped = pc.simulate(scene, state, run.t[-1] + 0.05, method="Moreau", dt=1e-3)
    assert stepped.status == 0
    # in m, of 0.4: up to there both are the same, but for the error of steps
    near = np.searchsorted(stepped.t, run.t[-1])
    np.testing.assert_allclose(stepped.q[near, :3], run.q[-1, :3], atol=2e-3)


def test_cells_that_show_bodies_apart_spare_newtons_method(monkeypatch):
    """Beside a closed contact it is asked for stationary points only where cells do not tell that bodies are apart, and
    these tell no more than is so: densely sampled, the ground is at least as far from the ball."""
    asked, told = [], []
    find, distance = NearestSearch._find, NearestSearch.distance

    def counted(search, t):
        asked.append(t)
        return find(search, t)

    def compared(search, t, taken):
        least = distance(search, t, taken)
        (place,) = taken
        origin = search.system.frames[0, 3]
        x = origin[:2, None, None] + np.stack(np.meshgrid(*[np.linspace(-0.4, 0.4, 201)] * 2))
        heights = ground.evaluate_many(x.reshape(2, -1).T, t)[:, 0]
        beside = np.linalg.norm(heights - place[1], axis=1) > search.neighbourhood
        told.append((least, np.linalg.norm(heights[beside] - origin, axis=1).min() - radius))
        return least

    monkeypatch.setattr(NearestSearch, "_find", counted)
    monkeypatch.setattr(NearestSearch, "distance", compared)
    radius = 0.15
    ground = pc.HeightField(narrow("ridge", 0.03, 0.04), domain=((-15.0, 15.0), (-15.0, 15.0)))
    for method in ("DOP853", "Moreau"):
        asked.clear()
        told.clear()
        assert rolls(1, ground, radius, method).status == -3
        apart = sum(least > 0.0 for least, _ in told)
        assert apart > 5 and len(asked) == len(told) - apart
        assert all(least <= max(sampled, 0.0) for least, sampled in told)


@pytest.mark.parametrize("method", ["DOP853", "RK23", "Moreau"])
def test_a_bump_that_grows_beside_is_told(method):
    """How far points of a shape that changes may have moved is not known; where they have come is."""
    radius, place, width, rate = 0.2, 0.17, 0.03, 0.3

    def height(x, t):
        return rate * t * np.exp(-(((x - place) / width) ** 2))

    ground = pc.ParametricSurface(lambda u, v, t: (u, v, height(u, t)), ((-1.0, 1.0),) * 2)
    scene = pc.Scene(body(pc.Sphere(radius)))
    scene.add_contour("shape", pc.Sphere(radius), frame="body")
    scene.add_contour("ground", ground)
    scene.add_contact("c", "shape", "ground", friction=pc.Coulomb(0.6))
    x = np.linspace(0.05, 0.4, 200_001)
    touch = scipy.optimize.brentq(lambda t: np.hypot(x, height(x, t) - radius).min() - radius, 0.01, 1.0)
    state = scene.initial_state(at(pc.Sphere(radius), 0.0, radius))
    assert pc.simulate(scene, state, touch - 2e-3, method=method).status == 0
    run = pc.simulate(scene, state, touch + 5e-3, method=method)
    assert run.status == -3 and "another point" in run.message, run.message
    assert abs(run.t[-1] - touch) < 3e-3


@pytest.mark.parametrize(("method", "rtol"), [("RK45", 1e-9), ("Moreau", 1e-8)])
def test_the_far_side_of_a_shape_that_changes_is_no_second_place(method, rtol):
    """A ring rolls on a torus that moves: by its formula, of which no more is known, and by a prescribed motion."""
    amplitude, frequency = np.array([-1.2e-3, 3.2e-3, 1.7e-3]), 0.77

    def torus(u, v, t):
        x, y, z = (a * np.sin(2.0 * math.pi * frequency * t) for a in amplitude.tolist())
        return (
            (2.0 + 0.6 * np.cos(v)) * np.cos(u) + x,
            (2.0 + 0.6 * np.cos(v)) * np.sin(u) + y,
            0.6 * np.sin(v) + z,
        )

    ends = []
    for formula in (True, False):
        inertia = pin.Inertia(0.3, np.array([1e-3, -5e-3, 5e-3]), np.diag([1.32e-3, 1.23e-3, 1.3e-3]))
        scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia))
        shape = pc.ParametricSurface(torus, ((-math.pi, math.pi),) * 2, (True, True)) if formula else pc.Torus(2.0, 0.6)
        motion = None if formula else pc.HarmonicMotion(amplitude=amplitude, frequency=frequency)
        placement = pin.SE3(pin.rpy.rpyToMatrix(-0.134, -0.045, 0.136), np.array([0.115, -0.072, 0.215]))
        scene.add_contour("ring", pc.Circle(0.1), "body")
        scene.add_contour("torus", shape, placement=placement, motion=motion)
        scene.add_contact("c", "ring", "torus", friction=pc.Coulomb(0.2, 0.4))
        q = np.array([2.754, -0.418, 0.355, -0.5256, 0.2685, -0.4528, 0.6683])
        q[3:] /= np.linalg.norm(q[3:])
        state = scene.initial_state(q, [-0.3, -0.43, -0.27, -0.09, 1.75, -1.53], free=["c"])
        run = pc.simulate(scene, state, 0.4, method=method, rtol=rtol, atol=rtol / 100)
        assert run.status == 0 and [event.kind for event in run.events][:1] == ["touch"], run.message
        ends.append(run.q[-1])
    np.testing.assert_allclose(*ends, atol=1e-6)
