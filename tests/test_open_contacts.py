"""Contacts that are open: bodies that are dropped, thrown and flung touch where and when they are nearest, fly through
nothing, and touch nothing from behind. Distances are computed independently, from dense samples."""

import functools
import math

import numpy as np
import pinocchio as pin
import pytest
import scipy
from shared import one_body

import pincontact as pc
from pincontact.geometry.nearest import NearestSearch
from pincontact.integration.discrete import write_discrete
from pincontact.integration.open_contacts import OpenContacts
from pincontact.integration.run_system import RunSystem

G = 9.81
METHODS = ["DOP853", "RK45", "RK23", "Sharp98", "Moreau"]
TOLERANCES = {"rtol": 1e-8, "atol": 1e-10}
# Event-driven runs locate touches to the error of the state; time stepping, to second order within a step of 1 ms.
ACCURACY = dict.fromkeys(METHODS, 1e-7) | {"Moreau": 1e-5}
# What bodies may overlap by in an output: in time stepping by what a step that ends in an impact does, g h^2 and more.
OVERLAP = dict.fromkeys(METHODS, 1e-7) | {"Moreau": 2e-4}


def body(shape):
    """A point mass that does not turn, or a free body, of 1 kg."""
    model = pin.Model()
    if isinstance(shape, pc.Point):
        joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "body")
        inertia = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    else:
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
        inertia = pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    return model


def scene_of(shape, ground, placement=None, motion=None, order=("shape", "ground"), **options):
    scene = pc.Scene(body(shape))
    scene.add_contour("shape", shape, frame="body")
    scene.add_contour("ground", ground, placement=placement, motion=motion)
    scene.add_contact("c", *order, **options)
    return scene


def start(scene, position, velocity=(0.0, 0.0, 0.0), spin=(0.0, 0.0, 0.0), free=("c",)):
    if scene.model.nq == 3:
        return scene.initial_state(np.array(position, float), np.array(velocity, float), free=list(free))
    return scene.initial_state([*position, 0, 0, 0, 1], [*velocity, *spin], free=list(free))


def run_of(scene, state, duration, method, **options):
    if method != "Moreau":
        options = TOLERANCES | options
    return pc.simulate(scene, state, duration, method=method, **options)


def touches(run):
    return [event.time for event in run.events if event.kind == "touch"]


def fall(height):
    return math.sqrt(2.0 * height / G)


# ------------------------------------------------------------------------------------------------- nearest points


AMPLITUDE, LENGTH = 0.05, 0.5


def waves(domain=((-5.0, 5.0), (-5.0, 5.0))):
    return pc.HeightField(lambda x, y: AMPLITUDE * math.sin(2.0 * math.pi * x / LENGTH), domain=domain)


