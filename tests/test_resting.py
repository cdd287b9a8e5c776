"""What decides while nothing moves: loads and drives of random frequency, amplitude and phase, against closed forms."""

import math
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq
from shared import one_body

import pincontact as pc
from pincontact.integration import events
from pincontact.integration.resolution import roughness
from pincontact.integration.sign_changes import resolve, with_double_zeros
from pincontact.integration.tableaux import tableau

G = 9.81
METHODS = [
    ("DOP853", 1e-4),
    ("DOP853", 1e-6),
    ("DOP853", 1e-8),
    ("DOP853", 1e-11),
    ("RK45", 1e-6),
    ("RK23", 1e-5),
    ("Sharp98", 1e-8),
]
FEET = [(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)]


def body(**options):
    inertia = pin.Inertia(1.0, np.zeros(3), 0.004 * np.eye(3))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia))
    return scene, scene.add_contour("floor", pc.Plane(), **options)


def block(friction, feet=4, **options):
    """A block of 1 kg whose centre is in the plane of its feet, so that no torque tips it."""
    scene, floor = body(**options)
    for i, (x, y) in enumerate(FEET[:feet] if feet > 1 else [(0.0, 0.0)]):
        point = scene.add_contour(f"point {i}", pc.Point(), "body", pin.SE3(np.eye(3), np.array([x, y, 0.0])))
        scene.add_contact(f"foot {i}", point, floor, friction=friction)
    return scene, scene.initial_state([0, 0, 0, 0, 0, 0, 1.0])


def ball(friction=None):
    scene, floor = body()
    scene.add_contact("c", scene.add_contour("ball", pc.Sphere(0.1), "body"), floor, friction=friction)
    return scene, scene.initial_state([0, 0, 0.1, 0, 0, 0, 1.0])


def slider(low=None, dry=0.0):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    if low is not None:
        model.lowerPositionLimit, model.upperPositionLimit = np.array([low]), np.array([1e3])
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = np.array([-dry]), np.array([dry])
    scene = pc.Scene(model)
    return scene, scene.initial_state([0.0])


def along_x(force, nv=6):
    return lambda t, q, v: np.r_[force(t), np.zeros(nv - 1)]


def options(case):
    method, rtol = METHODS[case % len(METHODS)]
    return {"method": method, "rtol": rtol, "atol": 1e-2 * rtol}


def slides(amplitude, omega, phase, hold, kinetic, duration):
    """1 kg that is held up to a force, slides against another one, under amplitude sin(omega t + phase): times at which
    it starts and stops, by turns, and how far it gets. Piecewise closed form; roots bracketed by 400 samples
    a period."""
    times = np.linspace(0.0, duration, int(400 * duration * omega / (2.0 * math.pi)) + 1000)
    t, x, found = 0.0, 0.0, []
    while True:
        # |load| - hold turns positive
        later = np.r_[t, times[times > t]]
        over = np.abs(amplitude * np.sin(omega * later + phase)) - hold
        rises = np.flatnonzero((over[:-1] < 0.0) & (over[1:] >= 0.0))
        if over[0] >= 0.0:
            start = t
        elif rises.size:
            i = rises[0]
            start = brentq(lambda s: abs(amplitude * math.sin(omega * s + phase)) - hold, later[i], later[i + 1])
        else:
            return found, x
        sign = math.copysign(1.0, amplitude * math.sin(omega * start + phase))

        def speed(s, start=start, sign=sign):
            turned = math.cos(omega * start + phase) - math.cos(omega * s + phase)
            return sign * amplitude / omega * turned - kinetic * (s - start)

        later = np.r_[start + 1e-3 / omega, times[times > start + 1e-3 / omega]]
        speeds = np.array([speed(s) for s in later])
        ends = np.flatnonzero((speeds[:-1] > 0.0) & (speeds[1:] <= 0.0))
        end = brentq(speed, later[ends[0]], later[ends[0] + 1]) if ends.size else duration
        span, turned = end - start, math.sin(omega * start + phase) - math.sin(omega * end + phase)
        x += amplitude / omega * (span * math.cos(omega * start + phase) + turned / omega)
        x -= 0.5 * sign * kinetic * span**2
        found.append(start)
        if end >= duration:
            return found, x
        found.append(end)
        t = end


