"""One instant of random scenes: equations of motion, constraints and every law of friction, written out in NumPy.

Positions, velocities, Jacobians and inertias are Pinocchio's; of the package are only forces, accelerations, modes and
the directions of the contact frames.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from random_scenes import axis, placement

import pincontact as pc
from pincontact.analysis.instant import Instant
from pincontact.dynamics.impact import apply_impact
from pincontact.friction.solve import ContactSolver
from pincontact.layout import FREE, FRICTIONLESS, JOINT_END, MODE, SLIPPING

LAWS = {
    "none": lambda rng: None,
    "Coulomb": lambda rng: pc.Coulomb(rng.uniform(0.2, 1.0)),
    "static": lambda rng: pc.Coulomb(0.3, 0.6),
    "Stribeck": lambda rng: pc.Stribeck(0.2, 0.5, 0.3),
    "two directions": lambda rng: pc.Coulomb((0.6, 0.25)),
    "viscous": lambda rng: pc.Coulomb(0.3, viscous=0.7),
    "turning": lambda rng: pc.Coulomb(0.5, spinning=0.03, rolling=0.02),
    "ideal": lambda rng: pc.NoSlip(),
    "ideal turning": lambda rng: pc.NoSlip(spinning=0.02),
}
# rad/s^2 or m/s^2 against accelerations of some hundred: systems of condition numbers of up to 1e4
ACCURACY = 1e-9


def feet_scene(rng, laws, arm=None, bilateral=False, tilted=False, height=0.2):
    """A body on feet, one for each law, each on a plane of its own, and an arm on it: free, dry, or at its end.
    bilateral: all of them, or which."""
    model = pin.Model()
    model.gravity.linear = np.array([*rng.uniform(-3.0, 3.0, 2), -9.81])
    body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    spread = rng.normal(size=(3, 3))
    inertia = pin.Inertia(
        rng.uniform(0.5, 2.0), rng.uniform(-0.05, 0.05, 3), 0.02 * (spread @ spread.T) + 0.02 * np.eye(3)
    )
    model.appendBodyToJoint(body, inertia, pin.SE3.Identity())
    model.addBodyFrame("body", body, pin.SE3.Identity(), 0)
    if arm is not None:
        joint = model.addJoint(body, pin.JointModelRevoluteUnaligned(axis(rng)), placement(rng, 0.2), "arm")
        model.appendBodyToJoint(
            joint, pin.Inertia(0.4, rng.uniform(-0.2, 0.2, 3), 0.01 * np.eye(3)), pin.SE3.Identity()
        )
        model.damping[-1] = 0.2
        if "dry" in arm:
            model.lowerDryFrictionLimit[-1], model.upperDryFrictionLimit[-1] = -0.5, 0.8
        if "low" in arm:
            model.lowerPositionLimit[-1] = 0.0
        if "high" in arm:
            model.upperPositionLimit[-1] = 0.0
    scene = pc.Scene(model)
    n = len(laws)
    points = np.c_[rng.uniform(-0.3, 0.3, (n, 2)), np.full(n, -height)]
    for i, law in enumerate(laws):
        foot = scene.add_contour(f"foot {i}", pc.Point(), "body", placement=pin.SE3(np.eye(3), points[i]))
        turn = pin.utils.rotate("z", rng.uniform(0.0, 6.0))
        if tilted:
            turn = pin.exp3(np.array([*rng.uniform(-0.4, 0.4, 2), 0.0])) @ turn
        floor = scene.add_contour(f"floor {i}", pc.Plane(), placement=pin.SE3(turn, points[i]))
        # in either order: inside, the foot is body 1
        pair = (foot, floor) if rng.random() < 0.7 else (floor, foot)
        scene.add_contact(f"c{i}", *pair, friction=LAWS[law](rng), bilateral=bool(np.broadcast_to(bilateral, n)[i]))
    return scene, points


class Written:
    """An instant's equations, from Pinocchio: all forces act on the body with the feet."""

    def __init__(self, scene, points, state, tau):
        self.instant = Instant(scene, state, tau)
        self.system = system = self.instant.system
        self.a = self.instant.evaluate()
        model, data = scene.model, scene.model.createData()
        self.contacts = list(scene.contacts.values())
        pin.computeAllTerms(model, data, state.q, state.v)
        self.rest = pin.rnea(model, data, state.q, state.v, self.a) - tau + model.damping * state.v
        pin.forwardKinematics(model, data, state.q, state.v, self.a)
        pin.computeJointJacobians(model, data, state.q)
        self.feet = []
        for i, point in enumerate(points):
            frame = pin.Frame(f"p{i}", 1, 0, pin.SE3(np.eye(3), point), pin.FrameType.OP_FRAME)
            jacobian = pin.getFrameJacobian(model, data, 1, frame.placement, pin.LOCAL_WORLD_ALIGNED)
            v = pin.getFrameVelocity(model, data, 1, frame.placement, pin.LOCAL_WORLD_ALIGNED)
            a = pin.getFrameClassicalAcceleration(model, data, 1, frame.placement, pin.LOCAL_WORLD_ALIGNED)
            alpha = pin.getFrameAcceleration(model, data, 1, frame.placement, pin.LOCAL_WORLD_ALIGNED).angular
            basis = system.basis[i]
            self.feet.append((basis, jacobian, -v.linear, -a.linear, -v.angular, -alpha))
            assert basis @ basis.T == pytest.approx(np.eye(3), abs=1e-12)

    def check_motion(self):
        """M a + h = tau + J^T F: what is left over after all forces."""
        system, rest = self.system, self.rest.copy()
        for i, (basis, jacobian, *_) in enumerate(self.feet):
            rest += jacobian[:3].T @ (basis.T @ system.force[i])
        for k in system.resisting():
            _, jacobian, *_ = self.feet[system.owner(k)]
            rest += jacobian[3:].T @ (system.basis[k, :2].T @ system.force[k, :2])
        rest -= system.joint_forces()
        assert np.abs(rest).max() <= ACCURACY * 10.0, rest