def wave_gap(x, z, radius):
    """Distance of a ball from the waves, by samples; negative where its centre is below them."""
    u = np.linspace(x - 0.7, x + 0.7, 14_001)
    distances = np.hypot(u - x, AMPLITUDE * np.sin(2.0 * np.pi * u / LENGTH) - z)
    above = z > AMPLITUDE * math.sin(2.0 * math.pi * x / LENGTH)
    return (1.0 if above else -1.0) * float(distances.min()) - radius


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("radius", "domain"), [(0.0, None), (0.05, ((-5.0, 5.0), (-5.0, 5.0)))])
def test_drops_on_waves(method, radius, domain):
    """From 0.6 m, over three places of the waves, from where others are near at first; contours in either order."""
    for i, x in enumerate(np.linspace(0.01, 0.49, 3)):
        order = ("shape", "ground") if i % 2 else ("ground", "shape")
        scene = scene_of(pc.Sphere(radius) if radius else pc.Point(), waves(domain), order=order)
        run = run_of(scene, start(scene, (x, 0.0, 0.6)), 0.45, method)
        assert run.status == 0, run.message
        across = np.linspace(-radius, radius, 20_001)
        under = AMPLITUDE * np.sin(2.0 * np.pi * (x + across) / LENGTH)
        height = float((under + np.sqrt(np.maximum(radius**2 - across**2, 0.0))).max())
        # samples of 5 um are good to their square over a radius of 0.03 m
        assert touches(run)[0] == pytest.approx(fall(0.6 - height), abs=ACCURACY[method] + 1e-8)
        assert min(wave_gap(q[0], q[2], radius) for q in run.q[:: max(len(run.q) // 50, 1)]) > -OVERLAP[method]


@pytest.mark.parametrize("method", METHODS)
def test_drops_into_a_bowl(method):
    """A point from places above and beside the centre of an ellipsoid, where what is nearest changes on the way."""
    axes = np.array([1.0, 1.0, 0.8])
    rng = np.random.default_rng(5)
    for _ in range(6):
        place = rng.uniform(-0.15, 0.15, 3) + np.array([0.0, 0.0, 0.1])
        scene = scene_of(pc.Point(), pc.Ellipsoid(*axes), side=-1)
        run = run_of(scene, start(scene, place), 0.7, method)
        assert run.status == 0, run.message
        bottom = -axes[2] * math.sqrt(1.0 - place[0] ** 2 - place[1] ** 2)
        assert touches(run)[0] == pytest.approx(fall(place[2] - bottom), abs=ACCURACY[method])
        assert (np.linalg.norm(run.q / axes, axis=1) <= 1.0 + 2.0 * OVERLAP[method]).all()


def random_throw(rng):
    """A body in a bowl whose axes are all different, or in a tube, thrown and spun: shape, bowl, the bowl's rotation,
    what is below zero inside of it, place, velocity and spin."""
    sizes = rng.uniform(0.03, 0.12, 3)
    shapes = [pc.Point(), pc.Sphere(sizes[0]), pc.Ellipsoid(*sizes), pc.Circle(sizes[0]), pc.Torus(0.08, 0.03)]
    shape, axes = shapes[rng.integers(5)], rng.uniform(0.5, 1.2, 3)
    if rng.random() < 0.7:
        bowl, depth = pc.Ellipsoid(*axes), lambda x: np.sum((x / axes) ** 2, axis=-1) - 1.0
    else:
        bowl, depth = pc.Cylinder(axes[0]), lambda x: np.hypot(x[..., 0], x[..., 1]) - axes[0]
    rotation = pin.exp3(rng.normal(size=3))
    place, velocity = rng.uniform(-0.2, 0.2, 3), rng.choice([0.0, 0.5, 2.0]) * rng.normal(size=3)
    return shape, bowl, rotation, depth, place, velocity, rng.choice([0.0, 3.0, 15.0]) * rng.normal(size=3)


def first_overlap(shape, rotation, depth, place, velocity, spin, duration):
    """When any of a body's samples, 40 along each parameter of a surface, gets out of the bowl; None if none does. Its
    moments of inertia are all alike, so it spins steadily."""
    counts = [40 if shape.dimension == 2 else 1000] * shape.dimension
    axes = [np.linspace(*ends, count) for ends, count in zip(shape.domain, counts)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, shape.dimension) if axes else None
    samples = np.zeros((1, 3)) if grid is None else shape.evaluate_many(grid, 0.0)[:, 0]

    def deepest(t):
        turned = pin.exp3(t * spin) @ samples.T if shape.dimension else samples.T
        return depth((place + t * velocity + turned.T - [0.0, 0.0, 0.5 * G * t * t]) @ rotation).max()

    times = np.linspace(0.0, duration, 1001)
    out = [deepest(t) > 0.0 for t in times]
    if not any(out):
        return None
    first = out.index(True)
    return scipy.optimize.brentq(deepest, times[first - 1], times[first])


@pytest.mark.parametrize("seed", [4, 21, 30, 36])
def test_throws_into_bowls(seed):
    """On their way bodies pass places from where all of a bowl is as far, or no point of it is nearest."""
    rng = np.random.default_rng(seed)
    shape, bowl, rotation, depth, place, velocity, spin = random_throw(rng)
    touch = first_overlap(shape, rotation, depth, place, velocity, spin, 0.6)
    duration = 0.6 if touch is None else 1.005 * touch
    order = ("shape", "ground") if rng.random() < 0.5 else ("ground", "shape")
    # the bowl is inside out if it is the second surface, and touches the body from outside if it is the first
    side = 1 if shape.dimension == 2 and order[0] == "ground" else -1
    scene = scene_of(shape, bowl, pin.SE3(rotation, np.zeros(3)), order=order, side=side)
    state = start(scene, place, velocity, spin)
    ways = (
        {},
        {"max_step": duration / 200},
        {"method": "RK45", "max_step": duration / 37},
        {"method": "Moreau", "step": 1e-3},
    )
    for options in ways:
        run = pc.simulate(scene, state, duration, t_eval=np.linspace(0.0, duration, 60), **options)
        assert run.status == 0, run.message
        found = touches(run)
        # samples are 4 mm apart at most, which over radii of curvature of 5 cm hides 0.05 mm
        assert (found[0] if found else None) == (touch if touch is None else pytest.approx(touch, abs=3e-4))
        assert "inside" not in run.message
        assert run.contacts["c"].gap.min() > -2e-4


@pytest.mark.parametrize("options", [{}, {"method": "Moreau", "step": 1e-3}])
def test_a_ring_rocks_across_a_trough(options):
    """Where it rebounds at one place another one is next, which is not nearest when the step begins."""
    scene = scene_of(pc.Circle(0.08), waves(None), restitution=0.8)
    state = start(scene, (0.0, 0.0, 0.5), (0.3, 0.2, 0.0), (3.0, 4.0, 5.0))
    run = pc.simulate(scene, state, 1.65, t_eval=np.linspace(0.0, 1.65, 200), **options)
    assert run.status == 0, run.message
    angles = np.linspace(0.0, 2.0 * np.pi, 2000)
    # bodies get inside by what they go in a step, at 2 m/s
    deepest = 2.0 * options["step"] if "step" in options else OVERLAP["DOP853"]
    circle = 0.08 * np.array([np.cos(angles), np.sin(angles), 0.0 * angles])
    for q in run.q:
        x, _, z = q[:3, None] + pin.Quaternion(q[3:]).toRotationMatrix() @ circle
        assert (z - AMPLITUDE * np.sin(2.0 * np.pi * x / LENGTH)).min() > -deepest


@pytest.mark.parametrize("jump", [0.3, 0.06])
@pytest.mark.parametrize(
    ("method", "breakpoints"), [("DOP853", ()), ("DOP853", (0.1,)), ("Moreau", (0.1,)), ("Moreau", ())]
)
def test_a_motion_that_jumps_moves_no_body(method, breakpoints, jump):
    """A floor that is elsewhere from one instant to the next strikes what is in between with no speed at all: deep
    inside, and 1 cm, which is less than starts may be."""

    def motion(t):
        return pin.SE3(np.eye(3), np.array([0.0, 0.0, jump * (t > 0.1)])), np.zeros(6), np.zeros(6)

    scene = scene_of(pc.Point(), pc.Plane(), motion=pc.CallableMotion(motion))
    run = pc.simulate(scene, start(scene, (0.0, 0.0, 0.1)), 0.5, method=method, breakpoints=breakpoints)
    assert run.status == -1
    assert "'c' are " in run.message and " at once: a motion jumps" in run.message
    assert run.q[-1, 2] == pytest.approx(0.1 - 0.5 * G * run.t[-1] ** 2, abs=1e-3)


SHAPES = {
    "point": pc.Point(),
    "ball": pc.Sphere(0.06),
    "ellipsoid": pc.Ellipsoid(0.05, 0.08, 0.1),
    "ring": pc.Circle(0.08),
    "torus": pc.Torus(0.08, 0.03),
}
GROUNDS = {
    "waves": waves(),
    "endless waves": waves(None),
    "egg box": pc.HeightField(lambda x, y: 0.04 * math.sin(6.0 * x) * math.cos(7.0 * y), domain=((-2, 2), (-2, 2))),
    "cylinder": pc.Cylinder(0.3),
    "torus": pc.Torus(0.6, 0.2),
    "ellipsoid": pc.Ellipsoid(0.7, 0.5, 0.3),
}


@functools.cache
def samples_of(ground):
    """Samples of a ground, and twice their largest spacing."""
    contour = GROUNDS[ground]
    # angles as they are, lengths around the poses below
    window = [(low, high) if abs(low) < 4.0 and low != -2.0 else (-1.2, 1.2) for low, high in contour.domain]
    points = contour.evaluate_many(contour.samples((250, 250), window))[:, 0]
    tree = scipy.spatial.cKDTree(points)
    return tree, 2.0 * np.max(tree.query(points[::97], k=2)[0][:, 1])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("ground", GROUNDS)
def test_nearest_points(shape, ground):
    """Bounds and nearest points against samples of both contours, refined, in random poses that are apart."""
    rng = np.random.default_rng(len(shape) + 7 * len(ground))
    one, two = SHAPES[shape], GROUNDS[ground]
    scene = scene_of(one, two, side=1)
    system = RunSystem(scene.model, list(scene.contacts.values()))
    tree, spacing = samples_of(ground)
    found = 0
    for _ in range(4):
        place = rng.uniform(-0.5, 0.5, 3) + np.array([0.0, 0.0, 0.9])
        if ground == "cylinder":
            # beside it
            place *= [1.0, 0.2, 0.5]
            place[0] += math.copysign(0.5, place[0])
        quaternion = rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        system.q[:] = place if system.nq == 3 else [*place, *quaternion]
        turn = np.eye(3) if system.nq == 3 else pin.Quaternion(quaternion).matrix()
        own = one.evaluate_many(one.samples((40, 40)[: one.dimension] or 2))[:, 0] @ turn.T + place
        exact = float(tree.query(own)[0].min())
        system.evaluate_kinematics(0.0)
        search = NearestSearch(system, 0, 0.0)
        nearest = search.search(0.0)
        # samples are no nearer than what is nearest, and not by more than their spacing farther
        assert nearest.distance <= exact
        assert nearest.distance >= 0.7 * exact - 0.05
        if nearest.candidate is None:
            continue
        found += 1
        assert nearest.elsewhere >= nearest.distance
        assert exact - 2.0 * spacing - 0.004 <= nearest.candidate.gap <= exact + 1e-9
    assert found >= 3


# -------------------------------------------------------------------------------------------- nothing is flown through


@pytest.mark.parametrize("method", METHODS)
def test_a_plate_is_not_missed(method):
    """A ball thrown from 4 m at a plate of 0.4 m, that it is above for a moment of its flight only."""
    plate = pc.Plane(((-0.2, 0.2), (-0.2, 0.2)))
    for speed in (0.0, 3.0, 20.0):
        scene = scene_of(pc.Sphere(0.05), plate, restitution=0.5)
        flight = fall(4.0)
        state = start(scene, (0.0, 0.0, 4.05))
        state.q[0], state.v[0] = -speed * flight + 0.05, speed
        run = run_of(scene, state, 1.5, method)
        assert run.status == 0, run.message
        assert touches(run)[0] == pytest.approx(flight, abs=ACCURACY[method])


@pytest.mark.parametrize("method", ["DOP853", "RK45", "RK23", "Sharp98"])
def test_what_is_beside_a_plate_is_missed(method):
    """A ball that gets below the plate beside it, flies on under it, and comes out."""
    scene = scene_of(pc.Sphere(0.05), pc.Plane(((-0.2, 0.2), (-0.2, 0.2))))
    state = start(scene, (0.0, 0.0, 4.05))
    state.q[0], state.v[0] = -4.0 * fall(4.0) - 0.3, 4.0
    run = run_of(scene, state, 1.5, method)
    assert run.status == 0
    assert run.events == []
    assert run.q[-1, 2] == pytest.approx(4.05 - 0.5 * G * 1.5**2, abs=1e-7)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", ["point", "ball"])
def test_small_balls_are_not_missed(method, shape):
    """A point and a ball thrown from afar at a sphere of 1 cm, off its middle."""
    radius, own = 0.01, 0.004 if shape == "ball" else 0.0
    reach = radius + own
    for aside in (0.0, 0.5 * reach, 0.9 * reach):
        scene = scene_of(pc.Sphere(own) if own else pc.Point(), pc.Sphere(radius), side=1)
        step = {"step": 2e-4} if method == "Moreau" else {}
        run = run_of(scene, start(scene, (aside, 0.0, 4.0)), 0.95, method, **step)
        assert run.status == 0, run.message
        when = fall(4.0 - math.sqrt(reach**2 - aside**2))
        # where it grazes, a step of 0.2 ms or 2 mm takes the sphere for its tangent plane
        assert touches(run)[0] == pytest.approx(when, abs=2e-4 if method == "Moreau" else 1e-7)


def test_time_stepping_does_not_fly_through_silently():
    """A step that takes a point farther than a sphere is thick ends the run instead."""
    scene = scene_of(pc.Point(), pc.Sphere(0.01), side=1)
    run = pc.simulate(scene, start(scene, (0.0, 0.0, 4.0)), 0.95, method="Moreau", step=0.02)
    assert run.status == -9 and "contact 'c'" in run.message and "go through each other" in run.message
    stepper = pc.Stepper(scene, start(scene, (0.0, 0.0, 4.0)), dt=0.02)
    with pytest.raises(pc.SolverError, match="go through each other"):
        stepper.step(np.zeros(3), 50)


@pytest.mark.parametrize("block", range(4))
def test_no_step_flies_through_a_ball(block):
    """Forty points and balls thrown at balls of 1 to 50 cm, in steps of 1 to 50 ms: what gets within nine tenths of the
    ball's radius has touched it, or the run ends and names the contact."""
    finished = 0
    for seed in range(10 * block, 10 * block + 10):
        rng = np.random.default_rng(seed)
        own, size = float(rng.choice([0.0, 0.01, 0.05])), 10.0 ** rng.uniform(-2.0, -0.3)
        scene = scene_of(pc.Sphere(own) if own else pc.Point(), pc.Sphere(size), side=1, restitution=0.5)
        scene.model.gravity.linear = np.zeros(3)
        along, aside = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
        way, speed = rng.uniform(1.0, 5.0), 10.0 ** rng.uniform(0.0, 1.6)
        off = rng.uniform(0.0, 1.0) * (0.9 * size + own)
        state = start(scene, along * way + aside * off, -along * speed)
        duration = 2.0 * way / speed
        step = min(10.0 ** rng.uniform(-3.0, -1.3), duration / 3.0)
        run = pc.simulate(scene, state, duration, method="Moreau", step=step)
        assert (run.status == 0 and touches(run)) or (run.status == -9 and "'c'" in run.message), (seed, run.message)
        finished += run.status == 0
    assert finished >= 4


@pytest.mark.parametrize("method", ["DOP853", "RK45", "RK23", "Sharp98"])
def test_a_swinging_plate_is_not_missed(method):
    """A point that hovers where a plate comes once in a while: neither its state nor its gap's sign at a step's ends
    tells of it."""
    amplitude, frequency, height = 0.1, 5.0, 0.09
    motion = pc.HarmonicMotion(amplitude=(0.0, 0.0, amplitude), frequency=frequency)
    scene = scene_of(pc.Point(), pc.Plane(), motion=motion)
    scene.model.gravity.linear = np.zeros(3)
    run = run_of(scene, start(scene, (0.0, 0.0, height)), 2.0, method)
    assert run.status == 0
    assert touches(run)[0] == pytest.approx(math.asin(height / amplitude) / (2.0 * math.pi * frequency), abs=1e-7)


@pytest.mark.parametrize("method", ["DOP853", "RK45", "RK23", "Sharp98"])
def test_a_turning_arm_is_not_missed(method):
    """A ball at the end of an arm that turns steadily, which any step follows, dips into a floor once a turn."""
    model = one_body(pin.JointModelRY(), pin.Inertia(1.0, np.zeros(3), np.eye(3)), "arm")
    model.gravity.linear = np.zeros(3)
    scene = pc.Scene(model)
    scene.add_contour("ball", pc.Sphere(0.1), "arm", placement=pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0])))
    scene.add_contour("floor", pc.Plane(), placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.09])))
    scene.add_contact("c", "ball", "floor")
    state = scene.initial_state([-1.0], [7.0], free=["c"])
    run = run_of(scene, state, 5.0, method)
    assert run.status == 0
    # from 1 rad above to where sin = 0.99
    assert touches(run)[0] == pytest.approx((1.0 + math.asin(0.99)) / 7.0, abs=1e-7)


