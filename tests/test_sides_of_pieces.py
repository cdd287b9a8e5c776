"""Tracks of pieces whose sides nobody gives: a body is on that side of a piece on which it comes over it, whichever way
the piece runs, and moves as on a track of which all sides are given."""

import math
import warnings

import numpy as np
import pinocchio as pin
import pytest
from shared import one_body

import pincontact as pc

UPRIGHT = pin.utils.rotate("x", 0.5 * math.pi)
BESIDE, SIDE = -1, 3  # columns of `State.discrete`
WIDE = (-0.5, 0.5)


def wheel(radius):
    model, joint = pin.Model(), 0
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("turn", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    inertia = pin.Inertia(0.3, np.zeros(3), 0.15 * radius**2 * np.eye(3))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    return model


def along(angle):
    """Rotation of a frame whose x-axis rises by an angle in the xz-plane of the world, with y up in it."""
    return pin.utils.rotate("y", -angle) @ UPRIGHT


def above(piece, placement):
    """The side of a piece that is above its middle."""
    values = piece.evaluate(np.mean(piece.domain, axis=1).tolist())
    across = values[2] if piece.dimension == 2 else [0.0, 0.0, 1.0]
    return 1 if (placement.rotation @ np.cross(values[1], across))[2] > 0.0 else -1


def piece_of(kind, place, angle, rng, in_space):
    """A piece that begins at a place and an angle, and where and at which angle it ends; it runs either way."""
    reverse = rng.random() < 0.5
    if kind == "arc":
        radius, turn, hollow = rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.9), 1.0 if angle < 0.0 else -1.0
        centre = place + radius * hollow * np.array([-math.sin(angle), 0.0, math.cos(angle)])
        first = angle - 0.5 * math.pi * hollow
        last = first + hollow * turn
        low, high = sorted((first, last))
        end = centre + radius * np.array([math.cos(last), 0.0, math.sin(last)])
        if in_space:
            piece, rotation = pc.Cylinder(radius, ((low, high), WIDE)), UPRIGHT
        elif reverse:
            piece, rotation = pc.Circle(radius, domain=(-high, -low)), UPRIGHT @ np.diag([1.0, -1.0, -1.0])
        else:
            piece, rotation = pc.Circle(radius, domain=(low, high)), UPRIGHT
        return piece, pin.SE3(rotation, centre), end, angle + hollow * turn
    length, rise = rng.uniform(0.3, 0.8), rng.uniform(-0.12, 0.12)
    rotation, end = along(angle), place + length * along(angle)[:, 0]
    if in_space:
        rotation = pin.utils.rotate("y", -angle) @ np.diag([1.0, -1.0, -1.0] if reverse else [1.0, 1.0, 1.0])
        return pc.Plane(((0.0, length), WIDE)), pin.SE3(rotation, place), end, angle
    if kind == "line":
        # upside down
        rotation = rotation @ np.diag([1.0, -1.0, -1.0]) if reverse else rotation
        return pc.Line((0.0, length)), pin.SE3(rotation, place), end, angle
    u = np.linspace(0.0, length, 41)
    points = np.stack([u, rise * np.sin(math.pi * u / length) ** 2, 0.0 * u], axis=1)
    return pc.SplineCurve(points[::-1] if reverse else points), pin.SE3(rotation, place), end, angle


