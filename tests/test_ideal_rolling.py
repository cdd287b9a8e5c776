"""Ideal rolling whose normal force vanishes, in event-driven runs: it opens, or slides held up by friction alone.

The second is the limit of Coulomb's law for large mu: closed forms, Coulomb runs, time stepping and random scenes.
"""

import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from reference import build
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from shared import kinds, one_body
from test_moreau import G, body_scene, random_scene

import pincontact as pc
from pincontact.contacts import characteristic_length
from pincontact.integration.penetration import Penetration

FREE, STICK, SLIPPING = -1, 1, 2
HALF, PUSH = 0.5, 2.0


def rod_scene(law, tangents):
    """A rod that stands on its foot and is pushed over about y; in space, or in the plane of x and z."""
    moments = (1e-3, HALF**2 / 3.0, HALF**2 / 3.0)
    place = pin.SE3(np.eye(3), np.array([-HALF, 0.0, 0.0]))
    if tangents == 2:
        scene = body_scene(pin.JointModelFreeFlyer(), 1.0, moments)
        foot, floor = scene.add_contour("foot", pc.Point(), "body", place), scene.add_contour("floor", pc.Plane())
        scene.add_contact("c", foot, floor, friction=law)
        q = np.concatenate([[0.0, 0.0, HALF], pin.Quaternion(pin.utils.rotate("y", -0.5 * math.pi)).coeffs()])
        return scene, scene.initial_state(q, [0.0, 0.0, -PUSH * HALF, 0.0, PUSH, 0.0])
    model = pin.Model()
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3))
    joint = model.addJoint(0, pin.JointModelPlanar(), upright, "joint")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag(moments)), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    foot = scene.add_contour("foot", pc.Point(), "body", place)
    scene.add_contact("c", foot, scene.add_contour("floor", pc.Line(), placement=upright), friction=law, side=-1)
    # the joint's axis points to -y
    return scene, scene.initial_state([0.0, HALF, 0.0, 1.0], [0.0, -PUSH * HALF, -PUSH])


def leaning(run):
    """(n,) angle of the rod from the vertical in rad."""
    if run.q.shape[1] == 7:
        return np.array([math.acos(pin.Quaternion(q[3:]).matrix()[2, 0]) for q in run.q])
    return np.arccos(run.q[:, 3])


