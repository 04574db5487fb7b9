"""Where the values of a config come from: layers of presets and settings, of which later ones win.

The defaults of the signatures, `configs/tasks/TASK.yaml`, `configs/agents/AGENT.yaml`, what differs for the agent in
the fast twin (`configs/kinematic/AGENT.yaml`) and at this task (`configs/tasks/TASK-AGENT.yaml`), what suits the robot
(`Robot.task_settings`), a preset that the user names, single settings (`agent.gamma=0.9`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError, one_line
from tb2rl.core.files import find_file, parse_yaml, read_yaml, top_folder
from tb2rl.core.plugins import reference_to
from tb2rl.envs.scene import with_robots_settings
from tb2rl.runs.arguments import argument_names, is_schedule
from tb2rl.runs.config import Config, TrainSettings, config_from
from tb2rl.runs.plain import SECTIONS, check_plain, check_sections
from tb2rl.tasks import Task
from tb2rl.tasks.registry import find_task

DEFAULT_AGENT, DEFAULT_TASK = "qlearn", "maze"


def resolve(
    agent: str | type | None = None,
    task: str | type[Task] | None = None,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Config:
    """Put the layers together and check the result.

    Args:
        agent: The agent's name, or its algorithm; None: the preset's, else `DEFAULT_AGENT`.
        task: The task's name, or its class; None: the preset's, else `DEFAULT_TASK`.
        preset: The name of a file in `configs`, or the path of one.
        settings: Single settings by dotted key, such as {"agent.gamma": 0.9}.

    Raises:
        InputError: For any name, key or value that does not fit.
    """
    chosen = _preset(preset) if preset else {}
    single = _nest(_in_sections(settings or {}, agent, task, chosen))
    for layer in (chosen, single):
        check_plain(layer, "")
    agent = reference_to(agent) if isinstance(agent, type) else agent
    task = reference_to(task) if isinstance(task, type) else task
    agent = agent or _first("name", single, chosen, "agent") or DEFAULT_AGENT
    task = task or _first("name", single, chosen, "task") or DEFAULT_TASK
    _, kind = find_agent(agent), find_task(task)  # say that a name is unknown before anything else
    simulation = _first("simulation", single, chosen, "train")
    built_in = [
        _built_in("tasks", task),
        _built_in("agents", agent),
        _built_in("kinematic", agent) if simulation == "kinematic" else {},
        _built_in("tasks", f"{task}-{agent}"),
    ]
    robot = _first("robot", single, chosen, "task")
    suiting = {"task": with_robots_settings({"robot": robot}, kind)} if robot else {}
    tree: dict[str, Any] = {"agent": {}, "task": {}, "train": {}}
    for layer in (*built_in, suiting, chosen, single):
        _merge(tree, layer)
    tree["agent"]["name"], tree["task"]["name"] = agent, task
    return config_from(tree)


def as_preset(
    agent: str | None = None,
    task: str | None = None,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The tree of one preset that stands for these arguments of `resolve`, which makes the same config of it.

    Raises:
        InputError: If the preset or a setting cannot be read; what they say is checked by `resolve`.
    """
    tree: dict[str, Any] = {"agent": {}, "task": {}, "train": {}}
    chosen, single = _preset(preset) if preset else {}, _nest(settings or {})
    for layer in (chosen, single):
        _merge(tree, layer)
    tree["agent"]["name"] = agent or _first("name", single, chosen, "agent") or DEFAULT_AGENT
    tree["task"]["name"] = task or _first("name", single, chosen, "task") or DEFAULT_TASK
    return tree


def parse_settings(pairs: Iterable[str]) -> dict[str, Any]:
    """Settings as the command line has them: "agent.gamma=0.9" to {"agent.gamma": 0.9}, values read as YAML.

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


def _preset(name: str) -> dict[str, Any]:
    return check_sections(read_yaml(find_file(name, top_folder("configs"), "preset")), f"preset {name}")


def _built_in(kind: str, name: str) -> dict[str, Any]:
    file = top_folder("configs") / kind / f"{name}.yaml"
    return check_sections(read_yaml(file), f"preset {file.name}") if file.is_file() else {}


def _nest(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Sections with the values that dotted keys name."""
    tree: dict[str, Any] = {}
    for dotted, value in settings.items():
        *path, key = dotted.split(".")
        if not path:
            raise _without_section(dotted, SECTIONS)
        branch = tree
        for name in path:
            branch = branch.setdefault(name, {})
            if not isinstance(branch, dict):
                raise InputError(f"setting {dotted!r} and another one give {'.'.join(path)} twice")
        branch[key] = value
    return check_sections(tree, "the settings")


def _in_sections(
    settings: Mapping[str, Any], agent: str | type | None, task: str | type[Task] | None, chosen: Mapping[str, Any]
) -> Mapping[str, Any]:
    """The settings, if each begins with its section; the error names the sections that have a setting of this name."""
    for key in settings:
        if "." not in key:
            agent = agent or _first("name", {}, chosen, "agent") or DEFAULT_AGENT
            task = task or _first("name", {}, chosen, "task") or DEFAULT_TASK
            known = {
                "agent": {
                    "name",
                    *argument_names(find_agent(reference_to(agent) if isinstance(agent, type) else agent)),
                },
                "task": {"name", "observation", *(each.name for each in fields(find_task(task)))},
                "train": {each.name for each in fields(TrainSettings)},
            }
            raise _without_section(key, [section for section in SECTIONS if key in known[section]] or SECTIONS)
    return settings


def _without_section(key: str, sections: Sequence[str]) -> InputError:
    *others, last = (f"{section}.{key}" for section in sections)
    return InputError(f"setting {key!r} needs its section: {' or '.join(filter(None, [', '.join(others), last]))}")


def _first(key: str, single: Mapping[str, Any], chosen: Mapping[str, Any], section: str) -> str | None:
    for layer in (single, chosen):
        if layer.get(section, {}).get(key) is not None:
            return str(layer[section][key])
    return None


def _merge(tree: dict[str, Any], layer: Mapping[str, Any]) -> None:
    """Put a layer over a tree: mappings are merged key by key, but for those that are whole in themselves."""
    for key, value in layer.items():
        if isinstance(value, Mapping) and isinstance(tree.get(key), Mapping) and not _is_whole(value):
            tree[key] = dict(tree[key])
            _merge(tree[key], value)
        else:
            tree[key] = value


def _is_whole(value: Mapping[str, Any]) -> bool:
    """Whether a mapping means something by itself: a schedule, or the worlds of a file or a generator."""
    return is_schedule(value) or "file" in value or "generator" in value
