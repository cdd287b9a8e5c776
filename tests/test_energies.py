"""The account of energies: everything that does work is in it, from the state that a run starts from on."""

import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest
from random_scenes import JOINTS, chain, random_scene
from turning_ball import MASS, RADIUS, G, ball, on_the_floor

import pincontact as pc

METHODS = {"DOP853": {}, "Moreau": {"method": "Moreau", "step": 1e-3}}
BOTH = pytest.mark.parametrize("method", METHODS)
# sums of a few numbers of order one
ROUND_OFF = 1e-13


def slider(**limits):
    """1 kg on a vertical rail."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    for name, value in limits.items():
        getattr(model, name)[:] = value
    return pc.Scene(model)


# ---------------------------------------------------------------------------------------------------- rotors


@pytest.mark.parametrize("name", JOINTS)
def test_kinetic_energy_has_the_rotors(name):
    """Without rotors Pinocchio's own; with them half the armature times the squares of the velocities in addition."""
    rng = np.random.default_rng(4)
    model = chain(rng, [name, "unaligned revolute", name if name != "free flyer" else "spherical"])
    scene = pc.Scene(model)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.8, 0.8, model.nv))
    v, rotors = rng.normal(size=model.nv), rng.uniform(0.1, 0.5, model.nv)
    bare = pin.computeKineticEnergy(model, model.createData(), q, v)
    state = scene.initial_state(q, v)
    for armature in (np.zeros(model.nv), rotors):
        model.armature[:] = armature
        found = pc.simulate(scene, state, 0.0).energies()
        assert found.kinetic[0] == pytest.approx(bare + 0.5 * armature @ (v * v), rel=1e-13)
        assert found.potential[0] == pytest.approx(pin.computePotentialEnergy(model, model.createData(), q), rel=1e-13)
    # nothing else stores energy
    run = pc.simulate(scene, state, 0.2, rtol=1e-10, atol=1e-12, energies=True)
    assert run.status == 0
    energies = run.energies()
    # what the tolerance leaves
    assert np.abs(energies.balance).max() <= 1e-9 * energies.kinetic.max()


# ---------------------------------------------------------------------------------------------------- outputs


@pytest.mark.parametrize("times", [[0.3, 0.4], [0.5], [0.2, 0.2, 0.35, 0.35], []], ids=str)
@BOTH
def test_works_are_counted_from_the_start_whatever_the_outputs(method, times, tmp_path):
    """A sliding and spinning ball: works and balance at outputs are those of a run with all outputs."""
    scene = ball(pc.Coulomb(0.3, spinning=1e-3, rolling=1e-3), slope=0.2)
    state = on_the_floor(scene, [1.0, 0.5, 0.0, 2.0, -3.0, 5.0])
    whole = pc.simulate(scene, state, 0.5, energies=True, **METHODS[method]).energies()
    run = pc.simulate(scene, state, 0.5, energies=True, t_eval=times, **METHODS[method])
    path = tmp_path / "run.npz"
    run.save(path)
    for energies in (run.energies(), pc.Trajectory.load(path, scene).energies()):
        assert energies.total_at_start == pytest.approx(whole.total[0], abs=ROUND_OFF)
        assert energies.balance.shape == (len(times),)
        # what the run leaves: 1e-8 in 0.8 J, or steps of 1 ms to second order
        assert np.abs(energies.balance).max(initial=0.0) <= (1e-7 if method == "DOP853" else 1e-4)
        if times and times[-1] == 0.5:
            assert energies.friction_work[-1] == pytest.approx(whole.friction_work[-1], abs=1e-7)
            assert energies.friction_work[-1] < -0.1


@BOTH
def test_balance_of_a_run_that_ends_early(method):
    scene = ball(pc.Coulomb(0.3), slope=0.2)
    state = on_the_floor(scene, [1.0, 0.5, 0.0, 2.0, -3.0, 5.0])

    def broken(t, q, v):
        return np.full(6, math.nan if t > 0.3 else 0.01)

    run = pc.simulate(scene, state, 0.5, energies=True, control=broken, t_eval=[0.1, 0.25, 0.4], **METHODS[method])
    assert run.status == -5
    assert run.t.tolist() == [0.1, 0.25]
    assert np.abs(run.energies().balance).max() <= (1e-7 if method == "DOP853" else 1e-4)


