"""The standard evaluation: a greedy policy in PyBullet's physics, from start poses that training did not draw.

    python -m tb2rl.evaluate runs/maze/dqn/NAME
    python -m tb2rl.evaluate --agent wallfollower

100 episodes of at most 1 500 control steps, each with a start pose and a random stream of its own: the result does not
depend on how many processes share the work.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import multiprocessing
import os
import pickle
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import cloudpickle
import numpy as np
import torch as th
from rich.console import Console
from rich.table import Table

from tb2rl.config import Config, config_from, parse_settings, resolve
from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import InputError, command
from tb2rl.maze import load_maze
from tb2rl.runs import Run, checkpoint_file, load, make_baseline, versions, write
from tb2rl.tasks import Task

EPISODES, STEPS = 100, 1500
SEED = 20_180_000  # of the standard start poses; trainings with small seeds never draw them
TRAINING_SEED = 20_190_000  # of the evaluations while training


class Policy(Protocol):
    """What is evaluated: anything with Stable-Baselines3's `predict`."""

    def predict(self, observation: np.ndarray, *, deterministic: bool = False) -> tuple[np.ndarray, Any]:
        """Action and state for an observation."""


@dataclass(frozen=True)
class Episode:
    """One evaluated episode; the return and the distance are sums over its steps."""

    start: tuple[float, float, float]  # x [m], y [m], yaw [rad]
    ended: str  # "crash", "goal", ..., "time limit"
    success: bool
    touched: bool  # whether the bumper fired
    length: int  # control steps
    distance: float  # [m]
    episode_return: float
    path: np.ndarray  # x, y [m] after each step, shape (length + 1, 2), float32


@dataclass(frozen=True)
class Evaluation:
    """What a policy did, and what it was asked to do."""

    episodes: Sequence[Episode]
    task: Task
    steps: int
    seed: int

    def summary(self) -> dict[str, Any]:
        """The figures, for a table or a JSON file; speeds in m/s, distances in m, rates with 95 % intervals."""
        episodes, seconds = self.episodes, self.task.control_period
        crash_free = [episode.ended != "crash" for episode in episodes]
        success = [episode.success for episode in episodes]
        lengths = [episode.length for episode in episodes]
        distances = [episode.distance for episode in episodes]
        returns = [episode.episode_return for episode in episodes]
        return {
            "episodes": len(episodes),
            "steps": self.steps,
            "seed": self.seed,
            "crash_free_rate": float(np.mean(crash_free)),
            "crash_free_interval": wilson_interval(sum(crash_free), len(episodes)),
            "success_rate": float(np.mean(success)),
            "success_interval": wilson_interval(sum(success), len(episodes)),
            "touch_free_rate": float(np.mean([not episode.touched for episode in episodes])),
            "mean_distance": float(np.mean(distances)),
            "std_distance": float(np.std(distances)),
            "mean_return": float(np.mean(returns)),
            "std_return": float(np.std(returns)),
            "mean_length": float(np.mean(lengths)),
            "std_length": float(np.std(lengths)),
            "mean_speed": sum(distances) / (sum(lengths) * seconds),
            "endings": {ended: sum(e.ended == ended for e in episodes) for ended in sorted({e.ended for e in episodes})},
        }

    @property
    def score(self) -> tuple[float, float]:
        """What makes one evaluation better than another: the success rate, then the mean return."""
        return float(np.mean([e.success for e in self.episodes])), float(np.mean([e.episode_return for e in self.episodes]))