@pytest.mark.parametrize("tangents", [1, 2])
def test_rod_slides_held_up_by_friction(tangents):
    """Without a normal force the centre of mass falls freely, and the foot stays down all the same, which gives the
    angle. Before that J w w' = m g half sin(a), J = 4/3 m half^2, until g = half (w' sin(a) + w^2 cos(a))."""
    scene, state = rod_scene(pc.NoSlip(), tangents)
    squared = lambda a: PUSH**2 + 1.5 * G / HALF * (1.0 - math.cos(a))  # noqa: E731
    pressed = lambda a: G - 0.75 * G * math.sin(a) ** 2 - HALF * squared(a) * math.cos(a)  # noqa: E731
    angle = brentq(pressed, 0.1, 1.2, xtol=1e-14)
    starts = quad(lambda a: squared(a) ** -0.5, 0.0, angle, epsabs=1e-13)[0]
    run = pc.simulate(scene, state, 0.5, rtol=1e-11, atol=1e-13, energies=True)
    assert kinds(run) == ["slip", "stick"]
    # a root of the force in time, which falls by 1e2 N/s
    assert abs(run.events[0].time - starts) <= 1e-10
    track = run.contacts["c"]
    slides = (track.mode == SLIPPING) & (run.t > starts) & (run.t < run.events[1].time)
    assert slides.sum() >= 10
    after = run.t[slides] - starts
    rate = math.sqrt(squared(angle))
    height = HALF * math.cos(angle) - HALF * math.sin(angle) * rate * after - 0.5 * G * after**2
    # accumulated errors of some tens of steps; the start of slip in space is accurate to a tenth of the tolerance
    np.testing.assert_allclose(leaning(run)[slides], np.arccos(height / HALF), rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(track.normal_force[slides], 0.0)
    assert track.tangential_force[slides].min() >= 3.0
    # where slip begins its speed is round-off
    assert np.einsum("ij,ij->i", track.force, track.slip_velocity)[slides].max() <= 1e-14
    assert np.abs(track.gap).max() <= 1e-14
    energies = run.energies()
    assert np.abs(energies.balance).max() <= 1e-9
    assert energies.friction_work[-1] <= -1e-3


def test_what_resists_turning_does_so_again_after_the_slide():
    """While there is no load nothing resists; when the slide ends there is one."""
    run = pc.simulate(*rod_scene(pc.NoSlip(rolling=0.02), 2), 0.5, rtol=1e-10, atol=1e-12)
    assert kinds(run) == ["slip", "stick"]
    track = run.contacts["c"]
    torque = np.linalg.norm(track.torque, axis=1)
    np.testing.assert_allclose(torque, 0.02 * track.normal_force, rtol=1e-9, atol=1e-12)
    slid = (run.t > run.events[0].time) & (run.t < run.events[1].time)
    assert (track.normal_force[slid] == 0.0).all()
    assert (track.normal_force[run.t > run.events[1].time] > 1.0).all()


@pytest.mark.parametrize("tangents", [1, 2])
def test_it_is_the_limit_of_coulombs_law(tangents):
    """What large coefficients differ by falls as 1 / mu."""
    options = {"rtol": 1e-10, "atol": 1e-12, "t_eval": [0.42]}
    ideal = pc.simulate(*rod_scene(pc.NoSlip(), tangents), 0.42, **options)
    assert ideal.contacts["c"].mode[-1] == SLIPPING
    errors = []
    for mu in (1e3, 1e4, 1e5):
        rough = pc.simulate(*rod_scene(pc.Coulomb(mu), tangents), 0.42, **options)
        assert rough.status == 0, rough.message
        errors.append(np.abs(rough.v[-1] - ideal.v[-1]).max())
    assert errors[0] <= 1e-2
    # 10, less what the second order leaves
    assert errors[0] / errors[1] == pytest.approx(10.0, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(10.0, rel=0.05)


def test_time_stepping_tends_to_it():
    scene, state = rod_scene(pc.NoSlip(), 2)
    exact = pc.simulate(scene, state, 0.5, rtol=1e-10, atol=1e-12, t_eval=[0.42, 0.5])
    errors = []
    for h in (1e-3, 5e-4, 2.5e-4):
        run = pc.simulate(scene, state, 0.5, method="Moreau", step=h, t_eval=[0.42, 0.5])
        errors.append(np.abs(run.q - exact.q).max())
    # first order, with the events anywhere in a step
    assert errors[0] <= 5e-3
    assert errors[2] <= 0.5 * errors[0]


@pytest.mark.parametrize("factor", [1.0, 1.2, 3.0])
@pytest.mark.parametrize("step", [1e-3, 1e-2])
def test_time_stepping_shows_no_pull(step, factor):
    """Not at the start either, where the disk is too fast to stay, nor in the last row before it is let go."""
    run = pc.simulate(*fast_disk(factor), 1.0, method="Moreau", step=step)
    assert run.status == 0, run.message
    assert "separate" in kinds(run)
    assert run.contacts["0"].normal_force.min() >= 0.0


def test_run_goes_on_from_the_middle_of_a_slide():
    scene, state = rod_scene(pc.NoSlip(), 2)
    whole = pc.simulate(scene, state, 0.5, rtol=1e-10, atol=1e-12, t_eval=[0.0, 0.42, 0.5])
    rest = pc.simulate(scene, whole.state(1), 0.08, rtol=1e-10, atol=1e-12, t_eval=[0.42, 0.5])
    assert rest.contacts["c"].mode[0] == SLIPPING
    np.testing.assert_allclose(rest.q[-1], whole.q[-1], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(rest.v[-1], whole.v[-1], rtol=0.0, atol=1e-8)


def fast_disk(factor=1.0):
    """The disk that rolls off a sphere in the references, at so many times its speed there."""
    scene, state = build("disk_on_sphere_detach", native=True)
    return scene, scene.initial_state(state.q, factor * state.v)


def test_disk_slides_off_a_sphere():
    """Rolling faster than in the reference it would sink in by 1.2e-3 of its radius if it were let go: it slides."""
    run = pc.simulate(*fast_disk(1.2), 1.0, rtol=1e-11, atol=1e-13, energies=True)
    assert kinds(run) == ["slip", "separate"]
    slips, opens = (event.time for event in run.events)
    assert 5e-3 <= opens - slips <= 3e-2
    track, flight = run.contacts["0"], run.t > opens
    slides = (run.t > slips) & (run.t < opens)
    assert slides.any()
    assert (track.mode[slides] == SLIPPING).all()
    assert np.nanmin(track.gap) >= -1e-14
    assert (np.diff(track.gap[flight]) > 0.0).all()
    assert not track.force[flight].any()
    energies = run.energies()
    assert np.abs(energies.balance).max() <= 1e-10 * energies.kinetic.max()
    assert np.ptp(energies.total[run.t < slips]) <= 1e-10 * energies.kinetic.max()
    assert np.ptp(energies.total[flight]) <= 1e-10 * energies.kinetic.max()


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-10])
def test_a_small_dip_is_let_be(rtol):
    """The reference's disk dips by 4.4e-4 of its radius: it flies from where its normal force vanishes, and a run that
    starts within the dip goes on in it."""
    times = np.linspace(0.0, 1.0, 1001)
    scene, state = fast_disk()
    options = {"rtol": rtol, "atol": 1e-2 * rtol}
    whole = pc.simulate(scene, state, 1.0, t_eval=times, energies=True, **options)
    assert kinds(whole) == ["separate"]
    assert abs(whole.events[0].time - 0.8826212696277185) <= 10.0 * rtol
    gap = whole.contacts["0"].gap
    # ten times the tolerance in position; the dip is 1.3e-4 m
    assert -1.4e-4 - 10.0 * rtol <= gap.min() <= -1.2e-4 + 10.0 * rtol
    assert gap[-1] >= 1e-3
    for row in (885, 895, 900):
        assert gap[row] < -10.0 * (0.3 * rtol + 1e-2 * rtol) or rtol > 1e-6
        rest = pc.simulate(scene, whole.state(row), 1.0 - times[row], t_eval=times[row:], **options)
        assert kinds(rest) == []
        np.testing.assert_allclose(rest.q, whole.q[row:], rtol=0.0, atol=10.0 * rtol)


@cache
def before_its_dip():
    """The reference's disk, shortly before it is let go: (scene, state)."""
    scene, state = fast_disk()
    return scene, pc.simulate(scene, state, 0.87, t_eval=[0.87], rtol=1e-10, atol=1e-12).state()


def pushed_into_its_dip(push, until=math.inf, restitution=0.0, rising=0.0, end=1.0):
    """The reference's disk in its dip, which a force in N, not foreseen, makes deeper, up to a time in s after it;
    rising: speed in m/s of the sphere, and of all that is on it; end: of the run, in s."""
    foresee, acts = Penetration._foresee, [True]

    def foresee_without(self, *arguments):
        acts[0] = False
        depth = foresee(self, *arguments)
        acts[0] = True
        return depth

    scene, state = before_its_dip()
    body, sphere = (side.contour for side in (scene.contacts["0"].first, scene.contacts["0"].second))
    scene = pc.Scene(scene.model)
    disk = scene.add_contour("disk", body, scene.model.frames[-1].name)
    ball = scene.add_contour("ball", sphere, motion=pc.ConstantTwist(linear=(0.0, 0.0, rising)) if rising else None)
    scene.add_contact("0", disk, ball, friction=pc.NoSlip(), restitution=restitution)
    q, v = state.q.copy(), state.v.copy()
    q[2] += rising * state.t
    v[:3] += pin.Quaternion(q[3:]).matrix().T @ [0.0, 0.0, rising]
    state = scene.initial_state(q, v, t=state.t)

    def smooth(x):
        x = min(max(x, 0.0), 1.0)
        return x * x * (3.0 - 2.0 * x)

    def control(t, q, v):
        after = t - 0.8826212696
        force = acts[0] * push * smooth((after - 1e-3) / 5e-3) * (1.0 - smooth((after - until) / 5e-3))
        return np.concatenate([pin.Quaternion(q[3:]).matrix().T @ [0.0, 0.0, -force], np.zeros(3)])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Penetration, "_foresee", foresee_without)
        return pc.simulate(scene, state, end - state.t, rtol=1e-10, atol=1e-12, energies=True, control=control)


