"""The robot with ROS of a command line; see `tb2rl.policy_arguments.add_robot_arguments`."""

from __future__ import annotations

import argparse
import math
import signal
from dataclasses import asdict

from tb2rl.core.errors import InputError
from tb2rl.deploy.portable.termination import termination_signals
from tb2rl.deploy.ros.robot import RosRobot, parse_limits, parse_mounting
from tb2rl.deploy.ros.topics import TURTLEBOT2, parse_topics
from tb2rl.simulation import find_simulator


def parse_goal(text: str) -> tuple[float, float]:
    """Parse a goal x, y [m], such as "3,2".

    Raises:
        InputError: For another form.
    """
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"--goal takes two numbers, X,Y, such as 3,2, got {text!r}")
    return x, y


def robot_chosen(options: argparse.Namespace) -> bool:
    """Whether `--simulation` names a robot."""
    return options.simulation is not None and find_simulator(options.simulation).is_robot


def chosen_robot(options: argparse.Namespace) -> RosRobot | None:
    """Return the robot of the arguments; None: they ask for a simulation.

    From now on all signals that end the program raise `KeyboardInterrupt`, so that `close` stops the robot.

    Raises:
        InputError: If an argument does not fit.
    """
    if not robot_chosen(options):
        if options.ros or options.topics or options.ros_args or options.mounting or options.top_speed is not None:
            raise InputError("--ros, --topics, --mounting, --top-speed and --ros-args go with --simulation ros")
        return None
    ros = options.ros or 1
    topics = asdict(parse_topics(options.topics, TURTLEBOT2[ros]))
    mounting, limits = parse_mounting(options.mounting or "0,0,0"), parse_limits(options.top_speed, "--top-speed")
    goal = None if options.goal is None else parse_goal(options.goal)
    for sign in termination_signals():
        signal.signal(sign, signal.default_int_handler)
    return RosRobot(ros, topics, mounting, limits, goal, tuple(options.ros_args))
