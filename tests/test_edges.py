"""Contours that end: the contact point reaches the end at a time known in closed form."""

import math

import numpy as np
import pinocchio as pin
import pytest
from shared import one_body

import pincontact as pc

SLOPE = 0.5
GRAVITY = 9.81


def bead(contour, placement=None, **options):
    """A point mass of 1 kg that slides on a contour of the world without friction."""
    scene = pc.Scene(one_body(pin.JointModelTranslation(), pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), "bead"))
    point = scene.add_contour("bead", pc.Point(), frame="bead")
    ground = scene.add_contour("ground", contour, placement=placement)
    scene.add_contact("contact", point, ground, **options)
    return scene


def inclined():
    return pin.SE3(pin.utils.rotate("y", SLOPE), np.zeros(3))


def time_down(length):
    """Time from rest over a length of the incline without friction."""
    return math.sqrt(2.0 * length / (GRAVITY * math.sin(SLOPE)))


def test_bead_reaches_the_end_of_its_wire():
    scene = bead(pc.Line((-1.0, 1.0)), inclined())
    run = pc.simulate(scene, scene.initial_state(np.zeros(3)), 2.0, rtol=1e-10, atol=1e-12)
    assert run.status < 0
    assert "end of a contour" in run.message
    (event,) = run.events
    assert (event.kind, event.contact) == ("edge", "contact")
    # event times are refined to the accuracy of the state, a few times rtol
    assert event.time == pytest.approx(time_down(1.0), abs=1e-9)
    assert run.t[-1] == event.time
    assert run.contacts["contact"].location[-1] == pytest.approx(1.0, abs=1e-9)


def test_point_leaves_a_patch_and_falls():
    patch = pc.Plane(((-1.0, 1.0), (-1.0, 1.0)))
    scene = bead(patch, inclined())
    times = np.linspace(0.0, 1.2, 25)
    run = pc.simulate(scene, scene.initial_state(np.zeros(3)), 1.2, rtol=1e-10, atol=1e-12, t_eval=times)
    assert run.status == 0
    (event,) = run.events
    leaving = time_down(1.0)
    assert (event.kind, event.time) == ("edge", pytest.approx(leaving, abs=1e-9))
    mode = run.contacts["contact"].mode
    assert set(mode[times < leaving]) == {0}
    assert set(mode[times > leaving]) == {-1}
    # free fall from the end, with the speed reached there: no force, although the plane would go on
    down = np.array([math.cos(SLOPE), 0.0, -math.sin(SLOPE)])
    flight = times[-1] - leaving
    expected = down + GRAVITY * math.sin(SLOPE) * leaving * down * flight + np.array([0, 0, -0.5 * GRAVITY]) * flight**2
    assert run.q[-1] == pytest.approx(expected, abs=1e-8)
    assert run.contacts["contact"].gap[-1] < 0.0


def test_a_pole_is_no_end():
    """A ball that rolls over the poles of its own charts meets no event."""
    scene = pc.Scene(one_body(pin.JointModelFreeFlyer(), pin.Inertia(1.0, np.zeros(3), 0.004 * np.eye(3)), "ball"))
    ball = scene.add_contour("ball", pc.Sphere(0.1), frame="ball")
    floor = scene.add_contour("floor", pc.Plane())
    scene.add_contact("contact", ball, floor, friction=pc.NoSlip())
    state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [1.0, 0, 0, 0, 10.0, 0])
    run = pc.simulate(scene, state, 5.0)
    assert run.status == 0
    assert run.events == []
    assert run.q[-1, :3] == pytest.approx([5.0, 0.0, 0.1], abs=1e-7)
    assert set(run.contacts["contact"].charts[:, 0]) == {0, 1}


@pytest.mark.parametrize("shape", ["cycloid", "cone"])
def test_cusps_and_apexes_are_ends(shape):
    """A bead runs into the cusp of a cycloid, or into a cone's apex, where the location's rates grow without bound: the
    run ends with the edge that it is, on the constraints."""
    model = one_body(pin.JointModelTranslation(), pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), "bead")
    model.gravity.linear = np.zeros(3)
    scene = pc.Scene(model)
    contour, u, along, sign, pattern = {
        "cycloid": (pc.Cycloid(0.5), [1.0], 1, 1.0, "P-3C"),
        "cone": (pc.Cone(0.5), [0.3, 0.4], 2, -1.0, None),
    }[shape]
    bead, wall = scene.add_contour("bead", pc.Point(), "bead"), scene.add_contour("wall", contour)
    scene.add_contact("c", bead, wall, bilateral=True, pattern=pattern)
    tangent = contour.evaluate(u)[along]
    state = scene.initial_state(contour.point(u), sign * tangent / np.linalg.norm(tangent))
    run = pc.simulate(scene, state, 5.0)
    assert run.status == -8, run.message
    assert run.events[-1].kind == "edge"
    # at 1 m/s: the arc of the cycloid from u to its cusp, of which 1e-9 m are left; the line to the cone's apex, of
    # which 1e-6 m are left
    way = 4.0 * 0.5 * (1.0 - math.sin(0.5)) if shape == "cycloid" else 0.4
    assert run.t[-1] == pytest.approx(way, abs=2e-6)
    # close to the cusp a parameter is known to the square root of rounding only
    assert max(values.max() for values in run.residuals().values()) < 1e-10
