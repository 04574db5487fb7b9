"""The config of a training: its form as a tree of plain values, and the layers that are merged into it.

The tree has three sections, which are mappings: `agent`, `task` and `train`. `resolve` merges these layers; each layer
overrides the earlier layers:

1. The defaults in the code: of the agent, the task and `TrainSettings`.
2. `configs/tasks/TASK.yaml`.
3. `configs/agents/AGENT.yaml`.
4. `configs/kinematic/AGENT.yaml`, if the user chooses the kinematic simulator.
5. `configs/tasks/TASK-AGENT.yaml`.
6. `Robot.task_settings`, if the user chooses a robot.
7. The user's preset.
8. The user's settings, such as `agent.gamma=0.9`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le
from pydantic import AfterValidator, Field
from pydantic_core import to_jsonable_python

from tb2rl.core import Agent, InputError, check_file_allowed, find_agent, one_line, reference_to
from tb2rl.core.files import find_file, parse_yaml, read_yaml, top_folder
from tb2rl.core.processes import processors
from tb2rl.core.values import Count, CountOrZero, Fraction, Names, PluginNames, build
from tb2rl.envs.scene import Scene, make_scene, with_robot_settings
from tb2rl.envs.worlds import absolute_worlds, paths_in
from tb2rl.robots.robot_file import robot_setting, variation_setting
from tb2rl.runs.arguments import checked_arguments, is_schedule, with_policy
from tb2rl.simulation.simulator import batch_simulator, default_physics, find_simulator
from tb2rl.tasks import Task
from tb2rl.tasks.task import find_task


def _checked_simulator_name(name: str) -> str:
    simulator = find_simulator(name)
    if simulator.is_external:
        raise ValueError(f"cannot be {name!r}, because a training needs a simulator of tb2rl")
    return simulator.name


SimulatorName = Annotated[str, "name of a simulator", AfterValidator(_checked_simulator_name)]
Episodes = Annotated[int, Ge(1), Le(100_000)]
Device = Annotated[str, "cpu, cuda, cuda:N, mps or auto", Field(pattern=r"^(auto|cpu|mps|cuda(:\d{1,2})?)$")]
TorchThreads = Annotated[Annotated[int, Ge(1), Le(256)] | Literal["auto"], "int 1 to 256, or auto"]
MatmulPrecision = Literal["highest", "high", "medium"]
_MAX_AUTO_THREADS = 4  # more would wait for each other, because the networks are small


@dataclass(frozen=True)
class TrainSettings:
    """Length, environments, evaluations and checkpoints of a training."""

    total_timesteps: Count = 500_000  # [control steps] length of the training, in all environments
    episodes: Count | None = None  # maximum number of episodes in all environments; None: no limit
    episode_steps: Count | None = None  # [control steps] time limit of training episodes; None: the task's time limit
    seed: Annotated[int, Ge(0), Le(2**32 - 1)] = 0  # seed of the networks, the environments and the exploration
    simulation: SimulatorName = field(default_factory=lambda: default_physics().name)  # simulator to train in
    n_envs: Annotated[int, Ge(1), Le(100_000)] = 16  # number of environments; PyBullet divides them among processes
    device: Device = "cpu"  # device of the networks
    torch_threads: TorchThreads = 1  # threads of torch, for each network; auto: half the processors, 1 to 4
    matmul_precision: MatmulPrecision = "highest"  # medium: bfloat16 if the processor has it; evaluations: highest
    reward_scale: Annotated[float, Gt(0), Le(1e6)] = 1.0  # factor for rewards in training; logs are unscaled
    norm_obs: bool = False  # normalise observations by running mean and standard deviation (SB3's VecNormalize)
    norm_reward: bool = False  # normalise rewards by the standard deviation of returns, which cancels reward_scale
    eval_freq: CountOrZero = 50_000  # [control steps] between evaluations; 0: no evaluations
    eval_simulation: SimulatorName = field(default_factory=lambda: batch_simulator().name)  # simulator of evaluations
    eval_episodes: Episodes | None = None  # episodes of an evaluation; None: 1000, or 20 in physics or with images
    eval_steps: Count = 1000  # [control steps] time limit of evaluation episodes
    best_by: Literal["success", "return"] = "success"  # metric of the best policy: success rate or mean return
    stop_score: Fraction | None = None  # rate of good episodes in evaluations at which to stop; None: never
    stop_evaluations: Count = 2  # number of consecutive evaluations that must reach stop_score
    save_freq: CountOrZero = 50_000  # [control steps] between checkpoints; 0: only the last
    keep: Count = 2  # number of latest checkpoints to keep
    privileged: PluginNames = ()  # sensors that only the critic observes, with a policy such as AsymmetricPolicy
    track: Names = ()  # trackers beside TensorBoard: mlflow, wandb or module:Class

    def with_thread_count(self) -> TrainSettings:
        """A copy with a number in place of `torch_threads: auto`: 1 in a worker, whose `processors` is 1."""
        if self.torch_threads != "auto":
            return self
        # Half of them, because the actor and the critic run at the same time, see `tb2rl.training.parallel_networks`.
        return dataclasses.replace(self, torch_threads=min(max(1, processors() // 2), _MAX_AUTO_THREADS))


@dataclass(frozen=True)
class Config:
    """The complete, checked config of a training."""

    agent_name: str  # name or reference, see `tb2rl.core.agent.find_agent`
    agent_arguments: Mapping[str, Any]  # arguments of the agent's algorithm, or of its policy if it does not learn
    task_name: str  # name or reference, see `tb2rl.tasks.task.find_task`
    task: Task
    observation: Annotated[str, "one of discrete, raw"]  # observation mode; default: that of the agent
    train: TrainSettings
    agent: Agent = field(compare=False, repr=False)  # with the policy for the observation space, see `with_policy`
    scene: Scene = field(compare=False, repr=False)  # the environment that the task's settings describe

    @cached_property
    def training_scene(self) -> Scene:
        """The scene with the privileged sensors and the filters of the training."""
        filters = tuple(command_filter for command_filter in self.scene.filters if command_filter.acts_in_training)
        scene = dataclasses.replace(self.scene, filters=filters)
        return scene.with_privileged_sensors(self.train.privileged) if self.train.privileged else scene

    def to_dict(self) -> dict[str, Any]:
        """The tree of plain values, which `config_from` converts back."""
        task = {"name": self.task_name, "observation": self.observation, **dataclasses.asdict(self.task)}
        agent = {"name": self.agent_name, **self.agent_arguments}
        return to_jsonable_python({"agent": agent, "task": task, "train": dataclasses.asdict(self.train)})

    def with_task(self, settings: Mapping[str, Any]) -> Config:
        """A copy with changed task settings, such as {"world": "circuit"}."""
        if not settings:
            return self
        tree = self.to_dict()
        tree["task"].update(with_robot_settings(settings, type(self.task), self.task))
        return config_from(tree)


def config_from(tree: Mapping[str, Any]) -> Config:
    """Make a config from a tree like that of `Config.to_dict`, and check it."""
    sections = checked_sections(tree, "config")
    for name in ("agent", "task"):
        if "name" not in sections[name]:
            raise InputError(f"the config has no {name}.name")
    agent_name, task_name = str(sections["agent"].pop("name")), str(sections["task"].pop("name"))
    agent = find_agent(agent_name)
    observation = str(sections["task"].pop("observation", agent.observation))
    if agent.fixed_obs_mode and observation != agent.observation:
        raise InputError(f"agent {agent_name} needs task.observation={agent.observation}, got {observation!r}")
    task = build(find_task(task_name), sections["task"], "task")
    for file in paths_in(task.world):
        check_file_allowed(file)
    # Paths become absolute, because the run may be loaded from another working directory; of a robot file, a run needs
    # only the values.
    variation = variation_setting(task.variation, task.control_period)
    files = {"world": absolute_worlds(task.world), "robot": robot_setting(task.robot), "variation": variation}
    task = dataclasses.replace(task, **files)
    scene = make_scene(task, observation)  # raises an InputError if settings of the task contradict each other
    agent = with_policy(agent, scene.observation_space, sections["agent"].get("policy"))
    arguments = checked_arguments(agent, sections["agent"])
    train = build(TrainSettings, sections["train"], "train")
    return Config(agent_name, arguments, task_name, task, observation, train, agent, scene)


@dataclass(frozen=True)
class _Sections:
    agent: dict[str, Any] = field(default_factory=dict)
    task: dict[str, Any] = field(default_factory=dict)
    train: dict[str, Any] = field(default_factory=dict)


def checked_sections(tree: Any, where: str) -> dict[str, dict[str, Any]]:
    """The sections of a tree as new mappings; raises an `InputError` unless they are mappings with text keys."""
    return vars(build(_Sections, tree, where))


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The leaves of a tree by dotted key, such as "agent.gamma"."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        leaves |= flatten(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return leaves


DEFAULTS = {"agent": "qlearn", "task": "maze"}  # names of the default agent and task
Layer = Mapping[str, Any]  # nested values by section


def resolve(
    agent: str | type | None = None,
    task: str | type[Task] | None = None,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Config:
    """Merge the layers into a checked config.

    Args:
        agent: Name or algorithm class; None: the agent of the preset, or the default one.
        task: Name or task class; None: the task of the preset, or the default one.
        preset: Name of a file in `configs`, or a path.
        settings: Values by dotted key, such as {"agent.gamma": 0.9}.

    Raises:
        InputError: If a name, key or value is invalid.
    """
    chosen = as_preset(agent, task, preset, settings)
    agent_name, task_name, robot = chosen["agent"]["name"], chosen["task"]["name"], chosen["task"].get("robot")
    _, task_class = find_agent(agent_name), find_task(task_name)  # unknown names raise an error
    kinematic_layers = [f"kinematic/{agent_name}"] if chosen["train"].get("simulation") == "kinematic" else []
    layers = [f"tasks/{task_name}", f"agents/{agent_name}", *kinematic_layers, f"tasks/{task_name}-{agent_name}"]
    robot_layer = {"task": with_robot_settings({"robot": robot}, task_class)} if robot else {}
    return config_from(merge_layers(*map(read_layer, layers), robot_layer, chosen))


def as_preset(
    agent: str | type | None = None,
    task: str | type[Task] | None = None,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Combine the arguments of `resolve` into one preset that resolves to the same config."""
    file = find_file(preset, top_folder("configs"), "preset") if preset else None
    preset_layer = checked_sections(read_yaml(file), f"preset {preset}") if file else {}
    tree = merge_layers(preset_layer, _nest(settings or {}))
    for section, name_or_class in (("agent", agent), ("task", task)):
        name = reference_to(name_or_class) if isinstance(name_or_class, type) else name_or_class
        tree[section]["name"] = str(name or tree[section].get("name") or DEFAULTS[section])
    return tree


