"""User programs with other libraries, a file for each library."""

import pytest
import torch as th

from tb2rl.runs.config import resolve

TRAIN = {"simulation": "kinematic", "n_envs": 4, "total_timesteps": 128, "save_freq": 64, "keep": 9, "eval_freq": 64}
TRAIN |= {"eval_episodes": 2, "eval_steps": 8, "episode_steps": 8}


@pytest.fixture(autouse=True)
def one_thread_of_torch():
    """Use one thread of torch, because the networks are small and other tests use the processors."""
    number = th.get_num_threads()
    th.set_num_threads(1)
    yield
    th.set_num_threads(number)


@pytest.fixture
def tracked():
    """A function that makes the config of a short training with a tracker."""
    return lambda tracker: resolve(
        settings={f"train.{key}": value for key, value in {**TRAIN, "track": [tracker]}.items()}
    )
