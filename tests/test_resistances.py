"""Friction beyond one or two coefficients: viscous, falling with speed, of two directions."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from shared import one_body
from turning_ball import ball

import pincontact as pc

G = 9.81
MASS = 0.4
TIGHT = {"rtol": 1e-11, "atol": 1e-13}
BOTH = pytest.mark.parametrize("planar", [False, True], ids=["P-S", "P-2C"])


def slider(friction, planar=False, slope=0.0, direction=0.0, bilateral=False):
    """A point mass on a plane of space (P-S), or on a line of a vertical plane (P-2C).

    The line of fall is x, turned by `direction` about the plane's normal.
    """
    model = pin.Model()
    fall, press = G * math.sin(slope), -G * math.cos(slope)
    if planar:
        model.gravity.linear = np.array([fall, press, 0.0])
        parent = 0
        for i, joint in enumerate((pin.JointModelPX(), pin.JointModelPY())):
            parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"joint {i}")
    else:
        model.gravity.linear = np.array([fall * math.cos(direction), fall * math.sin(direction), press])
        parent = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(parent, pin.Inertia(MASS, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addBodyFrame("slider", parent, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    point = scene.add_contour("point", pc.Point(), "slider")
    # e_3 of a line along x points downwards: the slider is on the other side
    ground, side = scene.add_contour("ground", pc.Line() if planar else pc.Plane()), -1 if planar else 1
    scene.add_contact("c", point, ground, friction=friction, side=side, bilateral=bilateral)
    return scene


def moving(scene, *v):
    return scene.initial_state(np.zeros(scene.model.nv), np.r_[v, np.zeros(scene.model.nv - len(v))])


def errors_of_moreau(scene, state, duration, q, v, steps):
    """Largest errors of q and v at the end of runs of Moreau's method."""
    out = []
    for step in steps:
        run = pc.simulate(scene, state, duration, method="Moreau", step=step, t_eval=[duration])
        assert run.status == 0, run.message
        out.append(max(np.abs(run.q[-1] - q).max(), np.abs(run.v[-1] - v).max()))
    return out


# ------------------------------------------------------------------------------------------------ viscous


