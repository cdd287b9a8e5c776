"""Contours that end: the contact point reaches the end at a time known in closed form."""

import math

import numpy as np
import pinocchio as pin
import pytest
from shared import body_scene, one_body, rotation

import pincontact as pc

SLOPE = 0.5
GRAVITY = 9.81


def bead(contour, placement=None, **options):
    """A point mass of 1 kg that slides on a contour of the world without friction."""
    scene = pc.Scene(one_body(pin.JointModelTranslation(), pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), "bead"))
    point = scene.add_contour("bead", pc.Point(), frame="bead")
    ground = scene.add_contour("ground", contour, placement=placement)
    scene.add_contact("contact", point, ground, **options)
    return scene


def inclined():
    return pin.SE3(pin.utils.rotate("y", SLOPE), np.zeros(3))


def time_down(length):
    """Time from rest over a length of the incline without friction."""
    return math.sqrt(2.0 * length / (GRAVITY * math.sin(SLOPE)))


def test_bead_reaches_the_end_of_its_wire():
    scene = bead(pc.Line((-1.0, 1.0)), inclined())
    run = pc.simulate(scene, scene.initial_state(np.zeros(3)), 2.0, rtol=1e-10, atol=1e-12)
    assert run.status < 0
    assert "end of a contour" in run.message
    (event,) = run.events
    assert (event.kind, event.contact) == ("edge", "contact")
    # event times are refined to the accuracy of the state, a few times rtol
    assert event.time == pytest.approx(time_down(1.0), abs=1e-9)
    assert run.t[-1] == event.time
    assert run.contacts["contact"].location[-1] == pytest.approx(1.0, abs=1e-9)


def test_point_leaves_a_patch_and_falls():
    patch = pc.Plane(((-1.0, 1.0), (-1.0, 1.0)))
    scene = bead(patch, inclined())
    times = np.linspace(0.0, 1.2, 25)
    run = pc.simulate(scene, scene.initial_state(np.zeros(3)), 1.2, rtol=1e-10, atol=1e-12, t_eval=times)
    assert run.status == 0
    (event,) = run.events
    leaving = time_down(1.0)
    assert (event.kind, event.time) == ("edge", pytest.approx(leaving, abs=1e-9))
    mode = run.contacts["contact"].mode
    assert set(mode[times < leaving]) == {0}
    assert set(mode[times > leaving]) == {-1}
    # free fall from the end, with the speed reached there: no force, although the plane would go on
    down = np.array([math.cos(SLOPE), 0.0, -math.sin(SLOPE)])
    flight = times[-1] - leaving
    expected = down + GRAVITY * math.sin(SLOPE) * leaving * down * flight + np.array([0, 0, -0.5 * GRAVITY]) * flight**2
    assert run.q[-1] == pytest.approx(expected, abs=1e-8)
    assert run.contacts["contact"].gap[-1] < 0.0


def test_a_pole_is_no_end():
    """A ball that rolls over the poles of its own charts meets no event."""
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.004 * np.eye(3)), "ball"))
    ball = scene.add_contour("ball", pc.Sphere(0.1), frame="ball")
    floor = scene.add_contour("floor", pc.Plane())
    scene.add_contact("contact", ball, floor, friction=pc.NoSlip())
    state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [1.0, 0, 0, 0, 10.0, 0])
    run = pc.simulate(scene, state, 5.0)
    assert run.status == 0
    assert run.events == []
    assert run.q[-1, :3] == pytest.approx([5.0, 0.0, 0.1], abs=1e-7)
    assert set(run.contacts["contact"].charts[:, 0]) == {0, 1}


