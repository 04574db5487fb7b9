"""One training, from a config to a run folder."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import has_images
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.evaluator import TRAINING_SEED, Evaluator, random_initial_states
from tb2rl.runs.algorithm import check_device, check_learns, make_algorithm
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.config import Config
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.runs.loading import content_config, load
from tb2rl.runs.parameters import load_parameters
from tb2rl.simulation import default_simulator, find_simulator
from tb2rl.tasks import Task
from tb2rl.training import state
from tb2rl.training.callbacks import Checkpoints, Evaluate, StopAfterEpisodes, StopOnInterrupt
from tb2rl.training.environments import make_vec_env
from tb2rl.training.statistics import EpisodeLines, Statistics, TensorBoard, flat
from tb2rl.training.trackers import Tracked, find_trackers, run_name, tracking
from tb2rl.training.troubles import learning_troubles_named, machine_troubles_named
from tb2rl.training.watcher import Watcher
from tb2rl.worlds.generators import Purpose

_GO_ON = "raise --total-timesteps to go on"
_MANY, _FEW = 1000, 20  # episodes of an evaluation: where all drive at once, and where a step takes time


def train(
    agent: str | type[BaseAlgorithm] | None = None,
    task: str | type[Task] | None = None,
    *,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
    folder: str | Path | None = None,
    name: str | None = None,
    progress_bar: bool = False,
    verbose: int = 0,
    **train_settings: Any,
) -> BaseAlgorithm:
    """Train an agent and leave a run folder.

    Args:
        agent: Its name in the registry, "module:Class", or the class of its algorithm.
        task: The task's name, "module:Class", or its class. A class of a notebook or of a script is found again there;
            for a run that is to be loaded anywhere else, save the class in a file.
        preset: The name of a file in `configs`, or the path of one.
        settings: Single settings by dotted key, such as {"task.world": "circuit"}.
        folder: The run folder; None: `runs/<task>/<agent>/<name>`.
        name: Of the run folder there; None: date and time.
        progress_bar: Whether to show the rate and the remaining time.
        verbose: 1: a line for each episode.
        train_settings: Fields of `tb2rl.runs.config.TrainSettings`, such as total_timesteps, seed or n_envs.

    Returns:
        The run's best policy, as `load` gives it.

    Raises:
        InputError: For anything in the arguments that does not fit.
    """
    if folder is not None and name is not None:
        raise InputError("name= is for a run folder in runs/TASK/AGENT; give either it or folder=")
    given = {f"train.{key}": value for key, value in train_settings.items()}
    config = resolve(agent, task, preset, {**(settings or {}), **given})
    return load(train_config(config, folder or default_folder(config, name), progress_bar, verbose).run.folder)


@dataclass(frozen=True)
class Training:
    """How a training went."""

    run: Run
    timesteps: int  # control steps; of a resumed training those since
    seconds: float  # of learning them, evaluations included
    lengths: Sequence[int]  # control steps of each episode
    interrupted: int  # the signal that asked it to end; 0: none
    stopped_after: int | None  # control steps since it began, if evaluations stopped it before its time was up


@dataclass(frozen=True)
class _Checkpoint:
    """Where a resumed training goes on."""

    file: Path
    content: Mapping[str, Any]
    total_timesteps: int  # that it was to have


def train_config(
    config: Config,
    folder: str | Path,
    progress_bar: bool = False,
    verbose: int = 0,
    began: Callable[[Path], object] | None = None,
    evaluated: Callable[[Evaluation], object] | None = None,
    place: Path | None = None,
) -> Training:
    """`train` for a resolved config.

    Args:
        config: What to train.
        folder, progress_bar, verbose: As in `train`.
        began: Is called with the run folder when nothing was refused.
        evaluated: Is called with each evaluation on the way; what it raises ends the training.
        place: Where the run folder belongs, if it is made elsewhere, as on another machine: trackers are told this.
    """
    return _train(config, Path(folder), None, progress_bar, verbose, began, evaluated, place)


def resume(
    folder: str | Path,
    total_timesteps: int | None = None,
    progress_bar: bool = False,
    verbose: int = 0,
    began: Callable[[Path], object] | None = None,
) -> Training:
    """Go on with the training of a run folder from its last checkpoint, as if nothing had happened.

    Args:
        folder: The run folder.
        total_timesteps: A larger total than the run was begun with; schedules then stretch over it.
        progress_bar, verbose, began: As in `train_config`.

    Raises:
        InputError: If there is nothing to resume, or it does not fit.
    """
    run = Run.open(Path(folder))
    if not run.checkpoints:
        raise InputError(f"{folder} has no checkpoint of its training to go on from")
    file = run.checkpoints[0]
    content = read_checkpoint(file)
    config = run.config
    begun = content_config(content, file)
    # The folder may say more steps: of a resume that ended before its first checkpoint.
    longer = replace(begun, train=replace(begun.train, total_timesteps=config.train.total_timesteps))
    if longer != config or "training" not in content:
        raise InputError(f"{file} is not a checkpoint of the training that {folder} describes")
    checkpoint = _Checkpoint(file, content, begun.train.total_timesteps)
    if total_timesteps is not None:
        if total_timesteps < config.train.total_timesteps:
            raise InputError(f"the run was begun with {config.train.total_timesteps} steps; ask for more, not for less")
        config = replace(config, train=replace(config.train, total_timesteps=total_timesteps))
    if content["timesteps"] >= config.train.total_timesteps:
        raise InputError(f"{folder} has all its {config.train.total_timesteps} steps; {_GO_ON}")
    return _train(config, run.folder, checkpoint, progress_bar, verbose, began)


def _train(
    config: Config,
    folder: Path,
    checkpoint: _Checkpoint | None,
    progress_bar: bool,
    verbose: int,
    began: Callable[[Path], object] | None,
    evaluated: Callable[[Evaluation], object] | None = None,
    place: Path | None = None,
) -> Training:
    settings = config.train
    check_learns(config)
    check_device(config)
    trackers = find_trackers(settings.track, folder if checkpoint else None)
    with machine_troubles_named(folder), ExitStack() as resources:
        resources.callback(th.set_num_threads, th.get_num_threads())  # they are the whole program's
        th.set_num_threads(settings.torch_threads)
        env = make_vec_env(config)
        resources.callback(env.close)
        algorithm = make_algorithm(config, env)
        evaluator = make_evaluator(config) if settings.eval_freq else None
        if evaluator:
            resources.callback(evaluator.close)
        run = Run(folder, config) if checkpoint else Run.create(folder, config)
        refused = resources.enter_context(ExitStack())  # where a tracker cannot begin, nothing is left behind
        if not checkpoint:
            refused.callback(shutil.rmtree, run.folder, ignore_errors=True)
        resources.enter_context(run.lock())
        statistics, checkpoints = Statistics(), Checkpoints(run, settings.save_freq, settings.keep)
        stop = StopOnInterrupt(partial(checkpoints.save, in_rollout=True))
        remembering: list[Any] = [
            statistics,
            checkpoints,
            Watcher(settings.total_timesteps, config.task.control_period, config.scene.actions.max_speed),
        ]
        if evaluator:
            evaluation = Evaluate(run, evaluator, settings, evaluated)
            remembering.append(evaluation)
        if settings.episodes:
            remembering.append(StopAfterEpisodes(settings.episodes))
        checkpoints.others = remembering
        watching: list[BaseCallback] = [*remembering, stop, *([EpisodeLines()] if verbose else [])]
        if checkpoint:
            watching.insert(0, _restore(algorithm, run, checkpoint, remembering))
            if evaluator and evaluation.stopped:
                if settings.total_timesteps == checkpoint.total_timesteps:
                    raise InputError(f"{folder} has {stopped_early(config, algorithm.num_timesteps)}; {_GO_ON}")
                evaluation.go_on()
        done = algorithm.num_timesteps
        algorithm.set_logger(Logger(str(run.folder), [TensorBoard(run.folder / "tensorboard", done, config.to_dict())]))
        resources.callback(algorithm.logger.close)
        tracked = Tracked(run.folder, run_name(config, place or run.folder), flat(config.to_dict()))
        resources.enter_context(tracking(algorithm.logger, trackers, tracked, stop))
        refused.pop_all()
        if began:
            began(run.folder)
        started = time.monotonic()
        with stop:
            with learning_troubles_named(algorithm, run):
                left = settings.total_timesteps - done
                algorithm.learn(left, watching, reset_num_timesteps=checkpoint is None, progress_bar=progress_bar)
            run.save(algorithm, "final/policy")
            if not stop.stopped:
                if evaluator and not evaluation.stopped:
                    evaluation.evaluate(progress_bar)
                checkpoints.save()  # it knows the best score, should more steps be asked
        seconds = time.monotonic() - started
    timesteps = algorithm.num_timesteps
    stopped_after = timesteps if evaluator and evaluation.stopped else None
    return Training(run, timesteps - done, seconds, statistics.lengths, stop.interrupted, stopped_after)


def stopped_early(config: Config, timesteps: int) -> str:
    """Why a training that its evaluations stopped has ended, in a line."""
    settings = config.train
    return (
        f"stopped after {timesteps} of {settings.total_timesteps} steps: {settings.stop_evaluations} evaluations in a "
        f"row reached {100 * (settings.stop_score or 0.0):g} %"
    )


def make_evaluator(config: Config, purpose: Purpose = "validation", seed: int = TRAINING_SEED) -> Evaluator:
    """The evaluator of a training, by its settings.

    Args:
        config: Of the training.
        purpose: Of the worlds, if they are generated; by those for validation the best policy is chosen.
        seed: Of the initial states and of all noise.
    """
    settings, scene = config.train, config.scene.worlds_for(purpose)
    simulator = find_simulator(settings.eval_simulation)
    try:
        scene.check(simulator)
    except InputError as error:
        simulator = default_simulator()
        print(f"evaluations on the way use {simulator.title}, and are slower: {error}", flush=True)
    slow = simulator.in_processes or has_images(scene.observation_space)
    states = random_initial_states(scene, settings.eval_episodes or (_FEW if slow else _MANY), seed)
    return Evaluator(scene, states, settings.eval_steps, seed, simulation=simulator)


def _restore(
    algorithm: BaseAlgorithm, run: Run, checkpoint: _Checkpoint, remembering: Sequence[state.Stateful]
) -> BaseCallback:
    """Put a checkpoint into a training, and undo what was noted after it; see `state.restore`."""
    load_parameters(algorithm, checkpoint.content, checkpoint.file)
    try:
        first = state.restore(checkpoint.content["training"], algorithm, remembering)
    except InputError as error:
        raise InputError(f"{checkpoint.file}: {error}") from None
    run.forget_evaluations(after=algorithm.num_timesteps)
    run.write_config()
    return first


def default_folder(config: Config, name: str | None = None) -> Path:
    """`runs/<task>/<agent>/<name>`; without a name date and time, with a number where that is taken.

    Raises:
        InputError: If the name is a path, or not printable.
    """
    folder = Path("runs") / _file_name(config.task_name) / _file_name(config.agent_name)
    if name:
        if Path(name).name != name or name == ".." or not name.isprintable():
            raise InputError(f"--name (name=) is the name of a folder, of printable text without a path, got {name!r}")
        return folder / name
    name = datetime.now().strftime("%Y%m%d-%H%M%S")
    names = [name, *(f"{name}-{i}" for i in range(2, 1000))]
    return next(folder / name for name in names if not (folder / name).exists())


def _file_name(name: str) -> str:
    return name.rpartition(":")[2]
