"""The standard evaluation: a greedy policy in PyBullet's physics, from start poses that training did not draw.

    python -m tb2rl.evaluate runs/maze/dqn/NAME
    python -m tb2rl.evaluate --agent wallfollower

100 episodes of at most 1 500 control steps, each with a start pose and a random stream of its own: the result does not
depend on how many processes share the work.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tb2rl.config import parse_settings, resolve
from tb2rl.driving import LARGEST_SEED, Policy
from tb2rl.errors import ArgumentParser, InputError, command
from tb2rl.evaluation import EPISODES, SEED, STEPS, evaluate, keep, report, save, with_task
from tb2rl.runs import checkpoint_file, config_of, load, make_baseline


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.evaluate", description=(__doc__ or "").splitlines()[0])
    add_policy_arguments(parser)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--steps", type=int, default=STEPS, help="control steps at most in an episode")
    parser.add_argument("--seed", type=int, default=SEED, help="of the start poses")
    parser.add_argument("--workers", type=int, help="processes (default: one for each processor)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result here, not into the run folder")
    return parser.parse_args(arguments)


def add_policy_arguments(parser: argparse.ArgumentParser) -> None:
    """What names a policy on a command line, and the task that it drives at."""
    parser.add_argument("policy", nargs="?", help="run folder, checkpoint in it, or zoo:NAME")
    parser.add_argument("--agent", help="instead: an agent that does not learn, such as random or wallfollower")
    parser.add_argument("--task", help="its task (default: maze)")
    parser.add_argument(
        "--set",
        nargs="+",
        default=[],
        action="extend",
        metavar="KEY=VALUE",
        help="change the task, e.g. task.maze=circuit",
    )


@command
def main(arguments: list[str] | None = None) -> None:
    """Evaluate a policy, print a table, write JSON."""
    options = parse(arguments)
    if (options.policy is None) == (options.agent is None):
        raise InputError("name either a policy (a run folder, a checkpoint, zoo:NAME) or an --agent")
    if options.policy and options.task:
        raise InputError("--task goes with --agent; a policy keeps the task that it was trained at")
    workers = 1 if options.workers is None else options.workers
    if min(options.episodes, options.steps, workers) < 1 or not 0 <= options.seed <= LARGEST_SEED:
        raise InputError(f"--episodes, --steps and --workers must be at least 1, and --seed from 0 to {LARGEST_SEED}")
    if options.json and not options.json.absolute().parent.is_dir():
        raise InputError(f"cannot write {options.json}: there is no folder {options.json.absolute().parent}")
    settings = parse_settings(options.set)
    conditions = {
        "episodes": options.episodes,
        "steps": options.steps,
        "seed": options.seed,
        "workers": options.workers,
    }
    if options.agent is not None:
        config = resolve(options.agent, options.task, settings=settings)
        policy: Policy = make_baseline(config)
        name = options.agent
    else:
        policy, name = load(options.policy), str(checkpoint_file(options.policy))
        config = with_task(config_of(policy), task_settings(settings))
    evaluation = evaluate(policy, config, **conditions)
    summary = report(evaluation, f"{name} in {evaluation.task.maze}")
    standard = (options.episodes, options.steps, options.seed) == (EPISODES, STEPS, SEED) and not settings
    if options.json:
        save(evaluation, summary, config, name, options.json)
    elif options.policy and standard and Path(options.policy).is_dir():
        keep(evaluation, summary, config, name, Path(options.policy))
    else:
        print("not written: only the standard evaluation of a run folder is kept there; --json FILE keeps any")


def task_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Changes to the task of a trained policy by the names of its fields, from dotted keys.

    Raises:
        InputError: If one is no setting of a task.
    """
    for key in settings:
        if not key.startswith("task."):
            raise InputError(f"only the task of a trained policy can be changed (task.KEY=VALUE), got {key!r}")
    return {key.removeprefix("task."): value for key, value in settings.items()}


if __name__ == "__main__":
    main()
