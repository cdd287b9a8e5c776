"""Signs follow the user's order of naming, everywhere: the force is on the second contour, the slip velocity is that of
the second contour's material point against the first's."""

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from random_contacts import PATTERNS, PLANAR, START, RandomContact
from test_inverse import SHAPES, evaluated

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf"
LAWS = {"smooth": None, "rough": pc.Coulomb(0.3), "rolling": pc.NoSlip()}
EACH = [
    pytest.mark.parametrize("pattern", PATTERNS),
    pytest.mark.parametrize("law", LAWS),
    pytest.mark.parametrize("reverse", [False, True]),
]
# rounding of a few products, by the conditioning of the contacts and masses
ROUND_OFF = 1e-10


def each(test):
    for mark in EACH:
        test = mark(test)
    return test


def moving(pattern, law, reverse):
    """A contact between two bodies a little way into its motion under constant torques."""
    contact = RandomContact(pattern, SHAPES[pattern], seed=2, friction=LAWS[law], reverse=reverse)
    scene = contact.scene
    tau = np.random.default_rng(5).normal(size=scene.model.nv)
    run = pc.simulate(
        scene, contact.state, 0.02, control=lambda t, q, v: tau, t_eval=START + np.array([0.0, 0.01, 0.02])
    )
    assert run.status == 0, run.message
    return scene, run, tau


@each
def test_analysis_is_that_of_the_tracks(pattern, law, reverse):
    """Every field against the track at the same state, against each other, and v_c against Pinocchio."""
    scene, run, tau = moving(pattern, law, reverse)
    track, contact, model = run.contacts["c"], scene.contacts["c"], scene.model
    for i in range(3):
        state = run.state(i)
        found = pc.analyze(scene, state, tau)["c"]
        scale = ROUND_OFF * (1.0 + np.abs(found.v_c).max())
        np.testing.assert_allclose(found.v_c, track.slip_velocity[i], rtol=0.0, atol=scale)
        for name in ("frame", "dual_frame", "point", "location", "rates", "gap"):
            np.testing.assert_allclose(getattr(found, name), getattr(track, name)[i], rtol=0.0, atol=ROUND_OFF)
        np.testing.assert_allclose(found.frame @ found.components, found.v_c, rtol=0.0, atol=scale)
        np.testing.assert_allclose(found.rows @ state.v + found.drift, found.components, rtol=0.0, atol=scale)
        # conditions change as the bodies move apart, the second away from the first
        first_rows = found.f_q[: 2 if pattern in PLANAR else 3] @ state.v
        axes = np.eye(3)
        if pattern in PLANAR:
            data = model.createData()
            pin.forwardKinematics(model, data, state.q)
            body = contact.body2
            axes = (data.oMi[body.joint] * body.placement_in_joint).rotation[:, :2].T
        np.testing.assert_allclose(first_rows, -axes @ found.v_c, rtol=0.0, atol=scale)
        np.testing.assert_allclose(found.J @ found.rates, -(found.f_q @ state.v + found.f_t), rtol=0.0, atol=scale)
        # force and power in components
        force, multipliers = track.force[i], track.multipliers[i]
        size = ROUND_OFF * (1.0 + np.abs(force).max())
        np.testing.assert_allclose(found.force, force, rtol=0.0, atol=size)
        np.testing.assert_allclose(found.multipliers, multipliers, rtol=0.0, atol=size)
        np.testing.assert_allclose(found.dual_frame @ multipliers, force, rtol=0.0, atol=size)
        power = force @ track.slip_velocity[i]
        assert abs(multipliers @ found.components - power) <= size * (1.0 + np.abs(found.v_c).max())
        if law == "rough":
            assert power < 0.0
        # the material points by Pinocchio
        data = model.createData()
        pin.forwardKinematics(model, data, state.q, state.v)
        velocity = []
        for side in (contact.first, contact.second):
            spatial = data.oMi[side.joint].act(data.v[side.joint])
            velocity.append(spatial.linear + np.cross(spatial.angular, found.point))
        np.testing.assert_allclose(found.v_c, velocity[1] - velocity[0], rtol=0.0, atol=scale)


