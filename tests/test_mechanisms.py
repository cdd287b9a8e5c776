"""Several contacts at once, redundant ones among them: gears, an axle, a ball between plates, with motions known in
closed form."""

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pincontact as pc

TIGHT = {"rtol": 1e-11, "atol": 1e-13}


def add_body(model, parent, joint, placement, name, mass, inertia):
    index = model.addJoint(parent, joint, placement, name)
    model.appendBodyToJoint(index, pin.Inertia(mass, np.zeros(3), np.diag(inertia)), pin.SE3.Identity())
    model.addBodyFrame(name, index, pin.SE3.Identity(), 0)
    return index


def assert_sound(run):
    assert run.status == 0, run.message
    assert max(values.max() for values in run.residuals().values()) <= 1e-12


def test_epicyclic_gear():
    """A sun with a torque drives a planet inside a fixed ring: the planet's centre goes at half the speed of the sun's
    rim. The radial constraint is doubled: forces between sun and planet are known up to a preload."""
    sun, planet, torque = 0.2, 0.1, 0.7
    mass, spin, inertia = 0.3, 0.002, 0.05
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    add_body(model, 0, pin.JointModelRZ(), pin.SE3.Identity(), "sun", 1.0, (1.0, 1.0, inertia))
    add_body(model, 0, pin.JointModelPlanar(), pin.SE3.Identity(), "planet", mass, (1.0, 1.0, spin))
    scene = pc.Scene(model)
    inner, rolling = (
        scene.add_contour("inner", pc.Circle(sun), "sun"),
        scene.add_contour("p", pc.Circle(planet), "planet"),
    )
    outer = scene.add_contour("outer", pc.Circle(sun + 2.0 * planet))
    scene.add_contact("sun", rolling, inner, friction=pc.NoSlip(), bilateral=True)
    scene.add_contact("ring", rolling, outer, friction=pc.NoSlip(), bilateral=True)
    assert {contact.pattern.name for contact in scene.contacts.values()} == {"2C-2C"}
    orbit = sun + planet
    state = scene.initial_state(np.array([0.0, orbit, 0.0, 1.0, 0.0]), np.zeros(4))
    times = np.linspace(0.0, 2.0, 21)
    run = pc.simulate(
        scene, state, 2.0, control=lambda t, q, v: np.array([torque, 0.0, 0.0, 0.0]), t_eval=times, **TIGHT
    )
    assert_sound(run)
    effective = inertia + 0.25 * mass * sun**2 + 0.25 * spin * (sun / planet) ** 2
    rate = torque / effective * times
    np.testing.assert_allclose(run.v[:, 0], rate, rtol=0.0, atol=1e-9)
    around = 0.25 * torque / effective * times**2 * sun / orbit
    expected = orbit * np.column_stack([np.cos(around), np.sin(around)])
    assert np.abs(run.q[:, 1:3] - expected).max() <= 1e-9
    np.testing.assert_allclose(run.v[:, 3], -0.5 * rate * sun / planet, rtol=0.0, atol=1e-8)
    centripetal = mass * (0.5 * rate * sun) ** 2 / orbit
    difference = run.contacts["ring"].normal_force - run.contacts["sun"].normal_force
    np.testing.assert_allclose(difference, centripetal, rtol=0.0, atol=1e-8)
    # what the teeth carry: the planet's centre is driven from both sides
    on_sun = run.contacts["sun"].tangential_force
    np.testing.assert_allclose(on_sun, (torque - inertia * torque / effective) / sun, rtol=0.0, atol=1e-9)