# ------------------------------------------------------------------------------------------------- from behind


def table_and_floor():
    model = body(pc.Sphere(0.1))
    scene = pc.Scene(model)
    scene.add_contour("ball", pc.Sphere(0.1), "body")
    scene.add_contour("table", pc.Plane(((-1.0, 1.0), (-1.0, 1.0))))
    scene.add_contour("floor", pc.Plane(), placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5])))
    scene.add_contact("on the table", "ball", "table", friction=None)
    scene.add_contact("on the floor", "ball", "floor", friction=None)
    return scene


@pytest.mark.parametrize("method", ["DOP853", "RK45", "RK23", "Sharp98"])
def test_a_ball_comes_back_under_the_table(method):
    """Off the table's end, down to the floor, and back under the table, drawn by a steady force: it stays there."""
    scene = table_and_floor()
    state = scene.initial_state([0.5, 0, 0.1, 0, 0, 0, 1], [1.5, 0, 0, 0, 0, 0], free=["on the floor"])
    run = run_of(
        scene, state, 2.5, method, control=lambda t, q, v: np.array([-1.5, 0, 0, 0, 0, 0.0]), t_eval=[1.0, 2.0, 2.5]
    )
    assert run.status == 0, run.message
    assert [(event.contact, event.kind) for event in run.events] == [
        ("on the table", "edge"),
        ("on the floor", "touch"),
    ]
    # x = 0.5 + 1.5 t - 0.75 t^2 all the way, which is under the table after 1.6 s
    assert run.q[:, 0] == pytest.approx(0.5 + 1.5 * run.t - 0.75 * run.t**2, abs=1e-6)
    assert run.q[:, 2] == pytest.approx([-0.4, -0.4, -0.4], abs=1e-9)


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_a_plate_is_passed_from_below_and_touched_from_above(method):
    """A point thrown up through a floor that it started under touches it as it comes down again."""
    scene = scene_of(pc.Point(), pc.Plane(), restitution=0.5)
    state = start(scene, (0.0, 0.0, 1.0))
    state.q[2], state.v[2] = -0.5, 5.0
    run = run_of(scene, state, 1.0, method)
    assert run.status == 0
    assert touches(run)[0] == pytest.approx((5.0 + math.sqrt(25.0 - G)) / G, abs=1e-7)