@pytest.mark.parametrize("shape", ["cycloid", "cone"])
def test_cusps_and_apexes_are_ends(shape):
    """A bead runs into the cusp of a cycloid, or into a cone's apex, where the location's rates grow without bound: the
    run ends with the edge that it is, on the constraints."""
    model = one_body(pin.JointModelTranslation(), pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), "bead")
    model.gravity.linear = np.zeros(3)
    scene = pc.Scene(model)
    contour, u, along, sign, pattern = {
        "cycloid": (pc.Cycloid(0.5), [1.0], 1, 1.0, "P-3C"),
        "cone": (pc.Cone(0.5), [0.3, 0.4], 2, -1.0, None),
    }[shape]
    bead, wall = scene.add_contour("bead", pc.Point(), "bead"), scene.add_contour("wall", contour)
    scene.add_contact("c", bead, wall, bilateral=True, pattern=pattern)
    tangent = contour.evaluate(u)[along]
    state = scene.initial_state(contour.point(u), sign * tangent / np.linalg.norm(tangent))
    run = pc.simulate(scene, state, 5.0)
    assert run.status == -8, run.message
    assert run.events[-1].kind == "edge"
    # at 1 m/s: the arc of the cycloid from u to its cusp, of which 1e-9 m are left; the line to the cone's apex, of
    # which 1e-6 m are left
    way = 4.0 * 0.5 * (1.0 - math.sin(0.5)) if shape == "cycloid" else 0.4
    assert run.t[-1] == pytest.approx(way, abs=2e-6)
    # close to the cusp a parameter is known to the square root of rounding only
    assert max(values.max() for values in run.residuals().values()) < 1e-10


RADIUS = 0.1
STANDING = np.array([0.0, 0.0, 0.0, 1.0])
ACROSS = (-9.0, 9.0)


def tilted(angle=0.0, x=0.0, z=0.0):
    """A placement that is turned about y, so that x goes down."""
    return pin.SE3(pin.utils.rotate("y", angle), np.array([x, 0.0, z]))


def roll(pieces, lines, speed, start, mu, duration, method, **options):
    """A ball rolls along x from `start` over pieces of ground (contour, placement), the first of which it is on, and
    edges, lines along y through points (x, z); the run, with its energies."""
    scene = body_scene(pin.JointModelFreeFlyer(), 1.0, 3 * [0.4 * RADIUS**2])
    ball, friction = scene.add_contour("ball", pc.Sphere(RADIUS), frame="body"), pc.Coulomb(mu) if mu else None
    turned = pin.utils.rotate("z", 0.5 * math.pi)
    parts = [*pieces, *((pc.Line(ACROSS), pin.SE3(turned, np.array([x, 0.0, z]))) for x, z in lines)]
    names = [f"c{i}" for i in range(len(parts))]
    for name, (contour, placement) in zip(names, parts):
        scene.add_contact(name, ball, scene.add_contour(name, contour, placement=placement), friction)
    state = scene.initial_state([*start, *STANDING], [speed, 0, 0, 0, speed / RADIUS, 0], free=names[1:])
    return pc.simulate(scene, state, duration, method=method, energies=True, **options)


def before_and_behind(edge, angle=0.0, x=0.0, z=0.0):
    """Two planes: one that ends at x = edge, and one that begins at (x, z) and goes down at that angle."""
    return [
        (pc.Plane(((-9.0, edge), ACROSS)), None),
        (pc.Plane(((0.0, 9.0), ACROSS)), tilted(angle, x, z)),
    ]


