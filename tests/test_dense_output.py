"""Dense output: `run.sol` at any time, also across events."""

import math
import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from random_scenes import random_scene

import pincontact as pc

ROOT = Path(__file__).parents[1]
MU, G = 0.2, 9.81


def ball(v, height=0.1, restitution=0.0, mu=MU, **options):
    scene = pc.Scene.from_urdf(ROOT / "urdf" / "ball.urdf", floating_base=True)
    sphere, floor = scene.add_contour("ball", pc.Sphere(0.1), frame="ball"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", sphere, floor, friction=None if mu is None else pc.Coulomb(mu), restitution=restitution)
    return scene, scene.initial_state([0, 0, height, 0, 0, 0, 1], v, **options)


def disk(friction, spin=5.0):
    scene = pc.Scene.from_urdf(ROOT / "urdf" / "disk.urdf", floating_base=True)
    rim, floor = scene.add_contour("rim", pc.Circle(0.3), frame="disk"), scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", rim, floor, friction=friction)
    q = pin.neutral(scene.model)
    q[2], q[3:] = 0.2796, [0, 0.564642, 0, 0.825336]
    return scene, scene.initial_state(q, [0, 0, 0, 0, 0, spin])


def test_closed_form_across_the_end_of_slip():
    """A ball slides, rolls from t = 2 v / (7 mu g) on: place, velocity and force on both sides and at the event."""
    scene, state = ball([1.0, 0, 0, 0, 0, 0])
    run = pc.simulate(scene, state, 0.5, dense_output=True, t_eval=[])
    (event,) = run.events
    rolls = 2.0 / (7.0 * MU * G)
    t = np.sort(np.r_[np.random.default_rng(0).uniform(0.0, 0.5, 40), 0.0, event.time, 0.5])
    sample = run.sol(t)
    sliding = np.minimum(t, rolls)
    x = sliding - 0.5 * MU * G * sliding**2 + 5.0 / 7.0 * (t - sliding)
    # tolerances of the run: rtol 1e-8, atol 1e-10
    np.testing.assert_allclose(sample.q[:, 0], x, atol=1e-8)
    np.testing.assert_allclose(sample.v[:, 0] ** 2 + sample.v[:, 2] ** 2, (1.0 - MU * G * sliding) ** 2, atol=1e-8)
    track = sample.contacts["c"]
    before = t <= event.time
    np.testing.assert_allclose(track.force[:, 0], np.where(before, MU * 0.5 * G, 0.0), atol=1e-9)
    np.testing.assert_allclose(track.force[:, 2], -0.5 * G, atol=1e-12)
    assert (track.mode == np.where(before, 2, 1)).all()
    np.testing.assert_allclose(track.gap, 0.0, atol=1e-14)
    np.testing.assert_allclose(track.location_second[:, 0], x, atol=1e-8)


CASES = {
    "slips and sticks": lambda: (*disk(pc.Coulomb(0.8)), 0.5),
    "rolls": lambda: (*disk(pc.NoSlip()), 0.5),
    "frictionless": lambda: (*disk(None), 0.5),
    "bounces": lambda: (*ball([0.4, 0, 0, 0, 0, 0], 0.3, 0.7, free=["c"]), 0.8),
    "redundant": lambda: (*sliding_block(), 0.6),
}


def sliding_block():
    scene = pc.Scene.from_urdf(ROOT / "urdf" / "block.urdf", floating_base=True)
    scene.add_contours_from_collision(links=["block"], kinds=["corners"])
    floor = scene.add_contour("floor", pc.Plane())
    for corner in [name for name in scene.contours if name.endswith("-z")]:
        scene.add_contact(corner, corner, floor, friction=pc.Stribeck(mu=0.2, mu_static=0.4, speed=0.05))
    return scene, scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [1.0, 0, 0, 0, 0.0, 0.5])


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("method", ["DOP853", "RK23"])
def test_the_same_as_outputs_and_without_gaps(case, method):
    """In the same steps outputs are made from the same interpolants: equal to round-off but where steps have been taken
    anew to end at an event."""
    scene, state, duration = CASES[case]()
    t = np.linspace(0.0, duration, 41)
    options = {"method": method, "rtol": 1e-6, "atol": 1e-8}
    run = pc.simulate(scene, state, duration, t_eval=t, dense_output=True, **options)
    assert run.status == 0, run.message
    sample = run.sol(t)
    # the accuracy of interpolation, of this order for these tolerances; positions vary by tenths of m
    np.testing.assert_allclose(sample.q, run.q, atol=3e-6)
    if case != "bounces":
        np.testing.assert_allclose(sample.v, run.v, atol=3e-5)
    same = np.abs(sample.q - run.q).max(axis=1) < 1e-14
    for name, track in run.contacts.items():
        for key in ("force", "location", "point", "slip_velocity", "mode"):
            # forces of some 10 N, after round-off has been through a solution
            np.testing.assert_allclose(getattr(sample.contacts[name], key)[same], getattr(track, key)[same], atol=1e-11)
    pieces = list(run._dense._pieces)
    ends = np.array([(piece.start, piece.end) for piece in pieces])
    assert ends[0, 0] == 0.0 and ends[-1, 1] == duration
    # of a short run each bounce ends a step that is long
    events = np.array([event.time for event in run.events])
    anew = np.isclose(ends[:, 1, None], events, rtol=0.0, atol=1e-12).any(axis=1)
    assert same[~anew[np.searchsorted(ends[:, 1], t)]].all() and same.mean() > 0.3
    # what breakpoints and impacts leave out is a rounding error
    np.testing.assert_allclose(ends[1:, 0], ends[:-1, 1], rtol=1e-15, atol=1e-300)
    # positions are continuous from one step to the next, up to the accuracy of interpolation
    knots = ends[1:, 0]
    left, right = run.sol(knots).q, run.sol(np.nextafter(knots, np.inf)).q
    np.testing.assert_allclose(left, right, atol=1e-8)
    residuals = max(np.abs(track.gap[track.mode >= 0]).max(initial=0.0) for track in sample.contacts.values())
    assert residuals < 1e-12