@each
def test_forces_are_on_the_second_contour(pattern, law, reverse):
    """Newton's law for the body of the second contour: what it takes besides gravity and torques is the force, in
    tracks, inverse dynamics and external forces; and in time stepping."""
    scene, run, tau = moving(pattern, law, reverse)
    contact, model = scene.contacts["c"], scene.model
    axes = 2 if pattern in PLANAR else 3
    for i in (0, 2):
        state = run.state(i)
        a = evaluated(scene, state, tau).acceleration
        data = model.createData()
        # a free body's generalised force is what acts on it, in its axes
        acting = pin.rnea(model, data, state.q, state.v, a) - tau
        pin.forwardKinematics(model, data, state.q)
        second = contact.second.joint
        start = model.joints[second].idx_v
        linear = np.zeros(3)
        linear[:axes] = acting[start : start + axes]
        expected = data.oMi[second].rotation @ linear
        scale = 1.0 + np.abs(expected).max()
        np.testing.assert_allclose(run.contacts["c"].force[i], expected, rtol=0.0, atol=1e-9 * scale)
        given = pc.external_forces(scene, state, tau)
        np.testing.assert_allclose(given[second].linear, linear, rtol=0.0, atol=1e-9 * scale)
        found = pc.inverse_dynamics(scene, state, a, actuation=tau[:, None])
        np.testing.assert_allclose(found.forces["c"], expected, rtol=0.0, atol=1e-7 * scale)
        again = pc.external_forces(scene, state, forces=found.forces)
        np.testing.assert_allclose(again[second].linear, linear, rtol=0.0, atol=1e-7 * scale)
    stepper = pc.Stepper(scene, run.state(0), dt=1e-4)
    stepper.step(tau)
    first = run.contacts["c"].force[0]
    # the mean over a step of 0.1 ms
    np.testing.assert_allclose(stepper.forces["c"], first, rtol=0.0, atol=2e-2 * (1.0 + np.abs(first).max()))


@pytest.mark.parametrize("reverse", [False, True])
def test_forces_at_rest_and_in_steady_motion(reverse):
    """A ball that rests on the floor, a disk that rolls in a circle: the weight, up on the body, down on the floor."""
    scene = pc.Scene.from_urdf(URDF / "ball.urdf", floating_base=True)
    pair = scene.add_contour("ball", pc.Sphere(0.1), "ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", *pair[:: -1 if reverse else 1], friction=pc.Coulomb(0.5))
    weight = sum(inertia.mass for inertia in scene.model.inertias) * 9.81
    # the second contour is the floor, or the ball
    expected = [0.0, 0.0, weight if reverse else -weight]
    state = scene.initial_state([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])
    stepper = pc.Stepper(scene, state, dt=1e-3)
    stepper.step(np.zeros(6))
    on_joint = pc.external_forces(scene, state)[1].linear
    np.testing.assert_allclose(on_joint, [0.0, 0.0, weight], rtol=0.0, atol=1e-12)
    resting = pc.find_equilibrium(scene, state.q)
    run = pc.simulate(scene, state, 0.1)
    found = pc.inverse_dynamics(scene, state)
    for force in (stepper.forces["c"], resting.forces["c"], run.contacts["c"].force[-1], found.forces["c"]):
        np.testing.assert_allclose(force, expected, rtol=0.0, atol=1e-11)
    assert run.contacts["c"].normal_force[-1] == pytest.approx(weight, rel=1e-12)

    disk = pc.Scene.from_urdf(URDF / "disk.urdf", floating_base=True)
    pair = disk.add_contour("rim", pc.Circle(0.3), "disk"), disk.add_contour("floor", pc.Plane())
    disk.add_contact("c", *pair[:: -1 if reverse else 1], friction=pc.NoSlip())
    lean = 0.3
    q = np.array(
        [0.0, 0.0, 0.3 * math.cos(lean), *pin.Quaternion(pin.utils.rotate("x", 0.5 * math.pi - lean)).coeffs()]
    )

    def keep(q, v):
        return [pin.Quaternion(q[3:7]).matrix()[2, 2] - math.sin(lean), v[5] + 8.0]

    steady = pc.find_steady_motion(disk, q, [2.4, 0.0, 0.0, 0.0, 1.0, -8.0], conditions=keep)
    heavy = sum(inertia.mass for inertia in disk.model.inertias) * 9.81
    assert steady.forces["c"][2] == pytest.approx(heavy if reverse else -heavy, rel=1e-9)
    on_disk = pc.external_forces(disk, steady.state)[1]
    placement = pin.XYZQUATToSE3(steady.state.q)
    sign = 1.0 if reverse else -1.0
    np.testing.assert_allclose(placement.rotation @ on_disk.linear, sign * steady.forces["c"], rtol=0.0, atol=1e-8)
