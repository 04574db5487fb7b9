"""The command `train --seeds`: a job for each seed, and a summary of all."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

from tb2rl.core.files import write_text
from tb2rl.core.signals import ending_signals
from tb2rl.envs.worlds import carry, worlds_of_files
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluator import PASSED
from tb2rl.evaluation.statistics import bootstrap_interval
from tb2rl.execution.executor import Executor
from tb2rl.execution.job import Job
from tb2rl.runs.algorithm import check_device, check_trainable
from tb2rl.runs.config import Config
from tb2rl.runs.loading import load
from tb2rl.training.statistics import tutorial_scores
from tb2rl.training.trackers import check_trackers
from tb2rl.training.training import Training, early_stop, train_config
from tb2rl.viz.table import print_evaluation

LOG = "log.txt"  # in the run folder: the output of its training


def train_seeds(config: Config, seeds: Sequence[int], folder: Path, executor: Executor, verbose: int = 0) -> None:
    """Train and evaluate with each seed, and print a summary.

    Args:
        config: Of the training; its seed is replaced.
        seeds: The seeds.
        folder: Gets a run folder for each, `seed-<seed>`, and `seeds.json`.
        executor: Runs the trainings.
        verbose: 1: a line for each episode, in `log.txt`.
    """
    settings = config.train
    check_trainable(config)
    check_device(settings.device)
    check_trackers(settings.track, executor.remote)
    jobs = [_job(replace(config, train=replace(settings, seed=seed)), folder, verbose) for seed in seeds]
    print(
        f"training {config.agent_name} at {config.task_name} in {config.scene.place}: {len(seeds)} seeds, "
        f"{settings.total_timesteps} steps each, then the standard evaluation\n"
        f"run folders: {folder}/seed-* (watch them: tensorboard --logdir runs)",
        flush=True,
    )
    summaries: dict[int, Mapping[str, Any]] = {}
    signals: list[int] = []
    try:
        with ending_signals(partial(_interrupt, signals)):
            worlds = worlds_of_files(config.task.world)
            for job, summary in executor.as_completed(train_and_evaluate, jobs, shared=[worlds]):
                summaries[seeds[jobs.index(job)]] = summary
                score = f"{100 * summary['success_rate']:.1f} % success, {summary['mean_distance']:.1f} m"
                effort = f"trained {summary['timesteps']} steps in {summary['seconds']:.0f} s"
                print(f"{job.name}: {score}, {effort}", flush=True)
    except KeyboardInterrupt:
        print(f"\nstopped; {len(summaries)} of {len(seeds)} seeds are done, in {folder}", flush=True)
        raise SystemExit(128 + signals[0]) from None
    _summarize({seed: summaries[seed] for seed in seeds}, folder)


def _interrupt(signals: list[int], number: int) -> None:
    if not signals:
        print("\nstopping: each training saves a checkpoint for --resume; Ctrl-C again stops at once", flush=True)
    signals.append(number)
    raise KeyboardInterrupt


def _job(config: Config, folder: Path, verbose: int) -> Job:
    run_folder = folder / f"seed-{config.train.seed}"
    return Job(f"seed {config.train.seed}", (config, str(run_folder), verbose), run_folder)


def train_and_evaluate(worlds: Mapping[str, Any], config: Config, name: str, verbose: int, folder: Path) -> Any:
    """A job: one training and its standard evaluation, whose summary it returns; the output goes to its log.

    Args:
        worlds: See `carry`.
        config: Of the training.
        name: The final path of the run folder, which differs on another machine.
        verbose: As in `train_config`.
        folder: The run folder.
    """
    carry(worlds)
    output = StringIO()
    with redirect_stdout(output), redirect_stderr(output):
        training = train_config(config, folder, verbose=verbose, tracked_folder=Path(name))
        if training.interrupted:
            raise KeyboardInterrupt
        print_training(training)
        evaluation = evaluate(load(folder))
        summary = print_evaluation(evaluation, f"{name} in {config.scene.place}")
    training.run.write_evaluation(*evaluation.tree(config, name))
    write_text(folder / LOG, output.getvalue())
    return {**summary, "timesteps": training.timesteps, "seconds": training.seconds}


def print_training(training: Training) -> None:
    """Print the result of a training."""
    rate = training.timesteps / training.seconds
    print(f"trained {training.timesteps} steps in {training.seconds:.0f} s ({rate:.0f} steps/s, evaluations included)")
    if training.stopped_after is not None:
        print(early_stop(training.run.config.train, training.stopped_after))
    print(tutorial_scores(training.lengths))


def _summarize(summaries: Mapping[int, Mapping[str, Any]], folder: Path) -> None:
    """Print the summary of several seeds, and write it to `seeds.json`."""
    rates = [summary["success_rate"] for summary in summaries.values()]
    distances = [summary["mean_distance"] for summary in summaries.values()]
    failed = [seed for seed, summary in summaries.items() if summary["success_rate"] < PASSED]
    figures: dict[str, Any] = {"seeds": list(summaries), "failed": failed, "passed_from": PASSED}
    print(f"{len(summaries)} seeds in {folder}")
    for name, values, scale, unit in (("success", rates, 100, "%"), ("distance", distances, 1, "m")):
        low, high = bootstrap_interval(values)
        mean = sum(values) / len(values)
        figures[name] = {"each": values, "mean": mean, "interval": [low, high]}
        print(f"  {name}: mean {scale * mean:.1f} {unit}, 95 % interval {scale * low:.1f} to {scale * high:.1f} {unit}")
    named = f": {', '.join(map(str, failed))}" if failed else ""
    print(f"  failed (success below {100 * PASSED:.0f} %): {len(failed)} of {len(summaries)}{named}")
    write_text(folder / "seeds.json", json.dumps(figures, indent=1) + "\n")
