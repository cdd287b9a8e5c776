"""Resistance to spinning and rolling: closed forms in event-driven runs and in time stepping, and the two against
each other."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shared import kinds, one_body
from turning_ball import MASS, RADIUS, G, ball, on_the_floor

import pincontact as pc

BILATERAL = pytest.mark.parametrize("bilateral", [False, True], ids=["unilateral", "bilateral"])
TIGHT = {"rtol": 1e-10, "atol": 1e-12}
# what runs at these tolerances are off by: closed forms of low order, so the steps' errors are below the tolerance
ACCURATE = 1e-9


# ------------------------------------------------------------------------------------------------ between events


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
@pytest.mark.parametrize("seed", range(4))
def test_what_two_feet_keep_from_spinning_holds_at_both(seed, method):
    """A bar that slides and spins on two points, and rocks about the line through them: once both stick nothing spins,
    and resistance is of any size up to its limit."""
    rng = np.random.default_rng(seed)
    model, height = pin.Model(), rng.uniform(0.01, 0.03)
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "bar")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([0.002, 0.01, 0.01])), pin.SE3.Identity())
    model.addBodyFrame("bar", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for k, x in enumerate((0.1, -0.12)):
        foot = scene.add_contour(f"p{k}", pc.Point(), "bar", pin.SE3(np.eye(3), np.array([x, 0.0, -height])))
        law = pc.Coulomb(rng.uniform(0.3, 0.6), spinning=rng.uniform(0.002, 0.01))
        scene.add_contact(f"foot {k}", foot, floor, friction=law)
    rocks, spins, along, aside = rng.normal(size=4) * [1.0, 1.5, 0.1, 0.1]
    v = [along, rocks * height + aside, 0.0, rocks, 0.0, spins]
    run = pc.simulate(scene, scene.initial_state([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0], v), 0.12, method=method)
    assert run.status == 0, run.message
    for name, track in run.contacts.items():
        turning = [event.kind for event in run.events if event.contact == name and event.kind in ("turn", "hold")]
        assert track.mode[-1] == 1
        assert turning[-1:] == ["hold"], run.events


@pytest.mark.parametrize("seed", [28, 50, *range(4)])
def test_what_a_plate_that_lands_flat_does_not_roll_is_held(seed):
    """A plate rattles on four rolling feet until all are down: from then on it cannot roll, and resistance to it
    takes no energy."""
    rng = np.random.default_rng(seed)
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag(rng.uniform(0.003, 0.02, 3)))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia, "plate"))
    floor = scene.add_contour("floor", pc.Plane())
    for k, (x, y) in enumerate([(0.1, 0.1), (-0.1, 0.1), (-0.1, -0.1), (0.1, -0.1)]):
        foot = scene.add_contour(f"p{k}", pc.Sphere(0.02), "plate", pin.SE3(np.eye(3), np.array([x, y, -0.1])))
        law = pc.Coulomb(rng.uniform(0.1, 0.6), rolling=rng.uniform(0.002, 0.01))
        scene.add_contact(f"foot {k}", foot, floor, friction=law)
    height = 0.12 + rng.uniform(0.001, 0.01)
    turned = pin.Quaternion(pin.rpy.rpyToMatrix(*(0.05 * rng.normal(size=3)))).coeffs()
    v = np.concatenate([0.5 * rng.normal(size=3), rng.normal(size=3)])
    state = scene.initial_state([0.0, 0.0, height, *turned], v, free=list(scene.contacts), max_gap=1.0)
    run = pc.simulate(scene, state, 1.0, energies=True)
    assert run.status == 0, run.message
    # what a run to 1e-8 leaves; resistance to rolling at a contact that does not roll made 1e-5
    energies = run.energies()
    assert np.abs(energies.balance).max() <= 3e-8 * energies.kinetic.max()


@BILATERAL
def test_spin_ends_at_an_event(bilateral):
    length, spin = 2e-4, 12.0
    scene = ball(pc.Coulomb(0.5, spinning=length), bilateral=bilateral)
    slowing = length * MASS * G / (0.4 * MASS * RADIUS**2)
    stops = spin / slowing
    run = pc.simulate(scene, on_the_floor(scene, [0, 0, 0, 0, 0, spin]), 1.2 * stops, energies=True, **TIGHT)
    assert run.status == 0, run.message
    assert kinds(run) == ["hold"] and run.events[0].contact == "c"
    assert run.events[0].time == pytest.approx(stops, rel=ACCURATE)
    rests = run.t > run.events[0].time
    assert np.abs(run.v[rests, 5]).max() <= 1e-15
    # nothing resists rolling: what rounding has made of it goes on
    assert np.abs(run.v[rests]).max() <= 1e-12
    np.testing.assert_allclose(run.contacts["c"].torque[~rests][:-1, 2], length * MASS * G, rtol=1e-12)
    assert np.abs(run.energies().balance).max() <= 1e-12
    turned = 2.0 * math.atan2(run.q[-1, 5], run.q[-1, 6])
    assert math.remainder(turned - 0.5 * spin * stops, 2.0 * math.pi) == pytest.approx(0.0, abs=spin * stops * ACCURATE)


@BILATERAL
@pytest.mark.parametrize("law", [pc.NoSlip(rolling=4e-3), pc.Coulomb(0.5, rolling=4e-3)], ids=["no slip", "Coulomb"])
def test_rolling_ends_at_an_event(law, bilateral):
    """A ball that rolls obliquely: a = r rolling m g / (I + m r^2), distance v^2 / 2 a, then it lies still."""
    speed, direction = 0.3, 0.6
    scene = ball(law, bilateral=bilateral)
    along = np.array([math.cos(direction), math.sin(direction), 0.0])
    v = np.r_[speed * along, np.cross([0.0, 0.0, 1.0], speed * along) / RADIUS]
    slowing = law.rolling * G / (1.4 * RADIUS)
    stops = speed / slowing
    run = pc.simulate(scene, on_the_floor(scene, v), 1.2 * stops, energies=True, **TIGHT)
    assert run.status == 0, run.message
    assert kinds(run) == ["hold"]
    assert run.events[0].time == pytest.approx(stops, rel=ACCURATE)
    np.testing.assert_allclose(run.q[-1, :3] - run.q[0, :3], 0.5 * speed * stops * along, atol=speed * stops * ACCURATE)
    rests = run.t > run.events[0].time
    # rounding of the 6 rad/s that it came to rest from
    assert np.abs(run.v[rests]).max() <= 1e-13
    track = run.contacts["c"]
    axis = np.array([-math.sin(direction), math.cos(direction), 0.0])
    # slower it has a direction that is known no better than that
    rolls = np.linalg.norm(run.v[:, :3], axis=1) > 1e-4 * speed
    assert rolls.sum() > 5
    expected = np.outer(np.ones(rolls.sum()), law.rolling * MASS * G * axis)
    np.testing.assert_allclose(track.torque[rolls], expected, rtol=0.0, atol=1e-9)
    assert np.abs(run.energies().balance).max() <= run.energies().kinetic[0] * ACCURATE


def test_a_growing_force_sets_a_ball_rolling():
    """The ball holds until f r = rolling m g and rolls as the rest of the force has it, x = k (t - t0)^3 / (8.4 m)."""
    length, growth, direction, end = 4e-3, 0.4, 0.9, 2.0
    along = np.array([math.cos(direction), math.sin(direction), 0.0])
    scene = ball(pc.Coulomb(0.6, rolling=length))

    def push(t, q, v):
        rotation = pin.Quaternion(q[3:]).toRotationMatrix()
        return np.r_[rotation.T @ (growth * t * along), np.zeros(3)]

    run = pc.simulate(scene, on_the_floor(scene), end, control=push, t_eval=np.linspace(0.0, end, 21), **TIGHT)
    assert run.status == 0, run.message
    begins = length * MASS * G / (RADIUS * growth)
    assert kinds(run) == ["turn"]
    assert run.events[0].time == pytest.approx(begins, rel=ACCURATE)
    way = growth * np.maximum(run.t - begins, 0.0) ** 3 / (6.0 * 1.4 * MASS)
    # rolling is seeded after a short time, whose cube is what is neglected
    np.testing.assert_allclose(run.q[:, :2] - run.q[0, :2], np.outer(way, along[:2]), rtol=0.0, atol=1e-8)


def test_pushed_from_rest_it_rolls_at_once():
    length, force = 4e-3, 2.0
    assert force * RADIUS > length * MASS * G
    scene = ball(pc.Coulomb(0.9, rolling=length))

    def push(t, q, v):
        return np.r_[pin.Quaternion(q[3:]).toRotationMatrix().T @ [0.6 * force, 0.8 * force, 0.0], np.zeros(3)]

    run = pc.simulate(scene, on_the_floor(scene), 0.5, control=push, **TIGHT)
    assert run.status == 0, run.message
    assert run.stats["cone_problems"] == 1
    expected = (force - length * MASS * G / RADIUS) / (1.4 * MASS) * 0.5**2 / 2.0
    np.testing.assert_allclose(run.q[-1, :2], [0.6 * expected, 0.8 * expected], rtol=1e-8)


def test_resistance_on_a_slope_between_events():
    """Below slope = rolling / r the ball stays where it is; above, it rolls with what is left of gravity."""
    length = 4e-3
    limit = math.atan(length / RADIUS)
    scene = ball(pc.Coulomb(0.5, rolling=length), (1.0 - 1e-9) * limit)
    run = pc.simulate(scene, on_the_floor(scene), 10.0, **TIGHT)
    # but for spin, which nothing resists: rounding of nothing
    assert np.abs(run.v[:, :5]).max() <= 1e-20 and np.abs(run.v[:, 5]).max() <= 1e-12 and not run.events
    slope = (1.0 + 1e-2) * limit
    scene = ball(pc.Coulomb(0.5, rolling=length), slope)
    run = pc.simulate(scene, on_the_floor(scene), 10.0, **TIGHT)
    expected = G * (math.sin(slope) - length / RADIUS * math.cos(slope)) / 1.4
    assert np.linalg.norm(run.v[-1, :3]) == pytest.approx(10.0 * expected, rel=1e-8)


def test_turntable_in_smooth_steps():
    rate, length = 3.0, 1e-4
    scene = ball(pc.Coulomb(0.5, spinning=length), motion=pc.ConstantTwist((0.0, 0.0, rate)))
    gaining = length * G / (0.4 * RADIUS**2)
    run = pc.simulate(scene, on_the_floor(scene), 1.3 * rate / gaining, energies=True, **TIGHT)
    assert run.status == 0 and kinds(run) == ["hold"]
    assert run.events[0].time == pytest.approx(rate / gaining, rel=ACCURATE)
    assert run.v[-1, 5] == pytest.approx(rate, rel=1e-14)
    energies = run.energies()
    assert np.abs(energies.balance).max() <= 1e-11
    # the plate gives twice what the ball gets: the rest is friction's
    assert energies.drive_work[-1] == pytest.approx(2.0 * energies.kinetic[-1], rel=ACCURATE)
    assert energies.friction_work[-1] == pytest.approx(-energies.kinetic[-1], rel=ACCURATE)


def test_sliding_rolling_and_spinning_end_one_after_the_other():
    """Time stepping, without events, comes to the same motion to its second order."""
    scene = ball(pc.Coulomb(0.3, rolling=4e-3, spinning=2e-3))
    state = on_the_floor(scene, [1.0, 0.5, 0.0, 3.0, 4.0, 30.0])
    times = np.linspace(0.0, 2.0, 21)
    run = pc.simulate(scene, state, 2.0, t_eval=times, energies=True)
    assert run.status == 0, run.message
    assert sorted(kinds(run)) == ["hold", "hold", "stick"]
    assert np.abs(run.energies().balance).max() <= 1e-7
    for kind, worst in run.residuals().items():
        assert worst.max() <= 1e-13, kind
    errors = []
    for step in (2e-3, 1e-3):
        stepped = pc.simulate(scene, state, 2.0, t_eval=times, method="Moreau", step=step)
        errors.append(np.abs(stepped.q[:, :3] - run.q[:, :3]).max())
    assert errors[1] <= 0.3 * errors[0] and errors[1] <= 2e-3


def bowl(law, size=0.5, **options):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "joint")
    # three different moments: those of a homogeneous ball would leave its spin alone
    inertia = pin.Inertia(MASS, np.zeros(3), MASS * RADIUS**2 * np.diag([0.3, 0.4, 0.55]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addBodyFrame("ball", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    inner = scene.add_contour("inner", pc.Sphere(size))
    surface = scene.add_contour("surface", pc.Sphere(RADIUS), "ball")
    scene.add_contact("c", surface, inner, friction=law, **options)
    return scene


def test_ball_in_a_bowl_neither_spins_nor_leaves():
    """Curved ground turns the axes of what is held: omega . n stays zero to round-off, and time stepping agrees."""
    size = 0.5
    scene = bowl(pc.NoSlip(spinning=5e-2, rolling=1e-3), size)
    angle = 0.5
    n = np.array([math.sin(angle), 0.0, -math.cos(angle)])
    q = np.r_[(size - RADIUS) * n, 0.0, 0.0, 0.0, 1.0]
    velocity = np.array([0.3, 0.5, 0.0])
    velocity -= n * (n @ velocity)
    state = scene.initial_state(q, np.r_[velocity, np.cross(velocity, n) / RADIUS])
    times = np.linspace(0.0, 3.0, 31)
    run = pc.simulate(scene, state, 3.0, t_eval=times, energies=True, **TIGHT)
    assert run.status == 0, run.message
    spins = []
    for i in range(times.size):
        rotation = pin.Quaternion(run.q[i, 3:]).toRotationMatrix()
        spins.append(rotation @ run.v[i, 3:] @ run.q[i, :3] / np.linalg.norm(run.q[i, :3]))
    assert np.abs(spins).max() <= 1e-12
    normal = run.q[:, :3] / np.linalg.norm(run.q[:, :3], axis=1)[:, None]
    assert np.abs(np.sum(run.contacts["c"].torque * normal, axis=1)).max() >= 1e-3
    energies = run.energies()
    assert np.abs(energies.balance).max() <= 1e-9
    assert (np.diff(energies.total) <= 1e-9).all()
    errors = []
    for step in (2e-3, 1e-3):
        stepped = pc.simulate(scene, state, 3.0, t_eval=times, method="Moreau", step=step)
        errors.append(np.abs(stepped.q[:, :3] - run.q[:, :3]).max())
    assert errors[1] <= 0.35 * errors[0] and errors[1] <= 2e-3


def disk_in_a_plane(radius, length, speed, bilateral=False):
    """A disk that rolls on a line of its plane, as it starts."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -G, 0.0])
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(
        joint, pin.Inertia(MASS, np.zeros(3), 0.5 * MASS * radius**2 * np.eye(3)), pin.SE3.Identity()
    )
    model.addBodyFrame("disk", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    rim = scene.add_contour("rim", pc.Circle(radius), "disk")
    road = scene.add_contour("road", pc.Line())
    scene.add_contact("c", rim, road, friction=pc.Coulomb(0.6, rolling=length), bilateral=bilateral)
    return scene, scene.initial_state(np.array([0.0, radius, 1.0, 0.0]), np.array([speed, 0.0, -speed / radius]))


@BILATERAL
def test_disk_in_a_plane_between_events(bilateral):
    """One axis to roll about (2C-2C)."""
    radius, length, speed = 0.2, 3e-3, 0.5
    scene, state = disk_in_a_plane(radius, length, speed, bilateral)
    stops = speed * 1.5 * radius / (length * G)
    run = pc.simulate(scene, state, 1.1 * stops, **TIGHT)
    assert run.status == 0 and kinds(run) == ["hold"]
    assert run.events[0].time == pytest.approx(stops, rel=ACCURATE)
    assert run.q[-1, 0] == pytest.approx(0.5 * speed * stops, rel=ACCURATE)
    np.testing.assert_allclose(run.contacts["c"].torque[0], [0.0, 0.0, -length * MASS * G], rtol=0.0, atol=1e-12)


def test_an_impact_takes_spin():
    """A ball that falls without rebound: I change of omega_n = -spinning P."""
    length, spin, height = 1e-3, 100.0, 0.2
    scene = ball(pc.Coulomb(0.5, spinning=length))
    q = pin.neutral(scene.model)
    q[2] = RADIUS + height
    state = scene.initial_state(q, [0, 0, 0, 0, 0, spin], free=["c"])
    touch = math.sqrt(2.0 * height / G)
    run = pc.simulate(scene, state, touch + 1e-3, energies=True, **TIGHT)
    assert run.status == 0, run.message
    assert "touch" in kinds(run)
    lost = length * (MASS * math.sqrt(2.0 * G * height) + MASS * G * 1e-3) / (0.4 * MASS * RADIUS**2)
    assert run.v[-1, 5] == pytest.approx(spin - lost, rel=ACCURATE)
    assert np.abs(run.energies().balance).max() <= 1e-9


def test_pinocchio_gets_the_torques_too():
    """Forward dynamics under the external forces of a run, and of a state, are the run's accelerations."""
    scene = ball(pc.Coulomb(0.5, spinning=2e-3, rolling=4e-3))
    state = on_the_floor(scene, [0.3, 0.1, 0.0, -2.0, 6.0, 8.0])
    run = pc.simulate(scene, state, 0.2, **TIGHT)
    model = scene.model
    data = model.createData()
    i = int(np.searchsorted(run.t, 0.1))
    a = pin.aba(model, data, run.q[i], run.v[i], np.zeros(6), run.external_forces(i)).copy()
    again = pin.aba(model, data, run.q[i], run.v[i], np.zeros(6), pc.external_forces(scene, run.state(i)))
    np.testing.assert_allclose(again, a, rtol=0.0, atol=1e-10)
    h = 1e-4
    near = pc.simulate(scene, run.state(i), h, **TIGHT)
    # a difference of first order; without the torques it would be off by 40 rad/s^2
    np.testing.assert_allclose((near.v[-1] - run.v[i]) / h, a, rtol=0.0, atol=h * np.abs(run.v[i]).max() ** 2)


def test_inverse_dynamics_with_resistance():
    """Torques found for an acceleration make just that acceleration."""
    scene = ball(pc.NoSlip(spinning=2e-3, rolling=4e-3))
    state = on_the_floor(scene, [0.3, 0.0, 0.0, 0.0, 0.3 / RADIUS, 8.0])
    # of the centre along x, in axes that turn with the ball
    acceleration = np.r_[[0.5, 0.0, 0.0] - np.cross(state.v[3:], state.v[:3]), 0.0, 0.5 / RADIUS, -1.0]
    found = pc.inverse_dynamics(scene, state, acceleration, actuation=np.eye(6)[:, 3:])
    expected = MASS * G * np.array([0.0, 4e-3, 2e-3])
    np.testing.assert_allclose(np.abs(found.torques["c"]), expected, rtol=1e-10, atol=1e-14)
    h = 1e-3
    run = pc.simulate(scene, state, h, control=lambda t, q, v: found.tau, **TIGHT)
    # body axes turn by 1e-2 in that time
    np.testing.assert_allclose((run.v[-1, 5] - 8.0) / h, -1.0, atol=2e-2)
    with pytest.raises(pc.StateError, match="into turning"):
        rest = on_the_floor(scene)
        pc.inverse_dynamics(scene, rest, [0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@settings(max_examples=25, deadline=None, derandomize=True, database=None)
@given(
    v=st.tuples(*[st.floats(-3.0, 3.0)] * 2),
    w=st.tuples(*[st.floats(-30.0, 30.0)] * 3),
    mu=st.floats(0.05, 1.0),
    lengths=st.tuples(st.floats(0.0, 1e-2), st.floats(0.0, 1e-2)),
    height=st.sampled_from([0.0, 0.1]),
)
def test_turning_never_gains_energy(v, w, mu, lengths, height):
    scene = ball(pc.Coulomb(mu, spinning=lengths[0], rolling=lengths[1]))
    q = pin.neutral(scene.model)
    q[2] = RADIUS + height
    state = scene.initial_state(q, [*v, 0.0, *w], free=["c"] if height else ())
    run = pc.simulate(scene, state, 1.0, energies=True)
    assert run.status == 0, run.message
    energies = run.energies()
    scale = energies.total[0] + 1e-6
    assert (np.diff(energies.total) <= 1e-7 * scale).all()
    assert np.abs(energies.balance).max() <= 1e-6 * scale


def thrown(seed, law):
    """A random body above a plane or a ball, and its flight."""
    rng = np.random.default_rng(seed)
    axes, mass = rng.uniform(0.1, 0.3, 3), rng.uniform(0.5, 3.0)
    moments = mass / 5.0 * (axes @ axes - axes**2)
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(mass, np.zeros(3), np.diag(moments)), joint="joint")
    scene = pc.Scene(model)
    shape = (pc.Ellipsoid(*axes), pc.Circle(axes[0]), pc.Sphere(axes[0]))[rng.integers(3)]
    body = scene.add_contour("shape", shape, "body")
    ground = scene.add_contour("ground", pc.Plane() if rng.random() < 0.5 else pc.Sphere(1.0))
    scene.add_contact("c", body, ground, friction=law, restitution=float(rng.choice([0.0, 0.0, 0.5])))
    q = np.r_[rng.uniform(-0.1, 0.1, 2), 1.5, pin.Quaternion(pin.exp3(rng.normal(size=3))).coeffs()]
    return scene, scene.initial_state(q, np.r_[rng.normal(size=3), 3.0 * rng.normal(size=3)], free=["c"])


@pytest.mark.parametrize("rtol", [1e-5, 1e-8])
@pytest.mark.parametrize("seed", [2, 7, 31, 87])
def test_thrown_bodies_roll_on_or_slide_without_load(seed, rtol):
    """Impacts, ideal rolling that lets go, slides that friction alone holds up and resistances to turning, together."""
    scene, state = thrown(seed, pc.NoSlip(spinning=2e-3, rolling=2e-3))
    run = pc.simulate(scene, state, 1.2, rtol=rtol, atol=1e-2 * rtol, energies=True)
    assert run.status == 0, run.message
    energies = run.energies()
    scale = max(1.0, abs(energies.total[0]))
    # some hundred steps, and jumps where slips are stopped
    assert np.diff(energies.total).max() <= 10.0 * rtol * scale
    assert np.abs(energies.balance).max() <= 100.0 * rtol * scale
    assert run.contacts["c"].gap.min() >= -20.0 * rtol


# ------------------------------------------------------------------------------------------------ time stepping


@BILATERAL
def test_spinning_ball_stops(bilateral):
    """Constant deceleration, exact but for the step in which it stops; then nothing moves."""
    length, spin, step = 2e-4, 12.0, 1e-3
    scene = ball(pc.Coulomb(0.5, spinning=length), bilateral=bilateral)
    slowing = length * MASS * G / (0.4 * MASS * RADIUS**2)
    stops = spin / slowing
    run = pc.simulate(
        scene, on_the_floor(scene, [0, 0, 0, 0, 0, spin]), 1.2 * stops, method="Moreau", step=step, energies=True
    )
    assert run.status == 0, run.message
    before, after = run.t <= stops, run.t >= stops + step
    np.testing.assert_allclose(run.v[before, 5], spin - slowing * run.t[before], rtol=0.0, atol=1e-9)
    assert np.abs(run.v[after]).max() <= 1e-12
    assert np.abs(run.q[after] - run.q[-1]).max() <= 1e-12
    assert np.abs(run.v[:, :5]).max() <= 1e-12
    assert np.abs(run.energies().balance).max() <= 1e-10
    # the angle misses what the mean speed of the last step hides
    turned = 2.0 * math.atan2(run.q[-1, 5], run.q[-1, 6])
    assert math.remainder(turned - 0.5 * spin * stops, 2.0 * math.pi) == pytest.approx(0.0, abs=slowing * step**2)


@BILATERAL
@pytest.mark.parametrize("law", [pc.NoSlip(rolling=4e-3), pc.Coulomb(0.5, rolling=4e-3)], ids=["no slip", "Coulomb"])
def test_rolling_ball_stops(law, bilateral):
    """a = r rolling m g / (I + m r^2) against a ball that rolls obliquely; distance v^2 / 2 a, then it lies still."""
    speed, direction, step = 0.3, 0.6, 2e-3
    scene = ball(law, bilateral=bilateral)
    along = np.array([math.cos(direction), math.sin(direction), 0.0])
    v = np.r_[speed * along, np.cross([0.0, 0.0, 1.0], speed * along) / RADIUS]
    slowing = RADIUS * law.rolling * G / (1.4 * RADIUS**2)
    stops = speed / slowing
    errors = []
    for size in (2.0 * step, step):
        run = pc.simulate(scene, on_the_floor(scene, v), 1.2 * stops, method="Moreau", step=size, energies=True)
        assert run.status == 0, run.message
        errors.append(np.abs(run.q[-1, :3] - run.q[0, :3] - 0.5 * speed * stops * along).max())
    turned = speed / RADIUS * step
    # it misses what the mean speed of the last step hides
    assert errors[0] <= slowing * (2.0 * step) ** 2 and errors[1] <= slowing * step**2
    rolling, resting = run.t < stops - step, run.t > stops + step
    speeds = np.linalg.norm(run.v[rolling, :3], axis=1)
    np.testing.assert_allclose(speeds, speed - slowing * run.t[rolling], rtol=0.0, atol=speed * turned**2)
    assert np.abs(run.v[resting]).max() <= 1e-12
    assert np.abs(run.q[resting] - run.q[-1]).max() <= 1e-12
    # the ground's friction is what slows the centre down
    track = run.contacts["c"]
    np.testing.assert_allclose(track.tangential_force[1:][rolling[1:]], MASS * slowing, rtol=1e-6)
    # the ball is the first contour: on the floor acts the torque along the ball's rotation
    axis = np.array([-math.sin(direction), math.cos(direction), 0.0])
    np.testing.assert_allclose(
        track.torque[1:][rolling[1:]],
        np.outer(np.ones(rolling.sum() - 1), law.rolling * MASS * G * axis),
        rtol=0.0,
        atol=1e-12,
    )
    energies = run.energies()
    assert np.abs(energies.balance).max() <= energies.kinetic[0] * turned**2


def test_ball_that_rolls_and_spins():
    """On a plane neither resistance knows of the other."""
    law, step = pc.Coulomb(0.5, spinning=2e-4, rolling=1e-3), 1e-3
    scene = ball(law)
    speed, spin, time = 0.3, 8.0, 0.4
    state = on_the_floor(scene, [speed, 0.0, 0.0, 0.0, speed / RADIUS, spin])
    run = pc.simulate(scene, state, time, method="Moreau", step=step)
    rotation = pin.XYZQUATToSE3(run.q[-1]).rotation
    v, w = rotation @ run.v[-1, :3], rotation @ run.v[-1, 3:]
    # second order in the angle turned in a step
    accuracy = ((speed / RADIUS + spin) * step) ** 2
    assert w[2] == pytest.approx(spin - time * law.spinning * G / (0.4 * RADIUS**2), abs=spin * accuracy)
    assert v[0] == pytest.approx(speed - time * law.rolling * G / (1.4 * RADIUS), abs=speed * accuracy)
    assert abs(v[1]) <= speed * accuracy


def test_turntable_takes_a_ball_along():
    """Spinning resistance is what turns a ball that lies on the axis of a plate, until it turns with it."""
    rate, length, step = 3.0, 1e-4, 2e-3
    scene = ball(pc.Coulomb(0.5, spinning=length), motion=pc.ConstantTwist((0.0, 0.0, rate)))
    gaining = length * G / (0.4 * RADIUS**2)
    reached = rate / gaining
    run = pc.simulate(scene, on_the_floor(scene), 1.3 * reached, method="Moreau", step=step, energies=True)
    assert run.status == 0, run.message
    before, after = run.t <= reached, run.t >= reached + step
    np.testing.assert_allclose(run.v[before, 5], gaining * run.t[before], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(run.v[after, 5], rate, rtol=1e-12)
    energies = run.energies()
    assert np.abs(energies.balance).max() <= 1e-10
    # the plate gives twice what the ball gets: the rest is friction's, but for the step in which they meet
    assert energies.drive_work[-1] == pytest.approx(2.0 * energies.kinetic[-1], rel=step / reached)


def test_rolling_resistance_on_a_slope():
    """Below slope = rolling / r the ball stays where it is; above, it rolls with what is left of gravity."""
    length, step = 4e-3, 2e-3
    limit = math.atan(length / RADIUS)
    scene = ball(pc.Coulomb(0.5, rolling=length), 0.98 * limit)
    run = pc.simulate(scene, on_the_floor(scene), 0.5, method="Moreau", step=step)
    assert np.abs(run.v).max() <= 1e-12
    np.testing.assert_allclose(run.contacts["c"].tangential_force[1:], MASS * G * math.sin(0.98 * limit), rtol=1e-9)
    slope = 1.5 * limit
    scene = ball(pc.Coulomb(0.5, rolling=length), slope)
    run = pc.simulate(scene, on_the_floor(scene), 0.5, method="Moreau", step=step)
    expected = G * (math.sin(slope) - length / RADIUS * math.cos(slope)) / 1.4
    speed = float(np.linalg.norm(pin.XYZQUATToSE3(run.q[-1]).rotation @ run.v[-1, :3]))
    # second order in the angle turned in a step
    assert speed == pytest.approx(0.5 * expected, rel=(speed / RADIUS * step) ** 2)


def test_disk_that_rolls_in_a_plane():
    """One axis to roll about (2C-2C): the same law, and the torque that the stepper reports."""
    radius, length, speed, step = 0.2, 3e-3, 0.5, 1e-3
    scene, state = disk_in_a_plane(radius, length, speed)
    slowing = radius * length * G / (1.5 * radius**2)
    stops = speed / slowing
    run = pc.simulate(scene, state, 1.1 * stops, method="Moreau", step=step)
    assert run.status == 0, run.message
    # second order in the angle turned in a step
    assert run.q[-1, 0] == pytest.approx(0.5 * speed * stops, rel=(speed / radius * step) ** 2)
    assert np.abs(run.v[-1]).max() <= 1e-12
    stepper = pc.Stepper(scene, state, dt=step)
    stepper.step(np.zeros(3))
    # rolling forward turns about -z; the disk resists it, the road feels the opposite
    np.testing.assert_allclose(stepper.torques["c"], [0.0, 0.0, -length * MASS * G], rtol=0.0, atol=1e-12)
