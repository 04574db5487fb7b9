"""What a policy does from many start poses, and the figures that say how good that is."""

from __future__ import annotations

import dataclasses
import json
import math
import pickle
import signal
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cloudpickle
import numpy as np
import torch as th
from rich.console import Console
from rich.table import Table

from tb2rl.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.config import Config, config_from
from tb2rl.driving import Policy, drive
from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import InputError, one_line
from tb2rl.maze import load_maze
from tb2rl.observations import prepare
from tb2rl.processes import main_hidden, process_context, processors
from tb2rl.runs import EVALUATION, WAYS, config_of, load, versions, write
from tb2rl.settings import Count, checked, read_text, type_with_checks
from tb2rl.tasks import Task

EPISODES, STEPS = 100, 1500
SEED = 20_180_000  # of the standard start poses; trainings with small seeds never draw them
TRAINING_SEED = 20_190_000  # of the evaluations while training
PASSED = 0.95  # success rate from which a training counts as one that has learned


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
    path: np.ndarray  # x, y [m] at the start and after each step, shape (length + 1, 2), float32
    actions: np.ndarray  # of each step, shape (length,), uint8


_ARRAYS = ("path", "actions")
_FIGURES = tuple(field.name for field in dataclasses.fields(Episode) if field.name not in _ARRAYS)


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
            "endings": {
                ended: sum(e.ended == ended for e in episodes) for ended in sorted({e.ended for e in episodes})
            },
        }

    @property
    def score(self) -> tuple[float, float]:
        """What makes one evaluation better than another: the success rate, then the mean return."""
        success = [episode.success for episode in self.episodes]
        returns = [episode.episode_return for episode in self.episodes]
        return float(np.mean(success)), float(np.mean(returns))


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
        self.task, self.observation = replace(task, episode_steps=steps), observation
        self.steps, self.seed = steps, seed
        maze = load_maze(task.maze)
        self.poses = maze.random_poses(np.random.default_rng(seed), episodes, task.start_clearance)
        workers = min(workers or processors(), episodes)
        self._pool = None
        if workers > 1:
            world = (cloudpickle.dumps(self.task), observation)
            self._pool = ProcessPoolExecutor(workers, process_context(), initializer=_open_world, initargs=world)

    def run(self, policy: Policy) -> Evaluation:
        """Drive all episodes."""
        if self._pool is None:
            env = TurtleBot2Env(self.task, self.observation)
            episodes = [judge(env, policy, pose, self.seed + i) for i, pose in enumerate(self.poses)]
            env.close()
        else:
            with TemporaryDirectory() as folder:  # a table can have millions of values: through no pipe, each time
                file = Path(folder, "policy")
                file.write_bytes(cloudpickle.dumps(policy))
                with main_hidden():  # processes start as they are needed
                    jobs = [
                        self._pool.submit(_drive_one, file, pose, self.seed + i) for i, pose in enumerate(self.poses)
                    ]
                episodes = [job.result() for job in jobs]
        return Evaluation(episodes, self.task, self.steps, self.seed)

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def __enter__(self) -> Evaluator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def judge(env: TurtleBot2Env, policy: Policy, pose: np.ndarray, seed: int) -> Episode:
    """One episode of the greedy policy from `pose` (x, y, yaw)."""
    moments = list(drive(env, policy, seed, pose))
    last = moments[-1]
    return Episode(
        start=tuple(pose.tolist()),
        ended=last.info["ended"],
        success=last.info["is_success"],
        touched=any(moment.info["bumped"] for moment in moments),
        length=last.step,
        distance=last.info["distance"],
        episode_return=last.total,
        path=np.array([moments[0].before[:2], *(moment.pose[:2] for moment in moments)], dtype=np.float32),
        actions=np.array([moment.action for moment in moments], dtype=np.uint8),
    )


def wilson_interval(count: int, total: int, z: float = 1.959964) -> tuple[float, float]:
    """The 95 % interval of a rate (Wilson 1927): honest near 0 and 1, where the usual one is not."""
    rate, spread = count / total, z * z / total
    centre = (rate + spread / 2) / (1 + spread)
    half = z / (1 + spread) * math.sqrt(rate * (1 - rate) / total + spread / (4 * total))
    return max(0.0, centre - half), min(1.0, centre + half)