@pytest.mark.parametrize("case", range(4))
def test_a_block_slides_when_the_load_says(case):
    """Every slip at its closed-form time, and the way; loads that stay below the limit move nothing."""
    rng = np.random.default_rng(case)
    mu, feet = rng.uniform(0.1, 0.8), int(rng.choice([1, 3, 4]))
    static = mu * rng.choice([1.0, 1.3])
    friction = pc.Coulomb(mu, mu_static=static)
    hold, kinetic = static * G, mu * G
    amplitude, omega = rng.uniform(0.7, 2.5) * hold, 10.0 ** rng.uniform(0.0, 2.7)
    duration, phase = min(10.0, 25.0 * 2.0 * math.pi / omega), rng.uniform(-0.3, 0.3)
    if feet == 3:
        # three feet around the centre, so that all are loaded
        scene, floor = body()
        for i, angle in enumerate((0.0, 2.1, 4.2)):
            place = pin.SE3(np.eye(3), 0.1 * np.array([math.cos(angle), math.sin(angle), 0.0]))
            point = scene.add_contour(f"point {i}", pc.Point(), "body", place)
            scene.add_contact(f"foot {i}", point, floor, friction=friction)
        state = scene.initial_state([0, 0, 0, 0, 0, 0, 1.0])
    else:
        scene, state = block(friction, feet)
    load = along_x(lambda t: amplitude * math.sin(omega * t + phase))
    run = pc.simulate(scene, state, duration, control=load, t_eval=[duration], **options(case))
    times, way = slides(amplitude, omega, phase, hold, kinetic, duration)
    assert run.status == 0, run.message
    starts = np.array(times[::2])
    found = np.array([event.time for event in run.events if event.kind == "slip"])
    assert len(starts) == 0 or len(found) > 0
    # where the load is what decides, the time is known to round-off; after a slip, as well as that
    allowed = 1e-9 + 10.0 * options(case)["rtol"]
    for start in starts:
        assert np.abs(found - start).min() <= allowed
    for time in found:
        assert np.abs(starts - time).min() <= allowed
    # a hundred slips' errors, each of the size of the tolerance
    assert abs(run.q[-1, 0] - way) <= 100.0 * options(case)["rtol"] * max(1.0, abs(way))


@pytest.mark.parametrize("case", range(4))
def test_a_dry_joint_slides_when_the_load_says(case):
    rng = np.random.default_rng(100 + case)
    dry, omega, duration = rng.uniform(0.5, 5.0), 10.0 ** rng.uniform(0.0, 1.5), 8.0
    amplitude = rng.uniform(1.1, 2.5) * dry
    scene, state = slider(dry=dry)
    load = along_x(lambda t: amplitude * math.sin(omega * t), 1)
    run = pc.simulate(scene, state, duration, control=load, t_eval=[duration], **options(case))
    times, way = slides(amplitude, omega, 0.0, dry, dry, duration)
    assert run.status == 0
    assert len([e for e in run.events if e.kind == "slip"]) == len(times[::2])
    assert abs(run.q[-1, 0] - way) <= 100.0 * options(case)["rtol"] * max(1.0, abs(way))


