"""Implementation of `python -m tb2rl.play --video` and `--bag`: films and bags."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from tb2rl.commands.arguments import refuse
from tb2rl.commands.evaluate import chosen_policy, chosen_robot, chosen_time_limit, parse_goal
from tb2rl.core import InputError
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.progress import say
from tb2rl.evaluation.sim_to_sim import explain_place
from tb2rl.runs import HUB, SUFFIX, Config, parse_settings
from tb2rl.viz.film import FILM_STEPS, FilmOptions, film, record


def run(arguments: argparse.Namespace) -> None:
    """Write films or bags, and print how the episodes ended."""
    options = chosen_options(arguments)
    policy, config = chosen_drive(arguments, options)
    if arguments.bag:
        _report_files(record(policy, arguments.bag, config, options=options))
    else:
        name = arguments.policy and _policy_name(arguments)
        _report_files([film(policy, arguments.video, config, options=replace(options, name=name))])


def chosen_options(arguments: argparse.Namespace) -> FilmOptions:
    """The options of a film, a bag or a live drive."""
    robot = chosen_robot(arguments)
    if robot and not arguments.video:
        raise InputError("--simulation ros needs --video FILE; to record a bag of a robot with ROS, use rosbag")
    if arguments.video:
        refuse(arguments, "cannot be combined with --video; for the bag, run again with the same --seed", "bag")
    others = {name: getattr(arguments, name) for name in ("seed", "camera", "speed")}
    return FilmOptions(
        episodes=1 if arguments.episodes is None else arguments.episodes,
        steps=chosen_time_limit(arguments, FILM_STEPS),
        simulation=robot or arguments.simulation,
        on_episode_end=say,
        progress=True,
        **others,
    )


def chosen_drive(arguments: argparse.Namespace, options: FilmOptions) -> tuple[Policy, Config]:
    """The policy, and its config with the goal of `--goal`; prints in which simulator it drives."""
    policy, config = chosen_policy(arguments)
    if not options.simulator.is_external:
        if arguments.goal is not None:
            config = config.with_task(_goal_settings(config, arguments))
        say(f"driving {explain_place(options.simulator.name)}")
    return policy, config


def _goal_settings(config: Config, arguments: argparse.Namespace) -> dict[str, Any]:
    """Task settings for `--goal`. Episodes begin at the start of the world unless `task.start` is set."""
    if not hasattr(config.task, "goal"):
        raise InputError(f"--goal needs a task with a goal, such as navigate, but {config.task_name} has none")
    start = {} if "task.start" in parse_settings(arguments.set) else {"start": "fixed"}
    return {"goal": list(parse_goal(arguments.goal)), **start}


def _policy_name(arguments: argparse.Namespace) -> str:
    """Name of the policy or the agent."""
    policy = arguments.agent or arguments.policy.removeprefix("zoo:").removeprefix(HUB)
    return Path(policy).resolve().name.removesuffix(SUFFIX).replace(":", ".")


def _report_files(paths: list[Path]) -> None:
    """Print the files that were written."""
    for path in paths:
        size = sum(file.stat().st_size for file in [path, *path.glob("*")] if file.is_file())
        print(f"wrote {path} ({size / 1e6:.1f} MB)")
