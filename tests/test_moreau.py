"""Time stepping with impulses: bounces, stops, jams and limits in closed form, order, energy, and the other integrator.

Bounds are multiples of the step h where a mode changes within a step (first order), and of h^2 elsewhere; the factors
are two to ten times what is observed, and far below what a wrong law would leave.
"""

import math

import numpy as np
import pinocchio as pin
import pytest
from reference import NATIVE_NAMES, body_motion, build, reference
from scipy.integrate import quad
from scipy.optimize import brentq
from shared import body_scene, kinds, one_body

import pincontact as pc

G = 9.81
FREE, FRICTIONLESS, STICK, SLIPPING = -1, 0, 1, 2


def ball_scene(radius=0.1, mass=2.0, friction=None, restitution=0.0, gravity=(0.0, 0.0, -G)):
    moment = 0.4 * mass * radius**2
    scene = body_scene(pin.JointModelFreeFlyer(), mass, (moment, moment, moment), gravity)
    ball, ground = scene.add_contour("ball", pc.Sphere(radius), "body"), scene.add_contour("ground", pc.Plane())
    scene.add_contact("c", ball, ground, friction=friction, restitution=restitution)
    return scene


def block_scene(mu, gravity=(0.0, 0.0, -G), mass=2.0):
    """A block on four feet, its centre of mass 5 cm above them."""
    scene = body_scene(pin.JointModelFreeFlyer(), mass, (0.02, 0.03, 0.04), gravity)
    floor = scene.add_contour("floor", pc.Plane())
    for i, (x, y) in enumerate(((0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1))):
        foot = scene.add_contour(f"foot{i}", pc.Point(), "body", pin.SE3(np.eye(3), np.array([x, y, -0.05])))
        scene.add_contact(f"foot{i}", foot, floor, friction=pc.Coulomb(mu))
    return scene, scene.initial_state(np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0]))


def upright(*position):
    return np.array([*position, 0.0, 0.0, 0.0, 1.0])


def slide_scene(mu, mass=1.0, **contact):
    """A point mass on a plane, without rotation."""
    scene = body_scene(pin.JointModelTranslation(), mass, (0.0, 0.0, 0.0))
    mass_point, floor = scene.add_contour("mass", pc.Point(), "body"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", mass_point, floor, friction=pc.Coulomb(mu), **contact)
    return scene


def joint_scene(damping=0.0, friction=0.0, lower=-1.0, upper=2.0, mass=1.0):
    """A mass on a vertical prismatic joint."""
    scene = body_scene(pin.JointModelPZ(), mass)
    model = scene.model
    model.lowerPositionLimit[0], model.upperPositionLimit[0] = lower, upper
    model.lowerDryFrictionLimit[0], model.upperDryFrictionLimit[0] = -friction, friction
    model.damping[0] = damping
    return scene


def stepped(scene, state, duration, h, **options):
    run = pc.simulate(scene, state, duration, method="Moreau", step=h, **options)
    assert run.status == 0, run.message
    assert np.isfinite(run.q).all()
    assert np.isfinite(run.v).all()
    return run


# ---------------------------------------------------------------------------------------------------- impacts


@pytest.mark.parametrize("restitution", [0.5, 0.7, 0.9])
def test_bouncing_ball(restitution):
    """Heights, times and their sum. A ball follows its parabolas exactly, as long as it touches once a step."""
    h, height = 1e-3, 1.0
    scene = ball_scene(restitution=restitution)
    state = scene.initial_state(upright(0.0, 0.0, 0.1 + height), free=["c"])
    fall = math.sqrt(2.0 * height / G)
    end = fall * (1.0 + restitution) / (1.0 - restitution)
    run = stepped(scene, state, end + 0.1, h)
    touches = [event.time for event in run.events if event.kind == "touch"]
    flights = 2.0 * fall * restitution ** np.arange(1, len(touches) + 1)
    expected = fall + np.concatenate([[0.0], np.cumsum(flights)[:-1]])
    # two bounces a step are the end of accumulation: all flights longer than that are there
    whole = int(np.sum(flights > 2.0 * h))
    assert whole >= 6
    np.testing.assert_allclose(touches[:whole], expected[:whole], rtol=0.0, atol=1e-12)
    for k in range(min(whole, 4) - 1):
        between = (run.t > touches[k]) & (run.t < touches[k + 1])
        # the highest sample is within h / 2 of the top
        assert abs(run.q[between, 2].max() - 0.1 - height * restitution ** (2 * k + 2)) <= G * h * h
    # what is cut off is shorter than the first flight that is dropped, over 1 - restitution
    assert abs(touches[-1] - end) <= 2.0 * h / (1.0 - restitution)
    assert run.contacts["c"].mode[-1] == FRICTIONLESS
    # of speeds up to 4 m/s only round-off is left
    assert np.abs(run.v[-1]).max() <= 1e-12
    # support is exact: the gap of a resting ball is round-off
    assert abs(run.contacts["c"].gap[-1]) <= 1e-15
    assert run.contacts["c"].gap.min() >= -1e-12


@pytest.mark.parametrize("friction", [pc.NoSlip(), pc.Coulomb(0.5), pc.Coulomb(0.5, spinning=0.01, rolling=0.01)])
@pytest.mark.parametrize("turns", [False, True])
def test_what_friction_alone_holds_stays(turns, friction):
    """One degree of freedom, pulled away from the ground at an angle within that of friction: rest is a solution as
    lifting is, and stays, in both kinds of methods; beyond the angle of friction it lifts."""
    for angle, rests in ((0.2, True), (0.6, friction == pc.NoSlip())):
        pull = np.array([0.0, math.cos(angle), math.sin(angle)])
        joint = pin.JointModelRX() if turns else pin.JointModelPrismaticUnaligned(pull)
        scene = body_scene(joint, 1.0, gravity=(0.0, 0.0, 0.0))
        # a lever that moves along the pull as the joint turns
        place = pin.SE3(np.eye(3), np.array([0.0, pull[2], -pull[1]]) if turns else np.zeros(3))
        ball = scene.add_contour("ball", pc.Sphere(0.1), "body", place)
        level = pin.SE3(np.eye(3), place.translation - [0.0, 0.0, 0.1])
        scene.add_contact("c", ball, scene.add_contour("ground", pc.Plane(), placement=level), friction=friction)
        state = scene.initial_state(np.zeros(1), np.zeros(1))
        pulled = {"control": lambda t, q, v: [5.0]}
        for run in (pc.simulate(scene, state, 0.1, **pulled), stepped(scene, state, 0.1, 1e-3, **pulled)):
            assert run.status == 0, run.message
            assert np.abs(run.q).max() < 1e-12 if rests else abs(run.q[-1, 0]) > 1e-3


@pytest.mark.parametrize("restitution", [0.3, 0.8])
def test_rebounds_in_a_bowl_come_to_an_end(restitution):
    """No gravity: it is the bowl's curvature that closes the contact again, and presses it from then on."""
    speed, radius = 3.0, 1.0
    scene = body_scene(pin.JointModelTranslation(), 1.0, gravity=(0.0, 0.0, 0.0))
    point, bowl = scene.add_contour("point", pc.Point(), "body"), scene.add_contour("bowl", pc.Sphere(radius))
    scene.add_contact("c", point, bowl, restitution=restitution, side=-1)
    state = scene.initial_state([0.0, 0.0, -0.999], [speed, 0.0, -0.05], free=["c"])
    apart = []
    for h in (2e-3, 1e-3, 5e-4):
        run = stepped(scene, state, 1.0, h)
        track = run.contacts["c"]
        assert track.mode[-1] == FRICTIONLESS
        assert abs(track.gap[-1]) < 1e-15 and track.gap.min() > -0.1 * speed**2 / radius * h * h
        assert track.normal_force[-1] == pytest.approx(np.sum(run.v[-1] ** 2) / radius, rel=2e-2)
        apart.append(np.linalg.norm(run.q[-1] - pc.simulate(scene, state, 1.0).q[-1]))
    # of first order in the step across impacts
    assert max(apart) < 0.03 and apart[-1] < 0.6 * apart[0], apart


def test_elastic_bounces_keep_the_energy():
    scene = ball_scene(restitution=1.0)
    run = stepped(scene, scene.initial_state(upright(0.0, 0.0, 0.6), free=["c"]), 20.0, 1e-3)
    assert len(run.events) >= 30
    energy = run.energies().total
    # rounding of 2e4 steps
    assert np.abs(energy / energy[0] - 1.0).max() <= 1e-11


def test_inelastic_landing_on_four_feet():
    """A tilted block falls, lands foot by foot and comes to rest on all four."""
    scene, _ = block_scene(0.8)
    q = np.concatenate([[0.0, 0.0, 0.3], pin.Quaternion(pin.rpy.rpyToMatrix(0.2, -0.15, 0.3)).coeffs()])
    run = stepped(scene, scene.initial_state(q, free=list(scene.contacts)), 1.5, 1e-3)
    assert [run.contacts[name].mode[-1] for name in scene.contacts] == [STICK] * 4
    assert np.abs(run.v[-1]).max() <= 1e-12
    assert abs(run.q[-1, 2] - 0.05) <= 1e-12
    # what falls freely into the plane within a step: O(h^2) of the accelerations
    assert min(run.contacts[name].gap.min() for name in scene.contacts) >= -1e-4


def test_restitution_with_friction_creates_no_energy():
    """A slender rod hits the floor sliding: with Newton's law alone a tip at mu = 2, e = 1 gains energy (Kane)."""
    for angle in np.linspace(0.2, 1.4, 7):
        scene = body_scene(pin.JointModelFreeFlyer(), 1.0, (1e-3, 0.02, 0.02), (0.0, 0.0, 0.0))
        tip = scene.add_contour("tip", pc.Point(), "body", pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])))
        scene.add_contact("c", tip, scene.add_contour("floor", pc.Plane()), friction=pc.Coulomb(2.0), restitution=1.0)
        q = np.concatenate(
            [[0.0, 0.0, 0.5 * math.sin(angle) + 0.02], pin.Quaternion(pin.utils.rotate("y", angle)).coeffs()]
        )
        body = pin.utils.rotate("y", angle).T
        v = np.concatenate([body @ np.array([-1.5, 0.3, -1.0]), [0.0, 0.5, 0.0]])
        run = stepped(scene, scene.initial_state(q, v, free=["c"]), 0.1, 1e-4)
        assert "touch" in kinds(run)
        energy = run.energies().kinetic
        # the impact is O(h) of the rates of turning away from the law's geometry
        assert energy.max() <= energy[0] * (1.0 + 1e-4)