def track(seed, in_space):
    """A function that makes the scene and its start, with all sides given or none; two to five pieces, tangent or with
    kinks, and a body that rolls on the first, or falls onto them."""
    rng = np.random.default_rng(seed)
    radius, kinks, place, angle = rng.uniform(0.03, 0.06), 0.3 * (seed % 3 == 0), np.zeros(3), rng.uniform(-0.7, -0.2)
    slope, pieces = angle, []
    for i in range(rng.integers(2, 6)):
        kind = "line" if i == 0 else rng.choice(["line", "arc", "arc", "spline"])
        piece, placement, place, angle = piece_of(kind, place, angle, rng, in_space)
        pieces.append((piece, placement, above(piece, placement)))
        angle += kinks * rng.uniform(-1.0, 1.0)
    law = [None, pc.Coulomb(rng.uniform(0.1, 0.6)), pc.NoSlip()][seed % 3]
    falls, part, height, speed = seed % 4 == 3, rng.uniform(0.05, 0.2), rng.uniform(0.2, 0.5), rng.uniform(0.0, 1.0)
    inertia = pin.Inertia(0.3, np.zeros(3), 0.12 * radius**2 * np.eye(3))
    model = one_body(pin.JointModelFreeFlyer(), inertia) if in_space else wheel(radius)
    forward, up = along(slope)[:, 0], along(slope)[:, 1]
    at, v = part * forward + (radius + height * falls) * up, speed * falls * forward

    def make(given):
        scene = pc.Scene(model)
        if in_space:
            scene.add_contour("shape", pc.Sphere(radius), "body")
        else:
            scene.add_contour("shape", pc.Circle(radius), "body", placement=pin.SE3(UPRIGHT, np.zeros(3)))
        for i, (piece, placement, side) in enumerate(pieces):
            scene.add_contour(f"piece{i}", piece, placement=placement)
            scene.add_contact(f"c{i}", "shape", f"piece{i}", law, side=side if given else None)
        names = list(scene.contacts)
        start = ([*at, 0, 0, 0, 1], [*v, 0, 0, 0]) if in_space else ([at[0], at[2], 0.0], [v[0], v[2], 0.0])
        return scene, scene.initial_state(*start, free=names[0 if falls else 1 :])

    return make


def told_events(run):
    """Contacts and kinds of events, without touches that end at once, as they may at a tangent joint."""
    left = []
    for event in run.events:
        if event.kind == "separate" and left and left[-1].contact == event.contact and left[-1].time == event.time:
            left.pop()
        else:
            left.append(event)
    return [(event.contact, event.kind) for event in left]


METHODS = {"events": {}, "steps": {"method": "Moreau", "dt": 2e-3}}


