"""The short form of the differential run; `python tests/stress/differential.py` is the long one."""

import differential
import numpy as np
import pinocchio as pin
import pytest
from differential import Finding, Runs, check, judge
from random_motions import KINDS, Motion, kind_of, random_motion
from test_dead_centres import random_crank

import pincontact as pc


def test_all_ways_agree():
    """One motion of each kind but carts and limbs, followed in five ways."""
    seeds = (100, 103, 104, 105, 107, 110, 114, 118, 120, 121, 123, 125, 8_000_044, 8_000_045)
    assert {kind_of(seed) for seed in seeds} == set(KINDS) - {"cart", "limbs"}
    for seed in seeds:
        finding = check(seed)
        assert not finding.wrong, finding


def test_a_wrong_run_is_told():
    """A run of a slightly different motion is near at first, and is told from errors and from undecided motions."""
    runs = Runs(random_motion(100)[1])
    exact = runs.tight()
    other = runs.tight(runs.motion.rebuilt(gravity=1.0 + 1e-3))
    # larger than errors that may go with the tolerance
    for run, wrong in ((runs.run(), 0), (other, 1)):
        finding = Finding(100, "")
        judge(runs, run, exact, "", "DOP853", finding, runs.motion)
        assert len(finding.wrong) == wrong, finding


def test_slip_that_begins_and_turns_among_events():
    """Five feet: slip that begins after other events was once lost in noise; later their loads change in a ten
    thousandth of a second as slip turns, and one that has come to zero was taken for one that opens."""
    runs = Runs(random_motion(203628)[1])
    run, finer = (runs.run(**options) for options in ({}, {"rtol": 1e-10, "atol": 1e-12}))
    assert run.status == finer.status == 0
    # nor does one open that the others keep closed, whatever is recorded
    for one in (run, finer, runs.run(energies=False)):
        assert not any(event.kind == "separate" for event in one.events)
    # slip that has just begun, at nanometres a second, may come to rest for some ten millionths of a second
    assert runs.apart(run, finer).max() < 5e-6
    assert differential.gain(run, runs.motion.passive, stepped=False) < 1e-9


def test_a_hopping_ball_is_followed_on_the_side_that_faces_the_ground():
    """Waves that shake throw a ball up 0.1 mm; in some frames of the world its far side was taken for the nearest."""
    motion = random_motion(405625)[1]
    rng = np.random.default_rng(405625 + 10**9)
    rng.choice(differential.METHODS)
    world = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    runs = Runs(motion)
    run, turned = runs.run(), runs.run(motion.rebuilt(world, rng))
    assert run.status == turned.status == 0
    told = [event.kind for event in run.events]
    assert told == [event.kind for event in turned.events] and told.count("touch") > 5
    # errors of some twenty events at 1e-8
    assert runs.apart(turned, run).max() < 1e-6


def test_turned_worlds_keep_their_motion():
    """q and v are the same whatever frame the world has and in whichever order contacts are made."""
    for seed in range(60, 60 + len(KINDS)):
        kind, motion = random_motion(seed)
        rng = np.random.default_rng(seed)
        start = motion.rebuilt(pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)), rng).state()
        # round-off, where a contact point is found by Newton's method
        assert start.correction.dq < 1e-9 and start.correction.dv < 1e-9, kind


@pytest.mark.parametrize("angle", [1e-9, 0.1, 0.5, 1.0, 1.5])
def test_normals_of_a_curve_are_a_choice(angle):
    """A slider-crank whose rail is a curve in space, turned about that rail: which two normals the curve has there is
    chosen from the world's axes, and all forces are in the plane of the crank."""
    crank, begin, expected, _ = random_crank(1)
    scene = crank.scene("P-3C")
    motion = Motion.of(scene, scene.initial_state(*crank.place(*begin)), 1.0)
    runs = Runs(motion)
    run = runs.run(motion.rebuilt(pin.SE3(pin.utils.rotate("x", angle), np.zeros(3))), t_eval=runs.times[-1:])
    assert run.status == 0, run.message
    # errors of 1e-8 through two dead centres
    np.testing.assert_allclose([run.q[-1, 0], run.v[-1, 0]], expected, rtol=0.0, atol=2e-6)


