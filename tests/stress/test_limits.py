"""Numbers far from 1 and contacts close to their limits: no NaN, no warning, no hang, answers as good as elsewhere."""

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import quad
from stress_scenes import (
    G,
    ball_in_bowl,
    bead_on_hoop,
    crossed_rods,
    disk,
    leaning,
    rod_on_ground,
    rod_state,
)

import pincontact as pc


def assert_sound(run, residual=1e-12):
    assert run.status == 0, run.message
    assert np.isfinite(run.q).all()
    assert max(values.max() for values in run.residuals().values()) <= residual


# ------------------------------------------------------------------------------------------------------- scales


@pytest.mark.parametrize("radius", [1e-3, 1e-1, 1e1, 1e3])
@pytest.mark.parametrize("mass", [1e-6, 1e6])
def test_motion_scales_with_size_and_mass(radius, mass):
    """Lengths in radii and times in sqrt(r / g): the same motion for a coin's edge and for a Ferris wheel, any mass."""
    runs = []
    for r, m in ((0.5, 1.0), (radius, mass)):
        unit = math.sqrt(r / G)
        v = np.array([0.0, 0.0, 0.0, 0.4, 0.3, 2.5]) / unit
        scene = disk(r, m, pc.NoSlip())
        state = scene.initial_state(leaning(r, 1.1), v)
        run = pc.simulate(
            scene,
            state,
            10.0 * unit,
            rtol=1e-11,
            atol=1e-13 * min(r, 1.0),
            t_eval=np.linspace(0.0, 10.0, 21) * unit,
        )
        assert_sound(run)
        track = run.contacts["c"]
        runs.append((run.q[:, :3] / r, run.q[:, 3:], run.v[:, 3:] * unit, track.force / (m * G)))
    for found, expected in zip(runs[1], runs[0]):
        assert np.abs(found - expected).max() <= 1e-7


@pytest.mark.parametrize("ratio", [1e-6, 1e6])
def test_mass_ratio(ratio):
    """A bead on a heavy or light hoop that turns freely about its vertical diameter: energy and momentum are kept."""
    bead, radius = 0.2, 0.4
    scene, moment = bead_on_hoop(ratio)
    q = np.array([0.0, radius * math.sin(1.0), 0.0, -radius * math.cos(1.0)])
    rate = 3.0
    state = scene.initial_state(q, np.array([rate, 0.0, rate * q[1], 0.0]))
    run = pc.simulate(scene, state, 3.0, rtol=1e-11, atol=1e-13, t_eval=np.linspace(0.0, 3.0, 31))
    assert_sound(run)
    energy = run.energies().total
    assert np.abs(energy - energy[0]).max() <= 1e-9 * max(np.abs(energy).max(), 1.0)
    momentum = moment * run.v[:, 0] + bead * (run.q[:, 1] * run.v[:, 2] - run.q[:, 2] * run.v[:, 1])
    # a light hoop's own rate is found from a momentum of which it has a millionth
    assert np.abs(momentum / momentum[0] - 1.0).max() <= 1e-9


# ------------------------------------------------------------------------------------------------------- geometry


def test_nearly_flat_disk():
    """A coin that wobbles down onto its face bounces off the singular position at lean angles of a degree, with many
    times its weight, and keeps its energy."""
    radius = 0.5
    scene = disk(radius, 1.0, pc.NoSlip())
    state = scene.initial_state(leaning(radius, 0.2), np.array([0.0, 0.0, 0.0, 0.05, 0.0, 0.02]))
    run = pc.simulate(scene, state, 3.0, rtol=1e-11, atol=1e-13)
    assert run.status == 0, run.message
    energy = run.energies().total
    assert np.abs(energy / energy[0] - 1.0).max() <= 1e-7
    lean = np.array([math.acos(abs(pin.Quaternion(q[3:]).matrix()[2, 2])) for q in run.q])
    assert lean.min() < 0.03
    assert run.contacts["c"].normal_force.max() > 20.0 * G


def test_ball_in_almost_its_own_bowl():
    """Radii that differ by a thousandth: location parameters run a thousand times faster than the ball moves."""
    radius, gap, amplitude = 0.5, 5e-4, 0.6
    scene = ball_in_bowl(radius, gap, pc.NoSlip())
    q = np.array([gap * math.sin(amplitude), 0.0, -gap * math.cos(amplitude), 0.0, 0.0, 0.0, 1.0])
    state = scene.initial_state(q, np.zeros(6))
    period = 2.0 * math.pi * math.sqrt(1.4 * gap / G)
    run = pc.simulate(scene, state, 3.0 * period, rtol=1e-10, atol=1e-14, t_eval=np.linspace(0.0, 3.0 * period, 61))
    assert_sound(run)
    energy = run.energies().total
    assert np.abs(energy - energy[0]).max() <= 1e-8 * G * gap
    distance = np.linalg.norm(run.q[:, :3], axis=1)
    np.testing.assert_allclose(distance, gap, rtol=0.0, atol=1e-14)
    assert run.q[:, 0].min() == pytest.approx(-gap * math.sin(amplitude), rel=1e-2)