# ------------------------------------------------------------------------------------------------- steppers


@pytest.mark.parametrize("case", range(4))
def test_rings_that_tumble(case):
    """A ring's lowest point in closed form: its other stationary points, above and on the far side of the tube, are
    never taken for it, however often it turns over."""
    rng = np.random.default_rng(case)
    major = rng.uniform(0.1, 0.4)
    minor = rng.uniform(0.05, 0.4) * major
    scene = scene_of(pc.Torus(major, minor), pc.Plane())
    spin = rng.choice([3.0, 12.0]) * rng.normal(size=3)
    height, speed = major + minor + rng.uniform(0.05, 0.5), rng.uniform(-1.0, 2.0)
    # where it is flat all of the ring is lowest
    turn = pin.exp3(rng.normal(size=3))

    def lowest(t):
        along = (turn @ pin.exp3(spin * t))[2]
        return height + speed * t - 0.5 * G * t * t - major * math.hypot(along[0], along[1]) - minor

    times = np.linspace(0.0, 1.0, 2001)
    below = np.flatnonzero([lowest(t) < 0.0 for t in times])[0]
    end = scipy.optimize.brentq(lowest, times[below - 1], times[below], xtol=1e-13)
    q = [0.0, 0.0, height, *pin.Quaternion(turn).coeffs()]
    state = scene.initial_state(q, [*(turn.T @ [0.3, 0.2, speed]), *spin], free=["c"])
    shown = np.linspace(0.0, 0.999 * end, 30)
    run = pc.simulate(scene, state, end + 1e-3, t_eval=shown)
    np.testing.assert_allclose(run.contacts["c"].gap, [lowest(t) for t in shown], rtol=0.0, atol=1e-7)
    assert [event.kind for event in run.events][:1] == ["touch"]
    assert abs(run.events[0].time - end) <= 1e-7