@pytest.mark.parametrize("case", range(len(METHODS)))
def test_first_events_of_other_holds(case):
    """A ball lifted by a sine, and by a pulse after a long rest; spinning resistance; a joint at its stop."""
    rng = np.random.default_rng(200 + case)
    omega = rng.uniform(2.0, 30.0)
    size = rng.uniform(1.05, 2.0)
    turn = math.asin(1.0 / size)
    scene, state = ball()
    lift = lambda t, q, v: np.r_[0, 0, size * G * math.sin(omega * t), 0, 0, 0]  # noqa: E731
    run = pc.simulate(scene, state, 1.2 * turn / omega, control=lift, **options(case))
    assert [e.kind for e in run.events] == ["separate"]
    assert abs(run.events[0].time - turn / omega) <= 1e-10

    start = rng.uniform(2.0, 25.0)

    def pulse(t, q, v):
        inside = start < t < start + 0.6
        return np.r_[0, 0, size**2 * G * math.sin(math.pi * (t - start) / 0.6) ** 2 if inside else 0.0, 0, 0, 0]

    run = pc.simulate(scene, state, 30.0, control=pulse, **options(case))
    # sin^2 reaches 1 / size^2
    assert abs(run.events[0].time - (start + 0.6 / math.pi * turn)) <= 1e-10

    scene, state = ball(pc.Coulomb(0.5, spinning=0.01))
    spin = lambda t, q, v: np.r_[0, 0, 0, 0, 0, 0.01 * G * size * math.sin(omega * t)]  # noqa: E731
    run = pc.simulate(scene, state, 3.0, control=spin, **options(case))
    assert run.events[0].kind == "turn" and abs(run.events[0].time - turn / omega) <= 1e-10

    scene, state = slider(low=0.0)
    run = pc.simulate(
        scene, state, 9.0, control=along_x(lambda t: -1.0 + size * math.sin(omega * t), 1), **options(case)
    )
    assert run.events[0].kind == "release" and abs(run.events[0].time - turn / omega) <= 1e-10


@pytest.mark.parametrize("case", range(len(METHODS)))
def test_a_plate_takes_the_block_along(case):
    """It rests, moves 0.1 m within a second and rests; the block sticks to it all the time."""

    def motion(t):
        u = min(max(t - 13.3, 0.0), 1.0)
        x = np.array([1.0, 0.0, 0.0])
        rates = 3.0 * u**2 * (1.0 - u) ** 2, 6.0 * u - 18.0 * u**2 + 12.0 * u**3
        place = pin.SE3(np.eye(3), 0.1 * u**3 * (10.0 - 15.0 * u + 6.0 * u**2) * x)
        return place, *(np.r_[rate * x, np.zeros(3)] for rate in rates)

    scene, state = block(pc.Coulomb(0.9), motion=pc.CallableMotion(motion))
    run = pc.simulate(scene, state, 16.0, t_eval=[16.0], **options(case))
    assert run.status == 0 and not run.events
    assert abs(run.q[-1, 0] - 0.1) <= max(
        1e-2 * options(case)["rtol"], 1e-7 if options(case)["method"] == "RK23" else 0
    )


def test_a_belt_that_turns_round_below_a_block_in_slip():
    """Friction is constant until v_c changes its sign, and so is the block's acceleration: its path is integrated
    exactly, over however many turns of the belt. Against steps of 1 ms."""
    belt = pc.HarmonicMotion((0.5, 0.0, 0.0), 2.0)
    scene, state = block(pc.Coulomb(0.05), feet=1, motion=belt)
    run = pc.simulate(scene, state, 4.0, t_eval=[4.0])
    fine = pc.simulate(scene, state, 4.0, t_eval=[4.0], max_step=1e-3)
    assert run.status == fine.status == 0
    assert abs(run.q[-1, 0] - fine.q[-1, 0]) <= 1e-7


def test_event_functions_far_from_zero_shorten_no_step():
    """A load that never comes near the limit costs no rejected step."""
    scene, state = block(pc.Coulomb(0.5))
    run = pc.simulate(scene, state, 10.0, control=along_x(lambda t: 0.05 * math.sin(30.0 * t)))
    assert run.status == 0 and run.stats["rejected"] == 0 and run.stats["steps"] <= 160


@pytest.mark.parametrize("name", ["DOP853", "Sharp98", "RK45", "RK23"])
def test_roughness_of_polynomials_is_zero(name):
    pair = tableau(name)
    n = pair.stages + 1
    weights, nodes = roughness(pair.a[:n, :n], pair.c[:n]), pair.c[:n]
    assert len(weights) >= 2
    # a row of no use is one whose last weight is zero
    assert (np.abs(weights[:, -1]) > 1e-6).all()
    assert np.abs(weights @ nodes).max() <= 1e-13
    assert np.linalg.norm(weights @ np.sin(20.0 * nodes)) > 0.1


# ------------------------------------------------------------------------------------------------------ users' events


