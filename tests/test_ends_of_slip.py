"""The end of slip in three dimensions is foretold, and approached without passing it."""

import math

import numpy as np
import pinocchio as pin
import pytest
import scipy
from calling import from_python
from test_zeros import Looked, particle

import pincontact as pc
from pincontact.integration import slip_at_ends
from pincontact.integration.driver import Driver
from pincontact.layout import (
    LAST_RATE,
    LAST_SPEED,
    LAST_STEP,
    START_RATE,
    START_SPEED,
    START_TOLERANCE,
    STOP_ERROR,
    STOP_TIME,
    SYSTEM,
)

MU, G = 0.4, 9.81
FRACTION = slip_at_ends._STOP_FRACTION


def sliding(v):
    """1 kg that slides on a plane."""
    scene = particle(friction=pc.Coulomb(MU))
    return scene, scene.initial_state(np.zeros(3), v)


def system_of_a_run(monkeypatch):
    """The system of a run of that, before its first step."""
    systems = []

    def keep(driver, t, end):
        systems.append(driver.system)
        raise Looked

    monkeypatch.setattr(Driver, "_run", keep)
    with pytest.raises(Looked):
        pc.simulate(*sliding([1.0, 0.0, 0.0]), 1.0)
    (system,) = systems
    return system


@pytest.fixture
def foretell(monkeypatch):
    """foretell(h, speed, rate, before, rate_before, tolerance, turning, older): STOP_TIME and STOP_ERROR of a slip of
    these speeds and rates now and a step of h ago; turning: acceleration across the slip in m/s^2; older: speed and
    rate a step before that, and its size."""
    system = system_of_a_run(monkeypatch)
    foretold = from_python(slip_at_ends._foretell_stop, SYSTEM)

    def call(h, speed, rate, before, rate_before, tolerance=1e-10, turning=0.0, older=(math.inf, 0.0, 0.0)):
        numbers = system.contact_real[0]
        numbers[[START_SPEED, START_RATE, START_TOLERANCE]] = speed, rate, tolerance
        numbers[[LAST_SPEED, LAST_RATE, LAST_STEP]] = older
        system.scalars["step"] = h
        system.basis[0] = np.eye(3)
        system.slip[0], system.relative_acceleration[0] = (speed, 0.0, 0.0), (rate, turning, 0.0)
        foretold(system, 0, before, rate_before)
        return float(numbers[STOP_TIME]), float(numbers[STOP_ERROR])

    return call


