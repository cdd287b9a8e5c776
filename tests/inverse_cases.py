"""Random states of the quadruped and of the arm for inverse dynamics within limits, and what must hold of the results,
checked by Pinocchio and by conditions that use none of the package's rows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf"
FEET, LEG, FOOT = ("fl", "fr", "hl", "hr"), 0.16, 0.016
PAD, REACH, HEIGHT, WAVE = 0.02, 0.07, 0.008, 24.0
# what the documents promise, in parts of the loads
LIMITS = 1e-6
# rounding of a few products of matrices
ROUND_OFF = 1e-10


@dataclass
class Case:
    """A scene with limits in its model, a state, what is wanted, and the contacts' coefficients along the first
    direction (x) and across it."""

    scene: pc.Scene
    state: pc.State
    wanted: dict[str, np.ndarray]
    weights: dict[str, float]
    mu: dict[str, tuple[float, float]]


def quadruped(rng: np.random.Generator) -> pc.Scene:
    """On a plane, some feet with elliptic cones."""
    scene = pc.Scene.from_urdf(URDF / "quadruped.urdf", floating_base=True)
    floor = scene.add_contour("floor", pc.Plane())
    centre = pin.SE3(np.eye(3), np.array([0.0, 0.0, -LEG]))
    for name in FEET:
        foot = scene.add_contour(name, pc.Sphere(FOOT), f"{name}_shank", centre)
        mu = float(rng.uniform(0.2, 1.0))
        if rng.random() < 0.3:
            law = pc.Coulomb((mu, mu * float(rng.uniform(0.4, 2.0))), along="floor")
        else:
            law = pc.Coulomb(mu)
        scene.add_contact(name, foot, floor, friction=law)
    return scene


def arm(rng: np.random.Generator) -> pc.Scene:
    """A spherical pad on a wavy surface."""
    scene = pc.Scene.from_urdf(URDF / "arm.urdf")
    pad = scene.add_contour("pad", pc.Sphere(PAD), "tool", pin.SE3(np.eye(3), np.array([0.0, 0.0, REACH])))
    surface = scene.add_contour(
        "surface",
        pc.HeightField(lambda x, y: HEIGHT * math.cos(WAVE * x) * math.cos(WAVE * y), domain=((0.2, 0.6), (-0.2, 0.2))),
        placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15])),
    )
    scene.add_contact("pad", pad, surface, friction=pc.Coulomb(float(rng.uniform(0.2, 1.0))))
    return scene


def coefficients(scene: pc.Scene) -> dict[str, tuple[float, float]]:
    laws = {name: contact.friction for name, contact in scene.contacts.items()}
    return {name: (law.sticking, law.sticking * law.aspect) for name, law in laws.items()}


def quadruped_state(scene: pc.Scene, rng: np.random.Generator) -> pc.State:
    """A random stance on four feet, some of which slide."""
    model = scene.model
    data = model.createData()
    q = pin.neutral(model)
    bend = rng.uniform(0.4, 0.9)
    q[2] = 2.0 * LEG * math.cos(bend) + FOOT
    q[3:7] = pin.Quaternion(pin.exp3(rng.uniform(-0.08, 0.08, 3))).coeffs()
    for name in FEET:
        q[model.joints[model.getJointId(f"{name}_hip")].idx_q] = bend + rng.uniform(-0.1, 0.1)
        q[model.joints[model.getJointId(f"{name}_knee")].idx_q] = -2.0 * bend
        q[model.joints[model.getJointId(f"{name}_side")].idx_q] = rng.uniform(-0.15, 0.15)
    # the knees and hips put the feet's centres at the height of their radius
    for _ in range(100):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        step = np.zeros(model.nv)
        for name in FEET:
            joint = model.getJointId(f"{name}_knee")
            centre = data.oMi[joint].act(np.array([0.0, 0.0, -LEG]))
            jacobian = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.WORLD)
            row = (jacobian[:3] + np.cross(jacobian[3:].T, centre).T)[2]
            row[:6] = 0.0
            step -= row * (centre[2] - FOOT) / (row @ row)
        q = pin.integrate(model, q, step)
    rest = scene.initial_state(q)
    return moving(scene, rest, rng)


def arm_state(scene: pc.Scene, rng: np.random.Generator) -> pc.State:
    """The pad somewhere on the surface, its tool nearly upright."""
    model = scene.model
    data = model.createData()
    x, y = rng.uniform([0.3, -0.1], [0.5, 0.1])
    z = HEIGHT * math.cos(WAVE * x) * math.cos(WAVE * y) + 0.15
    n = np.array(
        [
            HEIGHT * WAVE * math.sin(WAVE * x) * math.cos(WAVE * y),
            HEIGHT * WAVE * math.cos(WAVE * x) * math.sin(WAVE * y),
            1.0,
        ]
    )
    centre = np.array([x, y, z]) + PAD * n / np.linalg.norm(n)
    turned = pin.utils.rotate("y", math.pi) @ pin.exp3(rng.uniform(-0.2, 0.2, 3))
    wanted = pin.SE3(turned, centre - turned @ np.array([0.0, 0.0, REACH]))
    q = np.array([0.0, 0.6, 1.7, 0.0, math.pi - 2.3, 0.0])
    frame = model.getFrameId("tool")
    for _ in range(100):
        pin.framesForwardKinematics(model, data, q)
        error = pin.log6(data.oMf[frame].actInv(wanted))
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        step = np.linalg.solve(pin.Jlog6(wanted.actInv(data.oMf[frame])) @ jacobian, error.vector)
        q = q + step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-300))
    return moving(scene, scene.initial_state(q), rng)


def moving(scene: pc.Scene, rest: pc.State, rng: np.random.Generator) -> pc.State:
    """With a random velocity: each contact sticks, or slides with a third of a chance."""
    rows = []
    for kinematics in (pc.analyze(scene, rest)[name] for name in scene.contacts):
        rows.append(kinematics.rows if rng.random() < 2.0 / 3.0 else kinematics.rows[2:])
    stacked = np.vstack(rows)
    v = rng.normal(size=scene.model.nv) * 0.3
    v -= np.linalg.lstsq(stacked, stacked @ v, rcond=None)[0]
    return scene.initial_state(rest.q, v)


def random_case(kind: str, seed: int) -> Case:
    """kind: "quadruped" or "arm"."""
    rng = np.random.default_rng(seed)
    scene = quadruped(rng) if kind == "quadruped" else arm(rng)
    model = scene.model
    start = 6 if kind == "quadruped" else 0
    # from plenty to too little
    limits = model.effortLimit.copy()
    limits[start:] = 10.0 ** rng.uniform(0.0, 2.0) * rng.uniform(0.5, 1.5, model.nv - start)
    model.effortLimit = limits
    state = quadruped_state(scene, rng) if kind == "quadruped" else arm_state(scene, rng)
    size = 10.0 ** rng.uniform(-1.0, 1.0)
    if kind == "quadruped":
        wanted = {"root_joint": size * rng.normal(size=6), "fl_shank": size * rng.normal(size=3)}
        weights = {"root_joint": 1.0, "fl_shank": float(10.0 ** rng.uniform(-2.0, 0.0))}
    else:
        joint = list(model.names)[2]
        wanted = {"tool": size * rng.normal(size=6), joint: size * rng.normal(size=1)}
        weights = {"tool": 1.0, joint: 0.1}
    return Case(scene, state, wanted, weights, coefficients(scene))


# ---------------------------------------------------------------------------------- independent of the package's rows


@dataclass
class Independent:
    """The equations by Pinocchio: mass @ a + nle = tau + sum of contacts' jacobian^T force, forces on the robot; for
    each contact the jacobian (3, nv) of its material point in world axes, axes (3, 3) whose rows are both directions of
    friction and the normal, whether it sticks, and the direction (2,) of its slip."""

    mass: np.ndarray
    nle: np.ndarray
    jacobians: dict[str, np.ndarray]
    axes: dict[str, np.ndarray]
    sticks: dict[str, bool]
    slip: dict[str, np.ndarray]


def by_pinocchio(case: Case) -> Independent:
    model, q, v = case.scene.model, case.state.q, case.state.v
    data = model.createData()
    mass = pin.crba(model, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    nle = pin.rnea(model, data, q, v, np.zeros(model.nv)) + model.damping * v
    pin.computeJointJacobians(model, data, q)
    found = pc.analyze(case.scene, case.state)
    jacobians, axes, sticks, slip = {}, {}, {}, {}
    for name, contact in case.scene.contacts.items():
        at = found[name]
        joint = contact.first.joint
        jacobian = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.WORLD)
        jacobians[name] = jacobian[:3] + np.cross(jacobian[3:].T, at.point).T
        # (first, second, normal), into the robot's body
        n = np.array([0.0, 0.0, 1.0]) if name in FEET else at.frame[:, 2] / np.linalg.norm(at.frame[:, 2])
        n = n * np.sign(n[2])
        first = np.array([1.0, 0.0, 0.0]) - n[0] * n
        first /= np.linalg.norm(first)
        axes[name] = np.array([first, np.cross(n, first), n])
        velocity = axes[name][:2] @ (jacobians[name] @ v)
        speed = float(np.linalg.norm(velocity))
        sticks[name] = speed < 1e-6
        slip[name] = velocity / max(speed, 1e-300)
    return Independent(mass, nle, jacobians, axes, sticks, slip)


def check_result(case: Case, found: pc.InverseDynamics, independent: Independent) -> None:
    """The equations of motion, the contacts, cones and limits."""
    model, start = case.scene.model, case.scene.model.nv - found.efforts.size
    left = independent.mass @ found.acceleration + independent.nle - found.tau
    load = 0.0
    for name, force in found.forces.items():
        left += independent.jacobians[name].T @ force
        load = max(load, float(np.abs(force).max()))
    scale = max(float(np.abs(independent.nle).max()), load, float(np.abs(found.tau).max()))
    assert np.abs(left).max() <= ROUND_OFF * scale
    assert found.residual <= ROUND_OFF * scale
    np.testing.assert_array_equal(found.tau[:start], 0.0)
    assert (np.abs(found.efforts) <= model.effortLimit[start:] + LIMITS * scale).all()
    for name, kinematics in pc.analyze(case.scene, case.state).items():
        kept = kinematics.rows @ found.acceleration + kinematics.bias
        kept = kept if independent.sticks[name] else kept[2:]
        assert np.abs(kept).max() <= ROUND_OFF * (
            1.0 + np.abs(kinematics.bias).max() + np.abs(found.acceleration).max()
        )
        # on the robot, the first contour
        force = -independent.axes[name] @ found.forces[name]
        along, across = case.mu[name]
        normal = float(force[2])
        assert normal >= -LIMITS * scale
        if independent.sticks[name]:
            assert math.hypot(force[0] / along, force[1] / across) <= normal + LIMITS * scale / min(along, across)
        else:
            # of maximal dissipation
            squares = np.array([along, across]) ** 2 * independent.slip[name]
            expected = -normal * squares / math.sqrt(squares @ independent.slip[name])
            np.testing.assert_allclose(force[:2], expected, rtol=0.0, atol=1e-9 * scale)


def tasks(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Rows and goals (r,) of the wanted accelerations, times the roots of their weights, by Pinocchio."""
    model, q, v = case.scene.model, case.state.q, case.state.v
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    rows, goals = [], []
    for name, goal in case.wanted.items():
        root = math.sqrt(case.weights[name])
        if model.existJointName(name):
            joint = model.joints[model.getJointId(name)]
            row = np.eye(model.nv)[joint.idx_v : joint.idx_v + joint.nv]
            drift = np.zeros(joint.nv)
        else:
            frame, axes = model.getFrameId(name), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            row = pin.getFrameJacobian(model, data, frame, axes)[: goal.size]
            # by finite differences of the frame's velocity along the motion at constant v: d/dt (J v)
            step, speeds = 1e-5, []
            for h in (-step, step):
                other = model.createData()
                pin.forwardKinematics(model, other, pin.integrate(model, q, h * v), v)
                pin.updateFramePlacements(model, other)
                speeds.append(pin.getFrameVelocity(model, other, frame, axes).vector[: goal.size])
            drift = (speeds[1] - speeds[0]) / (2.0 * step)
        rows.append(root * row)
        goals.append(root * (goal - drift))
    return np.vstack(rows), np.concatenate(goals)