@pytest.mark.parametrize("case", range(14))
def test_all_zeros_within_steps(case):
    """A function of time alone, and a height passed twice in one step."""
    rng = np.random.default_rng(300 + case)
    omega, phase = rng.uniform(5.0, 60.0), rng.uniform(0.1, 3.0)
    scene, state = ball(pc.Coulomb(0.4))
    run = pc.simulate(scene, state, 5.0, events=lambda t, q, v: math.sin(omega * t + phase), **options(case))
    zeros = (math.pi * np.arange(1, 200) - phase) / omega
    np.testing.assert_allclose([e.time for e in run.events], zeros[zeros <= 5.0], rtol=0.0, atol=1e-12)
    speed, height = rng.uniform(1.0, 3.0), rng.uniform(0.5, 0.999)
    state = scene.initial_state([0, 0, 1.1, 0, 0, 0, 1.0], [0, 0, speed, 0, 0, 0], free=["c"])
    top = speed**2 / (2.0 * G)
    run = pc.simulate(scene, state, 2.2 * speed / G, events=lambda t, q, v: q[2] - 1.1 - height * top, **options(case))
    expected = (speed + np.array([-1.0, 1.0]) * speed * math.sqrt(1.0 - height)) / G
    np.testing.assert_allclose([e.time for e in run.events], expected, rtol=0.0, atol=1e-9)


ALL_METHODS = ("DOP853", "RK45", "RK23", "Sharp98", "Moreau")


@pytest.mark.parametrize("method", ALL_METHODS)
def test_functions_that_are_faster_than_steps(method):
    """Sines and a square wave of time alone, thousands of zeros in one step; and marks on a way that is rolled."""
    scene, state = ball(pc.Coulomb(0.4))
    omega, phase, beat = 1e4, 0.3, 1.3e3
    functions = [
        lambda t, q, v: math.sin(omega * t + phase),
        lambda t, q, v: math.copysign(1.0, math.cos(beat * t)),
        lambda t, q, v: math.sin(math.pi * (q[0] / 1e-3 - 0.5)),
    ]
    start = scene.initial_state(state.q, [0.6, 0, 0, 0, 6.0, 0])
    for at_start, speed in ((state, 0.0), (start, 0.6)):
        run = pc.simulate(scene, at_start, 0.1, events=functions, method=method)
        assert run.status == 0 and run.message.endswith("was reached."), run.message
        expected = (
            (math.pi * np.arange(1, 1000) - phase) / omega,
            math.pi * (np.arange(1000) + 0.5) / beat,
            1e-3 * (np.arange(1000) + 0.5) / speed if speed else np.array([np.inf]),
        )
        for index, times in enumerate(expected):
            found = [e.time for e in run.events if e.index == index]
            # rolling is straight; steps of 1e-15
            np.testing.assert_allclose(found, times[times <= 0.1], rtol=0.0, atol=1e-9 if index == 2 else 1e-12)


@pytest.mark.parametrize("method", ALL_METHODS)
def test_functions_that_are_too_fast_are_told(method, monkeypatch):
    """A sine, and noise; looks are bounded, also in all later steps."""
    monkeypatch.setattr(events, "MOST_LOOKS", 2000)
    scene, state = ball(pc.Coulomb(0.4))
    rng, calls = np.random.default_rng(0), []

    def noise(t, q, v):
        calls.append(t)
        return 1.0 + 0.9 * rng.random()

    run = pc.simulate(
        scene, state, 0.02, events=[lambda t, q, v: t - 0.01, lambda t, q, v: math.sin(1e9 * t)], method=method
    )
    assert run.status == 0 and "; events[1] changes too fast" in run.message and "events[0]" not in run.message
    assert abs(next(e.time for e in run.events if e.index == 0) - 0.01) <= 1e-15
    run = pc.simulate(scene, state, 0.02 if method == "Moreau" else 2.0, events=noise, method=method)
    assert run.status == 0 and not run.events and len(calls) < 4000 + 1000 * (run.stats["steps"] + 1)


def test_direction_and_terminal_within_a_step():
    scene, state = ball()
    function = lambda t, q, v: math.sin(20.0 * t + 1.0)  # noqa: E731
    function.direction = 1.0
    run = pc.simulate(scene, state, 2.0, events=function)
    np.testing.assert_allclose(np.diff([e.time for e in run.events]), 0.1 * math.pi, rtol=1e-10)
    assert len(run.events) == 6
    function.terminal = True
    run = pc.simulate(scene, state, 2.0, events=function)
    assert run.status == 1 and abs(run.t[-1] - (2.0 * math.pi - 1.0) / 20.0) <= 1e-12


