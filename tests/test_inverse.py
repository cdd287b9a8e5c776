"""Inverse dynamics and contact forces as Pinocchio's external forces, on random contacts of all patterns."""

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from random_contacts import PATTERNS, RandomContact
from random_scenes import resting_chain
from scipy.optimize import lsq_linear
from turning_ball import MASS, RADIUS, G, ball, on_the_floor

import pincontact as pc
from pincontact.analysis.instant import Instant
from pincontact.dynamics.system import System
from pincontact.integration.discrete import write_discrete
from pincontact.layout import EVENT

URDF = Path(__file__).resolve().parent.parent / "urdf"
SHAPES = {
    "P-2C": ("Point", "Ellipse"),
    "P-3C": ("Point", "Helix"),
    "P-S": ("Point", "Ellipsoid"),
    "2C-2C": ("Circle", "Ellipse"),
    "3C-3C": ("Circle", "Helix"),
    "3C-S": ("Circle", "Ellipsoid"),
    "S-S": ("Sphere", "Ellipsoid"),
}
FRICTIONS = {"smooth": None, "rolling": pc.NoSlip(), "rough": pc.Coulomb(0.3)}
# rounding of a few matrix products, by the conditioning of the contacts and masses
ROUND_OFF = 1e-10


def evaluated(scene, state, tau):
    """A system with accelerations at a state of a run, in the modes of the run."""
    system = System(scene.model, list(scene.contacts.values()))
    system.q[:], system.v[:], system.tau[:] = state.q, state.v, tau
    system.location[: system.nc] = state.location
    write_discrete(system, state.discrete)
    assert system.evaluate(state.t) <= EVENT
    return system


def moving(pattern, friction, seed=2):
    """A contact a little way into its motion under constant torques, and the run."""
    contact = RandomContact(pattern, SHAPES[pattern], seed=seed, friction=FRICTIONS[friction])
    tau = np.random.default_rng(seed).normal(size=contact.scene.model.nv)
    run = pc.simulate(contact.scene, contact.state, 0.02, control=lambda t, q, v: tau)
    assert run.status == 0, run.message
    return contact.scene, run, tau


@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_forward_dynamics_by_pinocchio(pattern, friction):
    """pin.aba under the contacts' forces makes the scene's own accelerations."""
    scene, run, tau = moving(pattern, friction)
    model, data = scene.model, scene.model.createData()
    for index in (0, -1):
        state = run.state(index)
        expected = evaluated(scene, state, tau).acceleration
        scale = 1.0 + np.abs(expected).max()
        for forces in (run.external_forces(index), pc.external_forces(scene, state, tau)):
            found = pin.aba(model, data, state.q, state.v, tau, forces)
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=ROUND_OFF * scale)


