"""Policies of Stable-Baselines3 with other networks."""

from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from stable_baselines3.common.utils import obs_as_tensor
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


class AsymmetricPolicy(BoundedPolicy):
    """A `BoundedPolicy` whose critic also observes the sensors of `train.privileged`, which the actor does not need.

    This is the asymmetric actor-critic of Pinto et al. 2018, "Asymmetric Actor Critic for Image-Based Robot Learning".
    `observation_space` is that of the actor, so a trained policy needs no privileged sensors.
    """

    def _build(self, lr_schedule: Any) -> None:
        actor_space: Any = getattr(self.observation_space, "actor_space", None)
        self._is_asymmetric = actor_space is not None
        if self._is_asymmetric:
            self.observation_space, self.share_features_extractor = actor_space, False
            (self._num_actor_numbers,) = actor_space.shape
            self.vf_features_extractor = self.features_extractor
            self.features_extractor = self.pi_features_extractor = self.make_features_extractor()
        super()._build(lr_schedule)

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        if self._is_asymmetric:
            num_features = self.pi_features_extractor.features_dim
            actor = MlpExtractor(num_features, self.net_arch, self.activation_fn, self.device)
            self.mlp_extractor.policy_net = actor.policy_net

    def extract_features(self, obs: Any, features_extractor: Any = None) -> Any:
        """As in Stable-Baselines3; a pair of the features of actor and critic unless both observe the same."""
        if not self._is_asymmetric:
            return super().extract_features(obs, features_extractor)
        return self.pi_features_extractor(obs[:, : self._num_actor_numbers]), self.vf_features_extractor(obs)

    def obs_to_tensor(self, observation: Any) -> tuple[Any, bool]:
        """As in Stable-Baselines3, with or without the privileged numbers."""
        if not self._is_asymmetric or observation.shape[-1] == self._num_actor_numbers:
            return super().obs_to_tensor(observation)
        return obs_as_tensor(np.atleast_2d(observation), self.device), observation.ndim > 1

    def predict_values(self, obs: Any) -> th.Tensor:
        """Values of observations, shape (n, 1); NaN without the privileged numbers."""
        if self._is_asymmetric and obs.shape[1] == self._num_actor_numbers:
            return obs.new_full((len(obs), 1), th.nan)
        return super().predict_values(obs)
