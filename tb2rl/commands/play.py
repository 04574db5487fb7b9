"""Implementation of `python -m tb2rl.play`: a window, a film, bags, or teleoperation."""

import argparse
import sys
from contextlib import ExitStack, closing, suppress
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
from tb2rl.runs import HUB, SUFFIX, Config, parse_settings, resolve
from tb2rl.viz.film import FILM_STEPS, FilmOptions, film, open_episodes, record
from tb2rl.viz.window import Teleop, Window, has_display, steer_in_terminal


def run(arguments: argparse.Namespace) -> None:
    """Play, and print how the episodes ended."""
    announce_compiling()
    steps, robot = chosen_time_limit(arguments, FILM_STEPS), chosen_robot(arguments)
    if robot and not arguments.teleop and not arguments.video:
        raise InputError("--simulation ros needs --video FILE; to record a bag of a robot with ROS, use rosbag")
    if arguments.video:
        refuse(arguments, "cannot be combined with --video; for the bag, run again with the same --seed", "bag")
    others = {name: getattr(arguments, name) for name in ("episodes", "seed", "camera", "speed")}
    simulation = robot or arguments.simulation
    options = FilmOptions(steps=steps, simulation=simulation, on_episode_end=say, progress=True, **others)
    if arguments.teleop:
        _teleoperate(arguments, options)
        return
    policy, config = chosen_policy(arguments)
    if arguments.goal is not None and robot is None:
        config = config.with_task(_goal_settings(config, arguments))
    if robot is None:
        say(f"driving {explain_place(options.simulator.name)}")
    with handle_termination_signals(exit_by_signal):  # exit by an exception, which removes a half-written file
        if arguments.bag:
            _report_files(record(policy, arguments.bag, config, options=options))
        elif arguments.video or not has_display():
            path, name = arguments.video or f"{_film_name(arguments)}.mp4", arguments.policy and _film_name(arguments)
            _report_files([film(policy, path, config, options=replace(options, name=name))])
        else:
            _watch(policy, config, replace(options, progress=False))


def _goal_settings(config: Config, arguments: argparse.Namespace) -> dict[str, Any]:
    """Task settings for `--goal`. Episodes begin at the start of the world unless `task.start` is set."""
    if not hasattr(config.task, "goal"):
        raise InputError(f"--goal needs a task with a goal, such as navigate, but {config.task_name} has none")
    start = {} if "task.start" in parse_settings(arguments.set) else {"start": "fixed"}
    return {"goal": list(parse_goal(arguments.goal)), **start}


def _film_name(arguments: argparse.Namespace) -> str:
    """The default name of a film: that of the policy or the agent."""
    policy = arguments.agent or arguments.policy.removeprefix("zoo:").removeprefix(HUB)
    return Path(policy).resolve().name.removesuffix(SUFFIX).replace(":", ".")


def _report_files(paths: list[Path]) -> None:
    """Print the files that were written."""
    for path in paths:
        size = sum(file.stat().st_size for file in [path, *path.glob("*")] if file.is_file())
        print(f"wrote {path} ({size / 1e6:.1f} MB)")


def _watch(policy: Policy, config: Config, options: FilmOptions) -> None:
    opening = open_episodes(policy, config, settings=None, options=options, title="playing")
    with opening as (scene, episodes), closing(Window(scene, options.camera)) as window, suppress(KeyboardInterrupt):
        window.watch(episodes, options.speed)


def _teleoperate(arguments: argparse.Namespace, options: FilmOptions) -> None:
    """Let the user drive in the terminal, with a window if there is a display; closing it makes `show` return False."""
    refuse(arguments, "cannot be combined with --teleop", "agent", "video", "bag")
    if arguments.policy or not (options.simulation is None or isinstance(options.simulation, str)):
        raise InputError("--teleop drives a simulated robot without a policy; omit the policy and --simulation ros")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise InputError("--teleop needs a terminal, but stdin or stdout is redirected")
    scene = resolve("random", arguments.task, settings=parse_settings(arguments.set)).scene
    with closing(Teleop(scene, options.seed, options.simulation)) as teleop, ExitStack() as display:
        show = display.enter_context(closing(Window(scene, options.camera))).show if has_display() else lambda *_: True
        steer_in_terminal(teleop, show)
