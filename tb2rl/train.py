"""Train an agent at a task: one command, one run folder.

    python -m tb2rl.train --agent qlearn
    python -m tb2rl.train --agent dqn --set task.maze=circuit agent.gamma=0.97 --name mine
    python -m tb2rl.train --agent ppo --simulation kinematic --seeds 0..4
    python -m tb2rl.train --resume runs/maze/dqn/mine

Everything has a default, in a signature or a preset of `configs`; `--set` changes anything.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from tb2rl.callbacks import tutorial_scores
from tb2rl.config import Config, parse_settings, resolve
from tb2rl.errors import ArgumentParser, InputError, command
from tb2rl.evaluation import PASSED, bootstrap_interval, evaluate, keep, report
from tb2rl.registry import agent_names, task_names
from tb2rl.runs import load, write
from tb2rl.training import Training, default_folder, resume, train_config

_FLAGS = (
    "total_timesteps", "episodes", "seed", "simulation", "n_envs", "device", "eval_freq", "save_freq", "keep",
)  # fmt: skip
_MOST_SEEDS = 1000


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.train", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--agent", help=f"{', '.join(agent_names())}, or module:Class (default: qlearn)")
    parser.add_argument("--task", help=f"{', '.join(task_names())}, or module:Class (default: maze)")
    parser.add_argument("--preset", help="a file of configs, such as tutorial, or a path")
    parser.add_argument(
        "--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="e.g. agent.gamma=0.9"
    )
    parser.add_argument("--name", help="of the run folder runs/TASK/AGENT/NAME (default: date and time)")
    parser.add_argument("--total-timesteps", type=int, help="control steps, over all worlds")
    parser.add_argument("--episodes", type=int, help="stop after so many, if that comes before --total-timesteps")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--seeds", metavar="A..B", help="train once with each of these seeds, say what they come to")
    parser.add_argument("--simulation", help="what to train in: bullet (default), or its fast twin kinematic")
    parser.add_argument("--n-envs", type=int, help="worlds, in parallel processes or in one batch")
    parser.add_argument("--device", help="of the networks: cpu, cuda, auto")
    parser.add_argument("--eval-freq", type=int, help="control steps between evaluations; 0: none")
    parser.add_argument("--save-freq", type=int, help="control steps between checkpoints; 0: only the last")
    parser.add_argument("--keep", type=int, help="checkpoints of the training to keep, the latest")
    parser.add_argument("--resume", type=Path, metavar="FOLDER", help="go on with a run; takes --total-timesteps")
    parser.add_argument("--no-evaluation", action="store_true", help="skip the standard evaluation at the end")
    parser.add_argument("--no-progress", action="store_true", help="no progress bar")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="a line for each episode")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Train, say where the run is, evaluate."""
    options = parse(arguments)
    if options.resume:
        others = {"agent", "task", "preset", "set", "name", "seeds", *_FLAGS} - {"total_timesteps"}
        if any(getattr(options, name) not in (None, []) for name in others):
            raise InputError("--resume goes on with what the run's config says; only --total-timesteps can be raised")
        print(f"resuming {options.resume}", flush=True)
        _judge(resume(options.resume, options.total_timesteps, _bar(options), options.verbose), options)
        return
    config = requested(options)
    folder = _folder(config, options.name)
    if options.seeds is None:
        _train_and_judge(config, folder, options)
        return
    if options.seed is not None or options.no_evaluation:
        raise InputError("--seeds goes neither with --seed nor with --no-evaluation")
    seeds = parse_seeds(options.seeds)
    if folder.exists():
        raise InputError(f"{folder} exists already; choose another --name")
    judged = {}
    for seed in seeds:
        seeded = replace(config, train=replace(config.train, seed=seed))
        summary = _train_and_judge(seeded, folder / f"seed-{seed}", options)
        if summary is None:  # interrupted
            return
        judged[seed] = summary
    _report_seeds(judged, folder)


def requested(options: argparse.Namespace) -> Config:
    """The config that a command line asks for."""
    flags = {f"train.{name}": getattr(options, name) for name in _FLAGS if getattr(options, name) is not None}
    return resolve(options.agent, options.task, options.preset, {**parse_settings(options.set), **flags})


def parse_seeds(text: str) -> list[int]:
    """Seeds as the command line has them: "0..4" or "0,3,7".

    Raises:
        InputError: If it is neither.
    """
    first, dots, last = text.partition("..")
    try:
        seeds = list(range(int(first), int(last) + 1)) if dots else [int(part) for part in text.split(",")]
    except ValueError:
        seeds = []
    if not seeds or min(seeds) < 0 or len(set(seeds)) < len(seeds) or len(seeds) > _MOST_SEEDS:
        raise InputError(f"--seeds takes different seeds, such as 0..4 or 0,3,7, at most {_MOST_SEEDS}, got {text!r}")
    return seeds


def _train_and_judge(config: Config, folder: Path, options: argparse.Namespace) -> dict[str, Any] | None:
    settings = config.train
    print(
        f"training {config.agent} at {config.task} in {config.task_settings.maze}: {settings.total_timesteps} steps, "
        f"{settings.n_envs} worlds, seed {settings.seed}\nrun folder: {folder} (watch it: tensorboard --logdir runs)",
        flush=True,
    )
    return _judge(train_config(config, folder, _bar(options), options.verbose), options)


def _judge(training: Training, options: argparse.Namespace) -> dict[str, Any] | None:
    """Say how a training went, and give the summary of its standard evaluation; None if it was interrupted."""
    rate = training.timesteps / training.seconds
    print(f"trained {training.timesteps} steps in {training.seconds:.0f} s ({rate:.0f} steps/s, evaluations included)")
    print(tutorial_scores(training.lengths))
    if options.no_evaluation or training.interrupted:
        return None
    folder = training.run.folder
    evaluation = evaluate(load(folder))
    summary = report(evaluation, f"{folder} in {evaluation.task.maze}")
    keep(evaluation, summary, training.run.config, str(folder), folder)
    return summary


def _report_seeds(judged: Mapping[int, Mapping[str, Any]], folder: Path) -> None:
    """Print what several seeds came to, and keep it as `seeds.json`."""
    rates = [summary["success_rate"] for summary in judged.values()]
    distances = [summary["mean_distance"] for summary in judged.values()]
    failed = [seed for seed, summary in judged.items() if summary["success_rate"] < PASSED]
    figures: dict[str, Any] = {"seeds": list(judged), "failed": failed, "passed_from": PASSED}
    print(f"{len(judged)} seeds in {folder}")
    for name, values, scale, unit in (("success", rates, 100, "%"), ("distance", distances, 1, "m")):
        low, high = bootstrap_interval(values)
        mean = sum(values) / len(values)
        figures[name] = {"each": values, "mean": mean, "interval": [low, high]}
        print(f"  {name}: mean {scale * mean:.1f} {unit}, 95 % interval {scale * low:.1f} to {scale * high:.1f} {unit}")
    named = f": {', '.join(map(str, failed))}" if failed else ""
    print(f"  failed (success below {100 * PASSED:.0f} %): {len(failed)} of {len(judged)}{named}")
    write(folder / "seeds.json", json.dumps(figures, indent=1) + "\n")


def _bar(options: argparse.Namespace) -> bool:
    return not options.no_progress and not options.verbose and sys.stderr.isatty()


def _folder(config: Config, name: str | None) -> Path:
    folder = default_folder(config)
    if name and (Path(name).name != name or name == ".."):
        raise InputError(f"--name is the name of a folder, without a path, got {name!r}")
    return folder.with_name(name) if name else folder


if __name__ == "__main__":
    main()
