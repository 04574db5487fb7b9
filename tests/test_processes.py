"""Worlds in processes behave as worlds in this one."""

from __future__ import annotations

import multiprocessing
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import InputError
from tb2rl.processes import ProcessVecEnv


class Numbered(gym.Env):
    """A world that knows its number; action 1 fails in the odd ones."""

    observation_space, action_space = gym.spaces.Box(-1, 99, (1,), np.float64), gym.spaces.Discrete(2)

    def __init__(self, number: int) -> None:
        self.number, self.mark = number, None

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.array([float(self.number)]), {}

    def step(self, action):
        if action == 1 and self.number % 2:
            raise ValueError(f"world {self.number} fails")
        return np.array([float(self.number)]), float(self.number), False, False, {"number": self.number}

    def plus(self, term: int, factor: int = 1) -> int:
        return self.number + term * factor


def make_world() -> gym.Env:
    return Monitor(TurtleBot2Env(episode_steps=25, noise=0.01))


def numbered(count: int, processes: int) -> ProcessVecEnv:
    return ProcessVecEnv([partial(Numbered, number) for number in range(count)], processes)


def infos_alike(one: dict, other: dict) -> bool:
    np.testing.assert_equal({**one, "episode": None}, {**other, "episode": None})  # "episode" holds the wall-clock time
    return True


def test_three_worlds_in_two_processes_do_what_they_do_in_this_one():
    here, there = DummyVecEnv([make_world] * 3), ProcessVecEnv([make_world] * 3, processes=2)
    assert (here.observation_space, here.action_space) == (there.observation_space, there.action_space)
    here.seed(7), there.seed(7)
    np.testing.assert_array_equal(here.reset(), there.reset())
    rng, endings = np.random.default_rng(0), []
    for _ in range(200):
        actions = rng.integers(3, size=3)
        expected, got = here.step(actions), there.step(actions)
        for one, other in zip(expected[:3], got[:3], strict=True):
            np.testing.assert_array_equal(one, other)
        assert all(infos_alike(one, other) for one, other in zip(expected[3], got[3], strict=True))
        endings += [info["ended"] for info in got[3] if info["ended"]]
    here.close(), there.close()
    assert {"crash", "time limit"} == set(endings)


def test_worlds_of_one_seed_start_in_different_places():
    env = ProcessVecEnv([make_world] * 3, processes=2)
    env.seed(7)
    env.reset()
    _, _, _, infos = env.step(np.zeros(3, int))
    env.close()
    assert len({tuple(info["pose"]) for info in infos}) == 3


@pytest.mark.parametrize("processes", [1, 2, 9])
def test_attributes_and_methods_go_to_the_worlds_that_are_meant(processes):
    env = numbered(5, processes)
    assert env.get_attr("number") == [0, 1, 2, 3, 4]
    assert env.get_attr("number", [4, 0, 3]) == [4, 0, 3]
    assert env.get_attr("number", 3) == [3]
    env.set_attr("mark", "x", [3, 1])
    assert env.get_attr("mark") == [None, "x", None, "x", None]
    assert env.env_method("plus", 10, factor=2) == [20, 21, 22, 23, 24]
    assert env.env_method("plus", 10, indices=[4, 1]) == [14, 11]
    assert env.env_is_wrapped(Monitor) == [False] * 5
    env.reset()
    observations, rewards, _, infos = env.step(np.zeros(5, int))
    assert observations[:, 0].tolist() == rewards.tolist() == [info["number"] for info in infos] == [0, 1, 2, 3, 4]
    env.close()


def test_an_exception_in_a_world_arrives_in_the_caller_and_the_worlds_live_on():
    env = numbered(4, 4)
    env.reset()
    with pytest.raises(ValueError, match="world 1 fails"):
        env.step(np.ones(4, int))
    with pytest.raises(AttributeError, match="no_such_name"):
        env.get_attr("no_such_name")
    assert env.reset()[:, 0].tolist() == [0, 1, 2, 3]
    assert env.get_attr("number") == [0, 1, 2, 3]
    env.close()


def test_a_world_that_cannot_be_made_says_why_and_leaves_no_process():
    before = set(multiprocessing.active_children())
    with pytest.raises(InputError, match="'lop'"):
        ProcessVecEnv([partial(TurtleBot2Env, maze="lop")] * 2, processes=2)
    assert set(multiprocessing.active_children()) <= before


def test_close_ends_the_processes():
    before = set(multiprocessing.active_children())
    env = numbered(3, 2)
    started = set(multiprocessing.active_children()) - before
    assert len(started) == 2
    env.close()
    assert not started & set(multiprocessing.active_children())
    env.close()  # once more does no harm
