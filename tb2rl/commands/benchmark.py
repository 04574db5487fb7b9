"""What `benchmark` does, see `tb2rl.benchmark`: measures each part, prints a table, writes JSON."""

from __future__ import annotations

import argparse
import json
import platform
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

from tb2rl.envs.scene import make_scene
from tb2rl.envs.single import TurtleBot2Env
from tb2rl.envs.vec_env import BatchVecEnv
from tb2rl.errors import InputError, unknown
from tb2rl.files import write_text
from tb2rl.judging.evaluator import PASSED, evaluate
from tb2rl.learning.training import Training, train_config
from tb2rl.processes import processors
from tb2rl.registry import Agent, agent_names, find_agent
from tb2rl.runs.folder import EVALUATIONS
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import load
from tb2rl.simulation import SIMULATIONS, check_bullet
from tb2rl.simulation.kinematic import KinematicSimulation
from tb2rl.tasks.wander import Wander

BEAMS = (6, 36, 720)
ROBOTS = (1, 64, 1024, 4096)
ENVIRONMENTS = 16  # as in the presets
_BLOCK = 50  # control steps between the two sides of a ratio
_STEPS = 50_000  # of a training in PyBullet whose rate is measured


@dataclass(frozen=True)
class Figure:
    """One measured number."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class Conditions:
    """How long to measure, and what to train."""

    seconds: float = 5.0  # for each figure of the parts physics and twin
    seeds: int = 1  # trainings of each agent in the part trained, with seeds from 0
    simulations: Sequence[str] = ("kinematic",)  # in which the part trained does so


def measure_physics(conditions: Conditions) -> list[Figure]:
    """The environment's step, alone and in parallel processes."""
    figures = [figure for beams in BEAMS for figure in measure_step(beams, conditions.seconds)]
    return [*figures, *measure_processes(ENVIRONMENTS, conditions.seconds)]


def measure_step(beams: int, seconds: float) -> list[Figure]:
    """The environment's step with raw ranges of so many beams, and the bare stepping in it."""
    scene = make_scene(Wander(beams=beams), "raw")
    env = TurtleBot2Env(scene)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    whole, bare = [], []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        actions = rng.integers(len(scene.actions.names), size=_BLOCK)
        before = env.simulation.state()
        times, over = _time_steps(env, actions)
        after = env.simulation.state()
        env.simulation.restore(before)
        whole.append(np.mean(times))
        bare.append(_time_bare(env.simulation, scene.actions.commands(actions[: len(times)])))
        env.simulation.restore(after)
        if over:
            env.reset()
    env.close()
    step, physics = float(np.median(whole)), float(np.median(bare))
    return [
        Figure(f"PyBullet, {beams} beams: step", 1.0 / step, "steps/s"),
        Figure(f"PyBullet, {beams} beams: bare stepping in it", 1e3 * physics, f"ms per {env.task.control_period} s"),
        Figure(f"PyBullet, {beams} beams: step / bare stepping", float(np.median(np.divide(whole, bare))), "ratio"),
    ]


def measure_processes(environments: int, seconds: float) -> list[Figure]:
    """Environments in parallel processes and one alone, in turns: machines change from second to second."""
    alone = gym.make("tb2rl:TurtleBot2Maze-v0")
    together = BatchVecEnv(alone.get_wrapper_attr("scene"), environments, simulation="bullet")
    together.seed(0)
    together.reset()
    alone.reset(seed=0)
    rng = np.random.default_rng(0)
    rates = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        for actions in rng.integers(3, size=(_BLOCK, environments)):
            together.step(actions)
        between = time.perf_counter()
        for action in rng.integers(3, size=4 * _BLOCK):
            if True in alone.step(action)[2:4]:  # terminated, truncated
                alone.reset()
        rates.append((_BLOCK * environments / (between - start), 4 * _BLOCK / (time.perf_counter() - between)))
    together.close()
    alone.close()
    many, one = np.array(rates).T
    name = f"PyBullet, {environments} environments in parallel processes"
    share = float(np.median(many / one) / processors())
    return [
        Figure("PyBullet, one environment alone", float(np.median(one)), "steps/s"),
        Figure(name, float(np.median(many)), "steps/s"),
        Figure(f"PyBullet, {environments} in parallel / ({processors()} x one alone)", share, "ratio"),
    ]


def measure_twin(conditions: Conditions) -> list[Figure]:
    """The fast twin for every number of robots and beams."""
    return [
        figure
        for beams in BEAMS
        for robots in ROBOTS
        for figure in measure_batch(robots, beams, conditions.seconds / 5)
    ]


def measure_batch(robots: int, beams: int, seconds: float) -> list[Figure]:
    """The VecEnv's own step, everything included, and the twin's compiled kernel alone over the same commands."""
    scene = make_scene(Wander(beams=beams), "raw")
    env = BatchVecEnv(scene, robots)
    env.seed(0)
    env.reset()
    simulation, period, rng = env.batch.simulation, scene.task.control_period, np.random.default_rng(0)
    assert isinstance(simulation, KinematicSimulation)
    numbers = [np.empty(shape) for shape in ((robots, 2), (robots, 2), robots, robots)]
    results = *numbers, np.empty(robots, dtype=bool), np.empty(robots), np.empty((robots, beams))
    whole: list[float] = []
    bare: list[float] = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(whole) < 3:  # the first ones start the threads
        action = rng.integers(len(scene.actions.names), size=robots)
        commands, state = scene.actions.commands(action), simulation.state()
        start = time.perf_counter()
        env.step(action)
        between = time.perf_counter()
        simulation.advance(state["poses"], state["rims"], commands, period, *results)
        whole.append(between - start)
        bare.append(time.perf_counter() - between)
    name = f"twin, {robots} robots, {beams} beams"
    return [
        Figure(f"{name}: step", robots / float(np.mean(whole[2:])), "robot-steps/s"),
        Figure(f"{name}: step / bare kernel", float(np.mean(whole[2:]) / np.mean(bare[2:])), "ratio"),
    ]


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
    "physics": measure_physics,
    "twin": measure_twin,
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


def _time_steps(env: TurtleBot2Env, actions: np.ndarray) -> tuple[list[float], bool]:
    times = []
    for action in actions:
        start = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(action)
        times.append(time.perf_counter() - start)
        if terminated or truncated:
            return times, True
    return times, False


def _time_bare(simulation: Any, commands: np.ndarray) -> float:
    total = 0.0
    for told in commands:
        simulation.set_wheel_speeds(told[None])
        start = time.perf_counter()
        simulation.advance()
        total += time.perf_counter() - start
    return total / len(commands)


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
