"""What a training is: an agent, a task and how to train, resolved from presets and overrides.

Later layers win: the defaults of the signatures, `configs/tasks/TASK.yaml`, `configs/agents/AGENT.yaml`, what differs
for the agent in the fast twin (`configs/kinematic/AGENT.yaml`) and at this task (`configs/tasks/TASK-AGENT.yaml`), a
preset that the user names, single settings (`agent.gamma=0.9`). Each layer is a tree of three mappings, `agent`,
`task`, `train`.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import torch as th
from annotated_types import Ge, Gt, Le
from stable_baselines3.common.utils import LinearSchedule

from tb2rl.errors import InputError, one_line, unknown
from tb2rl.observations import prepare
from tb2rl.registry import Agent, find_agent, find_task, import_object
from tb2rl.settings import Count, CountOrNone, build, checked, find_file, parse_yaml, read_yaml, room
from tb2rl.tasks import Task

DEFAULT_AGENT, DEFAULT_TASK = "qlearn", "maze"
_GIVEN_BY_TRAIN = {
    "self", "policy", "env", "tensorboard_log", "verbose", "seed", "device", "_init_setup_model",
    "observation_space", "action_space", "replay_buffer_class", "replay_buffer_kwargs", "rollout_buffer_class",
    "rollout_buffer_kwargs",
}  # fmt: skip
_GIVEN = {  # to policies and what they are made of; the last two are for CUDA graphs and for gradients of gradients
    "self", "observation_space", "action_space", "lr_schedule", "params", "capturable", "differentiable",
}  # fmt: skip
_MOST_LAYERS, _WIDEST = 32, 16_384
_LARGEST = 1e12  # of any number
_SHARE, _COUNT, _WEIGHT = (0.0, 1.0), (1, 10**8), (-1e6, 1e6)
_LIMITS = {  # of arguments as Stable-Baselines3 names them, schedules of them too; it checks hardly any itself
    "learning_rate": (0.0, 10.0),
    **dict.fromkeys(("gamma", "gae_lambda", "tau"), _SHARE),
    **dict.fromkeys(("exploration_fraction", "exploration_initial_eps", "exploration_final_eps"), _SHARE),
    **dict.fromkeys(("buffer_size", "batch_size", "n_steps", "n_epochs", "train_freq", "stats_window_size"), _COUNT),
    **dict.fromkeys(("target_update_interval", "n_quantiles"), _COUNT),
    "learning_starts": (0, 10**8),
    "gradient_steps": (-1, 10**8),  # -1: as many as control steps
    "sde_sample_freq": (-1, 10**8),  # -1: at the start of a rollout
    **dict.fromkeys(("clip_range", "clip_range_vf", "max_grad_norm", "target_kl"), (0.0, 1e6)),
    **dict.fromkeys(("ent_coef", "vf_coef"), _WEIGHT),
}


@dataclass(frozen=True)
class TrainSettings:
    """How long to train, on how many worlds, and what to note on the way."""

    total_timesteps: Count = 500_000  # control steps, over all worlds
    episodes: Count | None = None  # stop after so many, over all worlds, if that comes first
    episode_steps: Count | None = None  # time limit while training, more starts if it is short; None: the task's
    seed: Annotated[int, Ge(0), Le(2**32 - 1)] = 0
    simulation: Literal["bullet", "kinematic"] = "bullet"  # what it trains in; evaluations always drive in PyBullet
    n_envs: Annotated[int, Ge(1), Le(100_000)] = 16  # worlds, shared out among parallel processes
    device: str = "cpu"
    torch_threads: Annotated[int, Ge(1), Le(256)] = 1  # two: 15 % for ppo in the twin, nothing for dqn
    reward_scale: Annotated[float, Gt(0), Le(1e6)] = 1.0  # of what the agent sees; logs are unscaled
    eval_freq: CountOrNone = 50_000  # control steps between evaluations; 0: none
    eval_episodes: Annotated[int, Ge(1), Le(100_000)] = 20
    eval_steps: Count = 1000  # control steps at most in an episode of these
    save_freq: CountOrNone = 50_000  # control steps between checkpoints; 0: only the last
    keep: Count = 2  # of these checkpoints, the latest


@dataclass(frozen=True)
class Config:
    """A resolved training.

    Attributes:
        agent: The agent's name in the registry.
        agent_settings: Arguments of its algorithm, by name.
        task: The task's name in the registry.
        task_settings: The task itself.
        observation: "discrete" or "raw".
        train: The rest.
    """

    agent: str
    agent_settings: Mapping[str, Any]
    task: str
    task_settings: Task
    observation: str
    train: TrainSettings = field(default_factory=TrainSettings)

    def to_dict(self) -> dict[str, Any]:
        """The tree of plain values that `config_from` reads back."""
        task = {"name": self.task, "observation": self.observation, **dataclasses.asdict(self.task_settings)}
        return _plain(
            {
                "agent": {"name": self.agent, **self.agent_settings},
                "task": task,
                "train": dataclasses.asdict(self.train),
            }
        )


def resolve(
    agent: str | None = None,
    task: str | type[Task] | None = None,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Config:
    """Put the layers together and check the result.

    Args:
        agent: The agent's name; None: the preset's, else `DEFAULT_AGENT`.
        task: The task's name, or its class; None: the preset's, else `DEFAULT_TASK`.
        preset: The name of a file in `configs`, or the path of one.
        settings: Single settings by dotted key, such as {"agent.gamma": 0.9}.

    Raises:
        InputError: For any name, key or value that does not fit.
    """
    chosen = _sections(read_yaml(find_file(preset, room("configs"), "preset")), f"preset {preset}") if preset else {}
    single = _nest(settings or {})
    for layer in (chosen, single):
        _check_plain(layer, "")
    agent = agent or _first("name", single, chosen, "agent") or DEFAULT_AGENT
    if isinstance(task, type):
        task = f"{task.__module__}:{task.__qualname__}"
    task = task or _first("name", single, chosen, "task") or DEFAULT_TASK
    find_agent(agent), find_task(task)  # say that a name is unknown before anything else
    simulation = _first("simulation", single, chosen, "train")
    built_in = [
        _built_in("tasks", task),
        _built_in("agents", agent),
        _built_in("kinematic", agent) if simulation == "kinematic" else {},
        _built_in("tasks", f"{task}-{agent}"),
    ]
    tree: dict[str, Any] = {"agent": {}, "task": {}, "train": {}}
    for layer in (*built_in, chosen, single):
        _merge(tree, layer)
    tree["agent"]["name"], tree["task"]["name"] = agent, task
    return config_from(tree)


def config_from(tree: Mapping[str, Any]) -> Config:
    """The checked config of a tree as `Config.to_dict` gives it.

    Raises:
        InputError: For any name, key or value that does not fit.
    """
    _check_plain(tree, "")
    sections = {name: dict(values) for name, values in _sections(tree, "config").items()}
    for name in ("agent", "task"):
        if "name" not in sections.get(name, {}):
            raise InputError(f"the config does not say {name}.name")
    agent_name, task_name = str(sections["agent"].pop("name")), str(sections["task"].pop("name"))
    agent = find_agent(agent_name)
    observation = str(sections["task"].pop("observation", agent.observation))
    if agent.only and observation != agent.observation:
        raise InputError(f"agent {agent_name} needs task.observation={agent.observation}, got {observation!r}")
    task = build(find_task(task_name), sections["task"], "task")
    prepare(task, observation)  # says what does not fit together
    if Path(task.maze).is_file():  # the run is to be found again from another folder
        task = dataclasses.replace(task, maze=str(Path(task.maze).resolve()))
    agent_settings = check_arguments(agent, sections["agent"])
    train = build(TrainSettings, sections.get("train", {}), "train")
    if "episode" in str(agent_settings.get("train_freq")) and train.n_envs > 1:
        raise InputError(f"agent.train_freq counts episodes only with train.n_envs=1, got {train.n_envs}")
    return Config(agent_name, agent_settings, task_name, task, observation, train)


def _check_plain(value: Any, where: str) -> None:
    """Raise an `InputError` for what the config of a run cannot hold, or no computation survives."""
    if isinstance(value, Mapping | list | tuple):
        for key, part in value.items() if isinstance(value, Mapping) else enumerate(value):
            if isinstance(value, Mapping) and not isinstance(key, str):
                raise InputError(one_line(f"{where or 'config'}: a key must be text, got {key!r}"))
            _check_plain(part, f"{where}.{key}".lstrip("."))
    elif isinstance(value, str):
        if not value.isprintable():
            raise InputError(one_line(f"{where}: text must be printable, got {value!r}"))
    elif isinstance(value, int | float):
        if not abs(value) <= _LARGEST:
            shown = value if isinstance(value, float) else f"an integer of {value.bit_length()} bits"
            raise InputError(f"{where}: numbers must be finite, within {_LARGEST:g} of 0, got {shown}")
    elif value is not None:
        raise InputError(one_line(f"{where}: expected plain numbers, text, lists and mappings, got {value!r}"))


def parse_settings(pairs: Iterable[str]) -> dict[str, Any]:
    """Settings as the command line has them: "agent.gamma=0.9" to {"agent.gamma": 0.9}, values read as YAML."""
    settings = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise InputError(f"--set takes KEY=VALUE, for example task.maze=circuit, got {pair!r}")
        settings[key.strip()] = parse_yaml(value, f"--set {key}: {value!r}")
    return settings


def check_arguments(agent: Agent, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of an agent's algorithm (of its policy, if it does not learn), held against the signatures."""
    algorithm = import_object(agent.algorithm or agent.policy)
    fitting = _fitting(algorithm, arguments, "agent", _GIVEN_BY_TRAIN)
    if agent.algorithm and fitting.get("policy_kwargs") is not None:
        policy = algorithm.policy_aliases.get(agent.policy) or import_object(agent.policy)
        where, inner = "agent.policy_kwargs", _fitting(policy, fitting["policy_kwargs"], "agent.policy_kwargs", _GIVEN)
        for part in ("features_extractor", "optimizer"):
            if inner.get(f"{part}_kwargs") is not None:
                kind = inner.get(f"{part}_class") or inspect.signature(policy).parameters[f"{part}_class"].default
                kind = _network_class(kind, f"{where}.{part}_class") if isinstance(kind, str) else kind
                inner[f"{part}_kwargs"] = _fitting(kind, inner[f"{part}_kwargs"], f"{where}.{part}_kwargs", _GIVEN)
        fitting["policy_kwargs"] = inner
    return fitting


