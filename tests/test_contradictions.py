"""Constraints that cannot be met together are told, with the contacts' names: velocities in every method, gaps at the
start."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

METHODS = {"DOP853": {"method": "DOP853"}, "Moreau": {"method": "Moreau", "step": 1e-3}}
BOTH = pytest.mark.parametrize("method", METHODS)


def plate(rng, motion, bilateral=True, turned=None):
    """A plate on a plane at rest, on which two or more points roll ideally, and on a driven one."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "plate")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([0.01, 0.02, 0.03])), pin.SE3.Identity())
    model.addFrame(pin.Frame("plate", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    scene = pc.Scene(model)
    fixed, driven = scene.add_contour("fixed", pc.Plane()), scene.add_contour("driven", pc.Plane(), motion=motion)
    places = (
        np.array([[0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, 0.0, 0.0]])
        + np.c_[rng.uniform(-0.03, 0.03, (3, 2)), [0, 0, 0]]
    )
    for k in rng.permutation(3):
        point = scene.add_contour(f"p{k}", pc.Point(), "plate", pin.SE3(np.eye(3), places[k]))
        scene.add_contact(f"p{k}", point, driven if k == 2 else fixed, friction=pc.NoSlip(), bilateral=bilateral)
    return scene, np.r_[np.zeros(6), 1.0]


@pytest.mark.parametrize("bilateral", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_contradiction_at_the_start_is_refused(seed, bilateral):
    rng = np.random.default_rng(seed)
    belt = pc.ConstantTwist(linear=[*rng.uniform(0.01, 0.2, 2), 0.0])
    scene, q = plate(rng, belt, bilateral)
    with pytest.raises(pc.StateError, match=r"'p2'.* cannot be met together"):
        scene.initial_state(q)


@BOTH
@pytest.mark.parametrize("bilateral", [True, False])
@pytest.mark.parametrize("seed", range(2))
def test_contradiction_in_a_run_ends_it(seed, bilateral, method):
    """A drive that begins at rest: no run goes on while a contact that must not slip does."""
    rng = np.random.default_rng(seed)
    scene, q = plate(
        rng, pc.HarmonicMotion(rng.uniform(0.02, 0.1, 3) * [1.0, 1.0, 0.0], 1.0, -0.5 * math.pi), bilateral
    )
    run = pc.simulate(scene, scene.initial_state(q), 0.3, **METHODS[method])
    assert run.status == -4
    assert "'p2'" in run.message
    # the accepted states keep to their constraints, to 1e-5 where they contradict each other
    assert run.residuals()["VC"].max() <= 1e-5


@BOTH
@pytest.mark.parametrize("seed", range(4))
def test_redundant_but_consistent_contacts_go_on(seed, method):
    """All three on the same drive, or a point driven as the plate that rests would have it: nothing contradicts."""
    rng = np.random.default_rng(seed)
    scene, q = plate(rng, pc.HarmonicMotion([0.0, 0.0, 0.0], 1.0, 0.0))
    run = pc.simulate(scene, scene.initial_state(q), 0.3, **METHODS[method])
    assert run.status == 0, run.message
    assert run.residuals()["VC"].max() <= 1e-12


def table(short):
    """On four round feet, one of which is short by so much."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "table")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(2.0, 0.6, 0.4, 0.2), pin.SE3.Identity())
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane())
    for k, (x, y) in enumerate(((0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2))):
        centre = pin.SE3(np.eye(3), np.array([x, y, short * (k == 0) - 0.08]))
        foot = scene.add_contour(f"foot {k}", pc.Sphere(0.02), "table", centre)
        scene.add_contact(f"foot {k}", foot, floor, friction=pc.Coulomb(0.5))
    return scene, np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])


def test_gaps_that_would_be_left_are_refused():
    """A table on four legs of which one is short: the nearest that all four come to the floor is a quarter of that."""
    short = 4e-4
    scene, q = table(short)
    with pytest.raises(pc.NoContactError, match=r"foot 0, .* cannot all be closed.* 0.0001 m are left") as told:
        scene.initial_state(q)
    assert told.value.gap == pytest.approx(short / 4.0, rel=1e-3)
    # it stands on three
    state = scene.initial_state(q, free=["foot 0"])
    run = pc.simulate(scene, state, 0.1)
    assert run.status == 0, run.message
    assert run.contacts["foot 0"].gap[0] == pytest.approx(short, rel=1e-3)


@pytest.mark.parametrize("part", [0.5, 2.0])
def test_gaps_are_refused_that_time_stepping_refuses(part):
    """From a millionth of a foot's radius on, 20 mm."""
    scene, q = table(4.0 * part * 1e-6 * 0.02)
    if part > 1.0:
        with pytest.raises(pc.NoContactError, match="cannot all be closed"):
            scene.initial_state(q)
        return
    run = pc.simulate(scene, scene.initial_state(q), 0.01, method="Moreau", dt=1e-3)
    assert run.status == 0


@pytest.mark.parametrize("step", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("short", [1e-8, 1e-7, 1e-6, 1e-5, 1e-4])
def test_a_short_leg_of_a_standing_table_touches_nothing(short, step):
    """It is nearer to the floor than what falls freely gets in a step, but the others hold it."""
    scene, q = table(short)
    run = pc.simulate(scene, scene.initial_state(q, free=["foot 0"]), 0.1, method="Moreau", dt=step)
    assert run.status == 0, run.message
    assert not run.events
    assert np.abs(run.contacts["foot 0"].gap - short).max() < 1e-12
    assert run.residuals()["GC"].max() < 1e-12


BODIES = {"ball": pc.Sphere(0.1), "egg": pc.Ellipsoid(0.1, 0.12, 0.15)}
FLOORS = {"plane": pc.Plane(), "hill": pc.Ellipsoid(3.0, 2.5, 2.0)}
STARTS = {
    "DOP853": lambda scene, state: pc.simulate(scene, state, 0.1),
    "RK45": lambda scene, state: pc.simulate(scene, state, 0.1, method="RK45"),
    "Moreau": lambda scene, state: pc.simulate(scene, state, 0.1, method="Moreau"),
    "Stepper": pc.Stepper,
    "rollout": lambda scene, state: pc.rollout(scene, [state], np.zeros((1, 3, 6)), 1e-3),
    "linearize": pc.linearize,
    "inverse_dynamics": pc.inverse_dynamics,
}


def on_top(body, floor, bilateral, motion=None):
    """A body at rest on top of a floor."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag([0.004, 0.005, 0.006])), pin.SE3.Identity())
    scene = pc.Scene(model)
    contours = scene.add_contour("body", BODIES[body], "body"), scene.add_contour("floor", FLOORS[floor], motion=motion)
    scene.add_contact("foot", *contours, friction=pc.Coulomb(0.5), side=1, bilateral=bilateral)
    height = {"ball": 0.1, "egg": 0.15}[body] + {"plane": 0.0, "hill": 2.0}[floor]
    return scene, scene.initial_state([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("bilateral", [True, False])
@pytest.mark.parametrize("floor", FLOORS)
@pytest.mark.parametrize("body", BODIES)
def test_states_that_were_moved_apart_are_refused(body, floor, bilateral, start):
    """A state's q is replaced, so that a closed contact is apart: nothing is moved back, whatever v is."""
    scene, state = on_top(body, floor, bilateral)
    for up, speed in ((0.3, 0.0), (-0.03, -1.0), (-0.03, 1.0), (5.0, -1.0)):
        moved = replace(state, q=state.q + np.r_[0.0, 0.0, up, np.zeros(4)], v=np.r_[0.0, 0.0, speed, np.zeros(3)])
        with pytest.raises(pc.StateError, match=f"'foot' is closed in this state, but {abs(up):g} m apart"):
            STARTS[start](scene, moved)
    # what is nearer is put together
    STARTS[start](scene, replace(state, q=state.q + np.r_[0.0, 0.0, 1e-3, np.zeros(4)]))


@pytest.mark.parametrize("method", METHODS)
def test_motions_that_jump_apart_end_a_run(method):
    """A floor that sinks by a radius at once, at a breakpoint: a bilateral contact cannot follow."""

    def sink(t):
        return pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1 * (t > 0.05)])), np.zeros(6), np.zeros(6)

    scene, state = on_top("ball", "plane", True, pc.CallableMotion(sink))
    run = pc.simulate(scene, state, 0.1, breakpoints=[0.05], **METHODS[method])
    assert run.status < 0
    assert "'foot' 0.1 m apart at once" in run.message
    assert run.t[-1] == pytest.approx(0.05)