@pytest.mark.parametrize("angle", [1e-1, 1e-3])
def test_nearly_parallel_rods(angle):
    """Two straight rods that cross at a small angle: one slides down the other as a block on an incline.

    The position is unstable: an offset y moves the contact by y / angle, a tilt turns the normal by tilt / angle, and
    both grow at the rate (N / (angle sqrt(m I)))^(1/2). The run is as long as leaves ten of these.
    """
    slope, moment = 0.3, 0.1
    scene = crossed_rods(angle, slope, moment)
    q = np.array([0.0, 0.0, 0.0, *pin.Quaternion(pin.utils.rotate("y", slope)).coeffs()])
    state = scene.initial_state(q, np.zeros(6))
    duration = 10.0 / math.sqrt(G * math.cos(slope) / (angle * math.sqrt(moment)))
    times = np.linspace(0.0, duration, 11)
    run = pc.simulate(scene, state, duration, rtol=1e-11, atol=1e-13, t_eval=times)
    assert_sound(run)
    path = 0.5 * G * math.sin(slope) * times**2
    expected = path[:, None] * np.array([math.cos(slope), 0.0, -math.sin(slope)])
    assert np.abs(run.q[:, :3] - expected).max() <= 1e-10


def test_disk_that_falls_flat_ends_the_run():
    """A disk dropped on its face from a small angle without spin reaches the position in which its whole rim touches: a
    typed end of the run at that time, with everything before it."""
    radius = 0.5
    scene = disk(radius, 1.0, pc.NoSlip())
    state = scene.initial_state(leaning(radius, 0.5), np.zeros(6))
    run = pc.simulate(scene, state, 5.0, rtol=1e-9, atol=1e-11)
    assert run.status < 0
    assert "'c'" in run.message
    assert [event.kind for event in run.events] == ["singular"]
    # it turns about its lowest point, rate^2 = 8/5 g / r (sin(start) - sin(lean)), down to lean = 0
    time, _ = quad(lambda lean: 1.0 / math.sqrt(1.6 * G / radius * (math.sin(0.5) - math.sin(lean))), 0.0, 0.5)
    assert run.events[0].time == pytest.approx(time, abs=1e-6)
    assert np.isfinite(run.q).all()


# ------------------------------------------------------------------------------------------------------- friction


@pytest.mark.parametrize("mu", [0.0, 1e-6, 0.05, 0.4, 0.8])
def test_any_friction_coefficient(mu):
    """From slipping to rolling and back: forces inside the cone, energy only lost, the same motion as its own energy
    account."""
    radius = 0.3
    scene = disk(radius, 1.0, pc.Coulomb(mu))
    state = scene.initial_state(leaning(radius, 1.2), np.array([0.3, -0.1, 0.2, 0.1, 0.4, 6.0]))
    run = pc.simulate(scene, state, 1.0, rtol=1e-9, atol=1e-11, energies=True, max_steps=5000)
    assert_sound(run)
    track, energies = run.contacts["c"], run.energies()
    assert (track.tangential_force <= mu * track.normal_force + 1e-9).all()
    assert np.abs(energies.balance).max() <= 1e-7
    assert np.diff(energies.friction_work).max(initial=0.0) <= 1e-8


def test_painleve_rod_says_so():
    """A rod that is pushed into the ground at mu = 2 has no consistent force: the run ends and gives that reason."""
    mu, lean = 2.0, 1.0
    c, s = math.cos(lean), math.sin(lean)
    # the tip moves away from the side to which the rod leans; without a force it would go into the ground
    assert 1.0 + 3.0 * c * c - 3.0 * mu * s * c < 0.0
    scene = rod_on_ground(mu)
    run = pc.simulate(scene, rod_state(scene, lean, -1.5), 1.0)
    assert run.status < 0
    assert "Painleve" in run.message
    assert "tip/ground" in run.message


# ------------------------------------------------------------------------------------------------------- states


def test_inconsistent_start_is_corrected_and_reported():
    """Off by a few millimetres and centimetres a second: projected in the mass metric, which moves the light body."""
    model = pin.Model()
    for name, mass in (("heavy", 1e6), ("light", 1.0)):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), 0.1 * mass * np.eye(3)), pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    a, b = scene.add_contour("a", pc.Sphere(0.5), "heavy"), scene.add_contour("b", pc.Sphere(0.3), "light")
    scene.add_contact("a/b", b, a)
    direction = np.array([0.6, 0.0, 0.8])
    q = np.concatenate([np.zeros(6), [1.0], (0.8 + 4e-3) * direction, [0.0, 0.0, 0.0, 1.0]])
    v = np.zeros(12)
    v[6:9] = 0.05 * direction
    state = scene.initial_state(q, v)
    assert state.correction.gaps["a/b"] == pytest.approx(4e-3, rel=1e-9)
    assert state.correction.slips["a/b"][0] == pytest.approx(0.05, abs=1e-9) or state.correction.slips["a/b"][
        0
    ] == pytest.approx(-0.05, abs=1e-9)
    assert np.abs(state.q[:7] - q[:7]).max() <= 1e-8
    np.testing.assert_allclose(state.q[7:10], 0.8 * direction, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(state.v[6:9], 0.0, atol=1e-7)


@pytest.mark.parametrize("start", [0.0, 1e6])
def test_late_times(start):
    """A clock that has been running for eleven days costs digits of time, not of the motion."""
    scene = disk(0.5, 1.0, pc.NoSlip())
    v = np.array([0.0, 0.0, 0.0, 0.4, 0.3, 8.0])
    state = scene.initial_state(leaning(0.5, 1.1), v, t=start)
    run = pc.simulate(scene, state, 1.0, rtol=1e-10, atol=1e-12, t_eval=start + np.linspace(0.0, 1.0, 11))
    assert_sound(run)
    reference = pc.simulate(
        scene, scene.initial_state(leaning(0.5, 1.1), v), 1.0, rtol=1e-10, atol=1e-12, t_eval=np.linspace(0.0, 1.0, 11)
    )
    # times are rounded to 1e-10 s there
    assert np.abs(run.q - reference.q).max() <= 1e-8
