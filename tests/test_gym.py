"""The Gymnasium environment: Gymnasium's own checks, seeds, ends, and many at once."""

import doctest
import importlib
import importlib.util
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc

gymnasium = pytest.importorskip("gymnasium", reason="needs gymnasium: pip install pincontact[gym]")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.wrappers import NormalizeObservation  # noqa: E402

import pincontact.gym  # noqa: E402
from pincontact.gym import ContactEnv  # noqa: E402

ROOT = Path(__file__).parents[1]


def scene_and_state():
    """A ball that rolls along a floor on a rail in x, pushed by a motor with limits."""
    model = pin.Model()
    along = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "along")
    up = model.addJoint(along, pin.JointModelPZ(), pin.SE3.Identity(), "up")
    spin = model.addJoint(up, pin.JointModelRY(), pin.SE3.Identity(), "spin")
    model.appendBodyToJoint(spin, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.effortLimit[:] = 5.0
    scene = pc.Scene(model)
    scene.add_contour("ball", pc.Sphere(0.1), "spin")
    scene.add_contour("floor", pc.Plane())
    scene.add_contact("c", "ball", "floor", pc.Coulomb(0.5))
    return scene, scene.initial_state([0.0, 0.1, 0.0])


def far(stepper):
    return stepper.q[0] > 0.05


def make(**options):
    scene, state = scene_and_state()

    def start(rng):
        return scene.initial_state([rng.uniform(-0.01, 0.01), 0.1, 0.0])

    given = {
        "scene": scene,
        "state": state,
        "joints": ["along"],
        "reward": lambda stepper, tau: stepper.q[0] - 0.01 * tau @ tau,
        "terminate": far,
        "start": start,
        "max_episode_steps": 30,
    }
    return ContactEnv(**{**given, **options})


def episode(env, seed, actions):
    rows = [env.reset(seed=seed)[0]]
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        rows.append(np.r_[observation, reward, terminated, truncated][: len(rows[0])])
        if terminated or truncated:
            break
    return np.array(rows)


ACTIONS = np.random.default_rng(3).uniform(-1, 1, (30, 1))


def test_gymnasium_is_content():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # what it has to say of spaces without bounds, and of what `gymnasium.make` would have wrapped
        warnings.filterwarnings("ignore", message=".*(minimum value is -infinity|maximum value is infinity).*")
        warnings.filterwarnings("ignore", message=".*(not making use of|not assigned with).*")
        check_env(make(), skip_render_check=True)


def test_equal_seeds_are_equal_episodes():
    env = make()
    first = episode(env, 7, ACTIONS)
    assert len(first) > 10
    np.testing.assert_array_equal(episode(env, 7, ACTIONS), first)
    np.testing.assert_array_equal(episode(make(), 7, ACTIONS), first)
    assert np.abs(episode(env, 8, ACTIONS)[0] - first[0]).max() > 1e-4
    # a seed holds for the episodes after it, too
    both = []
    for _ in range(2):
        env.reset(seed=1)
        both.append(env.reset()[0])
    np.testing.assert_array_equal(*both)


def test_actions_are_torques():
    """A force F through the centre of a rolling ball: acceleration 5 F / (7 m), with F = action times 5 N."""
    env = make(terminate=None, start=None)
    env.reset(seed=0)
    for _ in range(10):
        observation, _, terminated, truncated, info = env.step(np.array([0.4]))
    assert not (terminated or truncated) and info == {"t": pytest.approx(0.1)}
    # constant acceleration: exact in time stepping's velocities
    assert observation[3] == pytest.approx(0.1 * 5.0 * 2.0 / 7.0, rel=1e-9)
    np.testing.assert_array_equal(observation, np.r_[env.stepper.q, env.stepper.v])
    # beyond the limits it is the limit
    over = [make(terminate=None, start=None) for _ in range(2)]
    rows = []
    for one, action in zip(over, (1.0, 3.0)):
        one.reset(seed=0)
        rows.append(one.step(np.array([action]))[0])
    np.testing.assert_array_equal(*rows)


def test_ends_of_episodes():
    env = make(start=None)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.array([0.0]))
    env.reset(seed=0)
    ends = []
    while not ends or not any(ends[-1]):
        *_, terminated, truncated, _ = env.step(np.array([1.0]))
        ends.append((terminated, truncated))
    # F = 5 N for 50 mm at 25/7 m/s^2: 0.167 s, which is 17 actions of 10 ms
    assert len(ends) == 17 and ends[-1] == (True, False) and env.stepper.q[0] > 0.05
    with pytest.raises(gymnasium.error.ResetNeeded, match="over"):
        env.step(np.array([0.0]))
    env.reset(seed=0)
    for i in range(30):
        *_, terminated, truncated, info = env.step(np.array([0.0]))
        assert (terminated, truncated) == (False, i == 29)
    assert "failure" not in info


def test_a_step_that_fails_truncates(monkeypatch):
    """The episode is cut off, not lost: the last good state is observed, the reason told, and a reset goes on."""
    env = make()
    env.reset(seed=0)
    good = env.step(np.array([0.3]))[0]
    advance = pc.Stepper.step

    def fails(stepper, tau, count=1):
        raise pc.SolverError("t = 0.01 s: no contact force was found")

    monkeypatch.setattr(pc.Stepper, "step", fails)
    observation, _, terminated, truncated, info = env.step(np.array([0.3]))
    assert (terminated, truncated) == (False, True)
    assert info["failure"] == "t = 0.01 s: no contact force was found." and info["t"] == env.stepper.t
    np.testing.assert_array_equal(observation, good)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.array([0.3]))
    monkeypatch.setattr(pc.Stepper, "step", advance)
    first = episode(env, 7, ACTIONS)
    np.testing.assert_array_equal(episode(make(), 7, ACTIONS), first)