@pytest.mark.parametrize("in_space", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_tracks_of_which_no_side_is_given(seed, in_space):
    make = track(seed, in_space)
    (scene, start), (told, told_start) = make(False), make(True)
    for name, options in METHODS.items():
        run, other = (pc.simulate(one, state, 1.2, **options) for one, state in ((scene, start), (told, told_start)))
        assert run.status == other.status == 0, (run.message, other.message)
        assert told_events(run) == told_events(other)
        # error control sees other steps; time stepping takes the same, but for rounding and what Newton's method leaves
        assert np.abs(run.q[-1] - other.q[-1]).max() < (1e-6 if name == "events" else 1e-8)
        decided, given = (one.state(-1).discrete for one in (run, other))
        over = decided[:, BESIDE] == 0
        assert (decided[over, SIDE] == given[over, SIDE]).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("faces_first", [False, True])
def test_a_ball_goes_round_an_edge_onto_the_side_face(faces_first, method):
    """At its start the ball is behind what the side face would go on as; it comes over it from the other side,
    whichever contour is named first."""
    radius, force, inertia = 0.04, 30.0, pin.Inertia.FromSphere(1.0, 0.04)
    scene = pc.Scene(one_body(pin.JointModelTranslation(), inertia, "ball"))
    ball = scene.add_contour("ball", pc.Sphere(radius), "ball")
    facing = pin.SE3(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.zeros(3))
    shapes = {
        "top": (pc.Plane(domain=((-1.0, 1.0), (0.0, 1.0))), pin.SE3.Identity()),
        "edge": (pc.Line((-1.0, 1.0)), pin.SE3.Identity()),
        "side": (pc.Plane(domain=((-1.0, 1.0), (-0.2, 0.0))), facing),
    }
    for name, (shape, placement) in shapes.items():
        pair = ball, scene.add_contour(name, shape, placement=placement)
        scene.add_contact(name, *(pair[::-1] if faces_first else pair))
    start = scene.initial_state([0.0, 0.01, radius], [0.0, -0.05, 0.0], free=["edge", "side"])

    def wind(t, q, v):
        """Towards the face, once the ball is all but beside it."""
        return np.array([0.0, force / (1.0 + math.exp((q[1] + 0.034) / 0.0012)), 0.0])

    run = pc.simulate(scene, start, 0.55, control=wind, **METHODS[method])
    assert run.status == 0, run.message
    assert [event.contact for event in run.events if event.kind == "touch"] == ["edge", "side"]
    y, z = run.q[:, 1:].T
    beside = (z < 0.0) & (z > -0.2) & (y < 0.0)
    assert beside.any()
    # what a step of time stepping goes round the edge; event-driven runs leave next to nothing
    assert (y[beside] < -radius + 1e-5).all()


@pytest.mark.parametrize("in_space", [False, True])
@pytest.mark.parametrize("seed", [0, 3])
def test_the_order_of_naming_does_not_matter(seed, in_space, monkeypatch):
    make, add = track(seed, in_space), pc.Scene.add_contact
    ends = []
    for pieces_first in (False, True):

        def add_either_way(scene, name, *rest, pieces_first=pieces_first, **options):
            pair, options["side"] = rest[:2], None
            return add(scene, name, *(pair[::-1] if pieces_first else pair), *rest[2:], **options)

        monkeypatch.setattr(pc.Scene, "add_contact", add_either_way)
        scene, start = make(False)
        run = pc.simulate(scene, start, 1.2)
        assert run.status == 0, run.message
        ends.append(run.q[-1])
        # what has ends is body 2
        assert all(one.body1.name == "shape" and one.swapped == pieces_first for one in scene.contacts.values())
    np.testing.assert_array_equal(*ends)


def hill(side=None):
    """A line up to a kink, and one down: from below, the wheel is under what the second would go on as."""
    scene, slope = pc.Scene(wheel(0.1)), 0.5
    scene.add_contour("rim", pc.Circle(0.1), "body", placement=pin.SE3(UPRIGHT, np.zeros(3)))
    for name, ends, angle in (("up", (-2.0, 0.0), slope), ("down", (0.0, 2.0), -slope)):
        scene.add_contour(name, pc.Line(ends), placement=pin.SE3(along(angle), np.zeros(3)))
        scene.add_contact(name, "rim", name, pc.NoSlip(), side=side if name == "down" else None)
    at, speed = -0.6 * along(slope)[:, 0] + 0.1 * along(slope)[:, 1], 3.5
    v = speed * along(slope)[:, 0]
    return scene, scene.initial_state([at[0], at[2], 0.0], [v[0], v[2], speed / 0.1], free=["down"])


@pytest.mark.parametrize("method", METHODS)
def test_a_wheel_over_a_hill_lands_behind_it(method):
    """Its side is that of its flight, not that of its start, and a run from any state of the first goes on alike."""
    scene, start = hill()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hill()
    assert start.discrete[1, SIDE] == 1 and start.discrete[1, BESIDE] == 1
    run, told = (pc.simulate(one, state, 1.0, **METHODS[method]) for one, state in ((scene, start), hill(-1)))
    assert [(e.contact, e.kind) for e in run.events] == [(e.contact, e.kind) for e in told.events]
    assert ("down", "touch") in [(e.contact, e.kind) for e in run.events]
    assert run.q[-1] == pytest.approx(told.q[-1], abs=1e-6)
    end = run.state(-1).discrete[1]
    # it has gone over the other end
    assert (end[SIDE], end[BESIDE]) == (-1, 1)
    for i in (0, len(run.t) // 4, len(run.t) // 2):
        rest = pc.simulate(scene, run.state(i), 1.0 - run.t[i], **METHODS[method])
        assert rest.q[-1] == pytest.approx(run.q[-1], abs=1e-6)


def test_steppers_and_rollouts_tell_sides():
    scene, start = hill()
    stepper, (other, other_start) = pc.Stepper(scene, start, dt=2e-3), hill(-1)
    told = pc.Stepper(other, other_start, dt=2e-3)
    rows = np.zeros((500, 3))
    q, _ = stepper.rollout(rows, 1)
    expected, _ = told.rollout(rows, 1)
    assert q == pytest.approx(expected, abs=1e-9)
    # once more from the start, whose side is another one
    stepper.reset(start)
    stepper.step(np.zeros(3), 200)
    half = stepper.state
    assert stepper.step(np.zeros(3), 300).q == pytest.approx(q[-1], abs=1e-12)
    stepper.reset(half)
    assert stepper.step(np.zeros(3), 300).q == pytest.approx(q[-1], abs=1e-9)
    many, _, status = pc.rollout(scene, [start, half], np.zeros((2, 300, 3)), dt=2e-3)
    assert not status.any() and many[0] == pytest.approx(q[:300], abs=1e-12)
    assert many[1, -1] == pytest.approx(q[-1], abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_given_sides_stay(method):
    """Also that on which the wheel is not: it falls through."""
    scene, start = hill(1)
    run = pc.simulate(scene, start, 1.0, **METHODS[method])
    assert ("down", "touch") not in [(e.contact, e.kind) for e in run.events]
    assert (run.state(-1).discrete[1, SIDE], run.status) == (1, 0)


def test_what_was_over_a_piece_keeps_its_side():
    """A ball that has rolled over a table's end and comes back under it is behind it, as with a side that was given."""
    ends = []
    for side in (None, 1):
        model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.004 * np.eye(3)))
        model.gravity.linear = np.zeros(3)
        scene = pc.Scene(model)
        scene.add_contour("ball", pc.Sphere(0.1), "body")
        scene.add_contour("table", pc.Plane(((0.0, 1.0), WIDE)))
        scene.add_contact("c", "ball", "table", side=side)
        start = scene.initial_state([-0.3, 0, 0.15, 0, 0, 0, 1], [2.0, 0, 0, 0, 0, 0], free=["c"])

        def control(t, q, v):
            return np.r_[-8.0, 0.0, -1.5 if t < 0.7 else 4.0, 0.0, 0.0, 0.0]

        run = pc.simulate(scene, start, 1.5, method="Moreau", dt=1e-3, control=control)
        assert run.status == 0, run.message
        ends.append(run.q[-1])
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


def test_files_without_the_last_column_are_read(tmp_path):
    scene, start = hill()
    run = pc.simulate(scene, start, 0.1)
    file = run.save(tmp_path / "run.npz")
    with np.load(file) as stored:
        arrays = dict(stored)
    arrays["discrete"] = arrays["discrete"][:, :, :BESIDE]
    np.savez(file, **arrays)
    state = pc.Trajectory.load(file, scene).state(-1)
    assert (state.discrete[:, BESIDE] == 0).all()
    assert pc.simulate(scene, state, 0.1).status == 0


@pytest.mark.parametrize("options", [{}, {"method": "Moreau", "dt": 1e-3}], ids=["events", "steps"])
@pytest.mark.parametrize("start", [(0.7, 0.5, 2.5, 0.0), (0.5, 0.21, 2.5, 1.0), (0.3, 0.15, 3.5, 1.2)])
def test_a_body_that_has_gone_round_an_end_meets_the_other_side(start, options):
    """A disk that a spring draws over a saw tooth and back comes to rest at the tooth's face, which it starts behind:
    it went through it, as it was behind it once."""
    radius, model, joint = 0.05, pin.Model(), 0
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    scene.add_contour("disk", pc.Circle(radius), "body", placement=pin.SE3(UPRIGHT, np.zeros(3)))
    corners = {"ramp": ((1.0, 0.3), (0.0, 0.0)), "face": ((1.0, 0.0), (1.0, 0.3)), "floor": ((3.0, 0.0), (1.0, 0.0))}
    for name, ((x, z), (x2, z2)) in corners.items():
        place = pin.SE3(along(math.atan2(z2 - z, x2 - x)), np.array([x, 0.0, z]))
        scene.add_contour(name, pc.Line((0.0, math.hypot(x2 - x, z2 - z))), placement=place)
        scene.add_contact(name, "disk", name)
    scene.add_contour("tip", pc.Point(), placement=pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.3])))
    scene.add_contact("tip", "disk", "tip")
    x, z, *v = start
    state = scene.initial_state([x, z], v, free=list(scene.contacts))
    run = pc.simulate(
        scene, state, 3.0, control=lambda t, q, v: np.array([4.0 * (0.5 - q[0]) - 0.3 * v[0], 0.0]), **options
    )
    assert run.status == 0, run.message
    inside = (run.q[:, 0] > 0.0) & (run.q[:, 0] < 1.0) & (run.q[:, 1] > 0.0) & (run.q[:, 1] < 0.3 * run.q[:, 0])
    assert not inside.any()
    np.testing.assert_allclose(run.q[-1], [1.0 + radius, radius], atol=1e-6)


