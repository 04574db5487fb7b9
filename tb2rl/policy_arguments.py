"""How `evaluate` and `play` name a policy on a command line, and the task that it drives at."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from tb2rl.errors import InputError
from tb2rl.judging.rollout import Policy
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import Config
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.runs.loading import config_of, load


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
        help="change the task, e.g. task.world=circuit",
    )


def chosen_policy(options: argparse.Namespace) -> tuple[Policy, Config]:
    """The policy that the arguments of `add_policy_arguments` name, and what it is to do.

    Raises:
        InputError: If there is no such policy, or a setting does not fit.
    """
    settings = parse_settings(options.set)
    if options.agent is not None:
        config = resolve(options.agent, options.task, settings=settings)
        return make_baseline(config), config
    policy = load(options.policy)
    return policy, config_of(policy).with_task(_task_settings(settings))


def _task_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Changes to the task of a trained policy by the names of its fields, from dotted keys."""
    for key in settings:
        if not key.startswith("task."):
            raise InputError(f"only the task of a trained policy can be changed (task.KEY=VALUE), got {key!r}")
    return {key.removeprefix("task."): value for key, value in settings.items()}
