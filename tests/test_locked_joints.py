"""Joints whose limits coincide are locked: what they carry moves as if it were welded, in all that scenes are for."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest
from random_scenes import axis, placement
from scipy.special import ellipj, ellipk

import pincontact as pc
from pincontact.analysis.instant import Instant
from pincontact.analysis.symmetry import find_symmetries
from pincontact.dynamics.joints import END_SLACK, JointLock, joint_limits, joint_locks

GRAVITY = 9.81
LENGTH, MASS, BEND = 0.5, 2.0, 0.7


def lock(model, joint, value):
    k = model.joints[model.getJointId(joint)].idx_q
    model.lowerPositionLimit[k] = model.upperPositionLimit[k] = value


def double_pendulum():
    """Two point masses, each at the end of a rod without inertia; the second rod is locked, bent by BEND."""
    model, joint, place = pin.Model(), 0, pin.SE3.Identity()
    for name in ("shoulder", "elbow"):
        joint = model.addJoint(joint, pin.JointModelRY(), place, name)
        model.addJointFrame(joint)
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -LENGTH]))
        model.appendBodyToJoint(joint, pin.Inertia(MASS, place.translation, np.zeros((3, 3))), pin.SE3.Identity())
    lock(model, "elbow", BEND)
    return model


def masses(shoulder):
    """(2, 2) x and z of both masses from the shoulder; angles about y."""
    first, second = shoulder, shoulder + BEND
    elbow = -LENGTH * np.array([math.sin(first), math.cos(first)])
    return np.array([elbow, elbow - LENGTH * np.array([math.sin(second), math.cos(second)])])


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Moreau"])
def test_a_locked_double_pendulum_is_one_rigid_pendulum(method):
    """Let go at an angle of 1 rad from where it hangs; the angle is Jacobi's elliptic sine."""
    scene = pc.Scene(double_pendulum())
    centre = masses(0.0).mean(axis=0)
    inertia, arm = MASS * float((masses(0.0) ** 2).sum()), float(np.hypot(*centre))
    rate, hanging = math.sqrt(2.0 * MASS * GRAVITY * arm / inertia), -math.atan2(-centre[0], -centre[1])
    times, amplitude = np.linspace(0.0, 2.0, 21), 1.0
    tolerances = {"dt": 1e-3} if method == "Moreau" else {"rtol": 1e-10, "atol": 1e-12}
    start = scene.initial_state([hanging + amplitude, BEND])
    run = pc.simulate(scene, start, 2.0, method=method, t_eval=times, **tolerances)
    assert run.status == 0 and not run.events
    modulus = math.sin(0.5 * amplitude) ** 2
    sn = ellipj(ellipk(modulus) - rate * times, modulus)[0]
    expected = hanging + 2.0 * np.arcsin(math.sqrt(modulus) * sn)
    # of second order in steps of a millisecond
    np.testing.assert_allclose(run.q[:, 0], expected, rtol=0.0, atol=2e-5 if method == "Moreau" else 1e-8)
    assert (run.q[:, 1] == BEND).all() and not run.v[:, 1].any()