@pytest.mark.parametrize("count", [255, 256, 257, 1000])
def test_however_many_outputs_there_were(count):
    """One time, or many, are asked for after outputs that were fewer or more."""
    scene, state = ball([1.0, 0, 0, 0, 0, 0])
    t = np.linspace(0.0, 0.3, count)
    run = pc.simulate(scene, state, 0.3, t_eval=t, dense_output=True)
    few, one, many = run.sol(t[:10]), run.sol(t[5]), run.sol(np.repeat(t, 3))
    np.testing.assert_allclose(few.q, run.q[:10], rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(one.q, few.q[5])
    np.testing.assert_allclose(many.q[::3], run.q, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize(("method", "order"), [("DOP853", 7), ("RK45", 4), ("RK23", 3)])
def test_order_between_steps(method, order):
    """Errors in the middle of constant steps fall with the order of the method's interpolant, or faster."""
    scene, state = disk(pc.NoSlip())
    # not in the middles of steps, where interpolants of even degree may be better than elsewhere
    t = np.linspace(0.013, 0.787, 29)
    reference = pc.simulate(scene, state, 0.8, t_eval=t, method="Sharp98", rtol=1e-13, atol=1e-15)
    sizes = {"DOP853": (0.03, 0.015), "RK45": (0.01, 0.005), "RK23": (0.004, 0.002)}[method]
    errors = []
    for size in sizes:
        run = pc.simulate(
            scene, state, 0.8, method=method, fixed_step=size, rtol=1e-9, atol=1e-11, dense_output=True, t_eval=[]
        )
        errors.append(np.abs(run.sol(t).v - reference.v).max())
    observed = math.log2(errors[0] / errors[1])
    # half an order for steps that are not in the limit yet
    assert observed > order - 0.5, (observed, errors)
    assert errors[1] > 1e-12


def test_scalars_and_arrays():
    scene, state = ball([1.0, 0, 0, 0, 0, 0])
    run = pc.simulate(scene, state, 0.3, dense_output=True)
    one, several = run.sol(0.2), run.sol([0.25, 0.1, 0.2, 0.2])
    assert isinstance(one.t, float) and one.q.shape == (7,) and one.v.shape == (6,)
    assert several.t.tolist() == [0.25, 0.1, 0.2, 0.2] and several.q.shape == (4, 7)
    for i in (2, 3):
        np.testing.assert_array_equal(several.q[i], one.q)
        for key, values in one.contacts["c"].arrays().items():
            np.testing.assert_array_equal(getattr(several.contacts["c"], key)[i], values)
    assert one.contacts["c"].force.shape == (3,) and one.contacts["c"].force_on("ball").shape == (3,)
    assert one.contacts["c"].frame.shape == (3, 3) and int(one.contacts["c"].mode) in (1, 2)
    assert run.sol(np.float64(0.2)).q.tolist() == one.q.tolist()
    assert run.sol([]).q.shape == (0, 7)
    assert "0.2 s" in repr(one) and "4 times" in repr(several)
    assert len(repr(one.contacts["c"])) < 200


def test_ends_and_what_is_beyond():
    scene, state = ball([1.0, 0, 0, 0, 0, 0])
    run = pc.simulate(scene, state, 0.3, dense_output=True)
    np.testing.assert_allclose(run.sol([0.0, 0.3]).q, run.q[[0, -1]], rtol=0, atol=1e-15)
    # what linspace leaves
    assert run.sol(0.3 * (1.0 + 1e-14)).t == 0.3
    for wrong in (-0.1, 0.31, [0.1, 0.4]):
        with pytest.raises(pc.ArgumentError, match=r"t must lie in \[0, 0.3\], got"):
            run.sol(wrong)
    for wrong in ("0.1", None, True, 1j, [0.1, "x"]):
        with pytest.raises(pc.ArgumentError, match="t must be times in s"):
            run.sol(wrong)
    with pytest.raises(pc.ArgumentError, match="t must be finite"):
        run.sol([0.1, math.nan])
    with pytest.raises(pc.ArgumentError, match=r"shape \(1, 2\)"):
        run.sol([[0.1, 0.2]])
    at_once = pc.simulate(scene, state, 0.0, dense_output=True)
    np.testing.assert_array_equal(at_once.sol(0.0).q, at_once.q[0])


def test_runs_that_keep_none():
    scene, state = ball([1.0, 0, 0, 0, 0, 0])
    run = pc.simulate(scene, state, 0.1)
    with pytest.raises(pc.TrajectoryError, match="dense_output=True"):
        run.sol(0.05)
    kept = pc.simulate(scene, state, 0.1, dense_output=True)
    again = pickle.loads(pickle.dumps(kept))
    np.testing.assert_array_equal(again.contacts["c"].force, kept.contacts["c"].force)
    with pytest.raises(pc.TrajectoryError, match="dense_output=True"):
        again.sol(0.05)
    for given in ({"method": "Moreau"}, {"fallback": "Moreau"}):
        with pytest.raises(pc.ArgumentError, match="dense_output is for the event-driven methods"):
            pc.simulate(scene, state, 0.1, dense_output=True, **given)


def test_controls_user_events_and_other_runs_in_between():
    """A control is asked again for the torques; a run that ends at an event has none beyond; other runs of the scene
    leave it alone."""
    scene, state = ball([0, 0, 0, 0, 0, 0])

    def push(t, q, v):
        return np.array([math.sin(3.0 * t), 0, 0, 0, 0, 0])

    def far(t, q, v):
        return q[0] - 0.02

    far.terminal = True
    run = pc.simulate(scene, state, 2.0, control=push, events=far, dense_output=True)
    assert run.status == 1 and run.events[-1].kind == "user"
    end = run.events[-1].time
    before = run.sol(0.7 * end).q.tolist()
    # the event was located to the accuracy of the run
    np.testing.assert_allclose(run.sol(end).q, run.q[-1], atol=1e-14)
    assert run.sol(end).q[0] == pytest.approx(0.02, abs=1e-10)
    with pytest.raises(pc.ArgumentError, match="t must lie in"):
        run.sol(end + 1e-6)
    pc.simulate(scene, scene.initial_state([1, 2, 0.1, 0, 0, 0, 1], [1.0, 0, 0, 0, 0, 0]), 0.3)
    sample = run.sol([0.7 * end])
    assert sample.q[0].tolist() == before
    # rolling under a force F through the centre, which turns with the ball: friction is 2/7 of its horizontal part,
    # since the inertia is that of a solid ball
    along = math.sin(2.1 * end) * math.cos(sample.q[0, 0] / 0.1)
    assert sample.contacts["c"].force[0, 0] == pytest.approx(2.0 / 7.0 * along, rel=1e-9)


def test_a_run_that_fails_has_what_there_is():
    scene, state = ball([1.0, 0, 0, 0, 0, 0])
    run = pc.simulate(scene, state, 5.0, dense_output=True, max_steps=4)
    assert run.status < 0
    np.testing.assert_allclose(run.sol(run.t[-1]).q, run.q[-1], atol=1e-12)
    with pytest.raises(pc.ArgumentError, match="t must lie in"):
        run.sol(5.0)

    def control(t, q, v):
        if t > 0.05:
            raise KeyError("no more")
        return np.zeros(6)

    with pytest.raises(KeyError) as caught:
        pc.simulate(scene, state, 5.0, dense_output=True, control=control)
    np.testing.assert_allclose(caught.value.run.sol(caught.value.run.t[-1]).q, caught.value.run.q[-1], atol=1e-12)


def test_random_scenes():
    """With all joints, laws, motions, joint limits, dry friction and torques: as outputs are, and nothing left out."""
    kinds = set()
    for seed in range(40, 54):
        scene, state, control = random_scene(seed)
        t = state.t + np.linspace(0.0, 0.4, 33)
        run = pc.simulate(scene, state, 0.4, t_eval=t, control=control, rtol=1e-7, atol=1e-9, dense_output=True)
        kinds |= {event.kind for event in run.events}
        ends = np.array([(piece.start, piece.end) for piece in run._dense._pieces])
        np.testing.assert_allclose(ends[1:, 0], ends[:-1, 1], rtol=1e-15, atol=1e-300)
        assert run.status == 0 and ends[-1, 1] == t[-1]
        # at a start that is an event, outputs are what was before, and there are no steps before
        sample = run.sol(t[1:])
        np.testing.assert_allclose(sample.q, run.q[1:], atol=1e-6)
        for name, track in run.contacts.items():
            close = np.abs(sample.contacts[name].force - track.force[1:]).max(axis=1) < 1e-5 * (
                1.0 + np.abs(track.force).max()
            )
            # forces jump at events, and what is next to one may be on its other side
            assert close.mean() > 0.9, seed
    assert kinds >= {"touch", "slip", "stick"}


def test_redundant_forces_are_those_of_the_run():
    """Four corners that stick under a growing push: some reach their limits before all do, and the run chooses forces
    that hold, which are part of what a step depends on."""
    scene, _ = sliding_block()
    state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1])
    weight = sum(inertia.mass for inertia in scene.model.inertias) * G

    def push(t, q, v):
        return np.array([0.4 * weight * t, 0, 0, 0, 0, 0.01 * weight * t])

    run = pc.simulate(scene, state, 0.9, control=push, dense_output=True)
    assert run.status == 0 and run.stats["redistributions"] == 1
    # what was chosen late does not act early
    early = pc.simulate(scene, state, 0.4, control=push)
    for name, track in run.sol(0.4).contacts.items():
        np.testing.assert_allclose(track.force, early.contacts[name].force[-1], atol=1e-9 * weight)
    t = np.linspace(0.0, 0.9, 181)
    tracks = run.sol(t).contacts
    total = sum(track.force_on(name) for name, track in tracks.items())
    np.testing.assert_allclose(total[:, 0], -0.4 * weight * t, atol=1e-9 * weight)
    np.testing.assert_allclose(total[:, 2], weight, rtol=1e-9)
    for track in tracks.values():
        assert (track.mode == 1).all()
        assert (track.tangential_force <= 0.4 * track.normal_force * (1.0 + 1e-9)).all()
        # the push is linear in time, and so are the forces but where they were chosen anew
        bends = np.abs(np.diff(track.force, 2, axis=0)).max(axis=1) > 1e-7 * weight
        assert np.count_nonzero(bends) <= 2


