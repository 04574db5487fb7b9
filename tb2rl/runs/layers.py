"""Layers of presets and settings that make a config; later ones win.

The defaults of the signatures, `configs/tasks/TASK.yaml`, `configs/agents/AGENT.yaml`, changes for the agent in the
kinematic simulator (`configs/kinematic/AGENT.yaml`) and at this task (`configs/tasks/TASK-AGENT.yaml`), settings of the
robot (`Robot.task_settings`), a preset that the user names, single settings (`agent.gamma=0.9`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import find_file, parse_yaml, read_yaml, top_folder
from tb2rl.core.plugins import reference_to
from tb2rl.envs.scene import with_robots_settings
from tb2rl.runs.arguments import argument_names, is_schedule
from tb2rl.runs.config import Config, TrainSettings, config_from
from tb2rl.runs.plain_values import SECTIONS, check_plain, check_sections
from tb2rl.tasks import Task
from tb2rl.tasks.registry import find_task

DEFAULT_AGENT, DEFAULT_TASK = "qlearn", "maze"


@dataclass(frozen=True)
class _Choices:
    """Choices of a user: names of agent and task, a preset and single settings as trees of sections."""

    agent: str
    task: str
    preset: Mapping[str, Any]
    settings: Mapping[str, Any]


def resolve(
    agent: str | type | None = None,
    task: str | type[Task] | None = None,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Config:
    """Merge the layers and check the result.

    Args:
        agent: The agent's name, or its algorithm; None: the preset's, else `DEFAULT_AGENT`.
        task: The task's name, or its class; None: the preset's, else `DEFAULT_TASK`.
        preset: The name of a file in `configs`, or a path.
        settings: Single settings by dotted key, such as {"agent.gamma": 0.9}.

    Raises:
        InputError: For any name, key or value that does not fit.
    """
    choices = _choices(agent, task, preset, settings or {})
    for layer in (choices.preset, choices.settings):
        check_plain(layer, "")
    agent, task = choices.agent, choices.task
    _, task_class = find_agent(agent), find_task(task)  # unknown names are reported before anything else
    robot = _value("task", "robot", choices.settings, choices.preset)
    simulation = _value("train", "simulation", choices.settings, choices.preset)
    layers = [
        _built_in("tasks", task),
        _built_in("agents", agent),
        _built_in("kinematic", agent) if simulation == "kinematic" else {},
        _built_in("tasks", f"{task}-{agent}"),
        {"task": with_robots_settings({"robot": robot}, task_class)} if robot else {},
    ]
    return config_from(_merged(choices, layers))


def as_preset(
    agent: str | None = None,
    task: str | None = None,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """A single preset from which `resolve` makes the same config as from these arguments."""
    return _merged(_choices(agent, task, preset, settings or {}), [])


def parse_settings(pairs: Iterable[str]) -> dict[str, Any]:
    """Parse settings of a command line, "agent.gamma=0.9" to {"agent.gamma": 0.9}; values are YAML.

    Raises:
        InputError: For a pair without "=", or a value that is not YAML.
    """
    settings = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise InputError(f"--set takes KEY=VALUE, for example task.world=circuit, got {pair!r}")
        settings[key.strip()] = parse_yaml(value, one_line(f"--set {key}: {value!r}", 100))
    return settings


def _choices(
    agent: str | type | None, task: str | type[Task] | None, preset: str | None, settings: Mapping[str, Any]
) -> _Choices:
    file = find_file(preset, top_folder("configs"), "preset") if preset else None
    chosen = check_sections(read_yaml(file), f"preset {preset}") if file else {}
    agent, task = (reference_to(given) if isinstance(given, type) else given for given in (agent, task))
    without_section = [key for key in settings if "." not in key]
    single = {} if without_section else _nested(settings)
    agent = agent or _value("agent", "name", single, chosen) or DEFAULT_AGENT
    task = task or _value("task", "name", single, chosen) or DEFAULT_TASK
    for key in without_section:
        raise InputError(f"setting {key!r} needs its section: {_with_sections(key, agent, task)}")
    return _Choices(agent, task, chosen, single)


def _value(section: str, key: str, *trees: Mapping[str, Any]) -> str | None:
    found = [value for tree in trees if (value := tree.get(section, {}).get(key)) is not None]
    return str(found[0]) if found else None


def _with_sections(key: str, agent: str, task: str) -> str:
    """The key with each section that has it (else with each section), as a list in words."""
    known = {
        "agent": {"name", *argument_names(find_agent(agent))},
        "task": {"name", "observation", *(each.name for each in fields(find_task(task)))},
        "train": {each.name for each in fields(TrainSettings)},
    }
    sections = [section for section in SECTIONS if key in known[section]] or SECTIONS
    *others, last = (f"{section}.{key}" for section in sections)
    return " or ".join([", ".join(others), last]) if others else last


def _nested(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The tree of sections that dotted keys describe."""
    tree: dict[str, Any] = {}
    for dotted, value in settings.items():
        *path, key = dotted.split(".")
        branch = tree
        for name in path:
            branch = branch.setdefault(name, {})
            if not isinstance(branch, dict):
                raise InputError(f"setting {dotted!r} and another one give {'.'.join(path)} twice")
        branch[key] = value
    return check_sections(tree, "the settings")


def _built_in(folder: str, name: str) -> dict[str, Any]:
    file = top_folder("configs") / folder / f"{name}.yaml"
    return check_sections(read_yaml(file), f"preset {file.name}") if file.is_file() else {}


def _merged(choices: _Choices, layers: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """The choices over some layers."""
    tree: dict[str, Any] = {section: {} for section in SECTIONS}
    for layer in (*layers, choices.preset, choices.settings):
        _merge(tree, layer)
    tree["agent"]["name"], tree["task"]["name"] = choices.agent, choices.task
    return tree


def _merge(tree: dict[str, Any], layer: Mapping[str, Any]) -> None:
    """Put a layer over a tree: mappings are merged key by key, except complete ones."""
    for key, value in layer.items():
        if isinstance(value, Mapping) and isinstance(tree.get(key), Mapping) and not _is_complete(value):
            tree[key] = dict(tree[key])
            _merge(tree[key], value)
        else:
            tree[key] = value


def _is_complete(value: Mapping[str, Any]) -> bool:
    """Whether a mapping is one value: a schedule, or the worlds of a file or a generator."""
    return is_schedule(value) or "file" in value or "generator" in value
