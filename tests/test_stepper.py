"""The stepper: the same numbers for the same input, what it hands out, and what it refuses."""

import gc
import math
import os
import pickle
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
from test_moreau import G, ball_scene, block_scene, double_pendulum, joint_scene, upright

import pincontact as pc


def bouncing():
    scene = ball_scene(friction=pc.Coulomb(0.3), restitution=0.6)
    return scene, scene.initial_state(upright(0.0, 0.0, 0.2), np.array([1.0, 0.3, 0.0, 0.0, -3.0, 2.0]), free=["c"])


def torques(n, nv, seed=0):
    return np.random.default_rng(seed).normal(size=(n, nv))


def drive(stepper, taus):
    """All states, as one array (n, nq + nv)."""
    return np.array([np.concatenate([(state := stepper.step(tau)).q, state.v]) for tau in taus])


@pytest.mark.parametrize("make", [bouncing, lambda: block_scene(0.3)])
def test_deterministic_to_the_bit(make):
    scene, state = make()
    taus = torques(60, 6)
    first = drive(pc.Stepper(scene, state), taus)
    np.testing.assert_array_equal(drive(pc.Stepper(scene, state), taus), first)
    assert np.ptp(first[:, 0]) > 0.0


def test_hundreds_of_steps_to_the_bit():
    """Steppers of their own and a copy on the way: all the same, through slip, stick and tipping."""
    scene, state = block_scene(0.4)
    taus = torques(400, 6) * [6.0, 6.0, 3.0, 0.5, 0.5, 0.5]
    stepper = pc.Stepper(scene, state)
    first = drive(stepper, taus)
    other = pc.Stepper(scene, state)
    np.testing.assert_array_equal(drive(other, taus[:173]), first[:173])
    twin = other.copy()
    np.testing.assert_array_equal(drive(twin, taus[173:]), first[173:])
    np.testing.assert_array_equal(drive(other, taus[173:]), first[173:])


def test_steps_allocate_nothing_that_stays():
    """In the steady state memory neither grows nor is there more at work than one step's few small objects."""
    scene, state = block_scene(0.5)
    stepper = pc.Stepper(scene, state)
    # slip to and fro and stick: buffers of all sizes of problems are there after that
    taus = [np.array([15.0, 0, 0, 0, 0, 0.3]), np.array([-15.0, 0, 0, 0, 0, -0.3]), np.zeros(6)]
    for i in range(150):
        stepper.step(taus[i % 3])
    gc.collect()
    # which empties the interpreter's free lists, and is not to do so again
    gc.disable()
    tracemalloc.start()
    try:
        # they fill up again
        for i in range(150):
            stepper.step(taus[i % 3])
        before, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        for i in range(600):
            stepper.step(taus[i % 3])
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        gc.enable()
    # a few objects may be replaced by larger ones; a float a step that stays would be 14,400 bytes
    assert after - before <= 10_000
    # arrays of the central forces among redundant ones are 8 kB of them; what NumPy keeps of small arrays, of which
    # less is seen here the more there is, is 5 kB
    assert peak - before <= 30_000


@pytest.mark.parametrize("make", [bouncing, lambda: block_scene(0.3)])
def test_reset_starts_again(make):
    scene, state = make()
    taus = torques(60, 6)
    stepper = pc.Stepper(scene, state)
    first = drive(stepper, taus)
    stepper.reset(state)
    assert stepper.t == 0.0
    np.testing.assert_array_equal(drive(stepper, taus), first)


@pytest.mark.parametrize("contact_solver", ["auto", "proxqp"])
@pytest.mark.parametrize(
    "duplicate", [pc.Stepper.copy, lambda x: pickle.loads(pickle.dumps(x))], ids=["copy", "pickle"]
)
@pytest.mark.parametrize("make", [bouncing, lambda: block_scene(0.3)])
def test_copies_go_on_alike(make, duplicate, contact_solver):
    scene, state = make()
    taus = torques(120, 6)
    stepper = pc.Stepper(scene, state, contact_solver=contact_solver)
    drive(stepper, taus[:60])
    twin = duplicate(stepper)
    assert twin.t == stepper.t and twin.dt == stepper.dt and repr(twin) == repr(stepper)
    ahead = drive(stepper, taus[60:])
    # the copy has not moved with the original
    assert twin.t == pytest.approx(0.06)
    np.testing.assert_array_equal(drive(twin, taus[60:]), ahead)


