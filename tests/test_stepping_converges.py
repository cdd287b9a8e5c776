"""Time stepping converges to the motions of event-driven runs where friction, loads and stops depend on each other."""

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

G = 9.81
TIGHT = {"rtol": 1e-11, "atol": 1e-13}


def difference(scene, state, duration, control, steps):
    """Largest differences in q between a tight run and time stepping with these steps."""
    options = {"control": control, "t_eval": np.linspace(0.0, duration, 41)}
    exact = pc.simulate(scene, state, duration, **options, **TIGHT)
    assert exact.status == 0, exact.message
    errors = []
    for step in steps:
        run = pc.simulate(scene, state, duration, method="Moreau", dt=step, **options)
        assert run.status == 0, run.message
        errors.append(float(np.abs(run.q - exact.q).max()))
    return errors


def chain(rng, hinges=3, static=1.0):
    """A planar chain of hinges, three of them between stops, whose tip rubs on a line that it cannot leave: scene,
    start and torques. static: coefficient of sticking over that of sliding."""
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    model.gravity.linear = np.array([0.0, -G, 0.0])
    for k in range(hinges):
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"j{k}")
        length, mass = rng.uniform(0.15, 0.4), rng.uniform(0.3, 2.0)
        inertia = np.diag(mass * length**2 * rng.uniform(0.06, 0.1, 3))
        model.appendBodyToJoint(parent, pin.Inertia(mass, np.array([0.5 * length, 0, 0]), inertia), pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, place, pin.FrameType.OP_FRAME))
    q = rng.uniform(-1.0, 1.0, hinges)
    weight = np.abs(pin.computeGeneralizedGravity(model, model.createData(), q)).max()
    if hinges == 3:
        model.lowerPositionLimit[:], model.upperPositionLimit[:] = q + rng.uniform(0.01, 0.1, (2, 3)) * [[-1.0], [1.0]]
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    turned = pin.utils.rotate("z", rng.uniform(0.0, 2.0 * math.pi))
    place = pin.SE3(turned, data.oMf[model.getFrameId("tip")].translation)
    scene = pc.Scene(model)
    tip, rail = scene.add_contour("tip", pc.Point(), "tip"), scene.add_contour("rail", pc.Line(), placement=place)
    mu = rng.uniform(0.2, 0.8)
    scene.add_contact("c", tip, rail, pc.Coulomb(mu, mu_static=static * mu), bilateral=True, pattern="P-2C")
    size, omega = weight * rng.normal(size=hinges), rng.uniform(5.0, 30.0, hinges)
    return scene, scene.initial_state(q), lambda t, q, v: size * np.sin(omega * t)


@pytest.mark.parametrize("seed", [39, 54])
def test_what_an_impact_throws_off_its_stop_leaves_it(seed):
    """Beside a bilateral contact with friction, whose load is found with the impulses: that of a stop is round-off."""
    scene, state, control = chain(np.random.default_rng(seed))
    coarse, fine = difference(scene, state, 0.15, control, (4e-4, 1e-4))
    assert fine <= max(0.5 * coarse, 3e-4)


@pytest.mark.parametrize("seed", [1, 5, 11, 16, 32])
def test_loads_that_friction_makes(seed):
    """Of a bilateral contact: what they hold at rest stays there (11, 16, 32), and what slides on under them does not
    jam (1)."""
    scene, state, control = chain(np.random.default_rng(seed), hinges=2, static=1.3)
    coarse, fine = difference(scene, state, 0.3, control, (4e-4, 1e-4))
    assert fine <= max(0.5 * coarse, 3e-4)


