"""One training, from a config to a run folder."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger

from tb2rl.core.errors import InputError
from tb2rl.core.signals import ending_signals
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.runs.algorithm import check_device, check_trainable, make_algorithm
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.config import Config, TrainSettings
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import content_config, load
from tb2rl.runs.parameters import load_parameters
from tb2rl.tasks import Task
from tb2rl.training import state
from tb2rl.training.callbacks import StopOnSignal, TrainingCallbacks
from tb2rl.training.environments import make_evaluator, make_vec_env
from tb2rl.training.error_translation import translate_learning_errors, translate_machine_errors
from tb2rl.training.statistics import TensorBoard, flat
from tb2rl.training.trackers import Tracked, Tracker, find_trackers, run_name, tracking

_ADVICE = "raise --total-timesteps to go on"


def train(
    agent: str | type[BaseAlgorithm] | None = None,
    task: str | type[Task] | None = None,
    *,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
    folder: str | Path | None = None,
    name: str | None = None,
    progress_bar: bool = False,
    **train_settings: Any,
) -> BaseAlgorithm:
    """Train an agent and leave a run folder.

    Args:
        agent: Its name in the registry, "module:Class", or the class of its algorithm.
        task: The task's name, "module:Class", or its class. A class of a notebook or script can be loaded there only;
            for a run that is to be loaded anywhere else, save the class in a file.
        preset: The name of a file in `configs`, or the path of one.
        settings: Single settings by dotted key, such as {"task.world": "circuit"}.
        folder: The run folder; None: `runs/<task>/<agent>/<name>`.
        name: Of the run folder in `runs`; None: date and time.
        progress_bar: Whether to show the rate and the remaining time.
        train_settings: Fields of `tb2rl.runs.config.TrainSettings`, such as total_timesteps, seed or n_envs.

    Returns:
        The run's best policy, as `load` gives it.

    Raises:
        InputError: For any argument that does not fit.
    """
    if folder is not None and name is not None:
        raise InputError("name= is for a run folder in runs/TASK/AGENT; give either it or folder=")
    given = {f"train.{key}": value for key, value in train_settings.items()}
    config = resolve(agent, task, preset, {**(settings or {}), **given})
    return load(train_config(config, folder or default_folder(config, name), progress_bar).run.folder)


@dataclass(frozen=True)
class Training:
    """The result of a training.

    Attributes:
        timesteps: Control steps; of a resumed training, since it was resumed.
        seconds: Of learning them, evaluations included.
        lengths: Control steps of each episode.
        interrupted: The number of the signal that ended it; 0: none.
        stopped_after: Control steps since it began, if evaluations stopped it early.
    """

    run: Run
    timesteps: int
    seconds: float
    lengths: Sequence[int]
    interrupted: int
    stopped_after: int | None


def train_config(
    config: Config,
    folder: str | Path,
    progress_bar: bool = False,
    verbose: int = 0,
    on_start: Callable[[Path], object] | None = None,
    on_evaluation: Callable[[Evaluation], object] | None = None,
    tracked_folder: Path | None = None,
) -> Training:
    """Train a resolved config in a run folder.

    Args:
        config, folder, progress_bar: See `train`.
        verbose: 1: a line for each episode.
        on_start: Called with the run folder once nothing was refused.
        on_evaluation: Called with each evaluation during training; an exception from it ends the training.
        tracked_folder: The final place of a run folder that is made elsewhere, as on another machine, for trackers.
    """
    trainer = Trainer(config, Path(folder), None, verbose, on_start, on_evaluation, tracked_folder)
    return trainer.train(progress_bar)


def resume(
    folder: str | Path,
    total_timesteps: int | None = None,
    progress_bar: bool = False,
    verbose: int = 0,
    on_start: Callable[[Path], object] | None = None,
) -> Training:
    """Continue the training of a run folder from its last checkpoint, as if it had not been interrupted.

    Args:
        folder: The run folder.
        total_timesteps: A larger total than the run began with; schedules then stretch over it.
        progress_bar, verbose, on_start: As in `train_config`.

    Raises:
        InputError: If there is nothing to resume, or it does not fit.
    """
    run = Run.open(Path(folder))
    if not run.checkpoints:
        raise InputError(f"{folder} has no checkpoint of its training to go on from")
    file = run.checkpoints[0]
    content = read_checkpoint(file)
    config = run.config
    saved = content_config(content, file)
    # The folder may say more steps, if an earlier resume ended before its first checkpoint.
    longer = replace(saved, train=replace(saved.train, total_timesteps=config.train.total_timesteps))
    if longer != config or "training" not in content:
        raise InputError(f"{file} is not a checkpoint of the training that {folder} describes")
    if total_timesteps is not None:
        if total_timesteps < config.train.total_timesteps:
            raise InputError(f"the run was begun with {config.train.total_timesteps} steps; ask for more, not for less")
        config = replace(config, train=replace(config.train, total_timesteps=total_timesteps))
    if content["timesteps"] >= config.train.total_timesteps:
        raise InputError(f"{folder} has all its {config.train.total_timesteps} steps; {_ADVICE}")
    checkpoint = _Checkpoint(file, content, saved.train.total_timesteps)
    return Trainer(config, run.folder, checkpoint, verbose, on_start).train(progress_bar)


@dataclass(frozen=True)
class _Checkpoint:
    """The checkpoint from which a training continues, and the total of control steps that it was saved with."""

    file: Path
    content: Mapping[str, Any]
    total_timesteps: int


@dataclass(frozen=True)
class Trainer:
    """Trains one config in its run folder; see `train_config` for its attributes.

    Attributes:
        checkpoint: The checkpoint to continue from; None: a new training.
    """

    config: Config
    folder: Path
    checkpoint: _Checkpoint | None = None
    verbose: int = 0
    on_start: Callable[[Path], object] | None = None
    on_evaluation: Callable[[Evaluation], object] | None = None
    tracked_folder: Path | None = None

    def train(self, progress_bar: bool) -> Training:
        """Check the config, open everything that the training needs, and learn."""
        settings, scene = self.config.train, self.config.scene
        check_trainable(self.config)
        check_device(settings.device)
        trackers = find_trackers(settings.track, self.folder if self.checkpoint else None)
        with translate_machine_errors(self.folder), ExitStack() as resources:
            resources.callback(th.set_num_threads, th.get_num_threads())  # they are the whole program's
            th.set_num_threads(settings.torch_threads)
            env = resources.enter_context(closing(make_vec_env(scene, settings)))
            algorithm = make_algorithm(self.config, env)
            evaluator = make_evaluator(self.config.validation_scene, settings) if settings.eval_freq else None
            resources.enter_context(evaluator or nullcontext())
            run = Run(self.folder, self.config) if self.checkpoint else Run.create(self.folder, self.config)
            refused = resources.enter_context(ExitStack())  # leaves no new folder behind if a tracker cannot begin
            if not self.checkpoint:
                refused.callback(shutil.rmtree, run.folder, ignore_errors=True)
            resources.enter_context(run.lock())
            callbacks = TrainingCallbacks(run, evaluator, self.on_evaluation, self.verbose)
            if self.checkpoint:
                self._restore(self.checkpoint, algorithm, callbacks)
                run.drop_evaluations(after=algorithm.num_timesteps)
                run.write_config()
            resources.enter_context(self._logging(algorithm, trackers, callbacks.stop))
            refused.pop_all()
            if self.on_start:
                self.on_start(run.folder)
            return self._learn(run, algorithm, callbacks, progress_bar)

    def _restore(self, checkpoint: _Checkpoint, algorithm: BaseAlgorithm, callbacks: TrainingCallbacks) -> None:
        load_parameters(algorithm, checkpoint.content, checkpoint.file)
        try:
            first = state.restore(checkpoint.content["training"], algorithm, callbacks.stateful)
        except InputError as error:
            raise InputError(f"{checkpoint.file}: {error}") from None
        callbacks.callbacks.insert(0, first)
        if callbacks.evaluation and callbacks.evaluation.stopped:
            if self.config.train.total_timesteps == checkpoint.total_timesteps:
                reason = early_stop(self.config.train, algorithm.num_timesteps)
                raise InputError(f"{self.folder} has {reason}; {_ADVICE}")
            callbacks.evaluation.restart()

    @contextmanager
    def _logging(
        self, algorithm: BaseAlgorithm, trackers: Sequence[type[Tracker]], stop: StopOnSignal
    ) -> Iterator[None]:
        """Log to TensorBoard and to trackers."""
        hyperparameters = flat(self.config.to_dict())
        tensorboard = TensorBoard(self.folder / "tensorboard", algorithm.num_timesteps, hyperparameters)
        algorithm.set_logger(Logger(str(self.folder), [tensorboard]))
        name = run_name(self.config.task_name, self.config.agent_name, self.tracked_folder or self.folder)
        tracked = Tracked(self.folder, name, hyperparameters)
        with closing(algorithm.logger), tracking(algorithm.logger, trackers, tracked, stop):
            yield

    def _learn(self, run: Run, algorithm: BaseAlgorithm, callbacks: TrainingCallbacks, progress_bar: bool) -> Training:
        """Learn, then save and evaluate the final policy."""
        started, before = time.monotonic(), algorithm.num_timesteps
        left, is_new = self.config.train.total_timesteps - before, self.checkpoint is None
        evaluation, stop = callbacks.evaluation, callbacks.stop
        with ending_signals(stop.receive):
            with translate_learning_errors(algorithm, run):
                algorithm.learn(left, callbacks, reset_num_timesteps=is_new, progress_bar=progress_bar)
            run.save(algorithm, "final/policy")
            if not stop.stopped:
                if evaluation and not evaluation.stopped:
                    evaluation.evaluate(progress_bar)
                callbacks.checkpoints.save()  # holds the best score, in case the training is resumed
        seconds, timesteps = time.monotonic() - started, algorithm.num_timesteps
        stopped_after = timesteps if evaluation and evaluation.stopped else None
        lengths = list(callbacks.statistics.lengths)
        return Training(run, timesteps - before, seconds, lengths, stop.received, stopped_after)


def early_stop(settings: TrainSettings, timesteps: int) -> str:
    """The reason of an early stop, in a line."""
    return (
        f"stopped after {timesteps} of {settings.total_timesteps} steps: {settings.stop_evaluations} evaluations in a "
        f"row reached {100 * (settings.stop_score or 0.0):g} %"
    )


def default_folder(config: Config, name: str | None = None) -> Path:
    """`runs/<task>/<agent>/<name>`; without a name date and time, and a number if that exists.

    Raises:
        InputError: If the name is a path, or not printable.
    """
    folder = Path("runs", *(each.rpartition(":")[2] for each in (config.task_name, config.agent_name)))
    if name:
        if Path(name).name != name or name == ".." or not name.isprintable():
            raise InputError(f"--name (name=) is the name of a folder, of printable text without a path, got {name!r}")
        return folder / name
    name = datetime.now().strftime("%Y%m%d-%H%M%S")
    names = [name, *(f"{name}-{i}" for i in range(2, 1000))]
    return next(folder / name for name in names if not (folder / name).exists())
