"""Policies of Stable-Baselines3 with other networks."""

from typing import Any

from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn


class BoundedPolicy(ActorCriticPolicy):
    """The `MlpPolicy` of PPO or A2C with the mean of continuous actions between -1 and 1, the limits of actions.

    Without limits, the mean of the speed can fall so far below -1 that the robot stands whatever the noise is: all
    actions then have the same effect, from which nothing can be learned.
    """

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        if isinstance(self.action_space, spaces.Box):
            self.action_net = nn.Sequential(self.action_net, nn.Tanh())
