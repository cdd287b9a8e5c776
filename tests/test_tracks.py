"""Rates of contact coordinates along runs: differences of the coordinates themselves, and closed forms."""

import numpy as np
import pinocchio as pin
import pytest
from random_contacts import EIGHTH_ORDER, START, RandomContact
from test_inverse import SHAPES

import pincontact as pc
from pincontact.tracks import evaluate_tracks

RADIUS, SPEED = 0.3, 0.6
STEP = 1e-3
# s; truncation (rates STEP)^8 is below round-off; integrated at 1e-12, of which differences keep 1e-12 / STEP.
DIFFERENCES = 1e-8
EXACT = {"rtol": 1e-12, "atol": 1e-13}


def assert_rates_are_differences(location, rates):
    """At every output that has four others on both sides, all of them STEP apart."""
    windows = np.lib.stride_tricks.sliding_window_view(location, 9, axis=0)
    differences, rates = windows @ (EIGHTH_ORDER / STEP), rates[4:-4]
    assert rates.shape == differences.shape and np.abs(rates).max() > 0.1
    np.testing.assert_allclose(rates, differences, rtol=0.0, atol=DIFFERENCES * (1.0 + np.abs(rates).max()))


def wheel(friction):
    scene = pc.Scene.from_urdf("urdf/disk.urdf", floating_base=True)
    rim, floor = scene.add_contour("rim", pc.Circle(RADIUS), "disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", rim, floor, friction=friction)
    return scene


@pytest.fixture(autouse=True)
def at_the_root(monkeypatch, request):
    monkeypatch.chdir(request.config.rootpath)


def test_rolling_disk():
    """Tilted, precessing; 40 ms in the middle of a run, which does not begin at rest."""
    scene = wheel(pc.NoSlip())
    tilt = 1.2
    omega = np.array([0.3, 0.5, 5.0])
    q = [0.0, 0.0, RADIUS * np.sin(tilt), *pin.Quaternion(pin.utils.rotate("y", tilt)).coeffs()]
    state = scene.initial_state(q, [*-np.cross(omega, [RADIUS, 0.0, 0.0]), *omega])
    times = np.r_[0.0, 0.3 + STEP * np.arange(41)]
    track = pc.simulate(scene, state, 0.35, t_eval=times, **EXACT).contacts["c"]
    rates = track.rates
    assert_rates_are_differences(track.location[1:], rates[1:])
    # without slip both traces are of one length (below Eq. 56)
    np.testing.assert_allclose(RADIUS * np.abs(rates[:, 0]), np.hypot(rates[:, 1], rates[:, 2]), rtol=1e-10)


def test_upright_wheel_that_slides_or_falls():
    """Its point of contact goes along with the centre, and turns back in the rim; in the air it is the nearest one."""
    scene = wheel(None)
    upright = pin.Quaternion(pin.utils.rotate("x", 0.5 * np.pi)).coeffs()
    for height, free, modes in ((0.0, (), 0), (0.05, ("c",), -1)):
        state = scene.initial_state([0, 0, RADIUS + height, *upright], [SPEED, 0, 0, 0, 0, -3.0], free=free)
        track = pc.simulate(scene, state, 0.05, t_eval=[0.0, 0.02, 0.05]).contacts["c"]
        assert (track.mode == modes).all()
        np.testing.assert_allclose(np.abs(track.rates), [[3.0, SPEED, 0.0]] * 3, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("pattern", ["P-S", "3C-3C", "S-S"])
def test_random_contacts(pattern, reverse):
    """Between two bodies that rub on each other, in the paper's order whichever the user names first."""
    contact = RandomContact(pattern, SHAPES[pattern], seed=2, friction=pc.Coulomb(0.3), reverse=reverse)
    times = START + STEP * np.arange(21)
    run = pc.simulate(contact.scene, contact.state, 0.021, t_eval=times, **EXACT)
    assert run.success and not run.events
    track = run.contacts["c"]
    assert_rates_are_differences(track.location, track.rates)


def test_open_contacts_without_nearest_points():
    """In the middle of a sphere no point of it is the nearest: there are no rates, and no equations."""
    model, joint = pin.Model(), 0
    for name, kind in (("x", pin.JointModelPX), ("y", pin.JointModelPY), ("z", pin.JointModelPZ)):
        joint = model.addJoint(joint, kind(), pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    model.gravity.linear = np.zeros(3)
    scene = pc.Scene(model)
    tip, shell = scene.add_contour("tip", pc.Point(), "body"), scene.add_contour("shell", pc.Sphere(0.5))
    scene.add_contact("c", tip, shell, side=-1)
    state = scene.initial_state([0.125, 0.0, 0.0], [-1.0, 0.0, 0.0], free=["c"])
    run = pc.simulate(scene, state, 0.25, t_eval=[0.0, 0.125, 0.25])
    np.testing.assert_array_equal(np.isnan(run.contacts["c"].rates), [[False] * 2, [True] * 2, [False] * 2])
    assert pc.analyze(scene, run.state(0))["c"].gap == pytest.approx(0.375)
    with pytest.raises(pc.SingularContactError, match="'c' is open and has no nearest points"):
        pc.analyze(scene, run.state(1))


@pytest.mark.parametrize("method", ["DOP853", "Moreau"])
@pytest.mark.parametrize("outputs", [None, [0.0, 0.1]])
def test_what_a_control_that_fails_at_once_leaves(method, outputs):
    """The contact is where it is, and its force is not known; an open one has none."""
    scene = wheel(pc.Coulomb(0.5))
    upright = pin.Quaternion(pin.utils.rotate("x", 0.5 * np.pi)).coeffs()
    for height, free, force in ((0.0, (), np.nan), (0.05, ("c",), 0.0)):
        state = scene.initial_state([0.2, 0, RADIUS + height, *upright], [SPEED, 0, 0, 0, 0, 0], free=free)
        options = {"method": method, "t_eval": outputs}
        run = pc.simulate(scene, state, 0.2, control=lambda t, q, v: np.full(6, np.nan), **options)
        track = run.contacts["c"]
        assert run.status == -5 and run.t.tolist() == [0.0]
        # round-off of the rotation
        np.testing.assert_allclose(track.point, [[0.2, 0.0, 0.0]], rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(track.gap, height, rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(np.abs(track.slip_velocity), [[SPEED, 0.0, 0.0]], rtol=0.0, atol=1e-15)
        assert (track.mode[0] >= 0) == (height == 0.0)
        np.testing.assert_array_equal(track.force, [[force] * 3])
        np.testing.assert_array_equal(track.normal_force, force)
        assert ("not known" in repr(track)) == (height == 0.0)
        assert max(run.residuals()["GC"]) < 1e-15
        # where the contact is not known either, its mode is
        lost, _ = evaluate_tracks(scene, run.t, run.q * np.nan, run.v, run._recorded)
        np.testing.assert_array_equal(lost["c"].mode, track.mode)
        np.testing.assert_array_equal(np.isnan(lost["c"].point), [[True] * 3])
        np.testing.assert_array_equal(lost["c"].force, [[force] * 3])
