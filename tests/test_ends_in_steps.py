"""Time stepping and the ends of contours: where bodies run over them, beside them and into them, both kinds of methods
tell the same."""

import math

import numpy as np
import pinocchio as pin
import pytest
from shared import one_body

import pincontact as pc

GRAVITY = 9.81
LIFT = 12.0
IDENTITY = [0.0, 0.0, 0.0, 1.0]


def free_body(name, mass=1.0, inertia=(0.004, 0.004, 0.004)):
    return one_body(pin.JointModelFreeFlyer(), pin.Inertia(mass, np.zeros(3), np.diag(inertia)), name)


def ball_scene(table, radius=0.1, mu=0.5, restitution=0.0, placement=None):
    scene = pc.Scene(free_body("ball", 1.0, (0.4 * radius**2,) * 3))
    ball = scene.add_contour("ball", pc.Sphere(radius), "ball")
    scene.add_contact(
        "c", ball, scene.add_contour("table", table, placement=placement), pc.Coulomb(mu), restitution=restitution
    )
    return scene


def bead_scene(wire, placement=None, friction=None):
    scene = pc.Scene(one_body(pin.JointModelTranslation(), pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), "bead"))
    bead = scene.add_contour("bead", pc.Point(), "bead")
    scene.add_contact(
        "c", bead, scene.add_contour("wire", wire, placement=placement), bilateral=True, friction=friction
    )
    return scene


def stepped(scene, start, duration, step):
    return pc.simulate(scene, start, duration, method="Moreau", step=step)


def test_ball_rolls_off_a_table():
    scene = ball_scene(pc.Plane(((-0.5, 0.5), (-0.5, 0.5))))
    start = scene.initial_state([0, 0, 0.1, *IDENTITY], [1.0, 0, 0, 0, 10.0, 0])
    errors = []
    # the end falls inside a step
    for step in (3e-3, 1.5e-3, 0.75e-3):
        run = stepped(scene, start, 1.0, step)
        assert run.status == 0, run.message
        assert [(event.kind, event.contact) for event in run.events] == [("edge", "c")]
        assert run.events[0].time == pytest.approx(0.5, abs=1e-9)
        assert run.contacts["c"].mode[-1] == -1
        errors.append(abs(run.q[-1, 2] - (0.1 - 0.5 * GRAVITY * 0.5**2)))
    # it is held to the end of the step in which it leaves: g h times the time of fall
    assert all(error < GRAVITY * 0.5 * step for error, step in zip(errors, (3e-3, 1.5e-3, 0.75e-3)))


def test_ball_thrown_past_a_table_lands_on_nothing():
    scene = ball_scene(pc.Plane(((-0.5, 0.5), (-0.5, 0.5))))
    start = scene.initial_state([0.4, 0, 0.4, *IDENTITY], [2.0, 0, 0, 0, 0, 0], free=["c"])
    run = stepped(scene, start, 1.0, 1e-3)
    assert (run.status, run.events) == (0, [])
    assert run.q[-1, 2] == pytest.approx(0.4 - 0.5 * GRAVITY, abs=1e-9)


def test_ball_comes_back_under_a_table():
    """What has fallen beside a table and moves under it has not touched it: nothing lifts it through the top."""
    scene = ball_scene(pc.Plane(((-0.5, 0.5), (-0.5, 0.5))))
    scene.model.gravity.linear = np.zeros(3)
    start = scene.initial_state([0.45, 0, 0.4, *IDENTITY], [2.0, 0, -2.0, 0, 0, 0], free=["c"])
    push = np.array([-20.0, 0, 0, 0, 0, 0])

    def control(t, q, v):
        # back under the table, and up, until the ball would have to pass through it
        return push + np.array([0, 0, LIFT if t > 0.3 else 0.0, 0, 0, 0])

    run = pc.simulate(scene, start, 0.8, method="Moreau", step=1e-3, control=control)
    assert run.status == 0, run.message
    assert run.events == []
    z = 0.4 - 2.0 * 0.8 + 0.5 * LIFT * 0.5**2
    # the step in which the force sets in
    assert run.q[-1, 2] == pytest.approx(z, abs=LIFT * 0.5 * 1e-3)
    # it has passed through the plane, from below, inside the table
    inside = np.abs(run.q[:, 0]) < 0.5
    assert run.q[inside, 2].min() < -0.2
    assert run.q[inside, 2].max() > 0.2


def test_bead_ends_with_its_wire():
    slope = pin.SE3(pin.utils.rotate("y", 0.5), np.zeros(3))
    scene = bead_scene(pc.Line((-0.4, 0.4)), slope)
    run = stepped(scene, scene.initial_state(np.zeros(3)), 2.0, 1e-3)
    assert run.status == -8, run.message
    assert "'c' reached the end of a contour" in run.message
    time = math.sqrt(2.0 * 0.4 / (GRAVITY * math.sin(0.5)))
    assert [(event.kind, event.contact) for event in run.events] == [("edge", "c")]
    # constant acceleration is exact in steps of second order
    assert run.t[-1] == run.events[0].time == pytest.approx(time, abs=1e-9)
    assert run.contacts["c"].location[-1] == pytest.approx(0.4, abs=1e-9)


