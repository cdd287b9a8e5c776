"""Carts with two wheels on one axle: on flat ground the wheels hold it along the axle both, on curved ground next
to so, and what no rolling motion allows is slip, however slow."""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

RADIUS, DURATION = 0.08, 0.5
UP = pin.SE3(pin.utils.rotate("x", 0.5 * np.pi), np.zeros(3))


def cart(ground, wheel, track, mu, speed, turn):
    """A cart that drives onto the ground, with a skid without friction behind; its wheels' speeds are those of rolling
    on flat ground. Returns scene and start."""
    model = pin.Model()
    body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(body, pin.Inertia(4.0, np.array([-0.03, 0.0, 0.0]), 0.004 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("tail", body, pin.SE3(np.eye(3), np.array([-0.2, 0.0, -0.05])), 0)
    for name, side in (("left", 0.5), ("right", -0.5)):
        place = pin.SE3(np.eye(3), np.array([0.0, side * track, 0.0]))
        joint = model.addJoint(body, pin.JointModelRUBY(), place, name)
        model.appendBodyToJoint(joint, pin.Inertia(0.6, np.zeros(3), 0.0015 * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    floor = scene.add_contour("ground", pc.HeightField(ground, domain=((-1.5, 2.0), (-1.5, 1.5))))
    for name in ("left", "right"):
        rim = scene.add_contour(name, wheel, frame=name, placement=UP)
        scene.add_contact(name, rim, floor, friction=pc.Coulomb(mu))
    scene.add_contact("tail", scene.add_contour("tail", pc.Point(), frame="tail"), floor)
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[2] = RADIUS + ground(0.0, 0.0)
    v[0], v[5] = speed, turn
    v[6:] = (speed - turn * track * np.array([0.5, -0.5])) / RADIUS
    return scene, scene.initial_state(q, v)


def random_cart(seed):
    """A cart of random track, speed and friction, with wheels of a random kind, and random ground; every second one
    drives straight ahead."""
    rng = np.random.default_rng(seed)
    kind, h = ("bump", "bowl", "saddle", "waves", "step")[rng.integers(5)], 10 ** rng.uniform(-3.0, -1.5)
    x0, y0 = rng.uniform(0.1, 0.4), rng.uniform(-0.2, 0.2)
    k, phase = rng.uniform(2.0, 8.0, 2), rng.uniform(0.0, 6.0, 2)
    ground = {
        "bump": lambda x, y: h * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 0.05),
        "bowl": lambda x, y: 10.0 * h * ((x - x0) * (x - x0) + (y - y0) * (y - y0)),
        "saddle": lambda x, y: 10.0 * h * ((x - x0) * (x - x0) - (y - y0) * (y - y0)),
        "waves": lambda x, y: 0.3 * h * np.sin(k[0] * x + phase[0]) * np.sin(k[1] * y + phase[1]),
        "step": lambda x, y: 0.3 * h * np.tanh((x - x0 + y0 * y) / 0.1),
    }[kind]
    track = rng.uniform(0.1, 0.5)
    wheel = (pc.Circle(RADIUS), pc.Torus(RADIUS - 0.02, 0.02), pc.Sphere(RADIUS))[rng.integers(3)]
    mu, speed = rng.uniform(0.2, 1.2), rng.uniform(0.2, 1.5)
    return cart(ground, wheel, track, mu, speed, rng.choice([0, 1]) * rng.uniform(-2.0, 2.0))


def saddle(x0, y0):
    return lambda x, y: 0.01 * ((x - x0) ** 2 - (y - y0) ** 2)


def compare(scene, state):
    """A run gets to its end, without energy from nowhere, and where time stepping gets to."""
    run = pc.simulate(scene, state, DURATION, energies=True, max_steps=3000)
    assert run.status == 0 and run.t[-1] == DURATION, run.message
    energies = run.energies()
    # in J, of some J: the errors of rtol=1e-8, over some hundred steps
    assert np.abs(energies.balance).max() < 1e-6
    assert np.diff(energies.total).max() < 1e-6
    stepped = pc.simulate(scene, state, DURATION, method="Moreau", dt=5e-4)
    # in m, of 0.1 to 0.7: the error of steps of this size, which halves with them
    assert np.abs(stepped.q[-1][:7] - run.q[-1][:7]).max() < 5e-5


@pytest.mark.parametrize("seed", [2, 4, 8, 15])
def test_two_wheels_on_one_axle(seed):
    """Random carts: wheels that slip by 1e-8 m/s, in steps that no friction makes short (15), wheels that come to
    rest together where they cannot both stick (8), constraints that become independent (2), wheels that slip in turn
    (15), and slips that friction does not end, however slow they are (4)."""
    compare(*random_cart(seed))


@pytest.mark.parametrize("seed", [7, 13])
def test_no_tolerance_ends_slips_that_go_on(seed):
    """A slip as slow as errors of steps, beside constraints that leave next to nothing of its rows, has the direction
    that it shows, and goes on."""
    scene, state = random_cart(seed)
    runs = [pc.simulate(scene, state, DURATION, rtol=rtol, atol=0.01 * rtol) for rtol in (1e-6, 1e-8, 1e-10)]
    assert [run.status for run in runs] == [0, 0, 0], [run.message for run in runs]
    for run in runs[:2]:
        # in m and rad, of 0.2 to 0.7: what slips that end take at rtol=1e-6
        np.testing.assert_allclose(run.q[-1, :7], runs[2].q[-1, :7], atol=1e-6)


def test_hops_that_do_not_get_lower_are_told():
    """A cart whose friction tips it from wheel to wheel: what slip there is, in turning, throws up one as the other
    comes down, for ever, by 1e-10 to 1e-9 m. Without the hops it turns by 6 % less."""
    scene, state = random_cart(5)
    loose, tight = (pc.simulate(scene, state, 0.02, rtol=rtol, atol=0.01 * rtol) for rtol in (1e-8, 1e-10))
    assert loose.status == tight.status == 0
    assert "'left', 'right' bounce on" in loose.message
    assert "bounce on" not in tight.message
    # hops that last, and not as an error of tolerances
    assert len(tight.events) > 5 * len(loose.events)


def test_wheels_slip_more_slowly_than_steps_are_accurate():
    """A wheel slips on beside another that sticks, far below the error of steps in velocities; to end that took more
    from the cart than such errors do, again and again."""
    scene, state = random_cart(13)
    runs = [pc.simulate(scene, state, DURATION, rtol=rtol, atol=0.01 * rtol) for rtol in (1e-8, 1e-10)]
    assert [run.status for run in runs] == [0, 0], runs[0].message
    # in m and rad, of 0.3 m: errors of rtol=1e-8 over a hundred steps
    np.testing.assert_allclose(runs[0].q[-1], runs[1].q[-1], atol=1e-7)


@pytest.mark.parametrize("rtol", [1e-7, 1e-8, 1e-9])
def test_stick_gives_way_where_constraints_become_independent(rtol):
    """On a saddle the wheels of an axle hold the same till their rows have turned by 1e-6: then both cannot stick, and
    that takes next to nothing from the cart's turn. The values are those of short time steps, see below."""
    for x0, y0, turn in ((0.25, -0.1, -0.54344), (0.1, 0.1, 0.53137)):
        for side in (1.0, -1.0):
            scene, state = cart(saddle(x0, side * y0), pc.Circle(RADIUS), 0.15, 0.43, 1.2, 0.0)
            run = pc.simulate(scene, state, DURATION, rtol=rtol, atol=0.01 * rtol)
            assert run.status == 0, run.message
            assert "slip" in [event.kind for event in run.events if event.time > 0.01]
            np.testing.assert_allclose(run.v[-1, 5], side * turn, atol=1e-5)


@pytest.mark.parametrize(("dt", "x0", "y0", "turn"), [(1e-3, 0.25, -0.1, -0.54344), (1e-4, 0.1, 0.1, 0.53137)])
def test_steps_take_no_turn_away(dt, x0, y0, turn):
    """On a saddle both wheels of an axle stick up to 2e-9 m/s, which is as much as solutions of contact problems leave
    open; to take that away, as a constraint next to redundant, would take 0.02 rad/s of the cart's turn at once."""
    scene, state = cart(saddle(x0, y0), pc.Circle(RADIUS), 0.15, 0.43, 1.2, 0.0)
    run = pc.simulate(scene, state, DURATION, method="Moreau", dt=dt)
    assert run.status == 0
    # the turn grows in steps of an equal size, and to that of an event-driven run that got through
    assert np.abs(np.diff(run.v[:, 5])).max() < 5.0 * dt
    np.testing.assert_allclose(run.v[-1, 5], turn, atol=1e-5 + 0.02 * dt)
