"""The short form of `robots.py`: quadrupeds, humanoids and arms whose runs need no time stepping."""

import math

import numpy as np
import pinocchio as pin
import pytest
import robots

import pincontact as pc

FOLDER = robots.robots_folder()
# joints of G1 and Z1 rattled for ever, in dry friction and at limits; ANYmal's feet begin to slip one beside the other;
# feet of B1 jam, while others stick and slide
LIMP = (
    "anymal_b",
    "anymal_c",
    "b1",
    "g1_29dof_rev_1_0",
    "quadruped",
    "borinot_flying_arm_2",
    "finger_edu",
    "z1",
    "solo",
    "solo12",
)
# it jams again and again in slips of 1e-6 m/s: of eight relative tolerances next to 1e-8 one finds no forces in one
MAY_FALL_BACK = ("b1",)
# what hops left of slip, of the feet of Laikago and Alexander, left no forces
STANDING = ("a1", "alexander_v1.lowerBodyOnly", "laikago", "solo12", "xarm7")


@pytest.mark.skipif(FOLDER is None, reason='needs pip install "pincontact[robots]"')
@pytest.mark.parametrize(
    ("name", "motion"), [*((name, "limp") for name in LIMP), *((name, "standing") for name in STANDING)]
)
def test_robot(name, motion):
    row = robots.measure(robots.load(FOLDER, robots.ROBOTS[name]), motion, ("Moreau", "DOP853"), timed=False)
    assert not list(row.faults())
    assert name in MAY_FALL_BACK or not row.outcomes["DOP853"].fell_back
    if motion == "standing":
        # time stepping's own error, and its limits': steps of a millisecond
        assert row.outcomes["DOP853"].distance < 1e-3


@pytest.mark.skipif(FOLDER is None, reason='needs pip install "pincontact[robots]"')
def test_hundreds_of_hops():
    """Limp, Go1's joints hop at their stops: steps of a millisecond have impacts at once that are not."""
    robot = robots.load(FOLDER, robots.ROBOTS["go1"])
    state = robot.scene.initial_state(robot.q, np.zeros(robot.model.nv), free=list(robot.scene.contacts))
    run = pc.simulate(robot.scene, state, 0.2)
    stepped = pc.simulate(robot.scene, state, 0.2, method="Moreau", step=2e-5)
    assert run.status == stepped.status == 0, (run.message, stepped.message)
    # feet that creep come to rest where they do, not again and again
    assert len(run.events) < 200
    # the error of time stepping, which falls with the step
    apart = pin.difference(robot.model, run.q[-1], stepped.q[-1])
    assert np.abs(apart).max() < 1e-3


@pytest.mark.skipif(FOLDER is None, reason='needs pip install "pincontact[robots]"')
def test_slips_that_go_back_in_turn_are_given_up():
    """Centauro's wheels: what slides goes back, and others do; the same modes come back again and again."""
    robot = robots.load(FOLDER, robots.ROBOTS["centauro"])
    state = robot.scene.initial_state(robot.q, np.zeros(robot.model.nv), free=list(robot.scene.contacts))
    run = pc.simulate(robot.scene, state, 0.0452)
    # how many mode changes there are hangs on round-off; most evaluations of each are for directions of slip
    assert run.stats["rhs"] < 400 * len(run.events)
    assert run.status == 0 or (run.status == -4 and "wheel" in run.message and "fallback" in run.message)


@pytest.mark.parametrize("case", range(8))
def test_a_mass_matrix_that_is_singular_to_round_off_is_refused(case):
    """A gimbal without inertia but of its last body, whose outer axes coincide: which sign a pivot has is chance."""
    rng = np.random.default_rng(case)
    model, parent = pin.Model(), 0
    place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    for name, joint in (("outer", pin.JointModelRZ()), ("middle", pin.JointModelRX()), ("inner", pin.JointModelRZ())):
        parent, place = model.addJoint(parent, joint, place, name), pin.SE3.Identity()
    inertia = pin.Inertia(rng.uniform(0.5, 2.0), rng.uniform(-1.0, 1.0, 3), np.diag(rng.uniform(0.02, 0.03, 3)))
    model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    q = np.array([rng.uniform(-3.0, 3.0), 0.0, rng.uniform(-3.0, 3.0)])
    with pytest.raises(pc.ModelError, match=r"joint '(outer|inner)' moves nothing that has inertia.*armature"):
        pc.Scene(model).initial_state(q)
    model.armature[:] = 1e-3
    scene = pc.Scene(model)
    run = pc.simulate(scene, scene.initial_state(q), 0.1)
    assert run.status == 0 and math.isfinite(float(run.q.sum()))