# ---------------------------------------------------------------------------------------------------- friction


@pytest.mark.parametrize("share", [0.9, 0.999, 1.001, 1.1])
def test_block_on_incline(share):
    """On both sides of the friction angle: sliding is exact (constant acceleration), rest is rest."""
    mu = 0.5
    angle = math.atan(mu)
    scene, state = block_scene(share * mu, (G * math.sin(angle), 0.0, -G * math.cos(angle)))
    run = stepped(scene, state, 1.0, 1e-3)
    acceleration = max(G * (math.sin(angle) - share * mu * math.cos(angle)), 0.0)
    assert abs(run.v[-1, 0] - acceleration) <= 1e-12
    assert abs(run.q[-1, 0] - 0.5 * acceleration) <= 1e-12
    assert kinds(run) == (["slip"] * 4 if share < 1.0 else [])


def test_rest_does_not_creep():
    """10,000 steps in stick under a load of 80 % of its limit, on four redundant feet."""
    scene, state = block_scene(0.5)
    run = stepped(scene, state, 10.0, 1e-3, control=lambda t, q, v: np.array([0.4 * 2.0 * G, 0, 0, 0, 0, 0]))
    # round-off of M^-1 J^T F, and no sum of it
    assert np.abs(run.v).max() <= 1e-15
    assert np.abs(run.q[-1] - run.q[0]).max() <= 1e-15
    assert kinds(run) == []


def arm_scene(mu=0.8):
    """Two links that press their tip onto the floor at a distance of 0.5 m, and the torques that do."""
    model, place = pin.Model(), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3]))
    joint = 0
    for i in range(2):
        joint = model.addJoint(joint, pin.JointModelRY(), place, f"joint{i}")
        inertia = pin.Inertia(1.0, np.array([0.2, 0.0, 0.0]), 0.02 * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addBodyFrame(f"link{i}", joint, pin.SE3.Identity(), 0)
        place = pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0]))
    scene = pc.Scene(model)
    tip, floor = scene.add_contour("tip", pc.Point(), "link1", place), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", tip, floor, friction=pc.Coulomb(mu))
    # law of cosines for the elbow, then the height of the tip
    bend = math.acos((0.5**2 + 0.3**2) / (2.0 * 0.4**2) - 1.0)
    shoulder = math.atan2(0.3, 0.5) - 0.5 * bend
    return scene, scene.initial_state(np.array([shoulder, bend]), max_gap=0.05), np.array([3.0, 1.0])