def test_a_pickled_stepper_goes_on_in_another_process(tmp_path):
    """To the last bit; what comes from there can be a start here."""
    scene, state = block_scene(0.3)
    taus = torques(80, 6)
    stepper = pc.Stepper(scene, state)
    drive(stepper, taus[:40])
    (tmp_path / "stepper").write_bytes(pickle.dumps((stepper, taus[40:])))
    script = (
        "import pickle, sys\n"
        "stepper, taus = pickle.load(open(sys.argv[1], 'rb'))\n"
        "rows = stepper.rollout(taus)\n"
        "pickle.dump((rows, stepper.state, stepper.forces), open(sys.argv[2], 'wb'))\n"
    )
    paths = [str(tmp_path / name) for name in ("stepper", "result")]
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(filter(None, sys.path)))
    subprocess.run([sys.executable, "-c", script, *paths], check=True, env=environment)
    (q, v), there, forces = pickle.loads((tmp_path / "result").read_bytes())
    here = stepper.rollout(taus[40:])
    np.testing.assert_array_equal(q, here[0])
    np.testing.assert_array_equal(v, here[1])
    assert there.t == stepper.t and forces["foot0"].tolist() == stepper.forces["foot0"].tolist()
    assert pc.Stepper(there.scene, there).step(taus[0]).t > there.t


def test_same_motion_as_simulate():
    scene, state = bouncing()
    stepper = pc.Stepper(scene, state, dt=2e-3)
    run = pc.simulate(scene, state, 1.0, method="Moreau", step=2e-3)
    drive(stepper, np.zeros((500, 6)))
    assert stepper.t == pytest.approx(1.0)
    np.testing.assert_array_equal(stepper.q, run.q[-1])
    np.testing.assert_array_equal(stepper.v, run.v[-1])


@pytest.mark.parametrize("make", [bouncing, lambda: block_scene(0.3)])
def test_several_steps_at_once(make):
    """Touching, slipping and coming to rest within them; more than compiled code makes without coming back."""
    scene, state = make()
    one, several = pc.Stepper(scene, state), pc.Stepper(scene, state)
    modes = []
    for tau, count in zip(torques(12, 6) * 4.0, (1, 2, 7, 30, 90, 300, 1, 1, 600, 30, 5, 1)):
        for _ in range(count):
            alone = one.step(tau)
        together = several.step(tau, count)
        assert together.t == alone.t == one.t == several.t
        for name in ("q", "v", "location", "discrete"):
            np.testing.assert_array_equal(getattr(together, name), getattr(alone, name))
        np.testing.assert_array_equal(several.modes, one.modes)
        for name, force in one.forces.items():
            np.testing.assert_array_equal(several.forces[name], force)
        modes.append(several.modes.tolist())
    assert len({tuple(row) for row in modes}) > 1


def test_several_steps_end_with_the_last_that_could_be_made():
    """A double pendulum is driven until it turns too far in a step."""
    scene = double_pendulum()
    state, tau = scene.initial_state([0.0, 1.0]), np.array([0.0, 5.0])
    one, several = pc.Stepper(scene, state, dt=0.1), pc.Stepper(scene, state, dt=0.1)
    for _ in range(2):
        with pytest.raises(pc.SolverError, match="too long"):
            for _ in range(300):
                one.step(tau)
        with pytest.raises(pc.SolverError, match="too long"):
            several.step(tau, 300)
        assert several.t == one.t > 0.1
        np.testing.assert_array_equal(np.r_[several.q, several.v], np.r_[one.q, one.v])


