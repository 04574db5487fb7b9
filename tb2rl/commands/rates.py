"""Rates of the simulators: PyBullet alone and in processes, and the kinematic simulator."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np

from tb2rl.core.processes import main_hidden, process_context, processors
from tb2rl.envs.scene import make_scene
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.simulation.kinematic.records import Motion
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.tasks.wander import Wander

BEAMS = (6, 36, 720)
NUM_ENVS = (1, 64, 1024, 4096)
PARALLEL = 16  # environments in processes, as in the presets
_BLOCK = 50  # control steps between the two sides of a ratio


@dataclass(frozen=True)
class Figure:
    """One measured number."""

    name: str
    value: float
    unit: str


def measure_physics(seconds: float) -> list[Figure]:
    """The environment step of PyBullet, alone and in parallel processes."""
    figures = [figure for beams in BEAMS for figure in measure_step(beams, seconds)]
    return [*figures, *measure_processes(PARALLEL, seconds)]


def measure_step(beams: int, seconds: float) -> list[Figure]:
    """The environment step with raw ranges, and the bare physics steps in it."""
    scene = make_scene(Wander(beams=beams), "raw")
    env = TurtleBot2Env(scene)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    whole, bare = [], []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        actions = rng.integers(len(scene.actions.names), size=_BLOCK)
        before = env.simulator.state()
        times, over = _time_steps(env, actions)
        after = env.simulator.state()
        env.simulator.restore(before)
        whole.append(np.mean(times))
        bare.append(_time_bare(env.simulator, scene.actions.commands(actions[: len(times)]), env.task.control_period))
        env.simulator.restore(after)
        if over:
            env.reset()
    env.close()
    step, physics = float(np.median(whole)), float(np.median(bare))
    return [
        Figure(f"PyBullet, {beams} beams: step", 1.0 / step, "steps/s"),
        Figure(f"PyBullet, {beams} beams: bare stepping in it", 1e3 * physics, f"ms per {env.task.control_period} s"),
        Figure(f"PyBullet, {beams} beams: step / bare stepping", float(np.median(np.divide(whole, bare))), "ratio"),
    ]


def measure_processes(num_envs: int, seconds: float) -> list[Figure]:
    """Environments in parallel processes, one alone, and one alone in each process at once.

    The three alternate, because the speed of a machine changes from second to second. Processors that share a core do
    less at once than one after the other; the last figure excludes this loss.
    """
    together = TurtleBot2VecEnv(make_scene(Wander(), "discrete"), num_envs, simulation="bullet")
    together.seed(0)
    together.reset()
    rng, rates, count = np.random.default_rng(0), [], processors()
    with main_hidden():
        others = process_context().Pool(count - 1) if count > 1 else None
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        for actions in rng.integers(3, size=(_BLOCK, num_envs)):
            together.step(actions)
        many = _BLOCK * num_envs / (time.perf_counter() - start)
        pending = others.map_async(_rate_alone, range(1, count), 1) if others else None
        at_once = _rate_alone(0) + (sum(pending.get()) if pending else 0.0)
        rates.append((many, at_once, _rate_alone(0)))
    together.close()
    if others:
        others.terminate()
    many, at_once, one = np.array(rates).T
    medians = {
        ("one environment alone", "steps/s"): one,
        (f"{count} alone at once", "steps/s"): at_once,
        (f"{num_envs} environments in parallel processes", "steps/s"): many,
        (f"{num_envs} in parallel / ({count} x one alone)", "ratio"): many / one / count,
        (f"{num_envs} in parallel / {count} alone at once", "ratio"): many / at_once,
    }
    return [Figure(f"PyBullet, {name}", float(np.median(values)), unit) for (name, unit), values in medians.items()]


@cache
def _alone() -> gym.Env:
    """The environment of this process."""
    env = gym.make("tb2rl:TurtleBot2Maze-v0")
    env.reset(seed=0)
    return env


def _rate_alone(seed: int) -> float:
    """Rate of this process's environment with random actions [steps/s]."""
    env, start = _alone(), time.perf_counter()
    for action in np.random.default_rng(seed).integers(3, size=4 * _BLOCK):
        if True in env.step(action)[2:4]:  # terminated, truncated
            env.reset()
    return 4 * _BLOCK / (time.perf_counter() - start)


def measure_kinematic(seconds: float) -> list[Figure]:
    """The kinematic simulator for every number of environments and beams."""
    return [f for beams in BEAMS for num_envs in NUM_ENVS for f in measure_batch(num_envs, beams, seconds / 5)]


def measure_batch(num_envs: int, beams: int, seconds: float) -> list[Figure]:
    """The whole VecEnv step, and the compiled kernel alone with the same commands."""
    scene = make_scene(Wander(beams=beams), "raw")
    env = TurtleBot2VecEnv(scene, num_envs)
    env.seed(0)
    env.reset()
    simulation, period, rng = env.loop.simulator, scene.task.control_period, np.random.default_rng(0)
    assert isinstance(simulation, KinematicSimulator)
    whole, bare = list[float](), list[float]()
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(whole) < 3:  # the first two start the threads
        action = rng.integers(len(scene.actions.names), size=num_envs)
        motion = Motion(**{name: simulation.state().get(name, np.zeros((num_envs, 2))) for name in Motion._fields})
        motion.commands[:] = scene.actions.commands(action)
        start = time.perf_counter()
        env.step(action)
        between = time.perf_counter()
        simulation.step_arrays(motion, period)
        whole.append(between - start)
        bare.append(time.perf_counter() - between)
    name = f"kinematic, {num_envs} environments, {beams} beams"
    return [
        Figure(f"{name}: step", num_envs / float(np.mean(whole[2:])), "steps/s"),
        Figure(f"{name}: step / bare kernel", float(np.mean(whole[2:]) / np.mean(bare[2:])), "ratio"),
    ]


def _time_steps(env: TurtleBot2Env, actions: np.ndarray) -> tuple[list[float], bool]:
    times = []
    for action in actions:
        start = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(action)
        times.append(time.perf_counter() - start)
        if terminated or truncated:
            return times, True
    return times, False


def _time_bare(simulation: Any, commands: np.ndarray, period: float) -> float:
    total = 0.0
    simulation.set_duration(period)
    for command in commands:
        simulation.set_wheel_speeds(command[None])
        start = time.perf_counter()
        simulation.advance()
        total += time.perf_counter() - start
    return total / len(commands)
