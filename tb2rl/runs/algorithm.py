"""The algorithm, or the policy that does not learn, that a config describes; untrained."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from functools import partial
from typing import Any

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
from tb2rl.runs.normalisation import agree, normalised
from tb2rl.tasks.actions import Velocities

MOST_WEIGHTS = 100_000_000  # in all networks of an algorithm; 400 MB
MOST_LAYERS = 2_000  # arrays of weights, in all networks of an algorithm


def make_algorithm(config: Config, env: VecEnv, **arguments: Any) -> BaseAlgorithm:
    """The untrained algorithm of a config.

    Args:
        config: Its agent learns.
        env: What it is to learn in; normalised here if the config says so.
        arguments: More of the algorithm's own, by name.

    Raises:
        InputError: If its agent does not learn, its arguments do not fit together, or its policy has no parameters
            that a checkpoint can hold.
    """
    agent = agent_for(config.agent_name, config.scene.observation_space)
    check_learns(config)
    device = _device(config.train.device)
    env = normalised(env, config.train)
    try:
        with _few_weights():
            algorithm = import_object(str(agent.algorithm))(
                agent.policy,
                env,
                seed=config.train.seed,
                device=device if _is_here(device) else "cpu",  # a policy drives on any machine
                **algorithm_arguments(config.agent_arguments, config.scene.action_space),
                **arguments,
            )
    except LIBRARY_ERRORS as error:
        raise refusal(config, str(error)) from None
    if not isinstance(algorithm.policy, th.nn.Module) or not algorithm.policy.state_dict():
        raise InputError(
            f"agent {config.agent_name} cannot be saved: its {type(algorithm.policy).__name__} has no torch parameters "
            "(those of SBX are JAX's); take an algorithm of Stable-Baselines3 or sb3-contrib"
        )
    agree(algorithm)
    return algorithm


def check_learns(config: Config) -> None:
    """Raise an `InputError` if the agent of a config does not learn, or not such actions, or needs to be told more."""
    name, agent = config.agent_name, find_agent(config.agent_name)
    if agent.algorithm is None:
        raise InputError(f"agent {name} does not learn; try it with `python -m tb2rl.evaluate --agent {name}`")
    actions = "named" if isinstance(config.scene.action_space, spaces.Discrete) else "continuous"
    if agent.actions not in (None, actions):
        raise InputError(f"agent {name} learns {agent.actions} actions; those of task {config.task_name} are {actions}")
    if "action_masks" in inspect.signature(import_object(agent.algorithm).predict).parameters:
        raise InputError(f"agent {name} needs masks of the actions that are allowed, and here all of them always are")


def refusal(config: Config, reason: str) -> InputError:
    """The error for an algorithm that does not take its settings, which names them all: libraries rarely say which."""
    given = ", ".join(config.agent_arguments) or "all as they are by default"
    who = f"agent {config.agent_name} with {config.observation} observations"
    return InputError(one_line(f"{who} refuses its settings ({given}): {reason}"))


@contextmanager
def _few_weights() -> Iterator[None]:
    """Refuse networks that nobody means or that do not fit into the memory, from a typing error or a stranger's file.

    Each layer is counted before it is filled with numbers, when it takes up no memory yet.

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


def check_device(config: Config) -> None:
    """Raise an `InputError` if the device that a config trains on is not there: on another one it would take longer."""
    name = config.train.device
    if not _is_here(_device(name)):
        raise InputError(f"train.device {name!r} cannot be used: torch finds none on this machine; take cpu or auto")


def _device(name: str) -> th.device:
    """The device of a name, whether it is there or not: a table has no use for one, and yet its name should exist."""
    try:
        device = get_device(name) if name == "auto" else th.device(name)
    except (RuntimeError, ValueError, TypeError) as error:
        raise InputError(one_line(f"train.device {name!r} cannot be used: {error}")) from None
    if device.type not in ("cpu", "cuda", "mps"):
        raise InputError(f"train.device {name!r} cannot be used: take cpu, cuda or auto")
    return device


def _is_here(device: th.device) -> bool:
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
    told = {"vehicle": _vehicle(scene)} if "vehicle" in inspect.signature(policy).parameters else {}
    return policy(scene.observation_space, scene.action_space, **told, **config.agent_arguments)


def _vehicle(scene: Scene) -> Vehicle:
    actions, robot = scene.actions, scene.robot
    max_speed, turn_rate = actions.max_speed, robot.max_turn_rate
    if isinstance(actions, Velocities):
        max_speed, turn_rate = actions.high.tolist()
    return Vehicle(robot.radius, max_speed, turn_rate, scene.task.control_period, tuple(scene.laser.angles.tolist()))


class Spaces(gym.Env):
    """The spaces of a config without a simulation behind them: all that an algorithm needs to be rebuilt."""

    def __init__(self, config: Config) -> None:
        self.observation_space = config.scene.observation_space
        self.action_space = config.scene.action_space

    @classmethod
    def vectorised(cls, config: Config) -> VecEnv:
        """As many of them as the config has environments."""
        one = cls(config)
        return DummyVecEnv([partial(copy, one)] * config.train.n_envs)
