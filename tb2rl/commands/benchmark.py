"""Implementation of `python -m tb2rl.benchmark`: the measurements of its four parts."""

import argparse
import math
import platform
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from timeit import timeit
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Column, Table

from tb2rl.core import agent_names, check_output, find_agent, unknown, write_json
from tb2rl.core.processes import processors
from tb2rl.envs.scene import make_scene
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.evaluation.evaluate import SOLVED_RATE, evaluate
from tb2rl.evaluation.sim_to_sim import available_physics
from tb2rl.runs import TRAINING_EVALUATIONS, load, read_lines, resolve
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.simulator import SimulatorType, batch_simulator, default_physics, find_simulator
from tb2rl.tasks.wander import Wander
from tb2rl.training.training import FinishedTraining, train_config

BEAM_COUNTS = (6, 36, 720)
ENV_COUNTS = (1, 64, 1024, 4096)
NUM_PARALLEL = 16  # number of environments in parallel processes, as in the presets
_BLOCK_STEPS = 50  # control steps of a single measurement
_KINEMATIC_STEPS = 10  # the same in the kinematic simulator
# The CPU time of Windows has a resolution of 16 ms, longer than a block of steps.
_cpu_time = time.process_time if time.get_clock_info("process_time").resolution < 1e-5 else time.perf_counter
_MAX_PHYSICS_STEPS = 50_000  # maximum control steps of a training in physics, which is slow


class Figure(NamedTuple):
    """One measured number."""

    name: str
    value: float
    unit: str


def measure_physics(options: argparse.Namespace) -> Iterator[Figure]:
    """Each physics: the environment step, many environments, and for PyBullet the bare physics of the step."""
    for simulator in available_physics("part physics"):
        for beams in BEAM_COUNTS:
            env = TurtleBot2Env(make_scene(Wander(beams=beams), "raw"), simulation=simulator)
            env.reset(seed=0)
            times = _repeat(partial(_time_physics, env, np.random.default_rng(0)), options.seconds)
            env.close()
            step, physics, ratio = np.median([*times.T, times[:, 0] / times[:, 1]], axis=1).tolist()
            name = f"{simulator.title}, {beams} beams"
            yield Figure(f"{name}: step", 1.0 / step, "steps/s")
            if not math.isnan(ratio):
                yield Figure(f"{name}: bare stepping in it", 1e3 * physics, f"ms per {env.task.control_period} s")
                yield Figure(f"{name}: step / bare stepping", ratio, "ratio")
        yield from _measure_parallel(simulator, options.seconds)


def _repeat(measure: Callable[[], Sequence[float]], seconds: float) -> np.ndarray:
    """Repeat a measurement for `seconds`, but at least three times; returns shape (repetitions, values)."""
    rows, end = list[Sequence[float]](), time.perf_counter() + seconds
    while time.perf_counter() < end or len(rows) < 3:
        rows.append(measure())
    return np.array(rows)


def _time_physics(env: TurtleBot2Env, rng: np.random.Generator) -> tuple[float, float]:
    """Mean CPU times of an environment step and of its bare physics [s], for the same motion from the same state.

    Simulators without a method `advance` have no bare physics; its time is NaN.
    """
    simulator: Any = env.simulator
    actions = rng.integers(len(env.scene.actions.names), size=_BLOCK_STEPS)
    before, steps, done, bare_time = simulator.state(), 0, False, 0.0
    start = _cpu_time()
    while steps < _BLOCK_STEPS and not done:
        done = True in env.step(actions[steps])[2:4]  # terminated, truncated
        steps += 1
    total_time = _cpu_time() - start
    if hasattr(simulator, "advance"):
        after = simulator.state()
        simulator.restore(before)
        simulator.set_duration(env.task.control_period)
        for command in env.scene.actions.commands(actions[:steps]).tolist():
            simulator.set_wheel_speeds(command)
            bare_time += timeit(simulator.advance, timer=_cpu_time, number=1)
        simulator.restore(after)
    if done:
        env.reset()
    return total_time / steps, bare_time / steps or math.nan


def _measure_parallel(simulator: SimulatorType, seconds: float) -> Iterator[Figure]:
    """Measure many environments and one alone, by turns, because a machine's speed varies."""
    parallel, single = (_make_vec_env(num_envs, "discrete", simulator) for num_envs in (NUM_PARALLEL, 1))
    rates = _repeat(lambda: (_measure_rate(parallel, _BLOCK_STEPS), _measure_rate(single, 4 * _BLOCK_STEPS)), seconds)
    parallel.close()
    single.close()
    parallel_rate, single_rate = np.median(rates, axis=0).tolist()
    ratio = float(np.median(rates[:, 0] / rates[:, 1])) / processors()
    name = simulator.title
    yield Figure(f"{name}, one environment alone", single_rate, "steps/s")
    yield Figure(f"{name}, {NUM_PARALLEL} environments in parallel", parallel_rate, "steps/s")
    yield Figure(f"{name}, {NUM_PARALLEL} in parallel / ({processors()} x one alone)", ratio, "ratio")


def _make_vec_env(num_envs: int, observation: str, simulation: Any, **settings: Any) -> TurtleBot2VecEnv:
    env = TurtleBot2VecEnv(make_scene(Wander(**settings), observation), num_envs, simulation=simulation)
    env.seed(0)
    env.reset()
    return env


def _measure_rate(env: TurtleBot2VecEnv, steps: int) -> float:
    """Rate of all environments together with random actions [steps/s]."""
    actions, start = np.random.default_rng(0).integers(3, size=(steps, env.num_envs)), time.perf_counter()
    for action in actions:
        env.step(action)
    return steps * env.num_envs / (time.perf_counter() - start)