def _fitting(kind: Any, arguments: Mapping[str, Any], where: str, given: set[str]) -> dict[str, Any]:
    """The arguments of a class, held against its constructor's signature; those in `given` are not for users."""
    constructor = kind.__init__
    parameters = inspect.signature(constructor).parameters.values()
    known = {parameter.name for parameter in parameters if parameter.kind is parameter.POSITIONAL_OR_KEYWORD} - given
    known |= {parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY}
    fitting: dict[str, Any] = {}
    for key, value in arguments.items():
        if key not in known:
            raise unknown(f"key of {where}", key, known)
        wanted = _parameter_type(constructor, key)
        if isinstance(value, Mapping) and _takes_schedule(wanted):
            _schedule(value, f"{where}.{key}")
            fitting[key] = value
        elif isinstance(value, str) and get_origin(wanted) is type:
            _network_class(value, f"{where}.{key}")
            fitting[key] = value
        else:
            fitting[key] = checked(wanted, value, f"{where}.{key}")
        if key in _LIMITS:
            _check_limits(value, *_LIMITS[key], f"{where}.{key}")
        if key == "net_arch":
            _check_widths(value, f"{where}.{key}")
    return fitting


def _check_limits(value: Any, low: float, high: float, where: str) -> None:
    if isinstance(value, Mapping | list | tuple):
        for part in value.values() if isinstance(value, Mapping) else value:
            _check_limits(part, low, high, where)
    elif isinstance(value, int | float) and not low <= value <= high:
        raise InputError(f"{where}: must be from {low:g} to {high:g}, got {value:g}")


