"""Actions by chance: what every learner must beat."""

from __future__ import annotations

import torch as th
from stable_baselines3.common.policies import BasePolicy

from tb2rl.registry import Agent

AGENT = Agent(algorithm=None, policy="tb2rl.agents.random:RandomPolicy", observation="discrete")


class RandomPolicy(BasePolicy):
    """Each action as likely as any other, from torch's random stream; it knows no greedy mode."""

    def _predict(self, observation: th.Tensor, deterministic: bool = False) -> th.Tensor:
        return th.randint(int(self.action_space.n), (len(observation),))