def test_sign_changes_of_fast_sines_and_jumps():
    """As many as there are, with some looks for each; a jump takes few."""
    rng = np.random.default_rng(2)
    for _ in range(15):
        omega, phase, calls = 10.0 ** rng.uniform(2.0, 4.0), rng.uniform(0.0, 2.0 * math.pi), []

        def sine(s):
            calls.append(s)  # noqa: B023
            return math.sin(omega * s + phase)  # noqa: B023

        values = [value for _, value in resolve(sine, sine(0.0), sine(1.0))]
        changes = math.floor((omega + phase) / math.pi) - math.floor(phase / math.pi)
        assert sum(low * high < 0.0 for low, high in pairwise(values)) == changes
        assert len(calls) < 40 * (changes + 1)
    for _ in range(30):
        # not two between neighbouring looks
        count = int(rng.integers(1, 5))
        places, calls = (np.arange(count) + rng.uniform(0.2, 0.5, count)) / count, []

        def steps(s):
            calls.append(s)  # noqa: B023
            return (-1.0) ** np.searchsorted(places, s)  # noqa: B023

        values = [value for _, value in resolve(steps, steps(0.0), steps(1.0))]
        assert sum(low * high < 0.0 for low, high in pairwise(values)) == count
        assert len(calls) < 250 * count


def test_sign_changes_of_random_sines():
    """Against 20,001 samples; what is closer to a double root than these see is left out."""
    rng = np.random.default_rng(1)
    x = np.linspace(0.0, 1.0, 20001)
    for _ in range(500):
        omega, phase, level = rng.uniform(0.1, 40.0), rng.uniform(0.0, 6.3), rng.uniform(-1.2, 1.2)
        if abs(abs(level) - 1.0) < 1e-4:
            continue
        function = lambda s: math.sin(omega * s + phase) - level  # noqa: E731, B023
        samples = with_double_zeros(function, resolve(function, function(0.0), function(1.0)))
        signs = np.sign([value for _, value in samples])
        dense = np.sign(np.sin(omega * x + phase) - level)
        assert (signs[1:] != signs[:-1]).sum() == (dense[1:] != dense[:-1]).sum()


# --------------------------------------------------------------------------------------------------------- breakpoints


@pytest.mark.parametrize("inclusive", [True, False])
@pytest.mark.parametrize("method", ["DOP853", "RK45", "RK23", "Sharp98", "Moreau"])
def test_breakpoints_show_what_no_step_sees(method, inclusive):
    """2 ms of 50 N after a rest of 8 s: a block on the ground, a joint in dry friction; whatever holds at the jump."""
    rtol = 1e-5 if method == "RK23" else 1e-8
    kwargs = {"method": method} | ({} if method == "Moreau" else {"rtol": rtol, "atol": 1e-2 * rtol})
    on, off, force = 7.7731, 7.7751, 50.0
    load = (lambda t: force * (on <= t < off)) if inclusive else (lambda t: force * (on < t <= off))
    for scene, state, nv, hold in ((*block(pc.Coulomb(0.4)), 6, 0.4 * G), (*slider(dry=3.0), 1, 3.0)):
        run = pc.simulate(
            scene,
            state,
            10.0,
            control=along_x(load, nv),
            breakpoints=[off, 99.0, on, -1.0],
            t_eval=[on, 10.0],
            **kwargs,
        )
        assert run.status == 0, run.message
        speed = (force - hold) * (off - on)
        way = 0.5 * speed * (off - on) + speed**2 / (2.0 * hold)
        # time stepping with steps of 1 ms is of first order in the last one; the others follow a parabola exactly, but
        # for the last linear step, which leaves out a twentieth of what steps may, 1e-7 m/s in RK23
        assert abs(run.q[-1, 0] - way) <= {"Moreau": 2e-6, "RK23": 5e-9}.get(method, 1e-11)
        assert abs(run.q[0, 0]) <= 1e-12 and run.t.tolist() == [on, 10.0]
        if method != "Moreau":
            times = {e.kind: e.time for e in run.events}
            assert abs(times["slip"] - on) <= 1e-14 and abs(times["stick"] - (off + speed / hold)) <= 1e-9