def gap_of(run, event):
    """The gap in m at an event, before its impact."""
    return run.scene.initial_state(event.q, event.v, t=event.time, free=["0"]).correction.gaps["0"]


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("push", [2.0, 20.0, 500.0])
def test_a_dip_that_gets_deeper_than_foreseen_touches(push, restitution):
    """There is an impact where it is twice as deep; what lifts the body from there is taken from the motion."""
    run = pushed_into_its_dip(push, restitution=restitution)
    assert run.status == 0, run.message
    assert kinds(run)[:2] == ["separate", "touch"]
    track, energies = run.contacts["0"], run.energies()
    # twice as deep as without the push, where it is 1.3076e-4 m and foreseen to a thousandth
    assert gap_of(run, run.events[1]) == pytest.approx(-2.6152e-4, rel=1e-3)
    if restitution == 0.0:
        assert abs(track.gap[run.t > run.events[1].time][0]) <= 1e-12
    scale = energies.kinetic.max()
    assert np.abs(energies.balance).max() <= 1e-9 * scale
    assert np.diff(energies.friction_work).max() <= 1e-12 * scale
    assert energies.friction_work[-1] <= -1e-5


def test_a_dip_that_is_too_deep_by_a_hair():
    """The impact takes next to nothing there, and the lift more than that: its energy comes from the motion, but for
    what drives have of it."""
    rising, low, high = 3.0, 0.8, 1.1
    for _ in range(8):
        middle = 0.5 * (low + high)
        # deepest while it is pushed
        touches = "touch" in kinds(pushed_into_its_dip(middle, 0.012, rising=rising, end=0.91))
        low, high = (low, middle) if touches else (middle, high)
    run = pushed_into_its_dip(high, 0.012, rising=rising)
    assert kinds(run)[:2] == ["separate", "touch"]
    energies, touched = run.energies(), int(np.searchsorted(run.t, run.events[1].time))
    assert gap_of(run, run.events[1]) <= -2.61e-4
    assert abs(run.contacts["0"].gap[touched]) <= 1e-12
    # the lift takes 3e-5 of the energy, and half of that part of v
    np.testing.assert_allclose(run.v[touched], run.events[1].v, rtol=0.0, atol=1e-2)
    # round-off in energies of ten joules, and what the run leaves
    assert abs(energies.friction_work[touched]) <= 1e-10
    assert np.abs(energies.balance).max() <= 1e-10


