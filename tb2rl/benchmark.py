"""How fast the worlds are: steps a second, and what the environment's step costs on top of the physics in it.

    python -m tb2rl.benchmark --json benchmark.json

Both sides of the ratio run in turn over the very same motion: a block of environment steps, then the same block as bare
PyBullet stepping from the same state. So it holds on a noisy machine, where the rates do not.
"""

from __future__ import annotations

import json
import platform
import time
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import ArgumentParser, InputError, command
from tb2rl.processes import ProcessVecEnv, processors
from tb2rl.runs import write
from tb2rl.simulation.bullet import BulletSimulation

BEAMS = (6, 720)
BLOCK = 50  # control steps


@dataclass(frozen=True)
class Figure:
    """One measured number."""

    name: str
    value: float
    unit: str


def benchmark(seconds: float = 5.0) -> list[Figure]:
    """Measure everything, about `seconds` [s] for each part."""
    figures = [figure for beams in BEAMS for figure in measure_step(beams, seconds)]
    return [*figures, measure_worlds(16, seconds)]


def measure_step(beams: int, seconds: float) -> list[Figure]:
    """The environment's step with raw ranges of so many beams, and the bare stepping in it."""
    env = TurtleBot2Env(observation="raw", beams=beams)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    assert isinstance(env.simulation, BulletSimulation)
    whole, bare = [], []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        actions = rng.integers(len(env.task.commands), size=BLOCK)
        before = env.simulation.state()
        times, over = _time_steps(env, actions)
        after = env.simulation.state()
        env.simulation.restore(before)
        whole.append(np.mean(times))
        bare.append(_time_bare(env.simulation, env.task.commands[actions[: len(times)]]))
        env.simulation.restore(after)
        if over:
            env.reset()
    env.close()
    step, physics = float(np.median(whole)), float(np.median(bare))
    return [
        Figure(f"step with {beams} beams", 1.0 / step, "steps/s"),
        Figure(f"bare PyBullet stepping in it, {beams} beams", 1e3 * physics, f"ms per {env.task.control_period} s"),
        Figure(f"step / bare stepping, {beams} beams", float(np.median(np.divide(whole, bare))), "ratio"),
    ]


def measure_worlds(worlds: int, seconds: float) -> Figure:
    """Worlds in parallel processes, stepped at random."""
    env = ProcessVecEnv([partial(gym.make, "tb2rl:TurtleBot2Maze-v0")] * worlds)
    env.seed(0)
    env.reset()
    rng = np.random.default_rng(0)
    steps, start = 0, time.perf_counter()
    while time.perf_counter() < start + seconds:
        env.step(rng.integers(3, size=worlds))
        steps += worlds
    rate = steps / (time.perf_counter() - start)
    env.close()
    return Figure(f"{worlds} worlds in parallel processes", rate, "steps/s")


def _time_steps(env: TurtleBot2Env, actions: np.ndarray) -> tuple[list[float], bool]:
    times = []
    for action in actions:
        start = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(action)
        times.append(time.perf_counter() - start)
        if terminated or truncated:
            return times, True
    return times, False


def _time_bare(simulation: BulletSimulation, commands: np.ndarray) -> float:
    total = 0.0
    for told in commands:
        simulation.drive(told[None])
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


@command
def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, write JSON."""
    parser = ArgumentParser(prog="python -m tb2rl.benchmark", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="write a list of name, value, unit")
    parser.add_argument("--seconds", type=float, default=5.0, help="for each part")
    options = parser.parse_args(arguments)
    if not options.seconds > 0:
        raise InputError(f"--seconds must be above 0, got {options.seconds}")
    figures = benchmark(options.seconds)
    table = Table(title=machine(), title_justify="left")
    table.add_column("what")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for figure in figures:
        table.add_row(
            figure.name, f"{figure.value:,.3f}" if figure.value < 100 else f"{figure.value:,.0f}", figure.unit
        )
    Console().print(table)
    if options.json:
        try:
            write(options.json, json.dumps([asdict(figure) for figure in figures], indent=1) + "\n")
        except OSError as error:
            raise InputError(f"cannot write {options.json}: {error.strerror}") from None


if __name__ == "__main__":
    main()
