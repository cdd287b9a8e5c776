"""Motions that jump without being declared, in time stepping: the run says so, and no body is moved by them. What moves
fast but smoothly is none of these."""

import math
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from random_motions import G, axis, free_body

import pincontact as pc

JUMPS_AT, DURATION = 0.0503, 0.1
STEP = 1e-3


def thrown(rng, motion_at, closed):
    """A ball, an ellipsoid or a three-legged stool at rest on, or dropped a little above, a plane, a ball or a
    cylinder that moves. motion_at: its motion for where it is placed."""
    size, shape = rng.uniform(0.03, 0.1), rng.integers(3)
    scene = pc.Scene(free_body(1.0, rng.uniform(0.5, 1.0, 3) * size**2))
    place = pin.SE3(pin.exp3(0.2 * rng.uniform() * axis(rng)), np.zeros(3))
    ground = (pc.Plane(), pc.Sphere(0.5), pc.Cylinder(0.5))[rng.integers(3)] if shape != 2 else pc.Plane()
    up = place.rotation[:, 2] if isinstance(ground, pc.Plane) else np.array([0.0, 0.0, 0.0])
    if not isinstance(ground, pc.Plane):
        # the cylinder lies along y
        place = pin.SE3(pin.utils.rotate("x", math.pi / 2), np.array([0.0, 0.0, -0.5]))
        up = np.array([0.0, 0.0, 1.0])
    motion = motion_at(place)
    scene.add_contour("ground", ground, placement=place * motion.placement(0.0).inverse(), motion=motion)
    law = pc.Coulomb(rng.uniform(0.1, 0.8))
    if shape == 2:
        for i in range(3):
            foot = np.array([size * math.cos(2.1 * i), size * math.sin(2.1 * i), -size])
            scene.add_contour(f"foot {i}", pc.Point(), "body", pin.SE3(np.eye(3), foot))
            scene.add_contact(f"foot {i}", f"foot {i}", "ground", law)
    else:
        body = pc.Sphere(size) if shape == 0 else pc.Ellipsoid(0.8 * size, 1.1 * size, size)
        scene.add_contour("body", body, "body")
        scene.add_contact("body", "body", "ground", law)
    height = size + (0.0 if closed else rng.uniform(0.015, 0.03))
    turned = place.rotation if isinstance(ground, pc.Plane) else np.eye(3)
    q = np.array([*height * up, *pin.Quaternion(turned).coeffs()])
    return scene, scene.initial_state(q, np.zeros(6), free=[] if closed else list(scene.contacts), max_gap=0.3)


def run_of(scene, state, **options):
    return pc.simulate(scene, state, DURATION, method="Moreau", dt=STEP, **options)