def test_parabolas_are_foretold_to_their_end(foretell):
    """What slows down on a parabola, or a straight line, is stepped to a thousandth before its end; to where one linear
    step is good enough, where that is further away."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        # speed (T - t) (r + b (T - t)): r > 0 its rate at the end T
        end, r, b = 10.0 ** rng.uniform(-3, 0), 10.0 ** rng.uniform(-1, 1), rng.uniform(-0.4, 1.0)
        b *= r / end
        h = end * 10.0 ** rng.uniform(0.6, 2.0)
        if r + 2.0 * b * (end + h) <= 0.0:
            continue
        speed, rate = end * (r + b * end), -(r + 2.0 * b * end)
        before, rate_before = (end + h) * (r + b * (end + h)), -(r + 2.0 * b * (end + h))
        # cancellation in what is told of the error
        rounded = 4.0 * 1e-15 * before / r
        time, _ = foretell(h, speed, rate, before, rate_before)
        bend = abs(rate - rate_before) / h
        linear = math.sqrt(slip_at_ends._MARGIN * slip_at_ends.LEFT_OUT * 1e-10 / max(-rate, bend))
        expected = min(0.999 * end, end - linear)
        assert time == pytest.approx(max(expected, FRACTION * min(end, speed / -rate)), rel=1e-9, abs=rounded)
        assert time < end


def test_what_is_foretold_is_not_past_the_end(foretell):
    """Cubic speeds, also such as hardly come to rest: as far as the first zero, and no further; nearer to it than a
    fixed fraction of the way as a rule."""
    rng = np.random.default_rng(1)
    near = []
    for _ in range(4000):
        h = 10.0 ** rng.uniform(-3, 0)
        rate, speed = -(10.0 ** rng.uniform(-1, 1)), 10.0 ** rng.uniform(-4, -0.5)
        speed *= -rate * h
        b, c = rng.normal() * -rate / h, rng.normal() * -rate / h**2 * 10.0 ** rng.uniform(-4, 0)
        if rng.random() < 0.3:
            # the parabola just touches zero, or just does not
            b = 0.5 * rate**2 / speed * 0.5 * (1.0 + rng.normal() * 1e-2)
        slowing = np.polynomial.Polynomial([speed, rate, b, c])
        past, slope = slowing(-h), slowing.deriv()
        if past <= 0.0 or any(slope(np.linspace(-h, 0.0, 9)) > 0.0):
            continue
        end = min((z.real for z in slowing.roots() if abs(z.imag) < 1e-12 * abs(z) and z.real > 0.0), default=math.inf)
        time, _ = foretell(h, speed, rate, past, slope(-h))
        assert time > 0.0
        # what curves down by more than the last step tells may end sooner than a fraction of the line
        assert time < end or time <= FRACTION * speed / -rate, (h, speed, rate, b, c)
        near.append(time / end)
    assert np.quantile(near, 0.5) > FRACTION


def test_three_states_foretell_polynomials_of_degree_five(foretell):
    """With its last term as the error: as far as that leaves, and where it is small to a thousandth before the end."""
    rng = np.random.default_rng(2)
    errors = []
    for _ in range(400):
        h, ago, end = rng.uniform(0.5, 2.0, 3)
        # speed (T - t) times what is positive, of degree four
        scales = 10.0 ** rng.uniform(-6, -1, 4)
        other = np.polynomial.Polynomial([1.0, *(scales * rng.normal(size=4))])
        speed = other * np.polynomial.Polynomial([end, -1.0])
        places = np.linspace(-h - ago, end, 99)
        if other(places).min() <= 0.1 or speed.deriv()(np.linspace(0.0, end, 99)).max() >= 0.0:
            continue
        slope = speed.deriv()
        at, ahead = -h - ago, end + h + ago
        time, _ = foretell(
            h, speed(0.0), slope(0.0), speed(-h), slope(-h), older=(speed(at), slope(at), ago)
        )  # fmt: skip
        last = abs(speed.coef[5]) * end**2 * (end + h) ** 2 * ahead
        error = slip_at_ends._FORETOLD * last / -slope(end)
        expected = (1.0 - slip_at_ends._LEAST_LEFT) * end - error
        if end <= h + ago and expected > 1.01 * FRACTION * end:
            errors.append(error)
            assert time == pytest.approx(expected, rel=1e-7)
        assert time < end or time <= FRACTION * speed(0.0) / -slope(0.0)
    assert len(errors) > 100 and max(errors) > 0.05


def test_a_swing_that_ends_is_met_in_two_steps():
    """1 kg against a force that swings: the step that sees the end ends a thousandth before it, and the next one leaves
    a straight line. None passes the end, and is taken back."""
    rate, size = 9.0, 5.0
    scene, state = sliding([0.0, 0.0, 0.0])
    run = pc.simulate(scene, state, 3.0, control=lambda t, q, v: np.array([size * math.sin(rate * t), 0.0, 0.0]))
    assert run.status == 0, run.message
    stops = [event.time for event in run.events if event.kind == "stick"]
    assert len(stops) > 6
    assert run.stats["rejected"] == 0
    for stop in stops:
        before = stop - run.t[run.t < stop - 1e-12]
        assert np.sum(before < 0.03) <= 3
        assert before.min() > 1e-8


def test_nothing_is_foretold_of_what_does_not_slow_down(foretell):
    infinite = math.inf, math.inf
    assert foretell(0.1, 1.0, 0.0, 1.0, 0.0) == infinite
    assert foretell(0.1, 1.0, 2.0, 0.8, 2.0) == infinite
    assert foretell(0.1, 0.0, -1.0, 0.1, -1.0) == infinite
    # without a step before it, as the slip has just begun: a fraction of the straight line
    assert foretell(0.1, 1e-3, -2.0, math.inf, 0.0) == (pytest.approx(FRACTION * 5e-4), math.inf)
    assert foretell(0.0, 1e-3, -2.0, 1e-3, -2.0) == (pytest.approx(FRACTION * 5e-4), math.inf)
    # on its parabola it never ends: the same, and what a linear step leaves out is known
    time, error = foretell(1.0, 0.1, -1.0, 0.1 + 1.0 + 5.0, -11.0)
    assert time == pytest.approx(FRACTION * 0.1) and error == pytest.approx(0.05)
    # a long way is not foretold
    time, _ = foretell(1.0, 1.0, -1.0, 2.0, -1.0)
    assert time == pytest.approx(FRACTION)
    # it turns by as much as it has speed
    time, _ = foretell(0.1, 1e-3, -1.0, 0.101, -1.0, turning=1.0)
    assert time == pytest.approx(FRACTION * 1e-3)
    # and slows down ever faster: a fraction of the shorter way
    time, _ = foretell(0.2, 0.02, -1.0, 0.02 + 0.2 - 5.0 * 0.2**2 / 2.0, 0.0, turning=1.0)
    assert time == pytest.approx(FRACTION * (math.sqrt(1.0 + 10.0 * 0.02) - 1.0) / 5.0, rel=1e-12)


@pytest.mark.parametrize("bend", [0.0, 1.5, -3.0])
@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-11])
def test_a_slip_that_ends_on_a_parabola(bend, rtol):
    """1 kg that slides against a force which grows with time: speed v - (mu g) t + bend t^2 / 2; and of whose last
    stretch steps take all but a thousandth at a time."""
    v = 2.0
    end = 2.0 * v / (MU * G + math.sqrt((MU * G) ** 2 - 2.0 * bend * v))
    way = v * end - 0.5 * MU * G * end**2 + bend * end**3 / 6.0
    scene, state = sliding([v, 0.0, 0.0])
    run = pc.simulate(
        scene, state, end + 0.05, control=lambda t, q, v: np.array([bend * min(t, end), 0.0, 0.0]), rtol=rtol, atol=rtol
    )
    assert run.status == 0
    (event,) = run.events
    assert event.kind == "stick"
    # speeds are known to some tolerances of them, and slip ends at MU G or so
    assert event.time == pytest.approx(end, abs=4.0 * rtol)
    assert run.q[-1, 0] == pytest.approx(way, abs=20.0 * rtol)
    assert (np.diff(run.q[:, 0]) >= -1e-15).all()
    assert run.stats["rejected"] == 0
    left = end - run.t[run.t < event.time - 1e-9 * end]
    # from there the parabola is short against the last step: a few steps, not one for every factor of five
    assert np.sum(left < 0.1 * end) <= 4


def test_slip_that_shows_is_followed_from_its_limit():
    """A pull that grows and turns: what is alone at its limit slips against its friction, and no modes are searched."""
    scene = particle(friction=pc.Coulomb(MU))

    def control(t, q, v):
        return MU * G * (0.5 + t) * np.array([math.cos(t), math.sin(t), 0.0])

    run = pc.simulate(scene, scene.initial_state(np.zeros(3), np.zeros(3)), 0.6, control=control)
    assert run.status == 0, run.message
    (event,) = run.events
    assert event.kind == "slip" and event.time == pytest.approx(0.5, abs=1e-9)
    assert run.stats["cone_problems"] == 0


def test_a_run_that_ends_where_slip_turns_round_ends_there():
    """A hoop slides on a peg; the run ends at the instant at which its slip turns round, or starts. It went on for what
    a start of slip takes, 1e-5 s, beyond its end."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "hoop")
    inertia = np.diag([0.5, 0.5, 1.0]) * 0.2**2
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia), pin.SE3.Identity())
    model.addBodyFrame("hoop", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    scene.add_contour("hoop", pc.Circle(0.2), "hoop")
    scene.add_contour("peg", pc.Cylinder(0.145))
    scene.add_contact("c", "hoop", "peg", friction=pc.Coulomb(0.05))
    place, along = np.array([np.sin(0.9), -np.cos(0.9), 0.0]), np.array([np.cos(0.9), np.sin(0.9), 0.0])
    state = scene.initial_state([*(0.055 * place), 0, 0, 0, 1], [*(0.055 * 2.0 * along), 0, 0, 5.0])
    whole = pc.simulate(scene, state, 1.0, rtol=1e-11, atol=1e-13, dense_output=True)
    assert [event.kind for event in whole.events] == ["slip", "stick", "slip"]
    for event in whole.events:
        run = pc.simulate(scene, state, event.time)
        assert run.status == 0 and run.t[-1] == event.time
        np.testing.assert_allclose(run.q[-1], whole.sol(event.time).q, atol=1e-9)
        # and goes on from there
        rest = pc.simulate(scene, run.state(-1), 1.0 - event.time)
        np.testing.assert_allclose(rest.q[-1], whole.q[-1], atol=1e-9)


def test_slip_that_should_grow_but_does_not_has_ended(monkeypatch):
    """Friction that turns slip far below the errors of steps as fast as these allow may hold it at a speed that is no
    solution; a slip that has just begun is as slow, but nothing has held it back yet."""
    system = system_of_a_run(monkeypatch)
    ends = from_python(slip_at_ends.slip_ends, SYSTEM)
    numbers, counters = system.contact_real[0], system.counters
    for speed, rate, stalled, expected in (
        (0.9, 1.0, 0, False),
        (0.9, 1.0, 1, True),
        (1.1, 1.0, 1, False),
        (0.9, -1.0, 0, True),
        (1.1, -1.0, 0, False),
        (1.1, -1.0, 1, True),
    ):
        counters["stalled"] = stalled
        numbers[[START_SPEED, START_RATE, START_TOLERANCE, STOP_ERROR]] = 1e-9 * speed, rate, 1e-9, math.inf
        assert bool(ends(system, 1)) == expected


@pytest.mark.parametrize(
    ("gravity", "fall", "slip"),
    [(0.0, 0.3, 0.1), (1e-9, 0.3, 0.1), (1e-3, 0.3, 0.1), (1e-6, 0.0, 1e-7), (1e-4, 0.0, 1e-5)],
)
@pytest.mark.parametrize("rtol", [1e-6, 1e-8])
def test_a_body_spins_on_while_a_slip_beside_ends(gravity, fall, slip, rtol):
    """Under next to no load slip ends slowly, and a straight line to its end would be a long one. The other body's
    angular velocity is that of Euler's equations, integrated by SciPy; slip that is round-off has ended."""
    moments, radius = np.array([1e-3, 2e-3, 2.5e-3]), 0.1
    for seed in range(8):
        rng = np.random.default_rng(seed)
        model = pin.Model()
        model.gravity.linear = np.array([0.0, 0.0, -gravity])
        for name, inertia in (
            ("free", pin.Inertia(0.5, np.zeros(3), np.diag(moments))),
            ("ball", pin.Inertia(0.3, np.zeros(3), 8e-4 * np.eye(3))),
        ):
            joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
            model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
            model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
        scene = pc.Scene(model)
        scene.add_contour("ball", pc.Sphere(radius), "ball")
        scene.add_contour("floor", pc.Plane())
        scene.add_contact("c", "ball", "floor", friction=pc.Coulomb(0.9))
        q, spin = pin.neutral(model), 6.0 * rng.normal(size=3)
        q[2], q[9] = 5.0, radius + (0.005 if fall else 0.0)
        v = np.r_[rng.normal(size=3), spin, slip * rng.normal(size=2), -fall, np.zeros(3)]
        if fall:
            v[9:] = rng.normal(size=3)
        state = scene.initial_state(q, v, free=["c"] if fall else [])
        run = pc.simulate(scene, state, 0.1, rtol=rtol, atol=0.01 * rtol)
        assert run.status == 0, run.message

        def euler(t, w):
            return np.cross(moments * w, w) / moments

        exact = scipy.integrate.solve_ivp(euler, (0.0, 0.1), spin, rtol=1e-12, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(run.v[-1, 3:6], exact, atol=1e2 * rtol)
