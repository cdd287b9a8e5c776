"""Slips that jam (Painleve) in the course of a run: an impact without collision stops them, and the run goes on."""

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import quad

import pincontact as pc

G, FOOT, FOOT_FRICTION = 9.81, 0.1, 0.01


class Pusher:
    """A carriage pushes a rod whose tip slides ahead over a floor that sinks: as the rod gets as steep as friction,
    tan(angle) = 1 / mu, the tip's load grows without bound.

    The rod's centre of mass is in its hinge, so that only a torque loads it: the load follows from the angle alone. A
    light foot of the carriage slides on the floor, and goes on to slide.
    """

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.mu, self.length, self.inertia = rng.uniform(0.5, 2.0), rng.uniform(0.5, 1.5), rng.uniform(0.05, 0.2)
        self.mass, self.torque, self.sinks = rng.uniform(100.0, 200.0), rng.uniform(1.0, 2.0), rng.uniform(0.02, 0.03)
        self.steepest = math.atan(1.0 / self.mu)
        self.angle = self.steepest - rng.uniform(0.1, 0.2)
        self.speed = rng.uniform(12.0, 14.0)
        model = pin.Model()
        carriage = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "carriage")
        model.appendBodyToJoint(carriage, pin.Inertia(self.mass, np.zeros(3), np.eye(3)), pin.SE3.Identity())
        hinge = model.addJoint(carriage, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
        model.appendBodyToJoint(hinge, pin.Inertia(1.0, np.zeros(3), self.inertia * np.eye(3)), pin.SE3.Identity())
        foot = model.addJoint(carriage, pin.JointModelPZ(), pin.SE3.Identity(), "foot")
        model.appendBodyToJoint(foot, pin.Inertia(FOOT, np.zeros(3), np.eye(3)), pin.SE3.Identity())
        self.mass += 1.0 + FOOT
        self.scene = pc.Scene(model)
        below = pin.SE3(np.eye(3), np.array([0.0, 0.0, -self.length * math.sin(self.angle)]))
        motion = pc.ConstantTwist(linear=[0.0, 0.0, -self.sinks])
        self.scene.add_contour("floor", pc.Plane(), placement=below, motion=motion)
        self.scene.add_contour("tip", pc.Point(), "hinge", pin.SE3(np.eye(3), np.array([self.length, 0.0, 0.0])))
        self.scene.add_contact("tip", "tip", "floor", pc.Coulomb(self.mu))
        self.scene.add_contour("foot", pc.Point(), "foot")
        self.scene.add_contact("foot", "foot", "floor", pc.Coulomb(FOOT_FRICTION))

    def run(self, duration: float, **options) -> pc.Trajectory:
        q = [0.0, self.angle, -self.length * math.sin(self.angle)]
        state = self.scene.initial_state(q, [self.speed, self.turns(self.angle), -self.sinks])
        torques = [0.0, self.torque, 0.0]
        return pc.simulate(self.scene, state, duration, control=lambda t, q, v: torques, **options)

    def turns(self, angle: float) -> float:
        """Speed in rad/s at which the sinking floor lets the rod turn."""
        return self.sinks / (self.length * math.cos(angle))

    def time(self, angle: float) -> float:
        return self.length * (math.sin(angle) - math.sin(self.angle)) / self.sinks

    def slowed(self, angle: float) -> float:
        """By how much friction has slowed the carriage, in m/s."""

        def force(at: float) -> float:
            turns = self.turns(at)
            load = (self.torque - self.inertia * math.tan(at) * turns**2) / self.length
            return self.mu * load / (math.cos(at) - self.mu * math.sin(at)) / turns / self.mass

        return quad(force, self.angle, angle, limit=200)[0] + FOOT_FRICTION * FOOT * G / self.mass * self.time(angle)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_a_tip_whose_load_grows_without_bound_is_stopped(seed, method):
    """The load goes with the inverse of the time that is left, and what it takes from the speed with its logarithm: all
    that is left of that is taken at once. From then on the tip stays where it is, and the floor moves the carriage."""
    pusher = Pusher(seed)
    jams = pusher.time(pusher.steepest)
    # the load has lost its sign, to round-off, where 1e-9 of it is left
    close = 1e-8 * pusher.angle / pusher.turns(pusher.angle)
    run = pusher.run(jams + 0.05, method=method, energies=True)
    assert run.status == 0, run.message
    (event,) = run.events
    assert (event.kind, event.contact) == ("stick", "tip")
    assert 0.0 < jams - event.time < close
    before = run.t < jams - 1e-3
    angles = np.arcsin(math.sin(pusher.angle) + run.t * pusher.sinks / pusher.length)
    assert before.sum() > 3
    for speed, angle in zip(run.v[before, 0], angles[before]):
        # the tolerance, 1e-8, and a hundred times more for a load that grows a thousandfold
        assert speed == pytest.approx(pusher.speed - pusher.slowed(angle), rel=1e-6)
    stuck = run.t > event.time
    assert stuck.sum() > 2
    assert run.v[stuck, 0] == pytest.approx(pusher.sinks * np.tan(angles[stuck]), abs=1e-8)
    assert run.q[stuck, 1] == pytest.approx(angles[stuck], abs=1e-8)
    tip = run.q[stuck, 0] + pusher.length * np.cos(run.q[stuck, 1])
    assert np.ptp(tip) < 1e-8
    # where the tip jams there are two states, of which the first has no forces
    assert (run.contacts["foot"].mode[run.t != event.time] == 2).all()
    # the impulse's work is friction's
    lost = 0.5 * pusher.mass * pusher.speed**2
    assert np.abs(run.energies().balance).max() < 1e-6 * lost
    assert run.energies().friction_work[-1] == pytest.approx(-lost, rel=1e-2)


def limp_biped():
    """Two legs of three joints, and four points on or above the floor, one of which slides, and jams in 3.2 ms."""
    model, joint = pin.Model(), 0
    small = 1e-3 / 60.0 * np.ones(3)
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("turn", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
        mass, moments = (4.0, np.array([0.8, 1.0, 0.52]) / 12.0) if name == "turn" else (0.01, small)
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.diag(moments)), pin.SE3.Identity())
    for leg in range(2):
        parent, place = joint, np.array([0.05 * (1 - 2 * leg), 0.0, -0.2])
        for name, mass, size, lever in (
            ("hip", 1.0, (0.05, 0.05, 0.3), (0.0, 0.0, -0.15)),
            ("knee", 0.7, (0.05, 0.05, 0.3), (0.0, 0.0, -0.15)),
            ("foot", 0.4, (0.2, 0.05, 0.03), (0.03, 0.0, -0.02)),
        ):
            parent = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), place), f"{name}{leg}")
            box = pin.Inertia.FromBox(mass, *size)
            model.appendBodyToJoint(parent, pin.Inertia(mass, np.array(lever), box.inertia), pin.SE3.Identity())
            place = np.array([0.0, 0.0, -0.3])
        model.addBodyFrame(f"foot {leg}", parent, pin.SE3.Identity(), 0)
    model.damping = np.r_[np.zeros(3), 0.07965397 * np.ones(6)]
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for leg, x in ((0, -0.06), (0, 0.12), (1, -0.06), (1, 0.12)):
        place = pin.SE3(np.eye(3), np.array([x, 0.0, -0.04]))
        point = scene.add_contour(f"{leg}{x:+}", pc.Point(), f"foot {leg}", placement=place)
        scene.add_contact(f"{leg}{x:+}", point, floor, pc.Coulomb(0.8764555819943509))
    q = [-0.075653141080, 0.259610076285, 0.141153105507]
    q += [0.864509951301, -3.169554898048, 1.728194505699, 1.587232024492, -3.044040172567, 1.315655042568]
    v = [-0.117578212259, -2.810979090141, -0.257035362155]
    v += [-4.150944828987, -14.063289035457, 0.538181065347, 5.448736987138, -9.644945419177, 4.453243794194]
    return scene, scene.initial_state(q, v, free=["0+0.12"])


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_jams_do_not_depend_on_the_tolerance(method):
    """Whether steps get too short first, or a load of 6e7 N is seen to change its sign, is chance."""
    scene, start = limp_biped()
    steps, found = pc.simulate(scene, start, 0.01, method="Moreau", dt=2e-6), []
    for rtol in (1e-6, 1e-8, 1e-10):
        run = pc.simulate(scene, start, 0.01, method=method, rtol=rtol, atol=1e-2 * rtol)
        assert run.status == 0, run.message
        found.append(run.v[-1][2])
    # without the impulse that stops the slip it turns at -1.95 rad/s and not at -2.30; the jam multiplies errors
    assert found[-1] == pytest.approx(steps.v[-1][2], abs=1e-2)
    assert found == pytest.approx([found[-1]] * 3, abs=1e-5)