def test_steppers_tell_ends():
    scene = ball_scene(pc.Plane(((-0.5, 0.5), (-0.5, 0.5))))
    stepper = pc.Stepper(scene, scene.initial_state([0, 0, 0.1, *IDENTITY], [1.0, 0, 0, 0, 10.0, 0]), dt=1e-3)
    stepper.step(np.zeros(6), 490)
    assert stepper.modes[0] == 1
    stepper.step(np.zeros(6), 20)
    assert stepper.modes[0] == -1
    scene = bead_scene(pc.Line((-0.4, 0.4)))
    stepper = pc.Stepper(scene, scene.initial_state(np.zeros(3), [1.0, 0.0, 0.0]), dt=1e-3)
    with pytest.raises(pc.SolverError, match="'c' reached the end of a contour"):
        stepper.step(np.zeros(3), 1000)
    # it is where the last step inside has ended
    assert stepper.q[0] == pytest.approx(0.4, abs=1e-3)
    assert stepper.q[0] <= 0.4 + 1e-12


@pytest.mark.parametrize("step", [0.25, 0.1])
def test_steps_that_leave_contacts_apart_are_told(step):
    """The rolling disk in steps in which it would fall through the floor by 1 to 2 cm."""
    scene = pc.Scene.from_urdf("urdf/disk.urdf", floating_base=True)
    rim = scene.add_contour("rim", pc.Circle(radius=0.3), frame="disk")
    scene.add_contact("rim/floor", rim, scene.add_contour("floor", pc.Plane()), friction=pc.Coulomb(mu=0.8))
    q, v = pin.neutral(scene.model), [0, 0, 0, 0, 0, 5.0]
    q[2], q[3:] = 0.2796, [0, 0.564642, 0, 0.825336]
    run = stepped(scene, scene.initial_state(q, v), 5.0, step)
    assert run.status == -9, run.message
    assert "'rim/floor'" in run.message
    assert "apart" in run.message
    assert np.abs(run.contacts["rim/floor"].gap).max() < 1e-9


def random_case(seed):
    """A scene with contours that end, its start, and how long to run."""
    rng = np.random.default_rng(seed)
    kind = ["table", "tilted", "cylinder", "wire", "cycloid", "drop"][seed % 6]
    speed, turn = rng.uniform(0.5, 2.0), rng.uniform(0.0, 2.0 * math.pi)
    along = np.array([math.cos(turn), math.sin(turn), 0.0])
    if kind in ("table", "tilted", "drop"):
        half = rng.uniform(0.2, 0.5, 2)
        place = pin.SE3(pin.utils.rotate("y", rng.uniform(-0.3, 0.3) if kind == "tilted" else 0.0), np.zeros(3))
        scene = ball_scene(
            pc.Plane(((-half[0], half[0]), (-half[1], half[1]))), mu=rng.uniform(0.1, 0.8), placement=place
        )
        height = 0.1 + (rng.uniform(0.02, 0.3) if kind == "drop" else 0.0)
        v = place.rotation @ (speed * along)
        state = scene.initial_state(
            [*place.act(np.array([0.0, 0.0, height])), *IDENTITY], [*v, 0, 0, 0], free=["c"] if kind == "drop" else []
        )
        return scene, state, 0.8
    if kind == "cylinder":
        # the ball rolls along the top of a barrel, and a little down its side
        half = rng.uniform(0.2, 0.4)
        scene = ball_scene(
            pc.Cylinder(0.5, (None, (-half, half))),
            mu=0.6,
            placement=pin.SE3(pin.utils.rotate("y", 0.5 * math.pi), np.zeros(3)),
        )
        return scene, scene.initial_state([0, 0, 0.6, *IDENTITY], [speed, 0.02, 0, 0, 10.0 * speed, 0]), 0.8
    if kind == "wire":
        place = pin.SE3(pin.utils.rotate("y", rng.uniform(-1.0, 1.0)) @ pin.utils.rotate("z", turn), np.zeros(3))
        friction = pc.Coulomb(rng.uniform(0.05, 0.2))
        scene = bead_scene(pc.Line((-rng.uniform(0.2, 0.5), rng.uniform(0.2, 0.5))), place, friction)
        return scene, scene.initial_state(np.zeros(3), place.rotation[:, 0] * speed), 2.0
    scene = bead_scene(pc.Cycloid(0.5))
    contour = pc.Cycloid(0.5)
    tangent = contour.evaluate([2.0])[1]
    return scene, scene.initial_state(contour.point([2.0]), -speed * tangent / np.linalg.norm(tangent)), 3.0


