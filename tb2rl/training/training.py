"""One training, from a config to a run folder."""

import re
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import chain, count
from pathlib import Path
from textwrap import shorten
from types import MappingProxyType
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from tb2rl.core import InputError, handle_termination_signals
from tb2rl.envs.scene import Scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.evaluation.evaluate import VALIDATION_SEED, Evaluator, random_initial_states
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.runs import Config, Run, TrainSettings, flatten, read_checkpoint, resolve
from tb2rl.runs.algorithm import check_device, check_trainable, make_algorithm, torch_settings
from tb2rl.runs.loading import checkpoint_config, load, load_parameters
from tb2rl.simulation.simulator import default_simulator, find_simulator
from tb2rl.tasks import Task
from tb2rl.training import state
from tb2rl.training.callbacks import TrainingCallbacks
from tb2rl.training.error_translation import translate_learning_errors, translate_resource_errors
from tb2rl.training.parallel_networks import parallelize_networks
from tb2rl.training.statistics import TensorBoard
from tb2rl.training.trackers import TrackedRun, Tracker, attach_trackers, find_trackers, run_name

_FAST_EPISODES, _SLOW_EPISODES = 1000, 20  # default number of episodes of an evaluation; slow: with images or physics
# Characters of a value and of all settings in the name of a run folder, because Windows limits the length of paths.
_MAX_VALUE, _MAX_SETTINGS = 30, 60
_EXTEND_HINT = "raise --total-timesteps to continue"


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
        agent: Name of an agent, "module:Class", or an algorithm class.
        task: Name of a task, "module:Class", or a task class. Save your own classes in a file: a policy trained with
            a class of a notebook or script can only be loaded in that notebook or script.
        preset: Name of a file in `configs`, or a path.
        settings: Single settings by dotted key, such as {"task.world": "circuit"}.
        folder: Path of the run folder; None: `runs/<task>/<agent>/<name>`.
        name: Name of the run folder in `runs/<task>/<agent>`; None: seed, settings, date and time.
        progress_bar: Whether to show the rate and the remaining time.
        train_settings: Fields of `tb2rl.runs.config.TrainSettings`, such as total_timesteps, seed or n_envs.

    Returns:
        The best policy of the run (without evaluations: the last one), loaded by `load`.

    Raises:
        InputError: If an argument is invalid.
    """
    if folder is not None and name is not None:
        raise InputError("folder= and name= exclude each other; give only one of them")
    chosen = {**(settings or {}), **{f"train.{key}": value for key, value in train_settings.items()}}
    config = resolve(agent, task, preset, chosen)
    folder = folder or default_folder(config, name, {"seed": config.train.seed, "preset": preset, **chosen})
    return load(train_config(config, folder, progress_bar).run.folder)


@dataclass(frozen=True)
class FinishedTraining:
    """The result of a training."""

    run: Run
    timesteps: int  # control steps since the start or the last resume
    seconds: float  # wall-clock time of these steps, including evaluations
    episode_lengths: Sequence[int]  # control steps of each episode of the run, also before a resume
    signal_number: int  # signal that interrupted the training; 0: none
    early_stop_timesteps: int | None  # control steps of the run, also before a resume, if evaluations stopped it


def train_config(
    config: Config,
    folder: str | Path,
    progress_bar: bool = False,
    verbose: int = 0,
    on_start: Callable[[Path], object] | None = None,
    on_evaluation: Callable[[Evaluation], object] | None = None,
    final_folder: Path | None = None,
    checkpoint: Mapping[str, Any] | None = None,
    watchers: Sequence[BaseCallback] = (),
) -> FinishedTraining:
    """Train with a config, and write the run folder.

    Args:
        config: The config, see `resolve`.
        folder: Path of the run folder.
        progress_bar: Whether to show the rate and the remaining time.
        verbose: 1 prints a line for each episode.
        on_start: Callback that gets the run folder when learning begins.
        on_evaluation: Callback that gets each evaluation during training; its exceptions end the training.
        final_folder: Path to which the run folder will be moved, for the run's name in trackers; None: `folder`.
        checkpoint: Content of the checkpoint to resume from; None: a new training.
        watchers: Further callbacks, which have no state to resume, such as the viewer of the training.
    """
    config = replace(config, train=config.train.with_thread_count())
    folder, settings = Path(folder), config.train
    check_trainable(config)
    check_device(settings.device)
    # The config of a checkpoint may be a stranger's, and must not import modules from its folder.
    trackers = find_trackers(settings.track, untrusted_folder=folder if checkpoint else None)
    with translate_resource_errors(folder), ExitStack() as resources:
        resources.enter_context(torch_settings(int(settings.torch_threads), settings.matmul_precision))
        scene = config.training_scene
        scene = scene.with_time_limit(settings.episode_steps) if settings.episode_steps else scene
        simulator = find_simulator(settings.simulation)
        simulator.check(purpose=f"a training in simulation {settings.simulation!r}")
        env = TurtleBot2VecEnv(scene, settings.n_envs, settings.reward_scale, simulator)
        resources.callback(env.close)
        algorithm = make_algorithm(config, env)
        parallelize_networks(algorithm)
        evaluator = make_evaluator(config.scene.for_purpose("validation"), settings) if settings.eval_freq else None
        resources.enter_context(evaluator or nullcontext())
        run = Run(folder, config) if checkpoint else Run.create(folder, config)
        cleanup_on_failure = resources.enter_context(ExitStack())  # removes a new folder if learning cannot start
        if not checkpoint:
            cleanup_on_failure.callback(shutil.rmtree, folder, ignore_errors=True)
        resources.enter_context(run.lock())
        learner = _Learner(run, algorithm, TrainingCallbacks(run, evaluator, on_evaluation, verbose), watchers)
        if checkpoint:
            learner.restore(checkpoint)
        resources.enter_context(learner.logging(trackers, final_folder or folder))
        cleanup_on_failure.pop_all()
        if on_start:
            on_start(folder)
        return learner.learn(progress_bar, is_new=checkpoint is None)


@dataclass(frozen=True)
class _Learner:
    """The parts of a training that is ready to learn."""

    run: Run
    algorithm: BaseAlgorithm
    callbacks: TrainingCallbacks
    watchers: Sequence[BaseCallback]

    def restore(self, content: Mapping[str, Any]) -> None:
        """Restore a checkpoint into the new algorithm and callbacks."""
        run, evaluations = self.run, self.callbacks.evaluation
        file, settings = run.checkpoints[0], run.config.train  # [0]: the latest
        load_parameters(self.algorithm, content, file)
        state.restore(content["training"], self.algorithm, self.callbacks, file)
        timesteps = self.algorithm.num_timesteps
        if evaluations and evaluations.stopped_training:
            if settings.total_timesteps == content["config"]["train"]["total_timesteps"]:  # the total was not raised
                raise InputError(f"{run.folder} has {describe_early_stop(settings, timesteps)}; {_EXTEND_HINT}")
            evaluations.clear_early_stop()
        run.drop_training_evaluations(after=timesteps)
        run.write_config()

    @contextmanager
    def logging(self, trackers: Sequence[type[Tracker]], final_folder: Path) -> Iterator[None]:
        """Log to TensorBoard and to trackers, which name the run after its final folder."""
        run, config = self.run, self.run.config
        leaves = {key: value for key, value in flatten(config.to_dict()).items() if value is not None}
        hyperparameters = {key: str(value) if isinstance(value, list) else value for key, value in leaves.items()}
        tensorboard = TensorBoard(run.folder / "tensorboard", self.algorithm.num_timesteps, hyperparameters)
        name = run_name(config.task_name, config.agent_name, final_folder)
        tracked_run = TrackedRun(run.folder, name, hyperparameters)
        with closing(Logger(str(run.folder), [tensorboard])) as logger:
            self.algorithm.set_logger(logger)
            with attach_trackers(logger, trackers, tracked_run, self.callbacks.checkpoint):
                yield

    def learn(self, progress_bar: bool, is_new: bool) -> FinishedTraining:
        """Learn, then save and evaluate the final policy."""
        run, algorithm = self.run, self.algorithm
        start_time, start_timesteps = time.monotonic(), algorithm.num_timesteps
        evaluations, checkpoints = self.callbacks.evaluation, self.callbacks.checkpoint
        with handle_termination_signals(checkpoints.handle_signal):
            with translate_learning_errors(algorithm, run):
                remaining = run.config.train.total_timesteps - start_timesteps
                callbacks = [self.callbacks, *self.watchers] if self.watchers else self.callbacks
                algorithm.learn(remaining, callbacks, reset_num_timesteps=is_new, progress_bar=progress_bar)
            run.save(algorithm, "final/policy")
            if not checkpoints.stopped_training:  # else a signal stopped learning, after a checkpoint was saved
                if evaluations and not evaluations.stopped_training:
                    evaluations.evaluate(progress_bar)
                checkpoints.save()  # after the evaluation, because its score is part of the checkpoint
        return FinishedTraining(
            run,
            timesteps=algorithm.num_timesteps - start_timesteps,
            seconds=time.monotonic() - start_time,
            episode_lengths=list(self.callbacks.statistics.lengths),
            signal_number=checkpoints.signal_number,
            early_stop_timesteps=algorithm.num_timesteps if evaluations and evaluations.stopped_training else None,
        )


def make_evaluator(scene: Scene, settings: TrainSettings, seed: int = VALIDATION_SEED) -> Evaluator:
    """Make the evaluator of a training; `seed` determines initial states and noise."""
    simulator = find_simulator(settings.eval_simulation)
    try:
        scene.check(simulator)
    except InputError as error:
        simulator = default_simulator()
        print(f"evaluations during training use {simulator.title}, and are slower: {error}", flush=True)
    is_slow = simulator.is_physics or scene.has_images
    num_episodes = settings.eval_episodes or (_SLOW_EPISODES if is_slow else _FAST_EPISODES)
    states = random_initial_states(scene, num_episodes, seed)
    return Evaluator(scene, states, settings.eval_steps, seed, simulation=simulator)


def resume(
    folder: str | Path,
    total_timesteps: int | None = None,
    progress_bar: bool = False,
    verbose: int = 0,
    on_start: Callable[[Path], object] | None = None,
    watchers: Sequence[BaseCallback] = (),
) -> FinishedTraining:
    """Resume the training of a run folder from its last checkpoint, as if it had not been interrupted.

    Args:
        folder: Path of the run folder.
        total_timesteps: New total, not less than the present total; schedules end at the new total. None: no change.
        progress_bar, verbose, on_start, watchers: See `train_config`.
    """
    run = Run.open(Path(folder))
    if not run.checkpoints:
        raise InputError(f"{folder} has no checkpoint to resume from")
    file, old_total = run.checkpoints[0], run.config.train.total_timesteps  # [0]: the latest
    content = read_checkpoint(file)
    # An earlier resume may have raised the total of the config, but ended before it saved a checkpoint.
    if _with_total(checkpoint_config(content, file), old_total) != run.config or "training" not in content:
        raise InputError(f"{file} does not belong to the training of {folder}")
    new_total = old_total if total_timesteps is None else total_timesteps
    if new_total < old_total:
        raise InputError(f"the total is {old_total} steps already; give this number or a larger one, not {new_total}")
    if content["timesteps"] >= new_total:
        raise InputError(f"{folder} has all its {new_total} steps; {_EXTEND_HINT}")
    config = _with_total(run.config, new_total)
    return train_config(config, run.folder, progress_bar, verbose, on_start, checkpoint=content, watchers=watchers)


def _with_total(config: Config, total_timesteps: int) -> Config:
    return replace(config, train=replace(config.train, total_timesteps=total_timesteps))


def describe_early_stop(settings: TrainSettings, timesteps: int) -> str:
    """Describe in one line why evaluations stopped a training."""
    return (
        f"stopped after {timesteps} of {settings.total_timesteps} steps: {settings.stop_evaluations} evaluations in a "
        f"row reached the train.stop_score of {100 * (settings.stop_score or 0.0):g} %"
    )


def default_folder(config: Config, name: str | None = None, chosen: Mapping[str, Any] = MappingProxyType({})) -> Path:
    """The path `runs/<task>/<agent>/<name>`.

    Args:
        config: The config of the run.
        name: Name of the folder. None: the first chosen settings, date and time, and a number if that folder exists.
        chosen: Values by key, whose last part is shown; not those that are None.
    """
    parent = Path("runs", config.task_name.rpartition(":")[2], config.agent_name.rpartition(":")[2])
    if name:
        if Path(name).name != name or name == ".." or not name.isprintable():
            raise InputError(f"--name (name=) is {name!r}; give a folder name of printable characters, without a path")
        return parent / name
    values = {key.rpartition(".")[2]: str(value) for key, value in chosen.items() if value is not None}
    texts = {key: re.sub(r"[^\w.+-]+", "_", value, flags=re.ASCII).strip("_") for key, value in values.items()}
    settings = " ".join(f"{key}={text[:_MAX_VALUE]}" for key, text in texts.items())
    shortened = shorten(settings, _MAX_SETTINGS, placeholder="", break_on_hyphens=False).replace(" ", "-")
    stem = f"{shortened}-{datetime.now():%Y%m%d-%H%M%S}".lstrip("-")
    names = chain([stem], (f"{stem}-{number}" for number in count(2)))
    return next(parent / name for name in names if not (parent / name).exists())
