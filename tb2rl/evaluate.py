"""The standard evaluation: a greedy policy in PyBullet's physics, from start poses that training did not draw.

    python -m tb2rl.evaluate runs/maze/dqn/NAME
    python -m tb2rl.evaluate --agent wallfollower

100 episodes of at most 1 500 control steps, each with a start pose and a random stream of its own: the result does not
depend on how many processes share the work.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch as th
from rich.console import Console
from rich.table import Table

from tb2rl.config import Config, config_from, parse_settings, resolve
from tb2rl.errors import InputError, command
from tb2rl.evaluation import EPISODES, SEED, STEPS, Evaluation, Evaluator, Policy
from tb2rl.runs import checkpoint_file, config_of, load, make_baseline, versions, write


def evaluate(
    policy: Policy | str | Path,
    config: Config | None = None,
    settings: Mapping[str, Any] | None = None,
    **conditions: Any,
) -> Evaluation:
    """Evaluate a policy; the standard evaluation unless `conditions` say otherwise.

    Args:
        policy: A loaded policy, a reference that `load` takes, or anything with `predict`.
        config: What it is to do; None: what it was trained to do.
        settings: Changes to the task by name, for example {"maze": "circuit"}.
        conditions: Arguments of `Evaluator`.
    """
    if isinstance(policy, str | Path):
        policy = load(policy)
    if config is None:
        config = config_of(policy)
    config = changed(config, settings or {})
    th.set_num_threads(1)
    with Evaluator(config.task_settings, config.observation, **conditions) as evaluator:
        return evaluator.run(getattr(policy, "policy", policy))


def changed(config: Config, settings: Mapping[str, Any]) -> Config:
    """The config with some of its task's settings changed, checked again."""
    tree = config.to_dict()
    tree["task"].update(settings)
    return config_from(tree) if settings else config


def report(evaluation: Evaluation, title: str) -> dict[str, Any]:
    """Print the table of an evaluation and return its summary."""
    summary = evaluation.summary()
    table = Table(title=title, title_justify="left")
    table.add_column(f"{summary['episodes']} episodes of at most {evaluation.steps} steps")
    table.add_column("value", justify="right")
    table.add_column("", justify="left")

    def rate(name: str, key: str) -> None:
        low, high = summary[f"{key}_interval"]
        table.add_row(
            name, f"{100 * summary[f'{key}_rate']:.1f} %", f"95 % interval {100 * low:.1f} to {100 * high:.1f} %"
        )

    rate("crash-free", "crash_free")
    if evaluation.task.goal_task:
        rate("goal reached", "success")
    for name, key, unit in (("distance", "distance", "m"), ("return", "return", ""), ("length", "length", "steps")):
        table.add_row(name, f"{summary[f'mean_{key}']:.1f}", f"± {summary[f'std_{key}']:.1f} {unit}".rstrip())
    table.add_row("speed", f"{summary['mean_speed']:.3f}", "m/s")
    table.add_row("endings", "", ", ".join(f"{ended} {count}" for ended, count in summary["endings"].items()))
    Console().print(table)
    return summary


def save(evaluation: Evaluation, summary: Mapping[str, Any], config: Config, policy: str, path: Path) -> None:
    """Write an evaluation as JSON: its figures, its conditions, and every episode."""
    episodes = [
        {field.name: getattr(episode, field.name) for field in dataclasses.fields(episode) if field.name != "path"}
        for episode in evaluation.episodes
    ]
    tree = {**summary, "policy": policy, "config": config.to_dict(), "versions": versions(), "each": episodes}
    try:
        write(path, json.dumps(tree, indent=1) + "\n")
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from None


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tb2rl.evaluate", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("policy", nargs="?", help="run folder, checkpoint in it, or zoo:NAME")
    parser.add_argument("--agent", help="instead: an agent that does not learn, such as random or wallfollower")
    parser.add_argument("--task", help="its task (default: maze)")
    parser.add_argument(
        "--set", nargs="+", default=[], metavar="KEY=VALUE", help="change the task, e.g. task.maze=circuit"
    )
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--steps", type=int, default=STEPS, help="control steps at most in an episode")
    parser.add_argument("--seed", type=int, default=SEED, help="of the start poses")
    parser.add_argument("--workers", type=int, help="processes (default: one for each processor)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result here, not into the run folder")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Evaluate a policy, print a table, write JSON."""
    options = parse(arguments)
    if (options.policy is None) == (options.agent is None):
        raise InputError("name either a policy (a run folder, a checkpoint, zoo:NAME) or an --agent")
    if min(options.episodes, options.steps, options.workers or 1) < 1 or options.seed < 0:
        raise InputError("--episodes, --steps and --workers must be at least 1, and --seed at least 0")
    settings = parse_settings(options.set)
    conditions = {
        "episodes": options.episodes,
        "steps": options.steps,
        "seed": options.seed,
        "workers": options.workers,
    }
    if options.agent:
        config = resolve(options.agent, options.task, settings=settings)
        policy: Policy = make_baseline(config)
        name = options.agent
    else:
        policy, name = load(options.policy), str(checkpoint_file(options.policy))
        config = changed(config_of(policy), _task_settings(settings))
    evaluation = evaluate(policy, config, **conditions)
    summary = report(evaluation, f"{name} in {evaluation.task.maze}")
    standard = (options.episodes, options.steps, options.seed) == (EPISODES, STEPS, SEED) and not settings
    if options.json:
        save(evaluation, summary, config, name, options.json)
    elif options.policy and standard and Path(options.policy).is_dir():
        save(evaluation, summary, config, name, Path(options.policy) / "evaluation.json")


def _task_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    for key in settings:
        if not key.startswith("task."):
            raise InputError(f"only the task of a trained policy can be changed (task.KEY=VALUE), got {key!r}")
    return {key.removeprefix("task."): value for key, value in settings.items()}


if __name__ == "__main__":
    main()
