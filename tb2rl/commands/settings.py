"""Implementation of `python -m tb2rl.settings`: tables of settings, from the code and from `configs`."""

import argparse
import inspect
import math
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from functools import partial
from itertools import accumulate, chain, pairwise
from types import FunctionType
from typing import Any

import yaml
from pydantic_core import to_jsonable_python
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl import core, robots
from tb2rl.commands.reference import markdown
from tb2rl.core.descriptions import describe_fields, describe_type
from tb2rl.core.plugins import FILTERS
from tb2rl.envs.filters import Filter
from tb2rl.envs.parts import SENSORS
from tb2rl.robots.robot import find_robot
from tb2rl.runs.arguments import AGENT_RESERVED, constructor_parameters, type_hints
from tb2rl.runs.config import Config, Layer, TrainSettings, merge_layers, read_layer
from tb2rl.sensors import Sensor
from tb2rl.simulation.variation import Variation
from tb2rl.tasks import Task
from tb2rl.tasks.task import find_task
from tb2rl.worlds import ImportOptions
from tb2rl.worlds.dynamic_obstacles import DynamicObstacles
from tb2rl.worlds.generators import GENERATORS, GeneratorSettings

Row = dict[str, str]  # texts by column
_WITHOUT_EXAMPLE = None, inspect.Parameter.empty, math.inf  # values in whose place command lines have "VALUE"
_PAIR = "task with agent"
_VALUES = "default", "tb2rl", "kinematic", _PAIR  # columns of values: in the code, and in the layers of `configs`
_RESERVED = AGENT_RESERVED | {"robot", "laser", "camera", "worlds"}  # arguments of constructors that users cannot set
_GROUPS: dict[str, tuple[Any, ...]] = {  # arguments of `_rows`
    "train": (TrainSettings, "train"),
    "variation": (Variation, "task.variation"),
    "dynamic_obstacles": (DynamicObstacles, "task.dynamic_obstacles", (), {"task.dynamic_obstacles.posts": 2}),
    "world_file": (ImportOptions, "task.world", (), {"task.world.file": "my_map.yaml"}),
}
_CLASSES = {  # of the objects of a kind
    Task: "task", core.Agent: "agent", BaseAlgorithm: "agent", FunctionType: "world generator", robots.Robot: "robot",
    Sensor: "sensor", Filter: "filter",
}  # fmt: skip


def run(options: argparse.Namespace) -> None:
    """Print all names, the tables of one name, or a page with all tables."""
    if options.markdown:
        tables = {f"{name} ({kind})": list(rows(kind, name)) for kind, names in all_names().items() for name in names}
        print(markdown("settings", tables=tables, values=_VALUES), end="")
    elif options.name is None:
        print(*(f"{kind}: {', '.join(names)}" for kind, names in all_names().items()), sep="\n")
    else:
        for kind in _find_kinds(options.name):
            _print_table(f"{options.name} ({kind})", rows(kind, options.name))


def all_names() -> dict[str, list[str]]:
    """Names with settings, by kind."""
    plugins = {"task": core.task_names(), "agent": core.agent_names(), "robot": core.robot_names()}
    parts = {"world generator": [*GENERATORS], "sensor": [*SENSORS], "filter": [*FILTERS]}
    return {"group": [*_GROUPS], **plugins, **parts}


def _find_kinds(name: str) -> list[str]:
    """Kinds of a name or of a reference "module:Class"; several, because `maze` is a task and a generator."""
    found = core.import_object(name) if ":" in name else None
    classes = found.__mro__ if isinstance(found, type) else type(found).__mro__
    kinds = [kind for kind, names in all_names().items() if name in names]
    kinds += [kind for cls, kind in _CLASSES.items() if cls in classes]
    if not kinds:
        raise core.unknown("settings", name, {*chain(*all_names().values())})
    return kinds


def _print_table(title: str, table_rows: Iterable[Row]) -> None:
    columns = (Column(name, overflow="fold") for name in ("command line", "meaning"))
    table = Table(*columns, title=title, title_justify="left")
    for row in table_rows:
        unit, values = f" [{row['unit']}]" if row["unit"] else "", [f"{key} {row[key]}" for key in _VALUES if row[key]]
        details = ("; ".join([row["type"], *values]), "dim")
        table.add_row(Text(row["command line"]), Text.assemble(row["meaning"], unit, "\n", details))
    table.caption = None if table.row_count else "no settings"
    Console().print(table)