def laws_hold(written):
    """Open, stick or slip, by the law of each contact, at the level of accelerations where it is at rest."""
    system = written.system
    size = 1.0 + np.abs(system.force).max()
    for i, (basis, _, v, a, _, _) in enumerate(written.feet):
        law, mode, force = written.contacts[i].friction, system.contact_int[i, MODE], system.force[i]
        speed, normal, bilateral = basis[:2] @ v, force[2], written.contacts[i].bilateral
        along = basis @ a
        # contact frames of planes do not turn
        if mode == FREE:
            assert along[2] > -1e-9
            assert not force.any()
            continue
        assert abs(along[2]) <= ACCURACY * size
        assert bilateral or normal >= -ACCURACY * size
        normal = abs(normal)
        if law is None:
            assert not force[:2].any()
            continue
        dry = force[:2] + law.viscous * speed
        stretch, turned = np.eye(2), 0.0
        aspect = law.aspect
        if aspect != 1.0:
            # the first direction is the first tangent of body 2, which is t1
            stretch = np.diag([1.0, aspect])
        if np.linalg.norm(speed) > 1e-9:
            direction = stretch @ speed
            coefficient = float(law.coefficient(np.linalg.norm(speed)))
        elif np.linalg.norm(along[:2]) > 1e-8 * size:
            direction = stretch @ along[:2]
            # accelerations are known to round-off of what forces make, and small ones have less of a direction
            turned = 1e-11 * size / np.linalg.norm(along[:2])
            coefficient = law.onset
        else:
            if law.sticking < math.inf:
                assert np.linalg.norm(np.linalg.solve(stretch, dry)) <= law.sticking * normal + 1e-8 * size
            continue
        if coefficient == math.inf:
            assert abs(normal) <= ACCURACY * size
            continue
        expected = -coefficient * normal * stretch @ direction / np.linalg.norm(direction)
        assert dry == pytest.approx(expected, abs=1e-8 * size + turned * np.abs(expected).max())
        assert (mode == SLIPPING) or np.abs(expected).max() < 1e-8 * size
    for k in system.resisting():
        owner = system.owner(k)
        law, (basis, _, _, _, omega, alpha) = written.contacts[owner].friction, written.feet[owner]
        spins = abs(abs(system.basis[k, 0] @ basis[2]) - 1.0) < 1e-9
        rows = basis[2:] if spins else basis[:2]
        length = law.spinning if spins else law.rolling
        torque = rows @ (system.basis[k][:2].T @ system.force[k][:2])
        rate, change = rows @ omega, rows @ alpha
        load = abs(system.force[owner, 2])
        if np.linalg.norm(rate) > 1e-9:
            assert torque == pytest.approx(-length * load * rate / np.linalg.norm(rate), abs=1e-8 * size)
        elif np.linalg.norm(change) > 1e-7 * size:
            assert torque == pytest.approx(-length * load * change / np.linalg.norm(change), abs=1e-8 * size)
        else:
            assert np.linalg.norm(torque) <= length * load + 1e-8 * size
    for limit in system.limits:
        k, force = limit.index_v, system.joint_forces()[limit.index_v]
        speed, rate = written.instant.v[k], written.a[k]
        low, high = limit.low_force, limit.high_force
        at_low, at_high = limit.low_end == 0.0, limit.high_end == 0.0
        if abs(speed) > 1e-9 or abs(rate) > 1e-8 * size:
            assert force == pytest.approx(low if (speed if abs(speed) > 1e-9 else rate) > 0.0 else high, abs=1e-9)
            assert speed != 0.0 or (not (at_low and rate < 0.0) and not (at_high and rate > 0.0))
        else:
            assert force >= low - 1e-9 * size or at_high
            assert force <= high + 1e-9 * size or at_low