@pytest.mark.parametrize("seed", range(12))
def test_a_jump_is_told_and_moves_no_body(seed):
    """Under bodies that rest, and into such as fall. It jumps 3 to 30 cm up, by itself or as it turns about a point a
    metre away; the body has by then fallen 1.2 cm at most, and is less than 3 cm above it."""
    rng = np.random.default_rng([17, seed])
    closed, turns, jump = seed % 2 == 0, seed % 4 < 2, rng.uniform(0.03, 0.3)
    drift = 0.3 * axis(rng)
    rotation, pivot = pin.utils.rotate("y", -jump * turns), np.array([-1.0, 0.0, 0.0])
    pose = pin.SE3(rotation, pivot - rotation @ pivot + (not turns) * np.array([0.0, 0.0, jump]))

    def motion_at(jumps, place):
        """By pose in world axes, drifting along the axes of where it is placed."""

        def motion(t):
            elsewhere = place.inverse() * pose * place if jumps and t > JUMPS_AT else pin.SE3.Identity()
            velocity = np.r_[elsewhere.rotation @ drift, 0.0, 0.0, 0.0]
            return elsewhere * pin.SE3(np.eye(3), drift * t), velocity, np.zeros(6)

        return pc.CallableMotion(motion)

    rng_state = rng.bit_generator.state
    scene, state = thrown(rng, partial(motion_at, True), closed)
    run = run_of(scene, state)
    assert run.status == -1
    assert run.t[-1] <= JUMPS_AT
    assert "at once: a motion jumps" in run.message
    # up to there it is the motion without a jump, which runs through
    rng.bit_generator.state = rng_state
    scene, state = thrown(rng, partial(motion_at, False), closed)
    smooth = run_of(scene, state, t_eval=[run.t[-1], DURATION])
    assert smooth.status == 0
    np.testing.assert_allclose(run.q[-1], smooth.q[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_what_moves_fast_does_not_jump(seed):
    """The same motion as a class of the package and as a function, by up to a radian of its phase in a step: status and
    result are the same."""
    rng = np.random.default_rng([18, seed])
    omega = 10.0 ** rng.uniform(1.0, 3.0)
    reach = min(rng.uniform(0.1, 3.0) * G / omega**2, 0.1)
    given = pc.HarmonicMotion(
        reach * axis(rng),
        omega / (2.0 * math.pi),
        rng.uniform(0, 6),
        axis(rng),
        rng.uniform(0.0, 0.5) * (seed % 3 == 0),
    )
    if seed % 4 == 3:
        # a belt, or a cam that turns
        given = pc.ConstantTwist(linear=5.0 * axis(rng) * (1, 1, 0), angular=(0.0, 0.0, rng.uniform(-300.0, 300.0)))

    def motion(t):
        row = given.evaluate(t)
        return pin.SE3(row[:9].reshape(3, 3), row[9:12]), row[12:18], row[18:24]

    rng_state = rng.bit_generator.state
    first = run_of(*thrown(rng, lambda place: given, seed % 2 == 0))
    rng.bit_generator.state = rng_state
    second = run_of(*thrown(rng, lambda place: pc.CallableMotion(motion), seed % 2 == 0))
    assert first.status == second.status
    np.testing.assert_allclose(first.q, second.q, rtol=0, atol=1e-9)


def test_steppers_tell_jumps_too():
    def motion(t):
        return pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1 * (t > JUMPS_AT)])), np.zeros(6), np.zeros(6)

    scene, state = thrown(np.random.default_rng(3), lambda place: pc.CallableMotion(motion), True)
    stepper = pc.Stepper(scene, state, dt=STEP)
    with pytest.raises(pc.SolverError, match="a motion jumps"):
        stepper.step(np.zeros(6), 100)
    assert stepper.t == pytest.approx(0.05)


# the slow ones are no rebounds, and were neither impacts nor within what is taken for errors
JUMPS = [
    *((0.5, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.2), (0.0, 0.0, -0.2), (0.3, 0.0, 0.2)),
    *((5e-4, 0.0, 0.0), (0.0, 0.0, 5e-4), (1e-4, 0.0, -4e-4)),
]


@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize("law", [None, pc.NoSlip(), pc.Coulomb(0.3)])
@pytest.mark.parametrize("jump", JUMPS)
def test_a_velocity_that_jumps_at_a_breakpoint_throws_a_ball(jump, law, bilateral):
    """A ball that rolls on a plate: what cannot slip, and what cannot part, receives an impulse. Without friction, the
    plate moves it up and down alone; with friction its own velocity becomes 2/7 of the plate's and 5/7 of what it
    was, once it rolls again. Where it can part it does as the plate goes down, and comes back."""
    jump, radius, at = np.array(jump), 0.1, 0.1

    def plate(t):
        moving = t >= at
        pose = pin.SE3(np.eye(3), moving * (t - at) * jump)
        return pose, np.append(moving * jump, np.zeros(3)), np.zeros(6)

    scene = pc.Scene(free_body(1.0, np.full(3, 0.4 * radius**2)))
    ball, ground = scene.add_contour("ball", pc.Sphere(radius), "body"), pc.Plane()
    ground = scene.add_contour("plate", ground, motion=pc.CallableMotion(plate))
    scene.add_contact("c", ball, ground, friction=law, bilateral=bilateral)
    state = scene.initial_state([0.0, 0.0, radius, 0.0, 0.0, 0.0, 1.0], [0.2, 0.0, 0.0, 0.0, 2.0, 0.0])
    run = pc.simulate(scene, state, 0.4, breakpoints=[at], energies=True)
    assert run.status == 0, run.message
    rolls = 2.0 / 7.0 if law is not None else 0.0
    v = pin.XYZQUATToSE3(run.q[-1]).rotation @ run.v[-1, :3]
    np.testing.assert_allclose(v, [0.2 + rolls * jump[0], rolls * jump[1], jump[2]], rtol=0.0, atol=1e-8)
    # the plate's impulse puts in what the ball gains
    assert np.abs(run.energies().balance).max() < 1e-8