def push_round(loop, end):
    """A block's corners, with friction as it is and a hundred times it, under a push that grows and goes round."""
    scene, _ = sliding_block()
    rough = pc.Scene.from_urdf(ROOT / "urdf" / "block.urdf", floating_base=True)
    rough.add_contours_from_collision(links=["block"], kinds=["corners"])
    floor = rough.add_contour("floor", pc.Plane())
    for corner in scene.contacts:
        rough.add_contact(corner, corner, floor, friction=pc.Coulomb(40.0))
    weight = sum(inertia.mass for inertia in scene.model.inertias) * G
    t = np.linspace(0.0, end, 96)

    def push(t, q, v):
        return 0.4 * weight * t * np.array([math.cos(loop * t), math.sin(loop * t), 0, 0, 0, 0.02 + 0.01 * loop * t])

    options = {"control": push, "t_eval": t, "rtol": 1e-6, "atol": 1e-8, "dense_output": True}
    runs = []
    for one in (scene, rough):
        runs.append(pc.simulate(one, one.initial_state([0, 0, 0.1, 0, 0, 0, 1]), end, **options))
        assert runs[-1].status == 0
    return runs, np.array([push(time, None, None)[:3] for time in t]), weight


def test_choices_among_forces_that_move_nothing_take_no_steps():
    (run, rough), _, _ = push_round(3.0, 0.95)
    assert run.stats["redistributions"] == 2 and rough.stats["redistributions"] == 0
    assert not run.events
    assert [run.stats[name] for name in ("steps", "rejected")] == [rough.stats[name] for name in ("steps", "rejected")]
    np.testing.assert_allclose(run.q, rough.q, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("loop", [8.0, 20.0])
def test_redundant_forces_of_outputs_are_those_of_their_times(loop):
    """Each choice goes with the loads, and is in force from when it was made."""
    (run, _), pushed, weight = push_round(loop, 0.95)
    assert run.stats["redistributions"] >= 8
    for tracks in (run.contacts, run.sol(run.t).contacts):
        stick = np.all([track.mode == 1 for track in tracks.values()], axis=0)
        assert np.count_nonzero(stick) > 60
        total = sum(track.force_on(name) for name, track in tracks.items())
        wanted = [0.0, 0.0, weight] - pushed
        np.testing.assert_allclose(total[stick], wanted[stick], rtol=0.0, atol=1e-6 * weight)
        for track in tracks.values():
            # the accuracy of dense output, by which the times of choices are found
            assert (track.tangential_force <= 0.4 * track.normal_force + 1e-6 * weight).all()


@pytest.mark.parametrize("angle", np.linspace(0.1, 6.1, 7))
def test_friction_at_the_end_of_slip(angle):
    """At the very event v_c is round-off and has no direction: friction is against the slip before it all the same."""
    scene, state = ball([math.cos(angle), math.sin(angle), 0, 0, 0, 0])
    run = pc.simulate(scene, state, 0.3, dense_output=True, rtol=1e-6, atol=1e-8)
    (event,) = run.events
    for t in (event.time, np.nextafter(event.time, 0.0), 0.5 * event.time):
        friction = run.sol(t).contacts["c"].force_on("ball")[:2]
        np.testing.assert_allclose(friction, -MU * 0.5 * G * np.array([math.cos(angle), math.sin(angle)]), atol=1e-6)


@pytest.mark.parametrize("method", ["DOP853", "Sharp98", "RK45"])
def test_nothing_touches(method):
    """Steps are what they are without dense output, where no contact is put back on its constraints, too: after the
    extra stages the next step begins with the slope at its start."""
    model = pin.buildSampleModelManipulator()
    scene = pc.Scene(model)
    state = scene.initial_state(np.linspace(-0.5, 0.5, model.nq))
    plain = pc.simulate(scene, state, 0.5, method=method)
    ends = plain.t[len(plain.t) // 2 :]
    for options in ({"dense_output": True}, {"t_eval": ends}, {"t_eval": np.sort(np.r_[ends, ends[:-1] + 1e-3])}):
        run = pc.simulate(scene, state, 0.5, method=method, **options)
        assert run.stats["steps"] == plain.stats["steps"]
        np.testing.assert_array_equal(run.q[-1], plain.q[-1])