def test_steppers_find_what_is_nearest():
    """Step by step, in counts and by rows alike, and as `simulate` does."""
    scene = scene_of(pc.Point(), pc.Ellipsoid(1.0, 1.0, 0.8), side=-1)
    state = start(scene, (0.05, 0.02, 0.1))
    run = pc.simulate(scene, state, 1.0, method="Moreau")
    one, many, rows = (pc.Stepper(scene, state, dt=1e-3) for _ in range(3))
    for _ in range(1000):
        one.step(np.zeros(3))
    many.step(np.zeros(3), 1000)
    q, _ = rows.rollout(np.zeros((100, 3)), 10)
    assert np.linalg.norm(run.q[-1] / [1.0, 1.0, 0.8]) == pytest.approx(1.0, abs=1e-9)
    for last in (one.q, many.q, q[-1]):
        # looks at other steps find the same points to the rounding of Newton's method
        assert last == pytest.approx(run.q[-1], abs=1e-9)


def test_what_may_touch_within_a_step_is_foreseen():
    """A ball beside the centre of a body that spins as it falls, above a plane: the first touch, from samples of a
    closed form, never comes before the bounds say that it may, and mostly not three times as late."""
    rng, foreseen = np.random.default_rng(5), []
    for _ in range(100):
        # above, where it has no speed towards the plane yet
        spin, lever, radius = np.array([10.0 ** rng.uniform(0.0, 2.5), 0.0, 0.0]), np.array([0.0, 0.0, 0.1]), 0.01
        height, rise = rng.uniform(0.0, 0.12), rng.uniform(-0.1, 0.1)
        scene = pc.Scene(body(pc.Sphere(radius)))
        ball = scene.add_contour("ball", pc.Sphere(radius), "body", pin.SE3(np.eye(3), lever))
        scene.add_contact("c", ball, scene.add_contour("ground", pc.Plane()))
        times = np.arange(0.0, 1.0, 1e-4)
        turned = scipy.spatial.transform.Rotation.from_rotvec(np.multiply.outer(times, spin)).apply(lever)
        gap = height + rise * times - 0.5 * G * times**2 + turned[:, 2] - radius
        touch = times[int(np.argmax(gap < 0.0))]
        state = start(scene, (0.0, 0.0, height), (0.0, 0.0, rise), spin)
        system = RunSystem(scene.model, list(scene.contacts.values()))
        system.q[:], system.v[:], system.location[:] = state.q, state.v, state.location
        write_discrete(system, state.discrete)
        system.evaluate(0.0)
        opened = OpenContacts(system)
        assert opened.are_any(0.0)
        assert opened.begin_step(0.0, touch) == (math.inf, True)
        foreseen.append(opened.begin_step(0.0, 0.3 * touch)[1])
    assert np.mean(foreseen) < 0.5


