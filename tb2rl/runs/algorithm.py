"""Makes the untrained algorithm of a config, or the policy of an agent that does not learn.

During training, the wrapper `VecNormalize` of Stable-Baselines3 normalizes observations and rewards. A loaded policy
normalizes observations itself, with the statistics of its checkpoint.
"""

import inspect
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize

from tb2rl.core.errors import InputError, one_line
from tb2rl.envs.encodings import NUMBERS
from tb2rl.envs.features import InverseRange
from tb2rl.robots.vehicle import Vehicle
from tb2rl.runs.arguments import LIBRARY_ERRORS, algorithm_arguments, policy_class
from tb2rl.runs.checkpoint import restore_like
from tb2rl.runs.config import Config
from tb2rl.tasks.actions import Velocities


def make_algorithm(config: Config, env: VecEnv | None = None) -> BaseAlgorithm:
    """Make the untrained algorithm of a config.

    Args:
        config: Config of the training.
        env: Environments, to which normalization is added; None: environments that have spaces but no simulation.

    Raises:
        InputError: If the agent does not learn, its arguments are invalid, or its policy cannot be saved.
    """
    check_trainable(config)
    agent, train = config.agent, config.train
    env = DummyVecEnv([partial(_SpacesOnlyEnv, config)] * train.n_envs) if env is None else env
    env = normalize(env, train.norm_obs, train.norm_reward)
    try:
        arguments = algorithm_arguments(config.agent_arguments, config.scene.action_space)
        algorithm = agent.load()(
            **arguments | {"policy": policy_class(agent) if ":" in agent.policy else agent.policy},
            env=env,
            seed=train.seed,
            device=train.device if _has_device(train.device) else "cpu",  # so that policies load on any machine
        )
    except LIBRARY_ERRORS as error:
        raise settings_error(config, str(error)) from None
    if not isinstance(algorithm.policy, th.nn.Module) or not algorithm.policy.state_dict():
        raise InputError(
            f"agent {config.agent_name} cannot be saved: its {type(algorithm.policy).__name__} has no torch parameters "
            "(SBX uses JAX); take an algorithm of Stable-Baselines3 or sb3-contrib"
        )
    if train.privileged and algorithm.policy.observation_space == env.observation_space:
        raise InputError("train.privileged needs agent.policy=tb2rl.training.policies:AsymmetricPolicy")
    if train.privileged and train.norm_obs:
        raise InputError("train.norm_obs does not work with train.privileged")
    adapt_normalization(algorithm)
    return algorithm


def check_trainable(config: Config) -> None:
    """Raise an `InputError` if the agent does not learn, needs other actions than the task's, or needs action masks."""
    name, agent = config.agent_name, config.agent
    if agent.algorithm is None:
        raise InputError(f"agent {name} does not learn; try it with `python -m tb2rl.evaluate --agent {name}`")
    actions = "discrete" if isinstance(config.scene.action_space, spaces.Discrete) else "continuous"
    if agent.actions not in (None, actions):
        raise InputError(f"agent {name} learns {agent.actions} actions; those of task {config.task_name} are {actions}")
    if "action_masks" in inspect.signature(agent.load().predict).parameters:
        raise InputError(f"agent {name} needs action masks, which tasks do not have; use its unmasked variant")


def settings_error(config: Config, reason: str) -> InputError:
    """Make the error for rejected settings; it lists all settings, because libraries rarely name the invalid one."""
    settings = ", ".join(config.agent_arguments) or "all default"
    agent = f"agent {config.agent_name} with {config.observation} observations"
    return InputError(one_line(f"{agent} rejects its settings ({settings}): {reason}"))


def check_device(name: str) -> None:
    """Raise an `InputError` if torch does not find a device."""
    if not _has_device(name):
        raise InputError(f"train.device is {name!r}, but torch finds no such device; take cpu or auto")


@contextmanager
def torch_settings(num_threads: int, matmul_precision: str = "highest") -> Iterator[None]:
    """Set torch's threads and precision during the block; both are global."""
    threads, precision = th.get_num_threads(), th.get_float32_matmul_precision()
    th.set_num_threads(num_threads)
    th.set_float32_matmul_precision(matmul_precision)
    try:
        yield
    finally:
        th.set_num_threads(threads)
        th.set_float32_matmul_precision(precision)


def _has_device(name: str) -> bool:
    device_type, _, index = name.partition(":")
    if device_type == "cuda":
        return int(index or 0) < th.cuda.device_count()
    return device_type != "mps" or th.backends.mps.is_available()


def make_baseline(config: Config) -> BasePolicy:
    """Make the policy of an agent that does not learn; raises an `InputError` for an agent that learns."""
    name, agent = config.agent_name, config.agent
    if agent.algorithm is not None:
        raise InputError(f"agent {name} learns; train it with `python -m tb2rl.train --agent {name}`")
    scene, policy_class, arguments = config.scene, agent.load(), dict(config.agent_arguments)
    if "vehicle" in inspect.signature(policy_class).parameters:
        actions, robot = scene.actions, scene.robot
        angles = tuple(scene.laser.angles.tolist())
        v, w = actions.high if isinstance(actions, Velocities) else (actions.max_speed, robot.max_turn_rate)
        arguments["vehicle"] = Vehicle(robot.radius, float(v), float(w), scene.task.control_period, angles)
    return policy_class(scene.observation_space, scene.action_space, **arguments)


