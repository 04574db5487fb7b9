"""Observations and rewards, normalised by all that a training has met so far: `VecNormalize` of Stable-Baselines3.

The environments of a training normalise what they return. A policy that drives elsewhere does it by itself, with the
statistics that every checkpoint holds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import NUMBERS
from tb2rl.envs.features import InverseRange
from tb2rl.runs.config import TrainSettings

_LARGEST = 1e12  # of any mean or variance


def normalised(env: VecEnv, settings: TrainSettings) -> VecEnv:
    """The environments of a training, which normalise what `norm_obs` and `norm_reward` say.

    Raises:
        InputError: If there are no numbers among the observations, but classes or images.
    """
    if not settings.norm_obs and not settings.norm_reward:
        return env
    space, keys = env.observation_space, None
    if settings.norm_obs:
        parts = space.spaces if isinstance(space, spaces.Dict) else {"": space}
        numbers = [key for key, part in parts.items() if isinstance(part, spaces.Box) and not is_image_space(part)]
        if not numbers:
            raise InputError("train.norm_obs normalises numbers, and here classes or images are observed; leave it out")
        keys = numbers if isinstance(space, spaces.Dict) else None
    return VecNormalize(env, norm_obs=settings.norm_obs, norm_reward=settings.norm_reward, norm_obs_keys=keys)


def agree(algorithm: BaseAlgorithm) -> None:
    """Discount returns as the agent does; called once, when there is one.

    Raises:
        InputError: If its network takes the observations for metres.
    """
    env = algorithm.get_vec_normalize_env()
    if env is None:
        return
    env.gamma = getattr(algorithm, "gamma", env.gamma)
    if env.norm_obs and any(isinstance(module, InverseRange) for module in algorithm.policy.modules()):
        raise InputError(
            "train.norm_obs does not go with Nearness, which reads metres; set "
            "agent.policy_kwargs.features_extractor_class=stable_baselines3.common.torch_layers:FlattenExtractor "
            "and agent.policy_kwargs.features_extractor_kwargs=null"
        )


def statistics_of(algorithm: BaseAlgorithm) -> dict[str, Any]:
    """Mean, variance and count of all that was met, a tree for `write_checkpoint`; empty if nothing is normalised."""
    env = algorithm.get_vec_normalize_env()
    if env is None:
        return {}
    observations = {name: _tree(met) for name, met in _met(env).items()}
    return {"observations": observations, "rewards": _tree(env.ret_rms)}


def load_statistics(algorithm: BaseAlgorithm, tree: Any) -> None:
    """Put the statistics of a checkpoint back.

    Raises:
        ValueError: If they are not those of such an algorithm.
    """
    env = algorithm.get_vec_normalize_env()
    if env is None:
        return
    met = _met(env)
    if not isinstance(tree, Mapping) or tree["observations"].keys() != met.keys():
        raise ValueError("it lacks the statistics of train.norm_obs or train.norm_reward")
    for name, one in met.items():
        _fill(one, tree["observations"][name], name)
    _fill(env.ret_rms, tree["rewards"], "rewards")


def _met(env: VecNormalize) -> dict[str, RunningMeanStd]:
    """What it has met of each part of the observations that it normalises; numbers alone have the name of numbers."""
    if not env.norm_obs:
        return {}
    return env.obs_rms if isinstance(env.obs_rms, dict) else {NUMBERS: env.obs_rms}


def _tree(met: RunningMeanStd) -> dict[str, Any]:
    return {"mean": np.asarray(met.mean), "var": np.asarray(met.var), "count": float(met.count)}


def _fill(met: RunningMeanStd, tree: Mapping[str, Any], name: str) -> None:
    mean, var, count = tree["mean"], tree["var"], tree["count"]
    for array in (mean, var):
        if not isinstance(array, np.ndarray) or (array.shape, array.dtype) != (np.shape(met.mean), np.dtype(float)):
            raise ValueError(f"the statistics of the {name} have another shape or type")
        if not (np.abs(array) < _LARGEST).all():
            raise ValueError(f"the statistics of the {name} are not finite, or too large")
    if (var < 0.0).any() or type(count) is not float or not 0.0 < count < math.inf:
        raise ValueError(f"the statistics of the {name} have a negative variance, or no count")
    met.mean, met.var, met.count = mean.copy(), var.copy(), count


def driving_policy(algorithm: BaseAlgorithm) -> BasePolicy:
    """The policy of an algorithm as it drives outside of its training: one that takes observations as they are.

    It shares the networks of the algorithm's own policy, which is given normalised observations.
    """
    env = algorithm.get_vec_normalize_env()
    if env is None or not env.norm_obs:
        return algorithm.policy
    policy = copy(algorithm.policy)
    scales = {name: (met.mean, np.sqrt(met.var + env.epsilon)) for name, met in _met(env).items()}
    policy.obs_to_tensor = _NormaliseFirst(algorithm.policy, scales, env.clip_obs)  # type: ignore[method-assign]
    return policy


@dataclass(frozen=True)
class _NormaliseFirst:
    """The method `obs_to_tensor` of a policy, after what `VecNormalize.normalize_obs` does.

    (That wrapper can be copied, or sent to a process, only once.)
    """

    policy: BasePolicy
    scales: Mapping[str, tuple[np.ndarray, np.ndarray]]  # mean and deviation, by name as in `_met`
    clip: float

    def __call__(self, observation: Any) -> tuple[Any, bool]:
        if not isinstance(observation, dict):
            return self.policy.obs_to_tensor(self._normalised(observation, NUMBERS))
        named = {key: self._normalised(observation[key], key) for key in self.scales}
        return self.policy.obs_to_tensor({**observation, **named})

    def _normalised(self, values: Any, name: str) -> np.ndarray:
        mean, deviation = self.scales[name]
        return np.clip((values - mean) / deviation, -self.clip, self.clip).astype(np.float32)
