"""What a training is: an agent, a task and how to train, as plain values that a run folder keeps.

A config is a tree of three mappings, `agent`, `task` and `train`, see `Config.to_dict`. Where its values come from is
told in `tb2rl.runs.layers`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le
from pydantic import AfterValidator

from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.trust import check_file
from tb2rl.core.values import Count, CountOrZero, Fraction, Names, build
from tb2rl.envs.scene import Scene, make_scene, with_robots_settings
from tb2rl.envs.worlds import absolute_worlds, files_named
from tb2rl.runs.arguments import agent_for, check_arguments
from tb2rl.runs.plain import check_plain, check_sections, plain
from tb2rl.simulation import batch_simulator, default_physics, find_simulator
from tb2rl.tasks import Task
from tb2rl.tasks.registry import find_task


def _simulator(name: str) -> str:
    simulator = find_simulator(name)
    if simulator.is_robot:
        raise ValueError(f"cannot be {name!r}: a training needs a simulator")
    return simulator.name


Simulation = Annotated[str, AfterValidator(_simulator)]  # a name that `find_simulator` takes


@dataclass(frozen=True)
class TrainSettings:
    """How long to train, in how many environments, and what to note on the way."""

    total_timesteps: Count = 500_000  # control steps, over all environments
    episodes: Count | None = None  # stop after so many, over all environments, if that comes first
    episode_steps: Count | None = None  # time limit while training, more starts if it is short; None: the task's
    seed: Annotated[int, Ge(0), Le(2**32 - 1)] = 0
    simulation: Simulation = field(default_factory=lambda: default_physics().name)  # what it trains in
    n_envs: Annotated[int, Ge(1), Le(100_000)] = 16  # environments, shared out among parallel processes
    device: str = "cpu"
    torch_threads: Annotated[int, Ge(1), Le(256)] = 1  # two: 15 % for ppo in the twin, nothing for dqn
    reward_scale: Annotated[float, Gt(0), Le(1e6)] = 1.0  # of what the agent sees; logs are unscaled
    norm_obs: bool = False  # numbers observed, by the mean and spread of all so far: Stable-Baselines3's VecNormalize
    norm_reward: bool = False  # by the spread of discounted returns; whatever the reward_scale
    eval_freq: CountOrZero = 50_000  # control steps between evaluations; 0: no evaluations
    eval_simulation: Simulation = field(default_factory=lambda: batch_simulator().name)  # in which all drive at once
    eval_episodes: Annotated[int, Ge(1), Le(100_000)] | None = None  # None: 1000, or 20 in PyBullet and of images
    eval_steps: Count = 1000  # control steps at most in an episode of these
    best_by: Literal["success", "return"] = "success"  # what makes one the best: good episodes, or mean return
    stop_score: Fraction | None = None  # stop once evaluations reach it: the share of good episodes; None: never
    stop_evaluations: Count = 2  # so many of them in a row
    save_freq: CountOrZero = 50_000  # control steps between checkpoints; 0: only the last
    keep: Count = 2  # of these checkpoints, the latest
    track: Names = ()  # where the figures go beside TensorBoard: mlflow, wandb, module:Class


@dataclass(frozen=True)
class Config:
    """A resolved training.

    Attributes:
        agent_name: The agent's name in the registry.
        agent_arguments: Arguments of its algorithm, by name.
        task_name: The task's name in the registry.
        task: The task itself.
        observation: "discrete" or "raw".
        train: The rest.
    """

    agent_name: str
    agent_arguments: Mapping[str, Any]
    task_name: str
    task: Task
    observation: str
    train: TrainSettings = field(default_factory=TrainSettings)

    @cached_property
    def scene(self) -> Scene:
        """What the task's settings describe.

        Raises:
            InputError: If something in them is unknown or does not fit together; `config_from` has found that out.
        """
        return make_scene(self.task, self.observation)

    def to_dict(self) -> dict[str, Any]:
        """The tree of plain values that `config_from` reads back."""
        task = {"name": self.task_name, "observation": self.observation, **dataclasses.asdict(self.task)}
        agent = {"name": self.agent_name, **self.agent_arguments}
        return plain({"agent": agent, "task": task, "train": dataclasses.asdict(self.train)})

    def with_task(self, settings: Mapping[str, Any]) -> Config:
        """The config with some settings of its task changed, for example {"world": "circuit"}, all checked again.

        Raises:
            InputError: For a key or a value that does not fit.
        """
        if not settings:
            return self
        tree = self.to_dict()
        tree["task"].update(with_robots_settings(settings, type(self.task), self.task))
        return config_from(tree)


def config_from(tree: Mapping[str, Any]) -> Config:
    """The checked config of a tree as `Config.to_dict` gives it.

    Raises:
        InputError: For any name, key or value that does not fit.
    """
    check_plain(tree, "")
    sections = {name: dict(values) for name, values in check_sections(tree, "config").items()}
    for name in ("agent", "task"):
        if "name" not in sections.get(name, {}):
            raise InputError(f"the config does not say {name}.name")
    agent_name, task_name = str(sections["agent"].pop("name")), str(sections["task"].pop("name"))
    agent = find_agent(agent_name)
    observation = str(sections["task"].pop("observation", agent.observation))
    if agent.only and observation != agent.observation:
        raise InputError(f"agent {agent_name} needs task.observation={agent.observation}, got {observation!r}")
    task = build(find_task(task_name), sections["task"], "task")
    for file in files_named(task.world):
        check_file(file)
    task = dataclasses.replace(task, world=absolute_worlds(task.world))  # the run is loaded from other folders, too
    scene = make_scene(task, observation)  # says what of the task does not fit together
    arguments = check_arguments(agent_for(agent_name, scene.observation_space), sections["agent"])
    train = build(TrainSettings, sections.get("train", {}), "train")
    config = Config(agent_name, arguments, task_name, task, observation, train)
    vars(config)["scene"] = scene  # so that it is not made again
    return config