def bootstrap_interval(values: Sequence[float], resamples: int = 10_000) -> tuple[float, float]:
    """The 95 % interval of the mean of a few trainings (percentile bootstrap, Agarwal et al. 2021).

    Too narrow for fewer than ten; of two or three it is their range.
    """
    drawn = np.random.default_rng(0).choice(np.asarray(values), size=(resamples, len(values)))
    low, high = np.percentile(drawn.mean(axis=1), [2.5, 97.5])
    return float(low), float(high)


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
        config = config_of(policy)
    config = with_task(config, settings or {})
    check_observes(policy, config)
    with Evaluator(config.task_settings, config.observation, **conditions) as evaluator:
        return evaluator.run(getattr(policy, "policy", policy))


def check_observes(policy: Any, config: Config) -> None:
    """Raise an `InputError` where a policy would get other observations or actions than it knows."""
    _, task, observe, _ = prepare(config.task_settings, config.observation)
    known = getattr(policy, "observation_space", observe.space)
    if known != observe.space:
        raise InputError(f"the policy knows the observation {known}, but this task gives {observe.space}")
    actions = getattr(getattr(policy, "action_space", None), "n", len(task.commands))
    if actions != len(task.commands):
        raise InputError(f"the policy knows {actions} actions, but this task has {len(task.commands)}")


def with_task(config: Config, settings: Mapping[str, Any]) -> Config:
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
        table.add_row(
            name, f"{100 * summary[f'{key}_rate']:.1f} %", f"95 % interval {100 * low:.1f} to {100 * high:.1f} %"
        )

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
    episodes = [{name: getattr(episode, name) for name in _FIGURES} for episode in evaluation.episodes]
    tree = {**summary, "policy": policy, "config": config.to_dict(), "versions": versions(), "each": episodes}
    try:
        write(path, json.dumps(tree, indent=1) + "\n")
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from None


def keep(evaluation: Evaluation, summary: Mapping[str, Any], config: Config, policy: str, folder: Path) -> None:
    """Put the standard evaluation into a run folder: `save` it, and beside it the way of every episode."""
    try:
        write_checkpoint(
            folder / WAYS, {name: [getattr(episode, name) for episode in evaluation.episodes] for name in _ARRAYS}
        )
    except OSError as error:
        raise InputError(f"cannot write {folder / WAYS}: {error.strerror}") from None
    save(evaluation, summary, config, policy, folder / EVALUATION)


def has_kept(folder: Path) -> bool:
    """Whether `keep` put an evaluation into a run folder."""
    return (folder / EVALUATION).is_file() and (folder / WAYS).is_file()


def kept(folder: Path) -> Evaluation:
    """The evaluation that `keep` put into a run folder.

    Raises:
        InputError: If there is none, or its files are damaged or do not belong together.
    """
    file = folder / EVALUATION
    if not has_kept(folder):
        raise InputError(f"{folder} has no standard evaluation: run `python -m tb2rl.evaluate {folder}`")
    ways = read_checkpoint(folder / WAYS)
    try:
        tree = json.loads(read_text(file))
        columns = [ways[name] for name in _ARRAYS]
        trees = [
            {**each, **dict(zip(_ARRAYS, arrays, strict=True))}
            for each, *arrays in zip(tree["each"], *columns, strict=True)
        ]
        episodes = checked(list[type_with_checks(Episode)], trees, "each")  # type: ignore[misc]
        if not episodes or any((e.path.shape, e.actions.shape) != ((e.length + 1, 2), (e.length,)) for e in episodes):
            raise ValueError("its episodes have other lengths than their paths")
        task = replace(config_from(tree["config"]).task_settings, episode_steps=checked(Count, tree["steps"], "steps"))
        if not all(np.isfinite(e.path).all() and e.actions.dtype == np.uint8 for e in episodes):
            raise ValueError("its paths or actions are none")
        if max(e.actions.max() for e in episodes) >= len(task.commands):
            raise ValueError("its actions are not the task's")
        return Evaluation(episodes, task, task.episode_steps, checked(int, tree["seed"], "seed"))
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(one_line(f"{file} is not an evaluation with {WAYS} beside it: {error}")) from None


_world: TurtleBot2Env  # of a worker process


def _open_world(task: bytes, observation: str) -> None:
    global _world
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process; the one that asked decides
    th.set_num_threads(1)
    _world = TurtleBot2Env(pickle.loads(task), observation)


def _drive_one(policy: Path, pose: np.ndarray, seed: int) -> Episode:
    return judge(_world, pickle.loads(policy.read_bytes()), pose, seed)
