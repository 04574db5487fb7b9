"""What `benchmark` does, see `tb2rl.benchmark`: measures each part, prints a table, writes JSON."""

from __future__ import annotations

import argparse
import json
import platform
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tb2rl.commands.rates import Figure, measure_physics, measure_twin
from tb2rl.core.agent import Agent, find_agent
from tb2rl.core.errors import InputError, unknown
from tb2rl.core.files import write_text
from tb2rl.core.plugins import agent_names
from tb2rl.core.processes import processors
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluator import PASSED
from tb2rl.runs.folder import EVALUATIONS
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import load
from tb2rl.simulation import SIMULATIONS, check_bullet
from tb2rl.training.training import Training, train_config

_STEPS = 50_000  # of a training in PyBullet whose rate is measured


@dataclass(frozen=True)
class Conditions:
    """How long to measure, and what to train."""

    seconds: float = 5.0  # for each figure of the parts physics and twin
    seeds: int = 1  # trainings of each agent in the part trained, with seeds from 0
    simulations: Sequence[str] = ("kinematic",)  # in which the part trained does so


def measure_training(conditions: Conditions) -> list[Figure]:
    """What is left of the simulations' rates while each agent learns in them."""
    figures = []
    for simulation in SIMULATIONS:
        for agent in learners():
            preset = resolve(agent, settings={"train.simulation": simulation}).train.total_timesteps
            steps = preset if simulation == "kinematic" else min(preset, _STEPS)
            training = _train(agent, simulation, 0, total_timesteps=steps, eval_freq=0, save_freq=0)
            rate = training.timesteps / training.seconds
            figures.append(Figure(f"training, {agent} in {simulation}", rate, "steps/s"))
    return figures


def measure_trained(conditions: Conditions) -> list[Figure]:
    """Whole trainings: the time of the first evaluation that passes, and what the standard evaluation says then."""
    figures = []
    for simulation in conditions.simulations:
        for agent in learners():
            for seed in range(conditions.seeds):
                figures += measure_one_trained(agent, simulation, seed)
            if conditions.seeds > 1:
                times = [f.value for f in figures if f.name.startswith(f"{agent} in {simulation}") and f.unit == "s"]
                name = f"{agent} in {simulation}: trained, median of {conditions.seeds} seeds"
                figures.append(Figure(name, float(np.median(times)), "s"))
    return figures


def measure_one_trained(agent: str, simulation: str, seed: int) -> list[Figure]:
    """Seconds of learning, with the evaluations on the way, until one passes (inf: not one did)."""
    with tempfile.TemporaryDirectory() as folder:
        training = _train(agent, simulation, seed, Path(folder))
        lines = (training.run.folder / EVALUATIONS).read_text().splitlines()
        passed = [e["elapsed"] for e in map(json.loads, lines) if e["failure_free_rate"] >= PASSED]
        rate = evaluate(load(training.run.folder)).summary()["failure_free_rate"]
    name = f"{agent} in {simulation}, seed {seed}"
    return [
        Figure(f"{name}: trained after", min(passed, default=float("inf")), "s"),
        Figure(f"{name}: failure-free, standard evaluation", 100 * rate, "%"),
    ]


def learners() -> list[str]:
    """The agents that learn the default task and are installed."""
    agents = {name: find_agent(name) for name in agent_names()}
    return [name for name, agent in agents.items() if agent.actions != "continuous" and _is_here(agent)]


def _is_here(agent: Agent) -> bool:
    return agent.algorithm is not None and find_spec(agent.algorithm.partition(":")[0]) is not None


PARTS: dict[str, Callable[[Conditions], list[Figure]]] = {
    "physics": lambda conditions: measure_physics(conditions.seconds),
    "twin": lambda conditions: measure_twin(conditions.seconds),
    "training": measure_training,
    "trained": measure_trained,
}


def _train(agent: str, simulation: str, seed: int, folder: Path | None = None, **settings: Any) -> Training:
    """One training after a first short one, which loads what is compiled and imported late."""
    given = {f"train.{key}": value for key, value in {"simulation": simulation, "seed": seed, **settings}.items()}
    config = resolve(agent, settings=given)
    short = resolve(agent, settings={**given, "train.total_timesteps": 1, "train.eval_freq": 0, "train.save_freq": 0})
    with tempfile.TemporaryDirectory() as scratch:
        train_config(short, Path(scratch) / "short")
        return train_config(config, (folder or Path(scratch)) / "run")


def machine() -> str:
    """The processor and how many of them this process may use."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.processor()
    return f"{model}, {processors()} processors, Python {platform.python_version()}"


def run(options: argparse.Namespace) -> None:
    """Measure, print a table, write JSON."""
    for part in options.parts or PARTS:
        if part not in PARTS:
            raise unknown("part", part, PARTS)
        if part != "twin":
            check_bullet(f"part {part}")
    for simulation in options.simulations:
        if simulation not in SIMULATIONS:
            raise unknown("simulation", simulation, SIMULATIONS)
    if not options.seconds > 0 or options.seeds < 1:
        raise InputError(f"--seconds must be above 0 and --seeds at least 1, got {options.seconds}, {options.seeds}")
    if options.json and not options.json.absolute().parent.is_dir():
        raise InputError(f"cannot write {options.json}: there is no folder {options.json.absolute().parent}")
    conditions = Conditions(options.seconds, options.seeds, options.simulations)
    figures = [figure for part in options.parts or PARTS for figure in PARTS[part](conditions)]
    Console().print(as_table(figures))
    if options.json:
        tree = {"machine": machine(), "figures": [asdict(figure) for figure in figures]}
        try:
            write_text(options.json, json.dumps(tree, indent=1) + "\n")
        except OSError as error:
            raise InputError(f"cannot write {options.json}: {error.strerror}") from None


def as_table(figures: Sequence[Figure]) -> Table:
    """The figures, one a line."""
    table = Table(title=machine(), title_justify="left")
    table.add_column("what")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for figure in figures:
        shown = f"{figure.value:,.2f}" if figure.value < 100 else f"{figure.value:,.0f}"
        table.add_row(figure.name, shown, figure.unit)
    return table
