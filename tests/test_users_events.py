"""Functions of users at jumps, at round-off, and in runs that go on from where they ended one."""

import math

import numpy as np
import pinocchio as pin
import pytest
from shared import one_body

import pincontact as pc

G = 9.81
RADIUS = 0.1

METHODS = {"DOP853": {}, "RK45": {"method": "RK45"}, "Moreau": {"method": "Moreau", "step": 1e-3}}


def ball_scene(friction=None, restitution=0.0):
    mass = 0.5
    inertia = pin.Inertia(mass, np.zeros(3), 0.4 * mass * RADIUS**2 * np.eye(3))
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), inertia, "ball"))
    ball, floor = scene.add_contour("ball", pc.Sphere(RADIUS), "ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", ball, floor, friction=friction, restitution=restitution)
    return scene


def thrown(scene, height, v=(0.0, 0.0, 0.0)):
    q = np.array([0.0, 0.0, RADIUS + height, 0.0, 0.0, 0.0, 1.0])
    return scene.initial_state(q, np.array([*v, 0.0, 0.0, 0.0]), free=["c"])


@pytest.mark.parametrize("method", METHODS)
def test_velocities_jump_through_zero(method):
    """A ball that bounces: its velocity rises through zero in each impact, and falls through zero at each top."""
    scene = ball_scene(restitution=0.8)
    run = pc.simulate(scene, thrown(scene, 0.5), 1.5, events=lambda t, q, v: v[2], **METHODS[method])
    touches = [event.time for event in run.events if event.kind == "touch"]
    rises = [event.time for event in run.events if event.kind == "user"]
    fall = math.sqrt(2.0 * 0.5 / G)
    # twice 0.8^k of the time of the first fall between touches
    expected = fall + 2.0 * fall * np.cumsum([0.0, 0.8, 0.8**2])
    tops = expected[:2] + fall * np.array([0.8, 0.8**2])
    within = 2e-3 if method == "Moreau" else 1e-7
    np.testing.assert_allclose(touches[:3], expected[: len(touches)], rtol=0.0, atol=within)
    np.testing.assert_allclose(rises[:4], np.sort([*expected[:2], *tops]), rtol=0.0, atol=within)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("direction", [0.0, -1.0])
def test_a_terminal_event_that_an_impact_makes(method, direction):
    scene = ball_scene(friction=pc.Coulomb(0.3))

    def slows(t, q, v):
        return np.linalg.norm(v) - 0.1

    slows.terminal, slows.direction = True, direction
    start = thrown(scene, 0.5, v=(0.0, 0.0, -1.0))
    run = pc.simulate(scene, start, 2.0, events=slows, **METHODS[method])
    assert run.status == 1
    (slow,) = [event.time for event in run.events if event.kind == "user"]
    assert run.t[-1] == slow == pytest.approx((math.sqrt(1.0 + G) - 1.0) / G, abs=2e-3)
    assert np.linalg.norm(run.v[-1]) < 1e-9


@pytest.mark.parametrize("jump", [0.3, 0.7])
def test_functions_of_time_jump_at_breakpoints(jump):
    scene = ball_scene()
    function = lambda t, q, v: 1.0 if t < jump else -1.0  # noqa: E731
    run = pc.simulate(scene, thrown(scene, 100.0), 1.0, events=function, breakpoints=[jump])
    assert [(event.kind, event.time) for event in run.events] == [("user", pytest.approx(jump, abs=1e-15))]


@pytest.mark.parametrize("method", METHODS)
def test_round_off_has_no_sign(method):
    """A function that comes to zero and stays there, as velocities of what is held do, is not seen to go through it
    again."""
    scene = ball_scene()
    run = pc.simulate(
        scene,
        thrown(scene, 100.0),
        1.0,
        events=lambda t, q, v: max(0.25 - t, 0.0) + 1e-17 * math.sin(400.0 * t),
        **METHODS[method],
    )
    assert [event.kind for event in run.events] == ["user"]
    # in Moreau's method as near as it looks for zeros, a part of its step
    assert run.events[0].time == pytest.approx(0.25, abs=1e-9 if method == "Moreau" else 1e-12)


FUNCTIONS = {
    "sine": lambda t, q, v: math.sin(23.0 * t + 1.0),
    "time": lambda t, q, v: t - 0.5,
    "angle": lambda t, q, v: q[0] - 1.0,
    "speed": lambda t, q, v: v[0],
    "square": lambda t, q, v: q[0] ** 2 - 2.0,
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("direction", [0.0, 1.0])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_runs_go_on_from_terminal_events(name, direction, method):
    """Each run goes on from where the last one ended, with the same function: as many of them as there are zeros."""
    inertia = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), 0.01 * np.eye(3))
    scene = pc.Scene(one_body(pin.JointModelRY(), inertia, "pendulum"))

    def function(t, q, v):
        return FUNCTIONS[name](t, q, v)

    function.direction = direction
    start, end = scene.initial_state([0.2], [0.3]), 2.0
    zeros = [event.time for event in pc.simulate(scene, start, end, events=function, **METHODS[method]).events]
    assert zeros
    function.terminal, times, state, status = True, [], start, 1
    while status == 1 and len(times) <= len(zeros):
        run = pc.simulate(scene, state, end - state.t, events=function, **METHODS[method])
        status, state = run.status, run.state(-1)
        times += [event.time for event in run.events]
    assert status == 0
    # new runs begin with steps of other sizes
    np.testing.assert_allclose(times, zeros, rtol=0.0, atol=2e-5 if method == "Moreau" else 1e-6)


