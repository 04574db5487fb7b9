"""Load the policy, the task and the robot that the arguments of `arguments.py` select."""

import argparse
import signal
from dataclasses import asdict

from tb2rl.commands.arguments import refuse
from tb2rl.core.errors import InputError
from tb2rl.core.values import Point, checked
from tb2rl.deploy.portable.termination import termination_signals
from tb2rl.deploy.ros.robot import RosRobot, parse_limits, parse_mounting
from tb2rl.deploy.ros.topics import TURTLEBOT2, parse_topics
from tb2rl.evaluation.episodes import Policy
from tb2rl.evaluation.evaluate import time_limit
from tb2rl.runs import Config, config_of, load, make_baseline, parse_settings, resolve
from tb2rl.simulation import find_simulator


def chosen_policy(options: argparse.Namespace) -> tuple[Policy, Config]:
    """Load the chosen policy, and the config of the task at which it drives.

    Raises:
        InputError: If the policy does not exist, or a setting is invalid.
    """
    if (options.policy is None) == (options.agent is None):
        raise InputError("name a policy (run folder, checkpoint, zoo:NAME, hf:USER/REPOSITORY), or name an --agent")
    settings = parse_settings(options.set)
    if options.agent is not None:
        config = resolve(options.agent, options.task, settings=settings)
        return make_baseline(config), config
    refuse(options, "needs --agent; a policy keeps the task of its training", "task")
    policy = load(options.policy, options.trust)
    for key in settings:
        if not key.startswith("task."):
            raise InputError(f"only the task of a trained policy can be changed (task.KEY=VALUE), got {key!r}")
    return policy, config_of(policy).with_task({key.removeprefix("task."): value for key, value in settings.items()})


def chosen_time_limit(options: argparse.Namespace, default: int) -> int:
    """Time limit of an episode [control steps], from `--steps` or `--set task.episode_steps`."""
    settings = parse_settings(options.set)
    return time_limit(options.steps, {key.removeprefix("task."): value for key, value in settings.items()}, default)


def parse_goal(text: str) -> Point:
    """Parse a goal x, y [m], such as "3,2"."""
    return checked(Point, text.split(","), "--goal")


def chosen_robot(options: argparse.Namespace) -> RosRobot | None:
    """The robot with ROS that the arguments select; None for a simulation.

    With a robot, all termination signals raise `KeyboardInterrupt` from now on, so that `close` can stop the robot.

    Raises:
        InputError: If an argument is invalid.
    """
    if options.simulation is None or not find_simulator(options.simulation).is_external:
        refuse(options, "needs --simulation ros", "ros", "topics", "mounting", "top_speed", "ros_args")
        return None
    ros = options.ros or 1
    topics = asdict(parse_topics(options.topics, TURTLEBOT2[ros]))
    mounting, limits = parse_mounting(options.mounting or "0,0,0"), parse_limits(options.top_speed, "--top-speed")
    goal = None if options.goal is None else parse_goal(options.goal)
    for number in termination_signals():
        signal.signal(number, signal.default_int_handler)
    return RosRobot(ros, topics, mounting, limits, goal, tuple(options.ros_args))
