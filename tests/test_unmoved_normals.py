"""Contacts whose normal no joint can move, exactly or to round-off: no force, in every method, and no false jam."""

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import linprog
from test_moreau import G, body_scene

import pincontact as pc

RADIUS, MASS, MOMENT, SPEED = 0.1, 1.0, 4e-3, 4.0
# far from the origin and turned: rows are sums of terms that cancel to round-off
SOMEWHERE = pin.SE3(pin.utils.rotate("z", 0.7), np.array([30.0, -7.0, RADIUS]))


def held_ball(joint, law, bilateral=False, centre=(0.0, 0.0, 0.0), placement=SOMEWHERE, speed=SPEED):
    """A ball on a joint at its own height over a floor."""
    model = pin.Model()
    index = model.addJoint(0, joint, placement, "joint")
    inertia = pin.Inertia(MASS, np.array(centre), MOMENT * np.eye(3))
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    model.addBodyFrame("ball", index, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), "ball", pin.SE3(np.eye(3), np.array(centre)))
    scene.add_contact("c", ball, scene.add_contour("floor", pc.Plane()), friction=law, bilateral=bilateral)
    return scene, scene.initial_state(pin.neutral(model), np.full(model.nv, speed))


LAWS = [
    None,
    pc.Coulomb(0.3),
    pc.Coulomb(5.0),
    pc.Coulomb(0.2, 0.4),
    pc.Stribeck(0.2, 0.4, 0.1),
    pc.Coulomb((0.3, 0.5)),
]


@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize(
    "joint", [pin.JointModelRX(), pin.JointModelRZ(), pin.JointModelSpherical()], ids=lambda joint: joint.shortname()
)
def test_ball_that_turns_in_place(joint, law, bilateral):
    """What presses it on the floor is its joint's business: F_n = 0, no friction, and it turns for ever."""
    scene, state = held_ball(joint, law, bilateral)
    for options in ({}, {"method": "Moreau"}):
        run = pc.simulate(scene, state, 0.5, t_eval=[0.0, 0.2, 0.5], **options)
        assert run.status == 0, run.message
        # unilateral or not, round-off has no sign to open by
        assert run.events == []
        # steps of two methods through up to a radian, in body axes
        np.testing.assert_allclose(run.v, SPEED, rtol=0.0, atol=1e-9)
        track = run.contacts["c"]
        assert not track.normal_force.any()
        assert not track.tangential_force.any()
        assert np.abs(track.gap).max() <= 1e-13


def test_viscous_friction_acts_all_the_same():
    """w = w_0 exp(-c R^2 t / J)"""
    scene, state = held_ball(pin.JointModelRX(), pc.Coulomb(0.3, viscous=0.1))
    run = pc.simulate(scene, state, 0.5, rtol=1e-10, atol=1e-12)
    assert run.status == 0, run.message
    expected = SPEED * np.exp(-0.1 * RADIUS**2 / MOMENT * run.t)
    np.testing.assert_allclose(run.v[:, 0], expected, rtol=0.0, atol=1e-9)


def test_ideal_rolling_of_a_held_ball_stops_it():
    for method in ("DOP853", "Moreau"):
        scene, state = held_ball(pin.JointModelRX(), pc.NoSlip())
        run = pc.simulate(scene, state, 0.1, method=method)
        assert run.status == 0, run.message
        assert np.abs(run.v).max() <= 1e-15