def test_a_scene_that_cannot_go_on_truncates():
    """A real one: a bilateral contact runs off the end of its contour. What is not the scene's is passed on."""
    scene, _ = scene_and_state()
    scene.contacts.clear()
    scene.add_contour("rail", pc.Plane(domain=((-0.02, 0.02), (-1.0, 1.0))))
    scene.add_contact("r", "ball", "rail", None, bilateral=True)
    state = scene.initial_state([0.0, 0.1, 0.0])
    env = make(scene=scene, state=state, start=None, terminate=None)
    env.reset(seed=0)
    done, info = False, {}
    while not done:
        observation, _, terminated, done, info = env.step(np.array([1.0]))
    assert not terminated and "end of a contour" in info["failure"] and info["failure"].endswith(".")
    assert 0.01 < observation[0] <= 0.02 and np.isfinite(observation).all()

    def broken(stepper, tau):
        raise KeyError("mine")

    env = make(reward=broken)
    env.reset(seed=0)
    with pytest.raises(KeyError, match="mine"):
        env.step(np.array([1.0]))


def test_many_at_once_are_the_same_as_one():
    env = make()
    envs = env.vector(3)
    observations, _ = envs.reset(seed=5)
    assert observations.shape == (3, 6) and isinstance(envs, gymnasium.vector.VectorEnv)
    rows = [observations]
    for action in ACTIONS[:8]:
        observations, rewards, terminated, truncated, _ = envs.step(np.tile(action, (3, 1)))
        assert rewards.shape == terminated.shape == truncated.shape == (3,)
        rows.append(observations)
    for i in range(3):
        env.reset(seed=5 + i)
        single = [env.reset(seed=5 + i)[0], *(env.step(action)[0] for action in ACTIONS[:8])]
        np.testing.assert_array_equal(np.array(rows)[:, i], single)
    # a planner's way: all from one state
    state = env.stepper.state
    observations, _ = envs.reset(options={"state": state})
    np.testing.assert_array_equal(observations, np.tile(np.r_[state.q, state.v], (3, 1)))
    # the next episode begins by itself
    for _ in range(31):
        *_, truncated, _ = envs.step(np.zeros((3, 1)))
    assert not truncated.any()


def test_wrappers_of_gymnasium():
    env = NormalizeObservation(make(observe=lambda stepper: stepper.q[:1]))
    observation, _ = env.reset(seed=0)
    assert observation.shape == (1,) and env.observation_space.shape == (1,)
    assert env.unwrapped.stepper.t == 0.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"joints": ["wheel"]}, r"no joint 'wheel'; joints: along, up, spin"),
        ({"joints": []}, "at least one joint"),
        ({"joints": 3}, "names of joints, got 3"),
        ({"joints": [3]}, "no joint 3"),
        ({"joints": "up", "torque_limits": [1.0, 2.0]}, "torque_limits"),
        ({"joints": ["up", "up"]}, "each once"),
        ({"torque_limits": 0.0}, "positive and finite"),
        ({"torque_limits": "1"}, "a number, or 1 of them"),
        ({"torque_limits": np.inf}, "positive and finite"),
        ({"reward": 3}, "reward must be callable"),
        ({"observe": None}, "observe must be callable"),
        ({"terminate": 1}, "terminate must be callable"),
        ({"start": []}, "start must be callable"),
        ({"substeps": 0}, "substeps"),
        ({"max_episode_steps": 2.5}, "max_episode_steps"),
        ({"dt": -1.0}, "dt must be"),
        ({"state": None}, "state must come from"),
        ({"scene": None}, "must be a Scene"),
    ],
)
def test_arguments_are_checked(given, message):
    with pytest.raises(pc.ArgumentError, match=message):
        make(**given)


def test_limits_of_the_model():
    scene, state = scene_and_state()
    scene.model.effortLimit[0] = np.inf
    with pytest.raises(pc.ArgumentError, match="of the model"):
        make(scene=scene, state=state)
    assert make(scene=scene, state=state, torque_limits=2.0).action_space.shape == (1,)


def test_what_is_asked_of_it_is_checked():
    env = make()
    env.reset(seed=0)
    for wrong in ("0", None, np.zeros(2), 0.3, np.array([np.nan]), [[0.1]], [True]):
        with pytest.raises(pc.ArgumentError, match="an action must"):
            env.step(wrong)
    with pytest.raises(pc.ArgumentError, match="'start'"):
        env.reset(options={"start": 3})
    with pytest.raises(pc.ArgumentError, match="another scene"):
        env.reset(options={"state": scene_and_state()[1]})
    with pytest.raises(pc.ArgumentError, match="count"):
        env.vector(0)


def test_without_gymnasium(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "gymnasium", None)
    specification = importlib.util.find_spec("pincontact.gym")
    module = importlib.util.module_from_spec(specification)
    with pytest.raises(pc.MissingExtraError, match=r"pip install pincontact\[gym\]"):
        specification.loader.exec_module(module)


def test_its_example():
    found = doctest.testmod(pincontact.gym)
    assert found.attempted > 10 and found.failed == 0
