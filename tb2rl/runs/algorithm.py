"""The untrained algorithm of a config, or the policy of an agent that does not learn."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from functools import partial

import gymnasium as gym
import torch as th
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.utils import get_device
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from torch.nn.modules.module import register_module_parameter_registration_hook

from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError, one_line
from tb2rl.core.plugins import import_object
from tb2rl.envs.scene import Scene
from tb2rl.robots.vehicle import Vehicle
from tb2rl.runs.arguments import LIBRARY_ERRORS, agent_for, algorithm_arguments
from tb2rl.runs.config import Config
from tb2rl.runs.normalisation import check_features, normalize, sync_gamma
from tb2rl.tasks.actions import Velocities

MOST_WEIGHTS = 100_000_000  # in all networks of an algorithm; 400 MB
MOST_LAYERS = 2_000  # parameter arrays in all networks of an algorithm


def make_algorithm(config: Config, env: VecEnv) -> BaseAlgorithm:
    """The untrained algorithm of a config, in environments that it normalizes if the config says so.

    Raises:
        InputError: If its agent does not learn, its arguments do not fit together, or its policy has no parameters
            that a checkpoint can hold.
    """
    check_trainable(config)
    agent, train = agent_for(config.agent_name, config.scene.observation_space), config.train
    device = _parse_device(train.device)
    env = normalize(env, train.norm_obs, train.norm_reward)
    try:
        with _limited_networks():
            algorithm = import_object(str(agent.algorithm))(
                agent.policy,
                env,
                seed=train.seed,
                device=device if _is_available(device) else "cpu",  # a policy drives on any machine
                **algorithm_arguments(config.agent_arguments, config.scene.action_space),
            )
    except LIBRARY_ERRORS as error:
        raise settings_error(config, str(error)) from None
    if not isinstance(algorithm.policy, th.nn.Module) or not algorithm.policy.state_dict():
        raise InputError(
            f"agent {config.agent_name} cannot be saved: its {type(algorithm.policy).__name__} has no torch parameters "
            "(those of SBX are JAX's); take an algorithm of Stable-Baselines3 or sb3-contrib"
        )
    check_features(algorithm)
    sync_gamma(algorithm)
    return algorithm


def check_trainable(config: Config) -> None:
    """Raise an `InputError` if the agent does not learn, or not with the task's actions, or needs action masks."""
    name, agent = config.agent_name, find_agent(config.agent_name)
    if agent.algorithm is None:
        raise InputError(f"agent {name} does not learn; try it with `python -m tb2rl.evaluate --agent {name}`")
    actions = "named" if isinstance(config.scene.action_space, spaces.Discrete) else "continuous"
    if agent.actions not in (None, actions):
        raise InputError(f"agent {name} learns {agent.actions} actions; those of task {config.task_name} are {actions}")
    if "action_masks" in inspect.signature(import_object(agent.algorithm).predict).parameters:
        raise InputError(f"agent {name} needs masks of the actions that are allowed, and here all of them always are")


def settings_error(config: Config, reason: str) -> InputError:
    """The error for an algorithm that refuses its settings; it names them all, because libraries rarely say which."""
    given = ", ".join(config.agent_arguments) or "all as they are by default"
    agent = f"agent {config.agent_name} with {config.observation} observations"
    return InputError(one_line(f"{agent} refuses its settings ({given}): {reason}"))


@contextmanager
def _limited_networks() -> Iterator[None]:
    """Refuse huge networks, from a typing error or an untrusted file, before their layers take up memory.

    Raises:
        InputError: For a layer without units, or too many weights or layers.
    """
    weights = layers = 0

    def count(_module: th.nn.Module, name: str, parameter: th.nn.Parameter | None) -> None:
        nonlocal weights, layers
        if parameter is None:
            return
        weights, layers = weights + parameter.numel(), layers + 1
        if parameter.numel() == 0:
            raise InputError(f"a layer has no units (its {name} is empty)")
        if weights > MOST_WEIGHTS or layers > MOST_LAYERS:
            raise InputError(f"its networks have more than {MOST_WEIGHTS} weights, or {MOST_LAYERS} arrays of them")

    hook = register_module_parameter_registration_hook(count)
    try:
        yield
    finally:
        hook.remove()


def check_device(name: str) -> None:
    """Raise an `InputError` if a training's device is missing, because training on another one would take longer."""
    if not _is_available(_parse_device(name)):
        raise InputError(f"train.device {name!r} cannot be used: torch finds none on this machine; take cpu or auto")


def _parse_device(name: str) -> th.device:
    """Parse and validate a device name, even of a device that this machine lacks."""
    try:
        device = get_device(name) if name == "auto" else th.device(name)
    except (RuntimeError, ValueError, TypeError) as error:
        raise InputError(one_line(f"train.device {name!r} cannot be used: {error}")) from None
    if device.type not in ("cpu", "cuda", "mps"):
        raise InputError(f"train.device {name!r} cannot be used: take cpu, cuda or auto")
    return device


def _is_available(device: th.device) -> bool:
    if device.type == "cuda":
        return (device.index or 0) < th.cuda.device_count()
    return device.type != "mps" or th.backends.mps.is_available()


def make_baseline(config: Config) -> BasePolicy:
    """The policy of an agent that does not learn.

    Raises:
        InputError: If the agent learns.
    """
    agent = find_agent(config.agent_name)
    if agent.algorithm is not None:
        name = config.agent_name
        raise InputError(f"agent {name} learns; train it with `python -m tb2rl.train --agent {name}`")
    scene, policy = config.scene, import_object(agent.policy)
    needs_vehicle = "vehicle" in inspect.signature(policy).parameters
    vehicle = {"vehicle": _vehicle(scene)} if needs_vehicle else {}
    return policy(scene.observation_space, scene.action_space, **vehicle, **config.agent_arguments)


def _vehicle(scene: Scene) -> Vehicle:
    actions, robot = scene.actions, scene.robot
    max_speed, turn_rate = actions.max_speed, robot.max_turn_rate
    if isinstance(actions, Velocities):
        max_speed, turn_rate = actions.high.tolist()
    return Vehicle(robot.radius, max_speed, turn_rate, scene.task.control_period, tuple(scene.laser.angles.tolist()))


class Spaces(gym.Env):
    """The spaces of a config without a simulation: enough to rebuild an algorithm."""

    def __init__(self, config: Config) -> None:
        self.observation_space = config.scene.observation_space
        self.action_space = config.scene.action_space

    @classmethod
    def vectorised(cls, config: Config) -> VecEnv:
        """As many of them as the config has environments."""
        one = cls(config)
        return DummyVecEnv([partial(copy, one)] * config.train.n_envs)
