"""The command `benchmark`: measures each part, prints a table, writes JSON; see `tb2rl.benchmark`."""

from __future__ import annotations

import argparse
import json
import platform
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tb2rl.commands.output import check_output, write_json
from tb2rl.commands.rates import Figure, measure_kinematic, measure_physics
from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError, unknown
from tb2rl.core.plugins import agent_names
from tb2rl.core.processes import processors
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluator import PASSED
from tb2rl.runs.folder import EVALUATIONS
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import load
from tb2rl.simulation import batch_simulator, default_physics, find_simulator
from tb2rl.training.training import Training, train_config

_STEPS = 50_000  # at most, of a training in PyBullet whose rate is measured


def measure_training(options: argparse.Namespace) -> list[Figure]:
    """Training rate of each agent in each simulator."""
    figures = []
    for simulator in (default_physics(), batch_simulator()):
        simulation = simulator.name
        for agent in learners():
            preset = resolve(agent, settings={"train.simulation": simulation}).train.total_timesteps
            steps = min(preset, _STEPS) if simulator.is_physics else preset
            training = _train(agent, simulation, 0, total_timesteps=steps, eval_freq=0, save_freq=0)
            rate = training.timesteps / training.seconds
            figures.append(Figure(f"training, {agent} in {simulation}", rate, "steps/s"))
    return figures


def measure_trained(options: argparse.Namespace) -> list[Figure]:
    """Time of the first evaluation that passes, and the standard evaluation, of whole trainings."""
    figures = []
    for simulation in options.simulations:
        for agent in learners():
            trainings = [_measure_one_trained(agent, simulation, seed) for seed in range(options.seeds)]
            figures += [figure for training in trainings for figure in training]
            if options.seeds > 1:
                name = f"{agent} in {simulation}: trained, median of {options.seeds} seeds"
                figures.append(Figure(name, float(np.median([time.value for time, _ in trainings])), "s"))
    return figures


def _measure_one_trained(agent: str, simulation: str, seed: int) -> tuple[Figure, Figure]:
    """Seconds until an evaluation passes, evaluations included (inf if none does), and the standard evaluation."""
    with tempfile.TemporaryDirectory() as folder:
        training = _train(agent, simulation, seed, Path(folder))
        lines = (training.run.folder / EVALUATIONS).read_text().splitlines()
        passed = [e["elapsed"] for e in map(json.loads, lines) if e["failure_free_rate"] >= PASSED]
        rate = evaluate(load(training.run.folder)).summary()["failure_free_rate"]
    name = f"{agent} in {simulation}, seed {seed}"
    return (
        Figure(f"{name}: trained after", min(passed, default=float("inf")), "s"),
        Figure(f"{name}: failure-free, standard evaluation", 100 * rate, "%"),
    )


def learners() -> list[str]:
    """The agents that learn the default task and are installed."""
    agents = {name: find_agent(name) for name in agent_names()}
    return [
        name
        for name, agent in agents.items()
        if agent.algorithm and agent.actions != "continuous" and find_spec(agent.algorithm.partition(":")[0])
    ]


PARTS: dict[str, Callable[[argparse.Namespace], list[Figure]]] = {
    "physics": lambda options: measure_physics(options.seconds),
    "kinematic": lambda options: measure_kinematic(options.seconds),
    "training": measure_training,
    "trained": measure_trained,
}


def _train(agent: str, simulation: str, seed: int, folder: Path | None = None, **settings: Any) -> Training:
    """Train once, after a short training that loads all code which is compiled or imported late."""
    given = {f"train.{key}": value for key, value in {"simulation": simulation, "seed": seed, **settings}.items()}
    config = resolve(agent, settings=given)
    short = resolve(agent, settings={**given, "train.total_timesteps": 1, "train.eval_freq": 0, "train.save_freq": 0})
    with tempfile.TemporaryDirectory() as scratch:
        train_config(short, Path(scratch) / "short")
        return train_config(config, (folder or Path(scratch)) / "run")


def machine() -> str:
    """The processor, the number of processors that this process may use, and the version of Python."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.processor()
    return f"{model}, {processors()} processors, Python {platform.python_version()}"


def run(options: argparse.Namespace) -> None:
    """Measure, print a table, write JSON."""
    parts = options.parts or list(PARTS)
    for part in parts:
        if part not in PARTS:
            raise unknown("part", part, PARTS)
        if part != "kinematic":
            default_physics().check(f"part {part}")
    for simulation in options.simulations:
        find_simulator(simulation).check()
    if not options.seconds > 0 or options.seeds < 1:
        raise InputError(f"--seconds must be above 0 and --seeds at least 1, got {options.seconds}, {options.seeds}")
    check_output(options.json)
    figures = [figure for part in parts for figure in PARTS[part](options)]
    Console().print(as_table(figures))
    if options.json:
        write_json(options.json, {"machine": machine(), "figures": [asdict(figure) for figure in figures]})


def as_table(figures: Sequence[Figure]) -> Table:
    """A table with a row for each figure."""
    table = Table(title=machine(), title_justify="left")
    table.add_column("figure")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for figure in figures:
        shown = f"{figure.value:,.2f}" if figure.value < 100 else f"{figure.value:,.0f}"
        table.add_row(figure.name, shown, figure.unit)
    return table