def test_files_without_the_energy_at_the_start(tmp_path):
    """Older files: the account begins at their first output."""
    scene = ball(pc.Coulomb(0.3), slope=0.2)
    run = pc.simulate(scene, on_the_floor(scene, [1.0, 0.5, 0.0, 2.0, -3.0, 5.0]), 0.2, energies=True)
    run.save(tmp_path / "new.npz")
    with np.load(tmp_path / "new.npz") as file:
        arrays = {name: file[name] for name in file.files if name != "total_at_start"}
    np.savez(tmp_path / "old.npz", **arrays)
    old = pc.Trajectory.load(tmp_path / "old.npz", scene).energies()
    np.testing.assert_allclose(old.balance, run.energies().balance, rtol=0.0, atol=ROUND_OFF)


# ------------------------------------------------------------------------------------- impacts at the start


@BOTH
@pytest.mark.parametrize("times", [None, [0.05, 0.1], [0.0]], ids=str)
def test_stop_that_is_struck_at_the_start(method, times):
    """1 kg at 2 m/s against its stop: 2 J are gone, at once or in the first step, and it stays there."""
    scene = slider(lowerPositionLimit=0.0, upperPositionLimit=1.0)
    state = scene.initial_state([0.0], [-2.0])
    run = pc.simulate(scene, state, 0.1, energies=True, t_eval=times, **METHODS[method])
    energies = run.energies()
    assert energies.total_at_start == pytest.approx(2.0, rel=1e-15)
    assert np.abs(energies.balance).max() <= ROUND_OFF
    if times is None:
        # the first output is the state that was given
        assert run.v[0, 0] == -2.0
        assert energies.damping_work[0] == 0.0
    if times != [0.0]:
        np.testing.assert_allclose(energies.damping_work[-1], -2.0, rtol=0.0, atol=ROUND_OFF)
        np.testing.assert_allclose(run.v[-1], 0.0, rtol=0.0, atol=ROUND_OFF)
    if method == "DOP853":
        assert [(event.time, event.joint, event.kind) for event in run.events] == [(0.0, "z", "limit")]


@pytest.mark.parametrize("gap", [0.0, 1e-15, -1e-15])
@pytest.mark.parametrize("law", [None, pc.Coulomb(0.3), pc.NoSlip()], ids=str)
@pytest.mark.parametrize("bounce", [0.0, 0.5])
@pytest.mark.parametrize("given", ["open", "closed"])
@BOTH
def test_contact_that_comes_in_at_the_start(method, given, bounce, law, gap):
    """A ball that touches the floor at 1 m/s when the run begins, whether its state calls the contact open or closed:
    impact with restitution, in the account. v_n' = -e v_n; friction takes what rolling or its limit mu (1 + e) v_n
    takes."""
    scene, slip, spin = ball(law), 0.4, 20.0
    contact = scene.contacts["c"]
    scene.contacts["c"] = dataclasses.replace(contact, restitution=bounce)
    v = np.array([slip, 0.0, -1.0, 0.0, spin, 0.0])
    q = pin.neutral(scene.model)
    q[2] = RADIUS + gap
    if given == "open":
        state = scene.initial_state(q, v, free=["c"])
    else:
        state = dataclasses.replace(scene.initial_state(q), v=v)
    run = pc.simulate(scene, state, 0.02, energies=True, **METHODS[method])
    energies = run.energies()
    # the floor is below: its point moves at v_x - R omega_y against the ball's
    sliding = slip - RADIUS * spin
    impulse = MASS * (1.0 + bounce)
    rolls = 2.0 / 7.0 * MASS * abs(sliding)
    friction = -math.copysign(0.0 if law is None else min(rolls, law.sliding * impulse), sliding)
    after = np.array([slip + friction / MASS, bounce, spin - friction * RADIUS / (0.4 * MASS * RADIUS**2)])
    lost = 0.5 * MASS * (after[0] ** 2 + after[1] ** 2 - slip**2 - 1.0)
    lost += 0.2 * MASS * RADIUS**2 * (after[2] ** 2 - spin**2)
    assert np.abs(energies.balance).max() <= 1e-11
    assert run.events[0].kind == "touch"
    # gaps are told from zero to ten times the tolerance, at 1 m/s
    late = 0.0 if given == "closed" else 1e-8
    assert abs(run.events[0].time) <= late
    # right after the impact, or after the step that it is in
    velocity = pin.Quaternion(run.q[1, 3:]).matrix() @ run.v[1, :3]
    assert velocity[2] == pytest.approx(after[1] - (G * run.t[1] if bounce else 0.0), abs=1e-9 + 2.0 * G * late)
    if law is None or rolls < law.sliding * impulse or bounce or run.t[1] <= late:
        # else friction goes on where it slides
        assert energies.friction_work[1] == pytest.approx(lost, abs=1e-9 + 2.0 * G * late)
        np.testing.assert_allclose(
            [velocity[0], run.v[1, 4]], after[[0, 2]], rtol=0.0, atol=1e-9 + 2.0 * G * late / RADIUS
        )


