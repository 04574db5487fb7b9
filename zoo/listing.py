"""Implementation of `python -m tb2rl.zoo list` and `show`."""

import argparse
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.markdown import Markdown
from rich.table import Column, Table

from tb2rl.core import InputError, read_text, unknown
from tb2rl.evaluation.metrics import criterion
from tb2rl.evaluation.sim_to_sim import BY_SIMULATION
from tb2rl.runs.folder import read_config
from tb2rl.simulation import find_simulator
from tb2rl.tasks.task import find_task
from tb2rl.zoo.cards import percent
from tb2rl.zoo.entry import entries


def list_policies(arguments: argparse.Namespace) -> None:
    """Print a table of the policies that match `--task`, `--robot` and `--simulation`, with good episodes and speed."""
    rows = []
    for entry in entries():
        task = read_config(entry.folder)["task"]  # without making its worlds, which would take seconds
        results: dict[str, Any] = entry.summary.get(BY_SIMULATION) or {entry.summary["simulation"]: entry.summary}
        has = {"task": [task["name"]], "robot": [task["robot"]], "simulation": list(results)}
        if all(getattr(arguments, key) in (None, *values) for key, values in has.items()):
            rows.append((entry, task, results))
    if not rows:
        raise InputError("no policy of the zoo matches; `python -m tb2rl.zoo list` shows all")
    simulators = dict.fromkeys(name for *_, results in rows for name in results)
    titles = [Column(find_simulator(name).title, justify="right") for name in simulators]
    table = Table(
        Column("zoo:", no_wrap=True),
        "task",
        Column("world", no_wrap=True, max_width=12),
        *titles,
        caption="good episodes, speed in m/s",
    )
    for entry, task, results in rows:
        key = criterion(find_task(task["name"]).goal_task).key
        cells = [_cell(results[name], key) if name in results else "" for name in simulators]
        table.add_row(entry.name, task["name"], _world_title(task["world"]), *cells)
    Console().print(table)


def show_policy(arguments: argparse.Namespace) -> None:
    """Print the card of a policy."""
    known = {entry.name: entry for entry in entries()}
    name = arguments.name.removeprefix("zoo:")
    if name not in known:
        raise unknown("zoo policy", name, known)
    Console().print(Markdown(read_text(known[name].folder / "README.md")))


def _cell(figures: Mapping[str, Any], key: str) -> str:
    return f"{percent(figures[key])} {figures['mean_speed']:.2f}"


def _world_title(setting: Any) -> str:
    """The names of worlds and generators: "loop", "mixed, offices"."""
    worlds = setting if isinstance(setting, list) else [setting]
    return ", ".join(world.get("generator", "file") if isinstance(world, dict) else str(world) for world in worlds)