def one(rng, laws, moving=False, about=False, **options):
    scene, points = feet_scene(rng, laws, **options)
    nv = scene.model.nv
    v = np.zeros(nv)
    if moving:
        v[:2], v[5] = rng.normal(size=2), rng.normal()
        if nv > 6 and not any(end in options["arm"] for end in ("low", "high")):
            v[6] = rng.normal()
    if about:
        # the first foot is a pivot
        v[5] = rng.uniform(0.5, 3.0)
        v[:3] = -np.cross(v[3:6], points[0])
    state = scene.initial_state(pin.neutral(scene.model), v)
    tau = np.r_[rng.normal(size=3) * 4.0, rng.normal(size=3) * 0.4, rng.normal(size=nv - 6)]
    return Written(scene, points, state, tau)


def check(seed, laws, **options):
    written = one(np.random.default_rng(seed), laws, **options)
    written.check_motion()
    laws_hold(written)


TWICE, THRICE = (pytest.mark.parametrize("seed", range(count)) for count in (2, 3))


@TWICE
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("feet", [1, 2, 3, 4])
def test_from_rest(feet, law, seed):
    check([feet, list(LAWS).index(law), seed], [law] * feet, tilted=feet == 2)


# ideal rolling does not slip
@TWICE
@pytest.mark.parametrize("law", [law for law in LAWS if "ideal" not in law])
@pytest.mark.parametrize("feet", [1, 2, 4])
def test_in_slip(feet, law, seed):
    """On a level floor. What opens has no viscous force, without which it may close."""
    if not (law == "viscous" and feet > 2):
        check([7, feet, list(LAWS).index(law), seed], [law] * feet, moving=True)


@THRICE
@pytest.mark.parametrize("arm", ["free", "dry", "low", "high", "dry low", "dry high"])
@pytest.mark.parametrize("laws", [["Coulomb"], ["ideal", "none"], ["Coulomb", "turning", "static"]])
def test_with_an_arm(laws, arm, seed):
    check([8, len(laws), seed], laws, arm=arm)