@BOTH
def test_contact_that_parts_at_the_start(method):
    """A closed contact of a state whose bodies part at 1 m/s opens: free flight, nothing lost."""
    scene = ball(pc.Coulomb(0.3))
    state = dataclasses.replace(on_the_floor(scene), v=np.array([0.3, 0.0, 1.0, 0.0, 0.0, 0.0]))
    run = pc.simulate(scene, state, 0.1, energies=True, t_eval=[0.0, 0.1], **METHODS[method])
    assert [event.kind for event in run.events] == ["separate"]
    np.testing.assert_allclose(run.v[-1, :3], [0.3, 0.0, 1.0 - 0.1 * G], rtol=0.0, atol=1e-12)
    assert np.abs(run.energies().balance).max() <= 1e-12
    assert not run.energies().friction_work.any()


@BOTH
def test_held_contact_that_cannot_move_as_its_state_says(method):
    """Bilateral: what the state has along the normal is lost, and counted."""
    scene = ball(None, bilateral=True)
    state = dataclasses.replace(on_the_floor(scene), v=np.array([0.3, 0.0, -1.0, 0.0, 0.0, 0.0]))
    run = pc.simulate(scene, state, 0.02, energies=True, **METHODS[method])
    energies = run.energies()
    assert energies.friction_work[-1] == pytest.approx(-0.5 * MASS, rel=0.01 if method == "Moreau" else 1e-9)
    # in a step of 1 ms the weight is in the impulse, too
    assert np.abs(energies.balance).max() <= (0.5 * MASS * G * 1e-3 * 1.01 if method == "Moreau" else 1e-12)


def test_stepper_bounces_at_the_start():
    scene = ball(None)
    scene.contacts["c"] = dataclasses.replace(scene.contacts["c"], restitution=0.5)
    state = dataclasses.replace(on_the_floor(scene), v=np.array([0.3, 0.0, -1.0, 0.0, 0.0, 0.0]))
    stepper = pc.Stepper(scene, state, dt=1e-3)
    stepper.step(np.zeros(6))
    np.testing.assert_allclose(stepper.v[:3], [0.3, 0.0, 0.5 - 1e-3 * G], rtol=0.0, atol=1e-12)


# ---------------------------------------------------------------------------------------------------- joints


@BOTH
def test_dry_friction_that_is_not_symmetric(method):
    """Down against 2 N, at 5 m/s^2 less than free: works in closed form."""
    scene = slider(lowerDryFrictionLimit=-1.0, upperDryFrictionLimit=2.0)
    run = pc.simulate(scene, scene.initial_state([0.0], [-1.0]), 0.1, energies=True, **METHODS[method])
    fall = 0.1 + 0.5 * (G - 2.0) * 0.01
    assert run.q[-1, 0] == pytest.approx(-fall, rel=1e-9)
    assert run.energies().damping_work[-1] == pytest.approx(-2.0 * fall, rel=1e-9)
    assert np.abs(run.energies().balance).max() <= 1e-10


def test_impact_and_rest_in_one_step():
    """Where a body stays down after it has struck in the midst of a step, what holds it for the rest does no work."""
    scene = slider(lowerPositionLimit=0.0, upperPositionLimit=1.0)
    for height in (0.0021, 0.1234):
        run = pc.simulate(scene, scene.initial_state([height], [-2.0]), 0.3, energies=True, method="Moreau", step=1e-3)
        # a constant force: parabolas, and the instant of the impact, are exact
        assert np.abs(run.energies().balance).max() <= 1e-11


# ---------------------------------------------------------------------------------------------------- everything


