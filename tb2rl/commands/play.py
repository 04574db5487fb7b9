"""The work of the command `tb2rl.play`: a window, a film, bags, or teleoperation."""

from __future__ import annotations

import argparse
import sys
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from tb2rl.commands.policy import chosen_policy, chosen_time_limit
from tb2rl.commands.robot import chosen_robot, parse_goal, robot_chosen
from tb2rl.core.compiled import announce_compiling
from tb2rl.core.errors import InputError
from tb2rl.core.signals import end_program, ending_signals
from tb2rl.envs.control_loop import ControlLoop
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.progress import say
from tb2rl.runs.checkpoint import SUFFIX
from tb2rl.runs.config import Config
from tb2rl.runs.hub import HUB
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.simulation import default_physics, default_simulator
from tb2rl.viz.episodes import STEPS, FilmOptions, load_policy, roll_out_episodes
from tb2rl.viz.film import check_film, film, record
from tb2rl.viz.teleop import Teleop, steer_in_terminal
from tb2rl.viz.window import Window, has_display


def run(arguments: argparse.Namespace) -> None:
    """Play, and print how the episodes ended."""
    announce_compiling()
    steps, robot = chosen_time_limit(arguments, STEPS), chosen_robot(arguments)
    _check(arguments)
    options = FilmOptions(
        episodes=arguments.episodes,
        steps=steps,
        seed=arguments.seed,
        camera=arguments.camera,
        speed=arguments.speed,
        simulation=robot or arguments.simulation,
        on_end=say,
        progress=True,
    )
    if arguments.teleop:
        config = resolve("random", arguments.task, settings=parse_settings(arguments.set))
        _teleoperate(config.scene, options.seed, options.camera, arguments.simulation)
        return
    policy, config = chosen_policy(arguments)
    if arguments.goal is not None and robot is None:
        config = config.with_task(_goal_settings(config, arguments))
    with ending_signals(end_program):  # so that no part of a film is left
        if arguments.bag:
            _report_files(record(policy, arguments.bag, config, options=options), arguments)
        elif arguments.video or not has_display():
            path = arguments.video or f"{_film_name(arguments)}.mp4"
            _report_files([film(policy, path, config, options=options)], arguments)
        else:
            _watch(policy, config, options)


def _check(arguments: argparse.Namespace) -> None:
    """Raise an `InputError` for arguments that do not go together, or a film that cannot be written."""
    if [arguments.policy is not None, arguments.agent is not None, arguments.teleop].count(True) != 1:
        raise InputError(
            "name either a policy (a run folder, a checkpoint, zoo:NAME, hf:USER/REPOSITORY), an --agent, or --teleop"
        )
    if arguments.policy and arguments.task:
        raise InputError("--task goes with --agent and --teleop; a policy keeps the task of its training")
    if arguments.teleop and robot_chosen(arguments):
        raise InputError("--teleop drives a simulated robot; with --simulation ros a policy drives a real one")
    if arguments.teleop and (arguments.video or arguments.bag):
        raise InputError("--video and --bag show a policy; remove them, or --teleop")
    if robot_chosen(arguments) and not arguments.video:
        raise InputError("a real robot is filmed: add --video FILE; for a bag use ROS itself (rosbag)")
    if arguments.video and arguments.bag:
        raise InputError("use --video and --bag one after the other: the same --seed gives the same episodes")
    if arguments.video:
        check_film(arguments.video)


def _goal_settings(config: Config, arguments: argparse.Namespace) -> dict[str, Any]:
    """The settings of `--goal`; episodes begin at the world's start unless `task.start` is set."""
    if not hasattr(config.task, "goal"):
        raise InputError(f"--goal goes with a task that has a goal, such as navigate; {config.task_name} has none")
    x, y = parse_goal(arguments.goal)
    keys = [pair.partition("=")[0].strip() for pair in arguments.set]
    return {"goal": [x, y], **({} if "task.start" in keys else {"start": "fixed"})}


def _film_name(arguments: argparse.Namespace) -> str:
    """The name of a film, after its policy."""
    if arguments.agent is not None:
        return arguments.agent.replace(":", ".")
    return Path(arguments.policy.removeprefix("zoo:").removeprefix(HUB)).resolve().name.removesuffix(SUFFIX)


def _report_files(paths: list[Path], arguments: argparse.Namespace) -> None:
    """Print the files that were written, and the reason if the kinematic simulator stood in for PyBullet."""
    physics = default_physics()
    trouble = physics.unavailable()
    if arguments.simulation is None and trouble:
        print(f"driven in the {default_simulator().title}, because {physics.title} {trouble}")
    for path in paths:
        size = sum(file.stat().st_size for file in [path, *path.glob("*")] if file.is_file())
        print(f"wrote {path} ({size / 1e6:.1f} MB)")


def _watch(policy: Policy, config: Config, options: FilmOptions) -> None:
    policy, scene = load_policy(policy, config, None, options)
    loop = ControlLoop.open(scene, options.simulator)
    with closing(loop), closing(Window(scene, options.camera)) as window, suppress(KeyboardInterrupt):
        window.watch(roll_out_episodes(loop, policy, options), options.speed)


def _teleoperate(scene: Scene, seed: int, camera: str, simulation: str | None) -> None:
    """Let the user drive in the terminal, and show the robot in the window if there is a display."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise InputError("--teleop reads keys from a terminal and draws on it, but stdin or stdout is not a terminal")
    with closing(Teleop(scene, seed, simulation)) as teleop:
        if has_display():
            with closing(Window(scene, camera)) as window:
                steer_in_terminal(teleop, window.show)
        else:
            steer_in_terminal(teleop, lambda *_: True)