@pytest.mark.parametrize("seed", range(8))
def test_both_methods_tell_the_same_ends(seed):
    scene, start, duration = random_case(seed)
    # steps that no end and no touch fits into
    exact = pc.simulate(scene, start, duration, max_step=5e-3)
    edges = [event.time for event in exact.events if event.kind == "edge"]
    differences = []
    for step in (2e-3, 1e-3):
        run = stepped(scene, start, duration, step)
        assert run.status == exact.status, run.message
        times = [event.time for event in run.events if event.kind == "edge"]
        assert len(times) == len(edges)
        np.testing.assert_allclose(times, edges, rtol=0.0, atol=2.0 * step)
        differences.append(np.linalg.norm(run.q[-1, :3] - exact.q[-1, :3]))
    # a step's weight, for the rest of the time, and the time at which a run ends
    assert differences[-1] < 30.0 * 1e-3


def passer_by(seed):
    """A body in a random steady field that passes an end of a contour, from any side: scene, start, how long to run."""
    rng = np.random.default_rng(seed)
    kind = ["table", "field", "barrel", "wire", "arch", "field"][seed % 6]
    planar, radius = kind in ("wire", "arch"), rng.uniform(0.03, 0.1)
    half, wave, phase = rng.uniform(0.15, 0.4, 2), rng.uniform(2.0, 8.0, 2), rng.uniform(0.0, 6.0, 2)
    height = rng.uniform(0.01, 0.06)
    domain = ((-half[0], half[0]), (-half[1], half[1]))
    ground = {
        "table": lambda: pc.Plane(domain),
        "field": lambda: pc.HeightField(
            lambda x, y: height * math.sin(wave[0] * x + phase[0]) * math.cos(wave[1] * y + phase[1]), domain=domain
        ),
        "barrel": lambda: pc.Cylinder(half[0], (None, domain[1])),
        "wire": lambda: pc.Line(domain[0]),
        "arch": lambda: pc.ParametricCurve(lambda u: (u, height * math.sin(wave[0] * u + phase[0]), 0.0), domain[0]),
    }[kind]()
    balls = [pc.Circle(radius)] if planar else [pc.Sphere(radius), pc.Ellipsoid(radius, 0.8 * radius, 0.6 * radius)]
    shape = [pc.Point(), *balls][rng.integers(1 + len(balls))]
    if planar:
        model = one_body(pin.JointModelPlanar(), pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)))
    else:
        model = free_body("body", inertia=(0.01, 0.01, 0.01))
    scene = pc.Scene(model)
    scene.add_contour("shape", shape, "body")
    scene.add_contour("ground", ground)
    scene.add_contact("c", "shape", "ground", side=1 if isinstance(shape, pc.Point) or kind == "wire" else None)
    field, v = rng.normal(size=3), rng.normal(size=3) * rng.choice([0.5, 1.5])
    field *= rng.uniform(1.0, 10.0) / np.linalg.norm(field)
    # where it is near the end, and when
    near = np.array([rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 1.15), rng.uniform(-1.0, 1.0)]) * half
    off = rng.uniform(-0.1, 0.1) + (half[0] * rng.choice([1.0, 0.5, -0.5]) if kind == "barrel" else 0.0)
    place = np.array([near[0], off, 0.0] if planar else [*near, off])
    when, spin = rng.uniform(0.1, 0.5), rng.normal(size=3) * rng.choice([0.0, 2.0])
    if planar:
        field[2] = v[2] = 0.0
    model.gravity.linear = field
    place, v = place - v * when + 0.5 * field * when**2, v - field * when
    duration = when + rng.uniform(0.1, 0.5)
    if planar:
        return scene, scene.initial_state([*place[:2], 1.0, 0.0], [*v[:2], spin[0]], free=["c"], max_gap=10.0), duration
    turn = pin.exp3(rng.normal(size=3))
    q = [*place, *pin.Quaternion(turn).coeffs()]
    return scene, scene.initial_state(q, [*(turn.T @ v), *spin], free=["c"], max_gap=10.0), duration


@pytest.mark.parametrize("seed", [26, 101, 121, 157, 171, 235])
def test_what_gets_behind_a_contour_touches_it_as_in_exact_runs(seed):
    """From the side, from below and from above: what has got behind it beside its end does not touch it from there,
    also where its nearest points are looked for anew."""
    scene, start, duration = passer_by(seed)
    exact = pc.simulate(scene, start, duration, rtol=1e-10, atol=1e-12, max_step=2e-2)
    run = stepped(scene, start, duration, 1e-3)
    assert run.status == exact.status == 0, (run.message, exact.message)
    touched = [[event.time for event in r.events if event.kind == "touch"] for r in (run, exact)]
    assert len(touched[0]) == len(touched[1])
    np.testing.assert_allclose(*touched, rtol=0.0, atol=1e-3)
    # the step of an impact is of first order
    assert np.abs(run.q[-1] - exact.q[-1]).max() < 5e-3
