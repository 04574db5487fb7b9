"""Small environments in which values can be worked out by hand."""

from __future__ import annotations

import gymnasium as gym
import pytest
from stable_baselines3.common.monitor import Monitor


class Drive(gym.Env):
    """Two steps, whatever the action: state 0 to 1 for +5, 1 to 2 for -200, and there the episode ends."""

    def __init__(self, ends: str = "terminated", actions: int = 1) -> None:
        self.observation_space, self.action_space = gym.spaces.Discrete(3), gym.spaces.Discrete(actions)
        self.ends = ends

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = 0
        return self.state, {}

    def step(self, action):
        self.state += 1
        over = self.state == 2
        reward = -200.0 if over else 5.0
        return self.state, reward, over and self.ends == "terminated", over and self.ends == "truncated", {}


class Bandit(gym.Env):
    """Episodes of one step from the only state; action 0 pays 1, action 1 pays 2, and so on."""

    def __init__(self, actions: int = 1) -> None:
        self.observation_space, self.action_space = gym.spaces.Discrete(1), gym.spaces.Discrete(actions)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return 0, {}

    def step(self, action):
        return 0, 1.0 + action, True, False, {}


@pytest.fixture
def drive():
    """The class `Drive`."""
    return Drive


@pytest.fixture
def bandit():
    """The class `Bandit`."""
    return Bandit


@pytest.fixture
def frozen_lake():
    """A function that makes Gymnasium's frozen lake."""
    return lambda slippery=False: Monitor(gym.make("FrozenLake-v1", is_slippery=slippery))


@pytest.fixture
def epsilons():
    """A function from a learner and steps to epsilon at the choice of each action."""

    def of(model, steps, **arguments):
        seen = []
        model.learn(steps, callback=lambda local, _: seen.append(local["self"].exploration_rate) or True, **arguments)
        return seen

    return of