@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("limits", [0, 1, 3])
def test_external_forces_beside_limited_joints_and_resistances(limits, turning):
    """Contacts are not the only ones that have rows: pin.aba makes the accelerations with them, too."""
    scene = ball(pc.Coulomb(0.3, **({"rolling": 1e-3, "spinning": 1e-3} if turning else {})))
    model, parent = scene.model, 1
    for k in range(limits):
        parent = model.addJoint(parent, pin.JointModelPX(), pin.SE3.Identity(), f"slider {k}")
        model.appendBodyToJoint(parent, pin.Inertia(0.1, np.zeros(3), 1e-4 * np.eye(3)), pin.SE3.Identity())
    model.lowerPositionLimit[7:], model.upperPositionLimit[7:] = -1.0, 1.0
    moving = pc.Scene(model)
    for name, contour in (("surface", pc.Sphere(RADIUS)), ("floor", pc.Plane())):
        moving.add_contour(name, contour, "ball" if name == "surface" else "universe")
    moving.add_contact("c", "surface", "floor", friction=scene.contacts["c"].friction)
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[2], v[:6] = RADIUS, [0.1, 0.2, 0.0, 1.0, 2.0, 3.0]
    state, tau = moving.initial_state(q, v), np.linspace(-0.1, 0.1, model.nv)
    found = pin.aba(model, model.createData(), q, v, tau, pc.external_forces(moving, state, tau))
    np.testing.assert_allclose(found, Instant(moving, state, tau).evaluate(), rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("size", [3, 6])
def test_frames_of_one_joint(size):
    """A frame on a hinge: its acceleration is that of the hinge alone."""
    model = pin.Model()
    hinge = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(hinge, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("tip", hinge, pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])), 0)
    scene = pc.Scene(model)
    wanted = [0.0, 1.0, 0.0, 0.0, 0.0, 2.0][:size]
    found = pc.inverse_dynamics(scene, scene.initial_state([0.0]), {"tip": wanted})
    np.testing.assert_allclose(found.acceleration, [2.0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.tau, [0.2], rtol=0.0, atol=1e-9)
    # of joints added in Python `effortLimit` is the largest number, which limits nothing
    with np.errstate(over="raise"):
        limited = pc.inverse_dynamics(scene, scene.initial_state([0.0]), {"tip": wanted}, effort_limits=True)
    np.testing.assert_allclose(limited.tau, found.tau, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("friction", ["smooth", "rolling"])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_inverse_of_forward_dynamics(pattern, friction):
    """The accelerations of a motion under torques need no larger torques, and pin.rnea under the forces agrees."""
    scene, run, tau = moving(pattern, friction, seed=8)
    model, state = scene.model, run.state()
    a = evaluated(scene, state, tau).acceleration.copy()
    found = pc.inverse_dynamics(scene, state, a, actuation=np.eye(model.nv))
    scale = 1.0 + np.abs(tau).max() + np.abs(a).max()
    assert np.linalg.norm(found.tau) <= np.linalg.norm(tau) * (1.0 + 1e-12)
    forces = pc.external_forces(scene, state, forces=found.forces)
    needed = pin.rnea(model, model.createData(), state.q, state.v, a, forces)
    np.testing.assert_allclose(needed, found.tau, rtol=0.0, atol=ROUND_OFF * scale)
    # only one set of forces goes with these torques: the contact's own under them
    again = pc.external_forces(scene, state, found.tau)
    for one, other in zip(forces, again):
        np.testing.assert_allclose(one.vector, other.vector, rtol=0.0, atol=1e-8 * scale)


@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_effort_of_one_actuator(pattern, friction):
    """One actuator that pulls along the torques: its effort is 1, the contact's force that of the motion, friction
    included; and with that force given, all torques follow without the law of friction."""
    scene, run, tau = moving(pattern, friction, seed=8)
    model, state = scene.model, run.state()
    a = evaluated(scene, state, tau).acceleration.copy()
    force = run.contacts["c"].force[-1]
    scale = 1.0 + np.abs(force).max()
    found = pc.inverse_dynamics(scene, state, a, actuation=tau[:, None])
    np.testing.assert_allclose(found.efforts, [1.0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.forces["c"], force, rtol=0.0, atol=1e-8 * scale)
    given = pc.inverse_dynamics(scene, state, a, actuation=np.eye(model.nv), forces={"c": force})
    np.testing.assert_allclose(given.tau, tau, rtol=0.0, atol=1e-9 * scale)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_acceleration_by_default_keeps_the_contact(pattern):
    scene, run, _ = moving(pattern, "rolling")
    state, model = run.state(), scene.model
    found = pc.inverse_dynamics(scene, state, actuation=np.eye(model.nv))
    kinematics = pc.analyze(scene, state)["c"]
    defects = kinematics.rows @ found.acceleration + kinematics.bias
    count = {"P-2C": (0, 2), "2C-2C": (0, 2)}.get(pattern, (0, 1, 2))
    assert np.abs(defects[list(count)]).max() <= ROUND_OFF * (1.0 + np.abs(kinematics.bias).max())
    # nearest zero in the norm of M: orthogonal to every motion that the contact allows
    mass = pin.crba(model, model.createData(), state.q)
    rows = kinematics.rows[list(count)]
    free = np.linalg.svd(rows)[2][rows.shape[0] :]
    np.testing.assert_allclose(
        free @ mass @ found.acceleration, 0.0, atol=1e-9 * (1.0 + np.abs(found.acceleration).max())
    )


def bicycle():
    scene = pc.Scene.from_urdf(URDF / "bicycle.urdf", floating_base=True)
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    floor = scene.add_contour("floor", pc.Plane())
    for name, radius in (("rear", 0.3), ("front", 0.35)):
        rim = scene.add_contour(name, pc.Circle(radius), f"{name}_wheel", upright)
        scene.add_contact(name, rim, floor, friction=pc.NoSlip())
    q = pin.neutral(scene.model)
    q[2] = 0.3
    return scene, scene.initial_state(q)


def test_pedalling():
    """The torque at the rear wheel for an acceleration a: r a (m + I_R / r_R^2 + I_F / r_F^2), by power."""
    scene, state = bicycle()
    model, forward = scene.model, 1.5
    a = np.zeros(model.nv)
    a[0] = forward
    for name, radius in (("rear", 0.3), ("front", 0.35)):
        a[model.joints[model.getJointId(f"{name}_axle")].idx_v] = forward / radius
    found = pc.inverse_dynamics(scene, state, a, actuation=["rear_axle"])
    expected = 0.3 * forward * (94.0 + 0.12 / 0.09 + 0.28 / 0.35**2)
    assert found.efforts == pytest.approx([expected], rel=1e-12)
    total = sum(found.forces.values())
    # on the floor
    np.testing.assert_allclose(total, [-94.0 * forward, 0.0, -94.0 * 9.81], rtol=0.0, atol=1e-9)
    front = found.forces["front"]
    assert front[0] == pytest.approx(0.28 / 0.35**2 * forward, rel=1e-10)
    # braking with both wheels is shared such that the torques are least
    shared = pc.inverse_dynamics(scene, state, -a, actuation=["rear_axle", "front_axle"])
    assert np.linalg.norm(shared.efforts) < expected
    assert shared.efforts @ [1.0 / 0.3, 1.0 / 0.35] == pytest.approx(-expected / 0.3, rel=1e-12)


def test_forces_of_a_free_root():
    """Without actuators named, the root of a floating robot has none: leaning cannot be held by the joints."""
    scene, state = bicycle()
    tipped = state.q.copy()
    tipped[1], tipped[2] = -0.3 * math.sin(0.1), 0.3 * math.cos(0.1)
    tipped[3:7] = [math.sin(0.05), 0.0, 0.0, math.cos(0.05)]
    leaning = scene.initial_state(tipped)
    with pytest.raises(pc.SolverError, match=r"leave .* of the equations of motion"):
        pc.inverse_dynamics(scene, leaning)
    held = pc.inverse_dynamics(scene, leaning, actuation=np.eye(scene.model.nv))
    assert held.residual < 1e-9


@pytest.mark.parametrize("steeper", [0.9, 1.1])
@pytest.mark.parametrize("bilateral", [False, True])
def test_resistance_to_turning_says_what_it_holds_with(steeper, bilateral):
    """A ball at rest on a ramp, where the torque that keeps it is m g sin R, against length m g cos; beside it one that
    a motor spins up against what resists its spinning."""
    rolling, spinning = 4e-3, 1e-3
    slope = math.atan(steeper * rolling / RADIUS)
    scene = ball(pc.Coulomb(0.5, rolling=rolling, spinning=spinning), slope, bilateral)
    # the floor is the second contour
    weight = MASS * G
    found = pc.inverse_dynamics(scene, on_the_floor(scene))
    assert {turn.kind: turn.contact for turn in found.held} == {"rolling": "c", "spinning": "c"}
    turns = {turn.kind: turn for turn in found.held}
    np.testing.assert_allclose(
        turns["rolling"].torque, [0.0, weight * math.sin(slope) * RADIUS, 0.0], rtol=0.0, atol=1e-12
    )
    assert turns["rolling"].limit == pytest.approx(rolling * weight * math.cos(slope), rel=1e-12)
    assert turns["spinning"].limit == pytest.approx(spinning * weight * math.cos(slope), rel=1e-12)
    np.testing.assert_allclose(turns["spinning"].torque, 0.0, rtol=0.0, atol=1e-12)
    assert turns["rolling"].within == (steeper < 1.0)
    assert turns["spinning"].within
    np.testing.assert_allclose(sum(turn.torque for turn in found.held), found.torques["c"], rtol=0.0, atol=1e-15)
    # it is within exactly where a run stays at rest
    run = pc.simulate(scene, on_the_floor(scene), 0.1)
    # round-off, against 0.1 m/s
    assert (np.abs(run.v).max() <= 1e-15) == turns["rolling"].within


def test_what_turns_or_is_given_is_not_held():
    scene = ball(pc.Coulomb(0.5, rolling=4e-3, spinning=1e-3))
    state = on_the_floor(scene, [0.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    (turn,) = pc.inverse_dynamics(scene, state, actuation=np.eye(6)).held
    assert turn.kind == "rolling"
    resting, force = on_the_floor(scene), [0.0, 0.0, -MASS * G]
    assert pc.inverse_dynamics(scene, resting, actuation=np.eye(6), forces={"c": force}).held == ()
    assert pc.inverse_dynamics(*bicycle(), actuation=np.eye(9)).held == ()


def test_bad_arguments():
    scene, state = bicycle()
    model = scene.model
    up = np.zeros(model.nv)
    up[2] = 1.0
    with pytest.raises(pc.StateError, match=r"takes contact '(rear|front)' apart at -?1"):
        pc.inverse_dynamics(scene, state, up)
    aside = np.zeros(model.nv)
    aside[1] = 1.0
    with pytest.raises(pc.StateError, match=r"takes contact '(rear|front)' into slip"):
        pc.inverse_dynamics(scene, state, aside)
    with pytest.raises(pc.StateError, match="acceleration must have 9 entries, got 3"):
        pc.inverse_dynamics(scene, state, [0.0, 0.0, 0.0])
    with pytest.raises(pc.ArgumentError, match=r"unknown joint 'pedal'; joints: .*rear_axle"):
        pc.inverse_dynamics(scene, state, actuation=["pedal"])
    with pytest.raises(pc.ArgumentError, match=r"finite matrix \(9, na\)"):
        pc.inverse_dynamics(scene, state, actuation=np.eye(3))
    with pytest.raises(pc.ArgumentError, match="unknown contact 'side'; contacts: rear, front"):
        pc.external_forces(scene, state, forces={"side": np.zeros(3)})
    with pytest.raises(pc.StateError, match=r"forces\['rear'\] must be 3 finite numbers"):
        pc.inverse_dynamics(scene, state, forces={"rear": [0.0, math.nan, 0.0]})


# ---------------------------------------------------------------------------------- what contacts and actuators share


def rotation(rng):
    return pin.Quaternion(*(lambda x: x / np.linalg.norm(x))(rng.normal(size=4))).matrix()


def held_tree(seed, law, floating, legs, joints):
    """Legs of random joints on a base that floats or is fixed, of random size and mass; each ends in a ball on a plane
    that holds it from both sides."""
    rng = np.random.default_rng(seed)
    length, mass = 10.0 ** rng.uniform(-2, 2), 10.0 ** rng.uniform(-3, 3)
    model, base = pin.Model(), 0

    def inertia():
        moments = mass * length**2 * np.diag(rng.uniform(0.1, 0.15, 3))
        return pin.Inertia(mass * rng.uniform(0.5, 2.0), length * rng.uniform(-0.2, 0.2, 3), moments)

    if floating:
        base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
        model.appendBodyToJoint(base, inertia(), pin.SE3.Identity())
    for leg in range(legs):
        joint = base
        for k in range(joints):
            axis = rng.normal(size=3)
            kind = pin.JointModelRevoluteUnaligned if rng.random() < 0.8 else pin.JointModelPrismaticUnaligned
            place = pin.SE3(rotation(rng), length * rng.uniform(-0.5, 0.5, 3))
            joint = model.addJoint(joint, kind(axis / np.linalg.norm(axis)), place, f"{leg}.{k}")
            model.appendBodyToJoint(joint, inertia(), pin.SE3.Identity())
        place = pin.SE3(rotation(rng), length * rng.uniform(-0.5, 0.5, 3))
        model.addFrame(pin.Frame(f"foot{leg}", joint, 0, place, pin.FrameType.OP_FRAME))
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.7, 0.7, model.nv))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    scene, turns = pc.Scene(model), 0.01 * length
    friction = {
        "smooth": None,
        "stick": pc.Coulomb(0.5),
        "rolling": pc.NoSlip(rolling=turns),
        "spinning": pc.Coulomb(0.5, spinning=turns),
        "fixed": pc.NoSlip(rolling=turns, spinning=turns),
    }[law]
    for leg in range(legs):
        centre, turned = data.oMf[model.getFrameId(f"foot{leg}")].translation, rotation(rng)
        foot = scene.add_contour(f"foot{leg}", pc.Sphere(0.05 * length), f"foot{leg}")
        wall = scene.add_contour(
            f"wall{leg}", pc.Plane(), placement=pin.SE3(turned, centre - 0.05 * length * turned[:, 2])
        )
        pair = (foot, wall) if rng.random() < 0.5 else (wall, foot)
        scene.add_contact(f"{leg}", *pair, friction=friction, bilateral=True)
    return scene, scene.initial_state(q)


def rows_by_pinocchio(scene, state, law):
    """(m, nv) by contact: rows of what holds the feet, forces first, then torques."""
    model, data = scene.model, scene.model.createData()
    pin.computeJointJacobians(model, data, state.q)
    pin.framesForwardKinematics(model, data, state.q)
    out = {}
    for name in scene.contacts:
        joint = model.frames[model.getFrameId(f"foot{name}")].parentJoint
        jacobian = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.WORLD)
        wall = scene.contours[f"wall{name}"].placement_in_joint
        point = wall.translation
        linear, angular = jacobian[:3] + np.cross(jacobian[3:].T, point).T, jacobian[3:]
        tangents, normal = wall.rotation[:, :2].T, wall.rotation[:, 2:].T
        forces = normal if law == "smooth" else np.eye(3)
        torques = {"rolling": tangents, "spinning": normal, "fixed": np.eye(3)}.get(law, np.zeros((0, 3)))
        out[name] = linear, angular, np.vstack([forces @ linear, torques @ angular])
    return out


@pytest.mark.parametrize("law", ["smooth", "stick", "rolling", "spinning", "fixed"])
def test_least_torques_of_random_mechanisms(law):
    """Against a dense computation with Pinocchio's Jacobians: equations of motion hold, torques are the least of all
    that do it, and zero where contacts carry everything."""
    refused = carried = 0
    for seed in range(12):
        rng = np.random.default_rng(1000 + seed)
        floating, legs, joints = bool(rng.random() < 0.5), int(rng.integers(1, 5)), int(rng.integers(1, 5))
        scene, state = held_tree(seed, law, floating, legs, joints)
        model, nv = scene.model, scene.model.nv
        actuation = np.eye(nv) if rng.random() < 0.5 else np.eye(nv)[:, 6 if floating else 0 :]
        data = model.createData()
        gravity = pin.rnea(model, data, state.q, np.zeros(nv), np.zeros(nv))
        upper = np.triu(pin.crba(model, data, state.q))
        factor = np.linalg.cholesky(upper + np.triu(upper, 1).T)
        rows = rows_by_pinocchio(scene, state, law)

        def whiten(columns, factor=factor):
            return np.linalg.solve(factor, columns)

        # what contacts cannot carry; their columns are of unit size there
        columns = whiten(np.vstack([part for *_, part in rows.values()]).T)
        sizes = np.linalg.norm(columns, axis=0)
        sizes[sizes == 0.0] = 1.0  # what prismatic joints cannot turn
        left, values, _ = np.linalg.svd(columns / sizes)
        # a gap of many orders: rounding is 1e-15, the smallest others are near 1e-4
        assert not ((values > 1e-11) & (values < 1e-7)).any()
        rest = left[:, int((values > 1e-9).sum()) :].T
        carried += rest.shape[0] == 0
        if law == "fixed" and not floating:
            # legs of at most four joints are held by six rows each, whatever the rounding says
            assert rest.shape[0] == 0
        actuators, loads = rest @ whiten(actuation), rest @ whiten(gravity)
        units = np.linalg.norm(whiten(actuation), axis=0)
        left, values, right = np.linalg.svd(actuators / units)
        rank = int((values > 1e-8).sum())
        best = right[:rank].T @ ((left[:, :rank].T @ loads) / values[:rank]) / units
        idle = np.linalg.qr(right[rank:].T / units[:, None])[0]
        best -= idle @ (idle.T @ best)
        if np.linalg.norm(actuators @ best - loads) > 1e-6 * np.linalg.norm(whiten(gravity)):
            refused += 1
            with pytest.raises(pc.SolverError, match="leave"):
                pc.inverse_dynamics(scene, state, actuation=actuation)
            continue
        found = pc.inverse_dynamics(scene, state, actuation=actuation)
        scale = np.abs(gravity).max()
        # rounding by the conditioning of the feet, up to 1e4
        np.testing.assert_allclose(found.efforts, best, rtol=0.0, atol=1e-9 * scale, err_msg=f"seed {seed}")
        if rest.shape[0] == 0:
            # round-off of the loads
            assert np.abs(found.efforts).max(initial=0.0) <= 1e-13 * scale, seed
        acting = actuation @ found.efforts
        for name, (linear, angular, _) in rows.items():
            on_foot = 1.0 if scene.contacts[name].second.name.startswith("foot") else -1.0
            acting = acting + on_foot * (linear.T @ found.forces[name] + angular.T @ found.torques[name])
        np.testing.assert_allclose(acting, gravity, rtol=0.0, atol=1e-9 * scale, err_msg=f"seed {seed}")
    assert refused < 12
    assert carried > 0


def test_least_torques_of_a_link_that_lies_flat():
    """Two points of one link stick: what they push against each other along it nothing else knows of."""
    for seed in range(20):
        rng, model, joint = np.random.default_rng(seed), pin.Model(), 0
        lengths, place = rng.uniform(0.2, 0.6, 2), pin.SE3.Identity()
        kinds = (pin.JointModelPX(), pin.JointModelPZ(), pin.JointModelRY(), pin.JointModelRY())
        for name, kind in zip(("x", "z", "hip", "knee"), kinds):
            joint = model.addJoint(joint, kind, place, name)
            place = pin.SE3(np.eye(3), np.array([lengths[0], 0.0, 0.0])) if name == "hip" else pin.SE3.Identity()
        for joint, length in zip((3, 4), lengths):
            mass, lever = rng.uniform(0.5, 2.0), np.array([0.5 * length, 0.0, 0.0])
            model.appendBodyToJoint(
                joint, pin.Inertia(mass, lever, mass * length**2 / 12.0 * np.eye(3)), pin.SE3.Identity()
            )
        scene = pc.Scene(model)
        floor = scene.add_contour("floor", pc.Plane())
        for name, x in (("heel", 0.0), ("toe", lengths[1])):
            at = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
            scene.add_contact(name, scene.add_contour(name, pc.Point(), "knee", at), floor, friction=pc.Coulomb(0.9))
        angle = rng.uniform(0.1, 1.0)
        q = np.array([0.0, lengths[0] * math.sin(angle), angle, -angle])
        found = pc.inverse_dynamics(scene, scene.initial_state(q, np.zeros(4)))
        # the link is held in the plane: those velocities that are left, from closed forms
        free = np.array([lengths[0] * math.sin(angle), lengths[0] * math.cos(angle), 1.0, -1.0])
        gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
        np.testing.assert_allclose(found.efforts, free * (free @ gravity) / (free @ free), rtol=0.0, atol=1e-9)


def test_loads_of_a_tiny_robot_are_loads():
    """What is left of 1e-9 N m is not nothing because it is less than a newton metre."""
    scene, state = held_tree(3, "smooth", True, 2, 2)
    scene.model.gravity.linear = 1e-9 * scene.model.gravity.linear
    with pytest.raises(pc.SolverError, match="leave"):
        pc.inverse_dynamics(scene, state)


# ---------------------------------------------------------------------------------------------------- joints


def slider(friction=2.0, ends=(-math.inf, math.inf)):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = np.array([-friction]), np.array([friction])
    model.lowerPositionLimit, model.upperPositionLimit = np.array([ends[0]]), np.array([ends[1]])
    return pc.Scene(model)


@pytest.mark.parametrize(
    ("speed", "acceleration", "effort", "friction"),
    [(1.0, 3.0, 5.0, -2.0), (-1.0, 3.0, 1.0, 2.0), (0.0, 3.0, 5.0, -2.0), (0.0, -3.0, -5.0, 2.0), (0.0, 0.0, 0.0, 0.0)],
)
def test_dry_friction_of_a_slider(speed, acceleration, effort, friction):
    """It opposes motion, or the motion that is to begin."""
    scene = slider()
    found = pc.inverse_dynamics(scene, scene.initial_state([0.0], [speed]), [acceleration])
    np.testing.assert_allclose(found.tau, [effort], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found.joint_forces, [friction], rtol=0.0, atol=1e-12)


def test_ends_of_a_joints_way():
    """They take what pushes against them, and nobody can accelerate beyond."""
    scene = slider(0.0, (0.0, 1.0))
    scene.model.gravity.linear = np.array([-9.81, 0.0, 0.0])
    found = pc.inverse_dynamics(scene, scene.initial_state([0.0]))
    np.testing.assert_allclose(found.tau, [0.0], atol=1e-12)
    np.testing.assert_allclose(found.joint_forces, [9.81], rtol=1e-12)
    np.testing.assert_allclose(pc.inverse_dynamics(scene, scene.initial_state([1.0])).tau, [9.81], rtol=1e-12)
    with pytest.raises(
        pc.StateError, match=r"joint 'slider', which is at an end of its way, q\[0\] = 0, beyond it at -1"
    ):
        pc.inverse_dynamics(scene, scene.initial_state([0.0]), [-1.0])
    for acceleration in ([1.0], [0.0]):
        pc.inverse_dynamics(scene, scene.initial_state([0.0]), acceleration)


@pytest.mark.parametrize("seed", range(20))
def test_dry_friction_and_ends_of_random_joints(seed):
    """With all joints driven the least efforts are what is needed beyond the range of each joint's force; a run
    that starts with them accelerates as wanted."""
    scene, q, v, _ = resting_chain(seed)
    model, rng = scene.model, np.random.default_rng(seed)
    low, high = model.lowerDryFrictionLimit.copy(), model.upperDryFrictionLimit.copy()
    at_low, at_high = q == model.lowerPositionLimit, q == model.upperPositionLimit
    a = np.where(rng.random(model.nv) < 0.4, rng.normal(size=model.nv), 0.0)
    a = np.where(at_low, np.abs(a), np.where(at_high, -np.abs(a), a))
    state = scene.initial_state(q, v)
    found = pc.inverse_dynamics(scene, state, a)
    needed = pin.rnea(model, model.createData(), q, v, a) + model.damping * v
    moving = np.where(v != 0.0, np.sign(v), np.sign(a))
    least = np.where(moving < 0.0, high, np.where(at_high & (moving == 0.0), -np.inf, low))
    most = np.where(moving > 0.0, low, np.where(at_low & (moving == 0.0), np.inf, high))
    expected = np.clip(needed, least, most)
    np.testing.assert_allclose(found.joint_forces, expected, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(found.tau, needed - expected, rtol=0.0, atol=1e-10)
    # friction may be just at its limit, which is known to 1e-13 of it
    np.testing.assert_allclose(Instant(scene, state, found.tau).evaluate(), a, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("law", ["smooth", "stick"])
def test_least_torques_of_legs_with_dry_friction(law):
    """Some joints driven, feet held, against SciPy's bounded least squares, where the equations of motion are rows with
    a weight: they are kept to one part in its square."""
    weight, used, refused = 1e6, 0, 0
    for seed in range(30):
        rng = np.random.default_rng(3000 + seed)
        scene, state = held_tree(seed, law, bool(rng.random() < 0.5), int(rng.integers(1, 3)), int(rng.integers(2, 5)))
        model, nv = scene.model, scene.model.nv
        data = model.createData()
        gravity = pin.rnea(model, data, state.q, np.zeros(nv), np.zeros(nv))
        upper = np.triu(pin.crba(model, data, state.q))
        factor = np.linalg.cholesky(upper + np.triu(upper, 1).T)
        scale, loads = np.abs(gravity).max(), np.linalg.solve(factor, gravity)
        start = 6 if model.joints[1].shortname() == "JointModelFreeFlyer" else 0
        friction = np.zeros(nv)
        friction[start:] = np.where(rng.random(nv - start) < 0.6, rng.uniform(0.02, 0.3, nv - start) * scale, 0.0)
        model.lowerDryFrictionLimit, model.upperDryFrictionLimit = -friction, friction
        dry, driven = np.flatnonzero(friction), np.flatnonzero(rng.random(nv) < 0.7)
        rows = np.vstack([part for *_, part in rows_by_pinocchio(scene, state, law).values()])
        # all in parts of the loads
        contacts = np.linalg.solve(factor, rows.T)
        contacts /= np.maximum(np.linalg.norm(contacts, axis=0), 1e-300)
        joints = scale * np.linalg.solve(factor, np.eye(nv)) / np.linalg.norm(loads)
        unknowns = np.hstack([joints[:, driven], joints[:, dry], contacts])
        values = np.linalg.svd(unknowns, compute_uv=False)
        if values[values > 1e-9].min() < 0.05:
            # SciPy's solution has the square of that
            continue
        count = unknowns.shape[1]
        bound = np.full(count, np.inf)
        bound[driven.size : driven.size + dry.size] = friction[dry] / scale
        matrix = np.vstack([np.eye(count)[: driven.size], weight * unknowns])
        wanted = np.concatenate([np.zeros(driven.size), weight * loads / np.linalg.norm(loads)])
        best = lsq_linear(matrix, wanted, (-bound, bound), method="bvls", tol=1e-15, max_iter=1000).x
        actuation = np.eye(nv)[:, driven]
        if np.abs(unknowns @ best - loads / np.linalg.norm(loads)).max() > 1e-7:
            refused += 1
            with pytest.raises(pc.SolverError, match=r"leave|out of reach|no forces within the limits"):
                pc.inverse_dynamics(scene, state, actuation=actuation)
            continue
        found = pc.inverse_dynamics(scene, state, actuation=actuation)
        np.testing.assert_allclose(
            found.efforts,
            scale * best[: driven.size],
            rtol=0.0,
            atol=1e-6 * scale * np.abs(best).max(),
            err_msg=f"seed {seed}",
        )
        assert (np.abs(found.joint_forces) <= friction * (1.0 + 1e-12)).all()
        used += bool((np.abs(np.abs(found.joint_forces) - friction)[dry] < 1e-9 * scale).any())
    assert used > 3
    assert 0 < refused < 20


@pytest.mark.parametrize("cones", [False, True])
def test_of_both_signs_of_a_sliding_bilateral_load_the_one_with_less_efforts(cones):
    """Three equations for two efforts and the load: one solution for either sign, which may have it or not."""
    mu, better, none = 0.8, 0, 0
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "mass")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("mass", joint, pin.SE3.Identity(), 0)
    model.gravity.linear = np.zeros(3)
    scene = pc.Scene(model)
    scene.add_contour("plane", pc.Plane())
    scene.add_contour("point", pc.Point(), "mass")
    scene.add_contact("c", "plane", "point", friction=pc.Coulomb(mu), bilateral=True)
    state = scene.initial_state(np.zeros(3), [1.0, 0.0, 0.0])
    rng = np.random.default_rng(1)
    for _ in range(60):
        actuation, wanted = rng.normal(size=(3, 2)), np.array([-rng.uniform(0.1, 3.0), 0.0, 0.0])
        found = {}
        for sign in (1.0, -1.0):
            efforts_and_load = np.linalg.solve(np.column_stack([actuation, [-sign * mu, 0.0, 1.0]]), wanted)
            if sign * efforts_and_load[2] >= 0.0:
                found[sign] = efforts_and_load[:2]
        if not found:
            none += 1
            with pytest.raises(pc.ContactError):
                pc.inverse_dynamics(scene, state, wanted, actuation=actuation, cones=cones)
            continue
        least = min(found.values(), key=np.linalg.norm)
        better += len(found) == 2 and least is found[-1.0]
        result = pc.inverse_dynamics(scene, state, wanted, actuation=actuation, cones=cones)
        np.testing.assert_allclose(result.efforts, least, rtol=1e-6, atol=1e-9)
    assert better > 5