class Evaluator:
    """Worlds that stand ready to evaluate policies, spread over processes.

    Args:
        task: What to do; its start poses and time limit are replaced.
        observation: "discrete" or "raw".
        episodes: How many, each from a start pose of its own.
        steps: Control steps at most in an episode.
        seed: Of the start poses and of all noise.
        workers: Processes; None: one for each processor, 1: none but this one.
    """

    def __init__(
        self,
        task: Task,
        observation: str,
        episodes: int = EPISODES,
        steps: int = STEPS,
        seed: int = SEED,
        workers: int | None = None,
    ) -> None:
        self.task, self.observation, self.steps, self.seed = replace(task, episode_steps=steps), observation, steps, seed
        maze = load_maze(task.maze)
        self.poses = maze.random_poses(np.random.default_rng(seed), episodes, task.start_clearance)
        workers = min(workers or len(os.sched_getaffinity(0)), episodes)
        self._pool = None
        if workers > 1:
            self._pool = ProcessPoolExecutor(
                workers, _process_context(), initializer=_open_world, initargs=(cloudpickle.dumps(self.task), observation)
            )
            self._chunks = np.array_split(np.arange(episodes), 4 * workers)

    def run(self, policy: Policy) -> Evaluation:
        """Drive all episodes."""
        if self._pool is None:
            env = TurtleBot2Env(self.task, self.observation)
            episodes = [drive(env, policy, pose, self.seed + i) for i, pose in enumerate(self.poses)]
            env.close()
        else:
            data = cloudpickle.dumps(policy)
            jobs = [
                self._pool.submit(_drive_some, data, self.poses[chunk], self.seed + chunk) for chunk in self._chunks if len(chunk)
            ]
            episodes = [episode for job in jobs for episode in job.result()]
        return Evaluation(episodes, self.task, self.steps, self.seed)

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def __enter__(self) -> Evaluator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def drive(env: TurtleBot2Env, policy: Policy, pose: np.ndarray, seed: int) -> Episode:
    """One episode of the greedy policy from `pose` (x, y, yaw)."""
    observation, info = env.reset(seed=seed, options={"pose": tuple(pose)})
    path, total, touched, over = [info["pose"][:2]], 0.0, False, False
    while not over:
        action, _ = policy.predict(observation, deterministic=True)
        observation, reward, terminated, truncated, info = env.step(int(action))
        path.append(info["pose"][:2])
        total += float(reward)
        touched = touched or info["bumped"]
        over = terminated or truncated
    return Episode(
        start=tuple(pose.tolist()),
        ended=info["ended"],
        success=info["is_success"],
        touched=touched,
        length=len(path) - 1,
        distance=info["distance"],
        episode_return=total,
        path=np.array(path, dtype=np.float32),
    )


def evaluate(
    policy: Policy | str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    **conditions: Any,
) -> Evaluation:
    """Evaluate a policy; the standard evaluation unless `conditions` say otherwise.

    Args:
        policy: A loaded policy, a reference that `load` takes, or anything with `predict`.
        config: What it is to do; None: what it was trained to do.
        settings: Changes to the task by name, for example {"maze": "circuit"}.
        conditions: Arguments of `Evaluator`.
    """
    if isinstance(policy, str | Path):
        policy = load(policy)
    if config is None:
        config = getattr(policy, "trained_with", None)
        if config is None:
            raise InputError("evaluate needs a config for a policy that tb2rl did not train")
    config = changed(config, settings or {})
    th.set_num_threads(1)
    with Evaluator(config.task_settings, config.observation, **conditions) as evaluator:
        return evaluator.run(getattr(policy, "policy", policy))


def changed(config: Config, settings: Mapping[str, Any]) -> Config:
    """The config with some of its task's settings changed, checked again."""
    tree = config.to_dict()
    tree["task"].update(settings)
    return config_from(tree) if settings else config


def report(evaluation: Evaluation, title: str) -> dict[str, Any]:
    """Print the table of an evaluation and return its summary."""
    summary = evaluation.summary()
    table = Table(title=title, title_justify="left")
    table.add_column(f"{summary['episodes']} episodes of at most {evaluation.steps} steps")
    table.add_column("value", justify="right")
    table.add_column("", justify="left")

    def rate(name: str, key: str) -> None:
        low, high = summary[f"{key}_interval"]
        table.add_row(name, f"{100 * summary[f'{key}_rate']:.1f} %", f"95 % interval {100 * low:.1f} to {100 * high:.1f} %")

    rate("crash-free", "crash_free")
    if evaluation.task.goal_task:
        rate("goal reached", "success")
    for name, key, unit in (("distance", "distance", "m"), ("return", "return", ""), ("length", "length", "steps")):
        table.add_row(name, f"{summary[f'mean_{key}']:.1f}", f"± {summary[f'std_{key}']:.1f} {unit}".rstrip())
    table.add_row("speed", f"{summary['mean_speed']:.3f}", "m/s")
    table.add_row("endings", "", ", ".join(f"{ended} {count}" for ended, count in summary["endings"].items()))
    Console().print(table)
    return summary