@BOTH
@pytest.mark.parametrize("mu", [0.0, 0.2])
@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_viscous_friction_on_a_slope(planar, mu, method):
    """The speed approaches its end exponentially; the reported force is the dry and the viscous part."""
    slope, viscous = 0.4, 0.7
    scene = slider(pc.Coulomb(mu, viscous=viscous), planar, slope)
    run = pc.simulate(
        scene, moving(scene), 1.5, method=method, t_eval=np.linspace(0.0, 1.5, 16), **TIGHT, energies=True
    )
    assert run.status == 0, run.message
    rate = viscous / MASS
    drive = G * (math.sin(slope) - mu * math.cos(slope))
    speed = drive / rate * -np.expm1(-rate * run.t)
    path = (drive * run.t - speed) / rate
    # the start of slip out of rest is an event of its own, to the tolerance
    np.testing.assert_allclose(run.v[:, 0], speed, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(run.q[:, 0], path, rtol=0.0, atol=1e-9)
    track = run.contacts["c"]
    expected = mu * MASS * G * math.cos(slope) + viscous * run.v[:, 0]
    np.testing.assert_allclose(track.tangential_force[1:], expected[1:], rtol=1e-12)
    assert np.abs(run.energies().balance).max() <= 1e-9


def test_viscous_bead_on_a_helix():
    """A point on a spatial curve (bilateral, two normals): the speed along the wire is that on a slope."""
    radius, pitch, viscous = 0.3, 0.4, 0.5
    model = one_body(
        pin.JointModelTranslation(), pin.Inertia(MASS, np.zeros(3), np.zeros((3, 3))), "bead", joint="joint"
    )
    scene = pc.Scene(model)
    bead = scene.add_contour("bead", pc.Point(), "bead")
    wire = scene.add_contour("wire", pc.Helix(radius, pitch))
    scene.add_contact("c", bead, wire, friction=pc.Coulomb(0.0, viscous=viscous))
    state = scene.initial_state(np.array([radius, 0.0, 0.0]), np.zeros(3))
    run = pc.simulate(scene, state, 1.0, **TIGHT)
    climb = pitch / math.hypot(pitch, 2.0 * math.pi * radius)
    rate = viscous / MASS
    speed = G * climb / rate * -math.expm1(-rate)
    assert np.linalg.norm(run.v[-1]) == pytest.approx(speed, abs=1e-9)
    reference, v = run.q[-1], run.v[-1]
    coarse, fine = errors_of_moreau(scene, state, 1.0, reference, v, (0.02, 0.01))
    assert fine < 0.3 * coarse and fine < 1e-3


def test_strong_viscous_friction_does_not_make_time_stepping_unstable():
    """A decay a thousand times faster than the step: the trapezoidal rule damps it in the long run."""
    scene = slider(pc.Coulomb(0.0, viscous=4e4), slope=0.3)
    run = pc.simulate(scene, moving(scene, 0.01), 1.0, method="Moreau", step=0.01)
    assert run.status == 0, run.message
    assert np.abs(run.v).max() <= 0.0101
    assert abs(run.v[-1, 0]) < abs(run.v[0, 0])


# ------------------------------------------------------------------------------------------------ Stribeck


CURVE = {"mu": 0.15, "mu_static": 0.4, "speed": 0.1}


def stribeck(v, exponent=2.0):
    return CURVE["mu"] + (CURVE["mu_static"] - CURVE["mu"]) * math.exp(-((v / CURVE["speed"]) ** exponent))


@BOTH
@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_stopping_with_stribeck(planar, exponent):
    """Time and path of a slider that stops, by quadrature over its speed; then it sticks."""
    v0 = 0.6
    scene = slider(pc.Stribeck(**CURVE, exponent=exponent), planar)
    run = pc.simulate(scene, moving(scene, v0), 0.6, **TIGHT, energies=True)
    assert run.status == 0, run.message
    time, _ = quad(lambda v: 1.0 / (G * stribeck(v, exponent)), 0.0, v0, epsabs=1e-13, epsrel=1e-13)
    path, _ = quad(lambda v: v / (G * stribeck(v, exponent)), 0.0, v0, epsabs=1e-13, epsrel=1e-13)
    assert [event.kind for event in run.events] == ["stick"]
    assert abs(run.events[0].time - time) <= 1e-9
    assert run.q[-1, 0] == pytest.approx(path, abs=1e-9)
    assert abs(run.v[-1]).max() <= 1e-12
    energies = run.energies()
    assert np.abs(energies.balance).max() <= 1e-9
    assert (np.diff(energies.friction_work) <= 1e-12).all()


@BOTH
def test_stribeck_slip_starts_with_the_force_of_stick(planar):
    """Pulled by k t: the force has no jump at the start of slip, and the motion is that of v' = k t / m - g mu(v)."""
    pull, end = 4.0, 0.6
    scene = slider(pc.Stribeck(**CURVE), planar)
    force = np.eye(scene.model.nv)[0] * pull
    run = pc.simulate(scene, moving(scene), end, control=lambda t, q, v: t * force, **TIGHT)
    starts = CURVE["mu_static"] * MASS * G / pull
    assert [event.kind for event in run.events] == ["slip"]
    assert abs(run.events[0].time - starts) <= 1e-10
    reference = solve_ivp(
        lambda t, y: [y[1], pull * t / MASS - G * stribeck(y[1])],
        (starts, end), [0.0, 0.0], method="DOP853", rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    np.testing.assert_allclose([run.q[-1, 0], run.v[-1, 0]], reference.y[:, -1], rtol=0.0, atol=1e-8)
    track = run.contacts["c"]
    expected = [MASS * G * stribeck(v) if t > starts else pull * t for t, v in zip(run.t, run.v[:, 0])]
    np.testing.assert_allclose(track.tangential_force, expected, rtol=0.0, atol=1e-9)


def test_stick_slip_of_a_block_on_a_spring():
    """A block drawn by a spring over a rough plane: slip starts at mu_static, and both methods agree."""
    stiffness, draw, end = 30.0, 0.15, 2.0
    scene = slider(pc.Stribeck(0.1, 0.4, 0.02))

    def spring(t, q, v):
        return np.array([stiffness * (draw * t - q[0]), 0.0, 0.0])

    run = pc.simulate(scene, moving(scene), end, control=spring, rtol=1e-9, atol=1e-11)
    assert run.status == 0, run.message
    assert [event.kind for event in run.events[:3]] == ["slip", "stick", "slip"]
    for event in run.events:
        if event.kind == "slip":
            load = stiffness * (draw * event.time - event.q[0])
            assert load == pytest.approx(0.4 * MASS * G, abs=1e-8)
    # a jump of the spring's release is 0.1 m; the steps resolve it to first order
    moreau = pc.simulate(scene, moving(scene), end, control=spring, method="Moreau", step=5e-4, t_eval=[end])
    assert moreau.q[-1, 0] == pytest.approx(run.q[-1, 0], abs=2e-3)


# ------------------------------------------------------------------------------------------------ two directions


PAIR = (0.2, 0.35)


@pytest.mark.parametrize("mu_static", [None, (0.24, 0.42)])
def test_direction_of_the_force_and_path_of_a_slider(mu_static):
    """Thrown at an angle: F = -N S^2 v / |S v|, so that v_2 = C v_1^(mu_2 / mu_1)^2; the stop by quadrature."""
    v0 = np.array([0.7, 0.9])
    scene = slider(pc.Coulomb(PAIR, mu_static))
    run = pc.simulate(scene, moving(scene, *v0), 1.0, **TIGHT, energies=True)
    assert run.status == 0, run.message
    assert [event.kind for event in run.events] == ["stick"]
    squares = np.array(PAIR) ** 2
    power = squares[1] / squares[0]

    def across(v):
        return v0[1] * (v / v0[0]) ** power

    def pace(v):
        return math.sqrt(squares[0] * v**2 + squares[1] * across(v) ** 2) / (G * squares[0] * v) if v > 0.0 else 0.0

    time, _ = quad(pace, 0.0, v0[0], epsabs=1e-13, epsrel=1e-13, limit=200)
    x, _ = quad(lambda v: v * pace(v), 0.0, v0[0], epsabs=1e-13, epsrel=1e-13, limit=200)
    y, _ = quad(lambda v: across(v) * pace(v), 0.0, v0[0], epsabs=1e-13, epsrel=1e-13, limit=200)
    assert abs(run.events[0].time - time) <= 1e-8
    np.testing.assert_allclose(run.q[-1, :2], [x, y], rtol=0.0, atol=1e-8)
    track = run.contacts["c"]
    slipping = (track.mode == 2) & (np.hypot(run.v[:, 0], run.v[:, 1]) > 1e-6)
    v = run.v[slipping, :2]
    force = MASS * G * squares * v / np.linalg.norm(np.array(PAIR) * v, axis=1)[:, None]
    # the force on the ground is along the slip
    np.testing.assert_allclose(track.force[slipping, :2], force, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(v[:, 1], across(v[:, 0]), rtol=0.0, atol=1e-9)
    assert np.abs(run.energies().balance).max() <= 1e-9


BILATERAL = pytest.mark.parametrize("bilateral", [False, True], ids=["unilateral", "bilateral"])


@BILATERAL
@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
def test_holds_along_one_axis_and_slides_along_the_other(method, bilateral):
    slope = math.atan(0.28)
    for direction, moves in ((0.0, True), (0.5 * math.pi, False)):
        scene = slider(pc.Coulomb(PAIR), slope=slope, direction=direction, bilateral=bilateral)
        run = pc.simulate(scene, moving(scene), 0.5, method=method)
        assert run.status == 0, run.message
        along = np.array([math.cos(direction), math.sin(direction), 0.0])
        if moves:
            speed = 0.5 * G * (math.sin(slope) - PAIR[0] * math.cos(slope))
            # Moreau's steps from rest are exact here, events start slip to the tolerance
            np.testing.assert_allclose(run.v[-1], speed * along, rtol=0.0, atol=1e-7)
        else:
            assert np.abs(run.v).max() <= 1e-13
            track = run.contacts["c"]
            np.testing.assert_allclose(track.tangential_force, MASS * G * math.sin(slope), rtol=1e-12)


@pytest.mark.parametrize("mu_static", [None, (0.25, 0.4375)])
def test_pulled_out_of_an_elliptic_cone(mu_static):
    """A load that grows at an angle: slip starts on the ellipse; without a jump of friction along its normal."""
    pull, angle = 3.0, 0.7
    scene = slider(pc.Coulomb(PAIR, mu_static))
    force = pull * np.array([math.cos(angle), math.sin(angle), 0.0])
    run = pc.simulate(scene, moving(scene), 0.6, control=lambda t, q, v: t * force, rtol=1e-10, atol=1e-12)
    assert run.status == 0, run.message
    starts = MASS * G / np.linalg.norm(force[:2] / np.array(mu_static or PAIR))
    assert [event.kind for event in run.events] == ["slip"]
    assert abs(run.events[0].time - starts) <= 1e-9
    first = np.flatnonzero(run.t > starts)[0]
    squares = np.array(PAIR) ** 2
    normal = force[:2] / squares
    direction = run.v[first, :2] / np.linalg.norm(run.v[first, :2])
    if mu_static is None:
        # the direction turns with the time since the start
        np.testing.assert_allclose(
            direction, normal / np.linalg.norm(normal), rtol=0.0, atol=5.0 * (run.t[first] - starts)
        )

    # after the stiff start, any integrator will do
    def slope(t, y):
        return (t * force[:2] / MASS) - G * squares * y / np.linalg.norm(np.array(PAIR) * y)

    reference = solve_ivp(slope, (run.t[first], run.t[-1]), run.v[first, :2], method="Radau", rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(run.v[-1, :2], reference.y[:, -1], rtol=0.0, atol=1e-7)


def skate(friction):
    """A blade with a rocker (a circle that stands on its edge) that may yaw, and slide anywhere on the ice."""
    model = pin.Model()
    parent = 0
    for i, joint in enumerate((pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ(), pin.JointModelRZ())):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"joint {i}")
    inertia = pin.Inertia(MASS, np.array([0.05, 0.0, 0.0]), 0.002 * np.eye(3))
    model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    model.addBodyFrame("skate", parent, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    blade = scene.add_contour(
        "blade", pc.Circle(2.0), "skate", pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.array([0.0, 0.0, 2.0]))
    )
    ice = scene.add_contour("ice", pc.Plane())
    scene.add_contact("c", blade, ice, friction=friction, location=(-0.5 * math.pi, None))
    return scene


def test_along_a_blade():
    """The first direction turns with the blade: the force is that of its axes at every time; both methods agree."""
    mu = (0.02, 0.5)
    scene = skate(pc.Coulomb(mu, along="blade"))
    state = scene.initial_state(np.array([0.0, 0.0, 0.0, 0.6]), np.array([2.0, 0.3, 0.0, 1.5]))
    run = pc.simulate(scene, state, 0.4, rtol=1e-10, atol=1e-12)
    assert run.status == 0, run.message
    track = run.contacts["c"]
    for i in range(run.t.size):
        yaw = run.q[i, 3]
        axes = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        # on the ice, which the blade slides over the other way round
        slip = axes @ -track.slip_velocity[i, :2]
        expected = track.normal_force[i] * np.array(mu) ** 2 * slip / np.linalg.norm(np.array(mu) * slip)
        np.testing.assert_allclose(axes @ track.force[i, :2], expected, rtol=0.0, atol=1e-9)
    errors = errors_of_moreau(scene, state, 0.4, run.q[-1], run.v[-1], (4e-3, 2e-3))
    # second order: a quarter
    assert errors[1] < 0.3 * errors[0] and errors[1] < 1e-4


@BILATERAL
def test_time_stepping_converges_to_the_events(bilateral):
    """Curve, viscous part and two directions at once: second order in the step while slip lasts."""
    scene = slider(pc.Stribeck((0.1, 0.2), (0.2, 0.4), 0.5, viscous=0.3), bilateral=bilateral)
    state = moving(scene, 0.9, 1.1)
    run = pc.simulate(scene, state, 0.25, **TIGHT)
    assert not run.events
    errors = errors_of_moreau(scene, state, 0.25, run.q[-1], run.v[-1], (5e-3, 2.5e-3, 1.25e-3))
    assert 3.5 < errors[0] / errors[1] < 4.5
    assert 3.5 < errors[1] / errors[2] < 4.5


def test_impact_with_two_directions():
    """Dropped while moving aside: the tangential impulse obeys the ellipse.

    Rows soon after it: friction turns with the slip.
    """
    scene = slider(pc.Coulomb(PAIR))
    state = scene.initial_state(np.array([0.0, 0.0, 0.02]), np.array([0.8, 0.5, -0.4]), free=["c"])
    for options in ({"rtol": 1e-9, "atol": 1e-11, "max_step": 1e-3}, {"method": "Moreau", "step": 1e-3}):
        run = pc.simulate(scene, state, 0.1, **options)
        assert run.status == 0, run.message
        touch = [event for event in run.events if event.kind == "touch"]
        after = np.flatnonzero(run.t > touch[0].time)[0]
        gained = run.v[after, :2] - run.v[0, :2]
        down = math.sqrt(0.4**2 + 2.0 * G * 0.02)
        assert np.linalg.norm(gained / np.array(PAIR)) == pytest.approx(
            down + G * (run.t[after] - touch[0].time), rel=1e-6
        )


coefficients = st.floats(0.01, 2.0)


@settings(max_examples=30, deadline=None, derandomize=True, database=None)
@given(
    mu=st.tuples(coefficients, coefficients),
    falls=st.floats(1.0, 3.0),
    viscous=st.floats(0.0, 5.0),
    speed=st.floats(1e-3, 3.0),
    angle=st.floats(0.0, 2.0 * math.pi),
)
def test_friction_takes_energy(mu, falls, viscous, speed, angle):
    """Power of friction: never positive, and no admissible force of the dry part would take more."""
    law = pc.Stribeck(mu, (falls * mu[0], falls * mu[1]), 0.3, viscous=viscous)
    scene = slider(law)
    run = pc.simulate(scene, moving(scene, speed * math.cos(angle), speed * math.sin(angle)), 0.0)
    track = run.contacts["c"]
    slip, force, normal = track.slip_velocity[0, :2], track.force[0, :2], track.normal_force[0]
    power = force @ slip
    assert power < 0.0
    dry = power + viscous * slip @ slip
    factor = float(law.coefficient(speed)) / mu[0]
    turns = np.linspace(0.0, 2.0 * math.pi, 200)
    ellipse = factor * normal * np.column_stack([mu[0] * np.cos(turns), mu[1] * np.sin(turns)])
    assert dry <= (ellipse @ slip).min() + 1e-12 * abs(power)


# ------------------------------------------------------------------------------------------------ what is refused


def test_laws_that_do_not_fit_a_contact():
    with pytest.raises(pc.ArgumentError, match="two directions needs two tangents; P-2C has one"):
        slider(pc.Coulomb(PAIR), planar=True)
    with pytest.raises(pc.ArgumentError, match="neither 'point' nor 'ground'"):
        slider(pc.Coulomb(PAIR, along="blade"))
    with pytest.raises(pc.ArgumentError, match="along 'point', a point"):
        slider(pc.Coulomb(PAIR, along="point"))
    with pytest.raises(pc.ArgumentError, match="'surface', whose tangents change with its charts"):
        ball(pc.Coulomb(PAIR, along="surface"))
    with pytest.raises(pc.ArgumentError, match="nothing spins about the normal of P-2C"):
        slider(pc.Coulomb(0.3, spinning=1e-3), planar=True)