def test_a_lock_carries_the_torque_of_statics():
    """Held at the shoulder, the elbow bears the second mass; its own motor is not needed."""
    scene = pc.Scene(double_pendulum())
    at = masses(0.3)
    found = pc.inverse_dynamics(scene, scene.initial_state([0.3, BEND]))
    assert found.efforts[0] == pytest.approx(-MASS * GRAVITY * at[:, 0].sum(), rel=1e-12)
    assert found.efforts[1] == 0.0 and found.residual < 1e-12
    assert found.joint_forces[1] == pytest.approx(-MASS * GRAVITY * (at[1, 0] - at[0, 0]), rel=1e-12)
    # alone it cannot hold anything, nor give way
    with pytest.raises(pc.SolverError, match="actuators"):
        pc.inverse_dynamics(scene, scene.initial_state([0.3, BEND]), [0.0, 0.0], actuation=["elbow"])
    with pytest.raises(pc.StateError, match="'elbow', which is locked"):
        pc.inverse_dynamics(scene, scene.initial_state([0.3, BEND]), [0.0, 1.0])
    missed = pc.inverse_dynamics(scene, scene.initial_state([0.3, BEND]), {"elbow": [0.5]})
    assert missed.missed == pytest.approx(0.5, rel=1e-9) and missed.acceleration[1] == 0.0


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_an_impact_on_a_locked_chain_is_one_on_a_rigid_body(method):
    """The end of the pendulum falls on a floor without friction: it turns back at half its speed, all of it."""
    model = double_pendulum()
    model.addFrame(pin.Frame("end", 2, pin.SE3(np.eye(3), np.array([0.0, 0.0, -LENGTH])), pin.FrameType.OP_FRAME))
    scene = pc.Scene(model)
    height = masses(0.2)[1, 1]
    floor = scene.add_contour("floor", pc.Plane(), placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, height])))
    scene.add_contact("end", scene.add_contour("point", pc.Point(), "end"), floor, restitution=0.5)
    # as the pendulum swings towards 0.2 from beyond, its end comes down
    state = scene.initial_state([0.4, BEND], [-1.0, 0.0], free=["end"])
    run = pc.simulate(scene, state, 0.2, method=method, **({"dt": 1e-5} if method == "Moreau" else {}))
    touch = next(event for event in run.events if event.kind == "touch")
    after = int(np.searchsorted(run.t, touch.time, side="right"))
    inertia = MASS * float((masses(0.0) ** 2).sum())
    energy = 0.5 * inertia * run.v[:, 0] ** 2 + MASS * GRAVITY * np.array([masses(q)[:, 1].sum() for q in run.q[:, 0]])
    # of what is kinetic as it strikes a quarter is left
    kinetic = energy[0] - MASS * GRAVITY * masses(0.2)[:, 1].sum()
    assert run.v[0, 0] < 0.0 < run.v[after, 0] and kinetic > 1.0
    assert energy[0] - energy[after] == pytest.approx(0.75 * kinetic, rel=1e-3 if method == "Moreau" else 1e-7)
    assert not run.v[:, 1].any()


# --------------------------------------------------------------------------- random robots, and the same ones welded


@dataclasses.dataclass
class Pair:
    """A robot with locked joints and the one that Pinocchio makes without these, and which coordinates it keeps."""

    locked: pc.Scene
    welded: pc.Scene
    q: np.ndarray
    kept_q: list[int]
    kept_v: list[int]

    def states(self, v, **options):
        return (
            self.locked.initial_state(self.q, v, **options),
            self.welded.initial_state(self.q[self.kept_q], v[self.kept_v], **options),
        )


FRICTION = pc.Coulomb(0.6)