@pytest.mark.parametrize("bend", [-1.0, 4.0, 20.0])
def test_dips_whose_jerk_changes_are_foreseen(monkeypatch, bend):
    """From 0 and 0 with second derivative -1 + 10 s + bend s^2 / 2: its depth, to a hundredth, whatever the first rate
    says."""
    gap = np.polynomial.Polynomial([0.0, 0.0, -0.5, 10.0 / 6.0, bend * 10.0 / 24.0])
    system = SimpleNamespace(gaps=np.zeros((1, 1)), contact_real=np.full((1, 99), 100.0), gap_accuracy=[0.0])
    now = [0.0]

    def evaluate_after(self, t, tau):
        now[0] = tau
        system.gaps[0, 0] = gap(tau)
        return True

    monkeypatch.setattr(Penetration, "_evaluate_after", evaluate_after)
    foreseen = Penetration.__new__(Penetration)
    foreseen._rk = SimpleNamespace(system=system, evaluate_start=lambda t: now.__setitem__(0, 0.0) or 0)
    foreseen._modes = SimpleNamespace(gap_acceleration=lambda t, c: gap.deriv(2)(now[0]))
    places = np.linspace(0.0, 0.4, 4001)
    assert foreseen._foresee(0.0, 0, 1e-3) == pytest.approx(-gap(places).min(), rel=1e-2)


