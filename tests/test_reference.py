"""Every reference scene, integrated tightly, against its stored trajectory.

At rtol = 1e-10 the global error of these runs is between 1e-11 and 1e-9: the bounds leave a factor of ten and are far
below anything a wrong term, a wrong frame or an event located to less than the method's order would leave.
"""

import math

import numpy as np
import pytest
from reference import (
    KINDS,
    NAMES,
    NATIVE_NAMES,
    body_motion,
    farthest,
    largest_angle,
    path_extent,
    reference,
    simulated,
)

MOTION = 1e-8
FORCE = 1e-6
RESIDUAL = 1e-12

# s: surfaces of which formulas alone are known are searched for second places in every step, which native ones are not
UNTIL = {"ball_in_bowl_3d_roll": 0.5, "ellipsoid_on_plane_roll": 1.0, "ellipsoid_in_ellipsoid_slip_then_roll": 0.8}
CASES = [(name, False) for name in NAMES] + [(name, True) for name in NATIVE_NAMES]


def tracks(run, key):
    """One attribute of all contacts' tracks, (n, contacts, ...), in the scene's order."""
    return np.stack([getattr(run.contacts[name], key) for name in run.scene.contacts], axis=1)


def check_motion(name, run, expected):
    motion = body_motion(name, run)
    assert farthest(motion.p, expected["p"]) <= MOTION * path_extent(expected["p"])
    assert largest_angle(motion.R, expected["R"]) <= MOTION
    for found, key in ((motion.v, "v"), (motion.w, "w")):
        scale = max(float(np.linalg.norm(expected[key], axis=-1).max()), 1.0)
        # velocities lose a factor of the highest frequency, at most some 20 rad/s here
        assert farthest(found, expected[key]) <= 10.0 * MOTION * scale, key


def check_forces_and_contact_points(run, expected):
    rows = expected.away_from_events()
    scale = float(np.linalg.norm(expected["force"], axis=-1).max())
    assert farthest(tracks(run, "force")[rows], expected["force"][rows]) <= FORCE * scale
    closed = expected["mode"] >= 0
    found = tracks(run, "point")
    assert farthest(found[closed], expected["point"][closed]) <= MOTION * max(path_extent(expected["point"]), 0.1)


def check_modes_and_events(run, expected):
    rows = expected.away_from_events()
    np.testing.assert_array_equal(tracks(run, "mode")[rows], expected["mode"][rows])
    found = [(event.kind, event.contact) for event in run.events]
    assert found == [(KINDS[event["what"]], str(event["contact"])) for event in expected.events]
    for event, wanted in zip(run.events, expected.events, strict=True):
        assert abs(event.time - wanted["t"]) <= MOTION


def check_location_parameters(run, expected):
    column = 0
    for i, contact in enumerate(run.scene.contacts.values()):
        found = run.contacts[contact.name].location
        k = found.shape[1]
        difference = found - expected["loc"][:, column : column + k]
        column += k
        periodic = [*contact.body1.contour.periodic, *contact.body2.contour.periodic]
        difference -= np.where(periodic, np.round(difference / (2.0 * math.pi)) * 2.0 * math.pi, 0.0)
        closed = expected["mode"][:, i] >= 0
        # parameters are lengths or angles of contours of some decimetres
        assert np.abs(difference[closed]).max() <= MOTION


def check_frames_and_multipliers(run, expected):
    rows = expected.away_from_events()
    scale = float(np.linalg.norm(expected["force"], axis=-1).max())
    for i, contact in enumerate(run.scene.contacts.values()):
        track = run.contacts[contact.name]
        closed = (expected["mode"][:, i] >= 0) & rows
        frame, wanted = track.frame[closed], expected["frame"][closed, i]
        if contact.pattern.name == "P-3C":
            # both normals of a spatial curve are a choice; the tangent is not
            frame, wanted = frame[..., :1], wanted[..., :1]
            dual, wanted_dual = track.multipliers[closed, :1], expected["force_dual"][closed, i, :1]
            in_plane = np.linalg.norm(track.multipliers[closed, 1:], axis=1)
            normal = np.linalg.norm(expected["force_dual"][closed, i, 1:], axis=1)
            assert np.abs(in_plane - normal).max() <= FORCE * scale
        else:
            dual, wanted_dual = track.multipliers[closed], expected["force_dual"][closed, i]
        assert np.abs(frame - wanted).max() <= 10.0 * MOTION
        assert np.abs(dual - wanted_dual).max() <= FORCE * scale
        slip = track.slip_velocity[closed] - expected["slip"][closed, i]
        assert np.abs(slip).max() <= 10.0 * MOTION * max(1.0, float(np.abs(expected["v"]).max()))


@pytest.mark.parametrize(
    ("name", "native"), CASES, ids=[f"{name}-{'native' if native else 'expressions'}" for name, native in CASES]
)
def test_run(name, native):
    until = math.inf if native else UNTIL.get(name, math.inf)
    run, expected = simulated(name, native, until=until), reference(name, until)
    assert run.status == 0, run.message
    np.testing.assert_array_equal(run.t, expected["t"])
    check_motion(name, run, expected)
    check_forces_and_contact_points(run, expected)
    check_modes_and_events(run, expected)
    for kind, values in run.residuals().items():
        assert values.max() <= RESIDUAL, kind
    if not native:
        check_location_parameters(run, expected)
        check_frames_and_multipliers(run, expected)


@pytest.mark.parametrize("name", NATIVE_NAMES)
def test_sharp98_follows(name):
    """The pair of order 9: the same bounds, and the same events at the same times."""
    run, expected = simulated(name, True, method="Sharp98"), reference(name)
    assert run.status == 0, run.message
    check_motion(name, run, expected)
    assert [event.kind for event in run.events] == [KINDS[event["what"]] for event in expected.events]
    for event, wanted in zip(run.events, expected.events, strict=True):
        assert abs(event.time - wanted["t"]) <= MOTION
    assert max(values.max() for values in run.residuals().values()) <= RESIDUAL
