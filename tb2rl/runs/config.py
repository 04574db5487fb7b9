"""The config of a training: agent, task and training settings, as plain values that a run folder keeps.

A config is a tree of three mappings, `agent`, `task` and `train`. `tb2rl.runs.layers` merges its values.
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
from tb2rl.runs.plain_values import check_plain, check_sections, to_plain
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
    """Length, environments, evaluations and checkpoints of a training."""

    total_timesteps: Count = 500_000  # control steps, over all environments
    episodes: Count | None = None  # stop after so many, over all environments, if that comes first
    episode_steps: Count | None = None  # time limit while training; a short one gives more starts; None: the task's
    seed: Annotated[int, Ge(0), Le(2**32 - 1)] = 0
    simulation: Simulation = field(default_factory=lambda: default_physics().name)  # simulator to train in
    n_envs: Annotated[int, Ge(1), Le(100_000)] = 16  # environments, divided among parallel processes
    device: str = "cpu"
    torch_threads: Annotated[int, Ge(1), Le(256)] = 1  # 2: 15 % faster for ppo in the kinematic simulator
    reward_scale: Annotated[float, Gt(0), Le(1e6)] = 1.0  # of the rewards that the agent sees; logs are unscaled
    norm_obs: bool = False  # normalise observations by their running mean and deviation (SB3's VecNormalize)
    norm_reward: bool = False  # normalise rewards by the deviation of discounted returns, whatever the reward_scale
    eval_freq: CountOrZero = 50_000  # control steps between evaluations; 0: none
    eval_simulation: Simulation = field(
        default_factory=lambda: batch_simulator().name
    )  # simulator of these evaluations
    eval_episodes: Annotated[int, Ge(1), Le(100_000)] | None = None  # None: 1000; 20 in PyBullet and for images
    eval_steps: Count = 1000  # time limit of their episodes, in control steps
    best_by: Literal["success", "return"] = "success"  # the best policy has most successful episodes or the best return
    stop_score: Fraction | None = None  # stop once evaluations reach this share of successful episodes; None: never
    stop_evaluations: Count = 2  # consecutive evaluations that must reach stop_score
    save_freq: CountOrZero = 50_000  # control steps between checkpoints; 0: only the last
    keep: Count = 2  # checkpoints to keep, the latest
    track: Names = ()  # where metrics go beside TensorBoard: mlflow, wandb, module:Class


@dataclass(frozen=True)
class Config:
    """A resolved training.

    Attributes:
        agent_name: A name or a reference, see `tb2rl.core.agent`.
        agent_arguments: Arguments of the agent's algorithm, by name.
        task_name: A name or a reference, see `tb2rl.tasks.registry`.
        task: The task itself.
        observation: "discrete" or "raw".
        train: Settings of the training.
    """

    agent_name: str
    agent_arguments: Mapping[str, Any]
    task_name: str
    task: Task
    observation: str
    train: TrainSettings = field(default_factory=TrainSettings)

    @cached_property
    def scene(self) -> Scene:
        """The scene that the task's settings describe."""
        return make_scene(self.task, self.observation)

    @cached_property
    def validation_scene(self) -> Scene:
        """The scene in the worlds that decide which policy of a training is the best."""
        return self.scene.worlds_for("validation")

    def to_dict(self) -> dict[str, Any]:
        """The tree of plain values that `config_from` reads back."""
        task = {"name": self.task_name, "observation": self.observation, **dataclasses.asdict(self.task)}
        agent = {"name": self.agent_name, **self.agent_arguments}
        return to_plain({"agent": agent, "task": task, "train": dataclasses.asdict(self.train)})

    def with_task(self, settings: Mapping[str, Any]) -> Config:
        """The config with some settings of its task changed, for example {"world": "circuit"}."""
        if not settings:
            return self
        tree = self.to_dict()
        tree["task"].update(with_robots_settings(settings, type(self.task), self.task))
        return config_from(tree)


def config_from(tree: Mapping[str, Any]) -> Config:
    """The checked config of a tree from `Config.to_dict`."""
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
    task = dataclasses.replace(task, world=absolute_worlds(task.world))  # a run is loaded from other folders, too
    scene = make_scene(task, observation)  # checks that the task's settings fit together
    arguments = check_arguments(agent_for(agent_name, scene.observation_space), sections["agent"])
    train = build(TrainSettings, sections.get("train", {}), "train")
    config = Config(agent_name, arguments, task_name, task, observation, train)
    vars(config)["scene"] = scene  # where cached_property keeps its value, so that worlds are not loaded twice
    return config