def kept(case: Case, independent: Independent) -> tuple[np.ndarray, np.ndarray]:
    """Rows and wanted values of the contacts' accelerations."""
    rows, values = [], []
    for name, kinematics in pc.analyze(case.scene, case.state).items():
        which = slice(0, 3) if independent.sticks[name] else slice(2, 3)
        rows.append(kinematics.rows[which])
        values.append(-kinematics.bias[which])
    return np.vstack(rows), np.concatenate(values)


def nearest_without_limits(case: Case, independent: Independent) -> np.ndarray:
    """Accelerations (nv,) that keep the contacts, as near to those wanted as that allows."""
    rows, goals = tasks(case)
    constraints, values = kept(case, independent)
    a = np.linalg.lstsq(constraints, values, rcond=None)[0]
    _, sizes, right = np.linalg.svd(constraints)
    null = right[int((sizes > 1e-9).sum()) :].T
    return a + null @ np.linalg.lstsq(rows @ null, goals - rows @ a, rcond=None)[0]


def check_certificate(case: Case, certificate: pc.FarkasCertificate, independent: Independent) -> None:
    """By Farkas: no forces within cones and limits have as little power under the certificate's velocity as the motion
    that is wanted."""
    p, model, a = certificate.velocity, case.scene.model, nearest_without_limits(case, independent)
    wanted = float(p @ (independent.mass @ a + independent.nle))
    start = 6 if case.scene.contacts.keys() >= set(FEET) else 0
    terms = float(np.abs(p * (independent.mass @ a + independent.nle)).max())
    # nothing moves what carries no torque
    least = -float(np.abs(p[start:]) @ model.effortLimit[start:])
    terms = max(terms, -least)
    # multipliers are as good as ProxQP where Newton's method does not finish; there are some cases in a hundred
    assert abs(certificate.wanted - wanted) <= 1e-4 * terms
    assert abs(certificate.least - least) <= 1e-4 * terms
    assert wanted < least
    for name, jacobian in independent.jacobians.items():
        # on the robot
        moved = independent.axes[name] @ (jacobian @ p)
        along, across = case.mu[name]
        size = float(np.linalg.norm(jacobian)) * float(np.abs(p).max())
        if independent.sticks[name]:
            work = moved[2] - math.hypot(along * moved[0], across * moved[1])
        else:
            squares = np.array([along, across]) ** 2 * independent.slip[name]
            work = moved[2] - float(moved[:2] @ squares) / math.sqrt(squares @ independent.slip[name])
        # of the multipliers again
        assert work >= -1e-5 * size, (name, work / size)


def solve(case: Case, **options: object) -> pc.InverseDynamics:
    return pc.inverse_dynamics(
        case.scene,
        case.state,
        case.wanted,
        weights=case.weights,
        cones=True,
        effort_limits=True,
        **options,  # type: ignore[arg-type]
    )


def check_case(case: Case) -> str:
    """Solve a case and check all; what came of it: "reached", "nearest" or "nothing"."""
    independent = by_pinocchio(case)
    try:
        found = solve(case, unreachable="nearest")
    except pc.InfeasibleError as error:
        check_certificate(case, error.certificate, independent)
        return "nothing"
    check_result(case, found, independent)
    rows, _ = tasks(case)
    missed = float(np.linalg.norm(rows @ (found.acceleration - nearest_without_limits(case, independent))))
    # finite differences of the frames' velocities
    assert abs(missed - found.shortfall) <= 1e-6 * (1.0 + missed)
    if found.certificate is None:
        return "reached"
    check_certificate(case, found.certificate, independent)
    try:
        solve(case)
    except pc.InfeasibleError as error:
        check_certificate(case, error.certificate, independent)
        return "nearest"
    raise AssertionError("accelerations that cannot be reached were not refused")