@pytest.mark.parametrize("method", ["DOP853", "RK45", "Moreau"])
def test_a_belt_that_starts_at_once(method):
    """It slips below the block until friction has brought that to its speed: no impulse acts along a belt."""
    start, speed, x = 3.21, 0.5, np.array([1.0, 0.0, 0.0])

    def motion(t):
        place = pin.SE3(np.eye(3), speed * max(t - start, 0.0) * x)
        return place, np.r_[speed * (t >= start) * x, np.zeros(3)], np.zeros(6)

    scene, state = block(pc.Coulomb(0.4), motion=pc.CallableMotion(motion))
    run = pc.simulate(scene, state, 6.0, method=method, breakpoints=[start], t_eval=[6.0])
    friction = 0.4 * G
    way = speed**2 / (2.0 * friction) + speed * (6.0 - start - speed / friction)
    assert run.status == 0
    assert abs(run.q[-1, 0] - way) <= (1e-5 if method == "Moreau" else 1e-9)
    assert {e.kind for e in run.events} == {"slip", "stick"}


def test_a_motion_that_jumps_away_is_told():
    def motion(t):
        return pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.01 * (t >= 1.0)])), np.zeros(6), np.zeros(6)

    scene, floor = body(motion=pc.CallableMotion(motion))
    scene.add_contact("c", scene.add_contour("ball", pc.Sphere(0.1), "body"), floor)
    run = pc.simulate(scene, scene.initial_state([0, 0, 0.1, 0, 0, 0, 1.0]), 2.0, breakpoints=[1.0])
    assert run.status == -1 and "'c'" in run.message and abs(run.t[-1] - 1.0) <= 1e-12


@pytest.mark.parametrize("bad", [[math.nan], [math.inf], "soon", [1j], {"t": 1.0}])
def test_bad_breakpoints(bad):
    scene, state = ball()
    for method in ("DOP853", "Moreau"):
        with pytest.raises(pc.ArgumentError, match="breakpoints"):
            pc.simulate(scene, state, 1.0, breakpoints=bad, method=method)


# -------------------------------------------------------------------------------------------------------------- joints


def _chain(rng, n):
    model, parent = pin.Model(), 0
    model.gravity.linear = np.zeros(3)
    for i in range(n):
        axis = np.r_[1.0, rng.uniform(-0.9, 0.9, 2)]
        joint = pin.JointModelPrismaticUnaligned(axis / np.linalg.norm(axis))
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"joint {i}")
        model.appendBodyToJoint(
            parent, pin.Inertia(rng.uniform(0.2, 3.0), np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity()
        )
    model.lowerPositionLimit, model.upperPositionLimit = np.zeros(n), np.full(n, 5.0)
    return pc.Scene(model)


@pytest.mark.parametrize("case", range(13, 40, 2))
def test_coupled_stops_come_to_rest(case):
    """Sliders on each other, pressed onto their limits: each impact lifts the others, by less and less."""
    rng = np.random.default_rng(case)
    scene = _chain(rng, 3)
    start = np.random.default_rng(case + 100)
    q, v, load = start.uniform(0.0, 0.2, 3), start.uniform(-1.0, 0.5, 3), -start.uniform(1.0, 10.0, 3)
    run = pc.simulate(scene, scene.initial_state(q, v), 3.0, control=lambda t, q, v: load, t_eval=[3.0])
    assert run.status == 0 and len(run.events) <= 20
    # where it ends: at all limits
    assert np.abs(run.q[-1]).max() <= 1e-9 and np.abs(run.v[-1]).max() <= 1e-12


@pytest.mark.parametrize("case", range(6))
def test_dry_friction_holds_for_good(case):
    """Joints that are held have no acceleration, not even by round-off times the square of a long step."""
    rng = np.random.default_rng(case)
    model, parent, n = pin.Model(), 0, 5
    for i in range(n):
        axis, place = rng.normal(size=3), pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.3, 0.3, 3))
        joint = pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis))
        parent = model.addJoint(parent, joint, place, f"joint {i}")
        inertia = pin.Inertia(rng.uniform(0.2, 3.0), rng.uniform(-0.2, 0.2, 3), 0.01 * np.eye(3))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    q = rng.uniform(-2.0, 2.0, n)
    limit = 1.3 * np.abs(pin.rnea(model, model.createData(), q, np.zeros(n), np.zeros(n))) + 1e-3
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = -limit, limit
    scene = pc.Scene(model)
    run = pc.simulate(scene, scene.initial_state(q), 1e5, t_eval=np.linspace(0.0, 1e5, 9))
    assert run.status == 0 and not run.events
    assert (run.q == q).all()