def random_pair(seed, contacts=True, law=FRICTION, restitution=0.3):
    """Branches of revolute and prismatic joints, free or on the world, some of them locked; spheres at the last links
    of both branches over a plane."""
    rng = np.random.default_rng(seed)
    model, base, free = pin.Model(), 0, bool(rng.random() < 0.6)

    def body():
        return pin.Inertia(rng.uniform(0.5, 2.0), rng.uniform(-0.1, 0.1, 3), np.diag(rng.uniform(0.02, 0.03, 3)))

    if free:
        base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
        model.addJointFrame(base)
        model.appendBodyToJoint(base, body(), pin.SE3.Identity())
    tips = []
    for branch in range(2):
        joint = base
        for i in range(3):
            kind = pin.JointModelRevoluteUnaligned if rng.random() < 0.7 else pin.JointModelPrismaticUnaligned
            joint = model.addJoint(joint, kind(axis(rng)), placement(rng, 0.3), f"joint {branch}{i}")
            model.addJointFrame(joint)
            model.appendBodyToJoint(joint, body(), pin.SE3.Identity())
        tips.append(joint)
        model.addFrame(pin.Frame(f"tip {branch}", joint, placement(rng, 0.2), pin.FrameType.OP_FRAME))
    nv, first = model.nv, 6 if free else 0
    model.armature[first:] = rng.uniform(0.0, 0.1, nv - first)
    model.damping[first:] = rng.uniform(0.0, 0.3, nv - first)
    dry = np.where(rng.random(nv - first) < 0.3, 0.2, 0.0)
    model.upperDryFrictionLimit[first:], model.lowerDryFrictionLimit[first:] = dry, -dry
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.8, 0.8, nv))
    joints = list(range(2 if free else 1, model.njoints))
    rng.shuffle(joints)
    joints, stopped = sorted(joints[: rng.integers(1, 4)]), joints[-1]
    names = [model.names[j] for j in joints]
    for name, j in zip(names, joints):
        lock(model, name, q[model.joints[j].idx_q])
    k = model.joints[stopped].idx_q
    model.lowerPositionLimit[k], model.upperPositionLimit[k] = q[k] - 0.05, q[k] + 0.05
    gone_q, gone_v = ({getattr(model.joints[j], index) for j in joints} for index in ("idx_q", "idx_v"))
    kept_q, kept_v = [i for i in range(model.nq) if i not in gone_q], [i for i in range(nv) if i not in gone_v]
    reduced = pin.buildReducedModel(model, joints, q)
    for name, kept in (
        ("armature", kept_v), ("damping", kept_v), ("upperDryFrictionLimit", kept_v), ("lowerDryFrictionLimit", kept_v),
        ("lowerPositionLimit", kept_q), ("upperPositionLimit", kept_q),
    ):  # fmt: skip
        setattr(reduced, name, np.array(getattr(model, name))[kept])
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    # both spheres begin 1 and 3 mm over the floor, which is tilted for that
    points = [data.oMf[model.getFrameId(f"tip {b}")].translation for b in range(2)]
    across = points[1] - points[0]
    flat = np.cross(across, [across[1], -across[0], 0.0])
    normal = flat / np.linalg.norm(flat) * (1.0 if flat[2] > 0.0 else -1.0)
    side = np.cross([0.0, 1.0, 0.0], normal)
    side /= np.linalg.norm(side)
    turned = np.column_stack([side, np.cross(normal, side), normal])
    scenes = pc.Scene(model), pc.Scene(reduced)
    for scene in scenes if contacts else ():
        place = pin.SE3(turned, points[0] - 0.051 * normal)
        floor = scene.add_contour("floor", pc.Plane(), placement=place)
        for b in range(2):
            sphere = scene.add_contour(f"sphere {b}", pc.Sphere(0.05 - 0.002 * b), f"tip {b}")
            scene.add_contact(f"c{b}", sphere, floor, friction=law, restitution=restitution)
    return Pair(*scenes, q, kept_q, kept_v)


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Moreau"])
@pytest.mark.parametrize("seed", range(4))
def test_random_robots_move_as_welded_ones(method, seed):
    pair = random_pair(seed)
    rng = np.random.default_rng(seed)
    v, torques = 0.3 * rng.normal(size=pair.locked.model.nv), rng.normal(size=pair.locked.model.nv)
    v[[k for k in range(v.size) if k not in pair.kept_v]] = 0.0
    # what is asked of locked joints, and their friction and damping, makes no difference
    controls = lambda t, q, v: torques * math.cos(9.0 * t), lambda t, q, v: torques[pair.kept_v] * math.cos(9.0 * t)
    options = {"dt": 1e-3} if method == "Moreau" else {"rtol": 1e-9, "atol": 1e-11}
    one, two = (
        pc.simulate(state.scene, state, 0.2, method=method, control=control, energies=True, **options)
        for state, control in zip(pair.states(v, free=["c0", "c1"]), controls)
    )
    assert one.status == two.status == 0, (one.message, two.message)
    assert [(e.kind, e.contact, e.joint) for e in one.events] == [(e.kind, e.contact, e.joint) for e in two.events]
    assert any(e.kind == "touch" for e in one.events)
    # they differ by round-off, which grows from impact to impact
    tolerance = 1e-7 if method != "Moreau" else 1e-8
    np.testing.assert_allclose(one.t[-1], two.t[-1], rtol=1e-12)
    np.testing.assert_allclose(one.q[-1][pair.kept_q], two.q[-1], rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(one.v[-1][pair.kept_v], two.v[-1], rtol=0.0, atol=100.0 * tolerance)
    for name in ("c0", "c1"):
        np.testing.assert_array_equal(one.contacts[name].mode[-1], two.contacts[name].mode[-1])
    energies, expected = one.energies(), two.energies()
    np.testing.assert_allclose(energies.kinetic[-1], expected.kinetic[-1], rtol=0.0, atol=100.0 * tolerance)
    gone = [k for k in range(pair.locked.model.nq) if k not in pair.kept_q]
    assert (one.q[:, gone] == pair.q[gone]).all()
    assert not one.v[:, [k for k in range(v.size) if k not in pair.kept_v]].any()


@pytest.mark.parametrize("law", [None, pc.NoSlip(), pc.Coulomb(0.4, viscous=0.3), pc.Coulomb(0.3, spinning=0.01)])
@pytest.mark.parametrize("seed", range(3))
def test_random_robots_with_other_laws(law, seed):
    pair = random_pair(seed, law=law, restitution=0.0)
    rest = np.zeros(pair.locked.model.nv)
    for method, options in (("DOP853", {"rtol": 1e-9, "atol": 1e-11}), ("Moreau", {"dt": 1e-3})):
        one, two = (
            pc.simulate(state.scene, state, 0.1, method=method, **options)
            for state in pair.states(rest, free=["c0", "c1"])
        )
        assert one.status == two.status == 0, (one.message, two.message)
        # friction limits that go with loads are iterated as far as they still change
        tolerance = 1e-5 if method == "Moreau" and law is not None and law.spinning else 1e-7
        np.testing.assert_allclose(one.q[-1][pair.kept_q], two.q[-1], rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("seed", range(6))
def test_actuators_of_steppers_leave_locked_joints_out(seed):
    """The step's weight goes with the fastest decay, in which a light joint that is locked has no say."""
    pair = random_pair(seed)
    steppers = [pc.Stepper(s.scene, s, dt=1e-3) for s in pair.states(np.zeros(pair.locked.model.nv), free=["c0", "c1"])]
    for stepper, q in zip(steppers, (pair.q + 0.1, pair.q[pair.kept_q] + 0.1)):
        stepper.pd(200.0, 30.0, q)
        for _ in range(100):
            stepper.step(np.zeros(stepper.scene.model.nv))
    np.testing.assert_allclose(steppers[0].q[pair.kept_q], steppers[1].q, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(steppers[0].actuation[pair.kept_v], steppers[1].actuation, rtol=0.0, atol=1e-6)
    gone = [k for k in range(pair.locked.model.nv) if k not in pair.kept_v]
    assert not steppers[0].actuation[gone].any() and not steppers[0].v[gone].any()
    for name in ("c0", "c1"):
        np.testing.assert_allclose(steppers[0].forces[name], steppers[1].forces[name], rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_inverse_dynamics_of_random_robots(seed):
    """Efforts and contact forces are those of the welded robot, and what the locks carry is what Pinocchio needs."""
    pair = random_pair(seed)
    rng = np.random.default_rng(seed)
    v = np.zeros(pair.locked.model.nv)
    # closed contacts
    states = pair.states(v, max_gap=0.01)
    model, kept = pair.locked.model, np.array(pair.kept_v)
    gone = [k for k in range(model.nv) if k not in pair.kept_v]
    # motors of their own, and such that drive all joints, locked ones, too
    alone, together = np.eye(model.nv), np.eye(model.nv) + 0.2 * rng.normal(size=(model.nv, model.nv))
    limits = {"cones": True, "effort_limits": True, "unreachable": "nearest"}
    for matrix, options in ((alone, {}), (alone, limits), (together, {}), (together, limits)):
        acceleration = np.zeros(model.nv)
        if options:
            acceleration[pair.kept_v] = rng.normal(size=kept.size)
        found, expected = (
            pc.inverse_dynamics(state.scene, state, acceleration[k], actuation=matrix[k], **options)
            for state, k in zip(states, (slice(None), kept))
        )
        size = max(1.0, float(np.abs(expected.efforts).max()))
        tolerance = (1e-5 if options else 1e-8) * size
        np.testing.assert_allclose(found.efforts, expected.efforts, rtol=0.0, atol=tolerance)
        np.testing.assert_allclose(found.tau[kept], expected.tau, rtol=0.0, atol=tolerance)
        for name in ("c0", "c1"):
            np.testing.assert_allclose(found.forces[name], expected.forces[name], rtol=0.0, atol=tolerance)
        assert found.missed == pytest.approx(expected.missed, abs=1e-5) and not found.acceleration[gone].any()
        assert found.residual < 1e-8 * size
        outside = pc.external_forces(pair.locked, states[0], forces=found.forces)
        needed = pin.rnea(model, model.createData(), states[0].q, v, found.acceleration, outside)
        carried = needed - found.tau
        np.testing.assert_allclose(found.joint_forces[gone], carried[gone], rtol=0.0, atol=1e-9 * size)
        np.testing.assert_allclose(found.joint_forces, carried, rtol=0.0, atol=10.0 * tolerance)


@pytest.mark.parametrize("seed", [1, 2, 3, 6, 8, 11])
def test_certificates_do_not_move_what_is_locked(seed):
    """Why weak motors cannot do what is wanted: a virtual velocity of the welded robot."""
    pair = random_pair(seed)
    for scene in (pair.locked, pair.welded):
        scene.model.effortLimit[:] = 3.0
    acceleration = 30.0 * np.random.default_rng(seed).normal(size=pair.locked.model.nv)
    states = pair.states(np.zeros(acceleration.size), max_gap=0.01)

    def certificate(state, a):
        options = {"cones": True, "effort_limits": True, "unreachable": "nearest"}
        try:
            return pc.inverse_dynamics(state.scene, state, a, **options).certificate
        except pc.InfeasibleError as error:
            return error.certificate

    found, expected = certificate(states[0], acceleration), certificate(states[1], acceleration[pair.kept_v])
    assert np.abs(np.delete(found.velocity, pair.kept_v)).max() < 1e-12 and found.joints == expected.joints
    np.testing.assert_allclose(found.velocity[pair.kept_v], expected.velocity, rtol=0.0, atol=1e-5)
    assert found.wanted == pytest.approx(expected.wanted, rel=1e-4) and found.wanted < found.least
    assert found.least == pytest.approx(expected.least, rel=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_equilibria_and_linear_motions_of_random_robots(seed):
    pair = random_pair(seed, contacts=False)
    for scene in (pair.locked, pair.welded):
        model = scene.model
        model.gravity.linear = np.array([0.0, 0.0, -9.81 if model.names[1] != "base" else 0.0])
        # springs pull to where it is, and weights bend them
        model.lowerPositionLimit[:] = np.where(
            model.lowerPositionLimit == model.upperPositionLimit, model.lowerPositionLimit, -np.inf
        )
        model.upperPositionLimit[:] = np.where(np.isinf(model.lowerPositionLimit), np.inf, model.upperPositionLimit)
        model.lowerDryFrictionLimit[:] = model.upperDryFrictionLimit[:] = 0.0
    v = np.zeros(pair.locked.model.nv)
    states = pair.states(v)
    gravity = pin.computeGeneralizedGravity(pair.locked.model, pair.locked.model.createData(), pair.q)
    taus = gravity, gravity[pair.kept_v]
    found, expected = (
        pc.find_equilibrium(s.scene, s.q, tau, actuation=np.eye(tau.size), tolerance=1e-10)
        for s, tau in zip(states, taus)
    )
    np.testing.assert_allclose(found.state.q[pair.kept_q], expected.state.q, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.tau[pair.kept_v], expected.tau, rtol=0.0, atol=1e-8)
    one, two = (pc.linearize(e.state.scene, e.state, e.tau) for e in (found, expected))
    assert one.A.shape == two.A.shape and one.names == two.names
    np.testing.assert_allclose(one.A, two.A, rtol=0.0, atol=1e-7 * max(1.0, np.abs(two.A).max()))
    np.testing.assert_allclose(one.B[:, pair.kept_v], two.B, rtol=0.0, atol=1e-7 * max(1.0, np.abs(two.B).max()))
    assert not np.delete(one.B, pair.kept_v, axis=1).any()
    assert one.symmetries.shape == two.symmetries.shape
    one, two = one.without_symmetries(), two.without_symmetries()
    np.testing.assert_allclose(
        np.sort_complex(one.eigenvalues),
        np.sort_complex(two.eigenvalues),
        rtol=0.0,
        atol=1e-5 * max(1.0, abs(two.A).max()),
    )


def test_what_is_locked_is_no_unknown():
    """At rest the centre of mass hangs below the shoulder; on a turntable it swings out until gravity balances that."""
    hanging = -math.atan2(-masses(0.0)[:, 0].mean(), -masses(0.0)[:, 1].mean())
    found = pc.find_equilibrium(pc.Scene(double_pendulum()), [hanging + 0.3, BEND])
    np.testing.assert_allclose(found.state.q, [hanging, BEND], rtol=0.0, atol=1e-10)
    model = pin.Model()
    table = model.addJoint(0, pin.JointModelRUBZ(), pin.SE3.Identity(), "table")
    model.appendBodyToJoint(table, pin.Inertia(1.0, np.zeros(3), np.diag([0.1, 0.1, 0.2])), pin.SE3.Identity())
    model = pin.appendModel(
        model,
        double_pendulum(),
        model.addFrame(pin.Frame("top", table, pin.SE3.Identity(), pin.FrameType.OP_FRAME)),
        pin.SE3.Identity(),
    )
    lock(model, "elbow", BEND)
    scene = pc.Scene(model)
    found = pc.find_steady_motion(
        scene, [1.0, 0.0, hanging - 0.5, BEND], [6.0, 0.0, 0.0], conditions=lambda q, v: [v[0] - 6.0]
    )
    q, v = found.state.q, found.state.v
    assert q[3] == BEND and v[2] == 0.0 and v[0] == pytest.approx(6.0, abs=1e-9) and abs(q[2] - hanging) > 0.05
    at = masses(q[2])
    # about the shoulder, by a unit of mass: weight against what turning makes
    assert 36.0 * float(at[:, 0] @ at[:, 1]) == pytest.approx(-GRAVITY * float(at[:, 0].sum()), abs=1e-8)


def test_a_locked_wheel_has_no_spin_to_follow():
    """A wheel on an axle, both on a turntable: locked, it cannot spin by itself, round as it is."""
    model = pin.Model()
    table = model.addJoint(0, pin.JointModelRUBZ(), pin.SE3.Identity(), "table")
    model.appendBodyToJoint(table, pin.Inertia(1.0, np.zeros(3), np.diag([0.1, 0.1, 0.2])), pin.SE3.Identity())
    wheel = model.addJoint(table, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0])), "wheel")
    model.appendBodyToJoint(wheel, pin.Inertia(0.5, np.zeros(3), np.diag([0.02, 0.01, 0.01])), pin.SE3.Identity())
    v = [2.0, 0.0]
    scene = pc.Scene(model)
    assert pc.linearize(scene, scene.initial_state(pin.neutral(model), v)).symmetries.shape == (4, 2)
    lock(model, "wheel", 0.25)
    scene = pc.Scene(model)
    found = pc.find_steady_motion(scene, [1.0, 0.0, 0.25], [2.0, 5.0])
    assert found.state.v[1] == 0.0 and found.state.q[2] == 0.25
    motion = pc.linearize(scene, found.state)
    assert motion.names == ["q:table", "v:table"] and motion.symmetries.shape == (2, 1)


def test_a_locked_rotor_is_no_gyroscope():
    """A ball that is round with its rotor, which is locked, spins about any axis; one whose rotor turns does not."""
    model = pin.Model()
    ball = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(ball, pin.Inertia(1.0, np.zeros(3), np.diag([0.1, 0.13, 0.13])), pin.SE3.Identity())
    rotor = model.addJoint(ball, pin.JointModelRX(), pin.SE3.Identity(), "rotor")
    model.appendBodyToJoint(rotor, pin.Inertia(0.5, np.zeros(3), np.diag([0.05, 0.02, 0.02])), pin.SE3.Identity())
    counts = []
    for locked in (False, True):
        if locked:
            lock(model, "rotor", 0.0)
        scene = pc.Scene(model)
        scene.model.gravity.linear = np.zeros(3)
        state = scene.initial_state(pin.neutral(model), [0.0, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0 if locked else 2.0])
        counts.append(find_symmetries(Instant(scene, state)).count)
    # places, turns of the world and of the ball, of which one is left beside the rotor, that of the rotor
    assert counts == [3 + 3 + 1 + 1, 3 + 3 + 3]


# ------------------------------------------------------------------------------------------------- starts and results


def test_locks_of_a_model():
    """Of coordinates that are numbers, one of a joint's several, too, and beside true limits."""
    model = double_pendulum()
    assert joint_locks(model) == [JointLock("elbow", 1, 1, BEND)] and joint_limits(model) == []
    model.upperDryFrictionLimit[:] = 0.3
    assert [limit.joint for limit in joint_limits(model)] == ["shoulder"]
    joint = model.addJoint(2, pin.JointModelTranslation(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.lowerPositionLimit[2:], model.upperPositionLimit[2:] = [-1.0, 0.2, -np.inf], [1.0, 0.2, np.inf]
    assert joint_locks(model)[1:] == [JointLock("slide", 3, 3, 0.2)]
    assert [limit.index_q for limit in joint_limits(model)] == [0, 2]


def test_one_of_a_joints_coordinates_can_be_locked():
    """What slides along x and z only falls as it does without y."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.gravity.linear = np.array([1.0, 2.0, -3.0])
    model.lowerPositionLimit[1] = model.upperPositionLimit[1] = 0.5
    scene = pc.Scene(model)
    for method in ("DOP853", "Moreau"):
        run = pc.simulate(scene, scene.initial_state([0.0, 0.5, 0.0]), 1.0, method=method)
        np.testing.assert_allclose(run.q[-1], [0.5, 0.5, -1.5], rtol=1e-12)
    found = pc.inverse_dynamics(scene, scene.initial_state([0.0, 0.5, 0.0]), [1.0, 0.0, -3.0])
    np.testing.assert_allclose(found.joint_forces, [0.0, -4.0, 0.0], rtol=0.0, atol=1e-12)


def test_starts_elsewhere_are_refused_by_the_joints_name():
    scene = pc.Scene(double_pendulum())
    for off in (1.1 * END_SLACK, -0.1):
        with pytest.raises(pc.StateError, match=r"'elbow': q\[1\] = .*locked"):
            scene.initial_state([0.0, BEND + off])
    state = scene.initial_state([0.0, BEND + 0.9 * END_SLACK])
    assert state.q[1] == BEND and state.correction.dq == pytest.approx(0.9 * END_SLACK, rel=1e-6)
    for change, match in (({"q": np.array([0.0, 0.0])}, r"q\[1\]"), ({"v": np.array([0.0, 1e-3])}, r"v\[1\]")):
        bad = dataclasses.replace(state, **change)
        for method in ("DOP853", "Moreau"):
            with pytest.raises(pc.StateError, match=match):
                pc.simulate(scene, bad, 0.1, method=method)
        with pytest.raises(pc.StateError, match=match):
            pc.Stepper(scene, bad)
        with pytest.raises(pc.StateError, match=match):
            pc.linearize(scene, bad)


def test_velocities_of_starts_are_corrected_in_the_mass_metric():
    """What a lock takes off is an impulse of its own: no other changes the velocity."""
    model = double_pendulum()
    scene, v = pc.Scene(model), np.array([0.4, 1.5])
    state = scene.initial_state([0.3, BEND], v)
    mass = pin.crba(model, model.createData(), np.array([0.3, BEND]))
    mass = np.triu(mass) + np.triu(mass, 1).T
    assert state.v[1] == 0.0 and state.correction.dv == pytest.approx(np.abs(state.v - v).max(), rel=1e-12)
    assert (mass @ (state.v - v))[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_velocities_of_locked_joints_start_as_zeros(seed):
    pair = random_pair(seed)
    v = np.random.default_rng(seed).normal(size=pair.locked.model.nv)
    state = pair.locked.initial_state(pair.q, v, max_gap=0.01)
    assert not np.delete(state.v, pair.kept_v).any() and state.v.any()


def test_runs_are_saved_and_go_on(tmp_path):
    scene = pc.Scene(double_pendulum())
    run = pc.simulate(scene, scene.initial_state([0.5, BEND]), 0.2, dense_output=True, energies=True)
    run.save(tmp_path / "run")
    loaded = pc.Trajectory.load(tmp_path / "run.npz", scene)
    np.testing.assert_array_equal(loaded.q, run.q)
    assert np.ptp(run.energies().kinetic + run.energies().potential) < 1e-8
    assert run.sol(0.1).q[1] == BEND
    for method in ("RK45", "Moreau"):
        again = pc.simulate(scene, loaded.state(-1), 0.1, method=method)
        assert again.status == 0 and (again.q[:, 1] == BEND).all()


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_limits_that_nearly_coincide_are_stops(method):
    """A way that steps cannot resolve holds the joint all the same, but for that way."""
    model = double_pendulum()
    exact = pc.Scene(model)
    near = model.copy()
    near.lowerPositionLimit[1] -= 1e-9
    scene = pc.Scene(near)
    assert not joint_locks(near) and len(joint_limits(near)) == 1
    runs = [pc.simulate(s, s.initial_state([1.0, BEND]), 1.0, method=method) for s in (exact, scene)]
    assert runs[0].status == runs[1].status == 0
    # stops are held by impulses, of first order in steps of a millisecond
    tolerance = 2e-2 if method == "Moreau" else 1e-7
    np.testing.assert_allclose(runs[1].q[-1], runs[0].q[-1], rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(runs[1].v[-1], runs[0].v[-1], rtol=0.0, atol=10.0 * tolerance)
    assert np.abs(runs[1].q[:, 1] - BEND).max() < 1e-8 and len(runs[1].events) < 5
