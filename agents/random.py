"""Uniformly random actions, the weakest baseline."""

import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy

from tb2rl import Agent

AGENT = Agent(algorithm=None, policy="tb2rl.agents.random:RandomPolicy", observation="discrete")


class RandomPolicy(BasePolicy):
    """Draws actions from torch's global generator, also with `deterministic=True`."""

    def _predict(self, observation: th.Tensor, deterministic: bool = False) -> th.Tensor:
        num_envs = len(next(iter(observation.values())) if isinstance(observation, dict) else observation)
        if isinstance(self.action_space, spaces.Discrete):
            return th.randint(int(self.action_space.n), (num_envs,))
        low, high = th.as_tensor(self.action_space.low), th.as_tensor(self.action_space.high)
        return low + (high - low) * th.rand((num_envs, *self.action_space.shape))