@pytest.mark.parametrize("make", [bouncing, lambda: block_scene(0.3)])
def test_rollouts_are_steps(make):
    scene, state = make()
    taus = torques(40, 6) * 4.0
    one, whole = pc.Stepper(scene, state), pc.Stepper(scene, state)
    for count in (1, 7, 20):
        q, v = whole.rollout(taus, count)
        assert q.shape == (40, 7)
        assert v.shape == (40, 6)
        for i, tau in enumerate(taus):
            alone = one.step(tau, count)
            np.testing.assert_array_equal(np.r_[q[i], v[i]], np.r_[alone.q, alone.v])
        assert whole.t == one.t
        np.testing.assert_array_equal(whole.modes, one.modes)
        # what was returned is the caller's: the next step does not write into it
        kept = q.copy(), v.copy()
        one.step(taus[0])
        whole.step(taus[0])
        np.testing.assert_array_equal(q, kept[0])
        np.testing.assert_array_equal(v, kept[1])
    # the same numbers in other arrays
    other = pc.Stepper(scene, state)
    first = pc.Stepper(scene, state).rollout(taus)
    for same in (np.asfortranarray(taus), np.repeat(taus, 2, axis=1)[:, ::2], taus.tolist()):
        other.reset(state)
        np.testing.assert_array_equal(other.rollout(same)[0], first[0])


