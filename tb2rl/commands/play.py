"""What `play` does, see `tb2rl.play`: a window, a film, or the keyboard."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from tb2rl.commands.policy import chosen_policy, chosen_time_limit
from tb2rl.commands.robot import chosen_robot, parse_goal
from tb2rl.core.compiled import announce_compiling
from tb2rl.core.errors import InputError, unknown
from tb2rl.core.signals import end_program, ending_signals
from tb2rl.deploy.ros.robot import RosRobot
from tb2rl.envs.scene import Scene
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.moments import Moment
from tb2rl.evaluation.progress import say
from tb2rl.runs.checkpoint import SUFFIX
from tb2rl.runs.config import Config
from tb2rl.runs.hub import HUB
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.simulation import ROS, bullet_trouble
from tb2rl.viz.cameras import CAMERAS
from tb2rl.viz.film import STEPS, check_film, check_numbers, drives, film, open_env
from tb2rl.viz.keyboard import Teleop
from tb2rl.viz.recording import record
from tb2rl.viz.terminal import steer_in_terminal
from tb2rl.viz.window import Window, has_display, watch


def run(options: argparse.Namespace) -> None:
    """Play, and say how the episodes went."""
    announce_compiling()
    options.steps = chosen_time_limit(options, STEPS)
    robot = chosen_robot(options)
    check(options)
    if options.teleop:
        config = resolve("random", options.task, settings=parse_settings(options.set))
        drive_by_keyboard(config.scene, options.seed, options.camera, options.simulation)
        return
    policy, config = chosen_policy(options)
    if options.goal is not None and robot is None:
        config = config.with_task(_to_goal(config, options))
    with ending_signals(end_program):  # else a part of a film would be left
        if options.bag:
            _record(policy, config, options)
        elif options.video or not has_display():
            _film(policy, config, options, robot)
        else:
            _show(policy, config, options)


def check(options: argparse.Namespace) -> None:
    """Raise an `InputError` where options do not go together, or do not fit."""
    if [options.policy is not None, options.agent is not None, options.teleop].count(True) != 1:
        raise InputError(
            "name either a policy (a run folder, a checkpoint, zoo:NAME, hf:USER/REPOSITORY), an --agent, or --teleop"
        )
    if options.policy and options.task:
        raise InputError("--task goes with --agent and --teleop; a policy keeps the task that it was trained at")
    if options.teleop and options.simulation == ROS:
        raise InputError("--teleop drives a simulated robot; --simulation ros has a policy drive yours")
    if options.teleop and (options.video or options.bag):
        raise InputError("--video and --bag show a policy; --teleop shows what you drive in the terminal")
    if options.simulation == ROS and not options.video:
        raise InputError("of a robot with ROS there is a film: name it by --video; a bag records ROS itself (rosbag)")
    if options.video and options.bag:
        raise InputError("take --video and --bag one after the other: with the same --seed it is the same drive")
    if options.camera not in CAMERAS:
        raise unknown("--camera", options.camera, CAMERAS)
    check_numbers(options.episodes, options.steps, options.seed, options.speed)
    if options.video:
        check_film(options.video, options.camera)


def _to_goal(config: Config, options: argparse.Namespace) -> dict[str, Any]:
    """The settings of a drive from the world's start, unless something else is set, to the goal that `--goal` says."""
    if not hasattr(config.task, "goal"):
        raise InputError(f"--goal goes with a task that has one, such as navigate; task {config.task_name} has none")
    x, y = parse_goal(options.goal)
    chosen = [pair.partition("=")[0].strip() for pair in options.set]
    return {"goal": [x, y], **({} if "task.start" in chosen else {"start": "fixed"})}


def _film(policy: Policy, config: Config, options: argparse.Namespace, robot: RosRobot | None) -> None:
    path = film(
        policy,
        options.video or f"{_film_name(options)}.mp4",
        config,
        episodes=options.episodes,
        steps=options.steps,
        seed=options.seed,
        camera=options.camera,
        speed=options.speed,
        listener=_teller(config.scene),
        progress=True,
        simulation=robot or options.simulation,
    )
    _tell_of_twin(options)
    _tell_of_file(path, path.stat().st_size)


def _record(policy: Policy, config: Config, options: argparse.Namespace) -> None:
    bags = record(
        policy,
        options.bag,
        config,
        episodes=options.episodes,
        steps=options.steps,
        seed=options.seed,
        listener=_teller(config.scene),
        progress=True,
        simulation=options.simulation,
    )
    _tell_of_twin(options)
    for bag in bags:
        _tell_of_file(bag, sum(file.stat().st_size for file in [bag, *bag.glob("*")] if file.is_file()))


def _tell_of_twin(options: argparse.Namespace) -> None:
    trouble = bullet_trouble()
    if options.simulation is None and trouble:
        print(f"driven in the fast twin, since PyBullet {trouble}")


def _tell_of_file(path: Path, size: int) -> None:
    print(f"wrote {path} ({size / 1e6:.1f} MB)")


def _film_name(options: argparse.Namespace) -> str:
    """What a film is called after its policy."""
    if options.agent is not None:
        return options.agent.replace(":", ".")
    return Path(options.policy.removeprefix("zoo:").removeprefix(HUB)).resolve().name.removesuffix(SUFFIX)


def _show(policy: Policy, config: Config, options: argparse.Namespace) -> None:
    policy, env = open_env(policy, config, {}, options.steps, options.simulation)
    with closing(env), closing(Window(env.scene, options.camera)) as window, suppress(KeyboardInterrupt):
        driven = drives(env, policy, options.episodes, options.seed, _teller(env.scene))
        watch(driven, env.scene.task.control_period, window, options.speed)


def _teller(scene: Scene) -> Callable[[int, Moment], None]:
    """What prints a line at the end of each episode."""

    def tell(episode: int, last: Moment) -> None:
        seconds, distance = last.step * scene.task.control_period, last.info["distance"]
        say(
            f"episode {episode}: {last.info['ended']} after {last.step} steps ({seconds:.1f} s), "
            f"{distance:.1f} m, {distance / seconds:.3f} m/s, return {last.total:g}"
        )

    return tell


def drive_by_keyboard(scene: Scene, seed: int, camera: str = "above", simulation: str | None = None) -> None:
    """Let the user drive, in the terminal, and in the window if there is a display."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise InputError("--teleop reads keys from a terminal and draws on it, and here stdin or stdout is not one")
    with closing(Teleop(scene, seed, simulation)) as teleop:
        if has_display():
            with closing(Window(scene, camera)) as window:
                steer_in_terminal(teleop, window.show)
        else:
            steer_in_terminal(teleop, lambda start, pose, dynamic_obstacles: True)
