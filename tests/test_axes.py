"""Velocities of turning joints in the axes of their parents, in which the pairs integrate them, and steps in which a
contact runs over poles of its charts."""

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.special import ellipj, ellipk
from shared import one_body

import pincontact as pc
from pincontact.integration.run_system import RunSystem
from pincontact.integration.runge_kutta import RungeKutta
from pincontact.integration.tableaux import tableau

G = 9.81


def model_of_all_joints():
    """Every kind of joint that turns, one of them within a composite, with a revolute and a prismatic one between."""
    model = pin.Model()
    composite = pin.JointModelComposite()
    composite.addJoint(pin.JointModelPZ())
    composite.addJoint(pin.JointModelSpherical())
    index = 0
    for joint in (
        pin.JointModelFreeFlyer(),
        pin.JointModelRX(),
        pin.JointModelPlanar(),
        pin.JointModelSpherical(),
        composite,
        pin.JointModelRUBZ(),
    ):
        index = model.addJoint(index, joint, pin.SE3.Random(), f"joint{index}")
        model.appendBodyToJoint(index, pin.Inertia.Random(), pin.SE3.Random())
    return model


def states(seed):
    """A pair on a free mechanism, and random (q, v)."""
    pin.seed(seed)
    rng = np.random.default_rng(seed)
    model = model_of_all_joints()
    pair = RungeKutta(RunSystem(model, []), tableau("DOP853"), 1e-8, 1e-10, None)
    low, high = -np.ones(model.nq), np.ones(model.nq)
    return pair, [(pin.randomConfiguration(model, low, high), rng.normal(size=model.nv)) for _ in range(20)]


def velocities(pair, q, v):
    """(nv,) those of the state for (q, v)."""
    pair.begin_at(q, v, np.zeros((0, 4)))
    return pair.system.state[pair.system.nq :].copy()