def thrown_body(seed):
    """A disk, an ellipsoid, an unbalanced ball, a rod's tip or a ring, thrown or set on a plane, a sphere or waves."""
    rng = np.random.default_rng(seed)
    kind, mass = seed % 5, rng.uniform(0.3, 3.0)
    axes = np.sort(rng.uniform(0.1, 0.4, 3))[::-1]
    a, place, com = axes[0], pin.SE3.Identity(), np.zeros(3)
    disk = 0.25 * mass * a**2 * np.array([1.0, 1.0, 2.0])
    rotation = pin.utils.rotate("z", rng.uniform(-3.0, 3.0)) @ pin.utils.rotate("y", rng.uniform(0.3, 1.4))
    rotation = rotation @ pin.utils.rotate("z", rng.uniform(-3.0, 3.0))
    height = a * math.hypot(rotation[2, 0], rotation[2, 1])
    if kind == 0:
        shape, moments = pc.Circle(a), disk
    elif kind == 1:
        shape, moments = pc.Ellipsoid(*axes), 0.2 * mass * (axes @ axes - axes**2)
        height = float(np.linalg.norm(axes * rotation[2]))
    elif kind == 2:
        shape, moments, height = pc.Sphere(a), 0.4 * mass * a**2 * np.ones(3), a
        com = 0.25 * a * rng.uniform(-1.0, 1.0, 3)
    elif kind == 3:
        shape, moments = pc.Point(), mass * a**2 / 3.0 * np.array([1e-2, 1.0, 1.0])
        place, height = pin.SE3(np.eye(3), np.array([a, 0.0, 0.0])), -a * rotation[2, 0]
    else:
        shape, moments, height = pc.Torus(a, 0.2 * a), disk, height + 0.2 * a
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(mass, com, np.diag(moments))))
    grounds = [
        (pc.Plane(), 0.0),
        (pc.Sphere(2.0), -2.0),
        (pc.HeightField(lambda x, y: 0.05 * math.sin(2.0 * x) * math.cos(1.5 * y)), 0.0),
    ]
    ground, level = grounds[0 if kind == 4 else int(rng.integers(3))]
    body = scene.add_contour("body", shape, "body", place)
    floor = scene.add_contour("floor", ground, placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, level])))
    restitution = float(rng.choice([0.0, 0.0, rng.random()]))
    scene.add_contact("c", body, floor, friction=pc.NoSlip(), restitution=restitution)
    flies = rng.random() < 0.5
    q = np.array([0.0, 0.0, height + 0.1 * flies, *pin.Quaternion(rotation).coeffs()])
    v = np.concatenate([rng.normal(size=3), rng.choice([3.0, 8.0]) * rng.normal(size=3)])
    return scene, scene.initial_state(q, v, free=["c"] if flies else [], max_gap=0.3)


