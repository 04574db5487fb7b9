"""Copies of environments, and environments sent to a process: each is independent of the original."""

import copy
import gc
import pickle
import subprocess
import sys
from importlib import import_module

import gymnasium as gym
import numpy as np
import pytest

import tb2rl

ACTIONS, OTHERS = np.random.default_rng(0).integers(3, size=(2, 60))


@pytest.fixture(params=("bullet", "mujoco", "kinematic"))
def simulation(request):
    """The name of a simulator."""
    return request.param


@pytest.fixture
def without_gc():
    """Only the number of references frees an object: there is no reference cycle."""
    gc.disable()
    yield
    gc.enable()


def start(simulation):
    """An environment with a noisy laser, in the middle of its episode."""
    env = gym.make("tb2rl:TurtleBot2Maze-v0", simulation=simulation, laser_noise=0.01, observation="raw")
    env.reset(seed=3)
    run(env, [1] * 5)
    return env


def run(env, actions):
    """The observations after each action, across episodes."""
    seen = []
    for action in actions:
        observation, _, terminated, truncated, _ = env.step(action)
        seen.append(env.reset()[0] if terminated or truncated else observation)
    return np.array(seen)


def test_an_environment_and_its_copy_do_not_affect_each_other(simulation):
    one, other = (run(start(simulation), actions) for actions in (ACTIONS, OTHERS))
    env = start(simulation)
    copied = copy.deepcopy(env)
    both = [(run(env, [first]), run(copied, [second])) for first, second in zip(ACTIONS, OTHERS, strict=True)]
    np.testing.assert_array_equal(np.concatenate([seen for seen, _ in both]), one)
    np.testing.assert_array_equal(np.concatenate([seen for _, seen in both]), other)


CONTINUE = """
import pickle, sys
env, actions = pickle.load(open(sys.argv[1], "rb"))
print([env.step(action)[4]["pose"].tolist() for action in actions])
"""


@pytest.mark.slow
def test_an_environment_sent_to_another_process_continues_there(simulation, tmp_path):
    env, actions = start(simulation), [1, 2, 1, 0, 2, 2]
    (tmp_path / "env").write_bytes(pickle.dumps((env, actions)))
    seen = subprocess.check_output([sys.executable, "-c", CONTINUE, tmp_path / "env"], text=True)
    assert seen == f"{[env.step(action)[4]['pose'].tolist() for action in actions]}\n"


def test_a_closed_environment_does_not_close_its_copy(simulation):
    env = start(simulation)
    copied, expected = pickle.loads(pickle.dumps(env)), run(copy.deepcopy(env), ACTIONS)
    env.close()
    np.testing.assert_array_equal(run(copied, ACTIONS), expected)


@pytest.mark.parametrize("make_copy", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_of_an_environment_with_a_page_has_none(make_copy, make):
    env = make("maze", render_mode="human", simulation="kinematic", control_period=0.01)
    env.reset(seed=3)
    copied = make_copy(env)
    assert env.viewer
    assert copied.viewer is None
    np.testing.assert_array_equal(run(copied, ACTIONS), run(env, ACTIONS))


@pytest.mark.bullet
@pytest.mark.parametrize("make_again", [lambda env: env, lambda env: pickle.loads(pickle.dumps(env))])
def test_an_environment_without_references_frees_its_client(make_again, without_gc):
    env = make_again(gym.make("tb2rl:TurtleBot2Maze-v0", render_mode="rgb_array"))
    env.reset(seed=0)
    env.step(0)
    client = env.unwrapped.simulator._client
    pybullet = import_module("pybullet")
    assert pybullet.isConnected(client)
    del env
    assert not pybullet.isConnected(client)


@pytest.mark.bullet
def test_a_forked_process_does_not_disconnect_the_client_of_its_parent(monkeypatch, without_gc):
    env = tb2rl.make_env()
    client, pybullet = env.simulator._client, import_module("pybullet")
    with monkeypatch.context() as forked:
        forked.setattr("os.getpid", lambda: -1)
        del env
    assert pybullet.isConnected(client)
    pybullet.disconnect(client)
