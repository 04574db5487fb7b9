"""One training, from a config to a run folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from tb2rl import callbacks
from tb2rl.config import Config, resolve
from tb2rl.envs import TurtleBot2Env
from tb2rl.evaluation import TRAINING_SEED, Evaluator
from tb2rl.processes import ProcessVecEnv
from tb2rl.runs import Run, load, make_algorithm
from tb2rl.tasks import Task
from tb2rl.vec_env import BatchVecEnv


def train(
    agent: str | None = None,
    task: str | type[Task] | None = None,
    *,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
    folder: str | Path | None = None,
    progress_bar: bool = False,
    verbose: int = 0,
    **train_settings: Any,
) -> BaseAlgorithm:
    """Train an agent and leave a run folder.

    Args:
        agent: Its name in the registry, or "module:Class".
        task: The task's name, or "module:Class".
        preset: The name of a file in `configs`, or the path of one.
        settings: Single settings by dotted key, such as {"task.maze": "circuit"}.
        folder: The run folder; None: `runs/<task>/<agent>/<date and time>`.
        progress_bar: Whether to show the rate and the remaining time.
        verbose: 1: a line for each episode.
        train_settings: Fields of `config.TrainSettings`, such as total_timesteps, seed or n_envs.

    Returns:
        The run's best policy, as `load` gives it.

    Raises:
        InputError: For anything in the arguments that does not fit.
    """
    given = {f"train.{key}": value for key, value in train_settings.items() if value is not None}
    config = resolve(agent, task, preset, {**(settings or {}), **given})
    return load(train_config(config, folder or default_folder(config), progress_bar, verbose).run.folder)


@dataclass(frozen=True)
class Training:
    """How a training went."""

    run: Run
    timesteps: int
    seconds: float  # of learning, evaluations included
    lengths: Sequence[int]  # control steps of each episode
    interrupted: bool


def train_config(config: Config, folder: str | Path, progress_bar: bool = False, verbose: int = 0) -> Training:
    """`train` for a resolved config."""
    settings = config.train
    with ExitStack() as resources:
        th.set_num_threads(settings.torch_threads)
        env = make_vec_env(config)
        resources.callback(env.close)
        algorithm = make_algorithm(config, env)
        if settings.eval_freq:
            conditions = (settings.eval_episodes, settings.eval_steps, TRAINING_SEED)
            evaluator = resources.enter_context(Evaluator(config.task_settings, config.observation, *conditions))
        run = Run.create(Path(folder), config)
        algorithm.set_logger(configure(str(run.folder / "tensorboard"), ["tensorboard"]))
        statistics, stop = callbacks.Statistics(config.to_dict()), callbacks.StopOnInterrupt()
        watching: list[BaseCallback] = [statistics, stop]
        if settings.save_freq:
            watching.append(callbacks.Checkpoints(run, settings.save_freq))
        if settings.eval_freq:
            evaluation = callbacks.Evaluate(run, evaluator, settings.eval_freq)
            watching.append(evaluation)
        if settings.episodes:
            watching.append(callbacks.StopAfterEpisodes(settings.episodes))
        if verbose:
            watching.append(callbacks.EpisodeLines())
        started = time.monotonic()
        with stop:
            algorithm.learn(settings.total_timesteps, watching, progress_bar=progress_bar)
            run.save(algorithm, "final/policy.pt")
            if settings.eval_freq and not stop.interrupted:
                evaluation.evaluate()
        seconds = time.monotonic() - started
    return Training(run, algorithm.num_timesteps, seconds, statistics.lengths, stop.interrupted)


def make_vec_env(config: Config) -> VecEnv:
    """The worlds of a training: one batch of the fast twin, or PyBullet's, shared out among processes."""
    settings = config.train
    if settings.simulation == "kinematic":
        return BatchVecEnv(_training_task(config), config.observation, settings.n_envs, settings.reward_scale)
    worlds: list[Callable[[], gym.Env]] = [partial(_make_world, config)] * config.train.n_envs
    return DummyVecEnv(worlds) if len(worlds) == 1 else ProcessVecEnv(worlds)


def default_folder(config: Config) -> Path:
    """`runs/<task>/<agent>/<date and time>`, with a number where that is taken."""
    folder = Path("runs") / _file_name(config.task) / _file_name(config.agent)
    name = datetime.now().strftime("%Y%m%d-%H%M%S")
    names = [name, *(f"{name}-{i}" for i in range(2, 1000))]
    return next(folder / name for name in names if not (folder / name).exists())


def _file_name(name: str) -> str:
    return name.rpartition(":")[2]


def _training_task(config: Config) -> Task:
    steps = config.train.episode_steps
    return config.task_settings if steps is None else replace(config.task_settings, episode_steps=steps)


def _make_world(config: Config) -> gym.Env:
    env: gym.Env = Monitor(TurtleBot2Env(_training_task(config), config.observation))
    scale = config.train.reward_scale
    return env if scale == 1.0 else gym.wrappers.TransformReward(env, partial(_scaled, scale))


def _scaled(scale: float, reward: float) -> float:
    return scale * reward