def measure_kinematic(options: argparse.Namespace) -> Iterator[Figure]:
    """Kinematic simulator: the VecEnv step, and the compiled kernel alone with the same commands."""
    for beams, num_envs in product(BEAM_COUNTS, ENV_COUNTS):
        env, rng = _make_vec_env(num_envs, "raw", "kinematic", beams=beams), np.random.default_rng(0)
        times = _repeat(partial(_time_kinematic, env, rng), options.seconds / 5)
        # Without the first two times, because those include the start of the threads.
        step, kernel = (np.mean(times[2:], axis=0) / _KINEMATIC_STEPS).tolist()
        name = f"kinematic, {num_envs} x {beams} beams"
        yield Figure(f"{name}: step", num_envs / step, "steps/s")
        yield Figure(f"{name}: step / bare kernel", step / kernel, "ratio")


def _time_kinematic(env: TurtleBot2VecEnv, rng: np.random.Generator) -> list[float]:
    """Times [s] of `_KINEMATIC_STEPS` VecEnv steps, and of as many calls of the kernel, which has its own memory."""
    simulator, scene = env.loop.simulator, env.loop.scene
    assert isinstance(simulator, KinematicSimulator)
    actions = rng.integers(len(scene.actions.names), size=(_KINEMATIC_STEPS, env.num_envs))
    commands, period, next_actions = scene.actions.commands(actions[0]), scene.task.control_period, iter(actions)
    step_time = timeit(lambda: env.step(next(next_actions)), number=_KINEMATIC_STEPS)
    return [step_time, timeit(lambda: simulator.step_robots(commands, period), number=_KINEMATIC_STEPS)]


def measure_training(options: argparse.Namespace) -> Iterator[Figure]:
    """Training rate of each agent in each simulator."""
    for simulator, agent in product((default_physics(), batch_simulator()), learners()):
        preset_steps = resolve(agent, settings={"train.simulation": simulator.name}).train.total_timesteps
        steps = min(preset_steps, _MAX_PHYSICS_STEPS) if simulator.is_physics else preset_steps
        with tempfile.TemporaryDirectory() as folder:
            only_training = {"eval_freq": 0, "save_freq": 0}
            training = _train(agent, folder, simulation=simulator.name, total_timesteps=steps, **only_training)
        yield Figure(f"training, {agent} in {simulator.name}", training.timesteps / training.seconds, "steps/s")


def measure_trained(options: argparse.Namespace) -> Iterator[Figure]:
    """Training time until an evaluation passes (inf: none does), and failure-free rate in the standard evaluation."""
    for simulation, agent in product(options.simulations, learners()):
        seconds = list[float]()
        for seed in range(options.seeds):
            with tempfile.TemporaryDirectory() as folder:
                run = _train(agent, folder, simulation=simulation, seed=seed).run
                evaluations = read_lines(run.folder / TRAINING_EVALUATIONS)
                rate = evaluate(load(run.folder)).summary()["failure_free_rate"]
            times = [line["elapsed"] for line in evaluations if line["failure_free_rate"] >= SOLVED_RATE]
            seconds.append(min(times, default=float("inf")))
            name = f"{agent} in {simulation}, seed {seed}"
            yield Figure(f"{name}: trained after", seconds[-1], "s")
            yield Figure(f"{name}: failure-free, standard evaluation", 100 * rate, "%")
        if options.seeds > 1:
            name = f"{agent} in {simulation}: trained, median of {options.seeds} seeds"
            yield Figure(name, float(np.median(seconds)), "s")


def learners() -> list[str]:
    """Names of the agents that can learn the default task and whose libraries are installed."""
    agents = {name: find_agent(name) for name in agent_names()}
    algorithms = {name: agent.algorithm for name, agent in agents.items() if agent.actions != "continuous"}
    return [name for name, algorithm in algorithms.items() if algorithm and find_spec(algorithm.partition(":")[0])]


def _train(agent: str, folder: str, **settings: Any) -> FinishedTraining:
    """Train, after a short warm-up training that compiles and imports everything."""
    for name, changes in (("warm-up", {"total_timesteps": 1, "eval_freq": 0, "save_freq": 0}), ("run", {})):
        train_settings = {f"train.{key}": value for key, value in (settings | changes).items()}
        training = train_config(resolve(agent, settings=train_settings), Path(folder, name))
    return training


PARTS = {
    "physics": measure_physics,
    "kinematic": measure_kinematic,
    "training": measure_training,
    "trained": measure_trained,
}


def describe_machine() -> str:
    """Processor model, number of processors that this process may use, and Python version."""
    info = Path("/proc/cpuinfo")
    match = re.search(r"model name\s*: (.*)", info.read_text(encoding="utf-8")) if info.is_file() else None
    model = match[1] if match else platform.processor()
    return f"{model}, {processors()} processors, Python {platform.python_version()}"


def run(options: argparse.Namespace) -> None:
    """Measure, print a table, write JSON."""
    parts = options.parts or list(PARTS)
    for part in parts:
        if part not in PARTS:
            raise unknown("part", part, PARTS)
        if part != "kinematic":  # the others use physics; trained at least in its standard evaluation
            default_physics().check(f"part {part}")
    for simulation in options.simulations:
        find_simulator(simulation).check()
    if options.json:
        check_output(options.json)
    figures = [figure for part in parts for figure in PARTS[part](options)]
    table = Table("figure", Column("value", justify="right"), "unit", title=describe_machine(), title_justify="left")
    for name, value, unit in figures:
        table.add_row(name, f"{value:,.{2 if value < 100 else 0}f}", unit)
    Console().print(table)
    if options.json:
        write_json(options.json, {"machine": describe_machine(), "figures": [figure._asdict() for figure in figures]})
