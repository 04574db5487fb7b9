"""The command `train`, see `tb2rl.train`: one training or several, and their evaluation."""

from __future__ import annotations

import argparse
import signal
import sys
from functools import partial
from pathlib import Path

from tb2rl.commands.seeds import print_training, train_seeds
from tb2rl.core.compiled import announce_compiling
from tb2rl.core.errors import InputError
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluator import EPISODES
from tb2rl.execution.arguments import make_executor
from tb2rl.runs.config import Config
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.runs.loading import load
from tb2rl.simulation import default_simulator
from tb2rl.training.training import Training, default_folder, resume, train_config
from tb2rl.viz.table import print_evaluation

_FLAGS = (
    "total_timesteps", "episodes", "seed", "simulation", "n_envs", "device", "eval_freq", "save_freq", "keep",
    "track",
)  # fmt: skip
_MOST_SEEDS = 1000


def run(options: argparse.Namespace) -> None:
    """Train, print the result, evaluate.

    Raises:
        InputError: For options that do not go together.
    """
    announce_compiling()
    progress_bar = not options.no_progress and not options.verbose and sys.stderr.isatty()
    if options.resume:
        others = {"agent", "task", "preset", "set", "name", "seeds", "on", "workers", *_FLAGS} - {"total_timesteps"}
        if any(getattr(options, name) not in (None, []) for name in others):
            raise InputError("--resume goes on with what the run's config says; only --total-timesteps can be raised")
        training = resume(options.resume, options.total_timesteps, progress_bar, options.verbose, _print_resumed)
        _finish(training, options)
        return
    config = requested_config(options)
    folder = default_folder(config, options.name)
    executor = make_executor(options)
    if options.seeds is None:
        if (options.on, options.workers) != (None, None):
            raise InputError("--on and --workers go with --seeds: one training is one process")
        on_start = partial(_print_start, config)
        _finish(train_config(config, folder, progress_bar, options.verbose, on_start), options)
        return
    if options.seed is not None or options.no_evaluation:
        raise InputError("--seeds goes neither with --seed nor with --no-evaluation")
    seeds = parse_seeds(options.seeds)
    if folder.exists():
        raise InputError(f"{folder} exists already; choose another --name")
    with executor:
        train_seeds(config, seeds, folder, executor, options.verbose)


def requested_config(options: argparse.Namespace) -> Config:
    """The config of a command line."""
    flags = {f"train.{name}": getattr(options, name) for name in _FLAGS if getattr(options, name) is not None}
    return resolve(options.agent, options.task, options.preset, {**parse_settings(options.set), **flags})


def parse_seeds(text: str) -> list[int]:
    """Parse seeds such as "0..4" or "0,3,7".

    Raises:
        InputError: If the text is neither.
    """
    first, dots, last = text.partition("..")
    try:
        seeds = list(range(int(first), int(last) + 1)) if dots else [int(part) for part in text.split(",")]
    except ValueError:
        seeds = []
    if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds) or len(seeds) > _MOST_SEEDS:
        raise InputError(f"--seeds takes different seeds, such as 0..4 or 0,3,7, at most {_MOST_SEEDS}, got {text!r}")
    return seeds


def _print_start(config: Config, folder: Path) -> None:
    settings = config.train
    environments = "1 environment" if settings.n_envs == 1 else f"{settings.n_envs} environments"
    print(
        f"training {config.agent_name} at {config.task_name} in {config.scene.place}: "
        f"{settings.total_timesteps} steps, {environments}, seed {settings.seed}\n"
        f"run folder: {folder} (watch it: tensorboard --logdir runs)",
        flush=True,
    )


def _print_resumed(folder: Path) -> None:
    print(f"resuming {folder}", flush=True)


def _finish(training: Training, options: argparse.Namespace) -> None:
    """Print the result of a training, and evaluate it unless it was interrupted.

    Raises:
        SystemExit: If another signal than Ctrl-C ended it, with the status that a shell counts for it.
    """
    print_training(training)
    if training.interrupted not in (0, signal.SIGINT):
        raise SystemExit(128 + training.interrupted)
    if options.no_evaluation or training.interrupted:
        return
    run = training.run
    simulator = default_simulator().title
    print(
        f"standard evaluation of its best policy in {simulator}: {EPISODES} episodes, about half a minute", flush=True
    )
    evaluation = evaluate(load(run.folder), progress=True)
    print_evaluation(evaluation, f"{run.folder} in {run.config.scene.place}")
    run.write_evaluation(*evaluation.tree(run.config, str(run.folder)))
