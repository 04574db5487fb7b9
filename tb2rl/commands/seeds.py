"""What `train --seeds` does: a job for each seed, and what they came to."""

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
from tb2rl.execution.job import Job
from tb2rl.execution.running import run_jobs
from tb2rl.execution.where import Where
from tb2rl.runs.algorithm import check_device, check_learns
from tb2rl.runs.config import Config
from tb2rl.runs.loading import load
from tb2rl.training.statistics import tutorial_scores
from tb2rl.training.trackers import check_trackers
from tb2rl.training.training import Training, stopped_early, train_config
from tb2rl.viz.table import print_evaluation

LOG = "log.txt"  # in the run folder: what a training said that nobody watched


def train_seeds(config: Config, seeds: Sequence[int], folder: Path, where: Where, verbose: int = 0) -> None:
    """Train and evaluate with each seed, and say what they came to.

    Args:
        config: Of the training; its seed is replaced.
        seeds: Which.
        folder: Gets a run folder for each, `seed-<seed>`, and `seeds.json`.
        where: Where they are trained.
        verbose: 1: a line for each episode, in `log.txt`.
    """
    check_learns(config)
    check_device(config)
    check_trackers(config, where.ray)
    jobs = [_job(replace(config, train=replace(config.train, seed=seed)), folder, verbose) for seed in seeds]
    settings = config.train
    print(
        f"training {config.agent_name} at {config.task_name} in {config.scene.place}: {len(seeds)} seeds, "
        f"{settings.total_timesteps} steps each, then the standard evaluation\n"
        f"run folders: {folder}/seed-* (watch them: tensorboard --logdir runs)",
        flush=True,
    )
    summaries: dict[int, Mapping[str, Any]] = {}
    came: list[int] = []  # signals
    try:
        with ending_signals(partial(_interrupt, came)):
            for job, summary in run_jobs(jobs, where, worlds_of_files(config.task.world)):
                summaries[seeds[jobs.index(job)]] = summary
                said = f"{100 * summary['success_rate']:.1f} % success, {summary['mean_distance']:.1f} m"
                took = f"trained {summary['timesteps']} steps in {summary['seconds']:.0f} s"
                print(f"{job.name}: {said}, {took}", flush=True)
    except KeyboardInterrupt:
        print(f"\nstopped; {len(summaries)} of {len(seeds)} seeds are done, in {folder}", flush=True)
        raise SystemExit(128 + came[0]) from None
    _print_seeds({seed: summaries[seed] for seed in seeds}, folder)


def _interrupt(came: list[int], number: int) -> None:
    if not came:
        print("\nstopping: each training saves a checkpoint for --resume; Ctrl-C again stops at once", flush=True)
    came.append(number)
    raise KeyboardInterrupt


def _job(config: Config, folder: Path, verbose: int) -> Job:
    place = folder / f"seed-{config.train.seed}"
    return Job(f"seed {config.train.seed}", train_and_evaluate, (config, str(place), verbose), place)


def train_and_evaluate(worlds: Mapping[str, Any] | None, folder: Path, config: Config, name: str, verbose: int) -> Any:
    """A job: one training, and its standard evaluation, whose summary it returns; what is said is in its log.

    Args:
        worlds: See `carry`; None: it needs no files.
        folder: The run folder.
        config: Of the training.
        name: Of the run folder where it belongs, which is elsewhere on another machine.
        verbose: As in `train_config`.
    """
    carry(worlds or {})
    said = StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        training = train_config(config, folder, verbose=verbose, place=Path(name))
        if training.interrupted:
            raise KeyboardInterrupt
        say_trained(training)
        evaluation = evaluate(load(folder))
        summary = print_evaluation(evaluation, f"{name} in {config.scene.place}")
    training.run.write_evaluation(*evaluation.tree(config, name))
    write_text(folder / LOG, said.getvalue())
    return {**summary, "timesteps": training.timesteps, "seconds": training.seconds}


def say_trained(training: Training) -> None:
    """Say how a training went."""
    rate = training.timesteps / training.seconds
    print(f"trained {training.timesteps} steps in {training.seconds:.0f} s ({rate:.0f} steps/s, evaluations included)")
    if training.stopped_after is not None:
        print(stopped_early(training.run.config, training.stopped_after))
    print(tutorial_scores(training.lengths))


def _print_seeds(summaries: Mapping[int, Mapping[str, Any]], folder: Path) -> None:
    """Print what several seeds came to, and keep it as `seeds.json`."""
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
