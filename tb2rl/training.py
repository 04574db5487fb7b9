"""One training, from a config to a run folder."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from torch.utils.tensorboard import SummaryWriter

from tb2rl import callbacks
from tb2rl.checkpoint import read_checkpoint
from tb2rl.config import Config, resolve
from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import InputError
from tb2rl.evaluation import TRAINING_SEED, Evaluator
from tb2rl.processes import ProcessVecEnv
from tb2rl.resume import Stateful, restore
from tb2rl.runs import Run, content_config, load, load_parameters, make_algorithm
from tb2rl.tasks import Task
from tb2rl.vec_env import BatchVecEnv
from tb2rl.watcher import Watcher

_DISK_TROUBLES = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}


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
    timesteps: int  # control steps; of a resumed training those since
    seconds: float  # of learning them, evaluations included
    lengths: Sequence[int]  # control steps of each episode
    interrupted: bool


def train_config(config: Config, folder: str | Path, progress_bar: bool = False, verbose: int = 0) -> Training:
    """`train` for a resolved config."""
    return _train(config, Path(folder), None, progress_bar, verbose)


def resume(
    folder: str | Path, total_timesteps: int | None = None, progress_bar: bool = False, verbose: int = 0
) -> Training:
    """Go on with the training of a run folder from its last checkpoint, as if nothing had happened.

    Args:
        folder: The run folder.
        total_timesteps: A larger total than the run was begun with; schedules then stretch over it.
        progress_bar, verbose: As in `train`.

    Raises:
        InputError: If there is nothing to resume, or it does not fit.
    """
    run = Run.open(Path(folder))
    if not run.checkpoints:
        raise InputError(f"{folder} has no checkpoint of its training to go on from")
    file = run.checkpoints[0]
    content = read_checkpoint(file)
    config = run.config
    if content_config(content, file) != config or "training" not in content:
        raise InputError(f"{file} is not a checkpoint of the training that {folder} describes")
    if total_timesteps is not None:
        if total_timesteps < config.train.total_timesteps:
            raise InputError(f"the run was begun with {config.train.total_timesteps} steps; ask for more, not for less")
        config = replace(config, train=replace(config.train, total_timesteps=total_timesteps))
    if content["timesteps"] >= config.train.total_timesteps:
        raise InputError(f"{folder} has all its {config.train.total_timesteps} steps; raise --total-timesteps to go on")
    return _train(config, run.folder, (file, content), progress_bar, verbose)


def _train(
    config: Config, folder: Path, resumed: tuple[Path, dict[str, Any]] | None, progress_bar: bool, verbose: int
) -> Training:
    settings = config.train
    with _troubles_named(folder), ExitStack() as resources:
        th.set_num_threads(settings.torch_threads)
        env = make_vec_env(config)
        resources.callback(env.close)
        algorithm = make_algorithm(config, env)
        evaluator = resources.enter_context(_evaluator(config)) if settings.eval_freq else None
        run = Run(folder, config) if resumed else Run.create(folder, config)
        resources.enter_context(run.lock())
        statistics, stop = callbacks.Statistics(config.to_dict()), callbacks.StopOnInterrupt()
        checkpoints = callbacks.Checkpoints(run, settings.save_freq, settings.keep)
        watcher = Watcher(settings.total_timesteps, config.task_settings.control_period)
        remembering: list[Any] = [statistics, checkpoints, watcher]
        if evaluator:
            evaluation = callbacks.Evaluate(run, evaluator, settings.eval_freq)
            remembering.append(evaluation)
        if settings.episodes:
            remembering.append(callbacks.StopAfterEpisodes(settings.episodes))
        checkpoints.others = remembering
        watching: list[BaseCallback] = [*remembering, stop, *([callbacks.EpisodeLines()] if verbose else [])]
        done = _restore(algorithm, run, *resumed, remembering) if resumed else 0
        algorithm.set_logger(Logger(str(run.folder), [TensorBoard(run.folder / "tensorboard", done)]))
        resources.callback(algorithm.logger.close)
        started = time.monotonic()
        with stop:
            with _divergence_named(algorithm):
                left = settings.total_timesteps - done
                algorithm.learn(left, watching, reset_num_timesteps=not resumed, progress_bar=progress_bar)
            run.save(algorithm, "final/policy")
            if not stop.interrupted:
                if evaluator:
                    evaluation.evaluate()
                checkpoints.save()  # it knows the best score, should more steps be asked
        seconds = time.monotonic() - started
    return Training(run, algorithm.num_timesteps - done, seconds, statistics.lengths, stop.interrupted)


def _evaluator(config: Config) -> Evaluator:
    settings = config.train
    conditions = (settings.eval_episodes, settings.eval_steps, TRAINING_SEED)
    return Evaluator(config.task_settings, config.observation, *conditions)


@contextmanager
def _troubles_named(folder: Path) -> Iterator[None]:
    """Say in one line that the disk is full, the folder cannot be written any more, or the memory is too small."""
    try:
        yield
    except OSError as error:
        if error.errno not in _DISK_TROUBLES:
            raise
        raise InputError(f"cannot write into {folder}: {error.strerror}; its last checkpoint stands") from None
    except MemoryError:
        raise InputError(
            "not enough memory: take fewer train.n_envs or task.beams, or a smaller agent.buffer_size, n_steps, "
            "batch_size or train.eval_episodes"
        ) from None


@contextmanager
def _divergence_named(algorithm: BaseAlgorithm) -> Iterator[None]:
    """Say in one line that what torch stumbles over is weights that are no numbers any more."""
    try:
        yield
    except (ValueError, RuntimeError):
        if all(bool(th.isfinite(parameter).all()) for parameter in algorithm.policy.parameters()):
            raise
        raise InputError(
            "the training diverged (weights that are no numbers); try a smaller agent.learning_rate"
        ) from None


def _restore(
    algorithm: BaseAlgorithm, run: Run, file: Path, content: dict[str, Any], remembering: Sequence[Stateful]
) -> int:
    """Put the content of a checkpoint into a training, undo what was noted after it; its timesteps."""
    load_parameters(algorithm, content, file)
    try:
        restore(content["training"], algorithm, remembering)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    run.write_config()
    run.forget_notes("evaluations.jsonl", after=algorithm.num_timesteps)
    return algorithm.num_timesteps


class TensorBoard(TensorBoardOutputFormat):
    """Stable-Baselines3's event files; those of a resumed training replace what a killed one wrote after `done`."""

    def __init__(self, folder: Path, done: int) -> None:
        self.writer = SummaryWriter(log_dir=str(folder), purge_step=done + 1 if done else None)
        self._is_closed = False


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
    return TrainingWorld(TurtleBot2Env(_training_task(config), config.observation), config.train.reward_scale)


class TrainingWorld(gym.Wrapper[np.ndarray, np.int64, np.ndarray, np.int64]):
    """Reports an episode that ends as Stable-Baselines3 wants it (its `Monitor` does not resume), scales rewards.

    Args:
        env: The world.
        reward_scale: Of the rewards that `step` returns; `episode` holds the unscaled return.
    """

    env: TurtleBot2Env

    def __init__(self, env: TurtleBot2Env, reward_scale: float = 1.0) -> None:
        super().__init__(env)
        self.reward_scale = reward_scale
        self._return, self._length = 0.0, 0

    def reset(self, **arguments: Any) -> tuple[np.ndarray, dict[str, Any]]:
        self._return, self._length = 0.0, 0
        return self.env.reset(**arguments)

    def step(self, action: np.int64) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._return += float(reward)
        self._length += 1
        if terminated or truncated:
            info["episode"] = {"r": self._return, "l": self._length, "t": 0.0}
        return observation, self.reward_scale * float(reward), terminated, truncated, info

    def state(self) -> dict[str, Any]:
        return {**self.env.state(), "return": self._return, "length": self._length}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.env.restore(state)
        self._return, self._length = float(state["return"]), int(state["length"])