@THRICE
@pytest.mark.parametrize("arm", ["dry", "low", "dry high"])
@pytest.mark.parametrize("laws", [["Coulomb"], ["Coulomb", "turning", "none"]])
def test_with_an_arm_in_slip(laws, arm, seed):
    check([9, len(laws), seed], laws, arm=arm, moving=True)


@THRICE
@pytest.mark.parametrize("laws", [["Coulomb"], ["Coulomb", "viscous"], ["turning", "Stribeck"], ["two directions"]])
@pytest.mark.parametrize("moving", [False, True])
def test_bilateral(moving, laws, seed):
    check([10, len(laws), seed], laws, bilateral=True, moving=moving, arm="dry")


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("laws", [["Coulomb"], ["Coulomb", "viscous"], ["two directions"] * 2, ["Coulomb"] * 3])
def test_bilateral_from_rest(laws, seed):
    """Slip begins in a direction of its own, not against the force that would have held."""
    check([14, len(laws), seed], laws, bilateral=True, arm="dry")


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("law", ["static", "Stribeck", "two directions", "viscous", "turning"])
def test_four_feet_begin_to_slip_together(law, seed):
    """Their loads are redundant, and others once they slide: these decide where to."""
    check([15, list(LAWS).index(law), seed], [law] * 4)


@THRICE
@pytest.mark.parametrize(
    "laws",
    [
        ["ideal", "Coulomb"],
        ["ideal", "Coulomb", "none"],
        ["ideal turning", "Coulomb"],
        ["Coulomb", "viscous"],
        ["static", "Stribeck"],
        ["none", "turning"],
        ["Coulomb"] * 3,
    ],
)
def test_about_a_foot_at_rest(laws, seed):
    """Some rest, or begin to slip, while others slide: their loads depend on each other."""
    # low enough that there always is a solution (Painleve)
    check([13, len(laws), seed], laws, about=True, height=0.02)


@pytest.mark.parametrize("seed", range(12))
def test_all_laws_together(seed):
    rng = np.random.default_rng([11, seed])
    check([12, seed], list(rng.choice(list(LAWS), 3, replace=False)), arm="dry", tilted=bool(seed % 2))


@pytest.mark.parametrize(
    "seed",
    # of the first the laws do not hold where modes are changed one after the other, of the next no solution is found
    [
        *(51, 73, 86, 105, 116, 133, 134, 139, 140, 160, 175, 187, 194, 229, 314, 321, 351, 402, 418, 440, 479, 494),
        *(34, 61, 198, 254, 384, 404, 625, 731, 907, 920),
        *range(2, 20),
    ],
)
def test_feet_some_of_which_cannot_open(seed):
    """Together with others, an arm that is free, dry or at its end; from rest, in slip, and about a foot."""
    rng = np.random.default_rng([77, seed])
    n = int(rng.integers(1, 5))
    laws = [str(law) for law in rng.choice(list(LAWS), n)]
    bilateral = rng.random(n) < 0.6
    bilateral[0] |= not bilateral.any()
    arm = [None, "free", "dry", "low", "dry high"][rng.integers(5)]
    tilted, height = bool(rng.random() < 0.4), float(rng.choice([0.02, 0.1, 0.2]))
    kind = ["rest", "moving", "about"][rng.integers(3)]
    scene, points = feet_scene(rng, laws, arm, bilateral, tilted, height)
    v = np.zeros(scene.model.nv)
    if kind == "moving" and not tilted:
        v[:2], v[5] = rng.normal(size=2), rng.normal()
        if arm in ("free", "dry"):
            v[6] = rng.normal()
    elif kind == "about" and not tilted:
        v[5] = rng.uniform(0.5, 3.0)
        v[:3] = -np.cross(v[3:6], points[0])
    tau = np.r_[rng.normal(size=3) * 8.0, rng.normal(size=3) * 0.4, rng.normal(size=v.size - 6)]
    written = Written(scene, points, scene.initial_state(pin.neutral(scene.model), v), tau)
    written.check_motion()
    laws_hold(written)