METHODS = ["DOP853", "RK45", "Moreau"]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(2))
def test_a_ball_rolls_over_a_crest(seed, method):
    """It turns about the crest until the slope behind carries it, whose gap is zero there, and negative till then."""
    rng = np.random.default_rng(seed)
    angle, speed = rng.uniform(0.02, 0.4), rng.uniform(0.2, 0.4)
    run = roll(before_and_behind(0.0, angle), [(0.0, 0.0)], speed, (-0.1, 0.0, RADIUS), 0.8, 0.1 / speed + 0.4, method)
    assert run.status == 0, run.message
    assert [event.contact for event in run.events if event.kind == "touch"] == ["c2", "c1"]
    # on the slope, which nothing has kept it from: no height is lost but to gravity, and no energy
    below = tilted(angle).actInv(run.q[-1, :3])
    assert below[0] > 0.02 and below[2] == pytest.approx(RADIUS, abs=1e-9)
    energies = run.energies()
    # in steps of 1 ms: an edge is met up to 0.4 mm late, which costs the square of an angle of 4e-3
    loss = 1e-3 if method == "Moreau" else 1e-8
    np.testing.assert_allclose(energies.total, energies.total[0], atol=loss * energies.total[0])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("gap", "step", "mu"), [(0.01, 0.0, 0.5), (1e-3, 0.0, 0.0), (1e-4, 0.0, 0.5), (1e-3, 1e-3, 0.0), (1e-3, -1e-3, 0.5)]
)
def test_a_ball_crosses_a_joint(gap, step, mu, method):
    """Between two plates, the far one of which is as high, higher or lower. Without edges it overlaps with that one,
    where it is no lower, which is told."""
    pieces = before_and_behind(0.0, 0.0, gap, step)
    for edges in ([(0.0, 0.0), (gap, step)], []):
        run = roll(pieces, edges, 1.0, (-0.1, 0.003, RADIUS), mu, 0.3, method)
        # steps of 1 ms cross a joint of 1 mm without seeing it
        told = not edges and (step > 0.0 or (step == 0.0 and gap > 2e-3))
        if told or run.status < 0:
            assert not edges and step >= 0.0 and run.status == -3 and "'c1': the bodies overlap" in run.message
            assert run.q[-1, 2] == pytest.approx(RADIUS, abs=1e-3)
        else:
            assert run.status == 0, run.message
            assert run.q[-1, 0] > 0.1 and run.q[-1, 2] == pytest.approx(RADIUS + step, abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_ball_climbs_a_kerb_and_comes_back_over_an_edge(method):
    """Onto a kerb of a twentieth of its radius; and over the end of a table, from which it is drawn back."""
    pieces = [(pc.Plane(((-9.0, 9.0), ACROSS)), None), (pc.Plane(((0.0, 9.0), ACROSS)), tilted(z=0.005))]
    run = roll(pieces, [(0.0, 0.005)], 0.8, (-0.2, 0.0, RADIUS), 0.6, 0.7, method)
    assert run.status == 0, run.message
    assert run.q[-1, 0] > 0.1 and run.q[-1, 2] == pytest.approx(RADIUS + 0.005, abs=1e-9)
    table = [(pc.Plane(((-9.0, 0.0), ACROSS)), None)]

    def pull(t, q, v):
        return np.array([*(pin.Quaternion(q[3:]).matrix().T @ [-3.0, 0.0, 0.0]), 0.0, 0.0, 0.0])

    run = roll(table, [(0.0, 0.0)], 0.3, (-0.01, 0.0, RADIUS), 0.6, 0.6, method, control=pull)
    assert run.status == 0, run.message
    assert run.q[:, 0].max() > 0.005 and run.q[-1, 0] < -0.05
    assert run.q[-1, 2] == pytest.approx(RADIUS, abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("overlap", "mu"), [(0.0, 0.0), (0.0, 0.5), (0.01, 0.5)])
def test_a_ball_goes_over_a_rounded_crest(mu, overlap, method):
    """A plane, a cylinder and a slope, each tangent to the one before, which end where they touch: the speed is that of
    a fall, or of rolling. A slope that begins before the cylinder's end has an edge 0.2 mm above it."""
    angle, round_, speed = 0.26, 0.3, 0.5
    slope = tilted(angle)
    slope.translation = np.array([0.0, 0.0, -round_]) + slope.rotation @ np.array([0.0, 0.0, round_])
    side = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.array([0.0, 0.0, -round_]))
    pieces = [
        (pc.Plane(((-9.0, overlap), ACROSS)), None),
        (pc.Cylinder(round_, ((0.5 * math.pi - angle, 0.5 * math.pi), ACROSS)), side),
        (pc.Plane(((-overlap, 9.0), ACROSS)), slope),
    ]
    run = roll(pieces, [], speed, (-0.1, 0.002, RADIUS), mu, 0.8, method)
    if overlap:
        assert run.status == -3 and "'c2': the bodies overlap" in run.message
        return
    assert run.status == 0, run.message
    below = slope.actInv(run.q[-1, :3])
    assert below[0] > 0.1 and below[2] == pytest.approx(RADIUS, abs=1e-9)
    fall = RADIUS - run.q[-1, 2]
    expected = math.sqrt(speed**2 + 2.0 * GRAVITY * fall / (1.4 if mu else 1.0))
    # in steps of 1 ms angles of 2e-3 are met at once
    assert np.linalg.norm(run.v[-1, :3]) == pytest.approx(expected, rel=1e-4 if method == "Moreau" else 1e-7)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("yaw", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_a_box_slides_over_a_step(mu, yaw, method):
    """Points of the step's edge come into the box's bottom at gap zero, and carry it as it tips."""
    half = 0.06
    scene = body_scene(pin.JointModelFreeFlyer(), 1.0, 3 * [(2.0 * half) ** 2 / 6.0])
    step = scene.add_contour("step", pc.Plane(((-2.0, 0.0), (-2.0, 2.0))))
    friction = pc.Coulomb(mu) if mu else None
    for i, (x, y) in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1)]):
        place = pin.SE3(np.eye(3), half * np.array([x, y, -1.0]))
        scene.add_contact(f"corner{i}", scene.add_contour(f"corner{i}", pc.Point(), "body", place), step, friction)
    down = pin.SE3(pin.utils.rotate("x", math.pi), np.array([0.0, 0.0, -half]))
    bottom = scene.add_contour("bottom", pc.Plane(((-half, half), (-half, half))), "body", down)
    for y in (-0.05, 0.05):
        edge = scene.add_contour(f"edge{y}", pc.Point(), placement=pin.SE3(np.eye(3), np.array([0.0, y, 0.0])))
        scene.add_contact(f"edge{y}", edge, bottom, friction)
    edges = [name for name in scene.contacts if name.startswith("edge")]
    state = scene.initial_state([-0.2, 0.0, half, *STANDING], [1.4, 0.0, 0.0, 0.0, 0.0, yaw], free=edges)
    run = pc.simulate(scene, state, 0.15, method=method)
    assert run.status == 0, run.message
    assert {event.contact for event in run.events if event.kind == "touch"} >= set(edges)
    for q in run.q:
        body = pin.XYZQUATToSE3(q)
        inside = [body.actInv(scene.contours[name].placement.translation) for name in edges]
        assert all(np.abs(x[:2]).max() > 0.98 * half or x[2] < -half + 1e-6 for x in inside)
    # without friction it is soon far enough out to tip
    assert (run.v[-1, 4] > 0.1) == (mu == 0.0)


