"""Environments in processes behave as environments in this one."""

from __future__ import annotations

import multiprocessing
import multiprocessing.spawn
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from tb2rl.envs.make import make_env
from tb2rl.envs.processes import ProcessVecEnv, main_hidden, process_context
from tb2rl.envs.scene import make_scene
from tb2rl.envs.single import TurtleBot2Env
from tb2rl.errors import InputError
from tb2rl.tasks.wander import Wander

cloudpickle.register_pickle_by_value(sys.modules[__name__])  # other processes cannot import it


class Numbered(gym.Env):
    """An environment that knows its number; action 1 fails in the odd ones."""

    observation_space, action_space = gym.spaces.Box(-1, 99, (1,), np.float64), gym.spaces.Discrete(2)

    def __init__(self, number: int) -> None:
        self.number, self.mark = number, None

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.array([float(self.number)]), {}

    def step(self, action):
        if action == 1 and self.number % 2:
            raise ValueError(f"environment {self.number} fails")
        return np.array([float(self.number)]), float(self.number), False, False, {"number": self.number}

    def plus(self, term: int, factor: int = 1) -> int:
        return self.number + term * factor


class Counting(gym.Env):
    """An environment that counts its steps, and says in which process it is."""

    observation_space, action_space = gym.spaces.Box(-1, 99, (1,), np.float64), gym.spaces.Discrete(2)
    steps = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1), {}

    def step(self, action):
        self.steps += 1
        return np.full(1, float(self.steps)), float(self.steps), False, False, {"process": os.getpid()}


class Uncopied(Counting):
    """Its infos say what must not be done with them."""

    def __deepcopy__(self, memo):
        pytest.fail("copied")

    def step(self, action):
        *step, info = super().step(action)
        return *step, {**info, "environment": self}


def maker_of(task=Wander, observation="discrete") -> partial:
    """A function that makes an environment of a scene which is made here, as that of a training."""
    return partial(make_monitored, make_scene(task(episode_steps=25, noise=0.01), observation))


def make_monitored(scene) -> gym.Env:
    return Monitor(TurtleBot2Env(scene))


def numbered(count: int, processes: int) -> ProcessVecEnv:
    return ProcessVecEnv([partial(Numbered, number) for number in range(count)], processes)


def assert_the_same(one, other) -> None:
    """Of answers to `reset` or `step`; "episode" holds the wall-clock time."""
    for answer in (one, other):
        if isinstance(answer, tuple):
            for info in answer[3]:
                info.pop("episode", None)
    np.testing.assert_equal(other, one)


def assert_equal_to_environments_in_this_process(maker, steps=200):
    here, there = DummyVecEnv([maker] * 3), ProcessVecEnv([maker] * 3, processes=2)
    assert (here.observation_space, here.action_space) == (there.observation_space, there.action_space)
    here.seed(7), there.seed(7)
    assert_the_same(here.reset(), there.reset())
    rng, endings = np.random.default_rng(0), []
    for _ in range(steps):
        actions = rng.integers(3, size=3)
        got = there.step(actions)
        endings += [info["ended"] for info in got[3] if info["ended"]]
        assert_the_same(here.step(actions), got)
    here.close(), there.close()
    return set(endings)


def test_three_environments_in_two_processes_do_what_they_do_in_this_one():
    assert assert_equal_to_environments_in_this_process(maker_of()) == {"crash", "time limit"}


def test_so_do_environments_with_images(image_task):
    assert assert_equal_to_environments_in_this_process(maker_of(image_task, "raw"), steps=40)


def test_environments_of_one_seed_start_in_different_places():
    env = ProcessVecEnv([maker_of()] * 3, processes=2)
    env.seed(7)
    env.reset()
    _, _, _, infos = env.step(np.zeros(3, int))
    env.close()
    assert len({tuple(info["pose"]) for info in infos}) == 3


def test_this_process_has_the_first_share_and_waits_for_nobody_meanwhile():
    env = ProcessVecEnv([Counting] * 4, processes=2)
    env.reset()
    _, _, _, infos = env.step(np.zeros(4, int))
    env.close()
    where = [info["process"] for info in infos]
    assert where[:2] == [os.getpid()] * 2
    assert where[2] == where[3] != os.getpid()


@pytest.mark.parametrize("processes", [1, 2])
def test_a_step_does_not_overwrite_what_the_last_one_returned(processes):
    env = ProcessVecEnv([Counting] * 2, processes)
    env.reset()
    first, second = (env.step(np.zeros(2, int)) for _ in range(2))
    env.close()
    for before, after in zip(first[:2], second[:2], strict=True):
        assert before.ravel().tolist() == [1, 1]
        assert after.ravel().tolist() == [2, 2]


def test_infos_are_not_copied_on_their_way():
    env = ProcessVecEnv([Uncopied], processes=1)
    env.reset()
    _, _, _, infos = env.step(np.zeros(1, int))
    assert [info["environment"].steps for info in infos] == [1]
    env.close()


@pytest.mark.parametrize("processes", [1, 2, 9])
def test_attributes_and_methods_go_to_the_environments_that_are_meant(processes):
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


def test_an_exception_in_an_environment_arrives_in_the_caller_and_the_others_live_on():
    env = numbered(4, 4)
    env.reset()
    with pytest.raises(ValueError, match="environment 1 fails"):
        env.step(np.ones(4, int))
    with pytest.raises(AttributeError, match="no_such_name"):
        env.get_attr("no_such_name")
    assert env.reset()[:, 0].tolist() == [0, 1, 2, 3]
    assert env.get_attr("number") == [0, 1, 2, 3]
    env.close()


def test_an_environment_that_cannot_be_made_says_why_and_leaves_no_process():
    before = set(multiprocessing.active_children())
    with pytest.raises(InputError, match="'lop'"):
        ProcessVecEnv([partial(make_env, world="lop")] * 2, processes=2)
    assert set(multiprocessing.active_children()) <= before


def test_close_ends_the_processes():
    before = set(multiprocessing.active_children())
    env = numbered(3, 2)
    started = set(multiprocessing.active_children()) - before
    assert len(started) == 1  # the other share is in this process
    env.close()
    assert not started & set(multiprocessing.active_children())
    env.close()  # once more does no harm


def test_only_on_linux_processes_come_from_a_fork(monkeypatch):
    assert process_context().get_start_method() == ("forkserver" if sys.platform == "linux" else "spawn")
    monkeypatch.setattr(sys, "platform", "darwin")
    assert process_context().get_start_method() == "spawn"


@pytest.mark.slow
def test_processes_that_start_anew_serve_as_well(monkeypatch):
    monkeypatch.setattr("tb2rl.envs.processes.process_context", lambda: multiprocessing.get_context("spawn"))
    env = ProcessVecEnv([partial(make_env, simulation="kinematic")] * 2, processes=2)
    env.reset()
    _, rewards, _, infos = env.step(np.zeros(2, dtype=int))
    env.close()
    assert (rewards.shape, len(infos)) == ((2,), 2)


def test_the_users_script_is_hidden_from_new_processes_and_from_nobody_else(monkeypatch):
    main = sys.modules["__main__"]
    monkeypatch.setattr(main, "__file__", "/home/ada/script.py", raising=False)
    monkeypatch.setattr(main, "__spec__", None)

    def scripts():
        return [key for key in multiprocessing.spawn.get_preparation_data("one") if key.startswith("init_main")]

    with ThreadPoolExecutor(1) as other, main_hidden():
        assert scripts() == []
        assert (main.__file__, other.submit(scripts).result()) == ("/home/ada/script.py", ["init_main_from_path"])
    assert scripts() == ["init_main_from_path"]
