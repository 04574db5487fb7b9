"""Actions by chance: what every learner must beat."""

from __future__ import annotations

from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy

from tb2rl.registry import Agent

AGENT = Agent(algorithm=None, policy="tb2rl.agents.random:RandomPolicy", observation="discrete")


class RandomPolicy(BasePolicy):
    """Each action as likely as any other, from a stream of its own; it knows no greedy mode."""

    def __init__(self, observation_space: spaces.Space, action_space: spaces.Discrete, **kwargs: Any) -> None:
        super().__init__(observation_space, action_space, **kwargs)
        self._rng = th.Generator().manual_seed(0)

    def _predict(self, observation: th.Tensor, deterministic: bool = False) -> th.Tensor:
        return th.randint(int(self.action_space.n), (len(observation),), generator=self._rng)