def in_a_valley(seed: int, overlap: float):
    """Where a disk that slides without friction in a valley of two half planes is after half a second, in which it yaws
    to and fro through the way the valley goes, and touches both there. overlap: by how much they go on behind it."""
    axes, radius = rotation(np.random.default_rng(seed)), 0.13
    moments = [0.25 * radius**2, 0.25 * radius**2, 0.5 * radius**2]
    scene = body_scene(pin.JointModelFreeFlyer(), 1.0, moments, axes @ [0.0, 0.0, -GRAVITY])
    scene.add_contour("disk", pc.Circle(radius), frame="body")
    yawed = pin.utils.rotate("z", 0.25) @ pin.utils.rotate("x", 0.5 * math.pi)
    normals, heights = [], []
    for slope, ends in ((0.758, (-overlap, math.inf)), (-1.065, (-math.inf, overlap))):
        turned = pin.utils.rotate("x", slope)
        plane = pc.Plane(((-math.inf, math.inf), ends))
        scene.add_contour(f"plane {slope}", plane, placement=pin.SE3(axes @ turned, np.zeros(3)))
        scene.add_contact(f"disk on plane {slope}", "disk", f"plane {slope}")
        normals.append(turned[1:, 2])
        heights.append(radius * math.sqrt(1.0 - (yawed[:, 2] @ turned[:, 2]) ** 2))
    place = axes @ [0.0, *np.linalg.solve(normals, heights)]
    state = scene.initial_state(
        [*place, *pin.Quaternion(axes @ yawed).coeffs()], [*(yawed.T @ [0.3, 0.0, 0.0]), *(yawed.T @ [0.1, 0.0, -2.0])]
    )
    run = pc.simulate(scene, state, 0.5)
    assert run.status == 0, run.message
    return axes.T @ run.q[-1, :3], len(run.events)