def resting(name):
    """Scene, state and torques of something that stays where it is, near its limit of friction."""
    if name == "four feet":
        angle = math.radians(20.0)
        return *block_scene(0.4, (G * math.sin(angle), 0.0, -G * math.cos(angle))), np.zeros(6)
    if name == "arm":
        return arm_scene()
    scene = ball_scene(friction=pc.Coulomb(0.3))
    q = upright(0.0, 0.0, 0.1)
    return scene, scene.initial_state(q), np.zeros(6)


@pytest.mark.parametrize("name", ["four feet", "ball", "arm"])
def test_rest_for_a_thousand_seconds(name):
    """Below 1e-12 m/s over 1000 s, where soft contacts creep by millimetres."""
    scene, state, tau = resting(name)
    stepper = pc.Stepper(scene, state, dt=0.1)
    for _ in range(10_000):
        stepper.step(tau)
    assert stepper.modes.tolist() == [STICK] * len(scene.contacts)
    assert np.abs(pin.difference(scene.model, state.q, stepper.q)).max() <= 1e-9
    if name != "four feet":
        # redundant feet are another method's: the event-driven one takes forces of least norm
        for longest in (math.inf, 10.0):
            run = pc.simulate(scene, state, 1000.0, control=lambda t, q, v: tau, t_eval=[1000.0], max_step=longest)
            assert run.status == 0, run.message
            if name == "arm":
                # what is held completely has accelerations of zero, not of round-off
                assert np.array_equal(run.q[-1], state.q)
            # a ball may roll: round-off of its torques (1e-14 rad / s^2) makes a random walk of its speed, whose
            # integral counts in m
            assert np.abs(run.q[-1, :3] - state.q[:3]).max() <= 1e-9


def test_coulomb_oscillator_stops():
    """x'' = -k x -+ mu g from x0: every half-period takes 2 mu g / k off, until |x| <= mu g / k holds."""
    mu, k, h = 0.3, 30.0, 1e-3
    scene = slide_scene(mu)
    state = scene.initial_state(np.array([1.0, 0.0, 0.0]))
    run = stepped(scene, state, 3.0, h, control=lambda t, q, v: np.array([-k * q[0], 0.0, 0.0]))
    reach, x, halves = mu * G / k, 1.0, 0
    while abs(x) > reach:
        x = -math.copysign(abs(x) - 2.0 * reach, x)
        halves += 1
    # a reversal within a step is late by a part of it, where the speed is of the order h
    assert abs(run.q[-1, 0] - x) <= 20.0 * h * h * k
    assert run.contacts["c"].mode[-1] == STICK
    assert np.abs(run.v[-1]).max() <= 1e-15
    assert abs(run.events[-1].time - halves * math.pi / math.sqrt(k)) <= 3.0 * h


def test_sliding_ball_rolls():
    """From sliding at v0 without spin a ball rolls after 2 v0 / (7 mu g), at 5 v0 / 7."""
    mu, speed, h = 0.2, 2.0, 1e-3
    scene = ball_scene(friction=pc.Coulomb(mu))
    state = scene.initial_state(upright(0.0, 0.0, 0.1), np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0]))
    run = stepped(scene, state, 1.0, h)
    stop = 2.0 * speed / (7.0 * mu * G)
    assert kinds(run) == ["stick"]
    assert abs(run.events[0].time - stop) <= h
    v = np.array([pin.Quaternion(q[3:]).matrix() @ w[:3] for q, w in zip(run.q, run.v)])
    assert abs(v[-1, 0] - 5.0 / 7.0 * speed) <= 1e-3 * speed
    # body axes turn by omega h in a step: 14 rad/s, relative error (omega h)^2 / 8 of the velocity per turn
    slip = run.contacts["c"].slip_velocity
    assert np.linalg.norm(slip[run.t > stop + h], axis=1).max() <= 1e-7
    distance = speed * stop - 0.5 * mu * G * stop**2 + 5.0 / 7.0 * speed * (1.0 - stop)
    assert abs(run.q[-1, 0] - distance) <= 1e-3 * distance


