"""Implementation of `python -m tb2rl.play`: a live drive, a film, or bags."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from tb2rl.commands.arguments import refuse
from tb2rl.commands.evaluate import chosen_policy, chosen_robot, chosen_time_limit, parse_goal
from tb2rl.core import InputError, exit_by_signal, handle_termination_signals
from tb2rl.core.compiled import announce_compiling
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.progress import say
from tb2rl.evaluation.sim_to_sim import explain_place
from tb2rl.runs import HUB, SUFFIX, Config, parse_settings
from tb2rl.viz.film import FILM_STEPS, FilmOptions, film, record


def run(arguments: argparse.Namespace) -> None:
    """Drive on a page until the user ends the program, or write films or bags and print how the episodes ended."""
    announce_compiling()
    if arguments.teleop:
        refuse(arguments, "cannot be combined with --teleop", "agent", "policy", "video", "bag")
        arguments.agent = "random"  # its task decides the rewards, and the user drives
    options = _chosen_options(arguments)
    policy, config = chosen_policy(arguments)
    if not options.simulator.is_external:
        if arguments.goal is not None:
            config = config.with_task(_goal_settings(config, arguments))
        say(f"driving {explain_place(options.simulator.name)}")
    with handle_termination_signals(exit_by_signal):  # exit by an exception, which removes a half-written file
        if arguments.bag:
            _report_files(record(policy, arguments.bag, config, options=options))
        elif arguments.video:
            name = arguments.policy and _policy_name(arguments.policy)
            _report_files([film(policy, arguments.video, config, options=replace(options, name=name))])
        else:
            _drive_live(arguments, policy, config, options)


def _chosen_options(arguments: argparse.Namespace) -> FilmOptions:
    """The options of a film, a bag or a live drive."""
    robot = chosen_robot(arguments)
    if robot and not arguments.video:
        raise InputError("--simulation ros needs --video FILE; to record a bag of a robot with ROS, use rosbag")
    if arguments.video:
        refuse(arguments, "cannot be combined with --video; for the bag, run again with the same --seed", "bag")
    if arguments.video or arguments.bag:
        refuse(arguments, "cannot be combined with --video or --bag", "viewer", "host", "port")
    else:
        refuse(arguments, "needs --video or --bag", "episodes")
    others = {name: getattr(arguments, name) for name in ("seed", "camera", "speed")}
    return FilmOptions(
        episodes=1 if arguments.episodes is None else arguments.episodes,
        steps=chosen_time_limit(arguments, FILM_STEPS),
        simulation=robot or arguments.simulation,
        on_episode_end=say,
        progress_bar=True,
        **others,
    )


def _drive_live(arguments: argparse.Namespace, policy: Policy, config: Config, options: FilmOptions) -> None:
    """Drive on a page until the user ends the program."""
    from tb2rl.viz.viewer.drive import Selection
    from tb2rl.viz.viewer.page import drive_live  # imported here, because films and bags need no page

    if arguments.steps is not None:
        config = config.with_task({"episode_steps": arguments.steps})
    selection = Selection(policy, config, options.simulator, arguments.policy or arguments.agent)
    view = {"speed": options.speed, "follow": options.camera == "chase", "is_manual": arguments.teleop}
    drive_live(selection, options.seed, host=arguments.host, port=arguments.port, **view)


def _goal_settings(config: Config, arguments: argparse.Namespace) -> dict[str, Any]:
    """Task settings for `--goal`. Episodes begin at the start of the world unless `task.start` is set."""
    if not hasattr(config.task, "goal"):
        raise InputError(f"--goal needs a task with a goal, such as navigate, but {config.task_name} has none")
    start = {} if "task.start" in parse_settings(arguments.set) else {"start": "fixed"}
    return {"goal": list(parse_goal(arguments.goal)), **start}


def _policy_name(reference: str) -> str:
    policy = Path(reference.removeprefix("zoo:").removeprefix(HUB))
    return policy.resolve().name.removesuffix(SUFFIX).replace(":", ".")


def _report_files(paths: list[Path]) -> None:
    """Print the files that were written."""
    for path in paths:
        size = sum(file.stat().st_size for file in [path, *path.glob("*")] if file.is_file())
        print(f"wrote {path} ({size / 1e6:.1f} MB)")