def _check_widths(layers: Any, where: str) -> None:
    for widths in layers.values() if isinstance(layers, Mapping) else (layers or [],):
        if len(widths) > _MOST_LAYERS or any(not 1 <= width <= _WIDEST for width in widths):
            raise InputError(
                f"{where}: at most {_MOST_LAYERS} layers of 1 to {_WIDEST} units, got {len(widths)} layers"
            )


def algorithm_arguments(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Agent settings as the algorithm takes them: schedules and classes made from their YAML form.

    A schedule is {start: 0.5, end: 0.05, fraction: 0.8}, linear over that share of the training; in `policy_kwargs` a
    class is "module:Class".
    """
    made: dict[str, Any] = {
        key: _schedule(value, f"agent.{key}") if _is_schedule(value) else value for key, value in settings.items()
    }
    if made.get("policy_kwargs") is not None:
        made["policy_kwargs"] = {
            key: _network_class(value, f"agent.policy_kwargs.{key}") if isinstance(value, str) else value
            for key, value in made["policy_kwargs"].items()
        }
    return made


def _network_class(reference: str, where: str) -> type:
    try:
        found = import_object(reference)
    except InputError as error:
        raise InputError(one_line(f"{where}: {error}")) from None
    if not (isinstance(found, type) and issubclass(found, th.nn.Module | th.optim.Optimizer)):
        raise InputError(one_line(f"{where}: {reference!r} is neither a torch module nor an optimiser"))
    if issubclass(found, th.nn.Module) and found.forward is th.nn.Module.forward:
        raise InputError(f"{where}: {reference} has no forward of its own")
    return found


@dataclass(frozen=True)
class _Linear:
    start: float
    end: float
    fraction: Annotated[float, Gt(0), Le(1)] = 1.0


def _parameter_type(function: Any, name: str) -> Any:
    """The annotation of one parameter; Any where it cannot be known at run time."""
    only = SimpleNamespace(__annotations__={name: function.__annotations__.get(name, Any)})
    try:
        return get_type_hints(only, function.__globals__)[name]
    except NameError:  # a name imported for type checkers only
        return Any


def _takes_schedule(kind: Any) -> bool:
    return any(get_origin(option) is Callable for option in get_args(kind))


def _is_schedule(value: Any) -> bool:
    return isinstance(value, Mapping) and {"start", "end"} <= value.keys()


def _schedule(value: Mapping[str, Any], where: str) -> LinearSchedule:
    line = build(_Linear, value, where)
    return LinearSchedule(line.start, line.end, line.fraction)


def _built_in(kind: str, name: str) -> dict[str, Any]:
    file = room("configs") / kind / f"{name}.yaml"
    return _sections(read_yaml(file), f"preset {file.name}") if file.is_file() else {}


def _sections(tree: Any, where: str) -> dict[str, Any]:
    if not isinstance(tree, Mapping):
        raise InputError(f"{where}: expected the sections agent, task and train, got {tree!r}")
    for name, values in tree.items():
        if name not in ("agent", "task", "train"):
            raise unknown(f"section of {where}", name, ("agent", "task", "train"))
        if not isinstance(values, Mapping):
            raise InputError(f"{where}: section {name} must be a mapping, got {values!r}")
    return dict(tree)


def _nest(settings: Mapping[str, Any]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for dotted, value in settings.items():
        *path, key = dotted.split(".")
        if not path:
            raise InputError(f"setting {dotted!r} needs its section: agent.{dotted}, task.{dotted} or train.{dotted}")
        branch = tree
        for name in path:
            branch = branch.setdefault(name, {})
            if not isinstance(branch, dict):
                raise InputError(f"setting {dotted!r} and another one give {'.'.join(path)} twice")
        branch[key] = value
    return _sections(tree, "the settings")


def _first(key: str, single: Mapping[str, Any], chosen: Mapping[str, Any], section: str) -> str | None:
    for layer in (single, chosen):
        if layer.get(section, {}).get(key) is not None:
            return str(layer[section][key])
    return None


def _merge(tree: dict[str, Any], layer: Mapping[str, Any]) -> None:
    for key, value in layer.items():
        if isinstance(value, Mapping) and isinstance(tree.get(key), Mapping) and not _is_schedule(value):
            tree[key] = dict(tree[key])
            _merge(tree[key], value)
        else:
            tree[key] = value


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