@pytest.mark.parametrize("ask", [lambda s: s.step(np.zeros(6), 3000), lambda s: s.rollout(np.zeros((10, 6)), 300)])
def test_an_interrupt_leaves_the_last_step(ask, monkeypatch):
    """Between the batches of compiled steps, when the ball has come to roll; then it goes on."""
    scene, state = bouncing()
    stepper, other = pc.Stepper(scene, state), pc.Stepper(scene, state)
    run, calls = stepper._step._run, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 8:
            raise KeyboardInterrupt
        return run(*arguments)

    start = stepper.modes.tolist()
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(stepper._step, "_run", interrupted)
        ask(stepper)
    done = round(stepper.t / stepper.dt)
    assert done == 7 * 256
    other.step(np.zeros(6), done)
    assert stepper.modes.tolist() == other.modes.tolist() != start
    for one, two in ((stepper.state, other.state), (stepper.step(np.zeros(6), 300), other.step(np.zeros(6), 300))):
        for name in ("q", "v", "location", "discrete"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_rollouts_check_their_torques():
    scene, state = bouncing()
    stepper = pc.Stepper(scene, state)
    ragged, text, complex_ones = [[0.0], [1.0, 2.0]], [["a"] * 6], np.zeros((2, 6)) * 1j
    for wrong in (np.zeros(6), np.zeros((3, 5)), np.zeros((2, 6, 1)), 0.0, ragged, text, complex_ones):
        with pytest.raises(pc.StateError, match="torques"):
            stepper.rollout(wrong)
    for wrong in (0, 2.5, None):
        with pytest.raises(pc.ArgumentError, match="count"):
            stepper.rollout(np.zeros((3, 6)), wrong)
    assert stepper.t == 0.0
    assert [part.shape for part in stepper.rollout(np.zeros((0, 6)))] == [(0, 7), (0, 6)]
    taus = np.zeros((8, 6))
    taus[5, 3] = math.nan
    with pytest.raises(pc.StateError, match=r"torques\[5, 3\] is nan"):
        stepper.rollout(taus, 2)
    # the rows before it were made
    assert stepper.t == 10 * stepper.dt
    stepper.rollout(np.zeros((2, 6)))
    assert stepper.t == 12 * stepper.dt


def test_rollouts_end_with_the_last_step_that_could_be_made():
    scene = double_pendulum()
    state = scene.initial_state([0.0, 1.0])
    one, several = pc.Stepper(scene, state, dt=0.1), pc.Stepper(scene, state, dt=0.1)
    taus = np.tile([0.0, 5.0], (300, 1))
    with pytest.raises(pc.SolverError, match="too long"):
        one.step(taus[0], 300)
    with pytest.raises(pc.SolverError, match="too long"):
        several.rollout(taus)
    assert several.t == one.t > 0.1
    np.testing.assert_array_equal(several.q, one.q)
    # and a plain step afterwards writes no rows
    for stepper in (one, several):
        stepper.reset(state)
        stepper.step(taus[0])
    np.testing.assert_array_equal(several.q, one.q)


def test_states_are_views_and_copies():
    scene, state = bouncing()
    stepper = pc.Stepper(scene, state)
    view = stepper.step(np.zeros(6))
    kept = stepper.state
    before = kept.q.copy()
    assert np.shares_memory(view.q, stepper.q)
    stepper.step(np.zeros(6))
    np.testing.assert_array_equal(view.q, stepper.q)
    np.testing.assert_array_equal(kept.q, before)
    with pytest.raises(ValueError, match="read-only"):
        view.q[0] = 1.0
    # a state taken out is one to start from, for the other method too
    stepper.reset(kept)
    assert stepper.t == kept.t
    assert pc.simulate(scene, kept, 0.01).status == 0


def test_forces_modes_and_time():
    scene, state = block_scene(0.5)
    stepper = pc.Stepper(scene, state)
    for _ in range(1000):
        stepper.step(np.array([3.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert stepper.t == 1.0
    assert stepper.modes.tolist() == [1, 1, 1, 1]
    total = sum(stepper.forces.values())
    # on the floor, which was named second: the push and the weight
    np.testing.assert_allclose(total, [3.0, 0.0, -2.0 * G], rtol=0.0, atol=1e-12)
    for _ in range(10):
        stepper.step(np.array([12.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert stepper.modes.tolist() == [2, 2, 2, 2]
    np.testing.assert_allclose(sum(stepper.forces.values()), [G, 0.0, -2.0 * G], rtol=0.0, atol=1e-10)
    assert "foot0" in repr(stepper)


def test_forces_follow_the_order_of_naming():
    forces = []
    for order in ((0, 1), (1, 0)):
        scene = ball_scene()
        pair = [scene.contours["ball"], scene.contours["ground"]]
        scene.contacts.clear()
        scene.add_contact("c", pair[order[0]], pair[order[1]])
        stepper = pc.Stepper(scene, scene.initial_state(upright(0.0, 0.0, 0.1)))
        stepper.step(np.zeros(6))
        forces.append(stepper.forces["c"].copy())
    np.testing.assert_allclose(forces, [[0.0, 0.0, -2.0 * G], [0.0, 0.0, 2.0 * G]], rtol=0.0, atol=1e-12)


def test_balances_a_pendulum():
    """A controller in the loop: a mass on a prismatic joint is brought to its target and held."""
    scene = joint_scene(lower=-10.0, upper=10.0)
    stepper = pc.Stepper(scene, scene.initial_state([0.0]))
    for _ in range(5000):
        stepper.step(np.array([G + 25.0 * (0.5 - stepper.q[0]) - 10.0 * stepper.v[0]]))
    assert abs(stepper.q[0] - 0.5) <= 1e-9


def test_torque_is_checked():
    scene, state = bouncing()
    stepper = pc.Stepper(scene, state)
    before = stepper.q.copy()
    for wrong in (np.zeros(5), np.zeros((6, 1)), 0.0):
        with pytest.raises(pc.StateError, match=r"\(6,\)"):
            stepper.step(wrong)
    for value in (math.nan, math.inf, -math.inf):
        tau = np.zeros(6)
        tau[2] = value
        with pytest.raises(pc.StateError, match=r"tau\[2\]"):
            stepper.step(tau)
    with pytest.raises(pc.StateError, match="tau"):
        stepper.step(["a"] * 6)
    np.testing.assert_array_equal(stepper.q, before)
    assert stepper.t == 0.0
    stepper.step([0, 0, 0, 0, 0, 0])


def test_count_is_checked():
    scene, state = bouncing()
    stepper = pc.Stepper(scene, state)
    for wrong in (0, -1, 1.5, math.nan, math.inf, "2", None, np.array([1, 2]), 10**19):
        with pytest.raises(pc.ArgumentError, match="count"):
            stepper.step(np.zeros(6), wrong)
    assert stepper.t == 0.0
    stepper.step(np.zeros(6), np.int64(2))
    stepper.step(np.zeros(6), 1.0)
    assert stepper.t == 3 * stepper.dt


def test_arguments_are_checked():
    scene, state = bouncing()
    for dt in (0.0, -1e-3, math.nan, math.inf, "1e-3"):
        with pytest.raises(pc.ArgumentError, match="dt"):
            pc.Stepper(scene, state, dt=dt)
    with pytest.raises(pc.ArgumentError, match="Scene"):
        pc.Stepper(scene.model, state)
    with pytest.raises(pc.ArgumentError, match="initial_state"):
        pc.Stepper(scene, state.q)
    other, _ = bouncing()
    with pytest.raises(pc.ArgumentError, match="another scene"):
        pc.Stepper(other, state)
    with pytest.raises(pc.ArgumentError, match="another scene"):
        pc.Stepper(scene, state).reset(bouncing()[1])
