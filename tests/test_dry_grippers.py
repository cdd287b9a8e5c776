"""Grippers whose fingers have dry friction in their joints, and lift what stands on the floor.

Contacts slip where no forces within bounds hold them: the fingers' friction lets each grip with up to its motor's force
and that friction, so that an object which needs no more goes up with the slide that carries the fingers.
"""

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

G = 9.81
SLIDE, FINGER = 1.0, 0.1
HALF = np.array([0.02, 0.03, 0.04])
# the slide is balanced; its force takes over the box's weight and 2 % by then, and lifts on
LIFTED, TIME, LIFT = 0.204, 0.5, 1.02


class Gripper:
    """Two fingers on a slide, on both sides of a box on its four corners; grips: whether the motors alone would do."""

    def __init__(self, rng, grips, turned):
        self.mu, self.mass = rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.0)
        need = self.mass * (G + 0.3) / (2.0 * self.mu)
        self.motor = need * (rng.uniform(1.05, 2.0) if grips else rng.uniform(0.3, 0.9))
        dry = rng.uniform(1.0, 1.6, 2) * (0.3 if grips else (need - self.motor) / rng.uniform(0.3, 0.95))
        model = pin.Model()
        slide = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide")
        model.appendBodyToJoint(slide, pin.Inertia.FromBox(SLIDE, 0.1, 0.1, 0.1), pin.SE3.Identity())
        for i in range(2):
            place = pin.SE3(pin.utils.rotate("z", np.pi * i), np.zeros(3))
            finger = model.addJoint(slide, pin.JointModelPX(), place, f"finger_{i}")
            model.appendBodyToJoint(finger, pin.Inertia.FromBox(FINGER, 0.02, 0.02, 0.05), pin.SE3.Identity())
            model.addBodyFrame(f"finger_{i}", finger, pin.SE3.Identity(), 0)
        box = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
        model.appendBodyToJoint(box, pin.Inertia.FromBox(self.mass, *(2.0 * HALF)), pin.SE3.Identity())
        model.addBodyFrame("box", box, pin.SE3.Identity(), 0)
        limits = np.zeros(model.nv)
        limits[1:3] = dry
        model.upperDryFrictionLimit, model.lowerDryFrictionLimit = limits, -limits
        self.scene = scene = pc.Scene(model)
        floor, pairs = scene.add_contour("floor", pc.Plane()), {}
        for i, corner in enumerate(HALF * [[1, 1, -1], [1, -1, -1], [-1, 1, -1], [-1, -1, -1]]):
            place = pin.SE3(np.eye(3), corner)
            pairs[f"corner_{i}"] = scene.add_contour(f"corner_{i}", pc.Point(), "box", place), floor
        for i in range(2):
            face = pin.utils.rotate("z", np.pi * i) @ pin.utils.rotate("y", np.pi / 2)
            place = pin.SE3(face, HALF[0] * face[:, 2])
            pad = scene.add_contour(f"pad_{i}", pc.Sphere(0.01), f"finger_{i}")
            pairs[f"pad_{i}"] = pad, scene.add_contour(f"face_{i}", pc.Plane(), "box", place)
        for name in reversed(pairs) if turned else pairs:
            scene.add_contact(name, *pairs[name], friction=pc.Coulomb(self.mu))
        q = pin.neutral(model)
        q[:3] = HALF[2] + rng.uniform(-0.012, 0.012), HALF[0] + 0.01, HALF[0] + 0.01
        q[5] = HALF[2]
        self.start = scene.initial_state(q)

    def torques(self, t, q, v):
        tau = np.zeros(v.size)
        tau[0] = (SLIDE + 2.0 * FINGER + self.mass * min(LIFT, 5.0 * t)) * G
        tau[1:3] = -self.motor
        return tau


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("grips", [False, True])
@pytest.mark.parametrize(
    "options", [{}, {"method": "RK45"}, {"contact_solver": "proxqp"}, {"rtol": 1e-11, "atol": 1e-13}], ids=str
)
def test_what_they_can_hold_goes_up_with_them(options, grips, turned):
    rng = np.random.default_rng(51)
    for _ in range(4):
        gripper = Gripper(rng, grips, turned)
        run = pc.simulate(gripper.scene, gripper.start, TIME, control=gripper.torques, breakpoints=[LIFTED], **options)
        assert run.status == 0, run.message
        np.testing.assert_allclose(run.q[-1, 5] - run.q[0, 5], run.q[-1, 0] - run.q[0, 0], atol=1e-9)
        # the force is the weight at 0.2 s; then it grows for 4 ms, and the rest of the time it is constant
        whole, over = SLIDE + 2.0 * FINGER + gripper.mass, (LIFT - 1.0) * gripper.mass * G
        grows, rest = LIFTED - 0.2, TIME - LIFTED
        way = over / whole * (grows**2 / 6.0 + 0.5 * grows * rest + 0.5 * rest**2)
        np.testing.assert_allclose(run.q[-1, 5] - run.q[0, 5], way, rtol=1e-4 if options.get("method") else 1e-6)
        assert not run.stats["open_loads"]