@pytest.mark.parametrize("seed", range(12))
def test_a_ball_on_a_spinning_body_touches_a_plane_when_it_first_can(seed):
    """A body of equal moments of inertia spins steadily as it falls; a ball beside its centre goes up and down many
    times before it touches. The time is the first root of a closed form, looked for in samples 1000 to a turn."""
    rng = np.random.default_rng(seed)
    spin = rng.uniform(20.0, 300.0) * np.array([1.0, *rng.uniform(-1.0, 1.0, 2)])
    lever, radius = rng.uniform(0.02, 0.1) * np.array([0.0, *rng.uniform(0.3, 1.0, 2)]), 0.01
    rise, method = rng.uniform(-1.0, 1.0), METHODS[rng.integers(4)]

    def above(t, height):
        turned = scipy.spatial.transform.Rotation.from_rotvec(np.multiply.outer(t, spin)).apply(lever)
        return height + rise * t - 0.5 * G * t * t + turned[..., 2] - radius

    # it comes to within a hair, or just misses, on one of the first turns
    times = np.arange(0.0, 1.0, 2e-3 * math.pi / np.linalg.norm(spin))
    height = 1e-4 * rng.uniform(0.1, 10.0) - above(times[times < 0.1], 0.0).min() + rng.choice([0.0, 0.02])
    first = int(np.argmax(above(times, height) < 0.0))
    expected = scipy.optimize.brentq(above, times[first - 1], times[first], args=(height,), xtol=1e-15)
    scene = pc.Scene(body(pc.Sphere(radius)))
    ball = scene.add_contour("ball", pc.Sphere(radius), "body", pin.SE3(np.eye(3), lever))
    scene.add_contact("c", ball, scene.add_contour("ground", pc.Plane()))
    state = start(scene, (0.0, 0.0, height), (0.0, 0.0, rise), spin)
    run = pc.simulate(scene, state, 1.01 * expected, method=method, **TOLERANCES)
    touches = [event.time for event in run.events if event.kind == "touch"]
    # a slow touch at 1e-8 of the state; grazes magnify it
    assert touches[0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("options", [{}, {"method": "Moreau", "step": 1e-3}])
@pytest.mark.parametrize(
    ("depth", "speed", "told"),
    [
        (1e-4, -0.1, False),  # has just touched, as states of coarser models have
        (4e-3, -0.1, False),
        (4e-3, 0.0, False),
        (4e-3, 1e-12, False),
        (2e-2, 1.0, False),  # comes out, and comes down again
        (2e-2, -0.1, True),  # inside: there it touches nothing
        (5e-2, 0.0, True),
    ],
)
def test_starts_inside(depth, speed, told, options):
    """A ball that is free starts within the floor: both kinds of methods take it alike, and say where it ends."""
    radius, duration = 0.1, 0.4
    scene = pc.Scene(one_body(pin.JointModelPZ(), pin.Inertia.FromSphere(1.0, radius), "ball"))
    floor, ball = scene.add_contour("floor", pc.Plane()), scene.add_contour("ball", pc.Sphere(radius), "ball")
    scene.add_contact("c", ball, floor)
    state = scene.initial_state([radius - depth], [speed], free=["c"])
    run = pc.simulate(scene, state, duration, **options)
    assert run.status == 0
    assert ("'c' (gap -" in run.message) == told, run.message
    fallen = radius - depth + speed * duration - 0.5 * 9.81 * duration**2
    assert run.q[-1, 0] == pytest.approx(fallen if told else radius, abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_starts_slightly_inside_touch_in_every_method(seed):
    """At rest by up to 4 mm, where they come in, by up to 0.1 mm. What rested deeper than 1e-6 of the length fell."""
    rng = np.random.default_rng(seed)
    shapes = pc.Sphere(0.1), pc.Ellipsoid(0.1, 0.08, 0.06), pc.Circle(0.1), pc.Torus(0.1, 0.03)
    grounds = (pc.Plane(), None), (pc.Sphere(2.0), -2.0), (waves(None), None)
    ground, level = grounds[rng.integers(3)]
    placement = None if level is None else pin.SE3(np.eye(3), np.array([0.0, 0.0, level]))
    friction = [pc.Coulomb(0.5), pc.NoSlip(), None][rng.integers(3)]
    scene = scene_of(shapes[seed % 4], ground, placement, friction=friction)
    turn = pin.Quaternion(pin.exp3(rng.normal(size=3))).coeffs()
    q = scene.initial_state([*0.2 * rng.normal(size=2), 0.12, *turn], np.zeros(6), max_gap=0.5).q
    rests = seed % 3 == 0
    q[2] -= 10.0 ** rng.uniform(-11.0, -2.4 if rests else -4.0)
    v = np.zeros(6) if rests else np.r_[0.5 * rng.normal(size=3), 2.0 * rng.normal(size=3)]
    state = scene.initial_state(q, v, free=["c"], max_gap=0.5)
    runs = [pc.simulate(scene, state, 0.05, **options) for options in ({}, {"method": "Moreau", "dt": 2.5e-4})]
    assert [run.status for run in runs] == [0, 0]
    first, second = (touches(run)[:1] for run in runs)
    assert len(first) == len(second)
    if rests:
        assert first == [0.0]
    # the step of an impact is of first order, and g / 2 times 0.05^2 what nothing holds falls by
    np.testing.assert_allclose(first, second, rtol=0.0, atol=5e-4)
    assert np.abs(runs[0].q[-1] - runs[1].q[-1]).max() < 2e-3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("shape", "order"),
    [
        (pc.Sphere(0.1), ("shape", "ground")),
        (pc.Ellipsoid(0.1, 0.08, 0.1), ("ground", "shape")),
        (pc.Circle(0.1), ("shape", "ground")),
    ],
    ids=["Sphere", "Ellipsoid", "Circle"],
)
def test_what_starts_beside_a_plate_lands_on_it(shape, order, method):
    """Thrown from beside its edge, where only the plate's continuation has a point opposite: the nearest one counts."""
    plate = pc.Plane(domain=((-0.5, 0.5), (-0.5, 0.5)))
    scene = scene_of(shape, plate, order=order, restitution=0.6)
    # about x, so that a ring stands upright
    q = [-0.6, 0.0, 0.4, math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
    state = scene.initial_state(q, [1.0, 0, 0, 0, 0, 0], free=["c"])
    lowest = 0.08 if isinstance(shape, pc.Ellipsoid) else 0.1
    run = run_of(scene, state, 0.4, method)
    assert run.status == 0, run.message
    assert run.contacts["c"].gap[0] == pytest.approx(0.4 - lowest, abs=1e-12)
    assert touches(run) == [pytest.approx(fall(0.4 - lowest), abs=ACCURACY[method])]


@pytest.mark.parametrize("side", [None, 1])
@pytest.mark.parametrize("method", METHODS)
def test_rods_that_pass_through_parallel_do_not_touch(method, side):
    """Their common normal turns round then, and with it the sign of their gap, 0.26 m apart."""
    model = body(pc.Sphere(0.1))
    model.gravity.setZero()
    scene, rod = pc.Scene(model), pc.Line((-0.3, 0.3))
    scene.add_contact(
        "c", scene.add_contour("a", rod), scene.add_contour("b", rod, frame="body"), restitution=1.0, side=side
    )
    turn = pin.Quaternion(pin.rpy.rpyToMatrix(0.02, 0.03, 0.5)).coeffs()
    state = scene.initial_state([0, 0, 0.3, *turn], [0, 0, -0.05, 0, 0, -1.0], free=["c"])
    run = run_of(scene, state, 3.0, method)
    assert run.status == 0 and not touches(run)
    np.testing.assert_allclose(run.v[-1, 3:], [0.0, 0.0, -1.0], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(run.v[-1, :3]), 0.05, rtol=0.0, atol=1e-7)
    # where a side is given, bodies are on the other one then, and that is told
    assert ("inside or behind each other" in run.message) == (side is not None)
    assert run.contacts["c"].gap[-1] * (1 if side is None else -1) > 0.1


def test_throws_across_a_tube():
    """Past its axis, where what is nearest goes over to the other side within steps: long steps of a method of low
    order touch when short ones of high order do."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        shape, tube = pc.Ellipsoid(*rng.uniform(0.04, 0.12, 3)), pc.Cylinder(rng.uniform(0.5, 0.8))
        placement = pin.SE3(pin.exp3(rng.normal(size=3)), np.zeros(3))
        scene = scene_of(shape, tube, placement=placement, side=1, order=("ground", "shape"))
        state = start(scene, rng.uniform(-0.15, 0.15, 3), rng.normal(size=3), 3.0 * rng.normal(size=3))
        expected = touches(pc.simulate(scene, state, 0.3, rtol=1e-10, atol=1e-12))
        for steps in (None, 36):
            run = pc.simulate(scene, state, 0.3, method="RK45", **({"max_step": 0.3 / steps} if steps else {}))
            assert run.status == 0, (seed, run.message)
            assert len(touches(run)) == len(expected), seed
            np.testing.assert_allclose(touches(run)[:1], expected[:1], atol=1e-5)