def save(evaluation: Evaluation, summary: Mapping[str, Any], config: Config, policy: str, path: Path) -> None:
    """Write an evaluation as JSON: its figures, its conditions, and every episode."""
    episodes = [
        {field.name: getattr(episode, field.name) for field in dataclasses.fields(episode) if field.name != "path"}
        for episode in evaluation.episodes
    ]
    tree = {**summary, "policy": policy, "config": config.to_dict(), "versions": versions(), "each": episodes}
    try:
        write(path, json.dumps(tree, indent=1) + "\n")
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from None


def wilson_interval(count: int, total: int, z: float = 1.959964) -> tuple[float, float]:
    """The 95 % interval of a rate (Wilson 1927): honest near 0 and 1, where the usual one is not."""
    rate, spread = count / total, z * z / total
    centre = (rate + spread / 2) / (1 + spread)
    half = z / (1 + spread) * math.sqrt(rate * (1 - rate) / total + spread / (4 * total))
    return max(0.0, centre - half), min(1.0, centre + half)


def _process_context() -> multiprocessing.context.BaseContext:
    """Processes that start clean (a fork would copy torch's threads), from a server that has imported what they need."""
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    context = multiprocessing.get_context(method)
    if method == "forkserver":
        context.set_forkserver_preload(["tb2rl.evaluate"])
    return context


_world: TurtleBot2Env  # of a worker process


def _open_world(task: bytes, observation: str) -> None:
    global _world
    th.set_num_threads(1)
    _world = TurtleBot2Env(pickle.loads(task), observation)


def _drive_some(policy: bytes, poses: np.ndarray, seeds: np.ndarray) -> list[Episode]:
    loaded = pickle.loads(policy)
    return [drive(_world, loaded, pose, int(seed)) for pose, seed in zip(poses, seeds, strict=True)]


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tb2rl.evaluate", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("policy", nargs="?", help="run folder, checkpoint in it, or zoo:NAME")
    parser.add_argument("--agent", help="instead: an agent that does not learn, such as random or wallfollower")
    parser.add_argument("--task", help="its task (default: maze)")
    parser.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE", help="change the task, e.g. task.maze=circuit")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--steps", type=int, default=STEPS, help="control steps at most in an episode")
    parser.add_argument("--seed", type=int, default=SEED, help="of the start poses")
    parser.add_argument("--workers", type=int, help="processes (default: one for each processor)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result here, not into the run folder")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Evaluate a policy, print a table, write JSON."""
    options = parse(arguments)
    if (options.policy is None) == (options.agent is None):
        raise InputError("name either a policy (a run folder, a checkpoint, zoo:NAME) or an --agent")
    if min(options.episodes, options.steps, options.workers or 1) < 1 or options.seed < 0:
        raise InputError("--episodes, --steps and --workers must be at least 1, and --seed at least 0")
    settings = parse_settings(options.set)
    conditions = {"episodes": options.episodes, "steps": options.steps, "seed": options.seed, "workers": options.workers}
    if options.agent:
        config = resolve(options.agent, options.task, settings=settings)
        policy, name = make_baseline(config), options.agent
    else:
        policy, name = load(options.policy), str(checkpoint_file(options.policy))
        config = changed(policy.trained_with, _task_settings(settings))
    evaluation = evaluate(policy, config, **conditions)
    summary = report(evaluation, f"{name} in {evaluation.task.maze}")
    standard = (options.episodes, options.steps, options.seed) == (EPISODES, STEPS, SEED) and not settings
    if options.json:
        save(evaluation, summary, config, name, options.json)
    elif options.policy and standard and Path(options.policy).is_dir():
        save(evaluation, summary, config, name, Path(options.policy) / "evaluation.json")


def _task_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    for key in settings:
        if not key.startswith("task."):
            raise InputError(f"only the task of a trained policy can be changed (task.KEY=VALUE), got {key!r}")
    return {key.removeprefix("task."): value for key, value in settings.items()}


if __name__ == "__main__":
    main()