# ------------------------------------------------------------------------------------------------ impacts


def impulses_of(rng, laws, bilateral=False, restitution=0.0, arm=None):
    """A body with feet, thrown at its floors: velocities of the feet before and after the impact, impulses (n, 3) on
    the floors, from the momentum they make, and what the impact says of its work."""
    scene, points = feet_scene(rng, laws, bilateral=bilateral, arm=arm, tilted=True)
    nv = scene.model.nv
    state = scene.initial_state(pin.neutral(scene.model), np.zeros(nv))
    written = Written(scene, points, state, np.zeros(nv))
    system = written.system
    for c in range(len(laws)):
        system.contact_int[c, MODE] = FRICTIONLESS
    v = rng.normal(size=nv)
    v[2] = -2.0
    system.v[:] = v
    system.evaluate(0.0)
    before = [basis @ (-jacobian[:3] @ v) for basis, jacobian, *_ in written.feet]
    solver = ContactSolver()
    impact = apply_impact(system, solver, list(range(len(laws))), [], dict.fromkeys(range(len(laws)), restitution))
    assert impact is not None
    change = system.v - v
    after = [basis @ (-jacobian[:3] @ system.v) for basis, jacobian, *_ in written.feet]
    mass = pin.crba(scene.model, scene.model.createData(), state.q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    columns = np.hstack([-jacobian[:3].T @ basis.T for basis, jacobian, *_ in written.feet])
    for i, law in enumerate(laws):
        columns[:, 3 * i : 3 * i + 2] *= law != "none"
    impulses, *_ = np.linalg.lstsq(columns, mass @ change, rcond=1e-12)
    assert columns @ impulses == pytest.approx(mass @ change, abs=1e-10)
    kinetic = 0.5 * system.v @ mass @ system.v - 0.5 * v @ mass @ v
    # a bilateral contact's own velocity, zero but here, takes part in no work
    assert bilateral or impact.contacts + impact.joints == pytest.approx(kinetic, abs=1e-10)
    assert impact.drives == 0.0
    return written, np.array(before), np.array(after), impulses.reshape(-1, 3), impact


@pytest.mark.parametrize("restitution", [0.0, 0.6])
@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize(
    "laws", ["none", "Coulomb", "ideal", "two directions", "Stribeck", "Coulomb none", "ideal none"]
)
def test_impacts_obey_the_laws(laws, bilateral, restitution):
    """Newton's restitution along the normals, Coulomb's law between impulses and the slip that is left."""
    laws = [laws] if laws in LAWS else laws.split()
    rng = np.random.default_rng([20, len(laws), bilateral])
    for _ in range(3):
        written, before, after, impulses, impact = impulses_of(rng, laws, bilateral, restitution)
        size = 1.0 + np.abs(impulses).max()
        for i, impulse in enumerate(impulses):
            law = written.contacts[i].friction
            u, normal = after[i], impulse[2]
            if bilateral:
                assert u[2] == pytest.approx(0.0, abs=1e-9 * size)
                normal = abs(normal)
            else:
                # nothing pulls, or closes, and what was pressed leaves as fast as it is to
                left = u[2] + impact.kept * restitution * min(before[i, 2], 0.0)
                assert normal >= -1e-9 * size
                assert left >= -1e-9 * size
                assert normal * left == pytest.approx(0.0, abs=1e-8 * size)
            if law is None:
                assert impulse[:2] == pytest.approx(np.zeros(2), abs=1e-9 * size)
                continue
            stretch = np.diag([1.0, law.aspect])
            speed = np.linalg.norm(u[:2])
            mu = law.sliding
            if isinstance(law, pc.Stribeck):
                mu = float(law.coefficient(np.linalg.norm(before[i, :2])))
            if speed < 1e-9:
                if mu < math.inf:
                    assert np.linalg.norm(np.linalg.solve(stretch, impulse[:2])) <= mu * normal + 1e-8 * size
            elif mu < math.inf:
                direction = stretch @ u[:2]
                expected = -mu * normal * stretch @ direction / np.linalg.norm(direction)
                assert impulse[:2] == pytest.approx(expected, abs=1e-8 * size)
            else:
                assert normal <= 1e-8 * size
        # kept is all of it, unless that would create energy
        assert bilateral or impact.contacts <= 1e-12 * size**2
        assert impact.kept == 1.0 or impact.contacts > -1e-3 * size**2


@pytest.mark.parametrize("end", [-1, 1])
def test_ends_of_joints_take_part_in_impacts(end):
    """An arm that moves into its end while the foot strikes: its impulse pushes back, and it stops."""
    rng = np.random.default_rng(21)
    for _ in range(4):
        scene, points = feet_scene(rng, ["Coulomb"], arm="low" if end < 0 else "high")
        nv = scene.model.nv
        state = scene.initial_state(pin.neutral(scene.model), np.zeros(nv))
        written = Written(scene, points, state, np.zeros(nv))
        system = written.system
        system.joint_int[0, JOINT_END] = end
        v = rng.normal(size=nv)
        v[2], v[-1] = -1.0, 3.0 * end
        system.v[:] = v
        system.evaluate(0.0)
        impact = apply_impact(system, ContactSolver(), [0], [0], {})
        mass = pin.crba(scene.model, scene.model.createData(), state.q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        momentum = mass @ (system.v - v)
        basis, jacobian, *_ = written.feet[0]
        columns = np.c_[-jacobian[:3].T @ basis.T, np.eye(nv)[-1]]
        impulses = np.linalg.lstsq(columns, momentum, rcond=1e-12)[0]
        assert columns @ impulses == pytest.approx(momentum, abs=1e-10)
        # away from the end, and no further into it
        assert impulses[3] * end <= 1e-10
        assert system.v[-1] * end <= 1e-10
        assert impulses[3] * system.v[-1] == pytest.approx(0.0, abs=1e-10)
        speed = 0.5 * (v[-1] + system.v[-1])
        assert impact.joints == pytest.approx(impulses[3] * speed, abs=1e-10)
        kinetic = 0.5 * system.v @ mass @ system.v - 0.5 * v @ mass @ v
        assert impact.contacts + impact.joints == pytest.approx(kinetic, abs=1e-10)


@pytest.mark.parametrize("rtol", [1e-5, 1e-8, 1e-10])
def test_fingers_slip_one_after_the_other(rtol):
    """Two fingers let a box go, of which one holds a little longer, 0.3 ms: as slip begins at one of them it does not
    at the other one yet, however long it takes to show."""
    model = pin.Model()
    for name in ("left", "right"):
        joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(0.1, np.zeros(3), 1e-4 * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia(0.2, np.zeros(3), 1e-4 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("box", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    for name, side, mu in (("left", -1.0, 0.5), ("right", 1.0, 0.50003)):
        face = pin.SE3(pin.utils.rotate("y", 0.5 * np.pi * side), np.array([0.05 * side, 0.0, 0.0]))
        tip = scene.add_contour(f"{name} tip", pc.Sphere(0.01), name)
        # both resist turning about the line between them, which is redundant
        scene.add_contact(
            name, tip, scene.add_contour(f"{name} face", pc.Plane(), "box", face), pc.Coulomb(mu, spinning=1e-3)
        )
    state = scene.initial_state([-0.06, 0.06, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

    def control(t, q, v):
        grip = 2.2 - 1.2 * t
        return np.array([grip, -grip, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])

    run = pc.simulate(scene, state, 0.3, rtol=rtol, atol=0.01 * rtol, control=control)
    assert [(event.kind, event.contact) for event in run.events] == [("slip", "left"), ("slip", "right")]
    # half the weight at the first limit
    first = (2.2 - 0.5 * 0.2 * 9.81 / 0.5) / 1.2
    assert run.events[0].time == pytest.approx(first, abs=1e-7)
    assert run.events[1].time - first == pytest.approx(2.943e-4, abs=2e-7)