def test_ball_welded_to_the_world_meets_a_belt():
    """No joint at all: the belt slides under the ball, and nothing moves."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "elsewhere")
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    scene = pc.Scene(model)
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), placement=SOMEWHERE)
    belt = scene.add_contour("belt", pc.Plane(), motion=pc.ConstantTwist([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]))
    scene.add_contact("c", ball, belt, friction=pc.Coulomb(0.3))
    run = pc.simulate(scene, scene.initial_state([0.0], [0.5]), 0.5)
    assert run.status == 0, run.message
    assert not run.contacts["c"].force.any()
    np.testing.assert_allclose(run.q[-1], 0.25, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("lever", [1e-3, 1e-6, 1e-9])
def test_a_short_lever_is_no_round_off(lever):
    """A ball whose centre is off its axis rests on the floor with all its weight, however short the lever."""
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, RADIUS]))
    scene, state = held_ball(pin.JointModelRX(), None, centre=(0.0, lever, 0.0), placement=place, speed=0.0)
    run = pc.simulate(scene, state, 0.1)
    assert run.status == 0, run.message
    # the lever is known to the round-off of a tenth of a metre
    np.testing.assert_allclose(run.contacts["c"].normal_force, MASS * G, rtol=1e-15 / lever)


def test_a_jam_is_still_found():
    """Painleve's rod, steep enough at mu = 3: its normal can move, and no force is found."""
    angle, half, mu = 1.0, 0.5, 3.0
    scene = body_scene(pin.JointModelFreeFlyer(), 1.0, (1e-3, half**2 / 3.0, half**2 / 3.0))
    tip = scene.add_contour("tip", pc.Point(), "body", pin.SE3(np.eye(3), np.array([half, 0.0, 0.0])))
    scene.add_contact("c", tip, scene.add_contour("floor", pc.Plane()), friction=pc.Coulomb(mu))
    # 1 + 3 cos(a)^2 - 3 mu sin(a) cos(a) is what a unit of normal force does to the gap
    assert 1.0 + 3.0 * math.cos(angle) * (math.cos(angle) - mu * math.sin(angle)) < 0.0
    rotation = pin.utils.rotate("y", angle)
    q = np.concatenate([[0.0, 0.0, half * math.sin(angle)], pin.Quaternion(rotation).coeffs()])
    for speed, status in ((1.0, -4), (-1.0, 0)):
        run = pc.simulate(scene, scene.initial_state(q, [*(rotation.T @ [speed, 0.0, 0.0]), 0.0, 0.0, 0.0]), 0.01)
        assert run.status == status, (speed, run.message)