@pytest.mark.parametrize("friction", [None, pc.Coulomb(0.3)])
@pytest.mark.parametrize("case", [16, 18, 25, 27, 31, 33, 36, 37])
def test_stops_and_a_contact_strike_as_one(case, friction):
    """Sliders that come to their stops and onto a plate, all as near as symmetric motions leave them: one impact,
    whatever the others are thrown by each alone."""
    rng = np.random.default_rng(case)
    scene = _chain(rng, 3)
    model, data = scene.model, scene.model.createData()
    # the plate takes the third stop's place
    model.lowerPositionLimit[2] = -5.0
    pin.computeJointJacobians(model, data, np.zeros(3))
    along = pin.getJointJacobian(model, data, 3, pin.LOCAL_WORLD_ALIGNED)[:3]
    normal = rng.normal(size=3)
    while normal @ along[:, 2] < 0.3 * np.linalg.norm(normal):
        normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    tangent = np.cross(normal, rng.normal(size=3))
    tangent /= np.linalg.norm(tangent)
    plate = pin.SE3(np.column_stack([tangent, np.cross(normal, tangent), normal]), np.zeros(3))
    tip, floor = (
        scene.add_contour("tip", pc.Point(), "joint 2"),
        scene.add_contour("plate", pc.Plane(), placement=plate),
    )
    scene.add_contact("tip", tip, floor, friction=friction)
    pressed = rng.uniform(1.0, 10.0, 3)
    load = -(np.r_[pressed[:2], 0.0] + along.T @ normal * pressed[2])
    # an instant is a thousandth of ten times the absolute and the relative tolerance: 1e-10
    ways = rng.uniform(1e-11, 5e-11, 3)
    q = np.r_[ways[:2], (ways[2] - normal @ along[:, :2] @ ways[:2]) / (normal @ along[:, 2])]
    state = scene.initial_state(q, rng.uniform(-1.0, 0.5, 3), free=["tip"])
    run = pc.simulate(scene, state, 1e-4, control=lambda t, q, v: load)
    assert run.status == 0
    # speeds are of 1 m/s: all that happens for 1e-5 s is within some micrometres
    assert len({event.time for event in run.events if event.time < 1e-5}) <= 1


@pytest.mark.parametrize("case", [38, 39, 40])
def test_dry_joints_begin_to_slide_for_good(case):
    """At its limit of friction a joint's acceleration is round-off, whose sign may be the other one."""
    rng = np.random.default_rng(case)
    model, parent, n = pin.Model(), 0, 4
    for i in range(n):
        axis, place = rng.normal(size=3), pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.3, 0.3, 3))
        joint = pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis))
        parent = model.addJoint(parent, joint, place, f"joint {i}")
        mass, lever, size = rng.uniform(0.2, 3.0), rng.uniform(-0.2, 0.2, 3), 10.0 ** rng.uniform(-3.0, -2.0)
        model.appendBodyToJoint(parent, pin.Inertia(mass, lever, size * np.eye(3)), pin.SE3.Identity())
    limit = rng.uniform(0.1, 1.0, n)
    model.upperDryFrictionLimit[:], model.lowerDryFrictionLimit[:] = limit, -limit
    scene = pc.Scene(model)
    run = pc.simulate(scene, scene.initial_state(rng.uniform(-1.0, 1.0, n)), 2.0, t_eval=[2.0])
    assert run.status == 0 and len(run.events) < 60