def skateboard(seed, ideal=()):
    """Two leaning trucks of two wheels each that turn faster or slower than they roll, on a slope. Some slips turn, and
    jam, within milliseconds. ideal: wheels that cannot slip; the others do so slowly then."""
    rng = np.random.default_rng(seed)
    model, wheels = pin.Model(), []
    frame = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "frame")
    mass = rng.uniform(1.0, 30.0)
    rng.uniform(size=3)
    moments = np.diag(np.sort(rng.uniform(0.5, 0.9, 3)) * mass * 0.05)
    model.appendBodyToJoint(frame, pin.Inertia(mass, np.array([0.3, 0.0, 0.1]), moments), pin.SE3.Identity())
    for x, way in ((0.0, 1.0), (0.6, -1.0)):
        lean = way * rng.uniform(0.3, 0.9)
        axis = pin.JointModelRevoluteUnaligned(np.array([math.sin(lean), 0.0, math.cos(lean)]))
        truck = model.addJoint(frame, axis, pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), f"truck {x}")
        model.appendBodyToJoint(truck, pin.Inertia(0.5, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
        for y in (0.1, -0.1):
            place = pin.SE3(np.eye(3), np.array([0.02 * way, y, 0.0]))
            wheel = model.addJoint(truck, pin.JointModelRY(), place, f"wheel {x} {y}")
            inertia = pin.Inertia(0.3, np.zeros(3), np.diag([1e-3, 2e-3, 1e-3]))
            model.appendBodyToJoint(wheel, inertia, pin.SE3.Identity())
            wheels.append(wheel)
    scene = pc.Scene(model)
    slope = pin.utils.rotate("y", rng.uniform(-0.2, 0.2)) @ pin.utils.rotate("x", rng.uniform(-0.1, 0.1))
    floor = scene.add_contour("floor", pc.Plane(), placement=pin.SE3(slope, np.zeros(3)))
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    for i, wheel in enumerate(wheels):
        rim = scene.add_contour(f"rim {i}", pc.Circle(0.05), model.names[wheel], upright)
        mu = rng.uniform(0.05, 0.9)
        law = pc.NoSlip() if i in ideal else pc.Coulomb(mu)
        if not ideal and rng.random() < 0.5:
            law = pc.Stribeck(mu, 1.3 * mu, 0.1)
        scene.add_contact(f"wheel {i}", floor, rim, friction=law)
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[:3], q[3:7], v[0] = slope @ [0.0, 0.0, 0.05], pin.Quaternion(slope).coeffs(), rng.uniform(0.5, 4.0)
    for wheel in wheels:
        v[model.joints[wheel].idx_v] = v[0] / 0.05 * (1.0 + 1e-3 * rng.normal() if ideal else rng.uniform(0.5, 1.5))
    v[[6, 9]] = 0.3 * rng.normal(size=2)
    return scene, scene.initial_state(q, v, max_gap=0.3)


# slip that jams and goes on in another direction, with more friction where it is slower, or ends; before, runs ended
# there with a status (858, 1346), or with all slips stopped (93)
@pytest.mark.parametrize(
    ("seed", "jams"), [(93, 6.2e-4), (858, 4.79e-3), (1346, 2.58e-3), (2057, 2.0e-3), (2471, 9.9e-4), (2927, 1.6e-3)]
)
def test_jams_of_skateboards_are_those_of_short_steps(seed, jams):
    scene, state = skateboard(seed)
    near = pc.simulate(scene, state, jams - 1e-4).state(-1)
    after = [
        pc.simulate(scene, near, 2e-4, **options)
        for options in ({}, {"rtol": 1e-10, "atol": 1e-12}, {"method": "Moreau", "dt": 1e-6})
    ]
    assert [run.status for run in after] == [0, 0, 0]
    assert max(run.contacts[name].normal_force.max() for run in after[:2] for name in scene.contacts) > 1e3
    # wheels turn by up to 1e2 rad/s; the accuracy of steps of a microsecond
    for run in after[:2]:
        np.testing.assert_allclose(run.v[-1], after[2].v[-1], rtol=0.0, atol=1e-4)


def test_slow_slips_beside_wheels_that_cannot_slip():
    """The loads of the latter shrink to nothing as friction grows without bound, and were lost on the way."""
    ideal = np.random.default_rng(1_000_136).choice(4, 2, replace=False).tolist()
    scene, state = skateboard(136, ideal)
    run, steps = pc.simulate(scene, state, 1e-4), pc.simulate(scene, state, 1e-4, method="Moreau", dt=1e-6)
    assert run.status == steps.status == 0, run.message
    np.testing.assert_allclose(run.v[-1], steps.v[-1], atol=1e-2)
