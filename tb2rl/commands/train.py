"""Implementation of `python -m tb2rl.train`: one training, or one for each seed, and the standard evaluations."""

import argparse
import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback

from tb2rl.commands.arguments import refuse
from tb2rl.commands.evaluate import with_safety
from tb2rl.core import InputError, handle_termination_signals, write_json, write_text
from tb2rl.core.compiled import announce_compiling
from tb2rl.envs.worlds import register_worlds, worlds_of_files
from tb2rl.evaluation.evaluate import EPISODES, SOLVED_RATE, evaluate
from tb2rl.evaluation.progress import say
from tb2rl.evaluation.sim_to_sim import describe_place, explain_place
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.execution.arguments import make_executor
from tb2rl.execution.executor import Executor, Job
from tb2rl.runs import Config, Run, TrainSettings, load, parse_settings, resolve
from tb2rl.runs.algorithm import check_device, check_trainable
from tb2rl.simulation.simulator import default_simulator
from tb2rl.training.statistics import tutorial_scores
from tb2rl.training.trackers import check_trackers
from tb2rl.training.training import FinishedTraining, default_folder, describe_early_stop, resume, train_config
from tb2rl.viz.table import print_evaluation

LOG = "log.txt"  # file in the run folder: output of a training with --seeds
# Options that are valid with --resume:
_RESUME_OPTIONS = {"resume", "total_timesteps", "no_evaluation", "no_progress", "verbose", "viewer", "host", "port"}
_MAX_SEEDS = 1000


def run(options: argparse.Namespace) -> None:
    """Train, print the result, evaluate."""
    announce_compiling()
    progress = not options.no_progress and not options.verbose and sys.stderr.isatty()
    if not options.viewer:
        refuse(options, "needs --viewer", "host", "port")
    if options.resume:
        others = sorted(vars(options).keys() - _RESUME_OPTIONS)
        refuse(options, "cannot be combined with --resume, which can only raise --total-timesteps", *others)
        on_start = partial(print, "resuming", flush=True)
        watchers = _watchers(options)
        training = resume(options.resume, options.total_timesteps, progress, options.verbose, on_start, watchers)
        _finish(training, options.no_evaluation)
        return
    config = requested_config(options)
    seed = {} if options.seeds else {"seed": config.train.seed}
    chosen = {**seed, "preset": options.preset, "safe": options.safe, **_requested_settings(options)}
    folder = default_folder(config, options.name, chosen)
    executor = make_executor(options)
    if options.seeds is None:
        refuse(options, "needs --seeds, because a single training runs in one process", "on", "workers")
        on_start, watchers = partial(_print_single_start, config), _watchers(options)
        training = train_config(config, folder, progress, options.verbose, on_start, watchers=watchers)
        _finish(training, options.no_evaluation)
        return
    refuse(options, "cannot be combined with --seeds", "seed", "no_evaluation", "viewer")
    seeds = parse_seeds(options.seeds)
    if folder.exists():
        raise InputError(f"{folder} exists already; choose another --name")
    with executor:
        train_seeds(config, seeds, folder, executor, options.verbose)


def _watchers(options: argparse.Namespace) -> list[BaseCallback]:
    """The viewer of a training, if it is to be watched."""
    if not options.viewer:
        return []
    from tb2rl.viz.viewer.server import ViewerServer  # imported here, because a training needs no page
    from tb2rl.viz.viewer.training import TrainingViewer

    server = ViewerServer(options.host, options.port)
    server.announce()
    return [TrainingViewer(server)]


def requested_config(options: argparse.Namespace) -> Config:
    """The config of a command line."""
    config = resolve(options.agent, options.task, options.preset, _requested_settings(options))
    return with_safety(config, getattr(options, "safe", None))


def _requested_settings(options: argparse.Namespace) -> dict[str, Any]:
    """Settings of --set and other options, by dotted key."""
    fields = TrainSettings.__dataclass_fields__
    flags = {f"train.{name}": value for name, value in vars(options).items() if name in fields and value is not None}
    return {**parse_settings(options.set), **flags}


def parse_seeds(text: str) -> list[int]:
    """Parse seeds such as "0..4" or "0,3,7".

    Raises:
        InputError: If the text has another form, a seed is negative or repeated, or there are too many seeds.
    """
    first, dots, last = text.partition("..")
    try:
        seeds = list(range(int(first), int(last) + 1)) if dots else [int(part) for part in text.split(",")]
    except ValueError:
        seeds = []
    if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds) or len(seeds) > _MAX_SEEDS:
        raise InputError(f"--seeds takes up to {_MAX_SEEDS} different seeds >= 0, such as 0..4 or 0,3,7, got {text!r}")
    return seeds


def _print_single_start(config: Config, folder: Path) -> None:
    settings = config.train
    environments = "1 environment" if settings.n_envs == 1 else f"{settings.n_envs} environments"
    steps = f"{settings.total_timesteps} steps {describe_place(settings.simulation)}"
    description = f"{steps}, {environments}, seed {settings.seed}"
    _print_start(config, description, f"run folder: {folder} (watch it: tensorboard --logdir runs)")


def _print_start(config: Config, description: str, folders: str) -> None:
    say(f"training {config.agent_name} at {config.task_name} in {config.scene.worlds_title}: {description}\n{folders}")


