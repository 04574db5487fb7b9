"""Running normalization of observations and rewards with `VecNormalize` of Stable-Baselines3.

A training's environments normalize what they return. A policy outside its training normalizes by itself, with the
statistics in its checkpoint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from functools import partial
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

_LARGEST = 1e12  # of any mean or variance


def normalize(env: VecEnv, norm_obs: bool, norm_reward: bool) -> VecEnv:
    """Wrap environments in `VecNormalize` if observations or rewards are to be normalized.

    Raises:
        InputError: If observations are to be normalized but hold only classes or images.
    """
    if not norm_obs and not norm_reward:
        return env
    space, keys = env.observation_space, None
    if norm_obs:
        parts = space.spaces if isinstance(space, spaces.Dict) else {"": space}
        boxes = [key for key, part in parts.items() if isinstance(part, spaces.Box) and not is_image_space(part)]
        if not boxes:
            raise InputError("train.norm_obs normalises numbers, and here classes or images are observed; leave it out")
        keys = boxes if isinstance(space, spaces.Dict) else None
    return VecNormalize(env, norm_obs=norm_obs, norm_reward=norm_reward, norm_obs_keys=keys)


def sync_gamma(algorithm: BaseAlgorithm) -> None:
    """Use the agent's gamma in `VecNormalize`."""
    if env := algorithm.get_vec_normalize_env():
        env.gamma = getattr(algorithm, "gamma", env.gamma)


def check_features(algorithm: BaseAlgorithm) -> None:
    """Raise an `InputError` if a feature extractor needs ranges in metres, but observations are normalized."""
    env = algorithm.get_vec_normalize_env()
    if env and env.norm_obs and any(isinstance(module, InverseRange) for module in algorithm.policy.modules()):
        raise InputError(
            "train.norm_obs does not go with InverseRange, which reads metres; set "
            "agent.policy_kwargs.features_extractor_class=stable_baselines3.common.torch_layers:FlattenExtractor "
            "and agent.policy_kwargs.features_extractor_kwargs=null"
        )


def statistics_of(algorithm: BaseAlgorithm) -> dict[str, Any]:
    """Mean, variance and count of observations and rewards, for a checkpoint; empty if nothing is normalized."""
    env = algorithm.get_vec_normalize_env()
    if env is None:
        return {}
    observations = {key: _tree(statistics) for key, statistics in _by_key(env).items()}
    return {"observations": observations, "rewards": _tree(env.ret_rms)}


def load_statistics(algorithm: BaseAlgorithm, tree: Any) -> None:
    """Restore the statistics of a checkpoint.

    Raises:
        ValueError: If they do not fit the algorithm.
    """
    env = algorithm.get_vec_normalize_env()
    if env is None:
        return
    present = _by_key(env)
    if not isinstance(tree, Mapping) or tree["observations"].keys() != present.keys():
        raise ValueError("it lacks the statistics of train.norm_obs or train.norm_reward")
    for key, statistics in present.items():
        _load(statistics, tree["observations"][key], key)
    _load(env.ret_rms, tree["rewards"], "rewards")


def _by_key(env: VecNormalize) -> dict[str, RunningMeanStd]:
    """Running statistics, by observation key."""
    if not env.norm_obs:
        return {}
    return env.obs_rms if isinstance(env.obs_rms, dict) else {NUMBERS: env.obs_rms}


def _tree(statistics: RunningMeanStd) -> dict[str, Any]:
    count = float(statistics.count)
    return {"mean": np.asarray(statistics.mean), "var": np.asarray(statistics.var), "count": count}


def _load(statistics: RunningMeanStd, tree: Mapping[str, Any], name: str) -> None:
    mean, var, count = tree["mean"], tree["var"], tree["count"]
    for array in (mean, var):
        expected = np.shape(statistics.mean), np.dtype(float)
        if not isinstance(array, np.ndarray) or (array.shape, array.dtype) != expected:
            raise ValueError(f"the statistics of the {name} have another shape or type")
        if not (np.abs(array) < _LARGEST).all():
            raise ValueError(f"the statistics of the {name} are not finite, or too large")
    if (var < 0.0).any() or type(count) is not float or not 0.0 < count < math.inf:
        raise ValueError(f"the statistics of the {name} have a negative variance, or no count")
    statistics.mean, statistics.var, statistics.count = mean.copy(), var.copy(), count


def driving_policy(algorithm: BaseAlgorithm) -> BasePolicy:
    """The policy for raw observations, outside the normalized environments of its training.

    It shares the networks of the algorithm's own policy.
    """
    env = algorithm.get_vec_normalize_env()
    if env is None or not env.norm_obs:
        return algorithm.policy
    scales = {key: (each.mean, np.sqrt(each.var + env.epsilon)) for key, each in _by_key(env).items()}
    policy = copy(algorithm.policy)
    normalize_first = partial(_normalized_to_tensor, algorithm.policy, scales, env.clip_obs)
    policy.obs_to_tensor = normalize_first  # type: ignore[method-assign]
    return policy


def _normalized_to_tensor(
    policy: BasePolicy, scales: Mapping[str, tuple[np.ndarray, np.ndarray]], clip: float, observation: Any
) -> tuple[Any, bool]:
    """A policy's `obs_to_tensor` after `VecNormalize.normalize_obs`, which itself can be copied or pickled only once.

    `scales` holds mean and standard deviation, by key as in `_by_key`.
    """

    def normalized(values: Any, key: str) -> np.ndarray:
        mean, deviation = scales[key]
        return np.clip((values - mean) / deviation, -clip, clip).astype(np.float32)

    if not isinstance(observation, dict):
        return policy.obs_to_tensor(normalized(observation, NUMBERS))
    return policy.obs_to_tensor({**observation, **{key: normalized(observation[key], key) for key in scales}})