def test_static_coefficient():
    """Stick up to mu_static, then slip with mu."""
    scene = body_scene(pin.JointModelTranslation(), 1.0, (0.0, 0.0, 0.0))
    point, floor = scene.add_contour("p", pc.Point(), "body"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", point, floor, friction=pc.Coulomb(0.2, mu_static=0.4))
    run = stepped(
        scene, scene.initial_state(np.zeros(3)), 1.0, 1e-3, control=lambda t, q, v: np.array([0.8 * G * t, 0, 0])
    )
    assert kinds(run) == ["slip"]
    assert abs(run.events[0].time - 0.5) <= 2e-3
    # x'' = 0.8 g t - 0.2 g from t = 0.5
    assert abs(run.v[-1, 0] - G * (0.4 * 0.75 - 0.2 * 0.5)) <= 2e-2


def test_pushed_block_slips_at_its_limit():
    """A growing push low on a block with four feet: slip begins when it reaches mu m g."""
    scene, state = block_scene(0.4)
    run = stepped(scene, state, 1.0, 1e-3, control=lambda t, q, v: np.array([2.0 * G * t, 0, 0, 0, -0.1 * G * t, 0]))
    assert kinds(run) == ["slip"] * 4
    assert abs(run.events[0].time - 0.4) <= 2e-3
    # m x'' = m g (t - 0.4)
    assert abs(run.v[-1, 0] - 0.5 * G * 0.6**2) <= 1e-2


def test_jam_is_resolved():
    """Painleve's rod, sliding at mu = 2 where no force exists: an impulse stops its tip, and the run goes on."""
    angle = math.radians(60.0)
    scene = body_scene(pin.JointModelFreeFlyer(), 1.0, (1e-3, 1.0 / 12.0, 1.0 / 12.0))
    half = 0.5
    tip = scene.add_contour("tip", pc.Point(), "body", pin.SE3(np.eye(3), np.array([half, 0.0, 0.0])))
    scene.add_contact("c", tip, scene.add_contour("floor", pc.Plane()), friction=pc.Coulomb(2.0))
    rotation = pin.utils.rotate("y", angle)
    q = np.concatenate([[0.0, 0.0, half * math.sin(angle)], pin.Quaternion(rotation).coeffs()])
    v = np.concatenate([rotation.T @ np.array([3.0, 0.0, 0.0]), np.zeros(3)])
    state = scene.initial_state(q, v)
    forces = pc.simulate(scene, state, 0.05)
    assert forces.status < 0, "the event-driven method finds no force"
    run = stepped(scene, state, 0.5, 1e-3, energies=True)
    assert np.diff(run.energies().friction_work).max() <= 1e-9
    assert run.contacts["c"].mode[1] in (STICK, FREE)
    assert run.contacts["c"].gap.min() >= -1e-4
    # at the start, where there is no force, none is known
    known = np.isfinite(run.contacts["c"].force).all(axis=1)
    assert not known[0] and known[1:].all()


@pytest.mark.parametrize("mu", [0.2, 0.5, 1.0])
def test_tumbling_block(mu):
    """A block thrown on its eight corners bounces, tumbles and comes to rest on a face: four redundant corners."""
    size = np.array([0.2, 0.15, 0.1])
    for h in (2e-3, 5e-4):
        scene = body_scene(pin.JointModelFreeFlyer(), 3.0, (0.0325, 0.05, 0.0725))
        floor = scene.add_contour("floor", pc.Plane())
        for i in range(8):
            place = pin.SE3(np.eye(3), size * [1 - 2 * (i >> k & 1) for k in range(3)])
            corner = scene.add_contour(f"corner{i}", pc.Point(), "body", place)
            scene.add_contact(f"corner{i}", corner, floor, friction=pc.Coulomb(mu), restitution=0.3)
        q = np.concatenate([[0.0, 0.0, 0.6], pin.Quaternion(pin.rpy.rpyToMatrix(0.4, 0.3, 0.2)).coeffs()])
        state = scene.initial_state(q, [1.5, 0.3, 0.0, 2.0, 6.0, 1.0], free=list(scene.contacts))
        run = stepped(scene, state, 2.0, h, t_eval=[2.0])
        assert np.abs(run.v[-1]).max() <= 1e-12
        assert sum(run.contacts[name].mode[-1] == STICK for name in scene.contacts) == 4
        # it lies on one of its faces
        assert np.abs(size - run.q[-1, 2]).min() <= 1e-12
        assert run.stats["cone_residual"] <= 1e-10


@pytest.mark.parametrize("driven", ["conveyor", "shaker"])
def test_energy_of_driven_contacts(driven):
    """What the drive puts in is what the body has and friction took, but for an error of the steps where slip ends.

    A conveyor carries a block along; a plate that shakes slides under it and takes it along, back and forth.
    """
    motion = pc.ConstantTwist(linear=(1.0, 0.0, 0.0))
    if driven == "shaker":
        motion = pc.HarmonicMotion(amplitude=(0.02, 0.0, 0.002), frequency=3.0)
    scene = body_scene(pin.JointModelFreeFlyer(), 2.0, (0.02, 0.03, 0.04))
    floor = scene.add_contour("floor", pc.Plane(), motion=motion)
    for i, (x, y) in enumerate(((0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1))):
        foot = scene.add_contour(f"foot{i}", pc.Point(), "body", pin.SE3(np.eye(3), np.array([x, y, -0.05])))
        scene.add_contact(f"foot{i}", foot, floor, friction=pc.Coulomb(0.3))
    state = scene.initial_state(upright(0.0, 0.0, 0.05))
    lost = []
    for h in (4e-3, 2e-3):
        run = stepped(scene, state, 0.6, h, energies=True)
        energies = run.energies()
        assert (run.contacts["foot0"].mode == SLIPPING).any()
        # friction takes, the drive gives
        assert energies.friction_work[-1] < -0.1
        assert energies.drive_work[-1] > 0.1
        # where slip ends within a step, the impulse that ends it meets the mean of the velocities at both ends
        assert np.diff(energies.friction_work).max() <= 5e-3 * energies.kinetic.max()
        lost.append(np.abs(energies.balance).max())
    # a quarter, where it is more than round-off
    assert lost[1] <= max(0.4 * lost[0], 1e-12)
    assert lost[1] <= 1e-3 * -energies.friction_work[-1]
    if driven == "conveyor":
        # v = mu g t up to the belt's speed; all work that is not kinetic energy is heat: one half each
        assert abs(run.v[-1, 0] - 1.0) <= 1e-12
        assert abs(energies.friction_work[-1] + 1.0) <= 1e-2
        assert abs(energies.drive_work[-1] - 2.0) <= 1e-2


# ---------------------------------------------------------------------------------------------------- joints


def test_joint_limits():
    """A mass thrown up to its stop, falling on the other: inelastic, held exactly, and its force reported."""
    scene = joint_scene(lower=-0.5, upper=0.2)
    run = stepped(scene, scene.initial_state([0.0], [3.0]), 1.0, 1e-3)
    assert run.q.max() <= 0.2
    assert run.q.min() >= -0.5
    reach = (3.0 - math.sqrt(9.0 - 2.0 * G * 0.2)) / G
    landing = reach + math.sqrt(2.0 * 0.7 / G)
    assert abs(run.t[np.argmax(run.q)] - reach) <= 2e-3
    assert abs(run.t[np.argmax(run.q <= -0.5)] - landing) <= 2e-3
    assert run.q[-1, 0] == -0.5
    assert run.v[-1, 0] == 0.0


def test_contact_and_stop_hold_together():
    """A bent arm slides down on its tip until its elbow stops: both hold exactly, and no energy comes in."""
    scene, state, _ = arm_scene(mu=0.0)
    stop = state.q[1] - 0.2
    scene.model.lowerPositionLimit[1] = stop
    run = stepped(scene, state, 1.0, 1e-3)
    at_stop = run.q[:, 1] == stop
    first = int(np.argmax(at_stop))
    assert 0 < first < 900
    assert at_stop[first:].all()
    # the arm has nowhere to go from here
    assert np.abs(run.v[first + 1 :]).max() <= 1e-12
    assert np.abs(run.q[first + 1 :] - run.q[-1]).max() <= 1e-12
    # what one projection with a correction below 1e-7 leaves
    assert np.abs(run.contacts["c"].gap).max() <= 1e-13
    # moments about the shoulder: the stop's torque is none of them
    track = run.contacts["c"]
    gravity = pin.computeGeneralizedGravity(scene.model, scene.model.createData(), run.q[-1])[0]
    assert track.normal_force[-1] * track.point[-1, 0] == pytest.approx(-gravity, rel=1e-9)
    total = run.energies().total
    # errors of second order until the stop, of the projection after it
    assert (total - np.minimum.accumulate(total)).max() <= 1e-5 * run.energies().kinetic.max()


@pytest.mark.parametrize("gap", [0.0, 1e-5, 1e-4, 1e-3])
def test_impact_throws_a_joint_onto_its_stop(gap):
    """Two masses fall, the upper one on a slide of the lower one, just above its stop, which it reaches when the lower
    one has landed: both come to rest, and the slide never passes its stop."""
    model = pin.Model()
    for i in range(2):
        joint = model.addJoint(i, pin.JointModelPZ(), pin.SE3.Identity(), f"joint{i}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0 + i, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("body", 1, pin.SE3.Identity(), 0)
    model.lowerPositionLimit[1] = 0.0
    scene = pc.Scene(model)
    point, floor = scene.add_contour("point", pc.Point(), "body"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", point, floor)
    run = stepped(scene, scene.initial_state([0.2, gap], free=["c"]), 0.4, 1e-3)
    # round-off of the way of 0.2 m, and of the speed of 2 m/s
    assert run.q[:, 1].min() >= -1e-16
    assert np.abs(run.q[-1]).max() <= 1e-15
    assert np.abs(run.v[-1]).max() <= 1e-14


@pytest.mark.parametrize("h", [2e-3, 1e-3])
def test_ideal_rolling_without_normal_force(h):
    """A rod that stands on an ideally rough floor is pushed over. Where its foot would pull, and would be pressed down
    again if it were let go, it slides, held up by its tangential force alone: the limit for ever rougher floors."""
    half, push = 0.5, 2.0
    scene = body_scene(pin.JointModelFreeFlyer(), 1.0, (1e-3, half**2 / 3.0, half**2 / 3.0))
    foot = scene.add_contour("foot", pc.Point(), "body", pin.SE3(np.eye(3), np.array([-half, 0.0, 0.0])))
    scene.add_contact("c", foot, scene.add_contour("floor", pc.Plane()), friction=pc.NoSlip())
    q = np.concatenate([[0.0, 0.0, half], pin.Quaternion(pin.utils.rotate("y", -0.5 * math.pi)).coeffs()])
    run = stepped(scene, scene.initial_state(q, [0.0, 0.0, -push * half, 0.0, push, 0.0]), 0.5, h)
    # J w w' = m g half sin(a), J = 4/3 m half^2, until g = half (w' sin(a) + w^2 cos(a))
    squared = lambda a: push**2 + 1.5 * G / half * (1.0 - math.cos(a))  # noqa: E731
    pressed = lambda a: G - 0.75 * G * math.sin(a) ** 2 - half * squared(a) * math.cos(a)  # noqa: E731
    angle = brentq(pressed, 0.1, 1.2)
    lifts = quad(lambda a: squared(a) ** -0.5, 0.0, angle)[0]
    assert kinds(run) == ["slip", "stick"]
    assert abs(run.events[0].time - lifts) <= 1.5 * h
    track = run.contacts["c"]
    slides = track.mode == SLIPPING
    assert slides.sum() >= 0.09 / h
    np.testing.assert_array_equal(track.normal_force[slides], 0.0)
    assert track.tangential_force[slides].min() >= 3.0
    power = np.einsum("ij,ij->i", track.force, track.slip_velocity)[slides]
    # zero, to the rounding of speeds of 1 m/s, where the slip is about to begin
    assert power[0] <= 1e-14 and power[1:].max() < 0.0
    # the midpoint's force is that of the end to first order
    assert track.normal_force[~slides].min() >= -h
    assert np.abs(track.gap).max() <= 1e-14
    total = run.energies().total
    # second order, in a fall that ends at 6 rad/s
    assert (total - np.minimum.accumulate(total)).max() <= 200.0 * h * h


def test_dry_joint_friction_and_damping():
    """m x'' = -m g - d x' - f sign(x'): rise with both, and rest where f > m g."""
    for damping in (0.0, 3.0):
        friction, h = 12.0, 1e-3
        scene = joint_scene(damping, friction)
        run = stepped(scene, scene.initial_state([0.0], [1.0]), 0.5, h)
        pull = G + friction
        if damping == 0.0:
            top = 0.5 / pull
        else:
            stop = math.log1p(damping / pull) / damping
            top = 1.0 / damping - pull / damping * stop
        assert abs(run.q[-1, 0] - top) <= pull * h * h
        assert abs(run.v[-1, 0]) <= 1e-15
        assert abs(run.q[-1, 0] - run.q[200, 0]) <= 1e-15


def test_stiff_damping_is_stable():
    """Damping a hundred times faster than the step: the trapezoidal rule keeps the fall at its terminal velocity."""
    scene = joint_scene(damping=1e5, lower=-1e3)
    run = stepped(scene, scene.initial_state([0.0], [0.0]), 1.0, 1e-3)
    assert np.abs(run.v).max() <= 2.0 * G / 1e5


# ---------------------------------------------------------------------------------------------------- order


SMOOTH = [
    "arm_on_heightfield_frictionless",
    "ball_in_bowl_3d_roll",
    "ball_on_plane_through_pole",
    "bead_on_free_hoop",
    "disk_heaving_incline_roll",
    "disk_plane_frictionless",
    "disk_plane_slip_then_roll",
    "disk_plane_stick_to_slip",
    "helix_bead_slip",
    "rod_slide_regular_push",
    "two_free_ellipsoids_frictionless",
]


@pytest.mark.parametrize("name", SMOOTH)
def test_second_order(name):
    """Against the stored trajectories: every pattern, driven contours, charts, slip in space, slip to stick."""
    expected = reference(name)
    scene, state = build(name, name in NATIVE_NAMES)
    last = int(np.searchsorted(expected["t"], min(1.6, expected["t"][-1]) + 1e-9)) - 1
    errors = []
    for h in (4e-3, 2e-3):
        run = stepped(scene, state, float(expected["t"][last]), h, t_eval=expected["t"][last : last + 1])
        motion = body_motion(name, run)
        errors.append(
            max(np.abs(motion.p[-1] - expected["p"][last]).max(), np.abs(motion.v[-1] - expected["v"][last]).max())
        )
    # 4 within what the next order leaves at these steps; a homogeneous ball on a plane is followed to round-off
    assert errors[0] / errors[1] >= 3.2 or errors[1] <= 1e-12
    assert errors[1] <= 5e-3


def test_both_methods_agree_across_impacts():
    """A spinning ball with friction and restitution over four bounces: the difference is bounded by a multiple of h.

    It is no smooth function of h, since impacts fall anywhere in a step; in body axes, turning at 6 rad/s, each changes
    the velocity by up to 5 m/s in a direction known to h / 2, and the error of the first times the ones to come.
    """
    scene = ball_scene(friction=pc.Coulomb(0.3), restitution=0.7)
    state = scene.initial_state(upright(0.0, 0.0, 0.5), np.array([1.0, 0.0, 0.0, 0.0, -5.0, 2.0]), free=["c"])
    exact = pc.simulate(scene, state, 1.2, t_eval=[1.2], rtol=1e-10)
    assert exact.status == 0
    for h in (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4):
        run = stepped(scene, state, 1.2, h, t_eval=[1.2])
        assert np.abs(run.v[-1] - exact.v[-1]).max() <= 150.0 * h
        assert kinds(run) == kinds(exact)


# ---------------------------------------------------------------------------------------------------- energy


def random_scene(rng):
    """Two free bodies, each an ellipsoid or up to three points over a floor, with all laws; and a state above it."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G * (rng.random() < 0.7)])
    axes, masses = rng.uniform(0.1, 0.3, (2, 3)), 10.0 ** rng.uniform(-1.0, 1.0, 2)
    for i, ((a, b, c), mass) in enumerate(zip(axes, masses)):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"joint{i}")
        inertia = np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) * mass / 5.0
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), inertia), pin.SE3.Identity())
        model.addBodyFrame(f"body{i}", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for i in range(2):
        contours = [(pc.Ellipsoid(*axes[i]), pin.SE3.Identity())]
        if rng.random() < 0.5:
            places = rng.uniform(-0.2, 0.2, (rng.integers(1, 4), 3))
            contours = [(pc.Point(), pin.SE3(np.eye(3), place)) for place in places]
        for k, (contour, placement) in enumerate(contours):
            laws = [None, pc.Coulomb(rng.uniform(0.0, 0.3)), pc.Coulomb(rng.uniform(0.3, 2.0)), pc.NoSlip()]
            attached = scene.add_contour(f"{i}.{k}", contour, f"body{i}", placement)
            restitution = float(rng.choice([0.0, rng.random(), 1.0]))
            scene.add_contact(f"{i}.{k}", attached, floor, friction=laws[rng.integers(4)], restitution=restitution)
    q, v = pin.neutral(model), np.zeros(12)
    for i in range(2):
        turn = rng.normal(size=4)
        turn /= np.linalg.norm(turn)
        q[7 * i : 7 * i + 7] = [1.0 * i, 0.0, 0.5 + 0.3 * rng.random(), *turn]
        velocity = np.array([rng.normal(), rng.normal(), -1.0 - rng.random()])
        v[6 * i : 6 * i + 6] = [*(pin.Quaternion(turn).matrix().T @ velocity), *(3.0 * rng.normal(size=3))]
    return scene, scene.initial_state(q, v, free=list(scene.contacts))


@pytest.mark.parametrize("block", range(3))
def test_friction_and_impacts_create_no_energy(block):
    """Thirty random runs: the work of contacts falls in every step; energy rises by errors of the order h only."""
    for seed in range(10 * block, 10 * block + 10):
        scene, state = random_scene(np.random.default_rng(seed))
        run = stepped(scene, state, 0.4, 1e-3, energies=True)
        energies = run.energies()
        scale = energies.kinetic.max()
        # where slip ends within a step, the impulse that ends it meets the mean of the velocities at both ends
        assert np.diff(energies.friction_work).max() <= 1e-4 * scale, seed
        lowest = np.minimum.accumulate(energies.total)
        assert (energies.total - lowest).max() <= 0.05 * scale, seed
        assert not energies.drive_work.any()


# ---------------------------------------------------------------------------------------------------- the call


def test_outputs_between_steps_leave_the_run_alone():
    scene = ball_scene(friction=pc.Coulomb(0.3), restitution=0.6)
    state = scene.initial_state(upright(0.0, 0.0, 0.3), np.array([1.0, 0.0, 0.0, 0.0, 0.0, 2.0]), free=["c"])
    times = np.array([0.0, 0.0004, 0.2, 0.2, 0.25037, 0.5])
    run, plain = stepped(scene, state, 0.5, 1e-3, t_eval=times), stepped(scene, state, 0.5, 1e-3)
    np.testing.assert_array_equal(run.t, times)
    # a shorter step changes the solver's starting point, and with it the last bits
    np.testing.assert_allclose(run.q[-1], plain.q[-1], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(run.q[2], plain.q[200], rtol=0.0, atol=1e-12)
    assert np.array_equal(run.q[2], run.q[3])


def test_user_events():
    scene = ball_scene(restitution=0.5)
    state = scene.initial_state(upright(0.0, 0.0, 1.1), free=["c"])

    def halfway(t, q, v):
        return q[2] - 0.6

    halfway.terminal = True
    run = pc.simulate(scene, state, 2.0, method="Moreau", events=[lambda t, q, v: q[2] - 0.8, halfway])
    assert run.status == 1
    times = [event.time for event in run.events]
    np.testing.assert_allclose(times, [math.sqrt(0.6 / G), math.sqrt(1.0 / G)], rtol=0.0, atol=1e-10)
    assert run.t[-1] == times[-1]


def test_failed_control_ends_the_run():
    scene = ball_scene()
    state = scene.initial_state(upright(0.0, 0.0, 0.1))
    run = pc.simulate(
        scene, state, 1.0, method="Moreau", control=lambda t, q, v: np.full(6, math.nan if t > 0.5 else 0.0)
    )
    assert run.status < 0
    assert "control returned nan" in run.message
    assert run.t[-1] == pytest.approx(0.5)


def test_bad_steps():
    scene = ball_scene()
    state = scene.initial_state(upright(0.0, 0.0, 0.1))
    for step in (0.0, -1e-3, math.nan, math.inf, "1e-3"):
        with pytest.raises(pc.ArgumentError, match="step"):
            pc.simulate(scene, state, 1.0, method="Moreau", step=step)
    with pytest.raises(pc.ArgumentError, match="rounded"):
        pc.simulate(scene, state, 1.0, method="Moreau", step=1e-19)
    with pytest.raises(pc.ArgumentError, match="Moreau"):
        pc.simulate(scene, state, 1.0, step=1e-3)
    assert pc.simulate(scene, state, 1.0, method="Moreau", max_steps=10).status < 0


def tippe_top():
    """A fast spinning ball whose centre of mass is off its centre: a free body that turns by 180 rad/s."""
    inertia = pin.Inertia(0.006, np.array([0.0, 0.0, -0.003]), np.diag([8e-7, 8e-7, 7e-7]))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia, "ball", joint="free"))
    ball, floor = scene.add_contour("ball", pc.Sphere(0.015), "ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", ball, floor, friction=pc.Coulomb(0.3))
    q = [0.0, 0.0, 0.015, math.sin(0.05), 0.0, 0.0, math.cos(0.05)]
    return scene, scene.initial_state(q, [0.0, 0.0, 0.0, 0.0, 0.0, 180.0])


@pytest.mark.parametrize("step", [1.25e-3, 2.5e-3, 5e-3, 1.25e-2, 2.5e-2])
def test_steps_in_which_bodies_turn_far(step):
    """A top that turns by up to 4.5 rad in a step: no energy is made, and it goes where it goes with short steps."""
    scene, state = tippe_top()
    run = stepped(scene, state, 0.5, step)
    total = run.energies().total
    # friction takes seven thousandths of the energy
    assert total.max() <= (1.0 + 1e-6) * total[0]
    exact = pc.simulate(scene, state, 0.5, t_eval=[0.5], rtol=1e-9)
    # second order: 2e-3 m of its way of 5e-2 m where steps are 2.5e-2 s
    assert np.abs(run.q[-1, :3] - exact.q[-1, :3]).max() <= 4.0 * step * step


def test_a_free_body_keeps_its_momenta():
    """An unsymmetric body with its centre of mass off the joint's origin tumbles: momentum and angular momentum to
    round-off however long the steps are, energy and attitude to second order; with a part that moves in it, too."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    inertia = pin.Inertia(1.5, np.array([0.2, -0.1, 0.3]), np.diag([1.0, 2.0, 2.5]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    scene, data = pc.Scene(model), model.createData()
    state = scene.initial_state([0, 0, 0, 0, 0, 0, 1], [0.3, 0.2, -0.1, 1.0, 1.2, 0.8])

    def momenta(run):
        out = []
        for q, v in zip(run.q, run.v):
            pin.computeCentroidalMomentum(model, data, q, v)
            out.append(data.hg.vector.copy())
        return np.array(out)

    errors = []
    for h in (0.1, 0.05):
        run = stepped(scene, state, 20.0, h)
        found = momenta(run)
        # rounding of 400 steps
        assert np.abs(found - found[0]).max() <= 1e-12
        exact = pc.simulate(scene, state, 20.0, t_eval=run.t, rtol=1e-9)
        errors.append(np.abs(run.q - exact.q).max())
        kinetic = run.energies().kinetic
        # no more than the step's square, and no drift: that is a part of it
        assert np.abs(kinetic / kinetic[0] - 1.0).max() <= 2.0 * h * h
    assert errors[0] / errors[1] >= 3.2


@pytest.mark.parametrize("joint", ["planar", "spherical", "free with a rod"])
def test_turning_joints_are_second_order(joint):
    """Other turning joints, and one that carries another joint, so that its composite inertia changes: with gravity and
    fast turns, against the other method."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -G, 0.0])
    kinds = {"planar": pin.JointModelPlanar(), "spherical": pin.JointModelSpherical()}
    index = model.addJoint(0, kinds.get(joint, pin.JointModelFreeFlyer()), pin.SE3.Identity(), "base")
    inertia = pin.Inertia(1.5, np.array([0.1, -0.05, 0.2]), np.diag([0.1, 0.2, 0.25]))
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    if joint == "free with a rod":
        index = model.addJoint(index, pin.JointModelRY(), pin.SE3.Identity(), "rod")
        rod = pin.Inertia(0.5, np.array([0.3, 0.0, 0.0]), np.diag([1e-3, 0.02, 0.02]))
        model.appendBodyToJoint(index, rod, pin.SE3.Identity())
    scene = pc.Scene(model)
    state = scene.initial_state(pin.neutral(model), np.linspace(1.0, 4.0, model.nv))
    exact = pc.simulate(scene, state, 1.0, t_eval=[1.0], rtol=1e-10)
    errors = []
    for h in (4e-3, 2e-3):
        run = stepped(scene, state, 1.0, h, t_eval=[1.0])
        errors.append(np.abs(np.r_[run.q[-1] - exact.q[-1], run.v[-1] - exact.v[-1]]).max())
    # 4 within what the next order leaves at these steps
    assert errors[0] / errors[1] >= 3.5


def double_pendulum():
    model, joint = pin.Model(), 0
    for i in range(2):
        joint = model.addJoint(joint, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.4 * i, 0.0, 0.0])), f"j{i}")
        inertia = pin.Inertia(1.0, np.array([0.3, 0.0, 0.0]), 0.02 * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return pc.Scene(model)


def test_too_long_steps_are_named():
    """Links that turn by more than a radian in a step, where no iteration converges: the run ends and says why."""
    scene = double_pendulum()
    run = pc.simulate(scene, scene.initial_state([0.0, 1.0], [5.0, 8.0]), 5.0, method="Moreau", step=0.2)
    assert run.status == -9
    assert "the step is too long" in run.message


def test_runaways_are_told_apart():
    """A spring that is too stiff for the step: whatever fails in the end, the message has the cause."""
    scene = body_scene(pin.JointModelFreeFlyer(), 1.0)
    state = scene.initial_state(upright(0.0, 0.0, 0.0), [0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    run = pc.simulate(
        scene, state, 100.0, method="Moreau", step=0.1, control=lambda t, q, v: np.r_[-1e3 * q[0], np.zeros(5)]
    )
    assert run.status < 0
    assert "in a step of 0.1 s" in run.message


def test_stiff_controls_are_told_apart():
    """A damping that is too stiff for explicit torques: no body turns at all, and the message does not say so."""
    scene = double_pendulum()
    run = pc.simulate(
        scene, scene.initial_state([0.3, -0.2]), 1.0, method="Moreau", control=lambda t, q, v: -1e4 * q - 1e2 * v
    )
    assert run.status == -9
    assert "the control is too stiff for steps of 0.001 s" in run.message


@pytest.mark.parametrize("law", [pc.Coulomb(0.3), pc.Coulomb(0.3, viscous=0.2), pc.Coulomb(0.0, viscous=0.5)], ids=str)
def test_two_points_of_a_turning_body_slide(law):
    """Of six relative velocities of two points of a body five are independent, and the sixth is given by its turning.
    That does not bind points that slide: steps converge to the event-driven motion, to second order."""
    inertia = pin.Inertia(1.0, np.array([0.01, 0.02, 0.03]), np.diag([0.02, 0.025, 0.03]))
    model = one_body(pin.JointModelFreeFlyer(), inertia)
    scene = pc.Scene(model)
    # in a wedge of 60 degrees about the horizontal y
    for name, side in (("left", -1.0), ("right", 1.0)):
        centre = np.array([0.15 * side, 0.05 * side, 0.0])
        tilted = pin.utils.rotate("y", -side * math.pi / 6.0)
        ball = scene.add_contour(name, pc.Sphere(0.05), "body", pin.SE3(np.eye(3), centre))
        wall = scene.add_contour(f"{name} wall", pc.Plane(), placement=pin.SE3(tilted, centre - 0.05 * tilted[:, 2]))
        scene.add_contact(name, ball, wall, friction=law)
    state = scene.initial_state(pin.neutral(model), [0.1, 1.0, 0.0, 1.0, 2.0, 1.5])
    exact = pc.simulate(scene, state, 0.1, rtol=1e-11, atol=1e-13, t_eval=[0.1])
    assert {int(track.mode[-1]) for track in exact.contacts.values()} == {2 if law.sliding else 0}
    assert exact.events == []
    off = []
    for h in (2e-3, 1e-3, 5e-4):
        run = pc.simulate(scene, state, 0.1, method="Moreau", step=h, t_eval=[0.1], energies=True)
        off.append(np.abs(run.q[-1] - exact.q[-1]).max())
        assert np.abs(run.energies().balance).max() <= 2.0 * h**2 * run.energies().kinetic[0]
    assert off[2] <= 1e-5
    # second order, but for the first step
    assert off[2] <= off[0] / 8.0


@pytest.mark.parametrize("seed", range(4))
def test_all_zeros_of_an_event_within_a_step(seed):
    """Several functions with several zeros in steps of 0.05 s: of time alone, and of a ball's height on its parabola,
    dips between samples included. Closed forms; times to what a step's own order leaves, none at all here."""
    rng = np.random.default_rng(seed)
    scene = ball_scene(restitution=0.5)
    height, speed = 5.0, 3.0
    v = np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0])
    state = scene.initial_state(upright(0.0, 0.0, height), v, free=["c"])
    zeros = np.sort(rng.uniform(0.0, 0.5, 12))
    zeros = zeros[np.append(True, np.diff(zeros) > 2e-3)]
    low, high = sorted(rng.uniform(0.005, 0.045, 2) + np.array([0.0, 1e-3]))
    # heights that are passed on the way up and down, both within one step around the top
    top = speed / G
    near = rng.uniform(1e-3, 0.02)
    level = height + 0.5 * speed**2 / G - 0.5 * G * near**2
    functions = [
        lambda t, q, v: float(np.prod(t - zeros)),
        lambda t, q, v: (t - low) * (t - high),
        lambda t, q, v: q[2] - level,
        lambda t, q, v: math.sin(2.0 * math.pi * 87.0 * (t - 1e-4)),
    ]
    run = pc.simulate(scene, state, 0.5, method="Moreau", step=0.05, events=functions)
    assert run.status == 0
    times = [[event.time for event in run.events if event.kind == "user" and event.index == i] for i in range(4)]
    np.testing.assert_allclose(times[0], zeros, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(times[1], [low, high], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(times[2], [top - near, top + near], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(times[3], 1e-4 + np.arange(87) / 174.0, rtol=0.0, atol=1e-9)


def test_a_coin_that_falls_flat_is_not_told_to_take_shorter_steps():
    """A rim that comes to lie on a plane is no point contact; the message has the conditioning, which tells."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "coin")
    body = pin.Inertia(0.01, np.zeros(3), np.diag([1e-6, 1e-6, 2e-6]))
    model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    scene = pc.Scene(model)
    rim, floor = scene.add_contour("rim", pc.Circle(0.02), "coin"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("rim/floor", rim, floor, friction=pc.Coulomb(0.3))
    tilted = pin.Quaternion(pin.utils.rotate("x", 0.1)).coeffs()
    state = scene.initial_state([0, 0, 0.02 * np.sin(0.1), *tilted])
    for dt in (1e-3, 1e-4):
        run = pc.simulate(scene, state, 1.0, method="Moreau", dt=dt)
        assert run.status == -9
        assert "'rim/floor' has the least conditioning" in run.message and "shorter steps do not help" in run.message


@pytest.mark.parametrize("options", [{}, {"method": "Moreau"}])
@pytest.mark.parametrize("at", [0.3, 0.4 + 0.8, 1.2, 2.0])
@pytest.mark.parametrize("off", [-1, 0, 1])
def test_breakpoints_and_outputs_that_round_off_parts(options, at, off):
    """An output in the last digit of a breakpoint's time is one at the breakpoint; a breakpoint there before the end is
    none."""
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia.FromSphere(1.0, 0.1)))
    ball = scene.add_contour("ball", pc.Sphere(0.1), "body")
    scene.add_contact("c", ball, scene.add_contour("floor", pc.Plane()), pc.Coulomb(0.5))
    state = scene.initial_state([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    near = math.nextafter(at, math.inf * off) if off else at
    for outputs in (None, [0.0, near, 2.0] if near < 2.0 else [0.0, 2.0]):
        run = pc.simulate(
            scene, state, 2.0, breakpoints=[at], t_eval=outputs, control=lambda t, q, v: 0.0 * v, **options
        )
        assert run.status == 0, run.message
        assert run.t[-1] == 2.0
        assert all(np.isfinite(values).all() for values in (run.q, run.v, run.contacts["c"].force))
        # rolls at 5/7 of its speed, after sliding for 2 v / (7 mu g); time stepping's error is that of a step
        slides = 2.0 / (7.0 * 0.5 * 9.81)
        way = slides - 0.5 * 0.5 * 9.81 * slides**2 + 5.0 / 7.0 * (2.0 - slides)
        assert run.q[-1, 0] == pytest.approx(way, abs=1e-5)