def _finish(training: FinishedTraining, no_evaluation: bool) -> None:
    """Print the result of a training, and evaluate it unless it was interrupted.

    Raises:
        SystemExit: If a signal other than Ctrl-C ended the training; the status is 128 + signal number.
    """
    _print_training(training)
    if training.signal_number not in (0, signal.SIGINT):
        raise SystemExit(128 + training.signal_number)
    if no_evaluation or training.signal_number:
        return
    say(f"standard evaluation of the best policy: {EPISODES} episodes, about half a minute")
    _evaluate(training.run, str(training.run.folder), progress_bar=True)


def train_seeds(config: Config, seeds: Sequence[int], folder: Path, executor: Executor, verbose: int = 0) -> None:
    """Train and evaluate with each seed, print a summary, and write run folders `seed-<seed>` and `seeds.json`."""
    check_trainable(config)
    check_device(config.train.device)
    check_trackers(config.train.track, executor.remote)
    steps = f"{config.train.total_timesteps} steps each {describe_place(config.train.simulation)}"
    evaluations = f"the standard evaluation {explain_place(default_simulator().name)}"
    description = f"{len(seeds)} seeds, {steps}, then {evaluations}"
    _print_start(config, description, f"run folders: {folder}/seed-* (watch them: tensorboard --logdir runs)")
    jobs, summaries, signals = list[Job](), dict[str, Mapping[str, Any]](), list[int]()
    for seed in seeds:
        run_folder = folder / f"seed-{seed}"
        seed_config = replace(config, train=replace(config.train, seed=seed))
        jobs.append(Job(f"seed {seed}", arguments=(seed_config, str(run_folder), verbose), folder=run_folder))

    def interrupt(signal_number: int) -> None:
        if not signals:
            print("\nstopping: each training saves a checkpoint for --resume; Ctrl-C again stops at once", flush=True)
        signals.append(signal_number)
        raise KeyboardInterrupt

    try:
        with handle_termination_signals(interrupt):
            worlds = worlds_of_files(config.task.world)
            for job, summary in executor.as_completed(train_and_evaluate, jobs, shared=[worlds]):
                summaries[job.name] = summary
                score = f"{100 * summary['success_rate']:.1f} % success, {summary['mean_distance']:.1f} m"
                say(f"{job.name}: {score}, trained {summary['timesteps']} steps in {summary['seconds']:.0f} s")
    except KeyboardInterrupt:
        say(f"\nstopped; {len(summaries)} of {len(seeds)} seeds are done, in {folder}")
        raise SystemExit(128 + signals[0]) from None
    _summarize({seed: summaries[f"seed {seed}"] for seed in seeds}, folder)


def train_and_evaluate(worlds: Mapping[str, Any], config: Config, final_path: str, verbose: int, folder: Path) -> Any:
    """Train with one seed, write the output to the log, and return the summary of the standard evaluation.

    Args:
        worlds: Worlds from files, for `register_worlds`; another machine, on which this may run, lacks the files.
        config: Config with the seed.
        final_path: Path of the run folder on the machine of the command.
        verbose: See `train_config`.
        folder: Folder to write to: that of `final_path`, or with Ray a temporary one that is copied to it.
    """
    register_worlds(worlds)
    output = StringIO()
    with redirect_stdout(output), redirect_stderr(output):
        training = train_config(config, folder, verbose=verbose, final_folder=Path(final_path))
        if training.signal_number:
            raise KeyboardInterrupt
        _print_training(training)
        summary = _evaluate(training.run, final_path)
    write_text(folder / LOG, output.getvalue())
    return {**summary, "timesteps": training.timesteps, "seconds": training.seconds}


def _evaluate(run: Run, name: str, progress_bar: bool = False) -> dict[str, Any]:
    """Make, print and write the standard evaluation of a run, and return its summary; the title contains `name`."""
    evaluation = evaluate(load(run.folder), progress_bar=progress_bar)
    summary = print_evaluation(evaluation, f"{name} in {run.config.scene.worlds_title}")
    run.write_evaluation(*evaluation.serialize(run.config, name))
    return summary


def _print_training(training: FinishedTraining) -> None:
    rate = training.timesteps / training.seconds
    print(f"trained {training.timesteps} steps in {training.seconds:.0f} s ({rate:.0f} steps/s, evaluations included)")
    if training.early_stop_timesteps is not None:
        print(describe_early_stop(training.run.config.train, training.early_stop_timesteps))
    print(tutorial_scores(training.episode_lengths))  # episode lengths, as the famous ROS tutorial prints them


def _summarize(summaries: Mapping[int, Mapping[str, Any]], folder: Path) -> None:
    """Print the summary of several seeds, and write it to `seeds.json`."""
    failed = [seed for seed, summary in summaries.items() if summary["success_rate"] < SOLVED_RATE]
    overall: dict[str, Any] = {"seeds": list(summaries), "failed": failed, "solved_rate": SOLVED_RATE}
    print(f"{len(summaries)} seeds in {folder}")
    for name, key, scale, unit in (("success", "success_rate", 100, "%"), ("distance", "mean_distance", 1, "m")):
        values = [summary[key] for summary in summaries.values()]
        mean, (low, high) = sum(values) / len(values), bootstrap_interval(values)
        overall[name] = {"each": values, "mean": mean, "interval": [low, high]}
        print(f"  {name}: mean {scale * mean:.1f} {unit}, 95 % interval {scale * low:.1f} to {scale * high:.1f} {unit}")
    failed_seeds = f": {', '.join(map(str, failed))}" if failed else ""
    print(f"  failed (success below {100 * SOLVED_RATE:.0f} %): {len(failed)} of {len(summaries)}{failed_seeds}")
    write_json(folder / "seeds.json", overall)
