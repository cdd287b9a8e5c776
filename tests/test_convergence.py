"""Observed orders of convergence, and errors that keep falling with the tolerance across mode changes."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from reference import body_motion, build, farthest, largest_angle, path_extent, reference, simulated

import pincontact as pc


def at_end(scene, state, duration, **options):
    run = pc.simulate(scene, state, duration, **options)
    assert run.status == 0, run.message
    return run.q[-1], run.v[-1]


def observed_order(name, duration, method, steps):
    """Slope of log error over log step between constant-step runs, against a run at round-off."""
    scene, state = build(name, native=True)
    q, v = at_end(scene, state, duration, rtol=1e-13, atol=1e-15)
    errors = []
    for n in steps:
        q_n, v_n = at_end(scene, state, duration, method=method, fixed_step=duration / n)
        errors.append(max(np.abs(pin.difference(scene.model, q, q_n)).max(), np.abs(v_n - v).max()))
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0], errors


# Step numbers at which the leading term of the error rules and round-off (some 1e-13) does not: errors of 1e-5 to
# 1e-12. Projection on the constraints after every step must not cost order. In the circular bowl the leading term of
# RK45 vanishes.
@pytest.mark.parametrize(
    ("name", "duration", "method", "order", "steps"),
    [
        ("disk_plane_slip_then_roll", 0.8, "DOP853", 8.0, (32, 40, 48, 56)),
        ("disk_plane_slip_then_roll", 0.8, "RK45", 5.0, (96, 128, 192, 256)),
        ("disk_plane_roll", 1.0, "RK45", 5.0, (48, 64, 96, 128, 256)),
        ("disk_plane_slip_then_roll", 0.8, "RK23", 3.0, (192, 256, 384, 512)),
        ("disk_plane_roll", 1.0, "RK23", 3.0, (96, 128, 192, 256, 384)),
        ("ball_in_bowl_3d_roll", 0.8, "DOP853", 8.0, (6, 8, 10, 12, 16)),
        ("disk_in_circular_bowl_slip_then_roll", 0.25, "RK45", 6.0, (12, 16, 24, 32, 48)),
    ],
)
def test_order_of_smooth_motion(name, duration, method, order, steps):
    found, errors = observed_order(name, duration, method, steps)
    assert abs(found - order) <= 0.3, (found, errors)


def test_order_of_rolling_disk():
    """Rolling, the eighth-order term of DOP853 is small: the slope is between 8 and 9, never below 8."""
    found, errors = observed_order("disk_plane_roll", 3.0, "DOP853", (28, 40, 56, 80, 112))
    assert 7.7 <= found <= 9.0, (found, errors)


@pytest.mark.parametrize(
    ("name", "duration", "steps"),
    [
        ("disk_plane_slip_then_roll", 0.8, (16, 20, 24, 28)),
        ("disk_plane_roll", 1.0, (10, 12, 16, 20)),
        ("ball_in_bowl_3d_roll", 0.8, (6, 7, 8, 10, 12)),
    ],
)
def test_order_of_sharp98(name, duration, steps):
    """Errors of 1e-8 to 1e-12; at the longer steps those of the tenth order still count."""
    found, errors = observed_order(name, duration, "Sharp98", steps)
    assert 8.7 <= found <= 9.8, (found, errors)


@pytest.mark.parametrize(("method", "order"), [("DOP853", 7.0), ("RK45", 4.0), ("Sharp98", 8.0)])
def test_order_of_outputs_between_steps(method, order):
    """The dense output is of one order less than the steps; its points are projected on the constraints too.

    That of Sharp98 is of order 6 only, but with errors of the next orders so small that they do not show.
    """
    scene, state = build("disk_plane_roll", native=True)
    duration = 1.0
    times = np.linspace(0.0, duration, 101)[1:-1] + 1.2345e-3
    exact = pc.simulate(scene, state, duration, rtol=1e-13, atol=1e-15, t_eval=times)
    errors = []
    counts = np.array((8, 12, 16, 24) if method in ("DOP853", "Sharp98") else (32, 48, 64, 96))
    for n in counts:
        run = pc.simulate(scene, state, duration, method=method, fixed_step=duration / n, t_eval=times)
        errors.append(max(np.abs(pin.difference(scene.model, a, b)).max() for a, b in zip(exact.q, run.q)))
        assert max(values.max() for values in run.residuals().values()) <= 1e-12
    found = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert found >= order - 0.3, (found, errors)


WITH_EVENTS = (
    "disk_plane_stick_to_slip",
    "disk_plane_slip_then_roll",
    "ring_on_rod_slip_then_stick",
    "disk_in_circular_bowl_slip_then_roll",
    "ellipse_bead_friction",
    "ellipsoid_in_ellipsoid_slip_then_roll",
    "point_in_ellipsoid_slip",
)
TOLERANCES = (1e-5, 1e-7, 1e-9)


@pytest.mark.parametrize(
    ("name", "method"),
    [(name, method) for method in ("DOP853", "Sharp98") for name in WITH_EVENTS]
    + [(name, "RK45") for name in WITH_EVENTS[:4]],
)
def test_error_falls_with_the_tolerance_across_events(name, method):
    """An event located or crossed to less than the method's order would put a floor under the error."""
    expected = reference(name)
    motion_errors, event_errors = [], []
    for rtol in TOLERANCES:
        scene, state = build(name, native=True)
        times = expected["t"]
        run = pc.simulate(scene, state, float(times[-1]), rtol=rtol, atol=1e-2 * rtol, t_eval=times, method=method)
        assert run.status == 0, run.message
        motion = body_motion(name, run)
        position = farthest(motion.p, expected["p"]) / path_extent(expected["p"])
        motion_errors.append(max(position, largest_angle(motion.R, expected["R"])))
        assert len(run.events) == len(expected.events)
        event_errors.append(max(abs(a.time - b["t"]) for a, b in zip(run.events, expected.events, strict=True)))
    for errors in (motion_errors, event_errors):
        # The error goes with the tolerance to the power p / (p + 1): 5/6 and 8/9. Single errors may be lucky, so the
        # slope over all four decades decides, a tenth below the lesser of the two; errors that are a fifth of every
        # tolerance have no floor to show.
        assert errors[2] < errors[1] < errors[0], errors
        slope = np.log10(errors[0] / errors[2]) / np.log10(TOLERANCES[0] / TOLERANCES[-1])
        assert slope > 0.73 or all(error < 0.2 * rtol for error, rtol in zip(errors, TOLERANCES)), errors
    assert motion_errors[-1] <= 50.0 * TOLERANCES[-1]