def mass_on_a_plane(friction=None, restitution=0.0):
    scene = pc.Scene(one_body(pin.JointModelTranslation(), pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)), "mass"))
    point, floor = scene.add_contour("point", pc.Point(), "mass"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", point, floor, friction=friction, restitution=restitution)
    return scene


@pytest.mark.parametrize("before", [1e-6, 3e-7, 1e-7, 1e-8, 1e-9, 1e-12, 0.0, -1e-12, -1e-9])
@pytest.mark.parametrize("terminal", [False, True])
def test_zeros_beside_the_end_of_a_slip(before, terminal):
    """The last of a slip is one short step, in which zeros were not looked for: 3e-7 s before its end, and at it."""
    scene = mass_on_a_plane(pc.Coulomb(0.4))
    for speed in (0.4, 1.1, 1.9):
        zero = speed / (0.4 * G) - before

        def event(t, q, v, zero=zero):
            return t - zero

        event.terminal = terminal
        run = pc.simulate(scene, scene.initial_state([0, 0, 0], [speed, 0, 0]), zero + 0.3, events=event)
        (found,) = (one for one in run.events if one.kind == "user")
        assert run.status == int(terminal)
        assert [one.time for one in run.events] == sorted(one.time for one in run.events)
        # a terminal one ends the run where that step ends
        assert found.time == pytest.approx(zero, abs=5e-7 if terminal else 1e-9)
        if not terminal:
            left = max(speed - 0.4 * G * found.time, 0.0)
            assert found.v[0] == pytest.approx(left, abs=1e-8)


@pytest.mark.parametrize("speed", [1e-3, 1e-5, 1e-6, 1e-7, 1e-9])
@pytest.mark.parametrize("method", ["DOP853", "RK45", "Sharp98"])
def test_runs_that_end_as_a_mass_has_all_but_stopped(speed, method):
    scene = mass_on_a_plane(pc.Coulomb(0.4))

    def slow(t, q, v):
        return math.hypot(v[0], v[1]) - speed

    slow.terminal = True
    run = pc.simulate(scene, scene.initial_state([0, 0, 0], [1.0, 0.3, 0]), 1.0, method=method, events=slow)
    assert run.status == 1 and run.t[-1] == pytest.approx((math.hypot(1.0, 0.3) - speed) / (0.4 * G), abs=5e-7)


@pytest.mark.parametrize("direction", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize("after", [0.0, 1e-14, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9])
@pytest.mark.parametrize("jump", [False, True])
def test_zeros_beside_an_impact_are_found_once(after, direction, jump):
    """The step that strikes goes on beyond the impact, which may come a little before a zero that was seen with it."""
    scene, twice = mass_on_a_plane(restitution=0.5), 0
    for height in (0.3, 0.7, 1.1, 1.6):
        zero = math.sqrt(2.0 * height / G) + after

        def event(t, q, v, zero=zero):
            return t - zero

        event.direction = direction
        state = scene.initial_state([0, 0, height], [1, 0, 0], free=["c"])
        # an impact and a breakpoint that round-off alone parts have no order
        jumps = [zero] if jump and after > 1e-14 else []
        run = pc.simulate(scene, state, zero + 0.05, events=event, breakpoints=jumps)
        twice += sum(one.kind == "user" for one in run.events) != (direction >= 0.0)
    assert twice == 0


@pytest.mark.parametrize("method", ["DOP853", "RK45", "RK23", "Sharp98"])
@pytest.mark.parametrize("speed", [1e-7, 1e-5, 1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("rate", [5.0, 100.0])
def test_zeros_as_a_slip_begins(rate, speed, method):
    """A force grows until a mass slips, v = rate (t - start)^2 / 2: the speed is there when it is, once; a run that
    ends there has it then."""
    mu = 0.4
    scene = mass_on_a_plane(pc.Coulomb(mu))
    towards = np.array([0.6, 0.8, 0.0])

    def control(t, q, v):
        return rate * t * towards

    def event(t, q, v):
        return float(towards @ v) - speed

    time = mu * G / rate + math.sqrt(2.0 * speed / rate)
    for terminal in (False, True):
        event.terminal = terminal
        state = scene.initial_state(np.zeros(3))
        run = pc.simulate(scene, state, time + 0.1, method=method, control=control, events=event)
        zeros = [found.time for found in run.events if found.kind == "user"]
        assert len(zeros) == 1 and run.status == int(terminal), run.message
        # the seed of a slip, 1e-4 s in units of its own growth, is resolved to its square
        assert abs(zeros[0] - time) < 2e-6
        if terminal:
            assert run.t[-1] == zeros[0] and abs(towards @ run.v[-1] - speed) < 1e-9 + 2e-6 * math.sqrt(
                2 * speed * rate
            )


def test_zeros_come_in_pairs_as_a_slip_begins():
    """A function that goes below zero and back within the first step of a slip."""
    mu, rate, low, high = 0.4, 5.0, 1e-3, 1.1e-3
    scene = mass_on_a_plane(pc.Coulomb(mu))
    run = pc.simulate(
        scene,
        scene.initial_state(np.zeros(3)),
        1.0,
        control=lambda t, q, v: np.array([rate * t, 0.0, 0.0]),
        events=lambda t, q, v: (v[0] - low) * (v[0] - high) / (low * high),
    )
    zeros = [found.time for found in run.events if found.kind == "user"]
    start = mu * G / rate
    np.testing.assert_allclose(zeros, [start + math.sqrt(2.0 * speed / rate) for speed in (low, high)], atol=1e-6)