def test_ends_of_runs_are_explained():
    """A bead at the end of its wire: no run goes on, and none could."""
    finding = check(2)
    assert set(finding.statuses.values()) == {-8}
    assert all(solution.startswith("none") for _, solution in finding.ends if solution)
    assert not finding.wrong and differential.ENDS_ASKED > 0


def test_of_two_solutions_all_ways_take_the_same():
    """A chain on two sliding contacts, whose common operator has a negative determinant: both could stay closed, or one
    opens. Compliances lead to the second."""
    assert not check(1024).wrong
    motion = random_motion(1024)[1]
    ends = [Runs(motion).run(), Runs(motion).stepped(5e-4)]
    for run in ends:
        assert run.status == 0, run.message
        # open from the first moment on
        assert run.contacts["c0"].mode[1] == -1


@pytest.mark.parametrize("seed", [405760, 409024])
def test_what_can_stay_closed_does(seed):
    """Ideal rolling that might open as well: as the dry friction of a joint turns back, which a drive makes pass zero,
    and in time steps as a joint leaves its end, so that other units than in the last step take part."""
    finding = check(seed)
    assert not finding.wrong, finding
    motion = random_motion(seed)[1]
    for run in (Runs(motion).run(), Runs(motion).stepped(5e-4)):
        # long after the event
        assert min(event.time for event in run.events if event.kind == "separate") > 0.07


@pytest.mark.parametrize("seed", [405059, 406787])
def test_corners_are_not_wedged(seed):
    """Boxes that may not slip fall from corner to corner. Where a step ends, one that touches is not quite on the
    ground, and would be wedged against one that is on it, by forces of 400 N s that no motion feels."""
    finding = check(seed)
    assert not finding.wrong, finding


@pytest.mark.parametrize("seed", [8_502_400, 8_502_430])
def test_rows_that_become_independent_make_no_energy(seed):
    """Four ideal feet, and two wheels on one axle: forces jump within a step to an event, or by the second correction
    of a projection, and had taken or made a hundredth of the energy."""
    motion = random_motion(seed)[1]
    options = {"control": motion.control, "breakpoints": motion.breakpoints, "energies": True, "method": "RK45"}
    run = pc.simulate(motion.scene, motion.state(), motion.duration, **options)
    assert run.status == 0, run.message
    energies = run.energies()
    # hundreds of steps of 1e-8 of the energy
    assert np.abs(energies.balance).max() < 1e-6 * energies.kinetic.max()


def test_forces_on_the_rim_of_their_cones_end_no_run_with_an_exception():
    """Feet of whose redundant forces none lies inside the cones, but for round-off: there is no central one."""
    run = Runs(random_motion(1140)[1]).run()
    assert run.status == 0, run.message


def test_a_touch_after_a_dip_is_as_good_as_the_tolerance():
    """An ellipsoid in ideal rolling is let go, dips, comes near again and sinks in: when it has sunk too far follows
    from the rate of the gap's second derivative, which is measured."""
    _, motion = random_motion(50216)
    touches = []
    for rtol in (1e-8, 1e-10):
        run = pc.simulate(motion.scene, motion.state(), 0.3, rtol=rtol, atol=rtol)
        assert run.status == 0, run.message
        touches.append(next(event.time for event in run.events if event.kind == "touch"))
    # measured to first order they are 6e-5 s apart; the surfaces approach each other at 4 cm/s
    assert touches[0] == pytest.approx(touches[1], abs=1e-6)


@pytest.mark.parametrize("seed", [500380, 511680, 511588, 400552])
def test_methods_agree_where_one_was_wrong(seed):
    """A mechanism that comes to rest and is held by forces no motion feels, though what rigid geometry leaves out asks
    for more than its rows reach; resistance to rolling after ideal rolling was held up by friction; resistance to
    rolling that wedges what strikes; coupled joints that stop together."""
    finding = check(seed)
    assert not finding.wrong, finding


def test_a_dip_is_foreseen_by_its_whole_length():
    """A tripod whose rough foot is let go: the rate of its gap's acceleration is no constant, and by its first value
    the foot would be back from half a millimetre. It got twice as deep, and was lifted with more energy than there was.
    """
    _, motion = random_motion(700068)
    run = pc.simulate(motion.scene, motion.state(), 1.1, energies=True)
    assert run.status == 0, run.message
    energies = run.energies()
    assert np.abs(energies.balance).max() <= 1e-7 * energies.kinetic.max()