def test_there_and_back():
    pair, samples = states(3)
    for q, v in samples:
        w = velocities(pair, q, v)
        np.testing.assert_array_equal(pair.system.v, v)
        pair.load(pair.system.state)
        np.testing.assert_allclose(pair.system.v, v, rtol=0.0, atol=1e-14)
        # turned, not stretched
        assert np.linalg.norm(w) == pytest.approx(np.linalg.norm(v), rel=1e-14)
        # a free joint's linear velocity is that of its frame's origin
        rotation = pin.Quaternion(q[3:7]).matrix()
        np.testing.assert_allclose(w[:3], rotation @ v[:3], rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(w[3:6], rotation @ v[3:6], rtol=0.0, atol=1e-14)


def test_rates():
    """Against central differences along q' = v, v' = a: relative errors of h^2 and of round-off over h."""
    pair, samples = states(4)
    system, model, h = pair.system, pair.system.model, 1e-5
    for q, v in samples:
        pair.begin_at(q, v, np.zeros((0, 4)))
        pair.evaluate_start(0.0)
        rate, a = system.slopes[0, system.nq :].copy(), system.acceleration.copy()
        ends = [velocities(pair, pin.integrate(model, q, s * h * v), v + s * h * a) for s in (-1.0, 1.0)]
        np.testing.assert_allclose(rate, (ends[1] - ends[0]) / (2.0 * h), rtol=0.0, atol=1e-8 * np.abs(a).max())


@pytest.mark.parametrize("method", ["DOP853", "RK45", "RK23"])
@pytest.mark.parametrize("joint", [pin.JointModelFreeFlyer(), pin.JointModelPlanar()])
def test_a_spinning_ball_flies_on_a_parabola(method, joint):
    """Which any step follows to round-off, whatever the ball's spin."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -G, 0.0])
    index = model.addJoint(0, joint, pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(index, pin.Inertia(0.3, np.zeros(3), 0.02 * np.eye(3)), pin.SE3.Identity())
    scene = pc.Scene(model)
    v = np.zeros(model.nv)
    v[:2], v[-1] = (3.0, 4.0), 250.0
    run = pc.simulate(scene, scene.initial_state(pin.neutral(model), v), 1.0, method=method, fixed_step=0.5)
    assert run.stats["steps"] == 2
    np.testing.assert_array_equal(run.v[0], v)
    np.testing.assert_allclose(run.q[-1, :2], [3.0, 4.0 - 0.5 * G], rtol=0.0, atol=1e-12)


def bowl_scene(radius, bowl):
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(0.5, np.zeros(3), 0.2 * radius**2 * np.eye(3)), "ball")
    scene = pc.Scene(model)
    ball = scene.add_contour("ball", pc.Sphere(radius), "ball")
    scene.add_contact("c", ball, scene.add_contour("bowl", pc.Sphere(bowl)), friction=pc.NoSlip(), side=-1)
    return scene


@pytest.mark.parametrize("rtol", [1e-1, 1e-2, 1e-4, 1e-6])
def test_ball_in_a_bowl_in_long_steps(rtol):
    """It rolls to and fro like a pendulum of length 7/5 (R - r); half a turn in a step takes it over poles."""
    radius, bowl, amplitude = 0.2, 1.0, 1.2
    length = bowl - radius
    scene = bowl_scene(radius, bowl)
    q = [length * math.sin(amplitude), 0.0, -length * math.cos(amplitude), 0.0, 0.0, 0.0, 1.0]
    times = np.linspace(0.0, 4.0, 21)
    run = pc.simulate(scene, scene.initial_state(q), 4.0, t_eval=times, rtol=rtol, atol=1e-2 * rtol)
    assert run.status == 0, run.message
    assert not run.events
    assert run.stats["steps"] <= 60
    k = math.sin(0.5 * amplitude)
    sine = ellipj(math.sqrt(5.0 * G / (7.0 * length)) * times + ellipk(k * k), k * k)[0]
    theta = 2.0 * np.arcsin(k * sine)
    expected = length * np.column_stack([np.sin(theta), np.zeros_like(theta), -np.cos(theta)])
    # some ten steps, in each of which the error may reach the tolerance
    assert np.abs(run.q[:, :3] - expected).max() <= rtol
    assert max(values.max() for values in run.residuals().values()) <= 1e-12


def test_spheres_need_no_newton():
    """One in the other, one beside the other, a point on one: each in closed form, on the side that a guess names."""
    scene = bowl_scene(0.2, 1.0)
    run = pc.simulate(scene, scene.initial_state([0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), 0.2)
    assert run.stats["newton"] == 0
    model = one_body(pin.JointModelFreeFlyer(), pin.Inertia(0.5, np.zeros(3), 0.02 * np.eye(3)))
    for contour, side, place in ((pc.Sphere(0.2), 1, 1.2), (pc.Sphere(0.2), -1, 0.8), (pc.Point(), 1, 1.0)):
        scene = pc.Scene(model)
        body, world = scene.add_contour("body", contour, "body"), scene.add_contour("world", pc.Sphere(1.0))
        scene.add_contact("c", body, world, side=side)
        direction = np.array([0.36, 0.48, 0.8])
        q = [*(place * direction), 0.0, 0.0, 0.0, 1.0]
        found = scene.initial_state(q)
        assert found.correction.dq <= 1e-12
        run = pc.simulate(scene, found, 0.05)
        assert run.stats["newton"] == 0
        np.testing.assert_allclose(run.contacts["c"].point[0], direction, rtol=0.0, atol=1e-14)
        # latitude and longitude of the point, and of the opposite one: the far side of a sphere beside
        angles = [math.atan2(0.48, 0.36), math.asin(0.8)]
        scene = pc.Scene(model)
        body, world = scene.add_contour("body", contour, "body"), scene.add_contour("world", pc.Sphere(1.0))
        turn = 1.0 if side < 0 else -1.0
        own = None if isinstance(contour, pc.Point) else [math.atan2(turn * 0.48, turn * 0.36), turn * math.asin(0.8)]
        scene.add_contact("c", body, world, side=side, location=(own, angles))
        named = scene.initial_state(q)
        np.testing.assert_allclose(named.location, found.location, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("seed", [0, 2, 3, 6])
def test_spheroids_that_are_traced_meet_as_ellipsoids_do(seed):
    """Their axes are singular starts of the search, which found nothing nearer than the point where they meet."""
    traced = pc.SurfaceOfRevolution(
        lambda s: (0.1 * math.cos(s), 0.14 * math.sin(s)), domain=(-math.pi / 2, math.pi / 2)
    )
    runs = []
    for shape in (traced, pc.Ellipsoid(0.1, 0.1, 0.14)):
        rng, model = np.random.default_rng(seed), pin.Model()
        model.gravity.linear = np.zeros(3)
        for name, mass, inertia in (("a", 1.0, [0.004, 0.003, 0.002]), ("b", 2.0, [0.006, 0.008, 0.01])):
            joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
            model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.diag(inertia)), pin.SE3.Identity())
            model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
        scene = pc.Scene(model)
        scene.add_contact("c", scene.add_contour("one", shape, "a"), scene.add_contour("two", shape, "b"))
        turns = [rng.normal(size=4) for _ in range(2)]
        first, second = (turn / np.linalg.norm(turn) for turn in turns)
        q = np.r_[0.0, 0.0, 0.0, first, 0.6, 0.03, 0.02, second]
        speeds = [pin.Quaternion(turn).matrix().T[:, 0] for turn in (first, second)]
        v = np.r_[speeds[0], rng.normal(size=3) * 3.0, -speeds[1], rng.normal(size=3) * 3.0]
        state = scene.initial_state(q, v, free=["c"])
        runs.append(pc.simulate(scene, state, 0.3, method="Moreau", step=1e-3))
    assert runs[0].status == runs[1].status == 0, runs[0].message
    assert "touch" in [event.kind for event in runs[0].events]
    # the same geometry, to what the search resolves
    np.testing.assert_allclose(runs[0].q[-1], runs[1].q[-1], atol=1e-9)
