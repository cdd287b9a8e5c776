"""Equilibria and steady motions against closed forms."""

import functools
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import scipy
from shared import one_body
from test_inverse import bicycle

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf"
G = 9.81
LEVEL = [0.0, 0.0, 0.0, 1.0]


def ball_on(surface, friction=None, placement=None, side=None):
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    ball = scene.add_contour("ball", pc.Sphere(0.1), "ball")
    ground = scene.add_contour("ground", surface, placement=placement)
    scene.add_contact("c", ball, ground, friction=friction, side=side)
    return scene


@pytest.mark.parametrize("friction", [None, pc.Coulomb(0.3), pc.NoSlip()])
def test_ball_finds_the_lowest_point(friction):
    """From 30 degrees up the wall of a bowl that is not round. The residual is at rounding, the point where the slope
    vanishes."""
    scene = ball_on(pc.Ellipsoid(1.2, 0.9, 0.7), friction, pin.SE3(np.eye(3), np.array([0.5, -0.2, 0.7])), side=-1)
    start = [0.9, 0.1, 0.22, *LEVEL]
    found = pc.find_equilibrium(scene, scene.initial_state(start, max_gap=0.2).q)
    np.testing.assert_allclose(found.state.q[:3], [0.5, -0.2, 0.1], rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(found.forces["c"], [0.0, 0.0, -0.5 * G], rtol=0.0, atol=1e-9)
    assert found.holds
    assert found.residual < 1e-10
    assert np.abs(found.state.v).max() == 0.0


def test_nearest_of_a_family():
    """On a plane a ball stays where it is, but for the gap."""
    scene = ball_on(pc.Plane(), pc.Coulomb(0.3))
    found = pc.find_equilibrium(scene, [0.3, -0.4, 0.101, *LEVEL])
    np.testing.assert_allclose(found.state.q, [0.3, -0.4, 0.1, *LEVEL], rtol=0.0, atol=1e-12)


def test_no_equilibrium():
    tilted = pin.SE3(pin.utils.rotate("y", 0.2), np.zeros(3))
    scene = ball_on(pc.Plane(), None, tilted)
    q = np.r_[0.1 * tilted.rotation[:, 2], LEVEL]
    with pytest.raises(pc.SolverError, match=r"no equilibrium was found .* the residual is 1\.9.*actuation="):
        pc.find_equilibrium(scene, q)
    with pytest.raises(pc.NoContactError, match="leave out those that are open") as caught:
        pc.find_equilibrium(scene, [0.0, 0.0, 5.0, *LEVEL])
    assert caught.value.gap == pytest.approx(5.0 * np.cos(0.2) - 0.1)


@pytest.mark.parametrize(("mu", "holds"), [(0.21, True), (0.2, False)])
def test_whether_friction_holds(mu, holds):
    """A bead on a slope of 0.2 rad stays if mu > tan 0.2 = 0.2027."""
    tilted = pin.SE3(pin.utils.rotate("y", 0.2), np.zeros(3))
    scene = pc.Scene.from_urdf(URDF / "bead.urdf", floating_base=True)
    bead, slope = (
        scene.add_contour("bead", pc.Point(), "bead"),
        scene.add_contour("slope", pc.Plane(), placement=tilted),
    )
    scene.add_contact("c", bead, slope, friction=pc.Coulomb(mu))
    found = pc.find_equilibrium(scene, [0.0, 0.0, 0.0, *LEVEL])
    assert found.holds == holds
    np.testing.assert_allclose(found.forces["c"], [0.0, 0.0, -0.1 * G], rtol=0.0, atol=1e-10)


def test_holding_torque():
    """A motor holds an eccentric cam under the weight of its follower: m g e cos(angle)."""
    scene = pc.Scene.from_urdf(URDF / "cam_follower.urdf")
    model = scene.model
    model.gravity.linear = np.array([0.0, -G, 0.0])
    cam = scene.add_contour("cam", pc.Circle(0.06), "cam", pin.SE3(np.eye(3), np.array([0.02, 0.0, 0.0])))
    face = scene.add_contour("face", pc.Line(), "follower")
    scene.add_contact("c", cam, face)
    shaft, guide = (model.joints[model.getJointId(name)] for name in ("shaft", "guide"))
    q = pin.neutral(model)
    q[guide.idx_q] = 0.06
    wanted = 0.7

    def angle(q):
        return [math.atan2(q[shaft.idx_q + 1], q[shaft.idx_q]) - wanted]

    found = pc.find_equilibrium(scene, q, actuation=["shaft"], conditions=angle)
    assert found.state.q[guide.idx_q] == pytest.approx(0.06 + 0.02 * math.sin(wanted), abs=1e-12)
    assert found.tau[shaft.idx_v] == pytest.approx(0.5 * G * 0.02 * math.cos(wanted), rel=1e-10)
    assert found.tau[guide.idx_v] == 0.0
    # without the motor the cam turns until the weight has no arm
    hanging = pc.find_equilibrium(scene, found.state.q)
    assert abs(math.cos(angle(hanging.state.q)[0] + wanted)) < 1e-9


def test_steady_disk():
    """(J3 + m R^2) W w3 = J1 W^2 cos(tilt) - m g R cot(tilt), tilt and spin given, the precession found."""
    scene = pc.Scene.from_urdf(URDF / "disk.urdf", floating_base=True)
    rim, floor = scene.add_contour("rim", pc.Circle(0.3), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", rim, floor, friction=pc.Coulomb(0.8))
    tilt, spin = 1.2, 8.0
    q = np.r_[0.0, 0.0, 0.3 * math.sin(tilt), pin.Quaternion(pin.utils.rotate("y", tilt)).coeffs()]
    omega = np.array([0.8, 0.0, spin])

    def kept(q, v):
        return [pin.Quaternion(q[3:]).matrix()[2, 2] - math.cos(tilt), v[5] - spin]

    found = pc.find_steady_motion(scene, q, np.r_[-np.cross(omega, [0.3, 0.0, 0.0]), omega], conditions=kept)
    rotation = pin.Quaternion(found.state.q[3:]).matrix()
    axis, turning = rotation[:, 2], rotation @ found.state.v[3:]
    # precession about the vertical: what the angular velocity is made of besides spin
    across = np.cross(axis, [0.0, 0.0, 1.0])
    precession = float(np.cross(axis, turning) @ across / (across @ across))
    loads = 0.045 * precession**2 * math.cos(tilt) - 2.0 * G * 0.3 / math.tan(tilt)
    assert precession == pytest.approx(loads / (0.27 * spin), rel=1e-9)
    assert found.holds
    run = pc.simulate(scene, found.state, 2.0, rtol=1e-10, atol=1e-12)
    assert run.events == []
    # marginally stable: what is off by 1e-10 stays so, but for the integration's 1e-10 a step
    tilts = np.array([pin.Quaternion(q[3:]).matrix()[2, 2] for q in run.q])
    assert np.abs(tilts - math.cos(tilt)).max() < 1e-8
    np.testing.assert_allclose(run.v[-1, 5], spin, rtol=0.0, atol=1e-7)


def test_bicycle_in_a_turn():
    """Handlebar held at an angle by a torque, at a given speed: leaning inwards, the contacts' forces turn the mass."""
    scene, start = bicycle()
    model = scene.model
    rear, steer, front = (model.joints[model.getJointId(n)] for n in ("rear_axle", "steer", "front_axle"))
    v = np.zeros(model.nv)
    v[0], v[rear.idx_v], v[front.idx_v] = 5.0, 5.0 / 0.3, 5.0 / 0.35

    def kept(q, v):
        return [q[steer.idx_q] - 0.1, v[rear.idx_v] - 5.0 / 0.3]

    found = pc.find_steady_motion(scene, start.q, v, conditions=kept, actuation=["steer"])
    assert found.residual < 1e-9
    assert found.holds
    assert np.count_nonzero(found.tau) == 1
    data = model.createData()
    q, v = found.state.q, found.state.v
    lean = math.asin(pin.Quaternion(q[3:7]).matrix()[2, 1])
    pin.centerOfMass(model, data, q, v)
    velocity = data.vcom[0].copy()
    turning = float((pin.Quaternion(q[3:7]).matrix() @ v[3:6])[2])
    assert turning > 0.0 > lean
    # m (W x v) and the weight, on the bicycle; forces are on the floor
    total = -sum(found.forces.values())
    expected = 94.0 * np.cross([0.0, 0.0, turning], velocity) + [0.0, 0.0, 94.0 * G]
    np.testing.assert_allclose(total, expected, rtol=0.0, atol=1e-6)
    run = pc.simulate(scene, found.state, 1.0, rtol=1e-9, control=lambda t, q, v: found.tau)
    np.testing.assert_allclose(run.v[-1], v, rtol=0.0, atol=1e-6)


def test_equilibria_beyond_a_joints_limits_are_none():
    """A pendulum that cannot reach its lowest point; a model without joints is at rest."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.0, -0.3]), 0.01 * np.eye(3)), pin.SE3.Identity())
    assert abs(pc.find_equilibrium(pc.Scene(model), [0.3]).state.q[0]) < 1e-9
    model.lowerPositionLimit, model.upperPositionLimit = np.array([0.1]), np.array([1.0])
    with pytest.raises(pc.StateError, match=r"joint 'hinge'.*beyond the position limits"):
        pc.find_equilibrium(pc.Scene(model), [0.3])
    assert pc.find_equilibrium(pc.Scene(pin.Model()), []).residual == 0.0
    with pytest.raises(pc.SolverError, match="no equilibrium was found"):
        pc.find_equilibrium(pc.Scene(pin.Model()), [], conditions=lambda q: [1.0])


def test_conditions_must_be_numbers():
    scene = ball_on(pc.Plane())
    with pytest.raises(pc.ArgumentError, match="conditions must return numbers, got 'height'"):
        pc.find_equilibrium(scene, [0.0, 0.0, 0.1, *LEVEL], conditions=lambda q: "height")
    with pytest.raises(pc.StateError, match=r"conditions\[0\] is nan"):
        pc.find_equilibrium(scene, [0.0, 0.0, 0.1, *LEVEL], conditions=lambda q: math.nan)


@pytest.mark.parametrize("seed", range(4))
def test_where_nothing_changes_nothing_moves(seed):
    """A load on three sliding joints: its height does not matter to its accelerations. Held but for round-off it stays
    where it is, and where it falls there is no equilibrium."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    turned = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    joint = model.addJoint(0, pin.JointModelTranslation(), turned, "load")
    model.appendBodyToJoint(joint, pin.Inertia(1.7, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    scene, q = pc.Scene(model), np.array([0.1, 0.2, 0.3])
    hold = turned.rotation.T @ [0.0, 0.0, 1.7 * G]
    found = pc.find_equilibrium(scene, q, hold * (1.0 + 4e-16))
    np.testing.assert_allclose(found.state.q, q, rtol=0.0, atol=1e-15)
    with pytest.raises(pc.SolverError, match="no equilibrium"):
        pc.find_equilibrium(scene, q, 0.5 * hold)


def five_bar(base, links):
    """Two chains of two links (length in m, mass in kg, moment of inertia in kg m^2) each, hung up side by side, whose
    ends a pin joins; and how far these are apart."""
    model, ends = pin.Model(), []
    for name, x, chain in (("a", -base / 2, links[:2]), ("b", base / 2, links[2:])):
        parent, at = 0, np.array([x, 0.0, 0.0])
        for k, (length, mass, inertia) in enumerate(chain):
            parent = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), at), f"{name}{k}")
            body = pin.Inertia(mass, np.array([length / 2, 0.0, 0.0]), inertia * np.eye(3))
            model.appendBodyToJoint(parent, body, pin.SE3.Identity())
            model.addBodyFrame(f"{name}{k}", parent, pin.SE3.Identity(), 0)
            at = np.array([length, 0.0, 0.0])
        ends.append((parent, at))
    scene = pc.Scene(model)
    end = scene.add_contour("end", pc.Point(), "a1", pin.SE3(np.eye(3), ends[0][1]))
    for axis, angle in (("x", math.pi / 2), ("y", -math.pi / 2)):
        placement = pin.SE3(pin.utils.rotate(axis, angle), ends[1][1])
        slot = scene.add_contour(f"slot {axis}", pc.Line(), "b1", placement)
        scene.add_contact(axis, end, slot, bilateral=True)
    data = model.createData()

    def apart(q):
        pin.forwardKinematics(model, data, q)
        one, two = (data.oMi[joint].act(at) for joint, at in ends)
        return (one - two)[[0, 2]]

    return scene, apart


def closed_near(apart, q):
    return scipy.optimize.least_squares(apart, q, xtol=1e-15, ftol=1e-15, gtol=1e-15).x


def lowest_near(scene, apart, q):
    """The least potential on the constraint."""
    data = scene.model.createData()
    closed, options = {"type": "eq", "fun": apart}, {"ftol": 1e-14, "maxiter": 500}
    potential = functools.partial(pin.computePotentialEnergy, scene.model, data)
    return scipy.optimize.minimize(potential, q, constraints=closed, method="SLSQP", options=options).x


@pytest.mark.parametrize("seed", range(3))
def test_five_bar_hangs_where_its_potential_is_least(seed):
    """From up to 0.3 rad away. Where a potential is least is known to the root of the accuracy of its value."""
    rng = np.random.default_rng(seed)
    links = [(length, mass, mass * length**2 / 12.0) for length, mass in rng.uniform([0.2, 0.2], [0.4, 0.6], (4, 2))]
    scene, apart = five_bar(rng.uniform(0.1, 0.4), links)
    lowest = lowest_near(scene, apart, closed_near(apart, [1.6, -0.3, 1.5, 0.3]))
    start = closed_near(apart, lowest + rng.uniform(-0.3, 0.3, 4))
    found = pc.find_equilibrium(scene, start)
    np.testing.assert_allclose(found.state.q, lowest, rtol=0.0, atol=1e-5)


def test_search_stays_on_the_constraints():
    """From far away: accelerations vanish, too, where the pin has left its slots, from where no way leads back."""
    links = [(0.3, 0.4, 3e-3), (0.3, 0.3, 2.5e-3)] * 2
    scene, apart = five_bar(0.3, links)
    start = [2.0, -1.3, *closed_near(lambda q: apart(np.r_[2.0, -1.3, q]), [1.4, 1.1])]
    found = pc.find_equilibrium(scene, start)
    lowest = lowest_near(scene, apart, closed_near(apart, [1.6, -0.9, 1.4, 1.1]))
    np.testing.assert_allclose(found.state.q, lowest, rtol=0.0, atol=1e-5)


def test_moving_start_without_symmetries():
    """A pendulum that swings is no steady motion, and its rest is no answer to that."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.0, -0.3]), 0.01 * np.eye(3)), pin.SE3.Identity())
    with pytest.raises(pc.StateError, match="no symmetry is seen: find_equilibrium finds where it is at rest"):
        pc.find_steady_motion(pc.Scene(model), [0.1], [2.0])
    assert abs(pc.find_steady_motion(pc.Scene(model), [0.1], [0.0]).state.q[0]) < 1e-9


def test_what_slides_in_a_steady_motion_is_what_slides_at_the_start():
    """A ball that rolls on straight, sought from where it nearly rolls: with friction that slides it is not steady."""
    for law, slides in ((pc.NoSlip(), False), (pc.Coulomb(0.5), True)):
        model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)))
        scene = pc.Scene(model)
        ball = scene.add_contour("ball", pc.Sphere(0.1), "body")
        scene.add_contact("c", ball, scene.add_contour("floor", pc.Plane()), law)
        q, v = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0], [0.1, 0.0, 0.0, 0.0, 1.01, 0.0]
        if slides:
            with pytest.raises(pc.SolverError, match="contacts that slide, as with v0: 'c'"):
                pc.find_steady_motion(scene, q, v, conditions=lambda q, v: [v[0] - 0.1])
        else:
            found = pc.find_steady_motion(scene, q, v, conditions=lambda q, v: [v[0] - 0.1])
            assert found.state.v[4] == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("side", [None, 1])
def test_a_search_does_not_go_through_bodies(side):
    """To where an ellipsoid would hang below a saddle: it stands on it, with its centre above the point of contact."""
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)))
    scene, axes = pc.Scene(model), np.array([0.1, 0.15, 0.2])
    turned = pin.exp3(1.2 * np.random.default_rng(1).normal(size=3))
    scene.add_contour("ellipsoid", pc.Ellipsoid(*axes), "body")
    scene.add_contour("saddle", pc.HeightField(lambda x, y: 0.5 * x * x - 0.5 * y * y))
    scene.add_contact("c", "ellipsoid", "saddle", side=side)
    start = [0.0, 0.0, float(np.linalg.norm(axes * turned[2])), *pin.Quaternion(turned).coeffs()]
    found = pc.find_equilibrium(scene, start)
    # one of its axes is vertical
    assert np.abs(axes - found.state.q[2]).min() < 1e-9
    np.testing.assert_allclose(found.forces["c"], [0.0, 0.0, -9.81], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_a_ball_in_a_bowl_ends_in_it(seed):
    """With its mass off its middle, it may have gone round its poles on the way."""
    rng = np.random.default_rng(seed)
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, 0.02 * rng.normal(size=3), 0.01 * np.eye(3)))
    scene, (a, b), c = pc.Scene(model), rng.uniform(0.3, 1.2, 2), rng.uniform(-0.2, 0.2)
    scene.add_contour("ball", pc.Sphere(0.15), "body")
    scene.add_contour("bowl", pc.HeightField(lambda x, y: 0.5 * (a * x * x + b * y * y) + c * x * y))
    scene.add_contact("c", "ball", "bowl")
    start = [0.0, 0.0, 0.15, *pin.Quaternion(pin.exp3(rng.normal(size=3))).coeffs()]
    assert pc.find_equilibrium(scene, start).state.q[2] == pytest.approx(0.15, abs=1e-9)


def test_an_equilibrium_beyond_an_end_is_none():
    """The lowest point of what a bowl would go on as."""
    scene = pc.Scene(one_body(pin.JointModelTranslation(), pin.Inertia.FromSphere(0.1, 0.05)))
    scene.add_contour("ball", pc.Sphere(0.05), "body")
    piece = pc.ParametricSurface(lambda x, y: (x, y, 0.5 * (x * x + y * y)), domain=((0.2, 1.0), (-1.0, 1.0)))
    scene.add_contour("bowl", piece)
    scene.add_contact("c", "ball", "bowl")
    with pytest.raises(pc.SolverError, match="contact 'c' is beyond the end of a contour"):
        pc.find_equilibrium(scene, scene.initial_state([0.5, 0.0, 0.2], max_gap=1.0).q)


def test_friction_holds_a_ladder_or_does_not():
    """Forces are redundant with friction at both ends: the ladder stands from (1 - mu1 mu2) / (2 mu1) = tan(angle) on,
    by forces inside both cones."""
    rng, standing = np.random.default_rng(3), 0
    length = 2.0
    for _ in range(30):
        floor_mu, wall_mu = rng.uniform(0.2, 0.9, 2)
        least = math.atan((1.0 - floor_mu * wall_mu) / (2.0 * floor_mu))
        angle = least + rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 0.15)
        lever = pin.Inertia(10.0, np.array([0.5 * length, 0.0, 0.0]), 10.0 * length**2 / 12.0 * np.eye(3))
        model = one_body(pin.JointModelPlanar(), lever, "ladder")
        model.gravity.linear = np.array([0.0, -G, 0.0])
        scene = pc.Scene(model)
        turned = pin.SE3(pin.utils.rotate("x", -0.5 * math.pi), np.zeros(3))
        facing = pin.SE3(pin.utils.rotate("y", 0.5 * math.pi), np.zeros(3))
        foot = scene.add_contour("foot", pc.Point(), "ladder")
        top = scene.add_contour("top", pc.Point(), "ladder", pin.SE3(np.eye(3), np.array([length, 0.0, 0.0])))
        floor, wall = (
            scene.add_contour(f"plane{i}", pc.Plane(), placement=at) for i, at in enumerate((turned, facing))
        )
        scene.add_contact("floor", foot, floor, friction=pc.Coulomb(floor_mu))
        scene.add_contact("wall", top, wall, friction=pc.Coulomb(wall_mu))
        turn = math.pi - angle
        q = np.array([length * math.cos(angle), 0.0, math.cos(turn), math.sin(turn)])
        found = pc.find_equilibrium(scene, q)
        assert found.holds == (angle > least)
        if found.holds:
            standing += 1
            (across, up, _), (push, hold, _) = -found.forces["floor"], -found.forces["wall"]
            assert abs(across) <= floor_mu * up * (1.0 + 1e-9) and abs(hold) <= wall_mu * push * (1.0 + 1e-9)
            assert up + hold == pytest.approx(10.0 * G, rel=1e-12)
    assert 5 < standing < 25
