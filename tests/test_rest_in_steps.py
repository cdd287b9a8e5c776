"""What rests, passes by rest, or begins and ends to slip by turns within steps of time stepping: the motion is that of
the event-driven methods."""

import math

import numpy as np
import pinocchio as pin
import pytest
from random_motions import free_body
from test_loads import body_on_feet

import pincontact as pc


def compared(scene, state, duration, dt, control=None):
    """A run of time stepping, and its largest distance in q from the event-driven one."""
    run = pc.simulate(scene, state, duration, method="Moreau", dt=dt, control=control, t_eval=[0.0, duration])
    assert run.status == 0, run.message
    exact = pc.simulate(scene, state, duration, control=control, t_eval=[0.0, duration], rtol=1e-10, atol=1e-12)
    assert exact.status == 0, exact.message
    return run, float(np.abs(run.q - exact.q).max())


@pytest.mark.parametrize("dt", [4e-4, 2e-4, 1e-4])
@pytest.mark.parametrize(("bilateral", "speed"), [(True, -6.6), (True, -3.0), (False, -6.6)])
def test_slip_passes_a_dead_centre_below_the_coefficient_of_sticking(bilateral, speed, dt):
    """A stretched arm whose tip slides along a rail: there slip turns back though no force ends it. An impulse, however
    large, that held it would end the motion in an instant (at the first of these speeds steps of 0.1 ms did not
    converge to it, and were refused)."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    parent, place = 0, pin.SE3.Identity()
    for name, length, mass, inertia in (("a", 0.2394, 1.2769, 0.006586), ("b", 0.2085, 1.8073, 0.00707)):
        parent = model.addJoint(parent, pin.JointModelRZ(), place, name)
        body = pin.Inertia(mass, np.array([0.5 * length, 0.0, 0.0]), inertia * np.eye(3))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        model.addBodyFrame(name, parent, pin.SE3.Identity(), 0)
        place = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    model.armature[:] = 0.0258, 0.0285
    scene = pc.Scene(model)
    scene.add_contour("tip", pc.Point(), "b", place)
    scene.add_contour("rail", pc.Line(), placement=pin.SE3(np.eye(3), np.array([0.0, -0.3881, 0.0])))
    law = pc.Coulomb(0.404, mu_static=0.62)
    scene.add_contact("c", "tip", "rail", law, bilateral=bilateral, pattern="P-2C", side=1)
    state = scene.initial_state([-1.0843, 0.0749], [-0.498 * speed, speed], max_gap=0.01)
    run, off = compared(scene, state, 0.05, dt, lambda t, q, v: np.array([-0.6 - bilateral * 0.1, -0.6]))
    # of first order, as the slip's turn is in the middle of a step; it was refused, or a tenth of a radian off
    assert off < 0.1 * dt
    assert abs(run.v[-1, 1]) > 0.5 * abs(speed)


@pytest.mark.parametrize("dt", [4e-4, 1e-4])
def test_a_foot_that_may_stay_at_rest_does(dt):
    """A plate without weight that a finger presses on two feet, of which one must not slip: the other one opens, and
    this one rolls on, or both may open. Nothing is redundant."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    plate = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "plate")
    model.appendBodyToJoint(
        plate, pin.Inertia(2.77, np.zeros(3), np.diag([0.0184, 0.0193, 0.0119])), pin.SE3.Identity()
    )
    model.addBodyFrame("plate", plate, pin.SE3.Identity(), 0)
    finger = model.addJoint(
        0, pin.JointModelPZ(), pin.SE3(np.eye(3), np.array([0.052406, -0.062942, 0.246323])), "finger"
    )
    model.appendBodyToJoint(finger, pin.Inertia(0.9736, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("finger", finger, pin.SE3.Identity(), 0)
    scene, height = pc.Scene(model), 0.098162
    shaken = pc.HarmonicMotion((-0.001109, 0.000279, -0.021042), 1.4993, 3.384167)
    scene.add_contour("floor", pc.Plane(), placement=shaken.placement(0.0).inverse(), motion=shaken)
    scene.add_contour("top", pc.Plane(), "plate", pin.SE3(np.eye(3), np.array([0.0, 0.0, height])))
    for name, x, y, law, restitution in (
        ("rolls", -0.063574, -0.125763, pc.NoSlip(), 0.0),
        ("opens", 0.059728, 0.118153, pc.Coulomb(0.259), 0.688),
    ):
        scene.add_contour(name, pc.Point(), "plate", pin.SE3(np.eye(3), np.array([x, y, -height])))
        scene.add_contact(name, name, "floor", law, restitution=restitution, side=1)
    scene.add_contour("tip", pc.Sphere(0.05), "finger")
    scene.add_contact("tip", "tip", "top", pc.NoSlip())
    v = [0.01741, -0.00623, 0.1924, 0.09006, 0.17815, 0.08122, 0.18218]
    state = scene.initial_state([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0, 0.0], v, max_gap=0.01)
    torques = np.array([-1.105673, -4.463102, 16.05919, -0.296375, 0.025884, 0.054937, -18.016063])
    run, off = compared(scene, state, 0.025, dt, lambda t, q, v: torques)
    assert run.contacts["rolls"].mode[-1] == 1
    assert run.contacts["opens"].mode[-1] == -1
    # of second order while modes last; both opening is 1e-3 off
    assert off < 0.1 * dt


@pytest.mark.parametrize("seed", [0, 14, 36, 45])
def test_slip_that_begins_and_ends_by_turns_does_not_make_steps_too_long(seed):
    """A block on four feet of different laws on a floor that shakes at up to a third of a radian of its phase in a
    step: whether it slips or sticks changes with the velocity at the middle of the step, to which nothing else is
    sensitive. Of 60 such scenes 17 were refused."""
    rng = np.random.default_rng([19, seed])
    scene = pc.Scene(free_body(2.945, np.array([0.026339, 0.013073, 0.021421])))
    frequency = rng.uniform(60.0, 140.0)
    reach = rng.uniform(0.5, 2.0) * 9.81 / (2.0 * math.pi * frequency) ** 2
    along = rng.normal(size=3)
    along *= reach / np.linalg.norm(along)
    shaken = pc.HarmonicMotion(along, frequency, rng.uniform(0, 6), (0.0, 0.0, 1.0), 2.0 * reach)
    scene.add_contour("floor", pc.Plane(), placement=shaken.placement(0.0).inverse(), motion=shaken)
    height, radii = 0.089626, (0.11116, 0.156506, 0.192558, 0.185837)
    laws = pc.Coulomb(0.88), pc.Coulomb(0.583), pc.Coulomb(0.579, mu_static=0.851), pc.Coulomb(0.362, viscous=1.256)
    for i, (r, law) in enumerate(zip(radii, laws)):
        foot = np.array([r * math.cos(0.5 * math.pi * i), r * math.sin(0.5 * math.pi * i), -height])
        scene.add_contour(f"foot {i}", pc.Point(), "body", pin.SE3(np.eye(3), foot))
        scene.add_contact(f"foot {i}", f"foot {i}", "floor", law, side=1)
    state = scene.initial_state([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0], np.zeros(6), max_gap=0.01)
    runs = [pc.simulate(scene, state, 0.02, method="Moreau", dt=dt, t_eval=[0.0, 0.02]) for dt in (4e-4, 5e-5)]
    assert [run.status for run in runs] == [0, 0], runs[0].message
    # the floor's way, up to 6e-5 m, is followed to first order
    np.testing.assert_allclose(runs[0].q[-1], runs[1].q[-1], rtol=0.0, atol=3e-5)


@pytest.mark.parametrize("step", [1e-3, 1e-4, 1e-5, 1e-6])
@pytest.mark.parametrize("over", [1.05, 1.001])
@pytest.mark.parametrize("count", [3, 4])
def test_what_hardly_slides_does_in_short_steps_too(count, over, step):
    """A block on feet, pushed by a little more than friction holds, has the acceleration of the rest; a step leaves no
    more than a thousandth of its way, which is no round-off however short the step is."""
    points = np.array([[0.1, 0.1, -0.05], [0.1, -0.1, -0.05], [-0.1, 0.1 * (count - 3), -0.05], [-0.1, -0.1, -0.05]])
    scene = body_on_feet(points[:count], 0.5)
    state = scene.initial_state([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0], np.zeros(6))
    push = over * 0.5 * 9.81

    def control(t, q, v):
        # at the height of the floor, about which loads turn nothing
        return np.array([push, 0.0, 0.0, 0.0, 0.05 * push, 0.0])

    run = pc.simulate(scene, state, 2e-3, control=control, method="Moreau", step=step)
    assert run.status == 0, run.message
    # the block's acceleration is constant, and the midpoint rule has no error
    assert run.q[-1, 0] == pytest.approx(0.5 * (push - 0.5 * 9.81) * 2e-3**2, rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_outputs_of_feet_at_rest_say_so(seed):
    """Velocities at rest are round-off, and no slip that passes through zero: forces that hold are inside all cones,
    also where those of least norm are not."""
    rng = np.random.default_rng(seed)
    points = np.array([[x, y, -0.05] for x in (0.1, -0.1) for y in (0.1, -0.1)])
    scene, push = body_on_feet(points, 0.3), np.array([*rng.uniform(1.6, 1.8, 2), 0.0, 0.2, -0.2, 0.05])
    state = scene.initial_state([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0], [*rng.uniform(-0.3, 0.3, 2), 0.0, 0.0, 0.0, 0.5])
    run = pc.simulate(scene, state, 0.5, method="Moreau", dt=1e-3, control=lambda t, q, v: push * np.sin(9.0 * t))
    assert run.status == 0, run.message
    rests = np.abs(run.v).max(axis=1) < 1e-12
    assert rests[300:].all()
    for track in run.contacts.values():
        assert (track.mode[rests] == 1).all()
        assert (track.tangential_force[rests] < 0.3 * track.normal_force[rests]).all()