@pytest.mark.parametrize("seed", (4, 8, 14))
def test_a_disk_stays_in_a_valley_whose_planes_end_there(seed):
    """Its points graze the ends, and do not come over them, wherever errors of a step have them."""
    place, events = in_a_valley(seed, 0.0)
    expected, without = in_a_valley(seed, 0.01)
    assert events == without
    # at the default tolerance of 1e-8
    assert np.abs(place - expected).max() < 1e-7


def thrown_at_an_edge(contour, moments, start, velocity, mu, duration, plane_first, method="DOP853"):
    """A run of a body of 1 kg that is thrown at the edge, along y, of a plane that ends at x = 0."""
    scene, friction = body_scene(pin.JointModelFreeFlyer(), 1.0, moments), pc.Coulomb(mu) if mu else None
    scene.add_contour("body", contour, frame="body")
    scene.add_contour("plane", pc.Plane(((-math.inf, 0.0), (-math.inf, math.inf))))
    turned = pin.SE3(pin.utils.rotate("z", 0.5 * math.pi), np.zeros(3))
    scene.add_contour("edge", pc.Line((-math.inf, math.inf)), placement=turned)
    scene.add_contact("on plane", *(("plane", "body") if plane_first else ("body", "plane")), friction)
    scene.add_contact("on edge", "body", "edge", friction)
    state = scene.initial_state(start, velocity, free=["on plane", "on edge"])
    return pc.simulate(scene, state, duration, method=method)


def test_a_torus_that_comes_over_an_edge_touches_the_plane_behind_it():
    """Elsewhere than where it was followed to, and within the step as far as gaps are known."""
    axes = np.array([[-0.266, 0.941, 0.209], [-0.281, 0.131, -0.951], [-0.922, -0.312, 0.229]])
    left, _, right = np.linalg.svd(axes)
    start = [0.0609, 0.0, 0.25, *pin.Quaternion(left @ right).coeffs()]
    velocity = [*(right.T @ left.T @ [-0.056, 0.747, -1.847]), 7.83, -0.48, 3.4]
    torus, moments = pc.Torus(0.164, 0.036), (0.01, 0.01, 0.02)
    runs = [thrown_at_an_edge(torus, moments, start, velocity, 1.0, 0.155, first) for first in (False, True)]
    for run in runs:
        assert run.status == 0, run.message
        assert ("on plane", "touch") in [(event.contact, event.kind) for event in run.events]
        assert abs(run.contacts["on plane"].gap[-1]) < 1e-8
    # at the default tolerance of 1e-8, after two impacts
    assert np.abs(runs[0].q[-1] - runs[1].q[-1]).max() < 1e-6


@pytest.mark.parametrize(("seed", "method"), [(0, "DOP853"), (4, "DOP853"), (4, "Moreau")])
def test_an_ellipsoid_falls_past_an_edge(seed, method):
    """It is beside the plane then, which it touches nowhere, in whatever order the contours are named."""
    turning = np.random.default_rng(seed).integers(-6, 7, 3)
    moments = 0.2 * np.array([0.1**2 + 0.12**2, 0.2**2 + 0.12**2, 0.2**2 + 0.1**2])
    start, velocity = [0.1, 0.0, 0.3, *STANDING], [0.0, 0.0, 0.0, *turning]
    shape = pc.Ellipsoid(0.2, 0.1, 0.12)
    runs = [thrown_at_an_edge(shape, moments, start, velocity, 0.0, 0.5, first, method) for first in (False, True)]
    for run in runs:
        assert run.status == 0, run.message
    assert np.abs(runs[0].q[-1] - runs[1].q[-1]).max() < 1e-6