@pytest.mark.parametrize("mu", [0.3, 0.6])
@pytest.mark.parametrize("options", [{}, {"method": "Moreau", "step": 0.01}])
def test_a_tangent_along_which_nothing_moves(mu, options):
    """A block guided in a vertical plane, on a plane in space, is pushed with 5 N: a = (5 - mu g) / 1 kg, or rest."""
    model = pin.Model()
    index = 0
    for joint, name in ((pin.JointModelPX(), "x"), (pin.JointModelPZ(), "z")):
        index = model.addJoint(index, joint, pin.SE3.Identity(), name)
    model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("block", index, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    foot, floor = scene.add_contour("foot", pc.Point(), "block"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", foot, floor, friction=pc.Coulomb(mu))
    times = np.array([0.0, 0.5, 1.0])
    run = pc.simulate(
        scene,
        scene.initial_state([0.0, 0.0], [0.0, 0.0]),
        1.0,
        t_eval=times,
        control=lambda t, q, v: np.array([5.0, 0.0]),
        **options,
    )
    # constant acceleration: both methods are exact but for round-off, and the seed of slip, whose error is its cube
    expected = 0.5 * max(5.0 - mu * G, 0.0) * times**2
    np.testing.assert_allclose(run.q[:, 0], expected, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(run.contacts["c"].tangential_force, min(mu * G, 5.0), rtol=0.0, atol=1e-11)
    assert (run.contacts["c"].mode == (2 if mu * G < 5.0 else 1)).all()


@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize(
    "law",
    [pc.Coulomb(0.5, spinning=0.01), pc.Coulomb(0.5, spinning=0.01, rolling=0.01), pc.NoSlip(spinning=0.01)],
    ids=str,
)
@pytest.mark.parametrize("seed", range(2))
def test_arm_in_a_plane_cannot_spin_about_the_normal(seed, law, bilateral):
    """Three links whose axes are parallel, in axes of the world in which the cosines between them and the normal are
    round-off: the contact resists no spinning, and both methods tell the same motion."""
    rng = np.random.default_rng(seed)
    turned = pin.exp3(rng.normal(size=3))
    model, joint = pin.Model(), 0
    model.gravity.linear = turned @ np.array([0.0, 0.0, -G])
    link = turned @ np.array([0.4, 0.0, 0.0])
    for k in range(3):
        place = pin.SE3(np.eye(3), link if k else np.zeros(3))
        joint = model.addJoint(joint, pin.JointModelRevoluteUnaligned(turned[:, 1]), place, f"{k}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, 0.5 * link, 0.02 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, 0, pin.SE3(np.eye(3), link), pin.FrameType.OP_FRAME))
    q, data = np.array([-0.5, 1.0, 0.4]), model.createData()
    pin.framesForwardKinematics(model, data, q)
    tip = data.oMf[model.getFrameId("tip")].translation
    scene = pc.Scene(model)
    ball = scene.add_contour("tip", pc.Sphere(0.05), "tip")
    floor = scene.add_contour("floor", pc.Plane(), placement=pin.SE3(turned, tip - 0.05 * turned[:, 2]))
    scene.add_contact("c", ball, floor, friction=law, bilateral=bilateral)
    state = scene.initial_state(q)
    runs = [pc.simulate(scene, state, 0.1, t_eval=[0.05, 0.1], **options) for options in ({}, {"method": "Moreau"})]
    for run in runs:
        assert run.status == 0, run.message
        # no part about the normal
        assert np.abs(run.contacts["c"].torque @ turned[:, 2]).max() <= 1e-12
    # steps of 1 ms, to second order
    np.testing.assert_allclose(runs[0].v, runs[1].v, rtol=0.0, atol=2e-4)
    found = pc.inverse_dynamics(scene, state)
    assert all(abs(turn.torque @ turned[:, 2]) <= 1e-12 for turn in found.held)


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize(
    ("shape", "angles"), [("ball", (-0.7, 0.7)), ("ball", (-0.9, 0.1, 0.8)), ("tip", (-0.9, 0.1, 0.8))]
)
def test_no_force_across_a_mechanism(shape, angles, swapped):
    """What a slider in a plane is held by has nothing across that plane, however its loads change and its contours are
    named. It slips where no forces in the plane hold it, in any method of choosing among them."""
    model, mu, radius = pin.Model(), 0.5, 0.1 if shape == "ball" else 0.0
    model.gravity.linear = np.zeros(3)
    joint = 0
    for kind, name in ((pin.JointModelPX(), "x"), (pin.JointModelPZ(), "z")):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    scene, load = pc.Scene(model), np.zeros(2)
    tip = scene.add_contour("tip", pc.Sphere(radius) if radius else pc.Point(), "body")
    for i, angle in enumerate(angles):
        normal = np.array([math.sin(angle), 0.0, math.cos(angle)])
        load -= 3.0 * normal[[0, 2]]
        place = pin.SE3(pin.utils.rotate("y", angle), -radius * normal)
        pair = [tip, scene.add_contour(f"face {i}", pc.Plane(), placement=place)]
        scene.add_contact(f"c{i}", *(pair[::-1] if swapped else pair), pc.Coulomb(mu))
    run = pc.simulate(
        scene, scene.initial_state([0.0, 0.0]), 0.5, control=lambda t, q, v: load + 10.0 * t * np.array([1.0, 0.7])
    )
    assert run.status == 0, run.message
    for track in run.contacts.values():
        assert np.abs(track.force[:, 1]).max() <= 1e-12

    def holds(t):
        """Forces of edges of the cones in the plane that balance the load."""
        edges = [
            [math.sin(angle) + side * mu * math.cos(angle), math.cos(angle) - side * mu * math.sin(angle)]
            for angle in angles
            for side in (1.0, -1.0)
        ]
        wanted = -(load + 10.0 * t * np.array([1.0, 0.7]))
        return linprog(np.zeros(len(edges)), A_eq=np.array(edges).T, b_eq=wanted).status == 0

    first = next((event.time for event in run.events if event.kind in ("slip", "separate")), 0.5)
    assert holds(first - 1e-6)
    assert first == 0.5 or not holds(first + 1e-6)


def test_a_nut_that_turns_fast_on_its_screw():
    """The normal of the helix that points to its axis moves nothing where the nut is on it, but at places beside: long
    steps, which nothing else limits, have to be shorter."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        radius, mass = 10.0 ** rng.uniform(-2.0, 0.0), rng.uniform(0.3, 3.0)
        lead, moment = radius * rng.uniform(0.05, 2.0) * rng.choice([-1, 1]), mass * radius**2 * rng.uniform(0.3, 3.0)
        model = pin.Model()
        along = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "along")
        about = model.addJoint(along, pin.JointModelRZ(), pin.SE3.Identity(), "about")
        model.appendBodyToJoint(about, pin.Inertia(mass, np.zeros(3), moment * np.eye(3)), pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([radius, 0.0, 0.0]))
        model.addFrame(pin.Frame("tip", about, place, pin.FrameType.OP_FRAME))
        scene = pc.Scene(model)
        helix, tip = pc.Helix(radius, 2.0 * math.pi * lead), scene.add_contour("tip", pc.Point(), "tip")
        scene.add_contact("c", scene.add_contour("helix", helix), tip, friction=pc.Coulomb(0.3))
        turns = rng.uniform(20.0, 100.0)
        state = scene.initial_state([0.0, 0.0], [lead * turns, turns])
        run = pc.simulate(scene, state, 0.3)
        assert run.status == 0, run.message
        exact = pc.simulate(scene, state, 0.3, method="RK45", max_step=1e-3, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(run.q[-1], exact.q[-1], rtol=1e-5, atol=1e-8)
