"""Train an agent at a task: one command, one run folder.

    python -m tb2rl.train --agent qlearn
    python -m tb2rl.train --agent dqn --set task.maze=circuit agent.gamma=0.97 --name mine
    python -m tb2rl.train --resume runs/maze/dqn/mine

Everything has a default, in a signature or a preset of `configs`; `--set` changes anything.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tb2rl.callbacks import tutorial_scores
from tb2rl.config import Config, parse_settings, resolve
from tb2rl.errors import ArgumentParser, InputError, command
from tb2rl.evaluation import evaluate, report, save
from tb2rl.registry import agent_names, task_names
from tb2rl.runs import load
from tb2rl.training import default_folder, resume, train_config

_FLAGS = (
    "total_timesteps", "episodes", "seed", "simulation", "n_envs", "device", "eval_freq", "save_freq", "keep",
)  # fmt: skip


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
    bar = not options.no_progress and not options.verbose and sys.stderr.isatty()
    flags = {f"train.{name}": getattr(options, name) for name in _FLAGS if getattr(options, name) is not None}
    if options.resume:
        folder = options.resume
        others = {"agent", "task", "preset", "set", "name", *_FLAGS} - {"total_timesteps"}
        if any(getattr(options, name) not in (None, []) for name in others):
            raise InputError("--resume goes on with what the run's config says; only --total-timesteps can be raised")
        print(f"resuming {folder}", flush=True)
        training = resume(folder, options.total_timesteps, bar, options.verbose)
    else:
        config = resolve(options.agent, options.task, options.preset, {**parse_settings(options.set), **flags})
        folder = _folder(config, options.name)
        settings = config.train
        print(
            f"training {config.agent} at {config.task} in {config.task_settings.maze}: {settings.total_timesteps} "
            f"steps, {settings.n_envs} worlds, seed {settings.seed}\n"
            f"run folder: {folder} (watch it: tensorboard --logdir runs)",
            flush=True,
        )
        training = train_config(config, folder, bar, options.verbose)
    rate = training.timesteps / training.seconds
    print(f"trained {training.timesteps} steps in {training.seconds:.0f} s ({rate:.0f} steps/s, evaluations included)")
    print(tutorial_scores(training.lengths))
    if not (options.no_evaluation or training.interrupted):
        evaluation = evaluate(load(folder))
        summary = report(evaluation, f"{folder} in {evaluation.task.maze}")
        save(evaluation, summary, training.run.config, str(folder), folder / "evaluation.json")


def _folder(config: Config, name: str | None) -> Path:
    folder = default_folder(config)
    if name and (Path(name).name != name or name == ".."):
        raise InputError(f"--name is the name of a folder, without a path, got {name!r}")
    return folder.with_name(name) if name else folder


if __name__ == "__main__":
    main()