def check(seed, scene, run, depth):
    """Nothing gains energy; nothing sinks in, but for the dips that are let be; what slides without a normal force is
    braked. Returns rows that slide."""
    energies = run.energies()
    scale = energies.kinetic.max()
    assert np.diff(energies.friction_work).max(initial=0.0) <= 1e-7 * scale, seed
    # accumulated error of some hundred steps at rtol = 1e-8
    assert np.diff(energies.total).max(initial=0.0) <= 1e-7 * scale, seed
    assert np.abs(energies.balance).max() <= 1e-6 * scale, seed
    slides = 0
    for name, contact in scene.contacts.items():
        track = run.contacts[name]
        ideal = isinstance(contact.friction, pc.NoSlip)
        # twice a thousandth of the length
        dip = 2e-3 * characteristic_length(contact) if ideal else 0.0
        assert np.nanmin(track.gap) >= -depth - dip, seed
        # they are short, in time: what is near takes short steps
        deep = np.gradient(run.t)[track.gap < -depth].sum()
        assert deep <= (0.1 * (run.t[-1] - run.t[0]) if ideal else 0.0), seed
        assert track.normal_force.min() >= -1e-7 * (1.0 + track.normal_force.max()), seed
        if ideal:
            alone = track.mode == SLIPPING
            power = np.einsum("ij,ij->i", track.force, track.slip_velocity)
            assert not track.normal_force[alone].any(), seed
            # round-off where a slip is about to start
            assert power[alone].max(initial=0.0) <= 1e-12, seed
            slides += int(alone.sum())
    return slides


@pytest.mark.parametrize(("first", "some_slide"), [(0, True), (30, False), (937, True)])
def test_thrown_bodies(first, some_slide):
    """Eight bodies a block, of which some slide; in one next to all that let go dip by less than a slide needs."""
    slides = 0
    for seed in range(first, first + 8):
        scene, state = thrown_body(seed)
        run = pc.simulate(scene, state, 1.0, energies=True, max_steps=5000)
        if run.status != 0:
            # a disk or a ring has come to lie flat
            assert kinds(run)[-1] == "singular", (seed, run.message)
            assert run.contacts["c"].conditioning[-1] < 1e-5, seed
        # ten times the tolerances, twice
        slides += check(seed, scene, run, 4e-7) > 0
    assert slides >= 1 if some_slide else slides == 0


def test_a_slide_that_jams():
    """An ellipsoid lands sliding, and its friction holds it up with ever less leverage: the force grows without bound,
    until the slip is stopped. Time stepping stops it at the same time."""
    scene, state = thrown_body(224)
    run = pc.simulate(scene, state, 0.6, energies=True)
    assert run.status == 0, run.message
    check(224, scene, run, 4e-7)
    assert kinds(run)[-2:] == ["touch", "stick"]
    landed, stopped = (event.time for event in run.events[-2:])
    track = run.contacts["c"]
    slides = (run.t > landed) & (run.t < stopped)
    assert (track.mode[slides] == SLIPPING).all()
    assert track.tangential_force[slides].max() >= 1e5
    # next to nothing is left to be stopped
    assert np.linalg.norm(track.slip_velocity[slides][-1]) <= 1e-6
    assert (track.mode[run.t > stopped] == STICK).all()
    for h in (1e-3, 5e-4):
        stepped = pc.simulate(scene, state, 0.6, method="Moreau", step=h)
        assert abs(stepped.events[-1].time - stopped) <= 2.0 * h
        # first order, across two impacts
        assert np.abs(stepped.q[-1] - run.q[-1]).max() <= 4.0 * h


@pytest.mark.parametrize("case", [2, 3])
def test_a_slide_jams_whatever_the_steps(case):
    """The last steps before the jam fail or not by round-off; the run goes on from it all the same."""
    rng = np.random.default_rng(case)
    scene, state = thrown_body(224)
    v = np.asarray(state.v) * (1.0 + 1e-9 * rng.normal())
    rtol = 10.0 ** rng.uniform(-9.0, -6.0)
    start = scene.initial_state(state.q, v, free=["c"], max_gap=0.3) if case % 2 else state
    run = pc.simulate(scene, start, 0.6, rtol=rtol, atol=1e-2 * rtol, max_step=10.0 ** rng.uniform(-4.0, -1.0))
    assert run.status == 0, run.message
    assert kinds(run)[-2:] == ["touch", "stick"]


