"""Bodies that moving contours press into what cannot give way: the run ends there, and its message says so."""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

RADIUS, ROOM, SPEED = 0.1, 0.2, 0.2


def pressed_ball(seed: int, by_stop: bool) -> tuple[pc.Scene, pc.State]:
    """A ball on a slide, carried by a plate towards another plate, or towards the end of its way, at a random slant."""
    rng = np.random.default_rng(seed)
    turned = pin.SE3(pin.Quaternion(*rng.normal(size=4)).normalized().matrix(), rng.normal(size=3))
    model = pin.Model()
    model.gravity.linear = turned.rotation @ np.array([0.0, 0.0, -9.81])
    reach = np.array([ROOM if by_stop else 9.0])
    joint = model.addJoint(0, pin.JointModelPZ(), turned, "slide", 9.0 * reach, 9.0 * reach, -reach, reach)
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, RADIUS), pin.SE3.Identity())
    model.addBodyFrame("ball", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    ball = scene.add_contour("ball", pc.Sphere(RADIUS), frame="ball")

    def rises(t: float) -> pin.SE3:
        return pin.SE3(np.eye(3), np.array([0.0, 0.0, SPEED * t]))

    below = turned * pin.SE3(np.eye(3), np.array([0.0, 0.0, -RADIUS]))
    plate = scene.add_contour("plate", pc.Plane(), placement=below, motion=pc.CallableMotion(rises, (-1.0, 3.0)))
    scene.add_contact("below", plate, ball, friction=pc.Coulomb(0.3))
    if not by_stop:
        upside = pin.SE3(pin.utils.rotate("x", np.pi), np.array([0.0, 0.0, ROOM + RADIUS]))
        ceiling = scene.add_contour("ceiling", pc.Plane(), placement=turned * upside)
        scene.add_contact("above", ceiling, ball, friction=pc.Coulomb(0.3))
    return scene, scene.initial_state([0.0], free=[] if by_stop else ["above"])


@pytest.mark.parametrize("by_stop", [False, True])
@pytest.mark.parametrize("options", [{}, {"method": "Moreau", "step": 1e-3}, {"fallback": "Moreau"}])
def test_the_message_says_what_crushes(options, by_stop):
    """At t = ROOM / SPEED = 1 s; time stepping knows an impact to its step."""
    for seed in (int(by_stop),):
        run = pc.simulate(*pressed_ball(seed, by_stop), 2.0, **options)
        assert run.status == -4 and run.t[-1] == pytest.approx(ROOM / SPEED, abs=2e-3)
        assert "crushed" in run.message and "contact 'below'" in run.message
        assert ("joint 'slide'" if by_stop else "contact 'above'") in run.message
        # another method does not go on, either
        assert "goes on" not in run.message and "Painleve" not in run.message
