"""The robot with ROS that a command line names; see `tb2rl.policy_arguments.add_robot_arguments`."""

from __future__ import annotations

import argparse
import signal
from dataclasses import asdict

from tb2rl.errors import InputError
from tb2rl.ros.robot import RosRobot, parse_limits, parse_mounting
from tb2rl.ros.topics import TURTLEBOT2, parse_topics


def chosen_robot(options: argparse.Namespace) -> RosRobot | None:
    """The robot that the arguments name; None: they ask for a simulation.

    Whatever ends the program from now on, it goes through what tells the robot to stand.

    Raises:
        InputError: If one of them does not fit.
    """
    if options.simulation is None:
        if options.ros or options.topics or options.ros_args or options.mounting or options.top_speed is not None:
            raise InputError("--ros, --topics, --mounting, --top-speed and --ros-args go with --simulation ros")
        return None
    ros = options.ros or 1
    topics = asdict(parse_topics(options.topics, TURTLEBOT2[ros]))
    mounting, limits = parse_mounting(options.mounting or "0,0,0"), parse_limits(options.top_speed, "--top-speed")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    return RosRobot(ros, topics, mounting, limits, tuple(options.ros_args))