def rows(kind: str, name: str) -> Iterator[Row]:
    """Rows of the settings of a name or a reference; of an agent or a task, also of those that its presets change."""
    layers = {"task": [f"tasks/{name}"], "agent": [f"agents/{name}", f"kinematic/{name}"]}.get(kind, [])
    agents = {agent: read_layer(f"tasks/{name}-{agent}") for agent in core.agent_names() if kind == "task"}
    pairs = agents | {task: read_layer(f"tasks/{task}-{name}") for task in core.task_names() if kind == "agent"}
    configured = partial(_rows, layers=layers, pairs=pairs)
    others = [*configured(TrainSettings, "train"), *(configured(Task, "task") if kind == "agent" else [])]
    if kind == "group":
        yield from _rows(*_GROUPS[name])
    elif kind == "task":
        yield from configured(find_task(name), "task")
        yield from (row for row in _rows(Config, "task") if row["setting"] == "task.observation")
    elif kind == "agent":
        yield from configured(core.find_agent(name).load(), "agent")
    elif kind == "world generator":
        yield from _rows(GeneratorSettings, "task.world", also={"task.world.generator": name})
    elif kind == "robot":
        robot, also = find_robot(name), {"task.robot.base": name}
        numbers = _rows(robots.Robot, "task.robot", also=also, values=robot)
        yield from (row for row in numbers if row["setting"].endswith(("max_speed", "max_turn_rate")))
        yield from _rows(robots.Laser, "task.robot.laser", also=also, values=robot.laser)
    else:
        classes = SENSORS.get(name) or (core.import_object(FILTERS.get(name, name)),)
        for cls in classes:
            entry = name if len(classes) == 1 else core.reference_to(cls)
            yield from _rows(cls, "task.observe" if kind == "sensor" else "task.filters", entry=entry)
    yield from (row for row in others if any(row[column] for column in _VALUES[1:]))


def _rows(
    cls: Any,
    prefix: str,
    layers: Iterable[str] = (),
    also: dict | None = None,
    values: Any = None,
    entry: str = "",
    pairs: Mapping[str, Layer] | None = None,
) -> Iterator[Row]:
    """Rows of a dataclass's fields, with the defaults of the object `values`, or of a constructor's arguments.

    `pairs` are the layers of a task with each agent, or of an agent at each task. `entry` is the sensor or filter in
    the list `prefix` that has the fields; the command line also needs `also`.
    """
    is_plain, trees = is_dataclass(cls), [*accumulate(map(read_layer, layers), merge_layers)]
    described, hints = describe_fields(cls), type_hints(cls if is_plain else cls.__init__)
    for name, parameter in constructor_parameters(cls).items():
        if is_plain or name not in _RESERVED:
            default = getattr(values or cls, name, parameter.empty) if is_plain else parameter.default
            configured = [default, *(tree.get(prefix, {}).get(name, default) for tree in trees)]
            changed = ["" if new == old else _text(new) for old, new in pairwise(configured)]
            paired = {k: tree[prefix][name] for k, tree in (pairs or {}).items() if name in tree.get(prefix, {})}
            key, value = f"{prefix}.{name}", "VALUE" if configured[-1] in _WITHOUT_EXAMPLE else configured[-1]
            assigned = {prefix: [{entry: {name: value}}]} if entry else {key: value} | (also or {})
            unit, meaning = described.get(name, ("", ""))
            yield {
                "setting": f"{prefix}.{entry}.{name}" if entry else key,
                "type": describe_type(hints.get(name, Any)),
                "default": "" if default is parameter.empty else _text(default),
                **dict(zip(_VALUES[1:], [*changed, "", ""], strict=False)),
                _PAIR: _text(paired) if paired else "",
                "unit": unit,
                "meaning": meaning,
                "command line": " ".join(["--set", *(shlex.quote(f"{k}={_text(v)}") for k, v in assigned.items())]),
            }


def _text(value: Any) -> str:
    """A value in YAML, as one line, with double quotes, because a shell needs the single ones."""
    plain = to_jsonable_python(value, fallback=str)
    text = yaml.safe_dump(plain, default_flow_style=True, sort_keys=False, width=float("inf"))
    return re.sub(r"'([^'\"\\]*)'", r'"\1"', text.removesuffix("...\n").strip())