def test_ball_between_plates():
    """The upper plate moves, the ball between them goes at half its speed. The vertical constraint is doubled, spin
    about the vertical is free."""
    radius, mass, speed = 0.1, 0.4, 0.9
    model = pin.Model()
    moment = 0.4 * mass * radius**2
    add_body(model, 0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball", mass, (moment, moment, moment))
    scene = pc.Scene(model)
    ball = scene.add_contour("ball", pc.Sphere(radius), "ball", pin.SE3(pin.utils.rotate("x", 0.7), np.zeros(3)))
    floor = scene.add_contour("floor", pc.Plane())
    above = pin.SE3(pin.utils.rotate("x", math.pi), np.array([0.0, 0.0, 2.0 * radius]))
    belt = scene.add_contour("belt", pc.Plane(), placement=above, motion=pc.ConstantTwist(linear=(speed, 0.0, 0.0)))
    for plate in (floor, belt):
        scene.add_contact(plate.name, ball, plate, friction=pc.NoSlip(), bilateral=True)
    q = np.array([0.0, 0.0, radius, 0.0, 0.0, 0.0, 1.0])
    spin = 3.0
    v = np.array([0.5 * speed, 0.0, 0.0, 0.0, 0.5 * speed / radius, spin])
    state = scene.initial_state(q, v)
    assert state.correction.dv <= 1e-13
    times = np.linspace(0.0, 3.0, 16)
    run = pc.simulate(scene, state, 3.0, t_eval=times, **TIGHT)
    assert_sound(run)
    expected = np.column_stack([0.5 * speed * times, np.zeros_like(times), np.full_like(times, radius)])
    assert np.abs(run.q[:, :3] - expected).max() <= 1e-10
    for q, v in zip(run.q, run.v):
        omega = pin.Quaternion(q[3:]).matrix() @ v[3:]
        np.testing.assert_allclose(omega, [0.0, 0.5 * speed / radius, spin], rtol=0.0, atol=1e-9)
    total = run.contacts["floor"].force + run.contacts["belt"].force
    np.testing.assert_allclose(total, np.tile([0.0, 0.0, -9.81 * mass], (times.size, 1)), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("friction", [pc.NoSlip(), pc.Coulomb(0.9)], ids=["no slip", "Coulomb"])
def test_axle_with_two_wheels_goes_in_a_circle(friction):
    """Two wheels on one axle at different speeds: a circle at constant speed. The sideways constraint is doubled."""
    radius, track, mass, wheel = 0.25, 0.8, 1.5, 0.4
    rim_inertia = (0.25 * wheel * radius**2, 0.5 * wheel * radius**2, 0.25 * wheel * radius**2)
    model = pin.Model()
    axle = add_body(model, 0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "axle", mass, (0.05, 0.002, 0.05))
    scene_wheels = []
    for name, y in (("left", 0.5 * track), ("right", -0.5 * track)):
        place = pin.SE3(np.eye(3), np.array([0.0, y, 0.0]))
        add_body(model, axle, pin.JointModelRY(), place, name, wheel, rim_inertia)
        scene_wheels.append(name)
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    for name in scene_wheels:
        rim = scene.add_contour(name, pc.Circle(radius), name, upright)
        scene.add_contact(name, rim, floor, friction=friction)
    left, right = 6.0, 9.0  # rates about +y roll towards +x
    forward, turning = 0.5 * radius * (left + right), radius * (right - left) / track
    q = np.array([0.0, 0.0, radius, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    v = np.array([forward, 0.0, 0.0, 0.0, 0.0, turning, left, right])
    state = scene.initial_state(q, v)
    assert state.correction.dv <= 1e-12
    times = np.linspace(0.0, 4.0, 21)
    run = pc.simulate(scene, state, 4.0, t_eval=times, **TIGHT)
    assert_sound(run)
    assert run.events == []
    circle = forward / turning
    expected = circle * np.column_stack([np.sin(turning * times), 1.0 - np.cos(turning * times)])
    assert np.abs(run.q[:, :2] - expected).max() <= 1e-9
    np.testing.assert_allclose(run.v[:, 6:], np.tile([left, right], (times.size, 1)), rtol=0.0, atol=1e-9)
    # both wheels together carry the weight and bend the path
    total = run.contacts["left"].force + run.contacts["right"].force
    whole = mass + 2.0 * wheel
    np.testing.assert_allclose(total[:, 2], -9.81 * whole, rtol=1e-10)
    np.testing.assert_allclose(np.hypot(total[:, 0], total[:, 1]), whole * forward * turning, rtol=1e-9)


def test_disk_on_a_rolling_disk():
    """Planar: a small disk rolls off a larger one that rolls on the ground itself. Energy, the ground's impulse, and
    the first accelerations in closed form."""
    big, small = 0.5, 0.2
    masses = {"big": 2.0, "small": 0.5}
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    for name, radius in (("big", big), ("small", small)):
        moment = 0.5 * masses[name] * radius**2
        add_body(model, 0, pin.JointModelPlanar(), pin.SE3.Identity(), name, masses[name], (1.0, 1.0, moment))
    scene = pc.Scene(model)
    wheel, roller = (
        scene.add_contour("wheel", pc.Circle(big), "big"),
        scene.add_contour("roller", pc.Circle(small), "small"),
    )
    ground = scene.add_contour("ground", pc.Line())
    scene.add_contact("ground", wheel, ground, friction=pc.NoSlip())
    scene.add_contact("pair", roller, wheel, friction=pc.NoSlip())
    lean = 0.3
    position = np.array([(big + small) * math.sin(lean), big + (big + small) * math.cos(lean)])
    q = np.array([0.0, big, 1.0, 0.0, *position, 1.0, 0.0])
    state = scene.initial_state(q, np.zeros(6))
    times = np.linspace(0.0, 0.35, 15)
    run = pc.simulate(scene, state, 0.35, t_eval=times, **TIGHT)
    assert_sound(run)
    assert run.events == []
    energy = run.energies().total
    assert np.abs(energy - energy[0]).max() <= 1e-9
    world = [[q[i + 2] * v[j] - q[i + 3] * v[j + 1] for q, v in zip(run.q, run.v)] for i, j in ((0, 0), (4, 3))]
    momentum = masses["big"] * np.array(world[0]) + masses["small"] * np.array(world[1])
    # Newton's law for both together: the ground's tangential force, integrated by Simpson's rule
    force = -run.contacts["ground"].force[:, 0]
    h = times[1] - times[0]
    impulse = h / 3.0 * (force[0] + force[-1] + 4.0 * force[1:-1:2].sum() + 2.0 * force[2:-1:2].sum())
    assert momentum[-1] == pytest.approx(impulse, rel=1e-4)
    along, turning = first_accelerations(big, small, masses["big"], masses["small"], lean)
    early = pc.simulate(scene, state, 1e-3, **TIGHT)
    assert early.v[-1, 0] == pytest.approx(1e-3 * along, rel=1e-4)
    angle = math.atan2(early.q[-1, 4] - early.q[-1, 0], early.q[-1, 5] - early.q[-1, 1])
    assert angle - lean == pytest.approx(0.5e-6 * turning, rel=1e-3)


def first_accelerations(big, small, heavy, light, lean):
    """(x'', a'') at rest: Lagrange's equations of the two rolling disks in the wheel's centre x and the angle a."""
    distance = big + small
    # clockwise spins: x' / R of the wheel; of the small disk such that both surfaces move alike where they touch
    spin_x, spin_a = -1.0 / small, distance / small
    inertia_big, inertia_small = 0.5 * heavy * big**2, 0.5 * light * small**2
    c, s = math.cos(lean), math.sin(lean)
    matrix = np.array(
        [
            [
                heavy + light + inertia_big / big**2 + inertia_small * spin_x**2,
                light * distance * c + inertia_small * spin_x * spin_a,
            ],
            [light * distance * c + inertia_small * spin_x * spin_a, light * distance**2 + inertia_small * spin_a**2],
        ]
    )
    return np.linalg.solve(matrix, [0.0, light * 9.81 * distance * s])


@pytest.mark.parametrize("bilateral", [True, False])
@pytest.mark.parametrize("friction", [pc.Coulomb(0.5), pc.Coulomb(0.5, rolling=0.01), pc.Stribeck(0.3, 0.6, 0.1)])
def test_what_no_joint_moves_carries_no_load(friction, bilateral):
    """A pinion on a rack: bearings and rails carry all that is along the normal of their contact, of which nothing is
    known. So the contact has no friction, in any method, and the pinion turns alone."""
    radius, torque, inertia = 0.1, 1.0, 0.02
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    raised = pin.SE3(np.eye(3), np.array([0.0, radius, 0.0]))
    add_body(model, 0, pin.JointModelRZ(), raised, "pinion", 1.0, (0.01, 0.01, inertia))
    add_body(model, 0, pin.JointModelPX(), pin.SE3.Identity(), "rack", 2.0, (1.0, 1.0, 1.0))
    scene = pc.Scene(model)
    wheel, rack = scene.add_contour("wheel", pc.Circle(radius), "pinion"), scene.add_contour("rack", pc.Line(), "rack")
    scene.add_contact("teeth", wheel, rack, friction, bilateral=bilateral, side=-1)
    state = scene.initial_state([0.0, 0.0])
    for options in ({}, {"method": "Moreau", "dt": 1e-3}):
        run = pc.simulate(scene, state, 0.5, control=lambda t, q, v: np.array([torque, 0.0]), **options)
        assert run.status == 0, run.message
        np.testing.assert_allclose(run.q[-1], [0.125 * torque / inertia, 0.0], rtol=0.0, atol=1e-9)
        assert not run.contacts["teeth"].force.any()
    if isinstance(friction, pc.Coulomb) and friction.rolling:
        return
    # the rack has to be driven by itself
    found = pc.inverse_dynamics(scene, state, [10.0, 1.0], cones=True)
    np.testing.assert_allclose(found.tau, [10.0 * inertia, 2.0], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("friction", [pc.NoSlip(), None])
@pytest.mark.parametrize("off", [1e-13, 1e-9, 1e-7])
def test_a_velocity_is_not_lost_to_what_is_next_to_nothing(off, friction):
    """Two friction wheels, of which one turns about a point a little beside its centre, cannot turn at all, as rigid
    bodies that cannot part. Whoever gives them a velocity is told."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    add_body(model, 0, pin.JointModelRZ(), pin.SE3.Identity(), "first", 1.0, (0.01, 0.01, 0.01))
    add_body(
        model, 0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([0.25, 0.0, 0.0])), "second", 1.0, (0.01, 0.01, 0.02)
    )
    scene = pc.Scene(model)
    beside = pin.SE3(np.eye(3), np.array([0.0, off, 0.0]))
    wheels = scene.add_contour("a", pc.Circle(0.1), "first", beside), scene.add_contour("b", pc.Circle(0.15), "second")
    scene.add_contact("wheels", *wheels, friction, bilateral=True)
    with pytest.raises(pc.StateError, match=r"meets the constraints up to .* 'wheels' are next to redundant"):
        scene.initial_state([0.0, 0.0], [5.0, -10.0 / 3.0])
    assert scene.initial_state([0.0, 0.0]).correction.dv == 0.0


def test_a_start_at_rest_on_what_moves():
    """Where there is no velocity none is lost, whatever rounding makes of the table's."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        world = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        model = pin.Model()
        add_body(model, 0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball", 1.0, (0.01, 0.01, 0.01))
        scene = pc.Scene(model)
        table = scene.add_contour("table", pc.Plane(), placement=world, motion=pc.ConstantTwist(linear=(1.0, 0.0, 0.0)))
        scene.add_contact("c", scene.add_contour("ball", pc.Sphere(0.1), "ball"), table, pc.Coulomb(0.3))
        place = world * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
        assert np.abs(scene.initial_state(pin.SE3ToXYZQUAT(place), np.zeros(6)).v).max() < 1e-15


def test_what_a_lock_takes_is_not_lost():
    """A wheel that must not slip, on a locked slider, is given the velocity of rolling: it stands still, as it has to.
    Nor is what a corrected configuration takes."""
    model = pin.Model()
    slider = add_body(model, 0, pin.JointModelPX(), pin.SE3.Identity(), "slider", 1.0, (0.01, 0.01, 0.01))
    axis = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    add_body(model, slider, pin.JointModelRY(), axis, "wheel", 1.0, (0.01, 0.01, 0.01))
    model.lowerPositionLimit[0] = model.upperPositionLimit[0] = 0.0
    scene = pc.Scene(model)
    wheel, floor = scene.add_contour("wheel", pc.Sphere(0.1), "wheel"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", wheel, floor, pc.NoSlip(), bilateral=True)
    assert not scene.initial_state([0.0, 0.0], [1.0, 10.0]).v.any()

    # a bead 1 cm off its parabola has the velocity along the tangent beside it
    model = pin.Model()
    add_body(model, 0, pin.JointModelTranslation(), pin.SE3.Identity(), "tip", 1.0, (0.01, 0.01, 0.01))
    scene = pc.Scene(model)
    wire = scene.add_contour("wire", pc.ParametricCurve(lambda u: (u, 0.5 * u * u, 0.0), domain=(-2.0, 2.0)))
    scene.add_contact("c", scene.add_contour("tip", pc.Point(), "tip"), wire, bilateral=True)
    state = scene.initial_state([0.5, 0.135, 0.0], [1.0, 0.5, 0.0], max_gap=0.1)
    np.testing.assert_allclose(state.v[1] / state.v[0], state.q[0], rtol=0.0, atol=1e-12)


def bar_in_slots(angle, between, mu, turns, centre, moment):
    """A bar of 1 m and 1 kg whose ends slide in two slots, at this angle to each other, with friction; and its angular
    acceleration at (angle, rate) by Newton and Euler's equations, of all signs of the two loads."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "bar")
    inertia = pin.Inertia(1.0, np.array([*centre, 0.0]), np.diag([0.05, 0.05, moment]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    scene = pc.Scene(model)
    for i in range(2):
        place = pin.SE3(np.eye(3), np.array([i - 0.5, 0.0, 0.0]))
        model.addFrame(pin.Frame(f"end {i}", joint, place, pin.FrameType.OP_FRAME))
        turned = pin.SE3(pin.utils.rotate("z", between * i), np.zeros(3))
        slot = scene.add_contour(f"slot {i}", pc.Line(), placement=turned)
        end = scene.add_contour(f"end {i}", pc.Point(), f"end {i}")
        scene.add_contact(f"c{i}", slot, end, friction=pc.Coulomb(mu[i]), bilateral=True)
    away = 1.0 / math.tan(between)
    along = np.array([[1.0, 0.0], [math.cos(between), math.sin(between)]])

    def middle(theta):
        c, s = math.cos(theta), math.sin(theta)
        return [np.array(p) for p in ((away * s - 0.5 * c, 0.5 * s), (away * c + 0.5 * s, 0.5 * c))]

    def accelerations(theta, rate):
        c, s = math.cos(theta), math.sin(theta)
        rotation, turning = np.array([[c, -s], [s, c]]), np.array([[-s, -c], [c, -s]])
        place, step = middle(theta)
        found = []
        for signs in itertools.product((1.0, -1.0), repeat=2):
            matrix, right = np.zeros((3, 3)), np.zeros(3)
            matrix[:2, 2], matrix[2, 2] = step + turning @ centre, moment
            right[:2] = (place + rotation @ centre) * rate**2 - [0.0, 9.81]
            for i, (t, end) in enumerate(zip(along, ([-0.5, 0.0], [0.5, 0.0]))):
                slip = t @ (step + turning @ end) * rate
                force = np.array([-t[1], t[0]]) - mu[i] * signs[i] * np.sign(slip) * t
                lever = rotation @ (np.array(end) - centre)
                matrix[:2, i], matrix[2, i] = -force, lever[1] * force[0] - lever[0] * force[1]
            x = np.linalg.solve(matrix, right)
            if (x[:2] * signs >= 0.0).all():
                found.append(x)
        return found

    place, step = middle(angle)
    c, s = math.cos(angle), math.sin(angle)
    state = scene.initial_state([*place, c, s], [*(np.array([[c, s], [-s, c]]) @ step * turns), turns])
    return scene, state, accelerations


# in the course of these a diagonal element of the operator with friction is zero, its determinant positive
@pytest.mark.parametrize(
    "bar",
    [
        (2.477, 1.774, (0.12, 0.99), 4.65, (0.08, -0.05), 0.023),
        (2.492, 2.307, (0.96, 0.89), -5.59, (0.22, -0.04), 0.068),
    ],
)
def test_bars_in_slots_with_friction(bar):
    scene, state, accelerations = bar_in_slots(*bar)

    def rate(t, y):
        (x,) = accelerations(*y)
        return [y[1], x[2]]

    exact = solve_ivp(rate, (0.0, 0.1), [bar[0], bar[3]], rtol=1e-11, atol=1e-12).y[:, -1]
    (x,) = accelerations(*exact)
    for options, accuracy in (({}, 1e-7), ({"method": "Moreau", "dt": 1e-4}, 1e-5)):
        run = pc.simulate(scene, state, 0.1, **options)
        assert run.status == 0, run.message
        np.testing.assert_allclose(
            [run.q[-1, 2], run.q[-1, 3]], [math.cos(exact[0]), math.sin(exact[0])], atol=accuracy
        )
        loads = [run.contacts[f"c{i}"].normal_force for i in range(2)]
        assert np.isfinite(loads).all()
        # the forces on the ends are along the slots' normals, those of the package on the other side
        np.testing.assert_allclose([load[-1] for load in loads], -x[:2], rtol=1e3 * accuracy)