def rocked(rng, law):
    """A point that joints move but do not turn, on a plate that rocks: scene, start and period."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(1, pin.Inertia(rng.uniform(0.5, 2.0), np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("body", 1, pin.SE3.Identity(), 0)
    scene, frequency = pc.Scene(model), rng.uniform(1.0, 3.0)
    axis = rng.normal(size=3)
    rocks = pc.HarmonicMotion(
        amplitude=np.zeros(3), frequency=frequency, axis=axis / np.linalg.norm(axis), angle=rng.uniform(0.01, 0.05)
    )
    tip, plate = scene.add_contour("tip", pc.Point(), "body"), scene.add_contour("plate", pc.Plane(), motion=rocks)
    scene.add_contact("c", tip, plate, friction=law, bilateral=True)
    return scene, scene.initial_state(0.02 * rng.normal(size=3) * [1.0, 1.0, 0.0]), 1.0 / frequency


@pytest.mark.parametrize("law", [pc.NoSlip(rolling=0.01), pc.NoSlip(spinning=0.02), pc.Coulomb(0.5, rolling=0.01)])
@pytest.mark.parametrize("seed", range(3))
def test_resistance_passes_through_a_rest_that_no_joint_holds(law, seed):
    """Drives alone turn one body on the other: twice in a period they turn round, and so does the torque of the
    resistance, in both kinds of methods."""
    scene, state, period = rocked(np.random.default_rng(seed), law)
    times = np.linspace(0.1, 1.1, 11) * period
    runs = [
        pc.simulate(scene, state, times[-1], t_eval=times, **options)
        for options in (TIGHT, {"method": "Moreau", "dt": 1e-3})
    ]
    for run in runs:
        assert run.status == 0, run.message
        assert [event.kind for event in run.events if event.kind in ("turn", "hold")] == ["turn", "turn"]
    exact, stepped = runs
    # the mean over a step, which changes its torque by as much
    size = np.abs(exact.contacts["c"].torque).max()
    np.testing.assert_allclose(stepped.contacts["c"].torque, exact.contacts["c"].torque, atol=2e-2 * size)
    np.testing.assert_allclose(stepped.q, exact.q, rtol=0.0, atol=1e-5)


def touching_arm(rng):
    """An arm of two hinges that are not parallel, whose tip comes onto a shaken plate on which it cannot stick: scene
    and start."""
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for k in range(2):
        axis = rng.normal(size=3)
        joint = pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis))
        parent = model.addJoint(parent, joint, place, f"j{k}")
        length, mass = rng.uniform(0.15, 0.4), rng.uniform(0.3, 2.0)
        inertia = np.diag(mass * length**2 * rng.uniform(0.06, 0.1, 3))
        model.appendBodyToJoint(parent, pin.Inertia(mass, np.array([0.5 * length, 0, 0]), inertia), pin.SE3.Identity())
        place = pin.SE3(pin.exp3(rng.normal(size=3)), np.array([length, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, place, pin.FrameType.OP_FRAME))
    q, data = rng.uniform(-1.0, 1.0, 2), model.createData()
    pin.framesForwardKinematics(model, data, q)
    frequency = rng.uniform(20.0, 80.0)
    reach = rng.uniform(0.3, 1.5) * G / (2.0 * math.pi * frequency) ** 2
    shaken = pc.HarmonicMotion(amplitude=reach * rng.normal(size=3), frequency=frequency)
    plate = pin.SE3(pin.exp3(0.4 * rng.normal(size=3)), data.oMf[model.getFrameId("tip")].translation)
    scene, mu = pc.Scene(model), rng.uniform(0.2, 0.6)
    tip = scene.add_contour("tip", pc.Point(), "tip")
    plane = scene.add_contour("plate", pc.Plane(), placement=plate, motion=shaken)
    scene.add_contact("c", tip, plane, pc.Coulomb(mu, mu_static=1.3 * mu))
    return scene, scene.initial_state(q)


@pytest.mark.parametrize("seed", [498, 748])
def test_slip_that_turns_back_need_not_stop(seed):
    """Where the coefficient of sticking leaves no impulses, neither in slip nor at rest, that of sliding does."""
    scene, state = touching_arm(np.random.default_rng(seed))
    (error,) = difference(scene, state, 0.1, None, (5e-4,))
    assert error <= 1e-4
    run = pc.simulate(scene, state, 0.1, method="Moreau", dt=5e-4)
    # nor is friction taken for that of other loads
    assert run.stats["settled"] == 0
