"""Command-line arguments that name a policy, its task and the robot; `tb2rl.commands.policy` and `robot` read them."""

from __future__ import annotations

import argparse

from tb2rl.core.plugins import simulator_names


def add_policy_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the policy and its task."""
    parser.add_argument("policy", nargs="?", help="run folder, checkpoint in it, zoo:NAME, or hf:USER/REPOSITORY")
    add_trust(parser)
    parser.add_argument("--agent", help="an agent that does not learn, such as random or wallfollower, as the policy")
    parser.add_argument("--task", help="task of --agent (default: maze)")
    parser.add_argument(
        "--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="change the task: task.world=circuit"
    )


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the simulator, or a robot with ROS in its place."""
    parser.add_argument(
        "--simulation",
        metavar="NAME",
        help=f"{', '.join(simulator_names())} (a robot, see tb2rl/deploy/ros/README.md) or module:Class; default: the "
        "first physics that is installed",
    )
    parser.add_argument("--top-speed", type=float, metavar="M/S", help="with ROS: speed limit")
    parser.add_argument("--goal", metavar="X,Y", help="goal of task navigate, from the start pose [m]")
    add_ros_arguments(parser)


def add_ros_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the ROS version, the scanner's pose, topics and ROS arguments."""
    parser.add_argument("--ros", type=int, choices=(1, 2), help="ROS version (1)")
    parser.add_argument(
        "--mounting",
        metavar="X,Y,YAW[,upside-down]",
        help="pose of the scanner: ahead and left of the axle's middle [m], turned left [rad]; --mounting=-0.1,0,0",
    )
    add_topics(parser)
    parser.add_argument(
        "--ros-args", nargs=argparse.REMAINDER, default=[], help="at the end, for ROS 2: -p use_sim_time:=true"
    )


def add_topics(parser: argparse.ArgumentParser) -> None:
    """Add the names of ROS topics."""
    parser.add_argument(
        "--topics", nargs="+", default=[], action="extend", metavar="KEY=TOPIC", help="rename topics, e.g. scan=/scan"
    )


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Add `--trust`, see `tb2rl.core.trust`."""
    parser.add_argument("--trust", action="store_true", help="import any module that a shared policy names")