def test_a_point_may_start_behind_some_faces_of_a_body():
    """A point that falls onto a block of lines is behind its other faces, which was refused."""
    model, half = pin.Model(), 0.1
    joint = 0
    for name, kind in (("x", pin.JointModelPX()), ("y", pin.JointModelPY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(0.1, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    model.gravity = pin.Motion(np.array([0.0, -9.81, 0.0]), np.zeros(3))
    for side in (None, 1):
        scene = pc.Scene(model)
        scene.add_contour("point", pc.Point(), "body")
        for k in range(4):
            turn = pin.utils.rotate("z", 0.5 * k * math.pi)
            placement = pin.SE3(turn, turn @ np.array([0.0, -half, 0.0]))
            scene.add_contour(f"face {k}", pc.Line((-half, half)), placement=placement)
            scene.add_contact(f"face {k}", "point", f"face {k}", side=side)
        state = scene.initial_state([0.03, 0.3], np.zeros(2), free=list(scene.contacts))
        run = pc.simulate(scene, state, 0.5)
        assert run.status == 0, run.message
        assert [(event.contact, event.kind) for event in run.events] == [("face 2", "touch")]
        assert abs(run.events[0].time - math.sqrt(2.0 * 0.2 / 9.81)) < 1e-9
        np.testing.assert_allclose(run.q[-1], [0.03, half], atol=1e-9)


@pytest.mark.parametrize("wheel_first", [True, False])
def test_a_wheel_flies_in_over_the_end_of_a_moving_wave(wheel_first):
    """While it is beside the end the moving curve is looked at again and again, and steps still go on."""
    model, radius, level = wheel(0.1), 0.1, 0.05
    scene = pc.Scene(model)
    wave = pc.ParametricCurve(lambda u, t: (u, level * math.sin(8.0 * t), 0.0 * u), domain=(-1.0, 1.0))
    contours = [
        scene.add_contour("wheel", pc.Circle(radius), frame="body", placement=pin.SE3(UPRIGHT, np.zeros(3))),
        scene.add_contour("wave", wave, placement=pin.SE3(UPRIGHT, np.zeros(3))),
    ]
    scene.add_contact("touch", *(contours if wheel_first else contours[::-1]))
    height, speed = 0.6, 2.0
    start = scene.initial_state([-1.5, height, 0.0], [speed, 0.0, 0.0], free=["touch"])
    run = pc.simulate(scene, start, 0.4, max_steps=500)
    assert run.status == 0
    times = np.linspace(0.0, 0.4, 400_001)
    fall = times[height - 0.5 * 9.81 * times**2 - radius < level * np.sin(8.0 * times)]
    assert [event.kind for event in run.events] == ["touch"]
    # the grid of the closed form
    assert run.events[0].time == pytest.approx(fall[0], abs=2e-6)