def test_balance_of_random_scenes():
    """Event-driven: rotors, damping, dry friction, limits, drives, torques, all laws, strikes at the start."""
    finished = 0
    for seed in range(28):
        scene, state, control = random_scene(seed)
        run = pc.simulate(scene, state, 0.3, rtol=1e-9, atol=1e-11, control=control, energies=True, max_steps=3000)
        energies = run.energies()
        # relative to a hundred times the tolerance; runs that end early are accounted for until then
        scale = max(float(energies.kinetic.max()), 1e-2)
        assert np.abs(energies.balance).max() <= 1e-7 * scale, (seed, run)
        finished += run.success
    assert finished >= 25


def test_balance_of_random_scenes_by_time_stepping():
    """What steps lose falls with their size: to first order where contacts close within them, to second elsewhere."""
    lost = {2e-3: [], 5e-4: []}
    for seed in range(30):
        scene, state, control = random_scene(seed)
        found = {}
        for step in lost:
            run = pc.simulate(scene, state, 0.3, method="Moreau", step=step, control=control, energies=True)
            energies = run.energies()
            found[step] = float(np.abs(energies.balance).max()) / max(float(energies.kinetic.max()), 1e-2)
        # the instants of impacts within steps are a matter of chance: of some runs the finer one is not better
        assert found[5e-4] <= max(0.75 * found[2e-3], 2e-3), seed
        for step, value in found.items():
            lost[step].append(value)
    coarse, fine = (np.array(values) for values in lost.values())
    assert fine.mean() <= 0.4 * coarse.mean()
    assert np.median(fine) <= 0.15 * np.median(coarse)


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
@pytest.mark.parametrize("two_sided", [False, True])
def test_balance_at_outputs_of_the_step_in_which_a_load_ends(method, two_sided):
    """Trial steps go beyond the load's zero: friction is as smooth there as the motion, whose outputs it pays for."""
    rng = np.random.default_rng(5)
    for _ in range(4):
        model = pin.Model()
        joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "point")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
        scene = pc.Scene(model)
        plane, point = scene.add_contour("plane", pc.Plane()), scene.add_contour("point", pc.Point(), frame="point")
        law = pc.Coulomb(rng.uniform(0.05, 0.3))
        scene.add_contact("c", point, plane, friction=law, bilateral=two_sided)
        lift, rate = rng.uniform(12.0, 20.0), rng.uniform(3.0, 8.0)

        def control(t, q, v, lift=lift, rate=rate):
            return np.array([0.0, 0.0, lift * math.sin(rate * t) ** 2])

        start = scene.initial_state(np.zeros(3), [2.0, 0.0, 0.0])
        options = dict(control=control, energies=True, rtol=1e-6, atol=1e-8, method=method)
        run = pc.simulate(scene, start, 0.4, t_eval=np.linspace(0.0, 0.4, 801), **options)
        assert two_sided or run.events
        # rtol of the energies, which are some 2 J; outputs within steps are a little less accurate than their ends
        assert np.abs(run.energies().balance).max() < 3e-6


@pytest.mark.parametrize(("mass", "length"), [(1e8, 1.0), (1e3, 1e3)])
def test_units_do_not_change_the_steps(mass, length):
    """An eccentric ball that rolls, of great mass or in millimetres and grams: nothing drives its contact, whose work
    then is none, and no round-off of its forces that would be as large as absolute tolerances."""
    steps = []
    for m, unit in ((1.0, 1.0), (mass, length)):
        model = pin.Model()
        model.gravity.linear = np.array([0.0, 0.0, -G * unit])
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
        inertia = pin.Inertia(m, unit * np.array([0.05, 0.02, 0.03]), unit**2 * m * np.diag([0.02, 0.03, 0.025]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addBodyFrame("ball", joint, pin.SE3.Identity(), 0)
        scene = pc.Scene(model)
        sphere, floor = (
            scene.add_contour("sphere", pc.Sphere(0.2 * unit), "ball"),
            scene.add_contour("floor", pc.Plane()),
        )
        scene.add_contact("c", sphere, floor, friction=pc.NoSlip())
        state = scene.initial_state([0, 0, 0.2 * unit, 0, 0, 0, 1], [unit, 0, 0, 0, 5.0, 2.0])
        run = pc.simulate(scene, state, 1.0, energies=True, max_steps=500)
        assert run.status == 0, run.message
        steps.append(run.stats["steps"])
        assert not run.energies().drive_work.any()
    assert steps[1] <= 1.2 * steps[0]
