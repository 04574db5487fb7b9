"""Reads the arguments of `tb2rl.policy_arguments.add_policy_arguments`: a policy and its task."""

from __future__ import annotations

import argparse

from tb2rl.core.errors import InputError
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.moments import time_limit
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import Config
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.runs.loading import config_of, load


def chosen_policy(options: argparse.Namespace) -> tuple[Policy, Config]:
    """Load the policy that the arguments name, with the config of what it is to do.

    Raises:
        InputError: If there is no such policy, or a setting does not fit.
    """
    settings = parse_settings(options.set)
    if options.agent is not None:
        config = resolve(options.agent, options.task, settings=settings)
        return make_baseline(config), config
    policy = load(options.policy, options.trust)
    for key in settings:
        if not key.startswith("task."):
            raise InputError(f"only the task of a trained policy can be changed (task.KEY=VALUE), got {key!r}")
    return policy, config_of(policy).with_task({key.removeprefix("task."): value for key, value in settings.items()})


def chosen_time_limit(options: argparse.Namespace, usual: int) -> int:
    """The maximum control steps of an episode, by `--steps` or `--set task.episode_steps`; see `time_limit`."""
    settings = parse_settings(options.set)
    return time_limit(options.steps, {key.removeprefix("task."): value for key, value in settings.items()}, usual)
