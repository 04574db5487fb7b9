"""Copies of environments, and environments sent to a process: each goes its own way."""

import copy
import gc
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.envs.vector_env import TurtleBot2VectorEnv
from tb2rl.simulation.bullet.client import pybullet
from tb2rl.tasks.wander import Wander

STEPS = 200


@pytest.fixture(params=("bullet", "kinematic"))
def env(request):
    """A wandering robot with a noisy laser, in the middle of its episode."""
    env = _made(request.param)
    yield env
    env.close()


@pytest.fixture
def without_gc():
    """Only the number of references frees what is dropped: there is no reference cycle."""
    gc.disable()
    yield
    gc.enable()


def _made(simulation):
    env = gym.make("tb2rl:TurtleBot2Maze-v0", simulation=simulation, laser_noise=0.01, observation="raw")
    env.reset(seed=3)
    follow(env, range(40))
    return env


def follow(env, numbers):
    """What the robot meets by a rule that turns away from walls, a little different for each of the `numbers`."""
    seen = []
    for number in numbers:
        ranges = env.unwrapped.robot_state.ranges[0]
        action = 0 if ranges[12:24].min() > 0.8 + 0.01 * (number % 7) else 1 + (number // 40) % 2
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append(np.concatenate([observation, info["pose"], [reward]]))
        if terminated or truncated:
            seen.append(env.reset()[0])
    return np.concatenate(seen)


def test_copies_drive_as_each_would_alone(env):
    alone = follow(_made(env.unwrapped.spec.kwargs["simulation"]), range(100, 100 + STEPS))
    other = follow(_made(env.unwrapped.spec.kwargs["simulation"]), range(900, 900 + STEPS))
    twin = copy.deepcopy(env)
    both = [(follow(env, [100 + i]), follow(twin, [900 + i])) for i in range(STEPS)]
    np.testing.assert_array_equal(np.concatenate([mine for mine, _ in both]), alone)
    np.testing.assert_array_equal(np.concatenate([its for _, its in both]), other)
    assert not np.array_equal(alone[:1000], other[:1000])


@pytest.mark.parametrize("simulation", ["bullet", pytest.param("kinematic", marks=pytest.mark.slow)])
def test_one_that_is_sent_to_a_process_drives_on_there(simulation):
    env = _made(simulation)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        there = pool.submit(follow, env, range(STEPS)).result()
    np.testing.assert_array_equal(there, follow(env, range(STEPS)))


def test_the_end_of_one_is_not_the_end_of_the_other(env):
    twin = pickle.loads(pickle.dumps(env))
    expected = follow(copy.deepcopy(env), range(50))
    env.close()
    np.testing.assert_array_equal(follow(twin, range(50)), expected)
    twin.close()


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_before_a_reset_and_after_the_end_there_are_copies_too(simulation, make):
    env = make("maze", simulation=simulation)
    twin = copy.deepcopy(env)
    closed = copy.deepcopy(env)
    closed.close()
    for one in (twin, copy.deepcopy(closed)):
        np.testing.assert_array_equal(one.reset(seed=1)[1]["pose"], env.reset(seed=1)[1]["pose"])
        one.close()


def test_a_restored_environment_is_copied_from_there(make):
    env = make("maze", "raw", laser_noise=0.01)
    env.reset(seed=3)
    follow(env, range(10))
    env.restore(env.state())
    follow(env, range(10))
    np.testing.assert_array_equal(follow(copy.deepcopy(env), range(60)), follow(env, range(60)))


def test_one_with_a_window_is_not_copied(make):
    env = make("maze")
    env.simulator._window = True
    with pytest.raises(InputError, match="window cannot be copied"):
        copy.deepcopy(env)


@pytest.mark.parametrize(
    "made",
    [
        tb2rl.make_env,
        lambda: gym.make("tb2rl:TurtleBot2Maze-v0", render_mode="rgb_array"),
        lambda: copy.deepcopy(tb2rl.make_env()),
        lambda: pickle.loads(pickle.dumps(tb2rl.make_env())),
    ],
)
def test_one_that_is_dropped_frees_its_client(made, without_gc):
    env = made()
    env.reset(seed=0)
    env.step(0)
    client = env.unwrapped.simulation._client
    assert pybullet.isConnected(client)
    del env
    assert not pybullet.isConnected(client)


def test_a_forked_process_does_not_disconnect_the_client_of_its_parent(monkeypatch, without_gc):
    env = tb2rl.make_env()
    client = env.simulator._client
    with monkeypatch.context() as forked:
        forked.setattr("os.getpid", lambda: -1)
        del env
    assert pybullet.isConnected(client)
    pybullet.disconnect(client)


@pytest.mark.parametrize("kind", [TurtleBot2VecEnv, TurtleBot2VectorEnv])
def test_a_batch_is_copied(kind):
    batch = kind(make_scene(Wander(laser_noise=0.01, episode_steps=40), "raw"), 30)
    batch.reset()
    rng = np.random.default_rng(0)
    for _ in range(20):
        batch.step(rng.integers(3, size=30))
    twin = copy.deepcopy(batch)
    actions = rng.integers(3, size=(60, 30))
    mine = [batch.step(chosen)[0].copy() for chosen in actions]
    np.testing.assert_array_equal(mine, [twin.step(chosen)[0] for chosen in actions])


@pytest.mark.parametrize("copied", [copy.deepcopy, pickle.dumps])
def test_worlds_of_pybullet_in_processes_are_not_copied(copied):
    envs = TurtleBot2VecEnv(make_scene(Wander(), "raw"), 2, simulation="bullet")
    with closing(envs), pytest.raises(InputError, match="worlds in processes cannot be copied"):
        copied(envs)