def thrown_box(seed):
    """A box thrown on its eight corners."""
    rng = np.random.default_rng(seed)
    size, mass = rng.uniform(0.05, 0.3, 3), 10.0 ** rng.uniform(-1.0, 1.0)
    scene = body_scene(pin.JointModelFreeFlyer(), mass, mass / 3.0 * (size @ size - size * size))
    floor = scene.add_contour("floor", pc.Plane())
    restitution = float(rng.choice([0.0, rng.random()]))
    for i in range(8):
        place = size * [1 - 2 * (i >> k & 1) for k in range(3)]
        corner = scene.add_contour(f"corner{i}", pc.Point(), "body", pin.SE3(np.eye(3), place))
        scene.add_contact(f"corner{i}", corner, floor, friction=pc.NoSlip(), restitution=restitution)
    turn = rng.normal(size=4)
    turn /= np.linalg.norm(turn)
    velocity = pin.Quaternion(turn).matrix().T @ [*rng.normal(size=2), -1.0]
    q = np.array([0.0, 0.0, np.linalg.norm(size) + 0.05 * rng.random(), *turn])
    return scene, scene.initial_state(q, [*velocity, *(4.0 * rng.normal(size=3))], free=list(scene.contacts))


@pytest.mark.parametrize("make", [thrown_box, lambda seed: random_scene(np.random.default_rng(seed))])
def test_several_contacts(make):
    """Corners land and slide one after the other, or at once."""
    slides = 0
    for seed in range(18):
        scene, state = make(seed)
        run = pc.simulate(scene, state, 0.5, energies=True, max_steps=5000)
        assert run.status == 0, (seed, run.message)
        slides += check(seed, scene, run, 4e-7) > 0
    assert slides >= 1


@pytest.mark.parametrize("rtol", [1e-5, 1e-8])
def test_large_friction_opens_where_it_jumps(rtol):
    """A rod pulled back at its centre while it falls over its tip: at |F_t| = mu F_n no sliding force exists (Painleve)
    and it lifts off, with a jump of the force. Until then it turns about its tip, which an equation of one angle
    follows."""
    mass, half, pull, mu = 1.2, 0.4, -20.0, 10.0
    about_tip = mass * half**2 * 4.0 / 3.0

    def rate(t, y):
        return [y[1], (mass * 9.81 * half * math.sin(y[0]) + pull * half * math.cos(y[0])) / about_tip]

    def limit(t, y):
        a, s, c = rate(t, y)[1], math.sin(y[0]), math.cos(y[0])
        along, up = mass * half * (c * a - s * y[1] ** 2) - pull, mass * (9.81 - half * (s * a + c * y[1] ** 2))
        return mu * up - abs(along)

    limit.terminal = True
    opens = solve_ivp(rate, (0.0, 1.0), [0.2, 4.0], events=limit, rtol=1e-12, atol=1e-13).t[-1]
    model = pin.Model()
    joint = 0
    for name, kind in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("turn", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    inertia = pin.Inertia(mass, np.zeros(3), np.diag([1.0, 1.0, 1e-4]) * mass * half**2 / 3.0)
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addBodyFrame("rod", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    tip = scene.add_contour("tip", pc.Point(), "rod", pin.SE3(np.eye(3), np.array([0.0, 0.0, -half])))
    scene.add_contact("tip", tip, floor, friction=pc.Coulomb(mu))
    q = [half * math.sin(0.2), half * math.cos(0.2), 0.2]
    state = scene.initial_state(q, [4.0 * q[1], -4.0 * q[0], 4.0])
    run = pc.simulate(
        scene,
        state,
        opens + 0.03,
        control=lambda t, q, v: np.array([pull, 0.0, 0.0]),
        energies=True,
        rtol=rtol,
        atol=1e-2 * rtol,
    )
    assert run.status == 0, run.message
    assert [event.kind for event in run.events] == ["separate"]
    # stick runs on for a ten-thousandth of (rtol / 100)^(1/3) s, so that the cone problem sees the limit exceeded
    assert run.events[0].time == pytest.approx(opens, abs=1.1e-4 * (1e-2 * rtol) ** (1.0 / 3.0) + 0.1 * rtol)
    assert np.abs(run.energies().balance).max() <= rtol