class _SpacesOnlyEnv(gym.Env):
    """An environment that has the spaces of a config, but no simulation."""

    def __init__(self, config: Config) -> None:
        self.observation_space, self.action_space = config.training_scene.observation_space, config.scene.action_space


def normalize(env: VecEnv, norm_obs: bool, norm_reward: bool) -> VecEnv:
    """Wrap environments in `VecNormalize` if observations or rewards are to be normalized."""
    if not norm_obs and not norm_reward:
        return env
    space = env.observation_space
    parts = space.spaces if isinstance(space, spaces.Dict) else {NUMBERS: space}
    keys = [key for key, part in parts.items() if isinstance(part, spaces.Box) and not is_image_space(part)]
    if norm_obs and not keys:
        raise InputError("train.norm_obs normalises numbers, but the observations are discrete or images; omit it")
    norm_obs_keys = keys if isinstance(space, spaces.Dict) else None
    return VecNormalize(env, norm_obs=norm_obs, norm_reward=norm_reward, norm_obs_keys=norm_obs_keys)


def adapt_normalization(algorithm: BaseAlgorithm) -> None:
    """Use the agent's gamma in `VecNormalize`.

    Raises:
        InputError: If observations are normalized, but a features extractor needs ranges in metres.
    """
    env = algorithm.get_vec_normalize_env()
    if env is None:
        return
    env.gamma = getattr(algorithm, "gamma", env.gamma)
    if env.norm_obs and any(isinstance(module, InverseRange) for module in algorithm.policy.modules()):
        raise InputError(
            "train.norm_obs does not work with InverseRange, which needs ranges in metres; set "
            "agent.policy_kwargs.features_extractor_class=stable_baselines3.common.torch_layers:FlattenExtractor "
            "and agent.policy_kwargs.features_extractor_kwargs=null"
        )


def statistics_of(algorithm: BaseAlgorithm) -> dict[str, Any]:
    """The running statistics of observations and rewards, for a checkpoint; empty without normalization."""
    env = algorithm.get_vec_normalize_env()
    if env is None:
        return {}
    observations = {key: _statistics_tree(statistics) for key, statistics in _observation_statistics(env).items()}
    return {"observations": observations, "rewards": _statistics_tree(env.ret_rms)}


def load_statistics(algorithm: BaseAlgorithm, tree: Any) -> None:
    """Restore the statistics of a checkpoint; raises a ValueError if names, shapes or types are not the algorithm's."""
    env = algorithm.get_vec_normalize_env()
    if env is None:
        return
    restored = restore_like(statistics_of(algorithm), tree, "normalisation")
    current = [*_observation_statistics(env).values(), env.ret_rms]
    for statistics, values in zip(current, [*restored["observations"].values(), restored["rewards"]], strict=True):
        vars(statistics).update(values)


def _observation_statistics(env: VecNormalize) -> dict[str, RunningMeanStd]:
    """Running statistics, by observation key."""
    if not env.norm_obs:
        return {}
    return env.obs_rms if isinstance(env.obs_rms, dict) else {NUMBERS: env.obs_rms}


def _statistics_tree(statistics: RunningMeanStd) -> dict[str, Any]:
    count = float(statistics.count)
    return {"mean": np.array(statistics.mean), "var": np.array(statistics.var), "count": count}


def policy_with_normalization(algorithm: BaseAlgorithm) -> BasePolicy:
    """A policy that normalizes its observations if the training does; shares the networks of the algorithm's policy."""
    env = algorithm.get_vec_normalize_env()
    if env is None or not env.norm_obs:
        return algorithm.policy
    policy = copy(algorithm.policy)
    policy.obs_to_tensor = partial(  # type: ignore[method-assign]
        _normalized_to_tensor, algorithm.policy, _observation_statistics(env), env.epsilon, env.clip_obs
    )
    return policy


def _normalized_to_tensor(
    policy: BasePolicy, statistics: Mapping[str, RunningMeanStd], epsilon: float, clip: float, observation: Any
) -> tuple[Any, bool]:
    """Normalize an observation like `VecNormalize.normalize_obs`, then call the policy's `obs_to_tensor`.

    `normalize_obs` is not used, because policies are copied and pickled, and a copied `VecNormalize` cannot be copied.
    """
    parts = dict(observation) if isinstance(observation, dict) else {NUMBERS: observation}
    for key, moments in statistics.items():
        scaled = (parts[key] - moments.mean) / np.sqrt(moments.var + epsilon)
        parts[key] = np.clip(scaled, -clip, clip).astype(np.float32)
    return policy.obs_to_tensor(parts if isinstance(observation, dict) else parts[NUMBERS])
