"""Gymnasium's wrappers of vectors, over the twin's batch and over environments one after the other."""

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium.wrappers import vector

from tb2rl.envs.vector_env import BatchVectorEnv

RAW = "tb2rl:TurtleBot2MazeRaw-v0"


def make(mode=None, env_id=RAW, robots=4):
    return gym.make_vec(
        env_id, num_envs=robots, vectorization_mode=mode, simulation="kinematic", max_episode_steps=9
    )


def drive(envs, steps=30, action=1):
    """What the wrapped environments tell, over the ends of three episodes."""
    with envs:
        seen = [envs.reset(seed=3)[0]]
        told = []
        for _ in range(steps):
            told.append(envs.step(np.full(envs.num_envs, action)))
            seen.append(told[-1][0])
    return seen, told


WRAPPERS = {
    "NumpyToTorch": vector.NumpyToTorch,
}
