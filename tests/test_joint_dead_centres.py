"""Linkages whose joints have dry friction and pass dead centres, where the joint's speed is zero for an instant though
nothing comes to rest."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

DURATION = 0.6


def slotted(rng: np.random.Generator) -> tuple[pc.Scene, pc.State]:
    """A crank's pin in the slot of a lever that swings to and fro, with friction in the slot and in both hinges."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    length = rng.uniform(0.1, 0.3)
    pivot = length * rng.uniform(1.2, 1.8)
    for name, x, size in (("crank", 0.0, length), ("lever", pivot, rng.uniform(0.3, 0.6))):
        place, mass = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), rng.uniform(0.3, 2.0)
        joint = model.addJoint(0, pin.JointModelRZ(), place, name)
        body = pin.Inertia(mass, np.array([0.5 * size, 0.0, 0.0]), 0.09 * mass * size**2 * np.eye(3))
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    model.upperDryFrictionLimit = rng.uniform(0.05, 0.4, 2)
    model.lowerDryFrictionLimit = -model.upperDryFrictionLimit
    scene = pc.Scene(model)
    scene.add_contour("pin", pc.Point(), "crank", pin.SE3(np.eye(3), np.array([length, 0.0, 0.0])))
    scene.add_contour("slot", pc.Line(), "lever")
    scene.add_contact("pin", "pin", "slot", pc.Coulomb(rng.uniform(0.02, 0.3)), bilateral=True, pattern="P-2C")
    angle = rng.uniform(-3.0, 3.0)
    lever = math.atan2(length * math.sin(angle), length * math.cos(angle) - pivot)
    speed = rng.choice([-1.0, 1.0]) * rng.uniform(8.0, 15.0)
    return scene, scene.initial_state([angle, lever], [speed, 0.0], max_gap=0.5)


def passing_arm(rng: np.random.Generator) -> tuple[pc.Scene, pc.State]:
    """Three links whose tip sticks to a line by friction: a four-bar linkage while it holds. Its middle joint has dry
    friction."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    parent, place = 0, pin.SE3.Identity()
    for name, size in zip("abc", rng.uniform(0.2, 0.4, 3)):
        mass = rng.uniform(0.3, 1.0)
        parent = model.addJoint(parent, pin.JointModelRZ(), place, name)
        body = pin.Inertia(mass, np.array([0.5 * size, 0.0, 0.0]), 0.09 * mass * size**2 * np.eye(3))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([size, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, place, pin.FrameType.OP_FRAME))
    dry = np.array([0.0, rng.uniform(0.3, 0.6), 0.0])
    model.upperDryFrictionLimit, model.lowerDryFrictionLimit = dry, -dry
    q = np.array([rng.uniform(0.0, 1.0), rng.uniform(0.6, 1.2), rng.uniform(0.6, 1.2)])
    data = model.createData()
    jacobian = pin.computeFrameJacobian(model, data, q, model.getFrameId("tip"), pin.LOCAL_WORLD_ALIGNED)[:2]
    pin.updateFramePlacements(model, data)
    tip = data.oMf[model.getFrameId("tip")].translation
    scene = pc.Scene(model)
    scene.add_contour("tip", pc.Point(), "tip")
    # away from the base, lest it slides
    turned = pin.utils.rotate("z", math.atan2(tip[1], tip[0]) - 0.5 * math.pi)
    scene.add_contour("line", pc.Line(), placement=pin.SE3(turned, tip))
    scene.add_contact("tip", "tip", "line", pc.Coulomb(2.0), bilateral=True, pattern="P-2C")
    moving = np.linalg.svd(jacobian)[2][2]
    return scene, scene.initial_state(q, 4.0 * moving / np.abs(moving).max(), max_gap=0.3)


@pytest.mark.parametrize(
    "make, seed", [*((slotted, seed) for seed in (0, 1, 4, 6, 11)), *((passing_arm, seed) for seed in (0, 2, 8, 9))]
)
def test_dry_joint_passes_its_dead_centre(make, seed):
    """It turns round and the others go on, in all methods: the dry joint slips the other way, and does not stick."""
    scene, state = make(np.random.default_rng(seed))
    times = np.linspace(0.0, DURATION, 31)
    run = pc.simulate(scene, state, DURATION, t_eval=times)
    tight = pc.simulate(scene, state, DURATION, t_eval=times, rtol=1e-11, atol=1e-13)
    steps = pc.simulate(scene, state, DURATION, t_eval=times, method="Moreau", dt=2e-4)
    assert run.status == tight.status == steps.status == 0, (run.message, tight.message, steps.message)
    passed = [event.time for event in tight.events if (event.joint, event.kind) in (("lever", "slip"), ("b", "slip"))]
    assert passed
    assert np.abs(run.q - tight.q).max() < 1e-7
    # of first order: errors of 1e-3 at 2e-4 s
    assert np.abs(steps.q - tight.q).max() < 3e-3
