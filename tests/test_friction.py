"""Coulomb friction in time: when slip starts and stops, static above sliding friction, one and two tangents."""

import math

import numpy as np
import pinocchio as pin
import pytest
from random_contacts import START, RandomContact

import pincontact as pc
from pincontact.integration.discrete import write_discrete
from pincontact.layout import MODE, NO_FORCE, SLIP_SIGN, SLIPPING

G = 9.81
MASS = 0.4
TIGHT = {"rtol": 1e-11, "atol": 1e-13}


def slider(friction, planar=False, slope=0.0, motion=None):
    """A point mass on a plane of space (P-S), or on a line of a vertical plane (P-2C); x goes down the slope."""
    model = pin.Model()
    if planar:
        model.gravity.linear = G * np.array([math.sin(slope), -math.cos(slope), 0.0])
        parent = 0
        for i, joint in enumerate((pin.JointModelPX(), pin.JointModelPY())):
            parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"joint {i}")
    else:
        model.gravity.linear = G * np.array([math.sin(slope), 0.0, -math.cos(slope)])
        parent = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(parent, pin.Inertia(MASS, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addBodyFrame("slider", parent, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    point = scene.add_contour("point", pc.Point(), "slider")
    if planar:
        # e_3 of a line along x points downwards: the slider is on the other side
        ground, side = scene.add_contour("ground", pc.Line()), -1
    else:
        ground, side = scene.add_contour("ground", pc.Plane(), motion=motion), 1
    scene.add_contact("c", point, ground, friction=friction, side=side)
    return scene


BOTH = pytest.mark.parametrize("planar", [False, True], ids=["P-S", "P-2C"])


def at_rest(scene, vx=0.0):
    nv = scene.model.nv
    return scene.initial_state(np.zeros(nv), vx * np.eye(nv)[0])


@BOTH
@pytest.mark.parametrize("mu_static", [None, 0.5], ids=["one coefficient", "static above sliding"])
def test_pulled_until_it_slides(planar, mu_static):
    """A force that grows as k t: slip starts where it meets the static limit, and goes on against sliding friction."""
    mu, pull = 0.3, 5.0
    scene = slider(pc.Coulomb(mu, mu_static), planar)
    force = np.eye(scene.model.nv)[0] * pull
    times = np.linspace(0.0, 0.8, 41)
    run = pc.simulate(scene, at_rest(scene), 0.8, control=lambda t, q, v: t * force, t_eval=times, **TIGHT)
    assert run.status == 0, run.message
    starts = (mu_static or mu) * MASS * G / pull
    assert [event.kind for event in run.events] == ["slip"]
    assert abs(run.events[0].time - starts) <= 1e-10
    t = np.maximum(times, starts)
    speed = pull * (t**2 - starts**2) / (2.0 * MASS) - mu * G * (t - starts)
    path = (
        pull * ((t**3 - starts**3) / 3.0 - starts**2 * (t - starts)) / (2.0 * MASS) - 0.5 * mu * G * (t - starts) ** 2
    )
    assert np.abs(run.v[:, 0] - speed).max() <= 1e-9
    assert np.abs(run.q[:, 0] - path).max() <= 1e-9
    track = run.contacts["c"]
    resting = times < starts
    np.testing.assert_allclose(track.tangential_force[resting], pull * times[resting], rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(track.tangential_force[~resting], mu * MASS * G, rtol=0.0, atol=1e-10)


@BOTH
def test_turns_on_a_slope(planar):
    """Friction below the slope: thrown uphill it stops for no time and slides back, less fast than it went."""
    mu, slope = 0.2, 0.5
    scene = slider(pc.Coulomb(mu), planar, slope)
    up, down = (G * (math.sin(slope) + sign * mu * math.cos(slope)) for sign in (1.0, -1.0))
    run = pc.simulate(scene, at_rest(scene, -1.0), 1.0, **TIGHT)
    assert run.status == 0, run.message
    assert [event.kind for event in run.events] == ["slip"]
    turns = 1.0 / up
    assert abs(run.events[0].time - turns) <= 1e-10
    assert run.q[-1, 0] == pytest.approx(-0.5 / up + 0.5 * down * (1.0 - turns) ** 2, abs=1e-9)
    assert run.v[-1, 0] == pytest.approx(down * (1.0 - turns), abs=1e-9)


def test_thrown_across_a_slope():
    """Two tangents: the direction of slip turns into the line of fall, and the slider comes to rest there; time and
    path by quadrature of the speed as a function of the direction."""
    mu, slope, v0 = 0.9, 0.5, 1.2
    scene = slider(pc.Coulomb(mu), False, slope)
    along, holding = G * math.sin(slope), mu * G * math.cos(slope)
    run = pc.simulate(scene, scene.initial_state(np.zeros(3), np.array([0.0, v0, 0.0])), 1.0, **TIGHT)
    assert [event.kind for event in run.events] == ["stick"]
    # at an angle a to the line of fall speed' = g_x cos a - h and a' = -g_x sin a / speed: d ln(speed) / da is a
    # function of a alone, speed = v0 tan(a / 2)^(h / g_x) / sin a from a = pi / 2, and t and x are integrals over a
    ratio = holding / along
    nodes, weights = np.polynomial.legendre.leggauss(60)
    # a runs from pi / 2 to 0; a = pi / 2 e^-s makes the integrands smooth at the end
    length = 40.0
    total, reach = 0.0, np.zeros(2)
    for piece in range(40):
        s = piece + 0.5 * (nodes + 1.0)
        a = 0.5 * math.pi * np.exp(-s * length / 40.0)
        speed = v0 * np.tan(0.5 * a) ** ratio / np.sin(a)
        measure = 0.5 * weights * a * speed / (along * np.sin(a)) * length / 40.0
        total += measure.sum()
        reach += [float((measure * speed * np.cos(a)).sum()), float((measure * speed * np.sin(a)).sum())]
    assert abs(run.events[0].time - total) <= 1e-9
    np.testing.assert_allclose(run.q[-1], [*reach, 0.0], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("method", ["DOP853", "Sharp98"])
def test_shaken_plate(method):
    """A plate that shakes sideways faster than friction can hold: slip in alternate directions, periodic after a while,
    with the sliding acceleration mu g between stops. Polynomials are integrated exactly, in steps of any length: the
    error estimate has to notice where slip turns round."""
    mu, amplitude, frequency = 0.2, 0.05, 3.0
    rate = 2.0 * math.pi * frequency
    assert amplitude * rate**2 > 3.0 * mu * G
    scene = slider(pc.Coulomb(mu), motion=pc.HarmonicMotion((amplitude, 0.0, 0.0), frequency))
    duration = 20.0 / frequency
    run = pc.simulate(scene, at_rest(scene), duration, rtol=1e-10, atol=1e-12, method=method)
    assert run.status == 0, run.message
    # so fast a plate leaves no time to stick: reversals only, two a period
    late = [event.time for event in run.events if event.time > 0.5 * duration]
    assert {event.kind for event in run.events} == {"slip"}
    assert len(late) == 20
    # the slider's velocity settles to a triangle of slope mu g, reversed half a period apart where it meets the
    # plate's: |cos(w t)| = pi mu g / (2 a w^2)
    np.testing.assert_allclose(np.diff(late), 0.5 / frequency, rtol=0.0, atol=1e-3)
    phase = np.abs(np.cos(rate * np.array(late[-4:])))
    np.testing.assert_allclose(phase, math.pi * mu * G / (2.0 * amplitude * rate**2), rtol=0.0, atol=5e-3)


@pytest.mark.parametrize("seed", range(20))
def test_slip_on_a_curve_is_the_root_of_a_quadratic(seed):
    """With x the normal force in the plane of two normals, G_nn x = b + mu G_nt |x|: so x = x_0 + mu k |x|, and |x| is
    a root of a quadratic, the only one that is positive while mu |k| < 1."""
    rng = np.random.default_rng(seed)
    names = ("Point", str(rng.choice(["Helix", "Ellipse", "FourierCurve", "SplineCurve"])))
    on_world, placed = bool(rng.random() < 0.5), int(rng.integers(10**6))
    mu = rng.uniform(0.1, 1.5)
    contact = RandomContact("P-3C", names, on_world=on_world, seed=placed, friction=pc.Coulomb(mu))
    system, state, nv = contact.system, contact.state, contact.scene.model.nv
    system.tau[:] = rng.normal(size=nv)
    contact.at()
    sign = np.sign(system.basis[0, 0] @ system.slip[0])
    write_discrete(system, state.discrete)
    system.contact_int[0, [MODE, SLIP_SIGN]] = SLIPPING, int(sign)
    system.q[:], system.v[:], system.location[:] = state.q, state.v, state.location
    status = system.evaluate(START)
    data = contact.scene.model.createData()
    mass = np.array(pin.crba(contact.scene.model, data, state.q))
    mass = np.triu(mass) + np.triu(mass, 1).T
    rows = system.rows[0]
    gram = rows @ np.linalg.solve(mass, rows.T)
    free = np.linalg.solve(mass, system.tau - pin.nonLinearEffects(contact.scene.model, data, state.q, state.v))
    base = -(rows @ free + system.bias[0])[1:]
    start, turn = np.linalg.solve(gram[1:, 1:], np.column_stack([base, mu * sign * gram[1:, 0]])).T
    if turn @ turn >= 1.0:
        # two roots or none
        assert status == NO_FORCE or system.force[0, 1:] @ turn < np.linalg.norm(system.force[0, 1:])
        return
    size = max(np.roots([1.0 - turn @ turn, -2.0 * (start @ turn), -(start @ start)]).real)
    assert status != NO_FORCE
    np.testing.assert_allclose(system.force[0, 1:], start + size * turn, rtol=0.0, atol=1e-10 * (1.0 + size))


@pytest.mark.parametrize("method", ["DOP853", "Sharp98", "RK45", "RK23"])
def test_a_bilateral_load_passes_through_zero(method):
    """A bead on a bar, whose load falls by r N/s and is zero at t_0: pulled by f it slips from d = f / (mu r) before
    t_0 on, at speed v = mu r (s + d)^2 / 2m after s < 0, and comes to rest (1 + sqrt(2)) d after t_0. A millisecond in
    a step that nothing else shortens."""
    rng = np.random.default_rng(61)
    for _ in range(12):
        mu, zero, fall = rng.uniform(0.2, 1.2), rng.uniform(0.2, 0.8), 10.0 ** rng.uniform(1.0, 3.0)
        pull, sign = mu * fall * 10.0 ** rng.uniform(-3.5, -1.3), rng.choice([-1.0, 1.0])
        model = pin.Model()
        along = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "along")
        bead = model.addJoint(along, pin.JointModelPZ(), pin.SE3.Identity(), "across")
        model.appendBodyToJoint(bead, pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame("bead", bead, pin.SE3.Identity(), 0)
        scene = pc.Scene(model)
        bar = scene.add_contour("bar", pc.Line(), placement=pin.SE3(pin.utils.rotate("x", 0.5 * math.pi), np.zeros(3)))
        point = scene.add_contour("point", pc.Point(), "bead")
        scene.add_contact("c", point, bar, friction=pc.Coulomb(mu), bilateral=True)

        def force(t, q, v, pull=pull, zero=zero, fall=sign * fall):
            return np.array([pull, 9.81 - fall * (zero - t)])

        run = pc.simulate(scene, scene.initial_state([0.0, 0.0]), 1.0, control=force, method=method)
        d, end = pull / (mu * fall), 1.0 + math.sqrt(2.0)
        assert [event.kind for event in run.events] == ["slip", "stick"]
        np.testing.assert_allclose([event.time for event in run.events], [zero - d, zero + end * d], atol=1e-3 * d)
        way = mu * fall * d**3 * (1.0 / 6.0 + 0.5 * end**2 - end**3 / 6.0 + 0.5 * end)
        # the start of slip is followed to third order of its seed
        np.testing.assert_allclose(run.q[-1, 0], way, rtol=1e-3, atol=1e-8)