def parse_settings(pairs: Iterable[str]) -> dict[str, Any]:
    """Parse KEY=VALUE pairs of a command line, whose values are YAML.

    For example, "agent.gamma=0.9" becomes {"agent.gamma": 0.9}.
    """
    settings = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise InputError(f"--set takes KEY=VALUE, for example task.world=circuit, got {pair!r}")
        settings[key.strip()] = parse_yaml(value, one_line(f"--set {key}: {value!r}", 100))
    return settings


def _nest(settings: Mapping[str, Any]) -> Layer:
    """Convert dotted keys to nested mappings, such as {"agent.gamma": 0.9} to {"agent": {"gamma": 0.9}}."""
    tree: dict[str, Any] = {}
    for dotted, value in settings.items():
        *parents, key = dotted.split(".")
        if not parents:
            raise InputError(f"setting {key!r} needs its section, one of agent.{key}, task.{key}, train.{key}")
        branch = tree
        for name in parents:
            branch = branch.setdefault(name, {})
            if not isinstance(branch, dict):
                raise InputError(f"settings {dotted!r} and {'.'.join(parents)!r} contradict each other; keep only one")
        branch[key] = value
    return checked_sections(tree, "the settings")


def read_layer(name: str) -> Layer:
    """Read a file of `configs`, such as "agents/ppo"; no values if there is none."""
    file = top_folder("configs") / f"{name}.yaml"
    return checked_sections(read_yaml(file), f"configs/{name}.yaml") if file.is_file() else {}


def merge_layers(*layers: Layer) -> dict[str, Any]:
    """Merge layers key by key; schedules, and mappings that describe a world, are replaced, not merged."""
    tree: dict[str, Any] = {}
    for layer in layers:
        for key, value in layer.items():
            old_value = tree.get(key)
            is_leaf = not isinstance(value, Mapping) or is_schedule(value) or "file" in value or "generator" in value
            tree[key] = merge_layers(old_value, value) if isinstance(old_value, Mapping) and not is_leaf else value
    return tree