@pytest.mark.parametrize("rtol", [1e-5, 1e-7, 1e-9])
@pytest.mark.parametrize(
    "name",
    [
        "ball_on_plane_through_pole",
        "disk_plane_slip_then_roll",
        "disk_plane_stick_to_slip",
        "ellipse_on_line_roll",
        "rigid_on_twisted_cubic_frictionless",
    ],
)
def test_errors_of_sharp98_stay_at_the_tolerance(name, rtol):
    """Its estimate is three orders below it, and scaled: on the references with the largest errors, which are twice
    rtol at the coarsest tolerance it takes, then half of it, and on one that runs over a pole."""
    run, expected = simulated(name, True, rtol, "Sharp98"), reference(name)
    assert run.status == 0, run.message
    motion = body_motion(name, run)
    position = farthest(motion.p, expected["p"]) / path_extent(expected["p"])
    assert max(position, largest_angle(motion.R, expected["R"])) <= (3.0 if rtol == 1e-5 else 1.0) * rtol


@pytest.mark.parametrize(("method", "rtol"), [("DOP853", 1e-4), ("RK45", 1e-4), ("RK45", 1e-5)])
def test_slip_that_grows_out_of_stick_is_not_cut_short(method, rtol):
    """Slow slip that gets faster is no slip that fails to end: at loose tolerances, too, it ends at its own time."""
    scene = pc.Scene.from_urdf(Path(__file__).parents[1] / "urdf" / "disk.urdf", floating_base=True)
    rim = scene.add_contour("rim", pc.Circle(0.3), frame="disk")
    scene.add_contact("contact", rim, scene.add_contour("floor", pc.Plane()), friction=pc.Coulomb(0.8))
    q = np.r_[0.0, 0.0, 0.3 * np.sin(1.2), pin.Quaternion(pin.utils.rotate("y", 1.2)).coeffs()]
    state = scene.initial_state(q, [0.0, 0.0, 0.0, 0.0, 0.0, 5.0])
    exact = pc.simulate(scene, state, 0.6, rtol=1e-11, atol=1e-13)
    run = pc.simulate(scene, state, 0.6, method=method, rtol=rtol, atol=1e-2 * rtol)
    assert [e.kind for e in run.events] == [e.kind for e in exact.events] == ["stick", "slip", "stick"]
    # velocities of up to 10 m/s are known to rtol; decelerations of 5 m/s^2 make times of that, and steps add up
    for found, expected in zip(run.events, exact.events):
        assert found.time == pytest.approx(expected.time, abs=10.0 * rtol)
